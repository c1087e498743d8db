//! Warm-up: the bias after switching on, dying away.

use super::spec::{Kind, Range, number};
use super::stream::number as streams;
use super::{At, Effect, Record, Sampler, Spec, Stage, Stream, Temperature};
use serde_json::Value;
use std::sync::Arc;

/// A bias of A·exp(−t/τ), A at the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WarmUp {
    /// At the start, U; signed.
    pub amplitude: f64,
    /// Time to fall to 1/e, s.
    pub tau_s: f64,
}

static SPEC: Spec = Spec {
    name: "warm_up",
    stream: streams::NONE,
    stage: Stage::Bias,
    parameters: &[
        number("amplitude", Range::Any, "bias at the start, U; signed"),
        number("tau_s", Range::Above(0.0), "time to fall to 1/e, s"),
    ],
    forms: &[],
    meaning: "a bias that dies away exponentially from the start",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| Arc::new(WarmUp { amplitude: values.number("amplitude"), tau_s: values.number("tau_s") }),
};

impl Effect for WarmUp {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("amplitude", self.amplitude.into()), ("tau_s", self.tau_s.into())]
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    /// With r = exp(−dt/τ) the averages from sample i on differ by A·rⁱ(1 − rᵐ)²/(m(1 − r)); half its mean square over the
    /// record, in closed form.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let starts = record.samples.checked_sub(2 * m).filter(|_| m > 0)? as f64 + 1.0;
        let decay = 1.0 / (record.rate_hz * self.tau_s);
        let m = m as f64;
        let first = (-decay * m).exp_m1().powi(2) / (m * (-decay).exp_m1());
        let mean_square = (-2.0 * decay * starts).exp_m1() / (-2.0 * decay).exp_m1() / starts;
        Some(0.5 * (self.amplitude * first).powi(2) * mean_square)
    }
    fn mean_response(&self, input: f64, at: At) -> f64 {
        input + self.amplitude * (-at.time_s / self.tau_s).exp()
    }
    fn regressors(&self) -> usize {
        1
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        row[0] = (-at.time_s / self.tau_s).exp();
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        Box::new(WarmUpSampler { amplitude: self.amplitude, decay: 1.0 / (rate_hz * self.tau_s), index: 0 })
    }
}

/// The next sample's index, and the bias's parameters.
#[derive(Debug)]
struct WarmUpSampler {
    amplitude: f64,
    decay: f64,
    index: u64,
}

impl Sampler for WarmUpSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        for value in values {
            *value += self.amplitude * (-self.decay * self.index as f64).exp();
            self.index += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn allan_variance_and_course_are_those_of_an_exponential() {
        for tau_s in [1.0, 60.0, 1e5] {
            check::agrees_with_its_closed_forms(&WarmUp { amplitude: -0.3, tau_s }, 40.0);
        }
    }
}
