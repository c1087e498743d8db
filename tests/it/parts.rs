//! A part of a recording: `--from`, `--to` and `--channels` mean the same for every command and for files and captures.

use crate::world::{World, vn100d};
use serde_json::Value;
use std::path::Path;
use vn100_testkit::ros2::{self, Cdr};

/// The first sample: a Saturday evening of November 2026, s since 1970.
const ORIGIN_S: f64 = 1_795_464_000.0;

/// Returns a table of noise at 40 Hz, the rows `from..to` of a night, with a gap.
fn table(from: u32, to: u32) -> String {
    let mut state = 7_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / 2_147_483_648.0 - 0.5
    };
    let rows = (0..to).map(|row| (row, noise(), noise()));
    let rows = rows.filter(|(row, ..)| *row >= from && !(3000..3004).contains(row));
    let rows = rows.map(|(row, gyro, accel)| {
        let time_s = ORIGIN_S + f64::from(row) * 0.025;
        format!("{time_s:.3},{:.9},{:.9}\n", 1e-3 * gyro, 9.8 + 1e-2 * accel)
    });
    format!("time_s,gyro_x_rad_s,accel_z_m_s2\n{}", rows.collect::<String>())
}

fn done(arguments: &[&str]) -> String {
    let output = vn100d(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn refused(arguments: &[&str]) -> (Option<i32>, String) {
    let output = vn100d(arguments);
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_part_is_analysed_as_a_file_that_has_no_more_whether_of_a_file_or_a_capture() {
    let world = World::new();
    let [night, cut] = ["night.csv", "cut.csv"].map(|name| world.path(name));
    std::fs::write(&night, table(0, 6000)).unwrap();
    std::fs::write(&cut, table(2000, 5000)).unwrap();
    let data = world.path("data");
    let of = |arguments: &[&str]| done(&[&["--data-dir", text(&data)][..], arguments].concat());
    of(&["import", text(&night)]);
    let seconds = ["--from", "50", "--to", "125"];
    // 50 s and 125 s after the first sample.
    let dates = ["--from", "2026-11-23T20:00:50Z", "--to", "2026-11-23T20:02:05Z"];
    let curve = |named: &str, part: &[&str]| {
        let json = of(&[&["--json", "allan", named][..], part].concat());
        serde_json::from_str::<Value>(&json).unwrap()["channels"].clone()
    };
    let expected = curve(text(&cut), &[]);
    assert!(expected["gyro_x"]["deviation"].as_array().unwrap().len() > 20);
    for (named, part) in [(text(&night), seconds), (text(&night), dates), ("night", seconds), ("night", dates)] {
        assert_eq!(curve(named, &part), expected, "{named} {part:?}");
    }
    let one = curve("night", &["--from", "50", "--to", "125", "--channels", "gyro_x"]);
    assert_eq!(one.as_object().unwrap().keys().collect::<Vec<_>>(), ["gyro_x"]);
    assert_eq!(one["gyro_x"], expected["gyro_x"]);
    for named in [text(&night), "night"] {
        let part = [named, "--from", "50", "--to", "125"];
        let shown = of(&[&["show"][..], &part].concat());
        assert!(shown.contains("2996 samples") && shown.contains("4 missing"), "{shown}");
        let noise: Value = serde_json::from_str(&of(&[&["--json", "noise"][..], &part].concat())).unwrap();
        assert_eq!((noise["samples"].as_u64(), noise["missing"].as_u64()), (Some(2996), Some(4)), "{noise}");
        let model: Value = serde_json::from_str(&of(&[&["model", "fit"][..], &part].concat())).unwrap();
        assert!(
            model["channels"]["accel_z"]["N"].is_object() || model["channels"]["accel_z"]["N"].is_number(),
            "{model}"
        );
        let page = world.path("report.html");
        of(&[&["report"][..], &part, &["--out", text(&page), "--force"]].concat());
        assert!(std::fs::read_to_string(&page).unwrap().contains("2996 samples"));
        let picture = world.path("psd.svg");
        of(&["plot", named, "allan-gyro_x", "--from", "50", "--to", "125", "--out", text(&picture), "--force"]);
        assert!(std::fs::read_to_string(&picture).unwrap().contains("<svg"));
    }
}

#[test]
fn channels_that_are_left_out_are_left_out_of_the_model_too() {
    let world = World::new();
    let [night, sim] = ["night.csv", "sim.json"].map(|name| world.path(name));
    std::fs::write(&night, table(0, 6000)).unwrap();
    let channels = r#"{"gyro_x": {"N": 6.5e-5}, "accel_z": {"N": 6.5e-4}}"#;
    let model = r#"{"format": "vn100d-sensor-model-1", "name": "both", "rate_hz": 40, "channels": CHANNELS}"#;
    std::fs::write(&sim, model.replace("CHANNELS", channels)).unwrap();
    let command = ["--json", "diagnose", "--real", text(&night), "--sim", text(&sim), "--channels", "gyro_x"];
    let report: Value = serde_json::from_str(&done(&command)).unwrap();
    let compared = report["per_channel"].as_object().unwrap();
    assert!(compared.len() == 1 && compared.contains_key("gyro_x"), "{report}");
    // Of a simulator's recording as of a model.
    let of_recording = ["diagnose", "--real", text(&night), "--sim", text(&night), "--channels", "gyro_x", "--json"];
    let report: Value = serde_json::from_str(&done(&of_recording)).unwrap();
    assert_eq!(report["per_channel"].as_object().unwrap().len(), 1, "{report}");
    std::fs::write(&sim, model.replace("CHANNELS", r#"{"accel_z": {"N": 6.5e-4}}"#)).unwrap();
    let (code, error) = refused(&command);
    assert!(code == Some(1) && error.contains("has none of the wanted channels: choose from accel_z"), "{error}");
    // A velocity needs the accelerometer, and of the gyroscope what the model has of it.
    std::fs::write(&night, table(0, 6000).replace("gyro_x", "gyro_y").replace("accel_z", "accel_x")).unwrap();
    let channels = r#"{"gyro_y": {"N": 6.5e-5}, "accel_x": {"N": 6.5e-4}}"#;
    std::fs::write(&sim, model.replace("CHANNELS", channels)).unwrap();
    let align = ["--align", "10s", "--channels", "accel_x"];
    let command = [&["--json", "cost", "--model", text(&sim), "--real", text(&night)][..], &align].concat();
    let cost: Value = serde_json::from_str(&done(&command)).unwrap();
    assert!(cost["measured"]["quantities"].as_object().is_some_and(|of| !of.is_empty()), "{cost}");
}

#[test]
fn what_a_part_cannot_be_is_refused_with_what_to_do() {
    let world = World::new();
    let night = world.path("night.csv");
    std::fs::write(&night, table(0, 400)).unwrap();
    let own = world.path("own.csv");
    std::fs::write(&own, "time_s,gyro_x_rad_s\n0,1\n0.1,2\n0.2,3\n").unwrap();
    for (arguments, code, words) in [
        (vec!["show", text(&night), "--from", "20"], 1, "no sample in the part"),
        (vec!["show", text(&night), "--channels", "mag_x"], 1, "mag_x"),
        (vec!["show", text(&night), "--channels", "gyro_w"], 2, "gyro_w"),
        (vec!["show", text(&night), "--from", "soon"], 2, "RFC 3339"),
        (vec!["show", text(&own), "--from", "2026-11-23T20:00:00Z"], 1, "tells no time of day"),
        (vec!["cost", "--model", "unit.json", "--from", "1"], 2, "give --real too"),
        (vec!["plot", text(&night), "timeseries-gyro_x", "--channels", "gyro_x", "--out", "a.svg"], 2, "--channels"),
    ] {
        let (found, error) = refused(&arguments);
        assert!(found == Some(code) && error.contains(words), "{arguments:?}: {found:?} {error}");
    }
}

#[test]
fn a_part_is_imported_with_a_note_also_through_the_daemon() {
    let world = World::new();
    let night = world.path("night.csv");
    std::fs::write(&night, table(0, 6000)).unwrap();
    let daemon = world.daemon("", &[]);
    let address = world.url.trim_start_matches("http://");
    let import = |arguments: &[&str]| -> Value {
        let all = [&["--json", "import", "--listen", address, text(&night)][..], arguments].concat();
        serde_json::from_str::<Value>(&done(&all)).unwrap()[0].clone()
    };
    let whole = import(&[]);
    let part = ["--from", "50", "--to", "2026-11-23T20:02:05Z", "--channels", "gyro_x", "--note", "on foam, 23 °C"];
    let first = import(&part);
    assert_eq!((first["samples"].as_u64(), first["missing"].as_u64()), (Some(2996), Some(4)), "{first}");
    assert_ne!(first["capture"], whole["capture"], "another part is another capture");
    let again = import(&part);
    assert_eq!((again["new"].as_bool(), &again["capture"]), (Some(false), &first["capture"]));
    let row = world.get(&format!("/v1/captures/{}", first["capture"]));
    assert_eq!(row["note"], "on foam, 23 °C", "{}", daemon.log());
    assert_eq!(row["channels"].as_array().unwrap().len(), 1);
    assert_eq!(row["configuration"]["part"], "from 50 s to 2026-11-23T20:02:05.000000000Z channels gyro_x");
    let (code, error) = refused(&["import", "--listen", address, text(&night), "--note", "a\nb"]);
    assert!(code != Some(0) && error.contains("note"), "{error}");
}

#[test]
fn a_split_bag_is_imported_whole_and_a_daemon_says_how() {
    let world = World::new();
    let bag = world.path("bag");
    std::fs::create_dir(&bag).unwrap();
    let stamp_ns = |index: usize| 1_795_464_000_000_000_000 + 25_000_000 * index as u64;
    let file = |range: std::ops::Range<usize>| {
        let message = |index: usize| {
            let data = Cdr::little_endian().imu(stamp_ns(index), [index as f64, 0.0, 0.0], [0.0, 0.0, 9.8]);
            (0, stamp_ns(index) as i64, data.bytes())
        };
        ros2::db3(&[("/imu", "sensor_msgs/msg/Imu", None)], &range.map(message).collect::<Vec<_>>())
    };
    std::fs::write(bag.join("bag_0.db3"), file(0..60)).unwrap();
    std::fs::write(bag.join("bag_1.db3"), file(60..100)).unwrap();
    let metadata = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - bag_0.db3\n    - bag_1.db3\n";
    std::fs::write(bag.join("metadata.yaml"), metadata).unwrap();
    let data = world.path("own");
    let report: Value =
        serde_json::from_str(&done(&["--json", "--data-dir", text(&data), "import", text(&bag)])).unwrap();
    assert_eq!((report[0]["samples"].as_u64(), report[0]["missing"].as_u64()), (Some(100), Some(0)), "{report}");
    let _daemon = world.daemon("", &[]);
    let address = world.url.trim_start_matches("http://");
    let (code, error) = refused(&["import", "--listen", address, text(&bag)]);
    assert!(code == Some(2) && error.contains("vn100d export"), "{error}");
}
