//! A triad's response to the reference motion: latency, then cross-axis, scale factor and bias effects.

use super::reference::Motion;
use crate::effects::triad::{Axes, DelayLine, Drive, Vibration};
use crate::effects::{EffectKind, Stage, Temperature, TriadEffect};
use imu_core::sample::Triad;
use std::sync::Arc;

/// The memoryless stages in the chain's order.
pub const STAGES: [Stage; 3] = [Stage::CrossAxis, Stage::Scale, Stage::Bias];

/// One triad's motion chain and its last block.
#[derive(Debug)]
pub(super) struct Response {
    triad: Triad,
    delay: Option<DelayLine>,
    /// The delay of the specific force that acts on a gyroscope, equal to that of the motion.
    force_delay: Option<DelayLine>,
    /// The mean square of the vibration, if an effect asks for it.
    vibration: Option<Vibration>,
    stages: [Vec<Arc<dyn TriadEffect>>; 3],
    /// Whether an effect acts at rest.
    acts_at_rest: bool,
    /// One block per axis.
    pub(super) axes: [Vec<f64>; 3],
}

impl Response {
    pub(super) fn new(triad: Triad, effects: &[Arc<dyn TriadEffect>], internal_rate_hz: f64) -> Self {
        let delay_s: f64 = effects.iter().map(|effect| effect.delay_s()).sum();
        let is_rectified = effects.iter().any(|effect| effect.kind() == EffectKind::Rectification);
        let of = |stage| effects.iter().filter(|effect| effect.stage() == stage).cloned().collect();
        Self {
            triad,
            delay: (delay_s > 0.0).then(|| DelayLine::new(delay_s * internal_rate_hz)),
            force_delay: (delay_s > 0.0).then(|| DelayLine::new(delay_s * internal_rate_hz)),
            vibration: is_rectified.then(|| Vibration::new(internal_rate_hz)),
            acts_at_rest: effects.iter().any(|effect| STAGES.contains(&effect.stage())),
            stages: STAGES.map(of),
            axes: Default::default(),
        }
    }

    /// Returns whether the triad's output differs from its channels' biases.
    pub(super) fn acts(&self, moved: bool) -> bool {
        (moved && matches!(self.triad, Triad::Accel | Triad::Gyro)) || self.acts_at_rest
    }

    pub(super) fn triad(&self) -> Triad {
        self.triad
    }

    /// Computes the triad's response to these motions at this temperature, before any noise.
    pub(super) fn run(&mut self, motions: &[Motion], temperature: Temperature<'_>) {
        for axis in &mut self.axes {
            axis.clear();
        }
        for (index, motion) in motions.iter().enumerate() {
            let mut values = match self.triad {
                Triad::Gyro => motion.gyro_rad_s,
                Triad::Accel => motion.accel_m_s2,
                Triad::Attitude | Triad::Mag => [0.0; 3],
            };
            if let Some(delay) = &mut self.delay {
                values = delay.next(values);
            }
            let accel_m_s2 = match &mut self.force_delay {
                Some(delay) => delay.next(motion.accel_m_s2),
                None => motion.accel_m_s2,
            };
            let vibration_m2_s4 = self.vibration.as_mut().map_or([0.0; 3], |vibration| vibration.next(accel_m_s2));
            let temperature_c = Some(temperature.at(index));
            for effects in &self.stages {
                values = stage(effects, Drive { input: values, accel_m_s2, vibration_m2_s4, temperature_c });
            }
            for (axis, value) in self.axes.iter_mut().zip(values) {
                axis.push(value);
            }
        }
    }
}

/// Returns the stage's input and the sum of its effects' additions, each from that input.
pub fn stage(effects: &[Arc<dyn TriadEffect>], drive: Drive) -> Axes {
    let mut values = drive.input;
    for effect in effects {
        for (value, deviation) in values.iter_mut().zip(effect.deviation(drive)) {
            *value += deviation;
        }
    }
    values
}
