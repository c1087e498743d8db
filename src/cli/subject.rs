//! The subject of a drawing: a capture of the database, or a recording's file as the capture that it would become.

use super::analysis::contradicted;
use super::emulate::stop_on_signal;
use super::progress::bar;
use super::source::{self, file, note_assumed_rate, note_assumed_time, note_ignored};
use super::{Context, failed};
use crate::clock::SystemClock;
use crate::daemon::import::{ImportError, Source, import};
use crate::jobs::{Documents, JobError, JobKind, Plan, direct};
use crate::store::{CaptureRow, Reader, Store, StoreOptions};
use anyhow::Context as _;
use imu_core::sample::{Channel, StatedSampling};
use imu_files::recording::{KeepOn, RecordingError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tempfile::TempDir;

/// Maximum delay between a signal and the end of reading.
const SOON: Duration = Duration::from_millis(50);

/// A signal that ends the command, so that nothing half made is left behind.
#[derive(Debug, Clone)]
pub(super) struct Stop(Arc<AtomicBool>);

impl Stop {
    /// From here on, a signal only sets the flag.
    ///
    /// # Errors
    /// The error that the system reports.
    pub(super) fn listen() -> anyhow::Result<Self> {
        Ok(Self(stop_on_signal()?))
    }

    /// Returns a handle that lets a recording be read until then.
    pub(super) fn keep_on(&self) -> KeepOn {
        let stop = self.clone();
        KeepOn::asking(move || !stop.is_wanted())
    }

    fn is_wanted(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Returns the result, unless a signal came, which is then the error.
    ///
    /// # Errors
    /// The result's own error, or that the command was stopped.
    pub(super) fn unless<T>(&self, result: anyhow::Result<T>) -> anyhow::Result<T> {
        if self.is_wanted() {
            return Err(failed("stopped before the end: no file is kept of it"));
        }
        result
    }
}

/// A capture to be read.
#[derive(Debug)]
pub(super) struct Subject {
    /// The database of the capture.
    pub reader: Reader,
    /// The row of the capture; for a running capture, as far as it is committed now.
    pub row: CaptureRow,
    /// Whether it is a recording's file, so that its id has no meaning elsewhere.
    pub of_file: bool,
    /// The command's statement about the sampling.
    stated: Option<StatedSampling>,
    /// Remarks for a page, as sentences.
    pub remarks: Vec<String>,
    /// The folder of the recording's database, kept as long as it is read.
    _folder: Option<TempDir>,
}

impl Subject {
    /// Returns a file if one of that name exists, else a capture. Assumptions are printed on standard error.
    ///
    /// # Errors
    /// If neither can be read, or if a stated sampling is impossible.
    pub(super) fn open(
        context: &Context,
        named: &str,
        rate_hz: Option<f64>,
        stated: Option<StatedSampling>,
        stop: &Stop,
    ) -> anyhow::Result<Self> {
        let keep_on = stop.keep_on();
        let mut subject = match file(named) {
            Some(path) => {
                let (columns, definitions) = (context.columns.clone(), context.definitions.clone());
                let part = context.part.of_recording();
                let source = Source { rate_hz, keep_on, columns, definitions, part, ..Source::of(path) };
                stop.unless(Self::of_recording(source, stop))?
            }
            None => match source::Source::open(context, named, rate_hz, keep_on)? {
                source::Source::Capture(reader, row) => {
                    let (reader, row) = (*reader, *row);
                    let remarks = if context.part.is_whole() {
                        Vec::new()
                    } else {
                        vec![format!("This is a part of capture {}.", row.id)]
                    };
                    Self { reader, row, of_file: false, stated: None, remarks, _folder: None }
                }
                source::Source::Recording(_) => return Err(failed(format!("{named} became a file meanwhile"))),
            },
        };
        if subject.row.rate_assumed {
            note_assumed_rate(named, subject.row.rate_hz.unwrap_or_default());
        }
        if let Some(stated) = stated {
            let row = &subject.row;
            let mut plan = Plan::read(&subject.reader, row.id, row.samples, &Channel::ANALYSED)?;
            plan.sampled(stated).map_err(contradicted)?;
            subject.stated = Some(stated);
        }
        subject.end_with(stop)?;
        Ok(subject)
    }

    /// Imports the recording into a temporary database.
    fn of_recording(source: Source<'_>, stop: &Stop) -> anyhow::Result<Self> {
        let file = source.file;
        let folder = tempfile::Builder::new().prefix("vn100d-").tempdir().context("no temporary folder can be made")?;
        let database = folder.path().join("vn100d.db");
        let store = Store::open(&database, StoreOptions::default())?;
        let bar = bar("{bar:40} {percent} %  {human_pos} samples read", 0);
        let imported = import(&store, &SystemClock, source, None, &mut |written, of| {
            bar.set_length(of);
            bar.set_position(written);
            let unwanted = || ImportError::from(RecordingError::Unwanted { file: file.to_owned() });
            if stop.is_wanted() { Err(unwanted()) } else { Ok(()) }
        })?;
        bar.finish_and_clear();
        store.close()?;
        let reader = Reader::open(&database)?;
        let row = reader.capture(imported.end.id())?;
        note_ignored(&file.display().to_string(), &imported.report.ignored_columns);
        let mut remarks = Vec::new();
        if imported.report.stamps != "unix" {
            note_assumed_time(&file.display().to_string());
            remarks.push(
                "The recording tells no time of day: its first sample counts as taken when this was made.".to_owned(),
            );
        }
        Ok(Self { reader, row, of_file: true, stated: None, remarks, _folder: Some(folder) })
    }

    /// Ends reading on a signal, because reading takes long.
    fn end_with(&self, stop: &Stop) -> anyhow::Result<()> {
        let (interrupt, stop) = (self.reader.interrupt(), stop.clone());
        std::thread::Builder::new().name("stop".to_owned()).spawn(move || {
            loop {
                std::thread::sleep(SOON);
                if stop.is_wanted() {
                    interrupt.interrupt();
                }
            }
        })?;
        Ok(())
    }

    /// Returns the result of an analysis ([`direct::document`]).
    ///
    /// # Errors
    /// The errors of [`direct::document`]; those of a recording name it.
    pub(super) fn document(&self, kind: JobKind) -> Result<Documents, JobError> {
        direct::document(&self.reader, &self.row, kind, self.stated).map_err(|error| match error {
            JobError::InsufficientData(reason) if self.of_file => {
                JobError::InsufficientData(reason.replace(&format!("capture {}", self.row.id), &self.row.name))
            }
            other => other,
        })
    }

    /// Returns the first of these channels that the capture lacks.
    pub(super) fn lacks(&self, channels: &[Channel]) -> Option<Channel> {
        channels.iter().copied().find(|channel| !self.row.channels.contains(channel))
    }
}
