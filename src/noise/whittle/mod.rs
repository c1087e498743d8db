//! The Whittle fit: noise parameters from the spectrum of a record's differences, as precise as the data allows.
//!
//! Samples enter a [`DstEstimator`] stretch by stretch; what leaves are [`DstSums`], which add over segments and captures, and
//! from these [`fit`] answers N, B, K, Q, R or a Gauss–Markov process with 95 % intervals, or limits for what the data does
//! not support. The basis is the DST-I of the differences, in which white noise and random walks are independent exactly;
//! their mean is not taken out, since that would move the ends' white noise to the lowest frequencies.
//!
//! # Validation
//! `examples/noise_monte_carlo.rs` with its table in docs/validation.md; `tests` has a small form of it.

mod choice;
mod dst;
mod estimator;
mod likelihood;
mod residual;
mod statement;
mod sums;
#[cfg(test)]
mod tests;

pub use dst::Transform;
pub use estimator::DstEstimator;
pub use sums::DstSums;

use super::fit::{
    Estimate, FitSummary, FittedCurve, Flag, GaussMarkov, NoiseParameters, Term, gauss_markov_variance, nothing,
};
use crate::sample::Channel;
use choice::Choice;
use likelihood::{Likelihood, SIGMA, place};
use residual::{MISFIT, Residual};
use statement::{Profile, Statement};

/// Name of the method in JSON.
pub const METHOD: &str = "whittle-dst";
/// Squares below which nothing is fitted.
const LEAST: f64 = 48.0;

/// Fits the noise parameters of a channel; `rate_hz` finite and above 0.
///
/// `excluded_bands_hz`: frequencies that are no noise, such as those of vibration lines; they, and 4 % beside them, take no
/// part. Never fails: what cannot be told is not identified, and a flag says why.
#[must_use]
pub fn fit(sums: &DstSums, rate_hz: f64, channel: Channel, excluded_bands_hz: &[[f64; 2]]) -> NoiseParameters {
    if !(rate_hz.is_finite() && rate_hz > 0.0) {
        return nothing(channel, METHOD, Flag::whole("insufficient", "no sampling rate"));
    }
    let likelihood = Likelihood::new(sums, rate_hz, excluded_bands_hz);
    let (count, varies) = likelihood.extent();
    if count < LEAST {
        let all: f64 = sums.filled().map(|(_, bin)| bin.count).sum();
        let note = if all < LEAST {
            "fewer than 50 samples without a gap: record more".to_owned()
        } else {
            format!(
                "the frequencies left out, which are no noise, leave {count:.0} of {all:.0} coefficients of the spectrum: \
                 record where there is less vibration, or more"
            )
        };
        return nothing(channel, METHOD, Flag::whole("insufficient", note));
    }
    if !varies {
        let note = "every sample has the same value: no noise to be seen";
        return nothing(channel, METHOD, Flag::whole("constant", note));
    }
    match choice::choose(&likelihood) {
        Some(choice) => of_choice(&likelihood, &choice, channel),
        None => nothing(channel, METHOD, Flag::whole("misfit", "no noise model describes the spectrum")),
    }
}

fn of_choice(likelihood: &Likelihood, choice: &Choice, channel: Channel) -> NoiseParameters {
    let profile = Profile::new(likelihood, choice);
    let estimate = |term| match profile.statement(term) {
        Statement::Named(value, ci95) => Estimate::identified(channel, term, value, ci95),
        Statement::Limited(limit) => Estimate::unidentified(channel, term, limit),
    };
    let gauss_markov = profile.gauss_markov().map(|[(sigma, sigma_95), (tc_s, tc_95)]| GaussMarkov {
        sigma: Estimate::of(channel.unit(), sigma, sigma_95),
        tc_s: Estimate::of("s", tc_s, tc_95),
    });
    let mut flags = Vec::new();
    if let Some(residual) = choice.residual.filter(|residual| residual.p_value < MISFIT) {
        let note = format!(
            "white, flicker and random-walk noise do not describe the spectrum (χ² {:.0} at {} degrees of freedom): \
             lines, knocks or drift; intervals are widened by {:.1}",
            residual.chi2,
            residual.degrees_of_freedom,
            Residual::widen(choice.residual)
        );
        flags.push(Flag::whole("misfit", note));
    }
    NoiseParameters {
        unit: channel.unit().to_owned(),
        n: estimate(Term::N),
        b: estimate(Term::B),
        k: estimate(Term::K),
        q: estimate(Term::Q),
        r: estimate(Term::R),
        gauss_markov,
        fit: FitSummary {
            method: METHOD.to_owned(),
            chi2: choice.residual.map(|residual| residual.chi2),
            degrees_of_freedom: choice.residual.map(|residual| residual.degrees_of_freedom),
            p_value: choice.residual.map(|residual| residual.p_value),
            curve: Some(curve(likelihood, choice)),
        },
        flags,
    }
}

/// The chosen model's Allan deviation and its parts.
fn curve(likelihood: &Likelihood, choice: &Choice) -> FittedCurve {
    let (model, dt_s) = (&choice.model, likelihood.dt_s());
    let parts = Term::ALL.into_iter().filter(|term| model.terms.has(*term)).map(|term| {
        let square = place(term).map_or(model.ramp * model.ramp, |at| model.squares[at]);
        (term.letter(), Box::new(move |m| square * term.allan_variance(m, dt_s)) as Box<dyn Fn(usize) -> f64>)
    });
    let process = model.terms.has_gauss_markov().then(|| {
        let (square, tc_s) = (model.squares[SIGMA], model.tc_s);
        let variance = move |m: usize| square * gauss_markov_variance(m as f64 * dt_s, tc_s);
        ("gauss_markov", Box::new(variance) as Box<dyn Fn(usize) -> f64>)
    });
    FittedCurve::of(likelihood.longest_s(), dt_s, parts.chain(process))
}
