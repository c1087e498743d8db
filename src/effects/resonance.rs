//! Resonance: noise in a narrow band, such as a structure that rings.

use super::gauss_markov::Lorentzian;
use super::spec::{Kind, Range, number};
use super::stream::number as streams;
use super::{Effect, Moments, Record, Refusal, Sampler, Spec, Stage, Stream, Temperature, sampled};
use serde_json::Value;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Narrow-band noise whose spectrum has a Lorentzian line at ± its frequency.
///
/// A damped oscillation that white noise drives, in both quadratures: autocovariance σ²·exp(−πw|t|)·cos(2πf₀t) with w the
/// full width at half power, exact at the samples, stationary from the start. Its frequency and damping hold at any rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resonance {
    /// Centre, Hz.
    pub frequency_hz: f64,
    /// Full width at half power, Hz.
    pub bandwidth_hz: f64,
    /// Root mean square, U.
    pub sigma: f64,
}

pub(super) static SPEC: Spec = Spec {
    name: "resonance",
    stream: streams::RESONANCE,
    stage: Stage::Noise,
    parameters: &[
        number("frequency_hz", Range::Above(0.0), "centre, Hz; below half the rate at which it acts"),
        number("bandwidth_hz", Range::Above(0.0), "full width at half power, Hz"),
        number("sigma", Range::FromZero, "root mean square, U"),
    ],
    forms: &[],
    meaning: "noise in a narrow band, with a Lorentzian line",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| {
        Arc::new(Resonance {
            frequency_hz: values.number("frequency_hz"),
            bandwidth_hz: values.number("bandwidth_hz"),
            sigma: values.number("sigma"),
        })
    },
};

impl Resonance {
    /// Decay of the amplitude per sample.
    fn decay(&self, rate_hz: f64) -> f64 {
        PI * self.bandwidth_hz / rate_hz
    }
}

impl Effect for Resonance {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![
            ("frequency_hz", self.frequency_hz.into()),
            ("bandwidth_hz", self.bandwidth_hz.into()),
            ("sigma", self.sigma.into()),
        ]
    }
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        SPEC.below_nyquist("frequency_hz", self.frequency_hz, rate_hz)
    }
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        self.densities(&[frequency_hz], rate_hz).first().copied()
    }
    fn densities(&self, frequencies_hz: &[f64], rate_hz: f64) -> Vec<f64> {
        let line = Lorentzian::new(self.decay(rate_hz), rate_hz);
        let (own_sine, own_cosine) = (PI * self.frequency_hz / rate_hz).sin_cos();
        let half_power = 0.5 * self.sigma * self.sigma;
        let at = |frequency_hz: &f64| {
            let (sine, cosine) = (PI * frequency_hz / rate_hz).sin_cos();
            let (near, far) = (sine * own_cosine - cosine * own_sine, sine * own_cosine + cosine * own_sine);
            half_power * (line.at(near) + line.at(far))
        };
        frequencies_hz.iter().map(at).collect()
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let decay = self.decay(record.rate_hz);
        let step = PI * self.frequency_hz / record.rate_hz;
        // 1 − e^(−ak) cos 2xk = (1 − e^(−ak)) + 2 e^(−ak) sin² xk.
        let structure = |k: u64| {
            let k = k as f64;
            -(-decay * k).exp_m1() + 2.0 * (-decay * k).exp() * (step * k).sin().powi(2)
        };
        Some(self.sigma * self.sigma * sampled::allan_variance(m, structure))
    }
    fn moments(&self, _record: Record) -> Option<Moments> {
        Some(Moments { variance: self.sigma * self.sigma, kurtosis: Some(3.0) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let decay = self.decay(rate_hz);
        let (sine, cosine) = (TAU * self.frequency_hz / rate_hz).sin_cos();
        let state = [self.sigma * stream.normal(), self.sigma * stream.normal()];
        Box::new(ResonanceSampler {
            turn: [(-decay).exp() * cosine, (-decay).exp() * sine],
            drive: self.sigma * (-(-2.0 * decay).exp_m1()).sqrt(),
            state,
            stream,
        })
    }
}

/// The oscillation's two quadratures, and how they turn and shrink per sample.
#[derive(Debug)]
struct ResonanceSampler {
    turn: [f64; 2],
    drive: f64,
    state: [f64; 2],
    stream: Stream,
}

impl Sampler for ResonanceSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        let [cosine, sine] = self.turn;
        for value in values {
            let [x, y] = self.state;
            *value += x;
            self.state = [
                cosine * x - sine * y + self.drive * self.stream.normal(),
                sine * x + cosine * y + self.drive * self.stream.normal(),
            ];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_the_line() {
        for bandwidth_hz in [0.1, 2.0] {
            check::agrees_with_its_closed_forms(&Resonance { frequency_hz: 7.3, bandwidth_hz, sigma: 0.4 }, 40.0);
        }
    }

    #[test]
    fn the_line_has_half_its_height_at_half_its_width() {
        let line = Resonance { frequency_hz: 100.0, bandwidth_hz: 2.0, sigma: 1.0 };
        let ratio = line.psd(101.0, 800.0).unwrap() / line.psd(100.0, 800.0).unwrap();
        assert!((ratio - 0.5).abs() < 1e-3, "{ratio}");
    }
}
