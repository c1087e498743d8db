//! Corrections of civil times: the host's clock had not been set when a capture began.
//!
//! [`imu_core::sample::Record::UtcSet`] leaves one row in table `utc_correction`, in the transaction of its batch. The
//! writer then moves the capture's times in steps of a few thousand rows ([`step`]). Each step is a separate
//! transaction that also stores its progress and renews the checksums: a kill costs one step, and new data is committed
//! in between. Tables are processed from the newest row to the oldest, so that civil time never runs back on the way.
//!
//! An earlier boot of the host began at another wrong time, so its rows keep their times if they were never corrected.
//! A correction reaches back to the first segment of the present boot ([`since`]), or to the point where the clock was
//! set back since.
//!
//! Samples that the accounting still held when the clock was set arrive after the record, with the old time. So a
//! correction begins once the first sample with a later time is there ([`close`]), or the capture has ended.

use super::StoreError;
use super::batch::{self, batch_row};
use super::sql::{find, list, run, value};
use rusqlite::{Connection, params};

/// Rows of one step: some tens of milliseconds.
pub(super) const STEP_ROWS: i64 = 4096;

/// A place that holds times: the table, what identifies the capture, the key that orders its rows, the columns, and
/// which rows are of the present boot, from sample (event, for events) `?6` on.
struct Place {
    table: &'static str,
    capture: &'static str,
    key: &'static str,
    columns: &'static [(&'static str, &'static str)],
}

/// The places in processing order; samples come last.
const PLACES: [Place; 6] = [
    Place {
        table: "capture",
        capture: "id",
        key: "id",
        columns: &[("created_utc_ns", "?6 = 0"), ("started_utc_ns", "?6 = 0")],
    },
    Place {
        table: "configuration",
        capture: "capture_id",
        key: "configuration_id",
        columns: &[("utc_ns", "before_seq >= ?6")],
    },
    Place {
        table: "segment",
        capture: "capture_id",
        key: "segment_id",
        columns: &[("first_utc_ns", "first_seq >= ?6"), ("last_utc_ns", "first_seq + samples > ?6")],
    },
    // The key is the place, not the number, because the index is on the place.
    Place {
        table: "gap",
        capture: "capture_id",
        key: "before_seq",
        columns: &[("from_utc_ns", "before_seq >= ?6"), ("to_utc_ns", "before_seq >= ?6")],
    },
    Place { table: "event", capture: "capture_id", key: "event_id", columns: &[("utc_ns", "event_id >= ?6")] },
    Place { table: "sample", capture: "capture_id", key: "seq", columns: &[("host_utc_ns", "seq >= ?6")] },
];

/// A row of the table.
struct Correction {
    id: i64,
    capture_id: i64,
    by_ns: i64,
    before_utc_ns: i64,
    since: Since,
    end_seq: i64,
    place: usize,
    next_key: i64,
    live: bool,
}

/// The first sample and the first event that a correction concerns; 0 for the whole capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Since {
    seq: i64,
    event: i64,
}

/// Determines how far back a new correction reaches: to the first segment of the boot `boot_id`, or to the point where
/// the clock was set back since (`since_seq`). It is the whole capture if the boot is not known.
pub(super) fn since(
    connection: &Connection,
    capture_id: i64,
    boot_id: Option<&str>,
    since_seq: Option<u64>,
    next_seq: u64,
) -> Result<Since, StoreError> {
    let event = |sql: &str, utc_ns: i64| -> Result<i64, StoreError> {
        Ok(find(connection, sql, [capture_id, utc_ns], |row| row.get(0))?.unwrap_or(i64::MAX))
    };
    if let Some(seq) = since_seq.filter(|seq| *seq > 0) {
        // An event records the step back, the last of its kind.
        let sql = "SELECT event_id FROM event WHERE capture_id = ?1 AND kind = 'clock_step' AND utc_ns < ?2 \
                   ORDER BY event_id DESC LIMIT 1";
        return Ok(Since { seq: seq as i64, event: event(sql, i64::MAX)? });
    }
    let Some(boot_id) = boot_id else { return Ok(Since { seq: 0, event: 0 }) };
    let sql = "SELECT first_seq, first_utc_ns FROM segment WHERE capture_id = ?1 AND boot_id = ?2 ORDER BY segment_id LIMIT 1";
    let first = find(connection, sql, params![capture_id, boot_id], |row| Ok((row.get(0)?, row.get(1)?)))?;
    match first {
        Some((seq, utc_ns)) if seq > 0 => {
            // A run of the program records its first sample in an event with that sample's time.
            let sql = "SELECT event_id FROM event WHERE capture_id = ?1 AND kind = 'capture_started' \
                       ORDER BY abs(utc_ns - ?2), event_id DESC LIMIT 1";
            Ok(Since { seq, event: event(sql, utc_ns)? })
        }
        None if next_seq > 0 => Ok(Since { seq: next_seq as i64, event: i64::MAX }),
        _ => Ok(Since { seq: 0, event: 0 }),
    }
}

/// Returns the civil time of a sample after the noted corrections are done.
pub(super) fn corrected(connection: &Connection, capture_id: i64, seq: u64, utc_ns: i64) -> Result<i64, StoreError> {
    let sql = "SELECT by_ns, before_utc_ns FROM utc_correction JOIN capture ON capture.id = capture_id \
               WHERE capture_id = ?1 AND ?2 >= first_seq AND ?2 < coalesce(end_seq, samples) \
               AND (place < ?3 OR place = ?3 AND ?2 < next_key) ORDER BY correction_id";
    let mut statement = connection.prepare_cached(sql)?;
    let mut rows = statement.query(params![capture_id, seq as i64, PLACES.len() as i64 - 1])?;
    let mut corrected = utc_ns;
    while let Some(row) = rows.next()? {
        if corrected < row.get(1)? {
            corrected += row.get::<_, i64>(0)?;
        }
    }
    Ok(corrected)
}

/// Notes that times of the capture before `before_utc_ns` must be moved; `next_seq` is that of its next sample.
pub(super) fn note(
    connection: &Connection,
    capture_id: i64,
    by_ns: i64,
    before_utc_ns: i64,
    since: Since,
    next_seq: u64,
) -> Result<(), StoreError> {
    close(connection, capture_id, next_seq)?;
    // This ensures that no earlier time overflows.
    if before_utc_ns.checked_add(by_ns).is_none() {
        return Ok(());
    }
    let sql = "INSERT INTO utc_correction (capture_id, by_ns, before_utc_ns, first_seq, first_event) VALUES (?1, ?2, ?3, ?4, ?5)";
    connection.execute(sql, params![capture_id, by_ns, before_utc_ns, since.seq, since.event])?;
    Ok(())
}

/// Returns the time below which samples still belong to the correction that was noted last; `None` if there is none.
pub(super) fn open_before(connection: &Connection, capture_id: i64) -> Result<Option<i64>, StoreError> {
    let sql = "SELECT max(before_utc_ns) FROM utc_correction WHERE capture_id = ?1 AND end_seq IS NULL";
    Ok(value(connection, sql, [capture_id])?)
}

/// Records that the sample `seq` is the first that was taken after the clock was set.
pub(super) fn close(connection: &Connection, capture_id: i64, seq: u64) -> Result<(), StoreError> {
    let sql = "UPDATE utc_correction SET end_seq = ?2 WHERE capture_id = ?1 AND end_seq IS NULL";
    run(connection, sql, params![capture_id, seq as i64])?;
    Ok(())
}

/// Closes all corrections when the program starts: the samples that the accounting of an earlier run held are gone.
pub(super) fn close_all(connection: &Connection) -> Result<(), StoreError> {
    let sql = "UPDATE utc_correction SET end_seq = (SELECT samples FROM capture WHERE id = capture_id) \
               WHERE end_seq IS NULL";
    connection.execute(sql, [])?;
    Ok(())
}

/// Does one step of the oldest correction that can continue; returns `false` if there is none. Must be called in a
/// separate transaction.
pub(super) fn step(connection: &Connection) -> Result<bool, StoreError> {
    let Some(correction) = next(connection)? else { return Ok(false) };
    let place = PLACES.get(correction.place).filter(|_| correction.live);
    let Some(place) = place else {
        connection.execute("DELETE FROM utc_correction WHERE correction_id = ?1", [correction.id])?;
        return Ok(true);
    };
    let reached = if place.table == "sample" {
        samples(connection, &correction, place)?
    } else {
        rows(connection, &correction, place)?
    };
    let (place, next_key) = match reached {
        Some(key) => (correction.place, key),
        None => (correction.place + 1, i64::MAX),
    };
    let sql = "UPDATE utc_correction SET place = ?2, next_key = ?3 WHERE correction_id = ?1";
    run(connection, sql, params![correction.id, place as i64, next_key])?;
    Ok(true)
}

fn next(connection: &Connection) -> Result<Option<Correction>, StoreError> {
    let sql = "SELECT correction_id, capture_id, by_ns, before_utc_ns, coalesce(end_seq, samples), place, next_key, \
               lifecycle = 'live', first_seq, first_event FROM utc_correction JOIN capture ON capture.id = capture_id \
               WHERE end_seq IS NOT NULL OR state <> 'capturing' OR lifecycle <> 'live' ORDER BY correction_id LIMIT 1";
    let read = |row: &rusqlite::Row<'_>| {
        Ok(Correction {
            id: row.get(0)?,
            capture_id: row.get(1)?,
            by_ns: row.get(2)?,
            before_utc_ns: row.get(3)?,
            end_seq: row.get(4)?,
            place: row.get::<_, i64>(5)? as usize,
            next_key: row.get(6)?,
            live: row.get(7)?,
            since: Since { seq: row.get(8)?, event: row.get(9)? },
        })
    };
    Ok(find(connection, sql, [], read)?)
}

/// Moves the times of some rows. Returns the lowest key among them, or `None` if there are none below `next_key`.
fn rows(connection: &Connection, correction: &Correction, place: &Place) -> Result<Option<i64>, StoreError> {
    let Place { table, capture, key, .. } = place;
    let sql = format!(
        "SELECT min(key) FROM (SELECT {key} AS key FROM {table} WHERE {capture} = ?1 AND {key} < ?2 \
         ORDER BY {key} DESC LIMIT ?3)"
    );
    let (id, end) = (correction.capture_id, correction.next_key);
    let lowest: Option<i64> = value(connection, &sql, params![id, end, STEP_ROWS])?;
    if let Some(lowest) = lowest {
        move_times(connection, correction, place, lowest, end)?;
    }
    Ok(lowest)
}

/// Moves the times of samples, whole batches at a time, whose checksums are renewed.
fn samples(connection: &Connection, correction: &Correction, place: &Place) -> Result<Option<i64>, StoreError> {
    let end = correction.next_key.min(correction.end_seq);
    let first = correction.since.seq;
    if end <= first {
        return Ok(None);
    }
    let from = (end - STEP_ROWS).max(first);
    let sql = "SELECT capture_id, first_seq, count, crc FROM batch \
               WHERE capture_id = ?1 AND first_seq < ?2 AND first_seq + count > ?3 AND first_seq >= \
               coalesce((SELECT max(first_seq) FROM batch WHERE capture_id = ?1 AND first_seq <= ?3), 0)";
    let batches = list(connection, sql, params![correction.capture_id, end, from], batch_row)?;
    let from = batches.iter().map(|batch| batch.first_seq).fold(from, i64::min);
    let mut intact = Vec::with_capacity(batches.len());
    for batch in batches {
        if batch::is_intact(connection, &batch)? {
            intact.push(batch);
        }
    }
    if move_times(connection, correction, place, from, end)? > 0 {
        batch::renew(connection, &intact)?;
    }
    Ok((from > first).then_some(from))
}

/// Moves the times before the limit; returns how many rows changed.
fn move_times(
    connection: &Connection,
    correction: &Correction,
    place: &Place,
    from: i64,
    end: i64,
) -> Result<usize, StoreError> {
    let Place { table, capture, key, columns } = place;
    let moved: Vec<String> = columns
        .iter()
        .map(|(column, since)| {
            format!("{column} = CASE WHEN {column} < ?5 AND {since} THEN {column} + ?4 ELSE {column} END")
        })
        .collect();
    let early: Vec<String> = columns.iter().map(|(column, since)| format!("{column} < ?5 AND {since}")).collect();
    // A row that would become equal to another keeps its time: it must not block the rest.
    let sql = format!(
        "UPDATE OR IGNORE {table} SET {} WHERE {capture} = ?1 AND {key} >= ?2 AND {key} < ?3 AND (({}))",
        moved.join(", "),
        early.join(") OR (")
    );
    let since = if *table == "event" { correction.since.event } else { correction.since.seq };
    let values = params![correction.capture_id, from, end, correction.by_ns, correction.before_utc_ns, since];
    Ok(run(connection, &sql, values)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::{World, bare_writer, gap, sample, segment};
    use crate::store::{Store, StoreOptions, check, paths, schema};
    use imu_core::sample::{EventKind, EventRecord, Gap, Record, Segment};
    use std::path::Path;
    use std::time::{Duration, Instant};

    /// The clock is set forward by this much; times before 2020 were recorded before that.
    const BY_NS: i64 = START_NS - 100_000_000_000;
    const START_NS: i64 = 1_800_000_000_000_000_000;
    const UNSET_NS: i64 = 1_577_836_800_000_000_000;
    const PERIOD_NS: i64 = 25_000_000;
    const COUNT: u64 = 40_000;

    /// Returns the record with the time of a clock that was not set.
    fn early(record: Record) -> Record {
        match record {
            Record::Sample { seq, segment, mut sample } => {
                sample.host_utc_ns -= BY_NS;
                Record::Sample { seq, segment, sample }
            }
            Record::Segment(one) => Record::Segment(Segment { first_utc_ns: one.first_utc_ns - BY_NS, ..one }),
            Record::Gap(one) => {
                let (from_utc_ns, to_utc_ns) = (one.from_utc_ns - BY_NS, one.to_utc_ns - BY_NS);
                Record::Gap(Gap { from_utc_ns, to_utc_ns, ..one })
            }
            other => other,
        }
    }

    fn event(utc_ns: i64) -> Record {
        Record::Event(EventRecord { utc_ns, kind: EventKind::Warning, message: "said".to_owned(), detail: None })
    }

    fn utc_set(by_ns: i64, before_utc_ns: i64, boot_id: Option<&str>, since_seq: Option<u64>) -> Record {
        Record::UtcSet { by_ns, before_utc_ns, boot_id: boot_id.map(str::to_owned), since_seq }
    }

    /// Returns the records of a capture that began in 1970: segments and gaps, then the clock is set while two samples
    /// are still held.
    fn records() -> Vec<Record> {
        let mut records = vec![early(segment(1, 0)), event(5)];
        for seq in 0..COUNT {
            let number = 1 + (seq / 10_000) as u32;
            if seq > 0 && seq % 10_000 == 0 {
                records.extend([early(gap(seq, 1)), early(segment(number, seq))]);
            }
            records.push(early(sample(number, seq)));
        }
        records.push(utc_set(BY_NS, UNSET_NS, None, None));
        records.push(event(START_NS + 1));
        records.extend([early(sample(4, COUNT)), early(sample(4, COUNT + 1)), sample(4, COUNT + 2)]);
        records
    }

    fn one(path: &Path, sql: &str) -> i64 {
        let connection = Connection::open_with_flags(path, rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY).unwrap();
        connection.query_row(sql, [], |row| row.get(0)).unwrap()
    }

    const LEFT: &str = "SELECT count(*) FROM utc_correction";

    fn all_right(path: &Path, samples: u64) {
        let wrong = format!("SELECT count(*) FROM sample WHERE host_utc_ns <> {START_NS} + seq * {PERIOD_NS}");
        assert_eq!(one(path, &wrong), 0);
        assert_eq!(one(path, "SELECT count(*) FROM sample"), samples as i64);
        for column in [
            "started_utc_ns FROM capture",
            "first_utc_ns FROM segment",
            "last_utc_ns FROM segment",
            "from_utc_ns FROM gap",
            "utc_ns FROM event",
        ] {
            let earliest = one(
                path,
                &format!(
                    "SELECT min({}) FROM {}",
                    column.split(' ').next().unwrap(),
                    column.rsplit(' ').next().unwrap()
                ),
            );
            assert!((BY_NS..BY_NS + 10_000_000_000_000).contains(&earliest), "{column}: {earliest}");
        }
        let findings = check(path).unwrap().findings;
        assert!(!findings.iter().any(|finding| finding.check == "checksum"), "{findings:?}");
        assert_eq!(check(path).unwrap().captures[0].without_checksum, 0);
    }

    #[test]
    fn times_are_corrected_in_small_steps_and_a_kill_between_any_two_of_them_costs_nothing() {
        let world = World::new();
        let id = world.capturing();
        world.store.close().unwrap();
        let path = world.store.path().to_owned();
        let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
        for part in records().chunks(5000) {
            writer.write_now(part.iter().map(|record| (id, record.clone())));
        }
        // The state after a kill right after the clock was set: the correction is noted, and nothing is done.
        assert_eq!(
            (one(&path, LEFT), one(&path, &format!("SELECT count(*) FROM sample WHERE host_utc_ns < {UNSET_NS}"))),
            (1, COUNT as i64 + 2)
        );
        let mut connection = schema::reopen(&path).unwrap();
        let (mut steps, mut images) = (0, 0);
        loop {
            let before = connection.total_changes();
            // A query for the last sample during the correction returns its final time.
            for seq in [0, COUNT / 2, COUNT + 1, COUNT + 2] {
                let sql = format!("SELECT host_utc_ns FROM sample WHERE seq = {seq}");
                let will_be = corrected(&connection, id, seq, one(&path, &sql)).unwrap();
                assert_eq!(will_be, START_NS + seq as i64 * PERIOD_NS, "sample {seq} in step {steps}");
            }
            let step = connection.transaction().unwrap();
            let more = super::step(&step).unwrap();
            step.commit().unwrap();
            let changed = connection.total_changes() - before;
            assert!(changed <= STEP_ROWS as u64 + 5000 + 100, "step {steps} changed {changed} rows");
            if !more {
                break;
            }
            steps += 1;
            let back = "SELECT count(*) FROM (SELECT host_utc_ns - lag(host_utc_ns) OVER (ORDER BY seq) AS step FROM sample) WHERE step < 0";
            assert_eq!(one(&path, back), 0, "civil time never runs back");
            if steps % 4 == 1 {
                images += 1;
                killed_here(&path, &world.directory.path().join(format!("image-{images}.db")), id);
            }
        }
        assert!(steps > 14 && images >= 4, "{steps} steps, {images} images");
        assert_eq!(one(&path, LEFT), 0);
        all_right(&path, COUNT + 3);
    }

    /// Opens the files as a kill leaves them: the correction continues, beside a capture that continues.
    fn killed_here(path: &Path, image: &Path, id: i64) {
        std::fs::copy(path, image).unwrap();
        std::fs::copy(paths::wal_path(path), paths::wal_path(image)).unwrap();
        let left = one(image, LEFT);
        let store = Store::open(image, StoreOptions::default()).unwrap();
        for seq in COUNT + 3..COUNT + 103 {
            store.records().blocking_send(id, sample(4, seq)).unwrap();
        }
        store.flush_blocking().unwrap();
        let begun = Instant::now();
        while one(image, LEFT) > 0 {
            assert!(begun.elapsed() < Duration::from_secs(60), "{left} were left");
            std::thread::sleep(Duration::from_millis(10));
        }
        store.close().unwrap();
        all_right(image, COUNT + 103);
    }

    #[test]
    fn a_correction_waits_for_what_was_held_and_the_capture_goes_on_beside_it() {
        let world = World::new();
        let id = world.capturing();
        let (held, set): (Vec<Record>, Vec<Record>) = {
            let mut records = records();
            let set = records.split_off(records.len() - 1);
            (records, set)
        };
        world.send(id, held);
        world.store.flush_blocking().unwrap();
        std::thread::sleep(Duration::from_millis(1200));
        let path = world.store.path().to_owned();
        assert_eq!(
            one(&path, "SELECT max(host_utc_ns) FROM sample"),
            START_NS - BY_NS + (COUNT as i64 + 1) * PERIOD_NS,
            "nothing yet"
        );
        world.send(id, set);
        let mut seq = COUNT + 3;
        let begun = Instant::now();
        while seq < COUNT + 103 || one(&path, LEFT) > 0 {
            assert!(begun.elapsed() < Duration::from_secs(60));
            world.send(id, [sample(4, seq)]);
            seq += 1;
            std::thread::sleep(Duration::from_millis(5));
        }
        world.store.flush_blocking().unwrap();
        all_right(&path, seq);
        // A second time: times that are already right stay.
        world.send(id, [utc_set(BY_NS, UNSET_NS, None, None), sample(4, seq)]);
        world.store.close().unwrap();
        all_right(&path, seq + 1);
    }

    fn of_boot(record: Record, boot: &str) -> Record {
        match record {
            Record::Segment(one) => Record::Segment(Segment { boot_id: Some(boot.to_owned()), ..one }),
            other => other,
        }
    }

    fn started(utc_ns: i64) -> Record {
        let message = "capture `night` goes on".to_owned();
        Record::Event(EventRecord { utc_ns, kind: EventKind::CaptureStarted, message, detail: None })
    }

    /// Returns the record with the time of a clock that is off by this much.
    fn off(record: Record, by_ns: i64) -> Record {
        match record {
            Record::Sample { seq, segment, mut sample } => {
                sample.host_utc_ns -= by_ns;
                Record::Sample { seq, segment, sample }
            }
            Record::Segment(one) => Record::Segment(Segment { first_utc_ns: one.first_utc_ns - by_ns, ..one }),
            other => other,
        }
    }

    /// Writes the records and does all corrections; returns the rows of numbers that a query selects.
    fn corrected_rows(records: Vec<Record>, sql: &str) -> Vec<i64> {
        let world = World::new();
        let id = world.capturing();
        world.store.close().unwrap();
        let path = world.store.path().to_owned();
        let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
        writer.write_now(records.into_iter().map(|record| (id, record)));
        let mut connection = schema::reopen(&path).unwrap();
        loop {
            let step = connection.transaction().unwrap();
            let more = super::step(&step).unwrap();
            step.commit().unwrap();
            if !more {
                break;
            }
        }
        assert_eq!(one(&path, LEFT), 0);
        assert!(!check(&path).unwrap().findings.iter().any(|finding| finding.check == "checksum"));
        let mut statement = connection.prepare(sql).unwrap();
        let rows = statement.query_map([], |row| row.get(0)).unwrap();
        rows.collect::<Result<_, _>>().unwrap()
    }

    const SAMPLES: &str = "SELECT host_utc_ns FROM sample ORDER BY seq";

    /// Returns 100 samples of a first boot and 50 of a second one, whose clocks both began at about the same wrong
    /// time.
    fn two_boots() -> (Vec<Record>, i64) {
        let (first_off, second_off) = (BY_NS, BY_NS + 120 * PERIOD_NS);
        let mut records = vec![started(START_NS - first_off), of_boot(off(segment(1, 0), first_off), "one")];
        records.extend((0..100).map(|seq| off(sample(1, seq), first_off)));
        records.push(event(7));
        records.push(started(START_NS + 100 * PERIOD_NS - second_off));
        let Record::Gap(between) = gap(100, 3) else { panic!() };
        // The clock of the later of its two samples determines its times.
        let (from_utc_ns, to_utc_ns) = (between.from_utc_ns - second_off, START_NS + 100 * PERIOD_NS - second_off);
        records.push(Record::Gap(Gap { from_utc_ns, to_utc_ns, ..between }));
        records.push(of_boot(off(segment(2, 100), second_off), "two"));
        records.extend((100..150).map(|seq| off(sample(2, seq), second_off)));
        records.push(event(9));
        (records, second_off)
    }

    #[test]
    fn a_clock_that_is_set_leaves_the_rows_of_an_earlier_boot_as_they_are() {
        let all = "SELECT host_utc_ns FROM (SELECT 1 AS place, seq AS key, host_utc_ns FROM sample \
                   UNION ALL SELECT 2, segment_id, first_utc_ns FROM segment \
                   UNION ALL SELECT 3, segment_id, last_utc_ns FROM segment \
                   UNION ALL SELECT 4, 1, from_utc_ns FROM gap UNION ALL SELECT 4, 2, to_utc_ns FROM gap \
                   UNION ALL SELECT 5, 1, started_utc_ns FROM capture \
                   UNION ALL SELECT 6, event_id, utc_ns FROM event) ORDER BY place, key";
        let at = |seq: i64| START_NS + seq * PERIOD_NS;
        let (mut records, second_off) = two_boots();
        records.extend([utc_set(second_off, UNSET_NS, Some("two"), None), sample(2, 150)]);
        let mut expected: Vec<i64> = (0..100).map(|seq| at(seq) - BY_NS).chain((100..151).map(at)).collect();
        expected.extend([at(0) - BY_NS, at(100), at(99) - BY_NS, at(150)]);
        expected.extend([at(99), at(100), at(0) - BY_NS]);
        expected.extend([at(0) - BY_NS, 7, at(100), 9 + second_off]);
        assert_eq!(corrected_rows(records, all), expected);
        // A boot that has no samples yet has nothing to correct.
        let (mut records, second_off) = two_boots();
        records.extend([utc_set(second_off, UNSET_NS, Some("three"), None), sample(2, 150)]);
        let mut expected: Vec<i64> = (0..100).map(|seq| at(seq) - BY_NS).collect();
        expected.extend((100..150).map(|seq| at(seq) - second_off).chain([at(150)]));
        assert_eq!(corrected_rows(records, SAMPLES), expected);
    }

    #[test]
    fn a_clock_that_is_set_twice_within_one_boot_is_corrected_twice() {
        // 1970, then 2010 by hand, then now.
        let second_off = START_NS - 1_262_304_000_000_000_000;
        let step = BY_NS - second_off;
        let steps = |first: Option<Record>, since_seq| {
            let mut records = vec![of_boot(off(segment(1, 0), BY_NS), "one")];
            records.extend((0..50).map(|seq| off(sample(1, seq), BY_NS)));
            records.extend(first);
            // Two samples that were still held.
            records.extend((50..52).map(|seq| off(sample(1, seq), BY_NS)));
            records.extend((52..100).map(|seq| off(sample(1, seq), second_off)));
            records.extend([utc_set(second_off, UNSET_NS, Some("one"), since_seq), sample(1, 100)]);
            records
        };
        let middle = START_NS + 52 * PERIOD_NS - second_off - step / 2;
        let right: Vec<i64> = (0..101).map(|seq| START_NS + seq * PERIOD_NS).collect();
        assert_eq!(corrected_rows(steps(Some(utc_set(step, middle, Some("one"), None)), None), SAMPLES), right);
        // As after a step back that no row records: the times before it stay.
        let mut expected = right.clone();
        expected.iter_mut().take(52).for_each(|utc_ns| *utc_ns -= BY_NS);
        assert_eq!(corrected_rows(steps(None, Some(52)), SAMPLES), expected);
    }
}
