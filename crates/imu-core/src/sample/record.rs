//! Records: the contents of a capture in the order of events. They carry samples from the reader to the store.

use super::device_clock::ClockEstimate;
use super::{ChannelSet, ConnectedSensor, Gap, Sample};
use crate::variants;
use serde::{Deserialize, Serialize};

/// The source of a segment's times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Timebase {
    /// The sensor's clock (TimeStartup).
    #[default]
    Device,
    /// The sensor's sync counter in ASCII messages.
    SyncCounter,
    /// The host's arrival times at the stated rate, because ASCII messages carry no time.
    Arrival,
    /// The stamps of an imported recording.
    Stamps,
    /// The row number at a stated rate, for an imported recording without stamps.
    Rate,
}

/// The longest stretch without a gap, at one rate and one configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// Number within the capture, from 1; column `segment_id`.
    pub number: u32,
    /// Number of the run of the sensor's clock, from 1: a reset begins a new epoch.
    pub epoch: u32,
    /// `seq` of the segment's first sample.
    pub first_seq: u64,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// The timebase of its times.
    pub timebase: Timebase,
    /// Channels of the segment's samples.
    pub channels: ChannelSet,
    /// Device time of the first sample.
    pub first_device_time_ns: Option<u64>,
    /// Host UTC of the first sample.
    pub first_utc_ns: i64,
    /// The host's boot in which the monotonic times of the samples count, if known.
    pub boot_id: Option<String>,
}

/// Why received data did not become a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum DiscardCause {
    /// A frame with a wrong checksum or CRC.
    Checksum,
    /// Bytes that belong to no frame (the count is in bytes).
    GarbageBytes,
    /// A frame with a right checksum whose fields are not numbers.
    Malformed,
    /// A frame with a device time that exists already.
    Duplicate,
    /// A frame that came after a later one: its place is already counted as missing.
    OutOfOrder,
    /// A valid measurement of another type than the configured one.
    UnexpectedFormat,
    /// The queue to the disk was full.
    StorageBackpressure,
    /// A frame that came after the capture's planned end.
    AfterEnd,
    /// A frame that came while the sensor was being identified or configured: not yet part of the stream.
    Probing,
}

impl DiscardCause {
    /// All causes.
    pub const ALL: [Self; 9] = variants();
    /// Returns the name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
    /// Returns whether the discarded data is a valid measurement, which `received` counts. The other causes concern
    /// bytes that never became a measurement.
    pub fn is_frame(self) -> bool {
        !matches!(self, Self::Checksum | Self::GarbageBytes | Self::Malformed)
    }
    /// Returns the cause with that name.
    pub fn from_name(name: &str) -> Option<Self> {
        name.parse().ok()
    }
}

/// Kinds of events that are kept with a capture.
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
    Renamed,
}

impl EventKind {
    /// Returns the name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// A notable event that is neither sample nor gap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// How a capture ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CaptureEnd {
    /// The capture has all samples that its duration requires.
    Complete,
    /// A user stopped the capture.
    Stopped,
}

/// One entry of a capture's record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Record {
    /// A new segment; its samples follow.
    Segment(Segment),
    /// A sample of the segment opened last; `seq` counts the capture's samples from 0 without gaps.
    Sample {
        /// Position among the capture's samples.
        seq: u64,
        /// The number of the sample's segment.
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
        /// The run of the sensor's clock.
        epoch: u32,
        /// The estimate.
        estimate: ClockEstimate,
    },
    /// The host's civil time was set for the first time, by this much: times of this capture before `before_utc_ns` are
    /// corrected.
    UtcSet {
        /// The amount, ns.
        by_ns: i64,
        /// Times before this come from the unset clock, UTC ns.
        before_utc_ns: i64,
        /// The present boot of the host: times of an earlier boot are off by another amount. `None` if it is not known.
        boot_id: Option<String>,
        /// Samples before this were taken before the clock was set back.
        since_seq: Option<u64>,
    },
    /// The sensor and its registers as read on (re)connection; stored with the capture.
    #[serde(skip)]
    Configuration(Box<ConnectedSensor>),
    /// The end; only late discards of this capture follow.
    Ended {
        /// The kind of end.
        how: CaptureEnd,
        /// The time, UTC ns.
        utc_ns: i64,
    },
}
