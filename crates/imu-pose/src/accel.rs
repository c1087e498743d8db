//! Accelerometer: averaged over the kernel of a second difference of positions, and compared with that difference.
//!
//! A divided second difference of positions is the mean of the acceleration over a triangle (Peano's kernel). The noise of the
//! positions is then in what remains, not in what is multiplied. The lever arm from the accelerometer to the point whose positions
//! are known enters by the second difference of the attitude.

use crate::fit::{Prior, Solution, Window, solve};
use crate::gyro::{DRIFT_SD, inverse, priors};
use crate::reference::Poses;
use crate::track::Track;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

/// Half of a triangle's length, s.
const HALF_S: f64 = 0.1;
/// Local gravity is within 0.13 % of the standard value.
const GRAVITY_SD: f64 = 0.013;
/// How far the reference's world may be off the vertical, as m/s².
const LEVEL_SD: f64 = 0.1;
/// How long a lever arm may be, m.
const ARM_SD_M: f64 = 0.3;
const LAG_SD_S: f64 = 0.05;
/// The step of the derivative by the lag, s.
const LAG_STEP_S: f64 = 2e-4;

/// Places of the numbers behind those of the matrix: gravity, the lever arm, the lag in the middle, its growth.
pub(crate) const GRAVITY: usize = 12;
pub(crate) const ARM: usize = 15;
pub(crate) const LAG: usize = 18;
const DRIFT: usize = 19;
const NUMBERS: usize = 20;

/// Three poses that are [`HALF_S`] apart.
type Triple = [usize; 3];

/// Fits the accelerometer. `rough` is its matrix to some tenths, `lag_s` the offset of the clocks, `sign` −1 if gravity points along
/// the reference's z axis. `None` without positions or without windows.
pub(crate) fn fit(track: &Track, poses: &Poses, rough: &Matrix3<f64>, lag_s: f64, sign: f64) -> Option<Solution> {
    let triples = triples(poses)?;
    let mut priors = priors(rough, 5.0)?;
    priors.extend([
        Prior { mean: 0.0, sd: LEVEL_SD },
        Prior { mean: 0.0, sd: LEVEL_SD },
        Prior { mean: sign * STANDARD_GRAVITY_M_S2, sd: GRAVITY_SD },
    ]);
    priors.extend([Prior { mean: 0.0, sd: ARM_SD_M }; 3]);
    priors.push(Prior { mean: lag_s, sd: LAG_SD_S });
    priors.push(Prior { mean: 0.0, sd: DRIFT_SD });
    solve(&|numbers| of_triples(track, poses, &triples, numbers), &priors)
}

/// Returns all windows at these numbers.
pub(crate) fn windows(track: &Track, poses: &Poses, numbers: &DVector<f64>) -> Vec<Window> {
    of_triples(track, poses, &triples(poses).unwrap_or_default(), numbers)
}

fn of_triples(track: &Track, poses: &Poses, triples: &[Triple], numbers: &DVector<f64>) -> Vec<Window> {
    let steps = [poses.longest_step_s(), track.longest_step_s()];
    triples.iter().filter_map(|triple| window(track, poses, *triple, numbers, steps)).collect()
}

fn triples(poses: &Poses) -> Option<Vec<Triple>> {
    if poses.position_m.len() != poses.time_s.len() {
        return None;
    }
    let longest_s = poses.longest_step_s();
    let after = |from: usize| {
        let to = poses.time_s.partition_point(|time_s| *time_s < poses.time_s[from] + HALF_S - 1e-9);
        let near = to < poses.time_s.len() && poses.time_s[to] - poses.time_s[from] < HALF_S + longest_s;
        near.then_some(to)
    };
    let mut found = Vec::new();
    let mut from = 0;
    while let Some(middle) = after(from) {
        if let Some(to) = after(middle) {
            found.push([from, middle, to]);
        }
        from = middle;
    }
    Some(found)
}

/// Returns the triangle of unit integral at a time.
fn kernel([from, middle, to]: [f64; 3], time_s: f64) -> f64 {
    let rise = ((time_s - from) / (middle - from)).min((to - time_s) / (to - middle));
    rise.max(0.0) / (0.5 * (to - from))
}

/// Returns the mean of attitude times (force and 1) over the kernel: for each axis of the sensor, and the constant.
fn means(
    track: &Track,
    poses: &Poses,
    triple: Triple,
    lag_s: f64,
    [longest_pose_s, longest_s]: [f64; 2],
) -> Option<([Matrix3<f64>; 3], Matrix3<f64>)> {
    let times = triple.map(|place| poses.time_s[place]);
    let parts = track.parts(&track.accel, times[0] + lag_s, times[2] + lag_s, longest_s)?;
    let mut near = triple[0];
    let (mut by_axis, mut constant, mut all) = ([Matrix3::zeros(); 3], Matrix3::zeros(), 0.0);
    for part in parts {
        let time_s = part.middle_s - lag_s;
        let weight = kernel(times, time_s) * part.seconds;
        let attitude = poses.at(time_s, &mut near, longest_pose_s)?.to_rotation_matrix().into_inner() * weight;
        for (sum, value) in by_axis.iter_mut().zip(part.value.iter()) {
            *sum += attitude * *value;
        }
        constant += attitude;
        all += weight;
    }
    Some((by_axis.map(|of| of / all), constant / all))
}

fn second(of: [Vector3<f64>; 3], [from, middle, to]: [f64; 3]) -> Vector3<f64> {
    ((of[2] - of[1]) / (to - middle) - (of[1] - of[0]) / (middle - from)) / (0.5 * (to - from))
}

fn window(track: &Track, poses: &Poses, triple: Triple, numbers: &DVector<f64>, steps: [f64; 2]) -> Option<Window> {
    let (matrix, constant) = inverse(numbers);
    let times = triple.map(|place| poses.time_s[place]);
    let after_s = times[1] - poses.middle_s();
    let lag_s = numbers[LAG] + numbers[DRIFT] * after_s;
    let force = |lag_s: f64| {
        let (by_axis, attitude) = means(track, poses, triple, lag_s, steps)?;
        let value: Vector3<f64> = (0..3).map(|axis| by_axis[axis] * matrix.column(axis)).sum::<Vector3<f64>>();
        Some((value + attitude * constant, by_axis, attitude))
    };
    let (value, by_axis, attitude) = force(lag_s)?;
    let (sooner, later) = (force(lag_s - LAG_STEP_S)?.0, force(lag_s + LAG_STEP_S)?.0);
    let turned: [UnitQuaternion<f64>; 3] = triple.map(|place| poses.attitude[place]);
    // A column for each part of the lever arm.
    let swing = Matrix3::from_columns(&std::array::from_fn::<_, 3, _>(|axis| {
        second(turned.map(|attitude| attitude * Vector3::ith(axis, 1.0)), times)
    }));
    let gravity = Vector3::new(numbers[GRAVITY], numbers[GRAVITY + 1], numbers[GRAVITY + 2]);
    let arm = Vector3::new(numbers[ARM], numbers[ARM + 1], numbers[ARM + 2]);
    let moved = second(triple.map(|place| poses.position_m[place]), times);
    let residual = value - gravity - moved + swing * arm;
    let mut jacobian = DMatrix::zeros(3, NUMBERS);
    for row in 0..3 {
        for by in 0..3 {
            for of in 0..3 {
                jacobian[(row, 3 * by + of)] = by_axis[of][(row, by)];
            }
            jacobian[(row, 9 + by)] = attitude[(row, by)];
            jacobian[(row, ARM + by)] = swing[(row, by)];
        }
        jacobian[(row, GRAVITY + row)] = -1.0;
        jacobian[(row, LAG)] = (later - sooner)[row] / (2.0 * LAG_STEP_S);
        jacobian[(row, DRIFT)] = jacobian[(row, LAG)] * after_s;
    }
    Some(Window {
        middle_s: times[1],
        residual: DVector::from_column_slice(residual.as_slice()),
        jacobian,
        instruments: None,
    })
}
