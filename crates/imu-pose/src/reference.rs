//! References: poses, and rates about one axis.

use crate::track::median_step;
use nalgebra::{UnitQuaternion, Vector3};

/// A step of this many median steps is a gap, between whose ends nothing is interpolated.
const GAP_STEPS: f64 = 12.0;

/// Attitudes, and positions if they are known, at increasing times.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Poses {
    /// The times, s, on the reference's clock.
    pub time_s: Vec<f64>,
    /// The rotation from the body's axes to the world's, of which z points up, at each time.
    pub attitude: Vec<UnitQuaternion<f64>>,
    /// The position of a point of the body in the world, m, at each time; empty if unknown.
    pub position_m: Vec<Vector3<f64>>,
}

impl Poses {
    /// Returns the middle of its time, s.
    pub(crate) fn middle_s(&self) -> f64 {
        self.time_s.first().zip(self.time_s.last()).map_or(0.0, |(first, last)| 0.5 * (first + last))
    }

    /// Returns the longest step that is interpolated, s.
    pub(crate) fn longest_step_s(&self) -> f64 {
        GAP_STEPS * self.period_s()
    }

    /// Returns the median step, s.
    pub(crate) fn period_s(&self) -> f64 {
        median_step(&self.time_s)
    }

    /// Returns the attitude at a time by spherical interpolation, and the place of the pose before it. `near` is the place from
    /// which the search starts. `None` outside the poses or in a gap.
    pub(crate) fn at(&self, time_s: f64, near: &mut usize, longest_s: f64) -> Option<UnitQuaternion<f64>> {
        let last = self.time_s.len().checked_sub(2)?;
        *near = (*near).min(last);
        while *near > 0 && self.time_s[*near] > time_s {
            *near -= 1;
        }
        while *near < last && self.time_s[*near + 1] <= time_s {
            *near += 1;
        }
        let [from, to] = [self.time_s[*near], self.time_s[*near + 1]];
        if time_s < from || time_s > to || to - from > longest_s {
            return None;
        }
        let part = (time_s - from) / (to - from);
        self.attitude[*near].try_slerp(&self.attitude[*near + 1], part, 1e-9).or(Some(self.attitude[*near]))
    }
}

/// Rates about one axis at increasing times.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rates {
    /// The axis: 0, 1 or 2 for x, y or z.
    pub axis: usize,
    /// The times, s, on the reference's clock.
    pub time_s: Vec<f64>,
    /// The rates, rad/s.
    pub rate_rad_s: Vec<f64>,
}
