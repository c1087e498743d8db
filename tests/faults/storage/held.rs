//! Other programs hold the database (C6, C7), or copy it (C9).

use super::*;
use crate::tools;

/// Row C6.
#[test]
fn a_foreign_write_lock_is_waited_out() {
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let configuration = "[sensor]\nrate-hz = 400\nbaud = 921600\n";
    let mut daemon = start(&world, &[], configuration, &["--capture", "1h"]);
    until_committed(&world, 400, START, &daemon);
    let watch = Watch::start(&world);
    let foreign = rusqlite::Connection::open(world.database()).unwrap();
    foreign.busy_timeout(Duration::from_secs(5)).unwrap();
    foreign.execute_batch("BEGIN IMMEDIATE").unwrap();
    until_state(&world, "storage_locked", Duration::from_secs(10), &daemon);
    std::thread::sleep(Duration::from_secs(tools::scaled(0, 14)));
    foreign.execute_batch("ROLLBACK").unwrap();
    drop(foreign);
    until_state(&world, "ok", Duration::from_secs(10), &daemon);
    let received = status(&world)["capture"]["samples"].as_u64().unwrap();
    until_committed(&world, received, START, &daemon);
    watch.settle();
    let (_, metrics) = world.request("GET", "/metrics", "").unwrap();
    let busy = metrics.lines().find_map(|line| line.strip_prefix("vn100d_commits_busy_total ")).unwrap();
    assert!(busy.parse::<u64>().unwrap() >= 1, "{busy}");
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());
    stop_and_settle(&world, &mut daemon);
}

/// Row C7.
#[test]
fn a_long_reader_is_reported_and_its_log_is_drained_when_it_ends() {
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let alarm = tools::scaled(1, 8_u64);
    let configuration = format!("[sensor]\nrate-hz = 400\nbaud = 921600\n[storage]\nwal-alarm-mib = {alarm}\n");
    let mut daemon = start(&world, &[], &configuration, &["--capture", "1h"]);
    until_committed(&world, 400, START, &daemon);
    let reader =
        rusqlite::Connection::open_with_flags(world.database(), rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY).unwrap();
    reader.execute_batch("BEGIN").unwrap();
    let seen: i64 = reader.query_row("SELECT count(*) FROM sample", [], |row| row.get(0)).unwrap();
    assert!(seen > 0);
    let warned = || {
        world.try_get("/v1/status")?["storage"]["warning"]
            .as_str()
            .filter(|text| text.contains("log"))
            .map(str::to_owned)
    };
    world.until("the alarm", Duration::from_secs(tools::scaled(60, 300)), warned, &daemon);
    assert_eq!(status(&world)["storage"]["state"], "ok", "the capture is not concerned");
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());
    reader.execute_batch("ROLLBACK").unwrap();
    drop(reader);
    let drained = || {
        let status = world.try_get("/v1/status")?;
        (status["storage"]["wal_bytes"].as_u64()? < alarm << 20).then_some(())
    };
    world.until("the log is drained", Duration::from_secs(5), drained, &daemon);
    stop_and_settle(&world, &mut daemon);
}

/// Row C9.
#[test]
fn a_backup_during_a_capture_is_whole_and_costs_no_sample() {
    let world = World::new();
    build(&world.database(), tools::scaled(40, 400), 8192);
    let _sensor = world.emulate(FAST);
    let configuration = format!("[sensor]\nrate-hz = {}\nbaud = 921600\n", tools::scaled(400, 800));
    let mut daemon = start(&world, &[], &configuration, &["--capture", "1h"]);
    until_committed(&world, 1600, START, &daemon);
    let plain = |name: &str| {
        let begun = Instant::now();
        std::fs::copy(world.database(), world.path(name)).unwrap();
        std::fs::File::open(world.path(name)).unwrap().sync_all().unwrap();
        begun.elapsed()
    };
    let copied = plain("plain-1").min(plain("plain-2"));
    let backup = |name: &str| {
        let begun = Instant::now();
        let out = world.path(name);
        let data = world.path("data");
        let output =
            vn100d(&["--data-dir", data.to_str().unwrap(), "--json", "backup", "--out", out.to_str().unwrap()]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["bytes"].as_u64().unwrap(), out.metadata().unwrap().len());
        begun.elapsed()
    };
    let took = backup("copy-1.db").min(backup("copy-2.db"));
    println!("backup {took:?}, plain copy {copied:?}, {} bytes", world.database().metadata().unwrap().len());
    // The start of a process does not grow with the database. In the full run the disk is as fast as memory, so that
    // SQLite's work per page is visible (docs/reliability.md, C9).
    let limit = copied.mul_f64(tools::scaled(1.5, 4.0)) + Duration::from_millis(250);
    assert!(took <= limit, "backup {took:?}, plain copy {copied:?}");
    for name in ["copy-1.db", "copy-2.db"] {
        assert!(sound(&world.path(name)));
    }
    let out = world.path("copy-1.db");
    let again = vn100d(&["--data-dir", world.path("data").to_str().unwrap(), "backup", "--out", out.to_str().unwrap()]);
    assert_eq!(again.status.code(), Some(73), "an existing file is not replaced unasked");
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());
    stop_and_settle(&world, &mut daemon);
}
