//! Resolution: rounding of sent values.

use super::described::effect;
use super::spec::above;
use super::{At, Effect, Moments, Record, Sampler, Stage, Stream, each};

effect! {
    /// Each sent value is the nearest multiple of `step`.
    ///
    /// If the values' own noise exceeds about half a step per sample, the error is white and uniformly distributed,
    /// with variance step²/12. At half a step that variance is off by 0.9 %, at one step by 3e-9. If the values hardly
    /// move, rounding keeps them at one multiple and the closed forms do not hold.
    ///
    /// Source: Bennett, Bell System Technical Journal 27 (1948); Widrow and Kollár, Quantization Noise (2008), chapter
    /// 5.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Resolution: dyn Effect, 0, Stage::Resolution, White;
    "output rounded to the nearest multiple" => "values in steps of {step:.3e}";
    step: f64 = above(0.0), "U", "distance of the values that are sent, U";
}

impl Effect for Resolution {
    fn psd(&self, _frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        Some(self.step * self.step / 12.0 / rate_hz)
    }
    fn allan_variance(&self, m: u64, _record: Record) -> Option<f64> {
        Some(self.step * self.step / 12.0 / m as f64)
    }
    fn mean_response(&self, input: f64, _at: At) -> f64 {
        (input / self.step).round() * self.step
    }
    fn moments(&self, _record: Record) -> Option<Moments> {
        Some(Moments { variance: self.step * self.step / 12.0, kurtosis: Some(1.8) })
    }
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        let step = self.step;
        each(move |value| *value = (*value / step).round() * step)
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn the_error_is_white_with_a_twelfth_of_the_squared_step() {
        check::agrees_with_its_closed_forms(&Resolution { step: 0.7 }, 40.0);
    }

    #[test]
    fn every_value_is_the_nearest_multiple() {
        let values = check::draw_on_white(&Resolution { step: 0.25 }, 40.0, 1000, 5);
        let before = check::draw_on_white(&Resolution { step: 1e-9 }, 40.0, 1000, 5);
        for (value, before) in values.iter().zip(before) {
            assert_eq!((value / 0.25).fract(), 0.0);
            assert!((value - before).abs() <= 0.125 + 1e-8);
        }
        let at = At { time_s: 0.0, temperature_c: 25.0 };
        assert_eq!(Resolution { step: 0.25 }.mean_response(0.4, at), 0.5);
    }

    #[test]
    fn a_step_of_nothing_is_refused() {
        assert!(Resolution { step: 0.0 }.check(40.0).is_err());
    }
}
