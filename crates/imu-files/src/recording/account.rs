//! Converts a recording's items to a capture's records by the rule of docs/formats.md: a gap is a grid point without a
//! sample. No file is touched here.
//!
//! With stamps the grid determines how many samples are missing before each one ([`super::grid`]). A rejected line with
//! a stamp takes the grid point nearest to it, with the cause `checksum` if its checksum failed. A hole beside a
//! rejected line thus stays a separate gap, caused by the source. Without stamps only rejected samples are known to be
//! missing. Each rejected line that stands for a sample is one missing sample, not exact, since a spliced line may hold
//! parts of several.
//!
//! The identity: (samples + missing) periods = last stamp − first stamp + one period, to the jitter of these stamps.

use super::between::Between;
use super::grid::StampGrid;
use super::info::RecordingInfo;
use super::{Item, REJECTED_KEPT, Rejected};
use imu_core::sample::{
    ChannelSet, DiscardCause, EventKind, EventRecord, Gap, GapCause, Record, Sample, Segment, Timebase,
};

/// Counts the samples and the missing samples of a recording.
#[derive(Debug, Clone, Default)]
pub struct RecordingAccountant {
    rate_hz: f64,
    timebase: Timebase,
    channels: ChannelSet,
    started_utc_ns: i64,
    /// Whether stamps determine the number of missing samples exactly.
    exact: bool,
    /// Device time and UTC of the last sample.
    last: Option<(Option<u64>, i64)>,
    segment_open: bool,
    segments: u32,
    received: u64,
    /// Valid measurements so far, including those that did not become a sample.
    frames: u64,
    missing: u64,
    gaps: u64,
    /// Rejected lines since the last sample that stand for a sample.
    between: Between,
    /// The name of one entry of the recording.
    entry: &'static str,
    events: usize,
}

impl RecordingAccountant {
    /// Creates an accountant of a recording of which nothing has been read yet.
    pub fn new(info: &RecordingInfo) -> Self {
        Self {
            rate_hz: info.rate_hz,
            timebase: info.timebase(),
            channels: info.channels,
            started_utc_ns: info.started_utc_ns,
            exact: info.stamp_grid.as_ref().is_some_and(StampGrid::is_exact) && info.findings.off_grid == 0,
            entry: info.kind.entry(),
            ..Self::default()
        }
    }

    /// Returns the number of samples so far.
    pub fn received(&self) -> u64 {
        self.received
    }
    /// Returns the number of missing samples so far.
    pub fn missing(&self) -> u64 {
        self.missing
    }
    /// Returns the number of gaps so far.
    pub fn gaps(&self) -> u64 {
        self.gaps
    }
    /// Returns UTC of the last sample, ns; of the start if there is no sample yet.
    pub fn last_utc_ns(&self) -> i64 {
        self.last.map_or(self.started_utc_ns, |(_, utc_ns)| utc_ns)
    }

    /// Takes the next item and appends the resulting records of the capture to `out`.
    pub fn take(&mut self, item: Item, out: &mut Vec<Record>) {
        match item {
            Item::Sample(mut sample, missing) => {
                self.frames += 1;
                sample.frame = self.frames;
                self.take_sample(sample, missing, out);
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

    fn take_sample(&mut self, sample: Sample, missing: Option<u64>, out: &mut Vec<Record>) {
        if let Some(last) = self.last {
            let before = out.len();
            self.gaps_before(last, &sample, missing, out);
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

    /// Returns the gaps between the sample before, with this device time and UTC, and this one, before which `missing`
    /// samples are missing.
    fn gaps_before(
        &mut self,
        (device_ns, utc_ns): (Option<u64>, i64),
        sample: &Sample,
        missing: Option<u64>,
        out: &mut Vec<Record>,
    ) {
        let (Some(missing), Some(device_ns), Some(now_ns)) = (missing, device_ns, sample.device_time_ns) else {
            let missing = self.between.count();
            if missing > 0 {
                let cause = if self.between.any_checksum() { GapCause::Checksum } else { GapCause::Source };
                self.push_gap((utc_ns, sample.host_utc_ns), None, (missing, false), cause, out);
            }
            return;
        };
        if missing == 0 {
            return;
        }
        let mut between = std::mem::take(&mut self.between);
        let (from_ns, to_ns) = (device_ns as i64, now_ns as i64);
        between.settle(from_ns, to_ns);
        let source = if between.unplaced_checksum { GapCause::Checksum } else { GapCause::Source };
        let step_ns = (to_ns - from_ns) as f64 / (missing + 1) as f64;
        let at_ns = |point: u64| from_ns + (point as f64 * step_ns).round() as i64;
        // Points 1 to `missing` have no sample; a rejected line takes the free one nearest to its stamp.
        let mut pieces: Vec<(u64, u64, GapCause, bool)> = Vec::new();
        let mut next = 1;
        for instant in between.instants(to_ns) {
            let Some(checksum) = instant.rejected else { break };
            let point = ((instant.stamp_ns - from_ns) as f64 / step_ns).round() as u64;
            let point = point.max(next);
            if point > missing {
                break;
            }
            if point > next {
                pieces.push((next, point, source, false));
            }
            let cause = if checksum { GapCause::Checksum } else { GapCause::Source };
            match pieces.last_mut() {
                // Rejected lines side by side are one gap.
                Some((_, end, joined, true)) if *end == point => {
                    *end = point + 1;
                    if checksum {
                        *joined = GapCause::Checksum;
                    }
                }
                _ => pieces.push((point, point + 1, cause, true)),
            }
            next = point + 1;
        }
        if next <= missing {
            pieces.push((next, missing + 1, source, false));
        }
        for (begin, end, cause, _) in pieces {
            // From the point before to the one behind: of the samples, or of rejected lines.
            let (from, to) = (at_ns(begin - 1), at_ns(end));
            let utc = |stamp_ns: i64| utc_ns.saturating_add(stamp_ns - from_ns);
            let device_ns = Some((from as u64, to as u64));
            self.push_gap((utc(from), utc(to)), device_ns, (end - begin, self.exact), cause, out);
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
