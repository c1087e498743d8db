//! Ends: the contribution of a stretch's ends to the expected squares of noise that a filter correlates.
//!
//! Let d be the differences of a stretch of n samples, D their autocovariance, and θ = πk/n the angle of a coefficient
//! of the DST-I. Then exactly E z² = Σ D(l) cos lθ − (1/n) Σ D(l) g(|l|) over l from −n to n, with g(l) = l cos lθ −
//! cot θ sin lθ. The first sum is the spectrum. The second one is the contribution of the ends; it vanishes if D ends
//! at l = 1, as for white noise. With R the autocovariance of the samples, the second sum for the power, z²/4
//! sin²(θ/2), is (1/n) times −2 Σ R(l) (l cos lθ + sin lθ / sin θ) over l from 1 on.
//!
//! # Validation
//! `tests` compare both forms with the covariance matrix itself.

use super::shape::Shape;
use super::sums::DstSums;
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Number of intervals of u from 0 to 1/2.
const GRID: usize = 2048;
/// Number of lags of a filter's autocovariance.
const LAGS: usize = 1024;
/// Number of lags of a record's own autocovariance: more are mostly chance.
const OWN_LAGS: usize = 64;

/// The excess of the power of white noise behind a filter over its gain, times the stretch's length.
#[derive(Debug)]
pub(super) struct Excess {
    /// Values at u = place/2/GRID.
    grid: Vec<f64>,
}

impl Excess {
    /// Computes the excess for a filter; `None` if it does not correlate white noise.
    pub(super) fn of(shape: &Shape) -> Option<Self> {
        if *shape == Shape::Open {
            return None;
        }
        let mut planner = RealFftPlanner::<f64>::new();
        let inverse = planner.plan_fft_inverse(2 * GRID);
        let gain = |place: usize| shape.gains(0.5 * place as f64 / GRID as f64).white;
        let mut spectrum: Vec<Complex<f64>> = (0..=GRID).map(|place| Complex::new(gain(place), 0.0)).collect();
        let mut covariance = inverse.make_output_vec();
        inverse.process(&mut spectrum, &mut covariance).ok()?;
        let covariance = |lag: usize| covariance.get(lag).map_or(0.0, |sum| sum / (2.0 * GRID as f64));
        let forward = planner.plan_fft_forward(2 * GRID);
        let transformed = |of: &dyn Fn(usize) -> f64| {
            let mut lags = forward.make_input_vec();
            lags.iter_mut().enumerate().take(LAGS).skip(1).for_each(|(lag, value)| *value = of(lag));
            let mut sums = forward.make_output_vec();
            forward.process(&mut lags, &mut sums).ok().map(|()| sums)
        };
        let cosines = transformed(&|lag| lag as f64 * covariance(lag))?;
        let sines = transformed(&covariance)?;
        // At both ends, sin lθ / sin θ is ±l.
        let at_end =
            |sign: f64| (1..LAGS).map(|lag| -(sign.powi(lag as i32)) * lag as f64 * covariance(lag)).sum::<f64>();
        let ratio = |place: usize, sum: f64| match place {
            0 => -at_end(1.0),
            GRID => at_end(-1.0),
            _ => -sum / (PI * place as f64 / GRID as f64).sin(),
        };
        let excess = |(place, (cosine, sine)): (usize, (&Complex<f64>, &Complex<f64>))| {
            -2.0 * (cosine.re + ratio(place, sine.im))
        };
        Some(Self { grid: cosines.iter().zip(&sines).enumerate().map(excess).collect() })
    }

    /// Returns the excess at u cycles per sample.
    pub(super) fn at(&self, u: f64) -> f64 {
        let place = (2.0 * GRID as f64 * u).clamp(0.0, GRID as f64);
        let below = (place as usize).min(GRID - 1);
        let part = place - below as f64;
        let of = |place: usize| self.grid.get(place).copied().unwrap_or(0.0);
        of(below) * (1.0 - part) + of(below + 1) * part
    }
}

/// The autocovariance of a record's differences.
#[derive(Debug)]
pub(super) struct Own {
    lags: Vec<f64>,
}

impl Own {
    /// Computes the autocovariance from the record's spectrum.
    pub(super) fn of(sums: &DstSums) -> Self {
        let mut lags = vec![0.0; OWN_LAGS];
        for ([low, high], bin) in sums.finely_filled() {
            // z², two-sided.
            let weight = 2.0 * (high - low) * (bin.power / bin.count) * (bin.count / bin.walk);
            for (lag, cosine) in lags.iter_mut().zip(cosines(0.5 * TAU * (low + high))) {
                *lag += weight * cosine;
            }
        }
        Self { lags }
    }

    /// Returns the contribution of a stretch's ends to z² at u cycles per sample, times the stretch's length.
    pub(super) fn excess(&self, u: f64) -> f64 {
        let theta = TAU * u;
        let over = theta.cos() / theta.sin().max(1e-9);
        let terms = self.lags.iter().zip(cosines(theta)).zip(sines(theta)).enumerate().skip(2);
        -2.0 * terms.map(|(lag, ((own, cosine), sine))| own * (lag as f64 * cosine - over * sine)).sum::<f64>()
    }
}

/// Returns cos lθ for l from 0 on.
fn cosines(theta: f64) -> impl Iterator<Item = f64> {
    turned(theta, 1.0, theta.cos())
}

/// Returns sin lθ for l from 0 on.
fn sines(theta: f64) -> impl Iterator<Item = f64> {
    turned(theta, 0.0, theta.sin())
}

/// Returns the terms of Chebyshev's recurrence.
fn turned(theta: f64, first: f64, second: f64) -> impl Iterator<Item = f64> {
    let twice = 2.0 * theta.cos();
    std::iter::successors(Some((first, second)), move |(one, other)| Some((*other, twice * other - one)))
        .map(|(own, _)| own)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns E z²/(4 sin²(πu)) of coefficient k of a stretch of n samples with this autocovariance, from the
    /// covariance matrix of its differences.
    fn exact(covariance: impl Fn(usize) -> f64, n: usize, k: usize) -> f64 {
        let of_difference = |lag: usize| 2.0 * covariance(lag) - covariance(lag + 1) - covariance(lag.abs_diff(1));
        let theta = PI * k as f64 / n as f64;
        let basis = |at: usize| (2.0 / n as f64).sqrt() * (at as f64 * theta).sin();
        let mut sum = 0.0;
        for one in 1..n {
            for other in 1..n {
                sum += basis(one) * basis(other) * of_difference(one.abs_diff(other));
            }
        }
        sum / (4.0 * (0.5 * theta).sin().powi(2))
    }

    #[test]
    fn what_ends_add_is_that_of_the_covariance_matrix() {
        let n = 60;
        let boxcar = |lag: usize| if lag < 4 { (4.0 - lag as f64) / 16.0 } else { 0.0 };
        let a: f64 = 0.6;
        let exponential = |lag: usize| a / (2.0 - a) * (1.0 - a).powi(lag as i32);
        let c = 1.0 - a * a / (2.0 * (1.0 - a));
        let shapes: [(Shape, &dyn Fn(usize) -> f64); 2] =
            [(Shape::MovingAverage(4), &boxcar), (Shape::Exponential { cutoff: c.acos() / TAU }, &exponential)];
        for (shape, covariance) in shapes {
            let excess = Excess::of(&shape).unwrap();
            for k in [1, 2, 7, 15, 29, 31, 44, 58, 59] {
                let u = 0.5 * k as f64 / n as f64;
                let expected = shape.gains(u).white + excess.at(u) / n as f64;
                let found = exact(covariance, n, k);
                assert!((expected - found).abs() < 2e-5, "{shape:?} {k}: {expected} for {found}");
            }
        }
        assert!(Excess::of(&Shape::Open).is_none());
    }

    #[test]
    fn a_records_own_spectrum_has_the_excess_of_its_filter() {
        use super::super::{DstEstimator, Transform};
        use crate::allan::FixedPoint;
        use rand::SeedableRng as _;
        use rand_distr::{Distribution as _, StandardNormal};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let white: Vec<f64> = (0..400_003).map(|_| StandardNormal.sample(&mut rng)).collect();
        let means: Vec<f64> = white.windows(4).map(|four| 0.25 * four.iter().sum::<f64>()).collect();
        let (mut estimator, mut transform) =
            (DstEstimator::new(FixedPoint::for_range(1, 6).unwrap()), Transform::default());
        estimator.push(&mut transform, &means);
        let own = Own::of(&estimator.into_sums(&mut transform));
        let excess = Excess::of(&Shape::MovingAverage(4)).unwrap();
        for u in [0.05, 0.1, 0.2, 0.3, 0.4, 0.48] {
            let expected = excess.at(u) * 4.0 * (PI * u).sin().powi(2);
            // The scatter of 400,000 samples.
            assert!((own.excess(u) - expected).abs() < 0.4, "{u}: {} for {expected}", own.excess(u));
        }
    }
}
