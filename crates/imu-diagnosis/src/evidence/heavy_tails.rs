//! Heavy tails: the distribution of a residual whose white part has Student's t, and the search for such tails.
//!
//! A residual holds a white sample as a whole only if there is nothing else. Slow noise, lines and noise behind a filter
//! take a part of the band; there the residual is theirs. What a white sample lacks at its own time is spread over many
//! samples, where it looks normal.

use super::{Candidate, Kind};
use crate::series::Series;
use statrs::function::gamma::ln_gamma;
use std::f64::consts::{PI, TAU};

/// The values that a white sample of 1 leaves in a residual, by their distance in time.
#[derive(Debug, Clone)]
pub(crate) struct Kernel(Vec<f64>);

impl Kernel {
    /// Returns the kernel of a series' residual.
    pub(crate) fn of(series: &Series<'_>) -> Self {
        const REACH: usize = 32;
        /// Averages of neighbouring coefficients, many more than [`REACH`].
        const BLOCKS: usize = 4096;
        let shares = series.white_shares();
        let n = shares.len().max(1) as f64;
        let size = shares.len().div_ceil(BLOCKS).max(1);
        let blocks: Vec<(f64, f64)> = shares
            .chunks(size)
            .enumerate()
            .map(|(at, of)| {
                let middle = (at * size) as f64 + 0.5 * (of.len() - 1) as f64;
                (PI * middle / n, of.iter().map(|share| f64::from(*share)).sum::<f64>() / n)
            })
            .collect();
        let at = |lag: usize| blocks.iter().map(|(turn, sum)| sum * (turn * lag as f64).cos()).sum();
        Self((0..REACH).map(at).collect())
    }

    /// Returns the factor on Student's t in the residual. Far out a sum of such values is distributed as one value times
    /// this; for 4 degrees of freedom the factor preserves the fourth cumulant.
    pub(crate) fn share(&self, degrees: f64) -> f64 {
        let powers = self.0.iter().enumerate().map(|(lag, value)| {
            let twice = if lag == 0 { 1.0 } else { 2.0 };
            twice * value.abs().powf(degrees)
        });
        powers.sum::<f64>().powf(1.0 / degrees).clamp(1e-3, 1.0)
    }
}

/// Student's t times a share, and normal noise up to a variance of 1.
#[derive(Debug, Clone)]
enum StudentT {
    /// Hardly any normal noise: the degrees of freedom, the square of the scale, and a constant.
    Whole { degrees: f64, scale: f64, constant: f64 },
    /// Student's t is normal noise whose variance is drawn: ln of the chance over the standard deviation, and one over
    /// the variance.
    Mixed(Vec<(f64, f64)>),
}

impl StudentT {
    /// A share that counts as whole.
    const WHOLE: f64 = 0.998;

    /// `degrees`: above 2; `share`: above 0, at most 1.
    fn new(degrees: f64, share: f64) -> Self {
        /// Places of ln χ² about its mean, in units of its standard deviation for many degrees of freedom. The left tail is
        /// long; with these steps the trapezoidal rule is exact to 1e-9.
        const STEP: f64 = 0.4;
        const PLACES: std::ops::RangeInclusive<i32> = -60..=16;
        if share > Self::WHOLE {
            let scale = (degrees - 2.0) / degrees;
            let gammas = ln_gamma(0.5 * (degrees + 1.0)) - ln_gamma(0.5 * degrees);
            return Self::Whole { degrees, scale, constant: gammas - 0.5 * (0.5 * degrees * scale).ln() };
        }
        let width = (2.0 / degrees).sqrt() * STEP;
        let constant = width.ln() - 0.5 * degrees * 2f64.ln() - ln_gamma(0.5 * degrees);
        let drawn = PLACES.map(|place| {
            let ln_chi = degrees.ln() + width * f64::from(place);
            let variance = 1.0 + share * share * ((degrees - 2.0) / ln_chi.exp() - 1.0);
            (constant + 0.5 * (degrees * ln_chi - ln_chi.exp()) - 0.5 * variance.ln(), 1.0 / variance)
        });
        Self::Mixed(drawn.collect())
    }

    /// Returns ln of the density at a value with this square, without −½ ln 2π.
    fn logarithm(&self, square: f64) -> f64 {
        match self {
            Self::Whole { degrees, scale, constant } => {
                constant - 0.5 * (degrees + 1.0) * (square / (degrees * scale)).ln_1p()
            }
            Self::Mixed(drawn) => {
                let of = |(logarithm, inverse): &(f64, f64)| logarithm - 0.5 * square * inverse;
                let greatest = drawn.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
                greatest + drawn.iter().map(|drawn| (of(drawn) - greatest).exp()).sum::<f64>().ln()
            }
        }
    }
}

/// Returns the standard error of ln ν for n samples with a free scale, from Fisher's information of both. It is that of
/// Lange, Little and Taylor 1989, J. Am. Stat. Assoc. 84, appendix B, if the residual holds the white samples as a whole.
pub(crate) fn error(degrees: f64, kernel: &Kernel, n: f64) -> f64 {
    /// Step of ln (ν − 2) and of ln of the scale, and points of the integral over half of the distribution.
    const STEP: f64 = 1e-3;
    const POINTS: usize = 1000;
    let tails = |degrees: f64| StudentT::new(degrees, kernel.share(degrees));
    let [more, less] = [STEP, -STEP].map(|by: f64| tails(2.0 + (degrees - 2.0) * by.exp()));
    let own = tails(degrees);
    let (mut both, mut of_degrees, mut of_scale) = (0.0, 0.0, 0.0);
    for point in 0..POINTS {
        // The whole axis: x = u/(1 − u).
        let u = (point as f64 + 0.5) / POINTS as f64;
        let square = (u / (1.0 - u)).powi(2);
        let weight = 2.0 * own.logarithm(square).exp() / (TAU.sqrt() * (1.0 - u).powi(2) * POINTS as f64);
        // The derivative by ln ν follows from that by ln (ν − 2).
        let a = degrees / (degrees - 2.0) * (more.logarithm(square) - less.logarithm(square)) / (2.0 * STEP);
        let moved = |by: f64| own.logarithm(square * (-2.0 * by).exp()) - by;
        let b = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
        of_degrees += weight * a * a;
        both += weight * a * b;
        of_scale += weight * b * b;
    }
    let information = of_degrees - both * both / of_scale;
    if information > 0.0 { (1.0 / (n * information)).sqrt() } else { 1.0 }
}

/// Squares in bins so fine that ln of a density is smooth in each: counts and mean squares.
struct Squares(Vec<(f64, f64)>);

impl Squares {
    /// Returns those of a series' residual. Replaced samples are normal, and those beside a stretch may belong to it.
    fn of_series(series: &Series<'_>) -> Self {
        let near = series.near_stretches();
        Self::of(series.there().filter(|(place, _)| !near[*place]).map(|(_, value)| value))
    }

    fn of(values: impl IntoIterator<Item = f64>) -> Self {
        const PER_UNIT: f64 = 24.0;
        let mut bins: Vec<(f64, f64)> = Vec::new();
        for value in values {
            let square = value * value;
            let bin = ((1.0 + square).ln() * PER_UNIT) as usize;
            if bin >= bins.len() {
                bins.resize(bin + 1, (0.0, 0.0));
            }
            bins[bin].0 += 1.0;
            bins[bin].1 += square;
        }
        Self(bins.into_iter().filter(|(count, _)| *count > 0.0).map(|(count, sum)| (count, sum / count)).collect())
    }

    fn sum(&self, of: impl Fn(f64) -> f64) -> f64 {
        self.0.iter().map(|(count, square)| count * of(*square)).sum()
    }

    /// Returns the nats that a distribution with a free scale gains over a normal one.
    fn gain(&self, tails: &StudentT) -> f64 {
        let n = self.sum(|_| 1.0);
        let plain = self.sum(|square| square) / n;
        let at = |scale: f64| self.sum(|square| tails.logarithm(square / plain * (-2.0 * scale).exp())) - n * scale;
        // The maximum is the vertex of a parabola.
        let mut scale = 0.0;
        for step in [0.5, 0.2, 0.05, 0.01] {
            let [below, here, above] = [scale - step, scale, scale + step].map(at);
            let bend = below + above - 2.0 * here;
            scale += step * if bend < 0.0 { (0.5 * (below - above) / bend).clamp(-3.0, 3.0) } else { 0.0 };
        }
        at(scale) + 0.5 * n
    }

    /// Returns the nats that Student's t gains over a normal distribution if the residual has the white samples as a
    /// whole, and its degrees of freedom if it has them by a kernel. The kernel is asked for only if there are such tails
    /// at all. A mixture of t and normal noise would fit spikes as well as their own law does, so its gain is no evidence.
    fn fit(&self, kernel: impl FnOnce() -> Kernel) -> (f64, f64) {
        const DEGREES: [f64; 12] = [2.2, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 25.0, 40.0, 60.0, 90.0, 140.0];
        /// Nats below which the degrees of freedom are hardly known.
        const ANY: f64 = 1.0;
        let whole = |degrees: f64| self.gain(&StudentT::new(degrees, 1.0));
        let starts = DEGREES.map(|degrees| (whole(degrees), degrees));
        let (gain, degrees) = starts.into_iter().fold(starts[0], |a, b| if b.0 > a.0 { b } else { a });
        if gain < ANY {
            return (gain, degrees);
        }
        let (gain, degrees) = highest(whole, (gain, degrees));
        let kernel = kernel();
        if kernel.share(degrees) > StudentT::WHOLE {
            return (gain, degrees);
        }
        let of = |degrees: f64| self.gain(&StudentT::new(degrees, kernel.share(degrees)));
        (gain, highest(of, (of(degrees), degrees)).1)
    }
}

/// Returns the greatest value of a function of the degrees of freedom near a start, and its place.
fn highest(of: impl Fn(f64) -> f64, start: (f64, f64)) -> (f64, f64) {
    const LEAST: f64 = 2.05;
    let (mut best, mut degrees) = start;
    for step in [0.4f64, 0.15, 0.05] {
        for _ in 0..6 {
            let sides = [-step, step].map(|by| degrees * by.exp()).map(|degrees| (of(degrees), degrees));
            let better = sides.into_iter().filter(|(value, degrees)| *value > best && *degrees > LEAST);
            let Some(better) = better.max_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            (best, degrees) = better;
        }
    }
    let step = 0.05f64;
    let [below, above] = [-step, step].map(|by| of((degrees * by.exp()).max(LEAST)));
    let bend = below + above - 2.0 * best;
    if bend < 0.0 {
        degrees = (degrees * (step * (0.5 * (below - above) / bend).clamp(-1.0, 1.0)).exp()).max(LEAST);
    }
    (best, degrees)
}

impl Series<'_> {
    /// Returns the nats by which Student's t of these degrees of freedom is denser than a normal distribution.
    pub(crate) fn nats_of_tails(&self, degrees: f64) -> f64 {
        let tails = StudentT::new(degrees, Kernel::of(self).share(degrees));
        Squares::of(self.innovations().iter().copied()).sum(|square| tails.logarithm(square) + 0.5 * square)
    }
}

/// Searches for Student's t tails.
pub(crate) fn heavy_tails(series: &Series<'_>) -> Option<Candidate> {
    let mut explanation = series.explanation.clone();
    if explanation.tails.is_some() {
        return None;
    }
    let squares = Squares::of_series(series);
    if squares.0.is_empty() {
        return None;
    }
    let (gain, degrees) = squares.fit(|| Kernel::of(series));
    explanation.tails = Some(degrees);
    Some(Candidate::missing(Kind::HeavyTails, gain, explanation))
}

/// Returns the degrees of freedom, and the standard error of their logarithm, if other channels share this part of the
/// white noise's variance, which is normal.
pub(crate) fn beside_shared(series: &Series<'_>, shared: f64) -> (f64, f64) {
    let own = (1.0 - shared).sqrt();
    let kernel = Kernel(Kernel::of(series).0.into_iter().map(|value| value * own).collect());
    let squares = Squares::of_series(series);
    let n = squares.sum(|_| 1.0);
    let (_, degrees) = squares.fit(|| kernel.clone());
    (degrees, error(degrees, &kernel, n))
}

/// Fits the degrees of freedom again, beside all effects that were found later.
pub(crate) fn fit_again(series: &mut Series<'_>) {
    let Some(before) = series.explanation.tails.take() else { return };
    let again = heavy_tails(series).and_then(|of| of.explanation.tails);
    series.explanation.tails = Some(again.unwrap_or(before));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_are_normalised_have_variance_1_and_are_that_of_student_alone() {
        for (degrees, share) in [(3.0, 1.0), (6.0, 0.9), (12.0, 0.6), (5.0, 0.2), (100.0, 0.95)] {
            const STEP: f64 = 0.01;
            let tails = StudentT::new(degrees, share);
            let (mut all, mut variance) = (0.0, 0.0);
            for step in -100_000..=100_000 {
                let x = STEP * f64::from(step);
                let density = tails.logarithm(x * x).exp() / TAU.sqrt() * STEP;
                all += density;
                variance += density * x * x;
            }
            assert!((all - 1.0).abs() < 1e-6, "{degrees} {share}: {all}");
            assert!((variance - 1.0).abs() < 3e-3, "{degrees} {share}: {variance}");
        }
        for degrees in [3.0, 5.0, 50.0] {
            let scale = (degrees - 2.0) / degrees;
            let constant =
                ln_gamma(0.5 * (degrees + 1.0)) - ln_gamma(0.5 * degrees) - 0.5 * (0.5 * degrees * scale).ln();
            for square in [0.0, 0.3, 2.0, 50.0] {
                let expected = constant - 0.5 * (degrees + 1.0) * (square / (degrees * scale)).ln_1p();
                let found = StudentT::new(degrees, StudentT::WHOLE).logarithm(square);
                assert!(
                    (found - expected).abs() < 0.005 * (1.0 + expected.abs()),
                    "{degrees} {square}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn the_error_of_whole_samples_is_that_of_the_closed_form() {
        let trigamma = |x: f64| {
            // Uses the recurrence up to where the asymptotic series is exact to 1e-10.
            let (mut x, mut sum) = (x, 0.0);
            while x < 20.0 {
                sum += 1.0 / (x * x);
                x += 1.0;
            }
            sum + 1.0 / x + 0.5 / (x * x) + 1.0 / (6.0 * x.powi(3)) - 1.0 / (30.0 * x.powi(5))
        };
        for nu in [3.0, 8.0, 30.0] {
            let of_degrees = 0.25 * (trigamma(0.5 * nu) - trigamma(0.5 * (nu + 1.0)))
                - 0.5 * (nu + 5.0) / (nu * (nu + 1.0) * (nu + 3.0));
            let (of_scale, both) = (2.0 * nu / (nu + 3.0), -2.0 / ((nu + 1.0) * (nu + 3.0)));
            let expected = (1.0 / (of_degrees - both * both / of_scale)).sqrt() / nu;
            let found = error(nu, &Kernel(vec![1.0]), 1.0);
            assert!((found / expected - 1.0).abs() < 0.02, "{nu}: {found} {expected}");
            assert!(error(nu, &Kernel(vec![0.9]), 1.0) > 1.1 * expected);
        }
    }
}
