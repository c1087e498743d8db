//! From a recording's items to a capture's records, by the contract's rule (section 3): a gap is a step over 1.5 periods of
//! the median step. No file is touched here.
//!
//! With stamps a gap's `missing` is round(step/period) − 1 and exact. A rejected line with a stamp is one missing sample at
//! that stamp, with the cause `checksum` where it failed it: steps are counted from stamp to stamp, so that a hole beside a
//! rejected line stays a gap of its own, of the source's. Without stamps nothing can be known to be missing but what was
//! rejected: each rejected line that stands for a sample is one missing sample, not exact, since a spliced line may hold
//! parts of several.
//!
//! The identity: samples + missing = 1 + Σ max(1, round(step/period)) over the steps from stamp to stamp.

use super::between::Between;
use super::info::RecordingInfo;
use super::{GAP_PERIODS, Item, REJECTED_KEPT, Rejected};
use crate::sample::{
    ChannelSet, DiscardCause, EventKind, EventRecord, Gap, GapCause, Record, Sample, Segment, Timebase,
};
use crate::units::period_ns;

/// Counts what a recording has and what it lacks.
#[derive(Debug, Clone)]
pub struct RecordingAccountant {
    rate_hz: f64,
    timebase: Timebase,
    channels: ChannelSet,
    started_utc_ns: i64,
    /// Device time and UTC of the last sample.
    last: Option<(Option<u64>, i64)>,
    segment_open: bool,
    segments: u32,
    received: u64,
    /// Valid measurements so far, those that did not become a sample included.
    frames: u64,
    missing: u64,
    gaps: u64,
    /// Rejected lines since the last sample that stand for a sample.
    between: Between,
    /// What one entry of the recording is called.
    entry: &'static str,
    events: usize,
}

impl RecordingAccountant {
    /// An accountant of a recording of which nothing was read yet.
    #[must_use]
    pub fn new(info: &RecordingInfo) -> Self {
        Self {
            rate_hz: info.rate_hz,
            timebase: info.timebase(),
            channels: info.channels,
            started_utc_ns: info.started_utc_ns,
            last: None,
            segment_open: false,
            segments: 0,
            received: 0,
            frames: 0,
            missing: 0,
            gaps: 0,
            between: Between::default(),
            entry: info.kind.entry(),
            events: 0,
        }
    }

    /// Samples so far.
    #[must_use]
    pub fn received(&self) -> u64 {
        self.received
    }
    /// Missing samples so far.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.missing
    }
    /// Gaps so far.
    #[must_use]
    pub fn gaps(&self) -> u64 {
        self.gaps
    }
    /// UTC of the last sample, ns; of the start before it.
    #[must_use]
    pub fn last_utc_ns(&self) -> i64 {
        self.last.map_or(self.started_utc_ns, |(_, utc_ns)| utc_ns)
    }

    /// Takes the next item; what it means for the capture is appended to `out`.
    pub fn take(&mut self, item: Item, out: &mut Vec<Record>) {
        match item {
            Item::Sample(mut sample) => {
                self.frames += 1;
                sample.frame = self.frames;
                self.take_sample(sample, out);
            }
            Item::Rejected(rejected) => self.take_rejected(rejected, out),
        }
    }

    fn take_rejected(&mut self, rejected: Rejected, out: &mut Vec<Record>) {
        if rejected.cause.is_frame() {
            self.frames += rejected.amount();
        }
        if rejected.stands_for_sample && self.last.is_some() {
            let stamp_ns = rejected.at.and_then(|(device_ns, _)| i64::try_from(device_ns).ok());
            self.between.add(stamp_ns, rejected.cause == DiscardCause::Checksum);
        }
        out.push(Record::Discarded { cause: rejected.cause, count: rejected.amount() });
        if self.events < REJECTED_KEPT {
            self.events += 1;
            out.push(Record::Event(EventRecord {
                utc_ns: rejected.at.map_or_else(|| self.last_utc_ns(), |(_, utc_ns)| utc_ns),
                kind: EventKind::Rejected,
                message: format!("{} {} was rejected: {}", self.entry, rejected.line, rejected.cause.name()),
                detail: Some(serde_json::json!({
                    self.entry: rejected.line,
                    "cause": rejected.cause.name(),
                    "text": rejected.text,
                })),
            }));
        }
    }

    fn take_sample(&mut self, sample: Sample, out: &mut Vec<Record>) {
        if let Some(last) = self.last {
            let before = out.len();
            self.gaps_before(last, &sample, out);
            if out.len() > before {
                self.segment_open = false;
            }
        }
        self.between.clear();
        if !self.segment_open {
            self.segment_open = true;
            self.segments += 1;
            out.push(Record::Segment(Segment {
                number: self.segments,
                epoch: 1,
                first_seq: self.received,
                rate_hz: self.rate_hz,
                timebase: self.timebase,
                channels: self.channels,
                first_device_time_ns: sample.device_time_ns,
                first_utc_ns: sample.host_utc_ns,
                boot_id: None,
            }));
        }
        self.last = Some((sample.device_time_ns, sample.host_utc_ns));
        out.push(Record::Sample { seq: self.received, segment: self.segments, sample });
        self.received += 1;
    }

    /// The gaps between the sample before, of this device time and UTC, and this one.
    fn gaps_before(&mut self, (device_ns, utc_ns): (Option<u64>, i64), sample: &Sample, out: &mut Vec<Record>) {
        let (Some(device_ns), Some(now_ns)) = (device_ns, sample.device_time_ns) else {
            let missing = self.between.count();
            if missing > 0 {
                let cause = if self.between.any_checksum() { GapCause::Checksum } else { GapCause::Source };
                self.push_gap((utc_ns, sample.host_utc_ns), None, (missing, false), cause, out);
            }
            return;
        };
        let between = std::mem::take(&mut self.between);
        let (mut between, from_ns, to_ns) = (between, device_ns as i64, now_ns as i64);
        between.settle(from_ns, to_ns);
        let source = if between.unplaced_checksum { GapCause::Checksum } else { GapCause::Source };
        let period_ns = period_ns(self.rate_hz);
        let gap = |from: i64, to: i64, missing, cause| {
            let utc = |stamp_ns: i64| utc_ns.saturating_add(stamp_ns - from_ns);
            ((utc(from), utc(to)), Some((from as u64, to as u64)), (missing, true), cause)
        };
        let mut gaps = Vec::new();
        // A run of rejected lines since the last hole: where it begins, how many, whether one failed its checksum.
        let (mut run_from_ns, mut run, mut run_checksum) = (from_ns, 0, false);
        let run_cause = |checksum| if checksum { GapCause::Checksum } else { GapCause::Source };
        let mut last_ns = from_ns;
        for instant in between.instants(to_ns) {
            let periods = (instant.stamp_ns - last_ns) as f64 / period_ns;
            if periods > GAP_PERIODS {
                if run > 0 {
                    gaps.push(gap(run_from_ns, last_ns, run, run_cause(run_checksum)));
                }
                gaps.push(gap(last_ns, instant.stamp_ns, periods.round() as u64 - 1, source));
                (run_from_ns, run, run_checksum) = (instant.stamp_ns, 0, false);
            }
            if let Some(checksum) = instant.rejected {
                run += 1;
                run_checksum |= checksum;
            }
            last_ns = instant.stamp_ns;
        }
        if run > 0 {
            gaps.push(gap(run_from_ns, to_ns, run, run_cause(run_checksum)));
        }
        for (utc, device, missing, cause) in gaps {
            self.push_gap(utc, device, missing, cause, out);
        }
        self.between = between;
    }

    fn push_gap(
        &mut self,
        (from_utc_ns, to_utc_ns): (i64, i64),
        device_ns: Option<(u64, u64)>,
        (missing, missing_exact): (u64, bool),
        cause: GapCause,
        out: &mut Vec<Record>,
    ) {
        self.missing += missing;
        self.gaps += 1;
        let before_seq = self.received;
        out.push(Record::Gap(Gap { before_seq, from_utc_ns, to_utc_ns, device_ns, missing, missing_exact, cause }));
    }
}
