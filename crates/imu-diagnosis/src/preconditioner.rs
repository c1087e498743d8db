//! Preconditioner: the precision matrix among some samples; for many samples, restricted to pairs that are near each other.

use super::dot::dot;

/// The Cholesky factor of a matrix that is a function of the distance between places, reflected at the record's ends.
///
/// Among many places it is tapered to 0 for far places. Parzen's window is a positive definite function, so that the
/// tapered matrix is positive definite if the whole one is (Schur's product theorem). The window's transform falls with
/// the fourth power, so that a zero of a filter hides few frequencies beside it.
#[derive(Debug, Clone)]
pub(super) struct Preconditioner {
    /// By row: the first column, and the factor's entries from there to the diagonal.
    rows: Vec<(usize, Vec<f64>)>,
    /// Whether all pairs of places are included.
    pub(super) is_whole: bool,
}

impl Preconditioner {
    /// Factors the matrix among `places` (in order) of a record of `length` samples; `kernel` is the matrix by distance,
    /// from 0 on. `None` if the factorization fails numerically.
    pub(super) fn of(kernel: &[f64], places: &[usize], length: usize) -> Option<Self> {
        /// Approximate number of products for making the factor, per sample of the record and in all: transforms of a short
        /// record cost little. In long runs, only nearer samples are used.
        const WORK_PER_SAMPLE: usize = 500;
        const WORK: usize = 30_000_000;
        let most = WORK.min(WORK_PER_SAMPLE * length);
        /// The distance of places that count as near if there are many.
        const REACH: usize = 512;
        const LEAST: usize = 8;
        let firsts = |reach: usize| {
            let mut first = 0;
            let of = move |place: &usize| {
                while places[first] + reach <= *place {
                    first += 1;
                }
                first
            };
            places.iter().map(of).collect::<Vec<usize>>()
        };
        let work =
            |firsts: &[usize]| firsts.iter().enumerate().map(|(row, first)| (row - first + 1).pow(2)).sum::<usize>();
        let is_whole = places.len().pow(3) / 3 <= most;
        let mut reach = if is_whole { length } else { REACH };
        let mut first = firsts(reach);
        while !is_whole && reach > LEAST && work(&first) > most {
            reach /= 2;
            first = firsts(reach);
        }
        let at = |distance: usize| kernel.get(distance).copied().unwrap_or_default();
        let entry = |i: usize, j: usize| match is_whole {
            true => at(i - j) + at(i + j + 1) + at(2 * length - 1 - i - j),
            false => at(i - j) * parzen((i - j) as f64 / reach as f64),
        };
        let mut rows: Vec<(usize, Vec<f64>)> = Vec::with_capacity(places.len());
        for (row, first) in first.into_iter().enumerate() {
            let mut own: Vec<f64> = (first..=row).map(|column| entry(places[row], places[column])).collect();
            for column in first..row {
                let (begin, other) = &rows[column];
                let from = first.max(*begin);
                let sum = dot(&own[from - first..column - first], &other[from - begin..column - begin]);
                own[column - first] = (own[column - first] - sum) / other[column - begin];
            }
            let (diagonal, before) = own.split_last_mut()?;
            *diagonal -= dot(before, before);
            if diagonal.is_nan() || *diagonal <= 0.0 {
                return None;
            }
            *diagonal = diagonal.sqrt();
            rows.push((first, own));
        }
        Some(Self { rows, is_whole })
    }

    /// Solves the equations of the matrix that was factored.
    pub(super) fn solve(&self, right: &[f64]) -> Vec<f64> {
        let mut x = right.to_vec();
        for (row, (first, own)) in self.rows.iter().enumerate() {
            let (diagonal, before) = own.split_last().map_or((1.0, &own[..0]), |(last, before)| (*last, before));
            x[row] = (x[row] - dot(before, &x[*first..row])) / diagonal;
        }
        for (row, (first, own)) in self.rows.iter().enumerate().rev() {
            let (diagonal, before) = own.split_last().map_or((1.0, &own[..0]), |(last, before)| (*last, before));
            x[row] /= diagonal;
            let value = x[row];
            x[*first..row].iter_mut().zip(before).for_each(|(x, a)| *x -= a * value);
        }
        x
    }
}

/// Returns Parzen's window at a part of its reach.
fn parzen(part: f64) -> f64 {
    if part <= 0.5 { 1.0 - 6.0 * part * part * (1.0 - part) } else { 2.0 * (1.0 - part).max(0.0).powi(3) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kernel(lags: i32) -> Vec<f64> {
        (0..lags).map(|lag| (-0.3 * f64::from(lag)).exp() * (0.7 * f64::from(lag)).cos()).collect()
    }

    /// Asserts that a right side made from a known solution is solved.
    fn assert_solves(near: &Preconditioner, places: &[usize], entry: impl Fn(usize, usize) -> f64) {
        let wanted: Vec<f64> = (0..places.len()).map(|at| (at as f64 % 7.0 - 3.0) * 0.7).collect();
        let row = |i: usize| places.iter().zip(&wanted).map(|(j, value)| entry(places[i], *j) * value).sum::<f64>();
        let right: Vec<f64> = (0..places.len()).map(row).collect();
        let found = near.solve(&right);
        assert!(found.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-11), "{found:?}");
    }

    #[test]
    fn few_places_are_solved_exactly_with_the_reflection_at_the_ends() {
        let (kernel, length) = (kernel(200), 200);
        let places = [0, 3, 4, 9, 30, 31, 33, 80, 120, 199];
        let near = Preconditioner::of(&kernel, &places, length).unwrap();
        assert!(near.is_whole);
        let at = |distance: usize| kernel.get(distance).copied().unwrap_or_default();
        assert_solves(&near, &places, |i, j| at(i.abs_diff(j)) + at(i + j + 1) + at(2 * length - 1 - i - j));
    }

    #[test]
    fn many_places_are_solved_as_the_tapered_matrix_is() {
        let kernel = kernel(1000);
        let places: Vec<usize> = (0..2000).map(|at| 50 * at).collect();
        let near = Preconditioner::of(&kernel, &places, 100_000).unwrap();
        assert!(!near.is_whole);
        let entry = |i: usize, j: usize| {
            let distance = i.abs_diff(j);
            if distance < 512 { kernel[distance] * parzen(distance as f64 / 512.0) } else { 0.0 }
        };
        assert_solves(&near, &places, entry);
    }

    #[test]
    fn what_is_not_positive_definite_has_no_factor() {
        assert!(Preconditioner::of(&[1.0, 2.0, 2.0, 2.0], &[20, 21, 22], 100).is_none());
        assert!(Preconditioner::of(&[f64::NAN], &[0], 1).is_none());
    }
}
