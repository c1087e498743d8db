//! What is analysed: a capture in the database, or a recording's file directly.

use super::Context;
use crate::clock::{Clock as _, SystemClock};
use crate::jobs::Plan;
use crate::recording::{Options, load_columns};
use crate::sample::{Channel, ChannelSet};
use std::path::Path;

/// Samples read at a time.
const CHUNK: usize = 65_536;

/// The analysed channels of a capture or recording, in memory.
pub(super) struct Material {
    /// Its name.
    pub name: String,
    /// Sampling rate in Hz.
    pub rate_hz: f64,
    /// Whether nothing told the rate.
    pub rate_assumed: bool,
    /// Samples.
    pub samples: u64,
    /// Missing samples.
    pub missing: u64,
    /// Whether no sample will follow.
    pub complete: bool,
    /// Frames or lines were rejected on the way in.
    pub rejected: bool,
    /// Per channel its segments, each without a gap, in the channel's unit.
    pub channels: Vec<(Channel, Vec<Vec<f64>>)>,
}

impl Material {
    /// Sample time from first to last, received and missing, s.
    pub(super) fn duration_s(&self) -> f64 {
        (self.samples + self.missing) as f64 / self.rate_hz
    }

    /// Length of the longest segment of any channel, samples.
    pub(super) fn longest(&self) -> u64 {
        self.channels.iter().flat_map(|(_, segments)| segments).map(|segment| segment.len() as u64).max().unwrap_or(0)
    }

    /// Says what was assumed; on standard error, so that machine-readable output stays alone.
    pub(super) fn remark(&self) {
        if self.rate_assumed {
            eprintln!("note: {} tells no rate: {} Hz is assumed (--rate HZ tells another)", self.name, self.rate_hz);
        }
    }
}

/// Opens what the person named: a file where one of that name exists, else a capture.
pub(super) fn open(context: &Context, named: &str, rate_hz: Option<f64>) -> anyhow::Result<Material> {
    if Path::new(named).is_file() { from_file(named, rate_hz) } else { from_database(context, named) }
}

fn from_file(named: &str, rate_hz: Option<f64>) -> anyhow::Result<Material> {
    let options = Options { rate_hz, started_utc_ns: SystemClock.utc_ns() };
    let mut recording = load_columns(Path::new(named), options)?;
    let channels = std::mem::take(&mut recording.columns)
        .into_iter()
        .filter(|column| Channel::ANALYSED.contains(&column.channel))
        .map(|column| {
            let segments = column.segments.iter().map(|range| column.values[range.clone()].to_vec()).collect();
            (column.channel, segments)
        })
        .collect();
    Ok(Material {
        name: named.to_owned(),
        rate_hz: recording.info.rate_hz,
        rate_assumed: recording.info.rate_assumed,
        samples: recording.samples,
        missing: recording.missing,
        complete: true,
        rejected: recording.info.rejected.values().any(|count| *count > 0),
        channels,
    })
}

fn from_database(context: &Context, named: &str) -> anyhow::Result<Material> {
    let reader = context.reader()?;
    let id = reader.resolve(named)?;
    let row = reader.capture(id)?;
    let present: ChannelSet = row.channels.iter().copied().collect();
    let wanted: Vec<Channel> = Channel::ANALYSED.into_iter().filter(|channel| present.contains(*channel)).collect();
    let mut channels: Vec<(Channel, Vec<Vec<f64>>)> = wanted.iter().map(|channel| (*channel, Vec::new())).collect();
    // As the background jobs do: the rate that most samples have; nothing mixes two.
    let plan = Plan::read(&reader, id, row.samples, &wanted)?;
    let mut last = vec![None; wanted.len()];
    let mut from_seq = 0;
    loop {
        let chunk = reader.read_chunk(id, from_seq, CHUNK, &wanted)?;
        if chunk.is_empty() || from_seq >= plan.end_seq {
            break;
        }
        for (((_, segments), column), last) in channels.iter_mut().zip(&chunk.columns).zip(&mut last) {
            for (segment, value) in chunk.segment.iter().zip(column) {
                // An absent value ends a stretch as a gap does.
                let here = Some(*segment).filter(|number| value.is_finite() && plan.segment(*number).is_some());
                if here.is_some() {
                    if here != *last || segments.is_empty() {
                        segments.push(Vec::new());
                    }
                    if let Some(open) = segments.last_mut() {
                        open.push(*value);
                    }
                }
                *last = here;
            }
        }
        from_seq = chunk.next_seq();
    }
    Ok(Material {
        name: row.name,
        rate_hz: plan.rate_hz,
        rate_assumed: row.rate_assumed,
        samples: row.samples,
        missing: row.missing,
        complete: !row.state.is_open(),
        rejected: row.rejected.values().any(|count| *count > 0),
        channels,
    })
}
