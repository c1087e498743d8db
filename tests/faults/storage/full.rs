//! The disk is full (C1).

use super::*;
use crate::tools;

/// Fills the file system to the last byte.
pub fn fill(folder: &Path) -> PathBuf {
    use std::io::Write as _;
    let path = folder.join("filler");
    let mut file = std::fs::File::create(&path).unwrap();
    for size in [65_536, 4096, 1] {
        while file.write_all(&vec![1; size]).is_ok() {}
    }
    path
}

/// Row C1.
#[test]
fn a_full_disk_is_reported_at_once_costs_nothing_for_half_a_minute_and_one_gap_beyond() {
    if !tools::root("a file system of its own is mounted") {
        return;
    }
    let world = World::new();
    // Room for the recorded data, and for the data that waits in memory.
    let mount = Mount::tmpfs(&world, tools::scaled("8m", "64m"));
    let _sensor = world.emulate(FAST);
    let rate = if tools::scaled(true, false) { 400 } else { 800 };
    let configuration = format!("[sensor]\nrate-hz = {rate}\nbaud = 921600\n");
    let mut daemon = start(&world, &[], &configuration, &["--capture", "1h"]);
    until_committed(&world, 400, START, &daemon);
    let before = status(&world);
    assert_eq!(before["storage"]["state"], "ok");
    assert_eq!(before["storage"]["low_space"], true, "warned before: {before}");
    assert!(before["storage"]["warning"].as_str().unwrap().contains("free"), "{before}");
    let watch = Watch::start(&world);

    let filler = fill(&mount.0);
    let filled = Instant::now();
    until_state(&world, "storage_full", Duration::from_secs(3), &daemon);
    println!("storage_full after {:?}", filled.elapsed());
    // Control answers within its limits while nothing can be written.
    let asked = Instant::now();
    let (code, body) = world.request("POST", "/v1/captures", "{\"duration\": \"1h\"}").unwrap();
    assert_eq!(code, 409, "{body}");
    assert!(asked.elapsed() < Duration::from_secs(8), "{:?}", asked.elapsed());
    std::thread::sleep(Duration::from_secs(tools::scaled(4, 22)));
    let waiting = status(&world);
    assert!(waiting["storage"]["queued"].as_u64().unwrap() > 3 * rate, "{waiting}");
    std::fs::remove_file(&filler).unwrap();
    let freed = Instant::now();
    until_state(&world, "ok", Duration::from_secs(3), &daemon);
    println!("commits again after {:?}", freed.elapsed());
    assert!(freed.elapsed() < Duration::from_secs(3));
    let received = status(&world)["capture"]["samples"].as_u64().unwrap();
    until_committed(&world, received, Duration::from_secs(10), &daemon);
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());

    // More than memory holds: 24,000 samples in the queue and a batch of 8,192.
    if tools::scaled(false, true) {
        let filler = fill(&mount.0);
        // The log has its own space until it is copied into the file.
        until_state(&world, "storage_full", Duration::from_secs(90), &daemon);
        std::thread::sleep(Duration::from_secs(55));
        std::fs::remove_file(&filler).unwrap();
        until_state(&world, "ok", Duration::from_secs(5), &daemon);
        let received = status(&world)["capture"]["samples"].as_u64().unwrap();
        until_committed(&world, received, Duration::from_secs(20), &daemon);
        let gaps = gaps(&world);
        assert_eq!(gaps.len(), 1, "{gaps:?}");
        assert_eq!(gaps[0]["cause"], "storage_backpressure");
        assert!(gaps[0]["missing"].as_u64().unwrap() > 1000, "{gaps:?}");
    }
    watch.settle();
    stop_and_settle(&world, &mut daemon);
}

/// A capture that is stopped while the disk is full is not reported as written, and ends once there is room.
#[test]
fn a_capture_that_is_stopped_on_a_full_disk_is_not_reported_as_written() {
    if !tools::root("a file system of its own is mounted") {
        return;
    }
    let world = World::new();
    let mount = Mount::tmpfs(&world, "16m");
    let _sensor = world.emulate(FAST);
    let mut daemon = start(&world, &[], "[sensor]\nrate-hz = 400\nbaud = 921600\n", &["--capture", "1h"]);
    until_committed(&world, 400, START, &daemon);
    let filler = fill(&mount.0);
    until_state(&world, "storage_full", Duration::from_secs(30), &daemon);
    let (code, body) = world.request("POST", "/v1/captures/latest/stop", "").unwrap();
    assert_eq!(code, 503, "{body}");
    assert!(body.contains("has not taken its end"), "{body}");
    std::fs::remove_file(&filler).unwrap();
    until_state(&world, "ok", Duration::from_secs(5), &daemon);
    let ended = || (world.get("/v1/captures/latest")["state"] == "stopped").then_some(());
    world.until("its end is written", Duration::from_secs(10), ended, &daemon);
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());
    assert_eq!(daemon.terminate(), Some(0));
}
