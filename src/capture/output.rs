//! Output: the requested output of the sensor, the output that its registers state, and whether that fits the line.
//! Pure.

use vn100_proto::register::{BinaryOutput, CommunicationControl, SyncControl};
use vn100_proto::{AsciiType, FrameOptions, MeasurementKind, frame_bytes, link, max_rate_hz};

/// The requested output of the sensor.
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Binary output 1 with these groups and fields (hex, as register 75 takes them) every `divisor`-th of 800 Hz.
    Binary {
        /// Such as `01,0609`.
        fields: String,
        /// 800 Hz / rate.
        divisor: u32,
    },
    /// The ASCII message of register 6 with this number, at the rate of register 7.
    Ascii {
        /// Register 6.
        number: u8,
        /// Register 7.
        rate_hz: u32,
    },
    /// The sensor's present output.
    Keep,
}

impl Output {
    /// Returns the frames that this output consists of and their rate in Hz; `None` for `Keep`.
    pub fn kind_and_rate(&self) -> Option<(MeasurementKind, f64)> {
        match self {
            Self::Binary { fields, divisor } => binary_output(75, &format!("1,{divisor},{fields}")),
            Self::Ascii { number, rate_hz } => Some((ascii_kind(*number)?, f64::from(*rate_hz))),
            Self::Keep => None,
        }
    }
}

pub(super) fn is_binary(kind: MeasurementKind) -> bool {
    matches!(kind, MeasurementKind::Binary(_))
}

/// Returns the output that a binary output register with these values selects, and its rate in Hz; `None` if it is off.
pub(super) fn binary_output(register: u16, values: &str) -> Option<(MeasurementKind, f64)> {
    let output = BinaryOutput::parse(register, values).ok()?;
    let header = output.header.filter(|_| output.async_mode != 0)?;
    Some((MeasurementKind::Binary(header), output.rate_hz()?))
}

/// Returns the message with this number in register 6; `None` for 0 (off) and numbers that a VN-100 does not have.
pub(super) fn ascii_kind(number: u8) -> Option<MeasurementKind> {
    AsciiType::from_id(number).map(MeasurementKind::Ascii)
}

/// Register 32's SyncOutMode for a pulse at each start of an IMU sample, of which every (skip factor + 1)th is counted.
const SYNC_OUT_IMU: u32 = 1;
/// Register 32's SyncOutMode if the pin drives nothing: off, or the pulse of a GPS receiver, which a VN-100 lacks.
const SYNC_OUT_FREE: [u32; 2] = [0, 6];
/// Register 30's SerialCount for the SyncOut counter.
const SERIAL_COUNT_SYNC_OUT: u8 = 3;

/// Returns the skip factor with which the SyncOut counter increases by one for each message at this rate.
fn skip_factor(rate_hz: f64) -> Option<u32> {
    let samples = f64::from(link::INTERNAL_RATE_HZ) / rate_hz;
    (samples >= 1.0 && samples.fract() == 0.0).then(|| samples as u32 - 1)
}

/// Returns whether messages at this rate carry a count that increases by one for each, according to registers 30 and
/// 32.
pub(super) fn counts_messages(communication: &str, synchronization: &str, rate_hz: f64) -> bool {
    let Ok(communication) = CommunicationControl::parse(communication) else { return false };
    let Ok(synchronization) = SyncControl::parse(synchronization) else { return false };
    communication.serial_count == SERIAL_COUNT_SYNC_OUT
        && synchronization.sync_out_mode == SYNC_OUT_IMU
        && Some(synchronization.sync_out_skip_factor) == skip_factor(rate_hz)
}

/// Returns the values of registers 32 and 30 that make the sensor number its messages. Empty if they are set already,
/// or if the SyncOut pin or the count is used for something else.
pub(super) fn serial_count(communication: &str, synchronization: &str, rate_hz: f64) -> Vec<(u16, String)> {
    let (Ok(mut communication), Ok(mut synchronization), Some(skip)) =
        (CommunicationControl::parse(communication), SyncControl::parse(synchronization), skip_factor(rate_hz))
    else {
        return Vec::new();
    };
    let count_is_free = communication.serial_count == 0 || communication.serial_count == SERIAL_COUNT_SYNC_OUT;
    let pin_is_free = SYNC_OUT_FREE.contains(&synchronization.sync_out_mode);
    let pin_is_right = synchronization.sync_out_mode == SYNC_OUT_IMU && synchronization.sync_out_skip_factor == skip;
    let mut writes = Vec::new();
    if count_is_free && (pin_is_free || pin_is_right) {
        if !pin_is_right {
            (synchronization.sync_out_mode, synchronization.sync_out_skip_factor) = (SYNC_OUT_IMU, skip);
            writes.push((32, synchronization.to_string()));
        }
        if communication.serial_count == 0 {
            communication.serial_count = SERIAL_COUNT_SYNC_OUT;
            writes.push((30, communication.to_string()));
        }
    }
    writes
}

/// Checks whether frames of this kind at this rate fit a line of this baud rate.
///
/// # Errors
/// The calculation, as a sentence for the user.
pub fn check_fit(kind: MeasurementKind, rate_hz: f64, baud: u32) -> Result<(), String> {
    let bytes = frame_bytes(&kind, &FrameOptions::default());
    let share = link::link_share(bytes, rate_hz, baud);
    if share <= 1.0 {
        return Ok(());
    }
    let bits = bytes as f64 * rate_hz * f64::from(link::BITS_PER_BYTE);
    Err(format!(
        "{kind} at {rate_hz} Hz does not fit {baud} baud: {bytes} bytes × {rate_hz} Hz × {} bits = {bits:.0} bit/s, which is {:.0} % of the line; lower the rate (at most {:.0} Hz), choose a shorter output, or raise the sensor's baud rate",
        link::BITS_PER_BYTE,
        100.0 * share,
        max_rate_hz(bytes, baud).floor(),
    ))
}
