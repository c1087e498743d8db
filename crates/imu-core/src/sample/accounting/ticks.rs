//! Ticks: detects gaps, other rates and resets from the steps of samples that carry the sensor's own time or count.
//! Pure.

use super::arrival::Arrival;
use super::{
    Accountant, DRIFT, Observation, Position, RATE_STEPS_MIN, REORDER_WINDOW_NS, host_elapsed_ns, is_one_boot,
};
use crate::sample::{DiscardCause, GapCause, Record, Sample, Timebase};
use crate::units::{IMU_RATE_HZ, period_ns};

/// Steps of the sensor's ticks that differ from the period by more than this share belong to another rate or to losses;
/// steps within [`RATE_SAME`] have one length.
const RATE_DIFFERS: f64 = 0.19;
const RATE_SAME: f64 = 0.01;
/// The steps of another rate ([`RATE_STEPS_MIN`] of them) take at least this long, ns. At 100 Hz the decision takes
/// 0.12 s, at 20 Hz 0.6 s.
const RATE_TRIAL_NS: f64 = 1e8;
/// No loss makes a step that is not a whole number of periods. This many such steps of one length in succession are
/// another rate even if the stream was interrupted before the trial lasted long; one or two may be a wrong tick.
const RATE_STEPS_UNEVEN: usize = 3;
/// A longer step is not a rate, ns: register 7's lowest is 1 Hz.
const RATE_STEP_MAX_NS: f64 = 1.5e9;
/// After an interruption, device and host must agree on its length within this share and this time, ns. If less passed for the
/// device, the sensor lost power in between and its clock started again; if more, its clock was set.
const EPOCH_SHARE: f64 = 1e-3;
const EPOCH_BEHIND_NS: f64 = 1e9;
const EPOCH_AHEAD_NS: f64 = 2e9;

/// After this time without a sample earlier than the quickest one before, the earliest possible arrival is known, ns.
const LINE_NS: f64 = 1e9;
/// Jitter does not explain a sample that comes earlier by more than this, ns.
const EARLY_NS: f64 = 1e7;
/// An interruption may change the latency, but not by more than this, ns.
const EARLY_INTERRUPTED_NS: f64 = 2.5e8;

/// Samples after a reset that have not come earlier than all before them for this long show how late the first one was
/// read, ns of the host's clock. A reader that catches up pauses for 20 ms between two reads.
const CAUGHT_UP_NS: f64 = 5e7;
/// A sample has come earlier if it is earlier by more than this, ns.
const EARLIER_NS: f64 = 5e6;
/// Among samples after a reset, one whose clock is behind by more periods than this follows another reset.
const REORDERED_PERIODS: f64 = 4.0;
/// The longest time for which samples after a reset are held, ns of the host's clock, and the maximum number. A count that advances
/// faster than before the reset never seems to catch up.
const RERUN_NS: f64 = 3e9;
const RERUN_MAX: usize = 16_384;

/// A way to take a sample.
pub(super) type Observe = fn(&mut Accountant, Sample, &mut Vec<Record>) -> Observation;

/// Samples in succession that do not come at the rate.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Trial {
    pub(super) held: Vec<Sample>,
    /// The step between the first two samples, ns of the sensor's clock.
    pub(super) step_ns: f64,
    /// The host's trouble when the first sample arrived.
    host_trouble: Option<GapCause>,
}

/// How late all samples of the last second or two were: a line whose latency has grown for good delays every one of them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Lag {
    /// The least lateness in the last whole window and in the present one, ns.
    least_ns: [f64; 2],
    /// How much of the present window has passed for both clocks, ns.
    passed_ns: f64,
}

impl Lag {
    /// The length of a window, ns.
    const WINDOW_NS: f64 = 1e9;

    fn ns(self) -> f64 {
        self.least_ns[0].min(self.least_ns[1])
    }

    /// Notes how late a sample was, after this time has passed for both clocks: samples that are read at once show nothing.
    fn note(&mut self, late_ns: f64, passed_ns: f64) {
        self.least_ns[1] = self.least_ns[1].min(late_ns);
        self.passed_ns += passed_ns;
        if self.passed_ns > Self::WINDOW_NS {
            *self = Self { least_ns: [self.least_ns[1], late_ns], passed_ns: 0.0 };
        }
    }
}

/// What happened to the sensor's clock before the samples that are held.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
enum Happened {
    /// It went back.
    #[default]
    Reset,
    /// It was set ahead of the host's by this much, ns; samples missing before have this cause.
    Ahead(u64, GapCause),
    /// It advanced, but may have been reset: how late the samples were read decides.
    Undecided,
}

/// The first samples of another run of the sensor's clock, which show how late the first one was read. The clock may start
/// again among them.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Rerun {
    pub(super) held: Vec<Sample>,
    happened: Happened,
    /// The host's trouble when the first sample arrived, and what was suspicious before it.
    before: (Option<(GapCause, u64)>, Option<GapCause>),
    /// Whether the last of them show no more lateness, and whether they were held for as long as they may be without that.
    caught_up: bool,
    is_long: bool,
    /// How far the sensor's clock has advanced since the first sample, ns.
    advance_ns: f64,
    /// How late the first sample was read, as far as the held samples show, ns, and the monotonic time of the one that
    /// shows it.
    late_ns: f64,
    shown_mono_ns: u64,
}

impl Accountant {
    /// Returns how far the sensor's tick of the later instant is ahead of the earlier one's, ns. A tick is the sensor's
    /// clock in ns or its count of messages. They wrap at 2^64 and 2^32: a difference below half of that is ahead.
    pub(super) fn ahead_ns(
        &self,
        earlier: (Option<u64>, Option<u32>),
        later: (Option<u64>, Option<u32>),
    ) -> Option<i64> {
        if self.timebase == Timebase::SyncCounter {
            let count = later.1?.wrapping_sub(earlier.1?) as i32;
            return Some((f64::from(count) * period_ns(self.rate_hz)) as i64);
        }
        Some(later.0?.wrapping_sub(earlier.0?) as i64)
    }

    /// Handles samples with the sensor's ticks: a step that is not one period is the first of another rate, or a gap.
    /// The samples are held until the following steps decide.
    pub(super) fn observe_ticks(&mut self, sample: Sample, out: &mut Vec<Record>) -> Observation {
        let explained = self.trial.held.is_empty() && (self.interrupted.is_some() || self.suspicion.is_some());
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
        let differs = step_ns > 0.0
            && step_ns <= RATE_STEP_MAX_NS
            && (step_ns / period_ns(self.rate_hz) - 1.0).abs() > RATE_DIFFERS
            && !explained;
        let begun = self.trial.held.len();
        // The first sample after a gap may be the first of another rate.
        let is_gap = begun == 0 && step_ns > 1.5 * period_ns(self.rate_hz) && !differs;
        let goes_on = is_gap || (differs && (begun < 2 || same(self.trial.step_ns)));
        if !goes_on && begun > 0 {
            self.end_trial(out);
            // A sample must not overtake those that are held after a reset.
            let is_behind_others = !self.rerun.held.is_empty();
            return if is_behind_others { self.observe_step(sample, out) } else { self.observe_ticks(sample, out) };
        }
        if !goes_on {
            return self.observe_step(sample, out);
        }
        if begun == 1 {
            self.trial.step_ns = step_ns;
        }
        if self.trial.held.is_empty() {
            self.trial.host_trouble = self.host_trouble.map(|(cause, _)| cause);
        }
        self.trial.held.push(sample);
        let steps = self.trial.held.len() - 1;
        if steps >= RATE_STEPS_MIN && steps as f64 * self.trial.step_ns >= RATE_TRIAL_NS {
            return self.adopt_rate(out);
        }
        Observation::Taken
    }

    /// Treats the held samples as losses, not as another rate, unless several steps were not a whole number of periods
    /// (shorter than one, or two and a half), which no loss makes.
    pub(super) fn end_trial(&mut self, out: &mut Vec<Record>) {
        let periods = self.trial.step_ns / period_ns(self.rate_hz);
        let uneven = (periods - periods.round().max(1.0)).abs() > RATE_DIFFERS;
        if uneven && self.trial.held.len() > RATE_STEPS_UNEVEN {
            self.adopt_rate(out);
            return;
        }
        let Trial { held, host_trouble, .. } = std::mem::take(&mut self.trial);
        self.observe_held(held, host_trouble, out);
    }

    /// Takes samples that were held while the host was in this trouble, whose time may be over.
    pub(super) fn observe_held(&mut self, held: Vec<Sample>, host_trouble: Option<GapCause>, out: &mut Vec<Record>) {
        let now = self.host_trouble;
        self.host_trouble = host_trouble.map(|cause| (cause, u64::MAX)).or(now);
        for sample in held {
            let frame = sample.frame;
            if self.timebase == Timebase::Arrival {
                self.observe_arrival(sample, out);
                continue;
            }
            let observation = self.observe_step(sample, out);
            self.note_held(frame, observation);
        }
        self.host_trouble = now;
    }

    /// Keeps the observation at a sample that was held, for the caller.
    fn note_held(&mut self, frame: u64, observation: Observation) {
        match observation {
            Observation::Duplicate => self.refused.push((frame, DiscardCause::Duplicate)),
            Observation::OutOfOrder => self.refused.push((frame, DiscardCause::OutOfOrder)),
            Observation::Taken => {}
            observation => self.held_observations.push_back(observation),
        }
    }

    /// Adopts another rate: the steps have one length, which is its period, from the first held sample on.
    pub(super) fn adopt_rate(&mut self, out: &mut Vec<Record>) -> Observation {
        let host_trouble = self.trial.host_trouble;
        let held = std::mem::take(&mut self.trial.held);
        let measured_hz = 1e9 / self.trial.step_ns;
        let near_hz = IMU_RATE_HZ / (IMU_RATE_HZ / measured_hz).round().max(1.0);
        let to_hz = if (near_hz / measured_hz - 1.0).abs() < 0.01 { near_hz } else { measured_hz };
        let from_hz = std::mem::replace(&mut self.rate_hz, to_hz);
        self.open = None;
        // If another rate was announced and never came, steps of one period show what is missing from the last sample on.
        if to_hz != self.last_rate_hz {
            self.suspect(GapCause::RateChange);
        }
        self.observe_held(held, host_trouble, out);
        Observation::RateChanged { from_hz, to_hz }
    }

    pub(super) fn observe_step(&mut self, sample: Sample, out: &mut Vec<Record>) -> Observation {
        if !self.rerun.held.is_empty() {
            return self.observe_rerun(sample, Self::observe_step, out);
        }
        let Some(last) = self.last else {
            self.take(sample, out);
            return Observation::Taken;
        };
        let period = period_ns(self.rate_hz);
        let host_ns = host_elapsed_ns(&last, sample.host_mono_ns, sample.host_utc_ns);
        let tick = (sample.device_time_ns, sample.sync_count);
        let Some(ahead_ns) = self.ahead_ns((last.device_time_ns, last.sync_count), tick) else {
            // The times before came from the host, so that only the host can determine the distance.
            self.gap_by_host(&last, &sample, host_ns, GapCause::FormatChange, out);
            self.take(sample, out);
            return Observation::Taken;
        };
        if ahead_ns <= 0 {
            let back = ahead_ns.unsigned_abs();
            self.backward += 1;
            // A counter that does not advance while messages arrive was never switched on: their arrival is used
            // instead.
            if self.timebase == Timebase::SyncCounter && back == 0 && host_ns > 2.5 * period {
                self.timebase = Timebase::Arrival;
                self.open = None;
                self.arrival = Arrival::default();
                self.observe_arrival(sample, out);
                return Observation::Taken;
            }
            // A clock that went back but runs on steadily was reset shortly after an earlier reset.
            if back <= REORDER_WINDOW_NS && (self.interrupted.is_none() || back == 0) && self.backward < 16 {
                return if back == 0 { Observation::Duplicate } else { Observation::OutOfOrder };
            }
            return self.hold_rerun(sample, Happened::Reset);
        }
        let step_ns = ahead_ns as f64;
        // A restarted clock is behind the host's. If the sensor's clock is ahead, the host's clock stood still or was
        // stepped.
        // Only an interruption shows that the last sample's lateness is over: a line may keep it.
        let late_ns = if self.interrupted.is_some() { self.late_before(&last, &sample) } else { 0.0 };
        let is_away = self.interrupted.is_some() || step_ns > 1.5 * period;
        if is_away && self.is_behind(host_ns + late_ns, step_ns) {
            return self.hold_rerun(sample, Happened::Undecided);
        }
        self.observe_ahead(sample, last, step_ns, out)
    }

    /// Returns how much later than those before it the last sample before this one was read, ns; 0 if that is of no importance now.
    fn late_before(&self, last: &Position, sample: &Sample) -> f64 {
        if is_one_boot(last, sample) { (self.late_ns - self.lag.ns()).max(0.0) } else { 0.0 }
    }

    /// Takes a sample of the same run of the sensor's clock, or the first one after it was set ahead.
    fn observe_ahead(&mut self, sample: Sample, last: Position, step_ns: f64, out: &mut Vec<Record>) -> Observation {
        let period = period_ns(self.rate_hz);
        let host_ns = host_elapsed_ns(&last, sample.host_mono_ns, sample.host_utc_ns);
        let device_ns = last.device_time_ns.zip(sample.device_time_ns);
        // No sample comes before its time. If the host's monotonic clock has not advanced as far, the sensor's clock
        // was set.
        let mut is_early = false;
        if is_one_boot(&last, &sample) {
            // A sample that was read late may be followed at once by a much later one.
            let late_ns = self.late_ns + host_ns - step_ns;
            let early_ns = -late_ns - self.host_jitter_ns;
            let is_known = self.on_line_ns >= LINE_NS;
            let known_ns = if is_known && self.interrupted.is_none() {
                (0.5 * (step_ns - period)).max(EARLY_NS)
            } else {
                EPOCH_AHEAD_NS + EPOCH_SHARE * host_ns
            };
            if step_ns > 1.5 * period && early_ns > known_ns {
                return self.hold_rerun(sample, Happened::Ahead(-late_ns as u64, self.cause()));
            }
            // The clock may have been set ahead by less than is certain.
            let least_ns = if self.interrupted.is_none() { EARLY_NS } else { EARLY_INTERRUPTED_NS };
            is_early = is_known && early_ns > least_ns;
            self.on_line_ns = if early_ns > EARLY_NS { 0.0 } else { self.on_line_ns + step_ns };
            self.late_ns = (late_ns - DRIFT * step_ns).max(0.0);
            self.lag.note(self.late_ns, step_ns.min(host_ns));
            self.note_lateness(self.late_ns, step_ns);
        }
        self.backward = 0;
        // Between two rates, more than one period of the slower rate is a gap, and a gap has the rate of the samples before it. A
        // count of messages counts those that are missing, whatever their rate.
        let changes = self.timebase == Timebase::Device && self.rate_changes();
        let before = period_ns(self.last_rate_hz);
        let periods = step_ns / if changes { period.max(before) } else { period };
        let steps = periods.round() as u64;
        if steps == 0 && !changes {
            return Observation::Duplicate;
        }
        if steps > 1 {
            let missing = if changes { (step_ns / before).round() as u64 } else { steps } - 1;
            let exact = !changes && !is_early && !self.undecided;
            let gap = self.gap(&last, &sample, device_ns, missing, exact, self.cause());
            self.push_gap(gap, out);
        } else if (periods - 1.0).abs() > RATE_DIFFERS {
            // No sample is missing, but the samples of one segment are a period apart.
            self.open = None;
        }
        self.take(sample, out);
        Observation::Taken
    }

    /// Returns whether the next sample has another rate than the last one.
    pub(super) fn rate_changes(&self) -> bool {
        (self.rate_hz / self.last_rate_hz - 1.0).abs() > RATE_SAME
    }

    /// Holds the first sample of another run of the sensor's clock.
    fn hold_rerun(&mut self, sample: Sample, happened: Happened) -> Observation {
        self.rerun = Rerun {
            happened,
            before: (self.host_trouble, self.suspicion.take()),
            shown_mono_ns: sample.host_mono_ns,
            held: vec![sample],
            ..Rerun::default()
        };
        Observation::Taken
    }

    /// Returns how far the sensor's clock advanced from one sample to the next, ns: 0 if it started again in between, and `None` if
    /// that is undecided.
    fn advance_ns(&self, before: &Sample, sample: &Sample) -> Option<f64> {
        let ticks = |sample: &Sample| (sample.device_time_ns, sample.sync_count);
        let step_ns = self.ahead_ns(ticks(before), ticks(sample))?;
        let reordered_ns = (REORDERED_PERIODS * period_ns(self.rate_hz)).min(REORDER_WINDOW_NS as f64);
        (step_ns > 0 || step_ns.unsigned_abs() as f64 > reordered_ns).then_some(step_ns.max(0) as f64)
    }

    /// Handles samples after a reset. As long as each of them is earlier than those before, they were read late. `observe` takes
    /// them then: samples that were held for another reason are not held again.
    pub(super) fn observe_rerun(&mut self, sample: Sample, observe: Observe, out: &mut Vec<Record>) -> Observation {
        let advance_ns = self.rerun.held.last().and_then(|before| self.advance_ns(before, &sample));
        let first_mono_ns = self.rerun.held.first().map_or(0, |first| first.host_mono_ns);
        let Rerun { held, advance_ns: so_far_ns, late_ns, shown_mono_ns, caught_up, is_long, .. } = &mut self.rerun;
        if let (Some(advance_ns), true) = (advance_ns, held.len() < RERUN_MAX) {
            *so_far_ns += advance_ns;
            let shown_ns = *so_far_ns - sample.host_mono_ns.saturating_sub(first_mono_ns) as f64;
            if shown_ns > *late_ns + EARLIER_NS.max(self.host_jitter_ns) {
                (*late_ns, *shown_mono_ns) = (shown_ns, sample.host_mono_ns);
            }
            let since_ns = sample.host_mono_ns.saturating_sub(*shown_mono_ns) as f64;
            let passed_ns = sample.host_mono_ns.saturating_sub(first_mono_ns) as f64;
            *caught_up = since_ns >= CAUGHT_UP_NS.max(2.0 * self.host_jitter_ns);
            *is_long = !*caught_up && passed_ns >= RERUN_NS.max(32.0 * self.host_jitter_ns);
            if !*caught_up && !*is_long {
                held.push(sample);
                return Observation::Taken;
            }
        }
        self.end_rerun(observe, out);
        observe(self, sample, out)
    }

    /// Takes the samples after a reset that were held.
    pub(super) fn end_rerun(&mut self, observe: Observe, out: &mut Vec<Record>) {
        let Rerun { held, mut happened, mut before, caught_up, is_long, .. } = std::mem::take(&mut self.rerun);
        // Counts that do not catch up have another rate than before the reset, and show no lateness.
        let is_unknown = is_long && self.timebase == Timebase::SyncCounter;
        // How late each sample was read: each later one shows that it was at least as late.
        let mut late_ns = vec![0.0_f64; held.len()];
        let mut begins = vec![true; held.len()];
        for index in (1..held.len()).rev() {
            let (before, sample) = (&held[index - 1], &held[index]);
            let advance_ns = self.advance_ns(before, sample).unwrap_or(0.0);
            begins[index] = advance_ns == 0.0;
            let passed_ns = sample.host_mono_ns.saturating_sub(before.host_mono_ns) as f64;
            late_ns[index - 1] = if is_unknown { 0.0 } else { (late_ns[index] + advance_ns - passed_ns).max(0.0) };
        }
        for (sample, (late_ns, begins)) in held.into_iter().zip(late_ns.into_iter().zip(begins)) {
            if begins {
                // Samples of the run before must not be overtaken.
                self.settle(out);
                let happened = std::mem::take(&mut happened);
                self.begin_rerun(sample, (late_ns, caught_up), happened, before, out);
                before.1 = None;
                continue;
            }
            let frame = sample.frame;
            let observation = observe(self, sample, out);
            self.note_held(frame, observation);
        }
    }

    /// Takes the first sample of another run of the sensor's clock, which was read this late, at least; `caught_up` if no later.
    /// `before` it there was this trouble and suspicion.
    fn begin_rerun(
        &mut self,
        first: Sample,
        (late_ns, caught_up): (f64, bool),
        happened: Happened,
        before: (Option<(GapCause, u64)>, Option<GapCause>),
        out: &mut Vec<Record>,
    ) {
        let Some(last) = self.last else { return self.take(first, out) };
        let host_ns = host_elapsed_ns(&last, first.host_mono_ns, first.host_utc_ns);
        // The last sample before may have been read late as well.
        let before_ns = self.late_before(&last, &first);
        let away_ns = if is_one_boot(&last, &first) { (host_ns + before_ns - late_ns).max(0.0) } else { host_ns };
        let tick = (first.device_time_ns, first.sync_count);
        let step_ns = self.ahead_ns((last.device_time_ns, last.sync_count), tick).unwrap_or(0) as f64;
        let later = (self.host_trouble, self.suspicion);
        (self.host_trouble, self.suspicion) = before;
        // Samples that have not caught up do not show the lateness before them to be over.
        let least_ns = if caught_up { away_ns } else { host_ns - late_ns };
        if happened == Happened::Undecided && !self.is_behind(least_ns, step_ns) {
            let frame = first.frame;
            let undecided = std::mem::replace(&mut self.undecided, !caught_up);
            let observation = self.observe_ahead(first, last, step_ns, out);
            self.undecided = undecided;
            self.note_held(frame, observation);
        } else {
            let cause = if let Happened::Ahead(_, cause) = happened { cause } else { GapCause::SensorReset };
            let observation = self.new_epoch(&last, first, (away_ns, cause), out);
            self.late_ns = late_ns;
            self.held_observations.push_back(match happened {
                Happened::Ahead(ahead_ns, _) => Observation::ClockAhead(ahead_ns + late_ns as u64),
                Happened::Reset | Happened::Undecided => observation,
            });
        }
        (self.host_trouble, self.suspicion) = later;
    }

    /// Takes the first sample of another run of the sensor's clock. `host_ns` is the time since the last one by the host's clock,
    /// and the cause that of samples missing in between without another reason.
    fn new_epoch(
        &mut self,
        last: &Position,
        sample: Sample,
        (host_ns, cause): (f64, GapCause),
        out: &mut Vec<Record>,
    ) -> Observation {
        self.backward = 0;
        (self.late_ns, self.on_line_ns, self.lag) = (0.0, 0.0, Lag::default());
        self.open = None;
        self.epoch += 1;
        // The consequences of a reset are not its cause.
        if cause == GapCause::SensorReset
            && matches!(self.interrupted, Some(GapCause::FormatChange | GapCause::Silent | GapCause::Checksum))
        {
            self.interrupted = Some(GapCause::SensorReset);
        }
        // Whatever the host's stepped clock shows, the sensor has run at least as long as its own clock shows.
        let host_ns =
            if is_one_boot(last, &sample) { host_ns } else { host_ns.max(sample.device_time_ns.unwrap_or(0) as f64) };
        self.gap_by_host(last, &sample, host_ns, cause, out);
        self.take(sample, out);
        Observation::AfterReset
    }

    /// Returns whether the sensor's clock advanced by so much less than the host's that it started again in between.
    fn is_behind(&self, host_ns: f64, step_ns: f64) -> bool {
        host_ns - step_ns > EPOCH_BEHIND_NS.max(2.0 * self.host_jitter_ns) + EPOCH_SHARE * host_ns
    }
}
