//! CDR, the encoding of ROS 2 messages: little-endian, each number at a multiple of its own size.
//!
//! Source: OMG Common Data Representation as DDSI-RTPS 2.x carries it (clause 10: encapsulation `CDR_LE`, 00 01 00 00); places
//! count from after those four bytes.

/// Bytes before the first place that counts.
const ENCAPSULATION: [u8; 4] = [0x00, 0x01, 0x00, 0x00];

/// One message being encoded; the bytes are reused for the next.
#[derive(Debug, Default)]
pub(super) struct Cdr {
    bytes: Vec<u8>,
}

impl Cdr {
    /// Begins a message.
    pub(super) fn begin(&mut self) -> &mut Self {
        self.bytes.clear();
        self.bytes.extend_from_slice(&ENCAPSULATION);
        self
    }

    /// Returns the message so far.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    fn align(&mut self, to: usize) {
        let place = self.bytes.len() - ENCAPSULATION.len();
        self.bytes.resize(place.next_multiple_of(to) + ENCAPSULATION.len(), 0);
    }

    pub(super) fn i32(&mut self, value: i32) -> &mut Self {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub(super) fn u32(&mut self, value: u32) -> &mut Self {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub(super) fn u64(&mut self, value: u64) -> &mut Self {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub(super) fn f64s(&mut self, values: &[f64]) -> &mut Self {
        self.align(8);
        for value in values {
            self.bytes.extend_from_slice(&value.to_le_bytes());
        }
        self
    }

    /// Appends a text with its length, including the final zero.
    pub(super) fn string(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32 + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_at_multiples_of_their_size_after_the_encapsulation() {
        let mut cdr = Cdr::default();
        cdr.begin().i32(-2).string("ab").f64s(&[1.5]).u64(3);
        let mut expected = vec![0, 1, 0, 0, 0xFE, 0xFF, 0xFF, 0xFF, 3, 0, 0, 0, b'a', b'b', 0, 0];
        // Four and four and three bytes: the double waits for the sixteenth.
        expected.extend([0; 4]);
        expected.extend(1.5_f64.to_le_bytes());
        expected.extend(3_u64.to_le_bytes());
        assert_eq!(cdr.bytes(), expected);
        assert_eq!(cdr.begin().u32(1).bytes(), [0, 1, 0, 0, 1, 0, 0, 0]);
    }
}
