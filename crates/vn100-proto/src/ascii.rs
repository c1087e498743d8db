//! Lines: `$` body `*` checksum. Parses the bytes of one line to a [`Measurement`], or reports that they are not one.

use super::measurement::Measurement;
use super::{ChecksumKind, Quantity};
use imu_core::variants;

/// Maximum length of a line, `$` and line end included (the SDK's limit).
pub const MAX_LINE_BYTES: usize = 320;

/// The asynchronous ASCII messages (register 6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, strum::VariantArray)]
pub enum AsciiType {
    /// Yaw, pitch, roll.
    Ypr,
    /// Quaternion.
    Qtn,
    /// Quaternion, magnetic field, acceleration, angular rate.
    Qmr,
    /// Direction cosines (firmware up to 3.0).
    Dcm,
    /// Magnetic field.
    Mag,
    /// Acceleration.
    Acc,
    /// Angular rate.
    Gyr,
    /// Magnetic field, acceleration, angular rate.
    Mar,
    /// Yaw, pitch, roll, magnetic field, acceleration, angular rate.
    Ymr,
    /// Yaw, pitch, roll, body acceleration without gravity, angular rate.
    Yba,
    /// Yaw, pitch, roll, NED acceleration without gravity, angular rate.
    Yia,
    /// Uncompensated magnetic field, acceleration, angular rate; temperature, pressure.
    Imu,
    /// Delta time, theta, velocity.
    Dtv,
    /// Heave.
    Hve,
}

struct Row {
    ascii: AsciiType,
    id: u8,
    register: u16,
    header: &'static str,
    quantities: &'static [Quantity],
}

const fn row(ascii: AsciiType, id: u8, register: u16, header: &'static str, quantities: &'static [Quantity]) -> Row {
    Row { ascii, id, register, header, quantities }
}

/// User manual UM001 rev 2.45, section 5.2.7 (ids) and chapters 6 and 7 (registers and their fields), in the order of
/// [`AsciiType`].
static ROWS: [Row; 14] = {
    use Quantity::{
        Accel, AngularRate, DeltaTheta, DeltaTime, DeltaVelocity, DirectionCosines, Heave, LinearAccelBody,
        LinearAccelNed, Mag, Pressure, Quaternion, Temperature, UncompAccel, UncompGyro, UncompMag, YawPitchRoll,
    };
    [
        row(AsciiType::Ypr, 1, 8, "VNYPR", &[YawPitchRoll]),
        row(AsciiType::Qtn, 2, 9, "VNQTN", &[Quaternion]),
        row(AsciiType::Qmr, 8, 15, "VNQMR", &[Quaternion, Mag, Accel, AngularRate]),
        row(AsciiType::Dcm, 9, 10, "VNDCM", &[DirectionCosines]),
        row(AsciiType::Mag, 10, 17, "VNMAG", &[Mag]),
        row(AsciiType::Acc, 11, 18, "VNACC", &[Accel]),
        row(AsciiType::Gyr, 12, 19, "VNGYR", &[AngularRate]),
        row(AsciiType::Mar, 13, 20, "VNMAR", &[Mag, Accel, AngularRate]),
        row(AsciiType::Ymr, 14, 27, "VNYMR", &[YawPitchRoll, Mag, Accel, AngularRate]),
        row(AsciiType::Yba, 16, 239, "VNYBA", &[YawPitchRoll, LinearAccelBody, AngularRate]),
        row(AsciiType::Yia, 17, 240, "VNYIA", &[YawPitchRoll, LinearAccelNed, AngularRate]),
        row(AsciiType::Imu, 19, 54, "VNIMU", &[UncompMag, UncompAccel, UncompGyro, Temperature, Pressure]),
        row(AsciiType::Dtv, 30, 80, "VNDTV", &[DeltaTime, DeltaTheta, DeltaVelocity]),
        row(AsciiType::Hve, 34, 115, "VNHVE", &[Heave]),
    ]
};

impl AsciiType {
    /// All messages.
    pub const ALL: [Self; 14] = variants();

    fn row(self) -> &'static Row {
        &ROWS[self as usize]
    }
    /// Returns the value of register 6 that selects the message.
    pub fn id(self) -> u8 {
        self.row().id
    }
    /// Returns the message that register 6 selects with this value; `None` for 0 (off) and messages of other products.
    pub fn from_id(id: u8) -> Option<Self> {
        ROWS.iter().find(|row| row.id == id).map(|row| row.ascii)
    }
    /// Returns the register with the same values.
    pub fn register(self) -> u16 {
        self.row().register
    }
    /// Returns the message with the values of that register.
    pub fn from_register(register: u16) -> Option<Self> {
        ROWS.iter().find(|row| row.register == register).map(|row| row.ascii)
    }
    /// Returns the header, without `$`: `VNYMR`.
    pub fn header(self) -> &'static str {
        self.row().header
    }
    /// Returns the message with that header (without `$`).
    pub fn from_header(header: &[u8]) -> Option<Self> {
        ROWS.iter().find(|row| row.header.as_bytes() == header).map(|row| row.ascii)
    }
    /// Returns the quantities in the order of the message's fields.
    pub fn quantities(self) -> &'static [Quantity] {
        self.row().quantities
    }
}

/// The checksum field behind the `*` of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trailer {
    /// Two hex digits.
    Xor8(u8),
    /// Four hex digits.
    Crc16(u16),
    /// `XX` or `XXXX`: a command without checksum. A sensor accepts it and never sends it.
    Bypass(ChecksumKind),
}

impl Trailer {
    /// Returns whether the trailer is the checksum of `body`; a bypass is not.
    pub fn matches(self, body: &[u8]) -> bool {
        match self {
            Self::Xor8(found) => super::checksum::xor8(body) == found,
            Self::Crc16(found) => super::checksum::crc16(body) == found,
            Self::Bypass(_) => false,
        }
    }
}

fn hex_digit(byte: u8) -> Option<u16> {
    char::from(byte).to_digit(16).and_then(|digit| u16::try_from(digit).ok())
}

fn hex(text: &[u8]) -> Option<u16> {
    if text.is_empty() || text.len() > 4 {
        return None;
    }
    text.iter().try_fold(0, |number, byte| Some(number << 4 | hex_digit(*byte)?))
}

/// Splits a line (with its `$`, without its line end) into body and trailer; `None` if it has no checksum of two or
/// four digits. The body is the text between `$` and `*`.
pub fn split_line(line: &[u8]) -> Option<(&[u8], Trailer)> {
    let inner = line.strip_prefix(b"$")?;
    let star = [3, 5].into_iter().find_map(|back| {
        let star = inner.len().checked_sub(back)?;
        (inner.get(star) == Some(&b'*')).then_some(star)
    })?;
    let (body, digits) = inner.split_at(star);
    let digits = digits.get(1..)?;
    let kind = if digits.len() == 2 { ChecksumKind::Xor8 } else { ChecksumKind::Crc16 };
    if digits.iter().all(|byte| *byte == b'X') {
        return Some((body, Trailer::Bypass(kind)));
    }
    let number = hex(digits)?;
    let trailer = match u8::try_from(number) {
        Ok(xor) if kind == ChecksumKind::Xor8 => Trailer::Xor8(xor),
        _ => Trailer::Crc16(number),
    };
    Some((body, trailer))
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_stands_in_the_order_of_the_type() {
        for ascii in AsciiType::ALL {
            assert_eq!(ascii.row().ascii, ascii);
            assert_eq!(AsciiType::from_id(ascii.id()), Some(ascii));
            assert_eq!(AsciiType::from_register(ascii.register()), Some(ascii));
            assert_eq!(AsciiType::from_header(ascii.header().as_bytes()), Some(ascii));
        }
        assert_eq!(AsciiType::from_id(0), None);
        assert_eq!(AsciiType::from_header(b"VNYMRX"), None);
    }

    #[test]
    fn a_trailer_is_recognised_by_its_digits() {
        assert_eq!(split_line(b"$VNRRG,8*4B"), Some((&b"VNRRG,8"[..], Trailer::Xor8(0x4B))));
        assert_eq!(split_line(b"$VNRRG,01*E15F"), Some((&b"VNRRG,01"[..], Trailer::Crc16(0xE15F))));
        assert_eq!(split_line(b"$VNRRG,1*XX"), Some((&b"VNRRG,1"[..], Trailer::Bypass(ChecksumKind::Xor8))));
        assert_eq!(split_line(b"$VNRRG,1*XXXX"), Some((&b"VNRRG,1"[..], Trailer::Bypass(ChecksumKind::Crc16))));
        // four digits with a small value are still a CRC
        assert_eq!(split_line(b"$VNA*0012"), Some((&b"VNA"[..], Trailer::Crc16(0x12))));
        for line in
            [&b"$VNRRG,8*"[..], b"$VNRRG,8", b"$VNRRG,8*4", b"$VNRRG,8*4BX", b"$VNYMR,1*GG", b"VNRRG,8*4B", b"$", b""]
        {
            assert_eq!(split_line(line), None, "{}", String::from_utf8_lossy(line));
        }
        assert!(!Trailer::Bypass(ChecksumKind::Xor8).matches(b""));
    }

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
        let mut measurement = Measurement::new(super::super::MeasurementKind::Ascii(ascii));
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
