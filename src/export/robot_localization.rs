//! Covariances for `robot_localization`.
//!
//! # Source
//! cra-ros-pkg/robot_localization, `src/ros_filter.cpp`, `imuCallback`, `prepareTwist`, `prepareAcceleration`: rates and accelerations are
//! measurements with the covariance that `sensor_msgs/Imu` brings along, row-major 3×3, of one sample; −1 in its first element
//! has the quantity ignored. No bias is estimated.

use super::ImuNoise;

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    text += &super::comment(
        "# ",
        &format!(
            "For the driver that fills sensor_msgs/Imu. Variances of one sample at {} Hz, N^2 rate, one per axis: \
             robot_localization takes rates and accelerations as measurements with the covariance of their message. It estimates \
             no bias: add the square of what bias is left, or B and K stay unheard of.",
            noise.rate_hz
        ),
    );
    text += &super::comment("# ", super::filter::INFLATED);
    super::ros::inertial(&mut text, noise);
    text
}
