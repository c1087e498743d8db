//! Protocol: the VN-100's serial language, bytes ↔ frames. Pure: no I/O, no clock, no allocation per frame.
//!
//! In: bytes in any division ([`Decoder`]), or measurements and commands to be sent ([`encode`], [`Command`]). Out:
//! [`Event`]s (measurements, replies, errors of the device, rejected data, to the byte). Guarantees: any division of
//! the input gives the same events. A failed frame costs one byte, never the data behind it. The encoder writes byte
//! for byte what firmware 2 and 3 send. Refuses: binary groups and fields that a VN-100 does not have, lines above 320
//! bytes, fields that are not numbers.
//!
//! Sources: VN-100 user manual UM001 rev 2.45 (firmware 3.0.0.0), application note AN110, the official SDK 0.99.0 and
//! recordings of real sensors; the vectors under `tests/golden/protocol/` name theirs.
//!
//! # Example
//! ```
//! use vn100_proto::{Decoder, DecoderOptions, Event, Quantity};
//!
//! let mut decoder = Decoder::new(DecoderOptions::default());
//! let mut accelerations_m_s2 = Vec::new();
//! let mut sink = |event: Event<'_>| {
//!     if let Event::Measurement(measurement) = event {
//!         accelerations_m_s2.extend(measurement.vector(Quantity::Accel));
//!     }
//! };
//! // A line may arrive in any division.
//! decoder.push(b"$VNACC,+00.105,-0", &mut sink);
//! decoder.push(b"0.250,-10.148*4F\r\n", &mut sink);
//! assert_eq!(accelerations_m_s2, [[0.105, -0.25, -10.148]]);
//! ```

pub mod ascii;
pub mod binary;
pub mod checksum;
pub mod command;
pub mod decoder;
pub mod encode;
pub mod error;
mod fields;
pub mod link;
pub mod measurement;
pub mod quantity;
pub mod register;

pub use ascii::AsciiType;
pub use binary::BinaryHeader;
pub use checksum::ChecksumKind;
pub use command::{Command, Reply, Verb};
pub use decoder::{BinaryAcceptance, Decoder, DecoderOptions, DecoderStats, Event};
pub use error::DeviceError;
pub use link::{FrameOptions, frame_bytes, max_rate_hz};
pub use measurement::{Measurement, MeasurementKind};
pub use quantity::Quantity;

#[cfg(test)]
mod tests;
