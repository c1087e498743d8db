//! The runner: works on one job from its checkpoint to its end, chunk by chunk.
//!
//! After every chunk a [`Keeper`] commits the computation's state and the next `seq` together. A process that continues
//! from there comes to the same result, bit for bit. A job that is stopped is queued again; a cancelled one ends at the
//! next chunk.

use super::fold;
use super::pass::{FOLDED, Keeper, Pass};
use super::{JobError, JobRequest};
use crate::store::{JobCheckpoint, JobRow, JobState, Reader, Store, StoreError};
use std::time::{Duration, Instant};

/// The share of its time that a job leaves to others after each chunk.
const REST: u32 = 10;

/// How a run of a job ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    /// It is done; its result has this id.
    Done(i64),
    /// It was cancelled, or its capture was deleted.
    Cancelled,
    /// It was stopped and waits for the next start.
    Stopped,
}

/// Stores the progress in the database; `keep_on` is called after each step and returns `false` when the program ends.
pub(super) struct InStore<'a, K> {
    store: &'a Store,
    job: i64,
    keep_on: K,
    /// The progress stored in the database.
    noted: f64,
}

impl<'a, K: FnMut() -> bool> InStore<'a, K> {
    pub(super) fn new(store: &'a Store, job: i64, keep_on: K) -> Self {
        Self { store, job, keep_on, noted: 0.0 }
    }

    /// Checks whether the job is still wanted.
    pub(super) fn look(&mut self, reader: &Reader) -> Result<(), JobError> {
        let running = match reader.job(self.job) {
            Ok(row) => row.state == JobState::Running,
            Err(StoreError::NoSuchJob(_)) => false,
            Err(error) => return Err(error.into()),
        };
        self.after(running)
    }

    fn after(&mut self, running: bool) -> Result<(), JobError> {
        match running {
            false => Err(JobError::CalledOff),
            true if (self.keep_on)() => Ok(()),
            true => Err(JobError::Stopped),
        }
    }

    /// Stores the result, or the failure.
    pub(super) fn end(&self, body: Result<String, JobError>) -> Result<Outcome, JobError> {
        match body {
            Ok(body) => Ok(self.store.finish_job(self.job, body)?.map_or(Outcome::Cancelled, Outcome::Done)),
            Err(JobError::CalledOff) => Ok(Outcome::Cancelled),
            Err(JobError::Stopped) => {
                self.store.release_job(self.job)?;
                Ok(Outcome::Stopped)
            }
            Err(error) => Err(error),
        }
    }
}

impl<K: FnMut() -> bool + Send> Keeper for InStore<'_, K> {
    fn checkpoint(&mut self, checkpoint: JobCheckpoint, progress: f64) -> Result<(), JobError> {
        let running = self.store.checkpoint_job(self.job, checkpoint, progress)?;
        self.after(running)
    }
    fn progress(&mut self, progress: f64) -> Result<(), JobError> {
        // A thousandth is the resolution of the display.
        if progress < self.noted + 0.001 {
            return self.after(true);
        }
        self.noted = progress;
        let running = self.store.note_progress(self.job, progress)?;
        self.after(running)
    }
}

/// Works on a claimed job in this process until the job is done or cancelled, or `keep_on` returns `false`.
pub(super) fn run(
    store: &Store,
    reader: &Reader,
    job: &JobRow,
    chunk_samples: usize,
    keep_on: impl FnMut() -> bool + Send,
) -> Result<Outcome, JobError> {
    let mut keeper = InStore::new(store, job.id, keep_on);
    let body = work(reader, job, chunk_samples, &mut keeper);
    keeper.end(body)
}

/// Works on a job to its end; returns the text of its result.
pub(super) fn work(
    reader: &Reader,
    job: &JobRow,
    chunk_samples: usize,
    keeper: &mut dyn Keeper,
) -> Result<String, JobError> {
    let request = match JobRequest::of_row(job)? {
        JobRequest::Diagnosis(parameters) => return super::diagnosis::work(reader, job, parameters, keeper),
        JobRequest::Analysis(request) => request,
    };
    let mut begun = Instant::now();
    let (mut pass, mut next_seq) = fold::begin(reader, job, &request, || {
        rest(begun.elapsed() / REST);
        begun = Instant::now();
        keeper.progress(0.0)
    })?;
    let end_seq = pass.plan().map_or(job.end_seq, |plan| plan.end_seq);
    let keep = |keeper: &mut dyn Keeper, pass: &mut dyn Pass, next_seq: u64| {
        let checkpoint = JobCheckpoint { next_seq, state: pass.save()? };
        keeper.checkpoint(checkpoint, pass.progress(next_seq, end_seq))
    };
    loop {
        while next_seq < end_seq {
            let begun = Instant::now();
            crate::observe::provoke::provoke(crate::observe::provoke::Point::Job);
            let limit = chunk_samples.min(usize::try_from(end_seq - next_seq).unwrap_or(usize::MAX));
            let chunk = fold::read_chunk(&*pass, reader, job, next_seq, limit)?;
            pass.take(&chunk);
            next_seq = chunk.next_seq();
            keep(keeper, &mut *pass, next_seq)?;
            rest(begun.elapsed() / REST);
        }
        while pass.work() {
            keep(keeper, &mut *pass, next_seq)?;
        }
        if !pass.end_pass() {
            break;
        }
        next_seq = 0;
    }
    pass.document(reader, job, &mut |done, state| {
        let progress = FOLDED + (1.0 - FOLDED) * done;
        match state {
            Some(state) => keeper.checkpoint(JobCheckpoint { next_seq: end_seq, state }, progress),
            None => keeper.progress(progress),
        }
    })
}

fn rest(time: Duration) {
    std::thread::sleep(time.min(Duration::from_millis(100)));
}
