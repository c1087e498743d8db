//! Figures: numbers, intervals and shares as a person reads them.

pub(super) use crate::plot::number::plain;
use crate::plot::number::rounded;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_told_apart() {
        assert_eq!(with_interval(11.399_999_8, [11.399_998_9, 11.400_000_7]), "11.3999998 (11.3999989 to 11.4000007)");
        assert_eq!(with_interval(1.9557e-3, [1.8976e-3, 2.0137e-3]), "0.001956 (0.001898 to 0.002014)");
        assert_eq!(with_interval(2.0, [2.0, 2.0]), "2 (2 to 2)");
        assert_eq!(percent(0.994), "99 %");
    }
}
