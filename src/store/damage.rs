//! Damage that is found while the database is in use: by a commit, a command, a purge or a job.
//!
//! Trying again does not repair damage, and further writes may make it worse. So the first damage ends the writing: it
//! is recorded beside the database ([`super::lock::WriterLock::mark_damaged`]), and the connection is closed without
//! copying the log. Every later command fails with one error that names the command to run. The next start refuses the
//! file with the same error, even if its check of two seconds does not reach the damaged place.

use super::{StoreError, lock};
use std::path::Path;

/// The reason why nothing is written any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Damage {
    /// SQLite, or the check after an error, reported damage in the open file.
    Met(String),
    /// A file that replaced a lost one is damaged.
    Refused(String),
    /// This many committed batches are missing: the log was removed.
    LogMissing(i64),
}

impl Damage {
    /// Returns the damage that the error indicates; `None` if it indicates none.
    pub(super) fn of(error: &StoreError) -> Option<Self> {
        match error {
            StoreError::RefusedDamaged { report, .. } => Some(Self::Refused(report.clone())),
            StoreError::LogMissing { lost, .. } => Some(Self::LogMissing(*lost)),
            StoreError::Damaged(report) | StoreError::MetDamage { report, .. } => Some(Self::Met(report.clone())),
            error if error.is_damage() => Some(Self::Met(error.to_string())),
            _ => None,
        }
    }

    /// Returns the error that every call returns from now on.
    pub(super) fn error(&self, path: &Path) -> StoreError {
        let path = path.to_owned();
        match self {
            Self::Met(report) => StoreError::MetDamage { lock: lock::lock_path(&path), path, report: report.clone() },
            Self::Refused(report) => StoreError::RefusedDamaged { path, report: report.clone() },
            Self::LogMissing(lost) => StoreError::LogMissing { lock: lock::lock_path(&path), path, lost: *lost },
        }
    }
}
