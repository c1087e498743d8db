//! The topics of an MCAP file, and the definitions of their messages.

use imu_core::ros_messages::{fields_of, schema};
use imu_core::sample::Channel;

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

    /// Returns the message's definition and those of its parts.
    pub(super) fn definition(self, channels: &[Channel]) -> String {
        match fields_of(&self.message().replace("/msg/", "/")) {
            Some(fields) => schema(fields),
            None => {
                let mut own = "std_msgs/Header header\nuint64 seq\n".to_owned();
                for channel in channels {
                    own.push_str(&format!("float64 {}\n", channel.column_name()));
                }
                schema(&own)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_messages_are_the_standards_own_and_a_sample_has_its_channels() {
        for topic in Topic::ALL {
            let text = topic.definition(&[Channel::GyroX]);
            assert!(text.starts_with("std_msgs/Header header\n"), "{text}");
            assert_eq!(text.contains("gyro_x_rad_s"), topic == Topic::Sample, "{text}");
            assert!(text.contains("MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp"), "{text}");
        }
        let sample = Topic::Sample.definition(&[Channel::GyroX]);
        assert!(sample.starts_with("std_msgs/Header header\nuint64 seq\nfloat64 gyro_x_rad_s\n====="), "{sample}");
    }
}
