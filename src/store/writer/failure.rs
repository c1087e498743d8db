//! Failures of the writer: what an error says of the disk or the file, and what the writer does about it: it waits and tries
//! again, closes the connection that is in doubt, or ends the writing of a damaged database.

use super::super::damage::Damage;
use super::super::progress::{IO_FAILURES, locked};
use super::super::{StoreError, lock, schema};
use super::Writer;
use crate::clock::{Clock as _, SystemClock};
use crate::observe::StorageState;
use std::time::Duration;
use tokio::time::Instant;

/// First and longest delay before a failed commit is tried again.
pub(super) const RETRY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(1));
/// The same after an I/O error: with the third the process ends, so that a disk which recovers has some seconds.
const RETRY_IO: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(5));
/// Less free space than this explains an error that does not name its cause.
const NO_SPACE_BYTES: u64 = 1 << 20;

/// A storage error, apart from its typed origin.
#[derive(Debug, Clone)]
pub(in crate::store) struct Failure {
    pub(in crate::store) state: StorageState,
    text: String,
    sound: bool,
    damage: Option<Damage>,
}

impl Failure {
    pub(in crate::store) fn of(error: &StoreError) -> Self {
        let text = match error {
            StoreError::Sqlite(rusqlite::Error::SqliteFailure(code, _)) => {
                format!("{error} (SQLite {})", code.extended_code)
            }
            other => other.to_string(),
        };
        let damage = Damage::of(error);
        Self { state: error.storage_state(), text, sound: error.connection_is_sound(), damage }
    }
}

/// Whether the error says something about the disk rather than about what was asked.
pub(in crate::store) fn concerns_storage(error: &StoreError) -> bool {
    use rusqlite::ErrorCode as Code;
    matches!(error, StoreError::Sqlite(error) if matches!(
        error.sqlite_error_code(),
        Some(Code::DiskFull | Code::ReadOnly | Code::DatabaseBusy | Code::DatabaseLocked | Code::SystemIoFailure
            | Code::DatabaseCorrupt | Code::CannotOpen | Code::NotADatabase | Code::PermissionDenied)
    )) || matches!(error, StoreError::Lost { .. })
        || error.is_damage()
}

/// Whether the disk only failed to give what was asked: nothing was written, and what was is in no doubt. In the middle of
/// a statement SQLite says of a read's EIO that the database is damaged instead.
pub(super) fn only_reading_failed(error: &StoreError) -> bool {
    use rusqlite::ffi::{SQLITE_IOERR_CORRUPTFS, SQLITE_IOERR_READ, SQLITE_IOERR_SHORT_READ};
    const READING: [i32; 3] = [SQLITE_IOERR_READ, SQLITE_IOERR_SHORT_READ, SQLITE_IOERR_CORRUPTFS];
    matches!(error, StoreError::Sqlite(rusqlite::Error::SqliteFailure(code, _)) if READING.contains(&code.extended_code))
}

impl Writer {
    /// A reader met damage: that counts also while the disk refuses, but not of a file that is gone.
    pub(in crate::store) fn take_report(&mut self, failure: Failure) {
        if self.damage.is_none() && !self.file.is_lost(&self.path) {
            self.fail(failure);
        }
    }

    pub(super) fn recovered(&mut self) {
        self.retry_at = None;
        self.retry_after = Duration::ZERO;
        let mut progress = locked(&self.progress);
        if !matches!(progress.state, StorageState::Ok | StorageState::Slow) {
            tracing::info!(message = "The database takes data again.");
        }
        progress.state = StorageState::Ok;
        progress.error = None;
    }

    pub(super) fn fail(&mut self, mut failure: Failure) {
        if !failure.sound {
            if self.connection.is_some() && self.file.is_lost(&self.path) {
                self.check_file();
                return;
            }
            if let Some(damage) = failure.damage {
                let Err(error) = self.mark_damaged(&damage) else {
                    self.give_up(damage);
                    return;
                };
                failure.state = StorageState::StorageError;
                failure.text = format!("{}, and the disk takes no mark of that: {error}", failure.text);
            }
            self.close_after(failure.state);
        }
        if failure.state == StorageState::StorageError {
            failure.state = self.cause();
        }
        let retry = if failure.state == StorageState::StorageError { RETRY_IO } else { RETRY };
        self.retry_after = self.retry_after.clamp(retry.0, retry.1);
        if failure.state == StorageState::StorageLost {
            // Long enough to be seen.
            self.retry_after = RETRY.1;
        }
        self.retry_at = Some(Instant::now() + self.retry_after);
        self.retry_after = match failure.state {
            StorageState::StorageError => RETRY_IO.1,
            _ => (self.retry_after * 2).min(RETRY.1),
        };
        let mut progress = locked(&self.progress);
        if progress.error.as_ref() != Some(&failure.text) {
            tracing::error!(message = "The database does not take data; it is kept in memory.", error = failure.text);
        }
        progress.failures += 1;
        progress.busy += u64::from(failure.state == StorageState::StorageLocked);
        if failure.state == StorageState::StorageError {
            progress.io_failures_mono_ns.push(SystemClock.mono_ns());
            if progress.io_failures_mono_ns.len() > IO_FAILURES {
                progress.io_failures_mono_ns.remove(0);
            }
        }
        progress.state = failure.state;
        progress.error = Some(failure.text);
    }

    /// Closes the connection after an error that leaves it in doubt: the next one who needs it opens and checks the file.
    pub(super) fn close_after(&mut self, state: StorageState) {
        if let Some(connection) = self.connection.take() {
            // Should the file be replaced before it is opened again, they go on in the other one.
            self.lost.note(&connection);
            self.file.close(&self.path, connection);
        }
        self.suspect |= state == StorageState::StorageError;
    }

    /// Remembers damage for the next start. SQLite calls a page that cannot be read corrupt too (`SQLITE_IOERR_CORRUPTFS`
    /// becomes `SQLITE_CORRUPT`): where not even the mark can be written it is the disk that has gone, and it may come back
    /// whole.
    fn mark_damaged(&self, damage: &Damage) -> std::io::Result<()> {
        match damage {
            Damage::Met(report) => self.lock.mark_damaged(&self.identity, report),
            Damage::Refused(_) | Damage::LogMissing(_) => Ok(()),
        }
    }

    /// The database is damaged: from now on nothing is written to it, by this process or the next.
    fn give_up(&mut self, damage: Damage) {
        if let Some(connection) = self.connection.take() {
            // Closing would copy the log into the file: both stay as they are, for whoever salvages them.
            if let Err(error) = schema::keep_log(&connection, true) {
                tracing::warn!(message = "The log may be copied into the damaged file.", %error);
            }
        }
        let error = damage.error(&self.path);
        tracing::error!("{error}");
        (self.retry_at, self.due) = (None, None);
        self.damage = Some(damage);
        let mut progress = locked(&self.progress);
        progress.failures += 1;
        progress.state = StorageState::StorageError;
        progress.error = Some(error.to_string());
        progress.damaged = true;
    }

    /// What an I/O error comes from, as the system says it of a small write beside the database.
    fn cause(&self) -> StorageState {
        let full = || lock::free_bytes(&self.path).is_ok_and(|free| free < NO_SPACE_BYTES);
        match self.remember().map(|error| error.kind()) {
            Some(std::io::ErrorKind::ReadOnlyFilesystem) => StorageState::StorageReadonly,
            Some(std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded) => StorageState::StorageFull,
            _ if full() => StorageState::StorageFull,
            _ => StorageState::StorageError,
        }
    }

    /// How the thread ends where the database is damaged.
    pub(super) fn stop_damaged(&mut self) -> Result<(), StoreError> {
        let records = self.batch.len() + self.records.len();
        if records > 0 {
            tracing::error!(message = "What was not committed is not written to a damaged file.", records);
        }
        Err(self.damage.as_ref().map_or(StoreError::Closed, |damage| damage.error(&self.path)))
    }
}
