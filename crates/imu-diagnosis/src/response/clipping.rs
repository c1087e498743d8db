//! Clipping: samples at the sensor's range are found before any regression and left out of it without bias.
//!
//! A clipped sample is an exact tie at the largest magnitude shown. Leaving out just the ties would bias the rest:
//! close to the limit, only samples whose noise points away from it would remain. The fit therefore leaves out every
//! sample whose *response* comes within five standard deviations of the limit, whatever its value.
//!
//! The samples that are left out are bridged: a straight line joins the means of the samples on both sides. The same linear rule
//! acts on samples and on design columns alike, so that the fit stays unbiased. Its effect on the noise's covariance is carried
//! through to the standard errors exactly.

use imu_model::effects::TriadEffect;
use imu_model::effects::triad::Axes;
use std::ops::Range;
use std::sync::Arc;

/// Minimum number of ties at the limit; fewer may be chance.
const LEAST_TIES: usize = 3;
/// Number of largest magnitudes that are examined for repeats due to rounding.
const TOP_VALUES: usize = 200;
/// Minimum share of repeated values among them for a record that counts as rounded.
const ROUNDED_SHARE: f64 = 0.05;
/// Minimum number of ties for rounded values, and minimum ratio to the ties of any value just below the limit.
const LEAST_ROUNDED_TIES: usize = 20;
const TIES_OVER_OTHERS: usize = 3;
/// Number of values just below the limit.
const VALUES_BELOW: usize = 10;
/// Minimum number of rounding steps over which the reference runs while the samples stay at the limit.
const STEPS_RUN: f64 = 3.0;
/// Distance that a response keeps from the limit, in standard deviations of single samples.
const MARGIN_DEVIATIONS: f64 = 5.0;
/// Samples averaged on either side of a bridge: enough to calm white noise, and short against most motions.
const PIER: usize = 16;

/// The range that a triad's samples show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clipping {
    /// The largest magnitude shown, U; exact.
    pub limit: f64,
    /// Samples at the limit, per axis.
    pub ties: [usize; 3],
}

impl Clipping {
    /// Returns the limit that these samples show. `input` is the reference of the same triad. Rounded values repeat at
    /// their largest even without a limit; only a reference that runs on while they stay shows a limit.
    pub(super) fn find(samples: [&[f64]; 3], input: &[Axes]) -> Option<Self> {
        let magnitudes = samples.iter().flat_map(|axis| axis.iter().map(|value| value.abs()));
        let limit = magnitudes.fold(0.0, f64::max);
        let mut ties = [0; 3];
        let mut run: Option<(f64, f64)> = None;
        for index in 0..input.len() {
            // A sample sent again repeats every axis.
            let again = index > 0 && samples.iter().all(|axis| axis[index] == axis[index - 1]);
            for axis in 0..3 {
                if samples[axis][index].abs() == limit && !again {
                    ties[axis] += 1;
                    let felt = input[index][axis].abs();
                    let (low, high) = run.unwrap_or((felt, felt));
                    run = Some((low.min(felt), high.max(felt)));
                }
            }
        }
        let (low, high) = run?;
        if limit <= 0.0 || ties.iter().sum::<usize>() < LEAST_TIES {
            return None;
        }
        let clipped = match rounding(samples, limit) {
            None => true,
            Some(rounded) => {
                let ties: usize = ties.iter().sum();
                let piled = ties >= LEAST_ROUNDED_TIES && ties > TIES_OVER_OTHERS * rounded.most_below;
                piled && high - low > STEPS_RUN * rounded.step
            }
        };
        clipped.then_some(Self { limit, ties })
    }

    /// Returns the limit that these samples show, or a known one that they reach.
    pub(super) fn find_or_known(samples: [&[f64]; 3], input: &[Axes], known: &[Arc<dyn TriadEffect>]) -> Option<Self> {
        Self::find(samples, input).or_else(|| {
            let limit = known.iter().filter_map(|effect| effect.range()).reduce(f64::min)?;
            let ties = samples.map(|axis| axis.iter().filter(|value| value.abs() >= limit).count());
            (ties != [0; 3]).then_some(Self { limit, ties })
        })
    }
}

/// Returns whether a sample is clipped or its response is so close to the limit that its noise might be.
pub(super) fn is_near(limit: f64, shown: f64, response: Option<f64>, deviation: f64) -> bool {
    shown.abs() >= limit || response.is_some_and(|of| of.abs() > limit - MARGIN_DEVIATIONS * deviation)
}

/// The rounding of values.
struct Rounded {
    step: f64,
    /// How often the most frequent of the values just below the limit occurs.
    most_below: usize,
}

/// Returns the rounding of the values below the limit; `None` if they hardly repeat.
fn rounding(samples: [&[f64]; 3], limit: f64) -> Option<Rounded> {
    let mut below: Vec<f64> =
        samples.iter().flat_map(|axis| axis.iter().map(|value| value.abs()).filter(|value| *value < limit)).collect();
    below.sort_by(|one, other| other.total_cmp(one));
    let mut counts: Vec<(f64, usize)> = Vec::new();
    let (mut looked, mut repeated) = (0, 0);
    for same in below.chunk_by(|one, other| one == other) {
        if counts.len() == TOP_VALUES {
            break;
        }
        if looked < TOP_VALUES {
            looked += same.len();
            repeated += if same.len() > 1 { same.len() } else { 0 };
        }
        counts.push((same[0], same.len()));
    }
    if repeated as f64 <= ROUNDED_SHARE * looked as f64 {
        return None;
    }
    let values = std::iter::once(limit).chain(counts.iter().map(|(value, _)| *value));
    let steps = values.zip(&counts).map(|(above, (value, _))| above - value);
    let step = Some(steps.fold(f64::INFINITY, f64::min)).filter(|step| step.is_finite())?;
    let most_below = counts.iter().take(VALUES_BELOW).map(|(_, count)| *count).max().unwrap_or(0);
    Some(Rounded { step, most_below })
}

/// A stretch that is left out, with the samples from which it is bridged.
#[derive(Debug, Clone)]
struct Bridge {
    out: Range<usize>,
    before: Range<usize>,
    after: Range<usize>,
}

/// The stretches of one axis that are left out.
#[derive(Debug, Clone, Default)]
pub(super) struct Bridges {
    bridges: Vec<Bridge>,
}

impl Bridges {
    /// Creates bridges from an iterator over whether each sample is left out.
    pub(super) fn new(out: impl Iterator<Item = bool>) -> Self {
        let mut runs: Vec<Range<usize>> = Vec::new();
        let mut length = 0;
        for (index, out) in out.enumerate() {
            length = index + 1;
            if out {
                match runs.last_mut() {
                    Some(run) if run.end == index => run.end = index + 1,
                    _ => runs.push(index..index + 1),
                }
            }
        }
        let ends = |place: usize| runs.get(place).map_or(length, |run| run.start);
        let bridge = |(place, run): (usize, &Range<usize>)| {
            let from = if place == 0 { 0 } else { runs[place - 1].end };
            Bridge {
                out: run.clone(),
                before: from.max(run.start.saturating_sub(PIER))..run.start,
                after: run.end..ends(place + 1).min(run.end + PIER),
            }
        };
        Self { bridges: runs.iter().enumerate().map(bridge).collect() }
    }

    /// Returns the number of samples that are left out.
    pub(super) fn count(&self) -> usize {
        self.bridges.iter().map(|bridge| bridge.out.len()).sum()
    }

    /// Returns the stretches, in order.
    pub(super) fn stretches(&self) -> Vec<Range<usize>> {
        self.bridges.iter().map(|bridge| bridge.out.clone()).collect()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.bridges.is_empty()
    }

    /// Fills the bridges in a column.
    pub(super) fn fill(&self, values: &mut [f64]) {
        for bridge in &self.bridges {
            let mean = |of: &Range<usize>| values[of.clone()].iter().sum::<f64>() / of.len().max(1) as f64;
            let (before, after) = (mean(&bridge.before), mean(&bridge.after));
            for index in bridge.out.clone() {
                let (one, other) = bridge.shares(index);
                values[index] = one * before + other * after;
            }
        }
    }

    /// Applies the transpose of [`Bridges::fill`].
    pub(super) fn fill_transposed(&self, values: &mut [f64]) {
        for bridge in &self.bridges {
            let (mut before, mut after) = (0.0, 0.0);
            for index in bridge.out.clone() {
                let (one, other) = bridge.shares(index);
                before += one * values[index];
                after += other * values[index];
                values[index] = 0.0;
            }
            for (of, sum) in [(&bridge.before, before), (&bridge.after, after)] {
                let share = sum / of.len().max(1) as f64;
                values[of.clone()].iter_mut().for_each(|value| *value += share);
            }
        }
    }
}

impl Bridge {
    /// Returns the weights of the means before and after at a place on the bridge.
    fn shares(&self, index: usize) -> (f64, f64) {
        let centre = |of: &Range<usize>| 0.5 * (of.start + of.end - 1) as f64;
        match (self.before.is_empty(), self.after.is_empty()) {
            (true, true) => (0.0, 0.0),
            (true, false) => (0.0, 1.0),
            (false, true) => (1.0, 0.0),
            (false, false) => {
                let (from, to) = (centre(&self.before), centre(&self.after));
                let share = (index as f64 - from) / (to - from);
                (1.0 - share, share)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bridge_is_a_line_between_the_means_of_both_sides() {
        let out = (0..100).map(|index| (40..50).contains(&index) || index >= 98);
        let bridges = Bridges::new(out);
        assert_eq!(bridges.count(), 12);
        let line = |index: usize| 3.0 - 0.5 * index as f64;
        let mut values: Vec<f64> = (0..100).map(line).collect();
        values[40..50].fill(99.0);
        values[98..].fill(99.0);
        bridges.fill(&mut values);
        for (index, value) in values.iter().enumerate().take(98) {
            assert!((value - line(index)).abs() < 1e-12, "{index}");
        }
        let mean = values[82..98].iter().sum::<f64>() / 16.0;
        assert!((values[98] - mean).abs() < 1e-12 && values[98] == values[99]);
    }

    #[test]
    fn the_transpose_is_one() {
        let bridges = Bridges::new((0..60).map(|index| index < 3 || (20..31).contains(&index) || index == 35));
        let one: Vec<f64> = (0..60).map(|index| f64::from(index * index % 17)).collect();
        let other: Vec<f64> = (0..60).map(|index| f64::from(index * 7 % 13)).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (mut filled, mut spread) = (one.clone(), other.clone());
        bridges.fill(&mut filled);
        bridges.fill_transposed(&mut spread);
        assert!((dot(&filled, &other) - dot(&one, &spread)).abs() < 1e-9);
    }

    #[test]
    fn ties_at_the_largest_value_are_a_limit_unless_the_record_is_rounded_and_lies_still() {
        let course = |index: usize| 10.0 * (0.1 * index as f64).sin();
        let noise = |index: usize| 1e-3 * ((index * 7919) % 1009) as f64;
        let input: Vec<Axes> = (0..400).map(|index| [course(index), 0.0, 0.0]).collect();
        let quiet: Vec<f64> = (0..400).map(noise).collect();
        let clipped: Vec<f64> = (0..400).map(|index| (course(index) + noise(index)).clamp(-8.0, 8.0)).collect();
        let found = Clipping::find([&clipped, &quiet, &quiet], &input).unwrap();
        assert_eq!(found.limit, 8.0);
        assert!(found.ties[0] > 20 && found.ties[1] == 0);
        let free: Vec<f64> = (0..400).map(|index| course(index) + noise(index)).collect();
        assert_eq!(Clipping::find([&free, &quiet, &quiet], &input), None);
        // At rest and rounded to a tenth, most samples have one value.
        let rest = vec![[9.8, 0.0, 0.0]; 400];
        let rounded: Vec<f64> = (0..400).map(|index| ((9.76 + 0.1 * noise(index)) * 10.0).round() / 10.0).collect();
        assert_eq!(Clipping::find([&rounded, &quiet, &quiet], &rest), None);
        let rounded: Vec<f64> = clipped.iter().map(|value| (value * 10.0).round() / 10.0).collect();
        assert_eq!(Clipping::find([&rounded, &quiet, &quiet], &input).unwrap().limit, 8.0);
    }
}
