//! Checksums: the XOR of a line's bytes and CRC-16/XMODEM.

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
    /// Hex digits behind the `*`.
    pub fn digits(self) -> usize {
        match self {
            Self::Xor8 => 2,
            Self::Crc16 => 4,
        }
    }
}

/// XOR of all bytes.
///
/// # Source
/// User manual UM001 rev 2.45, section 3.9.2. Weak: two equal bit changes cancel (`VNERR,12` and `VNERR,03` both give 72).
pub fn xor8(bytes: &[u8]) -> u8 {
    let (words, rest) = bytes.as_chunks::<8>();
    let folded = words.iter().fold(0_u64, |sum, word| sum ^ u64::from_ne_bytes(*word));
    folded.to_ne_bytes().iter().chain(rest).fold(0, |sum, byte| sum ^ byte)
}

/// Generator polynomial x¹⁶ + x¹² + x⁵ + 1. (The text "polynomial = 0x07" in the manual's section 5.2.10 is a misprint;
/// its C code in section 3.9.3 is this one.)
const POLYNOMIAL: u16 = 0x1021;

/// `TABLES[k][b]`: the remainder of byte `b` followed by `k` zero bytes.
static TABLES: [[u16; 256]; 8] = tables();

const fn tables() -> [[u16; 256]; 8] {
    let mut tables = [[0_u16; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let mut remainder = (byte as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            remainder = if remainder & 0x8000 == 0 { remainder << 1 } else { (remainder << 1) ^ POLYNOMIAL };
            bit += 1;
        }
        tables[0][byte] = remainder;
        byte += 1;
    }
    let mut zeros = 1;
    while zeros < 8 {
        let mut byte = 0;
        while byte < 256 {
            let before = tables[zeros - 1][byte];
            tables[zeros][byte] = (before << 8) ^ tables[0][(before >> 8) as usize];
            byte += 1;
        }
        zeros += 1;
    }
    tables
}

/// CRC-16/XMODEM: polynomial 0x1021, start 0, not reflected, no final XOR. Over a frame that ends in its own CRC
/// (high byte first) it is 0.
///
/// # Source
/// User manual UM001 rev 2.45, sections 3.9.3 and 4.3.5. Tables process eight bytes per step ("slicing").
///
/// # Validation
/// Check value 0x31C3 of `123456789`; equal to the `crc` crate on random bytes (`crc16_equals_an_independent_one`).
pub fn crc16(bytes: &[u8]) -> u16 {
    let (chunks, rest) = bytes.as_chunks::<8>();
    let at = |zeros: usize, byte: u8| TABLES[zeros][usize::from(byte)];
    let mut crc = 0_u16;
    for [a, b, c, d, e, f, g, h] in chunks {
        let [high, low] = crc.to_be_bytes();
        crc = at(7, a ^ high) ^ at(6, b ^ low) ^ at(5, *c) ^ at(4, *d) ^ at(3, *e) ^ at(2, *f) ^ at(1, *g) ^ at(0, *h);
    }
    for byte in rest {
        let [high, low] = crc.to_be_bytes();
        crc = (u16::from(low) << 8) ^ at(0, byte ^ high);
    }
    crc
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
        fn crc16_equals_an_independent_one(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let oracle = crc::Crc::<u16>::new(&crc::CRC_16_XMODEM);
            prop_assert_eq!(crc16(&bytes), oracle.checksum(&bytes));
            prop_assert_eq!(xor8(&bytes), bytes.iter().fold(0, |sum, byte| sum ^ byte));
            let mut framed = bytes.clone();
            framed.extend(crc16(&bytes).to_be_bytes());
            prop_assert_eq!(crc16(&framed), 0);
        }
    }
}
