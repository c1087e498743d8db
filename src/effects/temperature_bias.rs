//! Temperature bias: a level that follows the sensor's temperature.

use super::spec::{Kind, Range, number};
use super::stream::number as streams;
use super::{At, Effect, Record, Sampler, Spec, Stage, Stream, Temperature};
use serde_json::Value;
use std::sync::Arc;

/// A bias of `per_c`·(T − `reference_c`).
///
/// Its Allan variance is that of the temperature's course times `per_c`², which no parameter says: `None`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemperatureBias {
    /// U/°C.
    pub per_c: f64,
    /// The temperature at which it vanishes, °C.
    pub reference_c: f64,
}

static SPEC: Spec = Spec {
    name: "temperature_bias",
    stream: streams::NONE,
    stage: Stage::Bias,
    parameters: &[
        number("per_c", Range::Any, "slope, U/°C"),
        number("reference_c", Range::Above(-273.15), "the temperature at which it vanishes, °C"),
    ],
    forms: &[],
    meaning: "a bias proportional to the sensor's temperature",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| {
        Arc::new(TemperatureBias { per_c: values.number("per_c"), reference_c: values.number("reference_c") })
    },
};

impl Effect for TemperatureBias {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("per_c", self.per_c.into()), ("reference_c", self.reference_c.into())]
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        None
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        None
    }
    fn mean_response(&self, input: f64, at: At) -> f64 {
        input + self.per_c * (at.temperature_c - self.reference_c)
    }
    fn regressors(&self) -> usize {
        1
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        row[0] = at.temperature_c - self.reference_c;
    }
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        Box::new(TemperatureSampler(*self))
    }
}

#[derive(Debug)]
struct TemperatureSampler(TemperatureBias);

impl Sampler for TemperatureSampler {
    fn act(&mut self, values: &mut [f64], temperature: Temperature<'_>) {
        for (index, value) in values.iter_mut().enumerate() {
            *value += self.0.per_c * (temperature.at(index) - self.0.reference_c);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn the_level_follows_the_temperature() {
        let effect = TemperatureBias { per_c: -0.02, reference_c: 20.0 };
        let temperatures: Vec<f64> = (0..500).map(|i| 15.0 + 0.1 * f64::from(i)).collect();
        let mut values = vec![1.0; 500];
        effect.sampler(40.0, 1.0, check::stream(1)).act(&mut values, Temperature::Series(&temperatures));
        let mut row = [0.0];
        for (value, temperature_c) in values.iter().zip(temperatures) {
            let at = At { time_s: 0.0, temperature_c };
            effect.regress(at, &mut row);
            assert!((value - effect.mean_response(1.0, at)).abs() < 1e-14);
            assert!((value - 1.0 - effect.per_c * row[0]).abs() < 1e-14);
        }
        assert!((values[0] - 1.1).abs() < 1e-14);
    }
}
