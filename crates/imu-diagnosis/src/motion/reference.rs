//! Reference: a motion recorded by another instrument, possibly on its own clock.

use crate::averages::median;
use imu_model::simulator::Motion;

/// Rows of a motion in the order of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reference {
    /// Times, s, from any origin.
    time_s: Vec<f64>,
    motions: Vec<Motion>,
}

/// The reasons why rows are not a reference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReferenceError {
    /// Too few rows.
    #[error("the reference has {found} rows; at least {least} are needed")]
    TooShort {
        /// The number of rows.
        found: usize,
        /// The minimum number of rows.
        least: usize,
    },
    /// Times do not increase, or are not numbers.
    #[error("row {row} of the reference is at {time_s} s; each row has to be later than the one before")]
    Backwards {
        /// The row, from 1.
        row: usize,
        /// The row's time, s.
        time_s: f64,
    },
    /// A value is not a finite number.
    #[error("row {row} of the reference has a value that is no finite number")]
    NotFinite {
        /// The row, from 1.
        row: usize,
    },
    /// Rows are missing.
    #[error(
        "the reference has no row for {gap_s:.3} s before its row {row}; a reference has a row every {period_s:.4} s and no gaps"
    )]
    Gap {
        /// The row behind the gap, from 1.
        row: usize,
        /// The length of the gap, s.
        gap_s: f64,
        /// The period of the rows, s.
        period_s: f64,
    },
}

/// What is known of the sensor's motion.
#[derive(Debug, Clone, PartialEq)]
pub enum Known {
    /// Rates and specific forces in the sensor's axes, without noise.
    Motion(Reference),
    /// Poses, or rates about one axis, as an instrument measured them.
    External(imu_pose::External),
}

/// Minimum number of rows.
const LEAST: usize = 64;
/// A step of this many periods is a gap: a cubic between its ends would be a guess.
const GAP_PERIODS: f64 = 4.5;

impl Reference {
    /// Creates a reference from rows of the time, s, and the sensor's motion.
    ///
    /// # Errors
    /// [`ReferenceError`].
    pub fn new(rows: impl IntoIterator<Item = (f64, Motion)>) -> Result<Self, ReferenceError> {
        let (time_s, motions): (Vec<f64>, Vec<Motion>) = rows.into_iter().unzip();
        if time_s.len() < LEAST {
            return Err(ReferenceError::TooShort { found: time_s.len(), least: LEAST });
        }
        for (place, pair) in time_s.windows(2).enumerate() {
            if !(pair[1] > pair[0] && pair[1].is_finite() && pair[0].is_finite()) {
                return Err(ReferenceError::Backwards { row: place + 2, time_s: pair[1] });
            }
        }
        let finite =
            |motion: &Motion| motion.gyro_rad_s.iter().chain(&motion.accel_m_s2).all(|value| value.is_finite());
        if let Some(place) = motions.iter().position(|motion| !finite(motion)) {
            return Err(ReferenceError::NotFinite { row: place + 1 });
        }
        let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let wide = |period_s: f64| move |step: &f64| *step > GAP_PERIODS * period_s;
        let period_s = median(&mut steps.clone());
        if let Some(place) = steps.iter().position(wide(period_s)) {
            return Err(ReferenceError::Gap { row: place + 2, gap_s: steps.swap_remove(place), period_s });
        }
        Ok(Self { time_s, motions })
    }

    /// Returns the time from the first row to the last, s.
    pub fn length_s(&self) -> f64 {
        self.time_s.last().zip(self.time_s.first()).map_or(0.0, |(last, first)| last - first)
    }

    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Returns whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Returns the motion `after_s` after the first row. Between rows, it lies on the cubic through the four rows about
    /// it (Lagrange); beyond the ends, it keeps the value at the end. `near` is the row from which the search starts,
    /// and becomes the row before.
    pub fn at(&self, after_s: f64, near: &mut usize) -> Motion {
        let count = self.time_s.len();
        let time_s = self.time_s.first().copied().unwrap_or_default() + after_s;
        let last = count.saturating_sub(2);
        *near = (*near).min(last);
        while *near > 0 && self.time_s[*near] > time_s {
            *near -= 1;
        }
        while *near < last && self.time_s[*near + 1] <= time_s {
            *near += 1;
        }
        let first = near.saturating_sub(1).min(count.saturating_sub(4));
        let time_s = time_s.clamp(self.time_s[0], self.time_s[count - 1]);
        let mut motion = Motion { temperature_c: self.motions[*near].temperature_c, ..Motion::default() };
        for node in first..(first + 4).min(count) {
            let others = (first..(first + 4).min(count)).filter(|other| *other != node);
            let own = self.time_s[node];
            let weight: f64 = others.map(|other| (time_s - self.time_s[other]) / (own - self.time_s[other])).product();
            for axis in 0..3 {
                motion.gyro_rad_s[axis] += weight * self.motions[node].gyro_rad_s[axis];
                motion.accel_m_s2[axis] += weight * self.motions[node].accel_m_s2[axis];
            }
        }
        motion
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(time_s: f64) -> (f64, Motion) {
        (time_s, Motion { gyro_rad_s: [time_s, time_s * time_s, 1.0], ..Motion::default() })
    }

    #[test]
    fn between_rows_a_parabola_is_exact_and_rows_are_themselves() {
        let reference = Reference::new((0..100).map(|index| row(0.1 * f64::from(index)))).unwrap();
        let mut near = 50;
        for after_s in [0.0, 0.1, 3.33, 9.9, 0.05] {
            let [x, y, z] = reference.at(after_s, &mut near).gyro_rad_s;
            assert!((x - after_s).abs() < 1e-12 && (y - after_s * after_s).abs() < 1e-12 && (z - 1.0).abs() < 1e-12);
        }
        assert!((reference.at(12.0, &mut near).gyro_rad_s[0] - 9.9).abs() < 1e-9);
    }

    #[test]
    fn rows_that_run_back_or_leave_a_gap_are_refused() {
        let rows =
            |change: &dyn Fn(usize) -> f64| Reference::new((0..100).map(|index| row(change(index)))).unwrap_err();
        let back = rows(&|index| if index == 40 { 0.0 } else { index as f64 });
        assert!(back.to_string().starts_with("row 41 of the reference"), "{back}");
        let gap = rows(&|index| index as f64 + if index >= 60 { 7.0 } else { 0.0 });
        assert!(gap.to_string().contains("8.000 s before its row 61"), "{gap}");
        assert!(Reference::new((0..3).map(|index| row(f64::from(index)))).is_err());
    }
}
