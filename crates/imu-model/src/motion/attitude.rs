//! Attitude: a sequence of turns, each about one of the sensor's axes, known exactly at any time.

use nalgebra::{UnitQuaternion, Vector3};

/// A turn about one of the sensor's axes whose rate changes evenly from one value to another. A turn at rate 0 is a
/// rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turn {
    /// The axis: 0, 1 or 2 for x, y or z.
    pub(super) axis: usize,
    pub(super) duration_s: f64,
    /// Rate at the beginning and the end, rad/s.
    pub(super) rate_rad_s: [f64; 2],
}

impl Turn {
    /// Returns a rest.
    pub(super) fn rest(duration_s: f64) -> Self {
        Self::steady(0, 0.0, duration_s)
    }

    /// Returns a turn at one rate.
    pub(super) fn steady(axis: usize, rate_rad_s: f64, duration_s: f64) -> Self {
        Self { axis, duration_s, rate_rad_s: [rate_rad_s; 2] }
    }

    /// Returns a turn whose rate changes from one value to another.
    pub(super) fn change(axis: usize, from_rad_s: f64, to_rad_s: f64, duration_s: f64) -> Self {
        Self { axis, duration_s, rate_rad_s: [from_rad_s, to_rad_s] }
    }

    fn unit(&self) -> Vector3<f64> {
        Vector3::ith(self.axis, 1.0)
    }

    /// Returns rate and angle `time_s` after the beginning.
    fn at(&self, time_s: f64) -> (f64, f64) {
        let [from, to] = self.rate_rad_s;
        if self.duration_s <= 0.0 {
            return (to, 0.0);
        }
        let slope = (to - from) / self.duration_s;
        (from + slope * time_s, (from + 0.5 * slope * time_s) * time_s)
    }
}

/// The attitude and rate of the sensor, turn after turn; after the last turn the sensor rests.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sequence {
    /// Each turn with its beginning and the attitude then (sensor to north-east-down).
    turns: Vec<(f64, UnitQuaternion<f64>, Turn)>,
    end: (f64, UnitQuaternion<f64>),
}

impl Sequence {
    /// Creates a sequence that begins level and facing north at time 0.
    pub(super) fn new(turns: impl IntoIterator<Item = Turn>) -> Self {
        let mut end = (0.0, UnitQuaternion::identity());
        let begun = |turn: Turn| {
            let begins = (end.0, end.1, turn);
            let (_, angle) = turn.at(turn.duration_s);
            end = (end.0 + turn.duration_s, end.1 * UnitQuaternion::from_scaled_axis(turn.unit() * angle));
            begins
        };
        let turns = turns.into_iter().map(begun).collect();
        Self { turns, end }
    }

    /// Returns the attitude (sensor to north-east-down) and the rate in the sensor's axes (rad/s, relative to the
    /// Earth) at a time.
    pub(super) fn at(&self, time_s: f64) -> (UnitQuaternion<f64>, Vector3<f64>) {
        if time_s >= self.end.0 {
            return (self.end.1, Vector3::zeros());
        }
        let index = self.turns.partition_point(|(begin_s, ..)| *begin_s <= time_s).saturating_sub(1);
        let Some((begin_s, attitude, turn)) = self.turns.get(index) else { return (self.end.1, Vector3::zeros()) };
        let (rate, angle) = turn.at((time_s - begin_s).max(0.0));
        (attitude * UnitQuaternion::from_scaled_axis(turn.unit() * angle), turn.unit() * rate)
    }

    /// Returns the end of the last turn, s.
    pub(super) fn duration_s(&self) -> f64 {
        self.end.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn rates_integrate_to_the_attitude() {
        let sequence = Sequence::new([
            Turn::rest(1.0),
            Turn::change(0, 0.0, 0.8, 2.0),
            Turn::steady(0, 0.8, 3.0),
            Turn::change(2, 0.5, -0.3, 4.0),
        ]);
        assert_eq!(sequence.duration_s(), 10.0);
        let step_s = 1e-4;
        let mut attitude = UnitQuaternion::identity();
        for index in 0..110_000 {
            // The rate at the middle of a step is exact for one that changes evenly.
            let (_, rate) = sequence.at((f64::from(index) + 0.5) * step_s);
            attitude *= UnitQuaternion::from_scaled_axis(rate * step_s);
        }
        let (expected, rate) = sequence.at(11.0);
        assert!(attitude.angle_to(&expected) < 1e-6, "{}", attitude.angle_to(&expected));
        assert_eq!(rate, Vector3::zeros());
    }

    #[test]
    fn a_quarter_turn_about_x_lets_y_point_down() {
        let sequence = Sequence::new([Turn::steady(0, FRAC_PI_2, 1.0)]);
        let down_seen = sequence.at(2.0).0.inverse() * Vector3::new(0.0, 0.0, 1.0);
        assert!((down_seen - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-12, "{down_seen}");
    }
}
