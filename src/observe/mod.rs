//! Observation: the daemon's status snapshot, metrics and log, from memory.

pub mod logging;
pub mod metrics;
pub mod notify;
pub mod provoke;
pub mod recent;
pub mod status;

pub use metrics::{Metrics, WriterFigures};
pub use notify::{NotifyEvent, NotifyStatus};
pub use recent::{Recent, SharedRecent, Trace};
pub use status::{
    CaptureStatus, ClockDistrust, JobsStatus, PlannedDeletion, RetentionStatus, ScheduleStatus, SensorState,
    SensorStatus, ShareStatus, Status, StorageState, StorageStatus, Tally,
};
