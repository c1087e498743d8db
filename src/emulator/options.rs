//! The properties of the virtual sensor: its description in the registers, its port and times, and the tick in which
//! these are counted.

use imu_core::units::NANOS_PER_SECOND;
use vn100_proto::link::INTERNAL_RATE_HZ;

/// Nanoseconds of one tick: 1/800 s, a whole number of microseconds, as a real TimeStartup is.
pub const TICK_NS: u64 = NANOS_PER_SECOND / INTERNAL_RATE_HZ as u64;

/// The properties of the sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SensorOptions {
    /// Register 0, at most 20 characters.
    pub user_tag: String,
    /// Register 1.
    pub model: String,
    /// Register 2.
    pub hardware_revision: u32,
    /// Register 3.
    pub serial_number: String,
    /// Register 4; below 3.1 there are VNDCM and VNTAR.
    pub firmware: String,
    /// The serial port in use, 1 or 2.
    pub port: u8,
    /// The time that its clock ran before tick 0, in ticks.
    pub uptime_ticks: u64,
    /// The silence after a reset, in ticks: 1.25 s (ArduPilot#22488).
    pub boot_ticks: u64,
}

impl Default for SensorOptions {
    fn default() -> Self {
        Self {
            user_tag: "vn100d emulator".to_owned(),
            model: "VN-100T-CR".to_owned(),
            hardware_revision: 7,
            serial_number: "0100012345".to_owned(),
            firmware: "3.1.0.0".to_owned(),
            port: 1,
            uptime_ticks: 0,
            boot_ticks: 1000,
        }
    }
}
