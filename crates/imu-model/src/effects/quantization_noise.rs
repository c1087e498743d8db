//! Quantization noise (Q): independent errors of the angle (or velocity), so that the rate shows their differences.

use super::described::effect;
use super::spec::FROM_ZERO;
use super::{Effect, Frequencies, Moments, Record, Sampler, Stage, Stream, each};
use std::f64::consts::PI;

effect! {
    /// White angle noise of standard deviation Q per sample.
    ///
    /// The rate is the difference of this noise over one period dt: two-sided PSD 4Q² sin²(πf·dt)/dt, Allan variance
    /// 3Q²/τ² exactly.
    ///
    /// Source: IEEE Std 952-1997, annex C (quantization noise), in sampled form.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct QuantizationNoise: dyn Effect, 8, Stage::Noise, Coloured;
    "IEEE's quantization noise: white noise of the angle or velocity, seen in the rate";
    q as "Q": f64 = FROM_ZERO, "U·s", "standard deviation of the white angle noise, U·s";
}

impl Effect for QuantizationNoise {
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        let sine = 2.0 * (PI * frequency_hz / rate_hz).sin();
        Some(self.q * self.q * sine * sine * rate_hz)
    }
    fn densities(&self, frequencies: &Frequencies) -> Vec<f64> {
        frequencies.map(|half| self.q * self.q * 4.0 * half.sine * half.sine * frequencies.rate_hz())
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        Some(3.0 * (self.q * record.rate_hz / m as f64).powi(2))
    }
    fn moments(&self, record: Record) -> Option<Moments> {
        Some(Moments { variance: 2.0 * (self.q * record.rate_hz).powi(2), kurtosis: Some(3.0) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let scale = self.q * rate_hz;
        let mut last = scale * stream.normal();
        each(move |value| {
            let error = scale * stream.normal();
            *value += error - last;
            last = error;
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_white_angle_noise() {
        check::agrees_with_its_closed_forms(&QuantizationNoise { q: 3e-5 }, 200.0);
    }
}
