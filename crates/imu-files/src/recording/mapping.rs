//! The map from the columns of a foreign CSV to known columns: `Time [ms]=time_ms,ax=accel_x_g,#3=gyro_x_dps`.
//!
//! A pair is FOREIGN=NAME. FOREIGN is a header's name, or `#` and a position from 1. NAME is a column of
//! docs/formats.md (section 4) with its unit, or `time_s`, `time_ms`, `time_us`, `time_ns`. Pairs are separated by
//! commas. The last `=` of a pair separates its sides, and a comma that no `=` precedes belongs to the name. A name
//! with a comma behind an `=` must be given by its position. Pure.

use super::error::short;
use super::names::{allowed_names, clean, known_column, target};
use imu_core::sample::Channel;
use std::fmt;

/// The foreign side of a pair.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Foreign {
    /// A column by its position, from 1.
    Position(usize),
    /// A column by its name in the header line.
    Name(String),
}

impl fmt::Display for Foreign {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position(position) => write!(formatter, "#{position}"),
            Self::Name(name) => formatter.write_str(name),
        }
    }
}

/// The meaning of columns whose own names do not state it. Empty: no column is mapped.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ColumnMap {
    /// Sorted, so that the same pairs in another order make the same map.
    pairs: Vec<(Foreign, String)>,
}

/// The reasons why pairs of columns are invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ColumnsError {
    /// A pair without `=`, or with nothing on one side.
    #[error("columns: {pair:?} is no pair FOREIGN=NAME, such as 'ax=accel_x_g' or '#3=time_ms'")]
    NoPair {
        /// The pair.
        pair: String,
    },
    /// The name is none of docs/formats.md.
    #[error(
        "columns: {pair:?}: {name:?} is no column's name; allowed are {}. (A name that has both a comma and a `=` is given \
         by its position: '#3=accel_x_g')",
        allowed_names()
    )]
    UnknownName {
        /// The pair.
        pair: String,
        /// The name in the pair.
        name: String,
    },
    /// The position is invalid.
    #[error("columns: {pair:?}: positions count from #1")]
    NoPosition {
        /// The pair.
        pair: String,
    },
    /// A column is given twice.
    #[error("columns: {foreign:?} is given twice, as {first} and as {second}")]
    Twice {
        /// The column.
        foreign: String,
        /// Its first meaning.
        first: String,
        /// Its second meaning.
        second: String,
    },
}

impl ColumnMap {
    /// Parses texts of pairs; several texts count as one.
    ///
    /// # Errors
    /// [`ColumnsError`] with the pair and the allowed values.
    pub fn parse<T: AsRef<str>>(texts: &[T]) -> Result<Self, ColumnsError> {
        let mut pairs: Vec<(Foreign, String)> = Vec::new();
        for text in texts {
            let mut begun = String::new();
            for piece in text.as_ref().split(',') {
                begun.push_str(piece);
                if piece.contains('=') {
                    pairs.push(pair(begun.trim())?);
                    begun.clear();
                } else {
                    begun.push(',');
                }
            }
            // A trailing comma is allowed.
            let rest = begun.trim_matches(|c: char| c == ',' || c.is_whitespace());
            if !rest.is_empty() {
                return Err(ColumnsError::NoPair { pair: short(rest) });
            }
        }
        pairs.sort();
        pairs.dedup();
        if let Some(twice) = pairs.windows(2).find(|two| two[0].0 == two[1].0) {
            let (foreign, first, second) = (short(&twice[0].0.to_string()), twice[0].1.clone(), twice[1].1.clone());
            return Err(ColumnsError::Twice { foreign, first, second });
        }
        Ok(Self { pairs })
    }

    /// Returns whether the map is empty.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Returns the pairs, each in its written form.
    pub fn pairs(&self) -> impl Iterator<Item = String> + '_ {
        self.pairs.iter().map(|(foreign, name)| format!("{foreign}={name}"))
    }

    /// Returns the meaning of the column with this name at this position, from 1, with the pair's index in the map.
    pub(super) fn of(&self, position: usize, name: &str) -> Option<(usize, &str)> {
        let is = |foreign: &Foreign| match foreign {
            Foreign::Position(at) => *at == position,
            Foreign::Name(known) => known == name,
        };
        // Sorted: a position, which is the most exact, comes first.
        let found = self.pairs.iter().position(|(foreign, _)| is(foreign))?;
        self.pairs.get(found).map(|(_, name)| (found, name.as_str()))
    }

    /// Returns the elements of the array with this path that are named, as `path[2]` or `path.2`: the pair's index in the
    /// map, the place from 0, and the meaning.
    pub(super) fn elements(&self, path: &str) -> impl Iterator<Item = (usize, u32, &str)> {
        self.pairs.iter().enumerate().filter_map(move |(pair, (foreign, name))| {
            let Foreign::Name(foreign) = foreign else { return None };
            let behind = foreign.strip_prefix(path)?;
            let digits = behind.strip_prefix('.').or_else(|| behind.strip_prefix('[')?.strip_suffix(']'))?;
            let digits = Some(digits).filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()))?;
            Some((pair, digits.parse().ok()?, name.as_str()))
        })
    }

    /// Returns the foreign sides.
    pub(super) fn foreign(&self) -> impl Iterator<Item = &Foreign> {
        self.pairs.iter().map(|(foreign, _)| foreign)
    }

    /// Returns whether a pair gives this channel.
    pub(super) fn has(&self, channel: Channel) -> bool {
        self.pairs.iter().any(|(_, name)| known_column(name).is_some_and(|(known, ..)| known == channel))
    }

    /// Returns two columns that give the same channel.
    pub(super) fn twice(&self) -> Option<(String, String, Channel)> {
        let channels = || self.pairs.iter().filter_map(|(foreign, name)| Some((foreign, known_column(name)?.0)));
        channels().enumerate().find_map(|(place, (foreign, channel))| {
            let (first, _) = channels().take(place).find(|(_, earlier)| *earlier == channel)?;
            Some((first.to_string(), foreign.to_string(), channel))
        })
    }

    /// Returns whether all columns are given by position, so that no header line is needed.
    pub(super) fn is_by_position(&self) -> bool {
        !self.is_empty() && self.foreign().all(|foreign| matches!(foreign, Foreign::Position(_)))
    }
}

/// The pairs as one text, which [`ColumnMap::parse`] parses to the same map.
impl fmt::Display for ColumnMap {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.pairs().collect::<Vec<_>>().join(","))
    }
}

fn pair(text: &str) -> Result<(Foreign, String), ColumnsError> {
    let no_pair = || ColumnsError::NoPair { pair: short(text) };
    let (foreign, name) = text.rsplit_once('=').ok_or_else(no_pair)?;
    let (foreign, name) = (clean(foreign), name.trim());
    if foreign.is_empty() || name.is_empty() {
        return Err(no_pair());
    }
    if target(name).is_none() {
        return Err(ColumnsError::UnknownName { pair: short(text), name: short(name) });
    }
    let digits = foreign.strip_prefix('#').filter(|digits| !digits.is_empty());
    let foreign = match digits.filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit())) {
        Some(digits) => match digits.parse() {
            Ok(position) if position > 0 => Foreign::Position(position),
            _ => return Err(ColumnsError::NoPosition { pair: short(text) }),
        },
        None => Foreign::Name(foreign.to_owned()),
    };
    Ok((foreign, name.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pairs(texts: &[&str]) -> Vec<(String, String)> {
        let map = ColumnMap::parse(texts).unwrap();
        map.pairs.iter().map(|(foreign, name)| (foreign.to_string(), name.clone())).collect()
    }

    #[test]
    fn pairs_are_split_at_commas_and_at_the_last_equals_sign() {
        let of = |foreign: &str, name: &str| (foreign.to_owned(), name.to_owned());
        assert_eq!(
            pairs(&["Time [ms]=time_ms,ax=accel_x_g, GyroX(dps) = gyro_x_dps"]),
            [of("GyroX(dps)", "gyro_x_dps"), of("Time [ms]", "time_ms"), of("ax", "accel_x_g")]
        );
        // A name with a comma, one with an equals sign; several options count as one; a trailing comma does no harm.
        assert_eq!(
            pairs(&["Time, ms=time_ms,a=b=gyro_x_dps,", "#12=accel_z_m_s2"]),
            [of("#12", "accel_z_m_s2"), of("Time, ms", "time_ms"), of("a=b", "gyro_x_dps")]
        );
        assert_eq!(pairs(&["#x=mag_x_ut"]), [of("#x", "mag_x_ut")]);
        assert_eq!(ColumnMap::parse(&["a=time_s,b=gyro_x_dps"]), ColumnMap::parse(&["b=gyro_x_dps", "a=time_s"]));
        assert_eq!(ColumnMap::parse(&["a=time_s,a=time_s"]).unwrap().pairs.len(), 1);
    }

    #[test]
    fn what_cannot_be_meant_is_refused_with_the_pair_and_what_is_allowed() {
        for (text, words) in [
            ("ax", ["\"ax\"", "FOREIGN=NAME"]),
            ("=accel_x_g", ["\"=accel_x_g\"", "FOREIGN=NAME"]),
            ("ax=accel_x", ["\"accel_x\" is no column's name", "accel_{x,y,z}_{m_s2,g,mg,ug,counts}"]),
            ("t=time,ax=accel_x_g", ["\"time\"", "time_{s,ms,us,ns}"]),
            ("ax=accel_x_g,t", ["\"t\"", "FOREIGN=NAME"]),
            ("#0=accel_x_g", ["#0", "count from #1"]),
            ("#99999999999999999999=accel_x_g", ["#9", "count from #1"]),
            ("a=accel_x_g,a=accel_y_g", ["\"a\" is given twice", "accel_x_g and as accel_y_g"]),
        ] {
            let error = ColumnMap::parse(&[text]).unwrap_err().to_string();
            assert!(words.iter().all(|word| error.contains(word)), "{text}: {error}");
        }
    }

    #[test]
    fn an_error_shows_the_beginning_of_a_pair_that_is_long() {
        let long = "é\0".repeat(20_000);
        for text in [
            long.clone(),
            format!("{long}="),
            format!("ax={long}"),
            format!("#{}=time_s", "9".repeat(40_000)),
            format!("{long}=accel_x_g,{long}=accel_y_g"),
        ] {
            let error = ColumnMap::parse(&[text.as_str()]).unwrap_err().to_string();
            assert!(error.contains('…') && error.len() < 2_000, "{} bytes", error.len());
        }
    }

    proptest! {
        #[test]
        fn what_a_map_is_written_as_is_the_same_map(
            names in prop::collection::btree_set("[ a-z,()]{0,6}[a-z=#0-9]{1,6}", 0..5)
        ) {
            let targets = ["time_us", "accel_x_g", "gyro_z_deg_s", "mag_x_ut", "temperature_c"];
            let texts: Vec<_> = names.iter().zip(targets).map(|(name, target)| format!("{name}={target}")).collect();
            if let Ok(map) = ColumnMap::parse(&texts) {
                prop_assert_eq!(&ColumnMap::parse(&[map.to_string()]).unwrap(), &map);
            }
        }
    }
}
