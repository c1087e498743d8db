//! `vn100d cost`: the table, the document, limits with exit code 4, and what is refused.

use crate::world::vn100d;
use serde_json::{Value, json};
use std::path::Path;

fn model(folder: &Path, name: &str, channels: &Value) -> String {
    let model = json!({"format": "vn100d-sensor-model-1", "name": "test", "rate_hz": 40, "channels": channels});
    let path = folder.join(name);
    std::fs::write(&path, model.to_string()).unwrap();
    path.to_str().unwrap().to_owned()
}

fn done(arguments: &[&str], code: i32) -> String {
    let ended = vn100d(arguments);
    assert_eq!(ended.status.code(), Some(code), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
    String::from_utf8(ended.stdout).unwrap()
}

fn six_axes(gyro: &Value, accel: &Value) -> Value {
    let axis = |triad: &str, of: &Value| ["x", "y", "z"].map(|axis| (format!("{triad}_{axis}"), of.clone()));
    axis("gyro", gyro).into_iter().chain(axis("accel", accel)).collect::<serde_json::Map<_, _>>().into()
}

#[test]
fn the_document_has_what_the_contract_names() {
    let folder = tempfile::tempdir().unwrap();
    let warm = json!({"N": 1e-4, "bias": 0.01, "effects": [{"effect": "warm_up", "amplitude": 1e-3, "tau_s": 300}]});
    let file = model(folder.path(), "unit.json", &six_axes(&warm, &json!({"N": 2e-3, "bias": 0.1})));
    let arguments = ["--json", "cost", "--model", &file, "--horizons", "1s,10s,1min", "--align", "20s"];
    let found: Value = serde_json::from_str(&done(&arguments, 0)).unwrap();
    assert_eq!((found["format"].as_str(), found["align_s"].as_f64()), (Some("vn100d-cost-1"), Some(20.0)));
    assert_eq!(found["horizons_s"], json!([1.0, 10.0, 60.0]));
    for (quantity, unit) in [
        ("attitude_x", "rad"),
        ("attitude_y", "rad"),
        ("heading", "rad"),
        ("velocity_x", "m/s"),
        ("velocity_y", "m/s"),
        ("position_x", "m"),
        ("position_y", "m"),
    ] {
        let of = &found["quantities"][quantity];
        assert_eq!((of["unit"].as_str(), of["method"].as_str()), (Some(unit), Some("closed form")), "{quantity}");
        for key in ["mean", "sd", "band95"] {
            assert_eq!(of[key].as_array().map(Vec::len), Some(3), "{quantity} {key}");
        }
    }
    // N √(t + t²/align).
    let sd = found["quantities"]["attitude_x"]["sd"][2].as_f64().unwrap();
    assert!((sd / (1e-4 * (60.0_f64 + 180.0).sqrt()) - 1.0).abs() < 1e-6, "{sd}");
    let causes = found["causes"].as_array().unwrap();
    let has = |cause: &str, channel: &str, quantity: &str| {
        causes.iter().any(|of| of["cause"] == cause && of["channel"] == channel && of["quantity"] == quantity)
    };
    assert!(
        has("warm_up", "gyro_z", "heading") && has("N", "gyro_y", "position_x") && !has("N", "gyro_z", "position_x")
    );
    let table = done(&["cost", "--model", &file], 0);
    let first = table.lines().next().unwrap();
    assert!(first.contains("° of ") && first.contains(" km of position_") && first.ends_with("after 1h."), "{first}");
    assert!(first.contains("warm_up on gyro_"), "{first}");
}

#[test]
fn a_missed_limit_is_exit_code_four_and_names_the_cause() {
    let folder = tempfile::tempdir().unwrap();
    let file = model(folder.path(), "unit.json", &six_axes(&json!({"N": 1e-4}), &json!({"N": 2e-3})));
    let with = |limit: &str, code: i32, more: &[&str]| {
        done(&[&["cost", "--model", &file, "--horizons", "10s", "--tolerance", limit], more].concat(), code)
    };
    assert!(with("heading=1deg/1min", 0, &["--check"]).contains("pass: heading after 1m is "));
    let missed = with("heading=1deg/1min,position=1mm/10s", 4, &["--check"]);
    assert!(missed.contains("FAIL: position_x after 10s is ") && missed.contains("N on gyro_y decides"), "{missed}");
    // Without --check a verdict is a result like any other.
    let verdicts: Value = serde_json::from_str(&with("position=1mm/10s", 0, &["--json"])).unwrap();
    let verdict = &verdicts["tolerances"][0];
    assert_eq!((verdict["pass"].as_bool(), verdict["deciding"].as_str()), (Some(false), Some("N on gyro_y")));
    assert_eq!((verdict["limit"].as_f64(), verdict["horizon_s"].as_f64()), (Some(1e-3), Some(10.0)));
}

#[test]
fn a_comparison_prints_both_and_the_ratio() {
    let folder = tempfile::tempdir().unwrap();
    let one = model(folder.path(), "one.json", &six_axes(&json!({"N": 3e-4}), &json!({"N": 2e-3})));
    let other = model(folder.path(), "other.json", &json!({"gyro_x": {}, "gyro_z": {"N": 1e-4}}));
    let arguments = ["cost", "--model", &one, "--against", &other, "--horizons", "10s"];
    let table = done(&arguments, 0);
    assert!(table.contains("one.json costs up to") && table.contains("other.json costs up to"), "{table}");
    assert!(table.contains("other.json:") && table.contains("attitude only"), "{table}");
    let found: Value = serde_json::from_str(&done(&[&arguments[..], &["--json"]].concat(), 0)).unwrap();
    let ratio = found["ratio"]["heading"][0].as_f64().unwrap();
    assert!((ratio - 3.0).abs() < 1e-6, "{ratio}");
    assert_eq!(found["ratio"]["attitude_x"], json!([null]));
    assert_eq!(found["against"]["format"], "vn100d-cost-1");
}

#[test]
fn a_recording_is_measured_in_pieces_beside_the_models_band() {
    let folder = tempfile::tempdir().unwrap();
    let file = model(folder.path(), "unit.json", &six_axes(&json!({"N": 1e-4, "K": 1e-6}), &json!({"N": 2e-3})));
    let quiet = model(folder.path(), "quiet.json", &json!({"gyro_z": {"N": 2e-5}}));
    let night = folder.path().join("night.csv").to_str().unwrap().to_owned();
    done(&["simulate", "--model", &file, "--duration", "1h", "--seed", "3", "--out", &night], 0);
    let arguments = ["cost", "--model", &file, "--against", &quiet, "--real", &night, "--horizons", "1s,10s,1h"];
    let found: Value = serde_json::from_str(&done(&[&["--json"], &arguments[..]].concat(), 0)).unwrap();
    let measured = &found["measured"];
    assert_eq!((&measured["horizons_s"], measured["length_s"].as_f64()), (&json!([1.0, 10.0, 3600.0]), Some(3600.0)));
    for quantity in ["attitude_x", "heading", "velocity_y", "position_x"] {
        let pieces = &measured["quantities"][quantity]["pieces"];
        assert!(pieces[0]["coverage"].as_f64().unwrap() > 0.88, "{pieces}");
        assert!(pieces[1]["independent"].as_f64().unwrap() <= 90.0, "{pieces}");
        assert_eq!(pieces[2], Value::Null);
    }
    let against = &found["against"]["measured"]["quantities"]["heading"]["pieces"][1];
    assert!(against["coverage_ci95"][1].as_f64().unwrap() < 0.7, "{against}");
    let table = done(&arguments, 0);
    assert!(table.contains("Measured in pieces of ") && table.contains("inside the band"), "{table}");
    assert!(table.contains("fewer than 5 disjoint pieces: 1h"), "{table}");
    let ended = vn100d(&["cost", "--model", &file, "--real", &night, "--horizons", "20min"]);
    let error = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(1), "{error}");
    assert!(error.contains("2 disjoint pieces of 1230 s") && error.contains("at least 5"), "{error}");
}

#[test]
fn limits_of_a_file_are_checked_and_errors_have_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = model(folder.path(), "unit.json", &json!({"gyro_z": {"N": 1e-4}}));
    let limits = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let good = limits("limits.txt", "# of the robot\nheading=2deg/10min\nheading=1mrad/1min # tight\n");
    let arguments = ["cost", "--model", &file, "--horizons", "10s", "--check", "--tolerance"];
    let table = done(&[&arguments[..], &[&good]].concat(), 4);
    assert!(table.contains("pass: heading after 10m") && table.contains("FAIL: heading after 1m"), "{table}");
    for (text, part) in [
        ("heading=1deg/10min\nyaw=1deg/1s\n", "limits-bad.txt: line 2: the tolerance `yaw=1deg/1s`"),
        ("# none\n", "limits-bad.txt: there is no tolerance"),
    ] {
        let bad = limits("limits-bad.txt", text);
        let ended = vn100d(&[&arguments[..], &[&bad]].concat());
        let error = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(ended.status.code() == Some(2) && error.contains(part), "{error}");
    }
    let ended = vn100d(&[&arguments[..], &["nowhere.txt"]].concat());
    let error = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(
        ended.status.code() == Some(2)
            && error.contains("neither NAME=LIMIT/DURATION")
            && error.contains("nowhere.txt"),
        "{error}"
    );
}

#[test]
fn a_diagnosis_has_the_cost_of_the_gap() {
    let folder = tempfile::tempdir().unwrap();
    let warm = json!({"N": 1e-4, "effects": [{"effect": "warm_up", "amplitude": 2e-3, "tau_s": 300}]});
    let truth = model(folder.path(), "truth.json", &json!({"gyro_z": warm}));
    let plain = model(folder.path(), "plain.json", &json!({"gyro_z": {"N": 1e-4}}));
    let desk = folder.path().join("desk.csv").to_str().unwrap().to_owned();
    done(&["simulate", "--model", &truth, "--duration", "20min", "--seed", "7", "--out", &desk], 0);
    let page = folder.path().join("gap.html").to_str().unwrap().to_owned();
    let arguments = ["--json", "diagnose", "--real", &desk, "--sim", &plain, "--html", &page];
    let found: Value = serde_json::from_str(&done(&arguments, 0)).unwrap();
    let cost = &found["discrepancy"]["cost"];
    assert_eq!(cost["horizons_s"], json!([10.0, 60.0, 600.0]), "{found}");
    let expected = |file: &str| -> Value {
        let arguments = ["--json", "cost", "--model", file, "--horizons", "10s,1min,10min"];
        let cost: Value = serde_json::from_str(&done(&arguments, 0)).unwrap();
        cost["quantities"]["heading"]["band95"].clone()
    };
    let heading = &cost["quantities"]["heading"];
    assert_eq!(heading["before"], expected(&plain));
    for (place, truth) in expected(&truth).as_array().unwrap().iter().enumerate() {
        let truth = truth.as_f64().unwrap();
        let after = heading["after"][place].as_f64().unwrap();
        assert!((after / truth - 1.0).abs() < 0.1, "{heading}: {truth}");
        let [low, high] = [0, 1].map(|end| heading["after_ci95"][place][end].as_f64().unwrap());
        assert!(low <= truth && truth <= high, "{heading}: {truth}");
        assert!(heading["floor"][place].as_f64().unwrap() < after, "{heading}");
    }
    let cause = &found["causes"][0];
    assert_eq!(cause["effect"], "warm_up");
    assert!(cause["cost"]["heading"]["share"][2].as_f64().unwrap() > 0.9, "{cause}");
    let summary = found["summary"].as_str().unwrap();
    assert!(summary.contains("After 10m without aid, 95 % of the sensor's heading errors are within "), "{summary}");
    assert!(summary.contains(" of it: warm_up); the model states "), "{summary}");
    assert!(std::fs::read_to_string(&page).unwrap().contains("What it costs without aid"));
    let table = done(&["diagnose", "--real", &desk, "--sim", &plain], 0);
    assert!(table.contains("without the causes"), "{table}");
}

/// Rows of a level sensor, z up, that turns about z from 1 s on.
fn motion(folder: &Path, name: &str, count: usize, rate_hz: f64) -> String {
    let mut text = "time_s,ref_gyro_x_rad_s,ref_gyro_y_rad_s,ref_gyro_z_rad_s,ref_accel_x_m_s2,ref_accel_y_m_s2,ref_accel_z_m_s2\n".to_owned();
    for index in 0..count {
        let time_s = index as f64 / rate_hz;
        text += &format!("{time_s},0,0,{},0,0,9.80665\n", if time_s < 1.0 { 0.0 } else { 0.5 });
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_motion_adds_what_acts_on_it() {
    let folder = tempfile::tempdir().unwrap();
    let plain = model(folder.path(), "plain.json", &six_axes(&json!({"N": 1e-5}), &json!({"N": 1e-3})));
    let mut scaled: Value = serde_json::from_str(&std::fs::read_to_string(&plain).unwrap()).unwrap();
    scaled["triads"] = json!({"gyro": {"effects": [{"effect": "scale_factor", "x": 0, "y": 0, "z": 2e-3}]}});
    let own = folder.path().join("scaled.json");
    std::fs::write(&own, scaled.to_string()).unwrap();
    let own = own.to_str().unwrap();
    let turn = motion(folder.path(), "turn.csv", 800, 40.0);
    let arguments = ["cost", "--model", own, "--against", &plain, "--motion", &turn, "--horizons", "1s,10s,20s,1min"];
    let found: Value = serde_json::from_str(&done(&[&["--json"], &arguments[..]].concat(), 0)).unwrap();
    assert_eq!(found["motion"], json!(turn));
    assert_eq!(
        (&found["horizons_s"], &found["against"]["horizons_s"]),
        (&json!([1.0, 10.0, 20.0]), &json!([1.0, 10.0, 20.0]))
    );
    let heading = &found["quantities"]["heading"];
    assert!((heading["mean"][2].as_f64().unwrap() / (2e-3 * 0.5 * 19.0) - 1.0).abs() < 1e-6, "{heading}");
    assert_eq!((heading["method"].as_str(), heading["runs"].as_u64()), (Some("Monte Carlo"), Some(500)));
    assert_eq!(found["against"]["quantities"]["heading"]["mean"][2].as_f64(), Some(0.0));
    assert!(found["ratio"]["heading"][2].as_f64().unwrap() > 50.0, "{}", found["ratio"]);
    let table = done(&arguments, 0);
    let first = table.lines().next().unwrap();
    assert!(first.contains("of heading (scale_factor on gyro_z, 100 %)"), "{first}");
    for words in [
        "turn.csv, after 30s of alignment at rest",
        "the motion ends after 20 s: no horizon of 60 s",
        "because of the motion",
    ] {
        assert!(table.contains(words), "{words} is not in {table}");
    }
    let limited = [
        "cost",
        "--model",
        own,
        "--motion",
        "tumble",
        "--horizons",
        "80s",
        "--check",
        "--tolerance",
        "heading=0.01deg/80s",
    ];
    assert!(done(&limited, 4).contains("FAIL: heading"));

    let short = motion(folder.path(), "short.csv", 1, 40.0);
    let fast = motion(folder.path(), "fast.csv", 100, 50.0);
    let broken = folder.path().join("broken.csv");
    std::fs::write(&broken, std::fs::read_to_string(&turn).unwrap().replacen(",0.5,", ",nan,", 1)).unwrap();
    let broken = broken.to_str().unwrap();
    for (more, code, words) in [
        (&["--motion", &*turn, "--horizons", "1min"][..], 2, ["turn.csv ends after 20 s", "within the motion"]),
        (&["--motion", &*turn, "--tolerance", "heading=1deg/30s"], 2, ["ends after 20 s", "before 30 s"]),
        (&["--motion", &*turn, "--real", &*turn], 2, ["--motion", "--real"]),
        (&["--motion", &*short], 1, ["short.csv", "single row"]),
        (&["--motion", &*fast], 1, ["fast.csv", "50 rows per second"]),
        (&["--motion", broken], 1, ["broken.csv, line 42", "a finite number"]),
        (&["--motion", "absent.csv"], 74, ["absent.csv", "cannot be read"]),
        (&["--motion", "tumble", "--horizons", "10s"], 2, ["`tumble` needs 78 s", "last horizon"]),
    ] {
        let ended = vn100d(&[&["cost", "--model", own], more].concat());
        let text = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(code), "{more:?}: {text}");
        assert!(ended.stdout.is_empty(), "{more:?}");
        for word in words {
            assert!(text.contains(word), "{more:?}: {word} is not in {text}");
        }
    }
}

#[test]
fn what_makes_no_sense_is_refused_with_what_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let file = model(folder.path(), "unit.json", &json!({"gyro_z": {"N": 1e-4}}));
    let mag = model(folder.path(), "mag.json", &json!({"mag_x": {"N": 1e-4}}));
    for (more, code, words) in [
        (&["--model", &*file, "--horizons", "0s"][..], 2, ["a horizon of 0 s", "above 0"]),
        (&["--model", &*file, "--horizons", "-1s"], 2, ["-1s", "30s or 500ms"]),
        (&["--model", &*file, "--horizons", "10s,1s"], 2, ["1 s after one of 10 s", "increasing"]),
        (&["--model", &*file, "--align", "0s"], 2, ["alignment", "such as 30s"]),
        (&["--model", &*file, "--tolerance", "yaw=1deg/1s"], 2, ["yaw", "attitude_x"]),
        (&["--model", &*file, "--tolerance", "heading=1m/1s"], 2, ["heading=1m/1s", "deg, rad or mrad"]),
        (&["--model", &*file, "--tolerance", "position=1m/1s"], 2, ["position_x", "one of heading"]),
        (&["--model", &*file, "--check"], 2, ["--tolerance", "--check"]),
        (&["--model", &*mag], 1, ["mag.json", "gyro_x"]),
        (&["--model", "absent.json"], 74, ["absent.json", "cannot be read"]),
        (&["--model", &*file, "--temperature", "absent.csv"], 74, ["absent.csv", "neither °C nor a file"]),
    ] {
        let ended = vn100d(&[&["cost"], more].concat());
        let text = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(code), "{more:?}: {text}");
        assert!(ended.stdout.is_empty(), "{more:?}");
        for word in words {
            assert!(text.contains(word), "{more:?}: {word} is not in {text}");
        }
    }
}
