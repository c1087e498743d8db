//! The plan of a job: which samples it takes in. It follows from the capture and the job's `end_seq` alone, so that a job
//! that goes on after a kill has the plan it began with.

use super::JobError;
use crate::sample::Channel;
use crate::store::{Chunk, PageRequest, Reader, SegmentRow};
use std::collections::BTreeMap;
use std::ops::Range;

/// Which samples a computation takes in.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The capture.
    pub capture_id: i64,
    /// Samples with `seq` below this.
    pub end_seq: u64,
    /// The rate that most of them have, Hz. Segments of another rate are left out: nothing mixes two rates.
    pub rate_hz: f64,
    /// The channels that occur, of those asked for, in column order.
    pub channels: Vec<Channel>,
    /// Samples of the longest segment.
    pub longest: u64,
    /// Samples left out because their segment has another rate.
    pub other_rate: u64,
    /// Segments of that rate: number and `seq` range.
    segments: BTreeMap<u32, Range<u64>>,
}

impl Plan {
    /// The plan for the capture's samples below `end_seq` and the channels asked for.
    ///
    /// # Errors
    /// [`JobError::InsufficientData`] where there is no sample of such a channel; [`JobError::Store`].
    pub fn read(reader: &Reader, capture_id: i64, end_seq: u64, wanted: &[Channel]) -> Result<Self, JobError> {
        let segments = all_segments(reader, capture_id, end_seq)?;
        let mut by_rate: BTreeMap<u64, u64> = BTreeMap::new();
        for (row, range) in &segments {
            *by_rate.entry(row.rate_hz.to_bits()).or_default() += range.end - range.start;
        }
        let total: u64 = by_rate.values().sum();
        // Positive doubles are ordered as their bits: of equally frequent rates the higher one.
        let (rate, most) = by_rate.into_iter().max_by_key(|(rate, samples)| (*samples, *rate)).unwrap_or_default();
        let rate_hz = f64::from_bits(rate);
        let taken = segments.iter().filter(|(row, _)| row.rate_hz == rate_hz);
        let mut channels: Vec<Channel> = taken
            .clone()
            .flat_map(|(row, _)| row.channels.iter().copied())
            .filter(|channel| wanted.contains(channel))
            .collect();
        channels.sort_unstable();
        channels.dedup();
        if most == 0 || channels.is_empty() {
            let names: Vec<&str> = wanted.iter().map(|channel| channel.name()).collect();
            let reason = format!("capture {capture_id} has no samples of {} yet", names.join(", "));
            return Err(JobError::InsufficientData { reason });
        }
        Ok(Self {
            capture_id,
            end_seq,
            rate_hz,
            channels,
            longest: taken.clone().map(|(_, range)| range.end - range.start).max().unwrap_or(0),
            other_rate: total - most,
            segments: taken.map(|(row, range)| (row.segment, range.clone())).collect(),
        })
    }

    /// The `seq` range of a segment that is taken in.
    #[must_use]
    pub fn segment(&self, number: u32) -> Option<&Range<u64>> {
        self.segments.get(&number)
    }

    /// The rows of a chunk by segment, in order: segment number (None where it is left out) and rows.
    #[must_use]
    pub fn runs(&self, chunk: &Chunk) -> Vec<(Option<u32>, Range<usize>)> {
        let mut runs = Vec::new();
        let mut from = 0;
        for part in chunk.segment.chunk_by(|one, next| one == next) {
            let to = from + part.len();
            let number = part.first().copied().filter(|number| self.segments.contains_key(number));
            runs.push((number, from..to));
            from = to;
        }
        runs
    }
}

/// Segments with the `seq` range that they have below `end_seq`; empty ones are left out.
fn all_segments(reader: &Reader, capture_id: i64, end_seq: u64) -> Result<Vec<(SegmentRow, Range<u64>)>, JobError> {
    let mut rows: Vec<SegmentRow> = Vec::new();
    let mut page = PageRequest::first();
    loop {
        let part = reader.segments(capture_id, &page)?;
        rows.extend(part.rows);
        match part.next {
            Some(next) => page.cursor = Some(next),
            None => break,
        }
    }
    // A segment ends where the next one begins: its own counter may have grown since the job was submitted.
    let begins: Vec<u64> = rows.iter().map(|row| row.first_seq.min(end_seq)).collect();
    let ends = begins.iter().skip(1).copied().chain([end_seq]);
    let ranges: Vec<Range<u64>> = begins.iter().copied().zip(ends).map(|(from, to)| from..to.max(from)).collect();
    Ok(rows.into_iter().zip(ranges).filter(|(_, range)| !range.is_empty()).collect())
}

/// Hands the runs of present values of one column to `push`, with a call of `cut` wherever nothing may be averaged across.
///
/// `open` is the segment that the values before this chunk belonged to.
pub fn feed<T>(
    target: &mut T,
    runs: &[(Option<u32>, Range<usize>)],
    column: &[f64],
    mut open: Option<u32>,
    push: impl Fn(&mut T, &[f64]),
    cut: impl Fn(&mut T),
) {
    for (number, rows) in runs {
        if number.is_none() || *number != open {
            cut(target);
        }
        open = *number;
        let Some(values) = column.get(rows.clone()).filter(|_| number.is_some()) else { continue };
        for (index, part) in values.split(|value| value.is_nan()).enumerate() {
            if index > 0 {
                cut(target);
            }
            if !part.is_empty() {
                push(target, part);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_averaged_across_a_segment_or_an_absent_value() {
        let nan = f64::NAN;
        let column = [1.0, 2.0, nan, nan, 3.0, 4.0, 5.0, 6.0, nan];
        let runs = [(Some(1), 0..5), (None, 5..6), (Some(3), 6..7), (Some(4), 7..9)];
        let fed = |open| {
            let mut parts = vec![vec![0.0]];
            feed(
                &mut parts,
                &runs,
                &column,
                open,
                |parts, values| parts.last_mut().unwrap().extend_from_slice(values),
                |parts| parts.push(Vec::new()),
            );
            parts.retain(|part| !part.is_empty());
            parts
        };
        assert_eq!(fed(Some(1)), [vec![0.0, 1.0, 2.0], vec![3.0], vec![5.0], vec![6.0]]);
        assert_eq!(fed(Some(7)), [vec![0.0], vec![1.0, 2.0], vec![3.0], vec![5.0], vec![6.0]]);
    }
}
