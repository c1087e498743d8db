//! Failures of the writer: determines from an error the state of the disk or the file, and reacts. The writer waits and
//! tries again, closes the connection that is in doubt, or ends the writing of a damaged database.

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
/// The delays after an I/O error: the third error ends the process, so that a disk which recovers has some seconds.
const RETRY_IO: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(5));
/// Less free space than this explains an error that does not name its cause.
const NO_SPACE_BYTES: u64 = 1 << 20;

/// A storage error without its typed source.
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

/// Returns whether the error concerns the disk rather than the request.
pub(in crate::store) fn concerns_storage(error: &StoreError) -> bool {
    use rusqlite::ErrorCode as Code;
    matches!(error, StoreError::Sqlite(error) if matches!(
        error.sqlite_error_code(),
        Some(Code::DiskFull | Code::ReadOnly | Code::DatabaseBusy | Code::DatabaseLocked | Code::SystemIoFailure
            | Code::DatabaseCorrupt | Code::CannotOpen | Code::NotADatabase | Code::PermissionDenied)
    )) || matches!(error, StoreError::Lost { .. })
        || error.is_damage()
}

/// Returns whether the disk only failed to read: nothing was written, and earlier writes are not in doubt. In the
/// middle of a statement SQLite instead reports a read's EIO as a damaged database.
pub(super) fn only_reading_failed(error: &StoreError) -> bool {
    use rusqlite::ffi::{SQLITE_IOERR_CORRUPTFS, SQLITE_IOERR_READ, SQLITE_IOERR_SHORT_READ};
    const READING: [i32; 3] = [SQLITE_IOERR_READ, SQLITE_IOERR_SHORT_READ, SQLITE_IOERR_CORRUPTFS];
    matches!(error, StoreError::Sqlite(rusqlite::Error::SqliteFailure(code, _)) if READING.contains(&code.extended_code))
}

impl Writer {
    /// Handles damage that a reader found. This also counts while the disk refuses writes, but not for a file that is
    /// gone.
    pub(in crate::store) fn take_report(&mut self, failure: Failure) {
        if self.damage.is_none() && !self.file.is_lost(&self.parts.path) {
            self.fail(failure);
        }
    }

    pub(super) fn recovered(&mut self) {
        self.retry_at = None;
        self.retry_after = Duration::ZERO;
        let mut progress = locked(&self.parts.progress);
        if !matches!(progress.state, StorageState::Ok | StorageState::Slow) {
            tracing::info!(message = "The database takes data again.");
        }
        progress.state = StorageState::Ok;
        progress.error = None;
    }

    pub(super) fn fail(&mut self, mut failure: Failure) {
        if !failure.sound {
            if self.connection.is_some() && self.file.is_lost(&self.parts.path) {
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
        let mut progress = locked(&self.parts.progress);
        if progress.error.as_ref() != Some(&failure.text) {
            tracing::error!(message = "The database does not take data; it is kept in memory.", error = failure.text);
        }
        progress.figures.failures += 1;
        progress.figures.busy += u64::from(failure.state == StorageState::StorageLocked);
        if failure.state == StorageState::StorageError {
            progress.io_failures_mono_ns.push(SystemClock.mono_ns());
            if progress.io_failures_mono_ns.len() > IO_FAILURES {
                progress.io_failures_mono_ns.remove(0);
            }
        }
        progress.state = failure.state;
        progress.error = Some(failure.text);
    }

    /// Closes the connection after an error that leaves it in doubt; its next user opens and checks the file.
    pub(super) fn close_after(&mut self, state: StorageState) {
        if let Some(connection) = self.connection.take() {
            // If the file is replaced before it is reopened, the captures continue in the replacement.
            self.lost.note(&connection);
            self.file.close(&self.parts.path, connection);
        }
        self.suspect |= state == StorageState::StorageError;
    }

    /// Records damage for the next start. SQLite also reports a page that cannot be read as corrupt
    /// (`SQLITE_IOERR_CORRUPTFS` becomes `SQLITE_CORRUPT`). If not even the mark can be written, the disk has gone, and
    /// it may come back intact.
    fn mark_damaged(&self, damage: &Damage) -> std::io::Result<()> {
        match damage {
            Damage::Met(report) => self.parts.lock.mark_damaged(&self.identity, report),
            Damage::Refused(_) | Damage::LogMissing(_) => Ok(()),
        }
    }

    /// Ends the writing of a damaged database, by this process and the next.
    fn give_up(&mut self, damage: Damage) {
        if let Some(connection) = self.connection.take() {
            // Closing would copy the log into the file. Both stay as they are for a later recovery.
            if let Err(error) = schema::keep_log(&connection, true) {
                tracing::warn!(message = "The log may be copied into the damaged file.", %error);
            }
        }
        let error = damage.error(&self.parts.path);
        tracing::error!("{error}");
        (self.retry_at, self.due) = (None, None);
        self.damage = Some(damage);
        let mut progress = locked(&self.parts.progress);
        progress.figures.failures += 1;
        progress.state = StorageState::StorageError;
        progress.error = Some(error.to_string());
        progress.damaged = true;
    }

    /// Determines the cause of an I/O error with a small write beside the database.
    fn cause(&self) -> StorageState {
        let full = || lock::free_bytes(&self.parts.path).is_ok_and(|free| free < NO_SPACE_BYTES);
        match self.remember().map(|error| error.kind()) {
            Some(std::io::ErrorKind::ReadOnlyFilesystem) => StorageState::StorageReadonly,
            Some(std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded) => StorageState::StorageFull,
            _ if full() => StorageState::StorageFull,
            _ => StorageState::StorageError,
        }
    }

    /// Ends the thread if the database is damaged; returns the damage.
    pub(super) fn stop_damaged(&mut self) -> Result<(), StoreError> {
        let records = self.batch.len() + self.parts.records.len();
        if records > 0 {
            tracing::error!(message = "What was not committed is not written to a damaged file.", records);
        }
        Err(self.damage.as_ref().map_or(StoreError::Closed, |damage| damage.error(&self.parts.path)))
    }
}
