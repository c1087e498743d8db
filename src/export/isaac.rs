//! Noise of IMU observations in Isaac Lab.
//!
//! # Source
//! isaac-sim/IsaacLab, `source/isaaclab/isaaclab/utils/noise/noise_cfg.py` (`GaussianNoiseCfg`: `mean`, `std`) and `noise_model.py`
//! (`gaussian_noise`: an independent draw per observation; `NoiseModelWithAdditiveBias`: a bias drawn at each reset, which then
//! stays). Isaac Sim's own IMU sensor has no noise.

use super::{ImuNoise, each, worst};
use std::fmt::Write as _;

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    text += &super::comment(
        "# ",
        "For the observation terms of an IMU in Isaac Lab (isaaclab/utils/noise/noise_cfg.py). std is that of one observation, \
         N sqrt(rate); one number for three axes: the largest. Not expressible: bias instability B, random walk K, a Gauss-Markov \
         process; the bias of NoiseModelWithAdditiveBiasCfg is drawn at a reset and stays: it is the one at switch-on, which a record \
         at rest does not tell.",
    );
    // Writing to a text cannot fail.
    let _ = writeln!(
        text,
        "import math\n\nfrom isaaclab.utils.noise import GaussianNoiseCfg\n\n\
         RATE_HZ = {:?}  # of the observations: 1 / (sim.dt * decimation)",
        noise.rate_hz
    );
    for (name, unit, axes) in
        [("IMU_LIN_ACC_NOISE", "m/s^2", &noise.accel), ("IMU_ANG_VEL_NOISE", "rad/s", &noise.gyro)]
    {
        let Some(axes) = axes else { continue };
        let _ = writeln!(text, "# N of x, y, z in {unit}/sqrt(Hz): {}", each(axes, |axis| axis.n, 1.0));
        let _ = match worst(axes, |axis| axis.n) {
            Some(n) => writeln!(text, "{name} = GaussianNoiseCfg(mean=0.0, std={n:.6e} * math.sqrt(RATE_HZ))"),
            None => writeln!(text, "# {name}: unknown, take it from a longer record"),
        };
    }
    text
}
