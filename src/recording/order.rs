//! The order of a recording's samples: their stamps are of one clock and increase. What is of another clock or not later
//! than the sample before is rejected.

use super::choice::Chosen;
use super::rows::{Rejected, Row};
use super::stamps::UNIX_FROM_NS;
use crate::sample::{DiscardCause, Sample};
use crate::units::NANOS_PER_SECOND;

/// A row, with the stamp that counts.
pub(super) enum Entry {
    Sample {
        stamp_ns: Option<i64>,
        sample: Sample,
    },
    /// With its stamp, where it stands for a sample and its stamp is later than that of the sample before.
    Rejected(Rejected, Option<i64>),
    Aside,
}

/// Keeps stamps increasing.
#[derive(Debug)]
pub(super) struct Order {
    /// Which stamp of a row counts; `None`: the recording has none.
    column: Option<usize>,
    /// Whether stamps are times since 1970.
    unix: bool,
    pub(super) last_stamp_ns: Option<i64>,
}

impl Order {
    pub(super) fn new(chosen: &Chosen) -> Self {
        Self { column: chosen.column, unix: chosen.unix, last_stamp_ns: None }
    }

    pub(super) fn check(&mut self, row: Row) -> Entry {
        let stamp_of = |stamps: super::stamps::RowStamps| self.column.and_then(|column| stamps.get(column));
        match row {
            Row::Aside => Entry::Aside,
            Row::Rejected(rejected) => {
                let stamp_ns = stamp_of(rejected.stamps)
                    .filter(|stamp_ns| self.last_stamp_ns.is_some_and(|last| *stamp_ns > last))
                    .filter(|_| rejected.stands_for_sample);
                Entry::Rejected(rejected, stamp_ns)
            }
            Row::Sample { line, stamps, sample } => match (self.column, stamp_of(stamps)) {
                (None, _) => Entry::Sample { stamp_ns: None, sample },
                (Some(_), None) => {
                    Entry::Rejected(Rejected::new(line, DiscardCause::Malformed, "it has no stamp", true), None)
                }
                (Some(_), Some(stamp_ns)) if (stamp_ns >= UNIX_FROM_NS) != self.unix => {
                    let stamp_s = stamp_ns as f64 / NANOS_PER_SECOND as f64;
                    let clock = if self.unix { "a time since 1970" } else { "from the recording's origin" };
                    let text = format!("stamp {stamp_s} s is not {clock}, as the others are");
                    Entry::Rejected(Rejected::new(line, DiscardCause::Malformed, &text, true), None)
                }
                (Some(_), Some(stamp_ns)) if self.last_stamp_ns.is_some_and(|last| stamp_ns <= last) => {
                    let stamp_s = stamp_ns as f64 / NANOS_PER_SECOND as f64;
                    let text = format!("stamp {stamp_s} s is not later than the one before");
                    Entry::Rejected(Rejected::new(line, DiscardCause::Duplicate, &text, false), None)
                }
                (Some(_), Some(stamp_ns)) => {
                    self.last_stamp_ns = Some(stamp_ns);
                    Entry::Sample { stamp_ns: Some(stamp_ns), sample }
                }
            },
        }
    }
}
