//! Arrival: samples that carry no time: a loss is a lasting delay, and what is late is held until that is decided. Pure.

use super::{Accountant, DRIFT, host_elapsed_ns};
use crate::sample::{GapCause, Record, Sample};
use crate::units::period_ns;

/// Without device time: for how long the stream must stay late before samples count as missing.
const DECISION_S: f64 = 0.1;
/// Without device time: the share of a period by which the stream must be late.
const LATE_PERIODS: f64 = 0.75;
/// Without device time: lateness below this says nothing by itself: an FTDI adapter's latency timer is 16 ms at worst.
const HOST_JITTER_NS: f64 = 20e6;
/// Without device time: how many samples may be held while a burst catches up.
const HELD_MAX: usize = 16_384;

/// The expected arrival of the next sample, for streams without device time.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Arrival {
    /// Earliest plausible arrival of the sample to come, ns of the host's monotonic clock.
    pub(super) next_mono_ns: f64,
    /// Samples that came late and not yet in time again.
    pub(super) held: Vec<Sample>,
    /// How late the least late of the steady held samples was, ns.
    pub(super) least_late_ns: f64,
    /// Held samples in succession that did not catch up.
    pub(super) steady: u32,
    /// How late the last held sample was, ns.
    pub(super) previous_late_ns: f64,
}

impl Accountant {
    pub(super) fn observe_arrival(&mut self, sample: Sample, out: &mut Vec<Record>) {
        let period = period_ns(self.rate_hz);
        let arrived = sample.host_mono_ns as f64;
        let Some(last) = self.last else {
            self.arrival.next_mono_ns = arrived + period;
            self.take(sample, out);
            return;
        };
        if self.interrupted.is_some() || last.device_time_ns.is_some() || self.arrival.next_mono_ns == 0.0 {
            let host_ns = host_elapsed_ns(&last, sample.host_mono_ns, sample.host_utc_ns);
            self.gap_by_host(&last, &sample, host_ns, GapCause::FormatChange, out);
            self.arrival.next_mono_ns = arrived + period;
            self.take(sample, out);
            return;
        }
        let late = arrived - self.arrival.next_mono_ns;
        self.arrival.next_mono_ns += period;
        // A rejected frame explains one missing sample; without it lateness must exceed what a host does by itself.
        let jitter_ns = if self.suspicion.is_some() { 0.0 } else { self.host_jitter_ns.max(HOST_JITTER_NS) };
        if late < (LATE_PERIODS * period).max(jitter_ns) {
            // In time: whatever was held has caught up and nothing is missing.
            self.arrival.next_mono_ns += if late < 0.0 { late } else { late.min(DRIFT * period) };
            let held = std::mem::take(&mut self.arrival.held);
            for earlier in held {
                self.take(earlier, out);
            }
            self.take(sample, out);
            return;
        }
        let arrival = &mut self.arrival;
        if arrival.held.is_empty() || arrival.previous_late_ns - late > 0.5 * period {
            arrival.steady = 0;
            arrival.least_late_ns = f64::INFINITY;
        }
        arrival.steady += 1;
        arrival.least_late_ns = arrival.least_late_ns.min(late);
        arrival.previous_late_ns = late;
        arrival.held.push(sample);
        let enough = (DECISION_S * self.rate_hz).ceil().max(4.0) as u32;
        if arrival.steady >= enough || arrival.held.len() >= HELD_MAX {
            let late = arrival.least_late_ns;
            self.release(late, out);
        }
    }

    /// The held samples are late for good: `late_ns` of samples are missing before them.
    pub(super) fn release(&mut self, late_ns: f64, out: &mut Vec<Record>) {
        let held = std::mem::take(&mut self.arrival.held);
        self.arrival.steady = 0;
        let period = period_ns(self.rate_hz);
        let missing = (late_ns / period).round() as u64;
        if let (Some(last), Some(first), true) = (self.last, held.first(), missing > 0) {
            self.arrival.next_mono_ns += missing as f64 * period;
            let gap = self.gap(&last, first, None, missing, false, self.cause());
            self.push_gap(gap, out);
        }
        for sample in held {
            self.take(sample, out);
        }
    }
}
