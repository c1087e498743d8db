//! Noise of an SDF IMU sensor.
//!
//! # Source
//! SDFormat specification, element `noise` (types, `mean`, `stddev`, `precision` of the type `gaussian_quantized`,
//! `dynamic_bias_stddev`, `dynamic_bias_correlation_time`), and the Gaussian noise model that reads it, after the ROS plugin of the same equations: a bias of
//! σ_b² τ/2 (1 − e^(−2Δt/τ)) per step, so that σ_b is K where τ is long, and σ √(2/Tc) for a Gauss–Markov process.

use super::{Axis, ImuNoise, Known, Part};
use crate::units::TESLA_PER_GAUSS;
use std::fmt::Write as _;

/// Correlation time that stands for a random walk, s: two hundred times five hours.
const WALK_S: f64 = 3.6e6;

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = String::new();
    let origin = noise.origin_for(&[Part::Bias, Part::Resolution]);
    let said = format!(
        "{origin}. stddev is that of one sample at this rate; keep update_rate. mean is the bias: bias_mean would get another \
         sign at random. dynamic_bias_stddev is K (per root second) with a correlation time so long that the bias walks, or a \
         Gauss-Markov process as it was found. Bias instability B cannot be expressed. Where K is not identified there is none."
    );
    let _ = writeln!(text, "<!--\n{}-->", super::comment("     ", &said));
    if noise.gyro.is_some() || noise.accel.is_some() {
        let _ = writeln!(
            text,
            "<sensor name=\"vn100\" type=\"imu\">\n  <update_rate>{:?}</update_rate>\n  <imu>",
            noise.rate_hz
        );
        for (name, axes) in [("angular_velocity", &noise.gyro), ("linear_acceleration", &noise.accel)] {
            if let Some(axes) = axes {
                triad(&mut text, name, "    ", axes, noise.rate_hz, 1.0);
            }
        }
        text.push_str("  </imu>\n</sensor>\n");
    }
    if let Some(mag) = &noise.mag {
        let _ = writeln!(
            text,
            "<sensor name=\"vn100_magnetometer\" type=\"magnetometer\">\n  <update_rate>{:?}</update_rate>\n  <magnetometer>",
            noise.rate_hz
        );
        // Tesla, as the simulator's world field.
        axes(&mut text, "    ", mag, noise.rate_hz, TESLA_PER_GAUSS);
        text.push_str("  </magnetometer>\n</sensor>\n");
    }
    text
}

fn triad(text: &mut String, name: &str, indent: &str, of: &[Axis; 3], rate_hz: f64, factor: f64) {
    let _ = writeln!(text, "{indent}<{name}>");
    axes(text, &format!("{indent}  "), of, rate_hz, factor);
    let _ = writeln!(text, "{indent}</{name}>");
}

fn axes(text: &mut String, indent: &str, of: &[Axis; 3], rate_hz: f64, factor: f64) {
    for (letter, axis) in ["x", "y", "z"].into_iter().zip(of) {
        let Some(n) = axis.n.bound() else {
            let _ = writeln!(text, "{indent}<!-- {letter}: not known -->");
            continue;
        };
        let step = axis.fixed.resolution.map(|step| step * factor);
        let kind = if step.is_some() { "gaussian_quantized" } else { "gaussian" };
        let _ = writeln!(text, "{indent}<{letter}><noise type=\"{kind}\">");
        if let Known::Below(_) = axis.n {
            let _ = writeln!(text, "{indent}  <!-- N is not identified: stddev is that of its 95 % upper limit -->");
        }
        let mean = axis.fixed.bias.map_or_else(|| "0.0".to_owned(), |bias| format!("{:.6e}", bias * factor));
        let _ = writeln!(text, "{indent}  <mean>{mean}</mean><stddev>{:.6e}</stddev>", n * rate_hz.sqrt() * factor);
        if let Some(step) = step {
            let _ = writeln!(text, "{indent}  <precision>{step:.6e}</precision>");
        }
        let bias = match (axis.gauss_markov, axis.k) {
            (Some((sigma, tc_s)), _) => Some((sigma * (2.0 / tc_s).sqrt(), tc_s)),
            (None, Known::Value(k)) => Some((k, WALK_S)),
            _ => None,
        };
        if let Some((stddev, time_s)) = bias {
            let _ = writeln!(
                text,
                "{indent}  <dynamic_bias_stddev>{:.6e}</dynamic_bias_stddev>\
                 <dynamic_bias_correlation_time>{time_s:?}</dynamic_bias_correlation_time>",
                stddev * factor
            );
        }
        let _ = writeln!(text, "{indent}</noise></{letter}>");
    }
}
