//! Raw counts: a recording whose values were never scaled. It is recognised by values that no sensor measures in the
//! channel's unit.

use imu_core::sample::Channel;

/// A channel whose values mostly exceed its measuring range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RawCounts {
    channel: Channel,
    beyond: u64,
    values: u64,
}

impl RawCounts {
    /// Returns the channel if more than half of its values exceed its measuring range.
    pub(super) fn of(channel: Channel, beyond: u64, values: u64) -> Option<Self> {
        (beyond > values / 2).then_some(Self { channel, beyond, values })
    }
}

impl std::fmt::Display for RawCounts {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { channel, beyond, values } = self;
        let unit = channel.unit();
        write!(
            to,
            "{beyond} of {values} values of {channel} are beyond what it can measure in {unit}: raw counts? give the scale, so that \
             they are {unit}"
        )
    }
}
