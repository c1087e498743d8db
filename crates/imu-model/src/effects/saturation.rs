//! Saturation of a channel: no sample is sent beyond its limits.

use super::described::effect;
use super::spec::ANY;
use super::{At, Effect, Record, Refusal, Sampler, Stage, Stream, each};

effect! {
    /// Values beyond a limit become the limit, motion and noise alike.
    ///
    /// Its effect on spectrum and Allan variance depends on how often the other noise and the motion reach a limit: `None`.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Saturation: dyn Effect, 0, Stage::Saturation, Samples;
    "values beyond a limit become the limit";
    low: f64 = ANY, "U", "lowest value, U";
    high: f64 = ANY, "U", "highest value, U; above `low`";
}

impl Effect for Saturation {
    fn check_at(&self, _rate_hz: f64) -> Result<(), Refusal> {
        if self.low < self.high {
            return Ok(());
        }
        Err(Self::SPEC.refuse("high", self.high, format!("a number above `low`, {}", self.low)))
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
        let Self { low, high } = *self;
        each(move |value| *value = value.max(low).min(high))
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
