//! Noise identification: the dominant power law at an averaging time. The degrees of freedom depend on it.
//!
//! Two estimates are used, each in the range in which it is more precise. The slope of the overlapping Allan variance
//! over an octave on both sides separates white rate, flicker and random walk from each other, and all of them from
//! angle noise. It needs only the sums and uses every term: with r₁, r₂ the autocorrelations of second differences at
//! lags m and 2m, σ²(2m)/σ²(m) = (6 + 8 r₁ + 2 r₂)/4. It cannot separate white from flicker angle noise, whose Allan
//! variances are both proportional to τ⁻². In that case, the lag-1 autocorrelation of the phases separates them, if the
//! samples are available. Used alone, the lag-1 autocorrelation takes one phase in m, identifies averaged flicker as a
//! random walk, and decimated flicker angle noise as white (`lag_1_alone_mistakes_both_flickers`).
//!
//! # Source
//! W. J. Riley and C. A. Greenhall, "Power law noise identification using the lag 1 autocorrelation", 18th EFTF (2004); NIST
//! SP1065 (2008), section 5.5.6.

use super::point::noise_by_slope;
use super::{AllanPoint, Estimator, NoiseType, Phases, SquareSum};

/// Minimum number of averages for which the lag-1 autocorrelation separates white from flicker angle noise in 95 % of
/// records.
const LEAST: usize = 100;
/// Minimum number of points for which the autocorrelation is computed at all (SP1065).
const STATED: usize = 30;
/// The limit between the exponents that the lag-1 autocorrelation gives for flicker angle noise (0.5 to 1.5) and for
/// white angle noise (2 ± 0.2 at [`LEAST`]).
const BETWEEN: f64 = 1.6;
/// Up to these averaging factors, the slope of flicker angle noise may look like that of white rate noise.
const UNSURE: usize = 4;
/// Maximum number of differences: Allan's variance converges down to α = −2.
const DIFFERENCES: i32 = 2;

/// The lag-1 autocorrelation estimate for a series of phases.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lag1 {
    /// Exponent of the rate's spectrum, not rounded.
    pub(super) alpha: f64,
    /// Number of differences taken until the series was stationary.
    pub(super) differences: i32,
    /// r₁/(1 + r₁) of the differences.
    pub(super) rho: f64,
}

impl Lag1 {
    /// Estimates from stretches of phases, which are pooled. `None` with fewer than 30 points in the longest stretch,
    /// or without variation.
    pub(super) fn of(stretches: impl IntoIterator<Item = Vec<f64>>) -> Option<Self> {
        let mut series: Vec<Vec<f64>> = stretches.into_iter().filter(|stretch| stretch.len() >= STATED).collect();
        // An offset of the rate and its drift are not noise.
        series.iter_mut().for_each(|stretch| remove_parabola(stretch));
        for differences in 0..=DIFFERENCES {
            let r1 = autocorrelation(&series)?;
            let rho = r1 / (1.0 + r1);
            if rho < 0.25 || differences == DIFFERENCES {
                let alpha = 2.0 - 2.0 * (rho + f64::from(differences));
                return alpha.is_finite().then_some(Self { alpha, differences, rho });
            }
            for stretch in &mut series {
                *stretch = stretch.windows(2).map(|pair| pair[1] - pair[0]).collect();
            }
        }
        None
    }
}

/// Returns the lag-1 autocorrelation of stretches, each with its own mean.
fn autocorrelation(series: &[Vec<f64>]) -> Option<f64> {
    let (mut products, mut squares) = (0.0, 0.0);
    for stretch in series {
        let mean = stretch.iter().sum::<f64>() / stretch.len() as f64;
        products += stretch.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean)).sum::<f64>();
        squares += stretch.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
    }
    (squares > 0.0).then(|| products / squares)
}

/// Subtracts the least-squares parabola, by polynomials that are orthogonal on evenly spaced points.
fn remove_parabola(values: &mut [f64]) {
    let count = values.len() as f64;
    let middle = (count - 1.0) / 2.0;
    let bend = (count * count - 1.0) / 12.0;
    let basis: [&dyn Fn(f64) -> f64; 3] = [&|_| 1.0, &|t| t, &|t| t * t - bend];
    for of in basis {
        let (mut dot, mut norm) = (0.0, 0.0);
        for (index, value) in values.iter().enumerate() {
            let base = of(index as f64 - middle);
            dot += value * base;
            norm += base * base;
        }
        if norm > 0.0 {
            for (index, value) in values.iter_mut().enumerate() {
                *value -= dot / norm * of(index as f64 - middle);
            }
        }
    }
}

/// Returns the dominant noise at each averaging factor, from samples in memory. `factors` are ascending.
pub(super) fn noise_of_phases(segments: &[Phases], factors: &[usize]) -> Vec<NoiseType> {
    let largest = factors.last().copied().unwrap_or(0);
    // Octaves suffice: the power law does not change between neighbouring averaging times of a dense grid.
    let octaves: Vec<AllanPoint> = std::iter::successors(Some(1usize), |m| m.checked_mul(2))
        .take_while(|m| *m <= largest)
        .filter_map(|m| octave(segments, m))
        .collect();
    let mut kinds = noise_by_slope(&octaves);
    let mut flicker = false;
    for (point, kind) in octaves.iter().zip(&mut kinds) {
        // The shortest averaging times of flicker angle noise are less steep than longer ones.
        let unsure = *kind == NoiseType::WhiteRate && point.m <= UNSURE;
        if *kind != NoiseType::WhiteAngle && !unsure {
            continue;
        }
        // Phases are averaged, not decimated: decimation folds flicker's spectrum until it looks white.
        let averages = segments.iter().map(|phases| phases.averages(point.m)).filter(|means| means.len() >= LEAST);
        let found = Lag1::of(averages);
        if unsure {
            // Averages of white rate's phases give −0.3, those of flicker angle noise 0.5; at m = 1 the values are 0
            // and 1.
            let least = if point.m == 1 { 0.5 } else { 0.1 };
            flicker = found.is_some_and(|found| (least..BETWEEN).contains(&found.alpha));
        } else if let Some(found) = found {
            flicker = found.alpha < BETWEEN;
        }
        if flicker {
            *kind = NoiseType::FlickerAngle;
        }
    }
    let nearest = |m: usize| {
        let distance = |point: &AllanPoint| (point.m as f64 / m as f64).ln().abs();
        octaves.iter().zip(&kinds).min_by(|(one, _), (other, _)| distance(one).total_cmp(&distance(other)))
    };
    factors.iter().map(|m| nearest(*m).map_or(NoiseType::WhiteRate, |(_, kind)| *kind)).collect()
}

fn octave(segments: &[Phases], m: usize) -> Option<AllanPoint> {
    let sums = segments.iter().map(|phases| phases.square_sum(Estimator::Oadev, m)).filter(|sum| sum.terms > 0);
    let (total, count) = sums.fold((SquareSum::default(), 0), |(total, count), sum| (total.plus(sum), count + 1));
    let variance = total.deviation()?.powi(2);
    Some(AllanPoint { m, variance, terms: total.terms, segments: count, stride: 1 })
}
