//! Capture: from a serial port to [`imu_core::sample::Record`]s, unattended.
//!
//! [`session`] (with [`action`], [`script`], [`output`] and [`backoff`]) makes the decisions about the connection,
//! [`recorder`] those about the capture; both are pure. [`port`] is the serial port, and [`task`] applies the decisions
//! to it.

pub mod action;
pub mod backoff;
pub mod description;
pub mod host_watch;
pub mod output;
pub mod port;
mod rate_meter;
pub mod recorder;
pub mod recorder_state;
pub mod script;
pub mod session;
pub mod task;
