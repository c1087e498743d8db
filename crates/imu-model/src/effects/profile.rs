//! Profiles: factors at instants, linear between them and constant before the first and after the last, and noise whose
//! amplitude follows one.

use super::{Moments, Sampler, Temperature};
use serde_json::{Value, json};

/// Returns the factor at `time_s` from points [s, factor] with increasing times; 1 without points.
pub fn factor(points: &[(f64, f64)], time_s: f64) -> f64 {
    let after = points.partition_point(|point| point.0 <= time_s);
    match (after.checked_sub(1).and_then(|before| points.get(before)), points.get(after)) {
        (Some((t0, f0)), Some((t1, f1))) => f0 + (f1 - f0) * (time_s - t0) / (t1 - t0),
        (Some((_, factor)), None) | (None, Some((_, factor))) => *factor,
        (None, None) => 1.0,
    }
}

/// Returns the mean over 0…`length_s` of the `power`th power of a `factor` of time that is linear between any two
/// neighbouring `cuts` (increasing, in s). Each piece is integrated by Gauss's three points, which is exact up to the
/// fifth power.
pub(super) fn mean_power(mut cuts: Vec<f64>, length_s: f64, power: i32, factor: impl Fn(f64) -> f64) -> f64 {
    // For a length of 0, the mean is that of the first instant.
    let length_s = length_s.max(f64::MIN_POSITIVE);
    cuts.retain(|cut| *cut > 0.0 && *cut < length_s);
    cuts.insert(0, 0.0);
    cuts.push(length_s);
    let reach = 0.6_f64.sqrt();
    let piece = |from: f64, to: f64| {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let at = |offset: f64| factor(middle + offset * half).powi(power);
        half * (5.0 * at(-reach) + 8.0 * at(0.0) + 5.0 * at(reach)) / 9.0
    };
    cuts.windows(2).map(|cut| piece(cut[0], cut[1])).sum::<f64>() / length_s
}

/// Returns the [`mean_power`] of a profile's points.
pub fn mean_power_of(points: &[(f64, f64)], length_s: f64, power: i32) -> f64 {
    mean_power(points.iter().map(|point| point.0).collect(), length_s, power, |time_s| factor(points, time_s))
}

/// Returns the points in the form of a file.
pub(super) fn value(points: &[(f64, f64)]) -> Value {
    points.iter().map(|(time_s, factor)| json!([time_s, factor])).collect::<Vec<_>>().into()
}

/// Number of samples that are made at a time.
const BLOCK: usize = 256;

/// A factor, sample by sample.
pub(super) trait Factor: std::fmt::Debug + Send {
    /// Returns the factor of the next sample.
    fn next(&mut self) -> f64;
}

/// A profile's factor.
#[derive(Debug)]
pub(super) struct Course {
    level: Vec<(f64, f64)>,
    rate_hz: f64,
    index: u64,
}

impl Course {
    /// Creates the course of points [s, factor] at a rate.
    pub(super) fn new(level: &[(f64, f64)], rate_hz: f64) -> Self {
        Self { level: level.to_vec(), rate_hz, index: 0 }
    }
}

impl Factor for Course {
    fn next(&mut self) -> f64 {
        let time_s = self.index as f64 / self.rate_hz;
        self.index += 1;
        factor(&self.level, time_s)
    }
}

/// The output of another sampler, times a factor.
#[derive(Debug)]
pub(super) struct Weighted<F> {
    inner: Box<dyn Sampler>,
    factor: F,
    added: Vec<f64>,
}

impl<F: Factor> Weighted<F> {
    /// Multiplies `inner` by the factor of each sample.
    pub(super) fn new(inner: Box<dyn Sampler>, factor: F) -> Self {
        Self { inner, factor, added: Vec::with_capacity(BLOCK) }
    }
}

impl<F: Factor> Sampler for Weighted<F> {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        for block in values.chunks_mut(BLOCK) {
            self.added.clear();
            self.added.resize(block.len(), 0.0);
            self.inner.apply(&mut self.added);
            for (value, added) in block.iter_mut().zip(&self.added) {
                *value += added * self.factor.next();
            }
        }
    }
}

/// Returns the moments of normal noise of this variance times a profile's factor.
pub(super) fn moments(variance: f64, level: &[(f64, f64)], length_s: f64) -> Moments {
    let [square, fourth] = [2, 4].map(|power| mean_power_of(level, length_s, power));
    let kurtosis = (square > 0.0).then(|| 3.0 * fourth / (square * square));
    Moments { variance: variance * square, kurtosis }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_linear_between_its_points_and_constant_beyond() {
        let points = [(1.0, 1.0), (3.0, 2.0)];
        assert_eq!([0.0, 1.0, 2.0, 3.0, 9.0].map(|t| factor(&points, t)), [1.0, 1.0, 1.5, 2.0, 2.0]);
        assert_eq!(factor(&[], 5.0), 1.0);
        // 1 for a second, (1 + x/2)² over two, 4 for another.
        assert!((mean_power_of(&points, 4.0, 2) - (1.0 + 14.0 / 3.0 + 4.0) / 4.0).abs() < 1e-12);
    }
}
