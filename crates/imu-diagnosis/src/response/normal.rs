//! Normal equations of a whitened design: the step, its covariance, and the directions that the motion leaves open.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Share of the largest eigenvalue (of the design with columns of length 1) below which a direction is open: the rest
/// is rounding.
const OPEN: f64 = 1e-10;
/// A direction is also open if its standard error exceeds the one that carries no information by this factor. Effects
/// of first order would be larger than their input, and steps along the direction do not converge.
const BEYOND: f64 = 10.0;
/// Share below which a direction hardly shows: it increases standard errors thirtyfold.
const FAINT: f64 = 1e-3;
/// Minimum length of a column as a share of the longest column of its effect; shorter ones are rounding.
const NOTHING: f64 = 1e-9;

/// Normal equations with their eigenvalues.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    /// Scales of all slots; 0 if the column is not used.
    scales: Vec<f64>,
    values: DVector<f64>,
    vectors: DMatrix<f64>,
    used: Vec<usize>,
    /// Whether each direction is open.
    open: Vec<bool>,
}

impl Normal {
    /// Creates the equations from XᵀX. `unseen` is the standard error from which on a column carries no information;
    /// `effects` is the effect of each column.
    pub(super) fn new(matrix: &DMatrix<f64>, unseen: &[f64], effects: &[usize]) -> Self {
        let lengths: Vec<f64> = (0..matrix.nrows()).map(|place| matrix[(place, place)].sqrt()).collect();
        let longest = |effect: usize| {
            let of = lengths.iter().zip(effects).filter(|(_, other)| **other == effect);
            of.map(|(length, _)| *length).fold(0.0, f64::max)
        };
        let seen = |place: &usize| {
            let length = lengths[*place];
            length > 0.0 && length > NOTHING * longest(effects[*place]) && length.recip() < unseen[*place]
        };
        let used: Vec<usize> = (0..lengths.len()).filter(seen).collect();
        let mut scales = vec![0.0; lengths.len()];
        used.iter().for_each(|place| scales[*place] = lengths[*place].recip());
        let scaled = DMatrix::from_fn(used.len(), used.len(), |row, column| {
            matrix[(used[row], used[column])] * scales[used[row]] * scales[used[column]]
        });
        let (values, vectors) = if used.is_empty() {
            (DVector::zeros(0), DMatrix::zeros(0, 0))
        } else {
            let eigen = SymmetricEigen::new(scaled);
            (eigen.eigenvalues, eigen.eigenvectors)
        };
        let largest = values.iter().copied().fold(0.0, f64::max);
        let open = (0..used.len())
            .map(|direction| {
                let value: f64 = values[direction];
                let beyond = |(row, place): (usize, &usize)| {
                    let error = scales[*place] * vectors[(row, direction)].abs() / value.sqrt();
                    error > BEYOND * unseen[*place]
                };
                value < OPEN * largest || used.iter().enumerate().any(beyond)
            })
            .collect();
        Self { scales, values, vectors, used, open }
    }

    fn largest(&self) -> f64 {
        self.values.iter().copied().fold(0.0, f64::max)
    }

    fn share(&self, direction: usize) -> f64 {
        self.values[direction] / self.largest().max(f64::MIN_POSITIVE)
    }

    /// Returns the inverse of XᵀX, with 0 in open directions; its size is the number of slots.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let slots = self.scales.len();
        let mut inverse = DMatrix::zeros(slots, slots);
        for direction in (0..self.used.len()).filter(|direction| !self.open[*direction]) {
            for (row, of_row) in self.used.iter().enumerate() {
                for (column, of_column) in self.used.iter().enumerate() {
                    let both = self.vectors[(row, direction)] * self.vectors[(column, direction)];
                    inverse[(*of_row, *of_column)] +=
                        both / self.values[direction] * self.scales[*of_row] * self.scales[*of_column];
                }
            }
        }
        inverse
    }

    /// Returns the columns without information.
    pub(super) fn unseen(&self) -> Vec<usize> {
        (0..self.scales.len()).filter(|place| self.scales[*place] <= 0.0).collect()
    }

    /// Returns groups of columns among which a direction is open.
    pub(super) fn open_groups(&self) -> Vec<Vec<usize>> {
        self.groups(|direction| self.open[direction])
    }

    /// Returns groups of columns among which a direction hardly shows.
    pub(super) fn faint_groups(&self) -> Vec<Vec<usize>> {
        self.groups(|direction| !self.open[direction] && self.share(direction) < FAINT)
    }

    /// Returns the groups of columns of such directions. The projection on the directions splits into blocks for any
    /// basis of eigenvectors.
    fn groups(&self, of: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
        /// The part of a column in those directions, and of two columns together, that counts.
        const PART: f64 = 0.01;
        let directions: Vec<usize> = (0..self.used.len()).filter(|place| of(*place)).collect();
        let shared = |row: usize, column: usize| {
            directions.iter().map(|place| self.vectors[(row, *place)] * self.vectors[(column, *place)]).sum::<f64>()
        };
        let mut rest: Vec<usize> = (0..self.used.len()).filter(|place| shared(*place, *place) > PART).collect();
        let mut groups = Vec::new();
        while let Some(first) = (!rest.is_empty()).then(|| rest.remove(0)) {
            let mut group = vec![first];
            let mut place = 0;
            while place < group.len() {
                let member = group[place];
                let (joined, apart) = rest.iter().partition(|other| shared(member, **other).abs() > PART);
                group.extend::<Vec<usize>>(joined);
                rest = apart;
                place += 1;
            }
            group.sort_unstable();
            groups.push(group.into_iter().map(|place| self.used[place]).collect());
        }
        groups
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_that_are_one_and_those_that_are_nothing_are_named() {
        // Column 1 is twice column 0; 2 and 3 are nearly equal; 4 is 0; 5 is independent.
        let columns = [
            [1.0, 0.0, 0.0, 0.0],
            [2.0, 0.0, 0.0, 0.0],
            [0.0, 1e6, 1e3, 0.0],
            [0.0, 1e6, -1e3, 0.0],
            [0.0; 4],
            [0.0, 0.0, 0.0, 1e-9],
        ];
        let dot = |row: usize, column: usize| (0..4).map(|at| columns[row][at] * columns[column][at]).sum::<f64>();
        let matrix = DMatrix::from_fn(6, 6, dot);
        let normal = Normal::new(&matrix, &[f64::INFINITY; 6], &[0, 1, 2, 3, 4, 5]);
        assert_eq!(normal.unseen(), [4]);
        assert_eq!(normal.open_groups(), [[0, 1]]);
        assert_eq!(normal.faint_groups(), [[2, 3]]);
        assert!((normal.largest() - 2.0).abs() < 1e-9, "{}", normal.largest());
        let inverse = normal.inverse();
        assert!((inverse[(5, 5)] * 1e-18 - 1.0).abs() < 1e-9);
        // The joint effect of both columns of a pair is still known.
        let sum = inverse[(0, 0)] + 4.0 * inverse[(1, 1)] + 4.0 * inverse[(0, 1)];
        assert!((sum - 1.0).abs() < 1e-9);
        assert_eq!(Normal::new(&matrix, &[1e-3; 6], &[0; 6]).unseen(), [0, 1, 4, 5]);
    }
}
