//! A bag's topic as rows: one message, one row.
//!
//! One topic is the recording: the one whose messages hold the sensor's raw lines, else the one with the most channels,
//! else the one with the most messages; the others are named. Where there is a raw line it decides, by its checksum, and
//! nothing else in the message is believed: the driver took its numbers from that line. Otherwise the values are those of
//! the message, in the units of ROS: tesla and pascal are converted. An orientation is not read: it is a quaternion in a
//! frame that the message does not tell.
//!
//! Topics are not merged: a magnetic field in a topic of its own is one of the others.

use super::bag::{BagReader, Connection, Record};
use super::error::RecordingError;
use super::info::{Conversion, Decimals};
use super::input::Input;
use super::ros_message::{Layout, Values};
use super::rows::{Rejected, Row, Rows};
use super::stamps::RowStamps;
use super::vn_text::{Message, line_decoder, read_message};
use crate::protocol::Decoder;
use crate::sample::{Channel, ChannelSet, DiscardCause, Sample, Triad};
use crate::units::GAUSS_PER_TESLA;
use std::collections::HashMap;

/// What a row's stamps are called.
pub(super) const STAMP_NAMES: [&str; 2] = ["time of reception", "stamp in the message's header"];
/// Connections that are looked at; a bag has one per topic and publisher.
const CONNECTIONS_MAX: usize = 256;
/// Other topics that are named.
const NAMED_MAX: usize = 20;
/// Kilopascal in one pascal.
const KPA_PER_PA: f64 = 1e-3;

/// The topic that is the recording.
#[derive(Debug, Clone)]
pub(super) struct Topic {
    topic: String,
    message_type: String,
    /// Whether its messages hold raw lines.
    raw: bool,
    channels: ChannelSet,
    /// What else is in the bag.
    others: Vec<String>,
}

/// A topic that may be it.
struct Candidate {
    topic: String,
    message_type: String,
    channels: ChannelSet,
    messages: u64,
    raw: u64,
    /// Why it is not read.
    refused: Option<String>,
}

impl Candidate {
    fn new(connection: &Connection, layout: &Result<Layout, super::ros_message::MessageError>) -> Self {
        let refused = match layout {
            Err(error) => Some(error.to_string()),
            Ok(layout) if layout.channels().next().is_none() && !layout.has_text() => Some("no IMU data".to_owned()),
            Ok(_) => None,
        };
        Self {
            topic: connection.topic.clone(),
            message_type: connection.message_type.clone(),
            channels: layout.iter().flat_map(Layout::channels).collect(),
            messages: 0,
            raw: 0,
            refused,
        }
    }

    fn is_usable(&self) -> bool {
        self.refused.is_none() && (self.raw > 0 || !self.channels.is_empty()) && self.messages > 0
    }

    fn describe(&self) -> String {
        let shown = |text: &str| text.chars().take(80).collect::<String>();
        let why = self.refused.as_ref().map_or_else(
            || format!("{} messages", self.messages),
            |refused| if refused == "no IMU data" { refused.clone() } else { format!("not read: {refused}") },
        );
        format!("{} ({}, {why})", shown(&self.topic), shown(&self.message_type))
    }
}

impl Topic {
    /// Looks through the whole bag for it.
    pub(super) fn find(input: &Input) -> Result<Self, RecordingError> {
        let mut reader = BagReader::open(input)?;
        let mut candidates: Vec<Candidate> = Vec::new();
        let mut connections: HashMap<u32, (usize, Layout)> = HashMap::new();
        let mut known = std::collections::HashSet::new();
        while let Some(record) = reader.next_record(|number| connections.contains_key(&number)) {
            match record {
                Record::Connection(connection) => {
                    if known.len() >= CONNECTIONS_MAX || !known.insert(connection.number) {
                        continue;
                    }
                    let layout = Layout::parse(&connection.message_type, &connection.definition);
                    let of_same = |candidate: &Candidate| {
                        candidate.topic == connection.topic && candidate.message_type == connection.message_type
                    };
                    let index = candidates.iter().position(of_same).unwrap_or_else(|| {
                        candidates.push(Candidate::new(&connection, &layout));
                        candidates.len() - 1
                    });
                    if let (Ok(layout), None) = (layout, &candidates[index].refused) {
                        connections.insert(connection.number, (index, layout));
                    }
                }
                Record::Message { connection, data, .. } => {
                    let Some((index, layout)) = connections.get(&connection) else { continue };
                    candidates[*index].messages += 1;
                    if layout.has_text() && layout.read(data).is_ok_and(|values| values.raw.is_some()) {
                        candidates[*index].raw += 1;
                    }
                }
                Record::Damaged { .. } => reader.check()?,
            }
        }
        reader.check()?;
        let rank = |candidate: &Candidate| (candidate.raw > 0, candidate.channels.iter().count(), candidate.messages);
        // Of equals the first.
        let best = candidates.iter().enumerate().rev().filter(|(_, candidate)| candidate.is_usable());
        let Some((index, _)) = best.max_by_key(|(_, candidate)| rank(candidate)) else {
            let names: Vec<_> = candidates.iter().take(NAMED_MAX).map(Candidate::describe).collect();
            let found = if names.is_empty() { "no topics".to_owned() } else { names.join(", ") };
            return Err(RecordingError::NoTopic { file: input.path().to_owned(), found });
        };
        let best = candidates.remove(index);
        Ok(Self {
            topic: best.topic,
            message_type: best.message_type,
            raw: best.raw > 0,
            channels: best.channels,
            others: candidates
                .iter()
                .take(NAMED_MAX)
                .map(|candidate| format!("topic {}", candidate.describe()))
                .collect(),
        })
    }
}

/// The messages of a bag's topic, one at a time.
pub(super) struct BagRows {
    reader: BagReader,
    topic: Topic,
    layouts: HashMap<u32, Layout>,
    /// Messages of the topic so far.
    messages: u64,
    decoder: Decoder,
    decimals: Decimals,
    waiting: Option<Row>,
}

impl BagRows {
    pub(super) fn open(input: &Input, topic: &Topic) -> Result<Self, RecordingError> {
        Ok(Self {
            reader: BagReader::open(input)?,
            topic: topic.clone(),
            layouts: HashMap::new(),
            messages: 0,
            decoder: line_decoder(),
            decimals: Decimals::default(),
            waiting: None,
        })
    }

    /// What of the bag is not read.
    pub(super) fn ignored(&self) -> Vec<String> {
        let mut ignored = self.topic.others.clone();
        if !self.topic.raw && self.topic.channels.contains(Channel::GyroX) {
            ignored.push("orientation (a quaternion)".to_owned());
        }
        ignored
    }

    pub(super) fn conversions(&self) -> Vec<Conversion> {
        if self.topic.raw {
            return Vec::new();
        }
        let converted = self.topic.channels.iter().filter_map(|channel| {
            let (original_unit, factor) = conversion(channel)?;
            Some(Conversion { channel, column: self.topic.topic.clone(), original_unit, factor })
        });
        converted.collect()
    }
}

/// Unit of ROS and factor, where it is not the channel's unit.
fn conversion(channel: Channel) -> Option<(&'static str, f64)> {
    match channel.triad() {
        Some(Triad::Mag) => Some(("T", GAUSS_PER_TESLA)),
        None if channel == Channel::Pressure => Some(("Pa", KPA_PER_PA)),
        _ => None,
    }
}

impl Rows for BagRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        if let Some(row) = self.waiting.take() {
            return Ok(Some(row));
        }
        let layouts = &mut self.layouts;
        while let Some(record) = self.reader.next_record(|number| layouts.contains_key(&number)) {
            match record {
                Record::Connection(connection) => {
                    if connection.topic == self.topic.topic
                        && connection.message_type == self.topic.message_type
                        && layouts.len() < CONNECTIONS_MAX
                        && !layouts.contains_key(&connection.number)
                        && let Ok(layout) = Layout::parse(&connection.message_type, &connection.definition)
                    {
                        layouts.insert(connection.number, layout);
                    }
                }
                Record::Damaged { at, what } => {
                    self.reader.check()?;
                    let text = format!("at byte {at}: {what}");
                    return Ok(Some(Row::Rejected(Rejected::new(
                        self.messages,
                        DiscardCause::Malformed,
                        &text,
                        false,
                    ))));
                }
                Record::Message { connection, received_ns, data } => {
                    let Some(layout) = layouts.get(&connection) else { continue };
                    self.messages += 1;
                    let mut stamps = RowStamps::one(received_ns);
                    let number = self.messages;
                    let values = match layout.read(data) {
                        Ok(values) => values,
                        Err(error) => {
                            let text = error.to_string();
                            let rejected = Rejected::new(number, DiscardCause::Malformed, &text, true);
                            return Ok(Some(Row::Rejected(rejected.stamped(stamps))));
                        }
                    };
                    if let Some(stamp_ns) = values.stamp_ns {
                        stamps.push(stamp_ns);
                    }
                    let (row, waiting) = if self.topic.raw {
                        from_line(number, stamps, values.raw, &mut self.decoder, &mut self.decimals)
                    } else {
                        (from_values(number, stamps, &values), None)
                    };
                    self.waiting = waiting;
                    return Ok(Some(row));
                }
            }
        }
        self.reader.check()?;
        Ok(None)
    }

    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}

/// A message with a raw line; a row that follows where a good line stands behind a spliced one.
fn from_line(
    number: u64,
    stamps: RowStamps,
    raw: Option<&[u8]>,
    decoder: &mut Decoder,
    decimals: &mut Decimals,
) -> (Row, Option<Row>) {
    let text = raw.map_or_else(|| "no raw line".into(), |raw| String::from_utf8_lossy(raw.trim_ascii()));
    let rejected = |cause| Rejected::new(number, cause, &text, true);
    let (message, bad) = match raw {
        Some(raw) => read_message(raw.trim_ascii(), decoder, decimals),
        None => (Message::Nothing, None),
    };
    match (message, bad) {
        (Message::Measurement(sample), bad) if !sample.channels().is_empty() => {
            let row = Row::Sample { line: number, stamps, sample };
            match bad {
                Some(cause) => (Row::Rejected(rejected(cause)), Some(row)),
                None => (row, None),
            }
        }
        (Message::Measurement(_), _) => {
            let cause = DiscardCause::UnexpectedFormat;
            (Row::Rejected(Rejected::new(number, cause, &text, false)), None)
        }
        (Message::Other, None) => (Row::Aside, None),
        (_, cause) => (Row::Rejected(rejected(cause.unwrap_or(DiscardCause::Malformed)).stamped(stamps)), None),
    }
}

/// A message with numbers.
fn from_values(number: u64, stamps: RowStamps, values: &Values<'_>) -> Row {
    let mut sample = Sample::at(0, 0);
    for channel in Channel::ALL {
        if let Some(value) = values.channels[channel as usize] {
            sample.set(channel, conversion(channel).map_or(value, |(_, factor)| value * factor));
        }
    }
    if sample.channels().is_empty() {
        let rejected = Rejected::new(number, DiscardCause::Malformed, "no value is a finite number", true);
        return Row::Rejected(rejected.stamped(stamps));
    }
    Row::Sample { line: number, stamps, sample }
}
