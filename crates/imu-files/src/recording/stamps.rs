//! Stamps: converts decimal text to integer nanoseconds without loss, and computes the median of the steps between them
//! in bounded memory.

use imu_core::units::NANOS_PER_SECOND;

/// Stamps in seconds above this are taken as time since 1970 (it corresponds to March 1973; no recording runs three
/// years).
pub(super) const UNIX_FROM_NS: i64 = 100_000_000 * NANOS_PER_SECOND as i64;

/// Converts a stamp as decimal text to nanoseconds, rounded at the next decimal, in any unit of which a nanosecond is the `places`th
/// decimal: 9 for seconds, 6 for ms, 3 for µs, 0 for ns. `None` if the text is no number or the time lies beyond 292 years.
///
/// This does not use `f64`, which resolves a time since 1970 only to 240 ns.
pub(super) fn parse_stamp(text: &[u8], places: usize) -> Option<i64> {
    let (negative, digits) = match text.first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let point = digits.iter().position(|byte| *byte == b'.');
    let (whole, fraction) = point.map_or((digits, &[][..]), |point| (&digits[..point], &digits[point + 1..]));
    let plain = |part: &[u8]| part.iter().all(u8::is_ascii_digit);
    if whole.is_empty() && fraction.is_empty() || !plain(whole) || !plain(fraction) {
        // Exponents, and text that is no number.
        let nanos = std::str::from_utf8(text).ok()?.parse::<f64>().ok()? * 10_f64.powi(places as i32);
        return (nanos.abs() < i64::MAX as f64).then_some(nanos.round() as i64);
    }
    let digit = |byte: &u8| i64::from(byte - b'0');
    let mut total = 0_i64;
    for byte in whole {
        total = total.checked_mul(10)?.checked_add(digit(byte))?;
    }
    for position in 0..places {
        total = total.checked_mul(10)?.checked_add(fraction.get(position).map_or(0, digit))?;
    }
    total = total.checked_add(i64::from(fraction.get(places).is_some_and(|next| *next >= b'5')))?;
    Some(if negative { -total } else { total })
}

/// Converts a date of ISO 8601 with a time of day to nanoseconds since 1970; one without a zone counts as UTC.
pub(super) fn parse_date(text: &[u8]) -> Option<i64> {
    if !matches!(text.get(4), Some(b'-' | b'/')) || !text.contains(&b':') {
        return None;
    }
    // ISO 8601 permits a comma before the fraction; others write slashes, or the zone's name.
    let text = std::str::from_utf8(text).ok()?.trim().replacen(',', ".", 1).replacen('/', "-", 2);
    let of_utc = text.strip_suffix("UTC").or(text.strip_suffix("GMT"));
    let text = of_utc.map_or(text.as_str(), str::trim_end);
    let zones = ["%Y-%m-%dT%H:%M:%S%.f%z", "%Y-%m-%d %H:%M:%S%.f%z", "%Y-%m-%d %H:%M:%S%.f %z"];
    let other = || zones.iter().find_map(|form| chrono::DateTime::parse_from_str(text, form).ok());
    let with_zone = chrono::DateTime::parse_from_rfc3339(text).ok().or_else(other).map(|date| date.to_utc());
    let without = || {
        let forms = ["%Y-%m-%dT%H:%M:%S%.f", "%Y-%m-%d %H:%M:%S%.f"];
        forms.iter().find_map(|form| chrono::NaiveDateTime::parse_from_str(text, form).ok()).map(|date| date.and_utc())
    };
    with_zone.or_else(without)?.timestamp_nanos_opt()
}

/// The maximum number of stamps kept per row.
pub(super) const STAMPS_MAX: usize = 4;

/// The stamps that a row carries, ns, in their order in the row; of more than [`STAMPS_MAX`] the last ones.
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
    pub(super) fn set(&mut self, column: usize, stamp_ns: i64) {
        if let Some(own) = self.nanos[..self.count].get_mut(column) {
            *own = stamp_ns;
        }
    }
    pub(super) fn get(&self, column: usize) -> Option<i64> {
        self.nanos[..self.count].get(column).copied()
    }
}

/// Distinct steps that are counted exactly.
const DISTINCT_MAX: usize = 1 << 18;
/// Leading bits of a step that are kept when there are more (a relative error of 6e-8 at first).
const KEPT_BITS: u32 = 24;

/// Steps that are gathered before they are merged into the table.
const GATHERED: usize = 1 << 15;

/// The median of steps. It is exact for up to [`DISTINCT_MAX`] distinct ones; beyond that its relative error is 6e-8
/// or, for ever more scattered ones, worse by powers of two. Memory stays below 16 MB.
///
/// A regular recording repeats one step, which is counted directly. Other steps are gathered, sorted and merged by the
/// ten thousand, which costs a third of looking each one up.
#[derive(Debug, Default)]
pub(super) struct StepMedian {
    /// Distinct steps and how often each came, increasing.
    counts: Vec<(u64, u64)>,
    /// Steps not merged yet, with how often each came in a row.
    gathered: Vec<(u64, u64)>,
    total: u64,
    /// Leading bits kept; `None` keeps all.
    kept_bits: Option<u32>,
}

impl StepMedian {
    pub(super) fn add(&mut self, step_ns: u64) {
        self.total += 1;
        match self.gathered.last_mut() {
            Some((step, count)) if *step == step_ns => *count += 1,
            _ => {
                if self.gathered.len() == GATHERED {
                    self.merge();
                }
                self.gathered.push((step_ns, 1));
            }
        }
    }

    fn merge(&mut self) {
        let gathered = std::mem::take(&mut self.gathered);
        self.counts = self.merged(gathered);
        while self.counts.len() > DISTINCT_MAX {
            self.kept_bits = Some(self.kept_bits.map_or(KEPT_BITS, |bits| bits - 1));
            // Rounding preserves the order.
            let coarse = std::mem::take(&mut self.counts);
            for (step, count) in coarse {
                push(&mut self.counts, rounded(step, self.kept_bits), count);
            }
        }
    }

    /// Returns the table with these steps in it.
    fn merged(&self, mut gathered: Vec<(u64, u64)>) -> Vec<(u64, u64)> {
        for (step, _) in &mut gathered {
            *step = rounded(*step, self.kept_bits);
        }
        gathered.sort_unstable();
        let mut merged = Vec::with_capacity(self.counts.len() + gathered.len());
        let mut known = self.counts.iter().copied().peekable();
        for (step, count) in gathered {
            while let Some((smaller, times)) = known.next_if(|(known, _)| *known <= step) {
                push(&mut merged, smaller, times);
            }
            push(&mut merged, step, count);
        }
        for (step, count) in known {
            push(&mut merged, step, count);
        }
        merged
    }

    /// Returns distinct steps, ns, and how often each came, increasing.
    pub(super) fn counted(&self) -> Vec<(u64, u64)> {
        self.merged(self.gathered.clone())
    }

    /// Returns the number of steps.
    pub(super) fn total(&self) -> u64 {
        self.total
    }

    #[cfg(test)]
    fn median_ns(&self) -> Option<f64> {
        median_of(&self.counted())
    }
}

/// Appends a step to an increasing table.
fn push(table: &mut Vec<(u64, u64)>, step: u64, count: u64) {
    match table.last_mut() {
        Some((last, times)) if *last == step => *times += count,
        _ => table.push((step, count)),
    }
}

/// Returns the median of the steps counted in an increasing table; of an even number the mean of the middle two.
pub(super) fn median_of(counted: &[(u64, u64)]) -> Option<f64> {
    let total: u64 = counted.iter().map(|(_, count)| count).sum();
    let at = |rank: u64| {
        let mut passed = 0;
        let found = counted.iter().find(|(_, count)| {
            passed += count;
            passed > rank
        });
        found.map_or(0.0, |(step, _)| *step as f64)
    };
    (total > 0).then(|| 0.5 * (at((total - 1) / 2) + at(total / 2)))
}

/// Returns `step` with all but its leading bits replaced by the middle of their range.
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
            assert_eq!(parse_stamp(text.as_bytes(), 9), nanos, "{text:?}");
        }
    }

    #[test]
    fn stamps_of_any_unit_are_read_to_the_nanosecond() {
        for (text, places, nanos) in [
            ("25", 6, Some(25_000_000)),
            ("25.0000005", 6, Some(25_000_001)),
            ("1710358267729.695082", 6, Some(1_710_358_267_729_695_082)),
            ("1710358267729695.082", 3, Some(1_710_358_267_729_695_082)),
            ("1710358267729695082", 0, Some(1_710_358_267_729_695_082)),
            ("7.5", 0, Some(8)),
            ("1.5e3", 3, Some(1_500_000)),
            ("-2", 3, Some(-2_000)),
            ("99999999999999999999", 0, None),
            ("", 6, None),
        ] {
            assert_eq!(parse_stamp(text.as_bytes(), places), nanos, "{text:?} {places}");
        }
    }

    #[test]
    fn dates_are_times_since_1970_in_utc() {
        for (text, nanos) in [
            ("2024-03-13T19:31:07.729695082Z", Some(1_710_358_267_729_695_082)),
            ("2024-03-13T20:31:07.5+01:00", Some(1_710_358_267_500_000_000)),
            ("2024-03-13 19:31:07.5", Some(1_710_358_267_500_000_000)),
            ("2024-03-13T19:31:07", Some(1_710_358_267_000_000_000)),
            ("2024-03-13T20:31:07,5+0100", Some(1_710_358_267_500_000_000)),
            ("2024-03-13 11:31:07.5 -08:00", Some(1_710_358_267_500_000_000)),
            ("2024/03/13 19:31:07.5", Some(1_710_358_267_500_000_000)),
            ("2024-03-13 19:31:07.5 UTC", Some(1_710_358_267_500_000_000)),
            ("2024-03-13", None),
            ("19:31:07", None),
            ("2024-13-13T19:31:07Z", None),
            ("", None),
        ] {
            assert_eq!(parse_date(text.as_bytes()), nanos, "{text:?}");
        }
    }

    #[test]
    fn steps_are_counted_in_whatever_order_they_come() {
        let mut steps = StepMedian::default();
        let mut state = 1_u64;
        let mut all: Vec<u64> = Vec::new();
        for _ in 0..100_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let step = 24_000_000 + (state >> 33) % 2_000;
            steps.add(step);
            all.push(step);
        }
        all.sort_unstable();
        assert_eq!(steps.median_ns(), Some(0.5 * (all[49_999] + all[50_000]) as f64));
        let counted = steps.counted();
        assert!(counted.is_sorted_by(|(one, _), (other, _)| one < other));
        let below = counted.iter().filter(|(step, _)| *step < 24_000_500).map(|(_, count)| count).sum::<u64>();
        assert_eq!(below as usize, all.iter().filter(|step| **step < 24_000_500).count());
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
        assert!(median.counts.len() <= DISTINCT_MAX && median.gathered.len() <= GATHERED);
        assert_eq!(median.total(), 1_000_000);
        assert_eq!(median.counted().iter().map(|(_, count)| count).sum::<u64>(), 1_000_000);
        let error = median.median_ns().unwrap() / true_median as f64 - 1.0;
        assert!(error.abs() < 1e-6, "{error}");
    }
}
