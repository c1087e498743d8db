//! Encoding: converts measurements and text to the bytes that a sensor of firmware 2 or 3 sends.

use super::binary::{Field, SYNC};
use super::checksum::{crc16, xor8};
use super::measurement::MeasurementKind;
use super::{AsciiType, BinaryHeader, ChecksumKind, Measurement};
use std::io::Write as _;

/// Appends `$body*checksum` with CR and LF.
pub fn text_line(out: &mut Vec<u8>, body: &str, checksum: ChecksumKind) {
    out.push(b'$');
    out.extend_from_slice(body.as_bytes());
    finish_line(out, body.len(), checksum);
}

/// Closes a line whose last `length` bytes are its body.
fn finish_line(out: &mut Vec<u8>, length: usize, checksum: ChecksumKind) {
    let body = out.get(out.len().saturating_sub(length)..).unwrap_or_default();
    // writing into a vector cannot fail
    let _ = match checksum {
        ChecksumKind::Xor8 => {
            let sum = xor8(body);
            write!(out, "*{sum:02X}\r\n")
        }
        ChecksumKind::Crc16 => {
            let crc = crc16(body);
            write!(out, "*{crc:04X}\r\n")
        }
    };
}

/// Appends the numbers of a message, each led by a comma, as firmware 2 and 3 print them.
pub fn numbers(out: &mut Vec<u8>, ascii: AsciiType, measurement: &Measurement) {
    for quantity in ascii.quantities() {
        let format = quantity.ascii_format();
        for value in measurement.values_or_zero(*quantity) {
            let _ = write!(out, ",{value:+0width$.decimals$}", width = format.width, decimals = format.decimals);
        }
    }
}

/// Appends an asynchronous ASCII message. A serial count and a status are added if the measurement has them
/// (`sync_count`, `vpe_status`), in the order of recordings: count, then status. Quantities it lacks are sent as 0.
pub fn ascii_message(out: &mut Vec<u8>, ascii: AsciiType, measurement: &Measurement, checksum: ChecksumKind) {
    out.push(b'$');
    let start = out.len();
    out.extend_from_slice(ascii.header().as_bytes());
    numbers(out, ascii, measurement);
    if let Some(count) = measurement.sync_count {
        let _ = write!(out, ",T{count:010}");
    }
    if let Some(status) = measurement.vpe_status {
        let _ = write!(out, ",S{status:04X}");
    }
    let length = out.len() - start;
    finish_line(out, length, checksum);
}

/// Appends a binary frame. Numbers become 32-bit floats; quantities that the measurement lacks are sent as 0.
pub fn binary_frame(out: &mut Vec<u8>, header: &BinaryHeader, measurement: &Measurement) {
    out.push(SYNC);
    let start = out.len();
    out.push(header.groups());
    for mask in header.masks() {
        out.extend_from_slice(&mask.to_le_bytes());
    }
    for field in header.fields() {
        match field {
            Field::None => {}
            Field::TimeStartup => out.extend_from_slice(&measurement.device_time_ns.unwrap_or(0).to_le_bytes()),
            Field::TimeSyncIn => out.extend_from_slice(&measurement.time_sync_in_ns.unwrap_or(0).to_le_bytes()),
            Field::SyncInCount => out.extend_from_slice(&measurement.sync_in_count.unwrap_or(0).to_le_bytes()),
            Field::SyncOutCount => out.extend_from_slice(&measurement.sync_count.unwrap_or(0).to_le_bytes()),
            Field::TimeStatus => out.extend_from_slice(&measurement.time_status.unwrap_or(0).to_le_bytes()),
            Field::VpeStatus => out.extend_from_slice(&measurement.vpe_status.unwrap_or(0).to_le_bytes()),
            Field::ImuStatus => out.extend_from_slice(&measurement.imu_status.unwrap_or(0).to_le_bytes()),
            Field::SensorSaturation => {
                out.extend_from_slice(&measurement.sensor_saturation.unwrap_or(0).to_le_bytes());
            }
            Field::Floats(quantities) => {
                for quantity in quantities {
                    for value in measurement.values_or_zero(*quantity) {
                        out.extend_from_slice(&(*value as f32).to_le_bytes());
                    }
                }
            }
        }
    }
    let crc = crc16(out.get(start..).unwrap_or_default());
    out.extend_from_slice(&crc.to_be_bytes());
}

/// Appends the measurement as the message of its kind.
pub fn measurement(out: &mut Vec<u8>, measurement: &Measurement, checksum: ChecksumKind) {
    match &measurement.kind {
        MeasurementKind::Ascii(ascii) => ascii_message(out, *ascii, measurement, checksum),
        MeasurementKind::Binary(header) => binary_frame(out, header, measurement),
    }
}
