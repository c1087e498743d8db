//! Emulator: a VN-100 that can be talked to, on a pseudo-terminal.
//!
//! [`sensor`] is the sensor itself, pure: bytes and ticks in, bytes out. [`registers`] is what it remembers, [`instant`]
//! turns channel values into whatever its messages carry. The encoder is the protocol room's, tested against published
//! vectors and recordings, so that decoder and emulator cannot share an error. [`replay`] is a recording in the
//! stream's place, [`source`] is either it or simulated noise; [`terminal`] is the shell around either. What goes wrong is said by [`faults`] and done by [`line`] and
//! [`uart`]; [`outbox`] knows what became of each frame.

pub mod faults;
pub mod instant;
pub mod line;
pub mod outbox;
pub mod registers;
pub mod replay;
pub mod sensor;
pub mod source;
pub mod terminal;
pub mod uart;

pub use instant::Values;
pub use sensor::{Notice, SensorOptions, VirtualSensor};

#[cfg(test)]
mod tests;
