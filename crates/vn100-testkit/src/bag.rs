//! A writer of small ROS 1 bags, for recordings whose every value is known.

use std::io::Write;

/// Type and definition of a message like those of IMU drivers: a header, the raw line, the standard messages.
pub const DRIVER: (&str, &str) = ("imu_driver/Measurement", DRIVER_DEFINITION);
/// Type and definition of the standard message alone.
pub const IMU: (&str, &str) = ("sensor_msgs/Imu", IMU_DEFINITION);
/// Type and definition of a text.
pub const TEXT: (&str, &str) = ("std_msgs/String", "string data\n");

const DRIVER_DEFINITION: &str = "# a driver's own message
Header header
string raw
sensor_msgs/Imu imu
sensor_msgs/MagneticField mag
int32[] extra
uint8 KIND=3   # a constant
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: sensor_msgs/Imu
Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: sensor_msgs/MagneticField
Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance
";

const IMU_DEFINITION: &str = "std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
===
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
===
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
===
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
";

/// Returns a record: header fields and data, each behind its length.
pub fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut header = Vec::new();
    for (name, value) in fields {
        header.extend(((name.len() + 1 + value.len()) as u32).to_le_bytes());
        header.extend(name.as_bytes());
        header.push(b'=');
        header.extend(*value);
    }
    let mut record = (header.len() as u32).to_le_bytes().to_vec();
    record.extend(header);
    record.extend((data.len() as u32).to_le_bytes());
    record.extend(data);
    record
}

/// Returns a connection's record.
pub fn connection(number: u32, topic: &str, (kind, definition): (&str, &str)) -> Vec<u8> {
    let described = record(&[("type", kind.as_bytes()), ("message_definition", definition.as_bytes())], &[]);
    // The data are fields as in a header, without its length and without data behind them.
    let data = &described[4..described.len() - 4];
    record(&[("op", &[7]), ("conn", &number.to_le_bytes()), ("topic", topic.as_bytes())], data)
}

/// Returns a message's record, received at this time in ns since 1970.
pub fn message(number: u32, received_ns: u64, data: &[u8]) -> Vec<u8> {
    record(&[("op", &[2]), ("conn", &number.to_le_bytes()), ("time", &time(received_ns))], data)
}

/// Returns a time of ROS.
pub fn time(ns: u64) -> Vec<u8> {
    let (seconds, nanos) = ((ns / 1_000_000_000) as u32, (ns % 1_000_000_000) as u32);
    [seconds.to_le_bytes(), nanos.to_le_bytes()].concat()
}

/// Returns a chunk of records, compressed: `none`, `bz2` or `lz4`.
pub fn chunk(compression: &str, records: &[u8]) -> Vec<u8> {
    let packed = match compression {
        "bz2" => {
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
            encoder.write_all(records).unwrap();
            encoder.finish().unwrap()
        }
        "lz4" => {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            encoder.write_all(records).unwrap();
            encoder.finish().unwrap()
        }
        _ => records.to_vec(),
    };
    let size = (records.len() as u32).to_le_bytes();
    record(&[("op", &[5]), ("compression", compression.as_bytes()), ("size", &size)], &packed)
}

/// Returns a bag of these chunks.
pub fn bag(chunks: &[Vec<u8>]) -> Vec<u8> {
    let mut bag = b"#ROSBAG V2.0\n".to_vec();
    let padding = vec![b' '; 64];
    let numbers: [(&str, &[u8]); 4] =
        [("op", &[3]), ("index_pos", &[0; 8]), ("conn_count", &[1, 0, 0, 0]), ("chunk_count", &[1, 0, 0, 0])];
    bag.extend(record(&numbers, &padding));
    for chunk in chunks {
        bag.extend(chunk);
        // Indices, which need not be read.
        bag.extend(record(&[("op", &[4]), ("ver", &[1, 0, 0, 0]), ("conn", &[0; 4]), ("count", &[0; 4])], &[]));
    }
    bag
}

fn header(stamp_ns: u64) -> Vec<u8> {
    [&7_u32.to_le_bytes()[..], &time(stamp_ns), &text("imu")].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

fn numbers(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Returns the bytes of an [`IMU`] message.
pub fn imu(stamp_ns: u64, gyro: [f64; 3], accel: [f64; 3]) -> Vec<u8> {
    let covariance = numbers(&[0.0; 9]);
    let mut bytes = header(stamp_ns);
    bytes.extend(numbers(&[0.0, 0.0, 0.0, 1.0]));
    bytes.extend(&covariance);
    bytes.extend(numbers(&gyro));
    bytes.extend(&covariance);
    bytes.extend(numbers(&accel));
    bytes.extend(&covariance);
    bytes
}

/// Returns the bytes of a [`DRIVER`] message.
pub fn driver(stamp_ns: u64, raw: &str, gyro: [f64; 3], accel: [f64; 3], mag_tesla: [f64; 3]) -> Vec<u8> {
    let mut bytes = header(stamp_ns);
    bytes.extend(text(raw));
    bytes.extend(imu(0, gyro, accel));
    bytes.extend(header(0));
    bytes.extend(numbers(&mag_tesla));
    bytes.extend(numbers(&[0.0; 9]));
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend([1, 0, 0, 0, 2, 0, 0, 0]);
    bytes
}

/// Returns the bytes of a [`TEXT`] message.
pub fn string(line: &str) -> Vec<u8> {
    text(line)
}

/// Returns a raw `$VNYMR` line of these gyro and acceleration values, with its checksum.
pub fn raw_line(gyro: [f64; 3], accel: [f64; 3]) -> String {
    let body = format!(
        "VNYMR,-134.051,-000.443,-000.892,-00.1575,+00.1599,+00.3040,{:+07.3},{:+07.3},{:+07.3},{:+010.6},{:+010.6},{:+010.6}",
        accel[0], accel[1], accel[2], gyro[0], gyro[1], gyro[2]
    );
    format!("${body}*{:02X}", body.bytes().fold(0, |sum, byte| sum ^ byte))
}
