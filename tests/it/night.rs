//! One short night: a sensor on a terminal, the daemon, a capture, curl.

use crate::world::{World, vn100d};
use serde_json::Value;
use std::time::Duration;

const START: Duration = Duration::from_secs(15);

fn state(world: &World, id: &str) -> Option<Value> {
    let capture = world.try_get(&format!("/v1/captures/{id}"))?;
    (capture["state"] != "capturing" && capture["state"] != "waiting").then_some(capture)
}

#[test]
fn a_capture_of_the_default_output_is_complete_and_every_interface_shows_it() {
    let world = World::new();
    let _sensor = world.emulate(&["--speed", "20"]);
    let mut daemon = world.daemon("", &["--speed", "20"]);
    let streaming = || world.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "streaming");
    let status = world.until("the sensor streams", START, streaming, &daemon);
    assert_eq!(status["sensor"]["rate_hz"], 40.0);
    assert!(status["capture"].is_null());
    assert_eq!(world.request("GET", "/readyz", "").unwrap().0, 200);

    let (code, body) = world.request("POST", "/v1/captures", r#"{"duration": "100s", "name": "evening"}"#).unwrap();
    assert_eq!(code, 201, "{body}");
    let (code, body) = world.request("POST", "/v1/captures", r#"{"duration": "1s"}"#).unwrap();
    assert_eq!(code, 409, "a second capture while one runs: {body}");
    let early = world.until(
        "noise parameters while it runs",
        START,
        || world.try_get("/v1/captures/latest/noise").filter(|noise| noise["samples"].as_u64() > Some(400)),
        &daemon,
    );
    assert_eq!(early["complete"], false);

    let capture = world.until("the capture ends", START, || state(&world, "evening"), &daemon);
    assert_eq!(capture["state"], "complete");
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(4000), Some(0)));
    assert_eq!(capture["segments"], 1);
    assert_eq!(capture["sensor"]["serial_number"], status["sensor"]["serial_number"]);

    let noise = world.until("noise parameters", START, || world.try_get("/v1/captures/latest/noise"), &daemon);
    assert_eq!(noise["format"], "vn100d-noise-1");
    assert_eq!(noise["complete"], true);
    assert!(noise["channels"]["gyro_x"]["N"]["value"].as_f64().unwrap() > 0.0);
    let allan = world.until("deviations", START, || world.try_get("/v1/captures/latest/allan"), &daemon);
    assert_eq!(allan["channels"]["accel_z"]["unit"], "m/s²");
    let tau = allan["channels"]["accel_z"]["tau_s"].as_array().unwrap();
    assert_eq!(tau[0], 0.025);

    // Any SQLite client can read it beside the daemon.
    let rows = world.query("SELECT count(*), min(seq), max(seq), avg(accel_z), count(DISTINCT segment_id) FROM sample WHERE capture_id = 1");
    let text = format!("{rows:?}");
    assert!(text.contains("Integer(4000)") && text.contains("Integer(3999)"), "{text}");
    let steps = world.query(
        "SELECT max(step), min(step) FROM (SELECT device_time_ns - lag(device_time_ns) OVER (ORDER BY seq) AS step FROM sample WHERE capture_id = 1)",
    );
    assert_eq!(format!("{steps:?}"), "[[Integer(25000000), Integer(25000000)]]");

    // A clean stop restores the sensor's output: ASCII, as before.
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    let probe = vn100d(&["--json", "probe", "--device", world.port().to_str().unwrap()]);
    let found: Value =
        serde_json::from_slice(&probe.stdout).unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&probe.stderr)));
    assert_eq!(found["registers"]["6"], "14");
    assert_eq!(found["output"], "VNYMR");
}

#[test]
fn a_capture_that_is_stopped_by_hand_keeps_what_it_has() {
    let world = World::new();
    let _sensor = world.emulate(&["--speed", "10"]);
    let daemon = world.daemon("", &["--speed", "10", "--capture", "5h"]);
    let enough = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(400));
    world.until("samples", START, enough, &daemon);
    assert_eq!(world.request("POST", "/v1/captures/latest/stop", "").unwrap().0, 200);
    let capture = world.get("/v1/captures/latest");
    assert_eq!(capture["state"], "stopped");
    assert_eq!(capture["missing"], 0);
    assert_eq!(world.request("POST", "/v1/captures/latest/stop", "").unwrap().0, 409);
    let events = world.get("/v1/captures/latest/events");
    let kinds: Vec<&str> =
        events["events"].as_array().unwrap().iter().filter_map(|event| event["kind"].as_str()).collect();
    assert!(kinds.contains(&"capture_started") && kinds.contains(&"capture_ended"), "{kinds:?}");
}

#[test]
fn ascii_output_at_another_rate_is_captured_as_configured() {
    let world = World::new();
    let _sensor = world.emulate(&["--speed", "10"]);
    let daemon = world.daemon("[sensor]\noutput = \"VNIMU\"\nrate-hz = 50\n", &["--speed", "10", "--capture", "20s"]);
    let capture = world.until("the capture ends", START, || state(&world, "latest"), &daemon);
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(1000), Some(0)));
    assert_eq!(capture["rate_hz"], 50.0);
    let segments = world.get("/v1/captures/latest/segments");
    assert_eq!(segments["segments"][0]["timebase"], "sync_counter", "the sensor's serial count is switched on");
    let rows = world.query("SELECT count(yaw), count(temperature), count(device_time_ns) FROM sample");
    assert_eq!(format!("{rows:?}"), "[[Integer(0), Integer(1000), Integer(0)]]");
}

#[test]
fn the_baud_rate_is_found_by_scanning() {
    let world = World::new();
    let _sensor = world.emulate(&["--baud", "921600", "--strict-baud"]);
    let daemon = world.daemon("[sensor]\nrate-hz = 200\n", &["--capture", "2s"]);
    let capture = world.until("the capture ends", START, || state(&world, "latest"), &daemon);
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(400), Some(0)));
    assert_eq!(world.get("/v1/status")["sensor"]["baud"], 921_600);
}
