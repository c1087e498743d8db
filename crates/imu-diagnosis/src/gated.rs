//! Gated: lines and bands of noise that come and go. Their spectra are those of bands, but their power has two levels.

use super::averages::{mean, median};
use super::explanation::{GatedSine, LOUD, Stay, turning};
use super::law::{Shape, Term};
use super::series::Series;
use imu_model::effects::{Effect, EffectKind};
use imu_model::simulator::ChannelModel;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::ops::Range;
use std::sync::Arc;

/// A band of noise of the law that is present only at times.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Stays {
    /// The place of its term in the law.
    pub(super) term: usize,
    /// The samples at which it is present, in order.
    pub(super) ranges: Vec<Range<usize>>,
}

impl Stays {
    /// Returns the part of the samples from `from` to `to` at which it is present, or next to nothing.
    pub(super) fn share(&self, from: usize, to: usize) -> f64 {
        const NOTHING: f64 = 1e-6;
        let inside = self.ranges.iter().map(|range| range.end.min(to).saturating_sub(range.start.max(from)));
        (inside.sum::<usize>() as f64 / (to - from).max(1) as f64).max(NOTHING)
    }

    /// Returns the number of samples at which it is present.
    pub(super) fn samples(&self) -> usize {
        self.ranges.iter().map(Range::len).sum()
    }
}

/// The lowest frequency of a band that the search finds, in cycles per sample.
pub(super) const LOWEST: f64 = 0.004;
/// The highest frequency of a line whose amplitude and phase can be separated.
const HIGHEST: f64 = 0.49;
/// Minimum number of blocks of a record.
const FEWEST: usize = 24;

/// A record that is demodulated at a frequency: the means of value·exp(−2πi·cycles·t) over blocks.
#[derive(Clone)]
struct Demodulated {
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
struct TwoLevels {
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
    fn of(powers: &[f64], scatter: f64) -> Option<Self> {
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
            && between <= 1 + changes * 4 / 5 + full.len() / 16;
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
    fn ranges(&self) -> Vec<Range<usize>> {
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

/// Returns, for each sample, whether it carries no information about lines: it is replaced.
pub(super) fn left_out(series: &Series<'_>) -> Vec<bool> {
    let mut is_left_out = vec![false; series.len()];
    series.explanation.left_out(series.len(), series.reach()).iter().for_each(|at| is_left_out[*at] = true);
    for loud in series.explanation.loud.iter().filter(|loud| loud.ratio > LOUD) {
        is_left_out[series.spoilt(loud)].fill(true);
    }
    is_left_out
}

/// Returns the number of samples in the shortest blocks of a record that is demodulated at a frequency.
fn shortest(cycles: f64) -> usize {
    /// Minimum length, and minimum number of periods.
    const SAMPLES: f64 = 16.0;
    const PERIODS: f64 = 2.0;
    (PERIODS / cycles).max(SAMPLES).ceil() as usize
}

/// Returns the blocks of a sine that comes and goes, as short as its noise permits.
fn line_blocks(values: &[f64], is_left_out: &[bool], cycles: f64) -> Option<(Demodulated, TwoLevels)> {
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

/// A band of noise that is present only at times.
pub(super) struct Gate {
    /// The place of its term in the law; none for a band of the model.
    term: Option<usize>,
    /// The samples at which it is present, in order.
    pub(super) ranges: Vec<Range<usize>>,
    /// Its mean power in each coefficient.
    pub(super) power: Vec<f64>,
}

/// Returns the bands of the law and of the model that are present only at times.
pub(super) fn gates(series: &Series<'_>) -> Vec<Gate> {
    let setting = series.setting();
    let is_left_out = left_out(series);
    // The variance of the white noise in a range over its mean.
    let is_uneven = series.equaliser.is_none() && !series.variance.is_empty();
    let usual = if is_uneven { mean(&series.variance) } else { 1.0 };
    let loudness = |range: Range<usize>| if is_uneven { mean(&series.variance[range]) / usual } else { 1.0 };
    let gate = |term: Option<usize>, [cycles, width]: [f64; 2], logarithms: Vec<f64>| {
        let other = series.grid.fill(&logarithms);
        let at = ((2.0 * series.len() as f64 * cycles) as usize).clamp(1, series.len() - 1);
        let ranges = band_stays(&series.rest, &is_left_out, [cycles, width], &|range| other[at] * loudness(range))?;
        let power = series.spectrum.iter().zip(&other).map(|(all, other)| (all - other).max(0.0)).collect();
        (!ranges.is_empty()).then_some(Gate { term, ranges, power })
    };
    let of_term = |(place, term): (usize, &Term)| {
        let mut other = series.explanation.law.clone();
        other.terms.remove(place);
        let band = [term.at(1) / setting.rate_hz, term.at(2).exp() / setting.rate_hz];
        gate(Some(place), band, other.logarithms(series.data()))
    };
    let of_model = |of: &OfModel| {
        let is_there = !series.explanation.without.contains(&of.place);
        let band = of.width.filter(|_| is_there).map(|width| [of.cycles, width])?;
        gate(None, band, series.logarithms_without_declared(of.place))
    };
    let terms = series.explanation.law.terms.iter().enumerate().filter(|(_, term)| term.shape == Shape::Resonance);
    terms.filter_map(of_term).chain(setting.gated.iter().filter_map(of_model)).take(MOST_GATES).collect()
}

/// Maximum number of bands that come and go, at which each sample's state fits into a byte.
const MOST_GATES: usize = 7;

/// Returns the spectrum of a series at times at which some of its gates are present.
pub(super) fn spectrum_at(series: &Series<'_>, gates: &[Gate], is_present: impl Fn(usize) -> bool) -> Vec<f64> {
    /// The least part of the mean spectrum that remains.
    const LEAST: f64 = 1e-6;
    let mut spectrum = series.spectrum.clone();
    for (at, gate) in gates.iter().enumerate() {
        let share = gate.ranges.iter().map(Range::len).sum::<usize>() as f64 / series.len() as f64;
        let more = if is_present(at) { 1.0 / share - 1.0 } else { -1.0 };
        spectrum.iter_mut().zip(&gate.power).for_each(|(all, own)| *all += more * own);
    }
    spectrum.iter_mut().zip(&series.spectrum).for_each(|(own, all)| *own = own.max(LEAST * all));
    spectrum
}

/// Returns the bands of noise of the law that are present only at times.
pub(super) fn stays(series: &Series<'_>) -> Vec<Stays> {
    let of = |gate: Gate| Some(Stays { term: gate.term?, ranges: gate.ranges });
    gates(series).into_iter().filter_map(of).collect()
}

/// Returns the sine at a frequency if it is present only at times. Made even, white noise hides at which times the sine has which
/// size: `None`.
pub(super) fn sine(series: &Series<'_>, cycles: f64) -> Option<GatedSine> {
    const ROUNDS: usize = 3;
    if series.equaliser.is_some() {
        return None;
    }
    let is_left_out = left_out(series);
    let (blocks, levels) = line_blocks(&series.rest, &is_left_out, cycles)?;
    let cycles = cycles + apart(blocks.clone(), &levels);
    let ranges = line_stays(&series.rest, &is_left_out, cycles, &blocks, &levels);
    let stays = ranges.into_iter().map(|range| Stay { from: range.start, to: range.end, quadratures: [0.0; 2] });
    let mut sine = GatedSine { cycles, stays: stays.collect() };
    for round in 0..ROUNDS {
        let mut rest = series.rest.clone();
        if round > 0 {
            sine.add(-1.0, &mut rest);
        }
        fit(&mut sine, &rest, &is_left_out);
    }
    (!sine.stays.is_empty()).then_some(sine)
}

/// Fits the frequencies and the phases of a series' sines that come and go again.
pub(super) fn refine(series: &mut Series<'_>) {
    if series.explanation.gated.is_empty() || series.equaliser.is_some() {
        return;
    }
    let is_left_out = left_out(series);
    let mut sines = std::mem::take(&mut series.explanation.gated);
    sines.iter_mut().for_each(|sine| fit(sine, &series.rest, &is_left_out));
    series.explanation.gated = sines;
}

/// Fits a sine's quadratures in each stay, and its frequency, to the rest beside it.
///
/// The phases of the halves of a stay of T samples differ by 2π·T/2 times the error of the frequency; the variance of that error
/// is proportional to T⁻³.
fn fit(sine: &mut GatedSine, rest: &[f64], is_left_out: &[bool]) {
    let cycles = sine.cycles;
    // The sum and the number of the samples of each half that count.
    let of = |stay: &Stay| {
        let middle = (stay.to - stay.from) / 2;
        let mut halves = [(Complex::<f64>::default(), 0.0); 2];
        turning(cycles, stay.to - stay.from, |t, cosine, sine| {
            if !is_left_out[stay.from + t] {
                let (sum, count) = &mut halves[usize::from(t >= middle)];
                *sum += Complex::new(cosine, -sine) * rest[stay.from + t];
                *count += 1.0;
            }
        });
        let own = Complex::new(stay.quadratures[0], -stay.quadratures[1]);
        halves.map(|(sum, count)| (if count > 0.0 { own + sum * (2.0 / count) } else { own }, count))
    };
    let halves: Vec<[(Complex<f64>, f64); 2]> = sine.stays.iter().map(of).collect();
    let (mut apart, mut weights) = (0.0, 0.0);
    for (stay, [(first, before), (second, after)]) in sine.stays.iter().zip(&halves) {
        let length = (stay.to - stay.from) as f64;
        let weight = length * length * before.min(*after);
        apart += weight * (second * first.conj()).arg() / (0.5 * TAU * length);
        weights += weight;
    }
    let apart = if weights > 0.0 { apart / weights } else { 0.0 };
    sine.cycles += apart;
    for (stay, [(first, before), (second, after)]) in sine.stays.iter_mut().zip(&halves) {
        let to_middle = 0.25 * TAU * apart * (stay.to - stay.from) as f64;
        // Each half turns about its middle.
        let turned = [*before * first * Complex::cis(-to_middle), *after * second * Complex::cis(-3.0 * to_middle)];
        let of = (turned[0] + turned[1]) / (before + after).max(1.0);
        stay.quadratures = [of.re, -of.im];
    }
}

/// Returns the standard error of a sine's frequency, in cycles per sample, and its amplitude with its error.
///
/// The error of a stay of T samples is that of a sine in a record of T samples (Rife and Boorstyn 1974, IEEE Trans. IT 20). If
/// the amplitudes of the stays scatter more than the noise, their scatter counts.
pub(super) fn errors(series: &Series<'_>, sine: &GatedSine) -> (f64, [f64; 2]) {
    /// Minimum number of stays that show a scatter.
    const SEVERAL: usize = 3;
    /// Error of the frequency as it is fitted, over the bound.
    const OVER_BOUND: f64 = 1.2;
    let n = series.len();
    let density = series.spectrum[((2.0 * n as f64 * sine.cycles) as usize).clamp(1, n - 1)];
    let samples = sine.samples() as f64;
    let count = sine.stays.len();
    // Each quadrature of a stay has the variance 2·density/T.
    let square = (sine.square() - 4.0 * density * count as f64 / samples).max(0.0);
    let amplitude = square.sqrt();
    let cubes: f64 = sine.stays.iter().map(|stay| ((stay.to - stay.from) as f64).powi(3)).sum();
    let cycles_error = OVER_BOUND * (24.0 * density / cubes).sqrt() / amplitude / TAU;
    let scatter = |stay: &Stay| {
        let own = stay.quadratures[0].hypot(stay.quadratures[1]);
        ((stay.to - stay.from) as f64 / samples * (own - amplitude)).powi(2)
    };
    let by_scatter = if count < SEVERAL { 0.0 } else { sine.stays.iter().map(scatter).sum::<f64>().sqrt() };
    (cycles_error, [amplitude, (2.0 * density / samples).sqrt().max(by_scatter)])
}

/// Returns whether two frequencies in cycles per sample are those of one line in a record that is long enough to show when it comes
/// and goes.
pub(super) fn are_same(one: f64, other: f64, samples: usize) -> bool {
    /// Part of a record over which the sines turn against each other at most once.
    const PART: f64 = 0.05;
    (one - other).abs() * PART * (samples as f64) < 1.0
}

/// A model's line or band that comes and goes.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct OfModel {
    /// Its place in the model's list.
    pub(super) place: usize,
    /// Its frequency in cycles per sample.
    pub(super) cycles: f64,
    /// The full width at half power in cycles per sample; none for a line.
    pub(super) width: Option<f64>,
}

/// Returns a number of the effect that comes and goes; `None` for all other effects.
fn number_of(effect: &dyn Effect, wanted: EffectKind, number: &str) -> Option<f64> {
    if effect.kind() != EffectKind::Intermittent {
        return None;
    }
    let of = effect.parameters().into_iter().find(|(name, _)| *name == "of")?.1;
    (of["effect"] == wanted.name()).then(|| of[number].as_f64()).flatten()
}

/// Returns whether an effect comes and goes at random times, which its model does not state.
fn is_random(effect: &dyn Effect) -> bool {
    effect.kind() == EffectKind::Intermittent && effect.pairs("intervals").is_empty()
}

/// Returns whether the search may look for sines that come and go: the times of the model's own are known.
pub(super) fn are_known(model: &ChannelModel) -> bool {
    !model.effects.iter().any(|effect| is_random(&**effect))
}

/// Returns a model's bands that come and go, and its lines whose times it states.
pub(super) fn of_model(model: &ChannelModel, rate_hz: f64) -> Vec<OfModel> {
    let of = |(place, effect): (usize, &Arc<dyn Effect>)| {
        let number = |kind: EffectKind, name: &str| number_of(&**effect, kind, name).map(|value| value / rate_hz);
        let line = number(EffectKind::Tone, "frequency_hz").filter(|_| !is_random(&**effect));
        line.map(|cycles| OfModel { place, cycles, width: None }).or_else(|| {
            let (cycles, width) =
                (number(EffectKind::Resonance, "frequency_hz")?, number(EffectKind::Resonance, "bandwidth_hz"));
            Some(OfModel { place, cycles, width })
        })
    };
    model.effects.iter().enumerate().filter_map(of).collect()
}

/// Returns the place of the model's sine that comes and goes for which a found one stands in a record of `samples` at a rate.
pub(super) fn stands_for(of: &[OfModel], found: &dyn Effect, rate_hz: f64, samples: usize) -> Option<usize> {
    let cycles = number_of(found, EffectKind::Tone, "frequency_hz")? / rate_hz;
    let is_same = |of: &&OfModel| of.width.is_none() && are_same(of.cycles, cycles, samples);
    let nearest =
        of.iter().filter(is_same).min_by(|a, b| (a.cycles - cycles).abs().total_cmp(&(b.cycles - cycles).abs()));
    nearest.map(|of| of.place)
}

/// Returns whether a sine that was found agrees with a model's: its amplitude inside an interval that is half as wide again, and
/// its times apart by a small part. A model without times agrees with any.
pub(super) fn is_as_declared(found: &dyn Effect, ci95: &[(&'static str, [f64; 2])], declared: &dyn Effect) -> bool {
    /// Largest part of all stays by which the times may differ.
    const OTHER: f64 = 0.05;
    let Some(amplitude) = number_of(declared, EffectKind::Tone, "amplitude") else { return false };
    let ends = ci95.iter().find(|(name, _)| *name == "of.amplitude").map(|(_, ends)| ends);
    let is_inside = |[low, high]: &[f64; 2]| (amplitude - 0.5 * (low + high)).abs() < 0.75 * (high - low);
    let [own, other] = [found, declared].map(|effect| effect.pairs("intervals"));
    let length = |of: &[(f64, f64)]| of.iter().map(|(from_s, to_s)| to_s - from_s).sum::<f64>();
    let common =
        |(from_s, to_s): &(f64, f64)| other.iter().map(|of| (to_s.min(of.1) - from_s.max(of.0)).max(0.0)).sum::<f64>();
    let apart_s = length(&own) + length(&other) - 2.0 * own.iter().map(common).sum::<f64>();
    ends.is_some_and(is_inside) && (other.is_empty() || apart_s < OTHER * (length(&own) + length(&other)))
}

/// Returns a model's sines that come and go and that a series has with other times or numbers.
fn replaced<'a>(series: &'a Series<'_>) -> impl Iterator<Item = &'a OfModel> {
    let is_left_out = |of: &&OfModel| of.width.is_none() && series.explanation.without.contains(&of.place);
    series.setting().gated.iter().filter(is_left_out)
}

/// Returns the sines of a series that stand for a model's and have about its amplitude (`scale` is the unit of the series), with
/// the places of the model's.
pub(super) fn as_declared(series: &Series<'_>, model: &ChannelModel, scale: f64) -> Vec<(usize, GatedSine)> {
    /// Largest ratio of the amplitudes.
    const NEAR: f64 = 1.25;
    let own = |of: &OfModel| {
        let effect = model.effects.get(of.place)?;
        let amplitude = number_of(&**effect, EffectKind::Tone, "amplitude")? / scale;
        let is_same = |sine: &&GatedSine| are_same(sine.cycles, of.cycles, series.len());
        let sine = series.explanation.gated.iter().find(is_same)?;
        let ratio = sine.square().sqrt() / amplitude;
        (ratio < NEAR && NEAR * ratio > 1.0).then(|| (of.place, sine.clone()))
    };
    replaced(series).filter_map(own).collect()
}

/// Returns the distance of a line from the frequency of its blocks, in cycles per sample: the turn of the phase from block to
/// block. Longer blocks determine it better, and shorter ones determine how often it turns within a longer one.
fn apart(mut blocks: Demodulated, levels: &TwoLevels) -> f64 {
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
fn line_stays(
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
fn band_stays(
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Verdict;
    use crate::cliffs::{WHITE, Wrong, diagnosed, list, names};
    use crate::report::Sense;
    use crate::round_trip::{RATE_HZ, model, recording};
    use crate::two_effects::with_both;
    use imu_core::sample::Channel;
    use imu_model::simulator::SensorModel;
    use serde_json::{Value, json};

    const SAMPLES: usize = 40_000;

    /// Returns stays of a length every `every_s`, the first after half a pause.
    fn every(every_s: f64, stay_s: f64) -> Vec<[f64; 2]> {
        let first_s = 0.5 * (every_s - stay_s);
        let count = (SAMPLES as f64 / RATE_HZ / every_s) as usize;
        (0..count).map(|of| first_s + of as f64 * every_s).map(|from_s| [from_s, from_s + stay_s]).collect()
    }

    fn intermittent(of: &Value, intervals: &[[f64; 2]]) -> Value {
        json!({"effect": "intermittent", "of": of, "intervals": intervals})
    }

    fn tone(frequency_hz: f64, amplitude: f64) -> Value {
        json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": amplitude})
    }

    fn band(frequency_hz: f64, bandwidth_hz: f64, sigma: f64) -> Value {
        json!({"effect": "resonance", "frequency_hz": frequency_hz, "bandwidth_hz": bandwidth_hz, "sigma": sigma})
    }

    /// Returns the largest distance of an end from its truth; infinite if the numbers of stays differ.
    fn farthest(found: &Value, truth: &[[f64; 2]]) -> f64 {
        let found: Vec<[f64; 2]> = serde_json::from_value(found["intervals"].clone()).unwrap_or_default();
        if found.len() != truth.len() {
            return f64::INFINITY;
        }
        let ends = found.iter().flatten().zip(truth.iter().flatten());
        ends.map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
    }

    /// Expects the effect alone, with numbers in their intervals that are narrower than `width` of the number, ends within
    /// `end_s`, and a corrected model that explains its own simulation.
    fn expect(wrong: &mut Wrong, effect: &Value, seed: u64, end_s: f64, width: f64) {
        let found = diagnosed(&recording(&model(Some(effect)), seed, SAMPLES), &model(None));
        let case =
            format!("{} of {} stays, seed {seed}", effect["of"], effect["intervals"].as_array().map_or(0, Vec::len));
        wrong.expect(names(&found) == ["intermittent"] && found.diagnosis.verdict == Verdict::Effects, || {
            format!("{case}: {:?} {:?} {:?}", names(&found), found.diagnosis.verdict, found.diagnosis.notes)
        });
        let Some(cause) = found.diagnosis.causes.first() else { return };
        let own = list(cause, "accel_x").into_iter().next().unwrap_or_default();
        let truth: Vec<[f64; 2]> = serde_json::from_value(effect["intervals"].clone()).unwrap();
        let end = farthest(&own, &truth);
        wrong.expect(end < end_s, || format!("{case}: an end is {end} s off: {own}"));
        let known = cause.uncertainty.get("accel_x").map(|list| list[0].clone()).unwrap_or_default();
        for (name, truth) in effect["of"].as_object().unwrap().iter().filter(|(name, _)| *name != "effect") {
            let ends = [0, 1].map(|end| known[format!("of.{name}")][end].as_f64().unwrap_or(f64::NAN));
            let truth = truth.as_f64().unwrap();
            // Twice the half width: one interval in twenty misses.
            let [low, high] = [2.0 * ends[0] - 0.5 * (ends[0] + ends[1]), 2.0 * ends[1] - 0.5 * (ends[0] + ends[1])];
            wrong.expect(low <= truth && truth <= high, || format!("{case}: {name} in {ends:?}"));
            wrong.expect(ends[1] - ends[0] < width * truth, || format!("{case}: {name} in {ends:?} is wide"));
        }
        let written = serde_json::to_string(&found.augmented).unwrap();
        let read = SensorModel::from_json(&written, "corrected").unwrap();
        let again = recording(&read, seed + 100, SAMPLES);
        let own = diagnosed(&again, &read);
        let is_own = matches!(own.diagnosis.verdict, Verdict::NoGap | Verdict::Parameters);
        wrong.expect(is_own, || format!("{case}: its corrected model: {:?}", names(&own)));
        let plain = diagnosed(&again, &model(None));
        wrong.expect(names(&plain) == ["intermittent"], || format!("{case} again: {:?}", names(&plain)));
    }

    #[test]
    fn a_line_that_comes_and_goes_is_named_with_its_times() {
        let mut wrong = Wrong::default();
        for (every_s, stay_s, amplitude, seed) in [
            (15.0, 5.0, 0.03, 1),
            (50.0, 30.0, 0.03, 2),
            (250.0, 80.0, 0.03, 3),
            (1000.0, 400.0, 0.03, 4),
            (100.0, 30.0, 0.3, 5),
            (200.0, 60.0, 0.01, 6),
        ] {
            expect(&mut wrong, &intermittent(&tone(8.1, amplitude), &every(every_s, stay_s)), seed, 1.0, 0.1);
        }
        wrong.none();
    }

    #[test]
    fn a_band_that_comes_and_goes_is_named_with_its_times() {
        let mut wrong = Wrong::default();
        for (every_s, stay_s, bandwidth_hz, sigma, seed) in [
            (100.0, 40.0, 0.8, 0.02, 1),
            (250.0, 100.0, 0.8, 0.02, 2),
            (100.0, 50.0, 2.0, 0.03, 3),
            (500.0, 200.0, 0.3, 0.1, 4),
        ] {
            expect(&mut wrong, &intermittent(&band(8.1, bandwidth_hz, sigma), &every(every_s, stay_s)), seed, 4.0, 0.5);
        }
        wrong.none();
    }

    #[test]
    fn what_comes_and_goes_is_found_beside_other_effects() {
        let mut wrong = Wrong::default();
        let gated_tone = intermittent(&tone(8.1, 0.03), &every(100.0, 40.0));
        let gated_band = intermittent(&band(8.1, 0.8, 0.02), &every(200.0, 80.0));
        let loud = json!({"effect": "variance_change", "from_s": 300.0, "to_s": 500.0, "factor": 1.5});
        let bursts = json!({"effect": "bursts", "intervals": [[310.0, 314.0], [555.0, 560.0]], "sigma": 0.2});
        let spikes = json!({"effect": "spikes", "rate_hz": 0.05, "amplitude": 0.2});
        let low_pass = json!({"effect": "low_pass", "cutoff_hz": 6.0, "order": 2});
        let ramp = json!({"effect": "rate_ramp", "R": 1e-4});
        let cases = [
            (&gated_tone, &loud),
            (&gated_tone, &low_pass),
            (&gated_tone, &ramp),
            (&gated_tone, &tone(11.3, 0.004)),
            (&gated_band, &loud),
            (&gated_band, &bursts),
            (&gated_band, &spikes),
            (&gated_tone, &spikes),
            (&gated_band, &low_pass),
        ];
        for ((gated, other), seed) in cases.into_iter().zip(1..) {
            let found = diagnosed(&recording(&with_both([gated, other]), seed, SAMPLES), &model(None));
            let named = names(&found);
            let name = other["effect"].as_str().unwrap_or_default();
            let are_both = named.len() == 2 && ["intermittent", name].iter().all(|name| named.contains(name));
            wrong.expect(are_both, || format!("{} beside {other}: {named:?}", gated["of"]));
        }
        wrong.none();
    }

    /// A steady line beside a stretch that is replaced, a line whose amplitude swings, two lines that beat, and a band.
    #[test]
    fn what_is_steady_or_swings_does_not_come_and_go() {
        let mut wrong = Wrong::default();
        let loud = json!({"effect": "variance_change", "from_s": 300.0, "to_s": 800.0, "factor": 10.0});
        let swings = json!({"effect": "wandering_line", "frequency_hz": 8.1, "amplitude": 0.03, "frequency_sigma_hz": 0.01,
            "frequency_tc_s": 5.0, "amplitude_sigma": 0.7, "amplitude_tc_s": 20.0});
        let profile: Vec<[f64; 2]> = (0..21).map(|of| [50.0 * f64::from(of), f64::from(of % 4)]).collect();
        let swells = json!({"effect": "modulated_band", "frequency_hz": 8.1, "bandwidth_hz": 0.8, "sigma": 0.02,
            "level": profile});
        for (effects, seed) in [
            ([tone(8.1, 0.03), loud], 1),
            ([tone(8.1, 0.03), tone(8.11, 0.03)], 2),
            ([tone(8.1, 0.03), tone(8.15, 0.02)], 3),
            ([band(8.1, 0.8, 0.02), tone(3.1, 0.01)], 4),
            ([swings, tone(3.1, 0.01)], 5),
            ([swells, tone(3.1, 0.01)], 6),
        ] {
            let found = diagnosed(&recording(&with_both([&effects[0], &effects[1]]), seed, SAMPLES), &model(None));
            let named = names(&found);
            wrong.expect(!named.is_empty() && !named.contains(&"intermittent"), || format!("{effects:?}: {named:?}"));
        }
        wrong.none();
    }

    /// In the half of the record in which white noise is louder, a steady band and white noise of the mean level have the powers
    /// of a band and of silence.
    #[test]
    fn a_steady_band_beside_a_change_of_variance_does_not_come_and_go() {
        let mut wrong = Wrong::default();
        let low_pass = json!({"effect": "low_pass", "cutoff_hz": 12.0, "order": 1});
        for (factor, sigma, seed) in [(1.2, 0.003, 1), (1.38, 0.003, 2), (1.38, 0.004, 3), (1.38, 0.006, 4)] {
            let change = json!({"effect": "variance_change", "from_s": 400.0, "to_s": 900.0, "factor": factor});
            let mut sensor = with_both([&band(8.1, 0.8, sigma), &change]);
            for other in [None, Some(&low_pass)] {
                if let Some(other) = other {
                    let filter = model(Some(other)).channels.remove(&Channel::AccelX).unwrap().effects[0].clone();
                    sensor.channels.get_mut(&Channel::AccelX).unwrap().push_effect(filter, &[]);
                }
                let found = diagnosed(&recording(&sensor, seed, SAMPLES), &model(None));
                let named = names(&found);
                let is_steady = !named.is_empty() && !named.contains(&"intermittent");
                wrong.expect(is_steady, || format!("{factor} {sigma} {}: {named:?}", other.is_some()));
            }
        }
        wrong.none();
    }

    /// A line whose frequency wanders within its stays is no sine, but it is named.
    #[test]
    fn what_comes_and_goes_and_wanders_is_named() {
        let mut wrong = Wrong::default();
        for (frequency_sigma_hz, seed) in [(0.05, 1), (0.3, 2)] {
            let line = json!({"effect": "wandering_line", "frequency_hz": 8.1, "amplitude": 0.03,
                "frequency_sigma_hz": frequency_sigma_hz, "frequency_tc_s": 5.0, "amplitude_sigma": 0.0, "amplitude_tc_s": 1.0});
            let mut real = recording(&model(None), seed, SAMPLES);
            let [quiet, with] =
                [None, Some(&line)].map(|of| recording(&model(of), seed + 50, SAMPLES).channels[0].1.clone());
            let stays = every(100.0, 40.0);
            for (t, value) in real.channels[0].1.iter_mut().enumerate() {
                let time_s = t as f64 / RATE_HZ;
                let is_there = stays.iter().any(|[from_s, to_s]| (*from_s..*to_s).contains(&time_s));
                *value += if is_there { with[t] - quiet[t] } else { 0.0 };
            }
            let found = diagnosed(&real, &model(None));
            let is_of_band =
                |name: &&str| ["intermittent", "modulated_band", "resonance", "wandering_line"].contains(name);
            let named = names(&found);
            wrong.expect(named.iter().any(is_of_band), || format!("{frequency_sigma_hz}: {named:?}"));
        }
        wrong.none();
    }

    /// A model states an amplitude, times or means of the times. A record that agrees has no gap.
    #[test]
    fn a_models_line_that_comes_and_goes_is_compared() {
        let mut wrong = Wrong::default();
        let own = intermittent(&tone(8.1, 0.03), &every(100.0, 40.0));
        let random = json!({"effect": "intermittent", "of": tone(8.1, 0.03), "on_s": 10.0, "off_s": 30.0});
        for (effect, seed) in [(&own, 1), (&random, 2)] {
            let found = diagnosed(&recording(&model(Some(effect)), seed, SAMPLES), &model(Some(effect)));
            let is_none = names(&found).is_empty() && found.diagnosis.verdict == Verdict::NoGap;
            wrong.expect(is_none, || format!("{effect}: {:?} {:?}", names(&found), found.diagnosis.notes));
        }
        let louder = intermittent(&tone(8.1, 0.06), &every(100.0, 40.0));
        let later: Vec<[f64; 2]> = every(100.0, 40.0).iter().map(|stay| stay.map(|at_s| at_s + 20.0)).collect();
        let later = intermittent(&tone(8.1, 0.03), &later);
        for (effect, seed) in [(&louder, 4), (&later, 5)] {
            let found = diagnosed(&recording(&model(Some(effect)), seed, SAMPLES), &model(Some(&own)));
            let cause = found.diagnosis.causes.first().map(|cause| (cause.effect.name(), cause.sense));
            let is_size = names(&found).len() == 1 && cause == Some(("intermittent", Sense::Size));
            wrong.expect(is_size, || format!("{effect}: {:?} {cause:?}", names(&found)));
        }
        wrong.none();
    }

    /// Its frequency has to be found with an error that turns it by much less than a cycle within a stay.
    #[test]
    fn a_line_with_one_long_stay_and_times_at_random_is_one_line() {
        let mut wrong = Wrong::default();
        let long = intermittent(&tone(8.1, 0.03), &[[500.0, 7000.0]]);
        let random = json!({"effect": "intermittent", "of": tone(8.1, 0.03), "on_s": 60.0, "off_s": 120.0});
        for (effect, seed) in [(&long, 1), (&long, 2), (&random, 3), (&random, 4)] {
            let found = diagnosed(&recording(&model(Some(effect)), seed, 300_000), &model(None));
            let named = names(&found);
            wrong.expect(named == ["intermittent"], || format!("{effect} seed {seed}: {named:?}"));
            let known = found.diagnosis.causes.first().and_then(|of| of.uncertainty.get("accel_x").cloned());
            let ends = known.map(|known| known[0]["of.amplitude"].clone()).unwrap_or_default();
            let [low, high] = [0, 1].map(|end| ends[end].as_f64().unwrap_or(f64::NAN));
            // Twice the half width: one interval in twenty misses.
            let is_known = (0.03 - 0.5 * (low + high)).abs() < high - low && high - low < 0.002;
            wrong.expect(is_known, || format!("{effect} seed {seed}: {ends}"));
        }
        wrong.none();
    }

    /// The first half has no stay from which the effects of the second could be learned.
    #[test]
    fn what_is_present_in_one_half_alone_is_no_unknown_effect() {
        let mut wrong = Wrong::default();
        for (of, seed) in [(tone(8.1, 0.03), 1), (band(8.1, 0.8, 0.02), 2)] {
            for stay in [[600.0, 900.0], [100.0, 400.0]] {
                let effect = intermittent(&of, &[stay]);
                let found = diagnosed(&recording(&model(Some(&effect)), seed, SAMPLES), &model(None));
                let is_right = names(&found) == ["intermittent"] && found.diagnosis.verdict == Verdict::Effects;
                let notes = &found.diagnosis.notes;
                wrong.expect(is_right, || {
                    format!("{effect}: {:?} {:?} {notes:?}", names(&found), found.diagnosis.verdict)
                });
            }
        }
        wrong.none();
    }

    #[test]
    fn a_sensor_that_does_not_move_has_no_levels() {
        assert!(TwoLevels::of(&[0.0; 40], 0.2).is_none());
        assert!(TwoLevels::of(&[f64::NAN; 40], 0.2).is_none());
        let steps: Vec<f64> = (0..48).map(|at| if at / 8 % 2 == 0 { 1e-3 } else { WHITE }).collect();
        let levels = TwoLevels::of(&steps, 0.2).map(|levels| levels.ranges());
        assert_eq!(levels, None);
        let steps: Vec<f64> = steps.iter().map(|of| of * of).collect();
        assert_eq!(TwoLevels::of(&steps, 0.2).map(|levels| levels.ranges()), Some(vec![8..16, 24..32, 40..48]));
    }
}
