//! Units and conversions: what a number means, in one place.
//!
//! Inside the program every quantity carries the unit that a VN-100 sends (rad/s, m/s², gauss, degrees,
//! °C, kPa); times are integer nanoseconds. Units people quote (°/h, mg…) exist only at the edges.

use std::time::Duration;

/// Standard gravity in m/s² (exact by definition, CGPM 1901).
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;
/// Radians in one degree.
pub const RAD_PER_DEG: f64 = std::f64::consts::PI / 180.0;
/// Seconds in one hour.
pub const SECONDS_PER_HOUR: f64 = 3600.0;
/// Nanoseconds in one second.
pub const NANOS_PER_SECOND: u64 = 1_000_000_000;
/// Internal sampling rate of the VN-100's IMU in Hz (user manual UM001 rev 2.45, register 75: rate = 800 Hz / divisor).
pub const IMU_RATE_HZ: f64 = 800.0;

/// The period of `rate_hz` in nanoseconds (not rounded).
#[must_use]
pub fn period_ns(rate_hz: f64) -> f64 {
    NANOS_PER_SECOND as f64 / rate_hz
}

/// Why a duration was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{found}` is not a duration: expected a number with a unit, such as 5h, 90m, 30s or 500ms")]
pub struct DurationError {
    /// The text as it was given.
    pub found: String,
}

/// Parses a duration as the command line and the API write it: `5h`, `90m`, `30s`, `500ms`, `1.5h`, `5h30m`.
///
/// # Errors
/// [`DurationError`] where a number or its unit is missing or unknown, or the total does not fit.
pub fn parse_duration(text: &str) -> Result<Duration, DurationError> {
    let refuse = || DurationError { found: text.to_owned() };
    let mut rest = text.trim();
    if rest.is_empty() {
        return Err(refuse());
    }
    let mut total_ns = 0_u128;
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !(c.is_ascii_digit() || c == '.')).ok_or_else(refuse)?;
        let (number, tail) = rest.split_at(digits);
        let letters = tail.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(tail.len());
        let (unit, tail) = tail.split_at(letters);
        let unit_ns = match unit {
            "d" => 86_400 * 1_000_000_000,
            "h" => 3600 * 1_000_000_000,
            "m" | "min" => 60 * 1_000_000_000,
            "s" => 1_000_000_000,
            "ms" => 1_000_000,
            _ => return Err(refuse()),
        };
        total_ns = times(number, unit_ns).and_then(|ns| total_ns.checked_add(ns)).ok_or_else(refuse)?;
        rest = tail;
    }
    let seconds = u64::try_from(total_ns / u128::from(NANOS_PER_SECOND)).map_err(|_| refuse())?;
    Ok(Duration::new(seconds, (total_ns % u128::from(NANOS_PER_SECOND)) as u32))
}

/// A decimal number times a unit, exactly, rounded to a whole; `None` where it is no number or does not fit.
fn times(number: &str, unit: u128) -> Option<u128> {
    /// Digits behind the point that can matter: a unit has at most fourteen.
    const FRACTION_DIGITS: usize = 18;
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    if whole.is_empty() && fraction.is_empty() || fraction.contains('.') {
        return None;
    }
    let whole: u128 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
    let fraction = fraction.get(..FRACTION_DIGITS).unwrap_or(fraction);
    let parts: u128 = if fraction.is_empty() { 0 } else { fraction.parse().ok()? };
    let scale = 10_u128.pow(fraction.len() as u32);
    whole.checked_mul(unit)?.checked_add((parts * unit + scale / 2) / scale)
}

/// Writes a duration the way [`parse_duration`] reads it, in the largest units that lose nothing: `5h`, `1h30m`, `754.45s`.
#[must_use]
pub fn format_duration(duration: Duration) -> String {
    let total_ms = duration.as_millis();
    if total_ms < 1000 && duration.subsec_nanos().is_multiple_of(1_000_000) {
        return format!("{total_ms}ms");
    }
    let whole = duration.as_secs();
    let (hours, minutes) = (whole / 3600, whole % 3600 / 60);
    let seconds = (whole % 60) as f64 + f64::from(duration.subsec_nanos()) / 1e9;
    let mut text = String::new();
    if hours > 0 {
        text.push_str(&format!("{hours}h"));
    }
    if minutes > 0 {
        text.push_str(&format!("{minutes}m"));
    }
    if seconds > 0.0 || text.is_empty() {
        text.push_str(&format!("{seconds}s"));
    }
    text
}

/// Serde form of a [`Duration`] as the text of [`parse_duration`].
pub mod duration_text {
    use serde::{Deserialize, Deserializer, Serializer};
    use std::time::Duration;

    /// Writes the duration as text.
    ///
    /// # Errors
    /// Whatever the serializer reports.
    pub fn serialize<S: Serializer>(duration: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&super::format_duration(*duration))
    }

    /// Reads the duration from text.
    ///
    /// # Errors
    /// Where the text is not a duration.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
        let text = String::deserialize(deserializer)?;
        super::parse_duration(&text).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_read_as_the_contract_writes_them() {
        assert_eq!(parse_duration("5h").unwrap(), Duration::from_secs(18_000));
        assert_eq!(parse_duration("90m").unwrap(), Duration::from_secs(5_400));
        assert_eq!(parse_duration("30s").unwrap(), Duration::from_secs(30));
        assert_eq!(parse_duration("500ms").unwrap(), Duration::from_millis(500));
        assert_eq!(parse_duration("1.5h").unwrap(), Duration::from_secs(5_400));
        assert_eq!(parse_duration("5h30m").unwrap(), Duration::from_secs(19_800));
        assert_eq!(parse_duration("754.45s").unwrap(), Duration::from_millis(754_450));
    }

    #[test]
    fn a_duration_without_unit_or_with_an_unknown_one_is_refused() {
        for text in ["", "5", "h", "5 h", "-5h", "5x", "1e9h", "NaNs", "99999999999999999999h"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_duration_written_is_read_back() {
        for text in ["5h", "1h30m", "30s", "500ms", "12m34.5s", "0ms"] {
            let duration = parse_duration(text).unwrap();
            assert_eq!(parse_duration(&format_duration(duration)).unwrap(), duration, "{text}");
        }
    }
}
