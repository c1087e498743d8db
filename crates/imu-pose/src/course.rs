//! Course: the angular rate and the specific force of a body that moves along poses, for a simulator.
//!
//! Both are derivatives. They are those of polynomials that are fitted to the poses about each instant, so that the noise of the poses
//! does not become noise of the rate.
//!
//! # Source
//! Local polynomials: Savitzky and Golay 1964, on the tangent space of the attitude.

use crate::reference::Poses;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

/// Half of the time over which a polynomial is fitted, s.
const HALF_S: f64 = 0.06;
/// The least number of poses in it, and half of the longest time over which they are sought, s.
const LEAST: usize = 8;
const LONGEST_HALF_S: f64 = 0.4;
/// Powers of the polynomial.
const POWERS: usize = 5;
/// Rounds in which the attitude about which angles count is found.
const ROUNDS: usize = 2;

/// The motion at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instant {
    /// Time on the reference's clock, s.
    pub time_s: f64,
    /// Angular rate in the body's axes, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Specific force in the body's axes, m/s²; gravity's alone if there are no positions.
    pub force_m_s2: Vector3<f64>,
}

/// The reason why poses give no motion.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CourseError {
    /// Too few poses about an instant.
    #[error(
        "the poses have a gap at {time_s:.2} s: {LEAST} poses within {LONGEST_HALF_S} s are needed for a rate and a specific force; cut the \
         reference there"
    )]
    Gap {
        /// The instant, s.
        time_s: f64,
    },
}

/// Returns the motion at this rate, from the first pose to the last.
///
/// # Errors
/// [`CourseError`] if the poses have a gap.
///
/// # Validation
/// `tests` below: the rate and force of a motion that is known.
pub fn course(poses: &Poses, rate_hz: f64) -> Result<Vec<Instant>, CourseError> {
    let (Some(first), Some(last)) = (poses.time_s.first(), poses.time_s.last()) else { return Ok(Vec::new()) };
    let count = ((last - first) * rate_hz).floor() as usize;
    (0..=count).map(|index| at(poses, first + index as f64 / rate_hz)).collect()
}

fn at(poses: &Poses, time_s: f64) -> Result<Instant, CourseError> {
    let within = |half_s: f64| {
        let from = poses.time_s.partition_point(|own| *own < time_s - half_s);
        from..poses.time_s.partition_point(|own| *own <= time_s + half_s)
    };
    let mut half_s = HALF_S;
    while within(half_s).len() < LEAST {
        half_s *= 1.25;
        if half_s > LONGEST_HALF_S {
            return Err(CourseError::Gap { time_s });
        }
    }
    let places = within(half_s);
    let powers = DMatrix::from_fn(places.len(), POWERS, |row, power| {
        ((poses.time_s[places.start + row] - time_s) / half_s).powi(power as i32)
    });
    let solver = powers.svd(true, true);
    // The polynomial's value, its slope and its curvature in the middle.
    let fitted = |values: &dyn Fn(usize) -> Vector3<f64>| {
        let numbers = [0, 1, 2].map(|axis| {
            let values = DVector::from_iterator(places.len(), places.clone().map(|place| values(place)[axis]));
            solver.solve(&values, 1e-12).unwrap_or_else(|_| DVector::zeros(POWERS))
        });
        [(0, 1.0), (1, 1.0 / half_s), (2, 2.0 / (half_s * half_s))]
            .map(|(power, factor)| Vector3::from_fn(|axis, _| factor * numbers[axis][power]))
    };
    let mut attitude = poses.attitude[places.start + places.len() / 2];
    let mut rate_rad_s = Vector3::zeros();
    for _ in 0..ROUNDS {
        let about = attitude.inverse();
        let [off, slope, _] = fitted(&|place| (about * poses.attitude[place]).scaled_axis());
        attitude *= UnitQuaternion::from_scaled_axis(off);
        // The rate of a rotation vector in the body's axes, to first order in what is left of it.
        rate_rad_s = (Matrix3::identity() - 0.5 * off.cross_matrix()) * slope;
    }
    let moved = match poses.position_m.is_empty() {
        true => Vector3::zeros(),
        false => fitted(&|place| poses.position_m[place])[2],
    };
    let force_m_s2 = attitude.inverse() * (moved + Vector3::z() * STANDARD_GRAVITY_M_S2);
    Ok(Instant { time_s, rate_rad_s, force_m_s2 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attitude(t: f64) -> UnitQuaternion<f64> {
        let turn = |axis, size: f64, hz: f64| {
            UnitQuaternion::from_scaled_axis(Vector3::ith(axis, size * (std::f64::consts::TAU * hz * t).sin()))
        };
        turn(2, 1.0, 0.3) * turn(1, 0.9, 0.5) * turn(0, 1.1, 0.7)
    }

    fn position(t: f64) -> Vector3<f64> {
        Vector3::new(0.3 * (1.9 * t).sin(), 0.25 * (2.6 * t).sin(), 0.2 * (5.3 * t).cos())
    }

    #[test]
    fn a_known_motion_has_its_rate_and_its_force() {
        let time_s: Vec<f64> = (0..1200).map(|place| f64::from(place) / 120.0).collect();
        let poses = Poses {
            attitude: time_s.iter().map(|t| attitude(*t)).collect(),
            position_m: time_s.iter().map(|t| position(*t)).collect(),
            time_s,
        };
        let rows = course(&poses, 200.0).unwrap();
        assert_eq!(rows.len(), 1999);
        for row in &rows[20..rows.len() - 20] {
            let t = row.time_s;
            let rate = (attitude(t - 1e-5).inverse() * attitude(t + 1e-5)).scaled_axis() / 2e-5;
            let moved = (position(t + 1e-3) - 2.0 * position(t) + position(t - 1e-3)) / 1e-6;
            let force = attitude(t).inverse() * (moved + Vector3::z() * STANDARD_GRAVITY_M_S2);
            assert!((row.rate_rad_s - rate).norm() < 2e-3, "{t}: {} {rate}", row.rate_rad_s);
            assert!((row.force_m_s2 - force).norm() < 2e-2, "{t}: {} {force}", row.force_m_s2);
        }
    }

    #[test]
    fn poses_with_a_gap_are_refused_at_its_time() {
        let time_s: Vec<f64> =
            (0..1200).filter(|place| !(500..650).contains(place)).map(|of| f64::from(of) / 120.0).collect();
        let poses = Poses { attitude: time_s.iter().map(|t| attitude(*t)).collect(), position_m: Vec::new(), time_s };
        let CourseError::Gap { time_s } = course(&poses, 100.0).unwrap_err();
        assert!((4.1..5.5).contains(&time_s), "{time_s}");
    }
}
