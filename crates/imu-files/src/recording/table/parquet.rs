//! Parquet: the columns of numbers and times of a file, by groups of rows.
//!
//! Numbers of any width and times of Arrow are read; other columns (text, lists) stay empty and are not used. Memory is
//! bounded by a group of rows. Codecs: none, Snappy, gzip, zstd, LZ4.

use super::super::error::RecordingError;
use super::super::input::Input;
use super::{Cell, Next, Table, broken};
use arrow_array::cast::AsArray as _;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, TimestampMicrosecondType,
    TimestampMillisecondType, TimestampNanosecondType, TimestampSecondType, UInt8Type, UInt16Type, UInt32Type,
    UInt64Type,
};
use arrow_array::{Array as _, ArrayRef, RecordBatch};
use arrow_schema::{DataType, TimeUnit};
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};

/// Rows that are decoded at a time.
const BATCH_ROWS: usize = 4096;

pub(super) struct ParquetTable {
    input: Input,
    names: Vec<String>,
    batches: ParquetRecordBatchReader,
    batch: Option<RecordBatch>,
    row: usize,
}

impl ParquetTable {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let damaged = |error: parquet::errors::ParquetError| {
            broken(input, format!("its Parquet is damaged or was cut (the table of contents is at its end): {error}"))
        };
        let builder = match input.plain_file()? {
            Some(file) => {
                ParquetRecordBatchReaderBuilder::try_new(file).map_err(damaged)?.with_batch_size(BATCH_ROWS).build()
            }
            None => {
                let bytes = bytes::Bytes::from(input.whole()?);
                ParquetRecordBatchReaderBuilder::try_new(bytes).map_err(damaged)?.with_batch_size(BATCH_ROWS).build()
            }
        };
        let batches = builder.map_err(damaged)?;
        let names = arrow_array::RecordBatchReader::schema(&batches)
            .fields()
            .iter()
            .map(|field| field.name().clone())
            .collect();
        Ok(Self { input: input.clone(), names, batches, batch: None, row: 0 })
    }
}

impl Table for ParquetTable {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn next_row(&mut self, cells: &mut Vec<Cell>) -> Result<Next, RecordingError> {
        loop {
            if let Some(batch) = &self.batch
                && self.row < batch.num_rows()
            {
                cells.clear();
                cells.extend(batch.columns().iter().map(|column| cell(column, self.row)));
                self.row += 1;
                return Ok(Next::Row);
            }
            match self.batches.next() {
                None => return Ok(Next::End),
                Some(Ok(batch)) => (self.batch, self.row) = (Some(batch), 0),
                Some(Err(error)) => return Err(broken(&self.input, format!("its Parquet is damaged: {error}"))),
            }
        }
    }
}

fn cell(column: &ArrayRef, row: usize) -> Cell {
    if column.is_null(row) {
        return Cell::Absent;
    }
    let date = |value: i64, to_nanos: i64| value.checked_mul(to_nanos).map_or(Cell::Absent, Cell::Date);
    match column.data_type() {
        DataType::Float64 => Cell::of(column.as_primitive::<Float64Type>().value(row)),
        DataType::Float32 => Cell::of(f64::from(column.as_primitive::<Float32Type>().value(row))),
        DataType::Int64 => Cell::Whole(column.as_primitive::<Int64Type>().value(row)),
        DataType::Int32 => Cell::Whole(i64::from(column.as_primitive::<Int32Type>().value(row))),
        DataType::Int16 => Cell::Whole(i64::from(column.as_primitive::<Int16Type>().value(row))),
        DataType::Int8 => Cell::Whole(i64::from(column.as_primitive::<Int8Type>().value(row))),
        DataType::UInt64 => {
            i64::try_from(column.as_primitive::<UInt64Type>().value(row)).map_or(Cell::Absent, Cell::Whole)
        }
        DataType::UInt32 => Cell::Whole(i64::from(column.as_primitive::<UInt32Type>().value(row))),
        DataType::UInt16 => Cell::Whole(i64::from(column.as_primitive::<UInt16Type>().value(row))),
        DataType::UInt8 => Cell::Whole(i64::from(column.as_primitive::<UInt8Type>().value(row))),
        DataType::Timestamp(TimeUnit::Nanosecond, _) => {
            date(column.as_primitive::<TimestampNanosecondType>().value(row), 1)
        }
        DataType::Timestamp(TimeUnit::Microsecond, _) => {
            date(column.as_primitive::<TimestampMicrosecondType>().value(row), 1_000)
        }
        DataType::Timestamp(TimeUnit::Millisecond, _) => {
            date(column.as_primitive::<TimestampMillisecondType>().value(row), 1_000_000)
        }
        DataType::Timestamp(TimeUnit::Second, _) => {
            date(column.as_primitive::<TimestampSecondType>().value(row), 1_000_000_000)
        }
        _ => Cell::Absent,
    }
}
