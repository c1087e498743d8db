//! JSON for `loadparams` of MATLAB's `imuSensor`.
//!
//! # Source
//! MathWorks documentation of `loadparams`, `accelparams`, `gyroparams`, `magparams`: one object per part, in it one object
//! per sensor with the names of the parameter objects; NoiseDensity in U/√Hz, BiasInstability in U, RandomWalk in U/√s (there
//! written U √Hz), magnetic field in µT. With `NoiseType` `single-sided` a sample's white noise is NoiseDensity √rate, which
//! is our N; with `double-sided` it is smaller by √2. ConstantBias in U, Resolution in U per step and MeasurementRange in U, one
//! for all axes; TemperatureBias in U/°C, from 25 °C on; a gyroscope's AccelerationBias in (rad/s)/(m/s²), each axis by its own.
//! Scale factors and misalignment are left out: AxesMisalignment takes 0 to 100 %, and neither sign.

use super::form::{Entry, Form, Noise};
use super::{Axis, Fixed, ImuNoise, Known, Part};
use imu_core::sample::Triad;
use imu_core::units::MICROTESLA_PER_GAUSS;
use serde_json::{Map, Value, json};

/// The parts of an `imuSensor`: triad, name, unit, and the factor to it.
const PARTS: [(Triad, &str, &str, f64); 3] = [
    (Triad::Accel, "Accelerometer", "m/s^2", 1.0),
    (Triad::Gyro, "Gyroscope", "rad/s", 1.0),
    (Triad::Mag, "Magnetometer", "uT", MICROTESLA_PER_GAUSS),
];
/// The temperature from which `imuSensor` counts, °C.
const REFERENCE_C: f64 = 25.0;

/// Returns densities of the measured quantities, for each axis.
pub(super) fn form(noise: &ImuNoise) -> Form {
    let mut entries = Vec::new();
    for ((triad, _, unit, factor), axes) in PARTS.into_iter().zip([&noise.accel, &noise.gyro, &noise.mag]) {
        let Some(axes) = axes else { continue };
        for (key, noise, root) in [("NoiseDensity", Noise::White, "Hz"), ("RandomWalk", Noise::Walk, "s")] {
            let axes = axes.map(|axis| noise.of(&axis).measured().scaled(factor));
            entries.push(Entry { key, triad, noise, unit: format!("{unit}/sqrt({root})"), axes });
        }
    }
    let takes = "densities: N, K; each axis".to_owned();
    Form { takes, source: "MathWorks, loadparams, accelparams, gyroparams, magparams", each_axis: true, entries }
}

pub(super) fn write(noise: &ImuNoise) -> String {
    let (mut part, entries) = (Map::new(), form(noise).entries);
    for ((triad, name, _, factor), axes) in PARTS.into_iter().zip([&noise.accel, &noise.gyro, &noise.mag]) {
        if let Some(axes) = axes {
            let own: Vec<&Entry> = entries.iter().filter(|entry| entry.triad == triad).collect();
            part.insert(name.into(), sensor(axes, &own, factor));
        }
    }
    let note = format!(
        "{}. Part name: IMU. 0 where a parameter was not identified. Units m/s^2, rad/s, uT. \
         Set SampleRate to {}. A Gauss-Markov process cannot be expressed. Resolution and MeasurementRange are one number \
         for three axes: the smallest of them.",
        noise.origin_for(&[Part::Bias, Part::Resolution, Part::Temperature, Part::Range, Part::Acceleration]),
        noise.rate_hz
    );
    let document = json!({ "IMU": part, "Comment": note });
    // An object of strings and numbers can be written.
    serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
}

fn sensor(axes: &[Axis; 3], entries: &[&Entry], factor: f64) -> Value {
    let numbers = |axes: [Known; 3]| axes.map(|known| known.measured().bound().unwrap_or(0.0));
    let mut sensor = json!({
        "BiasInstability": numbers(axes.map(|axis| axis.b.scaled(factor))),
        "NoiseType": "single-sided",
    });
    for entry in entries {
        sensor[entry.key] = json!(numbers(entry.axes));
    }
    let each = |of: fn(&Fixed) -> Option<f64>| {
        let there = axes.iter().any(|axis| of(&axis.fixed).is_some());
        there.then(|| json!(axes.map(|axis| of(&axis.fixed).unwrap_or(0.0) * factor)))
    };
    let smallest = |of: fn(&Fixed) -> Option<f64>| {
        let least = axes.iter().filter_map(|axis| of(&axis.fixed)).reduce(f64::min);
        least.map(|least| json!(least * factor))
    };
    // If the reference temperature is not 25 °C, there is a bias at 25 °C.
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
