//! CSV: a header line that names channels and units, rows of numbers (contract, section 4).
//!
//! Columns may stand in any order. A column is known by channel and unit suffix (`gyro_x_rad_s`, `accel_z_mg`); its values
//! are converted to the channel's unit once, here. Other columns are ignored and named. A blank cell or NaN leaves its
//! channel absent; a row with another number of cells, a cell that is no number or no stamp is rejected.

use super::choice::{Chosen, choose};
use super::detect::read_error;
use super::error::RecordingError;
use super::info::{Conversion, Decimals};
use super::input::Input;
use super::rows::{Rejected, Row, Rows};
use super::stamps::{RowStamps, parse_seconds};
use crate::sample::{Channel, DiscardCause, Sample, Triad};
use crate::units::{GAUSS_PER_TESLA, RAD_PER_DEG, STANDARD_GRAVITY_M_S2};
use std::io::BufRead;
use std::path::{Path, PathBuf};

/// Name of the column with stamps in seconds.
const TIME: &str = "time_s";

/// What a column gives.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Column {
    Stamp,
    Value { channel: Channel, factor: f64 },
    Ignored,
}

/// Unit suffixes that a channel's column may have, with the unit's name and the factor to the channel's unit.
fn suffixes(channel: Channel) -> &'static [(&'static str, &'static str, f64)] {
    match channel.triad() {
        Some(Triad::Attitude) => &[("_deg", "deg", 1.0), ("_rad", "rad", 1.0 / RAD_PER_DEG)],
        Some(Triad::Mag) => {
            &[("_gauss", "gauss", 1.0), ("_tesla", "T", GAUSS_PER_TESLA), ("_ut", "µT", 1e-6 * GAUSS_PER_TESLA)]
        }
        Some(Triad::Accel) => {
            &[("_m_s2", "m/s²", 1.0), ("_g", "g", STANDARD_GRAVITY_M_S2), ("_mg", "mg", 1e-3 * STANDARD_GRAVITY_M_S2)]
        }
        Some(Triad::Gyro) => {
            &[("_rad_s", "rad/s", 1.0), ("_deg_s", "deg/s", RAD_PER_DEG), ("_dps", "deg/s", RAD_PER_DEG)]
        }
        None if channel == Channel::Temperature => &[("_c", "°C", 1.0)],
        None => &[("_kpa", "kPa", 1.0)],
    }
}

/// The channel and unit that a column's name means.
pub(super) fn known_column(name: &str) -> Option<(Channel, &'static str, f64)> {
    Channel::ALL.into_iter().find_map(|channel| {
        let suffix = name.strip_prefix(channel.name())?;
        let (_, unit, factor) = suffixes(channel).iter().find(|(known, ..)| *known == suffix)?;
        Some((channel, *unit, *factor))
    })
}

/// A header line, understood.
#[derive(Debug)]
pub(super) struct Header {
    columns: Vec<Column>,
    pub(super) ignored: Vec<String>,
    pub(super) conversions: Vec<Conversion>,
    pub(super) stamped: bool,
}

impl Header {
    /// Whether a line, as the header of a CSV, names at least one channel with its unit.
    pub(super) fn names_a_channel(line: &str) -> bool {
        line.trim_start_matches('\u{FEFF}').split(',').any(|name| known_column(clean(name)).is_some())
    }

    fn understand<'a>(names: impl Iterator<Item = &'a str>, file: &Path) -> Result<Self, RecordingError> {
        let mut header = Self { columns: Vec::new(), ignored: Vec::new(), conversions: Vec::new(), stamped: false };
        let mut seen: Vec<(Channel, String)> = Vec::new();
        for name in names.map(clean) {
            if name == TIME {
                if header.stamped {
                    return Err(RecordingError::DuplicateTime { file: file.to_owned() });
                }
                header.stamped = true;
                header.columns.push(Column::Stamp);
                continue;
            }
            let Some((channel, unit, factor)) = known_column(name) else {
                header.ignored.push(name.to_owned());
                header.columns.push(Column::Ignored);
                continue;
            };
            if let Some((_, first)) = seen.iter().find(|(earlier, _)| *earlier == channel) {
                return Err(RecordingError::DuplicateColumn {
                    file: file.to_owned(),
                    first: first.clone(),
                    second: name.to_owned(),
                    channel,
                });
            }
            seen.push((channel, name.to_owned()));
            if unit != channel.unit() {
                header.conversions.push(Conversion { channel, column: name.to_owned(), original_unit: unit, factor });
            }
            header.columns.push(Column::Value { channel, factor });
        }
        Ok(header)
    }
}

/// A column's name without the space, quotes and byte-order mark that programs put around it.
fn clean(name: &str) -> &str {
    name.trim_matches(|c: char| c.is_whitespace() || c == '\u{FEFF}' || c == '"')
}

/// The rows of a CSV file, one at a time.
pub(super) struct CsvRows {
    file: PathBuf,
    reader: csv::Reader<ShortRows>,
    pub(super) header: Header,
    record: csv::ByteRecord,
    decimals: Decimals,
}

impl CsvRows {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let file = input.path();
        let mut reader =
            csv::ReaderBuilder::new().flexible(true).has_headers(true).from_reader(ShortRows::new(input.open()?));
        let names = reader.byte_headers().map_err(|error| csv_error(file, 1, error))?.clone();
        let names: Vec<_> = names.iter().map(|name| String::from_utf8_lossy(name).into_owned()).collect();
        let header = Header::understand(names.iter().map(String::as_str), file)?;
        Ok(Self {
            file: file.to_owned(),
            reader,
            header,
            record: csv::ByteRecord::new(),
            decimals: Decimals::default(),
        })
    }

    /// Its header tells whether rows have a stamp, the first rows of which clock.
    pub(super) fn chosen(mut self) -> Result<Chosen, RecordingError> {
        let column = self.header.stamped.then_some(0);
        let unix = choose(&mut self)?.unix;
        Ok(Chosen { count: usize::from(column.is_some()), column, unix, regular: Vec::new() })
    }

    /// The row's stamp and values, or what was wrong with it.
    fn understand(&mut self) -> Result<(Option<i64>, Sample), ()> {
        let mut sample = Sample::at(0, 0);
        let mut stamp_ns = None;
        if self.record.len() != self.header.columns.len() {
            return Err(());
        }
        for (cell, column) in self.record.iter().zip(&self.header.columns) {
            if *column == Column::Ignored {
                continue;
            }
            let text = std::str::from_utf8(cell).map_err(|_| ())?.trim();
            match *column {
                Column::Stamp => stamp_ns = Some(parse_seconds(text).ok_or(())?),
                Column::Value { channel, factor } => {
                    if text.is_empty() || text.eq_ignore_ascii_case("nan") {
                        continue;
                    }
                    let value: f64 = text.parse().map_err(|_| ())?;
                    if !value.is_finite() {
                        return Err(());
                    }
                    self.decimals.note(channel, text);
                    // A factor of 1 must leave the value as it was written.
                    sample.set(channel, if factor == 1.0 { value } else { value * factor });
                }
                Column::Ignored => {}
            }
        }
        if sample.channels().is_empty() { Err(()) } else { Ok((stamp_ns, sample)) }
    }
}

/// A row of all channels has some 300 bytes; foreign columns may make it longer.
const ROW_BYTES: usize = 64 * 1024;

/// Refuses rows that are too long to be rows, so that a file does not decide how much memory is taken: a line without
/// end, or a quotation mark that is never closed.
struct ShortRows {
    bytes: Box<dyn BufRead>,
    row_bytes: usize,
    quoted: bool,
}

impl ShortRows {
    fn new(bytes: Box<dyn BufRead>) -> Self {
        Self { bytes, row_bytes: 0, quoted: false }
    }
}

impl std::fmt::Debug for ShortRows {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("ShortRows").field("row_bytes", &self.row_bytes).finish_non_exhaustive()
    }
}

impl std::io::Read for ShortRows {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.bytes.read(buffer)?;
        for byte in buffer.iter().take(read) {
            self.quoted ^= *byte == b'"';
            self.row_bytes = if *byte == b'\n' && !self.quoted { 0 } else { self.row_bytes + 1 };
            if self.row_bytes > ROW_BYTES {
                return Err(std::io::Error::other(format!(
                    "a row of more than {ROW_BYTES} bytes: expected one sample a line (is a quotation mark left open?)"
                )));
            }
        }
        Ok(read)
    }
}

fn csv_error(file: &Path, line: u64, error: csv::Error) -> RecordingError {
    let text = error.to_string();
    match error.into_kind() {
        csv::ErrorKind::Io(source) => read_error(file, line, source),
        _ => read_error(file, line, std::io::Error::other(text)),
    }
}

impl Rows for CsvRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        let line = self.reader.position().line();
        if !self.reader.read_byte_record(&mut self.record).map_err(|error| csv_error(&self.file, line, error))? {
            return Ok(None);
        }
        let line = self.record.position().map_or(line, csv::Position::line);
        Ok(Some(match self.understand() {
            Ok((stamp_ns, sample)) => {
                Row::Sample { line, stamps: stamp_ns.map(RowStamps::one).unwrap_or_default(), sample }
            }
            Err(()) => {
                let cells: Vec<_> = self.record.iter().map(String::from_utf8_lossy).collect();
                Row::Rejected(Rejected::new(line, DiscardCause::Malformed, &cells.join(","), true))
            }
        }))
    }
    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}
