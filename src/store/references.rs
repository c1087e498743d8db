//! References: the motion that a sensor underwent, as supplied with diagnoses. The text is stored once, in parts, so
//! that neither the writer nor the client holds all of it. It is deleted with the last diagnosis that uses it.

use super::sql::{find, run, value};
use super::{Reader, Store, StoreError};
use rusqlite::{Transaction, params};

/// Bytes of a part: some milliseconds of the writer's time.
pub const REFERENCE_PART_BYTES: usize = 1 << 20;
/// Parts that one purge step deletes.
const STEP_PARTS: i64 = 8;
/// References that no job uses any more.
const ORPHANS: &str = "FROM reference WHERE claimed = 1 \
    AND NOT EXISTS (SELECT 1 FROM job WHERE job.reference_id = reference.reference_id)";

impl Store {
    /// Begins to store a reference, given the SHA-256 of its text and its length. Returns its id, and whether it is
    /// already complete. Otherwise [`Self::keep_reference_part`] adds its parts.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn begin_reference(&self, sha256: &str, bytes: u64) -> Result<(i64, bool), StoreError> {
        let (sha256, utc_ns) = (sha256.to_owned(), self.utc_ns());
        let parts = bytes.div_ceil(REFERENCE_PART_BYTES as u64).max(1) as i64;
        self.execute(move |transaction| {
            // A reference that was about to be removed stays for the client that sends it again.
            let sql = "INSERT INTO reference (sha256, bytes, parts, created_utc_ns) VALUES (?1, ?2, ?3, ?4) \
                       ON CONFLICT (sha256) DO UPDATE SET claimed = 0 \
                       WHERE NOT EXISTS (SELECT 1 FROM job WHERE job.reference_id = reference.reference_id)";
            transaction.execute(sql, params![sha256, bytes as i64, parts, utc_ns])?;
            let id: i64 = value(transaction, "SELECT reference_id FROM reference WHERE sha256 = ?1", [&sha256])?;
            Ok((id, is_whole(transaction, id)?))
        })
    }

    /// Stores a part of a reference, counted from 0.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn keep_reference_part(&self, id: i64, part: u32, content: Vec<u8>) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            let sql = "INSERT OR IGNORE INTO reference_part (reference_id, part, content) SELECT ?1, ?2, ?3 \
                       WHERE EXISTS (SELECT 1 FROM reference WHERE reference_id = ?1)";
            run(transaction, sql, params![id, part, content])?;
            Ok(())
        })
    }

    /// Releases a reference that was sent for a diagnosis which was refused, unless another diagnosis uses it.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn let_reference_go(&self, id: i64) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            transaction.execute("UPDATE reference SET claimed = 1 WHERE reference_id = ?1", [id])?;
            Ok(())
        })
    }

    /// Removes some parts of a reference that no job uses any more; returns `false` if there is none.
    ///
    /// # Errors
    /// The error that the database reports.
    pub(super) fn purge_reference(transaction: &Transaction<'_>) -> Result<bool, StoreError> {
        let sql = format!("SELECT reference_id {ORPHANS} LIMIT 1");
        let found: Option<i64> = find(transaction, &sql, [], |row| row.get(0))?;
        let Some(id) = found else { return Ok(false) };
        let sql = "DELETE FROM reference_part WHERE reference_part_id IN \
                   (SELECT reference_part_id FROM reference_part WHERE reference_id = ?1 LIMIT ?2)";
        if transaction.execute(sql, params![id, STEP_PARTS])? == 0 {
            transaction.execute("DELETE FROM reference WHERE reference_id = ?1", [id])?;
        }
        Ok(true)
    }
}

/// Returns the id of the reference with this SHA-256, claimed for a job.
pub(super) fn claim(transaction: &Transaction<'_>, sha256: &str) -> Result<i64, StoreError> {
    let sql = "UPDATE reference SET claimed = 1 WHERE sha256 = ?1 RETURNING reference_id";
    let id = find(transaction, sql, [sha256], |row| row.get(0))?;
    let unknown = || StoreError::NoSuchReference(sha256.to_owned());
    let id = id.ok_or_else(unknown)?;
    if is_whole(transaction, id)? { Ok(id) } else { Err(unknown()) }
}

fn is_whole(transaction: &Transaction<'_>, id: i64) -> Result<bool, StoreError> {
    let sql = "SELECT parts = (SELECT count(*) FROM reference_part WHERE reference_id = ?1) FROM reference \
               WHERE reference_id = ?1";
    Ok(value(transaction, sql, [id])?)
}

impl Reader {
    /// Returns the text of a reference.
    ///
    /// # Errors
    /// [`StoreError::NoSuchReference`], or the error that the database reports.
    pub fn reference(&self, sha256: &str) -> Result<String, StoreError> {
        let unknown = || StoreError::NoSuchReference(sha256.to_owned());
        let sql =
            "SELECT content FROM reference_part JOIN reference USING (reference_id) WHERE sha256 = ?1 ORDER BY part";
        let mut statement = self.connection.prepare_cached(sql)?;
        let mut rows = statement.query([sha256])?;
        let mut text = Vec::new();
        while let Some(row) = rows.next()? {
            text.extend_from_slice(row.get_ref(0)?.as_blob().map_err(|_| unknown())?);
        }
        if text.is_empty() {
            return Err(unknown());
        }
        String::from_utf8(text).map_err(|_| unknown())
    }

    /// Returns whether there are references that no job uses any more.
    pub(super) fn has_orphans(&self) -> Result<bool, StoreError> {
        let sql = format!("SELECT EXISTS (SELECT 1 {ORPHANS})");
        Ok(value(&self.connection, &sql, [])?)
    }
}

#[cfg(test)]
mod tests {
    use super::REFERENCE_PART_BYTES;
    use crate::store::tests::World;
    use crate::store::{JobKind, NewJob, Reader, StoreError};

    fn job(capture_id: i64, sim: u32, sha256: &str) -> NewJob {
        let reference = Some(sha256.to_owned());
        NewJob { reference, ..NewJob::new(JobKind::Diagnosis, capture_id, serde_json::json!({ "sim": sim })) }
    }

    fn parts(reader: &Reader) -> i64 {
        reader.connection.query_row("SELECT count(*) FROM reference_part", [], |row| row.get(0)).unwrap()
    }

    #[test]
    fn a_reference_is_kept_once_and_goes_with_its_last_diagnosis() {
        let world = World::new();
        let (one, other) = (world.complete("one"), world.complete("other"));
        let text = "time_s,and so on\n".repeat(REFERENCE_PART_BYTES / 16);
        let (id, whole) = world.store.begin_reference("abc", text.len() as u64).unwrap();
        assert!(!whole);
        let refused = world.store.submit_job(job(one, 1, "abc"), u64::MAX).unwrap_err();
        assert!(matches!(refused, StoreError::NoSuchReference(_)), "it is not whole yet: {refused}");
        for (part, content) in (0..).zip(text.as_bytes().chunks(REFERENCE_PART_BYTES)) {
            world.store.keep_reference_part(id, part, content.to_vec()).unwrap();
        }
        assert_eq!(world.store.begin_reference("abc", text.len() as u64).unwrap(), (id, true));
        let first = world.store.submit_job(job(one, 1, "abc"), u64::MAX).unwrap().0;
        world.store.submit_job(job(other, 1, "abc"), u64::MAX).unwrap();
        let reader = world.reader();
        assert_eq!(reader.reference("abc").unwrap(), text);
        assert_eq!((parts(&reader), reader.has_deleted().unwrap()), (2, false));
        assert!(!first.params.contains("and so on"));
        for row in reader.retention_rows().unwrap() {
            assert_eq!(row.bytes, text.len() as u64 / 2, "it counts for what may be kept, once");
        }
        world.store.delete_capture(one).unwrap();
        while world.store.purge_step().unwrap() {}
        assert_eq!(reader.reference("abc").unwrap(), text, "another diagnosis has it");
        world.store.delete_capture(other).unwrap();
        assert!(reader.has_deleted().unwrap());
        while world.store.purge_step().unwrap() {}
        assert!(matches!(reader.reference("abc").unwrap_err(), StoreError::NoSuchReference(_)));
        assert_eq!((parts(&reader), reader.has_deleted().unwrap()), (0, false));
    }

    #[test]
    fn one_that_is_brought_while_it_goes_stays() {
        let world = World::new();
        let capture = world.complete("one");
        let (id, _) = world.store.begin_reference("abc", 4).unwrap();
        world.store.keep_reference_part(id, 0, b"text".to_vec()).unwrap();
        world.store.submit_job(job(capture, 1, "abc"), u64::MAX).unwrap();
        world.store.delete_capture(capture).unwrap();
        // The capture's rows are removed, and the parts of the reference one step later.
        while parts(&world.reader()) > 0 {
            assert!(world.store.purge_step().unwrap());
        }
        assert_eq!(world.store.begin_reference("abc", 4).unwrap(), (id, false), "its parts are to be brought again");
        while world.store.purge_step().unwrap() {}
        world.store.keep_reference_part(id, 0, b"text".to_vec()).unwrap();
        assert_eq!(world.reader().reference("abc").unwrap(), "text");
    }
}
