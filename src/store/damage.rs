//! Damage that is met while the database is in use: by a commit, a command, a purge, a job.
//!
//! No second try mends it, and whatever is written may make it worse. So the first that is met ends the writing: it is
//! remembered beside the database ([`super::lock::WriterLock::mark_damaged`]), the connection is given up without copying
//! the log, and every command is answered with one sentence that says what to run. The next start refuses the file with the
//! same sentence, also where its check of two seconds does not come to the damaged place.

use super::{StoreError, lock};
use std::path::Path;

/// Why nothing is written any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Damage {
    /// SQLite, or the check after an error, said so of the file that is in use.
    Met(String),
    /// A file that took a lost one's place is damaged.
    Refused(String),
    /// So many committed batches are gone: the log was taken away.
    LogMissing(i64),
}

impl Damage {
    /// None where the error is of another sort.
    pub(super) fn of(error: &StoreError) -> Option<Self> {
        match error {
            StoreError::RefusedDamaged { report, .. } => Some(Self::Refused(report.clone())),
            StoreError::LogMissing { lost, .. } => Some(Self::LogMissing(*lost)),
            StoreError::Damaged { report } | StoreError::MetDamage { report, .. } => Some(Self::Met(report.clone())),
            error if error.is_damage() => Some(Self::Met(error.to_string())),
            _ => None,
        }
    }

    /// What whoever asks is told from now on.
    pub(super) fn error(&self, path: &Path) -> StoreError {
        let path = path.to_owned();
        match self {
            Self::Met(report) => StoreError::MetDamage { lock: lock::lock_path(&path), path, report: report.clone() },
            Self::Refused(report) => StoreError::RefusedDamaged { path, report: report.clone() },
            Self::LogMissing(lost) => StoreError::LogMissing { lock: lock::lock_path(&path), path, lost: *lost },
        }
    }
}
