//! Random streams: from a seed and a stream's identity, normal and uniform numbers that are the same on every machine
//! and in every version.
//!
//! Each stream is ChaCha8 under the key `seed (8 bytes, little endian) ‖ "vn100d-simulator-1" ‖ zeros` with the 64-bit
//! stream number
//!
//! ```text
//! bits 63–32  owner      the channel's column number (0–13); 256 + n for a triad (attitude, mag, accel, gyro: n = 0–3)
//!                        and 260 for the whole sensor
//! bits 31–16  effect     the number that the kind's file states, given once and never reused: the last one is 22, and 0
//!                        is for effects that do not use random draws
//! bits 15–0   instance   counts several effects of one kind on one owner, from 0
//! ```
//!
//! Normal numbers are the Ziggurat of `rand_distr`; `the_stream_is_value_stable` fails if a new version of it, or of the
//! generator, draws other values.

use imu_core::sample::Triad;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

/// Separates these streams from any other use of the same seed; a new scheme gets a new number.
const DOMAIN: &[u8; 18] = b"vn100d-simulator-1";

/// Returns the owner of a triad's streams.
pub fn triad_owner(triad: Triad) -> u32 {
    256 + match triad {
        Triad::Attitude => 0,
        Triad::Mag => 1,
        Triad::Accel => 2,
        Triad::Gyro => 3,
    }
}

/// Owner of the streams that the whole sensor shares.
pub const SENSOR_OWNER: u32 = 260;

/// The identity of a stream: see the module's table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct StreamId {
    /// Column number of the channel, or 256 + n.
    pub owner: u32,
    /// Number of the effect's kind.
    pub effect: u16,
    /// Index among several effects of that kind.
    pub instance: u16,
}

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// Returns the stream `id` of `seed`, at its beginning.
    pub fn new(seed: u64, id: StreamId) -> Self {
        let mut key = [0_u8; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..8 + DOMAIN.len()].copy_from_slice(DOMAIN);
        let mut generator = ChaCha8Rng::from_seed(key);
        generator.set_stream(u64::from(id.owner) << 32 | u64::from(id.effect) << 16 | u64::from(id.instance));
        Self(generator)
    }

    /// Returns the next normal number of mean 0 and variance 1.
    #[inline]
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Returns the next number from 0 to below 1, all multiples of 2⁻⁵³ equally likely.
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Returns a separate stream whose key is drawn from this one, for a sampler that draws in addition.
    pub(super) fn branch(&mut self) -> Self {
        let mut key = [0_u8; 32];
        for eight in key.chunks_exact_mut(8) {
            eight.copy_from_slice(&self.0.next_u64().to_le_bytes());
        }
        Self(ChaCha8Rng::from_seed(key))
    }

    /// Returns the next number of a distribution.
    pub(super) fn draw(&mut self, distribution: &impl Distribution<f64>) -> f64 {
        distribution.sample(&mut self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ID: StreamId = StreamId { owner: 9, effect: 1, instance: 0 };

    #[test]
    fn the_stream_is_value_stable() {
        let mut stream = Stream::new(1, ID);
        let drawn: Vec<f64> = (0..4).map(|_| stream.normal()).collect();
        assert_eq!(drawn, [-1.6236043913647966, -0.594052344562553, -1.9408553170850902, 0.6245322440979414]);
        assert_eq!((0..100_000).map(|_| stream.normal()).last(), Some(-0.3643090252422438));
    }

    #[test]
    fn uniform_numbers_are_value_stable_and_evenly_spread() {
        let mut stream = Stream::new(1, ID);
        assert_eq!([stream.uniform(), stream.uniform()], [0.20292877187780356, 0.2750876831945379]);
        let n = 1_000_000;
        let mut counts = [0_u32; 10];
        for _ in 0..n {
            let value = stream.uniform();
            assert!((0.0..1.0).contains(&value));
            counts[(value * 10.0) as usize] += 1;
        }
        // χ² with nine degrees of freedom: 33.7 is exceeded once in 10,000.
        let expected = f64::from(n) / 10.0;
        let chi2: f64 = counts.iter().map(|count| (f64::from(*count) - expected).powi(2) / expected).sum();
        assert!(chi2 < 33.7, "{chi2}");
    }

    #[test]
    fn streams_differ_by_seed_owner_effect_and_instance() {
        let first = |seed, id| Stream::new(seed, id).normal();
        let reference = first(1, ID);
        assert_eq!(first(1, ID), reference);
        for other in [
            first(2, ID),
            first(1, StreamId { owner: 10, ..ID }),
            first(1, StreamId { effect: 2, ..ID }),
            first(1, StreamId { instance: 1, ..ID }),
        ] {
            assert_ne!(other, reference);
        }
    }

    #[test]
    fn a_branch_is_value_stable_and_another_stream() {
        let mut stream = Stream::new(1, ID);
        let mut branch = stream.branch();
        assert_eq!(branch.uniform(), 0.994536588324098);
        assert_ne!(stream.uniform(), branch.uniform());
    }

    #[test]
    fn normal_numbers_have_the_moments_of_a_normal_distribution() {
        let mut stream = Stream::new(7, ID);
        let n = 1_000_000;
        let (mut mean, mut square, mut fourth) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let value = stream.normal();
            mean += value;
            square += value * value;
            fourth += value.powi(4);
        }
        let n = f64::from(n);
        // Five standard errors: those of the estimates are 1/√n, √(2/n), √(96/n).
        assert!((mean / n).abs() < 5.0 / n.sqrt());
        assert!((square / n - 1.0).abs() < 5.0 * (2.0 / n).sqrt());
        assert!((fourth / n - 3.0).abs() < 5.0 * (96.0 / n).sqrt());
    }
}
