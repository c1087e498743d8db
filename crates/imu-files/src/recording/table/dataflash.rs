//! Dataflash: the log of ArduPilot (`.BIN`).
//!
//! The table is the message of which most columns are channels, `IMU` as a rule. Its labels have no units; they are
//! those of ArduPilot's documentation of log messages ([`UNITS`]). Of several sensors the first in the file is
//! read. `VIBE` holds levels of vibration, not samples. Damaged data are passed over to the next message. Crates
//! for this format were not looked at. Format:
//! <https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html>, AP_Logger/LogStructure.h.

use super::super::error::RecordingError;
use super::super::input::{Input, broken};
use super::super::vocabulary::{Meaning, meaning};
use super::arrays::{Form, Kind};
use super::blocks::Blocks;
use super::row::{Cell, Next, Table};
use std::collections::{BTreeSet, HashMap};

/// The first bytes of a message.
const SYNC: [u8; 2] = [0xA3, 0x95];
/// The message that declares others, and its length.
const FMT: u8 = 128;
const FMT_BYTES: usize = 89;
/// The part of a file in which messages are looked for, bytes.
const LOOK_AT: u64 = 8 << 20;

/// Labels of messages whose quantity and unit are documented: message, label, the name with its unit.
const UNITS: [(&str, &str, &str); 20] = [
    ("IMU", "GyrX", "GyrX [rad/s]"),
    ("IMU", "GyrY", "GyrY [rad/s]"),
    ("IMU", "GyrZ", "GyrZ [rad/s]"),
    ("IMU", "AccX", "AccX [m/s^2]"),
    ("IMU", "AccY", "AccY [m/s^2]"),
    ("IMU", "AccZ", "AccZ [m/s^2]"),
    ("IMU", "T", "Temp T [degC]"),
    ("GYR", "GyrX", "GyrX [rad/s]"),
    ("GYR", "GyrY", "GyrY [rad/s]"),
    ("GYR", "GyrZ", "GyrZ [rad/s]"),
    ("ACC", "AccX", "AccX [m/s^2]"),
    ("ACC", "AccY", "AccY [m/s^2]"),
    ("ACC", "AccZ", "AccZ [m/s^2]"),
    ("MAG", "MagX", "MagX [mG]"),
    ("MAG", "MagY", "MagY [mG]"),
    ("MAG", "MagZ", "MagZ [mG]"),
    ("BARO", "Press", "Press [Pa]"),
    ("BARO", "Temp", "Temp [degC]"),
    ("GYR", "SampleUS", "SampleUS"),
    ("ACC", "SampleUS", "SampleUS"),
];

/// A message that the file declares.
#[derive(Debug, Clone)]
struct Message {
    length: usize,
    name: String,
    /// Label, place and type of each number.
    fields: Vec<(String, usize, Option<Kind>)>,
}

/// Returns whether a file begins as a dataflash log: with the declaration of declarations.
pub(in crate::recording) fn is_dataflash(head: &[u8]) -> bool {
    head.starts_with(&SYNC) && head.get(2..5) == Some(&[FMT, FMT, 89])
}

pub(super) struct DataflashTable {
    blocks: Blocks,
    messages: HashMap<u8, Message>,
    chosen: u8,
    names: Vec<String>,
    /// The column of the sensor's number, and the number that is read.
    instance: Option<usize>,
    sensor: Option<i64>,
    /// The other numbers of sensors in the part that was looked at.
    further: BTreeSet<i64>,
}

impl DataflashTable {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let mut blocks = Blocks::open(input)?;
        let mut messages = HashMap::new();
        let mut order = Vec::new();
        while blocks.at < LOOK_AT
            && let Some(Ok((number, content))) = next(&mut blocks, &messages)?
        {
            if number == FMT
                && let Some((number, message)) = declaration(&content)
                && messages.insert(number, message).is_none()
            {
                order.push(number);
            }
        }
        let names = |message: &Message| -> Vec<String> {
            let named = |label: &String| {
                let known = UNITS.iter().find(|(name, known, _)| message.name == *name && label == known);
                known.map_or_else(|| label.clone(), |(.., name)| (*name).to_owned())
            };
            message.fields.iter().map(|(label, ..)| named(label)).collect()
        };
        let channels = |message: &Message| {
            let list = names(message);
            let of_user = |name: &String| input.columns().of(0, name).is_some();
            list.iter().filter(|name| of_user(name) || matches!(meaning(name), Some(Meaning::Value { .. }))).count()
        };
        // Of equals the first is taken.
        let best = order.iter().rev().filter_map(|number| Some((*number, messages.get(number)?)));
        let best = best.max_by_key(|(_, message)| channels(message)).filter(|(_, message)| channels(message) > 0);
        let Some((chosen, message)) = best else {
            let names: Vec<&str> = messages.values().map(|message| message.name.as_str()).collect();
            let what = format!("it is a log of ArduPilot without IMU messages; it has {}", names.join(", "));
            return Err(broken(input, what));
        };
        let instance = message.fields.iter().position(|(label, ..)| label == "I");
        let names = names(message);
        let (sensor, further) = (None, BTreeSet::new());
        let mut table = Self { blocks: Blocks::open(input)?, chosen, names, instance, sensor, further, messages };
        table.count_sensors()?;
        table.blocks = Blocks::open(input)?;
        Ok(table)
    }
}

impl DataflashTable {
    /// Notes the numbers of all sensors in the first part of the file; the first one is read.
    fn count_sensors(&mut self) -> Result<(), RecordingError> {
        while self.instance.is_some()
            && self.blocks.at < LOOK_AT
            && let Some(found) = next(&mut self.blocks, &self.messages)?
        {
            let Ok((number, content)) = found else { continue };
            let sensor = self.chosen_message(number).and_then(|message| self.sensor_of(message, &content));
            if let Some(sensor) = sensor
                && *self.sensor.get_or_insert(sensor) != sensor
            {
                self.further.insert(sensor);
            }
        }
        Ok(())
    }

    fn chosen_message(&self, number: u8) -> Option<&Message> {
        self.messages.get(&number).filter(|_| number == self.chosen)
    }

    fn sensor_of(&self, message: &Message, content: &[u8]) -> Option<i64> {
        let (_, at, kind) = message.fields.get(self.instance?)?;
        match (*kind)?.number(content.get(*at..)?)? {
            Cell::Whole(sensor) => Some(sensor),
            _ => None,
        }
    }
}

/// Reads the next message: its number and content. The error is the message about damage; `None` at the end.
fn next(blocks: &mut Blocks, messages: &HashMap<u8, Message>) -> Result<Option<super::Message>, RecordingError> {
    let at = blocks.at;
    let bytes = blocks.peek(256)?;
    if bytes.is_empty() {
        return Ok(None);
    }
    let length =
        |number: u8| if number == FMT { Some(FMT_BYTES) } else { messages.get(&number).map(|message| message.length) };
    if let [a, b, number, ..] = *bytes
        && [a, b] == SYNC
        && let Some(length) = length(number)
    {
        let content = bytes.get(3..length).map(<[u8]>::to_vec);
        let left = bytes.len();
        blocks.pass(length);
        return Ok(Some(match content {
            Some(content) => Ok((number, content)),
            None => Err(format!("at byte {at}: the file was cut: a message of {length} bytes has {left} of them")),
        }));
    }
    loop {
        let bytes = blocks.peek(256)?;
        let is_begin = |three: &[u8]| three[..2] == SYNC && length(three[2]).is_some();
        let place = bytes.windows(3).skip(1).position(is_begin).map(|place| place + 1);
        let passed = place.unwrap_or(if bytes.len() < 256 { bytes.len() } else { bytes.len() - 2 });
        blocks.pass(passed);
        if place.is_some() || blocks.peek(1)?.is_empty() {
            return Ok(Some(Err(format!("at byte {at}: {} bytes are no messages", blocks.at - at))));
        }
    }
}

/// Reads a declaration.
fn declaration(content: &[u8]) -> Option<(u8, Message)> {
    let text = |range: std::ops::Range<usize>| {
        let text = content.get(range)?;
        Some(String::from_utf8_lossy(text.split(|byte| *byte == 0).next()?).into_owned())
    };
    let (number, length) = (*content.first()?, usize::from(*content.get(1)?));
    let mut at = 0;
    let mut fields = Vec::new();
    for (code, label) in text(6..22)?.chars().zip(text(22..86)?.split(',')) {
        let (kind, size) = kind(code)?;
        fields.push((label.to_owned(), at, kind));
        at += size;
    }
    (length == at + 3).then_some((number, Message { length, name: text(2..6)?, fields }))
}

/// Returns the type of a letter, and its bytes; no type for one that is no single number.
fn kind(code: char) -> Option<(Option<Kind>, usize)> {
    let (form, size) = match code {
        'b' => (Form::Signed, 1),
        'B' | 'M' => (Form::Unsigned, 1),
        'h' => (Form::Signed, 2),
        'H' => (Form::Unsigned, 2),
        'i' => (Form::Signed, 4),
        'I' => (Form::Unsigned, 4),
        'q' => (Form::Signed, 8),
        'Q' => (Form::Unsigned, 8),
        'f' => (Form::Float, 4),
        'd' => (Form::Float, 8),
        'n' | 'e' | 'E' | 'L' => return Some((None, 4)),
        'c' | 'C' | 'g' => return Some((None, 2)),
        'N' => return Some((None, 16)),
        'a' | 'Z' => return Some((None, 64)),
        _ => return None,
    };
    Some((Some(Kind { form, size, big_endian: false }), size))
}

impl Table for DataflashTable {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn left_out(&self) -> Vec<String> {
        let others = self.messages.iter().filter(|(number, _)| **number != self.chosen && **number != FMT);
        let mut names: Vec<String> = others.map(|(_, message)| message.name.clone()).collect();
        names.sort();
        let mut all: Vec<String> = super::row::left_out("messages", &names).into_iter().collect();
        if let Some(message) = self.chosen_message(self.chosen).filter(|_| !self.further.is_empty()) {
            let sensors: Vec<String> = self.further.iter().map(i64::to_string).collect();
            all.extend(super::row::left_out(&format!("further sensors of {}:", message.name), &sensors));
        }
        all
    }

    fn next_row(&mut self, cells: &mut Vec<Cell>) -> Result<Next, RecordingError> {
        loop {
            let (number, content) = match next(&mut self.blocks, &self.messages)? {
                None => return Ok(Next::End),
                Some(Err(what)) => return Ok(Next::Damaged(what)),
                Some(Ok(message)) => message,
            };
            let Some(message) = self.messages.get(&number).filter(|_| number == self.chosen) else { continue };
            if let Some(sensor) = self.sensor_of(message, &content)
                && *self.sensor.get_or_insert(sensor) != sensor
            {
                continue;
            }
            cells.clear();
            cells.extend(
                message.fields.iter().map(|(_, at, kind)| {
                    kind.and_then(|kind| kind.number(content.get(*at..)?)).unwrap_or(Cell::Absent)
                }),
            );
            return Ok(Next::Row);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a declaration of a message of `length` bytes.
    fn declared(number: u8, length: u8, name: &str, format: &str, labels: &str) -> Vec<u8> {
        let mut bytes = vec![SYNC[0], SYNC[1], FMT, number, length];
        for (text, size) in [(name, 4), (format, 16), (labels, 64)] {
            let mut padded = text.as_bytes().to_vec();
            padded.resize(size, 0);
            bytes.extend(padded);
        }
        bytes
    }

    #[test]
    fn the_first_sensor_is_read_and_further_ones_are_named() {
        let mut bytes = declared(FMT, FMT_BYTES as u8, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns");
        bytes.extend(declared(9, 16, "IMU", "QBf", "TimeUS,I,GyrX"));
        for time_us in 0..4_u64 {
            for sensor in [1_u8, 0, 2] {
                bytes.extend([SYNC[0], SYNC[1], 9]);
                bytes.extend((1000 * time_us).to_le_bytes());
                bytes.push(sensor);
                bytes.extend(f32::from(sensor).to_le_bytes());
            }
        }
        let mut table = DataflashTable::open(&Input::memory("a.bin", bytes)).unwrap();
        assert_eq!(table.left_out(), ["further sensors of IMU: 0, 2"]);
        let (mut cells, mut rows) = (Vec::new(), Vec::new());
        while matches!(table.next_row(&mut cells), Ok(Next::Row)) {
            rows.push(cells.clone());
        }
        assert_eq!(rows.len(), 4);
        assert_eq!(rows[3], [Cell::Whole(3000), Cell::Whole(1), Cell::Number(1.0)]);
    }
}
