//! The meter of one reading. It ends the reading when it is no longer wanted, and when compressed bytes expand out of
//! all proportion.
//!
//! Memory is bounded elsewhere (a line, a row, a message). The expansion of a few compressed bytes costs time and rows.
//! So the bytes read from the file and the bytes that decompression produced are counted for every reading.

use std::cell::Cell;
use std::io::{BufRead, Read};
use std::rc::Rc;
use std::sync::Arc;

/// Called from time to time while a recording is read, to determine whether it is still wanted.
#[derive(Clone)]
pub struct KeepOn(Arc<dyn Fn() -> bool + Send + Sync>);

impl KeepOn {
    /// Uses the result of `wanted`.
    pub fn asking(wanted: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(wanted))
    }

    /// Returns whether the recording is still wanted.
    pub fn is_wanted(&self) -> bool {
        (self.0)()
    }
}

impl Default for KeepOn {
    fn default() -> Self {
        Self::asking(|| true)
    }
}

impl std::fmt::Debug for KeepOn {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_tuple("KeepOn").finish()
    }
}

/// Limits for the expansion of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Expansion {
    /// Bytes allowed whatever the file's size.
    pub(super) free_bytes: u64,
    /// Additional bytes allowed for each byte of the file. A sensor's text becomes ten times smaller at best.
    pub(super) ratio: u64,
    /// The absolute maximum.
    pub(super) most_bytes: u64,
}

impl Expansion {
    /// Returns the bytes that this many of the file may become.
    pub(super) fn allowed_bytes(self, file_bytes: u64) -> u64 {
        file_bytes.saturating_mul(self.ratio).saturating_add(self.free_bytes).min(self.most_bytes)
    }
}

/// The limits for recordings (docs/cli.md).
pub(super) const EXPANSION: Expansion = Expansion { free_bytes: 256 << 20, ratio: 100, most_bytes: 1 << 40 };

/// The reason why a reading ended before the end of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum Refusal {
    #[error("nobody wants it any more")]
    Unwanted,
    #[error("{file_bytes} compressed bytes became more than {allowed_bytes}")]
    Expands { file_bytes: u64, allowed_bytes: u64 },
}

impl From<Refusal> for std::io::Error {
    fn from(refusal: Refusal) -> Self {
        Self::other(refusal)
    }
}

/// The interval in bytes at which the meter checks whether the reading is still wanted.
const ASK_BYTES: u64 = 64 * 1024;

/// Counts one reading. A refusal is permanent: a reader that continues after damage must not continue here.
#[derive(Debug)]
pub(super) struct Meter {
    keep_on: KeepOn,
    expansion: Expansion,
    file_bytes: Cell<u64>,
    expanded_bytes: Cell<u64>,
    ask_at: Cell<u64>,
    refused: Cell<Option<Refusal>>,
}

impl Meter {
    pub(super) fn new(keep_on: KeepOn, expansion: Expansion) -> Rc<Self> {
        Rc::new(Self {
            keep_on,
            expansion,
            file_bytes: Cell::new(0),
            expanded_bytes: Cell::new(0),
            ask_at: Cell::new(0),
            refused: Cell::new(None),
        })
    }

    /// Returns the reason for the refusal, if any.
    pub(super) fn refused(&self) -> Option<Refusal> {
        self.refused.get()
    }

    fn read(&self, bytes: usize) {
        self.file_bytes.set(self.file_bytes.get().saturating_add(bytes as u64));
    }

    pub(super) fn check(&self) -> Result<(), Refusal> {
        if let Some(refusal) = self.refused.get() {
            return Err(refusal);
        }
        let (file_bytes, expanded_bytes) = (self.file_bytes.get(), self.expanded_bytes.get());
        let allowed = self.expansion.allowed_bytes(file_bytes);
        let moved = file_bytes.saturating_add(expanded_bytes);
        let refusal = if expanded_bytes > allowed {
            Refusal::Expands { file_bytes, allowed_bytes: allowed }
        } else if moved >= self.ask_at.get() {
            self.ask_at.set(moved.saturating_add(ASK_BYTES));
            if self.keep_on.is_wanted() {
                return Ok(());
            }
            Refusal::Unwanted
        } else {
            return Ok(());
        };
        self.refused.set(Some(refusal));
        Err(refusal)
    }
}

/// A reader that counts the file's own bytes.
pub(super) struct FileBytes {
    pub(super) bytes: Box<dyn BufRead>,
    pub(super) meter: Rc<Meter>,
}

impl BufRead for FileBytes {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        self.meter.check()?;
        self.bytes.fill_buf()
    }
    fn consume(&mut self, amount: usize) {
        self.meter.read(amount);
        self.bytes.consume(amount);
    }
}

impl Read for FileBytes {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.meter.check()?;
        let read = self.bytes.read(buffer)?;
        self.meter.read(read);
        Ok(read)
    }
}

/// A reader that counts the bytes that a decompressor returns.
pub(super) struct Expanded<R> {
    pub(super) bytes: R,
    pub(super) meter: Rc<Meter>,
}

impl<R: Read> Read for Expanded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.bytes.read(buffer)?;
        self.meter.expanded_bytes.set(self.meter.expanded_bytes.get().saturating_add(read as u64));
        self.meter.check()?;
        Ok(read)
    }
}
