//! Parquet: the columns of numbers and times of a file, by groups of rows.
//!
//! Numbers of any width and times of Arrow are read; other columns (text, lists) are not decoded. Memory is
//! bounded by a group of rows. Codecs: none, Snappy, gzip, zstd, LZ4.

use super::super::error::{RecordingError, read_error, refused};
use super::super::input::{Input, broken};
use super::super::meter::Refusal;
use super::row::{Cell, Next, Table};
use arrow_array::cast::AsArray as _;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, TimestampMicrosecondType,
    TimestampMillisecondType, TimestampNanosecondType, TimestampSecondType, UInt8Type, UInt16Type, UInt32Type,
    UInt64Type,
};
use arrow_array::{Array as _, ArrayRef, RecordBatch};
use arrow_schema::{DataType, TimeUnit};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};
use parquet::file::reader::ChunkReader;

/// Rows that are decoded at a time.
const BATCH_ROWS: usize = 4096;

pub(super) struct ParquetTable {
    input: Input,
    names: Vec<String>,
    /// The columns that cannot be read, with their types.
    undecoded: Vec<String>,
    batches: ParquetRecordBatchReader,
    batch: Option<RecordBatch>,
    row: usize,
}

impl ParquetTable {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let damaged = |error: parquet::errors::ParquetError| {
            broken(input, format!("its Parquet is damaged or was cut (the table of contents is at its end): {error}"))
        };
        match input.plain_file()? {
            Some(file) => {
                let file_bytes = file.metadata().map_err(|source| read_error(input.path(), 0, source))?.len();
                Self::of(input, file_bytes, ParquetRecordBatchReaderBuilder::try_new(file).map_err(damaged)?)
            }
            None => {
                let bytes = bytes::Bytes::from(input.whole()?);
                let file_bytes = bytes.len() as u64;
                Self::of(input, file_bytes, ParquetRecordBatchReaderBuilder::try_new(bytes).map_err(damaged)?)
            }
        }
    }

    /// Reads the columns of numbers and times, unless the file states more rows than one of its size can have.
    fn of<T: ChunkReader + 'static>(
        input: &Input,
        file_bytes: u64,
        builder: ParquetRecordBatchReaderBuilder<T>,
    ) -> Result<Self, RecordingError> {
        let (mut names, mut read, mut undecoded) = (Vec::new(), Vec::new(), Vec::new());
        for (index, field) in builder.schema().fields().iter().enumerate() {
            if is_read(field.data_type()) {
                names.push(field.name().clone());
                read.push(index);
            } else {
                undecoded.push(format!("{} ({})", field.name(), field.data_type()));
            }
        }
        let groups = builder.metadata().row_groups().iter();
        let rows = groups.fold(0_u64, |rows, group| rows.saturating_add(u64::try_from(group.num_rows()).unwrap_or(0)));
        let allowed_bytes = input.allowed_bytes(file_bytes);
        if rows.saturating_mul(8 * read.len() as u64) > allowed_bytes {
            return Err(refused(input.path(), Refusal::Expands { file_bytes, allowed_bytes }));
        }
        let mask = ProjectionMask::roots(builder.parquet_schema(), read);
        let batches = builder.with_projection(mask).with_batch_size(BATCH_ROWS).build();
        let batches = batches.map_err(|error| broken(input, format!("its Parquet is damaged: {error}")))?;
        Ok(Self { input: input.clone(), names, undecoded, batches, batch: None, row: 0 })
    }
}

impl Table for ParquetTable {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn left_out(&self) -> Vec<String> {
        super::row::left_out("columns", &self.undecoded).into_iter().collect()
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
            if !self.input.keep_on().is_wanted() {
                return Err(refused(self.input.path(), Refusal::Unwanted));
            }
            match self.batches.next() {
                None => return Ok(Next::End),
                Some(Ok(batch)) => (self.batch, self.row) = (Some(batch), 0),
                Some(Err(error)) => return Err(broken(&self.input, format!("its Parquet is damaged: {error}"))),
            }
        }
    }
}

/// Returns whether [`cell`] reads a type.
fn is_read(kind: &DataType) -> bool {
    matches!(kind, DataType::Float64 | DataType::Float32 | DataType::Timestamp(..)) || kind.is_integer()
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
            let value = column.as_primitive::<UInt64Type>().value(row);
            i64::try_from(value).map_or_else(|_| Cell::of(value as f64), Cell::Whole)
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

#[cfg(test)]
mod tests {
    use super::super::super::meter::Expansion;
    use super::*;
    use arrow_array::{Float64Array, StringArray};
    use std::sync::Arc;

    #[test]
    fn columns_of_text_are_not_decoded_and_more_rows_than_the_file_can_have_are_refused() {
        let numbers: ArrayRef = Arc::new(Float64Array::from(vec![1.5; 10_000]));
        let notes: ArrayRef = Arc::new(StringArray::from(vec!["note"; 10_000]));
        let batch = RecordBatch::try_from_iter([("note", notes), ("gyro_x_rad_s", numbers)]).unwrap();
        let mut bytes = Vec::new();
        let mut writer = parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        let input = Input::memory("a.parquet", bytes);
        let mut table = ParquetTable::open(&input).unwrap();
        let mut cells = Vec::new();
        assert!(matches!(table.next_row(&mut cells), Ok(Next::Row)));
        assert_eq!((table.names(), cells), (&["gyro_x_rad_s".to_owned()][..], vec![Cell::Number(1.5)]));
        assert!(table.left_out()[0].contains("columns note (Utf8)"), "{:?}", table.left_out());
        let small = input.expanding(Expansion { free_bytes: 1000, ratio: 1, most_bytes: 1 << 40 });
        assert!(matches!(ParquetTable::open(&small), Err(RecordingError::Expands { .. })));
    }
}
