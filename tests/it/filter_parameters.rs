//! `vn100d noise --consistent`: the document, the filters' files, captures, and what is refused.

use crate::world::vn100d;
use serde_json::{Value, json};
use std::path::Path;

const FILTERS: [&str; 10] = [
    "kalibr",
    "openvins",
    "vins-fusion",
    "orb-slam3",
    "lio-sam",
    "fast-lio",
    "robot-localization",
    "px4",
    "ardupilot",
    "ros",
];

fn model(folder: &Path, name: &str, channels: &Value) -> String {
    let model = json!({"format": "vn100d-sensor-model-1", "name": "test", "rate_hz": 40, "channels": channels});
    let path = folder.join(name);
    std::fs::write(&path, model.to_string()).unwrap();
    path.to_str().unwrap().to_owned()
}

fn done(arguments: &[&str]) -> String {
    let ended = vn100d(arguments);
    assert_eq!(ended.status.code(), Some(0), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
    String::from_utf8(ended.stdout).unwrap()
}

/// Three gyroscopes with a vibration and a warm-up.
fn shaken() -> Value {
    let axis = json!({"N": 1.2e-4, "K": 1.5e-6, "bias": 0.1, "effects": [
        {"effect": "tone", "frequency_hz": 13.38, "amplitude": 1e-2},
        {"effect": "warm_up", "amplitude": 2e-2, "tau_s": 600}]});
    json!({"gyro_x": axis, "gyro_y": axis, "gyro_z": axis})
}

#[test]
fn pairs_inflation_and_causes_are_in_document_table_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let file = model(folder.path(), "unit.json", &shaken());
    let found: Value = serde_json::from_str(&done(&["noise", "--model", &file, "--consistent", "--json"])).unwrap();
    assert_eq!(found["format"], "vn100d-filter-parameters-1");
    assert_eq!((&found["over_s"], &found["align_s"]), (&json!([0.1, 100.0]), &json!(30.0)));
    assert_eq!((&found["record_s"], &found["extrapolated"]), (&json!(3600.0), &json!(false)));
    let of = &found["channels"]["gyro_z"];
    let summary = of["summary"].as_str().unwrap();
    assert!(summary.contains(": tone at 13.38 Hz; K × ") && summary.ends_with(": warm_up"), "{summary}");
    let (fit, cover) = (&of["white_and_walk"]["fit"], &of["white_and_walk"]["cover"]);
    let number = |of: &Value| of.as_f64().unwrap_or_else(|| panic!("{of}"));
    assert!(number(&fit["inflation"]["N"]) > 2.0 && number(&fit["inflation"]["K"]) > 5.0, "{fit}");
    assert!((number(&cover["worst_ratio"]) - 1.0).abs() < 1e-4 && number(&fit["worst_ratio"]) > 1.0, "{cover}");
    assert_eq!(number(&of["allan"]["N"]), 1.2e-4);
    assert!(number(&of["allan"]["worst_ratio"]) > number(&fit["worst_ratio"]), "{of}");
    let real = of["real_sd"].as_array().unwrap();
    for (real, predicted) in real.iter().zip(cover["predicted_sd"].as_array().unwrap()) {
        assert!(number(real) <= 1.0001 * number(predicted), "{real} {predicted}");
    }
    let table = done(&["noise", "--model", &file, "--consistent"]);
    assert!(table.contains("over 0.1 s to 1m40s after 30s of alignment") && table.contains(summary), "{table}");
    for (pair, own) in [("--consistent", fit), ("--consistent=cover", cover)] {
        let n = number(&own["N"]);
        for name in FILTERS {
            let text = done(&["noise", "--model", &file, pair, "--format", name]);
            assert!(text.contains("# Consistent, at least the sensor's own"), "{text}");
        }
        let kalibr = done(&["noise", "--model", &file, pair, "--format", "kalibr"]);
        assert!(kalibr.contains(&format!("gyroscope_noise_density: {n:.6e}")), "{kalibr}");
        assert!(kalibr.replace("\n# ", " ").contains(summary), "{kalibr}");
        let px4 = done(&["noise", "--model", &file, pair, "--format", "px4"]);
        assert!(px4.contains(&format!("EKF2_GYR_NOISE {:.6e}", 10.0 * n)), "{px4}");
    }
}

/// A constant bias, a magnetometer and the channel's level do not act on what a filter integrates.
#[test]
fn what_does_not_act_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let plain = json!({"gyro_x": {"N": 1e-4, "B": 1e-5}});
    let more = json!({"gyro_x": {"N": 1e-4, "B": 1e-5, "bias": 0.3}, "mag_x": {"N": 1.0, "bias": 0.2}, "pressure": {"B": 3.0}});
    let [plain, more] = [("unit.json", plain), ("more.json", more)].map(|(name, channels)| {
        let file = model(folder.path(), name, &channels);
        let text = done(&["noise", "--model", &file, "--consistent", "--json"]);
        serde_json::from_str::<Value>(&text).unwrap()["channels"].clone()
    });
    assert_eq!(plain, more);
}

/// The effects that a recording shows lead to the parameters of the model that made it.
#[test]
fn a_recording_has_the_parameters_of_its_model() {
    let folder = tempfile::tempdir().unwrap();
    let axis = json!({"N": 1.2e-4, "effects": [{"effect": "tone", "frequency_hz": 13.38, "amplitude": 3e-3}]});
    let file = model(folder.path(), "unit.json", &json!({"gyro_x": axis}));
    let recording = folder.path().join("night.csv").to_str().unwrap().to_owned();
    done(&["simulate", "--model", &file, "--duration", "20min", "--seed", "3", "--out", &recording]);
    let of = |arguments: &[&str]| -> Value {
        serde_json::from_str(&done(&[&["noise", "--consistent", "--json"], arguments].concat())).unwrap()
    };
    let (model, recorded) = (of(&["--model", &file]), of(&[&recording]));
    assert_eq!((&recorded["record_from"], &recorded["extrapolated"]), (&json!("model"), &json!(false)), "{recorded}");
    let note = recorded["notes"][0].as_str().unwrap();
    assert!(note.contains("fitted to") && note.contains("tone on gyro_x"), "{note}");
    let n = |of: &Value| of["channels"]["gyro_x"]["white_and_walk"]["fit"]["N"].as_f64().unwrap();
    assert!((n(&recorded) / n(&model) - 1.0).abs() < 0.05, "{} {}", n(&recorded), n(&model));
    let summary = recorded["channels"]["gyro_x"]["summary"].as_str().unwrap();
    assert!(summary.contains("tone at 13.38 Hz"), "{summary}");
    let beyond = of(&[&recording, "--over", "1s..1h"]);
    assert!(beyond["extrapolated"] == json!(true) && beyond["notes"].to_string().contains("extrapolation"), "{beyond}");
}

#[test]
fn what_makes_no_sense_is_refused_with_what_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let file = model(folder.path(), "unit.json", &json!({"gyro_z": {"N": 1e-4}}));
    let mag = model(folder.path(), "mag.json", &json!({"mag_x": {"N": 1e-4}}));
    let with = |file: &'static str| ["--consistent", "--over", file];
    for (more, code, words) in [
        (&with("100s..1s")[..], 2, ["the range `100s..1s`", "a longer second one"]),
        (&with("1s..1s"), 2, ["the range `1s..1s`", "above 0"]),
        (&with("-1s..1s"), 2, ["the range `-1s..1s`", "0.1s..100s"]),
        (&with("0s..1s"), 2, ["the range `0s..1s`", "above 0"]),
        (&with("10"), 2, ["the range `10`", "FROM..TO"]),
        (&with("1ms..1s"), 2, ["shorter than a sample at 40 Hz", "0.025 s"]),
        (&with("1s..1010ms"), 2, ["at 40 Hz has too few", "1.05 s"]),
        (&with("1s..400d"), 2, ["are too long", "25000000 s"]),
        (&with("100ms..90d"), 2, ["0.1 s to 7776000 s", "100000 s"]),
        (&["--consistent", "--align", "0s"], 2, ["alignment", "such as 30s"]),
        (&["--consistent", "--record", "0s"], 2, ["a record of 0 s", "such as 5h"]),
        (&["--consistent", "--format", "gazebo"], 2, ["gazebo is a simulator", "kalibr"]),
        (&["--consistent", "--format", "csv"], 2, ["csv", "json"]),
        (&["--over", "1s..2s"], 2, ["--consistent", "--over"]),
        (&["--consistent=best"], 2, ["fit", "cover"]),
    ] {
        refuses(&[&["noise", "--model", &file], more].concat(), code, &words);
    }
    refuses(&["noise", "--model", &mag, "--consistent"], 1, &["mag.json", "gyro_x"]);
    refuses(&["noise", "--model", "absent.json", "--consistent"], 74, &["absent.json", "cannot be read"]);
    refuses(&["noise", "night.csv", "--model", &file, "--consistent"], 2, &["--model", "cannot be used"]);
    refuses(&["noise", "--consistent"], 2, &["CAPTURE"]);
}

fn refuses(arguments: &[&str], code: i32, words: &[&str]) {
    let ended = vn100d(arguments);
    let text = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(code), "{arguments:?}: {text}");
    assert!(ended.stdout.is_empty(), "{arguments:?}");
    for word in words {
        assert!(text.contains(word), "{arguments:?}: {word} is not in {text}");
    }
}
