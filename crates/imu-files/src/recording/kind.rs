//! The kinds of recordings, with the words for them in messages. Pure.

/// The kind of a recording. A further format needs a kind here, a file that implements its [`Rows`](super::rows::Rows),
/// and a `Source`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A table with a header line (docs/formats.md).
    Csv,
    /// Raw `$VN…` lines.
    VnText,
    /// Raw bytes of a VN-100 with binary frames.
    RawBytes,
    /// A ROS 1 bag, format 2.0.
    Bag,
    /// A ROS 2 bag in SQLite.
    Db3,
    /// An MCAP file.
    Mcap,
    /// A Parquet file.
    Parquet,
    /// A NumPy array.
    Npy,
    /// An archive of NumPy arrays.
    Npz,
    /// A MATLAB file of format 5.
    Mat,
    /// An HDF5 file, MATLAB's version 7.3 among them.
    Hdf5,
    /// A log of PX4.
    Ulog,
    /// A log of ArduPilot.
    Dataflash,
}

impl Kind {
    /// Returns the name of one of its entries.
    pub fn entry(self) -> &'static str {
        match self {
            Self::Csv | Self::VnText => "line",
            Self::RawBytes => "byte",
            Self::Bag | Self::Db3 | Self::Mcap | Self::Ulog | Self::Dataflash => "message",
            Self::Parquet | Self::Npy | Self::Npz | Self::Mat | Self::Hdf5 => "row",
        }
    }

    /// Returns the name of a recording without columns; `None` for a kind that has columns.
    pub(super) fn without_columns(self) -> Option<&'static str> {
        match self {
            Self::Csv
            | Self::Parquet
            | Self::Npy
            | Self::Npz
            | Self::Mat
            | Self::Hdf5
            | Self::Ulog
            | Self::Dataflash => None,
            Self::VnText => Some("a file of raw `$VN…` lines"),
            Self::RawBytes => Some("a file of a VN-100's raw bytes"),
            // Fields of messages are named by their dotted paths.
            Self::Bag | Self::Db3 | Self::Mcap => None,
        }
    }
}
