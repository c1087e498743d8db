//! Random walk of the rate (K): the sum of independent steps.

use super::described::effect;
use super::spec::FROM_ZERO;
use super::{Effect, Record, Sampler, Stage, Stream, each};
use std::f64::consts::PI;

effect! {
    /// Rate random walk with two-sided PSD (K/2πf)².
    ///
    /// Sampled, it is a sum of steps of standard deviation K√dt that starts at 0; its spectrum is then
    /// (K·dt)²/(4 sin²(πf·dt)), which is (K/2πf)² far below Nyquist.
    ///
    /// Source: IEEE Std 952-1997, annex C (rate random walk).
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct RandomWalk: dyn Effect, 3, Stage::Noise;
    "rate random walk, two-sided density (K/2πf)²";
    k as "K": f64 = FROM_ZERO, "U/√s", "K in U/√s";
}

impl Effect for RandomWalk {
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        let half_step = 2.0 * rate_hz * (PI * frequency_hz / rate_hz).sin();
        Some((self.k / half_step).powi(2))
    }
    /// Returns K²·dt·(2m² + 1)/(6m), exact for the sampled walk; K²τ/3 for large m.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let m = m as f64;
        Some(self.k * self.k / record.rate_hz * (2.0 * m * m + 1.0) / (6.0 * m))
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let (step, mut level) = (self.k / rate_hz.sqrt(), 0.0);
        each(move |value| {
            *value += level;
            level += step * stream.normal();
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_and_allan_variance_are_those_of_a_random_walk() {
        check::agrees_with_its_closed_forms(&RandomWalk { k: 3.19e-4 }, 40.0);
    }

    #[test]
    fn the_walk_starts_at_zero_and_its_steps_are_k_root_dt() {
        let values = check::draw(&RandomWalk { k: 2.0 }, 100.0, 200_000, 5);
        assert_eq!(values[0], 0.0);
        let variance =
            values.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
        assert!((variance / 0.04 - 1.0).abs() < 5.0 * 0.0032, "{variance}");
    }

    #[test]
    fn the_spectrum_is_that_of_the_standard_far_below_nyquist() {
        let walk = RandomWalk { k: 0.1 };
        let standard = (0.1 / (2.0 * PI * 0.01)).powi(2);
        assert!((walk.psd(0.01, 40.0).unwrap() / standard - 1.0).abs() < 1e-6);
    }
}
