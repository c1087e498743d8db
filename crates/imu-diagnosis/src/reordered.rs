//! Reordered: finds the terms of a spectrum again in other orders, once all effects in time are known.
//!
//! The search adds one term after the other. A term that was found first can stand for two others: a resonance for the edge
//! of a filter, a process for the skirt of a band. Neither alone is then worth its price. Here the search of terms begins
//! again with each kind of filter, and the best end of all is kept that has no more terms.

use super::evidence::{self, Candidate, Kind};
use super::explanation::Explanation;
use super::further::lean;
use super::law::{Data, FREE, Shape};
use super::prices::Prices;
use super::series::Series;
use super::steps::{BOXCAR, Step, best_of, doubt_filters, is_of_reading, louder_before, step_of};
use super::taken_back::take_back;

/// Nats by which another order has to end better.
const CLEARLY: f64 = 4.0;

/// Finds the own terms of the law again, and keeps them if they explain more for their prices, both with the believed B and K and
/// with any. The model's own effects have to be as it states them.
pub(super) fn reordered(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    let own = steps.iter().filter(|step| step.kind.is_spectral()).count();
    if own < 2 || steps.iter().any(|step| step.of_model.is_some()) {
        return;
    }
    let known = series.explanation.law.terms.len().saturating_sub(own);
    let bare = series.changed(|of| of.law.terms.truncate(known));
    let mut least = worth(series, prices, steps).map(|worth| worth + CLEARLY);
    let mut best: Option<(Explanation, Vec<Step>)> = None;
    for first in evidence::filters(&bare) {
        if first.gain - louder_before(&bare, &first.explanation) <= prices.of(first.kind) {
            continue;
        }
        let (found, named) = continued(&bare, first, prices, own);
        let worth = worth(&found, prices, &named);
        if worth.iter().zip(&least).all(|(worth, least)| worth > least) {
            least = worth;
            best = Some((found.explanation, named));
        }
    }
    if let Some((explanation, named)) = best {
        series.adopt(explanation);
        steps.retain(|step| !step.kind.is_spectral());
        steps.extend(named);
    }
}

/// Returns the log posterior less the prices of the terms, with the believed levels and with free ones.
fn worth(series: &Series<'_>, prices: &Prices, steps: &[Step]) -> [f64; 2] {
    let own = steps.iter().filter(|step| step.kind.is_spectral());
    let price: f64 = own.map(|step| prices.of(step.kind)).sum();
    let terms = &series.explanation.law.terms;
    let mut doubt = 0.0;
    if terms.iter().any(|term| term.is_filter()) {
        doubt += louder_before(series, &series.explanation);
    }
    if terms.iter().any(|term| matches!(term.shape, Shape::LowPass(_))) {
        doubt += BOXCAR;
    }
    let free = series.explanation.law.fit(Data { priors: &FREE, ..series.data() });
    [series.fitted.log_posterior, free.log_posterior].map(|posterior| posterior - price - doubt)
}

/// Continues the search of terms from a first one to at most `most`.
fn continued<'a>(bare: &Series<'a>, first: Candidate, prices: &Prices, most: usize) -> (Series<'a>, Vec<Step>) {
    let (mut series, mut steps) = (bare.clone(), Vec::new());
    let mut next = Some((step_of(&first, prices), first));
    while let Some((step, chosen)) = next {
        let kind = step.kind;
        steps.push(step);
        series.adopt(chosen.explanation);
        if kind == Kind::Resonance {
            lean(&mut series);
        }
        if steps.len() >= most {
            break;
        }
        let mut candidates = evidence::of_spectrum(&series);
        doubt_filters(&series, &mut candidates);
        candidates.retain(|of| !is_of_reading(&series, of));
        next = best_of(candidates, prices, &steps);
    }
    take_back(&mut series, prices, &mut steps);
    (series, steps)
}
