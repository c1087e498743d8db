//! Samples for other programs: CSV and NDJSON, Parquet, MCAP; and the places of a data set's files.
//!
//! In: the facts about a capture ([`About`]), then its samples block by block ([`Rows`]), and at the end its missing
//! samples ([`Tally`]). Out: bytes to any [`Write`]. One format per file. Only what a format needs is kept in memory: a
//! row group of Parquet ([`ROW_GROUP_ROWS`]), a chunk of MCAP (1 MiB), and their indexes.
//!
//! Values are written as they were recorded, in the channel's unit. Only messages whose definition fixes another unit
//! (tesla, pascal) are converted, and the recorded values are written beside these. Absent values stay absent.

mod bucket;
mod cdr;
mod mcap;
mod parquet;
mod partition;
mod ros2;
mod tally;
mod text;

pub use self::bucket::Bucket;
pub use self::mcap::McapSink;
pub use self::parquet::{ParquetSink, ROW_GROUP_ROWS, is_parquet_of};
pub use self::partition::partition_path;
pub use self::tally::{GAPS_LISTED, Tally};
pub use self::text::{TextFormat, TextHead, TextSink, TextWriter};

use imu_core::sample::{Channel, SensorDescription};
use imu_core::variants;
use std::io::Write;

/// The facts about a capture as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// Its id; `None` for a recording that is in no database.
    pub id: Option<i64>,
    /// An identifier that distinguishes its database from others; empty for a recording that is in none.
    pub database: String,
    /// Its name, or the recording's file.
    pub name: String,
    /// What somebody wrote about it.
    pub note: Option<String>,
    /// UTC of the origin of times (its first sample), ns since 1970.
    pub origin_ns: i64,
    /// Output rate in Hz.
    pub rate_hz: Option<f64>,
    /// The columns, in this order.
    pub channels: Vec<Channel>,
    /// The description of the sensor.
    pub sensor: SensorDescription,
    /// The software that recorded it.
    pub software: String,
    /// Name and version of the writing program.
    pub writer: String,
}

impl About {
    /// Returns a file's description of the capture besides its samples, by name.
    fn metadata(&self, tally: &Tally) -> Vec<(&'static str, String)> {
        let mut pairs = vec![
            ("capture", self.name.clone()),
            ("database", self.database.clone()),
            ("started_at", rfc3339(self.origin_ns)),
            ("samples", tally.samples.to_string()),
            ("missing", tally.missing.to_string()),
            ("gap_count", tally.gaps.to_string()),
            ("gaps", tally.gaps_json()),
            ("sensor", self.sensor.to_string()),
            ("recorded_by", self.software.clone()),
            ("software", self.writer.clone()),
        ];
        pairs.extend(self.note.iter().map(|note| ("note", note.clone())));
        pairs.extend(self.rate_hz.map(|rate_hz| ("rate_hz", rate_hz.to_string())));
        pairs
    }
}

/// Consecutive samples, column by column; all columns have the same length.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// `seq` of the first row; row i has `first_seq + i`.
    pub first_seq: u64,
    /// The number of each row's segment.
    pub segment: &'a [u32],
    /// Times since the capture's first sample, ns.
    pub time_ns: &'a [i64],
    /// The sensor's own clock, ns, if it was sent.
    pub device_ns: &'a [Option<u64>],
    /// One column per channel of [`About::channels`]; NaN if a sample has no value.
    pub columns: &'a [Vec<f64>],
}

impl Rows<'_> {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.time_ns.len()
    }
    /// Returns whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.time_ns.is_empty()
    }
}

/// The reasons why samples could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The destination accepted no more.
    #[error(transparent)]
    Write(#[from] std::io::Error),
    /// Parquet's writer refused them.
    #[error("the samples cannot be written as Parquet: {0}")]
    Parquet(#[source] ::parquet::errors::ParquetError),
    /// MCAP's writer refused them.
    #[error("the samples cannot be written as MCAP: {0}")]
    Mcap(#[source] ::mcap::McapError),
    /// A time cannot be represented in a ROS stamp.
    #[error("sample {seq} was taken at {utc}, but a ROS stamp holds 1970 to 2038: export it as csv or parquet")]
    Stamp {
        /// The sample.
        seq: u64,
        /// The time of the sample, RFC 3339.
        utc: String,
    },
}

impl From<::parquet::errors::ParquetError> for ExportError {
    fn from(error: ::parquet::errors::ParquetError) -> Self {
        // A full disk is no fault of the format.
        match error {
            ::parquet::errors::ParquetError::External(inner) => match inner.downcast::<std::io::Error>() {
                Ok(error) => Self::Write(*error),
                Err(inner) => Self::Parquet(::parquet::errors::ParquetError::External(inner)),
            },
            error => Self::Parquet(error),
        }
    }
}

impl From<::mcap::McapError> for ExportError {
    fn from(error: ::mcap::McapError) -> Self {
        match error {
            ::mcap::McapError::Io(error) => Self::Write(error),
            error => Self::Mcap(error),
        }
    }
}

/// A file of samples being written.
pub trait Sink {
    /// Takes the next samples.
    ///
    /// # Errors
    /// [`ExportError`]; the data written until then is not a complete file.
    fn rows(&mut self, rows: Rows<'_>) -> Result<(), ExportError>;

    /// Writes the end of the file behind the samples; only then the file is complete.
    ///
    /// # Errors
    /// [`ExportError`].
    fn finish(self: Box<Self>, tally: &Tally) -> Result<(), ExportError>;
}

/// The formats of exported samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum SampleFormat {
    /// The documented CSV.
    Csv,
    /// A JSON document per line.
    Ndjson,
    /// Apache Parquet.
    Parquet,
    /// MCAP with ROS 2 messages.
    Mcap,
}

impl SampleFormat {
    /// All formats.
    pub const ALL: [Self; 4] = variants();

    /// Returns the name on the command line, and the extension of its files.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Returns the format of files with this extension, in any case of letters.
    pub fn of_ending(ending: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name().eq_ignore_ascii_case(ending))
    }

    /// Returns whether a terminal can show it.
    pub fn is_text(self) -> bool {
        matches!(self, Self::Csv | Self::Ndjson)
    }

    /// Begins a file. With `utc`, a text's `time_s` counts from 1970 instead of from the first sample.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn begin<'a, W: Write + Send + 'a>(
        self,
        to: W,
        about: &About,
        utc: bool,
    ) -> Result<Box<dyn Sink + 'a>, ExportError> {
        let origin_ns = if utc { about.origin_ns } else { 0 };
        Ok(match self {
            Self::Csv => Box::new(TextSink::begin(to, TextFormat::Csv, &about.channels, origin_ns)?),
            Self::Ndjson => Box::new(TextSink::begin(to, TextFormat::Ndjson, &about.channels, origin_ns)?),
            Self::Parquet => Box::new(ParquetSink::begin(to, about)?),
            Self::Mcap => Box::new(McapSink::begin(to, about)?),
        })
    }
}

/// Returns the time as RFC 3339 with nanoseconds.
fn rfc3339(utc_ns: i64) -> String {
    chrono::DateTime::from_timestamp_nanos(utc_ns).to_rfc3339_opts(chrono::SecondsFormat::Nanos, true)
}

#[cfg(test)]
mod tests;
