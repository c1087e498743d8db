//! Gravity in a model's level: a model of a sensor at rest has it as bias, whereas a motion includes gravity.

use crate::simulator::SensorModel;
use imu_core::sample::{Channel, Triad};

/// If the accelerometer's bias is at least this long, m/s², it includes gravity.
const AT_REST_M_S2: f64 = 5.0;

/// Removes gravity from the accelerometer's biases. The remaining biases are the excess over `gravity_m_s2` along their
/// own direction, which is all that one position determines. Returns the original biases; `None` if they do not include
/// gravity.
pub fn take_out(model: &mut SensorModel, gravity_m_s2: f64) -> Option<[f64; 3]> {
    let axes = Triad::Accel.channels();
    let level = axes.map(|axis: Channel| model.channels.get(&axis).and_then(|of| of.bias).unwrap_or(0.0));
    let length = level.iter().map(|bias| bias * bias).sum::<f64>().sqrt();
    if length < AT_REST_M_S2 {
        return None;
    }
    for (axis, bias) in axes.into_iter().zip(level) {
        if let Some(of) = model.channels.get_mut(&axis).filter(|of| of.bias.is_some()) {
            of.bias = Some(bias * (1.0 - gravity_m_s2 / length));
        }
    }
    Some(level)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::default_model;
    use imu_core::units::STANDARD_GRAVITY_M_S2;

    #[test]
    fn a_sensor_at_rest_keeps_what_exceeds_gravity_and_one_without_gravity_all() {
        let mut model = default_model();
        let before = take_out(&mut model, STANDARD_GRAVITY_M_S2).unwrap();
        let length = before.iter().map(|bias| bias * bias).sum::<f64>().sqrt();
        let rest: f64 = Triad::Accel.channels().iter().map(|axis| model.channels[axis].bias.unwrap().powi(2)).sum();
        assert!((rest.sqrt() - (length - STANDARD_GRAVITY_M_S2).abs()).abs() < 1e-9);
        let once = model.clone();
        assert_eq!(take_out(&mut model, STANDARD_GRAVITY_M_S2), None);
        assert_eq!(model, once);
    }
}
