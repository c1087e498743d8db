//! Diagnoses through the daemon: requested, followed, fetched, displayed, and continued after a restart.

use crate::world::{Process, World, vn100d};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Duration;

/// Debug builds beside other tests are slow.
const PATIENCE: Duration = Duration::from_secs(120);

fn model(effects: &Value) -> Value {
    json!({"format": "vn100d-sensor-model-1", "name": "unit 7", "rate_hz": 40, "channels": {
        "gyro_x": {"N": 1e-4, "B": 2e-5, "K": 1e-6},
        "accel_z": {"N": 0.002, "B": 4e-4, "K": 2e-5, "bias": -9.8, "effects": effects}}})
}

/// Returns a daemon over a capture of 20 minutes with a tone, `desk`.
fn with_capture(world: &World) -> Process {
    let path = |name: &str| -> PathBuf { world.path(name) };
    let tone = json!([{"effect": "tone", "frequency_hz": 13.38, "amplitude": 0.002}]);
    std::fs::write(path("truth.json"), model(&tone).to_string()).unwrap();
    let (truth, data) = (path("truth.json"), path("data"));
    let text = |path: &PathBuf| path.to_str().unwrap().to_owned();
    let ended = vn100d(&[
        "--data-dir",
        &text(&data),
        "simulate",
        "--model",
        &text(&truth),
        "--duration",
        "20min",
        "--seed",
        "7",
        "--into-db",
        "desk",
    ]);
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    world.daemon("", &[])
}

fn submitted(world: &World, body: &Value) -> (u16, Value) {
    let (status, body) = world.request("POST", "/v1/captures/desk/diagnoses", &body.to_string()).unwrap();
    (status, serde_json::from_str(&body).unwrap())
}

#[test]
fn a_diagnosis_is_asked_for_followed_fetched_and_seen() {
    let world = World::new();
    let mut daemon = with_capture(&world);
    let plain = model(&json!([]));
    let (status, job) = submitted(&world, &json!({"sim": plain}));
    assert_eq!(status, 202, "{job}");
    let id = job["id"].as_i64().unwrap();
    let mut furthest = 0.0;
    let ended = world.until(
        "the diagnosis",
        PATIENCE,
        || {
            let job = world.get(&format!("/v1/jobs/{id}"));
            let progress = job["progress"].as_f64().unwrap();
            assert!(progress >= furthest, "{furthest} {job}");
            furthest = progress;
            (!matches!(job["state"].as_str(), Some("queued" | "running"))).then_some(job)
        },
        &daemon,
    );
    assert_eq!(
        (ended["state"].as_str(), ended["result"].as_str()),
        (Some("done"), Some(&*format!("/v1/diagnoses/{id}")))
    );
    let report = world.get(&format!("/v1/diagnoses/{id}"));
    assert_eq!((&report["verdict"], &report["causes"][0]["effect"]), (&json!("effects"), &json!("tone")), "{report:#}");
    let found = report["causes"][0]["parameters"]["accel_z"]["frequency_hz"].as_f64().unwrap();
    assert!((found - 13.38).abs() < 1e-3, "{found}");
    let Value::String(page) = world.get(&format!("/diagnoses/{id}")) else { panic!("a page is no JSON") };
    assert!(page.contains(&format!("<h1>{}</h1>", report["summary"].as_str().unwrap())), "{page}");
    assert!(!page.contains("<script>") && !page.contains("http://") && !page.contains("https://"), "{page}");
    // The same request is the same job; the corrected model closes the gap.
    let (status, again) = submitted(&world, &json!({"sim": plain, "reference": null}));
    assert_eq!((status, again["id"].as_i64()), (200, Some(id)), "{again}");
    let better = world.get(&format!("/v1/diagnoses/{id}/model"));
    let (status, kept) = world.request("POST", "/v1/models", &better.to_string()).unwrap();
    let kept: Value = serde_json::from_str(&kept).unwrap();
    assert_eq!(status, 201, "{kept}");
    let (_, closed) = submitted(&world, &json!({"sim": kept["id"]}));
    let route = format!("/v1/diagnoses/{}", closed["id"]);
    let closed = world.until("the second", PATIENCE, || world.try_get(&route), &daemon);
    assert_eq!(closed["causes"], json!([]), "{closed:#}");
    // Refusals.
    let wobble = model(&json!([{"effect": "wobble"}]));
    for (route, body, status, part) in [
        ("/v1/captures/nobody/diagnoses", json!({"sim": plain}), 404, "nobody"),
        ("/v1/captures/desk/diagnoses", json!({"sim": wobble}), 400, "channels.accel_z.effects[0].effect"),
        ("/v1/captures/desk/diagnoses", json!({"sim": plain, "reference": "m.csv"}), 400, "expected a motion's CSV"),
    ] {
        let (found, text) = world.request("POST", route, &body.to_string()).unwrap();
        assert!(found == status && text.contains(part), "{route}: {found} {text}");
    }
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
}

#[test]
fn a_diagnosis_that_is_interrupted_begins_again_at_the_next_start_and_a_cancelled_one_does_not() {
    let world = World::new();
    let mut daemon = with_capture(&world);
    let of = |n: f64| json!({"sim": {"format": "vn100d-sensor-model-1", "name": "m", "rate_hz": 40, "channels": {"gyro_x": {"N": n}}}});
    // Both wait for a longer one.
    submitted(&world, &json!({"sim": model(&json!([]))}));
    let (cancelled, waits) =
        (submitted(&world, &of(1e-4)).1["id"].clone(), submitted(&world, &of(2e-4)).1["id"].clone());
    let (status, _) = world.request("DELETE", &format!("/v1/jobs/{cancelled}"), "").unwrap();
    assert_eq!(status, 200);
    let begun = std::time::Instant::now();
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    let daemon = world.daemon("", &[]);
    let route = format!("/v1/diagnoses/{waits}");
    world.until("the diagnosis", PATIENCE, || world.try_get(&route), &daemon);
    assert_eq!(world.get(&format!("/v1/jobs/{cancelled}"))["state"], "cancelled");
    let list = world.get("/v1/diagnoses");
    let states: Vec<&str> =
        list["diagnoses"].as_array().unwrap().iter().map(|one| one["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["done", "cancelled", "done"], "{list:#}");
}

#[test]
fn a_capture_of_a_known_motion_is_diagnosed_against_it() {
    let world = World::new();
    let path = |name: &str| world.path(name).to_str().unwrap().to_owned();
    let channels: serde_json::Map<String, Value> = [("gyro", 6e-5), ("accel", 1.4e-3)]
        .into_iter()
        .flat_map(|(triad, n)| ["x", "y", "z"].map(|axis| (format!("{triad}_{axis}"), json!({"N": n}))))
        .collect();
    let model = |triads: Value| json!({"format": "vn100d-sensor-model-1", "name": "unit 7", "rate_hz": 40, "channels": channels, "triads": triads});
    let effect = json!({"effect": "scale_factor", "x": 1e-3, "y": -5e-4, "z": 0.0});
    std::fs::write(path("truth.json"), model(json!({"gyro": {"effects": [effect]}})).to_string()).unwrap();
    let (data, truth, motion) = (path("data"), path("truth.json"), path("motion.csv"));
    let simulate = ["simulate", "--model", &truth, "--duration", "4min", "--seed", "7", "--motion", "rate-table"];
    let ended =
        vn100d(&[&["--data-dir", &data], &simulate[..], &["--motion-out", &motion, "--into-db", "desk"]].concat());
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    let daemon = world.daemon("", &[]);
    let reference = std::fs::read_to_string(&motion).unwrap();
    let (status, job) = submitted(&world, &json!({"sim": model(json!({})), "reference": reference}));
    assert_eq!(status, 202, "{job}");
    assert!(job["params"]["reference"]["bytes"].as_u64() == Some(reference.len() as u64), "{job}");
    let route = format!("/v1/diagnoses/{}", job["id"]);
    let report = world.until("the diagnosis", PATIENCE, || world.try_get(&route), &daemon);
    let cause = &report["causes"][0];
    assert_eq!((&cause["effect"], &cause["triad"]), (&json!("scale_factor"), &json!("gyro")), "{report:#}");
    assert!((cause["parameters"]["gyro"]["x"].as_f64().unwrap() - 1e-3).abs() < 1e-4, "{cause:#}");
    // It turns about x with x down and at no other time: pose and rate are equivalent.
    let place = &report["where"][0];
    assert!(place["channel"] == "gyro_x" && place["at"]["axis"] == "x" && place["sign"] == "real higher", "{report:#}");
    let Value::String(page) = world.get(&format!("/diagnoses/{}", job["id"])) else { panic!("a page is no JSON") };
    assert!(page.contains("Beyond the motion") && page.contains("gyro_x against the rate about x"), "{page}");
    // The name of the simulated motion gives the same result.
    let (status, job) = submitted(&world, &json!({"sim": model(json!({})), "reference": "rate-table"}));
    assert_eq!(status, 202, "{job}");
    let route = format!("/v1/diagnoses/{}", job["id"]);
    let named = world.until("the second", PATIENCE, || world.try_get(&route), &daemon);
    assert_eq!(named["causes"][0]["effect"], "scale_factor", "{named:#}");
}
