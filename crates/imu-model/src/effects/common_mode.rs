//! Common mode: noise that several channels share, such as that of a supply.

use super::described::effect;
use super::spec::ANY;
use super::{Effect, Moments, Record, Sampler, Scope, Stage, Stream, each};

effect! {
    /// White noise that is the same on all channels that name it, times the `sigma` of each.
    ///
    /// A negative `sigma` is noise of the opposite sign. The first common modes of all channels share one source, the
    /// second ones another, and so on.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct CommonMode: dyn Effect, 12, Stage::Noise, White;
    "white noise shared by the channels that name it";
    sigma: f64 = ANY, "U", "root mean square per sample, U; negative: with the opposite sign";
}

impl Effect for CommonMode {
    fn scope(&self) -> Scope {
        Scope::Sensor
    }
    fn psd(&self, _frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        Some(self.sigma * self.sigma / rate_hz)
    }
    fn allan_variance(&self, m: u64, _record: Record) -> Option<f64> {
        Some(self.sigma * self.sigma / m as f64)
    }
    fn moments(&self, _record: Record) -> Option<Moments> {
        Some(Moments { variance: self.sigma * self.sigma, kurtosis: Some(3.0) })
    }
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let sigma = self.sigma;
        each(move |value| *value += sigma * stream.normal())
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_white_noise() {
        check::agrees_with_its_closed_forms(&CommonMode { sigma: -0.4 }, 40.0);
    }
}
