//! Lines: sines and narrow bands of noise.

use super::{Candidate, Kind};
use crate::averages::sums;
use crate::explanation::{GatedSine, Sine, alternates, per_product, turning};
use crate::gated;
use crate::grid::Narrow;
use crate::law::{Data, Law, Shape, Term};
use crate::series::Series;
use imu_model::effects::{Effect, Resonance};

/// Sines need at least this number of periods in the record. With fewer periods, a record cannot show that they recur.
const LEAST_PERIODS: f64 = 3.0;

/// Returns the strongest line of a residual's periodogram: its gain in nats at the present law, and its frequency in
/// cycles per sample.
fn strongest(periodogram: &[f64]) -> Option<(f64, f64)> {
    let n = periodogram.len().checked_sub(1)?;
    let from = (2.0 * LEAST_PERIODS) as usize;
    // At half the rate there is no sine beside the cosine.
    let power = |k: usize| if k == n { 0.5 * periodogram[k] } else { periodogram[k] };
    let k = (from..=n).max_by(|a, b| power(*a).total_cmp(&power(*b)))?;
    if k == n {
        return Some((power(k), 0.5));
    }
    // Fits a parabola to ln of the power; its top is the frequency.
    let (left, middle, right) = (power(k - 1).ln(), power(k).ln(), power(k + 1).ln());
    let curvature = left - 2.0 * middle + right;
    let shift = if curvature < 0.0 { (0.5 * (left - right) / curvature).clamp(-0.5, 0.5) } else { 0.0 };
    Some((power(k), (k as f64 + shift) / (2.0 * n as f64)))
}

/// Returns Σ x·cos and Σ x·sin at a frequency.
fn products(values: &[f64], cycles: f64) -> [f64; 2] {
    let mut sums = [0.0; 2];
    turning(cycles, values.len(), |t, cosine, sine| {
        sums[0] += values[t] * cosine;
        sums[1] += values[t] * sine;
    });
    sums
}

/// Returns the frequency near `cycles` with the greatest power, in a record of `samples` samples.
fn peak(samples: usize, cycles: f64, power: impl Fn(f64) -> f64) -> f64 {
    let mut best = (power(cycles), cycles);
    let mut width = 0.15 / samples as f64;
    for _ in 0..6 {
        let (left, right) = (power(best.1 - width), power(best.1 + width));
        let curvature = left - 2.0 * best.0 + right;
        let shift = if curvature < 0.0 { (0.5 * width * (left - right) / curvature).clamp(-width, width) } else { 0.0 };
        let there = power(best.1 + shift);
        if there > best.0 {
            best = (there, best.1 + shift);
        }
        width *= 0.4;
    }
    best.1
}

/// The part of the spectrum to either side of a line that comes and goes that is its foot, in cycles per sample.
const FOOT: f64 = 0.01;

/// Returns the strongest line of a residual's periodogram that is always present, and the candidates of those that are present
/// only at times: the model's, and the strongest other. The spectrum of such a line has a foot that looks like further lines.
fn lines(series: &Series<'_>, mut periodogram: Vec<f64>) -> (Option<(f64, f64)>, Vec<Candidate>) {
    /// Smallest gain in nats of a line that blocks show, as a line and as one that comes and goes.
    const SHOWN: f64 = 40.0;
    /// Maximum number of lines that are examined.
    const MOST: usize = 6;
    let gates = series.setting().gates;
    let find = |cycles: f64| gated::sine(series, cycles).map(|sine| come_and_go(series, sine));
    let is_left = |of: &&gated::OfModel| of.width.is_none() && !series.explanation.without.contains(&of.place);
    let declared = series.setting().gated.iter().filter(|_| gates).filter(is_left);
    let mut found: Vec<Candidate> = declared.filter_map(|of| find(of.cycles)).collect();
    let known = found.len();
    for _ in 0..MOST {
        let Some((power, cycles)) = strongest(&periodogram) else { break };
        let is_new = !series.explanation.gated.iter().any(|own| gated::are_same(own.cycles, cycles, series.len()));
        let gated = (gates && is_new && power > SHOWN).then(|| find(cycles)).flatten().filter(|of| of.gain > SHOWN);
        let Some(gated) = gated else { return (Some((power, cycles)), found) };
        if found.len() == known {
            found.push(gated);
        }
        let n = (periodogram.len() - 1) as f64;
        let [from, to] = [cycles - FOOT, cycles + FOOT].map(|end| (2.0 * n * end).clamp(0.0, n) as usize);
        periodogram[from..to].fill(f64::MIN_POSITIVE);
    }
    (None, found)
}

/// Returns the candidate of a sine that comes and goes. It replaces the model's of the same frequency.
fn come_and_go(series: &Series<'_>, sine: GatedSine) -> Candidate {
    let n = series.len();
    let is_same = |of: &&gated::OfModel| of.width.is_none() && gated::are_same(of.cycles, sine.cycles, n);
    let of_model = series.setting().gated.iter().find(is_same).map(|of| of.place);
    let of_model = of_model.filter(|place| !series.explanation.without.contains(place));
    let bare = of_model.map(|place| series.without_declared(place));
    let own = bare.as_ref().unwrap_or(series);
    let mut rest = series.rest.clone();
    sine.add(-1.0, &mut rest);
    let mut transform = series.transform.clone();
    transform.forward(&mut rest);
    let fitted = own.explanation.law.fit(own.data_of(&own.grid.power(&rest)));
    // Both ends of each stay, and its phase.
    let cost = sine.stays.len() as f64 * (2.0 * (n as f64).ln() + 7.0);
    let gain = fitted.log_posterior - series.fitted.log_posterior - cost;
    let mut explanation = own.explanation.clone();
    explanation.law = fitted.law;
    explanation.gated.push(sine);
    Candidate::missing(Kind::Intermittent, gain, explanation)
}

/// Returns the periodogram of the residual, with the mean 1 at the present law.
fn periodogram(series: &mut Series<'_>) -> Vec<f64> {
    series.transform.periodogram(&series.residual)
}

/// Returns the mean power of the residual about a line relative to the law, 1 or more. Near the line it is estimated from
/// medians, which other lines do not raise: of the greatest of three widths.
pub fn surroundings(series: &mut Series<'_>, cycles: f64) -> f64 {
    /// Half widths, and the half width of the line, in values of the periodogram.
    const WIDTHS: [usize; 3] = [20, 64, 256];
    const LINE: usize = 4;
    let periodogram = periodogram(series);
    let last = periodogram.len() - 1;
    let at = ((2.0 * last as f64 * cycles) as usize).min(last);
    let mean = |width: usize| {
        let below = at.saturating_sub(width).max(1)..at.saturating_sub(LINE).max(1);
        let above = (at + LINE + 1).min(last)..(at + width).min(last);
        let mut near: Vec<f64> = periodogram[below].iter().chain(&periodogram[above]).copied().collect();
        let middle = near.len() / 2;
        if near.is_empty() {
            return 1.0;
        }
        // Powers are distributed exponentially.
        *near.select_nth_unstable_by(middle, f64::total_cmp).1 / std::f64::consts::LN_2
    };
    WIDTHS.map(mean).into_iter().fold(1.0, f64::max)
}

/// Searches for a sine that is always present: the strongest that remains.
pub fn tone(series: &mut Series<'_>) -> Option<Candidate> {
    sines(series).0
}

/// Searches for sines: the strongest that is always present, and those that come and go.
pub fn sines(series: &mut Series<'_>) -> (Option<Candidate>, Vec<Candidate>) {
    let periodogram = periodogram(series);
    let (strongest, gated) = lines(series, periodogram);
    (strongest.and_then(|line| steady(series, line)), gated)
}

/// Returns the candidate of a sine of this gain and frequency.
fn steady(series: &mut Series<'_>, (power, cycles): (f64, f64)) -> Option<Candidate> {
    let n = series.len();
    let mut explanation = series.explanation.clone();
    // The greatest of n values is about this large by chance.
    if power < (n as f64).ln() + 1.0 {
        return Some(Candidate::missing(Kind::Tone, power, explanation));
    }
    if series.is_slow(cycles) {
        let cycles = peak(n, cycles, |cycles| series.turn(cycles).0);
        let drift = series.with_columns(&series.setting().courses.turning(cycles));
        explanation.sines.push(Sine { cycles, quadratures: [drift.factors[0], drift.factors[1]] });
        explanation.law = drift.law;
        return Some(Candidate::missing(Kind::Tone, drift.gain, explanation));
    }
    let power = |cycles: f64| products(&series.residual, cycles).iter().map(|sum| sum * sum).sum();
    let cycles = if cycles < 0.5 { peak(n, cycles, power) } else { cycles };
    let cycles = if alternates(cycles, n) { 0.5 } else { cycles };
    let spectrum = {
        let k = 2.0 * n as f64 * cycles;
        let below = (k as usize).clamp(1, n - 1);
        series.spectrum[below]
    };
    // In the whitened series a sine is one of 1/√S.
    let mut rest = series.rest.clone();
    let quadratures = products(&series.residual, cycles).map(|sum| per_product(cycles, n) * sum * spectrum.sqrt());
    let sine = Sine { cycles, quadratures };
    turning(cycles, n, |t, cosine, sine| rest[t] -= quadratures[0] * cosine + quadratures[1] * sine);
    series.transform.forward(&mut rest);
    let power = series.grid.power(&rest);
    let fitted = series.explanation.law.fit(series.data_of(&power));
    let gain = fitted.log_posterior - series.fitted.log_posterior;
    explanation.sines.push(sine);
    explanation.law = fitted.law;
    Some(Candidate::missing(Kind::Tone, gain, explanation))
}

/// Returns whether the band that a candidate adds is the foot of a sine that comes and goes and explains about as much.
pub fn is_foot(series: &Series<'_>, of: &Candidate, gated: &Candidate) -> bool {
    /// Part of the band's gain that the sine has at least.
    const AS_MUCH: f64 = 0.7;
    let band = of.explanation.law.terms.last().filter(|term| term.shape == Shape::Resonance);
    let both = band.zip(gated.explanation.gated.last());
    let is_near = both.is_some_and(|(band, sine)| (band.at(1) / series.setting().rate_hz - sine.cycles).abs() < FOOT);
    is_near && gated.gain > AS_MUCH * of.gain
}

/// Searches for a narrow band of noise.
pub fn resonance(series: &Series<'_>) -> Option<Candidate> {
    const WIDTHS: [f64; 6] = [0.0001, 0.0004, 0.0015, 0.005, 0.015, 0.04];
    const MOST: usize = 4;
    let n = series.len();
    let bands = series.explanation.law.terms.iter().filter(|term| term.shape == Shape::Resonance).count();
    if bands >= MOST {
        return None;
    }
    // The band that is most conspicuous, at several widths.
    let sums = sums(series.whitened[1..n].iter().map(|c| c * c));
    let mut best: Option<(f64, f64, f64, f64)> = None;
    let from = ((gated::LOWEST * 2.0 * n as f64) as usize).max(8);
    for width in WIDTHS {
        let count = ((width * 2.0 * n as f64) as usize).max(8);
        let mut k = from;
        while k + count < n {
            let ratio = (sums[k + count] - sums[k]) / count as f64;
            if ratio > 1.0 {
                let score = 0.5 * count as f64 * (ratio - 1.0 - ratio.ln());
                if best.is_none_or(|best| score > best.0) {
                    best = Some((score, (k as f64 + 0.5 * count as f64) / (2.0 * n as f64), count as f64, ratio));
                }
            }
            k += (count / 8).max(1);
        }
    }
    let (score, cycles, count, ratio) = best?;
    let rate_hz = series.setting().rate_hz;
    let (frequency_hz, width_hz) = (cycles * rate_hz, count / (2.0 * n as f64) * rate_hz);
    let mut explanation = series.explanation.clone();
    // The approximate gain of chance.
    if score < 9.0 {
        return Some(Candidate::missing(Kind::Resonance, score.max(0.0), explanation));
    }
    let grid = series.resolving(&[Narrow { frequency_hz, width_hz: 0.5 * width_hz }]);
    let power = grid.power(&series.coefficients);
    let base = (series.setting().base)(&grid, &series.explanation.without);
    let worth = series.worth_on(&grid, &base);
    let data = Data { grid: &grid, power: &power, worth: &worth, base: &base, priors: &series.priors };
    let without = series.explanation.law.fit(data);
    let level = {
        let k = ((cycles * 2.0 * n as f64) as usize).clamp(1, n - 1);
        series.spectrum[k]
    };
    let start = |share: f64, ratio: f64| {
        let bandwidth_hz = share * width_hz;
        // The two-sided peak of such a band is σ²·rate/(π·bandwidth).
        let unit = Resonance::new(frequency_hz, bandwidth_hz, 1.0);
        let top = rate_hz * unit.psd(frequency_hz, rate_hz).unwrap_or(1.0);
        let mut law = without.law.clone();
        let sigma2 = (ratio - 1.0).max(0.05) * level / top;
        law.terms.push(Term { shape: Shape::Resonance, numbers: vec![sigma2.ln(), frequency_hz, bandwidth_hz.ln()] });
        law
    };
    let with = Law::fit_best(vec![start(0.6, ratio), start(0.2, 2.0 * ratio)], data)?;
    let mut alone = with.law.clone();
    alone.terms.pop();
    let alone = alone.fit(data).log_posterior.max(without.log_posterior);
    explanation.law = with.law;
    Some(Candidate::missing(Kind::Resonance, with.log_posterior - alone, explanation))
}
