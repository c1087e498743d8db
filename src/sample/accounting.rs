//! Accounting: turns a stream of samples into segments and gaps, so that every missing sample is counted once. Pure.
//!
//! In: samples in the order of their arrival, interruptions of the connection, frames that were rejected.
//! Out: [`Record::Segment`], [`Record::Sample`] and [`Record::Gap`].
//!
//! With the sensor's clock ([`Timebase::Device`]) a step of k periods means k − 1 missing samples, exactly; a step back
//! beyond [`REORDER_WINDOW_NS`] is a reset and begins a new epoch, across which `missing` follows from the host's clock.
//! Without it ([`Timebase::Arrival`]) a sample counts as missing only when the stream stays late: arrivals are late by
//! latency, never early, and a burst that catches up lost nothing. Until that is decided the samples concerned are held
//! back, for at most [`DECISION_S`] of steady flow.
//!
//! Tested by the properties below: received + missing = sent, for any losses, jitter and bursts.

use super::{DiscardCause, Gap, GapCause, Record, Sample, Segment, Timebase};
use crate::units::{IMU_RATE_HZ, period_ns};

/// A device time that lies back by no more than this is a duplicate or a reordered frame; beyond it the clock was reset.
pub const REORDER_WINDOW_NS: u64 = 1_000_000_000;
/// Without device time: for how long the stream must stay late before samples count as missing.
pub const DECISION_S: f64 = 0.1;
/// Without device time: the share of a period by which the stream must be late.
const LATE_PERIODS: f64 = 0.75;
/// Without device time: lateness below this says nothing by itself: an FTDI adapter's latency timer is 16 ms at worst.
const HOST_JITTER_NS: f64 = 20e6;
/// How fast host and sensor clocks may drift apart unnoticed (500 ppm is ten times what both may).
const DRIFT: f64 = 500e-6;
/// Without device time: how many samples may be held while a burst catches up.
const HELD_MAX: usize = 16_384;
/// Steps of the sensor's ticks that differ from the period by more than this share are another rate or losses; they are of
/// one length within [`RATE_SAME`].
const RATE_ODD: f64 = 0.2;
const RATE_SAME: f64 = 0.01;
/// So many steps of one length in succession, over so many ns, are another rate: nothing loses every other sample so
/// regularly. At 100 Hz that is decided after 0.12 s, at 20 Hz after 0.6 s.
const RATE_STEPS_MIN: usize = 12;
const RATE_TRIAL_NS: f64 = 1e8;
/// No loss makes a step shorter than a period. So many of one length in succession are another rate although the stream
/// was interrupted before it was tried for long; one or two may be a tick that is wrong.
const RATE_STEPS_SHORT: usize = 3;
/// A longer step is no rate, ns: register 7's lowest is 1 Hz.
const RATE_STEP_MAX_NS: f64 = 1.5e9;
/// Civil and monotonic time that disagree by more about a distance: civil time was stepped, ns.
const UTC_STEP_NS: i64 = 10_000_000;
/// After an interruption, device and host must agree on its length within this share (and [`EPOCH_SLACK_NS`]);
/// otherwise the sensor was without power in between and its clock started again.
const EPOCH_SHARE: f64 = 1e-3;
const EPOCH_SLACK_NS: f64 = 2e9;

/// What came of one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Observation {
    /// It was taken (or is held until it is clear whether samples are missing before it).
    Taken,
    /// Its device time was there already.
    Duplicate,
    /// A later one was taken before it.
    OutOfOrder,
    /// It was taken, and the sensor's clock had started again before it.
    AfterReset,
    /// It was taken, and the last dozen came at another rate than before.
    RateChanged {
        /// The rate so far, Hz.
        from_hz: f64,
        /// The rate now, Hz.
        to_hz: f64,
    },
}

/// The end of what is accounted for: where the next sample is measured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Device time of the last sample.
    pub device_time_ns: Option<u64>,
    /// Serial count of the last sample.
    pub sync_count: Option<u32>,
    /// Host monotonic time of the last sample; 0 where it belongs to another boot of the machine.
    pub host_mono_ns: u64,
    /// Host UTC of the last sample.
    pub host_utc_ns: i64,
}

/// Counts what a capture has and what it lacks.
#[derive(Debug, Clone, PartialEq)]
pub struct Accountant {
    rate_hz: f64,
    timebase: Timebase,
    last: Option<Position>,
    /// A segment is open and the next sample may continue it.
    open: Option<Segment>,
    segments: u32,
    epoch: u32,
    received: u64,
    missing: u64,
    gaps: u64,
    /// The connection was interrupted since the last sample, and why.
    interrupted: Option<GapCause>,
    /// Why samples may be missing although the connection stands: a rejected frame, a stalled host.
    suspicion: Option<GapCause>,
    /// What the host did to itself: the cause of gaps seen by samples that arrive until then, monotonic ns.
    host_trouble: Option<(GapCause, u64)>,
    /// Samples whose steps are of one wrong length: another rate, or losses?
    trial: Trial,
    /// Measurements that turned out to be no samples after they were held: number and cause.
    refused: Vec<(u64, DiscardCause)>,
    arrival: Arrival,
    /// How late a host may read for reasons of its own, ns: lateness below it says nothing about the sensor.
    host_jitter_ns: f64,
    backward: u32,
    /// How much later than the quickest of its epoch the last sample was read, ns.
    late_ns: f64,
}

/// Samples in succession that do not come at the rate.
#[derive(Debug, Clone, PartialEq, Default)]
struct Trial {
    held: Vec<Sample>,
    /// The step between the first two, ns of the sensor's clock.
    step_ns: f64,
}

/// The expected arrival of the next sample, for streams without device time.
#[derive(Debug, Clone, PartialEq, Default)]
struct Arrival {
    /// Earliest plausible arrival of the sample to come, ns of the host's monotonic clock.
    next_mono_ns: f64,
    /// Samples that came late and not yet in time again.
    held: Vec<Sample>,
    /// How late the least late of the steady held samples was, ns.
    least_late_ns: f64,
    /// Held samples in succession that did not catch up.
    steady: u32,
    /// How late the last held sample was, ns.
    previous_late_ns: f64,
}

impl Accountant {
    /// An accountant of a capture that has nothing yet. `rate_hz` is above 0.
    #[must_use]
    pub fn new(rate_hz: f64, timebase: Timebase) -> Self {
        Self {
            rate_hz,
            timebase,
            last: None,
            open: None,
            segments: 0,
            epoch: 1,
            received: 0,
            missing: 0,
            gaps: 0,
            interrupted: None,
            suspicion: None,
            host_trouble: None,
            trial: Trial::default(),
            refused: Vec::new(),
            arrival: Arrival::default(),
            host_jitter_ns: 0.0,
            backward: 0,
            late_ns: 0.0,
        }
    }

    /// The same, for a host that may read late by up to `host_jitter_ns` for reasons of its own.
    ///
    /// At real time the host's jitter is below a period. Where time runs faster it is magnified by the speed, and without
    /// the sensor's clock a silence shorter than it cannot be told from it.
    #[must_use]
    pub fn with_host_jitter(self, host_jitter_ns: f64) -> Self {
        Self { host_jitter_ns, ..self }
    }

    /// An accountant that goes on where an earlier one stopped: `segments`, `epoch`, `received`, `missing`, `gaps` and
    /// the last sample's position as the database has them. What is missing until the next sample has `cause`.
    #[must_use]
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

    /// Samples received (held ones included).
    #[must_use]
    pub fn received(&self) -> u64 {
        self.received + self.held()
    }
    /// Samples that are held until it is clear whether some are missing before them.
    #[must_use]
    pub fn held(&self) -> u64 {
        (self.arrival.held.len() + self.trial.held.len()) as u64
    }
    /// The frame number of the first held sample.
    #[must_use]
    pub fn held_from(&self) -> Option<u64> {
        self.arrival.held.first().or(self.trial.held.first()).map(|sample| sample.frame)
    }
    /// Samples missing.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.missing
    }
    /// Gaps recorded.
    #[must_use]
    pub fn gaps(&self) -> u64 {
        self.gaps
    }
    /// Output rate in Hz.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }
    /// What the times rest on.
    #[must_use]
    pub fn timebase(&self) -> Timebase {
        self.timebase
    }
    /// The run of the sensor's clock, from 1.
    #[must_use]
    pub fn epoch(&self) -> u32 {
        self.epoch
    }
    /// The last sample taken.
    #[must_use]
    pub fn last(&self) -> Option<Position> {
        self.last
    }
    /// The cause that a gap would have if one showed now.
    #[must_use]
    pub fn interruption(&self) -> Option<GapCause> {
        self.interrupted
    }

    /// The connection is interrupted: samples missing until the next one have this cause. The first cause stands.
    pub fn interrupt(&mut self, cause: GapCause, out: &mut Vec<Record>) {
        self.settle(out);
        if self.last.is_some() {
            // What follows from the host's own standstill is its doing.
            let cause = self.host_trouble.map_or(cause, |(cause, _)| cause);
            self.interrupted.get_or_insert(cause);
        }
    }

    /// The host stood or slept: gaps that samples arriving until `until_mono_ns` show are its doing.
    pub fn blame_host(&mut self, cause: GapCause, until_mono_ns: u64) {
        self.host_trouble = Some((cause, until_mono_ns));
    }

    /// Measurements that were held and turned out to be no samples, since the last call: number and cause.
    pub fn take_refused(&mut self) -> Vec<(u64, DiscardCause)> {
        std::mem::take(&mut self.refused)
    }

    /// A frame was rejected, or the host did not run for a while: a likely cause of the next gap.
    pub fn suspect(&mut self, cause: GapCause) {
        self.suspicion.get_or_insert(cause);
    }

    /// The stream goes on at another rate or with other times, from the next sample, in a new segment.
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
        match (self.timebase, sample.device_time_ns, sample.sync_count) {
            (Timebase::Device, Some(_), _) | (Timebase::SyncCounter, _, Some(_)) => self.observe_ticks(sample, out),
            _ => {
                self.observe_arrival(sample, out);
                Observation::Taken
            }
        }
    }

    /// Decides on samples that are held; to be called before the capture ends.
    pub fn settle(&mut self, out: &mut Vec<Record>) {
        self.end_trial(out);
        if !self.arrival.held.is_empty() {
            let late = if self.arrival.steady > 0 { self.arrival.least_late_ns } else { self.arrival.previous_late_ns };
            self.release(late, out);
        }
    }

    /// Counts `missing` samples between the last one and `to_utc_ns`, where the capture ends without a further sample.
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

    /// A gap between the last sample and this one. Where civil time was stepped in between it is told by the time of the
    /// later one: a gap has no negative length.
    fn gap(
        &self,
        last: &Position,
        sample: &Sample,
        device_ns: Option<(u64, u64)>,
        missing: u64,
        missing_exact: bool,
        cause: GapCause,
    ) -> Gap {
        let stepped = is_one_boot(last, sample)
            && ((sample.host_utc_ns - last.host_utc_ns) - (sample.host_mono_ns - last.host_mono_ns) as i64).abs()
                > UTC_STEP_NS;
        let from_utc_ns = if stepped {
            sample.host_utc_ns - (sample.host_mono_ns - last.host_mono_ns) as i64
        } else {
            last.host_utc_ns.min(sample.host_utc_ns)
        };
        Gap {
            before_seq: self.received,
            from_utc_ns,
            to_utc_ns: sample.host_utc_ns,
            device_ns,
            missing,
            missing_exact,
            cause,
        }
    }

    fn push_gap(&mut self, gap: Gap, out: &mut Vec<Record>) {
        self.missing += gap.missing;
        self.gaps += 1;
        self.open = None;
        out.push(Record::Gap(gap));
    }

    /// The most likely cause of a gap that shows now.
    fn cause(&self) -> GapCause {
        let host = self.host_trouble.map(|(cause, _)| cause);
        self.interrupted.or(host).or(self.suspicion).unwrap_or(GapCause::Silent)
    }

    /// How far the sensor's tick of the later instant is ahead of the earlier one's, ns: its clock in ns, or its count of
    /// messages. Both wrap, at 2^64 and 2^32: what is less than half of that ahead is ahead.
    fn ahead_ns(&self, earlier: (Option<u64>, Option<u32>), later: (Option<u64>, Option<u32>)) -> Option<i64> {
        if self.timebase == Timebase::SyncCounter {
            let count = later.1?.wrapping_sub(earlier.1?) as i32;
            return Some((f64::from(count) * period_ns(self.rate_hz)) as i64);
        }
        Some(later.0?.wrapping_sub(earlier.0?) as i64)
    }

    /// With the sensor's ticks: a step that is no period is the first of another rate, or a gap. The samples are held until
    /// the following steps tell.
    fn observe_ticks(&mut self, sample: Sample, out: &mut Vec<Record>) -> Observation {
        let explained = self.interrupted.is_some() || self.host_trouble.is_some() || self.suspicion.is_some();
        let earlier = match (self.trial.held.last(), self.last) {
            (Some(held), _) => (held.device_time_ns, held.sync_count),
            (None, Some(last)) => (last.device_time_ns, last.sync_count),
            (None, None) => return self.observe_step(sample, out),
        };
        let Some(step_ns) = self.ahead_ns(earlier, (sample.device_time_ns, sample.sync_count)) else {
            self.end_trial(out);
            return self.observe_step(sample, out);
        };
        let step_ns = step_ns as f64;
        let same = |other: f64| (step_ns - other).abs() <= RATE_SAME * other;
        let odd = step_ns > 0.0
            && step_ns <= RATE_STEP_MAX_NS
            && (step_ns / period_ns(self.rate_hz) - 1.0).abs() > RATE_ODD
            && !explained;
        let begun = self.trial.held.len();
        let goes_on = odd && (begun < 2 || same(self.trial.step_ns));
        if !goes_on {
            self.end_trial(out);
            if !odd {
                return self.observe_step(sample, out);
            }
        } else if begun == 1 {
            self.trial.step_ns = step_ns;
        }
        self.trial.held.push(sample);
        let steps = self.trial.held.len() - 1;
        if steps >= RATE_STEPS_MIN && steps as f64 * self.trial.step_ns >= RATE_TRIAL_NS {
            return self.adopt_rate(out);
        }
        Observation::Taken
    }

    /// What was held are losses, not another rate: unless several steps were shorter than a period, which no loss makes.
    fn end_trial(&mut self, out: &mut Vec<Record>) {
        let short = self.trial.step_ns < (1.0 - RATE_ODD) * period_ns(self.rate_hz);
        if short && self.trial.held.len() > RATE_STEPS_SHORT {
            self.adopt_rate(out);
            return;
        }
        for sample in std::mem::take(&mut self.trial.held) {
            let frame = sample.frame;
            match self.observe_step(sample, out) {
                Observation::Duplicate => self.refused.push((frame, DiscardCause::Duplicate)),
                Observation::OutOfOrder => self.refused.push((frame, DiscardCause::OutOfOrder)),
                _ => {}
            }
        }
    }

    /// The steps are of one length: it is the period of another rate, from the first held sample on.
    fn adopt_rate(&mut self, out: &mut Vec<Record>) -> Observation {
        let held = std::mem::take(&mut self.trial.held);
        let old_period = period_ns(self.rate_hz);
        let measured_hz = 1e9 / self.trial.step_ns;
        let near_hz = IMU_RATE_HZ / (IMU_RATE_HZ / measured_hz).round().max(1.0);
        let to_hz = if (near_hz / measured_hz - 1.0).abs() < 0.01 { near_hz } else { measured_hz };
        let from_hz = std::mem::replace(&mut self.rate_hz, to_hz);
        self.open = None;
        for (index, sample) in held.into_iter().enumerate() {
            if let (0, Some(last)) = (index, self.last) {
                // Between the two rates: more than one period of the slower is a gap.
                let tick = (sample.device_time_ns, sample.sync_count);
                let step_ns = self.ahead_ns((last.device_time_ns, last.sync_count), tick).unwrap_or(0) as f64;
                let missing = (step_ns / old_period.max(period_ns(to_hz))).round() as u64;
                if missing > 1 {
                    let device_ns = last.device_time_ns.zip(sample.device_time_ns);
                    let gap = self.gap(&last, &sample, device_ns, missing - 1, false, GapCause::RateChange);
                    self.push_gap(gap, out);
                }
            }
            self.take(sample, out);
        }
        Observation::RateChanged { from_hz, to_hz }
    }

    fn observe_step(&mut self, sample: Sample, out: &mut Vec<Record>) -> Observation {
        let Some(last) = self.last else {
            self.take(sample, out);
            return Observation::Taken;
        };
        let period = period_ns(self.rate_hz);
        let host_ns = host_elapsed_ns(&last, sample.host_mono_ns, sample.host_utc_ns);
        let tick = (sample.device_time_ns, sample.sync_count);
        let Some(ahead_ns) = self.ahead_ns((last.device_time_ns, last.sync_count), tick) else {
            // The times before came from the host: only it can tell the distance.
            self.gap_by_host(&last, &sample, host_ns, GapCause::FormatChange, out);
            self.take(sample, out);
            return Observation::Taken;
        };
        let device_ns = last.device_time_ns.zip(sample.device_time_ns);
        if ahead_ns <= 0 {
            let back = ahead_ns.unsigned_abs();
            self.backward += 1;
            // A counter that stands while messages come was never switched on: their arrival has to do.
            if self.timebase == Timebase::SyncCounter && back == 0 && host_ns > 2.5 * period {
                self.timebase = Timebase::Arrival;
                self.open = None;
                self.arrival = Arrival::default();
                self.observe_arrival(sample, out);
                return Observation::Taken;
            }
            // A clock that stands back but runs on steadily was reset shortly after an earlier reset.
            if back <= REORDER_WINDOW_NS && (self.interrupted.is_none() || back == 0) && self.backward < 16 {
                return if back == 0 { Observation::Duplicate } else { Observation::OutOfOrder };
            }
            return self.new_epoch(&last, sample, host_ns, out);
        }
        let step_ns = ahead_ns as f64;
        // A clock that started again is behind; one that is ahead of the host's says that the host's stood or was stepped.
        if self.interrupted.is_some() && host_ns - step_ns > EPOCH_SLACK_NS + EPOCH_SHARE * host_ns {
            return self.new_epoch(&last, sample, host_ns, out);
        }
        // No clock runs ahead of the host's monotonic one by seconds: the sensor's was set.
        if is_one_boot(&last, &sample) {
            // What was read late may be followed at once by what came much later.
            let late_ns = self.late_ns + host_ns - step_ns;
            if late_ns < -(EPOCH_SLACK_NS + self.host_jitter_ns + EPOCH_SHARE * host_ns) {
                return self.new_epoch(&last, sample, host_ns, out);
            }
            self.late_ns = (late_ns - DRIFT * step_ns).max(0.0);
        }
        self.backward = 0;
        let steps = (step_ns / period).round() as u64;
        if steps == 0 {
            return Observation::Duplicate;
        }
        if steps > 1 {
            let gap = self.gap(&last, &sample, device_ns, steps - 1, true, self.cause());
            self.push_gap(gap, out);
        }
        self.take(sample, out);
        Observation::Taken
    }

    fn new_epoch(&mut self, last: &Position, sample: Sample, host_ns: f64, out: &mut Vec<Record>) -> Observation {
        self.backward = 0;
        self.late_ns = 0.0;
        self.open = None;
        self.epoch += 1;
        // The consequences of a reset are not its cause.
        if matches!(self.interrupted, Some(GapCause::FormatChange | GapCause::Silent | GapCause::Checksum)) {
            self.interrupted = Some(GapCause::SensorReset);
        }
        // Whatever a host's stepped clock says, the sensor has run at least as long as its own clock shows.
        let host_ns =
            if is_one_boot(last, &sample) { host_ns } else { host_ns.max(sample.device_time_ns.unwrap_or(0) as f64) };
        self.gap_by_host(last, &sample, host_ns, GapCause::SensorReset, out);
        self.take(sample, out);
        Observation::AfterReset
    }

    fn gap_by_host(&mut self, last: &Position, sample: &Sample, host_ns: f64, cause: GapCause, out: &mut Vec<Record>) {
        let missing = (host_ns / period_ns(self.rate_hz)).round() as u64;
        if missing > 1 {
            let cause = self.interrupted.or(self.host_trouble.map(|(cause, _)| cause)).unwrap_or(cause);
            let gap = self.gap(last, sample, None, missing - 1, false, cause);
            self.push_gap(gap, out);
        }
    }

    fn observe_arrival(&mut self, sample: Sample, out: &mut Vec<Record>) {
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
    fn release(&mut self, late_ns: f64, out: &mut Vec<Record>) {
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

    fn take(&mut self, sample: Sample, out: &mut Vec<Record>) {
        self.interrupted = None;
        self.suspicion = None;
        if self.open.as_ref().is_some_and(|segment| segment.channels != sample.channels()) {
            self.open = None;
        }
        if self.open.is_none() {
            self.segments += 1;
            let segment = Segment {
                number: self.segments,
                epoch: self.epoch,
                first_seq: self.received,
                rate_hz: self.rate_hz,
                timebase: self.timebase,
                channels: sample.channels(),
                first_device_time_ns: sample.device_time_ns,
                first_utc_ns: sample.host_utc_ns,
                // The recorder knows it.
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
        out.push(Record::Sample { seq: self.received, segment: self.segments, sample });
        self.received += 1;
    }
}

/// Whether the host's monotonic clock tells how far the two samples are apart.
fn is_one_boot(last: &Position, sample: &Sample) -> bool {
    last.host_mono_ns > 0 && sample.host_mono_ns >= last.host_mono_ns
}

/// Host time from the last sample to a later instant, ns: monotonic within one boot, civil across boots.
#[must_use]
pub fn host_elapsed_ns(last: &Position, mono_ns: u64, utc_ns: i64) -> f64 {
    if last.host_mono_ns > 0 && mono_ns >= last.host_mono_ns {
        (mono_ns - last.host_mono_ns) as f64
    } else {
        civil_elapsed_ns(last.host_utc_ns, utc_ns)
    }
}

/// Civil time before 2025 is that of a host whose clock nobody has set, UTC ns.
pub const UTC_UNSET_BEFORE_NS: i64 = 1_735_689_600_000_000_000;

/// Civil time from one instant to a later one, ns; 0 where it went back, or where the clock was set in between and nobody
/// knows how long it was: what the sensor's own clock shows is then all that counts.
fn civil_elapsed_ns(from_utc_ns: i64, to_utc_ns: i64) -> f64 {
    if from_utc_ns < UTC_UNSET_BEFORE_NS && to_utc_ns >= UTC_UNSET_BEFORE_NS {
        return 0.0;
    }
    to_utc_ns.saturating_sub(from_utc_ns).max(0) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Channel;
    use proptest::prelude::*;

    const PERIOD_NS: u64 = 25_000_000;

    fn sample(tick: u64, device: bool, delay_ns: u64) -> Sample {
        let host = 1_000_000_000 + tick * PERIOD_NS + delay_ns;
        let mut sample = Sample::at(host, 1_700_000_000_000_000_000 + host as i64);
        sample.device_time_ns = device.then_some(5_000_000_000 + tick * PERIOD_NS);
        sample.set(Channel::GyroX, tick as f64);
        sample
    }

    fn gaps(out: &[Record]) -> Vec<&Gap> {
        out.iter().filter_map(|record| if let Record::Gap(gap) = record { Some(gap) } else { None }).collect()
    }

    fn seqs(out: &[Record]) -> Vec<(u64, u32)> {
        out.iter()
            .filter_map(
                |record| if let Record::Sample { seq, segment, .. } = record { Some((*seq, *segment)) } else { None },
            )
            .collect()
    }

    #[test]
    fn a_clock_that_was_set_in_between_does_not_make_decades_of_absence() {
        assert_eq!(civil_elapsed_ns(1_000_000_000, 1_800_000_000_000_000_000), 0.0);
        assert_eq!(civil_elapsed_ns(1_000_000_000, 3_000_000_000), 2e9);
        assert_eq!(civil_elapsed_ns(3_000_000_000, 1_000_000_000), 0.0);
        assert_eq!(civil_elapsed_ns(1_800_000_000_000_000_000, 1_800_000_003_000_000_000), 3e9);
    }

    #[test]
    fn a_step_of_three_periods_is_two_missing_samples_and_a_new_segment() {
        let mut accountant = Accountant::new(40.0, Timebase::Device);
        let mut out = Vec::new();
        for tick in [0, 1, 4, 5] {
            assert_eq!(accountant.observe(sample(tick, true, 0), &mut out), Observation::Taken);
        }
        let gaps = gaps(&out);
        assert_eq!(gaps.len(), 1);
        assert_eq!((gaps[0].before_seq, gaps[0].missing, gaps[0].missing_exact), (2, 2, true));
        assert_eq!(seqs(&out), [(0, 1), (1, 1), (2, 2), (3, 2)]);
        assert_eq!((accountant.received(), accountant.missing()), (4, 2));
    }

    #[test]
    fn a_duplicate_is_dropped_and_a_clock_that_starts_again_is_a_reset() {
        let mut accountant = Accountant::new(40.0, Timebase::Device);
        let mut out = Vec::new();
        accountant.observe(sample(400, true, 0), &mut out);
        assert_eq!(accountant.observe(sample(400, true, 0), &mut out), Observation::Duplicate);
        assert_eq!(accountant.observe(sample(399, true, 0), &mut out), Observation::OutOfOrder);
        let mut after = sample(480, true, 0);
        after.device_time_ns = Some(1_000_000);
        assert_eq!(accountant.observe(after, &mut out), Observation::AfterReset);
        let gaps = gaps(&out);
        assert_eq!((gaps[0].missing, gaps[0].missing_exact, gaps[0].cause), (79, false, GapCause::SensorReset));
    }

    /// B11: 200 → 100 Hz, and back to a faster one.
    #[test]
    fn a_silent_change_of_rate_is_a_new_segment_and_no_loss() {
        for (from_hz, to_hz) in [(200.0, 100.0), (100.0, 200.0), (40.0, 10.0), (40.0, 400.0)] {
            let (mut accountant, mut out) = (Accountant::new(from_hz, Timebase::Device), Vec::new());
            let (mut at_ns, mut seen_after) = (5_000_000_000_u64, None);
            for index in 0..200 {
                at_ns += if index < 100 { period_ns(from_hz) } else { period_ns(to_hz) } as u64;
                let mut next = sample(0, true, 0);
                (next.device_time_ns, next.host_mono_ns) = (Some(at_ns), at_ns);
                if let Observation::RateChanged { from_hz: from, to_hz: to } = accountant.observe(next, &mut out) {
                    assert_eq!((from, to), (from_hz, to_hz));
                    seen_after = Some((index - 99) as f64 / to_hz);
                }
            }
            accountant.settle(&mut out);
            assert!(seen_after.unwrap() <= 2.0, "{seen_after:?}");
            assert_eq!((accountant.received(), accountant.missing()), (200, 0), "{from_hz} to {to_hz}");
            let rates: Vec<(u64, f64)> = out
                .iter()
                .filter_map(
                    |record| if let Record::Segment(new) = record { Some((new.first_seq, new.rate_hz)) } else { None },
                )
                .collect();
            assert_eq!(rates, [(0, from_hz), (100, to_hz)]);
        }
    }

    /// A tick that is wrong, by itself, before an interruption or after a trial that was none, is no rate.
    #[test]
    fn a_single_short_step_is_no_change_of_rate() {
        let (period, tenth) = (PERIOD_NS, PERIOD_NS / 10);
        let regular = |from: u64, count: u64| (0..count).map(move |index| from + index * period);
        let late = 1_000_000_000;
        let streams: [Vec<u64>; 3] = [
            // One measurement too many, a tenth of a period after another.
            regular(0, 50).chain([49 * period + tenth]).chain(regular(50 * period, 50)).collect(),
            // Every other one lost for a while, then one a tenth of a period after another.
            (0..20)
                .map(|index| index * period)
                .chain((0..6).map(|index| (21 + 2 * index) * period))
                .chain([31 * period + tenth])
                .chain(regular(32 * period, 68))
                .collect(),
            // The same, and then the cable is pulled.
            regular(0, 50).chain([49 * period + tenth]).chain(regular(50 * period + late, 50)).collect(),
        ];
        for (index, stream) in streams.into_iter().enumerate() {
            let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
            let count = stream.len() as u64;
            for at_ns in stream {
                if index == 2 && at_ns == 50 * period + late {
                    accountant.interrupt(GapCause::Unplugged, &mut out);
                }
                let mut next = sample(0, true, 0);
                (next.device_time_ns, next.host_mono_ns) = (Some(5_000_000_000 + at_ns), 1_000_000_000 + at_ns);
                accountant.observe(next, &mut out);
            }
            accountant.settle(&mut out);
            let rates =
                out.iter().filter(|record| matches!(record, Record::Segment(new) if new.rate_hz != 40.0)).count();
            assert_eq!((accountant.rate_hz(), rates), (40.0, 0), "stream {index}");
            assert_eq!((accountant.received(), accountant.take_refused().len()), (count - 1, 1), "stream {index}");
        }
    }

    #[test]
    fn losses_that_are_not_regular_are_no_change_of_rate() {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
        for tick in (0..100).chain((100..120).step_by(2)).chain(120..200) {
            accountant.observe(sample(tick, true, 0), &mut out);
        }
        assert_eq!((accountant.rate_hz(), accountant.missing()), (40.0, 10));
        assert!(gaps(&out).iter().all(|gap| gap.missing_exact && gap.cause == GapCause::Silent));
    }

    /// B10.
    #[test]
    fn a_counter_that_wraps_is_no_gap() {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
        let start = u64::MAX - 50 * PERIOD_NS;
        for tick in 0..100 {
            let mut next = sample(tick, true, 0);
            next.device_time_ns = Some(start.wrapping_add(tick * PERIOD_NS));
            assert_eq!(accountant.observe(next, &mut out), Observation::Taken);
        }
        assert_eq!((accountant.received(), accountant.missing(), gaps(&out).len()), (100, 0, 0));
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::SyncCounter), Vec::new());
        for tick in (0..70).chain(73..100) {
            let mut next = sample(tick, false, 0);
            next.sync_count = Some((u32::MAX - 50).wrapping_add(tick as u32));
            accountant.observe(next, &mut out);
        }
        accountant.settle(&mut out);
        assert_eq!((accountant.received(), accountant.missing(), gaps(&out).len()), (97, 3, 1));
        assert!(gaps(&out)[0].missing_exact);
    }

    #[test]
    fn a_clock_that_is_set_ahead_begins_a_new_epoch_and_nothing_is_missing() {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
        for tick in 0..100 {
            let mut next = sample(tick, true, 0);
            next.device_time_ns = next.device_time_ns.map(|ns| if tick < 50 { ns } else { ns + 3_600_000_000_000 });
            accountant.observe(next, &mut out);
        }
        accountant.settle(&mut out);
        assert_eq!((accountant.received(), accountant.missing(), accountant.epoch()), (100, 0, 2));
    }

    #[test]
    fn a_serial_count_that_stands_still_is_not_believed() {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::SyncCounter), Vec::new());
        for tick in 0..100 {
            let mut next = sample(tick, false, 0);
            next.sync_count = Some(7);
            accountant.observe(next, &mut out);
        }
        accountant.settle(&mut out);
        assert!(accountant.received() >= 97, "{}", accountant.received());
        let Some(Record::Segment(last)) = out.iter().rev().find(|record| matches!(record, Record::Segment(_))) else {
            panic!("no segment")
        };
        assert_eq!(last.timebase, Timebase::Arrival);
    }

    /// D1, D5: what the host did to itself, and what civil time does not change.
    #[test]
    fn a_host_that_slept_is_the_cause_and_a_stepped_clock_is_none() {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
        for tick in 0..100 {
            accountant.observe(sample(tick, true, 0), &mut out);
        }
        let hour = 144_000;
        accountant.blame_host(GapCause::HostSuspend, 1_000_000_000 + (100 + hour + 80) * PERIOD_NS);
        for (index, tick) in (100..110).chain(100 + hour..300 + hour).enumerate() {
            // The first ones had waited in the line's buffer.
            let mut next = sample(tick, true, 0);
            if index < 10 {
                next.host_mono_ns = sample(100 + hour, true, 0).host_mono_ns;
            }
            next.host_utc_ns -= 7_200_000_000_000;
            accountant.observe(next, &mut out);
        }
        let gaps = gaps(&out);
        assert_eq!(gaps.len(), 1);
        assert_eq!((gaps[0].cause, gaps[0].missing, gaps[0].missing_exact), (GapCause::HostSuspend, hour - 10, true));
        assert!(gaps[0].to_utc_ns >= gaps[0].from_utc_ns);
    }

    #[test]
    fn an_interruption_names_the_cause_and_the_device_clock_counts() {
        let mut accountant = Accountant::new(40.0, Timebase::Device);
        let mut out = Vec::new();
        accountant.observe(sample(0, true, 0), &mut out);
        accountant.interrupt(GapCause::Unplugged, &mut out);
        accountant.observe(sample(400, true, 0), &mut out);
        assert_eq!((gaps(&out)[0].missing, gaps(&out)[0].cause), (399, GapCause::Unplugged));
    }

    #[test]
    fn a_sensor_that_lost_power_while_unplugged_is_measured_by_the_host() {
        let mut accountant = Accountant::new(40.0, Timebase::Device);
        let mut out = Vec::new();
        accountant.observe(sample(0, true, 0), &mut out);
        accountant.interrupt(GapCause::Unplugged, &mut out);
        // An hour later the clock is only 10 s ahead of where it was: it began again.
        let mut back = sample(144_000, true, 0);
        back.device_time_ns = Some(15_000_000_000);
        assert_eq!(accountant.observe(back, &mut out), Observation::AfterReset);
        assert_eq!((gaps(&out)[0].missing, gaps(&out)[0].missing_exact), (143_999, false));
    }

    #[test]
    fn a_burst_that_catches_up_has_lost_nothing() {
        let mut accountant = Accountant::new(40.0, Timebase::Arrival);
        let mut out = Vec::new();
        for tick in 0..200 {
            // The host hears nothing between tick 100 and 140, then everything at once.
            let delay = if (100..140).contains(&tick) { (140 - tick) * PERIOD_NS } else { 0 };
            accountant.observe(sample(tick, false, delay), &mut out);
        }
        accountant.settle(&mut out);
        assert_eq!((accountant.received(), accountant.missing()), (200, 0));
        assert_eq!(seqs(&out).len(), 200);
    }

    #[test]
    fn without_device_time_a_lasting_delay_is_a_gap() {
        let mut accountant = Accountant::new(40.0, Timebase::Arrival);
        let mut out = Vec::new();
        for tick in (0..100).chain(152..200) {
            accountant.observe(sample(tick, false, tick % 3 * 2_000_000), &mut out);
        }
        accountant.settle(&mut out);
        assert_eq!(accountant.missing(), 52);
        assert_eq!((gaps(&out)[0].before_seq, gaps(&out)[0].missing_exact), (100, false));
        assert_eq!(seqs(&out)[100], (100, 2));
    }

    #[test]
    fn where_time_runs_faster_the_hosts_own_lateness_is_no_gap() {
        let mut accountant = Accountant::new(40.0, Timebase::Arrival).with_host_jitter(5e9);
        let mut out = Vec::new();
        for tick in 0..1000 {
            // For a while everything is read 2 s late, steadily.
            let delay = if (300..600).contains(&tick) { 2_000_000_000 } else { 0 };
            accountant.observe(sample(tick, false, delay), &mut out);
        }
        accountant.settle(&mut out);
        assert_eq!((accountant.received(), accountant.missing()), (1000, 0));
    }

    #[test]
    fn clocks_that_drift_apart_lose_nothing() {
        let mut accountant = Accountant::new(40.0, Timebase::Arrival);
        let mut out = Vec::new();
        for tick in 0..720_000_u64 {
            // 200 ppm: 3.6 s in five hours.
            accountant.observe(sample(tick, false, tick * PERIOD_NS / 5000), &mut out);
            out.clear();
        }
        assert_eq!(accountant.missing(), 0);
    }

    #[test]
    fn a_resumed_capture_goes_on_in_a_new_segment_with_the_gap_counted() {
        let mut out = Vec::new();
        let last = Position {
            device_time_ns: Some(5_000_000_000),
            sync_count: None,
            host_mono_ns: 0,
            host_utc_ns: 1_700_000_000_000_000_000,
        };
        let mut accountant =
            Accountant::resume(40.0, Timebase::Device, (3, 1, 1000, 7, 2), Some(last), GapCause::DaemonStopped);
        let mut next = sample(400, true, 0);
        next.host_utc_ns = last.host_utc_ns + 10_000_000_000;
        accountant.observe(next, &mut out);
        assert_eq!((accountant.received(), accountant.missing(), accountant.gaps()), (1001, 7 + 399, 3));
        assert_eq!(gaps(&out)[0].cause, GapCause::DaemonStopped);
        assert_eq!(seqs(&out), [(1000, 4)]);
    }

    proptest! {
        #[test]
        fn received_and_missing_add_up_for_any_losses(lost in proptest::collection::vec(any::<bool>(), 1..400), jitter in 0_u64..10_000_000) {
            let mut accountant = Accountant::new(40.0, Timebase::Device);
            let mut out = Vec::new();
            let kept: Vec<u64> = (0..lost.len() as u64).filter(|tick| !lost[*tick as usize]).collect();
            for tick in &kept {
                let mut sample = sample(*tick, true, 0);
                sample.device_time_ns = sample.device_time_ns.map(|time| time + tick * 7919 % (jitter + 1));
                accountant.observe(sample, &mut out);
            }
            accountant.settle(&mut out);
            if let (Some(first), Some(last)) = (kept.first(), kept.last()) {
                prop_assert_eq!(accountant.received(), kept.len() as u64);
                prop_assert_eq!(accountant.received() + accountant.missing(), last - first + 1);
                prop_assert_eq!(gaps(&out).iter().map(|gap| gap.missing).sum::<u64>(), accountant.missing());
                let numbers: Vec<u64> = seqs(&out).iter().map(|(seq, _)| *seq).collect();
                prop_assert_eq!(numbers, (0..kept.len() as u64).collect::<Vec<_>>());
            }
        }

        #[test]
        fn arrival_times_with_latency_below_a_period_find_every_longer_silence(silences in proptest::collection::vec((20_u64..60, 3_u64..200), 1..8), latency in 0_u64..12_000_000) {
            let mut accountant = Accountant::new(40.0, Timebase::Arrival);
            let mut out = Vec::new();
            let (mut tick, mut sent) = (0, 0_u64);
            for (run, silence) in &silences {
                for _ in 0..*run {
                    accountant.observe(sample(tick, false, tick * 7919 % (latency + 1)), &mut out);
                    tick += 1;
                    sent += 1;
                }
                tick += silence;
            }
            for _ in 0..20 {
                accountant.observe(sample(tick, false, 0), &mut out);
                tick += 1;
                sent += 1;
            }
            accountant.settle(&mut out);
            prop_assert_eq!(accountant.received(), sent);
            prop_assert_eq!(accountant.missing(), tick - sent);
        }
    }
}
