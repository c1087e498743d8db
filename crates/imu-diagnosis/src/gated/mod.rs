//! Gated: lines and bands of noise that come and go. Their spectra are those of bands, but their power has two levels.

mod blocks;
mod model;
#[cfg(test)]
mod tests;
mod whitened;

pub(crate) use blocks::LOWEST;
pub(crate) use model::{OfModel, are_known, are_same, is_as_declared, of_model, stands_for};

use crate::averages::mean;
use crate::explanation::{GatedSine, LOUD, Stay, turning};
use crate::law::{Shape, Term};
use crate::series::Series;
use blocks::{apart, band_stays, line_blocks, line_stays};
use imu_model::effects::EffectKind;
use imu_model::simulator::ChannelModel;
use model::number_of;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::ops::Range;

/// A band of noise of the law that is present only at times.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Stays {
    /// The place of its term in the law.
    pub(crate) term: usize,
    /// The samples at which it is present, in order.
    pub(crate) ranges: Vec<Range<usize>>,
}

impl Stays {
    /// Returns the part of the samples from `from` to `to` at which it is present, or next to nothing.
    pub(crate) fn share(&self, from: usize, to: usize) -> f64 {
        const NOTHING: f64 = 1e-6;
        let inside = self.ranges.iter().map(|range| range.end.min(to).saturating_sub(range.start.max(from)));
        (inside.sum::<usize>() as f64 / (to - from).max(1) as f64).max(NOTHING)
    }

    /// Returns the number of samples at which it is present.
    pub(crate) fn samples(&self) -> usize {
        present(&self.ranges)
    }
}

/// Returns the number of samples in ranges.
fn present(ranges: &[Range<usize>]) -> usize {
    ranges.iter().map(Range::len).sum()
}

/// Returns, for each sample, whether it carries no information about lines: it is replaced.
pub(crate) fn left_out(series: &Series<'_>) -> Vec<bool> {
    let mut is_left_out = vec![false; series.len()];
    series.explanation.left_out(series.len(), series.reach()).iter().for_each(|at| is_left_out[*at] = true);
    for loud in series.explanation.loud.iter().filter(|loud| loud.ratio > LOUD) {
        is_left_out[series.spoilt(loud)].fill(true);
    }
    is_left_out
}

/// A band of noise that is present only at times.
pub(crate) struct Gate {
    /// The place of its term in the law; none for a band of the model.
    term: Option<usize>,
    /// The samples at which it is present, in order.
    pub(crate) ranges: Vec<Range<usize>>,
    /// Its mean power in each coefficient.
    pub(crate) power: Vec<f64>,
}

/// Returns the bands of the law and of the model that are present only at times.
pub(crate) fn gates(series: &Series<'_>) -> Vec<Gate> {
    let setting = series.setting();
    let has_bands = series.explanation.law.terms.iter().any(|term| term.shape == Shape::Resonance);
    // Most records have none of either.
    if !has_bands && setting.gated.iter().all(|of| of.width.is_none()) {
        return Vec::new();
    }
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
pub(crate) fn spectrum_at(series: &Series<'_>, gates: &[Gate], is_present: impl Fn(usize) -> bool) -> Vec<f64> {
    /// The least part of the mean spectrum that remains.
    const LEAST: f64 = 1e-6;
    let mut spectrum = series.spectrum.clone();
    for (at, gate) in gates.iter().enumerate() {
        let share = present(&gate.ranges) as f64 / series.len() as f64;
        let more = if is_present(at) { 1.0 / share - 1.0 } else { -1.0 };
        spectrum.iter_mut().zip(&gate.power).for_each(|(all, own)| *all += more * own);
    }
    spectrum.iter_mut().zip(&series.spectrum).for_each(|(own, all)| *own = own.max(LEAST * all));
    spectrum
}

/// Returns the bands of noise of the law that are present only at times.
pub(crate) fn stays(series: &Series<'_>) -> Vec<Stays> {
    let of = |gate: Gate| Some(Stays { term: gate.term?, ranges: gate.ranges });
    gates(series).into_iter().filter_map(of).collect()
}

/// Returns the sine at a frequency if it is present only at times. Made even, white noise hides at which times the sine has which
/// size: `None`.
pub(crate) fn sine(series: &Series<'_>, cycles: f64) -> Option<GatedSine> {
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
pub(crate) fn refine(series: &mut Series<'_>) {
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
pub(crate) fn errors(series: &Series<'_>, sine: &GatedSine) -> (f64, [f64; 2]) {
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

/// Returns a model's sines that come and go and that a series has with other times or numbers.
fn replaced<'a>(series: &'a Series<'_>) -> impl Iterator<Item = &'a OfModel> {
    let is_left_out = |of: &&OfModel| of.width.is_none() && series.explanation.without.contains(&of.place);
    series.setting().gated.iter().filter(is_left_out)
}

/// Returns the sines of a series that stand for a model's and have about its amplitude (`scale` is the unit of the series), with
/// the places of the model's.
pub(crate) fn as_declared(series: &Series<'_>, model: &ChannelModel, scale: f64) -> Vec<(usize, GatedSine)> {
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
