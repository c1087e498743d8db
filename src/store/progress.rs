//! Progress: the state of the writer, shared between its thread and its observers.

use crate::observe::{StorageState, WriterFigures};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A commit that takes longer than this is slow.
pub(super) const SLOW: Duration = Duration::from_secs(1);
/// A writer that has not completed a turn for longer than this is stalled; it turns at least once a second.
const STANDS: Duration = Duration::from_secs(3);
/// The number of I/O errors within [`IO_FAILURES_WITHIN`] that is too many.
pub(super) const IO_FAILURES: usize = 3;
const IO_FAILURES_WITHIN: Duration = Duration::from_secs(60);
/// Free space below this is low, bytes.
const LOW_SPACE_BYTES: f64 = 1e9;
/// Free space that is filled within this time is low, too.
const LOW_SPACE_AHEAD: Duration = Duration::from_secs(12 * 3600);
/// Bytes of a row of table `sample` in the file, with its share of the tree (measured: benches/store.rs).
pub const BYTES_PER_SAMPLE: f64 = 190.0;

/// The state of the writer, as of its last step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WriterProgress {
    /// The state of the commits.
    pub state: StorageState,
    /// The last error, while `state` is not ok.
    pub error: Option<String>,
    /// Samples on disk by capture, of captures written since the start.
    pub committed: BTreeMap<i64, u64>,
    /// What the metrics show.
    pub figures: WriterFigures,
    /// Real times (monotonic, ns) of the last three failures that were I/O errors, oldest first.
    pub io_failures_mono_ns: Vec<u64>,
    /// The time of the last successful commit, real monotonic ns.
    pub last_commit_mono_ns: Option<u64>,
    /// The duration of the last commit.
    pub last_commit: Option<Duration>,
    /// The start of the commit in progress, real ns of a clock that stops while the machine sleeps.
    pub committing_since_awake_ns: Option<u64>,
    /// Records taken from the queue and not committed.
    pub in_flight: usize,
    /// Increases as long as the thread is alive, at least once a second; does not increase while a commit hangs.
    pub ticks: u64,
    /// The time at which `ticks` last increased, on the same clock: a machine that slept is not a stalled writer.
    /// `None` before the first time.
    pub turned_awake_ns: Option<u64>,
    /// Size of the database file in bytes.
    pub database_bytes: u64,
    /// Size of the write-ahead log in bytes.
    pub wal_bytes: u64,
    /// Free space of the file system in bytes.
    pub free_bytes: u64,
    /// The file is damaged: nothing is written to it any more.
    pub damaged: bool,
    /// Captures that continue under another id, in a file that replaced a lost one.
    pub moved: BTreeMap<i64, i64>,
    /// New names of captures that were renamed while they ran.
    pub renamed: BTreeMap<i64, String>,
}

impl WriterProgress {
    /// Returns whether this process should end: at once with a damaged file, else at the third I/O error within a
    /// minute. A new process has new descriptors, and its start checks the database.
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

    /// Returns the present state of the store: a commit that hangs is slow before it ends, and a stalled writer is
    /// degraded.
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

    /// Returns the present problem as text: the last error, or how long the writer has been stalled.
    pub(super) fn error_now(&self, now_awake_ns: u64) -> Option<String> {
        if self.state_now(now_awake_ns) != StorageState::Degraded {
            return self.error.clone();
        }
        let stood_ns = self.turned_awake_ns.map_or(0, |turned| now_awake_ns.saturating_sub(turned));
        let doing =
            if self.committing_since_awake_ns.is_some() { "a commit has not ended" } else { "the writer stands still" };
        Some(format!("{doing} for {:.0} s: look at the disk (`dmesg`, `iostat`)", stood_ns as f64 / 1e9))
    }

    /// Returns the time in s until the free space is used up at the present rate; `None` if nothing is written.
    pub(super) fn time_to_full_s(&self) -> Option<f64> {
        let growth = self.figures.samples_per_s * BYTES_PER_SAMPLE;
        (growth > 1.0).then(|| self.free_bytes as f64 / growth)
    }

    /// Returns whether less than a gigabyte is left, or than twelve hours' data at the present rate.
    pub(super) fn low_space(&self) -> bool {
        let need = self.figures.samples_per_s * BYTES_PER_SAMPLE * LOW_SPACE_AHEAD.as_secs_f64();
        (self.free_bytes as f64) < need.max(LOW_SPACE_BYTES)
    }

    /// Returns a condition that deserves attention although data is being stored.
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

/// Progress shared between the writer's thread and its observers.
pub(super) type SharedProgress = Arc<Mutex<WriterProgress>>;

pub(super) fn locked(progress: &Mutex<WriterProgress>) -> MutexGuard<'_, WriterProgress> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fault A7 of docs/reliability/line.md.
    #[test]
    fn a_writer_that_hangs_is_slow_and_then_degraded() {
        let second = 1_000_000_000;
        let mut progress = WriterProgress { turned_awake_ns: Some(10 * second), ..WriterProgress::default() };
        assert_eq!(progress.state_now(12 * second), StorageState::Ok);
        progress.committing_since_awake_ns = Some(10 * second);
        assert_eq!(progress.state_now(12 * second), StorageState::Slow);
        assert_eq!(progress.state_now(14 * second), StorageState::Degraded);
        assert!(progress.error_now(14 * second).unwrap().contains("has not ended for 4 s"));
        // A thread that hangs outside a commit is degraded too.
        progress.committing_since_awake_ns = None;
        assert_eq!(progress.state_now(14 * second), StorageState::Degraded);
        // A known state of the disk takes precedence.
        progress.state = StorageState::StorageFull;
        assert_eq!(
            (progress.state_now(14 * second), progress.error_now(14 * second)),
            (StorageState::StorageFull, None)
        );
    }
}
