//! Backup: a consistent copy of a database, also while a daemon writes it.
//!
//! The source is copied within one read transaction, in steps through SQLite's backup API. In WAL mode a reader never
//! blocks the writer. Because the transaction stays open, the copy does not restart at each of the writer's commits.
//! The copy is written beside its destination, synced, and appears under its name complete or not at all.

use super::paths::wal_path;
use super::{Reader, StoreError, schema};
use rusqlite::Connection;
use rusqlite::backup::{Backup, StepResult};
use std::path::Path;
use std::time::{Duration, Instant};

/// Pages copied in one step: 16 MiB.
const STEP: i32 = 4096;
/// The total time to wait for another reader's lock.
const PATIENCE: Duration = Duration::from_secs(10);

/// The outcome of a backup.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct BackupReport {
    /// Size of the copy in bytes.
    pub bytes: u64,
    /// The duration in s.
    pub seconds: f64,
}

impl Reader {
    /// Copies the database to `out`. `progress` is called with the number of bytes copied and the total. An existing
    /// file is replaced only with `replace`.
    ///
    /// # Errors
    /// [`StoreError::Exists`], [`StoreError::Create`] if the copy cannot be written, or the error that SQLite reports.
    /// In each case `out` is unchanged.
    pub fn backup(
        &self,
        out: &Path,
        replace: bool,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<BackupReport, StoreError> {
        let begun = Instant::now();
        let new = NewFile::beside(out, replace, Path::new(self.connection.path().unwrap_or_default()))?;
        let mut copy = Connection::open(new.path())?;
        // The file is synced as a whole at the end.
        copy.pragma_update(None, "synchronous", "OFF")?;
        copy.pragma_update(None, "journal_mode", "OFF")?;
        let snapshot = self.connection.unchecked_transaction()?;
        let page: u64 = snapshot.query_row("PRAGMA page_size", [], |row| row.get::<_, i64>(0))? as u64;
        // A transaction holds nothing before it has read.
        snapshot.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get::<_, i64>(0))?;
        {
            let backup = Backup::new(&snapshot, &mut copy)?;
            let mut waited = Duration::ZERO;
            loop {
                let step = backup.step(STEP)?;
                let at = backup.progress();
                progress((at.pagecount - at.remaining) as u64 * page, at.pagecount as u64 * page);
                match step {
                    StepResult::Done => break,
                    StepResult::More => waited = Duration::ZERO,
                    _ if waited >= PATIENCE => {
                        let busy = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_BUSY);
                        return Err(rusqlite::Error::SqliteFailure(busy, None).into());
                    }
                    _ => {
                        std::thread::sleep(Duration::from_millis(20));
                        waited += Duration::from_millis(20);
                    }
                }
            }
        }
        drop(snapshot);
        copy.close().map_err(|(_, error)| error)?;
        schema::make_independent(new.path())?;
        let bytes = new.finish()?;
        Ok(BackupReport { bytes, seconds: begun.elapsed().as_secs_f64() })
    }
}

/// A file under construction. It appears under its name once it is complete and synced; if dropped before, it is
/// removed.
#[derive(Debug)]
pub(super) struct NewFile {
    file: tempfile::NamedTempFile,
    out: std::path::PathBuf,
    directory: std::path::PathBuf,
    replace: bool,
}

impl NewFile {
    /// Begins a file in the directory of `out`, made from `source`. It never replaces a database that is in use.
    pub(super) fn beside(out: &Path, replace: bool, source: &Path) -> Result<Self, StoreError> {
        if out.symlink_metadata().is_ok() {
            if !replace {
                return Err(StoreError::Exists(out.to_owned()));
            }
            let same = out.canonicalize().ok().zip(source.canonicalize().ok()).is_some_and(|(one, other)| one == other);
            // SQLite would take the log of the replaced file for the log of the new file.
            let has_log = std::fs::metadata(wal_path(out)).is_ok_and(|log| log.len() > 0);
            // A log is no database, but one would miss it.
            let is_beside = schema::is_of_database(out) && !schema::is_database(out);
            if same || has_log || is_beside {
                return Err(StoreError::InUse(out.to_owned()));
            }
            super::lock::refuse_writer(out)?;
        }
        let directory =
            out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned();
        let file = tempfile::Builder::new()
            .prefix(".vn100d-")
            .suffix(".part")
            .tempfile_in(&directory)
            .map_err(|source| StoreError::Create { path: out.to_owned(), source })?;
        Ok(Self { file, out: out.to_owned(), directory, replace })
    }

    pub(super) fn path(&self) -> &Path {
        self.file.path()
    }

    /// Syncs the file, gives it its name, and syncs the directory that holds the name. Returns the size in bytes.
    pub(super) fn finish(self) -> Result<u64, StoreError> {
        let Self { file, out, directory, replace } = self;
        let create = |source| StoreError::Create { path: out.clone(), source };
        // Through the path: SQLite wrote it under another descriptor.
        let written = std::fs::File::open(file.path()).map_err(create)?;
        written.sync_all().map_err(create)?;
        let bytes = written.metadata().map_err(create)?.len();
        let persisted = if replace { file.persist(&out) } else { file.persist_noclobber(&out) };
        persisted.map_err(|error| match error.error.kind() {
            std::io::ErrorKind::AlreadyExists => StoreError::Exists(out.clone()),
            _ => create(error.error),
        })?;
        std::fs::File::open(&directory).and_then(|directory| directory.sync_all()).map_err(create)?;
        Ok(bytes)
    }
}
