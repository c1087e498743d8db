//! CSV: a header line that names channels and units, rows of numbers (docs/formats.md).
//!
//! Columns may stand in any order and be separated by comma, semicolon, tab or space ([`super::header`]); values
//! are converted to the channel's unit once, here. Where the comma does not separate columns it may be the decimal
//! sign: the first number with a sign decides, and a row with the other sign is rejected. Other columns are ignored
//! and reported by name. A blank cell, NaN, NA or null leaves its channel absent. A row is rejected if it has another number
//! of cells, or a cell that is no number or no stamp. A line that ends within quotation marks is also rejected: a
//! cell does not run over a line's end, or an open mark would consume the rows behind it. A rejected row's stamp
//! still shows its time.
//!
//! Rows of plain numbers are read in place; only those with quotation marks are copied. Memory is bounded by the
//! longest row, 64 KiB.

use super::columns::Column;
use super::error::{RecordingError, read_error};
use super::header::{Header, SPACE, Split, decoded, rate_of_comment};
use super::input::Input;
use super::number::{Plain, parse_plain};
use super::rows::{Decimals, Rejected, Row, Rows};
use super::stamps::{RowStamps, STAMPS_MAX, parse_date, parse_stamp};
use imu_core::sample::{DiscardCause, Sample};
use std::io::{BufRead, Read};
use std::ops::Range;
use std::path::PathBuf;

/// A row of all channels has about 300 bytes; foreign columns may make it longer. A longer line is no row: a file must
/// not determine how much memory a line without end takes.
const ROW_BYTES: usize = 64 * 1024;

/// Cells without a value, as spreadsheets, R and Python write them, in any case of letters.
const ABSENT: [&str; 8] = ["", "nan", "na", "n/a", "null", "none", "nil", "-"];

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

    /// Reduces the space between cells to one character, and takes away that around the line.
    fn squeeze(&mut self) {
        let mut to = self.current.start;
        let mut after_space = true;
        for from in self.current.clone() {
            let Some(byte) = self.bytes.get(from).copied() else { break };
            let is_space = byte.is_ascii_whitespace();
            if !(is_space && after_space)
                && let Some(place) = self.bytes.get_mut(to)
            {
                *place = if is_space { SPACE } else { byte };
                to += 1;
            }
            after_space = is_space;
        }
        self.current.end = if after_space { to.saturating_sub(1).max(self.current.start) } else { to };
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
#[expect(clippy::large_enum_variant, reason = "one at a time; a box would cost an allocation for each row")]
enum Found {
    Sample(RowStamps, Sample),
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
    sign: Sign,
}

/// The rows behind the header that are looked at to determine the unit of times, or to propose columns.
const FIRST_ROWS: usize = 64;

/// The decimal sign of a table whose cells are not separated by commas.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sign {
    /// No number with a sign was read.
    Unknown,
    Point,
    Comma,
}

/// Returns the lines that follow the first `after` ones.
fn first_rows(input: &Input, after: u64) -> Vec<String> {
    let Ok(mut lines) = Lines::new(input) else { return Vec::new() };
    let mut rows = Vec::new();
    while rows.len() < FIRST_ROWS && lines.advance().unwrap_or(false) {
        lines.by_return = lines.cut() || lines.by_return;
        if lines.number > after {
            rows.push(decoded(lines.current()));
        }
    }
    rows
}

impl CsvRows {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let (file, map) = (input.path(), input.columns());
        let mut lines = Lines::new(input)?;
        let mut commented_rate_hz = None;
        let header = loop {
            if !lines.advance()? {
                // The file contains only comments.
                break Header::understand("", map, file, &Vec::new)?;
            }
            lines.by_return = lines.cut() || lines.by_return;
            let line = decoded(lines.current());
            if !Header::is_comment(&line, map) {
                let number = lines.number;
                break Header::understand(&line, map, file, &|| first_rows(input, number))?;
            }
            commented_rate_hz = commented_rate_hz.or_else(|| rate_of_comment(&line));
        };
        let waiting = header.is_row;
        let header_comma = header.delimiter == b',';
        Ok(Self {
            lines,
            header,
            commented_rate_hz,
            decimals: Decimals::default(),
            split: Split::default(),
            waiting,
            sign: if header_comma { Sign::Point } else { Sign::Unknown },
        })
    }

    /// Returns the current line's stamps and values, if it consists of numbers and delimiters.
    fn plain(&mut self) -> Found {
        let mut taken = Taken::new(self.header.columns.stamps.len());
        let line = self.lines.bytes.get(self.lines.current.clone()).unwrap_or_default();
        let mut rest = Some(line);
        for column in &self.header.columns.list {
            let Some(text) = rest else { return self.bad() };
            let end = text.iter().position(|byte| *byte == self.header.delimiter);
            let (cell, behind) = match end {
                Some(end) => (&text[..end], Some(&text[end + 1..])),
                None => (text, None),
            };
            rest = behind;
            let fits = match column {
                Column::Ignored if cell.contains(&b'"') => return Found::Quoted,
                column => taken.take(*column, cell, &mut self.sign, &mut self.decimals),
            };
            if fits.is_none() {
                return self.bad();
            }
        }
        // Some programs end each row with a delimiter that the header does not have.
        let has_more = rest.is_some_and(|rest| !rest.trim_ascii().is_empty());
        if has_more || taken.sample.channels().is_empty() { self.bad() } else { taken.found() }
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
        let columns = &self.header.columns;
        let mut taken = Taken::new(columns.stamps.len());
        if cells.len() != columns.list.len() {
            return Found::Bad;
        }
        for (cell, column) in cells.zip(&columns.list) {
            if taken.take(*column, cell, &mut self.sign, &mut self.decimals).is_none() {
                return Found::Bad;
            }
        }
        if taken.sample.channels().is_empty() { Found::Bad } else { taken.found() }
    }

    /// Returns the stamp of a line that is no row: its own if it has all its cells, else the one in its first cell if
    /// that is complete.
    fn stamp_of_rejected(&self) -> RowStamps {
        let cells = || self.lines.current().split(|byte| *byte == self.header.delimiter);
        let columns = &self.header.columns;
        let place = columns.list.iter().position(|column| matches!(column, Column::Stamp { .. }));
        let stamp_ns = place.filter(|_| columns.stamps.len() == 1).and_then(|place| {
            let Column::Stamp { places, .. } = *columns.list.get(place)? else { return None };
            let count = cells().count();
            let is_its_own = count == columns.list.len() || (place == 0 && count > 1);
            stamp(cells().nth(place).filter(|_| is_its_own)?, places)
        });
        stamp_ns.map(RowStamps::one).unwrap_or_default()
    }
}

fn stamp(cell: &[u8], places: usize) -> Option<i64> {
    let cell = cell.trim_ascii();
    parse_stamp(cell, places).or_else(|| parse_date(cell))
}

/// The longest number with a decimal comma.
const COMMA_BYTES: usize = 40;

/// Reads a number of a table with decimal commas, or of one whose sign is not known yet.
fn parse_signed(cell: &[u8], sign: &mut Sign) -> Option<Plain> {
    let comma = cell.iter().position(|byte| *byte == b',').filter(|_| cell.len() <= COMMA_BYTES);
    let Some(place) = comma else {
        let plain = parse_plain(cell)?;
        if plain.decimals > 0 && *sign == Sign::Unknown {
            *sign = Sign::Point;
        }
        return Some(plain);
    };
    let mut copy = [0; COMMA_BYTES];
    copy[..cell.len()].copy_from_slice(cell);
    copy[place] = b'.';
    let plain = parse_plain(&copy[..cell.len()])?;
    *sign = Sign::Comma;
    Some(plain)
}

/// What was taken from a row's cells so far.
struct Taken {
    sample: Sample,
    stamps: [i64; STAMPS_MAX],
    count: usize,
}

impl Taken {
    fn new(count: usize) -> Self {
        Self { sample: Sample::at(0, 0), stamps: [0; STAMPS_MAX], count }
    }

    fn found(self) -> Found {
        let mut stamps = RowStamps::default();
        self.stamps.iter().take(self.count).for_each(|nanos| stamps.push(*nanos));
        Found::Sample(stamps, self.sample)
    }

    /// Takes a cell; `None` if its content does not fit its column.
    fn take(&mut self, column: Column, cell: &[u8], sign: &mut Sign, decimals: &mut Decimals) -> Option<()> {
        match column {
            Column::Ignored => {}
            Column::Stamp { places, slot } => {
                let nanos = stamp(cell, places).or_else(|| {
                    let text = std::str::from_utf8(cell).ok().filter(|_| *sign != Sign::Point)?;
                    parse_stamp(text.trim().replacen(',', ".", 1).as_bytes(), places)
                })?;
                let sum = self.stamps.get_mut(slot)?;
                *sum = sum.checked_add(nanos)?;
            }
            Column::Value { channel, factor } => {
                if *sign == Sign::Comma && cell.contains(&b'.') {
                    return None;
                }
                let plain = if *sign == Sign::Point { parse_plain(cell) } else { parse_signed(cell, sign) };
                let value = match plain {
                    Some(plain) => {
                        decimals.note_count(channel, Some(plain.decimals));
                        plain.value
                    }
                    None => {
                        let text = std::str::from_utf8(cell).ok()?.trim();
                        if ABSENT.iter().any(|absent| text.eq_ignore_ascii_case(absent)) {
                            return Some(());
                        }
                        let comma = *sign != Sign::Point && text.contains(',');
                        let text = if comma { text.replacen(',', ".", 1) } else { text.to_owned() };
                        let value: f64 = text.parse().ok().filter(|value: &f64| value.is_finite())?;
                        decimals.note(channel, &text);
                        value
                    }
                };
                // A factor of 1 must leave the value as it was written.
                self.sample.set(channel, if factor == 1.0 { value } else { value * factor });
            }
        }
        Some(())
    }
}

impl Rows for CsvRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        if !std::mem::take(&mut self.waiting) && !self.lines.advance()? {
            return Ok(None);
        }
        let line = self.lines.number;
        // A carriage return inside is where a line of an old file ends, even if the text could be read across it.
        self.lines.cut();
        if self.header.delimiter == SPACE {
            self.lines.squeeze();
        }
        let mut found = self.plain();
        if matches!(found, Found::Quoted) {
            found = self.quoted();
        }
        if let Found::Sample(stamps, sample) = found {
            return Ok(Some(Row::Sample { line, stamps, sample }));
        }
        let rejected = Rejected::of_line(line, DiscardCause::Malformed, self.lines.current(), true);
        Ok(Some(Row::Rejected(rejected.stamped(self.stamp_of_rejected()))))
    }
    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}
