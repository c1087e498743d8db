//! The check before a database is opened for writing: whether its file, its log and its newest batches are intact. Two
//! of its parts also serve the running writer and `vn100d check`.

use super::StoreError;
use super::batch::{batch_row, is_intact};
use super::damage::Damage;
use super::error::reports_damage;
use super::lock::Mark;
use super::paths::wal_path;
use super::sql::{list, value};
use super::writer::{identity_of, quick_check};
use rusqlite::{Connection, params};
use std::path::Path;
use std::time::{Duration, Instant};

/// The time limit of the check at a start. Of a larger database the newest batches are checked first, as many as fit.
const AT_START: Duration = Duration::from_secs(2);

/// Checks a database before it is opened for writing, through a connection that cannot write.
pub(super) fn at_start(connection: &Connection, path: &Path, mark: Option<&Mark>) -> Result<(), StoreError> {
    let refused = |report: String| Damage::Refused(report).error(path);
    let damaged = |error: StoreError| match error {
        StoreError::Sqlite(error) if reports_damage(&error) => refused(error.to_string()),
        StoreError::Damaged(report) => refused(report),
        other => other,
    };
    if let Some(problem) = truncated(connection, path) {
        return Err(refused(problem));
    }
    if let Some(mark) = mark {
        not_behind(connection, path, mark).map_err(damaged)?;
        met_before(connection, path, mark).map_err(damaged)?;
    }
    let until = Instant::now() + AT_START;
    quick_check(connection, AT_START / 2).map_err(damaged)?;
    newest_batches(connection, until).map_err(damaged)
}

/// Describes the problem if the file is shorter than its header states. A log that is not empty may hold the missing
/// part.
pub(super) fn truncated(connection: &Connection, path: &Path) -> Option<String> {
    let log = std::fs::metadata(wal_path(path)).map_or(0, |log| log.len());
    let number = |name: &str| connection.pragma_query_value(None, name, |row| row.get::<_, i64>(0)).ok();
    let wanted = number("page_count")? * number("page_size")?;
    let there = std::fs::metadata(path).ok()?.len() as i64;
    (log == 0 && there < wanted).then(|| format!("the file has {there} bytes of {wanted}"))
}

/// Fails if damage was found while this database was in use: it may lie outside the part that the check of a start
/// covers.
fn met_before(connection: &Connection, path: &Path, mark: &Mark) -> Result<(), StoreError> {
    let Some(report) = &mark.damage else { return Ok(()) };
    // If the identity cannot be read, the checks that follow report it.
    if identity_of(connection).ok().as_ref() != Some(&mark.identity) {
        return Ok(());
    }
    Err(Damage::Met(report.clone()).error(path))
}

/// Fails if the database has fewer batches than were acknowledged: it has lost its log.
pub(super) fn not_behind(connection: &Connection, path: &Path, mark: &Mark) -> Result<(), StoreError> {
    let sql = "SELECT identity, batch FROM writer";
    let found = connection.query_row(sql, [], |row| Ok((row.get::<_, String>(0)?, row.get::<_, i64>(1)?)));
    match found {
        Ok((identity, batch)) if identity == mark.identity && batch < mark.batch => {
            Err(Damage::LogMissing(mark.batch - batch).error(path))
        }
        Ok(_) => Ok(()),
        // An older schema has no identity. A database without the table is one whose beginning was still in the log.
        Err(error) if !reports_damage(&error) => {
            let sql = "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'writer')";
            let has_table: bool = value(connection, sql, [])?;
            if has_table || mark.batch == 0 {
                return Ok(());
            }
            Err(Damage::LogMissing(mark.batch).error(path))
        }
        Err(error) => Err(error.into()),
    }
}

fn newest_batches(connection: &Connection, until: Instant) -> Result<(), StoreError> {
    let has_batches: bool = value(connection, "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'batch')", [])?;
    if !has_batches {
        return Ok(());
    }
    let mut next = Some((i64::MAX, i64::MAX));
    while let Some((capture, before)) = next {
        let sql = "SELECT capture_id, first_seq, count, crc FROM batch WHERE (capture_id, first_seq) < (?1, ?2) \
                   AND capture_id IN (SELECT id FROM capture WHERE lifecycle = 'live') \
                   ORDER BY capture_id DESC, first_seq DESC LIMIT 100";
        let batches = list(connection, sql, params![capture, before], batch_row)?;
        for batch in &batches {
            if !is_intact(connection, batch)? {
                let (from, to) = (batch.first_seq, batch.first_seq + batch.count - 1);
                let report = format!("samples {from}–{to} of capture {} are not what was committed", batch.capture_id);
                return Err(StoreError::Damaged(report));
            }
            if Instant::now() > until {
                return Ok(());
            }
        }
        next = batches.last().map(|batch| (batch.capture_id, batch.first_seq));
    }
    Ok(())
}
