//! The messages of a file's topics as rows: one message of the recording's topic, one row.
//!
//! If there is a raw line, its checksum decides, and the other values of the message are ignored: the driver took its
//! numbers from that line. Otherwise the values are those of the message and of the messages of other topics with its
//! stamp, in the units of ROS: tesla and pascal are converted. An orientation is not read: it is a quaternion in a
//! frame that the message does not state.

use super::super::error::RecordingError;
use super::super::input::Input;
use super::super::rows::{Decimals, Rejected, Row, Rows};
use super::super::stamps::RowStamps;
use super::super::vn_text::{Message, line_decoder, read_message};
use super::layout::Values;
use super::topics::{APART_MAX, Role, Topics};
use super::{Entry, Messages};
use imu_core::sample::{Channel, ChannelSet, DiscardCause, Sample};
use std::collections::VecDeque;
use vn100_proto::Decoder;

/// The names of a row's stamps.
pub(in crate::recording) const STAMP_NAMES: [&str; 2] = ["time of reception", "stamp in the message's header"];

/// A row whose companions may still arrive.
struct Waiting {
    row: Row,
    /// The stamp of its companions.
    stamp_ns: Option<i64>,
    /// The number of companions still missing.
    lacks: usize,
}

/// A companion whose row has not arrived yet.
struct Early {
    stamp_ns: i64,
    beside: usize,
    values: [Option<f64>; Channel::COUNT],
}

/// The rows of a file's topics, one at a time.
pub(in crate::recording) struct RosRows {
    reader: Box<dyn Messages>,
    topics: Topics,
    /// Messages of the recording's topic so far.
    messages: u64,
    decoder: Decoder,
    decimals: Decimals,
    waiting: VecDeque<Waiting>,
    early: VecDeque<Early>,
    ended: bool,
}

impl RosRows {
    pub(in crate::recording) fn open(input: &Input, topics: &Topics) -> Result<Self, RecordingError> {
        Ok(Self {
            reader: super::open(topics.kind, input)?,
            topics: topics.clone(),
            messages: 0,
            decoder: line_decoder(),
            decimals: Decimals::default(),
            waiting: VecDeque::new(),
            early: VecDeque::new(),
            ended: false,
        })
    }

    /// Reads the next entry of the file into the waiting rows.
    fn read_entry(&mut self) -> Result<(), RecordingError> {
        let layouts = &self.topics.layouts;
        let Some(entry) = self.reader.next_entry(&|number| layouts.contains_key(&number)) else {
            self.reader.check()?;
            self.ended = true;
            // Companions whose rows never arrived.
            while let Some(early) = self.early.pop_front() {
                self.push(alone(&self.topics, &early, self.messages));
            }
            return Ok(());
        };
        match entry {
            Entry::Connection(_) => {}
            Entry::Damaged { at, what } => {
                self.reader.check()?;
                let text = if at == 0 { what } else { format!("at byte {at}: {what}") };
                let rejected = Rejected::new(self.messages, DiscardCause::Malformed, &text, false);
                self.push(Row::Rejected(rejected));
            }
            Entry::Message { connection, received_ns, data } => {
                let Some((role, layout)) = self.topics.layouts.get(&connection) else { return Ok(()) };
                let values = layout.read(data);
                match *role {
                    Role::Main => {
                        self.messages += 1;
                        let number = self.messages;
                        let mut stamps = RowStamps::one(received_ns);
                        let stamp_ns = values.as_ref().ok().and_then(|values| values.stamp_ns);
                        if let Some(stamp_ns) = stamp_ns {
                            stamps.push(stamp_ns);
                        }
                        let (row, behind) = match &values {
                            Err(error) => {
                                let text = error.to_string();
                                let rejected = Rejected::new(number, DiscardCause::Malformed, &text, true);
                                (Row::Rejected(rejected.stamped(stamps)), None)
                            }
                            Ok(values) if self.topics.raw => {
                                from_line(number, stamps, values.raw, &mut self.decoder, &mut self.decimals)
                            }
                            Ok(values) => (from_values(number, stamps, values), None),
                        };
                        let lacks = if matches!(row, Row::Sample { .. }) { self.topics.beside.len() } else { 0 };
                        self.waiting.push_back(Waiting { row, stamp_ns, lacks });
                        if lacks > 0 {
                            self.join_early();
                        }
                        if let Some(row) = behind {
                            self.push(row);
                        }
                    }
                    Role::Beside(beside) => {
                        let Ok(Values { stamp_ns: Some(stamp_ns), channels, .. }) = values else {
                            let text = format!("a message of {} without a stamp", self.topics.beside[beside].name);
                            let rejected = Rejected::new(self.messages, DiscardCause::Malformed, &text, false);
                            self.push(Row::Rejected(rejected));
                            return Ok(());
                        };
                        self.companion(Early { stamp_ns, beside, values: channels });
                    }
                }
            }
        }
        Ok(())
    }

    fn push(&mut self, row: Row) {
        self.waiting.push_back(Waiting { row, stamp_ns: None, lacks: 0 });
    }

    /// Adds a companion to its row, or keeps it until the row arrives.
    fn companion(&mut self, companion: Early) {
        let channels = self.topics.beside[companion.beside].channels;
        let row = self.waiting.iter_mut().rev().find(|row| row.stamp_ns == Some(companion.stamp_ns));
        match row {
            Some(row) => row.join(channels, &companion.values),
            None => {
                self.early.push_back(companion);
                if self.early.len() > APART_MAX
                    && let Some(early) = self.early.pop_front()
                {
                    self.push(alone(&self.topics, &early, self.messages));
                }
            }
        }
    }

    /// Adds the companions that arrived before it to the last row.
    fn join_early(&mut self) {
        let Some(row) = self.waiting.back_mut() else { return };
        let topics = &self.topics;
        self.early.retain(|early| {
            let its_own = row.stamp_ns == Some(early.stamp_ns);
            if its_own {
                row.join(topics.beside[early.beside].channels, &early.values);
            }
            !its_own
        });
    }
}

impl Waiting {
    fn join(&mut self, channels: ChannelSet, values: &[Option<f64>; Channel::COUNT]) {
        self.lacks = self.lacks.saturating_sub(1);
        if let Row::Sample { sample, .. } = &mut self.row {
            for channel in channels.iter() {
                if let Some(value) = values[channel as usize] {
                    sample.set(channel, value);
                }
            }
        }
    }
}

/// Returns the row of a companion that belongs to no message.
fn alone(topics: &Topics, early: &Early, messages: u64) -> Row {
    let (beside, main) = (&topics.beside[early.beside].name, &topics.main.name);
    let text = format!("a message of {beside} whose stamp no message of {main} has");
    Row::Rejected(Rejected::new(messages, DiscardCause::UnexpectedFormat, &text, false))
}

impl Rows for RosRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        loop {
            let ready = match self.waiting.front() {
                None => self.ended,
                Some(front) => self.ended || front.lacks == 0 || self.waiting.len() > APART_MAX,
            };
            if ready {
                return Ok(self.waiting.pop_front().map(|waiting| waiting.row));
            }
            self.read_entry()?;
        }
    }

    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}

/// Returns the rows of a message with a raw line; a second row follows if a good line stands behind a spliced one.
fn from_line(
    number: u64,
    stamps: RowStamps,
    raw: Option<&[u8]>,
    decoder: &mut Decoder,
    decimals: &mut Decimals,
) -> (Row, Option<Row>) {
    let text = || raw.map_or_else(|| "no raw line".into(), |raw| String::from_utf8_lossy(raw.trim_ascii()));
    let rejected = |cause| Rejected::new(number, cause, &text(), true);
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
            (Row::Rejected(Rejected::new(number, cause, &text(), false)), None)
        }
        (Message::Other, None) => (Row::Aside, None),
        (_, cause) => (Row::Rejected(rejected(cause.unwrap_or(DiscardCause::Malformed)).stamped(stamps)), None),
    }
}

/// Returns the row of a message with numbers.
fn from_values(number: u64, stamps: RowStamps, values: &Values<'_>) -> Row {
    let mut sample = Sample::at(0, 0);
    for channel in Channel::ALL {
        if let Some(value) = values.channels[channel as usize] {
            sample.set(channel, value);
        }
    }
    if sample.channels().is_empty() {
        let rejected = Rejected::new(number, DiscardCause::Malformed, "no value is a finite number", true);
        return Row::Rejected(rejected.stamped(stamps));
    }
    Row::Sample { line: number, stamps, sample }
}
