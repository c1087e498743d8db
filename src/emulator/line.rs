//! Line: determines the fate of each frame between the sensor and the terminal. Pure.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vn100_proto::binary::SYNC;

/// The maximum number of random bytes before one frame: more would delay the stream by more than a frame at 115200
/// baud.
const GARBAGE_AT_ONCE: u64 = 512;

/// A frame of measurements that the sensor made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Its number, from 0 in the order of creation.
    pub number: u64,
    /// The tick of its creation, counted from the start of the emulator.
    pub tick: u64,
    /// TimeStartup, ns.
    pub device_time_ns: u64,
    /// Its length.
    pub bytes: usize,
}

/// The fate of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Fate {
    /// The frame is in the terminal, complete and in its order.
    Sent,
    /// The frame is in the terminal, complete, after a delay.
    Held,
    /// The frame is in the terminal twice.
    Duplicated,
    /// The frame is in the terminal, complete, after the following frame.
    Reordered,
    /// The frame is in the terminal with a flipped bit.
    Garbled,
    /// The frame is in the terminal at another baud rate than the terminal's.
    WrongBaud,
    /// The frame was omitted.
    Dropped,
    /// The sensor was silent.
    Silent,
    /// There was no terminal.
    Unplugged,
    /// The terminal accepted nothing, or only a part: it is not being read.
    Overrun,
}

impl Fate {
    /// Returns the word for this fate in the log.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// Bytes for the terminal, or a frame that is not sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Piece {
    /// The bytes to send; empty for a frame that is not sent.
    pub bytes: Vec<u8>,
    /// The frame, and its fate once it is in the terminal. `None` for replies and noise.
    pub frame: Option<(Frame, Fate)>,
}

/// The present faults of a line.
#[derive(Debug)]
pub struct Line {
    /// Number of random bytes still to be sent.
    pub garbage: u64,
    /// Number of frames still to be garbled.
    pub checksum: u64,
    /// Number of frames still to be omitted.
    pub drop: u64,
    /// Number of frames still to be sent twice.
    pub duplicate: u64,
    /// Number of pairs still to be swapped.
    pub reorder: u64,
    /// Nothing is sent or received before this tick.
    pub silent_until: u64,
    /// Bytes are kept until this tick.
    pub hold_until: u64,
    kept_back: Option<Piece>,
    made: u64,
    random: ChaCha8Rng,
}

impl Line {
    /// Creates a line without faults; `seed` determines the bits and the noise of its faults.
    pub fn new(seed: u64) -> Self {
        Self {
            garbage: 0,
            checksum: 0,
            drop: 0,
            duplicate: 0,
            reorder: 0,
            silent_until: 0,
            hold_until: 0,
            kept_back: None,
            made: 0,
            random: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// Returns whether the sensor is silent at this tick.
    pub fn is_silent(&self, tick: u64) -> bool {
        tick < self.silent_until
    }

    /// Sends a frame; `there` states whether the line has a terminal.
    pub fn frame(&mut self, tick: u64, device_time_ns: u64, bytes: &[u8], there: bool, out: &mut Vec<Piece>) {
        let frame = Frame { number: self.made, tick, device_time_ns, bytes: bytes.len() };
        self.made += 1;
        let lost = |fate| Piece { bytes: Vec::new(), frame: Some((frame, fate)) };
        if !there {
            // A frame that was kept back has missed its terminal as well.
            out.extend(self.kept_back.take().map(|piece| Piece {
                bytes: Vec::new(),
                frame: piece.frame.map(|(frame, _)| (frame, Fate::Unplugged)),
            }));
            out.push(lost(Fate::Unplugged));
            return;
        }
        if self.is_silent(tick) {
            out.push(lost(Fate::Silent));
            return;
        }
        if self.garbage > 0 {
            let mut bytes = vec![0; self.garbage.min(GARBAGE_AT_ONCE) as usize];
            self.random.fill_bytes(&mut bytes);
            self.garbage -= bytes.len() as u64;
            out.push(Piece { bytes, frame: None });
        }
        let sent = |bytes: &[u8], fate| Piece { bytes: bytes.to_vec(), frame: Some((frame, fate)) };
        if take(&mut self.drop) {
            out.push(lost(Fate::Dropped));
        } else if take(&mut self.checksum) {
            let mut bytes = bytes.to_vec();
            flip(&mut bytes, &mut self.random);
            out.push(sent(&bytes, Fate::Garbled));
        } else if take(&mut self.duplicate) {
            out.push(sent(&bytes.repeat(2), Fate::Duplicated));
        } else if self.kept_back.is_none() && take(&mut self.reorder) {
            self.kept_back = Some(sent(bytes, Fate::Reordered));
            return;
        } else {
            let fate = if tick < self.hold_until { Fate::Held } else { Fate::Sent };
            out.push(sent(bytes, fate));
        }
        out.extend(self.kept_back.take());
    }
}

fn take(count: &mut u64) -> bool {
    let some = *count > 0;
    *count = count.saturating_sub(1);
    some
}

/// Flips one bit such that the frame keeps its beginning and its length, so that only its checksum shows the error. In
/// a binary frame it is a bit of the second half, in a line the lowest bit of a digit.
fn flip(bytes: &mut [u8], random: &mut ChaCha8Rng) {
    if bytes.first() == Some(&SYNC) {
        let index = random.random_range(bytes.len() / 2..bytes.len());
        bytes[index] ^= 1 << random.random_range(0..8);
        return;
    }
    let end = bytes.iter().position(|byte| *byte == b'*').unwrap_or(bytes.len());
    let digits: Vec<usize> = (0..end).filter(|index| bytes[*index].is_ascii_digit()).collect();
    if !digits.is_empty() {
        bytes[digits[random.random_range(0..digits.len())]] ^= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends frames `a`, `b`, `c`… and returns the bytes sent and the fate of each.
    fn send(line: &mut Line, count: u8, there: bool) -> (Vec<u8>, Vec<(u64, Fate)>) {
        let (mut bytes, mut fates) = (Vec::new(), Vec::new());
        for index in 0..count {
            let mut out = Vec::new();
            line.frame(u64::from(index), 0, &[b'a' + index], there, &mut out);
            for piece in out {
                bytes.extend(piece.bytes);
                fates.extend(piece.frame.map(|(frame, fate)| (frame.number, fate)));
            }
        }
        (bytes, fates)
    }

    #[test]
    fn frames_are_left_out_doubled_and_swapped_as_often_as_asked() {
        let mut line = Line::new(1);
        (line.drop, line.duplicate, line.reorder) = (2, 1, 1);
        let (bytes, fates) = send(&mut line, 7, true);
        assert_eq!(bytes, b"ccedfg");
        let expected = [
            (0, Fate::Dropped),
            (1, Fate::Dropped),
            (2, Fate::Duplicated),
            (4, Fate::Sent),
            (3, Fate::Reordered),
            (5, Fate::Sent),
            (6, Fate::Sent),
        ];
        assert_eq!(fates, expected);
    }

    #[test]
    fn a_frame_without_terminal_or_voice_is_accounted_for() {
        let mut line = Line::new(1);
        line.reorder = 1;
        assert!(send(&mut line, 1, true).1.is_empty());
        assert_eq!(send(&mut line, 1, false).1, [(0, Fate::Unplugged), (1, Fate::Unplugged)]);
        line.silent_until = 1;
        assert_eq!(send(&mut line, 2, true), (b"b".to_vec(), vec![(2, Fate::Silent), (3, Fate::Sent)]));
    }

    #[test]
    fn exactly_one_bit_is_flipped_behind_the_header() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..200 {
            for before in [[SYNC; 70].to_vec(), b"$VNYPR,+100.949,-007.330*41\r\n".to_vec()] {
                let mut after = before.clone();
                flip(&mut after, &mut random);
                let bits: u32 = before.iter().zip(&after).map(|(a, b)| (a ^ b).count_ones()).sum();
                assert_eq!(bits, 1);
                assert_eq!(before[..7], after[..7]);
            }
        }
    }

    #[test]
    fn garbage_comes_to_the_byte_and_never_inside_a_frame() {
        let mut line = Line::new(3);
        line.garbage = 700;
        let mut out = Vec::new();
        for tick in 0..4 {
            line.frame(tick, 0, b"frame", true, &mut out);
        }
        let lengths: Vec<usize> =
            out.iter().filter(|piece| piece.frame.is_none()).map(|piece| piece.bytes.len()).collect();
        assert_eq!(lengths, [512, 188]);
        assert!(out.iter().filter(|piece| piece.frame.is_some()).all(|piece| piece.bytes == b"frame"));
    }
}
