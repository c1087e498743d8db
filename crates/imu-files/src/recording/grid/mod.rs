//! The grid on which a recording's stamps lie: its period, and the grid point of each stamp.
//!
//! A sensor samples at a steady rate. Its stamps are those times, rounded to some decimals, with the jitter of the
//! clock's reader, and late if deliveries were delayed. So neither a single step nor the median step determines the
//! rate, and a long step is a gap only if the next short ones do not compensate it. In: stamps in the order of their
//! samples. Out: a [`StampGrid`] ([`find`]), and for each sample the number of empty grid points before it
//! ([`Tracker`]). Pure.
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
    /// The distance of neighbouring grid points, ns.
    pub period_ns: f64,
    /// All stamps are multiples of this, ns; 0 if they are not, or if the period is a multiple of it too.
    pub rounding_ns: u64,
    /// Standard deviation of stamps about their grid points beyond the rounding, ns; delays are excluded.
    pub jitter_ns: f64,
    /// The grid point of the first stamp, ns after that stamp, up to whole periods.
    pub(super) start_ns: f64,
    /// The possible delay of the first stamp, periods: 0 or negative.
    pub(super) first_late: i64,
    /// Whether the errors of periods accumulate, as in a loop that sleeps, reads and stamps: each stamp refers only to
    /// the one before.
    pub(super) is_loop: bool,
    /// Whether more than a twentieth of the stamps is late by most of a period.
    pub late_often: bool,
    /// Whether single losses can be distinguished from jitter. Otherwise the period is the mean step, and only holes
    /// are gaps.
    pub resolved: bool,
}

impl StampGrid {
    /// Returns whether the number of missing samples is exact: stamps are nearer to their own grid point than to any
    /// other.
    pub fn is_exact(&self) -> bool {
        self.resolved && self.jitter_ns < EXACT_JITTER * self.period_ns && (self.rounding_ns as f64) <= self.period_ns
    }
}

/// If the jitter is below this share of the period, three standard deviations are less than a period.
const EXACT_JITTER: f64 = 1.0 / 3.0;
