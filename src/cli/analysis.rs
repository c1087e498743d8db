//! What is analysed: captures in the database, or recordings' files directly.

use super::{CliError, Context, Failure};
use crate::clock::{Clock as _, SystemClock};
use crate::jobs::{Extent, JobError, Plan, SampleSource, SamplingError, Setting, StatedSampling, one_sensor};
use crate::store::{Chunk, Missing, Reader, StoreError};
use imu_core::sample::{Channel, Triad};
use imu_core::units::NANOS_PER_SECOND;
use imu_files::recording::{Kind, LoadedRecording, Options, load_columns};
use imu_noise::datasheet::FilterWindows;
use std::ops::Range;
use std::path::Path;

/// What is known of a capture or recording besides its samples.
struct Material {
    name: String,
    /// Whether nothing told the rate.
    rate_assumed: bool,
    /// That a given rate overrides that of the stamps.
    overridden: Option<String>,
    /// Frames or lines were rejected on the way in.
    rejected: bool,
    /// Filter windows of register 85, where they are known.
    windows: Option<FilterWindows>,
    /// What has to be the same of captures that are analysed together.
    setting: Setting,
    /// Which capture of the database it is.
    id: Option<i64>,
}

/// One capture or several of one sensor, to be analysed as one.
pub(super) struct Together {
    /// Which samples.
    pub plan: Plan,
    /// Where they are.
    pub source: Shelf,
    captures: Vec<Material>,
}

impl Together {
    /// The name, or the names.
    pub(super) fn name(&self) -> String {
        self.captures.iter().map(|of| of.name.as_str()).collect::<Vec<_>>().join(" + ")
    }

    /// Filter windows: of register 85 if a capture has it, else as stated.
    pub(super) fn windows(&self) -> Option<FilterWindows> {
        self.captures
            .iter()
            .find_map(|of| of.windows)
            .or_else(|| Some(FilterWindows::stated(self.plan.sampling.get(&Triad::Gyro)?.window)))
    }

    /// Takes in what a person says of how the samples came about.
    ///
    /// # Errors
    /// If that contradicts the samples' rate or register 85.
    pub(super) fn sampled(&mut self, told: Option<StatedSampling>) -> anyhow::Result<()> {
        told.map_or(Ok(()), |told| self.plan.sampled(told)).map_err(contradicted)
    }

    /// Whether frames or lines of one were rejected on the way in.
    pub(super) fn rejected(&self) -> bool {
        self.captures.iter().any(|of| of.rejected)
    }
}

/// The database, where a capture of it is named, and the recordings in memory. These have ids below 0: there is no such capture.
#[derive(Default)]
pub(super) struct Shelf {
    reader: Option<Reader>,
    recordings: Vec<Loaded>,
}

/// Samples of a recording.
struct Loaded {
    name: String,
    rate_hz: f64,
    /// Stretches of samples without a gap.
    segments: Vec<Range<usize>>,
    missing: Missing,
    missing_total: u64,
    /// NaN where a sample has no value.
    columns: Vec<(Channel, Vec<f64>)>,
    /// The samples' stamps, s; empty where there are none or they are the host's.
    stamps_s: Vec<f64>,
}

impl Loaded {
    fn new(name: &str, mut recording: LoadedRecording) -> Self {
        // Whose stamps a table has nobody knows; those before raw lines and in bags are the host's.
        let of_table = recording.info.kind == Kind::Csv;
        let stamps_ns = std::mem::take(&mut recording.stamps_ns);
        let stamps = stamps_ns.into_iter().filter(|_| of_table).map(|ns| ns as f64 / NANOS_PER_SECOND as f64).collect();
        let columns = std::mem::take(&mut recording.columns).into_iter();
        let wanted = columns.filter(|of| Channel::ANALYSED.contains(&of.channel) || of.channel == Channel::Temperature);
        let marked = wanted.map(|mut column| {
            let mut absent_from = 0;
            for segment in column.segments.iter().chain([&(column.values.len()..column.values.len())]) {
                if let Some(absent) = column.values.get_mut(absent_from..segment.start) {
                    absent.fill(f64::NAN);
                }
                absent_from = segment.end;
            }
            (column.channel, column.values)
        });
        Self {
            name: name.to_owned(),
            rate_hz: recording.info.rate_hz,
            columns: marked.collect(),
            stamps_s: stamps,
            missing: Missing::of(recording.gaps.iter().map(|gap| (gap.before_seq, gap.missing))),
            missing_total: recording.missing,
            segments: recording.segments,
        }
    }

    fn samples(&self) -> u64 {
        self.segments.last().map_or(0, |last| last.end as u64)
    }

    fn chunk(&self, from_seq: u64, limit: usize, channels: &[Channel]) -> Chunk {
        let end = self.segments.last().map_or(0, |last| last.end);
        let from = usize::try_from(from_seq).unwrap_or(end).min(end);
        let rows = from..from.saturating_add(limit).min(end);
        let column = |channel: &Channel| {
            let found = self.columns.iter().find(|(other, _)| other == channel);
            let values = found.and_then(|(_, values)| values.get(rows.clone()));
            values.map_or_else(|| vec![f64::NAN; rows.len()], <[f64]>::to_vec)
        };
        // Segments are numbered from 1, as the plan has them.
        let mut segment = Vec::with_capacity(rows.len());
        let first = self.segments.partition_point(|range| range.end <= rows.start);
        for (number, range) in (1..).zip(&self.segments).skip(first) {
            let until = range.end.min(rows.end);
            segment.resize(until.saturating_sub(rows.start), number);
            if until == rows.end {
                break;
            }
        }
        Chunk {
            first_seq: from as u64,
            segment,
            channels: channels.to_vec(),
            columns: channels.iter().map(column).collect(),
            times: None,
        }
    }
}

impl Shelf {
    /// Takes a recording in and gives its id.
    fn add(&mut self, recording: Loaded) -> i64 {
        self.recordings.push(recording);
        -(self.recordings.len() as i64)
    }

    fn recording(&self, id: i64) -> Option<&Loaded> {
        let index = usize::try_from(id.checked_neg()?).ok()?.checked_sub(1)?;
        self.recordings.get(index)
    }

    fn reader(&self, id: i64) -> Result<&Reader, StoreError> {
        self.reader.as_ref().ok_or_else(|| StoreError::NoSuchCapture { asked: id.to_string() })
    }
}

impl SampleSource for Shelf {
    fn read_chunk(
        &self,
        capture_id: i64,
        from_seq: u64,
        limit: usize,
        channels: &[Channel],
    ) -> Result<Chunk, StoreError> {
        match self.recording(capture_id) {
            Some(recording) => Ok(recording.chunk(from_seq, limit, channels)),
            None => self.reader(capture_id)?.read_chunk(capture_id, from_seq, limit, channels),
        }
    }

    fn missing(&self, capture_id: i64) -> Result<Missing, StoreError> {
        match self.recording(capture_id) {
            Some(recording) => Ok(recording.missing.clone()),
            None => self.reader(capture_id)?.missing(capture_id),
        }
    }

    fn stamps(&self, capture_id: i64, from_seq: u64, limit: usize) -> Result<Vec<Option<(u32, f64)>>, StoreError> {
        let Some(recording) = self.recording(capture_id) else {
            return self.reader(capture_id)?.stamps(capture_id, from_seq, limit);
        };
        let from = usize::try_from(from_seq).unwrap_or(usize::MAX);
        Ok(recording.stamps_s.iter().skip(from).take(limit).map(|time_s| Some((1, *time_s))).collect())
    }

    fn extent(&self, capture_id: i64, end_seq: u64) -> Result<Extent, StoreError> {
        let Some(recording) = self.recording(capture_id) else {
            return self.reader(capture_id)?.extent(capture_id, end_seq);
        };
        Ok(Extent {
            capture: recording.name.clone(),
            duration_s: (recording.samples() + recording.missing_total) as f64 / recording.rate_hz,
            samples: recording.samples(),
            missing: recording.missing_total,
            complete: true,
            captures: Vec::new(),
        })
    }
}

/// Opens what the person named, each a file where one of that name exists, else a capture; several only where they are of
/// one sensor at one setting. What is assumed is said on standard error.
pub(super) fn open(context: &Context, named: &[String], rate_hz: Option<f64>) -> anyhow::Result<Together> {
    let mut source = Shelf::default();
    let (mut captures, mut whole): (Vec<Material>, Option<Plan>) = (Vec::new(), None);
    for name in named {
        let (material, plan) = if Path::new(name).is_file() {
            from_file(&mut source, name, rate_hz)?
        } else {
            from_database(context, &mut source, name)?
        };
        let same = |other: &Material| match (other.id, material.id) {
            (None, None) => same_file(&other.name, &material.name),
            (one, two) => one == two,
        };
        if captures.iter().any(same) {
            let reason = format!("`{name}` is given twice");
            return Err(JobError::Together { reason }.into());
        }
        if material.rate_assumed {
            // On standard error, so that machine-readable output stays alone.
            let rate_hz = material.setting.rate_hz;
            eprintln!("note: {name} tells no rate: {rate_hz} Hz is assumed (--rate HZ tells another)");
        }
        if let Some(overridden) = &material.overridden {
            eprintln!("note: {name}: {overridden}");
        }
        captures.push(material);
        // Before their samples are put side by side.
        one_sensor(&captures.iter().map(|of| of.setting.clone()).collect::<Vec<_>>())?;
        whole = Some(match whole {
            None => plan,
            Some(whole) => whole.followed_by(plan)?,
        });
    }
    let plan = whole.ok_or_else(|| JobError::Together { reason: "no capture is given".to_owned() })?;
    Ok(Together { plan, source, captures })
}

/// A sampling that cannot be is a matter of how the command was used.
pub(super) fn contradicted(error: SamplingError) -> anyhow::Error {
    CliError { failure: Failure::Usage, message: error.to_string() }.into()
}

fn same_file(one: &str, two: &str) -> bool {
    let place = |name: &str| Path::new(name).canonicalize().ok();
    one == two || place(one).is_some_and(|place_of_one| place(two) == Some(place_of_one))
}

fn from_file(source: &mut Shelf, named: &str, rate_hz: Option<f64>) -> anyhow::Result<(Material, Plan)> {
    let options = Options { rate_hz, started_utc_ns: SystemClock.utc_ns(), ..Options::default() };
    let recording = load_columns(Path::new(named), options)?;
    let info = &recording.info;
    let units = info.channels.iter().map(|channel| {
        let converted = info.conversions.iter().find(|conversion| conversion.channel == channel);
        (channel, converted.map_or(channel.unit(), |conversion| conversion.original_unit).to_owned())
    });
    let material = Material {
        windows: None,
        setting: Setting { units: units.collect(), ..Setting::of_rate(named, info.rate_hz) },
        id: None,
        overridden: info.overridden(),
        name: named.to_owned(),
        rate_assumed: info.rate_assumed,
        rejected: info.rejected.values().any(|count| *count > 0),
    };
    let loaded = Loaded::new(named, recording);
    let channels: Vec<Channel> = loaded.columns.iter().map(|(channel, _)| *channel).collect();
    let (rate_hz, segments) = (loaded.rate_hz, loaded.segments.clone());
    let plan = Plan::of_recording(source.add(loaded), named, rate_hz, &channels, &segments)?;
    Ok((material, plan))
}

fn from_database(context: &Context, source: &mut Shelf, named: &str) -> anyhow::Result<(Material, Plan)> {
    let (reader, id) = context.capture(named)?;
    let reader = source.reader.insert(reader);
    let row = reader.capture(id)?;
    // As the background jobs do: the rate that most samples have; nothing mixes two.
    let plan = Plan::read(reader, row.id, row.samples, &Channel::ANALYSED)?;
    let material = Material {
        windows: FilterWindows::of_configuration(&row.configuration),
        setting: Setting::of(&row, plan.rate_hz),
        id: Some(row.id),
        overridden: None,
        rejected: row.has_rejected(),
        name: row.name,
        rate_assumed: row.rate_assumed,
    };
    Ok((material, plan))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loaded_recording_gives_the_segments_of_any_range() {
        let loaded = Loaded {
            name: "desk.csv".to_owned(),
            rate_hz: 40.0,
            segments: vec![0..3, 3..4, 4..9],
            missing: Missing::of([(3, 10), (4, 2)]),
            missing_total: 12,
            columns: vec![(Channel::GyroX, (0..9).map(f64::from).collect())],
            stamps_s: Vec::new(),
        };
        let numbers = [1, 1, 1, 2, 3, 3, 3, 3, 3];
        for from in 0..10 {
            for limit in 0..11 {
                let chunk = loaded.chunk(from as u64, limit, &[Channel::GyroX, Channel::Temperature]);
                let rows = from.min(9)..(from + limit).min(9);
                assert_eq!(chunk.segment, numbers[rows.clone()], "{from} {limit}");
                assert_eq!(chunk.columns[0], rows.clone().map(|row| row as f64).collect::<Vec<_>>());
                assert!(chunk.columns[1].len() == rows.len() && chunk.columns[1].iter().all(|value| value.is_nan()));
            }
        }
    }
}
