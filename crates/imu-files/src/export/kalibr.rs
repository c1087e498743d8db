//! Kalibr's `imu.yaml`.
//!
//! # Source
//! ethz-asl/kalibr, wiki "IMU Noise Model": continuous-time densities of white noise (m/s²/√Hz, rad/s/√Hz) and of the
//! random walk of the bias (m/s³/√Hz, rad/s²/√Hz, which is our K in U/√s), one number for all three axes, discretised by
//! the reader as σ/√Δt.

use super::filter::{Layout, OPENVINS, form, sensor};
use super::{ImuNoise, each, largest};
use imu_core::sample::Triad;
use std::fmt::Write as _;

/// The keys and their meanings are those that `OpenVINS` adopted.
pub(super) const LAYOUT: Layout =
    Layout { source: "ethz-asl/kalibr, wiki page IMU Noise Model", head: "", around: ["", ": "], ..OPENVINS };

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    text.push_str(
        "# Continuous-time, SI. One number per sensor: the largest axis; each axis in the comment (x, y, z).\n\
         # `<`: not identified in this record, 95 % upper limit; where it is the largest it stands as the number, which is\n\
         # conservative. ",
    );
    text.push_str(if noise.enlarged.is_some() {
        "Bias instability B and other effects are in these numbers; add nothing for them.\n"
    } else {
        "Not expressible here: bias instability B, Gauss-Markov, one value per axis.\n"
    });
    text += &super::comment("# ", noise.note());
    let entries = form(noise, &LAYOUT).entries;
    for (triad, axes, unit) in [(Triad::Accel, &noise.accel, "m/s"), (Triad::Gyro, &noise.gyro, "rad/s")] {
        let Some(axes) = axes else { continue };
        for entry in entries.iter().filter(|entry| entry.triad == triad) {
            let (key, comment) = (entry.key, format!("# {}; {}", entry.unit, entry.words()));
            // Writing to a text cannot fail.
            let _ = match largest(entry.axes).bound() {
                Some(value) => writeln!(text, "{key}: {value:.6e}  {comment}"),
                None => writeln!(text, "# {key}: unknown, take it from a longer record  {comment}"),
            };
        }
        let (b, sigma) = (axes.map(|axis| axis.b), axes.map(|axis| axis.n.scaled(noise.rate_hz.sqrt())));
        let sensor = sensor(triad);
        let _ = writeln!(text, "# {sensor} bias instability B (IEEE 952 coefficient), {unit}: {}", each(b));
        let _ = writeln!(text, "# {sensor} discrete white sigma at {} Hz, {unit}: {}", noise.rate_hz, each(sigma));
    }
    let _ = writeln!(text, "update_rate: {:?}  # Hz", noise.rate_hz);
    text.push_str("rostopic: /imu/data  # set to your topic\n");
    text
}
