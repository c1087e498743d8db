//! Temperature: a course over time from a table of `time_s` and `temperature_c`.

use super::file::MotionError;
use std::io::Read;

/// A temperature over time: linear between the rows, constant before the first and after the last.
#[derive(Debug, Clone, PartialEq)]
pub struct Temperatures {
    rows: Vec<(f64, f64)>,
}

impl Temperatures {
    /// Reads CSV with the columns `time_s` (ascending) and `temperature_c`; others are ignored. `file` names it in messages.
    ///
    /// # Errors
    /// [`MotionError`] with file, line and column.
    pub fn read(text: impl Read, file: &str) -> Result<Self, MotionError> {
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text);
        let unreadable = |source| MotionError::Csv { file: file.to_owned(), source };
        let header = reader.headers().map_err(unreadable)?.clone();
        let place = |column: &'static str| {
            let found = header.iter().position(|name| name.trim_start_matches('\u{FEFF}') == column);
            found.ok_or_else(|| MotionError::TemperatureColumn { file: file.to_owned(), column })
        };
        let (time, temperature) = (place("time_s")?, place("temperature_c")?);
        let mut rows: Vec<(f64, f64)> = Vec::new();
        for record in reader.records() {
            let record = record.map_err(unreadable)?;
            let line = record.position().map_or(0, csv::Position::line);
            let cell = |place: usize, column: &'static str| {
                let text = record.get(place).unwrap_or_default();
                let number = text.parse().ok().filter(|value: &f64| value.is_finite());
                let found = text.chars().take(40).collect();
                number.ok_or(MotionError::Cell { file: file.to_owned(), line, column, found })
            };
            let (time_s, temperature_c) = (cell(time, "time_s")?, cell(temperature, "temperature_c")?);
            if rows.last().is_some_and(|(last_s, _)| *last_s >= time_s) {
                return Err(MotionError::Backwards { file: file.to_owned(), line, time_s });
            }
            rows.push((time_s, temperature_c));
        }
        if rows.is_empty() {
            return Err(MotionError::Empty { file: file.to_owned() });
        }
        Ok(Self { rows })
    }

    /// Creates a constant temperature.
    pub fn constant(temperature_c: f64) -> Self {
        Self { rows: vec![(0.0, temperature_c)] }
    }

    /// Creates a course from a sensor's samples at `rate_hz`: means over a second. Values that are not finite do not count;
    /// `None` if none is.
    pub fn of_samples(values: &[f64], rate_hz: f64) -> Option<Self> {
        let length = (rate_hz.round() as usize).max(1);
        let mean = |(second, part): (usize, &[f64])| {
            let there: Vec<f64> = part.iter().copied().filter(|value| value.is_finite()).collect();
            let middle = second as f64 * length as f64 + 0.5 * (part.len() as f64 - 1.0);
            (!there.is_empty()).then(|| (middle / rate_hz, there.iter().sum::<f64>() / there.len() as f64))
        };
        let rows: Vec<(f64, f64)> = values.chunks(length).enumerate().filter_map(mean).collect();
        (!rows.is_empty()).then_some(Self { rows })
    }

    /// Returns the same course, begun `by_s` later.
    pub fn delayed(self, by_s: f64) -> Self {
        Self { rows: self.rows.into_iter().map(|(time_s, value)| (time_s + by_s, value)).collect() }
    }

    /// Returns whether the temperature is the same at all times.
    pub fn is_constant(&self) -> bool {
        self.rows.windows(2).all(|pair| pair[0].1 == pair[1].1)
    }

    /// Returns the temperature at a time, °C.
    pub fn at(&self, time_s: f64) -> f64 {
        let next = self.rows.partition_point(|(at_s, _)| *at_s <= time_s);
        let before = next.checked_sub(1).and_then(|last| self.rows.get(last));
        match (before, self.rows.get(next)) {
            (Some((from_s, from)), Some((to_s, to))) => from + (to - from) * (time_s - from_s) / (to_s - from_s),
            (Some((_, value)), None) | (None, Some((_, value))) => *value,
            (None, None) => f64::NAN,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_rows_lies_a_straight_line_and_the_ends_hold() {
        let read = Temperatures::read("temperature_c,time_s\n20,10\n30,20\n25,40\n".as_bytes(), "t.csv").unwrap();
        let found = [0.0, 10.0, 15.0, 20.0, 30.0, 40.0, 1e9].map(|time_s| read.at(time_s));
        assert_eq!(found, [20.0, 20.0, 25.0, 30.0, 27.5, 25.0, 25.0]);
    }

    #[test]
    fn samples_are_means_over_a_second() {
        let found = Temperatures::of_samples(&[20.0, 22.0, f64::NAN, 25.0], 2.0).unwrap();
        assert_eq!([0.25, 1.25].map(|time_s| found.at(time_s)), [21.0, 25.0]);
        assert_eq!(Temperatures::of_samples(&[f64::NAN], 2.0), None);
    }

    #[test]
    fn a_delayed_course_holds_its_first_value_before_it() {
        let found = Temperatures::of_samples(&[20.0, 22.0, 25.0, 25.0], 2.0).unwrap().delayed(1e9);
        assert_eq!([0.0, 1e9 + 0.25, 1e9 + 0.75, 1e9 + 1.25].map(|time_s| found.at(time_s)), [21.0, 21.0, 23.0, 25.0]);
    }

    #[test]
    fn what_is_wrong_is_refused_with_file_line_and_what_is_allowed() {
        for (text, parts) in [
            ("time_s,temperature\n1,2\n", ["line 1", "no column `temperature_c`"]),
            ("time_s,temperature_c\n1,warm\n", ["line 2", "found `warm`"]),
            ("time_s,temperature_c\n1,20\n1,21\n", ["line 3", "later"]),
            ("time_s,temperature_c\n", ["t.csv", "no row"]),
        ] {
            let message = Temperatures::read(text.as_bytes(), "t.csv").unwrap_err().to_string();
            for part in ["t.csv"].into_iter().chain(parts) {
                assert!(message.contains(part), "{part:?} is not in {message:?}");
            }
        }
    }
}
