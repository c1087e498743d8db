//! Gyro: integrated between poses and compared with their relative rotation.
//!
//! # Source
//! The integral of a rate that is linear in its numbers, to first order in them: Forster and others 2017 (preintegration),
//! equations (43) and (44).

use crate::fit::{Prior, Solution, Window, solve};
use crate::reference::Poses;
use crate::rough::Rough;
use crate::track::Track;
use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

/// A window's length, s: the noise of two attitudes is then small beside a turn.
const WINDOW_S: f64 = 0.5;
/// Half of the time over which the reference's rate is taken, s.
const RATE_HALF_S: f64 = 0.025;
/// Half of the time over which attitudes are averaged, s.
const SMOOTHED_S: f64 = 0.15;
/// Poses on either side that are averaged at most, so that stamps do not decide how long it takes.
const SMOOTHED_MOST: usize = 200;
/// How far entries of the inverse matrix may be from the rough ones, in units of their scale.
const MATRIX_SD: f64 = 0.1;
/// How far the lag may be from the rough one, s.
const LAG_SD_S: f64 = 0.1;

/// Places of the numbers: nine of the inverse matrix row by row, three of its constant, the lag in the middle, its growth.
pub(crate) const NUMBERS: usize = 14;
pub(crate) const LAG: usize = 12;
/// The rate of the clocks: how much the lag grows in a second.
pub(crate) const DRIFT: usize = 13;
/// Clocks differ by up to some hundred parts per million.
pub(crate) const DRIFT_SD: f64 = 3e-4;

/// Returns the inverse matrix and the constant of the first twelve numbers.
pub(crate) fn inverse(numbers: &DVector<f64>) -> (Matrix3<f64>, Vector3<f64>) {
    let matrix = Matrix3::from_fn(|row, column| numbers[3 * row + column]);
    (matrix, Vector3::new(numbers[9], numbers[10], numbers[11]))
}

/// Returns the priors of the first twelve numbers: `rough` to some tenths, and a constant of this standard deviation.
pub(crate) fn priors(rough: &Matrix3<f64>, constant_sd: f64) -> Option<Vec<Prior>> {
    let inverse = rough.try_inverse()?;
    let scale = inverse.norm() / 3.0_f64.sqrt();
    let entries = (0..9).map(|at| Prior { mean: inverse[(at / 3, at % 3)], sd: MATRIX_SD * scale });
    Some(entries.chain((0..3).map(|_| Prior { mean: 0.0, sd: constant_sd })).collect())
}

/// Fits the gyroscope. `None` if no window is free of gaps.
pub(crate) fn fit(track: &Track, poses: &Poses, rough: &Rough) -> Option<Solution> {
    let mut priors = priors(&rough.matrix, 1.0)?;
    priors.push(Prior { mean: rough.lag_s, sd: LAG_SD_S });
    priors.push(Prior { mean: 0.0, sd: DRIFT_SD });
    solve(&|numbers| windows(track, poses, numbers), &priors)
}

/// Returns the poses with attitudes averaged over [`SMOOTHED_S`] along the turns of the fitted gyroscope, so that they have less noise.
pub(crate) fn smoothed(track: &Track, poses: &Poses, numbers: &DVector<f64>) -> Poses {
    let (matrix, constant) = inverse(numbers);
    let longest_s = track.longest_step_s();
    let at = |time_s: f64| time_s + numbers[LAG] + numbers[DRIFT] * (time_s - poses.middle_s());
    let turn = |from_s: f64, to_s: f64| {
        let parts = track.parts(&track.gyro, at(from_s), at(to_s), longest_s)?;
        let steps =
            parts.iter().map(|part| UnitQuaternion::from_scaled_axis((matrix * part.value + constant) * part.seconds));
        Some(steps.fold(UnitQuaternion::identity(), |turned, step| turned * step))
    };
    // What each pose is beyond the integrated turns, in stretches without a gap.
    let (mut turned, mut stretch) = (UnitQuaternion::identity(), 0_usize);
    let mut beyond = Vec::with_capacity(poses.time_s.len());
    for (place, attitude) in poses.attitude.iter().enumerate() {
        if let Some(before) = place.checked_sub(1) {
            match turn(poses.time_s[before], poses.time_s[place]) {
                Some(step) => turned *= step,
                None => (turned, stretch) = (UnitQuaternion::identity(), stretch + 1),
            }
        }
        beyond.push((stretch, turned, attitude * turned.inverse()));
    }
    let mean = |place: usize| {
        let (stretch, turned, own) = &beyond[place];
        let from = poses.time_s.partition_point(|time_s| *time_s < poses.time_s[place] - SMOOTHED_S);
        let to = poses.time_s.partition_point(|time_s| *time_s <= poses.time_s[place] + SMOOTHED_S);
        // As far to one side as to the other; more poses than that in this time are of no instrument.
        let reach = (place - from).min(to - 1 - place).min(SMOOTHED_MOST);
        let all = beyond[place - reach..=place + reach].iter().filter(|(other, ..)| other == stretch);
        let sum = all.fold(nalgebra::Quaternion::default(), |sum, (.., of)| {
            sum + of.quaternion() * of.quaternion().dot(own.quaternion()).signum()
        });
        UnitQuaternion::from_quaternion(sum) * turned
    };
    Poses { attitude: (0..beyond.len()).map(mean).collect(), ..poses.clone() }
}

/// Returns all windows at these numbers.
pub(crate) fn windows(track: &Track, poses: &Poses, numbers: &DVector<f64>) -> Vec<Window> {
    let longest_s = track.longest_step_s();
    ends(poses).into_iter().filter_map(|ends| window(track, poses, ends, numbers, longest_s)).collect()
}

/// Returns the places of the first and the last pose of each window.
fn ends(poses: &Poses) -> Vec<(usize, usize)> {
    let mut ends = Vec::new();
    let mut from = 0;
    for to in 1..poses.time_s.len() {
        let length_s = poses.time_s[to] - poses.time_s[from];
        if length_s >= WINDOW_S {
            if length_s < 2.0 * WINDOW_S {
                ends.push((from, to));
            }
            from = to;
        }
    }
    ends
}

fn window(
    track: &Track,
    poses: &Poses,
    (from, to): (usize, usize),
    numbers: &DVector<f64>,
    longest_s: f64,
) -> Option<Window> {
    let (matrix, constant) = inverse(numbers);
    let after_s = 0.5 * (poses.time_s[from] + poses.time_s[to]) - poses.middle_s();
    let lag_s = numbers[LAG] + numbers[DRIFT] * after_s;
    let [from_s, to_s] = [poses.time_s[from], poses.time_s[to]].map(|time_s| time_s + lag_s);
    let parts = track.parts(&track.gyro, from_s, to_s, longest_s)?;
    let turned = poses.attitude[from].inverse() * poses.attitude[to];
    let mean_rate = turned.scaled_axis() / (to_s - from_s);
    let forward = matrix.try_inverse()?;
    let (mut jacobian, mut instruments) = (DMatrix::zeros(3, NUMBERS), DMatrix::zeros(3, NUMBERS));
    let (mut near, longest_pose_s) = (from, poses.longest_step_s());
    // From the end on: what turns later turns the effect of what was earlier.
    let mut later = UnitQuaternion::identity();
    for part in parts.iter().rev() {
        let rate = matrix * part.value + constant;
        let half = UnitQuaternion::from_scaled_axis(rate * (0.5 * part.seconds));
        later = half * later;
        let mut at = |time_s: f64| poses.at(time_s - lag_s, &mut near, longest_pose_s);
        let known = at(part.middle_s - RATE_HALF_S).zip(at(part.middle_s + RATE_HALF_S));
        let known = known.map_or(mean_rate, |(one, other)| (one.inverse() * other).scaled_axis() / (2.0 * RATE_HALF_S));
        let expected = forward * (known - constant);
        let back = later.inverse().to_rotation_matrix().into_inner() * part.seconds;
        for row in 0..3 {
            for by in 0..3 {
                for of in 0..3 {
                    jacobian[(row, 3 * by + of)] += back[(row, by)] * part.value[of];
                    instruments[(row, 3 * by + of)] += back[(row, by)] * expected[of];
                }
                jacobian[(row, 9 + by)] += back[(row, by)];
            }
        }
        later = half * later;
    }
    let rate_at = |part: &crate::track::Part| matrix * part.value + constant;
    let ends = rate_at(parts.last()?) - later.inverse() * rate_at(parts.first()?);
    for row in 0..3 {
        jacobian[(row, LAG)] = ends[row];
        jacobian[(row, DRIFT)] = ends[row] * after_s;
    }
    instruments.columns_mut(9, 5).copy_from(&jacobian.columns(9, 5));
    let residual = (turned.inverse() * later).scaled_axis();
    Some(Window {
        middle_s: 0.5 * (poses.time_s[from] + poses.time_s[to]),
        residual: DVector::from_column_slice(residual.as_slice()),
        jacobian,
        instruments: Some(instruments),
    })
}
