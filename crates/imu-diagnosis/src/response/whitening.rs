//! Whitening: turns columns of a record into coefficients of variance 1, and bridges clipped samples.

use super::clipping::Bridges;
use super::design::Column;
use super::noise_law::NoiseLaw;
use crate::dot::dot;
use crate::transform::Cosines;
use nalgebra::{DMatrix, DVector};

/// All operations on a record's columns before they are compared.
#[derive(Debug)]
pub(super) struct Whitening<'a> {
    pub(super) law: &'a NoiseLaw,
    cosines: Cosines,
    pub(super) bridges: [Bridges; 3],
}

/// A whitened design.
pub(super) type Columns = Vec<Column>;

/// Samples whose products are summed at a time: two dozen columns of them fit a processor's cache.
const AT_A_TIME: usize = 1024;

/// Returns XᵀX of whitened columns: Σ over the axes of the products of every two.
pub(super) fn products(columns: &Columns) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(columns.len(), columns.len());
    for axis in 0..3 {
        let there: Vec<(usize, &[f64])> =
            columns.iter().enumerate().filter_map(|(place, column)| Some((place, column[axis].as_deref()?))).collect();
        let n = there.first().map_or(0, |(_, values)| values.len());
        for from in (0..n).step_by(AT_A_TIME) {
            let within = from..n.min(from + AT_A_TIME);
            for (place, (row, one)) in there.iter().enumerate() {
                for (column, other) in &there[..=place] {
                    matrix[(*row, *column)] += dot(&one[within.clone()], &other[within.clone()]);
                }
            }
        }
    }
    matrix.fill_upper_triangle_with_lower_triangle();
    matrix
}

impl<'a> Whitening<'a> {
    pub(super) fn new(law: &'a NoiseLaw) -> Self {
        Self { law, cosines: Cosines::new(law.samples()), bridges: Default::default() }
    }

    pub(super) fn whiten(&mut self, axis: usize, values: &mut [f64]) {
        self.bridges[axis].fill(values);
        self.cosines.forward(values);
        self.law.axes[axis].whiten(values);
    }

    /// Returns the whitened samples less the response.
    pub(super) fn residual(&mut self, samples: [&[f64]; 3], response: &[Vec<f64>; 3]) -> [Vec<f64>; 3] {
        std::array::from_fn(|axis| {
            let pairs = samples[axis].iter().zip(&response[axis]);
            let mut values: Vec<f64> = pairs.map(|(shown, response)| shown - response).collect();
            self.whiten(axis, &mut values);
            values
        })
    }

    pub(super) fn columns(&mut self, mut columns: Columns) -> Columns {
        for column in &mut columns {
            for (axis, values) in column.iter_mut().enumerate() {
                if let Some(values) = values {
                    self.whiten(axis, values);
                }
            }
        }
        columns
    }

    /// Transforms a whitened column back into time: it has its original length, with each value at its place. Samples
    /// of noise are then uncorrelated, so that sums over blocks of time are sums of the likelihood.
    pub(super) fn in_time(&mut self, values: &mut [f64]) {
        self.cosines.backward(values);
    }

    /// Returns Xᵀr.
    pub(super) fn gradient(columns: &Columns, residual: &[Vec<f64>; 3]) -> DVector<f64> {
        let along = |column: &Column| {
            let axes = column.iter().zip(residual);
            axes.filter_map(|(values, residual)| Some(dot(values.as_deref()?, residual))).sum::<f64>()
        };
        DVector::from_iterator(columns.len(), columns.iter().map(along))
    }

    /// Returns the covariance of Xᵀr under the law: XᵀX except for bridges, which have less noise than the weights
    /// assume.
    pub(super) fn gradient_covariance(&mut self, columns: &Columns) -> DMatrix<f64> {
        let mut seen = columns.clone();
        for column in &mut seen {
            for (axis, values) in column.iter_mut().enumerate().filter(|(axis, _)| !self.bridges[*axis].is_empty()) {
                let Some(values) = values else { continue };
                // Noise reaches the whitened coefficients through W·C·F; its covariance is CᵀΣC with Σ⁻¹ = WᵀW.
                self.law.axes[axis].whiten_transposed(values);
                self.cosines.backward(values);
                self.bridges[axis].fill_transposed(values);
                self.cosines.forward(values);
                self.law.axes[axis].colour_transposed(values);
            }
        }
        products(&seen)
    }
}
