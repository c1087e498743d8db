//! Checksums: the XOR of a line's bytes and CRC-16/XMODEM.

use crc::{CRC_16_XMODEM, Crc, Table};

/// The kind of checksum behind the `*` of a line (register 30, `SerialChecksum`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum ChecksumKind {
    /// XOR of the bytes between `$` and `*`, two hex digits (the sensor's default).
    #[default]
    Xor8,
    /// CRC-16/XMODEM of the same bytes, four hex digits.
    Crc16,
}

impl ChecksumKind {
    /// Returns the number of hex digits behind the `*`.
    pub fn digits(self) -> usize {
        match self {
            Self::Xor8 => 2,
            Self::Crc16 => 4,
        }
    }
}

/// Returns the XOR of all bytes.
///
/// # Source
/// User manual UM001 rev 2.45, section 3.9.2. Weak: two equal bit changes cancel (`VNERR,12` and `VNERR,03` both give 72).
pub fn xor8(bytes: &[u8]) -> u8 {
    let (words, rest) = bytes.as_chunks::<8>();
    let folded = words.iter().fold(0_u64, |sum, word| sum ^ u64::from_ne_bytes(*word));
    folded.to_ne_bytes().iter().chain(rest).fold(0, |sum, byte| sum ^ byte)
}

/// The text "polynomial = 0x07" in the manual's section 5.2.10 is a misprint; its C code in section 3.9.3 is this one.
static XMODEM: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_XMODEM);

/// Returns the CRC-16/XMODEM: polynomial 0x1021, start 0, not reflected, no final XOR. Over a frame that ends in its
/// own CRC (high byte first), it is 0.
///
/// # Source
/// User manual UM001 rev 2.45, sections 3.9.3 and 4.3.5.
///
/// # Validation
/// Check value 0x31C3 of `123456789`; the manual's worked value.
pub fn crc16(bytes: &[u8]) -> u16 {
    XMODEM.checksum(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_manuals_worked_values_hold() {
        assert_eq!(xor8(b"VNRRG,8"), 0x4B);
        assert_eq!(xor8(b"VNWRG,07,40"), 0x59);
        assert_eq!(crc16(b"123456789"), 0x31C3);
        assert_eq!(crc16(b""), 0);
        assert_eq!(crc16(b"VNRRG,01"), 0xE15F);
    }

    proptest! {
        #[test]
        fn a_frame_with_its_own_crc_has_crc_0(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert_eq!(xor8(&bytes), bytes.iter().fold(0, |sum, byte| sum ^ byte));
            let mut framed = bytes.clone();
            framed.extend(crc16(&bytes).to_be_bytes());
            prop_assert_eq!(crc16(&framed), 0);
        }
    }
}
