//! Arguments of `cost`.

use super::{PartArgs, complete};
use clap::Args;
use imu_core::units::parse_duration;
use imu_cost::{CostError, Tolerance};
use imu_files::recording::{RecordingError, read_small};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Arguments of `cost`.
#[derive(Debug, Args)]
pub struct CostArgs {
    /// The sensor model (JSON)
    #[arg(long, value_name = "FILE", add = complete::models())]
    pub model: PathBuf,
    /// Another sensor model to compare with, such as the one before a correction
    #[arg(long, value_name = "FILE", add = complete::models())]
    pub against: Option<PathBuf>,
    /// A capture or a recording at rest, to measure the growth of errors in and to compare it with the model's bands
    #[arg(long, value_name = "CAPTURE|FILE", add = complete::captures_and_files())]
    pub real: Option<String>,
    /// Sampling rate of that recording in Hz, if the file has no times
    #[arg(long, value_name = "HZ", requires = "real")]
    pub rate: Option<f64>,
    /// The part of that recording
    #[command(flatten)]
    pub part: PartArgs,
    /// A motion after the alignment, as simulate reads it: a file, or still, tumble, poses, rate-table as long as the last horizon
    #[arg(long, value_name = "FILE|KIND", conflicts_with = "real")]
    pub motion: Option<String>,
    /// Times of unaided integration, increasing, separated by commas
    #[arg(
        long,
        value_name = "DURATIONS",
        value_delimiter = ',',
        value_parser = parse_duration,
        default_value = "1s,10s,1min,10min,1h",
        allow_hyphen_values = true
    )]
    pub horizons: Vec<Duration>,
    /// Time at rest before, over which the bias is taken as a mean
    #[arg(long, value_name = "DURATION", value_parser = parse_duration, default_value = "30s", allow_hyphen_values = true)]
    pub align: Duration,
    /// Time from switch-on to the begin of the alignment, or of the recording
    #[arg(long, value_name = "DURATION", value_parser = parse_duration, default_value = "0s", allow_hyphen_values = true)]
    pub after: Duration,
    /// Temperature in °C, or a file with its course from switch-on on: time_s, temperature_c
    #[arg(long, value_name = "FILE|°C", allow_hyphen_values = true)]
    pub temperature: Option<String>,
    /// Limit on a 95 % band, such as heading=1deg/10min,position=1m/10s, or a file with a limit per line; may be repeated
    #[arg(long, value_name = "NAME=LIMIT/DURATION|FILE", value_parser = tolerances)]
    pub tolerance: Vec<Tolerances>,
    /// End with exit code 4 if a limit is missed
    #[arg(long, requires = "tolerance")]
    pub check: bool,
}

/// Limits of one option.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerances(pub Vec<Tolerance>);

/// The reason why limits of the command line were refused.
#[derive(Debug, thiserror::Error)]
pub(super) enum ToleranceError {
    #[error(transparent)]
    Text(CostError),
    #[error("{file}: {error}")]
    File { file: String, error: Box<CostError> },
    #[error("neither NAME=LIMIT/DURATION nor a file that can be read: {0}")]
    Unreadable(#[from] RecordingError),
}

/// Maximum number of bytes of a file of limits.
const LIMITS_BYTES: u64 = 1 << 20;

pub(super) fn tolerances(text: &str) -> Result<Tolerances, ToleranceError> {
    if text.contains('=') && !Path::new(text).is_file() {
        return Tolerance::parse(text).map(Tolerances).map_err(ToleranceError::Text);
    }
    let lines = read_small(Path::new(text), LIMITS_BYTES)?;
    let of_file = |error| ToleranceError::File { file: text.to_owned(), error: Box::new(error) };
    Tolerance::parse_lines(&lines).map(Tolerances).map_err(of_file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_limits_is_read_whole_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("limits");
        let named = file.to_str().unwrap();
        let line = "heading=1deg/10min\n";
        std::fs::write(&file, line.repeat(3)).unwrap();
        assert_eq!(tolerances(named).unwrap().0.len(), 3);
        std::fs::write(&file, line.repeat(LIMITS_BYTES as usize / line.len() + 1)).unwrap();
        let message = tolerances(named).unwrap_err().to_string();
        assert!(message.contains(named) && message.contains("longer than 1048576 bytes"), "{message}");
        let message = tolerances(folder.path().to_str().unwrap()).unwrap_err().to_string();
        assert!(message.contains("a folder"), "{message}");
    }
}
