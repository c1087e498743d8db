//! Results of jobs, as the JSON documents that the interfaces return.

use super::sql::find;
use super::{Reader, StoreError};
use rusqlite::Row;

/// A result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResultRow {
    /// Its id.
    pub id: i64,
    /// The job that made it; absent once that job is deleted.
    pub job_id: Option<i64>,
    /// The software that made it: a result of other software than [`super::SOFTWARE`] is stale.
    pub software: String,
    /// The document, JSON text, byte by byte as it was stored.
    pub body: String,
}

impl Reader {
    /// Returns a result; `None` if there is none with that id.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn result(&self, id: i64) -> Result<Option<ResultRow>, StoreError> {
        let sql = "SELECT job_id, software, body FROM result WHERE id = ?1";
        let read = |row: &Row<'_>| Ok(ResultRow { id, job_id: row.get(0)?, software: row.get(1)?, body: row.get(2)? });
        Ok(find(&self.connection, sql, [id], read)?)
    }
}
