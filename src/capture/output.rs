//! Output: what the sensor shall send, what its registers say it sends, and whether that fits the line. Pure.

use crate::protocol::register::BinaryOutput;
use crate::protocol::{AsciiType, FrameOptions, MeasurementKind, frame_bytes, link, max_rate_hz};

/// What the sensor shall send.
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
    /// Whatever it sends.
    Keep,
}

impl Output {
    /// The frames that this output consists of and their rate in Hz; `None` for what is kept.
    #[must_use]
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

/// What a binary output register with these values sends, and its rate in Hz; `None` where it is off.
pub(super) fn binary_output(register: u16, values: &str) -> Option<(MeasurementKind, f64)> {
    let output = BinaryOutput::parse(register, values).ok()?;
    let header = output.header.filter(|_| output.async_mode != 0)?;
    Some((MeasurementKind::Binary(header), output.rate_hz()?))
}

/// The message with this number in register 6; `None` for 0 (off) and numbers that a VN-100 does not have.
pub(super) fn ascii_kind(number: u8) -> Option<MeasurementKind> {
    AsciiType::from_id(number).map(MeasurementKind::Ascii)
}

/// Whether frames of this kind at this rate fit a line of this baud rate.
///
/// # Errors
/// The arithmetic, as a sentence for a person.
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
