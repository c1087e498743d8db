//! Values: the part of a recording's numbers that a first pass keeps, in memory that does not grow with it.
//!
//! It keeps at most [`KEPT`] samples, spread evenly over the whole record, to examine the distribution of values. It
//! also keeps running counts for comparisons between neighbours. Pure.

use super::turning::Turning;
use imu_core::sample::{Channel, Sample, Triad};

/// The maximum number of samples that are kept.
const KEPT: usize = 4096;
/// A VN-100 cannot measure more than this (its range is 2.5), gauss: a magnetic field whose unit is wrong.
const MAG_MAX_GAUSS: f64 = 25.0;
/// The standard deviation of normal noise over the median distance from the median.
pub(super) const STD_OF_SPREAD: f64 = 1.4826;
/// The channels of a magnetic field.
const FIELD: [Channel; 3] = [Channel::MagX, Channel::MagY, Channel::MagZ];

/// The facts about the values so far.
#[derive(Debug, Default)]
pub(super) struct Values {
    /// Samples spread over the record.
    pub(super) spread: Vec<Sample>,
    /// One less than the number of samples of which one is kept, which is a power of two.
    mask: u64,
    seen: u64,
    /// Number of samples that repeat the one before in every channel.
    pub(super) repeated: u64,
    /// Number of samples with a field of more than [`MAG_MAX_GAUSS`].
    pub(super) strong_fields: u64,
    pub(super) turning: Turning,
    /// The curvature of the gyro's axes at each of the kept samples: the difference between the step to it and the step
    /// before.
    pub(super) bends: Vec<Option<[f64; 3]>>,
    last: Option<Sample>,
    before_last: Option<Sample>,
}

impl Values {
    pub(super) fn take(&mut self, stamp_ns: Option<i64>, sample: Sample) {
        // A sensor's noise never repeats in several channels at once; a single coarse channel may.
        let several = sample.channels().iter().nth(1).is_some();
        if several && self.last.as_ref().is_some_and(|last| last.same_values(&sample)) {
            self.repeated += 1;
        }
        if FIELD.iter().any(|channel| sample.get(*channel).is_some_and(|value| value.abs() > MAG_MAX_GAUSS)) {
            self.strong_fields += 1;
        }
        self.turning.take(stamp_ns, &sample);
        if self.seen & self.mask == 0 {
            self.keep(&sample);
        }
        self.seen += 1;
        self.before_last = self.last.replace(sample);
    }

    fn keep(&mut self, sample: &Sample) {
        if self.spread.len() == KEPT {
            // Every second one is removed to make room for as many new ones.
            let mut place = 0;
            self.spread.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            let mut place = 0;
            self.bends.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.mask = 2 * self.mask + 1;
        }
        if self.seen & self.mask == 0 {
            self.spread.push(sample.clone());
            self.bends.push(self.bend(sample));
        }
    }

    fn bend(&self, sample: &Sample) -> Option<[f64; 3]> {
        let (last, before) = (self.last.as_ref()?, self.before_last.as_ref()?);
        let [x, y, z] =
            Triad::Gyro.channels().map(|axis| Some(before.get(axis)? - 2.0 * last.get(axis)? + sample.get(axis)?));
        Some([x?, y?, z?])
    }

    /// Returns the kept values of a channel.
    pub(super) fn of(&self, channel: Channel) -> Vec<f64> {
        self.spread.iter().filter_map(|sample| sample.get(channel)).collect()
    }
}

/// Returns the median of these values, and the median of their distances from it; `None` without values.
pub(super) fn median_and_spread(mut values: Vec<f64>) -> Option<(f64, f64)> {
    let middle = |values: &mut Vec<f64>| {
        let place = values.len() / 2;
        (!values.is_empty()).then(|| *values.select_nth_unstable_by(place, f64::total_cmp).1)
    };
    let median = middle(&mut values)?;
    let mut distances: Vec<f64> = values.iter().map(|value| (value - median).abs()).collect();
    Some((median, middle(&mut distances)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_samples_are_spread_evenly_over_a_record_of_any_length() {
        for (count, every) in [(100, 1), (4096, 1), (4097, 2), (100_000, 32)] {
            let mut values = Values::default();
            for index in 0..count {
                let mut sample = Sample::at(0, 0);
                sample.set(Channel::GyroX, f64::from(index));
                values.take(None, sample);
            }
            let kept = values.of(Channel::GyroX);
            assert_eq!(kept.len(), (count as usize).div_ceil(every), "{count}");
            assert!(kept.iter().enumerate().all(|(place, value)| *value == (place * every) as f64), "{count}");
        }
    }

    #[test]
    fn the_spread_is_that_of_most_values() {
        assert_eq!(median_and_spread(Vec::new()), None);
        assert_eq!(median_and_spread(vec![1.0, 2.0, 3.0, 4.0, 1000.0]), Some((3.0, 1.0)));
    }
}
