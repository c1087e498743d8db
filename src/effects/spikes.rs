//! Spikes: single samples far off.

use super::spec::{Kind, Range, number};
use super::stream::number as streams;
use super::{Effect, Moments, Record, Refusal, Sampler, Spec, Stage, Stream, Temperature};
use serde_json::Value;
use std::sync::Arc;

/// Single samples that are off by about `amplitude`, at random times.
///
/// Each sample has one with probability `rate_hz`/rate, of random sign, its size evenly spread over half to one and a half
/// times `amplitude` (mean and median are `amplitude`). The spectrum is white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spikes {
    /// How many there are per second on average.
    pub rate_hz: f64,
    /// Typical size, U.
    pub amplitude: f64,
}

static SPEC: Spec = Spec {
    name: "spikes",
    stream: streams::SPIKES,
    stage: Stage::Noise,
    parameters: &[
        number("rate_hz", Range::FromZero, "spikes per second on average; up to the rate at which they act"),
        number("amplitude", Range::FromZero, "typical size, U; sizes spread evenly from half of it to one and a half"),
    ],
    forms: &[],
    meaning: "single samples far off, at random times and with random sign",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| Arc::new(Spikes { rate_hz: values.number("rate_hz"), amplitude: values.number("amplitude") }),
};

/// Mean square and fourth moment of a number spread evenly over 0.5 … 1.5.
const SQUARE: f64 = 13.0 / 12.0;
const FOURTH: f64 = 1.5125;

impl Spikes {
    /// Variance of a sample at `rate_hz`.
    fn variance(&self, rate_hz: f64) -> f64 {
        SQUARE * self.amplitude * self.amplitude * self.rate_hz / rate_hz
    }
}

impl Effect for Spikes {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("rate_hz", self.rate_hz.into()), ("amplitude", self.amplitude.into())]
    }
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        if self.rate_hz <= rate_hz {
            return Ok(());
        }
        let allowed = format!("at most {rate_hz} spikes per second, one for every sample");
        Err(SPEC.refuse("rate_hz", format!("{} Hz", self.rate_hz), allowed))
    }
    fn psd(&self, _frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        Some(self.variance(rate_hz) / rate_hz)
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        Some(self.variance(record.rate_hz) / m as f64)
    }
    fn moments(&self, record: Record) -> Option<Moments> {
        let kurtosis = FOURTH / (SQUARE * SQUARE) * record.rate_hz / self.rate_hz;
        Some(Moments { variance: self.variance(record.rate_hz), kurtosis: kurtosis.is_finite().then_some(kurtosis) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        Box::new(SpikeSampler { probability: self.rate_hz / rate_hz, amplitude: self.amplitude, stream })
    }
}

#[derive(Debug)]
struct SpikeSampler {
    probability: f64,
    amplitude: f64,
    stream: Stream,
}

impl Sampler for SpikeSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        for value in values {
            if self.stream.uniform() < self.probability {
                let size = self.amplitude * (0.5 + self.stream.uniform());
                *value += if self.stream.uniform() < 0.5 { size } else { -size };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_spikes() {
        check::agrees_with_its_closed_forms(&Spikes { rate_hz: 0.7, amplitude: 5.0 }, 40.0);
    }

    #[test]
    fn their_number_and_median_size_are_the_parameters() {
        let values = check::draw(&Spikes { rate_hz: 0.5, amplitude: 3.0 }, 100.0, 1_000_000, 4);
        let mut sizes: Vec<f64> = values.iter().filter(|value| **value != 0.0).map(|value| value.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        // 5000 expected; five standard deviations are 353.
        assert!((sizes.len() as f64 - 5000.0).abs() < 353.0, "{}", sizes.len());
        assert!((sizes[sizes.len() / 2] - 3.0).abs() < 0.11);
        assert!(sizes[0] >= 1.5 && sizes[sizes.len() - 1] <= 4.5);
        let positive = values.iter().filter(|value| **value > 0.0).count() as f64;
        assert!((positive / sizes.len() as f64 - 0.5).abs() < 5.0 * 0.0071);
    }

    #[test]
    fn more_spikes_than_samples_are_refused() {
        assert!(Spikes { rate_hz: 41.0, amplitude: 1.0 }.check(40.0).is_err());
        assert!(Spikes { rate_hz: 1.0, amplitude: -1.0 }.check(40.0).is_err());
    }
}
