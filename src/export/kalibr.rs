//! Kalibr's `imu.yaml`.
//!
//! # Source
//! ethz-asl/kalibr, wiki "IMU Noise Model": continuous-time densities of white noise (m/s²/√Hz, rad/s/√Hz) and of the
//! random walk of the bias (m/s³/√Hz, rad/s²/√Hz, which is our K in U/√s), one number for all three axes, discretised by
//! the reader as σ/√Δt.

use super::{Axis, ImuNoise, Known, each, worst};
use std::fmt::Write as _;

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    text.push_str(
        "# Continuous-time, SI. One number per sensor: the largest axis; each axis in the comment (x, y, z).\n\
         # `<`: not identified in this record, 95 % upper limit; where it is the largest it stands as the number, which is\n\
         # conservative. Not expressible here: bias instability B, Gauss-Markov, one value per axis.\n",
    );
    for (sensor, axes, unit) in [("accelerometer", &noise.accel, "m/s"), ("gyroscope", &noise.gyro, "rad/s")] {
        let Some(axes) = axes else { continue };
        let (white, walk) = if sensor == "accelerometer" { ("m/s^2", "m/s^3") } else { (unit, "rad/s^2") };
        line(&mut text, &format!("{sensor}_noise_density"), axes, |axis| axis.n, &format!("{white}/sqrt(Hz)"));
        line(&mut text, &format!("{sensor}_random_walk"), axes, |axis| axis.k, &format!("{walk}/sqrt(Hz)"));
        let _ = writeln!(
            text,
            "# {sensor} bias instability B (IEEE 952 coefficient), {white}: {}",
            each(axes, |axis| axis.b, 1.0)
        );
        let _ = writeln!(
            text,
            "# {sensor} discrete white sigma at {} Hz, {white}: {}",
            noise.rate_hz,
            each(axes, |axis| axis.n, noise.rate_hz.sqrt())
        );
    }
    let _ = writeln!(text, "update_rate: {:?}  # Hz", noise.rate_hz);
    text.push_str("rostopic: /imu/data  # set to your topic\n");
    text
}

fn line(text: &mut String, key: &str, axes: &[Axis; 3], of: impl Fn(&Axis) -> Known + Copy, unit: &str) {
    let comment = format!("# {unit}; {}", each(axes, of, 1.0));
    let _ = match worst(axes, of) {
        Some(value) => writeln!(text, "{key}: {value:.6e}  {comment}"),
        None => writeln!(text, "# {key}: unknown, take it from a longer record  {comment}"),
    };
}
