//! Drift: warm-up and creep, as distinct from a random walk.
//!
//! The levels of a walk change by independent amounts. A drift makes the changes share a direction, always (creep) or
//! at the beginning (warm-up). The changes are therefore correlated with those of a straight line and of exponentials,
//! and Student's t gives the probability of that correlation for a walk. White and flicker noise give less correlation
//! than a walk.

use super::Part;
use super::blocks::Blocks;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Total share of walks that are reported as a drift.
const BY_CHANCE: f64 = 1e-4;
/// Numbers of blocks: few for small drifts under white noise, many for fast warm-ups.
const COUNTS: [usize; 2] = [16, 64];
/// Time constants of the exponentials over the record's length.
const CONSTANTS: [f64; 7] = [1.0 / 128.0, 1.0 / 64.0, 1.0 / 32.0, 1.0 / 16.0, 1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0];
/// The time constant of the best exponential is refined to this share; otherwise the rest of a warm-up would look like
/// a walk.
const PRECISE: f64 = 1e-3;
/// An exponential has to be better than a line by this much in 2 Δ log L (1 % of χ² with one degree).
const BETTER: f64 = 6.63;

/// A drift of the level that is not noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Drift {
    /// Change over the whole record, in the channel's unit.
    pub change: f64,
    /// Time constant of a warm-up, s; absent for a steady creep, which the parameter R describes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tau_s: Option<f64>,
    /// How often a random walk shows as large a drift.
    pub p_value: f64,
    /// Begin and end of the levels in which it was found, s: the exponential counts from there.
    #[serde(skip)]
    pub(super) span_s: (f64, f64),
}

struct Candidate {
    tau: Option<f64>,
    amplitude: f64,
    fit: f64,
    p_value: f64,
}

/// Finds a drift; increments across a step (s) do not count.
pub(super) fn find(parts: &[Part], rate_hz: f64, steps_s: &[f64]) -> Option<Drift> {
    COUNTS
        .into_iter()
        .filter_map(|count| of_blocks(parts, rate_hz, count, steps_s))
        .min_by(|a, b| a.p_value.total_cmp(&b.p_value))
}

fn of_blocks(parts: &[Part], rate_hz: f64, count: usize, steps_s: &[f64]) -> Option<Drift> {
    let blocks = Blocks::of(parts, rate_hz, count)?;
    let increments = blocks.increments(steps_s);
    if increments.len() < count / 2 {
        return None;
    }
    let line = candidate(&increments, count, None)?;
    let curved = CONSTANTS
        .into_iter()
        .filter_map(|tau| candidate(&increments, count, Some(tau)))
        .max_by(|a, b| a.fit.total_cmp(&b.fit))
        .map(|best| precise(&increments, count, best));
    let best = match curved {
        Some(curved) if curved.fit > line.fit + BETTER => curved,
        _ => line,
    };
    let tried = (COUNTS.len() * (CONSTANTS.len() + 1)) as f64;
    let duration_s = blocks.length_s * count as f64;
    (best.p_value * tried < BY_CHANCE).then_some(Drift {
        change: best.amplitude,
        tau_s: best.tau.map(|tau| tau * duration_s),
        p_value: (best.p_value * tried).max(f64::MIN_POSITIVE),
        span_s: (blocks.begin_s, blocks.begin_s + duration_s),
    })
}

/// Returns the amplitude over the record of a line (`tau` None) or an exponential, by least squares on the increments.
fn candidate(increments: &[(usize, f64)], count: usize, tau: Option<f64>) -> Option<Candidate> {
    let shape = |index: usize| match tau {
        None => 1.0 / count as f64,
        Some(tau) => {
            // Means over blocks, because a time constant may be shorter than a block.
            let edge = |block: f64| (-block / count as f64 / tau).exp();
            let at = |block: f64| tau * count as f64 * (edge(block) - edge(block + 1.0));
            (at(index as f64) - at(index as f64 + 1.0)) / (1.0 - (-1.0 / tau).exp())
        }
    };
    let (mut hh, mut hd, mut dd) = (0.0, 0.0, 0.0);
    for (index, change) in increments {
        let h = shape(*index);
        hh += h * h;
        hd += h * change;
        dd += change * change;
    }
    let degrees = increments.len() as f64 - 1.0;
    let rest = dd - hd * hd / hh;
    if !(rest > 0.0 && degrees >= 4.0) {
        return None;
    }
    let t = hd / hh.sqrt() / (rest / degrees).sqrt();
    let p_value = 2.0 * StudentsT::new(0.0, 1.0, degrees).ok()?.sf(t.abs());
    let fit = increments.len() as f64 * (dd / rest).ln();
    (t.is_finite() && p_value.is_finite()).then_some(Candidate { tau, amplitude: hd / hh, fit, p_value })
}

/// Returns the time constant between its neighbours on the grid, by golden section.
fn precise(increments: &[(usize, f64)], count: usize, best: Candidate) -> Candidate {
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    let Some(tau) = best.tau else { return best };
    let at = |log_tau: f64| candidate(increments, count, Some(log_tau.exp()));
    let (mut low, mut high) = ((0.5 * tau).ln(), (2.0 * tau).ln());
    let inner = |low: f64, high: f64, share: f64| low + share * (high - low);
    let (mut left, mut right) = (at(inner(low, high, 1.0 - GOLDEN)), at(inner(low, high, GOLDEN)));
    while high - low > PRECISE {
        let (Some(one), Some(other)) = (&left, &right) else { return best };
        if one.fit > other.fit {
            high = inner(low, high, GOLDEN);
            right = left;
            left = at(inner(low, high, 1.0 - GOLDEN));
        } else {
            low = inner(low, high, 1.0 - GOLDEN);
            left = right;
            right = at(inner(low, high, GOLDEN));
        }
    }
    left.filter(|found| found.fit > best.fit).unwrap_or(best)
}

/// Subtracts a warm-up; a creep is left to R. Before the levels in which it was found, the level counts as that at
/// their beginning.
pub(super) fn subtract(parts: &mut [Part], rate_hz: f64, drift: &Drift) {
    let Some(tau_s) = drift.tau_s else { return };
    let (begin_s, end_s) = drift.span_s;
    let scale = drift.change / (1.0 - (-(end_s - begin_s) / tau_s).exp());
    for part in parts {
        let from_s = part.start_s - begin_s;
        for (index, value) in part.values.iter_mut().enumerate() {
            *value += scale * (-(from_s + index as f64 / rate_hz).max(0.0) / tau_s).exp();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Noise;
    use super::*;

    fn part(values: Vec<f64>) -> [Part; 1] {
        [Part { start_s: 0.0, values }]
    }

    #[test]
    fn a_warm_up_is_found_with_its_size_and_taken_out() {
        let mut values = Noise::new(41).sensor(100_000, 40.0, 2e-3, 5e-4, 1e-5);
        for (i, value) in values.iter_mut().enumerate() {
            *value -= 0.05 * (-(i as f64) / 40.0 / 250.0).exp();
        }
        let mut parts = part(values);
        let drift = find(&parts, 40.0, &[]).unwrap();
        assert!((drift.change / 0.05 - 1.0).abs() < 0.1, "{drift:?}");
        assert!(drift.tau_s.is_some_and(|tau| (150.0..400.0).contains(&tau)), "{drift:?}");
        let before = parts[0].values[0];
        subtract(&mut parts, 40.0, &drift);
        assert!(parts[0].values[0] - before > 0.04);
        assert!(parts[0].values[..4000].iter().sum::<f64>().abs() / 4000.0 < 0.01);
    }

    /// A stretch before the levels, too short for a level, does not move the exponential.
    #[test]
    fn a_warm_up_counts_from_where_it_was_found() {
        let mut values = Noise::new(45).sensor(100_000, 40.0, 2e-3, 5e-4, 1e-5);
        for (i, value) in values.iter_mut().enumerate() {
            *value -= 0.05 * (-(i as f64) / 40.0 / 250.0).exp();
        }
        let drift = find(&[Part { start_s: 900.0, values: values.clone() }], 40.0, &[]).unwrap();
        let short = Part { start_s: 0.0, values: vec![1.0; 40] };
        let mut parts = [short, Part { start_s: 900.0, values }];
        subtract(&mut parts, 40.0, &drift);
        assert!(parts[1].values[..4000].iter().sum::<f64>().abs() / 4000.0 < 0.01);
        assert!(parts[0].values.iter().all(|value| (value - 1.0).abs() < 0.07), "{:?}", parts[0].values);
    }

    #[test]
    fn a_creep_is_a_line_and_stays_in_the_samples() {
        let mut values = Noise::new(42).sensor(30_000, 40.0, 2e-3, 3e-4, 2e-5);
        for (i, value) in values.iter_mut().enumerate() {
            *value -= 0.037 * i as f64 / 30_000.0;
        }
        let mut parts = part(values);
        let drift = find(&parts, 40.0, &[]).unwrap();
        assert!(drift.tau_s.is_none() && (drift.change / -0.037 - 1.0).abs() < 0.1, "{drift:?}");
        let before = parts.clone();
        subtract(&mut parts, 40.0, &drift);
        assert_eq!(before, parts);
    }

    #[test]
    fn a_random_walk_is_no_drift() {
        let found = (0..200).filter(|seed| {
            let values = Noise::new(1000 + seed).sensor(4000, 1.0, 1e-3, 0.0, 1e-2);
            find(&part(values), 1.0, &[]).is_some()
        });
        assert_eq!(found.count(), 0);
    }

    /// For any time constant, the rest is small compared with a walk of the sensor's own size.
    #[test]
    fn what_is_left_of_a_warm_up_is_less_than_a_walk() {
        for (seed, (amplitude, tau_s)) in
            (50..).zip([(0.05, 250.0), (0.05, 110.0), (0.05, 41.0), (0.15, 350.0), (0.05, 700.0)])
        {
            let noise = Noise::new(seed).sensor(100_000, 40.0, 2e-3, 5e-4, 1e-5);
            let warm = |index: usize| amplitude * (-(index as f64) / 40.0 / tau_s).exp();
            let values: Vec<f64> = noise.iter().enumerate().map(|(index, value)| value - warm(index)).collect();
            let mut parts = part(values);
            let drift = find(&parts, 40.0, &[]).unwrap();
            assert!(drift.tau_s.is_some_and(|tau| (tau / tau_s - 1.0).abs() < 0.25), "{tau_s} s: {drift:?}");
            subtract(&mut parts, 40.0, &drift);
            // Over 100 s the walk itself moves by 1e-4.
            let mean = |values: &[f64], block: usize| values[block * 4000..][..4000].iter().sum::<f64>() / 4000.0;
            for block in 0..24 {
                let step = mean(&parts[0].values, block + 1) - mean(&parts[0].values, block);
                let own = mean(&noise, block + 1) - mean(&noise, block);
                assert!((step - own).abs() < 0.02 * amplitude, "{tau_s} s, block {block}: {step} {own}");
            }
        }
    }
}
