//! JSON for `loadparams` of MATLAB's `imuSensor`.
//!
//! # Source
//! MathWorks documentation of `loadparams`, `accelparams`, `gyroparams`, `magparams`: one object per part, in it one object
//! per sensor with the names of the parameter objects; NoiseDensity in U/√Hz, BiasInstability in U, RandomWalk in U/√s (there
//! written U √Hz), magnetic field in µT. With `NoiseType` `single-sided` a sample's white noise is NoiseDensity √rate, which
//! is our N; with `double-sided` it is smaller by √2. ConstantBias in U, Resolution in U per step and MeasurementRange in U, one
//! for all axes; TemperatureBias in U/°C, from 25 °C on; a gyroscope's AccelerationBias in (rad/s)/(m/s²), each axis by its own.
//! Scale factors and misalignment are left out: AxesMisalignment takes 0 to 100 %, and neither sign.

use super::{Axis, Fixed, ImuNoise, Known, Part};
use crate::units::MICROTESLA_PER_GAUSS;
use serde_json::{Map, Value, json};

/// The temperature from which `imuSensor` counts, °C.
const REFERENCE_C: f64 = 25.0;

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut part = Map::new();
    for (name, axes, factor) in [
        ("Accelerometer", &noise.accel, 1.0),
        ("Gyroscope", &noise.gyro, 1.0),
        ("Magnetometer", &noise.mag, MICROTESLA_PER_GAUSS),
    ] {
        if let Some(axes) = axes {
            part.insert(name.into(), sensor(axes, factor));
        }
    }
    let note = format!(
        "{}. Part name: VN100. 0 where a parameter was not identified. Units m/s^2, rad/s, uT. \
         Set SampleRate to {}. A Gauss-Markov process cannot be expressed. Resolution and MeasurementRange are one number \
         for three axes: the smallest of them.",
        noise.origin_for(&[Part::Bias, Part::Resolution, Part::Temperature, Part::Range, Part::Acceleration]),
        noise.rate_hz
    );
    let document = json!({ "VN100": part, "Comment": note });
    // An object of strings and numbers can be written.
    serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
}

fn sensor(axes: &[Axis; 3], factor: f64) -> Value {
    let measured = |of: fn(&Axis) -> Known| {
        axes.map(|axis| match of(&axis) {
            Known::Value(value) => value * factor,
            Known::Below(_) | Known::Nothing => 0.0,
        })
    };
    let mut sensor = json!({
        "NoiseDensity": measured(|axis| axis.n),
        "BiasInstability": measured(|axis| axis.b),
        "RandomWalk": measured(|axis| axis.k),
        "NoiseType": "single-sided",
    });
    let each = |of: fn(&Fixed) -> Option<f64>| {
        let there = axes.iter().any(|axis| of(&axis.fixed).is_some());
        there.then(|| json!(axes.map(|axis| of(&axis.fixed).unwrap_or(0.0) * factor)))
    };
    let smallest = |of: fn(&Fixed) -> Option<f64>| {
        let least = axes.iter().filter_map(|axis| of(&axis.fixed)).reduce(f64::min);
        least.map(|least| json!(least * factor))
    };
    // What another temperature than 25 °C is the reference of is a bias at 25 °C.
    let at_25_c = |fixed: &Fixed| {
        let shift = fixed.temperature.map(|(per_c, reference_c)| per_c * (REFERENCE_C - reference_c));
        let parts = fixed.bias.into_iter().chain(shift.filter(|shift| *shift != 0.0));
        parts.reduce(|bias, shift| bias + shift)
    };
    for (key, value) in [
        ("ConstantBias", each(at_25_c)),
        ("Resolution", smallest(|fixed| fixed.resolution)),
        ("MeasurementRange", smallest(|fixed| fixed.range)),
        ("TemperatureBias", each(|fixed| fixed.temperature.map(|(per_c, _)| per_c))),
        ("AccelerationBias", each(|fixed| fixed.acceleration)),
    ] {
        if let Some(value) = value {
            sensor[key] = value;
        }
    }
    sensor
}
