//! NumPy's arrays: `.npy`, and `.npz`, a ZIP archive of them. Pure.
//!
//! Plain arrays of integers and floats of 1 to 8 bytes in either byte order and memory layout, and structured ones of such
//! fields. Others (objects, text, complex numbers) are refused with their type. The crates that read `.npy` parse its header
//! with a grammar of Python (npyz: 20 crates more), so the header is read here.
//! Format: <https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>.

use super::arrays::{Array, Arrays, Budget, Form, Kind};
use std::io::{Cursor, Read as _};

/// The first bytes of a `.npy`.
const MAGIC: &[u8] = b"\x93NUMPY";

/// The most columns of a field that is itself an array.
const INNER_MAX: usize = 64;

/// Reads a `.npy`.
///
/// # Errors
/// What was found and what would be right.
pub(super) fn npy(bytes: &[u8]) -> Result<Arrays, String> {
    let (header, mut budget) = (Header::read(bytes)?, Budget::of(bytes.len()));
    match header.fields()? {
        Type::Plain(kind) => Arrays::of(vec![header.array(String::new(), kind, bytes, &mut budget)?], Vec::new()),
        Type::Fields(fields) => header.columns(&fields, bytes, &mut budget),
    }
}

/// Reads a `.npz`: its arrays by their names.
///
/// # Errors
/// What was found and what would be right.
pub(super) fn npz(bytes: &[u8]) -> Result<Arrays, String> {
    let mut archive =
        zip::ZipArchive::new(Cursor::new(bytes)).map_err(|error| format!("its ZIP archive is damaged: {error}"))?;
    let (mut arrays, mut left_out) = (Vec::new(), Vec::new());
    let mut budget = Budget::of(bytes.len());
    for index in 0..archive.len() {
        let mut file = archive.by_index(index).map_err(|error| format!("entry {index} of its archive: {error}"))?;
        let name = file.name().map_err(|error| format!("entry {index} of its archive: {error}"))?.into_owned();
        let Some(bare) = name.strip_suffix(".npy") else { continue };
        let mut content = Vec::new();
        file.by_ref()
            .take(budget.left() as u64 + 1)
            .read_to_end(&mut content)
            .map_err(|error| format!("{name} in it is damaged: {error}"))?;
        budget.take(content.len())?;
        let header = Header::read(&content).map_err(|what| format!("{name} in it: {what}"))?;
        // Text and objects beside the numbers are left out.
        let Ok(Type::Plain(kind)) = header.fields() else {
            left_out.push(bare.to_owned());
            continue;
        };
        let array = header.array(bare.to_owned(), kind, &content, &mut budget);
        arrays.push(array.map_err(|what| format!("{name} in it: {what}"))?);
    }
    if arrays.is_empty() {
        return Err("it is a ZIP archive without arrays of NumPy; unpack it and name the recording in it".to_owned());
    }
    Arrays::of(arrays, left_out)
}

/// The type of an array's elements.
enum Type {
    Plain(Kind),
    /// Name, type and place of each field.
    Fields(Vec<(String, Option<Kind>, usize)>),
}

struct Header<'a> {
    descr: &'a str,
    by_columns: bool,
    sides: Vec<usize>,
    /// Where the numbers begin.
    at: usize,
}

impl<'a> Header<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, String> {
        let short = || format!("it ends after {} bytes, within the header of NumPy's array", bytes.len());
        if !bytes.starts_with(MAGIC) {
            return Err("expected the first bytes of a NumPy array (\\x93NUMPY)".to_owned());
        }
        let version = *bytes.get(6).ok_or_else(short)?;
        let length = |range: std::ops::Range<usize>| {
            bytes
                .get(range)
                .map(|length| length.iter().rev().fold(0_usize, |sum, byte| (sum << 8) | usize::from(*byte)))
        };
        let (begin, length) = if version == 1 { (10, length(8..10)) } else { (12, length(8..12)) };
        let at = length.and_then(|length| length.checked_add(begin)).ok_or_else(short)?;
        let text = std::str::from_utf8(bytes.get(begin..at).ok_or_else(short)?)
            .map_err(|_| "its header is no text".to_owned())?;
        let odd = || format!("its header {:?} lacks descr, fortran_order or shape", text.trim());
        let value = |key: &str| text.split_once(&format!("'{key}':")).map(|(_, behind)| behind.trim_start());
        let shape = value("shape").and_then(|text| text.strip_prefix('(')?.split_once(')')).ok_or_else(odd)?.0;
        let sides: Option<Vec<usize>> =
            shape.split(',').map(str::trim).filter(|side| !side.is_empty()).map(|side| side.parse().ok()).collect();
        let by_columns = value("fortran_order").ok_or_else(odd)?.starts_with("True");
        Ok(Self { descr: value("descr").ok_or_else(odd)?, by_columns, sides: sides.ok_or_else(odd)?, at })
    }

    fn fields(&self) -> Result<Type, String> {
        let odd = |found: &str| format!("its elements are {found}; expected integers or floats of 1 to 8 bytes");
        let Some(list) = self.descr.strip_prefix('[') else {
            let code = quoted(self.descr).map(|(code, _)| code).unwrap_or_default();
            return kind(code).map(|(kind, _)| Type::Plain(kind)).ok_or_else(|| odd(code));
        };
        let (mut rest, mut fields, mut at) = (list, Vec::new(), 0);
        while let Some(tuple) = rest.trim_start_matches([',', ' ']).strip_prefix('(') {
            let (name, behind) = quoted(tuple).ok_or_else(|| odd(self.descr))?;
            let (code, behind) = quoted(behind).ok_or_else(|| odd(self.descr))?;
            // A field that is itself an array has its sides behind its type.
            let inner = behind.trim_start_matches([',', ' ']);
            let (count, behind) = match inner.strip_prefix('(') {
                Some(sides) => {
                    let (sides, behind) = sides.split_once(')').ok_or_else(|| odd(self.descr))?;
                    let sides = sides.split(',').filter_map(|side| side.trim().parse::<usize>().ok());
                    (sides.fold(1, usize::saturating_mul), behind)
                }
                None => (1, inner),
            };
            let size = kind(code).map(|(kind, _)| kind.size).or_else(|| size_of_text(code)).ok_or_else(|| odd(code))?;
            let end = count.checked_mul(size).and_then(|bytes| bytes.checked_add(at)).ok_or_else(|| odd(self.descr))?;
            // A field of too many columns is left out, as an array of them is.
            let read = if count > INNER_MAX { 1 } else { count };
            for index in 0..read {
                let called = if count == 1 || read < count { name.to_owned() } else { format!("{name}[{index}]") };
                let known = kind(code).map(|(kind, _)| kind).filter(|_| read == count);
                fields.push((called, known, at + index * size));
            }
            at = end;
            rest = behind.split_once(')').ok_or_else(|| odd(self.descr))?.1;
        }
        fields.push((String::new(), None, at));
        Ok(Type::Fields(fields))
    }

    /// Returns the bytes of all elements.
    fn content(&self, size: usize, bytes: &'a [u8]) -> Result<&'a [u8], String> {
        let wanted = self.sides.iter().try_fold(size, |all, side| all.checked_mul(*side));
        let there = bytes.len().saturating_sub(self.at);
        let end = wanted.filter(|wanted| *wanted <= there).and_then(|wanted| self.at.checked_add(wanted));
        end.and_then(|end| bytes.get(self.at..end)).ok_or_else(|| {
            format!("it was cut: its header states {:?} elements of {size} bytes, but {there} bytes follow", self.sides)
        })
    }

    fn array(&self, name: String, kind: Kind, bytes: &[u8], budget: &mut Budget) -> Result<Array, String> {
        let data = kind.data(self.content(kind.size, bytes)?, budget)?;
        Ok(Array { name, sides: self.sides.clone(), by_columns: self.by_columns, data })
    }

    /// Returns the fields of a structured array as columns.
    fn columns(
        &self,
        fields: &[(String, Option<Kind>, usize)],
        bytes: &[u8],
        budget: &mut Budget,
    ) -> Result<Arrays, String> {
        let Some(((_, _, size), fields)) = fields.split_last() else { return Err("it has no fields".to_owned()) };
        let content = self.content(*size, bytes)?;
        let (mut columns, mut left_out) = (Vec::new(), Vec::new());
        for (name, kind, at) in fields {
            let Some(kind) = kind else {
                left_out.push(name.clone());
                continue;
            };
            let rows = content.chunks_exact((*size).max(1)).filter_map(|row| row.get(*at..at + kind.size));
            let packed: Vec<u8> = rows.flatten().copied().collect();
            let data = kind.data(&packed, budget).map_err(|what| format!("field {name:?}: {what}"))?;
            columns.push((name.clone(), data));
        }
        Ok(Arrays::of_columns(columns, content.len() / (*size).max(1), left_out))
    }
}

/// Returns the text in the next quotation marks, and what follows them.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let (_, behind) = text.split_once('\'')?;
    behind.split_once('\'')
}

/// Reads a type's code, such as `<f8`.
fn kind(code: &str) -> Option<(Kind, usize)> {
    let mut letters = code.chars();
    let big_endian = match letters.next()? {
        '<' | '|' | '=' => false,
        '>' => true,
        _ => return None,
    };
    let form = match letters.next()? {
        'f' => Form::Float,
        'i' => Form::Signed,
        'u' | 'b' => Form::Unsigned,
        _ => return None,
    };
    let size = letters.as_str().parse().ok()?;
    let known = matches!((form, size), (Form::Float, 4 | 8) | (Form::Signed | Form::Unsigned, 1 | 2 | 4 | 8));
    known.then_some((Kind { form, size, big_endian }, size))
}

/// Returns the size of an element of text or bytes, bytes.
fn size_of_text(code: &str) -> Option<usize> {
    let count: usize = code.get(2..)?.parse().ok()?;
    match code.get(1..2)? {
        "S" | "V" | "f" | "c" => Some(count),
        "U" => count.checked_mul(4),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_that_promises_more_than_follows_is_refused() {
        let text = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 7), }";
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend(u16::try_from(text.len()).unwrap().to_le_bytes());
        bytes.extend(text.as_bytes());
        assert!(npy(&bytes).unwrap_err().contains("it was cut"));
        assert!(npy(&bytes[..20]).unwrap_err().contains("within the header"));
        for descr in ["[('a', '<f8', (99999999999, 99999999999))]", "[('a', '<f8', (65,)), ('b', '<f8')]"] {
            let text = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (9,), }}");
            let bytes = [b"\x93NUMPY\x01\x00", &[text.len() as u8, 0][..], text.as_bytes(), &[0; 5000]].concat();
            let found = npy(&bytes);
            assert_eq!(found.is_ok(), descr.contains("65"), "{found:?}");
        }
        let objects = String::from_utf8_lossy(&bytes).replace("<f8", "|O").into_bytes();
        assert!(npy(&objects).is_err());
    }
}
