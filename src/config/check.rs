//! Range checks: pure, over the typed configuration. The module `capture`, which knows the length of a frame, checks
//! whether a rate fits a baud rate.

use super::sections::{Config, ScheduleConfig};
use super::values::{Baud, Device, Output};
use imu_core::units::{IMU_RATE_HZ, format_duration};
use std::time::Duration;

/// Baud rates of register 5 that Linux supports too (termios has no 128000).
pub const BAUDS: [u32; 8] = [9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600];
/// Rates of register 7 in Hz.
pub const ASCII_RATES_HZ: [f64; 11] = [1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0];
/// The minimum length of a token in characters: 128 bits as hexadecimal digits would be 32, and a passphrase of 16
/// resists guessing by HTTP.
pub const TOKEN_LENGTH_MIN: usize = 16;

const DURATION: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(366 * 86_400));
const QUEUE: (Duration, Duration) = (Duration::from_secs(30), Duration::from_secs(600));
const KEEP_DAYS: (u32, u32) = (0, 36_500);
const KEEP_MIB: (u64, u64) = (0, 1 << 30);
const DELETE_NOTICE: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30 * 86_400));
const SENSOR_LOST_AFTER: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(86_400));
const COALESCE: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(3600));
const TIMEOUT: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(120));
const ATTEMPTS: (u32, u32) = (1, 20);
const RETRY_AFTER: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(300));
const RESERVE_MIB: (u64, u64) = (16, 1 << 20);
const WAL_ALARM_MIB: (u64, u64) = (1, 1 << 20);
const FILE_CHECK: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(600));

/// A value outside its range.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// The key with its section.
    pub key: &'static str,
    /// The value.
    pub found: String,
    /// The allowed values.
    pub allowed: String,
}

/// Checks `config` for the first value outside its range.
///
/// # Errors
/// The [`Refusal`].
pub fn check(config: &Config) -> Result<(), Refusal> {
    let sensor = &config.sensor;
    if let Baud::Fixed(baud) = sensor.baud {
        check_baud("sensor.baud", baud)?;
    }
    if sensor.bauds.is_empty() {
        return Err(Refusal { key: "sensor.bauds", found: "[]".to_owned(), allowed: allowed_bauds() });
    }
    sensor.bauds.iter().try_for_each(|baud| check_baud("sensor.bauds", *baud))?;
    check_rate(config)?;
    between("capture.duration", config.capture.duration, DURATION)?;
    check_schedule(config)?;
    between("storage.queue", config.storage.queue, QUEUE)?;
    within("storage.reserve-mib", config.storage.reserve_mib, RESERVE_MIB, " MiB")?;
    within("storage.wal-alarm-mib", config.storage.wal_alarm_mib, WAL_ALARM_MIB, " MiB")?;
    between("storage.file-check", config.storage.file_check, FILE_CHECK)?;
    within("storage.keep-days", config.storage.keep_days, KEEP_DAYS, " days (0: without limit)")?;
    within("storage.keep-mib", config.storage.keep_mib, KEEP_MIB, " MiB (0: without limit)")?;
    between("storage.delete-notice", config.storage.delete_notice, DELETE_NOTICE)?;
    check_notify(config)?;
    check_share(config)?;
    check_token(config)?;
    check_level(config)
}

fn allowed_bauds() -> String {
    format!("allowed are {}", BAUDS.map(|baud| baud.to_string()).join(", "))
}

fn check_baud(key: &'static str, baud: u32) -> Result<(), Refusal> {
    if BAUDS.contains(&baud) {
        return Ok(());
    }
    Err(Refusal { key, found: baud.to_string(), allowed: allowed_bauds() })
}

fn check_rate(config: &Config) -> Result<(), Refusal> {
    let sensor = &config.sensor;
    let (allowed, fits) = match sensor.output {
        Output::Keep => ("any rate from 1 to 800 Hz (with output = \"keep\" it is not used)".to_owned(), {
            (1.0..=IMU_RATE_HZ).contains(&sensor.rate_hz)
        }),
        Output::Binary => (
            format!(
                "binary output has {IMU_RATE_HZ} Hz divided by a whole number, down to 1 Hz: 800, 400, 200, 100, 50, 40…"
            ),
            sensor.rate_divisor().is_some(),
        ),
        Output::Ascii(_) => (
            format!("ASCII output has {} Hz", ASCII_RATES_HZ.map(|rate| rate.to_string()).join(", ")),
            ASCII_RATES_HZ.contains(&sensor.rate_hz),
        ),
    };
    if fits { Ok(()) } else { Err(Refusal { key: "sensor.rate-hz", found: format!("{} Hz", sensor.rate_hz), allowed }) }
}

fn between(key: &'static str, value: Duration, (low, high): (Duration, Duration)) -> Result<(), Refusal> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Refusal {
        key,
        found: format_duration(value),
        allowed: format!("allowed is {} to {}", format_duration(low), format_duration(high)),
    })
}

fn within<T: PartialOrd + std::fmt::Display>(
    key: &'static str,
    value: T,
    (low, high): (T, T),
    unit: &str,
) -> Result<(), Refusal> {
    if (&low..=&high).contains(&&value) {
        return Ok(());
    }
    Err(Refusal { key, found: value.to_string(), allowed: format!("allowed is {low} to {high}{unit}") })
}

fn check_schedule(config: &Config) -> Result<(), Refusal> {
    let schedule = &config.schedule;
    let name = &schedule.name;
    let fits = !name.is_empty()
        && name.trim() == name
        && name.chars().count() <= ScheduleConfig::NAME_MAX
        && !name.contains(|character: char| character == '/' || character.is_control());
    if !fits {
        return Err(Refusal {
            key: "schedule.name",
            found: format!("{name:?}"),
            allowed: format!(
                "expected 1 to {} characters without `/`, control characters, and spaces at either end",
                ScheduleConfig::NAME_MAX
            ),
        });
    }
    let Some(interval) = schedule.shortest_interval() else {
        return Err(Refusal {
            key: "schedule.days",
            found: "[]".to_owned(),
            allowed: "expected at least one of mon, tue, wed, thu, fri, sat, sun; at = \"\" is for no schedule"
                .to_owned(),
        });
    };
    // A night that lasts into the next one would displace it every other time.
    let (key, length) = match (schedule.duration.0, schedule.at.0) {
        (Some(length), _) => ("schedule.duration", length),
        (None, Some(_)) => ("capture.duration", config.capture.duration),
        (None, None) => return Ok(()),
    };
    between(key, length, (DURATION.0, interval)).map_err(|refusal| Refusal {
        allowed: format!("{} for a night of `[schedule]`, which ends before the next one begins", refusal.allowed),
        ..refusal
    })
}

fn check_notify(config: &Config) -> Result<(), Refusal> {
    let notify = &config.notify;
    // A program's name must not be empty; no argument may contain the byte that ends it.
    let named = notify.command.first().is_none_or(|program| !program.trim().is_empty());
    if !named || notify.command.iter().any(|argument| argument.contains('\0')) {
        return Err(Refusal {
            key: "notify.command",
            found: format!("{:?}", notify.command),
            allowed: "expected a program and its arguments, such as [\"/usr/bin/logger\", \"-t\", \"vn100d\"], or [] for none"
                .to_owned(),
        });
    }
    between("notify.sensor-lost-after", notify.sensor_lost_after, SENSOR_LOST_AFTER)?;
    between("notify.coalesce", notify.coalesce, COALESCE)?;
    between("notify.timeout", notify.timeout, TIMEOUT)?;
    within("notify.attempts", notify.attempts, ATTEMPTS, "")?;
    between("notify.retry-after", notify.retry_after, RETRY_AFTER)
}

/// The maximum length of a socket's path in bytes (`sun_path` of Linux, without its zero).
const SOCKET_PATH_BYTES: usize = 107;

fn check_share(config: &Config) -> Result<(), Refusal> {
    let (link, socket) = (&config.share.link, &config.share.socket);
    let refuse = |key: &'static str, path: &std::path::Path, allowed: String| {
        Err(Refusal { key, found: path.display().to_string(), allowed })
    };
    for (key, path) in [("share.link", link), ("share.socket", socket)] {
        if !path.as_os_str().is_empty() && path.file_name().is_none() {
            return refuse(key, path, "expected a path that ends in a name, or \"\" for none".to_owned());
        }
    }
    if matches!(&config.sensor.device, Device::Path(device) if device == link) {
        return refuse("share.link", link, "this is `sensor.device`: choose another path for the copy".to_owned());
    }
    if !link.as_os_str().is_empty() && link == socket {
        return refuse("share.socket", socket, "this is `share.link`: choose another path".to_owned());
    }
    if socket.as_os_str().len() > SOCKET_PATH_BYTES {
        return refuse("share.socket", socket, format!("expected a path of at most {SOCKET_PATH_BYTES} bytes"));
    }
    Ok(())
}

fn check_token(config: &Config) -> Result<(), Refusal> {
    let token = config.http.token.secret();
    let fits =
        token.is_empty() || (token.len() >= TOKEN_LENGTH_MIN && token.bytes().all(|byte| byte.is_ascii_graphic()));
    if fits {
        return Ok(());
    }
    Err(Refusal {
        key: "http.token",
        found: format!("a text of {} characters", token.chars().count()),
        allowed: format!(
            "allowed are at least {TOKEN_LENGTH_MIN} visible ASCII characters without spaces, or \"\" for none"
        ),
    })
}

fn check_level(config: &Config) -> Result<(), Refusal> {
    let level = config.log.level.trim();
    if !level.is_empty() && tracing_subscriber::EnvFilter::try_new(level).is_ok() {
        return Ok(());
    }
    Err(Refusal {
        key: "log.level",
        found: format!("`{}`", config.log.level),
        allowed: "allowed are error, warn, info, debug, trace, off, or directives such as info,vn100d::capture=debug"
            .to_owned(),
    })
}
