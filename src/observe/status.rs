//! The status snapshot: published by the daemon through a watch channel, and read by the HTTP interface without access
//! to the disk (docs/formats.md).

use super::notify::NotifyStatus;
use imu_core::sample::device_clock::ClockEstimate;
use imu_core::sample::{DiscardCause, Timebase};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The state of the connection to the sensor (docs/formats.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum SensorState {
    /// There is no port to open.
    #[default]
    Absent,
    /// A port is being opened.
    Opening,
    /// Baud rate, identity and registers are being determined, or the output is being configured.
    Probing,
    /// Samples arrive.
    Streaming,
    /// The port is open, but nothing arrives.
    Stalled,
    /// Bytes arrive, but none form a frame.
    NoValidFrames,
    /// Valid frames arrive, but not of the configured kind.
    UnexpectedFormat,
    /// Another process holds the port.
    PortBusy,
    /// The user may not open the port.
    NoPermission,
    /// The sensor's serial number differs from the capture's.
    WrongUnit,
    /// The daemon waits before the next attempt.
    Backoff,
}

impl SensorState {
    /// Returns the name of the state, as documents write it.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// The state of the sensor.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SensorStatus {
    /// The state of the connection.
    pub state: SensorState,
    /// The problem and its remedy in one sentence, if the state is not `streaming`.
    pub hint: Option<String>,
    /// The port in use or last used.
    pub port: Option<String>,
    /// The device of `port`: another name if `port` is a link, such as those of `/dev/serial/by-id`.
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
    /// The received output: `binary 01,0609`, `VNYMR`…
    pub output: Option<String>,
    /// The source of the samples' times, which determines how exactly losses are counted.
    pub timebase: Option<Timebase>,
    /// The sensor's clock against the host's; null before a few seconds were observed, and without device time.
    pub clock: Option<ClockEstimate>,
}

/// The state of every valid measurement that a running capture has received, at one instant of the reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// The capture.
    pub capture_id: i64,
    /// Measurements received, counted at their arrival.
    pub received: u64,
    /// Samples passed to the store, including those of earlier runs of the daemon.
    pub samples: u64,
    /// Samples held until it is known whether samples are missing before them.
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
    /// Sample time so far, received and missing, s.
    pub elapsed_s: f64,
    /// Remaining sample time, s.
    pub remaining_s: f64,
    /// Number of samples received.
    pub samples: u64,
    /// Number of samples missing.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Number of valid measurements received: `committed` + `in_flight` + `discarded`, at every instant.
    pub received: u64,
    /// Number of samples committed to disk: they survive a power loss.
    pub committed: u64,
    /// Number of samples that are held or wait for their commit.
    pub in_flight: i64,
    /// Number of valid measurements that did not become samples, by cause.
    pub discarded: BTreeMap<String, u64>,
    /// The time since the last sample arrived, s; null before the first.
    pub last_sample_age_s: Option<f64>,
    /// The time since which a gap has been open, RFC 3339.
    pub gap_open_since: Option<String>,
}

/// The state of the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum StorageState {
    /// Commits succeed.
    #[default]
    Ok,
    /// Commits take too long.
    Slow,
    /// The writer has been stalled for three seconds, in a commit or otherwise.
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

impl StorageState {
    /// Returns the name of the state, as documents write it.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// The state of the store, with its figures.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StorageStatus {
    /// The state.
    pub state: StorageState,
    /// Path of the database.
    pub database: String,
    /// Size of the database file in bytes.
    pub database_bytes: u64,
    /// Size of the write-ahead log in bytes.
    pub wal_bytes: u64,
    /// Free space of its file system in bytes.
    pub free_bytes: u64,
    /// The time until the free space is used up at the present rate, s; null if nothing is written.
    pub time_to_full_s: Option<f64>,
    /// Age of the last commit in real seconds; null before the first.
    pub last_commit_age_s: Option<f64>,
    /// Duration of the last commit in real seconds.
    pub last_commit_s: Option<f64>,
    /// Number of samples waiting in the queue.
    pub queued: u64,
    /// How long the oldest of them has waited, in real seconds in which the machine was awake; null if none waits.
    pub oldest_waiting_s: Option<f64>,
    /// Whether space is low: less than a gigabyte, or less than twelve hours at the present rate.
    pub low_space: bool,
    /// A condition that needs attention although data is accepted: low space, a log that does not shrink.
    pub warning: Option<String>,
    /// The text of the last error, if the state is not `ok`.
    pub error: Option<String>,
}

/// The numbers of background jobs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JobsStatus {
    /// Waiting jobs.
    pub queued: u64,
    /// Running jobs.
    pub running: u64,
    /// Jobs done since the daemon started.
    pub done: u64,
    /// Jobs failed since the daemon started.
    pub failed: u64,
}

/// A capture that will be deleted to stay within the limits of `[storage]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PlannedDeletion {
    /// Its id.
    pub capture: i64,
    /// Its name.
    pub name: String,
    /// Size of its samples in the database, bytes.
    pub bytes: u64,
    /// The exceeded limit: `age` or `size`.
    pub reason: String,
    /// The earliest time of the deletion, RFC 3339.
    pub delete_at: String,
}

/// The planned and past deletions of captures.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RetentionStatus {
    /// Captures that will be deleted, the next one first; at most 100 of them.
    pub planned: Vec<PlannedDeletion>,
    /// The number of captures that will be deleted.
    pub planned_total: u64,
    /// Captures deleted by age or size since the daemon started.
    pub deleted: u64,
    /// Why the ages of captures cannot be determined from the clock; null if they can. Until then only `keep-mib`
    /// applies.
    #[serde(default)]
    pub distrust: Option<ClockDistrust>,
}

/// The reason why no capture is deleted for its age.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ClockDistrust {
    /// `unset`, `behind` or `far-ahead`.
    pub reason: String,
    /// The time that the clock shows, the problem with it, and the remedy, for the user.
    pub message: String,
}

/// The next night of the schedule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ScheduleStatus {
    /// The local time of day at which a night begins, `22:00`.
    pub at: String,
    /// The start of the next night, RFC 3339; the start of the present one, if it waits.
    pub next_start: String,
    /// The name of its capture.
    pub name: String,
    /// Its planned sample time, s.
    pub duration_s: f64,
    /// Why a due night has not begun, for the user; null if none waits.
    pub waits: Option<String>,
}

/// The live data for other programs, counted since the daemon started.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ShareStatus {
    /// The configured link.
    pub link: Option<String>,
    /// The terminal that it leads to.
    pub terminal: Option<String>,
    /// Whether a program has the terminal open.
    pub reading: bool,
    /// Bytes that the terminal took for a program.
    pub bytes: u64,
    /// Bytes that a program was too slow to take, in whole frames.
    pub dropped_bytes: u64,
    /// Bytes that programs wrote to the terminal. They were discarded.
    pub ignored_bytes: u64,
    /// The configured socket.
    pub socket: Option<String>,
    /// Clients of the socket.
    pub clients: u64,
    /// Clients that were refused because there were too many.
    pub clients_refused: u64,
    /// Samples sent to all clients.
    pub lines: u64,
    /// Samples that clients were too slow to take.
    pub lost_lines: u64,
    /// Why link or socket do not work; null if they do.
    pub error: Option<String>,
}

/// The content of `GET /v1/status`, without version and uptime.
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
    /// Deletions of captures.
    #[serde(default)]
    pub retention: RetentionStatus,
    /// The next night; null without a schedule.
    #[serde(default)]
    pub schedule: Option<ScheduleStatus>,
    /// The notifications.
    #[serde(default)]
    pub notify: NotifyStatus,
    /// The live data for other programs; null if none is shared.
    #[serde(default)]
    pub share: Option<ShareStatus>,
}
