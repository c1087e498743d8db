//! A ROS 2 bag that is split into several files: their entries one file after another, as if it were one.
//!
//! Each file states its connections again, with numbers of its own; here they are numbers of the whole. A file that
//! cannot be opened is damage, and the next one is read.

use super::super::error::RecordingError;
use super::super::input::Input;
use super::super::kind::Kind;
use super::{Entry, Messages, open_one};
use std::collections::VecDeque;

/// Numbers of connections in one file: MCAP has 16 bits, and of a `.db3` fewer topics are examined.
const NUMBERS: u32 = 1 << 16;

/// Reads the files' messages.
pub(super) struct Chain {
    kind: Kind,
    current: Box<dyn Messages>,
    next: VecDeque<Input>,
    /// What is added to the numbers of the present file.
    offset: u32,
    /// The present message.
    held: Vec<u8>,
}

impl Chain {
    pub(super) fn open(kind: Kind, input: &Input) -> Result<Self, RecordingError> {
        let next = input.further().iter().map(|path| input.clone().with_path(path.clone())).collect();
        Ok(Self { kind, current: open_one(kind, input)?, next, offset: 0, held: Vec::new() })
    }
}

impl Messages for Chain {
    fn next_entry(&mut self, wanted: &dyn Fn(u32) -> bool) -> Option<Entry<'_>> {
        loop {
            let offset = self.offset;
            match self.current.next_entry(&|number| wanted(number.saturating_add(offset))) {
                Some(Entry::Connection(connection)) => {
                    let number = connection.number.saturating_add(offset);
                    return Some(Entry::Connection(super::Connection { number, ..connection }));
                }
                Some(Entry::Damaged { at, what }) => return Some(Entry::Damaged { at, what }),
                Some(Entry::Message { connection, received_ns, data }) => {
                    self.held.clear();
                    self.held.extend_from_slice(data);
                    let connection = connection.saturating_add(offset);
                    return Some(Entry::Message { connection, received_ns, data: &self.held });
                }
                None => {}
            }
            // A reading that was called off ends here too: no further file is begun.
            if self.current.check().is_err() {
                return None;
            }
            let input = self.next.pop_front()?;
            match open_one(self.kind, &input) {
                Ok(reader) => {
                    self.current = reader;
                    self.offset = self.offset.saturating_add(NUMBERS);
                }
                Err(error) => return Some(Entry::Damaged { at: 0, what: error.to_string() }),
            }
        }
    }

    fn check(&self) -> Result<(), RecordingError> {
        self.current.check()
    }
}
