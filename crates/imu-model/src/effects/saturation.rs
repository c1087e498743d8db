//! Saturation of a channel: no sample is sent beyond its limits.

use super::spec::{Kind, Range, number};
use super::stream::number as streams;
use super::{At, Effect, Record, Refusal, Sampler, Spec, Stage, Stream, Temperature};
use serde_json::Value;
use std::sync::Arc;

/// Values beyond a limit become the limit, motion and noise alike.
///
/// Its effect on spectrum and Allan variance depends on how often the other noise and the motion reach a limit: `None`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Saturation {
    /// Lowest value, U.
    pub low: f64,
    /// Highest value, U.
    pub high: f64,
}

static SPEC: Spec = Spec {
    name: "saturation",
    stream: streams::NONE,
    stage: Stage::Saturation,
    parameters: &[
        number("low", Range::Any, "lowest value, U"),
        number("high", Range::Any, "highest value, U; above `low`"),
    ],
    forms: &[],
    meaning: "values beyond a limit become the limit",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| Arc::new(Saturation { low: values.number("low"), high: values.number("high") }),
};

impl Effect for Saturation {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("low", self.low.into()), ("high", self.high.into())]
    }
    fn check_at(&self, _rate_hz: f64) -> Result<(), Refusal> {
        if self.low < self.high {
            return Ok(());
        }
        Err(SPEC.refuse("high", self.high, format!("a number above `low`, {}", self.low)))
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        None
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        None
    }
    fn mean_response(&self, input: f64, _at: At) -> f64 {
        input.max(self.low).min(self.high)
    }
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        Box::new(Clip { low: self.low, high: self.high })
    }
}

/// The limits.
#[derive(Debug)]
struct Clip {
    low: f64,
    high: f64,
}

impl Sampler for Clip {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        for value in values {
            *value = value.max(self.low).min(self.high);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn values_end_at_the_limits() {
        let limits = Saturation { low: -1.0, high: 0.5 };
        let values = check::draw_on_white(&limits, 40.0, 1_000_000, 5);
        assert!(values.iter().all(|value| (-1.0..=0.5).contains(value)));
        // Of normal values, 15.8655 % lie below −1 and 30.8538 % above 0.5.
        for (limit, share) in [(-1.0, 0.158_655), (0.5, 0.308_538)] {
            let at = values.iter().filter(|value| **value == limit).count() as f64 / 1e6;
            assert!((at - share).abs() < 5.0 * (share * (1.0 - share) / 1e6_f64).sqrt(), "{limit}: {at}");
        }
        let at = At { time_s: 0.0, temperature_c: 25.0 };
        assert_eq!([-3.0, 0.2, 3.0].map(|input| limits.mean_response(input, at)), [-1.0, 0.2, 0.5]);
    }

    #[test]
    fn limits_in_the_wrong_order_are_refused() {
        assert!(Saturation { low: 1.0, high: 1.0 }.check(40.0).is_err());
        assert!(Saturation { low: f64::NEG_INFINITY, high: 1.0 }.check(40.0).is_err());
    }
}
