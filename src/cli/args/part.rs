//! The part of a recording that a command reads: one set of options for every command that reads one.

use super::complete;
use super::{Command, ModelCommand};
use crate::gallery::Picture;
use crate::store::Moment;
use clap::Args;
use imu_core::sample::Channel;

/// The part of each recording or capture that is read.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct PartArgs {
    /// From this time on: RFC 3339, or seconds since the first sample
    #[arg(long, value_name = "T", value_parser = moment)]
    pub from: Option<Moment>,
    /// Before this time: RFC 3339, or seconds since the first sample
    #[arg(long, value_name = "T", value_parser = moment)]
    pub to: Option<Moment>,
    /// Only these, separated by commas, such as gyro_x,gyro_y (default: all that the capture has)
    #[arg(long, value_name = "NAMES", value_parser = channel_list, add = complete::channels())]
    pub channels: Option<ChannelList>,
}

/// Channels by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChannelList(pub Vec<Channel>);

fn channel_list(text: &str) -> Result<ChannelList, String> {
    Channel::list(text).map(ChannelList).map_err(|error| error.to_string())
}

fn moment(text: &str) -> Result<Moment, String> {
    Moment::parse(text)
        .ok_or_else(|| "expected RFC 3339 such as 2026-11-21T20:00:00Z, or seconds since the first sample".to_owned())
}

impl Command {
    /// Returns the part that the command reads of each recording; `export`, and `plot` of a time series, cut it
    /// themselves. With the option that names the recording, if that is not given.
    pub fn part(&self) -> (PartArgs, Option<&'static str>) {
        let part = match self {
            Self::Import(args) => &args.part,
            Self::Show { part, .. } => part,
            Self::Allan(args) => &args.part,
            Self::Noise(args) => &args.part,
            Self::Report(args) => &args.part,
            Self::Diagnose(args) => &args.part,
            Self::Calibrate(args) => &args.part,
            Self::Model(args) => match &args.command {
                ModelCommand::Fit { part, .. } => part,
                _ => return (PartArgs::default(), None),
            },
            Self::Cost(args) => return (args.part.clone(), args.real.is_none().then_some("--real")),
            Self::Trial(args) => return (args.part.clone(), args.on.is_none().then_some("--on")),
            Self::Plot(args) if !matches!(args.picture, Picture::Timeseries(_)) => &args.part,
            _ => return (PartArgs::default(), None),
        };
        (part.clone(), None)
    }
}
