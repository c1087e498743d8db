//! Fitted: the numbers of a triad with their errors, and any function of them with an interval.

use crate::fit::Solution;
use crate::triad::Estimate;
use nalgebra::{DVector, Matrix3, Vector3};

/// A function of the numbers that returns a matrix and a constant.
type Inverse = fn(&DVector<f64>) -> (Matrix3<f64>, Vector3<f64>);

/// Raw values, roughly converted to the unit of what they measure.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scaled {
    pub(super) offset: Vector3<f64>,
    pub(super) per_unit: f64,
}

impl Scaled {
    pub(super) fn of(&self, raw: &Vector3<f64>) -> Vector3<f64> {
        (raw - self.offset) * self.per_unit
    }
}

/// A triad that was fitted: raw = M·x + b for what it measures, x.
#[derive(Debug, Clone)]
pub struct Fitted {
    pub(super) solution: Solution,
    pub(super) scaled: Scaled,
    /// Returns C and c of x = C·m + c for the roughly converted m.
    pub(super) inverse: Inverse,
}

impl Fitted {
    fn sensor(&self, numbers: &DVector<f64>) -> Option<(Matrix3<f64>, Vector3<f64>)> {
        let (matrix, constant) = (self.inverse)(numbers);
        let forward = matrix.try_inverse()?;
        Some((forward / self.scaled.per_unit, self.scaled.offset - forward * constant / self.scaled.per_unit))
    }

    /// Returns M and b.
    pub fn matrix_and_bias(&self) -> (Matrix3<f64>, Vector3<f64>) {
        let nothing = (Matrix3::from_element(f64::NAN), Vector3::from_element(f64::NAN));
        self.sensor(&self.solution.numbers).unwrap_or(nothing)
    }

    /// Returns a function of M and b with its 95 % interval.
    pub fn estimate(&self, what: &dyn Fn(&Matrix3<f64>, &Vector3<f64>) -> f64) -> Estimate {
        let of = |numbers: &DVector<f64>| self.sensor(numbers).map_or(f64::NAN, |(matrix, bias)| what(&matrix, &bias));
        Estimate::of(&self.solution, &of)
    }

    /// Returns the values roughly converted, then as fitted.
    pub(super) fn felt(&self, raw: &Vector3<f64>) -> Vector3<f64> {
        self.felt_by(&self.solution.numbers, raw)
    }

    /// Returns the values with other numbers.
    pub(super) fn felt_by(&self, numbers: &DVector<f64>, raw: &Vector3<f64>) -> Vector3<f64> {
        let (matrix, constant) = (self.inverse)(numbers);
        matrix * self.scaled.of(raw) + constant
    }

    /// Returns whether all numbers and their errors are finite.
    pub(super) fn is_finite(&self) -> bool {
        let (matrix, bias) = self.matrix_and_bias();
        matrix.iter().chain(&bias).all(|of| of.is_finite()) && self.solution.formal.iter().all(|of| of.is_finite())
    }

    /// Returns the length that the values have in every pose, in the unit of what is measured.
    pub(super) fn length(&self) -> f64 {
        self.solution.numbers.get(9).copied().unwrap_or(f64::NAN)
    }

    /// Returns the numbers, one standard deviation off in each independent direction.
    pub(super) fn deviations(&self) -> Vec<DVector<f64>> {
        self.solution.deviations().into_iter().map(|by| &self.solution.numbers + by).collect()
    }

    /// Returns what a raw unit is, roughly, in the unit of what is measured.
    pub(super) fn per_unit(&self) -> f64 {
        self.scaled.per_unit
    }

    /// Returns the root mean square of the residuals.
    pub fn rms(&self) -> f64 {
        self.solution.rms()
    }

    /// Returns how far the length of a raw value is off, in the unit of what is measured.
    pub(super) fn off(&self, raw: &Vector3<f64>) -> f64 {
        (self.felt(raw).norm() - self.length()).abs()
    }

    /// Returns the scatter of the lengths, in the unit of what is measured.
    pub(super) fn scatter(&self) -> f64 {
        self.solution.scales.first().copied().unwrap_or(f64::NAN)
    }
}
