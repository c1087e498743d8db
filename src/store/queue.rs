//! Queue: passes records to the writer.

use crate::clock::{Clock as _, SystemClock};
use imu_core::sample::Record;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::mpsc;

/// The resolution at which the age of the oldest waiting record is known, ns.
const MARK_EVERY_NS: u64 = 100_000_000;

/// Tracks since when the oldest uncommitted record has waited, in the queue or in the writer.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    /// Number of records that arrived.
    came: u64,
    /// Number of records on disk.
    written: u64,
    /// Numbers of records and their arrival times. The first is the oldest waiting record or one shortly before it.
    marks: VecDeque<(u64, u64)>,
}

/// [`Waiting`], shared between the senders and the writer.
pub(super) type SharedWaiting = Arc<Mutex<Waiting>>;

pub(super) fn locked(waiting: &Mutex<Waiting>) -> MutexGuard<'_, Waiting> {
    waiting.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Waiting {
    /// Records that a record arrived at `now_ns`.
    fn come(&mut self, now_ns: u64) {
        self.came += 1;
        let is_due = self.marks.back().is_none_or(|(_, at_ns)| now_ns.saturating_sub(*at_ns) >= MARK_EVERY_NS);
        // The writer may have been faster than this note.
        if is_due && self.came > self.written {
            self.marks.push_back((self.came, now_ns));
        }
    }

    /// Records that the oldest `count` records are on disk.
    pub(super) fn write(&mut self, count: u64) {
        self.written += count;
        while self.marks.get(1).is_some_and(|(number, _)| *number <= self.written + 1) {
            self.marks.pop_front();
        }
        if self.written >= self.came {
            self.marks.clear();
        }
    }

    /// Returns the arrival time of the oldest waiting record.
    pub(super) fn since_ns(&self) -> Option<u64> {
        self.marks.front().map(|(_, at_ns)| *at_ns)
    }
}

/// Puts records into the writer's queue.
#[derive(Debug, Clone)]
pub struct RecordSender {
    pub(super) queue: mpsc::Sender<(i64, Record)>,
    pub(super) waiting: SharedWaiting,
}

/// A record that was not accepted.
#[derive(Debug, Clone, PartialEq)]
pub enum Refused {
    /// The queue is full.
    Full(Record),
    /// The writer has ended.
    Closed(Record),
}

impl RecordSender {
    /// Puts a capture's record into the queue; never waits.
    ///
    /// # Errors
    /// [`Refused`] with the record if the queue is full or the writer has ended.
    #[expect(clippy::result_large_err, reason = "the record is given back, it was as large when it came")]
    pub fn try_send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.queue.try_send((capture_id, record)).map(|()| self.came()).map_err(|error| match error {
            mpsc::error::TrySendError::Full((_, record)) => Refused::Full(record),
            mpsc::error::TrySendError::Closed((_, record)) => Refused::Closed(record),
        })
    }

    /// Puts a capture's record into the queue, waiting for room, from a thread outside the asynchronous runtime.
    ///
    /// # Errors
    /// [`Refused::Closed`] if the writer has ended.
    #[expect(clippy::result_large_err, reason = "the record is given back, it was as large when it came")]
    pub fn blocking_send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.queue.blocking_send((capture_id, record)).map_err(|error| Refused::Closed(error.0.1))?;
        self.came();
        Ok(())
    }

    fn came(&self) {
        locked(&self.waiting).come(SystemClock.awake_ns());
    }

    /// Returns the number of records that wait in the queue.
    pub fn queued(&self) -> usize {
        self.queue.max_capacity() - self.queue.capacity()
    }

    /// Returns the number of records that still fit.
    pub fn room(&self) -> usize {
        self.queue.capacity()
    }

    /// Returns whether the writer has ended.
    pub fn is_closed(&self) -> bool {
        self.queue.is_closed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_that_waits_is_known_whatever_was_written_before_it() {
        let second = 1_000_000_000;
        let mut waiting = Waiting::default();
        assert_eq!(waiting.since_ns(), None);
        // Ten per second for five seconds; the first 25 are on disk.
        (0..50).for_each(|number| waiting.come(number * second / 10));
        assert_eq!(waiting.since_ns(), Some(0));
        waiting.write(25);
        assert_eq!(waiting.since_ns(), Some(25 * second / 10));
        waiting.write(25);
        assert_eq!((waiting.since_ns(), waiting.marks.len()), (None, 0));
        // An hour without a record must not affect the age of the next one.
        waiting.come(3600 * second);
        assert_eq!(waiting.since_ns(), Some(3600 * second));
        // Many records at once need one mark.
        (0..1000).for_each(|number| waiting.come(3600 * second + number));
        assert_eq!(waiting.marks.len(), 1);
        waiting.write(1000);
        assert_eq!(waiting.since_ns(), Some(3600 * second));
        waiting.write(1);
        assert_eq!(waiting.since_ns(), None);
        // The writer may be faster than the note of its records.
        waiting.write(1);
        waiting.come(3700 * second);
        assert_eq!(waiting.since_ns(), None);
    }
}
