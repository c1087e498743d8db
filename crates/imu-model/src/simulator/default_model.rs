//! The emulator's sensor if no model is given: a VN-100 on a desk.

use super::{ChannelModel, SensorModel};
use imu_core::sample::Channel;

/// Returns "VN-100 (emulated)" at 40 Hz: level and still, with all fourteen channels.
///
/// The accelerometer's N, B and K are those of a measured unit (a desk capture of five hours). The gyroscope's N and B are
/// those of VN-100 recordings at rest; its K, and the magnetometer's parameters, are such that five hours identify each
/// of N, B and K. Angles lie away from ±180°, so that none wraps.
pub fn default_model() -> SensorModel {
    let noise = |n, b, k, bias| ChannelModel { n, b, k, bias: Some(bias), ..ChannelModel::default() };
    let channels = [
        (Channel::Yaw, noise(5e-4, 0.0, 0.0, 62.0)),
        (Channel::Pitch, noise(2e-4, 0.0, 0.0, -0.44)),
        (Channel::Roll, noise(2e-4, 0.0, 0.0, -0.89)),
        (Channel::MagX, noise(3.0e-4, 1.0e-4, 5e-6, 0.18)),
        (Channel::MagY, noise(3.0e-4, 1.0e-4, 4e-6, 0.05)),
        (Channel::MagZ, noise(3.4e-4, 1.2e-4, 6e-6, 0.45)),
        (Channel::AccelX, noise(0.0021, 0.0011, 3.19e-4, 0.076)),
        (Channel::AccelY, noise(0.0017, 5.3e-4, 7.39e-5, -0.152)),
        (Channel::AccelZ, noise(0.0028, 0.0018, 6.56e-4, -9.79465)),
        (Channel::GyroX, noise(1.2e-4, 2.6e-5, 1.5e-6, 3.1e-4)),
        (Channel::GyroY, noise(1.2e-4, 2.5e-5, 1.3e-6, -2.2e-4)),
        (Channel::GyroZ, noise(1.1e-4, 2.7e-5, 1.7e-6, 1.4e-4)),
        (Channel::Temperature, noise(0.01, 0.0, 5e-4, 25.0)),
        (Channel::Pressure, noise(0.002, 0.0, 0.0, 101.3)),
    ];
    SensorModel {
        name: "VN-100 (emulated)".to_owned(),
        rate_hz: 40.0,
        channels: channels.into(),
        ..SensorModel::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_accelerometer_is_that_of_the_measured_unit() {
        let model = default_model();
        assert_eq!(model.channels.len(), Channel::COUNT);
        let found = [Channel::AccelX, Channel::AccelY, Channel::AccelZ].map(|channel| {
            let parameters = &model.channels[&channel];
            (parameters.n, parameters.b, parameters.k)
        });
        assert_eq!(found, [(0.0021, 0.0011, 3.19e-4), (0.0017, 5.3e-4, 7.39e-5), (0.0028, 0.0018, 6.56e-4)]);
    }
}
