//! The writer: one thread that owns the only connection that writes.
//!
//! Records come through a bounded queue, commands (closures, each in a transaction of its own) through a channel.
//! Records are committed when the oldest has waited [`COMMIT_AFTER`] or [`COMMIT_RECORDS`] have come together, whichever
//! is first, and kept in memory until a commit has succeeded. While commits fail the thread leaves the queue alone (it
//! absorbs what arrives), tries again with a capped delay, and says so in [`WriterProgress`].
//!
//! A failed commit may be on disk all the same, and after a failed fsync the kernel may have dropped what it was given.
//! So after an I/O error the connection is closed and reopened, the file checked, the log copied into the file, and the
//! batch's number read back: there it is acknowledged, otherwise it is written again.

use super::insert::insert;
use super::{StoreError, lock, schema};
use crate::clock::{Clock, SystemClock};
use crate::observe::StorageState;
use crate::sample::Record;
use rusqlite::{Connection, Transaction, TransactionBehavior};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

/// The longest a record waits for its commit to begin, in real time: with the commit itself it stays under a second.
pub const COMMIT_AFTER: Duration = Duration::from_millis(900);
/// So many records are committed without waiting.
pub const COMMIT_RECORDS: usize = 8192;
/// First and longest delay before a failed commit is tried again.
const RETRY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(1));
/// A commit that takes longer than this is slow.
const SLOW: Duration = Duration::from_secs(1);
/// How long the check after an I/O error may take: a large database is then taken as it is.
const QUICK_CHECK: Duration = Duration::from_secs(5);
/// How long the end may wait for a disk that refuses.
const STOP_PATIENCE: Duration = Duration::from_secs(5);
/// What a row of table `sample` takes in the file, with its share of the tree (measured: benches/store.rs).
pub const BYTES_PER_SAMPLE: f64 = 190.0;

/// How the writer is, as of its last step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WriterProgress {
    /// How commits go.
    pub state: StorageState,
    /// The last error, while `state` is not ok.
    pub error: Option<String>,
    /// Samples on disk by capture, of captures written since the start.
    pub committed: BTreeMap<i64, u64>,
    /// Commits of batches since the start.
    pub commits: u64,
    /// Failed attempts since the start.
    pub failures: u64,
    /// Real times (monotonic, ns) of the last three failures that were I/O errors, oldest first.
    pub io_failures_mono_ns: Vec<u64>,
    /// Records that the schema refused: faults of this program.
    pub refused: u64,
    /// When the last commit succeeded, real monotonic ns.
    pub last_commit_mono_ns: Option<u64>,
    /// How long it took.
    pub last_commit: Option<Duration>,
    /// Records taken from the queue and not committed.
    pub in_flight: usize,
    /// Grows as long as the thread is alive, at least once a second; stands still while a commit hangs.
    pub ticks: u64,
    /// Size of the database file in bytes.
    pub database_bytes: u64,
    /// Size of the write-ahead log in bytes.
    pub wal_bytes: u64,
    /// Free space of the file system in bytes.
    pub free_bytes: u64,
    /// Samples committed per real second, averaged over half a minute.
    pub samples_per_s: f64,
}

/// Progress shared between the thread and whoever asks.
pub(super) type SharedProgress = Arc<Mutex<WriterProgress>>;

pub(super) fn locked(progress: &Mutex<WriterProgress>) -> MutexGuard<'_, WriterProgress> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Puts records into the writer's queue.
#[derive(Debug, Clone)]
pub struct RecordSender(pub(super) mpsc::Sender<(i64, Record)>);

/// A record that was not taken.
#[derive(Debug, Clone, PartialEq)]
pub enum Refused {
    /// The queue is full.
    Full(Record),
    /// The writer has ended.
    Closed(Record),
}

impl RecordSender {
    /// Puts a capture's record into the queue; never waits.
    ///
    /// # Errors
    /// [`Refused`] with the record where the queue is full or the writer has ended.
    #[expect(clippy::result_large_err, reason = "the record is given back, it was as large when it came")]
    pub fn try_send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.0.try_send((capture_id, record)).map_err(|error| match error {
            mpsc::error::TrySendError::Full((_, record)) => Refused::Full(record),
            mpsc::error::TrySendError::Closed((_, record)) => Refused::Closed(record),
        })
    }

    /// Puts a capture's record into the queue, waiting for room: for a reader that may hold its source back.
    ///
    /// # Errors
    /// [`Refused::Closed`] where the writer has ended.
    pub async fn send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.0.send((capture_id, record)).await.map_err(|error| Refused::Closed(error.0.1))
    }

    /// As [`Self::send`], from a thread outside the asynchronous runtime.
    ///
    /// # Errors
    /// [`Refused::Closed`] where the writer has ended.
    #[expect(clippy::result_large_err, reason = "the record is given back, it was as large when it came")]
    pub fn blocking_send(&self, capture_id: i64, record: Record) -> Result<(), Refused> {
        self.0.blocking_send((capture_id, record)).map_err(|error| Refused::Closed(error.0.1))
    }

    /// Records that wait in the queue.
    #[must_use]
    pub fn queued(&self) -> usize {
        self.0.max_capacity() - self.0.capacity()
    }

    /// Records that still fit.
    #[must_use]
    pub fn room(&self) -> usize {
        self.0.capacity()
    }

    /// Whether the writer has ended.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.0.is_closed()
    }
}

/// A storage error, apart from its typed origin.
#[derive(Debug, Clone)]
pub(super) struct Failure {
    state: StorageState,
    text: String,
    sound: bool,
}

impl Failure {
    pub(super) fn of(error: &StoreError) -> Self {
        Self { state: error.storage_state(), text: error.to_string(), sound: error.connection_is_sound() }
    }
}

type Work = Box<dyn FnOnce(Result<&mut Connection, StoreError>) -> Option<Failure> + Send>;

/// What the thread is told besides records.
pub(super) enum Command {
    /// Run this.
    Run(Work),
    /// Answer when everything that is in the queue now is committed.
    Flush(oneshot::Sender<()>),
    /// Write what is there and end.
    Stop,
}

/// Runs `work` in a transaction of its own.
pub(super) fn in_transaction<T>(
    connection: &mut Connection,
    work: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let value = work(&transaction)?;
    transaction.commit()?;
    Ok(value)
}

/// Whether the error says something about the disk rather than about what was asked.
pub(super) fn concerns_storage(error: &StoreError) -> bool {
    use rusqlite::ErrorCode as Code;
    matches!(error, StoreError::Sqlite(error) if matches!(
        error.sqlite_error_code(),
        Some(Code::DiskFull | Code::ReadOnly | Code::DatabaseBusy | Code::DatabaseLocked | Code::SystemIoFailure
            | Code::DatabaseCorrupt | Code::CannotOpen | Code::NotADatabase | Code::PermissionDenied)
    ))
}

pub(super) struct Writer {
    path: PathBuf,
    clock: Arc<dyn Clock>,
    records: mpsc::Receiver<(i64, Record)>,
    commands: mpsc::UnboundedReceiver<Command>,
    progress: SharedProgress,
    connection: Option<Connection>,
    /// Taken from the queue, not yet committed.
    batch: Vec<(i64, Record)>,
    /// The number the batch will have.
    number: i64,
    /// The batch was handed to a commit that failed: it may be there.
    in_doubt: bool,
    /// An I/O error happened: the file is to be checked when it is opened again.
    suspect: bool,
    /// When the oldest record of the batch must be committed.
    due: Option<Instant>,
    /// No attempt before this.
    retry_at: Option<Instant>,
    retry_after: Duration,
    /// Who waits for how many more records to be committed.
    flushes: Vec<(usize, oneshot::Sender<()>)>,
    measured_at: Instant,
    samples_since: u64,
}

impl Writer {
    pub(super) fn new(
        path: PathBuf,
        clock: Arc<dyn Clock>,
        connection: Connection,
        records: mpsc::Receiver<(i64, Record)>,
        commands: mpsc::UnboundedReceiver<Command>,
        progress: SharedProgress,
    ) -> Result<Self, StoreError> {
        let number = last_batch(&connection)? + 1;
        let mut writer = Self {
            path,
            clock,
            records,
            commands,
            progress,
            connection: Some(connection),
            batch: Vec::with_capacity(COMMIT_RECORDS),
            number,
            in_doubt: false,
            suspect: false,
            due: None,
            retry_at: None,
            retry_after: RETRY.0,
            flushes: Vec::new(),
            measured_at: Instant::now(),
            samples_since: 0,
        };
        writer.measure();
        Ok(writer)
    }

    /// Works until told to stop or every sender is gone.
    pub(super) async fn run(mut self) -> Result<(), StoreError> {
        let mut records_open = true;
        loop {
            let tick = self.measured_at + Duration::from_secs(1);
            let wake = [self.retry_at.or(self.due), Some(tick)].into_iter().flatten().min().unwrap_or(tick);
            let room = COMMIT_RECORDS.saturating_sub(self.batch.len());
            let receive = records_open && room > 0 && self.retry_at.is_none();
            tokio::select! {
                command = self.commands.recv() => match command {
                    Some(Command::Run(work)) => self.run_command(work),
                    Some(Command::Flush(reply)) => self.flushes.push((self.batch.len() + self.records.len(), reply)),
                    Some(Command::Stop) | None => return self.stop(),
                },
                received = self.records.recv_many(&mut self.batch, room), if receive => {
                    records_open = received > 0;
                    if received > 0 && self.due.is_none() {
                        self.due = Some(Instant::now() + COMMIT_AFTER);
                    }
                }
                () = tokio::time::sleep_until(wake) => {}
            }
            let now = Instant::now();
            let full = self.batch.len() >= COMMIT_RECORDS;
            let asked = !self.flushes.is_empty() && self.records.is_empty();
            let retry = self.retry_at.is_some_and(|at| now >= at);
            if retry || self.retry_at.is_none() && (full || asked || self.due.is_some_and(|due| now >= due)) {
                self.commit();
            }
            self.answer_flushes(0);
            if now >= tick {
                self.measure();
            }
            let mut progress = locked(&self.progress);
            progress.ticks += 1;
            progress.in_flight = self.batch.len();
        }
    }

    /// Runs a command. A batch that is being gathered is committed first, so that a command finds what preceded it.
    fn run_command(&mut self, work: Work) {
        if self.retry_at.is_none() {
            self.commit();
        }
        let failure = match self.connection() {
            Ok(connection) => work(Ok(connection)),
            Err(error) => {
                let failure = Failure::of(&error);
                work(Err(error));
                Some(failure)
            }
        };
        if let Some(failure) = failure {
            self.fail(failure);
        }
    }

    fn connection(&mut self) -> Result<&mut Connection, StoreError> {
        if self.connection.is_none() {
            let connection = schema::reopen(&self.path)?;
            if self.suspect {
                quick_check(&connection, QUICK_CHECK)?;
                copy_log(&connection)?;
                self.suspect = false;
            }
            self.connection = Some(connection);
        }
        self.connection.as_mut().ok_or(StoreError::Closed)
    }

    fn commit(&mut self) {
        if self.batch.is_empty() {
            // Nothing to write, but a broken connection is mended all the same.
            match self.connection().map(drop) {
                Ok(()) if self.retry_at.is_some() => self.recovered(),
                Ok(()) => {}
                Err(error) => self.fail(Failure::of(&error)),
            }
            return;
        }
        let started = SystemClock.mono_ns();
        match self.write_batch() {
            Ok(inserted) => {
                let now = SystemClock.mono_ns();
                let took = Duration::from_nanos(now - started);
                let written = self.batch.len();
                self.batch.clear();
                self.number += 1;
                self.in_doubt = false;
                self.due = None;
                self.samples_since += inserted.samples;
                self.recovered();
                {
                    let mut progress = locked(&self.progress);
                    progress.committed.extend(inserted.committed);
                    progress.refused += inserted.refused;
                    progress.commits += 1;
                    progress.last_commit_mono_ns = Some(now);
                    progress.last_commit = Some(took);
                    if took > SLOW {
                        progress.state = StorageState::Slow;
                    }
                }
                self.answer_flushes(written);
            }
            Err(error) => {
                self.in_doubt = true;
                self.fail(Failure::of(&error));
            }
        }
    }

    fn write_batch(&mut self) -> Result<super::insert::Inserted, StoreError> {
        let (number, in_doubt, utc_ns) = (self.number, self.in_doubt, self.clock.utc_ns());
        self.connection()?;
        let Some(connection) = self.connection.as_mut() else { return Err(StoreError::Closed) };
        if in_doubt && last_batch(connection)? == number {
            tracing::warn!(message = "A batch whose commit had failed is there.", number);
            return committed_of(connection, &self.batch);
        }
        let batch = &self.batch;
        in_transaction(connection, |transaction| {
            let inserted = insert(transaction, batch, utc_ns)?;
            transaction.prepare_cached("UPDATE writer SET batch = ?1")?.execute([number])?;
            Ok(inserted)
        })
    }

    fn recovered(&mut self) {
        self.retry_at = None;
        self.retry_after = RETRY.0;
        let mut progress = locked(&self.progress);
        if !matches!(progress.state, StorageState::Ok | StorageState::Slow) {
            tracing::info!(message = "The database takes data again.");
        }
        progress.state = StorageState::Ok;
        progress.error = None;
    }

    fn fail(&mut self, failure: Failure) {
        if !failure.sound {
            self.connection = None;
            self.suspect |= failure.state == StorageState::StorageError;
        }
        self.retry_at = Some(Instant::now() + self.retry_after);
        self.retry_after = (self.retry_after * 2).min(RETRY.1);
        let mut progress = locked(&self.progress);
        if progress.error.as_ref() != Some(&failure.text) {
            tracing::error!(message = "The database does not take data; it is kept in memory.", error = failure.text);
        }
        progress.failures += 1;
        if failure.state == StorageState::StorageError {
            progress.io_failures_mono_ns.push(SystemClock.mono_ns());
            if progress.io_failures_mono_ns.len() > 3 {
                progress.io_failures_mono_ns.remove(0);
            }
        }
        progress.state = failure.state;
        progress.error = Some(failure.text);
    }

    fn answer_flushes(&mut self, written: usize) {
        let idle = self.batch.is_empty() && self.records.is_empty();
        for (remaining, _) in &mut self.flushes {
            *remaining = if idle { 0 } else { remaining.saturating_sub(written) };
        }
        let (done, waiting) = std::mem::take(&mut self.flushes).into_iter().partition(|(remaining, _)| *remaining == 0);
        self.flushes = waiting;
        let done: Vec<(usize, oneshot::Sender<()>)> = done;
        for (_, reply) in done {
            // Whoever asked may have given up waiting.
            let _ = reply.send(());
        }
    }

    /// Sizes and rates, once a second.
    fn measure(&mut self) {
        let now = Instant::now();
        let seconds = (now - self.measured_at).as_secs_f64();
        self.measured_at = now;
        let rate = if seconds > 0.0 { self.samples_since as f64 / seconds } else { 0.0 };
        self.samples_since = 0;
        let weight = (seconds / 30.0).min(1.0);
        let bytes = |path: &std::path::Path| std::fs::metadata(path).map_or(0, |file| file.len());
        let (database, wal) = (bytes(&self.path), bytes(&schema::wal_path(&self.path)));
        let free = lock::free_bytes(&self.path);
        let mut progress = locked(&self.progress);
        progress.samples_per_s += weight * (rate - progress.samples_per_s);
        progress.database_bytes = database;
        progress.wal_bytes = wal;
        if let Ok(free) = free {
            progress.free_bytes = free;
        }
    }

    /// Writes everything that is there, copies the log into the file and closes it.
    fn stop(mut self) -> Result<(), StoreError> {
        self.records.close();
        let patience = Instant::now() + STOP_PATIENCE;
        loop {
            // A batch in doubt stays as it was handed over: its number stands for exactly these records.
            while !self.in_doubt && self.batch.len() < COMMIT_RECORDS {
                match self.records.try_recv() {
                    Ok(record) => self.batch.push(record),
                    Err(_) => break,
                }
            }
            if self.batch.is_empty() {
                break;
            }
            self.commit();
            let error = locked(&self.progress).error.clone();
            if let Some(reason) = error {
                if Instant::now() >= patience {
                    let records = self.batch.len() + self.records.len();
                    return Err(StoreError::Unwritten { records, reason });
                }
                std::thread::sleep(self.retry_after);
            }
        }
        self.answer_flushes(0);
        if let Ok(connection) = self.connection() {
            // A reader beside us may keep the log from being emptied; the next start does it then.
            if let Err(error) = copy_log(connection) {
                tracing::warn!(message = "The write-ahead log stays until the next start.", %error);
            }
        }
        if let Some(connection) = self.connection.take() {
            connection.close().map_err(|(_, error)| StoreError::Sqlite(error))?;
        }
        Ok(())
    }
}

#[cfg(test)]
impl Writer {
    /// Writes the records and behaves as if the commit had reported an error.
    pub(super) fn pretend_failed_commit(&mut self, records: Vec<(i64, Record)>) {
        self.batch = records;
        self.write_batch().unwrap();
        self.in_doubt = true;
        self.suspect = true;
        self.connection = None;
    }

    /// Tries the batch again.
    pub(super) fn retry_now(&mut self) {
        self.commit();
        assert!(self.batch.is_empty());
    }
}

fn last_batch(connection: &Connection) -> Result<i64, StoreError> {
    Ok(connection.query_row("SELECT batch FROM writer", [], |row| row.get(0))?)
}

/// What a batch that turned out to be there has left in the captures.
fn committed_of(connection: &Connection, batch: &[(i64, Record)]) -> Result<super::insert::Inserted, StoreError> {
    let mut inserted = super::insert::Inserted::default();
    let captures: std::collections::BTreeSet<i64> = batch.iter().map(|(id, _)| *id).collect();
    inserted.samples = batch.iter().filter(|(_, record)| matches!(record, Record::Sample { .. })).count() as u64;
    for id in captures {
        let samples =
            connection.query_row("SELECT samples FROM capture WHERE id = ?1", [id], |row| row.get::<_, i64>(0));
        match samples {
            Ok(samples) => drop(inserted.committed.insert(id, samples as u64)),
            Err(rusqlite::Error::QueryReturnedNoRows) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(inserted)
}

/// Copies the whole log into the database file, synced, so that nothing rests on what a failed fsync may have dropped.
fn copy_log(connection: &Connection) -> Result<(), StoreError> {
    let (log, copied): (i64, i64) =
        connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| Ok((row.get(1)?, row.get(2)?)))?;
    if log > copied {
        let busy = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_BUSY);
        let text = Some("a reader keeps the log from being copied".to_owned());
        return Err(StoreError::Sqlite(rusqlite::Error::SqliteFailure(busy, text)));
    }
    Ok(())
}

/// SQLite's quick check; one that takes longer than `limit` is given up and taken as passed.
pub(super) fn quick_check(connection: &Connection, limit: Duration) -> Result<(), StoreError> {
    let until = std::time::Instant::now() + limit;
    connection.progress_handler(100_000, Some(move || std::time::Instant::now() > until))?;
    let report: Result<String, rusqlite::Error> = connection.query_row("PRAGMA quick_check(1)", [], |row| row.get(0));
    connection.progress_handler(0, None::<fn() -> bool>)?;
    match report {
        Ok(report) if report == "ok" => Ok(()),
        Ok(report) => Err(StoreError::Damaged { report }),
        Err(error) if error.sqlite_error_code() == Some(rusqlite::ErrorCode::OperationInterrupted) => {
            tracing::warn!(message = "The database is too large to be checked in passing.", ?limit);
            Ok(())
        }
        Err(error) => Err(error.into()),
    }
}
