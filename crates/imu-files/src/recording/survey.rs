//! The survey: the counts of a first pass over a recording.

use super::between::Between;
use super::choice::Chosen;
use super::doubts::doubts;
use super::error::RecordingError;
use super::findings::{Findings, Quantisation};
use super::grid::{self, StampGrid};
use super::info::{Conversion, Stamps};
use super::order::Entry;
use super::pairs::{Pairing, SHORT};
use super::placing::Placing;
use super::quantum::step_of;
use super::rows::{Decimals, Rejected, Rows};
use super::stamps::{StepMedian, median_of};
use super::values::Values;
use super::{REJECTED_KEPT, SLIPS_MOST};
use imu_core::sample::{Channel, ChannelSet, DiscardCause};
use imu_core::units::NANOS_PER_SECOND;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

/// The decimals of text are a step if the greatest value has no more digits: beyond that they are a double's.
const DIGITS_MAX: f64 = 1e9;
/// A step is that of the decimals if it is smaller than this many steps of the decimals.
const DECIMALS_OWN: f64 = 1.5;
/// A step that lies this close to a multiple of the decimals' is that multiple.
const MULTIPLE_WITHIN: f64 = 0.02;

/// A stamp is delayed if it is this much later than its rounding explains, periods.
const DELAYED: f64 = 0.5;
/// A grid with a period below this share of another one's is finer.
const FINER: f64 = 0.9;

/// The counts of the first pass.
#[derive(Debug, Default)]
pub(super) struct Survey {
    lines: u64,
    rejected_lines: u64,
    pub(super) samples: u64,
    pub(super) channels: ChannelSet,
    pub(super) first_stamp_ns: Option<i64>,
    /// Steps from stamp to stamp, including those of rejected lines.
    pub(super) steps: StepMedian,
    pairing: Pairing,
    /// Number of samples missing by the grid, number of gaps that contain them, and the longest gap: its points, and
    /// the ns at which it begins.
    missing: u64,
    gaps: u64,
    longest_gap: Option<(u64, i64)>,
    /// Number of stamps that are late by half a period or more, and the longest delay, periods.
    delayed: (u64, f64),
    /// The mean period, ns, and how often stamps left the grid.
    outcome: Option<(f64, u64)>,
    /// The last stamps.
    last_stamps_ns: VecDeque<i64>,
    last_stamp_ns: Option<i64>,
    between: Between,
    frozen: Frozen,
    /// Number of stamps before that of the last sample, and the largest distance, ns.
    late: (u64, u64),
    first_late_line: Option<u64>,
    present: Present,
    /// Number of stamps that lie ahead of those that follow, or are of another clock.
    astray: u64,
    pub(super) rejected: BTreeMap<DiscardCause, u64>,
    pub(super) first_rejected: Vec<Rejected>,
    values: Values,
}

/// Counts of stamps that repeat the last sample's.
#[derive(Debug, Default)]
struct Frozen {
    stamps: u64,
    runs: u64,
    longest: u64,
    /// The number in the current run.
    run: u64,
}

impl Frozen {
    fn repeats(&mut self) {
        self.runs += u64::from(self.run == 0);
        self.run += 1;
        self.stamps += 1;
        self.longest = self.longest.max(self.run);
    }
}

/// The number of samples that have each channel.
#[derive(Debug, Default)]
struct Present {
    counts: [u64; Channel::COUNT],
    /// The channels of the last samples, and the number of these samples: nearly all have the same channels.
    run: (ChannelSet, u64),
}

impl Present {
    fn take(&mut self, channels: ChannelSet) {
        if self.run.0 != channels {
            self.counts = self.counts();
            self.run = (channels, 0);
        }
        self.run.1 += 1;
    }

    fn counts(&self) -> [u64; Channel::COUNT] {
        let mut counts = self.counts;
        for channel in self.run.0.iter() {
            counts[channel as usize] += self.run.1;
        }
        counts
    }
}

impl Survey {
    pub(super) fn of(rows: &mut dyn Rows, chosen: &Chosen) -> Result<Self, RecordingError> {
        let mut survey = Self::default();
        let mut placing = Placing::new(chosen);
        let half = chosen.grid.as_ref().map_or(0.0, |grid| 0.5 * grid.rounding_ns as f64 / grid.period_ns);
        while let Some((entry, placed)) = placing.next_entry(rows)? {
            survey.lines += 1;
            match entry {
                Entry::Aside => {}
                Entry::Sample { stamp_ns, sample } => {
                    survey.samples += 1;
                    survey.frozen.run = 0;
                    survey.channels = survey.channels.union(sample.channels());
                    survey.present.take(sample.channels());
                    survey.first_stamp_ns = survey.first_stamp_ns.or(stamp_ns);
                    if let Some((placed, stamp_ns)) = placed.zip(stamp_ns) {
                        survey.take_place(placed, half, stamp_ns);
                    }
                    survey.take_stamp(stamp_ns);
                    survey.values.take(stamp_ns, sample);
                }
                Entry::Rejected(rejected, stamp_ns) => survey.take_rejected(rejected, stamp_ns),
            }
        }
        survey.outcome = placing.outcome();
        Ok(survey)
    }

    fn take_place(&mut self, placed: grid::Placed, half: f64, stamp_ns: i64) {
        if placed.missing > 0 {
            self.missing += placed.missing;
            self.gaps += 1;
            if self.longest_gap.is_none_or(|(longest, _)| placed.missing > longest) {
                self.longest_gap = Some((placed.missing, self.last_stamp_ns.unwrap_or(stamp_ns)));
            }
        }
        if placed.error > half + DELAYED {
            self.delayed = (self.delayed.0 + 1, self.delayed.1.max(placed.error));
        }
        if self.last_stamps_ns.len() == grid::LOOK_AT {
            self.last_stamps_ns.pop_front();
        }
        self.last_stamps_ns.push_back(stamp_ns);
    }

    /// Returns the mean period of the stamps, ns; `None` if they do not determine one.
    pub(super) fn period_ns(&self) -> Option<f64> {
        self.outcome.map(|(period_ns, _)| period_ns)
    }

    /// Returns the grid of the last stamps, if earlier ones left the grid of the first stamps and this one is finer: a
    /// recording whose rate rose.
    pub(super) fn another_grid(&self, first: Option<&StampGrid>) -> Option<StampGrid> {
        let (_, slips) = self.outcome?;
        if slips as f64 <= SLIPS_MOST * self.samples as f64 {
            return None;
        }
        let last: Vec<i64> = self.last_stamps_ns.iter().copied().collect();
        grid::find(&last)
            .filter(|last| first.is_some_and(|first| last.period_ns < FINER * first.period_ns))
            .map(|last| StampGrid { start_ns: 0.0, first_late: 0, ..last })
    }

    fn take_rejected(&mut self, rejected: Rejected, stamp_ns: Option<i64>) {
        self.rejected_lines += 1;
        *self.rejected.entry(rejected.cause).or_default() += rejected.amount();
        match rejected.late_ns {
            Some(0) => self.frozen.repeats(),
            Some(late_ns) => {
                self.late = (self.late.0 + 1, self.late.1.max(late_ns));
                self.first_late_line = self.first_late_line.or(Some(rejected.line));
            }
            None => self.astray += u64::from(rejected.astray),
        }
        if stamp_ns.is_some() {
            self.between.add(stamp_ns, false);
        }
        if self.first_rejected.len() < REJECTED_KEPT {
            self.first_rejected.push(rejected);
        }
    }

    fn take_stamp(&mut self, stamp_ns: Option<i64>) {
        let Some(stamp_ns) = stamp_ns else { return };
        if let Some(last_ns) = self.last_stamp_ns {
            if self.between.count() == 0 {
                self.take_step(last_ns, stamp_ns);
            } else {
                let mut between = std::mem::take(&mut self.between);
                between.settle(last_ns, stamp_ns);
                let mut from_ns = last_ns;
                for instant in between.instants(stamp_ns) {
                    self.take_step(from_ns, instant.stamp_ns);
                    from_ns = instant.stamp_ns;
                }
                self.between = between;
            }
        }
        self.between.clear();
        self.last_stamp_ns = Some(stamp_ns);
    }

    fn take_step(&mut self, from_ns: i64, to_ns: i64) {
        let step_ns = to_ns.abs_diff(from_ns);
        self.steps.add(step_ns);
        self.pairing.add(step_ns);
    }

    /// Returns the findings, once the rate is known.
    pub(super) fn findings(
        &self,
        rate_hz: f64,
        stamps: Stamps,
        conversions: &[Conversion],
        decimals: &Decimals,
    ) -> Findings {
        let steps = self.steps.total();
        let span_ns = self.first_stamp_ns.zip(self.last_stamp_ns).map_or(0, |(first, last)| last.abs_diff(first));
        let mean_ns = span_ns as f64 / steps.max(1) as f64;
        let counted = self.steps.counted();
        let count_where = |condition: &dyn Fn(f64) -> bool| -> u64 {
            counted.iter().filter(|(step, _)| condition(*step as f64)).map(|(_, count)| count).sum()
        };
        let seconds = |nanos: f64| nanos / NANOS_PER_SECOND as f64;
        let median_ns = median_of(&counted);
        let pairs = self.pairing.pairs(&counted);
        // Holes lengthen the mean step; among pairs the median may be a short one.
        let typical_ns = pairs.map(|pairs| pairs.long_s * NANOS_PER_SECOND as f64).or(median_ns).unwrap_or(0.0);
        let turned_s = if stamps == Stamps::None { 1.0 / rate_hz } else { 1.0 };
        let period_ns = self.period_ns().unwrap_or(0.0);
        Findings {
            steps,
            median_step_s: median_ns.map(seconds),
            mean_rate_hz: (span_ns > 0).then(|| NANOS_PER_SECOND as f64 / mean_ns),
            missing: self.missing,
            gaps: self.gaps,
            longest_gap_s: self.longest_gap.map(|(missing, _)| seconds((missing + 1) as f64 * period_ns)),
            longest_gap_utc_ns: self.longest_gap.map(|(_, from_ns)| from_ns).filter(|_| stamps == Stamps::Unix),
            delayed: self.delayed.0,
            longest_delay_s: (self.delayed.0 > 0).then(|| seconds(self.delayed.1 * period_ns)),
            off_grid: self.outcome.map_or(0, |(_, slips)| slips),
            short_steps: count_where(&|step| step < SHORT * typical_ns),
            pairs,
            frozen_stamps: self.frozen.stamps,
            frozen_runs: self.frozen.runs,
            longest_frozen_run: self.frozen.longest,
            late_stamps: self.late.0,
            latest_by_s: (self.late.0 > 0).then(|| seconds(self.late.1 as f64)),
            first_late_line: self.first_late_line,
            stray_stamps: self.astray,
            repeated_samples: self.values.repeated,
            strong_fields: self.values.strong_fields,
            quantisation: self.quantisation(conversions, decimals),
            doubts: doubts(&self.values, conversions, turned_s),
            ..Findings::default()
        }
    }

    /// Returns, for each of these channels that is absent in some samples, the number of those samples.
    pub(super) fn absent(&self, of: ChannelSet) -> BTreeMap<Channel, u64> {
        let counts = self.present.counts();
        let absent = of.iter().map(|channel| (channel, self.samples - counts[channel as usize]));
        absent.filter(|(_, count)| *count > 0).collect()
    }

    /// Returns the step of each channel's values, if one is found.
    fn quantisation(&self, conversions: &[Conversion], decimals: &Decimals) -> BTreeMap<Channel, Quantisation> {
        let of = |channel: Channel| {
            let converted = conversions.iter().find(|conversion| conversion.channel == channel);
            let (unit, factor) =
                converted.map_or((channel.unit(), 1.0), |conversion| (conversion.original_unit, conversion.factor));
            let written: Vec<f64> = self.values.of(channel).iter().map(|value| value / factor).collect();
            let step = step_as_written(&written, decimals.get(channel))?;
            Some((
                channel,
                Quantisation { step: step * factor.abs(), original_step: step, original_unit: unit.to_owned() },
            ))
        };
        self.channels.iter().filter_map(of).collect()
    }

    pub(super) fn no_sample(&self, file: &Path) -> RecordingError {
        let first = self.first_rejected.first();
        RecordingError::NoSample {
            file: file.to_owned(),
            lines: self.lines,
            rejected: self.rejected_lines,
            first: first.map_or_else(String::new, |first| {
                format!("; line {} ({}): {:?}", first.line, first.cause.name(), first.text)
            }),
        }
    }
}

/// Returns the step of values in the file's own unit: of the values themselves, or their decimals.
fn step_as_written(values: &[f64], decimals: Option<u8>) -> Option<f64> {
    let found = step_of(values);
    let size = values.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
    let of_text = decimals.map(|decimals| 10_f64.powi(-i32::from(decimals))).filter(|step| size / step < DIGITS_MAX);
    let Some(of_text) = of_text else { return found };
    match found {
        Some(found) if found > DECIMALS_OWN * of_text => {
            let multiple = (found / of_text).round();
            // Multiplied and divided by whole powers of ten, the step becomes the number that a user would write.
            let written = multiple / 10_f64.powi(i32::from(decimals.unwrap_or(0)));
            Some(if (found / of_text - multiple).abs() < MULTIPLE_WITHIN { written } else { found })
        }
        // Few distinct values allow no conclusion.
        None if values.iter().any(|value| Some(value) != values.first()) => Some(of_text),
        None => None,
        Some(_) => Some(of_text),
    }
}
