//! The known facts about a recording as a whole.

use super::choice::StampChoice;
use super::findings::Findings;
use super::grid::StampGrid;
use super::kind::Kind;
use super::rows::{Decimals, Rejected};
use imu_core::sample::{Channel, ChannelSet, DiscardCause, Timebase};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The source of a recording's times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stamps {
    /// There are no stamps: the row number at a given or assumed rate.
    None,
    /// Seconds in a column (or before each raw line), from any origin.
    Relative,
    /// Seconds since 1970 in a column (or before each raw line).
    Unix,
}

/// A column whose unit differs from the channel's.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Conversion {
    /// The channel.
    pub channel: Channel,
    /// The column's name in the file.
    pub column: String,
    /// The unit in the file.
    pub original_unit: &'static str,
    /// Value in the channel's unit = factor × value in the file.
    pub factor: f64,
}

/// The result of a first pass over the whole file.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingInfo {
    /// The file.
    pub file: PathBuf,
    /// Its kind.
    pub kind: Kind,
    /// Channels that occur in at least one sample.
    pub channels: ChannelSet,
    /// Decimals of the text, in the file's units.
    pub decimals: Decimals,
    /// Columns in other units.
    pub conversions: Vec<Conversion>,
    /// Columns that belong to no channel and are ignored. For raw lines: the text before `$VN` that is no stamp.
    pub ignored_columns: Vec<String>,
    /// Columns that are used although their names say that they are uncompensated, raw or without gravity.
    pub second_columns: Vec<String>,
    /// The source of the times.
    pub stamps: Stamps,
    /// The selected stamps, if there are any.
    pub stamp_choice: Option<StampChoice>,
    /// The findings.
    pub findings: Findings,
    /// Samples per second: from the grid of the stamps, given, or assumed.
    pub rate_hz: f64,
    /// Whether the rate was neither in the file nor given.
    pub rate_assumed: bool,
    /// The rate in a comment of the file that was not used because the file has stamps.
    pub unused_rate_hz: Option<f64>,
    /// The rate of the stamps, Hz, if a given one overrides it.
    pub overridden_rate_hz: Option<f64>,
    /// The grid of the stamps; `None` without stamps.
    pub stamp_grid: Option<StampGrid>,
    /// UTC of the first sample, ns since 1970: its stamp, else the start that the caller gave.
    pub started_utc_ns: i64,
    /// Number of samples that the second pass will return.
    pub samples: u64,
    /// Number of lines that the second pass will reject, by cause (bytes for [`DiscardCause::GarbageBytes`]).
    pub rejected: BTreeMap<DiscardCause, u64>,
    /// The first rejected lines, at most [`super::REJECTED_KEPT`].
    pub first_rejected: Vec<Rejected>,
    /// First stamp in ns from the file's own origin; 0 without stamps.
    pub first_stamp_ns: i64,
}

impl RecordingInfo {
    /// Returns the timebase of the segments.
    pub fn timebase(&self) -> Timebase {
        if self.stamps == Stamps::None { Timebase::Rate } else { Timebase::Stamps }
    }
}
