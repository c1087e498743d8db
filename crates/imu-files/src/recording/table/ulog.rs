//! ULog: the log of PX4.
//!
//! The table is the topic of which most columns name a channel (`sensor_combined` as a rule), or the one whose
//! fields the user mapped (`sensor_gyro.x=gyro_x_rad_s`). Times are microseconds. Other topics, and further
//! instances of one, are left out and named. After damage, reading goes on at the next mark that PX4 writes for
//! that purpose. The source of the crate `px4-ulog` was looked at: it reads files by name and reports no damage.
//! Format: <https://docs.px4.io/main/en/dev_log/ulog_file_format>.

use super::super::error::RecordingError;
use super::super::input::{Input, broken};
use super::super::mapping::Foreign;
use super::super::vocabulary::{Meaning, meaning};
use super::arrays::{Form, Kind};
use super::blocks::Blocks;
use super::row::{Cell, Next, Table};
use std::collections::{HashMap, HashSet};

/// The first bytes of a file.
pub(in crate::recording) const MAGIC: &[u8] = b"ULog\x01\x12\x35";
const HEAD_BYTES: usize = 16;
/// The content of the message that marks a place to go on at.
const SYNC: [u8; 8] = [0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12];
/// The part of a file in which topics are looked for, bytes.
const LOOK_AT: u64 = 8 << 20;
/// Fields of all topics, those of types in them and padding included, the depth of these, and bytes of a message: a
/// declaration of a few bytes must not take long.
const FIELDS_MAX: usize = 1 << 16;
const DEPTH_MAX: usize = 8;
const BYTES_MAX: usize = 65_535;
/// Topics that are looked at.
const TOPICS_MAX: usize = 4096;

/// A field of a topic.
#[derive(Debug, Clone)]
struct Field {
    name: String,
    at: usize,
    kind: Kind,
}

/// A topic that the file declares.
struct Topic {
    number: u16,
    name: String,
    fields: Vec<Field>,
    /// Bytes of its fields, without padding at the end.
    bytes: usize,
}

pub(super) struct UlogTable {
    blocks: Blocks,
    number: u16,
    fields: Vec<Field>,
    /// Bytes of a message's fields.
    bytes: usize,
    names: Vec<String>,
    left_out: Vec<String>,
}

impl UlogTable {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let mut blocks = Blocks::open(input)?;
        if blocks.peek(HEAD_BYTES)?.len() < HEAD_BYTES {
            return Err(broken(input, format!("it ends within the head of {HEAD_BYTES} bytes of a ULog")));
        }
        blocks.pass(HEAD_BYTES);
        let (mut formats, mut topics) = (HashMap::new(), Vec::<Topic>::new());
        let (mut declared, mut budget, mut left_out) = (HashSet::new(), FIELDS_MAX, Vec::new());
        while blocks.at < LOOK_AT
            && let Some((kind, content)) = next(&mut blocks)?.ok()
        {
            match kind {
                b'F' => {
                    let text = String::from_utf8_lossy(&content);
                    if let Some((name, fields)) = text.split_once(':') {
                        formats.insert(name.to_owned(), fields.to_owned());
                    }
                }
                b'A' => {
                    let [instance, low, high, name @ ..] = content.as_slice() else { continue };
                    let name = String::from_utf8_lossy(name).into_owned();
                    // Of several instances the first one declared.
                    if declared.len() >= TOPICS_MAX || !declared.insert(name.clone()) {
                        if left_out.len() < TOPICS_MAX {
                            left_out.push(format!("{name} (instance {instance})"));
                        }
                        continue;
                    }
                    let mut expansion = Expansion { formats: &formats, at: 0, budget, fields: Vec::new() };
                    let is_known = expansion.expand(&name, "", 0).is_some();
                    let fields = expansion.fields;
                    budget = expansion.budget;
                    let bytes = fields.last().map_or(0, |last| last.at + last.kind.size);
                    // The places of fields behind one of an unknown type are unknown as well.
                    if is_known {
                        topics.push(Topic { number: u16::from_le_bytes([*low, *high]), name, fields, bytes });
                    } else {
                        left_out.push(format!("{name} (of an unknown type)"));
                    }
                }
                0 => break,
                _ => {}
            }
        }
        let map = input.columns();
        let wanted = |topic: &Topic| map.foreign().filter(|foreign| is_in(foreign, &topic.name)).count();
        let channels = |topic: &Topic| {
            topic.fields.iter().filter(|field| matches!(meaning(&field.name), Some(Meaning::Value { .. }))).count()
        };
        // Of equals the first is taken.
        let best = topics.iter().rev().max_by_key(|topic| (wanted(topic), channels(topic)));
        let Some(topic) = best.filter(|topic| wanted(topic) + channels(topic) > 0) else {
            let names: Vec<&str> = topics.iter().map(|topic| topic.name.as_str()).collect();
            let names = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            return Err(broken(
                input,
                format!(
                    "none of its topics has channels with units; name fields with --columns 'TOPIC.FIELD=NAME,…'; its topics: {names}"
                ),
            ));
        };
        let dotted = wanted(topic) > 0;
        let named = |field: &Field| match (dotted, field.name.starts_with("timestamp")) {
            (_, true) if !field.name.ends_with("relative") => format!("{} [us]", field.name),
            (true, _) => format!("{}.{}", topic.name, field.name),
            (false, _) => field.name.clone(),
        };
        let names = topic.fields.iter().map(named).collect();
        let (number, fields, bytes) = (topic.number, topic.fields.clone(), topic.bytes);
        left_out.extend(topics.iter().filter(|other| other.number != number).map(|other| other.name.clone()));
        let mut blocks = Blocks::open(input)?;
        blocks.peek(HEAD_BYTES)?;
        blocks.pass(HEAD_BYTES);
        Ok(Self { blocks, number, fields, bytes, names, left_out })
    }
}

/// Returns whether the user's name is that of a field of the topic.
fn is_in(foreign: &Foreign, topic: &str) -> bool {
    matches!(foreign, Foreign::Name(name) if name.strip_prefix(topic).is_some_and(|rest| rest.starts_with('.')))
}

/// Reads the next message, its type and its content, whatever it is; the error is the message about damage. Type 0 at the end.
fn next(blocks: &mut Blocks) -> Result<super::Message, RecordingError> {
    let at = blocks.at;
    let head = blocks.peek(3)?;
    let [low, high, kind, ..] = *head else {
        let left = head.len();
        blocks.pass(left);
        let cut = Err(format!("at byte {at}: the file was cut within the head of a message"));
        return Ok(if left == 0 { Ok((0, Vec::new())) } else { cut });
    };
    let size = usize::from(u16::from_le_bytes([low, high]));
    if !kind.is_ascii_uppercase() {
        return skip(blocks, at, kind);
    }
    let message = blocks.peek(3 + size)?;
    let Some(content) = message.get(3..3 + size) else {
        let left = message.len();
        blocks.pass(left);
        return Ok(Err(format!("at byte {at}: the file was cut: a message of {size} bytes has {} of them", left - 3)));
    };
    let content = content.to_vec();
    blocks.pass(3 + size);
    Ok(Ok((kind, content)))
}

/// Passes over damaged data, to behind the next mark.
fn skip(blocks: &mut Blocks, at: u64, found: u8) -> Result<super::Message, RecordingError> {
    loop {
        let bytes = blocks.peek(SYNC.len() + 1)?;
        let place = bytes.windows(SYNC.len()).position(|window| window == SYNC);
        let is_end = bytes.len() < SYNC.len() + 1;
        let passed =
            place.map_or_else(|| bytes.len().saturating_sub(SYNC.len() - 1).max(1), |place| place + SYNC.len());
        blocks.pass(passed);
        if place.is_some() || is_end {
            let bytes = blocks.at - at;
            return Ok(Err(format!(
                "at byte {at}: {bytes} bytes are no messages: type {found:#04x} where a letter stands"
            )));
        }
    }
}

/// The fields of a topic, as far as they are laid out.
struct Expansion<'a> {
    formats: &'a HashMap<String, String>,
    /// The place behind the last field.
    at: usize,
    /// Fields that may still follow in this file.
    budget: usize,
    fields: Vec<Field>,
}

impl Expansion<'_> {
    /// Adds the fields of a type; `None` if one of them has no known place or there are too many.
    fn expand(&mut self, name: &str, within: &str, depth: usize) -> Option<()> {
        let formats = self.formats;
        let text = formats.get(name).filter(|_| depth < DEPTH_MAX)?;
        // A long text of no fields takes time as well.
        self.budget = self.budget.checked_sub(text.len() / 64)?;
        for (kind, name) in text.split(';').filter_map(|field| field.trim().split_once(' ')) {
            let (kind, count) = match kind.split_once('[') {
                Some((kind, count)) => (kind, count.strip_suffix(']')?.parse().ok()?),
                None => (kind, 1_usize),
            };
            let is_array = count != 1;
            if count > BYTES_MAX {
                return None;
            }
            for index in 0..count {
                self.budget = self.budget.checked_sub(1)?;
                let called = if is_array { format!("{within}{name}[{index}]") } else { format!("{within}{name}") };
                let Some(kind) = simple(kind) else {
                    self.expand(kind, &format!("{called}."), depth + 1)?;
                    continue;
                };
                if !name.starts_with("_padding") {
                    self.fields.push(Field { name: called, at: self.at, kind });
                }
                self.at += kind.size;
                if self.at > BYTES_MAX {
                    return None;
                }
            }
        }
        Some(())
    }
}

fn simple(kind: &str) -> Option<Kind> {
    let (form, size) = match kind {
        "int8_t" => (Form::Signed, 1),
        "uint8_t" | "bool" | "char" => (Form::Unsigned, 1),
        "int16_t" => (Form::Signed, 2),
        "uint16_t" => (Form::Unsigned, 2),
        "int32_t" => (Form::Signed, 4),
        "uint32_t" => (Form::Unsigned, 4),
        "int64_t" => (Form::Signed, 8),
        "uint64_t" => (Form::Unsigned, 8),
        "float" => (Form::Float, 4),
        "double" => (Form::Float, 8),
        _ => return None,
    };
    Some(Kind { form, size, big_endian: false })
}

impl Table for UlogTable {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn left_out(&self) -> Vec<String> {
        super::row::left_out("topics", &self.left_out).into_iter().collect()
    }

    fn next_row(&mut self, cells: &mut Vec<Cell>) -> Result<Next, RecordingError> {
        loop {
            let (kind, content) = match next(&mut self.blocks)? {
                Err(what) => return Ok(Next::Damaged(what)),
                Ok((0, _)) => return Ok(Next::End),
                Ok(message) => message,
            };
            let at = self.blocks.at;
            let [low, high, data @ ..] = content.as_slice() else { continue };
            if kind != b'D' || u16::from_le_bytes([*low, *high]) != self.number {
                continue;
            }
            // Padding at the end is not written.
            if data.len() < self.bytes {
                let (found, expected) = (data.len(), self.bytes);
                return Ok(Next::Damaged(format!("before byte {at}: a message has {found} of {expected} bytes")));
            }
            cells.clear();
            cells.extend(self.fields.iter().map(|field| {
                let bytes = data.get(field.at..).unwrap_or_default();
                field.kind.number(bytes).unwrap_or(Cell::Absent)
            }));
            return Ok(Next::Row);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(formats: &[(&str, &str)]) -> Option<Vec<(String, usize)>> {
        let formats = formats.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect();
        let mut expansion = Expansion { formats: &formats, at: 0, budget: FIELDS_MAX, fields: Vec::new() };
        expansion.expand("topic", "", 0)?;
        Some(expansion.fields.into_iter().map(|field| (field.name, field.at)).collect())
    }

    #[test]
    fn a_topic_that_cannot_be_laid_out_is_left_out_at_once() {
        let plain =
            fields(&[("topic", "uint64_t timestamp;uint8_t[4] _padding0;inner i;float x"), ("inner", "float a;")]);
        let expected = [("timestamp", 0), ("i.a", 12), ("x", 16)].map(|(name, at)| (name.to_owned(), at));
        assert_eq!(plain.unwrap_or_default(), expected);
        for (topic, inner) in [
            ("uint8_t[18446744073709551615] _padding0;float x", ""),
            ("inner[60000] i;float x", "topic[60000] t"),
            ("inner[60000] i;float x", ""),
            ("inner[9] i;float x", "topic[9] t"),
            ("unknown i;float x", ""),
            ("float[x] a;float x", ""),
        ] {
            let found = fields(&[("topic", topic), ("inner", inner)]);
            // An empty type takes no bytes.
            assert!(found.is_none_or(|fields| fields == [("x".to_owned(), 0)]), "{topic}");
        }
    }
}
