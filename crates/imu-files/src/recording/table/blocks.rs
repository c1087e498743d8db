//! Blocks: a stream of bytes of which as many as a message needs are held at once.

use super::super::error::{RecordingError, read_error};
use super::super::input::Input;
use std::io::{BufRead, Read as _};
use std::path::PathBuf;

/// Bytes that are read at a time; more than a message of ULog or dataflash has.
const READ_BYTES: usize = 256 * 1024;

/// The bytes of a file from a place on.
pub(super) struct Blocks {
    file: PathBuf,
    reader: Box<dyn BufRead>,
    held: Vec<u8>,
    begin: usize,
    /// The place in the file of the next byte.
    pub(super) at: u64,
    ended: bool,
}

impl Blocks {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let (file, reader) = (input.path().to_owned(), input.open()?);
        Ok(Self { file, reader, held: Vec::new(), begin: 0, at: 0, ended: false })
    }

    /// Returns the next bytes: at least `count`, or all that are left. `count` is at most 128 KiB.
    pub(super) fn peek(&mut self, count: usize) -> Result<&[u8], RecordingError> {
        if self.held.len() - self.begin < count && !self.ended {
            self.held.drain(..self.begin);
            self.begin = 0;
            let read = self.reader.by_ref().take(READ_BYTES as u64).read_to_end(&mut self.held);
            let read = read.map_err(|source| read_error(&self.file, self.at, source))?;
            self.ended = read < READ_BYTES;
        }
        Ok(self.held.get(self.begin..).unwrap_or_default())
    }

    /// Passes over bytes that were peeked at.
    pub(super) fn pass(&mut self, count: usize) {
        let count = count.min(self.held.len() - self.begin);
        self.begin += count;
        self.at += count as u64;
    }
}
