//! Raw `$VN…` lines, as a terminal program or a logging driver wrote them.
//!
//! A line is `[stamp …] $VN…*checksum`. Before the `$`, numbers separated by tabs, spaces, commas or semicolons are stamps
//! in seconds; of several the last one counts: drivers write the time of reception first and then the time they assigned
//! to the measurement, which is the smoother of the two. Other text there is ignored and named.
//!
//! The checksum decides, by the same decoder that reads a port: a line whose checksum fails is rejected, nothing in it is
//! guessed at; only a complete good message behind a spliced one is still a sample. Valid messages without a measurement
//! (replies to commands) are passed over, measurements of none of our channels rejected. The first measurement decides
//! whether the recording has stamps; a later one without is rejected.

use super::detect::{open, read_error};
use super::error::RecordingError;
use super::info::Decimals;
use super::rows::{Rejected, Row, Rows};
use super::stamps::parse_seconds;
use crate::protocol::{BinaryAcceptance, Decoder, DecoderOptions, Event};
use crate::sample::{DiscardCause, Sample};
use std::io::{BufRead, Read};
use std::path::{Path, PathBuf};

/// Longest line that is kept together; what follows is read as another line. Messages are shorter than 300 bytes.
const LINE_BYTES: u64 = 4096;
/// What every message begins with.
const START: &[u8] = b"$VN";
/// Name, in the list of ignored columns, of text before the message that is no stamp.
const UNREAD_PREFIX: &str = "text before $VN";

/// What a line's message says.
enum Message {
    /// A measurement with its values.
    Measurement(Sample),
    /// Something else that is valid.
    Other,
    /// Nothing that can be used.
    Nothing,
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
    decoder: Decoder,
    /// What is still to be given of the line read last.
    waiting: Option<Row>,
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
            decoder: Decoder::new(DecoderOptions { binary: BinaryAcceptance::Never }),
            waiting: None,
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

    /// The line's outcome. A line in which a good message follows a spliced one is both rejected and a sample: the sample
    /// waits.
    fn understand(&mut self) -> Row {
        let line = self.bytes.trim_ascii();
        let number = self.line;
        let rejected = |cause, stands_for_sample| {
            Row::Rejected(Rejected::new(number, cause, &String::from_utf8_lossy(line), stands_for_sample))
        };
        let Some(start) = line.windows(START.len()).position(|window| window == START) else {
            return rejected(DiscardCause::GarbageBytes, false);
        };
        let (prefix, message) = line.split_at(start);
        let (message, bad) = read_message(message, &mut self.decoder, &mut self.decimals);
        let bad = bad.map(|cause| rejected(cause, true));
        let sample = match message {
            Message::Measurement(sample) if sample.channels().is_empty() => {
                return rejected(DiscardCause::UnexpectedFormat, false);
            }
            Message::Measurement(sample) => sample,
            Message::Other => return bad.unwrap_or(Row::Aside),
            Message::Nothing => return bad.unwrap_or_else(|| rejected(DiscardCause::GarbageBytes, false)),
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
        let row = match (*self.stamped.get_or_insert(stamp_ns.is_some()), stamp_ns) {
            (true, None) => rejected(DiscardCause::Malformed, true),
            (true, Some(_)) => Row::Sample { line: number, stamp_ns, sample },
            (false, _) => Row::Sample { line: number, stamp_ns: None, sample },
        };
        match bad {
            Some(bad) => {
                self.waiting = Some(row);
                bad
            }
            None => row,
        }
    }
}

impl Rows for VnRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        if let Some(row) = self.waiting.take() {
            return Ok(Some(row));
        }
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

/// Reads a line from its `$`: what it says, and why a part of it was rejected.
fn read_message(line: &[u8], decoder: &mut Decoder, decimals: &mut Decimals) -> (Message, Option<DiscardCause>) {
    let (mut message, mut bad) = (Message::Nothing, None);
    let mut take = |event: Event<'_>| match event {
        Event::Measurement(measurement) => {
            let sample = measurement.to_sample(0, 0);
            for channel in sample.channels().iter() {
                decimals.note_count(channel, measurement.decimals(channel));
            }
            message = Message::Measurement(sample);
        }
        // The bytes of what was rejected follow as garbage; they count once.
        Event::Rejected { cause: DiscardCause::GarbageBytes, .. } => {}
        Event::Rejected { cause, .. } => bad = bad.or(Some(cause)),
        _ => message = Message::Other,
    };
    decoder.push(line, &mut take);
    decoder.push(b"\r\n", &mut take);
    // Lines are read one by one: nothing of one may complete another.
    decoder.flush(&mut take);
    (message, bad)
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
