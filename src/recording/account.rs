//! From a recording's items to a capture's records, by the contract's rule (section 3): a gap is a step over 1.5 periods of
//! the median step. No file is touched here.
//!
//! With stamps a gap's `missing` is round(step/period) − 1 and exact. Without stamps nothing can be known to be missing but
//! what was rejected: each rejected line that stands for a sample is one missing sample, not exact, since a spliced line
//! may hold parts of several. A gap in which lines failed their checksum has that cause, any other is the source's.

use super::info::RecordingInfo;
use super::{Item, REJECTED_KEPT, Rejected};
use crate::sample::{
    ChannelSet, DiscardCause, EventKind, EventRecord, Gap, GapCause, Record, Sample, Segment, Timebase,
};
use crate::units::period_ns;

/// A step over this many periods is a gap (contract, section 3).
const GAP_PERIODS: f64 = 1.5;

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
    missing: u64,
    gaps: u64,
    /// Rejected lines since the last sample that stand for a sample.
    rejected_since: u64,
    /// One of them failed its checksum.
    checksum_since: bool,
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
            missing: 0,
            gaps: 0,
            rejected_since: 0,
            checksum_since: false,
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
            Item::Sample(sample) => self.take_sample(sample, out),
            Item::Rejected(rejected) => self.take_rejected(rejected, out),
        }
    }

    fn take_rejected(&mut self, rejected: Rejected, out: &mut Vec<Record>) {
        let counts = rejected.stands_for_sample && self.last.is_some();
        self.rejected_since += u64::from(counts);
        self.checksum_since |= counts && rejected.cause == DiscardCause::Checksum;
        out.push(Record::Discarded { cause: rejected.cause, count: rejected.amount() });
        if self.events < REJECTED_KEPT {
            self.events += 1;
            out.push(Record::Event(EventRecord {
                utc_ns: self.last_utc_ns(),
                kind: EventKind::Rejected,
                message: format!("line {} was rejected: {}", rejected.line, rejected.cause.name()),
                detail: Some(serde_json::json!({
                    "line": rejected.line,
                    "cause": rejected.cause.name(),
                    "text": rejected.text,
                })),
            }));
        }
    }

    fn take_sample(&mut self, sample: Sample, out: &mut Vec<Record>) {
        if let Some((device_ns, utc_ns)) = self.last {
            let (missing, exact) = self.missing_before(device_ns, &sample);
            if missing > 0 {
                self.missing += missing;
                self.gaps += 1;
                self.segment_open = false;
                out.push(Record::Gap(Gap {
                    before_seq: self.received,
                    from_utc_ns: utc_ns,
                    to_utc_ns: sample.host_utc_ns,
                    device_ns: device_ns.zip(sample.device_time_ns),
                    missing,
                    missing_exact: exact,
                    cause: if self.checksum_since { GapCause::Checksum } else { GapCause::Source },
                }));
            }
        }
        (self.rejected_since, self.checksum_since) = (0, false);
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
            }));
        }
        self.last = Some((sample.device_time_ns, sample.host_utc_ns));
        out.push(Record::Sample { seq: self.received, segment: self.segments, sample });
        self.received += 1;
    }

    /// How many samples are missing before `sample`, and whether the stamps say so.
    fn missing_before(&self, last_device_ns: Option<u64>, sample: &Sample) -> (u64, bool) {
        match (last_device_ns, sample.device_time_ns) {
            (Some(last), Some(now)) => {
                let steps = now.saturating_sub(last) as f64 / period_ns(self.rate_hz);
                (if steps > GAP_PERIODS { steps.round() as u64 - 1 } else { 0 }, true)
            }
            _ => (self.rejected_since, false),
        }
    }
}
