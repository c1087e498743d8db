//! Samples as MCAP with ROS 2 messages, for Foxglove and `ros2 bag`, and the recorded values beside them.
//!
//! `/imu/data` (rad/s, m/s²), `/imu/mag` (tesla), `/imu/temperature` (°C) and `/imu/pressure` (Pa) exist if the capture
//! has the channels. Absent values are marked as the messages' definitions require: −1 in the covariance's first place
//! (`Imu`), NaN (a single axis of `MagneticField`), no message at all (neither value is present). The orientation is
//! always unknown: a VN-100's angles count from north, east, down, and ROS' from east, north, up. Covariances are 0:
//! unknown. `/vn100d/sample` carries every channel as it was recorded, in degrees and gauss, NaN if there is no value;
//! `import` reads this topic back.
//!
//! `log_time`, `publish_time` and the header's stamp are the sample's UTC. Chunks of 1 MiB, zstd, with index,
//! statistics and CRCs.

use super::cdr::Cdr;
use super::ros2::Topic;
use super::{About, ExportError, Rows, Sink, Tally, rfc3339};
use ::mcap::records::{MessageHeader, Metadata};
use ::mcap::write::NoSeek;
use ::mcap::{Compression, WriteOptions};
use imu_core::sample::{Channel, Triad};
use imu_core::units::{GAUSS_PER_TESLA, NANOS_PER_SECOND};
use std::collections::BTreeMap;
use std::io::Write;

/// The frame of the values: the sensor's own axes.
const FRAME: &str = "imu_link";
/// Pascal in one kilopascal.
const PA_PER_KPA: f64 = 1000.0;
/// The covariance that marks an absent measurement, and the one that marks an unknown covariance.
const ABSENT: [f64; 9] = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
const UNKNOWN: [f64; 9] = [0.0; 9];
/// No rotation.
const IDENTITY: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// An MCAP file being written.
pub struct McapSink<W: Write> {
    writer: ::mcap::Writer<NoSeek<W>>,
    about: About,
    /// The file's number of each topic, and its number of messages.
    topics: Vec<(Topic, u16, u32)>,
    columns: Columns,
    cdr: Cdr,
}

impl<W: Write> std::fmt::Debug for McapSink<W> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("McapSink").field("about", &self.about).finish_non_exhaustive()
    }
}

/// The column of each channel.
#[derive(Debug)]
struct Columns([Option<usize>; Channel::COUNT]);

impl Columns {
    fn of(channels: &[Channel]) -> Self {
        let mut places = [None; Channel::COUNT];
        for (place, channel) in channels.iter().enumerate() {
            places[*channel as usize] = Some(place);
        }
        Self(places)
    }

    fn has(&self, channel: Channel) -> bool {
        self.0[channel as usize].is_some()
    }

    fn has_any(&self, triad: Triad) -> bool {
        triad.channels().into_iter().any(|channel| self.has(channel))
    }

    /// Returns a sample's value; NaN if it has none.
    fn value(&self, rows: &Rows<'_>, index: usize, channel: Channel) -> f64 {
        let column = self.0[channel as usize].and_then(|place| rows.columns.get(place));
        column.and_then(|column| column.get(index)).copied().unwrap_or(f64::NAN)
    }

    fn triad(&self, rows: &Rows<'_>, index: usize, triad: Triad) -> [f64; 3] {
        triad.channels().map(|channel| self.value(rows, index, channel))
    }
}

impl<W: Write> McapSink<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn begin(to: W, about: &About) -> Result<Self, ExportError> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(about.writer.clone())
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .disable_seeking(true);
        let mut writer = options.create(NoSeek::new(to))?;
        let columns = Columns::of(&about.channels);
        let mut topics = Vec::new();
        for topic in Topic::ALL {
            let there = match topic {
                Topic::Imu => columns.has_any(Triad::Gyro) || columns.has_any(Triad::Accel),
                Topic::Mag => columns.has_any(Triad::Mag),
                Topic::Temperature => columns.has(Channel::Temperature),
                Topic::Pressure => columns.has(Channel::Pressure),
                Topic::Sample => true,
            };
            if there {
                let definition = topic.definition(&about.channels);
                let schema = writer.add_schema(topic.message(), "ros2msg", definition.as_bytes())?;
                // rosbag2 writes the key for every topic, and requires it.
                let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), String::new())]);
                topics.push((topic, writer.add_channel(schema, topic.name(), "cdr", &metadata)?, 0));
            }
        }
        Ok(Self { writer, about: about.clone(), topics, columns, cdr: Cdr::default() })
    }

    /// Encodes one sample's message of a topic; returns `false` if there is none.
    fn put(&mut self, topic: Topic, rows: &Rows<'_>, index: usize, utc_ns: u64, sec: i32) -> bool {
        let nanosec = (utc_ns % NANOS_PER_SECOND) as u32;
        let columns = &self.columns;
        let cdr = self.cdr.begin().i32(sec).u32(nanosec).string(FRAME);
        match topic {
            Topic::Imu => {
                let whole = |values: [f64; 3]| {
                    if values.iter().all(|value| value.is_finite()) { (values, UNKNOWN) } else { ([0.0; 3], ABSENT) }
                };
                let (gyro, gyro_covariance) = whole(columns.triad(rows, index, Triad::Gyro));
                let (accel, accel_covariance) = whole(columns.triad(rows, index, Triad::Accel));
                if gyro_covariance == ABSENT && accel_covariance == ABSENT {
                    return false;
                }
                cdr.f64s(&IDENTITY)
                    .f64s(&ABSENT)
                    .f64s(&gyro)
                    .f64s(&gyro_covariance)
                    .f64s(&accel)
                    .f64s(&accel_covariance);
            }
            Topic::Mag => {
                // Divided, not multiplied by 1e-4, which is not a double, so that each value is the nearest to the true
                // one.
                let field = columns.triad(rows, index, Triad::Mag).map(|gauss| gauss / GAUSS_PER_TESLA);
                if field.iter().all(|value| value.is_nan()) {
                    return false;
                }
                cdr.f64s(&field).f64s(&UNKNOWN);
            }
            Topic::Temperature => return scalar(cdr, columns.value(rows, index, Channel::Temperature)),
            Topic::Pressure => return scalar(cdr, columns.value(rows, index, Channel::Pressure) * PA_PER_KPA),
            Topic::Sample => {
                cdr.u64(rows.first_seq + index as u64);
                for column in rows.columns {
                    cdr.f64s(&[column.get(index).copied().unwrap_or(f64::NAN)]);
                }
            }
        }
        true
    }
}

/// Encodes a value and its variance, which is not known; returns `false` if there is no value.
fn scalar(cdr: &mut Cdr, value: f64) -> bool {
    cdr.f64s(&[value, 0.0]);
    value.is_finite()
}

impl<W: Write> Sink for McapSink<W> {
    fn rows(&mut self, rows: Rows<'_>) -> Result<(), ExportError> {
        for (index, time_ns) in rows.time_ns.iter().enumerate() {
            let utc_ns = self.about.origin_ns.saturating_add(*time_ns);
            let sec = i32::try_from(utc_ns.div_euclid(NANOS_PER_SECOND as i64)).ok().filter(|sec| *sec >= 0);
            let Some((sec, utc_ns)) = sec.zip(u64::try_from(utc_ns).ok()) else {
                return Err(ExportError::Stamp { seq: rows.first_seq + index as u64, utc: rfc3339(utc_ns) });
            };
            for place in 0..self.topics.len() {
                let (topic, channel_id, sequence) = self.topics[place];
                if self.put(topic, &rows, index, utc_ns, sec) {
                    let header = MessageHeader { channel_id, sequence, log_time: utc_ns, publish_time: utc_ns };
                    self.writer.write_to_known_channel(&header, self.cdr.bytes())?;
                    self.topics[place].2 = sequence.wrapping_add(1);
                }
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, tally: &Tally) -> Result<(), ExportError> {
        let about = &self.about;
        let mut metadata: BTreeMap<String, String> =
            about.metadata(tally).into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        for channel in &about.channels {
            metadata.insert(format!("unit.{}", channel.column_name()), channel.unit().to_owned());
        }
        self.writer.write_metadata(&Metadata { name: "vn100d".to_owned(), metadata })?;
        self.writer.finish()?;
        Ok(self.writer.into_inner().into_inner().flush()?)
    }
}
