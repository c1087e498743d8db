//! Diagnosis: compares a capture with a simulator, as a job.
//!
//! Unlike the other kinds it holds all samples at once. Its checkpoint has the result for each channel that is done, and
//! what the turns of the search on the present channel decided so far: a process that continues comes to the same result,
//! bit for bit. After each channel it checks whether it is still wanted.

use super::diagnosis_parameters::{DiagnosisParameters, ReferenceMotion, Simulator, read_reference};
use super::pass::{Keeper, join, split};
use super::plan::Plan;
use super::{Gridded, JobError, add_cost, fitted, gridded};
use crate::store::{JobCheckpoint, JobRow, Reader, SOFTWARE};
use imu_core::sample::Channel;
use imu_diagnosis::{Diagnosis, Drawings, Known, Options, Reference, Workers};
use imu_model::motion::{Course, Kind, Site};
use imu_model::simulator::SensorModel;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The maximum number of grid places, missing samples included, times (channels + [`BESIDES`]), about 35 bytes each:
/// five hours of nine channels at 40 Hz.
const ROOM: u64 = 14_000_000;
/// The additional memory for the work on one channel, in channels.
const BESIDES: u64 = 10;
/// The factor by which the room is smaller if the sensor moved.
const OF_A_MOTION: u64 = 4;
/// Returns the motion of the sensor during a recording.
fn reference_of(reader: &Reader, given: &ReferenceMotion, gridded: &Gridded) -> Result<Known, JobError> {
    let none = JobError::InsufficientData;
    let text = match given {
        ReferenceMotion::Stored { sha256, axis, .. } => {
            return read_reference(&reader.reference(sha256)?, "reference", *axis).map_err(none);
        }
        ReferenceMotion::Named(name) => name,
    };
    let kind = Kind::from_name(text).ok_or_else(|| none(format!("there is no motion `{text}`")))?;
    // A named motion is as long as the simulation, and begins with it.
    if gridded.left_out > 0 || gridded.full || gridded.from_s > 0.0 {
        return Err(none(format!(
            "the motion `{text}` is that of a whole capture, and only a part of this one can be compared; give the motion's CSV"
        )));
    }
    let recording = &gridded.recording;
    let course = Course::new(kind, recording.length_s(), Site::default()).map_err(|error| none(error.to_string()))?;
    let time_s = |index: usize| index as f64 / recording.rate_hz;
    let rows = (0..recording.len()).map(|index| (time_s(index), course.at(time_s(index))));
    Reference::new(rows).map(Known::Motion).map_err(|error| none(error.to_string()))
}

/// The result of a diagnosis: parts of one JSON text, unchanged.
#[derive(Debug, Deserialize)]
pub struct DiagnosisDocument<'a> {
    /// The report, `vn100d-diagnosis-1`.
    #[serde(borrow)]
    pub report: &'a RawValue,
    /// The corrected model, `vn100d-sensor-model-1`.
    #[serde(borrow)]
    pub model: &'a RawValue,
}

impl<'a> DiagnosisDocument<'a> {
    /// Splits a result's text.
    ///
    /// # Errors
    /// [`JobError::Json`] if the text is no such result.
    pub fn read(body: &'a str) -> Result<Self, JobError> {
        Ok(serde_json::from_str(body)?)
    }
}

/// Reads the report of a result and the data of its pictures.
///
/// # Errors
/// [`JobError::Json`] if the text is no such result.
pub fn read_diagnosis(body: &str) -> Result<(Diagnosis, Drawings), JobError> {
    let report = DiagnosisDocument::read(body)?.report;
    Ok((serde_json::from_str(report.get())?, serde_json::from_str(body)?))
}

/// A [`DiagnosisDocument`] to be written.
#[derive(Serialize)]
struct Written<'a> {
    report: &'a Diagnosis,
    model: &'a SensorModel,
    #[serde(flatten)]
    drawings: Drawings,
}

/// Maximum size of the results that a checkpoint holds, bytes. A result that does not fit is found again after an
/// interruption.
const KEPT_MAX: usize = 4 << 20;
/// Version of the checkpoint. One of another version is not used.
const VERSION: u8 = 6;

/// The progress of the work.
struct Progress<'a> {
    keeper: &'a mut dyn Keeper,
    /// The reason why the job is no longer wanted.
    ended: Option<JobError>,
    /// Number of times that work was given out.
    given_out: u32,
    share: f64,
    /// The results of the work by [`Self::key`].
    kept: BTreeMap<u64, Vec<u8>>,
}

impl<'a> Progress<'a> {
    /// Begins, or continues from a checkpoint's state. `None` if it is damaged.
    fn new(keeper: &'a mut dyn Keeper, state: Option<Vec<u8>>) -> Option<Self> {
        let mut kept = BTreeMap::new();
        if let Some((_, mut rest)) = state.as_deref().and_then(|of| of.split_first()).filter(|of| *of.0 == VERSION) {
            for entry in split(&mut rest)? {
                let (key, result) = entry.split_first_chunk()?;
                kept.insert(u64::from_le_bytes(*key), result.to_vec());
            }
        }
        Some(Self { keeper, ended: None, given_out: 0, share: 0.0, kept })
    }

    /// Identifies a part of the work on a number among all work of the job. The keys of a number's parts follow one
    /// another.
    fn key(&self, number: usize, part: usize) -> u64 {
        debug_assert!(number < 1 << 16 && part < 1 << 16, "{number} {part}");
        (u64::from(self.given_out) << 32) | ((number as u64) << 16) | part as u64
    }

    /// Stores the progress; returns `false` if the job is no longer wanted.
    fn note(&mut self, share: f64) -> bool {
        // Channels may be searched again.
        self.share = self.share.max(share);
        if self.ended.is_none() {
            self.ended = self.keeper.progress(self.share).err();
        }
        self.ended.is_none()
    }

    /// Stores a checkpoint with one more result. That of part 0, the whole work on a number, replaces all parts.
    fn keep(&mut self, number: usize, part: usize, result: Vec<u8>) {
        let parts = self.key(number, 0)..self.key(number + 1, 0);
        let stays = |key: &u64| part != 0 || !parts.contains(key);
        let size: usize = self.kept.iter().filter(|(key, _)| stays(key)).map(|(_, result)| result.len()).sum();
        if self.ended.is_some() || size + result.len() > KEPT_MAX {
            return;
        }
        self.kept.retain(|key, _| stays(key));
        self.kept.insert(self.key(number, part), result);
        let entry = |(key, result): (&u64, &Vec<u8>)| [&key.to_le_bytes(), result.as_slice()].concat();
        let entries: Vec<Vec<u8>> = self.kept.iter().map(entry).collect();
        let state = [vec![VERSION], join(&entries)].concat();
        self.ended = self.keeper.checkpoint(JobCheckpoint { next_seq: 0, state }, self.share).err();
    }
}

/// Works on one channel after the other, as long as the job is wanted: two at a time would take more memory.
struct OneByOne<'a, 'b> {
    progress: &'a Mutex<Progress<'b>>,
    from: f64,
    to: f64,
}

impl<'b> OneByOne<'_, 'b> {
    fn progress(&self) -> MutexGuard<'_, Progress<'b>> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Workers for OneByOne<'_, '_> {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        self.progress().given_out += 1;
        let share = |index: usize| self.from + (self.to - self.from) * index as f64 / count as f64;
        for index in (0..count).take_while(|index| self.progress().note(share(*index))) {
            work(index);
        }
    }

    fn kept(&self, number: usize, part: usize) -> Option<Vec<u8>> {
        let progress = self.progress();
        progress.kept.get(&progress.key(number, part)).cloned()
    }

    fn keep(&self, number: usize, part: usize, result: Vec<u8>) {
        self.progress().keep(number, part, result);
    }
}

/// Works on a diagnosis to its end; returns the text of its result.
pub(super) fn work(
    reader: &Reader,
    job: &JobRow,
    parameters: DiagnosisParameters,
    keeper: &mut dyn Keeper,
) -> Result<String, JobError> {
    let state = reader.checkpoint(job.id)?.map(|checkpoint| checkpoint.state);
    let progress = Mutex::new(Progress::new(keeper, state).ok_or(JobError::Checkpoint(job.id))?);
    let document = document_of(reader, job, parameters, &progress);
    // Unfinished work leads to some other error, or to a meaningless result.
    match progress.into_inner().unwrap_or_else(PoisonError::into_inner).ended {
        Some(error) => Err(error),
        None => document,
    }
}

/// Returns the result's text.
fn document_of(
    reader: &Reader,
    job: &JobRow,
    parameters: DiagnosisParameters,
    progress: &Mutex<Progress<'_>>,
) -> Result<String, JobError> {
    let plan = Plan::read(reader, job.capture, job.end_seq, &Channel::ANALYSED)?;
    // Another rate is refused before any work.
    let same_rate = |sim_hz| imu_diagnosis::same_rate(plan.rate_hz, sim_hz);
    let ((sim, doubt), begun) = match parameters.sim {
        Simulator::Model(sim) => {
            same_rate(sim.rate_hz)?;
            ((*sim, None), 0.0)
        }
        Simulator::Capture(id) => {
            let capture = reader.capture(id)?;
            let plan = Plan::read(reader, id, capture.samples, &Channel::ANALYSED)?;
            same_rate(plan.rate_hz)?;
            let (workers, room) = (OneByOne { progress, from: 0.05, to: 0.5 }, room(&plan));
            let fitted = fitted(reader, plan, &imu_diagnosis::effects(), &capture.name, room, &workers)?;
            (fitted.as_law()?, 0.5)
        }
    };
    // A motion is screened with a hundred columns of a triad beside its samples.
    let room = if parameters.reference.is_some() { room(&plan) / OF_A_MOTION } else { room(&plan) };
    let gridded = gridded(reader, &plan, room)?;
    let from = begun + 0.05;
    let name = reader.capture(job.capture)?.name;
    let workers = OneByOne { progress, from, to: 0.98 };
    let options = Options { software: SOFTWARE, real: &name, sim: &sim.name, workers: &workers, ..Options::default() };
    let reference = parameters.reference.as_ref().map(|given| reference_of(reader, given, &gridded)).transpose()?;
    let mut outcome = imu_diagnosis::diagnose_any(&gridded.recording, reference.as_ref(), &sim, &options)?;
    gridded.adjust(&mut outcome.diagnosis);
    outcome.diagnosis.notes.extend(doubt);
    if reference.is_none() {
        add_cost(&mut outcome, &gridded.recording, &sim);
    }
    let Gridded { recording, from_s, .. } = gridded;
    let drawings = Drawings::new(&recording, from_s, &sim, &outcome);
    let written = Written { report: &outcome.diagnosis, model: &outcome.augmented, drawings };
    Ok(serde_json::to_string(&written)?)
}

/// Returns the number of places for which there is room with a plan's channels.
fn room(plan: &Plan) -> u64 {
    ROOM / (plan.channels.len() as u64 + BESIDES)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts the checkpoints.
    struct Count(usize);

    impl Keeper for Count {
        fn checkpoint(&mut self, _checkpoint: JobCheckpoint, _progress: f64) -> Result<(), JobError> {
            self.0 += 1;
            Ok(())
        }

        fn progress(&mut self, _progress: f64) -> Result<(), JobError> {
            Ok(())
        }
    }

    #[test]
    fn a_result_that_does_not_fit_replaces_nothing_and_makes_no_checkpoint() {
        let mut count = Count(0);
        let mut progress = Progress::new(&mut count, None).unwrap();
        let kept = |progress: &Progress<'_>| progress.kept.values().map(Vec::len).collect::<Vec<_>>();
        progress.keep(0, 1, vec![0; 100]);
        progress.keep(0, 2, vec![0; KEPT_MAX - 200]);
        progress.keep(1, 1, vec![0; 90]);
        progress.keep(1, 2, vec![0; 11]);
        progress.keep(0, 0, vec![0; KEPT_MAX]);
        assert_eq!(kept(&progress), [100, KEPT_MAX - 200, 90]);
        // Its own parts make room for the whole.
        progress.keep(0, 0, vec![0; KEPT_MAX - 90]);
        assert_eq!(kept(&progress), [KEPT_MAX - 90, 90]);
        assert_eq!(count.0, 4);
    }
}
