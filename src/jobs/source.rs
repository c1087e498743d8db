//! Source: where a computation's samples come from. The database is one; whoever has them elsewhere gives another.

use super::report::Extent;
use crate::sample::Channel;
use crate::store::{Chunk, Missing, Reader, StoreError};

/// Samples of captures, by the captures' ids.
pub trait SampleSource {
    /// Up to `limit` samples from `from_seq` on: one column per channel in the channel's unit, NaN where a sample has no value.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or what the database says.
    fn read_chunk(
        &self,
        capture_id: i64,
        from_seq: u64,
        limit: usize,
        channels: &[Channel],
    ) -> Result<Chunk, StoreError>;

    /// What is missing before each sample.
    ///
    /// # Errors
    /// What the database says.
    fn missing(&self, capture_id: i64) -> Result<Missing, StoreError>;

    /// What a report says about the samples below `end_seq`.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or what the database says.
    fn extent(&self, capture_id: i64, end_seq: u64) -> Result<Extent, StoreError>;
}

impl SampleSource for Reader {
    fn read_chunk(
        &self,
        capture_id: i64,
        from_seq: u64,
        limit: usize,
        channels: &[Channel],
    ) -> Result<Chunk, StoreError> {
        self.read_chunk(capture_id, from_seq, limit, channels)
    }
    fn missing(&self, capture_id: i64) -> Result<Missing, StoreError> {
        self.missing(capture_id)
    }
    fn extent(&self, capture_id: i64, end_seq: u64) -> Result<Extent, StoreError> {
        Extent::read(self, capture_id, end_seq)
    }
}
