//! Emulator: a VN-100 that accepts commands, on a pseudo-terminal.
//!
//! [`sensor`] is the sensor itself, pure: bytes and ticks in, bytes out. [`registers`] is its memory, and [`instant`]
//! converts channel values to the content of its messages. The encoder is that of `vn100-proto`, tested against published
//! vectors and recordings, so that decoder and emulator cannot share an error. [`replay`] replaces the stream by a
//! recording; [`source`] is either a recording or simulated noise. [`terminal`] is the shell around either. [`faults`]
//! describes faults, and [`line`] and [`uart`] apply them; [`outbox`] tracks the fate of each frame.

pub mod faults;
pub mod instant;
pub mod line;
mod options;
pub mod outbox;
pub mod registers;
pub mod replay;
pub mod sensor;
pub mod source;
pub mod terminal;
pub mod uart;

pub use instant::Values;
pub use options::SensorOptions;
pub use sensor::VirtualSensor;

#[cfg(test)]
mod tests;
