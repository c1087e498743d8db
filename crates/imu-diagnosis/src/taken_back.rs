//! Taken back: removes effects that were named early and are not worth their price beside all effects found later.

use super::course::Course;
use super::evidence::declared::kind_of;
use super::evidence::{self, Kind};
use super::explanation::{Explanation, Loud};
use super::further::leave_rises_out;
use super::gated;
use super::law::{Fitted, Shape, Term};
use super::prices::Prices;
use super::report::Sense;
use super::series::Series;
use super::steps::Step;

/// Takes back steps that the remaining samples do not show, or that are not worth their number beside all other effects. The
/// first `known` courses are the model's.
pub(super) fn weak_steps(series: &mut Series<'_>, steps: &mut Vec<Step>, known: usize) {
    let is_own = |at: usize, course: &Course| at >= known && matches!(course, Course::Step(_));
    let own = |series: &Series<'_>| -> Vec<usize> {
        let courses = series.explanation.courses.iter().enumerate();
        courses.filter(|(at, (course, _))| is_own(*at, course)).map(|(at, _)| at).collect()
    };
    if own(series).is_empty() {
        return;
    }
    if join_across_gaps(series, known) {
        series.rebuild(false);
    }
    loop {
        let courses = &series.explanation.courses;
        let columns: Vec<Vec<f64>> =
            courses.iter().map(|(course, _)| series.setting().courses.coefficients(*course)).collect();
        let Some(covariance) = series.covariance(&columns) else { break };
        let worth = |at: usize| 0.5 * courses[at].1.powi(2) / covariance[(at, at)];
        let weakest = own(series).into_iter().map(|at| (worth(at), at)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, at)) = weakest.filter(|(worth, _)| *worth < evidence::level::FURTHER) else { break };
        series.explanation.courses.remove(at);
        series.rebuild(false);
    }
    if own(series).is_empty() {
        steps.retain(|step| step.kind != Kind::BiasStep || step.of_model.is_some());
    }
}

/// Takes back stretches that are as loud as the rest once all else is known. The first `known` stretches are the
/// model's.
pub(super) fn weak_stretches(series: &mut Series<'_>, steps: &mut Vec<Step>, known: usize) {
    let (samples, bursts_of_model) = (series.len(), series.setting().bursts);
    let is_named = |kind: Kind| steps.iter().any(|step| step.kind == kind && step.of_model.is_none());
    let (bursts, intervals) = (is_named(Kind::Bursts), is_named(Kind::VarianceInterval));
    let before = series.explanation.loud.len();
    series.explanation.retain_loud(known, |loud| {
        let named = if loud.is_interval(samples, bursts_of_model) { intervals } else { bursts };
        named && loud.gain() >= evidence::loudness::price_of_one(samples)
    });
    if series.explanation.loud.len() == before {
        return;
    }
    series.rebuild(false);
    let is_left = |long: bool, of: &Loud| of.is_interval(samples, bursts_of_model) == long;
    let left = |long: bool| series.explanation.loud[known..].iter().any(|loud| is_left(long, loud));
    let (burst, interval) = (left(false), left(true));
    steps.retain(|step| match step.kind {
        Kind::Bursts => burst || step.of_model.is_some(),
        Kind::VarianceInterval => interval || step.of_model.is_some(),
        _ => true,
    });
}

/// Joins steps between which every sample is left out: only their sum is known. Returns whether there were such steps.
fn join_across_gaps(series: &mut Series<'_>, known: usize) -> bool {
    let excluded = series.excluded();
    let nothing_between = |from: usize, to: usize| {
        let count = excluded.partition_point(|at| *at < to) - excluded.partition_point(|at| *at < from);
        count == to - from
    };
    let courses = &mut series.explanation.courses;
    let mut order: Vec<(usize, usize)> = Vec::new();
    for (at, (course, _)) in courses.iter().enumerate().skip(known) {
        if let Course::Step(place) = course {
            order.push((*place, at));
        }
    }
    order.sort_unstable();
    let mut gone = Vec::new();
    for pair in order.windows(2) {
        let ((from, one), (to, other)) = (pair[0], pair[1]);
        if nothing_between(from, to) {
            courses[other].1 += courses[one].1;
            gone.push(one);
        }
    }
    gone.sort_unstable();
    for at in gone.iter().rev() {
        courses.remove(*at);
    }
    !gone.is_empty()
}

/// Takes back tails and bursts that are not worth their price any more: an early estimate of a variance, a step or a
/// limit leaves both. A band that comes and goes leaves a course of the variance.
pub(super) fn tails_and_bursts_again(
    series: &mut Series<'_>,
    prices: &Prices,
    steps: &mut Vec<Step>,
    start: &Explanation,
) {
    /// Nats beyond the price, if effects are known that leave tails or bursts.
    const CLEARLY: f64 = 6.0;
    let leaves = |step: &Step| {
        use Kind::{BiasStep, VarianceInterval, VariancePerDegree, VarianceProfile};
        matches!(
            step.kind,
            BiasStep | VarianceInterval | VariancePerDegree | VarianceProfile | Kind::Bursts | Kind::Spikes
        )
    };
    for kind in [Kind::VarianceProfile, Kind::HeavyTails, Kind::Bursts] {
        let Some(at) = steps.iter().position(|step| step.kind == kind && step.of_model.is_none()) else { continue };
        let beside = match kind {
            Kind::VarianceProfile => !gated::gates(series).is_empty(),
            _ => series.is_cut() || steps.iter().any(|step| step.kind != kind && leaves(step)),
        };
        if !beside {
            continue;
        }
        let (samples, bursts) = (series.len(), series.setting().bursts);
        let without = series.changed(|of| match kind {
            Kind::VarianceProfile => of.scedasticity.clone_from(&start.scedasticity),
            Kind::HeavyTails => of.tails = start.tails,
            _ => of.retain_loud(start.loud.len(), |loud| loud.is_interval(samples, bursts)),
        });
        let again = evidence::of_squares(&without).into_iter().find(|of| of.kind == kind);
        if again.is_none_or(|of| of.gain < prices.of(kind) + CLEARLY) {
            *series = without;
            steps.remove(at);
        }
    }
}

/// Takes back steps about a far larger one that are not needed once the samples of its rise are left out; the first `known`
/// courses are the model's.
pub(super) fn drop_minor_steps(series: &mut Series<'_>, known: usize) {
    /// Samples about the larger step, and the ratio of its size to theirs.
    const NEAR: usize = 512;
    const LARGER: f64 = 5.0;
    /// Nats that a step has to gain.
    const WORTH: f64 = 14.0;
    let is_minor = |courses: &[(Course, f64)], at: usize| {
        let (Course::Step(place), size) = courses[at] else { return false };
        courses[known..].iter().any(|(course, other)| match course {
            Course::Step(its) => its.abs_diff(place) <= NEAR && other.abs() > LARGER * size.abs(),
            _ => false,
        })
    };
    let mut at = known;
    while at < series.explanation.courses.len() {
        if is_minor(&series.explanation.courses, at) {
            let mut without = series.changed(|of| of.courses.remove(at));
            leave_rises_out(&mut without);
            if without.fitted.log_posterior > series.fitted.log_posterior - WORTH {
                *series = without;
                continue;
            }
        }
        at += 1;
    }
}

/// Takes back spectral terms that are not worth their price any more beside effects named later.
pub(super) fn take_back(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    if steps.len() < 2 {
        return;
    }
    loop {
        let whole = series.fitted.log_posterior;
        let terms = &series.explanation.law.terms;
        // If the model has the term itself, no effect was named.
        let is_named = |shape: Shape| steps.iter().any(|step| step.kind == kind_of(shape) && step.has_term());
        let own: Vec<usize> = (0..terms.len()).filter(|at| is_named(terms[*at].shape)).collect();
        let filters: Vec<usize> = own.iter().copied().filter(|at| terms[*at].is_filter()).collect();
        let mut sets: Vec<Vec<usize>> = own.iter().map(|at| vec![*at]).collect();
        // Of two filters each may stand for what the other does.
        sets.extend((filters.len() > 1).then_some(filters));
        let losses = sets.into_iter().filter_map(|set| {
            let price: f64 = set.iter().map(|at| prices.of(kind_of(terms[*at].shape))).sum();
            let mut law = without_terms(series, &set);
            if whole - law.log_posterior >= price {
                law = with_lines_again(series, &set, &law, price)?;
            }
            let loss = whole - law.log_posterior;
            (loss < price).then_some((loss - price, set, law))
        });
        let Some((_, set, without)) = losses.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        for kind in set.into_iter().map(|at| kind_of(terms[at].shape)) {
            let weakest = |of: &(usize, &Step)| of.1.kind == kind && of.1.has_term();
            let step = steps.iter().enumerate().filter(weakest).min_by(|a, b| a.1.gain.total_cmp(&b.1.gain));
            if let Some(step) = step.map(|(step, _)| step) {
                match &mut steps[step].of_model {
                    Some((_, sense)) => *sense = Sense::Superfluous,
                    None => drop(steps.remove(step)),
                }
            }
        }
        series.explanation.law = without.law;
        series.rebuild(false);
    }
}

/// Fits the law without some of its terms.
///
/// A filter that was named first stands for the skirts of bands as well, and the noise in front of it is far louder than the
/// model's. The fit without it therefore also starts from the model's N, with bands that may lean.
fn without_terms(series: &Series<'_>, set: &[usize]) -> Fitted {
    let terms = &series.explanation.law.terms;
    let mut law = series.explanation.law.clone();
    law.terms = terms.iter().enumerate().filter(|(at, _)| !set.contains(at)).map(|(_, term)| term.clone()).collect();
    let near = law.fit(series.data());
    let is_band = |term: &Term| term.shape == Shape::Resonance;
    if !(set.iter().any(|at| terms[*at].is_filter()) && law.terms.iter().any(is_band)) {
        return near;
    }
    law.levels[0] = series.setting().white;
    let mut doubt = 0.0;
    for term in law.terms.iter_mut().filter(|term| is_band(term)) {
        if term.numbers.len() == Shape::SYMMETRIC {
            term.numbers.push(0.0);
            doubt += Shape::LEANING;
        }
    }
    let mut other = law.fit(series.data());
    other.log_posterior -= doubt;
    if other.log_posterior > near.log_posterior { other } else { near }
}

/// Fits the lines beside bands again, after the law was fitted without the bands. A line was fitted beside a band at its
/// frequency: without the band it may explain what the band did. `None` if there is no such line, or if the coefficients apart
/// from the lines lose far more than the price: then the whole series need not be built again, which takes long in a long record.
fn with_lines_again(series: &Series<'_>, set: &[usize], near: &Fitted, price: f64) -> Option<Fitted> {
    /// Widths of a band within which a line is beside it.
    const WIDTHS: f64 = 2.0;
    /// Coefficients to either side of a line, beyond which another amplitude of the line changes little.
    const NEAR: usize = 32;
    /// Lines that are fitted again do not make up for a loss of this many prices apart from them.
    const FAR: f64 = 3.0;
    let terms = &series.explanation.law.terms;
    let rate_hz = series.setting().rate_hz;
    let bands = set.iter().map(|at| &terms[*at]).filter(|term| term.shape == Shape::Resonance);
    let widths: Vec<[f64; 2]> = bands.map(|term| [term.numbers[1], WIDTHS * term.numbers[2].exp()]).collect();
    let sines = series.explanation.sines.iter().map(|sine| sine.cycles);
    let is_beside = |cycles: &f64| widths.iter().any(|[at_hz, width_hz]| (cycles * rate_hz - at_hz).abs() < *width_hz);
    let lines: Vec<usize> =
        sines.filter(is_beside).map(|cycles| (2.0 * series.len() as f64 * cycles) as usize).collect();
    if lines.is_empty() {
        return None;
    }
    let data = series.data();
    let independent = data.worth.iter().sum::<f64>() / data.grid.counts.iter().sum::<f64>();
    let without = series.grid.fill(&near.logarithms);
    let coefficients = series.coefficients.iter().zip(&series.spectrum).zip(&without).enumerate();
    let apart = coefficients.filter(|(at, _)| lines.iter().all(|line| line.abs_diff(*at) > NEAR));
    let loss = |((c, with), without): ((&f64, &f64), &f64)| {
        0.5 * ((without / with).ln() + c * c * (1.0 / without - 1.0 / with))
    };
    let lost = independent * apart.map(|(_, of)| loss(of)).filter(|loss| loss.is_finite()).sum::<f64>();
    // Lines that come and go are fitted again, too.
    let is_lost = lost >= FAR * price && series.explanation.gated.is_empty();
    (!is_lost).then(|| series.changed(|of| of.law = near.law.clone()).fitted)
}

/// Takes back tones that were chance under a law without a filter that is now known. The first `known` tones are the
/// model's.
pub(super) fn weak_tones(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>, known: usize) {
    let worth = |series: &Series<'_>, at: usize| {
        let sine = &series.explanation.sines[at];
        let place = ((2.0 * series.len() as f64 * sine.cycles) as usize).clamp(1, series.len() - 1);
        0.25 * series.len() as f64 * sine.amplitude().powi(2) / series.spectrum[place]
    };
    loop {
        let own = known..series.explanation.sines.len();
        let weakest = own.map(|at| (worth(series, at), at)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, at)) = weakest.filter(|(worth, _)| *worth < prices.of(Kind::Tone)) else { return };
        series.explanation.sines.remove(at);
        let tones = steps.iter().enumerate().filter(|(_, step)| step.kind == Kind::Tone);
        let step = tones.min_by(|a, b| a.1.gain.total_cmp(&b.1.gain)).map(|(step, _)| step);
        step.into_iter().for_each(|step| drop(steps.remove(step)));
        series.rebuild(false);
    }
}

/// Takes an effect that was named as missing for another size of the model's effect, if the latter is not needed beside
/// it.
pub(super) fn same_as_the_models(series: &mut Series<'_>, prices: &Prices, steps: &mut [Step]) {
    for at in 0..steps.len() {
        let kind = steps[at].kind;
        if steps[at].of_model.is_some() || kind.repeats() || !steps[at].has_term() {
            continue;
        }
        let is_open = |place: usize| {
            let named = steps.iter().any(|step| step.of_model.is_some_and(|(own, _)| own == place));
            !named && !series.explanation.without.contains(&place)
        };
        let mut declared = series.setting().declared.iter();
        let own = declared.find(|(place, term)| kind_of(term.shape) == kind && is_open(*place));
        let Some(place) = own.map(|(place, _)| *place) else { continue };
        let bare = series.without_declared(place);
        if series.fitted.log_posterior - bare.fitted.log_posterior < prices.of(kind) {
            *series = bare;
            series.rebuild(false);
            steps[at].of_model = Some((place, Sense::Size));
        }
    }
}

/// Puts back the model's effect if it explains as much beside the effects found after it was changed.
pub(super) fn put_back(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    let changed = |step: &Step| step.of_model.is_some();
    while let Some((at, as_stated)) =
        steps.iter().enumerate().filter(|(_, step)| changed(step)).find_map(|(at, step)| {
            let (place, _) = step.of_model?;
            let mut as_stated = series.clone();
            as_stated.explanation.without.remove(&place);
            if step.has_term() {
                let own = as_stated.explanation.law.terms.iter().rposition(|term| kind_of(term.shape) == step.kind)?;
                as_stated.explanation.law.terms.remove(own);
            }
            as_stated.relaw();
            let loss = series.fitted.log_posterior - as_stated.fitted.log_posterior;
            (loss < prices.of(step.kind)).then_some((at, as_stated))
        })
    {
        *series = as_stated;
        series.rebuild(false);
        steps.remove(at);
    }
}
