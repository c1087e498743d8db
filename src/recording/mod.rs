//! Recordings: files of samples that somebody else wrote, read as if they had been captured.
//!
//! In: a path to CSV (contract, section 4) or raw `$VN…` lines, either also gzip-compressed. Out: a [`RecordingInfo`] from a
//! first pass over the file, then its samples one by one ([`Recording::items`]), [`Record`](crate::sample::Record)s
//! ([`account`]), or whole columns ([`load_columns`]).
//!
//! Promises: memory does not grow with the file (but for [`load_columns`]); no line is dropped without being counted, with
//! its number, cause and text; samples are never reordered: one whose stamp is not later than the one before is rejected as
//! a duplicate. Values are those of the text, converted only where the column's unit is not the channel's.
//!
//! Times: a sample's `device_time_ns` is its stamp counted from the first one; its UTC is the stamp where stamps are
//! seconds since 1970, else counted from [`Options::started_utc_ns`].

pub mod account;
pub mod detect;
pub mod error;
pub mod info;
pub mod load;
pub mod rows;

#[cfg(test)]
mod tests;

mod csv;
mod stamps;
mod vn_text;

pub use account::RecordingAccountant;
pub use detect::{Kind, detect};
pub use error::RecordingError;
pub use info::{Conversion, Decimals, RecordingInfo, Stamps};
pub use load::{LoadedColumn, LoadedRecording, load_columns};
pub use rows::Rejected;

use crate::sample::{ChannelSet, DiscardCause, Sample};
use crate::units::{NANOS_PER_SECOND, period_ns};
use rows::{Row, Rows};
use stamps::{StepMedian, UNIX_FROM_NS};
use std::collections::BTreeMap;
use std::path::Path;

/// The rate at which raw `$VN…` lines are taken when nothing tells it: register 7's default (contract, section 1).
pub const DEFAULT_VN_RATE_HZ: f64 = 40.0;
/// Rejected lines that are kept with their text.
pub const REJECTED_KEPT: usize = 100;

/// What the caller knows about a recording.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Options {
    /// Samples per second of a recording without stamps.
    pub rate_hz: Option<f64>,
    /// UTC of its start, ns since 1970, where it has no stamps since 1970: the time of the import, say.
    pub started_utc_ns: i64,
}

/// One line's outcome.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// A sample with its times.
    Sample(Sample),
    /// A line that is none.
    Rejected(Rejected),
}

/// A recording that was looked through once.
#[derive(Debug)]
pub struct Recording {
    info: RecordingInfo,
}

impl Recording {
    /// Looks through the whole file: what it is, its channels, rate, counts.
    ///
    /// # Errors
    /// [`RecordingError`] where it is nothing that can be read, has no sample, or tells no rate.
    pub fn open(file: &Path, options: Options) -> Result<Self, RecordingError> {
        if let Some(rate_hz) = options.rate_hz.filter(|rate| !(rate.is_finite() && *rate > 0.0)) {
            return Err(RecordingError::Rate { found: rate_hz });
        }
        let (kind, mut source) = Source::open(file, detect(file)?)?;
        let survey = Survey::of(source.rows())?;
        if survey.samples == 0 {
            return Err(survey.no_sample(file));
        }
        let stamps = match survey.first_stamp_ns {
            None => Stamps::None,
            Some(first) if first >= UNIX_FROM_NS => Stamps::Unix,
            Some(_) => Stamps::Relative,
        };
        let stamped = stamps != Stamps::None;
        let (rate_hz, rate_assumed) = if stamped {
            let step_ns = survey.steps.median_ns();
            let step_ns =
                step_ns.ok_or_else(|| RecordingError::NoStep { file: file.to_owned(), samples: survey.samples })?;
            (NANOS_PER_SECOND as f64 / step_ns, false)
        } else {
            match (options.rate_hz, kind) {
                (Some(rate_hz), _) => (rate_hz, false),
                (None, Kind::VnText) => (DEFAULT_VN_RATE_HZ, true),
                (None, Kind::Csv) => return Err(RecordingError::NoRate { file: file.to_owned() }),
            }
        };
        let first_stamp_ns = survey.first_stamp_ns.unwrap_or(0);
        let (conversions, ignored_columns) = source.about();
        let info = RecordingInfo {
            file: file.to_owned(),
            kind,
            channels: survey.channels,
            decimals: source.rows().decimals().clone(),
            conversions,
            ignored_columns,
            stamps,
            rate_hz,
            rate_assumed,
            unused_rate_hz: options.rate_hz.filter(|_| stamped),
            started_utc_ns: if stamps == Stamps::Unix { first_stamp_ns } else { options.started_utc_ns },
            samples: survey.samples,
            rejected: survey.rejected,
            first_rejected: survey.first_rejected,
            first_stamp_ns,
        };
        Ok(Self { info })
    }

    /// What the first pass found.
    #[must_use]
    pub fn info(&self) -> &RecordingInfo {
        &self.info
    }

    /// The second pass: samples and rejected lines in the file's order.
    ///
    /// # Errors
    /// [`RecordingError`] where the file cannot be opened any more.
    pub fn items(&self) -> Result<Items, RecordingError> {
        let (_, source) = Source::open(&self.info.file, self.info.kind)?;
        Ok(Items {
            source,
            order: Order::default(),
            first_stamp_ns: self.info.first_stamp_ns,
            started_utc_ns: self.info.started_utc_ns,
            period_ns: period_ns(self.info.rate_hz),
            position: 0,
            failed: false,
        })
    }
}

/// A recording's samples and rejected lines.
pub struct Items {
    source: Source,
    order: Order,
    first_stamp_ns: i64,
    started_utc_ns: i64,
    period_ns: f64,
    /// Without stamps: the next sample's place, rejected lines counted.
    position: u64,
    failed: bool,
}

impl std::fmt::Debug for Items {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Items").field("position", &self.position).finish_non_exhaustive()
    }
}

impl Items {
    fn next_item(&mut self) -> Result<Option<Item>, RecordingError> {
        loop {
            let Some(row) = self.source.rows().next_row()? else { return Ok(None) };
            match self.order.check(row) {
                Row::Aside => {}
                Row::Rejected(rejected) => {
                    // A line before the first sample belongs to no gap.
                    self.position += u64::from(rejected.stands_for_sample && self.position > 0);
                    return Ok(Some(Item::Rejected(rejected)));
                }
                Row::Sample { stamp_ns, mut sample, .. } => {
                    let since_start_ns = match stamp_ns {
                        Some(stamp_ns) => {
                            let since_start_ns = stamp_ns.saturating_sub(self.first_stamp_ns);
                            sample.device_time_ns = u64::try_from(since_start_ns).ok();
                            since_start_ns
                        }
                        None => (self.position as f64 * self.period_ns).round() as i64,
                    };
                    self.position += 1;
                    sample.host_utc_ns = self.started_utc_ns.saturating_add(since_start_ns);
                    return Ok(Some(Item::Sample(sample)));
                }
            }
        }
    }
}

impl Iterator for Items {
    type Item = Result<Item, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = self.next_item();
        self.failed = next.is_err();
        next.transpose()
    }
}

/// A file being read, of either kind.
enum Source {
    Csv(Box<csv::CsvRows>),
    VnText(Box<vn_text::VnRows>),
}

impl Source {
    fn open(file: &Path, kind: Kind) -> Result<(Kind, Self), RecordingError> {
        let source = match kind {
            Kind::Csv => Self::Csv(Box::new(csv::CsvRows::open(file)?)),
            Kind::VnText => Self::VnText(Box::new(vn_text::VnRows::open(file)?)),
        };
        Ok((kind, source))
    }
    fn rows(&mut self) -> &mut dyn Rows {
        match self {
            Self::Csv(rows) => rows.as_mut(),
            Self::VnText(rows) => rows.as_mut(),
        }
    }
    fn about(&self) -> (Vec<Conversion>, Vec<String>) {
        match self {
            Self::Csv(rows) => (rows.header.conversions.clone(), rows.header.ignored.clone()),
            Self::VnText(rows) => (Vec::new(), rows.ignored().to_vec()),
        }
    }
}

/// Keeps stamps increasing: what is not later than the sample before is turned into a rejected line.
#[derive(Debug, Default)]
struct Order {
    last_stamp_ns: Option<i64>,
}

impl Order {
    fn check(&mut self, row: Row) -> Row {
        let Row::Sample { line, stamp_ns: Some(stamp_ns), .. } = &row else { return row };
        if self.last_stamp_ns.is_some_and(|last| *stamp_ns <= last) {
            let text =
                format!("stamp {} s is not later than the one before", *stamp_ns as f64 / NANOS_PER_SECOND as f64);
            return Row::Rejected(Rejected::new(*line, DiscardCause::Duplicate, &text, false));
        }
        self.last_stamp_ns = Some(*stamp_ns);
        row
    }
}

/// What the first pass counts.
#[derive(Debug, Default)]
struct Survey {
    lines: u64,
    rejected_lines: u64,
    samples: u64,
    channels: ChannelSet,
    first_stamp_ns: Option<i64>,
    steps: StepMedian,
    rejected: BTreeMap<DiscardCause, u64>,
    first_rejected: Vec<Rejected>,
}

impl Survey {
    fn of(rows: &mut dyn Rows) -> Result<Self, RecordingError> {
        let mut survey = Self::default();
        let mut order = Order::default();
        while let Some(row) = rows.next_row()? {
            survey.lines += 1;
            let last_stamp_ns = order.last_stamp_ns;
            match order.check(row) {
                Row::Aside => {}
                Row::Sample { stamp_ns, sample, .. } => {
                    survey.samples += 1;
                    survey.channels = survey.channels.union(sample.channels());
                    survey.first_stamp_ns = survey.first_stamp_ns.or(stamp_ns);
                    if let (Some(last), Some(stamp)) = (last_stamp_ns, stamp_ns) {
                        survey.steps.add(stamp.abs_diff(last));
                    }
                }
                Row::Rejected(rejected) => {
                    survey.rejected_lines += 1;
                    *survey.rejected.entry(rejected.cause).or_default() += rejected.amount();
                    if survey.first_rejected.len() < REJECTED_KEPT {
                        survey.first_rejected.push(rejected);
                    }
                }
            }
        }
        Ok(survey)
    }

    fn no_sample(&self, file: &Path) -> RecordingError {
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
