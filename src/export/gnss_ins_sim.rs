//! The `imu_err` dictionary of gnss-ins-sim.
//!
//! # Source
//! Aceinna/gnss-ins-sim, README, step 1.1: `gyro_b` (constant biases; `accel_b` in m/s²) and `gyro_b_stability` in deg/hr, `gyro_arw` in deg/rt-hr,
//! `accel_vrw` in m/s/rt-hr, `accel_b_stability` in m/s², correlation times in s, `mag_std` in µT. A correlation time of
//! `inf` is called a random walk there, but draws independent values: it is not used here.

use super::{Axis, ImuNoise, Known, Part};
use crate::units::{MICROTESLA_PER_GAUSS, RAD_PER_DEG, SECONDS_PER_HOUR, SQRT_SECONDS_PER_SQRT_HOUR as SQRT_HOUR};
use std::fmt::Write as _;

pub(super) fn write(noise: &ImuNoise) -> String {
    const DEG: f64 = 1.0 / RAD_PER_DEG;
    // Long enough to walk over the whole record.
    let walk_s = (10.0 * noise.duration_s).max(1.0);
    let mut text = super::comment("# ", &noise.origin_for(&[Part::Bias]));
    let _ = write!(
        text,
        "# Biases are first-order Gauss-Markov processes here: K stands as one of {walk_s:?} s with sigma K*sqrt(Tc/2), which walks\n\
         # over a record of {} s. Not expressible: bias instability B, K beside a Gauss-Markov process. 0.0 stands for what\n\
         # is not known and for a bias that was not identified. mag_std is that of one sample at {} Hz.\n\
         import numpy as np\n\nimu_err = {{\n",
        noise.duration_s, noise.rate_hz
    );
    let mut row = |key: &str, unit: &str, values: [f64; 3]| {
        let [x, y, z] = values;
        let _ = writeln!(text, "    '{key}': np.array([{x:.6e}, {y:.6e}, {z:.6e}]),  # {unit}");
    };
    let with_limits = |unit: &str, axes: &[Axis; 3]| format!("{unit}{}", super::limits(axes, |axis| axis.n));
    let white = |axes: &[Axis; 3], factor: f64| axes.map(|axis| axis.n.bound().unwrap_or(0.0) * factor);
    let drift = |axis: &Axis| match (axis.gauss_markov, axis.k) {
        (Some(process), _) => process,
        (None, Known::Value(k)) => (k * (walk_s / 2.0).sqrt(), walk_s),
        _ => (0.0, walk_s),
    };
    let bias = |axes: &[Axis; 3], factor: f64| axes.map(|axis| axis.fixed.bias.unwrap_or(0.0) * factor);
    if let Some(gyro) = &noise.gyro {
        row("gyro_b", "deg/hr", bias(gyro, DEG * SECONDS_PER_HOUR));
        row("gyro_arw", &with_limits("deg/rt-hr", gyro), white(gyro, DEG * SQRT_HOUR));
        row("gyro_b_stability", "deg/hr", gyro.map(|axis| drift(&axis).0 * DEG * SECONDS_PER_HOUR));
        row("gyro_b_corr", "s", gyro.map(|axis| drift(&axis).1));
    }
    if let Some(accel) = &noise.accel {
        row("accel_b", "m/s^2", bias(accel, 1.0));
        row("accel_vrw", &with_limits("m/s/rt-hr", accel), white(accel, SQRT_HOUR));
        row("accel_b_stability", "m/s^2", accel.map(|axis| drift(&axis).0));
        row("accel_b_corr", "s", accel.map(|axis| drift(&axis).1));
    }
    if let Some(mag) = &noise.mag {
        let factor = MICROTESLA_PER_GAUSS * noise.rate_hz.sqrt();
        row("mag_std", &with_limits("uT", mag), white(mag, factor));
    }
    text.push_str("}\n");
    text
}
