//! White noise (N): angle random walk of a gyroscope, velocity random walk of an accelerometer.

use super::{Effect, Sampler, Stream};

/// White noise with two-sided PSD N².
///
/// Source: IEEE Std 952-1997, annex C (angle random walk).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct White {
    /// N in U/√Hz.
    pub n: f64,
}

impl Effect for White {
    fn name(&self) -> &'static str {
        "white"
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> f64 {
        self.n * self.n
    }
    fn allan_variance(&self, m: u64, rate_hz: f64) -> f64 {
        self.n * self.n * rate_hz / m as f64
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        Box::new(WhiteSampler { sigma: self.n * rate_hz.sqrt(), stream })
    }
}

/// Independent normal values of standard deviation N/√dt.
#[derive(Debug)]
struct WhiteSampler {
    sigma: f64,
    stream: Stream,
}

impl Sampler for WhiteSampler {
    fn apply(&mut self, values: &mut [f64]) {
        for value in values {
            *value += self.sigma * self.stream.normal();
        }
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
