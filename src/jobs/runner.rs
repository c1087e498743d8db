//! The runner: one job from where it stands to its end, chunk by chunk.
//!
//! After every chunk the computation's state and the next `seq` are committed together; whoever goes on from there, in
//! this process or the next, comes to the same result, bit for bit. A job that is stopped is queued again, a cancelled
//! one ends at the next chunk.

use super::fold::Fold;
use super::report::{self, Extent};
use super::{JobError, JobKind};
use crate::store::{JobCheckpoint, JobRow, Reader, Store, StoreError};
use std::time::{Duration, Instant};

/// Samples of one chunk.
pub const CHUNK: usize = 65_536;
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
    let parameters = kind.parameters(&job.params)?;
    let (mut fold, mut next_seq) = Fold::begin(reader, job, kind, &parameters)?;
    loop {
        while next_seq < job.end_seq {
            let begun = Instant::now();
            crate::observe::provoke::provoke(crate::observe::provoke::Point::Job);
            let limit = chunk_samples.min(usize::try_from(job.end_seq - next_seq).unwrap_or(usize::MAX));
            let chunk = reader.read_chunk(job.capture, next_seq, limit, fold.pass_channels())?;
            if chunk.is_empty() {
                return Err(StoreError::NoSuchCapture { asked: job.capture.to_string() }.into());
            }
            fold.take(&chunk);
            next_seq = chunk.next_seq();
            let checkpoint = JobCheckpoint { next_seq, state: fold.save() };
            if !store.checkpoint_job(job.id, checkpoint, fold.progress(next_seq, job.end_seq))? {
                return Ok(Outcome::Cancelled);
            }
            if !keep_on() {
                store.release_job(job.id)?;
                return Ok(Outcome::Stopped);
            }
            rest(begun.elapsed() / REST);
        }
        if !fold.end_pass() {
            break;
        }
        next_seq = 0;
    }
    let body = document(reader, job, kind, fold)?;
    Ok(store.finish_job(job.id, body)?.map_or(Outcome::Cancelled, Outcome::Done))
}

fn rest(time: Duration) {
    std::thread::sleep(time.min(Duration::from_millis(100)));
}

fn document(reader: &Reader, job: &JobRow, kind: JobKind, fold: Fold) -> Result<String, JobError> {
    let extent = Extent::read(reader, job.capture, job.end_seq)?;
    Ok(match fold {
        Fold::Sums(summation) => {
            let (plan, sums) = summation.finish();
            if kind == JobKind::Noise {
                serde_json::to_string(&report::noise(&plan, &sums, extent))?
            } else {
                serde_json::to_string(&report::allan(&plan, &sums, &extent))?
            }
        }
        Fold::Distribution(distribution) => {
            serde_json::to_string(&report::statistics(distribution.statistics(), extent))?
        }
    })
}
