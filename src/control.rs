//! Control: what the HTTP interface and the command line may ask of the running daemon.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::CancellationToken;

/// A capture that somebody wants.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureRequest {
    /// How much sample time it shall hold.
    pub duration: Duration,
    /// Its name; the daemon makes one of date and time where it is absent.
    pub name: Option<String>,
    /// When to begin, UTC ns; at once where absent.
    pub start_at_utc_ns: Option<i64>,
}

/// Why a request was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ControlError {
    /// One capture at a time.
    #[error("capture {running} is running until it is complete or stopped: stop it first")]
    Busy {
        /// The capture that runs or waits.
        running: i64,
    },
    /// Only a running capture can be stopped.
    #[error("capture {id} is not running")]
    NotRunning {
        /// The capture asked for.
        id: i64,
    },
    /// The name is taken.
    #[error("a capture named `{name}` exists already: choose another name")]
    NameTaken {
        /// The name asked for.
        name: String,
    },
    /// The name cannot be one.
    #[error("{reason}")]
    NameRefused {
        /// Why.
        reason: String,
    },
    /// The database did not take it.
    #[error("the database did not take the request: {reason}")]
    Store {
        /// What the database said.
        reason: String,
    },
    /// The daemon is ending.
    #[error("the daemon is stopping")]
    Stopping,
}

/// A request with the way back for its answer.
#[derive(Debug)]
pub enum Command {
    /// Start (or schedule) a capture; answers its id.
    Start(CaptureRequest, oneshot::Sender<Result<i64, ControlError>>),
    /// Stop the running or waiting capture with this id.
    Stop(i64, oneshot::Sender<Result<(), ControlError>>),
}

/// The asking side, cloned into whoever needs it.
#[derive(Debug, Clone)]
pub struct CaptureControl(mpsc::Sender<Command>);

impl CaptureControl {
    /// A pair of asking and answering side.
    #[must_use]
    pub fn pair() -> (Self, mpsc::Receiver<Command>) {
        let (sender, receiver) = mpsc::channel(16);
        (Self(sender), receiver)
    }

    /// Starts or schedules a capture and answers its id.
    ///
    /// # Errors
    /// [`ControlError`] where it cannot.
    pub async fn start(&self, request: CaptureRequest) -> Result<i64, ControlError> {
        let (reply, answer) = oneshot::channel();
        self.0.send(Command::Start(request, reply)).await.map_err(|_| ControlError::Stopping)?;
        answer.await.map_err(|_| ControlError::Stopping)?
    }

    /// Stops the capture; returns once its last sample is committed.
    ///
    /// # Errors
    /// [`ControlError`] where it is not running.
    pub async fn stop(&self, id: i64) -> Result<(), ControlError> {
        let (reply, answer) = oneshot::channel();
        self.0.send(Command::Stop(id, reply)).await.map_err(|_| ControlError::Stopping)?;
        answer.await.map_err(|_| ControlError::Stopping)?
    }
}

/// How files begin in which recordings are put aside beside the database while they are imported.
pub const IMPORT_PREFIX: &str = ".import-";

/// A recording that shall become a capture.
#[derive(Debug, Clone)]
pub struct ImportRequest {
    /// Where its bytes are.
    pub file: PathBuf,
    /// What it is called: where it came from, and what its capture is named after.
    pub called: String,
    /// Samples per second of a recording without stamps.
    pub rate_hz: Option<f64>,
    /// Gyroscope and accelerometer send means of so many samples.
    pub filter_window: Option<u32>,
    /// Rate of these samples, Hz.
    pub internal_rate_hz: Option<f64>,
    /// What the columns of a foreign CSV are: `FOREIGN=NAME,…`.
    pub columns: Option<String>,
    /// Definitions of messages that a bag does not bring along.
    pub definitions: Vec<MessageText>,
    /// Name of the capture.
    pub name: Option<String>,
    /// Cancelled once nobody waits for it any more.
    pub abandoned: CancellationToken,
}

/// A message type that a bag does not bring along.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MessageText {
    /// The type: `Name`, `package/Name` or `package/msg/Name`.
    pub name: String,
    /// The text of its `.msg` file.
    pub text: String,
}

/// What an import came to, as `vn100d import --json` and `POST /v1/imports` answer it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ImportReport {
    /// What the recording is called.
    pub file: String,
    /// Id of its capture.
    pub capture: i64,
    /// False where the same recording was imported before.
    pub new: bool,
    /// Samples.
    pub samples: u64,
    /// Samples missing between them.
    pub missing: u64,
    /// Gaps.
    pub gaps: u64,
    /// Rate in Hz.
    pub rate_hz: f64,
    /// Whether the rate was not told by anything.
    pub rate_assumed: bool,
    /// Lines or messages that are no sample, by cause.
    pub rejected: BTreeMap<String, u64>,
    /// The first of them.
    pub first_rejected: Vec<RejectedReport>,
    /// What its times are: `none`, `relative` or `unix`.
    pub stamps: String,
    /// Which of several stamps its times are, and how regular each is.
    #[schema(value_type = Option<Object>)]
    pub stamp_choice: Option<serde_json::Value>,
    /// Figures of its times and values.
    #[schema(value_type = Object)]
    pub findings: serde_json::Value,
    /// What a person should know about it, a sentence each.
    pub remarks: Vec<String>,
    /// Columns that are no channel.
    pub ignored_columns: Vec<String>,
    /// Channels that came in another unit.
    pub conversions: Vec<ConversionReport>,
}

/// A line or message that did not become a sample.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RejectedReport {
    /// `line`, or `message` of a bag.
    pub entry: String,
    /// Its number, from 1.
    pub line: u64,
    /// Why.
    pub cause: String,
    /// Its text, at most 256 characters.
    pub text: String,
}

/// A channel that came in another unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ConversionReport {
    /// The channel.
    pub channel: String,
    /// The column's name in the file.
    pub column: String,
    /// The unit it came in.
    pub original_unit: String,
    /// Value in the channel's unit = factor × value in the file.
    pub factor: f64,
}

/// Why a recording did not become a capture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// It cannot be read, or not as a recording.
    #[error("{reason}")]
    Recording {
        /// What is wrong with it.
        reason: String,
    },
    /// The name is taken.
    #[error("{reason}")]
    NameTaken {
        /// Which, and what to do.
        reason: String,
    },
    /// The name cannot be one.
    #[error("{reason}")]
    NameRefused {
        /// Why.
        reason: String,
    },
    /// The daemon is ending.
    #[error("the daemon is stopping, nothing of the recording was kept: import it again once the daemon runs")]
    Stopping,
    /// The database did not take it.
    #[error("the database did not take the recording: {reason}")]
    Store {
        /// What the database said.
        reason: String,
    },
}

/// Makes recordings captures; blocks until it is done.
pub trait Importer: std::fmt::Debug + Send + Sync {
    /// Whether nothing is imported any more.
    fn is_stopping(&self) -> bool {
        false
    }

    /// Imports one recording, whole or not at all; the same one twice is one capture.
    ///
    /// # Errors
    /// [`ImportError`]; nothing of the recording stays.
    fn import(&self, request: ImportRequest) -> Result<ImportReport, ImportError>;
}
