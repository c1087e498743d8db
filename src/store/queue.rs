//! Queue: the way of records to the writer.

use crate::sample::Record;
use tokio::sync::mpsc;

/// Puts records into the writer's queue.
#[derive(Debug, Clone)]
pub struct RecordSender(pub(super) mpsc::Sender<(i64, Record)>);

/// A record that was not taken.
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
    /// [`Refused`] with the record where the queue is full or the writer has ended.
    #[expect(clippy::result_large_err, reason = "the record is given back, it was as large when it came")]
    pub fn try_send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.0.try_send((capture_id, record)).map_err(|error| match error {
            mpsc::error::TrySendError::Full((_, record)) => Refused::Full(record),
            mpsc::error::TrySendError::Closed((_, record)) => Refused::Closed(record),
        })
    }

    /// Puts a capture's record into the queue, waiting for room: for a reader that may hold its source back.
    ///
    /// # Errors
    /// [`Refused::Closed`] where the writer has ended.
    pub async fn send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.0.send((capture_id, record)).await.map_err(|error| Refused::Closed(error.0.1))
    }

    /// As [`Self::send`], from a thread outside the asynchronous runtime.
    ///
    /// # Errors
    /// [`Refused::Closed`] where the writer has ended.
    #[expect(clippy::result_large_err, reason = "the record is given back, it was as large when it came")]
    pub fn blocking_send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.0.blocking_send((capture_id, record)).map_err(|error| Refused::Closed(error.0.1))
    }

    /// Records that wait in the queue.
    #[must_use]
    pub fn queued(&self) -> usize {
        self.0.max_capacity() - self.0.capacity()
    }

    /// Records that still fit.
    #[must_use]
    pub fn room(&self) -> usize {
        self.0.capacity()
    }

    /// Whether the writer has ended.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.0.is_closed()
    }
}
