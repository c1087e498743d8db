//! Registers whose meaning the program needs: text values ↔ typed values.
//!
//! Each type reads the values of a reply ([`Reply::values`](super::Reply)) and prints the values of a write command. A
//! value that is unknown to this program stays available as the reply's text.
//!
//! Source: user manual UM001 rev 2.45, chapters 5 and 6.

use super::binary::BinaryHeader;
use std::fmt;

/// User tag, 20 characters.
pub const USER_TAG: u16 = 0;
/// Model number.
pub const MODEL: u16 = 1;
/// Hardware revision.
pub const HARDWARE_REVISION: u16 = 2;
/// Serial number.
pub const SERIAL_NUMBER: u16 = 3;
/// Firmware version.
pub const FIRMWARE: u16 = 4;
/// Baud rate.
pub const BAUD_RATE: u16 = 5;
/// Type of the asynchronous ASCII message.
pub const ASYNC_TYPE: u16 = 6;
/// Rate of the asynchronous ASCII message.
pub const ASYNC_RATE: u16 = 7;
/// Communication protocol control.
pub const COMMUNICATION: u16 = 30;
/// Synchronization control.
pub const SYNCHRONIZATION: u16 = 32;
/// Synchronization status.
pub const SYNCHRONIZATION_STATUS: u16 = 33;
/// Binary output 1; 76 and 77 are outputs 2 and 3.
pub const BINARY_OUTPUT_1: u16 = 75;
/// Binary output 3.
pub const BINARY_OUTPUT_3: u16 = 77;
/// IMU filtering.
pub const IMU_FILTER: u16 = 85;

/// Register values of an unexpected form.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("register {register}: `{found}` is not {expected}")]
pub struct RegisterError {
    /// The register.
    pub register: u16,
    /// The expected form.
    pub expected: &'static str,
    /// The values found.
    pub found: String,
}

/// Parses numbers separated by commas: exactly `N`.
fn numbers<T: std::str::FromStr + Copy + Default, const N: usize>(values: &str) -> Option<[T; N]> {
    let mut numbers = [T::default(); N];
    let mut fields = values.split(',');
    for slot in &mut numbers {
        *slot = fields.next()?.trim().parse().ok()?;
    }
    fields.next().is_none().then_some(numbers)
}

/// Register 30: the additions to ASCII messages, their checksum, and the reporting of errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CommunicationControl {
    /// 0 none, 1 SyncIn count, 2 SyncIn time (µs), 3 SyncOut count, 4 GPS PPS.
    pub serial_count: u8,
    /// 0 none, 1 VPE status, 2 INS status.
    pub serial_status: u8,
    /// As `serial_count`, for SPI.
    pub spi_count: u8,
    /// As `serial_status`, for SPI.
    pub spi_status: u8,
    /// 1 XOR of eight bits, 3 CRC-16.
    pub serial_checksum: u8,
    /// 0 none, 1 XOR, 3 CRC-16.
    pub spi_checksum: u8,
    /// 0 ignore errors, 1 send them, 2 send them and turn the asynchronous output off.
    pub error_mode: u8,
}

impl Default for CommunicationControl {
    /// Returns `0,0,0,0,1,0,1`.
    fn default() -> Self {
        Self {
            serial_count: 0,
            serial_status: 0,
            spi_count: 0,
            spi_status: 0,
            serial_checksum: 1,
            spi_checksum: 0,
            error_mode: 1,
        }
    }
}

impl CommunicationControl {
    /// Reads the values of register 30.
    ///
    /// # Errors
    /// [`RegisterError`] if they are not seven numbers.
    pub fn parse(values: &str) -> Result<Self, RegisterError> {
        let [serial_count, serial_status, spi_count, spi_status, serial_checksum, spi_checksum, error_mode] =
            numbers(values).ok_or_else(|| RegisterError {
                register: COMMUNICATION,
                expected: "seven numbers",
                found: values.to_owned(),
            })?;
        Ok(Self { serial_count, serial_status, spi_count, spi_status, serial_checksum, spi_checksum, error_mode })
    }

    /// Returns the checksum of the sensor's output.
    pub fn checksum(&self) -> super::ChecksumKind {
        if self.serial_checksum == 3 { super::ChecksumKind::Crc16 } else { super::ChecksumKind::Xor8 }
    }

    /// Returns the additions to the length of ASCII messages.
    pub fn frame_options(&self) -> super::FrameOptions {
        super::FrameOptions {
            serial_count: self.serial_count != 0,
            serial_status: self.serial_status != 0,
            checksum: self.checksum(),
        }
    }
}

impl fmt::Display for CommunicationControl {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { serial_count, serial_status, spi_count, spi_status, serial_checksum, spi_checksum, error_mode } =
            self;
        write!(
            formatter,
            "{serial_count},{serial_status},{spi_count},{spi_status},{serial_checksum},{spi_checksum},{error_mode}"
        )
    }
}

/// Register 32: synchronization input and output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SyncControl {
    /// The effect of a SyncIn pulse (3: counts).
    pub sync_in_mode: u32,
    /// 0 rising edge, 1 falling edge.
    pub sync_in_edge: u32,
    /// Pulses skipped between two that count.
    pub sync_in_skip_factor: u32,
    /// Reserved.
    pub reserved_in: u32,
    /// The source of SyncOut pulses: 0 nothing, 1 start of an IMU sample (800 Hz), 2 IMU ready, 3 attitude ready, 6 GPS
    /// PPS.
    pub sync_out_mode: u32,
    /// 0 negative pulse, 1 positive.
    pub sync_out_polarity: u32,
    /// Events skipped between two pulses: with 19 of 800 Hz the counter increases by 1 at 40 Hz.
    pub sync_out_skip_factor: u32,
    /// Length of a pulse, ns.
    pub sync_out_pulse_width_ns: u32,
    /// Reserved.
    pub reserved_out: u32,
}

impl Default for SyncControl {
    /// Returns `3,0,0,0,6,1,0,100000000,0`.
    fn default() -> Self {
        Self {
            sync_in_mode: 3,
            sync_in_edge: 0,
            sync_in_skip_factor: 0,
            reserved_in: 0,
            sync_out_mode: 6,
            sync_out_polarity: 1,
            sync_out_skip_factor: 0,
            sync_out_pulse_width_ns: 100_000_000,
            reserved_out: 0,
        }
    }
}

impl SyncControl {
    /// Reads the values of register 32.
    ///
    /// # Errors
    /// [`RegisterError`] if they are not nine numbers.
    pub fn parse(values: &str) -> Result<Self, RegisterError> {
        let [
            sync_in_mode,
            sync_in_edge,
            sync_in_skip_factor,
            reserved_in,
            sync_out_mode,
            sync_out_polarity,
            sync_out_skip_factor,
            sync_out_pulse_width_ns,
            reserved_out,
        ] = numbers(values).ok_or_else(|| RegisterError {
            register: SYNCHRONIZATION,
            expected: "nine numbers",
            found: values.to_owned(),
        })?;
        Ok(Self {
            sync_in_mode,
            sync_in_edge,
            sync_in_skip_factor,
            reserved_in,
            sync_out_mode,
            sync_out_polarity,
            sync_out_skip_factor,
            sync_out_pulse_width_ns,
            reserved_out,
        })
    }
}

impl fmt::Display for SyncControl {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{},{},{},{},{},{},{},{},{}",
            self.sync_in_mode,
            self.sync_in_edge,
            self.sync_in_skip_factor,
            self.reserved_in,
            self.sync_out_mode,
            self.sync_out_polarity,
            self.sync_out_skip_factor,
            self.sync_out_pulse_width_ns,
            self.reserved_out
        )
    }
}

/// Register 33: synchronization counters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct SyncStatus {
    /// SyncIn pulses counted.
    pub sync_in_count: u32,
    /// Time since the last SyncIn pulse, µs.
    pub sync_in_time_us: u32,
    /// SyncOut pulses counted; writing 0 restarts the count.
    pub sync_out_count: u32,
}

impl SyncStatus {
    /// Reads the values of register 33.
    ///
    /// # Errors
    /// [`RegisterError`] if they are not three numbers.
    pub fn parse(values: &str) -> Result<Self, RegisterError> {
        let [sync_in_count, sync_in_time_us, sync_out_count] = numbers(values).ok_or_else(|| RegisterError {
            register: SYNCHRONIZATION_STATUS,
            expected: "three numbers",
            found: values.to_owned(),
        })?;
        Ok(Self { sync_in_count, sync_in_time_us, sync_out_count })
    }
}

impl fmt::Display for SyncStatus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{},{},{}", self.sync_in_count, self.sync_in_time_us, self.sync_out_count)
    }
}

/// Registers 75–77: a binary output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct BinaryOutput {
    /// The port on which it is sent: 0 none, 1 port 1, 2 port 2, 3 both.
    pub async_mode: u8,
    /// The output is sent at 800 Hz / divisor.
    pub rate_divisor: u16,
    /// The content; `None` if no group is selected (the default, `0,0,0`).
    pub header: Option<BinaryHeader>,
}

impl BinaryOutput {
    /// Reads the values of register 75, 76 or 77; groups and fields are hex.
    ///
    /// # Errors
    /// [`RegisterError`] if they are not mode, divisor, groups and one mask per group, or select groups or fields that
    /// a VN-100 does not have.
    pub fn parse(register: u16, values: &str) -> Result<Self, RegisterError> {
        let refuse = || RegisterError {
            register,
            expected: "mode, divisor, groups and fields of a VN-100's binary output",
            found: values.to_owned(),
        };
        let mut fields = values.splitn(3, ',').map(str::trim);
        let (mode, divisor, selection) = (fields.next(), fields.next(), fields.next());
        let async_mode = mode.and_then(|mode| mode.parse().ok()).ok_or_else(refuse)?;
        let rate_divisor = divisor.and_then(|divisor| divisor.parse().ok()).ok_or_else(refuse)?;
        let selection = selection.ok_or_else(refuse)?;
        let header = match u8::from_str_radix(selection, 16) {
            Ok(0) => None,
            _ => Some(BinaryHeader::parse_register(selection).map_err(|_| refuse())?),
        };
        Ok(Self { async_mode, rate_divisor, header })
    }

    /// Returns the rate in Hz; `None` if the divisor is 0.
    pub fn rate_hz(&self) -> Option<f64> {
        (self.rate_divisor != 0).then(|| f64::from(super::link::INTERNAL_RATE_HZ) / f64::from(self.rate_divisor))
    }

    /// Returns whether the output is sent on that port (1 or 2).
    pub fn is_sent_on(&self, port: u8) -> bool {
        self.header.is_some() && self.rate_divisor != 0 && self.async_mode & port != 0
    }
}

impl fmt::Display for BinaryOutput {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{},{},", self.async_mode, self.rate_divisor)?;
        match &self.header {
            Some(header) => header.fmt(formatter),
            None => formatter.write_str("0"),
        }
    }
}

/// Register 85: the moving averages over 800 Hz samples in front of the outputs. Order everywhere: magnetometer,
/// accelerometer, gyroscope, temperature, pressure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ImuFilter {
    /// Samples per average.
    pub windows: [u16; 5],
    /// 0 none, 1 uncompensated values only, 2 compensated only, 3 both.
    pub modes: [u8; 5],
}

impl Default for ImuFilter {
    /// Returns `0,4,4,4,0,0,3,3,3,0`: the manual's factory table, confirmed by the autocorrelation of a firmware 3.1
    /// unit (the register's own example has 5).
    fn default() -> Self {
        Self { windows: [0, 4, 4, 4, 0], modes: [0, 3, 3, 3, 0] }
    }
}

impl ImuFilter {
    /// Reads the values of register 85.
    ///
    /// # Errors
    /// [`RegisterError`] if they are not ten numbers.
    pub fn parse(values: &str) -> Result<Self, RegisterError> {
        let refuse = || RegisterError {
            register: IMU_FILTER,
            expected: "five windows and five modes",
            found: values.to_owned(),
        };
        let [a, b, c, d, e, modes @ ..] = numbers::<u16, 10>(values).ok_or_else(refuse)?;
        let mut filter = Self { windows: [a, b, c, d, e], modes: [0; 5] };
        for (slot, mode) in filter.modes.iter_mut().zip(modes) {
            *slot = u8::try_from(mode).map_err(|_| refuse())?;
        }
        Ok(filter)
    }
}

impl fmt::Display for ImuFilter {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e] = self.windows;
        let [f, g, h, i, j] = self.modes;
        write!(formatter, "{a},{b},{c},{d},{e},{f},{g},{h},{i},{j}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_printed_as_they_were_read() {
        for values in ["0,0,0,0,1,0,1", "3,1,0,0,3,0,2"] {
            assert_eq!(CommunicationControl::parse(values).unwrap().to_string(), values);
        }
        assert_eq!(CommunicationControl::default().to_string(), "0,0,0,0,1,0,1");
        assert_eq!(SyncControl::default().to_string(), "3,0,0,0,6,1,0,100000000,0");
        assert_eq!(SyncControl::parse("3,0,0,0,1,1,19,100000000,0").unwrap().sync_out_skip_factor, 19);
        assert_eq!(SyncStatus::parse("2552498,0,0").unwrap().to_string(), "2552498,0,0");
        for values in ["0,0,0", "1,20,01,0609", "3,400,01,0321", "3,80,14,073E,0004", "1,16,05,0008,0010"] {
            let Ok(output) = BinaryOutput::parse(75, values) else {
                // GNSS fields of another product in the published line
                assert_eq!(values, "3,80,14,073E,0004");
                continue;
            };
            assert_eq!(output.to_string(), values);
        }
        assert_eq!(BinaryOutput::parse(75, "3,400,1,321").unwrap().rate_hz(), Some(2.0));
        assert_eq!(ImuFilter::default().to_string(), "0,4,4,4,0,0,3,3,3,0");
        assert_eq!(ImuFilter::parse("0,5,5,5,0,0,3,3,3,0").unwrap().windows, [0, 5, 5, 5, 0]);
    }

    #[test]
    fn values_that_do_not_belong_there_are_refused() {
        assert!(CommunicationControl::parse("0,0,0").is_err());
        assert!(SyncControl::parse("a,0,0,0,6,1,0,100000000,0").is_err());
        assert!(BinaryOutput::parse(75, "1,20").is_err());
        assert!(BinaryOutput::parse(75, "1,20,01").is_err());
        assert!(BinaryOutput::parse(75, "1,20,01,8000").is_err());
        let error = ImuFilter::parse("0,4").unwrap_err();
        assert_eq!(error.to_string(), "register 85: `0,4` is not five windows and five modes");
    }

    #[test]
    fn an_output_is_sent_on_the_ports_of_its_mode() {
        let output = BinaryOutput::parse(75, "2,20,01,0609").unwrap();
        assert!(!output.is_sent_on(1));
        assert!(output.is_sent_on(2));
        assert!(!BinaryOutput::parse(75, "0,20,01,0609").unwrap().is_sent_on(1));
        assert!(!BinaryOutput::parse(75, "0,0,0").unwrap().is_sent_on(1));
        assert_eq!(BinaryOutput::default().to_string(), "0,0,0");
    }
}
