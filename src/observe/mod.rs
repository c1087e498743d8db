//! Observation: what the daemon says about itself, from memory: the status snapshot, metrics, the log.

pub mod logging;
pub mod metrics;
pub mod status;

pub use metrics::{Metrics, WriterFigures};
pub use status::{CaptureStatus, JobsStatus, SensorState, SensorStatus, Status, StorageState, StorageStatus};
