//! A CSV's first lines: they determine the delimiter and what each column contains.
//!
//! A column is identified by channel and unit suffix (`gyro_x_rad_s`, `accel_z_mg`), by the
//! [vocabulary](super::vocabulary) of other programs, or by the user's map ([`ColumnMap`]). Comma, semicolon, tab
//! and space separate columns. Of several in the header line the one that identifies the most columns is used.
//! Lines before the header that begin with `#` or `%` are comments, which may state a rate. Pure.

use super::columns::Columns;
use super::error::RecordingError;
use super::mapping::{ColumnMap, Foreign};
use super::names::{clean, known_column};
use super::vocabulary::{Meaning, meaning};
use std::path::Path;

/// The delimiters, in the order of priority if names do not decide.
const DELIMITERS: [u8; 3] = [b'\t', b';', b','];
/// Separates the columns of a line that has none of the [`DELIMITERS`].
pub(super) const SPACE: u8 = b' ';

/// A parsed header line.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) delimiter: u8,
    pub(super) columns: Columns,
    /// The line is no header but the first row: columns are identified by their positions.
    pub(super) is_row: bool,
}

impl Header {
    /// Parses the header line; `rows` returns the first lines behind it.
    pub(super) fn understand(
        line: &str,
        map: &ColumnMap,
        file: &Path,
        rows: &dyn Fn() -> Vec<String>,
    ) -> Result<Self, RecordingError> {
        let line = without_comment_sign(line, map);
        let (delimiter, _) = delimiter(line, map);
        let cells = cells(line, delimiter);
        let is_row = map.is_by_position() && is_row(&cells, map);
        let rows = || rows().iter().map(|row| numbers(row, delimiter)).collect();
        let columns = Columns::find(&cells, is_row, map, file, &rows)?;
        Ok(Self { delimiter, columns, is_row })
    }

    /// Returns whether a line, as the header of a CSV, names at least one channel with its unit or a column that the
    /// user named.
    pub(super) fn names_channels(line: &str, map: &ColumnMap) -> bool {
        delimiter(without_comment_sign(line, map), map).1 > 0
    }

    /// Returns whether [`Self::names_channels`] accepts the line, or whether it may be a row of a table whose columns are
    /// identified by their positions.
    pub(super) fn is_known(line: &str, map: &ColumnMap) -> bool {
        !map.is_empty() || Self::names_channels(line, map)
    }

    /// Returns whether a line is a comment before the header.
    pub(super) fn is_comment(line: &str, map: &ColumnMap) -> bool {
        let line = line.trim_start_matches('\u{FEFF}').trim_start();
        // Excel's line that names the delimiter, and Xsens' comments.
        let is_marked = line.starts_with("//") || line.starts_with(['#', '%']);
        line.starts_with("sep=") || is_marked && delimiter(without_comment_sign(line, map), map).1 == 0
    }
}

/// Returns a table's columns as words, if the line may be a foreign header; without words, if it is a row of numbers.
pub(super) fn foreign_names(line: &str) -> Option<Vec<String>> {
    let line = line.trim_start_matches('\u{FEFF}').trim_start_matches(['#', '%']);
    let cells = cells(line, delimiter(line, &ColumnMap::default()).0);
    let is_word = |cell: &String| {
        let cell = clean(cell);
        cell.is_empty() || cell.contains(|c: char| c.is_alphabetic()) && !cell.contains(|c: char| c.is_control())
    };
    let is_number = |cell: &String| clean(cell).parse::<f64>().is_ok();
    let empty = cells.iter().filter(|cell| clean(cell).is_empty()).count();
    let of_words = cells.len() > 1 + empty && empty < 2 && cells.iter().all(is_word);
    (of_words || (cells.len() > 3 && cells.iter().all(is_number))).then_some(cells)
}

/// Returns whether a name states a channel with its unit.
fn names_channel(name: &str) -> bool {
    known_column(name).is_some() || matches!(meaning(name), Some(Meaning::Value { .. }))
}

/// Returns the cells of a row.
fn numbers(row: &str, delimiter: u8) -> Vec<String> {
    cells(row, delimiter).iter().map(|cell| clean(cell).to_owned()).collect()
}

/// Returns the cells of a row, separated as those of the table's first line.
pub(super) fn numbers_like(row: &str, first: &str) -> Vec<String> {
    numbers(row, delimiter(first, &ColumnMap::default()).0)
}

/// Words that precede `rate` if it is a sampling rate: not a baud rate, nor a gyro's rate of turn.
const RATES_OF: [&str; 9] =
    ["sample", "samples", "sampling", "output", "imu", "sensor", "update", "measurement", "acquisition"];

/// Returns the rate that a comment states: `# rate: 40 Hz`, `# rate_hz = 40`, `# sampling rate 40`.
pub(super) fn rate_of_comment(line: &str) -> Option<f64> {
    let lower = line.to_ascii_lowercase();
    lower.match_indices("rate").find_map(|(place, rate)| {
        let before = lower[..place].trim_end_matches([' ', '\t', '_', '-']);
        let word = before.rsplit(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
        let is_meant = word.is_empty() || RATES_OF.contains(&word);
        rate_behind(&lower[place + rate.len()..]).filter(|_| is_meant)
    })
}

/// Returns the number behind the word, unless it has another unit.
fn rate_behind(behind: &str) -> Option<f64> {
    let is_filler = |c: char| c.is_whitespace() || matches!(c, ':' | '=' | '_' | ',' | ';' | '(' | ')' | '[' | ']');
    let mut words = behind.split(is_filler).filter(|word| !word.is_empty()).skip_while(|word| *word == "hz");
    let number: f64 = words.next()?.trim_end_matches("hz").parse().ok()?;
    (number.is_finite() && number > 0.0 && words.next().is_none_or(|unit| unit == "hz")).then_some(number)
}

/// Removes the comment sign, because some programs write the header line as a comment.
fn without_comment_sign<'a>(line: &'a str, map: &ColumnMap) -> &'a str {
    let trimmed = line.trim_start_matches('\u{FEFF}').trim_start();
    match trimmed.strip_prefix(['#', '%']) {
        Some(bare) if delimiter(trimmed, map).1 <= delimiter(bare, map).1 => bare,
        _ => line,
    }
}

/// Returns the character that separates the columns of a header line, and the number of columns it identifies.
fn delimiter(line: &str, map: &ColumnMap) -> (u8, usize) {
    let known = |delimiter: u8| {
        let names = cells(line, delimiter);
        let by_name = |name: &str| map.foreign().any(|foreign| *foreign == Foreign::Name(name.to_owned()));
        names.iter().map(|name| clean(name)).filter(|name| names_channel(name) || by_name(name)).count()
    };
    let present = DELIMITERS.into_iter().filter(|delimiter| line.as_bytes().contains(delimiter));
    // Of equals the first is taken.
    let counted = present.map(|delimiter| (delimiter, known(delimiter))).rev();
    let none = || {
        let of_space = line.trim().contains(char::is_whitespace) && known(SPACE) >= known(b',');
        if of_space { (SPACE, known(SPACE)) } else { (b',', known(b',')) }
    };
    counted.max_by_key(|(_, known)| *known).unwrap_or_else(none)
}

/// Returns text of UTF-8, or of ISO 8859-1 if it is not that: programs of Windows write `°/s` and `m/s²` in it.
pub(super) fn decoded(bytes: &[u8]) -> String {
    std::str::from_utf8(bytes).map_or_else(|_| bytes.iter().map(|byte| char::from(*byte)).collect(), str::to_owned)
}

/// Returns a line's cells; a cell in quotation marks stays whole.
fn cells(line: &str, delimiter: u8) -> Vec<String> {
    if delimiter == SPACE {
        return line.split_ascii_whitespace().map(str::to_owned).collect();
    }
    let mut split = Split::default();
    split.push(line.as_bytes(), delimiter);
    split.finish();
    split.cells().map(decoded).collect()
}

/// Returns whether every column that the user named by its position contains a number or is empty; other columns may
/// hold text.
fn is_row(cells: &[String], map: &ColumnMap) -> bool {
    let mapped = cells.iter().enumerate().filter(|(index, name)| map.of(index + 1, name).is_some());
    let mapped: Vec<&str> = mapped.map(|(_, cell)| clean(cell)).collect();
    mapped.iter().all(|cell| cell.is_empty() || cell.parse::<f64>().is_ok())
        && mapped.iter().any(|cell| !cell.is_empty())
}

/// Splits a row with quotation marks. They enclose a whole cell, which may hold the delimiter, and a doubled mark
/// stands for one mark.
#[derive(Debug, Default)]
pub(super) struct Split {
    bytes: Vec<u8>,
    ends: Vec<usize>,
    quoted: bool,
    /// Whether the position is behind the quotation mark that closes a cell, or that is the first of two.
    closed: bool,
    /// Whether the position is inside a cell.
    inside: bool,
}

impl Split {
    /// Takes the bytes of a line.
    pub(super) fn push(&mut self, bytes: &[u8], delimiter: u8) {
        for byte in bytes.iter().copied() {
            let closed = std::mem::take(&mut self.closed);
            match byte {
                b'"' if self.quoted => (self.quoted, self.closed) = (false, true),
                _ if self.quoted => self.bytes.push(byte),
                b'"' if closed => {
                    self.bytes.push(byte);
                    self.quoted = true;
                }
                b'"' if !self.inside => self.quoted = true,
                _ if byte == delimiter => {
                    self.finish();
                    continue;
                }
                _ => self.bytes.push(byte),
            }
            self.inside = true;
        }
    }

    /// Returns whether a quotation mark is open.
    pub(super) fn is_open(&self) -> bool {
        self.quoted
    }

    /// Ends the cell.
    pub(super) fn finish(&mut self) {
        self.ends.push(self.bytes.len());
        (self.quoted, self.closed, self.inside) = (false, false, false);
    }

    /// Returns the cells.
    pub(super) fn cells(&self) -> impl ExactSizeIterator<Item = &[u8]> {
        let begins = std::iter::once(0).chain(self.ends.iter().copied());
        let cells: Vec<&[u8]> =
            begins.zip(&self.ends).map(|(begin, end)| self.bytes.get(begin..*end).unwrap_or_default()).collect();
        cells.into_iter()
    }

    /// Clears the row.
    pub(super) fn clear(&mut self) {
        self.bytes.clear();
        self.ends.clear();
        (self.quoted, self.closed, self.inside) = (false, false, false);
    }
}
