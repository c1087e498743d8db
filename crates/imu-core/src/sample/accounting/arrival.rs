//! Arrival: detects losses and other rates of samples without time from their arrivals. Pure.
//!
//! A message is late by its latency and never early. A schedule of the earliest arrivals therefore determines each
//! sample's meaning. A sample that is on time is taken at once. A sample that is late or early may follow a loss,
//! precede a burst, or be the first of another rate. From that sample on, samples are held until their arrivals have
//! been steady at one rate or the other ([`STEADY_NS`], [`RATE_NS`]). Until then, [`Accountant::take_doubt`] reports
//! the doubt to the session, which queries the sensor; its registers decide ([`Accountant::rate_known`]). A sensor that
//! numbers its messages by a separate clock, not by its rate ([`Timebase::SyncCounter`]), is also judged by its
//! arrivals: the steps of such a count look like losses or repetitions if the rate differs.

use super::{Accountant, DRIFT, Observation, RATE_STEPS_MIN, RateDoubt, host_elapsed_ns};
use crate::sample::{GapCause, Record, Sample, Timebase};
use crate::units::period_ns;

/// The share of a period by which the stream must be late.
const LATE_PERIODS: f64 = 0.75;
/// Lateness below this has no meaning by itself, ns: an FTDI adapter's latency timer is 16 ms at worst.
const HOST_JITTER_NS: f64 = 20e6;
/// Held samples belong to the rate if their earliest arrivals keep it for this long, ns; at least [`STEADY_MIN`] of
/// them. Neighbouring rates of register 7 differ by a fifth: by 80 ms within this time.
const STEADY_NS: f64 = 0.4e9;
const STEADY_MIN: usize = 4;
/// Samples belong to another rate if they keep it for this long, ns; at least [`RATE_MIN`] of them: random losses do
/// not arrive evenly. The second time is for a sensor whose registers state that the rate is unchanged.
const RATE_NS: f64 = 2e9;
const RATE_CONFIRMED_NS: f64 = 3.5e9;
const RATE_MIN: usize = 8;
/// Counted samples belong to another rate if their counts lead or lag those of the present one by this many, advance by so
/// many (neighbouring rates then differ by more than one), and their arrivals agree for this long, ns.
const COUNT_EVIDENCE: f64 = 6.0;
const COUNTS_MIN: f64 = 8.0;
const COUNT_NS: f64 = 1e9;
/// The share of arrivals that may be later than the jitter allows when they are compared with another rate.
const RATE_LATE: f64 = 0.1;
/// Rates that differ by less are equal, and a measured rate this close to one of the sensor's is that rate.
const RATE_NEAR: f64 = 0.04;
/// Samples that are held for longer than this put the rate in doubt, ns.
const DOUBT_NS: u64 = 600_000_000;
/// The time after which a doubt about the rate that is not decided is raised again, ns: the rate may change after the sensor has
/// answered.
pub const DOUBT_AGAIN_NS: u64 = 2_000_000_000;
/// The longest time for which samples are held, ns, and the maximum number of held samples.
const HELD_NS: f64 = 6e9;
const HELD_MAX: usize = 16_384;
/// Samples that arrive this close together were read late, ns: no message comes at more than 200 Hz.
const BURST_NS: f64 = 2.5e6;
/// A sensor that was silent for longer than this before it sent at another rate was reset, ns: it boots for about 1.25
/// s.
const RESET_SILENCE_NS: f64 = 0.5e9;

/// The expected arrival of the next sample, for streams without device time.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Arrival {
    /// Earliest plausible arrival of the next sample, or of the first held one if any are held, ns of the host's
    /// monotonic clock.
    pub(super) next_mono_ns: f64,
    /// Samples whose meaning is undecided.
    pub(super) held: Vec<Sample>,
    /// How far the stream recently ran ahead of the schedule, ns.
    early_ns: f64,
    /// The host's trouble when the first held sample arrived.
    host_trouble: Option<GapCause>,
    /// The beginning of what is undecided, ns of the host's monotonic clock: the first held sample, or the first one after a
    /// silence among them.
    begun_ns: u64,
    /// Whether there was such a silence.
    was_silent: bool,
    /// When the doubt is due to be reported, ns of the host's monotonic clock.
    doubt_due_ns: u64,
    /// Whether the sensor's registers state that the rate is unchanged.
    confirmed: bool,
}

impl Accountant {
    /// Returns the host's own lateness in reading, ns.
    fn jitter_ns(&self) -> f64 {
        self.host_jitter_ns.max(HOST_JITTER_NS)
    }

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
            let (old_period, longest) = (period_ns(self.last_rate_hz), period.max(period_ns(self.last_rate_hz)));
            // No sample is missing at the step from one rate to the other.
            let away_ns =
                if host_ns > silence_of_a_reset(old_period, period) { host_ns } else { host_ns - longest + old_period };
            self.gap_by_host(&last, &sample, away_ns, GapCause::FormatChange, out);
            self.arrival.next_mono_ns = arrived + period;
            self.take(sample, out);
            return;
        }
        if self.arrival.held.is_empty() {
            let late_ns = arrived - self.arrival.next_mono_ns;
            // A rejected frame explains one missing sample; without one, lateness must exceed the host's own.
            let jitter_ns = if self.suspicion.is_some() { 0.0 } else { self.jitter_ns() };
            let early_ns = (self.arrival.early_ns - late_ns.min(0.0) - 2.0 * DRIFT * period).max(0.0);
            if late_ns < (LATE_PERIODS * period).max(jitter_ns) && early_ns < self.jitter_ns() {
                self.arrival.early_ns = early_ns;
                self.arrival.next_mono_ns += period + late_ns.min(DRIFT * period);
                self.note_lateness(late_ns, period);
                self.take(sample, out);
                return;
            }
        }
        self.hold(sample, out);
    }

    /// Handles samples with the sensor's count: a step of one is the next sample. Any other step is a loss, a
    /// repetition, or another rate.
    pub(super) fn observe_counted(&mut self, sample: Sample, out: &mut Vec<Record>) -> Observation {
        if self.arrival.held.is_empty() {
            let explained = self.interrupted.is_some() || self.suspicion.is_some();
            let Some(last) = self.last.filter(|last| last.host_mono_ns > 0 && !explained) else {
                return self.observe_step(sample, out);
            };
            let step = last.sync_count.zip(sample.sync_count).map(|(from, to)| to.wrapping_sub(from) as i32);
            if !step.is_some_and(|step| step == 0 || (step > 1 && f64::from(step) < self.rate_hz.max(2.0) * 2.0)) {
                return self.observe_step(sample, out);
            }
            self.arrival.next_mono_ns = last.host_mono_ns as f64 + period_ns(self.rate_hz);
        }
        self.hold(sample, out);
        Observation::Taken
    }

    fn hold(&mut self, sample: Sample, out: &mut Vec<Record>) {
        let now_ns = sample.host_mono_ns;
        let before_ns = self.arrival.held.last().map(|before| before.host_mono_ns);
        if before_ns.is_none() {
            self.arrival.host_trouble = self.host_trouble.map(|(cause, _)| cause);
        }
        let period = period_ns(self.rate_hz);
        let silence_ns = silence_of_a_reset(period, period);
        let is_silence = before_ns.is_none_or(|before_ns| now_ns.saturating_sub(before_ns) as f64 > silence_ns);
        // A first silence may be a boot. Later ones may be a low rate.
        if before_ns.is_none() || (is_silence && !self.arrival.was_silent) {
            self.arrival.was_silent = before_ns.is_some();
            (self.arrival.begun_ns, self.arrival.doubt_due_ns) = (now_ns, now_ns + DOUBT_NS);
        }
        self.arrival.held.push(sample);
        let held = &self.arrival.held;
        // If many samples are held, each further one changes little.
        if !held.len().is_multiple_of(1 + held.len() / 64) {
            return;
        }
        let span_ns = now_ns.saturating_sub(self.arrival.begun_ns);
        let longest_ns = HELD_NS.max(32.0 * self.host_jitter_ns);
        let counted = self.counted_rate().map(|rate_hz| (rate_hz, self.arrive_at(rate_hz)));
        let awaits_count = match counted {
            Some((_, agrees)) => agrees.is_none(),
            None => self.count_lead().abs() >= COUNT_EVIDENCE && (span_ns as f64) < RATE_NS,
        };
        if let Some((rate_hz, Some(true))) = counted {
            self.doubt = Some(RateDoubt::Changed(self.longest_silence_ns()));
            self.adopt_arrivals(rate_hz, out);
        } else if let (Some(late_from), false) = (self.steady_until(), awaits_count) {
            if self.count_contradicts(late_from) {
                self.doubt = Some(RateDoubt::Open(self.longest_silence_ns()));
                self.timebase = Timebase::Arrival;
                self.open = None;
            }
            let (mut late, host_trouble) = (self.arrival.held.split_off(late_from), self.arrival.host_trouble);
            self.release(out);
            if let (Some(first), true) = (late.first(), self.arrival.held.is_empty()) {
                self.arrival.begun_ns = first.host_mono_ns;
                self.arrival.doubt_due_ns = now_ns + DOUBT_NS;
                self.arrival.host_trouble = host_trouble;
                if let (Timebase::SyncCounter, Some(last)) = (self.timebase, self.last) {
                    self.arrival.next_mono_ns = last.host_mono_ns as f64 + period;
                }
            }
            // A count that is not used any more leaves samples undecided.
            self.arrival.held.append(&mut late);
        } else if span_ns as f64 > longest_ns || held.len() >= HELD_MAX {
            self.release_undecided(out);
        } else if let Some(rate_hz) = self.other_rate() {
            self.doubt = Some(RateDoubt::Changed(self.longest_silence_ns()));
            self.adopt_arrivals(rate_hz, out);
        } else if now_ns > self.arrival.doubt_due_ns {
            self.arrival.doubt_due_ns = now_ns + DOUBT_AGAIN_NS;
            self.doubt = Some(RateDoubt::Open(self.longest_silence_ns()));
        }
    }

    /// Returns whether the sensor counted on since the last sample: it was not reset.
    fn counts_on(&self) -> bool {
        let mut counts = self.arrival.held.iter().map(|sample| sample.sync_count);
        let mut before = self.last.and_then(|last| last.sync_count);
        self.timebase == Timebase::SyncCounter
            && counts.all(|count| {
                let is_later = before.zip(count).is_some_and(|(from, to)| to.wrapping_sub(from) as i32 >= 0);
                before = count;
                is_later
            })
    }

    /// Returns the longest time before a held sample without another, ns; 0 if the sensor counted on. The first one was due at the
    /// rate.
    fn longest_silence_ns(&self) -> u64 {
        if self.counts_on() {
            return 0;
        }
        let Arrival { held, next_mono_ns, .. } = &self.arrival;
        let first_ns = held.first().map_or(0.0, |first| first.host_mono_ns as f64 - next_mono_ns);
        let between = held.windows(2).map(|pair| pair[1].host_mono_ns.saturating_sub(pair[0].host_mono_ns) as f64);
        between.fold(first_ns + period_ns(self.rate_hz), f64::max) as u64
    }

    /// Returns whether the count of the held samples that keep the rate, up to `until`, advances at another rate: it does not
    /// count the messages. Few lost samples may hide among steady arrivals.
    fn count_contradicts(&self, until: usize) -> bool {
        let held = &self.arrival.held[..until];
        let from = self.tail(STEADY_NS, STEADY_MIN).and_then(|from| held.get(from..));
        let (Timebase::SyncCounter, Some([first, .., last])) = (self.timebase, from) else { return false };
        let steps = from.map_or(0, <[Sample]>::len) as f64 - 1.0;
        let advance = first.sync_count.zip(last.sync_count).map(|(from, to)| f64::from(to.wrapping_sub(from) as i32));
        let hidden = HOST_JITTER_NS.max(self.host_jitter_ns) / period_ns(self.rate_hz);
        advance.is_some_and(|advance| (advance - steps).abs() > 0.25 * steps + hidden)
    }

    /// Releases the held samples until none is left: nothing more comes that would decide about them.
    pub(super) fn release_all(&mut self, out: &mut Vec<Record>) {
        if let Some(rate_hz) = self.counted_rate() {
            self.adopt_arrivals(rate_hz, out);
        }
        while !self.arrival.held.is_empty() {
            self.release_undecided(out);
        }
    }

    /// Returns the only rate whose messages have the counts of the last held samples, Hz, if it is another one: no loss removes
    /// messages so regularly. The clock of the count may have changed instead ([`Self::arrive_at`]).
    fn counted_rate(&self) -> Option<f64> {
        if self.timebase != Timebase::SyncCounter {
            return None;
        }
        let held = &self.arrival.held;
        let counts: Vec<f64> = held
            .iter()
            .map(|sample| Some(f64::from(sample.sync_count?.wrapping_sub(held[0].sync_count?) as i32)))
            .collect::<Option<_>>()?;
        let others = MESSAGE_RATES_HZ.into_iter().filter(|rate_hz| (rate_hz / self.rate_hz - 1.0).abs() > RATE_NEAR);
        let mut fitting = others.filter_map(|rate_hz| {
            let advance = self.rate_hz / rate_hz;
            let least = (COUNT_EVIDENCE / (advance - 1.0).abs()).max(COUNTS_MIN / advance).ceil();
            let steps = RATE_STEPS_MIN.max(least as usize);
            let from = counts.len().checked_sub(steps + 1)?;
            let off = counts[from..].iter().enumerate().map(|(index, count)| count - index as f64 * advance);
            let (low, high) =
                off.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), off| (low.min(off), high.max(off)));
            (high - low <= 1.0).then_some(rate_hz)
        });
        fitting.next().filter(|_| fitting.next().is_none())
    }

    /// Returns by how many the counts of the last held samples lead (or lag, below 0) those of messages of the present rate.
    fn count_lead(&self) -> f64 {
        let held = &self.arrival.held;
        let first = held.len().checked_sub(RATE_STEPS_MIN + 1).map(|first| held[first].sync_count);
        let advance = first.flatten().zip(held.last().and_then(|last| last.sync_count));
        let lead = |(from, to): (u32, u32)| f64::from(to.wrapping_sub(from) as i32) - RATE_STEPS_MIN as f64;
        advance.filter(|_| self.timebase == Timebase::SyncCounter).map_or(0.0, lead)
    }

    /// Releases held samples about which nothing decided. Counts that repeat so often do not count the messages.
    fn release_undecided(&mut self, out: &mut Vec<Record>) {
        if self.count_lead() <= -COUNT_EVIDENCE {
            self.timebase = Timebase::Arrival;
            self.open = None;
        }
        self.undecided = true;
        self.release(out);
        self.undecided = false;
    }

    /// Returns whether the held samples arrive at this rate, and not at the present one; `None` if they do not suffice.
    fn arrive_at(&self, rate_hz: f64) -> Option<bool> {
        let arrived = &self.arrival.held[self.tail(COUNT_NS, RATE_MIN)?..];
        let span_ns = arrived.last()?.host_mono_ns.saturating_sub(arrived.first()?.host_mono_ns) as f64;
        let measured_hz = 1e9 * (arrived.len() - 1) as f64 / span_ns;
        let off = |other_hz: f64| (measured_hz / other_hz).ln().abs();
        Some(off(rate_hz) < off(self.rate_hz))
    }

    /// Returns the index of the last held samples that span this time and are at least `least`; `None` if the held
    /// samples do not suffice.
    fn tail(&self, span_ns: f64, least: usize) -> Option<usize> {
        let held = &self.arrival.held;
        let span_ns = span_ns.max(16.0 * self.host_jitter_ns) as u64;
        let until_ns = held.last()?.host_mono_ns.checked_sub(span_ns)?;
        let from = held.partition_point(|sample| sample.host_mono_ns <= until_ns).checked_sub(1)?;
        Some(from.min(held.len().checked_sub(least)?))
    }

    /// Returns the end of the held samples that keep the rate: the earliest arrivals of the four quarters of their time
    /// agree. Those after the end are late again, and stay undecided.
    fn steady_until(&self) -> Option<usize> {
        let period = period_ns(self.rate_hz);
        let from = self.tail(STEADY_NS, STEADY_MIN)?;
        let held = &self.arrival.held[from..];
        // Samples of a higher rate make up for a boot, and are as early as the old rate for a moment.
        let silence_ns = silence_of_a_reset(period, period);
        let gap_ns = |pair: &[Sample]| pair[1].host_mono_ns.saturating_sub(pair[0].host_mono_ns) as f64;
        if held.windows(2).any(|pair| gap_ns(pair) > silence_ns) {
            return None;
        }
        let since_ns = |sample: &Sample| sample.host_mono_ns.saturating_sub(held[0].host_mono_ns);
        let span_ns = since_ns(&held[held.len() - 1]);
        let mut earliest_ns = [f64::INFINITY; 4];
        let late_ns = residuals_ns(held, period);
        for (sample, late_ns) in held.iter().zip(&late_ns) {
            let quarter = &mut earliest_ns[((4 * since_ns(sample) / (span_ns + 1)) as usize).min(3)];
            *quarter = quarter.min(*late_ns);
        }
        let finite_ns = earliest_ns.into_iter().filter(|ns| ns.is_finite());
        let (least, most) = finite_ns.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), ns| (a.min(ns), b.max(ns)));
        let agreement_ns = (LATE_PERIODS * period).clamp(0.4 * HOST_JITTER_NS, HOST_JITTER_NS).max(self.host_jitter_ns);
        let on_time = |late_ns: &f64| late_ns - least < (LATE_PERIODS * period).max(self.jitter_ns());
        (most - least <= agreement_ns).then(|| from + late_ns.iter().rposition(on_time).map_or(0, |last| last + 1))
    }

    /// Returns another rate that the last held samples keep, Hz.
    fn other_rate(&self) -> Option<f64> {
        let least_ns = if self.arrival.confirmed { RATE_CONFIRMED_NS } else { RATE_NS };
        let held = &self.arrival.held[self.tail(least_ns, RATE_MIN)?..];
        // The median of the slopes over half of the time: neither a burst nor a loss moves it.
        let half = held.len() / 2;
        let slope =
            |pair: (&Sample, &Sample)| pair.1.host_mono_ns.saturating_sub(pair.0.host_mono_ns) as f64 / half as f64;
        let mut slopes: Vec<f64> = held.iter().zip(&held[half..]).map(slope).collect();
        slopes.sort_by(f64::total_cmp);
        let rate_hz = nearest_rate(1e9 / slopes.get(slopes.len() / 2).filter(|slope| **slope > 0.0)?)?;
        if (rate_hz / self.rate_hz - 1.0).abs() < RATE_NEAR {
            return None;
        }
        let mut late_ns = residuals_ns(held, period_ns(rate_hz));
        late_ns.sort_by(f64::total_cmp);
        let most = late_ns[((late_ns.len() - 1) as f64 * (1.0 - RATE_LATE)) as usize];
        (most - late_ns[0] <= self.tolerance_ns()).then_some(rate_hz)
    }

    /// Returns the maximum deviation of arrivals at one rate from their schedule, ns.
    fn tolerance_ns(&self) -> f64 {
        1.25 * self.jitter_ns()
    }

    /// Takes the rate that the sensor's registers state: held samples belong to it.
    pub fn rate_known(&mut self, rate_hz: f64, out: &mut Vec<Record>) {
        if self.arrival.held.is_empty() {
            return;
        }
        if (rate_hz / self.rate_hz - 1.0).abs() < RATE_NEAR {
            self.arrival.confirmed = true;
        } else {
            self.adopt_arrivals(rate_hz, out);
        }
    }

    /// Releases the held samples at the unchanged rate. The number of samples missing before a held sample is the
    /// smallest lateness from that sample on.
    pub(super) fn release(&mut self, out: &mut Vec<Record>) {
        let steady = self.tail(STEADY_NS / 4.0, STEADY_MIN).unwrap_or(0);
        let Arrival { next_mono_ns, held, host_trouble, .. } = std::mem::take(&mut self.arrival);
        self.arrival.next_mono_ns = next_mono_ns;
        if self.timebase == Timebase::SyncCounter {
            self.observe_held(held, host_trouble, out);
            // Samples that are still held must not overtake them.
            while !self.rerun.held.is_empty() {
                self.end_rerun(Self::observe_step, out);
            }
            return;
        }
        let period = period_ns(self.rate_hz);
        let mut least_ns: Vec<f64> =
            residuals_ns(&held, period).iter().map(|ns| ns + held[0].host_mono_ns as f64 - next_mono_ns).collect();
        let mut until_now = f64::INFINITY;
        for late_ns in least_ns.iter_mut().rev() {
            until_now = until_now.min(*late_ns);
            *late_ns = until_now;
        }
        let steady_ns = least_ns.get(steady).copied().unwrap_or(0.0);
        let cause = self.interrupted.or(host_trouble).unwrap_or(self.cause());
        let mut counted = 0;
        for (sample, late_ns) in held.into_iter().zip(least_ns) {
            let missing = (late_ns.min(steady_ns) / period).round().max(0.0) as u64;
            if let (Some(last), true) = (self.last, missing > counted) {
                // A gap of an interrupted stream has the rate of the samples before it.
                let is_before = self.interrupted.is_some() && self.rate_changes();
                let share = if is_before { period / period_ns(self.last_rate_hz) } else { 1.0 };
                let more = ((missing - counted) as f64 * share).round() as u64;
                if more > 0 {
                    let gap = self.gap(&last, &sample, None, more, false, cause);
                    self.push_gap(gap, out);
                }
                counted = missing;
            }
            self.arrival.next_mono_ns += period;
            self.take(sample, out);
        }
        self.arrival.next_mono_ns += counted as f64 * period + steady_ns.min(0.0);
    }

    /// Returns the first held sample of another rate: the one with the fewest missing samples before it at the old rate
    /// and after it at the new one.
    fn first_of(&self, rate_hz: f64) -> usize {
        let (old_period, period) = (period_ns(self.rate_hz), period_ns(rate_hz));
        let Arrival { held, next_mono_ns, .. } = &self.arrival;
        let late_ns = residuals_ns(held, period);
        let line_ns = late_ns[held.len() * 3 / 4..].iter().copied().fold(f64::INFINITY, f64::min);
        let begun_ns = held[0].host_mono_ns as f64 - next_mono_ns;
        // After a boot the new rate begins with the first sample, although the samples of a higher rate soon make up for the
        // silence at the old rate. Samples that were only read late come at once.
        let silence_ns = |index: usize| match index.checked_sub(1) {
            Some(before) => held[index].host_mono_ns.saturating_sub(held[before].host_mono_ns) as f64,
            None => begun_ns + old_period,
        };
        let keeps = |index: &usize| {
            let head = &late_ns[*index..late_ns.len().min(index + 2 * STEADY_MIN)];
            let ends =
                head.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), ns| (low.min(*ns), high.max(*ns)));
            silence_ns(*index) > silence_of_a_reset(old_period, period) && ends.1 - ends.0 <= self.tolerance_ns()
        };
        if let Some(first) = (0..held.len()).rev().find(keeps) {
            return first;
        }
        let old_late_ns: Vec<f64> = residuals_ns(held, old_period).iter().map(|ns| begun_ns + ns).collect();
        let (mut first, mut fewest) = (0, f64::INFINITY);
        let (mut least_ns, mut most_ns) = (0.0_f64, 0.0_f64);
        for index in (0..held.len()).rev() {
            let off_ns = late_ns[index] - line_ns;
            least_ns = least_ns.min(off_ns);
            // Samples that were read late come at once.
            let at_once = late_ns.get(index + 1).is_some_and(|next| next - late_ns[index] + period < BURST_NS);
            most_ns = if at_once { most_ns } else { most_ns.max(off_ns) };
            let old_ns = match index.checked_sub(1).map(|before| old_late_ns[before]) {
                Some(early_ns) if early_ns < 0.0 => (-early_ns - self.tolerance_ns()).max(0.0),
                late_ns => late_ns.unwrap_or(0.0),
            };
            let new_ns = (most_ns - self.tolerance_ns()).max(0.0) + (-least_ns - self.tolerance_ns()).max(0.0);
            // If both are equal, the straighter line is taken.
            let missing = old_ns / old_period + (new_ns + 0.05 * (most_ns - least_ns)) / period;
            if missing <= fewest {
                (first, fewest) = (index, missing);
            }
        }
        first
    }

    /// Returns the first held sample whose count shows that it is no message of the old rate: it is the same as the one before,
    /// or from there on all steps are those of messages of a lower rate. Arrivals of a burst show nothing.
    fn first_by_count(&self, rate_hz: f64) -> usize {
        let before = std::iter::once(self.last.and_then(|last| last.sync_count));
        let counts: Option<Vec<u32>> = before.chain(self.arrival.held.iter().map(|sample| sample.sync_count)).collect();
        let Some([before, counts @ .., end]) = counts.as_deref() else { return usize::MAX };
        let ratio = self.rate_hz / rate_hz;
        if ratio < 1.0 {
            let pairs = std::iter::once(before).chain(counts).zip(counts.iter().chain([end]));
            return pairs.into_iter().position(|(before, count)| before == count).unwrap_or(usize::MAX);
        }
        // Counts are whole numbers: they are within one of those of the lower rate.
        let is_lower = |(back, count): &(usize, &u32)| {
            let advance = f64::from(end.wrapping_sub(**count) as i32);
            (advance - (back + 1) as f64 * ratio).abs() <= 1.0
        };
        let lower = counts.iter().rev().enumerate().take_while(is_lower).count();
        if lower > 1 { counts.len() - lower } else { usize::MAX }
    }

    /// Assigns the held samples to this rate, from the first possible one on.
    fn adopt_arrivals(&mut self, rate_hz: f64, out: &mut Vec<Record>) {
        let (old_period, period) = (period_ns(self.rate_hz), period_ns(rate_hz));
        let counts_on = self.counts_on();
        let first = self.first_of(rate_hz).min(self.first_by_count(rate_hz));
        let held = self.arrival.held.split_off(first);
        let host_trouble = self.arrival.host_trouble;
        self.release_all(out);
        let last_due_ns = match (self.timebase, self.last) {
            (Timebase::SyncCounter, Some(last)) => last.host_mono_ns as f64,
            _ => self.arrival.next_mono_ns - old_period,
        };
        self.timebase = Timebase::Arrival;
        // Several samples show better than the first one alone when the first one was due: those that come at once, and
        // some more.
        let apart = |pair: &[Sample]| pair[1].host_mono_ns.saturating_sub(pair[0].host_mono_ns) as f64 >= BURST_NS;
        let at_once = held.windows(2).position(apart).unwrap_or(0);
        let late_ns = residuals_ns(&held[..held.len().min(at_once + 2 * STEADY_MIN)], period);
        let mut held = held.into_iter();
        let (Some(first), Some(last)) = (held.next(), self.last) else { return };
        let due_ns = first.host_mono_ns as f64 + late_ns.iter().copied().fold(0.0, f64::min);
        let (away_ns, longest) = (due_ns - last_due_ns, old_period.max(period));
        if away_ns - longest > (LATE_PERIODS * longest).max(self.jitter_ns()) {
            let reset = away_ns > silence_of_a_reset(old_period, period) && !counts_on;
            // No sample is missing at the step from one rate to the other.
            let (cause, away_ns) = match reset {
                true => (GapCause::SensorReset, away_ns),
                false => (GapCause::RateChange, away_ns - longest + old_period),
            };
            self.gap_by_host(&last, &first, away_ns, host_trouble.unwrap_or(cause), out);
        }
        self.rate_hz = rate_hz;
        self.open = None;
        self.take(first, out);
        self.arrival = Arrival { next_mono_ns: due_ns + period, ..Arrival::default() };
        // Samples of the new rate may be missing as well.
        for sample in held {
            self.observe_arrival(sample, out);
        }
    }
}

/// Returns the time between two samples of these periods (ns) above which the sensor was reset in between, ns. Without a reset,
/// a sample follows within the longer period.
pub(super) fn silence_of_a_reset(old_period: f64, period: f64) -> f64 {
    RESET_SILENCE_NS + old_period.max(period)
}

/// Returns the lateness of each sample relative to this many periods after the first, ns.
fn residuals_ns(samples: &[Sample], period: f64) -> Vec<f64> {
    let first_ns = samples.first().map_or(0, |sample| sample.host_mono_ns);
    let late =
        |(index, sample): (usize, &Sample)| sample.host_mono_ns.saturating_sub(first_ns) as f64 - index as f64 * period;
    samples.iter().enumerate().map(late).collect()
}

/// The rates that register 7 accepts, Hz.
const MESSAGE_RATES_HZ: [f64; 11] = [1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0];

/// Returns the message rate near a measured one, Hz. Random losses result in any rate.
fn nearest_rate(measured_hz: f64) -> Option<f64> {
    MESSAGE_RATES_HZ.into_iter().find(|rate_hz| (rate_hz / measured_hz - 1.0).abs() < RATE_NEAR)
}
