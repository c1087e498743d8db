//! JSON for `loadparams` of MATLAB's `imuSensor`.
//!
//! # Source
//! MathWorks documentation of `loadparams`, `accelparams`, `gyroparams`, `magparams`: one object per part, in it one object
//! per sensor with the names of the parameter objects; NoiseDensity in U/√Hz, BiasInstability in U, RandomWalk in U/√s (there
//! written U √Hz), magnetic field in µT. With `NoiseType` `single-sided` a sample's white noise is NoiseDensity √rate, which
//! is our N; with `double-sided` it is smaller by √2.

use super::{Axis, ImuNoise, Known};
use crate::units::MICROTESLA_PER_GAUSS;
use serde_json::{Map, Value, json};

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut part = Map::new();
    part.insert("Accelerometer".into(), sensor(&noise.accel, 1.0));
    part.insert("Gyroscope".into(), sensor(&noise.gyro, 1.0));
    if noise.has_mag() {
        part.insert("Magnetometer".into(), sensor(&noise.mag, MICROTESLA_PER_GAUSS));
    }
    let note = format!(
        "{}. Part name: VN100. 0 where a parameter was not identified. Units m/s^2, rad/s, uT. \
         Set SampleRate to {}. A Gauss-Markov process cannot be expressed.",
        noise.origin, noise.rate_hz
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
    json!({
        "NoiseDensity": measured(|axis| axis.n),
        "BiasInstability": measured(|axis| axis.b),
        "RandomWalk": measured(|axis| axis.k),
        "NoiseType": "single-sided",
    })
}
