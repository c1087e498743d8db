//! UTF-16: text with a byte-order mark of two bytes, read as UTF-8.
//!
//! Spreadsheets and some Windows programs write it. Other bytes pass as they are. A unit that is no character becomes
//! U+FFFD, so that its line is rejected and no other one. Pure.

use std::io::{BufRead, BufReader, Read};

/// Returns the reader itself, or its text as UTF-8 if it begins with a byte-order mark of UTF-16.
pub(super) fn decoded(mut bytes: Box<dyn BufRead>) -> std::io::Result<Box<dyn BufRead>> {
    let big_endian = match bytes.fill_buf()? {
        [0xFF, 0xFE, ..] => false,
        [0xFE, 0xFF, ..] => true,
        _ => return Ok(bytes),
    };
    bytes.consume(2);
    Ok(Box::new(BufReader::new(Utf16 { bytes, big_endian, high: None, ready: Vec::new(), given: 0 })))
}

/// Characters that are converted at a time.
const UNITS: usize = 4096;

struct Utf16 {
    bytes: Box<dyn BufRead>,
    big_endian: bool,
    /// The first unit of a pair whose second one is not read yet.
    high: Option<u16>,
    ready: Vec<u8>,
    given: usize,
}

impl Utf16 {
    fn convert(&mut self) -> std::io::Result<()> {
        let mut raw = Vec::with_capacity(2 * UNITS);
        self.bytes.by_ref().take(2 * UNITS as u64).read_to_end(&mut raw)?;
        let pairs = raw.chunks_exact(2);
        // A byte alone at the end is what is left of a character.
        let cut = (!pairs.remainder().is_empty()).then_some(0xFFFD);
        let unit = |pair: &[u8]| {
            let pair = [pair[0], pair[1]];
            if self.big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
        };
        let mut units: Vec<u16> = self.high.take().into_iter().chain(pairs.map(unit)).chain(cut).collect();
        if raw.len() == 2 * UNITS {
            self.high = units.pop_if(|last| (0xD800..0xDC00).contains(last));
        }
        self.ready = String::from_utf16_lossy(&units).into_bytes();
        self.given = 0;
        Ok(())
    }
}

impl Read for Utf16 {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.given == self.ready.len() {
            self.convert()?;
        }
        let rest = self.ready.get(self.given..).unwrap_or_default();
        let count = rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&rest[..count]);
        self.given += count;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: Vec<u8>) -> String {
        let mut text = String::new();
        decoded(Box::new(std::io::Cursor::new(bytes))).unwrap().read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn text_of_both_orders_comes_out_whole_and_other_bytes_as_they_are() {
        let text = "µT 𝛼 ".repeat(5000);
        let units = || std::iter::once(0xFEFF).chain(text.encode_utf16());
        assert_eq!(read(units().flat_map(u16::to_le_bytes).collect()), text);
        assert_eq!(read(units().flat_map(u16::to_be_bytes).collect()), text);
        assert_eq!(read(b"time_s".to_vec()), "time_s");
        assert_eq!(read(vec![0xFF, 0xFE, b'a', 0, b'b']), "a\u{FFFD}");
        assert_eq!(read(Vec::new()), "");
    }
}
