//! Common mode: noise that several channels share, such as a supply's.

use super::spec::{Kind, Range, number};
use super::stream::number as streams;
use super::{Effect, Moments, Record, Sampler, Scope, Spec, Stage, Stream, Temperature};
use serde_json::Value;
use std::sync::Arc;

/// White noise that is the same on all channels that name it, times each one's `sigma`.
///
/// A negative `sigma` is noise of the opposite sign. A channel's second common mode is the second of every other channel:
/// the first, second… of all share one source each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommonMode {
    /// Root mean square per sample, U; its sign is the sign of the share.
    pub sigma: f64,
}

static SPEC: Spec = Spec {
    name: "common_mode",
    stream: streams::COMMON_MODE,
    stage: Stage::Noise,
    parameters: &[number("sigma", Range::Any, "root mean square per sample, U; negative: with the opposite sign")],
    forms: &[],
    meaning: "white noise shared by the channels that name it",
};
pub(super) static KIND: Kind<dyn Effect> =
    Kind { spec: &SPEC, make: |values| Arc::new(CommonMode { sigma: values.number("sigma") }) };

impl Effect for CommonMode {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("sigma", self.sigma.into())]
    }
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
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        Box::new(SharedSampler { sigma: self.sigma, stream })
    }
}

#[derive(Debug)]
struct SharedSampler {
    sigma: f64,
    stream: Stream,
}

impl Sampler for SharedSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
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
    fn spectrum_allan_variance_and_moments_are_those_of_white_noise() {
        check::agrees_with_its_closed_forms(&CommonMode { sigma: -0.4 }, 40.0);
    }
}
