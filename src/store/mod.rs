//! The store: SQLite, and the only module that uses `rusqlite`.
//!
//! In: [`Record`](imu_core::sample::Record)s of captures through [`RecordSender`], commands as methods of [`Store`].
//! Out: typed rows through [`Reader`]. One process writes a database ([`StoreError::Locked`] names the other), through
//! one thread and one connection (`writer`). Any number of processes read beside it, never for longer than one short
//! query.
//!
//! Guarantees: samples that [`WriterProgress::committed`] counts survive kill -9 and power loss (WAL,
//! `synchronous=FULL`). A record waits at most a second for its commit. A commit that fails loses nothing: it is tried
//! again while the queue absorbs new records. Refused: network file systems, files of other programs (left untouched),
//! databases of a newer schema.
//!
//! Methods of [`Store`] block until their transaction is committed: from asynchronous code call them through
//! [`Store::offload`].

mod accounting;
mod backup;
mod batch;
mod captures;
mod check;
mod check_at_start;
mod damage;
mod diagnoses;
mod error;
mod file_id;
mod import;
mod insert;
mod jobs;
mod lists;
mod lock;
mod lost;
mod models;
mod names;
mod page;
mod part;
mod paths;
mod progress;
mod queue;
mod reader;
mod recover;
mod references;
mod results;
mod retention;
mod samples;
mod schema;
mod sql;
mod time_axis;
mod times;
mod trail;
mod unfinished;
mod utc;
mod writer;
mod written;

#[cfg(test)]
mod data_model;
#[cfg(test)]
mod model_test;
#[cfg(test)]
mod replaced;
#[cfg(test)]
mod safety;
#[cfg(test)]
mod tests;

pub use accounting::DeviceClockRow;
pub use backup::BackupReport;
pub use captures::{CaptureRow, CaptureState, ChannelRow, NewCapture};
pub use check::{CheckReport, CheckedCapture, Finding, check};
pub use diagnoses::DiagnosisRow;
pub use error::{StoreError, StoreErrorKind};
pub use import::{Import, ImportEnd};
pub use jobs::{JobCheckpoint, JobKind, JobRow, JobState, NewJob, QUEUE_JOBS_MAX, RESULTS_KEPT};
pub use lists::{Found, LIST_ROWS, ListedDiagnosis, ListedJob, Search};
pub use models::{ModelEntry, ModelRow};
pub use names::{CaptureChange, NAME_MAX, NOTE_MAX, as_id, check_name, check_note, printable};
pub use page::{Page, PageRequest};
pub use progress::{BYTES_PER_SAMPLE, WriterProgress};
use queue::SharedWaiting;
pub use queue::{RecordSender, Refused};
pub use reader::{PooledReader, Reader, ReaderPool};
pub use recover::{RecoverReport, RecoveredCapture, recover};
pub use references::REFERENCE_PART_BYTES;
pub use results::ResultRow;
pub use retention::RetentionRow;
pub use samples::{Chunk, SeqRange, Times, chunks};
pub use schema::{APPLICATION_ID, is_of_database, schema_version};
pub use time_axis::{Moment, SampleRange, TimeAxis};
pub use times::UtcNs;
pub use trail::{EventRow, GapRow, Missing, SegmentRow};
pub use unfinished::Unfinished;
pub use writer::{COMMIT_AFTER, COMMIT_RECORDS};

use crate::clock::{Clock, SystemClock};
use crate::observe::StorageStatus;
use progress::SharedProgress;
pub use rusqlite::InterruptHandle as Interrupt;
use rusqlite::Transaction;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use writer::{Command, Failure, Writer, WriterParts};

/// Name and version of this program, as stored with captures and results.
pub const SOFTWARE: &str = concat!("vn100d ", env!("CARGO_PKG_VERSION"));
/// The smallest queue between reader and disk, in records: 30 s at 800 Hz.
const QUEUE_MIN: usize = 24_000;

/// Options for opening a store.
#[derive(Debug, Clone)]
pub struct StoreOptions {
    /// Records that the queue holds.
    pub queue: usize,
    /// The clock that stamps rows which carry no time.
    pub clock: Arc<dyn Clock>,
    /// The interval at which the path is compared with the open file.
    pub file_check: Duration,
    /// Size of the write-ahead log in bytes above which [`Store::status`] warns.
    pub wal_alarm_bytes: u64,
}

impl Default for StoreOptions {
    fn default() -> Self {
        Self {
            queue: QUEUE_MIN,
            clock: Arc::new(SystemClock),
            file_check: Duration::from_secs(10),
            wal_alarm_bytes: 256_000_000,
        }
    }
}

/// A database opened for writing; cheap to clone. Dropping the last clone writes the rest and closes the database.
#[derive(Debug, Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    path: PathBuf,
    clock: Arc<dyn Clock>,
    records: RecordSender,
    commands: mpsc::UnboundedSender<Command>,
    progress: SharedProgress,
    wal_alarm_bytes: u64,
    thread: Mutex<Option<std::thread::JoinHandle<Result<(), StoreError>>>>,
}

impl Store {
    /// Opens the database at `path` for writing. Missing directories and a missing file are created, and an older
    /// schema is upgraded.
    ///
    /// # Errors
    /// [`StoreError`] of kind `CannotCreate` (locked, not ours, cannot be made), `NewerSchema` or `Io`.
    pub fn open(path: &Path, options: StoreOptions) -> Result<Self, StoreError> {
        let create = |source| StoreError::Create { path: path.to_owned(), source };
        let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        std::fs::create_dir_all(directory)
            .map_err(|source| StoreError::Create { path: directory.to_owned(), source })?;
        let name = path.file_name().ok_or_else(|| create(std::io::ErrorKind::InvalidInput.into()))?;
        // Links are resolved once, before the lock: two names of one file must share one lock.
        let path = match path.canonicalize() {
            Ok(path) => path,
            Err(_) => directory.canonicalize().map_err(create)?.join(name),
        };
        lock::refuse_network_file_system(&path)?;
        let writer_lock = lock::WriterLock::take(&path)?;
        let mut connection = schema::open_and_migrate(&path, writer_lock.previous.as_ref())?;
        captures::tidy_after_start(&mut connection)?;

        let (record_sender, record_receiver) = mpsc::channel(options.queue);
        let (command_sender, command_receiver) = mpsc::unbounded_channel();
        let progress = SharedProgress::default();
        let waiting = SharedWaiting::default();
        let parts = WriterParts {
            path: path.clone(),
            clock: Arc::clone(&options.clock),
            records: record_receiver,
            commands: command_receiver,
            progress: Arc::clone(&progress),
            waiting: Arc::clone(&waiting),
            lock: writer_lock,
            file_check: options.file_check,
            wal_alarm_bytes: options.wal_alarm_bytes,
        };
        let writer = Writer::new(parts, connection)?;
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_time().build().map_err(StoreError::Thread)?;
        let thread = std::thread::Builder::new()
            .name("writer".to_owned())
            .spawn(move || runtime.block_on(writer.run()))
            .map_err(StoreError::Thread)?;
        Ok(Self {
            inner: Arc::new(Inner {
                path,
                clock: options.clock,
                records: RecordSender { queue: record_sender, waiting },
                commands: command_sender,
                progress,
                wal_alarm_bytes: options.wal_alarm_bytes,
                thread: Mutex::new(Some(thread)),
            }),
        })
    }

    /// Returns the path of the database.
    pub fn path(&self) -> &Path {
        &self.inner.path
    }

    /// Returns a sender that puts records into the queue.
    pub fn records(&self) -> RecordSender {
        self.inner.records.clone()
    }

    /// Returns the state of the writer; read from memory.
    pub fn progress(&self) -> WriterProgress {
        progress::locked(&self.inner.progress).clone()
    }

    /// Returns the id of a capture in the database. It differs from the id at its start only if the file was replaced
    /// by one in which that id is taken.
    pub fn stored_id(&self, id: i64) -> i64 {
        progress::locked(&self.inner.progress).moved.get(&id).copied().unwrap_or(id)
    }

    /// Returns the state for the status page; read from memory, never waits for the disk.
    pub fn status(&self) -> StorageStatus {
        let progress = self.progress();
        let (now, awake) = (SystemClock.mono_ns(), SystemClock.awake_ns());
        StorageStatus {
            state: progress.state_now(awake),
            time_to_full_s: progress.time_to_full_s(),
            low_space: progress.low_space(),
            warning: progress.warning(self.inner.wal_alarm_bytes),
            database: self.inner.path.display().to_string(),
            database_bytes: progress.database_bytes,
            wal_bytes: progress.wal_bytes,
            free_bytes: progress.free_bytes,
            last_commit_age_s: progress.last_commit_mono_ns.map(|at| now.saturating_sub(at) as f64 / 1e9),
            last_commit_s: progress.last_commit.map(|took| took.as_secs_f64()),
            queued: (self.inner.records.queued() + progress.in_flight) as u64,
            oldest_waiting_s: queue::locked(&self.inner.records.waiting)
                .since_ns()
                .map(|since| awake.saturating_sub(since) as f64 / 1e9),
            error: progress.error_now(awake),
        }
    }

    /// Returns a connection for reading.
    ///
    /// # Errors
    /// [`StoreError`] if it cannot be opened.
    pub fn reader(&self) -> Result<Reader, StoreError> {
        Reader::open(&self.inner.path)
    }

    /// Waits until all records that are in the queue now are on disk. It waits as long as the disk refuses writes.
    ///
    /// # Errors
    /// [`StoreError::Closed`] if the writer has ended.
    pub async fn flush(&self) -> Result<(), StoreError> {
        let (reply, answer) = oneshot::channel();
        self.inner.commands.send(Command::Flush(reply)).map_err(|_| StoreError::Closed)?;
        answer.await.map_err(|_| StoreError::Closed)
    }

    /// Waits as [`Self::flush`] does, from a thread outside the asynchronous runtime.
    ///
    /// # Errors
    /// [`StoreError::Closed`] if the writer has ended.
    pub fn flush_blocking(&self) -> Result<(), StoreError> {
        let (reply, answer) = oneshot::channel();
        self.inner.commands.send(Command::Flush(reply)).map_err(|_| StoreError::Closed)?;
        answer.blocking_recv().map_err(|_| StoreError::Closed)
    }

    /// Runs one of the store's blocking methods on a thread for such work: `store.offload(move |s| s.pin(7, true)).await`.
    ///
    /// # Errors
    /// The error that the method reports; [`StoreError::Closed`] if it could not be run.
    pub async fn offload<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Self) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let store = self.clone();
        tokio::task::spawn_blocking(move || work(&store)).await.map_err(|_| StoreError::Closed)?
    }

    /// Runs `work` on the writer's thread in a separate transaction and returns once that is committed. After an I/O
    /// error at the commit the work may nevertheless have been committed: commands are written so that they can be
    /// repeated.
    pub(crate) fn execute<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.begin(schema::Durability::AtCommit, work)?.wait()
    }

    /// Does work as [`Self::execute`] does; `committed` then runs with its result on the writer's thread, before any
    /// other work.
    pub(crate) fn execute_then<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError> + Send + 'static,
        committed: impl FnOnce(&T) + Send + 'static,
    ) -> Result<T, StoreError> {
        self.begin_then(schema::Durability::AtCommit, work, committed)?.wait()
    }

    /// Begins work as [`Self::execute`] does, without waiting. Work is done in the order in which it was begun.
    pub(crate) fn begin<T: Send + 'static>(
        &self,
        durability: schema::Durability,
        work: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<Begun<T>, StoreError> {
        self.begin_then(durability, work, |_| ())
    }

    fn begin_then<T: Send + 'static>(
        &self,
        durability: schema::Durability,
        work: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError> + Send + 'static,
        committed: impl FnOnce(&T) + Send + 'static,
    ) -> Result<Begun<T>, StoreError> {
        let (reply, answer) = std::sync::mpsc::sync_channel(1);
        let job = move |connection: Result<&mut rusqlite::Connection, StoreError>| {
            let result = connection.and_then(|connection| writer::in_transaction(connection, durability, work));
            let result = result.inspect(committed);
            let failure = result.as_ref().err().filter(|error| writer::concerns_storage(error)).map(Failure::of);
            // The caller may have stopped waiting.
            let _ = reply.send(result);
            failure
        };
        self.inner.commands.send(Command::Run(Box::new(job))).map_err(|_| StoreError::Closed)?;
        Ok(Begun(answer))
    }

    /// Reports that a reader of this database found damage ([`StoreError::is_damage`]): nothing more is written to it.
    pub(crate) fn report_damage(&self, error: &StoreError) {
        let failure = Failure::of(error);
        // A writer that has ended writes nothing anyway.
        let _ = self.inner.commands.send(Command::Damage(failure));
    }

    /// Returns the file that is written, as text for [`Reader::open_written`].
    pub fn file(&self) -> String {
        written::written_file(self.path())
    }

    /// Returns the clock's civil time.
    pub(crate) fn utc_ns(&self) -> i64 {
        self.inner.clock.utc_ns()
    }

    /// Writes everything in the queue, empties the log and closes the database. Further calls return
    /// [`StoreError::Closed`].
    ///
    /// # Errors
    /// [`StoreError::Unwritten`] if the disk refused writes to the end.
    pub fn close(&self) -> Result<(), StoreError> {
        self.inner.close()
    }
}

/// Work that was passed to the writer.
#[derive(Debug)]
pub(crate) struct Begun<T>(std::sync::mpsc::Receiver<Result<T, StoreError>>);

impl<T> Begun<T> {
    /// Waits until the work is committed or has failed.
    pub(crate) fn wait(self) -> Result<T, StoreError> {
        self.0.recv().map_err(|_| StoreError::Closed)?
    }
}

impl Inner {
    fn close(&self) -> Result<(), StoreError> {
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(thread) = thread else { return Ok(()) };
        // A writer that has ended already takes no command.
        let _ = self.commands.send(Command::Stop);
        thread.join().map_err(|_| StoreError::Closed)?
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        if let Err(error) = self.close() {
            tracing::error!(message = "The store could not be closed cleanly.", %error);
        }
    }
}
