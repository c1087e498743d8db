//! Detection: how the share of named effects grows with their size, and the sizes at which half and 90 % are named.
//!
//! The share is a logistic curve in the logarithm of the size. Its limits have intervals by profile likelihood. An
//! interval that does not close within the range of possible sizes is reported as none.

use super::bound::{Bound, bound};
use super::kind::Kind;
use super::limit::{STUDY, one, unit};
use serde::Serialize;

/// A size with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limit {
    /// The size.
    pub size: f64,
    /// The 95 % interval by profile likelihood; none if it is not determined.
    pub ci95: Option<[f64; 2]>,
}

/// The sizes at which an effect is named, at the study's length.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Detection {
    /// The unit of the sizes; σ is the white part's standard deviation per sample.
    pub unit: &'static str,
    /// The length to which sizes refer, in samples.
    pub samples: usize,
    /// The study's 90 % limit, to which other sizes are relative.
    pub limit: f64,
    /// The size at which half are named; none if nearly all or none are named.
    pub size_50: Option<Limit>,
    /// The size at which 90 % are named.
    pub size_90: Option<Limit>,
    /// The lower bound for every test at 90 % ([`super::bound`]).
    pub bound_90: Option<f64>,
    /// The reason why there is no bound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_bound: Option<&'static str>,
}

impl Detection {
    /// Computes the limits from sizes over the limit, and whether each was named.
    pub fn of(kind: Kind, sizes: &[(f64, bool)]) -> Self {
        let limit = one(kind);
        let scaled = |of: Limit| Limit { size: of.size * limit, ci95: of.ci95.map(|ends| ends.map(|end| end * limit)) };
        let [half, most] = limits(sizes).map_or([None, None], |found| found.map(|of| Some(scaled(of))));
        let (bound_90, no_bound) = match bound(kind) {
            Bound::Size(size) => (Some(size), None),
            Bound::Meaningless(reason) => (None, Some(reason)),
        };
        Self { unit: unit(kind), samples: STUDY, limit, size_50: half, size_90: most, bound_90, no_bound }
    }
}

/// Minimum number of right and of wrong cases that determine the curve.
const LEAST: usize = 3;
/// The range outside which no limit is reported: far beyond the sizes that occur.
const REPORTED: [f64; 2] = [0.05, 100.0];
/// Standard deviation of a weak prior that the slope is a few: separable data would otherwise make it infinite.
const SLOPE: f64 = 3.0;
const WEIGHT: f64 = 0.02;
/// Range of slopes tried for an interval.
const SLOPES: [f64; 2] = [0.05, 80.0];
/// Half of χ²'s 95 % point with one degree of freedom: the permitted decrease of a profile, nats.
const FALL: f64 = 1.920_729;

/// Returns the sizes at which a logistic curve in the logarithm of the size passes ½ and 0.9; `None` if too few are
/// right or wrong.
pub(super) fn limits(sizes: &[(f64, bool)]) -> Option<[Limit; 2]> {
    let right = sizes.iter().filter(|(_, right)| *right).count();
    if right < LEAST || sizes.len() - right < LEAST {
        return None;
    }
    let (level, slope) = fitted(sizes);
    let odds = [0.0, 9.0_f64.ln()];
    let best = log_likelihood(sizes, level, slope);
    let found = odds.map(|odds| ((odds - level) / slope).exp());
    // A falling curve, or one that passes ½ far outside the sizes that occurred, determines no limit.
    let is_determined = slope > 0.0 && found[0] > REPORTED[0] && found[1] < REPORTED[1];
    is_determined.then(|| [0, 1].map(|at| Limit { size: found[at], ci95: interval(sizes, odds[at], found[at], best) }))
}

/// Returns level and slope of the log odds in the logarithm of the size, by Newton's method.
fn fitted(sizes: &[(f64, bool)]) -> (f64, f64) {
    let (mut level, mut slope) = (0.0, 1.0);
    for _ in 0..100 {
        let (mut gradient, mut curvature) = ([0.0, -WEIGHT * (slope - SLOPE)], [1e-9, 0.0, WEIGHT]);
        for (size, right) in sizes {
            let x = size.ln();
            let p = 1.0 / (1.0 + (-(level + slope * x)).exp());
            let off = f64::from(u8::from(*right)) - p;
            gradient[0] += off;
            gradient[1] += off * x;
            let w = p * (1.0 - p);
            curvature[0] += w;
            curvature[1] += w * x;
            curvature[2] += w * x * x;
        }
        let det = curvature[0] * curvature[2] - curvature[1] * curvature[1];
        let step = [
            (curvature[2] * gradient[0] - curvature[1] * gradient[1]) / det,
            (curvature[0] * gradient[1] - curvature[1] * gradient[0]) / det,
        ];
        level += step[0].clamp(-2.0, 2.0);
        slope += step[1].clamp(-2.0, 2.0);
    }
    (level, slope)
}

fn log_likelihood(sizes: &[(f64, bool)], level: f64, slope: f64) -> f64 {
    let one = |(size, right): &(f64, bool)| {
        let odds = level + slope * size.ln();
        let against = if *right { -odds } else { odds };
        // ln(1 + e^x) without overflow.
        -(against.max(0.0) + (-against.abs()).exp().ln_1p())
    };
    sizes.iter().map(one).sum::<f64>() - 0.5 * WEIGHT * (slope - SLOPE).powi(2)
}

/// Returns the sizes on both sides at which the profile at these log odds has fallen as far as 95 % allow.
///
/// # Source
/// D. Venzon, S. Moolgavkar, Appl. Statist. 37 (1988) 87.
fn interval(sizes: &[(f64, bool)], odds: f64, found: f64, best: f64) -> Option<[f64; 2]> {
    // The best slope of a curve through this size, by golden section in its logarithm: the log-likelihood is concave in
    // the logarithm.
    let profile = |size: f64| {
        let of = |log_slope: f64| {
            let slope = log_slope.exp();
            log_likelihood(sizes, odds - slope * size.ln(), slope)
        };
        let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
        let (mut low, mut high) = (SLOPES[0].ln(), SLOPES[1].ln());
        for _ in 0..40 {
            let (one, other) = (high - ratio * (high - low), low + ratio * (high - low));
            if of(one) > of(other) { high = other } else { low = one }
        }
        of(0.5 * (low + high))
    };
    let end = |outside: f64| {
        if best - profile(outside) < FALL {
            return None;
        }
        let (mut inside, mut outside) = (found, outside);
        for _ in 0..40 {
            let middle = (inside * outside).sqrt();
            if best - profile(middle) < FALL { inside = middle } else { outside = middle }
        }
        Some((inside * outside).sqrt())
    };
    Some([end(REPORTED[0].min(found))?, end(REPORTED[1].max(found))?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Draw;

    fn drawn(seed: u64, count: usize) -> Vec<(f64, bool)> {
        // 1/(1 + exp(−4 ln(x/1.2))): ½ at 1.2, 0.9 at 1.2·9^(1/4).
        let mut draw = Draw::device(seed, 1, "curve");
        let one = |_| {
            let size = draw.log_uniform(0.5, 10.0);
            (size, draw.chance(1.0 / (1.0 + (size / 1.2_f64).powf(-4.0))))
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn a_detection_curve_gives_its_limits_back() {
        let sizes = drawn(1, 20_000);
        let [half, most] = limits(&sizes).unwrap();
        assert!((half.size / 1.2 - 1.0).abs() < 0.03 && (most.size / (1.2 * 9.0_f64.powf(0.25)) - 1.0).abs() < 0.04);
        assert_eq!(limits(&sizes.iter().map(|(size, _)| (*size, true)).collect::<Vec<_>>()), None);
    }

    #[test]
    fn intervals_hold_the_truth_in_nineteen_of_twenty() {
        let [truth_50, truth_90] = [1.2, 1.2 * 9.0_f64.powf(0.25)];
        let (mut held, mut total) = ([0_u32; 2], [0_u32; 2]);
        for seed in 0..150 {
            let Some(found) = limits(&drawn(seed, 80)) else { continue };
            for (at, (of, truth)) in found.iter().zip([truth_50, truth_90]).enumerate() {
                if let Some([low, high]) = of.ci95 {
                    total[at] += 1;
                    held[at] += u32::from(low <= truth && truth <= high);
                }
            }
        }
        for (held, total) in held.into_iter().zip(total) {
            let share = f64::from(held) / f64::from(total);
            assert!(total > 130 && (0.89..=1.0).contains(&share), "{held} of {total}");
        }
    }

    #[test]
    fn few_cases_leave_an_interval_open() {
        let few = [(0.6, false), (0.7, true), (0.9, false), (1.0, true), (1.1, false), (1.2, true)];
        if let Some([half, _]) = limits(&few) {
            assert_eq!(half.ci95, None);
        }
    }

    #[test]
    fn sizes_are_reported_in_the_kinds_own_unit() {
        let found = Detection::of(Kind::Tone, &drawn(2, 4000));
        let half = found.size_50.unwrap();
        assert!((half.size / (1.2 * 0.06) - 1.0).abs() < 0.1 && found.limit == 0.06);
        assert!(half.ci95.is_some_and(|[low, high]| low < half.size && half.size < high));
        assert!(found.bound_90.unwrap() < half.size && found.no_bound.is_none());
        let certain = Detection::of(Kind::HeldSamples, &[]);
        assert!(certain.bound_90.is_none() && certain.no_bound.is_some() && certain.size_50.is_none());
    }
}
