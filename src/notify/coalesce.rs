//! Coalescing: limits the messages for many events of one kind. Pure.
//!
//! The first event is reported at once. Events that follow within the interval are held and reported together at its
//! end. The interval then doubles, up to an hour, and is reset after an interval without an event.

use super::notice::Notice;
use crate::observe::NotifyEvent;
use std::collections::BTreeMap;
use std::time::Duration;

/// The longest interval between two messages of a kind.
const LONGEST_NS: u64 = 3_600_000_000_000;

#[derive(Debug)]
struct Slot {
    /// The earliest time of the next message of this kind.
    until_ns: u64,
    interval_ns: u64,
    held: Option<Notice>,
}

/// Decides when each event is reported.
#[derive(Debug)]
pub struct Coalescer {
    first_ns: u64,
    slots: BTreeMap<NotifyEvent, Slot>,
}

impl Coalescer {
    /// Creates a coalescer with `interval` after the first message of a kind.
    pub fn new(interval: Duration) -> Self {
        Self { first_ns: interval.as_nanos() as u64, slots: BTreeMap::new() }
    }

    /// Takes a notice; returns it if it is to be reported now.
    pub fn offer(&mut self, now_ns: u64, notice: Notice) -> Option<Notice> {
        // Each capture completes once, and each plan and each night is a different one: none of them stands for
        // another.
        let is_single = matches!(
            notice.event,
            NotifyEvent::CaptureCompleted
                | NotifyEvent::DeletionPlanned
                | NotifyEvent::NightSkipped
                | NotifyEvent::Test
        );
        if is_single {
            return Some(notice);
        }
        let slot = self.slots.entry(notice.event).or_insert(Slot { until_ns: 0, interval_ns: 0, held: None });
        if let Some(held) = &mut slot.held {
            held.take_in(notice);
            return None;
        }
        if now_ns < slot.until_ns {
            slot.held = Some(notice);
            return None;
        }
        slot.interval_ns = self.first_ns;
        slot.until_ns = now_ns.saturating_add(slot.interval_ns);
        Some(notice)
    }

    /// Returns the notices that have been held long enough, in the order of their last event; with `u64::MAX` all of
    /// them.
    pub fn due(&mut self, now_ns: u64) -> Vec<Notice> {
        let mut due = Vec::new();
        for slot in self.slots.values_mut().filter(|slot| slot.until_ns <= now_ns) {
            if let Some(notice) = slot.held.take() {
                slot.interval_ns = slot.interval_ns.saturating_mul(2).min(LONGEST_NS.max(self.first_ns));
                slot.until_ns = now_ns.saturating_add(slot.interval_ns);
                due.push(notice);
            }
        }
        due.sort_by_key(|notice| notice.utc_ns);
        due
    }

    /// Returns the time at which [`Self::due`] returns something; `None` if nothing is held.
    pub fn deadline_ns(&self) -> Option<u64> {
        self.slots.values().filter(|slot| slot.held.is_some()).map(|slot| slot.until_ns).min()
    }
}
