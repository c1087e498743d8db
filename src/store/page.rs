//! Pages of lists by keyset. A cursor names the last row that was returned, so that rows added or removed in between
//! neither repeat nor hide others.

use super::StoreError;
use rusqlite::{Connection, Params, Row};

/// Rows of a page if no limit is requested.
pub const LIMIT: u32 = 100;
/// The maximum number of rows of a page.
pub const LIMIT_MAX: u32 = 1000;

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
            .ok_or_else(|| StoreError::BadCursor { found: cursor.chars().take(64).collect() })
    }
}

impl<T> Page<T> {
    /// Reads a page by a query for `limit + 1` rows, whose first column is the key.
    pub(super) fn read(
        connection: &Connection,
        sql: &str,
        values: impl Params,
        page: &PageRequest,
        list: &str,
        row_of: impl Fn(&Row<'_>) -> Result<T, StoreError>,
    ) -> Result<Self, StoreError> {
        let mut statement = connection.prepare_cached(sql)?;
        let rows = statement.query_and_then(values, |row| Ok::<_, StoreError>((row.get(0)?, row_of(row)?)))?;
        Ok(Self::cut(rows.collect::<Result<_, _>>()?, page.limit(), list))
    }

    /// Makes a page from up to `limit + 1` rows: an extra row shows that there are more.
    fn cut(mut rows: Vec<(i64, T)>, limit: usize, list: &str) -> Self {
        let more = rows.len() > limit;
        rows.truncate(limit);
        let next = rows.last().filter(|_| more).map(|(key, _)| format!("{list}-1-{}", base36(*key)));
        Self { rows: rows.into_iter().map(|(_, row)| row).collect(), next }
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

    #[test]
    fn a_cursor_leads_on_in_its_own_list_only() {
        let page = Page::cut(vec![(7, 'a'), (1_000_000, 'b'), (2_000_000, 'c')], 2, "gaps");
        assert_eq!(page.rows, ['a', 'b']);
        let next = PageRequest { limit: None, cursor: page.next };
        assert_eq!(next.after("gaps").unwrap(), Some(1_000_000));
        assert!(matches!(next.after("events"), Err(StoreError::BadCursor { .. })));
        for bad in ["", "gaps", "gaps-1-", "gaps-2-a", "gaps-1--1", "gaps-1-zzzzzzzzzzzzzz", "gaps-1-é"] {
            let request = PageRequest { limit: None, cursor: Some(bad.to_owned()) };
            assert!(request.after("gaps").is_err(), "{bad}");
        }
    }

    #[test]
    fn the_last_page_has_no_next() {
        assert_eq!(Page::cut(vec![(1, ()), (2, ())], 2, "x").next, None);
        assert_eq!(Page::<()>::cut(vec![], 2, "x").next, None);
    }
}
