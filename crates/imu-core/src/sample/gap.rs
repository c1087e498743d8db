//! Gaps: intervals with missing samples, each with its cause.

use crate::variants;
use serde::{Deserialize, Serialize};

/// Why samples are missing (docs/formats.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum GapCause {
    /// The port disappeared.
    Unplugged,
    /// The sensor's clock started again.
    SensorReset,
    /// The port stayed, but the sensor sent nothing.
    Silent,
    /// A frame failed its checksum or was cut.
    Checksum,
    /// The sensor changed its output rate.
    RateChange,
    /// The sensor changed its output format.
    FormatChange,
    /// The host did not run for a while.
    HostStall,
    /// The host was suspended.
    HostSuspend,
    /// The daemon was not running.
    DaemonStopped,
    /// The disk was too slow and the queue was full.
    StorageBackpressure,
    /// The samples are missing in an imported recording.
    Source,
}

impl GapCause {
    /// All causes.
    pub const ALL: [Self; 11] = variants();
    /// Returns the name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// An interval with missing samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gap {
    /// `seq` of the first sample after the gap: the gap lies between `before_seq − 1` and `before_seq`.
    /// Equal to the number of samples received so far; a gap at a capture's end has no sample after it.
    pub before_seq: u64,
    /// The time of the last sample before the gap, UTC ns.
    pub from_utc_ns: i64,
    /// The time of the first sample after the gap (or of the capture's end), UTC ns.
    pub to_utc_ns: i64,
    /// The sensor's clock at both ends, if one epoch spans the gap.
    pub device_ns: Option<(u64, u64)>,
    /// The number of missing samples.
    pub missing: u64,
    /// Whether `missing` follows from the sensor's own clock; otherwise from the host's.
    pub missing_exact: bool,
    /// The cause.
    pub cause: GapCause,
}

impl Gap {
    /// Returns the time of the missing samples, ns: a period each, at the rate of the samples before the gap. Samples that were
    /// counted at a higher rate take no longer than the gap itself.
    pub fn sample_time_ns(&self, period_ns: f64) -> f64 {
        let lasts_ns = self.to_utc_ns.saturating_sub(self.from_utc_ns).max(0) as f64;
        (self.missing as f64 * period_ns).min(lasts_ns)
    }
}
