//! Polish: numbers that were found early are fitted again beside all effects that were found later.

use super::course::{Course, Follow};
use super::evidence::loudness;
use super::explanation::{Explanation, LOUD, Scedasticity};
use super::series::Series;

/// Fits again the time constant of a warm-up, the dependence of variance on time or temperature, and the ratios of
/// stretches, for effects that the model lacks.
pub(super) fn polish(series: &mut Series<'_>, start: &Explanation) {
    warm_up(series, start.courses.len());
    play(series, start.courses.len());
    if start.scedasticity.is_none() {
        scedasticity(series);
    }
    stretches(series, start.loud.len());
}

/// Returns the derivative of a warm-up of amplitude 1 with respect to ln τ, in coefficients.
pub(super) fn by_time_constant(series: &Series<'_>, tau: f64) -> Vec<f64> {
    const STEP: f64 = 0.02;
    let there = |share: f64| series.setting().courses.coefficients(Course::WarmUp(tau * share));
    there(1.0 + STEP).iter().zip(there(1.0 - STEP)).map(|(a, b)| (a - b) / (2.0 * STEP)).collect()
}

/// Takes Gauss–Newton steps of a warm-up's time constant beside the factors of all courses.
fn warm_up(series: &mut Series<'_>, known: usize) {
    const ROUNDS: usize = 4;
    const FAR: f64 = 0.3;
    const NEAR: f64 = 2e-3;
    for _ in 0..ROUNDS {
        let courses = &series.explanation.courses;
        let is_new = |(at, (course, _)): (usize, &(Course, f64))| at >= known && matches!(course, Course::WarmUp(_));
        let Some(at) = courses.iter().enumerate().position(is_new) else { return };
        let (Course::WarmUp(tau), factor) = courses[at] else { return };
        let of = |(course, _): &(Course, f64)| series.setting().courses.coefficients(*course);
        let mut columns: Vec<Vec<f64>> = courses.iter().map(of).collect();
        columns.push(by_time_constant(series, tau).into_iter().map(|value| factor * value).collect());
        let found = series.with_columns(&columns).factors;
        let Some((by, factors)) = found.split_last() else { return };
        let by = by.clamp(-FAR, FAR);
        if !by.is_finite() || by.abs() < NEAR {
            return;
        }
        let kept = series.clone();
        for ((_, factor), more) in series.explanation.courses.iter_mut().zip(factors) {
            *factor += more;
        }
        series.explanation.courses[at].0 = Course::WarmUp(tau * by.exp());
        series.rebuild(false);
        if series.fitted.log_posterior < kept.fitted.log_posterior {
            *series = kept;
            return;
        }
    }
}

/// Fits the width of a play, and whether the level also follows the temperature along a straight line.
fn play(series: &mut Series<'_>, known: usize) {
    /// Nats that the straight line has to gain.
    const LEAST: f64 = 3.0;
    let place = |series: &Series<'_>, wanted: fn(&Course) -> bool| {
        let courses = &series.explanation.courses;
        (known..courses.len()).find(|at| wanted(&courses[*at].0))
    };
    let is_play = |of: &Course| matches!(of, Course::Follows(Follow::Play(_)));
    let Some(at) = place(series, is_play) else { return };
    for by in [1.25, 1.1, 1.04] {
        for share in [by, 1.0 / by] {
            let Course::Follows(Follow::Play(width)) = series.explanation.courses[at].0 else { return };
            let other = series.changed(|of| of.courses[at].0 = Course::Follows(Follow::Play(width * share)));
            if other.fitted.log_posterior > series.fitted.log_posterior {
                *series = other;
            }
        }
    }
    if let Some(line) = place(series, |of| *of == Course::Temperature) {
        let other = series.changed(|of| of.courses.remove(line));
        if series.fitted.log_posterior - other.fitted.log_posterior < LEAST {
            *series = other;
        }
    }
}

/// Fits the dependence of variance on time or temperature again, beside the known one.
pub(super) fn scedasticity(series: &mut Series<'_>) {
    const ROUNDS: usize = 4;
    for _ in 0..ROUNDS {
        let Some(now) = series.explanation.scedasticity.clone() else { return };
        let Some(next) = loudness::again(series, &now) else { return };
        let apart = match (&now, &next) {
            (Scedasticity::PerDegree(a), Scedasticity::PerDegree(b)) => (a - b).abs() / a.abs(),
            (Scedasticity::Profile(a), Scedasticity::Profile(b)) if a.len() != b.len() => f64::INFINITY,
            (Scedasticity::Profile(a), Scedasticity::Profile(b)) => {
                a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
            }
            _ => return,
        };
        series.explanation.scedasticity = Some(next);
        series.rebuild(false);
        if apart < 1e-3 {
            return;
        }
    }
}

/// Fits the ratios of stretches that are not left out, each relative to the samples in no stretch.
fn stretches(series: &mut Series<'_>, known: usize) {
    const ROUNDS: usize = 16;
    /// A smaller change of ln of a ratio counts as none.
    const SETTLED: f64 = 0.002;
    /// The largest share of its last change by which a ratio moves on.
    const SLOWEST: f64 = 0.95;
    if series.explanation.loud.len() <= known {
        return;
    }
    let mut last = vec![0.0; series.explanation.loud.len()];
    for round in 0..ROUNDS {
        let ratios = loudness::ratios(series);
        let mut moved = 0.0f64;
        for ((loud, ratio), last) in series.explanation.loud.iter_mut().zip(ratios).zip(&mut last).skip(known) {
            let change: f64 = ratio.map_or(0.0, |ratio| (ratio / loud.ratio).ln());
            moved = moved.max(change.abs());
            // If the rest is louder than the white noise, the changes are a slow geometric series: its sum, each second
            // time (Aitken 1926).
            let share = if round % 2 == 1 && *last != 0.0 { (change / *last).clamp(0.0, SLOWEST) } else { 0.0 };
            loud.ratio = (loud.ratio * (change / (1.0 - share)).exp()).min(LOUD.max(loud.ratio));
            *last = change;
        }
        series.rebuild(false);
        // The separation of white noise from the rest, the residual's ranks and the replaced samples depend on how loud
        // the white noise is.
        let is_exact = series.equaliser.is_none() && series.explanation.tails.is_none() && series.excluded().is_empty();
        if moved < SETTLED || is_exact {
            break;
        }
    }
}
