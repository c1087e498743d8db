//! The status snapshot: published by the daemon through a watch channel, read by the HTTP interface without ever
//! touching the disk (docs/formats.md).

use super::notify::NotifyStatus;
use imu_core::sample::device_clock::ClockEstimate;
use imu_core::sample::{DiscardCause, Timebase};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What the connection to the sensor is doing (docs/formats.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SensorState {
    /// No port to open.
    #[default]
    Absent,
    /// A port is being opened.
    Opening,
    /// Baud rate, identity and registers are being found out, the output is being configured.
    Probing,
    /// Samples arrive.
    Streaming,
    /// The port is open, nothing arrives.
    Stalled,
    /// Bytes arrive, none of them forms a frame.
    NoValidFrames,
    /// Valid frames of another kind than configured arrive.
    UnexpectedFormat,
    /// Somebody else has the port.
    PortBusy,
    /// The port may not be opened by this user.
    NoPermission,
    /// The sensor has another serial number than the capture's.
    WrongUnit,
    /// Waiting before the next try.
    Backoff,
}

impl SensorState {
    /// All states and their names in JSON.
    pub(super) const NAMES: [(Self, &str); 11] = [
        (Self::Absent, "absent"),
        (Self::Opening, "opening"),
        (Self::Probing, "probing"),
        (Self::Streaming, "streaming"),
        (Self::Stalled, "stalled"),
        (Self::NoValidFrames, "no_valid_frames"),
        (Self::UnexpectedFormat, "unexpected_format"),
        (Self::PortBusy, "port_busy"),
        (Self::NoPermission, "no_permission"),
        (Self::WrongUnit, "wrong_unit"),
        (Self::Backoff, "backoff"),
    ];

    /// The name in JSON.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(state, _)| *state == self).map_or("", |(_, name)| name)
    }
}

/// The sensor as the daemon sees it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SensorStatus {
    /// What the connection is doing.
    pub state: SensorState,
    /// A sentence for a person: why, and what to do, where the state is not `streaming`.
    pub hint: Option<String>,
    /// The port in use or last used.
    pub port: Option<String>,
    /// The device that `port` stands for: another name where `port` is a link, such as those of `/dev/serial/by-id`.
    pub port_target: Option<String>,
    /// Baud rate in use.
    pub baud: Option<u32>,
    /// Register 1.
    pub model: Option<String>,
    /// Register 3.
    pub serial_number: Option<String>,
    /// Register 4.
    pub firmware: Option<String>,
    /// Output rate in Hz.
    pub rate_hz: Option<f64>,
    /// What arrives: `binary 01,0609`, `VNYMR`…
    pub output: Option<String>,
    /// What the samples' times rest on, and so how exactly losses are counted.
    pub timebase: Option<Timebase>,
    /// The sensor's clock against the host's; null before a few seconds of it were seen, and without device time.
    pub clock: Option<ClockEstimate>,
}

/// Where every valid measurement is that a running capture has received: one consistent instant of the reader's side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// The capture.
    pub capture_id: i64,
    /// Measurements received, counted where they come in.
    pub received: u64,
    /// Samples that were written down for the store, those of earlier runs of the daemon included.
    pub samples: u64,
    /// Samples that are held until it is clear whether some are missing before them.
    pub held: u64,
    /// Samples that earlier runs of the daemon committed.
    pub base: u64,
    /// Measurements that did not become a sample, by cause, in the order of [`DiscardCause::ALL`].
    pub dropped: [u64; DiscardCause::ALL.len()],
}

/// The capture that runs or waits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CaptureStatus {
    /// Its id.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// `waiting` or `capturing`.
    pub state: String,
    /// Sample time it holds, received and missing, s.
    pub elapsed_s: f64,
    /// Sample time still to come, s.
    pub remaining_s: f64,
    /// Samples received.
    pub samples: u64,
    /// Samples missing.
    pub missing: u64,
    /// Gaps.
    pub gaps: u64,
    /// Valid measurements received: `committed` + `in_flight` + `discarded`, at every instant.
    pub received: u64,
    /// Samples that a power cut now would not take (committed to disk).
    pub committed: u64,
    /// Samples that are held or wait for their commit.
    pub in_flight: i64,
    /// Valid measurements that did not become a sample, by cause.
    pub discarded: BTreeMap<String, u64>,
    /// How long ago the last sample arrived, s; null before the first.
    pub last_sample_age_s: Option<f64>,
    /// When a gap is open: since when, RFC 3339.
    pub gap_open_since: Option<String>,
}

/// What the store is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StorageState {
    /// Commits succeed.
    #[default]
    Ok,
    /// Commits take longer than the queue likes.
    Slow,
    /// The writer has stood still for three seconds: in a commit that does not end, or altogether.
    Degraded,
    /// The disk is full.
    StorageFull,
    /// The file system is read-only.
    StorageReadonly,
    /// Another process holds the database.
    StorageLocked,
    /// The disk reports errors.
    StorageError,
    /// The database's file was deleted or replaced.
    StorageLost,
}

/// The store as the daemon sees it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StorageStatus {
    /// How it is.
    pub state: StorageState,
    /// Path of the database.
    pub database: String,
    /// Size of the database file in bytes.
    pub database_bytes: u64,
    /// Size of the write-ahead log in bytes.
    pub wal_bytes: u64,
    /// Free space of its file system in bytes.
    pub free_bytes: u64,
    /// How long the free space lasts at the present rate, s; null where nothing is written.
    pub time_to_full_s: Option<f64>,
    /// Age of the last commit in real seconds; null before the first.
    pub last_commit_age_s: Option<f64>,
    /// Duration of the last commit in real seconds.
    pub last_commit_s: Option<f64>,
    /// Samples waiting in the queue.
    pub queued: u64,
    /// For how long the oldest of them has waited, in real seconds in which the machine was awake; null while none waits.
    pub oldest_waiting_s: Option<f64>,
    /// Little space is left: less than a gigabyte, or than twelve hours at the present rate.
    pub low_space: bool,
    /// What deserves attention although data is taken: little space, a log that does not shrink.
    pub warning: Option<String>,
    /// The last error's text, where the state is not `ok`.
    pub error: Option<String>,
}

/// The background jobs in numbers.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JobsStatus {
    /// Waiting.
    pub queued: u64,
    /// Running.
    pub running: u64,
    /// Done since the daemon started.
    pub done: u64,
    /// Failed since the daemon started.
    pub failed: u64,
}

/// A capture that is going to be deleted to keep within the limits of `[storage]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PlannedDeletion {
    /// Its id.
    pub capture: i64,
    /// Its name.
    pub name: String,
    /// What its samples take in the database, bytes.
    pub bytes: u64,
    /// `age` or `size`: which limit it exceeds.
    pub reason: String,
    /// Not before this, RFC 3339.
    pub delete_at: String,
}

/// What becomes of old captures.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RetentionStatus {
    /// Captures that are going to be deleted, the next one first; at most 100 of them.
    pub planned: Vec<PlannedDeletion>,
    /// How many there are.
    pub planned_total: u64,
    /// Captures deleted by age or size since the daemon started.
    pub deleted: u64,
    /// Why the clock cannot tell the age of captures; null where it can. Until then only `keep-mib` holds.
    #[serde(default)]
    pub distrust: Option<ClockDistrust>,
}

/// Why no capture is deleted for its age.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ClockDistrust {
    /// `unset`, `behind` or `far-ahead`.
    pub reason: String,
    /// What the clock shows, what is wrong with that, and what to do, for a person.
    pub message: String,
}

/// Which night is recorded next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ScheduleStatus {
    /// The local time of day at which a night begins, `22:00`.
    pub at: String,
    /// When the next night begins, RFC 3339; when the present one did, while it waits.
    pub next_start: String,
    /// The name of its capture.
    pub name: String,
    /// Sample time that it will hold, s.
    pub duration_s: f64,
    /// Why a night whose time has come has not begun, for a person; null where none waits.
    pub waits: Option<String>,
}

/// Everything that `GET /v1/status` says, but for version and uptime.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Status {
    /// The sensor.
    pub sensor: SensorStatus,
    /// The capture that runs or waits.
    pub capture: Option<CaptureStatus>,
    /// The store.
    pub storage: StorageStatus,
    /// The jobs.
    pub jobs: JobsStatus,
    /// Old captures.
    #[serde(default)]
    pub retention: RetentionStatus,
    /// The next night; null without a schedule.
    #[serde(default)]
    pub schedule: Option<ScheduleStatus>,
    /// Notifications.
    #[serde(default)]
    pub notify: NotifyStatus,
}
