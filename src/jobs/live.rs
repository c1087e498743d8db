//! Live analysis of a capture that still runs: octaves of all analysed channels and moments of all, in constant memory.
//!
//! It pulls. Whenever a client requests it (or the daemon's tick calls [`Live::catch_up`]) it takes in the samples
//! committed since, at most [`CATCH_UP`] per call, and returns the result for those it has.

use super::distribution::Distribution;
use super::pass::Pass as _;
use super::report::{self, StatisticsReport};
use super::sampling::of_configuration;
use super::source::Extent;
use super::{Documents, JobError, JobKind};
use crate::store::Reader;
use imu_core::sample::{Channel, Triad};
use imu_noise::allan::{AllanCurve, AllanPoint, AllanReport, Estimator, FixedPoint, LiveAllan};
use imu_noise::fit::{Flag, fit_as_sampled};
use imu_noise::stillness::{MOTION_CHANNELS, Stillness};
use imu_noise::whittle::Sampling;
use imu_noise::{NoiseReport, hold_against};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The maximum number of samples taken in by one call: about a second of work.
pub const CATCH_UP: usize = 500_000;
/// How long a noise report is reused if the capture has grown by less than [`FRESH_SHARE`]: fitting nine channels takes
/// half a second of a core.
const FRESH: Duration = Duration::from_secs(2);
/// The part of the samples, 1/20, by which a capture may grow meanwhile.
const FRESH_SHARE: u64 = 20;
/// Samples read at a time.
const CHUNK: usize = 32_768;

/// The analysis of the running capture.
#[derive(Debug)]
pub struct Live {
    pyramids: Mutex<Option<Pyramids>>,
    noise: Mutex<Option<Kept>>,
    catch_up: usize,
}

impl Default for Live {
    fn default() -> Self {
        Self::taking_in(CATCH_UP)
    }
}

/// The last noise report.
#[derive(Debug)]
struct Kept {
    capture_id: i64,
    /// The samples that it covers.
    next_seq: u64,
    made: Instant,
    report: SoFar<NoiseReport>,
}

impl Kept {
    /// Returns whether this report may be reused for the capture's samples up to `next_seq`.
    fn stands_for(&self, capture_id: i64, next_seq: u64) -> bool {
        let is_near = self.next_seq.abs_diff(next_seq) < self.next_seq / FRESH_SHARE;
        self.capture_id == capture_id && is_near && self.made.elapsed() < FRESH
    }
}

/// The assumed duration of a capture without a planned end, a month. It bounds the memory for its motion.
const LONG_S: f64 = 30.0 * 86_400.0;

/// The octaves of one capture, by rate: two rates are never mixed.
#[derive(Debug)]
struct Pyramids {
    capture_id: i64,
    /// The planned duration of the capture, s.
    planned_s: f64,
    next_seq: u64,
    /// The most recent segment and its rate.
    rate: Option<(u32, f64)>,
    segment: Option<u32>,
    by_rate: BTreeMap<u64, Pyramid>,
    distribution: Distribution,
}

#[derive(Debug)]
struct Pyramid {
    samples: u64,
    stillness: Stillness,
    channels: BTreeMap<Channel, LiveAllan>,
}

/// A report, and whether it covers all committed samples.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct SoFar<T> {
    /// The report; its `samples` is the number of samples that it covers, from the first one on.
    #[serde(flatten)]
    pub report: T,
    /// Only while the capture runs: whether the report covers all committed samples. False for some time after the
    /// daemon has started, while the analysis catches up: ask again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub caught_up: Option<bool>,
}

impl<T> std::ops::Deref for SoFar<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.report
    }
}

/// The result of a capture's live analysis.
#[derive(Debug, Clone, PartialEq)]
pub struct LivePoints {
    /// Rate of the samples taken in, Hz.
    pub rate_hz: f64,
    /// The number of samples of that rate that were taken in.
    pub samples: u64,
    /// The number of samples of other rates that were skipped.
    pub other_rate: u64,
    /// The `seq` up to which samples were examined.
    pub next_seq: u64,
    /// Whether no more samples are on disk.
    pub caught_up: bool,
    /// Octaves of each channel.
    pub channels: BTreeMap<Channel, Vec<AllanPoint>>,
}

impl Live {
    /// Returns the state before any capture.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the state before any capture; every call takes in at most `catch_up` samples instead of [`CATCH_UP`].
    pub fn taking_in(catch_up: usize) -> Self {
        Self { pyramids: Mutex::default(), noise: Mutex::default(), catch_up }
    }

    fn lock(&self) -> MutexGuard<'_, Option<Pyramids>> {
        self.pyramids.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes in up to [`CATCH_UP`] samples committed since; returns whether these were all. For another capture than
    /// last time the analysis begins again.
    ///
    /// # Errors
    /// [`JobError::Store`] if the samples cannot be read.
    pub fn catch_up(&self, reader: &Reader, capture_id: i64) -> Result<bool, JobError> {
        let mut slot = self.lock();
        let pyramids = match &mut *slot {
            Some(pyramids) if pyramids.capture_id == capture_id => pyramids,
            other => {
                let planned_s = reader.capture(capture_id)?.planned_duration_s.unwrap_or(LONG_S);
                other.insert(Pyramids::new(capture_id, planned_s))
            }
        };
        let outcome = pyramids.catch_up(reader, self.catch_up);
        if outcome.is_err() {
            // A partly updated analysis must not be used.
            *slot = None;
        }
        outcome
    }

    /// Returns the octaves of the samples so far, after taking in new ones.
    ///
    /// # Errors
    /// [`JobError::InsufficientData`] before the first sample; [`JobError::Store`].
    pub fn points(&self, reader: &Reader, capture_id: i64) -> Result<LivePoints, JobError> {
        let caught_up = self.catch_up(reader, capture_id)?;
        let slot = self.lock();
        let pyramids = slot.as_ref().filter(|pyramids| pyramids.capture_id == capture_id);
        let found = pyramids.and_then(|pyramids| Some((pyramids, pyramids.largest()?)));
        let Some((pyramids, (rate_hz, pyramid))) = found else {
            return Err(JobError::InsufficientData(format!("capture {capture_id} has no samples yet")));
        };
        Ok(LivePoints {
            rate_hz,
            samples: pyramid.samples,
            other_rate: pyramids.next_seq - pyramid.samples,
            next_seq: pyramids.next_seq,
            caught_up,
            channels: pyramid
                .channels
                .iter()
                .filter(|(_, live)| live.samples() > 0)
                .map(|(channel, live)| (*channel, live.points()))
                .collect(),
        })
    }

    /// Returns the deviation curves of the samples so far (`complete: false`).
    ///
    /// # Errors
    /// As [`Self::points`].
    pub fn allan(&self, reader: &Reader, capture_id: i64) -> Result<SoFar<AllanReport>, JobError> {
        let points = self.points(reader, capture_id)?;
        let curves = points
            .channels
            .iter()
            .map(|(channel, octaves)| (*channel, AllanCurve::from_points(octaves, points.rate_hz, channel.unit())));
        let mut report = AllanReport::new(Estimator::Oadev, points.rate_hz, false, curves);
        report.samples = Some(points.next_seq);
        Ok(SoFar { report, caught_up: Some(points.caught_up) })
    }
}

impl Live {
    /// Returns the noise parameters of the samples so far (`complete: false`).
    ///
    /// # Errors
    /// As [`Self::points`].
    pub fn noise(&self, reader: &Reader, capture_id: i64) -> Result<SoFar<NoiseReport>, JobError> {
        let points = self.points(reader, capture_id)?;
        // Concurrent callers wait here instead of repeating the same fit.
        let mut noise = self.noise.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = noise.as_ref().filter(|kept| kept.stands_for(capture_id, points.next_seq)) {
            return Ok(kept.report.clone());
        }
        let extent = Extent { complete: false, ..Extent::read(reader, capture_id, points.next_seq)? };
        let sampling = of_configuration(&reader.capture(capture_id)?.configuration);
        let report = noise_of_points(&points, self.moving_s(capture_id), &sampling, extent);
        let report = SoFar { report, caught_up: Some(points.caught_up) };
        let (next_seq, made) = (points.next_seq, Instant::now());
        *noise = Some(Kept { capture_id, next_seq, made, report: report.clone() });
        Ok(report)
    }

    /// Returns how long the sensor moved, s, within the samples of the octaves; `None` if motion is unknown.
    fn moving_s(&self, capture_id: i64) -> Option<f64> {
        // The division is done outside the lock.
        let (rate_hz, samples, stillness) = {
            let slot = self.lock();
            let pyramids = slot.as_ref().filter(|pyramids| pyramids.capture_id == capture_id)?;
            let (rate_hz, pyramid) = pyramids.largest()?;
            (rate_hz, pyramid.samples, pyramid.stillness.clone())
        };
        let moving = stillness.settle()?;
        let places: u64 = moving.iter().map(|places| places.end.min(samples).saturating_sub(places.start)).sum();
        Some(places as f64 / rate_hz)
    }

    /// Returns the statistics of the samples so far (`complete: false`).
    ///
    /// # Errors
    /// As [`Self::points`].
    pub fn statistics(&self, reader: &Reader, capture_id: i64) -> Result<SoFar<StatisticsReport>, JobError> {
        let points = self.points(reader, capture_id)?;
        let extent = Extent { complete: false, ..Extent::read(reader, capture_id, points.next_seq)? };
        let slot = self.lock();
        let channels = slot.as_ref().filter(|pyramids| pyramids.capture_id == capture_id);
        let channels = channels.map(|pyramids| pyramids.distribution.statistics()).unwrap_or_default();
        let report = report::statistics(channels, extent);
        Ok(SoFar { report, caught_up: Some(points.caught_up) })
    }

    /// Returns the document of a kind.
    ///
    /// # Errors
    /// As the function of that kind.
    pub fn documents(&self, reader: &Reader, kind: JobKind, capture_id: i64) -> Result<Documents, JobError> {
        let mut own = Documents::default();
        match kind {
            JobKind::Statistics => own.statistics = Some(self.statistics(reader, capture_id)?.report),
            JobKind::Noise => own.noise = Some(self.noise(reader, capture_id)?.report),
            JobKind::Allan => own.allan = Some(self.allan(reader, capture_id)?.report),
            JobKind::Diagnosis => {}
        }
        Ok(own)
    }
}

/// Returns the noise parameters of octaves of a capture that still runs.
fn noise_of_points(
    points: &LivePoints,
    moving_s: Option<f64>,
    sampling: &BTreeMap<Triad, Sampling>,
    extent: Extent,
) -> NoiseReport {
    let LivePoints { rate_hz, other_rate, .. } = *points;
    // Octaves cannot be divided again: samples in motion are included.
    let moved = moving_s.filter(|moving_s| *moving_s > 0.0).map(|moving_s| {
        format!(
            "the sensor moved for {moving_s:.1} s, which is left out only once the capture has ended: ask again then, or submit a \
             noise job"
        )
    });
    let channels = points.channels.iter().map(|(channel, octaves)| {
        let sampling = channel.triad().and_then(|triad| sampling.get(&triad));
        let mut parameters = fit_as_sampled(octaves, rate_hz, *channel, sampling);
        hold_against(&mut parameters, octaves, rate_hz, *channel, &[]);
        if let Some(reason) = &moved {
            parameters.refuse(reason.clone());
        }
        parameters.flags.extend(Flag::other_rate(rate_hz, other_rate));
        (*channel, parameters)
    });
    let channels = channels.collect();
    let at_rest_s = moving_s.map(|moving_s| (points.samples as f64 / rate_hz - moving_s).max(0.0));
    NoiseReport { at_rest_s, moving_s, ..report::noise_report(extent, rate_hz, channels) }
}

impl Pyramids {
    fn new(capture_id: i64, planned_s: f64) -> Self {
        Self {
            capture_id,
            planned_s,
            next_seq: 0,
            rate: None,
            segment: None,
            by_rate: BTreeMap::new(),
            distribution: Distribution::new(Channel::ALL.to_vec()),
        }
    }

    fn largest(&self) -> Option<(f64, &Pyramid)> {
        let (rate, pyramid) = self.by_rate.iter().max_by_key(|(rate, pyramid)| (pyramid.samples, **rate))?;
        Some((f64::from_bits(*rate), pyramid))
    }

    fn catch_up(&mut self, reader: &Reader, samples: usize) -> Result<bool, JobError> {
        let mut left = samples;
        while left > 0 {
            let limit = CHUNK.min(left);
            let chunk = reader.read_chunk(self.capture_id, self.next_seq, limit, &Channel::ALL)?;
            if chunk.is_empty() {
                return Ok(true);
            }
            self.distribution.take(&chunk);
            let analysed: Vec<&Vec<f64>> = chunk
                .channels
                .iter()
                .zip(&chunk.columns)
                .filter(|(channel, _)| Channel::ANALYSED.contains(channel))
                .map(|(_, column)| column)
                .collect();
            let mut from = 0;
            for rows in chunk.segment.chunk_by(|one, next| one == next) {
                let to = from + rows.len();
                if let Some(number) = rows.first() {
                    let rate_hz = self.rate_of(reader, *number)?;
                    let columns: Vec<&[f64]> =
                        analysed.iter().map(|column| column.get(from..to).unwrap_or_default()).collect();
                    self.take(*number, rate_hz, &columns, rows.len());
                }
                from = to;
            }
            left -= chunk.len();
            self.next_seq = chunk.next_seq();
        }
        Ok(false)
    }

    fn take(&mut self, number: u32, rate_hz: f64, columns: &[&[f64]], rows: usize) {
        let continues = self.segment == Some(number);
        self.segment = Some(number);
        let planned = (self.planned_s * rate_hz) as u64;
        let pyramid = self.by_rate.entry(rate_hz.to_bits()).or_insert_with(|| Pyramid::new(rate_hz, planned));
        // Gaps take no place: samples in motion before and after a gap are equally motion.
        pyramid.stillness.push(
            pyramid.samples,
            MOTION_CHANNELS.map(|channel| {
                let at = Channel::ANALYSED.iter().position(|own| *own == channel);
                at.and_then(|at| columns.get(at)).copied().unwrap_or_default()
            }),
        );
        pyramid.samples += rows as u64;
        for (live, column) in pyramid.channels.values_mut().zip(columns) {
            if !continues {
                live.break_segment();
            }
            for (index, part) in column.split(|value| value.is_nan()).enumerate() {
                if index > 0 {
                    live.break_segment();
                }
                live.push(part);
            }
        }
    }

    fn rate_of(&mut self, reader: &Reader, number: u32) -> Result<f64, JobError> {
        if let Some((_, rate_hz)) = self.rate.filter(|(known, _)| *known == number) {
            return Ok(rate_hz);
        }
        let rate_hz = reader.segment_rate_hz(self.capture_id, number)?;
        self.rate = Some((number, rate_hz));
        Ok(rate_hz)
    }
}

impl Pyramid {
    fn new(rate_hz: f64, planned: u64) -> Self {
        // In column order, as `ANALYSED` is: the columns of a chunk have the same order.
        let channels = Channel::ANALYSED.map(|channel| (channel, LiveAllan::new(FixedPoint::for_channel(channel))));
        Self { samples: 0, stillness: Stillness::new(rate_hz, planned), channels: channels.into_iter().collect() }
    }
}
