//! Courses: motions that need no file.

use super::attitude::{Sequence, Turn};
use crate::simulator::Motion;
use imu_core::units::{RAD_PER_DEG, STANDARD_GRAVITY_M_S2};
use nalgebra::Vector3;

/// Rotation of the Earth relative to the stars, rad/s (WGS 84).
const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;
/// Duration of a quarter turn between two positions, s.
const QUARTER_TURN_S: f64 = 3.0;
/// Shortest rest in a position, s.
const SHORTEST_REST_S: f64 = 10.0;
/// Shortest rest in one of the many poses, s.
const SHORTEST_POSE_S: f64 = 4.0;
/// Number of poses, and the turns between them in quarters, in turn about x, y and z.
const POSES: usize = 24;
const POSE_QUARTERS: [f64; 4] = [0.7, 0.9, 0.6, 1.1];
/// The staircase's rates, °/s, in their order.
const STAIRS_DEG_S: [f64; 13] = [0.0, 25.0, 50.0, 100.0, 200.0, 100.0, 0.0, -25.0, -50.0, -100.0, -200.0, -100.0, 0.0];
/// Rate of change of the table's rate, °/s².
const TABLE_DEG_S2: f64 = 100.0;
/// Shortest time at one of the staircase's rates, s.
const SHORTEST_STAIR_S: f64 = 2.0;

/// The kind of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Level, at rest: gravity and Earth rate.
    Still,
    /// Six positions: each axis once down and once up, a sixth of the time each, with turns between them.
    Tumble,
    /// 24 poses, as a tumble by hand on faces, edges and corners has them, with turns about all axes between them.
    Poses,
    /// On a rate table, a third of the time with each axis down: the rates 0, 25, 50, 100, 200 °/s and back, in both directions.
    RateTable,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Still, Self::Tumble, Self::Poses, Self::RateTable];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Still => "still",
            Self::Tumble => "tumble",
            Self::Poses => "poses",
            Self::RateTable => "rate-table",
        }
    }

    /// Returns the kind of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// The place on Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Geodetic latitude, °, north positive.
    pub latitude_deg: f64,
    /// Gravity, m/s².
    pub gravity_m_s2: f64,
}

impl Default for Site {
    /// Returns 45° north with standard gravity, which is that of 45°.
    fn default() -> Self {
        Self { latitude_deg: 45.0, gravity_m_s2: STANDARD_GRAVITY_M_S2 }
    }
}

/// The reason why a motion cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CourseError {
    /// There is not enough time for the whole motion.
    #[error(
        "the motion `{kind}` needs {needed_s:.0} s or more, and {found_s} s are asked for: take a longer --duration"
    )]
    TooShort {
        /// The motion.
        kind: &'static str,
        /// The time that it needs, s.
        needed_s: f64,
        /// The available time, s.
        found_s: f64,
    },
}

/// A motion over time, known exactly at any time.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    sequence: Sequence,
    /// The Earth's rotation and the specific force that supports the sensor, north-east-down.
    earth_rad_s: Vector3<f64>,
    support_m_s2: Vector3<f64>,
}

impl Course {
    /// Returns the motion that fills `duration_s`.
    ///
    /// # Errors
    /// [`CourseError::TooShort`] if `duration_s` does not suffice.
    pub fn new(kind: Kind, duration_s: f64, site: Site) -> Result<Self, CourseError> {
        let sequence = match kind {
            Kind::Still => Sequence::new([]),
            Kind::Tumble => Sequence::new(tumble(kind, duration_s)?),
            Kind::Poses => Sequence::new(poses(kind, duration_s)?),
            Kind::RateTable => Sequence::new(rate_table(kind, duration_s)?),
        };
        let latitude = site.latitude_deg * RAD_PER_DEG;
        Ok(Self {
            sequence,
            earth_rad_s: EARTH_RATE_RAD_S * Vector3::new(latitude.cos(), 0.0, -latitude.sin()),
            support_m_s2: Vector3::new(0.0, 0.0, -site.gravity_m_s2),
        })
    }

    /// Returns angular rate and specific force at a time after the start, s.
    pub fn at(&self, time_s: f64) -> Motion {
        let (attitude, rate) = self.sequence.at(time_s);
        let into_sensor = attitude.inverse();
        let (gyro, accel) = (rate + into_sensor * self.earth_rad_s, into_sensor * self.support_m_s2);
        Motion { gyro_rad_s: gyro.into(), accel_m_s2: accel.into(), temperature_c: None }
    }

    /// Returns the motion at `rate_hz` from its beginning on, endlessly.
    pub fn sampled(self, rate_hz: f64) -> impl Iterator<Item = Motion> + Send {
        (0_u64..).map(move |index| self.at(index as f64 / rate_hz))
    }

    /// Returns the end of the last turn, s.
    pub fn moves_until_s(&self) -> f64 {
        self.sequence.duration_s()
    }
}

/// Returns turns by quarters, at a rate that rises and falls evenly.
fn quarters(axis: usize, count: f64) -> [Turn; 2] {
    let half_s = 0.5 * QUARTER_TURN_S * count;
    let peak = 0.5 * std::f64::consts::PI * count / half_s;
    [Turn::change(axis, 0.0, peak, half_s), Turn::change(axis, peak, 0.0, half_s)]
}

/// Returns the turns through z down, y down, z up, y up, x up, x down.
fn tumble(kind: Kind, duration_s: f64) -> Result<Vec<Turn>, CourseError> {
    let turns = [quarters(0, 1.0), quarters(0, 1.0), quarters(0, 1.0), quarters(2, 1.0), quarters(2, 2.0)];
    with_rests(kind, duration_s, &turns, SHORTEST_REST_S)
}

/// Returns the turns between many poses.
fn poses(kind: Kind, duration_s: f64) -> Result<Vec<Turn>, CourseError> {
    let turns: Vec<[Turn; 2]> =
        (1..POSES).map(|place| quarters(place % 3, POSE_QUARTERS[place % POSE_QUARTERS.len()])).collect();
    with_rests(kind, duration_s, &turns, SHORTEST_POSE_S)
}

/// Returns turns with rests of equal length before, between and after them.
fn with_rests(kind: Kind, duration_s: f64, turns: &[[Turn; 2]], shortest_s: f64) -> Result<Vec<Turn>, CourseError> {
    let rest_s = rest(kind, duration_s, turns.as_flattened(), turns.len() + 1, shortest_s)?;
    let mut course = vec![Turn::rest(rest_s)];
    for turn in turns {
        course.extend_from_slice(turn);
        course.push(Turn::rest(rest_s));
    }
    Ok(course)
}

/// Returns the turns with z, y and x down; in each, the whole staircase about that axis.
fn rate_table(kind: Kind, duration_s: f64) -> Result<Vec<Turn>, CourseError> {
    // The axis that points down, and the quarter turn that brings the next one there.
    let mounts = [(2, Some(0)), (1, Some(2)), (0, None)];
    let mut moves: Vec<Vec<Turn>> = Vec::new();
    for (axis, mount) in mounts {
        for pair in STAIRS_DEG_S.windows(2) {
            let seconds = (pair[1] - pair[0]).abs() / TABLE_DEG_S2;
            moves.push(vec![Turn::change(axis, pair[0] * RAD_PER_DEG, pair[1] * RAD_PER_DEG, seconds)]);
        }
        moves.extend(mount.map(|about| quarters(about, 1.0).to_vec()));
    }
    let stairs = 3 * STAIRS_DEG_S.len();
    let stair_s = rest(kind, duration_s, &moves.concat(), stairs, SHORTEST_STAIR_S)?;
    let mut course = Vec::new();
    let mut moves = moves.into_iter();
    for (axis, _) in mounts {
        for rate in STAIRS_DEG_S {
            course.push(Turn::steady(axis, rate * RAD_PER_DEG, stair_s));
            course.extend(moves.next().into_iter().flatten());
        }
    }
    Ok(course)
}

/// Returns the time for each of `count` rests.
fn rest(kind: Kind, duration_s: f64, turns: &[Turn], count: usize, shortest_s: f64) -> Result<f64, CourseError> {
    let turning_s: f64 = turns.iter().map(|turn| turn.duration_s).sum();
    let rest_s = (duration_s - turning_s) / count as f64;
    if rest_s >= shortest_s {
        return Ok(rest_s);
    }
    let needed_s = (turning_s + count as f64 * shortest_s).ceil();
    Err(CourseError::TooShort { kind: kind.name(), needed_s, found_s: duration_s })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(kind: Kind, duration_s: f64) -> Course {
        Course::new(kind, duration_s, Site { latitude_deg: 60.0, gravity_m_s2: 9.8 }).unwrap()
    }

    #[test]
    fn lying_still_it_feels_gravity_and_the_earths_rotation() {
        let motion = course(Kind::Still, 1.0).at(1e6);
        assert_eq!(motion.accel_m_s2, [0.0, 0.0, -9.8]);
        let [north, east, down] = motion.gyro_rad_s;
        assert!((north - 0.5 * EARTH_RATE_RAD_S).abs() < 1e-12 && east == 0.0);
        assert!((down + 0.75_f64.sqrt() * EARTH_RATE_RAD_S).abs() < 1e-12);
    }

    #[test]
    fn a_tumble_rests_equally_long_in_six_positions() {
        let course = course(Kind::Tumble, 600.0);
        let rest_s = (600.0 - 6.0 * QUARTER_TURN_S) / 6.0;
        let mut seen = Vec::new();
        for position in 0..6 {
            let before = [0.0, 1.0, 2.0, 3.0, 4.0, 6.0][position] * QUARTER_TURN_S;
            let motion = course.at(position as f64 * rest_s + before + 0.5 * rest_s);
            let rate: f64 = motion.gyro_rad_s.iter().map(|rate| rate * rate).sum::<f64>().sqrt();
            assert!((rate - EARTH_RATE_RAD_S).abs() < 1e-12, "{position}: {rate}");
            let along = (0..3).find(|axis| motion.accel_m_s2[*axis].abs() > 9.79).unwrap();
            seen.push((along, motion.accel_m_s2[along] < 0.0));
            let others: f64 = (0..3).filter(|axis| *axis != along).map(|axis| motion.accel_m_s2[axis].abs()).sum();
            assert!(others < 1e-9, "{motion:?}");
        }
        assert_eq!(seen, [(2, true), (1, true), (2, false), (1, false), (0, false), (0, true)]);
        assert!((course.moves_until_s() - 600.0).abs() < 1e-9);
    }

    #[test]
    fn many_poses_are_twenty_apart_by_eight_degrees_and_all_axes_turn() {
        let course = course(Kind::Poses, 300.0);
        let mut seen: Vec<Vector3<f64>> = Vec::new();
        let mut turned = [0.0; 3];
        for tenth in 0..3000 {
            let motion = course.at(f64::from(tenth) * 0.1);
            let rate = Vector3::from(motion.gyro_rad_s);
            (0..3).for_each(|axis| turned[axis] += 0.1 * rate[axis].abs());
            let force = Vector3::from(motion.accel_m_s2);
            if rate.norm() < 1e-3 && seen.iter().all(|other| other.angle(&force) > 8.0 * RAD_PER_DEG) {
                seen.push(force);
            }
        }
        assert!(seen.len() >= 20, "{} poses", seen.len());
        assert!(turned.iter().all(|angle| *angle > 6.0), "{turned:?}");
    }

    #[test]
    fn a_rate_table_drives_every_stair_about_every_axis_with_gravity_along_it() {
        let course = course(Kind::RateTable, 1800.0);
        let mut driven = [const { Vec::new() }; 3];
        for second in 0..18_000 {
            let motion = course.at(f64::from(second) * 0.1);
            for (axis, seen) in driven.iter_mut().enumerate() {
                let rate = (motion.gyro_rad_s[axis] / RAD_PER_DEG).round();
                let steady = (motion.gyro_rad_s[axis] / RAD_PER_DEG - rate).abs() < 0.01;
                if (motion.accel_m_s2[axis] + 9.8).abs() < 1e-6 && steady && seen.last() != Some(&rate) {
                    seen.push(rate);
                }
            }
        }
        for seen in driven {
            for stair in STAIRS_DEG_S {
                assert!(seen.contains(&stair), "{stair} in {seen:?}");
            }
        }
        assert!((course.moves_until_s() - 1800.0).abs() < 1e-6);
    }

    #[test]
    fn a_motion_without_time_for_it_is_refused_with_what_it_needs() {
        for kind in [Kind::Tumble, Kind::Poses, Kind::RateTable] {
            let refused = Course::new(kind, 30.0, Site::default()).unwrap_err();
            let CourseError::TooShort { needed_s, .. } = refused;
            assert!(refused.to_string().contains(kind.name()) && refused.to_string().contains("30 s"), "{refused}");
            assert!(Course::new(kind, needed_s, Site::default()).is_ok());
        }
        assert!(Course::new(Kind::Still, 0.1, Site::default()).is_ok());
    }
}
