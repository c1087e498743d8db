//! Outliers and tails: the distribution of the residual's single samples.

use super::{Candidate, Kind};
use crate::averages::{MEDIAN, median};
use crate::explanation::{Explanation, SpikeLaw};
use crate::series::Series;
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

/// Returns ln of the ratio of a normal density to the standard one, at the square of a value.
fn normal(square: f64, variance: f64) -> f64 {
    0.5 * square * (1.0 - 1.0 / variance) - 0.5 * variance.ln()
}

/// A mixture of two normal distributions about 0.
struct Mixture {
    /// Nats gained over one normal distribution.
    gain: f64,
    /// Share of values that belong to the wide distribution.
    share: f64,
    wide: f64,
    core: f64,
}

impl Mixture {
    /// Fits values with these squares by maximum likelihood.
    fn of(squares: &[f64]) -> Self {
        const ROUNDS: usize = 200;
        const LARGEST_SHARE: f64 = 0.12;
        let n = squares.len() as f64;
        let plain = squares.iter().sum::<f64>() / n;
        let reference: f64 = squares.iter().map(|a| normal(*a, plain)).sum();
        // The start is the median, so that many outliers do not hide themselves.
        let mut core = median(&mut squares.to_vec()) / MEDIAN;
        let mut share = (squares.iter().filter(|a| **a > 12.0 * core).count() as f64 / n).clamp(2.0 / n, LARGEST_SHARE);
        let mut wide = 40.0 * core;
        let mut gain = f64::NEG_INFINITY;
        let (large, small): (Vec<f64>, Vec<f64>) = squares.iter().partition(|a| **a > LARGE * core);
        let (small_count, small_sum) = (small.len() as f64, small.iter().sum::<f64>());
        for _ in 0..ROUNDS {
            let (mut total, mut weight, mut of_wide, mut of_core) = (0.0, 0.0, 0.0, 0.0);
            let (ln_share, ln_rest) = (share.ln(), (-share).ln_1p());
            let (half_core, half_wide) = (0.5 * core.ln(), 0.5 * wide.ln());
            // The others belong to the core: their sum is known.
            total += small_count * (ln_rest - half_core) - 0.5 * small_sum / core + 0.5 * small_sum;
            of_core += small_sum;
            for a in &large {
                let inside = ln_rest - half_core - 0.5 * a / core;
                let outside = ln_share - half_wide - 0.5 * a / wide;
                let difference = outside - inside;
                // Neither form overflows, however far out the sample is.
                let chance = 1.0 / (1.0 + (-difference).exp());
                let log = inside.max(outside) + (-difference.abs()).exp().ln_1p();
                total += log + 0.5 * a;
                weight += chance;
                of_wide += chance * a;
                of_core += (1.0 - chance) * a;
            }
            let now = total - reference;
            share = (weight / n).clamp(0.5 / n, LARGEST_SHARE);
            wide = (of_wide / weight.max(1e-9)).max(9.0 * core);
            core = of_core / (n - weight);
            if (now - gain).abs() < 1e-3 {
                gain = now;
                break;
            }
            gain = now;
        }
        Self { gain, share, wide, core }
    }

    /// Returns whether a value with this square more probably belongs to the wide distribution.
    fn is_wide(&self, square: f64) -> bool {
        let outside = self.share.ln() - 0.5 * self.wide.ln() - 0.5 * square / self.wide;
        outside > (-self.share).ln_1p() - 0.5 * self.core.ln() - 0.5 * square / self.core
    }
}

/// Squares above this multiple of the usual variance may be spikes.
const LARGE: f64 = 5.0;

/// Searches for rare values of a larger variance: a mixture of two normal distributions.
///
/// If such values come in groups, a group with one value that stands out is a spike. The other groups are stretches of noise,
/// which this function ignores.
pub fn spikes(series: &Series<'_>) -> Option<Candidate> {
    /// Least number of samples that are not in or near a stretch.
    const FEWEST: usize = 128;
    let mut explanation = series.explanation.clone();
    if explanation.tails.is_some() || explanation.spikes.is_some() {
        return None;
    }
    // Squares that do not count are not a number.
    let counts = |(e, near): (&f64, bool)| if near { f64::NAN } else { e * e };
    let mut squares: Vec<f64> = series.innovations().iter().zip(series.near_stretches()).map(counts).collect();
    let n = squares.len() as f64;
    let there = |squares: &[f64]| -> Vec<f64> { squares.iter().copied().filter(|square| !square.is_nan()).collect() };
    let counted = there(&squares);
    if counted.len() < FEWEST {
        return None;
    }
    let mut mixture = Mixture::of(&counted);
    let wide = |mixture: &Mixture, squares: &[f64]| -> Vec<usize> {
        squares.iter().enumerate().filter(|(_, a)| mixture.is_wide(**a)).map(|(t, _)| t).collect()
    };
    let mut flagged = wide(&mixture, &squares);
    let mut spoilt: Vec<usize> = Vec::new();
    if clustered(&flagged, n) {
        let flat;
        (spoilt, flat) = beside_peaks(&flagged, &squares);
        // Squares of these samples do not count, nor those of samples near a stretch, whose ends are soft.
        spoilt.iter().for_each(|place| squares[*place] = f64::NAN);
        for place in flat {
            squares[place.saturating_sub(FAR)..(place + FAR).min(n as usize)].fill(f64::NAN);
        }
        let left = there(&squares);
        if 2 * left.len() < counted.len() {
            return None;
        }
        mixture = Mixture::of(&left);
        flagged = wide(&mixture, &squares);
        if clustered(&flagged, n) {
            return None;
        }
    }
    let Mixture { gain, share, wide, core } = mixture;
    // A candidate that is not worth a nat is not examined more closely.
    let reach = series.reach();
    let there = there(&squares).len() as f64;
    let samples = reach.max(1) + spoilt.len().div_ceil(flagged.len().max(1));
    let hopeless = SpikeLaw { rate: share, size: wide.sqrt(), variance: wide, relative_error: 0.5, samples };
    let large: Vec<f64> = squares.iter().copied().filter(|a| *a > LARGE * core).collect();
    explanation.spikes = Some(if gain < 1.0 {
        hopeless
    } else {
        SpikeLaw { samples, ..spike_law(series, &large, [core, wide], there) }
    });
    explanation.leave_out(spoilt);
    // Behind a filter, each spike spoils as many samples as the filter reaches.
    explanation.leave_out(flagged.into_iter().flat_map(|at| at..(at + reach.max(1)).min(series.len())));
    Some(Candidate::missing(Kind::Spikes, gain, explanation))
}

/// Places within this many samples form one group.
const NEAR: usize = 4;
/// The longest reach of a spike's effect on its neighbours behind a filter that is not known yet, samples.
const FAR: usize = 64;

/// Returns the places beside the peak of a group that has one, and the places of large groups without a peak.
fn beside_peaks(places: &[usize], squares: &[f64]) -> (Vec<usize>, Vec<usize>) {
    /// Minimum ratio of a peak's square to the next largest one.
    const HIGHER: f64 = 6.0;
    /// Minimum size of a large group: two spikes may be side by side by chance.
    const MANY: usize = 3;
    let (mut beside, mut flat) = (Vec::new(), Vec::new());
    for group in places.chunk_by(|a, b| b - a <= NEAR) {
        let Some(peak) = group.iter().copied().max_by(|a, b| squares[*a].total_cmp(&squares[*b])) else { continue };
        let next = group.iter().filter(|place| **place != peak).map(|place| squares[*place]).fold(0.0, f64::max);
        if group.len() < MANY || squares[peak] > HIGHER * next {
            beside.extend(group.iter().filter(|place| **place != peak));
        } else {
            flat.extend(group);
        }
    }
    (beside, flat)
}

/// Returns spikes beside the known ones: the largest value of each short group of values that are far out, if all
/// samples about it are quiet.
///
/// Two spikes that are near each other hide each other's effect on their neighbours until one of them is left out.
pub(crate) fn further_spikes(series: &Series<'_>) -> Vec<usize> {
    /// A value is far out if its square exceeds twice the logarithm of the record's length by this: almost no normal
    /// value does.
    const FAR_OUT: f64 = 10.0;
    /// Maximum number of values in a group, and its maximum length.
    const MOST: usize = 8;
    const LONGEST: usize = 12;
    /// Number of samples about a group, and their maximum mean square.
    const ABOUT: usize = 32;
    const QUIET: f64 = 2.0;
    if series.explanation.spikes.is_none() || series.explanation.tails.is_some() {
        return Vec::new();
    }
    let values = series.innovations();
    let limit = FAR_OUT + 2.0 * (values.len().max(1) as f64).ln();
    let far: Vec<usize> = (0..values.len()).filter(|t| values[*t].powi(2) > limit).collect();
    let mut found = Vec::new();
    for group in far.chunk_by(|a, b| b - a <= NEAR).filter(|group| group.len() <= MOST) {
        let (first, last) = (group[0], group[group.len() - 1]);
        let about =
            (first.saturating_sub(ABOUT)..first).chain((last + 1..last + 1 + ABOUT).filter(|t| *t < values.len()));
        // Another spike nearby does not count as part of the surroundings.
        let squares = about.map(|t| values[t].powi(2)).filter(|square| *square <= limit);
        let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
        if last - first < LONGEST && sum < QUIET * count {
            found.extend(group.iter().copied().max_by(|a, b| values[*a].abs().total_cmp(&values[*b].abs())));
        }
    }
    found
}

/// Estimates rate and size of spikes whose sizes are spread evenly over half to one and a half times the typical size,
/// by maximum likelihood. Spikes that hide in the noise count as well. `large` are squares above 5 times the core's
/// variance among `n` samples.
fn spike_law(series: &Series<'_>, large: &[f64], [core, wide]: [f64; 2], n: f64) -> SpikeLaw {
    const ROUNDS: usize = 60;
    let spread = core.sqrt();
    let values: Vec<f64> = large.iter().map(|square| square.sqrt() / spread).collect();
    let normal = Normal::standard();
    // The distribution of a spike's residual without its sign: an even spread, blurred by the noise.
    let density = |x: f64, size: f64| 0.5 * (normal.cdf(x - 0.5 * size) - normal.cdf(x - 1.5 * size)) / size;
    let hidden = |size: f64| {
        // The chance that a spike stays below the limit.
        let limit = 5f64.sqrt();
        let steps = 40;
        let at = |step: i32| size * (0.5 + (f64::from(step) + 0.5) / f64::from(steps));
        (0..steps).map(|step| normal.cdf(limit - at(step)) - normal.cdf(-limit - at(step))).sum::<f64>()
            / f64::from(steps)
    };
    // ln of the density over noise alone, and the best rate, for a size.
    let at = |size: f64| {
        let ratios: Vec<f64> = values.iter().map(|x| density(*x, size) / normal.pdf(*x).max(1e-300)).collect();
        let hidden = hidden(size);
        let mut rate = (0.3 * values.len() as f64 / n).clamp(1.0 / n, 0.2);
        for _ in 0..ROUNDS {
            let seen: f64 = ratios.iter().map(|r| rate * r / (1.0 - rate + rate * r)).sum();
            rate = ((seen + n * rate * hidden) / n).clamp(0.2 / n, 0.3);
        }
        let sum: f64 = ratios.iter().map(|r| (1.0 - rate + rate * r).ln()).sum();
        // For values below the limit only their number is known.
        let small = n - values.len() as f64;
        let noise = 1.0 - 2.0 * normal.cdf(-(5f64.sqrt()));
        (sum + small * ((1.0 - rate) + rate * hidden / noise).ln(), rate)
    };
    let start = (wide / core).sqrt();
    let (mut low, mut high) = ((0.4 * start).max(2.0).ln(), (2.5 * start).ln());
    const GOLDEN: f64 = 0.618_033_988_749_895;
    for _ in 0..28 {
        let (left, right) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
        if at(left.exp()).0 < at(right.exp()).0 { low = left } else { high = right }
    }
    let size = (0.5 * (low + high)).exp();
    let (best, rate) = at(size);
    let step = 0.03;
    let curvature = (2.0 * best - at(size * (1.0 + step)).0 - at(size * (1.0 - step)).0) / (step * step);
    let kernel = kernel(series);
    let relative = if curvature > 0.0 { (1.0 / curvature).sqrt() } else { 0.5 };
    let samples = series.reach().max(1);
    SpikeLaw { rate, size: size * spread / kernel, variance: wide, relative_error: relative.min(0.5), samples }
}

/// Returns the size in the residual of a spike of size 1 in the samples: the whitening filter's own value. Before the
/// filters, the value follows from the spectrum without them.
fn kernel(series: &Series<'_>) -> f64 {
    let passed = series.filters();
    let gain = |k: usize| passed.as_ref().map_or(1.0, |gain| gain[k]);
    (1..series.len()).map(|k| (gain(k) / series.spectrum[k]).sqrt()).sum::<f64>() / series.len() as f64
}

/// Examines spikes at known places that are left out; each group of places counts as one spike.
pub(crate) fn spikes_at(series: &Series<'_>, places: &[usize]) -> Option<Candidate> {
    let mut with = series.clone();
    with.explanation.outliers.retain(|place| places.binary_search(place).is_err());
    with.rewhiten();
    let values = with.innovations();
    let groups = places.chunk_by(|a, b| b - a == 1);
    let peak = |group: &[usize]| group.iter().map(|place| values[*place].abs()).fold(0.0, f64::max);
    let peaks: Vec<f64> = groups.map(peak).collect();
    let (count, n) = (peaks.len() as f64, series.len() as f64);
    let typical = peaks.iter().sum::<f64>() / count;
    let (rate, variance) = (count / n, peaks.iter().map(|peak| peak * peak).sum::<f64>() / count);
    let gain = peaks.iter().map(|peak| 0.5 * (peak * peak - variance.ln()) - 0.5 + rate.ln()).sum::<f64>();
    // Sizes from half to one and a half times the typical size spread by this part of it.
    let relative_error = (1.0 / 12f64.sqrt() / count.sqrt()).min(0.5);
    let samples = places.len().div_ceil(peaks.len().max(1));
    let law = SpikeLaw { rate, size: typical / kernel(series), variance, relative_error, samples };
    let explanation = Explanation { spikes: Some(law), ..series.explanation.clone() };
    (gain > 0.0).then(|| Candidate::missing(Kind::Spikes, gain, explanation))
}

/// Returns whether places have neighbours far more often than independent ones would.
fn clustered(places: &[usize], samples: f64) -> bool {
    const FEWEST: usize = 8;
    if places.len() < FEWEST {
        return false;
    }
    let count = places.len();
    let near = |at: usize| {
        (at > 0 && places[at] - places[at - 1] <= NEAR) || (at + 1 < count && places[at + 1] - places[at] <= NEAR)
    };
    let share = (0..count).filter(|at| near(*at)).count() as f64 / count as f64;
    let expected = 1.0 - (1.0 - count as f64 / samples).powi(2 * NEAR as i32);
    share > expected + 0.3 * (1.0 - expected)
}
