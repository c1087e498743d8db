//! Observation: what the daemon says about itself, from memory.

pub mod status;

pub use status::{CaptureStatus, JobsStatus, SensorState, SensorStatus, Status, StorageState, StorageStatus};
