//! Units, samples and records of an inertial sensor: the types that every other crate here speaks.
//!
//! Nothing here reads a file or a clock.

pub mod ros_messages;
pub mod sample;
pub mod units;
