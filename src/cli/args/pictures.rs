//! Arguments of commands that draw a capture: `plot`, `report`.

use super::complete;
use super::{PartArgs, SamplingArgs, ValidationArgs, rate};
use crate::gallery::Picture;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `plot`.
#[derive(Debug, Args)]
pub struct PlotArgs {
    /// Id, name, `latest`, or the path of a recording
    #[arg(add = complete::captures_and_files())]
    pub capture: String,
    /// timeseries-<channel>, histogram-<channel>, allan-<triad>, allan-<channel>, hourly-<channel>, psd-<triad> or gaps, such as
    /// allan-gyro
    #[arg(value_name = "NAME", value_parser = picture, add = complete::plots())]
    pub picture: Picture,
    /// The file, with the ending .svg or .png; `-` is SVG on standard output
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// The part that is drawn
    #[command(flatten)]
    pub part: PartArgs,
    /// Rate of a recording in Hz: for one without stamps, or to override its stamps
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// The sampling of the sensor
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
}

/// Arguments of `report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Id, name, `latest`, or the path of a recording; several for --validation
    #[arg(required = true, value_name = "CAPTURE|FILE", add = complete::captures_and_files())]
    pub captures: Vec<String>,
    /// The file, with the ending .html; `-` is standard output
    #[arg(long, value_name = "FILE.html")]
    pub out: PathBuf,
    /// Rate of a recording in Hz: for one without stamps, or to override its stamps
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// The part of each recording
    #[command(flatten)]
    pub part: PartArgs,
    /// The sampling of the sensor
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// A validation sheet in place of a report
    #[command(flatten)]
    pub validation: ValidationArgs,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
}

fn picture(text: &str) -> Result<Picture, String> {
    Picture::from_name(text).ok_or_else(|| format!("there is no such plot: there are {}", Picture::forms()))
}
