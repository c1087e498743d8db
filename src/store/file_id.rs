//! File identity: which file the writer has open under the database's path, and whether that path still names it.
//!
//! While the connection is closed (after an I/O error) nothing holds the file. Another file may then receive its inode
//! number, and the same file may receive another device number or, on vfat and exfat, another inode number. So the
//! database's own identity is compared before the file is opened again, without its log: the log left behind would
//! destroy another file.
//!
//! The replacement may still be being copied (`cp`). It is left alone while it changes, and a file that is refused as
//! damaged is examined again ([`FileId::judged`]).

use super::StoreError;
use super::damage::Damage;
use super::error::reports_damage;
use super::paths::{shm_path, uri_escaped, wal_path};
use super::schema::refuse_foreign;
use super::written::{Id, id_of, written};
use rusqlite::{Connection, OpenFlags};
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Bytes that distinguish one log from the next in the same file: its header, with the salt.
const LOG_HEADER: usize = 32;

pub(super) fn log_header(path: &Path) -> Option<[u8; LOG_HEADER]> {
    let mut header = [0; LOG_HEADER];
    std::fs::File::open(wal_path(path)).ok()?.read_exact(&mut header).ok()?;
    Some(header)
}

/// Which files are open: the database, its log, its shared memory.
#[derive(Debug, Clone)]
pub(super) struct FileId {
    pub(super) database: Option<Id>,
    /// Log and shared memory of the open file: they stay the same while a connection has them open.
    beside: Vec<(PathBuf, Id)>,
    /// Files that remained when the database was closed, to be removed before another one is opened.
    remains: Vec<(PathBuf, Id)>,
    /// The log that remained when the connection was closed after an error.
    log: Option<[u8; LOG_HEADER]>,
    /// The last batch in the file itself at that moment. A file with fewer batches is an older copy, which that log
    /// would destroy.
    pub(super) copied: i64,
    /// Whether the path named another file, or none, while this one was still open.
    pub(super) let_go: bool,
    /// The replacement at its last examination, and how often it was refused since it last changed.
    newcomer: Option<Stamp>,
    refusals: u32,
}

/// The attributes that change while a file is written.
type Stamp = (u64, i64, i64);

fn stamp(path: &Path) -> Option<Stamp> {
    std::fs::metadata(path).ok().map(|file| (file.len(), file.mtime(), file.mtime_nsec()))
}

/// The attempt at which a replacement that seems damaged is refused for good. Attempts are about a second apart, and
/// the queue holds half a minute.
pub(super) const REFUSALS: u32 = 30;

/// The content of a file, without its log.
#[derive(Debug, PartialEq, Eq)]
enum Content {
    /// The database of this identity, with this many batches.
    Identity(String, i64),
    /// A database of this program; its identity is in its log.
    Ours,
    /// The file is damaged or cannot be read now.
    Nothing,
    /// Another kind of file.
    Foreign,
}

fn content(path: &Path) -> Content {
    let uri = format!("file:{}?immutable=1", uri_escaped(path));
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let Ok(connection) = Connection::open_with_flags(uri, flags) else { return Content::Nothing };
    match refuse_foreign(&connection, path) {
        Ok(()) => {}
        // A file that is no database at all may be a damaged one.
        Err(StoreError::Foreign { found, .. }) if found != 0 => return Content::Foreign,
        Err(_) => return Content::Nothing,
    }
    let read = |row: &rusqlite::Row<'_>| Ok(Content::Identity(row.get(0)?, row.get(1)?));
    match connection.query_row("SELECT identity, batch FROM writer", [], read) {
        Ok(identity) => identity,
        Err(error) if reports_damage(&error) => Content::Nothing,
        Err(_) => Content::Ours,
    }
}

impl FileId {
    pub(super) fn of(path: &Path) -> Self {
        Self {
            database: id_of(path),
            beside: Vec::new(),
            remains: Vec::new(),
            log: None,
            copied: 0,
            let_go: false,
            newcomer: None,
            refusals: 0,
        }
    }

    /// Returns the file that this process writes from now on. A connection has read it, so that log and shared memory
    /// exist.
    pub(super) fn written(path: &Path) -> Self {
        let beside = [wal_path(path), shm_path(path)];
        let beside = beside.into_iter().filter_map(|path| id_of(&path).map(|id| (path, id))).collect();
        let file = Self { beside, ..Self::of(path) };
        match file.database {
            Some(id) => written().insert(path.to_owned(), id),
            None => written().remove(path),
        };
        file
    }

    /// Records that nothing is written any more.
    pub(super) fn forget(path: &Path) {
        written().remove(path);
    }

    /// Returns whether the path names another file, or none.
    pub(super) fn is_lost(&self, path: &Path) -> bool {
        match std::fs::metadata(path) {
            Ok(file) => Some((file.dev(), file.ino())) != self.database,
            Err(error) => error.kind() == std::io::ErrorKind::NotFound,
        }
    }

    /// Returns whether the path names another file, or none, while no connection holds the file.
    pub(super) fn is_replaced(&self, path: &Path, identity: &str) -> bool {
        let file = match std::fs::metadata(path) {
            Ok(file) => file,
            Err(error) => return error.kind() == std::io::ErrorKind::NotFound,
        };
        // A device may come back under another number. So may a file on a file system without inode numbers.
        let same_number = self.database.is_some_and(|(_, number)| number == file.ino());
        if file.len() == 0 || self.let_go && !same_number {
            return true;
        }
        match content(path) {
            Content::Identity(found, batch) => found != identity || batch < self.copied,
            Content::Foreign => true,
            // The inode number of a file that was closed may be given to the next one.
            Content::Ours | Content::Nothing => self.let_go || !same_number,
        }
    }

    /// Records the current state of the replacement.
    pub(super) fn look(&mut self, path: &Path) {
        self.newcomer = stamp(path);
    }

    /// Opens the replacement. `None` if it is still changing: it may be a copy in progress. A file that seems damaged
    /// is refused only at the last of [`REFUSALS`] attempts that find it unchanged.
    pub(super) fn judged<T>(
        &mut self,
        path: &Path,
        open: impl FnOnce(&mut Self) -> Result<T, StoreError>,
    ) -> Result<Option<T>, StoreError> {
        let before = stamp(path);
        if before != std::mem::replace(&mut self.newcomer, before) {
            self.refusals = 0;
            return Ok(None);
        }
        match open(self) {
            Ok(opened) => Ok(Some(opened)),
            Err(error) if error.is_damage() => {
                self.refusals += 1;
                tracing::warn!(message = "What took the lost file's place cannot be used.", %error, self.refusals);
                if self.refusals < REFUSALS { Ok(None) } else { Err(error) }
            }
            Err(error) => {
                // The attempt itself may have changed the file.
                self.look(path);
                Err(error)
            }
        }
    }

    /// Records that the path names another database after all.
    pub(super) fn set_lost(&mut self) {
        (self.database, self.let_go) = (None, true);
    }

    /// Closes the connection after an error, and records the remaining files.
    pub(super) fn close(&mut self, path: &Path, connection: Connection) {
        // Before the connection is closed: a copy of the log that fails midway may have reached no more than the
        // system's memory.
        self.copied = match content(path) {
            Content::Identity(_, batch) => batch,
            _ => 0,
        };
        drop(connection);
        self.log = log_header(path);
        self.remains = [shm_path(path)].into_iter().filter_map(|path| id_of(&path).map(|id| (path, id))).collect();
    }

    /// Closes the connection to the lost file, which is then complete for a user who has it under another name. Removes
    /// the log and the shared memory that belonged to it, but not those that may have come with the replacement.
    pub(super) fn let_go(&mut self, path: &Path, connection: Connection) {
        self.remains = std::mem::take(&mut self.beside);
        let copied = connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()));
        if let Err(error) = copied {
            tracing::warn!(message = "The lost file could not be completed.", %error);
        }
        if let Err((_, error)) = connection.close() {
            tracing::warn!(message = "The lost file could not be closed.", %error);
        }
        (self.log, self.let_go) = (None, true);
        if let Err(error) = self.clear_remains(path) {
            tracing::warn!(message = "What a lost file left cannot be removed.", %error);
        }
    }

    /// Removes log and shared memory of the lost file: with another file they would destroy it. A log that may hold
    /// data missing in the lost file is kept under another name.
    pub(super) fn clear_remains(&mut self, path: &Path) -> Result<(), StoreError> {
        if let Some(header) = self.log
            && log_header(path) == Some(header)
        {
            // A file that cannot be read now may be the one that the log belongs to.
            if std::fs::metadata(path).is_ok_and(|file| file.len() > 0) && content(path) == Content::Nothing {
                let report = "it cannot be read beside the log that was left".to_owned();
                return Err(Damage::Refused(report).error(path));
            }
            let (log, aside) = (wal_path(path), kept_log(path));
            std::fs::rename(&log, &aside).map_err(|source| StoreError::Create { path: aside.clone(), source })?;
            tracing::warn!(
                message = "The lost file's log is kept: beside that file, under its name and `-wal`, it completes it.",
                path = %aside.display()
            );
        }
        self.log = None;
        for (remains, id) in std::mem::take(&mut self.remains) {
            if id_of(&remains) == Some(id)
                && let Err(error) = std::fs::remove_file(&remains)
            {
                tracing::warn!(message = "What a lost file left cannot be removed.", path = %remains.display(), %error);
            }
        }
        Ok(())
    }
}

/// Returns an unused name beside the database.
pub(super) fn kept_log(path: &Path) -> PathBuf {
    let numbered = |number: u32| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".lost-{number}-wal"));
        PathBuf::from(name)
    };
    (1..).map(numbered).find(|name| !name.exists()).unwrap_or_else(|| numbered(0))
}
