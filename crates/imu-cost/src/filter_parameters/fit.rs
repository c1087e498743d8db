//! Fits: the variances of two known kinds of noise whose joint covariance is closest to a real one, and the closest that
//! is nowhere smaller.
//!
//! In: moments. Out: two variances. A filter predicts Σ = a·A + b·B with A of white noise of 1 U/√Hz and B of the second
//! kind. The divergence of the real covariance C from it is ½(tr Σ⁻¹C − ln det Σ⁻¹C − M) (Kullback and Leibler 1951, for
//! normal laws of the same mean). With A = LLᵀ and L⁻¹BL⁻ᵀ = UΛUᵀ it depends on C by the diagonal c of UᵀL⁻¹CL⁻ᵀU alone:
//!
//! ```text
//! 2·divergence + constant = Σ c_i/(a + b λ_i) + ln(a + b λ_i)
//! ```
//!
//! For a ratio ρ = b/a the best a is the mean of c_i/(1 + ρλ_i). What is left is a function of ρ; all its minima are
//! bracketed on a grid and bisected. The covering pair lies where the conditions a·A_k + b·B_k ≥ C_k of the horizons end:
//! for each b the smallest a follows, and b is searched for.
//!
//! Validation: `white_noise_and_a_walk_are_found_again`, `the_closest_pair_is_the_closest_on_a_grid`,
//! `the_covering_pair_covers_and_is_the_closest_that_does`.

use super::moments::Moments;
use super::request::Grid;
use nalgebra::{Cholesky, DMatrix, SymmetricEigen};

/// Points per factor e of the ratio on which minima are bracketed.
const RATIO_POINTS: f64 = 6.0;
/// Ratios are searched until one kind of noise is this part of the other at every horizon.
const NEGLIGIBLE: f64 = 1e-9;
/// A simpler answer, one kind of noise alone, is taken if it is at most this much farther away, in nats.
const SAME: f64 = 1e-11;
/// Real covariances whose relative eigenvalues are smaller than this have no finite divergence.
const SINGULAR: f64 = 1e-12;
/// A bend of logarithms from one horizon to the next that counts as that of a smooth curve; what bends more is a line's phase,
/// whose worst horizons are in the grid.
const SMOOTH: f64 = 0.05;
/// Points of the search for a covering pair.
const COVER_POINTS: usize = 200;
/// Predictions that fall short by less than this part of a variance cover up to rounding.
const ROUNDING: f64 = 1e-7;

/// Variances of white noise, (U/√Hz)², and of the second kind of noise.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Variances {
    pub white: f64,
    pub second: f64,
}

/// What a filter can predict with two kinds of noise.
#[derive(Debug)]
pub(crate) struct Family {
    white: Moments,
    second: Moments,
    /// L⁻ᵀU.
    transform: DMatrix<f64>,
    lambda: Vec<f64>,
    joint: usize,
}

/// A real covariance as a family sees it.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    /// Diagonal in the family's own coordinates.
    diagonal: Vec<f64>,
    /// Logarithm of the determinant in these coordinates; none if the covariance is singular.
    log_det: Option<f64>,
    /// Variance at each horizon of the grid, (U·s)².
    pub variances: Vec<f64>,
}

/// Returns the covariance of the jointly fitted horizons.
fn joint(grid: &Grid, moments: &[f64]) -> DMatrix<f64> {
    let size = grid.joint.len();
    DMatrix::from_fn(size, size, |row, column| {
        let (row, column) = (row.max(column), row.min(column));
        moments[row * (row + 1) / 2 + column]
    })
}

impl Family {
    /// Creates the family of white noise and a second kind, from the moments of one unit of each; `None` if the
    /// covariance of white noise is not positive definite in floating-point numbers.
    pub(crate) fn new(grid: &Grid, white: &[f64], second: &[f64]) -> Option<Self> {
        let lower = Cholesky::new(joint(grid, white))?.l();
        let half = lower.solve_lower_triangular(&joint(grid, second))?;
        let inner = lower.solve_lower_triangular(&half.transpose())?;
        let eigen = SymmetricEigen::new(0.5 * (&inner + inner.transpose()));
        let largest = eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
        let transform = lower.transpose().solve_upper_triangular(&eigen.eigenvectors)?;
        Some(Self {
            white: white[grid.joint_pairs()..].to_vec(),
            second: second[grid.joint_pairs()..].to_vec(),
            transform,
            lambda: eigen.eigenvalues.iter().map(|value| value.max(f64::EPSILON * largest)).collect(),
            joint: grid.joint_pairs(),
        })
    }

    /// Returns a real covariance as the family sees it.
    pub(crate) fn seen(&self, grid: &Grid, real: &[f64]) -> Seen {
        let inner = self.transform.transpose() * joint(grid, real) * &self.transform;
        let eigen = SymmetricEigen::new(0.5 * (&inner + inner.transpose())).eigenvalues;
        let largest = eigen.iter().copied().fold(0.0, f64::max);
        let is_regular = eigen.iter().all(|value| *value > SINGULAR * largest);
        Seen {
            diagonal: inner.diagonal().iter().map(|value| value.max(0.0)).collect(),
            log_det: is_regular.then(|| eigen.iter().map(|value| value.ln()).sum()),
            variances: real[self.joint..].iter().map(|value| value.max(0.0)).collect(),
        }
    }

    /// Returns the predicted variance at each horizon of the grid.
    pub(crate) fn predicted(&self, of: Variances) -> Vec<f64> {
        self.white.iter().zip(&self.second).map(|(white, second)| of.white * white + of.second * second).collect()
    }

    /// Returns twice the divergence up to a constant.
    pub(crate) fn distance(&self, of: Variances, seen: &Seen) -> f64 {
        let term = |(real, lambda): (&f64, &f64)| {
            let own = of.white + of.second * lambda;
            real / own + own.ln()
        };
        seen.diagonal.iter().zip(&self.lambda).map(term).sum()
    }

    /// Returns the divergence in nats; none if the real covariance is singular, or the predicted one is 0.
    pub(crate) fn divergence(&self, of: Variances, seen: &Seen) -> Option<f64> {
        let all = 0.5 * (self.distance(of, seen) - seen.log_det? - seen.diagonal.len() as f64);
        Some(all.max(0.0)).filter(|nats| nats.is_finite())
    }

    /// Returns the closest variance of white noise alone.
    pub(crate) fn white_alone(&self, seen: &Seen) -> Variances {
        Variances { white: seen.diagonal.iter().sum::<f64>() / seen.diagonal.len() as f64, second: 0.0 }
    }

    /// Returns the closest variances.
    pub(crate) fn closest(&self, seen: &Seen) -> Variances {
        let count = seen.diagonal.len() as f64;
        let white = self.white_alone(seen);
        if white.white <= 0.0 {
            return Variances::default();
        }
        let own = seen.diagonal.iter().zip(&self.lambda);
        let second_alone = own.clone().map(|(real, lambda)| real / lambda).sum::<f64>() / count;
        let at = |log_ratio: f64| {
            let ratio = log_ratio.exp();
            let white = own.clone().map(|(real, lambda)| real / (1.0 + ratio * lambda)).sum::<f64>() / count;
            Variances { white, second: ratio * white }
        };
        // The derivative of the distance with respect to the ratio's logarithm.
        let slope = |log_ratio: f64| {
            let (ratio, white) = (log_ratio.exp(), at(log_ratio).white);
            let part = |(real, lambda): (&f64, &f64)| {
                let share = ratio * lambda / (1.0 + ratio * lambda);
                share - real / white * share / (1.0 + ratio * lambda)
            };
            own.clone().map(part).sum::<f64>()
        };
        let (least, most) = self
            .lambda
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(least, most), lambda| (least.min(*lambda), most.max(*lambda)));
        let (from, to) = ((NEGLIGIBLE / most).ln(), (1.0 / (NEGLIGIBLE * least)).ln());
        if !(from.is_finite() && to.is_finite()) {
            return white;
        }
        let steps = (RATIO_POINTS * (to - from)).ceil() as usize;
        let points: Vec<f64> = (0..=steps).map(|k| from + (to - from) * k as f64 / steps as f64).collect();
        let mut best = white;
        let mut nearest = self.distance(white, seen) - SAME;
        let mut try_one = |other: Variances, better_by: f64| {
            let distance = self.distance(other, seen);
            if distance.is_finite() && distance < nearest - better_by {
                (best, nearest) = (other, distance);
            }
        };
        for pair in points.windows(2) {
            if slope(pair[0]) < 0.0 && slope(pair[1]) >= 0.0 {
                try_one(at(bisect(pair[0], pair[1], |log_ratio| slope(log_ratio) < 0.0)), 0.0);
            }
        }
        if second_alone.is_finite() {
            try_one(Variances { white: 0.0, second: second_alone }, -SAME);
        }
        best
    }

    /// Returns the closest variances that predict at least the real variance at every horizon of the grid.
    pub(crate) fn covering(&self, closest: Variances, seen: &Seen) -> Variances {
        if self.shortfall(closest, seen).0 <= 1.0 + ROUNDING {
            return self.raised(closest, seen);
        }
        let all = || seen.variances.iter().zip(self.white.iter().zip(&self.second));
        let most = all().map(|(real, (_, second))| real / second).fold(0.0, f64::max);
        let with = |second: f64| {
            let white = all().map(|(real, (white, unit))| (real - second * unit) / white).fold(0.0, f64::max);
            Variances { white, second }
        };
        let distance = |second: f64| self.distance(with(second), seen);
        let log_from = (most * NEGLIGIBLE * NEGLIGIBLE).max(f64::MIN_POSITIVE).ln();
        let step = (most.ln() - log_from) / COVER_POINTS as f64;
        let points: Vec<f64> = (0..=COVER_POINTS).map(|k| (most.ln() - step * k as f64).exp()).chain([0.0]).collect();
        let smaller = |one: &f64, other: &f64| distance(*one).total_cmp(&distance(*other));
        let Some(start) = points.iter().copied().min_by(smaller) else { return closest };
        let found = golden(start.ln() - step, (start.ln() + step).min(most.ln()), |log| distance(log.exp())).exp();
        let best = if start > 0.0 && distance(found) <= distance(start) { found } else { start };
        self.raised(with(best), seen)
    }

    /// Returns the closest white noise alone that covers.
    pub(crate) fn covering_white(&self, seen: &Seen) -> Variances {
        let white = seen.variances.iter().zip(&self.white).map(|(real, white)| real / white).fold(0.0, f64::max);
        self.raised(Variances { white, second: 0.0 }, seen)
    }

    /// Returns the largest ratio of a real variance to the predicted one, and the place of its horizon; between horizons
    /// of the grid it is that of a parabola.
    pub(crate) fn shortfall(&self, of: Variances, seen: &Seen) -> (f64, usize) {
        let logs: Vec<f64> = seen
            .variances
            .iter()
            .zip(self.predicted(of))
            .map(|(real, predicted)| if *real > 0.0 { (real / predicted).ln() } else { f64::NEG_INFINITY })
            .collect();
        let mut largest = (f64::NEG_INFINITY, 0);
        for (place, own) in logs.iter().enumerate() {
            let mut peak = *own;
            if let [before, middle, after] = *logs.get(place.saturating_sub(1)..place + 2).unwrap_or_default()
                && middle >= before
                && middle >= after
                && before.is_finite()
                && after.is_finite()
                && middle.is_finite()
            {
                let bend = 2.0 * middle - before - after;
                peak += if bend > 0.0 && bend < SMOOTH { (after - before).powi(2) / (8.0 * bend) } else { 0.0 };
            }
            if peak > largest.0 {
                largest = (peak, place);
            }
        }
        (largest.0.exp(), largest.1)
    }

    /// Returns variances that are raised so that nothing falls short. One that matters at no horizon is 0.
    fn raised(&self, of: Variances, seen: &Seen) -> Variances {
        let matters = |own: f64, unit: &[f64]| {
            self.predicted(of).iter().zip(unit).any(|(all, unit)| own * unit > NEGLIGIBLE * all)
        };
        let of = Variances {
            white: if matters(of.white, &self.white) { of.white } else { 0.0 },
            second: if matters(of.second, &self.second) { of.second } else { 0.0 },
        };
        let factor = self.shortfall(of, seen).0;
        if factor > 1.0 && factor.is_finite() {
            return Variances { white: of.white * factor, second: of.second * factor };
        }
        of
    }
}

/// Returns where a condition that holds at `low` ends.
pub(crate) fn bisect(mut low: f64, mut high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if holds(middle) { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Returns where a function with one minimum between two points is smallest (golden section).
pub(crate) fn golden(mut low: f64, mut high: f64, of: impl Fn(f64) -> f64) -> f64 {
    let part = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut left, mut right) = (high - part * (high - low), low + part * (high - low));
    let (mut at_left, mut at_right) = (of(left), of(right));
    for _ in 0..60 {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - part * (high - low);
            at_left = of(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + part * (high - low);
            at_right = of(right);
        }
    }
    0.5 * (low + high)
}
