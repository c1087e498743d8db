//! The lock that lets one process write a database, and the file systems on which none should.

use super::StoreError;
use rustix::fs::FlockOperation;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};

/// Holds `<database>.lock` with this process's id in it; the kernel lets go of it when the process ends, however.
#[derive(Debug)]
pub(super) struct WriterLock {
    _file: File,
}

impl WriterLock {
    /// Takes the lock, at once or not at all.
    pub(super) fn take(database: &Path) -> Result<Self, StoreError> {
        let path = lock_path(database);
        let create = |source| StoreError::Create { path: path.clone(), source };
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path).map_err(create)?;
        if let Err(error) = rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive) {
            if error != rustix::io::Errno::WOULDBLOCK {
                return Err(create(error.into()));
            }
            let mut pid = String::new();
            file.read_to_string(&mut pid).map_err(create)?;
            let pid = match pid.trim() {
                "" => "(unknown)".to_owned(),
                text => text.to_owned(),
            };
            return Err(StoreError::Locked { path: database.to_owned(), pid });
        }
        file.set_len(0).map_err(create)?;
        file.rewind().map_err(create)?;
        writeln!(file, "{}", std::process::id()).map_err(create)?;
        Ok(Self { _file: file })
    }
}

fn lock_path(database: &Path) -> PathBuf {
    let mut path = database.as_os_str().to_owned();
    path.push(".lock");
    PathBuf::from(path)
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

/// Magic numbers of statfs(2) and linux/magic.h.
fn network_kind(magic: u64) -> Option<&'static str> {
    match magic {
        0x6969 => Some("NFS"),
        0x517B | 0xFF53_4D42 | 0xFE53_4D42 => Some("SMB/CIFS"),
        0x6573_5546 => Some("FUSE"),
        0x0102_1997 => Some("9p"),
        _ => None,
    }
}

/// Free bytes of the file system that holds `path`, for an unprivileged user.
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
