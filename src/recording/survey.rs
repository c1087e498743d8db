//! The survey: what a first pass over a recording counts.

use super::between::Between;
use super::choice::Chosen;
use super::error::RecordingError;
use super::findings::Findings;
use super::info::Stamps;
use super::order::{Entry, Order};
use super::rows::{Rejected, Rows};
use super::stamps::StepMedian;
use super::{GAP_PERIODS, REJECTED_KEPT};
use crate::sample::{Channel, ChannelSet, DiscardCause, Sample};
use crate::units::{NANOS_PER_SECOND, period_ns};
use std::collections::BTreeMap;
use std::path::Path;

/// More than this a VN-100 cannot tell (its range is 2.5), gauss: a magnetic field whose unit is wrong.
const MAG_MAX_GAUSS: f64 = 25.0;
/// A step shorter than this share of the mean step belongs to a pair or burst.
const SHORT: f64 = 0.1;

/// What the first pass counts.
#[derive(Debug, Default)]
pub(super) struct Survey {
    lines: u64,
    rejected_lines: u64,
    pub(super) samples: u64,
    pub(super) channels: ChannelSet,
    pub(super) first_stamp_ns: Option<i64>,
    /// From stamp to stamp, those of rejected lines included.
    pub(super) steps: StepMedian,
    /// Length and begin of the longest, ns.
    longest: Option<(u64, i64)>,
    last_stamp_ns: Option<i64>,
    between: Between,
    pub(super) rejected: BTreeMap<DiscardCause, u64>,
    pub(super) first_rejected: Vec<Rejected>,
    last_sample: Option<Sample>,
    repeated: u64,
    strong_fields: u64,
}

impl Survey {
    pub(super) fn of(rows: &mut dyn Rows, chosen: &Chosen) -> Result<Self, RecordingError> {
        let mut survey = Self::default();
        let mut order = Order::new(chosen);
        while let Some(entry) = order.next_entry(rows)? {
            survey.lines += 1;
            match entry {
                Entry::Aside => {}
                Entry::Sample { stamp_ns, sample } => {
                    survey.samples += 1;
                    survey.channels = survey.channels.union(sample.channels());
                    survey.first_stamp_ns = survey.first_stamp_ns.or(stamp_ns);
                    survey.take_stamp(stamp_ns);
                    survey.take_values(sample);
                }
                Entry::Rejected(rejected, stamp_ns) => {
                    survey.rejected_lines += 1;
                    *survey.rejected.entry(rejected.cause).or_default() += rejected.amount();
                    if stamp_ns.is_some() {
                        survey.between.add(stamp_ns, false);
                    }
                    if survey.first_rejected.len() < REJECTED_KEPT {
                        survey.first_rejected.push(rejected);
                    }
                }
            }
        }
        Ok(survey)
    }

    fn take_stamp(&mut self, stamp_ns: Option<i64>) {
        let Some(stamp_ns) = stamp_ns else { return };
        if let Some(last_ns) = self.last_stamp_ns {
            self.between.settle(last_ns, stamp_ns);
            let mut from_ns = last_ns;
            for instant in self.between.instants(stamp_ns) {
                let step_ns = instant.stamp_ns.abs_diff(from_ns);
                self.steps.add(step_ns);
                if self.longest.is_none_or(|(longest, _)| step_ns > longest) {
                    self.longest = Some((step_ns, from_ns));
                }
                from_ns = instant.stamp_ns;
            }
        }
        self.between.clear();
        self.last_stamp_ns = Some(stamp_ns);
    }

    fn take_values(&mut self, sample: Sample) {
        let values = |sample: &Sample| Channel::ALL.map(|channel| sample.get(channel));
        // A sensor's noise never repeats in several channels at once; a single coarse channel may.
        if sample.channels().iter().count() > 1
            && self.last_sample.as_ref().is_some_and(|last| values(last) == values(&sample))
        {
            self.repeated += 1;
        }
        let field = [Channel::MagX, Channel::MagY, Channel::MagZ];
        if field.iter().any(|channel| sample.get(*channel).is_some_and(|value| value.abs() > MAG_MAX_GAUSS)) {
            self.strong_fields += 1;
        }
        self.last_sample = Some(sample);
    }

    /// What is remarkable, now that the rate is known. `utc_offset_ns` is UTC − stamp.
    pub(super) fn findings(&self, rate_hz: f64, stamps: Stamps) -> Findings {
        let steps = self.steps.total();
        let span_ns = self.first_stamp_ns.zip(self.last_stamp_ns).map_or(0, |(first, last)| last.abs_diff(first));
        let mean_ns = span_ns as f64 / steps.max(1) as f64;
        let limit_ns = GAP_PERIODS * period_ns(rate_hz);
        Findings {
            steps,
            mean_rate_hz: (span_ns > 0).then(|| NANOS_PER_SECOND as f64 / mean_ns),
            irregular_steps: self.steps.count_where(|step| step > limit_ns),
            longest_step_s: self.longest.map(|(step_ns, _)| step_ns as f64 / NANOS_PER_SECOND as f64),
            longest_step_utc_ns: self.longest.map(|(_, from_ns)| from_ns).filter(|_| stamps == Stamps::Unix),
            short_steps: self.steps.count_where(|step| step < SHORT * mean_ns),
            repeated_samples: self.repeated,
            strong_fields: self.strong_fields,
            ..Findings::default()
        }
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
