//! A recording's bytes, which can be read from the start as often as wanted: a file, or memory.

use super::error::RecordingError;
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Read at a time.
const BUFFER_BYTES: usize = 128 * 1024;

/// Where a recording lies.
#[derive(Debug, Clone)]
pub struct Input {
    path: PathBuf,
    bytes: Option<Arc<[u8]>>,
}

impl Input {
    /// A file.
    #[must_use]
    pub fn file(path: &Path) -> Self {
        Self { path: path.to_owned(), bytes: None }
    }

    /// Bytes that are there already; messages call them `name`.
    #[must_use]
    pub fn memory(name: &str, bytes: impl Into<Arc<[u8]>>) -> Self {
        Self { path: PathBuf::from(name), bytes: Some(bytes.into()) }
    }

    /// The file's path, or the name.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its content from the start, decompressed where it is gzip.
    pub(super) fn open(&self) -> Result<Box<dyn BufRead>, RecordingError> {
        let bytes: Box<dyn BufRead> = match &self.bytes {
            Some(bytes) => Box::new(Cursor::new(Arc::clone(bytes))),
            None => Box::new(BufReader::with_capacity(
                BUFFER_BYTES,
                File::open(&self.path).map_err(|source| self.cannot_open(source))?,
            )),
        };
        self.decompressed(bytes)
    }

    fn decompressed(&self, mut bytes: Box<dyn BufRead>) -> Result<Box<dyn BufRead>, RecordingError> {
        // Opening a directory succeeds; reading it does not.
        let is_gzip = bytes.fill_buf().map_err(|source| self.cannot_open(source))?.starts_with(&[0x1F, 0x8B]);
        if is_gzip {
            return Ok(Box::new(BufReader::with_capacity(BUFFER_BYTES, MultiGzDecoder::new(bytes))));
        }
        Ok(bytes)
    }

    fn cannot_open(&self, source: std::io::Error) -> RecordingError {
        RecordingError::Open { file: self.path.clone(), source }
    }
}
