//! Proposals: a line of `--columns` for a table whose columns do not state their channels with units.
//!
//! Names give quantities and axes; units and what has no name follow from the first rows: a steady |a| is gravity, |m| is the
//! Earth's field, times increase. A proposal is printed, never applied: nothing but the user can know a unit. Pure.

use super::error::short;
use super::names::{allowed_names, clean, suffixes};
use super::siblings::Siblings;
use super::vocabulary::{Meaning, meaning};
use imu_core::sample::{Channel, Triad};
use imu_core::units::STANDARD_GRAVITY_M_S2;
use std::ops::Range;
use std::path::Path;

/// Rates that a time's unit may give, Hz; the middle is the likeliest.
const RATES_HZ: Range<f64> = 0.5..20_000.0;
const RATE_USUAL_HZ: f64 = 100.0;
/// The range of |a| at rest over gravity, and of |m|, gauss.
const GRAVITY: Range<f64> = 0.85..1.15;
const FIELD_GAUSS: Range<f64> = 0.2..0.7;
/// A gyro in rad/s has no value above this.
const RAD_S_MOST: f64 = 40.0;
/// The columns of KITTI's `oxts/data`, from 1 (its dataformat.txt): angles, acceleration in x, y, z, rates around x, y, z.
const OXTS: [(usize, &str); 9] = [
    (4, "roll_rad"),
    (5, "pitch_rad"),
    (6, "yaw_rad"),
    (12, "accel_x_m_s2"),
    (13, "accel_y_m_s2"),
    (14, "accel_z_m_s2"),
    (18, "gyro_x_rad_s"),
    (19, "gyro_y_rad_s"),
    (20, "gyro_z_rad_s"),
];
/// The number of columns of KITTI's `oxts/data`.
pub(super) const OXTS_COLUMNS: usize = 30;

/// Returns the pairs for KITTI's columns, shifted by the columns before them.
pub(super) fn of_oxts(before: usize) -> Vec<String> {
    OXTS.iter().map(|(position, name)| format!("#{}={name}", position + before)).collect()
}

/// A table with its columns as numbers.
struct Table<'a> {
    names: &'a [String],
    columns: Vec<Vec<f64>>,
    numbered: bool,
}

impl<'a> Table<'a> {
    fn of(names: &'a [String], rows: &[Vec<String>]) -> Self {
        let number = |cell: Option<&String>| {
            let cell = cell.map(String::as_str).unwrap_or_default();
            cell.parse::<f64>().or_else(|_| cell.replacen(',', ".", 1).parse()).unwrap_or(f64::NAN)
        };
        let columns = (0..names.len()).map(|index| rows.iter().map(|row| number(row.get(index))).collect()).collect();
        Self { names, columns, numbered: names.iter().all(|name| clean(name).parse::<f64>().is_ok()) }
    }

    fn foreign(&self, index: usize) -> String {
        let name = clean(&self.names[index]);
        let same = self.names.iter().filter(|other| clean(other) == name).count();
        let is_pair = !name.is_empty() && !name.contains([',', '=', '\'', '#']) && short(name) == name;
        if self.numbered || !is_pair || same > 1 { format!("#{}", index + 1) } else { name.to_owned() }
    }

    /// Returns the pair for a column of times; `None` if it does not increase.
    fn time(&self, index: usize) -> Option<String> {
        let stamps = self.columns.get(index)?;
        let mut steps: Vec<f64> = stamps.windows(2).map(|two| two[1] - two[0]).collect();
        if steps.is_empty() || steps.iter().any(|step| step.is_nan() || *step < 0.0) {
            return None;
        }
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        steps.sort_by(f64::total_cmp);
        // A first stretch of equal stamps does not determine the step.
        let likely = |per_s: f64| {
            let rate_hz = per_s / mean;
            RATES_HZ.contains(&rate_hz).then(|| (rate_hz / RATE_USUAL_HZ).ln().abs())
        };
        let units = [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)];
        let found = units.into_iter().filter_map(|(unit, per_s)| Some((unit, likely(per_s)?)));
        let (unit, _) = found.min_by(|one, other| one.1.total_cmp(&other.1))?;
        Some(format!("{}=time_{unit}", self.foreign(index)))
    }

    /// Returns the median length of the vectors of three columns, and its spread (half of the range of the middle half,
    /// relative).
    fn length(&self, columns: [usize; 3]) -> Option<(f64, f64)> {
        let rows = self.columns.first()?.len();
        let mut lengths: Vec<f64> = (0..rows)
            .map(|row| columns.iter().map(|column| self.columns[*column][row].powi(2)).sum::<f64>().sqrt())
            .filter(|length| length.is_finite())
            .collect();
        lengths.sort_by(f64::total_cmp);
        let at = |share: f64| lengths.get((share * (lengths.len() as f64 - 1.0)) as usize).copied();
        let median = at(0.5)?;
        Some((median, 0.5 * (at(0.75)? - at(0.25)?) / median))
    }

    /// Returns the suffix of the unit in which these three columns fit the quantity.
    fn fitting(&self, triad: Triad, columns: [usize; 3]) -> Option<&'static str> {
        let (length, spread) = self.length(columns)?;
        let fits = |factor: f64| match triad {
            Triad::Accel => GRAVITY.contains(&(length * factor / STANDARD_GRAVITY_M_S2)),
            Triad::Mag => FIELD_GAUSS.contains(&(length * factor)),
            _ => false,
        };
        let [first, ..] = triad.channels();
        let found = suffixes(first).iter().find(|(.., factor)| fits(*factor) && spread < 0.2);
        found.map(|(suffix, ..)| *suffix)
    }

    fn suffix(&self, triad: Triad, columns: [usize; 3]) -> &'static str {
        let most = || {
            columns.iter().flat_map(|column| &self.columns[*column]).fold(0.0, |most: f64, value| most.max(value.abs()))
        };
        match triad {
            Triad::Gyro => {
                if most() > RAD_S_MOST {
                    "_deg_s"
                } else {
                    "_rad_s"
                }
            }
            Triad::Attitude => "_deg",
            Triad::Accel => self.fitting(triad, columns).unwrap_or("_m_s2"),
            Triad::Mag => self.fitting(triad, columns).unwrap_or("_gauss"),
        }
    }

    fn pairs(&self, triad: Triad, columns: [usize; 3]) -> Vec<String> {
        let suffix = self.suffix(triad, columns);
        let pair = |(column, channel): (usize, Channel)| format!("{}={}{suffix}", self.foreign(column), channel.name());
        columns.into_iter().zip(triad.channels()).map(pair).collect()
    }

    /// Returns the pairs for a table without names: columns of times, then triads.
    fn numbered(&self) -> Vec<String> {
        let time = (0..self.names.len()).find_map(|index| Some((index, self.time(index)?)));
        let first = time.as_ref().map_or(0, |(index, _)| index + 1);
        if self.names.len() - first == OXTS_COLUMNS {
            return time.map(|(_, pair)| pair).into_iter().chain(of_oxts(first)).collect();
        }
        let mut triples: Vec<[usize; 3]> = (first..self.names.len())
            .step_by(3)
            .map(|at| [at, at + 1, at + 2])
            .filter(|three| three[2] < self.names.len())
            .collect();
        let mut pairs: Vec<String> = time.map(|(_, pair)| pair).into_iter().collect();
        let mut found = Vec::new();
        let accel = triples.iter().position(|three| self.fitting(Triad::Accel, *three).is_some());
        if let Some(place) = accel {
            found.push((Triad::Accel, triples.remove(place)));
            // The quieter one of the others is the gyro: a field has a length.
            triples.truncate(2);
            triples.sort_by(|one, other| {
                let size = |three: &[usize; 3]| self.length(*three).map_or(f64::INFINITY, |(length, _)| length);
                size(one).total_cmp(&size(other))
            });
            found.extend(triples.into_iter().zip([Triad::Gyro, Triad::Mag]).map(|(three, triad)| (triad, three)));
        }
        found.sort_by_key(|(_, three)| three[0]);
        pairs.extend(found.into_iter().flat_map(|(triad, three)| self.pairs(triad, three)));
        pairs
    }

    /// Returns the pairs for a table whose names state quantities without units.
    fn named(&self, file: &Path) -> Vec<String> {
        let siblings = Siblings::of(self.names);
        let meanings: Vec<Option<Meaning>> = self.names.iter().map(|name| siblings.meaning(clean(name))).collect();
        let place = |wanted: Meaning| meanings.iter().position(|found| *found == Some(wanted));
        let times = (0..meanings.len()).filter(|index| matches!(meanings[*index], Some(Meaning::Time { .. })));
        let mut pairs: Vec<String> = times.filter_map(|index| self.time(index)).take(1).collect();
        for triad in [Triad::Gyro, Triad::Accel, Triad::Mag] {
            let places = triad.channels().map(|channel| place(Meaning::Unitless { channel }));
            if let [Some(x), Some(y), Some(z)] = places {
                pairs.extend(self.pairs(triad, [x, y, z]));
            } else {
                let given =
                    places.into_iter().zip(triad.channels()).filter_map(|(place, channel)| Some((place?, channel)));
                pairs.extend(given.map(|(place, channel)| {
                    format!("{}={}{}", self.foreign(place), channel.name(), self.suffix(triad, [place; 3]))
                }));
            }
        }
        if let [Some(x), Some(y), Some(z)] = [0, 1, 2].map(|axis| place(Meaning::Axis(axis))) {
            let by_gravity = self.fitting(Triad::Accel, [x, y, z]).map(|_| Triad::Accel);
            if let Some(triad) = of_file(file).or(by_gravity) {
                pairs.extend(self.pairs(triad, [x, y, z]));
            }
        }
        for channel in [Channel::Temperature, Channel::Pressure] {
            let given = place(Meaning::Unitless { channel });
            pairs.extend(
                given.map(|place| format!("{}={}{}", self.foreign(place), channel.name(), suffixes(channel)[0].0)),
            );
        }
        pairs
    }
}

/// Returns the quantity that a file's name states, for a proposal: Sensor Logger writes one file for each.
fn of_file(file: &Path) -> Option<Triad> {
    let stem = file.file_name()?.to_str()?.split('.').next()?.to_owned();
    match meaning(&format!("{stem} x")) {
        Some(Meaning::Unitless { channel }) => channel.triad(),
        _ => None,
    }
}

/// Returns the pairs for the columns of times among `unknown`.
pub(super) fn time(names: &[String], rows: &[Vec<String>], unknown: &[usize]) -> Option<String> {
    let table = Table::of(names, rows);
    let first = unknown.first()?;
    unknown.iter().find_map(|index| table.time(*index)).or_else(|| Some(format!("{}=time_s", table.foreign(*first))))
}

/// Returns the end of the message about a table whose columns name no channel: a guess to paste and what it rests on, or
/// how to name the columns.
pub(super) fn proposal(names: &[String], rows: &[Vec<String>], file: &Path) -> String {
    let table = Table::of(names, rows);
    let pairs = if table.numbered { table.numbered() } else { table.named(file) };
    let states = |pair: &&String| !pair.contains("=time_");
    if !pairs.iter().any(|pair| states(&pair)) {
        return format!("say which is which with --columns 'FOREIGN=NAME,…'; names are {}", allowed_names());
    }
    let missing = if table.numbered { "no name and no unit stands in the file" } else { "no unit stands in the file" };
    let rate = if pairs.iter().any(|pair| !states(&pair)) { "" } else { " --rate HZ" };
    format!("{missing}, so check this guess and paste it: --columns '{}'{rate}", pairs.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(row: &str) -> Vec<String> {
        row.split(',').map(str::to_owned).collect()
    }

    fn of(header: &str, rows: &[&str], file: &str) -> String {
        proposal(&split(header), &rows.iter().map(|row| split(row)).collect::<Vec<_>>(), Path::new(file))
    }

    #[test]
    fn a_proposal_has_the_quantities_of_names_and_the_units_of_values() {
        let rows = ["0,10,0.1,-9.7,0.2,0.3", "10,20,0.1,-9.8,0.2,0.1", "20,30,0.1,-9.7,0.2,0.2"];
        assert_eq!(
            of("t,seq,accX,accZ,accY,gyroX", &rows, "a.csv"),
            "no unit stands in the file, so check this guess and paste it: --columns \
             't=time_ms,gyroX=gyro_x_rad_s,accX=accel_x_m_s2,accY=accel_y_m_s2,accZ=accel_z_m_s2'"
        );
        // Sensor Logger: the file's name states the quantity, for the proposal alone.
        let rows = ["1700000000000000000,0.0,1,2,3", "1700000000010000000,0.01,1,2,3"];
        let found = of("time,seconds_elapsed,z,y,x", &rows, "Gyroscope.csv");
        assert!(found.ends_with("--columns 'time=time_ns,x=gyro_x_rad_s,y=gyro_y_rad_s,z=gyro_z_rad_s'"), "{found}");
        assert!(of("a,b", &["1,2"], "a.csv").contains("FOREIGN=NAME"));
    }

    #[test]
    fn a_table_without_names_gets_positions() {
        let rows = ["10000,0.02,0.03,-0.98,1,-2,90", "20000,0.01,0.02,-1.01,1,-2,91", "30000,0.01,0.02,-1.0,1,-2,91"];
        let found = of("0,0.01,0.02,-0.99,1,-2,90", &rows, "a.txt");
        let expected = "--columns '#1=time_us,#2=accel_x_g,#3=accel_y_g,#4=accel_z_g,#5=gyro_x_deg_s,#6=gyro_y_deg_s,#7=gyro_z_deg_s'";
        assert!(found.ends_with(expected), "{found}");
    }
}
