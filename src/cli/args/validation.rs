//! Arguments of `report --validation`.

use super::complete;
use super::cost::Tolerances;
use clap::Args;
use imu_core::units::parse_duration;
use std::path::PathBuf;
use std::time::Duration;

/// What is validated, and how.
#[derive(Debug, Clone, Default, Args)]
pub struct ValidationArgs {
    /// Write the validation sheet of a sensor model: the error of its predictions in these recordings at rest, with its uncertainty
    #[arg(long, requires = "model")]
    pub validation: bool,
    /// The sensor model (JSON)
    #[arg(long, value_name = "FILE", requires = "validation", add = complete::models())]
    pub model: Option<PathBuf>,
    /// Times of unaided integration, increasing, separated by commas
    #[arg(
        long,
        value_name = "DURATIONS",
        value_delimiter = ',',
        value_parser = parse_duration,
        default_value = "1s,10s,1min,10min,1h",
        allow_hyphen_values = true,
        requires = "validation"
    )]
    pub horizons: Vec<Duration>,
    /// Time at rest before, over which the bias is taken as a mean
    #[arg(long, value_name = "DURATION", value_parser = parse_duration, default_value = "30s", allow_hyphen_values = true, requires = "validation")]
    pub align: Duration,
    /// Time from switch-on to the begin of each recording
    #[arg(long, value_name = "DURATION", value_parser = parse_duration, default_value = "0s", allow_hyphen_values = true, requires = "validation")]
    pub after: Duration,
    /// Largest error of the predicted root mean square, such as heading=0.1deg/10min, or a file with a limit per line; may be repeated
    #[arg(long, value_name = "NAME=LIMIT/DURATION|FILE", value_parser = super::cost::tolerances, requires = "validation")]
    pub tolerance: Vec<Tolerances>,
    /// End with exit code 4 if the model is not shown to be valid
    #[arg(long, requires = "validation")]
    pub check: bool,
}
