//! ROS 2 definitions of the messages that an MCAP file carries, as its schemas have them (`ros2msg`): the message's own, then
//! those it is made of.
//!
//! Source: common_interfaces (sensor_msgs, std_msgs, geometry_msgs) and rcl_interfaces (builtin_interfaces), ROS 2 Humble to
//! Jazzy, without their comments.

use crate::sample::Channel;

/// Between two definitions.
const SEPARATOR: &str = "================================================================================\nMSG: ";

const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: (&str, &str) = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const QUATERNION: (&str, &str) = ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n");
const VECTOR3: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");

const IMU: &str = "std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
";
const MAGNETIC_FIELD: &str = "std_msgs/Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance
";
const TEMPERATURE: &str = "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n";
const FLUID_PRESSURE: &str = "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n";

/// The topics of an exported capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topic {
    Imu,
    Mag,
    Temperature,
    Pressure,
    Sample,
}

impl Topic {
    pub(super) const ALL: [Self; 5] = [Self::Sample, Self::Imu, Self::Mag, Self::Temperature, Self::Pressure];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Imu => "/imu/data",
            Self::Mag => "/imu/mag",
            Self::Temperature => "/imu/temperature",
            Self::Pressure => "/imu/pressure",
            Self::Sample => "/vn100d/sample",
        }
    }

    pub(super) fn message(self) -> &'static str {
        match self {
            Self::Imu => "sensor_msgs/msg/Imu",
            Self::Mag => "sensor_msgs/msg/MagneticField",
            Self::Temperature => "sensor_msgs/msg/Temperature",
            Self::Pressure => "sensor_msgs/msg/FluidPressure",
            Self::Sample => "vn100d_msgs/msg/Sample",
        }
    }

    /// The message's definition and those it is made of.
    pub(super) fn definition(self, channels: &[Channel]) -> String {
        let (own, parts): (String, &[(&str, &str)]) = match self {
            Self::Imu => (IMU.to_owned(), &[HEADER, TIME, QUATERNION, VECTOR3]),
            Self::Mag => (MAGNETIC_FIELD.to_owned(), &[HEADER, TIME, VECTOR3]),
            Self::Temperature => (TEMPERATURE.to_owned(), &[HEADER, TIME]),
            Self::Pressure => (FLUID_PRESSURE.to_owned(), &[HEADER, TIME]),
            Self::Sample => {
                let mut own = "std_msgs/Header header\nuint64 seq\n".to_owned();
                for channel in channels {
                    own.push_str(&format!("float64 {}\n", channel.column_name()));
                }
                (own, &[HEADER, TIME])
            }
        };
        parts.iter().fold(own, |text, (name, definition)| format!("{text}{SEPARATOR}{name}\n{definition}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_brings_the_definitions_of_what_it_is_made_of() {
        for topic in Topic::ALL {
            let text = topic.definition(&[Channel::GyroX, Channel::Pressure]);
            let mut parts = text.split(SEPARATOR);
            let own = parts.next().unwrap();
            assert!(own.starts_with("std_msgs/Header header\n"), "{own}");
            let known: Vec<&str> = parts.map(|part| part.split('\n').next().unwrap()).collect();
            let used = text.lines().filter_map(|line| line.split(' ').next()).filter(|kind| kind.contains('/'));
            for kind in used {
                assert!(known.contains(&kind), "{} uses {kind}", topic.message());
            }
        }
        let sample = Topic::Sample.definition(&[Channel::GyroX]);
        assert!(sample.starts_with("std_msgs/Header header\nuint64 seq\nfloat64 gyro_x_rad_s\n====="), "{sample}");
    }
}
