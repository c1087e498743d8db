//! Figures: numbers, intervals and shares for display.

pub(super) use crate::plot::number::plain;
use crate::plot::number::rounded;

/// Returns a number with as many digits as its interval distinguishes, and the interval.
pub(super) fn with_interval(value: f64, ends: [f64; 2]) -> String {
    let (value, interval) = parted(value, ends);
    format!("{value} ({interval})")
}

/// Returns the number and its interval, as separate texts.
pub(super) fn parted(value: f64, [low, high]: [f64; 2]) -> (String, String) {
    let digits = digits(value, [low, high]);
    (rounded(value, digits), format!("{} to {}", rounded(low, digits), rounded(high, digits)))
}

/// Returns the number of significant digits that an interval distinguishes.
pub fn digits(value: f64, [low, high]: [f64; 2]) -> usize {
    let (size, width) = (value.abs().max(low.abs()).max(high.abs()), (high - low).abs());
    let digits = if width > 0.0 && size > 0.0 { ((size / width).log10().ceil() as i64 + 2).clamp(3, 9) } else { 6 };
    usize::try_from(digits).unwrap_or(4)
}

/// Returns a share in percent; small differences from 0 and 100 are not shown.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.0} %", 100.0 * share) } else { "–".to_owned() }
}

/// Returns a part of a whole in percent: what is measured beside it, below nothing or above everything, is chance.
pub fn part(share: f64) -> String {
    percent(if share.is_finite() { share.clamp(0.0, 1.0) } else { share })
}

/// Returns a time to the second.
pub(super) fn second(time_s: f64) -> String {
    if time_s.is_finite() { format!("{time_s:.0}") } else { "–".to_owned() }
}

/// Returns a span of time for display: 2 years, 5 h, 2 h 14 min, 90 s.
pub fn span(time_s: f64) -> String {
    if !time_s.is_finite() || time_s < 0.0 {
        return "–".to_owned();
    }
    const DAY_S: u64 = 86_400;
    let whole = time_s.round() as u64;
    // Of weeks and years nobody wants the hours.
    match whole / DAY_S {
        days @ 14..=60 => return format!("{days} days"),
        days @ 61..=729 => return format!("{:.0} months", days as f64 / 30.44),
        days @ 730.. => return format!("{:.0} years", days as f64 / 365.25),
        _ => {}
    }
    let parts = [(whole / DAY_S, "d"), (whole / 3600 % 24, "h"), (whole / 60 % 60, "min"), (whole % 60, "s")];
    let first = parts.iter().position(|(count, _)| *count > 0).unwrap_or(3);
    // Two neighbouring units are enough: seconds are irrelevant to a night.
    let units = parts[first..].iter().take(2).filter(|(count, _)| *count > 0);
    let units: Vec<String> = units.map(|(count, unit)| format!("{count} {unit}")).collect();
    if units.is_empty() { "0 s".to_owned() } else { units.join(" ") }
}

/// Returns a number of bytes for display.
pub(super) fn size(bytes: f64) -> String {
    match bytes {
        few if few < 1e6 => format!("{:.0} kB", few / 1e3),
        some if some < 1e9 => format!("{:.0} MB", some / 1e6),
        many if many < 1e12 => format!("{} GB", rounded(many / 1e9, 3)),
        huge => format!("{} TB", rounded(huge / 1e12, 3)),
    }
}

/// Returns RFC 3339 for display: `2026-11-23 21:04:05`.
pub(super) fn clock(rfc3339: &str) -> String {
    let to_the_second = rfc3339.split(['.', 'Z', '+']).next().unwrap_or(rfc3339);
    to_the_second.replacen('T', " ", 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_shown_with_distinguishable_ends() {
        assert_eq!(with_interval(11.399_999_8, [11.399_998_9, 11.400_000_7]), "11.3999998 (11.3999989 to 11.4000007)");
        assert_eq!(with_interval(1.9557e-3, [1.8976e-3, 2.0137e-3]), "0.001956 (0.001898 to 0.002014)");
        assert_eq!(with_interval(2.0, [2.0, 2.0]), "2 (2 to 2)");
        assert_eq!(percent(0.994), "99 %");
        assert_eq!([1.001, 0.4, -0.1, f64::NAN].map(part), ["100 %", "40 %", "0 %", "–"]);
    }

    #[test]
    fn spans_sizes_and_times_are_short() {
        let spans = [
            (0.2, "0 s"),
            (90.0, "1 min 30 s"),
            (18_000.0, "5 h"),
            (8_040.0, "2 h 14 min"),
            (90_061.0, "1 d 1 h"),
            (20.2 * 86_400.0, "20 days"),
            (400.0 * 86_400.0, "13 months"),
            (800.0 * 86_400.0, "2 years"),
            (17_955.0 * 86_400.0, "49 years"),
        ];
        for (time_s, expected) in spans {
            assert_eq!(span(time_s), expected);
        }
        assert_eq!(
            (size(2.5e9), size(12e6), span(f64::NAN)),
            ("2.5 GB".to_owned(), "12 MB".to_owned(), "–".to_owned())
        );
        assert_eq!(clock("2026-11-23T21:04:05.123Z"), "2026-11-23 21:04:05");
    }
}
