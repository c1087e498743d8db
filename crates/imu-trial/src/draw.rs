//! Draws: random numbers from the sealed seed and a purpose.
//!
//! Each purpose has a separate ChaCha8 stream under SHA-256("vn100d-trial-1", seed, case, capture, purpose). Draws for
//! the device use capture 0; draws for one recording of it use the capture's number. A second capture of the same
//! device shares only the draws for the device.

use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution as _, StandardNormal};
use sha2::{Digest as _, Sha256};

/// Separates these streams from any other use of a seed.
const DOMAIN: &[u8] = b"vn100d-trial-1";

/// A stream of random numbers for one purpose.
#[derive(Debug, Clone)]
pub struct Draw(ChaCha8Rng);

impl Draw {
    /// Returns the stream of a case's device.
    pub fn device(seed: u64, case: u64, purpose: &str) -> Self {
        Self::new(seed, case, 0, purpose)
    }

    /// Returns the stream of one capture (from 1) of a case's device.
    pub fn capture(seed: u64, case: u64, capture: u32, purpose: &str) -> Self {
        Self::new(seed, case, capture, purpose)
    }

    fn new(seed: u64, case: u64, capture: u32, purpose: &str) -> Self {
        let mut hash = Sha256::new();
        hash.update(DOMAIN);
        hash.update(seed.to_le_bytes());
        hash.update(case.to_le_bytes());
        hash.update(capture.to_le_bytes());
        hash.update(purpose.as_bytes());
        Self(ChaCha8Rng::from_seed(hash.finalize().into()))
    }

    /// Returns a stream that starts from the state of this one. Later draws of the two are independent.
    pub fn split(&mut self) -> Self {
        let mut seed = [0; 32];
        self.0.fill_bytes(&mut seed);
        Self(ChaCha8Rng::from_seed(seed))
    }

    /// Returns a number spread evenly over `from..to`.
    pub fn uniform(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.0.random::<f64>()
    }

    /// Returns a number whose logarithm is spread evenly.
    pub fn log_uniform(&mut self, from: f64, to: f64) -> f64 {
        self.uniform(from.ln(), to.ln()).exp()
    }

    /// Returns a normal number of variance 1.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Returns the square root of (ν − 2)/χ²(ν): the factor that turns a normal number into one of Student's t with the
    /// same variance.
    pub fn student_factor(&mut self, degrees_of_freedom: f64) -> f64 {
        // Degrees of freedom above 2 are always a valid χ².
        let chi = ChiSquared::new(degrees_of_freedom).map_or(degrees_of_freedom, |chi| chi.sample(&mut self.0));
        ((degrees_of_freedom - 2.0) / chi).sqrt()
    }

    /// Returns 1 or −1.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// Returns whether an event of this probability happens.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// Returns a whole number from `from` to `to`, inclusive.
    pub fn whole(&mut self, from: usize, to: usize) -> usize {
        self.0.random_range(from..=to)
    }

    /// Returns some of `0..count`, at least `least`, in ascending order: first their number is drawn, then the
    /// selection.
    pub fn some_of(&mut self, count: usize, least: usize) -> Vec<usize> {
        let wanted = self.whole(least.min(count), count);
        let mut all: Vec<usize> = (0..count).collect();
        self.shuffle(&mut all);
        all.truncate(wanted);
        all.sort_unstable();
        all
    }

    /// Puts a list in random order.
    pub fn shuffle<T>(&mut self, list: &mut [T]) {
        for last in (1..list.len()).rev() {
            list.swap(last, self.whole(0, last));
        }
    }

    /// Returns the number of samples, from 1, until the next event, if events happen in each sample with `probability`;
    /// `None` if that is beyond any recording.
    pub fn wait(&mut self, probability: f64) -> Option<usize> {
        let ahead = (1.0 - self.0.random::<f64>()).ln() / (-probability).ln_1p();
        (ahead < 1e15).then(|| ahead as usize + 1)
    }

    /// Returns the samples (from 1, below `samples`) of events that happen with `probability` in each: at least one,
    /// and at least half as many as expected. Without this minimum, an effect that by chance does not occur would count
    /// against a diagnosis that does not name it.
    pub fn events(&mut self, probability: f64, samples: usize) -> Vec<usize> {
        let least = (0.5 * probability * samples as f64).ceil() as usize;
        loop {
            let mut events = Vec::new();
            let mut at = 0;
            while let Some(wait) = self.wait(probability).filter(|wait| at + wait < samples) {
                at += wait;
                events.push(at);
            }
            if events.len() >= least.min(samples / 2) {
                return events;
            }
        }
    }

    /// Returns 16 bytes as hexadecimal digits.
    pub fn salt(&mut self) -> String {
        (0..2).map(|_| format!("{:016x}", self.0.next_u64())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_purpose_has_its_own_stream_and_always_the_same() {
        let first = |mut draw: Draw| draw.uniform(0.0, 1.0);
        let of = |case, purpose| first(Draw::device(7, case, purpose));
        assert_eq!(of(1, "size"), of(1, "size"));
        assert_ne!(of(1, "size"), of(2, "size"));
        assert_ne!(of(1, "size"), of(1, "noise"));
        assert_ne!(first(Draw::capture(7, 1, 1, "noise")), first(Draw::capture(7, 1, 2, "noise")));
    }

    #[test]
    fn events_come_as_often_as_their_probability_states() {
        let mut draw = Draw::device(1, 1, "wait");
        let mean = (0..20_000).filter_map(|_| draw.wait(0.02)).sum::<usize>() as f64 / 20_000.0;
        assert!((mean - 50.0).abs() < 1.5, "{mean}");
        assert_eq!(draw.wait(0.0), None);
    }

    #[test]
    fn a_choice_is_in_order_and_no_smaller_than_asked() {
        let mut draw = Draw::device(1, 1, "choice");
        for _ in 0..200 {
            let chosen = draw.some_of(6, 2);
            assert!(
                chosen.len() >= 2 && chosen.windows(2).all(|two| two[0] < two[1]) && chosen.iter().all(|one| *one < 6)
            );
        }
    }
}
