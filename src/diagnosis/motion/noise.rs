//! Noise: the law that a triad's answer is weighed by, of a model as far as it is known.

use crate::diagnosis::report::Diagnosis;
use crate::diagnosis::response::{Filters, NORMAL_95, NoiseLaw, ResponseError};
use crate::effects::{At, Effect, Record, Stage, USUAL_TEMPERATURE_C};
use crate::sample::Triad;
use crate::simulator::SensorModel;
use serde_json::Value;
use std::sync::Arc;

/// Effects that have a density throughout a record; drifts are taken off before.
const LASTING: [&str; 7] =
    ["quantization_noise", "gauss_markov", "resonance", "low_pass", "moving_average", "resolution", "common_mode"];
/// Effects that add noise at times.
const LOUD: [&str; 2] = ["bursts", "spikes"];
/// How well N, B and K are believed to be known where a model says no interval: standard deviations of ln of their squares.
const BELIEFS: [f64; 3] = [0.1, 0.6, 0.8];
/// Euler's constant.
const EULER_GAMMA: f64 = 0.577_215_664_901_532_9;

/// The law of a model for records of `samples`; where a channel has no white noise of its own it is `scale`, U per sample.
pub(super) fn law(
    model: &SensorModel,
    triad: Triad,
    rate_hz: f64,
    samples: usize,
    scale: [f64; 3],
) -> Result<NoiseLaw, ResponseError> {
    let mut plain = model.clone();
    for (axis, channel) in triad.channels().into_iter().enumerate() {
        let Some(of) = plain.channels.get_mut(&channel) else { continue };
        // What comes and goes is white noise of its mean square: too much in its quiet, which costs power and blames nobody.
        let record = Record { rate_hz, samples: samples as u64 };
        for effect in of.effects.iter().filter(|effect| !LASTING.contains(&effect.name())) {
            let factor = effect.white_moments(record).map_or(1.0, |of| of.variance);
            let added = effect.moments(record).filter(|_| LOUD.contains(&effect.name())).map_or(0.0, |of| of.variance);
            let square = factor.max(1.0) * of.n * of.n + added / rate_hz;
            if square.is_finite() {
                of.n = square.sqrt();
            }
        }
        of.effects.retain(|effect| LASTING.contains(&effect.name()));
        of.uncertainty = None;
        let least = 1e-3 * scale[axis] / rate_hz.sqrt();
        if of.n < least {
            of.n = scale[axis] / rate_hz.sqrt();
        }
    }
    NoiseLaw::of_model(&plain, triad, rate_hz, samples)
}

/// The filters of each axis that a motion passes, with the cutoffs that were found in a noise open as far as it left them.
pub(super) fn filters(model: &SensorModel, found: Option<&Diagnosis>, triad: Triad) -> Filters {
    // Before samples are decimated filters act at another rate: a cutoff in Hz is the same at this one, a window is not.
    let decimated = model.sampling.is_some();
    let of = triad.channels().map(|channel| {
        let effects = model.channels.get(&channel).map(|of| of.effects.as_slice()).unwrap_or_default();
        let filters = effects.iter().filter(|effect| effect.stage() == Stage::Bandwidth);
        filters.filter(|effect| !decimated || effect.name() == "low_pass").cloned().collect()
    });
    let open = triad.channels().map(|channel| {
        let causes = found.into_iter().flat_map(|found| &found.causes).filter(|cause| cause.effect == "low_pass");
        let told = causes.filter_map(|cause| ends_of(cause.uncertainty.get(channel.name())?, "cutoff_hz")).next();
        told.map(|[low, high]| (high / low).ln() / (2.0 * NORMAL_95)).filter(|error| error.is_finite() && *error > 0.0)
    });
    Filters { of, open }
}

/// The first interval of that name among the intervals of one or several effects.
fn ends_of(of: &Value, name: &str) -> Option<[f64; 2]> {
    match of {
        Value::Array(list) => list.iter().find_map(|one| ends_of(one, name)),
        Value::Object(map) => {
            let ends = map.get(name)?.as_array()?;
            Some([ends.first()?.as_f64()?, ends.get(1)?.as_f64()?])
        }
        _ => None,
    }
}

/// What a model says of the level's course on each axis beside its motion, U.
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

/// Degrees of freedom that the variance of a record's mean is known with: of a sum of white noise, flicker and a walk whose
/// levels are known to some accuracy, each with its share (Satterthwaite 1946, Biometrics Bull. 2). The least of the three axes.
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
            let told = of.interval(names[place]).filter(|[low, high]| *low > 0.0 && high > low);
            told.map_or(BELIEFS[place], |[low, high]| (high / low).ln() / 1.96)
        };
        let variance: f64 = (0..3).map(|place| (parts[place] / total * spread(place)).powi(2)).sum();
        Some(2.0 / variance).filter(|value| value.is_finite())
    };
    triad.channels().into_iter().filter_map(of).fold(1e6, f64::min).max(4.0)
}
