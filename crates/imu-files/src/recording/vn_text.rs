//! Raw `$VN…` lines, as a terminal program or a logging driver wrote them.
//!
//! A line is `[stamp …] $VN…*checksum`. Before the `$`, numbers and dates separated by tabs, spaces, commas or semicolons
//! are stamps ([`super::vn_stamps`]); [`super::choice`] selects one of several. Other text there is ignored and reported.
//!
//! The checksum decides, by the same decoder that reads a port. A line whose checksum fails is rejected, and nothing in
//! it is guessed. Only a complete good message behind a spliced one is still a sample. Valid messages without a
//! measurement (replies to commands) are skipped, and measurements of other channels than ours are rejected. Every line
//! must have as many stamps as most lines have: one with fewer is rejected.

use super::error::{RecordingError, read_error};
use super::header::foreign_names;
use super::input::Input;
use super::rows::{Decimals, Rejected, Row, Rows};
use super::vn_stamps::{LINE_BYTES, START, Units};
use imu_core::sample::{DiscardCause, Sample};
use std::io::{BufRead, Read};
use std::path::PathBuf;
use vn100_proto::{BinaryAcceptance, Decoder, DecoderOptions, Event};

/// The name of text before the message that is no stamp, in the list of ignored columns.
const UNREAD_PREFIX: &str = "text before $VN";

/// The content of a line's message.
pub(super) enum Message {
    /// A measurement with its values.
    Measurement(Sample),
    /// Another valid message.
    Other,
    /// No usable message.
    Nothing,
}

/// The lines of a file of raw messages, one at a time.
pub(super) struct VnRows {
    file: PathBuf,
    reader: Box<dyn BufRead>,
    line: u64,
    bytes: Vec<u8>,
    /// The number of stamps of a measurement; `None` accepts any number.
    stamp_count: Option<usize>,
    units: Units,
    ignored: Vec<String>,
    decimals: Decimals,
    decoder: Decoder,
    /// The row of the line read last that is still to be returned.
    waiting: Option<Row>,
}

impl VnRows {
    pub(super) fn open(input: &Input, stamp_count: Option<usize>) -> Result<Self, RecordingError> {
        Ok(Self {
            file: input.path().to_owned(),
            reader: input.open()?,
            line: 0,
            bytes: Vec::new(),
            stamp_count,
            units: Units::of(input)?,
            ignored: Vec::new(),
            decimals: Decimals::default(),
            decoder: line_decoder(),
            waiting: None,
        })
    }

    /// Returns the ignored parts of the lines read so far.
    pub(super) fn ignored(&self) -> &[String] {
        &self.ignored
    }

    /// Returns the unit of a column of stamps, if it is not seconds.
    pub(super) fn unit(&self, column: usize) -> Option<&'static str> {
        self.units.name(column)
    }

    /// Reads one line into `bytes`; returns whether there was one.
    fn read_line(&mut self) -> Result<bool, RecordingError> {
        self.bytes.clear();
        let read = self.reader.by_ref().take(LINE_BYTES).read_until(b'\n', &mut self.bytes);
        let read = read.map_err(|source| read_error(&self.file, self.line, source))?;
        self.line += 1;
        Ok(read > 0)
    }

    /// Returns the line's outcome. A line in which a good message follows a spliced one is both rejected and a sample:
    /// the sample waits.
    fn understand(&mut self) -> Row {
        let line = self.bytes.trim_ascii();
        let number = self.line;
        let rejected = |cause, stands_for_sample| Rejected::of_line(number, cause, line, stands_for_sample);
        let garbage = |cause| rejected(cause, false);
        let Some(start) = line.windows(START.len()).position(|window| window == START) else {
            // The end of a quoted cell that holds the message's line end, or the header of a table of messages.
            let is_rest = line.iter().all(|byte| matches!(byte, b'"' | b'\''));
            // A row of numbers is no header.
            let is_word = |names: Vec<String>| names.iter().any(|name| name.contains(char::is_alphabetic));
            let is_header = || number == 1 && foreign_names(&String::from_utf8_lossy(line)).is_some_and(is_word);
            if is_rest || is_header() {
                return Row::Aside;
            }
            return Row::Rejected(garbage(DiscardCause::GarbageBytes));
        };
        let (prefix, message) = line.split_at(start);
        let message = unquoted(message);
        let (message, bad) = read_message(message, &mut self.decoder, &mut self.decimals);
        let (stamps, is_text) = self.units.stamps(prefix);
        let bad = bad.map(|cause| rejected(cause, true));
        let sample = match message {
            Message::Measurement(sample) if sample.channels().is_empty() => {
                return Row::Rejected(garbage(DiscardCause::UnexpectedFormat));
            }
            Message::Measurement(sample) => sample,
            // Only the rejected part belongs to the line's stamps.
            Message::Other => return bad.map_or(Row::Aside, |bad| Row::Rejected(bad.stamped(stamps))),
            Message::Nothing => {
                let bad = bad.map(|bad| bad.stamped(stamps));
                return Row::Rejected(bad.unwrap_or_else(|| garbage(DiscardCause::GarbageBytes)));
            }
        };
        if is_text && self.stamp_count == Some(0) && self.ignored.is_empty() {
            self.ignored.push(UNREAD_PREFIX.to_owned());
        }
        let row = match self.stamp_count {
            Some(count) if stamps.count() < count => Row::Rejected(rejected(DiscardCause::Malformed, true)),
            _ => Row::Sample { line: number, stamps, sample },
        };
        match bad {
            Some(bad) => {
                self.waiting = Some(row);
                Row::Rejected(bad)
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

/// Returns a decoder of single lines.
pub(super) fn line_decoder() -> Decoder {
    Decoder::new(DecoderOptions { binary: BinaryAcceptance::Never })
}

/// Reads a line from its `$`: returns its content, and why a part of it was rejected.
pub(super) fn read_message(
    line: &[u8],
    decoder: &mut Decoder,
    decimals: &mut Decimals,
) -> (Message, Option<DiscardCause>) {
    let (mut message, mut bad) = (Message::Nothing, None);
    let mut take = |event: Event<'_>| match event {
        Event::Measurement(measurement) => {
            let sample = measurement.to_sample(0, 0);
            for channel in sample.channels().iter() {
                decimals.note_count(channel, measurement.decimals(channel));
            }
            message = Message::Measurement(sample);
        }
        // The bytes of a rejected message follow as garbage; they count once.
        Event::Rejected { cause: DiscardCause::GarbageBytes, .. } => {}
        Event::Rejected { cause, .. } => bad = bad.or(Some(cause)),
        _ => message = Message::Other,
    };
    decoder.push(line, &mut take);
    decoder.push(b"\r\n", &mut take);
    // Lines are read one by one: a part of one must not complete another.
    decoder.flush(&mut take);
    (message, bad)
}

/// Returns a message without the quotation marks and the written-out line end behind it, which it has if it came from a
/// table's cell.
fn unquoted(message: &[u8]) -> &[u8] {
    let bare =
        |message: &'_ [u8]| message.len() - message.iter().rev().take_while(|byte| b"\"'".contains(byte)).count();
    let message = &message[..bare(message)];
    let message = message.strip_suffix(br"\n").unwrap_or(message);
    message.strip_suffix(br"\r").unwrap_or(message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_first_line_of_numbers_is_counted_and_a_header_is_not() {
        let first = |text: &str| VnRows::open(&Input::memory("a", text.as_bytes()), None).unwrap().next_row().unwrap();
        assert!(matches!(first("1,2,3,4,5\n"), Some(Row::Rejected(_))));
        assert!(matches!(first("time,data\n"), Some(Row::Aside)));
    }
}
