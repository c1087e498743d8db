//! Tables: recordings whose rows are numbers in named columns, in another form than text.
//!
//! A form is read as a [`Table`]: names, then rows of [`Cell`]s. [`Columns`] determines what each column holds, as for a CSV,
//! so that names, units and `--columns` mean the same everywhere. Parquet, ULog and dataflash are read row by row. The arrays
//! of NumPy, MATLAB and HDF5 lie in the file one behind the other and are held in memory ([`arrays::BYTES_MAX`]).

mod arrays;
mod blocks;
mod dataflash;
mod hdf5;
mod mat5;
mod npy;
mod parquet;
mod row;
mod ulog;

pub(super) use arrays::{Arrays, BYTES_MAX as ARRAYS_MAX};
pub(super) use dataflash::is_dataflash;
pub(super) use ulog::MAGIC as ULOG_MAGIC;

use super::columns::{Column, Columns};
use super::error::RecordingError;
use super::input::Input;
use super::kind::Kind;
use super::rows::{Decimals, Rejected, Row, Rows};
use super::stamps::{RowStamps, STAMPS_MAX};
use imu_core::sample::{DiscardCause, Sample};
use row::{Cell, Next, Table};

/// Rows that are looked at to determine the unit of times, or to propose columns.
const FIRST_ROWS: usize = 64;

/// A message of a log: its type and content, or what is wrong with the data.
type Message = Result<(u8, Vec<u8>), String>;

fn open(kind: Kind, input: &Input) -> Result<Box<dyn Table>, RecordingError> {
    let form: fn(Vec<u8>) -> Result<Arrays, String> = match kind {
        Kind::Parquet => return Ok(Box::new(parquet::ParquetTable::open(input)?)),
        Kind::Ulog => return Ok(Box::new(ulog::UlogTable::open(input)?)),
        Kind::Dataflash => return Ok(Box::new(dataflash::DataflashTable::open(input)?)),
        Kind::Npz => |bytes| npy::npz(&bytes),
        Kind::Mat => |bytes| mat5::read(&bytes),
        Kind::Hdf5 => hdf5::read,
        _ => |bytes| npy::npy(&bytes),
    };
    Ok(Box::new(arrays::ArraysTable::new(input.arrays(form)?)))
}

/// The rows of a table, one at a time.
pub(super) struct TableRows {
    table: Box<dyn Table>,
    pub(super) columns: Columns,
    cells: Vec<Cell>,
    number: u64,
    decimals: Decimals,
}

impl TableRows {
    pub(super) fn open(kind: Kind, input: &Input) -> Result<Self, RecordingError> {
        let table = open(kind, input)?;
        let first_rows = || {
            let mut rows = Vec::new();
            let Ok(mut table) = open(kind, input) else { return rows };
            let mut cells = Vec::new();
            while rows.len() < FIRST_ROWS {
                match table.next_row(&mut cells) {
                    Ok(Next::Row) => rows.push(cells.iter().map(|cell| cell.text()).collect()),
                    Ok(Next::Damaged(_)) => {}
                    _ => break,
                }
            }
            rows
        };
        let mut columns = Columns::find(table.names(), table.is_unnamed(), input.columns(), input.path(), &first_rows)?;
        columns.ignored.extend(table.left_out());
        Ok(Self { table, columns, cells: Vec::new(), number: 0, decimals: Decimals::default() })
    }

    /// Returns stamps and values of the current cells; `None` if a stamp or all values are missing.
    fn sample(&self) -> Option<(RowStamps, Sample)> {
        let mut sample = Sample::at(0, 0);
        let mut sums = [0_i64; STAMPS_MAX];
        for (cell, column) in self.cells.iter().zip(&self.columns.list) {
            match *column {
                Column::Ignored => {}
                Column::Stamp { places, slot } => {
                    let sum = sums.get_mut(slot)?;
                    *sum = sum.checked_add(cell.nanos(places)?)?;
                }
                Column::Value { channel, factor } => {
                    let value = match *cell {
                        Cell::Number(number) => number,
                        Cell::Whole(whole) => whole as f64,
                        Cell::Absent | Cell::Date(_) => continue,
                    };
                    // A factor of 1 must leave the value as it was written.
                    sample.set(channel, if factor == 1.0 { value } else { value * factor });
                }
            }
        }
        let mut stamps = RowStamps::default();
        sums.iter().take(self.columns.stamps.len()).for_each(|nanos| stamps.push(*nanos));
        (!sample.channels().is_empty()).then_some((stamps, sample))
    }
}

impl Rows for TableRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        let next = self.table.next_row(&mut self.cells)?;
        let rejected = |number, text: &str, stands| Rejected::new(number, DiscardCause::Malformed, text, stands);
        match next {
            Next::End => Ok(None),
            Next::Damaged(what) => Ok(Some(Row::Rejected(rejected(self.number, &what, false)))),
            Next::Row => {
                self.number += 1;
                let line = self.number;
                Ok(Some(match self.sample() {
                    Some((stamps, sample)) => Row::Sample { line, stamps, sample },
                    None => {
                        let cells: Vec<String> = self.cells.iter().map(|cell| cell.text()).collect();
                        Row::Rejected(rejected(line, &cells.join(" | "), true))
                    }
                }))
            }
        }
    }

    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}
