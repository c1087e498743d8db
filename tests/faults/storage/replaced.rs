//! The database is deleted or replaced while it is open (C10).

use super::*;

fn goes_on(replace: impl Fn(&World)) -> World {
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let configuration = "[storage]\nfile-check = \"1s\"\n";
    let mut daemon = start(&world, &[], configuration, &["--capture", "1h"]);
    until_committed(&world, 80, START, &daemon);
    // A reader of the interface has the old file open.
    world.get("/v1/captures");
    replace(&world);
    let gone = Instant::now();
    until_state(&world, "storage_lost", Duration::from_secs(10), &daemon);
    until_state(&world, "ok", Duration::from_secs(10), &daemon);
    println!("another file takes data after {:?}", gone.elapsed());
    let refilled = || world.try_get("/v1/captures/latest").filter(|capture| capture["samples"].as_u64() > Some(80));
    let capture = world.until("samples in the new file", START, refilled, &daemon);
    let received = status(&world)["capture"]["samples"].as_u64().unwrap();
    assert_eq!(capture["state"], "capturing");
    let (stored, segments) = (capture["samples"].as_u64().unwrap(), capture["segments"].as_u64().unwrap());
    assert!(stored < received && segments == 1, "{capture}");
    // The new file begins with the first sample that the lost file had not acknowledged: nothing in flight was dropped.
    let events = world.get("/v1/captures/latest/events");
    let warning = events["events"].as_array().unwrap().iter().find(|event| event["kind"] == "warning").unwrap();
    let lost: u64 =
        warning["message"].as_str().unwrap().split(' ').filter_map(|word| word.parse().ok()).next().unwrap();
    std::thread::sleep(Duration::from_millis(1200));
    let first = world.query("SELECT min(seq), count(*), (SELECT sum(missing) FROM gap) FROM sample WHERE capture_id = (SELECT max(id) FROM capture)");
    assert_eq!(first[0][0], rusqlite::types::Value::Integer(0));
    assert_eq!(first[0][2], rusqlite::types::Value::Null, "no gap");
    let now = status(&world);
    let (samples, committed) =
        (now["capture"]["samples"].as_u64().unwrap(), now["capture"]["committed"].as_u64().unwrap());
    // Samples of the lost file count as acknowledged too.
    assert!(committed > lost && samples.abs_diff(committed) <= 80, "{lost} {now}");
    stop_and_settle(&world, &mut daemon);
    let rows = world.query("SELECT count(*) FROM sample WHERE capture_id = (SELECT max(id) FROM capture)");
    let rusqlite::types::Value::Integer(rows) = rows[0][0] else { panic!() };
    assert!(rows as u64 + lost >= samples, "{rows} + {lost} < {samples}");
    world
}

/// Row C10.
#[test]
fn a_deleted_database_is_noticed_and_a_new_file_goes_on() {
    goes_on(|world| std::fs::remove_file(world.database()).unwrap());
}

/// Row C10.
#[test]
fn a_database_moved_away_is_complete_and_a_new_file_goes_on() {
    let away = tempfile::tempdir().unwrap();
    let moved = away.path().join("moved.db");
    let world = goes_on(|world| std::fs::rename(world.database(), &moved).unwrap());
    assert!(sound(&moved));
    // By the sensor's clock the new file continues at the end of the old one: at 40 Hz, no sample is missing between
    // them.
    let old = rusqlite::Connection::open(&moved).unwrap();
    let last: i64 = old.query_row("SELECT max(device_time_ns) FROM sample", [], |row| row.get(0)).unwrap();
    let first = world.query("SELECT min(device_time_ns) FROM sample");
    assert_eq!(first[0][0], rusqlite::types::Value::Integer(last + 25_000_000));
}

/// Row C10.
#[test]
fn a_database_replaced_by_an_older_copy_goes_on_in_a_capture_of_its_own() {
    goes_on(|world| {
        let (out, data) = (world.path("older.db"), world.path("data"));
        let made = vn100d(&["--data-dir", data.to_str().unwrap(), "backup", "--out", out.to_str().unwrap()]);
        assert!(made.status.success());
        std::fs::rename(out, world.database()).unwrap();
    });
}
