//! Sensor models and their simulator, from the command line: simulated parameters are found again, motions are
//! followed, invalid input is refused, and a plain N-B-K model of a real record lacks effects.

use crate::world::vn100d;
use serde_json::{Value, json};
use std::path::Path;
use vn100_testkit::real_data;

/// Writes a model; returns its path.
fn model(folder: &Path, channels: Value, more: Value) -> String {
    let mut model = json!({"format": "vn100d-sensor-model-1", "name": "test", "rate_hz": 40, "channels": channels});
    for (key, value) in more.as_object().unwrap() {
        model[key] = value.clone();
    }
    let path = folder.join("model.json");
    std::fs::write(&path, model.to_string()).unwrap();
    path.to_str().unwrap().to_owned()
}

fn done(arguments: &[&str]) -> String {
    let ended = vn100d(arguments);
    assert!(ended.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
    String::from_utf8(ended.stdout).unwrap()
}

fn json_of(arguments: &[&str]) -> Value {
    serde_json::from_str(&done(arguments)).unwrap()
}

fn refused(arguments: &[&str]) -> (Option<i32>, String) {
    let ended = vn100d(arguments);
    assert!(ended.stdout.is_empty(), "{arguments:?}");
    let stderr = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(stderr.trim().lines().count(), 1, "{stderr}");
    (ended.status.code(), stderr)
}

/// Returns the number of an effect's parameter in a fitted model.
fn parameter(model: &Value, channel: &str, effect: &str, key: &str) -> f64 {
    let effects = model["channels"][channel]["effects"].as_array().unwrap();
    let found = effects.iter().find(|of| of["effect"] == effect);
    found.unwrap_or_else(|| panic!("no {effect} on {channel}: {effects:?}"))[key].as_f64().unwrap()
}

#[test]
fn what_is_simulated_is_what_a_fit_finds() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let channels = json!({
        "accel_x": {"N": 0.002, "B": 5e-4, "K": 3e-4, "bias": 0.1},
        "accel_y": {"N": 0.002, "effects": [{"effect": "tone", "frequency_hz": 7.31, "amplitude": 0.004}]},
        "accel_z": {"N": 0.002, "bias": -9.8, "effects": [{"effect": "resolution", "step": 0.001}]},
        "gyro_x": {"N": 1e-4, "effects": [{"effect": "gauss_markov", "sigma": 3e-4, "tc_s": 30}]},
        "gyro_y": {"N": 1e-4, "effects": [{"effect": "warm_up", "amplitude": -0.002, "tau_s": 600}]},
        "gyro_z": {"N": 1e-4, "effects": [{"effect": "temperature_bias", "per_c": 5e-4, "reference_c": 25}]},
        "mag_x": {"N": 1e-5, "effects": [{"effect": "quantization_noise", "Q": 4e-6}]},
        "mag_y": {"N": 3e-4, "effects": [{"effect": "rate_ramp", "R": 2e-6}]},
        "mag_z": {"N": 3e-4, "effects": [{"effect": "resonance", "frequency_hz": 9, "bandwidth_hz": 0.6, "sigma": 0.001}]},
        "temperature": {"N": 0.002},
    });
    let file = model(folder.path(), channels.clone(), json!({}));
    // Up, down and up again: no drift.
    let course = path("course.csv");
    std::fs::write(&course, "time_s,temperature_c\n0,20\n1500,26\n3200,21\n5000,27\n7200,22\n").unwrap();
    let (csv, fitted) = (path("sim.csv"), path("fitted.json"));
    let simulate = ["simulate", "--model", &file, "--duration", "2h", "--seed", "11", "--temperature", &course];
    done(&[&simulate[..], &["--out", &csv]].concat());
    done(&["model", "fit", &csv, "--effects", "all", "--out", &fitted]);
    let found: Value = serde_json::from_str(&std::fs::read_to_string(&fitted).unwrap()).unwrap();
    // Of 95 % intervals and limits one in twenty does not hold.
    let (mut held, mut failed) = (0, Vec::new());
    for (channel, truth) in channels.as_object().unwrap().iter().filter(|(channel, _)| *channel != "temperature") {
        for key in ["N", "B", "K"] {
            let truth = truth[key].as_f64().unwrap_or(0.0);
            // Rounding to 0.001 adds a twelfth of the squared step per sample: 0.001²/12/40 to N².
            let truth =
                if channel == "accel_z" && key == "N" { f64::hypot(truth, 0.001 / 480f64.sqrt()) } else { truth };
            let about = &found["channels"][channel]["uncertainty"][key];
            match (about["ci95"].as_array(), about["upper_limit95"].as_f64()) {
                (Some(ends), _) => {
                    let [low, high] = [0, 1].map(|end: usize| ends[end].as_f64().unwrap());
                    let inside = (low..=high).contains(&truth);
                    held += usize::from(inside);
                    failed.extend((!inside).then(|| format!("{channel} {key}: {truth} in {low}–{high}")));
                }
                (None, Some(limit)) => {
                    held += usize::from(truth < limit);
                    failed.extend((truth >= limit).then(|| format!("{channel} {key}: {truth} < {limit}")));
                }
                // A Gauss–Markov process beside a walk may leave one of them undetermined.
                (None, None) => assert_eq!(truth, 0.0, "{channel} {key}: {about}"),
            }
        }
    }
    assert!(held >= 20 && failed.len() <= 2, "{held} held, not {failed:?}");
    for (channel, effect, key, truth, share) in [
        ("accel_y", "tone", "frequency_hz", 7.31, 1e-3),
        ("accel_y", "tone", "amplitude", 0.004, 0.1),
        ("accel_z", "resolution", "step", 0.001, 1e-6),
        ("gyro_x", "gauss_markov", "sigma", 3e-4, 0.25),
        ("gyro_x", "gauss_markov", "tc_s", 30.0, 0.4),
        ("gyro_y", "warm_up", "amplitude", -0.002, 0.1),
        ("gyro_y", "warm_up", "tau_s", 600.0, 0.1),
        ("gyro_z", "temperature_bias", "per_c", 5e-4, 0.02),
        ("mag_x", "quantization_noise", "Q", 4e-6, 0.05),
        ("mag_y", "rate_ramp", "R", 2e-6, 0.02),
    ] {
        let value = parameter(&found, channel, effect, key);
        assert!((value / truth - 1.0).abs() < share, "{channel} {effect} {key}: {value}, simulated {truth}");
    }
    // A narrow band may be found as a tone and a band beside it: together they have its power.
    let of_band = found["channels"]["mag_z"]["effects"].as_array().unwrap();
    let square = |of: &Value, key: &str| of[key].as_f64().map_or(0.0, |value| value * value);
    let power: f64 = of_band.iter().map(|of| 0.5 * square(of, "amplitude") + square(of, "sigma")).sum();
    assert!((power / 1e-6 - 1.0).abs() < 0.2, "{of_band:?}");
    assert!(of_band.iter().all(|of| (of["frequency_hz"].as_f64().unwrap() / 9.0 - 1.0).abs() < 0.05), "{of_band:?}");
    // The bias does not include the effects' mean contribution to the level.
    for (channel, level, allowed) in
        [("accel_z", -9.8, 1e-4), ("gyro_y", 0.0, 3e-5), ("gyro_z", 0.0, 1e-3), ("mag_y", 0.0, 1e-4)]
    {
        let bias = found["channels"][channel]["bias"].as_f64().unwrap();
        assert!((bias - level).abs() < allowed, "{channel}: {bias}");
    }
    // Effects are fitted if requested, and the fitted model can be simulated unchanged. N, B and K alone contradict the
    // bias that follows the temperature: such a model is written only with --force.
    let plain = json_of(&["model", "fit", &csv, "--force"]);
    assert!(plain["provenance"]["not_usable"].as_str().is_some_and(|why| why.contains("gyro_z")), "{plain}");
    assert!(plain["channels"].as_object().unwrap().values().all(|of| of.get("effects").is_none()), "{plain}");
    assert_eq!(plain["provenance"]["capture"], csv.as_str());
    done(&["simulate", "--model", &fitted, "--duration", "1min", "--out", &path("again.csv")]);
    let shown = done(&["model", "show", &fitted]);
    let has_row = |parameter: &str, value: &str| {
        let mut lines = shown.lines().map(|line| line.split('┆').map(str::trim).collect::<Vec<_>>());
        lines.any(|cells| matches!(cells.as_slice(), [_, name, of, ..] if *name == parameter && of.starts_with(value)))
    };
    assert!(has_row("tone.frequency_hz", "7.3") && has_row("resolution.step", "0.001"), "{shown}");
    assert!(shown.lines().all(|line| line.chars().count() <= 80), "{shown}");
    let differ = json_of(&["--json", "model", "diff", &file, &fitted]);
    let paths: Vec<&str> = differ.as_array().unwrap().iter().map(|of| of["path"].as_str().unwrap()).collect();
    assert!(paths.contains(&"channels.accel_x.N") && paths.contains(&"channels.gyro_x.effects.gauss_markov.sigma"));
    assert!(!paths.contains(&"rate_hz"), "{paths:?}");
    let differ = done(&["model", "diff", &file, &fitted]);
    assert!(differ.lines().all(|line| line.chars().count() <= 80) && differ.contains("accel_x.N"), "{differ}");
    assert!(done(&["model", "diff", &file, &file]).contains("no difference"));
    let kalibr = done(&["model", "export", &fitted, "--format", "kalibr"]);
    assert!(kalibr.contains("gyroscope_noise_density: ") && kalibr.contains("tone of accel_y"), "{kalibr}");
}

#[test]
fn a_capture_is_made_marked_as_simulated_with_every_lost_sample_accounted_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let channels = json!({"gyro_x": {"N": 1e-4, "effects": [
        {"effect": "timing", "jitter_s": 1e-4, "drop_probability": 0.01}]}});
    let file = model(folder.path(), channels, json!({}));
    let data = path("data");
    let simulate = ["simulate", "--model", &file, "--duration", "10min", "--seed", "4"];
    let made = json_of(&[&["--json", "--data-dir", &data], &simulate[..], &["--into-db", "sim"]].concat());
    // Samples lost before the first or after the last one do not count as missing.
    let all = made["samples"].as_u64().unwrap() + made["missing"].as_u64().unwrap();
    assert!((23_990..=24_000).contains(&all), "{made}");
    let missing = made["missing"].as_u64().unwrap();
    assert!((150..350).contains(&missing), "{made}");
    let capture = json_of(&["--json", "--data-dir", &data, "show", "sim"]);
    assert_eq!((capture["state"].as_str(), capture["source"].as_str()), (Some("simulated"), Some("simulator")));
    assert_eq!((&capture["samples"], &capture["missing"]), (&made["samples"], &made["missing"]));
    assert_eq!(capture["configuration"]["seed"], 4);
    done(&["check", &path("data/vn100d.db")]);
    // The samples are those of the file, and a name cannot be used twice.
    let csv = path("sim.csv");
    done(&[&simulate[..], &["--out", &csv]].concat());
    let parameters = |arguments: &[&str]| json_of(arguments)["channels"]["gyro_x"]["N"]["value"].as_f64().unwrap();
    let (one, other) =
        (parameters(&["--json", "noise", &csv]), parameters(&["--json", "--data-dir", &data, "noise", "sim"]));
    // The rate of a file is that of its median step, which jitters too.
    assert!((one / other - 1.0).abs() < 1e-3, "{one} {other}");
    let (_, stderr) = refused(&[&["--data-dir", &data], &simulate[..], &["--into-db", "sim"]].concat());
    assert!(stderr.contains("sim"), "{stderr}");
    let once = std::fs::read(&csv).unwrap();
    done(&[&simulate[..], &["--out", &csv, "--force"]].concat());
    assert_eq!(std::fs::read(&csv).unwrap(), once, "the same seed, the same samples");
    assert_eq!(done(&[&simulate[..], &["--out", "-"]].concat()).into_bytes(), once);
}

#[test]
fn a_motion_is_followed_and_read_back_from_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let axes = |triad: &str, of: Value| {
        ["x", "y", "z"].map(|axis| (format!("{triad}_{axis}"), of.clone())).into_iter().collect::<Vec<_>>()
    };
    let channels: serde_json::Map<String, Value> =
        axes("gyro", json!({})).into_iter().chain(axes("accel", json!({}))).collect();
    let triads = json!({"gyro": {"effects": [{"effect": "scale_factor", "x": 0.01, "y": 0, "z": 0}]}});
    for sampling in [json!({}), json!({"internal_rate_hz": 800, "filter_window": 4})] {
        let mut more = json!({"triads": triads});
        if sampling != json!({}) {
            more["sampling"] = sampling;
        }
        let file = model(folder.path(), Value::Object(channels.clone()), more);
        let (csv, motion, again) = (path("table.csv"), path("motion.csv"), path("again.csv"));
        let simulate = ["simulate", "--model", &file, "--duration", "5min"];
        done(&[&simulate[..], &["--motion", "rate-table", "--motion-out", &motion, "--out", &csv, "--force"]].concat());
        done(&[&simulate[..], &["--motion", &motion, "--out", &again, "--force"]].concat());
        let rows = |path: &str| -> Vec<Vec<f64>> {
            let text = std::fs::read_to_string(path).unwrap();
            text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
        };
        let (table, file, motion) = (rows(&csv), rows(&again), rows(&motion));
        assert_eq!((table.len(), file.len(), motion.len()), (12_000, 12_000, 12_000));
        let mut fastest = 0.0_f64;
        for ((table, file), motion) in table.iter().zip(&file).zip(&motion).skip(1) {
            assert!((table[0] - motion[0]).abs() < 1e-9);
            // Columns of the samples: time, accel, gyro; of the motion: time, gyro, accel.
            for axis in 0..3 {
                let (gyro, accel) = (motion[1 + axis], motion[4 + axis]);
                let expected = if axis == 0 { 1.01 * gyro } else { gyro };
                // The mean of four samples of 1/800 s lags by 1.9 ms; the table changes by 1.75 rad/s².
                assert!((table[4 + axis] - expected).abs() < 0.01, "{table:?} {motion:?}");
                assert!((table[1 + axis] - accel).abs() < 0.1, "{table:?} {motion:?}");
                // Between two rows of a file the motion is linear.
                assert!((table[4 + axis] - file[4 + axis]).abs() < 0.01, "{table:?} {file:?}");
                fastest = fastest.max(gyro.abs());
            }
        }
        assert!((fastest - 200f64.to_radians()).abs() < 1e-3);
    }
}

#[test]
fn what_cannot_be_simulated_is_refused_with_file_place_and_what_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let out = path("out.csv");
    for (gyro_x, words) in [
        (json!({"N": -1e-4}), ["channels.gyro_x.N", "-0.0001"]),
        (json!({"M": 1}), ["channels.gyro_x", "unknown key `M`"]),
        (json!({"effects": [{"effect": "wobble"}]}), ["channels.gyro_x.effects[0]", "wobble"]),
        (
            json!({"effects": [{"effect": "tone", "frequency_hz": 21, "amplitude": 1e-3}]}),
            ["channels.gyro_x.effects[0]", "20"],
        ),
        (json!({"effects": [{"effect": "gauss_markov", "sigma": 1e-3, "tc_s": 0}]}), ["tc_s", "0"]),
        (json!({"K": 1e308}), ["channels.gyro_x.K", "from 0 to 1e30"]),
        (json!({"N": 1, "uncertainty": {"N": 3}}), ["channels.gyro_x.uncertainty.N", "an object"]),
    ] {
        let file = model(folder.path(), json!({ "gyro_x": gyro_x }), json!({}));
        let (code, stderr) = refused(&["simulate", "--model", &file, "--duration", "1min", "--out", &out]);
        assert_eq!(code, Some(1), "{stderr}");
        for words in words.iter().chain(&["model.json"]) {
            assert!(stderr.contains(words), "{words:?} is not in {stderr}");
        }
        assert!(!Path::new(&out).exists());
    }
    let file = model(folder.path(), json!({"gyro_x": {"N": 1e-4}}), json!({}));
    let header = "time_s,ref_gyro_x_rad_s,ref_gyro_y_rad_s,ref_gyro_z_rad_s,ref_accel_x_m_s2,ref_accel_y_m_s2,ref_accel_z_m_s2\n";
    let row = |time_s: f64| format!("{time_s},0,0,0,0,0,-9.8\n");
    let motion = path("motion.csv");
    for (rows, words) in [
        ([0.0, 0.025, 0.05, 0.2].map(row).concat(), ["line 5", "no gaps"]),
        ([0.0, 0.01, 0.02, 0.03].map(row).concat(), ["100", "40"]),
        ("0,0,0,0,0,0,x\n".to_owned(), ["line 2", "`ref_accel_z_m_s2`"]),
        ([1.0, 0.975, 0.95].map(row).concat(), ["line 3", "later than the one before"]),
        (row(0.0), ["single row", "a period apart"]),
    ] {
        std::fs::write(&motion, format!("{header}{rows}")).unwrap();
        let (_, stderr) = refused(&["simulate", "--model", &file, "--motion", &motion, "--out", &out]);
        for words in words.iter().chain(&["motion.csv"]) {
            assert!(stderr.contains(words), "{words:?} is not in {stderr}");
        }
    }
    let twice = path("twice.json");
    std::fs::write(&twice, std::fs::read_to_string(&file).unwrap().replace("{\"N\":", "{\"N\":0,\"N\":")).unwrap();
    for (model, motion, words) in [
        (&twice, "still", "twice.json: channels.gyro_x.N: found `N` a second time"),
        (&file, folder.path().to_str().unwrap(), "cannot be read"),
        (&file, "tumbl", "still, tumble, poses, rate-table"),
    ] {
        let simulate = ["simulate", "--model", model, "--duration", "1min", "--motion", motion, "--out", &out];
        let (_, stderr) = refused(&simulate);
        assert!(stderr.contains(words) && !Path::new(&out).exists(), "{words:?} is not in {stderr}");
    }
    for (arguments, words) in [
        (vec!["--duration", "20s", "--motion", "tumble", "--out", &out], "tumble"),
        (vec!["--motion", "still", "--out", &out], "--duration"),
        (vec!["--duration", "1min", "--motion-out", &motion, "--out", &out], "--motion"),
        (vec!["--duration", "1min"], "--out"),
        (vec!["--duration", "1ms", "--out", &out], "less than a sample"),
        (vec!["--duration", "1min", "--out", &file], "is read"),
        (vec!["--duration", "1min", "--temperature", "-400", "--out", &out], "-273.15"),
        (vec!["--duration", "1min", "--temperature", "warm", "--out", &out], "neither °C nor a file"),
        (vec!["--duration", "1000000h", "--out", &out], "a hundred years"),
        (vec!["--duration", "1min", "--motion", "still", "--motion-out", "-", "--out", &out], "--motion-out -"),
    ] {
        let (_, stderr) = refused(&[&["simulate", "--model", &file], &arguments[..]].concat());
        assert!(stderr.contains(words), "{words:?} is not in {stderr}");
    }
}

#[test]
fn nothing_is_written_over_or_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let hot = json!({"N": 1e-4, "effects": [{"effect": "variance_change", "per_c": 1000}]});
    let file = model(folder.path(), json!({ "gyro_x": hot }), json!({}));
    let (kept, none, motion) = (path("kept.csv"), path("none/out.csv"), path("motion.csv"));
    std::fs::write(&kept, "a night's work").unwrap();
    let simulate = ["simulate", "--model", &file, "--duration", "10min"];
    for (arguments, words) in [
        (vec!["--out", &kept], "kept.csv exists already: choose another name, or say --force"),
        (vec!["--motion", "tumble", "--motion-out", &kept, "--out", &motion], "kept.csv exists already"),
        (vec!["--motion", "tumble", "--motion-out", &motion, "--out", &none], "none/out.csv cannot be written"),
        (vec!["--motion", "tumble", "--motion-out", &motion, "--out", &motion], "cannot be samples and motion"),
        (vec!["--force", "--out", &file], "is read"),
        (vec!["--force", "--temperature", "30", "--out", &kept], "channel gyro_x is no finite number at 0 s"),
    ] {
        let (_, stderr) = refused(&[&simulate[..], &arguments[..]].concat());
        assert!(stderr.contains(words) && !stderr.contains(".vn100d-"), "{words:?} is not in {stderr}");
    }
    done(&["simulate", "--model", &file, "--duration", "1min", "--out", &motion]);
    // A fit must not overwrite its own record.
    for (arguments, words) in [
        (vec!["--out", &kept], "exists already"),
        (vec!["--force", "--out", &motion], "is read"),
        (vec!["--out", &none], "none/out.csv cannot be written: No such file or directory (os error 2)"),
    ] {
        let (_, stderr) = refused(&[&["model", "fit", &motion], &arguments[..]].concat());
        assert!(stderr.contains(words), "{words:?} is not in {stderr}");
    }
    assert_eq!(std::fs::read_to_string(&kept).unwrap(), "a night's work");
    let mut names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["kept.csv", "model.json", "motion.csv"]);
}

/// The plain model of a real record lacks its lines, knocks, creep and resolution; a fit adds some of them if requested.
#[test]
fn a_plain_model_of_the_desk_recording_lacks_its_lines_knocks_creep_and_resolution() {
    let Some(desk) = real_data("vn100-desk/live_capture.txt.gz") else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let desk = desk.to_str().unwrap().to_owned();
    let kinds = |noise: &Value, channel: &str| -> Vec<String> {
        let flags = noise["channels"][channel]["flags"].as_array().unwrap();
        flags.iter().map(|flag| flag["kind"].as_str().unwrap().to_owned()).collect()
    };
    let noise_of = |file: &str| json_of(&["--json", "noise", file]);
    let real = noise_of(&desk);
    let (plain, rich) = (path("plain.json"), path("rich.json"));
    // The vibration on accel z contradicts N, B and K, so that the fit needs --force.
    done(&["model", "fit", &desk, "--out", &plain, "--force"]);
    done(&["model", "fit", &desk, "--effects", "all", "--out", &rich]);
    let (plain_csv, rich_csv) = (path("plain.csv"), path("rich.csv"));
    for (model, csv) in [(&plain, &plain_csv), (&rich, &rich_csv)] {
        done(&["simulate", "--model", model, "--duration", "754s", "--seed", "3", "--out", csv]);
    }
    let plain_noise = noise_of(&plain_csv);
    for (channel, kind) in [("gyro_x", "line"), ("accel_y", "creep"), ("accel_z", "knock")] {
        assert!(kinds(&real, channel).iter().any(|of| of == kind), "{channel} {kind}: {:?}", kinds(&real, channel));
        assert!(kinds(&plain_noise, channel).iter().all(|of| of != kind), "{:?}", kinds(&plain_noise, channel));
    }
    // The vibration is there from 327 s to 477 s, in the simulation as in the record.
    let text = std::fs::read_to_string(&rich_csv).unwrap();
    let place = text.lines().next().unwrap().split(',').position(|name| name == "gyro_x_rad_s").unwrap();
    let cell = |line: &str| line.split(',').nth(place).unwrap().parse::<f64>().unwrap();
    let gyro_x: Vec<f64> = text.lines().skip(1).map(cell).collect();
    let mean = gyro_x.iter().sum::<f64>() / gyro_x.len() as f64;
    let amplitude = |from_s: usize| {
        let sum = |wave: fn(f64) -> f64| -> f64 {
            let turn = |t: usize| wave(std::f64::consts::TAU * (13.3777 * t as f64 / 40.0).fract());
            (40 * from_s..40 * (from_s + 10)).map(|t| (gyro_x[t] - mean) * turn(t)).sum()
        };
        f64::hypot(sum(f64::cos), sum(f64::sin)) / 200.0
    };
    for from_s in (0..740).step_by(10).filter(|from_s| !(310..330).contains(from_s) && !(470..480).contains(from_s)) {
        let allowed = if (330..470).contains(&from_s) { 2.8e-3..4.0e-3 } else { 0.0..8e-4 };
        assert!(allowed.contains(&amplitude(from_s)), "{from_s} s: {}", amplitude(from_s));
    }
    // One LSB of the text is 0.001 m/s². The lines that are not searched for remain, so that the fit needs --force.
    let step = |file: &str| {
        let fitted = json_of(&["model", "fit", file, "--effects", "resolution", "--force"]);
        fitted["channels"]["accel_x"]["effects"][0]["step"].as_f64()
    };
    assert_eq!(step(&desk).map(|step| (step * 1e6).round()), Some(1000.0));
    assert_eq!((step(&plain_csv), step(&rich_csv).map(|step| (step * 1e6).round())), (None, Some(1000.0)));
    // The white level is that of the real record.
    for channel in ["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"] {
        let n = |noise: &Value| noise["channels"][channel]["N"]["value"].as_f64().unwrap();
        assert!((n(&plain_noise) / n(&real) - 1.0).abs() < 0.05, "{channel}: {} {}", n(&plain_noise), n(&real));
    }
}

/// A record behind a filter, with noise behind the filter, its model, and a record of the model: N and the filter stay
/// the same.
#[test]
fn a_filter_of_a_record_is_in_its_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let channels = json!({
        "gyro_x": {"N": 1e-4, "effects": [{"effect": "moving_average", "window": 4, "white_behind": 2e-5}]},
        "gyro_y": {"N": 1e-4, "effects": [{"effect": "low_pass", "cutoff_hz": 7.0, "order": 2, "white_behind": 2e-5}]},
        "gyro_z": {"N": 1e-4},
    });
    let truth = model(folder.path(), channels, json!({}));
    let (first, fitted, second) = (path("first.csv"), path("fitted.json"), path("second.csv"));
    done(&["simulate", "--model", &truth, "--duration", "20min", "--seed", "4", "--out", &first]);
    done(&["model", "fit", &first, "--out", &fitted]);
    done(&["simulate", "--model", &fitted, "--duration", "20min", "--seed", "5", "--out", &second]);
    let (one, other) = (json_of(&["--json", "noise", &first]), json_of(&["--json", "noise", &second]));
    for (channel, n) in [("gyro_x", 1.0198e-4), ("gyro_y", 1.0198e-4), ("gyro_z", 1e-4)] {
        let of = |noise: &Value| noise["channels"][channel].clone();
        let density = |noise: &Value| of(noise)["N"]["value"].as_f64().unwrap();
        assert!((density(&one) / n - 1.0).abs() < 0.02, "{channel}: {}", density(&one));
        assert!(
            (density(&other) / density(&one) - 1.0).abs() < 0.025,
            "{channel}: {} {}",
            density(&one),
            density(&other)
        );
        assert_eq!(of(&one)["bandwidth"]["kind"], of(&other)["bandwidth"]["kind"], "{channel}");
        let value = |noise: &Value| of(noise)["bandwidth"]["value"].as_f64().unwrap_or(1.0);
        assert!((value(&one) / value(&other) - 1.0).abs() < 0.05, "{channel}: {} {}", value(&one), value(&other));
    }
    // A record shows no gap against its own model.
    let found = json_of(&["--json", "diagnose", "--real", &second, "--sim", &fitted]);
    assert!(
        found["causes"].as_array().unwrap().is_empty() && found["parameters"].as_array().unwrap().is_empty(),
        "{found}"
    );
    // --force does not replace a file.
    let (code, stderr) = refused(&["model", "fit", &first, "--out", &fitted, "--force"]);
    assert!(code == Some(73) && stderr.contains("say --overwrite to replace it"), "{stderr}");
    done(&["model", "fit", &first, "--out", &fitted, "--overwrite"]);
}

/// Lines, a band, shared noise and noise behind a filter: N of `diagnose` is that of `noise`, and the plateau of the
/// truth.
#[test]
fn a_diagnosis_has_the_n_of_the_noise() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let shared = |sigma: f64| json!({"effect": "common_mode", "sigma": sigma});
    let channels = json!({
        "gyro_x": {"N": 1.2e-4, "effects": [shared(4e-4), {"effect": "tone", "frequency_hz": 11.3, "amplitude": 1e-3}]},
        "gyro_y": {"N": 1.2e-4, "effects": [shared(5e-4),
            {"effect": "low_pass", "cutoff_hz": 8.0, "order": 2, "white_behind": 4e-5}]},
        "gyro_z": {"N": 1.2e-4, "effects": [
            {"effect": "resonance", "frequency_hz": 14.0, "bandwidth_hz": 1.5, "sigma": 2e-3}]},
    });
    let truth = model(folder.path(), channels, json!({}));
    let record = path("record.csv");
    done(&["simulate", "--model", &truth, "--duration", "12min", "--seed", "9", "--out", &record]);
    let wrong =
        model(folder.path(), json!({"gyro_x": {"N": 2e-4}, "gyro_y": {"N": 2e-4}, "gyro_z": {"N": 2e-4}}), json!({}));
    let found = json_of(&["--json", "diagnose", "--real", &record, "--sim", &wrong]);
    let noise = json_of(&["--json", "noise", &record]);
    let parameters = found["parameters"].as_array().unwrap();
    for (channel, plateau) in [("gyro_x", 1.356e-4), ("gyro_y", 1.491e-4), ("gyro_z", 1.477e-4)] {
        let of = parameters.iter().find(|of| of["channel"] == channel && of["parameter"] == "N");
        let capture = of.unwrap_or_else(|| panic!("{channel}: {found:#}"))["capture"].as_f64().unwrap();
        let owner = noise["channels"][channel]["N"]["value"].as_f64().unwrap();
        assert!((capture / owner - 1.0).abs() < 1e-6, "{channel}: {capture} {owner}");
        assert!((capture / plateau - 1.0).abs() < 0.08, "{channel}: {capture} {plateau}");
    }
}

#[test]
fn raw_counts_are_no_noise_of_a_sensor() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("counts.csv");
    let rows = (0..4000).map(|i| format!("{},{}\n", f64::from(i) / 100.0, 32_771 + i * i % 17));
    std::fs::write(&path, format!("time_s,gyro_x_rad_s\n{}", rows.collect::<String>())).unwrap();
    let path = path.to_str().unwrap();
    let (code, stderr) = refused(&["model", "fit", path]);
    assert!(code == Some(1) && stderr.contains("raw counts? give the scale"), "{stderr}");
    let noise = json_of(&["--json", "noise", path]);
    assert_eq!(noise["channels"]["gyro_x"]["usable"], false, "{noise}");
    // Counts as in a register at rest: the gyroscope's counts could be rad/s, the upright axis could be no
    // acceleration.
    let count = |i: u32, level: f64, wide: u32| level + f64::from(i * i % 97 % (2 * wide)) - f64::from(wide);
    let rows = (0..4000).map(|i| {
        format!("{},{},{},{}\n", f64::from(i) / 100.0, count(i, -30.0, 20), count(i, 50.0, 30), count(i, 16_384.0, 40))
    });
    let header = "time_s,gyro_x_rad_s,accel_x_m_s2,accel_z_m_s2";
    std::fs::write(path, format!("{header}\n{}", rows.collect::<String>())).unwrap();
    let noise = json_of(&["--json", "noise", path]);
    for channel in ["gyro_x", "accel_x", "accel_z"] {
        let reason = noise["channels"][channel]["reason"].as_str().unwrap_or_default();
        let expected =
            "4000 of 4000 values of accel_z are beyond what it can measure in m/s²: raw counts? give the scale";
        assert!(reason.starts_with(expected), "{channel}: {noise}");
    }
    assert_eq!(noise["at_rest_s"], serde_json::Value::Null);
    let (code, stderr) = refused(&["noise", path, "--format", "kalibr"]);
    assert!(
        code == Some(1) && stderr.contains("raw counts? give the scale") && !stderr.contains("at rest"),
        "{stderr}"
    );
    // JSON has the reason in it, whatever format is requested.
    assert_eq!(json_of(&["--json", "noise", path, "--format", "kalibr"])["channels"]["accel_z"]["usable"], false);
    let stderr = String::from_utf8(vn100d(&["noise", path, "--format", "kalibr", "--rate", "400"]).stderr).unwrap();
    assert!(stderr.contains("--rate 400 overrides the stamps, which lie on a grid of 100.0 Hz"), "{stderr}");
}
