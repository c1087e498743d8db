//! The errors of the store. Their kinds, not their texts, decide exit codes and HTTP status codes elsewhere.

use super::damage::Damage;
use crate::observe::StorageState;
use rusqlite::ErrorCode;
use std::path::{Path, PathBuf};

/// Everything that can go wrong with the database.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another process writes this database.
    #[error("database {path} is in use by process {pid}: stop that process or choose another data directory")]
    Locked {
        /// The database.
        path: PathBuf,
        /// The process that holds the lock, as recorded in the lock file.
        pid: String,
    },
    /// A directory or file could not be made.
    #[error("cannot create {path}: {source}; see that its directory exists, has room and may be written to")]
    Create {
        /// The path that could not be created.
        path: PathBuf,
        /// The error that the system reported.
        source: std::io::Error,
    },
    /// A file could not be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The error that the system reported.
        source: std::io::Error,
    },
    /// A file is in the way.
    #[error("{0} exists already: choose another name, or say --force to replace it")]
    Exists(PathBuf),
    /// A file that must not be replaced.
    #[error("{0} is the database itself or has a log beside it (-wal): name another file; nothing was replaced")]
    InUse(PathBuf),
    /// There is no database to read.
    #[error("there is no database at {0}: capture or import something first, or name its directory with --data-dir")]
    NoDatabase(PathBuf),
    /// The user may not read the database.
    #[error(
        "this user may not read {0}: run the command as its owner (`sudo -u vn100d vn100d …` for that of the package), or \
         let its owner allow it (`chmod o+r`, and `o+x` for its directory)"
    )]
    NotReadable(PathBuf),
    /// The file system does not keep SQLite's promises.
    #[error(
        "{path} lies on a {kind} file system, on which SQLite cannot keep data safe: choose a directory on a local disk"
    )]
    NetworkFileSystem {
        /// The database.
        path: PathBuf,
        /// The kind of file system.
        kind: &'static str,
    },
    /// The file is something else.
    #[error(
        "{path} is not a vn100d database (application id {found:#010x}, expected {expected:#010x}): it was left \
         untouched, choose another data directory (or, if it was one and is damaged, salvage it with `vn100d recover`)"
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Its application id; 0 for a file that is no SQLite database or has none.
        found: i32,
        /// The application id of this program.
        expected: i32,
    },
    /// A newer program made the database.
    #[error("{path} has schema version {found}, this vn100d knows versions up to {supported}: use a newer vn100d")]
    NewerSchema {
        /// The database.
        path: PathBuf,
        /// Its version.
        found: i64,
        /// The newest version that this program knows.
        supported: i64,
    },
    /// An older program made the database and it is open for reading only.
    #[error(
        "{path} has schema version {found}, this vn100d reads version {expected}: start `vn100d run` once to bring it up to date"
    )]
    OlderSchema {
        /// The database.
        path: PathBuf,
        /// Its version.
        found: i64,
        /// The version this program reads.
        expected: i64,
    },
    /// The SQLite in this program has a bug that can damage a WAL database.
    #[error("SQLite {found} can damage a database in WAL mode: need {needed} or newer")]
    SqliteTooOld {
        /// Its version.
        found: &'static str,
        /// The first version without the bug.
        needed: &'static str,
    },
    /// The schema could not be brought up to date.
    #[error("the schema could not be brought up to date: {0}")]
    Migration(#[from] rusqlite_migration::Error),
    /// The database is damaged.
    #[error("the database is damaged ({0}): salvage what is intact with `vn100d recover`")]
    Damaged(String),
    /// The database at this path is damaged: nothing is written to it.
    #[error("{}", .1.message(.0))]
    DamagedFile(PathBuf, Damage),
    /// The disk currently refuses writes.
    #[error("the database takes nothing for now: {0}")]
    Refusing(String),
    /// The file at the database's path is no longer the open one.
    #[error("the database {path} was deleted or replaced: {detail}")]
    Lost {
        /// The database.
        path: PathBuf,
        /// The action that is taken.
        detail: &'static str,
    },
    /// SQLite refused.
    #[error("database: {0}")]
    Sqlite(#[from] rusqlite::Error),
    /// Stored JSON could not be read, or a value not be written as JSON.
    #[error("JSON in the database: {0}")]
    Json(#[from] serde_json::Error),
    /// Stored text is none of the values that this program knows.
    #[error("column {column} holds `{found}`, which this program does not know")]
    Unknown {
        /// The column that holds it.
        column: &'static str,
        /// The stored text.
        found: String,
    },
    /// No capture has that id or name.
    #[error("there is no capture `{0}`: `vn100d captures` lists them")]
    NoSuchCapture(String),
    /// No job has that id.
    #[error("there is no job {0}")]
    NoSuchJob(i64),
    /// No complete reference has this digest.
    #[error("the reference {0} is not in the database any more: send the diagnosis with its reference again")]
    NoSuchReference(String),
    /// No sensor model has that id.
    #[error("there is no sensor model `{0}`: GET /v1/models lists them")]
    NoSuchModel(String),
    /// The maximum number of sensor models is stored.
    #[error("there are {0} sensor models, as many as are kept: delete one first (DELETE /v1/models/model-…)")]
    TooManyModels(u64),
    /// No diagnosis has that id.
    #[error("there is no diagnosis `{0}`: GET /v1/diagnoses lists them")]
    NoSuchDiagnosis(String),
    /// The name is taken.
    #[error("a capture named `{0}` exists already: choose another name")]
    NameTaken(String),
    /// The name is invalid.
    #[error("`{name}` cannot name a capture: {why}")]
    NameRefused {
        /// The name.
        name: String,
        /// The reason.
        why: &'static str,
    },
    /// The note is invalid.
    #[error("that cannot be a note: {0}")]
    NoteRefused(&'static str),
    /// The capture cannot be deleted.
    #[error("capture {id} is {why}: it is not deleted")]
    NotDeletable {
        /// The capture.
        id: i64,
        /// `running`, `waiting` or `pinned`.
        why: &'static str,
    },
    /// The job has ended already.
    #[error("job {id} is {state}: nothing to cancel")]
    JobEnded {
        /// The job.
        id: i64,
        /// How it ended.
        state: &'static str,
    },
    /// Too many jobs wait already.
    #[error("{0} jobs wait already: submit again once some are done (`vn100d jobs` lists them)")]
    QueueFull(u64),
    /// A cursor that this program did not issue.
    #[error("`{0}` is not a cursor of this list: take the one that the previous page gave as `next`")]
    BadCursor(String),
    /// The writer thread has ended.
    #[error("the store is closed")]
    Closed,
    /// Some records could not be written when the store was closed.
    #[error("{records} records could not be written before the end: {reason}")]
    Unwritten {
        /// The number of records.
        records: usize,
        /// The last error.
        reason: String,
    },
    /// The writer thread could not be started.
    #[error("the writer thread could not be started: {0}")]
    Thread(std::io::Error),
}

/// How a caller handles an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StoreErrorKind {
    /// The database cannot be created or is locked: exit code 73.
    CannotCreate,
    /// A database of a newer schema: exit code 78.
    NewerSchema,
    /// Input or output failed: exit code 74.
    Io,
    /// The requested object does not exist: exit code 1, HTTP 404.
    NotFound,
    /// The request contradicts the present state: exit code 1, HTTP 409.
    Conflict,
    /// The request is invalid: exit code 2, HTTP 400.
    Invalid,
    /// The database is temporarily busy or full: HTTP 503.
    Unavailable,
    /// A fault in this program: exit code 1, HTTP 500.
    Internal,
}

/// Returns whether this is EIO or ENOSPC, the errors that may pass by themselves.
fn failed_disk(error: &std::io::Error) -> bool {
    use rustix::io::Errno;
    Errno::from_io_error(error).is_some_and(|errno| errno == Errno::IO || errno == Errno::NOSPC)
}

impl StoreError {
    /// Returns the kind of this error.
    pub fn kind(&self) -> StoreErrorKind {
        match self {
            // A failing disk is not a problem of names and permissions.
            Self::Create { source, .. } if failed_disk(source) => StoreErrorKind::Io,
            Self::Locked { .. }
            | Self::Create { .. }
            | Self::Exists(_)
            | Self::InUse(_)
            | Self::NetworkFileSystem { .. }
            | Self::Foreign { .. } => StoreErrorKind::CannotCreate,
            Self::NewerSchema { .. } | Self::OlderSchema { .. } => StoreErrorKind::NewerSchema,
            Self::Read { .. }
            | Self::NotReadable(_)
            | Self::Damaged(_)
            | Self::DamagedFile(..)
            | Self::Thread(_)
            | Self::Unwritten { .. } => StoreErrorKind::Io,
            Self::NoDatabase(_)
            | Self::NoSuchCapture(_)
            | Self::NoSuchJob(_)
            | Self::NoSuchModel(_)
            | Self::NoSuchDiagnosis(_) => StoreErrorKind::NotFound,
            Self::NameTaken(_) | Self::NotDeletable { .. } | Self::JobEnded { .. } | Self::TooManyModels(_) => {
                StoreErrorKind::Conflict
            }
            Self::NameRefused { .. } | Self::NoteRefused(_) | Self::BadCursor(_) => StoreErrorKind::Invalid,
            Self::Closed | Self::NoSuchReference(_) | Self::QueueFull(_) | Self::Refusing(_) | Self::Lost { .. } => {
                StoreErrorKind::Unavailable
            }
            Self::Sqlite(error) => kind_of(error),
            Self::Migration(rusqlite_migration::Error::RusqliteError { err, .. }) => kind_of(err),
            Self::SqliteTooOld { .. } | Self::Migration(_) | Self::Json(_) | Self::Unknown { .. } => {
                StoreErrorKind::Internal
            }
        }
    }

    /// Returns the state that the store is in after this error.
    pub fn storage_state(&self) -> StorageState {
        match self {
            Self::Sqlite(error) => match error.sqlite_error_code() {
                Some(ErrorCode::DiskFull) => StorageState::StorageFull,
                Some(ErrorCode::ReadOnly) => StorageState::StorageReadonly,
                Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => StorageState::StorageLocked,
                _ => StorageState::StorageError,
            },
            Self::Lost { .. } => StorageState::StorageLost,
            _ => StorageState::StorageError,
        }
    }

    /// Returns whether the file differs from its committed content. A disk that recovers does not repair that.
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Sqlite(error) => {
                matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase))
            }
            Self::Damaged(_) | Self::DamagedFile(..) => true,
            _ => false,
        }
    }

    /// Returns SQLite's extended code, if the error came from SQLite. The code and the message can be passed to another
    /// process.
    pub(crate) fn sqlite_code(&self) -> Option<i32> {
        match self {
            Self::Sqlite(rusqlite::Error::SqliteFailure(code, _)) => Some(code.extended_code),
            _ => None,
        }
    }

    /// Restores the error from an extended code of SQLite and its message.
    pub(crate) fn of_code(code: i32, message: String) -> Self {
        Self::Sqlite(rusqlite::Error::SqliteFailure(rusqlite::ffi::Error::new(code), Some(message)))
    }

    /// Returns whether the connection can still be used: the transaction was rolled back and its outcome is certain.
    pub(super) fn connection_is_sound(&self) -> bool {
        matches!(self.storage_state(), StorageState::StorageFull | StorageState::StorageLocked)
    }

    /// Returns whether a long query was interrupted by its own caller.
    pub fn is_interrupted(&self) -> bool {
        matches!(self, Self::Sqlite(error) if error.sqlite_error_code() == Some(ErrorCode::OperationInterrupted))
    }
}

impl Damage {
    /// Returns the damage that the error indicates; `None` if it indicates none.
    pub(super) fn of(error: &StoreError) -> Option<Self> {
        match error {
            StoreError::DamagedFile(_, damage) => Some(damage.clone()),
            StoreError::Damaged(report) => Some(Self::Met(report.clone())),
            error if error.is_damage() => Some(Self::Met(error.to_string())),
            _ => None,
        }
    }

    /// Returns the error that every call returns from now on.
    pub(super) fn error(&self, path: &Path) -> StoreError {
        StoreError::DamagedFile(path.to_owned(), self.clone())
    }
}

/// Returns whether the error reports that the file is damaged.
pub(super) fn reports_damage(error: &rusqlite::Error) -> bool {
    use rusqlite::ErrorCode as Code;
    matches!(error.sqlite_error_code(), Some(Code::DatabaseCorrupt | Code::NotADatabase))
        || matches!(error, rusqlite::Error::InvalidColumnType(..) | rusqlite::Error::FromSqlConversionFailure(..))
}

/// Returns the error that no capture has this id.
pub(super) fn no_such(id: i64) -> StoreError {
    StoreError::NoSuchCapture(id.to_string())
}

/// Fails if a statement about this capture changed no row.
pub(super) fn changed_one(id: i64, rows: usize) -> Result<(), StoreError> {
    if rows == 0 { Err(no_such(id)) } else { Ok(()) }
}

fn kind_of(error: &rusqlite::Error) -> StoreErrorKind {
    match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked | ErrorCode::DiskFull) => StoreErrorKind::Unavailable,
        Some(ErrorCode::CannotOpen) => StoreErrorKind::CannotCreate,
        Some(
            ErrorCode::SystemIoFailure
            | ErrorCode::ReadOnly
            | ErrorCode::DatabaseCorrupt
            | ErrorCode::NotADatabase
            | ErrorCode::PermissionDenied,
        ) => StoreErrorKind::Io,
        _ => StoreErrorKind::Internal,
    }
}
