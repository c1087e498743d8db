//! The state that handlers share, and their access to the database: on threads for blocking work, a bounded number at a
//! time, and ended when the client has gone.

use super::problem::ApiError;
use super::server::Limits;
use crate::clock::Clock;
use crate::control::{CaptureControl, Importer};
use crate::jobs::{JobError, Jobs, Live};
use crate::observe::{Metrics, SharedRecent, Status};
use crate::page::Stored;
use crate::store::{Interrupt, PooledReader, Reader, ReaderPool, Store, StoreError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

/// Maximum number of changes at once; the writer takes one after the other anyway.
const CHANGES: usize = 4;

/// Maximum number of diagnoses received at once, at most one of them with a large body.
const TAKERS: usize = 3;

/// Maximum number of pages and pictures that hold their documents at once.
const DRAWINGS: usize = 8;

/// Maximum number of listeners to events; each has a connection.
const LISTENERS: usize = 64;

/// The parts of the interface, made by the daemon.
#[derive(Debug, Clone)]
pub struct ApiParts {
    /// The status, from memory.
    pub status: watch::Receiver<Status>,
    /// Starts and stops captures.
    pub control: CaptureControl,
    /// The database: pinning and deleting, and its path for readers.
    pub store: Store,
    /// Background work.
    pub jobs: Jobs,
    /// The analysis of the running capture.
    pub live: Arc<Live>,
    /// The counters.
    pub metrics: Arc<Metrics>,
    /// The last minute of the sensor's data.
    pub recent: SharedRecent,
    /// The time.
    pub clock: Arc<dyn Clock>,
    /// The secret that changing requests need; `None` if none is configured (loopback only).
    pub token: Option<String>,
    /// Whether only this machine has access: the header `Host` must then name it.
    pub loopback: bool,
    /// Imports recordings as captures.
    pub importer: Arc<dyn Importer>,
    /// Sample time of a capture that is requested without a duration.
    pub default_duration: Duration,
    /// Free space in bytes below which the daemon is not ready.
    pub reserve_bytes: u64,
    /// Limits of the server.
    pub limits: Limits,
}

/// The state that handlers share; cheap to clone.
#[derive(Debug, Clone)]
pub(super) struct ApiState(Arc<Inner>);

#[derive(Debug)]
pub(super) struct Inner {
    pub(super) parts: ApiParts,
    pub(super) started: Instant,
    readers: ReaderPool,
    streams: Arc<Semaphore>,
    computations: Arc<Semaphore>,
    drawings: Arc<Semaphore>,
    light: Arc<Semaphore>,
    changes: Arc<Semaphore>,
    imports: Arc<Semaphore>,
    bodies: Arc<Semaphore>,
    takers: Arc<Semaphore>,
    listeners: Arc<Semaphore>,
    /// In KiB.
    memory: Arc<Semaphore>,
    pub(super) latest: Latest,
}

/// The latest rows, and whether a query for them is pending.
#[derive(Debug, Default)]
pub(super) struct Latest(Mutex<Kept>);

/// What [`Latest`] holds.
#[derive(Debug, Default)]
pub(super) struct Kept {
    pub(super) rows: Option<(Instant, Arc<Stored>)>,
    /// Whether a query is running.
    pub(super) reading: bool,
}

impl Latest {
    pub(super) fn kept(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn not_older_than(&self, age: Duration) -> Option<Arc<Stored>> {
        self.kept().rows.as_ref().filter(|(at, _)| at.elapsed() < age).map(|(_, rows)| Arc::clone(rows))
    }
}

impl std::ops::Deref for ApiState {
    type Target = Inner;
    fn deref(&self) -> &Inner {
        &self.0
    }
}

impl ApiState {
    pub(super) fn new(parts: ApiParts) -> Self {
        let Limits { streams, computations, light_queries, .. } = parts.limits;
        Self(Arc::new(Inner {
            readers: ReaderPool::new(parts.store.path()),
            started: Instant::now(),
            streams: Arc::new(Semaphore::new(streams)),
            computations: Arc::new(Semaphore::new(computations)),
            drawings: Arc::new(Semaphore::new(DRAWINGS)),
            light: Arc::new(Semaphore::new(light_queries)),
            changes: Arc::new(Semaphore::new(CHANGES)),
            imports: Arc::new(Semaphore::new(1)),
            bodies: Arc::new(Semaphore::new(1)),
            takers: Arc::new(Semaphore::new(TAKERS)),
            listeners: Arc::new(Semaphore::new(LISTENERS)),
            memory: Arc::new(Semaphore::new(parts.limits.held_bytes / 1024)),
            latest: Latest::default(),
            parts,
        }))
    }

    /// Returns the present status.
    pub(super) fn status(&self) -> Status {
        self.parts.status.borrow().clone()
    }

    /// Runs a query of a few rows. Waits for its turn, as long as the request may take.
    pub(super) async fn read<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Reader) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, ApiError> {
        let permit = Arc::clone(&self.light).acquire_owned().await.map_err(|_| stopping())?;
        self.query(permit, work).await
    }

    /// Returns the permit to send samples, or 429 at once.
    pub(super) fn stream_permit(&self) -> Result<OwnedSemaphorePermit, ApiError> {
        let most = self.parts.limits.streams;
        let busy =
            || self.busy(format!("{most} streams of samples are being sent, which is all that may: ask again"), 1);
        Arc::clone(&self.streams).try_acquire_owned().map_err(|_| busy())
    }

    fn busy(&self, reason: String, retry_after_s: u32) -> ApiError {
        self.parts.metrics.query_refused();
        ApiError::busy(reason, retry_after_s)
    }

    /// Returns a part of the memory that bodies and answers share, or 429 at once. A single larger answer takes all of it.
    pub(super) fn memory_permit(&self, bytes: usize) -> Result<OwnedSemaphorePermit, ApiError> {
        let kib = bytes.div_ceil(1024).min(self.parts.limits.held_bytes / 1024) as u32;
        Arc::clone(&self.memory).try_acquire_many_owned(kib).map_err(|_| {
            let reason = "other clients hold as much memory as they may, with bodies that they do not finish and answers that \
                          they do not read: ask again";
            self.busy(reason.to_owned(), 5)
        })
    }

    /// Returns the permit to listen to events, or 429 at once.
    pub(super) fn listener_permit(&self) -> Result<OwnedSemaphorePermit, ApiError> {
        Arc::clone(&self.listeners).try_acquire_owned().map_err(|_| {
            let reason = format!("{LISTENERS} listen already, which is all that may: close a page, or ask /v1/status");
            ApiError::busy(reason, 5)
        })
    }

    /// Returns the permit to send a large body for a diagnosis, or 429 at once: one at a time.
    pub(super) fn body_permit(&self) -> Result<OwnedSemaphorePermit, ApiError> {
        let busy =
            || self.busy("another diagnosis with a reference is being taken in: ask again when it is".to_owned(), 2);
        Arc::clone(&self.bodies).try_acquire_owned().map_err(|_| busy())
    }

    /// Returns the permit to import, or 429 at once: one recording at a time.
    pub(super) fn import_permit(&self) -> Result<OwnedSemaphorePermit, ApiError> {
        let busy = || self.busy("another recording is being imported: ask again when it is done".to_owned(), 5);
        Arc::clone(&self.imports).try_acquire_owned().map_err(|_| busy())
    }

    /// Runs a computation over stored data: an analysis of a running capture, a picture, a page. Waits for its turn,
    /// and answers 429 if that does not come.
    pub(super) async fn compute<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Reader, &ApiParts) -> Result<T, JobError> + Send + 'static,
    ) -> Result<T, ApiError> {
        let most = self.parts.limits.computations;
        let permit = self.turn(&self.computations, || format!("{most} computations are running")).await?;
        let state = self.clone();
        self.query(permit, move |reader| work(reader, &state.parts)).await
    }

    /// Returns the permit to hold the documents of a page or of a picture. Waits for its turn, and answers 429 if that does not
    /// come.
    pub(super) async fn drawing_permit(&self) -> Result<OwnedSemaphorePermit, ApiError> {
        self.turn(&self.drawings, || format!("{DRAWINGS} pages and pictures are being made")).await
    }

    async fn turn(
        &self,
        turns: &Arc<Semaphore>,
        what: impl FnOnce() -> String,
    ) -> Result<OwnedSemaphorePermit, ApiError> {
        let turn = self.parts.limits.turn;
        let permit = tokio::time::timeout(turn, Arc::clone(turns).acquire_owned()).await;
        let busy = |_| {
            self.busy(format!("{}, which is all that may, and others wait: ask again", what()), turn.as_secs() as u32)
        };
        permit.map_err(busy)?.map_err(|_| stopping())
    }

    async fn query<T: Send + 'static, E: From<StoreError> + Into<ApiError> + Send + 'static>(
        &self,
        permit: OwnedSemaphorePermit,
        work: impl FnOnce(&Reader) -> Result<T, E> + Send + 'static,
    ) -> Result<T, ApiError> {
        let readers = self.readers.clone();
        let ending = Arc::new(Mutex::new(Ending::Waiting));
        let abandoned = Abandon(Arc::clone(&ending));
        let outcome = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            let reader = readers.get()?;
            if !enter(&ending, &reader) {
                return Err(StoreError::Closed.into());
            }
            let outcome = work(&reader);
            // From here on another request may use the reader, so that its query must not be ended any more.
            *ending.lock().unwrap_or_else(PoisonError::into_inner) = Ending::Waiting;
            outcome
        })
        .await;
        drop(abandoned);
        finished(outcome)
    }

    /// Returns a reader for a thread of the caller.
    pub(super) fn reader(&self) -> Result<PooledReader, StoreError> {
        self.readers.get()
    }

    /// Runs a command that changes something; waits for its turn, then for the disk.
    pub(super) async fn change<T: Send + 'static, E: Into<ApiError> + Send + 'static>(
        &self,
        work: impl FnOnce(&ApiParts) -> Result<T, E> + Send + 'static,
    ) -> Result<T, ApiError> {
        self.in_turn(&self.changes, work).await
    }

    /// Receives a diagnosis, possibly with a large body; waits for its turn among [`TAKERS`].
    pub(super) async fn take_in<T: Send + 'static>(
        &self,
        work: impl FnOnce(&ApiParts) -> Result<T, JobError> + Send + 'static,
    ) -> Result<T, ApiError> {
        self.in_turn(&self.takers, work).await
    }

    async fn in_turn<T: Send + 'static, E: Into<ApiError> + Send + 'static>(
        &self,
        turns: &Arc<Semaphore>,
        work: impl FnOnce(&ApiParts) -> Result<T, E> + Send + 'static,
    ) -> Result<T, ApiError> {
        let permit = Arc::clone(turns).acquire_owned().await.map_err(|_| stopping())?;
        let state = self.clone();
        let outcome = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            work(&state.parts)
        })
        .await;
        finished(outcome)
    }

    /// Returns the id of the capture that the path names: an id, a name, or `latest`.
    pub(super) async fn resolve(&self, name: String) -> Result<i64, ApiError> {
        self.read(move |reader| reader.resolve(&name)).await
    }
}

fn finished<T, E: Into<ApiError>>(outcome: Result<Result<T, E>, tokio::task::JoinError>) -> Result<T, ApiError> {
    match outcome {
        Ok(outcome) => outcome.map_err(Into::into),
        Err(error) => Err(ApiError::internal(format!("a query ended abnormally: {error}"))),
    }
}

fn stopping() -> ApiError {
    ApiError::unavailable("the daemon is stopping", 5)
}

/// The progress of a query, shared by its thread and the waiting request.
enum Ending {
    Waiting,
    Running(Interrupt),
    Abandoned,
}

/// Returns whether the query may begin because the client still waits.
fn enter(ending: &Mutex<Ending>, reader: &Reader) -> bool {
    let mut ending = ending.lock().unwrap_or_else(PoisonError::into_inner);
    if matches!(*ending, Ending::Abandoned) {
        return false;
    }
    *ending = Ending::Running(reader.interrupt());
    true
}

/// Ends the query when dropped before it is done: the client has gone or the time is up.
struct Abandon(Arc<Mutex<Ending>>);

impl Drop for Abandon {
    fn drop(&mut self) {
        let mut ending = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Ending::Running(interrupt) = &*ending {
            interrupt.interrupt();
        }
        *ending = Ending::Abandoned;
    }
}
