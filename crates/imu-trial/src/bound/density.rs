//! Additive noise with a separate density: Whittle's likelihood.

use std::f64::consts::{PI, TAU};

/// Number of points of the integral over the whole band, evenly spread in the logarithm of the frequency, and about a
/// peak.
const POINTS: usize = 160;
/// Halvings of the interval between two bounds.
const HALVINGS: usize = 30;

/// Returns frequencies in cycles per sample from half the first coefficient of `samples` to ½, denser about a peak's
/// middle and width.
pub(super) fn frequencies(samples: usize, peak: Option<(f64, f64)>) -> Vec<f64> {
    let from = 0.25 / samples as f64;
    let mut found: Vec<f64> =
        (0..=POINTS).map(|point| from * (0.5 / from).powf(point as f64 / POINTS as f64)).collect();
    if let Some((middle, width)) = peak {
        // Quantiles of Cauchy's law: equal numbers of points for equal parts of a resonance's power.
        let about = (1..POINTS).map(|point| middle + 0.5 * width * (PI * (point as f64 / POINTS as f64 - 0.5)).tan());
        found.extend(about.filter(|cycles| (from..0.5).contains(cycles)));
        found.sort_by(f64::total_cmp);
    }
    found
}

/// Integrates over these frequencies by trapezia.
fn integral(frequencies: &[f64], values: impl Fn(usize) -> f64) -> f64 {
    let mut before = values(0);
    (1..frequencies.len())
        .map(|at| {
            let now = values(at);
            let part = 0.5 * (now + before) * (frequencies[at] - frequencies[at - 1]);
            before = now;
            part
        })
        .sum()
}

/// Returns the nats that noise of density `added` on top of `base` is worth if the white part's size has to be fitted,
/// because no model has it right: n ∫₀^½ (ρ − 1 − ln ρ) df with ρ = (S₀ + A)/(S₀ + ν), minimal over ν ≥ 0. One value
/// per frequency, per sample.
///
/// # Source
/// P. Whittle, Ark. Mat. 2 (1953) 423: the likelihood; S. Kullback, *Information Theory and Statistics* (1959), chapter
/// 9: its expectation, the divergence of two Gaussian processes.
pub(super) fn nats(samples: usize, frequencies: &[f64], base: &[f64], added: &[f64]) -> f64 {
    let (mut low, mut high) = (0.0, added.iter().copied().fold(0.0, f64::max));
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        // The derivative's sign: there is too little white noise if the missing part exceeds the surplus part, each
        // over its variance.
        let missing = integral(frequencies, |at| (added[at] - middle) / (base[at] + middle).powi(2));
        if missing > 0.0 { low = middle } else { high = middle }
    }
    let white = 0.5 * (low + high);
    let divergence = |at: usize| {
        let excess = (added[at] - white) / (base[at] + white);
        excess - excess.ln_1p()
    };
    samples as f64 * integral(frequencies, divergence)
}

/// Returns the nats that noise common to several channels is worth through the correlation between them:
/// n ∫₀^½ [Σ ln(1 + aᵢ²/Sᵢ) − ln(1 + Σ aᵢ²/Sᵢ)] df, −½ ln det of the correlations of every coefficient. `ratios` are
/// aᵢ²/Sᵢ per channel, one per frequency. The noise added to each single channel is worth 0 nats, because the model's N is
/// not that well known.
///
/// # Source
/// T. W. Anderson, *An Introduction to Multivariate Statistical Analysis* (2003), section 9.2: tests of independence; the
/// determinant of diagonal and rank one.
pub(super) fn shared_nats(samples: usize, frequencies: &[f64], ratios: &[Vec<f64>]) -> f64 {
    let divergence = |at: usize| {
        let apart: f64 = ratios.iter().map(|of| of[at].ln_1p()).sum();
        apart - ratios.iter().map(|of| of[at]).sum::<f64>().ln_1p()
    };
    samples as f64 * integral(frequencies, divergence)
}

/// Returns the density of the differences of white angle noise of standard deviation `size`.
pub(super) fn angle(size: f64, cycles: f64) -> f64 {
    size * size * 4.0 * (PI * cycles).sin().powi(2)
}

/// Returns the density of a Gauss–Markov process of standard deviation `size` and time constant `tau`, samples: AR(1).
pub(super) fn markov(size: f64, tau: f64, cycles: f64) -> f64 {
    let pole = (-1.0 / tau).exp();
    size * size * (1.0 - pole * pole) / (1.0 + pole * pole - 2.0 * pole * (TAU * cycles).cos())
}

/// Returns the density of an AR(2) process of standard deviation `size` with poles of this radius and angle (cycles per
/// sample).
///
/// # Source
/// G. Box, G. Jenkins, *Time Series Analysis* (1976), 3.2.28 and 3.2.29.
pub(super) fn resonance(size: f64, radius: f64, middle: f64, cycles: f64) -> f64 {
    let (first, second) = (2.0 * radius * (TAU * middle).cos(), radius * radius);
    let variance = (1.0 + second) / ((1.0 - second) * ((1.0 + second).powi(2) - first * first));
    let (cos, sin) = ((TAU * cycles).cos(), (TAU * cycles).sin());
    // 1 − φ₁ e^{−iω} + r² e^{−2iω}.
    let real = 1.0 - first * cos + second * (2.0 * cos * cos - 1.0);
    let imaginary = first * sin - second * 2.0 * sin * cos;
    size * size / variance / (real * real + imaginary * imaginary)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLES: usize = 20_000;

    #[test]
    fn densities_have_their_variance() {
        for (name, density) in [
            ("angle", Box::new(|cycles| angle(2.0, cycles)) as Box<dyn Fn(f64) -> f64>),
            ("markov", Box::new(|cycles| markov(2.0, 50.0, cycles))),
            ("resonance", Box::new(|cycles| resonance(2.0, 0.99, 0.21, cycles))),
        ] {
            let at = frequencies(SAMPLES, Some((0.21, 0.01 / PI)));
            let values: Vec<f64> = at.iter().map(|cycles| density(*cycles)).collect();
            // Angle noise of variance 4 has differences of variance 8.
            let expected = if name == "angle" { 8.0 } else { 4.0 };
            let variance = 2.0 * integral(&at, |at| values[at]);
            assert!((variance / expected - 1.0).abs() < 0.01, "{name}: {variance}");
        }
    }

    #[test]
    fn white_noise_on_top_of_white_noise_is_worth_nothing_and_other_noise_what_whittle_predicts() {
        let at = frequencies(SAMPLES, None);
        let base = vec![1.0; at.len()];
        let white = nats(SAMPLES, &at, &base, &vec![0.05; at.len()]);
        assert!(white.abs() < 1e-9, "{white}");
        // Weak angle noise: the excess 4q² sin² πf has mean 2q² and variance 2q⁴ over the band; the worth is n/4 of
        // that.
        let q = 0.1_f64;
        let added: Vec<f64> = at.iter().map(|cycles| angle(q, *cycles)).collect();
        let found = nats(SAMPLES, &at, &base, &added);
        let expected = SAMPLES as f64 / 4.0 * 2.0 * q.powi(4);
        assert!((found / expected - 1.0).abs() < 0.06, "{found} for {expected}");
    }

    #[test]
    fn two_channels_that_share_noise_are_worth_what_their_correlation_is() {
        let at = frequencies(SAMPLES, None);
        let ratios = vec![vec![0.04; at.len()]; 2];
        let correlation: f64 = 0.04 / 1.04;
        let expected = -0.5 * SAMPLES as f64 * (1.0 - correlation * correlation).ln();
        let found = shared_nats(SAMPLES, &at, &ratios);
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} for {expected}");
    }
}
