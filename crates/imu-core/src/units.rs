//! Units and conversions: the meaning of numbers, in one place.
//!
//! Inside the program every quantity has the unit that a VN-100 sends (rad/s, m/s², gauss, degrees, °C, kPa); times are
//! integer nanoseconds. Other units in common use (°/h, mg…) exist only in input and output.

use std::time::Duration;

/// Standard gravity in m/s² (exact by definition, CGPM 1901).
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;
/// Radians in one degree.
pub const RAD_PER_DEG: f64 = std::f64::consts::PI / 180.0;
/// Seconds in one hour.
pub const SECONDS_PER_HOUR: f64 = 3600.0;
/// √s in one √h: 1 (deg/s)/√Hz is 60 deg/√h.
pub const SQRT_SECONDS_PER_SQRT_HOUR: f64 = 60.0;
/// Tesla in one gauss.
pub const TESLA_PER_GAUSS: f64 = 1e-4;
/// Microtesla in one gauss.
pub const MICROTESLA_PER_GAUSS: f64 = 100.0;
/// Gauss in one tesla.
pub const GAUSS_PER_TESLA: f64 = 1e4;
/// Nanoseconds in one second.
pub const NANOS_PER_SECOND: u64 = 1_000_000_000;
/// Internal sampling rate of the VN-100's IMU in Hz (user manual UM001 rev 2.45, register 75: rate = 800 Hz / divisor).
pub const IMU_RATE_HZ: f64 = 800.0;

/// The dimension of a quantity. Its purpose is that quantities of different dimensions cannot be compared.
pub trait Dimension: Copy + std::fmt::Debug + PartialOrd {
    /// The unit of stored values: the one that a VN-100 sends.
    const UNIT: &'static str;
}

/// Angular rate, held in rad/s.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct AngularRate;
/// Specific force, held in m/s².
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Acceleration;
/// Magnetic field, held in gauss.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct MagneticField;

impl Dimension for AngularRate {
    const UNIT: &'static str = "rad/s";
}
impl Dimension for Acceleration {
    const UNIT: &'static str = "m/s²";
}
impl Dimension for MagneticField {
    const UNIT: &'static str = "gauss";
}

/// A size of dimension `D`, created only by naming its unit.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Quantity<D: Dimension> {
    value: f64,
    dimension: std::marker::PhantomData<D>,
}

/// A noise density of dimension `D`: per root hertz.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Density<D: Dimension>(Quantity<D>);

impl<D: Dimension> Quantity<D> {
    /// Returns a value in the unit that `D` is held in.
    pub const fn held(value: f64) -> Self {
        Self { value, dimension: std::marker::PhantomData }
    }
    /// Returns the value in the unit that `D` is held in.
    pub fn value(self) -> f64 {
        self.value
    }
    /// Returns this size per root hertz.
    pub fn per_root_hertz(self) -> Density<D> {
        Density(self)
    }
    /// Returns the size times a number.
    pub fn times(self, factor: f64) -> Self {
        Self::held(self.value * factor)
    }
}

impl<D: Dimension> Density<D> {
    /// Returns the value in the unit that `D` is held in, per root hertz.
    pub fn value(self) -> f64 {
        self.0.value
    }
    /// Returns the density times a number.
    pub fn times(self, factor: f64) -> Self {
        Self(self.0.times(factor))
    }
}

impl Quantity<AngularRate> {
    /// Creates a rate from degrees per second.
    pub fn deg_per_s(value: f64) -> Self {
        Self::held(value * RAD_PER_DEG)
    }
    /// Creates a rate from degrees per hour.
    pub fn deg_per_h(value: f64) -> Self {
        Self::deg_per_s(value / SECONDS_PER_HOUR)
    }
}

impl Quantity<Acceleration> {
    /// Creates an acceleration from thousandths of standard gravity.
    pub fn mg(value: f64) -> Self {
        Self::held(value * 1e-3 * STANDARD_GRAVITY_M_S2)
    }
}

impl Quantity<MagneticField> {
    /// Creates a field from millionths of a gauss.
    pub fn microgauss(value: f64) -> Self {
        Self::held(value * 1e-6)
    }
}

/// Returns the period of `rate_hz` in nanoseconds (not rounded).
pub fn period_ns(rate_hz: f64) -> f64 {
    NANOS_PER_SECOND as f64 / rate_hz
}

/// The error of a text that is not a duration.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{found}` is not a duration: expected a number with a unit, such as 5h, 90m, 30s or 500ms")]
pub struct DurationError {
    /// The given text.
    pub found: String,
}

/// Parses a duration as the command line and the API write it: `5h`, `90m`, `30s`, `500ms`, `1.5h`, `5h30m`.
///
/// # Errors
/// [`DurationError`] if a number or its unit is missing or unknown, or the total does not fit.
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

/// Returns a decimal number times a unit, exactly, rounded to an integer; `None` if it is not a number or does not fit.
fn times(number: &str, unit: u128) -> Option<u128> {
    /// Maximum number of relevant digits behind the point: a unit has at most fourteen.
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

/// Writes a duration in the form that [`parse_duration`] reads, in the largest units that are exact: `5h`, `1h30m`,
/// `754.45s`.
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
    /// The error that the serializer reports.
    pub fn serialize<S: Serializer>(duration: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&super::format_duration(*duration))
    }

    /// Reads the duration from text.
    ///
    /// # Errors
    /// The error of a text that is not a duration.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
        let text = String::deserialize(deserializer)?;
        super::parse_duration(&text).map_err(serde::de::Error::custom)
    }
}

/// Returns a count with its noun, or with its noun and verb: `1 gap`, `2 gaps`, `1 sample is`.
pub fn counted(count: u64, one: &str, several: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { several })
}

/// Returns a rate for people, in Hz: two decimals, or three digits of a rate below 1 Hz, without trailing zeros.
pub fn hertz(rate_hz: f64) -> String {
    let decimals = if rate_hz > 0.0 && rate_hz < 1.0 { (2.0 - rate_hz.log10().floor()).clamp(2.0, 12.0) } else { 2.0 };
    let text = format!("{rate_hz:.*}", decimals as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_agree_with_their_nouns_and_rates_have_few_digits() {
        assert_eq!([0, 1, 2].map(|count| counted(count, "gap", "gaps")), ["0 gaps", "1 gap", "2 gaps"]);
        let rates =
            [(39.987_65, "39.99"), (40.0, "40"), (800.0, "800"), (0.1, "0.1"), (0.012_345, "0.0123"), (99.999, "100")];
        rates.into_iter().for_each(|(rate_hz, text)| assert_eq!(hertz(rate_hz), text));
    }

    #[test]
    fn quoted_units_become_the_units_that_are_held() {
        assert!((Quantity::deg_per_s(0.0035).value() - 6.109e-5).abs() < 1e-8);
        assert!((Quantity::deg_per_h(10.0).value() - 4.848e-5).abs() < 1e-8);
        assert!((Quantity::mg(0.14).per_root_hertz().value() - 1.373e-3).abs() < 1e-6);
        assert!((Quantity::mg(0.04).value() - 3.923e-4).abs() < 1e-7);
        assert!((Quantity::microgauss(140.0).value() - 1.4e-4).abs() < 1e-12);
        // 140 µgauss are 14 nT.
        assert!((Quantity::microgauss(140.0).value() * TESLA_PER_GAUSS - 1.4e-8).abs() < 1e-16);
        assert!((MICROTESLA_PER_GAUSS - 1e6 * TESLA_PER_GAUSS).abs() < 1e-9);
        assert!((GAUSS_PER_TESLA * TESLA_PER_GAUSS - 1.0).abs() < 1e-12);
        assert!((SQRT_SECONDS_PER_SQRT_HOUR.powi(2) - SECONDS_PER_HOUR).abs() < 1e-9);
        assert!(Quantity::deg_per_s(1.0) > Quantity::deg_per_h(3599.0));
        // `Quantity::mg(1.0) > Quantity::deg_per_h(1.0)` does not compile.
    }

    #[test]
    fn durations_are_read_as_documented() {
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
