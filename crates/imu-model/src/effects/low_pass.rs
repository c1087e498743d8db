//! Low pass: the sensor's bandwidth.

use super::described::effect;
use super::frequencies::warped;
use super::spec::{FROM_ZERO, Form, Need, above};
use super::{Effect, Frequencies, Record, Refusal, Sampler, Stage, Stream, White, each};
use std::f64::consts::PI;
use std::sync::Arc;

effect! {
    /// A Butterworth filter on the sum of all stages before it in the chain, motion and noise alike.
    ///
    /// Power gain 1/(1 + (tan(πf·dt)/tan(πf_c·dt))^(2·order)), half at the cutoff. It starts as if its first input had
    /// lasted forever. Noise of the electronics behind it is not filtered: `white_behind`.
    ///
    /// Source: the bilinear transform of Butterworth's filter, prewarped to its cutoff, in sections of first and second order.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct LowPass: dyn Effect, 16, Stage::Bandwidth, White;
    "the sensor's bandwidth: a Butterworth filter of motion and noise" => "a low-pass filter at {cutoff_hz:.2} Hz";
    cutoff_hz: f64 = above(0.0), "Hz", "−3 dB, Hz; below half the rate at which it acts";
    order: u64 = Form::Whole(1, LowPass::ORDER_MAX), "", "of Butterworth's filter", Need::Default(1.0);
    white_behind: f64 = FROM_ZERO, "U/√Hz",
        "white noise that comes in behind the filter, N in U/√Hz", Need::Unwritten(0.0);
}

impl LowPass {
    /// The highest order.
    pub const ORDER_MAX: u64 = 8;

    /// Creates a filter without noise behind it.
    pub fn new(cutoff_hz: f64, order: u64) -> Self {
        Self { cutoff_hz, order, white_behind: 0.0 }
    }
}

impl LowPass {
    /// Returns the power gain at the ratio of a warped frequency to that of the cutoff.
    fn gain_at(&self, ratio: f64) -> f64 {
        1.0 / (1.0 + ratio.powi(2).powi(self.order as i32))
    }
}

impl Effect for LowPass {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        Self::SPEC.below_nyquist("cutoff_hz", self.cutoff_hz, rate_hz)
    }
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        White { n: self.white_behind }.psd(frequency_hz, rate_hz)
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        White { n: self.white_behind }.allan_variance(m, record)
    }
    fn power_gain(&self, frequency_hz: f64, rate_hz: f64) -> f64 {
        self.gain_at(warped(frequency_hz, rate_hz) / warped(self.cutoff_hz, rate_hz))
    }
    fn power_gains(&self, frequencies: &Frequencies) -> Vec<f64> {
        let cutoff = warped(self.cutoff_hz, frequencies.rate_hz());
        frequencies.map(|half| self.gain_at(half.tangent / cutoff))
    }
    fn noiseless(&self) -> Option<Arc<dyn Effect>> {
        Some(Arc::new(Self { white_behind: 0.0, ..*self }))
    }
    fn sampler(&self, rate_hz: f64, record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        let warped = warped(self.cutoff_hz, rate_hz);
        let mut sections = Vec::new();
        if self.order % 2 == 1 {
            let below = 1.0 + warped;
            sections.push(Section::new([warped / below, warped / below, 0.0], [(warped - 1.0) / below, 0.0]));
        }
        for pair in 0..self.order / 2 {
            let damping = 2.0 * (PI * (2 * pair + 1) as f64 / (2 * self.order) as f64).sin();
            let below = 1.0 + warped * damping + warped * warped;
            let gain = warped * warped / below;
            let back = [2.0 * (warped * warped - 1.0) / below, (1.0 - warped * damping + warped * warped) / below];
            sections.push(Section::new([gain, 2.0 * gain, gain], back));
        }
        let mut started = false;
        let filter = each(move |value| {
            let first = [*value; 2];
            for section in &mut sections {
                if !started {
                    (section.inputs, section.outputs) = (first, first);
                }
                *value = section.next(*value);
            }
            started = true;
        });
        White { n: self.white_behind }.after(filter, rate_hz, record_length_s, stream)
    }
}

/// y = b·(x, x₁, x₂) − a·(y₁, y₂).
#[derive(Debug)]
struct Section {
    forward: [f64; 3],
    back: [f64; 2],
    inputs: [f64; 2],
    outputs: [f64; 2],
}

impl Section {
    fn new(forward: [f64; 3], back: [f64; 2]) -> Self {
        Self { forward, back, inputs: [0.0; 2], outputs: [0.0; 2] }
    }
    fn next(&mut self, input: f64) -> f64 {
        let output = self.forward[0] * input + self.forward[1] * self.inputs[0] + self.forward[2] * self.inputs[1]
            - self.back[0] * self.outputs[0]
            - self.back[1] * self.outputs[1];
        self.inputs = [input, self.inputs[0]];
        self.outputs = [output, self.outputs[0]];
        output
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn white_noise_behind_it_has_its_gain() {
        for (cutoff_hz, order) in [(6.0, 1), (3.0, 2), (8.0, 5)] {
            for white_behind in [0.0, 0.05] {
                check::agrees_with_its_closed_forms(&LowPass { cutoff_hz, order, white_behind }, 40.0);
            }
        }
    }

    #[test]
    fn the_gain_is_half_at_the_cutoff_and_a_level_passes() {
        for order in 1..=LowPass::ORDER_MAX {
            let filter = LowPass::new(5.0, order);
            assert!((filter.power_gain(5.0, 40.0) - 0.5).abs() < 1e-12);
            let mut values = vec![7.0; 1000];
            filter.sampler(40.0, 1.0, check::stream(1)).apply(&mut values);
            assert!(values.iter().all(|value| (value - 7.0).abs() < 1e-9), "order {order}");
        }
    }

    /// docs/simulation.md promises the same samples in every version: all sections begin with the filter's first input.
    #[test]
    fn the_first_samples_stay_the_same() {
        let mut values: Vec<f64> = (0..200).map(|t| 9.8 + (f64::from(t) * 0.7).sin()).collect();
        let inputs = values.clone();
        LowPass::new(10.0, 4).sampler(40.0, 1.0, check::stream(1)).apply(&mut values);
        let warped = (PI * 10.0 / 40.0).tan();
        let mut sections = [0, 1].map(|pair| {
            let damping = 2.0 * (PI * f64::from(2 * pair + 1) / 8.0).sin();
            let below = 1.0 + warped * damping + warped * warped;
            let gain = warped * warped / below;
            let back = [2.0 * (warped * warped - 1.0) / below, (1.0 - warped * damping + warped * warped) / below];
            let mut section = Section::new([gain, 2.0 * gain, gain], back);
            (section.inputs, section.outputs) = ([inputs[0]; 2], [inputs[0]; 2]);
            section
        });
        for (input, found) in inputs.iter().zip(values) {
            let expected = sections.iter_mut().fold(*input, |value, section| section.next(value));
            assert_eq!(expected.to_bits(), found.to_bits());
        }
    }

    #[test]
    fn orders_and_cutoffs_outside_their_ranges_are_refused() {
        assert!(LowPass::new(20.0, 1).check(40.0).is_err());
        assert!(LowPass::new(5.0, 0).check(40.0).is_err());
        assert!(LowPass::new(5.0, 9).check(40.0).is_err());
    }
}
