//! Diagnosis: a capture against a simulator, as a job.
//!
//! Unlike the other kinds it holds all samples at once and has nothing to go on from: where the program ends it begins anew.
//! It works on a thread of its own, so that a stop of the program waits for no channel; its worker looks now and then whether
//! it is still wanted.

use super::plan::Plan;
use super::runner::Outcome;
use super::{Gridded, JobError, JobKind, fitted, gridded};
use crate::diagnosis::{self, Diagnosis, Drawings, Options, Reference, Workers};
use crate::motion::file::Rows;
use crate::motion::{Course, Kind, Site};
use crate::sample::Channel;
use crate::simulator::SensorModel;
use crate::store::{JobRow, JobState, Reader, SOFTWARE, Store, StoreError};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use serde_json::value::RawValue;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

/// Places of the grid, missing samples counted, times (channels + [`BESIDES`]) at most, about 35 bytes each: five hours of nine channels at 40 Hz.
const ROOM: u64 = 14_000_000;
/// What the work on one channel takes besides what stays of all, in channels.
const BESIDES: u64 = 10;
/// By how much less of a record of a motion there is room for.
const OF_A_MOTION: u64 = 4;
/// How often it is looked whether the job is still wanted.
const LOOK: Duration = Duration::from_millis(200);
/// Before the number of a model in its id: a number alone is a capture.
const MODEL: &str = "model-";

/// What a capture is compared with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
#[expect(clippy::exhaustive_enums, reason = "the contract's, once ids are looked up")]
pub enum Simulator {
    /// A capture that a simulator made, by its id.
    Capture(i64),
    /// A sensor model, as JSON.
    Model(Value),
}

/// Parameters of a diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[expect(clippy::exhaustive_structs, reason = "the contract's")]
pub struct DiagnosisParameters {
    /// What the capture is compared with. A model stands here whole, so that the job outlives it.
    pub sim: Simulator,
    /// What the sensor went through: the text of a motion's CSV, or the name of a motion that needs no file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
}

impl DiagnosisParameters {
    /// Reads what was asked for: `{"sim": …}` with a model's id, a model, or a capture's id or name.
    ///
    /// # Errors
    /// [`JobError::Parameters`] for what is no such wish, [`JobError::Model`], [`JobError::Store`] where there is no such
    /// model or capture.
    pub fn read(reader: &Reader, given: &Value) -> Result<Self, JobError> {
        let refuse = |reason: &str| JobError::Parameters { kind: JobKind::Diagnosis.name(), reason: reason.to_owned() };
        let empty = serde_json::Map::new();
        let given = if given.is_null() { &empty } else { given.as_object().ok_or_else(|| refuse("not an object"))? };
        let mut reference = None;
        for (key, value) in given {
            match key.as_str() {
                "sim" => {}
                "reference" if value.is_null() => {}
                "reference" => {
                    let text = value.as_str().ok_or_else(|| {
                        refuse("`reference` is a text: a motion's CSV, or one of still, tumble, rate-table")
                    })?;
                    // What is no motion is refused now and not by the job.
                    if Kind::from_name(text).is_none() {
                        of_csv(text).map_err(|reason| refuse(&format!("`reference`: {reason}")))?;
                    }
                    reference = Some(text.to_owned());
                }
                other => {
                    return Err(refuse(&format!("unknown field `{other}`, expected `sim` and `reference`")));
                }
            }
        }
        let capture = |id: i64| {
            if reader.capture(id)?.state.is_open() {
                return Err(refuse(&format!("capture {id} still runs: `sim` is one that has ended")));
            }
            Ok(Simulator::Capture(id))
        };
        let sim = match given.get("sim") {
            Some(Value::Object(model)) => of_model(&Value::Object(model.clone()), "sim")?,
            Some(Value::String(text)) => match text.strip_prefix(MODEL).and_then(|number| number.parse().ok()) {
                Some(number) => of_model(&serde_json::from_str(&reader.model(number)?.body)?, text)?,
                None => capture(reader.resolve(text)?)?,
            },
            Some(Value::Number(number)) => {
                let id = number.as_i64().ok_or_else(|| refuse("`sim` is a number and no capture's id"))?;
                capture(id)?
            }
            _ => return Err(refuse("`sim` is a model's id (\"model-1\"), a sensor model, or a capture's id or name")),
        };
        Ok(Self { sim, reference })
    }
}

/// A motion's CSV.
fn of_csv(text: &str) -> Result<Reference, String> {
    if !text.contains('\n') {
        return Err("expected a motion's CSV with a header line, or one of still, tumble, rate-table".to_owned());
    }
    let rows = Rows::new(text.as_bytes(), "reference", None).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    Reference::new(rows.map_err(|error| error.to_string())?).map_err(|error| error.to_string())
}

/// What the sensor went through during a recording.
fn reference_of(text: &str, gridded: &Gridded) -> Result<Reference, JobError> {
    let none = |reason: String| JobError::InsufficientData { reason };
    let Some(kind) = Kind::from_name(text) else { return of_csv(text).map_err(none) };
    // A named motion is as long as the simulation was, and begins with it.
    if gridded.left_out > 0 || gridded.full || gridded.from_s > 0.0 {
        return Err(none(format!(
            "the motion `{text}` is that of a whole capture, and only a part of this one can be compared; give the motion's CSV"
        )));
    }
    let recording = &gridded.recording;
    let course = Course::new(kind, recording.length_s(), Site::default()).map_err(|error| none(error.to_string()))?;
    let time_s = |index: usize| index as f64 / recording.rate_hz;
    let rows = (0..recording.len()).map(|index| (time_s(index), course.at(time_s(index))));
    Reference::new(rows).map_err(|error| none(error.to_string()))
}

/// The model as it is written, so that the same model is the same text however it came.
fn of_model(value: &Value, called: &str) -> Result<Simulator, JobError> {
    Ok(Simulator::Model(serde_json::to_value(SensorModel::from_value(value, called)?)?))
}

/// What a diagnosis leaves behind: parts of one JSON text, each as it is given out.
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
    /// Takes a result's text apart; what its page is drawn of stands beside these, and the page takes it out by itself.
    ///
    /// # Errors
    /// [`JobError::Json`] where it is none.
    pub fn read(body: &'a str) -> Result<Self, JobError> {
        Ok(serde_json::from_str(body)?)
    }
}

/// The same while it is written.
#[derive(Serialize)]
struct Written<'a> {
    report: &'a Diagnosis,
    model: &'a SensorModel,
    #[serde(flatten)]
    drawings: Drawings<'a>,
}

/// What the thread and its worker tell each other.
#[derive(Debug, Default)]
struct Wire {
    called_off: AtomicBool,
    /// A thousandth of the whole.
    progress: AtomicU64,
}

impl Wire {
    fn is_at(&self, progress: f64) {
        self.progress.store((1000.0 * progress) as u64, Ordering::Relaxed);
    }
}

/// Calls the thread off when nobody waits for it any more: it ends with its channel or with the program, whichever is first.
struct CallOff(Arc<Wire>);

impl Drop for CallOff {
    fn drop(&mut self) {
        self.0.called_off.store(true, Ordering::Release);
    }
}

/// Works on a channel after the other, as long as it is wanted: two at a time would take more memory.
struct OneByOne<'a> {
    wire: &'a Wire,
    from: f64,
    to: f64,
}

impl Workers for OneByOne<'_> {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        for index in 0..count {
            if self.wire.called_off.load(Ordering::Acquire) {
                return;
            }
            work(index);
            self.wire.is_at(self.from + (self.to - self.from) * (index + 1) as f64 / count as f64);
        }
    }
}

/// Works on a claimed job until it is done, cancelled, or `keep_on` answers false.
pub(super) fn run(
    store: &Store,
    reader: &Reader,
    job: &JobRow,
    mut keep_on: impl FnMut() -> bool,
) -> Result<Outcome, JobError> {
    let parameters: DiagnosisParameters = serde_json::from_value(job.params.clone())?;
    let wire = Arc::new(Wire::default());
    let (tell, told) = sync_channel(1);
    let thread = {
        let (path, job, wire): (PathBuf, _, _) = (store.path().to_owned(), job.clone(), Arc::clone(&wire));
        // Not the store: whoever has that keeps it open.
        let work = move || {
            let document = Reader::open(&path).map_err(JobError::from);
            let document = document.and_then(|reader| document_of(&reader, &job, &parameters, &wire));
            // Nobody listens where the program ends.
            let _ = tell.send(document);
        };
        std::thread::Builder::new().name("diagnosis".to_owned()).spawn(work).map_err(JobError::Thread)?
    };
    let wire = CallOff(wire);
    let (mut noted, mut wanted) = (0, true);
    let document = loop {
        match told.recv_timeout(LOOK) {
            Ok(outcome) => break Some(outcome),
            Err(RecvTimeoutError::Disconnected) => break None,
            Err(RecvTimeoutError::Timeout) => {}
        }
        if wanted {
            wanted = is_running(reader, job.id)?;
            let progress = wire.0.progress.load(Ordering::Relaxed);
            if wanted && progress > noted {
                noted = progress;
                wanted = store.note_progress(job.id, progress as f64 / 1000.0)?;
            }
            // What it has begun is waited for: two at a time would take more memory.
            wire.0.called_off.store(!wanted, Ordering::Release);
        }
        if !keep_on() {
            store.release_job(job.id)?;
            return Ok(Outcome::Stopped);
        }
    };
    if let Err(panic) = thread.join() {
        std::panic::resume_unwind(panic);
    }
    match document {
        Some(Ok(body)) if wanted => Ok(store.finish_job(job.id, body)?.map_or(Outcome::Cancelled, Outcome::Done)),
        Some(Err(error)) if wanted && !matches!(error, JobError::CalledOff) => Err(error),
        _ => Ok(Outcome::Cancelled),
    }
}

fn is_running(reader: &Reader, id: i64) -> Result<bool, StoreError> {
    match reader.job(id) {
        Ok(row) => Ok(row.state == JobState::Running),
        Err(StoreError::NoSuchJob { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// The result's text.
fn document_of(
    reader: &Reader,
    job: &JobRow,
    parameters: &DiagnosisParameters,
    wire: &Wire,
) -> Result<String, JobError> {
    let plan = Plan::read(reader, job.capture, job.end_seq, &Channel::ANALYSED)?;
    // Another rate is refused before any work.
    let same_rate = |sim_hz| diagnosis::same_rate(plan.rate_hz, sim_hz);
    let ((sim, doubt), begun) = match &parameters.sim {
        Simulator::Model(value) => {
            let sim = SensorModel::from_value(value, "sim")?;
            same_rate(sim.rate_hz)?;
            ((sim, None), 0.0)
        }
        Simulator::Capture(id) => {
            let capture = reader.capture(*id)?;
            let plan = Plan::read(reader, *id, capture.samples, &Channel::ANALYSED)?;
            same_rate(plan.rate_hz)?;
            let (workers, room) = (OneByOne { wire, from: 0.05, to: 0.5 }, room(&plan));
            let fitted = fitted(reader, plan, &diagnosis::effect_names(), &capture.name, room, &workers)?;
            (fitted.as_law()?, 0.5)
        }
    };
    // A motion is screened with a hundred columns of a triad beside its samples.
    let room = if parameters.reference.is_some() { room(&plan) / OF_A_MOTION } else { room(&plan) };
    let gridded = gridded(reader, &plan, room)?;
    let from = begun + 0.05;
    wire.is_at(from);
    let name = reader.capture(job.capture)?.name;
    let workers = OneByOne { wire, from, to: 0.98 };
    let options = Options { software: SOFTWARE, real: &name, sim: &sim.name, workers: &workers, ..Options::default() };
    let reference = parameters.reference.as_deref().map(|text| reference_of(text, &gridded)).transpose()?;
    let mut outcome = diagnosis::diagnose_any(&gridded.recording, reference.as_ref(), &sim, &options)?;
    gridded.tell(&mut outcome.diagnosis);
    outcome.diagnosis.notes.extend(doubt);
    let Gridded { recording, from_s, .. } = gridded;
    let drawings = Drawings::new(&recording, from_s, &sim, &outcome);
    let written = Written { report: &outcome.diagnosis, model: &outcome.augmented, drawings };
    Ok(serde_json::to_string(&written)?)
}

/// Places that there is room for with a plan's channels.
fn room(plan: &Plan) -> u64 {
    ROOM / (plan.channels.len() as u64 + BESIDES)
}
