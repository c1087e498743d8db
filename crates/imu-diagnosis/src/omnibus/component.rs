//! Component: the most probable course of a spectral term in a record, and whether that course looks normal.
//!
//! A telegraph signal has the spectrum of a Gauss–Markov process, and a swept line that of a resonance. Given the
//! record, a term's most probable course then shows two levels or one amplitude; a normal process shows neither.

use super::half_square;
use crate::law::{Shape, Term};
use crate::plans;
use crate::series::Series;

/// Minimum number of independent values; the moments of fewer carry little information.
const FEWEST: f64 = 24.0;

/// The most probable course of a term that adds noise.
pub(crate) struct Part {
    /// The term's place in the law.
    pub(crate) place: usize,
    pub(crate) term: Term,
    pub(crate) course: Vec<f64>,
    /// The course's power in each coefficient.
    power: Vec<f64>,
    /// Part of the course's power that the term made; the rest is noise in its band.
    pub(crate) purity: f64,
}

impl Part {
    /// Returns the third and fourth moments of the course in its standard deviation, each with the number of independent normal
    /// values whose moments scatter alike. `None` if the fourth has too few.
    fn moments(&self) -> Option<[(f64, f64); 2]> {
        let count = self.course.len() as f64;
        let (third, fourth) = correlations(&self.power, self.course.len())?;
        let variance = self.course.iter().map(|x| x * x).sum::<f64>() / count;
        let moment = |order: i32| self.course.iter().map(|x| (x / variance.sqrt()).powi(order)).sum::<f64>() / count;
        let is_enough = variance > 0.0 && count / fourth >= FEWEST;
        is_enough.then(|| [(moment(3), count / third.max(0.0)), (moment(4), count / fourth)])
    }

    /// Returns the kurtosis of the course, and its deviation from that of a normal process as a standard normal value.
    pub(crate) fn kurtosis(&self) -> Option<(f64, f64)> {
        self.moments().map(|[_, (kurtosis, count)]| (kurtosis, kurtosis_score(kurtosis, count)))
    }
}

/// Returns the most probable course of each term that adds noise.
pub(crate) fn parts(series: &mut Series<'_>) -> Vec<Part> {
    let terms = series.explanation.law.terms.clone();
    let frequencies = series.grid.frequencies().clone();
    // Filters act behind the term.
    let mut gain = series.data().base.gain.clone();
    for filter in terms.iter().filter(|term| term.is_filter()) {
        gain.iter_mut().zip(filter.gains(&frequencies)).for_each(|(all, one)| *all *= one);
    }
    let mut found = Vec::new();
    for (place, term) in terms.into_iter().enumerate().filter(|(_, term)| term.adds()) {
        let added = term.added(&frequencies).into_iter().zip(&gain);
        let logarithms: Vec<f64> = added.map(|(power, gain)| (power * gain).max(f64::MIN_POSITIVE).ln()).collect();
        let own = series.grid.fill(&logarithms);
        // Share of the term in each coefficient's power.
        let share: Vec<f64> = own.iter().zip(&series.spectrum).map(|(own, all)| (own / all).min(1.0)).collect();
        let mut course: Vec<f64> = series.coefficients.iter().zip(&share).map(|(c, share)| c * share).collect();
        let mut power: Vec<f64> = own.iter().zip(&share).map(|(own, share)| own * share).collect();
        // A record's mean is unknown.
        (course[0], power[0]) = (0.0, 0.0);
        series.transform.backward(&mut course);
        let pure = power.iter().zip(&share).map(|(power, share)| power * share).sum::<f64>();
        let purity = pure / power.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        found.push(Part { place, term, course, power, purity });
    }
    found
}

/// Returns half the square of the largest deviation of a moment of any part, in standard deviations.
pub(super) fn worst(parts: &[Part]) -> f64 {
    let mut found = 0.0f64;
    for part in parts {
        let Some([(third, alike), (fourth, count)]) = part.moments() else { continue };
        found = found.max(half_square(kurtosis_score(fourth, count)));
        // The third moment of a narrow band is almost 0 for any process.
        if part.term.shape != Shape::Resonance && alike.is_finite() {
            found = found.max(half_square(third / (6.0 / alike).sqrt()));
        }
    }
    found
}

/// Returns the kurtosis of `n` independent normal values as a standard normal value (Anscombe and Glynn 1983,
/// Biometrika 70). The plain standard error overstates the probability of the kurtosis of two levels.
fn kurtosis_score(kurtosis: f64, n: f64) -> f64 {
    let mean = 3.0 * (n - 1.0) / (n + 1.0);
    let variance = 24.0 * n * (n - 2.0) * (n - 3.0) / ((n + 1.0).powi(2) * (n + 3.0) * (n + 5.0));
    let x = (kurtosis - mean) / variance.sqrt();
    let skew = 6.0 * (n * n - 5.0 * n + 2.0) / ((n + 7.0) * (n + 9.0))
        * (6.0 * (n + 3.0) * (n + 5.0) / (n * (n - 2.0) * (n - 3.0))).sqrt();
    let a = 6.0 + 8.0 / skew * (2.0 / skew + (1.0 + 4.0 / (skew * skew)).sqrt());
    let below = (1.0 + x * (2.0 / (a - 4.0)).sqrt()).max(1e-6);
    (1.0 - 2.0 / (9.0 * a) - ((1.0 - 2.0 / a) / below).cbrt()) / (2.0 / (9.0 * a)).sqrt()
}

/// Returns sums over all lags of the third and fourth powers of the autocorrelation that a power spectrum gives.
fn correlations(power: &[f64], samples: usize) -> Option<(f64, f64)> {
    let backward = plans::backward(2 * samples);
    let (mut input, mut output) = (backward.make_input_vec(), backward.make_output_vec());
    input.iter_mut().zip(power.iter().chain([&0.0])).for_each(|(own, power)| *own = (*power).into());
    backward.process(&mut input, &mut output).ok()?;
    let all = output[0];
    if all <= 0.0 {
        return None;
    }
    let sums = output[1..samples].iter().fold((0.0, 0.0), |(third, fourth), value| {
        let r = value / all;
        (third + r.powi(3), fourth + r.powi(4))
    });
    Some((1.0 + 2.0 * sums.0, 1.0 + 2.0 * sums.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    #[test]
    fn kurtosis_scores_of_normal_values_are_standard_normal() {
        let mut stream = Stream::new(3, StreamId { owner: 1, effect: 0, instance: 0 });
        let mut scores = Vec::new();
        for _ in 0..2000 {
            let values: Vec<f64> = (0..60).map(|_| stream.normal()).collect();
            let square = values.iter().map(|x| x * x).sum::<f64>() / 60.0;
            scores.push(kurtosis_score(values.iter().map(|x| x.powi(4)).sum::<f64>() / 60.0 / (square * square), 60.0));
        }
        let mean = scores.iter().sum::<f64>() / 2000.0;
        let spread = (scores.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 2000.0).sqrt();
        let below = scores.iter().filter(|score| **score < -2.326).count();
        assert!(mean.abs() < 0.1 && (spread - 1.0).abs() < 0.1, "{mean} {spread}");
        // About 1 % of 2000.
        assert!((8..40).contains(&below), "{below}");
        assert!(kurtosis_score(1.0, 1e4) < -30.0 && kurtosis_score(6.0, 1e4) > 15.0);
    }
}
