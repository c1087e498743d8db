//! The computations of a job over samples, with a common interface.

use super::curves::{Curves, check};
use super::distribution::Distribution;
use super::motion::{AtRest, at_rest};
use super::plan::Plan;
use super::spectra::Spectra;
use super::sums::Summation;
use super::{AnalysisRequest, JobError, SampleSource, together};
use crate::store::{Chunk, JobRow, Reader, StoreError};
use imu_core::sample::Channel;
use imu_noise::allan::Estimator;

/// Returns the job's computation at its last checkpoint, and the next `seq` that it needs.
pub(super) fn begin(
    reader: &Reader,
    job: &JobRow,
    request: &AnalysisRequest,
    go_on: impl FnMut() -> Result<(), JobError>,
) -> Result<(Box<dyn Pass>, u64), JobError> {
    let parameters = request.parameters();
    let checkpoint = reader.checkpoint(job.id)?;
    let next_seq = checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.next_seq);
    let state = checkpoint.as_ref().map(|checkpoint| checkpoint.state.as_slice());
    let damaged = || JobError::Checkpoint(job.id);
    let plan = || together::plan_of(reader, job.capture, job.end_seq, parameters);
    let pass: Box<dyn Pass> = match request {
        AnalysisRequest::Allan(_) => {
            let plan = plan()?;
            check(parameters, &plan)?;
            let AtRest { plan, .. } = at_rest(reader, plan, false, go_on)?;
            let next_seq = next_seq.min(plan.end_seq);
            match (state, parameters.estimator) {
                (None, Estimator::Oadev) => Box::new(Summation::new(plan, parameters)?),
                (None, _) => Box::new(Curves::new(plan, parameters)?),
                (Some(state), Estimator::Oadev) => {
                    let begun = Summation::new(plan, parameters)?;
                    Box::new(begun.restored(state, next_seq, reader)?.ok_or_else(damaged)?)
                }
                (Some(state), _) => {
                    let begun = Curves::new(plan, parameters)?;
                    Box::new(begun.restored(state, next_seq, reader)?.ok_or_else(damaged)?)
                }
            }
        }
        AnalysisRequest::Noise(_) => {
            let at_rest = at_rest(reader, plan()?, state.is_none(), go_on)?;
            let next_seq = next_seq.min(at_rest.plan.end_seq);
            Box::new(match state {
                Some(state) => Spectra::new(at_rest.plan).restored(state, next_seq, reader)?.ok_or_else(damaged)?,
                None => Spectra::of(at_rest),
            })
        }
        AnalysisRequest::Statistics(_) => {
            let capture = reader.capture(job.capture)?;
            let mut channels = parameters.channels.clone().unwrap_or(capture.channels.clone());
            channels.retain(|channel| capture.channels.contains(channel));
            if job.end_seq == 0 || channels.is_empty() {
                let reason = format!("capture {} has no samples of these channels yet", job.capture);
                return Err(JobError::InsufficientData(reason));
            }
            Box::new(match state {
                Some(state) => Distribution::restore(channels, state).ok_or_else(damaged)?,
                None => Distribution::new(channels),
            })
        }
    };
    let end_seq = pass.plan().map_or(job.end_seq, |plan| plan.end_seq);
    Ok((pass, next_seq.min(end_seq)))
}

/// Returns the next samples of this pass, at most `limit`.
pub(super) fn read_chunk(
    pass: &dyn Pass,
    source: &dyn SampleSource,
    job: &JobRow,
    next_seq: u64,
    limit: usize,
) -> Result<Chunk, StoreError> {
    if let Some(chunk) = pass.held_chunk(next_seq, limit) {
        return Ok(chunk);
    }
    let chunk = match pass.plan() {
        Some(plan) => plan.read_chunk(source, next_seq, limit, pass.read_channels())?,
        None => source.read_chunk(job.capture, next_seq, limit, pass.read_channels())?,
    };
    if chunk.is_empty() {
        return Err(StoreError::NoSuchCapture(job.capture.to_string()));
    }
    Ok(chunk)
}

/// A computation that receives samples, in one pass over them or several.
pub(super) trait Pass {
    /// Returns the plan of the samples that this computation takes in; `None` if it takes in all samples of the
    /// capture.
    fn plan(&self) -> Option<&Plan>;

    /// Returns the channels to be read in this pass.
    fn read_channels(&self) -> &[Channel];

    /// Returns the next samples of this pass if they are held; otherwise they must be read.
    fn held_chunk(&self, _from: u64, _limit: usize) -> Option<Chunk> {
        None
    }

    /// Takes in the next samples of this pass.
    fn take(&mut self, chunk: &Chunk);

    /// Does a part of the computation after a pass has all its samples; returns `false` if nothing is left.
    fn work(&mut self) -> bool {
        false
    }

    /// Ends a pass over the samples; returns whether another one is needed.
    fn end_pass(&mut self) -> bool {
        false
    }

    /// Returns the overall progress when this pass has reached `next_seq` of `end_seq`, 0–1.
    fn progress(&self, next_seq: u64, end_seq: u64) -> f64;

    /// Returns the state for a checkpoint: everything that continuing needs besides the samples.
    fn save(&mut self) -> Result<Vec<u8>, JobError>;

    /// Returns the result's text, once the last pass has ended; `go_on` receives the progress of the remaining work, and
    /// the state from which it continues.
    fn document(self: Box<Self>, reader: &Reader, job: &JobRow, go_on: &mut GoOn<'_>) -> Result<String, JobError>;
}

/// Receives the progress, 0–1, and a new state for a checkpoint, if there is one; an error ends the work.
pub(super) type GoOn<'a> = dyn FnMut(f64, Option<Vec<u8>>) -> Result<(), JobError> + 'a;

/// Joins byte strings, each preceded by its length.
pub(super) fn join(entries: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = (entries.len() as u32).to_le_bytes().to_vec();
    for entry in entries {
        bytes.extend((entry.len() as u32).to_le_bytes());
        bytes.extend(entry);
    }
    bytes
}

/// Splits off what [`join`] has written; `None` if it is damaged.
pub(super) fn split(rest: &mut &[u8]) -> Option<Vec<Vec<u8>>> {
    let number = |rest: &mut &[u8]| -> Option<usize> {
        let (bytes, tail) = rest.split_first_chunk::<4>()?;
        *rest = tail;
        usize::try_from(u32::from_le_bytes(*bytes)).ok()
    };
    let count = number(rest)?;
    let mut entries = Vec::new();
    for _ in 0..count {
        let length = number(rest)?;
        let (entry, tail) = rest.split_at_checked(length)?;
        entries.push(entry.to_vec());
        *rest = tail;
    }
    Some(entries)
}
