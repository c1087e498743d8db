//! Binary outputs: `FA`, groups, masks, payload, CRC. There is no length field: it follows from the masks.
//!
//! In: a header. Out: its fields, the frame's length. Refuses: groups and fields that a VN-100 does not have (reserved
//! for products with GNSS), extension bits, groups without a field.

use super::Quantity;
use super::quantity::QuantitySet;

/// The byte every binary frame begins with.
pub const SYNC: u8 = 0xFA;
/// Bytes of the CRC at the frame's end.
pub const CRC_BYTES: usize = 2;

/// The part of the payload that one bit of a mask adds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Field {
    /// Reserved: not a field of a VN-100.
    None,
    TimeStartup,
    TimeSyncIn,
    SyncInCount,
    SyncOutCount,
    TimeStatus,
    VpeStatus,
    ImuStatus,
    SensorSaturation,
    /// 32-bit floats, quantity after quantity.
    Floats(&'static [Quantity]),
}

impl Field {
    const fn bytes(self) -> usize {
        match self {
            Self::None => 0,
            Self::TimeStartup | Self::TimeSyncIn => 8,
            Self::SyncInCount | Self::SyncOutCount => 4,
            Self::VpeStatus | Self::ImuStatus | Self::SensorSaturation => 2,
            Self::TimeStatus => 1,
            Self::Floats(quantities) => {
                let mut bytes = 0;
                let mut index = 0;
                while index < quantities.len() {
                    bytes += 4 * quantities[index].components();
                    index += 1;
                }
                bytes
            }
        }
    }
}

const fn floats(quantities: &'static [Quantity]) -> Field {
    Field::Floats(quantities)
}

/// The number of groups of a VN-100.
const GROUPS: usize = 4;
/// Bits of the groups byte: Common (1), Time (2), IMU (3), Attitude (5).
const GROUP_BITS: [u8; GROUPS] = [0x01, 0x02, 0x04, 0x10];

/// User manual UM001 rev 2.45, sections 4.4–4.7 (fields per group and bit).
pub(super) static FIELDS: [[Field; 16]; GROUPS] = {
    use Quantity::{
        Accel, AccelNed, AngularRate, DeltaTheta, DeltaTime, DeltaVelocity, DirectionCosines, Heave, LinearAccelBody,
        LinearAccelNed, Mag, MagNed, Pressure, Quaternion, Temperature, UncompAccel, UncompGyro, UncompMag,
        YawPitchRoll, YprUncertainty,
    };
    let mut fields = [[Field::None; 16]; GROUPS];
    fields[0][0] = Field::TimeStartup;
    fields[0][2] = Field::TimeSyncIn;
    fields[0][3] = floats(&[YawPitchRoll]);
    fields[0][4] = floats(&[Quaternion]);
    fields[0][5] = floats(&[AngularRate]);
    fields[0][8] = floats(&[Accel]);
    fields[0][9] = floats(&[UncompAccel, UncompGyro]);
    fields[0][10] = floats(&[Mag, Temperature, Pressure]);
    fields[0][11] = floats(&[DeltaTime, DeltaTheta, DeltaVelocity]);
    fields[0][12] = Field::VpeStatus;
    fields[0][13] = Field::SyncInCount;
    fields[1][0] = Field::TimeStartup;
    fields[1][4] = Field::TimeSyncIn;
    fields[1][7] = Field::SyncInCount;
    fields[1][8] = Field::SyncOutCount;
    fields[1][9] = Field::TimeStatus;
    fields[2][0] = Field::ImuStatus;
    fields[2][1] = floats(&[UncompMag]);
    fields[2][2] = floats(&[UncompAccel]);
    fields[2][3] = floats(&[UncompGyro]);
    fields[2][4] = floats(&[Temperature]);
    fields[2][5] = floats(&[Pressure]);
    fields[2][6] = floats(&[DeltaTime, DeltaTheta]);
    fields[2][7] = floats(&[DeltaVelocity]);
    fields[2][8] = floats(&[Mag]);
    fields[2][9] = floats(&[Accel]);
    fields[2][10] = floats(&[AngularRate]);
    fields[2][11] = Field::SensorSaturation;
    fields[3][0] = Field::VpeStatus;
    fields[3][1] = floats(&[YawPitchRoll]);
    fields[3][2] = floats(&[Quaternion]);
    fields[3][3] = floats(&[DirectionCosines]);
    fields[3][4] = floats(&[MagNed]);
    fields[3][5] = floats(&[AccelNed]);
    fields[3][6] = floats(&[LinearAccelBody]);
    fields[3][7] = floats(&[LinearAccelNed]);
    fields[3][8] = floats(&[YprUncertainty]);
    fields[3][12] = floats(&[Heave]);
    fields
};

/// Bytes per group and bit: the lengths of [`FIELDS`].
static LENGTHS: [[u8; 16]; GROUPS] = {
    let mut lengths = [[0; 16]; GROUPS];
    let mut group = 0;
    while group < GROUPS {
        let mut bit = 0;
        while bit < 16 {
            lengths[group][bit] = FIELDS[group][bit].bytes() as u8;
            bit += 1;
        }
        group += 1;
    }
    lengths
};

/// The bits of each group's mask that a VN-100 has.
pub(super) const KNOWN_BITS: [u16; GROUPS] = [0x3F3D, 0x0391, 0x0FFF, 0x11FF];

/// The reasons why a header was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HeaderError {
    /// A group of another product, or none.
    #[error("binary groups {found:02X}: expected a sum of 01 (common), 02 (time), 04 (IMU), 10 (attitude)")]
    Groups {
        /// The groups byte.
        found: u8,
    },
    /// A field of another product, or none.
    #[error("binary group {group:02X} has the fields {found:04X}: expected at least one of {known:04X} and no other")]
    Fields {
        /// The group's bit.
        group: u8,
        /// The group's mask.
        found: u16,
        /// The bits that a VN-100 has.
        known: u16,
    },
    /// The text is not `groups,fields…` in hex.
    #[error("`{found}` is not a binary output: expected groups and one mask per group in hex, such as 01,0609")]
    Text {
        /// The text.
        found: String,
    },
}

/// The header of a binary output: which fields of which groups. Always valid for a VN-100.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BinaryHeader {
    groups: u8,
    /// Masks of the groups 1, 2, 3, 5; 0 if the group is absent.
    pub(super) masks: [u16; GROUPS],
}

/// The meaning of the bytes behind a sync byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HeaderBytes {
    /// Too few bytes to decide; this many are needed, the sync byte included.
    Incomplete(usize),
    /// Not a header of a VN-100.
    Invalid,
    /// A header.
    Header(BinaryHeader),
}

impl BinaryHeader {
    /// Returns the header with these masks for the groups Common, Time, IMU and Attitude; 0 omits a group.
    ///
    /// # Errors
    /// [`HeaderError`] if a mask has a bit that a VN-100 does not have, or all are 0.
    pub fn new(common: u16, time: u16, imu: u16, attitude: u16) -> Result<Self, HeaderError> {
        let masks = [common, time, imu, attitude];
        let mut groups = 0;
        for ((mask, known), group) in masks.into_iter().zip(KNOWN_BITS).zip(GROUP_BITS) {
            if mask & !known != 0 {
                return Err(HeaderError::Fields { group, found: mask, known });
            }
            if mask != 0 {
                groups |= group;
            }
        }
        if groups == 0 { Err(HeaderError::Groups { found: 0 }) } else { Ok(Self { groups, masks }) }
    }

    /// Returns the header in the text form of registers 75–77: groups and masks in hex, `05,0008,0010`.
    ///
    /// # Errors
    /// [`HeaderError`] if the text has another form, or is not an output of a VN-100.
    pub fn parse_register(text: &str) -> Result<Self, HeaderError> {
        let refuse = || HeaderError::Text { found: text.to_owned() };
        let mut fields = text.split(',').map(|field| u16::from_str_radix(field.trim(), 16).ok());
        let groups = fields.next().flatten().ok_or_else(refuse)?;
        let groups = u8::try_from(groups).map_err(|_| refuse())?;
        if groups == 0 || groups & !0x17 != 0 {
            return Err(HeaderError::Groups { found: groups });
        }
        let mut masks = [0; GROUPS];
        for ((slot, bit), known) in masks.iter_mut().zip(GROUP_BITS).zip(KNOWN_BITS) {
            if groups & bit != 0 {
                *slot = fields.next().flatten().ok_or_else(refuse)?;
                if *slot == 0 {
                    return Err(HeaderError::Fields { group: bit, found: 0, known });
                }
            }
        }
        if fields.next().is_some() {
            return Err(refuse());
        }
        let [common, time, imu, attitude] = masks;
        Self::new(common, time, imu, attitude)
    }

    /// Reads the header of a frame; `bytes` begins with the sync byte.
    pub(super) fn read(bytes: &[u8]) -> HeaderBytes {
        let Some(&groups) = bytes.get(1) else { return HeaderBytes::Incomplete(2) };
        if groups == 0 || groups & !0x17 != 0 {
            return HeaderBytes::Invalid;
        }
        let mut masks = [0; GROUPS];
        let mut at = 2;
        for ((slot, bit), known) in masks.iter_mut().zip(GROUP_BITS).zip(KNOWN_BITS) {
            if groups & bit == 0 {
                continue;
            }
            let Some(&[low, high]) = bytes.get(at..at + 2).and_then(|mask| mask.first_chunk()) else {
                return HeaderBytes::Incomplete(at + 2);
            };
            *slot = u16::from_le_bytes([low, high]);
            if *slot == 0 || *slot & !known != 0 {
                return HeaderBytes::Invalid;
            }
            at += 2;
        }
        HeaderBytes::Header(Self { groups, masks })
    }

    /// Returns the groups byte.
    pub fn groups(&self) -> u8 {
        self.groups
    }

    /// Returns the masks of the present groups, in sending order.
    pub fn masks(&self) -> impl Iterator<Item = u16> {
        self.masks.into_iter().filter(|mask| *mask != 0)
    }

    /// Returns the bytes of sync, groups and masks.
    pub fn header_bytes(&self) -> usize {
        2 + 2 * self.groups.count_ones() as usize
    }

    /// Returns the bytes of the payload.
    pub fn payload_bytes(&self) -> usize {
        let mut bytes = 0;
        for (mut mask, lengths) in self.masks.into_iter().zip(&LENGTHS) {
            while mask != 0 {
                bytes += usize::from(lengths[mask.trailing_zeros() as usize]);
                mask &= mask - 1;
            }
        }
        bytes
    }

    /// Returns the bytes of the whole frame, sync byte and CRC included.
    pub fn frame_bytes(&self) -> usize {
        self.header_bytes() + self.payload_bytes() + CRC_BYTES
    }

    /// Returns the fields in sending order.
    pub(super) fn fields(&self) -> impl Iterator<Item = Field> {
        self.masks
            .into_iter()
            .zip(&FIELDS)
            .flat_map(|(mask, fields)| fields.iter().enumerate().filter(move |(bit, _)| mask & (1 << bit) != 0))
            .map(|(_, field)| *field)
    }

    /// Returns the quantities of the output.
    pub fn quantities(&self) -> QuantitySet {
        let mut set = QuantitySet::EMPTY;
        for field in self.fields() {
            if let Field::Floats(quantities) = field {
                quantities.iter().for_each(|quantity| set.insert(*quantity));
            }
        }
        set
    }

    /// Returns whether the output has TimeStartup.
    pub fn has_time_startup(&self) -> bool {
        self.fields().any(|field| field == Field::TimeStartup)
    }
}

impl std::fmt::Display for BinaryHeader {
    /// Writes the text form of registers 75–77: `01,0609`.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{:02X}", self.groups)?;
        self.masks().try_for_each(|mask| write!(formatter, ",{mask:04X}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_known_bits_are_those_of_the_table() {
        for (fields, known) in FIELDS.iter().zip(KNOWN_BITS) {
            for (bit, field) in fields.iter().enumerate() {
                assert_eq!(*field != Field::None, known & (1 << bit) != 0, "{field:?}");
            }
        }
        let [common, time, imu, attitude] = KNOWN_BITS;
        assert_eq!(BinaryHeader::new(common, time, imu, attitude).unwrap().frame_bytes(), 433);
    }

    #[test]
    fn lengths_follow_from_the_masks() {
        // user manual 4.3.7 and the packets measured in recordings
        for (text, bytes) in [
            ("01,0008", 18),
            ("05,0008,0010", 24),
            ("01,0009", 26),
            ("01,0128", 42),
            ("01,0201", 38),
            ("01,0601", 58),
            ("01,0609", 70),
            ("01,0739", 110),
            ("01,0528", 62),
        ] {
            let header = BinaryHeader::parse_register(text).unwrap();
            assert_eq!(header.frame_bytes(), bytes, "{text}");
            assert_eq!(header.to_string(), text);
        }
    }

    #[test]
    fn groups_and_fields_of_other_products_are_refused() {
        for text in [
            "08,0001", "20,0001", "40,0001", "81,0001", "00", "01,0002", "01,0040", "01,8000", "02,0002", "04,1000",
            "10,0200",
        ] {
            assert!(BinaryHeader::parse_register(text).is_err(), "{text}");
        }
        for text in ["", "01", "01,0000", "01,0001,0001", "05,0001", "01;0001", "101,0001", "0x01,0001"] {
            assert!(BinaryHeader::parse_register(text).is_err(), "{text}");
        }
        assert_eq!(BinaryHeader::parse_register("1,609").unwrap().to_string(), "01,0609");
        assert!(BinaryHeader::new(0, 0, 0, 0).is_err());
    }

    #[test]
    fn a_header_is_read_byte_by_byte() {
        let bytes = [SYNC, 0x05, 0x08, 0x00, 0x10, 0x00, 0xFF];
        for length in 1..6 {
            assert!(matches!(BinaryHeader::read(&bytes[..length]), HeaderBytes::Incomplete(need) if need > length));
        }
        let header = BinaryHeader::parse_register("05,0008,0010").unwrap();
        assert_eq!(BinaryHeader::read(&bytes), HeaderBytes::Header(header));
        assert_eq!(BinaryHeader::read(&[SYNC, 0x08]), HeaderBytes::Invalid);
        assert_eq!(BinaryHeader::read(&[SYNC, 0x01, 0x00, 0x80]), HeaderBytes::Invalid);
    }
}
