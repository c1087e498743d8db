//! CSV: a header line that names channels and units, rows of numbers (docs/formats.md).
//!
//! Columns may stand in any order and be separated by comma, semicolon or tab ([`super::header`]); values are converted
//! to the channel's unit once, here. Other columns are ignored and reported by name. A blank cell or NaN leaves its
//! channel absent. A row is rejected if it has another number of cells, or a cell that is no number or no stamp. A line
//! that ends within quotation marks is also rejected: a cell does not run over a line's end, or an open mark would
//! consume the rows behind it. A rejected row's stamp still shows its time.
//!
//! Rows of plain numbers are read in place; only those with quotation marks are copied. Memory is bounded by the
//! longest row, 64 KiB.

use super::choice::{Chosen, choose};
use super::detect::read_error;
use super::error::RecordingError;
use super::header::{Column, Header, Split, rate_of_comment};
use super::info::Decimals;
use super::input::Input;
use super::number::parse_plain;
use super::rows::{Rejected, Row, Rows};
use super::stamps::{RowStamps, parse_stamp};
use imu_core::sample::{DiscardCause, Sample};
use std::io::{BufRead, Read};
use std::ops::Range;
use std::path::PathBuf;

/// A row of all channels has about 300 bytes; foreign columns may make it longer. A longer line is no row: a file must
/// not determine how much memory a line without end takes.
const ROW_BYTES: usize = 64 * 1024;

/// The lines of a file, one at a time.
struct Lines {
    file: PathBuf,
    reader: Box<dyn BufRead>,
    bytes: Vec<u8>,
    /// The current line, without its end.
    current: Range<usize>,
    /// The line that follows it in `bytes`, if a carriage return ended the current line.
    next: usize,
    /// The number of the line, from 1.
    number: u64,
    /// Lines end with a carriage return alone, as the first one does.
    by_return: bool,
    /// The data read last ends within a line.
    partial: bool,
}

impl Lines {
    fn new(input: &Input) -> Result<Self, RecordingError> {
        Ok(Self {
            file: input.path().to_owned(),
            reader: input.open()?,
            bytes: Vec::new(),
            current: 0..0,
            next: 0,
            number: 0,
            by_return: false,
            partial: false,
        })
    }

    /// Advances to the next line that is not empty; returns whether there is one.
    fn advance(&mut self) -> Result<bool, RecordingError> {
        loop {
            let rest = self.bytes.get(self.next..).unwrap_or_default();
            let fresh = rest.is_empty();
            if fresh {
                self.bytes.clear();
                self.next = 0;
                self.pass_empty()?;
                if self.read()? == 0 {
                    self.current = 0..0;
                    return Ok(false);
                }
            } else if self.partial && !rest.contains(&b'\r') {
                // The line continues behind the data read so far.
                self.bytes.drain(..self.next);
                self.next = 0;
                self.read()?;
            }
            let begin = self.next;
            let text = self.bytes.get(begin..).unwrap_or_default();
            let empty = text.iter().take_while(|byte| is_end(**byte)).count();
            let end = text.iter().rposition(|byte| !is_end(*byte)).map_or(empty, |last| last + 1);
            self.number += if self.by_return { u64::from(!fresh) + empty as u64 } else { 0 };
            self.current = begin + empty.min(end)..begin + end;
            self.next = self.bytes.len();
            if !self.current.is_empty() {
                return Ok(true);
            }
        }
    }

    /// Skips empty lines, a buffer at a time: compressed, there may be hundreds of millions.
    fn pass_empty(&mut self) -> Result<(), RecordingError> {
        while !self.by_return {
            let bytes = match self.reader.fill_buf() {
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                bytes => bytes.map_err(|source| read_error(&self.file, self.number, source))?,
            };
            let empty = bytes.iter().take_while(|byte| **byte == b'\n').count();
            if empty == 0 {
                break;
            }
            self.reader.consume(empty);
            self.number += empty as u64;
        }
        Ok(())
    }

    /// Reads up to the next line end behind the present data; returns the number of bytes.
    fn read(&mut self) -> Result<usize, RecordingError> {
        let room = (ROW_BYTES + 1).saturating_sub(self.bytes.len());
        let read = self.reader.by_ref().take(room as u64).read_until(b'\n', &mut self.bytes);
        let read = read.map_err(|source| read_error(&self.file, self.number, source))?;
        self.number += u64::from(read > 0 && !(self.by_return && self.partial));
        self.partial = self.bytes.len() > ROW_BYTES && !self.bytes.ends_with(b"\n");
        if self.partial && !self.bytes.contains(&b'\r') {
            let text = format!("a row of more than {ROW_BYTES} bytes: expected one sample a line");
            return Err(read_error(&self.file, self.number - 1, std::io::Error::other(text)));
        }
        Ok(read)
    }

    fn current(&self) -> &[u8] {
        self.bytes.get(self.current.clone()).unwrap_or_default()
    }

    /// Ends the line at its first carriage return, if it has one inside: old files have no other line end.
    fn cut(&mut self) -> bool {
        let Some(place) = self.current().iter().position(|byte| *byte == b'\r') else { return false };
        self.current.end = self.current.start + place;
        self.next = self.current.end + 1;
        true
    }
}

fn is_end(byte: u8) -> bool {
    byte == b'\n' || byte == b'\r'
}

/// The result of examining a row.
enum Found {
    Sample(Option<i64>, Sample),
    /// It has quotation marks.
    Quoted,
    Bad,
}

/// The rows of a CSV file, one at a time.
pub(super) struct CsvRows {
    lines: Lines,
    pub(super) header: Header,
    /// The rate that a comment before the header states, Hz.
    pub(super) commented_rate_hz: Option<f64>,
    decimals: Decimals,
    split: Split,
    /// Whether the current line is the first row already.
    waiting: bool,
    /// Whether no row has become a sample yet.
    unproven: bool,
}

impl CsvRows {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let (file, map) = (input.path(), input.columns());
        let mut lines = Lines::new(input)?;
        let mut commented_rate_hz = None;
        let header = loop {
            if !lines.advance()? {
                // The file contains only comments.
                break Header::understand("", map, file)?;
            }
            lines.by_return = lines.cut() || lines.by_return;
            let line = String::from_utf8_lossy(lines.current()).into_owned();
            if !Header::is_comment(&line, map) {
                break Header::understand(&line, map, file)?;
            }
            commented_rate_hz = commented_rate_hz.or_else(|| rate_of_comment(&line));
        };
        let waiting = header.is_row;
        Ok(Self {
            lines,
            header,
            commented_rate_hz,
            decimals: Decimals::default(),
            split: Split::default(),
            waiting,
            unproven: true,
        })
    }

    /// Returns the choice of stamps. The header determines whether rows have a stamp; the first rows determine its
    /// clock.
    pub(super) fn chosen(mut self) -> Result<Chosen, RecordingError> {
        let column = self.header.stamp.is_some().then_some(0);
        let Chosen { unix, falls, .. } = choose(&mut self)?;
        Ok(Chosen { count: usize::from(column.is_some()), column, unix, falls, ..Chosen::default() })
    }

    /// Returns the current line's stamp and values, if it consists of numbers and delimiters.
    fn plain(&mut self) -> Found {
        let mut sample = Sample::at(0, 0);
        let mut stamp_ns = None;
        let line = self.lines.bytes.get(self.lines.current.clone()).unwrap_or_default();
        let mut rest = Some(line);
        for column in &self.header.columns {
            let Some(text) = rest else { return self.bad() };
            let end = text.iter().position(|byte| *byte == self.header.delimiter);
            let (cell, behind) = match end {
                Some(end) => (&text[..end], Some(&text[end + 1..])),
                None => (text, None),
            };
            rest = behind;
            let taken = match column {
                Column::Ignored if cell.contains(&b'"') => return Found::Quoted,
                column => take(*column, cell, &mut sample, &mut stamp_ns, &mut self.decimals),
            };
            if taken.is_none() {
                return self.bad();
            }
        }
        if rest.is_some() || sample.channels().is_empty() { self.bad() } else { Found::Sample(stamp_ns, sample) }
    }

    fn bad(&self) -> Found {
        if self.lines.current().contains(&b'"') { Found::Quoted } else { Found::Bad }
    }

    /// Returns stamp and values as [`Self::plain`] does, for a line with quotation marks.
    fn quoted(&mut self) -> Found {
        self.split.clear();
        self.split.push(self.lines.current(), self.header.delimiter);
        if self.split.is_open() {
            return Found::Bad;
        }
        self.split.finish();
        let cells = self.split.cells();
        let mut sample = Sample::at(0, 0);
        let mut stamp_ns = None;
        if cells.len() != self.header.columns.len() {
            return Found::Bad;
        }
        for (cell, column) in cells.zip(&self.header.columns) {
            if take(*column, cell, &mut sample, &mut stamp_ns, &mut self.decimals).is_none() {
                return Found::Bad;
            }
        }
        if sample.channels().is_empty() { Found::Bad } else { Found::Sample(stamp_ns, sample) }
    }

    /// Returns the stamp of a line that is no row: its own if it has all its cells, else the one in its first cell if
    /// that is complete.
    fn stamp_of_rejected(&self) -> RowStamps {
        let cells = || self.lines.current().split(|byte| *byte == self.header.delimiter);
        let place = self.header.columns.iter().position(|column| matches!(column, Column::Stamp { .. }));
        let stamp_ns = place.and_then(|place| {
            let Column::Stamp { places } = *self.header.columns.get(place)? else { return None };
            let count = cells().count();
            let is_its_own = count == self.header.columns.len() || (place == 0 && count > 1);
            parse_stamp(cells().nth(place).filter(|_| is_its_own)?.trim_ascii(), places)
        });
        stamp_ns.map(RowStamps::one).unwrap_or_default()
    }

    /// Fails if the numbers of the first row have decimal commas, because all others then have them too.
    fn decimal_commas(&self) -> Result<(), RecordingError> {
        if !self.unproven || self.header.delimiter == b',' {
            return Ok(());
        }
        let line = String::from_utf8_lossy(self.lines.current());
        let is_one = |cell: &str| {
            let parts = cell.trim().trim_start_matches(['-', '+']).split_once(',');
            let digits = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
            parts.is_some_and(|(whole, fraction)| digits(whole) && digits(fraction))
        };
        match line.split(char::from(self.header.delimiter)).find(|cell| is_one(cell)) {
            Some(cell) => Err(RecordingError::DecimalComma {
                file: self.lines.file.clone(),
                line: self.lines.number,
                cell: cell.trim().to_owned(),
            }),
            None => Ok(()),
        }
    }
}

/// Takes a cell; `None` if its content does not fit its column.
fn take(
    column: Column,
    cell: &[u8],
    sample: &mut Sample,
    stamp_ns: &mut Option<i64>,
    decimals: &mut Decimals,
) -> Option<()> {
    match column {
        Column::Ignored => {}
        Column::Stamp { places } => *stamp_ns = Some(parse_stamp(cell.trim_ascii(), places)?),
        Column::Value { channel, factor } => {
            let value = match parse_plain(cell) {
                Some(plain) => {
                    decimals.note_count(channel, Some(plain.decimals));
                    plain.value
                }
                None => {
                    let text = std::str::from_utf8(cell).ok()?.trim();
                    if text.is_empty() || text.eq_ignore_ascii_case("nan") {
                        return Some(());
                    }
                    let value: f64 = text.parse().ok().filter(|value: &f64| value.is_finite())?;
                    decimals.note(channel, text);
                    value
                }
            };
            // A factor of 1 must leave the value as it was written.
            sample.set(channel, if factor == 1.0 { value } else { value * factor });
        }
    }
    Some(())
}

impl Rows for CsvRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        if !std::mem::take(&mut self.waiting) && !self.lines.advance()? {
            return Ok(None);
        }
        let line = self.lines.number;
        // A carriage return inside is where a line of an old file ends, even if the text could be read across it.
        self.lines.cut();
        let mut found = self.plain();
        if matches!(found, Found::Quoted) {
            found = self.quoted();
        }
        if let Found::Sample(stamp_ns, sample) = found {
            self.unproven = false;
            return Ok(Some(Row::Sample { line, stamps: stamp_ns.map(RowStamps::one).unwrap_or_default(), sample }));
        }
        self.decimal_commas()?;
        let rejected = Rejected::of_line(line, DiscardCause::Malformed, self.lines.current(), true);
        Ok(Some(Row::Rejected(rejected.stamped(self.stamp_of_rejected()))))
    }
    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}
