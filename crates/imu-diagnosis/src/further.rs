//! Further: what follows a step of the search at once: the lean of bands, the rises of steps, and more tones, spikes and bursts.

use super::evidence::{self, Kind};
use super::law::Shape;
use super::prices::Prices;
use super::series::Series;
use super::steps::{Step, step_of};

/// Gives narrow bands an asymmetry if it is worth its price: the part far from a strong line would look like a filter or like
/// further noise.
pub(super) fn lean(series: &mut Series<'_>) {
    for at in 0..series.explanation.law.terms.len() {
        let term = &series.explanation.law.terms[at];
        if term.shape != Shape::Resonance || term.numbers.len() != Shape::SYMMETRIC {
            continue;
        }
        let mut law = series.explanation.law.clone();
        law.terms[at].numbers.push(0.0);
        let fitted = law.fit(series.data());
        if fitted.log_posterior > series.fitted.log_posterior + Shape::LEANING {
            series.explanation.law = fitted.law;
            series.rebuild(false);
        }
    }
}

/// Leaves out the course of steps during their rise, which is not another effect. The largest of several large steps
/// hide the others' until they are left out.
pub(super) fn leave_rises_out(series: &mut Series<'_>) {
    const ROUNDS: usize = 6;
    for _ in 0..ROUNDS {
        let rises = evidence::level::rises(series);
        if rises.is_empty() {
            return;
        }
        series.explanation.leave_out(rises);
        series.rebuild(false);
    }
}

/// Adds the other tones that are clearly worth their price. A tone that hardly exceeds its surroundings is left to the
/// comparison with noise of their spectrum.
pub(super) fn more_tones(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    const MOST: usize = 24;
    /// Nats beyond the price: an effect that is hardly worth its price is compared with the other effects again.
    const CLEAR: f64 = 10.0;
    for _ in 0..MOST {
        let Some(tone) = evidence::line::tone(series) else { break };
        let price = prices.of(Kind::Tone);
        let found = tone.explanation.sines.last().map(|sine| sine.cycles);
        let Some(cycles) = found.filter(|_| tone.gain > price + CLEAR) else { break };
        if tone.gain / evidence::line::surroundings(series, cycles) < price + CLEAR {
            break;
        }
        steps.push(step_of(&tone, prices));
        series.adopt(tone.explanation);
    }
}

/// Leaves out spikes beside the found ones.
pub(super) fn more_spikes(series: &mut Series<'_>) {
    const ROUNDS: usize = 4;
    for _ in 0..ROUNDS {
        let places = evidence::outlier::further_spikes(series);
        if places.is_empty() {
            return;
        }
        let (reach, samples) = (series.reach().max(1), series.len());
        if let Some(law) = &mut series.explanation.spikes {
            law.rate += places.len() as f64 / samples as f64;
        }
        series.explanation.leave_out(places.into_iter().flat_map(|at| at..(at + reach).min(samples)));
        series.rebuild(false);
    }
}

/// Adds stretches to the found ones: beside the loudest, the others do not show.
pub(super) fn more_bursts(series: &mut Series<'_>, prices: &Prices, steps: &mut [Step]) {
    const ROUNDS: usize = 3;
    /// Nats beyond the price.
    const CLEAR: f64 = 10.0;
    let Some(step) = steps.last_mut().filter(|step| step.of_model.is_none()) else { return };
    for _ in 0..ROUNDS {
        let more = evidence::loudness::intervals(series).into_iter().find(|of| of.kind == Kind::Bursts);
        let Some(more) = more.filter(|of| of.gain > prices.of(Kind::Bursts) + CLEAR) else { return };
        step.gain += more.gain;
        series.adopt(more.explanation);
    }
}
