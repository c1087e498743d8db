//! Recordings of inertial sensors in files: [`recording`] reads what others wrote, [`export`] writes what others read.

pub mod export;
pub mod recording;
