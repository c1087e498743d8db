//! Retention: which captures are to be deleted, when, and why. Pure: captures, the time and the limits in, a plan out.
//!
//! Promised, for any captures, limits and clock (tests/properties below): one that runs, waits or is pinned is never in
//! the plan; the oldest go first; no more go than the limits ask for; nothing is due that has not been announced for the
//! whole notice. A clock that is not to be trusted (it steps, it went back, the daemon was away past the date) begins the
//! notice anew, and one that shows an implausible date ([`Judge`]) tells no ages at all: too late a deletion costs space,
//! too early a one costs a night.

mod judge;

use crate::sample::accounting::UTC_UNSET_BEFORE_NS;
use std::time::Duration;

pub use judge::{Distrust, Judge, Moment, Verdict};

/// What captures may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Older ones go; without limit where absent.
    pub keep: Option<Duration>,
    /// All together take no more than so many bytes; without limit where absent.
    pub keep_bytes: Option<u64>,
    /// How long before its deletion one is announced, at least.
    pub notice: Duration,
}

impl Limits {
    /// Whether anything is ever deleted.
    #[must_use]
    pub fn is_unlimited(&self) -> bool {
        self.keep.is_none() && self.keep_bytes.is_none()
    }
}

/// A capture, as far as it matters here.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Its id.
    pub id: i64,
    /// Since when it is there whole: its end (of a recording of years ago its import), UTC ns.
    pub since_utc_ns: i64,
    /// What it takes.
    pub bytes: u64,
    /// Whether it runs or waits.
    pub open: bool,
    /// Whether it is kept from deletion.
    pub pinned: bool,
    /// What was announced: when it was said, and not before when it is deleted, UTC ns.
    pub announced: Option<Announcement>,
}

/// What was said of a deletion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Announcement {
    /// When it was said, UTC ns.
    pub said_utc_ns: i64,
    /// Not deleted before, UTC ns.
    pub delete_at_utc_ns: i64,
}

/// Which limit is exceeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// `keep-days`
    Age,
    /// `keep-mib`
    Size,
}

impl Reason {
    /// As status and messages name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Age => "age",
            Self::Size => "size",
        }
    }
}

/// A capture that is going to be deleted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Planned {
    /// Its id.
    pub id: i64,
    /// What it takes, bytes.
    pub bytes: u64,
    /// Why.
    pub reason: Reason,
    /// When it was said, and when it goes.
    pub announcement: Announcement,
    /// Whether that was said only now.
    pub is_new: bool,
    /// Whether its time has come.
    pub is_due: bool,
}

/// The captures to delete at `now_utc_ns`, oldest first. After a step of the clock (`verdict`) what was announced counts from
/// now; by one that is not believed none goes for its age, and those that were made first are the oldest.
#[must_use]
pub fn plan(captures: &[Candidate], now_utc_ns: i64, verdict: &Verdict, limits: &Limits) -> Vec<Planned> {
    let tells_ages = verdict.distrust.is_none();
    let mut oldest_first: Vec<&Candidate> =
        captures.iter().filter(|capture| !capture.open && !capture.pinned).collect();
    // A capture of a clock of 1970 must not pass for the oldest while that clock still runs: ids follow the making.
    oldest_first.sort_by_key(|capture| (if tells_ages { capture.since_utc_ns } else { 0 }, capture.id));
    let mut total: u64 = captures.iter().fold(0, |sum, capture| sum.saturating_add(capture.bytes));
    let mut planned: Vec<Planned> = Vec::new();
    for capture in oldest_first {
        let has_age = tells_ages && capture.since_utc_ns >= UTC_UNSET_BEFORE_NS;
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
                // Said by this clock, and not longer past its time than its notice was: else nobody may have seen it.
                && announcement.said_utc_ns <= now_utc_ns
                && announcement.delete_at_utc_ns >= announcement.said_utc_ns.saturating_add(notice_ns)
                && now_utc_ns <= announcement.delete_at_utc_ns.saturating_add(notice_ns.max(LATE_NS))
        });
        let announcement = standing.unwrap_or(Announcement {
            said_utc_ns: now_utc_ns,
            delete_at_utc_ns: wanted_at.max(now_utc_ns.saturating_add(notice_ns)),
        });
        // For its size none goes while an older one still waits: that one may turn out to be enough.
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

/// How late the daemon may come to a deletion that was announced, at least: a restart does not begin its notice anew.
const LATE_NS: i64 = 3_600_000_000_000;

#[cfg(test)]
mod tests;
