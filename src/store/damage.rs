//! Damage that is found while the database is in use: by a commit, a command, a purge or a job.
//!
//! Trying again does not repair damage, and further writes may make it worse. So the first damage ends the writing: it
//! is recorded beside the database ([`super::lock::WriterLock::mark_damaged`]), and the connection is closed without
//! copying the log. Every later command fails with one error that names the command to run. The next start refuses the
//! file with the same error, even if its check of two seconds does not reach the damaged place. `error.rs` turns damage into
//! an error and back.

use super::paths::lock_path;
use std::path::Path;

/// The reason why nothing is written any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Damage {
    /// SQLite, or the check after an error, reported damage in the open file, now or in an earlier run.
    Met(String),
    /// The check before the file is opened for writing reported damage.
    Refused(String),
    /// This many committed batches are missing: the log was removed, or an older file was put in its place.
    LogMissing(i64),
}

impl Damage {
    /// Describes the damage of the database at `path`, and what to do about it.
    pub(super) fn message(&self, path: &Path) -> String {
        let (path, lock) = (path.display(), lock_path(path));
        let lock = lock.display();
        match self {
            Self::Met(report) => format!(
                "{path} is damaged ({report}, met while it was in use): nothing more is written to it; `vn100d check \
                 {path}` says what is wrong, `vn100d recover {path} --out FILE` salvages what is intact: put that file \
                 in its place (if the check finds nothing, remove {lock} to go on)"
            ),
            Self::Refused(report) => format!(
                "{path} is damaged ({report}): nothing is written to it; salvage what is intact with `vn100d recover \
                 {path} --out FILE` and put that file in its place"
            ),
            Self::LogMissing(lost) => format!(
                "{path} lacks {lost} batches that were committed: its log `-wal` was taken away, or an older copy was \
                 put in its place; put the right files back, or salvage it with `vn100d recover`, or remove {lock} to \
                 go on with what is there"
            ),
        }
    }
}
