//! Samples: one instant of physical values, and the accounting of missing samples. Pure.

pub mod accounting;
pub mod audit;
pub mod channel;
pub mod description;
pub mod device_clock;
pub mod gap;
pub mod record;

pub use accounting::{Accountant, Observation, RateDoubt};
pub use channel::{Channel, ChannelError, ChannelSet, Triad};
pub use description::{
    CaptureConfiguration, ConnectedSensor, FilterWindows, Register85, Registers, SensorDescription, StatedSampling,
};
pub use gap::{Gap, GapCause};
pub use record::{DiscardCause, EventKind, EventRecord, Record, Segment, Timebase};

use serde::{Deserialize, Serialize};

/// One instant of physical values, in the sensor's units ([`Channel::unit`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// The sensor's own clock (TimeStartup) in ns since its reset; absent in ASCII messages.
    pub device_time_ns: Option<u64>,
    /// The serial count that ASCII messages may carry (register 30), 32 bits, wrapping.
    pub sync_count: Option<u32>,
    /// The time at which the sample's last byte was read, host monotonic clock, ns; 0 for a recording without host
    /// time.
    pub host_mono_ns: u64,
    /// The same instant in UTC, ns since 1970; 0 for a recording without host time.
    pub host_utc_ns: i64,
    /// The sample's number among all valid measurements that the capture has received, from 1, discarded ones included;
    /// 0 if they are not counted.
    pub frame: u64,
    channels: ChannelSet,
    values: [f64; Channel::COUNT],
}

impl Sample {
    /// Returns a sample at this host time, without values.
    pub fn at(host_mono_ns: u64, host_utc_ns: i64) -> Self {
        Self {
            device_time_ns: None,
            sync_count: None,
            host_mono_ns,
            host_utc_ns,
            frame: 0,
            channels: ChannelSet::EMPTY,
            values: [0.0; Channel::COUNT],
        }
    }
    /// Sets one channel's value. A value that is not finite leaves the channel absent, so that no NaN is passed on.
    pub fn set(&mut self, channel: Channel, value: f64) {
        if value.is_finite() {
            self.channels.insert(channel);
            self.values[channel as usize] = value;
        } else {
            self.channels.remove(channel);
        }
    }
    /// Returns the channel's value, if the sample has one.
    pub fn get(&self, channel: Channel) -> Option<f64> {
        self.channels.contains(channel).then(|| self.values[channel as usize])
    }
    /// Returns whether both samples have the same channels with the same values, regardless of their times.
    pub fn same_values(&self, other: &Self) -> bool {
        self.channels == other.channels && self.channels.iter().all(|channel| self.get(channel) == other.get(channel))
    }
    /// Returns the channels that have a value.
    pub fn channels(&self) -> ChannelSet {
        self.channels
    }
}
