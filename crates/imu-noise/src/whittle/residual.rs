//! The residual test: whether the spectrum agrees with the model.

use super::likelihood::{Likelihood, Model};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Below this p-value the model does not describe the data, and intervals are widened to the scatter.
pub(crate) const MISFIT: f64 = 1e-3;
/// Minimum number of squares in a group, and ratio of its ends in squared frequency: sixteen groups per decade.
const LEAST: f64 = 10.0;
const RATIO: f64 = 1.333_521;

/// The outcome of the test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Residual {
    pub(super) chi2: f64,
    pub(super) degrees_of_freedom: usize,
    pub(super) p_value: f64,
}

impl Residual {
    /// Tests the residuals in groups. A group of n squares over their expectation is χ² of n degrees; its cube root is
    /// nearly normal (E. B. Wilson and M. M. Hilferty, PNAS 17 (1931) 684), and the squares of these numbers are added.
    /// `None` if no degree of freedom is left.
    pub(super) fn of(likelihood: &Likelihood, model: &Model) -> Option<Self> {
        let groups = likelihood.groups(model, LEAST, RATIO);
        let chi2: f64 = groups
            .iter()
            .map(|(count, sum)| {
                let spread = 2.0 / (9.0 * count);
                ((sum / count).cbrt() - (1.0 - spread)).powi(2) / spread
            })
            .sum();
        let degrees_of_freedom = groups
            .len()
            .checked_sub(model.terms.parameters() + likelihood.shape().tilts())
            .filter(|degrees| *degrees > 0)?;
        let p_value = ChiSquared::new(degrees_of_freedom as f64).ok()?.sf(chi2);
        (chi2.is_finite() && p_value.is_finite()).then_some(Self { chi2, degrees_of_freedom, p_value })
    }

    /// Returns the factor on standard deviations: above 1 if the residuals are larger than expected (R. T. Birge,
    /// 1932).
    pub(super) fn widen(residual: Option<Self>) -> f64 {
        match residual {
            Some(residual) if residual.p_value < MISFIT => {
                (residual.chi2 / residual.degrees_of_freedom as f64).sqrt().max(1.0)
            }
            _ => 1.0,
        }
    }
}
