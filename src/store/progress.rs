//! Progress: how the writer is, shared between its thread and whoever asks.

use crate::observe::StorageState;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A commit that takes longer than this is slow.
pub(super) const SLOW: Duration = Duration::from_secs(1);
/// A writer that has not turned for longer than this stands still; it turns at least once a second.
const STANDS: Duration = Duration::from_secs(3);
/// So many I/O errors within [`IO_FAILURES_WITHIN`] are too many.
pub(super) const IO_FAILURES: usize = 3;
const IO_FAILURES_WITHIN: Duration = Duration::from_secs(60);
/// Less free space than this is little, bytes.
const LOW_SPACE_BYTES: f64 = 1e9;
/// So is less than what comes in this time.
const LOW_SPACE_AHEAD: Duration = Duration::from_secs(12 * 3600);
/// What a row of table `sample` takes in the file, with its share of the tree (measured: benches/store.rs).
pub const BYTES_PER_SAMPLE: f64 = 190.0;

/// How the writer is, as of its last step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WriterProgress {
    /// How commits go.
    pub state: StorageState,
    /// The last error, while `state` is not ok.
    pub error: Option<String>,
    /// Samples on disk by capture, of captures written since the start.
    pub committed: BTreeMap<i64, u64>,
    /// Commits of batches since the start.
    pub commits: u64,
    /// Failed attempts since the start.
    pub failures: u64,
    /// Real times (monotonic, ns) of the last three failures that were I/O errors, oldest first.
    pub io_failures_mono_ns: Vec<u64>,
    /// Failures because another process held the database.
    pub busy: u64,
    /// Records that the schema refused: faults of this program.
    pub refused: u64,
    /// When the last commit succeeded, real monotonic ns.
    pub last_commit_mono_ns: Option<u64>,
    /// How long it took.
    pub last_commit: Option<Duration>,
    /// How long the slowest since the start took.
    pub slowest_commit: Duration,
    /// Commits that took longer than a second.
    pub slow_commits: u64,
    /// Since when a commit is under way, real ns of a clock that stands while the machine sleeps.
    pub committing_since_awake_ns: Option<u64>,
    /// Records taken from the queue and not committed.
    pub in_flight: usize,
    /// Grows as long as the thread is alive, at least once a second; stands still while a commit hangs.
    pub ticks: u64,
    /// When `ticks` last grew, on the same clock: a machine that slept is no writer that stood. `None` before the first time.
    pub turned_awake_ns: Option<u64>,
    /// Size of the database file in bytes.
    pub database_bytes: u64,
    /// Size of the write-ahead log in bytes.
    pub wal_bytes: u64,
    /// Free space of the file system in bytes.
    pub free_bytes: u64,
    /// Samples committed per second of the store's clock, averaged over half a minute: forecasts are in the time that captures
    /// are in, also where that is accelerated.
    pub samples_per_s: f64,
    /// The file is damaged: nothing is written to it any more.
    pub damaged: bool,
    /// Captures that go on under another id, in a file that took the place of a lost one.
    pub moved: BTreeMap<i64, i64>,
}

impl WriterProgress {
    /// Whether this process should end: with a damaged file at once, else with the third I/O error within a minute.
    /// Another process has other descriptors, and its start checks the database.
    #[must_use]
    pub fn gives_up(&self) -> bool {
        if self.damaged {
            return true;
        }
        match self.io_failures_mono_ns.as_slice() {
            [first, .., last] if self.io_failures_mono_ns.len() >= IO_FAILURES => {
                last.saturating_sub(*first) <= IO_FAILURES_WITHIN.as_nanos() as u64
            }
            _ => false,
        }
    }

    /// How the store is now: a commit that hangs is slow before it ends, and a writer that does not turn is degraded.
    pub(super) fn state_now(&self, now_awake_ns: u64) -> StorageState {
        let longer = |since: Option<u64>, than: Duration| {
            since.is_some_and(|since| now_awake_ns.saturating_sub(since) > than.as_nanos() as u64)
        };
        match self.state {
            StorageState::Ok | StorageState::Slow if longer(self.turned_awake_ns, STANDS) => StorageState::Degraded,
            StorageState::Ok if longer(self.committing_since_awake_ns, SLOW) => StorageState::Slow,
            state => state,
        }
    }

    /// What is wrong now, in words: the last error, or for how long the writer has stood still.
    pub(super) fn error_now(&self, now_awake_ns: u64) -> Option<String> {
        if self.state_now(now_awake_ns) != StorageState::Degraded {
            return self.error.clone();
        }
        let stood_ns = self.turned_awake_ns.map_or(0, |turned| now_awake_ns.saturating_sub(turned));
        let doing =
            if self.committing_since_awake_ns.is_some() { "a commit has not ended" } else { "the writer stands still" };
        Some(format!("{doing} for {:.0} s: look at the disk (`dmesg`, `iostat`)", stood_ns as f64 / 1e9))
    }

    /// How long the free space lasts at the present rate, s; `None` where nothing is written.
    pub(super) fn time_to_full_s(&self) -> Option<f64> {
        let growth = self.samples_per_s * BYTES_PER_SAMPLE;
        (growth > 1.0).then(|| self.free_bytes as f64 / growth)
    }

    /// Whether less than a gigabyte is left, or than twelve hours' data at the present rate.
    pub(super) fn low_space(&self) -> bool {
        let need = self.samples_per_s * BYTES_PER_SAMPLE * LOW_SPACE_AHEAD.as_secs_f64();
        (self.free_bytes as f64) < need.max(LOW_SPACE_BYTES)
    }

    /// What deserves attention although data is taken.
    pub(super) fn warning(&self, wal_alarm_bytes: u64) -> Option<String> {
        let mut warnings = Vec::new();
        if self.low_space() {
            let left = format!("{:.2} GB are free for the database", self.free_bytes as f64 / 1e9);
            warnings.push(match self.time_to_full_s() {
                Some(seconds) => format!("{left}: full in {:.1} h at the present rate", seconds / 3600.0),
                None => left,
            });
        }
        if self.wal_bytes > wal_alarm_bytes {
            warnings.push(format!(
                "the write-ahead log has grown to {:.0} MB: a program that reads the database holds it; end its \
                 transaction",
                self.wal_bytes as f64 / 1e6
            ));
        }
        (!warnings.is_empty()).then(|| warnings.join("; "))
    }
}

/// Progress shared between the thread and whoever asks.
pub(super) type SharedProgress = Arc<Mutex<WriterProgress>>;

pub(super) fn locked(progress: &Mutex<WriterProgress>) -> MutexGuard<'_, WriterProgress> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A7.
    #[test]
    fn a_writer_that_hangs_is_slow_and_then_degraded() {
        let second = 1_000_000_000;
        let mut progress = WriterProgress { turned_awake_ns: Some(10 * second), ..WriterProgress::default() };
        assert_eq!(progress.state_now(12 * second), StorageState::Ok);
        progress.committing_since_awake_ns = Some(10 * second);
        assert_eq!(progress.state_now(12 * second), StorageState::Slow);
        assert_eq!(progress.state_now(14 * second), StorageState::Degraded);
        assert!(progress.error_now(14 * second).unwrap().contains("has not ended for 4 s"));
        // A thread that hangs outside a commit as well.
        progress.committing_since_awake_ns = None;
        assert_eq!(progress.state_now(14 * second), StorageState::Degraded);
        // What is known of the disk is said instead.
        progress.state = StorageState::StorageFull;
        assert_eq!(
            (progress.state_now(14 * second), progress.error_now(14 * second)),
            (StorageState::StorageFull, None)
        );
    }
}
