//! Held samples: the sensor sends its last sample again.

use super::described::effect;
use super::spec::PROBABILITY;
use super::{Effect, Record, Sampler, Scope, Stage, Stream, each};
use std::f64::consts::TAU;

effect! {
    /// With this probability a sample repeats the one before it; all channels of the triad repeat together.
    ///
    /// One channel that names it is enough. White noise keeps its variance and has the power gain of
    /// [`HeldSamples::white_gain`]. For any other input, the outcome depends on its spectrum: psd and Allan variance
    /// are `None`.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct HeldSamples: dyn Effect, 13, Stage::Hold, Samples;
    "the sensor sends its last sample again; all channels of the triad repeat together"
        => "samples sent twice, {probability:.3e} of all,";
    probability: f64 = PROBABILITY, "", "that a sample is the one before it again";
}

impl HeldSamples {
    /// Returns the power gain for a white spectrum: a held sample equals the one k earlier with probability pᵏ, which
    /// gives (1 − p²)/(1 + p² − 2p cos 2πf·dt).
    pub fn white_gain(&self, frequency_hz: f64, rate_hz: f64) -> f64 {
        let p = self.probability;
        (1.0 - p * p) / (1.0 + p * p - 2.0 * p * (TAU * frequency_hz / rate_hz).cos())
    }
}

impl Effect for HeldSamples {
    fn scope(&self) -> Scope {
        Scope::Triad
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        None
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        None
    }
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let (probability, mut last) = (self.probability, None);
        each(move |value| {
            let held = stream.uniform() < probability;
            match last {
                Some(last) if held => *value = last,
                _ => last = Some(*value),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn white_noise_gets_the_spectrum_of_held_samples() {
        let held = HeldSamples { probability: 0.3 };
        let cases = |seed| check::draw_on_white(&held, 40.0, check::SAMPLES, seed);
        check::spectrum_agrees("held_samples", check::Window::Hann, cases, 40.0, |f| held.white_gain(f, 40.0) / 40.0);
    }

    #[test]
    fn as_many_samples_repeat_as_the_probability_states() {
        let values = check::draw_on_white(&HeldSamples { probability: 0.02 }, 40.0, 1_000_000, 8);
        let repeats = values.windows(2).filter(|pair| pair[0] == pair[1]).count() as f64 / 1e6;
        assert!((repeats - 0.02).abs() < 5.0 * (0.02 * 0.98 / 1e6_f64).sqrt(), "{repeats}");
    }

    #[test]
    fn a_probability_outside_its_range_is_refused() {
        for probability in [-0.1, 1.0, f64::NAN] {
            let refusal = HeldSamples { probability }.check(40.0).unwrap_err();
            assert_eq!(refusal.allowed, "a probability from 0 to below 1");
        }
    }
}
