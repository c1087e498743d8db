//! Recordings: files of samples that other programs wrote, read as if they had been captured.
//!
//! In: a path to a table (docs/formats.md; CSV, Parquet, arrays, logs of PX4 and ArduPilot) or raw `$VN…` lines, either
//! also compressed, raw bytes of a VN-100, a ROS 1 or ROS 2 bag, or an MCAP file. Out: a [`RecordingInfo`] from a first
//! pass over the file, then its samples one by one ([`Recording::items`]), [`Record`](imu_core::sample::Record)s
//! ([`account`]), or whole columns ([`load_columns`]).
//!
//! Guarantees: memory does not grow with the file (except with [`load_columns`], and for arrays and KITTI's
//! folders). Compressed data expands to no more than [`RecordingError::Expands`] states. A reading that is no
//! longer wanted ends within 64 KiB ([`KeepOn`]). No line is dropped without being counted, with its number, cause
//! and text. Samples are never reordered: one whose stamp is not later than the one before is rejected as a
//! duplicate, one whose stamp lies ahead of those that follow as malformed. Values are those of the text, converted
//! only if the column's unit is not the channel's.
//!
//! A part ([`Options::part`]) is read as if the file had no more.
//!
//! Times: of several stamps the smoothest is used ([`choice`]). A sample's `device_time_ns` is its stamp counted from
//! the first one. Its UTC is the stamp if stamps are seconds since 1970, else counted from [`Options::started_utc_ns`].

pub mod account;
pub mod choice;
pub mod detect;
pub mod error;
pub mod findings;
pub mod info;
pub mod input;
pub mod load;
pub mod rows;

#[cfg(test)]
mod damaged_tests;
#[cfg(test)]
mod remark_tests;
#[cfg(test)]
mod tests;

mod between;
mod columns;
mod csv;
mod doubts;
mod folder;
mod grid;
mod header;
mod kind;
mod mapping;
mod meter;
mod names;
mod number;
mod order;
mod pairs;
mod part;
mod placing;
mod propose;
mod quantum;
mod remarks;
mod ros;
mod siblings;
mod stamps;
mod survey;
mod table;
mod turning;
mod utf16;
mod values;
mod vn_binary;
mod vn_stamps;
mod vn_text;
mod vocabulary;

pub use account::RecordingAccountant;
pub use choice::StampChoice;
pub use detect::detect;
pub use error::RecordingError;
pub use findings::{Doubt, Findings, Pairs, Quantisation};
pub use folder::{is_recording_folder, recording_file, recording_files};
pub use grid::StampGrid;
pub use info::{Conversion, RecordingInfo, Stamps};
pub use input::{Input, open_regular, read_small};
pub use kind::Kind;
pub use load::{LoadedColumn, LoadedRecording, columns, load_columns};
pub use mapping::{ColumnMap, ColumnsError};
pub use meter::KeepOn;
pub use names::COUNTS;
pub use part::{Part, PartEnd};
pub use ros::{DefinitionError, MessageDefinition, is_type_name, unmerged_log};
pub use rows::{Decimals, Rejected};

use choice::{Chosen, choose, choose_of_columns};
use imu_core::sample::{Channel, ChannelSet, Sample};
use imu_core::units::{NANOS_PER_SECOND, period_ns};
use order::{Entry, Order};
use part::{Cut, Reading};
use placing::Placing;
use rows::Rows;
use stamps::UNIX_FROM_NS;
use std::path::Path;
use survey::Survey;

/// The rate assumed for raw `$VN…` lines if nothing states it: register 7's default (docs/formats.md).
pub const DEFAULT_VN_RATE_HZ: f64 = 40.0;
/// Rejected lines that are kept with their text.
pub const REJECTED_KEPT: usize = 100;
/// A given rate that is closer than this to that of the stamps is theirs by another clock; one farther off overrides
/// them.
const RATE_NEAR: f64 = 0.01;
/// If a larger share of the stamps leaves the grid, the grid is not that of the whole recording.
const SLIPS_MOST: f64 = 2e-3;

/// The caller's knowledge about a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// Samples per second. For a recording with stamps it overrides theirs; stamps that differ by more than 1 % are not
    /// used at all.
    pub rate_hz: Option<f64>,
    /// UTC of the recording's start, ns since 1970, used if it has no stamps since 1970: for example the time of the
    /// import.
    pub started_utc_ns: i64,
    /// Definitions of messages that a bag lacks.
    pub definitions: Vec<MessageDefinition>,
    /// The wanted part.
    pub part: Part,
}

/// One line's outcome.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// A sample with its times, and the number of samples missing before it; `None` if no stamps determine it.
    Sample(Sample, Option<u64>),
    /// A line that is not a sample.
    Rejected(Rejected),
}

/// A recording after its first pass.
#[derive(Debug)]
pub struct Recording {
    input: Input,
    layout: Layout,
    info: RecordingInfo,
}

impl Recording {
    /// Reads the whole file once and determines its kind, channels, rate and counts.
    ///
    /// # Errors
    /// [`RecordingError`] if it is of no known kind, has no sample, or no rate can be determined.
    pub fn open(file: &Path, options: Options) -> Result<Self, RecordingError> {
        Self::read(Input::file(file), options)
    }

    /// Reads any input as [`Self::open`] reads a file.
    ///
    /// # Errors
    /// The errors of [`Self::open`].
    pub fn read(input: Input, options: Options) -> Result<Self, RecordingError> {
        if let Some(rate_hz) = options.rate_hz.filter(|rate| !(rate.is_finite() && *rate > 0.0)) {
            return Err(RecordingError::Rate { found: rate_hz });
        }
        let input = folder::resolved(input)?;
        let layout = Layout::find(&input, &options)?;
        let whole = Self::surveyed(input, layout, &options, None)?;
        if options.part.is_whole() {
            return Ok(whole);
        }
        let Self { input, mut layout, info } = whole;
        layout.cut = Some(options.part.cut(&layout, &info)?);
        if options.part.channels.is_some() {
            layout.find_grid(&input, options.rate_hz)?;
        }
        Self::surveyed(input, layout, &options, Some(&info))
    }

    /// Passes over the file; `whole` is the result for the whole recording if a part of it is read.
    fn surveyed(
        input: Input,
        mut layout: Layout,
        options: &Options,
        whole: Option<&RecordingInfo>,
    ) -> Result<Self, RecordingError> {
        let file = input.path();
        let mut reading = layout.open(&input)?;
        let mut survey = Survey::of(&mut reading, &layout.chosen)?;
        if let Some(grid) = survey.another_grid(layout.chosen.grid.as_ref()) {
            layout.chosen.grid = Some(grid);
            reading = layout.open(&input)?;
            survey = Survey::of(&mut reading, &layout.chosen)?;
        }
        let source = &reading.source;
        if survey.samples == 0 {
            return Err(whole.map_or_else(|| survey.no_sample(file), Part::nothing));
        }
        let stamps = match survey.first_stamp_ns {
            None => Stamps::None,
            Some(first) if first >= UNIX_FROM_NS => Stamps::Unix,
            Some(_) => Stamps::Relative,
        };
        let stamped = stamps != Stamps::None;
        let commented_rate_hz = source.commented_rate_hz().filter(|_| options.rate_hz.is_none());
        let no_step = || RecordingError::NoStep { file: file.to_owned(), samples: survey.samples };
        let (rate_hz, rate_assumed) = match (options.rate_hz, layout.kind) {
            (Some(given_hz), _) => (given_hz, false),
            _ if stamped => (NANOS_PER_SECOND as f64 / survey.period_ns().ok_or_else(no_step)?, false),
            (None, kind) => match (commented_rate_hz, kind) {
                (Some(rate_hz), _) => (rate_hz, false),
                (None, Kind::VnText | Kind::Bag | Kind::Db3 | Kind::Mcap) => (DEFAULT_VN_RATE_HZ, true),
                (None, _) => {
                    return Err(RecordingError::NoRate { file: file.to_owned(), proposed: source.proposed_time() });
                }
            },
        };
        let first_stamp_ns = survey.first_stamp_ns.unwrap_or(0);
        let started_utc_ns = if stamps == Stamps::Unix { first_stamp_ns } else { options.started_utc_ns };
        let (conversions, ignored_columns) = source.about();
        let counts = conversions.iter().find(|of| of.original_unit == COUNTS);
        if let Some(counts) = counts.filter(|_| !input.takes_counts()) {
            let (column, channel) = (error::short(&counts.column), counts.channel);
            return Err(RecordingError::Counts { file: file.to_owned(), column, channel });
        }
        let findings = survey.findings(rate_hz, stamps, &conversions, source.decimals());
        let stamps_hz = match (options.rate_hz, layout.chosen.overridden_hz) {
            (Some(_), None) if stamped => survey.period_ns().map(|period_ns| NANOS_PER_SECOND as f64 / period_ns),
            (_, overridden_hz) => overridden_hz,
        };
        let info = RecordingInfo {
            file: file.to_owned(),
            kind: layout.kind,
            channels: survey.channels,
            decimals: source.decimals().clone(),
            conversions,
            ignored_columns,
            second_columns: source.columns().map(|columns| columns.second.clone()).unwrap_or_default(),
            stamps,
            stamp_choice: source.stamp_choice(&layout.chosen).filter(|_| stamped),
            findings: Findings {
                restarts: source.restarts(),
                absent: survey.absent(survey.channels.union(layout.wanted(source.claimed()))),
                commented_rate_hz: commented_rate_hz.filter(|_| !stamped),
                ..findings
            },
            rate_hz,
            rate_assumed,
            unused_rate_hz: commented_rate_hz.filter(|_| stamped),
            overridden_rate_hz: stamps_hz,
            stamp_grid: layout.chosen.grid.clone().filter(|_| stamped),
            started_utc_ns,
            samples: survey.samples,
            rejected: survey.rejected,
            first_rejected: survey.first_rejected,
            first_stamp_ns,
        };
        Ok(Self { info, layout, input })
    }

    /// Returns the result of the first pass.
    pub fn info(&self) -> &RecordingInfo {
        &self.info
    }

    /// Returns the second pass: samples and rejected lines in the file's order.
    ///
    /// # Errors
    /// [`RecordingError`] if the file can no longer be opened.
    pub fn items(&self) -> Result<Items, RecordingError> {
        Ok(Items {
            reading: self.layout.open(&self.input)?,
            placing: Placing::new(&self.layout.chosen),
            last_ns: None,
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
    reading: Reading,
    placing: Placing,
    /// The last sample's time since the first stamp, ns.
    last_ns: Option<i64>,
    first_stamp_ns: i64,
    started_utc_ns: i64,
    period_ns: f64,
    /// Without stamps: the next sample's position, rejected lines included.
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
            let Some((entry, placed)) = self.placing.next_entry(&mut self.reading)? else { return Ok(None) };
            match entry {
                Entry::Aside => {}
                Entry::Rejected(mut rejected, stamp_ns) => {
                    // A line before the first sample belongs to no gap.
                    self.position += u64::from(rejected.stands_for_sample && self.position > 0);
                    rejected.at = stamp_ns.and_then(|stamp_ns| {
                        let since_start_ns = stamp_ns.saturating_sub(self.first_stamp_ns);
                        let utc_ns = self.started_utc_ns.saturating_add(since_start_ns);
                        u64::try_from(since_start_ns).ok().map(|device_ns| (device_ns, utc_ns))
                    });
                    return Ok(Some(Item::Rejected(rejected)));
                }
                Entry::Sample { stamp_ns, mut sample } => {
                    let since_start_ns = match stamp_ns {
                        Some(stamp_ns) => {
                            let since_start_ns = stamp_ns.saturating_sub(self.first_stamp_ns);
                            // Times increase, regardless of rounding and jitter.
                            let since_start_ns = self.last_ns.map_or(0, |last| since_start_ns.max(last + 1));
                            self.last_ns = Some(since_start_ns);
                            sample.device_time_ns = u64::try_from(since_start_ns).ok();
                            since_start_ns
                        }
                        None => (self.position as f64 * self.period_ns).round() as i64,
                    };
                    self.position += 1;
                    sample.host_utc_ns = self.started_utc_ns.saturating_add(since_start_ns);
                    return Ok(Some(Item::Sample(sample, placed.map(|placed| placed.missing))));
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

/// How a recording is read: determined once, the same for every pass.
#[derive(Debug)]
struct Layout {
    kind: Kind,
    chosen: Chosen,
    /// The topics of a bag.
    topics: Option<ros::Topics>,
    /// What is kept of the rows, if not all of them.
    cut: Option<Cut>,
}

impl Layout {
    /// Returns those of these channels that are wanted.
    fn wanted(&self, channels: ChannelSet) -> ChannelSet {
        let is_wanted = |channel: &Channel| self.cut.as_ref().is_none_or(|cut| cut.channels.contains(*channel));
        channels.iter().filter(is_wanted).collect()
    }

    fn find(input: &Input, options: &Options) -> Result<Self, RecordingError> {
        let kind = detect(input)?;
        let has_columns = !input.columns().is_empty();
        let of_no_csv = |found| RecordingError::ColumnsOfNoCsv { file: input.path().to_owned(), found };
        if let Some(found) = kind.without_columns().filter(|_| has_columns) {
            return Err(of_no_csv(found));
        }
        let (chosen, topics) = match kind {
            Kind::Csv => {
                let mut rows = csv::CsvRows::open(input)?;
                let count = rows.header.columns.stamps.len();
                (choose_of_columns(&mut rows, count)?, None)
            }
            Kind::VnText => (choose(&mut vn_text::VnRows::open(input, None)?)?, None),
            Kind::RawBytes => (choose(&mut vn_binary::BinaryRows::open(input)?)?, None),
            Kind::Bag | Kind::Db3 | Kind::Mcap => {
                let topics = ros::Topics::find(kind, input, &options.definitions)?;
                (choose(&mut ros::RosRows::open(input, &topics)?)?, Some(topics))
            }
            _ => {
                let mut rows = table::TableRows::open(kind, input)?;
                let count = rows.columns.stamps.len();
                (choose_of_columns(&mut rows, count)?, None)
            }
        };
        let mut layout = Self { kind, chosen, topics, cut: None };
        layout.find_grid(input, options.rate_hz)?;
        Ok(layout)
    }

    /// Finds the grid of the first stamps, unless the given rate overrides them.
    fn find_grid(&mut self, input: &Input, given_hz: Option<f64>) -> Result<(), RecordingError> {
        if self.chosen.column.is_none() {
            return Ok(());
        }
        let mut reading = self.open(input)?;
        let (mut order, mut first) = (Order::new(&self.chosen), Vec::new());
        while first.len() < grid::LOOK_AT
            && let Some(entry) = order.next_entry(&mut reading)?
        {
            if let Entry::Sample { stamp_ns: Some(stamp_ns), .. } = entry {
                first.push(stamp_ns);
            }
        }
        self.chosen.grid = grid::find(&first);
        if let (Some(given_hz), Some(grid)) = (given_hz, &self.chosen.grid) {
            let stamps_hz = NANOS_PER_SECOND as f64 / grid.period_ns;
            if (given_hz / stamps_hz - 1.0).abs() > RATE_NEAR {
                self.chosen = Chosen { overridden_hz: Some(stamps_hz), count: self.chosen.count, ..Chosen::default() };
            }
        }
        Ok(())
    }

    fn open(&self, input: &Input) -> Result<Reading, RecordingError> {
        // A sensor's own clock starts again with a reset, and the stamps of bags are the host's.
        let can_turn = !matches!(self.kind, Kind::RawBytes | Kind::Bag | Kind::Db3 | Kind::Mcap);
        let turning = self.chosen.column.filter(|_| can_turn);
        self.source(input).map(|source| Reading::new(source, self.cut.clone(), turning))
    }

    fn source(&self, input: &Input) -> Result<Source, RecordingError> {
        if let Some(topics) = &self.topics {
            return Ok(Source::Ros(Box::new(ros::RosRows::open(input, topics)?), topics.clone()));
        }
        Ok(match self.kind {
            Kind::Csv => Source::Csv(Box::new(csv::CsvRows::open(input)?)),
            Kind::RawBytes => Source::RawBytes(Box::new(vn_binary::BinaryRows::open(input)?)),
            Kind::VnText => Source::VnText(Box::new(vn_text::VnRows::open(input, Some(self.chosen.count))?)),
            kind => Source::Table(Box::new(table::TableRows::open(kind, input)?)),
        })
    }
}

/// A file being read, of any kind.
enum Source {
    Csv(Box<csv::CsvRows>),
    VnText(Box<vn_text::VnRows>),
    RawBytes(Box<vn_binary::BinaryRows>),
    Table(Box<table::TableRows>),
    Ros(Box<ros::RosRows>, ros::Topics),
}

impl Source {
    fn rows(&mut self) -> &mut dyn Rows {
        match self {
            Self::Csv(rows) => rows.as_mut(),
            Self::VnText(rows) => rows.as_mut(),
            Self::RawBytes(rows) => rows.as_mut(),
            Self::Table(rows) => rows.as_mut(),
            Self::Ros(rows, _) => rows.as_mut(),
        }
    }
    /// Returns how the values read so far were written.
    fn decimals(&self) -> &Decimals {
        match self {
            Self::Csv(rows) => rows.decimals(),
            Self::VnText(rows) => rows.decimals(),
            Self::RawBytes(rows) => rows.decimals(),
            Self::Table(rows) => rows.decimals(),
            Self::Ros(rows, _) => rows.decimals(),
        }
    }
    /// Returns the columns of a table.
    fn columns(&self) -> Option<&columns::Columns> {
        match self {
            Self::Csv(rows) => Some(&rows.header.columns),
            Self::Table(rows) => Some(&rows.columns),
            _ => None,
        }
    }
    fn about(&self) -> (Vec<Conversion>, Vec<String>) {
        if let Some(columns) = self.columns() {
            return (columns.conversions.clone(), columns.ignored.clone());
        }
        match self {
            Self::VnText(rows) => (Vec::new(), rows.ignored().to_vec()),
            Self::Ros(_, topics) => (topics.conversions(), topics.ignored()),
            _ => (Vec::new(), Vec::new()),
        }
    }
    /// Returns the channels that the file declares.
    fn claimed(&self) -> ChannelSet {
        let channel = |column: &columns::Column| match column {
            columns::Column::Value { channel, .. } => Some(*channel),
            _ => None,
        };
        self.columns().map(|columns| columns.list.iter().filter_map(channel).collect()).unwrap_or_default()
    }
    /// Returns how often the sensor's clock restarted.
    fn restarts(&self) -> u64 {
        if let Self::RawBytes(rows) = self { rows.restarts() } else { 0 }
    }
    /// Returns the rate that the file itself states for samples without stamps, Hz.
    fn commented_rate_hz(&self) -> Option<f64> {
        match self {
            Self::Csv(rows) => rows.commented_rate_hz,
            _ => None,
        }
    }
    /// Returns the pair that would name a column of times.
    fn proposed_time(&self) -> Option<String> {
        self.columns()?.proposed_time.clone()
    }
    fn stamp_choice(&self, chosen: &Chosen) -> Option<StampChoice> {
        let column = chosen.column?;
        let name = match self {
            Self::Csv(_) | Self::Table(_) => self.columns()?.stamps.get(column).cloned().unwrap_or_default(),
            Self::VnText(_) if chosen.count == 1 => "number before $VN".to_owned(),
            Self::VnText(_) => format!("number {} of {} before $VN", column + 1, chosen.count),
            Self::RawBytes(_) => "sensor's time since its start".to_owned(),
            Self::Ros(..) => ros::STAMP_NAMES.get(column).copied().unwrap_or_default().to_owned(),
        };
        let unit = if let Self::VnText(rows) = self { rows.unit(column) } else { None };
        let (regular, pairs) = (chosen.regular.clone(), chosen.pairs.clone());
        Some(StampChoice { name, column: column + 1, regular, pairs, unit })
    }
}
