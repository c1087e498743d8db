//! Results: what jobs have computed, as the JSON documents that the interfaces return.

use super::{Reader, StoreError, UtcNs};
use rusqlite::{OptionalExtension, Row};

/// A result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResultRow {
    /// Its id.
    pub id: i64,
    /// The job that made it; absent once that job is deleted.
    pub job_id: Option<i64>,
    /// The capture it is about.
    pub capture_id: i64,
    /// The kind of computation.
    pub kind: String,
    /// The software that made it: a result of other software than [`super::SOFTWARE`] is stale.
    pub software: String,
    /// The time of its creation.
    pub created_at: UtcNs,
    /// The document, JSON text, byte by byte as it was stored.
    pub body: String,
}

const RESULT_COLUMNS: &str = "id, job_id, capture_id, kind, software, created_utc_ns, body";

fn result_of(row: &Row<'_>) -> rusqlite::Result<ResultRow> {
    Ok(ResultRow {
        id: row.get(0)?,
        job_id: row.get(1)?,
        capture_id: row.get(2)?,
        kind: row.get(3)?,
        software: row.get(4)?,
        created_at: UtcNs(row.get(5)?),
        body: row.get(6)?,
    })
}

impl Reader {
    /// One result; `None` if there is none with that id.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn result(&self, id: i64) -> Result<Option<ResultRow>, StoreError> {
        let sql = format!("SELECT {RESULT_COLUMNS} FROM result WHERE id = ?1");
        Ok(self.connection.prepare_cached(&sql)?.query_row([id], result_of).optional()?)
    }
}
