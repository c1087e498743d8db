//! Definitions of ROS 2's standard messages, for bags that lack them (before Iron) and for bags that are written. Pure.
//!
//! The layouts are those of `std_msgs`, `builtin_interfaces`, `geometry_msgs` and `sensor_msgs` from ROS 2 Humble to
//! Jazzy, without their comments, and of a message that drivers of the VN-100 use (`imu_msg/IMUmsg`). A ROS 1 bag
//! always contains its own.

/// Types and their fields, one line each.
const STANDARD: [(&str, &str); 10] = [
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("std_msgs/String", "string data\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"),
    (
        "sensor_msgs/Imu",
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
         geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
         geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    ),
    (
        "sensor_msgs/MagneticField",
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance\n",
    ),
    ("sensor_msgs/Temperature", "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n"),
    ("sensor_msgs/FluidPressure", "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n"),
    (
        "imu_msg/IMUmsg",
        "std_msgs/Header header\nsensor_msgs/Imu imu\nsensor_msgs/MagneticField mag_field\nstring raw\n",
    ),
];

/// The separator between two definitions in a schema.
const SEPARATOR: &str = "================================================================================\nMSG: ";

/// Returns the fields of the type `package/Name`, if it is one of these.
pub fn fields_of(name: &str) -> Option<&'static str> {
    STANDARD.iter().find(|(known, _)| *known == name).map(|(_, fields)| *fields)
}

/// Returns a message's own fields, then the definitions of its parts, in the form of an MCAP schema (`ros2msg`).
pub fn schema(fields: &str) -> String {
    let mut parts = Vec::new();
    collect(fields, &mut parts);
    parts.iter().fold(fields.to_owned(), |text, (name, fields)| format!("{text}{SEPARATOR}{name}\n{fields}"))
}

fn collect<'a>(fields: &'a str, parts: &mut Vec<(&'a str, &'static str)>) {
    for kind in fields.lines().filter_map(|line| line.split(' ').next()) {
        if let Some(inner) = fields_of(kind)
            && parts.iter().all(|(known, _)| *known != kind)
        {
            parts.push((kind, inner));
            collect(inner, parts);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_brings_the_definitions_of_what_it_is_made_of_once() {
        for (name, fields) in STANDARD {
            let text = schema(fields);
            let mut parts = text.split(SEPARATOR);
            assert_eq!(parts.next(), Some(fields), "{name}");
            let known: Vec<&str> = parts.map(|part| part.split('\n').next().unwrap()).collect();
            for kind in text.lines().filter_map(|line| line.split(' ').next()).filter(|kind| kind.contains('/')) {
                assert_eq!(known.iter().filter(|known| **known == kind).count(), 1, "{name} uses {kind}");
            }
        }
    }

    #[test]
    fn an_imu_is_a_header_a_quaternion_and_vectors() {
        let text = schema(fields_of("sensor_msgs/Imu").unwrap());
        let parts: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("MSG: ")).collect();
        let expected =
            ["std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Quaternion", "geometry_msgs/Vector3"];
        assert_eq!(parts, expected);
        assert_eq!(fields_of("sensor_msgs/Image"), None);
    }
}
