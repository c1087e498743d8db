//! What is analysed: a capture in the database, or a recording's file directly.

use super::Context;
use crate::clock::{Clock as _, SystemClock};
use crate::datasheet::FilterWindows;
use crate::jobs::{JobError, Plan, Setting, one_sensor, parts};
use crate::noise::Contribution;
use crate::noise::robust::{Levels, Part};
use crate::recording::{Options, load_columns};
use crate::sample::{Channel, ChannelSet};
use crate::store::Missing;
use std::path::Path;

/// The analysed channels of a capture or recording, in memory.
pub(super) struct Material {
    /// Its name.
    pub name: String,
    /// Whether nothing told the rate.
    pub rate_assumed: bool,
    /// Samples.
    pub samples: u64,
    /// Missing samples.
    pub missing: u64,
    /// Samples left out because most have another rate.
    pub other_rate: u64,
    /// Whether no sample will follow.
    pub complete: bool,
    /// Frames or lines were rejected on the way in.
    pub rejected: bool,
    /// Per channel its segments, each without a gap, in the channel's unit.
    pub channels: Vec<(Channel, Vec<Part>)>,
    /// The temperature's course, where it was recorded.
    pub temperature: Levels,
    /// Filter windows of register 85, where they are known.
    pub windows: Option<FilterWindows>,
    /// What has to be the same of captures that are analysed together.
    pub setting: Setting,
    /// Which capture of the database it is.
    id: Option<i64>,
}

/// One capture or several of one sensor, to be analysed as one.
pub(super) struct Together {
    /// Each by itself, never empty.
    pub captures: Vec<Material>,
    /// The channels that all of them have.
    pub channels: Vec<Channel>,
}

impl Together {
    fn first(&self) -> Option<&Material> {
        self.captures.first()
    }

    /// The name, or the names.
    pub(super) fn name(&self) -> String {
        self.captures.iter().map(|of| of.name.as_str()).collect::<Vec<_>>().join(" + ")
    }

    /// Sampling rate in Hz: that of all.
    pub(super) fn rate_hz(&self) -> f64 {
        self.first().map_or(f64::NAN, |of| of.setting.rate_hz)
    }

    /// Filter windows of register 85, where one tells them.
    pub(super) fn windows(&self) -> Option<FilterWindows> {
        self.captures.iter().find_map(|of| of.windows)
    }

    /// Samples of all.
    pub(super) fn samples(&self) -> u64 {
        self.captures.iter().map(|of| of.samples).sum()
    }

    /// Missing samples of all.
    pub(super) fn missing(&self) -> u64 {
        self.captures.iter().map(|of| of.missing).sum()
    }

    /// Samples of all that were left out because most have another rate.
    pub(super) fn other_rate(&self) -> u64 {
        self.captures.iter().map(|of| of.other_rate).sum()
    }

    /// Sample time of all, received and missing, s.
    pub(super) fn duration_s(&self) -> f64 {
        self.captures.iter().map(Material::duration_s).sum()
    }

    /// Whether no sample will follow to any.
    pub(super) fn complete(&self) -> bool {
        self.captures.iter().all(|of| of.complete)
    }

    /// Whether frames or lines of one were rejected on the way in.
    pub(super) fn rejected(&self) -> bool {
        self.captures.iter().any(|of| of.rejected)
    }

    /// Length of the longest segment of any channel, samples.
    pub(super) fn longest(&self) -> u64 {
        self.captures.iter().map(Material::longest).max().unwrap_or(0)
    }

    /// The stretches of a channel, capture by capture.
    pub(super) fn parts(&self, channel: Channel) -> impl Iterator<Item = &[Part]> {
        self.captures.iter().map(move |of| of.parts(channel))
    }

    /// Of several captures what each gives.
    pub(super) fn contributions(&self) -> Vec<Contribution> {
        if self.captures.len() < 2 {
            return Vec::new();
        }
        let of = |material: &Material| Contribution {
            capture: material.name.clone(),
            duration_s: material.duration_s(),
            samples: material.samples,
            missing: material.missing,
            ..Contribution::default()
        };
        self.captures.iter().map(of).collect()
    }
}

impl Material {
    /// The stretches of a channel.
    pub(super) fn parts(&self, channel: Channel) -> &[Part] {
        self.channels.iter().find(|(other, _)| *other == channel).map(|(_, parts)| parts.as_slice()).unwrap_or_default()
    }

    /// Sample time from first to last, received and missing, s.
    fn duration_s(&self) -> f64 {
        (self.samples + self.missing) as f64 / self.setting.rate_hz
    }

    /// Length of the longest segment of any channel, samples.
    fn longest(&self) -> u64 {
        self.channels.iter().flat_map(|(_, segments)| segments).map(|part| part.values.len() as u64).max().unwrap_or(0)
    }

    /// Says what was assumed; on standard error, so that machine-readable output stays alone.
    fn remark(&self) {
        if self.rate_assumed {
            let rate_hz = self.setting.rate_hz;
            eprintln!("note: {} tells no rate: {rate_hz} Hz is assumed (--rate HZ tells another)", self.name);
        }
    }
}

/// Opens what the person named, each a file where one of that name exists, else a capture; several only where they are of
/// one sensor at one setting. What is assumed is said on standard error.
pub(super) fn open(context: &Context, named: &[String], rate_hz: Option<f64>) -> anyhow::Result<Together> {
    let mut captures: Vec<Material> = Vec::new();
    for name in named {
        let material =
            if Path::new(name).is_file() { from_file(name, rate_hz)? } else { from_database(context, name)? };
        let same = |other: &Material| match (other.id, material.id) {
            (None, None) => same_file(&other.name, &material.name),
            (one, two) => one == two,
        };
        if captures.iter().any(same) {
            let reason = format!("`{name}` is given twice");
            return Err(JobError::Together { reason }.into());
        }
        material.remark();
        captures.push(material);
    }
    one_sensor(&captures.iter().map(|of| of.setting.clone()).collect::<Vec<_>>())?;
    let has = |of: &Material, channel: Channel| of.channels.iter().any(|(other, _)| *other == channel);
    let channels: Vec<Channel> = captures
        .first()
        .map(|first| first.channels.iter().map(|(channel, _)| *channel))
        .into_iter()
        .flatten()
        .filter(|channel| captures.iter().all(|of| has(of, *channel)))
        .collect();
    if channels.is_empty() && captures.len() > 1 {
        return Err(JobError::Together { reason: "they have no channel in common".to_owned() }.into());
    }
    Ok(Together { captures, channels })
}

fn same_file(one: &str, two: &str) -> bool {
    let place = |name: &str| Path::new(name).canonicalize().ok();
    one == two || place(one).is_some_and(|place_of_one| place(two) == Some(place_of_one))
}

fn from_file(named: &str, rate_hz: Option<f64>) -> anyhow::Result<Material> {
    let options = Options { rate_hz, started_utc_ns: SystemClock.utc_ns() };
    let mut recording = load_columns(Path::new(named), options)?;
    let rate_hz = recording.info.rate_hz;
    let missing = Missing::of(recording.gaps.iter().map(|gap| (gap.before_seq, gap.missing)));
    let start_s = |index: usize| (index as u64 + missing.up_to(index as u64)) as f64 / rate_hz;
    let mut channels: Vec<(Channel, Vec<Part>)> = std::mem::take(&mut recording.columns)
        .into_iter()
        .filter(|column| Channel::ANALYSED.contains(&column.channel) || column.channel == Channel::Temperature)
        .map(|column| {
            let part = |range: &std::ops::Range<usize>| Part {
                start_s: start_s(range.start),
                values: column.values[range.clone()].to_vec(),
            };
            (column.channel, column.segments.iter().map(part).collect())
        })
        .collect();
    let temperature = take_temperature(&mut channels, rate_hz, recording.samples);
    let units = channels.iter().map(|(channel, _)| {
        let converted = recording.info.conversions.iter().find(|conversion| conversion.channel == *channel);
        (*channel, converted.map_or(channel.unit(), |conversion| conversion.original_unit).to_owned())
    });
    Ok(Material {
        windows: None,
        setting: Setting { units: units.collect(), ..Setting::of_rate(named, rate_hz) },
        id: None,
        name: named.to_owned(),
        rate_assumed: recording.info.rate_assumed,
        samples: recording.samples,
        missing: recording.missing,
        other_rate: 0,
        complete: true,
        rejected: recording.info.rejected.values().any(|count| *count > 0),
        channels,
        temperature,
    })
}

/// Takes the temperature out of the channels.
fn take_temperature(channels: &mut Vec<(Channel, Vec<Part>)>, rate_hz: f64, samples: u64) -> Levels {
    let mut levels = Levels::new(rate_hz, samples);
    if let Some(at) = channels.iter().position(|(channel, _)| *channel == Channel::Temperature) {
        levels.push(&channels.remove(at).1, false);
    }
    levels
}

fn from_database(context: &Context, named: &str) -> anyhow::Result<Material> {
    let reader = context.reader()?;
    let id = reader.resolve(named)?;
    let row = reader.capture(id)?;
    let present: ChannelSet = row.channels.iter().copied().collect();
    let wanted: Vec<Channel> = Channel::ANALYSED
        .into_iter()
        .chain([Channel::Temperature])
        .filter(|channel| present.contains(*channel))
        .collect();
    // As the background jobs do: the rate that most samples have; nothing mixes two.
    let plan = Plan::read(&reader, id, row.samples, &wanted)?;
    let mut channels: Vec<(Channel, Vec<Part>)> = wanted.iter().copied().zip(parts(&reader, &plan, &wanted)?).collect();
    let temperature = take_temperature(&mut channels, plan.rate_hz, row.samples);
    Ok(Material {
        windows: serde_json::from_value(row.configuration["filter_window"].clone()).ok(),
        setting: Setting::of(&row, plan.rate_hz),
        id: Some(id),
        temperature,
        name: row.name,
        rate_assumed: row.rate_assumed,
        samples: row.samples,
        missing: row.missing,
        other_rate: plan.other_rate,
        complete: !row.state.is_open(),
        rejected: row.rejected.values().any(|count| *count > 0),
        channels,
    })
}
