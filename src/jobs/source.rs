//! Source: provides a computation's samples, and their extent for a report. The database is one; callers with samples
//! elsewhere implement another.

use crate::store::{Chunk, Missing, Reader, StoreError};
use imu_core::sample::{Channel, Timebase};
use imu_core::units::NANOS_PER_SECOND;
use imu_noise::Contribution;
use std::collections::BTreeMap;

/// Samples of one chunk.
pub const CHUNK: usize = 65_536;

/// The part of a report that describes its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Extent {
    /// The capture's name, or the names of several.
    pub capture: String,
    /// Sample time covered, received and missing, s.
    pub duration_s: f64,
    /// Number of samples received.
    pub samples: u64,
    /// Number of samples missing.
    pub missing: u64,
    /// Whether no sample will follow.
    pub complete: bool,
    /// For several captures the contribution of each.
    pub captures: Vec<Contribution>,
}

impl Extent {
    /// Returns the capture's samples below `end_seq`; `rate_hz` turns them into time if that is not all of an ended
    /// capture.
    pub(super) fn read(reader: &Reader, capture_id: i64, end_seq: u64) -> Result<Self, StoreError> {
        let capture = reader.capture(capture_id)?;
        if !capture.state.is_open() && capture.samples == end_seq {
            return Ok(Self {
                capture: capture.name,
                duration_s: capture.duration_s,
                samples: capture.samples,
                missing: capture.missing,
                complete: true,
                captures: Vec::new(),
            });
        }
        let missing = reader.missing_before(capture_id, end_seq)?;
        let duration_s = capture.rate_hz.map_or(0.0, |rate_hz| (end_seq + missing) as f64 / rate_hz);
        Ok(Self { capture: capture.name, duration_s, samples: end_seq, missing, complete: false, captures: Vec::new() })
    }
}

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
