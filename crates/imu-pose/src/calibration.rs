//! Calibration: what poses or rates show of a sensor, one stage after the other.

use crate::accel;
use crate::error::PoseError;
use crate::fit::{Solution, weight};
use crate::frames::{Frames, Unit, frames};
use crate::gyro;
use crate::rate;
use crate::reference::{Poses, Rates};
use crate::rough::{Rough, matrix, rough};
use crate::track::Track;
use crate::triad::{Estimate, OFF, Stated, TriadFit, plain, triad, vector};
use imu_core::units::STANDARD_GRAVITY_M_S2;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::Serialize;

/// The other reading of a quaternion is taken if it leaves less than this part of the residuals.
const CLEARLY_LESS: f64 = 0.5;
/// Widest interval of a bias that counts as determined: of a rate, rad/s, and of a specific force, m/s².
const WIDEST_RATE_BIAS: f64 = 0.02;
const WIDEST_FORCE_BIAS: f64 = 0.3;
/// Between poses that are further apart, an attitude on the straight line is too far off, s.
const SELDOM_S: f64 = 0.035;
/// A reference with at least this part of its windows far off is refused.
const OFF_MOST: f64 = 0.03;
/// An offset below this is a delay on one clock, s.
pub(crate) const SAME_CLOCK_S: f64 = 0.1;
/// The gyroscope's axes are the accelerometer's if they leave no more than this many times what others leave.
const LIKELY: f64 = 1.2;
/// Length of the windows in which the direction of gravity is compared, s.
const GRAVITY_WINDOW_S: f64 = 0.5;

/// A stretch of time in which sensor and reference contradict each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Stretch {
    /// The beginning on the reference's clock, s.
    pub from_s: f64,
    /// The end, s.
    pub to_s: f64,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Calibration {
    /// The gyroscope. Against a rate, only the numbers of its axis are determined.
    pub gyro: TriadFit,
    /// The accelerometer, if there is one and positions are known.
    pub accel: Option<TriadFit>,
    /// Axes, sign and unit of an accelerometer without positions, from the direction of gravity.
    pub accel_frames: Option<Frames>,
    /// From the accelerometer to the point whose positions are known, m.
    pub arm_m: Option<[Estimate; 3]>,
    /// Whether the quaternions turn the world's axes to the body's, unlike what is expected.
    pub inverse_quaternions: bool,
    /// Whether z of the world points down.
    pub world_down: bool,
    /// Where gyroscope and reference contradict each other.
    pub off: Vec<Stretch>,
    /// How much faster the recording's clock runs than the reference's; `None` beside rates.
    pub clock_rate: Option<Estimate>,
    /// Whether another offset of the clocks, a period of the motion away, fits as well.
    pub is_ambiguous: bool,
    /// Why the accelerometer was not compared, if it was not.
    pub without_accel: Option<&'static str>,
}

impl Calibration {
    /// Returns whether sensor and reference are on one clock: all delays are small, and no clock is faster by `certain` half widths of
    /// its interval.
    pub fn is_one_clock(&self, certain: f64) -> bool {
        let is_one_rate = self.clock_rate.is_none_or(|of| of.value.abs() <= certain * of.half());
        let fits = std::iter::once(&self.gyro).chain(&self.accel);
        is_one_rate && fits.into_iter().all(|fit| fit.later_s.value.abs() < SAME_CLOCK_S)
    }
}

/// The deviations that a model states of gyroscope and accelerometer: the gap is what they leave.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StatedSensor {
    /// Of the gyroscope.
    pub gyro: Stated,
    /// Of the accelerometer.
    pub accel: Stated,
}

/// Compares a sensor with poses. The gap counts from what `stated` has; the numbers do not depend on it.
///
/// # Errors
/// [`PoseError`] if they have too little in common, or the reference turns too little.
///
/// # Validation
/// `tests.rs`: simulated motions with noise of the poses give the numbers back within their intervals. BROAD, RepoIMU in
/// docs/motion-diagnosis.md.
pub fn against_poses(track: &Track, poses: &Poses, stated: &StatedSensor) -> Result<Calibration, PoseError> {
    checked(track, poses.time_s.len(), 3)?;
    if let Some(axis) = Track::dead(&track.gyro) {
        return Err(PoseError::Dead { channel: format!("gyro_{}", ["x", "y", "z"][axis]) });
    }
    let track = &track.refined();
    let inverted = Poses { attitude: poses.attitude.iter().map(UnitQuaternion::inverse).collect(), ..poses.clone() };
    let (first, second) = (fitted(track, poses), fitted(track, &inverted));
    let rms =
        |of: &Result<(Solution, Rough), PoseError>| of.as_ref().map_or(f64::INFINITY, |(solution, _)| solution.rms());
    let inverse_quaternions = rms(&second) < CLEARLY_LESS * rms(&first);
    let (poses, found) = if inverse_quaternions { (&inverted, second) } else { (poses, first) };
    let (solution, rough) = found?;
    let none = || PoseError::Still { found_deg: rough.turning.norm().to_degrees(), least_deg: 20.0 };
    let mut gyro = triad(&solution, gyro::LAG, true, WIDEST_RATE_BIAS).ok_or_else(none)?;
    gyro.gap = solution.gap(&gyro::windows(
        track,
        poses,
        &plain(&solution, &gyro, gyro::LAG, one_clock(&gyro, &stated.gyro), &stated.gyro),
    ));
    refused(&gyro, &solution)?;
    if gyro.frames.unit == Unit::Unknown {
        return Err(PoseError::Ratio { ratio: gyro.frames.factor });
    }
    gyro.is_timed &= !rough.is_ambiguous;
    let mut found = Calibration {
        clock_rate: Some(Estimate::of(&solution, &|numbers| numbers[gyro::DRIFT])),
        is_ambiguous: rough.is_ambiguous,
        without_accel: None,
        off: stretches(&solution),
        gyro,
        accel: None,
        accel_frames: None,
        arm_m: None,
        inverse_quaternions,
        world_down: false,
    };
    if track.accel.len() == track.time_s.len() && Track::dead(&track.accel).is_some() {
        found.without_accel = Some("an axis of it shows the same value throughout");
    } else if track.accel.len() == track.time_s.len() && poses.period_s() > SELDOM_S && !poses.position_m.is_empty() {
        found.without_accel = Some("the poses come too seldom for second differences (30 a second are needed)");
    } else if track.accel.len() == track.time_s.len() {
        accelerometer(&mut found, track, &gyro::smoothed(track, poses, &solution.numbers), stated);
    }
    Ok(found)
}

/// Returns the offset of both clocks that is no delay of the sensor: none if the sensor is late by less than [`SAME_CLOCK_S`], else what the
/// gyroscope has beyond its stated latency.
fn one_clock(gyro: &TriadFit, stated: &Stated) -> f64 {
    let later_s = gyro.later_s.value;
    if later_s.abs() < SAME_CLOCK_S { 0.0 } else { later_s - stated.later_s }
}

fn checked(track: &Track, poses: usize, least: usize) -> Result<(), PoseError> {
    if track.gyro.len() != track.time_s.len() || track.time_s.len() < least {
        return Err(PoseError::Channel { channel: "gyroscope of three axes".to_owned() });
    }
    if poses < least {
        return Err(PoseError::Overlap { found_s: 0.0, least_s: 5.0 });
    }
    Ok(())
}

fn fitted(track: &Track, poses: &Poses) -> Result<(Solution, Rough), PoseError> {
    let rough = rough(track, poses)?;
    let solution = gyro::fit(track, poses, &rough).ok_or(PoseError::Overlap { found_s: 0.0, least_s: 5.0 })?;
    Ok((solution, rough))
}

fn accelerometer(found: &mut Calibration, track: &Track, poses: &Poses, stated: &StatedSensor) {
    let lag_s = found.gyro.later_s.value;
    let Some(rough) = by_gravity(track, poses, lag_s, &found.gyro) else {
        found.without_accel = Some("its samples and the poses have too little time in common");
        return;
    };
    if poses.position_m.is_empty() {
        let of = rough.svd(true, true);
        if let (Some(left), Some(right)) = (of.u, of.v_t) {
            // Without positions, a lively hand is noise here: what is no known unit is not stated.
            let of = frames(&(left * right), of.singular_values.mean(), false);
            found.accel_frames = Some(of).filter(|of| of.unit != Unit::Unknown);
        }
        return;
    }
    let up = accel::fit(track, poses, &rough, lag_s, 1.0);
    let down = accel::fit(track, poses, &-rough, lag_s, -1.0);
    let rms = |of: &Option<Solution>| of.as_ref().map_or(f64::INFINITY, Solution::rms);
    found.world_down = rms(&down) < CLEARLY_LESS * rms(&up);
    let Some(solution) = (if found.world_down { down } else { up }) else {
        found.without_accel = Some("attitudes and positions do not determine it");
        return;
    };
    found.accel = triad(&solution, accel::LAG, false, WIDEST_FORCE_BIAS).map(|mut of| {
        // The delay of the gyroscope against the reference's clock is that of both clocks if they are two.
        let lag_s = one_clock(&found.gyro, &stated.gyro);
        of.gap = solution.gap(&accel::windows(track, poses, &plain(&solution, &of, accel::LAG, lag_s, &stated.accel)));
        of
    });
    if found.accel.as_ref().is_some_and(|of| of.frames.unit == Unit::Unknown) {
        found.accel = None;
        found.without_accel = Some("its values are a multiple of the reference's that is no known unit");
        return;
    }
    found.arm_m =
        Some(std::array::from_fn(|axis| Estimate::of(&solution, &|numbers| vector(numbers, accel::ARM)[axis])));
    found.accel_frames = found.accel.as_ref().map(|of| of.frames.clone());
}

/// Returns the accelerometer's matrix by the direction of gravity in the body's axes.
fn by_gravity(track: &Track, poses: &Poses, lag_s: f64, gyro: &TriadFit) -> Option<Matrix3<f64>> {
    let (first, last) = (*poses.time_s.first()?, *poses.time_s.last()?);
    let [longest_pose_s, longest_s] = [poses.longest_step_s(), track.longest_step_s()];
    let mut near = 0;
    let mut pairs = Vec::new();
    for place in 0..((last - first) / GRAVITY_WINDOW_S) as usize {
        let from_s = first + place as f64 * GRAVITY_WINDOW_S;
        let Some(parts) = track.parts(&track.accel, from_s + lag_s, from_s + GRAVITY_WINDOW_S + lag_s, longest_s)
        else {
            continue;
        };
        let (mut up, mut force, mut all) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        for part in parts.iter().step_by(4) {
            let Some(attitude) = poses.at(part.middle_s - lag_s, &mut near, longest_pose_s) else { continue };
            up += attitude.inverse() * Vector3::z() * STANDARD_GRAVITY_M_S2;
            force += part.value;
            all += 1.0;
        }
        if all > 0.0 {
            pairs.push((up / all, force / all));
        }
    }
    if pairs.is_empty() {
        return None;
    }
    let (found, spread) = matrix(&pairs);
    let mean = pairs.iter().map(|(_, force)| force.norm()).sum::<f64>() / pairs.len() as f64;
    let size = mean / STANDARD_GRAVITY_M_S2;
    // Close to one direction, the axes are the gyroscope's, and the unit is that of gravity.
    if spread.norm() <= 0.2 * STANDARD_GRAVITY_M_S2 {
        return Some(gyro.frames.matrix() * size);
    }
    // A hand's own accelerations stretch the matrix: its rotation is what counts, and the size is that of gravity.
    let of = found.svd(true, true);
    let own = of.u? * of.v_t?;
    // If gravity kept to a plane, the sign of the third axis does not show: the gyroscope's axes are then the accelerometer's.
    let same = gyro.frames.matrix();
    let off = |rotation: &Matrix3<f64>| {
        pairs.iter().map(|(up, force)| (force - rotation * up * size).norm_squared()).sum::<f64>()
    };
    Some(if off(&same) < LIKELY * off(&own) { same } else { own } * size)
}

/// Refuses a reference that contradicts the sensor in too many windows.
fn refused(gyro: &TriadFit, solution: &Solution) -> Result<(), PoseError> {
    if gyro.off < OFF_MOST {
        return Ok(());
    }
    let all = stretches(solution);
    let named: Vec<String> = all.iter().take(8).map(|of| format!("{:.1} to {:.1} s", of.from_s, of.to_s)).collect();
    let more = all.len().saturating_sub(named.len());
    let more = if more > 0 { format!(" and in {more} more stretches") } else { String::new() };
    Err(PoseError::Bad { percent: 100.0 * gyro.off, stretches: named.join(", ") + &more })
}

/// Returns the stretches in which windows are far off.
fn stretches(solution: &Solution) -> Vec<Stretch> {
    let off = solution.windows.iter().filter(|window| weight(window, &solution.scales).1 > OFF);
    joined(off.map(|window| window.middle_s), 0.25, 1.0)
}

/// Returns the stretches about increasing times, `half_s` to either side, joined if less than `between_s` is between them.
pub(crate) fn joined(times_s: impl Iterator<Item = f64>, half_s: f64, between_s: f64) -> Vec<Stretch> {
    let mut found: Vec<Stretch> = Vec::new();
    for time_s in times_s {
        let (from_s, to_s) = (time_s - half_s, time_s + half_s);
        match found.last_mut() {
            Some(last) if from_s - last.to_s < between_s => last.to_s = to_s,
            _ => found.push(Stretch { from_s, to_s }),
        }
    }
    found
}

/// Compares a gyroscope with rates about one of its axes. The gap counts from what `stated` has. Delay and lag of the reference itself are in `later_s`.
///
/// # Errors
/// [`PoseError`] as [`against_poses`].
///
/// # Validation
/// `tests.rs`: a gyroscope on a motor with its encoder (asen3801 of the real recordings).
pub fn against_rates(track: &Track, rates: &Rates, stated: &Stated) -> Result<Calibration, PoseError> {
    checked(track, rates.time_s.len(), 3)?;
    let track = &track.refined();
    let axis = Vector3::ith(rates.axis, 1.0);
    let mut angle = 0.0;
    let mut attitude = vec![UnitQuaternion::identity()];
    for (pair, steps) in rates.rate_rad_s.windows(2).zip(rates.time_s.windows(2)) {
        angle += 0.5 * (pair[0] + pair[1]) * (steps[1] - steps[0]);
        attitude.push(UnitQuaternion::from_scaled_axis(axis * angle));
    }
    let poses = Poses { time_s: rates.time_s.clone(), attitude, position_m: Vec::new() };
    let rough = rough(track, &poses)?;
    let factor = 1.0 / rough.matrix[(rates.axis, rates.axis)];
    let solution =
        rate::fit(track, rates, factor, rough.lag_s).ok_or(PoseError::Overlap { found_s: 0.0, least_s: 5.0 })?;
    let matrix =
        |factor: f64| Matrix3::from_diagonal(&Vector3::from_fn(|at, _| if at == rates.axis { factor } else { 1.0 }));
    let ratio = 1.0 / solution.numbers[0];
    let frames = frames(&matrix(ratio.signum()), ratio.abs(), true);
    let unit = frames.factor * ratio.signum();
    let mut none = [None; 3];
    let mut one = |what: &dyn Fn(&nalgebra::DVector<f64>) -> f64| {
        none = [None; 3];
        none[rates.axis] = Some(Estimate::of(&solution, what));
        none
    };
    let scale = one(&|numbers| 1.0 / numbers[0] / unit - 1.0);
    let bias = one(&|numbers| -numbers[1] / numbers[0]);
    let off = solution.windows.iter().filter(|window| weight(window, &solution.scales).1 > OFF).count();
    let later_s = Estimate::of(&solution, &|numbers| numbers[rate::LAG]);
    let mut plain = solution.numbers.clone();
    plain[0] = 1.0 / (unit * (1.0 + stated.scale[rates.axis]));
    plain[1] = -plain[0] * stated.bias[rates.axis] * frames.factor;
    let gap = solution.gap(&rate::windows(track, rates, &plain));
    let gyro = TriadFit {
        turned_deg: [None; 3],
        scale,
        cross: [None; 3],
        bias,
        is_timed: later_s.half() < 0.02,
        later_s,
        gap,
        rms: solution.rms(),
        windows: solution.windows.len(),
        off: off as f64 / solution.windows.len() as f64,
        frames,
    };
    refused(&gyro, &solution)?;
    Ok(Calibration {
        off: stretches(&solution),
        gyro,
        accel: None,
        accel_frames: None,
        arm_m: None,
        inverse_quaternions: false,
        world_down: false,
        clock_rate: None,
        is_ambiguous: rough.is_ambiguous,
        without_accel: None,
    })
}
