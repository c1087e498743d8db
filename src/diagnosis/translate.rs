//! Translation: an explanation in a series' scale becomes effects of the contract, in the channel's unit.

use super::course::Course;
use super::evidence::Kind;
use super::law::{Shape, Term};
use super::prepare::Prepared;
use super::series::{Explanation, Scedasticity};
use crate::effects::{
    BiasStep, Bursts, Comb, Effect, GaussMarkov, HeavyTails, LowPass, MovingAverage, QuantizationNoise, RateRamp,
    Resonance, Spikes, TemperatureBias, Tone, VarianceChange, WarmUp,
};
use std::sync::Arc;

/// What is needed besides the explanation.
#[derive(Debug, Clone, Copy)]
pub struct Units<'a> {
    /// The channel.
    pub prepared: &'a Prepared,
    /// Samples per second.
    pub rate_hz: f64,
    /// Samples.
    pub samples: usize,
    /// Mean temperature, °C.
    pub temperature_c: f64,
}

/// The effects of an explanation, each with its kind; those that the model has already are left out.
#[must_use]
pub fn effects(explanation: &Explanation, units: Units<'_>) -> Vec<(Kind, Arc<dyn Effect>)> {
    let Units { prepared, rate_hz, samples, temperature_c } = units;
    let scale = prepared.scale;
    let mut found: Vec<(Kind, Arc<dyn Effect>)> = Vec::new();
    for (course, factor) in &explanation.courses {
        let size = factor * scale;
        found.push(match course {
            Course::Ramp => (Kind::RateRamp, Arc::new(RateRamp { r: size * rate_hz / samples as f64 })),
            Course::Temperature => {
                (Kind::TemperatureBias, Arc::new(TemperatureBias { per_c: size, reference_c: temperature_c }))
            }
            Course::WarmUp(tau) => (Kind::WarmUp, Arc::new(WarmUp { amplitude: size, tau_s: tau / rate_hz })),
            Course::Step(at) => (Kind::BiasStep, Arc::new(BiasStep { at_s: *at as f64 / rate_hz, size })),
        });
    }
    let own = explanation.sines.get(prepared.sines.len()..).unwrap_or_default();
    let lines: Vec<(f64, f64)> = own.iter().map(|sine| (sine.cycles * rate_hz, scale * sine.amplitude())).collect();
    let (combs, tones) = combs(&lines, rate_hz / samples as f64);
    found.extend(combs.into_iter().map(|comb| (Kind::Tone, Arc::new(comb) as Arc<dyn Effect>)));
    for (frequency_hz, amplitude) in tones {
        found.push((Kind::Tone, Arc::new(Tone { frequency_hz, amplitude })));
    }
    for term in &explanation.law.terms {
        found.push(spectral(term, scale));
    }
    if let Some(degrees) = explanation.tails
        && !prepared.has.contains(&"heavy_tails")
    {
        found.push((Kind::HeavyTails, Arc::new(HeavyTails { degrees_of_freedom: degrees })));
    }
    let seconds = |sample: usize| sample as f64 / rate_hz;
    let loud = explanation.loud.get(prepared.loud.len()..).unwrap_or_default();
    let white = (0.5 * explanation.law.levels[0]).exp() * rate_hz.sqrt() * scale;
    match loud {
        [] => {}
        [one] if one.to - one.from >= samples / 50 || one.ratio < 1.0 => {
            let (from_s, to_s) = (seconds(one.from), seconds(one.to));
            let change = VarianceChange::Interval { from_s, to_s, factor: one.ratio.sqrt() };
            found.push((Kind::VarianceInterval, Arc::new(change)));
        }
        several => {
            let (sum, count) = several.iter().fold((0.0, 0.0), |(sum, count), of| {
                let width = (of.to - of.from) as f64;
                (sum + width * (of.ratio - 1.0).max(0.0), count + width)
            });
            let sigma = white * (sum / count).sqrt();
            let intervals = several.iter().map(|of| (seconds(of.from), seconds(of.to))).collect();
            found.push((Kind::Bursts, Arc::new(Bursts { intervals, sigma })));
        }
    }
    if prepared.scedasticity.is_none() {
        match &explanation.scedasticity {
            Some(Scedasticity::PerDegree(slope)) => {
                let change = VarianceChange::PerDegree { per_c: 0.5 * slope, reference_c: temperature_c };
                found.push((Kind::VariancePerDegree, Arc::new(change)));
            }
            Some(Scedasticity::Profile(values)) => {
                let last = (values.len().max(2) - 1) as f64;
                let at = |index: usize| index as f64 / last * seconds(samples);
                // About a mean square of 1, so that N keeps its meaning.
                let mean = values.iter().map(|value| value.exp()).sum::<f64>() / values.len().max(1) as f64;
                let points = values.iter().enumerate().map(|(i, value)| (at(i), (value.exp() / mean).sqrt())).collect();
                found.push((Kind::VarianceProfile, Arc::new(VarianceChange::Profile(points))));
            }
            None => {}
        }
    }
    if let Some(spikes) = explanation.spikes
        && !prepared.has.contains(&"spikes")
    {
        let of = Spikes { rate_hz: spikes.rate * rate_hz, amplitude: spikes.size * scale };
        found.push((Kind::Spikes, Arc::new(of)));
    }
    found
}

fn spectral(term: &Term, scale: f64) -> (Kind, Arc<dyn Effect>) {
    let at = |index: usize| term.numbers.get(index).copied().unwrap_or_default();
    let size = |index: usize| (0.5 * at(index)).exp() * scale;
    match term.shape {
        Shape::QuantizationNoise => (Kind::QuantizationNoise, Arc::new(QuantizationNoise { q: size(0) })),
        Shape::GaussMarkov => (Kind::GaussMarkov, Arc::new(GaussMarkov { sigma: size(0), tc_s: at(1).exp() })),
        Shape::Resonance => {
            let of = Resonance { sigma: size(0), frequency_hz: at(1), bandwidth_hz: at(2).exp() };
            (Kind::Resonance, Arc::new(of))
        }
        Shape::LowPass(order) => (Kind::LowPass, Arc::new(LowPass { cutoff_hz: at(0).exp(), order })),
        Shape::MovingAverage(window) => (Kind::MovingAverage, Arc::new(MovingAverage { window })),
    }
}

/// Lines at whole multiples of the lowest of them, within what a record of 1/`resolution_hz` tells apart, are one comb; the
/// others are tones.
fn combs(lines: &[(f64, f64)], resolution_hz: f64) -> (Vec<Comb>, Vec<(f64, f64)>) {
    const HARMONICS: f64 = 12.0;
    let mut left: Vec<(f64, f64)> = lines.to_vec();
    left.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut combs = Vec::new();
    let mut index = 0;
    while index < left.len() {
        let (fundamental_hz, _) = left[index];
        let order = |line: &(f64, f64)| {
            let order = (line.0 / fundamental_hz).round();
            let near = (line.0 - order * fundamental_hz).abs() < 0.25 * order * resolution_hz;
            (near && order <= HARMONICS).then_some(order as usize)
        };
        let harmonics: Vec<(usize, f64)> = left.iter().filter_map(|line| Some((order(line)?, line.1))).collect();
        if harmonics.len() < 2 {
            index += 1;
            continue;
        }
        let highest = harmonics.iter().map(|(order, _)| *order).max().unwrap_or(1);
        let mut amplitudes = vec![0.0; highest];
        harmonics.iter().for_each(|(order, peak)| amplitudes[order - 1] = *peak);
        // The highest harmonic tells the fundamental best.
        let best = left.iter().filter_map(|line| Some(line.0 / order(line)? as f64)).next_back();
        combs.push(Comb { fundamental_hz: best.unwrap_or(fundamental_hz), amplitudes });
        left.retain(|line| order(line).is_none());
    }
    (combs, left)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_are_one_comb_and_others_stay_tones() {
        let lines = [(3.1, 1.0), (12.4001, 0.2), (5.0, 0.7), (9.3, 0.5), (7.77, 0.1)];
        let (combs, tones) = combs(&lines, 0.001);
        assert_eq!(combs.len(), 1);
        assert_eq!(combs[0].amplitudes, [1.0, 0.0, 0.5, 0.2]);
        assert!((combs[0].fundamental_hz - 3.1).abs() < 1e-3);
        assert_eq!(tones, [(5.0, 0.7), (7.77, 0.1)]);
    }
}
