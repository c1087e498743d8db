//! Level: ramps, the influence of temperature, warm-ups and steps.

use super::leaps::leaps;
use super::{Candidate, Kind};
use crate::averages::sums;
use crate::course::{Course, Follow};
use crate::explanation::Explanation;
use crate::series::{Drift, Series};

fn candidate(series: &Series<'_>, kind: Kind, courses: &[Course], drift: Drift) -> Candidate {
    let mut explanation = series.explanation.clone();
    explanation.courses.extend(courses.iter().copied().zip(drift.factors));
    explanation.law = drift.law;
    Candidate::missing(kind, drift.gain, explanation)
}

fn has(series: &Series<'_>, wanted: impl Fn(&Course) -> bool) -> bool {
    series.explanation.courses.iter().any(|(course, _)| wanted(course))
}

/// Searches for a ramp. Beside a warm-up that was found before it, the warm-up's time constant is searched again.
pub fn ramp(series: &Series<'_>) -> Option<Candidate> {
    let alone = of_course(series, Kind::RateRamp, Course::Ramp)?;
    Some(ramp_beside_warm_up(series).filter(|both| both.gain > alone.gain).unwrap_or(alone))
}

fn ramp_beside_warm_up(series: &Series<'_>) -> Option<Candidate> {
    let mut courses = series.explanation.courses.iter().enumerate().skip(series.setting().shifts);
    let (at, _) = courses.find(|(_, (course, _))| matches!(course, Course::WarmUp(_)))?;
    let bare = series.changed(|of| of.courses.remove(at));
    let (tau, drift) = warm_up_beside(&bare, &[Course::Ramp])?;
    // A better time constant alone is not the ramp's gain.
    let present = series.fitted.log_posterior - bare.fitted.log_posterior;
    let alone = warm_up_beside(&bare, &[]).map_or(present, |(_, alone)| alone.gain.max(present));
    let gain = drift.gain - alone;
    let own = Candidate { gain, ..candidate(&bare, Kind::RateRamp, &[Course::WarmUp(tau), Course::Ramp], drift) };
    Some(own)
}

/// Searches for an influence of the temperature.
pub fn temperature(series: &Series<'_>) -> Option<Candidate> {
    series.setting().courses.temperature()?;
    of_course(series, Kind::TemperatureBias, Course::Temperature)
}

fn of_course(series: &Series<'_>, kind: Kind, course: Course) -> Option<Candidate> {
    let is_new = !has(series, |own| *own == course);
    is_new.then(|| candidate(series, kind, &[course], series.with_courses(&[course])))
}

/// Searches for an influence of the temperature other than an immediate straight line, beside that line.
pub fn curve(series: &Series<'_>) -> Option<Candidate> {
    let known = |course: &Course| matches!(course, Course::Follows(_));
    if has(series, known) {
        return None;
    }
    // With play the level follows a straight line as well, which is found first.
    of_ways(series, |way| !matches!(way, Follow::Play(_)) || has(series, |course| *course == Course::Temperature))
}

/// Searches as [`curve`] does, but also if the straight line was not found.
pub(super) fn curve_alone(series: &Series<'_>) -> Option<Candidate> {
    of_ways(series, |_| true)
}

fn of_ways(series: &Series<'_>, wanted: impl Fn(Follow) -> bool) -> Option<Candidate> {
    let ways = series.setting().courses.ways().into_iter().filter(|way| wanted(*way));
    let drifts = ways.map(|way| (Course::Follows(way), series.with_courses(&[Course::Follows(way)])));
    let (course, drift) = drifts.reduce(|a, b| if b.1.gain > a.1.gain { b } else { a })?;
    Some(candidate(series, Kind::TemperatureCurve, &[course], drift))
}

/// Searches for a warm-up.
pub fn warm_up(series: &Series<'_>) -> Option<Candidate> {
    if has(series, |course| matches!(course, Course::WarmUp(_))) {
        return None;
    }
    let (tau, drift) = warm_up_beside(series, &[])?;
    Some(candidate(series, Kind::WarmUp, &[Course::WarmUp(tau)], drift))
}

/// Returns the time constant of the best warm-up, from a 200th to a quarter of the record, and the result of adding it and
/// other courses.
fn warm_up_beside(series: &Series<'_>, others: &[Course]) -> Option<(f64, Drift)> {
    let n = series.len() as f64;
    let (least, most) = (n / 200.0, n / 4.0);
    let steps = 10;
    let at = |step: usize| least * (most / least).powf(step as f64 / f64::from(steps));
    let with = |tau: f64| std::iter::once(Course::WarmUp(tau)).chain(others.iter().copied()).collect::<Vec<Course>>();
    let fitted = |tau: f64| (tau, series.with_courses(&with(tau)));
    // The present law is precise enough for the choice.
    let starts = (0..=steps as usize).map(at);
    let start = starts.max_by(|a, b| series.gain_of(&with(*a)).total_cmp(&series.gain_of(&with(*b))))?;
    let mut best = fitted(start);
    for width in [1.25, 1.08, 1.025] {
        if best.1.gain < 4.0 {
            break;
        }
        for tau in [best.0 / width, best.0 * width] {
            if (least..=most).contains(&tau) {
                let other = fitted(tau);
                if other.1.gain > best.1.gain {
                    best = other;
                }
            }
        }
    }
    Some(best)
}

/// Nats that a further step has to gain, and its price.
pub(crate) const FURTHER: f64 = 14.0;
const PRICE: f64 = 12.0;

/// Searches for steps, each at the peak of a matched filter of the whitened series, one after the other; then examines
/// each again beside all others.
///
/// A level that alternates between a few values is a process, not a chain of steps.
pub fn steps(series: &mut Series<'_>) -> Option<Candidate> {
    /// No sensor's level jumps more often than this; otherwise the cause is another effect.
    const MOST: usize = 32;
    const SWEEPS: usize = 2;
    // Leaps need no law. The search begins with them if they are worth more than chance.
    let mut found = leaps(&series.rest);
    let mut best = (!found.is_empty()).then(|| with_steps(series, &found)).filter(|best| best.gain > FURTHER);
    if best.is_none() {
        found.clear();
    }
    while found.len() <= MOST {
        let at = further(series, &found, best.as_ref(), None);
        let with: Vec<usize> = found.iter().copied().chain([at]).collect();
        let mut drift = with_steps(series, &with);
        drift.gain = drift.gain.max(0.0);
        let last = best.as_ref().map_or(0.0, |best| best.gain + FURTHER);
        // The gain of a single step counts even if it is 0, because calibration measures it.
        if best.is_some() && drift.gain < last {
            break;
        }
        (found, best) = (with, Some(drift));
        if best.as_ref().is_some_and(|best| found.len() == 1 && best.gain < 8.0) {
            break;
        }
    }
    let mut drift = best.filter(|_| found.len() <= MOST)?;
    for _ in 0..if found.len() > 1 { SWEEPS } else { 0 } {
        let moved: Vec<usize> = (0..found.len()).map(|own| further(series, &found, Some(&drift), Some(own))).collect();
        let again = with_steps(series, &moved);
        if again.gain <= drift.gain {
            break;
        }
        (found, drift) = (moved, again);
    }
    while found.len() > 1 {
        // Gain of each step beside the others, at the present law.
        let worth = |own: usize| 0.5 * drift.factors[own].powi(2) / drift.covariance[(own, own)];
        let weakest = (0..found.len()).min_by(|a, b| worth(*a).total_cmp(&worth(*b)));
        let Some(weakest) = weakest.filter(|own| worth(*own) < FURTHER) else { break };
        found.remove(weakest);
        drift = with_steps(series, &found);
    }
    if to_and_fro(&found, &drift) {
        return None;
    }
    drift.gain -= PRICE * (found.len() - 1) as f64;
    let courses: Vec<Course> = found.into_iter().map(Course::Step).collect();
    Some(candidate(series, Kind::BiasStep, &courses, drift))
}

fn with_steps(series: &Series<'_>, places: &[usize]) -> Drift {
    let courses: Vec<Course> = places.iter().copied().map(Course::Step).collect();
    series.with_courses(&courses)
}

/// Returns the place at which one more step fits best beside the known ones, or the new place of the step that is
/// `moved`.
fn further(series: &mut Series<'_>, found: &[usize], drift: Option<&Drift>, moved: Option<usize>) -> usize {
    let mut rest = series.coefficients.clone();
    let Some(drift) = drift else {
        let spectrum = series.spectrum.clone();
        return place(series, &spectrum, &rest);
    };
    for (_, (at, factor)) in found.iter().zip(&drift.factors).enumerate().filter(|(own, _)| Some(*own) != moved) {
        let column = series.setting().courses.coefficients(Course::Step(*at));
        rest.iter_mut().zip(&column).for_each(|(all, one)| *all -= factor * one);
    }
    let spectrum = series.grid.fill(&drift.law.logarithms(series.data()));
    place(series, &spectrum, &rest)
}

/// Returns whether many steps lead to the same few levels again and again.
fn to_and_fro(places: &[usize], drift: &Drift) -> bool {
    /// Numbers of steps and levels.
    const FEW: [(usize, usize); 2] = [(7, 2), (10, 3)];
    /// Levels that differ by less than this many standard errors are one level.
    const ERRORS: f64 = 4.0;
    if places.len() < FEW[0].0 {
        return false;
    }
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_unstable_by_key(|own| places[*own]);
    let mut levels = vec![(0.0, 0)];
    levels.extend(order.iter().enumerate().scan(0.0, |level, (at, own)| {
        *level += drift.factors[*own];
        Some((*level, at + 1))
    }));
    levels.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let error = |from: usize, to: usize| {
        let between = &order[from.min(to)..from.max(to)];
        let of = |i: &usize| between.iter().map(|j| drift.covariance[(*i, *j)]).sum::<f64>();
        between.iter().map(of).sum::<f64>().max(0.0).sqrt()
    };
    let apart = levels.windows(2).filter(|pair| pair[1].0 - pair[0].0 > ERRORS * error(pair[0].1, pair[1].1));
    let levels = 1 + apart.count();
    FEW.iter().any(|(steps, most)| places.len() >= *steps && levels <= *most)
}

/// Joins steps that follow one another within a few samples, if they have one direction or one is far larger. A real
/// step takes some samples to rise, which are left out. The first `known` courses are the model's own.
pub fn join_rises(explanation: &mut Explanation, known: usize) {
    /// Steps within this many samples are one step.
    const NEAR: usize = 40;
    /// A step that is at most this part of another is a residue of the rise of the other.
    const MINOR: f64 = 0.2;
    let mut steps: Vec<(usize, f64)> = Vec::new();
    for (course, factor) in explanation.courses.iter().skip(known) {
        if let Course::Step(at) = course {
            steps.push((*at, *factor));
        }
    }
    steps.sort_unstable_by_key(|(at, _)| *at);
    for near in steps.chunk_by(|a, b| b.0 - a.0 <= NEAR).filter(|near| near.len() > 1) {
        let Some(largest) = near.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())) else { continue };
        let is_of_it = |of: &&(usize, f64)| of.1 * largest.1 > 0.0 || of.1.abs() < MINOR * largest.1.abs();
        let group: Vec<(usize, f64)> = near.iter().filter(is_of_it).copied().collect();
        if group.len() < 2 {
            continue;
        }
        let (from, to) = (group[0].0, group[group.len() - 1].0);
        let mut place = 0;
        explanation.courses.retain(|(course, _)| {
            place += 1;
            place <= known || !matches!(course, Course::Step(at) if group.iter().any(|of| of.0 == *at))
        });
        explanation.courses.push((Course::Step(largest.0), group.iter().map(|(_, factor)| factor).sum()));
        explanation.leave_out(from..to);
    }
}

/// Returns samples about the steps that are on neither level. A real step takes some samples to rise, in any shape.
pub fn rises(series: &Series<'_>) -> Vec<usize> {
    /// Samples examined before and after a step.
    const NEAR: usize = 40;
    /// Nats that a different variance about a step has to gain.
    const LEAST: f64 = 8.0;
    let mut places = Vec::new();
    for (course, _) in &series.explanation.courses {
        let Course::Step(at) = *course else { continue };
        let from = at.saturating_sub(NEAR);
        let near = &series.residual[from..(at + NEAR).min(series.len())];
        let sums = sums(near.iter().map(|e| e * e));
        let gain = |a: usize, b: usize| {
            let (count, sum): (f64, f64) = ((b - a) as f64, sums[b] - sums[a]);
            if sum > count { 0.5 * (sum - count - count * (sum / count).ln()) } else { 0.0 }
        };
        let middle = at - from;
        let stretches = (0..=middle).flat_map(|a| (middle.max(a + 1)..near.len()).map(move |b| (a, b + 1)));
        let best = stretches.map(|(a, b)| (gain(a, b), a, b)).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, a, b)) = best.filter(|best| best.0 > LEAST) {
            places.extend(from + a..from + b);
        }
    }
    places
}

/// Returns the place at which a step fits best: the sum of the doubly whitened series from each sample on, over its
/// standard deviation.
fn place(series: &mut Series<'_>, spectrum: &[f64], rest: &[f64]) -> usize {
    const PLACES: usize = 96;
    let n = series.len();
    // A step passes the filters as the white noise does: coefficients that hardly pass are no evidence of its place.
    let least = series.white().powi(2);
    let mut weighted: Vec<f64> = rest.iter().zip(spectrum).map(|(c, s)| c / s.max(least)).collect();
    series.transform.backward(&mut weighted);
    // The information about a step at a few places; it varies slowly.
    let margin = (n / 250).max(2);
    let kept = n.min(4096);
    let scale = 2.0 / n as f64;
    let shape: Vec<f64> = (1..kept)
        .map(|k| {
            let sine = (std::f64::consts::PI * k as f64 / (2.0 * n as f64)).sin();
            scale / (4.0 * sine * sine * spectrum[k].max(least))
        })
        .collect();
    let information = |at: usize| -> f64 {
        let step = std::f64::consts::PI * at as f64 / n as f64;
        // sin²(k·step) by the recurrence of cos(2k·step).
        let (double, mut last, mut now) = (2.0 * (2.0 * step).cos(), 1.0, (2.0 * step).cos());
        let mut sum = 0.0;
        for weight in &shape {
            sum += weight * 0.5 * (1.0 - now);
            (last, now) = (now, double * now - last);
        }
        sum
    };
    let places: Vec<usize> = (0..=PLACES).map(|place| margin + (n - 2 * margin) * place / PLACES).collect();
    let known: Vec<f64> = places.iter().map(|at| information(*at)).collect();
    let (mut sum, mut best, mut segment) = (0.0, (0.0, n / 2), 0);
    for (t, value) in weighted.iter().enumerate() {
        // The sum from t on is minus the sum before it, because the whole is 0.
        if (margin..n - margin).contains(&t) {
            while segment + 2 < places.len() && places[segment + 1] <= t {
                segment += 1;
            }
            let (from, to) = (places[segment], places[segment + 1].max(places[segment] + 1));
            let share = (t - from) as f64 / (to - from) as f64;
            let about = known[segment] + share * (known[segment + 1] - known[segment]);
            let score = sum * sum / about;
            if score > best.0 {
                best = (score, t);
            }
        }
        sum += value;
    }
    best.1
}
