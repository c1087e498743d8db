//! Spectra: the record's spectra beside those of the original and the corrected model, for a picture of the gap.

use super::super::transform::Cosines;
use super::super::written::numbers;
use super::Recording;
use imu_core::sample::Channel;
use imu_model::effects::Record;
use imu_model::simulator::SensorModel;
use imu_model::simulator::spectrum::Spectrum;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Ratio of a bin's end to its start, minimum number of coefficients in a bin, and number of bins over the whole band.
const RATIO: f64 = 1.09;
const LEAST: usize = 6;
const BAND: usize = 240;
/// In bins of at most this many coefficients, each coefficient is compared with the model's value for it.
const NARROW: usize = 64;

/// Amplitude densities of one channel in U/√Hz (the root of the two-sided density, so that white noise stands at N).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChannelSpectra {
    /// The channel.
    pub channel: Cow<'static, str>,
    /// The unit, U.
    pub unit: Cow<'static, str>,
    /// Centres of the bins.
    #[serde(deserialize_with = "numbers")]
    pub frequency_hz: Vec<f64>,
    /// The number of independent coefficients in each bin, given the present samples. It distinguishes chance from a
    /// difference.
    #[serde(default)]
    pub coefficients: Vec<f64>,
    /// The record's spectrum: the root of the mean square in each bin.
    #[serde(deserialize_with = "numbers")]
    pub real: Vec<f64>,
    /// The original model's spectrum; none if it does not follow from the parameters alone and could not be simulated.
    #[serde(default, deserialize_with = "numbers")]
    pub before: Option<Vec<f64>>,
    /// The corrected model's spectrum.
    #[serde(default, deserialize_with = "numbers")]
    pub after: Option<Vec<f64>>,
    /// Mean of the ratio of the record's power to the model's in each bin, before and after.
    #[serde(default, deserialize_with = "numbers")]
    pub ratios: [Option<Vec<f64>>; 2],
    /// Whether each model's powers come from a simulation, with as much chance variation as the record's.
    #[serde(default)]
    pub simulated: [bool; 2],
    /// By how much the variance of a power exceeds that of normal stationary noise. It is greater if few samples carry
    /// the power.
    #[serde(default = "usual")]
    pub scatter: f64,
}

/// Returns the scatter of normal stationary noise, which results of earlier versions assume.
fn usual() -> f64 {
    1.0
}

impl ChannelSpectra {
    /// Returns the spectra of a record's channel. The models' spectra are those known from their parameters, else those
    /// of simulations.
    pub(super) fn new(
        bins: &mut Bins<'_>,
        (channel, values): (Channel, &[f64]),
        known: [Option<Known>; 2],
        simulations: &[Option<Vec<f64>>; 2],
    ) -> Self {
        let powers = bins.powers(values);
        let real = bins.means(&powers);
        let mut scatter = excess(values);
        let models = [0, 1].map(|index| match (&known[index], simulations[index].as_deref()) {
            (Some(Known { densities, powers: own }), _) => {
                let ratios = bins.ratios(&powers, own);
                (Some(densities.clone()), Some(ratios), false)
            }
            (None, Some(simulation)) => {
                scatter = scatter.max(excess(simulation));
                let own = bins.powers(simulation);
                let own = bins.means(&own);
                let ratios = real.iter().zip(&own).map(|(real, own)| short(real / own)).collect();
                (Some(roots(&own)), Some(ratios), true)
            }
            (None, None) => (None, None, false),
        });
        let [(before, ratios_before, simulated_before), (after, ratios_after, simulated_after)] = models;
        Self {
            channel: channel.name().into(),
            unit: channel.unit().into(),
            frequency_hz: bins.ends_hz.iter().map(|(from, to)| short((from * to).sqrt())).collect(),
            coefficients: bins.edges.windows(2).map(|of| short(bins.there * (of[1] - of[0]) as f64)).collect(),
            real: roots(&real),
            before,
            after,
            ratios: [ratios_before, ratios_after],
            simulated: [simulated_before, simulated_after],
            scatter: short(scatter),
        }
    }
}

/// The spectrum of a model, if it follows from the parameters alone.
#[derive(Debug, Clone)]
pub(super) struct Known {
    /// Roots of the power densities of the bins, U/√Hz.
    densities: Vec<f64>,
    /// Power densities: one per coefficient in narrow bins, where a steep spectrum differs from its middle value; one
    /// for all in other bins.
    powers: Vec<Vec<f64>>,
}

/// The bins of a record's spectra.
#[derive(Debug)]
pub(super) struct Bins<'a> {
    real: &'a Recording,
    transform: Cosines,
    /// First coefficient of each bin, and one past the last.
    edges: Vec<usize>,
    /// The frequencies at which the bins begin and end, Hz.
    ends_hz: Vec<(f64, f64)>,
    /// The share of present samples.
    there: f64,
}

impl<'a> Bins<'a> {
    pub(super) fn new(real: &'a Recording) -> Self {
        let edges = edges(real.len());
        let per_hz = 2.0 * real.len() as f64 / real.rate_hz;
        let ends_hz = edges.windows(2).map(|of| (of[0] as f64 / per_hz, of[1] as f64 / per_hz)).collect();
        let there = (0..real.len()).filter(|place| !real.is_missing(*place)).count();
        let there = there as f64 / real.len().max(1) as f64;
        Self { real, transform: Cosines::new(real.len()), edges, ends_hz, there }
    }

    /// Returns the power density of each coefficient of values with the record's missing samples. Straight lines bridge
    /// the missing samples. Such lines have almost no power above the lowest frequencies, so the present samples stand
    /// for them.
    fn powers(&mut self, values: &[f64]) -> Vec<f64> {
        let mut samples = bridged(values, &self.real.missing);
        self.transform.forward(&mut samples);
        let per = self.real.rate_hz * self.there;
        samples.iter().map(|value| value * value / per).collect()
    }

    /// Returns the means of powers over the bins.
    fn means(&self, powers: &[f64]) -> Vec<f64> {
        let mean =
            |of: &[usize]| powers.get(of[0]..of[1]).unwrap_or_default().iter().sum::<f64>() / (of[1] - of[0]) as f64;
        self.edges.windows(2).map(mean).collect()
    }

    /// Returns the means over the bins of the ratios to a model's powers.
    fn ratios(&self, powers: &[f64], model: &[Vec<f64>]) -> Vec<f64> {
        let of_bin = |(of, model): (&[usize], &Vec<f64>)| {
            let own = powers.get(of[0]..of[1]).unwrap_or_default();
            let sum: f64 = match model.as_slice() {
                [one] => own.iter().sum::<f64>() / one,
                each => own.iter().zip(each).map(|(power, model)| power / model).sum(),
            };
            short(sum / own.len() as f64)
        };
        self.edges.windows(2).zip(model).map(of_bin).collect()
    }

    /// Returns the spectrum of a model, if it follows from the parameters alone. `None` if it also depends on the other
    /// noise, the temperature or the record, as effects that occur once do.
    pub(super) fn of_model(&self, model: &SensorModel, channel: Channel) -> Option<Known> {
        let effects = &model.channels.get(&channel)?.effects;
        if effects.iter().any(|effect| effect.regressors() > 0 && effect.lines().is_empty()) {
            return None;
        }
        let record = Record { rate_hz: self.real.rate_hz, samples: self.real.len() as u64 };
        let spectrum = Spectrum::new(model, channel, record);
        let lines = spectrum.lines();
        let per_hz = 2.0 * self.real.len() as f64 / self.real.rate_hz;
        let of_bin = |(&(from, to), of): (&(f64, f64), &[usize])| {
            let inside = lines.iter().filter(|line| (from..to).contains(&line.frequency_hz));
            let lines: f64 = inside.map(|line| line.power / (2.0 * (to - from))).sum();
            let one_by_one = lines == 0.0 && of[1] - of[0] <= NARROW;
            let hz: Vec<f64> = match one_by_one {
                true => (of[0]..of[1]).map(|coefficient| coefficient as f64 / per_hz).collect(),
                false => vec![(from * to).sqrt()],
            };
            hz.into_iter().map(|hz| Some(spectrum.psd(hz)? + lines)).collect::<Option<Vec<f64>>>()
        };
        let powers = self.ends_hz.iter().zip(self.edges.windows(2)).map(of_bin).collect::<Option<Vec<_>>>()?;
        let mean = |of: &Vec<f64>| of.iter().sum::<f64>() / of.len() as f64;
        let densities = powers.iter().map(|of| short(mean(of).sqrt())).collect();
        Some(Known { densities, powers })
    }
}

fn roots(powers: &[f64]) -> Vec<f64> {
    powers.iter().map(|power| short(power.sqrt())).collect()
}

/// Returns the first coefficient of each bin, and one past the last.
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

/// Returns values less their mean. A straight line bridges missing samples, from the mean of as many samples before
/// them to that of as many behind. A line between two samples would carry their noise over the whole gap, which is much
/// at the lowest frequencies.
fn bridged(values: &[f64], missing: &[bool]) -> Vec<f64> {
    let there = |index: &usize| values[*index].is_finite() && !missing.get(*index).copied().unwrap_or(false);
    let places: Vec<usize> = (0..values.len()).filter(there).collect();
    let mean = places.iter().map(|at| values[*at]).sum::<f64>() / places.len().max(1) as f64;
    let mut out = vec![0.0; values.len()];
    for at in &places {
        out[*at] = values[*at] - mean;
    }
    for (place, pair) in places.windows(2).enumerate() {
        let (from, to) = (pair[0], pair[1]);
        let width = to - from - 1;
        if width == 0 {
            continue;
        }
        let level = |of: &[usize]| of.iter().map(|at| values[*at] - mean).sum::<f64>() / of.len() as f64;
        let before = level(&places[(place + 1).saturating_sub(width)..=place]);
        let behind = level(&places[place + 1..(place + 1 + width).min(places.len())]);
        for (step, value) in out[from + 1..to].iter_mut().enumerate() {
            *value = before + (behind - before) * (step + 1) as f64 / (to - from) as f64;
        }
    }
    out
}

/// Returns the fourth moment over that of a normal distribution: the variance of an average of squares over that of
/// normal noise; at least 1, as slow courses are flat.
fn excess(values: &[f64]) -> f64 {
    let there = || values.iter().filter(|value| value.is_finite());
    let count = there().count() as f64;
    let mean = there().sum::<f64>() / count;
    let moment = |power: i32| there().map(|value| (value - mean).powi(power)).sum::<f64>() / count;
    let (second, fourth) = (moment(2), moment(4));
    let over = fourth / (3.0 * second * second);
    if over.is_finite() { over.max(1.0) } else { 1.0 }
}

/// Returns the value to four digits, more than a picture shows.
fn short(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::super::simulated;
    use super::*;
    use imu_model::effects::{BiasStep, Tone};
    use imu_model::simulator::{ChannelModel, Simulator};
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
    fn a_true_models_ratios_are_one_where_the_spectrum_is_steep_and_where_samples_are_missing() {
        let model = SensorModel {
            name: "unit".to_owned(),
            rate_hz: 40.0,
            channels: [(Channel::GyroX, ChannelModel { n: 1e-3, k: 1e-4, ..ChannelModel::default() })].into(),
            ..SensorModel::default()
        };
        // Means over forty records of the first bin, and of the last bins with a twentieth of the samples missing.
        let (mut first, mut last) = (0.0, 0.0);
        for seed in 0..40 {
            let mut simulator = Simulator::new(&model, seed, 40.0, 200.0).unwrap();
            let values: Vec<f64> = (0..8000).map(|_| simulator.next_values()[Channel::GyroX as usize]).collect();
            let missing = (0..8000).map(|place| (4000..4400).contains(&place)).collect();
            let channels = vec![(Channel::GyroX, values)];
            let real = Recording { rate_hz: 40.0, channels, missing, ..Recording::default() };
            let mut bins = Bins::new(&real);
            let known = [0, 1].map(|_| bins.of_model(&model, Channel::GyroX));
            let (channel, values) = &real.channels[0];
            let of = ChannelSpectra::new(&mut bins, (*channel, values), known, &[None, None]);
            let ratios = of.ratios[0].as_ref().unwrap();
            first += ratios[0] / 40.0;
            let tail = &ratios[ratios.len() - 100..];
            last += tail.iter().sum::<f64>() / tail.len() as f64 / 40.0;
        }
        // A mean over 240 coefficients scatters by 9 %, one over tens of thousands by less than 1 %.
        assert!((first - 1.0).abs() < 0.4 && (last - 1.0).abs() < 0.02, "{first} {last}");
    }

    #[test]
    fn what_comes_once_is_in_a_simulations_spectrum() {
        let model = |effects: Vec<Arc<dyn imu_model::effects::Effect>>| SensorModel {
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
        assert!(of.scatter >= 1.0 && of.simulated == [false, true]);
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
        // A tenth of the samples has a hundred times the power: (0.1·10⁴ + 0.9)/10.9² for normal samples, a third of it
        // for signs.
        let knock = |index: i32| if index % 10 == 0 { 10.0 } else { 1.0 } * f64::from(1 - 2 * (index / 10 % 2));
        let knocks: Vec<f64> = (0..2000).map(knock).collect();
        assert!((excess(&knocks) - 1000.9 / 3.0 / 10.9 / 10.9).abs() < 1e-9 && excess(&[1.0, 2.0]) == 1.0);
        assert_eq!(excess(&[]), 1.0);
        assert!(edges(1000).windows(2).all(|of| of[0] < of[1]));
    }
}
