//! Civil times that are set right later: the host's clock had not been set when a capture began.
//!
//! [`crate::sample::Record::UtcSet`] leaves one row in table `utc_correction`, in the transaction of its batch. The writer
//! then moves the capture's times in steps of a few thousand rows ([`step`]), each in a transaction of its own that also
//! keeps how far it has come and renews the checksums: a kill costs one step, and what arrives meanwhile is committed in
//! between. Tables are gone through from the newest row to the oldest, so that civil time never runs back on the way.
//!
//! Samples that the accounting still held when the clock was set come after the record, with the old time. So a correction
//! begins once the first sample with a time of its own is there ([`close`]), or the capture has ended.

use super::StoreError;
use super::batch::{self, BatchRow, batch_row};
use rusqlite::{Connection, OptionalExtension, params};

/// Rows of one step: some tens of milliseconds.
pub(super) const STEP_ROWS: i64 = 4096;

/// Where times stand: table, what identifies the capture, what orders its rows, the columns.
struct Place {
    table: &'static str,
    capture: &'static str,
    key: &'static str,
    columns: &'static [&'static str],
}

/// In the order in which they are gone through; samples last.
const PLACES: [Place; 6] = [
    Place { table: "capture", capture: "id", key: "id", columns: &["created_utc_ns", "started_utc_ns"] },
    Place { table: "configuration", capture: "capture_id", key: "configuration_id", columns: &["utc_ns"] },
    Place { table: "segment", capture: "capture_id", key: "segment_id", columns: &["first_utc_ns", "last_utc_ns"] },
    // By place, not by number: that is what its index has.
    Place { table: "gap", capture: "capture_id", key: "before_seq", columns: &["from_utc_ns", "to_utc_ns"] },
    Place { table: "event", capture: "capture_id", key: "event_id", columns: &["utc_ns"] },
    Place { table: "sample", capture: "capture_id", key: "seq", columns: &["host_utc_ns"] },
];

/// A row of the table.
struct Correction {
    id: i64,
    capture_id: i64,
    by_ns: i64,
    before_utc_ns: i64,
    end_seq: i64,
    place: usize,
    next_key: i64,
    live: bool,
}

/// Notes that times of the capture before `before_utc_ns` are to be moved; `next_seq` is that of its next sample.
pub(super) fn note(
    connection: &Connection,
    capture_id: i64,
    by_ns: i64,
    before_utc_ns: i64,
    next_seq: u64,
) -> Result<(), StoreError> {
    close(connection, capture_id, next_seq)?;
    // No time that lies before can then run over.
    if before_utc_ns.checked_add(by_ns).is_none() {
        return Ok(());
    }
    connection.execute(
        "INSERT INTO utc_correction (capture_id, by_ns, before_utc_ns) VALUES (?1, ?2, ?3)",
        params![capture_id, by_ns, before_utc_ns],
    )?;
    Ok(())
}

/// Samples with times below this still belong to the correction that was noted last; None where there is none.
pub(super) fn open_before(connection: &Connection, capture_id: i64) -> Result<Option<i64>, StoreError> {
    let sql = "SELECT max(before_utc_ns) FROM utc_correction WHERE capture_id = ?1 AND end_seq IS NULL";
    Ok(connection.prepare_cached(sql)?.query_row([capture_id], |row| row.get(0))?)
}

/// The sample `seq` is the first that was taken after the clock was set.
pub(super) fn close(connection: &Connection, capture_id: i64, seq: u64) -> Result<(), StoreError> {
    let sql = "UPDATE utc_correction SET end_seq = ?2 WHERE capture_id = ?1 AND end_seq IS NULL";
    connection.prepare_cached(sql)?.execute(params![capture_id, seq as i64])?;
    Ok(())
}

/// When the program begins: what the accounting of an earlier run held is gone.
pub(super) fn close_all(connection: &Connection) -> Result<(), StoreError> {
    let sql = "UPDATE utc_correction SET end_seq = (SELECT samples FROM capture WHERE id = capture_id) \
               WHERE end_seq IS NULL";
    connection.execute(sql, [])?;
    Ok(())
}

/// Does one step of the oldest correction that can be gone on with; false where there is none. To be called in a
/// transaction of its own.
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
    connection
        .prepare_cached("UPDATE utc_correction SET place = ?2, next_key = ?3 WHERE correction_id = ?1")?
        .execute(params![correction.id, place as i64, next_key])?;
    Ok(true)
}

fn next(connection: &Connection) -> Result<Option<Correction>, StoreError> {
    let sql = "SELECT correction_id, capture_id, by_ns, before_utc_ns, coalesce(end_seq, samples), place, next_key, \
               lifecycle = 'live' FROM utc_correction JOIN capture ON capture.id = capture_id \
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
        })
    };
    Ok(connection.prepare_cached(sql)?.query_row([], read).optional()?)
}

/// Moves the times of some rows; answers the lowest key among them, None where there are none below `next_key`.
fn rows(connection: &Connection, correction: &Correction, place: &Place) -> Result<Option<i64>, StoreError> {
    let Place { table, capture, key, .. } = place;
    let sql = format!(
        "SELECT min(key) FROM (SELECT {key} AS key FROM {table} WHERE {capture} = ?1 AND {key} < ?2 \
         ORDER BY {key} DESC LIMIT ?3)"
    );
    let (id, end) = (correction.capture_id, correction.next_key);
    let lowest: Option<i64> =
        connection.prepare_cached(&sql)?.query_row(params![id, end, STEP_ROWS], |row| row.get(0))?;
    if let Some(lowest) = lowest {
        move_times(connection, correction, place, lowest, end)?;
    }
    Ok(lowest)
}

/// The same for samples, whole batches at a time, whose checksums are renewed.
fn samples(connection: &Connection, correction: &Correction, place: &Place) -> Result<Option<i64>, StoreError> {
    let end = correction.next_key.min(correction.end_seq);
    if end <= 0 {
        return Ok(None);
    }
    let from = (end - STEP_ROWS).max(0);
    let sql = "SELECT capture_id, first_seq, count, crc FROM batch \
               WHERE capture_id = ?1 AND first_seq < ?2 AND first_seq + count > ?3 AND first_seq >= \
               coalesce((SELECT max(first_seq) FROM batch WHERE capture_id = ?1 AND first_seq <= ?3), 0)";
    let batches: Vec<BatchRow> = connection
        .prepare_cached(sql)?
        .query_map(params![correction.capture_id, end, from], batch_row)?
        .collect::<Result<_, _>>()?;
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
    Ok((from > 0).then_some(from))
}

/// Moves what lies before the time that cannot be; answers how many rows changed.
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
        .map(|column| format!("{column} = CASE WHEN {column} < ?5 THEN {column} + ?4 ELSE {column} END"))
        .collect();
    let early: Vec<String> = columns.iter().map(|column| format!("{column} < ?5")).collect();
    // A row that would become equal to another stays as it is: it must not hold up the rest.
    let sql = format!(
        "UPDATE OR IGNORE {table} SET {} WHERE {capture} = ?1 AND {key} >= ?2 AND {key} < ?3 AND ({})",
        moved.join(", "),
        early.join(" OR ")
    );
    let values = params![correction.capture_id, from, end, correction.by_ns, correction.before_utc_ns];
    Ok(connection.prepare_cached(&sql)?.execute(values)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{EventKind, EventRecord, Gap, Record, Segment};
    use crate::store::tests::{World, bare_writer, gap, sample, segment};
    use crate::store::{Store, StoreOptions, check, schema};
    use std::path::Path;
    use std::time::{Duration, Instant};

    /// The clock is set so much forward; what lies before 2020 was taken before that.
    const BY_NS: i64 = START_NS - 100_000_000_000;
    const START_NS: i64 = 1_800_000_000_000_000_000;
    const UNSET_NS: i64 = 1_577_836_800_000_000_000;
    const PERIOD_NS: i64 = 25_000_000;
    const COUNT: u64 = 40_000;

    /// The record with the time of a clock that was not set.
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

    /// What a capture sends that began in 1970: segments and gaps, the clock is set, two samples were still held.
    fn records() -> Vec<Record> {
        let mut records = vec![early(segment(1, 0)), event(5)];
        for seq in 0..COUNT {
            let number = 1 + (seq / 10_000) as u32;
            if seq > 0 && seq % 10_000 == 0 {
                records.extend([early(gap(seq, 1)), early(segment(number, seq))]);
            }
            records.push(early(sample(number, seq)));
        }
        records.push(Record::UtcSet { by_ns: BY_NS, before_utc_ns: UNSET_NS });
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
        // As a kill right after the clock was set leaves it: noted, nothing done.
        assert_eq!(
            (one(&path, LEFT), one(&path, &format!("SELECT count(*) FROM sample WHERE host_utc_ns < {UNSET_NS}"))),
            (1, COUNT as i64 + 2)
        );
        let mut connection = schema::reopen(&path).unwrap();
        let (mut steps, mut images) = (0, 0);
        loop {
            let before = connection.total_changes();
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

    /// The files as a kill leaves them are opened anew: the correction goes on, beside a capture that goes on.
    fn killed_here(path: &Path, image: &Path, id: i64) {
        std::fs::copy(path, image).unwrap();
        std::fs::copy(schema::wal_path(path), schema::wal_path(image)).unwrap();
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
        // A second time: what is right already stays.
        world.send(id, [Record::UtcSet { by_ns: BY_NS, before_utc_ns: UNSET_NS }, sample(4, seq)]);
        world.store.close().unwrap();
        all_right(&path, seq + 1);
    }
}
