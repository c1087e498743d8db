//! The search: finds the effects in which a series and its model differ, one after the other, each at its price.

use super::course::Course;
use super::evidence::declared;
use super::evidence::{self, Candidate, Kind};
use super::explanation::Explanation;
use super::hidden;
use super::law::{Data, Priors, Shape};
use super::polish::{polish, scedasticity};
use super::prices::Prices;
use super::reordered::reordered;
use super::report::Sense;
use super::series::Series;
use super::taken_back::{
    drop_minor_steps, put_back, same_as_the_models, tails_and_bursts_again, take_back, weak_steps, weak_stretches,
    weak_tones,
};
use super::work::Parts;

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

/// The levels have no prior.
pub(super) const FREE: Priors = [None, None, None];
/// Nats that B and K of any size have to gain: the model's statement about them is rarely wrong by a large factor.
const ANY_LEVELS: f64 = 12.0;

/// Maximum number of named effects on a channel; no more are searched.
const EFFECTS_MAX: usize = 12;

/// What a turn of the search decides.
#[derive(serde::Serialize, serde::Deserialize)]
enum Turn {
    /// No further effect is worth its price.
    End,
    /// The prior on B and K is dropped.
    FreeLevels,
    /// This step is taken, with this explanation.
    Adopt(Step, Box<Explanation>),
}

/// Decides on the next step. The series stays as it is.
fn turn(series: &mut Series<'_>, prices: &Prices, steps: &[Step], refused: &[Kind]) -> Turn {
    let mut candidates = everything(series, prices);
    candidates.retain(|of| !refused.contains(&of.kind));
    let others = candidates.clone();
    let Some((step, chosen)) = best_of(candidates, prices, steps) else { return Turn::End };
    if levels_do(series, &step) {
        return Turn::FreeLevels;
    }
    let (step, chosen) = hidden::instead(series, prices, steps, &step, others).unwrap_or((step, chosen));
    Turn::Adopt(step, Box::new(chosen.explanation))
}

/// Explains a series as far as effects are worth their prices.
pub fn explain(series: &mut Series<'_>, prices: &Prices, work: &mut Parts<'_>) -> Vec<Step> {
    /// Steps may be taken back and found again. After this number of turns the search ends in its current state.
    const TURNS: usize = 3 * EFFECTS_MAX;
    let start = series.explanation.clone();
    let mut steps: Vec<Step> = Vec::new();
    // The peaks are classified once all else is known.
    let is_plain = start.spikes.is_none() && start.tails.is_none();
    let mut peaks = if is_plain { evidence::peaks::peaks(&series.rest) } else { Vec::new() };
    peaks.retain(|place| start.outliers.binary_search(place).is_err());
    if !peaks.is_empty() {
        series.explanation.leave_out(peaks.iter().copied());
        series.rebuild(true);
    }
    // An effect that was just taken back would be found again at once.
    let mut refused: Vec<Kind> = Vec::new();
    for _ in 0..TURNS {
        if steps.len() >= EFFECTS_MAX {
            break;
        }
        let (step, explanation) = match work.next(|| turn(series, prices, &steps, &refused)) {
            Turn::End => break,
            Turn::FreeLevels => {
                series.priors = FREE;
                series.rebuild(true);
                continue;
            }
            Turn::Adopt(step, explanation) => (step, explanation),
        };
        let kind = step.kind;
        refused.extend(taken(series, prices, &mut steps, &start, (step, *explanation)));
        if !kind.is_marginal() && kind != Kind::VarianceProfile {
            stretch_instead(series, prices, &mut steps, &start);
        }
        more_spikes(series);
    }
    other_filter(series, prices, &mut steps);
    one_slope(series, prices, &mut steps);
    reordered(series, prices, &mut steps);
    weak_steps(series, &mut steps, start.courses.len());
    take_back(series, prices, &mut steps);
    same_as_the_models(series, prices, &mut steps);
    put_back(series, prices, &mut steps);
    weak_tones(series, prices, &mut steps, start.sines.len());
    samples_again(series, prices, &mut steps, &start, &peaks);
    weak_steps(series, &mut steps, start.courses.len());
    believe_again(series);
    polish(series, &start);
    // Beside lines and bands in their final form.
    take_back(series, prices, &mut steps);
    weak_stretches(series, &mut steps, start.loud.len());
    tails_and_bursts_again(series, prices, &mut steps, &start);
    evidence::heavy_tails::fit_again(series);
    steps
}

/// Takes a step and adapts what was found before to it. Returns the step's kind if it did not last.
fn taken(
    series: &mut Series<'_>,
    prices: &Prices,
    steps: &mut Vec<Step>,
    start: &Explanation,
    (step, explanation): (Step, Explanation),
) -> Option<Kind> {
    let kind = step.kind;
    let before = (kind == Kind::BiasStep).then(|| series.clone());
    series.adopt(explanation);
    steps.push(step);
    match kind {
        Kind::Resonance => lean(series),
        Kind::Tone => {
            other_filter(series, prices, steps);
            more_tones(series, prices, steps);
        }
        Kind::BiasStep => {
            evidence::level::join_rises(&mut series.explanation, start.courses.len());
            leave_rises_out(series);
            drop_minor_steps(series, start.courses.len());
            weak_steps(series, steps, start.courses.len());
            if steps.iter().all(|step| step.kind != kind) {
                // With the samples about them.
                before.into_iter().for_each(|before| *series = before);
                return Some(kind);
            }
        }
        // Tails that were found before may belong to these stretches or to effects that they hid.
        Kind::Bursts if steps.iter().any(|step| step.kind == Kind::HeavyTails && step.of_model.is_none()) => {
            steps.retain(|step| step.kind != Kind::HeavyTails || step.of_model.is_some());
            series.explanation.tails = start.tails;
            series.rebuild(false);
            more_bursts(series, prices, steps);
        }
        Kind::Bursts => more_bursts(series, prices, steps),
        // A course of the variance outside this effect would look like tails.
        Kind::VarianceProfile | Kind::VariancePerDegree if start.scedasticity.is_none() => scedasticity(series),
        _ => {}
    }
    None
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

/// Returns candidates for effects that the model lacks, and for effects that it has with other numbers than the series.
fn everything(series: &mut Series<'_>, prices: &Prices) -> Vec<Candidate> {
    let mut found = evidence::all(series);
    doubt_filters(series, &mut found);
    found.retain(|of| !is_of_reading(series, of));
    if !series.setting().declared.is_empty() {
        let doubtful = found.iter().any(|of| of.gain > prices.of(of.kind));
        found.extend(declared::all(series, doubtful, |kind| prices.of(kind)));
    }
    found
}

/// Returns whether B and K that are far off explain as much as an effect.
fn levels_do(series: &Series<'_>, step: &Step) -> bool {
    /// Nats by which slow noise of another form has to be better.
    const CLEARLY: f64 = 3.0;
    /// Sessions differ by up to 30 times. From 100 times on there is further doubt: this is ln of 10⁴, the ratio in
    /// power.
    const FAR_LARGER: f64 = 9.2;
    if series.priors == FREE {
        return false;
    }
    let free = series.explanation.law.fit_from_several(Data { priors: &FREE, ..series.data() });
    let beyond = |(level, prior): (&f64, &Option<(f64, f64)>)| {
        prior.map_or(0.0, |(declared, _)| (level - declared - FAR_LARGER).max(0.0))
    };
    let doubt: f64 = free.law.levels.iter().zip(&series.priors).map(beyond).sum();
    let gain = free.log_likelihood - series.fitted.log_posterior - doubt;
    match step.kind {
        Kind::GaussMarkov => gain > step.gain - CLEARLY,
        _ => gain - ANY_LEVELS > step.gain - step.price,
    }
}

/// Resets B and K to the model's values if these fit about as well, because known effects may explain the difference.
fn believe_again(series: &mut Series<'_>) {
    if series.priors == series.setting().priors {
        return;
    }
    let mut believed = series.clone();
    believed.priors = series.setting().priors;
    believed.rebuild(true);
    if series.fitted.log_posterior - believed.fitted.log_posterior < ANY_LEVELS {
        *series = believed;
    }
}

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

/// Effects on single samples that were chosen early are chosen again. A spike behind a filter looks like a burst before
/// the filter is known, and stretches look like tails. The samples `peaks` were left out until now.
fn samples_again(
    series: &mut Series<'_>,
    prices: &Prices,
    steps: &mut Vec<Step>,
    start: &Explanation,
    peaks: &[usize],
) {
    let first = steps.iter().position(|step| step.kind.is_marginal());
    let is_hidden = first.is_some_and(|first| steps[first..].iter().any(|step| !step.kind.is_marginal()));
    if !is_hidden && peaks.is_empty() {
        return;
    }
    let before = steps.clone();
    restore_samples(series, steps, start, peaks);
    choose_samples(series, prices, steps);
    let is_named = |kind: Kind| steps.iter().any(|step| step.kind == kind && step.of_model.is_none());
    if peaks.is_empty() {
        return;
    }
    // Peaks like those among the other samples, or not worth their price, are examined together with all other samples.
    let is_of_rest = is_named(Kind::Spikes) || is_named(Kind::HeavyTails);
    match (!is_of_rest).then(|| evidence::outlier::spikes_at(series, peaks)).flatten() {
        Some(of) if of.gain > prices.of(Kind::Spikes) => {
            steps.push(step_of(&of, prices));
            series.explanation = of.explanation;
        }
        _ => {
            *steps = before;
            restore_samples(series, steps, start, &[]);
            choose_samples(series, prices, steps);
        }
    }
}

/// Takes back the effects on single samples except the model's, and leaves out some samples.
fn restore_samples(series: &mut Series<'_>, steps: &mut Vec<Step>, start: &Explanation, left_out: &[usize]) {
    steps.retain(|step| !step.kind.is_marginal());
    let (samples, bursts) = (series.len(), series.setting().bursts);
    let own = &mut series.explanation;
    (own.outliers, own.spikes, own.tails) = (start.outliers.clone(), start.spikes, start.tails);
    own.leave_out(left_out.iter().copied());
    own.retain_loud(start.loud.len(), |loud| loud.is_interval(samples, bursts));
    series.rebuild(false);
    leave_rises_out(series);
}

/// Names the effects on single samples.
fn choose_samples(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    for _ in 0..EFFECTS_MAX {
        let candidates = evidence::of_samples(series);
        let others = candidates.clone();
        let Some((step, chosen)) = best_of(candidates, prices, steps) else { break };
        let (step, chosen) = hidden::instead(series, prices, steps, &step, others).unwrap_or((step, chosen));
        series.adopt(chosen.explanation);
        let kind = step.kind;
        steps.push(step);
        match kind {
            Kind::Bursts => more_bursts(series, prices, steps),
            Kind::Spikes => more_spikes(series),
            _ => {}
        }
    }
}

/// Leaves out spikes beside the found ones.
fn more_spikes(series: &mut Series<'_>) {
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
fn more_bursts(series: &mut Series<'_>, prices: &Prices, steps: &mut [Step]) {
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

/// Tries filters of another kind or order in place of one that was chosen before all other effects were known, because
/// effects in front of a filter shape the spectrum too.
fn other_filter(series: &mut Series<'_>, prices: &Prices, steps: &mut [Step]) {
    let filters = [Kind::LowPass, Kind::MovingAverage];
    let last = steps.len().saturating_sub(1);
    // The last effect was chosen with all others known.
    let is_filter = |step: &Step| filters.contains(&step.kind) && step.has_term();
    let of_filters: Vec<usize> = (0..steps.len()).filter(|at| is_filter(&steps[*at])).collect();
    let [at] = of_filters[..] else { return };
    if at == last {
        if series.is_cut() {
            swapped_filter(series, prices, &mut steps[at]);
        }
        return;
    }
    let kept = series.clone();
    series.explanation.law.terms.retain(|term| !term.is_filter());
    series.rebuild(false);
    let both = [evidence::spectral::low_pass(series), evidence::spectral::moving_average(series)];
    let mut candidates: Vec<Candidate> = both.into_iter().flatten().collect();
    doubt_filters(series, &mut candidates);
    if let Some((step, place)) = choose(&candidates, prices)
        && let Some(best) = candidates.into_iter().nth(place)
    {
        series.adopt(best.explanation);
        let simpler = match (step.kind, steps[at].kind) {
            (Kind::MovingAverage, Kind::LowPass) => BOXCAR,
            (Kind::LowPass, Kind::MovingAverage) => -BOXCAR,
            _ => 0.0,
        };
        if series.fitted.log_posterior + simpler > kept.fitted.log_posterior {
            steps[at] = Step { of_model: steps[at].of_model, ..step };
            return;
        }
    }
    *series = kept;
}

/// Replaces several processes and filters that were named one after the other by one density that falls as a power, if
/// that density explains as much as all of them.
fn one_slope(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    /// Nats by which it has to be better.
    const CLEARLY: f64 = 3.0;
    let replaced = Kind::is_spectral;
    let (own, price) = steps
        .iter()
        .filter(|step| replaced(step.kind))
        .fold((0, 0.0), |(count, price), step| (count + 1, price + prices.of(step.kind)));
    if own < 2 || steps.iter().any(|step| step.of_model.is_some()) {
        return;
    }
    let kept = series.clone();
    let known = series.explanation.law.terms.len().saturating_sub(own);
    series.explanation.law.terms.truncate(known);
    series.rebuild(true);
    let without = series.fitted.log_posterior;
    let gain = kept.fitted.log_posterior - without;
    let slope = evidence::spectral::slope_believed(series);
    let better = |of: &Candidate| of.gain - prices.of(Kind::Slope) > gain - price + CLEARLY;
    let Some(slope) = slope.filter(better) else {
        *series = kept;
        return;
    };
    steps.retain(|step| !replaced(step.kind));
    steps.push(step_of(&slope, prices));
    series.adopt(slope.explanation);
}

/// Samples beyond a limit are drawn as if there were no filter until one is known, and that may make the filter look like the
/// other kind. Each kind is therefore compared with the other on samples that are drawn under its own law.
fn swapped_filter(series: &mut Series<'_>, prices: &Prices, step: &mut Step) {
    /// Nats by which the other kind has to be better.
    const CLEARLY: f64 = 3.0;
    let kept = series.clone();
    series.explanation.law.terms.retain(|term| !term.is_filter());
    let other = match step.kind {
        Kind::LowPass => evidence::spectral::moving_average(series),
        _ => evidence::spectral::low_pass(series),
    };
    let Some(other) = other else {
        *series = kept;
        return;
    };
    let kind = other.kind;
    series.adopt(other.explanation);
    let better = series.fitted.log_posterior - kept.fitted.log_posterior;
    if better - prices.of(kind) + prices.of(step.kind) > CLEARLY {
        (step.kind, step.gain, step.price) = (kind, step.gain + better, prices.of(kind));
    } else {
        *series = kept;
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

/// Replaces a smooth course of the variance by a stretch of another variance if the stretch explains more. Steps of the level
/// and lines that were not known when the course was found can hide where the stretch begins and ends.
fn stretch_instead(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>, start: &Explanation) {
    let is_own = |step: &Step, kind: Kind| step.kind == kind && step.of_model.is_none();
    let Some(at) = steps.iter().position(|step| is_own(step, Kind::VarianceProfile)) else { return };
    // Beside bursts that are known first, the course is measured as it is.
    if steps[..at].iter().any(|step| is_own(step, Kind::Bursts)) {
        return;
    }
    let mut bare = series.changed(|of| {
        of.scedasticity = None;
        of.tails = start.tails;
        of.retain_loud(start.loud.len(), |_| false);
    });
    let worth = |of: &Candidate| of.gain - prices.of(of.kind);
    let course = evidence::loudness::profile(&bare);
    let stretches = evidence::loudness::intervals(&bare);
    let stretch = stretches.into_iter().find(|of| of.kind == Kind::VarianceInterval);
    let least = course.as_ref().map_or(0.0, worth).max(0.0);
    let Some(stretch) = stretch.filter(|of| worth(of) > least) else { return };
    steps[at] = step_of(&stretch, prices);
    bare.adopt(stretch.explanation);
    *series = bare;
    steps.retain(|step| !is_own(step, Kind::HeavyTails) && !is_own(step, Kind::Bursts));
}

/// Returns the step that adds a candidate.
pub(super) fn step_of(of: &Candidate, prices: &Prices) -> Step {
    Step { kind: of.kind, gain: of.gain, price: prices.of(of.kind), others: Vec::new(), of_model: of.of_model }
}

/// Nats by which an effect that the model lacks has to exceed another reading of the model's own effects.
const NEWER: f64 = 4.0;

/// Returns the change to be made next, and the candidate that makes it. `None` if no change is worth its price.
fn choose(candidates: &[Candidate], prices: &Prices) -> Option<(Step, usize)> {
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
