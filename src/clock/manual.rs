//! A clock for tests.

use super::Clock;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::Duration;

/// A clock that advances only on request.
#[derive(Debug, Default)]
pub struct ManualClock {
    mono_ns: AtomicU64,
    slept_ns: AtomicU64,
    utc_offset_ns: AtomicI64,
}

impl ManualClock {
    /// Creates a clock whose monotonic time is 0 and whose civil time is `utc_ns`.
    pub fn new(utc_ns: i64) -> Self {
        Self { mono_ns: AtomicU64::new(0), slept_ns: AtomicU64::new(0), utc_offset_ns: AtomicI64::new(utc_ns) }
    }
    /// Lets `by` pass.
    pub fn advance(&self, by: Duration) {
        self.mono_ns.fetch_add(by.as_nanos() as u64, Ordering::AcqRel);
    }
    /// Lets the machine sleep for `by`.
    pub fn suspend(&self, by: Duration) {
        self.slept_ns.fetch_add(by.as_nanos() as u64, Ordering::AcqRel);
        self.advance(by);
    }
    /// Steps the civil time without changing the monotonic one.
    pub fn step_utc(&self, by_ns: i64) {
        self.utc_offset_ns.fetch_add(by_ns, Ordering::AcqRel);
    }
}

impl Clock for ManualClock {
    fn mono_ns(&self) -> u64 {
        self.mono_ns.load(Ordering::Acquire)
    }
    fn awake_ns(&self) -> u64 {
        self.mono_ns() - self.slept_ns.load(Ordering::Acquire)
    }
    fn utc_ns(&self) -> i64 {
        self.utc_offset_ns.load(Ordering::Acquire) + self.mono_ns() as i64
    }
}
