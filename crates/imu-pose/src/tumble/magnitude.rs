//! Magnitude: a triad that measures a vector of one length in every pose: gravity at rest, the earth's magnetic field.
//!
//! # Source
//! x = C·m + c, with a symmetric C, has the same length in all poses: IEEE Std 1293 (multi-position tests of accelerometers); Gebre-Egziabher and
//! others 2006 (hard and soft iron).

use super::fitted::{Fitted, Scaled};
use crate::fit::{Design, Prior, Window, solve_by};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix4, Vector3, Vector4};

/// Numbers: xx, yy, zz, xy, xz, yz of C, three of c, the length.
const NUMBERS: usize = 10;
/// Rows and columns of the first six numbers.
const ENTRIES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
/// How far the entries of C may be from 1 and 0, and c from 0 in parts of the length.
const ENTRY_SD: f64 = 0.5;

/// Returns C and c.
fn inverse(numbers: &DVector<f64>) -> (Matrix3<f64>, Vector3<f64>) {
    let mut matrix = Matrix3::zeros();
    for (at, (row, column)) in ENTRIES.into_iter().enumerate() {
        matrix[(row, column)] = numbers[at];
        matrix[(column, row)] = numbers[at];
    }
    (matrix, Vector3::new(numbers[6], numbers[7], numbers[8]))
}

/// Fits a triad to means of its raw values, each at a time, s. `None` without values that lie on a sphere.
pub(super) fn fit(points: &[(f64, Vector3<f64>)], length: Prior, design: Design) -> Option<Fitted> {
    let scaled = sphere(points, length.mean)?;
    let values: Vec<(f64, Vector3<f64>)> = points.iter().map(|(time_s, raw)| (*time_s, scaled.of(raw))).collect();
    let mut priors: Vec<Prior> = (0..6).map(|at| Prior { mean: f64::from(u8::from(at < 3)), sd: ENTRY_SD }).collect();
    priors.extend([Prior { mean: 0.0, sd: ENTRY_SD * length.mean }; 3]);
    priors.push(length);
    let make = |numbers: &DVector<f64>| {
        let (matrix, constant) = inverse(numbers);
        values.iter().map(|(time_s, value)| window(*time_s, value, &(matrix * value + constant), numbers[9])).collect()
    };
    Some(Fitted { solution: solve_by(&make, &priors, design)?, scaled, inverse })
}

fn window(middle_s: f64, value: &Vector3<f64>, felt: &Vector3<f64>, length: f64) -> Window {
    let size = felt.norm().max(1e-9);
    let along = felt / size;
    let mut jacobian = DMatrix::zeros(1, NUMBERS);
    for (at, (row, column)) in ENTRIES.into_iter().enumerate() {
        jacobian[(0, at)] = along[row] * value[column] + if row == column { 0.0 } else { along[column] * value[row] };
    }
    for axis in 0..3 {
        jacobian[(0, 6 + axis)] = along[axis];
    }
    jacobian[(0, 9)] = -1.0;
    Window { middle_s, residual: DVector::from_element(1, size - length), jacobian, instruments: None }
}

/// Returns the centre and the radius of the sphere that fits the values best, as an offset and a scale to this length. Scattered
/// values are left out in a second round.
///
/// # Source
/// |m|² = 2·m·centre + (radius² − |centre|²) is linear.
pub(super) fn sphere(points: &[(f64, Vector3<f64>)], length: f64) -> Option<Scaled> {
    let mean = points.iter().map(|(_, raw)| *raw).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let reach = points.iter().map(|(_, raw)| (raw - mean).norm()).fold(0.0, f64::max);
    if !(reach.is_finite() && reach > 0.0) {
        return None;
    }
    let mut kept: Vec<Vector3<f64>> = points.iter().map(|(_, raw)| (raw - mean) / reach).collect();
    let mut found = None;
    for _ in 0..2 {
        if kept.len() < 4 {
            return None;
        }
        let (mut normal, mut slope) = (Matrix4::zeros(), Vector4::zeros());
        for of in &kept {
            let row = Vector4::new(2.0 * of.x, 2.0 * of.y, 2.0 * of.z, 1.0);
            normal += row * row.transpose();
            slope += row * of.norm_squared();
        }
        let solved = normal.lu().solve(&slope)?;
        let centre = Vector3::new(solved[0], solved[1], solved[2]);
        let radius = (solved[3] + centre.norm_squared()).sqrt();
        if !radius.is_finite() || radius <= 0.0 {
            return None;
        }
        found = Some(Scaled { offset: mean + centre * reach, per_unit: length / (radius * reach) });
        let mut far: Vec<f64> = kept.iter().map(|of| ((of - centre).norm() - radius).abs()).collect();
        far.sort_unstable_by(f64::total_cmp);
        let most = 5.0 * far[far.len() / 2] + 1e-6;
        kept.retain(|of| ((of - centre).norm() - radius).abs() <= most);
    }
    found
}
