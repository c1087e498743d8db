//! Timelines: level and spread over time of a record, of a simulation of the original model, and of one of the
//! corrected model.

use super::super::written::numbers;
use super::Recording;
use imu_core::sample::Channel;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Number of stretches over the record, and minimum number of samples in a stretch.
const STRETCHES: usize = 240;
const LEAST: usize = 16;
/// Fewest samples in a record for which a timeline is drawn.
const SHORTEST: usize = 4 * LEAST;

/// Values over time, U, one per stretch; None if more than half of a stretch is missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stretches {
    /// Means, less the overall mean.
    pub level: Vec<Option<f64>>,
    /// Standard deviations inside the stretches.
    pub spread: Vec<Option<f64>>,
}

/// The timeline of a channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChannelTimeline {
    /// The channel.
    pub channel: Cow<'static, str>,
    /// The unit, U.
    pub unit: Cow<'static, str>,
    /// The stretches' middles, s since the capture's first sample.
    #[serde(deserialize_with = "numbers")]
    pub time_s: Vec<f64>,
    /// The length of a stretch, s.
    #[serde(deserialize_with = "numbers")]
    pub stretch_s: f64,
    /// The record's values.
    pub real: Stretches,
    /// The values of a simulation of the original model; none if the model cannot be run at the record's rate.
    pub before: Option<Stretches>,
    /// The values of a simulation of the corrected model.
    pub after: Option<Stretches>,
}

impl ChannelTimeline {
    /// Returns the timeline of a record's channel and its simulations, with times from `from_s` on; none for a record
    /// that is too short.
    pub(super) fn new(
        real: &Recording,
        from_s: f64,
        (channel, values): (Channel, &[f64]),
        simulations: &[Option<Vec<f64>>; 2],
    ) -> Option<Self> {
        if real.len() < SHORTEST {
            return None;
        }
        let length = real.len().div_ceil(STRETCHES).max(LEAST);
        let middle = |stretch: usize| from_s + (stretch as f64 + 0.5) * length as f64 / real.rate_hz;
        let of = |values: &[f64]| stretches(values, real, length);
        let [before, after] = simulations.each_ref().map(|values| values.as_deref().map(of));
        Some(Self {
            channel: channel.name().into(),
            unit: channel.unit().into(),
            time_s: (0..real.len() / length).map(middle).collect(),
            stretch_s: length as f64 / real.rate_hz,
            real: of(values),
            before,
            after,
        })
    }
}

/// Returns the means and deviations of stretches of `length` samples, over the samples that the record has.
fn stretches(values: &[f64], real: &Recording, length: usize) -> Stretches {
    let moments = |index: usize| {
        let there = (index * length..(index + 1) * length).filter(|place| !real.is_missing(*place));
        let there: Vec<f64> =
            there.filter_map(|place| values.get(place)).copied().filter(|of| of.is_finite()).collect();
        let count = there.len() as f64;
        let mean = there.iter().sum::<f64>() / count;
        let variance = there.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
        (2 * there.len() > length).then(|| (mean, variance.sqrt()))
    };
    let moments: Vec<Option<(f64, f64)>> = (0..real.len() / length).map(moments).collect();
    let known: Vec<f64> = moments.iter().flatten().map(|(mean, _)| *mean).collect();
    let whole = known.iter().sum::<f64>() / known.len().max(1) as f64;
    Stretches {
        level: moments.iter().map(|of| of.map(|(mean, _)| short(mean - whole))).collect(),
        spread: moments.iter().map(|of| of.map(|(_, spread)| short(spread))).collect(),
    }
}

/// Rounds to as many digits as a picture shows.
fn short(value: f64) -> f64 {
    format!("{value:.4e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::super::simulated;
    use super::*;
    use imu_model::simulator::{SensorModel, Simulator};
    use serde_json::json;

    const RATE_HZ: f64 = 40.0;

    fn model(effects: &serde_json::Value) -> SensorModel {
        let model = json!({"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": RATE_HZ,
            "channels": {"gyro_x": {"N": 1e-3, "effects": effects}, "gyro_y": {"N": 1e-3}}});
        SensorModel::from_json(&model.to_string(), "test").unwrap()
    }

    fn record(model: &SensorModel, samples: usize) -> Recording {
        let mut simulator = Simulator::new(model, 9, RATE_HZ, samples as f64 / RATE_HZ).unwrap();
        let mut values = Vec::new();
        while values.len() < samples {
            values.push(simulator.next_sample().unwrap().values[Channel::GyroX as usize] + 5.0);
        }
        Recording { rate_hz: RATE_HZ, channels: vec![(Channel::GyroX, values)], ..Recording::default() }
    }

    #[test]
    fn a_step_and_a_knock_are_in_the_record_and_in_the_corrected_model_alone() {
        let effects = json!([{"effect": "bias_step", "at_s": 300.0, "size": 0.01},
            {"effect": "bursts", "intervals": [[100.0, 110.0]], "sigma": 0.05}]);
        let (sim, augmented) = (model(&json!([])), model(&effects));
        let mut real = record(&augmented, 24_000);
        real.missing = vec![false; real.len()];
        real.missing[..90].fill(true);
        let simulations = [&sim, &augmented].map(|model| simulated(&real, model, Channel::GyroX));
        let of = ChannelTimeline::new(&real, 1000.0, (Channel::GyroX, &real.channels[0].1), &simulations).unwrap();
        assert_eq!((of.time_s.len(), of.stretch_s, of.time_s[0]), (240, 2.5, 1001.25));
        // Ninety of the first stretch's hundred samples are missing.
        assert!(of.real.level[0].is_none() && of.real.spread[0].is_none() && of.real.level[1].is_some());
        let (before, after) = (of.before.as_ref().unwrap(), of.after.as_ref().unwrap());
        let step = |of: &Stretches| of.level[200].unwrap() - of.level[60].unwrap();
        let knock = |of: &Stretches| of.spread[41].unwrap() / of.spread[60].unwrap();
        // Means of 100 samples scatter by N/√2.5 s = 6.3e-4.
        for own in [&of.real, after] {
            assert!((step(own) - 0.01).abs() < 4e-3 && knock(own) > 5.0, "{} {}", step(own), knock(own));
        }
        assert!(step(before).abs() < 4e-3 && (knock(before) - 1.0).abs() < 0.5, "{} {}", step(before), knock(before));
    }

    #[test]
    fn a_record_that_is_too_short_has_none() {
        let real = record(&model(&json!([])), 60);
        assert_eq!(ChannelTimeline::new(&real, 0.0, (Channel::GyroX, &real.channels[0].1), &[None, None]), None);
    }
}
