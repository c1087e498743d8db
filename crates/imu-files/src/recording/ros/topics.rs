//! Topics: determines which of a file's topics is the recording, and which topics belong to it.
//!
//! The recording is the topic whose messages hold the sensor's raw lines. Without one it is the topic that `vn100d
//! export` writes for it (values as they were recorded, beside standard messages of the same samples), else the one
//! with the most channels, else the one with the most messages. Topics that contain further channels under the same
//! stamps belong to it (drivers send a magnetic field and a temperature separately). The others are reported by name.

use super::definition;
use super::given::MessageDefinition;
use super::layout::{Layout, MessageError};
use super::{Connection, Entry};
use crate::recording::error::{RecordingError, short};
use crate::recording::info::Conversion;
use crate::recording::input::Input;
use crate::recording::kind::Kind;
use crate::recording::mapping::ColumnMap;
use imu_core::sample::{Channel, ChannelSet};
use imu_core::units::counted;
use std::collections::{HashMap, HashSet, VecDeque};

/// Connections that are examined, of readable ones and of others; a bag has one per topic and publisher.
const CONNECTIONS_MAX: usize = 256;
/// Connections of topics that are examined already: those of a split bag's further files.
const SAME_MAX: usize = 20_000;
/// Connections that are only known to contain text; whether it contains raw lines is only seen in their messages.
const TEXTS_MAX: usize = 192;
/// Connections whose numbers are kept.
const KNOWN_MAX: usize = 65_536;
/// Other topics that are reported.
const NAMED_MAX: usize = 20;
/// Paths of numbers that are reported.
const PATHS_SHOWN: usize = 64;
/// Topics whose stamps are compared.
const COMPARED_MAX: usize = 12;
/// The maximum distance, in messages, between messages of one stamp.
pub(super) const APART_MAX: usize = 64;
/// The share of a topic's messages that must have the stamp of one of the recording's messages for the topic to belong
/// to it.
const SHARE_MIN: f64 = 0.9;

/// One topic.
#[derive(Debug, Clone)]
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) message_type: String,
    /// The channels that are taken from it.
    pub(super) channels: ChannelSet,
}

impl Topic {
    fn has(&self, connection: &Connection) -> bool {
        self.name == connection.topic && self.message_type == connection.message_type
    }
}

/// The topic to which a connection belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// The recording.
    Main,
    /// One of the accompanying topics.
    Beside(usize),
}

/// The topics that are read.
#[derive(Debug, Clone)]
pub(in crate::recording) struct Topics {
    /// The kind of file.
    pub(super) kind: Kind,
    /// The layouts of their messages, by the numbers of their connections.
    pub(super) layouts: HashMap<u32, (Role, Layout)>,
    /// The recording.
    pub(super) main: Topic,
    /// Whether its messages hold raw lines.
    pub(super) raw: bool,
    /// The accompanying topics.
    pub(super) beside: Vec<Topic>,
    conversions: Vec<Conversion>,
    /// The other topics of the file.
    others: Vec<String>,
}

/// A topic that may be read.
struct Candidate {
    topic: Topic,
    messages: u64,
    raw: u64,
    /// Units that are not the channels' own.
    conversions: Vec<Conversion>,
    /// The reason why it is not read.
    refused: Option<String>,
    /// The last stamps, and the number of messages that share a stamp with each other candidate.
    stamps: VecDeque<i64>,
    shared: Vec<u64>,
    /// The pairs of the user's map that its fields satisfy, and the paths of its numbers.
    mapped: Vec<usize>,
    paths: Vec<String>,
}

/// The name that `vn100d export` gives to messages with all values as they were recorded.
const OWN_TYPE: &str = "vn100d_msgs/msg/Sample";

/// The reason why a readable topic is not read.
const NO_DATA: &str = "no IMU data";

impl Candidate {
    fn new(connection: &Connection, layout: &Result<Layout, MessageError>) -> Self {
        let refused = match layout {
            Err(error) => Some(error.to_string()),
            Ok(layout) if layout.channels().next().is_none() && !layout.has_text() => Some(NO_DATA.to_owned()),
            Ok(_) => None,
        };
        let units = || layout.iter().flat_map(Layout::channels);
        let conversions = units().filter(|(channel, unit)| unit.name != channel.unit());
        let conversions = conversions.map(|(channel, unit)| Conversion {
            channel,
            column: connection.topic.clone(),
            original_unit: unit.name,
            factor: unit.factor,
        });
        Self {
            topic: Topic {
                name: connection.topic.clone(),
                message_type: connection.message_type.clone(),
                channels: units().map(|(channel, _)| channel).collect(),
            },
            messages: 0,
            raw: 0,
            conversions: conversions.collect(),
            refused,
            stamps: VecDeque::new(),
            shared: Vec::new(),
            mapped: layout.as_ref().map(|layout| layout.mapped.clone()).unwrap_or_default(),
            paths: layout.as_ref().map(|layout| layout.paths.clone()).unwrap_or_default(),
        }
    }

    /// Returns whether its messages have numbers that are used.
    fn has_values(&self) -> bool {
        self.refused.is_none() && !self.topic.channels.is_empty()
    }

    fn is_usable(&self) -> bool {
        self.refused.is_none() && (self.raw > 0 || !self.topic.channels.is_empty()) && self.messages > 0
    }

    fn describe(&self) -> String {
        let why = self.refused.as_ref().map_or_else(
            || counted(self.messages, "message", "messages"),
            |refused| if refused == NO_DATA { refused.clone() } else { format!("not read: {refused}") },
        );
        format!("{} ({}, {why})", short(&self.topic.name), short(&self.topic.message_type))
    }
}

/// Returns the layout of a connection's messages.
fn layout_of(connection: &Connection, given: &[MessageDefinition], map: &ColumnMap) -> Result<Layout, MessageError> {
    let encoding = connection.encoding.clone()?;
    definition::layout(&connection.message_type, &connection.definition, encoding, given, map)
}

/// The result of a first pass over a file.
#[derive(Default)]
struct Search {
    candidates: Vec<Candidate>,
    connections: HashMap<u32, (usize, Layout)>,
    known: HashSet<u32>,
    /// Connections that were not examined.
    passed_over: u64,
    /// Candidates that cannot be read.
    refused: usize,
    /// Connections that have only text.
    texts: usize,
    /// Candidates whose stamps are compared.
    compared: Vec<usize>,
}

impl Search {
    /// Reads the file's entries; returns the first damage.
    fn pass(
        &mut self,
        kind: Kind,
        input: &Input,
        given: &[MessageDefinition],
    ) -> Result<Option<String>, RecordingError> {
        let mut reader = super::open(kind, input)?;
        let mut damage = None;
        while let Some(entry) = reader.next_entry(&|number| self.connections.contains_key(&number)) {
            match entry {
                Entry::Connection(connection) => self.connect(&connection, given, input.columns()),
                Entry::Message { connection, data, .. } => self.take(connection, data),
                Entry::Damaged { at, what } => {
                    damage.get_or_insert(if at == 0 { what } else { format!("at byte {at}: {what}") });
                    reader.check()?;
                }
            }
        }
        reader.check()?;
        Ok(damage)
    }

    fn connect(&mut self, connection: &Connection, given: &[MessageDefinition], map: &ColumnMap) {
        if self.known.contains(&connection.number) {
            return;
        }
        let same = self.candidates.iter().position(|candidate| candidate.topic.has(connection));
        // Each file of a split bag states its topics again.
        let most = if same.is_some() { SAME_MAX } else { CONNECTIONS_MAX };
        if self.known.len() >= KNOWN_MAX || self.connections.len() >= most {
            self.passed_over += 1;
            return;
        }
        self.known.insert(connection.number);
        let layout = layout_of(connection, given, map);
        let index = match same {
            Some(index) => index,
            None => {
                let candidate = Candidate::new(connection, &layout);
                // Cameras and the like are numerous: they must not displace readable topics.
                if candidate.refused.is_some() && self.refused >= CONNECTIONS_MAX {
                    self.passed_over += 1;
                    return;
                }
                self.refused += usize::from(candidate.refused.is_some());
                if candidate.has_values() && self.compared.len() < COMPARED_MAX {
                    self.compared.push(self.candidates.len());
                }
                self.candidates.push(candidate);
                self.candidates.len() - 1
            }
        };
        let candidate = &self.candidates[index];
        if candidate.refused.is_none() && !candidate.has_values() {
            if self.texts >= TEXTS_MAX && same.is_none() {
                self.passed_over += 1;
                return;
            }
            self.texts += usize::from(same.is_none());
        }
        if let (Ok(layout), None) = (layout, &self.candidates[index].refused) {
            self.connections.insert(connection.number, (index, layout));
        }
    }

    fn take(&mut self, connection: u32, data: &[u8]) {
        let Some((index, layout)) = self.connections.get(&connection) else { return };
        let index = *index;
        self.candidates[index].messages += 1;
        // If there is only one topic, nothing is to be compared.
        if !layout.has_text() && self.candidates.len() < 2 {
            return;
        }
        let Ok(values) = layout.read(data) else { return };
        self.candidates[index].raw += u64::from(values.raw.is_some());
        let Some(stamp_ns) = values.stamp_ns.filter(|_| self.compared.contains(&index)) else { return };
        for other in self.compared.iter().copied() {
            if other != index && self.candidates[other].stamps.contains(&stamp_ns) {
                self.candidates[index].share(other);
                self.candidates[other].share(index);
            }
        }
        let stamps = &mut self.candidates[index].stamps;
        stamps.push_back(stamp_ns);
        if stamps.len() > APART_MAX {
            stamps.pop_front();
        }
    }
}

impl Candidate {
    /// Counts a message that shares a stamp with another candidate.
    fn share(&mut self, other: usize) {
        if self.shared.len() <= other {
            self.shared.resize(other + 1, 0);
        }
        self.shared[other] += 1;
    }
}

/// Checks that every pair of the user's map names a field of the topic, and no two the same channel.
fn check_map(input: &Input, main: &Candidate) -> Result<(), RecordingError> {
    let map = input.columns();
    let file = || input.path().to_owned();
    if let Some((first, second, channel)) = map.twice() {
        let (first, second) = (short(&first), short(&second));
        return Err(RecordingError::DuplicateColumn { file: file(), first, second, channel });
    }
    match map.foreign().enumerate().find(|(pair, _)| !main.mapped.contains(pair)) {
        Some((_, foreign)) => Err(RecordingError::NoColumn {
            file: file(),
            column: format!(
                "{:?} with numbers of a channel in {}",
                short(&foreign.to_string()),
                short(&main.topic.name)
            ),
            found: if main.paths.is_empty() { "none".to_owned() } else { main.paths.join(" | ") },
        }),
        None => Ok(()),
    }
}

impl Topics {
    /// Searches the whole file for the topics.
    ///
    /// # Errors
    /// [`RecordingError::NoTopic`] with the topics present, or the error of reading.
    pub(in crate::recording) fn find(
        kind: Kind,
        input: &Input,
        given: &[MessageDefinition],
    ) -> Result<Self, RecordingError> {
        let mut search = Search::default();
        let damage = search.pass(kind, input, given)?;
        if damage.is_some() {
            // The damaged part may have stated the type of later messages; it is stated again at the end.
            for candidate in &mut search.candidates {
                (candidate.messages, candidate.raw) = (0, 0);
                (candidate.stamps, candidate.shared) = (VecDeque::new(), Vec::new());
            }
            search.pass(kind, input, given)?;
        }
        let passed_over = (search.passed_over > 0)
            .then(|| format!("{} more connections, which were not looked at", search.passed_over));
        let connections = search.connections;
        let mut candidates = search.candidates;
        let rank = |candidate: &Candidate| {
            let topic = &candidate.topic;
            let mapped = candidate.mapped.len();
            (
                mapped,
                candidate.raw > 0,
                topic.message_type == OWN_TYPE,
                topic.channels.iter().count(),
                candidate.messages,
            )
        };
        // Of equals the first is taken.
        let usable = candidates.iter().enumerate().rev().filter(|(_, candidate)| candidate.is_usable());
        let Some((main, _)) = usable.max_by_key(|(_, candidate)| rank(candidate)) else {
            let names: Vec<_> = candidates.iter().take(NAMED_MAX).map(Candidate::describe).chain(passed_over).collect();
            let mut found = if names.is_empty() { "no topics".to_owned() } else { names.join(", ") };
            let paths: Vec<&str> = candidates
                .iter()
                .flat_map(|candidate| &candidate.paths)
                .take(PATHS_SHOWN)
                .map(String::as_str)
                .collect();
            if !input.columns().is_empty() && !paths.is_empty() {
                found.push_str(&format!("; none of its numbers is mapped: {}", paths.join(" | ")));
            }
            if let Some(damage) = damage {
                found.push_str(&format!("; it is damaged: {damage}"));
            }
            return Err(RecordingError::NoTopic { file: input.path().to_owned(), found });
        };
        check_map(input, &candidates[main])?;
        // What the user names counts, not a line beside it.
        let raw = candidates[main].raw > 0 && input.columns().is_empty();
        let mut roles = vec![None; candidates.len()];
        roles[main] = Some(Role::Main);
        let (mut taken, mut beside) = (candidates[main].topic.channels, Vec::new());
        let mut conversions = if raw { Vec::new() } else { candidates[main].conversions.clone() };
        let mut others = Vec::new();
        for (index, candidate) in candidates.iter_mut().enumerate() {
            if index == main {
                continue;
            }
            let fresh: ChannelSet =
                candidate.topic.channels.iter().filter(|channel| !taken.contains(*channel)).collect();
            let shared = candidate.shared.get(main).copied().unwrap_or(0) as f64;
            if !raw && candidate.is_usable() && !fresh.is_empty() && shared >= SHARE_MIN * candidate.messages as f64 {
                taken = taken.union(fresh);
                conversions.extend(
                    candidate.conversions.iter().filter(|conversion| fresh.contains(conversion.channel)).cloned(),
                );
                roles[index] = Some(Role::Beside(beside.len()));
                beside.push(Topic { channels: fresh, ..candidate.topic.clone() });
            } else if others.len() < NAMED_MAX {
                others.push(format!("topic {}", candidate.describe()));
            }
        }
        others.extend(passed_over);
        let main = candidates.swap_remove(main).topic;
        let layouts = connections.into_iter().filter_map(|(number, (index, layout))| {
            roles.get(index).copied().flatten().map(|role| (number, (role, layout)))
        });
        Ok(Self { kind, layouts: layouts.collect(), main, raw, beside, conversions, others })
    }

    /// Returns the parts of the file that are not read.
    pub(in crate::recording) fn ignored(&self) -> Vec<String> {
        let mut ignored = self.others.clone();
        if !self.raw && self.main.channels.contains(Channel::GyroX) && !self.main.channels.contains(Channel::Yaw) {
            ignored.push("orientation (a quaternion)".to_owned());
        }
        ignored
    }

    /// Returns the channels in other units than their own.
    pub(in crate::recording) fn conversions(&self) -> Vec<Conversion> {
        self.conversions.clone()
    }
}
