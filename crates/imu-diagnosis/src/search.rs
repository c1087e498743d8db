//! The search: finds the effects in which a series and its model differ, one after the other, each at its price.

use super::evidence::declared;
use super::evidence::{self, Candidate, Kind};
use super::explanation::Explanation;
use super::further::{lean, leave_rises_out, more_bursts, more_spikes, more_tones};
use super::hidden;
use super::law::{Data, FREE};
use super::polish::{polish, scedasticity};
use super::prices::Prices;
use super::reordered::reordered;
use super::series::Series;
use super::steps::{BOXCAR, Step, best_of, choose, doubt_filters, is_of_reading, step_of};
use super::taken_back::{
    drop_minor_steps, put_back, same_as_the_models, tails_and_bursts_again, take_back, weak_steps, weak_stretches,
    weak_tones,
};
use super::work::Parts;

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
