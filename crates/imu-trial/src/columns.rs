//! Columns: samples, simulated or recorded, on which effects are imposed.

use imu_core::sample::Channel;
use imu_diagnosis::Recording;

/// One channel's samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// The channel.
    pub channel: Channel,
    /// The channel's values, U.
    pub values: Vec<f64>,
    /// The white part of the values, U, of the same length: the input of effects on the white part alone.
    pub white: Vec<f64>,
    /// The white part's standard deviation before any effect, U: the unit of sizes.
    pub scale: f64,
}

impl Column {
    /// Multiplies the white part, and its contribution to the values; `gain` takes a sample's number and its white part
    /// in σ.
    pub fn amplify(&mut self, mut gain: impl FnMut(usize, f64) -> f64) {
        for (i, (value, white)) in self.values.iter_mut().zip(&mut self.white).enumerate() {
            let new = *white * gain(i, *white / self.scale);
            *value += new - *white;
            *white = new;
        }
    }

    /// Adds a course to the values; the course is in σ per sample.
    pub fn add(&mut self, mut course: impl FnMut(usize) -> f64) {
        let scale = self.scale;
        self.values.iter_mut().enumerate().for_each(|(i, value)| *value += scale * course(i));
    }
}

/// Samples of several channels at one rate, with their temperature and stamps.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    /// Samples per second.
    pub rate_hz: f64,
    /// The channels, all of one length.
    pub columns: Vec<Column>,
    /// The sensor's true temperature at every sample, °C; empty if it is not known.
    pub temperature_c: Vec<f64>,
    /// Whether each sample is missing; empty if none is.
    pub missing: Vec<bool>,
    /// Stamps per place, s; empty if none were taken.
    pub time_s: Vec<f64>,
}

/// Length of the mean relative to which a recording's white part is measured, s: short compared with every slow part,
/// long compared with a sample.
const AROUND_S: f64 = 1.0;

impl Columns {
    /// Returns the columns of an existing recording. The white part is the difference from the mean over a second. Its
    /// scale is that of the differences between neighbours (their median, so that lines of outliers do not count).
    pub fn of(recording: &Recording) -> Self {
        let columns = recording.channels.iter().map(|(channel, values)| {
            let around = around(values, ((AROUND_S * recording.rate_hz) as usize).max(8));
            let white = values.iter().zip(around).map(|(value, mean)| value - mean).collect();
            Column { channel: *channel, values: values.clone(), white, scale: scale(values) }
        });
        Self {
            rate_hz: recording.rate_hz,
            columns: columns.collect(),
            temperature_c: recording.temperature_c.clone().unwrap_or_default(),
            missing: recording.missing.clone(),
            time_s: recording.time_s.clone(),
        }
    }

    /// Returns the number of samples per channel.
    pub fn len(&self) -> usize {
        self.columns.first().map_or(0, |column| column.values.len())
    }

    /// Returns whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Loses samples: they become missing, and the last sample before takes their place.
    pub fn lose(&mut self, places: impl IntoIterator<Item = usize>) {
        self.missing.resize(self.len(), false);
        for place in places {
            self.missing[place] = true;
            for column in &mut self.columns {
                column.values[place] = column.values[place.saturating_sub(1)];
            }
        }
    }

    /// Converts the columns to a recording, with the temperature as it was read.
    pub fn into_recording(self, temperature_c: Option<Vec<f64>>) -> Recording {
        Recording {
            rate_hz: self.rate_hz,
            channels: self.columns.into_iter().map(|column| (column.channel, column.values)).collect(),
            missing: self.missing,
            temperature_c,
            time_s: self.time_s,
            ..Recording::default()
        }
    }
}

/// Returns means over `window` samples around each sample, fewer at the ends.
pub(super) fn around(values: &[f64], window: usize) -> Vec<f64> {
    // Sums relative to the first value keep their digits beside a large level.
    let level = values.first().copied().unwrap_or(0.0);
    let mut sums = vec![0.0];
    let mut sum = 0.0;
    sums.extend(values.iter().map(|value| {
        sum += value - level;
        sum
    }));
    let half = window / 2;
    let mean = |index: usize| {
        let (from, to) = (index.saturating_sub(half), (index + half + 1).min(values.len()));
        level + (sums[to] - sums[from]) / (to - from) as f64
    };
    (0..values.len()).map(mean).collect()
}

/// Returns the standard deviation of white noise with these differences between neighbours.
pub(super) fn scale(values: &[f64]) -> f64 {
    let mut steps: Vec<f64> = values.windows(2).map(|two| (two[1] - two[0]).abs()).collect();
    if steps.is_empty() {
        return 0.0;
    }
    let mean_square = steps.iter().map(|step| step * step).sum::<f64>() / steps.len() as f64;
    let middle = steps.len() / 2;
    let median = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    // If a coarse resolution makes most differences 0 or one step, the median carries no information.
    let coarse = steps.iter().filter(|step| **step == 0.0).count() * 10 > steps.len();
    // 0.6745: the median of a normal distribution's absolute value.
    let of_steps = if coarse { mean_square.sqrt() } else { median / 0.6745 };
    of_steps / std::f64::consts::SQRT_2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Draw;

    #[test]
    fn scale_and_white_part_of_a_recording_are_those_of_its_noise() {
        let mut draw = Draw::device(1, 1, "columns");
        let mut walk = 9.8;
        let values: Vec<f64> = (0..20_001)
            .map(|index| {
                walk += 1e-5 * draw.normal();
                walk + 0.01 * draw.normal() + if index % 997 == 0 { 3.0 } else { 0.0 }
            })
            .collect();
        let recording = Recording { rate_hz: 40.0, channels: vec![(Channel::AccelZ, values)], ..Recording::default() };
        let columns = Columns::of(&recording);
        assert!((columns.columns[0].scale / 0.01 - 1.0).abs() < 0.03, "{}", columns.columns[0].scale);
        let white = &columns.columns[0].white;
        let sum: f64 = white.iter().sum::<f64>() / white.len() as f64;
        assert!(sum.abs() < 1e-3, "{sum}");
        assert_eq!(columns.into_recording(None), recording);
    }
}
