//! Source: provides a computation's samples. The database is one; callers with samples elsewhere implement another.

use super::report::Extent;
use crate::store::{Chunk, Missing, Reader, StoreError};
use imu_core::sample::{Channel, Timebase};
use imu_core::units::NANOS_PER_SECOND;
use std::collections::BTreeMap;

/// Samples of captures, by the captures' ids.
pub trait SampleSource {
    /// Returns up to `limit` samples from `from_seq` on: one column per channel in the channel's unit, NaN if a sample
    /// has no value.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    fn read_chunk(
        &self,
        capture_id: i64,
        from_seq: u64,
        limit: usize,
        channels: &[Channel],
    ) -> Result<Chunk, StoreError>;

    /// Returns the samples missing before each sample.
    ///
    /// # Errors
    /// The error that the database reports.
    fn missing(&self, capture_id: i64) -> Result<Missing, StoreError>;

    /// Returns the device's own stamps of up to `limit` samples from `from_seq` on: the run of its clock, and the time
    /// in that run in s. Empty if none of them has one. An arrival time is not a stamp, because it scatters with the
    /// host's deliveries.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    fn stamps(&self, capture_id: i64, from_seq: u64, limit: usize) -> Result<Vec<Option<(u32, f64)>>, StoreError>;

    /// Returns the time on the recording's own clock from which its stamps count, s, if it is known.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    fn first_stamp_s(&self, _capture_id: i64) -> Result<Option<f64>, StoreError> {
        Ok(None)
    }

    /// Returns the extent of the samples below `end_seq`, for a report.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
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
    fn stamps(&self, capture_id: i64, from_seq: u64, limit: usize) -> Result<Vec<Option<(u32, f64)>>, StoreError> {
        // The origin of a table's stamps is unknown; those before raw lines and in bags are the host's.
        let configuration = self.capture(capture_id)?.configuration;
        let imported_with_host_times = matches!(configuration.recording_kind(), Some("vn_text" | "bag"));
        let chunk = self.read_samples(capture_id, from_seq, limit, &[])?;
        let device_ns = chunk.times.map(|times| times.device_ns).unwrap_or_default();
        let mut epochs: BTreeMap<u32, Option<u32>> = BTreeMap::new();
        for number in &chunk.segment {
            if !epochs.contains_key(number) {
                let row = self.segment(capture_id, *number)?;
                let own =
                    row.timebase == Timebase::Device || row.timebase == Timebase::Stamps && !imported_with_host_times;
                epochs.insert(*number, own.then_some(row.epoch));
            }
        }
        let stamp = |(number, ns): (&u32, Option<u64>)| {
            let epoch = epochs.get(number).copied().flatten()?;
            Some((epoch, ns? as f64 / NANOS_PER_SECOND as f64))
        };
        let stamps: Vec<Option<(u32, f64)>> = chunk.segment.iter().zip(device_ns).map(stamp).collect();
        Ok(if stamps.iter().any(Option::is_some) { stamps } else { Vec::new() })
    }
    fn first_stamp_s(&self, capture_id: i64) -> Result<Option<f64>, StoreError> {
        Ok(self.capture(capture_id)?.configuration.first_stamp_s())
    }
    fn extent(&self, capture_id: i64, end_seq: u64) -> Result<Extent, StoreError> {
        Extent::read(self, capture_id, end_seq)
    }
}
