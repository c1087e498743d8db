//! The Whittle fit: noise parameters from the spectrum of a record's differences, as precise as the data allows.
//!
//! Samples enter a [`DstEstimator`] stretch by stretch. The outputs are [`DstSums`], which are added over segments and
//! captures. From these [`fit`] returns N, B, K, Q, R or a Gauss–Markov process with 95 % intervals, or limits for
//! parameters that the data does not support. The basis is the DST-I of the differences, in which white noise and
//! random walks are independent exactly. Their mean is not removed, since that would move the ends' white noise to the
//! lowest frequencies.
//!
//! # Validation
//! `examples/noise_monte_carlo.rs` with its table in docs/validation.md; `tests` has a small form.

mod bandwidth;
mod choice;
mod dst;
mod ends;
mod estimator;
mod likelihood;
mod residual;
mod shape;
mod statement;
mod sums;
#[cfg(test)]
mod tests;

pub(crate) use bandwidth::Filter;
pub use bandwidth::{Sampling, density_factor};
pub use dst::Transform;
pub use estimator::DstEstimator;
pub(crate) use shape::boxcar;
pub use shape::exponential_weight;
pub use sums::DstSums;

use super::fit::{
    Estimate, FitSummary, FittedCurve, Flag, GaussMarkov, NoiseParameters, Term, gauss_markov_variance, nothing,
};
use choice::Choice;
use imu_core::sample::Channel;
use likelihood::{Likelihood, SIGMA, place};
pub(crate) use residual::MISFIT;
use residual::Residual;
use shape::Shape;
use statement::{Profile, Statement};

/// Name of the method in JSON.
pub const METHOD: &str = "whittle-dst";
/// Minimum number of squares for a fit.
const LEAST: f64 = 48.0;

/// Fits the noise parameters of a channel; `rate_hz` is finite and above 0.
///
/// `excluded_bands_hz` are frequencies that are not noise, such as those of vibration lines; they, and 4 % beside them,
/// take no part. `sampling` states how the samples were made, if known; its filter is then part of the law. If the law
/// misfits, filters inside the band compete with it. The function never fails: a parameter that cannot be determined is
/// not identified, and a flag states why.
pub fn fit(
    sums: &DstSums,
    rate_hz: f64,
    channel: Channel,
    excluded_bands_hz: &[[f64; 2]],
    sampling: Option<&Sampling>,
) -> NoiseParameters {
    of_law(sums, rate_hz, channel, excluded_bands_hz, sampling, Search::Filters)
}

/// Fits as [`fit`] does, without a search for filters, for samples that contain more than noise, which a filter would
/// explain away.
pub fn fit_as_sampled(sums: &DstSums, rate_hz: f64, channel: Channel, sampling: Option<&Sampling>) -> NoiseParameters {
    of_law(sums, rate_hz, channel, &[], sampling, Search::Nothing)
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Search {
    Filters,
    Nothing,
}

fn of_law(
    sums: &DstSums,
    rate_hz: f64,
    channel: Channel,
    excluded_bands_hz: &[[f64; 2]],
    sampling: Option<&Sampling>,
    search: Search,
) -> NoiseParameters {
    if !(rate_hz.is_finite() && rate_hz > 0.0) {
        return nothing(channel, METHOD, Flag::whole("insufficient", "no sampling rate"));
    }
    let likelihood = bandwidth::basic(sums, rate_hz, excluded_bands_hz, sampling);
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
    let Some(choice) = choice::choose(&likelihood) else {
        return nothing(channel, METHOD, Flag::whole("misfit", "no noise model describes the spectrum"));
    };
    let compete = || bandwidth::compete(sums, rate_hz, excluded_bands_hz, likelihood.shape(), &choice);
    let better = (search == Search::Filters).then(compete).flatten();
    let (likelihood, choice, rivals) =
        better.map_or((likelihood, choice, Vec::new()), |law| (law.likelihood, law.choice, law.rivals));
    let mut parameters = of_choice(&likelihood, &choice, channel);
    for (likelihood, choice) in &rivals {
        let rival = Profile::new(likelihood, choice);
        for (term, own) in [(Term::N, &mut parameters.n), (Term::B, &mut parameters.b), (Term::K, &mut parameters.k)] {
            let high = match rival.statement(term) {
                Statement::Named(_, [low, high]) => {
                    own.ci95.iter_mut().for_each(|ends| ends[0] = ends[0].min(low));
                    Some(high)
                }
                Statement::Limited(limit) => limit,
            };
            let ends = own.ci95.iter_mut().map(|ends| &mut ends[1]).chain(&mut own.upper_limit95);
            ends.for_each(|end| *end = end.max(high.unwrap_or(*end)));
        }
    }
    parameters.bandwidth = bandwidth::statement(&likelihood, &choice, rate_hz, sampling);
    // A law in place of the known sampling contradicts it.
    let is_known = parameters.bandwidth.as_ref().is_none_or(|of| of.internal_rate_hz.is_some());
    let factor = sampling.filter(|_| is_known).and_then(|sampling| sampling.density_factor(rate_hz));
    parameters.n.internal = parameters.n.value.zip(factor).map(|(density, factor)| density / factor);
    parameters
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
            "white, flicker and random-walk noise, with or without a filter, do not describe the spectrum (χ² {:.0} at {} \
             degrees of freedom); intervals are widened by {:.1}",
            residual.chi2,
            residual.degrees_of_freedom,
            Residual::widen(choice.residual)
        );
        flags.push(Flag::whole("misfit", note));
    }
    let summary = FitSummary::of(
        METHOD,
        choice.residual.map(|of| (of.chi2, of.degrees_of_freedom, of.p_value)),
        Some(curve(likelihood, choice)),
    );
    NoiseParameters { gauss_markov, ..NoiseParameters::of(channel, estimate, summary, flags) }
}

/// Returns the chosen model's Allan deviation and its parts, from the averaging time on at which the filter is
/// described.
fn curve(likelihood: &Likelihood, choice: &Choice) -> FittedCurve {
    let (model, dt_s) = (&choice.model, likelihood.dt_s());
    let shape = likelihood.shape().moved(&model.tilt);
    let mut factors = FittedCurve::octaves(likelihood.longest_s(), dt_s);
    if let Shape::Smooth { up_to, .. } = shape {
        factors.retain(|m| *m as f64 * up_to >= 1.0);
    }
    let at = |m: usize| factors.iter().position(|own| *own == m);
    // For Shape::Open, all ratios are 1.
    let ratios = |gain: fn(shape::Gains) -> f64, spectrum: &dyn Fn(f64) -> f64| match shape {
        Shape::Open => vec![1.0; factors.len()],
        _ => bandwidth::variance_ratios(&shape, &factors, gain, spectrum),
    };
    let walk_like = |gains: shape::Gains| gains.walk;
    let parts = Term::ALL.into_iter().filter(|term| model.terms.has(*term)).map(|term| {
        let square = place(term).map_or(model.ramp * model.ramp, |at| model.squares[at]);
        let spectrum = move |u: f64| term.spectrum(u, dt_s);
        let ratio = match term {
            Term::N | Term::Q => ratios(|gains| gains.white, &spectrum),
            Term::B => ratios(|gains| gains.flicker, &spectrum),
            Term::K => ratios(walk_like, &spectrum),
            Term::R => vec![1.0; factors.len()],
        };
        // The part of the plateau behind the filter is unchanged.
        let behind = if term == Term::N { model.squares[likelihood::BEHIND] } else { 0.0 };
        let variance = move |m: usize| {
            let ratio = at(m).and_then(|at| ratio.get(at).copied()).unwrap_or(1.0);
            (square * ratio + behind * (1.0 - ratio)) * term.allan_variance(m, dt_s)
        };
        (term.letter(), Box::new(variance) as Box<dyn Fn(usize) -> f64 + '_>)
    });
    let process = model.terms.has_gauss_markov().then(|| {
        let (square, decay) = (model.squares[SIGMA], dt_s / model.tc_s);
        let spectrum = move |u: f64| {
            let (phi, s) = ((-decay).exp(), 4.0 * (std::f64::consts::PI * u).sin().powi(2));
            (1.0 - phi * phi) / ((1.0 - phi).powi(2) + phi * s)
        };
        let ratio = ratios(walk_like, &spectrum);
        let variance = move |m: usize| {
            let ratio = at(m).and_then(|at| ratio.get(at).copied()).unwrap_or(1.0);
            square * ratio * gauss_markov_variance(m, decay)
        };
        ("gauss_markov", Box::new(variance) as Box<dyn Fn(usize) -> f64 + '_>)
    });
    FittedCurve::at(factors.clone(), dt_s, parts.chain(process))
}
