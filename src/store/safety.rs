//! The guarantees that hold when commits fail, clocks are set and requests are repeated.

use super::tests::{World, a_capture, bare_writer, gap, sample, segment};
use super::*;
use imu_core::sample::Record;
use std::time::Duration;

const PERIOD_NS: u64 = 25_000_000;

/// Shifts the device times from sample `from` on by `missing` samples: the sensor's clock runs on over a gap, and the
/// fixtures count without gaps.
fn late(record: Record, from: u64, missing: u64) -> Record {
    let shift = missing * PERIOD_NS;
    match record {
        Record::Sample { seq, segment, mut sample } if seq >= from => {
            sample.device_time_ns = sample.device_time_ns.map(|ns| ns + shift);
            Record::Sample { seq, segment, sample }
        }
        Record::Segment(mut segment) if segment.first_seq >= from => {
            segment.first_device_time_ns = segment.first_device_time_ns.map(|ns| ns + shift);
            Record::Segment(segment)
        }
        other => other,
    }
}

fn whole() -> Vec<Record> {
    a_capture().into_iter().map(|record| late(record, 100, 3)).collect()
}

fn one<T: rusqlite::types::FromSql>(world: &World, sql: &str) -> T {
    world.reader().connection.query_row(sql, [], |row| row.get(0)).unwrap()
}

#[test]
fn every_commit_leaves_a_checksum_that_the_check_confirms() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, whole());
    world.store.flush_blocking().unwrap();
    let report = check(world.store.path()).unwrap();
    assert_eq!(report.findings, []);
    assert_eq!((report.captures[0].samples, report.captures[0].without_checksum), (150, 0));
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    let foreign = rusqlite::Connection::open(&path).unwrap();
    foreign.execute("UPDATE sample SET gyro_x = gyro_x + 1e-12 WHERE seq = 77", []).unwrap();
    drop(foreign);
    let report = check(&path).unwrap();
    assert_eq!(report.findings.len(), 1, "{report:?}");
    assert_eq!(report.findings[0].check, "checksum");
    let refused = Store::open(&path, StoreOptions::default()).map(drop).unwrap_err();
    assert_eq!(refused.kind(), StoreErrorKind::Io);
    assert!(refused.to_string().contains("vn100d recover"), "{refused}");
}

#[test]
fn counters_that_lie_are_found() {
    for (sql, check_name) in [
        ("UPDATE capture SET samples = samples + 1", "samples"),
        ("UPDATE capture SET missing = missing + 1", "gaps"),
        ("DELETE FROM gap", "gaps"),
        ("UPDATE segment SET first_seq = 99 WHERE segment_id = 2", "segments"),
        ("UPDATE sample SET segment_id = 2 WHERE seq = 3", "samples"),
        ("DELETE FROM sample WHERE seq = 12", "checksum"),
        ("UPDATE batch SET crc = crc + 1 WHERE first_seq = 0", "checksum"),
    ] {
        let world = World::new();
        let id = world.capturing();
        world.send(id, whole());
        world.store.flush_blocking().unwrap();
        let path = world.store.path().to_owned();
        world.store.close().unwrap();
        rusqlite::Connection::open(&path).unwrap().execute(sql, []).unwrap();
        let report = check(&path).unwrap();
        assert!(report.findings.iter().any(|finding| finding.check == check_name), "{sql}: {report:?}");
    }
}

#[test]
fn a_civil_time_that_is_set_later_keeps_the_checksums_right() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, [segment(1, 0)].into_iter().chain((0..50).map(|seq| sample(1, seq))));
    world.store.flush_blocking().unwrap();
    world.send(id, (50..60).map(|seq| sample(1, seq)));
    let first: i64 = one(&world, "SELECT min(host_utc_ns) FROM sample");
    let before_utc_ns = first + 60 * PERIOD_NS as i64;
    world.send(id, [Record::UtcSet { by_ns: 1_000, before_utc_ns, boot_id: None, since_seq: None }, sample(1, 60)]);
    world.store.flush_blocking().unwrap();
    let begun = std::time::Instant::now();
    while one::<i64>(&world, "SELECT count(*) FROM utc_correction") > 0 {
        assert!(begun.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(one::<i64>(&world, "SELECT min(host_utc_ns) FROM sample"), first + 1_000);
    let last = one::<i64>(&world, "SELECT max(host_utc_ns) FROM sample");
    assert_eq!(last, before_utc_ns, "what came with the right time keeps it");
    let report = check(world.store.path()).unwrap();
    assert!(!report.findings.iter().any(|finding| finding.check == "checksum"), "{report:?}");
    assert_eq!(report.captures[0].without_checksum, 0);
}

#[test]
fn the_same_request_makes_one_capture_and_can_be_taken_back() {
    let world = World::new();
    let capture = NewCapture { token: Some("request".to_owned()), ..NewCapture::new("pty", CaptureState::Capturing) };
    let id = world.store.create_capture(capture.clone()).unwrap();
    assert_eq!(world.store.create_capture(capture.clone()).unwrap(), id);
    world.store.withdraw("request").unwrap();
    assert!(world.reader().capture(id).is_err());
    assert_eq!(world.store.unfinished().unwrap(), []);
    // A capture that has samples stays.
    let capture = NewCapture { token: Some("another".to_owned()), ..capture };
    let id = world.store.create_capture(capture).unwrap();
    world.send(id, [segment(1, 0), sample(1, 0)]);
    world.store.flush_blocking().unwrap();
    world.store.withdraw("another").unwrap();
    assert_eq!(world.reader().capture(id).unwrap().samples, 1);
}

#[test]
fn a_log_written_over_itself_is_the_same_log() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, whole());
    world.store.flush_blocking().unwrap();
    let log = paths::wal_path(world.store.path());
    let before = std::fs::read(&log).unwrap();
    assert!(before.len() > 10_000);
    writer::rewrite(&log).unwrap();
    assert!(std::fs::read(&log).unwrap() == before);
    assert_eq!(check(world.store.path()).unwrap().findings, []);
}

#[test]
fn a_healthy_database_is_recovered_as_it_is() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, whole());
    world.store.flush_blocking().unwrap();
    world.store.pin(id, true).unwrap();
    let before = world.reader().capture(id).unwrap();
    let gaps = world.reader().gaps(id, &PageRequest::default()).unwrap().rows;
    let path = world.store.path().to_owned();
    // A killed process leaves everything in the log.
    let copy = world.directory.path().join("killed.db");
    std::fs::copy(&path, &copy).unwrap();
    std::fs::copy(paths::wal_path(&path), paths::wal_path(&copy)).unwrap();
    let out = world.directory.path().join("out.db");
    let report = recover(&copy, &out, false).unwrap();
    assert!(!report.has_damage(), "{report:?}");
    assert!(matches!(recover(&copy, &out, false), Err(StoreError::Exists(_))));
    assert!(matches!(recover(&path, &out, true), Err(StoreError::Locked { .. })));
    let reader = Reader::open(&out).unwrap();
    let after = reader.capture(id).unwrap();
    assert_eq!(after, before);
    assert_eq!(reader.gaps(id, &PageRequest::default()).unwrap().rows, gaps);
    assert_eq!(reader.events(id, &PageRequest::default()).unwrap().rows.len(), 1);
    assert_eq!(check(&out).unwrap().findings, []);
}

/// Every 820th page or so maps the others, and may look like a page of rows.
#[test]
fn a_healthy_database_of_many_pages_has_no_damage() {
    let world = World::new();
    let id = world.capturing();
    for batch in 0..60 {
        world.send(id, (batch == 0).then(|| segment(1, 0)));
        world.send(id, (batch * 1000..batch * 1000 + 1000).map(|seq| sample(1, seq)));
        world.store.flush_blocking().unwrap();
    }
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    assert!(std::fs::metadata(&path).unwrap().len() > 823 * 4096);
    let report = recover(&path, &world.directory.path().join("out.db"), false).unwrap();
    assert!(!report.has_damage(), "{report:?}");
}

/// A damaged header may claim pointer maps where there are tables.
#[test]
fn a_page_of_a_table_is_no_pointer_map_whatever_the_header_claims() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, whole());
    world.store.flush_blocking().unwrap();
    let before = world.reader().capture(id).unwrap();
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    let foreign = rusqlite::Connection::open(&path).unwrap();
    foreign.execute_batch("PRAGMA auto_vacuum = NONE; VACUUM; PRAGMA wal_checkpoint(TRUNCATE);").unwrap();
    drop(foreign);
    let mut bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes[52..56], [0; 4]);
    bytes[55] = 1;
    std::fs::write(&path, bytes).unwrap();
    let out = world.directory.path().join("out.db");
    recover(&path, &out, false).unwrap();
    assert_eq!(Reader::open(&out).unwrap().capture(id).unwrap(), before);
}

#[test]
fn a_file_without_a_whole_page_is_damaged() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("vn100d.db");
    for length in [0, 50, 4095] {
        std::fs::write(&path, vec![0; length]).unwrap();
        let report = recover(&path, &directory.path().join("out.db"), true).unwrap();
        assert!(report.has_damage() && report.captures.is_empty(), "{length}: {report:?}");
    }
}

#[test]
fn lost_samples_become_a_gap_in_the_recovered_database() {
    let world = World::new();
    let id = world.capturing();
    for batch in 0..10 {
        let first = batch * 100;
        world.send(id, (batch == 0).then(|| segment(1, 0)));
        if batch == 5 {
            world.send(id, [gap(500, 7), late(segment(2, 500), 500, 7)]);
        }
        let samples = (first..first + 100).map(|seq| sample(if seq < 500 { 1 } else { 2 }, seq));
        world.send(id, samples.map(|record| late(record, 500, 7)));
        world.store.flush_blocking().unwrap();
    }
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    let foreign = rusqlite::Connection::open(&path).unwrap();
    foreign.execute("UPDATE sample SET accel_z = 5 WHERE seq IN (250, 810)", []).unwrap();
    drop(foreign);
    let out = world.directory.path().join("out.db");
    let report = recover(&path, &out, false).unwrap();
    let capture = &report.captures[0];
    assert_eq!((capture.samples, capture.samples_lost, capture.batches_lost), (800, 200, 2));
    assert_eq!(capture.lost, [(200, 299), (800, 899)]);
    let reader = Reader::open(&out).unwrap();
    let row = reader.capture(id).unwrap();
    assert_eq!((row.samples, row.missing, row.gaps, row.segments), (800, 207, 3, 4));
    let gaps = reader.gaps(id, &PageRequest::default()).unwrap().rows;
    let seen: Vec<(u64, u64, &str)> = gaps.iter().map(|gap| (gap.before_seq, gap.missing, gap.cause.name())).collect();
    assert_eq!(seen, [(200, 100, "source"), (400, 7, "checksum"), (700, 100, "source")]);
    assert_eq!(check(&out).unwrap().findings, []);
}

#[test]
fn a_backup_is_whole_and_a_database_of_its_own() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, whole());
    world.store.flush_blocking().unwrap();
    let out = world.directory.path().join("copy.db");
    let mut steps = Vec::new();
    let report = world.reader().backup(&out, false, &mut |done, all| steps.push((done, all))).unwrap();
    assert_eq!(report.bytes, std::fs::metadata(&out).unwrap().len());
    assert!(steps.last().is_some_and(|(done, all)| done == all && *all > 0), "{steps:?}");
    assert_eq!(check(&out).unwrap().findings, []);
    let identity = |path: &std::path::Path| -> String {
        let reader = Reader::open(path).unwrap();
        reader.connection.query_row("SELECT identity FROM writer", [], |row| row.get(0)).unwrap()
    };
    assert_ne!(identity(&out), identity(world.store.path()));
    assert!(matches!(world.reader().backup(&out, false, &mut |_, _| ()), Err(StoreError::Exists(_))));
    world.reader().backup(&out, true, &mut |_, _| ()).unwrap();
    // A backup never replaces the database itself, nor a file whose log exists.
    let itself = world.store.path();
    assert!(matches!(world.reader().backup(itself, true, &mut |_, _| ()), Err(StoreError::InUse(_))));
    for beside in ["-wal", "-shm", ".lock"] {
        let mut path = itself.as_os_str().to_owned();
        path.push(beside);
        let refused = world.reader().backup(path.as_ref(), true, &mut |_, _| ());
        assert!(matches!(refused, Err(StoreError::InUse(_))), "{beside}: {refused:?}");
    }
    std::fs::write(world.directory.path().join("copy.db-wal"), b"log").unwrap();
    assert!(matches!(world.reader().backup(&out, true, &mut |_, _| ()), Err(StoreError::InUse(_))));
    let left: Vec<_> =
        std::fs::read_dir(world.directory.path()).unwrap().flatten().map(|file| file.file_name()).collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().ends_with(".part")), "{left:?}");
}

/// Makes the page that holds the root of this table or index unreadable, in the file itself.
fn damage_root(path: &std::path::Path, name: &str) -> Vec<u8> {
    let foreign = rusqlite::Connection::open_with_flags(path, rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY).unwrap();
    let sql = "SELECT rootpage FROM sqlite_schema WHERE name = ?1";
    let page = foreign.query_row(sql, [name], |row| row.get::<_, u32>(0)).unwrap() as usize;
    drop(foreign);
    let whole = std::fs::read(path).unwrap();
    let mut image = whole.clone();
    image[(page - 1) * 4096..(page - 1) * 4096 + 64].fill(0xA5);
    std::fs::write(path, &image).unwrap();
    whole
}

/// Returns a database with a finished capture of some thousand samples, closed.
fn with_old_capture(world: &World) -> std::path::PathBuf {
    let old = NewCapture { name: Some("old".to_owned()), ..NewCapture::new("pty", CaptureState::Complete) };
    let id = world.store.create_capture(old).unwrap();
    world.send(id, [segment(1, 0)].into_iter().chain((0..6000).map(|seq| sample(1, seq))));
    world.store.flush_blocking().unwrap();
    world.store.close().unwrap();
    world.store.path().to_owned()
}

#[test]
fn a_purge_that_meets_damage_ends_the_writing_for_good() {
    let world = World::new();
    let path = with_old_capture(&world);
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    let new = store.create_capture(NewCapture::new("pty", CaptureState::Capturing)).unwrap();
    store.delete_capture(1).unwrap();
    store.flush_blocking().unwrap();
    let whole = damage_root(&path, "sample");
    let files = || [std::fs::read(&path).unwrap(), std::fs::read(paths::wal_path(&path)).unwrap()];
    let before = files();
    // The first caller receives SQLite's error; the next one receives an instruction.
    assert!(store.purge_step().unwrap_err().is_damage());
    let error = store.purge_step().unwrap_err();
    assert_eq!(error.kind(), StoreErrorKind::Io);
    assert!(error.to_string().contains("vn100d check") && error.to_string().contains("vn100d recover"), "{error}");
    let progress = store.progress();
    assert!(progress.gives_up() && progress.io_failures_mono_ns.is_empty(), "{progress:?}");
    assert_eq!(store.status().error, Some(error.to_string()));
    for record in [segment(1, 0), sample(1, 0), sample(1, 1)] {
        store.records().blocking_send(new, record).unwrap();
    }
    std::thread::sleep(COMMIT_AFTER + Duration::from_millis(300));
    assert_eq!(store.close().unwrap_err().to_string(), error.to_string());
    assert!(files() == before, "the damaged files were changed");
    // The next start knows of the damage, even if its own check finds nothing.
    std::fs::write(&path, whole).unwrap();
    let refused = Store::open(&path, StoreOptions::default()).map(drop).unwrap_err();
    assert_eq!(refused.to_string(), error.to_string());
    // If the full check finds nothing, the user decides whether to continue, as the error states.
    assert_eq!(check(&path).unwrap().findings, []);
    std::fs::remove_file(paths::lock_path(&path)).unwrap();
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    while store.purge_step().unwrap() {}
    store.close().unwrap();
}

#[test]
fn damage_that_is_remembered_does_not_concern_the_database_that_takes_its_place() {
    let world = World::new();
    let path = with_old_capture(&world);
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    store.delete_capture(1).unwrap();
    damage_root(&path, "sample");
    assert!(store.purge_step().is_err());
    assert!(store.close().is_err());
    let out = world.directory.path().join("out.db");
    recover(&path, &out, false).unwrap();
    std::fs::rename(&out, &path).unwrap();
    std::fs::remove_file(paths::wal_path(&path)).unwrap();
    std::fs::remove_file(paths::shm_path(&path)).unwrap();
    Store::open(&path, StoreOptions::default()).unwrap().close().unwrap();
}

#[test]
fn a_commit_that_meets_damage_is_not_tried_again() {
    let world = World::new();
    let path = with_old_capture(&world);
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    let id = store.create_capture(NewCapture::new("pty", CaptureState::Capturing)).unwrap();
    damage_root(&path, "gap");
    for record in [segment(1, 0), sample(1, 0), gap(1, 3), segment(2, 1), sample(2, 1)] {
        store.records().blocking_send(id, record).unwrap();
    }
    let begun = std::time::Instant::now();
    while !store.progress().gives_up() {
        assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", store.progress());
        std::thread::sleep(Duration::from_millis(10));
    }
    let progress = store.progress();
    assert_eq!((progress.figures.failures, progress.figures.commits), (1, 0), "{progress:?}");
    assert!(store.close().unwrap_err().to_string().contains("vn100d recover"));
    assert!(Store::open(&path, StoreOptions::default()).is_err());
}

/// If its failures counted among those of commits, they would end the process or make the state flip with every commit.
#[test]
fn a_correction_that_fails_does_not_count_as_a_failed_commit() {
    let world = World::new();
    let id = world.capturing();
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
    let Record::Sample { sample: first, .. } = sample(1, 0) else { panic!() };
    let before_utc_ns = first.host_utc_ns + 10 * PERIOD_NS as i64;
    let records = [segment(1, 0)].into_iter().chain((0..10).map(|seq| sample(1, seq)));
    writer.write_now(records.map(|record| (id, record)));
    writer.write_now([
        (id, Record::UtcSet { by_ns: 1_000, before_utc_ns, boot_id: None, since_seq: None }),
        (id, sample(1, 10)),
    ]);
    let foreign = rusqlite::Connection::open(&path).unwrap();
    let sql = "CREATE TRIGGER refuse BEFORE UPDATE OF place ON utc_correction BEGIN SELECT RAISE(ABORT, 'no'); END";
    foreign.execute(sql, []).unwrap();
    for failure in 1..=5 {
        let next = writer.correct_now();
        let seen = progress::locked(&progress).clone();
        assert_eq!((seen.state, seen.figures.failures, seen.error.clone()), (Default::default(), 0, None));
        assert!(!seen.gives_up() && seen.io_failures_mono_ns.is_empty());
        assert_eq!(next.is_some(), failure < 5, "then it is the next start's");
        assert!(next.is_none_or(|next| next > Duration::from_secs(50)), "{next:?}");
        assert_eq!(writer.write_now([(id, sample(1, 10 + failure))]), 0);
    }
    drop(writer);
    foreign.execute("DROP TRIGGER refuse", []).unwrap();
    let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
    while writer.correct_now().is_some() {}
    let sql = "SELECT min(host_utc_ns), count(*) FROM sample";
    let found: (i64, i64) = foreign.query_row(sql, [], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    assert_eq!(found, (first.host_utc_ns + 1_000, 16));
}

/// Returns a writer beside an old capture, with a batch in the log, and the content of file and log once page `gap` is
/// damaged.
fn beside_damage(world: &World) -> (writer::Writer, SharedProgress, impl Fn() -> [Vec<u8>; 2] + use<>) {
    let path = with_old_capture(world);
    let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
    writer.write_now((6000..6010).map(|seq| (1, sample(1, seq))));
    let files = move || [std::fs::read(&path).unwrap(), std::fs::read(paths::wal_path(&path)).unwrap()];
    (writer, progress, files)
}

#[test]
fn no_civil_time_is_corrected_in_a_damaged_file() {
    let world = World::new();
    let (mut writer, progress, files) = beside_damage(&world);
    damage_root(world.store.path(), "gap");
    writer.write_now([(1, gap(6010, 3)), (1, segment(2, 6010)), (1, sample(2, 6010))]);
    assert!(progress::locked(&progress).damaged);
    let before = files();
    writer.correct_now();
    drop(writer);
    assert!(files() == before, "the damaged files were changed");
}

#[test]
fn damage_that_is_found_after_an_error_leaves_file_and_log_as_they_are() {
    for stopped in [false, true] {
        let world = World::new();
        let (mut writer, progress, files) = beside_damage(&world);
        // A reader keeps the log from being emptied while the writer is closed.
        let reader = Reader::open(world.store.path()).unwrap();
        assert_eq!(reader.capture(1).unwrap().samples, 6010);
        writer.pretend_io_error();
        drop(reader);
        damage_root(world.store.path(), "gap");
        let before = files();
        assert!(!before[1].is_empty());
        if stopped {
            assert!(writer.stop().unwrap_err().to_string().contains("vn100d recover"));
        } else {
            writer.write_now([(1, sample(1, 6010))]);
        }
        let seen = progress::locked(&progress).clone();
        assert!(seen.damaged, "{seen:?}");
        drop(writer);
        assert!(files() == before, "the damaged files were changed");
    }
}

#[test]
fn damage_that_a_reader_meets_counts_while_the_connection_is_closed() {
    let world = World::new();
    let (mut writer, progress, _) = beside_damage(&world);
    writer.pretend_io_error();
    assert!(!progress::locked(&progress).damaged);
    writer.take_report(Failure::of(&StoreError::Damaged("a page".to_owned())));
    let seen = progress::locked(&progress).clone();
    assert!(seen.damaged && seen.error.as_ref().is_some_and(|error| error.contains("vn100d recover")), "{seen:?}");
    // The damage is reported once.
    writer.take_report(Failure::of(&StoreError::Damaged("another".to_owned())));
    assert_eq!(progress::locked(&progress).figures.failures, seen.figures.failures);
}

#[test]
fn a_disk_that_has_gone_is_no_damage() {
    let world = World::new();
    let path = with_old_capture(&world);
    let lock = world.directory.path().join("lock");
    let (mut writer, progress) = super::tests::bare_writer(&path, &lock);
    writer.pretend_no_disk(&paths::lock_path(&lock));
    let code = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_CORRUPT);
    let corrupt = || super::writer::Failure::of(&rusqlite::Error::SqliteFailure(code, None).into());
    writer.take_report(corrupt());
    let seen = super::progress::locked(&progress).clone();
    assert!(!seen.damaged && seen.io_failures_mono_ns.len() == 1, "{seen:?}");
    drop(writer);
    // With a disk that takes the mark, the damage is recorded.
    let (mut writer, progress) = super::tests::bare_writer(&path, &lock);
    writer.take_report(corrupt());
    assert!(super::progress::locked(&progress).damaged);
    assert!(std::fs::read_to_string(paths::lock_path(&lock)).unwrap().contains("damaged: "));
}
