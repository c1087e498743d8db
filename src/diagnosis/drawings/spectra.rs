//! Spectra: a record's beside those of the model as it came and of the corrected one, for a picture of the gap.

use super::super::transform::Cosines;
use super::Recording;
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
    /// Coefficients in each bin, by which chance is told from a difference.
    pub coefficients: Vec<usize>,
    /// The record's: root of the mean of the squares in the bin.
    pub real: Vec<f64>,
    /// The model's as it came; none where it is neither its parameters' alone nor could be simulated.
    pub before: Option<Vec<f64>>,
    /// The corrected model's.
    pub after: Option<Vec<f64>>,
    /// By how much the variance of record over model, before and after, exceeds that of normal stationary noise over what is
    /// known: a simulation has chance of its own, and where few samples carry the power it is greater.
    pub scatter: [f64; 2],
}

impl ChannelSpectra {
    /// Of a record's channel; the models' spectra as they are known, else those of simulations.
    pub(super) fn new(
        bins: &mut Bins<'_>,
        (channel, values): (Channel, &[f64]),
        known: [Option<Vec<f64>>; 2],
        simulations: &[Option<Vec<f64>>; 2],
    ) -> Self {
        let real = bins.densities(values);
        let mut own = simulations.each_ref().map(|values| values.as_deref().map(|values| bins.densities(values)));
        let scatter = [0, 1].map(|index| {
            let simulation = simulations[index].as_deref().filter(|_| known[index].is_none());
            short(excess(values) + simulation.map_or(0.0, excess))
        });
        let [before, after] = known;
        Self {
            channel: channel.name(),
            unit: channel.unit(),
            frequency_hz: bins.ends_hz.iter().map(|(from, to)| short((from * to).sqrt())).collect(),
            coefficients: bins.edges.windows(2).map(|of| of[1] - of[0]).collect(),
            real,
            before: before.or_else(|| own[0].take()),
            after: after.or_else(|| own[1].take()),
            scatter,
        }
    }
}

/// The bins of a record's spectra.
#[derive(Debug)]
pub(super) struct Bins<'a> {
    real: &'a Recording,
    transform: Cosines,
    /// First coefficient of each bin, and one past the last.
    edges: Vec<usize>,
    /// Where they begin and end, Hz.
    ends_hz: Vec<(f64, f64)>,
}

impl<'a> Bins<'a> {
    pub(super) fn new(real: &'a Recording) -> Self {
        let edges = edges(real.len());
        let per_hz = 2.0 * real.len() as f64 / real.rate_hz;
        let ends_hz = edges.windows(2).map(|of| (of[0] as f64 / per_hz, of[1] as f64 / per_hz)).collect();
        Self { real, transform: Cosines::new(real.len()), edges, ends_hz }
    }

    /// Of values with the record's missing samples, which are bridged by straight lines.
    fn densities(&mut self, values: &[f64]) -> Vec<f64> {
        let mut samples = bridged(values, &self.real.missing);
        self.transform.forward(&mut samples);
        let mean_square = |of: &[usize]| {
            let squares = samples.get(of[0]..of[1]).unwrap_or_default().iter().map(|value| value * value);
            squares.sum::<f64>() / (of[1] - of[0]) as f64
        };
        self.edges.windows(2).map(|of| short((mean_square(of) / self.real.rate_hz).sqrt())).collect()
    }

    /// Of a model whose spectrum is its parameters' alone: none where it also depends on the other noise, the temperature or
    /// the record, as what comes once does.
    pub(super) fn of_model(&self, model: &SensorModel, channel: Channel) -> Option<Vec<f64>> {
        let effects = &model.channels.get(&channel)?.effects;
        if effects.iter().any(|effect| effect.regressors() > 0 && effect.lines().is_empty()) {
            return None;
        }
        let record = Record { rate_hz: self.real.rate_hz, samples: self.real.len() as u64 };
        let spectrum = Spectrum::new(model, channel, record);
        let lines = spectrum.lines();
        let density = |(from, to): &(f64, f64)| {
            let inside = lines.iter().filter(|line| (*from..*to).contains(&line.frequency_hz));
            let lines: f64 = inside.map(|line| line.power / (2.0 * (to - from))).sum();
            Some(short((spectrum.psd((from * to).sqrt())? + lines).sqrt()))
        };
        self.ends_hz.iter().map(density).collect()
    }
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

/// The fourth moment over a normal one's: the variance of an average of squares over that of normal noise; at least 1, as slow
/// courses are flat.
fn excess(values: &[f64]) -> f64 {
    let there = || values.iter().filter(|value| value.is_finite());
    let count = there().count() as f64;
    let mean = there().sum::<f64>() / count;
    let moment = |power: i32| there().map(|value| (value - mean).powi(power)).sum::<f64>() / count;
    let (second, fourth) = (moment(2), moment(4));
    let over = fourth / (3.0 * second * second);
    if over.is_finite() { over.max(1.0) } else { 1.0 }
}

/// The value to four digits, more than a picture shows.
fn short(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::super::simulated;
    use super::*;
    use crate::effects::{BiasStep, Tone};
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
        let mut bins = Bins::new(&real);
        let known = [&plain, &rich].map(|model| bins.of_model(model, Channel::AccelZ));
        let (channel, values) = &real.channels[0];
        let of = ChannelSpectra::new(&mut bins, (*channel, values), known, &[None, None]);
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
    fn what_comes_once_is_in_a_simulations_spectrum() {
        let model = |effects: Vec<Arc<dyn crate::effects::Effect>>| SensorModel {
            name: "unit".to_owned(),
            rate_hz: 40.0,
            channels: [(Channel::GyroX, ChannelModel { n: 1e-3, effects, ..ChannelModel::default() })].into(),
            ..SensorModel::default()
        };
        let step = BiasStep { at_s: 200.0, size: 0.01 };
        let (plain, stepped) = (model(vec![]), model(vec![Arc::new(step)]));
        let mut simulator = Simulator::new(&stepped, 3, 40.0, 500.0).unwrap();
        let values: Vec<f64> = (0..20_000).map(|_| simulator.next_values()[Channel::GyroX as usize]).collect();
        let real = Recording { rate_hz: 40.0, channels: vec![(Channel::GyroX, values)], ..Recording::default() };
        let mut bins = Bins::new(&real);
        let known = [&plain, &stepped].map(|model| bins.of_model(model, Channel::GyroX));
        assert!(known[0].is_some() && known[1].is_none());
        let own = simulated(&real, &stepped, Channel::GyroX);
        let (channel, values) = &real.channels[0];
        let of = ChannelSpectra::new(&mut bins, (*channel, values), known, &[None, own]);
        assert!(of.scatter[0] >= 1.0 && of.scatter[1] >= 2.0, "{:?}", of.scatter);
        let (before, after) = (of.before.unwrap()[0], of.after.unwrap()[0]);
        assert!(
            of.real[0] / before > 20.0 && (of.real[0] / after - 1.0).abs() < 0.2,
            "{before} {} {after}",
            of.real[0]
        );
    }

    #[test]
    fn what_is_missing_is_bridged_and_numbers_are_short() {
        assert_eq!(bridged(&[1.0, f64::NAN, 3.0, 9.0], &[false, false, false, true]), [-1.0, 0.0, 1.0, 0.0]);
        assert_eq!((short(0.001_234_56), short(-98_765.4), short(0.0)), (0.001_235, -98_770.0, 0.0));
        // A tenth of the samples has a hundred times the power: (0.1·10⁴ + 0.9)/10.9² for normal ones, a third of it for signs.
        let knock = |index: i32| if index % 10 == 0 { 10.0 } else { 1.0 } * f64::from(1 - 2 * (index / 10 % 2));
        let knocks: Vec<f64> = (0..2000).map(knock).collect();
        assert!((excess(&knocks) - 1000.9 / 3.0 / 10.9 / 10.9).abs() < 1e-9 && excess(&[1.0, 2.0]) == 1.0);
        assert_eq!(excess(&[]), 1.0);
        assert!(edges(1000).windows(2).all(|of| of[0] < of[1]));
    }
}
