//! Records: what a capture writes, in the order it happened. They carry samples from the reader to the store.

use super::device_clock::ClockEstimate;
use super::{ChannelSet, ConnectedSensor, Gap, Sample};
use crate::variants;
use serde::{Deserialize, Serialize};

/// What the times of a segment rest on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Timebase {
    /// The sensor's TimeStartup.
    #[default]
    Device,
    /// The sensor's sync counter in ASCII messages.
    SyncCounter,
    /// The host's arrival times at the told rate: ASCII messages carry no time.
    Arrival,
    /// The stamps of an imported recording.
    Stamps,
    /// The row number at a told rate: an imported recording without stamps.
    Rate,
}

/// The longest stretch without a gap, at one rate and one configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Number within the capture, from 1; column `segment_id`.
    pub number: u32,
    /// Counts the stretches of one run of the sensor's clock, from 1: a reset begins a new epoch.
    pub epoch: u32,
    /// `seq` of its first sample.
    pub first_seq: u64,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// The timebase of its times.
    pub timebase: Timebase,
    /// Channels its samples carry.
    pub channels: ChannelSet,
    /// Device time of its first sample.
    pub first_device_time_ns: Option<u64>,
    /// Host UTC of its first sample.
    pub first_utc_ns: i64,
    /// The boot of the host that the monotonic times of its samples belong to, if known.
    pub boot_id: Option<String>,
}

/// Why something that arrived did not become a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum DiscardCause {
    /// A frame whose checksum or CRC was wrong.
    Checksum,
    /// Bytes that belong to no frame (the count is in bytes).
    GarbageBytes,
    /// A frame whose checksum was right and whose fields were not numbers.
    Malformed,
    /// A frame with a device time that was already there.
    Duplicate,
    /// A frame that came after a later one: its place is counted as missing already.
    OutOfOrder,
    /// A valid measurement of another type than the one configured.
    UnexpectedFormat,
    /// The queue to the disk was full.
    StorageBackpressure,
    /// A frame that came after the capture's planned end.
    AfterEnd,
    /// A frame that came while the sensor was being found out or configured: not yet part of the stream.
    Probing,
}

impl DiscardCause {
    /// All causes.
    pub const ALL: [Self; 9] = variants();
    /// The name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
    /// Whether the discarded data is a valid measurement, one of those that `received` counts; the other causes are of
    /// bytes that never became one.
    pub fn is_frame(self) -> bool {
        !matches!(self, Self::Checksum | Self::GarbageBytes | Self::Malformed)
    }
    /// The cause with that name.
    pub fn from_name(name: &str) -> Option<Self> {
        name.parse().ok()
    }
}

/// Kinds of events that a capture keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[expect(missing_docs, reason = "the names are the description")]
pub enum EventKind {
    CaptureStarted,
    CaptureEnded,
    SensorFound,
    SensorLost,
    SensorReset,
    SensorError,
    Configured,
    Reconfigured,
    ClockStep,
    Rejected,
    Warning,
    DaemonStarted,
    DaemonStopped,
}

impl EventKind {
    /// The name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// A notable event that is neither sample nor gap.
#[derive(Debug, Clone, PartialEq)]
pub struct EventRecord {
    /// The time, UTC ns.
    pub utc_ns: i64,
    /// The kind of event.
    pub kind: EventKind,
    /// One sentence for the user.
    pub message: String,
    /// Details for a program (a JSON object), if there are any.
    pub detail: Option<serde_json::Value>,
}

/// How a capture came to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CaptureEnd {
    /// It has all that its duration asked for.
    Complete,
    /// Somebody stopped it.
    Stopped,
}

/// One entry of a capture's record.
#[derive(Debug, Clone, PartialEq)]
pub enum Record {
    /// A new segment; its samples follow.
    Segment(Segment),
    /// A sample of the segment opened last; `seq` counts the capture's samples from 0 without holes.
    Sample {
        /// Position among the capture's samples.
        seq: u64,
        /// Its segment's number.
        segment: u32,
        /// The values.
        sample: Sample,
    },
    /// Missing samples.
    Gap(Gap),
    /// An event.
    Event(EventRecord),
    /// Data arrived that did not become a sample.
    Discarded {
        /// The cause.
        cause: DiscardCause,
        /// The number of frames (bytes for [`DiscardCause::GarbageBytes`]).
        count: u64,
    },
    /// The sensor's clock compared with the host's in this epoch, as estimated now; the latest estimate is valid.
    DeviceClock {
        /// One run of the sensor's clock.
        epoch: u32,
        /// The estimate.
        estimate: ClockEstimate,
    },
    /// The host's civil time had not been set and was set by this much: times of this capture before `before_utc_ns`
    /// are corrected.
    UtcSet {
        /// The amount, ns.
        by_ns: i64,
        /// Times before this are of the clock as it was, UTC ns.
        before_utc_ns: i64,
        /// The present boot of the host: the times of an earlier one are off by another amount. `None`: not known.
        boot_id: Option<String>,
        /// Samples before this were taken before that clock was set back.
        since_seq: Option<u64>,
    },
    /// The sensor and its registers as read when (re)connected; stored with the capture.
    Configuration(Box<ConnectedSensor>),
    /// The end; nothing of this capture follows except late discards.
    Ended {
        /// The kind of end.
        how: CaptureEnd,
        /// The time, UTC ns.
        utc_ns: i64,
    },
}
