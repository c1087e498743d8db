//! Arguments of commands that read and write recordings: `import`, `export`.

use super::complete;
use super::{PartArgs, SamplingArgs, one_of, rate};
use clap::builder::{PossibleValue, TypedValueParser};
use clap::{Args, ValueEnum};
use imu_files::export::samples::SampleFormat;
use std::path::PathBuf;

/// Arguments of `import`.
#[derive(Debug, Args)]
pub struct ImportArgs {
    /// Recordings
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Rate of a recording in Hz: for one without stamps, or to override its stamps
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// The part of each recording that becomes a capture
    #[command(flatten)]
    pub part: PartArgs,
    /// The sampling of the sensor: kept with the capture, for its jobs
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Name of the capture (default: the file's name)
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// A note about each capture, such as "on foam, 23 °C"
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Send the recordings to the daemon at this address (default: to the one that has the database, if one runs)
    #[arg(long, value_name = "ADDR")]
    pub listen: Option<String>,
}

/// Arguments of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Id, name, `latest`, or the path of a recording; several only with --partitioned
    #[arg(required_unless_present = "all", value_name = "CAPTURE", add = complete::captures_and_files())]
    pub captures: Vec<String>,
    /// Form of the file (default: by the ending of --out; csv on standard output)
    #[arg(long, value_parser = sample_format())]
    pub format: Option<SampleFormat>,
    /// The part that is written
    #[command(flatten)]
    pub part: PartArgs,
    /// Rate of a recording in Hz: for one without stamps, or to override its stamps
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// Origin of time_s in csv and ndjson
    #[arg(long, value_enum, default_value_t = TimeOrigin::First)]
    pub time: TimeOrigin,
    /// The file (default: `-`, standard output)
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write each capture as Parquet into a data set: DIR/sensor=…/date=…/capture-….parquet; existing files are
    /// replaced
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "format", "from", "to", "rate", "time"])]
    pub partitioned: Option<PathBuf>,
    /// Export all captures that have samples
    #[arg(long, requires = "partitioned", conflicts_with = "captures")]
    pub all: bool,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
}

fn sample_format() -> impl TypedValueParser<Value = SampleFormat> {
    let helps = [
        "The table that `import` reads",
        "A JSON document per line",
        "Apache Parquet, units in Arrow's field metadata",
        "MCAP with ROS 2 messages",
    ];
    let values = SampleFormat::ALL.into_iter().zip(helps);
    one_of(values.map(|(format, help)| (PossibleValue::new(format.name()).help(help), format)).collect())
}

/// The origin of times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TimeOrigin {
    /// The capture's first sample
    First,
    /// 1970-01-01T00:00:00Z
    Utc,
}
