//! The files that this process writes, which no reader may confuse with the files that replace them.

use super::StoreError;
use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The device and the inode number of a file.
pub(super) type Id = (u64, u64);

/// The file that this process writes under each path. It is global because SQLite's own bookkeeping is: a reader that
/// opened a file which has just replaced the written one would use the log of the written one.
static WRITTEN: Mutex<BTreeMap<PathBuf, Id>> = Mutex::new(BTreeMap::new());

pub(super) fn written() -> MutexGuard<'static, BTreeMap<PathBuf, Id>> {
    WRITTEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Fails if the path names another file than the written one. Must be called between opening a connection, which opens
/// the file, and its first read, which opens the log.
pub(super) fn refuse_replaced(path: &Path) -> Result<(), StoreError> {
    match written().get(path) {
        Some(id) if id_of(path) != Some(*id) => Err(StoreError::Lost {
            path: path.to_owned(),
            detail: "it is read again once another file takes its place",
        }),
        _ => Ok(()),
    }
}

/// Returns the file that this process writes under a path, as text to be passed to another process of this program.
pub(super) fn written_file(path: &Path) -> String {
    written().get(path).map(|(device, number)| format!("{device}:{number}")).unwrap_or_default()
}

/// Adopts another process's record of the file that is written under a path: [`refuse_replaced`] then refuses any
/// other.
pub(super) fn adopt(path: &Path, file: &str) {
    let id = file.split_once(':').and_then(|(device, number)| Some((device.parse().ok()?, number.parse().ok()?)));
    if let Some(id) = id {
        written().insert(path.to_owned(), id);
    }
}

pub(super) fn id_of(path: &Path) -> Option<Id> {
    std::fs::metadata(path).ok().map(|file| (file.dev(), file.ino()))
}
