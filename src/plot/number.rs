//! Numbers for display.

/// Returns a number with four digits: plain if it is neither small nor large, else times a power of ten.
pub fn plain(value: f64) -> String {
    rounded(value, 4)
}

/// Returns a number as [`plain`] does, with this many digits; a dash for values that are not finite.
pub fn rounded(value: f64, digits: usize) -> String {
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

/// Removes trailing zeros.
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
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (11.4, "11.4"),
            (-9.79465, "−9.795"),
            (0.002, "0.002"),
            (3.52e-4, "3.52·10⁻⁴"),
            (720_000.0, "7.2·10⁵"),
            (12_345.6, "12346"),
            (-1e-12, "−1·10⁻¹²"),
            (f64::NAN, "–"),
        ] {
            assert_eq!(plain(value), text);
        }
    }
}
