//! Short forms for the statements of the store. A connection prepares each of them once.

use rusqlite::types::FromSql;
use rusqlite::{Connection, OptionalExtension as _, Params, Result, Row};

/// Executes a statement and returns how many rows it changed.
pub(super) fn run(connection: &Connection, sql: &str, values: impl Params) -> Result<usize> {
    connection.prepare_cached(sql)?.execute(values)
}

/// Returns what `read` takes from the first row of a query, or `None` if there is no row.
pub(super) fn find<T>(
    connection: &Connection,
    sql: &str,
    values: impl Params,
    read: impl FnOnce(&Row<'_>) -> Result<T>,
) -> Result<Option<T>> {
    connection.prepare_cached(sql)?.query_row(values, read).optional()
}

/// Returns the first column of the row that a query always has.
pub(super) fn value<T: FromSql>(connection: &Connection, sql: &str, values: impl Params) -> Result<T> {
    connection.prepare_cached(sql)?.query_row(values, |row| row.get(0))
}

/// Returns what `read` takes from each row of a query.
pub(super) fn list<T>(
    connection: &Connection,
    sql: &str,
    values: impl Params,
    read: impl FnMut(&Row<'_>) -> Result<T>,
) -> Result<Vec<T>> {
    connection.prepare_cached(sql)?.query_map(values, read)?.collect()
}
