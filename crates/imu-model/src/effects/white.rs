//! White noise (N): angle random walk of a gyroscope, velocity random walk of an accelerometer.

use super::described::effect;
use super::spec::FROM_ZERO;
use super::{Effect, Moments, Record, Sampler, Stage, Stream, Temperature, each};

effect! {
    /// White noise with two-sided PSD N².
    ///
    /// Source: IEEE Std 952-1997, annex C (angle random walk).
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct White: dyn Effect, 1, Stage::Noise;
    "white noise, two-sided density N²";
    n as "N": f64 = FROM_ZERO, "U/√Hz", "N in U/√Hz";
}

impl Effect for White {
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(self.n * self.n)
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        Some(self.n * self.n * record.rate_hz / m as f64)
    }
    fn moments(&self, record: Record) -> Option<Moments> {
        Some(Moments { variance: self.n * self.n * record.rate_hz, kurtosis: Some(3.0) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let sigma = self.n * rate_hz.sqrt();
        each(move |value| *value += sigma * stream.normal())
    }
}

impl White {
    /// Returns a filter's sampler that adds this noise to the filter's output.
    pub(super) fn after(
        self,
        filter: Box<dyn Sampler>,
        rate_hz: f64,
        record_length_s: f64,
        stream: Stream,
    ) -> Box<dyn Sampler> {
        if self.n > 0.0 { Box::new(InTurn([filter, self.sampler(rate_hz, record_length_s, stream)])) } else { filter }
    }
}

/// Samplers that act one after the other.
#[derive(Debug)]
struct InTurn([Box<dyn Sampler>; 2]);

impl Sampler for InTurn {
    fn act(&mut self, values: &mut [f64], temperature: Temperature<'_>) {
        self.0.iter_mut().for_each(|sampler| sampler.act(values, temperature));
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_and_allan_variance_are_those_of_white_noise() {
        check::agrees_with_its_closed_forms(&White { n: 0.0021 }, 40.0);
    }

    #[test]
    fn the_sample_deviation_is_n_over_root_dt() {
        let values = check::draw(&White { n: 0.5 }, 16.0, 200_000, 3);
        let variance = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
        // Expected 0.25·16 = 4 with relative standard error √(2/n) = 0.32 %.
        assert!((variance / 4.0 - 1.0).abs() < 5.0 * 0.0032, "{variance}");
    }
}
