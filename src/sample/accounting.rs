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

use super::{Gap, GapCause, Record, Sample, Segment, Timebase};
use crate::units::period_ns;

/// A device time that lies back by no more than this is a duplicate or a reordered frame; beyond it the clock was reset.
pub const REORDER_WINDOW_NS: u64 = 1_000_000_000;
/// Without device time: for how long the stream must stay late before samples count as missing.
pub const DECISION_S: f64 = 0.1;
/// Without device time: the share of a period by which the stream must be late.
const LATE_PERIODS: f64 = 0.75;
/// Without device time: lateness below this says nothing by itself: an FTDI adapter's latency timer is 16 ms at worst.
const HOST_JITTER_NS: f64 = 20e6;
/// Without device time: how fast host and sensor clocks may drift apart unnoticed (500 ppm is ten times what both may).
const DRIFT: f64 = 500e-6;
/// Without device time: how many samples may be held while a burst catches up.
const HELD_MAX: usize = 16_384;
/// After an interruption, device and host must agree on its length within this share (and [`EPOCH_SLACK_NS`]);
/// otherwise the sensor was without power in between and its clock started again.
const EPOCH_SHARE: f64 = 1e-3;
const EPOCH_SLACK_NS: f64 = 2e9;

/// What came of one sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observation {
    /// It was taken (or is held until it is clear whether samples are missing before it).
    Taken,
    /// Its device time was there already.
    Duplicate,
    /// It was taken, and the sensor's clock had started again before it.
    AfterReset,
}

/// The end of what is accounted for: where the next sample is measured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Device time of the last sample.
    pub device_time_ns: Option<u64>,
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
    arrival: Arrival,
    /// How late a host may read for reasons of its own, ns: lateness below it says nothing about the sensor.
    host_jitter_ns: f64,
    backward: u32,
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
            arrival: Arrival::default(),
            host_jitter_ns: 0.0,
            backward: 0,
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
        self.received + self.arrival.held.len() as u64
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
            self.interrupted.get_or_insert(cause);
        }
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
        match (self.timebase, sample.device_time_ns) {
            (Timebase::Device, Some(device_time_ns)) => self.observe_device(sample, device_time_ns, out),
            _ => {
                self.observe_arrival(sample, out);
                Observation::Taken
            }
        }
    }

    /// Decides on samples that are held; to be called before the capture ends.
    pub fn settle(&mut self, out: &mut Vec<Record>) {
        if !self.arrival.held.is_empty() {
            let late = if self.arrival.steady > 0 { self.arrival.least_late_ns } else { self.arrival.previous_late_ns };
            self.release(late, out);
        }
    }

    /// Counts `missing` samples between the last one and `to_utc_ns`, where the capture ends without a further sample.
    pub fn close_with_gap(&mut self, missing: u64, to_utc_ns: i64, out: &mut Vec<Record>) {
        self.settle(out);
        let cause = self.interrupted.or(self.suspicion).unwrap_or(GapCause::Silent);
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

    fn push_gap(&mut self, gap: Gap, out: &mut Vec<Record>) {
        self.missing += gap.missing;
        self.gaps += 1;
        self.open = None;
        out.push(Record::Gap(gap));
    }

    fn observe_device(&mut self, sample: Sample, device_ns: u64, out: &mut Vec<Record>) -> Observation {
        let Some(last) = self.last else {
            self.take(sample, out);
            return Observation::Taken;
        };
        let period = period_ns(self.rate_hz);
        let host_ns = host_elapsed_ns(&last, &sample);
        let Some(last_device_ns) = last.device_time_ns else {
            // The times before came from the host: only it can tell the distance.
            self.gap_by_host(&last, &sample, host_ns, GapCause::FormatChange, out);
            self.take(sample, out);
            return Observation::Taken;
        };
        if device_ns <= last_device_ns {
            let back = last_device_ns - device_ns;
            self.backward += 1;
            // A clock that stands back but runs on steadily was reset shortly after an earlier reset.
            if back <= REORDER_WINDOW_NS && (self.interrupted.is_none() || back == 0) && self.backward < 16 {
                return Observation::Duplicate;
            }
            return self.new_epoch(&last, sample, host_ns, out);
        }
        let step_ns = (device_ns - last_device_ns) as f64;
        // A clock that started again is behind; one that is ahead of the host's says that the host's stood or was stepped.
        if self.interrupted.is_some() && host_ns - step_ns > EPOCH_SLACK_NS + EPOCH_SHARE * host_ns {
            return self.new_epoch(&last, sample, host_ns, out);
        }
        self.backward = 0;
        let steps = (step_ns / period).round() as u64;
        if steps == 0 {
            return Observation::Duplicate;
        }
        if steps > 1 {
            let cause = self.interrupted.or(self.suspicion).unwrap_or(GapCause::Silent);
            self.push_gap(
                Gap {
                    before_seq: self.received,
                    from_utc_ns: last.host_utc_ns,
                    to_utc_ns: sample.host_utc_ns,
                    device_ns: Some((last_device_ns, device_ns)),
                    missing: steps - 1,
                    missing_exact: true,
                    cause,
                },
                out,
            );
        }
        self.take(sample, out);
        Observation::Taken
    }

    fn new_epoch(&mut self, last: &Position, sample: Sample, host_ns: f64, out: &mut Vec<Record>) -> Observation {
        self.backward = 0;
        self.open = None;
        self.epoch += 1;
        // The consequences of a reset are not its cause.
        if matches!(self.interrupted, Some(GapCause::FormatChange | GapCause::Silent | GapCause::Checksum)) {
            self.interrupted = Some(GapCause::SensorReset);
        }
        // Whatever a host's stepped clock says, the sensor has run at least as long as its own clock shows.
        let host_ns = host_ns.max(sample.device_time_ns.unwrap_or(0) as f64);
        self.gap_by_host(last, &sample, host_ns, GapCause::SensorReset, out);
        self.take(sample, out);
        Observation::AfterReset
    }

    fn gap_by_host(&mut self, last: &Position, sample: &Sample, host_ns: f64, cause: GapCause, out: &mut Vec<Record>) {
        let missing = (host_ns / period_ns(self.rate_hz)).round() as u64;
        if missing > 1 {
            let cause = self.interrupted.unwrap_or(cause);
            self.push_gap(
                Gap {
                    before_seq: self.received,
                    from_utc_ns: last.host_utc_ns,
                    to_utc_ns: sample.host_utc_ns,
                    device_ns: None,
                    missing: missing - 1,
                    missing_exact: false,
                    cause,
                },
                out,
            );
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
            let host_ns = host_elapsed_ns(&last, &sample);
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
            let cause = self.suspicion.unwrap_or(GapCause::Silent);
            self.push_gap(
                Gap {
                    before_seq: self.received,
                    from_utc_ns: last.host_utc_ns,
                    to_utc_ns: first.host_utc_ns,
                    device_ns: None,
                    missing,
                    missing_exact: false,
                    cause,
                },
                out,
            );
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
            };
            out.push(Record::Segment(segment.clone()));
            self.open = Some(segment);
        }
        self.last = Some(Position {
            device_time_ns: sample.device_time_ns,
            host_mono_ns: sample.host_mono_ns,
            host_utc_ns: sample.host_utc_ns,
        });
        out.push(Record::Sample { seq: self.received, segment: self.segments, sample });
        self.received += 1;
    }
}

/// Host time between the last sample and this one, ns: monotonic within one boot, civil across boots.
fn host_elapsed_ns(last: &Position, sample: &Sample) -> f64 {
    if last.host_mono_ns > 0 && sample.host_mono_ns >= last.host_mono_ns {
        (sample.host_mono_ns - last.host_mono_ns) as f64
    } else {
        ((sample.host_utc_ns - last.host_utc_ns) as f64).max(0.0)
    }
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
        assert_eq!(accountant.observe(sample(399, true, 0), &mut out), Observation::Duplicate);
        let mut after = sample(480, true, 0);
        after.device_time_ns = Some(1_000_000);
        assert_eq!(accountant.observe(after, &mut out), Observation::AfterReset);
        let gaps = gaps(&out);
        assert_eq!((gaps[0].missing, gaps[0].missing_exact, gaps[0].cause), (79, false, GapCause::SensorReset));
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
        let last =
            Position { device_time_ns: Some(5_000_000_000), host_mono_ns: 0, host_utc_ns: 1_700_000_000_000_000_000 };
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
