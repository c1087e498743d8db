//! Audit: whether a capture's numbers agree with each other and with the sensor's own ticks. Pure.
//!
//! Two identities, each of numbers that were counted apart from each other:
//!
//! 1. `received = committed + in flight + discarded`. `received` is counted where valid measurements leave the decoder,
//!    before anything decides about them; `committed` are rows; `in flight` is what is held or waits for its commit;
//!    `discarded` are valid measurements that did not become a sample, by cause ([`super::DiscardCause::is_frame`]).
//! 2. `expected = committed + Σ gap.missing`. `expected` follows from the first and the last tick of each stretch: the
//!    segments of one epoch with one rate and one timebase. Between stretches (a reset, another rate, another format) and
//!    behind the last sample only host time tells what is missing, and arrival times tell nothing that could be checked
//!    against: both enter `expected` as they were recorded, and [`Report::unchecked`] says how many and why.
//!
//! The definition is in one place: [`audit`]. The store feeds it from one snapshot of the database, tests from memory.

use super::Timebase;
use crate::units::period_ns;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A list of stretches in a report has at most this many entries; those that do not hold come first.
pub const STRETCHES_SHOWN: usize = 100;

/// A segment, as far as the audit needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentFacts {
    /// Number within the capture, from 1.
    pub number: u32,
    /// One run of the sensor's clock.
    pub epoch: u32,
    /// `seq` of its first sample.
    pub first_seq: u64,
    /// Samples that it has.
    pub samples: u64,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// What its times rest on.
    pub timebase: Timebase,
    /// The sensor's tick at its first and at its last sample: device time in ns ([`Timebase::Device`]) or the serial count
    /// ([`Timebase::SyncCounter`]).
    pub ticks: Option<(u64, u64)>,
}

/// A gap, as far as the audit needs it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GapFacts {
    /// `seq` of the first sample after it.
    pub before_seq: u64,
    /// Samples missing.
    pub missing: u64,
}

/// What was counted.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CountFacts {
    /// Valid measurements that left the decoder while the capture was on; `None` where nobody counted them.
    pub received: Option<u64>,
    /// Rows of table `sample`.
    pub committed: u64,
    /// Samples that are held or wait for their commit.
    pub in_flight: i64,
    /// Valid measurements that did not become a sample, by cause.
    pub discarded: BTreeMap<String, u64>,
    /// The capture's own counters of samples, missing samples, gaps and segments.
    pub counters: [u64; 4],
}

/// One run of the sensor's clock at one rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Stretch {
    /// One run of the sensor's clock, from 1.
    pub epoch: u32,
    /// Its first segment.
    pub first_segment: u32,
    /// Its last segment.
    pub last_segment: u32,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// What its times rest on.
    pub timebase: Timebase,
    /// Samples it has.
    pub samples: u64,
    /// Missing samples in the gaps inside it.
    pub missing: u64,
    /// Samples that its first and last tick ask for; null where its times are no ticks.
    pub expected: Option<u64>,
    /// `expected` − `samples` − `missing`: 0.
    pub difference: i64,
}

/// What cannot be checked against ticks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Unchecked {
    /// Why.
    pub reason: String,
    /// Samples that it concerns.
    pub samples: u64,
    /// Missing samples that it concerns.
    pub missing: u64,
}

/// Both identities of one capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Report {
    /// Whether every number agrees.
    pub holds: bool,
    /// Valid measurements that left the decoder; null for a capture of a version that did not count them.
    pub received: Option<u64>,
    /// Samples on disk.
    pub committed: u64,
    /// Samples that are held or wait for their commit; 0 for a capture that does not run.
    pub in_flight: i64,
    /// Valid measurements that did not become a sample, by cause.
    pub discarded: BTreeMap<String, u64>,
    /// `received` − `committed` − `in_flight` − `discarded`: 0.
    pub received_difference: i64,
    /// Samples that the sensor's ticks ask for, as of the last commit; across epochs and without ticks as recorded.
    pub expected: u64,
    /// Samples missing, as of the last commit.
    pub missing: u64,
    /// `expected` − samples − `missing`, as of the last commit: 0.
    pub expected_difference: i64,
    /// Runs of the sensor's clock at one rate, those that do not hold first; at most 100 are listed.
    pub stretches: Vec<Stretch>,
    /// How many are not listed.
    pub stretches_omitted: u64,
    /// What could not be checked against ticks, and why.
    pub unchecked: Vec<Unchecked>,
    /// What disagrees, one sentence each.
    pub violations: Vec<String>,
}

impl Report {
    /// The same capture while it runs: the first identity as of the instant at which `received` measurements had come in,
    /// `committed` of them were on disk and `in_flight` on their way there.
    #[must_use]
    pub fn at_this_instant(
        self,
        received: u64,
        committed: u64,
        in_flight: i64,
        discarded: BTreeMap<String, u64>,
    ) -> Self {
        let mut violations = self.violations;
        let received_difference = first_identity(Some(received), committed, in_flight, &discarded, &mut violations);
        Self {
            holds: violations.is_empty(),
            received: Some(received),
            committed,
            in_flight,
            discarded,
            received_difference,
            violations,
            ..self
        }
    }
}

/// `received` − `committed` − `in_flight` − `discarded`; what is wrong with it is said.
fn first_identity(
    received: Option<u64>,
    committed: u64,
    in_flight: i64,
    discarded: &BTreeMap<String, u64>,
    violations: &mut Vec<String>,
) -> i64 {
    if in_flight < 0 {
        violations.push(format!("{in_flight} samples are in flight"));
    }
    let Some(received) = received else { return 0 };
    let discarded: u64 = discarded.values().sum();
    let difference = received as i64 - committed as i64 - in_flight - discarded as i64;
    if difference != 0 {
        violations.push(format!(
            "{received} measurements were received, but {committed} are committed, {in_flight} in flight and {discarded} discarded: {difference} are unaccounted for"
        ));
    }
    difference
}

/// Checks a capture. `segments` and `gaps` are in their order.
#[must_use]
pub fn audit(segments: &[SegmentFacts], gaps: &[GapFacts], counts: CountFacts) -> Report {
    let mut violations = Vec::new();
    let mut unchecked: BTreeMap<&'static str, (u64, u64)> = BTreeMap::new();
    let mut stretches = stretches(segments);
    let mut between: u64 = 0;
    for gap in gaps {
        let home = stretches.partition_point(|(first_seq, _)| *first_seq < gap.before_seq);
        let inside = home
            .checked_sub(1)
            .and_then(|index| stretches.get_mut(index))
            .filter(|(first_seq, stretch)| gap.before_seq > *first_seq && gap.before_seq < first_seq + stretch.samples);
        match inside {
            Some((_, stretch)) => stretch.missing += gap.missing,
            None => {
                between += gap.missing;
                unchecked.entry(BETWEEN).or_default().1 += gap.missing;
            }
        }
    }
    let (mut samples, mut missing, mut expected) = (0, between, between);
    for (_, stretch) in &mut stretches {
        samples += stretch.samples;
        missing += stretch.missing;
        let had = stretch.samples + stretch.missing;
        expected += stretch.expected.unwrap_or(had);
        match stretch.expected {
            Some(asked) => {
                stretch.difference = difference(asked, had);
                if asked != had {
                    violations.push(format!(
                        "epoch {} at {} Hz (segments {} to {}): its ticks ask for {asked} samples, {} are there and {} missing",
                        stretch.epoch,
                        stretch.rate_hz,
                        stretch.first_segment,
                        stretch.last_segment,
                        stretch.samples,
                        stretch.missing
                    ));
                }
            }
            None => {
                let entry = unchecked.entry(why_unchecked(stretch.timebase)).or_default();
                entry.0 += stretch.samples;
                entry.1 += stretch.missing;
            }
        }
    }
    let received_difference =
        first_identity(counts.received, counts.committed, counts.in_flight, &counts.discarded, &mut violations);
    if counts.received.is_none() {
        unchecked.entry(NOT_COUNTED).or_default().0 += counts.committed;
    }
    if counts.committed != samples {
        violations.push(format!("{} rows are there, the segments say {samples}", counts.committed));
    }
    let expected_difference = difference(expected, samples + missing);
    let [counted_samples, counted_missing, counted_gaps, counted_segments] = counts.counters;
    for (what, counted, found) in [
        ("samples", counted_samples, samples),
        ("missing samples", counted_missing, missing),
        ("gaps", counted_gaps, gaps.len() as u64),
        ("segments", counted_segments, segments.len() as u64),
    ] {
        if counted != found {
            violations.push(format!("the capture counts {counted} {what}, its rows say {found}"));
        }
    }
    let mut next_seq = 0;
    for segment in segments {
        if segment.first_seq != next_seq {
            violations.push(format!(
                "segment {} begins at sample {}, the one before ends at {next_seq}",
                segment.number, segment.first_seq
            ));
        }
        next_seq = segment.first_seq + segment.samples;
    }
    let all = stretches.len();
    let mut stretches: Vec<Stretch> = stretches.into_iter().map(|(_, stretch)| stretch).collect();
    stretches.sort_by_key(|stretch| stretch.difference == 0);
    stretches.truncate(STRETCHES_SHOWN);
    Report {
        holds: violations.is_empty(),
        received: counts.received,
        committed: counts.committed,
        in_flight: counts.in_flight,
        discarded: counts.discarded,
        received_difference,
        expected,
        missing,
        expected_difference,
        stretches_omitted: (all - stretches.len()) as u64,
        stretches,
        unchecked: unchecked
            .into_iter()
            .filter(|(_, (samples, missing))| samples + missing > 0)
            .map(|(reason, (samples, missing))| Unchecked { reason: reason.to_owned(), samples, missing })
            .collect(),
        violations,
    }
}

const BETWEEN: &str = "between two runs of the sensor's clock, two rates or formats, or behind the last sample: \
    measured by the host's clock";
const NOT_COUNTED: &str = "recorded by a version that did not count what was received";

fn why_unchecked(timebase: Timebase) -> &'static str {
    match timebase {
        Timebase::Arrival => "messages without time: what is missing follows from their arrival",
        Timebase::Stamps => "an imported recording's stamps: their steps are not the sensor's ticks",
        Timebase::Rate => "an imported recording without stamps",
        Timebase::Device | Timebase::SyncCounter => "samples without the sensor's tick",
    }
}

/// Segments of one epoch, rate and timebase that follow each other, each with the `seq` it begins at.
fn stretches(segments: &[SegmentFacts]) -> Vec<(u64, Stretch)> {
    let same = |one: &SegmentFacts, next: &SegmentFacts| {
        (one.epoch, one.timebase) == (next.epoch, next.timebase) && one.rate_hz == next.rate_hz
    };
    let filled: Vec<&SegmentFacts> = segments.iter().filter(|segment| segment.samples > 0).collect();
    filled
        .chunk_by(|one, next| same(one, next))
        .filter_map(|part| {
            let (first, last) = (part.first()?, part.last()?);
            let expected = first.ticks.zip(last.ticks).and_then(|((from, _), (_, to))| match first.timebase {
                Timebase::Device => Some((to.wrapping_sub(from) as f64 / period_ns(first.rate_hz)).round() as u64 + 1),
                // The counter has 32 bits; it steps once for each message.
                Timebase::SyncCounter => Some((to.wrapping_sub(from) & u64::from(u32::MAX)) + 1),
                Timebase::Arrival | Timebase::Stamps | Timebase::Rate => None,
            });
            let stretch = Stretch {
                epoch: first.epoch,
                first_segment: first.number,
                last_segment: last.number,
                rate_hz: first.rate_hz,
                timebase: first.timebase,
                samples: part.iter().map(|segment| segment.samples).sum(),
                missing: 0,
                expected,
                difference: 0,
            };
            Some((first.first_seq, stretch))
        })
        .collect()
}

fn difference(one: u64, other: u64) -> i64 {
    one.wrapping_sub(other) as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 25_000_000;

    fn segment(number: u32, epoch: u32, first_seq: u64, samples: u64, from_tick: u64) -> SegmentFacts {
        SegmentFacts {
            number,
            epoch,
            first_seq,
            samples,
            rate_hz: 40.0,
            timebase: Timebase::Device,
            ticks: Some((from_tick * PERIOD_NS, (from_tick + samples - 1) * PERIOD_NS)),
        }
    }

    fn counts(committed: u64, missing: u64, gaps: u64, segments: u64) -> CountFacts {
        CountFacts {
            received: Some(committed),
            committed,
            counters: [committed, missing, gaps, segments],
            ..CountFacts::default()
        }
    }

    #[test]
    fn what_is_there_and_what_is_missing_make_what_the_ticks_ask_for() {
        let segments = [segment(1, 1, 0, 10, 100), segment(2, 1, 10, 5, 113), segment(3, 2, 15, 5, 0)];
        let gaps = [GapFacts { before_seq: 10, missing: 3 }, GapFacts { before_seq: 15, missing: 40 }];
        let report = audit(&segments, &gaps, counts(20, 43, 2, 3));
        assert!(report.holds, "{:?}", report.violations);
        assert_eq!((report.expected, report.missing), (63, 43));
        assert_eq!(report.stretches.len(), 2);
        assert_eq!(report.stretches[0].expected, Some(18));
        assert_eq!((report.unchecked.len(), report.unchecked[0].missing), (1, 40));
    }

    #[test]
    fn a_gap_that_counts_too_little_is_found_by_the_ticks() {
        let segments = [segment(1, 1, 0, 10, 100), segment(2, 1, 10, 5, 113)];
        let report = audit(&segments, &[GapFacts { before_seq: 10, missing: 2 }], counts(15, 2, 1, 2));
        assert!(!report.holds);
        assert_eq!((report.expected_difference, report.stretches[0].difference), (1, 1));
    }

    #[test]
    fn a_measurement_that_went_nowhere_is_found() {
        let segments = [segment(1, 1, 0, 10, 0)];
        let mut facts = counts(10, 0, 0, 1);
        facts.received = Some(14);
        facts.in_flight = 1;
        facts.discarded = [("duplicate".to_owned(), 2)].into();
        let report = audit(&segments, &[], facts.clone());
        assert_eq!((report.holds, report.received_difference), (false, 1));
        facts.in_flight = 2;
        assert!(audit(&segments, &[], facts).holds);
    }

    #[test]
    fn a_counter_that_disagrees_and_a_hole_between_segments_are_found() {
        let segments = [segment(1, 1, 0, 10, 0), segment(2, 1, 11, 5, 10)];
        let report = audit(&segments, &[], counts(16, 0, 0, 2));
        assert_eq!(report.violations.len(), 3, "{:?}", report.violations);
    }

    #[test]
    fn a_counter_that_wraps_asks_for_no_more() {
        let wrapped = SegmentFacts {
            timebase: Timebase::SyncCounter,
            ticks: Some((u64::from(u32::MAX) - 3, 5)),
            ..segment(1, 1, 0, 10, 0)
        };
        assert!(audit(&[wrapped], &[], counts(10, 0, 0, 1)).holds);
        let clock = SegmentFacts { ticks: Some((u64::MAX - PERIOD_NS + 1, 8 * PERIOD_NS)), ..segment(1, 1, 0, 10, 0) };
        assert!(audit(&[clock], &[], counts(10, 0, 0, 1)).holds);
    }

    #[test]
    fn arrival_times_are_said_to_be_unchecked() {
        let arrival = SegmentFacts { timebase: Timebase::Arrival, ticks: None, ..segment(1, 1, 0, 10, 0) };
        let report = audit(&[arrival], &[], counts(10, 0, 0, 1));
        assert!(report.holds);
        assert_eq!((report.stretches[0].expected, report.unchecked[0].samples), (None, 10));
    }
}
