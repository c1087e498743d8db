//! Raw `$VN…` lines, as a terminal program or a logging driver wrote them.
//!
//! A line is `[stamp …] $VN…*checksum`. Before the `$`, numbers separated by tabs, spaces, commas or semicolons are stamps
//! in seconds; of several the last one counts: drivers write the time of reception first and then the time they assigned
//! to the measurement, which is the smoother of the two. Other text there is ignored and named.
//!
//! The checksum decides: a line whose checksum fails is rejected whole, nothing in it is guessed at. Valid messages without
//! a measurement (replies to commands) are passed over. The first measurement decides whether the recording has stamps;
//! a later line without one is rejected.

use super::detect::{open, read_error};
use super::error::RecordingError;
use super::info::Decimals;
use super::rows::{Rejected, Row, Rows};
use super::stamps::parse_seconds;
use crate::sample::{DiscardCause, Sample};
use std::io::{BufRead, Read};
use std::path::{Path, PathBuf};

/// Longest line that is kept together; what follows is read as another line. Messages are shorter than 300 bytes.
const LINE_BYTES: u64 = 4096;
/// What every message begins with.
const START: &[u8] = b"$VN";
/// Name, in the list of ignored columns, of text before the message that is no stamp.
const UNREAD_PREFIX: &str = "text before $VN";

/// What a message says.
pub(super) enum Message {
    /// A measurement with its values.
    Measurement(Sample),
    /// Something else that is valid.
    Other,
    /// It cannot be used.
    Bad(DiscardCause),
}

/// The lines of a file of raw messages, one at a time.
pub(super) struct VnRows {
    file: PathBuf,
    reader: Box<dyn BufRead>,
    line: u64,
    bytes: Vec<u8>,
    /// Whether the first measurement had a stamp.
    stamped: Option<bool>,
    ignored: Vec<String>,
    decimals: Decimals,
}

impl VnRows {
    pub(super) fn open(file: &Path) -> Result<Self, RecordingError> {
        Ok(Self {
            file: file.to_owned(),
            reader: open(file)?,
            line: 0,
            bytes: Vec::new(),
            stamped: None,
            ignored: Vec::new(),
            decimals: Decimals::default(),
        })
    }

    /// What of the lines read so far was ignored.
    pub(super) fn ignored(&self) -> &[String] {
        &self.ignored
    }

    /// Reads one line into `bytes`; whether there was one.
    fn read_line(&mut self) -> Result<bool, RecordingError> {
        self.bytes.clear();
        let read = self.reader.by_ref().take(LINE_BYTES).read_until(b'\n', &mut self.bytes);
        let read = read.map_err(|source| read_error(&self.file, self.line, source))?;
        self.line += 1;
        Ok(read > 0)
    }

    fn understand(&mut self) -> Row {
        let line = self.bytes.trim_ascii();
        let rejected = |cause, stands_for_sample| {
            Row::Rejected(Rejected::new(self.line, cause, &String::from_utf8_lossy(line), stands_for_sample))
        };
        let Some(start) = line.windows(START.len()).position(|window| window == START) else {
            return rejected(DiscardCause::GarbageBytes, false);
        };
        let (prefix, message) = line.split_at(start);
        let sample = match measurement(message, &mut self.decimals) {
            Message::Measurement(sample) => sample,
            Message::Other => return Row::Aside,
            Message::Bad(cause) => return rejected(cause, true),
        };
        let stamp_ns = match stamp(prefix) {
            Prefix::Stamp(nanos) => Some(nanos),
            Prefix::Empty => None,
            Prefix::Text => {
                if self.stamped != Some(true) && self.ignored.is_empty() {
                    self.ignored.push(UNREAD_PREFIX.to_owned());
                }
                None
            }
        };
        match (*self.stamped.get_or_insert(stamp_ns.is_some()), stamp_ns) {
            (true, None) => rejected(DiscardCause::Malformed, true),
            (true, Some(_)) => Row::Sample { line: self.line, stamp_ns, sample },
            (false, _) => Row::Sample { line: self.line, stamp_ns: None, sample },
        }
    }
}

impl Rows for VnRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        while self.read_line()? {
            if !self.bytes.trim_ascii().is_empty() {
                return Ok(Some(self.understand()));
            }
        }
        Ok(None)
    }
    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}

/// What stands before a message.
enum Prefix {
    Empty,
    Stamp(i64),
    Text,
}

fn stamp(prefix: &[u8]) -> Prefix {
    let Ok(text) = std::str::from_utf8(prefix) else { return Prefix::Text };
    let words = text.split(|c: char| c.is_whitespace() || c == ',' || c == ';').filter(|word| !word.is_empty());
    words.fold(Prefix::Empty, |before, word| match (before, parse_seconds(word)) {
        (Prefix::Text, _) | (_, None) => Prefix::Text,
        (_, Some(nanos)) => Prefix::Stamp(nanos),
    })
}

/// Reads a message from its `$`.
fn measurement(message: &[u8], decimals: &mut Decimals) -> Message {
    use crate::sample::{Channel, Triad};
    let bad = |cause| Message::Bad(cause);
    let Ok(text) = std::str::from_utf8(message) else { return bad(DiscardCause::Checksum) };
    let Some((body, sum)) = text[1..].split_once('*') else { return bad(DiscardCause::Checksum) };
    let xor = body.bytes().fold(0, |sum, byte| sum ^ byte);
    if u8::from_str_radix(sum, 16) != Ok(xor) {
        return bad(DiscardCause::Checksum);
    }
    let mut fields = body.split(',');
    let triads: &[Triad] = match fields.next() {
        Some("VNYMR") => &[Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro],
        Some("VNMAR" | "VNIMU") => &[Triad::Mag, Triad::Accel, Triad::Gyro],
        _ => return Message::Other,
    };
    let mut sample = Sample::at(0, 0);
    for channel in triads.iter().flat_map(|triad| triad.channels()).collect::<Vec<Channel>>() {
        let Some(text) = fields.next() else { return bad(DiscardCause::Malformed) };
        let Ok(value) = text.parse() else { return bad(DiscardCause::Malformed) };
        decimals.note(channel, text);
        sample.set(channel, value);
    }
    Message::Measurement(sample)
}
