//! Accounting: converts a stream of samples to segments and gaps, so that every missing sample is counted once. Pure.
//!
//! In: samples in the order of their arrival, interruptions of the connection, rejected frames. Out:
//! [`Record::Segment`], [`Record::Sample`] and [`Record::Gap`].
//!
//! With the sensor's clock ([`Timebase::Device`]) a step of k periods means k − 1 missing samples, exactly. A step back
//! beyond [`REORDER_WINDOW_NS`] is a reset and begins a new epoch, across which `missing` follows from the host's
//! clock. Without it ([`Timebase::Arrival`]) a sample counts as missing only when the stream stays late: arrivals are
//! late by latency, never early, and a burst that catches up lost nothing. These samples are held until it is decided
//! whether samples are missing and whether the rate is still the same.
//!
//! `ticks` decides about samples with the sensor's ticks, `arrival` about those without; this file has the common part.
//! The properties below are tested: received + missing = sent, for any losses, jitter and bursts.

mod arrival;
#[cfg(test)]
mod rate_tests;
#[cfg(test)]
mod stall_tests;
#[cfg(test)]
mod tests;
mod ticks;

pub use arrival::DOUBT_AGAIN_NS;

use arrival::Arrival;
use ticks::{Lag, Rerun, Trial};

use super::{DiscardCause, Gap, GapCause, Record, Sample, Segment, Timebase};
use crate::units::period_ns;
use std::collections::VecDeque;

/// A device time that goes back by at most this is a duplicate or a reordered frame; by more, the clock was reset.
pub const REORDER_WINDOW_NS: u64 = 1_000_000_000;
/// How fast host and sensor clocks may drift apart unnoticed (500 ppm is ten times the drift that both may have).
const DRIFT: f64 = 500e-6;
/// This many steps of one length in succession are another rate: no loss removes every other sample so regularly.
const RATE_STEPS_MIN: usize = 12;

/// A sample that is later than the quickest ones by less than this is on time, ns.
const ON_TIME_NS: f64 = 5e7;
/// The host's trouble is over once samples have been on time for this long, ns.
const RECOVERED_NS: f64 = 5e8;

/// The result for one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Observation {
    /// The sample was taken (or is held until it is known whether samples are missing before it).
    Taken,
    /// A sample with the same device time exists already.
    Duplicate,
    /// A later sample was taken before it.
    OutOfOrder,
    /// The sample was taken, and the sensor's clock restarted before it.
    AfterReset,
    /// The sample was taken, and the sensor's clock was set ahead before it, by this much more than the host's
    /// advanced, ns.
    ClockAhead(u64),
    /// The sample was taken, and the last dozen samples came at another rate than before.
    RateChanged {
        /// The rate so far, Hz.
        from_hz: f64,
        /// The rate now, Hz.
        to_hz: f64,
    },
}

/// The doubt about the rate raised by the arrivals of samples without time, for a caller that can query the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RateDoubt {
    /// The samples do not arrive at the rate; it is undecided whether samples are lost or the rate has changed. The longest time
    /// before an undecided sample without another, ns.
    Open(u64),
    /// The samples came at another rate for long enough, and the rate was adopted, after such a time.
    Changed(u64),
}

impl RateDoubt {
    /// Returns whether the sensor was reset before the samples in doubt: none came for longer than these rates (before and now,
    /// Hz) explain. A gap of these samples has the same cause.
    pub fn is_reset(self, rate_hz: f64, now_hz: f64) -> bool {
        let (Self::Open(silence_ns) | Self::Changed(silence_ns)) = self;
        silence_ns as f64 > arrival::silence_of_a_reset(period_ns(rate_hz), period_ns(now_hz))
    }
}

/// The end of the accounted samples, from which the next sample is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Device time of the last sample.
    pub device_time_ns: Option<u64>,
    /// Serial count of the last sample.
    pub sync_count: Option<u32>,
    /// Host monotonic time of the last sample; 0 if it belongs to another boot of the machine.
    pub host_mono_ns: u64,
    /// Host UTC of the last sample.
    pub host_utc_ns: i64,
}

/// Counts the received and the missing samples of a capture.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Accountant {
    rate_hz: f64,
    timebase: Timebase,
    last: Option<Position>,
    /// Rate of the last sample's segment, Hz: it differs from `rate_hz` if a new rate was announced and no sample has
    /// come since.
    last_rate_hz: f64,
    /// The open segment, which the next sample may continue.
    open: Option<Segment>,
    segments: u32,
    epoch: u32,
    received: u64,
    missing: u64,
    gaps: u64,
    /// The cause of an interruption of the connection since the last sample.
    interrupted: Option<GapCause>,
    /// The reason why samples may be missing although the connection is open: a rejected frame or a stalled host.
    suspicion: Option<GapCause>,
    /// The host's own trouble, which is the cause of gaps shown by samples that arrive until this monotonic time, ns.
    host_trouble: Option<(GapCause, u64)>,
    /// How long samples have been on time since the host's trouble, ns.
    on_time_ns: f64,
    /// Samples whose steps have one wrong length: another rate, or losses.
    trial: Trial,
    rerun: Rerun,
    /// Measurements that turned out to be no samples after they were held: number and cause.
    refused: Vec<(u64, DiscardCause)>,
    /// The observations at held samples that no sample has returned yet.
    held_observations: VecDeque<Observation>,
    arrival: Arrival,
    /// Whether counted samples are taken whose rate is undecided.
    undecided: bool,
    /// The doubt not yet passed to the caller that can query the sensor.
    doubt: Option<RateDoubt>,
    /// The host's own lateness in reading, ns: a shorter delay shows nothing about the sensor.
    host_jitter_ns: f64,
    backward: u32,
    /// How much later the last sample was read than the quickest of its epoch, ns.
    late_ns: f64,
    lag: Lag,
    /// How long no sample has come earlier than the quickest so far, ns of the sensor's clock.
    on_line_ns: f64,
}

impl Accountant {
    /// Creates an accountant of a new capture. `rate_hz` is above 0.
    pub fn new(rate_hz: f64, timebase: Timebase) -> Self {
        Self { rate_hz, timebase, last_rate_hz: rate_hz, epoch: 1, ..Self::default() }
    }

    /// Returns the accountant for a host whose own lateness in reading is up to `host_jitter_ns`.
    ///
    /// At real time the host's jitter is below a period. If time runs faster, the jitter is multiplied by the speed.
    /// Without the sensor's clock, a shorter silence cannot be distinguished from jitter.
    pub fn with_host_jitter(self, host_jitter_ns: f64) -> Self {
        Self { host_jitter_ns, ..self }
    }

    /// Returns an accountant that continues where an earlier one stopped. `segments`, `epoch`, `received`, `missing`,
    /// `gaps` and the last sample's position come from the database. Samples missing until the next one have `cause`.
    pub fn resume(
        rate_hz: f64,
        timebase: Timebase,
        counts: (u32, u32, u64, u64, u64),
        last: Option<Position>,
        cause: GapCause,
    ) -> Self {
        let (segments, epoch, received, missing, gaps) = counts;
        let interrupted = last.map(|_| cause);
        Self {
            segments,
            epoch: epoch.max(1),
            received,
            missing,
            gaps,
            last,
            interrupted,
            ..Self::new(rate_hz, timebase)
        }
    }

    /// Returns the number of received samples, held ones included.
    pub fn received(&self) -> u64 {
        self.received + self.held()
    }

    /// Returns the number of samples that are held until it is known whether some are missing before them.
    pub fn held(&self) -> u64 {
        (self.arrival.held.len() + self.trial.held.len() + self.rerun.held.len()) as u64
    }

    /// Returns the frame number of the first held sample.
    pub fn held_from(&self) -> Option<u64> {
        let held = [&self.rerun.held, &self.arrival.held, &self.trial.held];
        held.into_iter().filter_map(|held| held.first()).map(|sample| sample.frame).min()
    }

    /// Returns the number of missing samples.
    pub fn missing(&self) -> u64 {
        self.missing
    }

    /// Returns the number of recorded gaps.
    pub fn gaps(&self) -> u64 {
        self.gaps
    }

    /// Returns the output rate in Hz.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Returns the timebase of the samples.
    pub fn timebase(&self) -> Timebase {
        self.timebase
    }

    /// Returns the number of the run of the sensor's clock, from 1.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Returns the last sample taken.
    pub fn last(&self) -> Option<Position> {
        self.last
    }

    /// Returns the cause that a gap would have if one appeared now.
    pub fn interruption(&self) -> Option<GapCause> {
        self.interrupted
    }

    /// Interrupts the connection: samples missing until the next one have this cause. The first cause is kept.
    pub fn interrupt(&mut self, cause: GapCause, out: &mut Vec<Record>) {
        self.settle(out);
        if self.last.is_some() {
            // The host is the cause of all effects of its own standstill.
            let cause = self.host_trouble.map_or(cause, |(cause, _)| cause);
            self.interrupted.get_or_insert(cause);
        }
    }

    /// Records that the host stood still or slept: it is the cause of gaps that samples arriving until `until_mono_ns`
    /// show.
    pub fn blame_host(&mut self, cause: GapCause, until_mono_ns: u64) {
        if self.host_trouble.is_none_or(|(_, until_ns)| until_ns < until_mono_ns) {
            self.host_trouble = Some((cause, until_mono_ns));
        }
        self.on_time_ns = 0.0;
    }

    /// Records whether a sample came on time, `step_ns` after the one before. Once samples have been on time for a while, the host
    /// is the cause of no more effects.
    fn note_lateness(&mut self, late_ns: f64, step_ns: f64) {
        // A longer step may be such an effect.
        let on_time = late_ns < ON_TIME_NS.max(self.host_jitter_ns) && step_ns < 1.5 * period_ns(self.rate_hz);
        self.on_time_ns = if on_time { self.on_time_ns + step_ns } else { 0.0 };
        if self.on_time_ns > RECOVERED_NS {
            self.host_trouble = None;
        }
    }

    /// Returns and clears the doubt about the rate, if any.
    pub fn take_doubt(&mut self) -> Option<RateDoubt> {
        self.doubt.take()
    }

    /// Returns the observation at a held sample that no later sample has returned, if any.
    pub fn take_observation(&mut self) -> Option<Observation> {
        self.held_observations.pop_front()
    }

    /// Returns the measurements that were held and turned out to be no samples, since the last call: number and cause.
    pub fn take_refused(&mut self) -> Vec<(u64, DiscardCause)> {
        std::mem::take(&mut self.refused)
    }

    /// Records a rejected frame, or a host that did not run for a while: a likely cause of the next gap.
    pub fn suspect(&mut self, cause: GapCause) {
        self.suspicion.get_or_insert(cause);
    }

    /// Continues the stream at another rate or with other times, from the next sample, in a new segment.
    pub fn change(&mut self, rate_hz: f64, timebase: Timebase, out: &mut Vec<Record>) {
        self.settle(out);
        if (rate_hz, timebase) != (self.rate_hz, self.timebase) {
            self.rate_hz = rate_hz;
            self.timebase = timebase;
            self.open = None;
        }
    }

    /// Takes one sample.
    pub fn observe(&mut self, sample: Sample, out: &mut Vec<Record>) -> Observation {
        if self.host_trouble.is_some_and(|(_, until_mono_ns)| sample.host_mono_ns > until_mono_ns) {
            self.host_trouble = None;
        }
        let seen = match (self.timebase, sample.device_time_ns, sample.sync_count) {
            _ if !self.rerun.held.is_empty() => self.observe_rerun(sample, Self::observe, out),
            (Timebase::Device, Some(_), _) => self.observe_ticks(sample, out),
            (Timebase::SyncCounter, _, Some(_)) => self.observe_counted(sample, out),
            _ => {
                self.observe_arrival(sample, out);
                Observation::Taken
            }
        };
        if seen == Observation::Taken { self.held_observations.pop_front().unwrap_or(seen) } else { seen }
    }

    /// Decides about held samples; must be called before the capture ends.
    pub fn settle(&mut self, out: &mut Vec<Record>) {
        while self.held() > 0 {
            self.end_trial(out);
            self.release_all(out);
            self.end_rerun(Self::observe, out);
        }
    }

    /// Counts `missing` samples between the last one and `to_utc_ns`, if the capture ends without a further sample.
    pub fn close_with_gap(&mut self, missing: u64, to_utc_ns: i64, out: &mut Vec<Record>) {
        self.settle(out);
        let cause = self.cause();
        let from_utc_ns = self.last.map_or(to_utc_ns, |last| last.host_utc_ns);
        self.push_gap(
            Gap {
                before_seq: self.received,
                from_utc_ns,
                to_utc_ns,
                device_ns: None,
                missing,
                missing_exact: false,
                cause,
            },
            out,
        );
    }

    /// Returns a gap between the last sample and this one. It ends when this one would have come without delay. Its
    /// length is that of the sensor's clock, else that of the host's monotonic one or of the missing samples. Two
    /// samples that are read at once do not determine a length, and neither does civil time that was stepped or set in
    /// between.
    fn gap(
        &self,
        last: &Position,
        sample: &Sample,
        device_ns: Option<(u64, u64)>,
        missing: u64,
        missing_exact: bool,
        cause: GapCause,
    ) -> Gap {
        let period = period_ns(self.last_rate_hz);
        let one_boot = is_one_boot(last, sample);
        let length_ns = match device_ns {
            Some((from, to)) => to.wrapping_sub(from) as f64,
            // Samples that were counted at another rate do not show how long they took.
            None if one_boot && self.rate_changes() => (sample.host_mono_ns - last.host_mono_ns) as f64,
            None if one_boot => ((sample.host_mono_ns - last.host_mono_ns) as f64).max(missing as f64 * period),
            None => (missing + 1) as f64 * period,
        };
        let late_ns = if device_ns.is_some() && one_boot { self.late_ns } else { 0.0 };
        let to_utc_ns = sample.host_utc_ns - late_ns as i64;
        let from_utc_ns = to_utc_ns - length_ns as i64;
        Gap { before_seq: self.received, from_utc_ns, to_utc_ns, device_ns, missing, missing_exact, cause }
    }

    fn push_gap(&mut self, gap: Gap, out: &mut Vec<Record>) {
        self.missing += gap.missing;
        self.gaps += 1;
        self.open = None;
        out.push(Record::Gap(gap));
    }

    /// Returns the most likely cause of a gap that appears now.
    fn cause(&self) -> GapCause {
        let host = self.host_trouble.map(|(cause, _)| cause);
        self.interrupted.or(host).or(self.suspicion).unwrap_or(GapCause::Silent)
    }

    fn gap_by_host(&mut self, last: &Position, sample: &Sample, host_ns: f64, cause: GapCause, out: &mut Vec<Record>) {
        // A gap has the rate of the samples before it.
        let missing = (host_ns / period_ns(self.last_rate_hz)).round() as u64;
        if missing > 1 {
            let cause = self.interrupted.or(self.host_trouble.map(|(cause, _)| cause)).unwrap_or(cause);
            let gap = self.gap(last, sample, None, missing - 1, false, cause);
            self.push_gap(gap, out);
        }
    }

    fn take(&mut self, sample: Sample, out: &mut Vec<Record>) {
        self.interrupted = None;
        self.suspicion = None;
        // A count that was announced but does not arrive is not used.
        let timebase = match self.timebase {
            Timebase::SyncCounter if sample.sync_count.is_none() => Timebase::Arrival,
            timebase => timebase,
        };
        let goes_on = |open: &Segment| open.channels == sample.channels() && open.timebase == timebase;
        self.open = self.open.take().filter(goes_on);
        if self.open.is_none() {
            self.segments += 1;
            let segment = Segment {
                number: self.segments,
                epoch: self.epoch,
                first_seq: self.received,
                rate_hz: self.rate_hz,
                timebase,
                channels: sample.channels(),
                first_device_time_ns: sample.device_time_ns,
                first_utc_ns: sample.host_utc_ns,
                // The recorder knows the boot.
                boot_id: None,
            };
            out.push(Record::Segment(segment.clone()));
            self.open = Some(segment);
        }
        self.last = Some(Position {
            device_time_ns: sample.device_time_ns,
            sync_count: sample.sync_count,
            host_mono_ns: sample.host_mono_ns,
            host_utc_ns: sample.host_utc_ns,
        });
        self.last_rate_hz = self.rate_hz;
        out.push(Record::Sample { seq: self.received, segment: self.segments, sample });
        self.received += 1;
    }
}

/// Returns whether the host's monotonic clock determines the distance of the two samples.
fn is_one_boot(last: &Position, sample: &Sample) -> bool {
    last.host_mono_ns > 0 && sample.host_mono_ns >= last.host_mono_ns
}

/// Returns the host time from the last sample to a later instant, ns: monotonic within one boot, civil across boots.
pub fn host_elapsed_ns(last: &Position, mono_ns: u64, utc_ns: i64) -> f64 {
    if last.host_mono_ns > 0 && mono_ns >= last.host_mono_ns {
        (mono_ns - last.host_mono_ns) as f64
    } else {
        civil_elapsed_ns(last.host_utc_ns, utc_ns)
    }
}

/// Civil time before 2025 is that of a host whose clock has not been set, UTC ns.
pub const UTC_UNSET_BEFORE_NS: i64 = 1_735_689_600_000_000_000;

/// Returns the civil time from one instant to a later one, ns; 0 if it went back, or if the clock was set in between so
/// that the duration is unknown. In these cases only the sensor's own clock counts.
fn civil_elapsed_ns(from_utc_ns: i64, to_utc_ns: i64) -> f64 {
    if from_utc_ns < UTC_UNSET_BEFORE_NS && to_utc_ns >= UTC_UNSET_BEFORE_NS {
        return 0.0;
    }
    to_utc_ns.saturating_sub(from_utc_ns).max(0) as f64
}
