//! Quantities for people: degrees instead of radians, three significant digits.

use crate::request::Quantity;
use imu_core::units::RAD_PER_DEG;

/// Returns a number with three significant digits.
pub fn number(value: f64) -> String {
    // The exponent after rounding: 0.99999 is 1.00.
    let rounded = format!("{value:.2e}");
    let exponent = rounded.split_once('e').and_then(|(_, exponent)| exponent.parse::<i32>().ok());
    match exponent {
        _ if value == 0.0 => "0".to_owned(),
        Some(exponent @ -3..=4) => format!("{value:.*}", usize::try_from(2 - exponent).unwrap_or(0)),
        _ => rounded,
    }
}

/// Returns a time, s, in s, min or h with at most three significant digits.
pub fn time(time_s: f64) -> String {
    let (value, unit) = match time_s {
        of if of < 60.0 => (of, "s"),
        of if of < 3600.0 => (of / 60.0, "min"),
        of => (of / 3600.0, "h"),
    };
    let digits = number(value);
    let digits = if digits.contains('.') && !digits.contains('e') {
        digits.trim_end_matches('0').trim_end_matches('.')
    } else {
        &digits
    };
    format!("{digits} {unit}")
}

impl Quantity {
    /// Returns the factor from the quantity's unit to the shown one, and the shown one: `°`, `m/s` or `m`.
    pub fn shown_in(self) -> (f64, &'static str) {
        match self.unit() {
            "rad" => (1.0 / RAD_PER_DEG, "°"),
            unit => (1.0, unit),
        }
    }

    /// Returns a value of the quantity, in its unit, as a text with the shown unit.
    pub fn with_unit(self, value: f64) -> String {
        let (factor, unit) = self.shown_in();
        match unit {
            "°" => format!("{}°", number(factor * value)),
            "m" if value >= 1e4 => format!("{} km", number(1e-3 * value)),
            _ => format!("{} {unit}", number(value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_significant_digits() {
        let shown = [0.0, 1.0, 0.123_45, 12_345.0, -99.9, 1.234e-5, 2.5e7].map(number);
        assert_eq!(shown, ["0", "1.00", "0.123", "12345", "-99.9", "1.23e-5", "2.50e7"]);
        assert_eq!([0.999_99, 9.996, 0.000_999_9, 99_999.0].map(number), ["1.00", "10.0", "0.00100", "1.00e5"]);
        assert_eq!(
            [0.5, 10.0, 90.0, 600.0, 3600.0, 18_000.0, 0.0].map(time),
            ["0.5 s", "10 s", "1.5 min", "10 min", "1 h", "5 h", "0 s"]
        );
        assert_eq!(Quantity::Heading.with_unit(RAD_PER_DEG), "1.00°");
        assert_eq!(Quantity::PositionX.with_unit(12_300.0), "12.3 km");
    }
}
