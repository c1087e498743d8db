//! Spectral effects: more terms in the law.

use super::{Candidate, Kind};
use crate::law::{Data, Fitted, Law, Shape, Term};
use crate::series::Series;

/// Returns the best law with another term, from several starts of its numbers.
pub(super) fn with_term(
    series: &Series<'_>,
    shape: Shape,
    starts: impl IntoIterator<Item = Vec<f64>>,
) -> Option<(f64, Fitted)> {
    let data = series.data();
    let started = |numbers: Vec<f64>| {
        let mut law = series.explanation.law.clone();
        law.terms.push(Term { shape, numbers });
        law
    };
    let best = Law::fit_best(starts.into_iter().map(started).collect(), data)?;
    // A better optimum without the term is not evidence for the term.
    let mut without = best.law.clone();
    without.terms.pop();
    let without = without.fit(data).log_posterior.max(series.fitted.log_posterior);
    Some((best.log_posterior - without, best))
}

pub(super) fn candidate(series: &Series<'_>, kind: Kind, (gain, fitted): (f64, Fitted)) -> Candidate {
    let mut explanation = series.explanation.clone();
    explanation.law = fitted.law;
    Candidate::missing(kind, gain, explanation)
}

fn has(series: &Series<'_>, wanted: impl Fn(Shape) -> bool) -> bool {
    series.explanation.law.terms.iter().any(|term| wanted(term.shape))
}

/// Returns ln of the white part's variance per sample.
fn white(series: &Series<'_>) -> f64 {
    2.0 * series.white().ln()
}

/// Searches for a Gauss–Markov process.
pub fn gauss_markov(series: &Series<'_>) -> Option<Candidate> {
    const STARTS: usize = 7;
    if has(series, |shape| shape == Shape::GaussMarkov) {
        return None;
    }
    let rate_hz = series.setting().rate_hz;
    let (least, most) = (4f64, series.len() as f64 / 20.0);
    let starts = (0..STARTS).map(|at| {
        let tau = least * (most / least).powf(at as f64 / (STARTS - 1) as f64);
        // Level at low frequencies relative to the white noise's.
        vec![white(series) + (3.0 / tau).ln() - 1.0, (tau / rate_hz).ln()]
    });
    Some(candidate(series, Kind::GaussMarkov, with_term(series, Shape::GaussMarkov, starts)?))
}

/// Searches for white angle noise.
pub fn quantization_noise(series: &Series<'_>) -> Option<Candidate> {
    if has(series, |shape| shape == Shape::QuantizationNoise) {
        return None;
    }
    let start = white(series) - 2.0 * series.setting().rate_hz.ln() - 3.0;
    Some(candidate(series, Kind::QuantizationNoise, with_term(series, Shape::QuantizationNoise, [vec![start]])?))
}

/// If a filter of the first order gains fewer nats than this, it does not count as a filter.
pub(super) const HOPELESS: f64 = 3.0;

/// Searches for a Butterworth filter of the order that fits best.
pub fn low_pass(series: &Series<'_>) -> Option<Candidate> {
    if has(series, |shape| matches!(shape, Shape::LowPass(_))) {
        return None;
    }
    let rate_hz = series.setting().rate_hz;
    let of = |order: u64| {
        let starts = [0.15, 0.4].map(|share| vec![(share * rate_hz).ln(), -7.0]);
        with_term(series, Shape::LowPass(order), starts)
    };
    let mut best = of(1)?;
    for order in [2, 3, 4] {
        if best.0 < HOPELESS {
            // If a filter of the first order does not gain, no filter of any order does.
            break;
        }
        let other = of(order)?;
        if other.0 <= best.0 {
            break;
        }
        best = other;
    }
    Some(candidate(series, Kind::LowPass, best))
}

/// Searches for a boxcar of the window that fits best.
pub fn moving_average(series: &Series<'_>) -> Option<Candidate> {
    /// Each window up to this one is fitted; beyond it, those with the deepest notches.
    const EACH: u64 = 20;
    if has(series, |shape| matches!(shape, Shape::MovingAverage(_))) {
        return None;
    }
    let started = |window: u64| {
        let mut law = series.explanation.law.clone();
        law.terms.push(Term { shape: Shape::MovingAverage(window), numbers: vec![-7.0] });
        law
    };
    // Each fit runs to its end: a window's notches do not show before the levels are right.
    let fits = (2..=EACH).chain(notched(series)).map(|window| started(window).fit(series.data()));
    let best = fits.reduce(|a, b| if b.log_posterior > a.log_posterior { b } else { a })?;
    let mut without = best.law.clone();
    without.terms.pop();
    let without = without.fit(series.data()).log_posterior.max(series.fitted.log_posterior);
    Some(candidate(series, Kind::MovingAverage, (best.log_posterior - without, best)))
}

/// Returns the long windows with the least power at their notches relative to that half way between them.
fn notched(series: &Series<'_>) -> Vec<u64> {
    const WINDOWS: std::ops::RangeInclusive<u64> = 21..=64;
    const MOST: usize = 3;
    let n = series.len();
    // The mean covers an eighth of the distance of notches about each frequency, but at least a thousandth of the band.
    let mean = |cycles: f64, window: u64| {
        let half = (n as f64 * (0.125 / window as f64).max(1e-3)) as usize;
        let at = (2.0 * n as f64 * cycles) as usize;
        let span = &series.coefficients[at.saturating_sub(half).max(1)..(at + half).min(n).max(2)];
        (span.iter().map(|c| c * c).sum::<f64>() / span.len().max(1) as f64).max(f64::MIN_POSITIVE).ln()
    };
    let depth = |window: u64| {
        let notches = 1..=(window / 2).saturating_sub(1);
        let count = notches.clone().count().max(1) as f64;
        let of = |order: u64| {
            let [notch, between] = [0.0, 0.5].map(|more| mean((order as f64 + more) / window as f64, window));
            between - notch
        };
        notches.map(of).sum::<f64>() / count
    };
    let mut all: Vec<(f64, u64)> =
        WINDOWS.filter(|window| *window as usize * 64 < n).map(|of| (depth(of), of)).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.into_iter().take(MOST).map(|(_, window)| window).collect()
}

/// Searches for a density whose slope differs from those of white noise, flicker and random walk.
pub fn slope(series: &Series<'_>) -> Option<Candidate> {
    let mut candidate = slope_believed(series)?;
    // If B or K is far off, the slope does not differ: only the gain with both free counts.
    let free = Data { priors: &[None, None, None], ..series.data() };
    let law = &candidate.explanation.law;
    let mut without = law.clone();
    without.terms.pop();
    let unbelieved = law.fit(free).log_likelihood - without.fit_from_several(free).log_likelihood;
    candidate.gain = candidate.gain.min(unbelieved);
    Some(candidate)
}

/// Searches as [`slope`] does if B and K are known to be about the model's values.
pub(crate) fn slope_believed(series: &Series<'_>) -> Option<Candidate> {
    if has(series, |shape| matches!(shape, Shape::Slope(_))) {
        return None;
    }
    let fits = Shape::SLOPES.into_iter().enumerate().filter_map(|(which, (low, high))| {
        with_term(series, Shape::Slope(which), [vec![white(series) - 1.5, 0.5 * (low + high)]])
    });
    let best = fits.reduce(|a, b| if b.0 > a.0 { b } else { a })?;
    Some(candidate(series, Kind::Slope, best))
}
