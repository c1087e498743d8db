//! Synthetic noise for the tests of this module: seeded, and independent of the simulator.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

pub(super) struct Noise(ChaCha8Rng);

impl Noise {
    pub(super) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(super) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    pub(super) fn white(&mut self, count: usize, sigma: f64) -> Vec<f64> {
        (0..count).map(|_| sigma * self.normal()).collect()
    }

    /// Returns white noise of density `n`, flicker of coefficient `b` (first-order processes, one per octave of time)
    /// and a walk of coefficient `k`.
    pub(super) fn sensor(&mut self, count: usize, rate_hz: f64, n: f64, b: f64, k: f64) -> Vec<f64> {
        let dt = 1.0 / rate_hz;
        // Σ 2σ²T/(1+(2πfT)²) over T = 2^i is σ²·(π/ln 2)/(2πf)·… : σ² = B² ln 2/π gives B²/(2πf).
        let sigma = b * (std::f64::consts::LN_2 / std::f64::consts::PI).sqrt();
        let octaves = ((count as f64).log2().ceil() as i32 + 2).max(1);
        let phis: Vec<f64> = (0..octaves).map(|octave| (-dt / (dt * 2f64.powi(octave))).exp()).collect();
        let mut states: Vec<f64> = phis.iter().map(|_| sigma * self.normal()).collect();
        let mut walk = 0.0;
        (0..count)
            .map(|_| {
                if b > 0.0 {
                    for (state, phi) in states.iter_mut().zip(&phis) {
                        *state = phi * *state + sigma * (1.0 - phi * phi).sqrt() * self.normal();
                    }
                }
                walk += k * dt.sqrt() * self.normal();
                n / dt.sqrt() * self.normal() + walk + if b > 0.0 { states.iter().sum::<f64>() } else { 0.0 }
            })
            .collect()
    }
}
