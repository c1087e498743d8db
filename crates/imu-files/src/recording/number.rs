//! Numbers: converts decimal text to binary floats, bit for bit as `str::parse` does, and counts the decimals of the
//! text.
//!
//! A sensor's numbers are short: up to 2⁵³ without the point, up to 22 decimals. Those are exact as an integer and a
//! power of ten, so that one division rounds once, as the standard requires. All other text is left to `str::parse`.
//! Pure.

/// Powers of ten that a double holds exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];
/// Digits that always fit into 64 bits.
const DIGITS_MAX: usize = 19;
/// Integers up to this are exact as doubles.
const EXACT_MAX: u64 = 1 << 53;

/// A parsed number, and its number of decimals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plain {
    pub(super) value: f64,
    pub(super) decimals: u8,
}

/// Reads `[sign]digits[.digits]` without space or exponent; `None` leaves the text to `str::parse`.
pub(super) fn parse_plain(text: &[u8]) -> Option<Plain> {
    let (negative, digits) = match text {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] => (false, digits),
        _ => (false, text),
    };
    if digits.len() > DIGITS_MAX + 1 {
        return None;
    }
    let (mut mantissa, mut point) = (0_u64, None);
    for (place, byte) in digits.iter().enumerate() {
        let digit = byte.wrapping_sub(b'0');
        if digit <= 9 {
            // A number that would overflow has more digits than are accepted.
            mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit));
        } else if *byte == b'.' && point.is_none() {
            point = Some(place);
        } else {
            return None;
        }
    }
    let count = digits.len() - usize::from(point.is_some());
    if count == 0 || count > DIGITS_MAX || mantissa > EXACT_MAX {
        return None;
    }
    let decimals = point.map_or(0, |point| digits.len() - point - 1);
    let size = mantissa as f64 / POWERS.get(decimals)?;
    Some(Plain { value: if negative { -size } else { size }, decimals: u8::try_from(decimals).ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Checks that for accepted text the result has the same bits as that of `str::parse`.
    fn same(text: &str) -> bool {
        let Some(plain) = parse_plain(text.as_bytes()) else { return true };
        let decimals = text.find('.').map_or(0, |point| text.len() - point - 1);
        text.parse::<f64>().is_ok_and(|value| value.to_bits() == plain.value.to_bits())
            && usize::from(plain.decimals) == decimals
    }

    #[test]
    fn what_sensors_write_is_taken_and_what_is_no_plain_number_is_left() {
        for text in ["0", "-0", "+00.001325", "-134.051", "5.", ".5", "9007199254740992", "0.000000000000000001"] {
            assert!(parse_plain(text.as_bytes()).is_some() && same(text), "{text}");
        }
        for text in
            ["", "-", ".", "+.", "1e3", "nan", "inf", " 1", "1 ", "1,5", "1.2.3", "--1", "9007199254740993", "٣"]
        {
            assert_eq!(parse_plain(text.as_bytes()), None, "{text}");
        }
        // 20 digits without a point wrap around in 64 bits.
        assert_eq!(parse_plain(b"18446744073709551617"), None);
        assert_eq!(parse_plain(b"-0").unwrap().value.to_bits(), (-0.0_f64).to_bits());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn any_text_gives_the_bits_of_parse(text in "[-+]?[0-9]{0,21}[.]?[0-9]{0,21}") {
            prop_assert!(same(&text));
        }

        #[test]
        fn any_characters_give_the_bits_of_parse(text in "[-+0-9.eEinfa ,]{0,24}") {
            prop_assert!(same(&text));
        }

        #[test]
        fn values_as_written_with_any_decimals_come_back(value in -1e6_f64..1e6, decimals in 0_usize..16) {
            let text = format!("{value:.decimals$}");
            prop_assert!(same(&text));
        }

        #[test]
        fn the_shortest_text_of_any_double_comes_back(bits: u64) {
            let text = f64::from_bits(bits).to_string();
            prop_assert!(same(&text));
        }
    }
}
