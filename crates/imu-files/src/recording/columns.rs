//! Columns: what each column of a table holds, from its name, the user's map and, for times without a unit, its first
//! values.
//!
//! The user's map decides first; of what it does not name, columns that state a channel with its unit are taken
//! ([`super::vocabulary`]). Two columns of one channel are refused, unless one gives way (an uncompensated value, one
//! without gravity). A time in a unit that its name does not state is taken if the program that wrote the file is known by
//! its other columns, if it is a date, or if its values are times since 1970 in one unit only. Pure.

use super::error::{RecordingError, cut, short};
use super::info::Conversion;
use super::mapping::{ColumnMap, Foreign};
use super::names::{Target, clean, known_column, target};
use super::propose::proposal;
use super::siblings::Siblings;
use super::stamps::{STAMPS_MAX, parse_date, parse_stamp};
use super::vocabulary::Meaning;
use imu_core::sample::Channel;
use imu_core::units::NANOS_PER_SECOND;
use std::path::Path;

/// The content of a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Column {
    /// Times in a unit of which a nanosecond is the `places`th decimal. The columns of one slot are summed to one stamp.
    Stamp { places: usize, slot: usize },
    /// A channel's values; multiplied by `factor` they are in its unit.
    Value { channel: Channel, factor: f64 },
    /// Nothing that is used.
    Ignored,
}

/// The columns of a table.
#[derive(Debug, Clone, Default)]
pub(super) struct Columns {
    /// The content of each column.
    pub(super) list: Vec<Column>,
    /// Names of those that are not used.
    pub(super) ignored: Vec<String>,
    /// Names of those used that give way to others of their channel, of which there are none.
    pub(super) second: Vec<String>,
    pub(super) conversions: Vec<Conversion>,
    /// The names of the stamps, by slot.
    pub(super) stamps: Vec<String>,
    /// Without stamps: the pairs that would name a column of times whose unit is unknown.
    pub(super) proposed_time: Option<String>,
}

/// The first rows of a table, as text.
pub(super) type FirstRows<'a> = &'a dyn Fn() -> Vec<Vec<String>>;

/// A column that may be used.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Use {
    Channel { channel: Channel, unit: &'static str, factor: f64, rank: u8 },
    Time { places: Option<usize>, stated: bool },
    Part { places: usize, stated: bool },
    Nothing,
}

/// The maximum number of a file's columns in a message, and of characters of each.
const SHOWN: (usize, usize) = (30, 40);

/// The rank of a column that gives way to any other of its channel.
const SECOND_RANK: u8 = 3;

/// The unit of times by the program that wrote the table, known by another of its columns: the name of the time, the
/// beginning or the whole of the other name, the places.
const PROGRAMS: [(&str, &str, usize); 6] = [
    // rostopic echo -p writes nanoseconds, bagpy and PlotJuggler seconds, ulog2csv microseconds.
    ("time", "field.", 0),
    ("field.header.stamp", "field.", 0),
    ("time", "header.stamp.secs", 9),
    ("__time", "__time", 9),
    ("timestamp", "gyro_rad[0]", 3),
    ("timestamp", "accelerometer_m_s2[0]", 3),
];

impl Columns {
    /// Determines the columns from their names. `unnamed`: the names are those of no header, only the map counts.
    ///
    /// # Errors
    /// [`RecordingError`] if a column of the map does not exist, two columns give the same, or no column gives a channel.
    pub(super) fn find(
        names: &[String],
        unnamed: bool,
        map: &ColumnMap,
        file: &Path,
        rows: FirstRows<'_>,
    ) -> Result<Self, RecordingError> {
        let mut mapped_pairs = Vec::new();
        let mut uses = Vec::new();
        let siblings = Siblings::of(names);
        for (index, name) in names.iter().map(|name| clean(name)).enumerate() {
            let mapped = map.of(index + 1, name);
            mapped_pairs.extend(mapped.map(|(pair, _)| pair));
            uses.push(match mapped {
                Some((_, target_name)) => of_user(target_name),
                None if unnamed => Use::Nothing,
                None => of_name(name, &siblings),
            });
        }
        let missing = map.foreign().enumerate().find(|(pair, _)| !mapped_pairs.contains(pair));
        if let Some((_, foreign)) = missing {
            let column = match foreign {
                Foreign::Position(position) => format!("#{position} (it has {} columns)", names.len()),
                Foreign::Name(name) => format!("{:?}", short(name)),
            };
            return Err(RecordingError::NoColumn { file: file.to_owned(), column, found: shown(names) });
        }
        let called = |index: usize| {
            let name = names.get(index).map(|name| clean(name)).unwrap_or_default();
            if unnamed || name.is_empty() { format!("#{}", index + 1) } else { name.to_owned() }
        };
        give_way(&mut uses);
        let mut columns = Self::default();
        columns.take_channels(&uses, file, &called)?;
        if !columns.list.iter().any(|column| matches!(column, Column::Value { .. })) {
            return Err(foreign(names, file, rows));
        }
        columns.take_times(&uses, names, file, &called, rows)?;
        let ignored = columns.list.iter().enumerate().filter(|(_, column)| **column == Column::Ignored);
        columns.ignored = ignored.map(|(index, _)| called(index)).collect();
        Ok(columns)
    }

    fn take_channels(
        &mut self,
        uses: &[Use],
        file: &Path,
        called: &dyn Fn(usize) -> String,
    ) -> Result<(), RecordingError> {
        let mut seen: Vec<(Channel, usize)> = Vec::new();
        for (index, kind) in uses.iter().enumerate() {
            let Use::Channel { channel, unit, factor, rank } = *kind else {
                self.list.push(Column::Ignored);
                continue;
            };
            if let Some((_, first)) = seen.iter().find(|(earlier, _)| *earlier == channel) {
                let (first, second) = (shown_at(*first, called), shown_at(index, called));
                return Err(RecordingError::DuplicateColumn { file: file.to_owned(), first, second, channel });
            }
            seen.push((channel, index));
            self.second.extend((rank == SECOND_RANK).then(|| called(index)));
            if unit != channel.unit() {
                self.conversions.push(Conversion { channel, column: called(index), original_unit: unit, factor });
            }
            self.list.push(Column::Value { channel, factor });
        }
        Ok(())
    }

    fn take_times(
        &mut self,
        uses: &[Use],
        names: &[String],
        file: &Path,
        called: &dyn Fn(usize) -> String,
        rows: FirstRows<'_>,
    ) -> Result<(), RecordingError> {
        let is_stated = |kind: &Use| matches!(kind, Use::Time { stated: true, .. } | Use::Part { stated: true, .. });
        let by_user = uses.iter().any(is_stated);
        let parts: Vec<(usize, usize)> = uses
            .iter()
            .enumerate()
            .filter(|(_, kind)| !by_user || is_stated(kind))
            .filter_map(|(index, kind)| if let Use::Part { places, .. } = kind { Some((*places, index)) } else { None })
            .collect();
        let is_pair = matches!(parts[..], [(one, _), (other, _)] if one.max(other) == 9 && one.min(other) == 0);
        if by_user && !parts.is_empty() && !is_pair {
            let columns = parts.iter().map(|(_, index)| shown_at(*index, called)).collect::<Vec<_>>().join(", ");
            return Err(RecordingError::Parts { file: file.to_owned(), columns });
        }
        let mut part_slot = None;
        let mut first_stated = None;
        let mut unknown = Vec::new();
        for (index, kind) in uses.iter().enumerate().filter(|(_, kind)| !by_user || is_stated(kind)) {
            let name = names.get(index).map(|name| clean(name)).unwrap_or_default();
            let places = match *kind {
                Use::Part { places, .. } if is_pair => {
                    let slot = *part_slot.get_or_insert_with(|| {
                        self.stamps.push(called(index));
                        self.stamps.len() - 1
                    });
                    self.list[index] = Column::Stamp { places, slot };
                    continue;
                }
                Use::Time { places: Some(places), stated } => {
                    let first = if stated || known_time(name) { first_stated.replace(index) } else { None };
                    if let Some(first) = first {
                        let (first, second) = (shown_at(first, called), shown_at(index, called));
                        return Err(RecordingError::DuplicateTime { file: file.to_owned(), first, second });
                    }
                    Some(places)
                }
                Use::Time { places: None, .. } => by_program(name, names).or_else(|| by_values(&rows(), index)),
                _ => continue,
            };
            match places {
                Some(places) if self.stamps.len() < STAMPS_MAX => {
                    self.list[index] = Column::Stamp { places, slot: self.stamps.len() };
                    self.stamps.push(called(index));
                }
                _ => unknown.push(index),
            }
        }
        if self.stamps.is_empty() && !unknown.is_empty() {
            self.proposed_time = super::propose::time(names, &rows(), &unknown);
        }
        Ok(())
    }
}

/// Returns whether the name is that of a column of docs/formats.md.
fn known_time(name: &str) -> bool {
    matches!(target(name), Some(Target::Stamp { .. }))
}

fn of_user(name: &str) -> Use {
    match target(name) {
        Some(Target::Stamp { places }) => Use::Time { places: Some(places), stated: true },
        Some(Target::Part { places }) => Use::Part { places, stated: true },
        Some(Target::Value { channel, unit, factor }) => Use::Channel { channel, unit, factor, rank: 0 },
        None => Use::Nothing,
    }
}

fn of_name(name: &str, siblings: &Siblings) -> Use {
    if let Some((channel, unit, factor)) = known_column(name) {
        return Use::Channel { channel, unit, factor, rank: 1 };
    }
    match siblings.meaning(name) {
        Some(Meaning::Value { channel, unit, factor, second }) => {
            Use::Channel { channel, unit, factor, rank: if second { SECOND_RANK } else { 2 } }
        }
        Some(Meaning::Time { places }) => Use::Time { places, stated: false },
        Some(Meaning::Part { places }) => Use::Part { places, stated: false },
        _ => Use::Nothing,
    }
}

/// Leaves out columns of a channel that another column replaces: one of the channel, or of its triad if the column gives way,
/// so that no triad is of both.
fn give_way(uses: &mut [Use]) {
    let best = |is_same: &dyn Fn(Channel) -> bool, uses: &[Use]| {
        let ranks = uses.iter().filter_map(|kind| match kind {
            Use::Channel { channel, rank, .. } if is_same(*channel) => Some(*rank),
            _ => None,
        });
        ranks.min()
    };
    let all = uses.to_vec();
    for kind in uses {
        let Use::Channel { channel, rank, .. } = *kind else { continue };
        let of_channel = best(&|other| other == channel, &all);
        let in_triad =
            |other: Channel| other == channel || (channel.triad().is_some() && other.triad() == channel.triad());
        // Of equal certainty are the names of docs/formats.md and those of the vocabulary.
        let is_stated = rank > 0 && of_channel == Some(0);
        if is_stated || (rank == SECOND_RANK && best(&in_triad, &all) < Some(SECOND_RANK)) {
            *kind = Use::Nothing;
        }
    }
}

fn by_program(name: &str, names: &[String]) -> Option<usize> {
    let bare = name.trim_start_matches('%');
    let has = |other: &str| {
        names.iter().any(|name| clean(name) == other || (other.ends_with('.') && name.starts_with(other)))
    };
    let found = PROGRAMS.into_iter().find(|(time, other, _)| bare.eq_ignore_ascii_case(time) && has(other));
    found.map(|(.., places)| places)
}

/// Times that state their own unit, by its places: the earliest ones and the longest step between two, s. Seconds,
/// milliseconds and microseconds since 1970 must not be a smaller unit of a clock that has run for days or weeks.
const SINCE_1970: [(usize, i64, f64); 4] =
    [(9, 1_262_304_000, 0.5), (6, 1_262_304_000, 0.5), (3, 1_262_304_000, 0.5), (0, 100_000_000, 60.0)];
/// Seconds since 1970 until the year 2100.
const UNIX_TO_S: i64 = 4_102_444_800;

/// Returns the places of times since 1970 whose values state their unit, or of dates.
fn by_values(rows: &[Vec<String>], column: usize) -> Option<usize> {
    let cells: Vec<&str> = rows.iter().filter_map(|row| row.get(column)).map(String::as_str).collect();
    if !cells.is_empty() && cells.iter().all(|cell| parse_date(cell.as_bytes()).is_some()) {
        return Some(9);
    }
    let second = NANOS_PER_SECOND as i64;
    let fits = |(places, from_s, step_s): &(usize, i64, f64)| {
        let stamps: Vec<i64> = cells.iter().filter_map(|cell| parse_stamp(cell.as_bytes(), *places)).collect();
        let near = |two: &[i64]| (two[1].abs_diff(two[0]) as f64) < step_s * NANOS_PER_SECOND as f64;
        stamps.len() > 1
            && stamps.len() == cells.len()
            && stamps.iter().all(|stamp| (from_s * second..UNIX_TO_S * second).contains(stamp))
            && stamps.windows(2).all(near)
    };
    SINCE_1970.iter().find(|unit| fits(unit)).map(|(places, ..)| *places)
}

/// Returns a column's name as an error shows it: with its position if the name is cut.
fn shown_at(index: usize, called: &dyn Fn(usize) -> String) -> String {
    let name = called(index);
    let short = short(&name);
    if short == name { name } else { format!("#{} {short}", index + 1) }
}

fn shown(cells: &[String]) -> String {
    let mut names: Vec<String> = cells.iter().take(SHOWN.0).map(|name| cut(clean(name), SHOWN.1)).collect();
    if cells.len() > SHOWN.0 {
        names.push(format!("and {} more", cells.len() - SHOWN.0));
    }
    names.join(" | ")
}

/// Returns the error of a table whose columns name no channel, with a proposal.
pub(super) fn foreign(names: &[String], file: &Path, rows: FirstRows<'_>) -> RecordingError {
    RecordingError::ForeignColumns {
        file: file.to_owned(),
        found: shown(names),
        proposal: proposal(names, &rows(), file),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_uptime_of_a_sensor_is_no_time_since_1970() {
        let places = |first: i64, step: i64| {
            let rows: Vec<Vec<String>> = (0..9).map(|row| vec![(first + step * row).to_string()]).collect();
            by_values(&rows, 0)
        };
        // Milliseconds of 28 hours, and of 20 days.
        assert_eq!(places(100_000_000, 10), None);
        assert_eq!(places(1_728_000_000, 10), None);
        assert_eq!(places(1_700_000_000_000, 10), Some(6));
        assert_eq!(places(1_700_000_000_000_000_000, 10_000_000), Some(0));
    }

    #[test]
    fn a_time_of_parts_has_one_of_seconds_and_one_of_nanoseconds() {
        let names = ["a", "b", "gyro_x_rad_s"].map(str::to_owned);
        let find = |pairs: &str| {
            let map = ColumnMap::parse(&[pairs]).unwrap_or_default();
            Columns::find(&names, false, &map, Path::new("table"), &Vec::new)
        };
        assert_eq!(find("a=time_secs,b=time_nsecs").map(|columns| columns.stamps.len()).ok(), Some(1));
        for pairs in ["a=time_secs,b=time_secs", "a=time_nsecs,b=time_nsecs", "a=time_secs"] {
            let error = find(pairs).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains("one column of time_secs and one of time_nsecs"), "{error}");
        }
    }
}
