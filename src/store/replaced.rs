//! Tests of a database that is deleted or replaced, open or closed: which captures continue, and which files stay
//! untouched.

use crate::observe::StorageState;
use crate::store::file_id::{FileId, REFUSALS, kept_log, log_header};
use crate::store::tests::{World, bare_writer, sample, segment};
use crate::store::written::id_of;
use crate::store::{
    CaptureState, NewCapture, PageRequest, Reader, Store, StoreOptions, check, paths, progress, schema, writer,
};
use imu_core::sample::Record;
use std::path::{Path, PathBuf};
use std::time::Duration;

fn samples(id: i64, range: std::ops::Range<u64>) -> impl Iterator<Item = (i64, Record)> {
    range.map(move |seq| (id, sample(1, seq)))
}

/// Returns a capture `night` of an hour with 100 samples, closed.
fn night(world: &World) -> (PathBuf, i64) {
    let planned = Some(Duration::from_secs(3600));
    let new = NewCapture::new("pty", CaptureState::Capturing);
    let (name, note) = (Some("night".to_owned()), Some("on foam".to_owned()));
    let id = world.store.create_capture(NewCapture { name, note, planned, ..new }).unwrap();
    world.send(id, [segment(1, 0)]);
    world.send(id, samples(id, 0..100).map(|(_, record)| record));
    world.store.close().unwrap();
    (world.store.path().to_owned(), id)
}

/// Returns another database with its own captures.
fn other(world: &World) -> PathBuf {
    let path = world.directory.path().join("other.db");
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    for number in 1..=3 {
        let new = NewCapture::new("pty", CaptureState::Complete);
        let name = Some(format!("other {number}"));
        let id = store.create_capture(NewCapture { name, ..new }).unwrap();
        store.records().blocking_send(id, segment(1, 0)).unwrap();
        for (id, record) in samples(id, 0..1000) {
            store.records().blocking_send(id, record).unwrap();
        }
    }
    store.close().unwrap();
    path
}

/// Returns names and samples of the captures in an intact database.
fn content(path: &Path) -> Vec<(String, u64)> {
    assert_eq!(check(path).unwrap().findings, []);
    let reader = Reader::open(path).unwrap();
    let page = reader.captures(None, &PageRequest::default()).unwrap();
    page.rows.into_iter().map(|row| (row.name, row.samples)).collect()
}

fn others() -> Vec<(String, u64)> {
    (1..=3).rev().map(|number| (format!("other {number}"), 1000)).collect()
}

#[test]
fn a_file_replaced_while_it_is_closed_takes_the_captures_and_never_the_old_log() {
    let world = World::new();
    let (path, id) = night(&world);
    let other = other(&world);
    // A reader of the old file keeps its log from being emptied.
    let reader = Reader::open(&path).unwrap();
    assert_eq!(reader.capture(id).unwrap().samples, 100);
    let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
    assert_eq!(writer.write_now(samples(id, 100..150)), 0);
    writer.pretend_io_error();
    assert!(log_header(&path).is_some(), "the log is there");
    let moved = world.directory.path().join("moved.db");
    std::fs::rename(&path, &moved).unwrap();
    std::fs::copy(&other, &path).unwrap();
    assert_eq!(writer.write_now(samples(id, 150..160)), 1, "first it is said");
    let seen = progress::locked(&progress).clone();
    assert_eq!((seen.committed[&id], seen.moved[&id]), (160, 4));
    let mut expected = others();
    expected.insert(0, ("night".to_owned(), 10));
    assert_eq!(content(&path), expected);
    let row = Reader::open(&path).unwrap().capture(4).unwrap();
    assert_eq!((row.state, row.note.as_deref()), (CaptureState::Capturing, Some("on foam")));
    let planned = row.planned_duration_s.unwrap();
    assert!((planned - (3600.0 - 150.0 / 40.0)).abs() < 1e-6, "{planned} s are left");
    drop(reader);
    // The data missing in the old file is in the log that was kept.
    let mut kept = path.as_os_str().to_owned();
    kept.push(".lost-1-wal");
    std::fs::rename(PathBuf::from(kept), paths::wal_path(&moved)).unwrap();
    assert_eq!(content(&moved), [("night".to_owned(), 150)]);
    // The file is lost again: each capture continues once.
    writer.pretend_io_error();
    std::fs::remove_file(&path).unwrap();
    writer.write_now(samples(id, 160..165));
    assert_eq!(content(&path), [("night".to_owned(), 5)]);
    assert_eq!(progress::locked(&progress).committed[&id], 165);
}

#[test]
fn another_database_in_a_file_of_the_same_number_is_another() {
    let world = World::new();
    let (path, id) = night(&world);
    let other = other(&world);
    let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
    writer.pretend_io_error();
    let number = id_of(&path);
    std::fs::write(&path, std::fs::read(other).unwrap()).unwrap();
    assert_eq!(id_of(&path), number);
    writer.write_now(samples(id, 100..110));
    let mut expected = others();
    expected.insert(0, ("night".to_owned(), 10));
    assert_eq!(content(&path), expected);
}

#[test]
fn the_same_database_on_a_device_of_another_number_goes_on() {
    let world = World::new();
    let (path, id) = night(&world);
    let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
    let identity = writer::identity_of(&Reader::open(&path).unwrap().connection).unwrap();
    let (device, number) = id_of(&path).unwrap();
    let mut file = FileId::of(&path);
    file.database = Some((device + 1, number));
    assert!(!file.is_replaced(&path, &identity) && file.is_replaced(&path, "another"));
    file.database = Some((device, number + 1));
    assert!(!file.is_replaced(&path, &identity), "vfat numbers its files anew at each mount");
    file.copied = i64::MAX;
    assert!(file.is_replaced(&path, &identity), "an older copy is not the file that was written");
    (file.copied, file.let_go) = (0, true);
    assert!(file.is_replaced(&path, &identity), "the path named another file while this one was held");
    writer.pretend_io_error();
    assert_eq!(writer.write_now(samples(id, 100..110)), 0);
    assert_eq!(content(&path), [("night".to_owned(), 110)]);
}

/// Writes the path's file again, under another inode number.
fn renumber(path: &Path, content: &[u8]) {
    let (beside, number) = (path.with_extension("beside"), id_of(path));
    std::fs::write(&beside, content).unwrap();
    std::fs::rename(&beside, path).unwrap();
    assert_ne!(id_of(path), number);
}

#[test]
fn the_same_database_under_another_number_keeps_its_own_log() {
    let world = World::new();
    let (path, id) = night(&world);
    let reader = Reader::open(&path).unwrap();
    assert_eq!(reader.capture(id).unwrap().samples, 100);
    let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
    assert_eq!(writer.write_now(samples(id, 100..150)), 0);
    writer.pretend_io_error();
    assert!(log_header(&path).is_some(), "the log is there");
    drop(reader.connection);
    renumber(&path, &std::fs::read(&path).unwrap());
    assert_eq!(writer.write_now(samples(id, 150..160)), 0);
    assert_eq!(content(&path), [("night".to_owned(), 160)]);
    assert!(!kept_log(&path).to_string_lossy().contains(".lost-2"), "no log was moved aside");
}

#[test]
fn an_older_copy_of_the_same_database_never_takes_the_newer_log() {
    let world = World::new();
    let (path, id) = night(&world);
    let older = std::fs::read(&path).unwrap();
    let reader = Reader::open(&path).unwrap();
    assert_eq!(reader.capture(id).unwrap().samples, 100);
    let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
    assert_eq!(writer.write_now(samples(id, 100..150)), 0);
    // The log is copied into the file; the log begins again with the next records.
    let copied = schema::reopen(&path).unwrap();
    copied.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(())).unwrap();
    assert_eq!(writer.write_now(samples(id, 150..160)), 0);
    drop(copied);
    writer.pretend_io_error();
    assert!(log_header(&path).is_some(), "the log is there");
    renumber(&path, &older);
    assert_eq!(writer.write_now(samples(id, 160..170)), 1);
    assert_eq!(content(&path), [("night-2".to_owned(), 10), ("night".to_owned(), 100)]);
    assert!(kept_log(&path).to_string_lossy().contains(".lost-2"), "the log was kept");
}

#[test]
fn a_copy_that_is_still_on_its_way_is_waited_for() {
    let world = World::new();
    let (path, id) = night(&world);
    let whole = std::fs::read(other(&world)).unwrap();
    let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
    writer.pretend_io_error();
    renumber(&path, &whole[..4096]);
    assert_eq!(writer.attempt(), StorageState::StorageLost);
    for part in 2..=10 {
        assert_eq!(writer.attempt(), StorageState::StorageLost, "{part}: {:?}", progress::locked(&progress));
        // The copy pauses now and then.
        if part % 3 != 0 {
            std::fs::write(&path, &whole[..4096 * part]).unwrap();
        }
    }
    std::fs::write(&path, &whole).unwrap();
    assert_eq!(writer.attempt(), StorageState::StorageLost, "it has just changed");
    assert_eq!(writer.write_now(samples(id, 100..110)), 0);
    let mut expected = others();
    expected.insert(0, ("night".to_owned(), 10));
    assert_eq!(content(&path), expected);
}

#[test]
fn half_a_file_that_stays_as_it_is_is_refused_in_the_end_and_the_log_stays() {
    let world = World::new();
    let (path, id) = night(&world);
    let whole = std::fs::read(other(&world)).unwrap();
    let reader = Reader::open(&path).unwrap();
    assert_eq!(reader.capture(id).unwrap().samples, 100);
    let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
    assert_eq!(writer.write_now(samples(id, 100..110)), 0);
    writer.pretend_io_error();
    let log = std::fs::read(paths::wal_path(&path)).unwrap();
    let garbage = vec![7; whole.len() / 2];
    renumber(&path, &garbage);
    for _ in 0..REFUSALS {
        assert_eq!(writer.attempt(), StorageState::StorageLost);
    }
    assert_eq!(writer.attempt(), StorageState::StorageError);
    let seen = progress::locked(&progress).clone();
    assert!(seen.damaged && seen.error.as_ref().is_some_and(|error| error.contains("damaged")), "{seen:?}");
    assert!(std::fs::read(&path).unwrap() == garbage);
    assert!(std::fs::read(paths::wal_path(&path)).unwrap() == log, "it may be that file's own");
}

#[test]
fn a_log_that_is_taken_away_while_it_is_closed_ends_the_writing() {
    let world = World::new();
    let (path, id) = night(&world);
    let reader = Reader::open(&path).unwrap();
    assert_eq!(reader.capture(id).unwrap().samples, 100);
    let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
    writer.write_now(samples(id, 100..150));
    writer.pretend_io_error();
    drop(reader);
    std::fs::remove_file(paths::wal_path(&path)).unwrap();
    let before = std::fs::read(&path).unwrap();
    writer.write_now(samples(id, 150..160));
    let seen = progress::locked(&progress).clone();
    assert!(seen.damaged && seen.error.as_ref().is_some_and(|error| error.contains("-wal")), "{seen:?}");
    assert!(std::fs::read(&path).unwrap() == before);
}

#[test]
fn a_database_moved_into_place_with_its_own_log_keeps_it() {
    let world = World::new();
    let (path, id) = night(&world);
    // Another database, copied while its last batch is only in its log.
    let source = other(&world);
    let (mut second, _) = bare_writer(&source, &world.directory.path().join("other.lock"));
    assert_eq!(second.write_now(samples(3, 1000..1050)), 0);
    let newcomer = world.directory.path().join("newcomer.db");
    std::fs::copy(&source, &newcomer).unwrap();
    std::fs::copy(paths::wal_path(&source), paths::wal_path(&newcomer)).unwrap();
    let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
    assert_eq!(writer.write_now(samples(id, 100..150)), 0);
    std::fs::rename(paths::wal_path(&newcomer), paths::wal_path(&path)).unwrap();
    std::fs::rename(&newcomer, &path).unwrap();
    writer.check_now();
    assert!(paths::wal_path(&path).exists(), "it is the newcomer's");
    assert_eq!(writer.write_now(samples(id, 150..160)), 0);
    assert_eq!(
        content(&path)[..2],
        [("night".to_owned(), 10), ("other 3".to_owned(), 1050)],
        "what stood in the newcomer's log is there"
    );
}
