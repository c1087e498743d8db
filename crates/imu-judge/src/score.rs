//! Scores: whether errors are those that a filter's covariance states.
//!
//! In: ends of outages. Out: the average normalised square error (NEES) with its bounds, coverage, log score.

use crate::outage::Outcome;
use nalgebra::{Cholesky, DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::f64::consts::TAU;
use std::ops::Range;

/// The normal distribution's 97.5 % point.
const NORMAL_95: f64 = 1.959_963_984_540_054;

/// The scores of a filter.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// The number of outages.
    pub outages: usize,
    /// The average of eᵀP⁻¹e over outages, by the number of errors in e: 1 if the covariance is right.
    pub nees: f64,
    /// What the average stays between with 95 % if the errors are normal, independent from outage to outage, and have the stated
    /// covariance.
    pub bounds: [f64; 2],
    /// The share of single errors within 1.96 of their standard deviations.
    pub coverage: f64,
    /// The mean of −ln p(e) by the number of errors in e, nats; p is the normal density of the stated covariance, with errors in
    /// rad, m/s and m. A smaller one is better, and a difference has no unit.
    pub log_score: f64,
}

impl Score {
    /// Returns whether the average NEES is within its bounds.
    pub fn is_consistent(&self) -> bool {
        (self.bounds[0]..=self.bounds[1]).contains(&self.nees)
    }
}

/// Returns the scores of the errors at `places` (0 … 9: attitude, velocity, position). `None` if there is no outage, or if a
/// covariance is not positive definite.
///
/// # Source
/// NEES and its bounds, χ² of as many degrees of freedom as errors: Bar-Shalom, Li and Kirubarajan 2001, section 5.4. Log score:
/// Gneiting and Raftery 2007, JASA 102.
///
/// # Validation
/// `a_filter_that_knows_its_noise_is_consistent`, `scores_of_known_errors`.
pub fn score(outcomes: &[Outcome], places: Range<usize>) -> Option<Score> {
    let size = places.len();
    let all = (outcomes.len() * size) as f64;
    let (mut nees, mut inside, mut log_score) = (0.0, 0, 0.0);
    for outcome in outcomes {
        let errors = DVector::from_fn(size, |row, _| outcome.errors[places.start + row]);
        let covariance =
            DMatrix::from_fn(size, size, |row, column| outcome.covariance[(places.start + row, places.start + column)]);
        inside += (0..size).filter(|at| errors[*at].abs() <= NORMAL_95 * covariance[(*at, *at)].sqrt()).count();
        let root = Cholesky::new(covariance)?;
        let square = errors.dot(&root.solve(&errors));
        nees += square;
        log_score += 0.5 * (square + size as f64 * TAU.ln() + root.ln_determinant());
    }
    let chi = ChiSquared::new(all).ok()?;
    Some(Score {
        outages: outcomes.len(),
        nees: nees / all,
        bounds: [0.025, 0.975].map(|part| chi.inverse_cdf(part) / all),
        coverage: inside as f64 / all,
        log_score: log_score / all,
    })
}
