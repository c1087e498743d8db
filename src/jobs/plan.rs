//! The plan of a job: the samples that it takes in. It follows from the captures and the job's `end_seq` alone, so that
//! a job that continues after a kill has the same plan.
//!
//! Several captures of one sensor are read one after the other, as if they were one: the sample and segment numbers of
//! the later ones continue those of the earlier ones. A segment never spans two captures, so nothing is averaged across
//! them.

use super::JobError;
use super::raw_counts::RawCounts;
use super::sampling::{SamplingError, of_configuration, sampling};
use super::source::{CHUNK, SampleSource};
use crate::store::{Chunk, PageRequest, Reader, StoreError, chunks};
use imu_core::sample::{Channel, StatedSampling, Triad};
use imu_noise::whittle::Sampling;
use std::collections::BTreeMap;
use std::ops::Range;

/// The samples that a computation takes in. A capture may have a million segments: each takes 16 bytes here.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The captures, in the order they are read.
    pub slices: Vec<Slice>,
    /// The end of the sample numbers: all samples have a lower one.
    pub end_seq: u64,
    /// The rate of most samples, Hz. Segments of another rate are excluded: two rates are never mixed.
    pub rate_hz: f64,
    /// The requested channels that occur, in column order.
    pub channels: Vec<Channel>,
    /// Samples of the longest segment.
    pub longest: u64,
    /// Samples excluded because their segment has another rate.
    pub other_rate: u64,
    /// The number of segments taken in.
    pub taken: u64,
    /// The sampling of each triad, if known.
    pub sampling: BTreeMap<Triad, Sampling>,
    /// An inertial channel whose values are no measurements ([`at_rest`](super::motion::at_rest)).
    pub(super) raw_counts: Option<RawCounts>,
    /// All segments below `end_seq` in order.
    segments: Vec<Stretch>,
    /// Samples in motion, in order and disjoint; `None` if motion is unknown ([`Self::leave_out`]).
    moving: Option<Vec<Range<u64>>>,
}

/// The times for which the sensor was at rest and in motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shares {
    /// Samples taken in at rest, s.
    pub at_rest_s: f64,
    /// Samples in motion, s: they are excluded.
    pub moving_s: f64,
}

/// One capture's share of a plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slice {
    /// The capture.
    pub capture_id: i64,
    /// The plan's numbers of its samples.
    pub samples: Range<u64>,
    /// The offset that is added to its segments' numbers.
    first_number: u32,
}

/// A segment: it ends where the next one begins.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stretch {
    first_seq: u64,
    number: u32,
    /// Whether its rate is that of most samples.
    taken: bool,
}

/// The totals of all segments of one rate.
#[derive(Debug, Default)]
struct OfRate {
    rate_hz: f64,
    samples: u64,
    longest: u64,
    segments: u64,
    channels: Vec<Channel>,
}

impl Plan {
    /// Returns the next channels after the first `done`, at most `count`.
    pub(super) fn channels_after(&self, done: usize, count: usize) -> &[Channel] {
        let rest = self.channels.get(done..).unwrap_or_default();
        rest.get(..count.min(rest.len())).unwrap_or_default()
    }

    /// Returns the plan for the capture's samples below `end_seq` and the requested channels.
    ///
    /// # Errors
    /// [`JobError::InsufficientData`] if there is no sample of such a channel; [`JobError::Store`].
    pub fn read(reader: &Reader, capture_id: i64, end_seq: u64, wanted: &[Channel]) -> Result<Self, JobError> {
        let (segments, rates) = all_segments(reader, capture_id, end_seq, wanted)?;
        let total: u64 = rates.iter().map(|rate| rate.samples).sum();
        // Of equally frequent rates the higher one.
        let most = rates.iter().enumerate().max_by(|(_, one), (_, other)| {
            (one.samples.cmp(&other.samples)).then(one.rate_hz.total_cmp(&other.rate_hz))
        });
        let found = most.filter(|(_, most)| most.samples > 0 && !most.channels.is_empty());
        let Some((most_rate, most)) = found else {
            let names: Vec<&str> = wanted.iter().map(|channel| channel.name()).collect();
            let reason = format!("capture {capture_id} has no samples of {} yet", names.join(", "));
            return Err(JobError::InsufficientData(reason));
        };
        let stretch = |(first_seq, number, rate)| Stretch { first_seq, number, taken: rate == most_rate };
        Ok(Self {
            slices: vec![Slice { capture_id, samples: 0..end_seq, first_number: 0 }],
            end_seq,
            rate_hz: most.rate_hz,
            channels: most.channels.clone(),
            longest: most.longest,
            other_rate: total - most.samples,
            taken: most.segments,
            sampling: of_configuration(&reader.capture(capture_id)?.configuration),
            segments: segments.into_iter().map(stretch).collect(),
            raw_counts: None,
            moving: None,
        })
    }

    /// Returns the plan for all samples of a recording whose segments are given, in order, all of one rate.
    ///
    /// # Errors
    /// [`JobError::InsufficientData`] if there is no sample of an analysed channel.
    pub fn of_recording(
        capture_id: i64,
        name: &str,
        rate_hz: f64,
        channels: &[Channel],
        segments: &[Range<usize>],
    ) -> Result<Self, JobError> {
        let channels: Vec<Channel> =
            Channel::ANALYSED.into_iter().filter(|channel| channels.contains(channel)).collect();
        let end_seq = segments.last().map_or(0, |last| last.end as u64);
        if end_seq == 0 || channels.is_empty() {
            let reason = format!("{name} has no samples of gyroscope, accelerometer or magnetometer");
            return Err(JobError::InsufficientData(reason));
        }
        let stretch =
            |(number, range): (u32, &Range<usize>)| Stretch { first_seq: range.start as u64, number, taken: true };
        Ok(Self {
            slices: vec![Slice { capture_id, samples: 0..end_seq, first_number: 0 }],
            end_seq,
            rate_hz,
            channels,
            longest: segments.iter().map(|range| range.len() as u64).max().unwrap_or(0),
            other_rate: 0,
            taken: segments.len() as u64,
            sampling: BTreeMap::new(),
            segments: (1..).zip(segments).map(stretch).collect(),
            raw_counts: None,
            moving: None,
        })
    }

    /// Returns the plan extended by another capture's samples, for the channels that both have.
    ///
    /// # Errors
    /// [`JobError::Together`] if they have no channel in common or more segments than can be numbered.
    /// [`one_sensor`](super::one_sensor) determines whether the two are of one sensor at one rate.
    pub fn followed_by(mut self, other: Self) -> Result<Self, JobError> {
        let last = self.segments.last().map_or(0, |last| last.number);
        let too_many = || JobError::Together("they have too many segments: take fewer captures".to_owned());
        let renumber = |number: u32| number.checked_add(last).ok_or_else(too_many);
        for slice in other.slices {
            self.slices.push(Slice {
                samples: slice.samples.start + self.end_seq..slice.samples.end + self.end_seq,
                first_number: renumber(slice.first_number)?,
                ..slice
            });
        }
        for stretch in other.segments {
            let (first_seq, number) = (stretch.first_seq + self.end_seq, renumber(stretch.number)?);
            self.segments.push(Stretch { first_seq, number, ..stretch });
        }
        self.channels.retain(|channel| other.channels.contains(channel));
        if self.channels.is_empty() {
            return Err(JobError::Together("they have no channel in common".to_owned()));
        }
        let shifted = |part: Range<u64>| part.start + self.end_seq..part.end + self.end_seq;
        self.moving = self.moving.zip(other.moving).map(|(mut moving, others)| {
            moving.extend(others.into_iter().map(shifted));
            moving
        });
        // One rate by two clocks: the mean, weighted by samples, so that samples over rate is the whole duration. Equal
        // rates stay.
        let [own, others] =
            [(self.end_seq, self.other_rate), (other.end_seq, other.other_rate)].map(|(all, left)| (all - left) as f64);
        self.rate_hz += (other.rate_hz - self.rate_hz) * others / (own + others);
        self.end_seq += other.end_seq;
        self.longest = self.longest.max(other.longest);
        self.other_rate += other.other_rate;
        self.taken += other.taken;
        // They are of one setting, which one of them may not state.
        if self.sampling.is_empty() {
            self.sampling = other.sampling;
        }
        Ok(self)
    }

    /// Applies the user's statement about the sampling.
    ///
    /// # Errors
    /// [`SamplingError`] if the statement is impossible.
    pub fn sampled(&mut self, stated: StatedSampling) -> Result<(), SamplingError> {
        self.sampling = sampling(stated, &self.sampling, self.rate_hz)?;
        Ok(())
    }

    /// Returns the sampling of a channel, if known.
    pub fn sampling(&self, channel: Channel) -> Option<&Sampling> {
        self.sampling.get(&channel.triad()?)
    }

    /// Reads the samples of a range of the plan's numbers, chunk by chunk.
    ///
    /// # Errors
    /// As [`Self::read_chunk`].
    pub(super) fn chunks(
        &self,
        source: &dyn SampleSource,
        range: Range<u64>,
        channels: &[Channel],
    ) -> impl Iterator<Item = Result<Chunk, StoreError>> {
        chunks(range, CHUNK, move |seq, limit| self.read_chunk(source, seq, limit, channels))
    }

    /// Returns the next samples from number `seq` on, at most `limit`, of one capture; numbers are the plan's. Empty at
    /// the end.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`] if the capture's samples are gone, or the error that the database reports.
    pub fn read_chunk(
        &self,
        source: &dyn SampleSource,
        seq: u64,
        limit: usize,
        channels: &[Channel],
    ) -> Result<Chunk, StoreError> {
        let slice = self.slices.iter().find(|slice| slice.samples.contains(&seq)).or(self.slices.last());
        let gone = |id: i64| StoreError::NoSuchCapture(id.to_string());
        let slice = slice.ok_or_else(|| gone(0))?;
        let left = usize::try_from(slice.samples.end.saturating_sub(seq)).unwrap_or(usize::MAX);
        let own = seq.saturating_sub(slice.samples.start);
        let mut chunk = source.read_chunk(slice.capture_id, own, limit.min(left), channels)?;
        if chunk.is_empty() && left > 0 && limit > 0 {
            return Err(gone(slice.capture_id));
        }
        chunk.first_seq += slice.samples.start;
        chunk.segment.iter_mut().for_each(|number| *number += slice.first_number);
        Ok(chunk)
    }

    /// Returns the `seq` range of a segment that is taken in.
    pub fn segment(&self, number: u32) -> Option<Range<u64>> {
        let index = self.segments.binary_search_by_key(&number, |segment| segment.number).ok()?;
        let segment = self.segments.get(index).filter(|segment| segment.taken)?;
        let end = self.segments.get(index + 1).map_or(self.end_seq, |next| next.first_seq);
        (segment.first_seq < end).then_some(segment.first_seq..end)
    }

    /// Excludes samples in which the sensor moved: the plan's numbers, in order and disjoint. They end stretches as
    /// gaps do.
    pub fn leave_out(&mut self, moving: Vec<Range<u64>>) {
        self.moving = Some(moving);
        if self.is_moving() {
            // Even if nothing is at rest, the longest averaging time is one of the record.
            let longest = self.stretches_at_rest(&(0..self.end_seq)).map(|range| range.end - range.start).max();
            self.longest = longest.map_or(self.longest, |longest| longest.max(self.longest.min(4)));
        }
    }

    /// Returns whether any sample is at rest; `true` if motion is unknown.
    pub(super) fn has_rest(&self) -> bool {
        self.stretches_at_rest(&(0..self.end_seq)).next().is_some()
    }

    fn is_moving(&self) -> bool {
        self.moving.as_ref().is_some_and(|moving| !moving.is_empty())
    }

    /// Returns the motion that touches a range, cut to the range.
    fn moving_in(&self, range: &Range<u64>) -> impl Iterator<Item = Range<u64>> {
        let moving = self.moving.as_deref().unwrap_or_default();
        let from = moving.partition_point(|part| part.end <= range.start);
        let (start, end) = (range.start, range.end);
        let touching = moving.get(from..).unwrap_or_default().iter().take_while(move |part| part.start < end);
        touching.map(move |part| part.start.max(start)..part.end.min(end))
    }

    /// Returns the parts of a range without motion.
    fn resting_in(&self, range: &Range<u64>) -> Vec<Range<u64>> {
        let mut found = Vec::new();
        let mut from = range.start;
        for part in self.moving_in(range) {
            found.push(from..part.start);
            from = part.end;
        }
        found.push(from..range.end);
        found.retain(|part| part.start < part.end);
        found
    }

    /// Returns the segments of a range that are taken in.
    fn taken_in(&self, range: &Range<u64>) -> impl Iterator<Item = Range<u64>> {
        let from = self.segments.partition_point(|segment| segment.first_seq < range.start);
        let (end, whole) = (range.end, self.end_seq);
        let of = move |at: usize| {
            let segment = self.segments.get(at)?;
            let next = self.segments.get(at + 1).map_or(whole, |next| next.first_seq);
            Some((segment.taken, segment.first_seq..next.min(end)))
        };
        let inside = (from..self.segments.len()).map_while(of).take_while(move |(_, part)| part.start < end);
        inside.filter(|(taken, _)| *taken).map(|(_, part)| part)
    }

    fn stretches_at_rest(&self, range: &Range<u64>) -> impl Iterator<Item = Range<u64>> {
        self.taken_in(range).flat_map(|part| self.resting_in(&part))
    }

    /// Returns how long the sensor was at rest in a range of samples, such as a capture's, and how long it moved;
    /// `None` if motion is unknown, as for raw counts.
    pub fn shares(&self, range: &Range<u64>) -> Option<Shares> {
        self.moving.as_ref().filter(|_| self.raw_counts.is_none())?;
        let taken: u64 = self.taken_in(range).map(|part| part.end - part.start).sum();
        let at_rest: u64 = self.stretches_at_rest(range).map(|part| part.end - part.start).sum();
        let seconds = |samples: u64| samples as f64 / self.rate_hz;
        Some(Shares { at_rest_s: seconds(at_rest), moving_s: seconds(taken - at_rest) })
    }

    /// Returns the stretch of samples at rest that contains a sample: its segment and where it begins; `None` if the
    /// sample is excluded.
    pub(super) fn stretch_of(&self, number: u32, seq: u64) -> Option<(u32, u64)> {
        let segment = self.segment(number)?;
        let own = self.resting_in(&segment).into_iter().find(|part| part.contains(&seq))?;
        Some((number, own.start))
    }

    /// Returns the rows of a chunk by segment, in order: segment number (`None` if it is excluded, as samples in motion
    /// are) and rows.
    pub fn runs(&self, chunk: &Chunk) -> Vec<(Option<u32>, Range<usize>)> {
        let mut runs = Vec::new();
        let mut from = 0;
        for part in chunk.segment.chunk_by(|one, next| one == next) {
            let to = from + part.len();
            let number = part.first().copied().filter(|number| self.segment(*number).is_some());
            match number.filter(|_| self.is_moving()) {
                None => runs.push((number, from..to)),
                Some(_) => self.divide(number, chunk.first_seq, from..to, &mut runs),
            }
            from = to;
        }
        runs
    }

    /// Divides rows of one segment into runs at rest and in motion.
    fn divide(
        &self,
        number: Option<u32>,
        first_seq: u64,
        rows: Range<usize>,
        runs: &mut Vec<(Option<u32>, Range<usize>)>,
    ) {
        let mut from = rows.start;
        for part in self.moving_in(&(first_seq + rows.start as u64..first_seq + rows.end as u64)) {
            // Both lie within the chunk.
            let (start, end) = ((part.start - first_seq) as usize, (part.end - first_seq) as usize);
            if from < start {
                runs.push((number, from..start));
            }
            runs.push((None, start..end));
            from = end;
        }
        if from < rows.end {
            runs.push((number, from..rows.end));
        }
    }
}

/// A segment's first sample, its number, and the index of its rate.
type Met = (u64, u32, usize);

/// Returns all segments that begin below `end_seq`, and the totals of each rate.
fn all_segments(
    reader: &Reader,
    capture_id: i64,
    end_seq: u64,
    wanted: &[Channel],
) -> Result<(Vec<Met>, Vec<OfRate>), JobError> {
    let (mut segments, mut rates): (Vec<Met>, Vec<OfRate>) = (Vec::new(), Vec::new());
    let mut open: Vec<Channel> = Vec::new();
    let mut page = PageRequest::first();
    'pages: loop {
        let part = reader.segments(capture_id, &page)?;
        for row in part.rows {
            if row.first_seq >= end_seq {
                break 'pages;
            }
            close(&segments, &mut rates, row.first_seq, &open);
            let rate = rates.iter().position(|rate| rate.rate_hz == row.rate_hz).unwrap_or_else(|| {
                rates.push(OfRate { rate_hz: row.rate_hz, ..OfRate::default() });
                rates.len() - 1
            });
            segments.push((row.first_seq, row.segment, rate));
            open = row.channels;
            open.retain(|channel| wanted.contains(channel));
        }
        match part.next {
            Some(next) => page.cursor = Some(next),
            None => break,
        }
    }
    close(&segments, &mut rates, end_seq, &open);
    Ok((segments, rates))
}

/// Ends the last segment. Its own counter is not used: it may have grown since the job was submitted.
fn close(segments: &[Met], rates: &mut [OfRate], end: u64, channels: &[Channel]) {
    let Some((first_seq, _, rate)) = segments.last() else { return };
    let samples = end.saturating_sub(*first_seq);
    if let Some(rate) = rates.get_mut(*rate).filter(|_| samples > 0) {
        rate.samples += samples;
        rate.longest = rate.longest.max(samples);
        rate.segments += 1;
        rate.channels.extend(channels);
        rate.channels.sort_unstable();
        rate.channels.dedup();
    }
}

/// Passes the runs of present values of one column to `push`, and calls `cut` wherever nothing may be averaged across.
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
