//! The workers: threads that take jobs from the queue, and remove deleted rows when there are none.

use super::runner::{Outcome, run};
use super::source::CHUNK;
use super::{AnalysisRequest, DiagnosisBody, JobError, JobKind, JobParameters, JobRequest, Simulator, together};
use crate::observe::JobsStatus;
use crate::process::step_back;
use crate::store::{JobRow, JobState, QUEUE_JOBS_MAX, Reader, ReaderPool, Store, StoreError, StoreErrorKind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The interval at which an idle worker checks for work of which it was not notified.
const LOOK: Duration = Duration::from_secs(2);
/// The delay after a job's process died, the first time; twice as long the second time.
const AGAIN: Duration = Duration::from_secs(3);
/// The delay after an error of the database.
const PAUSE: Duration = Duration::from_secs(1);

/// Shortest and longest rest after a step of removing rows.
const REST: (Duration, Duration) = (Duration::from_millis(5), Duration::from_secs(1));

/// Options of the workers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JobsOptions {
    /// The number of jobs at a time, at least 1: each takes a core, and a noise job two while it searches for
    /// disturbances and fits.
    pub threads: usize,
    /// The place where jobs are run.
    pub place: Place,
}

/// The place where jobs are run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// In separate processes, as in the daemon.
    Apart,
    /// In this process, in chunks of this many samples: for programs that are not `vn100d`, such as tests.
    Here {
        /// Samples of one chunk.
        chunk: usize,
    },
}

impl Default for JobsOptions {
    fn default() -> Self {
        Self { threads: 1, place: Place::Here { chunk: CHUNK } }
    }
}

/// The queue and its workers; cheap to clone. Workers end with [`Jobs::stop`].
#[derive(Debug, Clone)]
pub struct Jobs {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    store: Store,
    readers: ReaderPool,
    options: JobsOptions,
    stop: AtomicBool,
    /// Jobs that could not be put back into the queue when their work was interrupted: tried again before anything else.
    stranded: Mutex<Vec<i64>>,
    /// Counts wake-ups, so that none is missed between checking and waiting.
    calls: Mutex<u64>,
    called: Condvar,
    counts: Mutex<JobsStatus>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl Jobs {
    /// Starts the workers on the store's queue; jobs that ran when the program last ended continue.
    ///
    /// # Errors
    /// [`JobError::Thread`] if a thread cannot be started.
    pub fn start(store: &Store, options: JobsOptions) -> Result<Self, JobError> {
        let jobs = Self {
            inner: Arc::new(Inner {
                store: store.clone(),
                readers: ReaderPool::new(store.path()),
                options,
                stop: AtomicBool::new(false),
                stranded: Mutex::default(),
                calls: Mutex::new(0),
                called: Condvar::new(),
                counts: Mutex::default(),
                threads: Mutex::default(),
            }),
        };
        for number in 0..options.threads.max(1) {
            let inner = Arc::clone(&jobs.inner);
            let thread = std::thread::Builder::new()
                .name(format!("jobs-{number}"))
                .spawn(move || {
                    step_back();
                    inner.work();
                })
                .map_err(JobError::Thread)?;
            jobs.inner.threads.lock().unwrap_or_else(PoisonError::into_inner).push(thread);
        }
        Ok(jobs)
    }

    /// Queues a job; returns it and whether it is new. Blocks until it is on disk.
    ///
    /// # Errors
    /// [`JobError::Parameters`], or [`JobError::Store`] (no such capture, too many jobs wait, …).
    pub fn submit(&self, capture_id: i64, request: AnalysisRequest) -> Result<(JobRow, bool), JobError> {
        if !request.parameters().with.is_empty() {
            self.check_together(capture_id, request.parameters())?;
        }
        self.queue(capture_id, &JobRequest::Analysis(request), QUEUE_JOBS_MAX)
    }

    /// Queues the diagnosis that the body of a request describes; returns its job and whether it is new. Blocks until
    /// it is on disk. Its reference is stored once everything else is accepted, and released if the diagnosis is
    /// refused after all.
    ///
    /// # Errors
    /// [`JobError::Parameters`] for an invalid request, [`JobError::Model`], [`JobError::TooLarge`], or
    /// [`JobError::Store`].
    pub fn submit_diagnosis(&self, capture_id: i64, body: DiagnosisBody<'_>) -> Result<(JobRow, bool), JobError> {
        let store = &self.inner.store;
        let sim = |sim| {
            let reader = self.inner.readers.get()?;
            reader.capture(capture_id)?;
            let queued = reader.count_jobs(JobState::Queued)?;
            if queued >= QUEUE_JOBS_MAX {
                return Err(StoreError::QueueFull(queued).into());
            }
            Simulator::of(&reader, sim)
        };
        let (parameters, storing) = match (body, self.inner.options.place) {
            (DiagnosisBody::File(path), Place::Apart) => super::diagnosis_request::read_apart(store, path, sim)?,
            (DiagnosisBody::File(path), Place::Here { .. }) => {
                super::diagnosis_request::read_here(store, &std::fs::read(path).map_err(JobError::Process)?, sim)?
            }
            (DiagnosisBody::Bytes(body), _) => super::diagnosis_request::read_here(store, body, sim)?,
        };
        let submitted = self.queue(capture_id, &JobRequest::Diagnosis(parameters), QUEUE_JOBS_MAX)?;
        if submitted.1
            && let Some(storing) = storing
        {
            storing.claimed();
        }
        Ok(submitted)
    }

    fn queue(&self, capture_id: i64, request: &JobRequest, queue_max: u64) -> Result<(JobRow, bool), JobError> {
        let submitted = self.inner.store.submit_job(request.job(capture_id)?, queue_max)?;
        if submitted.1 {
            self.inner.counts().queued += 1;
        }
        self.wake();
        Ok(submitted)
    }

    /// Refuses captures that do not belong together at once, instead of in the job.
    fn check_together(&self, capture_id: i64, parameters: &JobParameters) -> Result<(), JobError> {
        let reader = self.inner.readers.get()?;
        let end_seq = reader.capture(capture_id)?.samples;
        together::plan_of(&reader, capture_id, end_seq, parameters).map(|_| ())
    }

    /// Queues all jobs that a complete or imported capture gets automatically: one job of every usual kind, however
    /// many wait. A capture without samples, which was cancelled before it began, gets none.
    ///
    /// # Errors
    /// As [`Self::submit`].
    pub fn submit_all(&self, capture_id: i64) -> Result<Vec<JobRow>, JobError> {
        if self.inner.readers.get()?.capture(capture_id)?.samples == 0 {
            return Ok(Vec::new());
        }
        let queue = |kind| Ok(self.queue(capture_id, &usual(kind)?, u64::MAX)?.0);
        JobKind::USUAL.into_iter().map(queue).collect()
    }

    /// Returns the place where heavy work is done.
    pub fn place(&self) -> Place {
        self.inner.options.place
    }

    /// Cancels a job.
    ///
    /// # Errors
    /// [`JobError::Store`]: no such job, or it has ended.
    pub fn cancel(&self, id: i64) -> Result<(), JobError> {
        Ok(self.inner.store.cancel_job(id)?)
    }

    /// Notifies the workers that there is work: a job was queued or a capture deleted.
    pub fn wake(&self) {
        *self.inner.calls.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        self.inner.called.notify_all();
    }

    /// Returns the numbers of jobs; read from memory.
    pub fn status(&self) -> JobsStatus {
        self.inner.counts().clone()
    }

    /// Ends the workers; a running job is queued again at its next chunk and continues at the next start.
    pub fn stop(&self) {
        self.inner.stop.store(true, Ordering::Release);
        self.wake();
        let threads = std::mem::take(&mut *self.inner.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            if thread.join().is_err() {
                tracing::error!(message = "A worker thread had ended by itself.");
            }
        }
    }
}

/// Queues the jobs that [`Jobs::submit_all`] queues, for a program without workers: the daemon does the work when it
/// runs next.
///
/// # Errors
/// As [`Jobs::submit`].
pub fn leave_for_daemon(store: &Store, capture_id: i64) -> Result<(), JobError> {
    for kind in JobKind::USUAL {
        store.submit_job(usual(kind)?.job(capture_id)?, u64::MAX)?;
    }
    Ok(())
}

fn usual(kind: JobKind) -> Result<JobRequest, JobError> {
    AnalysisRequest::usual(kind).map(JobRequest::Analysis)
}

impl Inner {
    fn counts(&self) -> MutexGuard<'_, JobsStatus> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    fn work(&self) {
        while !self.stopped() {
            let seen = *self.calls.lock().unwrap_or_else(PoisonError::into_inner);
            match self.step() {
                Ok(true) => {}
                Ok(false) => self.wait(seen, LOOK),
                Err(JobError::Store(StoreError::Closed)) => return,
                Err(error) => {
                    tracing::warn!(message = "Background work waits.", %error);
                    // Deleted rows are removed anyway: a lack of space may be the problem.
                    if let Err(error) =
                        self.readers.get().map_err(JobError::from).and_then(|reader| self.clear_away(&reader))
                    {
                        tracing::debug!(%error, "Nothing can be cleared away now.");
                    }
                    self.wait(seen, PAUSE);
                }
            }
        }
    }

    fn wait(&self, seen: u64, time: Duration) {
        let calls = self.calls.lock().unwrap_or_else(PoisonError::into_inner);
        // Wake-ups that arrived meanwhile are served at once.
        let waited = self.called.wait_timeout_while(calls, time, |calls| *calls == seen && !self.stopped());
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }

    /// Does one job, or a step of removing rows; returns `false` if there is nothing to do.
    fn step(&self) -> Result<bool, JobError> {
        let stranded = self.stranded.lock().unwrap_or_else(PoisonError::into_inner).pop();
        if let Some(id) = stranded {
            self.release(id)?;
        }
        let reader = self.readers.get()?;
        let queued = reader.count_jobs(JobState::Queued)?;
        self.counts().queued = queued;
        if queued == 0 {
            return self.clear_away(&reader);
        }
        let Some(job) = self.store.claim_job()? else { return Ok(true) };
        self.counts().queued = queued.saturating_sub(1);
        self.counts().running += 1;
        let keep_on = || !self.stopped();
        let outcome = match self.options.place {
            Place::Apart => super::apart::run(&self.store, &reader, &job, keep_on),
            Place::Here { chunk } => run(&self.store, &reader, &job, chunk, keep_on),
        };
        self.counts().running -= 1;
        self.settle(&job, outcome)?;
        Ok(true)
    }

    /// Does a step of removing deleted rows, or of giving back their space; returns `false` if there is nothing to do.
    fn clear_away(&self, reader: &Reader) -> Result<bool, JobError> {
        let begun = Instant::now();
        if reader.has_deleted()? {
            self.store.purge_step()?;
        } else if reader.has_space_to_give_back()? {
            self.store.give_back_step()?;
        } else {
            return Ok(false);
        }
        // The writer serves only the capture for at least as long as the step took.
        std::thread::sleep(begun.elapsed().clamp(REST.0, REST.1));
        Ok(true)
    }

    /// Puts a job back into the queue, now or as soon as the disk accepts it.
    fn release(&self, id: i64) -> Result<(), JobError> {
        let released = self.store.release_job(id);
        Ok(released.inspect_err(|_| self.strand(id))?)
    }

    /// Records a job that could not be put back into the queue: it is put there before anything else.
    fn strand(&self, id: i64) {
        self.stranded.lock().unwrap_or_else(PoisonError::into_inner).push(id);
    }

    fn settle(&self, job: &JobRow, outcome: Result<Outcome, JobError>) -> Result<(), JobError> {
        match outcome {
            Ok(Outcome::Done(result_id)) => {
                self.counts().done += 1;
                tracing::info!(
                    message = "A job is done.",
                    job = job.id,
                    kind = job.kind.name(),
                    capture = job.capture,
                    result_id
                );
                Ok(())
            }
            Ok(Outcome::Cancelled | Outcome::Stopped) => Ok(()),
            // A hole in the samples concerns only the job: its capture may be being deleted.
            Err(JobError::Store(error)) if error.is_damage() && !matches!(error, StoreError::Damaged(_)) => {
                // The job stays unchanged: nothing is written to a damaged database, not even a failure.
                self.store.report_damage(&error);
                Err(error.into())
            }
            Err(JobError::Store(error)) if is_passing(&error) => {
                self.release(job.id)?;
                Err(error.into())
            }
            Err(JobError::Process(error)) => {
                self.release(job.id)?;
                Err(JobError::Process(error))
            }
            // The process may have been ended together with the program.
            Err(JobError::Died(_)) if self.stopped() => self.release(job.id),
            Err(JobError::Died(reason)) => {
                let counted = self.store.count_attempt(job.id, &reason);
                let Some((state, attempts)) = counted.inspect_err(|_| self.strand(job.id))? else { return Ok(()) };
                tracing::warn!(
                    job = job.id,
                    kind = job.kind.name(),
                    capture = job.capture,
                    state = state.name(),
                    reason,
                    "A job's process died."
                );
                self.counts().failed += u64::from(state == JobState::Failed);
                if state == JobState::Queued {
                    // The cause of its death, such as too little memory, may pass.
                    let seen = *self.calls.lock().unwrap_or_else(PoisonError::into_inner);
                    self.wait(seen, AGAIN * attempts);
                }
                Ok(())
            }
            Err(error) => {
                self.counts().failed += 1;
                tracing::warn!(message = "A job failed.", job = job.id, kind = job.kind.name(), capture = job.capture, %error);
                Ok(self.store.fail_job(job.id, &error.to_string()).inspect_err(|_| self.strand(job.id))?)
            }
        }
    }
}

/// Returns whether the same job may succeed later without a change to it.
fn is_passing(error: &StoreError) -> bool {
    // A disk that reports an error now may recover; a damaged database does not.
    let passing = matches!(error.kind(), StoreErrorKind::Unavailable | StoreErrorKind::Io);
    (passing && !matches!(error, StoreError::Damaged(_))) || error.is_interrupted()
}
