//! Blocks of a demodulated record: whether their power has two levels, and where each begins and ends.

use crate::averages::{mean, median};
use crate::explanation::turning;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::ops::Range;

/// The lowest frequency of a band that the search finds, in cycles per sample.
pub(crate) const LOWEST: f64 = 0.004;
/// The highest frequency of a line whose amplitude and phase can be separated.
const HIGHEST: f64 = 0.49;
/// Minimum number of blocks of a record.
const FEWEST: usize = 24;

/// A record that is demodulated at a frequency: the means of value·exp(−2πi·cycles·t) over blocks.
#[derive(Clone)]
pub(super) struct Demodulated {
    /// Samples per block.
    size: usize,
    /// The means; not a number for blocks with samples that are left out.
    means: Vec<Complex<f64>>,
}

impl Demodulated {
    /// Creates blocks of `size` samples. A block counts if at most a tenth of its samples are left out.
    fn new(values: &[f64], is_left_out: &[bool], cycles: f64, size: usize) -> Self {
        let mut sums = vec![(Complex::<f64>::default(), 0); values.len() / size];
        turning(cycles, values.len() / size * size, |t, cosine, sine| {
            if !is_left_out[t] {
                let (sum, count) = &mut sums[t / size];
                *sum += Complex::new(cosine, -sine) * values[t];
                *count += 1;
            }
        });
        let counts = |count: usize| 10 * count >= 9 * size;
        let of = |(sum, count)| if counts(count) { sum / count as f64 } else { Complex::new(f64::NAN, f64::NAN) };
        Self { size, means: sums.into_iter().map(of).collect() }
    }

    /// Returns blocks of twice the size.
    fn doubled(&self) -> Self {
        let means = self.means.chunks_exact(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
        Self { size: 2 * self.size, means }
    }

    /// Returns the mean power of every `group` blocks.
    fn powers(&self, group: usize) -> Vec<f64> {
        let of = |own: &[Complex<f64>]| own.iter().map(Complex::norm_sqr).sum::<f64>() / group as f64;
        self.means.chunks_exact(group).map(of).collect()
    }
}

/// Blocks whose power has two levels.
pub(super) struct TwoLevels {
    /// Mean power of the blocks in stays.
    upper: f64,
    /// Mean power of the blocks in pauses.
    lower: f64,
    /// Whether the power is the upper one. A block that does not count is as the one before.
    is_on: Vec<bool>,
    /// Whether a block is inside a stay or inside a pause; none at the ends.
    inside: Vec<Option<bool>>,
}

impl TwoLevels {
    /// Returns the levels of powers. `None` if they have more or fewer, or if the upper ones scatter by more than `scatter`,
    /// as a part of their mean, beyond the scatter by the noise of the lower level.
    pub(super) fn of(powers: &[f64], scatter: f64) -> Option<Self> {
        /// Minimum number of blocks inside stays, and of blocks inside pauses.
        const INSIDE: usize = 6;
        /// Minimum mean length of stays and pauses, in blocks.
        const LENGTH: usize = 3;
        /// A block of a stay has at least this part of the upper level.
        const ON: f64 = 0.35;
        /// The lower level is below this part of the upper one, and almost all blocks of pauses below this.
        const LOWER: f64 = 0.05;
        const QUIET: f64 = 0.15;
        /// Between these parts of the upper level are only blocks in which a stay begins or ends, and a few others.
        const BETWEEN: Range<f64> = 0.1..0.5;
        /// Such blocks per beginning and end, and per block inside stays, since the power in stays scatters.
        const PER_CHANGE: f64 = 0.8;
        const PER_FULL: f64 = 0.0625;
        let counted: Vec<f64> = powers.iter().copied().filter(|power| power.is_finite()).collect();
        if counted.len() < FEWEST {
            return None;
        }
        let middle = mean(&counted);
        let mut above: Vec<f64> = counted.iter().copied().filter(|power| *power > middle).collect();
        let level = if above.is_empty() { return None } else { median(&mut above) };
        let mut last = powers.iter().find(|power| power.is_finite()).is_some_and(|power| *power > ON * level);
        let is_on: Vec<bool> = powers
            .iter()
            .map(|power| {
                last = if power.is_finite() { *power > ON * level } else { last };
                last
            })
            .collect();
        let same = |at: usize, other: Option<usize>| {
            other.and_then(|other| is_on.get(other)).is_none_or(|other| *other == is_on[at])
        };
        let is_inner = |at: &usize| powers[*at].is_finite() && same(*at, at.checked_sub(1)) && same(*at, Some(at + 1));
        let inner: Vec<usize> = (0..powers.len()).filter(is_inner).collect();
        let of = |state: bool| -> Vec<f64> {
            inner.iter().filter(|at| is_on[**at] == state).map(|at| powers[*at]).collect()
        };
        let (full, empty) = (of(true), of(false));
        if full.len() < INSIDE || empty.len() < INSIDE {
            return None;
        }
        let (upper, lower) = (mean(&full), mean(&empty));
        let deviation = (full.iter().map(|power| (power - upper).powi(2)).sum::<f64>() / full.len() as f64).sqrt();
        let changes = is_on.windows(2).filter(|pair| pair[0] != pair[1]).count();
        let between = counted.iter().filter(|power| BETWEEN.contains(&(*power / upper))).count();
        let loud = empty.iter().filter(|power| **power > QUIET * upper).count();
        let are_two = lower.abs() < LOWER * upper
            && 20 * loud <= empty.len()
            && deviation * deviation < (scatter * upper).powi(2) + 2.0 * upper * lower.max(0.0)
            && LENGTH * (changes + 1) <= counted.len()
            && between as f64 <= 1.0 + PER_CHANGE * changes as f64 + PER_FULL * full.len() as f64;
        let mut inside = vec![None; powers.len()];
        inner.iter().for_each(|at| inside[*at] = Some(is_on[*at]));
        are_two.then_some(Self { upper, lower, is_on, inside })
    }

    /// Returns by how much the mean of the powers of shorter blocks, `per_block` in each, is larger in stays than in pauses.
    fn rise(&self, powers: &[f64], per_block: usize) -> f64 {
        let of = |state: bool| {
            let is_there = |(at, power): &(usize, &f64)| {
                self.inside.get(at / per_block) == Some(&Some(state)) && power.is_finite()
            };
            let there: Vec<f64> = powers.iter().enumerate().filter(is_there).map(|(_, power)| *power).collect();
            mean(&there)
        };
        of(true) - of(false)
    }

    /// Returns the ranges of blocks in which the power is the upper one.
    pub(super) fn ranges(&self) -> Vec<Range<usize>> {
        let mut ranges: Vec<Range<usize>> = Vec::new();
        for at in (0..self.is_on.len()).filter(|at| self.is_on[*at]) {
            match ranges.last_mut() {
                Some(last) if last.end == at => last.end += 1,
                _ => ranges.push(at..at + 1),
            }
        }
        ranges
    }
}

/// Returns the number of samples in the shortest blocks of a record that is demodulated at a frequency.
fn shortest(cycles: f64) -> usize {
    /// Minimum length, and minimum number of periods.
    const SAMPLES: f64 = 16.0;
    const PERIODS: f64 = 2.0;
    (PERIODS / cycles).max(SAMPLES).ceil() as usize
}

/// Returns the blocks of a sine that comes and goes, as short as its noise permits.
pub(super) fn line_blocks(values: &[f64], is_left_out: &[bool], cycles: f64) -> Option<(Demodulated, TwoLevels)> {
    /// Largest scatter of the power in stays: that of noise in a band is as large as its mean.
    const STEADY: f64 = 0.2;
    /// The line has this part of the power that comes and goes near its frequency.
    const ALONE: f64 = 0.7;
    if !(LOWEST..HIGHEST).contains(&cycles) || values.len() < FEWEST * shortest(cycles) {
        return None;
    }
    let shortest = Demodulated::new(values, is_left_out, cycles, shortest(cycles));
    let powers = shortest.powers(1);
    let mut blocks = shortest;
    let mut per_block = 1;
    while blocks.means.len() >= FEWEST {
        if let Some(levels) = TwoLevels::of(&blocks.powers(1), STEADY) {
            return (levels.upper - levels.lower > ALONE * levels.rise(&powers, per_block)).then_some((blocks, levels));
        }
        blocks = blocks.doubled();
        per_block *= 2;
    }
    None
}

/// Returns the distance of a line from the frequency of its blocks, in cycles per sample: the turn of the phase from block to
/// block. Longer blocks determine it better, and shorter ones determine how often it turns within a longer one.
pub(super) fn apart(mut blocks: Demodulated, levels: &TwoLevels) -> f64 {
    let mut is_inside: Vec<bool> = levels.inside.iter().map(|of| *of == Some(true)).collect();
    let mut found = 0.0;
    loop {
        let is_pair = |at: &usize| is_inside[*at] && is_inside[*at + 1];
        let pairs = (0..blocks.means.len().saturating_sub(1)).filter(is_pair);
        let sum: Complex<f64> = pairs.map(|at| blocks.means[at + 1] * blocks.means[at].conj()).sum();
        // Without pairs, or with samples left out, there is no more to learn.
        if sum.norm_sqr().is_nan() || sum.norm_sqr() == 0.0 {
            return found;
        }
        let turn = sum.arg();
        found += turn / (TAU * blocks.size as f64);
        blocks.means.iter_mut().enumerate().for_each(|(at, mean)| *mean *= Complex::cis(-turn * at as f64));
        blocks = blocks.doubled();
        is_inside = is_inside.chunks_exact(2).map(|pair| pair[0] && pair[1]).collect();
    }
}

/// Returns the place of a sequence of log-likelihood ratios at which it is best cut: behind it the sum is largest.
fn best_cut(ratios: impl DoubleEndedIterator<Item = f64>) -> usize {
    let ratios: Vec<f64> = ratios.collect();
    let (mut sum, mut best, mut cut) = (0.0, 0.0, ratios.len());
    for (at, ratio) in ratios.iter().enumerate().rev() {
        sum += ratio;
        if sum > best {
            (best, cut) = (sum, at);
        }
    }
    cut
}

/// Returns ranges of samples for ranges of blocks of `size` samples, each end moved to the most probable place within a block and
/// a half. `ratio(at, of)` is the log-likelihood ratio of unit `at`, of `unit` samples each, in stay `of`.
fn refined(
    ranges: &[Range<usize>],
    samples: usize,
    [size, unit]: [usize; 2],
    ratio: &dyn Fn(usize, &Range<usize>) -> f64,
) -> Vec<Range<usize>> {
    let units = samples / unit;
    let near = |block: usize| {
        let middle = block * size / unit;
        let reach = (3 * size).div_ceil(2 * unit);
        (middle.saturating_sub(reach), (middle + reach).min(units))
    };
    let of = |range: &Range<usize>| {
        let from = if range.start == 0 {
            0
        } else {
            let (low, high) = near(range.start);
            low + best_cut((low..high).map(|at| ratio(at, range)))
        };
        let to = if (range.end + 1) * size > samples {
            units
        } else {
            let (low, high) = near(range.end);
            high - best_cut((low..high).rev().map(|at| ratio(at, range)))
        };
        let end = if to == units { samples } else { to * unit };
        (from * unit)..end
    };
    let mut found: Vec<Range<usize>> = Vec::new();
    for range in ranges.iter().map(of).filter(|range| !range.is_empty()) {
        match found.last_mut() {
            // A pause shorter than a block is a fade.
            Some(last) if range.start < last.end + size => last.end = last.end.max(range.end),
            _ => found.push(range),
        }
    }
    // A stay that is shorter is another event.
    found.retain(|range| range.len() >= size);
    found
}

/// Returns the stays of a line of a frequency that blocks show.
pub(super) fn line_stays(
    values: &[f64],
    is_left_out: &[bool],
    cycles: f64,
    blocks: &Demodulated,
    levels: &TwoLevels,
) -> Vec<Range<usize>> {
    let noise = levels.lower.max(f64::MIN_POSITIVE) * blocks.size as f64;
    let amplitude = 2.0 * (levels.upper - levels.lower).sqrt();
    // The phase at the end of a stay is that of the blocks near it.
    let own = Demodulated::new(values, is_left_out, cycles, blocks.size);
    let phase_near = |at: usize, range: &Range<usize>| {
        /// Number of blocks to either side whose mean is the phase.
        const AROUND: usize = 4;
        let block = (at / blocks.size).clamp(range.start, range.end - 1);
        let from = block.saturating_sub(AROUND).max(range.start);
        (from..(block + AROUND + 1).min(range.end))
            .map(|at| own.means[at])
            .filter(|mean| mean.re.is_finite())
            .sum::<Complex<f64>>()
    };
    let ratio = |at: usize, range: &Range<usize>| {
        let towards = phase_near(at, range);
        if is_left_out[at] || towards.norm_sqr() == 0.0 {
            return 0.0;
        }
        let unit = towards / towards.norm();
        let (sine, cosine) = (TAU * (cycles * at as f64).fract()).sin_cos();
        let there = amplitude * (unit * Complex::new(cosine, sine)).re;
        (values[at] * there - 0.5 * there * there) / noise
    };
    refined(&levels.ranges(), values.len(), [blocks.size, 1], &ratio)
}

/// Returns the stays of noise in a band of a frequency and width in cycles per sample beside other noise that has a `density` there in
/// each range of samples; `None` if its power does not have two levels.
///
/// The power of means that are short against 1/width is distributed exponentially. Their averages scatter less.
pub(super) fn band_stays(
    values: &[f64],
    is_left_out: &[bool],
    [cycles, width]: [f64; 2],
    density: &dyn Fn(Range<usize>) -> f64,
) -> Option<Vec<Range<usize>>> {
    if !(LOWEST..HIGHEST).contains(&cycles) {
        return None;
    }
    const SCATTER: f64 = 0.4;
    /// Blocks per correlation time of a band.
    const PER_WIDTH: f64 = 3.0;
    let unit = shortest(cycles);
    let size = ((1.0 / (PER_WIDTH * width)) as usize).div_ceil(unit).max(1) * unit;
    let blocks = Demodulated::new(values, is_left_out, cycles, size);
    let mut group = 2;
    while blocks.means.len() / group >= FEWEST {
        let noise = |at: usize| density(at * group * size..(at + 1) * group * size) / size as f64;
        let powers: Vec<f64> = blocks.powers(group).iter().enumerate().map(|(at, power)| power - noise(at)).collect();
        if let Some(levels) = TwoLevels::of(&powers, SCATTER) {
            // The ends show in blocks as short as possible.
            let fine = Demodulated::new(values, is_left_out, cycles, shortest(cycles));
            let powers = fine.powers(1);
            let quiet = density(0..values.len()) / fine.size as f64;
            let loud = quiet + levels.rise(&powers, group * size / fine.size).max(quiet);
            let ratio = |at: usize, _: &Range<usize>| {
                let ratio = (quiet / loud).ln() + powers[at] * (1.0 / quiet - 1.0 / loud);
                if ratio.is_finite() { ratio } else { 0.0 }
            };
            return Some(refined(&levels.ranges(), values.len(), [group * size, fine.size], &ratio));
        }
        group *= 2;
    }
    None
}
