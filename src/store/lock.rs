//! The lock that lets only one process write a database, and the refusal of unsafe file systems.

use super::StoreError;
use super::paths::lock_path;
use rustix::fs::FlockOperation;
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Holds `<database>.lock` with this process's id in it. The kernel releases it when the process ends, in whatever way.
///
/// The second line records the last batch that was acknowledged ([`Mark`]). It is outside the database, so that the
/// removal of a log is noticed. A third line records damage, so that the next start knows of it whatever its check
/// finds.
#[derive(Debug)]
pub(super) struct WriterLock {
    pub(super) file: File,
    /// The mark that an earlier writer left.
    pub(super) previous: Option<Mark>,
}

/// The last batch that was acknowledged, the database it belongs to, and any damage that was found in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Mark {
    pub(super) identity: String,
    pub(super) batch: i64,
    pub(super) damage: Option<String>,
}

/// Bytes of the first line, so that the second can be written in its place.
const PID_WIDTH: usize = 20;
/// The offset of the third line: behind an identity of 32 characters and a number of 20.
const DAMAGE_AT: u64 = PID_WIDTH as u64 + 1 + 32 + 1 + 20 + 1;

impl WriterLock {
    /// Takes the lock at once, or fails.
    pub(super) fn take(database: &Path) -> Result<Self, StoreError> {
        let path = lock_path(database);
        let create = |source| StoreError::Create { path: path.clone(), source };
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path).map_err(create)?;
        let locked = rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive);
        let mut text = String::new();
        // A lock file torn by a power loss contains no usable information.
        let _ = file.read_to_string(&mut text);
        let mut lines = text.lines();
        let pid = lines.next().map(str::trim).filter(|pid| !pid.is_empty()).unwrap_or("(unknown)").to_owned();
        if let Err(error) = locked {
            if error != rustix::io::Errno::WOULDBLOCK {
                return Err(create(error.into()));
            }
            return Err(StoreError::Locked { path: database.to_owned(), pid });
        }
        let previous = lines.next().and_then(|second| Mark::read(second, lines.next()));
        let lock = Self { file, previous };
        let line = format!("{:<PID_WIDTH$}\n", std::process::id());
        lock.file.write_all_at(line.as_bytes(), 0).map_err(create)?;
        Ok(lock)
    }

    /// Records the last acknowledged batch. It is not synced: a mark that is older than the database does no harm.
    pub(super) fn mark(&self, identity: &str, batch: i64) -> std::io::Result<()> {
        let line = format!("{identity} {batch:020}\n");
        self.file.write_all_at(line.as_bytes(), PID_WIDTH as u64 + 1)
    }

    /// Records durably that this database is damaged, or fails.
    pub(super) fn mark_damaged(&self, identity: &str, report: &str) -> std::io::Result<()> {
        let line = format!("{identity} damaged: {}\n", report.replace('\n', "; "));
        let marked = self.file.write_all_at(line.as_bytes(), DAMAGE_AT).and_then(|()| self.file.sync_all());
        if marked.is_err() {
            let _ = self.file.set_len(DAMAGE_AT);
        }
        marked
    }
}

impl Mark {
    fn read(line: &str, damage: Option<&str>) -> Option<Self> {
        let (identity, batch) = line.split_once(' ')?;
        let whole = identity.len() == 32 && batch.len() == 20;
        // A damage report on a database that another one has replaced does not concern the replacement.
        let report = damage.and_then(|line| line.strip_prefix(identity)?.strip_prefix(" damaged: "));
        let damage = report.map(str::to_owned);
        Some(Self { identity: identity.to_owned(), batch: batch.parse().ok()?, damage }).filter(|_| whole)
    }
}

/// Fails if another process writes the database; changes nothing.
pub(super) fn refuse_writer(database: &Path) -> Result<(), StoreError> {
    let Ok(mut file) = File::open(lock_path(database)) else { return Ok(()) };
    match rustix::fs::flock(&file, FlockOperation::NonBlockingLockShared) {
        Err(rustix::io::Errno::WOULDBLOCK) => {
            let mut text = String::new();
            let _ = file.read_to_string(&mut text);
            let pid = text.lines().next().unwrap_or_default().trim().to_owned();
            Err(StoreError::Locked { path: database.to_owned(), pid })
        }
        _ => Ok(()),
    }
}

/// Refuses file systems whose locks or shared memory do not reach all processes (sqlite.org/howtocorrupt.html, 2.1).
pub(super) fn refuse_network_file_system(path: &Path) -> Result<(), StoreError> {
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let statistics = rustix::fs::statfs(directory)
        .map_err(|error| StoreError::Create { path: directory.to_owned(), source: error.into() })?;
    match network_kind(statistics.f_type as u64 & 0xffff_ffff) {
        Some(kind) => Err(StoreError::NetworkFileSystem { path: path.to_owned(), kind }),
        None => Ok(()),
    }
}

/// Returns the kind of a network file system, by the magic numbers of statfs(2) and linux/magic.h.
fn network_kind(magic: u64) -> Option<&'static str> {
    match magic {
        0x6969 => Some("NFS"),
        0x517B | 0xFF53_4D42 | 0xFE53_4D42 => Some("SMB/CIFS"),
        0x6573_5546 => Some("FUSE"),
        0x0102_1997 => Some("9p"),
        _ => None,
    }
}

/// Returns the free bytes of the file system that holds `path`, for an unprivileged user.
pub(super) fn free_bytes(path: &Path) -> std::io::Result<u64> {
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let statistics = rustix::fs::statvfs(directory)?;
    Ok(statistics.f_bavail * statistics.f_frsize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn network_file_systems_are_known_by_their_magic_numbers() {
        assert_eq!(network_kind(0x6969), Some("NFS"));
        assert_eq!(network_kind(0xFF53_4D42), Some("SMB/CIFS"));
        assert_eq!(network_kind(0x6573_5546), Some("FUSE"));
        for local in [0xEF53, 0x5846_5342, 0x9123_683E, 0x0102_1994] {
            assert_eq!(network_kind(local), None, "{local:#x}");
        }
    }
}
