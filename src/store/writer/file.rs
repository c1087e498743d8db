//! The writer's queries about the database file itself: its identity, its last batch, and whether it is sound and
//! durable.

use super::super::StoreError;
use super::super::insert::Inserted;
use super::super::paths::wal_path;
use imu_core::sample::Record;
use rusqlite::Connection;
use std::path::Path;
use std::time::Duration;

pub(in crate::store) fn identity_of(connection: &Connection) -> Result<String, StoreError> {
    Ok(connection.query_row("SELECT identity FROM writer", [], |row| row.get(0))?)
}

pub(super) fn last_batch(connection: &Connection) -> Result<i64, StoreError> {
    Ok(connection.query_row("SELECT batch FROM writer", [], |row| row.get(0))?)
}

/// Returns the effect of a batch on the captures, after it turned out to be on disk.
pub(super) fn committed_of(connection: &Connection, batch: &[(i64, Record)]) -> Result<Inserted, StoreError> {
    let mut inserted = Inserted::default();
    let captures: std::collections::BTreeSet<i64> = batch.iter().map(|(id, _)| *id).collect();
    inserted.samples = batch.iter().filter(|(_, record)| matches!(record, Record::Sample { .. })).count() as u64;
    for id in captures {
        let samples =
            connection.query_row("SELECT samples FROM capture WHERE id = ?1", [id], |row| row.get::<_, i64>(0));
        match samples {
            Ok(samples) => drop(inserted.committed.insert(id, samples as u64)),
            Err(rusqlite::Error::QueryReturnedNoRows) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(inserted)
}

/// Makes committed data durable without trusting an fsync that has failed before. The log's pages are copied into the
/// file, which is synced. If a reader prevents that, the log is written over itself, byte by byte the same, which makes
/// its pages dirty again, and synced.
pub(super) fn make_durable(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    let (log, copied): (i64, i64) =
        connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |row| Ok((row.get(1)?, row.get(2)?)))?;
    if log > copied {
        rewrite(&wal_path(path)).map_err(|source| StoreError::Create { path: wal_path(path), source })?;
    }
    Ok(())
}

pub(in crate::store) fn rewrite(path: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::FileExt;
    let file = std::fs::OpenOptions::new().read(true).write(true).open(path)?;
    let mut buffer = vec![0; 1 << 20];
    let mut at = 0;
    loop {
        let count = file.read_at(&mut buffer, at)?;
        if count == 0 {
            return file.sync_all();
        }
        file.write_all_at(&buffer[..count], at)?;
        at += count as u64;
    }
}

/// Copies the whole log into the database file and empties it.
pub(super) fn copy_log(connection: &Connection) -> Result<(), StoreError> {
    connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))?;
    Ok(())
}

/// Returns SQLite's report without its headline, in one line.
pub(in crate::store) fn one_line(report: &str) -> String {
    report.trim_start_matches("*** in database main ***").trim().replace('\n', "; ")
}

/// Runs SQLite's quick check; a check that takes longer than `limit` is abandoned and counts as passed.
pub(in crate::store) fn quick_check(connection: &Connection, limit: Duration) -> Result<(), StoreError> {
    let until = std::time::Instant::now() + limit;
    connection.progress_handler(100_000, Some(move || std::time::Instant::now() > until))?;
    let report: Result<String, rusqlite::Error> = connection.query_row("PRAGMA quick_check(1)", [], |row| row.get(0));
    connection.progress_handler(0, None::<fn() -> bool>)?;
    match report {
        Ok(report) if report == "ok" => Ok(()),
        Ok(report) => Err(StoreError::Damaged(one_line(&report))),
        Err(error) if error.sqlite_error_code() == Some(rusqlite::ErrorCode::OperationInterrupted) => {
            tracing::warn!(message = "The database is too large to be checked in passing.", ?limit);
            Ok(())
        }
        Err(error) => Err(error.into()),
    }
}
