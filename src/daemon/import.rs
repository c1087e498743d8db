//! Import: converts a recording's file to a capture, complete or not at all; the same file only once.

use crate::clock::Clock;
use crate::control::{self, ConversionReport, ImportReport, ImportRequest, Importer, RejectedReport};
use crate::jobs::{self, Jobs, SamplingError};
use crate::store::{CaptureState, ChannelRow, ImportEnd, NAME_MAX, NewCapture, Store, StoreError, check_name};
use imu_core::sample::{CaptureConfiguration, StatedSampling};
use imu_files::recording::{
    ColumnMap, ColumnsError, Conversion, DefinitionError, Findings, Input, KeepOn, Kind, MessageDefinition, Options,
    Recording, RecordingAccountant, RecordingError, RecordingInfo, Rejected, StampChoice, Stamps, detect, open_regular,
    unmerged_log,
};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// The reasons why a file was not imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The map of its columns is invalid.
    #[error(transparent)]
    Columns(#[from] ColumnsError),
    /// The definition of its messages is invalid.
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    /// The sampling that the import states is impossible.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// The database returned an error.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The file could not be read.
    #[error("{path} cannot be read: {source}")]
    Read {
        /// The file.
        path: String,
        /// The error message of the system.
        source: std::io::Error,
    },
    /// The disk has no room for it.
    #[error("{free_mib} MiB are free and {reserve_mib} MiB are kept for captures: make room and import again")]
    NoRoom {
        /// The free space.
        free_mib: u64,
        /// The space that must stay free.
        reserve_mib: u64,
    },
}

/// The outcome of an import.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The capture: new, or imported before.
    pub end: ImportEnd,
    /// The facts about the recording.
    pub info: RecordingInfo,
    /// Samples, missing samples and gaps.
    pub counts: (u64, u64, u64),
}

impl Imported {
    /// Returns the outcome in the form for programs.
    pub fn report(&self) -> ImportReport {
        let (samples, missing, gaps) = self.counts;
        let conversions = self.info.conversions.iter().map(|conversion| ConversionReport {
            channel: conversion.channel.name().to_owned(),
            column: conversion.column.clone(),
            original_unit: conversion.original_unit.to_owned(),
            factor: conversion.factor,
        });
        let rejected = |rejected: &Rejected| RejectedReport {
            entry: self.info.kind.entry().to_owned(),
            line: rejected.line,
            cause: rejected.cause.name().to_owned(),
            text: rejected.text.clone(),
        };
        ImportReport {
            file: self.info.file.display().to_string(),
            capture: self.end.id(),
            new: matches!(self.end, ImportEnd::Created(_)),
            samples,
            missing,
            gaps,
            rate_hz: self.info.rate_hz,
            rate_assumed: self.info.rate_assumed,
            rejected: self.info.rejected.iter().map(|(cause, count)| (cause.name().to_owned(), *count)).collect(),
            first_rejected: self.info.first_rejected.iter().map(rejected).collect(),
            stamps: json(&self.info.stamps).as_str().unwrap_or_default().to_owned(),
            stamp_choice: self.info.stamp_choice.as_ref().map(json),
            findings: json(&self.info.findings),
            remarks: self.info.remarks(),
            ignored_columns: self.info.ignored_columns.clone(),
            conversions: conversions.collect(),
        }
    }
}

/// Returns a plain value as JSON.
fn json(value: &impl serde::Serialize) -> serde_json::Value {
    serde_json::to_value(value).unwrap_or_default()
}

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
            keep_on: KeepOn::default(),
        }
    }
}

/// Imports one file; `progress` receives the number of samples written and the total, and may end the import.
///
/// # Errors
/// [`ImportError`]; nothing of the recording is kept.
pub fn import(
    store: &Store,
    clock: &dyn Clock,
    source: Source<'_>,
    name: Option<String>,
    progress: &mut dyn FnMut(u64, u64) -> Result<(), ImportError>,
) -> Result<Imported, ImportError> {
    let Source { file, called, rate_hz, sampling, columns, definitions, keep_on } = source;
    let sampling = sampling.map(StatedSampling::kept);
    // An invalid name is refused before anything is read.
    if let Some(name) = &name {
        check_name(name)?;
    }
    // A file that is no recording is refused before all of it is read.
    let input = Input::file(file).while_wanted(keep_on.clone()).with_columns(columns.clone());
    detect(&input)?;
    let fingerprint = fingerprint(file, (rate_hz, sampling, &columns, &definitions), &keep_on)?;
    if let Some(name) = &name
        && store.imported(&fingerprint)?.is_none()
        && is_taken(store, name)?
    {
        return Err(StoreError::NameTaken { name: name.clone() }.into());
    }
    let statements = Statements {
        sampling,
        columns: columns.pairs().collect(),
        definitions: definitions.iter().map(|definition| definition.name().to_owned()).collect(),
    };
    let recording = Recording::read(input, Options { rate_hz, started_utc_ns: clock.utc_ns(), definitions })?;
    let mut info = recording.info().clone();
    info.file = called.to_owned();
    if let Some(stated) = sampling {
        jobs::sampling(stated, &BTreeMap::new(), info.rate_hz)?;
    }
    // A recording that was imported before is not written again; its counts are those in the database. This is checked
    // again here: reading takes time, in which captures come and go.
    if let Some(id) = store.imported(&fingerprint)? {
        let capture = store.reader()?.capture(id)?;
        let counts = (capture.samples, capture.missing, capture.gaps);
        return Ok(Imported { end: ImportEnd::Known(id), counts, info });
    }
    let mut accountant = RecordingAccountant::new(&info);
    let mut capture = NewCapture::new(&called.display().to_string(), CaptureState::Imported);
    capture.name = name;
    capture.liked_name = Some(name_of(called));
    capture.started_utc_ns = Some(info.started_utc_ns);
    capture.rate_assumed = info.rate_assumed;
    capture.configuration = Some(configuration(&info, &statements));
    capture.channels = channels(&info);
    let mut import = store.begin_import(capture, Some(&fingerprint))?;
    let mut out = Vec::new();
    let mut written = 0;
    for item in recording.items()? {
        let item = item?;
        accountant.take(item, &mut out);
        for record in out.drain(..) {
            import.push(record)?;
        }
        if accountant.received() >= written + 10_000 {
            written = accountant.received();
            progress(written, info.samples)?;
        }
    }
    let end = import.finish(Some(accountant.last_utc_ns()))?;
    Ok(Imported { end, counts: (accountant.received(), accountant.missing(), accountant.gaps()), info })
}

/// Imports beside a running capture, for the HTTP interface.
#[derive(Debug)]
pub struct DaemonImporter {
    store: Store,
    jobs: Jobs,
    clock: Arc<dyn Clock>,
    reserve_bytes: u64,
    /// Cancelled when the daemon ends.
    stop: CancellationToken,
    running: TaskTracker,
}

impl DaemonImporter {
    /// Creates an importer that leaves `reserve_bytes` of the disk free. It removes the files that an earlier run of
    /// the daemon left when it was killed: the store's lock shows that no other process uses them.
    pub fn new(store: Store, jobs: Jobs, clock: Arc<dyn Clock>, reserve_bytes: u64) -> Self {
        let folder = store.path().parent().unwrap_or(Path::new("."));
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with(control::IMPORT_PREFIX)
                && let Err(error) = std::fs::remove_file(entry.path())
            {
                tracing::warn!(file = %entry.path().display(), %error, "what is left of an import could not be removed");
            }
        }
        Self { store, jobs, clock, reserve_bytes, stop: CancellationToken::new(), running: TaskTracker::new() }
    }

    /// Refuses further imports, and ends those in progress.
    pub fn call_off(&self) {
        self.stop.cancel();
        self.running.close();
    }

    /// Waits until no import is in progress, at most for `patience`: a disk that hangs may delay an import.
    pub async fn ended(&self, patience: Duration) {
        if tokio::time::timeout(patience, self.running.wait()).await.is_err() {
            tracing::warn!("an import did not end in time: what it wrote is cleared away at the next start");
        }
    }
}

impl Importer for DaemonImporter {
    fn is_stopping(&self) -> bool {
        self.stop.is_cancelled()
    }

    fn import(&self, request: ImportRequest) -> Result<ImportReport, control::ImportError> {
        let _running = self.running.token();
        let (stop, abandoned) = (self.stop.clone(), request.abandoned.clone());
        let keep_on = KeepOn::asking(move || !stop.is_cancelled() && !abandoned.is_cancelled());
        let called = Path::new(&request.called);
        let columns = ColumnMap::parse(request.columns.as_slice());
        let columns = columns.map_err(|error| refused(&error.into(), &request))?;
        let definitions = request.definitions.iter().map(|given| MessageDefinition::new(&given.name, &given.text));
        let definitions = definitions.collect::<Result<_, _>>().and_then(MessageDefinition::list);
        let definitions = definitions.map_err(|error| refused(&error.into(), &request))?;
        let internal_rate_hz = request.internal_rate_hz;
        let sampling = request.filter_window.map(|filter_window| StatedSampling { filter_window, internal_rate_hz });
        let rate_hz = request.rate_hz;
        let source = Source { file: &request.file, called, rate_hz, sampling, columns, definitions, keep_on };
        let mut room = |_, _| {
            let free_bytes = self.store.progress().free_bytes;
            if free_bytes < self.reserve_bytes {
                return Err(ImportError::NoRoom { free_mib: free_bytes >> 20, reserve_mib: self.reserve_bytes >> 20 });
            }
            Ok(())
        };
        let imported =
            import(&self.store, self.clock.as_ref(), source, request.name.clone(), &mut room).map_err(|error| {
                // The store may be closed while an import has not ended in time: this is no fault of the store.
                if self.stop.is_cancelled() { control::ImportError::Stopping } else { refused(&error, &request) }
            })?;
        if let ImportEnd::Created(id) = imported.end {
            let queued = self.jobs.submit_all(id);
            if let Err(error) = queued {
                tracing::error!(capture = id, %error, "the analysis could not be queued");
            }
        }
        tracing::info!(capture = imported.end.id(), file = %request.called, samples = imported.counts.0, "imported");
        Ok(imported.report())
    }
}

/// Returns the error for the client that sent the recording, with the file's name as that client knows it.
fn refused(error: &ImportError, request: &ImportRequest) -> control::ImportError {
    let reason = error.to_string().replace(&request.file.display().to_string(), &request.called);
    match error {
        ImportError::Recording(RecordingError::Unwanted { .. }) => control::ImportError::Stopping,
        ImportError::Recording(_) | ImportError::Columns(_) | ImportError::Definition(_) | ImportError::Sampling(_) => {
            control::ImportError::Recording { reason }
        }
        ImportError::Store(StoreError::NameTaken { .. }) => control::ImportError::NameTaken { reason },
        ImportError::Store(StoreError::NameRefused { .. }) => control::ImportError::NameRefused { reason },
        ImportError::Store(_) | ImportError::Read { .. } | ImportError::NoRoom { .. } => {
            control::ImportError::Store { reason }
        }
    }
}

/// Identifies the recording's content and how it is read.
fn fingerprint(
    file: &Path,
    (rate_hz, sampling, columns, definitions): (Option<f64>, Option<StatedSampling>, &ColumnMap, &[MessageDefinition]),
    keep_on: &KeepOn,
) -> Result<String, ImportError> {
    let mut hash = Sha256::new();
    update(&mut hash, file, keep_on)?;
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

/// Extensions that are not part of a name.
const ENDINGS: [&str; 7] = [".gz", ".csv", ".txt", ".bag", ".db3", ".mcap", ".bin"];

/// Returns the file's name without its extensions, and without characters that a capture's name must not contain.
fn name_of(file: &Path) -> String {
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = ENDINGS.iter().fold(name.as_str(), |stem, ending| stem.trim_end_matches(ending));
    let kept: String = stem.chars().filter(|character| !character.is_control()).take(NAME_MAX).collect();
    kept.trim().to_owned()
}

/// Returns whether a capture has this name.
fn is_taken(store: &Store, name: &str) -> Result<bool, StoreError> {
    match store.reader()?.resolve(name) {
        Ok(_) => Ok(true),
        Err(StoreError::NoSuchCapture { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// The user's statements about a recording: the sampling, pairs of columns, names of message types.
#[derive(Serialize)]
struct Statements {
    sampling: Option<StatedSampling>,
    columns: Vec<String>,
    #[serde(rename = "message_definitions")]
    definitions: Vec<String>,
}

/// The configuration of an imported capture, as the database holds it.
#[derive(Serialize)]
struct ImportedRecording<'a> {
    file: String,
    kind: Kind,
    #[serde(flatten)]
    statements: &'a Statements,
    stamps: Stamps,
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

fn channels(info: &RecordingInfo) -> Vec<ChannelRow> {
    info.channels
        .iter()
        .map(|channel| {
            let conversion = info.conversions.iter().find(|conversion| conversion.channel == channel);
            let mut row = conversion.map_or_else(
                || ChannelRow::plain(channel),
                |conversion| ChannelRow::converted(channel, conversion.original_unit, conversion.factor),
            );
            let factor = conversion.map_or(1.0, |conversion| conversion.factor.abs());
            let written = info.decimals.get(channel).map(|decimals| factor * 10_f64.powi(-i32::from(decimals)));
            // Apart from rounding, an observed step is never finer than the decimals.
            let seen = info.findings.quantisation.get(&channel).map(|found| found.step);
            row.resolution = match (written, seen) {
                (Some(written), Some(seen)) if seen > SAME_STEP * written => Some(seen),
                (None, seen) => seen,
                (written, _) => written,
            };
            row
        })
        .collect()
}

#[cfg(test)]
mod tests;
