//! Correction: what removes a triad's deviations, from whatever determined them.
//!
//! A sensor shows M·x + b. M = P·C with a symmetric P (scale factors on its diagonal, cross-axis sensitivity beside it) and a
//! rotation C, which is a matter of mounting against a reference, and of the gyro's mounting beside the accelerometer in a tumble.
//! x = M⁻¹·(raw − b). A number that the record does not determine is left as a sensor without deviations has it.

use crate::triad::{DETERMINED, DETERMINED_DEG, Estimate, TriadFit, polar};
use crate::tumble::Fitted;
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Serialize;

/// Widest interval of a bias that counts as determined, in parts of the full size of what is measured at rest (gravity, the field).
const WIDEST_BIAS: f64 = 0.03;

/// The deviations of a triad. What the record does not determine is `None`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Deviations {
    /// The sensor's values per unit of what it measures, x, y, z: near 1 in SI units, counts per unit otherwise.
    pub sensitivity: [Option<Estimate>; 3],
    /// Cross-axis sensitivity of xy, xz, yz, in parts of the sensitivity.
    pub cross: [Option<Estimate>; 3],
    /// The rotation against the accelerometer about x, y, z, °, if it is a deviation.
    pub turned_deg: Option<[Option<Estimate>; 3]>,
    /// Bias of x, y, z: what the sensor shows of nothing, in its unit.
    pub bias: [Option<Estimate>; 3],
    /// The exchange of axes with signs beside the accelerometer, by rows, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exchange: Option<[[f64; 3]; 3]>,
}

/// x = `matrix`·(raw − `bias`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Correction {
    /// The inverse of the sensor's matrix, by rows.
    pub matrix: [[f64; 3]; 3],
    /// The bias, in the sensor's unit.
    pub bias: [f64; 3],
}

impl Deviations {
    /// Returns the deviations of a triad that a tumble determines. `is_turned`: its rotation counts as a deviation. `widest_bias`: the
    /// widest interval of a determined bias, in the unit of what is measured.
    pub(crate) fn of_tumble(fitted: &Fitted, is_turned: bool, widest_bias: f64) -> Self {
        let sensitivity = std::array::from_fn(|axis| {
            let of = fitted.estimate(&move |matrix, _| stretch(matrix)[(axis, axis)]);
            finite(of).filter(|of| of.half() <= DETERMINED * of.value.abs())
        });
        let cross = [(0, 1), (0, 2), (1, 2)].map(|(row, column)| {
            let of = fitted.estimate(&move |matrix, _| {
                let of = stretch(matrix);
                of[(row, column)] / (of[(row, row)] * of[(column, column)]).sqrt()
            });
            finite(of).filter(|of| of.half() <= DETERMINED)
        });
        let (matrix, _) = fitted.matrix_and_bias();
        let size = matrix.determinant().abs().cbrt();
        let bias = std::array::from_fn(|axis| {
            let of = fitted.estimate(&move |_, bias| bias[axis]);
            finite(of).filter(|of| of.half() <= widest_bias * size)
        });
        let found = crate::frames::nearest(&rotation(&matrix));
        if !is_turned && found != Matrix3::identity() {
            // A symmetric matrix that mirrors or exchanges axes is none of a sensor's.
            return Self::default();
        }
        if !is_turned && sensitivity.iter().any(Option::is_none) {
            // Sensitivities may be relative to their mean, and what is beside an unknown one is not known either.
            return Self { bias, ..Self::default() };
        }
        // Axes that are exchanged without a known size are chance.
        let is_seen = sensitivity.iter().all(Option::is_some);
        let exchange = if is_seen { found } else { Matrix3::identity() };
        let turned = |axis: usize| {
            let of = fitted.estimate(&move |matrix, _| {
                let rest = rotation(matrix) * exchange.transpose();
                Rotation3::from_matrix_unchecked(rest).scaled_axis()[axis].to_degrees()
            });
            finite(of).filter(|of| is_seen && of.half() <= DETERMINED_DEG)
        };
        Self {
            sensitivity,
            cross,
            turned_deg: is_turned.then(|| std::array::from_fn(turned)),
            bias,
            exchange: (exchange != Matrix3::identity())
                .then(|| std::array::from_fn(|row| std::array::from_fn(|column| exchange[(row, column)]))),
        }
    }

    /// Returns the deviations of a triad beside poses; its rotation and exchange of axes are a matter of mounting.
    pub fn of_poses(fit: &TriadFit) -> Self {
        let unit = fit.frames.factor;
        let scaled = |of: Estimate| Estimate {
            value: unit * (1.0 + of.value),
            sd: unit * of.sd,
            ci95: of.ci95.map(|end| unit * (1.0 + end)),
        };
        Self {
            sensitivity: fit.scale.map(|of| of.map(scaled)),
            cross: fit.cross,
            turned_deg: None,
            bias: fit.bias,
            exchange: None,
        }
    }

    /// Returns what removes the deviations; `None` if none is determined. A sensitivity that is not determined is 1, or the mean of those
    /// that are if they are not near 1.
    pub fn correction(&self) -> Option<Correction> {
        let turned = self.turned_deg.iter().flatten();
        if self.sensitivity.iter().chain(&self.cross).chain(turned).chain(&self.bias).all(Option::is_none) {
            return None;
        }
        let known: Vec<f64> = self.sensitivity.iter().flatten().map(|of| of.value).collect();
        let mean = if known.is_empty() { 1.0 } else { known.iter().sum::<f64>() / known.len() as f64 };
        let other = if (mean - 1.0).abs() < 0.2 { 1.0 } else { mean };
        let own = self.sensitivity.map(|of| of.map_or(other, |of| of.value));
        let cross = self.cross.map(|of| of.map_or(0.0, |of| of.value));
        let mut matrix = Matrix3::from_diagonal(&Vector3::from(own));
        for (part, (row, column)) in cross.into_iter().zip([(0, 1), (0, 2), (1, 2)]) {
            let value = part * (own[row] * own[column]).abs().sqrt();
            matrix[(row, column)] = value;
            matrix[(column, row)] = value;
        }
        if let Some(turned) = self.turned_deg {
            let angles = turned.map(|of| of.map_or(0.0, |of| of.value.to_radians()));
            matrix *= Rotation3::from_scaled_axis(Vector3::from(angles)).into_inner();
        }
        if let Some(exchange) = self.exchange {
            matrix *= Matrix3::from_fn(|row, column| exchange[row][column]);
        }
        let inverse = matrix.try_inverse()?;
        Some(Correction {
            matrix: std::array::from_fn(|row| std::array::from_fn(|column| inverse[(row, column)])),
            bias: self.bias.map(|of| of.map_or(0.0, |of| of.value)),
        })
    }

    /// Returns the names of the numbers that the record does not determine.
    pub fn open(&self) -> Vec<String> {
        let open = |names: [&str; 3], of: &[Option<Estimate>; 3], what: &str| -> Vec<String> {
            names.iter().zip(of).filter(|(_, of)| of.is_none()).map(|(name, _)| format!("{what} {name}")).collect()
        };
        let axes = ["x", "y", "z"];
        let mut all = open(axes, &self.sensitivity, "scale factor");
        all.extend(open(["xy", "xz", "yz"], &self.cross, "cross-axis sensitivity"));
        if let Some(turned) = &self.turned_deg {
            all.extend(open(axes, turned, "rotation about"));
        }
        all.extend(open(axes, &self.bias, "bias"));
        all
    }
}

/// Returns the deviations of a tumble's accelerometer, in SI units or counts.
pub(crate) fn of_accel(fitted: &Fitted, gravity_m_s2: f64) -> Deviations {
    Deviations::of_tumble(fitted, false, WIDEST_BIAS * gravity_m_s2)
}

/// Returns an estimate whose value and interval are finite.
fn finite(of: Estimate) -> Option<Estimate> {
    Some(of).filter(|of| of.value.is_finite() && of.ci95.iter().all(|end| end.is_finite()))
}

/// Returns P of M = P·C.
fn stretch(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    polar(matrix).map_or(Matrix3::from_element(f64::NAN), |(stretch, _)| stretch)
}

/// Returns C of M = P·C.
fn rotation(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    polar(matrix).map_or(Matrix3::from_element(f64::NAN), |(_, rotation)| rotation)
}
