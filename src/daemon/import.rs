//! Import: a recording's file becomes a capture, whole or not at all; the same file once.

use crate::clock::Clock;
use crate::recording::{Options, Recording, RecordingAccountant, RecordingError, RecordingInfo};
use crate::store::{CaptureState, ChannelRow, ImportEnd, NewCapture, Store, StoreError};
use sha2::{Digest, Sha256};
use std::path::Path;

/// Why a file was not imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The database.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The file.
    #[error("{path} cannot be read: {source}")]
    Read {
        /// The file.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
}

/// What an import came to.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The capture: new, or known already.
    pub end: ImportEnd,
    /// What is known about the recording.
    pub info: RecordingInfo,
    /// Samples, missing samples and gaps.
    pub counts: (u64, u64, u64),
}

/// Imports one file; `progress` hears how many samples are written and how many there are.
///
/// # Errors
/// [`ImportError`]; nothing of the recording stays.
pub fn import(
    store: &Store,
    clock: &dyn Clock,
    file: &Path,
    rate_hz: Option<f64>,
    name: Option<String>,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Imported, ImportError> {
    let fingerprint = fingerprint(file, rate_hz)?;
    let recording = Recording::open(file, Options { rate_hz, started_utc_ns: clock.utc_ns() })?;
    let info = recording.info().clone();
    let mut accountant = RecordingAccountant::new(&info);
    let mut capture = NewCapture::new(&file.display().to_string(), CaptureState::Imported);
    capture.name = match name {
        Some(name) => Some(name),
        None => free_name(store, file)?,
    };
    capture.started_utc_ns = Some(info.started_utc_ns);
    capture.rate_assumed = info.rate_assumed;
    capture.configuration = Some(description(&info));
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
            progress(written, info.samples);
        }
    }
    let end = import.finish(Some(accountant.last_utc_ns()))?;
    progress(info.samples, info.samples);
    Ok(Imported { end, counts: (accountant.received(), accountant.missing(), accountant.gaps()), info })
}

/// Names the recording's content and how it is read.
fn fingerprint(file: &Path, rate_hz: Option<f64>) -> Result<String, ImportError> {
    let failed = |source| ImportError::Read { path: file.display().to_string(), source };
    let mut hash = Sha256::new();
    std::io::copy(&mut std::fs::File::open(file).map_err(failed)?, &mut hash).map_err(failed)?;
    let digest: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(match rate_hz {
        Some(rate_hz) => format!("sha256:{digest} rate {rate_hz}"),
        None => format!("sha256:{digest}"),
    })
}

/// The file's name without its endings, where no capture has it yet.
fn free_name(store: &Store, file: &Path) -> Result<Option<String>, StoreError> {
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.trim_end_matches(".gz").trim_end_matches(".csv").trim_end_matches(".txt").to_owned();
    let reader = store.reader()?;
    let taken = stem.is_empty() || stem.bytes().all(|byte| byte.is_ascii_digit()) || reader.resolve(&stem).is_ok();
    Ok((!taken).then_some(stem))
}

fn description(info: &RecordingInfo) -> serde_json::Value {
    serde_json::json!({
        "file": info.file.display().to_string(),
        "kind": info.kind,
        "stamps": info.stamps,
        "rate_hz": info.rate_hz,
        "ignored_columns": info.ignored_columns,
        "conversions": info.conversions,
    })
}

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
            row.resolution = info.decimals.get(channel).map(|decimals| factor * 10_f64.powi(-i32::from(decimals)));
            row
        })
        .collect()
}
