//! The stamps before raw `$VN…` lines: numbers, dates and times of day, and the unit of the numbers.
//!
//! A header's name states the unit (`time_ms`). Without one, the sensor does: it sends text at 1 to 200 Hz, so that steps of
//! 5 to 1000 are milliseconds, and of 5,000 to a million microseconds. Numbers since 1970 show their unit by their size.
//! Otherwise a number is seconds.

use super::error::{RecordingError, read_error};
use super::header::foreign_names;
use super::input::Input;
use super::stamps::{RowStamps, STAMPS_MAX, UNIX_FROM_NS, parse_date, parse_stamp};
use super::vocabulary::{Meaning, meaning};
use std::io::{BufRead as _, Read as _};
use std::ops::RangeInclusive;

/// Longest line that is kept whole; the rest is read as another line. Messages are shorter than 300 bytes.
pub(super) const LINE_BYTES: u64 = 4096;
/// The beginning of every message.
pub(super) const START: &[u8] = b"$VN";
/// Decimal places from a second to a nanosecond, which is the unit of a number that nothing else is known of.
const SECONDS: usize = 9;
/// Names of units, with their decimal places to a nanosecond.
const SHORTER: [(usize, &str); 3] = [(6, "ms"), (3, "µs"), (0, "ns")];
/// Lines whose stamps show the unit.
const LOOK_AT: usize = 1024;
/// Steps are those from a line to this many lines on, in which deliveries of several lines at once are evened out.
const WINDOW: usize = 16;
/// Steps between messages, s: the sensor sends text at 1 to 200 Hz.
const STEPS_S: RangeInclusive<f64> = 0.0045..=1.2;
/// Times since 1970 from the year 2000 to 2100, s.
const SINCE_1970_S: RangeInclusive<f64> = 9.4e8..=4.2e9;
/// The longest step of times since 1970, which are not those of a sensor that sends by itself, s.
const STEP_MAX_S: f64 = 60.0;

/// The units of a file's stamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Units {
    places: [usize; STAMPS_MAX],
}

impl Default for Units {
    fn default() -> Self {
        Self { places: [SECONDS; STAMPS_MAX] }
    }
}

impl Units {
    /// Determines the units from the file's first lines.
    pub(super) fn of(input: &Input) -> Result<Self, RecordingError> {
        let mut reader = input.open()?;
        let (mut units, mut bytes) = (Self::default(), Vec::new());
        let mut columns: [Vec<f64>; STAMPS_MAX] = Default::default();
        for number in 0..LOOK_AT {
            bytes.clear();
            let read = reader.by_ref().take(LINE_BYTES).read_until(b'\n', &mut bytes);
            if read.map_err(|source| read_error(input.path(), number as u64, source))? == 0 {
                break;
            }
            let Some(start) = bytes.windows(START.len()).position(|window| window == START) else {
                if number == 0 {
                    units.read_header(&String::from_utf8_lossy(&bytes));
                }
                continue;
            };
            let stamps = written(&bytes[..start]).unwrap_or_default();
            let stamps = stamps.iter().skip(stamps.len().saturating_sub(STAMPS_MAX));
            for (column, stamp) in columns.iter_mut().zip(stamps) {
                column.push(if let Written::Number(word) = stamp {
                    word.parse().unwrap_or(f64::NAN)
                } else {
                    f64::NAN
                });
            }
        }
        for (places, column) in units.places.iter_mut().zip(&columns) {
            if *places == SECONDS {
                *places = places_of(column);
            }
        }
        Ok(units)
    }

    /// Takes the units that the names of a table's columns state.
    fn read_header(&mut self, line: &str) {
        let names = foreign_names(line.trim()).unwrap_or_default();
        for (places, name) in self.places.iter_mut().zip(&names) {
            if let Some(Meaning::Time { places: Some(stated) }) = meaning(name) {
                *places = stated;
            }
        }
    }

    /// Returns the name of a column's unit, unless it is seconds.
    pub(super) fn name(&self, column: usize) -> Option<&'static str> {
        let places = self.places.get(column)?;
        SHORTER.iter().find(|(of, _)| of == places).map(|(_, name)| *name)
    }

    /// Returns the stamps before a message, and whether there is also something that is no stamp: then none of it is used.
    pub(super) fn stamps(&self, prefix: &[u8]) -> (RowStamps, bool) {
        let mut stamps = RowStamps::default();
        let Some(written) = written(prefix) else { return (stamps, true) };
        let further = written.len().saturating_sub(STAMPS_MAX);
        for (place, stamp) in written.iter().enumerate() {
            let places =
                place.checked_sub(further).and_then(|column| self.places.get(column)).copied().unwrap_or(SECONDS);
            let nanos = match stamp {
                Written::Nanos(nanos) => Some(*nanos),
                Written::Number(word) => {
                    // What is too large for seconds may be nanoseconds since 1970, as rostopic writes them.
                    let nanos = || parse_stamp(word.as_bytes(), 0).filter(|nanos| *nanos >= UNIX_FROM_NS);
                    parse_stamp(word.as_bytes(), places).or_else(nanos)
                }
            };
            match nanos {
                Some(nanos) => stamps.push(nanos),
                None => return (RowStamps::default(), true),
            }
        }
        (stamps, false)
    }
}

/// A stamp as it is written before a message.
enum Written<'a> {
    /// A date with a time, ns since 1970, or a time of day, ns.
    Nanos(i64),
    /// What may be a number in some unit.
    Number(&'a str),
}

/// Returns what stands before a message; `None` if it is no text.
fn written(prefix: &[u8]) -> Option<Vec<Written<'_>>> {
    let mut words = words(prefix)?.into_iter().peekable();
    let mut found = Vec::new();
    while let Some(word) = words.next() {
        // A date and its time of day are two words, or one.
        let is_day = word.len() == 10 && matches!(word.as_bytes()[4], b'-' | b'/');
        let two = words.peek().filter(|_| is_day).and_then(|time| parse_date(format!("{word} {time}").as_bytes()));
        if two.is_some() {
            words.next();
        }
        let nanos = two.or_else(|| parse_date(word.as_bytes())).or_else(|| time_of_day(word));
        found.push(nanos.map_or(Written::Number(word), Written::Nanos));
    }
    Some(found)
}

/// Returns the words before a message; `None` if it is no text.
fn words(prefix: &[u8]) -> Option<Vec<&str>> {
    let text = std::str::from_utf8(prefix).ok()?.trim_start_matches('\u{feff}');
    // The message may be a table's cell in quotation marks, or Python's bytes.
    let bare = text.trim_end_matches(['"', '\'']);
    let text =
        if bare.len() < text.len() { bare.strip_suffix('b').unwrap_or(bare).trim_end_matches('"') } else { text };
    // A stamp may be a cell in quotation marks as well, or in brackets.
    let words = text.split(|c: char| c.is_whitespace() || c == ',' || c == ';');
    Some(
        words
            .map(|word| word.trim_matches(['"', '\'', '[', ']', '(', ')', '<', '>']))
            .filter(|word| !word.is_empty())
            .collect(),
    )
}

/// Returns a time of day (`12:30:05.25`), ns.
fn time_of_day(word: &str) -> Option<i64> {
    let word = word.trim_end_matches(':');
    let time = chrono::NaiveTime::parse_from_str(word, "%H:%M:%S%.f").ok()?;
    let since = time.signed_duration_since(chrono::NaiveTime::MIN);
    since.num_nanoseconds()
}

/// Returns the decimal places of the unit that a column's numbers have.
fn places_of(column: &[f64]) -> usize {
    let mut steps: Vec<f64> =
        column.windows(WINDOW + 1).map(|window| (window[WINDOW] - window[0]) / WINDOW as f64).collect();
    if steps.is_empty() {
        let ends = column.first().zip(column.last()).map(|(first, last)| last - first);
        steps.extend(ends.map(|span| span / (column.len() - 1).max(1) as f64));
    }
    steps.retain(|step| *step > 0.0);
    if steps.is_empty() {
        return SECONDS;
    }
    let middle = steps.len() / 2;
    let step = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    let value = column.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    let units = || std::iter::once(SECONDS).chain(SHORTER.iter().map(|(places, _)| *places));
    let second = |places: usize| 10_f64.powi(SECONDS as i32 - places as i32);
    let is_date =
        |places: &usize| SINCE_1970_S.contains(&(value / second(*places))) && step / second(*places) <= STEP_MAX_S;
    let is_sent = |places: &usize| STEPS_S.contains(&(step / second(*places)));
    units().find(is_date).or_else(|| units().find(is_sent)).unwrap_or(SECONDS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::units::NANOS_PER_SECOND;

    const SECOND: i64 = NANOS_PER_SECOND as i64;
    const MESSAGE: &str = "$VNYMR,1*00";

    /// Returns the stamps of the first and the last of 100 lines.
    fn read(header: &str, stamp: impl Fn(u32) -> String) -> [Option<i64>; 2] {
        let lines: String = (0..100).map(|line| format!("{}{MESSAGE}\n", stamp(line))).collect();
        let units = Units::of(&Input::memory("a", format!("{header}{lines}").into_bytes())).unwrap();
        [0, 99].map(|line| {
            let (stamps, is_text) = units.stamps(stamp(line).as_bytes());
            assert!(!is_text || stamps.count() == 0);
            stamps.get(0)
        })
    }

    #[test]
    fn the_rate_at_which_the_sensor_can_send_shows_the_unit() {
        for rate_hz in [1_i32, 40, 200] {
            for (places, per_second) in [(9, 1.0), (6, 1e3), (3, 1e6), (0, 1e9)] {
                for origin_s in [0.0, 5.0, 1000.0, 1_795_464_000.0] {
                    let stamp =
                        |line: u32| format!("{:.3} ", (origin_s + f64::from(line) / f64::from(rate_hz)) * per_second);
                    let [first, last] = read("", stamp);
                    let took = last.unwrap() - first.unwrap();
                    let expected = 99 * SECOND / i64::from(rate_hz);
                    assert!((took - expected).abs() <= 1000, "{rate_hz} Hz, {places}, {origin_s}: {took}");
                    assert!((first.unwrap() as f64 / 1e9 - origin_s).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn lines_that_arrive_together_do_not_hide_the_unit() {
        // Eight lines each 80 ms, 0.1 ms apart.
        let [first, last] = read("", |line| format!("{:.1},", f64::from(line / 8) * 80.0 + 0.1 * f64::from(line % 8)));
        assert_eq!(last.unwrap() - first.unwrap(), 12 * 80_000_000 + 300_000);
    }

    #[test]
    fn a_slow_log_since_1970_is_in_seconds() {
        let [first, last] = read("", |line| format!("{} ", 1_795_464_000 + 10 * line));
        assert_eq!(last.unwrap() - first.unwrap(), 990 * SECOND);
    }

    #[test]
    fn a_header_states_the_unit() {
        let [first, last] = read("time_ms,data\n", |line| format!("{},\"", 3000 * line));
        assert_eq!([first, last], [Some(0), Some(297 * SECOND)]);
    }

    #[test]
    fn dates_and_times_of_day_are_stamps() {
        let origin = 1_795_464_000 * SECOND;
        for (before, between, after) in [("", "T", "Z "), ("", " ", " "), ("[", " ", "] "), ("\"", "T", "+00:00\",b'")]
        {
            let stamp = |line: u32| format!("{before}2026-11-23{between}20:00:{:06.3}{after}", 0.025 * f64::from(line));
            assert_eq!(read("", stamp), [Some(origin), Some(origin + 2_475_000_000)], "{before}{between}{after}");
        }
        let slashes = |line: u32| format!("2026/11/23 20:00:{:06.3} ", 0.025 * f64::from(line));
        assert_eq!(read("", slashes), [Some(origin), Some(origin + 2_475_000_000)]);
        // Numbers in ms beside a date, and behind more columns than are kept.
        for before in ["2026-11-23 20:00:00 ", "1 1 1 1 1 "] {
            let lines: String = (0..100).map(|line| format!("{before}{} {MESSAGE}\n", 5000 + 25 * line)).collect();
            let units = Units::of(&Input::memory("a", lines.into_bytes())).unwrap();
            let (stamps, _) = units.stamps(format!("{before}5025 ").as_bytes());
            assert_eq!(stamps.get(stamps.count() - 1), Some(5_025_000_000), "{before}");
        }
        let [first, last] = read("", |line| format!("20:00:{:06.3} > ", 0.025 * f64::from(line)));
        assert_eq!([first, last], [Some(72_000 * SECOND), Some(72_002 * SECOND + 475_000_000)]);
        assert_eq!(read("", |_| "node-1: ".to_owned()), [None; 2]);
    }
}
