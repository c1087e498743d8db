//! The time axis: determines when each sample was taken, and which samples lie in a range of time.
//!
//! In: a capture and times as a user enters them. Out: `seq` of the range's ends, and each sample's time in ns since
//! the capture's first one. Only one segment is kept at a time, however many there are, and every look-up is a short
//! query.

use super::{CaptureRow, Chunk, PageRequest, Reader, SegmentRow, StoreError};
use imu_core::sample::Timebase;
use imu_core::units::period_ns;

/// A requested time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moment {
    /// UTC in ns since 1970.
    Utc(i64),
    /// Time since the capture's first sample, ns.
    Since(i64),
}

impl Moment {
    /// Reads RFC 3339, or seconds since the capture's first sample; `None` if the text is neither.
    pub fn parse(text: &str) -> Option<Self> {
        if let Ok(seconds) = text.parse::<f64>() {
            let ns = seconds * 1e9;
            // Beyond 2^62 ns (146 years) sums would overflow.
            return (0.0..4.6e18).contains(&ns).then(|| Self::Since(ns.round() as i64));
        }
        chrono::DateTime::parse_from_rfc3339(text).ok()?.timestamp_nanos_opt().map(Self::Utc)
    }

    /// Returns the time in ns since the first sample, which was taken at `origin_ns` (UTC).
    pub fn since(self, origin_ns: i64) -> i64 {
        match self {
            Self::Since(ns) => ns,
            Self::Utc(utc_ns) => utc_ns.saturating_sub(origin_ns),
        }
    }
}

/// A range of samples of a capture.
#[derive(Debug)]
pub struct SampleRange {
    /// The capture, as it was when the range was looked up.
    pub capture: CaptureRow,
    /// Its times.
    pub axis: TimeAxis,
    /// The first sample's `seq`.
    pub from_seq: u64,
    /// `seq` after the last sample; never below `from_seq`.
    pub to_seq: u64,
}

impl SampleRange {
    /// Returns the samples of a capture from one moment on and before another; an absent moment stands for the
    /// capture's own end.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    pub fn read(reader: &Reader, name: &str, from: Option<Moment>, to: Option<Moment>) -> Result<Self, StoreError> {
        let id = reader.resolve(name)?;
        let capture = reader.capture(id)?;
        let mut axis = TimeAxis::read(reader, id)?;
        let end = reader.seq_range(id)?.map_or(0, |range| range.last + 1);
        let from_seq = from.map_or(Ok(0), |from| axis.seq_at(reader, from, end))?;
        let to_seq = to.map_or(Ok(end), |to| axis.seq_at(reader, to, end))?;
        Ok(Self { capture, axis, from_seq, to_seq: to_seq.max(from_seq) })
    }

    /// Returns the number of samples.
    pub fn samples(&self) -> u64 {
        self.to_seq - self.from_seq
    }

    /// Returns the times of its first and its last sample, s since the capture's first one; both 0 if it has none.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn ends_s(&mut self, reader: &Reader) -> Result<[f64; 2], StoreError> {
        if self.samples() == 0 {
            return Ok([0.0; 2]);
        }
        let mut at_s = |seq| {
            let (segment, device_ns, host_utc_ns) = reader.sample_clocks(self.capture.id, seq)?;
            Ok::<_, StoreError>(self.axis.time_ns(reader, segment, seq, device_ns, host_utc_ns)? as f64 / 1e9)
        };
        Ok([at_s(self.from_seq)?, at_s(self.to_seq - 1)?])
    }
}

/// The time of each sample: by the sensor's clock within each of its epochs, by the rate if the sensor sends no time,
/// by the stamps of a recording. It keeps one segment at a time, however many there are.
#[derive(Debug)]
pub struct TimeAxis {
    capture_id: i64,
    origin_ns: i64,
    segment: Option<(SegmentRow, i64)>,
}

impl TimeAxis {
    /// Returns the axis of a capture; it begins at its first sample.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn read(reader: &Reader, capture_id: i64) -> Result<Self, StoreError> {
        let first = PageRequest { limit: Some(1), cursor: None };
        let origin_ns = reader.segments(capture_id, &first)?.rows.first().map_or(0, |segment| segment.from.0);
        Ok(Self { capture_id, origin_ns, segment: None })
    }

    /// Returns UTC of the origin of the times, ns since 1970.
    pub fn origin_ns(&self) -> i64 {
        self.origin_ns
    }

    /// Returns the `seq` of the first sample at or after the moment, `end` if there is none. Uses bisection: if the
    /// axis itself runs back (the host's clock was stepped while the sensor was disconnected), the result is one of
    /// several possible places.
    fn seq_at(&mut self, reader: &Reader, moment: Moment, end: u64) -> Result<u64, StoreError> {
        let wanted_ns = moment.since(self.origin_ns);
        let (mut low, mut high) = (0, end);
        while low < high {
            let middle = low + (high - low) / 2;
            let (segment, device_ns, host_utc_ns) = reader.sample_clocks(self.capture_id, middle)?;
            let at_ns = self.time_ns(reader, segment, middle, device_ns, host_utc_ns)?;
            if at_ns < wanted_ns { low = middle + 1 } else { high = middle }
        }
        Ok(low)
    }

    /// Returns the times of a chunk that was read with its clocks, one per sample, ns since the capture's first one;
    /// empty if it was read without clocks.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn times(&mut self, reader: &Reader, chunk: &Chunk) -> Result<Vec<i64>, StoreError> {
        let Some(times) = &chunk.times else { return Ok(Vec::new()) };
        let clocks = times.device_ns.iter().zip(&times.host_utc_ns);
        let rows = (chunk.first_seq..).zip(&chunk.segment).zip(clocks);
        rows.map(|((seq, segment), (device_ns, host_utc_ns))| {
            self.time_ns(reader, *segment, seq, *device_ns, *host_utc_ns)
        })
        .collect()
    }

    /// Returns the time of a row, ns since the capture's first sample.
    pub(super) fn time_ns(
        &mut self,
        reader: &Reader,
        segment: u32,
        seq: u64,
        device_ns: Option<u64>,
        host_utc_ns: i64,
    ) -> Result<i64, StoreError> {
        if self.segment.as_ref().is_none_or(|(row, _)| row.segment != segment) {
            let row = reader.segment(self.capture_id, segment)?;
            // One offset per epoch: host times vary by the latency, the sensor's own do not.
            let offset_ns = reader.epoch_offset_ns(self.capture_id, row.epoch)?.unwrap_or(0);
            self.segment = Some((row, offset_ns));
        }
        let utc_ns = match &self.segment {
            Some((row, offset_ns)) => match (row.timebase, device_ns) {
                (Timebase::Device, Some(device_ns)) => offset_ns.saturating_add(device_ns as i64),
                (Timebase::SyncCounter | Timebase::Arrival | Timebase::Rate, _) => {
                    let steps = seq.saturating_sub(row.first_seq) as f64;
                    row.from.0.saturating_add((steps * period_ns(row.rate_hz)).round() as i64)
                }
                (Timebase::Device | Timebase::Stamps, _) => host_utc_ns,
            },
            None => host_utc_ns,
        };
        Ok(utc_ns.saturating_sub(self.origin_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_rfc_3339_or_seconds_since_the_first_sample() {
        assert_eq!(Moment::parse("1.5"), Some(Moment::Since(1_500_000_000)));
        assert_eq!(Moment::parse("1970-01-01T00:00:01Z"), Some(Moment::Utc(1_000_000_000)));
        assert_eq!(Moment::parse("1970-01-01T01:00:01.5+01:00"), Some(Moment::Utc(1_500_000_000)));
        for text in ["", "-1", "NaN", "inf", "1e30", "yesterday", "2026-11-21", "9999-01-01T00:00:00Z"] {
            assert_eq!(Moment::parse(text), None, "{text}");
        }
    }

    #[test]
    fn a_moment_counts_from_the_first_sample() {
        assert_eq!(Moment::Since(7).since(1_000), 7);
        assert_eq!(Moment::Utc(1_007).since(1_000), 7);
        assert_eq!(Moment::Utc(i64::MIN).since(1_000), i64::MIN);
    }
}
