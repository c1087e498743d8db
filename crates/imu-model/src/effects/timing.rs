//! Timing: stamps that scatter, and samples that are lost.

use super::described::effect;
use super::spec::{FROM_ZERO, Need, PROBABILITY};
use super::{Effect, Record, Refusal, Sampler, Scope, Stage, Stream, each};

effect! {
    /// Stamps with jitter, and samples lost on the way; the values stay unchanged. The effect concerns the whole
    /// sensor: one channel that names it is enough.
    ///
    /// Deviations of stamps are limited to 0.49 periods, so that stamps keep their order.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Timing: dyn Effect, 14, Stage::Timing;
    "stamps that scatter and samples that get lost; concerns the whole sensor";
    jitter_s: f64 = FROM_ZERO, "s",
        "standard deviation of the stamps, s; at most a fifth of the output's period", Need::Default(0.0);
    drop_probability: f64 = PROBABILITY, "", "that a sample is lost", Need::Default(0.0);
}

/// The largest deviation of a stamp, as a part of a period.
pub(crate) const DEVIATION_MAX: f64 = 0.49;
/// The largest standard deviation of stamps, as a part of a period, so that deviations are seldom limited.
pub const JITTER_MAX: f64 = 0.2;

/// The random stream of the lost samples.
pub const LOSS_STREAM: u16 = 15;

impl Timing {
    /// Returns the stamp's deviation in s, from a standard normal number.
    pub fn deviation_s(&self, normal: f64, rate_hz: f64) -> f64 {
        let most = DEVIATION_MAX / rate_hz;
        (self.jitter_s * normal).clamp(-most, most)
    }
}

impl Effect for Timing {
    fn scope(&self) -> Scope {
        Scope::Sensor
    }
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        let most_s = JITTER_MAX / rate_hz;
        if self.jitter_s <= most_s {
            return Ok(());
        }
        let allowed = format!("at most {most_s} s, a fifth of the period at {rate_hz} Hz");
        Err(Self::SPEC.refuse("jitter_s", format!("{} s", self.jitter_s), allowed))
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
        each(|_| {})
    }
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
