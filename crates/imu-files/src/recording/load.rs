//! Whole columns of a recording, for commands that analyse a file directly, without a database.

use super::account::RecordingAccountant;
use super::error::RecordingError;
use super::info::RecordingInfo;
use super::{Options, Recording};
use imu_core::sample::{Channel, Gap, Record};
use std::ops::Range;
use std::path::Path;

/// One channel's values.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedColumn {
    /// The channel.
    pub channel: Channel,
    /// One value per sample of the recording, in the channel's unit; NaN if the channel is absent.
    pub values: Vec<f64>,
}

/// A recording in memory: 8 bytes per sample and channel, and per stamp.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedRecording {
    /// The facts about the recording.
    pub info: RecordingInfo,
    /// The recording's channels in column order, all of the same length.
    pub columns: Vec<LoadedColumn>,
    /// The samples' stamps since the first one, ns; empty if the recording has none.
    pub stamps_ns: Vec<u64>,
    /// Stretches of samples without a gap.
    pub segments: Vec<Range<usize>>,
    /// The gaps between the segments.
    pub gaps: Vec<Gap>,
    /// Number of samples.
    pub samples: u64,
    /// Number of missing samples.
    pub missing: u64,
}

impl LoadedRecording {
    /// Returns the sample time from the first to one period after the last sample, s: (samples + missing)/rate.
    pub fn duration_s(&self) -> f64 {
        (self.samples + self.missing) as f64 / self.info.rate_hz
    }
    /// Returns the column of a channel.
    pub fn column(&self, channel: Channel) -> Option<&LoadedColumn> {
        self.columns.iter().find(|column| column.channel == channel)
    }
}

/// Reads a whole recording.
///
/// # Errors
/// The errors of [`Recording::open`].
pub fn load_columns(file: &Path, options: Options) -> Result<LoadedRecording, RecordingError> {
    columns(&Recording::open(file, options)?)
}

/// Reads all samples of an opened recording.
///
/// # Errors
/// The errors of [`Recording::items`].
pub fn columns(recording: &Recording) -> Result<LoadedRecording, RecordingError> {
    let info = recording.info().clone();
    let capacity = usize::try_from(info.samples).unwrap_or(0);
    let mut columns: Vec<LoadedColumn> =
        info.channels.iter().map(|channel| LoadedColumn { channel, values: Vec::with_capacity(capacity) }).collect();
    let mut stamps_ns = Vec::new();
    let (mut segments, mut gaps) = (Vec::<Range<usize>>::new(), Vec::new());
    let mut accountant = RecordingAccountant::new(&info);
    let mut records = Vec::new();
    let mut count = 0;
    let mut begins = true;
    for item in recording.items()? {
        accountant.take(item?, &mut records);
        for record in records.drain(..) {
            match record {
                Record::Gap(gap) => gaps.push(gap),
                Record::Segment(_) => begins = true,
                Record::Sample { sample, .. } => {
                    match segments.last_mut() {
                        Some(last) if !begins => last.end = count + 1,
                        _ => segments.push(count..count + 1),
                    }
                    stamps_ns.extend(sample.device_time_ns);
                    for column in &mut columns {
                        column.values.push(sample.get(column.channel).unwrap_or(f64::NAN));
                    }
                    count += 1;
                    begins = false;
                }
                _ => {}
            }
        }
    }
    if stamps_ns.len() != count {
        stamps_ns.clear();
    }
    Ok(LoadedRecording {
        columns,
        stamps_ns,
        segments,
        gaps,
        samples: accountant.received(),
        missing: accountant.missing(),
        info,
    })
}
