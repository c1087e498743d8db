//! Samples as Parquet: one row per sample, units in Arrow's field metadata, the capture in the file's.
//!
//! Columns: `database` (which distinguishes it from others) and `capture` (its id there; both null for a recording that
//! is in none), `segment`, `seq`, `time_s` (since the capture's first sample), `utc`, `device_time_ns`, then the
//! channels named as in CSV (`gyro_x_rad_s`), null if a sample has no value. The file's metadata contains `capture`,
//! `started_at`, `rate_hz`, `samples`, `missing`, `gap_count`, `gaps` (the first [`GAPS_LISTED`](super::GAPS_LISTED) as
//! JSON), `sensor`, `recorded_by` and `software`.
//!
//! Sizes: a sensor rounds its values, so that channels have few distinct ones, which a dictionary holds in 10–17 bits
//! each. If there are too many, their bytes are split by place. Counters and times are stored as differences.

use super::{About, ExportError, Rows, Sink, Tally};
use ::parquet::arrow::ArrowWriter;
use ::parquet::basic::{Compression, Encoding, ZstdLevel};
use ::parquet::file::metadata::KeyValue;
use ::parquet::file::properties::{WriterProperties, WriterPropertiesBuilder};
use ::parquet::file::reader::{ChunkReader, FileReader as _, SerializedFileReader};
use ::parquet::schema::types::ColumnPath;
use arrow_array::{ArrayRef, Float64Array, Int32Array, Int64Array, RecordBatch, StringArray, TimestampNanosecondArray};
use arrow_schema::{DataType, Field, Schema, TimeUnit};
use std::collections::HashMap;
use std::io::Write;
use std::iter::repeat_n;
use std::sync::Arc;

/// Rows of a row group: 1.8 hours at 40 Hz, some 70 MB of fourteen channels while it is being made.
pub const ROW_GROUP_ROWS: usize = 262_144;

/// A Parquet file being written.
pub struct ParquetSink<W: Write + Send> {
    writer: ArrowWriter<W>,
    schema: Arc<Schema>,
    about: About,
}

impl<W: Write + Send> std::fmt::Debug for ParquetSink<W> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("ParquetSink").field("about", &self.about).finish_non_exhaustive()
    }
}

impl<W: Write + Send> ParquetSink<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn begin(to: W, about: &About) -> Result<Self, ExportError> {
        let schema = Arc::new(schema(about));
        let writer = ArrowWriter::try_new(to, schema.clone(), Some(properties(about)?))?;
        Ok(Self { writer, schema, about: about.clone() })
    }

    fn batch(&self, rows: Rows<'_>) -> Result<RecordBatch, ExportError> {
        let origin_ns = self.about.origin_ns;
        let utc = rows.time_ns.iter().map(|ns| origin_ns.saturating_add(*ns));
        let first_seq = rows.first_seq as i64;
        let database = Some(self.about.database.as_str()).filter(|database| !database.is_empty());
        let mut columns: Vec<ArrayRef> = vec![
            Arc::new(StringArray::from_iter(repeat_n(database, rows.len()))),
            match self.about.id {
                Some(id) => Arc::new(Int64Array::from_value(id, rows.len())),
                None => Arc::new(Int64Array::new_null(rows.len())),
            },
            Arc::new(rows.segment.iter().map(|segment| *segment as i32).collect::<Int32Array>()),
            Arc::new(Int64Array::from_iter_values((first_seq..).take(rows.len()))),
            Arc::new(Float64Array::from_iter_values(rows.time_ns.iter().map(|ns| *ns as f64 / 1e9))),
            Arc::new(TimestampNanosecondArray::from_iter_values(utc).with_timezone("UTC")),
            Arc::new(rows.device_ns.iter().map(|ns| ns.map(|ns| ns as i64)).collect::<Int64Array>()),
        ];
        for column in rows.columns {
            columns.push(if column.iter().all(|value| value.is_finite()) {
                Arc::new(Float64Array::from_iter_values(column.iter().copied()))
            } else {
                Arc::new(column.iter().map(|value| value.is_finite().then_some(*value)).collect::<Float64Array>())
            });
        }
        RecordBatch::try_new(self.schema.clone(), columns).map_err(|error| ExportError::Parquet(error.into()))
    }
}

impl<W: Write + Send> Sink for ParquetSink<W> {
    fn rows(&mut self, rows: Rows<'_>) -> Result<(), ExportError> {
        Ok(self.writer.write(&self.batch(rows)?)?)
    }

    fn finish(mut self: Box<Self>, tally: &Tally) -> Result<(), ExportError> {
        for (key, value) in self.about.metadata(tally) {
            self.writer.append_key_value_metadata(KeyValue::new(key.to_owned(), value));
        }
        self.writer.finish()?;
        Ok(self.writer.inner_mut().flush()?)
    }
}

/// Returns whether a file is a complete Parquet file of this capture: of its database, with the same first sample. Its
/// name and its id are not compared. `file` is an open file, or bytes.
pub fn is_parquet_of(about: &About, file: impl ChunkReader + 'static) -> bool {
    let Ok(reader) = SerializedFileReader::new(file) else { return false };
    let pairs = reader.metadata().file_metadata().key_value_metadata().map(Vec::as_slice).unwrap_or_default();
    let has = |key: &str, value: &str| pairs.iter().any(|pair| pair.key == key && pair.value.as_deref() == Some(value));
    has("database", &about.database) && has("started_at", &super::rfc3339(about.origin_ns))
}

fn schema(about: &About) -> Schema {
    let with_unit = |name: &str, kind, nullable, unit: &str| {
        Field::new(name, kind, nullable).with_metadata(HashMap::from([("unit".to_owned(), unit.to_owned())]))
    };
    let mut fields = vec![
        Field::new("database", DataType::Utf8, true),
        Field::new("capture", DataType::Int64, true),
        Field::new("segment", DataType::Int32, false),
        Field::new("seq", DataType::Int64, false),
        with_unit("time_s", DataType::Float64, false, "s"),
        Field::new("utc", DataType::Timestamp(TimeUnit::Nanosecond, Some("UTC".into())), false),
        with_unit("device_time_ns", DataType::Int64, true, "ns"),
    ];
    let channels = about.channels.iter();
    fields.extend(channels.map(|channel| with_unit(&channel.column_name(), DataType::Float64, true, channel.unit())));
    Schema::new(fields)
}

fn properties(about: &About) -> Result<WriterProperties, ExportError> {
    let encoded = |builder: WriterPropertiesBuilder, name: &str, encoding, dictionary| {
        let column = ColumnPath::from(name);
        builder.set_column_encoding(column.clone(), encoding).set_column_dictionary_enabled(column, dictionary)
    };
    let mut builder = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(ZSTD_LEVEL)?))
        .set_max_row_group_row_count(Some(ROW_GROUP_ROWS))
        .set_created_by(about.writer.clone());
    builder = encoded(builder, "time_s", Encoding::BYTE_STREAM_SPLIT, false);
    for name in ["seq", "utc", "device_time_ns"] {
        builder = encoded(builder, name, Encoding::DELTA_BINARY_PACKED, false);
    }
    for channel in &about.channels {
        // The encoding is used if the dictionary has grown too large.
        builder = encoded(builder, &channel.column_name(), Encoding::BYTE_STREAM_SPLIT, true);
    }
    Ok(builder.build())
}

/// The level at which a fifth more time is not bought by a tenth less size.
const ZSTD_LEVEL: i32 = 1;
