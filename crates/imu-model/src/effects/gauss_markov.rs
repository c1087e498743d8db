//! Gauss-Markov noise: exponentially correlated, the hump of an Allan curve.

use super::described::effect;
use super::spec::{FROM_ZERO, above};
use super::{Effect, Frequencies, Moments, Record, Sampler, Stage, Stream, each, sampled};
use std::f64::consts::PI;

effect! {
    /// A first-order Gauss-Markov process with autocovariance σ²·exp(−|t|/Tc), sampled; it starts in its stationary state.
    ///
    /// With φ = exp(−dt/Tc): two-sided PSD σ²(1 − φ²)dt/(1 + φ² − 2φ cos 2πf·dt), which is 2σ²Tc/(1 + (2πfTc)²) far below
    /// half the rate. Source: IEEE Std 952-1997, annex C (exponentially correlated noise, with qc² Tc/2 = σ²).
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct GaussMarkov: dyn Effect, 4, Stage::Noise, Coloured;
    "exponentially correlated noise";
    sigma: f64 = FROM_ZERO, "U", "root mean square, U";
    tc_s: f64 = above(0.0), "s", "correlation time, s";
}

/// Returns the two-sided spectrum, per Hz, of a sampled first-order process of variance 1 with decay dt/Tc = `decay`
/// per sample, at `cycles` per sample; `decay` may be arbitrarily small.
pub(super) fn lorentzian(cycles: f64, decay: f64, rate_hz: f64) -> f64 {
    Lorentzian::new(decay, rate_hz).at((PI * cycles).sin())
}

/// The frequency-independent numbers of [`lorentzian`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Lorentzian {
    least: f64,
    slope: f64,
    level: f64,
    per_hz: f64,
}

impl Lorentzian {
    pub(super) fn new(decay: f64, rate_hz: f64) -> Self {
        // 1 + φ² − 2φ cos ω = (1 − φ)² + 4φ sin²(ω/2).
        let (least, slope) = ((-decay).exp_m1().powi(2), 4.0 * (-decay).exp());
        Self { least, slope, level: -(-2.0 * decay).exp_m1() / rate_hz, per_hz: 1.0 / rate_hz }
    }

    /// Returns the density, from the sine of half an angle per sample.
    pub(super) fn at(&self, half: f64) -> f64 {
        self.level / (self.least + self.slope * half * half)
    }

    /// Returns the density of e^(−decay·|k|)·sin ω₀|k|, if this is the density of e^(−decay·|k|)·cos ω₀k: the spectrum
    /// of its odd part, from sine and cosine of half an angle per sample.
    pub(super) fn odd_at(&self, sine: f64, cosine: f64) -> f64 {
        self.per_hz * self.slope * sine * cosine / (self.least + self.slope * sine * sine)
    }
}

impl Effect for GaussMarkov {
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        Some(self.sigma * self.sigma * lorentzian(frequency_hz / rate_hz, 1.0 / (rate_hz * self.tc_s), rate_hz))
    }
    fn densities(&self, frequencies: &Frequencies) -> Vec<f64> {
        let rate_hz = frequencies.rate_hz();
        let line = Lorentzian::new(1.0 / (rate_hz * self.tc_s), rate_hz);
        frequencies.map(|half| self.sigma * self.sigma * line.at(half.sine))
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let decay = 1.0 / (record.rate_hz * self.tc_s);
        Some(self.sigma * self.sigma * sampled::allan_variance(m, |k| -(-decay * k as f64).exp_m1()))
    }
    fn moments(&self, _record: Record) -> Option<Moments> {
        Some(Moments { variance: self.sigma * self.sigma, kurtosis: Some(3.0) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let decay = 1.0 / (rate_hz * self.tc_s);
        let (pole, drive) = ((-decay).exp(), self.sigma * (-(-2.0 * decay).exp_m1()).sqrt());
        let mut state = self.sigma * stream.normal();
        each(move |value| {
            *value += state;
            state = pole * state + drive * stream.normal();
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_the_process() {
        for tc_s in [0.05, 3.0] {
            check::agrees_with_its_closed_forms(&GaussMarkov { sigma: 0.02, tc_s }, 40.0);
        }
    }

    #[test]
    fn the_allan_variance_is_the_standards_for_long_correlations() {
        // σ²·(T/τ)²·(2τ/T − 3 + 4e^(−τ/T) − e^(−2τ/T)), IEEE Std 952 (continuous time).
        let process = GaussMarkov { sigma: 1.0, tc_s: 10.0 };
        for m in [1000_u64, 10_000, 100_000] {
            let x = m as f64 / 100.0 / 10.0;
            let standard = (2.0 * x - 3.0 + 4.0 * (-x).exp() - (-2.0 * x).exp()) / (x * x);
            let found = process.allan_variance(m, Record { rate_hz: 100.0, samples: 1_000_000 }).unwrap();
            assert!((found / standard - 1.0).abs() < 1e-3, "m = {m}: {found} {standard}");
        }
    }
}
