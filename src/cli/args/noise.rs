//! Arguments of `noise`.

use super::complete;
use super::{NoiseFormat, PartArgs, SamplingArgs, noise_format, rate};
use clap::{Args, ValueEnum};
use imu_core::units::parse_duration;
use imu_cost::Over;
use imu_noise::datasheet::{Datasheet, DatasheetError};
use std::path::PathBuf;
use std::time::Duration;

/// Arguments of `noise`.
#[derive(Debug, Args)]
pub struct NoiseArgs {
    /// Id, name, `latest`, or the path of a recording; several of one sensor give one result
    #[arg(required_unless_present = "model", value_name = "CAPTURE", add = complete::captures_and_files())]
    pub captures: Vec<String>,
    /// Rate of recordings without stamps in Hz
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// The part of each capture
    #[command(flatten)]
    pub part: PartArgs,
    /// Form of the output
    #[arg(long, value_parser = noise_format(), default_value = "table")]
    pub format: NoiseFormat,
    /// The sampling of the sensor
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Write parameters even if they contradict the record, with a comment; replace the file of --junit
    #[arg(long)]
    pub force: bool,
    /// List every spike, knock and line, not only their numbers
    #[arg(long)]
    pub verbose: bool,
    /// End with exit code 4 unless N, B and K are within the limits of this file, such as `[gyro]` with `B_deg_h = 8`
    /// (docs/ci.md)
    #[arg(long, value_name = "LIMITS.toml", conflicts_with = "consistent")]
    pub within: Option<PathBuf>,
    /// What a limit that the record can neither confirm nor refute is: missed, or only reported
    #[arg(long, value_enum, value_name = "missed|reported", default_value = "missed", requires = "within")]
    pub undecided: Undecided,
    /// Write the limits and what was found as a JUnit report, which systems of continuous integration read
    #[arg(long, value_name = "OUT.xml", requires = "within")]
    pub junit: Option<PathBuf>,
    /// Compare with this datasheet: vn-100, or a file that ends with .toml
    #[arg(long, value_name = "NAME|FILE.toml", value_parser = SheetChoice::parse, conflicts_with = "consistent")]
    pub datasheet: Option<SheetChoice>,
    /// Print or write N and K with which a filter's covariance is that of the real errors (docs/filters.md); --format takes the
    /// closest pair (fit), or with `--consistent=cover` the one that covers the errors at every horizon
    #[arg(
        long,
        value_enum,
        value_name = "fit|cover",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "fit"
    )]
    pub consistent: Option<ConsistentPair>,
    /// Take the noise of this sensor model (JSON) in place of a capture's
    #[arg(
        long,
        value_name = "FILE",
        requires = "consistent",
        conflicts_with_all = ["captures", "rate", "filter_window", "from", "to", "channels"],
        add = complete::models()
    )]
    pub model: Option<PathBuf>,
    /// Times over which the filter integrates without aid, FROM..TO (default: 0.1s..100s)
    #[arg(long, value_name = "RANGE", value_parser = Over::parse, requires = "consistent", allow_hyphen_values = true)]
    pub over: Option<Over>,
    /// Time at rest before, from which the filter knows the bias
    #[arg(
        long,
        value_name = "DURATION",
        value_parser = parse_duration,
        requires = "consistent",
        default_value = "30s",
        allow_hyphen_values = true
    )]
    pub align: Duration,
    /// The record over which drifts, bursts and changes are averaged (default: the capture's or the model's, else 1h)
    #[arg(long, value_name = "DURATION", value_parser = parse_duration, requires = "consistent", allow_hyphen_values = true)]
    pub record: Option<Duration>,
    /// Temperature in °C, or a file with its course over the record: time_s, temperature_c
    #[arg(long, value_name = "FILE|°C", requires = "consistent", allow_hyphen_values = true)]
    pub temperature: Option<String>,
}

/// What a limit is that the record can neither confirm nor refute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Undecided {
    /// Such a limit is missed
    Missed,
    /// Such a limit is reported and does not change the exit code
    Reported,
}

/// One of the two pairs of filter parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ConsistentPair {
    /// The pair whose predicted covariance is closest to the real one
    Fit,
    /// The closest pair whose predicted variance is at least the real one at every horizon
    Cover,
}

/// A datasheet by its name, or its file.
#[derive(Debug, Clone)]
#[expect(missing_docs, reason = "the names say it")]
pub enum SheetChoice {
    Named(Box<Datasheet>),
    File(PathBuf),
}

impl SheetChoice {
    fn parse(text: &str) -> Result<Self, DatasheetError> {
        if text.ends_with(".toml") {
            return Ok(Self::File(text.into()));
        }
        Ok(Self::Named(Box::new(Datasheet::named(text)?)))
    }
}
