//! Triad: what the inverse matrix of a fit means for a sensor.
//!
//! A sensor shows M·x + b of what x acts on the body. M = P·C with a symmetric P and a rotation C (polar decomposition): C turns
//! the body's axes to the sensor's, P has 1 + scale factors on its diagonal and the cross-axis sensitivity beside it.

use crate::fit::{Part, Solution, weight};
use crate::frames::{Frames, frames};
use crate::gyro::inverse;
use nalgebra::{DVector, Matrix3, Vector3};
use serde::Serialize;

/// A scale factor or cross-axis sensitivity with a wider interval than this is not determined.
pub(crate) const DETERMINED: f64 = 0.05;
/// A rotation of frames with a wider interval than this is not determined, °.
pub(crate) const DETERMINED_DEG: f64 = 5.0;
/// A delay with a wider interval than this is not determined, s.
const DETERMINED_S: f64 = 0.02;
/// A window this many standard deviations off belongs to a stretch in which reference and sensor contradict each other.
pub(crate) const OFF: f64 = 6.0;

/// A number with its 95 % interval, or nothing if the motion does not determine it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation, from parts of the record left out in turn or independent residuals, whichever is larger.
    pub sd: f64,
    /// The 95 % interval.
    pub ci95: [f64; 2],
}

impl Estimate {
    pub(crate) fn of(solution: &Solution, what: &dyn Fn(&DVector<f64>) -> f64) -> Self {
        let (sd, factor) = solution.spread(what);
        let value = what(&solution.numbers);
        Self { value, sd, ci95: [value - factor * sd, value + factor * sd] }
    }

    /// Returns a value with Student's interval.
    pub(crate) fn with_freedom(value: f64, sd: f64, freedom: f64) -> Self {
        let half = sd * crate::fit::student(freedom);
        Self { value, sd, ci95: [value - half, value + half] }
    }

    /// Returns half of the interval's width.
    pub fn half(&self) -> f64 {
        0.5 * (self.ci95[1] - self.ci95[0])
    }

    fn determined(self, widest: f64) -> Option<Self> {
        (self.half() <= widest).then_some(self)
    }
}

/// What was found of a gyroscope or accelerometer. What the motion does not determine is `None`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TriadFit {
    /// Axes, signs and the unit.
    pub frames: Frames,
    /// The rotation that is left beside the axes' exchange: the reference's body turned to the sensor, about x, y, z, °.
    pub turned_deg: [Option<Estimate>; 3],
    /// Scale factors of x, y, z.
    pub scale: [Option<Estimate>; 3],
    /// Cross-axis sensitivity of xy, xz, yz.
    pub cross: [Option<Estimate>; 3],
    /// Bias of x, y, z, in the recording's unit.
    pub bias: [Option<Estimate>; 3],
    /// How much later the sensor is than the reference, s; the offset of the clocks is in it.
    pub later_s: Estimate,
    /// Whether `later_s` is determined to 20 ms.
    pub is_timed: bool,
    /// Root mean square of the residuals: of a window's turn, rad, or of a mean acceleration, m/s².
    pub rms: f64,
    /// Windows of time.
    pub windows: usize,
    /// The part of them that is far off.
    pub off: f64,
    /// The gap by part of the record.
    pub gap: Vec<Part>,
}

/// Returns P and C of M = P·C.
pub(crate) fn polar(matrix: &Matrix3<f64>) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
    let of = matrix.svd(true, true);
    let (left, right) = (of.u?, of.v_t?);
    Some((left * Matrix3::from_diagonal(&of.singular_values) * left.transpose(), left * right))
}

/// The deviations that a model states of a triad: what the gap counts from.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stated {
    /// Scale factors of x, y, z.
    pub scale: [f64; 3],
    /// Cross-axis sensitivity of xy, xz, yz.
    pub cross: [f64; 3],
    /// Bias of x, y, z, rad/s or m/s².
    pub bias: [f64; 3],
    /// Latency, s.
    pub later_s: f64,
}

impl Stated {
    /// Returns the symmetric matrix of 1 + scale factors and cross-axis sensitivity.
    fn matrix(&self) -> Matrix3<f64> {
        let [xy, xz, yz] = self.cross;
        let [x, y, z] = self.scale.map(|scale| 1.0 + scale);
        Matrix3::new(x, xy, xz, xy, y, yz, xz, yz, z)
    }
}

/// Returns the numbers of a sensor with the deviations that a model states: the axes and the unit of `of`, no delay beyond `lag_s`
/// and the stated one. What belongs to the reference stays as it is fitted.
pub(crate) fn plain(solution: &Solution, of: &TriadFit, lag: usize, lag_s: f64, stated: &Stated) -> DVector<f64> {
    let mut numbers = solution.numbers.clone();
    let turned = of.turned_deg.map(|of| of.map_or(0.0, |of| of.value.to_radians()));
    let rotation = nalgebra::Rotation3::from_scaled_axis(Vector3::from(turned)).into_inner() * of.frames.matrix();
    let stretch = stated.matrix().try_inverse().unwrap_or_else(Matrix3::identity);
    let inverse = rotation.transpose() * stretch / of.frames.factor;
    let constant = -inverse * (Vector3::from(stated.bias) * of.frames.factor);
    for row in 0..3 {
        for column in 0..3 {
            numbers[3 * row + column] = inverse[(row, column)];
        }
        numbers[9 + row] = constant[row];
    }
    numbers[lag] = lag_s + stated.later_s;
    numbers
}

/// Returns what a solution means. `lag` is the place of its lag, `widest_bias` the widest interval of a bias that counts as
/// determined, in SI units.
pub(crate) fn triad(solution: &Solution, lag: usize, is_gyro: bool, widest_bias: f64) -> Option<TriadFit> {
    let matrix = |numbers: &DVector<f64>| inverse(numbers).0.try_inverse();
    let found = matrix(&solution.numbers)?;
    let (stretch, rotation) = polar(&found)?;
    let frames = frames(&rotation, stretch.trace() / 3.0, is_gyro);
    let (unit, exchange) = (frames.factor, frames.matrix());
    let split = |numbers: &DVector<f64>| matrix(numbers).and_then(|matrix| polar(&matrix));
    let entry = |row: usize, column: usize| {
        move |numbers: &DVector<f64>| {
            split(numbers)
                .map_or(f64::NAN, |(stretch, _)| stretch[(row, column)] / unit - f64::from(u8::from(row == column)))
        }
    };
    let turned = |axis: usize| {
        move |numbers: &DVector<f64>| {
            let rest = |(_, rotation): (Matrix3<f64>, Matrix3<f64>)| {
                nalgebra::Rotation3::from_matrix_unchecked(rotation * exchange.transpose()).scaled_axis()[axis]
            };
            split(numbers).map_or(f64::NAN, rest).to_degrees()
        }
    };
    let bias = |axis: usize| {
        move |numbers: &DVector<f64>| {
            let (inverse, constant) = inverse(numbers);
            inverse.try_inverse().map_or(f64::NAN, |matrix| -(matrix * constant)[axis])
        }
    };
    let number = |what: &dyn Fn(&DVector<f64>) -> f64, widest: f64| Estimate::of(solution, what).determined(widest);
    let later_s = Estimate::of(solution, &|numbers| numbers[lag]);
    let off = solution.windows.iter().filter(|window| weight(window, &solution.scales).1 > OFF).count();
    Some(TriadFit {
        turned_deg: std::array::from_fn(|axis| number(&turned(axis), DETERMINED_DEG)),
        scale: std::array::from_fn(|axis| number(&entry(axis, axis), DETERMINED)),
        cross: [(0, 1), (0, 2), (1, 2)].map(|(row, column)| number(&entry(row, column), DETERMINED)),
        bias: std::array::from_fn(|axis| number(&bias(axis), widest_bias * unit)),
        is_timed: later_s.half() <= DETERMINED_S,
        later_s,
        gap: Vec::new(),
        rms: solution.rms(),
        windows: solution.windows.len(),
        off: off as f64 / solution.windows.len() as f64,
        frames,
    })
}

/// Returns a vector of three numbers.
pub(crate) fn vector(numbers: &DVector<f64>, from: usize) -> Vector3<f64> {
    Vector3::new(numbers[from], numbers[from + 1], numbers[from + 2])
}
