//! Quantities: the physical quantities in a VN-100's messages, with their size, unit and text format.

use imu_core::sample::Channel;
use imu_core::variants;

/// One physical quantity; values are in the sensor's unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, strum::VariantArray)]
#[repr(u8)]
pub enum Quantity {
    /// Yaw, pitch, roll, deg.
    YawPitchRoll,
    /// Attitude, body to NED, scalar last.
    Quaternion,
    /// Direction cosines in sending order: nine values (binary: column-major, NED to body).
    DirectionCosines,
    /// Magnetic field x, y, z, gauss, compensated.
    Mag,
    /// Specific force x, y, z, m/s², the on-board filter's bias estimate removed.
    Accel,
    /// Angular rate x, y, z, rad/s, the on-board filter's bias estimate removed.
    AngularRate,
    /// Magnetic field x, y, z, gauss, without hard and soft iron estimate.
    UncompMag,
    /// Specific force x, y, z, m/s², without the on-board bias estimate.
    UncompAccel,
    /// Angular rate x, y, z, rad/s, without the on-board bias estimate.
    UncompGyro,
    /// Temperature, °C.
    Temperature,
    /// Pressure, kPa.
    Pressure,
    /// Time over which delta theta and delta velocity were integrated, s.
    DeltaTime,
    /// Rotation over [`Quantity::DeltaTime`], x, y, z, deg.
    DeltaTheta,
    /// Change of velocity over [`Quantity::DeltaTime`], x, y, z, m/s.
    DeltaVelocity,
    /// Acceleration without gravity, body axes, m/s².
    LinearAccelBody,
    /// Acceleration without gravity, north, east, down, m/s².
    LinearAccelNed,
    /// Heave (m), its rate (m/s), delayed heave (m).
    Heave,
    /// Magnetic field north, east, down, gauss.
    MagNed,
    /// Acceleration north, east, down, m/s².
    AccelNed,
    /// One standard deviation of yaw, pitch, roll, deg.
    YprUncertainty,
}

/// The number format of firmware 2 and 3: C's `%+0<width>.<decimals>f`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AsciiFormat {
    /// The minimum number of characters, sign included; a larger number takes more.
    pub width: usize,
    /// Digits behind the point: the resolution.
    pub decimals: usize,
}

impl Quantity {
    /// The number of quantities.
    pub const COUNT: usize = 20;
    /// All quantities.
    pub const ALL: [Self; Self::COUNT] = variants();
    /// The number of values in all quantities together.
    pub const TOTAL_LEN: usize = OFFSETS[Self::COUNT];

    /// Returns the number of values of the quantity.
    pub const fn components(self) -> usize {
        match self {
            Self::Temperature | Self::Pressure | Self::DeltaTime => 1,
            Self::Quaternion => 4,
            Self::DirectionCosines => 9,
            _ => 3,
        }
    }

    /// Returns the position of its values among those of all quantities.
    pub(super) const fn range(self) -> std::ops::Range<usize> {
        OFFSETS[self as usize]..OFFSETS[self as usize + 1]
    }

    /// Returns the text format of firmware 2 and 3.
    ///
    /// # Source
    /// 40 recorded lines of a firmware 3.1 unit, AN110 tables 3–5 (transmission times), user manual UM001 rev 2.45
    /// sections 6 and 7. Direction cosines are printed like quaternions (no recording of VNDCM is known).
    pub const fn ascii_format(self) -> AsciiFormat {
        let (width, decimals) = match self {
            Self::YawPitchRoll | Self::YprUncertainty | Self::DeltaTheta | Self::DeltaVelocity | Self::Pressure => {
                (8, 3)
            }
            Self::Quaternion | Self::DirectionCosines | Self::DeltaTime => (9, 6),
            Self::Mag | Self::UncompMag | Self::MagNed => (8, 4),
            Self::Accel
            | Self::UncompAccel
            | Self::AccelNed
            | Self::LinearAccelBody
            | Self::LinearAccelNed
            | Self::Heave => (7, 3),
            Self::AngularRate | Self::UncompGyro => (10, 6),
            Self::Temperature => (5, 1),
        };
        AsciiFormat { width, decimals }
    }

    /// Returns the channels of a sample that the quantity fills, in order; empty for quantities that have none.
    /// Acceleration without gravity is not the channel `accel`.
    pub const fn channels(self) -> &'static [Channel] {
        match self {
            Self::YawPitchRoll => &[Channel::Yaw, Channel::Pitch, Channel::Roll],
            Self::Mag | Self::UncompMag => &[Channel::MagX, Channel::MagY, Channel::MagZ],
            Self::Accel | Self::UncompAccel => &[Channel::AccelX, Channel::AccelY, Channel::AccelZ],
            Self::AngularRate | Self::UncompGyro => &[Channel::GyroX, Channel::GyroY, Channel::GyroZ],
            Self::Temperature => &[Channel::Temperature],
            Self::Pressure => &[Channel::Pressure],
            _ => &[],
        }
    }
}

const OFFSETS: [usize; Quantity::COUNT + 1] = {
    let mut offsets = [0; Quantity::COUNT + 1];
    let mut index = 0;
    while index < Quantity::COUNT {
        offsets[index + 1] = offsets[index] + Quantity::ALL[index].components();
        index += 1;
    }
    offsets
};

/// A set of quantities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct QuantitySet(u32);

impl QuantitySet {
    /// The empty set.
    pub const EMPTY: Self = Self(0);
    /// Adds a quantity.
    pub const fn insert(&mut self, quantity: Quantity) {
        self.0 |= 1 << quantity as u8;
    }
    /// Returns whether the quantity is in the set.
    pub const fn contains(self, quantity: Quantity) -> bool {
        self.0 & (1 << quantity as u8) != 0
    }
    /// Returns the quantities in the set.
    pub fn iter(self) -> impl Iterator<Item = Quantity> {
        Quantity::ALL.into_iter().filter(move |quantity| self.contains(*quantity))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_stand_in_the_order_of_their_numbers() {
        for (index, quantity) in Quantity::ALL.into_iter().enumerate() {
            assert_eq!(quantity as usize, index);
            assert_eq!(quantity.range().len(), quantity.components());
        }
        assert_eq!(Quantity::TOTAL_LEN, 61);
    }

    #[test]
    fn a_channels_quantity_is_printed_with_the_channels_decimals() {
        for quantity in Quantity::ALL {
            for channel in quantity.channels() {
                assert_eq!(quantity.ascii_format().decimals, channel.ascii_decimals(), "{quantity:?}");
            }
        }
    }
}
