//! Felt motion: the motion that a sensor felt, computed from its samples and its model.

use super::settle::level;
use crate::recording::Recording;
use imu_core::sample::Triad;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_model::effects::TriadEffect;
use imu_model::effects::triad::{Axes, Drive, Vibration};
use imu_model::motion::gravity;
use imu_model::simulator::SensorModel;
use imu_model::simulator::response::{STAGES, stage};
use std::borrow::Cow;
use std::sync::Arc;

/// Steps of the inversion; they give effects of a percent to 10⁻¹⁴.
const STEPS: usize = 7;

/// Returns the record with the effects of the model's triads and its biases removed from accelerometer and gyro, sample
/// by sample. A bias that represents gravity at rest carries no information and stays. Delays, limits and bandwidths
/// are left as they are.
pub(super) fn felt<'a>(real: &'a Recording, sim: &SensorModel) -> Cow<'a, Recording> {
    let mut held = sim.clone();
    let at_rest = gravity::take_out(&mut held, STANDARD_GRAVITY_M_S2).is_some();
    let of = |triad: Triad| -> Option<Chain> {
        let effects = sim.triads.get(&triad).map(|of| of.effects.as_slice()).unwrap_or_default();
        let stages = STAGES.map(|stage| effects.iter().filter(|of| of.stage() == stage).cloned().collect::<Vec<_>>());
        let bias = if at_rest && triad == Triad::Accel { Axes::default() } else { level(sim, triad) };
        let acts = stages.iter().any(|of| !of.is_empty()) || bias.iter().any(|bias| *bias != 0.0);
        acts.then_some(Chain { stages, bias })
    };
    let (accel, gyro) = (of(Triad::Accel), of(Triad::Gyro));
    if accel.is_none() && gyro.is_none() {
        return Cow::Borrowed(real);
    }
    let mut felt = real.clone();
    let place = |felt: &Recording, triad: Triad| {
        let at = triad.channels().map(|channel| felt.channels.iter().position(|(own, _)| *own == channel));
        Some([at[0]?, at[1]?, at[2]?])
    };
    let (of_accel, of_gyro) = (place(&felt, Triad::Accel), place(&felt, Triad::Gyro));
    let mut vibration = Vibration::new(real.rate_hz);
    for t in 0..felt.len() {
        let temperature_c = real.temperature_c.as_ref().and_then(|of| of.get(t).copied());
        let mut force = of_accel.map(|at| at.map(|at| felt.channels[at].1[t]));
        for (chain, at, is_accel) in [(&accel, of_accel, true), (&gyro, of_gyro, false)] {
            let (Some(chain), Some(at)) = (chain, at) else { continue };
            // The mean square of the vibration moves little within a sample: an accelerometer's is that of the sample before.
            let about = Drive { vibration_m2_s4: vibration.now(), temperature_c, ..Drive::default() };
            let found = chain.inverse(at.map(|at| felt.channels[at].1[t]), force.filter(|_| !is_accel), about);
            at.into_iter().zip(found).for_each(|(at, value)| felt.channels[at].1[t] = value);
            if is_accel {
                force = Some(found);
            }
        }
        if let Some(force) = force.filter(|force| force.iter().all(|of| of.is_finite())) {
            vibration.next(force);
        }
    }
    Cow::Owned(felt)
}

/// A triad's reading of one instant, without memory.
struct Chain {
    stages: [Vec<Arc<dyn TriadEffect>>; 3],
    bias: Axes,
}

impl Chain {
    /// Returns the input that the triad felt. `force` acts on a gyro; an accelerometer's force is its own input.
    fn inverse(&self, shown: Axes, force: Option<Axes>, about: Drive) -> Axes {
        let mut input = shown;
        for _ in 0..STEPS {
            let accel_m_s2 = force.unwrap_or(input);
            let mut values = input;
            for effects in &self.stages {
                values = stage(effects, Drive { input: values, accel_m_s2, ..about });
            }
            for axis in 0..3 {
                input[axis] += shown[axis] - values[axis] - self.bias[axis];
            }
        }
        input
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::Channel;
    use serde_json::json;

    #[test]
    fn what_a_model_adds_is_taken_off_again() {
        let model = json!({"format": "vn100d-sensor-model-1", "name": "test", "rate_hz": 40, "channels": {
            "accel_x": {"N": 1e-3, "bias": 0.05}, "accel_y": {"N": 1e-3}, "accel_z": {"N": 1e-3}},
            "triads": {"accel": {"effects": [{"effect": "scale_factor", "x": 0.02, "y": -0.01, "z": 0.0},
                                             {"effect": "cross_axis_sensitivity", "xy": 0.01, "xz": 0.0, "yz": 0.0}]}}});
        let model = SensorModel::from_value(&model, "test").unwrap();
        // Cross-axis comes first, then the scale: x = 1.02·(1 + 0.01·2) + 0.05.
        let shown = [1.02 * 1.02 + 0.05, 0.99 * 2.01, -9.0];
        let channels = [Channel::AccelX, Channel::AccelY, Channel::AccelZ];
        let channels = channels.into_iter().zip(shown).map(|(channel, value)| (channel, vec![value])).collect();
        let real = Recording { rate_hz: 40.0, channels, ..Recording::default() };
        let found = felt(&real, &model);
        for ((_, values), truth) in found.channels.iter().zip([1.0, 2.0, -9.0]) {
            assert!((values[0] - truth).abs() < 1e-12, "{values:?} {truth}");
        }
        let mut at_rest = model;
        at_rest.triads.clear();
        at_rest.channels.get_mut(&Channel::AccelX).unwrap().bias = Some(0.0);
        at_rest.channels.get_mut(&Channel::AccelZ).unwrap().bias = Some(-9.81);
        assert!(matches!(felt(&real, &at_rest), Cow::Borrowed(_)));
    }
}
