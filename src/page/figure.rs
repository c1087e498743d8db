//! Figures: numbers as a person reads them.

use serde::{Deserialize, Deserializer};

/// A number; what was not finite and was therefore written as null is none, and shown as a dash.
pub(super) fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

/// The same for two.
pub(super) fn pair<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    let pair: [Option<f64>; 2] = Deserialize::deserialize(from)?;
    Ok(pair.map(|value| value.unwrap_or(f64::NAN)))
}

/// The same for a list.
pub(super) fn numbers<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    let list: Vec<Option<f64>> = Vec::deserialize(from)?;
    Ok(list.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect())
}

/// The same for a list that may be absent.
pub(super) fn numbers_or_none<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Vec<f64>>, D::Error> {
    let list: Option<Vec<Option<f64>>> = Option::deserialize(from)?;
    Ok(list.map(|list| list.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect()))
}

/// A number with four digits: plain where it is neither small nor large, else times a power of ten.
pub(super) fn plain(value: f64) -> String {
    rounded(value, 4)
}

/// A number with as many digits as its interval tells apart, and the interval.
pub(super) fn with_interval(value: f64, [low, high]: [f64; 2]) -> String {
    let (size, width) = (value.abs().max(low.abs()).max(high.abs()), (high - low).abs());
    let digits = if width > 0.0 && size > 0.0 { ((size / width).log10().ceil() as i64 + 2).clamp(3, 9) } else { 6 };
    let digits = usize::try_from(digits).unwrap_or(4);
    format!("{} ({} to {})", rounded(value, digits), rounded(low, digits), rounded(high, digits))
}

/// A share in percent; small differences from 0 and 100 are none of a reader's.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.0} %", 100.0 * share) } else { "–".to_owned() }
}

/// A time to the second.
pub(super) fn second(time_s: f64) -> String {
    if time_s.is_finite() { format!("{time_s:.0}") } else { "–".to_owned() }
}

fn rounded(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    if value == 0.0 {
        return "0".to_owned();
    }
    let written = format!("{value:.*e}", digits.saturating_sub(1));
    let Some((mantissa, exponent)) = written.split_once('e') else { return written };
    let power: i32 = exponent.parse().unwrap_or(0);
    if (-3..5).contains(&power) {
        let decimals = (digits as i32 - 1 - power).max(0) as usize;
        let text = format!("{value:.decimals$}");
        return shortened(&text).replace('-', "−");
    }
    let raised: String = exponent.chars().map(raised).collect();
    format!("{}·10{raised}", shortened(mantissa).replace('-', "−"))
}

/// Without zeros that say nothing.
fn shortened(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

fn raised(digit: char) -> char {
    match digit {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        other => other.to_digit(10).and_then(|number| char::from_u32(0x2070 + number)).unwrap_or(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_intervals_are_told_apart() {
        for (value, text) in [
            (0.0, "0"),
            (11.4, "11.4"),
            (-9.79465, "−9.795"),
            (0.002, "0.002"),
            (3.52e-4, "3.52·10⁻⁴"),
            (720_000.0, "7.2·10⁵"),
            (12_345.6, "12346"),
            (-1e-12, "−1·10⁻¹²"),
        ] {
            assert_eq!(plain(value), text);
        }
        assert_eq!(with_interval(11.399_999_8, [11.399_998_9, 11.400_000_7]), "11.3999998 (11.3999989 to 11.4000007)");
        assert_eq!(with_interval(1.9557e-3, [1.8976e-3, 2.0137e-3]), "0.001956 (0.001898 to 0.002014)");
        assert_eq!(with_interval(2.0, [2.0, 2.0]), "2 (2 to 2)");
        assert_eq!(percent(0.994), "99 %");
    }
}
