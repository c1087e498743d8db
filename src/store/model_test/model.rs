//! The model: the content that the store must hold, as plain lists, and the possible remains of a file after a power
//! loss. It touches no disk.

use crate::store::JobState;
use crate::store::tests::{gap, sample, segment};
use imu_core::sample::record::CaptureEnd;
use imu_core::sample::{DiscardCause, Record};
use rand::RngExt;
use std::collections::BTreeMap;

/// The sensor's time from one sample to the next.
const PERIOD_NS: u64 = 25_000_000;

/// A capture with the samples that were sent. The samples' values follow from their numbers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Capture {
    pub(super) samples: u64,
    pub(super) segments: Vec<u64>,
    pub(super) gaps: Vec<(u64, u64)>,
    pub(super) discarded: u64,
    pub(super) ended: bool,
}

impl Capture {
    pub(super) fn apply(&mut self, record: &Record) {
        match record {
            Record::Segment(segment) => self.segments.push(segment.first_seq),
            Record::Sample { .. } => self.samples += 1,
            Record::Gap(gap) => self.gaps.push((gap.before_seq, gap.missing)),
            Record::Discarded { count, .. } => self.discarded += count,
            Record::Ended { .. } => self.ended = true,
            other => panic!("{other:?}"),
        }
    }

    /// Returns the records that come next: a gap of `missing` samples or none, then samples, then duplicates.
    pub(super) fn next(&self, missing: u64, samples: u64, duplicates: u64) -> Vec<Record> {
        let mut records = Vec::new();
        let mut number = self.segments.len() as u32;
        let mut late_ns = PERIOD_NS * self.gaps.iter().map(|(_, missing)| missing).sum::<u64>();
        if missing > 0 && self.samples > 0 {
            let mut record = gap(self.samples, missing);
            if let Record::Gap(gap) = &mut record {
                gap.device_ns = gap.device_ns.map(|(from, to)| (from + late_ns, to + late_ns));
            }
            records.push(record);
            late_ns += PERIOD_NS * missing;
        }
        if number == 0 || !records.is_empty() {
            number += 1;
            let mut record = segment(number, self.samples);
            if let Record::Segment(segment) = &mut record {
                segment.first_device_time_ns = segment.first_device_time_ns.map(|ns| ns + late_ns);
                segment.first_utc_ns += late_ns as i64;
            }
            records.push(record);
        }
        for nth in 0..samples {
            let mut record = sample(number, self.samples + nth);
            if let Record::Sample { sample, .. } = &mut record {
                sample.device_time_ns = sample.device_time_ns.map(|ns| ns + late_ns);
                sample.host_mono_ns += late_ns;
                sample.host_utc_ns += late_ns as i64;
                sample.frame = self.samples + self.discarded + nth + 1;
            }
            records.push(record);
        }
        if duplicates > 0 {
            records.push(Record::Discarded { cause: DiscardCause::Duplicate, count: duplicates });
        }
        records
    }

    pub(super) fn end(&self) -> Record {
        Record::Ended { how: CaptureEnd::Complete, utc_ns: 1_900_000_000_000_000_000 }
    }
}

/// The content that a reader sees: the visible captures, and the jobs over them with their state and their checkpoint.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Content {
    pub(super) captures: BTreeMap<i64, Capture>,
    pub(super) jobs: BTreeMap<i64, (i64, JobState, Option<Vec<u8>>)>,
}

impl Content {
    /// Returns the content after a start: no job is being worked on.
    pub(super) fn after_start(mut self) -> Self {
        self.jobs.values_mut().filter(|job| job.1 == JobState::Running).for_each(|job| job.1 = JobState::Queued);
        self
    }

    pub(super) fn running(&self) -> Option<i64> {
        self.jobs.iter().find(|(_, job)| job.1 == JobState::Running).map(|(id, _)| *id)
    }
}

/// The files on the disk.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Files {
    pub(super) database: Vec<u8>,
    pub(super) log: Vec<u8>,
    pub(super) lock: Vec<u8>,
}

/// Bytes of the header of SQLite's log, which is synced before what follows it.
const HEADER: usize = 32;
const PAGE: usize = 4096;

/// An instant between two states of the disk at which the power may fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Instant {
    /// The log restarts, and only half of its header is written.
    Header,
    /// The log is being written, and not yet synced.
    Log,
    /// The log is synced and is being copied into the file.
    Copy,
    /// The step is complete.
    Done,
}

impl Files {
    /// Returns the instants between `self`, which is synced, and `after` at which the power may fail. With `one`, no
    /// more than one transaction lies between them: only then is the order known in which log and file were written.
    pub(super) fn instants(&self, after: &Self, one: bool) -> Vec<Instant> {
        let mut instants = vec![Instant::Done];
        let (file, log) = (self.database != after.database, self.log != after.log);
        let grown = log && after.log.len() >= self.log.len();
        if grown && (one || !file) {
            instants.push(Instant::Log);
            if self.log.len() >= HEADER && self.log[..HEADER] != after.log[..HEADER] {
                instants.push(Instant::Header);
            }
        }
        if file && one && (grown || !log) {
            instants.push(Instant::Copy);
        }
        instants
    }

    /// Returns the remains of a power loss at that instant. The pages that were not synced are any mix of before,
    /// after, halves and garbage.
    pub(super) fn lost(&self, after: &Self, at: Instant, random: &mut impl RngExt) -> Self {
        match at {
            Instant::Header => {
                let mut image = self.clone();
                image.log[..HEADER / 2].copy_from_slice(&after.log[..HEADER / 2]);
                image
            }
            Instant::Log => {
                let mut log = mixed(&self.log, &after.log, random);
                let header = HEADER.min(log.len());
                log[..header].copy_from_slice(&after.log[..header]);
                Self { log, ..self.clone() }
            }
            Instant::Copy => Self { database: mixed(&self.database, &after.database, random), ..after.clone() },
            Instant::Done => after.clone(),
        }
    }
}

fn mixed(before: &[u8], after: &[u8], random: &mut impl RngExt) -> Vec<u8> {
    // Either the writes came in order up to some byte, or the pages reached the disk in any order.
    let kind = random.random_range(0..6_u32).saturating_sub(2);
    let same = before.iter().zip(after).take_while(|(old, new)| old == new).count();
    let cut = random.random_range(same..=after.len());
    let length = after.len().max(before.len());
    let old = |at: usize| before.get(at).copied().unwrap_or(0);
    let new = |at: usize| after.get(at).copied().unwrap_or_else(|| old(at));
    let mut image: Vec<u8> = (0..length).map(new).collect();
    for (page, bytes) in image.chunks_mut(PAGE).enumerate() {
        let fate = random.random_range(0..4);
        for (offset, byte) in bytes.iter_mut().enumerate() {
            let at = page * PAGE + offset;
            let written = if kind == 0 { at < cut } else { fate == 0 || fate == 1 && offset < PAGE / 2 };
            if !written && (old(at) != new(at) || at >= before.len()) {
                *byte = if kind == 3 && fate == 2 { random.random() } else { old(at) };
            }
        }
    }
    if kind == 1 && after.len() > before.len() {
        image.truncate(random.random_range(before.len()..=after.len()));
    }
    image
}
