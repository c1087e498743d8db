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
    /// The longest step that is no gap, if the samples are no longer the sensor's own.
    pub(crate) longest_s: Option<f64>,
}

impl Track {
    /// Creates a track of samples at increasing stamps, s. `accel` has as many values or none.
    pub fn new(time_s: Vec<f64>, gyro: Vec<Vector3<f64>>, accel: Vec<Vector3<f64>>) -> Self {
        Self { time_s, gyro, accel, longest_s: None }
    }

    /// Returns the median step, s.
    pub(crate) fn period_s(&self) -> f64 {
        median_step(&self.time_s)
    }

    /// Returns the longest step that is no gap, s.
    pub(crate) fn longest_step_s(&self) -> f64 {
        self.longest_s.unwrap_or(GAP_STEPS * self.period_s())
    }

    /// Returns the track with three more samples in each step, on the cubic through the four samples about it (Lagrange). On straight
    /// lines a motion that bends between samples would turn less.
    pub(crate) fn refined(&self) -> Self {
        let longest_s = self.longest_step_s();
        let mut found = Self { longest_s: Some(longest_s), ..Self::default() };
        let count = self.time_s.len();
        for place in 0..count {
            let mut put = |time_s: f64, weights: &[(usize, f64)]| {
                let of = |values: &[Vector3<f64>]| {
                    weights.iter().map(|(at, weight)| values[*at] * *weight).sum::<Vector3<f64>>()
                };
                found.time_s.push(time_s);
                found.gyro.push(of(&self.gyro));
                if !self.accel.is_empty() {
                    found.accel.push(of(&self.accel));
                }
            };
            put(self.time_s[place], &[(place, 1.0)]);
            let Some(first) = place.checked_sub(1).filter(|first| first + 3 < count) else { continue };
            let nodes = &self.time_s[first..first + 4];
            if nodes.windows(2).any(|pair| pair[1] - pair[0] > longest_s) {
                continue;
            }
            for part in [0.25, 0.5, 0.75] {
                let time_s = nodes[1] + part * (nodes[2] - nodes[1]);
                let weight = |node: usize| {
                    let others = (0..4).filter(|other| *other != node);
                    others.map(|other| (time_s - nodes[other]) / (nodes[node] - nodes[other])).product::<f64>()
                };
                put(time_s, &[0, 1, 2, 3].map(|node| (first + node, weight(node))));
            }
        }
        found
    }

    /// Returns the gyroscope's track with every other sample.
    pub(crate) fn every_other(&self) -> Self {
        let time_s = self.time_s.iter().step_by(2).copied().collect();
        Self::new(time_s, self.gyro.iter().step_by(2).copied().collect(), Vec::new())
    }

    /// Returns the axis on which all values are the same, if there is one.
    pub(crate) fn dead(of: &[Vector3<f64>]) -> Option<usize> {
        (0..3).find(|axis| of.windows(2).all(|pair| pair[0][*axis] == pair[1][*axis]))
    }

    /// Returns the parts of the straight lines between samples in `[from_s, to_s]`, each with its duration, s, and the value in
    /// its middle. `None` if a gap, a sample without a number or the track's end is in between.
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
            if !value.iter().all(|of| of.is_finite()) {
                return None;
            }
            parts.push(Part { seconds: other_s - one_s, middle_s: 0.5 * (one_s + other_s), value });
        }
        Some(parts)
    }
}

/// Returns the median step of increasing times; 0 without a step.
pub(crate) fn median_step(time_s: &[f64]) -> f64 {
    let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let middle = steps.len() / 2;
    if steps.is_empty() { 0.0 } else { *steps.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// A part of a line between two samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) seconds: f64,
    pub(crate) middle_s: f64,
    pub(crate) value: Vector3<f64>,
}
