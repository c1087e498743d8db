//! Timing: stamps that scatter, samples that get lost.

use super::spec::{Form, Kind, Need, Parameter, Range};
use super::stream::number as streams;
use super::{Effect, Record, Refusal, Sampler, Scope, Spec, Stage, Stream, Temperature};
use serde_json::Value;
use std::sync::Arc;

/// Stamps with jitter, and samples lost on the way; the values are left alone. It concerns the whole sensor: one channel
/// that names it is enough.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Standard deviation of the stamps, s. Deviations end at 0.49 periods, so that stamps keep their order.
    pub jitter_s: f64,
    /// That a sample is lost.
    pub drop_probability: f64,
}

/// Stamps may deviate by this part of a period at most.
pub(crate) const DEVIATION_MAX: f64 = 0.49;
/// And their standard deviation may be this part of a period at most, so that deviations are seldom cut.
pub const JITTER_MAX: f64 = 0.2;

static SPEC: Spec = Spec {
    name: "timing",
    stream: streams::TIMING,
    stage: Stage::Timing,
    parameters: &[
        Parameter {
            name: "jitter_s",
            form: Form::Number(Range::FromZero),
            need: Need::Default(0.0),
            meaning: "standard deviation of the stamps, s; at most a fifth of the output's period",
        },
        Parameter {
            name: "drop_probability",
            form: Form::Number(Range::Probability),
            need: Need::Default(0.0),
            meaning: "that a sample is lost",
        },
    ],
    forms: &[],
    meaning: "stamps that scatter and samples that get lost; concerns the whole sensor",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| {
        Arc::new(Timing { jitter_s: values.number("jitter_s"), drop_probability: values.number("drop_probability") })
    },
};

impl Timing {
    /// The stamp's deviation in s, from a standard normal number.
    pub fn deviation_s(&self, normal: f64, rate_hz: f64) -> f64 {
        let most = DEVIATION_MAX / rate_hz;
        (self.jitter_s * normal).clamp(-most, most)
    }
}

impl Effect for Timing {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("jitter_s", self.jitter_s.into()), ("drop_probability", self.drop_probability.into())]
    }
    fn scope(&self) -> Scope {
        Scope::Sensor
    }
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        let most_s = JITTER_MAX / rate_hz;
        if self.jitter_s <= most_s {
            return Ok(());
        }
        let allowed = format!("at most {most_s} s, a fifth of the period at {rate_hz} Hz");
        Err(SPEC.refuse("jitter_s", format!("{} s", self.jitter_s), allowed))
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        Some(0.0)
    }
    fn timing(&self) -> Option<Timing> {
        Some(*self)
    }
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        Box::new(Untouched)
    }
}

/// The values are as they were.
#[derive(Debug)]
struct Untouched;

impl Sampler for Untouched {
    fn act(&mut self, _values: &mut [f64], _temperature: Temperature<'_>) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_keep_their_order() {
        let timing = Timing { jitter_s: 0.005, drop_probability: 0.0 };
        assert_eq!(timing.deviation_s(1.0, 40.0), 0.005);
        assert_eq!(timing.deviation_s(-1e9, 40.0), -0.49 / 40.0);
        assert!(timing.check(40.0).is_ok());
    }

    #[test]
    fn jitter_beyond_a_fifth_of_the_period_is_refused() {
        let refusal = Timing { jitter_s: 0.006, drop_probability: 0.0 }.check(40.0).unwrap_err().to_string();
        assert!(refusal.contains("`jitter_s`: found 0.006 s; allowed is at most 0.005 s"), "{refusal}");
        assert!(Timing { jitter_s: 0.0, drop_probability: 1.0 }.check(40.0).is_err());
    }
}
