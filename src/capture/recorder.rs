//! Recorder: writes one capture from its first sample to its planned end. Pure.
//!
//! A capture runs on sample time: it is complete when received + missing = duration × rate, however long that took
//! (docs/formats.md). A gap that reaches beyond the planned end is cut there; later samples are not part of the
//! capture.

use crate::observe::Tally;
use imu_core::sample::accounting::{Position, host_elapsed_ns};
use imu_core::sample::record::CaptureEnd;
use imu_core::sample::{
    Accountant, DiscardCause, EventKind, EventRecord, GapCause, Observation, RateDoubt, Record, Sample, Timebase,
};
use imu_core::units::counted;
use imu_core::units::period_ns;
use std::collections::{BTreeMap, VecDeque};

/// Silence that counts as an outage when the capture is stopped by hand: this long, ns, and this many periods.
const OUTAGE_NS: f64 = 1e9;
const OUTAGE_PERIODS: f64 = 20.0;
/// Silence after which an absent sensor is assumed to be absent until the planned end, ns.
const PATIENCE_NS: u64 = 5_000_000_000;

/// The plan of a capture.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The capture's id.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// The planned sample time, ns.
    pub duration_ns: u64,
    /// The planned start, UTC ns; at once if absent.
    pub start_at_utc_ns: Option<i64>,
}

/// The state in which an earlier run of the daemon left a capture.
#[derive(Debug, Clone, PartialEq)]
pub struct ResumePoint {
    /// Number of segments so far.
    pub segments: u32,
    /// Epoch of the last segment.
    pub epoch: u32,
    /// Number of samples received and committed.
    pub samples: u64,
    /// Number of valid measurements received, as of the last commit.
    pub received: u64,
    /// Of these, the number that did not become a sample, by cause.
    pub discarded: BTreeMap<DiscardCause, u64>,
    /// Number of samples missing.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Sample time so far, received and missing, ns.
    pub elapsed_ns: u64,
    /// The last sample; `None` if the capture had none.
    pub last: Option<Position>,
    /// Output rate of the last segment in Hz.
    pub rate_hz: Option<f64>,
    /// Serial number of the capture's sensor.
    pub serial_number: Option<String>,
    /// Its baud rate.
    pub baud: Option<u32>,
    /// The contents of the sensor's output registers before the capture changed them, by number.
    pub previous_output: BTreeMap<u16, String>,
}

/// Counts of a running capture.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Counts {
    /// Number of samples received.
    pub samples: u64,
    /// Number of samples missing.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Sample time so far, ns.
    pub elapsed_ns: f64,
    /// The arrival time of the last sample, host monotonic ns.
    pub last_mono_ns: Option<u64>,
    /// The UTC time since which a gap is open, ns.
    pub gap_open_since_utc_ns: Option<i64>,
}

/// Writes one capture.
#[derive(Debug)]
pub struct Recorder {
    plan: Plan,
    accountant: Option<Accountant>,
    resume: Option<ResumePoint>,
    counts: Counts,
    /// Number of measurements received, counted at their arrival, before any decision about them.
    received: u64,
    /// Number of samples that earlier runs of the daemon committed.
    base: u64,
    /// Measurements that did not become a sample, by cause, in the order of [`DiscardCause::ALL`].
    dropped: [u64; DiscardCause::ALL.len()],
    /// Bytes and broken frames that are not recorded yet.
    discarded: BTreeMap<DiscardCause, u64>,
    /// Measurements that did not become a sample and are not recorded yet: number, cause, count. They are recorded
    /// before the next sample, so that `received` of a commit always matches its rows and discards.
    frames: VecDeque<(u64, DiscardCause, u64)>,
    /// Rate of the segment that is written, Hz.
    rate_hz: Option<f64>,
    /// The end of the capture, once the samples at hand are sorted.
    ending: Option<(CaptureEnd, i64)>,
    ended: bool,
    host_jitter_ns: f64,
    boot_id: Option<String>,
    scratch: Vec<Record>,
}

impl Recorder {
    /// Creates a recorder of a new capture, or of one that an earlier run of the daemon left; `host_jitter_ns` as
    /// [`Accountant::with_host_jitter`] takes it.
    pub fn new(plan: Plan, resume: Option<ResumePoint>, host_jitter_ns: f64) -> Self {
        let counts = resume.as_ref().map_or_else(Counts::default, |point| Counts {
            samples: point.samples,
            missing: point.missing,
            gaps: point.gaps,
            elapsed_ns: point.elapsed_ns as f64,
            last_mono_ns: None,
            gap_open_since_utc_ns: point.last.map(|last| last.host_utc_ns),
        });
        let mut dropped = [0; DiscardCause::ALL.len()];
        for (cause, count) in resume.iter().flat_map(|point| &point.discarded) {
            dropped[*cause as usize] = *count;
        }
        Self {
            plan,
            accountant: None,
            received: resume.as_ref().map_or(0, |point| point.received),
            base: counts.samples,
            dropped,
            rate_hz: resume.as_ref().and_then(|point| point.rate_hz),
            resume,
            counts,
            discarded: BTreeMap::new(),
            frames: VecDeque::new(),
            ending: None,
            ended: false,
            host_jitter_ns,
            boot_id: None,
            scratch: Vec::new(),
        }
    }

    /// Sets the id of the host's present boot: its monotonic times are comparable with those of segments with the same
    /// id.
    pub fn of_boot(self, boot_id: Option<String>) -> Self {
        Self { boot_id, ..self }
    }

    /// Returns the boot of the host; `None` if it is not known.
    pub fn boot_id(&self) -> Option<String> {
        self.boot_id.clone()
    }

    /// Returns the plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }
    /// Returns the counts so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }
    /// Returns whether the capture has ended.
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// Begins samples of this rate, with times of this timebase.
    pub fn accept(&mut self, rate_hz: f64, timebase: Timebase, out: &mut Vec<Record>) {
        match &mut self.accountant {
            Some(accountant) => {
                accountant.change(rate_hz, timebase, &mut self.scratch);
                self.forward(out);
            }
            None => {
                let accountant = match self.resume.take() {
                    Some(point) => {
                        let mut accountant = Accountant::resume(
                            point.rate_hz.unwrap_or(rate_hz),
                            timebase,
                            (point.segments, point.epoch, point.samples, point.missing, point.gaps),
                            point.last,
                            GapCause::DaemonStopped,
                        );
                        accountant.change(rate_hz, timebase, &mut self.scratch);
                        accountant
                    }
                    None => Accountant::new(rate_hz, timebase),
                };
                self.accountant = Some(accountant.with_host_jitter(self.host_jitter_ns));
            }
        }
    }

    /// Ends the samples until further notice.
    pub fn interrupt(&mut self, cause: GapCause, out: &mut Vec<Record>) {
        if let Some(accountant) = &mut self.accountant {
            accountant.interrupt(cause, &mut self.scratch);
            self.counts.gap_open_since_utc_ns = accountant.last().map(|last| last.host_utc_ns);
            self.forward(out);
        }
    }

    /// Takes the rate that the sensor's registers state: held samples without time belong to it.
    pub fn rate_known(&mut self, rate_hz: f64, out: &mut Vec<Record>) {
        if let Some(accountant) = &mut self.accountant {
            accountant.rate_known(rate_hz, &mut self.scratch);
            self.forward(out);
        }
    }

    /// Returns the doubt about the rate since the last call, if any.
    pub fn take_doubt(&mut self) -> Option<RateDoubt> {
        self.accountant.as_mut().and_then(Accountant::take_doubt)
    }

    /// Records that the host stood still or slept: it is the cause of gaps that appear until then.
    pub fn blame_host(&mut self, cause: GapCause, until_mono_ns: u64) {
        if let Some(accountant) = &mut self.accountant {
            accountant.blame_host(cause, until_mono_ns);
        }
    }

    /// Records a possible cause of the next gap.
    pub fn suspect(&mut self, cause: GapCause) {
        if let Some(accountant) = &mut self.accountant {
            accountant.suspect(cause);
        }
    }

    /// Returns the present counts of all received measurements by their state.
    pub fn tally(&self) -> Tally {
        Tally {
            capture_id: self.plan.id,
            received: self.received,
            samples: self.counts.samples,
            held: self.accountant.as_ref().map_or(0, Accountant::held),
            base: self.base,
            dropped: self.dropped,
        }
    }

    /// Returns the present run of the sensor's clock; `None` before the first sample.
    pub fn epoch(&self) -> Option<u32> {
        self.accountant.as_ref().filter(|accountant| accountant.last().is_some()).map(Accountant::epoch)
    }

    /// Returns the rate and timebase of the stream in the capture.
    pub fn stream(&self) -> Option<(f64, Timebase)> {
        self.accountant.as_ref().map(|accountant| (accountant.rate_hz(), accountant.timebase()))
    }

    /// Counts bytes that are no measurement, or a broken one.
    pub fn discard(&mut self, cause: DiscardCause, count: u64) {
        if count > 0 {
            *self.discarded.entry(cause).or_insert(0) += count;
        }
    }

    /// Counts a valid measurement that does not become a sample.
    pub fn refuse(&mut self, cause: DiscardCause) {
        self.received += 1;
        self.drop_frame(self.received, cause);
    }

    fn drop_frame(&mut self, frame: u64, cause: DiscardCause) {
        self.dropped[cause as usize] += 1;
        if self.frames.back().is_some_and(|(last, ..)| *last > frame) {
            // The measurement was held while later ones were refused.
            let place = self.frames.partition_point(|(number, ..)| *number < frame);
            self.frames.insert(place, (frame, cause, 1));
            return;
        }
        match self.frames.back_mut() {
            Some((last, of, count)) if *of == cause && *last + 1 == frame => {
                (*last, *count) = (frame, *count + 1);
            }
            _ => self.frames.push_back((frame, cause, 1)),
        }
    }

    /// Takes a sample.
    pub fn sample(&mut self, mut sample: Sample, out: &mut Vec<Record>) {
        if self.ended {
            self.refuse(DiscardCause::AfterEnd);
            return;
        }
        let Some(accountant) = &mut self.accountant else {
            self.refuse(DiscardCause::Probing);
            return;
        };
        self.received += 1;
        sample.frame = self.received;
        if self.counts.last_mono_ns.is_none() {
            let (kind, message) = match self.counts.samples {
                0 => (EventKind::CaptureStarted, format!("capture `{}` has its first sample", self.plan.name)),
                samples => {
                    let samples = counted(samples, "sample", "samples");
                    (EventKind::CaptureStarted, format!("capture `{}` goes on after {samples}", self.plan.name))
                }
            };
            out.push(Record::Event(EventRecord { utc_ns: sample.host_utc_ns, kind, message, detail: None }));
        }
        self.counts.last_mono_ns = Some(sample.host_mono_ns);
        let utc_ns = sample.host_utc_ns;
        let observation = accountant.observe(sample, &mut self.scratch);
        match observation {
            Observation::Duplicate => self.drop_frame(self.received, DiscardCause::Duplicate),
            Observation::OutOfOrder => self.drop_frame(self.received, DiscardCause::OutOfOrder),
            _ => out.extend(event_of(observation, utc_ns)),
        }
        self.forward(out);
    }

    /// Handles the passage of time: discards are recorded, and a sensor that is absent past the planned end ends the
    /// capture.
    pub fn tick(&mut self, now_mono_ns: u64, now_utc_ns: i64, out: &mut Vec<Record>) {
        self.write_discards(out);
        if self.ended {
            return;
        }
        let is_over = |recorder: &Self| {
            let (last, rate_hz, silence_ns) = recorder.silence(now_mono_ns, now_utc_ns)?;
            let left_ns = recorder.plan.duration_ns as f64 - recorder.counts.elapsed_ns;
            let patience_ns = (PATIENCE_NS as f64).max(recorder.host_jitter_ns) + 2.0 * period_ns(rate_hz);
            (silence_ns > left_ns + patience_ns && !recorder.ended).then_some((last, rate_hz, left_ns))
        };
        if is_over(self).is_none() {
            return;
        }
        self.settle(out);
        if let Some((last, rate_hz, left_ns)) = is_over(self) {
            let period = period_ns(rate_hz);
            if self.accountant.is_none() {
                self.accept(rate_hz, timebase_of(&last), out);
            }
            let missing = (left_ns / period).round() as u64;
            let to_utc_ns = last.host_utc_ns + (left_ns + period) as i64;
            if let Some(accountant) = &mut self.accountant {
                accountant.close_with_gap(missing, to_utc_ns, &mut self.scratch);
            }
            self.forward(out);
        }
    }

    /// Ends the capture before its time: at its last sample or, if the sensor is absent, with a gap up to now.
    pub fn stop(&mut self, now_mono_ns: u64, now_utc_ns: i64, out: &mut Vec<Record>) {
        self.settle(out);
        if let Some((last, rate_hz, silence_ns)) = self.silence(now_mono_ns, now_utc_ns)
            && !self.ended
        {
            let period = period_ns(rate_hz);
            let away = self.accountant.as_ref().is_none_or(|accountant| accountant.interruption().is_some());
            let missing = (silence_ns / period).floor();
            if missing >= 1.0 && (away || silence_ns > OUTAGE_NS.max(OUTAGE_PERIODS * period).max(self.host_jitter_ns))
            {
                if self.accountant.is_none() {
                    self.accept(rate_hz, timebase_of(&last), out);
                }
                if let Some(accountant) = &mut self.accountant {
                    let to_utc_ns = last.host_utc_ns.saturating_add(silence_ns as i64);
                    accountant.close_with_gap(missing as u64, to_utc_ns, &mut self.scratch);
                }
            }
        }
        self.forward(out);
        if !self.ended {
            self.end(CaptureEnd::Stopped, now_utc_ns);
            self.finish(out);
        }
    }

    /// Returns the last sample, its rate, and the time since that sample, ns. Within one boot of the host its monotonic
    /// clock determines the time; if the last sample is of an earlier boot, only civil time does.
    fn silence(&self, now_mono_ns: u64, now_utc_ns: i64) -> Option<(Position, f64, f64)> {
        let resumed = self.resume.as_ref().and_then(|point| Some((point.last?, point.rate_hz?)));
        // A gap has the rate of the samples before it, not one that was announced since.
        let rate_hz = |accountant: &Accountant| self.rate_hz.unwrap_or(accountant.rate_hz());
        let known = self.accountant.as_ref().and_then(|accountant| Some((accountant.last()?, rate_hz(accountant))));
        let (last, rate_hz) = known.or(resumed)?;
        let silence_ns = match self.counts.last_mono_ns {
            Some(last_mono_ns) => now_mono_ns.saturating_sub(last_mono_ns) as f64,
            None => host_elapsed_ns(&last, now_mono_ns, now_utc_ns),
        };
        Some((last, rate_hz, silence_ns))
    }

    /// Records the samples that the accountant still holds; the capture continues later.
    pub fn pause(&mut self, out: &mut Vec<Record>) {
        self.settle(out);
        self.write_discards(out);
    }

    /// Decides about the samples that the accountant holds: the last one shows how long none has come.
    fn settle(&mut self, out: &mut Vec<Record>) {
        if let Some(accountant) = &mut self.accountant {
            accountant.settle(&mut self.scratch);
        }
        self.forward(out);
    }

    /// Records the measurements that did not become a sample, up to the first measurement that is still held.
    pub fn write_discards(&mut self, out: &mut Vec<Record>) {
        for (cause, count) in std::mem::take(&mut self.discarded) {
            out.push(Record::Discarded { cause, count });
        }
        self.write_frames(self.accountant.as_ref().and_then(Accountant::held_from).unwrap_or(u64::MAX), out);
    }

    /// Records the measurements before `frame` that did not become a sample.
    fn write_frames(&mut self, frame: u64, out: &mut Vec<Record>) {
        while let Some((_, cause, count)) = self.frames.pop_front_if(|(number, ..)| *number < frame) {
            out.push(Record::Discarded { cause, count });
        }
    }

    fn end(&mut self, how: CaptureEnd, utc_ns: i64) {
        self.ended = true;
        self.ending = Some((how, utc_ns));
    }

    /// Records the end, once the samples at hand are sorted.
    fn finish(&mut self, out: &mut Vec<Record>) {
        let Some((how, utc_ns)) = self.ending.take() else { return };
        self.write_discards(out);
        let words = match how {
            CaptureEnd::Complete => "is complete",
            CaptureEnd::Stopped => "was stopped",
        };
        let Counts { samples, missing, gaps, .. } = self.counts;
        out.push(Record::Event(EventRecord {
            utc_ns,
            kind: EventKind::CaptureEnded,
            message: format!(
                "capture `{}` {words}: {}, {missing} missing in {}",
                self.plan.name,
                counted(samples, "sample", "samples"),
                counted(gaps, "gap", "gaps")
            ),
            detail: None,
        }));
        out.push(Record::Ended { how, utc_ns });
    }

    /// Passes on the accountant's records, up to the planned end.
    fn forward(&mut self, out: &mut Vec<Record>) {
        let records = std::mem::take(&mut self.scratch);
        if let Some(accountant) = &mut self.accountant {
            while let (Some(observation), Some(last)) = (accountant.take_observation(), accountant.last()) {
                out.extend(event_of(observation, last.host_utc_ns));
            }
        }
        for (frame, cause) in self.accountant.as_mut().map(Accountant::take_refused).unwrap_or_default() {
            self.drop_frame(frame, cause);
        }
        for record in records {
            // A gap has the rate of the samples before it.
            let Some(rate_hz) = self.rate_hz.or(self.accountant.as_ref().map(Accountant::rate_hz)) else { return };
            let period = period_ns(rate_hz);
            if self.ended {
                // Samples after the end are not part of the capture.
                if let Record::Sample { sample, .. } = &record {
                    self.drop_frame(sample.frame, DiscardCause::AfterEnd);
                }
                continue;
            }
            match record {
                Record::Segment(mut segment) => {
                    segment.boot_id.clone_from(&self.boot_id);
                    if let Some(from_hz) = self.rate_hz.replace(segment.rate_hz).filter(|rate| *rate != segment.rate_hz)
                    {
                        let to_hz = segment.rate_hz;
                        out.push(Record::Event(EventRecord {
                            utc_ns: segment.first_utc_ns,
                            kind: EventKind::Warning,
                            message: format!("the rate changed from {from_hz} to {to_hz} Hz: a new segment begins"),
                            detail: Some(serde_json::json!({"from_hz": from_hz, "to_hz": to_hz})),
                        }));
                    }
                    out.push(Record::Segment(segment));
                }
                Record::Sample { ref sample, .. } => {
                    let utc_ns = sample.host_utc_ns;
                    self.write_frames(sample.frame, out);
                    self.counts.samples += 1;
                    self.counts.elapsed_ns += period;
                    self.counts.gap_open_since_utc_ns = None;
                    out.push(record);
                    self.end_if_full(period, utc_ns);
                }
                Record::Gap(mut gap) => {
                    let left_ns = self.plan.duration_ns as f64 - self.counts.elapsed_ns;
                    let left = (left_ns / period).round().max(0.0) as u64;
                    if gap.missing > left && gap.sample_time_ns(period) > left_ns {
                        gap.to_utc_ns = gap.to_utc_ns.min(gap.from_utc_ns + ((left + 1) as f64 * period) as i64);
                        gap.missing = left;
                        gap.device_ns =
                            gap.device_ns.map(|(from, _)| (from, from + ((left + 1) as f64 * period) as u64));
                    }
                    self.counts.missing += gap.missing;
                    self.counts.gaps += 1;
                    self.counts.elapsed_ns += gap.sample_time_ns(period);
                    let utc_ns = gap.to_utc_ns;
                    out.push(Record::Gap(gap));
                    self.end_if_full(period, utc_ns);
                }
                other => out.push(other),
            }
        }
        self.finish(out);
    }

    fn end_if_full(&mut self, period: f64, utc_ns: i64) {
        if self.counts.elapsed_ns + 0.5 * period > self.plan.duration_ns as f64 {
            self.end(CaptureEnd::Complete, utc_ns);
        }
    }
}

/// Returns the event that reports an observation; `None` if it is none of the sensor's clock.
fn event_of(observation: Observation, utc_ns: i64) -> Option<Record> {
    let (kind, message, detail) = match observation {
        Observation::AfterReset => (EventKind::SensorReset, "the sensor's clock started again".to_owned(), None),
        Observation::ClockAhead(by_ns) => {
            let by_s = by_ns as f64 / 1e9;
            let message = format!("the sensor's clock jumped ahead by {by_s:.3} s: a new epoch begins");
            (EventKind::Warning, message, Some(serde_json::json!({"sensor_clock_ahead_s": by_s})))
        }
        _ => return None,
    };
    Some(Record::Event(EventRecord { utc_ns, kind, message, detail }))
}

/// Returns the timebase of a capture whose last sample is this.
fn timebase_of(last: &Position) -> Timebase {
    match (last.device_time_ns, last.sync_count) {
        (Some(_), _) => Timebase::Device,
        (None, Some(_)) => Timebase::SyncCounter,
        (None, None) => Timebase::Arrival,
    }
}

#[cfg(test)]
mod tests;
