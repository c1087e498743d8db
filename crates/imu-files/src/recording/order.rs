//! The order of a recording's samples: their stamps are of one clock and increase, except for rounding and jitter
//! ([`Falls`]). A sample is rejected if its stamp is of another clock, lies ahead of those that follow, or is not later
//! than the sample before.
//!
//! Only the following stamps show which of two contradictory ones is wrong: after `1 2 900 3 4 5` it is 900, after `1 2
//! 4 3 5` it is 3. So a sample is judged with the [`WINDOW`] stamped ones behind it at hand. It is accepted if it
//! belongs to a longest increasing run among them; of equal runs the one that contains it counts. This never rejects
//! more samples than accepting each stamp in turn would.

use super::choice::{Chosen, Falls};
use super::error::RecordingError;
use super::rows::{Rejected, Row, Rows};
use super::stamps::UNIX_FROM_NS;
use imu_core::sample::{DiscardCause, Sample};
use imu_core::units::NANOS_PER_SECOND;
use std::collections::VecDeque;

/// Stamped samples that are examined together: up to seven stamps in a row may be wrong.
const WINDOW: usize = 16;
/// The maximum number of rows of any kind that wait for their judgement: memory does not grow with the rejected rows
/// between samples.
const WAITING_MAX: usize = 256;

/// A row, with the selected stamp.
#[derive(Debug)]
pub(super) enum Entry {
    Sample {
        stamp_ns: Option<i64>,
        sample: Sample,
    },
    /// A rejected row with its stamp, if it stands for a sample and its stamp is later than that of the sample before.
    Rejected(Rejected, Option<i64>),
    Aside,
}

/// A row that has not been judged yet.
#[derive(Debug)]
enum Waiting {
    /// A sample with a stamp of the recording's clock.
    Stamped {
        line: u64,
        stamp_ns: i64,
        sample: Sample,
        /// Whether the stamp is not later than the one read before it.
        falls: bool,
    },
    /// A sample of a recording without stamps.
    Plain(Sample),
    /// A rejected row with its stamp.
    Rejected(Rejected, Option<i64>),
    Aside,
}

/// Keeps stamps increasing.
#[derive(Debug)]
pub(super) struct Order {
    /// The index of the selected stamp; `None` if the recording has none.
    column: Option<usize>,
    /// Whether stamps are times since 1970.
    unix: bool,
    falls: Falls,
    last_stamp_ns: Option<i64>,
    /// The last sample, if equal stamps may belong to different samples.
    last_sample: Option<Sample>,
    waiting: VecDeque<Waiting>,
    /// The number of waiting rows that have a stamp.
    stamped: usize,
    /// The number of these whose stamp falls behind the one before: if none does, the waiting stamps increase.
    falling: usize,
    /// The stamp read last.
    newest_stamp_ns: Option<i64>,
    ended: bool,
}

impl Order {
    pub(super) fn new(chosen: &Chosen) -> Self {
        Self {
            column: chosen.column,
            unix: chosen.unix,
            falls: chosen.falls,
            last_stamp_ns: None,
            last_sample: None,
            waiting: VecDeque::new(),
            stamped: 0,
            falling: 0,
            newest_stamp_ns: None,
            ended: false,
        }
    }

    /// Returns the outcome of the next row; `None` at the end.
    pub(super) fn next_entry(&mut self, rows: &mut dyn Rows) -> Result<Option<Entry>, RecordingError> {
        loop {
            let needs_more = match self.waiting.front() {
                None => true,
                Some(Waiting::Stamped { .. }) => self.stamped < WINDOW && self.waiting.len() < WAITING_MAX,
                Some(_) => false,
            };
            if !needs_more || self.ended {
                return Ok(self.waiting.pop_front().map(|row| self.judge(row)));
            }
            match rows.next_row()? {
                None => self.ended = true,
                Some(row) => {
                    let row = self.read(row);
                    if let Waiting::Stamped { stamp_ns, falls, .. } = &row {
                        self.stamped += 1;
                        self.falling += usize::from(*falls);
                        self.newest_stamp_ns = Some(*stamp_ns);
                    }
                    self.waiting.push_back(row);
                }
            }
        }
    }

    /// Returns the row with the selected stamp, if that is of the recording's clock.
    fn read(&self, row: Row) -> Waiting {
        let stamp_of = |stamps: super::stamps::RowStamps| self.column.and_then(|column| stamps.get(column));
        let malformed = |line, text: &str| Rejected::new(line, DiscardCause::Malformed, text, true);
        match row {
            Row::Aside => Waiting::Aside,
            Row::Rejected(rejected) => {
                let stamp_ns = stamp_of(rejected.stamps).filter(|_| rejected.stands_for_sample);
                Waiting::Rejected(rejected, stamp_ns)
            }
            Row::Sample { line, stamps, sample } => match (self.column, stamp_of(stamps)) {
                (None, _) => Waiting::Plain(sample),
                (Some(_), None) => Waiting::Rejected(malformed(line, "it has no stamp"), None),
                (Some(_), Some(stamp_ns)) if (stamp_ns >= UNIX_FROM_NS) != self.unix => {
                    let clock = if self.unix { "a time since 1970" } else { "from the recording's origin" };
                    let text = format!("stamp {} s is not {clock}, as the others are", seconds(stamp_ns));
                    Waiting::Rejected(Rejected { astray: true, ..malformed(line, &text) }, None)
                }
                (Some(_), Some(stamp_ns)) => {
                    let falls = self.newest_stamp_ns.is_some_and(|newest| !self.follows(newest, stamp_ns));
                    Waiting::Stamped { line, stamp_ns, sample, falls }
                }
            },
        }
    }

    fn judge(&mut self, row: Waiting) -> Entry {
        match row {
            Waiting::Aside => Entry::Aside,
            Waiting::Plain(sample) => Entry::Sample { stamp_ns: None, sample },
            Waiting::Rejected(rejected, stamp_ns) => {
                let later = stamp_ns.filter(|stamp_ns| self.last_stamp_ns.is_some_and(|last| *stamp_ns > last));
                Entry::Rejected(rejected, later)
            }
            Waiting::Stamped { line, stamp_ns, sample, falls } => {
                self.stamped -= 1;
                self.falling -= usize::from(falls);
                let repeats = !self.falls.alike
                    && self.last_stamp_ns == Some(stamp_ns)
                    && self.last_sample.as_ref().is_some_and(|last| last.same_values(&sample));
                if let Some(last) = self.last_stamp_ns.filter(|last| repeats || !self.follows(*last, stamp_ns)) {
                    let text = format!("stamp {} s is not later than the one before", seconds(stamp_ns));
                    let rejected = Rejected::new(line, DiscardCause::Duplicate, &text, false);
                    return Entry::Rejected(Rejected { late_ns: Some(last.abs_diff(stamp_ns)), ..rejected }, None);
                }
                if !self.fits(stamp_ns) {
                    let text = format!("stamp {} s lies ahead of those that follow", seconds(stamp_ns));
                    let rejected = Rejected::new(line, DiscardCause::Malformed, &text, true);
                    return Entry::Rejected(Rejected { astray: true, ..rejected }, None);
                }
                // A stamp that jitter moved back does not make room for another one.
                self.last_stamp_ns = Some(self.last_stamp_ns.map_or(stamp_ns, |last| last.max(stamp_ns)));
                if self.falls.equal && !self.falls.alike {
                    self.last_sample = Some(sample.clone());
                }
                Entry::Sample { stamp_ns: Some(stamp_ns), sample }
            }
        }
    }

    fn follows(&self, before_ns: i64, stamp_ns: i64) -> bool {
        follows(self.falls, before_ns, stamp_ns)
    }

    /// Returns whether a longest increasing run from here on begins with this stamp, which is later than the last.
    fn fits(&self, stamp_ns: i64) -> bool {
        if self.falling == 0 {
            return true;
        }
        let following = self.waiting.iter().filter_map(|row| match row {
            Waiting::Stamped { stamp_ns, .. } => Some(*stamp_ns),
            _ => None,
        });
        let after = |from_ns: Option<i64>| {
            let later = |stamp_ns: &i64| from_ns.is_none_or(|from_ns| self.follows(from_ns, *stamp_ns));
            longest_run(following.clone().filter(later), self.falls)
        };
        1 + after(Some(stamp_ns)) >= after(self.last_stamp_ns)
    }
}

/// Returns whether a sample with stamp `stamp_ns` may follow one with stamp `before_ns`.
fn follows(falls: Falls, before_ns: i64, stamp_ns: i64) -> bool {
    let by_ns = stamp_ns.saturating_sub(before_ns);
    by_ns > 0 || (falls.equal && by_ns >= -falls.back_ns)
}

/// Returns the length of the longest increasing run among the stamps, if others are omitted.
fn longest_run(stamps: impl Iterator<Item = i64>, falls: Falls) -> usize {
    // The smallest stamp with which a run of each length can end.
    let mut ends: Vec<i64> = Vec::with_capacity(WINDOW);
    for stamp_ns in stamps {
        let length = ends.partition_point(|end| follows(falls, *end, stamp_ns));
        match ends.get_mut(length) {
            Some(end) => *end = stamp_ns,
            None => ends.push(stamp_ns),
        }
    }
    ends.len()
}

fn seconds(stamp_ns: i64) -> f64 {
    stamp_ns as f64 / NANOS_PER_SECOND as f64
}

#[cfg(test)]
mod tests {
    use super::super::rows::Decimals;
    use super::super::stamps::RowStamps;
    use super::*;
    use proptest::prelude::*;

    /// Samples with these stamps, ns.
    struct Given<'a>(std::slice::Iter<'a, i64>, Decimals);

    impl Rows for Given<'_> {
        fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
            let next = self.0.next();
            Ok(next.map(|ns| Row::Sample { line: 1, stamps: RowStamps::one(*ns), sample: Sample::at(0, 0) }))
        }
        fn decimals(&self) -> &Decimals {
            &self.1
        }
    }

    /// Returns the accepted stamps, and the causes of the rejections.
    fn judged(stamps: &[i64]) -> (Vec<i64>, Vec<DiscardCause>) {
        let chosen = Chosen { count: 1, column: Some(0), ..Chosen::default() };
        let (mut order, mut rows) = (Order::new(&chosen), Given(stamps.iter(), Decimals::default()));
        let (mut kept, mut causes) = (Vec::new(), Vec::new());
        while let Some(entry) = order.next_entry(&mut rows).unwrap() {
            match entry {
                Entry::Sample { stamp_ns, .. } => kept.extend(stamp_ns),
                Entry::Rejected(rejected, _) => causes.push(rejected.cause),
                Entry::Aside => {}
            }
        }
        (kept, causes)
    }

    /// Returns the stamps that are kept if each stamp is accepted in turn.
    fn greedy(stamps: &[i64]) -> Vec<i64> {
        let mut kept: Vec<i64> = Vec::new();
        for stamp_ns in stamps {
            if kept.last().is_none_or(|last| stamp_ns > last) {
                kept.push(*stamp_ns);
            }
        }
        kept
    }

    #[test]
    fn one_stamp_far_ahead_is_rejected_and_the_rest_is_kept() {
        let clean: Vec<i64> = (0..1000).map(|index| index * 25).collect();
        for place in [0, 1, 500, 990, 998] {
            let mut stamps = clean.clone();
            stamps[place] = 1_000_000_000;
            let (kept, causes) = judged(&stamps);
            // A single stamp follows the last but one: which of the two is wrong cannot be known.
            let expected = if place == 998 { DiscardCause::Duplicate } else { DiscardCause::Malformed };
            assert_eq!((kept.len(), causes.as_slice()), (999, [expected].as_slice()), "{place}");
            assert_eq!(kept.contains(&1_000_000_000), place == 998);
        }
        // Several in a row, and each on its own.
        let mut stamps = clean.clone();
        for place in [100, 101, 102, 103, 104, 105, 106, 300, 400] {
            stamps[place] = 2_000_000_000 - place as i64;
        }
        assert_eq!(judged(&stamps).0.len(), 991);
    }

    #[test]
    fn what_is_late_is_rejected_as_before() {
        assert_eq!(judged(&[1, 2, 4, 3, 5]), (vec![1, 2, 4, 5], vec![DiscardCause::Duplicate]));
        assert_eq!(judged(&[1, 2, 2, 3]), (vec![1, 2, 3], vec![DiscardCause::Duplicate]));
        // A clock that was set back: the samples recorded first stay.
        let stamps: Vec<i64> = (100..200).chain(150..260).collect();
        assert_eq!(judged(&stamps).0, (100..260).collect::<Vec<_>>());
        // A long hole is no outlier.
        let stamps: Vec<i64> = (0..50).chain(1_000_000..1_000_050).collect();
        assert_eq!(judged(&stamps).0, stamps);
    }

    proptest! {
        #[test]
        fn never_is_more_rejected_than_by_taking_each_stamp_at_its_word(
            stamps in prop::collection::vec(0_i64..60, 0..60)
        ) {
            let (kept, causes) = judged(&stamps);
            prop_assert!(kept.is_sorted_by(|earlier, later| earlier < later));
            prop_assert_eq!(kept.len() + causes.len(), stamps.len());
            prop_assert!(kept.len() >= greedy(&stamps).len());
        }

        #[test]
        fn outliers_far_apart_cost_themselves_alone(
            places in prop::collection::btree_set(0_usize..20, 0..10),
            ahead in 10_000_i64..1_000_000_000,
        ) {
            let mut stamps: Vec<i64> = (0..430).map(|index| index * 3).collect();
            for place in &places {
                stamps[place * 20] += ahead;
            }
            let (kept, causes) = judged(&stamps);
            prop_assert_eq!(kept.len(), 430 - places.len());
            prop_assert!(causes.iter().all(|cause| *cause == DiscardCause::Malformed));
        }
    }
}
