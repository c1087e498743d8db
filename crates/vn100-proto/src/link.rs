//! The link: the size of a message in bytes and the rate at which it fits a baud rate.

use super::{ChecksumKind, MeasurementKind};

/// Output rates of ASCII messages in Hz (register 7; user manual UM001 rev 2.45, section 5.2.8).
pub const ASCII_RATES_HZ: [u32; 11] = [1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200];
/// Baud rates of the sensor (register 5; section 5.2.6). Linux has no constant for 128000.
pub const BAUD_RATES: [u32; 9] = [9600, 19_200, 38_400, 57_600, 115_200, 128_000, 230_400, 460_800, 921_600];
/// The sensor's baud rate as delivered.
pub const DEFAULT_BAUD: u32 = 115_200;
/// Internal sampling rate of the sensor in Hz: binary outputs are sent at 800 Hz / divisor.
pub const INTERNAL_RATE_HZ: u32 = 800;
/// A byte on the line: start bit, eight data bits, stop bit.
pub const BITS_PER_BYTE: u32 = 10;

/// The fields that register 30 adds to ASCII messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct FrameOptions {
    /// `,T` and ten digits.
    pub serial_count: bool,
    /// `,S` and four digits.
    pub serial_status: bool,
    /// Two or four digits behind the `*`.
    pub checksum: ChecksumKind,
}

/// Returns the bytes of one message on the line: a binary frame exactly, a line (CR and LF included) in the number
/// formats of firmware 2 and 3. A line is longer by one byte per acceleration beyond ±99.999 m/s²; [`FrameOptions`]
/// does not affect binary frames.
pub fn frame_bytes(kind: &MeasurementKind, options: &FrameOptions) -> usize {
    match kind {
        MeasurementKind::Binary(header) => header.frame_bytes(),
        MeasurementKind::Ascii(ascii) => {
            let numbers: usize = ascii
                .quantities()
                .iter()
                .map(|quantity| quantity.components() * (1 + quantity.ascii_format().width))
                .sum();
            let count = if options.serial_count { ",T0000000000".len() } else { 0 };
            let status = if options.serial_status { ",S0000".len() } else { 0 };
            "$".len()
                + ascii.header().len()
                + numbers
                + count
                + status
                + "*".len()
                + options.checksum.digits()
                + "\r\n".len()
        }
    }
}

/// Returns the highest rate in Hz at which messages of this many bytes fit a baud rate (8N1, the whole link). Infinite
/// for 0 bytes.
pub fn max_rate_hz(bytes: usize, baud: u32) -> f64 {
    f64::from(baud) / f64::from(BITS_PER_BYTE) / bytes as f64
}

/// Returns the share of the link that a rate uses: 1 is all of it.
pub fn link_share(bytes: usize, rate_hz: f64, baud: u32) -> f64 {
    rate_hz / max_rate_hz(bytes, baud)
}

#[cfg(test)]
mod tests {
    use super::super::{AsciiType, BinaryHeader};
    use super::*;

    #[test]
    fn message_lengths_are_those_of_application_note_110_and_recordings() {
        use AsciiType::{Acc, Dcm, Dtv, Gyr, Hve, Imu, Mag, Mar, Qmr, Qtn, Yba, Yia, Ymr, Ypr};
        for (ascii, bytes) in [
            (Ypr, 38),
            (Qtn, 51),
            (Qmr, 135),
            (Dcm, 101),
            (Mag, 38),
            (Acc, 35),
            (Gyr, 44),
            (Mar, 95),
            (Ymr, 122),
            (Yba, 95),
            (Yia, 95),
            (Imu, 110),
            (Dtv, 75),
            (Hve, 35),
        ] {
            let kind = MeasurementKind::Ascii(ascii);
            assert_eq!(frame_bytes(&kind, &FrameOptions::default()), bytes, "{kind}");
            let all = FrameOptions { serial_count: true, serial_status: true, checksum: ChecksumKind::Crc16 };
            assert_eq!(frame_bytes(&kind, &all), bytes + 20, "{kind}");
        }
        let binary = MeasurementKind::Binary(BinaryHeader::parse_register("01,0609").unwrap());
        assert_eq!(frame_bytes(&binary, &FrameOptions::default()), 70);
    }

    #[test]
    fn the_highest_rates_are_those_of_the_table() {
        let bauds = [9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600];
        for (bytes, rates) in [
            (38, [25, 50, 100, 100, 200, 200, 200, 200]),
            (51, [10, 25, 50, 100, 200, 200, 200, 200]),
            (135, [5, 10, 25, 40, 50, 100, 200, 200]),
            (35, [25, 50, 100, 100, 200, 200, 200, 200]),
            (44, [20, 40, 50, 100, 200, 200, 200, 200]),
            (95, [10, 20, 40, 50, 100, 200, 200, 200]),
            (122, [5, 10, 25, 40, 50, 100, 200, 200]),
            (110, [5, 10, 25, 50, 100, 200, 200, 200]),
            (75, [10, 25, 50, 50, 100, 200, 200, 200]),
        ] {
            for (baud, rate) in bauds.into_iter().zip(rates) {
                let fits = |rate: &u32| f64::from(*rate) <= max_rate_hz(bytes, baud);
                assert_eq!(ASCII_RATES_HZ.into_iter().rfind(fits), Some(rate), "{bytes} bytes at {baud}");
            }
        }
    }

    #[test]
    fn the_default_output_takes_a_quarter_of_the_link() {
        assert!((link_share(70, 40.0, 115_200) - 0.243).abs() < 5e-4);
        assert!((max_rate_hz(110, 921_600) - 837.8).abs() < 0.05);
    }
}
