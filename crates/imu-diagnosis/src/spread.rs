//! Spread: standard errors of a series' explanation.

use super::course::Course;
use super::evidence::heavy_tails::{self, Kernel};
use super::evidence::loudness::LARGEST;
use super::explanation::{LOUD, Loud, Scedasticity};
use super::gated;
use super::polish::by_time_constant;
use super::series::Series;

/// Standard errors in the series' scale, beside the parts of an explanation.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Spread {
    /// The errors of each course's factor, and of the logarithm of a warm-up's time constant or of a step's place in
    /// samples.
    pub courses: Vec<(f64, f64)>,
    /// The errors of each sine's frequency in cycles per sample and of its amplitude.
    pub sines: Vec<(f64, f64)>,
    /// The errors of the frequency of each sine that comes and goes, and its amplitude with its error.
    pub gated: Vec<(f64, [f64; 2])>,
    /// The errors of each term's numbers.
    pub terms: Vec<Vec<f64>>,
    /// The error of ln of the degrees of freedom.
    pub tails: f64,
    /// The part of the white samples' fourth cumulant that the residual has.
    pub fourth: f64,
    /// The error of the slope of ln variance by °C.
    pub per_degree: f64,
    /// The variance of the residual's squares over that of a normal distribution's, as the ratios of stretches use them.
    pub squares: f64,
    /// The errors of ln of each stretch's factor.
    pub loud: Vec<f64>,
}

/// Returns the variance of ratios of normal scores' mean squares over that for normal noise. For Student's t no method is
/// below 1 + 3/ν (Fisher's information of the scale); scores are somewhat above it.
fn of_scores(degrees: f64) -> f64 {
    1.0 + 5.0 / degrees
}

/// Returns the variances of the residual's squares over that of a normal distribution's: as the ratios of stretches use the
/// squares, and as those of excluded stretches do.
fn squares(series: &Series<'_>) -> [f64; 2] {
    let over_normal = |limit: f64| {
        let sums = series.there().fold((0.0, 0.0, 0.0), |(count, square, fourth), (_, value)| {
            let own = (value * value).min(limit);
            (count + 1.0, square + own, fourth + own * own)
        });
        let (count, square, fourth) = sums;
        if square > 0.0 { (0.5 * (fourth * count / (square * square) - 1.0)).max(1.0) } else { 1.0 }
    };
    let limited = series.explanation.tails.map_or_else(|| over_normal(LARGEST), of_scores);
    [limited, over_normal(f64::INFINITY)]
}

/// Returns the error of ln of the factor on the white noise's deviation in a stretch. The rest of the noise hides a part of it,
/// and its power is itself known only to `REST_ERROR`.
fn factor_error(series: &Series<'_>, loud: &Loud, others: f64, squares: f64) -> f64 {
    /// The error of ln of the rest's power: B and K of hours are known to about a fifth.
    const REST_ERROR: f64 = 0.2;
    let samples = (loud.to - loud.from) as f64;
    // The factor is the mean square in the stretch over that in no stretch.
    let samples = 1.0 / ((1.0 / samples + 1.0 / others.max(1.0)) * squares);
    let (left, slope) = series.equaliser.as_ref().map_or((1.0, 0.0), |of| of.left((loud.from + loud.to) / 2));
    (0.5 / (samples * left)).sqrt().hypot(0.5 * slope * REST_ERROR)
}

impl Spread {
    /// Computes the errors of a series' explanation.
    ///
    /// Courses: generalised least squares, with a warm-up's time constant beside its amplitude. A step's place: about
    /// 11 times the squared ratio of noise to step holds it in 95 % (Yao 1987, Ann. Stat. 15). Sines: the Cramér–Rao
    /// bound (Rife and Boorstyn 1974, IEEE Trans. IT 20) at the law's density. Spectral terms: the inverse of Fisher's
    /// information.
    pub fn of(series: &Series<'_>) -> Self {
        let explanation = &series.explanation;
        let n = series.len() as f64;
        let courses = &series.setting().courses;
        let mut columns: Vec<Vec<f64>> =
            explanation.courses.iter().map(|(course, _)| courses.coefficients(*course)).collect();
        let mut slopes = Vec::new();
        for (at, (course, factor)) in explanation.courses.iter().enumerate() {
            if let Course::WarmUp(tau) = course {
                columns.push(by_time_constant(series, *tau).into_iter().map(|value| factor * value).collect());
                slopes.push((at, columns.len() - 1));
            }
        }
        // Twice the gain in nats of moving a step of 1 by one sample; behind filters, it is less than at full height.
        let gain = series.filters();
        let passed = |k: usize| gain.as_ref().map_or(1.0, |gain| gain[k].min(1.0));
        let worth = |(k, s): (usize, &f64)| passed(k) / s;
        let sharpness = series.spectrum.iter().enumerate().skip(1).map(worth).sum::<f64>() / n;
        let covariance = series.covariance(&columns);
        // The place of a step among excluded samples is unknown.
        let excluded = series.excluded();
        let unknown = |at: usize| {
            let place = excluded.partition_point(|of| *of < at);
            let before = (1..=place).take_while(|back| excluded[place - back] + back == at).count();
            let behind = excluded[place..].iter().zip(at..).take_while(|(of, t)| **of == *t).count();
            before.max(behind) as f64
        };
        let error = |at: usize| covariance.as_ref().map_or(0.0, |matrix| matrix[(at, at)].max(0.0).sqrt());
        let of_course = |at: usize| {
            let (course, factor) = explanation.courses[at];
            let more = match course {
                Course::Step(place) => (11.0 / (factor * factor * sharpness) + 1.0 + unknown(place)) / 1.96,
                _ => slopes.iter().find(|(own, _)| *own == at).map_or(0.0, |(_, column)| error(*column)),
            };
            (error(at), more)
        };
        let of_sine = |sine: &super::explanation::Sine| {
            let at = ((2.0 * n * sine.cycles) as usize).clamp(1, series.spectrum.len() - 1);
            let density = series.spectrum[at];
            let frequency = (24.0 * density / n.powi(3)).sqrt() / sine.amplitude() / std::f64::consts::TAU;
            (frequency, (2.0 * density / n).sqrt())
        };
        let mut number = 3;
        let mut of_term = |count: usize| {
            number += count;
            let error = |at| series.fitted.covariance.as_ref().map_or(0.0, |matrix| matrix[(at, at)].max(0.0).sqrt());
            (number - count..number).map(error).collect()
        };
        let per_degree = match &explanation.scedasticity {
            Some(Scedasticity::PerDegree(slope)) => {
                // At each instant, slow noise, which temperature does not change, cannot be separated from white noise.
                const OTHERS: f64 = 0.01;
                let about = courses.temperature().unwrap_or_default();
                let mean = about.iter().sum::<f64>() / n;
                let square: f64 = about.iter().map(|t| (t - mean).powi(2)).sum();
                (2.0 / square.max(f64::MIN_POSITIVE)).sqrt().hypot(OTHERS * slope)
            }
            _ => 0.0,
        };
        let [squares, of_excluded] = squares(series);
        let mut is_loud = vec![false; series.len()];
        explanation.loud.iter().for_each(|loud| is_loud[series.spoilt(loud)].fill(true));
        let others = series.there().filter(|(t, _)| !is_loud[*t]).count() as f64;
        let error_of = |loud: &Loud| {
            let squares = if loud.ratio > LOUD { of_excluded } else { squares };
            factor_error(series, loud, others, squares)
        };
        let kernel = Kernel::of(series);
        let there = n - series.excluded().len() as f64;
        Self {
            courses: (0..explanation.courses.len()).map(of_course).collect(),
            sines: explanation.sines.iter().map(of_sine).collect(),
            gated: explanation.gated.iter().map(|sine| gated::errors(series, sine)).collect(),
            terms: explanation.law.terms.iter().map(|term| of_term(term.numbers.len())).collect(),
            tails: explanation.tails.map_or(0.0, |degrees| heavy_tails::error(degrees, &kernel, there)),
            fourth: kernel.share(4.0).powi(4),
            per_degree,
            squares,
            loud: explanation.loud.iter().map(error_of).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::normal_scores;
    use imu_model::effects::{Stream, StreamId};

    #[test]
    fn ratios_of_normal_scores_scatter_about_as_much_as_stated() {
        const DRAWS: u64 = 200;
        const HALF: usize = 1000;
        for degrees in [3, 6] {
            let ratio = |seed: u64| {
                let mut stream = Stream::new(seed, StreamId { owner: 1, effect: degrees, instance: 0 });
                let mut draw = || {
                    let chi: f64 = (0..degrees).map(|_| stream.normal().powi(2)).sum();
                    stream.normal() / (chi / f64::from(degrees)).sqrt()
                };
                let values: Vec<f64> = (0..2 * HALF).map(|_| draw()).collect();
                let mut ratio = 1.0f64;
                for _ in 0..20 {
                    let divided = |(at, value): (usize, &f64)| if at < HALF { value / ratio.sqrt() } else { *value };
                    let scores = normal_scores(&values.iter().enumerate().map(divided).collect::<Vec<f64>>());
                    let square = |of: &[f64]| of.iter().map(|e| (e * e).min(LARGEST)).sum::<f64>();
                    ratio *= square(&scores[..HALF]) / square(&scores[HALF..]);
                }
                ratio.ln().powi(2)
            };
            let variance = (0..DRAWS).map(ratio).sum::<f64>() / DRAWS as f64;
            // The mean square of n normal values has a relative variance of 2/n.
            let over_normal = variance / (2.0 * 2.0 / HALF as f64);
            let over_stated = over_normal / of_scores(f64::from(degrees));
            assert!((0.6..1.25).contains(&over_stated), "{degrees}: {over_stated}");
        }
    }
}
