//! Outbox: the bytes to be written to the terminal, and the end of each frame in them. Pure.

use super::line::{Fate, Frame, Piece};
use std::collections::VecDeque;

/// The bytes that wait for the terminal.
#[derive(Debug, Default)]
pub struct Outbox {
    bytes: Vec<u8>,
    /// The number of bytes already in the terminal.
    sent: usize,
    /// Frames by their end in `bytes`.
    frames: VecDeque<(usize, Frame, Fate)>,
    /// Frames whose fate is known.
    settled: Vec<(Frame, Fate)>,
}

impl Outbox {
    /// Returns the bytes that the terminal does not have yet.
    pub fn waiting(&self) -> &[u8] {
        &self.bytes[self.sent..]
    }

    /// Returns whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.sent == self.bytes.len()
    }

    /// Adds a piece to be sent; a frame that is not sent is settled at once.
    pub fn put(&mut self, piece: Piece) {
        self.bytes.extend_from_slice(&piece.bytes);
        if let Some((frame, fate)) = piece.frame {
            if piece.bytes.is_empty() {
                self.settled.push((frame, fate));
            } else {
                self.frames.push_back((self.bytes.len(), frame, fate));
            }
        }
    }

    /// Records that the terminal accepted this many bytes.
    pub fn took(&mut self, count: usize) {
        self.sent += count;
        while let Some((_, frame, fate)) = self.frames.pop_front_if(|(end, ..)| *end <= self.sent) {
            self.settled.push((frame, fate));
        }
        if self.is_empty() {
            self.bytes.clear();
            self.sent = 0;
        }
    }

    /// Discards the waiting bytes; their frames get this fate.
    pub fn lose(&mut self, fate: Fate) {
        self.settled.extend(self.frames.drain(..).map(|(_, frame, _)| (frame, fate)));
        self.bytes.clear();
        self.sent = 0;
    }

    /// Returns the frames whose fate became known since the last call.
    pub fn settled(&mut self) -> std::vec::Drain<'_, (Frame, Fate)> {
        self.settled.drain(..)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(number: u64, bytes: &[u8]) -> Piece {
        let frame = Frame { number, tick: 0, device_time_ns: 0, bytes: 4 };
        Piece { bytes: bytes.to_vec(), frame: Some((frame, Fate::Sent)) }
    }

    #[test]
    fn a_frame_is_settled_with_its_last_byte() {
        let mut outbox = Outbox::default();
        outbox.put(piece(0, b"aaaa"));
        outbox.put(Piece { bytes: b"reply".to_vec(), frame: None });
        outbox.put(piece(1, b"bbbb"));
        outbox.put(piece(2, b""));
        let settled =
            |outbox: &mut Outbox| outbox.settled().map(|(frame, fate)| (frame.number, fate)).collect::<Vec<_>>();
        assert_eq!(settled(&mut outbox), [(2, Fate::Sent)]);
        outbox.took(3);
        assert_eq!(settled(&mut outbox), []);
        outbox.took(7);
        assert_eq!((settled(&mut outbox), outbox.waiting()), (vec![(0, Fate::Sent)], &b"bbb"[..]));
        outbox.lose(Fate::Overrun);
        assert_eq!((settled(&mut outbox), outbox.is_empty()), (vec![(1, Fate::Overrun)], true));
    }
}
