//! Non-negative least squares for a handful of unknowns.

use nalgebra::{DMatrix, DVector};

/// The solution of non-negative least squares.
#[derive(Debug, Clone)]
pub(super) struct Solution {
    /// One value per column, ≥ 0.
    pub(super) values: Vec<f64>,
    /// Sum of the squared residuals.
    pub(super) objective: f64,
}

/// Minimises |`target` − `design` · x|² over x ≥ 0 by trying every set of columns, which is exact and, with at most
/// five columns, cheap enough. `None` if the numbers are not finite.
pub(super) fn non_negative(design: &DMatrix<f64>, target: &DVector<f64>) -> Option<Solution> {
    let columns = design.ncols();
    let mut best = Solution { values: vec![0.0; columns], objective: target.norm_squared() };
    if !best.objective.is_finite() {
        return None;
    }
    for chosen in 1u32..1 << columns {
        let set: Vec<usize> = (0..columns).filter(|column| chosen & 1 << column != 0).collect();
        let Some(values) = unconstrained(&design.select_columns(&set), target) else { continue };
        if values.iter().any(|value| value.is_nan() || *value < 0.0) {
            continue;
        }
        let mut full = vec![0.0; columns];
        for (column, value) in set.iter().zip(values.iter()) {
            full[*column] = *value;
        }
        let objective = (target - design * DVector::from_column_slice(&full)).norm_squared();
        if objective < best.objective {
            best = Solution { values: full, objective };
        }
    }
    Some(best)
}

/// Solves least squares without bounds; `None` if columns depend on one another.
pub(super) fn unconstrained(design: &DMatrix<f64>, target: &DVector<f64>) -> Option<DVector<f64>> {
    let inverse = normal_inverse(design)?;
    Some(inverse * (design.transpose() * target))
}

/// Returns (AᵀA)⁻¹, computed with columns of unit length: coefficients of noise terms differ by many powers of ten.
pub(super) fn normal_inverse(design: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let lengths: Vec<f64> = design.column_iter().map(|column| column.norm()).collect();
    if lengths.iter().any(|length| !(length.is_finite() && *length > 0.0)) {
        return None;
    }
    let scaled =
        DMatrix::from_fn(design.nrows(), design.ncols(), |row, column| design[(row, column)] / lengths[column]);
    let inverse = (scaled.transpose() * &scaled).cholesky()?.inverse();
    Some(DMatrix::from_fn(design.ncols(), design.ncols(), |row, column| {
        inverse[(row, column)] / (lengths[row] * lengths[column])
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_that_would_be_negative_is_left_out() {
        let design = DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 1.0, 1.0, 1.0, 2.0]);
        let rising = non_negative(&design, &DVector::from_column_slice(&[1.0, 3.0, 5.0])).unwrap();
        assert!((rising.values[0] - 1.0).abs() < 1e-12 && (rising.values[1] - 2.0).abs() < 1e-12);
        assert!(rising.objective < 1e-20);
        let falling = non_negative(&design, &DVector::from_column_slice(&[5.0, 3.0, 1.0])).unwrap();
        assert_eq!(falling.values[1], 0.0);
        assert!((falling.values[0] - 3.0).abs() < 1e-12);
        let negative = non_negative(&design, &DVector::from_column_slice(&[-5.0, -3.0, -1.0])).unwrap();
        assert_eq!(negative.values, [0.0, 0.0]);
    }

    #[test]
    fn what_is_not_finite_has_no_solution() {
        let design = DMatrix::from_row_slice(1, 1, &[1.0]);
        assert!(non_negative(&design, &DVector::from_column_slice(&[f64::NAN])).is_none());
        assert!(unconstrained(&DMatrix::zeros(2, 1), &DVector::zeros(2)).is_none());
    }
}
