//! Damage that is met while the database is in use: by a commit, a command, a purge, a job.
//!
//! No second try mends it, and whatever is written may make it worse. So the first that is met ends the writing: it is
//! remembered beside the database ([`super::lock::WriterLock::mark_damaged`]), the connection is given up without copying
//! the log, and every command is answered with one sentence that says what to run. The next start refuses the file with the
//! same sentence, also where its check of two seconds does not come to the damaged place.

use super::{StoreError, lock, schema};
use std::io::Read as _;
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

    /// The disk's error where what was met is no more than pages that cannot be read: SQLite calls these corrupt
    /// (`SQLITE_IOERR_CORRUPTFS` becomes `SQLITE_CORRUPT`), but a disk that was pulled out comes back whole.
    pub(super) fn is_of_the_disk(&self, path: &Path) -> Option<std::io::Error> {
        match self {
            Self::Met(_) => [path.to_owned(), schema::wal_path(path)].iter().find_map(|path| read_whole(path).err()),
            Self::Refused(_) | Self::LogMissing(_) => None,
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

/// A file that is not there has nothing that cannot be read.
fn read_whole(path: &Path) -> std::io::Result<()> {
    let mut file = match std::fs::File::open(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        opened => opened?,
    };
    let mut buffer = vec![0; 1 << 20];
    while file.read(&mut buffer)? > 0 {}
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_read_is_the_disks_fault_and_what_can_is_damage() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vn100d.db");
        std::fs::write(&path, vec![1; 3 << 20]).unwrap();
        let met = Damage::Met("database disk image is malformed".to_owned());
        assert!(met.is_of_the_disk(&path).is_none());
        // A directory is what every read of fails here.
        std::fs::create_dir(schema::wal_path(&path)).unwrap();
        assert!(met.is_of_the_disk(&path).is_some());
        assert!(Damage::LogMissing(1).is_of_the_disk(&path).is_none());
    }
}
