//! Stamps: decimal text to integer nanoseconds without loss, and the median of the steps between them in bounded memory.

use crate::units::NANOS_PER_SECOND;
use std::collections::HashMap;

/// Stamps in seconds above this are taken as time since 1970 (it is March 1973; no recording runs three years).
pub(super) const UNIX_FROM_NS: i64 = 100_000_000 * NANOS_PER_SECOND as i64;

/// Seconds as decimal text to nanoseconds, rounded at the tenth decimal; `None` where the text is no number or the time
/// lies beyond 292 years.
///
/// Not by way of `f64`, which resolves a time since 1970 to 240 ns only.
pub(super) fn parse_seconds(text: &str) -> Option<i64> {
    let (negative, digits) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let plain = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    if whole.is_empty() && fraction.is_empty() || !plain(whole) || !plain(fraction) {
        // Exponents, and what is no number.
        let nanos = text.parse::<f64>().ok()? * NANOS_PER_SECOND as f64;
        return (nanos.abs() < i64::MAX as f64).then_some(nanos.round() as i64);
    }
    let whole: i64 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
    let mut nanos = 0_i64;
    for position in 0..9 {
        nanos = 10 * nanos + fraction.as_bytes().get(position).map_or(0, |digit| i64::from(digit - b'0'));
    }
    nanos += i64::from(fraction.as_bytes().get(9).is_some_and(|digit| *digit >= b'5'));
    let total = whole.checked_mul(NANOS_PER_SECOND as i64)?.checked_add(nanos)?;
    Some(if negative { -total } else { total })
}

/// Stamps of one row that are kept.
pub(super) const STAMPS_MAX: usize = 4;

/// The stamps that a row carries, ns, in the order in which they stand there; of more than [`STAMPS_MAX`] the last ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct RowStamps {
    nanos: [i64; STAMPS_MAX],
    count: usize,
}

impl RowStamps {
    pub(super) fn one(nanos: i64) -> Self {
        let mut stamps = Self::default();
        stamps.push(nanos);
        stamps
    }
    pub(super) fn push(&mut self, nanos: i64) {
        if self.count == STAMPS_MAX {
            self.nanos.rotate_left(1);
            self.count -= 1;
        }
        self.nanos[self.count] = nanos;
        self.count += 1;
    }
    pub(super) fn count(&self) -> usize {
        self.count
    }
    pub(super) fn get(&self, column: usize) -> Option<i64> {
        self.nanos[..self.count].get(column).copied()
    }
}

/// Distinct steps that are counted exactly.
const DISTINCT_MAX: usize = 1 << 18;
/// Leading bits of a step that are kept when there are more (a relative error of 6e-8 at first).
const KEPT_BITS: u32 = 24;

/// The median of steps: exact for up to [`DISTINCT_MAX`] distinct ones, beyond that to a relative 6e-8 or, for ever more
/// scattered ones, worse by powers of two. Memory stays below 16 MB.
#[derive(Debug, Default)]
pub(super) struct StepMedian {
    counts: HashMap<u64, u64>,
    /// Leading bits kept; `None` keeps all.
    kept_bits: Option<u32>,
}

impl StepMedian {
    pub(super) fn add(&mut self, step_ns: u64) {
        *self.counts.entry(rounded(step_ns, self.kept_bits)).or_default() += 1;
        while self.counts.len() > DISTINCT_MAX {
            let kept = self.kept_bits.map_or(KEPT_BITS, |bits| bits - 1);
            self.kept_bits = Some(kept);
            for (step, count) in std::mem::take(&mut self.counts) {
                *self.counts.entry(rounded(step, self.kept_bits)).or_default() += count;
            }
        }
    }

    /// How many steps there are whose length, ns, fulfils `condition`.
    pub(super) fn count_where(&self, condition: impl Fn(f64) -> bool) -> u64 {
        self.counts.iter().filter(|(step, _)| condition(**step as f64)).map(|(_, count)| count).sum()
    }

    /// How many steps there are.
    pub(super) fn total(&self) -> u64 {
        self.counts.values().sum()
    }

    /// The median in ns; of an even number the mean of the middle two.
    pub(super) fn median_ns(&self) -> Option<f64> {
        let total: u64 = self.counts.values().sum();
        if total == 0 {
            return None;
        }
        let mut sorted: Vec<(u64, u64)> = self.counts.iter().map(|(step, count)| (*step, *count)).collect();
        sorted.sort_unstable();
        let at = |rank: u64| {
            let mut passed = 0;
            sorted
                .iter()
                .find(|(_, count)| {
                    passed += count;
                    passed > rank
                })
                .map_or(0.0, |(step, _)| *step as f64)
        };
        Some(0.5 * (at((total - 1) / 2) + at(total / 2)))
    }
}

/// `step` with all but its leading bits replaced by the middle of what they may be.
fn rounded(step: u64, kept_bits: Option<u32>) -> u64 {
    let length = u64::BITS - step.leading_zeros();
    match kept_bits {
        Some(kept) if length > kept => {
            let dropped = length - kept;
            (step >> dropped << dropped) | (1 << (dropped - 1))
        }
        _ => step,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_read_to_the_nanosecond() {
        for (text, nanos) in [
            ("1710358267.729695082", Some(1_710_358_267_729_695_082)),
            ("0.008780029081872982", Some(8_780_029)),
            ("0.0000000015", Some(2)),
            ("-1.5", Some(-1_500_000_000)),
            ("12", Some(12_000_000_000)),
            (".5", Some(500_000_000)),
            ("5.", Some(5_000_000_000)),
            ("2.5e-2", Some(25_000_000)),
            ("", None),
            (".", None),
            ("1.2.3", None),
            ("NaN", None),
            ("inf", None),
            ("1e30", None),
            ("99999999999999", None),
            ("12:30", None),
        ] {
            assert_eq!(parse_seconds(text), nanos, "{text:?}");
        }
    }

    #[test]
    fn the_median_is_that_of_all_steps() {
        let mut median = StepMedian::default();
        assert_eq!(median.median_ns(), None);
        for step in [30, 10, 20, 1000] {
            median.add(step);
        }
        assert_eq!(median.median_ns(), Some(25.0));
        median.add(20);
        assert_eq!(median.median_ns(), Some(20.0));
    }

    #[test]
    fn the_median_of_a_million_distinct_steps_takes_bounded_memory() {
        let mut median = StepMedian::default();
        let true_median = 25_000_000_u64;
        for i in 0..500_000_u64 {
            median.add(true_median + 7 * i + 1);
            median.add(true_median - 7 * i - 1);
        }
        assert!(median.counts.len() <= DISTINCT_MAX);
        let error = median.median_ns().unwrap() / true_median as f64 - 1.0;
        assert!(error.abs() < 1e-6, "{error}");
    }
}
