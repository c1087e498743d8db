//! Channels: the fourteen quantities of a VN-100, their names, units and resolutions.

use crate::variants;
use serde::{Deserialize, Serialize};

/// One measured quantity. The order is the order of the columns of table `sample`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::Display, strum::EnumString, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
#[repr(u8)]
#[expect(missing_docs, reason = "name() and unit() say it all")]
pub enum Channel {
    Yaw,
    Pitch,
    Roll,
    MagX,
    MagY,
    MagZ,
    AccelX,
    AccelY,
    AccelZ,
    GyroX,
    GyroY,
    GyroZ,
    Temperature,
    Pressure,
}

/// A group of three channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[expect(missing_docs, reason = "the names are the field's own")]
pub enum Triad {
    Attitude,
    Mag,
    Accel,
    Gyro,
}

impl Triad {
    /// Returns the triad's three channels in the order x, y, z (yaw, pitch, roll).
    pub fn channels(self) -> [Channel; 3] {
        use Channel::{AccelX, AccelY, AccelZ, GyroX, GyroY, GyroZ, MagX, MagY, MagZ, Pitch, Roll, Yaw};
        match self {
            Self::Attitude => [Yaw, Pitch, Roll],
            Self::Mag => [MagX, MagY, MagZ],
            Self::Accel => [AccelX, AccelY, AccelZ],
            Self::Gyro => [GyroX, GyroY, GyroZ],
        }
    }
    /// Returns the name: `attitude`, `mag`, `accel` or `gyro`.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

impl Channel {
    /// The number of channels.
    pub const COUNT: usize = 14;
    /// All channels in column order.
    pub const ALL: [Self; Self::COUNT] = variants();
    /// The nine channels whose noise is analysed: magnetometer, accelerometer, gyroscope. Angles wrap and are filtered;
    /// temperature and pressure are conditions, not noise.
    pub const ANALYSED: [Self; 9] = [
        Self::MagX,
        Self::MagY,
        Self::MagZ,
        Self::AccelX,
        Self::AccelY,
        Self::AccelZ,
        Self::GyroX,
        Self::GyroY,
        Self::GyroZ,
    ];

    /// Returns the name in tables, JSON and on the command line.
    pub fn name(self) -> &'static str {
        self.into()
    }
    /// Returns the channel with that name.
    pub fn from_name(name: &str) -> Option<Self> {
        name.parse().ok()
    }
    /// Returns the channels of a comma-separated list of names, each once.
    ///
    /// # Errors
    /// [`ChannelError::Unknown`] with the first unknown name.
    pub fn list(names: &str) -> Result<Vec<Self>, ChannelError> {
        let mut channels = Vec::new();
        for name in names.split(',').map(str::trim) {
            let unknown = || ChannelError::Unknown { found: name.chars().take(NAME_CHARS).collect() };
            let channel = Self::from_name(name).ok_or_else(unknown)?;
            if !channels.contains(&channel) {
                channels.push(channel);
            }
        }
        Ok(channels)
    }
    /// Returns the requested channels of a capture, or all of its channels if none are named.
    ///
    /// # Errors
    /// [`ChannelError::Absent`] with the first channel that the capture does not have.
    pub fn chosen(wanted: Option<&[Self]>, has: &[Self]) -> Result<Vec<Self>, ChannelError> {
        let channels = wanted.unwrap_or(has).to_vec();
        match channels.iter().find(|channel| !has.contains(channel)) {
            Some(absent) => Err(ChannelError::Absent { channel: *absent, has: has.to_vec() }),
            None => Ok(channels),
        }
    }
    /// Returns the name of the channel's column in files that include the unit (docs/formats.md): `gyro_x_rad_s`.
    pub fn column_name(self) -> String {
        format!("{}{}", self.name(), self.csv_suffix())
    }
    /// Returns the triad of the channel; temperature and pressure stand alone.
    pub fn triad(self) -> Option<Triad> {
        match self {
            Self::Yaw | Self::Pitch | Self::Roll => Some(Triad::Attitude),
            Self::MagX | Self::MagY | Self::MagZ => Some(Triad::Mag),
            Self::AccelX | Self::AccelY | Self::AccelZ => Some(Triad::Accel),
            Self::GyroX | Self::GyroY | Self::GyroZ => Some(Triad::Gyro),
            Self::Temperature | Self::Pressure => None,
        }
    }
    /// Returns the unit in which the sensor sends and the database holds the channel.
    pub fn unit(self) -> &'static str {
        match self.triad() {
            Some(Triad::Attitude) => "deg",
            Some(Triad::Mag) => "gauss",
            Some(Triad::Accel) => "m/s²",
            Some(Triad::Gyro) => "rad/s",
            None if self == Self::Temperature => "°C",
            None => "kPa",
        }
    }
    /// Returns the suffix that names the unit in a CSV header (docs/formats.md): `gyro_x` + `_rad_s`.
    pub fn csv_suffix(self) -> &'static str {
        match self.triad() {
            Some(Triad::Attitude) => "_deg",
            Some(Triad::Mag) => "_gauss",
            Some(Triad::Accel) => "_m_s2",
            Some(Triad::Gyro) => "_rad_s",
            None if self == Self::Temperature => "_c",
            None => "_kpa",
        }
    }
    /// Returns the number of decimals in the VN-100's ASCII output in firmware 2 and 3 (recorded lines of 122 bytes;
    /// AN110's packet lengths).
    pub fn ascii_decimals(self) -> usize {
        match self.triad() {
            Some(Triad::Attitude | Triad::Accel) => 3,
            Some(Triad::Mag) => 4,
            Some(Triad::Gyro) => 6,
            None if self == Self::Temperature => 1,
            None => 3,
        }
    }
    /// Returns a power of two (its exponent) that no plausible value of this channel reaches, in the channel's unit. It
    /// fixes the fixed-point scale of exact sums. Gyro ±2000 °/s = 34.9 rad/s and accelerometer ±16 g = 157 m/s²
    /// (VN-100 data sheet), with room for other sensors.
    pub fn range_exponent(self) -> u32 {
        match self.triad() {
            Some(Triad::Attitude) => 9,
            Some(Triad::Mag) => 5,
            Some(Triad::Accel) => 9,
            Some(Triad::Gyro) => 7,
            None => 9,
        }
    }
}

/// The maximum number of characters of an unknown name in a message.
const NAME_CHARS: usize = 40;

/// The reasons why requested channels are not returned.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChannelError {
    /// There is no such channel.
    #[error("there is no `{found}`: channels are {}", names(&Channel::ALL))]
    Unknown {
        /// The beginning of the requested name.
        found: String,
    },
    /// The capture does not have the channel.
    #[error("the capture has no `{channel}`: it has {}", names(has))]
    Absent {
        /// The requested channel.
        channel: Channel,
        /// The channels of the capture.
        has: Vec<Channel>,
    },
}

fn names(channels: &[Channel]) -> String {
    channels.iter().map(|channel| channel.name()).collect::<Vec<_>>().join(", ")
}

/// A set of channels, as bits in column order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct ChannelSet(u16);

impl ChannelSet {
    /// The empty set.
    pub const EMPTY: Self = Self(0);
    /// Adds a channel.
    pub fn insert(&mut self, channel: Channel) {
        self.0 |= 1 << channel as u8;
    }
    /// Removes a channel.
    pub fn remove(&mut self, channel: Channel) {
        self.0 &= !(1 << channel as u8);
    }
    /// Returns whether the channel is in the set.
    pub fn contains(self, channel: Channel) -> bool {
        self.0 & (1 << channel as u8) != 0
    }
    /// Returns the channels of either set.
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
    /// Returns whether the set has no channel.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }
    /// Returns the channels in column order.
    pub fn iter(self) -> impl Iterator<Item = Channel> {
        Channel::ALL.into_iter().filter(move |channel| self.contains(*channel))
    }
}

impl FromIterator<Channel> for ChannelSet {
    fn from_iter<I: IntoIterator<Item = Channel>>(channels: I) -> Self {
        let mut set = Self::EMPTY;
        for channel in channels {
            set.insert(channel);
        }
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_channel_is_found_by_its_name() {
        for channel in Channel::ALL {
            assert_eq!(Channel::from_name(channel.name()), Some(channel));
        }
        assert_eq!(Channel::from_name("gyro"), None);
    }

    #[test]
    fn a_set_holds_what_was_put_in() {
        let set: ChannelSet = [Channel::GyroZ, Channel::Yaw].into_iter().collect();
        assert_eq!(set.iter().collect::<Vec<_>>(), [Channel::Yaw, Channel::GyroZ]);
        assert!(!set.contains(Channel::GyroX));
    }
}
