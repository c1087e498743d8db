//! Errors that the sensor reports: `$VNERR,cc`.

/// An error code of the sensor.
///
/// # Source
/// User manual UM001 rev 2.45, section 3.8. Firmware 2.1 prints the codes above 9 in decimal, 3.x in hex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
pub enum DeviceError {
    /// 01
    #[error("the sensor reports error 01, hard fault: its processor failed and restarts; samples are missing")]
    HardFault,
    /// 02
    #[error("the sensor reports error 02, serial buffer overflow: its input buffer of 256 characters is full")]
    SerialBufferOverflow,
    /// 03
    #[error("the sensor reports error 03, invalid checksum: a command arrived damaged; send it again")]
    InvalidChecksum,
    /// 04
    #[error("the sensor reports error 04, invalid command: this firmware does not know the command")]
    InvalidCommand,
    /// 05
    #[error("the sensor reports error 05, not enough parameters")]
    NotEnoughParameters,
    /// 06
    #[error("the sensor reports error 06, too many parameters")]
    TooManyParameters,
    /// 07
    #[error("the sensor reports error 07, invalid parameter")]
    InvalidParameter,
    /// 08
    #[error("the sensor reports error 08, invalid register: this model or firmware does not have it")]
    InvalidRegister,
    /// 09
    #[error("the sensor reports error 09, unauthorized access: the register is read-only")]
    UnauthorizedAccess,
    /// 0A
    #[error("the sensor reports error 0A, watchdog reset: its processor restarted; samples are missing")]
    WatchdogReset,
    /// 0B
    #[error(
        "the sensor reports error 0B, output buffer overflow: more is to be sent than the baud rate carries; lower the rate or raise the baud rate"
    )]
    OutputBufferOverflow,
    /// 0C
    #[error(
        "the sensor reports error 0C, insufficient baud rate: lower the output rate, choose a shorter message or raise the baud rate"
    )]
    InsufficientBaudRate,
    /// FF
    #[error("the sensor reports error FF, error buffer overflow: some of its errors are lost")]
    ErrorBufferOverflow,
    /// A code that occurs in no manual.
    #[error("the sensor reports error {0:02X}, which the manual does not list")]
    Unknown(u8),
}

impl DeviceError {
    const KNOWN: [(u8, Self); 13] = [
        (0x01, Self::HardFault),
        (0x02, Self::SerialBufferOverflow),
        (0x03, Self::InvalidChecksum),
        (0x04, Self::InvalidCommand),
        (0x05, Self::NotEnoughParameters),
        (0x06, Self::TooManyParameters),
        (0x07, Self::InvalidParameter),
        (0x08, Self::InvalidRegister),
        (0x09, Self::UnauthorizedAccess),
        (0x0A, Self::WatchdogReset),
        (0x0B, Self::OutputBufferOverflow),
        (0x0C, Self::InsufficientBaudRate),
        (0xFF, Self::ErrorBufferOverflow),
    ];

    /// Returns the error with this code.
    pub fn from_code(code: u8) -> Self {
        Self::KNOWN.into_iter().find(|(known, _)| *known == code).map_or(Self::Unknown(code), |(_, error)| error)
    }

    /// Returns the code.
    pub fn code(self) -> u8 {
        match self {
            Self::Unknown(code) => code,
            known => Self::KNOWN.into_iter().find(|(_, error)| *error == known).map_or(0, |(code, _)| code),
        }
    }

    /// Returns the error with a code as a sensor prints it: hex (`0C`, `C`, `FF`), or the decimal `10`, `11`, `12`,
    /// `255` of firmware 2.1, which as hex would be codes that do not exist. `None` if the text is no code.
    pub fn from_text(text: &str) -> Option<Self> {
        let code = match text {
            "10" => 0x0A,
            "11" => 0x0B,
            "12" => 0x0C,
            "255" => 0xFF,
            hex if hex.len() <= 2 && hex.bytes().all(|byte| byte.is_ascii_hexdigit()) => {
                u8::from_str_radix(hex, 16).ok()?
            }
            _ => return None,
        };
        Some(Self::from_code(code))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hex_and_the_older_decimal_form_are_the_same_errors() {
        for (texts, error) in [
            (["0A", "A", "10"], DeviceError::WatchdogReset),
            (["0B", "B", "11"], DeviceError::OutputBufferOverflow),
            (["0C", "c", "12"], DeviceError::InsufficientBaudRate),
            (["FF", "ff", "255"], DeviceError::ErrorBufferOverflow),
            (["3", "03", "03"], DeviceError::InvalidChecksum),
        ] {
            for text in texts {
                assert_eq!(DeviceError::from_text(text), Some(error), "{text}");
            }
        }
        for text in ["", "G", "003", "-1", "+1"] {
            assert_eq!(DeviceError::from_text(text), None, "{text}");
        }
    }

    #[test]
    fn every_code_is_its_own_error() {
        for code in 0..=u8::MAX {
            assert_eq!(DeviceError::from_code(code).code(), code);
        }
        assert!(DeviceError::InsufficientBaudRate.to_string().contains("0C"));
    }
}
