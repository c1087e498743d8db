//! Apart: converts a picture to PNG in a separate process, because that takes many times the memory of its SVG.

use crate::plot::raster::{self, SCALE};
use crate::process::{Child, Frame, FrameError, Received, write_frame};
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::time::Duration;

/// The limit of the process's private memory: a picture of 1680 pixels across takes a tenth.
const MEMORY_BYTES: u64 = 128 << 20;
/// The time limit.
const TIME: Duration = Duration::from_secs(8);
/// The maximum size of a picture in bytes.
const PNG_BYTES_MAX: u64 = 32 << 20;
/// The maximum size of SVG in bytes.
const SVG_BYTES_MAX: u64 = 8 << 20;

/// The messages of the process.
#[derive(Debug, Serialize, Deserialize)]
enum Word {
    /// The frame's body is the PNG.
    Png,
    /// There is no PNG, for this reason.
    Refused(String),
}

/// Returns the picture as PNG, made by a child.
///
/// # Errors
/// The reason why there is no PNG, for the user.
pub fn png(svg: &str) -> Result<Vec<u8>, String> {
    let failed = |error: std::io::Error| format!("a process for the picture cannot be started: {error}");
    let mut child =
        Child::<Word>::start(MEMORY_BYTES, TIME.as_secs(), &["png".as_ref()], PNG_BYTES_MAX).map_err(failed)?;
    if let Some(mut stdin) = child.stdin() {
        // A child that does not read has ended, and reports the reason below.
        let _ = stdin.write_all(svg.as_bytes());
    }
    match child.receive(TIME).map_err(failed)? {
        Received::Frame(Frame { header: Word::Png, body }) => Ok(body),
        Received::Frame(Frame { header: Word::Refused(reason), .. }) => Err(reason),
        Received::Ended(ended) => Err(format!("the picture was not made: {}", ended.reason)),
        Received::Nothing => Err(format!("the picture was not made within {} s", TIME.as_secs())),
    }
}

/// Converts the SVG from `from` to PNG, in the process that [`png`] has started, and writes it to `out`.
///
/// # Errors
/// [`FrameError`], if the SVG cannot be read or the parent does not listen.
pub fn answer(from: impl Read, mut out: impl Write) -> Result<(), FrameError> {
    let mut svg = String::new();
    from.take(SVG_BYTES_MAX).read_to_string(&mut svg)?;
    match raster::png(&svg, SCALE) {
        Ok(png) => write_frame(&mut out, &Word::Png, &png),
        Err(error) => write_frame(&mut out, &Word::Refused(error.to_string()), &[]),
    }
}
