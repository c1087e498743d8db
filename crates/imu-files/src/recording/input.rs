//! A recording's bytes, from a file or from memory. They can be read from the start repeatedly.

use super::error::RecordingError;
use super::mapping::ColumnMap;
use super::meter::{EXPANSION, Expanded, Expansion, FileBytes, KeepOn, Meter};
use super::table::{ARRAYS_MAX, Arrays};
use super::utf16;
use bzip2::bufread::MultiBzDecoder;
use flate2::bufread::MultiGzDecoder;
use lzma_rust2::XzReader;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::{Arc, OnceLock};

/// Memory that an xz file may ask for, KiB: `xz -9` asks for 65 MiB.
const XZ_MEMORY_KIB: u32 = 128 << 10;
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
    takes_counts: bool,
    /// The files that follow, in order: those of a split bag.
    further: Arc<[PathBuf]>,
    /// The arrays of a file that is read whole.
    arrays: Arc<OnceLock<Arc<Arrays>>>,
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
            takes_counts: false,
            further: Arc::default(),
            arrays: Arc::default(),
        }
    }

    /// Creates an input from bytes in memory; messages refer to them as `name`.
    pub fn memory(name: &str, bytes: impl Into<Arc<[u8]>>) -> Self {
        Self { bytes: Some(bytes.into()), ..Self::file(Path::new(name)) }
    }

    /// Sets the file, with all else as it is.
    pub(super) fn with_path(self, path: PathBuf) -> Self {
        Self { path, ..self }
    }

    /// Sets the files that follow.
    pub(super) fn followed_by(self, further: Vec<PathBuf>) -> Self {
        Self { further: further.into(), ..self }
    }

    /// Returns the files that follow.
    pub(super) fn further(&self) -> &[PathBuf] {
        &self.further
    }

    /// Sets the bytes that stand for the path.
    pub(super) fn with_bytes(self, text: String) -> Self {
        Self { bytes: Some(text.into_bytes().into()), ..self }
    }

    /// Reads only while the recording is wanted: once it is not, reading ends with [`RecordingError::Unwanted`].
    pub fn while_wanted(self, keep_on: KeepOn) -> Self {
        Self { keep_on, ..self }
    }

    /// Sets the map of the columns of a foreign CSV.
    pub fn with_columns(self, columns: ColumnMap) -> Self {
        Self { columns, ..self }
    }

    /// Takes columns in counts as they are if `takes_counts`; else a recording with such columns is refused.
    pub fn with_counts(self, takes_counts: bool) -> Self {
        Self { takes_counts, ..self }
    }

    /// Returns whether columns in counts are taken.
    pub(super) fn takes_counts(&self) -> bool {
        self.takes_counts
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

    /// Returns the bytes that the rows of a file of this size may take.
    pub(super) fn allowed_bytes(&self, file_bytes: u64) -> u64 {
        self.expansion.allowed_bytes(file_bytes)
    }

    /// Returns a meter for a separate reading.
    pub(super) fn meter(&self) -> Rc<Meter> {
        Meter::new(self.keep_on.clone(), self.expansion)
    }

    /// Returns the file itself, if it is one and is not compressed.
    pub(super) fn plain_file(&self) -> Result<Option<File>, RecordingError> {
        let mut head = [0; 16];
        if self.bytes.is_some() {
            return Ok(None);
        }
        let count = self.read_plain(&mut head)?;
        match packing(head.get(..count).unwrap_or_default()) {
            Some(_) => Ok(None),
            None => open_regular(&self.path).map(Some),
        }
    }

    fn read_plain(&self, head: &mut [u8]) -> Result<usize, RecordingError> {
        let read = open_regular(&self.path)?.read(head);
        read.map_err(|source| super::error::read_error(&self.path, 0, source))
    }

    /// Returns the whole content, decompressed.
    pub(super) fn whole(&self) -> Result<Vec<u8>, RecordingError> {
        let mut bytes = Vec::new();
        let read = self.open()?.take(ARRAYS_MAX as u64 + 1).read_to_end(&mut bytes);
        read.map_err(|source| super::error::read_error(&self.path, 0, source))?;
        if bytes.len() > ARRAYS_MAX {
            let what = format!(
                "it has more than {ARRAYS_MAX} bytes, and its form must be read whole; save it as CSV or Parquet"
            );
            return Err(broken(self, what));
        }
        Ok(bytes)
    }

    /// Returns the arrays of the content, which are kept: it is read several times.
    pub(super) fn arrays(&self, form: fn(Vec<u8>) -> Result<Arrays, String>) -> Result<Arc<Arrays>, RecordingError> {
        if let Some(arrays) = self.arrays.get() {
            return Ok(Arc::clone(arrays));
        }
        let arrays = Arc::new(form(self.whole()?).map_err(|what| broken(self, what))?);
        Ok(Arc::clone(self.arrays.get_or_init(|| arrays)))
    }

    /// Returns the content from the start, decompressed if it is gzip, bzip2, xz or zstd, and as UTF-8 if it is UTF-16.
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
        let head = bytes.fill_buf().map_err(|source| super::error::read_error(&self.path, 0, source))?;
        let read_error = |source| super::error::read_error(&self.path, 0, source);
        let expanded: Box<dyn Read> = match packing(head) {
            Some(Packing::Gzip) => Box::new(MultiGzDecoder::new(bytes)),
            Some(Packing::Bzip2) => Box::new(MultiBzDecoder::new(bytes)),
            Some(Packing::Xz) => Box::new(XzReader::new_mem_limit(bytes, true, XZ_MEMORY_KIB)),
            Some(Packing::Zstd) => Box::new(zstd::stream::read::Decoder::with_buffer(bytes).map_err(read_error)?),
            None => return Ok((utf16::decoded(Box::new(bytes)).map_err(read_error)?, meter)),
        };
        let expanded = Expanded { bytes: expanded, meter: Rc::clone(&meter) };
        let expanded = Box::new(BufReader::with_capacity(BUFFER_BYTES, expanded));
        Ok((utf16::decoded(expanded).map_err(read_error)?, meter))
    }
}

/// Returns the error of a file that cannot be read as a table.
pub(super) fn broken(input: &Input, what: impl Into<String>) -> RecordingError {
    RecordingError::Table { file: input.path().to_owned(), what: what.into() }
}

/// A form of compressed data that [`Input::open`] expands.
enum Packing {
    Gzip,
    Bzip2,
    Xz,
    Zstd,
}

/// Returns the form of compressed data by their first bytes.
fn packing(head: &[u8]) -> Option<Packing> {
    match head {
        [0x1F, 0x8B, ..] => Some(Packing::Gzip),
        [b'B', b'Z', b'h', b'1'..=b'9', 0x31, 0x41, 0x59, 0x26, ..] => Some(Packing::Bzip2),
        [0xFD, b'7', b'z', b'X', b'Z', 0, ..] => Some(Packing::Xz),
        [0x28, 0xB5, 0x2F, 0xFD, ..] => Some(Packing::Zstd),
        _ => None,
    }
}

/// Reads a whole text of at most `most_bytes`; bytes that are not UTF-8 become marks.
///
/// # Errors
/// Those of [`open_regular`], or [`RecordingError::Table`] if the file is longer.
pub fn read_small(path: &Path, most_bytes: u64) -> Result<String, RecordingError> {
    let mut bytes = Vec::new();
    let read = open_regular(path)?.take(most_bytes.saturating_add(1)).read_to_end(&mut bytes);
    read.map_err(|source| super::error::read_error(path, 0, source))?;
    if bytes.len() as u64 > most_bytes {
        let what = format!("it is longer than {most_bytes} bytes; shorten it");
        return Err(RecordingError::Table { file: path.to_owned(), what });
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
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
