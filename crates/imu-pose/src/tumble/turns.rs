//! Turns: a gyro integrated between rests, compared with the turn of gravity's direction.
//!
//! # Source
//! Tedaldi, Pretto and Menegatti 2014, "A robust and easy to implement method for IMU calibration without external equipments". Here the
//! bias is fitted beside the matrix with what the rests say of it, and every number has an interval.

use super::fitted::{Fitted, Scaled};
use crate::fit::{Design, Prior, Window, solve_by};
use crate::gyro::inverse;
use crate::track::{Part, Track};
use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

/// Numbers: nine of the inverse matrix by rows, three of its constant.
const NUMBERS: usize = 12;
/// How far the entries of the matrix may be from the rough ones.
const ENTRY_SD: f64 = 0.3;
/// A turn by less than this does not count, rad.
const LEAST_TURN: f64 = 0.2;
/// Turns by which the rough matrix is sought at most.
const SOUGHT: usize = 12;
/// The matrix that is stated fits if directions are this close, rad, root mean square.
const FITS: f64 = 0.15;
/// The best of all exchanges and scales is worth a fit if directions are this close, rad, root mean square.
const WORTH: f64 = 0.8;
/// A fit whose directions are farther off than this is none, rad, root mean square.
const FITTED: f64 = 0.1;
/// The largest turn between two rests is between these angles, rad.
const LARGEST: [f64; 2] = [0.7, 14.0];
/// Ratio of one sought scale to the next.
const FINER: f64 = 1.04;

/// A turn between two rests.
pub(super) struct Turn {
    pub(super) middle_s: f64,
    /// The raw rates less their bias, in parts of time.
    pub(super) parts: Vec<Part>,
    /// Directions of gravity before and after.
    pub(super) before: Vector3<f64>,
    pub(super) after: Vector3<f64>,
}

impl Turn {
    /// Returns a turn from one rest to the next; `None` if there is a gap in it, or if gravity is turned too little.
    pub(super) fn between(
        track: &Track,
        [from_s, to_s]: [f64; 2],
        directions: [Vector3<f64>; 2],
        bias: &dyn Fn(f64) -> Vector3<f64>,
    ) -> Option<Self> {
        let [before, after] = directions;
        let mut parts = track.parts(&track.gyro, from_s, to_s, track.longest_step_s())?;
        parts.iter_mut().for_each(|part| part.value -= bias(part.middle_s));
        (before.angle(&after) > LEAST_TURN).then_some(Self { middle_s: 0.5 * (from_s + to_s), parts, before, after })
    }

    fn turned(&self, matrix: &Matrix3<f64>) -> UnitQuaternion<f64> {
        let steps = self.parts.iter().map(|part| UnitQuaternion::from_scaled_axis(matrix * part.value * part.seconds));
        steps.fold(UnitQuaternion::identity(), |turned, step| turned * step)
    }

    /// Returns the angle between the predicted direction of gravity and that of the second rest.
    fn miss(&self, matrix: &Matrix3<f64>) -> f64 {
        (self.turned(matrix).inverse() * self.before).angle(&self.after)
    }

    /// Returns the sum of all rates' sizes, in raw units.
    fn path(&self) -> f64 {
        self.parts.iter().map(|part| part.value.norm() * part.seconds).sum()
    }

    fn window(&self, numbers: &DVector<f64>, rough: &Matrix3<f64>) -> Window {
        self.window_across(numbers, rough, &self.after)
    }

    /// Returns the window with residuals across a direction.
    fn window_across(&self, numbers: &DVector<f64>, rough: &Matrix3<f64>, along: &Vector3<f64>) -> Window {
        let (matrix, constant) = inverse(numbers);
        let mut jacobian = DMatrix::zeros(3, NUMBERS);
        // From the end on: what turns later turns the effect of what was earlier.
        let mut later = UnitQuaternion::identity();
        for part in self.parts.iter().rev() {
            let value = rough * part.value;
            let half = UnitQuaternion::from_scaled_axis((matrix * value + constant) * (0.5 * part.seconds));
            later = half * later;
            let back = later.inverse().to_rotation_matrix().into_inner() * part.seconds;
            for row in 0..3 {
                for by in 0..3 {
                    for of in 0..3 {
                        jacobian[(row, 3 * by + of)] += back[(row, by)] * value[of];
                    }
                    jacobian[(row, 9 + by)] += back[(row, by)];
                }
            }
            later = half * later;
        }
        let predicted = later.inverse() * self.before;
        // Two axes across the direction: along it nothing shows.
        let least = along.iamin();
        let one = along.cross(&Vector3::ith(least, 1.0)).normalize();
        let across = [one, along.cross(&one)];
        let turning = predicted.cross_matrix() * jacobian.fixed_rows::<3>(0);
        let rows =
            DMatrix::from_fn(2, NUMBERS, |row, column| across[row].dot(&turning.column(column).fixed_rows::<3>(0)));
        let residual = DVector::from_fn(2, |row, _| across[row].dot(&(predicted - self.after)));
        Window { middle_s: self.middle_s, residual, jacobian: rows, instruments: None }
    }
}

/// Returns the matrix that makes rad/s in the accelerometer's axes of raw values, roughly: the identity if that fits, else one
/// scale and one exchange of axes with signs. `None` if nothing fits.
pub(super) fn rough(turns: &[Turn], is_si: bool) -> Option<Matrix3<f64>> {
    let sought: Vec<&Turn> = turns.iter().take(SOUGHT).collect();
    let rms = |matrix: &Matrix3<f64>| {
        let squares: f64 = sought.iter().map(|turn| turn.miss(matrix).powi(2)).sum();
        (squares / sought.len().max(1) as f64).sqrt()
    };
    let largest = sought.iter().map(|turn| turn.path()).fold(0.0, f64::max);
    let identity = Matrix3::identity();
    if sought.is_empty() || !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    if is_si && rms(&identity) < FITS {
        return Some(identity);
    }
    let scales: Vec<f64> = std::iter::successors(Some(LARGEST[0] / largest), |scale| Some(scale * FINER))
        .take_while(|scale| *scale <= LARGEST[1] / largest)
        .collect();
    let best = |of: &Matrix3<f64>| {
        let all = scales.iter().map(|scale| *scale * of);
        all.map(|matrix| (rms(&matrix), matrix)).min_by(|one, other| one.0.total_cmp(&other.0))
    };
    let plain = best(&identity)?;
    // Scale factors and rotations of tens of percent leave much until they are fitted.
    if plain.0 < 2.0 * FITS {
        return Some(plain.1);
    }
    let all = crate::frames::exchanges().filter_map(|exchange| best(&exchange));
    all.min_by(|one, other| one.0.total_cmp(&other.0)).filter(|(rms, _)| *rms < WORTH).map(|(_, matrix)| matrix)
}

/// Fits the gyro. `bias_sd` is the standard deviation of the bias that was taken out, in raw units; `offset` that bias in the
/// middle of the record. `others` are the directions before and after the same turns, one standard deviation of the accelerometer's
/// numbers off, for each of those that are independent. `coarse` are the same turns by every other sample, and `wide` with a part of the
/// rests at either end: a fit must not depend on where a rest begins.
pub(super) fn fit(
    turns: &[Turn],
    rough: &Matrix3<f64>,
    offset: Vector3<f64>,
    bias_sd: f64,
    others: &[Vec<[Vector3<f64>; 2]>],
    [coarse, wide]: [&[Turn]; 2],
) -> Option<Fitted> {
    let per_unit = rough.determinant().abs().cbrt();
    let exchange = rough / per_unit;
    let mut priors: Vec<Prior> = (0..9).map(|at| Prior { mean: exchange[(at / 3, at % 3)], sd: ENTRY_SD }).collect();
    priors.extend([Prior { mean: 0.0, sd: bias_sd * per_unit }; 3]);
    let scale = Matrix3::from_diagonal_element(per_unit);
    let make = |numbers: &DVector<f64>| turns.iter().map(|turn| turn.window(numbers, &scale)).collect();
    let design = Design { parts: (0..turns.len()).collect(), ..Design::default() };
    let mut solution = solve_by(&make, &priors, design)?;
    if solution.rms() > FITTED {
        return None;
    }
    let borrowed = others.iter().filter_map(|directions| {
        let moved = turns.iter().zip(directions).map(|(turn, [before, after])| {
            let moved = Turn { middle_s: turn.middle_s, parts: turn.parts.clone(), before: *before, after: *after };
            moved.window_across(&solution.numbers, &scale, &turn.after)
        });
        solution.step(&moved.collect::<Vec<_>>())
    });
    let changed = |others: &[Turn]| {
        let lines = turns.iter().zip(others).map(|(turn, of)| of.window_across(&solution.numbers, &scale, &turn.after));
        solution.step(&lines.collect::<Vec<_>>())
    };
    // The error of a sum of samples grows with the square of their distance (Richardson): a third of what half of the samples change.
    let lines = changed(coarse).map(|step| step / 3.0);
    solution.borrowed = borrowed.chain(lines).chain(changed(wide)).collect();
    Some(Fitted { solution, scaled: Scaled { offset, per_unit }, inverse })
}
