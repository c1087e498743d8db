//! Selects which of several columns of stamps gives a recording's times, with the reason.
//!
//! Drivers write the time at which they received a message and the time which they assigned to the measurement. The
//! assigned time is smoother, because arrival comes in bursts. So of the columns that show the same time (their spans
//! agree to 1 %; a line number does not) the one with the most regular steps is taken. Among equals the last is taken,
//! as drivers write them in that order. A column that never advances is no time. Of columns that show different times
//! those since 1970 have priority over others, and a line number comes last.
//!
//! All stamps are of one clock: since 1970 or from another origin, whichever most are. A stamp of the other kind is a
//! cut or garbled number ([`super::order`]).

use super::error::RecordingError;
use super::findings::Pairs;
use super::grid::{StampGrid, rounding};
use super::pairs::Pairing;
use super::rows::{Row, Rows};
use super::stamps::{STAMPS_MAX, StepMedian, UNIX_FROM_NS, median_of};
use super::values::{STD_OF_SPREAD, median_and_spread};
use imu_core::sample::Sample;
use imu_core::units::NANOS_PER_SECOND;
use statrs::distribution::{ContinuousCDF as _, Normal};

/// Samples that are examined.
const LOOK_AT: usize = 20_000;
/// A step is regular if it differs from the median step by at most this share.
const REGULAR_WITHIN: f64 = 0.1;
/// Columns show the same time if their spans agree within this share.
const SAME_SPAN_WITHIN: f64 = 0.01;
/// An earlier column is preferred to a later one if it is more regular by this much.
const CLEARLY: f64 = 0.02;

/// A recording's column of stamps.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct StampChoice {
    /// The column's name.
    pub name: String,
    /// Its position among the columns of stamps, from 1.
    pub column: usize,
    /// Share of steps within 10 % of the median step, for each column of stamps.
    pub regular: Vec<f64>,
    /// The two alternating steps, for each column of stamps that comes in pairs.
    pub pairs: Vec<Option<Pairs>>,
    /// The unit of the stamps before raw lines, if it is not seconds.
    #[serde(skip)]
    pub unit: Option<&'static str>,
}

/// The properties of the examined rows.
#[derive(Debug, Default)]
pub(super) struct Chosen {
    /// The number of stamps in a row.
    pub(super) count: usize,
    /// The index of the selected column, from 0; `None` without stamps.
    pub(super) column: Option<usize>,
    /// Whether the stamps are times since 1970.
    pub(super) unix: bool,
    pub(super) regular: Vec<f64>,
    pub(super) pairs: Vec<Option<Pairs>>,
    /// How the stamps may fall behind each other.
    pub(super) falls: Falls,
    /// The grid of the stamps.
    pub(super) grid: Option<StampGrid>,
    /// The rate of its stamps, Hz, if a given rate overrides it: then the stamps are not used.
    pub(super) overridden_hz: Option<f64>,
}

/// How stamps of samples in their order may fall behind each other without a repeated or misplaced line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Falls {
    /// Several samples share one stamp: the stamp is rounded, or is that of their delivery.
    pub(super) equal: bool,
    /// Rounding explains equal stamps, so that a sample may also have the values of the one before it.
    pub(super) alike: bool,
    /// Jitter puts a stamp at most this much before the last one, ns.
    pub(super) back_ns: i64,
}

/// Counts samples whose values differ from those of the sample before, and samples with the same values: with its
/// stamp, and with another stamp.
#[derive(Debug, Default)]
struct Repeats {
    shared: [u64; 2],
    apart: [u64; 2],
}

impl Repeats {
    /// Returns whether samples of one stamp have the same values no more often than others do. This indicates a coarse
    /// channel, not a line that was written twice.
    fn by_chance(&self) -> bool {
        let share = |[other, same]: [u64; 2]| same as f64 / (other + same).max(1) as f64;
        self.shared != [0, 0] && share(self.shared) <= 2.0 * share(self.apart) + 0.05
    }
}

/// Fewer stamps do not determine their jitter.
const JITTER_LEAST: usize = 64;
/// Rounding to this share of the mean step makes equal stamps, if there is jitter too.
const ROUNDED_FROM: f64 = 0.2;
/// If this share of the samples has the stamp of the sample before, stamps are those of deliveries.
const SHARED_FROM: f64 = 0.02;
/// If this share of the samples has the stamp of the sample before, the column is not a time.
const SHARED_MOST: f64 = 0.98;
/// If this share of the steps falls, the column is not a time.
const FALLING_MOST: f64 = 0.5;
/// At least this share of the steps that normal jitter would make fall must fall: bursts spread stamps too, but none of
/// their steps falls.
const FALLING_SHARE: f64 = 0.3;
/// The number of falling steps may be lower than expected by this much by chance.
const FALLING_CHANCE: f64 = 4.0;
/// The jitters of two neighbours differ by at most this many standard deviations of one.
const DEVIATIONS: f64 = 8.0;
/// The tenth and the ninetieth percentile of a normal distribution are this many standard deviations apart.
const STD_OF_PERCENTILES: f64 = 2.563;

impl Falls {
    /// Determines the falls from stamps in the order of their samples, ns.
    fn of(stamps: &[i64], values: &Repeats) -> Self {
        let mut steps: Vec<f64> = stamps.windows(2).map(|two| two[1].saturating_sub(two[0]) as f64).collect();
        let span_ns = stamps.first().zip(stamps.last()).map_or(0, |(first, last)| last.saturating_sub(*first));
        if stamps.len() < JITTER_LEAST || span_ns <= 0 {
            return Self::default();
        }
        let count = steps.len() as f64;
        let mean_ns = span_ns as f64 / count;
        let rounding_ns = rounding(stamps) as f64;
        let rounded = rounding_ns >= ROUNDED_FROM * mean_ns;
        let shared = values.shared[0];
        let shared_of = shared as f64 / count;
        let alike = rounded && values.by_chance();
        let together = (SHARED_FROM..SHARED_MOST).contains(&shared_of) || (rounded && shared > 0) || alike;
        let falling = steps.iter().filter(|step| **step < 0.0 || (rounded && **step == 0.0)).count() as f64;
        let spread_ns = if rounded {
            // Most steps may be the same.
            let mut percentile = |of: f64| *steps.select_nth_unstable_by((of * count) as usize, f64::total_cmp).1;
            (percentile(0.9) - percentile(0.1)) / STD_OF_PERCENTILES
        } else {
            STD_OF_SPREAD * median_and_spread(steps).unwrap_or_default().1
        };
        let jitter_ns = spread_ns / std::f64::consts::SQRT_2;
        let expected = count * Normal::standard().cdf(-mean_ns / (std::f64::consts::SQRT_2 * jitter_ns));
        // Jitter of an eighth of a step never puts a stamp before the last one.
        let rounded_by_ns = if rounded { rounding_ns } else { 0.0 };
        let back_ns = (DEVIATIONS * jitter_ns - mean_ns + rounded_by_ns).max(0.0) as i64;
        let jitters =
            back_ns > 0 && falling < FALLING_MOST * count && falling + FALLING_CHANCE >= FALLING_SHARE * expected;
        Self { equal: jitters || together, alike, back_ns: if jitters { back_ns } else { 0 } }
    }
}

/// One column of stamps. Steps count from the second row on: a first line may be cut, and its first stamp with it.
#[derive(Default)]
struct Column {
    first: Option<i64>,
    last: i64,
    steps: StepMedian,
    pairing: Pairing,
    /// Steps that do not advance.
    backward: u64,
    values: Repeats,
    /// Stamps since 1970.
    unix: u64,
    stamps: Vec<i64>,
}

impl Column {
    fn add(&mut self, stamp_ns: i64, repeats: bool) {
        self.stamps.push(stamp_ns);
        if self.first.is_some() {
            let counts = if stamp_ns == self.last { &mut self.values.shared } else { &mut self.values.apart };
            counts[usize::from(repeats)] += 1;
        }
        if self.first.replace(self.first.unwrap_or(stamp_ns)).is_some() {
            if stamp_ns > self.last {
                let step_ns = stamp_ns.abs_diff(self.last);
                self.steps.add(step_ns);
                self.pairing.add(step_ns);
            } else {
                self.backward += 1;
            }
        }
        self.last = stamp_ns;
    }
    fn span_ns(&self) -> f64 {
        self.first.map_or(0.0, |first| self.last.saturating_sub(first) as f64)
    }
    fn same_time(&self, other: &Self) -> bool {
        (self.span_ns() - other.span_ns()).abs() <= SAME_SPAN_WITHIN * other.span_ns()
    }
    /// Returns whether the column increases by whole numbers, nearly always by one, as a line number does.
    fn counts(&self) -> bool {
        let counted = self.steps.counted();
        median_of(&counted) == Some(NANOS_PER_SECOND as f64)
            && counted.iter().all(|(step, _)| step % NANOS_PER_SECOND == 0)
    }
    fn regular(&self) -> f64 {
        let counted = self.steps.counted();
        let Some(median) = median_of(&counted) else { return 0.0 };
        let is_near = |step: u64| (step as f64 - median).abs() <= REGULAR_WITHIN * median;
        let near: u64 = counted.iter().filter(|(step, _)| is_near(*step)).map(|(_, count)| count).sum();
        near as f64 / (self.steps.total() + self.backward) as f64
    }
}

/// Returns the column whose time is used, among those of `rows` rows.
fn reference(columns: &[Column], rows: u64) -> Option<usize> {
    let advancing = || (0..columns.len()).rev().filter(|index| columns[*index].steps.total() > 0);
    let differ = advancing().any(|one| advancing().any(|other| !columns[one].same_time(&columns[other])));
    let unix = || advancing().find(|index| 2 * columns[*index].unix >= rows);
    let other = || advancing().find(|index| !columns[*index].counts());
    let of_several = if differ { unix().or_else(other) } else { None };
    of_several.or_else(|| advancing().next()).or(columns.len().checked_sub(1))
}

/// Examines the first rows and selects the column.
pub(super) fn choose(rows: &mut dyn Rows) -> Result<Chosen, RecordingError> {
    let mut by_count: [(u64, [Column; STAMPS_MAX]); STAMPS_MAX + 1] = Default::default();
    let mut looked_at = 0;
    let mut last: Option<Sample> = None;
    while looked_at < LOOK_AT
        && let Some(row) = rows.next_row()?
    {
        let Row::Sample { stamps, sample, .. } = row else { continue };
        let repeats = last.replace(sample.clone()).is_some_and(|last| last.same_values(&sample));
        looked_at += 1;
        let (rows, columns) = &mut by_count[stamps.count()];
        *rows += 1;
        for (index, column) in columns.iter_mut().enumerate() {
            let Some(stamp_ns) = stamps.get(index) else { break };
            column.unix += u64::from(stamp_ns >= UNIX_FROM_NS);
            if looked_at > 1 {
                column.add(stamp_ns, repeats);
            }
        }
    }
    // Of equally frequent counts the larger one: a first line may be cut.
    let Some((count, (rows, columns))) = by_count.iter().enumerate().max_by_key(|(count, (rows, _))| (*rows, *count))
    else {
        return Ok(Chosen::default());
    };
    let columns = &columns[..count];
    let regular: Vec<f64> = columns.iter().map(Column::regular).collect();
    let pairs = columns.iter().map(|column| column.pairing.pairs(&column.steps.counted())).collect();
    let Some(reference) = reference(columns, *rows) else {
        return Ok(Chosen { count, regular, pairs, ..Chosen::default() });
    };
    let mut column = reference;
    for earlier in (0..reference).rev() {
        if columns[earlier].same_time(&columns[reference]) && regular[earlier] > regular[column] + CLEARLY {
            column = earlier;
        }
    }
    let unix = 2 * columns[column].unix >= *rows;
    let own_clock = |stamp_ns: &i64| (*stamp_ns >= UNIX_FROM_NS) == unix;
    let stamps: Vec<i64> = columns[column].stamps.iter().copied().filter(own_clock).collect();
    let falls = Falls::of(&stamps, &columns[column].values);
    Ok(Chosen { count, column: Some(column), unix, regular, pairs, falls, ..Chosen::default() })
}

/// Selects the stamps of a table. Its columns determine how many stamps rows have; of several the first rows determine the
/// one that is used, and in any case its clock.
pub(super) fn choose_of_columns(rows: &mut dyn Rows, count: usize) -> Result<Chosen, RecordingError> {
    let of_several = choose(rows)?;
    if count > 1 && of_several.count == count && of_several.column.is_some() {
        return Ok(of_several);
    }
    let Chosen { unix, falls, .. } = of_several;
    Ok(Chosen { count, column: (count > 0).then_some(0), unix, falls, ..Chosen::default() })
}
