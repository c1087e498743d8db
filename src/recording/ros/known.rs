//! Definitions of standard message types, for recordings that lack them: bags of ROS 2 before Iron. Pure.
//!
//! The layouts are those of ROS 2's `std_msgs`, `builtin_interfaces`, `geometry_msgs` and `sensor_msgs`, and of a message that
//! drivers of the VN-100 use in them (`imu_msg/IMUmsg`); a ROS 1 bag always brings its own.

use super::layout::Encoding;

/// Types and their fields.
const STANDARD: [(&str, &str); 10] = [
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
    ("std_msgs/String", "string data"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
    (
        "sensor_msgs/Imu",
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
         geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
         geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
    ),
    (
        "sensor_msgs/MagneticField",
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance",
    ),
    ("sensor_msgs/Temperature", "std_msgs/Header header\nfloat64 temperature\nfloat64 variance"),
    ("sensor_msgs/FluidPressure", "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance"),
    ("imu_msg/IMUmsg", "std_msgs/Header header\nsensor_msgs/Imu imu\nsensor_msgs/MagneticField mag_field\nstring raw"),
];

/// The definition of the type `package/Name`, where it is a standard one of ROS 2.
pub(super) fn standard_definition(name: &str, encoding: Encoding) -> Option<&'static str> {
    if encoding != Encoding::Cdr {
        return None;
    }
    STANDARD.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}
