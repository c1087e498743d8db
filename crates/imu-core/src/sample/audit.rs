//! Audit: checks whether a capture's numbers agree with each other and with the sensor's own ticks. Pure.
//!
//! There are two identities of independently counted numbers:
//!
//! 1. `received = committed + in flight + discarded`. `received` is counted where valid measurements leave the decoder,
//!    before anything decides about them; `committed` are rows; `in flight` are samples that are held or wait for their
//!    commit; `discarded` are valid measurements that did not become a sample, by cause
//!    ([`super::DiscardCause::is_frame`]).
//! 2. `expected = committed + Σ gap.missing`. `expected` follows from the first and the last tick of each stretch: the
//!    segments of one epoch with one rate and one timebase. Between stretches (a reset, another rate, another format)
//!    and behind the last sample only host time determines the missing samples, and arrival times provide nothing to
//!    check against. Both enter `expected` as they were recorded, and [`Report::unchecked`] states how many and why.
//!
//! First and last tick determine the number of samples only if all of them lie on one grid: the last one a whole number
//! of periods behind the first. If another rate came and went while nothing arrived, or a reset was missed, the ticks
//! continue between two places of that grid, and the distance is not a number of samples. Two and a half periods may be
//! three samples; two such distances are five periods and may be six samples. A distance that is not a whole number of
//! periods is therefore rounded on its own, its gap is checked against it, and the ticks behind it count on a separate
//! grid. Whole distances are never rounded separately: a gap that counts one too few is found, however many segments
//! lie between first and last.
//!
//! The definition is in one place: [`audit_in_order`]. The store feeds it row by row from one snapshot of the database, tests
//! from memory ([`audit`]).

use super::Timebase;
use crate::units::period_ns;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The maximum number of stretches listed in a report; those that do not hold come first.
pub const STRETCHES_SHOWN: usize = 100;

/// Two segments whose distance differs by more than this share of a period from a whole number of periods are on two
/// grids.
const OFF_GRID: f64 = 0.05;

/// The facts about a segment that the audit needs.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentFacts {
    /// Number within the capture, from 1.
    pub number: u32,
    /// The run of the sensor's clock.
    pub epoch: u32,
    /// `seq` of the segment's first sample.
    pub first_seq: u64,
    /// Number of samples in the segment.
    pub samples: u64,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// The timebase of its times.
    pub timebase: Timebase,
    /// The sensor's tick at its first and at its last sample: device time in ns ([`Timebase::Device`]) or the serial count
    /// ([`Timebase::SyncCounter`]).
    pub ticks: Option<(u64, u64)>,
}

/// The facts about a gap that the audit needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GapFacts {
    /// `seq` of the first sample after the gap.
    pub before_seq: u64,
    /// Number of missing samples.
    pub missing: u64,
}

/// The counts of a capture.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CountFacts {
    /// Valid measurements that left the decoder during the capture; `None` if not counted.
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
    /// The first segment of the stretch.
    pub first_segment: u32,
    /// The last segment of the stretch.
    pub last_segment: u32,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// The timebase of the times.
    pub timebase: Timebase,
    /// Number of samples in the stretch.
    pub samples: u64,
    /// Number of missing samples in the gaps inside the stretch.
    pub missing: u64,
    /// Number of samples according to the first and last tick; null if the times are not ticks.
    pub expected: Option<u64>,
    /// `expected` − `samples` − `missing`: 0.
    pub difference: i64,
}

/// Samples that cannot be checked against ticks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Unchecked {
    /// The reason.
    pub reason: String,
    /// Number of samples concerned.
    pub samples: u64,
    /// Number of missing samples concerned.
    pub missing: u64,
}

/// Both identities of one capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Report {
    /// Whether every number agrees.
    pub holds: bool,
    /// Valid measurements that left the decoder; null for a capture made by a version that did not count them.
    pub received: Option<u64>,
    /// Samples on disk.
    pub committed: u64,
    /// Samples that are held or wait for their commit; 0 for a capture that does not run.
    pub in_flight: i64,
    /// Valid measurements that did not become a sample, by cause.
    pub discarded: BTreeMap<String, u64>,
    /// `received` − `committed` − `in_flight` − `discarded`: 0.
    pub received_difference: i64,
    /// Number of samples according to the sensor's ticks, as of the last commit; across epochs and without ticks, as
    /// recorded.
    pub expected: u64,
    /// Samples missing, as of the last commit.
    pub missing: u64,
    /// `expected` − samples − `missing`, as of the last commit: 0.
    pub expected_difference: i64,
    /// Runs of the sensor's clock at one rate, those that do not hold first; at most 100 are listed.
    pub stretches: Vec<Stretch>,
    /// Number of stretches that are not listed.
    pub stretches_omitted: u64,
    /// Samples that could not be checked against ticks, with the reason.
    pub unchecked: Vec<Unchecked>,
    /// Disagreements, one sentence each.
    pub violations: Vec<String>,
}

impl Report {
    /// Returns the report for a running capture: the first identity at the instant at which `received` measurements had
    /// arrived, `committed` of them were on disk and `in_flight` on their way there.
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

/// Computes `received` − `committed` − `in_flight` − `discarded` and reports violations.
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

/// Checks a capture. `segments` are in their order, `gaps` in any.
pub fn audit(segments: &[SegmentFacts], gaps: &[GapFacts], counts: CountFacts) -> Report {
    let mut gaps = gaps.to_vec();
    gaps.sort_by_key(|gap| gap.before_seq);
    let segments = segments.iter().cloned().map(Ok::<_, std::convert::Infallible>);
    match audit_in_order(segments, gaps.into_iter().map(Ok), counts) {
        Ok(report) => report,
        Err(never) => match never {},
    }
}

/// Checks a capture as [`audit`] does, for segments in the order of their numbers and gaps in the order of
/// `before_seq`, one after the other. However many there are, only one stretch and the entries of the report are in
/// memory.
///
/// # Errors
/// The first error of either iterator.
pub fn audit_in_order<E>(
    segments: impl IntoIterator<Item = Result<SegmentFacts, E>>,
    gaps: impl IntoIterator<Item = Result<GapFacts, E>>,
    counts: CountFacts,
) -> Result<Report, E> {
    let mut walk = Walk::new(gaps.into_iter())?;
    let mut open: Option<Open> = None;
    for segment in segments {
        let segment = segment?;
        walk.follow(&segment);
        if segment.samples == 0 {
            continue;
        }
        match open.as_mut().filter(|open| open.goes_on_with(&segment)) {
            Some(open) => open.push(&segment),
            None => {
                if let Some(whole) = open.replace(Open::new(&segment)) {
                    walk.close(whole)?;
                }
            }
        }
    }
    if let Some(whole) = open {
        walk.close(whole)?;
    }
    walk.finish(counts)
}

/// A list of bounded length: further entries are counted.
struct Listed<T> {
    first: Vec<T>,
    more: u64,
}

impl<T> Listed<T> {
    fn new() -> Self {
        Self { first: Vec::new(), more: 0 }
    }
    fn push(&mut self, make: impl FnOnce() -> T) {
        if self.first.len() < STRETCHES_SHOWN {
            self.first.push(make());
        } else {
            self.more += 1;
        }
    }
}

impl Listed<String> {
    fn lines(mut self) -> Vec<String> {
        if self.more > 0 {
            self.first.push(format!("and {} more of this kind", self.more));
        }
        self.first
    }
}

/// Consecutive segments of one epoch, rate and timebase, as far as they have been read.
struct Open {
    first_seq: u64,
    first: SegmentFacts,
    last: SegmentFacts,
    samples: u64,
    /// The first tick of the grid of the last segment.
    grid_from: Option<u64>,
    /// Periods from the stretch's first tick to `grid_from`.
    before_grid: u64,
}

/// Returns the number of periods from one tick to a later one of the sensor's clock.
fn periods(from: u64, to: u64, rate_hz: f64) -> f64 {
    to.wrapping_sub(from) as f64 / period_ns(rate_hz)
}

impl Open {
    fn new(segment: &SegmentFacts) -> Self {
        let (first, last) = (segment.clone(), segment.clone());
        // A count of messages has no places in between.
        let grid_from = segment.ticks.filter(|_| segment.timebase == Timebase::Device).map(|(from, _)| from);
        Self { first_seq: segment.first_seq, first, last, samples: segment.samples, grid_from, before_grid: 0 }
    }
    fn goes_on_with(&self, next: &SegmentFacts) -> bool {
        let one = &self.last;
        (one.epoch, one.timebase) == (next.epoch, next.timebase) && one.rate_hz == next.rate_hz
    }
    fn push(&mut self, segment: &SegmentFacts) {
        self.samples += segment.samples;
        if let (Some(grid_from), Some((_, to)), Some((from, _))) = (self.grid_from, self.last.ticks, segment.ticks) {
            let step = periods(to, from, segment.rate_hz);
            if (step - step.round()).abs() > OFF_GRID {
                let of_grid = periods(grid_from, to, segment.rate_hz).round() as u64;
                self.before_grid = self.before_grid.saturating_add(of_grid).saturating_add(step.round() as u64);
                self.grid_from = Some(from);
            }
        }
        self.last = segment.clone();
    }
    /// Returns the stretch, without its missing samples.
    fn stretch(&self) -> Stretch {
        let Self { first, last, .. } = self;
        let expected = first.ticks.zip(last.ticks).and_then(|((from, _), (_, to))| match first.timebase {
            Timebase::Device => self.grid_from.map(|grid_from| {
                let of_grid = periods(grid_from, to, first.rate_hz).round() as u64;
                self.before_grid.saturating_add(of_grid).saturating_add(1)
            }),
            // The counter has 32 bits; it steps once for each message.
            Timebase::SyncCounter => Some((to.wrapping_sub(from) & u64::from(u32::MAX)) + 1),
            Timebase::Arrival | Timebase::Stamps | Timebase::Rate => None,
        });
        Stretch {
            epoch: first.epoch,
            first_segment: first.number,
            last_segment: last.number,
            rate_hz: first.rate_hz,
            timebase: first.timebase,
            samples: self.samples,
            missing: 0,
            expected,
            difference: 0,
        }
    }
}

/// The state of the check so far.
struct Walk<G> {
    gaps: G,
    next_gap: Option<GapFacts>,
    gap_count: u64,
    segment_count: u64,
    next_seq: u64,
    samples: u64,
    missing: u64,
    expected: u64,
    unchecked: BTreeMap<&'static str, (u64, u64)>,
    failing: Listed<Stretch>,
    holding: Listed<Stretch>,
    ticks_disagree: Listed<String>,
    holes: Listed<String>,
}

impl<E, G: Iterator<Item = Result<GapFacts, E>>> Walk<G> {
    fn new(mut gaps: G) -> Result<Self, E> {
        let next_gap = gaps.next().transpose()?;
        Ok(Self {
            gaps,
            next_gap,
            gap_count: 0,
            segment_count: 0,
            next_seq: 0,
            samples: 0,
            missing: 0,
            expected: 0,
            unchecked: BTreeMap::new(),
            failing: Listed::new(),
            holding: Listed::new(),
            ticks_disagree: Listed::new(),
            holes: Listed::new(),
        })
    }

    /// Follows the segments: each one begins where the one before ends.
    fn follow(&mut self, segment: &SegmentFacts) {
        self.segment_count += 1;
        if segment.first_seq != self.next_seq {
            let next_seq = self.next_seq;
            self.holes.push(|| {
                format!(
                    "segment {} begins at sample {}, the one before ends at {next_seq}",
                    segment.number, segment.first_seq
                )
            });
        }
        self.next_seq = segment.first_seq + segment.samples;
    }

    /// Returns the next gap before this `seq`.
    fn gap_before(&mut self, seq: u64) -> Result<Option<GapFacts>, E> {
        let Some(gap) = self.next_gap.filter(|gap| gap.before_seq < seq) else { return Ok(None) };
        self.gap_count += 1;
        self.next_gap = self.gaps.next().transpose()?;
        Ok(Some(gap))
    }

    fn between(&mut self, gap: GapFacts) {
        self.missing += gap.missing;
        self.expected += gap.missing;
        self.unchecked.entry(BETWEEN).or_default().1 += gap.missing;
    }

    /// Takes in a complete stretch, with the gaps inside it.
    fn close(&mut self, open: Open) -> Result<(), E> {
        let mut stretch = open.stretch();
        while let Some(gap) = self.gap_before(open.first_seq + open.samples)? {
            if gap.before_seq > open.first_seq {
                stretch.missing += gap.missing;
            } else {
                self.between(gap);
            }
        }
        let had = stretch.samples + stretch.missing;
        self.samples += stretch.samples;
        self.missing += stretch.missing;
        self.expected += stretch.expected.unwrap_or(had);
        if let Some(asked) = stretch.expected {
            stretch.difference = difference(asked, had);
        } else {
            let entry = self.unchecked.entry(why_unchecked(stretch.timebase)).or_default();
            entry.0 += stretch.samples;
            entry.1 += stretch.missing;
        }
        if stretch.difference == 0 {
            self.holding.push(|| stretch);
            return Ok(());
        }
        self.ticks_disagree.push(|| {
            format!(
                "epoch {} at {} Hz (segments {} to {}): its ticks ask for {} samples, {} are there and {} missing",
                stretch.epoch,
                stretch.rate_hz,
                stretch.first_segment,
                stretch.last_segment,
                stretch.expected.unwrap_or(0),
                stretch.samples,
                stretch.missing
            )
        });
        self.failing.push(|| stretch);
        Ok(())
    }

    fn finish(mut self, counts: CountFacts) -> Result<Report, E> {
        while let Some(gap) = self.gap_before(u64::MAX)? {
            self.between(gap);
        }
        let mut violations = self.ticks_disagree.lines();
        let received_difference =
            first_identity(counts.received, counts.committed, counts.in_flight, &counts.discarded, &mut violations);
        if counts.received.is_none() {
            self.unchecked.entry(NOT_COUNTED).or_default().0 += counts.committed;
        }
        let (samples, missing) = (self.samples, self.missing);
        if counts.committed != samples {
            violations.push(format!("{} rows are there, the segments say {samples}", counts.committed));
        }
        let [counted_samples, counted_missing, counted_gaps, counted_segments] = counts.counters;
        for (what, counted, found) in [
            ("samples", counted_samples, samples),
            ("missing samples", counted_missing, missing),
            ("gaps", counted_gaps, self.gap_count),
            ("segments", counted_segments, self.segment_count),
        ] {
            if counted != found {
                violations.push(format!("the capture counts {counted} {what}, its rows say {found}"));
            }
        }
        violations.extend(self.holes.lines());
        let mut stretches = self.failing.first;
        let mut omitted = self.failing.more + self.holding.more;
        for stretch in self.holding.first {
            if stretches.len() < STRETCHES_SHOWN {
                stretches.push(stretch);
            } else {
                omitted += 1;
            }
        }
        Ok(Report {
            holds: violations.is_empty(),
            received: counts.received,
            committed: counts.committed,
            in_flight: counts.in_flight,
            discarded: counts.discarded,
            received_difference,
            expected: self.expected,
            missing,
            expected_difference: difference(self.expected, samples + missing),
            stretches_omitted: omitted,
            stretches,
            unchecked: self
                .unchecked
                .into_iter()
                .filter(|(_, (samples, missing))| samples + missing > 0)
                .map(|(reason, (samples, missing))| Unchecked { reason: reason.to_owned(), samples, missing })
                .collect(),
            violations,
        })
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

    /// The sensor twice had another rate while nothing arrived: each distance is two and a half periods.
    #[test]
    fn a_distance_that_is_no_whole_number_of_periods_is_checked_by_itself() {
        let half = PERIOD_NS / 2;
        let shifted = |segment: SegmentFacts, by_ns: u64| SegmentFacts {
            ticks: segment.ticks.map(|(from, to)| (from + by_ns, to + by_ns)),
            ..segment
        };
        let segments = [
            segment(1, 1, 0, 10, 100),
            shifted(segment(2, 1, 10, 10, 111), half),
            segment(3, 1, 20, 10, 123),
            // On the same grid; seven are missing.
            segment(4, 1, 30, 10, 140),
        ];
        let report = |missing: [u64; 3]| {
            let gaps: Vec<GapFacts> =
                (1..).zip(missing).map(|(index, missing)| GapFacts { before_seq: index * 10, missing }).collect();
            audit(&segments, &gaps, counts(40, missing.iter().sum(), 3, 4))
        };
        let whole = report([2, 2, 7]);
        assert!(whole.holds, "{:?}", whole.violations);
        assert_eq!((whole.expected, whole.stretches.len(), whole.unchecked.len()), (51, 1, 0));
        for (missing, difference) in [([1, 2, 7], 1), ([2, 3, 7], -1), ([2, 2, 6], 1)] {
            let wrong = report(missing);
            assert_eq!((wrong.holds, wrong.expected_difference), (false, difference), "{missing:?}");
        }
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
    fn what_is_listed_is_bounded_and_the_rest_is_counted() {
        // Each segment has its own epoch, every other one is a sample short, and no segment continues another.
        let segments = (0..1000).map(|number: u32| {
            let mut one = segment(number + 1, number + 1, u64::from(number) * 20, 10, 0);
            one.ticks = Some((0, (9 + u64::from(number % 2)) * PERIOD_NS));
            Ok::<_, std::convert::Infallible>(one)
        });
        let gaps = (1..1000).map(|number: u64| Ok(GapFacts { before_seq: number * 20, missing: 3 }));
        let report = audit_in_order(segments, gaps, counts(10_000, 2997, 999, 1000)).unwrap();
        assert_eq!((report.expected, report.missing, report.expected_difference), (10_000 + 500 + 2997, 2997, 500));
        assert_eq!((report.stretches.len(), report.stretches_omitted), (STRETCHES_SHOWN, 900));
        assert!(report.stretches.iter().all(|stretch| stretch.difference == 1));
        // A hundred of each kind, and one line for the others.
        assert_eq!(report.violations.len(), 202, "{:?}", report.violations.last());
        assert_eq!(report.violations[100], "and 400 more of this kind");
        assert_eq!(report.unchecked[0].missing, 2997);
    }

    #[test]
    fn arrival_times_are_reported_as_unchecked() {
        let arrival = SegmentFacts { timebase: Timebase::Arrival, ticks: None, ..segment(1, 1, 0, 10, 0) };
        let report = audit(&[arrival], &[], counts(10, 0, 0, 1));
        assert!(report.holds);
        assert_eq!((report.stretches[0].expected, report.unchecked[0].samples), (None, 10));
    }
}
