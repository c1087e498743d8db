//! The sections of the configuration with their defaults. `docs/config.md` and `systemd/vn100d.toml` describe every
//! key; a test compares the latter with these defaults.

use super::values::{
    Baud, BinaryFields, Day, Device, FileMode, LogFormat, NightLength, Output, StartTime, Token, Webhook,
};
use crate::observe::NotifyEvent;
use imu_core::units::{IMU_RATE_HZ, duration_text};
use serde::{Deserialize, Serialize};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

/// The effective configuration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// `[sensor]`
    pub sensor: SensorConfig,
    /// `[capture]`
    pub capture: CaptureConfig,
    /// `[schedule]`
    pub schedule: ScheduleConfig,
    /// `[storage]`
    pub storage: StorageConfig,
    /// `[http]`
    pub http: HttpConfig,
    /// `[notify]`
    pub notify: NotifyConfig,
    /// `[share]`
    pub share: ShareConfig,
    /// `[log]`
    pub log: LogConfig,
}

/// The sensor: its port and its output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SensorConfig {
    /// The device to search for.
    pub device: Device,
    /// Its baud rate.
    pub baud: Baud,
    /// Baud rates that `baud = "auto"` tries, in this order.
    pub bauds: Vec<u32>,
    /// The configured output.
    pub output: Output,
    /// Output rate in Hz; not used with `output = "keep"`.
    pub rate_hz: f64,
    /// The fields of binary output.
    pub binary_fields: BinaryFields,
}

impl SensorConfig {
    /// Returns the divisor of the internal rate of 800 Hz that gives `rate_hz` in binary output; `None` if none does.
    ///
    /// # Source
    /// VN-100 user manual, register 75: `RateDivisor`. A rate may be written with a few decimals: 33.33 means 800/24.
    pub fn rate_divisor(&self) -> Option<u16> {
        let exact = IMU_RATE_HZ / self.rate_hz;
        let divisor = exact.round();
        let fits = (exact - divisor).abs() <= 0.01 && (1.0..=IMU_RATE_HZ).contains(&divisor);
        fits.then_some(divisor as u16)
    }
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            device: Device::Auto,
            baud: Baud::Auto,
            bauds: vec![115_200, 921_600, 460_800, 230_400, 57_600, 38_400, 19_200, 9_600],
            output: Output::Binary,
            rate_hz: 40.0,
            binary_fields: BinaryFields { groups: 0x01, masks: vec![0x0609] },
        }
    }
}

/// Captures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct CaptureConfig {
    /// Sample time of a capture that is requested without a duration.
    #[serde(with = "duration_text")]
    pub duration: Duration,
}

impl Default for CaptureConfig {
    fn default() -> Self {
        Self { duration: Duration::from_secs(5 * 3600) }
    }
}

/// Scheduled captures: one per night.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ScheduleConfig {
    /// The local time at which a night's capture begins; if it is empty, none begins.
    pub at: StartTime,
    /// Its sample time, and how late it may still begin; `capture.duration` if it is empty.
    pub duration: NightLength,
    /// The prefix of its name; the date of the evening follows.
    pub name: String,
    /// The days on whose evening a capture begins.
    pub days: Vec<Day>,
}

impl ScheduleConfig {
    /// The maximum length of the name in characters: with the date it is a capture's name.
    pub const NAME_MAX: usize = 80;

    /// Returns the minimum time from the start of one night to that of the next; `None` if there is no night.
    pub fn shortest_interval(&self) -> Option<Duration> {
        let chosen = |day: usize| self.days.contains(&Day::ALL[day % Day::ALL.len()]);
        let following = |day: usize| (1..=Day::ALL.len()).find(|later| chosen(day + later));
        let days = (0..Day::ALL.len()).filter(|day| chosen(*day)).filter_map(following).min()?;
        Some(Duration::from_secs(86_400 * days as u64))
    }
}

impl Default for ScheduleConfig {
    fn default() -> Self {
        Self {
            at: StartTime::default(),
            duration: NightLength::default(),
            name: "nightly".to_owned(),
            days: Day::ALL.to_vec(),
        }
    }
}

/// The storage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct StorageConfig {
    /// How long the disk may stall before samples are lost.
    #[serde(with = "duration_text")]
    pub queue: Duration,
    /// Free space in MiB below which the daemon reports itself not ready.
    pub reserve_mib: u64,
    /// Size of the write-ahead log in MiB above which the daemon warns.
    pub wal_alarm_mib: u64,
    /// The interval at which the database's path is compared with the open file.
    #[serde(with = "duration_text")]
    pub file_check: Duration,
    /// Captures older than this many days are deleted; 0 keeps them.
    pub keep_days: u32,
    /// The oldest captures are deleted until all together take no more than this many MiB; 0 is unlimited.
    pub keep_mib: u64,
    /// The minimum time between the announcement of a deletion and the deletion.
    #[serde(with = "duration_text")]
    pub delete_notice: Duration,
}

impl StorageConfig {
    /// The minimum number of samples that the queue holds, whatever the rate (issue: 30 s of data, at least 24,000
    /// samples).
    pub const QUEUE_SAMPLES_MIN: usize = 24_000;

    /// Returns the number of samples that the queue between reader and writer holds at the highest rate of a sensor.
    pub fn queue_samples(&self) -> usize {
        ((self.queue.as_secs_f64() * IMU_RATE_HZ).ceil() as usize).max(Self::QUEUE_SAMPLES_MIN)
    }
    /// Returns the reserve in bytes.
    pub fn reserve_bytes(&self) -> u64 {
        self.reserve_mib << 20
    }
}

impl Default for StorageConfig {
    fn default() -> Self {
        Self {
            queue: Duration::from_secs(30),
            reserve_mib: 512,
            wal_alarm_mib: 256,
            file_check: Duration::from_secs(10),
            keep_days: 0,
            keep_mib: 0,
            delete_notice: Duration::from_secs(24 * 3600),
        }
    }
}

/// The HTTP interface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct HttpConfig {
    /// The address on which it listens.
    pub listen: SocketAddr,
    /// The bearer token that modifying requests need; beyond loopback one is required.
    pub token: Token,
    /// A file that holds the token (its first line); empty if there is none.
    pub token_file: PathBuf,
}

impl Default for HttpConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8100)),
            token: Token::default(),
            token_file: PathBuf::new(),
        }
    }
}

/// Live data for other programs beside the recording.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ShareConfig {
    /// The link to a terminal with a copy of the port's bytes; empty if there is none.
    pub link: PathBuf,
    /// The socket with the samples as JSON lines; empty if there is none.
    pub socket: PathBuf,
    /// The permissions of terminal and socket.
    pub mode: FileMode,
}

/// The receivers and events of notifications.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct NotifyConfig {
    /// A program and its arguments, run without a shell; empty if there is none.
    pub command: Vec<String>,
    /// The address to which events are posted; empty if there is none.
    pub url: Webhook,
    /// The reported events.
    pub events: Vec<NotifyEvent>,
    /// The minimum absence of the sensor that is reported.
    #[serde(with = "duration_text")]
    pub sensor_lost_after: Duration,
    /// The interval after which the same kind of event is reported again; events in between are reported together.
    #[serde(with = "duration_text")]
    pub coalesce: Duration,
    /// The time limit of one attempt.
    #[serde(with = "duration_text")]
    pub timeout: Duration,
    /// The number of attempts for a message.
    pub attempts: u32,
    /// The delay after the first failed attempt; it doubles with every further one.
    #[serde(with = "duration_text")]
    pub retry_after: Duration,
}

impl Default for NotifyConfig {
    fn default() -> Self {
        Self {
            command: Vec::new(),
            url: Webhook::default(),
            events: NotifyEvent::ALL.to_vec(),
            sensor_lost_after: Duration::from_secs(30),
            coalesce: Duration::from_secs(60),
            timeout: Duration::from_secs(10),
            attempts: 8,
            retry_after: Duration::from_secs(2),
        }
    }
}

/// The log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct LogConfig {
    /// `error`, `warn`, `info`, `debug`, `trace`, or directives such as `info,vn100d::capture=debug`.
    pub level: String,
    /// The form of its lines.
    pub format: LogFormat,
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { level: "info".to_owned(), format: LogFormat::Text }
    }
}
