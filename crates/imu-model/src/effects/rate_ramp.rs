//! Rate ramp (R): a bias that drifts steadily.

use super::described::effect;
use super::spec::ANY;
use super::{At, Effect, Record, Sampler, Stage, Stream, each};

effect! {
    /// A bias of R·t, from 0 at the start.
    ///
    /// Allan variance R²τ²/2, the same in every record that is long enough. Source: IEEE Std 952-1997, annex C (rate ramp).
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct RateRamp: dyn Effect, 0, Stage::Bias;
    "a bias that grows by R every second, from 0 at the start" => "a drift of {R:.3e} a second";
    r as "R": f64 = ANY, "U/s", "slope, U/s";
}

impl Effect for RateRamp {
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let tau_s = m as f64 / record.rate_hz;
        (2 * m <= record.samples).then_some((self.r * tau_s).powi(2) / 2.0)
    }
    fn mean_response(&self, input: f64, at: At) -> f64 {
        input + self.r * at.time_s
    }
    fn regressors(&self) -> usize {
        1
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        row[0] = at.time_s;
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        let (slope, mut index) = (self.r / rate_hz, 0_u64);
        each(move |value| {
            *value += slope * index as f64;
            index += 1;
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn allan_variance_and_course_are_those_of_a_ramp() {
        check::agrees_with_its_closed_forms(&RateRamp { r: -2e-4 }, 40.0);
    }
}
