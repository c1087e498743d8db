//! The store's guarantees, on real files.

use super::*;
use imu_core::sample::record::CaptureEnd;
use imu_core::sample::{
    Channel, ConnectedSensor, DiscardCause, EventKind, EventRecord, Gap, GapCause, Record, Sample, Segment, Timebase,
};
use std::time::{Duration, Instant};

const START_NS: i64 = 1_800_000_000_000_000_000;
const PERIOD_NS: u64 = 25_000_000;

pub(super) fn segment(number: u32, first_seq: u64) -> Record {
    Record::Segment(Segment {
        number,
        epoch: 1,
        first_seq,
        rate_hz: 40.0,
        timebase: Timebase::Device,
        channels: [Channel::AccelZ, Channel::GyroX].into_iter().collect(),
        first_device_time_ns: Some(first_seq * PERIOD_NS),
        first_utc_ns: START_NS + (first_seq * PERIOD_NS) as i64,
        boot_id: None,
    })
}

pub(super) fn sample(segment: u32, seq: u64) -> Record {
    let mut sample = Sample::at(seq * PERIOD_NS + 1, START_NS + (seq * PERIOD_NS) as i64);
    sample.device_time_ns = Some(seq * PERIOD_NS);
    sample.set(Channel::GyroX, seq as f64 * 1e-6);
    sample.set(Channel::AccelZ, -9.8 - seq as f64 * 1e-3);
    Record::Sample { seq, segment, sample }
}

pub(super) fn gap(before_seq: u64, missing: u64) -> Record {
    Record::Gap(Gap {
        before_seq,
        from_utc_ns: START_NS + ((before_seq - 1) * PERIOD_NS) as i64,
        to_utc_ns: START_NS + ((before_seq + missing) * PERIOD_NS) as i64,
        device_ns: Some(((before_seq - 1) * PERIOD_NS, (before_seq + missing) * PERIOD_NS)),
        missing,
        missing_exact: true,
        cause: GapCause::Checksum,
    })
}

fn event(kind: EventKind) -> Record {
    let detail = Some(serde_json::json!({"port": "/dev/ttyUSB0"}));
    Record::Event(EventRecord { utc_ns: START_NS, kind, message: "said".to_owned(), detail })
}

pub(super) struct World {
    pub(super) directory: tempfile::TempDir,
    pub(super) store: Store,
}

impl World {
    pub(super) fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let store = Store::open(&directory.path().join("data/vn100d.db"), StoreOptions::default()).unwrap();
        Self { directory, store }
    }
    pub(super) fn capturing(&self) -> i64 {
        let capture = NewCapture { name: Some("night".to_owned()), ..NewCapture::new("pty", CaptureState::Capturing) };
        self.store.create_capture(capture).unwrap()
    }
    /// Returns a capture that has ended, without samples.
    pub(super) fn complete(&self, name: &str) -> i64 {
        let capture = NewCapture { name: Some(name.to_owned()), ..NewCapture::new("pty", CaptureState::Complete) };
        self.store.create_capture(capture).unwrap()
    }
    pub(super) fn send(&self, id: i64, records: impl IntoIterator<Item = Record>) {
        for record in records {
            self.store.records().blocking_send(id, record).unwrap();
        }
    }
    pub(super) fn reader(&self) -> Reader {
        self.store.reader().unwrap()
    }
    fn one<T: rusqlite::types::FromSql>(&self, sql: &str) -> T {
        self.reader().connection.query_row(sql, [], |row| row.get(0)).unwrap()
    }
    pub(super) fn wait_for(&self, what: &str, condition: impl Fn(&WriterProgress) -> bool) {
        let begun = Instant::now();
        while !condition(&self.store.progress()) {
            assert!(begun.elapsed() < Duration::from_secs(20), "{what}: {:?}", self.store.progress());
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Returns the writer without its thread.
pub(super) fn bare_writer(path: &std::path::Path, lock: &std::path::Path) -> (Writer, SharedProgress) {
    let (_, records) = mpsc::channel(1);
    let (_, commands) = mpsc::unbounded_channel();
    let progress = SharedProgress::default();
    let connection = schema::reopen(path).unwrap();
    schema::keep_log(&connection, false).unwrap();
    let parts = WriterParts {
        path: path.to_owned(),
        clock: Arc::new(SystemClock),
        records,
        commands,
        progress: progress.clone(),
        waiting: Default::default(),
        lock: lock::WriterLock::take(lock).unwrap(),
        file_check: Duration::from_secs(10),
        wal_alarm_bytes: 1 << 28,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    (runtime.block_on(async { Writer::new(parts, connection) }).unwrap(), progress)
}

/// Returns 100 samples, a gap of 3, 50 samples, an event, rejections, and the end.
pub(super) fn a_capture() -> Vec<Record> {
    let mut records = vec![event(EventKind::CaptureStarted), segment(1, 0)];
    records.extend((0..100).map(|seq| sample(1, seq)));
    records.push(Record::Discarded { cause: DiscardCause::Checksum, count: 3 });
    records.extend([gap(100, 3), segment(2, 100)]);
    records.extend((100..150).map(|seq| sample(2, seq)));
    records.push(Record::Discarded { cause: DiscardCause::Checksum, count: 1 });
    records.push(Record::Discarded { cause: DiscardCause::GarbageBytes, count: 17 });
    records.push(Record::Ended { how: CaptureEnd::Complete, utc_ns: START_NS + 4_000_000_000 });
    records
}

#[test]
fn what_was_recorded_can_be_read_by_its_documented_names() {
    let world = World::new();
    let id = world.capturing();
    let (model, serial_number) = (Some("VN-100T-CR".to_owned()), Some("0100012345".to_owned()));
    let sensor = ConnectedSensor { model, serial_number, rate_hz: 40.0, ..ConnectedSensor::default() };
    world.send(id, [Record::Configuration(Box::new(sensor))]);
    world.send(id, a_capture());
    world.store.flush_blocking().unwrap();
    let reader = world.reader();
    let row = serde_json::to_value(reader.capture(id).unwrap()).unwrap();
    assert_eq!(row["state"], "complete");
    assert_eq!(row["name"], "night");
    assert_eq!(row["samples"], 150);
    assert_eq!(row["missing"], 3);
    assert_eq!(row["gaps"], 1);
    assert_eq!(row["segments"], 2);
    assert_eq!(row["rate_hz"], 40.0);
    assert_eq!(row["duration_s"], 153.0 / 40.0);
    assert_eq!(row["started_at"], "2027-01-15T08:00:00.000000000Z");
    assert_eq!(row["ended_at"], "2027-01-15T08:00:04.000000000Z");
    assert_eq!(row["rejected"], serde_json::json!({"checksum": 4, "garbage_bytes": 17}));
    assert_eq!(row["channels"], serde_json::json!(["accel_z", "gyro_x"]));
    assert_eq!(row["units"]["gyro_x"]["unit"], "rad/s");
    assert_eq!(row["sensor"]["serial_number"], "0100012345");
    assert_eq!(row["configuration"]["rate_hz"], 40.0);
    let gaps = reader.gaps(id, &PageRequest::default()).unwrap();
    assert_eq!((gaps.rows.len(), gaps.next), (1, None));
    assert_eq!((gaps.rows[0].missing, gaps.rows[0].before_seq, gaps.rows[0].cause), (3, 100, GapCause::Checksum));
    let segments = reader.segments(id, &PageRequest::default()).unwrap().rows;
    assert_eq!(segments.iter().map(|row| row.samples).collect::<Vec<_>>(), [100, 50]);
    assert_eq!(segments[1].last_device_time_ns, Some(149 * PERIOD_NS));
    assert_eq!(reader.events(id, &PageRequest::default()).unwrap().rows[0].kind, "capture_started");
    assert_eq!(world.store.progress().committed[&id], 150);
}

#[test]
fn any_sqlite_client_can_take_the_mean_of_a_channel() {
    let world = World::new();
    let id = world.capturing();
    assert_eq!(id, 1);
    world.send(id, a_capture());
    world.store.flush_blocking().unwrap();
    let mean: f64 = world.one("SELECT avg(gyro_x) FROM sample WHERE capture_id=1");
    assert!((mean - 74.5e-6).abs() < 1e-15, "{mean}");
    assert_eq!(world.one::<String>("PRAGMA integrity_check"), "ok");
}

#[test]
fn a_chunk_has_the_values_as_they_came_and_nan_where_there_was_none() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, a_capture());
    world.store.flush_blocking().unwrap();
    let reader = world.reader();
    let channels = [Channel::GyroX, Channel::Yaw, Channel::AccelZ];
    let chunk = reader.read_samples(id, 90, 20, &channels).unwrap();
    assert_eq!((chunk.first_seq, chunk.len(), chunk.next_seq()), (90, 20, 110));
    assert_eq!(chunk.segment[9..11], [1, 2]);
    assert_eq!(chunk.columns[0][3].to_bits(), (93.0_f64 * 1e-6).to_bits());
    assert_eq!(chunk.columns[2][3].to_bits(), (-9.8 - 93.0_f64 * 1e-3).to_bits());
    assert!(chunk.columns[1].iter().all(|value| value.is_nan()));
    assert_eq!(chunk.times.unwrap().device_ns[19], Some(109 * PERIOD_NS));
    assert_eq!(reader.read_chunk(id, 140, 1000, &channels).unwrap().len(), 10);
    assert!(reader.read_chunk(id, 150, 10, &channels).unwrap().is_empty());
    assert_eq!(reader.seq_range(id).unwrap(), Some(SeqRange { first: 0, last: 149 }));
}

#[test]
fn the_same_records_again_count_once() {
    let world = World::new();
    let id = world.capturing();
    let records: Vec<Record> = a_capture()
        .into_iter()
        .filter(|record| matches!(record, Record::Sample { .. } | Record::Segment(_) | Record::Gap(_)))
        .collect();
    world.send(id, records.clone());
    world.send(id, records[..40].to_vec());
    world.store.flush_blocking().unwrap();
    world.send(id, records);
    world.store.flush_blocking().unwrap();
    let row = world.reader().capture(id).unwrap();
    assert_eq!((row.samples, row.missing, row.gaps, row.segments), (150, 3, 1, 2));
    assert_eq!(row.duration_s, 153.0 / 40.0);
    assert_eq!(world.one::<i64>("SELECT count(*) FROM sample"), 150);
    assert_eq!(world.one::<i64>("SELECT sum(samples) FROM segment"), 150);
}

#[test]
fn samples_that_are_there_already_stay_wherever_in_a_statement_they_come() {
    for (from, to) in [(0, 20), (0, 33), (31, 64), (40, 41), (95, 100)] {
        let world = World::new();
        let id = world.capturing();
        let mut connection = rusqlite::Connection::open(world.store.path()).unwrap();
        // The writer sometimes runs its own transaction: one that begins with a read would not wait for it.
        let transaction = connection.transaction_with_behavior(rusqlite::TransactionBehavior::Immediate).unwrap();
        let of = |from: u64, to: u64| (from..to).map(|seq| (id, sample(1, seq))).collect::<Vec<_>>();
        super::insert::insert(&transaction, &[(id, segment(1, 0))], 0, 0).unwrap();
        let mut first = of(from, to);
        // A sample with other values under the same number is not taken for new.
        if let Record::Sample { sample, .. } = &mut first[0].1 {
            sample.set(Channel::GyroX, 42.0);
        }
        assert_eq!(super::insert::insert(&transaction, &first, 0, 0).unwrap().samples, to - from);
        let inserted = super::insert::insert(&transaction, &of(0, 100), 0, 0).unwrap();
        assert_eq!((inserted.samples, inserted.refused), (100 - (to - from), 0), "{from}..{to}");
        assert_eq!(inserted.committed[&id], 100);
        let rows = "SELECT count(*), max(seq) + 1, sum(gyro_x = 42), sum(gyro_x = seq * 1e-6) FROM sample";
        let counts = transaction
            .query_row(rows, [], |row| Ok([0, 1, 2, 3].map(|column| row.get::<_, i64>(column).unwrap())))
            .unwrap();
        assert_eq!(counts, [100, 100, 1, 99], "{from}..{to}");
        transaction.commit().unwrap();
        assert_eq!(world.one::<i64>("SELECT samples FROM segment"), 100);
        let report = super::check::check(world.store.path()).unwrap();
        assert!(report.is_clean(), "{from}..{to}: {report:?}");
    }
}

#[test]
fn a_record_that_the_schema_refuses_does_not_hold_up_the_others() {
    let world = World::new();
    let id = world.capturing();
    world.send(4711, [segment(1, 0), sample(1, 0)]);
    world.send(id, a_capture());
    world.store.flush_blocking().unwrap();
    assert_eq!(world.store.progress().figures.refused, 2);
    assert_eq!(world.reader().capture(id).unwrap().samples, 150);
}

#[test]
fn a_record_is_on_disk_within_a_second() {
    let world = World::new();
    let id = world.capturing();
    let begun = Instant::now();
    world.send(id, [segment(1, 0), sample(1, 0)]);
    world.wait_for("the first commit", |progress| progress.committed.get(&id) == Some(&1));
    assert!(begun.elapsed() < Duration::from_millis(1500), "{:?}", begun.elapsed());
    assert!(world.store.status().last_commit_age_s.unwrap() < 1.5);
}

#[test]
fn a_foreign_lock_is_waited_for_and_nothing_is_lost() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, [segment(1, 0), sample(1, 0)]);
    world.store.flush_blocking().unwrap();
    let foreign = rusqlite::Connection::open(world.store.path()).unwrap();
    foreign.execute_batch("BEGIN IMMEDIATE").unwrap();
    world.send(id, (1..500).map(|seq| sample(1, seq)));
    world.wait_for("the lock to show", |progress| progress.state == crate::observe::StorageState::StorageLocked);
    assert_eq!(world.store.progress().committed[&id], 1);
    assert!(world.store.status().error.unwrap().contains("locked"));
    world.send(id, (500..600).map(|seq| sample(1, seq)));
    foreign.execute_batch("ROLLBACK").unwrap();
    world.store.flush_blocking().unwrap();
    assert_eq!(world.store.status().state, crate::observe::StorageState::Ok);
    assert_eq!(world.reader().capture(id).unwrap().samples, 600);
}

#[test]
fn a_full_disk_is_reported_and_nothing_is_lost_once_there_is_room() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, [segment(1, 0)]);
    world.store.flush_blocking().unwrap();
    let set_pages = |pages: i64| {
        world
            .store
            .execute(move |transaction| {
                Ok(transaction
                    .query_row(&format!("PRAGMA max_page_count = {pages}"), [], |row| row.get::<_, i64>(0))?)
            })
            .unwrap()
    };
    let pages: i64 = world.one("PRAGMA page_count");
    set_pages(pages + 10);
    world.send(id, (0..20_000).map(|seq| sample(1, seq)));
    world.wait_for("the full disk to show", |progress| progress.state == crate::observe::StorageState::StorageFull);
    assert!(world.store.records().queued() > 0);
    set_pages(i64::from(u32::MAX) - 1);
    world.store.flush_blocking().unwrap();
    assert_eq!(world.reader().capture(id).unwrap().samples, 20_000);
    assert_eq!(world.one::<i64>("SELECT count(*) FROM sample"), 20_000);
    assert_eq!(world.store.status().state, crate::observe::StorageState::Ok);
}

#[test]
fn a_batch_that_is_there_although_its_commit_failed_is_not_written_twice() {
    let world = World::new();
    let id = world.capturing();
    let records = vec![(id, segment(1, 0)), (id, sample(1, 0)), (id, event(EventKind::Warning))];
    let (mut writer, progress) = bare_writer(world.store.path(), &world.directory.path().join("another"));
    writer.pretend_failed_commit(records);
    assert_eq!(world.one::<i64>("SELECT count(*) FROM event"), 1);
    writer.retry_now();
    assert_eq!(world.one::<i64>("SELECT count(*) FROM event"), 1);
    assert_eq!(world.reader().capture(id).unwrap().samples, 1);
    assert_eq!(super::progress::locked(&progress).committed[&id], 1);
}

#[test]
fn a_full_queue_gives_the_record_back_at_once() {
    let directory = tempfile::tempdir().unwrap();
    let options = StoreOptions { queue: 4, ..StoreOptions::default() };
    let store = Store::open(&directory.path().join("a.db"), options).unwrap();
    let (hold, held) = std::sync::mpsc::channel::<()>();
    let waiting = store.clone();
    let holder = std::thread::spawn(move || {
        waiting.execute(move |_| {
            held.recv().unwrap();
            Ok(())
        })
    });
    std::thread::sleep(Duration::from_millis(100));
    let sender = store.records();
    let mut sent = 0;
    let refused = loop {
        match sender.try_send(1, sample(1, sent)) {
            Ok(()) => sent += 1,
            Err(refused) => break refused,
        }
    };
    assert_eq!(refused, Refused::Full(sample(1, sent)));
    assert_eq!((sent, sender.queued(), sender.room()), (4, 4, 0));
    std::thread::sleep(Duration::from_millis(20));
    // The writer is stalled: it has seen none of the records, and their age is known nevertheless.
    assert!(store.status().oldest_waiting_s.unwrap() >= 0.02, "{:?}", store.status());
    hold.send(()).unwrap();
    holder.join().unwrap().unwrap();
    store.flush_blocking().unwrap();
    assert_eq!(store.status().oldest_waiting_s, None);
}

#[test]
fn a_second_daemon_is_refused_at_once_with_path_and_process() {
    let world = World::new();
    let begun = Instant::now();
    let error = Store::open(world.store.path(), StoreOptions::default()).unwrap_err();
    assert!(begun.elapsed() < Duration::from_secs(1));
    assert_eq!(error.kind(), StoreErrorKind::CannotCreate);
    let text = error.to_string();
    assert!(text.contains(&std::process::id().to_string()) && text.contains("vn100d.db"), "{text}");
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    Store::open(&path, StoreOptions::default()).unwrap();
}

#[test]
fn a_database_of_a_newer_schema_is_refused_with_both_versions() {
    let world = World::new();
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    rusqlite::Connection::open(&path).unwrap().pragma_update(None, "user_version", 4711).unwrap();
    for error in
        [Store::open(&path, StoreOptions::default()).map(drop).unwrap_err(), Reader::open(&path).map(drop).unwrap_err()]
    {
        assert_eq!(error.kind(), StoreErrorKind::NewerSchema);
        let text = error.to_string();
        assert!(text.contains("4711") && text.contains(&schema_version().to_string()), "{text}");
    }
}

#[test]
fn a_file_of_another_program_is_refused_and_left_untouched() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("other.db");
    let other = rusqlite::Connection::open(&path).unwrap();
    other.execute_batch("CREATE TABLE theirs (a); PRAGMA application_id = 7;").unwrap();
    drop(other);
    let text_file = directory.path().join("notes.db");
    std::fs::write(&text_file, "these are notes, and they are longer than the sixteen bytes of a header").unwrap();
    for file in [path, text_file] {
        let before = std::fs::read(&file).unwrap();
        let error = Store::open(&file, StoreOptions::default()).unwrap_err();
        assert!(matches!(error, StoreError::Foreign { .. }), "{error}");
        assert_eq!(error.kind(), StoreErrorKind::CannotCreate);
        assert_eq!(std::fs::read(&file).unwrap(), before);
    }
}

#[test]
fn a_missing_database_or_folder_is_reported_as_such() {
    let directory = tempfile::tempdir().unwrap();
    let error = Reader::open(&directory.path().join("none.db")).unwrap_err();
    assert!(matches!(error, StoreError::NoDatabase(_)));
    let error = Store::open(std::path::Path::new("/proc/none/vn100d.db"), StoreOptions::default()).unwrap_err();
    assert_eq!(error.kind(), StoreErrorKind::CannotCreate);
}

#[test]
fn a_clean_end_leaves_one_complete_file() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, a_capture());
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    assert!(!paths::wal_path(&path).exists());
    assert!(matches!(world.store.pin(id, true), Err(StoreError::Closed)));
    assert_eq!(Reader::open(&path).unwrap().capture(id).unwrap().samples, 150);
}

#[test]
fn an_unfinished_capture_is_found_with_all_that_its_accounting_needs() {
    let world = World::new();
    let planned = Some(Duration::from_secs(18_000));
    let capture = NewCapture { planned, ..NewCapture::new("pty", CaptureState::Capturing) };
    let id = world.store.create_capture(capture).unwrap();
    let mut records = a_capture();
    records.pop();
    world.send(id, records);
    let path = world.store.path().to_owned();
    world.store.close().unwrap();
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    let unfinished = store.unfinished().unwrap();
    assert_eq!(unfinished.len(), 1);
    let capture = &unfinished[0];
    assert_eq!((capture.id, capture.state, capture.planned), (id, CaptureState::Capturing, planned));
    assert_eq!((capture.samples, capture.missing, capture.gaps), (150, 3, 1));
    assert_eq!((capture.segment, capture.epoch), (2, 1));
    assert_eq!(capture.stream, Some((40.0, Timebase::Device)));
    assert_eq!(capture.epoch_first_device_ns, Some(0));
    assert_eq!(capture.sample_time_ns, 153 * PERIOD_NS);
    let last = 149 * PERIOD_NS;
    assert_eq!(capture.last, Some((Some(last), last + 1, START_NS + last as i64)));
}

#[test]
fn a_gap_without_the_sample_behind_it_is_left_to_be_measured_again() {
    let world = World::new();
    let id = world.store.create_capture(NewCapture::new("pty", CaptureState::Capturing)).unwrap();
    let mut records = a_capture();
    records.pop();
    // The power failed between the commit of a gap and that of the sample that ended it.
    records.push(Record::Gap(Gap {
        before_seq: 150,
        from_utc_ns: START_NS,
        to_utc_ns: START_NS + 1,
        device_ns: None,
        missing: 40,
        missing_exact: true,
        cause: GapCause::Silent,
    }));
    world.send(id, records);
    world.store.flush_blocking().unwrap();
    let capture = world.store.unfinished().unwrap().remove(0);
    assert_eq!((capture.samples, capture.missing, capture.gaps), (150, 3, 1));
    assert_eq!(capture.sample_time_ns, 153 * PERIOD_NS);
    assert_eq!(world.reader().gaps(id, &PageRequest::first()).unwrap().rows.len(), 1);
}

#[test]
fn captures_are_found_by_id_name_and_latest_and_listed_latest_first() {
    let world = World::new();
    let ids: Vec<i64> = (0..5)
        .map(|number| {
            let name = Some(format!("night {number}"));
            world.store.create_capture(NewCapture { name, ..NewCapture::new("x", CaptureState::Stopped) }).unwrap()
        })
        .collect();
    let reader = world.reader();
    assert_eq!(reader.resolve("latest").unwrap(), ids[4]);
    assert_eq!(reader.resolve("night 2").unwrap(), ids[2]);
    assert_eq!(reader.resolve(&ids[1].to_string()).unwrap(), ids[1]);
    for asked in ["night", "99", "", "-1", "1; DROP TABLE capture"] {
        assert!(matches!(reader.resolve(asked), Err(StoreError::NoSuchCapture(_))), "{asked}");
    }
    let mut page = PageRequest { limit: Some(2), cursor: None };
    let mut listed = Vec::new();
    loop {
        let captures = reader.captures(None, &page).unwrap();
        listed.extend(captures.rows.iter().map(|row| row.id));
        match captures.next {
            Some(next) => page.cursor = Some(next),
            None => break,
        }
    }
    assert_eq!(listed, ids.iter().rev().copied().collect::<Vec<_>>());
}

#[test]
fn a_name_is_taken_once_and_cannot_be_mistaken_for_an_id() {
    let world = World::new();
    let named = |name: &str| {
        let capture = NewCapture { name: Some(name.to_owned()), ..NewCapture::new("x", CaptureState::Stopped) };
        world.store.create_capture(capture)
    };
    named("desk").unwrap();
    assert!(matches!(named("desk"), Err(StoreError::NameTaken(_))));
    for refused in ["", " desk", "latest", "42", "a/b", "a\nb", &"x".repeat(101)] {
        assert!(matches!(named(refused), Err(StoreError::NameRefused { .. })), "{refused:?}");
    }
    let unnamed = || world.store.create_capture(NewCapture::new("x", CaptureState::Stopped)).unwrap();
    let (first, second) = (unnamed(), unnamed());
    let reader = world.reader();
    assert_ne!(reader.capture(first).unwrap().name, reader.capture(second).unwrap().name);
}

#[test]
fn a_deleted_capture_is_gone_at_once_and_its_rows_go_in_steps() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, [segment(1, 0)]);
    world.send(id, (0..10_000).map(|seq| sample(1, seq)));
    world.store.flush_blocking().unwrap();
    assert!(matches!(world.store.delete_capture(id), Err(StoreError::NotDeletable { why: "running", .. })));
    world.store.set_state(id, CaptureState::Stopped, START_NS).unwrap();
    world.store.pin(id, true).unwrap();
    assert!(matches!(world.store.delete_capture(id), Err(StoreError::NotDeletable { why: "pinned", .. })));
    world.store.pin(id, false).unwrap();
    world.store.delete_capture(id).unwrap();
    assert!(matches!(world.reader().capture(id), Err(StoreError::NoSuchCapture(_))));
    assert!(matches!(world.reader().resolve("night"), Err(StoreError::NoSuchCapture(_))));
    let again = world.capturing();
    let mut steps = 0;
    while world.store.purge_step().unwrap() {
        steps += 1;
    }
    assert!(steps >= 3, "{steps}");
    for table in ["sample", "segment", "channel", "gap"] {
        assert_eq!(world.one::<i64>(&format!("SELECT count(*) FROM {table}")), 0, "{table}");
    }
    assert_eq!(world.reader().resolve("latest").unwrap(), again);
    assert!(again > id);
}

#[test]
fn the_same_recording_imported_twice_is_one_capture() {
    let world = World::new();
    let import = |fingerprint: &str| {
        let capture = NewCapture::new("night.csv", CaptureState::Imported);
        let mut import = world.store.begin_import(capture, Some(fingerprint)).unwrap();
        import.push(segment(1, 0)).unwrap();
        for seq in 0..9000 {
            import.push(sample(1, seq)).unwrap();
        }
        import.finish(Some(START_NS)).unwrap()
    };
    let first = import("sha256:aa");
    assert_eq!(world.reader().capture(first.id()).unwrap().state, CaptureState::Imported);
    assert_eq!(import("sha256:aa"), ImportEnd::Known(first.id()));
    assert_eq!(world.store.imported("sha256:aa").unwrap(), Some(first.id()));
    assert!(matches!(import("sha256:bb"), ImportEnd::Created(_)));
    while world.store.purge_step().unwrap() {}
    assert_eq!(world.one::<i64>("SELECT count(*) FROM sample"), 18_000);
    assert_eq!(world.one::<i64>("SELECT count(*) FROM capture"), 2);
}

#[test]
fn a_name_that_was_only_liked_gives_way_and_one_that_was_given_does_not() {
    let world = World::new();
    let begin = |name: Option<&str>, liked: Option<&str>| {
        let (name, liked_name) = (name.map(str::to_owned), liked.map(str::to_owned));
        let capture = NewCapture { name, liked_name, ..NewCapture::new("x.csv", CaptureState::Imported) };
        world.store.begin_import(capture, None)
    };
    let called = |end: ImportEnd| world.reader().capture(end.id()).unwrap().name;
    // Both were begun together and find the name free.
    let (first, second) = (begin(None, Some("desk")).unwrap(), begin(None, Some("desk")).unwrap());
    let (named, unnamed, other) =
        (begin(Some("desk"), None).unwrap(), begin(None, None).unwrap(), begin(None, Some("a/b")).unwrap());
    assert_eq!(called(first.finish(None).unwrap()), "desk");
    let mut names = vec![called(second.finish(None).unwrap())];
    assert!(matches!(named.finish(None), Err(StoreError::NameTaken(_))));
    names.push(called(unnamed.finish(None).unwrap()));
    names.push(called(other.finish(None).unwrap()));
    names.push(called(begin(None, Some("desk")).unwrap().finish(None).unwrap()));
    assert_eq!((names.remove(0).as_str(), names.remove(2).as_str()), ("desk-2", "desk-3"));
    assert!(names.iter().all(|name| name.ends_with('Z') || name.contains("Z-")), "{names:?}");
    names.dedup();
    assert_eq!(names.len(), 2, "{names:?}");
}

#[test]
fn an_import_that_fails_leaves_nothing_behind() {
    let world = World::new();
    let mut import = world.store.begin_import(NewCapture::new("x.csv", CaptureState::Imported), Some("f")).unwrap();
    import.push(segment(1, 0)).unwrap();
    for seq in 0..5000 {
        import.push(sample(1, seq)).unwrap();
    }
    assert!(matches!(world.reader().resolve("latest"), Err(StoreError::NoSuchCapture(_))));
    drop(import);
    while world.store.purge_step().unwrap() {}
    assert_eq!(world.one::<i64>("SELECT count(*) FROM sample"), 0);
    assert_eq!(world.one::<i64>("SELECT count(*) FROM capture"), 0);
}

#[test]
fn the_same_submission_is_the_same_job() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, a_capture());
    world.store.flush_blocking().unwrap();
    let submit =
        |params: serde_json::Value| world.store.submit_job(NewJob::new(JobKind::Allan, id, params), u64::MAX).unwrap();
    let (job, new) = submit(serde_json::json!({"b": 1, "a": [1, {"y": 2, "x": 1}]}));
    assert!(new);
    assert_eq!(job.end_seq, 150);
    let (same, new) = submit(serde_json::json!({"a": [1, {"x": 1, "y": 2}], "b": 1}));
    assert_eq!((same.id, new), (job.id, false));
    assert!(submit(serde_json::json!({})).1);
    world.store.cancel_job(job.id).unwrap();
    assert!(matches!(world.store.cancel_job(job.id), Err(StoreError::JobEnded { .. })));
    let (again, new) = submit(serde_json::json!({"b": 1, "a": [1, {"y": 2, "x": 1}]}));
    assert!(new && again.id != job.id);
}

#[test]
fn a_job_whose_process_dies_three_times_fails_and_a_daemon_that_ends_counts_for_nothing() {
    let world = World::new();
    let id = world.capturing();
    let job = NewJob::new(JobKind::Allan, id, serde_json::json!({}));
    let job = world.store.submit_job(job, u64::MAX).unwrap().0.id;
    let mut store = world.store.clone();
    for _ in 0..5 {
        assert_eq!(store.claim_job().unwrap().unwrap().id, job);
        let path = store.path().to_owned();
        store.close().unwrap();
        store = Store::open(&path, StoreOptions::default()).unwrap();
    }
    let die = |last: bool| {
        assert_eq!(store.claim_job().unwrap().unwrap().id, job);
        let state = store.count_attempt(job, "signal 9").unwrap().unwrap().0;
        assert_eq!(state == JobState::Failed, last);
    };
    die(false);
    die(false);
    // The job has progressed: a further death has another cause.
    store.claim_job().unwrap();
    assert!(store.checkpoint_job(job, JobCheckpoint { next_seq: 1, state: vec![7] }, 0.1).unwrap());
    store.release_job(job).unwrap();
    die(false);
    die(false);
    die(true);
    assert_eq!(store.claim_job().unwrap(), None);
    let row = store.reader().unwrap().job(job).unwrap();
    assert_eq!((row.state, row.finished_at.is_some()), (JobState::Failed, true));
    assert_eq!(row.error.as_deref(), Some("tried 3 times: signal 9"));
}

#[test]
fn a_job_goes_on_at_its_checkpoint_and_its_progress_never_goes_back() {
    let world = World::new();
    let id = world.capturing();
    let job = NewJob::new(JobKind::Allan, id, serde_json::json!({}));
    let job = world.store.submit_job(job, u64::MAX).unwrap().0.id;
    world.store.claim_job().unwrap();
    let checkpoint = |next_seq| JobCheckpoint { next_seq, state: vec![7; 3] };
    assert!(world.store.checkpoint_job(job, checkpoint(10), 0.5).unwrap());
    assert!(world.store.checkpoint_job(job, checkpoint(20), 0.4).unwrap());
    world.store.release_job(job).unwrap();
    let reader = world.reader();
    assert_eq!(reader.checkpoint(job).unwrap(), Some(checkpoint(20)));
    assert_eq!(reader.job(job).unwrap().progress, 0.5);
    assert_eq!(world.store.claim_job().unwrap().unwrap().id, job);
    let result = world.store.finish_job(job, r#"{"format": "x"}"#.to_owned()).unwrap().unwrap();
    assert_eq!(reader.result(result).unwrap().unwrap().body, r#"{"format": "x"}"#);
    assert_eq!(reader.checkpoint(job).unwrap(), None);
    let row = reader.job(job).unwrap();
    assert_eq!((row.state, row.progress, row.result_id), (JobState::Done, 1.0, Some(result)));
    assert!(!world.store.checkpoint_job(job, checkpoint(30), 0.6).unwrap());
}

#[test]
fn commands_and_records_do_not_wait_for_a_reader() {
    let world = World::new();
    let id = world.capturing();
    world.send(id, a_capture());
    world.store.flush_blocking().unwrap();
    let reader = world.reader();
    let mut statement = reader.connection.prepare("SELECT seq FROM sample").unwrap();
    let mut rows = statement.query([]).unwrap();
    rows.next().unwrap();
    let begun = Instant::now();
    world.store.pin(id, true).unwrap();
    world.send(id, [event(EventKind::Warning)]);
    world.store.flush_blocking().unwrap();
    assert!(begun.elapsed() < Duration::from_secs(1), "{:?}", begun.elapsed());
    drop(rows);
    assert!(world.directory.path().exists());
}
