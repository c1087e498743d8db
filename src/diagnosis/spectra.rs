//! Spectra: a record's beside those of the model as it came and of the corrected one, for a picture of the gap.

use super::recording::Recording;
use super::transform::Cosines;
use crate::effects::Record;
use crate::sample::Channel;
use crate::simulator::SensorModel;
use crate::simulator::spectrum::Spectrum;
use serde::Serialize;

/// Ratio of a bin's end to its begin, coefficients in it at least, and bins over the whole band.
const RATIO: f64 = 1.09;
const LEAST: usize = 6;
const BAND: usize = 240;

/// Amplitude densities of one channel in U/√Hz (the root of the two-sided density, so that white noise stands at N).
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "data")]
pub struct ChannelSpectra {
    /// The channel.
    pub channel: &'static str,
    /// U.
    pub unit: &'static str,
    /// Centres of the bins.
    pub frequency_hz: Vec<f64>,
    /// The record's: root of the mean of the squares in the bin.
    pub real: Vec<f64>,
    /// The model's as it came; none where it has an effect whose spectrum is not its parameters' alone.
    pub before: Option<Vec<f64>>,
    /// The corrected model's.
    pub after: Option<Vec<f64>>,
}

/// Spectra of the channels of a model. Missing samples are bridged by straight lines; what drifts is in the record's alone.
#[must_use]
pub fn spectra(real: &Recording, sim: &SensorModel, augmented: &SensorModel) -> Vec<ChannelSpectra> {
    let mut transform = Cosines::new(real.len());
    let edges = edges(real.len());
    let per_hz = 2.0 * real.len() as f64 / real.rate_hz;
    let bins: Vec<(f64, f64)> = edges.windows(2).map(|of| (of[0] as f64 / per_hz, of[1] as f64 / per_hz)).collect();
    let channels = real.channels.iter().filter(|(channel, _)| sim.channels.contains_key(channel));
    channels
        .map(|(channel, values)| {
            let mut samples = bridged(values, &real.missing);
            transform.forward(&mut samples);
            let mean_square = |of: &[usize]| {
                let squares = samples.get(of[0]..of[1]).unwrap_or_default().iter().map(|value| value * value);
                squares.sum::<f64>() / (of[1] - of[0]) as f64
            };
            ChannelSpectra {
                channel: channel.name(),
                unit: channel.unit(),
                frequency_hz: bins.iter().map(|(from, to)| short((from * to).sqrt())).collect(),
                real: edges.windows(2).map(|of| short((mean_square(of) / real.rate_hz).sqrt())).collect(),
                before: of_model(sim, *channel, real, &bins),
                after: of_model(augmented, *channel, real, &bins),
            }
        })
        .collect()
}

/// First coefficient of each bin, and one past the last.
fn edges(samples: usize) -> Vec<usize> {
    let mut edges = vec![1];
    let widest = (samples / BAND).max(LEAST);
    let mut from = 1;
    while from + LEAST < samples {
        let width = ((from as f64 * (RATIO - 1.0)) as usize).clamp(LEAST, widest);
        from = (from + width).min(samples);
        edges.push(from);
    }
    edges
}

fn of_model(model: &SensorModel, channel: Channel, real: &Recording, bins: &[(f64, f64)]) -> Option<Vec<f64>> {
    let spectrum = Spectrum::new(model, channel, Record { rate_hz: real.rate_hz, samples: real.len() as u64 });
    let lines = spectrum.lines();
    let density = |(from, to): &(f64, f64)| {
        let inside = lines.iter().filter(|line| (*from..*to).contains(&line.frequency_hz));
        let lines: f64 = inside.map(|line| line.power / (2.0 * (to - from))).sum();
        Some(short((spectrum.psd((from * to).sqrt())? + lines).sqrt()))
    };
    bins.iter().map(density).collect()
}

/// Values less their mean; straight lines where samples are missing.
fn bridged(values: &[f64], missing: &[bool]) -> Vec<f64> {
    let there = |index: &usize| values[*index].is_finite() && !missing.get(*index).copied().unwrap_or(false);
    let places: Vec<usize> = (0..values.len()).filter(there).collect();
    let mean = places.iter().map(|at| values[*at]).sum::<f64>() / places.len().max(1) as f64;
    let mut out = vec![0.0; values.len()];
    let mut last: Option<usize> = None;
    for at in places {
        out[at] = values[at] - mean;
        let from = last.unwrap_or(at);
        for between in from + 1..at {
            let share = (between - from) as f64 / (at - from) as f64;
            out[between] = out[from] + share * (out[at] - out[from]);
        }
        last = Some(at);
    }
    out
}

/// The value to four digits, more than a picture shows.
fn short(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Tone;
    use crate::simulator::{ChannelModel, Simulator};
    use std::sync::Arc;

    #[test]
    fn the_corrected_model_lies_on_the_record_and_the_plain_one_lacks_the_line() {
        let plain = SensorModel {
            name: "unit".to_owned(),
            rate_hz: 40.0,
            channels: [(Channel::AccelZ, ChannelModel { n: 2e-3, ..ChannelModel::default() })].into(),
            ..SensorModel::default()
        };
        let mut rich = plain.clone();
        let tone = Tone { frequency_hz: 11.4, amplitude: 4e-3 };
        rich.channels.get_mut(&Channel::AccelZ).unwrap().effects.push(Arc::new(tone));
        let mut simulator = Simulator::new(&rich, 3, 40.0, 500.0).unwrap();
        let mut values: Vec<f64> =
            (0..20_000).map(|_| simulator.next_values()[Channel::AccelZ as usize] - 9.8).collect();
        values[77] = f64::NAN;
        let real = Recording { rate_hz: 40.0, channels: vec![(Channel::AccelZ, values)], ..Recording::default() };
        let found = spectra(&real, &plain, &rich);
        let [of] = found.as_slice() else { panic!("{found:?}") };
        let (before, after) = (of.before.as_ref().unwrap(), of.after.as_ref().unwrap());
        assert!((200..400).contains(&of.real.len()), "{}", of.real.len());
        for (index, hz) in of.frequency_hz.iter().enumerate() {
            let (ratio_before, ratio_after) = (of.real[index] / before[index], of.real[index] / after[index]);
            let is_line = (hz - 11.4).abs() < 0.05;
            assert!(is_line == (ratio_before > 1.7), "{hz} Hz: {ratio_before}");
            // A line leaks a little into the bins beside its own.
            assert!((hz - 11.4).abs() < 0.3 || (ratio_after - 1.0).abs() < 0.7, "{hz} Hz: {ratio_after}");
            assert!(!is_line || (ratio_after - 1.0).abs() < 0.3, "{hz} Hz: {ratio_after}");
        }
    }

    #[test]
    fn what_is_missing_is_bridged_and_numbers_are_short() {
        assert_eq!(bridged(&[1.0, f64::NAN, 3.0, 9.0], &[false, false, false, true]), [-1.0, 0.0, 1.0, 0.0]);
        assert_eq!((short(0.001_234_56), short(-98_765.4), short(0.0)), (0.001_235, -98_770.0, 0.0));
        assert!(edges(1000).windows(2).all(|of| of[0] < of[1]));
    }
}
