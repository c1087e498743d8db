//! Steps: what a step of the search is, what is doubted about its candidates, and which of them is next.

use super::course::Course;
use super::evidence::{Candidate, Kind};
use super::explanation::Explanation;
use super::law::{FREE, Shape};
use super::prices::Prices;
use super::report::Sense;
use super::series::Series;

/// An effect that was added, or one of the model's that was changed.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Step {
    /// Its kind.
    pub kind: Kind,
    /// Nats gained.
    pub gain: f64,
    /// Nats that the effect had to gain.
    pub price: f64,
    /// The other effects that would have been worth their price, best first.
    pub others: Vec<(Kind, f64)>,
    /// The model's own effect that was changed, by its place in the list, and how; none for an effect that the model
    /// lacks.
    pub of_model: Option<(usize, Sense)>,
}

impl Step {
    /// Returns the chance that noise alone gains as much somewhere in a record, given that it gains the price with
    /// chance `level`.
    pub(super) fn chance(&self, level: f64) -> f64 {
        (level * (self.price - self.gain).exp()).min(1.0)
    }

    /// Returns whether the law has a term of this kind.
    pub(super) fn has_term(&self) -> bool {
        self.of_model.is_none_or(|(_, sense)| sense != Sense::Superfluous)
    }
}

/// Nats by which a filter with a cutoff has to exceed a boxcar.
pub(super) const BOXCAR: f64 = 6.0;

/// Pairs of a complex kind and a simple one; the complex kind has to be better by some nats.
const SIMPLER: [(Kind, Kind, f64); 18] = [
    (Kind::WarmUp, Kind::RateRamp, 4.0),
    (Kind::BiasStep, Kind::RateRamp, 2.0),
    (Kind::TemperatureBias, Kind::RateRamp, 0.0),
    (Kind::Resonance, Kind::Tone, 4.0),
    (Kind::Resonance, Kind::Intermittent, 4.0),
    (Kind::VarianceProfile, Kind::VariancePerDegree, 4.0),
    (Kind::VarianceProfile, Kind::VarianceInterval, 0.0),
    (Kind::HeavyTails, Kind::Spikes, 0.0),
    (Kind::LowPass, Kind::MovingAverage, BOXCAR),
    (Kind::GaussMarkov, Kind::RateRamp, 4.0),
    // A rarer effect has to be clearly better.
    (Kind::Slope, Kind::GaussMarkov, 3.0),
    (Kind::Slope, Kind::QuantizationNoise, 3.0),
    (Kind::Slope, Kind::LowPass, 3.0),
    (Kind::TemperatureCurve, Kind::WarmUp, 3.0),
    (Kind::TemperatureCurve, Kind::RateRamp, 3.0),
    (Kind::TemperatureCurve, Kind::TemperatureBias, 3.0),
    (Kind::TemperatureCurve, Kind::BiasStep, 3.0),
    (Kind::TemperatureCurve, Kind::GaussMarkov, 3.0),
];

/// Returns the step that adds a candidate.
pub(super) fn step_of(of: &Candidate, prices: &Prices) -> Step {
    Step { kind: of.kind, gain: of.gain, price: prices.of(of.kind), others: Vec::new(), of_model: of.of_model }
}

/// Nats of doubt about a filter that needs far more white noise in front of it than the model states. White noise of the model's
/// size and a process of short correlation look like the noise behind a filter and the noise that the filter passes.
pub(super) fn louder_before(series: &Series<'_>, with: &Explanation) -> f64 {
    /// ln of the ratio up to which a larger N² raises no doubt, and the power below which the model has no white noise.
    const AS_LARGE: f64 = 2.5;
    const NONE: f64 = -50.0;
    const MOST: f64 = 20.0;
    let declared = series.setting().white;
    if declared < NONE || series.setting().priors == FREE {
        return 0.0;
    }
    (2.0 * (with.law.levels[0] - declared - AS_LARGE)).clamp(0.0, MOST)
}

/// Returns whether a candidate is slow noise that is no larger than the part of a level following the temperature that
/// rounded readings do not show.
pub(super) fn is_of_reading(series: &Series<'_>, of: &Candidate) -> bool {
    /// Limit as a part of a step of the readings.
    const UNRESOLVED: f64 = 0.4;
    let follows = |(course, factor): &(Course, f64)| if *course == Course::Temperature { factor.abs() } else { 0.0 };
    let per_c = of.explanation.courses.iter().map(follows).fold(0.0, f64::max);
    let unresolved = UNRESOLVED * series.setting().courses.reading_c * per_c;
    let term = of.explanation.law.terms.last().filter(|term| term.shape == Shape::GaussMarkov);
    of.kind == Kind::GaussMarkov
        && of.of_model.is_none()
        && term.is_some_and(|term| (0.5 * term.numbers[0]).exp() < unresolved)
}

/// Subtracts the doubt from the gains of filters.
pub(super) fn doubt_filters(series: &Series<'_>, candidates: &mut [Candidate]) {
    for of in candidates.iter_mut().filter(|of| matches!(of.kind, Kind::LowPass | Kind::MovingAverage)) {
        of.gain -= louder_before(series, &of.explanation);
    }
}

/// Returns the candidate to be added next from those that were not named yet. `None` if no candidate is worth its
/// price.
pub(super) fn best_of(mut candidates: Vec<Candidate>, prices: &Prices, steps: &[Step]) -> Option<(Step, Candidate)> {
    // An effect is named once: several effects of a kind would be a failure to explain it.
    let curve = |kind: Kind| kind == Kind::TemperatureCurve;
    let apart = |step: &Step, of: &Candidate| curve(step.kind) != curve(of.kind);
    let is_new = |of: &Candidate| steps.iter().all(|step| step.kind.effect() != of.kind.effect() || apart(step, of));
    candidates.retain(|of| of.of_model.is_some() || of.kind.repeats() || is_new(of));
    let (step, place) = choose(&candidates, prices)?;
    Some((step, candidates.swap_remove(place)))
}

/// Nats by which an effect that the model lacks has to exceed another reading of the model's own effects.
const NEWER: f64 = 4.0;

/// Returns the change to be made next, and the candidate that makes it. `None` if no change is worth its price.
pub(super) fn choose(candidates: &[Candidate], prices: &Prices) -> Option<(Step, usize)> {
    let score = |at: usize| candidates[at].gain - prices.of(candidates[at].kind);
    let mut order: Vec<usize> = (0..candidates.len()).filter(|at| candidates[*at].gain.is_finite()).collect();
    order.sort_by(|a, b| score(*b).total_cmp(&score(*a)));
    let kind = |at: usize| candidates[at].kind;
    let mut best = *order.first().filter(|best| score(**best) > 0.0)?;
    // A change of variance with bursts looks like tails or like a course of the variance. Those gain at once as much as
    // the stretches gain one by one.
    let is_stretch = |at: &&usize| matches!(kind(**at), Kind::Bursts | Kind::VarianceInterval) && score(**at) > 0.0;
    let looks_like_stretches = |kind: Kind| matches!(kind, Kind::HeavyTails | Kind::VarianceProfile);
    let stretches = order.iter().filter(is_stretch);
    let (sum, greatest) = stretches.fold((0.0, None), |(sum, greatest), at| (sum + score(*at), greatest.or(Some(*at))));
    if let Some(stretch) =
        greatest.filter(|at| looks_like_stretches(kind(best)) && score(*at) < score(best) && sum > score(best))
    {
        best = stretch;
    }
    for (complex, simple, margin) in SIMPLER {
        if kind(best) == complex
            && let Some(other) = order.iter().find(|at| kind(**at) == simple && score(**at) > 0.0)
            && score(best) - score(*other) < margin
        {
            best = *other;
        }
    }
    if candidates[best].of_model.is_none()
        && let Some(own) = order.iter().find(|at| candidates[**at].of_model.is_some() && score(**at) > 0.0)
        && score(best) - score(*own) < NEWER
    {
        best = *own;
    }
    let others = order.iter().filter(|at| kind(**at) != kind(best) && score(**at) > 0.0);
    let others = others.map(|at| (kind(*at), score(*at))).collect();
    Some((Step { others, ..step_of(&candidates[best], prices) }, best))
}
