//! The decoder: converts bytes in any division to [`Event`]s.
//!
//! In: the bytes that the port delivers. Out: events in the order of the bytes, borrowed from the decoder's buffer.
//!
//! Guarantees:
//! - The events depend on the bytes alone, not on how they were split into [`Decoder::push`] calls.
//! - A candidate (a sync byte with what follows) that fails costs one byte: the search continues behind its first byte,
//!   so that a broken binary frame never hides a line inside its length.
//! - `bytes_in = frame_bytes + garbage_bytes + pending()`, always.
//! - Memory is bounded; nothing is allocated per frame.
//!
//! A failure counts as one frame with [`DiscardCause::Checksum`] if the candidate has the head of a frame. That is a
//! line that begins with `$VN`, a known word and `,` or `*`, or a binary header that a VN-100 can send (with
//! [`BinaryAcceptance::Only`]: the one header). Without `Only`, candidates inside the length of one that was already
//! counted do not count again: payload bytes sometimes look like a header. A right checksum with wrong fields is one
//! frame with [`DiscardCause::Malformed`]. In both cases the bytes themselves are garbage and are reported as such when
//! they are skipped. A frame that is not complete yet is pending, not an error.

use super::ascii::{self, MAX_LINE_BYTES};
use super::binary::{CRC_BYTES, HeaderBytes, SYNC};
use super::fields::{read_fields, read_payload};
use super::measurement::{Measurement, MeasurementKind};
use super::{AsciiType, BinaryHeader, DeviceError, Reply, Verb, checksum};
use imu_core::sample::DiscardCause;

/// Longest run of garbage that one event reports; a longer run is reported in pieces of this many bytes.
pub const GARBAGE_RUN_BYTES: usize = 256;
/// Bytes taken from the input at a time.
const CHUNK_BYTES: usize = 4096;

/// The binary frames to search for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BinaryAcceptance {
    /// Every header that a VN-100 can send: to detect the output. In 1 MB of random bytes about 0.06 frames are
    /// expected to pass by chance.
    #[default]
    Any,
    /// Only this header: for capturing. 3.6e-9 false frames per MB of random bytes.
    Only(BinaryHeader),
    /// None: a sensor that sends lines.
    Never,
}

/// Options of the decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderOptions {
    /// The binary frames to search for.
    pub binary: BinaryAcceptance,
}

/// The result of decoding.
#[derive(Debug, PartialEq)]
pub enum Event<'a> {
    /// A measurement.
    Measurement(&'a Measurement),
    /// A reply to a command.
    Reply(Reply<'a>),
    /// An error that the sensor reports.
    DeviceError(DeviceError),
    /// A line with a right checksum that is of no other kind here; without `$` and checksum.
    Other(&'a str),
    /// Bytes that are not usable.
    Rejected {
        /// [`DiscardCause::Checksum`] or [`DiscardCause::Malformed`]: one frame, whose bytes follow as garbage.
        /// [`DiscardCause::GarbageBytes`]: bytes of no frame, at most [`GARBAGE_RUN_BYTES`] of them.
        cause: DiscardCause,
        /// The bytes.
        bytes: &'a [u8],
    },
}

/// The totals of a decoder since its creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderStats {
    /// Bytes pushed.
    pub bytes_in: u64,
    /// Good binary frames.
    pub frames: u64,
    /// Good lines: measurements, replies, errors, others.
    pub lines: u64,
    /// Bytes of good frames and lines, line ends included.
    pub frame_bytes: u64,
    /// Frames and lines with a wrong checksum or that were cut.
    pub bad_checksums: u64,
    /// Lines with a right checksum and wrong fields.
    pub malformed: u64,
    /// Bytes of no good frame.
    pub garbage_bytes: u64,
}

/// The content at a candidate's place.
enum Found<'a> {
    /// More bytes are needed: this many from the candidate's first on.
    Incomplete(usize),
    /// No message; if it has the head of a frame, with its cause and length.
    Nothing(Option<(DiscardCause, usize)>),
    /// A message of this length.
    Something(Message<'a>, usize),
}

enum Message<'a> {
    Frame,
    Line,
    Reply(Reply<'a>),
    DeviceError(DeviceError),
    Other(&'a str),
}

/// Finds frames and lines in a stream of bytes.
#[derive(Debug, Clone)]
pub struct Decoder {
    binary: BinaryAcceptance,
    /// Bytes not reported yet: a run of garbage, then the candidate and what follows it.
    buffer: Vec<u8>,
    /// The position of the candidate in `buffer`.
    at: usize,
    /// The candidate cannot be decided before this many of its bytes are present.
    need: usize,
    /// This many bytes of a candidate line are known to be text.
    scanned: usize,
    /// Position in the stream of `buffer`'s first byte.
    position: u64,
    /// Position in the stream where the binary candidate that was counted last would have ended.
    counted_until: u64,
    stats: DecoderStats,
    measurement: Measurement,
}

impl Decoder {
    /// Creates a decoder at the start of a stream.
    pub fn new(options: DecoderOptions) -> Self {
        Self {
            binary: options.binary,
            buffer: Vec::with_capacity(2 * CHUNK_BYTES),
            at: 0,
            need: 0,
            scanned: 0,
            position: 0,
            counted_until: 0,
            stats: DecoderStats::default(),
            measurement: Measurement::new(MeasurementKind::Ascii(AsciiType::Ypr)),
        }
    }

    /// Changes the binary frames to search for, from the bytes that are still pending on.
    pub fn accept_binary(&mut self, binary: BinaryAcceptance) {
        self.binary = binary;
        self.need = 0;
    }

    /// Returns the totals so far.
    pub fn stats(&self) -> DecoderStats {
        self.stats
    }

    /// Returns the number of bytes that are not decided or not reported yet: a run of garbage shorter than
    /// [`GARBAGE_RUN_BYTES`] and the candidate behind it.
    pub fn pending(&self) -> usize {
        self.buffer.len()
    }

    /// Takes bytes and reports the events that they complete.
    pub fn push(&mut self, bytes: &[u8], sink: &mut impl FnMut(Event<'_>)) {
        self.stats.bytes_in += bytes.len() as u64;
        for chunk in bytes.chunks(CHUNK_BYTES) {
            self.buffer.extend_from_slice(chunk);
            self.advance(sink, false);
        }
    }

    /// Ends the stream (the port is closed, a reply did not arrive): incomplete messages will not be completed. Good
    /// frames behind an incomplete one are still reported; everything else that was pending is garbage. The decoder is
    /// ready for a new stream; the statistics continue.
    pub fn flush(&mut self, sink: &mut impl FnMut(Event<'_>)) {
        self.advance(sink, true);
    }

    /// Processes the buffer as far as it can be decided.
    fn advance(&mut self, sink: &mut impl FnMut(Event<'_>), ended: bool) {
        let length = self.buffer.len();
        // first byte not reported yet
        let mut start = 0;
        loop {
            let rest = self.buffer.get(self.at..).unwrap_or_default();
            let skipped = rest.iter().position(|byte| *byte == SYNC || *byte == b'$').unwrap_or(rest.len());
            if skipped > 0 {
                (self.need, self.scanned) = (0, 0);
                self.at += skipped;
            }
            while self.at - start >= GARBAGE_RUN_BYTES {
                reject_garbage(&mut self.stats, sink, &self.buffer, start..start + GARBAGE_RUN_BYTES);
                start += GARBAGE_RUN_BYTES;
            }
            if self.at >= length || (!ended && length - self.at < self.need) {
                break;
            }
            let candidate = self.buffer.get(self.at..).unwrap_or_default();
            let found = if candidate.first() == Some(&SYNC) {
                examine_frame(candidate, self.binary, &mut self.measurement)
            } else {
                examine_line(candidate, &mut self.scanned, &mut self.measurement)
            };
            let counted = match found {
                Found::Incomplete(need) if !ended => {
                    self.need = need;
                    break;
                }
                Found::Incomplete(_) => None,
                Found::Nothing(counted) => counted,
                Found::Something(message, length) => {
                    if start < self.at {
                        reject_garbage(&mut self.stats, sink, &self.buffer, start..self.at);
                    }
                    self.stats.frame_bytes += length as u64;
                    let lines = &mut self.stats.lines;
                    match message {
                        Message::Frame => {
                            self.stats.frames += 1;
                            sink(Event::Measurement(&self.measurement));
                        }
                        Message::Line => {
                            *lines += 1;
                            sink(Event::Measurement(&self.measurement));
                        }
                        Message::Reply(reply) => {
                            *lines += 1;
                            sink(Event::Reply(reply));
                        }
                        Message::DeviceError(error) => {
                            *lines += 1;
                            sink(Event::DeviceError(error));
                        }
                        Message::Other(body) => {
                            *lines += 1;
                            sink(Event::Other(body));
                        }
                    }
                    self.at += length;
                    start = self.at;
                    (self.need, self.scanned) = (0, 0);
                    continue;
                }
            };
            if let Some((cause, length)) = counted {
                let position = self.position + self.at as u64;
                let doubtful = candidate.first() == Some(&SYNC) && !matches!(self.binary, BinaryAcceptance::Only(_));
                if !doubtful || position >= self.counted_until {
                    match cause {
                        DiscardCause::Malformed => self.stats.malformed += 1,
                        _ => self.stats.bad_checksums += 1,
                    }
                    sink(Event::Rejected { cause, bytes: candidate.get(..length).unwrap_or(candidate) });
                    if doubtful {
                        self.counted_until = position + length as u64;
                    }
                }
            }
            self.at += 1;
            (self.need, self.scanned) = (0, 0);
        }
        if ended {
            while start < length {
                let end = length.min(start + GARBAGE_RUN_BYTES);
                reject_garbage(&mut self.stats, sink, &self.buffer, start..end);
                start = end;
            }
            (self.at, self.need, self.scanned) = (length, 0, 0);
        }
        self.buffer.drain(..start);
        self.at -= start;
        self.position += start as u64;
    }
}

fn reject_garbage(
    stats: &mut DecoderStats,
    sink: &mut impl FnMut(Event<'_>),
    buffer: &[u8],
    range: std::ops::Range<usize>,
) {
    let bytes = buffer.get(range).unwrap_or_default();
    stats.garbage_bytes += bytes.len() as u64;
    sink(Event::Rejected { cause: DiscardCause::GarbageBytes, bytes });
}

/// Examines a candidate that begins with the sync byte.
fn examine_frame<'a>(candidate: &[u8], acceptance: BinaryAcceptance, measurement: &mut Measurement) -> Found<'a> {
    let header = match (acceptance, BinaryHeader::read(candidate)) {
        (BinaryAcceptance::Never, _) | (_, HeaderBytes::Invalid) => return Found::Nothing(None),
        (_, HeaderBytes::Incomplete(need)) => return Found::Incomplete(need),
        (BinaryAcceptance::Only(only), HeaderBytes::Header(header)) if header != only => return Found::Nothing(None),
        (_, HeaderBytes::Header(header)) => header,
    };
    let length = header.frame_bytes();
    let Some(frame) = candidate.get(..length) else { return Found::Incomplete(length) };
    // over everything behind the sync byte, CRC included, the CRC is 0
    if checksum::crc16(frame.get(1..).unwrap_or_default()) != 0 {
        return Found::Nothing(Some((DiscardCause::Checksum, length)));
    }
    *measurement = Measurement::new(MeasurementKind::Binary(header));
    let payload = frame.get(header.header_bytes()..length - CRC_BYTES).unwrap_or_default();
    read_payload(measurement, &header, payload);
    Found::Something(Message::Frame, length)
}

/// Known words of a line, besides the measurements and verbs.
const ERROR_HEADER: &[u8] = b"VNERR";
/// `VN` and three letters.
const HEADER_BYTES: usize = 5;

fn is_known_header(header: &[u8]) -> bool {
    AsciiType::from_header(header).is_some() || Verb::from_header(header).is_some() || header == ERROR_HEADER
}

/// Examines a candidate that begins with `$`.
fn examine_line<'a>(candidate: &'a [u8], scanned: &mut usize, measurement: &mut Measurement) -> Found<'a> {
    const PREFIX: &[u8] = b"$VN";
    let Some(prefix) = candidate.get(..PREFIX.len()) else {
        return if PREFIX.starts_with(candidate) { Found::Incomplete(PREFIX.len()) } else { Found::Nothing(None) };
    };
    if prefix != PREFIX {
        return Found::Nothing(None);
    }
    let window = candidate.get(..MAX_LINE_BYTES).unwrap_or(candidate);
    let end = PREFIX.len().max(*scanned);
    let end = end + text_bytes(window.get(end..).unwrap_or_default());
    *scanned = end;
    let line = window.get(..end).unwrap_or(window);
    // a line that began as one of ours and does not end as one is a damaged or cut frame
    let damaged = |length: usize| {
        let header = line.get(1..=HEADER_BYTES).unwrap_or_default();
        let known = matches!(line.get(HEADER_BYTES + 1), Some(b',' | b'*')) && is_known_header(header);
        Found::Nothing(known.then_some((DiscardCause::Checksum, length)))
    };
    let length = match window.get(end..).unwrap_or_default() {
        [b'\n', ..] => end + 1,
        [b'\r', b'\n', ..] => end + 2,
        [] | [b'\r'] if window.len() < MAX_LINE_BYTES => return Found::Incomplete(window.len() + 1),
        _ => return damaged(end),
    };
    let Some((body, trailer)) = ascii::split_line(line) else { return damaged(length) };
    if !trailer.matches(body) {
        return damaged(length);
    }
    match read_body(body, measurement) {
        Some(message) => Found::Something(message, length),
        None => Found::Nothing(Some((DiscardCause::Malformed, length))),
    }
}

/// Returns the number of bytes from the start that are text of a line: printable, and not the `$` of the next one.
fn text_bytes(bytes: &[u8]) -> usize {
    let is_text = |byte: &u8| matches!(byte, b' '..=b'~') && *byte != b'$';
    let (blocks, _) = bytes.as_chunks::<16>();
    // whole blocks first: without an early exit per byte the compiler examines all sixteen at once
    let whole = blocks.iter().take_while(|block| block.iter().fold(true, |all, byte| all & is_text(byte))).count() * 16;
    let rest = bytes.get(whole..).unwrap_or_default();
    whole + rest.iter().position(|byte| !is_text(byte)).unwrap_or(rest.len())
}

/// Parses the body of a line with a right checksum; `None` if its fields do not match its header.
fn read_body<'a>(body: &'a [u8], measurement: &mut Measurement) -> Option<Message<'a>> {
    let comma = body.iter().position(|byte| *byte == b',').unwrap_or(body.len());
    let (header, rest) = body.split_at_checked(comma)?;
    let fields = rest.get(1..).unwrap_or_default();
    if let Some(ascii) = AsciiType::from_header(header) {
        *measurement = Measurement::new(MeasurementKind::Ascii(ascii));
        read_fields(measurement, ascii, fields)?;
        return Some(Message::Line);
    }
    let text = std::str::from_utf8(body).ok()?;
    if Verb::from_header(header).is_some() {
        return Reply::parse(text).map(Message::Reply);
    }
    if header == ERROR_HEADER {
        let code = std::str::from_utf8(fields).ok()?;
        return DeviceError::from_text(code).map(Message::DeviceError);
    }
    Some(Message::Other(text))
}
