//! The writer: one thread that owns the only connection that writes.
//!
//! Records arrive through a bounded queue, commands (closures, each in a separate transaction) through a channel.
//! Records are committed when the oldest has waited [`COMMIT_AFTER`] or [`COMMIT_RECORDS`] have accumulated, whichever
//! is first. They are kept in memory until a commit has succeeded. While commits fail, the thread leaves the queue
//! alone (it absorbs new records), tries again with a capped delay, and reports it in `WriterProgress`.
//!
//! A failed commit may nevertheless be on disk, and after a failed fsync the kernel may have dropped its data. So after
//! an I/O error the connection is closed and reopened, the file checked, and the batch's number read back. If the batch
//! is missing, it is written again, in new pages that a new fsync covers. If it is present, it is first made durable:
//! the log is copied into the file or, if a reader prevents that, written over itself.

mod failure;
mod file;
#[cfg(test)]
mod pretend;

pub(super) use failure::{Failure, concerns_storage};
#[cfg(test)]
pub(super) use file::rewrite;
pub(super) use file::{identity_of, one_line, quick_check};

use super::check_at_start::not_behind;
use super::damage::Damage;
use super::file_id::FileId;
use super::insert::insert;
use super::lock::{Mark, WriterLock};
use super::lost::Lost;
use super::paths::wal_path;
use super::progress::{SLOW, SharedProgress, locked};
use super::queue::{self, SharedWaiting};
use super::schema::{Durability, set_durability};
use super::sql::run;
use super::{StoreError, lock, schema, utc};
use crate::clock::{Clock, SystemClock};
use crate::observe::StorageState;
use failure::{RETRY, only_reading_failed};
use file::{committed_of, copy_log, last_batch, make_durable};
use imu_core::sample::Record;
use rusqlite::{Connection, Transaction, TransactionBehavior};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

/// The longest time that a record taken from the queue waits for its commit to begin, in real time. With this commit
/// and the one before it, during which it waited in the queue, it stays under a second.
pub const COMMIT_AFTER: Duration = Duration::from_millis(750);
/// This many records are committed without waiting.
pub const COMMIT_RECORDS: usize = 8192;
/// The time limit of the check after an I/O error; a larger database is then accepted as it is.
const QUICK_CHECK: Duration = Duration::from_secs(2);
/// The shortest rest between two steps of correcting civil times.
const REST: Duration = Duration::from_millis(5);
/// How long the shutdown waits for a disk that refuses writes.
const STOP_PATIENCE: Duration = Duration::from_secs(5);
/// How long the shutdown continues to correct civil times; the next start does the rest.
const STOP_CORRECTING: Duration = Duration::from_secs(1);
/// The delay before a failed step of correcting is tried again. After several failures in a row the next start tries
/// it.
const CORRECT_AGAIN: Duration = Duration::from_secs(60);
const CORRECTION_FAILURES: u32 = 5;

type Work = Box<dyn FnOnce(Result<&mut Connection, StoreError>) -> Option<Failure> + Send>;

/// The commands to the thread, besides records.
pub(super) enum Command {
    /// Run this work.
    Run(Work),
    /// A reader found damage.
    Damage(Failure),
    /// Reply when all records that are in the queue now are committed.
    Flush(oneshot::Sender<()>),
    /// Write the rest and end.
    Stop,
}

/// Runs `work` in a separate transaction.
pub(super) fn in_transaction<T>(
    connection: &mut Connection,
    durability: Durability,
    work: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    set_durability(connection, durability)?;
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let value = work(&transaction)?;
    transaction.commit()?;
    Ok(value)
}

/// The parts from which the writer is built.
pub(super) struct WriterParts {
    pub(super) path: PathBuf,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) records: mpsc::Receiver<(i64, Record)>,
    pub(super) commands: mpsc::UnboundedReceiver<Command>,
    pub(super) progress: SharedProgress,
    pub(super) waiting: SharedWaiting,
    pub(super) lock: WriterLock,
    pub(super) file_check: Duration,
    pub(super) wal_alarm_bytes: u64,
}

pub(super) struct Writer {
    parts: WriterParts,
    connection: Option<Connection>,
    /// The identity of the open file.
    file: FileId,
    file_checked: Instant,
    /// Whether the connection is closed because another file is in its place, which was reported.
    replaced: bool,
    /// The records for the replacement of a lost file.
    lost: Lost,
    identity: String,
    warned: bool,
    /// The database is damaged: nothing is written any more.
    damage: Option<Damage>,
    /// Civil times are to be corrected; the next step is due at this moment.
    correcting: Option<Instant>,
    /// Steps that failed since one succeeded, for a reason that does not pass by itself.
    correction_failures: u32,
    /// Records taken from the queue and not yet committed.
    batch: Vec<(i64, Record)>,
    /// The number of the next batch.
    number: i64,
    /// Whether the batch was passed to a commit that failed: it may be on disk.
    in_doubt: bool,
    /// Whether an I/O error happened: the file must be checked when it is reopened.
    suspect: bool,
    /// The deadline for committing the oldest record of the batch.
    due: Option<Instant>,
    /// The earliest time of the next attempt.
    retry_at: Option<Instant>,
    retry_after: Duration,
    /// The callers that wait, and for how many more records to be committed.
    flushes: Vec<(usize, oneshot::Sender<()>)>,
    measured_at: Instant,
    samples_since: u64,
}

impl Writer {
    pub(super) fn new(parts: WriterParts, connection: Connection) -> Result<Self, StoreError> {
        let mut writer = Self {
            file: FileId::written(&parts.path),
            file_checked: Instant::now(),
            replaced: false,
            lost: Lost::default(),
            identity: identity_of(&connection)?,
            warned: false,
            parts,
            number: last_batch(&connection)? + 1,
            connection: Some(connection),
            damage: None,
            // An earlier run may have left corrections.
            correcting: Some(Instant::now()),
            correction_failures: 0,
            batch: Vec::with_capacity(COMMIT_RECORDS),
            in_doubt: false,
            suspect: false,
            due: None,
            retry_at: None,
            retry_after: RETRY.0,
            flushes: Vec::new(),
            measured_at: Instant::now(),
            samples_since: 0,
        };
        writer.remember();
        writer.measure();
        Ok(writer)
    }

    /// Records outside the database the last acknowledged batch. The error shows why a disk refuses writes, which
    /// SQLite does not report.
    fn remember(&self) -> Option<std::io::Error> {
        self.parts.lock.mark(&self.identity, self.number - 1).err()
    }

    /// Works until a stop command arrives or every sender is gone.
    pub(super) async fn run(mut self) -> Result<(), StoreError> {
        let mut records_open = true;
        loop {
            let tick = self.measured_at + Duration::from_secs(1);
            let step = self.correcting.filter(|_| self.retry_at.is_none() && self.damage.is_none());
            let wake = [self.retry_at.or(self.due), step, Some(tick)].into_iter().flatten().min().unwrap_or(tick);
            let room = COMMIT_RECORDS.saturating_sub(self.batch.len());
            let receive = records_open && room > 0 && self.retry_at.is_none() && self.damage.is_none();
            tokio::select! {
                command = self.parts.commands.recv() => match command {
                    Some(Command::Run(work)) => self.run_command(work),
                    Some(Command::Damage(failure)) => self.take_report(failure),
                    Some(Command::Flush(reply)) => self.flushes.push((self.batch.len() + self.parts.records.len(), reply)),
                    Some(Command::Stop) | None => return self.stop(),
                },
                received = self.parts.records.recv_many(&mut self.batch, room), if receive => {
                    records_open = received > 0;
                    if received > 0 && self.due.is_none() {
                        self.due = Some(Instant::now() + COMMIT_AFTER);
                    }
                }
                () = tokio::time::sleep_until(wake) => {}
            }
            let now = Instant::now();
            let full = self.batch.len() >= COMMIT_RECORDS;
            let asked = !self.flushes.is_empty() && self.parts.records.is_empty();
            let retry = self.retry_at.is_some_and(|at| now >= at);
            if self.damage.is_some() {
                // New records stay in the queue: the process is about to end.
            } else if retry || self.retry_at.is_none() && (full || asked || self.due.is_some_and(|due| now >= due)) {
                self.commit();
            }
            self.answer_flushes(0);
            if step.is_some_and(|step| now >= step) && self.retry_at.is_none() && self.damage.is_none() {
                self.correct_times();
            }
            if now >= self.file_checked + self.parts.file_check {
                self.check_file();
            }
            if now >= tick {
                self.measure();
            }
            let mut progress = locked(&self.parts.progress);
            progress.ticks += 1;
            progress.turned_awake_ns = Some(SystemClock.awake_ns());
            progress.in_flight = self.batch.len();
        }
    }

    /// Runs a command. A batch that is being gathered is committed first, so that a command sees the records before it.
    fn run_command(&mut self, work: Work) {
        if self.retry_at.is_none() && self.damage.is_none() {
            self.commit();
        }
        if let Some(damage) = &self.damage {
            work(Err(damage.error(&self.parts.path)));
            return;
        }
        if self.retry_at.is_some() && self.connection.is_none() {
            // Only the batch tries the disk again, at its own pace: a command that arrives now fails at once.
            let reason = locked(&self.parts.progress).error.clone().unwrap_or_default();
            work(Err(StoreError::Refusing(reason)));
            return;
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
        if let Some(damage) = &self.damage {
            return Err(damage.error(&self.parts.path));
        }
        if self.connection.is_none() {
            if !self.file.is_replaced(&self.parts.path, &self.identity) {
                self.replaced = false;
                self.reopen()?;
            } else if std::mem::replace(&mut self.replaced, true) {
                self.take_new_file()?;
            } else {
                return Err(self.lost());
            }
        }
        self.connection.as_mut().ok_or(StoreError::Closed)
    }

    /// Reopens the same file, if it still holds the committed data.
    fn reopen(&mut self) -> Result<(), StoreError> {
        let connection = schema::reopen(&self.parts.path).map_err(|error| match error {
            StoreError::Foreign { .. } => StoreError::Damaged("its header is not one of ours".to_owned()),
            other => other,
        })?;
        if identity_of(&connection)? != self.identity {
            self.file.set_lost();
            return Err(self.lost());
        }
        let mark = Mark { identity: self.identity.clone(), batch: self.number - 1, damage: None };
        not_behind(&connection, &self.parts.path, &mark)?;
        if self.suspect {
            quick_check(&connection, QUICK_CHECK)?;
            self.suspect = false;
        }
        schema::keep_log(&connection, false)?;
        self.file = FileId::written(&self.parts.path);
        self.connection = Some(connection);
        Ok(())
    }

    fn lost(&mut self) -> StoreError {
        self.file.look(&self.parts.path);
        let detail = "a new file takes what comes, from what was not yet committed on";
        StoreError::Lost { path: self.parts.path.clone(), detail }
    }

    /// Checks whether the path still names the open file. Data written to a deleted database is lost.
    fn check_file(&mut self) {
        self.file_checked = Instant::now();
        if !self.file.is_lost(&self.parts.path) {
            return;
        }
        if let Some(connection) = self.connection.take() {
            self.lost.note(&connection);
            self.file.let_go(&self.parts.path, connection);
            self.replaced = true;
            let lost = self.lost();
            self.fail(Failure::of(&lost));
        }
    }

    /// Opens the replacement of the lost file, or a new file, and continues the captures there.
    fn take_new_file(&mut self) -> Result<(), StoreError> {
        let path = &self.parts.path;
        let opened = self.file.judged(path, |file| {
            file.clear_remains(path)?;
            schema::open_and_migrate(path, None)
        })?;
        let Some(mut connection) = opened else { return Err(self.lost()) };
        let moved = self.lost.settle(&mut connection, self.parts.clock.utc_ns())?;
        self.number = last_batch(&connection)? + 1;
        self.identity = identity_of(&connection)?;
        self.in_doubt = false;
        self.suspect = false;
        self.replaced = false;
        self.file = FileId::written(&self.parts.path);
        self.connection = Some(connection);
        self.correcting = Some(Instant::now());
        self.correction_failures = 0;
        self.remember();
        let mut progress = locked(&self.parts.progress);
        progress.committed = self.lost.acknowledged();
        progress.moved = moved;
        tracing::warn!(message = "A new database file takes what comes.", path = %self.parts.path.display());
        Ok(())
    }

    fn commit(&mut self) {
        if self.batch.is_empty() {
            // There is nothing to write, but a broken connection is nevertheless repaired.
            match self.connection().map(drop) {
                Ok(()) if self.retry_at.is_some() => self.recovered(),
                Ok(()) => {}
                Err(error) => self.fail(Failure::of(&error)),
            }
            return;
        }
        let started = SystemClock.awake_ns();
        locked(&self.parts.progress).committing_since_awake_ns = Some(started);
        let written = self.write_batch();
        locked(&self.parts.progress).committing_since_awake_ns = None;
        match written {
            Ok(inserted) => {
                let took = Duration::from_nanos(SystemClock.awake_ns().saturating_sub(started));
                let written = self.batch.len();
                self.batch.clear();
                queue::locked(&self.parts.waiting).write(written as u64);
                self.remember_commit();
                self.in_doubt = false;
                self.due = None;
                self.samples_since += inserted.samples;
                if inserted.corrections {
                    self.correcting.get_or_insert_with(Instant::now);
                }
                self.recovered();
                {
                    let mut progress = locked(&self.parts.progress);
                    progress.committed.extend(inserted.committed);
                    progress.figures.refused += inserted.refused;
                    progress.figures.commits += 1;
                    progress.last_commit_mono_ns = Some(SystemClock.mono_ns());
                    progress.last_commit = Some(took);
                    progress.figures.slowest_commit_s = progress.figures.slowest_commit_s.max(took.as_secs_f64());
                    if took > SLOW {
                        progress.figures.slow_commits += 1;
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

    /// Does a step of correcting civil times, between commits; returns `false` if none can follow at once.
    fn correct_times(&mut self) -> bool {
        let begun = Instant::now();
        let connection = match self.connection() {
            Ok(connection) => connection,
            // Commits have no space either.
            Err(error) => {
                self.fail(Failure::of(&error));
                return false;
            }
        };
        let done = in_transaction(connection, Durability::AtCommit, |step| utc::step(step));
        if done.is_ok() {
            self.correction_failures = 0;
        }
        match done {
            // The writer serves only the capture for at least as long as the step took.
            Ok(true) => self.correcting = Some(Instant::now() + begun.elapsed().max(REST)),
            Ok(false) => self.correcting = None,
            Err(error) => {
                self.put_off_correcting(&error);
                return false;
            }
        }
        self.correcting.is_some()
    }

    /// Handles a failed step. It reads and writes when no commit does, so its failure is unrelated to commits: the
    /// correction of an old capture must neither delay the running one nor end the process. The next commit detects by
    /// itself what concerns both.
    fn put_off_correcting(&mut self, error: &StoreError) {
        tracing::warn!(message = "Civil times could not be corrected; it is tried again.", %error);
        self.correcting = Some(Instant::now() + CORRECT_AGAIN);
        if error.is_damage() {
            self.fail(Failure::of(error));
            return;
        }
        if error.connection_is_sound() {
            return;
        }
        self.correction_failures += 1;
        if self.correction_failures >= CORRECTION_FAILURES {
            tracing::warn!("The times that are left are corrected at the next start.");
            self.correcting = None;
        }
        if concerns_storage(error) && !only_reading_failed(error) {
            self.close_after(error.storage_state());
        }
    }

    /// Records that the batch is acknowledged: the next one gets the next number.
    fn remember_commit(&mut self) {
        self.number += 1;
        // A mark that could not be written is merely out of date.
        let _ = self.remember();
    }

    fn write_batch(&mut self) -> Result<super::insert::Inserted, StoreError> {
        self.connection()?;
        let (number, in_doubt, utc_ns) = (self.number, self.in_doubt, self.parts.clock.utc_ns());
        let Some(connection) = self.connection.as_mut() else { return Err(StoreError::Closed) };
        let batch = self.lost.translated(&self.batch);
        let inserted = if in_doubt && last_batch(connection)? == number {
            tracing::warn!(message = "A batch whose commit had failed is there.", number);
            make_durable(connection, &self.parts.path)?;
            committed_of(connection, &batch)?
        } else {
            in_transaction(connection, Durability::AtCommit, |transaction| {
                let inserted = insert(transaction, &batch, utc_ns, number)?;
                run(transaction, "UPDATE writer SET batch = ?1", [number])?;
                Ok(inserted)
            })?
        };
        Ok(self.lost.named(inserted))
    }

    fn answer_flushes(&mut self, written: usize) {
        let idle = self.batch.is_empty() && self.parts.records.is_empty();
        for (remaining, _) in &mut self.flushes {
            *remaining = if idle { 0 } else { remaining.saturating_sub(written) };
        }
        let (done, waiting) = std::mem::take(&mut self.flushes).into_iter().partition(|(remaining, _)| *remaining == 0);
        self.flushes = waiting;
        let done: Vec<(usize, oneshot::Sender<()>)> = done;
        for (_, reply) in done {
            // The caller may have stopped waiting.
            let _ = reply.send(());
        }
    }

    /// Measures sizes and rates, once a second.
    fn measure(&mut self) {
        let now = Instant::now();
        let seconds = (now - self.measured_at).as_secs_f64();
        self.measured_at = now;
        let passed = seconds * self.parts.clock.speed();
        let rate = if passed > 0.0 { self.samples_since as f64 / passed } else { 0.0 };
        self.samples_since = 0;
        let weight = (seconds / 30.0).min(1.0);
        let bytes = |path: &std::path::Path| std::fs::metadata(path).map_or(0, |file| file.len());
        let (database, wal) = (bytes(&self.parts.path), bytes(&wal_path(&self.parts.path)));
        let free = lock::free_bytes(&self.parts.path);
        let mut progress = locked(&self.parts.progress);
        progress.figures.samples_per_s += weight * (rate - progress.figures.samples_per_s);
        progress.database_bytes = database;
        progress.wal_bytes = wal;
        if let Ok(free) = free {
            progress.free_bytes = free;
        }
        let warning = progress.warning(self.parts.wal_alarm_bytes);
        let had = std::mem::replace(&mut self.warned, warning.is_some());
        match warning {
            Some(warning) if !had => tracing::warn!("{warning}"),
            None if had => tracing::info!("the database has room again"),
            _ => {}
        }
        drop(progress);
        let swollen = self.retry_at.is_none() && wal > self.parts.wal_alarm_bytes;
        if let Some(connection) = self.connection.as_ref().filter(|_| swollen)
            && let Err(error) = schema::shrink_log(connection)
        {
            tracing::debug!(message = "The log cannot be emptied yet.", %error);
        }
    }

    /// Writes the rest, copies the log into the file and closes it.
    pub(super) fn stop(&mut self) -> Result<(), StoreError> {
        self.parts.records.close();
        if self.damage.is_some() {
            return self.stop_damaged();
        }
        let patience = Instant::now() + STOP_PATIENCE;
        loop {
            // A batch in doubt stays as it was passed on: its number stands for exactly these records.
            while !self.in_doubt && self.batch.len() < COMMIT_RECORDS {
                match self.parts.records.try_recv() {
                    Ok(record) => self.batch.push(record),
                    Err(_) => break,
                }
            }
            if self.batch.is_empty() {
                break;
            }
            self.commit();
            if self.damage.is_some() {
                return self.stop_damaged();
            }
            let error = locked(&self.parts.progress).error.clone();
            if let Some(reason) = error {
                if Instant::now() >= patience {
                    let records = self.batch.len() + self.parts.records.len();
                    return Err(StoreError::Unwritten { records, reason });
                }
                std::thread::sleep(self.retry_after.min(RETRY.1));
            }
        }
        self.answer_flushes(0);
        let until = Instant::now() + STOP_CORRECTING;
        let mut correcting = self.correcting.is_some() && self.retry_at.is_none() && self.damage.is_none();
        while correcting && Instant::now() < until {
            correcting = self.correct_times();
        }
        if self.damage.is_some() {
            return self.stop_damaged();
        }
        match self.connection().and_then(|connection| copy_log(connection)) {
            Ok(()) => {}
            Err(error) if error.is_damage() => {
                self.fail(Failure::of(&error));
                if self.damage.is_some() {
                    return self.stop_damaged();
                }
            }
            // A reader in another process may keep the log from being emptied; the next start does it then.
            Err(error) => tracing::warn!(message = "The write-ahead log stays until the next start.", %error),
        }
        if let Some(connection) = self.connection.take() {
            connection.close().map_err(|(_, error)| StoreError::Sqlite(error))?;
        }
        Ok(())
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        FileId::forget(&self.parts.path);
    }
}
