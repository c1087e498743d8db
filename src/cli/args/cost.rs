//! Arguments of `cost`.

use clap::Args;
use imu_core::units::parse_duration;
use imu_cost::{CostError, Tolerance};
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
    /// Temperature in °C, or a file with its course from the alignment's begin on: time_s, temperature_c
    #[arg(long, value_name = "FILE|°C", allow_hyphen_values = true)]
    pub temperature: Option<String>,
    /// Limit on a 95 % band, such as heading=1deg/10min,position=1m/10s; may be repeated
    #[arg(long, value_name = "NAME=LIMIT/DURATION", value_parser = tolerances)]
    pub tolerance: Vec<Tolerances>,
    /// End with exit code 4 if a limit is missed
    #[arg(long, requires = "tolerance")]
    pub check: bool,
}

/// Limits of one option.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerances(pub Vec<Tolerance>);

fn tolerances(text: &str) -> Result<Tolerances, CostError> {
    Tolerance::parse(text).map(Tolerances)
}
