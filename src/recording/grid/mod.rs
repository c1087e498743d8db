//! The grid on which a recording's stamps lie: its period, and the grid point of each stamp.
//!
//! A sensor samples at a steady rate; its stamps are those times, rounded to some decimals, with the jitter of whoever read
//! the clock, and late where deliveries were held up. So neither a single step nor the median one tells the rate, and a long
//! step is a gap only if the next short ones do not make up for it. In: stamps in the order of their samples. Out: a
//! [`StampGrid`] ([`find`]), and of each sample how many grid points before it have none ([`Tracker`]). Pure.
//!
//! Invariant: (samples + missing) periods = last stamp − first stamp + one period, to the jitter of these two stamps.
//! Validated in `tests` on 8 rates × rounding, jitter, delays, pairs × losses (docs/validation.md).

mod deliveries;
mod period;
#[cfg(test)]
mod tests;
mod track;

pub(super) use period::{LOOK_AT, find, rounding};
pub(super) use track::{PENDING_MAX, Placed, Tracker};

/// A grid of stamps, and how stamps differ from it.
#[derive(Debug, Clone, PartialEq)]
pub struct StampGrid {
    /// From grid point to grid point, ns.
    pub period_ns: f64,
    /// All stamps are multiples of this, ns; 0 if they are not, or if the period is a multiple of it too.
    pub rounding_ns: u64,
    /// Standard deviation of stamps about their grid points beyond the rounding, ns; delays do not count.
    pub jitter_ns: f64,
    /// When the first stamp's grid point is, ns after that stamp, but for whole periods.
    pub(super) start_ns: f64,
    /// How late the first stamp may be, periods: 0 or negative.
    pub(super) first_late: i64,
    /// Whether the errors of periods add up, as in a loop that sleeps, reads and stamps: a stamp's only reference is the one before.
    pub(super) is_loop: bool,
    /// Whether more than a twentieth of the stamps is late by most of a period.
    pub late_often: bool,
    /// Whether single losses can be told from jitter. Otherwise the period is the mean step, and only holes are gaps.
    pub resolved: bool,
}

impl StampGrid {
    /// Whether the number of missing samples is exact: stamps are nearer to their own grid point than to any other.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        self.resolved && self.jitter_ns < EXACT_JITTER * self.period_ns && (self.rounding_ns as f64) <= self.period_ns
    }
}

/// Of jitter below this share of the period three standard deviations are less than a period.
const EXACT_JITTER: f64 = 1.0 / 3.0;
