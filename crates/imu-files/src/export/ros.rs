//! Covariances for `sensor_msgs/Imu` and `sensor_msgs/MagneticField`.
//!
//! # Source
//! ROS REP 145 and the messages' own definitions: row-major 3×3 covariances of one sample, (rad/s)², (m/s²)², tesla².
//! −1 in the first element means that the quantity is not provided.

use super::form::{Entry, Form, Noise};
use super::{Axis, ImuNoise, Known};
use imu_core::sample::Triad;
use imu_core::units::TESLA_PER_GAUSS;
use std::fmt::Write as _;

/// Returns variances at the sensor's rate, for each axis.
pub(super) fn form(noise: &ImuNoise) -> Form {
    let mut form = inertial(noise, "ROS REP 145; sensor_msgs/Imu, sensor_msgs/MagneticField");
    if let Some(mag) = &noise.mag {
        let factor = noise.rate_hz * TESLA_PER_GAUSS.powi(2);
        form.entries.push(covariance(Triad::Mag, "magnetic_field_covariance", "tesla^2", mag, factor));
    }
    form
}

/// Returns the covariances of `sensor_msgs/Imu`.
pub(super) fn inertial(noise: &ImuNoise, source: &'static str) -> Form {
    let of = |triad, key, unit, axes: &Option<[Axis; 3]>| {
        axes.as_ref().map(|axes| covariance(triad, key, unit, axes, noise.rate_hz))
    };
    let accel = of(Triad::Accel, "linear_acceleration_covariance", "(m/s^2)^2", &noise.accel);
    let gyro = of(Triad::Gyro, "angular_velocity_covariance", "(rad/s)^2", &noise.gyro);
    Form {
        takes: format!("variances at {} Hz: N² rate; each axis", super::short(noise.rate_hz)),
        source,
        each_axis: true,
        entries: accel.into_iter().chain(gyro).collect(),
    }
}

/// Returns the covariance of all three axes, or none.
fn covariance(triad: Triad, key: &'static str, unit: &str, axes: &[Axis; 3], factor: f64) -> Entry {
    let axes = axes.map(|axis| axis.n.map(|n| n * n * factor));
    let axes = if axes.contains(&Known::Nothing) { [Known::Nothing; 3] } else { axes };
    Entry { key, triad, noise: Noise::White, unit: unit.to_owned(), axes }
}

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    let others = if noise.enlarged.is_some() {
        "For rates and accelerations, B, K and other effects are in these numbers, for a filter that estimates no bias. Add no \
         process noise for them."
    } else {
        "A covariance holds white noise only: bias instability B, rate random walk K and Gauss-Markov cannot be expressed here \
         and belong into the filter's process noise."
    };
    let note =
        format!("Variances {}, N^2 rate, SI. {others}", noise.of_one_sample(&[Triad::Accel, Triad::Gyro, Triad::Mag]));
    text += &super::comment("# ", &note);
    if let Some(why) = &noise.enlarged {
        text += &super::comment("# ", why);
    }
    matrices(&mut text, form(noise));
    if noise.enlarged.is_some() {
        return text;
    }
    for (sensor, axes, unit) in [("accel", &noise.accel, "m/s^3"), ("gyro", &noise.gyro, "rad/s^2")] {
        if let Some(axes) = axes {
            let walks = super::each(axes.map(|axis| axis.k));
            let _ = writeln!(text, "# process noise, K of x, y, z: {sensor} {walks} {unit}/sqrt(Hz)");
        }
    }
    text
}

/// Writes the covariances, row by row.
pub(super) fn matrices(text: &mut String, form: Form) {
    for Entry { key, unit, axes, .. } in form.entries {
        // Writing to a text cannot fail.
        let _ = match axes.map(Known::bound) {
            [Some(x), Some(y), Some(z)] => {
                let limits = super::limits(axes);
                writeln!(text, "{key}: [{x:.6e}, 0.0, 0.0, 0.0, {y:.6e}, 0.0, 0.0, 0.0, {z:.6e}]  # {unit}{limits}")
            }
            _ => writeln!(text, "{key}: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]  # not known for all axes"),
        };
    }
}
