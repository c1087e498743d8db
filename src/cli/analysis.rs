//! The input of an analysis: captures in the database, or recordings' files directly.

use super::source::{Source, has_rejected, note_assumed_rate};
use super::{Context, usage};
use crate::clock::rfc3339;
use crate::jobs::{Extent, JobError, Plan, SampleSource, SamplingError, Setting, one_sensor};
use crate::store::{CaptureRow, Chunk, Missing, Reader, StoreError};
use imu_core::sample::{Channel, FilterWindows, StatedSampling, Triad};
use imu_core::units::NANOS_PER_SECOND;
use imu_files::recording::{KeepOn, Kind, LoadedRecording, Recording, Stamps, columns};
use std::collections::BTreeMap;
use std::path::Path;

/// The facts about a capture or recording besides its samples.
struct Material {
    name: String,
    /// Whether no source states the rate.
    rate_assumed: bool,
    /// A sentence if a given rate overrides that of the stamps.
    overridden: Option<String>,
    /// Whether frames or lines were rejected on the way in.
    rejected: bool,
    /// Filter windows of register 85, if they are known.
    windows: Option<FilterWindows>,
    /// The setting that captures analysed together must share.
    setting: Setting,
    /// The capture's id in the database.
    id: Option<i64>,
    /// When it began, RFC 3339, if that is known.
    began: Option<String>,
}

/// One capture or several of one sensor, to be analysed as one.
pub(super) struct Together {
    /// The selected samples.
    pub plan: Plan,
    /// The source of the samples.
    pub source: Shelf,
    captures: Vec<Material>,
}

impl Together {
    /// Returns the name, or the names.
    pub(super) fn name(&self) -> String {
        self.captures.iter().map(|of| of.name.as_str()).collect::<Vec<_>>().join(" + ")
    }

    /// Returns the filter windows: of register 85 if a capture has it, else as stated.
    pub(super) fn windows(&self) -> Option<FilterWindows> {
        self.captures
            .iter()
            .find_map(|of| of.windows)
            .or_else(|| Some(FilterWindows::stated(self.plan.sampling.get(&Triad::Gyro)?.window)))
    }

    /// Applies the user's statement about how the samples were made.
    ///
    /// # Errors
    /// If the statement contradicts the samples' rate or register 85.
    pub(super) fn sampled(&mut self, stated: Option<StatedSampling>) -> anyhow::Result<()> {
        stated.map_or(Ok(()), |stated| self.plan.sampled(stated)).map_err(contradicted)
    }

    /// Returns the first capture's id; none for a recording.
    pub(super) fn id(&self) -> Option<i64> {
        self.captures.first().and_then(|of| of.id)
    }

    /// Returns the sensor (its serial number, with its model if that is known) and the date of the first capture, each if it is known.
    pub(super) fn unit_and_date(&self) -> [Option<String>; 2] {
        let Some(of) = self.captures.first() else { return [None, None] };
        let unit = of.setting.serial_number.as_ref().map(|serial| match &of.setting.model {
            Some(model) => format!("{model} {serial}"),
            None => serial.clone(),
        });
        [unit, of.began.as_deref().and_then(|began| began.get(..10)).map(str::to_owned)]
    }

    /// Returns whether a channel has this unit.
    pub(super) fn has_unit(&self, unit: &str) -> bool {
        self.captures.iter().any(|of| of.setting.units.values().any(|own| own == unit))
    }

    /// Returns whether frames or lines of a capture were rejected on the way in.
    pub(super) fn rejected(&self) -> bool {
        self.captures.iter().any(|of| of.rejected)
    }
}

/// The captures' databases, which differ if they are parts, and the recordings in memory. Recordings have ids below 0, which no
/// capture has.
#[derive(Default)]
pub(super) struct Shelf {
    readers: BTreeMap<i64, Reader>,
    recordings: Vec<Loaded>,
}

/// A recording in memory.
struct Loaded {
    name: String,
    recording: LoadedRecording,
    missing: Missing,
}

impl Loaded {
    fn new(name: &str, mut recording: LoadedRecording) -> Self {
        recording.columns.retain(|of| Channel::ANALYSED.contains(&of.channel) || of.channel == Channel::Temperature);
        // It is not known whose stamps a table has; stamps before raw lines and in bags are the host's.
        if recording.info.kind != Kind::Csv {
            recording.stamps_ns = Vec::new();
        }
        let missing = Missing::of(recording.gaps.iter().map(|gap| (gap.before_seq, gap.missing)));
        Self { name: name.to_owned(), recording, missing }
    }

    fn chunk(&self, from_seq: u64, limit: usize, channels: &[Channel]) -> Chunk {
        let segments = &self.recording.segments;
        let end = segments.last().map_or(0, |last| last.end);
        let from = usize::try_from(from_seq).unwrap_or(end).min(end);
        let rows = from..from.saturating_add(limit).min(end);
        let column = |channel: &Channel| {
            let values = self.recording.column(*channel).and_then(|column| column.values.get(rows.clone()));
            values.map_or_else(|| vec![f64::NAN; rows.len()], <[f64]>::to_vec)
        };
        // Segments are numbered from 1, as in the plan.
        let mut segment = Vec::with_capacity(rows.len());
        let first = segments.partition_point(|range| range.end <= rows.start);
        for (number, range) in (1..).zip(segments).skip(first) {
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
    /// Adds a recording and returns its id.
    fn add(&mut self, recording: Loaded) -> i64 {
        self.recordings.push(recording);
        -(self.recordings.len() as i64)
    }

    fn recording(&self, id: i64) -> Option<&Loaded> {
        let index = usize::try_from(id.checked_neg()?).ok()?.checked_sub(1)?;
        self.recordings.get(index)
    }

    fn reader(&self, id: i64) -> Result<&Reader, StoreError> {
        self.readers.get(&id).ok_or_else(|| StoreError::NoSuchCapture(id.to_string()))
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
        let stamps_ns = recording.recording.stamps_ns.iter().skip(from).take(limit);
        Ok(stamps_ns.map(|ns| Some((1, *ns as f64 / NANOS_PER_SECOND as f64))).collect())
    }

    fn first_stamp_s(&self, capture_id: i64) -> Result<Option<f64>, StoreError> {
        match self.recording(capture_id) {
            Some(of) => {
                Ok((!of.recording.stamps_ns.is_empty()).then_some(1e-9 * of.recording.info.first_stamp_ns as f64))
            }
            None => self.reader(capture_id)?.first_stamp_s(capture_id),
        }
    }

    fn extent(&self, capture_id: i64, end_seq: u64) -> Result<Extent, StoreError> {
        let Some(Loaded { name, recording, .. }) = self.recording(capture_id) else {
            return self.reader(capture_id)?.extent(capture_id, end_seq);
        };
        Ok(Extent {
            capture: name.clone(),
            duration_s: recording.duration_s(),
            samples: recording.samples,
            missing: recording.missing,
            complete: true,
            captures: Vec::new(),
        })
    }
}

/// Opens the named inputs, each a file if one of that name exists, else a capture. Several are accepted only if they
/// have one sensor at one setting. Assumptions are printed on standard error.
pub(super) fn open(context: &Context, named: &[String], rate_hz: Option<f64>) -> anyhow::Result<Together> {
    let mut source = Shelf::default();
    let (mut captures, mut whole): (Vec<Material>, Option<Plan>) = (Vec::new(), None);
    for name in named {
        let (material, plan) = match Source::open(context, name, rate_hz, KeepOn::default())? {
            Source::Recording(recording) => of_recording(&mut source, name, &recording)?,
            Source::Capture(reader, row) => of_capture(&mut source, *reader, *row)?,
        };
        let same = |other: &Material| match (other.id, material.id) {
            (None, None) => same_file(&other.name, &material.name),
            (one, two) => one == two,
        };
        if captures.iter().any(same) {
            let reason = format!("`{name}` is given twice");
            return Err(JobError::Together(reason).into());
        }
        if material.rate_assumed {
            note_assumed_rate(name, material.setting.rate_hz);
        }
        if let Some(overridden) = &material.overridden {
            eprintln!("note: {name}: {overridden}");
        }
        captures.push(material);
        // Checked before their samples are joined.
        one_sensor(&captures.iter().map(|of| of.setting.clone()).collect::<Vec<_>>())?;
        whole = Some(match whole {
            None => plan,
            Some(whole) => whole.followed_by(plan)?,
        });
    }
    let plan = whole.ok_or_else(|| JobError::Together("no capture is given".to_owned()))?;
    Ok(Together { plan, source, captures })
}

/// Returns an error of usage for an impossible sampling.
pub(super) fn contradicted(error: SamplingError) -> anyhow::Error {
    usage(error.to_string())
}

pub(super) fn same_file(one: &str, two: &str) -> bool {
    let place = |name: &str| Path::new(name).canonicalize().ok();
    one == two || place(one).is_some_and(|place_of_one| place(two) == Some(place_of_one))
}

fn of_recording(source: &mut Shelf, named: &str, recording: &Recording) -> anyhow::Result<(Material, Plan)> {
    let loaded = columns(recording)?;
    let info = &loaded.info;
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
        rejected: has_rejected(info),
        began: (info.stamps == Stamps::Unix).then(|| rfc3339(info.started_utc_ns)),
    };
    let channels: Vec<Channel> = info.channels.iter().collect();
    let (rate_hz, segments) = (info.rate_hz, loaded.segments.clone());
    let id = source.add(Loaded::new(named, loaded));
    Ok((material, Plan::of_recording(id, named, rate_hz, &channels, &segments)?))
}

fn of_capture(source: &mut Shelf, reader: Reader, row: CaptureRow) -> anyhow::Result<(Material, Plan)> {
    // As in the background jobs: the rate of most samples; two rates are never mixed.
    let plan = Plan::read(&reader, row.id, row.samples, &Channel::ANALYSED)?;
    source.readers.insert(row.id, reader);
    let material = Material {
        windows: row.configuration.filter_windows(),
        setting: Setting::of(&row, plan.rate_hz),
        id: Some(row.id),
        overridden: None,
        rejected: row.has_rejected(),
        began: row.started_at.map(|at| at.to_string()),
        name: row.name,
        rate_assumed: row.rate_assumed,
    };
    Ok((material, plan))
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_files::recording::{Input, Options};

    #[test]
    fn a_loaded_recording_gives_the_segments_of_any_range() {
        let rows: String = (0..9).map(|row| format!("{row},{row}\n")).collect();
        let input = Input::memory("desk.csv", format!("time_s,gyro_x_rad_s\n{rows}").into_bytes());
        let mut recording = columns(&Recording::read(input, Options::default()).unwrap()).unwrap();
        recording.segments = vec![0..3, 3..4, 4..9];
        let loaded = Loaded::new("desk.csv", recording);
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
