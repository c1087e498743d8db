//! A sensor calibrated by gravity alone, from the simulator's tumble to the lines that correct it.

use crate::world::vn100d;
use serde_json::{Value, json};
use std::path::Path;

fn model() -> Value {
    let channel = |n: f64| json!({ "N": n });
    let (gyro, accel) = (channel(6e-5), channel(0.0014));
    json!({ "format": "vn100d-sensor-model-1", "name": "unit", "rate_hz": 40, "channels": {
        "gyro_x": gyro, "gyro_y": gyro, "gyro_z": gyro, "accel_x": accel, "accel_y": accel, "accel_z": accel },
      "triads": {
        "accel": { "effects": [
            { "effect": "scale_factor", "x": 0.004, "y": -0.003, "z": 0.001 },
            { "effect": "bias", "x": 0.05, "y": -0.03, "z": 0.12 } ] },
        "gyro": { "effects": [ { "effect": "scale_factor", "x": 0.01, "y": -0.005, "z": 0.002 } ] } } })
}

/// Runs the program on files of a folder, which are the arguments that end with a file's suffix.
fn run(folder: &Path, arguments: &[&str]) -> (bool, String, String) {
    let in_folder = |argument: &&str| match [".csv", ".json", ".txt"].iter().any(|suffix| argument.ends_with(suffix)) {
        true => folder.join(argument).to_str().unwrap().to_owned(),
        false => (*argument).to_owned(),
    };
    let arguments: Vec<String> = arguments.iter().map(in_folder).collect();
    let ended = vn100d(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (ended.status.success(), text(ended.stdout), text(ended.stderr))
}

/// Simulates a tumble of five minutes, and returns the folder with it.
fn tumbled(seed: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("unit.json"), model().to_string()).unwrap();
    let simulate = ["simulate", "--model", "unit.json", "--duration", "5min", "--motion", "poses", "--seed", seed];
    let (is_done, _, error) = run(folder.path(), &[&simulate[..], &["--out", "tumble.csv"]].concat());
    assert!(is_done, "{error}");
    folder
}

#[test]
fn a_simulated_tumble_is_calibrated_and_its_correction_is_written_for_the_sensor() {
    let world = tumbled("3");
    let world = world.path();
    let (is_done, text, _) = run(world, &["--json", "calibrate", "tumble.csv", "--gravity", "9.80665"]);
    assert!(is_done, "{text}");
    let found: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&found["format"], &found["tumble"]["poses"]), (&json!("vn100d-calibration-1"), &json!(24)));
    for (triad, key, truth) in [
        ("accel", "sensitivity", [1.004, 0.997, 1.001]),
        ("accel", "bias", [0.05, -0.03, 0.12]),
        ("gyro", "sensitivity", [1.01, 0.995, 1.002]),
    ] {
        for (axis, truth) in truth.into_iter().enumerate() {
            let of = &found["triads"][triad][key][axis];
            let [value, low, high] = [&of["value"], &of["ci95"][0], &of["ci95"][1]].map(|of| of.as_f64().unwrap());
            // Twice the interval: one of nine numbers may be outside.
            assert!((value - truth).abs() < high - low, "{triad} {key} {axis}: {truth} {of}");
        }
    }
    let (is_done, ..) = run(world, &["calibrate", "tumble.csv", "--format", "registers", "--out", "lines.txt"]);
    let lines = std::fs::read_to_string(world.join("lines.txt")).unwrap();
    assert!(is_done && lines.starts_with("$VNWRG,25,0.99") && lines.contains("\n$VNWRG,84,0.99"), "{lines}");
    let (is_done, _, error) = run(world, &["calibrate", "tumble.csv", "--format", "registers", "--out", "lines.txt"]);
    assert!(!is_done && error.contains("--force"), "{error}");
}

#[test]
fn counts_are_calibrated_and_refused_elsewhere() {
    let world = tumbled("4");
    let world = world.path();
    let text = std::fs::read_to_string(world.join("tumble.csv")).unwrap();
    let mut lines = text.lines();
    let names: Vec<String> = lines
        .next()
        .unwrap()
        .split(',')
        .map(|name| name.replace("_m_s2", "_counts").replace("_rad_s", "_counts"))
        .collect();
    let mut counts = names.join(",") + "\n";
    for line in lines {
        let cells = line.split(',').zip(&names).map(|(cell, name)| {
            let per_unit = if name.starts_with("accel") { 800.0 } else { 5000.0 };
            let is_counts = name.ends_with("_counts");
            if is_counts {
                (32768.0 + per_unit * cell.parse::<f64>().unwrap()).round().to_string()
            } else {
                cell.to_owned()
            }
        });
        counts += &(cells.collect::<Vec<_>>().join(",") + "\n");
    }
    std::fs::write(world.join("counts.csv"), counts).unwrap();
    let (is_done, text, error) = run(world, &["--json", "calibrate", "counts.csv", "--gravity", "9.80665"]);
    assert!(is_done, "{error}");
    let found: Value = serde_json::from_str(&text).unwrap();
    let of = |triad: &str, axis: usize| found["triads"][triad]["sensitivity"][axis]["value"].as_f64().unwrap();
    assert!((of("accel", 0) - 800.0 * 1.004).abs() < 0.5, "{}", of("accel", 0));
    assert!((of("gyro", 0) - 5000.0 * 1.01).abs() < 10.0, "{}", of("gyro", 0));
    for command in
        [&["noise", "counts.csv"][..], &["allan", "counts.csv"], &["calibrate", "counts.csv", "--format", "registers"]]
    {
        let (is_done, _, error) = run(world, command);
        assert!(!is_done && error.contains("counts"), "{command:?}: {error}");
    }
}
