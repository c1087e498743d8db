//! The runner: one job from where it stands to its end, chunk by chunk.
//!
//! After every chunk the computation's state and the next `seq` are committed together; whoever goes on from there, in
//! this process or the next, comes to the same result, bit for bit. A job that is stopped is queued again, a cancelled
//! one ends at the next chunk.

use super::fold::Fold;
use super::report::{self, Extent};
use super::{JobError, JobKind};
use crate::store::{JobCheckpoint, JobRow, Reader, Store};
use std::time::{Duration, Instant};

/// Samples of one chunk.
pub const CHUNK: usize = 65_536;
/// How far a job over a long capture is when its fold is done and disturbances are still to be looked for.
pub(super) const FOLDED: f64 = 0.4;
/// The same where these are looked for in one go.
pub(super) const FOLDED_SHORT: f64 = 0.9;
/// The share of its time that a job leaves to others after each chunk.
const REST: u32 = 10;

/// How a run of a job ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    /// Its result has this id.
    Done(i64),
    /// Somebody cancelled it or deleted the capture.
    Cancelled,
    /// It was told to stop and waits for the next start.
    Stopped,
}

/// Works on a claimed job until it is done, cancelled, or `keep_on` answers false; asked after every chunk.
pub(super) fn run(
    store: &Store,
    reader: &Reader,
    job: &JobRow,
    chunk_samples: usize,
    mut keep_on: impl FnMut() -> bool,
) -> Result<Outcome, JobError> {
    let kind = JobKind::from_name(&job.kind)?;
    if kind == JobKind::Diagnosis {
        return super::diagnosis::run(store, reader, job, keep_on);
    }
    let parameters = kind.parameters(&job.params)?;
    let mut begun = Instant::now();
    let begin = Fold::begin(reader, job, kind, &parameters, || {
        rest(begun.elapsed() / REST);
        begun = Instant::now();
        if keep_on() { Ok(()) } else { Err(JobError::Stopped) }
    });
    let (mut fold, mut next_seq) = match begin {
        Err(JobError::Stopped) => {
            store.release_job(job.id)?;
            return Ok(Outcome::Stopped);
        }
        begin => begin?,
    };
    let end_seq = fold.end_seq(job);
    loop {
        while next_seq < end_seq {
            let begun = Instant::now();
            crate::observe::provoke::provoke(crate::observe::provoke::Point::Job);
            let limit = chunk_samples.min(usize::try_from(end_seq - next_seq).unwrap_or(usize::MAX));
            let chunk = fold.read_chunk(reader, job, next_seq, limit)?;
            fold.pass_mut().take(&chunk);
            next_seq = chunk.next_seq();
            if let Some(outcome) = keep(store, job, &mut fold, next_seq, end_seq, &mut keep_on)? {
                return Ok(outcome);
            }
            rest(begun.elapsed() / REST);
        }
        while fold.pass_mut().work() {
            if let Some(outcome) = keep(store, job, &mut fold, next_seq, end_seq, &mut keep_on)? {
                return Ok(outcome);
            }
        }
        if !fold.pass_mut().end_pass() {
            break;
        }
        next_seq = 0;
    }
    let mut checkpoint = reader.checkpoint(job.id)?;
    let go_on = |done: f64| {
        // The same state again: it tells how far the job is, and whether it is still wanted.
        if let Some(same) = checkpoint.take() {
            checkpoint = Some(same.clone());
            if !store.checkpoint_job(job.id, same, FOLDED + (1.0 - FOLDED) * done)? {
                return Err(JobError::CalledOff);
            }
        }
        if keep_on() { Ok(()) } else { Err(JobError::Stopped) }
    };
    let body = match document(reader, job, fold, go_on) {
        Err(JobError::CalledOff) => return Ok(Outcome::Cancelled),
        Err(JobError::Stopped) => {
            store.release_job(job.id)?;
            return Ok(Outcome::Stopped);
        }
        body => body?,
    };
    Ok(store.finish_job(job.id, body)?.map_or(Outcome::Cancelled, Outcome::Done))
}

/// Keeps where the job is; answers how it ends where it is not to go on.
fn keep(
    store: &Store,
    job: &JobRow,
    fold: &mut Fold,
    next_seq: u64,
    end_seq: u64,
    keep_on: &mut impl FnMut() -> bool,
) -> Result<Option<Outcome>, JobError> {
    let checkpoint = JobCheckpoint { next_seq, state: fold.save()? };
    if !store.checkpoint_job(job.id, checkpoint, fold.progress(next_seq, end_seq))? {
        return Ok(Some(Outcome::Cancelled));
    }
    if !keep_on() {
        store.release_job(job.id)?;
        return Ok(Some(Outcome::Stopped));
    }
    Ok(None)
}

fn rest(time: Duration) {
    std::thread::sleep(time.min(Duration::from_millis(100)));
}

fn document(
    reader: &Reader,
    job: &JobRow,
    fold: Fold,
    go_on: impl FnMut(f64) -> Result<(), JobError>,
) -> Result<String, JobError> {
    Ok(match fold {
        Fold::Sums(summation) => {
            let (plan, sums) = summation.finish();
            let extent = Extent::of_plan(reader, &plan)?;
            serde_json::to_string(&report::allan(&plan, &sums, &extent))?
        }
        Fold::Curves(curves) => {
            let (plan, estimator, curves) = curves.finish();
            let extent = Extent::of_plan(reader, &plan)?;
            serde_json::to_string(&report::curves(&plan, estimator, curves, &extent))?
        }
        Fold::Spectra(spectra) => {
            let (plan, sums, held) = spectra.finish();
            serde_json::to_string(&report::noise(reader, &plan, &sums, held, go_on)?)?
        }
        Fold::Distribution(distribution) => {
            let extent = Extent::read(reader, job.capture, job.end_seq)?;
            serde_json::to_string(&report::statistics(distribution.statistics(), extent))?
        }
    })
}
