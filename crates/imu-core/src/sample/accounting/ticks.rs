//! Ticks: detects gaps, other rates and resets from the steps of samples that carry the sensor's own time or count.
//! Pure.

use super::arrival::Arrival;
use super::{Accountant, DRIFT, Observation, Position, REORDER_WINDOW_NS, host_elapsed_ns, is_one_boot};
use crate::sample::{DiscardCause, GapCause, Record, Sample, Timebase};
use crate::units::{IMU_RATE_HZ, period_ns};

/// Steps of the sensor's ticks that differ from the period by more than this share belong to another rate or to losses;
/// steps within [`RATE_SAME`] have one length.
const RATE_DIFFERS: f64 = 0.19;
const RATE_SAME: f64 = 0.01;
/// This many steps of one length in succession, over this many ns, are another rate: no loss removes every other sample
/// so regularly. At 100 Hz the decision takes 0.12 s, at 20 Hz 0.6 s.
const RATE_STEPS_MIN: usize = 12;
const RATE_TRIAL_NS: f64 = 1e8;
/// No loss makes a step that is not a whole number of periods. This many such steps of one length in succession are
/// another rate even if the stream was interrupted before the trial lasted long; one or two may be a wrong tick.
const RATE_STEPS_UNEVEN: usize = 3;
/// A longer step is not a rate, ns: register 7's lowest is 1 Hz.
const RATE_STEP_MAX_NS: f64 = 1.5e9;
/// After an interruption, device and host must agree on its length within this share (and [`EPOCH_SLACK_NS`]);
/// otherwise the sensor lost power in between and its clock started again.
const EPOCH_SHARE: f64 = 1e-3;
const EPOCH_SLACK_NS: f64 = 2e9;

/// After this time without a sample earlier than the quickest one before, the earliest possible arrival is known, ns.
const LINE_NS: f64 = 1e9;
/// Jitter does not explain a sample that comes earlier by more than this, ns.
const EARLY_NS: f64 = 1e7;

/// Samples that follow within this share of the time between them were read late.
const AT_ONCE: f64 = 0.5;
/// The maximum number of samples after a reset that are held.
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
        let explained = self.interrupted.is_some() || self.suspicion.is_some();
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
        let goes_on = differs && (begun < 2 || same(self.trial.step_ns));
        if !goes_on {
            self.end_trial(out);
            if !differs {
                return self.observe_step(sample, out);
            }
        } else if begun == 1 {
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
            match self.observe_step(sample, out) {
                Observation::Duplicate => self.refused.push((frame, DiscardCause::Duplicate)),
                Observation::OutOfOrder => self.refused.push((frame, DiscardCause::OutOfOrder)),
                Observation::Taken => {}
                observation => self.held_observation = Some(observation),
            }
        }
        // Samples that follow must not overtake them.
        self.end_rerun(Self::observe_step, out);
        self.host_trouble = now;
    }

    /// Adopts another rate: the steps have one length, which is its period, from the first held sample on.
    pub(super) fn adopt_rate(&mut self, out: &mut Vec<Record>) -> Observation {
        let host_trouble = self.trial.host_trouble;
        let held = std::mem::take(&mut self.trial.held);
        let old_period = period_ns(self.rate_hz);
        let measured_hz = 1e9 / self.trial.step_ns;
        let near_hz = IMU_RATE_HZ / (IMU_RATE_HZ / measured_hz).round().max(1.0);
        let to_hz = if (near_hz / measured_hz - 1.0).abs() < 0.01 { near_hz } else { measured_hz };
        let from_hz = std::mem::replace(&mut self.rate_hz, to_hz);
        self.open = None;
        if to_hz == self.last_rate_hz {
            // Another rate was announced and never came: steps of one period, from the last sample on, show the missing
            // samples.
            self.observe_held(held, host_trouble, out);
            return Observation::RateChanged { from_hz, to_hz };
        }
        for (index, sample) in held.into_iter().enumerate() {
            if let (0, Some(last)) = (index, self.last) {
                // Between the two rates, more than one period of the slower rate is a gap.
                let tick = (sample.device_time_ns, sample.sync_count);
                let step_ns = self.ahead_ns((last.device_time_ns, last.sync_count), tick).unwrap_or(0) as f64;
                if (step_ns / old_period.max(period_ns(to_hz))).round() > 1.0 {
                    let device_ns = last.device_time_ns.zip(sample.device_time_ns);
                    // A gap has the rate of the samples before it.
                    let missing = (step_ns / old_period).round() as u64 - 1;
                    let cause = host_trouble.unwrap_or(GapCause::RateChange);
                    let gap = self.gap(&last, &sample, device_ns, missing, false, cause);
                    self.push_gap(gap, out);
                }
            }
            self.take(sample, out);
        }
        Observation::RateChanged { from_hz, to_hz }
    }

    pub(super) fn observe_step(&mut self, sample: Sample, out: &mut Vec<Record>) -> Observation {
        if !self.rerun.is_empty() {
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
        let device_ns = last.device_time_ns.zip(sample.device_time_ns);
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
            // The reset explains what was suspicious before it.
            self.suspicion = None;
            self.rerun_trouble = self.host_trouble;
            self.rerun.push(sample);
            return Observation::Taken;
        }
        let step_ns = ahead_ns as f64;
        // A restarted clock is behind the host's. If the sensor's clock is ahead, the host's clock stood still or was
        // stepped.
        if self.interrupted.is_some() && host_ns - step_ns > EPOCH_SLACK_NS + EPOCH_SHARE * host_ns {
            return self.new_epoch(&last, sample, (host_ns, GapCause::SensorReset), out);
        }
        // No sample comes before its time. If the host's monotonic clock has not advanced as far, the sensor's clock
        // was set.
        if is_one_boot(&last, &sample) {
            // A sample that was read late may be followed at once by a much later one.
            let late_ns = self.late_ns + host_ns - step_ns;
            let early_ns = -late_ns - self.host_jitter_ns;
            let undisturbed = self.interrupted.is_none() && self.host_trouble.is_none();
            let known_ns = if undisturbed && self.on_line_ns >= LINE_NS {
                (0.5 * (step_ns - period)).max(EARLY_NS)
            } else {
                EPOCH_SLACK_NS + EPOCH_SHARE * host_ns
            };
            if step_ns > 1.5 * period && early_ns > known_ns {
                self.new_epoch(&last, sample, (host_ns, self.cause()), out);
                return Observation::ClockAhead(-late_ns as u64);
            }
            self.on_line_ns = if early_ns > EARLY_NS { 0.0 } else { self.on_line_ns + step_ns };
            self.late_ns = (late_ns - DRIFT * step_ns).max(0.0);
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
            let gap = self.gap(&last, &sample, device_ns, missing, !changes, self.cause());
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

    /// Handles samples after a reset. As long as they come at once, they were read late. `observe` takes them then: samples that
    /// were held for another reason are not held again.
    pub(super) fn observe_rerun(&mut self, sample: Sample, observe: Observe, out: &mut Vec<Record>) -> Observation {
        let before = self.rerun.last();
        let step_ns = before.and_then(|before| {
            self.ahead_ns((before.device_time_ns, before.sync_count), (sample.device_time_ns, sample.sync_count))
        });
        let passed_ns = before.map_or(0, |before| sample.host_mono_ns.saturating_sub(before.host_mono_ns)) as f64;
        let at_once = step_ns.is_some_and(|step_ns| step_ns > 0 && passed_ns < AT_ONCE * step_ns as f64);
        if at_once && self.interrupted.is_none() && self.rerun.len() < RERUN_MAX {
            self.rerun.push(sample);
            return Observation::Taken;
        }
        self.end_rerun(observe, out);
        observe(self, sample, out)
    }

    /// Takes the samples after a reset that were held.
    pub(super) fn end_rerun(&mut self, observe: Observe, out: &mut Vec<Record>) {
        let rerun = std::mem::take(&mut self.rerun);
        let ticks = |sample: &Sample| (sample.device_time_ns, sample.sync_count);
        let late_ns = rerun.first().zip(rerun.last()).map_or(0.0, |(first, end)| {
            let passed_ns = end.host_mono_ns.saturating_sub(first.host_mono_ns) as f64;
            self.ahead_ns(ticks(first), ticks(end)).map_or(0.0, |ahead_ns| ahead_ns as f64 - passed_ns)
        });
        let mut rerun = rerun.into_iter();
        if let Some(first) = rerun.next() {
            self.begin_rerun(first, late_ns.max(0.0), out);
        }
        for sample in rerun {
            let frame = sample.frame;
            match observe(self, sample, out) {
                Observation::Duplicate => self.refused.push((frame, DiscardCause::Duplicate)),
                Observation::OutOfOrder => self.refused.push((frame, DiscardCause::OutOfOrder)),
                Observation::Taken => {}
                observation => self.held_observation = Some(observation),
            }
        }
    }

    /// Takes the first sample of another run of the sensor's clock, which was read this late.
    fn begin_rerun(&mut self, first: Sample, late_ns: f64, out: &mut Vec<Record>) {
        let Some(last) = self.last else { return self.take(first, out) };
        let host_ns = host_elapsed_ns(&last, first.host_mono_ns, first.host_utc_ns);
        // The last sample before may have been read late as well.
        let away_ns = if is_one_boot(&last, &first) { (host_ns + self.late_ns - late_ns).max(0.0) } else { host_ns };
        let suspicion = self.suspicion.take();
        let host_trouble = std::mem::replace(&mut self.host_trouble, self.rerun_trouble);
        let observation = self.new_epoch(&last, first, (away_ns, GapCause::SensorReset), out);
        (self.late_ns, self.suspicion, self.host_trouble) = (late_ns, suspicion, host_trouble);
        self.held_observation = Some(observation);
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
        (self.late_ns, self.on_line_ns) = (0.0, 0.0);
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
}
