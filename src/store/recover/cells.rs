//! Cells: the rows on a page of a database. Every index and length is checked before it is used.
//!
//! # Source
//! "Database File Format", sqlite.org/fileformat2.html: b-tree pages (1.6), the record format (2.1).

use super::image::{Image, u32_at};
use rusqlite::types::{FromSql, Value};
use std::str::FromStr;

/// The longest chain of overflow pages that is followed; registers and results stay far below.
const OVERFLOW_MAX: usize = 4096;

/// Returns a column's value if it is of this type; a column of type REAL may be stored as an integer.
pub(super) fn get<T: FromSql>(row: &[Value], column: usize) -> Option<T> {
    T::column_result(row.get(column)?.into()).ok()
}

/// Returns the value that a column names.
pub(super) fn named<T: FromStr>(row: &[Value], column: usize) -> Option<T> {
    get::<String>(row, column)?.parse().ok()
}

/// Kinds of b-tree pages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    TableLeaf,
    TableInterior,
    IndexLeaf,
    IndexInterior,
}

/// The content of a b-tree page.
#[derive(Debug)]
pub(super) struct Page {
    pub(super) kind: Kind,
    /// Pages below it.
    pub(super) children: Vec<u32>,
    /// Row id (0 in an index or a table without one) and values.
    pub(super) rows: Vec<(i64, Vec<Value>)>,
    /// Cells that could not be read.
    pub(super) damaged: u64,
}

/// Reads a page; `None` if it is no b-tree page.
pub(super) fn parse(image: &Image, number: u32) -> Option<Page> {
    let bytes = image.page(number)?;
    let at = if number == 1 { 100 } else { 0 };
    let kind = match *bytes.get(at)? {
        0x0D => Kind::TableLeaf,
        0x05 => Kind::TableInterior,
        0x0A => Kind::IndexLeaf,
        0x02 => Kind::IndexInterior,
        _ => return None,
    };
    let interior = matches!(kind, Kind::TableInterior | Kind::IndexInterior);
    let count = usize::from(u16_at(&bytes, at + 3)?);
    let pointers = at + if interior { 12 } else { 8 };
    let mut page = Page { kind, children: Vec::new(), rows: Vec::new(), damaged: 0 };
    if interior {
        page.children.push(u32_at(&bytes, at + 8));
    }
    for index in 0..count {
        let cell = u16_at(&bytes, pointers + 2 * index).map(usize::from).filter(|cell| *cell >= pointers);
        match cell.and_then(|cell| read_cell(image, &bytes, cell, kind, &mut page.children)) {
            Some(Some(row)) => page.rows.push(row),
            Some(None) => {}
            None => page.damaged += 1,
        }
    }
    Some(page)
}

/// Reads one cell: a row, no row (in an interior table page), or `None` if it is invalid.
#[expect(clippy::option_option, reason = "outer: whether it can be read; inner: whether it holds a row")]
fn read_cell(
    image: &Image,
    bytes: &[u8],
    mut at: usize,
    kind: Kind,
    children: &mut Vec<u32>,
) -> Option<Option<(i64, Vec<Value>)>> {
    if matches!(kind, Kind::TableInterior | Kind::IndexInterior) {
        bytes.get(at..at + 4)?;
        children.push(u32_at(bytes, at));
        at += 4;
    }
    if kind == Kind::TableInterior {
        return Some(None);
    }
    let length = usize::try_from(varint(bytes, &mut at)?).ok()?;
    let row_id = if kind == Kind::TableLeaf { varint(bytes, &mut at)? as i64 } else { 0 };
    let usable = image.page_size;
    let (most, least) = match kind {
        Kind::TableLeaf => (usable - 35, (usable - 12) * 32 / 255 - 23),
        _ => ((usable - 12) * 64 / 255 - 23, (usable - 12) * 32 / 255 - 23),
    };
    if length <= most {
        return Some(Some((row_id, record(bytes.get(at..at + length)?)?)));
    }
    let fitted = least + (length - least) % (usable - 4);
    let local = if fitted <= most { fitted } else { least };
    let mut payload = bytes.get(at..at + local)?.to_vec();
    bytes.get(at + local..at + local + 4)?;
    let mut next = u32_at(bytes, at + local);
    for _ in 0..OVERFLOW_MAX {
        if payload.len() >= length {
            break;
        }
        let more = image.page(next)?;
        next = u32_at(&more, 0);
        let take = (length - payload.len()).min(usable - 4);
        payload.extend_from_slice(more.get(4..4 + take)?);
    }
    if payload.len() < length {
        return None;
    }
    Some(Some((row_id, record(&payload)?)))
}

fn record(bytes: &[u8]) -> Option<Vec<Value>> {
    let mut at = 0;
    let header = usize::try_from(varint(bytes, &mut at)?).ok()?;
    let mut body = header;
    let mut values = Vec::new();
    while at < header {
        let kind = varint(bytes, &mut at)?;
        let size = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind as usize,
            5 => 6,
            6 | 7 => 8,
            12.. => usize::try_from((kind - 12) / 2).ok()?,
            _ => return None,
        };
        let part = bytes.get(body..body.checked_add(size)?)?;
        body += size;
        values.push(match kind {
            0 => Value::Null,
            8 => Value::Integer(0),
            9 => Value::Integer(1),
            7 => Value::Real(f64::from_be_bytes(part.try_into().ok()?)),
            12.. if kind % 2 == 0 => Value::Blob(part.to_vec()),
            12.. => Value::Text(String::from_utf8(part.to_vec()).ok()?),
            _ => {
                let negative = part.first().is_some_and(|byte| *byte >= 0x80);
                let start = if negative { -1_i64 } else { 0 };
                Value::Integer(part.iter().fold(start, |value, byte| value << 8 | i64::from(*byte)))
            }
        });
    }
    (at == header && body == bytes.len()).then_some(values)
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

fn varint(bytes: &[u8], at: &mut usize) -> Option<u64> {
    let mut value = 0_u64;
    for index in 0..9 {
        let byte = *bytes.get(*at)?;
        *at += 1;
        if index == 8 {
            return Some(value << 8 | u64::from(byte));
        }
        value = value << 7 | u64::from(byte & 0x7f);
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}
