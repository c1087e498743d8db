//! Covariances for `sensor_msgs/Imu` and `sensor_msgs/MagneticField`.
//!
//! # Source
//! ROS REP 145 and the messages' own definitions: row-major 3×3 covariances of one sample, (rad/s)², (m/s²)², tesla².
//! −1 in the first element means that the quantity is not provided.

use super::{Axis, ImuNoise};
use crate::units::TESLA_PER_GAUSS;
use std::fmt::Write as _;

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    let _ = writeln!(
        text,
        "# Variances of one sample at {} Hz (N^2 x rate), SI. A covariance holds white noise only: bias instability B, rate\n\
         # random walk K and Gauss-Markov cannot be expressed here and belong into the filter's process noise.",
        noise.rate_hz
    );
    inertial(&mut text, noise);
    if let Some(mag) = &noise.mag {
        covariance(&mut text, "magnetic_field_covariance", "tesla^2", mag, noise.rate_hz * TESLA_PER_GAUSS.powi(2));
    }
    for (sensor, axes, unit) in [("accel", &noise.accel, "m/s^3"), ("gyro", &noise.gyro, "rad/s^2")] {
        if let Some(axes) = axes {
            let walks = super::each(axes, |axis| axis.k, 1.0);
            let _ = writeln!(text, "# process noise, K of x, y, z: {sensor} {walks} {unit}/sqrt(Hz)");
        }
    }
    text
}

/// The covariances of `sensor_msgs/Imu`, as far as the source has the triads.
pub(super) fn inertial(text: &mut String, noise: &ImuNoise) {
    if let Some(accel) = &noise.accel {
        covariance(text, "linear_acceleration_covariance", "(m/s^2)^2", accel, noise.rate_hz);
    }
    if let Some(gyro) = &noise.gyro {
        covariance(text, "angular_velocity_covariance", "(rad/s)^2", gyro, noise.rate_hz);
    }
}

fn covariance(text: &mut String, key: &str, unit: &str, axes: &[Axis; 3], factor: f64) {
    let variances: Option<Vec<f64>> = axes.iter().map(|axis| Some(axis.n.bound()?.powi(2) * factor)).collect();
    let _ = match variances.as_deref() {
        Some([x, y, z]) => {
            let limits = super::limits(axes, |axis| axis.n);
            writeln!(text, "{key}: [{x:.6e}, 0.0, 0.0, 0.0, {y:.6e}, 0.0, 0.0, 0.0, {z:.6e}]  # {unit}{limits}")
        }
        _ => writeln!(text, "{key}: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]  # not known for all axes"),
    };
}
