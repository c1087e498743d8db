//! The choice of a model: the terms that the spectrum requires.

use super::likelihood::{Held, Likelihood, Model, Terms, place};
use super::residual::{MISFIT, Residual};
use crate::fit::Term;

/// The gain that a term needs in 2 log L: 1 % of a 50:50 mixture of χ²₀ and χ²₁ for a term at its boundary of 0.
pub(super) const SIGNIFICANT: f64 = 5.41;
/// The gain that a walk needs: 5.41 names a walk in about 1.2 % of records without one, because a few low frequencies
/// are not a large sample. A walk that is barely present is estimated at twice its size (scenario D of the Monte
/// Carlo); 6.5 keeps that under a tenth of such records.
pub(super) const SIGNIFICANT_WALK: f64 = 6.5;
/// The gain that the correlation time of a Gauss–Markov process needs, whose inverse is 0 for a random walk: a value
/// between 5.41, which names a process in 2.2 % of the records of a walk (scenario B), and 9.55, which names an actual
/// process (scenario C) in only 80 %.
pub(super) const PLAIN_TIME: f64 = 7.0;
/// Other explanations of low frequencies need more evidence (0.1 %; 0.2 % for two signs): a ramp, and flicker or a walk
/// beside a Gauss–Markov process. At 1 % one of them took the place of a true random walk too often.
pub(super) const PLAIN: f64 = 9.55;
/// Quantization noise, which few sensors show, is only separated from N by the highest frequencies; if it is real, it
/// is evident there (5e-5). If it were named by chance, it would take its variance from N, whose error is small.
pub(super) const PLAIN_QUANTIZATION: f64 = 15.1;
/// A process of fewer samples is caused by a filter: white noise behind a first-order low pass has the same spectrum.
pub(super) const SHORTEST_PROCESS: f64 = 8.0;
/// Number of correlation times per decade that are tried before the best one is refined.
const PER_DECADE: f64 = 6.0;

/// The model that the data supports.
#[derive(Debug, Clone)]
pub(super) struct Choice {
    pub(super) model: Model,
    /// The model from which values are taken. If B is named and K is not, K is free: otherwise a weak K would count as
    /// B (at most 5 % of it, but more than B's own error). K's value is the best one without an unnamed B, with which
    /// K's error would be a third larger. If B is only just named, K lies between both readings; intervals allow for
    /// both.
    pub(super) values: Model,
    pub(super) residual: Option<Residual>,
}

/// Returns the price of naming `term` in a model of `terms`, both for choosing it and for later statements about it.
pub(super) fn price(term: Term, terms: Terms) -> f64 {
    match term {
        Term::B | Term::K if terms.has_gauss_markov() => PLAIN,
        Term::N | Term::B => SIGNIFICANT,
        Term::K => SIGNIFICANT_WALK,
        Term::Q => PLAIN_QUANTIZATION,
        Term::R => PLAIN,
    }
}

/// Returns −2 log L with every term's price.
fn score(model: &Model) -> f64 {
    let terms: f64 =
        Term::ALL.into_iter().filter(|term| model.terms.has(*term)).map(|term| price(term, model.terms)).sum();
    // σ and the correlation time.
    let process = if model.terms.has_gauss_markov() { SIGNIFICANT + PLAIN_TIME } else { 0.0 };
    model.deviance + terms + process
}

fn better(best: Option<Model>, other: Option<Model>) -> Option<Model> {
    match (best, other) {
        (Some(best), Some(other)) => Some(if score(&other) < score(&best) { other } else { best }),
        (best, other) => best.or(other),
    }
}

/// Chooses among N, B and K, with which every sensor begins. Then tests whether a ramp, a Gauss–Markov process in place
/// of one or both of B and K, or quantization noise is worth its price. These are used only if the data is then
/// described, so that they do not represent vibration and knocks. `None` if no model fits.
pub(super) fn choose(likelihood: &Likelihood) -> Option<Choice> {
    let bases = [&[][..], &[Term::B], &[Term::K], &[Term::B, Term::K]];
    let models: Vec<Option<Model>> = bases
        .iter()
        .map(|letters| letters.iter().fold(likelihood.least_terms(), |terms, term| terms.with(*term)))
        .map(|terms| likelihood.maximise(terms, 1.0, Held::Nothing, None))
        .collect();
    let plain = models.iter().copied().fold(None, better);
    let with_ramp = |model: &Option<Model>| {
        let terms = model.as_ref()?.terms.with(Term::R);
        likelihood.maximise(terms, 1.0, Held::Nothing, model.as_ref())
    };
    // A walk's lowest frequencies look like a ramp's, so that a ramp has to be worth its price beside a possible walk.
    let mut best = plain;
    let widest = models.last().copied().flatten();
    let ramp = with_ramp(&widest).zip(widest).is_some_and(|(with, without)| score(&with) < score(&without));
    if ramp {
        best = models.iter().map(with_ramp).fold(best, better);
    }
    let red = |model: &Model| [Term::B, Term::K, Term::R].iter().any(|term| model.terms.has(*term));
    if best.as_ref().is_some_and(red) {
        let ramped = best.as_ref().is_some_and(|best| best.terms.ramp);
        for ramp in [false, true].into_iter().take(1 + usize::from(ramped)) {
            best = better(best, with_gauss_markov(likelihood, ramp));
        }
    }
    if let Some(found) = best {
        let terms = found.terms.with(Term::Q);
        best = better(best, likelihood.maximise(terms, found.tc_s, Held::Nothing, Some(&found)));
    }
    let judged = |model: Model| {
        let free = model.terms.has(Term::B) && !model.terms.has_gauss_markov();
        let terms = if free { model.terms.with(Term::K) } else { model.terms };
        let mut values = likelihood.maximise(terms, model.tc_s, Held::Nothing, Some(&model)).unwrap_or(model);
        average_walk(likelihood, &mut values);
        Choice { residual: Residual::of(likelihood, &model), values, model }
    };
    let (best, plain) = (judged(best?), judged(plain?));
    let extended = best.model.terms != plain.model.terms;
    let described = best.residual.is_none_or(|residual| residual.p_value >= MISFIT);
    Some(if extended && !described { plain } else { best })
}

/// Sets K in a model with flicker and a walk between its value beside that flicker and its value without flicker,
/// weighted by their likelihoods at flicker's price. Otherwise, flicker that was named by chance would reduce K.
fn average_walk(likelihood: &Likelihood, values: &mut Model) {
    let Some(walk) = place(Term::K) else { return };
    if !values.terms.has(Term::B) || !values.terms.has(Term::K) || values.terms.has_gauss_markov() {
        return;
    }
    let terms = values.terms.without(Term::B);
    let Some(without) = likelihood.maximise(terms, values.tc_s, Held::Nothing, Some(values)) else { return };
    let share = 1.0 / (1.0 + (0.5 * (price(Term::B, values.terms) - (without.deviance - values.deviance))).exp());
    let k = share * values.squares[walk].sqrt() + (1.0 - share) * without.squares[walk].sqrt();
    values.squares[walk] = k * k;
}

/// Returns the shortest correlation time of a process: behind a fitted filter, ten times the filter's own, which is
/// 1/2πf at its half-power frequency f. A shorter one and the filter would share the white noise between them in any
/// proportion.
fn shortest_process_s(likelihood: &Likelihood) -> f64 {
    const FILTERS: f64 = 10.0;
    let shape = likelihood.shape();
    let half = (1..=500).map(|at| f64::from(at) / 1000.0).find(|u| shape.gains(*u).white < 0.5);
    let own = half.filter(|_| shape.tilts() > 0).map_or(0.0, |u| FILTERS / (std::f64::consts::TAU * u));
    SHORTEST_PROCESS.max(own) * likelihood.dt_s()
}

/// Returns the best model with a Gauss–Markov process.
fn with_gauss_markov(likelihood: &Likelihood, ramp: bool) -> Option<Model> {
    let (least, most) = (shortest_process_s(likelihood), likelihood.longest_s());
    let steps = ((most / least).log10() * PER_DECADE).ceil();
    if steps.is_nan() || steps < 1.0 {
        return None;
    }
    let mut best = None;
    for letters in [&[][..], &[Term::B], &[Term::K]] {
        let mut terms =
            letters.iter().fold(likelihood.least_terms(), |terms, term| terms.with(*term)).with_gauss_markov();
        terms.ramp = ramp;
        let mut start: Option<Model> = None;
        let mut found: Option<Model> = None;
        for step in 0..=steps as u32 {
            let tc_s = least * (most / least).powf(f64::from(step) / steps);
            start = likelihood.maximise(terms, tc_s, Held::Nothing, start.as_ref()).or(start);
            found = better(found, start);
        }
        let found = found.and_then(|found| correlation_time(likelihood, Held::Nothing, &found));
        best = better(best, found);
    }
    best
}

/// Maximises over the correlation time as well, starting at that of `start`.
///
/// Uses parabolas through three points, because the deviance is nearly parabolic in log Tc; as precise as roots of
/// deviances need.
pub(super) fn correlation_time(likelihood: &Likelihood, held: Held, start: &Model) -> Option<Model> {
    const STEP: f64 = 0.25;
    const MOVES: usize = 40;
    let (least, most) = (shortest_process_s(likelihood).ln(), (100.0 * likelihood.longest_s()).ln());
    let at =
        |log_tc: f64, near: &Model| likelihood.maximise(start.terms, log_tc.clamp(least, most).exp(), held, Some(near));
    let mut centre = at(start.tc_s.ln(), start)?;
    let mut step = STEP;
    for _ in 0..MOVES {
        let middle = centre.tc_s.ln();
        let (left, right) = (at(middle - step, &centre)?, at(middle + step, &centre)?);
        let (down, up) = (left.deviance - centre.deviance, right.deviance - centre.deviance);
        if down < 0.0 || up < 0.0 {
            centre = if down < up { left } else { right };
            if !(least + step..most - step).contains(&centre.tc_s.ln()) {
                return Some(centre);
            }
            continue;
        }
        let curvature = down + up;
        if curvature > 0.0 {
            let found = at(middle + 0.5 * step * (down - up) / curvature, &centre)?;
            if found.deviance < centre.deviance {
                centre = found;
            }
        }
        // The error of a parabola falls with the cube of its width.
        if step < 0.02 || curvature < 1e-6 {
            break;
        }
        step *= 0.2;
    }
    Some(centre)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(terms: Terms) -> Model {
        Model { terms, squares: [1.0; 6], tc_s: 1.0, ramp: 1.0, tilt: [0.0; 6], deviance: 0.0 }
    }

    /// Choice and statements charge the same price for a term, also beside a process.
    #[test]
    fn a_term_has_one_price_for_choice_and_statement() {
        let white = Terms::of(&[Term::N]);
        for terms in [white, white.with(Term::B), white.with_gauss_markov(), white.with(Term::K).with_gauss_markov()] {
            for term in [Term::B, Term::K, Term::Q, Term::R] {
                let (with, without) = (terms.with(term), terms.without(term));
                let charged = score(&model(with)) - score(&model(without));
                assert!((charged - price(term, with)).abs() < 1e-12, "{term:?} in {with:?}: {charged}");
            }
            let process = score(&model(white.with_gauss_markov())) - score(&model(white));
            assert!((process - SIGNIFICANT - PLAIN_TIME).abs() < 1e-12, "{process}");
        }
        let beside = white.with_gauss_markov();
        assert_eq!(
            [Term::N, Term::B, Term::K, Term::Q, Term::R].map(|term| price(term, white)),
            [5.41, 5.41, 6.5, 15.1, 9.55]
        );
        assert_eq!(
            [Term::N, Term::B, Term::K, Term::Q, Term::R].map(|term| price(term, beside)),
            [5.41, 9.55, 9.55, 15.1, 9.55]
        );
    }
}
