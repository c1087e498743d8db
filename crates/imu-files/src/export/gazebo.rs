//! Noise of an SDF IMU sensor.
//!
//! # Source
//! SDFormat specification, element `noise` (types, `mean`, `stddev`, `precision` of the type `gaussian_quantized`,
//! `dynamic_bias_stddev`, `dynamic_bias_correlation_time`), and the Gaussian noise model that reads it, after the ROS
//! plugin of the same equations: a bias of σ_b² τ/2 (1 − e^(−2Δt/τ)) per step, so that σ_b is K where τ is long, and σ
//! √(2/Tc) for a Gauss–Markov process.

use super::form::{Entry, Form, Noise};
use super::{Axis, ImuNoise, Known, Part};
use imu_core::sample::Triad;
use imu_core::units::TESLA_PER_GAUSS;
use std::fmt::Write as _;

/// Correlation time that stands for a random walk, s: two hundred times five hours.
const WALK_S: f64 = 3.6e6;

/// Returns standard deviations at the sensor's rate, and those of the bias' steps, for each axis.
pub(super) fn form(noise: &ImuNoise) -> Form {
    let mut entries = Vec::new();
    for (triad, axes, unit, factor) in [
        (Triad::Accel, &noise.accel, "m/s^2", 1.0),
        (Triad::Gyro, &noise.gyro, "rad/s", 1.0),
        // Tesla, as the simulator's world field.
        (Triad::Mag, &noise.mag, "T", TESLA_PER_GAUSS),
    ] {
        let Some(axes) = axes else { continue };
        let white = axes.map(|axis| axis.n.scaled(noise.rate_hz.sqrt() * factor));
        // The format has no place for the bias of an axis without white noise.
        let walk =
            axes.map(|axis| if axis.n == Known::Nothing { Known::Nothing } else { bias(&axis).0.scaled(factor) });
        for (key, noise, unit, axes) in [
            ("stddev", Noise::White, unit.to_owned(), white),
            ("dynamic_bias_stddev", Noise::Walk, format!("{unit}/sqrt(s)"), walk),
        ] {
            entries.push(Entry { key, triad, noise, unit, axes });
        }
    }
    let takes = format!("standard deviations at {} Hz: N√rate; K; each axis", imu_core::units::hertz(noise.rate_hz));
    Form { takes, source: "SDFormat specification, element noise", each_axis: true, entries }
}

/// Returns the steps of the bias, U/√s, and its correlation time, s.
fn bias(axis: &Axis) -> (Known, f64) {
    axis.gauss_markov
        .map_or((axis.k.measured(), WALK_S), |(sigma, tc_s)| (Known::Value(sigma * (2.0 / tc_s).sqrt()), tc_s))
}

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = String::new();
    let origin = noise.origin_for(&[Part::Bias, Part::Resolution]);
    let note = format!(
        "{origin}. stddev is the standard deviation {}, N sqrt(rate); keep update_rate. mean is the bias: bias_mean would get another \
         sign at random. dynamic_bias_stddev is K (per root second) with a correlation time so long that the bias walks, or a \
         Gauss-Markov process as it was found. Bias instability B cannot be expressed. Where K is not identified there is none.",
        noise.of_one_sample(&[Triad::Accel, Triad::Gyro, Triad::Mag])
    );
    let _ = writeln!(text, "<!--\n{}-->", super::comment("     ", &note));
    let entries = form(noise).entries;
    let numbers = |triad: Triad| {
        Noise::ALL.map(|noise| {
            let own = entries.iter().find(|entry| entry.triad == triad && entry.noise == noise);
            own.map_or([Known::Nothing; 3], |entry| entry.axes)
        })
    };
    if noise.gyro.is_some() || noise.accel.is_some() {
        let _ = writeln!(
            text,
            "<sensor name=\"imu\" type=\"imu\">\n  <update_rate>{:?}</update_rate>\n  <imu>",
            noise.rate_hz
        );
        for (name, triad, of) in
            [("angular_velocity", Triad::Gyro, &noise.gyro), ("linear_acceleration", Triad::Accel, &noise.accel)]
        {
            if let Some(of) = of {
                let _ = writeln!(text, "    <{name}>");
                axes(&mut text, "      ", of, numbers(triad), 1.0);
                let _ = writeln!(text, "    </{name}>");
            }
        }
        text.push_str("  </imu>\n</sensor>\n");
    }
    if let Some(mag) = &noise.mag {
        let _ = writeln!(
            text,
            "<sensor name=\"magnetometer\" type=\"magnetometer\">\n  <update_rate>{:?}</update_rate>\n  <magnetometer>",
            noise.rate_hz
        );
        axes(&mut text, "    ", mag, numbers(Triad::Mag), TESLA_PER_GAUSS);
        text.push_str("  </magnetometer>\n</sensor>\n");
    }
    text
}

fn axes(text: &mut String, indent: &str, of: &[Axis; 3], [white, walk]: [[Known; 3]; 2], factor: f64) {
    for (((letter, axis), white), walk) in ["x", "y", "z"].into_iter().zip(of).zip(white).zip(walk) {
        let Some(stddev) = white.bound() else {
            let _ = writeln!(text, "{indent}<!-- {letter}: not known -->");
            continue;
        };
        let step = axis.fixed.resolution.map(|step| step * factor);
        let kind = if step.is_some() { "gaussian_quantized" } else { "gaussian" };
        let _ = writeln!(text, "{indent}<{letter}><noise type=\"{kind}\">");
        if let Known::Below(_) = white {
            let _ = writeln!(text, "{indent}  <!-- N is not identified: stddev is that of its 95 % upper limit -->");
        }
        let mean = axis.fixed.bias.map_or_else(|| "0.0".to_owned(), |bias| format!("{:.6e}", bias * factor));
        let _ = writeln!(text, "{indent}  <mean>{mean}</mean><stddev>{stddev:.6e}</stddev>");
        if let Some(step) = step {
            let _ = writeln!(text, "{indent}  <precision>{step:.6e}</precision>");
        }
        if let Known::Value(stddev) = walk {
            let time_s = bias(axis).1;
            let _ = writeln!(
                text,
                "{indent}  <dynamic_bias_stddev>{stddev:.6e}</dynamic_bias_stddev>\
                 <dynamic_bias_correlation_time>{time_s:?}</dynamic_bias_correlation_time>"
            );
        }
        let _ = writeln!(text, "{indent}</noise></{letter}>");
    }
}
