//! The part of a recording that is wanted: a window of time and some of its channels. What is outside is left out as if
//! the file did not have it, so that counts, rate and findings are those of the part.

use super::error::RecordingError;
use super::info::{RecordingInfo, Stamps};
use super::rows::{Decimals, Row, Rows};
use super::stamps::UNIX_FROM_NS;
use super::{Layout, Source};
use imu_core::sample::{Channel, ChannelSet};
use imu_core::units::{NANOS_PER_SECOND, period_ns};
use std::ops::Range;

/// An end of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PartEnd {
    /// UTC in ns since 1970.
    Utc(i64),
    /// Time since the recording's first sample, ns.
    Since(i64),
}

/// A part of a recording; the default is all of it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Part {
    /// From this time on.
    pub from: Option<PartEnd>,
    /// Before this time.
    pub to: Option<PartEnd>,
    /// Only these channels.
    pub channels: Option<Vec<Channel>>,
}

impl Part {
    /// Returns whether it is all of a recording.
    pub fn is_whole(&self) -> bool {
        *self == Self::default()
    }

    /// Returns what the part leaves out of a recording whose first pass is known.
    pub(super) fn cut(&self, layout: &Layout, info: &RecordingInfo) -> Result<Cut, RecordingError> {
        let has: Vec<Channel> = info.channels.iter().collect();
        let channels = Channel::chosen(self.channels.as_deref(), &has)
            .map_err(|error| RecordingError::PartChannel { file: info.file.clone(), error })?;
        let since_ns = |end: PartEnd| match (end, info.stamps) {
            (PartEnd::Since(ns), _) => Ok(ns),
            (PartEnd::Utc(utc_ns), Stamps::Unix) => Ok(utc_ns.saturating_sub(info.started_utc_ns)),
            (PartEnd::Utc(_), _) => Err(RecordingError::PartTime { file: info.file.clone() }),
        };
        let (from_ns, to_ns) = (self.from.map(since_ns).transpose()?, self.to.map(since_ns).transpose()?);
        let column = layout.chosen.column;
        let place = |ns: i64| match column {
            Some(_) => info.first_stamp_ns.saturating_add(ns),
            // The first sample at that time or after it.
            None => (ns as f64 / period_ns(info.rate_hz)).ceil() as i64,
        };
        let window = from_ns.map_or(i64::MIN, place)..to_ns.map_or(i64::MAX, place);
        Ok(Cut { column, window, channels: channels.into_iter().collect() })
    }

    /// Returns the error for a part in which no sample is.
    pub(super) fn nothing(whole: &RecordingInfo) -> RecordingError {
        let length_s = whole.samples as f64 * period_ns(whole.rate_hz) / NANOS_PER_SECOND as f64;
        RecordingError::PartEmpty { file: whole.file.clone(), samples: whole.samples, length_s }
    }
}

/// What is kept of a recording's rows.
#[derive(Debug, Clone)]
pub(super) struct Cut {
    /// The stamp that gives the time; `None` without stamps.
    column: Option<usize>,
    /// Stamps, or numbers of rows if there are none.
    window: Range<i64>,
    pub(super) channels: ChannelSet,
}

/// Times after which clocks that count from their start begin again, ns: 32 bits of µs and of ms, a day, a GPS week.
const TURNS_NS: [i64; 4] = [4_294_967_296_000, 4_294_967_296_000_000, 86_400_000_000_000, 604_800_000_000_000];
/// How far the first stamp of a turn may be behind the last one of the turn before, ns.
const TURN_GAP_NS: i64 = 2_000_000_000;

/// The stamps of a clock that begins again, as if it went on.
#[derive(Debug, Default)]
struct Unrolled {
    last_ns: Option<i64>,
    turns_ns: i64,
}

impl Unrolled {
    /// Returns the stamp as if the clock had never begun again.
    fn next(&mut self, stamp_ns: i64) -> i64 {
        let unrolled_ns = self.unrolled(stamp_ns);
        (self.last_ns, self.turns_ns) = (Some(stamp_ns), unrolled_ns.saturating_sub(stamp_ns));
        unrolled_ns
    }

    /// Returns the same for the stamp of a line that may be damaged, which the next stamps do not follow.
    fn unrolled(&self, stamp_ns: i64) -> i64 {
        let begins_again = |last_ns: &i64, turn: i64| {
            stamp_ns < UNIX_FROM_NS
                && turn / 2 < last_ns.saturating_sub(stamp_ns)
                && (0..TURN_GAP_NS).contains(&stamp_ns.saturating_add(turn).saturating_sub(*last_ns))
        };
        let turn = self.last_ns.and_then(|last| TURNS_NS.into_iter().find(|turn| begins_again(&last, *turn)));
        stamp_ns.saturating_add(self.turns_ns).saturating_add(turn.unwrap_or(0))
    }
}

/// A recording's rows, without those outside the part.
pub(super) struct Reading {
    pub(super) source: Source,
    /// The column of stamps that is used, and its turns.
    unrolled: Option<(usize, Unrolled)>,
    cut: Option<Cut>,
    /// The number of rows so far that are samples or stand for one.
    position: i64,
    /// Whether the last row with a place was inside: a row without a place is where its neighbour is.
    inside: bool,
}

impl Reading {
    pub(super) fn new(source: Source, cut: Option<Cut>, column: Option<usize>) -> Self {
        let inside = cut.as_ref().is_none_or(|cut| cut.window.start == i64::MIN);
        Self { source, unrolled: column.map(|column| (column, Unrolled::default())), cut, position: 0, inside }
    }

    /// Replaces the stamps of a clock that began again.
    fn unroll(&mut self, row: &mut Row) {
        let Some((column, unrolled)) = &mut self.unrolled else { return };
        let (stamps, is_sample) = match row {
            Row::Sample { stamps, .. } => (stamps, true),
            Row::Rejected(rejected) => (&mut rejected.stamps, false),
            Row::Aside => return,
        };
        if let Some(stamp_ns) = stamps.get(*column) {
            stamps.set(*column, if is_sample { unrolled.next(stamp_ns) } else { unrolled.unrolled(stamp_ns) });
        }
    }

    /// Returns the row, if it belongs to the part.
    fn kept(&mut self, mut row: Row) -> Option<Row> {
        let Some(cut) = &self.cut else { return Some(row) };
        let (stamps, counts) = match &row {
            Row::Sample { stamps, .. } => (*stamps, true),
            // As without a part: a line before the first sample belongs to no gap.
            Row::Rejected(rejected) => (rejected.stamps, rejected.stands_for_sample && self.position > 0),
            Row::Aside => return Some(row),
        };
        let place = match cut.column {
            Some(column) => stamps.get(column),
            None => counts.then_some(self.position),
        };
        self.position += i64::from(counts);
        self.inside = place.map_or(self.inside, |place| cut.window.contains(&place));
        if let Row::Sample { sample, .. } = &mut row {
            for channel in sample.channels().iter().filter(|channel| !cut.channels.contains(*channel)) {
                sample.set(channel, f64::NAN);
            }
            // A channel that only some rows have is a recording at its own rate, if stamps show it.
            if cut.column.is_some() && sample.channels().is_empty() {
                return None;
            }
        }
        self.inside.then_some(row)
    }
}

impl Rows for Reading {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        while let Some(mut row) = self.source.rows().next_row()? {
            self.unroll(&mut row);
            if let Some(row) = self.kept(row) {
                return Ok(Some(row));
            }
        }
        Ok(None)
    }

    fn decimals(&self) -> &Decimals {
        self.source.decimals()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Input, Item, Options, Recording};
    use super::*;

    const S: i64 = 1_000_000_000;

    fn read(text: &str, rate_hz: Option<f64>, part: Part) -> Result<Recording, RecordingError> {
        let input = Input::memory("desk.csv", text.as_bytes().to_vec());
        Recording::read(input, Options { rate_hz, part, ..Options::default() })
    }

    fn window(from: i64, to: i64) -> Part {
        Part { from: Some(PartEnd::Since(from)), to: Some(PartEnd::Since(to)), channels: None }
    }

    fn values(recording: &Recording) -> Vec<f64> {
        let items = recording.items().unwrap().map(Result::unwrap);
        items
            .filter_map(|item| match item {
                Item::Sample(sample, _) => sample.get(Channel::GyroX),
                Item::Rejected(_) => None,
            })
            .collect()
    }

    fn stamped(origin_s: f64) -> String {
        let rows = (0..200).filter(|row| !(60..70).contains(row));
        let rows: String = rows.map(|row| format!("{:.3},{row},{}\n", origin_s + 0.1 * f64::from(row), -row)).collect();
        format!("time_s,gyro_x_rad_s,accel_z_m_s2\n{rows}")
    }

    #[test]
    fn a_window_is_half_open_and_counts_as_if_the_file_had_no_more() {
        let recording = read(&stamped(50.0), None, window(5 * S, 8 * S)).unwrap();
        let expected: Vec<f64> = (50..60).chain(70..80).map(f64::from).collect();
        assert_eq!(values(&recording), expected);
        let info = recording.info();
        assert_eq!((info.samples, info.first_stamp_ns), (20, 55 * S));
        assert!((info.rate_hz - 10.0).abs() < 1e-6, "{}", info.rate_hz);
        let missing: u64 = recording
            .items()
            .unwrap()
            .map(|item| if let Item::Sample(_, Some(missing)) = item.unwrap() { missing } else { 0 })
            .sum();
        assert_eq!(missing, 10);
        let all = read(&stamped(50.0), None, Part::default()).unwrap();
        assert_eq!(all.info().samples, 190);
        let rest = read(&stamped(50.0), None, Part { from: Some(PartEnd::Since(19 * S)), ..Part::default() }).unwrap();
        assert_eq!(values(&rest), (190..200).map(f64::from).collect::<Vec<_>>());
    }

    #[test]
    fn a_clock_that_begins_again_goes_on() {
        for (unit, turn, step) in
            [("us", 1_u64 << 32, 10_000), ("ms", 1 << 32, 10), ("s", 86_400, 1), ("s", 604_800, 1)]
        {
            let rows = (0..400_u64).filter(|row| !(190..195).contains(row));
            let rows: String =
                rows.map(|row| format!("{},{row}\n", (turn - 200 * step - step / 3 + row * step) % turn)).collect();
            let recording = read(&format!("time_{unit},gyro_x_rad_s\n{rows}"), None, Part::default()).unwrap();
            let info = recording.info();
            assert_eq!((info.samples, info.rejected.len()), (395, 0), "{unit} {turn}");
            let expected_hz = if unit == "s" { 1.0 } else { 100.0 };
            assert!((info.rate_hz / expected_hz - 1.0).abs() < 1e-6, "{unit} {turn}: {}", info.rate_hz);
        }
        // A clock that is set back by something else is not.
        let rows: String =
            (0..400).map(|row| format!("{},{row}\n", if row < 200 { 5000 + row } else { row })).collect();
        let info_of = read(&format!("time_s,gyro_x_rad_s\n{rows}"), None, Part::default()).unwrap();
        assert!(info_of.info().samples < 400);
    }

    #[test]
    fn a_time_of_day_needs_stamps_since_1970() {
        let origin_s = 1_800_000_000;
        let at = |since_s: i64| PartEnd::Utc((origin_s + since_s) * S);
        let part = Part { from: Some(at(1)), to: Some(at(2)), channels: None };
        let recording = read(&stamped(origin_s as f64), None, part.clone()).unwrap();
        assert_eq!(values(&recording), (10..20).map(f64::from).collect::<Vec<_>>());
        assert_eq!(recording.info().started_utc_ns, (origin_s + 1) * S);
        let error = read(&stamped(50.0), None, part).unwrap_err().to_string();
        assert!(error.contains("desk.csv tells no time of day") && error.contains("seconds"), "{error}");
    }

    #[test]
    fn without_stamps_rows_are_counted_rejected_ones_too() {
        let rows: String = (0..100).map(|row| if row == 12 { "x\n".to_owned() } else { format!("{row}\n") }).collect();
        let text = format!("gyro_x_rad_s\n{rows}");
        let recording = read(&text, Some(10.0), window(S, 2 * S)).unwrap();
        let expected: Vec<f64> = [10, 11].into_iter().chain(13..20).map(f64::from).collect();
        assert_eq!(values(&recording), expected);
        assert_eq!((recording.info().samples, recording.info().rejected.values().sum::<u64>()), (9, 1));
        // Between two samples, and from the middle of one.
        assert_eq!(values(&read(&text, Some(10.0), window(S + 1, S + S / 5 + 1)).unwrap()), [11.0]);
    }

    #[test]
    fn channels_that_are_not_wanted_are_as_if_they_were_not_there() {
        let part = |channels: &[Channel]| Part { channels: Some(channels.to_vec()), ..Part::default() };
        let recording = read(&stamped(0.0), None, part(&[Channel::AccelZ])).unwrap();
        assert_eq!(recording.info().channels.iter().collect::<Vec<_>>(), [Channel::AccelZ]);
        assert!(values(&recording).is_empty() && recording.info().findings.absent.is_empty());
        // In every fourth row alone, it has a quarter of the rate.
        let rows: String = (0..400)
            .map(|row| format!("{:.2},{row},{}\n", 0.01 * f64::from(row), if row % 4 == 1 { "9.8" } else { "" }))
            .collect();
        let sparse = format!("time_s,gyro_x_rad_s,accel_z_m_s2\n{rows}");
        let recording = read(&sparse, None, part(&[Channel::AccelZ])).unwrap();
        assert_eq!((recording.info().samples, recording.info().rate_hz.round()), (100, 25.0));
        let error = read(&stamped(0.0), None, part(&[Channel::MagX])).unwrap_err().to_string();
        assert!(error.contains("desk.csv") && error.contains("mag_x") && error.contains("accel_z"), "{error}");
    }

    #[test]
    fn an_empty_part_is_refused_with_the_length_of_the_recording() {
        for (from, to) in [(30 * S, 40 * S), (5 * S, 5 * S), (6 * S, 2 * S), (6 * S, 6 * S + S / 2)] {
            let error = read(&stamped(0.0), None, window(from, to)).unwrap_err().to_string();
            assert!(
                error.contains("no sample in the part") && error.contains("190 samples, 19"),
                "{from} {to}: {error}"
            );
        }
    }
}
