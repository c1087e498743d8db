//! Tones: a sine, and a comb of one fundamental and its harmonics, with random phases.

use super::described::effect;
use super::spec::{FROM_ZERO, Form, Range, above};
use super::{At, Effect, Extent, Line, Moments, Record, Refusal, Sampler, Stage, Stream, each};
use std::f64::consts::{PI, TAU};

effect! {
    /// A sine of one frequency. Its phase is drawn from the stream, with all phases equally likely.
    ///
    /// Expected Allan variance over the phases: A²·sin⁴(πfm·dt)/(m·sin(πf·dt))². Its spectrum is a line of power A²/2.
    /// Before a decimation its frequency may lie above half the output's rate; it then appears folded.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Tone: dyn Effect, 5, Stage::Noise;
    "a sine of one frequency and unknown phase" => "a {frequency_hz:.3} Hz tone of {amplitude:.2e}{more}";
    frequency_hz: f64 = above(0.0), "Hz", "frequency, Hz; below half the rate at which it acts";
    amplitude: f64 = FROM_ZERO, "U", "peak, U";
}

effect! {
    /// Harmonics of one fundamental: one cause, such as a motor. Phases are drawn independently.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Comb: dyn Effect, 6, Stage::Noise;
    "harmonics of one fundamental, as one cause" => "a comb of {fundamental_hz:.3} Hz{more}";
    fundamental_hz: f64 = above(0.0), "Hz", "frequency of the first harmonic, Hz; the last one below half the rate";
    amplitudes: Vec<f64> = Form::Numbers(Range::FromZero), "U", "peaks of the first, second… harmonic, U";
}

/// Returns the expected Allan variance of a sine of amplitude 1.
fn allan_variance(frequency_hz: f64, m: u64, rate_hz: f64) -> f64 {
    let (m, x) = (m as f64, PI * frequency_hz / rate_hz);
    (m * x).sin().powi(4) / (m * x.sin()).powi(2)
}

/// Returns cosine and sine at a time.
fn quadratures(frequency_hz: f64, time_s: f64) -> [f64; 2] {
    let (sine, cosine) = (TAU * (frequency_hz * time_s).fract()).sin_cos();
    [cosine, sine]
}

impl Effect for Tone {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        Self::SPEC.below_nyquist("frequency_hz", self.frequency_hz, rate_hz)
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    fn lines(&self) -> Vec<Line> {
        vec![Line { frequency_hz: self.frequency_hz, power: self.amplitude * self.amplitude / 2.0 }]
    }
    fn extents(&self) -> Vec<Extent> {
        vec![Extent::band(self.frequency_hz, 0.0, 1.0)]
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        Some(self.amplitude * self.amplitude * allan_variance(self.frequency_hz, m, record.rate_hz))
    }
    fn moments(&self, _record: Record) -> Option<Moments> {
        Some(Moments { variance: self.amplitude * self.amplitude / 2.0, kurtosis: Some(1.5) })
    }
    fn regressors(&self) -> usize {
        2
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        row.copy_from_slice(&quadratures(self.frequency_hz, at.time_s));
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        sum(vec![Sine::new(self.frequency_hz / rate_hz, self.amplitude, &mut stream)])
    }
}

impl Comb {
    /// Returns frequency and peak of each harmonic.
    fn harmonics(&self) -> impl Iterator<Item = (f64, f64)> {
        (1_u32..).zip(&self.amplitudes).map(|(order, amplitude)| (f64::from(order) * self.fundamental_hz, *amplitude))
    }
}

impl Effect for Comb {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        let highest_hz = self.fundamental_hz * self.amplitudes.len() as f64;
        if highest_hz < 0.5 * rate_hz {
            return Ok(());
        }
        let found = format!("{} Hz with {} harmonics", self.fundamental_hz, self.amplitudes.len());
        let allowed = format!(
            "a highest harmonic below {} Hz, half the rate at which it acts (it is {highest_hz} Hz)",
            0.5 * rate_hz
        );
        Err(Self::SPEC.refuse("fundamental_hz", found, allowed))
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    fn lines(&self) -> Vec<Line> {
        self.harmonics().map(|(frequency_hz, peak)| Line { frequency_hz, power: peak * peak / 2.0 }).collect()
    }
    fn extents(&self) -> Vec<Extent> {
        let present = self.harmonics().filter(|(_, peak)| *peak > 0.0);
        present.map(|(frequency_hz, peak)| Extent::band(frequency_hz, 0.0, peak * peak)).collect()
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        Some(self.harmonics().map(|(f, peak)| peak * peak * allan_variance(f, m, record.rate_hz)).sum())
    }
    /// The phases are independent, so that only Σ 3A⁴/8 and the pairs' 6·A²B²/4 remain of the fourth moment.
    fn moments(&self, _record: Record) -> Option<Moments> {
        let variance: f64 = self.amplitudes.iter().map(|peak| peak * peak / 2.0).sum();
        let fourths: f64 = self.amplitudes.iter().map(|peak| peak.powi(4)).sum();
        // E x⁴ = 3·variance² − (3/8)·ΣA⁴, over random independent phases.
        let kurtosis = if variance > 0.0 { 3.0 - 0.375 * fourths / (variance * variance) } else { 3.0 };
        Some(Moments { variance, kurtosis: Some(kurtosis) })
    }
    fn regressors(&self) -> usize {
        2 * self.amplitudes.len()
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        for (pair, (frequency_hz, _)) in row.chunks_exact_mut(2).zip(self.harmonics()) {
            pair.copy_from_slice(&quadratures(frequency_hz, at.time_s));
        }
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        sum(self.harmonics().map(|(f, peak)| Sine::new(f / rate_hz, peak, &mut stream)).collect())
    }
}

/// One sine: cycles per sample, peak, phase in cycles.
#[derive(Debug)]
struct Sine {
    step: f64,
    peak: f64,
    phase: f64,
}

impl Sine {
    fn new(step: f64, peak: f64, stream: &mut Stream) -> Self {
        Self { step, peak, phase: stream.uniform() }
    }
}

/// Creates a sampler that adds the sines.
fn sum(sines: Vec<Sine>) -> Box<dyn Sampler> {
    let mut index = 0_u64;
    each(move |value| {
        for sine in &sines {
            // Whole cycles are dropped first: the phase stays exact to 1e-7 cycles over 200 years at 800 Hz.
            let cycles = (sine.step * index as f64).fract() + sine.phase;
            *value += sine.peak * (TAU * cycles).sin();
        }
        index += 1;
    })
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn allan_variance_moments_and_line_are_those_of_a_sine() {
        check::agrees_with_its_closed_forms(&Tone { frequency_hz: 11.4, amplitude: 0.3 }, 40.0);
        check::agrees_with_its_closed_forms(&Tone { frequency_hz: 0.31, amplitude: 2.0 }, 40.0);
    }

    #[test]
    fn allan_variance_moments_and_lines_are_those_of_a_comb() {
        check::agrees_with_its_closed_forms(&Comb { fundamental_hz: 3.1, amplitudes: vec![1.0, 0.0, 0.4, 0.2] }, 40.0);
    }

    #[test]
    fn a_frequency_from_half_the_rate_up_is_refused() {
        let refusal = Tone { frequency_hz: 20.0, amplitude: 1.0 }.check(40.0).unwrap_err().to_string();
        assert_eq!(
            refusal,
            "tone: `frequency_hz`: found 20 Hz; allowed is a frequency below 20 Hz, half the rate at which it acts"
        );
        assert!(Tone { frequency_hz: 20.0, amplitude: 1.0 }.check(800.0).is_ok());
        assert!(Tone { frequency_hz: f64::NAN, amplitude: 1.0 }.check(800.0).is_err());
        let comb = Comb { fundamental_hz: 7.0, amplitudes: vec![1.0; 3] };
        assert!(comb.check(40.0).unwrap_err().to_string().contains("it is 21 Hz"));
        assert!(comb.check(50.0).is_ok());
    }
}
