//! Data for retention: the facts on which it decides, its announcements, and the space that it gives back.

use super::progress::BYTES_PER_SAMPLE;
use super::sql::list;
use super::{Reader, Store, StoreError, UtcNs};
use rusqlite::params;

/// Free pages that stay in the file for later data: 64 MiB of 4 KiB.
const SPARE_PAGES: i64 = 16_384;
/// Pages given back in one transaction: some tens of ms, so that the writer is free in between.
const STEP_PAGES: i64 = 1024;

/// The facts about a capture that retention needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetentionRow {
    /// Its id.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// The time since which the capture is complete: its end or, if it was imported or simulated, its creation.
    pub since: UtcNs,
    /// Bytes in the file of its samples and of the references of its diagnoses. A reference that diagnoses of several
    /// captures use counts in equal shares.
    pub bytes: u64,
    /// Whether it runs or waits.
    pub open: bool,
    /// Whether it is kept from deletion.
    pub pinned: bool,
    /// The time at which its deletion was announced, and the time it was announced for, UTC ns.
    pub announced: Option<(i64, i64)>,
}

impl Reader {
    /// Returns all captures, oldest id first.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn retention_rows(&self) -> Result<Vec<RetentionRow>, StoreError> {
        // An imported capture has the times of its stamps, which may be years in the past or in the future: its
        // creation counts.
        let sql = "SELECT id, name, CASE WHEN state IN ('imported', 'simulated') THEN created_utc_ns \
                   ELSE max(created_utc_ns, coalesce(ended_utc_ns, created_utc_ns)) END, samples, \
                   state IN ('waiting', 'capturing'), pinned, deletion_said_utc_ns, delete_at_utc_ns, \
                   (SELECT coalesce(sum(bytes / (SELECT count(DISTINCT capture_id) FROM job \
                     WHERE job.reference_id = reference.reference_id)), 0) FROM reference WHERE reference_id IN \
                    (SELECT reference_id FROM job WHERE capture_id = capture.id AND reference_id IS NOT NULL)) \
                   FROM capture WHERE lifecycle = 'live' ORDER BY id";
        Ok(list(&self.connection, sql, [], |row| {
            let announced_at: Option<i64> = row.get(6)?;
            let delete_at: Option<i64> = row.get(7)?;
            Ok(RetentionRow {
                id: row.get(0)?,
                name: row.get(1)?,
                since: UtcNs(row.get(2)?),
                bytes: (row.get::<_, i64>(3)?.max(0) as f64 * BYTES_PER_SAMPLE) as u64
                    + row.get::<_, i64>(8)?.max(0) as u64,
                open: row.get(4)?,
                pinned: row.get(5)?,
                announced: announced_at.zip(delete_at),
            })
        })?)
    }

    /// Returns whether the file has more free pages than it keeps for later data ([`Store::give_back_step`]).
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn has_space_to_give_back(&self) -> Result<bool, StoreError> {
        let number = |name| self.connection.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
        Ok(number("auto_vacuum")? == 2 && number("freelist_count")? > SPARE_PAGES)
    }
}

impl Store {
    /// Records the announcements of captures' deletions. For each id: the time of the announcement and the time of the
    /// deletion (UTC ns), or `None` to withdraw it.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn announce_deletions(&self, changes: Vec<(i64, Option<(i64, i64)>)>) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            let sql = "UPDATE capture SET deletion_said_utc_ns = ?2, delete_at_utc_ns = ?3 WHERE id = ?1";
            let mut statement = transaction.prepare_cached(sql)?;
            for (id, announcement) in &changes {
                let (announced_at, delete_at) = announcement.unzip();
                statement.execute(params![id, announced_at, delete_at])?;
            }
            Ok(())
        })
    }

    /// Gives some free pages back to the file system, in one transaction of some tens of milliseconds. A database that
    /// was made without `auto_vacuum` keeps them and reuses them for later data.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn give_back_step(&self) -> Result<(), StoreError> {
        self.execute(|transaction| {
            // Each row of the result is a page: the statement must be read to the end, or it stops.
            let mut statement = transaction.prepare(&format!("PRAGMA incremental_vacuum({STEP_PAGES})"))?;
            let mut rows = statement.query([])?;
            while rows.next()?.is_some() {}
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::store::{CaptureState, NewCapture, Store, StoreOptions};
    use imu_core::sample::{Record, Sample};
    use std::time::{Duration, Instant};

    /// 100,000 samples (about 19 MB) are deleted in steps and given back; no step holds the writer for long.
    #[test]
    fn space_of_deleted_captures_is_given_back() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.db");
        let store = Store::open(&path, StoreOptions::default()).unwrap();
        let named =
            |name: &str| NewCapture { name: Some(name.to_owned()), ..NewCapture::new("test", CaptureState::Complete) };
        let (old, new) = (store.create_capture(named("old")).unwrap(), store.create_capture(named("new")).unwrap());
        let records = store.records();
        for (capture, samples) in [(old, 100_000), (new, 1000)] {
            for seq in 0..samples {
                let sample = Sample::at(seq, seq as i64);
                records.blocking_send(capture, Record::Sample { seq, segment: 1, sample }).unwrap();
            }
        }
        store.flush_blocking().unwrap();
        let number = |name: &str| -> i64 {
            store.reader().unwrap().connection.pragma_query_value(None, name, |row| row.get(0)).unwrap()
        };
        let before = number("page_count");
        store.delete_capture(old).unwrap();
        let (mut steps, mut longest) = (0, Duration::ZERO);
        let mut step = |work: &dyn Fn() -> bool| {
            let begun = Instant::now();
            let more = work();
            longest = longest.max(begun.elapsed());
            steps += 1;
            more
        };
        while step(&|| store.purge_step().unwrap()) {}
        let free = number("freelist_count");
        assert!(free > before / 2, "{free} of {before} pages are free");
        assert!(!store.reader().unwrap().has_space_to_give_back().unwrap(), "so little stays for what comes next");
        while number("freelist_count") > 0 {
            step(&|| {
                store.give_back_step().unwrap();
                true
            });
        }
        // The pages that map free pages are removed with them.
        let after = number("page_count");
        assert!(after <= before - free, "{after} of {before} pages after {free} were free");
        eprintln!("{steps} steps, the longest {longest:?}; {before} pages before, {after} after");
        assert!(longest < Duration::from_secs(5), "{longest:?}");
        let reader = store.reader().unwrap();
        let counted: i64 = reader.connection.query_row("SELECT count(*) FROM sample", [], |row| row.get(0)).unwrap();
        assert_eq!(counted, 1000, "the other one is whole");
        let check: String = reader.connection.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
        assert_eq!(check, "ok");
        store.close().unwrap();
        let size = std::fs::metadata(&path).unwrap().len();
        assert!(size < 2 << 20, "{size} bytes are left");
    }

    #[test]
    fn an_announcement_is_kept_and_ends_with_a_pin() {
        let directory = tempfile::tempdir().unwrap();
        let store = Store::open(&directory.path().join("a.db"), StoreOptions::default()).unwrap();
        let id = store.create_capture(NewCapture::new("test", CaptureState::Complete)).unwrap();
        let announced = || store.reader().unwrap().retention_rows().unwrap()[0].announced;
        store.announce_deletions(vec![(id, Some((5, 9)))]).unwrap();
        assert_eq!(announced(), Some((5, 9)));
        assert_eq!(store.reader().unwrap().capture(id).unwrap().delete_at.map(|time| time.0), Some(9));
        store.pin(id, false).unwrap();
        assert_eq!(announced(), Some((5, 9)));
        store.pin(id, true).unwrap();
        assert_eq!(announced(), None);
        store.announce_deletions(vec![(id, Some((6, 10))), (id, None)]).unwrap();
        assert_eq!(announced(), None);
    }
}
