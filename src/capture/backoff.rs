//! Backoff: the delay before the next attempt on a port that exists and fails. Pure.

use rand::{Rng, RngExt};
use std::time::Duration;

/// The first delay.
pub const FIRST: Duration = Duration::from_millis(250);
/// The longest delay: together with the time to identify the sensor, a sensor that works again streams within 10 s.
pub const LONGEST: Duration = Duration::from_secs(8);

/// Doubles the delay with each failure, up to [`LONGEST`]. A random part of up to a quarter is subtracted, so that
/// several daemons do not try in step.
#[derive(Debug, Clone, Default)]
pub struct Backoff {
    failures: u32,
}

impl Backoff {
    /// Returns the delay after one more failure.
    pub fn next<R: Rng>(&mut self, random: &mut R) -> Duration {
        let wait = FIRST.saturating_mul(1 << self.failures.min(16)).min(LONGEST);
        self.failures = self.failures.saturating_add(1);
        wait.mul_f64(1.0 - 0.25 * random.random::<f64>())
    }
    /// Resets the delay after a success.
    pub fn reset(&mut self) {
        self.failures = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn waits_grow_and_never_exceed_the_longest() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut backoff = Backoff::default();
        let waits: Vec<Duration> = (0..40).map(|_| backoff.next(&mut random)).collect();
        assert!(waits[0] <= FIRST && waits[0] >= FIRST.mul_f64(0.75));
        assert!(waits.iter().all(|wait| *wait <= LONGEST));
        assert!(waits[39] >= LONGEST.mul_f64(0.75));
        backoff.reset();
        assert!(backoff.next(&mut random) <= FIRST);
    }
}
