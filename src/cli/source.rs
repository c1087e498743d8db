//! Source: the input of a command, a capture of the database or a recording's file.

use super::Context;
use crate::clock::{Clock as _, SystemClock};
use crate::store::{CaptureRow, Reader};
use imu_files::recording::{Input, KeepOn, Options, Recording, RecordingInfo};
use std::path::Path;

/// The input of a command.
pub(super) enum Source {
    /// A capture: its database and its row.
    Capture(Box<Reader>, Box<CaptureRow>),
    /// A recording's file.
    Recording(Box<Recording>),
}

impl Source {
    /// Opens the file of this name if there is one, and reads it while `keep_on` allows it; else the capture.
    ///
    /// # Errors
    /// If neither can be read.
    pub(super) fn open(context: &Context, named: &str, rate_hz: Option<f64>, keep_on: KeepOn) -> anyhow::Result<Self> {
        if let Some(file) = file(named) {
            let options = Options { rate_hz, started_utc_ns: SystemClock.utc_ns(), ..Options::default() };
            return Ok(Self::Recording(Box::new(Recording::read(Input::file(file).while_wanted(keep_on), options)?)));
        }
        let (reader, row) = context.capture(named)?;
        Ok(Self::Capture(Box::new(reader), Box::new(row)))
    }
}

/// Returns the path if it leads to a file, which no output may replace.
pub(super) fn file(named: &str) -> Option<&Path> {
    Some(Path::new(named)).filter(|path| path.is_file())
}

/// Returns whether lines or frames of a recording were rejected.
pub(super) fn has_rejected(info: &RecordingInfo) -> bool {
    info.rejected.values().any(|count| *count > 0)
}

/// Reports on standard error that no source states the rate, so that machine-readable output stays clean.
pub(super) fn note_assumed_rate(named: &str, rate_hz: f64) {
    eprintln!("note: {named} tells no rate: {rate_hz} Hz is assumed (--rate HZ tells another)");
}

/// Reports on standard error that no source states the time.
pub(super) fn note_assumed_time(named: &str) {
    eprintln!("note: {named} tells no time of day: its first sample counts as taken now");
}
