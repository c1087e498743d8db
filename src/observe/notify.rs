//! Notifications in data: what somebody may want to be told of, and how the telling goes.

use serde::{Deserialize, Serialize};

/// What somebody may want to be told of; the name in the configuration, in JSON and in `VN100D_EVENT`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum NotifyEvent {
    /// A capture has all the sample time it was asked for.
    CaptureCompleted,
    /// Samples have stopped coming in a running capture.
    GapOpened,
    /// A gap is over: how many samples are missing, and why.
    GapClosed,
    /// Space runs low, or the disk does not take data.
    StorageLow,
    /// There is space again and the disk takes data.
    StorageOk,
    /// A capture runs or waits and the sensor has been away for `sensor-lost-after`.
    SensorLost,
    /// The sensor that was lost sends again.
    SensorBack,
    /// Captures are going to be deleted to keep within `[storage]`'s limits.
    DeletionPlanned,
    /// A night of `[schedule]` was not recorded, although the daemon ran.
    NightSkipped,
    /// Somebody tries the notifications out (`vn100d notify`).
    Test,
}

impl NotifyEvent {
    /// All that can be selected: all but the test, which is always told.
    pub const ALL: [Self; 9] = [
        Self::CaptureCompleted,
        Self::GapOpened,
        Self::GapClosed,
        Self::StorageLow,
        Self::StorageOk,
        Self::SensorLost,
        Self::SensorBack,
        Self::DeletionPlanned,
        Self::NightSkipped,
    ];

    /// The name in the configuration, in JSON and in `VN100D_EVENT`.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// Notifications in numbers, since the daemon started. One that goes to a command and a URL counts twice.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NotifyStatus {
    /// Taken by their receiver.
    pub sent: u64,
    /// Given up after the last attempt.
    pub failed: u64,
    /// Not even tried: the queue was full.
    pub dropped: u64,
    /// Waiting or being sent.
    pub queued: u64,
    /// Why the last attempt failed, where the last one did.
    pub error: Option<String>,
}
