//! Arrays: named arrays of numbers as one table.
//!
//! The table has as many rows as most columns have: a vector of that length is a column, a matrix with one side of that
//! length has its other side as columns (`gyro[0]`, `gyro[1]`, …), whichever way it lies. Other arrays are left out. Pure.

use super::super::error::RecordingError;
use super::{Cell, Next, Table};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The largest file of arrays that is read into memory, bytes, and the most that its arrays may take.
pub(in crate::recording) const BYTES_MAX: usize = 1 << 30;
/// The ratio to which a file's arrays may expand, and the bytes that are allowed whatever its size: a length field or compressed
/// zeros must not determine how much memory a small file takes.
const EXPANSION: usize = 100;
const FREE_BYTES: usize = 64 << 20;

/// Returns the most bytes that the arrays of a file of this size may take.
pub(super) fn most_bytes(file_bytes: usize) -> usize {
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

    /// Reads all numbers.
    pub(super) fn data(self, bytes: &[u8]) -> Option<Data> {
        let cells = bytes.chunks_exact(self.size.max(1)).map(|chunk| self.number(chunk));
        Some(match self.form {
            Form::Float => Data::Floats(
                cells
                    .map(|cell| match cell {
                        Some(Cell::Number(number)) => Some(number),
                        Some(Cell::Absent) => Some(f64::NAN),
                        _ => None,
                    })
                    .collect::<Option<_>>()?,
            ),
            _ => Data::Wholes(
                cells
                    .map(|cell| if let Some(Cell::Whole(whole)) = cell { Some(whole) } else { None })
                    .collect::<Option<_>>()?,
            ),
        })
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
}

impl Arrays {
    /// Creates the table.
    ///
    /// # Errors
    /// A sentence if no array can be a column.
    pub(super) fn of(arrays: Vec<Array>) -> Result<Self, String> {
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
        let mut lengths: BTreeMap<usize, usize> = BTreeMap::new();
        for (one, other) in arrays.iter().filter_map(matrix) {
            *lengths.entry(one.max(other)).or_default() += one.min(other);
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
        };
        for array in arrays {
            let Some((one, other)) = matrix(&array) else { continue };
            let along_first = one == rows;
            let count = if along_first { other } else { one };
            if (!along_first && other != rows) || count > COLUMNS_MAX {
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
        Ok(table)
    }

    /// Creates a table of columns of equal length.
    pub(super) fn of_columns(columns: Vec<(String, Data)>, rows: usize) -> Self {
        let (names, places) =
            columns.into_iter().map(|(name, data)| (name, Place { data: Arc::new(data), first: 0, step: 1 })).unzip();
        Self { names, places, rows, unnamed: false }
    }
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
