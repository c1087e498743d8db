//! Arguments of `cost`.

use clap::Args;
use imu_core::units::parse_duration;
use imu_cost::{CostError, Tolerance};
use std::io::Read as _;
use std::path::PathBuf;
use std::time::Duration;

/// Arguments of `cost`.
#[derive(Debug, Args)]
pub struct CostArgs {
    /// The sensor model (JSON)
    #[arg(long, value_name = "FILE")]
    pub model: PathBuf,
    /// Another sensor model to compare with, such as the one before a correction
    #[arg(long, value_name = "FILE")]
    pub against: Option<PathBuf>,
    /// A capture or a recording at rest, to measure the growth of errors in and to compare it with the model's bands
    #[arg(long, value_name = "CAPTURE|FILE")]
    pub real: Option<String>,
    /// Sampling rate of that recording in Hz, if the file has no times
    #[arg(long, value_name = "HZ", requires = "real")]
    pub rate: Option<f64>,
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
enum ToleranceError {
    #[error(transparent)]
    Text(CostError),
    #[error("{file}: {error}")]
    File { file: String, error: Box<CostError> },
    #[error("{file}: neither NAME=LIMIT/DURATION nor a file that can be read: {error}")]
    Unreadable { file: String, error: std::io::Error },
}

fn tolerances(text: &str) -> Result<Tolerances, ToleranceError> {
    if text.contains('=') && !std::path::Path::new(text).is_file() {
        return Tolerance::parse(text).map(Tolerances).map_err(ToleranceError::Text);
    }
    let file = || text.to_owned();
    /// Bytes of a file that are read.
    const MOST: u64 = 1 << 20;
    let unreadable = |error| ToleranceError::Unreadable { file: file(), error };
    let is_file = std::fs::metadata(text).map_err(unreadable)?.is_file();
    if !is_file {
        return Err(unreadable(std::io::Error::other("it is no regular file")));
    }
    let mut lines = String::new();
    std::fs::File::open(text).and_then(|of| of.take(MOST).read_to_string(&mut lines)).map_err(unreadable)?;
    let read = Tolerance::parse_lines(&lines)
        .map_err(|error| ToleranceError::File { file: file(), error: Box::new(error) })?;
    Ok(Tolerances(read))
}
