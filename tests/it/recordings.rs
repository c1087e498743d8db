//! Recordings from other sources: bags whose every value is known, damaged ones, and real ones.

use crate::world::{World, vn100d};
use imu_core::sample::{Channel, DiscardCause, GapCause};
use imu_files::recording::{
    Input, Kind, LoadedRecording, Options, Recording, RecordingError, Stamps, columns, load_columns,
};
use std::collections::BTreeMap;
use std::path::Path;
use vn100_testkit::bag;
use vn100_testkit::real_data;

const MARCH_2024_NS: u64 = 1_710_358_267_000_000_000;
const PERIOD_NS: u64 = 25_000_000;
const ACCEL: [f64; 3] = [-0.077, 0.164, -9.965];

fn load(bytes: Vec<u8>) -> Result<LoadedRecording, RecordingError> {
    columns(&Recording::read(Input::memory("test.bag", bytes), Options::default())?)
}

fn values(recording: &LoadedRecording, channel: Channel) -> &[f64] {
    &recording.column(channel).unwrap().values
}

fn stamp_ns(index: u64) -> u64 {
    MARCH_2024_NS + index * PERIOD_NS
}

/// Returns records of a driver's topic: in the raw line gyro x is index µrad/s, in the message's own numbers it is 1
/// rad/s.
fn driver_records(range: std::ops::Range<u64>) -> Vec<u8> {
    let mut records = bag::connection(3, "/imu", bag::DRIVER);
    for index in range {
        let raw = bag::raw_line([1e-6 * index as f64, 0.0, 0.0], ACCEL);
        let data = bag::driver(stamp_ns(index), &raw, [1.0; 3], [2.0; 3], [3.0; 3]);
        // The messages are received in pairs: two at once, then none.
        records.extend(bag::message(3, stamp_ns(index / 2 * 2) + 90_000 * (index % 2) + 40_000_000, &data));
    }
    records
}

#[test]
fn a_bag_gives_the_same_samples_in_every_compression() {
    for compression in ["none", "bz2", "lz4"] {
        let chunks = [0..40, 40..100].map(|range| bag::chunk(compression, &driver_records(range)));
        let loaded = load(bag::bag(&chunks)).unwrap();
        assert_eq!((loaded.info.kind, loaded.info.stamps), (Kind::Bag, Stamps::Unix), "{compression}");
        assert_eq!((loaded.samples, loaded.missing, loaded.info.rate_hz), (100, 0, 40.0), "{compression}");
        let expected: Vec<f64> =
            (0..100).map(|index| format!("{:.6}", 1e-6 * f64::from(index)).parse().unwrap()).collect();
        assert_eq!(values(&loaded, Channel::GyroX), expected, "{compression}: the raw line wins");
        assert_eq!(values(&loaded, Channel::MagZ)[7], 0.3040, "in gauss, as the sensor wrote it");
        assert!(loaded.info.rejected.is_empty() && loaded.info.conversions.is_empty());
    }
}

#[test]
fn stamps_of_a_bag_are_those_of_the_header_where_reception_came_in_pairs() {
    let loaded = load(bag::bag(&[bag::chunk("none", &driver_records(0..100))])).unwrap();
    let choice = loaded.info.stamp_choice.as_ref().unwrap();
    assert_eq!((choice.name.as_str(), choice.column, choice.regular[1]), ("stamp in the message's header", 2, 1.0));
    assert!(choice.regular[0] < 0.6, "{choice:?}");
    assert_eq!(loaded.info.started_utc_ns, MARCH_2024_NS as i64);
    let remarks = loaded.info.remarks().join("\n");
    assert!(remarks.contains("stamp in the message's header"), "{remarks}");
}

#[test]
fn a_raw_line_in_a_bag_that_fails_its_checksum_is_no_sample_whatever_the_numbers_beside_it_are() {
    let mut records = driver_records(0..10);
    let spliced = "$VNYMR,+006.074,+002.094,+001.874,-00030945,-000.183267*60";
    records.extend(bag::message(
        3,
        stamp_ns(10),
        &bag::driver(stamp_ns(10), spliced, [-30945.0; 3], [0.0; 3], [0.0; 3]),
    ));
    records.extend(driver_records(11..20));
    let loaded = load(bag::bag(&[bag::chunk("none", &records)])).unwrap();
    assert_eq!((loaded.samples, loaded.missing, loaded.gaps.len()), (19, 1, 1));
    assert_eq!((loaded.gaps[0].cause, loaded.gaps[0].before_seq), (GapCause::Checksum, 10));
    assert_eq!(loaded.info.rejected, BTreeMap::from([(DiscardCause::Checksum, 1)]));
    let rejected = &loaded.info.first_rejected[0];
    assert_eq!((rejected.line, rejected.text.as_str()), (11, spliced));
}

#[test]
fn without_a_raw_line_the_numbers_count_and_tesla_become_gauss() {
    let mut records = bag::connection(0, "/imu", bag::DRIVER);
    for index in 0..20 {
        let data = bag::driver(stamp_ns(index), "", [0.5, 1e-3, -2.0], [1.0, 2.0, 9.5], [4e-5, -2e-5, 1e-5]);
        records.extend(bag::message(0, stamp_ns(index), &data));
    }
    let loaded = load(bag::bag(&[bag::chunk("none", &records)])).unwrap();
    assert_eq!(loaded.samples, 20);
    assert_eq!(values(&loaded, Channel::GyroY)[0], 1e-3);
    assert_eq!(values(&loaded, Channel::AccelZ)[0], 9.5);
    assert!((values(&loaded, Channel::MagX)[0] - 0.4).abs() < 1e-15);
    let units: Vec<_> = loaded.info.conversions.iter().map(|found| (found.original_unit, found.factor)).collect();
    assert_eq!(units, [("T", 1e4); 3]);
    assert_eq!(loaded.info.ignored_columns, ["orientation (a quaternion)"]);
    assert_eq!(loaded.info.findings.repeated_samples, 19, "frozen values are told");
}

#[test]
fn a_field_that_was_in_gauss_already_is_remarked() {
    let mut records = bag::connection(0, "/imu", bag::DRIVER);
    for index in 0..5 {
        let data = bag::driver(stamp_ns(index), "", [0.5; 3], [1.0; 3], [0.4, -0.2, 0.1]);
        records.extend(bag::message(0, stamp_ns(index), &data));
    }
    let loaded = load(bag::bag(&[bag::chunk("none", &records)])).unwrap();
    assert!(loaded.info.remarks().iter().any(|remark| remark.contains("was it in gauss already?")));
}

#[test]
fn of_several_topics_the_one_with_raw_lines_is_read_and_the_others_are_named() {
    let mut records = bag::connection(1, "/other", bag::IMU);
    records.extend(bag::connection(2, "/raw", bag::TEXT));
    records.extend(bag::connection(9, "/gps", ("x/Gps", "float64 latitude\n")));
    for index in 0..10 {
        records.extend(bag::message(1, stamp_ns(index), &bag::imu(stamp_ns(index), [1.0; 3], [2.0; 3])));
        records.extend(bag::message(2, stamp_ns(index) + 5, &bag::string(&bag::raw_line([0.25; 3], ACCEL))));
        records.extend(bag::message(9, stamp_ns(index), &[0; 8]));
    }
    let loaded = load(bag::bag(&[bag::chunk("none", &records)])).unwrap();
    assert_eq!(values(&loaded, Channel::GyroX), [0.25; 10]);
    assert_eq!(loaded.info.started_utc_ns, MARCH_2024_NS as i64 + 5, "a text has no header: reception counts");
    let others = loaded.info.ignored_columns.join("\n");
    assert!(others.contains("topic /other (sensor_msgs/Imu, 10 messages)") && others.contains("/gps"), "{others}");
}

#[test]
fn a_bag_without_imu_data_is_refused_with_what_it_has() {
    let mut records = bag::connection(9, "/gps", ("x/Gps", "float64 latitude\n"));
    records.extend(bag::message(9, MARCH_2024_NS, &[0; 8]));
    let error = load(bag::bag(&[bag::chunk("none", &records)])).unwrap_err().to_string();
    assert!(error.contains("/gps (x/Gps, no IMU data)"), "{error}");
    let error = load(bag::bag(&[])).unwrap_err().to_string();
    assert!(error.contains("no topics"), "{error}");
}

#[test]
fn a_definition_that_contains_itself_or_grows_without_end_is_refused() {
    let mut doubling = "T0/T a\nT0/T b\n".to_owned();
    for level in 0..40 {
        doubling += &format!("===\nMSG: T{level}/T\nT{}/T a\nT{}/T b\n", level + 1, level + 1);
    }
    doubling += "===\nMSG: T40/T\nfloat64 x\n";
    for definition in ["x/Self again\n===\nMSG: x/Self\nx/Self again\n", &doubling, "float64 a b\n", "x/Absent a\n"] {
        let mut records = bag::connection(0, "/imu", ("x/Root", definition));
        records.extend(bag::message(0, MARCH_2024_NS, &[0; 64]));
        let error = load(bag::bag(&[bag::chunk("none", &records)])).unwrap_err().to_string();
        assert!(error.contains("not read: ") && error.contains("definition"), "{error}");
    }
}

#[test]
fn arrays_that_claim_more_than_there_is_are_one_bad_message_each() {
    let kind = (
        "x/Imu",
        "string[] names\nx/Empty[4000000000] nothing\nx/Empty[] more\nsensor_msgs/Imu imu\n===\nMSG: x/Empty\n",
    );
    let definition = format!("{}===\nMSG: sensor_msgs/Imu\n{}", kind.1, bag::IMU.1);
    let mut records = bag::connection(0, "/imu", (kind.0, &definition));
    for (index, count) in [0_u32, u32::MAX, 200_000, 0, 0, 0, 0].into_iter().enumerate() {
        let mut data = count.to_le_bytes().to_vec();
        if count == 200_000 {
            data.extend(vec![0; 4 * 200_000]);
        }
        data.extend(u32::MAX.to_le_bytes());
        data.extend(bag::imu(stamp_ns(index as u64), [1.0; 3], [2.0; 3]));
        records.extend(bag::message(0, stamp_ns(index as u64), &data));
    }
    let loaded = load(bag::bag(&[bag::chunk("none", &records)])).unwrap();
    assert_eq!((loaded.samples, loaded.info.rejected[&DiscardCause::Malformed]), (5, 2));
    assert_eq!(loaded.missing, 2);
}

#[test]
fn a_bag_that_was_cut_is_read_as_far_as_it_goes_and_the_cut_is_reported() {
    let chunks = [0..50, 50..100].map(|range| bag::chunk("none", &driver_records(range)));
    let whole = bag::bag(&chunks);
    let first_chunk = whole.len() - chunks[1].len();
    let loaded = load(whole[..first_chunk + 2000].to_vec()).unwrap();
    assert!((50..55).contains(&loaded.samples), "{}", loaded.samples);
    assert_eq!(loaded.info.rejected, BTreeMap::from([(DiscardCause::Malformed, 1)]));
    let text = &loaded.info.first_rejected[0].text;
    assert!(text.starts_with("at byte ") && text.contains("are there"), "{text}");
}

#[test]
fn a_damaged_chunk_costs_itself_alone() {
    for compression in ["bz2", "lz4"] {
        let mut chunks = [0..50, 50..100, 100..150].map(|range| bag::chunk(compression, &driver_records(range)));
        let middle = chunks[1].len() / 2;
        for byte in &mut chunks[1][middle..middle + 20] {
            *byte ^= 0x55;
        }
        let loaded = load(bag::bag(&chunks)).unwrap();
        assert!((100..150).contains(&loaded.samples), "{compression}: {}", loaded.samples);
        assert!(loaded.info.rejected[&DiscardCause::Malformed] >= 1, "{compression}");
        assert_eq!(*values(&loaded, Channel::GyroX).last().unwrap(), 149e-6, "{compression}");
    }
}

#[test]
fn a_length_that_lies_is_no_reason_to_take_memory() {
    let good = bag::chunk("none", &driver_records(0..20));
    for lie in [
        // a header, data, a chunk, a record in a chunk
        vec![0xFF; 16],
        [&bag::record(&[("op", &[7])], &[])[..8], &[7, 0xFF, 0xFF, 0xFF, 0xFF]].concat(),
        bag::record(&[("op", &[5]), ("compression", b"bz2"), ("size", &[0xFF; 4])], &[1, 2, 3]),
        bag::record(&[("op", &[5]), ("compression", b"zip"), ("size", &[1, 0, 0, 0])], &[1]),
        bag::chunk("none", &[0xFF, 0xFF, 0xFF, 0x7F, 1, 2, 3]),
    ] {
        let mut bytes = bag::bag(std::slice::from_ref(&good));
        bytes.extend(&lie);
        let loaded = load(bytes).unwrap();
        assert_eq!((loaded.samples, loaded.info.rejected[&DiscardCause::Malformed]), (20, 1), "{lie:?}");
    }
}

#[test]
fn the_smoother_of_two_stamps_counts_wherever_it_stands_and_a_line_number_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("raw.txt");
    let smooth = |index: u64| format!("{:.6}", 1_710_358_267.0 + 0.025 * index as f64);
    let rough =
        |index: u64| format!("{:.6}", 1_710_358_267.04 + 0.05 * (index / 2) as f64 + 0.001 * (index % 2) as f64);
    let number = |index: u64| index.to_string();
    type Stamp<'a> = &'a dyn Fn(u64) -> String;
    for (stamps, column) in
        [([&smooth as Stamp<'_>, &rough], 1), ([&rough, &smooth], 2), ([&smooth, &smooth], 2), ([&number, &smooth], 2)]
    {
        let line = |index| format!("{}\t{}\t{}\n", stamps[0](index), stamps[1](index), bag::raw_line([0.1; 3], ACCEL));
        // The first line is cut: the rest of its stamps must neither affect the others nor make a gap.
        let content: String = std::iter::once(line(0)[10..].to_owned()).chain((1..200).map(line)).collect();
        std::fs::write(&file, content).unwrap();
        let loaded = load_columns(&file, Options::default()).unwrap();
        assert_eq!(loaded.info.stamp_choice.as_ref().unwrap().column, column);
        assert!((loaded.info.rate_hz - 40.0).abs() < 1e-3, "{}", loaded.info.rate_hz);
        assert!(loaded.samples >= 199);
        assert!(loaded.gaps.iter().all(|gap| gap.missing < 3), "{:?}", loaded.gaps.first());
    }
}

#[test]
fn thousands_of_segments_are_imported_shown_and_exact() {
    let world = World::new();
    let file = world.path("holes.txt");
    // Every third line is missing: 10,000 gaps.
    let content: String = (0..30_000)
        .filter(|index| index % 3 != 2)
        .map(|index| {
            format!("{:.3} {}\n", 0.025 * f64::from(index), bag::raw_line([1e-6 * f64::from(index); 3], ACCEL))
        })
        .collect();
    std::fs::write(&file, content).unwrap();
    let data = world.path("data");
    let import = vn100d(&["--data-dir", data.to_str().unwrap(), "import", file.to_str().unwrap()]);
    assert_eq!(import.status.code(), Some(0), "{}", String::from_utf8_lossy(&import.stderr));
    let counts = world.query("SELECT samples, missing, gaps, segments FROM capture");
    assert_eq!(counts, [[20_000, 9_999, 9_999, 10_000].map(rusqlite::types::Value::Integer)]);
    let in_segments = world.query("SELECT sum(samples), count(*) FROM segment");
    assert_eq!(in_segments, [[20_000, 10_000].map(rusqlite::types::Value::Integer)]);
    let show = vn100d(&["--data-dir", data.to_str().unwrap(), "show", "latest"]);
    let text = String::from_utf8_lossy(&show.stdout).into_owned();
    assert!(text.contains("9999 gaps by source: 9999 missing"), "{text}");
}

/// Returns the raw text of the cart: driver stamps in ns and whether each line passes its checksum, read here without
/// the program.
fn cart_lines(file: &Path) -> Vec<(i64, bool)> {
    let mut text = String::new();
    let packed = std::fs::File::open(file).unwrap();
    std::io::Read::read_to_string(&mut flate2::read::GzDecoder::new(packed), &mut text).unwrap();
    let line = |line: &str| {
        let mut parts = line.split('\t').skip(1);
        let (seconds, nanos) = parts.next().unwrap().split_once('.').unwrap();
        let stamp_ns = seconds.parse::<i64>().unwrap() * 1_000_000_000 + nanos.parse::<i64>().unwrap();
        let (body, sum) = parts.next().unwrap().trim().trim_start_matches('$').split_once('*').unwrap();
        let good = body.bytes().fold(0_u8, |sum, byte| sum ^ byte) == u8::from_str_radix(sum, 16).unwrap();
        (stamp_ns, good)
    };
    text.lines().map(line).collect()
}

#[test]
fn the_real_cart_is_imported_with_every_irregular_step_accounted_for() {
    let Some(file) = real_data("vn100-cart/circle_carter.imu.raw.txt.gz") else { return };
    let lines = cart_lines(&file);
    let mut steps: Vec<i64> = lines.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let in_order = steps.clone();
    steps.sort_unstable();
    let median_ns = steps[steps.len() / 2] as f64;
    assert_eq!(steps.len() % 2, 1);
    let over = in_order.iter().filter(|step| **step as f64 > 1.5 * median_ns).count();
    let bad = lines.iter().filter(|(_, good)| !good).count() as i64;
    assert_eq!((lines.len(), over, bad), (3_880, 1_411, 5));

    let world = World::new();
    let data = world.path("data");
    let run = |arguments: &[&str]| {
        let output = vn100d(&[&["--data-dir", data.to_str().unwrap()], arguments].concat());
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (code, printed) = run(&["import", file.to_str().unwrap()]);
    assert_eq!(code, Some(3), "data were rejected: {printed}");
    for words in ["rejected: 5 (checksum)", "number 2 of 2 before $VN", "line 3015"] {
        assert!(printed.contains(words), "{words} is not in: {printed}");
    }
    let one = |sql: &str| match world.query(sql)[0][0] {
        rusqlite::types::Value::Integer(value) => value,
        ref other => panic!("{sql}: {other:?}"),
    };
    assert_eq!(one("SELECT count(*) FROM sample"), 3_875);
    assert_eq!(one("SELECT samples FROM capture"), 3_875);
    // The identity, from the stamps alone: received and missing samples fill the time from the first stamp to the last.
    let (_, shown) = run(&["show", "latest", "--json"]);
    let shown: serde_json::Value = serde_json::from_str(&shown).unwrap();
    let good: Vec<i64> = lines.iter().filter(|(_, good)| *good).map(|(stamp_ns, _)| *stamp_ns).collect();
    let span_s = 1e-9 * (good[good.len() - 1] - good[0]) as f64;
    let periods = span_s * shown["rate_hz"].as_f64().unwrap() + 1.0;
    assert!((one("SELECT samples + missing FROM capture") as f64 - periods).abs() < 2.0, "{periods}");
    assert_eq!(one("SELECT sum(missing) FROM gap"), one("SELECT missing FROM capture"));
    // Many of the long steps are compensated by the next ones: nothing is missing there.
    assert!((900..1_411).contains(&one("SELECT count(*) FROM gap WHERE cause = 'source'")));
    assert_eq!(one("SELECT sum(missing) FROM gap WHERE cause = 'checksum'"), bad);
    // The longest step is of 1.298 s; a gap reaches over half a period to both sides.
    assert!((one("SELECT max(to_utc_ns - from_utc_ns) FROM gap") - 1_298_000_000).abs() < 30_000_000);
    assert_eq!(one("SELECT count FROM rejected WHERE cause = 'checksum'"), bad);
    assert_eq!(
        one("SELECT samples + (SELECT sum(count) FROM rejected) FROM capture"),
        lines.len() as i64,
        "every line"
    );
    assert_eq!(one("SELECT sum(samples) FROM segment"), 3_875);
    assert_eq!(one("SELECT count(*) FROM sample WHERE abs(gyro_x) > 35 OR abs(gyro_y) > 35 OR abs(gyro_z) > 35"), 0);
    let numbers = "SELECT group_concat(json_extract(detail, '$.line')) FROM event WHERE kind = 'rejected'";
    assert_eq!(world.query(numbers)[0][0], rusqlite::types::Value::Text("820,1611,2863,3015,3165".to_owned()));
    let longest = "SELECT max(length(json_extract(detail, '$.text'))) FROM event WHERE kind = 'rejected'";
    assert!((100..=256).contains(&one(longest)));
    // Every sample has the time of its line's stamp.
    let stamps: Vec<i64> = lines.iter().filter(|(_, good)| *good).map(|(stamp_ns, _)| *stamp_ns).collect();
    let stored = world.query("SELECT host_utc_ns FROM sample ORDER BY seq");
    assert!(stored.iter().zip(&stamps).all(|(row, stamp)| row[0] == rusqlite::types::Value::Integer(*stamp)));

    let (code, shown) = run(&["show", "latest"]);
    assert_eq!(code, Some(0));
    for words in ["3875 samples", "gaps by source", "5 gaps by checksum: 5 missing", "line 820"] {
        assert!(shown.contains(words), "{words} is not in: {shown}");
    }
    assert_eq!(world.query("PRAGMA integrity_check")[0][0], rusqlite::types::Value::Text("ok".to_owned()));
}

#[test]
fn the_real_cart_as_a_bag_gives_the_samples_of_its_text() {
    let Some(bag) = real_data("vn100-cart/circle_carter.bag") else { return };
    let Some(text) = real_data("vn100-cart/circle_carter.imu.raw.txt.gz") else { return };
    let of = |file: &Path| load_columns(file, Options::default()).unwrap();
    let (from_bag, from_text) = (of(&bag), of(&text));
    assert_eq!((from_bag.info.kind, from_text.info.kind), (Kind::Bag, Kind::VnText));
    for (bag, text) in from_bag.columns.iter().zip(&from_text.columns) {
        assert!(bag.channel == text.channel && bag.values == text.values, "{}", bag.channel);
    }
    // The author of the text rounded some stamps up by a nanosecond.
    assert!(from_bag.info.started_utc_ns.abs_diff(from_text.info.started_utc_ns) <= 1);
    assert!((from_bag.info.rate_hz / from_text.info.rate_hz - 1.0).abs() < 1e-3);
    // If a step is either two periods or one late stamp, a nanosecond may decide, but the number of missing samples
    // changes little.
    assert!(from_bag.missing.abs_diff(from_text.missing) <= 2, "{} and {}", from_bag.missing, from_text.missing);
    assert!(from_bag.gaps.len().abs_diff(from_text.gaps.len()) <= 20);
    let rejected = |loaded: &LoadedRecording| -> Vec<(u64, DiscardCause)> {
        loaded.info.first_rejected.iter().map(|bad| (bad.line, bad.cause)).collect()
    };
    assert_eq!(rejected(&from_bag), rejected(&from_text));
}

#[test]
fn the_real_rotation_bag_has_paired_receptions_and_smooth_stamps() {
    let Some(bag) = real_data("vn100-desk/calibration_square.bag") else { return };
    let loaded = load_columns(&bag, Options::default()).unwrap();
    let choice = loaded.info.stamp_choice.as_ref().unwrap();
    assert_eq!(choice.name, "stamp in the message's header");
    assert!(choice.regular[1] > 0.9 && choice.regular[0] < 0.6, "{choice:?}");
    assert!((loaded.info.rate_hz - 40.0).abs() < 2.0, "{}", loaded.info.rate_hz);
    assert!((loaded.duration_s() - 57.0).abs() < 2.0, "{}", loaded.duration_s());
    assert!(values(&loaded, Channel::GyroZ).iter().all(|value| value.abs() < 35.0));
}

/// Writes white noise of the same generator as a recording, from its `from`-th sample on.
fn white_csv(path: &Path, header: &str, period_s: f64, from: u64, count: u64) {
    let mut text = format!("{header}\n");
    for index in 0..count {
        let mut state = (from + index + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        state = (state ^ (state >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let white = (state >> 40) as f64 / f64::from(1 << 24) - 0.5;
        text.push_str(&format!("{:.4},{:.9}\n", index as f64 * period_s, 0.01 * white));
    }
    std::fs::write(path, text).unwrap();
}

#[test]
fn recordings_of_one_sensor_are_analysed_together_and_others_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let header = "time_s,gyro_x_rad_s";
    let nights = ["a.csv", "b.csv", "c.csv"].map(path);
    for (night, from) in nights.iter().zip([0, 4000, 8000]) {
        white_csv(Path::new(night), header, 0.025, from, 4000);
    }
    let json = |arguments: &[&str]| -> serde_json::Value {
        let done = vn100d(arguments);
        assert!(done.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&done.stderr));
        serde_json::from_slice(&done.stdout).unwrap()
    };
    let [a, b, c] = nights.each_ref().map(String::as_str);
    let together = json(&["--json", "noise", a, b, c]);
    let alone = json(&["--json", "noise", a]);
    assert_eq!((together["samples"].as_u64(), together["captures"][2]["samples"].as_u64()), (Some(12_000), Some(4000)));
    assert!(alone.get("captures").is_none());
    let ends = |report: &serde_json::Value| {
        let ci95 = &report["channels"]["gyro_x"]["N"]["ci95"];
        (ci95[0].as_f64().unwrap(), ci95[1].as_f64().unwrap())
    };
    let ((low, high), (low_alone, high_alone)) = (ends(&together), ends(&alone));
    assert!(high - low < 0.7 * (high_alone - low_alone), "three nights tell more than one: {low} {high}");
    let truth = 0.01 / 12f64.sqrt() / 40f64.sqrt();
    assert!(low < truth && truth < high, "{low} {truth} {high}");
    for estimator in ["oadev", "ohdev"] {
        let curves = json(&["--json", "allan", a, b, c, "--estimator", estimator, "--taus", "octave"]);
        let curve = &curves["channels"]["gyro_x"];
        let lost = if estimator == "oadev" { 1 } else { 2 };
        assert_eq!(curve["n"][0].as_u64(), Some(3 * (4000 - lost)), "nothing across two recordings");
        assert_eq!(curve["noise"][0], "white_rate");
    }
    let (fast, degrees) = (path("fast.csv"), path("degrees.csv"));
    white_csv(Path::new(&fast), header, 0.01, 0, 4000);
    white_csv(Path::new(&degrees), "time_s,gyro_x_deg_s", 0.025, 0, 4000);
    for (other, words) in [(fast.as_str(), "rate in Hz 40 and 100"), (&degrees, "unit of gyro_x"), (a, "given twice")] {
        for command in ["allan", "noise"] {
            let refused = vn100d(&[command, a, other]);
            let stderr = String::from_utf8_lossy(&refused.stderr).into_owned();
            assert!(!refused.status.success() && refused.stdout.is_empty() && stderr.contains(words), "{stderr}");
            assert_eq!(stderr.trim().lines().count(), 1, "{stderr}");
        }
    }
}

#[test]
fn this_programs_own_database_is_reported_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("vn100d.db");
    let options = vn100d::store::StoreOptions::default();
    vn100d::store::Store::open(&path, options).unwrap().close().unwrap();
    let error = Recording::open(&path, Options::default()).unwrap_err().to_string();
    assert!(error.contains("this program's own database") && error.contains("--data-dir"), "{error}");
}
