//! Covariances for `robot_localization`.
//!
//! # Source
//! cra-ros-pkg/robot_localization, `src/ros_filter.cpp`, `imuCallback`, `prepareTwist`, `prepareAcceleration`: rates
//! and accelerations are measurements with the covariance in `sensor_msgs/Imu`, row-major 3×3, of one sample; −1 in its
//! first element has the quantity ignored. No bias is estimated.

use super::form::Form;
use super::{ImuNoise, ros};
use imu_core::sample::Triad;

/// Returns variances at the sensor's rate, for each axis.
pub(super) fn form(noise: &ImuNoise) -> Form {
    ros::inertial(noise, "cra-ros-pkg/robot_localization, src/ros_filter.cpp")
}

pub(super) fn write(noise: &ImuNoise) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    let note = format!(
        "For the driver that fills sensor_msgs/Imu. Variances {}, N^2 rate, one per axis: robot_localization takes rates and \
         accelerations as measurements with the covariance of their message. It estimates no bias{}.",
        noise.of_one_sample(&[Triad::Accel, Triad::Gyro]),
        if noise.enlarged.is_some() {
            ""
        } else {
            ", and these variances hold neither B nor K: add the square of the bias that is left"
        }
    );
    text += &super::comment("# ", &note);
    text += &super::comment("# ", noise.note());
    ros::matrices(&mut text, form(noise));
    text
}
