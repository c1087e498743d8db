//! Recordings of inertial sensors in files: [`recording`] reads what others wrote, [`export`] writes what others read.
//!
//! # Example
//! ```
//! use imu_files::recording::{ColumnMap, Input, Item, Options, Recording};
//!
//! let csv = "t,gx\n0.00,0.01\n0.01,0.02\n0.03,0.01\n0.04,0.03\n";
//! let columns = ColumnMap::parse(&["t=time_s,gx=gyro_x_deg_s"])?;
//! let recording = Recording::read(Input::memory("desk.csv", csv.as_bytes()).with_columns(columns), Options::default())?;
//! assert_eq!(recording.info().rate_hz, 100.0);
//! let mut lost = 0;
//! for item in recording.items()? {
//!     if let Item::Sample(_, Some(before)) = item? {
//!         lost += before;
//!     }
//! }
//! assert_eq!(lost, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod export;
pub mod recording;
