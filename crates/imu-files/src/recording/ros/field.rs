//! Fields: reads the lines of a message's definition, and the names of types. Pure.

use super::layout::{Encoding, MessageError};

/// A field of a type.
#[derive(Debug, Clone)]
pub(super) struct Field {
    pub(super) kind: String,
    pub(super) name: String,
    pub(super) repeat: Repeat,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Repeat {
    Once,
    Times(u32),
    Counted,
}

/// Converts `package/msg/Name` to `package/Name`.
pub(super) fn plain_name(name: &str) -> String {
    name.trim().replacen("/msg/", "/", 1)
}

/// Parses a line of a definition; `None` if it is empty, a comment or a constant.
pub(super) fn parse_field(line: &str, encoding: Encoding) -> Result<Option<Field>, MessageError> {
    let line = line.split('#').next().unwrap_or_default().trim();
    // Bounds of ROS 2 do not change the bytes.
    let unbounded = line.replace("<=", "≤");
    if unbounded.is_empty() || unbounded.contains('=') {
        return Ok(None);
    }
    let refuse = || MessageError::Line(line.chars().take(80).collect());
    let mut words = unbounded.split_whitespace();
    let (Some(kind), Some(name)) = (words.next(), words.next()) else { return Err(refuse()) };
    // In ROS 2 a default may follow.
    if words.next().is_some() && encoding == Encoding::Ros1 {
        return Err(refuse());
    }
    let (kind, repeat) = match kind.strip_suffix(']') {
        None => (kind, Repeat::Once),
        Some(array) => {
            let (kind, count) = array.split_once('[').ok_or_else(refuse)?;
            let counted = count.is_empty() || count.starts_with('≤');
            let repeat = if counted { Repeat::Counted } else { Repeat::Times(count.parse().map_err(|_| refuse())?) };
            (kind, repeat)
        }
    };
    let kind = kind.split('≤').next().unwrap_or_default();
    Ok(Some(Field { kind: kind.to_owned(), name: name.to_owned(), repeat }))
}
