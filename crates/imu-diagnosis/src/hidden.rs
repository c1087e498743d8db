//! Hidden effects: effects that look like others as long as they are not known.

use super::course::Course;
use super::evidence::Kind::{
    self, BiasStep, Bursts, HeavyTails, Intermittent, LowPass, MovingAverage, Resonance, Spikes, Tone,
    VarianceInterval, VariancePerDegree, VarianceProfile,
};
use super::evidence::{self, Candidate};
use super::further::{leave_rises_out, more_tones};
use super::prices::Prices;
use super::series::Series;
use super::steps::{Step, step_of};

/// Effects that may look like other effects as long as they are not known, with the kinds that they may look like. A
/// large step makes a few samples of the residual loud and the rest quiet in comparison. Strong lines do that to parts
/// of the spectrum, as filters do. A few values that are far out look like tails, or behind a filter like bursts. Loud
/// stretches look like tails. A line or a band that comes and goes looks like all of these.
const HIDDEN: [(Kind, &[Kind]); 7] = [
    (BiasStep, &[Spikes, HeavyTails, Bursts, VarianceInterval, VarianceProfile, VariancePerDegree]),
    (Tone, &[LowPass, MovingAverage]),
    (Intermittent, &[LowPass, MovingAverage, HeavyTails, Bursts, VarianceInterval, VarianceProfile]),
    (Spikes, &[Bursts]),
    (VarianceInterval, &[HeavyTails]),
    (Bursts, &[HeavyTails]),
    (Resonance, &[HeavyTails, Bursts, VarianceInterval, VarianceProfile]),
];

/// Returns the effect that takes precedence over the one that would be chosen because it removes that effect's gain.
/// `all` holds the other candidates.
pub(super) fn instead(
    series: &Series<'_>,
    prices: &Prices,
    steps: &[Step],
    step: &Step,
    all: Vec<Candidate>,
) -> Option<(Step, Candidate)> {
    /// An effect that exceeds its price by this many nats is examined.
    const LARGE: f64 = 50.0;
    /// An effect takes away another's gain if at most this part of that gain remains.
    const LEFT: f64 = 0.5;
    if step.of_model.is_some() {
        return None;
    }
    let may_be = |of: &Candidate| {
        let hides = HIDDEN.iter().any(|(kind, looks)| *kind == of.kind && looks.contains(&step.kind));
        let is_known = steps.iter().any(|step| step.kind == of.kind && !of.kind.repeats());
        of.of_model.is_none() && hides && !is_known && of.gain > prices.of(of.kind) + LARGE
    };
    all.into_iter().filter(may_be).find_map(|of| {
        let own = step_of(&of, prices);
        // Blocks of the record show such a sine under any law.
        if of.kind == Intermittent {
            return Some((own, of));
        }
        if of.kind == BiasStep && !lasts(series, &of) {
            return None;
        }
        let mut beside = series.clone();
        beside.explanation = of.explanation.clone();
        // Tails are searched only if no spikes are named; the samples stay left out.
        beside.explanation.spikes = series.explanation.spikes;
        beside.rebuild(false);
        match of.kind {
            BiasStep => leave_rises_out(&mut beside),
            Tone => more_tones(&mut beside, prices, &mut Vec::new()),
            _ => {}
        }
        if of.kind == Tone && !is_loud(&beside, series.explanation.sines.len()) {
            return None;
        }
        (gain_of(step.kind, &beside) < LEFT * step.gain).then_some((own, of))
    })
}

/// Returns whether the sines other than the first `known` ones are a good part of a series.
fn is_loud(series: &Series<'_>, known: usize) -> bool {
    const PART: f64 = 0.2;
    let lines: f64 = series.explanation.sines[known..].iter().map(|sine| 0.5 * sine.amplitude().powi(2)).sum();
    let rest = series.rest.iter().map(|x| x * x).sum::<f64>() / series.len() as f64;
    lines > PART * (lines + rest)
}

/// Returns whether one of the steps that a candidate adds moves the level permanently.
fn lasts(series: &Series<'_>, of: &Candidate) -> bool {
    let known = series.explanation.courses.len();
    let mut joined = of.explanation.clone();
    evidence::level::join_rises(&mut joined, known);
    joined.courses[known..].iter().any(|(course, size)| match course {
        Course::Step(at) => evidence::leaps::is_lasting(&series.rest, *at, *size),
        _ => false,
    })
}

/// Returns the gain of a filter, or of an effect on single samples and their variance.
fn gain_of(kind: Kind, series: &Series<'_>) -> f64 {
    let found: Vec<Candidate> = match kind {
        LowPass => evidence::spectral::low_pass(series).into_iter().collect(),
        MovingAverage => evidence::spectral::moving_average(series).into_iter().collect(),
        _ => evidence::of_squares(series),
    };
    found.into_iter().filter(|of| of.kind == kind).map(|of| of.gain).fold(0.0, f64::max)
}
