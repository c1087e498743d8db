//! Screening: fits every candidate at once, as sums over blocks of time from which the gain of any subset follows.
//!
//! Around the solution with all candidates, the response is X·δ, with δ the parameters less their known values; the
//! whitened samples less the known response are y = r + X·δ̂. A subset S of the columns then explains ½·gᵀA⁻¹g nats for
//! any values of the others, with A = X_Sᵀ·X_S and g = X_Sᵀ·y. Of two subsets, the better one explains more for its
//! price. The derivatives are those at the solution: products of effects that are present are right, and those of
//! absent effects do not matter.
//!
//! Whitened columns are transformed back into time, where they stay uncorrelated (the transform is orthonormal). Sums
//! over blocks of time are then parts of the likelihood. The numbers of a subset from some blocks explain gᵀβ −
//! ½·βᵀ·A·β in other blocks, with g and A of those others: a prediction of data that were not used to choose the
//! numbers.

use super::clipping::Bridges;
use super::design::{Column, State};
use super::solution::{Search, Solution};
use super::{Fit, NoiseLaw, Record, Request, ResponseError, report, solved};
use imu_model::effects::triad::Axes;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use std::ops::Range;

/// Share of the largest eigenvalue, for columns of length 1, below which a direction is rounding.
const OPEN: f64 = 1e-9;

/// A column that belongs to no effect of the library: its values per axis, as long as the record; `None` if it is 0
/// throughout.
pub type Extra = [Option<Vec<f64>>; 3];

/// A whitened column in time, per axis; `None` if it is 0 throughout. There are many. The effect of rounding to 24 bits
/// on the sums of their products is far below [`OPEN`].
type Held = [Option<Vec<f32>>; 3];

/// Sums over the blocks of a record.
#[derive(Debug, Clone)]
pub struct Screen {
    /// The fit of all candidates, without extra columns.
    pub fit: Fit,
    /// Number of columns of the fit's parameters; the extra columns follow in their order.
    pub own: usize,
    /// XᵀX and Xᵀy per block, in the order of time.
    pub blocks: Vec<(DMatrix<f64>, DVector<f64>)>,
    /// The sums of the blocks, with the prior information about open cutoffs.
    pub total: (DMatrix<f64>, DVector<f64>),
    /// The prior information about each column's number: the inverse variance about 0. It belongs to no single block,
    /// and therefore to each one in part.
    beforehand: Vec<f64>,
    /// Whitened columns in time, per axis.
    columns: Vec<Held>,
    /// Whitened samples less the known response, in time.
    samples: [Vec<f64>; 3],
}

/// Screens all candidates of a request and the extra columns.
///
/// # Errors
/// As [`super::fit`].
pub fn screen(
    record: &Record<'_>,
    law: &NoiseLaw,
    request: &Request<'_>,
    extras: impl IntoIterator<Item = Extra>,
    blocks: usize,
) -> Result<Screen, ResponseError> {
    solved(record, law, request, |known, search, solution, clipping| {
        let fit = report::report(record, request, known, search, &solution, clipping);
        let (columns, samples) = in_time(search, solution, known, extras);
        let own = search.design.slots.len();
        let n = record.reference.len();
        let sums: Vec<(DMatrix<f64>, DVector<f64>)> = (0..blocks.max(1))
            .map(|block| sums(&columns, &samples, n * block / blocks.max(1)..n * (block + 1) / blocks.max(1)))
            .collect();
        let mut total = (DMatrix::zeros(columns.len(), columns.len()), DVector::zeros(columns.len()));
        for (matrix, gradient) in &sums {
            total.0 += matrix;
            total.1 += gradient;
        }
        // The prior of a cutoff is one more observation without a time.
        let known = search.known();
        let beforehand =
            (0..columns.len()).map(|place| if place < own { known[(place, place)] } else { 0.0 }).collect();
        let mut corner = total.0.view_mut((0, 0), (own, own));
        corner += known;
        Screen { fit, own, blocks: sums, total, beforehand, columns, samples }
    })
}

/// Transforms whitened columns and samples back into time.
fn in_time(
    search: &mut Search<'_, '_>,
    solution: Solution,
    known: &State,
    extras: impl IntoIterator<Item = Extra>,
) -> (Vec<Held>, [Vec<f64>; 3]) {
    let Solution { state, residual: mut samples, columns, .. } = solution;
    for (slot, column) in search.design.slots.iter().zip(&columns) {
        let moved = state.value(*slot) - known.value(*slot);
        for (values, column) in samples.iter_mut().zip(column) {
            for (value, of) in values.iter_mut().zip(column.as_deref().unwrap_or_default()) {
                *value += moved * of;
            }
        }
    }
    // A bridge carries the noise of the few samples at its ends over many samples. In time, values are uncorrelated, so
    // that excluded samples get no weight instead.
    let stretches = search.whitening.bridges.each_ref().map(Bridges::stretches);
    let back = |search: &mut Search<'_, '_>, axis: usize, values: &mut Vec<f64>| {
        search.whitening.in_time(values);
        stretches[axis].iter().for_each(|stretch| values[stretch.clone()].fill(0.0));
    };
    // One after the other: keeping all columns beside all whitened ones would need twice the memory.
    let mut all: Vec<Held> = Vec::new();
    for column in columns {
        all.push(held(column, |axis, values| back(search, axis, values)));
    }
    for extra in extras {
        all.push(held(extra, |axis, values| {
            search.design.pass(&state, axis, values);
            search.whitening.whiten(axis, values);
            back(search, axis, values);
        }));
    }
    samples.iter_mut().enumerate().for_each(|(axis, values)| back(search, axis, values));
    (all, samples)
}

/// Returns a column after an operation on each of its axes.
fn held(column: Column, mut done: impl FnMut(usize, &mut Vec<f64>)) -> Held {
    let mut axis = 0;
    column.map(|values| {
        let values = values.map(|mut values| {
            done(axis, &mut values);
            values.into_iter().map(|value| value as f32).collect()
        });
        axis += 1;
        values
    })
}

/// Returns XᵀX and Xᵀy over a stretch of time.
fn sums(columns: &[Held], samples: &[Vec<f64>; 3], within: Range<usize>) -> (DMatrix<f64>, DVector<f64>) {
    let mut matrix = DMatrix::zeros(columns.len(), columns.len());
    let mut gradient = DVector::zeros(columns.len());
    let dot = |one: &[f32], other: &[f32]| {
        one.iter().zip(other).map(|(one, other)| f64::from(*one) * f64::from(*other)).sum::<f64>()
    };
    let with =
        |one: &[f32], other: &[f64]| one.iter().zip(other).map(|(one, other)| f64::from(*one) * other).sum::<f64>();
    for axis in 0..3 {
        let there: Vec<(usize, &[f32])> = columns
            .iter()
            .enumerate()
            .filter_map(|(place, column)| Some((place, column[axis].as_deref()?.get(within.clone())?)))
            .collect();
        for (place, (row, one)) in there.iter().enumerate() {
            gradient[*row] += with(one, &samples[axis][within.clone()]);
            for (column, other) in &there[..=place] {
                matrix[(*row, *column)] += dot(one, other);
            }
        }
    }
    matrix.fill_upper_triangle_with_lower_triangle();
    (matrix, gradient)
}

impl Screen {
    /// Returns the joint gain of the columns, nats, and their numbers, less the known values.
    pub fn gain(&self, columns: &[usize]) -> (f64, Vec<f64>) {
        solve(&self.total.0, &self.total.1, columns)
    }

    /// Drops the values of columns other than these and keeps their sums.
    pub fn keep(&mut self, columns: &[usize]) {
        for (place, column) in self.columns.iter_mut().enumerate() {
            if !columns.contains(&place) {
                *column = [None, None, None];
            }
        }
    }

    /// Returns the held-out gain in each block of the columns' numbers fitted to all other folds, nats. Every `folds`th
    /// block is of the same fold, so that each part of a motion is in all of them.
    pub fn held_out(&self, columns: &[usize], folds: usize) -> Vec<f64> {
        let mut explained = vec![0.0; self.blocks.len()];
        for fold in 0..folds {
            let (mut matrix, mut gradient) = (self.total.0.clone(), self.total.1.clone());
            for (own, more) in self.blocks.iter().skip(fold).step_by(folds) {
                matrix -= own;
                gradient -= more;
            }
            let (_, numbers) = solve(&matrix, &gradient, columns);
            for (block, (own, more)) in self.blocks.iter().enumerate().skip(fold).step_by(folds) {
                explained[block] = predicted(own, more, columns, &numbers) - self.strained(columns, &numbers);
            }
        }
        explained
    }

    /// Returns the gain of the columns with these numbers in each block, nats.
    pub fn explained(&self, columns: &[usize], numbers: &[f64]) -> Vec<f64> {
        let strained = self.strained(columns, numbers);
        self.blocks.iter().map(|(own, more)| predicted(own, more, columns, numbers) - strained).collect()
    }

    /// Returns the nats per block lost because these numbers differ from their prior values.
    fn strained(&self, columns: &[usize], numbers: &[f64]) -> f64 {
        let all: f64 =
            columns.iter().zip(numbers).map(|(column, number)| self.beforehand[*column] * number * number).sum();
        0.5 * all / self.blocks.len().max(1) as f64
    }

    /// Returns, per axis and sample, half the square of the whitened contribution of the columns with these numbers.
    /// Its sum is the gap of the columns, nats; the gap lies where the values are large.
    pub fn course(&self, columns: &[usize], numbers: &[f64]) -> [Vec<f64>; 3] {
        std::array::from_fn(|axis| {
            let mut sum = vec![0.0; self.samples[axis].len()];
            for (place, number) in columns.iter().zip(numbers) {
                for (value, of) in sum.iter_mut().zip(self.columns[*place][axis].as_deref().unwrap_or_default()) {
                    *value += number * f64::from(*of);
                }
            }
            sum.into_iter().map(|value| 0.5 * value * value).collect()
        })
    }

    /// Returns the sums of [`Screen::course`] per axis, nats.
    pub fn by_axis(&self, columns: &[usize], numbers: &[f64]) -> Axes {
        self.course(columns, numbers).map(|values| values.into_iter().sum())
    }
}

/// Returns gᵀβ − ½ βᵀAβ.
fn predicted(matrix: &DMatrix<f64>, gradient: &DVector<f64>, columns: &[usize], numbers: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (row, one) in columns.iter().zip(numbers) {
        sum += one * gradient[*row];
        for (column, other) in columns.iter().zip(numbers) {
            sum -= 0.5 * one * other * matrix[(*row, *column)];
        }
    }
    sum
}

/// Returns ½ gᵀA⁺g over these columns, and A⁺g; directions without information are 0.
fn solve(matrix: &DMatrix<f64>, gradient: &DVector<f64>, columns: &[usize]) -> (f64, Vec<f64>) {
    let lengths: Vec<f64> = columns.iter().map(|place| matrix[(*place, *place)].max(0.0).sqrt()).collect();
    let used: Vec<usize> = (0..columns.len()).filter(|place| lengths[*place] > 0.0).collect();
    let mut numbers = vec![0.0; columns.len()];
    if used.is_empty() {
        return (0.0, numbers);
    }
    let at = |place: usize| columns[used[place]];
    let scaled = DMatrix::from_fn(used.len(), used.len(), |row, column| {
        matrix[(at(row), at(column))] / (lengths[used[row]] * lengths[used[column]])
    });
    let right = DVector::from_fn(used.len(), |row, _| gradient[at(row)] / lengths[used[row]]);
    let solution = match scaled.clone().cholesky().filter(|root| root.l_dirty().diagonal().min() > OPEN.sqrt()) {
        Some(root) => root.solve(&right),
        None => {
            let eigen = SymmetricEigen::new(scaled);
            let largest = eigen.eigenvalues.max();
            let mut along = eigen.eigenvectors.tr_mul(&right);
            for (value, eigenvalue) in along.iter_mut().zip(eigen.eigenvalues.iter()) {
                *value = if *eigenvalue > OPEN * largest { *value / eigenvalue } else { 0.0 };
            }
            &eigen.eigenvectors * along
        }
    };
    for (place, value) in used.iter().zip(solution.iter()) {
        numbers[*place] = value / lengths[*place];
    }
    (0.5 * right.dot(&solution), numbers)
}

#[cfg(test)]
mod tests {
    use super::super::round_trip::{Case, RATE_HZ, rate_table};
    use super::super::{Candidate, Clock, NO_FILTERS, fit};
    use super::*;
    use imu_core::sample::Triad;

    #[test]
    fn a_subset_gains_what_its_own_fit_gains_and_blocks_add_up() {
        let scale = (Candidate::ScaleFactor, vec![2e-3, -1e-3, 5e-4]);
        let turned = (Candidate::Misalignment, vec![1e-3, 0.0, -2e-3]);
        let case = Case::new(Triad::Gyro, rate_table(), &[scale, turned]);
        let samples = case.samples(5);
        let record = Record {
            rate_hz: RATE_HZ,
            triad: Triad::Gyro,
            samples: samples.each_ref().map(Vec::as_slice),
            reference: &case.reference,
            temperature_c: None,
            left_out: &[],
            sent: None,
        };
        let request = |candidates| Request {
            known: &[],
            level: [0.0; 3],
            candidates,
            clock: Clock::Shared,
            filters: &NO_FILTERS,
        };
        let all = [Candidate::ScaleFactor, Candidate::Misalignment, Candidate::Bias];
        let squares: Vec<f64> = case.reference.iter().map(|motion| motion.gyro_rad_s[0].powi(3)).collect();
        let extra: Extra = [Some(squares), None, None];
        let found = screen(&record, &case.law, &request(&all), vec![extra], 16).unwrap();
        assert_eq!((found.own, found.total.1.len()), (9, 10));
        let columns: Vec<usize> = (0..6).collect();
        let (gain, numbers) = found.gain(&columns);
        let alone = fit(&record, &case.law, &request(&all[..2])).unwrap();
        // They differ by products of effects of some thousandths.
        let by_fit = case.gain(&alone, &fit(&record, &case.law, &request(&[])).unwrap());
        assert!((gain / by_fit - 1.0).abs() < 4e-3, "{gain} {by_fit}");
        for (number, estimate) in numbers.iter().zip(&alone.estimates) {
            assert!((number - estimate.value).abs() < 0.05 * estimate.standard_error.unwrap(), "{estimate:?}");
        }
        let explained: f64 = found.explained(&columns, &numbers).iter().sum();
        assert!((explained / gain - 1.0).abs() < 1e-9);
        let held_out: f64 = found.held_out(&columns, 4).iter().sum();
        // Six numbers from three quarters of the data explain less by about p/2·(1 + 1/3), give or take a few nats.
        assert!(held_out < gain && gain - held_out < 25.0, "{held_out} of {gain}");
        assert!((found.by_axis(&columns, &numbers).iter().sum::<f64>() / gain - 1.0).abs() < 1e-9);
        // A cube explains no more here than chance.
        let (more, _) = found.gain(&[0, 1, 2, 3, 4, 5, 9]);
        assert!((0.0..8.0).contains(&(more - gain)), "{}", more - gain);
    }

    #[test]
    fn what_was_known_of_a_cutoff_counts_as_an_observation_that_no_block_has() {
        use crate::response::Filters;
        use imu_model::effects::{Effect, LowPass};
        use std::sync::Arc;
        let case = Case::new(Triad::Gyro, rate_table(), &[(Candidate::Latency, vec![0.02])]);
        let samples = case.samples(6);
        let record = Record {
            rate_hz: RATE_HZ,
            triad: Triad::Gyro,
            samples: samples.each_ref().map(Vec::as_slice),
            reference: &case.reference,
            temperature_c: None,
            left_out: &[],
            sent: None,
        };
        let found = |error: f64| {
            let low_pass = || vec![Arc::new(LowPass::new(5.0, 1)) as Arc<dyn Effect>];
            let filters = Filters { of: [low_pass(), low_pass(), low_pass()], open: [Some((0, error)); 3] };
            let request = Request {
                known: &[],
                level: [0.0; 3],
                candidates: &[Candidate::Latency],
                clock: Clock::Shared,
                filters: &filters,
            };
            screen(&record, &case.law, &request, Vec::new(), 16).unwrap()
        };
        for error in [1e-3, 0.3] {
            let found = found(error);
            let columns: Vec<usize> = (0..found.own).collect();
            let (gain, numbers) = found.gain(&columns);
            let explained: f64 = found.explained(&columns, &numbers).iter().sum();
            assert!((explained / gain - 1.0).abs() < 1e-9, "{explained} {gain}");
            let strained: f64 = numbers[1..4].iter().map(|number| 0.5 * (number / error).powi(2)).sum();
            let of_blocks: f64 = found.blocks.iter().map(|(own, more)| predicted(own, more, &columns, &numbers)).sum();
            assert!((of_blocks - strained - gain).abs() < 1e-6 * gain, "{of_blocks} {strained} {gain}");
        }
    }
}
