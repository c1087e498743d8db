//! Import: converts a recording's file to a capture, complete or not at all; the same file only once.

mod apart;
mod reading;

pub use apart::answer;
pub use reading::Source;

use crate::clock::Clock;
use crate::control::{self, ImportReport, ImportRequest, Importer};
use crate::jobs::{Jobs, SamplingError};
use crate::store::{
    CaptureState, ChannelRow, Import, ImportEnd, NAME_MAX, NewCapture, Store, StoreError, check_name, check_note,
};
use imu_core::sample::Record;
use imu_files::recording::{ColumnsError, DefinitionError, KeepOn, RecordingError};
use reading::{ChannelFacts, Facts, Step};
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
    /// The process that reads the recording refused it.
    #[error("{0}")]
    Refused(String),
    /// The process that reads the recording failed.
    #[error("{0}")]
    Process(String),
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
    /// The outcome in the form for programs.
    pub report: ImportReport,
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
    let mut writing = Writing::begin(store, source.called, (name, source.note.clone()), progress)?;
    reading::read(source, clock.utc_ns(), &mut |step| writing.take(step))?;
    writing.end()
}

/// A capture that is made of the steps of a recording.
struct Writing<'a> {
    store: &'a Store,
    called: &'a Path,
    name: Option<String>,
    note: Option<String>,
    progress: &'a mut dyn FnMut(u64, u64) -> Result<(), ImportError>,
    fingerprint: String,
    facts: Option<Facts>,
    import: Option<Import>,
    written: u64,
    end: Option<(ImportEnd, [u64; 3])>,
}

impl<'a> Writing<'a> {
    /// Begins a capture of a recording of this name. An invalid name or note is refused before anything is read.
    fn begin(
        store: &'a Store,
        called: &'a Path,
        (name, note): (Option<String>, Option<String>),
        progress: &'a mut dyn FnMut(u64, u64) -> Result<(), ImportError>,
    ) -> Result<Self, ImportError> {
        name.as_deref().map(check_name).transpose()?;
        let note = note.as_deref().map(check_note).transpose()?.flatten();
        let (fingerprint, written) = (String::new(), 0);
        Ok(Self { store, called, name, note, progress, fingerprint, facts: None, import: None, written, end: None })
    }

    /// Takes a step; returns whether the next one is wanted.
    fn take(&mut self, step: Step) -> Result<bool, ImportError> {
        match step {
            Step::Identified(fingerprint) => {
                if let Some(name) = &self.name
                    && self.store.imported(&fingerprint)?.is_none()
                    && is_taken(self.store, name)?
                {
                    return Err(StoreError::NameTaken(name.clone()).into());
                }
                self.fingerprint = fingerprint;
            }
            Step::Found(facts) => {
                // A recording that was imported before is not written again; its counts are those in the database. This is
                // checked here, because reading takes time, in which captures come and go.
                if let Some(id) = self.store.imported(&self.fingerprint)? {
                    let capture = self.store.reader()?.capture(id)?;
                    self.end = Some((ImportEnd::Known(id), [capture.samples, capture.missing, capture.gaps]));
                } else {
                    self.import = Some(self.store.begin_import(self.capture(&facts), Some(&self.fingerprint))?);
                }
                self.facts = Some(*facts);
            }
            Step::Records(records) => {
                self.written += records.iter().filter(|record| matches!(record, Record::Sample { .. })).count() as u64;
                if let Some(import) = &mut self.import {
                    records.into_iter().try_for_each(|record| import.push(record))?;
                }
                (self.progress)(self.written, self.facts.as_ref().map_or(0, |facts| facts.samples))?;
            }
            Step::Ended(last_utc_ns, counts) => {
                if let Some(import) = self.import.take() {
                    self.end = Some((import.finish(Some(last_utc_ns))?, counts));
                }
            }
        }
        Ok(self.end.is_none())
    }

    fn capture(&mut self, facts: &Facts) -> NewCapture {
        let mut capture = NewCapture::new(&self.called.display().to_string(), CaptureState::Imported);
        capture.name = self.name.take();
        capture.note = self.note.take();
        capture.liked_name = Some(name_of(self.called));
        capture.started_utc_ns = Some(facts.started_utc_ns);
        capture.rate_assumed = facts.report.rate_assumed;
        capture.configuration = Some(facts.configuration.clone());
        capture.channels = facts.channels.iter().map(row_of).collect();
        capture
    }

    fn end(self) -> Result<Imported, ImportError> {
        let unended = || ImportError::Process("the recording was not read to its end".to_owned());
        let ((end, [samples, missing, gaps]), facts) = self.end.zip(self.facts).ok_or_else(unended)?;
        let new = matches!(end, ImportEnd::Created(_));
        let report = ImportReport { capture: end.id(), new, samples, missing, gaps, ..facts.report };
        Ok(Imported { end, report })
    }
}

fn row_of(facts: &ChannelFacts) -> ChannelRow {
    let row = match &facts.converted {
        Some((unit, factor)) => ChannelRow::converted(facts.channel, unit, *factor),
        None => ChannelRow::plain(facts.channel),
    };
    ChannelRow { resolution: facts.resolution, ..row }
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
        let mut room = |_, _| {
            let free_bytes = self.store.progress().free_bytes;
            if free_bytes < self.reserve_bytes {
                return Err(ImportError::NoRoom { free_mib: free_bytes >> 20, reserve_mib: self.reserve_bytes >> 20 });
            }
            Ok(())
        };
        let called = Path::new(&request.called);
        let name_and_note = (request.name.clone(), request.note.clone());
        let imported = Writing::begin(&self.store, called, name_and_note, &mut room).and_then(|mut writing| {
            apart::read_apart(&request, self.clock.utc_ns(), &keep_on, &mut |step| writing.take(step))?;
            writing.end()
        });
        clear(&request.file);
        let imported = imported.map_err(|error| {
            // The store may be closed while an import has not ended in time: this is no fault of the store.
            if self.stop.is_cancelled() { control::ImportError::Stopping } else { refused(&error, &request) }
        })?;
        if let ImportEnd::Created(id) = imported.end {
            let queued = self.jobs.submit_all(id);
            if let Err(error) = queued {
                tracing::error!(capture = id, %error, "the analysis could not be queued");
            }
        }
        tracing::info!(capture = imported.end.id(), file = %request.called, samples = imported.report.samples, "imported");
        Ok(imported.report)
    }
}

/// Removes what SQLite leaves beside a bag that is a database.
fn clear(file: &Path) {
    for suffix in ["-wal", "-shm"] {
        let mut beside = file.as_os_str().to_owned();
        beside.push(suffix);
        let _ = std::fs::remove_file(beside);
    }
}

/// Returns the error for the client that sent the recording, with the file's name as that client knows it.
fn refused(error: &ImportError, request: &ImportRequest) -> control::ImportError {
    let reason = error.to_string().replace(&request.file.display().to_string(), &request.called);
    match error {
        ImportError::Recording(RecordingError::Unwanted { .. }) => control::ImportError::Stopping,
        ImportError::Recording(_)
        | ImportError::Columns(_)
        | ImportError::Definition(_)
        | ImportError::Sampling(_)
        | ImportError::Refused(_) => control::ImportError::Recording(reason),
        ImportError::Process(_) => control::ImportError::Process(reason),
        ImportError::Store(StoreError::NameTaken(_)) => control::ImportError::NameTaken(reason),
        ImportError::Store(StoreError::NameRefused { .. } | StoreError::NoteRefused(_)) => {
            control::ImportError::NameRefused(reason)
        }
        ImportError::Store(_) | ImportError::Read { .. } | ImportError::NoRoom { .. } => {
            control::ImportError::Store(reason)
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
        Err(StoreError::NoSuchCapture(_)) => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests;
