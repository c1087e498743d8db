//! Placing: assigns a grid point to each stamped entry of a recording. Pure.
//!
//! Whether a long step is a gap is known only after it ([`super::grid`]), so entries wait: at most [`PENDING_MAX`]
//! samples, and as many rejected lines between them.

use super::choice::Chosen;
use super::error::RecordingError;
use super::grid::{PENDING_MAX, Placed, Tracker};
use super::order::{Entry, Order};
use super::rows::Rows;
use std::collections::VecDeque;

/// Assigns the samples that [`Order`] accepts to their places on the grid.
#[derive(Debug)]
pub(super) struct Placing {
    order: Order,
    /// `None` without stamps.
    tracker: Option<Tracker>,
    held: VecDeque<Entry>,
    ended: bool,
}

impl Placing {
    pub(super) fn new(chosen: &Chosen) -> Self {
        let tracker = chosen.grid.as_ref().filter(|_| chosen.column.is_some()).map(Tracker::new);
        Self { order: Order::new(chosen), tracker, held: VecDeque::new(), ended: false }
    }

    /// Returns the next entry, a stamped sample with its place; `None` at the end.
    pub(super) fn next_entry(
        &mut self,
        rows: &mut dyn Rows,
    ) -> Result<Option<(Entry, Option<Placed>)>, RecordingError> {
        loop {
            match self.held.front() {
                Some(Entry::Sample { stamp_ns: Some(_), .. }) => {
                    if let Some(placed) = self.tracker.as_mut().and_then(Tracker::next) {
                        return Ok(self.held.pop_front().map(|entry| (entry, Some(placed))));
                    }
                }
                Some(_) => return Ok(self.held.pop_front().map(|entry| (entry, None))),
                None if self.ended => return Ok(None),
                None => {}
            }
            let full = self.held.len() >= 2 * PENDING_MAX;
            let next = if full { None } else { self.order.next_entry(rows)? };
            let Some(entry) = next else {
                self.ended |= !full;
                if let Some(tracker) = &mut self.tracker {
                    tracker.finish();
                }
                continue;
            };
            if let (Some(tracker), Entry::Sample { stamp_ns: Some(stamp_ns), .. }) = (&mut self.tracker, &entry) {
                tracker.push(*stamp_ns);
                if self.held.is_empty()
                    && let Some(placed) = tracker.next()
                {
                    return Ok(Some((entry, Some(placed))));
                }
            } else if self.held.is_empty() {
                return Ok(Some((entry, None)));
            }
            self.held.push_back(entry);
        }
    }

    /// Returns the mean period of all stamps, ns, and how often they left the grid.
    pub(super) fn outcome(&self) -> Option<(f64, u64)> {
        let tracker = self.tracker.as_ref()?;
        Some((tracker.mean_period_ns()?, tracker.slips))
    }
}
