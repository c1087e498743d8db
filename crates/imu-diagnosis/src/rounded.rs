//! Rounded values: the possible values before rounding, if a coarse sensor sends the nearest multiple of its step.
//!
//! Rounded values of few levels are not normal noise: they repeat, they have other tails, and their variance depends on the
//! position of the level between two multiples. The values before rounding have none of these properties, and each is known to
//! lie within half a step of the value that was sent.

use super::filling::stream;
use super::grid::Grid;
use super::law::{Data, Law};
use super::prepared::{Prepared, base_of};
use super::transform::Cosines;
use imu_model::simulator::SensorModel;
use statrs::distribution::{ContinuousCDF, Normal};
use std::collections::{BTreeMap, BTreeSet};

/// Random stream of the draws.
const ROUNDED: u16 = 5;

/// The information of rounded values about white noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct White {
    /// The standard deviation, U.
    pub(super) deviation: f64,
    /// The information on the logarithm of the deviation in the drawn values, as a part of that in the values before
    /// rounding.
    pub(super) share: f64,
}

/// Returns the white noise of coarse values (U): so many neighbours are equal that rounding shows as more than noise,
/// from steps of about 1.3 standard deviations on. `None` for other values. The places `left_out`, in order, do not
/// count.
///
/// Maximises the likelihood of the counts, by blocks of time with separate levels. If only two levels are sent, a wider
/// noise and another level look the same: the estimate is then about the model's `declared` (a standard deviation, U).
pub(super) fn white_of(values: &[f64], step: f64, left_out: &[usize], declared: f64) -> Option<White> {
    const EQUAL: f64 = 0.35;
    const BLOCKS: usize = 8;
    /// Standard deviation of the prior of the model's deviation, ln.
    const ABOUT: f64 = 0.7;
    /// Range of the standard deviation, in steps.
    const RANGE: [f64; 2] = [1.0 / 12.0, 1.5];
    const AROUND: f64 = 0.05;
    let known = |t: &usize| left_out.binary_search(t).is_err() && values[*t].is_finite();
    let pairs = || (1..values.len()).filter(|t| known(&(t - 1)) && known(t));
    let equal = pairs().filter(|t| values[*t] == values[t - 1]).count();
    if equal as f64 <= EQUAL * pairs().count() as f64 {
        return None;
    }
    let normal = Normal::standard();
    // Levels in steps, and how often each was sent.
    let first = (0..values.len()).find(known).map(|t| values[t])?;
    let size = values.len().div_ceil(BLOCKS);
    let of_block = |block: usize| {
        let mut counts: BTreeMap<i64, f64> = BTreeMap::new();
        for t in (block * size..((block + 1) * size).min(values.len())).filter(known) {
            *counts.entry(((values[t] - first) / step).round() as i64).or_default() += 1.0;
        }
        counts
    };
    let blocks: Vec<BTreeMap<i64, f64>> = (0..BLOCKS).map(of_block).collect();
    let likelihood = |deviation: f64| -> f64 {
        let of_block = |counts: &BTreeMap<i64, f64>| {
            let (sum, count) = counts.iter().fold((0.0, 0.0), |(s, c), (level, n)| (s + n * *level as f64, c + n));
            let at = |middle: f64| -> f64 {
                let of = |(level, count): (&i64, &f64)| {
                    // The side nearer to the middle, where the share is exact.
                    let far = (*level as f64 - middle).abs();
                    let [near, beyond] = [0.5 - far, -0.5 - far].map(|end| normal.cdf(end / deviation));
                    count * (near - beyond).max(1e-12).ln()
                };
                counts.iter().map(of).sum()
            };
            let middle = sum / f64::max(count, 1.0);
            greatest([middle - 1.0, middle + 1.0], at).1
        };
        let off = (step * deviation / declared).ln() / ABOUT;
        blocks.iter().map(of_block).sum::<f64>() - if off.is_finite() { 0.5 * off * off } else { 0.0 }
    };
    let (logarithm, most) = greatest(RANGE.map(f64::ln), |logarithm| likelihood(logarithm.exp()));
    let beside = |by: f64| likelihood((logarithm + by).exp());
    let curvature = (2.0 * most - beside(AROUND) - beside(-AROUND)) / (AROUND * AROUND);
    let share = (curvature / (2.0 * values.len() as f64)).clamp(1e-6, 1.0);
    // Hidden values are drawn, which adds as much uncertainty again.
    Some(White { deviation: step * logarithm.exp(), share: share / (2.0 - share) })
}

/// Returns the place and the value of the maximum of a function with one maximum, by the golden section.
fn greatest([mut low, mut high]: [f64; 2], of: impl Fn(f64) -> f64) -> (f64, f64) {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    const ROUNDS: usize = 22;
    let inner = |low: f64, high: f64| [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let [mut left, mut right] = inner(low, high);
    let (mut at_left, mut at_right) = (of(left), of(right));
    for _ in 0..ROUNDS {
        if at_left < at_right {
            (low, left, at_left) = (left, right, at_right);
            right = inner(low, high)[1];
            at_right = of(right);
        } else {
            (high, right, at_right) = (right, left, at_left);
            left = inner(low, high)[0];
            at_left = of(left);
        }
    }
    if at_left < at_right { (right, at_right) } else { (left, at_left) }
}

/// Draws samples that were rounded to multiples of `step` (U) from their distribution given the sent values. Samples that are
/// left out may take any value.
///
/// Gibbs sampling (Tanner and Wong 1987, J. Am. Stat. Assoc. 82) under the model's own law, with its levels fitted on
/// the way: the part above the white part, lines included, is drawn given all samples; then each sample is drawn given
/// that part and its bounds.
pub(super) fn unround(prepared: &mut Prepared, sim: &SensorModel, step: f64, white: White) {
    const ROUNDS: usize = 25;
    /// The number of samples that all rounds together may draw.
    const WORK: usize = 20_000_000;
    const FEWEST: usize = 5;
    /// A coefficient belongs to a line if it exceeds the largest one of chance by this many nats.
    const BEYOND: f64 = 12.0;
    let n = prepared.samples.len();
    let normal = Normal::standard();
    let mut stream = stream(n, prepared.channel as u32, ROUNDED);
    let mut transform = Cosines::new(n);
    let grid = Grid::new(n, sim.rate_hz, &[]);
    let base = base_of(sim, prepared, &grid, &BTreeSet::new());
    let width = step / prepared.scale;
    let mut last = 0.0;
    let mut sent: Vec<(f64, bool)> = Vec::with_capacity(n);
    for (t, value) in prepared.samples.iter().enumerate() {
        let known = prepared.outliers.binary_search(&t).is_err();
        last = if known { *value } else { last };
        sent.push((last, known));
    }
    let mut drawn: Vec<f64> = sent.iter().map(|(value, _)| value + width * (stream.uniform() - 0.5)).collect();
    let mut law = Law { levels: prepared.declared.levels, terms: Vec::new(), quiet: prepared.declared.quiet };
    law.levels[0] = 2.0 * (white.deviation / prepared.scale).ln() - sim.rate_hz.ln();
    for round in 0..ROUNDS.min((WORK / n).max(FEWEST)) {
        let mut above = drawn.clone();
        transform.forward(&mut above);
        let power = grid.power(&above);
        let data = Data { grid: &grid, power: &power, worth: &grid.counts, base: &base, priors: &prepared.priors };
        // The first draws lie anywhere within the steps, and carry no information about the noise.
        if round >= FEWEST {
            law = law.fit(data).law;
        }
        let spectrum = grid.fill(&law.logarithms(data));
        let white = spectrum.iter().copied().fold(f64::INFINITY, f64::min);
        let line = 2.0 * ((n as f64).ln() + BEYOND);
        for (c, s) in above.iter_mut().zip(&spectrum).skip(1) {
            if *c * *c < line * s || round < FEWEST {
                let share = (1.0 - white / s).max(0.0);
                *c = share * *c + (share * white).sqrt() * stream.normal();
            }
        }
        transform.backward(&mut above);
        let spread = white.sqrt();
        for ((value, level), (sent, known)) in drawn.iter_mut().zip(&above).zip(&sent) {
            let bound = |side: f64| if *known { (sent + side * width - level) / spread } else { side * f64::INFINITY };
            let (low, high) = (bound(-0.5), bound(0.5));
            // Above the middle, the mirror image's share is the exact one.
            let sign = if low > 0.0 { -1.0 } else { 1.0 };
            let [from, to] = if low > 0.0 { [-high, -low] } else { [low, high] };
            let (below, within) = (normal.cdf(from), normal.cdf(to) - normal.cdf(from));
            let share = (below + within * stream.uniform()).clamp(1e-300, 1.0 - 1e-16);
            *value = level + sign * spread * normal.inverse_cdf(share).clamp(from, to);
        }
    }
    prepared.samples = drawn;
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    #[test]
    fn white_noise_is_known_behind_its_rounding() {
        let n = 30_000;
        let rounded = |step: f64, middle: f64| -> Vec<f64> {
            let mut stream = Stream::new(7, StreamId { owner: 0, effect: 0, instance: 0 });
            (0..n).map(|_| ((middle + stream.normal()) / step).round() * step).collect()
        };
        for (step, middle) in [(1.5, 0.3), (2.0, 0.0), (3.0, 0.9), (4.0, 0.8), (6.0, 0.3)] {
            let White { deviation, share } = white_of(&rounded(step, middle), step, &[], 1.6).unwrap();
            let error = (0.5 / (n as f64 * share)).sqrt();
            assert!((deviation - 1.0).abs() < 3.5 * error + 1e-3, "{step}: {deviation} ± {error}");
            assert!(error < 0.1, "{step}: {error}");
        }
        // Two levels show only their shares.
        let White { deviation, share } = white_of(&rounded(12.0, 5.8), 12.0, &[], 1.1).unwrap();
        assert!((deviation - 1.1).abs() < 0.3 && share < 1e-3, "{deviation} {share}");
        assert_eq!(white_of(&rounded(1.0, 0.0), 1.0, &[], 1.0), None);
    }
}
