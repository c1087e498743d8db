//! Noise of IMU observations in Isaac Lab.
//!
//! # Source
//! isaac-sim/IsaacLab, `source/isaaclab/isaaclab/utils/noise/noise_cfg.py` (`GaussianNoiseCfg`: `mean`, `std`) and
//! `noise_model.py` (`gaussian_noise`: an independent draw per observation; `NoiseModelWithAdditiveBias`: a bias drawn
//! at each reset, which then stays). Isaac Sim's own IMU sensor has no noise.

use super::form::{Entry, Form, Noise};
use super::{ImuNoise, each, largest};
use imu_core::sample::Triad;
use std::fmt::Write as _;

/// Returns standard deviations at the sensor's rate, one for three axes.
pub(super) fn form(noise: &ImuNoise) -> Form {
    let mut entries = Vec::new();
    for (triad, key, unit, axes) in [
        (Triad::Accel, "IMU_LIN_ACC_NOISE", "m/s^2", &noise.accel),
        (Triad::Gyro, "IMU_ANG_VEL_NOISE", "rad/s", &noise.gyro),
    ] {
        let Some(axes) = axes else { continue };
        let axes = axes.map(|axis| axis.n.scaled(noise.rate_hz.sqrt()));
        entries.push(Entry { key, triad, noise: Noise::White, unit: unit.to_owned(), axes });
    }
    let takes = format!("standard deviations at {} Hz: N√rate", imu_core::units::hertz(noise.rate_hz));
    Form { takes, source: "isaac-sim/IsaacLab, isaaclab/utils/noise/noise_cfg.py", each_axis: false, entries }
}

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    let note = format!(
        "For the observation terms of an IMU in Isaac Lab (isaaclab/utils/noise/noise_cfg.py). std is the standard deviation {}, \
         N sqrt(rate); one number for three axes: the largest. Not expressible: bias instability B, random walk K, a Gauss-Markov \
         process; the bias of NoiseModelWithAdditiveBiasCfg is drawn at a reset and stays: it is the one at switch-on, which a record \
         at rest does not show.",
        noise.of_one_sample(&[Triad::Accel, Triad::Gyro])
    );
    text += &super::comment("# ", &note);
    // Writing to a text cannot fail.
    let _ = writeln!(
        text,
        "import math\n\nfrom isaaclab.utils.noise import GaussianNoiseCfg\n\n\
         RATE_HZ = {:?}  # of the observations: 1 / (sim.dt * decimation)",
        noise.rate_hz
    );
    for Entry { key, unit, axes, .. } in form(noise).entries {
        // The rate of the observations may differ from that of the record's samples.
        let density = axes.map(|known| known.scaled(noise.rate_hz.sqrt().recip()));
        let _ = writeln!(text, "# N of x, y, z in {unit}/sqrt(Hz): {}", each(density));
        let _ = match largest(density).bound() {
            Some(n) => writeln!(text, "{key} = GaussianNoiseCfg(mean=0.0, std={n:.6e} * math.sqrt(RATE_HZ))"),
            None => writeln!(text, "# {key}: unknown, take it from a longer record"),
        };
    }
    text
}
