//! Tracks: a sensor's samples with their stamps.

use nalgebra::Vector3;

/// A step of this many median steps is a gap, over which nothing is integrated.
const GAP_STEPS: f64 = 3.5;

/// The samples of a gyroscope and, if there is one, an accelerometer at increasing stamps.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Track {
    /// The stamps, s.
    pub time_s: Vec<f64>,
    /// Angular rates, in the unit of the recording.
    pub gyro: Vec<Vector3<f64>>,
    /// Specific forces, in the unit of the recording; empty if there is no accelerometer.
    pub accel: Vec<Vector3<f64>>,
}

impl Track {
    /// Returns the median step, s.
    pub(crate) fn period_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let middle = steps.len() / 2;
        if steps.is_empty() {
            return 0.0;
        }
        *steps.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Returns the longest step that is no gap, s.
    pub(crate) fn longest_step_s(&self) -> f64 {
        GAP_STEPS * self.period_s()
    }

    /// Returns the parts of the straight lines between samples in `[from_s, to_s]`, each with its duration, s, and the value in
    /// its middle. `None` if a gap or the track's end is in between.
    pub(crate) fn parts(&self, of: &[Vector3<f64>], from_s: f64, to_s: f64, longest_s: f64) -> Option<Vec<Part>> {
        let begin = self.time_s.partition_point(|time_s| *time_s <= from_s).checked_sub(1)?;
        let end = self.time_s.partition_point(|time_s| *time_s < to_s);
        if end >= self.time_s.len() {
            return None;
        }
        let mut parts = Vec::with_capacity(end - begin);
        for place in begin..end {
            let (start_s, stop_s) = (self.time_s[place], self.time_s[place + 1]);
            if stop_s - start_s > longest_s {
                return None;
            }
            let (one_s, other_s) = (start_s.max(from_s), stop_s.min(to_s));
            let middle = (0.5 * (one_s + other_s) - start_s) / (stop_s - start_s);
            let value = of[place] * (1.0 - middle) + of[place + 1] * middle;
            parts.push(Part { seconds: other_s - one_s, middle_s: 0.5 * (one_s + other_s), value });
        }
        Some(parts)
    }
}

/// A part of a line between two samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) seconds: f64,
    pub(crate) middle_s: f64,
    pub(crate) value: Vector3<f64>,
}
