//! Numbers for a terminal: digits by the interval, rates, counts with their noun. Powers of ten are written as programs
//! read them (`1.95e-4`).

use crate::page::digits;
use imu_core::units;

/// Returns a number with this many significant digits.
pub(super) fn rounded(value: f64, digits: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { "–".to_owned() };
    }
    let written = format!("{value:.*e}", digits.saturating_sub(1));
    let power: i32 = written.split_once('e').and_then(|(_, power)| power.parse().ok()).unwrap_or_default();
    if (-2..5).contains(&power) {
        let decimals = usize::try_from(digits as i32 - 1 - power).unwrap_or_default();
        return format!("{value:.decimals$}");
    }
    written
}

/// Returns a value and its interval with as many digits as the interval distinguishes.
pub(super) fn with_interval(value: f64, [low, high]: [f64; 2]) -> String {
    let digits = digits(value, [low, high]);
    // An end that is far smaller than the value has no more decimals than the value.
    let [value, low, high] = [value, low, high].map(|of| rounded(of, digits));
    format!("{value} [{low}, {high}]")
}

/// Returns a rate in Hz: two decimals, or three digits of a rate below 1 Hz, without trailing zeros.
pub(super) fn hertz(rate_hz: f64) -> String {
    format!("{} Hz", units::hertz(rate_hz))
}

/// Returns a time of RFC 3339 in UTC without its fraction of a second.
pub(super) fn to_the_second(rfc3339: &str) -> String {
    rfc3339.split_once('.').map_or_else(|| rfc3339.to_owned(), |(whole, _)| format!("{whole}Z"))
}

/// Returns a count with its noun in the singular or the plural.
pub(super) fn counted(count: impl Into<u64>, one: &str, several: &str) -> String {
    units::counted(count.into(), one, several)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_their_interval_distinguishes() {
        assert_eq!(with_interval(1.953_4e-4, [1.936e-4, 1.971e-4]), "1.953e-4 [1.936e-4, 1.971e-4]");
        assert_eq!(with_interval(5.165, [3.804, 7.431]), "5.17 [3.80, 7.43]");
        assert_eq!(with_interval(4.232e-5, [0.0, 7.36e-5]), "4.23e-5 [0, 7.36e-5]");
        assert_eq!(with_interval(13.378_123, [13.377_9, 13.378_4]), "13.37812 [13.37790, 13.37840]");
    }

    #[test]
    fn rates_shares_and_counts_read_as_people_write_them() {
        assert_eq!([39.987_654_3, 40.0, 0.012_34, 200.0].map(hertz), ["39.99 Hz", "40 Hz", "0.0123 Hz", "200 Hz"]);
        assert_eq!((counted(1_u64, "gap", "gaps"), counted(2_u64, "gap", "gaps")), ("1 gap".into(), "2 gaps".into()));
    }
}
