//! Motion of a sensor, as a reference for the simulator and for diagnosis. Pure.
//!
//! [`Course`] gives the motions that need no file: lying still, a tumble through six positions, a rate table's staircase in each
//! axis. [`file`] reads and writes motions as CSV (docs/formats.md). Both are angular rate and specific force in the sensor's
//! axes (x forward, y right, z down, as a VN-100 has them), with the Earth's rotation and gravity. The sensor turns about its own
//! centre, so that no other acceleration occurs.

pub mod file;
pub mod gravity;

mod attitude;
mod course;
mod temperature;

pub use course::{Course, CourseError, Kind, Site};
pub use temperature::Temperatures;
