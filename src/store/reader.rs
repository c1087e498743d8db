//! Readers: connections that cannot write, usable beside a running daemon, and a pool of them.
//!
//! Every method is one short query. None leaves a read transaction open, because an open one prevents the log from
//! being emptied (an hour's worth of data: 168 MB).

use super::file_id::FileId;
use super::{StoreError, schema};
use rusqlite::{Connection, InterruptHandle};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tempfile::TempDir;

/// Idle connections that the pool keeps.
const IDLE_MAX: usize = 16;

/// A connection for reading.
#[derive(Debug)]
pub struct Reader {
    pub(super) connection: Connection,
    file: FileId,
    /// The folder of the database, if it is removed after the connection.
    _folder: Option<TempDir>,
}

impl Reader {
    /// Opens the database at `path` for reading; no lock is needed.
    ///
    /// # Errors
    /// [`StoreError::NoDatabase`], [`StoreError::Foreign`], [`StoreError::NewerSchema`], [`StoreError::OlderSchema`] or
    /// the error that SQLite reports.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        // Before the connection: a file that is replaced in between is then considered lost, never the reverse.
        let file = FileId::of(path);
        Ok(Self { connection: schema::reader_connection(path)?, file, _folder: None })
    }

    /// Removes the folder of the database with the reader.
    pub(super) fn within(self, folder: TempDir) -> Self {
        Self { _folder: Some(folder), ..self }
    }

    /// Opens the database in a separate process, beside the one that writes `file` there ([`super::Store::file`]).
    ///
    /// # Errors
    /// As [`Self::open`]; [`StoreError::Lost`] if another file has taken its place.
    pub fn open_written(path: &Path, file: &str) -> Result<Self, StoreError> {
        super::written::adopt(path, file);
        Self::open(path)
    }

    /// Returns an identifier that distinguishes this database from all others, also from one whose captures have the
    /// same ids; copies share it.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn identity(&self) -> Result<String, StoreError> {
        super::writer::identity_of(&self.connection)
    }

    /// Returns a handle with which another thread interrupts a query of this reader that takes too long. The query then
    /// returns an error for which [`StoreError::is_interrupted`] holds.
    pub fn interrupt(&self) -> InterruptHandle {
        self.connection.get_interrupt_handle()
    }
}

/// A pool of readers; cheap to clone.
#[derive(Debug, Clone)]
pub struct ReaderPool {
    path: PathBuf,
    idle: Arc<Mutex<Vec<Reader>>>,
}

impl ReaderPool {
    /// Creates a pool for the database at `path`; connections are opened on demand.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), idle: Arc::default() }
    }

    /// Returns a reader; it returns to the pool when dropped.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn get(&self) -> Result<PooledReader, StoreError> {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        // A reader of a file that was deleted or replaced is discarded.
        idle.retain(|reader| !reader.file.is_lost(&self.path));
        let reader = idle.pop();
        drop(idle);
        let reader = match reader {
            Some(reader) => reader,
            None => Reader::open(&self.path)?,
        };
        Ok(PooledReader { reader: Some(reader), idle: Arc::clone(&self.idle) })
    }
}

/// A reader borrowed from the pool.
#[derive(Debug)]
pub struct PooledReader {
    reader: Option<Reader>,
    idle: Arc<Mutex<Vec<Reader>>>,
}

impl std::ops::Deref for PooledReader {
    type Target = Reader;
    #[expect(clippy::expect_used, reason = "the reader is only taken out by drop")]
    fn deref(&self) -> &Reader {
        self.reader.as_ref().expect("a pooled reader is there until it is dropped")
    }
}

impl Drop for PooledReader {
    fn drop(&mut self) {
        if let Some(reader) = self.reader.take() {
            let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
            if idle.len() < IDLE_MAX {
                idle.push(reader);
            }
        }
    }
}
