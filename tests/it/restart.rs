//! Power cuts and unplugged cables.

use crate::world::World;
use std::time::Duration;

const START: Duration = Duration::from_secs(15);

#[test]
fn after_a_kill_the_same_capture_goes_on_with_the_gap_counted() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let mut daemon = world.daemon("", &["--capture", "8s"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["committed"].as_u64() > Some(80));
    let before = world.until("samples", START, some, &daemon);
    daemon.kill();
    // Long enough that samples are missing however fast the daemon restarts.
    std::thread::sleep(Duration::from_millis(500));
    let daemon = world.daemon("", &["--capture", "8s"]);
    let ended = || world.try_get("/v1/captures/latest").filter(|capture| capture["state"] == "complete");
    let capture = world.until("the capture ends", START, ended, &daemon);
    assert_eq!(capture["id"], before["capture"]["id"], "the same capture goes on");
    let (samples, missing) = (capture["samples"].as_u64().unwrap(), capture["missing"].as_u64().unwrap());
    assert_eq!(samples + missing, 320, "received and missing are duration × rate");
    assert!(missing > 0, "the daemon was away");
    let gaps = world.get("/v1/captures/latest/gaps");
    assert_eq!(gaps["gaps"][0]["cause"], "daemon_stopped");
    assert_eq!(gaps["gaps"][0]["missing_exact"], true, "the sensor's clock ran on");
    let rows = world.query("SELECT count(*), max(seq) + 1 FROM sample");
    assert_eq!(format!("{rows:?}"), format!("[[Integer({samples}), Integer({samples})]]"));
}

#[test]
fn unplugged_and_plugged_in_again_is_one_capture_with_a_gap() {
    let world = World::new();
    let sensor = world.emulate(&[]);
    let daemon = world.daemon("", &["--capture", "12s"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(80));
    world.until("samples", START, some, &daemon);
    drop(sensor);
    let absent = || world.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "absent");
    world.until("the loss is noticed", Duration::from_secs(5), absent, &daemon);
    std::thread::sleep(Duration::from_millis(500));
    let _sensor = world.emulate(&[]);
    let again = || world.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "streaming");
    world.until("streaming within 3 s", Duration::from_secs(3), again, &daemon);
    let ended = || world.try_get("/v1/captures/latest").filter(|capture| capture["state"] == "complete");
    let capture = world.until("the capture ends", START, ended, &daemon);
    assert_eq!(capture["samples"].as_u64().unwrap() + capture["missing"].as_u64().unwrap(), 480);
    let gaps = world.get("/v1/captures/latest/gaps");
    assert_eq!(gaps["gaps"][0]["cause"], "unplugged");
    assert_eq!(capture["segments"], 2);
}
