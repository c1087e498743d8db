//! A recording's bytes, from a file or from memory. They can be read from the start repeatedly.

use super::error::RecordingError;
use super::mapping::ColumnMap;
use super::meter::{EXPANSION, Expanded, Expansion, FileBytes, KeepOn, Meter};
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

/// Bytes read at a time.
const BUFFER_BYTES: usize = 128 * 1024;

/// The source of a recording's bytes.
#[derive(Debug, Clone)]
pub struct Input {
    path: PathBuf,
    bytes: Option<Arc<[u8]>>,
    keep_on: KeepOn,
    expansion: Expansion,
    columns: ColumnMap,
}

impl Input {
    /// Creates an input from a file.
    pub fn file(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            bytes: None,
            keep_on: KeepOn::default(),
            expansion: EXPANSION,
            columns: ColumnMap::default(),
        }
    }

    /// Creates an input from bytes in memory; messages refer to them as `name`.
    pub fn memory(name: &str, bytes: impl Into<Arc<[u8]>>) -> Self {
        Self { bytes: Some(bytes.into()), ..Self::file(Path::new(name)) }
    }

    /// Reads only while the recording is wanted: once it is not, reading ends with [`RecordingError::Unwanted`].
    pub fn while_wanted(self, keep_on: KeepOn) -> Self {
        Self { keep_on, ..self }
    }

    /// Sets the map of the columns of a foreign CSV.
    pub fn with_columns(self, columns: ColumnMap) -> Self {
        Self { columns, ..self }
    }

    /// Returns the map of the columns of a foreign CSV.
    pub(super) fn columns(&self) -> &ColumnMap {
        &self.columns
    }

    /// Sets other limits for the expansion of compressed data.
    #[cfg(test)]
    pub(super) fn expanding(self, expansion: Expansion) -> Self {
        Self { expansion, ..self }
    }

    /// Returns the file's path, or the name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the bytes, if they are in memory.
    pub(super) fn bytes(&self) -> Option<&[u8]> {
        self.bytes.as_deref()
    }

    /// Returns a handle that reports whether the recording is still wanted.
    pub(super) fn keep_on(&self) -> KeepOn {
        self.keep_on.clone()
    }

    /// Returns a meter for a separate reading.
    pub(super) fn meter(&self) -> Rc<Meter> {
        Meter::new(self.keep_on.clone(), self.expansion)
    }

    /// Returns the content from the start, decompressed if it is gzip.
    pub(super) fn open(&self) -> Result<Box<dyn BufRead>, RecordingError> {
        Ok(self.open_metered()?.0)
    }

    /// Opens the content as [`Self::open`] does, and returns the meter that counts this reading.
    pub(super) fn open_metered(&self) -> Result<(Box<dyn BufRead>, Rc<Meter>), RecordingError> {
        let bytes: Box<dyn BufRead> = match &self.bytes {
            Some(bytes) => Box::new(Cursor::new(Arc::clone(bytes))),
            None => Box::new(BufReader::with_capacity(BUFFER_BYTES, open_regular(&self.path)?)),
        };
        let meter = self.meter();
        let mut bytes = FileBytes { bytes, meter: Rc::clone(&meter) };
        // Opening a directory succeeds; reading it does not.
        let head = bytes.fill_buf().map_err(|source| super::detect::read_error(&self.path, 0, source))?;
        if head.starts_with(&[0x1F, 0x8B]) {
            let expanded = Expanded { bytes: MultiGzDecoder::new(bytes), meter: Rc::clone(&meter) };
            return Ok((Box::new(BufReader::with_capacity(BUFFER_BYTES, expanded)), meter));
        }
        Ok((Box::new(bytes), meter))
    }
}

/// Opens a recording's file, which is read several times. A pipe returns its bytes only once, and opening one would
/// wait for its writer.
///
/// # Errors
/// [`RecordingError::NoFile`], or [`RecordingError::Open`] with the system's error.
pub fn open_regular(path: &Path) -> Result<File, RecordingError> {
    let cannot_open = |source| RecordingError::Open { file: path.to_owned(), source };
    let kind = std::fs::metadata(path).map_err(cannot_open)?.file_type();
    if kind.is_file() {
        return File::open(path).map_err(cannot_open);
    }
    let found = if kind.is_dir() {
        "a folder"
    } else if kind.is_fifo() {
        "a pipe"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    };
    Err(RecordingError::NoFile { file: path.to_owned(), found })
}
