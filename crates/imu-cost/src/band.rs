//! Bands: the value that an error's size stays below with a probability of 95 %.
//!
//! The error is a mean plus a normal part, sines of random phase, and spikes. With the normal part alone the equation
//! is solved directly. Otherwise the symmetric part's characteristic function is the product of those of its parts:
//! e^(−σ²s²/2), J0(a s) per sine of peak a, and for spikes the exponential of Σ ln(1 + p(ψ(w_k s) − 1)), with ψ the
//! characteristic function of one cluster's spikes. It is inverted by the sum of Gil-Pelaez (Biometrika 38, 1951).
//!
//! Validation: `sines_have_the_quantiles_of_the_arcsine_law`, `bands_hold_as_much_as_they_promise` (Monte Carlo).

use crate::weights::{Span, factorial};
use statrs::function::erf::erfc;
use std::f64::consts::{PI, SQRT_2};

/// The probability that a band holds.
const HELD: f64 = 0.95;
/// 95 % quantiles of a standard normal number: of its size, and of itself.
const TWO_SIDED: f64 = 1.959_963_984_540_054;
const ONE_SIDED: f64 = 1.644_853_626_951_472;
/// Parts that are not normal count from this share of the variance on.
const MATERIAL: f64 = 1e-3;
/// The least normal part, as a part of the standard deviation: it rounds the edges of a sine's distribution.
const LEAST: f64 = 4e-3;
/// Beyond this many standard deviations of the normal part, a characteristic function is 0.
const REACH: f64 = 5.5;
/// A smaller standard deviation counts as 0.
const TINY: f64 = 1e-140;
/// Standard deviations of a mean beyond which only one side of the distribution counts.
const FAR: f64 = 8.0;

/// Spikes in an integral: `weight(k)` times a size, at random samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spiky {
    /// Probability per sensor's own sample that a cluster begins.
    pub begins: f64,
    /// Probability that a cluster goes on.
    pub goes_on: f64,
    /// Typical size times the integral's scale and factor; sizes spread evenly over half to one and a half of it.
    pub amplitude: f64,
    /// The sensor's own samples that a sent one averages and no other does.
    pub averaged: f64,
    pub span: Span,
    pub order: usize,
    /// Variance in the integral.
    pub variance: f64,
}

impl Spiky {
    /// Returns the logarithm of the characteristic function at `s`.
    fn log(&self, s: f64) -> f64 {
        let scale = s * self.amplitude / self.averaged;
        let cluster = |weight: f64| {
            let x = (weight * scale).abs();
            // Of a size spread evenly over 0.5 … 1.5 and a random sign.
            let one = if x < 1e-4 { 1.0 - x * x * 13.0 / 24.0 } else { ((1.5 * x).sin() - (0.5 * x).sin()) / x };
            let whole = one * (1.0 - self.goes_on) / (1.0 - self.goes_on * one);
            (self.begins * (whole - 1.0)).ln_1p()
        };
        let level = self.span.horizon.powi(self.order as i32) / factorial(self.order);
        let align = self.span.align * cluster(level / self.span.align);
        // The weights of the horizon are a power of the time left: the sum over them is an integral.
        const PARTS: usize = 24;
        let below = factorial(self.order - 1);
        let part = |k: usize| {
            let left = self.span.horizon * (k as f64 + 0.5) / PARTS as f64;
            cluster(left.powi(self.order as i32 - 1) / below)
        };
        let parts = if self.order == 1 { PARTS as f64 * part(0) } else { (0..PARTS).map(part).sum::<f64>() };
        self.averaged * (align + self.span.horizon * parts / PARTS as f64)
    }
}

/// The distribution of an error.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Distribution {
    pub mean: f64,
    /// Variance of the normal part.
    pub normal: f64,
    /// Peaks of sines.
    pub sines: Vec<f64>,
    pub spikes: Vec<Spiky>,
}

impl Distribution {
    /// Returns the variance about the mean.
    pub(crate) fn variance(&self) -> f64 {
        self.normal + self.others()
    }

    /// Returns the variance of the parts that are not normal.
    fn others(&self) -> f64 {
        let sines: f64 = self.sines.iter().map(|peak| 0.5 * peak * peak).sum();
        sines + self.spikes.iter().map(|of| of.variance).sum::<f64>()
    }

    /// Returns the size that the error does not exceed with a probability of 95 %.
    pub(crate) fn band95(&self) -> f64 {
        let sigma = self.variance().max(0.0).sqrt();
        // Squares of such numbers are below the smallest one.
        if sigma < TINY {
            return self.mean.abs();
        }
        if self.others() <= MATERIAL * sigma * sigma {
            return normal_band(self.mean.abs(), sigma);
        }
        let left_out = (self.mean.abs() - FAR * sigma).max(0.0);
        let mean = self.mean.abs() - left_out;
        left_out + self.inverted(mean, sigma)
    }

    /// Solves for the band by the characteristic function, for a `mean` of at most [`FAR`] `sigma`.
    fn inverted(&self, mean: f64, sigma: f64) -> f64 {
        let normal = self.normal.max((LEAST * sigma).powi(2));
        // A sum at multiples of the step repeats the distribution after 2π/step: far enough to see one alone.
        let step = 2.0 * PI / (2.0 * mean + 24.0 * sigma);
        let count = (REACH / (normal.sqrt() * step)).ceil() as usize;
        let points: Vec<(f64, f64)> = (0..count)
            .map(|k| {
                let s = (k as f64 + 0.5) * step;
                let sines: f64 = self.sines.iter().map(|peak| libm::j0(peak * s)).product();
                let spikes: f64 = self.spikes.iter().map(|of| of.log(s)).sum();
                let characteristic = sines * (spikes - 0.5 * normal * s * s).exp();
                (s, characteristic * (mean * s).cos() / (k as f64 + 0.5))
            })
            .collect();
        let held = |band: f64| 2.0 / PI * points.iter().map(|(s, size)| size * (band * s).sin()).sum::<f64>();
        // Chebyshev: no more than a twentieth lies beyond √20 standard deviations.
        bisect(0.0, mean + 4.5 * sigma, |band| held(band) < HELD)
    }
}

/// Returns the band of a normal error of mean `mean` (0 or more) and standard deviation `sigma` (above 0).
fn normal_band(mean: f64, sigma: f64) -> f64 {
    let beyond = |z: f64| 0.5 * erfc(z / SQRT_2);
    let outside = |band: f64| beyond((band - mean) / sigma) + beyond((band + mean) / sigma);
    let low = (TWO_SIDED * sigma).max(mean + ONE_SIDED * sigma);
    bisect(low.min(mean + TWO_SIDED * sigma), mean + TWO_SIDED * sigma, |band| outside(band) > 1.0 - HELD)
}

/// Returns where a condition that holds below ends.
fn bisect(mut low: f64, mut high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if holds(middle) {
            low = middle
        } else {
            high = middle
        }
        if high - low < 1e-9 * high {
            break;
        }
    }
    0.5 * (low + high)
}

/// Returns the size that 95 of 100 values do not exceed.
pub(crate) fn empirical(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let place = HELD * (sizes.len() as f64 - 1.0).max(0.0);
    let at = |index: usize| sizes.get(index).copied().unwrap_or_default();
    let (below, above) = (at(place.floor() as usize), at(place.ceil() as usize));
    below + (above - below) * place.fract()
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    #[test]
    fn normal_errors_have_their_tabled_quantiles() {
        let band = |mean: f64, normal: f64| Distribution { mean, normal, ..Distribution::default() }.band95();
        assert!((band(0.0, 4.0) - 2.0 * TWO_SIDED).abs() < 1e-6);
        assert!((band(-100.0, 1.0) - (100.0 + ONE_SIDED)).abs() < 1e-6);
        // P(|1 + z| ≤ b) = 0.95.
        assert!((band(1.0, 1.0) - 2.646_232).abs() < 1e-3, "{}", band(1.0, 1.0));
        assert_eq!((band(3.0, 0.0), band(0.0, 0.0)), (3.0, 0.0));
    }

    #[test]
    fn sines_have_the_quantiles_of_the_arcsine_law() {
        let one = Distribution { sines: vec![2.0], ..Distribution::default() };
        // sin(0.95·π/2).
        assert!((one.band95() / (2.0 * (0.475 * PI).sin()) - 1.0).abs() < 0.006, "{}", one.band95());
        // With a small normal part: by the mean over all phases.
        let both = Distribution { mean: 0.5, normal: 0.04, sines: vec![1.0], ..Distribution::default() };
        let band = both.band95();
        let beyond = |z: f64| 0.5 * erfc(z / SQRT_2);
        let outside = |phase: f64| {
            let centre = 0.5 + phase.sin();
            beyond((band - centre) / 0.2) + beyond((band + centre) / 0.2)
        };
        let mean = (0..10_000).map(|k| outside(2.0 * PI * f64::from(k) / 10_000.0)).sum::<f64>() / 10_000.0;
        assert!((mean - 0.05).abs() < 1e-5, "{mean}");
    }

    #[test]
    fn bands_hold_as_much_as_they_promise() {
        let span = Span { align: 20.0, horizon: 100.0 };
        let probability = 0.02_f64;
        for order in 1..=3 {
            let weights = crate::weights::listed(order, span);
            let variance = weights.iter().map(|w| w * w).sum::<f64>() * probability * 9.0 * 13.0 / 12.0;
            let spikes =
                Spiky { begins: probability, goes_on: 0.0, amplitude: 3.0, averaged: 1.0, span, order, variance };
            let sine = 0.5 * variance.sqrt();
            let of = Distribution {
                mean: 0.3 * variance.sqrt(),
                normal: 0.05 * variance,
                sines: vec![sine],
                spikes: vec![spikes],
            };
            let band = of.band95();
            let mut stream = Stream::new(order as u64, StreamId { owner: 0, effect: 1, instance: 0 });
            let runs = 40_000;
            let inside = (0..runs).filter(|_| {
                let phase = 2.0 * PI * stream.uniform();
                let mut value = of.mean + of.normal.sqrt() * stream.normal() + sine * phase.sin();
                for weight in &weights {
                    if stream.uniform() < probability {
                        let size = 3.0 * (0.5 + stream.uniform());
                        value += weight * if stream.uniform() < 0.5 { size } else { -size };
                    }
                }
                value.abs() <= band
            });
            let share = inside.count() as f64 / f64::from(runs);
            // Five standard errors.
            assert!((share - 0.95).abs() < 0.0055, "{order}: {share}");
        }
    }
}
