//! The diagnosis from the command line: a missing effect is named and added, and the gap closes; without the effect it
//! opens again.

use crate::world::{World, program, vn100d};
use serde_json::{Value, json};
use std::path::Path;

fn model(folder: &Path, name: &str, channels: &Value) -> String {
    let model = json!({"format": "vn100d-sensor-model-1", "name": name, "rate_hz": 40, "channels": channels});
    write(folder, &format!("{name}.json"), &model.to_string())
}

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn done(arguments: &[&str]) -> String {
    let ended = vn100d(arguments);
    assert!(ended.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
    String::from_utf8(ended.stdout).unwrap()
}

fn diagnosed(real: &str, sim: &str, more: &[&str]) -> Value {
    let arguments = [&["--json", "diagnose", "--real", real, "--sim", sim][..], more].concat();
    serde_json::from_str(&done(&arguments)).unwrap()
}

fn effects(of: &Value) -> Vec<&str> {
    of["causes"].as_array().unwrap().iter().map(|cause| cause["effect"].as_str().unwrap()).collect()
}

#[test]
fn a_cause_that_is_added_closes_the_gap_and_taken_out_opens_it_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let plain = json!({"gyro_x": {"N": 1e-4, "B": 2e-5, "K": 1e-6}, "accel_z": {"N": 0.002, "B": 4e-4, "K": 2e-5, "bias": -9.8}});
    let mut rich = plain.clone();
    rich["accel_z"]["effects"] =
        json!([{"effect": "resonance", "frequency_hz": 9.1, "bandwidth_hz": 0.5, "sigma": 0.004}]);
    rich["gyro_x"]["effects"] = json!([{"effect": "spikes", "rate_hz": 0.05, "amplitude": 0.006}]);
    let (plain, rich) = (model(folder.path(), "plain", &plain), model(folder.path(), "rich", &rich));
    let (real, better) = (path("real.csv"), path("better.json"));
    done(&["simulate", "--model", &rich, "--duration", "20min", "--seed", "5", "--out", &real]);
    let found = diagnosed(&real, &plain, &["--augmented-model", &better]);
    assert_eq!(found["format"], "vn100d-diagnosis-1");
    assert_eq!(found["verdict"], "effects", "{found:#}");
    let mut names = effects(&found);
    names.sort_unstable();
    assert_eq!(names, ["resonance", "spikes"], "{found:#}");
    for cause in found["causes"].as_array().unwrap() {
        let channel = if cause["effect"] == "spikes" { "gyro_x" } else { "accel_z" };
        assert_eq!(cause["channels"], json!([channel]));
        assert!(cause["confidence"].as_f64().unwrap() > 0.9 && !cause["evidence"].as_array().unwrap().is_empty());
    }
    assert!(found["discrepancy"]["closed"].as_f64().unwrap() > 0.9, "{found:#}");
    let place = &found["where"][0];
    assert!(place["band_hz"][0].as_f64().unwrap() < 9.5 && place["band_hz"][1].as_f64().unwrap() > 8.7, "{found:#}");
    // The output of the corrected model must match the model.
    let again = path("again.csv");
    done(&["simulate", "--model", &better, "--duration", "20min", "--seed", "6", "--out", &again]);
    let closed = diagnosed(&again, &better, &[]);
    assert_eq!((closed["verdict"].as_str(), effects(&closed)), (Some("no_gap"), vec![]), "{closed:#}");
    // And so must the recording itself.
    let closed = diagnosed(&real, &better, &[]);
    assert_eq!(effects(&closed), Vec::<&str>::new(), "{closed:#}");
    assert_ne!(closed["verdict"], "unknown_effect", "{closed:#}");
    // Without a cause it is named again.
    let mut less: Value = serde_json::from_str(&std::fs::read_to_string(&better).unwrap()).unwrap();
    less["channels"]["accel_z"]["effects"] = json!([]);
    less["channels"]["accel_z"].as_object_mut().unwrap().remove("uncertainty");
    let less = write(folder.path(), "less.json", &less.to_string());
    let open = diagnosed(&again, &less, &[]);
    assert_eq!(effects(&open), ["resonance"], "{open:#}");
    // The user gets one sentence first, also on the page.
    let page = path("page.html");
    let printed = done(&["diagnose", "--real", &real, "--sim", &plain, "--html", &page]);
    let sentence = printed.lines().next().unwrap();
    assert!(sentence.contains("that the model lacks"), "{printed}");
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.contains(&format!("<h1>{sentence}</h1>")) && html.contains("<path class=\"line after\""), "{html}");
    let again = vn100d(&["diagnose", "--real", &real, "--sim", &plain, "--html", &page]);
    let stderr = String::from_utf8(again.stderr).unwrap();
    assert!(again.status.code() == Some(73) && stderr.contains("--force"), "{stderr}");
    let both = vn100d(&["diagnose", "--real", &real, "--sim", &plain, "--html", "x", "--augmented-model", "./x"]);
    assert_eq!(both.status.code(), Some(2), "{}", String::from_utf8_lossy(&both.stderr));
}

#[test]
fn what_is_merely_off_is_no_cause_and_another_simulators_recording_is_as_good_as_its_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let channel = |n: f64| json!({"gyro_y": {"N": n, "B": 2e-5, "K": 1e-6}});
    let declared = model(folder.path(), "told", &channel(1e-4));
    let true_one = model(folder.path(), "true", &channel(1.2e-4));
    let (real, other) = (path("real.csv"), path("other.csv"));
    done(&["simulate", "--model", &true_one, "--duration", "20min", "--seed", "8", "--out", &real]);
    done(&["simulate", "--model", &true_one, "--duration", "20min", "--seed", "9", "--out", &other]);
    let off = diagnosed(&real, &declared, &[]);
    assert_eq!((off["verdict"].as_str(), effects(&off)), (Some("parameters"), vec![]), "{off:#}");
    let n = off["parameters"].as_array().unwrap().iter().find(|one| one["parameter"] == "N").unwrap();
    assert!((n["ratio"].as_f64().unwrap() / 1.2 - 1.0).abs() < 0.02, "{n}");
    let same = diagnosed(&real, &other, &[]);
    assert_eq!((same["verdict"].as_str(), effects(&same)), (Some("no_gap"), vec![]), "{same:#}");
}

#[test]
fn stamps_that_scatter_are_found_in_a_table_and_in_a_capture_of_it_and_times_are_the_captures() {
    let world = World::new();
    let path = |name: &str| world.path(name).to_str().unwrap().to_owned();
    let folder = world.path("models");
    std::fs::create_dir(&folder).unwrap();
    let plain = json!({"gyro_x": {"N": 1e-4, "B": 2e-5, "K": 1e-6}});
    let mut rich = plain.clone();
    rich["gyro_x"]["effects"] = json!([
        {"effect": "timing", "jitter_s": 0.001, "drop_probability": 0.01},
        {"effect": "bias_step", "at_s": 700, "size": 0.01}
    ]);
    let (plain, rich) = (model(&folder, "plain", &plain), model(&folder, "rich", &rich));
    let (whole, real, better) = (path("whole.csv"), path("real.csv"), path("better.json"));
    done(&["simulate", "--model", &rich, "--duration", "20min", "--seed", "5", "--out", &whole]);
    // The recording has a hole of more than a minute: the part after it is compared.
    let text = std::fs::read_to_string(&whole).unwrap();
    let at = |line: &str| line.split(',').next().unwrap().parse::<f64>().ok();
    let kept = text.lines().filter(|line| !at(line).is_some_and(|s| (100.0..300.0).contains(&s)));
    std::fs::write(&real, kept.flat_map(|line| [line, "\n"]).collect::<String>()).unwrap();
    let data = path("data");
    done(&["--data-dir", &data, "import", &real, "--name", "table"]);
    for (name, more) in [(real.as_str(), ["--augmented-model", &better]), ("table", ["--data-dir", &data])] {
        let found = diagnosed(name, &plain, &more);
        let mut names = effects(&found);
        names.sort_unstable();
        assert_eq!(names, ["bias_step", "timing"], "{name}: {found:#}");
        let of = |effect: &str| found["causes"].as_array().unwrap().iter().find(|one| one["effect"] == effect).unwrap();
        let timing = &of("timing")["parameters"]["gyro_x"];
        assert!((timing["jitter_s"].as_f64().unwrap() / 0.001 - 1.0).abs() < 0.05, "{name}: {timing}");
        assert!((timing["drop_probability"].as_f64().unwrap() / 0.01 - 1.0).abs() < 0.2, "{name}: {timing}");
        // Places are counted at the rate of the median step, which scattering stamps determine to some 1e-4.
        let step = &of("bias_step")["parameters"]["gyro_x"];
        assert!((step["at_s"].as_f64().unwrap() - 700.0).abs() < 0.5, "{name}: {step}");
        let interval = &of("bias_step")["uncertainty"]["gyro_x"][0]["at_s"];
        assert!(interval[0].as_f64() > Some(699.0) && interval[1].as_f64() < Some(701.0), "{interval}");
        let place = &found["where"][0];
        assert!(place["from_s"].as_f64() >= Some(300.0) && place["to_s"].as_f64() <= Some(1201.0), "{place}");
        assert!(found["notes"].to_string().contains("begin at its 300"), "{found:#}");
    }
    let better: Value = serde_json::from_str(&std::fs::read_to_string(&better).unwrap()).unwrap();
    let added = better["channels"]["gyro_x"]["effects"].as_array().unwrap();
    let step = added.iter().find(|effect| effect["effect"] == "bias_step").unwrap();
    assert!((step["at_s"].as_f64().unwrap() - 400.0).abs() < 0.5, "a model is run from its own begin: {step}");
}

#[test]
fn what_cannot_be_compared_is_refused_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let simulator = model(folder.path(), "m", &json!({"gyro_x": {"N": 1e-4}, "gyro_y": {"N": 1e-4}}));
    let noise = |index: u32| 1e-3 * (f64::from(index) * 12.9898).sin() * 43758.5453 % 1e-3;
    let csv = |name: &str, rows: u32, values: &dyn Fn(u32) -> String, header: &str| {
        let lines: String = (0..rows).map(|i| format!("{:.3},{}\n", f64::from(i) / 40.0, values(i))).collect();
        write(folder.path(), name, &format!("time_s,{header}\n{lines}"))
    };
    let both = |i: u32| format!("{:.9},{:.9}", noise(i), noise(i + 7));
    for (file, part) in [
        (csv("short.csv", 400, &both, "gyro_x_rad_s,gyro_y_rad_s"), "400 samples; at least 1000"),
        (csv("one.csv", 2000, &|i| format!("{:.9}", noise(i)), "gyro_x_rad_s"), "no gyro_y, which the model has"),
        (
            csv("constant.csv", 2000, &|i| format!("{:.9},0.25", noise(i)), "gyro_x_rad_s,gyro_y_rad_s"),
            "gyro_y shows the same value throughout, 0.25",
        ),
    ] {
        let ended = vn100d(&["diagnose", "--real", &file, "--sim", &simulator]);
        let stderr = String::from_utf8(ended.stderr).unwrap();
        assert!(
            !ended.status.success() && stderr.contains(part) && stderr.trim().lines().count() == 1,
            "{file}: {stderr}"
        );
        assert!(ended.stdout.is_empty());
    }
}

#[test]
fn a_calibration_is_kept_and_found_again_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let channels = json!({"gyro_x": {"N": 1e-4, "B": 2e-5, "K": 1e-6,
        "effects": [{"effect": "tone", "frequency_hz": 7.3, "amplitude": 3e-4}]}});
    let rich = model(folder.path(), "rich", &channels);
    let plain = model(folder.path(), "plain", &json!({"gyro_x": {"N": 1e-4, "B": 2e-5, "K": 1e-6}}));
    let real = path("real.csv");
    done(&["simulate", "--model", &rich, "--duration", "40s", "--seed", "5", "--out", &real]);
    let cache = path("cache");
    let calibrated = || {
        let arguments = ["--json", "diagnose", "--real", &real, "--sim", &plain, "--calibrate"];
        let ended = program().args(arguments).env("XDG_CACHE_HOME", &cache).output().unwrap();
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
        serde_json::from_slice::<Value>(&ended.stdout).unwrap()
    };
    let found = calibrated();
    assert_eq!(effects(&found), ["tone"], "{found:#}");
    let files: Vec<_> =
        std::fs::read_dir(folder.path().join("cache/vn100d")).unwrap().map(|file| file.unwrap()).collect();
    let [file] = &files[..] else { panic!("{files:?}") };
    let kept = std::fs::read_to_string(file.path()).unwrap();
    assert!(serde_json::from_str::<Value>(&kept).unwrap()["kinds"]["tone"]["offset"].as_f64().unwrap() > 4.0);
    assert_eq!(calibrated(), found, "from the cache");
    // A broken file is made again with the same content.
    std::fs::write(file.path(), &kept[..kept.len() / 2]).unwrap();
    assert_eq!(calibrated(), found, "made anew");
    assert_eq!(std::fs::read_to_string(file.path()).unwrap(), kept);
}
