//! Paths: the names of the files beside a database, and the form of a path in a URI.

use std::path::{Path, PathBuf};

pub(super) fn lock_path(database: &Path) -> PathBuf {
    let mut path = database.as_os_str().to_owned();
    path.push(".lock");
    PathBuf::from(path)
}

pub(super) fn wal_path(path: &Path) -> PathBuf {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    log.into()
}

pub(super) fn shm_path(path: &Path) -> PathBuf {
    let mut shared = path.as_os_str().to_owned();
    shared.push("-shm");
    shared.into()
}

/// Escapes the characters that end or change a path in a `file:` URI (sqlite.org/uri.html, 3.1).
pub(super) fn uri_escaped(path: &Path) -> String {
    path.to_string_lossy().replace('%', "%25").replace('?', "%3f").replace('#', "%23")
}
