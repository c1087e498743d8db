//! Tests of the exported files: read back by the formats' own readers.

use super::*;
use ::parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int32Type, Int64Type, TimestampNanosecondType};
use arrow_array::{Array, RecordBatch};
use imu_core::sample::{Gap, GapCause};

const ORIGIN_NS: i64 = 1_800_000_000_123_456_789;

fn about(channels: &[Channel]) -> About {
    About {
        id: Some(7),
        database: "d0d0".to_owned(),
        name: "night \"1\"".to_owned(),
        note: Some("on foam, 23 °C".to_owned()),
        origin_ns: ORIGIN_NS,
        rate_hz: Some(40.0),
        channels: channels.to_vec(),
        sensor: serde_json::json!({"serial_number": "0100012345"}).into(),
        software: "vn100d 0.0.9".to_owned(),
        writer: "vn100d 0.1.0".to_owned(),
    }
}

/// The data of a test: times in ns, and columns in the order of the channels.
struct Made {
    segment: Vec<u32>,
    time_ns: Vec<i64>,
    device_ns: Vec<Option<u64>>,
    columns: Vec<Vec<f64>>,
}

impl Made {
    fn rows(&self, first_seq: u64) -> Rows<'_> {
        Rows {
            first_seq,
            segment: &self.segment,
            time_ns: &self.time_ns,
            device_ns: &self.device_ns,
            columns: &self.columns,
        }
    }
}

fn made(columns: Vec<Vec<f64>>) -> Made {
    let rows = columns[0].len();
    Made {
        segment: (0..rows).map(|row| 1 + u32::from(row >= 2)).collect(),
        time_ns: (0..rows as i64).map(|row| row * 25_000_001).collect(),
        device_ns: (0..rows as u64).map(|row| (row != 1).then_some(row * 25_000_000)).collect(),
        columns,
    }
}

fn tally() -> Tally {
    let mut tally = Tally::of(3);
    tally.gap(Gap {
        before_seq: 12,
        from_utc_ns: ORIGIN_NS,
        to_utc_ns: ORIGIN_NS + 1,
        device_ns: None,
        missing: 4,
        missing_exact: true,
        cause: GapCause::Unplugged,
    });
    tally
}

fn written(format: SampleFormat, about: &About, made: &Made) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut sink = format.begin(&mut bytes, about, false).unwrap();
    sink.rows(made.rows(10)).unwrap();
    sink.finish(&tally()).unwrap();
    bytes
}

fn parquet_of(bytes: &[u8]) -> (ParquetRecordBatchReaderBuilder<std::fs::File>, Vec<RecordBatch>) {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let open = || ParquetRecordBatchReaderBuilder::try_new(file.reopen().unwrap()).unwrap();
    (open(), open().build().unwrap().map(Result::unwrap).collect())
}

#[test]
fn parquet_gives_back_every_bit_and_states_units_and_gaps() {
    let awkward = vec![0.1 + 0.2, -0.0, f64::NAN];
    let made = made(vec![awkward, vec![5e-324, f64::MAX, -1e-7]]);
    let about = about(&[Channel::GyroX, Channel::Temperature]);
    let (builder, batches) = parquet_of(&written(SampleFormat::Parquet, &about, &made));
    let schema = builder.schema().clone();
    let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
    assert_eq!(
        names,
        ["database", "capture", "segment", "seq", "time_s", "utc", "device_time_ns", "gyro_x_rad_s", "temperature_c"]
    );
    assert_eq!(schema.field(7).metadata()["unit"], "rad/s");
    assert_eq!(schema.field(8).metadata()["unit"], "°C");
    let metadata = builder.metadata().file_metadata().key_value_metadata().unwrap();
    let value = |key: &str| metadata.iter().find(|pair| pair.key == key).unwrap().value.clone().unwrap();
    assert_eq!(value("note"), "on foam, 23 °C");
    assert_eq!(
        (value("capture").as_str(), value("rate_hz").as_str(), value("missing").as_str()),
        ("night \"1\"", "40", "4")
    );
    assert_eq!(value("started_at"), "2027-01-15T08:00:00.123456789Z");
    assert_eq!(value("sensor"), r#"{"serial_number":"0100012345"}"#);
    let gaps: serde_json::Value = serde_json::from_str(&value("gaps")).unwrap();
    assert_eq!((&gaps[0]["cause"], &gaps[0]["missing"]), (&"unplugged".into(), &4.into()));
    let [batch] = batches.as_slice() else { panic!("{} batches", batches.len()) };
    assert!(batch.column(0).as_string::<i32>().iter().all(|database| database == Some("d0d0")));
    assert_eq!(batch.column(1).as_primitive::<Int64Type>().values(), &[7, 7, 7]);
    assert_eq!(batch.column(2).as_primitive::<Int32Type>().values(), &[1, 1, 2]);
    assert_eq!(batch.column(3).as_primitive::<Int64Type>().values(), &[10, 11, 12]);
    assert_eq!(batch.column(4).as_primitive::<Float64Type>().values(), &[0.0, 0.025_000_001, 0.050_000_002]);
    let utc = batch.column(5).as_primitive::<TimestampNanosecondType>();
    assert_eq!((utc.value(2), utc.timezone()), (ORIGIN_NS + 50_000_002, Some("UTC")));
    let device = batch.column(6).as_primitive::<Int64Type>();
    assert!(device.is_null(1) && device.value(2) == 50_000_000);
    for (place, column) in made.columns.iter().enumerate() {
        let read = batch.column(7 + place).as_primitive::<Float64Type>();
        for (row, value) in column.iter().enumerate() {
            assert_eq!(read.is_null(row), value.is_nan());
            assert!(value.is_nan() || read.value(row).to_bits() == value.to_bits(), "{place} {row}");
        }
    }
}

#[test]
fn a_recording_without_a_database_has_no_id_and_an_empty_range_no_rows() {
    let about = About { id: None, database: String::new(), rate_hz: None, ..about(&[Channel::GyroX]) };
    let (_, batches) = parquet_of(&written(SampleFormat::Parquet, &about, &made(vec![vec![1.0]])));
    assert_eq!((batches[0].column(0).null_count(), batches[0].column(1).null_count()), (1, 1));
    let (builder, batches) = parquet_of(&written(SampleFormat::Parquet, &about, &made(vec![Vec::new()])));
    assert_eq!((builder.schema().fields().len(), batches.len()), (8, 0));
    let csv = written(SampleFormat::Csv, &about, &made(vec![Vec::new()]));
    assert_eq!(csv, b"time_s,gyro_x_rad_s\n");
    let bytes = written(SampleFormat::Mcap, &about, &made(vec![Vec::new()]));
    assert_eq!(::mcap::MessageStream::new(&bytes).unwrap().count(), 0);
}

#[test]
fn values_that_differ_from_row_to_row_survive_where_the_dictionary_gives_up() {
    let mut state = 1_u64;
    let mut value = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from_bits(0x3FF0_0000_0000_0000 | state >> 12)
    };
    let column: Vec<f64> = (0..300_000).map(|_| value()).collect();
    let (builder, batches) =
        parquet_of(&written(SampleFormat::Parquet, &about(&[Channel::GyroX]), &made(vec![column.clone()])));
    assert_eq!(builder.metadata().num_row_groups(), 2);
    let read: Vec<f64> =
        batches.iter().flat_map(|b| b.column(7).as_primitive::<Float64Type>().values().to_vec()).collect();
    assert!(read == column);
}

#[test]
fn text_counts_from_the_first_sample_or_from_1970() {
    let made = made(vec![vec![1e-7, f64::NAN]]);
    let about = about(&[Channel::GyroX]);
    for (utc, text) in [
        (false, "time_s,gyro_x_rad_s\n0,0.0000001\n0.025000001,\n"),
        (true, "time_s,gyro_x_rad_s\n1800000000.123456789,0.0000001\n1800000000.14845679,\n"),
    ] {
        let mut bytes = Vec::new();
        let mut sink = SampleFormat::Csv.begin(&mut bytes, &about, utc).unwrap();
        sink.rows(made.rows(0)).unwrap();
        sink.finish(&tally()).unwrap();
        assert_eq!(String::from_utf8(bytes).unwrap(), text);
    }
    let lines = String::from_utf8(written(SampleFormat::Ndjson, &about, &made)).unwrap();
    assert_eq!(lines, "{\"time_s\":0,\"gyro_x\":0.0000001}\n{\"time_s\":0.025000001,\"gyro_x\":null}\n");
}

/// Returns the doubles and integers of a message after its header, whose frame is `imu_link`: 4 + 4 + 4 + 4 + 9 bytes,
/// then places of 8.
fn doubles(data: &[u8]) -> Vec<f64> {
    assert_eq!(data[..4], [0, 1, 0, 0]);
    assert_eq!(&data[16..25], b"imu_link\0");
    data[28..].chunks_exact(8).map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())).collect()
}

#[test]
fn mcap_is_in_si_and_carries_what_was_recorded_beside() {
    use Channel::{AccelX, AccelY, AccelZ, GyroX, GyroY, GyroZ, MagX, MagY, MagZ, Pressure, Temperature, Yaw};
    let channels = [Yaw, MagX, MagY, MagZ, AccelX, AccelY, AccelZ, GyroX, GyroY, GyroZ, Temperature, Pressure];
    let columns = [-170.5, 0.5, -0.1, 0.25, 0.1, 0.2, -9.8, 0.01, 0.02, 0.03, 21.5, 101.325];
    let mut made = made(columns.iter().map(|value| vec![*value; 3]).collect());
    // In the second sample the gyroscope lacks an axis and the magnetometer everything, in the third there is only one angle.
    made.columns[8][1] = f64::NAN;
    for column in &mut made.columns[1..4] {
        column[1] = f64::NAN;
    }
    for column in &mut made.columns[1..] {
        column[2] = f64::NAN;
    }
    let bytes = written(SampleFormat::Mcap, &about(&channels), &made);
    let messages: Vec<_> = ::mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let of = |topic: &str| messages.iter().filter(|of| of.channel.topic == topic).collect::<Vec<_>>();
    let [imu, mag, warm, pressure, own] =
        ["/imu/data", "/imu/mag", "/imu/temperature", "/imu/pressure", "/vn100d/sample"].map(of);
    assert_eq!([imu.len(), mag.len(), warm.len(), pressure.len(), own.len()], [2, 1, 2, 2, 3]);
    assert_eq!(imu[1].log_time, ORIGIN_NS as u64 + 25_000_001);
    assert_eq!(imu[1].publish_time, imu[1].log_time);
    assert_eq!(i32::from_le_bytes(imu[1].data[4..8].try_into().unwrap()), 1_800_000_000);
    assert_eq!(u32::from_le_bytes(imu[1].data[8..12].try_into().unwrap()), 148_456_790);
    let first = doubles(&imu[0].data);
    assert_eq!(first.len(), 4 + 9 + 3 + 9 + 3 + 9);
    assert_eq!(
        (first[3], first[4], &first[13..16], &first[25..28]),
        (1.0, -1.0, &[0.01, 0.02, 0.03][..], &[0.1, 0.2, -9.8][..])
    );
    assert_eq!((first[16], first[28]), (0.0, 0.0), "the covariance is unknown, the value is not");
    let second = doubles(&imu[1].data);
    assert_eq!((second[16], second[28]), (-1.0, 0.0), "there is no angular rate");
    assert_eq!(doubles(&mag[0].data)[..3], [5e-5, -1e-5, 2.5e-5], "tesla");
    assert_eq!(doubles(&warm[0].data), [21.5, 0.0]);
    assert_eq!(doubles(&pressure[0].data), [101_325.0, 0.0], "pascal");
    for (row, message) in own.iter().enumerate() {
        let read = doubles(&message.data);
        assert_eq!(read[0].to_bits(), 10 + row as u64, "seq");
        for (place, column) in made.columns.iter().enumerate() {
            assert!(
                read[1 + place].to_bits() == column[row].to_bits() || column[row].is_nan() && read[1 + place].is_nan()
            );
        }
    }
    let schema = own[0].channel.schema.as_ref().unwrap();
    assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("vn100d_msgs/msg/Sample", "ros2msg"));
    assert!(String::from_utf8_lossy(&schema.data).contains("\nfloat64 mag_x_gauss\n"));
    let summary = ::mcap::Summary::read(&bytes).unwrap().unwrap();
    let statistics = summary.stats.unwrap();
    assert_eq!((statistics.message_count, statistics.channel_count, statistics.chunk_count), (10, 5, 1));
    assert_eq!(statistics.message_start_time, ORIGIN_NS as u64);
    assert_eq!((summary.chunk_indexes.len(), summary.chunk_indexes[0].compression.as_str()), (1, "zstd"));
    let metadata = ::mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap();
    assert_eq!((metadata.name.as_str(), metadata.metadata["capture"].as_str()), ("vn100d", "night \"1\""));
    assert_eq!(metadata.metadata["note"], "on foam, 23 °C");
    assert_eq!(metadata.metadata["unit.mag_x_gauss"], "gauss");
}

#[test]
fn a_topic_exists_where_the_capture_has_its_channels() {
    let bytes = written(SampleFormat::Mcap, &about(&[Channel::MagY]), &made(vec![vec![0.5; 3]]));
    let messages: Vec<_> = ::mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let mut topics: Vec<&str> = messages.iter().map(|of| of.channel.topic.as_str()).collect();
    topics.dedup();
    assert_eq!(topics[..2], ["/vn100d/sample", "/imu/mag"]);
    let field = doubles(&messages[1].data);
    assert!(field[0].is_nan() && field[1] == 5e-5 && field[2].is_nan());
}

#[test]
fn a_time_that_no_ros_stamp_holds_is_refused_with_its_sample() {
    for origin_ns in [-1, 2_147_483_648_000_000_000] {
        let about = About { origin_ns, ..about(&[Channel::GyroX]) };
        let made = made(vec![vec![1.0]]);
        let mut sink = SampleFormat::Mcap.begin(Vec::new(), &about, false).unwrap();
        let refused = sink.rows(made.rows(41)).unwrap_err().to_string();
        assert!(refused.contains("sample 41") && refused.contains("1970 to 2038"), "{refused}");
    }
}

/// A destination that accepts only this many bytes.
struct Full(usize);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::StorageFull)?;
        Ok(bytes.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_reported_as_such_in_every_format() {
    let about = about(&[Channel::GyroX]);
    for format in SampleFormat::ALL {
        for room in [0, 40] {
            let outcome = format.begin(Full(room), &about, false).and_then(|mut sink| {
                sink.rows(made(vec![vec![1.5; 100]]).rows(0))?;
                sink.finish(&tally())
            });
            let Err(ExportError::Write(error)) = outcome else { panic!("{format:?} {room}: {outcome:?}") };
            assert_eq!(error.kind(), std::io::ErrorKind::StorageFull, "{format:?}");
        }
    }
}

#[test]
fn a_form_is_known_by_its_ending() {
    assert_eq!(SampleFormat::of_ending("PARQUET"), Some(SampleFormat::Parquet));
    assert_eq!(SampleFormat::of_ending("json"), None);
}
