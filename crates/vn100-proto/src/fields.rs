//! Fields: reads the values of a line or of a binary payload into a [`Measurement`], or reports that a line has others.

use super::ascii::hex;
use super::binary::{FIELDS, Field};
use super::{AsciiType, BinaryHeader, Measurement};

/// Powers of ten that a double holds exactly (all up to 10²² are; a line's numbers need 15).
const POWERS_OF_TEN: [f64; 16] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// Reads a decimal number (sign, digits, at most one point) from the start of `text`. Returns the double nearest to it,
/// the number of digits behind its point and the number of bytes read. `None` if there is no digit.
fn read_number(text: &[u8]) -> Option<(f64, u8, usize)> {
    let (negative, sign) = match text.first()? {
        b'-' => (true, 1),
        b'+' => (false, 1),
        _ => (false, 0),
    };
    let mut at = sign;
    let mut whole = 0_u64;
    let mut point = None;
    for byte in text.get(sign..)? {
        match byte {
            b'0'..=b'9' => whole = whole.wrapping_mul(10).wrapping_add(u64::from(byte - b'0')),
            b'.' if point.is_none() => point = Some(at),
            _ => break,
        }
        at += 1;
    }
    let digits = at - sign - usize::from(point.is_some());
    if digits == 0 {
        return None;
    }
    let decimals = point.map_or(0, |point| at - point - 1);
    let value = match POWERS_OF_TEN.get(decimals) {
        // integer and power of ten are exact, so that their quotient is the correctly rounded decimal
        Some(power) if digits <= 15 => whole as f64 / power,
        _ => std::str::from_utf8(text.get(sign..at)?).ok()?.parse().ok()?,
    };
    let value = if negative { -value } else { value };
    Some((value, u8::try_from(decimals).unwrap_or(u8::MAX - 1), at))
}

/// Reads the fields of a message (the text behind `VNYMR,`) into a measurement of that type. `None` if a field is
/// missing, surplus or not a number.
///
/// The quantities may be followed by a serial count `T…` and a status `S…` in either order (register 30; the manual's
/// text and example disagree about it). The number of fields decides, never the column: widths vary with the firmware.
pub(super) fn read_fields(measurement: &mut Measurement, ascii: AsciiType, fields: &[u8]) -> Option<()> {
    let mut rest = fields;
    let mut more = true;
    for quantity in ascii.quantities() {
        for component in 0..quantity.components() {
            if !more {
                return None;
            }
            let (value, decimals, length) = read_number(rest)?;
            (rest, more) = next_field(rest, length)?;
            if let Some(slot) = measurement.slots(*quantity).get_mut(component) {
                *slot = value;
            }
            measurement.note_decimals(*quantity, decimals);
        }
    }
    while more {
        let length = rest.iter().position(|byte| *byte == b',').unwrap_or(rest.len());
        let (first, digits) = rest.get(..length)?.split_first()?;
        match first {
            b'T' if measurement.sync_count.is_none() => measurement.sync_count = Some(read_count(digits)?),
            b'S' if measurement.vpe_status.is_none() => measurement.vpe_status = Some(hex(digits)?),
            _ => return None,
        }
        (rest, more) = next_field(rest, length)?;
    }
    Some(())
}

/// Returns the text behind a field of `length` bytes, and whether a comma announced a further field.
fn next_field(text: &[u8], length: usize) -> Option<(&[u8], bool)> {
    match text.get(length..)? {
        [] => Some((&[], false)),
        [b',', rest @ ..] => Some((rest, true)),
        _ => None,
    }
}

fn read_count(digits: &[u8]) -> Option<u32> {
    if digits.is_empty() || digits.len() > 10 || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let count = digits.iter().fold(0_u64, |count, digit| count * 10 + u64::from(digit - b'0'));
    u32::try_from(count).ok()
}

/// Takes `N` bytes from the front; zeros if they are missing (a payload of the header's length never lacks any).
fn take<const N: usize>(payload: &mut &[u8]) -> [u8; N] {
    match payload.split_first_chunk::<N>() {
        Some((bytes, rest)) => {
            *payload = rest;
            *bytes
        }
        None => [0; N],
    }
}

/// Reads a payload of exactly `header.payload_bytes()` bytes. If two groups carry the same quantity, the later one is
/// used (a sensor sends the same value in both).
pub(super) fn read_payload(measurement: &mut Measurement, header: &BinaryHeader, payload: &[u8]) {
    let mut rest = payload;
    for (mut mask, fields) in header.masks.into_iter().zip(&FIELDS) {
        while mask != 0 {
            match fields[mask.trailing_zeros() as usize] {
                Field::None => {}
                Field::TimeStartup => measurement.device_time_ns = Some(u64::from_le_bytes(take(&mut rest))),
                Field::TimeSyncIn => measurement.time_sync_in_ns = Some(u64::from_le_bytes(take(&mut rest))),
                Field::SyncInCount => measurement.sync_in_count = Some(u32::from_le_bytes(take(&mut rest))),
                Field::SyncOutCount => measurement.sync_count = Some(u32::from_le_bytes(take(&mut rest))),
                Field::TimeStatus => measurement.time_status = Some(u8::from_le_bytes(take(&mut rest))),
                Field::VpeStatus => measurement.vpe_status = Some(u16::from_le_bytes(take(&mut rest))),
                Field::ImuStatus => measurement.imu_status = Some(u16::from_le_bytes(take(&mut rest))),
                Field::SensorSaturation => measurement.sensor_saturation = Some(u16::from_le_bytes(take(&mut rest))),
                Field::Floats(quantities) => {
                    for quantity in quantities {
                        for slot in measurement.slots(*quantity) {
                            *slot = f64::from(f32::from_le_bytes(take(&mut rest)));
                        }
                    }
                }
            }
            mask &= mask - 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MeasurementKind;
    use proptest::prelude::*;

    #[test]
    fn numbers_with_anything_else_in_them_are_refused() {
        for text in ["", "+", "-", ".", "+.", "nan", "inf", "x1", "+-1", ","] {
            assert!(read_number(text.as_bytes()).is_none(), "{text}");
        }
        for (text, expected) in [("1.2.3", 3), ("1e5", 1), ("1 ", 1), ("12,3", 2)] {
            assert_eq!(read_number(text.as_bytes()).map(|(_, _, length)| length), Some(expected), "{text}");
        }
        assert_eq!(read_number(b"-000.000").map(|(value, ..)| value.to_bits()), Some((-0.0_f64).to_bits()));
    }

    fn read(ascii: AsciiType, fields: &str) -> Option<Measurement> {
        let mut measurement = Measurement::new(MeasurementKind::Ascii(ascii));
        read_fields(&mut measurement, ascii, fields.as_bytes()).map(|()| measurement)
    }

    #[test]
    fn serial_count_and_status_stand_in_either_order() {
        for fields in ["1,2,3,T0000000543,S00A1", "1,2,3,S00A1,T543"] {
            let measurement = read(AsciiType::Ypr, fields).unwrap();
            assert_eq!((measurement.sync_count, measurement.vpe_status), (Some(543), Some(0xA1)), "{fields}");
        }
        assert_eq!(read(AsciiType::Ypr, "1,2,3,T4294967295").unwrap().sync_count, Some(u32::MAX));
        for fields in [
            "1,2,3,T",
            "1,2,3,S",
            "1,2,3,T1,T2",
            "1,2,3,S1,S1",
            "1,2,3,",
            "1,2",
            "1,2,",
            "1,2,3,4",
            "1,2,3,T4294967296",
            "",
            "1,,3",
        ] {
            assert!(read(AsciiType::Ypr, fields).is_none(), "{fields}");
        }
    }

    #[test]
    fn the_digits_behind_the_point_are_kept() {
        use imu_core::sample::Channel;
        let measurement =
            read(AsciiType::Mar, "-1.7866,+0.1747,+2.2113,-00.085,+00.005,-09.847,+00.0003,-00.0012,-00.0001").unwrap();
        assert_eq!(measurement.decimals(Channel::MagX), Some(4));
        assert_eq!(measurement.decimals(Channel::AccelY), Some(3));
        assert_eq!(measurement.decimals(Channel::GyroZ), Some(4));
        assert_eq!(measurement.decimals(Channel::Yaw), None);
    }

    proptest! {
        #[test]
        fn a_decimal_becomes_the_nearest_double(text in "[+-]?[0-9]{1,12}(\\.[0-9]{0,12})?") {
            let (value, _, length) = read_number(text.as_bytes()).unwrap();
            prop_assert_eq!(length, text.len());
            prop_assert_eq!(value.to_bits(), text.parse::<f64>().unwrap().to_bits());
        }
    }
}
