//! Rows of a table: their cells, what reads them one by one, and what is left out of them.

use crate::recording::error::RecordingError;

/// Names that are shown of what is left out.
const SHOWN: usize = 20;

/// The content of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Cell {
    /// No number, or one that is not finite.
    Absent,
    Number(f64),
    Whole(i64),
    /// A time since 1970, ns.
    Date(i64),
}

impl Cell {
    pub(super) fn of(number: f64) -> Self {
        if number.is_finite() { Self::Number(number) } else { Self::Absent }
    }

    pub(super) fn text(self) -> String {
        match self {
            Self::Absent => String::new(),
            Self::Number(number) => number.to_string(),
            Self::Whole(whole) => whole.to_string(),
            Self::Date(nanos) => chrono::DateTime::from_timestamp_nanos(nanos).to_rfc3339(),
        }
    }

    /// Returns the time in a unit of which a nanosecond is the `places`th decimal, ns.
    pub(super) fn nanos(self, places: usize) -> Option<i64> {
        let unit = 10_i64.pow(u32::try_from(places).ok()?);
        match self {
            Self::Absent => None,
            Self::Date(nanos) => Some(nanos),
            Self::Whole(whole) => whole.checked_mul(unit),
            Self::Number(number) => {
                let nanos = (number * unit as f64).round();
                (nanos.abs() < i64::MAX as f64).then_some(nanos as i64)
            }
        }
    }
}

/// The outcome of reading a row.
pub(super) enum Next {
    /// The cells hold it.
    Row,
    /// Data that cannot be read, and what is wrong with it. What follows is read.
    Damaged(String),
    End,
}

/// A table, row by row.
pub(super) trait Table {
    /// Returns the columns' names.
    fn names(&self) -> &[String];
    /// Returns whether the names are only positions.
    fn is_unnamed(&self) -> bool {
        false
    }
    /// Returns what of the file is no column of it.
    fn left_out(&self) -> Vec<String> {
        Vec::new()
    }
    /// Reads the next row into `cells`, one for each name.
    fn next_row(&mut self, cells: &mut Vec<Cell>) -> Result<Next, RecordingError>;
}

/// Returns what is left out of one kind, as one text.
pub(super) fn left_out(kind: &str, names: &[String]) -> Option<String> {
    let shown = names.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
    match names.len() {
        0 => None,
        all if all > SHOWN => Some(format!("{kind} {shown} and {} more", all - SHOWN)),
        _ => Some(format!("{kind} {shown}")),
    }
}
