//! Noise: the law that weighs a triad's response, from a model as far as the model is known.

use crate::response::{Filters, NORMAL_95, NoiseLaw, ResponseError};
use imu_core::sample::Triad;
use imu_model::effects::{At, Effect, EffectKind, Record, Stage, USUAL_TEMPERATURE_C};
use imu_model::simulator::SensorModel;
use std::sync::Arc;

/// Number of blocks of time for held-out scores, and number of folds to which they are assigned in turn.
pub(super) const BLOCKS: usize = 64;
/// Prior uncertainty of N, B and K if a model states no interval: standard deviations of ln of their squares.
const PRIOR_SDS: [f64; 3] = [0.1, 0.6, 0.8];
/// Standard error of a cutoff's logarithm if a model states no interval.
const UNSTATED: f64 = 0.1;
/// The upper bound of a cutoff that acts at the rate of decimated samples, in parts of that rate.
const BELOW: f64 = 0.49;
/// Euler's constant.
const EULER_GAMMA: f64 = 0.577_215_664_901_532_9;

/// Returns the law of a model for records of `samples`. For a channel without white noise, the law assumes `scale`, U
/// per sample.
pub(super) fn law(
    model: &SensorModel,
    triad: Triad,
    rate_hz: f64,
    samples: usize,
    scale: [f64; 3],
) -> Result<NoiseLaw, ResponseError> {
    let is_loud = |kind: EffectKind| matches!(kind, EffectKind::Bursts | EffectKind::Spikes);
    let mut plain = model.clone();
    for (axis, channel) in triad.channels().into_iter().enumerate() {
        let Some(of) = plain.channels.get_mut(&channel) else { continue };
        // Noise that comes and goes is modelled as white noise of its mean square. That is too much in its quiet parts,
        // which reduces the power of tests but names no effect falsely.
        let record = Record { rate_hz, samples: samples as u64 };
        for effect in of.effects.iter().filter(|effect| !effect.spec().is_lasting()) {
            let factor = effect.white_moments(record).map_or(1.0, |of| of.variance);
            let added = effect.moments(record).filter(|_| is_loud(effect.kind())).map_or(0.0, |of| of.variance);
            let square = factor.max(1.0) * of.n * of.n + added / rate_hz;
            if square.is_finite() {
                of.n = square.sqrt();
            }
        }
        // Drifts have been subtracted before.
        of.effects.retain(|effect| effect.spec().is_lasting());
        of.uncertainty = None;
        let least = 1e-3 * scale[axis] / rate_hz.sqrt();
        if of.n < least {
            of.n = scale[axis] / rate_hz.sqrt();
        }
    }
    NoiseLaw::of_model(&plain, triad, rate_hz, samples)
}

/// Returns the filters that a motion passes on each axis. Of the low passes, only the cutoff with the largest
/// uncertainty is free, within its interval.
pub(super) fn filters(model: &SensorModel, triad: Triad) -> Filters {
    // Before decimation, filters act at another rate: a cutoff in Hz is the same at the output rate, a window is not.
    let decimated = model.sampling.is_some();
    let mut all = Filters::default();
    for (axis, channel) in triad.channels().into_iter().enumerate() {
        let Some(of) = model.channels.get(&channel) else { continue };
        for (index, effect) in of.effects.iter().enumerate().filter(|(_, effect)| effect.stage() == Stage::Bandwidth) {
            let cutoff_hz = effect.number("cutoff_hz");
            if decimated && cutoff_hz.is_none_or(|cutoff_hz| cutoff_hz > BELOW * model.rate_hz) {
                continue;
            }
            if cutoff_hz.is_some() {
                let stated =
                    of.effect_interval(index, "cutoff_hz").map(|[low, high]| (high / low).ln() / (2.0 * NORMAL_95));
                let error = stated.filter(|error| error.is_finite() && *error > 0.0).unwrap_or(UNSTATED);
                if all.open[axis].is_none_or(|(_, other)| error > other) {
                    all.open[axis] = Some((all.of[axis].len(), error));
                }
            }
            all.of[axis].push(effect.noiseless().unwrap_or_else(|| Arc::clone(effect)));
        }
    }
    all
}

/// Returns the course of the level that a model states besides the motion on each axis, U.
pub(super) fn courses(
    model: &SensorModel,
    triad: Triad,
    rate_hz: f64,
    samples: usize,
    temperature_c: Option<&[f64]>,
) -> [Option<Vec<f64>>; 3] {
    triad.channels().map(|channel| {
        let effects = model.channels.get(&channel).map(|of| of.effects.as_slice()).unwrap_or_default();
        let shifts: Vec<&Arc<dyn Effect>> = effects.iter().filter(|effect| effect.stage() == Stage::Bias).collect();
        (!shifts.is_empty()).then(|| {
            let at = |index: usize| {
                let temperature_c = temperature_c.map_or(USUAL_TEMPERATURE_C, |values| values[index]);
                let at = At { time_s: index as f64 / rate_hz, temperature_c };
                shifts.iter().map(|effect| effect.mean_response(0.0, at)).sum()
            };
            (0..samples).map(at).collect()
        })
    })
}

/// Degrees of freedom of the variance of a record's mean: that of a sum of white noise, flicker and a walk with levels
/// of limited accuracy, each with its share (Satterthwaite 1946, Biometrics Bull. 2). This is the smallest value of the
/// three axes.
pub(super) fn mean_freedom(model: &SensorModel, triad: Triad, rate_hz: f64, samples: usize) -> f64 {
    let n = samples as f64;
    let of = |channel| {
        let of = model.channels.get(&channel)?;
        // As in the law of the mean's coefficient.
        let parts = [
            rate_hz * of.n * of.n,
            n * of.b * of.b / std::f64::consts::PI * (2.5 - EULER_GAMMA - (2.0 * std::f64::consts::PI / 32.0).ln()),
            of.k * of.k / rate_hz * n * n / 3.0,
        ];
        let total: f64 = parts.iter().sum();
        let names = ["N", "B", "K"];
        let spread = |place: usize| {
            let interval = of.interval(names[place]).filter(|[low, high]| *low > 0.0 && high > low);
            interval.map_or(PRIOR_SDS[place], |[low, high]| (high / low).ln() / 1.96)
        };
        let variance: f64 = (0..3).map(|place| (parts[place] / total * spread(place)).powi(2)).sum();
        Some(2.0 / variance).filter(|value| value.is_finite())
    };
    triad.channels().into_iter().filter_map(of).fold(1e6, f64::min).max(4.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::Filters;
    use serde_json::{Value, json};

    fn of(effects: Value, uncertainty: Value, sampling: Value) -> Filters {
        let mut channel = json!({"N": 1e-4, "effects": effects});
        if !uncertainty.is_null() {
            channel["uncertainty"] = json!({ "effects": uncertainty });
        }
        let mut value = json!({"format": "vn100d-sensor-model-1", "name": "test", "rate_hz": 40,
            "channels": {"gyro_x": channel, "gyro_y": {"N": 1e-4}, "gyro_z": {"N": 1e-4}}});
        if !sampling.is_null() {
            value["sampling"] = sampling;
        }
        filters(&SensorModel::from_value(&value, "test").unwrap(), Triad::Gyro)
    }

    #[test]
    fn the_cutoff_that_is_known_worst_is_open_as_far_as_its_interval_reaches() {
        let two = json!([{"effect": "low_pass", "cutoff_hz": 15.0}, {"effect": "low_pass", "cutoff_hz": 5.0}]);
        let uncertainty = json!([{"cutoff_hz": {"ci95": [14.9, 15.1]}}, {"cutoff_hz": {"ci95": [4.5, 5.5]}}]);
        let found = of(two.clone(), uncertainty, Value::Null);
        let (place, error) = found.open[0].unwrap();
        assert!(place == 1 && (error - (5.5f64 / 4.5).ln() / 3.92).abs() < 1e-4, "{error}");
        assert_eq!((found.of[0].len(), found.open[1]), (2, None));
        // If the model states no interval, the level is poorly known.
        assert_eq!(of(two, Value::Null, Value::Null).open[0], Some((0, UNSTATED)));
    }

    #[test]
    fn before_samples_are_decimated_only_a_cutoff_below_their_band_acts() {
        let sampling = json!({"internal_rate_hz": 800, "filter_window": 4});
        let all = json!([{"effect": "low_pass", "cutoff_hz": 70.0}, {"effect": "moving_average", "window": 3},
            {"effect": "low_pass", "cutoff_hz": 8.0}]);
        let found = of(all, Value::Null, sampling);
        assert_eq!((found.of[0].len(), found.open[0]), (1, Some((0, UNSTATED))));
    }
}
