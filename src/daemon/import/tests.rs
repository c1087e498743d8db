//! Imports into a separate database.

use super::*;
use crate::clock::SystemClock;
use crate::jobs::JobsOptions;
use crate::store::StoreOptions;
use imu_core::sample::StatedSampling;
use imu_files::recording::{ColumnMap, MessageDefinition};
use std::path::PathBuf;
use vn100_testkit::ros2;

/// An import that outlasts the daemon's patience finds the store closed; its client receives the answer that the daemon
/// stops. Unit tests have no program that could read the recording.
#[test]
fn an_import_that_fails_because_the_daemon_ends_reports_this_reason() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("vn100d.db"), StoreOptions::default()).unwrap();
    let jobs = Jobs::start(&store, JobsOptions::default()).unwrap();
    let importer = DaemonImporter::new(store.clone(), jobs.clone(), Arc::new(SystemClock), 0);
    let file = folder.path().join("desk.csv");
    std::fs::write(&file, "time_s,gyro_x_rad_s\n0,1\n0.025,2\n0.05,1\n").unwrap();
    let import = || {
        let request = ImportRequest {
            file: file.clone(),
            called: "desk.csv".to_owned(),
            name: None,
            rate_hz: None,
            filter_window: None,
            internal_rate_hz: None,
            columns: None,
            definitions: Vec::new(),
            from: None,
            to: None,
            channels: None,
            note: None,
            abandoned: CancellationToken::new(),
        };
        importer.import(request).unwrap_err()
    };
    assert!(matches!(import(), control::ImportError::Process(_)), "the daemon is not ending");
    jobs.stop();
    store.close().unwrap();
    let error = super::import(&store, &SystemClock, Source::of(&file), None, &mut |_, _| Ok(())).unwrap_err();
    assert!(matches!(error, ImportError::Store(_)), "{error}");
    importer.call_off();
    assert!(matches!(import(), control::ImportError::Stopping));
}

#[test]
fn a_name_after_the_file_is_one_that_a_capture_may_have_where_there_is_one() {
    for (file, name) in [
        ("/data/desk.csv", "desk"),
        ("run.imu.raw.txt.gz", "run.imu.raw"),
        (" night 1 .csv", "night 1"),
        ("a\nb\u{7}.bag", "ab"),
        ("circles_0.db3", "circles_0"),
        ("desk.mcap", "desk"),
        ("port.bin", "port"),
    ] {
        assert_eq!(name_of(Path::new(file)), name);
        check_name(name).unwrap();
    }
    let long = name_of(Path::new(&format!("{} {}.csv", "ä".repeat(99), "b".repeat(40))));
    assert_eq!(long, "ä".repeat(99), "no space at the end is left by the cut");
    check_name(&long).unwrap();
    // These are not valid names: the capture is named after the time.
    for file in ["2024.csv", ".csv", "latest.txt", "/", ".."] {
        check_name(&name_of(Path::new(file))).unwrap_err();
    }
}

fn counts(imported: &Imported) -> (u64, u64, u64) {
    (imported.report.samples, imported.report.missing, imported.report.gaps)
}

/// A world of one database.
struct World {
    folder: tempfile::TempDir,
    store: Store,
}

impl World {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("vn100d.db"), StoreOptions::default()).unwrap();
        Self { folder, store }
    }
    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
    fn import(&self, file: &Path, pairs: &[&str], definitions: &[(&str, &str)]) -> Result<Imported, ImportError> {
        let definitions = definitions.iter().map(|(name, text)| MessageDefinition::new(name, text).unwrap()).collect();
        let columns = ColumnMap::parse(pairs).unwrap();
        let source = Source { columns, definitions: MessageDefinition::list(definitions).unwrap(), ..Source::of(file) };
        import(&self.store, &SystemClock, source, None, &mut |_, _| Ok(()))
    }
    fn count(&self, table: &str) -> i64 {
        let database = rusqlite::Connection::open(self.folder.path().join("vn100d.db")).unwrap();
        database.query_row(&format!("SELECT count(*) FROM {table}"), [], |row| row.get(0)).unwrap()
    }
}

fn foreign() -> String {
    let mut text = String::from("t;gx;az\n");
    for row in 0..4000 {
        text.push_str(&format!(
            "{};{:.2};{:.4}\n",
            row * 25,
            0.05 * f64::from(row * 7919 % 101),
            1.0 + 1e-4 * f64::from(row % 3)
        ));
    }
    text
}

#[test]
fn the_same_file_read_the_same_way_is_one_capture_and_another_reading_another() {
    let world = World::new();
    let file = world.file("desk.csv", foreign().as_bytes());
    let of = |pairs: &[&str]| world.import(&file, pairs, &[]).unwrap();
    let first = of(&["t=time_ms,gx=gyro_x_dps"]);
    assert!(matches!(first.end, ImportEnd::Created(_)) && counts(&first) == (4000, 0, 0), "{first:?}");
    let again = of(&["gx=gyro_x_dps", "t=time_ms"]);
    assert!(matches!(again.end, ImportEnd::Known(_)) && again.end.id() == first.end.id(), "{again:?}");
    let other = of(&["gx=gyro_y_dps", "t=time_ms"]);
    assert!(matches!(other.end, ImportEnd::Created(_)) && other.end.id() != first.end.id(), "{other:?}");
    // The steps of the values are each channel's resolution.
    let database = rusqlite::Connection::open(world.folder.path().join("vn100d.db")).unwrap();
    let resolution: f64 = database
        .query_row("SELECT resolution FROM channel WHERE capture_id = ?1", [first.end.id()], |row| row.get(0))
        .unwrap();
    assert!((resolution / 0.05_f64.to_radians() - 1.0).abs() < 1e-6, "{resolution}");
    world.store.close().unwrap();
}

#[test]
fn what_a_killed_recorder_left_in_the_log_beside_a_bag_makes_it_another_recording() {
    let world = World::new();
    let stamp_ns = |index: usize| 1_729_716_663_000_000_000 + 25_000_000 * index as u64;
    let data = |index: usize| ros2::Cdr::little_endian().imu(stamp_ns(index), [0.0; 3], [9.8; 3]).bytes();
    let messages: Vec<_> = (0..40).map(|index| (0, stamp_ns(index) as i64, data(index))).collect();
    let file = world.file("run.db3", &ros2::db3(&[("/imu", "sensor_msgs/msg/Imu", None)], &messages));
    let bag = rusqlite::Connection::open(&file).unwrap();
    bag.pragma_update(None, "journal_mode", "wal").unwrap();
    let log = |index: usize| {
        let sql = "INSERT INTO messages VALUES (NULL, 1, ?1, ?2)";
        bag.execute(sql, rusqlite::params![stamp_ns(index) as i64, data(index)]).unwrap();
    };
    log(40);
    let first = world.import(&file, &[], &[]).unwrap();
    assert_eq!(counts(&first), (41, 0, 0));
    log(41);
    let second = world.import(&file, &[], &[]).unwrap();
    assert!(matches!(second.end, ImportEnd::Created(_)) && counts(&second) == (42, 0, 0), "{second:?}");
    let again = world.import(&file, &[], &[]).unwrap();
    assert!(matches!(again.end, ImportEnd::Known(_)) && again.end.id() == second.end.id(), "{again:?}");
    assert_eq!(counts(&again), (42, 0, 0), "as the database has it");
    world.store.close().unwrap();
}

#[test]
fn a_message_that_the_bag_does_not_define_is_read_by_the_users_definition() {
    let world = World::new();
    let data = |index: usize| {
        ros2::Cdr::little_endian()
            .header(1_729_716_663_000_000_000 + 25_000_000 * index as u64)
            .wide(&[index as f64])
            .bytes()
    };
    let messages: Vec<_> =
        (0..40).map(|index| (0, 1_729_716_663_000_000_000 + 25_000_000 * index as i64, data(index))).collect();
    let file = world.file("own.db3", &ros2::db3(&[("/own", "own_msgs/msg/Reading", None)], &messages));
    let error = world.import(&file, &[], &[]).unwrap_err().to_string();
    assert!(
        error.contains("own.db3") && error.contains("own_msgs") && error.contains("--message-definition"),
        "{error}"
    );
    let text = "std_msgs/Header header\nfloat64 gyro_x_rad_s\n";
    let first = world.import(&file, &[], &[("own_msgs/msg/Reading", text)]).unwrap();
    assert_eq!((counts(&first), first.report.rate_hz), ((40, 0, 0), 40.0));
    let again = world.import(&file, &[], &[("own_msgs/Reading", text)]).unwrap();
    assert_eq!(again.end.id(), first.end.id());
    let other = world.import(&file, &[], &[("own_msgs/Reading", &text.replace("gyro_x", "gyro_y"))]).unwrap();
    assert_ne!(other.end.id(), first.end.id());
    world.store.close().unwrap();
}

#[test]
fn an_import_that_fails_on_its_way_leaves_nothing_in_the_database() {
    let world = World::new();
    let mut text = String::from("time_s,gyro_x_rad_s\n");
    for row in 0..60_000 {
        text.push_str(&format!("{:.3},{}\n", f64::from(row) * 0.025, row % 7));
    }
    let file = world.file("desk.csv", text.as_bytes());
    let written = std::cell::Cell::new(0);
    let mut full = |samples, _| {
        written.set(samples);
        if samples < 40_000 { Ok(()) } else { Err(ImportError::NoRoom { free_mib: 1, reserve_mib: 2 }) }
    };
    let error = import(&world.store, &SystemClock, Source::of(&file), None, &mut full).unwrap_err();
    assert!(matches!(error, ImportError::NoRoom { .. }) && written.get() >= 40_000, "{error}");
    while world.store.purge_step().unwrap() {}
    assert_eq!(["capture", "sample", "segment", "gap", "event", "channel"].map(|table| world.count(table)), [0; 6]);
    // It is not a known recording either.
    let taken = world.import(&file, &[], &[]).unwrap();
    assert!(matches!(taken.end, ImportEnd::Created(_)) && taken.report.samples == 60_000);
    world.store.close().unwrap();
}

#[test]
fn what_is_no_recording_is_refused_before_all_of_it_is_read_and_leaves_nothing() {
    let world = World::new();
    let file = world.file("zeros", &[]);
    std::fs::OpenOptions::new().write(true).open(&file).unwrap().set_len(10 << 30).unwrap();
    let begun = std::time::Instant::now();
    let error = world.import(&file, &[], &[]).unwrap_err().to_string();
    assert!(error.contains("zeros") && error.contains("expected raw `$VN…` lines"), "{error}");
    assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    for (name, bytes, words) in [
        ("empty.csv", &b""[..], "is empty"),
        ("header.csv", b"time_s,gyro_x_rad_s\n", "has no sample"),
        ("words.csv", b"time_s,gyro_x_rad_s\na,b\nc,d\n", "line 2 (malformed)"),
        ("foreign.csv", b"t,gx\n0,1\n", "--columns"),
        ("one.csv", b"time_s,gyro_x_rad_s\n0,1\n", "no two stamps"),
        ("cut.csv.gz", b"\x1F\x8B\x08\x00", "ends in the middle of its compressed data"),
    ] {
        let error = world.import(&world.file(name, bytes), &[], &[]).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(words), "{name}: {error}");
    }
    assert_eq!(["capture", "sample", "event"].map(|table| world.count(table)), [0; 3]);
    world.store.close().unwrap();
}

/// A stated sampling is stored with the capture, for its analyses. One file with two samplings makes two captures.
#[test]
fn how_samples_came_about_is_kept_and_has_to_fit() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("vn100d.db"), StoreOptions::default()).unwrap();
    let file = folder.path().join("desk.csv");
    let rows: String = (0..400).map(|row| format!("{:.3},{}\n", f64::from(row) * 0.025, row % 7)).collect();
    std::fs::write(&file, format!("time_s,gyro_x_rad_s\n{rows}")).unwrap();
    let import_with = |filter_window, internal_rate_hz| {
        let source = Source { sampling: Some(StatedSampling { filter_window, internal_rate_hz }), ..Source::of(&file) };
        import(&store, &SystemClock, source, None, &mut |_, _| Ok(())).map(|imported| imported.end)
    };
    let refused = import_with(4, Some(1010.0)).unwrap_err().to_string();
    assert!(refused.contains("1010 Hz") && refused.contains("40.0000 Hz"), "{refused}");
    let [four, eight] = [import_with(4, None), import_with(8, Some(1000.0))].map(|end| end.unwrap().id());
    assert!(four != eight && matches!(import_with(4, Some(800.0)).unwrap(), ImportEnd::Known(id) if id == four));
    let reader = store.reader().unwrap();
    for (id, window, internal_hz) in [(four, 4, 800.0), (eight, 8, 1000.0)] {
        let plan = crate::jobs::Plan::read(&reader, id, 400, &[imu_core::sample::Channel::GyroX]).unwrap();
        let found = plan.sampling(imu_core::sample::Channel::GyroX).unwrap();
        assert_eq!((found.window, found.internal_rate_hz, found.source.as_str()), (window, internal_hz, "option"));
    }
    // As databases of earlier versions hold it; `first_stamp_s` was added.
    let configuration = reader.capture(four).unwrap().configuration;
    let kept: Vec<_> = configuration.entries().map(|(key, value)| (key, value.clone())).collect();
    let keys: Vec<_> = kept.iter().map(|(key, _)| *key).collect();
    let expected = "columns conversions file findings first_stamp_s ignored_columns kind message_definitions rate_hz remarks sampling \
                    stamp_choice stamp_grid stamps";
    assert_eq!(keys.join(" "), expected);
    let grid = &kept[keys.iter().position(|key| *key == "stamp_grid").unwrap()].1;
    let grid: Vec<_> = grid.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(grid, ["jitter_s", "losses_resolved", "period_s", "rounding_s"]);
}
