//! Reading: a recording's file as steps that a capture is made of. The database has no part in it, so that another process may
//! do it.

use super::ImportError;
use crate::clock::rfc3339;
use crate::control::{ConversionReport, ImportReport, ImportRequest, RejectedReport};
use crate::jobs;
use crate::store::Moment;
use imu_core::sample::{CaptureConfiguration, Channel, Record, StatedSampling, Timebase};
use imu_core::units::NANOS_PER_SECOND;
use imu_files::recording::{
    ColumnMap, Conversion, Findings, Input, KeepOn, Kind, MessageDefinition, Options, Part, PartEnd, Recording,
    RecordingAccountant, RecordingError, RecordingInfo, Rejected, StampChoice, Stamps, detect, open_regular,
    recording_files, unmerged_log,
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// The number of records of one step.
const RECORDS: usize = 2048;

/// Bytes that are hashed at a time.
const HASH_BYTES: usize = 256 * 1024;

/// A recording's file, and the options for reading it.
#[derive(Debug, Clone)]
pub struct Source<'a> {
    /// The path of its bytes.
    pub file: &'a Path,
    /// The recording's original file name.
    pub called: &'a Path,
    /// Rate of a recording without stamps, Hz.
    pub rate_hz: Option<f64>,
    /// The sampling.
    pub sampling: Option<StatedSampling>,
    /// The map of the columns of a foreign CSV.
    pub columns: ColumnMap,
    /// Definitions of messages that a bag lacks.
    pub definitions: Vec<MessageDefinition>,
    /// The wanted part.
    pub part: Part,
    /// A note about the capture.
    pub note: Option<String>,
    /// Reports whether the import is still wanted.
    pub keep_on: KeepOn,
}

impl<'a> Source<'a> {
    /// Returns a source with the file's own name, without further options.
    pub fn of(file: &'a Path) -> Self {
        Self {
            file,
            called: file,
            rate_hz: None,
            sampling: None,
            columns: ColumnMap::default(),
            definitions: Vec::new(),
            part: Part::default(),
            note: None,
            keep_on: KeepOn::default(),
        }
    }

    /// Returns the source that a request names.
    pub(super) fn of_request(request: &'a ImportRequest, keep_on: KeepOn) -> Result<Self, ImportError> {
        let definitions = request.definitions.iter().map(|given| MessageDefinition::new(&given.name, &given.text));
        let definitions = definitions.collect::<Result<_, _>>().and_then(MessageDefinition::list)?;
        let columns = ColumnMap::parse(request.columns.as_slice())?;
        let internal_rate_hz = request.internal_rate_hz;
        let sampling = request.filter_window.map(|filter_window| StatedSampling { filter_window, internal_rate_hz });
        let (file, called, rate_hz) = (request.file.as_path(), Path::new(&request.called), request.rate_hz);
        let refused = |what: &str| ImportError::Refused(format!("the import's part has no {what} that can be read"));
        let end = |text: &Option<String>, what| {
            text.as_deref().map(|text| Moment::parse(text).map(PartEnd::from).ok_or_else(|| refused(what))).transpose()
        };
        let channels = request.channels.as_deref().map(Channel::list).transpose();
        let part = Part {
            from: end(&request.from, "begin")?,
            to: end(&request.to, "end")?,
            channels: channels.map_err(|error| ImportError::Refused(error.to_string()))?,
        };
        Ok(Self { file, called, rate_hz, sampling, columns, definitions, part, note: None, keep_on })
    }
}

impl From<Moment> for PartEnd {
    fn from(moment: Moment) -> Self {
        match moment {
            Moment::Utc(utc_ns) => Self::Utc(utc_ns),
            Moment::Since(ns) => Self::Since(ns),
        }
    }
}

/// A part of a recording, in this order; records come in as many parts as they need.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    /// Identifies the content and how it is read.
    Identified(String),
    /// The facts about the recording.
    Found(Box<Facts>),
    /// The records of the capture.
    Records(Vec<Record>),
    /// The end: the time of the last sample, UTC ns, and the counts of samples, missing samples and gaps.
    Ended(i64, [u64; 3]),
}

/// The facts about a recording that its capture and its report need.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Facts {
    /// The report, without the capture and its counts.
    pub report: ImportReport,
    /// The capture's configuration.
    pub configuration: CaptureConfiguration,
    /// The channels.
    pub channels: Vec<ChannelFacts>,
    /// The time of the first sample, UTC ns.
    pub started_utc_ns: i64,
    /// Number of samples that follow.
    pub samples: u64,
}

/// The facts about a channel of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ChannelFacts {
    pub channel: Channel,
    /// The unit of the file and the factor from it, if it is another.
    pub converted: Option<(String, f64)>,
    /// The smallest step of the values.
    pub resolution: Option<f64>,
}

/// Reads a recording. `take` receives each step and returns whether the next one is wanted.
pub(super) fn read(
    source: Source<'_>,
    started_utc_ns: i64,
    take: &mut dyn FnMut(Step) -> Result<bool, ImportError>,
) -> Result<(), ImportError> {
    let Source { file, called, rate_hz, sampling, columns, definitions, part, keep_on, .. } = source;
    let sampling = sampling.map(StatedSampling::kept);
    // A file that is no recording is refused before all of it is read.
    let input = Input::file(file).while_wanted(keep_on.clone()).with_columns(columns.clone());
    detect(&input)?;
    let mut fingerprint = fingerprint(file, (rate_hz, sampling, &columns, &definitions), &keep_on)?;
    fingerprint += &of_part(&part);
    if !take(Step::Identified(fingerprint))? {
        return Ok(());
    }
    let statements = Statements {
        sampling,
        columns: columns.pairs().collect(),
        definitions: definitions.iter().map(|definition| definition.name().to_owned()).collect(),
        part: Some(of_part(&part).trim().to_owned()).filter(|part| !part.is_empty()),
    };
    let recording = Recording::read(input, Options { rate_hz, started_utc_ns, definitions, part })?;
    let mut info = recording.info().clone();
    info.file = called.to_owned();
    if let Some(stated) = sampling {
        jobs::sampling(stated, &BTreeMap::new(), info.rate_hz)?;
    }
    let mut accountant = RecordingAccountant::new(&info);
    if !take(Step::Found(Box::new(facts(&info, &statements))))? {
        return Ok(());
    }
    let mut out = Vec::new();
    for item in recording.items()? {
        accountant.take(item?, &mut out);
        if out.len() >= RECORDS && !take(Step::Records(std::mem::take(&mut out)))? {
            return Ok(());
        }
    }
    if take(Step::Records(out))? {
        let counts = [accountant.received(), accountant.missing(), accountant.gaps()];
        take(Step::Ended(accountant.last_utc_ns(), counts))?;
    }
    Ok(())
}

fn facts(info: &RecordingInfo, statements: &Statements) -> Facts {
    let conversions = info.conversions.iter().map(|conversion| ConversionReport {
        channel: conversion.channel.name().to_owned(),
        column: conversion.column.clone(),
        original_unit: conversion.original_unit.to_owned(),
        factor: conversion.factor,
    });
    let rejected = |rejected: &Rejected| RejectedReport {
        entry: info.kind.entry().to_owned(),
        line: rejected.line,
        cause: rejected.cause.name().to_owned(),
        text: rejected.text.clone(),
    };
    let report = ImportReport {
        file: info.file.display().to_string(),
        capture: 0,
        new: false,
        samples: 0,
        missing: 0,
        gaps: 0,
        rate_hz: info.rate_hz,
        rate_assumed: info.rate_assumed,
        rejected: info.rejected.iter().map(|(cause, count)| (cause.name().to_owned(), *count)).collect(),
        first_rejected: info.first_rejected.iter().map(rejected).collect(),
        stamps: json(&info.stamps).as_str().unwrap_or_default().to_owned(),
        stamp_choice: info.stamp_choice.as_ref().map(json),
        findings: json(&info.findings),
        remarks: info.remarks(),
        ignored_columns: info.ignored_columns.clone(),
        conversions: conversions.collect(),
    };
    Facts {
        report,
        configuration: configuration(info, statements),
        channels: channels(info),
        started_utc_ns: info.started_utc_ns,
        samples: info.samples,
    }
}

/// Returns a plain value as JSON.
fn json(value: &impl Serialize) -> serde_json::Value {
    serde_json::to_value(value).unwrap_or_default()
}

/// Identifies the recording's content and how it is read.
fn fingerprint(
    file: &Path,
    (rate_hz, sampling, columns, definitions): (Option<f64>, Option<StatedSampling>, &ColumnMap, &[MessageDefinition]),
    keep_on: &KeepOn,
) -> Result<String, ImportError> {
    let mut hash = Sha256::new();
    for file in recording_files(file) {
        update(&mut hash, &file, keep_on)?;
    }
    // The data that a killed recorder had not yet put into the file is read with it.
    if let Some(log) = unmerged_log(file) {
        update(&mut hash, &log, keep_on)?;
    }
    let hex = |hash: Sha256| -> String { hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect() };
    let digest = hex(hash);
    let rate = rate_hz.map(|rate_hz| format!(" rate {rate_hz}")).unwrap_or_default();
    let sampling = sampling.map(|of| format!(" means of {} at {:?}", of.filter_window, of.internal_rate_hz));
    let sampling = sampling.unwrap_or_default();
    let columns = if columns.is_empty() { String::new() } else { format!(" columns {columns}") };
    let mut texts = Sha256::new();
    for definition in definitions {
        // With the lengths, so that no two lists produce the same bytes.
        for text in [definition.name(), definition.text()] {
            texts.update((text.len() as u64).to_le_bytes());
            texts.update(text);
        }
    }
    let definitions = if definitions.is_empty() { String::new() } else { format!(" definitions {}", hex(texts)) };
    Ok(format!("sha256:{digest}{rate}{sampling}{columns}{definitions}"))
}

/// Identifies a part: another part of the same file is another recording. Empty for all of it.
fn of_part(part: &Part) -> String {
    let end = |name: &str, end: Option<PartEnd>| match end {
        None => String::new(),
        Some(PartEnd::Utc(utc_ns)) => format!(" {name} {}", rfc3339(utc_ns)),
        Some(PartEnd::Since(ns)) => format!(" {name} {} s", ns as f64 / NANOS_PER_SECOND as f64),
    };
    let names = |channels: &Vec<Channel>| channels.iter().map(|channel| channel.name()).collect::<Vec<_>>().join(",");
    let channels = part.channels.as_ref().map(|of| format!(" channels {}", names(of))).unwrap_or_default();
    format!("{}{}{channels}", end("from", part.from), end("to", part.to))
}

/// Adds a file's bytes to a digest.
fn update(hash: &mut Sha256, file: &Path, keep_on: &KeepOn) -> Result<(), ImportError> {
    let (mut bytes, mut buffer) = (open_regular(file)?, vec![0; HASH_BYTES]);
    loop {
        if !keep_on.is_wanted() {
            return Err(RecordingError::Unwanted { file: file.to_owned() }.into());
        }
        match bytes.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(read) => hash.update(&buffer[..read]),
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(source) => return Err(ImportError::Read { path: file.display().to_string(), source }),
        }
    }
}

/// The user's statements about a recording: the sampling, pairs of columns, names of message types.
#[derive(Serialize)]
struct Statements {
    sampling: Option<StatedSampling>,
    columns: Vec<String>,
    #[serde(rename = "message_definitions")]
    definitions: Vec<String>,
    /// The part of the file, if not all of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    part: Option<String>,
}

/// The configuration of an imported capture, as the database holds it.
#[derive(Serialize)]
struct ImportedRecording<'a> {
    file: String,
    kind: Kind,
    #[serde(flatten)]
    statements: &'a Statements,
    stamps: Stamps,
    /// The first stamp on the recording's own clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_stamp_s: Option<f64>,
    rate_hz: f64,
    ignored_columns: &'a [String],
    conversions: &'a [Conversion],
    stamp_choice: Option<&'a StampChoice>,
    stamp_grid: Option<GridOfStamps>,
    findings: &'a Findings,
    remarks: Vec<String>,
}

/// The grid on which a recording's stamps lie.
#[derive(Serialize)]
struct GridOfStamps {
    period_s: f64,
    rounding_s: f64,
    jitter_s: f64,
    losses_resolved: bool,
}

/// Returns the capture's configuration.
fn configuration(info: &RecordingInfo, statements: &Statements) -> CaptureConfiguration {
    CaptureConfiguration::of(&ImportedRecording {
        file: info.file.display().to_string(),
        kind: info.kind,
        statements,
        stamps: info.stamps,
        first_stamp_s: (info.timebase() == Timebase::Stamps).then_some(1e-9 * info.first_stamp_ns as f64),
        rate_hz: info.rate_hz,
        ignored_columns: &info.ignored_columns,
        conversions: &info.conversions,
        stamp_choice: info.stamp_choice.as_ref(),
        stamp_grid: info.stamp_grid.as_ref().map(|grid| GridOfStamps {
            period_s: 1e-9 * grid.period_ns,
            rounding_s: 1e-9 * grid.rounding_ns as f64,
            jitter_s: 1e-9 * grid.jitter_ns,
            losses_resolved: grid.resolved,
        }),
        findings: &info.findings,
        remarks: info.remarks(),
    })
}

/// A step that is coarser by no more than this is the same.
const SAME_STEP: f64 = 1.001;

fn channels(info: &RecordingInfo) -> Vec<ChannelFacts> {
    let facts = |channel: Channel| {
        let conversion = info.conversions.iter().find(|conversion| conversion.channel == channel);
        let converted = conversion.map(|conversion| (conversion.original_unit.to_owned(), conversion.factor));
        let factor = conversion.map_or(1.0, |conversion| conversion.factor.abs());
        let written = info.decimals.get(channel).map(|decimals| factor * 10_f64.powi(-i32::from(decimals)));
        // Apart from rounding, an observed step is never finer than the decimals.
        let seen = info.findings.quantisation.get(&channel).map(|found| found.step);
        let resolution = match (written, seen) {
            (Some(written), Some(seen)) if seen > SAME_STEP * written => Some(seen),
            (None, seen) => seen,
            (written, _) => written,
        };
        ChannelFacts { channel, converted, resolution }
    };
    info.channels.iter().map(facts).collect()
}
