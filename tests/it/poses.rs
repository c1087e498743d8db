//! A sensor beside poses and an encoder: axes, signs, units and clocks come first, then what the sensor has.

use crate::world::{World, vn100d};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

const RATE_HZ: f64 = 100.0;
const G: f64 = 9.806_65;

fn attitude(t: f64) -> UnitQuaternion<f64> {
    let turn = |axis: usize, size: f64, speed: f64| {
        UnitQuaternion::from_scaled_axis(Vector3::ith(axis, size * (speed * t).sin()))
    };
    turn(2, 1.2, 0.7) * turn(1, 1.0, 1.1) * turn(0, 1.3, 1.5)
}

fn position(t: f64) -> Vector3<f64> {
    Vector3::new(0.3 * (1.9 * t).sin(), 0.25 * (2.6 * t).sin(), 0.2 * (3.3 * t).cos())
}

/// Returns a recording, whose clock is `begins_s` ahead, and its poses. `shown` makes what the sensor shows of rates and forces.
fn made(begins_s: f64, shown: impl Fn(Vector3<f64>, Vector3<f64>) -> [Vector3<f64>; 2]) -> [String; 2] {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut noise = |sd: f64| Vector3::from_fn(|_, _| sd * (0..12).map(|_| random.random::<f64>() - 0.5).sum::<f64>());
    let mut recording =
        "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n".to_owned();
    let mut poses = "time_s,q_w,q_x,q_y,q_z,p_x_m,p_y_m,p_z_m\n".to_owned();
    for place in 0..6000 {
        let t = f64::from(place) / RATE_HZ;
        let (rate_t, force_t) = (t - 0.004, t - 0.002);
        let rate = (attitude(rate_t - 1e-5).inverse() * attitude(rate_t + 1e-5)).scaled_axis() / 2e-5;
        let moved = (position(force_t + 1e-3) - 2.0 * position(force_t) + position(force_t - 1e-3)) / 1e-6;
        let force = attitude(force_t).inverse() * (moved + Vector3::z() * G);
        let [rate, force] = shown(rate, force);
        let (rate, force) = (rate + noise(2e-3), force + noise(0.02));
        let _ = writeln!(
            recording,
            "{:.4},{},{},{},{},{},{}",
            t + begins_s,
            rate.x,
            rate.y,
            rate.z,
            force.x,
            force.y,
            force.z
        );
        let pose = attitude(t) * UnitQuaternion::from_scaled_axis(noise(1e-4));
        let at = position(t) + noise(2e-5);
        let _ = writeln!(poses, "{t:.4},{},{},{},{},{},{},{}", pose.w, pose.i, pose.j, pose.k, at.x, at.y, at.z);
    }
    [recording, poses]
}

fn model() -> String {
    let channel = |n: f64| json!({ "N": n });
    let (gyro, accel) = (channel(2e-4), channel(2e-3));
    json!({"format": "vn100d-sensor-model-1", "name": "unit", "rate_hz": RATE_HZ, "channels": {
        "gyro_x": gyro, "gyro_y": gyro, "gyro_z": gyro, "accel_x": accel, "accel_y": accel, "accel_z": accel}})
    .to_string()
}

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn diagnosed(arguments: &[&str]) -> Value {
    let ended = vn100d(&[&["--json", "diagnose"][..], arguments].concat());
    assert!(ended.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
    serde_json::from_slice(&ended.stdout).unwrap()
}

fn interval(of: &Value, effect: &str, triad: &str, name: &str) -> [f64; 2] {
    let mut causes = of["causes"].as_array().unwrap().iter();
    let cause =
        causes.find(|cause| cause["effect"] == effect && cause["triad"] == triad).unwrap_or_else(|| panic!("{of:#}"));
    [0, 1].map(|end| cause["uncertainty"][triad][name][end].as_f64().unwrap())
}

#[test]
fn a_sensor_beside_poses_has_its_scale_bias_and_latency_named_and_added() {
    let folder = tempfile::tempdir().unwrap();
    let bias = Vector3::new(0.0, 0.01, 0.0);
    let [recording, poses] = made(0.0, |rate, force| [rate * 1.01 + bias, force * 0.99]);
    let (real, sim) = (write(folder.path(), "real.csv", &recording), write(folder.path(), "sim.json", &model()));
    let reference = write(folder.path(), "poses.csv", &poses);
    let augmented = folder.path().join("more.json").to_str().unwrap().to_owned();
    let found =
        diagnosed(&["--real", &real, "--sim", &sim, "--reference", &reference, "--augmented-model", &augmented]);
    for (effect, triad, name, truth) in [
        ("scale_factor", "gyro", "x", 0.01),
        ("scale_factor", "accel", "z", -0.01),
        ("bias", "gyro", "y", 0.01),
        ("latency", "gyro", "seconds", 0.004),
        ("latency", "accel", "seconds", 0.002),
    ] {
        let [low, high] = interval(&found, effect, triad, name);
        assert!(
            low - 0.3 * (high - low) < truth && truth < high + 0.3 * (high - low),
            "{effect} {triad}: {low} {high}"
        );
    }
    assert_eq!(found["verdict"], "effects");
    assert!(found["discrepancy"]["closed"].as_f64().unwrap() > 0.9, "{found:#}");
    let texts = found["notes"].to_string();
    assert!(texts.contains("noise is not compared") && texts.contains("turned by"), "{texts}");
    // The corrected model has them: nothing is left to name.
    let again = diagnosed(&["--real", &real, "--sim", &augmented, "--reference", &reference]);
    assert_eq!(
        (again["verdict"].as_str(), again["causes"].as_array().unwrap().len()),
        (Some("no_gap"), 0),
        "{again:#}"
    );
}

#[test]
fn exchanged_axes_another_unit_and_another_clock_come_first() {
    let folder = tempfile::tempdir().unwrap();
    let sim = write(folder.path(), "sim.json", &model());
    let exchanged = |of: Vector3<f64>| Vector3::new(-of.y, of.x, of.z);
    let [recording, poses] = made(7.25, |rate, force| [exchanged(rate).map(f64::to_degrees), exchanged(force) / G]);
    let (real, reference) = (write(folder.path(), "real.csv", &recording), write(folder.path(), "poses.csv", &poses));
    let found = diagnosed(&["--real", &real, "--sim", &sim, "--reference", &reference]);
    let first = found["summary"].as_str().unwrap();
    for says in [
        "x, y, z of the gyroscope are −y, x, z of the reference",
        "the gyroscope is in °/s instead of rad/s",
        "x, y, z of the accelerometer are −y, x, z of the reference",
        "the accelerometer is in g instead of m/s²",
    ] {
        assert!(first.contains(says), "{first}");
    }
    assert_eq!(found["hints"].as_array().unwrap().len(), 4, "{found:#}");
    assert!(found["notes"].to_string().contains("the gyroscope is 7254"), "{found:#}");
}

#[test]
fn poses_by_http_are_kept_and_bad_references_are_refused_in_a_sentence() {
    let world = World::new();
    let daemon = world.daemon("", &[]);
    let [recording, poses] = made(100.0, |rate, force| [rate * 1.02, force]);
    let (status, body) = world.request_as("POST", "/v1/imports?name=stick", "text/csv", &recording).unwrap();
    assert_eq!(status, 201, "{body}\n{}", daemon.log());
    let sim: Value = serde_json::from_str(&model()).unwrap();
    let ask = json!({"sim": sim, "reference": poses}).to_string();
    let (status, body) = world.request("POST", "/v1/captures/stick/diagnoses", &ask).unwrap();
    assert!(status == 200 || status == 202, "{status} {body}\n{}", daemon.log());
    let id = serde_json::from_str::<Value>(&body).unwrap()["id"].as_i64().unwrap_or_else(|| panic!("{body}"));
    let ended = || {
        let job = world.get(&format!("/v1/jobs/{id}"));
        (job["state"] == "done" || job["state"] == "failed").then_some(job)
    };
    let job = world.until("the diagnosis ends", std::time::Duration::from_secs(60), ended, &daemon);
    assert_eq!(job["state"], "done", "{job:#}\n{}", daemon.log());
    let found = world.get(&format!("/v1/diagnoses/{id}"));
    let [low, high] = interval(&found, "scale_factor", "gyro", "x");
    assert!(low < 0.021 && 0.019 < high, "{low} {high}");
    for (reference, says) in [
        ("time_s,q_w,q_x,q_y,q_z\n0,1,0,0,0\n0,1,0,0,0\n", "line 3 of the reference"),
        ("time_s,encoder_rpm\n0,1\n1,2\n", "--reference-axis"),
        ("a,b\n1,2\n", "has the columns `a,b`"),
    ] {
        let ask = json!({"sim": sim, "reference": reference}).to_string();
        let (status, body) = world.request("POST", "/v1/captures/stick/diagnoses", &ask).unwrap();
        assert!(status == 400 && body.contains(says), "{status} {body}");
    }
}

#[test]
fn a_motors_encoder_and_a_bad_camera_are_what_the_readme_of_the_recordings_states() {
    let Some(data) = vn100_testkit::real_data("asen3801") else { return };
    let folder = tempfile::tempdir().unwrap();
    let sim = json!({"format": "vn100d-sensor-model-1", "name": "motor", "rate_hz": 100, "channels": {"gyro_z": {"N": 1e-3}}});
    let sim = write(folder.path(), "motor.json", &sim.to_string());
    let motor = data.join("ango_GYRO_AUTO_F0pt2_C0pt5");
    let [real, encoder] = ["csv.gz", "encoder.csv.gz"].map(|end| format!("{}.{end}", motor.display()));
    let found = diagnosed(&["--real", &real, "--sim", &sim, "--reference", &encoder, "--reference-axis", "z"]);
    assert!(
        found["summary"].as_str().unwrap().starts_with("gyro_z has the other sign than the reference"),
        "{found:#}"
    );
    let [low, high] = interval(&found, "scale_factor", "gyro", "z");
    assert!(-0.135 < low && high < -0.12, "{low} {high}");
    assert!(found["notes"].to_string().contains("ms earlier than the reference"), "{found:#}");
    let without = vn100d(&["diagnose", "--real", &real, "--sim", &sim, "--reference", &encoder]);
    assert_eq!(without.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&without.stderr).contains("--reference-axis x, y or z"));
    let sim = write(folder.path(), "stick.json", &model());
    let stick = data.parent().unwrap().join("repoimu/TStick_Test10_Trial1");
    let [real, vicon] = ["csv.gz", "vicon.csv.gz"].map(|end| format!("{}.{end}", stick.display()));
    let refused = vn100d(&["diagnose", "--real", &real, "--sim", &sim, "--reference", &vicon]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        refused.status.code() == Some(1) && said.contains("contradict each other in 4 % of the time (3.2 to"),
        "{said}"
    );
}

/// Returns the text of a recording with each row's values changed by `change(row, values)`.
fn with_values(recording: &str, change: impl Fn(usize, &mut [f64])) -> String {
    let mut lines = recording.lines();
    let mut text = format!("{}\n", lines.next().unwrap());
    for (row, line) in lines.enumerate() {
        let (time_s, rest) = line.split_once(',').unwrap();
        let mut values: Vec<f64> = rest.split(',').map(|value| value.parse().unwrap()).collect();
        change(row, &mut values);
        let values: Vec<String> = values.iter().map(f64::to_string).collect();
        let _ = writeln!(text, "{time_s},{}", values.join(","));
    }
    text
}

#[test]
fn a_range_that_cut_off_comes_first_and_makes_no_scale_factor_smaller() {
    let folder = tempfile::tempdir().unwrap();
    let [recording, poses] = made(0.0, |rate, force| [rate * 1.01, force]);
    let clipped = with_values(&recording, |_, values| values[0] = values[0].clamp(-1.8, 1.8));
    let (real, sim) = (write(folder.path(), "real.csv", &clipped), write(folder.path(), "sim.json", &model()));
    let reference = write(folder.path(), "poses.csv", &poses);
    let found = diagnosed(&["--real", &real, "--sim", &sim, "--reference", &reference]);
    let first = found["summary"].as_str().unwrap();
    assert!(first.starts_with("gyro_x is cut off at -1.8000 and 1.8000 rad/s"), "{first}");
    assert_eq!(found["hints"][0]["kind"], "range");
    let [low, high] = interval(&found, "scale_factor", "gyro", "x");
    let width = high - low;
    assert!(low - 0.3 * width < 0.01 && 0.01 < high + 0.3 * width && width < 4e-3, "{low} {high}");
}

#[test]
fn rows_that_repeat_come_first_and_are_no_latency() {
    let folder = tempfile::tempdir().unwrap();
    let [recording, poses] = made(0.0, |rate, force| [rate * 1.01, force]);
    let rows: Vec<Vec<f64>> = recording
        .lines()
        .skip(1)
        .map(|line| line.split(',').skip(1).map(|value| value.parse().unwrap()).collect())
        .collect();
    let held = with_values(&recording, |row, values| values.copy_from_slice(&rows[row - row % 3]));
    let (real, sim) = (write(folder.path(), "real.csv", &held), write(folder.path(), "sim.json", &model()));
    let reference = write(folder.path(), "poses.csv", &poses);
    let found = diagnosed(&["--real", &real, "--sim", &sim, "--reference", &reference]);
    let first = found["summary"].as_str().unwrap();
    assert!(first.starts_with("67 % of the gyroscope's rows repeat the row before"), "{first}");
    assert_eq!(found["hints"][0]["kind"], "repeats");
    let causes = found["causes"].as_array().unwrap();
    assert!(causes.iter().all(|cause| cause["effect"] != "latency"), "{found:#}");
    assert!(!found["notes"].to_string().contains("later than the reference"), "{found:#}");
    let [low, high] = interval(&found, "scale_factor", "gyro", "x");
    let width = high - low;
    assert!(low - 0.5 * width < 0.01 && 0.01 < high + 0.5 * width, "{low} {high}");
}

#[test]
fn effects_on_top_of_a_real_motion_are_found_and_nothing_else_is() {
    let folder = tempfile::tempdir().unwrap();
    let bias = Vector3::new(0.0, 0.01, 0.0);
    let [recording, poses] = made(0.0, |rate, force| [rate * 1.01 + bias, force * 0.99]);
    let (real, reference) = (write(folder.path(), "real.csv", &recording), write(folder.path(), "poses.csv", &poses));
    let asked = ["--json", "trial", "--motion", "--on", &real, "--reference", &reference, "--seed", "5"];
    let ended = vn100d(&[&asked[..], &["--cases", "20"]].concat());
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    let score: Value = serde_json::from_slice(&ended.stdout).unwrap();
    let rate = |name: &str| ["count", "of"].map(|key| score["rates"][name][key].as_u64().unwrap());
    let [right, of] = rate("right_first_clear");
    assert!(of >= 4 && right == of, "{score:#}");
    let [nothing, of] = rate("none_named");
    assert!(of == 6 && nothing == 0, "{score:#}");
    let [held, of] = rate("held");
    assert!(of > 10 && 10 * held >= 8 * of, "{score:#}");
    assert!(rate("spurious")[0] <= 1 && rate("held_alone")[1] > 10, "{score:#}");
    // The same seed seals the same keys.
    let again = vn100d(&[&asked[..], &["--cases", "20"]].concat());
    assert_eq!(serde_json::from_slice::<Value>(&again.stdout).unwrap()["manifest_sha256"], score["manifest_sha256"]);
    let without = vn100d(&["trial", "--motion", "--on", &real]);
    assert!(String::from_utf8_lossy(&without.stderr).contains("give --reference POSE"), "{without:?}");
    let foreign = vn100d(&[&asked[1..], &["--kinds", "g_sensitivity"]].concat());
    assert!(String::from_utf8_lossy(&foreign.stderr).contains("expected none, single, pair"), "{foreign:?}");
}
