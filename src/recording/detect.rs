//! What a file is, by its content: gzip or not, raw `$VN…` lines or CSV. Names and endings do not count.

use super::csv::Header;
use super::error::RecordingError;
use flate2::bufread::MultiGzDecoder;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// How much of a file is looked at.
const LOOK_AT_BYTES: u64 = 64 * 1024;
/// How many lines from the start may lack `$VN` in a file of raw lines: a recorder's header, a cut first line.
const LOOK_AT_LINES: usize = 100;
/// Read at a time.
const BUFFER_BYTES: usize = 128 * 1024;
/// How much of an unrecognised file is shown.
const SHOWN_CHARS: usize = 60;

/// What a recording's text is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A table with a header line (contract, section 4).
    Csv,
    /// Raw `$VN…` lines.
    VnText,
}

/// Formats that are recognised in order to say so.
const NOT_READ_YET: [(&[u8], &str); 5] = [
    (b"#ROSBAG V", "a ROS 1 bag"),
    (b"SQLite format 3\0", "an SQLite database (a ROS 2 .db3, or this program's own)"),
    (b"\x89MCAP0\r\n", "an MCAP file"),
    (b"\xFA", "raw binary output of a VN-100"),
    (b"PK\x03\x04", "a ZIP archive"),
];

/// Opens a file for reading its text, decompressing gzip.
pub(super) fn open(file: &Path) -> Result<Box<dyn BufRead>, RecordingError> {
    let opened = File::open(file).and_then(|opened| {
        // Opening a directory succeeds; reading it does not.
        let mut bytes = BufReader::with_capacity(BUFFER_BYTES, opened);
        let is_gzip = bytes.fill_buf()?.starts_with(&[0x1F, 0x8B]);
        Ok((bytes, is_gzip))
    });
    let (bytes, is_gzip) = opened.map_err(|source| RecordingError::Open { file: file.to_owned(), source })?;
    if is_gzip {
        return Ok(Box::new(BufReader::with_capacity(BUFFER_BYTES, MultiGzDecoder::new(bytes))));
    }
    Ok(Box::new(bytes))
}

/// Turns an error of reading into one that says where.
pub(super) fn read_error(file: &Path, line: u64, source: std::io::Error) -> RecordingError {
    if source.kind() == std::io::ErrorKind::UnexpectedEof {
        return RecordingError::CutCompression { file: file.to_owned(), line };
    }
    RecordingError::Read { file: file.to_owned(), line, source }
}

/// Finds out what `file` is.
///
/// # Errors
/// [`RecordingError`] where it cannot be read or is nothing that can be read, with how it begins.
pub fn detect(file: &Path) -> Result<Kind, RecordingError> {
    let mut head = Vec::new();
    open(file)?.take(LOOK_AT_BYTES).read_to_end(&mut head).map_err(|source| read_error(file, 0, source))?;
    if let Some((_, found)) = NOT_READ_YET.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Err(RecordingError::NotReadYet { file: file.to_owned(), found });
    }
    let lines = || head.split(|byte| *byte == b'\n').filter(|line| !line.trim_ascii().is_empty());
    if lines().take(LOOK_AT_LINES).any(|line| line.windows(3).any(|window| window == b"$VN")) {
        return Ok(Kind::VnText);
    }
    let first = String::from_utf8_lossy(lines().next().unwrap_or_default()).into_owned();
    if Header::names_a_channel(&first) {
        return Ok(Kind::Csv);
    }
    let found = first.chars().take(SHOWN_CHARS).collect();
    Err(RecordingError::Unrecognised { file: file.to_owned(), found })
}
