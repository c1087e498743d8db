//! Lines: `$` body `*` checksum. The messages with their quantities, and the division of a line into body and checksum.

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

pub(super) fn hex(text: &[u8]) -> Option<u16> {
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
