//! Recordings of ROS: bags of ROS 1 (`.bag`), of ROS 2 (`.db3`), and MCAP files.
//!
//! A file of each kind is read as [`Entry`]s: connections, which state a topic's type, and the messages of those that
//! are wanted ([`Messages`]). A message is read by its type's [layout](layout). [`topics`] finds the topic that is the
//! recording and the topics that belong to it; [`rows`] converts its messages to rows.

mod bag;
mod chain;
mod db3;
mod definition;
mod field;
mod given;
mod layout;
mod mcap;
mod rows;
mod topics;

#[cfg(test)]
mod tests;

pub use given::{DefinitionError, MessageDefinition, is_type_name};

pub(super) use bag::MAGIC as BAG_MAGIC;
pub use db3::unmerged_log;
pub(super) use db3::{MAGIC as SQLITE_MAGIC, check as check_db3};
pub(super) use mcap::MAGIC as MCAP_MAGIC;
pub(super) use rows::{RosRows, STAMP_NAMES};
pub(super) use topics::Topics;

use super::error::RecordingError;
use super::input::Input;
use super::kind::Kind;
use layout::{Encoding, MessageError};

/// One entry of a file.
#[derive(Debug, PartialEq)]
enum Entry<'a> {
    /// A connection: messages with its number follow.
    Connection(Connection),
    /// A message of a wanted connection, its time of reception in ns since 1970, and its bytes.
    Message { connection: u32, received_ns: i64, data: &'a [u8] },
    /// Damaged data, and the byte of the file at which it begins.
    Damaged { at: u64, what: String },
}

/// A source of messages.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Connection {
    number: u32,
    topic: String,
    /// Name of the message's type.
    message_type: String,
    /// Text of its definition and those of the types in it; empty if the file lacks it.
    definition: String,
    /// The encoding of its messages, or why they cannot be read.
    encoding: Result<Encoding, MessageError>,
}

/// A file's entries, one after another.
trait Messages {
    /// Returns the next entry; `None` at the end. Messages of unwanted connections are skipped.
    fn next_entry(&mut self, wanted: &dyn Fn(u32) -> bool) -> Option<Entry<'_>>;

    /// Checks whether the file was read as far as possible: a cancelled reading looks like a damaged file.
    ///
    /// # Errors
    /// [`RecordingError::Unwanted`] and [`RecordingError::Expands`].
    fn check(&self) -> Result<(), RecordingError>;
}

/// Opens a recording of one of these kinds: a file, or all files of a split bag.
fn open(kind: Kind, input: &Input) -> Result<Box<dyn Messages>, RecordingError> {
    if input.further().is_empty() { open_one(kind, input) } else { Ok(Box::new(chain::Chain::open(kind, input)?)) }
}

/// Opens a file of one of these kinds.
fn open_one(kind: Kind, input: &Input) -> Result<Box<dyn Messages>, RecordingError> {
    Ok(match kind {
        Kind::Db3 => Box::new(db3::Db3Reader::open(input)?),
        Kind::Mcap => Box::new(mcap::McapReader::open(input)?),
        _ => Box::new(bag::BagReader::open(input)?),
    })
}
