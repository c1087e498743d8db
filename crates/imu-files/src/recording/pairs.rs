//! Pairs: stamps that come two at a time, for example if two messages are received at once. Short and long steps
//! alternate. Pure.

use super::findings::Pairs;
use super::stamps::median_of;
use imu_core::units::NANOS_PER_SECOND;

/// A step below this share of the long one is short. A step that differs by this factor from the one before changes
/// between short and long.
pub(super) const SHORT: f64 = 0.1;
/// Stamps come in pairs if this share of the steps changes between short and long.
const PAIRED_FROM: f64 = 0.75;

/// How often the steps of a column of stamps change between short and long.
#[derive(Debug, Default)]
pub(super) struct Pairing {
    last_step_ns: u64,
    changes: u64,
    steps: u64,
}

impl Pairing {
    pub(super) fn add(&mut self, step_ns: u64) {
        let (shorter, longer) = (step_ns.min(self.last_step_ns), step_ns.max(self.last_step_ns));
        self.changes += u64::from((shorter as f64) < SHORT * longer as f64);
        self.last_step_ns = step_ns;
        self.steps += 1;
    }

    /// Returns the two alternating lengths, if there are such. `counted` are the distinct steps and how often each
    /// came, increasing.
    pub(super) fn pairs(&self, counted: &[(u64, u64)]) -> Option<Pairs> {
        if self.changes as f64 <= PAIRED_FROM * self.steps as f64 {
            return None;
        }
        // Half of the steps are long: the upper quartile is a typical one.
        let long_ns = upper_quartile(counted)?;
        let split = counted.partition_point(|(step, _)| (*step as f64) < SHORT * long_ns);
        let (short, long) = counted.split_at(split);
        let seconds = |nanos: f64| nanos / NANOS_PER_SECOND as f64;
        let (short_ns, long_ns) = median_of(short).zip(median_of(long))?;
        Some(Pairs { short_s: seconds(short_ns), long_s: seconds(long_ns) })
    }
}

fn upper_quartile(counted: &[(u64, u64)]) -> Option<f64> {
    let total: u64 = counted.iter().map(|(_, count)| count).sum();
    let mut passed = 0;
    let found = counted.iter().find(|(_, count)| {
        passed += count;
        4 * passed > 3 * total
    });
    found.or(counted.last()).map(|(step, _)| *step as f64)
}

#[cfg(test)]
mod tests {
    use super::super::stamps::StepMedian;
    use super::*;

    fn pairs_of(steps: impl Iterator<Item = u64>) -> Option<Pairs> {
        let (mut pairing, mut median) = (Pairing::default(), StepMedian::default());
        for step in steps {
            pairing.add(step);
            median.add(step);
        }
        pairing.pairs(&median.counted())
    }

    #[test]
    fn steps_that_take_turns_are_pairs_with_their_typical_lengths() {
        // Now and then a message comes alone, and once nothing comes for an hour.
        let step = |index: u64| match (index % 2, index % 40) {
            _ if index == 500 => 3_600_000_000_000,
            (_, 20) => 24_000_000,
            (0, _) => 10_000 + index % 7,
            _ => 42_000_000 + 1000 * (index % 11),
        };
        let found = pairs_of((0..1000).map(step)).unwrap();
        assert!((found.short_s - 1e-5).abs() < 1e-8 && (found.long_s - 0.042).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn bursts_holes_and_jitter_are_no_pairs() {
        assert_eq!(pairs_of(std::iter::empty()), None);
        assert_eq!(pairs_of((0..1000).map(|index| 25_000_000 + index * 7919 % 20_000_000)), None);
        assert_eq!(pairs_of((0..1000).map(|index| if index % 10 == 0 { 250_000_000 } else { 10_000 })), None);
        assert_eq!(pairs_of((0..221).map(|index| if index == 100 { 4_797_000_000_000 } else { 1_000_000_000 })), None);
    }
}
