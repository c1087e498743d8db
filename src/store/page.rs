//! Pages of lists by keyset. A cursor names the last row that was returned, so that rows added or removed in between
//! neither repeat nor hide others.

use super::StoreError;
use rusqlite::{Connection, Params, Row};

/// Rows of a page if no limit is requested.
pub const LIMIT: u32 = 100;
/// The maximum number of rows of a page.
pub const LIMIT_MAX: u32 = 1000;
/// A page ends before the row that would make it larger, bytes of text: a job's request may have 64 KiB.
const PAGE_BYTES: usize = 1 << 20;

/// The requested part of a list.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PageRequest {
    /// The number of rows, 1–1000; 100 if absent. Larger numbers are taken as 1000.
    pub limit: Option<u32>,
    /// `next` of the previous page; the first page if absent.
    pub cursor: Option<String>,
}

/// A part of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Page<T> {
    /// The rows.
    pub rows: Vec<T>,
    /// The cursor of the next page; absent on the last page.
    pub next: Option<String>,
}

impl PageRequest {
    /// Requests as many rows as a page may have, from the start.
    pub fn first() -> Self {
        Self { limit: Some(LIMIT_MAX), cursor: None }
    }

    /// Requests one row, the one after this key.
    pub(super) fn one_after(list: &str, key: i64) -> Self {
        Self { limit: Some(1), cursor: Some(format!("{list}-1-{}", base36(key))) }
    }

    pub(super) fn limit(&self) -> usize {
        self.limit.unwrap_or(LIMIT).clamp(1, LIMIT_MAX) as usize
    }

    /// Returns the key after which the page begins. `list` prevents the use of one list's cursor on another.
    pub(super) fn after(&self, list: &str) -> Result<Option<i64>, StoreError> {
        let Some(cursor) = &self.cursor else { return Ok(None) };
        cursor
            .strip_prefix(list)
            .and_then(|rest| rest.strip_prefix("-1-"))
            .and_then(|key| u64::from_str_radix(key, 36).ok())
            .and_then(|key| i64::try_from(key).ok())
            .map(Some)
            .ok_or_else(|| StoreError::BadCursor(cursor.chars().take(64).collect()))
    }
}

impl<T> Page<T> {
    /// Reads a page by a query for `limit + 1` rows, whose first column is the key. A page of large rows has fewer of them.
    pub(super) fn read(
        connection: &Connection,
        sql: &str,
        values: impl Params,
        page: &PageRequest,
        list: &str,
        row_of: impl Fn(&Row<'_>) -> Result<T, StoreError>,
    ) -> Result<Self, StoreError> {
        let mut statement = connection.prepare_cached(sql)?;
        let columns = statement.column_count();
        let mut found = statement.query(values)?;
        let (mut rows, mut bytes, mut last, mut next) = (Vec::new(), 0, 0, None);
        while let Some(row) = found.next()? {
            for column in 0..columns {
                bytes += row.get_ref(column)?.as_bytes_or_null().ok().flatten().map_or(8, <[u8]>::len);
            }
            if rows.len() >= page.limit() || (bytes > PAGE_BYTES && !rows.is_empty()) {
                next = Some(format!("{list}-1-{}", base36(last)));
                break;
            }
            last = row.get(0)?;
            rows.push(row_of(row)?);
        }
        Ok(Self { rows, next })
    }
}

fn base36(key: i64) -> String {
    let mut rest = key.max(0) as u64;
    let mut digits = Vec::new();
    loop {
        digits.extend(char::from_digit((rest % 36) as u32, 36));
        rest /= 36;
        if rest == 0 {
            break;
        }
    }
    digits.iter().rev().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads from a table of `count` rows of this size.
    fn page(count: i64, bytes: usize, request: &PageRequest) -> Page<i64> {
        let connection = Connection::open_in_memory().unwrap();
        connection.execute_batch("CREATE TABLE list (id INTEGER PRIMARY KEY, body TEXT)").unwrap();
        for id in 1..=count {
            connection.execute("INSERT INTO list VALUES (?1, ?2)", (1000 * id, "x".repeat(bytes))).unwrap();
        }
        let sql = "SELECT id, body FROM list WHERE id > ?1 ORDER BY id LIMIT ?2";
        let values = (request.after("gaps").unwrap().unwrap_or(0), request.limit() as i64 + 1);
        Page::read(&connection, sql, values, request, "gaps", |row| Ok(row.get(0)?)).unwrap()
    }

    #[test]
    fn a_cursor_leads_on_in_its_own_list_only() {
        let two = PageRequest { limit: Some(2), cursor: None };
        let first = page(3, 10, &two);
        assert_eq!(first.rows, [1000, 2000]);
        let next = PageRequest { cursor: first.next, ..two };
        assert_eq!(next.after("gaps").unwrap(), Some(2000));
        let rest = page(3, 10, &next);
        assert_eq!((rest.rows, rest.next), (vec![3000], None));
        assert!(matches!(next.after("events"), Err(StoreError::BadCursor(_))));
        for bad in ["", "gaps", "gaps-1-", "gaps-2-a", "gaps-1--1", "gaps-1-zzzzzzzzzzzzzz", "gaps-1-é"] {
            let request = PageRequest { limit: None, cursor: Some(bad.to_owned()) };
            assert!(request.after("gaps").is_err(), "{bad}");
        }
    }

    #[test]
    fn the_last_page_has_no_next() {
        let two = PageRequest { limit: Some(2), cursor: None };
        assert_eq!(page(2, 10, &two).next, None);
        assert_eq!(page(0, 10, &two), Page { rows: Vec::new(), next: None });
    }

    #[test]
    fn pages_of_large_rows_have_fewer_of_them_and_lead_through_all() {
        for (bytes, most) in [(64 * 1024, 16), (3 << 20, 1)] {
            let (mut request, mut all) = (PageRequest::first(), Vec::new());
            loop {
                let found = page(40, bytes, &request);
                assert!((1..=most).contains(&found.rows.len()), "{} rows of {bytes} bytes", found.rows.len());
                all.extend(found.rows);
                let Some(next) = found.next else { break };
                request.cursor = Some(next);
            }
            assert_eq!(all, (1..=40).map(|id| 1000 * id).collect::<Vec<i64>>());
        }
    }
}
