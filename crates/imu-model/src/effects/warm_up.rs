//! Warm-up: the bias after switching on, dying away.

use super::described::effect;
use super::spec::{ANY, above};
use super::{At, Effect, Extent, Record, Sampler, Stage, Stream, each};

effect! {
    /// A bias of A·exp(−t/τ): A at the start.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct WarmUp: dyn Effect, 0, Stage::Bias;
    "a bias that dies away exponentially from the start" => "a warm-up of {amplitude:.3e} in {tau_s:.3e} s";
    amplitude: f64 = ANY, "U", "bias at the start, U; signed";
    tau_s: f64 = above(0.0), "s", "time to fall to 1/e, s";
}

impl Effect for WarmUp {
    fn extents(&self) -> Vec<Extent> {
        vec![Extent::time(0.0, 3.0 * self.tau_s, 1.0)]
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    /// With r = exp(−dt/τ), the averages from sample i on differ by A·rⁱ(1 − rᵐ)²/(m(1 − r)). Returns half the mean
    /// square of that over the record, in closed form.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let starts = record.samples.checked_sub(2 * m).filter(|_| m > 0)? as f64 + 1.0;
        let decay = 1.0 / (record.rate_hz * self.tau_s);
        let m = m as f64;
        let first = (-decay * m).exp_m1().powi(2) / (m * (-decay).exp_m1());
        let mean_square = (-2.0 * decay * starts).exp_m1() / (-2.0 * decay).exp_m1() / starts;
        Some(0.5 * (self.amplitude * first).powi(2) * mean_square)
    }
    fn mean_response(&self, input: f64, at: At) -> f64 {
        input + self.amplitude * (-at.time_s / self.tau_s).exp()
    }
    fn regressors(&self) -> usize {
        1
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        row[0] = (-at.time_s / self.tau_s).exp();
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        let (amplitude, decay, mut index) = (self.amplitude, 1.0 / (rate_hz * self.tau_s), 0_u64);
        each(move |value| {
            *value += amplitude * (-decay * index as f64).exp();
            index += 1;
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn allan_variance_and_course_are_those_of_an_exponential() {
        for tau_s in [1.0, 60.0, 1e5] {
            check::agrees_with_its_closed_forms(&WarmUp { amplitude: -0.3, tau_s }, 40.0);
        }
    }
}
