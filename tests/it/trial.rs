//! The blind check of the diagnosis, from the command line: order, seals, thresholds, recordings. Longer trials measure
//! its quality (`docs/validation.md`); this short one fails if it no longer works.

use crate::world::vn100d;
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use std::path::Path;
use vn100_testkit::real_data;

fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn a_trial_seals_its_keys_before_it_diagnoses_and_counts_afterwards() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (out, page) = (path("trial"), path("page.html"));
    let kinds = ["--cases", "4", "--seed", "31", "--kinds", "none,tone,chirp"];
    let ended = vn100d(&[&["trial", "--json", "--out", &out, "--html", &page], &kinds[..]].concat());
    let stderr = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(0), "{stderr}");
    let score: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!((&score["format"], &score["cases"]), (&"vn100d-trial-1".into(), &4.into()));
    assert_eq!(score["rates"]["refused"]["count"], 0, "{score}");

    let read = |name: &str| std::fs::read(folder.path().join("trial").join(name)).unwrap();
    let manifest = read("manifest.json");
    assert_eq!(score["manifest_sha256"], hex(&manifest));
    assert!(stderr.contains(&hex(&manifest)), "{stderr}");
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    let keys: Vec<imu_trial::Key> = serde_json::from_slice(&read("key.json")).unwrap();
    for (key, digest) in keys.iter().zip(manifest["digests"].as_array().unwrap()) {
        assert_eq!(*digest, hex(serde_json::to_string(key).unwrap().as_bytes()));
        let report: Value = serde_json::from_slice(&read(&format!("reports/{:05}.json", key.case))).unwrap();
        assert_eq!(report["format"], "vn100d-diagnosis-1");
        assert!(!report.to_string().contains(&key.salt));
    }
    assert_eq!(keys.iter().filter(|key| !key.effects.is_empty()).count(), 3);
    assert!(std::fs::read_to_string(&page).unwrap().contains("Trial of the diagnosis"));
}

/// Fails if the engine gets clearly worse in the wide ranges: bounds are its results when the ranges were widened, less
/// the scatter of 48 cases. It takes some twenty seconds of one processor.
#[test]
fn a_short_trial_reaches_what_the_diagnosis_is_known_to() {
    let least =
        ["right_first=0.7", "cause_and_sense_first=0.7", "all_found=0.6", "outside_answered=0.5", "channels_exact=0.9"];
    let most = ["none_named=0.13", "none_unknown=0.13", "library_unknown=0.2", "spurious=0.5", "refused=0"];
    let mut arguments = vec!["trial", "--json", "--cases", "48", "--samples", "16384", "--seed", "41"];
    arguments.extend(least.iter().flat_map(|one| ["--at-least", one]));
    arguments.extend(most.iter().flat_map(|one| ["--at-most", one]));
    let ended = vn100d(&arguments);
    assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    let score: Value = serde_json::from_slice(&ended.stdout).unwrap();
    let kinds = score["kinds"].as_array().unwrap();
    let bounded: Vec<&Value> = kinds.iter().filter(|of| of["detection"]["bound_90"].is_f64()).collect();
    assert!(bounded.len() > 3, "{kinds:?}");
    for of in bounded {
        assert_eq!(of["detection"]["samples"], 65_536);
        assert!(
            of["detection"]["bound_90"].as_f64() < of["detection"]["limit"].as_f64().map(|limit| 1.05 * limit),
            "{of}"
        );
    }
    let error = score["calibration"]["expected_error"].as_f64();
    assert!(error.is_some_and(|error| error < 0.35), "{}", score["calibration"]);
}

/// Returns a recording of two channels that already has a line and a resolution.
fn recording(folder: &Path) -> String {
    let model = r#"{ "format": "vn100d-sensor-model-1", "name": "desk", "rate_hz": 40, "channels": {
        "accel_y": { "N": 0.002, "B": 4e-4, "K": 2e-5, "bias": 0.1, "effects": [
            { "effect": "tone", "frequency_hz": 13.378, "amplitude": 0.004 }, { "effect": "resolution", "step": 0.01 } ] },
        "accel_z": { "N": 0.002, "B": 4e-4, "K": 2e-5, "bias": -9.8 } } }"#;
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let (model_path, out) = (path("desk.json"), path("desk.csv"));
    std::fs::write(&model_path, model).unwrap();
    let made = vn100d(&["simulate", "--model", &model_path, "--duration", "20min", "--seed", "8", "--out", &out]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    out
}

#[test]
fn effects_on_a_recording_are_found_and_its_own_are_no_false_alarms() {
    let folder = tempfile::tempdir().unwrap();
    let desk = recording(folder.path());
    let out = folder.path().join("trial");
    let kinds = ["--cases", "8", "--seed", "5", "--samples", "16000", "--kinds", "none,bursts,tone,low_pass,timing"];
    let on = ["trial", "--json", "--on", &desk, "--out", out.to_str().unwrap()];
    let ended = vn100d(&[&on[..], &kinds[..]].concat());
    let stderr = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(0), "{stderr}");
    let score: Value = serde_json::from_slice(&ended.stdout).unwrap();
    // 48,000 samples make three stretches.
    assert_eq!((&score["on"]["stretches"], &score["on"]["recording"]), (&3.into(), &desk.into()));
    assert_eq!((&score["cases"], &score["rates"]["refused"]["count"]), (&8.into(), &0.into()), "{score}");
    let keys: Vec<imu_trial::Key> = serde_json::from_slice(&std::fs::read(out.join("key.json")).unwrap()).unwrap();
    for key in &keys {
        assert_eq!((key.samples, key.channels.len()), (16_000, 2));
        for effect in &key.effects {
            // The line of accel_y could not be distinguished from another.
            assert!(effect.kind != imu_trial::Kind::Tone || effect.channels == ["accel_z"], "{key:?}");
        }
        assert!(out.join(format!("reports/{:05}-own.json", key.case)).exists());
    }
    assert!(keys.iter().any(|key| !key.effects.is_empty()));
    assert_eq!(score["rates"]["none_named"]["count"], 0, "{score}");
    assert!(score["rates"]["right_first"]["share"].as_f64() >= Some(0.7), "{score}");
}

/// A trial on the data of a VN-100 on a desk: five minutes in a release build.
#[test]
#[ignore = "diagnoses the recording and cases of it: cargo test --release --test it trial_on_a_desk -- --ignored"]
fn a_trial_on_a_desk_recording_finds_what_is_imposed() {
    let Some(file) = real_data("vn100-desk/live_capture.txt.gz") else { return };
    let on = ["trial", "--json", "--on", file.to_str().unwrap(), "--rate", "40", "--samples", "15000"];
    let ended = vn100d(&[&on[..], &["--cases", "30", "--seed", "6", "--kinds", "none,single"]].concat());
    assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    let score: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!((&score["on"]["stretches"], &score["rates"]["refused"]["count"]), (&2.into(), &0.into()), "{score}");
    assert!(score["rates"]["right_first"]["share"].as_f64() >= Some(0.7), "{:#}", score["rates"]);
    assert!(score["rates"]["none_named"]["share"].as_f64() <= Some(0.3), "{:#}", score["rates"]);
}

#[test]
fn a_recording_that_is_too_short_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("short.csv");
    let rows: String =
        (0..500).map(|i| format!("{:.3},{:.6}\n", f64::from(i) * 0.025, f64::from(i * 7919 % 1000) * 1e-6)).collect();
    std::fs::write(&file, format!("time_s,gyro_x_rad_s\n{rows}")).unwrap();
    let ended = vn100d(&["trial", "--on", file.to_str().unwrap(), "--cases", "2"]);
    let stderr = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("500 samples") && stderr.contains("10000"), "{stderr}");
}

/// The findings are tested on a second record and on the output of the corrected model.
#[test]
fn what_is_found_is_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("trial");
    let arguments = ["--cases", "2", "--seed", "12", "--samples", "16384", "--kinds", "tone", "--again"];
    let ended = vn100d(&[&["trial", "--json", "--out", out.to_str().unwrap()], &arguments[..]].concat());
    assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    let score: Value = serde_json::from_slice(&ended.stdout).unwrap();
    for name in ["second_clean", "itself_clean", "cause_returns"] {
        assert_eq!(score["rates"][name]["of"], 2, "{name}: {}", score["rates"]);
    }
    assert_eq!(score["rates"]["cause_returns"]["count"], 2, "{}", score["rates"]);
    assert!(out.join("reports/00000-again.json").exists());
}

#[test]
fn what_is_asked_for_is_checked_first() {
    for (arguments, part) in [
        (["--kinds", "tune"], "`tune`"),
        (["--at-least", "right=0.9"], "right_first"),
        (["--at-most", "spurious=2"], "NAME=SHARE"),
        (["--cases", "0"], "no such case"),
        (["--samples", "900"], "10000 or more"),
        (["--suite", "1999"], "2026"),
    ] {
        let ended = vn100d(&[&["trial"], &arguments[..]].concat());
        let stderr = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains(part), "{stderr}");
    }
}
