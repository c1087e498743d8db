//! MATLAB's `.mat` up to version 7 (format 5): variables that are real matrices, and those within structures. Pure.
//!
//! Own code, because the entries of `matfile`, `matrw` and `mat5` in the registry promise neither structures nor bounded memory.
//! Elements may be compressed; all together may expand as [`most_bytes`] allows. Cells, text and objects are left out.
//! Format: MathWorks, MAT-File Format, "Level 5 MAT-Files".

use super::arrays::{Array, Arrays, Budget, Form, Kind};
use flate2::read::ZlibDecoder;
use std::io::Read as _;

/// Bytes before the first element.
const HEAD_BYTES: usize = 128;
const COMPRESSED: u32 = 15;
const MATRIX: u32 = 14;
/// Classes of arrays: structure, and the numeric ones from double to 64-bit integers.
const STRUCTURE: u8 = 2;
const NUMERIC: std::ops::RangeInclusive<u8> = 6..=15;
/// Structures within structures.
const DEPTH_MAX: usize = 8;

/// Reads the variables of a file.
///
/// # Errors
/// What was found and what would be right, with the byte at which it stands.
pub(super) fn read(bytes: &[u8]) -> Result<Arrays, String> {
    let big_endian = match bytes.get(126..HEAD_BYTES) {
        Some(b"IM") => false,
        Some(b"MI") => true,
        Some(found) => return Err(format!("byte 126 has {found:?} where a MAT-file has IM or MI")),
        None => return Err(format!("it ends after {} bytes, within the head of {HEAD_BYTES}", bytes.len())),
    };
    let mut found = Found { arrays: Vec::new(), left_out: Vec::new(), budget: Budget::of(bytes.len()), big_endian };
    let mut elements = Elements { bytes, at: HEAD_BYTES, big_endian };
    while elements.at < bytes.len() {
        let at = elements.at;
        let place = |what: String| format!("at byte {at}: {what}");
        let (kind, content) = elements.next().map_err(place)?;
        match kind {
            COMPRESSED => {
                let mut expanded = Vec::new();
                let expand = ZlibDecoder::new(content).take(found.budget.left() as u64 + 1).read_to_end(&mut expanded);
                expand.map_err(|error| place(format!("a compressed variable is damaged: {error}")))?;
                found.budget.take(expanded.len())?;
                let (kind, content) = Elements { bytes: &expanded, at: 0, big_endian }.next().map_err(place)?;
                if kind == MATRIX {
                    found.matrix(content, "", 0).map_err(place)?;
                }
            }
            MATRIX => found.matrix(content, "", 0).map_err(place)?,
            _ => {}
        }
    }
    if found.arrays.is_empty() {
        Err("it has no variable that is a matrix of real numbers".to_owned())
    } else {
        Arrays::of(found.arrays, found.left_out)
    }
}

/// Elements one behind the other.
struct Elements<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Elements<'a> {
    fn word(&self, at: usize) -> Option<u32> {
        let word: [u8; 4] = self.bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if self.big_endian { u32::from_be_bytes(word) } else { u32::from_le_bytes(word) })
    }

    /// Returns the type and content of the next element.
    fn next(&mut self) -> Result<(u32, &'a [u8]), String> {
        let cut = |wanted: u64| format!("the file was cut: an element of {wanted} bytes does not end in it");
        let tag = self.word(self.at).ok_or_else(|| cut(8))?;
        if tag >> 16 != 0 {
            // A small element: type, length and up to four bytes in eight.
            let length = (tag >> 16) as usize;
            let content = self.bytes.get(self.at + 4..self.at + 4 + length.min(4)).ok_or_else(|| cut(8))?;
            self.at += 8;
            return Ok((tag & 0xFFFF, content));
        }
        let length = self.word(self.at + 4).ok_or_else(|| cut(8))?;
        let begin = self.at + 8;
        let end = begin.checked_add(length as usize).ok_or_else(|| cut(u64::from(length)))?;
        let content = self.bytes.get(begin..end).ok_or_else(|| cut(u64::from(length)))?;
        self.at = if tag == COMPRESSED { end } else { end.next_multiple_of(8) };
        Ok((tag, content))
    }
}

/// Returns the type of the numbers of an element.
fn kind(code: u32, big_endian: bool) -> Option<Kind> {
    let (form, size) = match code {
        1 => (Form::Signed, 1),
        2 => (Form::Unsigned, 1),
        3 => (Form::Signed, 2),
        4 => (Form::Unsigned, 2),
        5 => (Form::Signed, 4),
        6 => (Form::Unsigned, 4),
        7 => (Form::Float, 4),
        9 => (Form::Float, 8),
        12 => (Form::Signed, 8),
        13 => (Form::Unsigned, 8),
        _ => return None,
    };
    Some(Kind { form, size, big_endian })
}

/// What is found in a file.
struct Found {
    arrays: Vec<Array>,
    left_out: Vec<String>,
    budget: Budget,
    big_endian: bool,
}

impl Found {
    /// Reads a matrix, or the fields of a structure.
    fn matrix(&mut self, bytes: &[u8], within: &str, depth: usize) -> Result<(), String> {
        let big_endian = self.big_endian;
        let mut parts = Elements { bytes, at: 0, big_endian };
        if bytes.is_empty() {
            return Ok(());
        }
        if depth > DEPTH_MAX {
            self.left_out.push(within.to_owned());
            return Ok(());
        }
        let (_, flags) = parts.next()?;
        let flags = Elements { bytes: flags, at: 0, big_endian }.word(0).unwrap_or_default();
        let (class, is_complex) = (flags as u8, flags & 0x800 != 0);
        let (_, sides) = parts.next()?;
        let sides: Vec<usize> = (0..sides.len() / 4)
            .filter_map(|side| Elements { bytes: sides, at: 0, big_endian }.word(4 * side))
            .map(|side| side as usize)
            .collect();
        let (_, own) = parts.next()?;
        let own = String::from_utf8_lossy(own);
        let name = [within, own.as_ref()].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(".");
        if class == STRUCTURE {
            let (_, length) = parts.next()?;
            let length = Elements { bytes: length, at: 0, big_endian }.word(0).unwrap_or(0) as usize;
            let (_, names) = parts.next()?;
            // One structure, not an array of them.
            if length == 0 || sides.iter().any(|side| *side != 1) {
                self.left_out.push(name);
                return Ok(());
            }
            for field in names.chunks_exact(length) {
                let (_, content) = parts.next()?;
                let field = String::from_utf8_lossy(field.split(|byte| *byte == 0).next().unwrap_or_default());
                self.matrix(content, format!("{name}.{field}").trim_matches('.'), depth + 1)?;
            }
            return Ok(());
        }
        if !NUMERIC.contains(&class) || is_complex {
            self.left_out.push(name);
            return Ok(());
        }
        let (code, numbers) = parts.next()?;
        let kind = kind(code, big_endian)
            .ok_or_else(|| format!("variable {name:?} has numbers of type {code}, which is none of the format"))?;
        let data = kind.data(numbers, &mut self.budget)?;
        self.arrays.push(Array { name, sides, by_columns: true, data });
        Ok(())
    }
}
