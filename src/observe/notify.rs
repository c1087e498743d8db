//! Notifications as data: the events that can be reported, and the counts of deliveries.

use serde::{Deserialize, Serialize};

/// An event that can be reported; its name in the configuration, in JSON and in `VN100D_EVENT`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum NotifyEvent {
    /// A capture has its planned sample time.
    CaptureCompleted,
    /// Samples stopped arriving in a running capture.
    GapOpened,
    /// A gap is over; the number of missing samples and the cause are known.
    GapClosed,
    /// Space runs low, or the disk refuses data.
    StorageLow,
    /// There is enough space again, and the disk accepts data.
    StorageOk,
    /// A capture runs or waits and the sensor has been absent for `sensor-lost-after`.
    SensorLost,
    /// The lost sensor sends again.
    SensorBack,
    /// Captures will be deleted to stay within the limits of `[storage]`.
    DeletionPlanned,
    /// A night of `[schedule]` was not recorded, although the daemon ran.
    NightSkipped,
    /// A test of the notifications (`vn100d notify`).
    Test,
}

impl NotifyEvent {
    /// All events that can be selected: all but the test, which is always reported.
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

    /// Returns the name in the configuration, in JSON and in `VN100D_EVENT`.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// Numbers of notifications since the daemon started. A notification that goes to a command and to a URL counts twice.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NotifyStatus {
    /// Accepted by their receiver.
    pub sent: u64,
    /// Abandoned after the last attempt.
    pub failed: u64,
    /// Never tried, because the queue was full.
    pub dropped: u64,
    /// Waiting or being sent.
    pub queued: u64,
    /// Why the last attempt failed; null if it succeeded.
    pub error: Option<String>,
}
