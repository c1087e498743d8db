//! Errors that concern a recording as a whole. A single bad line is an item, not an error.

use super::meter::Refusal;
use imu_core::sample::{Channel, ChannelError};
use imu_core::units::counted;
use std::path::{Path, PathBuf};

/// What can be read, for messages.
const READ: &str = "raw `$VN…` lines or raw bytes of a VN-100, a table with columns such as time_s, gyro_x_rad_s, accel_z_m_s2 \
                    (CSV, Parquet, .npy, .npz, .mat, HDF5), a ROS bag (.bag, .db3), an MCAP file, a ULog or an ArduPilot .BIN";

/// Characters of a name or a pair that an error shows.
const SHOWN_CHARS: usize = 80;

/// Returns the beginning of a text that the user or a file gives, which may be as long as a command line or a row.
pub(super) fn short(text: &str) -> String {
    cut(text, SHOWN_CHARS)
}

/// Returns the first `chars` characters of a text, with a mark if it has more.
pub(super) fn cut(text: &str, chars: usize) -> String {
    match text.char_indices().nth(chars) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// The reasons why a recording could not be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be opened.
    #[error("cannot open {}: {source}", file.display())]
    Open {
        /// The file.
        file: PathBuf,
        /// The error that the system reported.
        source: std::io::Error,
    },
    /// The file could not be read to its end.
    #[error("cannot read {} beyond line {line}: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The last line that was read.
        line: u64,
        /// The error that the system reported.
        source: std::io::Error,
    },
    /// The path is not a file.
    #[error("{} is {found}, but a recording is read several times: save it to a file and name that", file.display())]
    NoFile {
        /// The path.
        file: PathBuf,
        /// The kind of object found there.
        found: &'static str,
    },
    /// A folder that is no recording, or several.
    #[error(
        "{} is a folder with {found}; expected one .mcap or .db3 of a ROS 2 bag (of several, name one), or timestamps.txt and \
         data of KITTI's oxts",
        folder.display()
    )]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Files in it.
        found: String,
    },
    /// A column has raw counts, which no factor makes SI.
    #[error(
        "{}: the column `{column}` is in counts, which have no unit: calibrate it with `vn100d calibrate`, or convert it and state its \
         unit, such as --columns '{column}={channel}_…'",
        file.display()
    )]
    Counts {
        /// The file.
        file: PathBuf,
        /// The column.
        column: String,
        /// The channel.
        channel: Channel,
    },
    /// The recording is no longer wanted.
    #[error("reading {} was called off", file.display())]
    Unwanted {
        /// The file.
        file: PathBuf,
    },
    /// Few compressed bytes expand to too many.
    #[error(
        "{}: its first {file_bytes} compressed bytes become more than {allowed_bytes}, which no sensor's recording does: \
         decompress it yourself and look at it",
        file.display()
    )]
    Expands {
        /// The file.
        file: PathBuf,
        /// Bytes of the file that were read.
        file_bytes: u64,
        /// The number of bytes they may expand to.
        allowed_bytes: u64,
    },
    /// The compressed data ends too early: the recording was cut.
    #[error(
        "{} ends in the middle of its compressed data after line {line}: \
         decompress what is there (`zcat`, `bzcat`, `xzcat` or `zstdcat FILE > FILE.txt`) and read that",
        file.display()
    )]
    CutCompression {
        /// The file.
        file: PathBuf,
        /// The last line that was read.
        line: u64,
    },
    /// The file is empty.
    #[error("{} is empty: expected {READ}", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
    },
    /// The content is of no known kind.
    #[error(
        "{} is not a recording that can be read: line 1 begins with {found:?}; expected {READ}",
        file.display()
    )]
    Unrecognised {
        /// The file.
        file: PathBuf,
        /// The beginning of the content.
        found: String,
    },
    /// The content is of a known kind that this version does not read.
    #[error("{} is {found}, which this version does not read; expected {READ}", file.display())]
    NotReadYet {
        /// The file.
        file: PathBuf,
        /// The kind.
        found: &'static str,
    },
    /// Two columns of a CSV give the same channel.
    #[error(
        "{}: line 1: columns {first:?} and {second:?} both give {channel}; leave one of them out",
        file.display()
    )]
    DuplicateColumn {
        /// The file.
        file: PathBuf,
        /// The earlier column.
        first: String,
        /// The later one.
        second: String,
        /// The channel.
        channel: Channel,
    },
    /// Two columns of a CSV give the time.
    #[error("{}: line 1: columns {first:?} and {second:?} both give the time; leave one of them out", file.display())]
    DuplicateTime {
        /// The file.
        file: PathBuf,
        /// The earlier column.
        first: String,
        /// The later one.
        second: String,
    },
    /// The user's parts of a time make none.
    #[error("{}: a time takes one column of time_secs and one of time_nsecs, not {columns}", file.display())]
    Parts {
        /// The file.
        file: PathBuf,
        /// The columns that were given.
        columns: String,
    },
    /// A column that the user named does not exist.
    #[error(
        "{}: no column is {column}; its columns are: {found}. Name one of them, or its position from 1 as in '#3=gyro_x_dps'",
        file.display()
    )]
    NoColumn {
        /// The file.
        file: PathBuf,
        /// The column that was given.
        column: String,
        /// The file's columns.
        found: String,
    },
    /// A table whose columns name no channel with its unit.
    #[error(
        "{} looks like a table, but none of its columns names a channel with its unit (they are: {found}): {proposal}",
        file.display()
    )]
    ForeignColumns {
        /// The file.
        file: PathBuf,
        /// The file's columns.
        found: String,
        /// A guess at what they are, or how to name them.
        proposal: String,
    },
    /// A table that is no text cannot be read.
    #[error("cannot read {}: {what}", file.display())]
    Table {
        /// The file.
        file: PathBuf,
        /// What was found, and where.
        what: String,
    },
    /// Columns were given for a recording that has none.
    #[error("{} is {found}, which has no columns to map: leave --columns out", file.display())]
    ColumnsOfNoCsv {
        /// The file.
        file: PathBuf,
        /// The recording's kind.
        found: &'static str,
    },
    /// The recording has no times, and no rate was given.
    #[error(
        "{} has no stamps of a known unit: give its rate with --rate HZ, or name the column of times{}",
        file.display(),
        proposed.as_ref().map_or_else(
            || " with --columns 'NAME=time_s' (or _ms, _us, _ns)".to_owned(),
            |pair| format!(" and its unit, perhaps --columns '{pair}'")
        )
    )]
    NoRate {
        /// The file.
        file: PathBuf,
        /// The pair that would name a column of times.
        proposed: Option<String>,
    },
    /// The stamps do not determine a rate.
    #[error(
        "{}: its {} no two stamps of which the later is greater, so that no rate follows from them; take the stamps out and \
         give --rate HZ",
        file.display(),
        counted(*samples, "sample has", "samples have")
    )]
    NoStep {
        /// The file.
        file: PathBuf,
        /// Number of samples found.
        samples: u64,
    },
    /// The recording contains no sample.
    #[error("{} has no sample: {}, {rejected} of them rejected{first}", file.display(), counted(*lines, "line", "lines"))]
    NoSample {
        /// The file.
        file: PathBuf,
        /// Number of lines after the header.
        lines: u64,
        /// Number of rejected lines.
        rejected: u64,
        /// The first rejected line, its cause and text.
        first: String,
    },
    /// An SQLite database that is not a bag.
    #[error("{} is {found}; expected the tables `topics` and `messages` of a ROS 2 bag", file.display())]
    NoBag {
        /// The file.
        file: PathBuf,
        /// The content of the database.
        found: String,
    },
    /// An SQLite database that cannot be read.
    #[error("{} is an SQLite database that cannot be read: {reason}", file.display())]
    Database {
        /// The file.
        file: PathBuf,
        /// The error that SQLite reported.
        reason: String,
    },
    /// A bag without a topic that can be read.
    #[error("{} has no topic with IMU data or raw `$VN…` lines; it has {found}", file.display())]
    NoTopic {
        /// The file.
        file: PathBuf,
        /// The topics, with their types and the reasons why they are not read.
        found: String,
    },
    /// No sample is in the wanted part.
    #[error(
        "{} has no sample in the part that is wanted: it has {}, {length_s:.3} s",
        file.display(),
        counted(*samples, "sample", "samples")
    )]
    PartEmpty {
        /// The file.
        file: PathBuf,
        /// Number of its samples.
        samples: u64,
        /// The time that they take, s.
        length_s: f64,
    },
    /// The part is named by a time of day, which the recording does not tell.
    #[error("{} tells no time of day: give the part in seconds since its first sample", file.display())]
    PartTime {
        /// The file.
        file: PathBuf,
    },
    /// The part has a channel that the recording does not have.
    #[error("{}: {error}", file.display())]
    PartChannel {
        /// The file.
        file: PathBuf,
        /// The channel, and those that the recording has.
        error: ChannelError,
    },
    /// The given rate is invalid.
    #[error("a recording's rate must be a finite number above 0, not {found} Hz")]
    Rate {
        /// The given rate.
        found: f64,
    },
}

/// Adds the position to an error of reading.
pub(super) fn read_error(file: &Path, line: u64, source: std::io::Error) -> RecordingError {
    if let Some(refusal) = source.get_ref().and_then(|inner| inner.downcast_ref::<Refusal>()) {
        return refused(file, *refusal);
    }
    if source.kind() == std::io::ErrorKind::UnexpectedEof {
        return RecordingError::CutCompression { file: file.to_owned(), line };
    }
    RecordingError::Read { file: file.to_owned(), line, source }
}

/// Returns the error of a reading that was ended before the end of the file.
pub(super) fn refused(file: &Path, refusal: Refusal) -> RecordingError {
    match refusal {
        Refusal::Unwanted => RecordingError::Unwanted { file: file.to_owned() },
        Refusal::Expands { file_bytes, allowed_bytes } => {
            RecordingError::Expands { file: file.to_owned(), file_bytes, allowed_bytes }
        }
    }
}
