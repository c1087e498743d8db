//! The wanted part of a capture or a recording.

use super::args::{ChannelList, Command, PartArgs};
use super::{failed, usage};
use crate::clock::rfc3339;
use crate::store::{CaptureRow, Moment, Reader, SampleRange};
use imu_core::sample::Channel;
use imu_core::units::NANOS_PER_SECOND;
use imu_files::recording::{self, KeepOn};
use imu_model::simulator::SensorModel;
use std::path::Path;

/// The wanted part; the default is all of it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Part {
    /// From this time on.
    pub from: Option<Moment>,
    /// Before this time.
    pub to: Option<Moment>,
    /// Only these channels.
    pub channels: Option<Vec<Channel>>,
}

impl Part {
    /// Returns the part that the options name.
    pub(super) fn of(args: PartArgs) -> Self {
        let PartArgs { from, to, channels } = args;
        Self { from, to, channels: channels.map(|ChannelList(channels)| channels) }
    }

    /// Returns the part that the command line states.
    ///
    /// # Errors
    /// If there is no recording that it could be of.
    pub(super) fn stated(command: &Command) -> anyhow::Result<Self> {
        let (args, missing) = command.part();
        let part = Self::of(args);
        match missing.filter(|_| !part.is_whole()) {
            Some(option) => Err(usage(format!("--from, --to and --channels are of a recording: give {option} too"))),
            None => Ok(part),
        }
    }

    /// Returns whether it is all of a capture.
    pub(super) fn is_whole(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the part as a request's query.
    pub(super) fn query(&self) -> Vec<(&'static str, String)> {
        let second_ns = NANOS_PER_SECOND as i64;
        let moment = |of: Moment| match of {
            Moment::Utc(utc_ns) => rfc3339(utc_ns),
            Moment::Since(ns) => format!("{}.{:09}", ns / second_ns, ns % second_ns),
        };
        let names = |of: &Vec<Channel>| of.iter().map(|channel| channel.name()).collect::<Vec<_>>().join(",");
        [("from", self.from.map(moment)), ("to", self.to.map(moment)), ("channels", self.channels.as_ref().map(names))]
            .into_iter()
            .filter_map(|(key, value)| Some((key, value?)))
            .collect()
    }

    /// Returns the model without the channels that are left out of the recording.
    ///
    /// # Errors
    /// If no channel with noise is left.
    pub(super) fn of_model(&self, sensor: SensorModel, path: &Path) -> anyhow::Result<SensorModel> {
        let Some(wanted) = &self.channels else { return Ok(sensor) };
        let has = |sensor: &SensorModel| sensor.channels.keys().map(|of| of.name()).collect::<Vec<_>>().join(", ");
        let own = has(&sensor);
        let sensor = sensor.only(wanted);
        if sensor.channels.keys().all(|channel| channel.triad().is_none()) {
            let path = path.display();
            return Err(failed(format!("the model {path} has none of the wanted channels: choose from {own}")));
        }
        Ok(sensor)
    }

    /// Returns the part for a reader of recordings.
    pub(super) fn of_recording(&self) -> recording::Part {
        recording::Part {
            from: self.from.map(Into::into),
            to: self.to.map(Into::into),
            channels: self.channels.clone(),
        }
    }
}

/// Returns a part of a capture as the capture that it would be, read while `keep_on` allows it.
///
/// # Errors
/// If the capture has no such samples or channels, or the part cannot be written.
pub(super) fn of_capture(
    reader: &Reader,
    row: &CaptureRow,
    part: &Part,
    keep_on: &KeepOn,
) -> anyhow::Result<(Reader, CaptureRow)> {
    let range = SampleRange::read(reader, &row.id.to_string(), part.from, part.to)?;
    if range.samples() == 0 {
        let (name, length_s) = (&row.name, row.duration_s);
        return Err(failed(format!("capture {name} has no sample in the part that is wanted: it has {length_s:.3} s")));
    }
    let channels = Channel::chosen(part.channels.as_deref(), &range.capture.channels)?;
    Ok(range.apart(reader, &channels, &|| keep_on.is_wanted())?)
}
