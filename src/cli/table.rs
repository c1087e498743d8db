//! Tables for people: as wide as they need to be without a terminal, and within its columns on one.
//!
//! Cells go in, text comes out. If a table is too wide, cells are wrapped between words; if even its longest words are
//! too wide, each row becomes a list of its cells. No cell is cut.

use comfy_table::{ColumnConstraint, ContentArrangement, Width, presets};
use std::fmt;

/// What a column has beside its content: a border and two spaces.
const BESIDE: u16 = 3;

/// A table.
#[derive(Debug, Clone)]
pub(super) struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    /// The number of columns within which it has to fit; none if there is no limit.
    within: Option<u16>,
}

impl Table {
    /// Creates a table without rows that fits the terminal on standard output.
    pub(super) fn new(header: &[&str]) -> Self {
        Self { header: header.iter().map(|text| (*text).to_owned()).collect(), rows: Vec::new(), within: terminal() }
    }

    /// Limits the width also where there is no terminal.
    pub(super) fn at_most(mut self, columns: u16) -> Self {
        self.within = Some(self.within.map_or(columns, |within| within.min(columns)));
        self
    }

    /// Adds a row.
    pub(super) fn add_row<T: ToString>(&mut self, cells: impl IntoIterator<Item = T>) {
        self.rows.push(cells.into_iter().map(|cell| cell.to_string()).collect());
    }

    /// Adds rows.
    pub(super) fn add_rows<T: ToString, R: IntoIterator<Item = T>>(&mut self, rows: impl IntoIterator<Item = R>) {
        rows.into_iter().for_each(|row| self.add_row(row));
    }

    /// Returns whether the table has no row.
    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    fn drawn(&self, within: Option<u16>) -> String {
        let Some(within) = within else { return self.with(self.plain()) };
        if self.width(|text| text.lines().map(str::len_shown).max()) <= within {
            return self.with(self.plain());
        }
        if self.width(|text| text.split_whitespace().map(str::len_shown).max()) <= within {
            return self.with(self.wrapped(within));
        }
        self.listed(within)
    }

    /// Returns the width of a table whose columns have this width for each cell.
    fn width(&self, of: impl Fn(&str) -> Option<u16>) -> u16 {
        self.widths(of).into_iter().fold(1, |sum, width| sum.saturating_add(width.saturating_add(BESIDE)))
    }

    fn widths(&self, of: impl Fn(&str) -> Option<u16>) -> Vec<u16> {
        let width = |(column, header): (usize, &String)| {
            let cells = self.rows.iter().filter_map(|row| row.get(column));
            std::iter::once(header).chain(cells).filter_map(|text| of(text)).max().unwrap_or_default()
        };
        self.header.iter().enumerate().map(width).collect()
    }

    fn plain(&self) -> comfy_table::Table {
        let mut table = comfy_table::Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED).set_header(&self.header);
        table
    }

    /// Returns a table that wraps between words.
    fn wrapped(&self, within: u16) -> comfy_table::Table {
        let mut table = self.plain();
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(within);
        let words = self.widths(|text| text.split_whitespace().map(str::len_shown).max());
        // A width includes the two spaces.
        table.set_constraints(
            words.into_iter().map(|width| ColumnConstraint::LowerBoundary(Width::Fixed(width.saturating_add(2)))),
        );
        table
    }

    fn with(&self, mut table: comfy_table::Table) -> String {
        table.add_rows(&self.rows);
        table.to_string()
    }

    /// Returns a list: for each row the names of the columns, each with its cell.
    fn listed(&self, within: u16) -> String {
        let mut table = comfy_table::Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(within);
        for (place, row) in self.rows.iter().enumerate() {
            if place > 0 {
                table.add_row(["", ""]);
            }
            for (name, cell) in self.header.iter().zip(row).filter(|(_, cell)| !cell.is_empty()) {
                table.add_row([name, cell]);
            }
        }
        table.to_string()
    }
}

/// Returns rows of a name and a text, without borders, within this many columns.
pub(super) fn facts(rows: &[[String; 2]], within: Option<u16>) -> String {
    let mut table = comfy_table::Table::new();
    table.load_style(presets::NOTHING);
    if let Some(within) = within {
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(within);
        let names = rows.iter().map(|[name, _]| name.len_shown()).max().unwrap_or_default();
        table.set_constraints([ColumnConstraint::Absolute(Width::Fixed(names.saturating_add(2)))]);
    }
    table.add_rows(rows);
    table.trim_fmt()
}

impl fmt::Display for Table {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        to.write_str(&self.drawn(self.within))
    }
}

/// The width of a text on a terminal.
trait Shown {
    fn len_shown(&self) -> u16;
}

impl Shown for str {
    fn len_shown(&self) -> u16 {
        u16::try_from(self.chars().count()).unwrap_or(u16::MAX)
    }
}

/// Returns the number of columns of the terminal on standard output, or of `COLUMNS`; none if it is no terminal.
pub(super) fn terminal() -> Option<u16> {
    let stated = std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok());
    let of_terminal = || rustix::termios::tcgetwinsize(std::io::stdout()).ok().map(|size| size.ws_col);
    stated.or_else(of_terminal).filter(|columns| *columns > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_wraps_between_words_and_becomes_a_list_before_it_cuts_one() {
        let mut table = Table { within: None, ..Table::new(&["channel", "N in U/√Hz", "B in U"]) };
        table.add_row(["gyro_x", "1.953e-4 [1.936e-4, 1.971e-4]", "< 3.47e-5"]);
        table.add_row(["gyro_y", "1.119e-4 [1.100e-4, 1.147e-4]", "–"]);
        let widest = |text: &str| text.lines().map(|line| line.chars().count()).max().unwrap();
        assert_eq!((widest(&table.drawn(None)), table.drawn(None)), (55, table.drawn(Some(55))));
        for within in [54, 45, 40, 30] {
            let text = table.drawn(Some(within));
            assert!(widest(&text) <= usize::from(within), "{within}\n{text}");
            for word in ["gyro_x", "1.953e-4", "1.936e-4,", "1.971e-4]", "3.47e-5", "1.147e-4]"] {
                assert!(text.contains(word), "{word} is cut at {within}\n{text}");
            }
        }
        assert!(table.drawn(Some(30)).contains("│ channel    ┆ gyro_x"), "{}", table.drawn(Some(30)));
        assert_eq!(widest(&table.clone().at_most(45).to_string()), widest(&table.drawn(Some(45))));
    }
}
