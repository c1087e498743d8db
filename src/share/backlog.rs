//! Backlog: the bytes that a reader has not taken yet. Pure.
//!
//! In: the bytes of the port, as they were read. Out: the same bytes in the same order. If more than [`LIMIT_BYTES`]
//! wait, all whole frames among them are dropped: the frame that was begun is completed, and the newest one follows. So
//! a slow reader misses frames, but never sees half of one.

use std::collections::VecDeque;
use vn100_proto::{Decoder, DecoderOptions};

/// The maximum number of bytes that wait for a reader: 1.2 s of 70-byte frames at 800 Hz.
pub const LIMIT_BYTES: usize = 64 << 10;
/// Bytes between which a border between frames is looked for.
const PIECE_BYTES: usize = 256;

/// The bytes that wait, and the places at which they may be cut.
#[derive(Debug)]
pub struct Backlog {
    bytes: VecDeque<u8>,
    /// The position of the first byte that waits.
    start: u64,
    /// The position behind the last byte.
    end: u64,
    /// Positions between two frames, from `start` on, in ascending order.
    borders: VecDeque<u64>,
    /// Finds the frames; the values do not matter.
    decoder: Decoder,
}

impl Default for Backlog {
    fn default() -> Self {
        Self {
            bytes: VecDeque::new(),
            start: 0,
            end: 0,
            borders: VecDeque::from([0]),
            decoder: Decoder::new(DecoderOptions::default()),
        }
    }
}

impl Backlog {
    /// Takes bytes; returns how many of those that waited were dropped.
    pub fn push(&mut self, bytes: &[u8]) -> u64 {
        for piece in bytes.chunks(PIECE_BYTES) {
            self.bytes.extend(piece);
            self.end += piece.len() as u64;
            self.decoder.push(piece, &mut |_| ());
            // What is pending may become a frame; everything before it is decided.
            let border = self.end - self.decoder.pending() as u64;
            if border >= self.start && self.borders.back().is_none_or(|last| *last < border) {
                self.borders.push_back(border);
            }
        }
        if self.bytes.len() > LIMIT_BYTES { self.drop_frames() } else { 0 }
    }

    /// Returns bytes that wait, the first ones.
    pub fn front(&self) -> &[u8] {
        self.bytes.as_slices().0
    }

    /// Removes bytes that were written.
    pub fn took(&mut self, count: usize) {
        self.bytes.drain(..count.min(self.bytes.len()));
        self.start = self.end - self.bytes.len() as u64;
        while self.borders.front().is_some_and(|border| *border < self.start) {
            self.borders.pop_front();
        }
    }

    /// Removes everything before the present frame: nobody reads, and who begins to read begins with a frame.
    pub fn skip(&mut self) {
        if let Some(border) = self.borders.back() {
            self.took((border - self.start) as usize);
        }
    }

    /// Drops the whole frames that wait, and returns their number of bytes.
    fn drop_frames(&mut self) -> u64 {
        let (Some(from), Some(to)) = (self.borders.front().copied(), self.borders.back().copied()) else { return 0 };
        let at = |position: u64| (position - self.start) as usize;
        self.bytes.drain(at(from)..at(to));
        // Positions behind the cut move to it.
        self.end -= to - from;
        self.borders = VecDeque::from([from]);
        to - from
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use vn100_proto::Event;

    /// Returns lines of a sensor, each with another value.
    fn lines(numbers: std::ops::Range<u32>) -> Vec<u8> {
        let line = |number: u32| {
            let body = format!("VNGYR,+00.{number:06},+00.000000,-00.000001");
            let sum = body.bytes().fold(0_u8, |sum, byte| sum ^ byte);
            format!("${body}*{sum:02X}\r\n")
        };
        numbers.map(line).collect::<String>().into_bytes()
    }

    /// Returns the number of whole frames, and of bytes that belong to none.
    fn decoded(bytes: &[u8]) -> (usize, usize) {
        let (mut frames, mut garbage) = (0, 0);
        let mut decoder = Decoder::new(DecoderOptions::default());
        let mut count = |event: Event<'_>| match event {
            Event::Measurement(_) => frames += 1,
            Event::Rejected { bytes, .. } => garbage += bytes.len(),
            _ => {}
        };
        decoder.push(bytes, &mut count);
        decoder.flush(&mut count);
        (frames, garbage)
    }

    fn taken(backlog: &mut Backlog, most: usize) -> Vec<u8> {
        let bytes: Vec<u8> = backlog.front().iter().copied().take(most).collect();
        backlog.took(bytes.len());
        bytes
    }

    #[test]
    fn a_reader_that_keeps_up_gets_every_byte() {
        let stream = [&b"\xfa garbage, and"[..], &lines(0..2000), b"$VNGYR,cut"].concat();
        let (mut backlog, mut received) = (Backlog::default(), Vec::new());
        for part in stream.chunks(777) {
            assert_eq!(backlog.push(part), 0);
            while !backlog.front().is_empty() {
                received.extend(taken(&mut backlog, 100));
            }
        }
        assert_eq!(received, stream);
    }

    #[test]
    fn who_begins_to_read_begins_with_a_frame() {
        let stream = lines(0..100);
        let mut backlog = Backlog::default();
        backlog.push(&stream[..1000]);
        backlog.skip();
        backlog.push(&stream[1000..]);
        let mut rest = Vec::new();
        while !backlog.front().is_empty() {
            rest.extend(taken(&mut backlog, usize::MAX));
        }
        assert!(rest.starts_with(b"$VNGYR") && stream.ends_with(&rest), "{}", rest.len());
        assert!(rest.len() + 1000 < stream.len() + PIECE_BYTES + 64, "{}", rest.len());
    }

    proptest! {
        /// However slowly a reader takes the bytes, it sees whole frames, and the bytes add up.
        #[test]
        fn a_slow_reader_misses_whole_frames(parts in prop::collection::vec((1_usize..5000, 0_usize..3000), 60..200)) {
            let stream = lines(0..20_000);
            let (mut backlog, mut received, mut at, mut dropped) = (Backlog::default(), Vec::new(), 0, 0);
            for (push, take) in parts {
                let end = stream.len().min(at + push);
                dropped += backlog.push(&stream[at..end]);
                at = end;
                prop_assert!(backlog.bytes.len() <= LIMIT_BYTES);
                received.extend(taken(&mut backlog, take));
            }
            while !backlog.front().is_empty() {
                received.extend(taken(&mut backlog, usize::MAX));
            }
            prop_assert_eq!(received.len() + dropped as usize, at);
            let (frames, garbage) = decoded(&received);
            // Only the frame that the stream has not completed yet.
            prop_assert!(garbage < 64, "{} frames, {} bytes of none", frames, garbage);
        }
    }
}
