//! Moving average: the mean of the last samples, as computed by a sensor's filter.

use super::described::effect;
use super::spec::{FROM_ZERO, Form, Need};
use super::{Effect, Record, Sampler, Stage, Stream, White, each};
use std::f64::consts::PI;
use std::sync::Arc;

effect! {
    /// The mean of the last `window` samples of the sum of all stages before it in the chain, at the rate at which it acts.
    ///
    /// Power gain (sin(πfW·dt)/(W·sin(πf·dt)))². Until there are `window` samples, it is the mean of the existing ones.
    /// Noise of the electronics behind it is not averaged: `white_behind`.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct MovingAverage: dyn Effect, 17, Stage::Bandwidth, White;
    "the mean of the last samples of motion and noise";
    window: u64 = Form::Whole(1, MovingAverage::WINDOW_MAX), "samples",
        "samples that are averaged, at the rate at which it acts";
    white_behind: f64 = FROM_ZERO, "U/√Hz",
        "white noise that comes in behind the filter, N in U/√Hz", Need::Unwritten(0.0);
}

impl MovingAverage {
    /// The longest window: more than a minute of the VN-100's internal samples.
    pub const WINDOW_MAX: u64 = 65_536;

    /// Creates a mean without noise behind it.
    pub fn new(window: u64) -> Self {
        Self { window, white_behind: 0.0 }
    }
}

/// Returns |H|² of the mean over `window` samples at `cycles` per sample.
pub fn boxcar_gain(window: u64, cycles: f64) -> f64 {
    let (window, x) = (window as f64, PI * cycles);
    if x.sin().abs() < 1e-12 { 1.0 } else { ((window * x).sin() / (window * x.sin())).powi(2) }
}

impl Effect for MovingAverage {
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        White { n: self.white_behind }.psd(frequency_hz, rate_hz)
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        White { n: self.white_behind }.allan_variance(m, record)
    }
    fn power_gain(&self, frequency_hz: f64, rate_hz: f64) -> f64 {
        boxcar_gain(self.window, frequency_hz / rate_hz)
    }
    fn noiseless(&self) -> Option<Arc<dyn Effect>> {
        Some(Arc::new(Self { white_behind: 0.0, ..*self }))
    }
    fn sampler(&self, rate_hz: f64, record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        let mut mean = RunningMean::new(self.window);
        let filter = each(move |value| *value = mean.next(*value));
        White { n: self.white_behind }.after(filter, rate_hz, record_length_s, stream)
    }
}

/// The mean of the last values. The sum is computed again once per window, so that rounding never accumulates.
#[derive(Debug)]
pub struct RunningMean {
    window: usize,
    last: Vec<f64>,
    place: usize,
    sum: f64,
}

impl RunningMean {
    /// Creates a mean over `window` values (0 counts as 1).
    pub fn new(window: u64) -> Self {
        let window = usize::try_from(window).unwrap_or(usize::MAX).max(1);
        Self { window, last: Vec::new(), place: 0, sum: 0.0 }
    }

    /// Takes a value and returns the mean of the last ones, itself included.
    pub fn next(&mut self, value: f64) -> f64 {
        if self.window == 1 {
            return value;
        }
        if self.last.len() < self.window {
            self.last.push(value);
            self.sum += value;
            return self.sum / self.last.len() as f64;
        }
        self.sum += value - self.last[self.place];
        self.last[self.place] = value;
        self.place += 1;
        if self.place == self.window {
            self.place = 0;
            self.sum = self.last.iter().sum();
        }
        self.sum / self.window as f64
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn white_noise_behind_it_has_its_gain() {
        for window in [2, 5] {
            for white_behind in [0.0, 0.05] {
                check::agrees_with_its_closed_forms(&MovingAverage { window, white_behind }, 40.0);
            }
        }
    }

    #[test]
    fn each_value_is_the_mean_of_those_that_went_before() {
        let input: Vec<f64> = (0..200).map(|i| f64::from(i * i % 37)).collect();
        let mut mean = RunningMean::new(7);
        for index in 0..200 {
            let from = (index + 1_usize).saturating_sub(7);
            let expected = input[from..=index].iter().sum::<f64>() / (index + 1 - from) as f64;
            assert!((mean.next(input[index]) - expected).abs() < 1e-12, "{index}");
        }
    }

    #[test]
    fn an_empty_window_is_refused() {
        assert!(MovingAverage::new(0).check(40.0).is_err());
        assert!(MovingAverage::new(1).check(40.0).is_ok());
    }
}
