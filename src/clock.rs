//! Clocks: the only module that reads the time.
//!
//! Functions that need the time take a [`Clock`]. Three exist: the system's, a scaled one that an emulator and the
//! daemon share to simulate a night within a minute, and a manual one for tests.

#[cfg(test)]
mod manual;

#[cfg(test)]
pub use manual::ManualClock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// A source of monotonic and civil time, both in nanoseconds.
pub trait Clock: Send + Sync + std::fmt::Debug {
    /// Nanoseconds of a clock that never steps; comparable within one boot of the machine.
    fn mono_ns(&self) -> u64;
    /// Nanoseconds of a clock that stops while the machine sleeps and never steps.
    fn awake_ns(&self) -> u64;
    /// Nanoseconds since 1970-01-01T00:00:00Z; may step.
    fn utc_ns(&self) -> i64;
    /// Returns the boot of the machine to which [`Self::mono_ns`] belongs: times of the same boot are comparable, also
    /// between runs of the program. `None` if the clock is the program's own, or the machine does not report its boot.
    fn boot_id(&self) -> Option<String> {
        None
    }
    /// Returns whether civil time is known to have been set by a time server since the machine started.
    fn is_synchronised(&self) -> bool {
        false
    }
    /// Returns how much faster than real time this clock runs (1 for a real sensor).
    fn speed(&self) -> f64 {
        1.0
    }
    /// Returns how long to sleep in real time so that `scaled` passes on this clock.
    fn real(&self, scaled: Duration) -> Duration {
        scaled.div_f64(self.speed())
    }
}

fn real_mono_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn real_awake_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn real_utc_ns() -> i64 {
    let now = std::time::SystemTime::now();
    match now.duration_since(std::time::UNIX_EPOCH) {
        Ok(since) => since.as_nanos() as i64,
        // The host's clock was set before 1970.
        Err(before) => -(before.duration().as_nanos() as i64),
    }
}

/// The machine's own clocks: `CLOCK_BOOTTIME`, which continues while the machine is suspended, and `CLOCK_REALTIME`.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn mono_ns(&self) -> u64 {
        real_mono_ns()
    }
    fn awake_ns(&self) -> u64 {
        real_awake_ns()
    }
    fn utc_ns(&self) -> i64 {
        real_utc_ns()
    }
    fn boot_id(&self) -> Option<String> {
        let text = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
        Some(text.trim().to_owned()).filter(|id| !id.is_empty())
    }
    fn is_synchronised(&self) -> bool {
        std::path::Path::new(SYNCHRONISED).exists()
    }
}

/// The file that systemd-timesyncd creates once it has set the clock, and that disappears when the machine shuts down.
/// Other time servers leave no such mark: with them the state is unknown.
const SYNCHRONISED: &str = "/run/systemd/timesync/synchronized";

/// A clock that runs `speed` times faster than the machine's, from the moment it is made.
///
/// An emulator that shares it may hold it ([`ScaledClock::hold_at`]): time then never runs ahead of the emulator's
/// output, so that a machine too slow for the speed shows no false silence, latency or skew.
#[derive(Debug)]
pub struct ScaledClock {
    speed: f64,
    origin_mono_ns: u64,
    origin_utc_ns: i64,
    /// Time does not pass this value; `u64::MAX` holds nothing.
    limit_mono_ns: AtomicU64,
    /// The latest time that was returned: the clock never runs back when a limit is lowered.
    latest_mono_ns: AtomicU64,
}

impl ScaledClock {
    /// Creates a clock at `speed` (finite, above 0; 1 is real time) that starts at the machine's present time.
    pub fn new(speed: f64) -> Self {
        let origin_mono_ns = real_mono_ns();
        Self {
            speed,
            origin_mono_ns,
            origin_utc_ns: real_utc_ns(),
            limit_mono_ns: AtomicU64::new(u64::MAX),
            latest_mono_ns: AtomicU64::new(origin_mono_ns),
        }
    }

    /// Returns the scaled time without regard to any hold: the emulator's schedule.
    pub fn schedule_mono_ns(&self) -> u64 {
        let real = real_mono_ns().saturating_sub(self.origin_mono_ns);
        self.origin_mono_ns + (real as f64 * self.speed) as u64
    }

    /// Keeps time from passing `mono_ns` until the next call.
    pub fn hold_at(&self, mono_ns: u64) {
        self.limit_mono_ns.store(mono_ns, Ordering::Release);
    }

    /// Lets time run freely again.
    pub fn release(&self) {
        self.limit_mono_ns.store(u64::MAX, Ordering::Release);
    }
}

impl Clock for ScaledClock {
    fn mono_ns(&self) -> u64 {
        let now = self.schedule_mono_ns().min(self.limit_mono_ns.load(Ordering::Acquire));
        self.latest_mono_ns.fetch_max(now, Ordering::AcqRel).max(now)
    }
    fn awake_ns(&self) -> u64 {
        self.mono_ns()
    }
    fn utc_ns(&self) -> i64 {
        self.origin_utc_ns + (self.mono_ns() - self.origin_mono_ns) as i64
    }
    fn speed(&self) -> f64 {
        self.speed
    }
}

/// Returns RFC 3339 text in UTC with nanoseconds, as every interface writes a time.
pub fn rfc3339(utc_ns: i64) -> String {
    chrono::DateTime::from_timestamp_nanos(utc_ns).to_rfc3339_opts(chrono::SecondsFormat::Nanos, true)
}

/// Returns the offset of local time from UTC, s, at the instant `utc_s` (seconds since 1970-01-01T00:00:00Z), by the
/// rules of the machine's zone: `TZ`, else `/etc/localtime`, else UTC.
pub fn local_offset_s(utc_s: i64) -> i64 {
    use chrono::{Local, Offset, TimeZone};
    let instant = chrono::DateTime::from_timestamp(utc_s, 0).unwrap_or_default();
    i64::from(Local.offset_from_utc_datetime(&instant.naive_utc()).fix().local_minus_utc())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_clock_waits_and_never_runs_back() {
        let clock = ScaledClock::new(1000.0);
        let start = clock.mono_ns();
        clock.hold_at(start + 5);
        std::thread::sleep(Duration::from_millis(2));
        assert_eq!(clock.mono_ns(), start + 5);
        clock.hold_at(start + 2);
        assert_eq!(clock.mono_ns(), start + 5);
        clock.release();
        assert!(clock.mono_ns() > start + 1_000_000_000);
    }

    #[test]
    fn a_boot_has_one_name_and_a_clock_of_the_programs_own_has_none() {
        let boot = SystemClock.boot_id();
        assert!(boot.as_ref().is_some_and(|id| id.len() == 36), "{boot:?}");
        assert_eq!(boot, SystemClock.boot_id());
        assert_eq!(ScaledClock::new(1000.0).boot_id(), None);
    }

    #[test]
    fn civil_time_is_written_in_utc_with_nanoseconds() {
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00.000000000Z");
        assert_eq!(rfc3339(1_800_000_000_123_456_789), "2027-01-15T08:00:00.123456789Z");
    }
}
