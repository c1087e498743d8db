//! Recordings of ROS 2 as their readers see them, generated here with every value known.

use super::definition::layout;
use super::layout::{Encoding, MessageError};
use super::*;
use crate::recording::{ColumnMap, KeepOn, LoadedRecording, Options, Recording, columns};
use imu_core::sample::{Channel, DiscardCause};
use proptest::prelude::*;
use vn100_testkit::ros2::{Cdr, IMU_DEFINITION, Message, Topic, db3, mcap};

const START_NS: i64 = 1_729_716_663_000_000_000;
const IMU: Topic<'_> = ("/imu/data", "sensor_msgs/msg/Imu", None);
const MAG: Topic<'_> = ("/imu/mag", "sensor_msgs/msg/MagneticField", None);
const GYRO: [f64; 3] = [0.001, -0.002, 0.003];
const ACCEL: [f64; 3] = [0.1, -0.2, 9.8];

fn stamp_ns(index: usize) -> u64 {
    START_NS as u64 + 25_000_000 * index as u64
}

fn imu(index: usize) -> Vec<u8> {
    Cdr::little_endian().imu(stamp_ns(index), [GYRO[0] + index as f64, GYRO[1], GYRO[2]], ACCEL).bytes()
}

fn mag(index: usize) -> Vec<u8> {
    Cdr::little_endian().magnetic_field(stamp_ns(index), [2e-5, -1e-5, 4e-5]).bytes()
}

/// Message `index` of the topic `topic`, received a little after its stamp.
fn message(topic: usize, index: usize, data: Vec<u8>) -> Message {
    (topic, stamp_ns(index) as i64 + 1_000_000 * (index % 3) as i64, data)
}

fn load(bytes: Vec<u8>, options: Options) -> Result<LoadedRecording, RecordingError> {
    columns(&Recording::read(Input::memory("test", bytes), options)?)
}

fn column(recording: &LoadedRecording, channel: Channel) -> &[f64] {
    &recording.column(channel).unwrap().values
}

/// Returns both kinds of file with the same content.
fn both(topics: &[Topic<'_>], messages: &[Message]) -> [(&'static str, Vec<u8>); 4] {
    [
        ("db3", db3(topics, messages)),
        ("mcap, zstd", mcap(topics, messages, true, 7)),
        ("mcap, plain", mcap(topics, messages, false, 7)),
        ("mcap, one chunk", mcap(topics, messages, true, usize::MAX)),
    ]
}

#[test]
fn an_imu_topic_gives_its_values_with_and_without_a_definition_in_the_file() {
    let messages: Vec<_> = (0..40).map(|index| message(0, index, imu(index))).collect();
    for definition in [None, Some(IMU_DEFINITION)] {
        for (kind, bytes) in both(&[(IMU.0, IMU.1, definition)], &messages) {
            let loaded = load(bytes, Options::default()).unwrap();
            assert_eq!((loaded.samples, loaded.missing), (40, 0), "{kind}");
            assert_eq!(loaded.info.rate_hz, 40.0, "{kind}: the header's stamps are smooth, those of reception are not");
            assert_eq!(loaded.info.stamp_choice.as_ref().unwrap().name, "stamp in the message's header");
            assert_eq!(loaded.info.started_utc_ns, START_NS);
            let expected: Vec<f64> = (0..40).map(|index| GYRO[0] + f64::from(index)).collect();
            assert_eq!(column(&loaded, Channel::GyroX), expected);
            assert_eq!(column(&loaded, Channel::AccelZ), [9.8; 40]);
            assert_eq!(loaded.info.ignored_columns, ["orientation (a quaternion)"]);
        }
    }
}

#[test]
fn a_split_bag_is_read_as_if_it_were_one_file() {
    let of = |range: std::ops::Range<usize>| -> Vec<Message> {
        range.flat_map(|index| [message(0, index, imu(index)), message(1, index, mag(index))]).collect()
    };
    type Writer = fn(&[Message]) -> Vec<u8>;
    // The second file has its topics in another order, and so other numbers for them.
    let swapped = |messages: &[Message]| -> Vec<Message> {
        messages.iter().map(|(topic, received, data)| (1 - topic, *received, data.clone())).collect()
    };
    let forms: [(&str, Writer, Writer); 2] = [
        ("db3", |all| db3(&[IMU, MAG], all), |all| db3(&[MAG, IMU], all)),
        ("mcap", |all| mcap(&[IMU, MAG], all, true, 7), |all| mcap(&[MAG, IMU], all, true, 7)),
    ];
    for (end, one, other) in forms {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(format!("{name}.{end}"));
        // Alphabetical order is not that of the recording.
        std::fs::write(place("b"), one(&of(0..40))).unwrap();
        std::fs::write(place("a"), other(&swapped(&of(40..100)))).unwrap();
        let metadata = format!("rosbag2_bagfile_information:\n  relative_file_paths:\n    - b.{end}\n    - a.{end}\n");
        std::fs::write(folder.path().join("metadata.yaml"), metadata).unwrap();
        let loaded = columns(&Recording::open(folder.path(), Options::default()).unwrap()).unwrap();
        assert_eq!((loaded.samples, loaded.missing, loaded.info.rate_hz), (100, 0, 40.0), "{end}");
        let expected: Vec<f64> = (0..100).map(|index| GYRO[0] + f64::from(index)).collect();
        assert_eq!(column(&loaded, Channel::GyroX), expected, "{end}");
        assert_eq!(column(&loaded, Channel::MagX), [2e-5 * 1e4; 100], "{end}");
        // A file in the middle that is no bag costs itself.
        let metadata = format!("x:\n  relative_file_paths:\n    - b.{end}\n    - c.{end}\n    - a.{end}\n");
        std::fs::write(folder.path().join("metadata.yaml"), metadata).unwrap();
        std::fs::write(place("c"), "no bag").unwrap();
        let loaded = columns(&Recording::open(folder.path(), Options::default()).unwrap()).unwrap();
        assert_eq!(loaded.samples, 100, "{end}");
        assert!(loaded.info.rejected.values().sum::<u64>() >= 1, "{end}: {:?}", loaded.info.rejected);
    }
}

#[test]
fn a_bag_of_hundreds_of_files_is_read_whole() {
    const FILES: usize = 300;
    let folder = tempfile::tempdir().unwrap();
    let mut metadata = "x:\n  relative_file_paths:\n".to_owned();
    for file in 0..FILES {
        let messages: Vec<Message> = (4 * file..4 * file + 4).map(|index| message(0, index, imu(index))).collect();
        std::fs::write(folder.path().join(format!("{file}.mcap")), mcap(&[IMU], &messages, true, 7)).unwrap();
        metadata += &format!("    - {file}.mcap\n");
    }
    std::fs::write(folder.path().join("metadata.yaml"), metadata).unwrap();
    let loaded = columns(&Recording::open(folder.path(), Options::default()).unwrap()).unwrap();
    assert_eq!((loaded.samples, loaded.missing), (4 * FILES as u64, 0));
}

#[test]
fn integers_and_elements_of_arrays_are_read_by_their_paths() {
    let definition =
        "std_msgs/Header header\nint16 temperature\nuint8[3] head\nint32[3] rate\nfloat64[] force\nint64 tail";
    let data = |index: usize, long: bool| {
        // The header has 21 bytes: one more, and the number of two bytes is aligned.
        let [low, high] = (-250_i16).to_le_bytes();
        let mut cdr = Cdr::little_endian().header(stamp_ns(index)).byte(0).byte(low).byte(high).byte(1).byte(2).byte(3);
        cdr = [-7_i32, 8, index as i32].into_iter().fold(cdr, |cdr, value| cdr.number(value as u32));
        let force: &[f64] = if long { &[0.5, 9.8] } else { &[0.5] };
        cdr.number(force.len() as u32).wide(force).wide(&[f64::from_bits(-3_i64 as u64)]).bytes()
    };
    let topic = ("/raw", "own_msgs/msg/Raw", Some(definition));
    let messages: Vec<_> = (0..40).map(|index| message(0, index, data(index, index != 7))).collect();
    let read = |map: &str| {
        let input = Input::memory("test", db3(&[topic], &messages));
        let input = input.with_columns(ColumnMap::parse(&[map]).unwrap());
        Recording::read(input, Options::default()).and_then(|recording| columns(&recording))
    };
    let map =
        "temperature=temperature_c,rate[0]=gyro_x_deg_s,rate.2=gyro_z_rad_s,force[1]=accel_z_m_s2,tail=mag_x_gauss";
    let loaded = read(map).unwrap();
    assert_eq!(column(&loaded, Channel::Temperature), [-250.0; 40]);
    assert_eq!(column(&loaded, Channel::GyroX), [-7.0 * std::f64::consts::PI / 180.0; 40]);
    assert_eq!(column(&loaded, Channel::GyroZ), (0..40).map(f64::from).collect::<Vec<_>>());
    assert_eq!(column(&loaded, Channel::MagX), [-3.0; 40]);
    let force = column(&loaded, Channel::AccelZ);
    assert!(force[7].is_nan() && force[6] == 9.8 && force[8] == 9.8, "{force:?}");
    for (map, named) in [("rate[3]=gyro_x_rad_s", "rate[0] to [2]"), ("force=accel_x_g", "force[0] to […]")] {
        let error = read(map).unwrap_err().to_string();
        assert!(error.contains(named), "{map}: {error}");
    }
}

#[test]
fn big_endian_messages_are_read_too() {
    let data = |index| Cdr::big_endian().imu(stamp_ns(index), GYRO, ACCEL).bytes();
    let messages: Vec<_> = (0..40).map(|index| message(0, index, data(index))).collect();
    let loaded = load(db3(&[IMU], &messages), Options::default()).unwrap();
    assert_eq!((loaded.samples, loaded.info.rate_hz), (40, 40.0));
    assert_eq!(column(&loaded, Channel::GyroY), [-0.002; 40]);
}

#[test]
fn a_magnetic_field_under_the_same_stamps_goes_with_its_imu_message() {
    for mag_first in [true, false] {
        let mut messages = Vec::new();
        for index in 0..40 {
            let (imu, mag) = (message(0, index, imu(index)), message(1, index, mag(index)));
            messages.extend(if mag_first { [mag, imu] } else { [imu, mag] });
        }
        for (kind, bytes) in both(&[IMU, MAG], &messages) {
            let loaded = load(bytes, Options::default()).unwrap();
            assert_eq!((loaded.samples, loaded.missing), (40, 0), "{kind}");
            // Tesla become gauss, once.
            assert_eq!(column(&loaded, Channel::MagX), [2e-5 * 1e4; 40], "{kind}");
            assert_eq!(column(&loaded, Channel::GyroY), [-0.002; 40]);
            assert_eq!(loaded.info.rejected.len(), 0);
            let conversion = &loaded.info.conversions[0];
            assert_eq!((conversion.column.as_str(), conversion.original_unit), ("/imu/mag", "T"));
        }
    }
}

#[test]
fn a_field_that_lacks_messages_or_has_too_many_is_joined_where_it_belongs() {
    let mut messages = Vec::new();
    for index in 0..200 {
        messages.push(message(0, index, imu(index)));
        // Every tenth is missing; one has a separate stamp.
        if index % 10 != 0 {
            messages.push(message(1, index, mag(index)));
        }
        if index == 100 {
            messages.push(message(1, 100_000, mag(100_000)));
        }
    }
    let loaded = load(db3(&[IMU, MAG], &messages), Options::default()).unwrap();
    assert_eq!(loaded.samples, 200);
    let with_field = column(&loaded, Channel::MagX).iter().filter(|value| value.is_finite());
    assert_eq!(with_field.count(), 180);
    assert_eq!(loaded.info.rejected[&DiscardCause::UnexpectedFormat], 1);
    assert!(loaded.info.first_rejected[0].text.contains("/imu/mag whose stamp no message of /imu/data has"));
}

#[test]
fn a_field_under_stamps_of_its_own_is_named_and_left_alone() {
    let mut messages = Vec::new();
    for index in 0..100 {
        messages.push(message(0, index, imu(index)));
        messages.push((
            1,
            stamp_ns(index) as i64,
            Cdr::little_endian().magnetic_field(stamp_ns(index) + 7, [1e-5; 3]).bytes(),
        ));
    }
    let loaded = load(db3(&[IMU, MAG], &messages), Options::default()).unwrap();
    assert_eq!((loaded.samples, loaded.info.channels.contains(Channel::MagX)), (100, false));
    assert!(loaded.info.ignored_columns[0].starts_with("topic /imu/mag"), "{:?}", loaded.info.ignored_columns);
}

/// Returns a driver's own message, as in the real recordings of the VN-100.
fn driver(index: usize, raw: &str) -> Vec<u8> {
    Cdr::little_endian()
        .header(stamp_ns(index))
        .imu(0, [1.0; 3], [2.0; 3])
        .magnetic_field(0, [3.0; 3])
        .text(raw)
        .bytes()
}

fn raw_line(value: f64) -> String {
    let body = format!(
        "VNYMR,-134.051,-000.443,-000.892,-00.1575,+00.1599,+00.3040,-00.077,+00.164,-09.965,{value:+010.6},+00.001325,+00.000043"
    );
    format!("${body}*{:02X}\r\n", body.bytes().fold(0, |sum, byte| sum ^ byte))
}

#[test]
fn the_raw_line_wins_and_its_checksum_decides() {
    let topic: Topic<'_> = ("/imu", "imu_msg/msg/IMUmsg", None);
    let messages: Vec<_> = (0..40)
        .map(|index| {
            let mut raw = raw_line(1e-3 * index as f64);
            if index == 20 {
                raw = raw.replace("-09.965", "-30945");
            }
            message(0, index, driver(index, &raw))
        })
        .collect();
    for (kind, bytes) in both(&[topic], &messages) {
        let loaded = load(bytes, Options::default()).unwrap();
        assert_eq!((loaded.samples, loaded.missing), (39, 1), "{kind}");
        assert_eq!(loaded.info.rejected[&DiscardCause::Checksum], 1);
        assert_eq!(loaded.info.first_rejected[0].line, 21);
        assert!(loaded.info.first_rejected[0].text.contains("-30945"));
        assert_eq!(column(&loaded, Channel::AccelX), [-0.077; 39]);
    }
}

#[test]
fn a_type_that_is_not_known_can_be_given() {
    let data = |index: usize| {
        let head = Cdr::little_endian().byte(7).text("x").header(stamp_ns(index)).byte(1);
        head.wide(&[index as f64]).number(0.5_f32.to_bits()).bytes()
    };
    let topic: Topic<'_> = ("/own", "own_msgs/msg/Reading", None);
    let messages: Vec<_> = (0..40).map(|index| message(0, index, data(index))).collect();
    let bytes = db3(&[topic], &messages);
    let error = load(bytes.clone(), Options::default()).unwrap_err().to_string();
    assert!(error.contains("/own") && error.contains("--message-definition"), "{error}");
    let text = "uint8 LIMIT=3\nuint8 kind 7\nstring<=10 name \"a b\"\nstd_msgs/Header header\nbool on\nfloat64 gyro_x_deg_s\nfloat32 temperature_c";
    let definitions = vec![MessageDefinition::new("own_msgs/msg/Reading", text).unwrap()];
    let loaded = load(bytes, Options { definitions, ..Options::default() }).unwrap();
    assert_eq!((loaded.samples, loaded.info.rate_hz), (40, 40.0));
    assert_eq!(column(&loaded, Channel::GyroX)[2], 2.0_f64.to_radians());
    assert_eq!(column(&loaded, Channel::Temperature), [0.5; 40]);
    assert_eq!(loaded.info.conversions[0].original_unit, "deg/s");
}

#[test]
fn a_file_that_was_cut_is_read_as_far_as_it_goes() {
    let messages: Vec<_> = (0..400).map(|index| message(0, index, imu(index))).collect();
    let whole = mcap(&[(IMU.0, IMU.1, Some(IMU_DEFINITION))], &messages, true, 50);
    let cut = load(whole[..whole.len() / 2].to_vec(), Options::default()).unwrap();
    assert!((50..350).contains(&cut.samples) && cut.samples.is_multiple_of(50), "{}", cut.samples);
    assert_eq!(cut.info.rejected[&DiscardCause::Malformed], 1, "the end is reported");
    // A damaged chunk costs only itself.
    let chunk = whole.windows(4).position(|window| window == [0x28, 0xB5, 0x2F, 0xFD]).unwrap();
    let mut damaged = whole;
    damaged[chunk + 40] ^= 0xFF;
    let damaged = load(damaged, Options::default()).unwrap();
    assert_eq!(damaged.samples, 350);
    let text = &damaged.info.first_rejected[0].text;
    assert!(text.contains("chunk") && text.contains("at byte"), "{text}");
}

/// Two pages of rows (kind 13) change places.
#[test]
fn a_database_whose_rows_are_out_of_order_ends() {
    let messages: Vec<_> = (0..200).map(|index| message(0, index, imu(index))).collect();
    let mut bytes = db3(&[IMU], &messages);
    let page_bytes = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
    let leaves: Vec<usize> = (1..bytes.len() / page_bytes)
        .map(|page| page * page_bytes)
        .filter(|at| bytes[*at] == 13 && bytes[at + 3..at + 5] != [0, 1])
        .collect();
    let (first, last) = (leaves[leaves.len() / 2], *leaves.last().unwrap());
    let (before, behind) = bytes.split_at_mut(last);
    before[first..first + page_bytes].swap_with_slice(&mut behind[..page_bytes]);
    let recording = load(bytes, Options::default()).unwrap();
    let rejected = &recording.info.first_rejected;
    assert!(recording.info.samples > 50, "{}", recording.info.samples);
    assert!(rejected.iter().any(|rejected| rejected.text.contains("out of order")), "{rejected:?}");
}

/// Returns the leaves (kind 13) of the table of messages, from the first on.
fn leaves(bytes: &[u8]) -> (usize, Vec<usize>) {
    let page_bytes = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
    let pages = (1..bytes.len() / page_bytes).map(|page| page * page_bytes);
    (page_bytes, pages.filter(|at| bytes[*at] == 13 && bytes[at + 3..at + 5] > [0, 3][..]).collect())
}

#[test]
fn a_hole_in_a_database_costs_its_own_rows_and_is_reported() {
    let messages: Vec<_> = (0..2000).map(|index| message(0, index, imu(index))).collect();
    let bytes = db3(&[IMU], &messages);
    let (page_bytes, leaves) = leaves(&bytes);
    let whole = |holes: &[usize]| {
        let mut bytes = bytes.clone();
        for leaf in holes {
            bytes[*leaf..leaf + page_bytes].fill(0);
        }
        load(bytes, Options::default()).unwrap()
    };
    let middle = leaves.len() / 2;
    for holes in [&leaves[middle..=middle], &leaves[middle..middle + 3], &leaves[..1], &[leaves[5], leaves[50]]] {
        let loaded = whole(holes);
        let (rows, samples) = (loaded.column(Channel::GyroX).unwrap(), loaded.info.samples);
        assert!(samples >= 2000 - 12 * holes.len() as u64 && samples < 2000, "{samples}");
        assert_eq!(*rows.values.last().unwrap(), GYRO[0] + 1999.0);
        let texts: Vec<_> = loaded.info.first_rejected.iter().map(|rejected| rejected.text.as_str()).collect();
        assert!(!texts.is_empty() && texts.iter().all(|text| text.contains("passed over")), "{texts:?}");
    }
    let loaded = whole(&leaves[middle..]);
    assert!((900..1100).contains(&loaded.info.samples), "{}", loaded.info.samples);
    assert!(loaded.info.first_rejected[0].text.contains("was not read"), "{:?}", loaded.info.first_rejected);
}

/// The row's bytes lie beyond the page, in memory that differs from one reading to the next.
#[test]
fn a_damaged_page_is_the_same_at_every_reading() {
    let messages: Vec<_> = (0..2000).map(|index| message(0, index, imu(index))).collect();
    let mut bytes = db3(&[IMU], &messages);
    let (_, leaves) = leaves(&bytes);
    for leaf in [leaves[5], leaves[50]] {
        bytes[leaf + 8 + 2 * 5..leaf + 8 + 2 * 6].fill(0xFF);
    }
    let readings: Vec<_> = (0..200)
        .map(|_| {
            let info = load(bytes.clone(), Options::default()).unwrap().info;
            let texts: Vec<_> = info.first_rejected.iter().map(|rejected| rejected.text.clone()).collect();
            (info.samples, texts)
        })
        .collect();
    assert!(readings.iter().all(|reading| *reading == readings[0]), "{:?}", readings);
    assert!((1976..2000).contains(&readings[0].0) && readings[0].1.len() == 2, "{:?}", readings[0]);
}

#[test]
fn a_database_that_was_cut_off_is_reported_with_what_may_save_it() {
    let messages: Vec<_> = (0..200).map(|index| message(0, index, imu(index))).collect();
    let bytes = db3(&[IMU], &messages);
    let report = match load(bytes[..bytes.len() / 2].to_vec(), Options::default()) {
        Err(error) => error.to_string(),
        Ok(loaded) => loaded.info.first_rejected[0].text.clone(),
    };
    assert!(report.contains(".recover"), "{report}");
}

#[test]
fn topics_of_other_things_take_no_place_and_those_not_looked_at_are_counted() {
    let names: Vec<String> = (0..400).map(|index| format!("/camera{index}")).collect();
    let mut topics: Vec<Topic<'_>> = names.iter().map(|name| (name.as_str(), "std_msgs/msg/Header", None)).collect();
    topics.extend([IMU, MAG]);
    let pair = |index| [message(400, index, imu(index)), message(401, index, mag(index))];
    let messages: Vec<_> = (0..40).flat_map(pair).collect();
    let loaded = load(db3(&topics, &messages), Options::default()).unwrap();
    assert_eq!(loaded.samples, 40);
    assert!(loaded.info.channels.contains(Channel::MagX), "the field goes with the samples, however many came first");
    let ignored = &loaded.info.ignored_columns;
    assert!(ignored.iter().any(|entry| entry.contains("144 more connections")), "{ignored:?}");
    // Topics that have only text might hold raw lines: only so many of them are examined that there is room for others.
    let mut topics: Vec<Topic<'_>> =
        names[..300].iter().map(|name| (name.as_str(), "std_msgs/msg/String", None)).collect();
    topics.push(IMU);
    let messages: Vec<_> = (0..40).map(|index| message(300, index, imu(index))).collect();
    let loaded = load(db3(&topics, &messages), Options::default()).unwrap();
    assert_eq!(loaded.samples, 40);
    let ignored = &loaded.info.ignored_columns;
    assert!(ignored.iter().any(|entry| entry.contains("108 more connections")), "{ignored:?}");
}

#[test]
fn databases_that_are_no_bag_and_bags_without_an_imu_are_refused_with_what_they_hold() {
    let database = rusqlite::Connection::open_in_memory().unwrap();
    database.execute_batch("CREATE TABLE addresses (name TEXT)").unwrap();
    let bytes = database.serialize(rusqlite::MAIN_DB).unwrap().to_vec();
    let error = load(bytes, Options::default()).unwrap_err().to_string();
    assert!(error.contains("with the tables addresses") && error.contains("ROS 2 bag"), "{error}");
    let error = load(b"SQLite format 3\0 and nothing".to_vec(), Options::default()).unwrap_err().to_string();
    assert!(error.contains("cannot be read"), "{error}");
    let camera: Topic<'_> = ("/camera", "std_msgs/msg/Header", None);
    for (kind, bytes) in both(&[camera], &[message(0, 0, Cdr::little_endian().header(1).bytes())]) {
        let error = load(bytes, Options::default()).unwrap_err().to_string();
        assert!(error.contains("/camera (std_msgs/msg/Header, no IMU data)"), "{kind}: {error}");
    }
    for (kind, bytes) in both(&[], &[]) {
        let error = load(bytes, Options::default()).unwrap_err().to_string();
        assert!(error.contains("no topics"), "{kind}: {error}");
    }
}

#[test]
fn a_bag_on_disk_is_read_whatever_its_path_and_beside_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a?b#c%41 ü.db3");
    let messages: Vec<_> = (0..40).map(|index| message(0, index, imu(index))).collect();
    std::fs::write(&path, db3(&[IMU], &messages)).unwrap();
    assert_eq!(Recording::open(&path, Options::default()).unwrap().info().samples, 40);
    // A recorder that was killed leaves its last data in the log.
    let database = rusqlite::Connection::open(&path).unwrap();
    database.pragma_update(None, "journal_mode", "wal").unwrap();
    database
        .execute("INSERT INTO messages VALUES (NULL, 1, ?1, ?2)", rusqlite::params![stamp_ns(40) as i64, imu(40)])
        .unwrap();
    assert_eq!(Recording::open(&path, Options::default()).unwrap().info().samples, 41);
}

#[test]
fn a_reading_that_is_called_off_ends() {
    let messages: Vec<_> = (0..40).map(|index| message(0, index, imu(index))).collect();
    for (kind, bytes) in both(&[IMU], &messages) {
        let input = Input::memory("test", bytes).while_wanted(KeepOn::asking(|| false));
        let error = Recording::read(input, Options::default()).unwrap_err();
        assert!(matches!(error, RecordingError::Unwanted { .. }), "{kind}: {error}");
    }
}

#[test]
fn a_message_that_is_too_short_or_too_long_is_rejected_with_its_place() {
    let mut messages: Vec<_> = (0..40).map(|index| message(0, index, imu(index))).collect();
    messages[10].2.truncate(100);
    messages[20].2.extend([0; 8]);
    messages[30].2.extend([0; 7]);
    for (kind, bytes) in both(&[IMU], &messages) {
        let loaded = load(bytes, Options::default()).unwrap();
        assert_eq!((loaded.samples, loaded.missing), (38, 2), "{kind}");
        let lines: Vec<u64> = loaded.info.first_rejected.iter().map(|rejected| rejected.line).collect();
        assert_eq!(lines, [11, 21], "{kind}");
    }
}

#[test]
fn definitions_are_bounded() {
    let of = |text: &str| layout("own/T", text, Encoding::Cdr, &[], &ColumnMap::default());
    assert_eq!(of("own/T t\n"), Err(MessageError::TooMuch));
    assert_eq!(of("float64 x\nwstring y\n"), Err(MessageError::Type("wstring".to_owned())));
    assert!(matches!(of("float64\n"), Err(MessageError::Line(_))));
    // In ROS 1 nothing may follow a name.
    assert!(matches!(
        layout("own/T", "float64 x 3\n", Encoding::Ros1, &[], &ColumnMap::default()),
        Err(MessageError::Line(_))
    ));
    let bounded = of("float64[<=3] a\nuint8[4] b\nown/U[2] c\n===\nMSG: own/msg/U\nint8 a\nint32 b\n").unwrap();
    // 2 numbers, 4 bytes, then each of the pairs a byte and an aligned number.
    let cdr = Cdr::little_endian().number(2).wide(&[1.0, 2.0]).byte(0).byte(0).byte(0).byte(0);
    let bytes = cdr.byte(1).number(5).byte(1).number(6).bytes();
    bounded.read(&bytes).unwrap();
    assert_eq!(bounded.read(&bytes[..bytes.len() - 1]), Err(MessageError::Short));
}

proptest! {
    /// The position of each value follows from the preceding fields, whatever they are.
    #[test]
    fn a_value_is_found_behind_any_fields(fields in prop::collection::vec(0_usize..6, 0..12), value in -1e3..1e3_f64) {
        let (mut text, mut cdr) = (String::new(), Cdr::little_endian());
        for (index, field) in fields.iter().enumerate() {
            let (kind, next) = match field {
                0 => ("uint8", cdr.byte(1)),
                1 => ("float32", cdr.number(2)),
                2 => ("float64", cdr.wide(&[3.0])),
                3 => ("string", cdr.text("some text")),
                4 => ("int32[]", cdr.number(2).number(8).number(9)),
                _ => ("float64[]", cdr.number(0)),
            };
            cdr = next;
            text.push_str(&format!("{kind} f{index}\n"));
        }
        text.push_str("float64 gyro_z_rad_s\n");
        let layout = layout("own/T", &text, Encoding::Cdr, &[], &ColumnMap::default()).unwrap();
        let bytes = cdr.wide(&[value]).bytes();
        prop_assert_eq!(layout.read(&bytes).unwrap().channels[Channel::GyroZ as usize], Some(value));
    }
}
