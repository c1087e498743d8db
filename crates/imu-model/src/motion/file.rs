//! Files: motions as CSV (docs/formats.md), read row by row and written row by row.
//!
//! A motion has `time_s`, `ref_gyro_{x,y,z}_rad_s`, `ref_accel_{x,y,z}_m_s2` (specific force in the sensor's axes) and,
//! if known, `temperature_c`, in any order of columns; other columns are ignored. Refused, with the file, the line and
//! the values allowed: a missing column, a cell that is not a number, rows at another rate than requested, and gaps.
//! Memory does not grow with the file.

use crate::simulator::Motion;
use std::io::{Read, Write};

/// The columns that a motion must have, in the order they are written.
const COLUMNS: [&str; 7] = [
    "time_s",
    "ref_gyro_x_rad_s",
    "ref_gyro_y_rad_s",
    "ref_gyro_z_rad_s",
    "ref_accel_x_m_s2",
    "ref_accel_y_m_s2",
    "ref_accel_z_m_s2",
];
/// The optional column.
const TEMPERATURE: &str = "temperature_c";
/// How far a file's rate may differ from the rate that it stands for: its stamps come from another clock.
const RATE_TOLERANCE: f64 = 1e-3;
/// How far a step may differ from the period, in periods: from one and a half on, a row is missing (docs/formats.md).
const STRAY_PERIODS: f64 = 0.5;
/// Number of rows that determine the rate. Stamps are often rounded to a millisecond, so that one step alone does not
/// determine it.
const RATE_ROWS: usize = 1000;

/// The reasons why a motion was refused.
#[derive(Debug, thiserror::Error)]
pub enum MotionError {
    /// The file could not be read, or is not CSV.
    #[error("{file}: {source}")]
    Csv {
        /// The file.
        file: String,
        /// The reader's error, with the line.
        source: csv::Error,
    },
    /// A column is missing or occurs twice.
    #[error("{file}, line 1: {found} column `{column}`; a motion has once each {}, and `temperature_c` if it is known", COLUMNS.join(", "))]
    Column {
        /// The file.
        file: String,
        /// The column.
        column: &'static str,
        /// `no` or `more than one`.
        found: &'static str,
    },
    /// A cell is not a finite number.
    #[error("{file}, line {line}, column `{column}`: found `{found}`; expected a finite number")]
    Cell {
        /// The file.
        file: String,
        /// The line; the header is line 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// The value that was found.
        found: String,
    },
    /// A row is not one period after the one before.
    #[error(
        "{file}, line {line}: {step_s:.6} s after the row before; a motion at {} Hz has a row every {period_s:.6} s and no gaps",
        rounded(*rate_hz)
    )]
    Step {
        /// The file.
        file: String,
        /// The line.
        line: u64,
        /// Time from the row before to this one, s.
        step_s: f64,
        /// The rate that was expected, Hz.
        rate_hz: f64,
        /// The period of that rate, s.
        period_s: f64,
    },
    /// The rate of a motion is neither the sensor's own nor that of its output.
    #[error("{file} has {} rows per second; a motion for this simulation has {}", rounded(*found_hz), allowed(*output_hz, *internal_hz))]
    Rate {
        /// The file.
        file: String,
        /// The motion's rows per second.
        found_hz: f64,
        /// The output's rate, Hz.
        output_hz: f64,
        /// The sensor's own rate, Hz.
        internal_hz: f64,
    },
    /// A table of temperatures lacks a column.
    #[error("{file}, line 1: no column `{column}`; a course of temperature has time_s and temperature_c")]
    TemperatureColumn {
        /// The file.
        file: String,
        /// The column.
        column: &'static str,
    },
    /// Times do not increase.
    #[error("{file}, line {line}: {time_s} s; each row has to be later than the one before")]
    Backwards {
        /// The file.
        file: String,
        /// The line.
        line: u64,
        /// The time in that line.
        time_s: f64,
    },
    /// A single row has no rate.
    #[error("{file} has a single row; a motion has two or more, a period apart")]
    Single {
        /// The file.
        file: String,
    },
    /// There are no rows.
    #[error("{file} has no row below its header")]
    Empty {
        /// The file.
        file: String,
    },
}

/// Rounds a rate for display: that of a file comes from its stamps, with their rounding.
fn rounded(rate_hz: f64) -> f64 {
    format!("{rate_hz:.6}").parse().unwrap_or(rate_hz)
}

fn allowed(output_hz: f64, internal_hz: f64) -> String {
    if output_hz == internal_hz {
        format!("{output_hz}, the rate of its output")
    } else {
        format!("{output_hz} (its output's rate) or {internal_hz} (the sensor's own)")
    }
}

/// The rows of a motion at a rate, in order.
pub struct Rows<R> {
    file: String,
    records: csv::StringRecordsIntoIter<R>,
    /// The column number of each of [`COLUMNS`].
    places: [usize; COLUMNS.len()],
    temperature: Option<usize>,
    /// The expected rate; `None` before it is known.
    rate_hz: Option<f64>,
    last_s: Option<f64>,
    failed: bool,
}

impl<R> std::fmt::Debug for Rows<R> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Rows").field("file", &self.file).field("rate_hz", &self.rate_hz).finish_non_exhaustive()
    }
}

impl<R: Read> Rows<R> {
    /// Reads the header; `file` names the text in messages. Rows are expected at `rate_hz`, or at any times if it is
    /// `None`.
    ///
    /// # Errors
    /// [`MotionError::Csv`] and [`MotionError::Column`].
    pub fn new(text: R, file: &str, rate_hz: Option<f64>) -> Result<Self, MotionError> {
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text);
        let unreadable = |source| MotionError::Csv { file: file.to_owned(), source };
        let header = reader.headers().map_err(unreadable)?;
        let places_of = |name: &str| -> Vec<usize> {
            let clean = |found: &str| found.trim_start_matches('\u{FEFF}') == name;
            header.iter().enumerate().filter(|(_, found)| clean(found)).map(|(place, _)| place).collect()
        };
        let refuse = |column, found| MotionError::Column { file: file.to_owned(), column, found };
        let mut places = [0; COLUMNS.len()];
        for (place, column) in places.iter_mut().zip(COLUMNS) {
            *place = match places_of(column).as_slice() {
                [one] => *one,
                [] => return Err(refuse(column, "no")),
                _ => return Err(refuse(column, "more than one")),
            };
        }
        let temperature = match places_of(TEMPERATURE).as_slice() {
            [] => None,
            [one] => Some(*one),
            _ => return Err(refuse(TEMPERATURE, "more than one")),
        };
        let records = reader.into_records();
        Ok(Self { file: file.to_owned(), records, places, temperature, rate_hz, last_s: None, failed: false })
    }

    /// Reads all rows and returns their number and their rate.
    ///
    /// # Errors
    /// The errors of any row; [`MotionError::Empty`] and [`MotionError::Single`].
    pub fn survey(mut self) -> Result<Survey, MotionError> {
        let (mut rows, mut first_s) = (0, None);
        for row in &mut self {
            let (time_s, _) = row?;
            first_s.get_or_insert(time_s);
            rows += 1;
        }
        let (Some(first_s), Some(last_s)) = (first_s, self.last_s) else {
            return Err(MotionError::Empty { file: self.file });
        };
        if rows < 2 {
            return Err(MotionError::Single { file: self.file });
        }
        // Over the whole file: single steps have the stamps' rounding.
        let rate_hz = (rows - 1) as f64 / (last_s - first_s);
        Ok(Survey { rows, rate_hz, has_temperature: self.temperature.is_some() })
    }

    fn cell(&self, record: &csv::StringRecord, place: usize, column: &'static str) -> Result<f64, MotionError> {
        let text = record.get(place).unwrap_or_default();
        text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| MotionError::Cell {
            file: self.file.clone(),
            line: line(record),
            column,
            found: text.chars().take(40).collect(),
        })
    }

    fn understand(&mut self, record: &csv::StringRecord) -> Result<(f64, Motion), MotionError> {
        let mut values = [0.0; COLUMNS.len()];
        for ((value, place), column) in values.iter_mut().zip(self.places).zip(COLUMNS) {
            *value = self.cell(record, place, column)?;
        }
        let [time_s, gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z] = values;
        let temperature_c = match self.temperature {
            // Thermometers are often read less often than the rest.
            Some(place) if record.get(place).is_some_and(|cell| !cell.is_empty()) => {
                Some(self.cell(record, place, TEMPERATURE)?)
            }
            _ => None,
        };
        if self.rate_hz.is_none() && self.last_s.is_some_and(|last_s| time_s <= last_s) {
            return Err(MotionError::Backwards { file: self.file.clone(), line: line(record), time_s });
        }
        if let Some((last_s, rate_hz)) = self.last_s.zip(self.rate_hz) {
            let step_s = time_s - last_s;
            if (step_s * rate_hz - 1.0).abs() >= STRAY_PERIODS {
                let (file, line) = (self.file.clone(), line(record));
                return Err(MotionError::Step { file, line, step_s, rate_hz, period_s: 1.0 / rate_hz });
            }
        }
        self.last_s = Some(time_s);
        let (gyro_rad_s, accel_m_s2) = ([gyro_x, gyro_y, gyro_z], [accel_x, accel_y, accel_z]);
        Ok((time_s, Motion { gyro_rad_s, accel_m_s2, temperature_c }))
    }
}

/// Returns the rate of a text's first rows, Hz: the mean of those steps that are about as long as most. `None` with
/// fewer than two rows.
///
/// # Errors
/// The errors of any of these rows.
pub fn rate_of(text: impl Read, file: &str) -> Result<Option<f64>, MotionError> {
    let mut times = Vec::new();
    for row in Rows::new(text, file, None)?.take(RATE_ROWS + 1) {
        times.push(row?.0);
    }
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let Some(usual) = steps.get(steps.len() / 2).copied().filter(|usual| *usual > 0.0) else { return Ok(None) };
    let like = |step: &&f64| (**step / usual - 1.0).abs() < STRAY_PERIODS;
    let (count, sum) = steps.iter().filter(like).fold((0.0, 0.0), |(count, sum), step| (count + 1.0, sum + step));
    Ok(Some(count / sum))
}

/// Returns the number of samples at the sensor's own rate that a row of the file stands for.
pub fn samples_per_row(file: &str, found_hz: f64, output_hz: f64, internal_hz: f64) -> Result<u32, MotionError> {
    let is = |rate_hz: f64| (found_hz / rate_hz - 1.0).abs() < RATE_TOLERANCE;
    if is(internal_hz) {
        return Ok(1);
    }
    if is(output_hz) {
        return Ok((internal_hz / output_hz).round().max(1.0) as u32);
    }
    Err(MotionError::Rate { file: file.to_owned(), found_hz, output_hz, internal_hz })
}

impl<R: Read> Iterator for Rows<R> {
    type Item = Result<(f64, Motion), MotionError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let row = match self.records.next()? {
            Ok(record) => self.understand(&record),
            Err(source) => Err(MotionError::Csv { file: self.file.clone(), source }),
        };
        self.failed = row.is_err();
        Some(row)
    }
}

/// The contents of a motion's file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Survey {
    /// Number of rows.
    pub rows: u64,
    /// Rows per second.
    pub rate_hz: f64,
    /// Whether there is a column for the temperature.
    pub has_temperature: bool,
}

fn line(record: &csv::StringRecord) -> u64 {
    record.position().map_or(0, csv::Position::line)
}

/// Converts motions to a `ratio` times higher rate, by linear interpolation. The last motion holds for a period.
pub fn between(motions: impl Iterator<Item = Motion> + Send, ratio: u32) -> impl Iterator<Item = Motion> + Send {
    let mut motions = motions.peekable();
    std::iter::from_fn(move || {
        let from = motions.next()?;
        let to = motions.peek().copied().unwrap_or(from);
        Some((0..ratio).map(move |step| blend(from, to, f64::from(step) / f64::from(ratio))))
    })
    .flatten()
}

fn blend(from: Motion, to: Motion, share: f64) -> Motion {
    let axes = |from: [f64; 3], to: [f64; 3]| std::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis]));
    let temperature = from.temperature_c.zip(to.temperature_c).map(|(from, to)| from + share * (to - from));
    Motion {
        gyro_rad_s: axes(from.gyro_rad_s, to.gyro_rad_s),
        accel_m_s2: axes(from.accel_m_s2, to.accel_m_s2),
        temperature_c: temperature.or(from.temperature_c),
    }
}

/// Writes a motion, row by row.
pub struct Writer<W: Write> {
    to: W,
    has_temperature: bool,
}

impl<W: Write> std::fmt::Debug for Writer<W> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Writer").field("has_temperature", &self.has_temperature).finish_non_exhaustive()
    }
}

impl<W: Write> Writer<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// The error of the underlying writer.
    pub fn new(mut to: W, has_temperature: bool) -> std::io::Result<Self> {
        write!(to, "{}", COLUMNS.join(","))?;
        writeln!(to, "{}", if has_temperature { ",temperature_c" } else { "" })?;
        Ok(Self { to, has_temperature })
    }

    /// Writes a row; `{}` of an f64 is the shortest text that reads back as the same number.
    ///
    /// # Errors
    /// The error of the underlying writer.
    pub fn row(&mut self, time_s: f64, motion: &Motion) -> std::io::Result<()> {
        write!(self.to, "{time_s}")?;
        for value in motion.gyro_rad_s.iter().chain(&motion.accel_m_s2) {
            write!(self.to, ",{value}")?;
        }
        if self.has_temperature {
            match motion.temperature_c {
                Some(temperature_c) => write!(self.to, ",{temperature_c}")?,
                None => write!(self.to, ",")?,
            }
        }
        writeln!(self.to)
    }

    /// Flushes the written rows to the file.
    ///
    /// # Errors
    /// The error of the underlying writer.
    pub fn finish(mut self) -> std::io::Result<()> {
        self.to.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "time_s,ref_gyro_x_rad_s,ref_gyro_y_rad_s,ref_gyro_z_rad_s,ref_accel_x_m_s2,ref_accel_y_m_s2,\
                          ref_accel_z_m_s2";

    fn read(text: &str, rate_hz: Option<f64>) -> Result<Vec<(f64, Motion)>, MotionError> {
        Rows::new(text.as_bytes(), "table.csv", rate_hz)?.collect()
    }

    fn rows(count: usize, step_s: f64) -> String {
        let row = |index: usize| format!("{:.4},0.{index},0,0,0,0,-9.8\n", 5.0 + index as f64 * step_s);
        format!("{HEADER}\n{}", (0..count).map(row).collect::<String>())
    }

    #[test]
    fn what_is_written_is_read_back() {
        let motion = |index: u32| Motion {
            gyro_rad_s: [0.1 * f64::from(index), -1e-7, 3.0],
            accel_m_s2: [0.0, 1.0 / 3.0, -9.806_65],
            temperature_c: index.is_multiple_of(2).then_some(20.5),
        };
        for has_temperature in [true, false] {
            let mut text = Vec::new();
            let mut writer = Writer::new(&mut text, has_temperature).unwrap();
            for index in 0..9 {
                writer.row(f64::from(index) / 40.0, &motion(index)).unwrap();
            }
            writer.finish().unwrap();
            let text = String::from_utf8(text).unwrap();
            let survey = Rows::new(text.as_bytes(), "m", None).unwrap().survey().unwrap();
            assert_eq!((survey.rows, survey.has_temperature), (9, has_temperature));
            assert!((survey.rate_hz - 40.0).abs() < 1e-9);
            for (index, (time_s, found)) in (0..).zip(read(&text, Some(40.0)).unwrap()) {
                let expected = motion(index);
                let temperature_c = expected.temperature_c.filter(|_| has_temperature);
                assert_eq!((time_s, found), (f64::from(index) / 40.0, Motion { temperature_c, ..expected }));
            }
        }
    }

    #[test]
    fn columns_may_stand_in_any_order_beside_others() {
        let text = "note,ref_accel_z_m_s2,ref_accel_y_m_s2,ref_accel_x_m_s2,ref_gyro_z_rad_s,ref_gyro_y_rad_s,ref_gyro_x_rad_s,\
                    time_s\nlevel, -9.8 ,2,1,0.3,0.2,0.1,7\n";
        let found = read(text, None).unwrap();
        let expected = Motion { gyro_rad_s: [0.1, 0.2, 0.3], accel_m_s2: [1.0, 2.0, -9.8], temperature_c: None };
        assert_eq!(found, [(7.0, expected)]);
    }

    #[test]
    fn what_is_wrong_is_refused_with_file_line_and_what_is_allowed() {
        let gap = rows(5, 0.025) + "5.2000,0,0,0,0,0,-9.8\n";
        for (text, rate_hz, parts) in [
            (HEADER.replace("ref_gyro_y_rad_s", "gyro_y"), None, ["line 1", "no column `ref_gyro_y_rad_s`", "time_s"]),
            (format!("{HEADER},time_s"), None, ["line 1", "more than one column `time_s`", "ref_accel_z_m_s2"]),
            (rows(2, 0.025) + "5.05,a,0,0,0,0,0\n", None, ["line 4", "`ref_gyro_x_rad_s`", "found `a`"]),
            (rows(2, 0.025) + "5.05,nan,0,0,0,0,0\n", None, ["line 4", "`ref_gyro_x_rad_s`", "finite number"]),
            (rows(2, 0.025) + "5.05,0,0\n", None, ["line: 4", "3 fields", "7"]),
            (gap, Some(40.0), ["line 7", "0.1", "no gaps"]),
            (rows(3, 0.01), Some(40.0), ["line 3", "0.01", "a motion at 40 Hz has a row every 0.025000 s"]),
            (rows(3, 0.0), Some(40.0), ["line 3", "0 s after", "40 Hz"]),
            (rows(3, 0.0376), Some(40.0), ["line 3", "0.0376", "no gaps"]),
            (rows(3, -0.025), None, ["line 3", "4.975 s", "later than the one before"]),
            (rows(3, 0.1), Some(40.000_000_000_000_01), ["line 3", "0.1", "a motion at 40 Hz"]),
        ] {
            let message = read(&text, rate_hz).unwrap_err().to_string();
            for part in ["table.csv"].into_iter().chain(parts) {
                assert!(message.contains(part), "{part:?} is not in {message:?}");
            }
        }
        let empty = Rows::new(HEADER.as_bytes(), "table.csv", None).unwrap().survey().unwrap_err();
        assert!(empty.to_string().contains("table.csv has no row below"));
        let single = Rows::new(rows(1, 0.1).as_bytes(), "table.csv", None).unwrap().survey().unwrap_err();
        assert!(single.to_string().contains("table.csv has a single row"));
    }

    #[test]
    fn rounded_stamps_determine_their_rate_and_are_no_gaps() {
        let row = |index: u32| format!("{:.3},0,0,0,0,0,-9.8\n", f64::from(index) / 400.0);
        let text = format!("{HEADER}\n{}", (0..2000).map(row).collect::<String>());
        let rate_hz = rate_of(text.as_bytes(), "table.csv").unwrap().unwrap();
        assert!((rate_hz / 400.0 - 1.0).abs() < 1e-3, "{rate_hz}");
        assert_eq!(read(&text, Some(rate_hz)).unwrap().len(), 2000);
        // One long step does not change the rate.
        let gap = format!("{HEADER}\n{}{}", row(0), (100..600).map(row).collect::<String>());
        assert!((rate_of(gap.as_bytes(), "table.csv").unwrap().unwrap() / 400.0 - 1.0).abs() < 1e-2);
        assert_eq!(rate_of(rows(1, 0.1).as_bytes(), "table.csv").unwrap(), None);
    }

    #[test]
    fn between_two_motions_lies_a_straight_line() {
        let motion = |x: f64| Motion { gyro_rad_s: [x, 0.0, 0.0], ..Motion::default() };
        let found: Vec<f64> =
            between([1.0, 3.0, -1.0].map(motion).into_iter(), 4).map(|motion| motion.gyro_rad_s[0]).collect();
        assert_eq!(found, [1.0, 1.5, 2.0, 2.5, 3.0, 2.0, 1.0, 0.0, -1.0, -1.0, -1.0, -1.0]);
    }
}
