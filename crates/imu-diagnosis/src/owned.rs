//! Owned: N, B and K of a record as the crate `imu-noise` determines them.
//!
//! That crate owns these parameters. The law of a diagnosis has N, B and K beside effects, which share one spectrum
//! with them. How much of N a filter or the skirt of a band takes therefore depends on the law's form. The capture's
//! value in a report is the value of `imu-noise` for the same samples, if `imu-noise` states that it may be used.
//!
//! # Validation
//! `examples/one_n.rs`, docs/validation.md.

use super::recording::Recording;
use imu_core::sample::Channel;
use imu_noise::NoiseParameters;
use imu_noise::allan::FixedPoint;
use imu_noise::fit::Estimate;
use imu_noise::robust::{All, Company, Levels, Part, Record, spectral_sums};
use imu_noise::stillness::{MOTION_CHANNELS, Stillness};
use std::ops::Range;

/// A record whose channels are examined on demand.
pub(super) struct Owned<'a> {
    real: &'a Recording,
    /// Ranges in which the sensor moved.
    moving: Vec<Range<u64>>,
}

/// A parameter's value, U or its density, and its 95 % interval. A parameter that is not identified has no value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    pub(super) value: Option<f64>,
    pub(super) ends: [f64; 2],
}

impl Known {
    fn of(estimate: &Estimate) -> Option<Self> {
        let limit = || estimate.upper_limit95.map(|limit| [0.0, limit]);
        Some(Self { value: estimate.value, ends: estimate.ci95.or_else(limit)? })
    }

    /// Returns whether the interval overlaps with another one.
    pub(super) fn meets(&self, [low, high]: [f64; 2]) -> bool {
        low <= self.ends[1] && self.ends[0] <= high
    }
}

impl<'a> Owned<'a> {
    /// Finds the ranges in which the sensor of a record moved.
    pub(super) fn new(real: &'a Recording) -> Self {
        let there = |channel: Channel| -> Vec<f64> {
            let values = real.values(channel).unwrap_or_default().iter().enumerate();
            values.map(|(place, value)| if real.is_missing(place) { f64::NAN } else { *value }).collect()
        };
        let columns = MOTION_CHANNELS.map(there);
        let received = (0..real.len()).filter(|place| !real.is_missing(*place)).count();
        let mut stillness = Stillness::new(real.rate_hz, received as u64);
        stillness.push(0, columns.each_ref().map(Vec::as_slice));
        Self { real, moving: stillness.settle().unwrap_or_default() }
    }

    /// Returns N (as sent), B and K of a channel. `None` if `imu-noise` states that they must not be used.
    pub(super) fn of(&self, channel: Channel) -> Option<[Option<Known>; 3]> {
        let rate_hz = self.real.rate_hz;
        let parts = self.parts(channel);
        let sums = spectral_sums(&parts, FixedPoint::for_channel(channel));
        let sampling = channel.triad().and_then(|triad| self.real.sampling.get(&triad));
        let all = All::of(channel, rate_hz, &sums, sampling);
        let samples = parts.iter().map(|part| part.values.len() as u64).sum();
        let record = Record::of(channel, rate_hz, parts, &Levels::new(rate_hz, samples), Company::Alone);
        let (NoiseParameters { usable, n, b, k, .. }, _) = record.alone(channel, rate_hz, &all);
        usable.then(|| [&n, &b, &k].map(Known::of))
    }

    /// Returns samples without gaps, motion and values that are not numbers.
    fn parts(&self, channel: Channel) -> Vec<Part> {
        let values = self.real.values(channel).unwrap_or_default();
        let moves = |place: usize| {
            let at = self.moving.partition_point(|range| range.end <= place as u64);
            self.moving.get(at).is_some_and(|range| range.contains(&(place as u64)))
        };
        let mut parts: Vec<Part> = Vec::new();
        let mut goes_on = false;
        for (place, value) in values.iter().enumerate() {
            let counts = value.is_finite() && !self.real.is_missing(place) && !moves(place);
            if counts && !goes_on {
                parts.push(Part { start_s: place as f64 / self.real.rate_hz, values: Vec::new() });
            }
            goes_on = counts;
            if let Some(part) = parts.last_mut().filter(|_| counts) {
                part.values.push(*value);
            }
        }
        parts
    }
}
