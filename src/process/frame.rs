//! Frames: the messages between a child and its parent over a pipe, a header in JSON and bytes.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{Read, Write};

/// A header larger than this is invalid.
const HEADER_MAX: u32 = 1 << 20;

/// The reasons why a frame cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// The pipe failed.
    #[error("the pipe between the processes broke: {0}")]
    Pipe(#[from] std::io::Error),
    /// The lengths exceed the bounds.
    #[error(
        "a frame has a header of {header} bytes and a body of {body} bytes: expected at most {HEADER_MAX} and {body_max}"
    )]
    TooLong {
        /// Bytes of the header.
        header: u32,
        /// Bytes of the body.
        body: u64,
        /// The maximum size of the body in bytes.
        body_max: u64,
    },
    /// The header is of no known kind.
    #[error("the header of a frame cannot be read: {0}")]
    Header(#[from] serde_json::Error),
}

/// A header and the bytes that belong to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame<H> {
    /// The description of the bytes.
    pub header: H,
    /// The bytes.
    pub body: Vec<u8>,
}

/// Writes a frame and flushes it: lengths (4 and 8 bytes, little-endian), header, body.
///
/// # Errors
/// [`FrameError::Pipe`], or [`FrameError::Header`] if the header cannot be written as JSON.
pub fn write_frame<H: Serialize>(to: &mut impl Write, header: &H, body: &[u8]) -> Result<(), FrameError> {
    let header = serde_json::to_vec(header)?;
    to.write_all(&(header.len() as u32).to_le_bytes())?;
    to.write_all(&(body.len() as u64).to_le_bytes())?;
    to.write_all(&header)?;
    to.write_all(body)?;
    to.flush()?;
    Ok(())
}

/// Reads the next frame, whose body has at most `body_max` bytes; `None` at the end of the pipe.
///
/// # Errors
/// [`FrameError`]: a pipe that breaks in the middle, lengths beyond the bounds, a header of another kind.
pub fn read_frame<H: DeserializeOwned>(from: &mut impl Read, body_max: u64) -> Result<Option<Frame<H>>, FrameError> {
    let mut header_length = [0; 4];
    match from.read(&mut header_length)? {
        0 => return Ok(None),
        count => from.read_exact(header_length.get_mut(count..).unwrap_or_default())?,
    }
    let mut body_length = [0; 8];
    from.read_exact(&mut body_length)?;
    let (header, body) = (u32::from_le_bytes(header_length), u64::from_le_bytes(body_length));
    if header > HEADER_MAX || body > body_max {
        return Err(FrameError::TooLong { header, body, body_max });
    }
    let mut text = Vec::new();
    from.take(header.into()).read_to_end(&mut text)?;
    let header = serde_json::from_slice(&text)?;
    // Memory grows as the bytes arrive: a length alone takes none.
    let mut bytes = Vec::new();
    from.take(body).read_to_end(&mut bytes)?;
    if bytes.len() as u64 != body {
        return Err(FrameError::Pipe(std::io::ErrorKind::UnexpectedEof.into()));
    }
    Ok(Some(Frame { header, body: bytes }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read(header in ".{0,40}", body in proptest::collection::vec(any::<u8>(), 0..300), cut in 0..400_usize) {
            let mut pipe = Vec::new();
            write_frame(&mut pipe, &header, &body).unwrap();
            write_frame(&mut pipe, &7, &[]).unwrap();
            let mut rest = &pipe[..];
            let frame: Frame<String> = read_frame(&mut rest, 300).unwrap().unwrap();
            prop_assert_eq!((frame.header, frame.body), (header, body));
            prop_assert_eq!(read_frame::<u8>(&mut rest, 0).unwrap().unwrap().header, 7);
            prop_assert!(read_frame::<u8>(&mut rest, 0).unwrap().is_none());
            // Data that is cut off anywhere is an error or an end, and never another frame.
            let mut short = &pipe[..cut.min(pipe.len() - 1)];
            while let Ok(Some(_)) = read_frame::<serde_json::Value>(&mut short, 300) {}
        }
    }

    #[test]
    fn lengths_beyond_the_bounds_take_no_memory() {
        let pipe = [[0xff; 4].as_slice(), &[0xff; 8]].concat();
        assert!(matches!(read_frame::<u8>(&mut &pipe[..], 100), Err(FrameError::TooLong { .. })));
        let pipe = [4_u32.to_le_bytes().as_slice(), &101_u64.to_le_bytes()].concat();
        assert!(matches!(read_frame::<u8>(&mut &pipe[..], 100), Err(FrameError::TooLong { .. })));
    }
}
