//! A writer of small ROS 2 recordings, `.db3` and MCAP, for recordings whose every value is known.

/// A message in CDR.
pub struct Cdr {
    bytes: Vec<u8>,
    big_endian: bool,
}

impl Cdr {
    /// Returns a message in little-endian CDR.
    pub fn little_endian() -> Self {
        Self { bytes: vec![0, 1, 0, 0], big_endian: false }
    }
    /// Returns a message in big-endian CDR.
    pub fn big_endian() -> Self {
        Self { bytes: vec![0, 0, 0, 0], big_endian: true }
    }
    fn align(&mut self, to: usize) {
        while !(self.bytes.len() - 4).is_multiple_of(to) {
            self.bytes.push(0xEE);
        }
    }
    /// Appends a 32-bit number.
    pub fn number(mut self, value: u32) -> Self {
        self.align(4);
        self.bytes.extend(if self.big_endian { value.to_be_bytes() } else { value.to_le_bytes() });
        self
    }
    /// Appends a byte.
    pub fn byte(mut self, value: u8) -> Self {
        self.bytes.push(value);
        self
    }
    /// Appends doubles.
    pub fn wide(mut self, values: &[f64]) -> Self {
        for value in values {
            self.align(8);
            self.bytes.extend(if self.big_endian { value.to_be_bytes() } else { value.to_le_bytes() });
        }
        self
    }
    /// Appends a string.
    pub fn text(mut self, text: &str) -> Self {
        self = self.number(text.len() as u32 + 1);
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
        self
    }
    /// Appends a `std_msgs/msg/Header`.
    pub fn header(self, stamp_ns: u64) -> Self {
        self.number((stamp_ns / 1_000_000_000) as u32).number((stamp_ns % 1_000_000_000) as u32).text("imu_link")
    }
    /// Appends a `sensor_msgs/msg/Imu`.
    pub fn imu(self, stamp_ns: u64, gyro: [f64; 3], accel: [f64; 3]) -> Self {
        self.header(stamp_ns)
            .wide(&[0.0, 0.0, 0.0, 1.0])
            .wide(&[0.0; 9])
            .wide(&gyro)
            .wide(&[0.0; 9])
            .wide(&accel)
            .wide(&[0.0; 9])
    }
    /// Appends a `sensor_msgs/msg/MagneticField`.
    pub fn magnetic_field(self, stamp_ns: u64, tesla: [f64; 3]) -> Self {
        self.header(stamp_ns).wide(&tesla).wide(&[0.0; 9])
    }
    /// Returns the bytes of the message.
    pub fn bytes(self) -> Vec<u8> {
        self.bytes
    }
}

/// The definition of `sensor_msgs/msg/Imu` as ROS 2 puts it in recordings.
pub const IMU_DEFINITION: &str = "# comment\nstd_msgs/Header header\n\ngeometry_msgs/Quaternion orientation\n\
float64[9] orientation_covariance # Row major about x, y, z axes\n\ngeometry_msgs/Vector3 angular_velocity\n\
float64[9] angular_velocity_covariance\n\ngeometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n\
================================================================================\nMSG: geometry_msgs/Quaternion\n\
float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n\
================================================================================\nMSG: geometry_msgs/Vector3\n\
float64 x\nfloat64 y\nfloat64 z\n\
================================================================================\nMSG: std_msgs/Header\n\
builtin_interfaces/Time stamp\nstring frame_id\n\
================================================================================\nMSG: builtin_interfaces/Time\n\
int32 sec\nuint32 nanosec\n";

/// A topic: its name, its type, and its definition if the recording includes it.
pub type Topic<'a> = (&'a str, &'a str, Option<&'a str>);
/// A message: its topic's place, its time of reception, its bytes.
pub type Message = (usize, i64, Vec<u8>);

/// Returns a `.db3` as rosbag2 writes it; with definitions, as since ROS 2 Iron, if a topic has one.
pub fn db3(topics: &[Topic<'_>], messages: &[Message]) -> Vec<u8> {
    let database = rusqlite::Connection::open_in_memory().unwrap();
    database
        .execute_batch(
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);
             CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);
             CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL);
             CREATE INDEX timestamp_idx ON messages (timestamp ASC);",
        )
        .unwrap();
    if topics.iter().any(|(_, _, definition)| definition.is_some()) {
        database
            .execute_batch(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY,topic_type TEXT NOT NULL,encoding TEXT NOT NULL,encoded_message_definition TEXT NOT NULL,type_description_hash TEXT NOT NULL);",
            )
            .unwrap();
    }
    for (index, (name, kind, definition)) in topics.iter().enumerate() {
        let sql = "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '')";
        database.execute(sql, rusqlite::params![index as i64 + 1, name, kind]).unwrap();
        if let Some(definition) = definition {
            let sql = "INSERT INTO message_definitions VALUES (NULL, ?1, 'ros2msg', ?2, '')";
            database.execute(sql, rusqlite::params![kind, definition]).unwrap();
        }
    }
    for (topic, received_ns, data) in messages {
        let sql = "INSERT INTO messages VALUES (NULL, ?1, ?2, ?3)";
        database.execute(sql, rusqlite::params![*topic as i64 + 1, received_ns, data]).unwrap();
    }
    database.serialize(rusqlite::MAIN_DB).unwrap().to_vec()
}

/// Returns an MCAP file of ROS 2, with chunks compressed with zstd or uncompressed; one chunk for each `per_chunk`
/// messages.
pub fn mcap(topics: &[Topic<'_>], messages: &[Message], zstd: bool, per_chunk: usize) -> Vec<u8> {
    let compression = zstd.then_some(mcap::Compression::Zstd);
    let options = mcap::WriteOptions::new().profile("ros2").compression(compression).chunk_size(None);
    let mut writer = mcap::Writer::with_options(std::io::Cursor::new(Vec::new()), options).unwrap();
    let channels: Vec<u16> = topics
        .iter()
        .map(|(name, kind, definition)| {
            let schema = writer.add_schema(kind, "ros2msg", definition.unwrap_or_default().as_bytes()).unwrap();
            writer.add_channel(schema, name, "cdr", &Default::default()).unwrap()
        })
        .collect();
    for (index, (topic, received_ns, data)) in messages.iter().enumerate() {
        let time = *received_ns as u64;
        let header = mcap::records::MessageHeader {
            channel_id: channels[*topic],
            sequence: index as u32,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, data).unwrap();
        if (index + 1) % per_chunk == 0 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}
