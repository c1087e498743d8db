//! Arrays: named arrays of numbers as one table.
//!
//! The table has as many rows as most columns have whose names state a channel or a time, or else as most columns
//! have: a vector of that length is a column, a matrix with one side of that length has its other side as columns
//! (`gyro[0]`, `gyro[1]`, …), whichever way it lies. Other arrays are left out and named. Pure.

use super::super::error::RecordingError;
use super::super::names::known_column;
use super::super::vocabulary::{Meaning, meaning};
use super::row::{Cell, Next, Table};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The largest file of arrays that is read into memory, bytes, and the most that its arrays may take.
pub(in crate::recording) const BYTES_MAX: usize = 1 << 30;
/// The ratio to which a file's arrays may expand, and the bytes that are allowed whatever its size: a length field or compressed
/// zeros must not determine how much memory a small file takes.
const EXPANSION: usize = 100;
const FREE_BYTES: usize = 64 << 20;

/// Returns the most bytes that the arrays of a file of this size may take.
fn most_bytes(file_bytes: usize) -> usize {
    file_bytes.saturating_mul(EXPANSION).saturating_add(FREE_BYTES).min(BYTES_MAX)
}

/// The most columns that one array may have.
const COLUMNS_MAX: usize = 256;

/// An array's numbers, in the order of the file.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Data {
    Floats(Vec<f64>),
    Wholes(Vec<i64>),
}

impl Data {
    fn len(&self) -> usize {
        match self {
            Self::Floats(values) => values.len(),
            Self::Wholes(values) => values.len(),
        }
    }
}

/// The type of an array's numbers in a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Kind {
    pub(super) form: Form,
    /// Bytes of a number.
    pub(super) size: usize,
    pub(super) big_endian: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Form {
    Float,
    Signed,
    Unsigned,
}

impl Kind {
    /// Reads one number; `None` if this type is not read.
    pub(super) fn number(self, bytes: &[u8]) -> Option<Cell> {
        let mut eight = [0_u8; 8];
        let size = self.size.min(8);
        for (place, byte) in bytes.get(..size)?.iter().enumerate() {
            eight[if self.big_endian { size - 1 - place } else { place }] = *byte;
        }
        let raw = u64::from_le_bytes(eight);
        let unused = 64 - 8 * u32::try_from(size).ok()?;
        match (self.form, self.size) {
            (Form::Float, 4) => Some(Cell::of(f64::from(f32::from_bits(u32::try_from(raw).ok()?)))),
            (Form::Float, 8) => Some(Cell::of(f64::from_bits(raw))),
            (Form::Signed, 1 | 2 | 4 | 8) => Some(Cell::Whole((raw << unused).cast_signed() >> unused)),
            (Form::Unsigned, 1 | 2 | 4 | 8) => Some(i64::try_from(raw).map_or(Cell::Number(raw as f64), Cell::Whole)),
            _ => None,
        }
    }

    /// Reads all numbers; integers that are beyond 63 bits somewhere as floats.
    ///
    /// # Errors
    /// A sentence if this type is not read, or the numbers take more than is left.
    pub(super) fn data(self, bytes: &[u8], budget: &mut Budget) -> Result<Data, String> {
        let count = bytes.len() / self.size.max(1);
        budget.take_numbers(count)?;
        let cells = || bytes.chunks_exact(self.size.max(1)).map(|chunk| self.number(chunk));
        if self.form != Form::Float {
            let mut wholes = Vec::with_capacity(count);
            wholes
                .extend(cells().map_while(|cell| if let Some(Cell::Whole(whole)) = cell { Some(whole) } else { None }));
            if wholes.len() == count {
                return Ok(Data::Wholes(wholes));
            }
        }
        let mut floats = Vec::with_capacity(count);
        for cell in cells() {
            floats.push(match cell {
                Some(Cell::Number(number)) => number,
                Some(Cell::Whole(whole)) => whole as f64,
                Some(Cell::Absent | Cell::Date(_)) => f64::NAN,
                None => return Err(format!("numbers of {} bytes are not read", self.size)),
            });
        }
        Ok(Data::Floats(floats))
    }
}

/// The memory that a file's arrays may still take.
#[derive(Debug)]
pub(super) struct Budget {
    most: usize,
    left: usize,
}

impl Budget {
    pub(super) fn of(file_bytes: usize) -> Self {
        let most = most_bytes(file_bytes);
        Self { most, left: most }
    }

    /// Returns the bytes that are left.
    pub(super) fn left(&self) -> usize {
        self.left
    }

    /// # Errors
    /// A sentence if fewer bytes are left.
    pub(super) fn take(&mut self, bytes: usize) -> Result<(), String> {
        let most = self.most;
        self.left = self.left.checked_sub(bytes).ok_or_else(|| format!("its arrays take more than {most} bytes"))?;
        Ok(())
    }

    /// Takes the bytes of decoded numbers.
    ///
    /// # Errors
    /// The error of [`Self::take`].
    pub(super) fn take_numbers(&mut self, count: usize) -> Result<(), String> {
        self.take(count.saturating_mul(size_of::<f64>()))
    }
}

/// An array of a file.
#[derive(Debug)]
pub(super) struct Array {
    /// Its name; empty if it has none.
    pub(super) name: String,
    pub(super) sides: Vec<usize>,
    /// The first index runs fastest.
    pub(super) by_columns: bool,
    pub(super) data: Data,
}

/// A column within an array.
#[derive(Debug)]
struct Place {
    data: Arc<Data>,
    first: usize,
    step: usize,
}

/// Arrays as one table.
#[derive(Debug)]
pub(in crate::recording) struct Arrays {
    names: Vec<String>,
    places: Vec<Place>,
    rows: usize,
    unnamed: bool,
    left_out: Vec<String>,
}

impl Arrays {
    /// Creates the table. `left_out`: names of what else is in the file.
    ///
    /// # Errors
    /// A sentence if no array can be a column.
    pub(super) fn of(arrays: Vec<Array>, mut left_out: Vec<String>) -> Result<Self, String> {
        let matrix = |array: &Array| {
            let sides: Vec<usize> = array.sides.iter().copied().filter(|side| *side != 1).collect();
            let whole =
                array.sides.iter().try_fold(1_usize, |all, side| all.checked_mul(*side)) == Some(array.data.len());
            match *sides {
                [rows] if whole => Some((rows, 1)),
                [rows, columns] if whole => Some((rows, columns)),
                _ => None,
            }
        };
        // The number of columns of each length: those whose names state something, and all.
        let mut lengths: BTreeMap<usize, (usize, usize)> = BTreeMap::new();
        for array in &arrays {
            let Some((one, other)) = matrix(array) else { continue };
            let (named, all) = lengths.entry(one.max(other)).or_default();
            *all += one.min(other);
            *named += if states(&array.name) { one.min(other) } else { 0 };
        }
        let longest =
            lengths.iter().filter(|(length, _)| **length > 1).max_by_key(|(length, columns)| (**columns, **length));
        let Some((rows, _)) = longest else {
            let names: Vec<String> = arrays.iter().map(|array| format!("{} {:?}", array.name, array.sides)).collect();
            return Err(format!("no array of it can be columns; it has {}", names.join(", ")));
        };
        let rows = *rows;
        let mut table = Self {
            names: Vec::new(),
            places: Vec::new(),
            rows,
            unnamed: arrays.iter().all(|array| array.name.is_empty()),
            left_out: Vec::new(),
        };
        for array in arrays {
            let shown = format!("{} {:?}", array.name, array.sides);
            let Some((one, other)) = matrix(&array) else {
                left_out.push(shown);
                continue;
            };
            let along_first = one == rows;
            let count = if along_first { other } else { one };
            if (!along_first && other != rows) || count > COLUMNS_MAX {
                left_out.push(shown);
                continue;
            }
            // Neighbours in the file are those of the last index, or of the first one.
            let neighbours = along_first == array.by_columns;
            let data = Arc::new(array.data);
            for column in 0..count {
                let (first, step) = if neighbours { (column * rows, 1) } else { (column, count) };
                table.names.push(match (array.name.as_str(), count) {
                    ("", _) => (column + 1).to_string(),
                    (name, 1) => name.to_owned(),
                    (name, _) => format!("{name}[{column}]"),
                });
                table.places.push(Place { data: Arc::clone(&data), first, step });
            }
        }
        table.left_out = left_out;
        Ok(table)
    }

    /// Creates a table of columns of equal length.
    pub(super) fn of_columns(columns: Vec<(String, Data)>, rows: usize, left_out: Vec<String>) -> Self {
        let (names, places) =
            columns.into_iter().map(|(name, data)| (name, Place { data: Arc::new(data), first: 0, step: 1 })).unzip();
        Self { names, places, rows, unnamed: false, left_out }
    }
}

/// Returns whether a name states a channel or a time, by itself or with an axis.
fn states(name: &str) -> bool {
    let is_stated = |name: &str| {
        known_column(name).is_some() || matches!(meaning(name), Some(Meaning::Value { .. } | Meaning::Time { .. }))
    };
    is_stated(name) || is_stated(&format!("{name}[0]"))
}

/// The rows of arrays.
pub(super) struct ArraysTable {
    arrays: Arc<Arrays>,
    row: usize,
}

impl ArraysTable {
    pub(super) fn new(arrays: Arc<Arrays>) -> Self {
        Self { arrays, row: 0 }
    }
}

impl Table for ArraysTable {
    fn names(&self) -> &[String] {
        &self.arrays.names
    }

    fn is_unnamed(&self) -> bool {
        self.arrays.unnamed
    }

    fn left_out(&self) -> Vec<String> {
        super::row::left_out("arrays", &self.arrays.left_out).into_iter().collect()
    }

    fn next_row(&mut self, cells: &mut Vec<Cell>) -> Result<Next, RecordingError> {
        if self.row == self.arrays.rows {
            return Ok(Next::End);
        }
        cells.clear();
        cells.extend(self.arrays.places.iter().map(|place| {
            let at = place.first + place.step * self.row;
            match place.data.as_ref() {
                Data::Floats(values) => values.get(at).map_or(Cell::Absent, |value| Cell::of(*value)),
                Data::Wholes(values) => values.get(at).map_or(Cell::Absent, |value| Cell::Whole(*value)),
            }
        }));
        self.row += 1;
        Ok(Next::Row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array(name: &str, sides: &[usize]) -> Array {
        let data = Data::Floats(vec![0.5; sides.iter().product()]);
        Array { name: name.to_owned(), sides: sides.to_vec(), by_columns: false, data }
    }

    #[test]
    fn arrays_that_state_channels_determine_the_rows_and_others_are_named() {
        let arrays = vec![array("spectrum", &[500, 60]), array("gyro_rad_s", &[90, 3]), array("time_s", &[90])];
        let table = Arrays::of(arrays, vec!["note".to_owned()]).unwrap();
        assert_eq!((table.rows, table.names.len()), (90, 4));
        assert_eq!(table.left_out, ["note", "spectrum [500, 60]"]);
    }

    #[test]
    fn integers_beyond_63_bits_are_floats_and_numbers_are_charged_before_they_are_decoded() {
        let kind = Kind { form: Form::Unsigned, size: 8, big_endian: false };
        let bytes: Vec<u8> = [7, u64::MAX].into_iter().flat_map(u64::to_le_bytes).collect();
        let found = kind.data(&bytes, &mut Budget::of(0)).unwrap();
        assert_eq!(found, Data::Floats(vec![7.0, u64::MAX as f64]));
        let mut budget = Budget { most: 100, left: 100 };
        let bytes = Kind { form: Form::Signed, size: 1, big_endian: false };
        assert!(bytes.data(&[0; 12], &mut budget).is_ok());
        assert!(bytes.data(&[0; 1], &mut budget).unwrap_err().contains("more than 100 bytes"));
    }
}
