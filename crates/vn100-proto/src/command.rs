//! Commands to the sensor and its replies.
//!
//! There is deliberately no command here that writes the sensor's flash (`VNWNV`), restores the factory settings (`VNRFS`)
//! or enters the bootloader (`VNFWU`): a logger never sends them.

use super::fields::read_fields;
use super::measurement::{Measurement, MeasurementKind};
use super::{AsciiType, ChecksumKind, encode};

/// A command to the sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Command {
    /// Read a register (`$VNRRG,n`). Registers 5, 6 and 7 take the number of a serial port.
    ReadRegister {
        /// The number of the register.
        register: u16,
        /// The serial port whose setting is requested; if absent, the one in use.
        port: Option<u8>,
    },
    /// Write a register in RAM (`$VNWRG,n,values`): lost at the next reset.
    WriteRegister {
        /// The number of the register.
        register: u16,
        /// The values in the form of the line, without leading comma.
        values: String,
    },
    /// Pause (`false`) or resume all asynchronous output of this port; registers keep their values (`$VNASY,0`).
    AsyncOutput(bool),
}

impl Command {
    /// Creates a command that reads `register`.
    pub fn read(register: u16) -> Self {
        Self::ReadRegister { register, port: None }
    }

    /// Creates a command that writes `values` to `register`.
    pub fn write(register: u16, values: impl std::fmt::Display) -> Self {
        Self::WriteRegister { register, values: values.to_string() }
    }

    /// Returns the line without `$`, checksum and line end. Register numbers have at least two digits.
    pub fn body(&self) -> String {
        match self {
            Self::ReadRegister { register, port: None } => format!("VNRRG,{register:02}"),
            Self::ReadRegister { register, port: Some(port) } => format!("VNRRG,{register:02},{port}"),
            Self::WriteRegister { register, values } => format!("VNWRG,{register:02},{values}"),
            Self::AsyncOutput(on) => format!("VNASY,{}", u8::from(*on)),
        }
    }

    /// Returns the bytes to send. A sensor accepts either checksum at any time, regardless of register 30.
    pub fn to_bytes(&self, checksum: ChecksumKind) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode::text_line(&mut bytes, &self.body(), checksum);
        bytes
    }
}

/// The kind of command that a reply answers: the word behind `VN`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Verb {
    /// `RRG`
    ReadRegister,
    /// `WRG`
    WriteRegister,
    /// `ASY`
    AsyncOutput,
    /// `BOM`
    PollBinary,
    /// `RST`
    Reset,
    /// `RFS`
    RestoreFactorySettings,
    /// `WNV`
    WriteSettings,
    /// `TAR`
    Tare,
    /// `KMD`
    KnownMagneticDisturbance,
    /// `KAD`
    KnownAccelerationDisturbance,
    /// `SGB`
    SetGyroBias,
}

impl Verb {
    /// Returns the verb with that header (without `$`): `VNRRG`.
    pub fn from_header(header: &[u8]) -> Option<Self> {
        Some(match header {
            b"VNRRG" => Self::ReadRegister,
            b"VNWRG" => Self::WriteRegister,
            b"VNASY" => Self::AsyncOutput,
            b"VNBOM" => Self::PollBinary,
            b"VNRST" => Self::Reset,
            b"VNRFS" => Self::RestoreFactorySettings,
            b"VNWNV" => Self::WriteSettings,
            b"VNTAR" => Self::Tare,
            b"VNKMD" => Self::KnownMagneticDisturbance,
            b"VNKAD" => Self::KnownAccelerationDisturbance,
            b"VNSGB" => Self::SetGyroBias,
            _ => return None,
        })
    }
}

/// A reply of the sensor (or a command, which has the same form).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply<'a> {
    /// The kind of command that it answers.
    pub verb: Verb,
    /// The register, for reads and writes; parsed as a number, since sensors print `08` and manuals `8`.
    pub register: Option<u16>,
    /// The text behind the register (or the verb), without leading comma; empty if there is none.
    pub values: &'a str,
    /// The line between `$` and `*`.
    pub body: &'a str,
}

impl<'a> Reply<'a> {
    /// Reads the part of a line between `$` and `*`; `None` if its verb is unknown or its register no number.
    pub fn parse(body: &'a str) -> Option<Self> {
        let (header, rest) = body.split_once(',').unwrap_or((body, ""));
        let verb = Verb::from_header(header.as_bytes())?;
        let (register, values) = match verb {
            Verb::ReadRegister | Verb::WriteRegister => {
                let (register, values) = rest.split_once(',').unwrap_or((rest, ""));
                if !register.bytes().all(|byte| byte.is_ascii_digit()) {
                    return None;
                }
                (Some(register.parse().ok()?), values)
            }
            _ => (None, rest),
        };
        Some(Self { verb, register, values, body })
    }

    /// Returns whether this is the reply to `command` (not whether the sensor executed it; a refusal is a
    /// [`DeviceError`](super::DeviceError)).
    pub fn answers(&self, command: &Command) -> bool {
        match command {
            Command::ReadRegister { register, .. } => {
                self.verb == Verb::ReadRegister && self.register == Some(*register)
            }
            Command::WriteRegister { register, .. } => {
                self.verb == Verb::WriteRegister && self.register == Some(*register)
            }
            Command::AsyncOutput(_) => self.verb == Verb::AsyncOutput,
        }
    }

    /// Returns the values of a measurement register that was read (8, 9, 10, 15, 17–20, 27, 54, 80, 115, 239, 240) as a
    /// measurement; `None` for other registers and values that are not numbers.
    pub fn measurement(&self) -> Option<Measurement> {
        if self.verb != Verb::ReadRegister {
            return None;
        }
        let ascii = AsciiType::from_register(self.register?)?;
        let mut measurement = Measurement::new(MeasurementKind::Ascii(ascii));
        read_fields(&mut measurement, ascii, self.values.as_bytes())?;
        Some(measurement)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(command: &Command, checksum: ChecksumKind) -> String {
        String::from_utf8(command.to_bytes(checksum)).unwrap()
    }

    #[test]
    fn commands_are_the_published_lines() {
        use ChecksumKind::{Crc16, Xor8};
        assert_eq!(text(&Command::write(7, 40), Xor8), "$VNWRG,07,40*59\r\n");
        assert_eq!(text(&Command::write(6, "1,1"), Crc16), "$VNWRG,06,1,1*CA15\r\n");
        assert_eq!(text(&Command::read(1), Crc16), "$VNRRG,01*E15F\r\n");
        assert_eq!(text(&Command::read(7), Xor8), "$VNRRG,07*74\r\n");
        assert_eq!(Command::ReadRegister { register: 5, port: Some(2) }.body(), "VNRRG,05,2");
        assert_eq!(Command::AsyncOutput(false).body(), "VNASY,0");
        assert_eq!(Command::read(115).body(), "VNRRG,115");
    }

    #[test]
    fn a_reply_is_recognised_by_verb_and_register_number() {
        let padded = Reply::parse("VNRRG,08,-114.314,+000.058,-001.773").unwrap();
        let plain = Reply::parse("VNRRG,8,-114.314,+000.058,-001.773").unwrap();
        assert_eq!((padded.register, padded.values), (plain.register, plain.values));
        assert!(padded.answers(&Command::read(8)));
        assert!(!padded.answers(&Command::read(9)));
        assert!(!padded.answers(&Command::write(8, 1)));
        assert!(Reply::parse("VNASY,0").unwrap().answers(&Command::AsyncOutput(false)));
        assert_eq!(Reply::parse("VNRST").unwrap().verb, Verb::Reset);
        for body in ["VNRRG,x", "VNRRG,-1", "VNRRG,", "VNRRG", "VNRRG,99999", "VNXYZ,1", "RRG,1", ""] {
            assert_eq!(Reply::parse(body), None, "{body}");
        }
    }
}
