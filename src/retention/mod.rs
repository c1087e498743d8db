//! Retention: determines which captures are to be deleted, when, and why. Pure: captures, the time and the limits in, a
//! plan out.
//!
//! Guarantees, for any captures, limits and clock (tests/properties below): a capture that runs, waits or is pinned is
//! never in the plan. The oldest are deleted first. No more are deleted than the limits require. No deletion is due
//! before its whole notice has passed. A clock that is not trusted (it steps, it went back, the daemon was absent past
//! the date) begins the notice again. A clock with an implausible date ([`Judge`]) determines no ages at all: a late
//! deletion costs space, an early one costs a night.

mod judge;

use imu_core::sample::accounting::UTC_UNSET_BEFORE_NS;
use std::time::Duration;

pub use judge::{Distrust, Judge, Moment, Verdict};

/// The limits for captures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Older captures are deleted; unlimited if absent.
    pub keep: Option<Duration>,
    /// All captures together take no more than this many bytes; unlimited if absent.
    pub keep_bytes: Option<u64>,
    /// The minimum time between an announcement and the deletion.
    pub notice: Duration,
}

impl Limits {
    /// Returns whether no capture is ever deleted.
    pub fn is_unlimited(&self) -> bool {
        self.keep.is_none() && self.keep_bytes.is_none()
    }
}

/// The facts about a capture that retention needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Its id.
    pub id: i64,
    /// The time since which it is complete: its end (of a recording of years ago its import), UTC ns.
    pub since_utc_ns: i64,
    /// Its size in bytes.
    pub bytes: u64,
    /// Whether it runs or waits.
    pub open: bool,
    /// Whether it is kept from deletion.
    pub pinned: bool,
    /// The announcement: its time, and the earliest time of the deletion, UTC ns.
    pub announced: Option<Announcement>,
}

/// The announcement of a deletion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Announcement {
    /// The time of the announcement, UTC ns.
    pub made_utc_ns: i64,
    /// The earliest time of the deletion, UTC ns.
    pub delete_at_utc_ns: i64,
}

/// The limit that is exceeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// `keep-days`
    Age,
    /// `keep-mib`
    Size,
}

impl Reason {
    /// Returns the name in status and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Age => "age",
            Self::Size => "size",
        }
    }
}

/// A capture whose deletion is planned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Planned {
    /// Its id.
    pub id: i64,
    /// Its size in bytes.
    pub bytes: u64,
    /// The reason.
    pub reason: Reason,
    /// The times of the announcement and of the deletion.
    pub announcement: Announcement,
    /// Whether the announcement is new.
    pub is_new: bool,
    /// Whether its time has come.
    pub is_due: bool,
}

/// Returns the captures to delete at `now_utc_ns`, oldest first. After a step of the clock (`verdict`) the notice of
/// announcements begins now. With an untrusted clock none is deleted for its age, and the captures made first count as
/// the oldest.
pub fn plan(captures: &[Candidate], now_utc_ns: i64, verdict: &Verdict, limits: &Limits) -> Vec<Planned> {
    let is_trusted = verdict.distrust.is_none();
    let mut oldest_first: Vec<&Candidate> =
        captures.iter().filter(|capture| !capture.open && !capture.pinned).collect();
    // A capture dated by a clock of 1970 must not count as the oldest while that clock still runs: ids follow the order
    // of creation.
    oldest_first.sort_by_key(|capture| (if is_trusted { capture.since_utc_ns } else { 0 }, capture.id));
    let mut total: u64 = captures.iter().fold(0, |sum, capture| sum.saturating_add(capture.bytes));
    let mut planned: Vec<Planned> = Vec::new();
    for capture in oldest_first {
        let has_age = is_trusted && capture.since_utc_ns >= UTC_UNSET_BEFORE_NS;
        let old_at = limits.keep.filter(|_| has_age).map(|keep| {
            let keep_ns = i64::try_from(keep.as_nanos()).unwrap_or(i64::MAX);
            capture.since_utc_ns.saturating_add(keep_ns)
        });
        let notice_ns = i64::try_from(limits.notice.as_nanos()).unwrap_or(i64::MAX);
        let ages = old_at.filter(|old_at| old_at.saturating_sub(notice_ns) <= now_utc_ns);
        let too_large = limits.keep_bytes.is_some_and(|keep_bytes| total > keep_bytes);
        let (reason, wanted_at) = match ages {
            Some(old_at) => (Reason::Age, old_at),
            None if too_large => (Reason::Size, now_utc_ns),
            None => continue,
        };
        total -= capture.bytes.min(total);
        let standing = capture.announced.filter(|announcement| {
            !verdict.stepped
                // The deletion was announced by this clock, and is not longer overdue than its notice was: otherwise
                // nobody may have seen it.
                && announcement.made_utc_ns <= now_utc_ns
                && announcement.delete_at_utc_ns >= announcement.made_utc_ns.saturating_add(notice_ns)
                && now_utc_ns <= announcement.delete_at_utc_ns.saturating_add(notice_ns.max(LATE_NS))
        });
        let announcement = standing.unwrap_or(Announcement {
            made_utc_ns: now_utc_ns,
            delete_at_utc_ns: wanted_at.max(now_utc_ns.saturating_add(notice_ns)),
        });
        // None is deleted for its size while an older one still waits: that one may turn out to be enough.
        let in_turn = reason == Reason::Age || planned.iter().all(|older| older.is_due);
        planned.push(Planned {
            id: capture.id,
            bytes: capture.bytes,
            reason,
            announcement,
            is_new: standing.is_none(),
            is_due: !verdict.is_first && in_turn && standing.is_some() && announcement.delete_at_utc_ns <= now_utc_ns,
        });
    }
    planned
}

/// The minimum lateness with which the daemon may do an announced deletion: a restart does not begin its notice again.
const LATE_NS: i64 = 3_600_000_000_000;

#[cfg(test)]
mod tests;
