//! The computations of a job over samples: begins the one that a request needs, and reads its samples.

use super::curves::{Curves, check};
use super::distribution::Distribution;
use super::motion::{AtRest, at_rest};
use super::pass::Pass;
use super::spectra::Spectra;
use super::sums::Summation;
use super::{AnalysisRequest, JobError, SampleSource, together};
use crate::store::{Chunk, JobRow, Reader, StoreError};
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
