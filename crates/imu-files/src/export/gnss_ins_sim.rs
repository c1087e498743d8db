//! The `imu_err` dictionary of gnss-ins-sim.
//!
//! # Source
//! Aceinna/gnss-ins-sim, README, step 1.1: `gyro_b` (constant biases; `accel_b` in m/s²) and `gyro_b_stability` in
//! deg/hr, `gyro_arw` in deg/rt-hr, `accel_vrw` in m/s/rt-hr, `accel_b_stability` in m/s², correlation times in s,
//! `mag_std` in µT. A correlation time of `inf` is called a random walk there, but draws independent values: it is not
//! used here.

use super::form::{Entry, Form, Noise};
use super::{Axis, ImuNoise, Known, Part};
use imu_core::sample::Triad;
use imu_core::units::{MICROTESLA_PER_GAUSS, RAD_PER_DEG, SECONDS_PER_HOUR, SQRT_SECONDS_PER_SQRT_HOUR as SQRT_HOUR};
use std::fmt::Write as _;

/// rad/s to deg/hr.
const DEG_HR: f64 = SECONDS_PER_HOUR / RAD_PER_DEG;

/// Returns densities per root hour, and Gauss-Markov biases, for each axis.
pub(super) fn form(noise: &ImuNoise) -> Form {
    let mut entries = Vec::new();
    let mut add = |triad, noise, key, unit: &str, axes: [Known; 3]| {
        entries.push(Entry { key, triad, noise, unit: unit.to_owned(), axes });
    };
    let white = |axes: &[Axis; 3], factor: f64| axes.map(|axis| axis.n.scaled(factor));
    let sigma = |axes: &[Axis; 3], factor: f64| axes.map(|axis| drift(&axis, noise).0.scaled(factor));
    if let Some(gyro) = &noise.gyro {
        add(Triad::Gyro, Noise::White, "gyro_arw", "deg/rt-hr", white(gyro, SQRT_HOUR / RAD_PER_DEG));
        add(Triad::Gyro, Noise::Walk, "gyro_b_stability", "deg/hr", sigma(gyro, DEG_HR));
    }
    if let Some(accel) = &noise.accel {
        add(Triad::Accel, Noise::White, "accel_vrw", "m/s/rt-hr", white(accel, SQRT_HOUR));
        add(Triad::Accel, Noise::Walk, "accel_b_stability", "m/s^2", sigma(accel, 1.0));
    }
    if let Some(mag) = &noise.mag {
        add(Triad::Mag, Noise::White, "mag_std", "uT", white(mag, MICROTESLA_PER_GAUSS * noise.rate_hz.sqrt()));
    }
    let takes = "N per √h; Gauss–Markov bias of K√(Tc/2); each axis".to_owned();
    Form { takes, source: "Aceinna/gnss-ins-sim, README, step 1.1", each_axis: true, entries }
}

/// Returns the standard deviation of the bias and its correlation time, s: long enough to walk over the whole record.
fn drift(axis: &Axis, noise: &ImuNoise) -> (Known, f64) {
    let walk_s = (10.0 * noise.duration_s).max(1.0);
    let walk = (axis.k.measured().scaled((walk_s / 2.0).sqrt()), walk_s);
    axis.gauss_markov.map_or(walk, |(sigma, tc_s)| (Known::Value(sigma), tc_s))
}

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[Part::Bias]));
    let note = format!(
        "Biases are first-order Gauss-Markov processes here: K stands as one of {:?} s with sigma K*sqrt(Tc/2), which walks over a \
         record of {} s. Not expressible: bias instability B, K beside a Gauss-Markov process. 0.0 stands for what is not known and for \
         a bias that was not identified. mag_std is the standard deviation {}.",
        drift(&Axis::UNKNOWN, noise).1,
        noise.duration_s,
        noise.of_one_sample(&[Triad::Mag])
    );
    text += &super::comment("# ", &note);
    text.push_str("import numpy as np\n\nimu_err = {\n");
    // Writing to a text cannot fail.
    let mut row = |key: &str, unit: &str, [x, y, z]: [f64; 3]| {
        let _ = writeln!(text, "    '{key}': np.array([{x:.6e}, {y:.6e}, {z:.6e}]),  # {unit}");
    };
    let bias = |axes: &[Axis; 3], factor: f64| axes.map(|axis| axis.fixed.bias.unwrap_or(0.0) * factor);
    for Entry { key, triad, noise: of, unit, axes } in form(noise).entries {
        let (own, sensor, bias_unit, factor) = match triad {
            Triad::Gyro => (&noise.gyro, "gyro", "deg/hr", DEG_HR),
            _ => (&noise.accel, "accel", "m/s^2", 1.0),
        };
        let own = own.as_ref().filter(|_| triad != Triad::Mag);
        if let (Noise::White, Some(own)) = (of, own) {
            row(&format!("{sensor}_b"), bias_unit, bias(own, factor));
        }
        let numbers = axes.map(|known| known.bound().unwrap_or(0.0));
        row(key, &format!("{unit}{}", super::limits(axes)), numbers);
        if let (Noise::Walk, Some(own)) = (of, own) {
            row(&format!("{sensor}_b_corr"), "s", own.map(|axis| drift(&axis, noise).1));
        }
    }
    text.push_str("}\n");
    text
}
