//! Control: the requests of the HTTP interface and the command line to the running daemon.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::CancellationToken;

/// A request for a capture.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureRequest {
    /// The sample time to record.
    pub duration: Duration,
    /// Its name; the daemon makes one from date and time if it is absent.
    pub name: Option<String>,
    /// The planned start, UTC ns; at once if absent.
    pub start_at_utc_ns: Option<i64>,
}

/// The reasons why a request was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
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
        /// The requested capture.
        id: i64,
    },
    /// The name is taken.
    #[error("a capture named `{name}` exists already: choose another name")]
    NameTaken {
        /// The requested name.
        name: String,
    },
    /// The name is invalid.
    #[error("{reason}")]
    NameRefused {
        /// The reason.
        reason: String,
    },
    /// The database did not accept it.
    #[error("the database did not take the request: {reason}")]
    Store {
        /// The error that the database reported.
        reason: String,
    },
    /// The daemon is ending.
    #[error("the daemon is stopping")]
    Stopping,
}

/// A request with the channel for its reply.
#[derive(Debug)]
pub enum Command {
    /// Start (or schedule) a capture; the reply is its id.
    Start(CaptureRequest, oneshot::Sender<Result<i64, ControlError>>),
    /// Stop the running or waiting capture with this id.
    Stop(i64, oneshot::Sender<Result<(), ControlError>>),
}

/// The requesting side, cloned for each client.
#[derive(Debug, Clone)]
pub struct CaptureControl(mpsc::Sender<Command>);

impl CaptureControl {
    /// A pair of requesting and replying side.
    pub fn pair() -> (Self, mpsc::Receiver<Command>) {
        let (sender, receiver) = mpsc::channel(16);
        (Self(sender), receiver)
    }

    /// Starts or schedules a capture and returns its id.
    ///
    /// # Errors
    /// [`ControlError`] if the capture cannot be started.
    pub async fn start(&self, request: CaptureRequest) -> Result<i64, ControlError> {
        let (reply, answer) = oneshot::channel();
        self.0.send(Command::Start(request, reply)).await.map_err(|_| ControlError::Stopping)?;
        answer.await.map_err(|_| ControlError::Stopping)?
    }

    /// Stops the capture; returns once its last sample is committed.
    ///
    /// # Errors
    /// [`ControlError`] if it is not running.
    pub async fn stop(&self, id: i64) -> Result<(), ControlError> {
        let (reply, answer) = oneshot::channel();
        self.0.send(Command::Stop(id, reply)).await.map_err(|_| ControlError::Stopping)?;
        answer.await.map_err(|_| ControlError::Stopping)?
    }
}

/// The prefix of files beside the database in which recordings are stored while they are imported.
pub const IMPORT_PREFIX: &str = ".import-";

/// A recording to be imported as a capture.
#[derive(Debug, Clone)]
pub struct ImportRequest {
    /// The path of its bytes.
    pub file: PathBuf,
    /// Its name: the origin of the recording, after which its capture is named.
    pub called: String,
    /// Samples per second of a recording without stamps.
    pub rate_hz: Option<f64>,
    /// Gyroscope and accelerometer send means of this many samples.
    pub filter_window: Option<u32>,
    /// Rate of these samples, Hz.
    pub internal_rate_hz: Option<f64>,
    /// The map of the columns of a foreign CSV: `FOREIGN=NAME,…`.
    pub columns: Option<String>,
    /// Definitions of messages that a bag lacks.
    pub definitions: Vec<MessageText>,
    /// Name of the capture.
    pub name: Option<String>,
    /// Cancelled once no client waits for the import any more.
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

/// The reasons why a recording was not imported.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImportError {
    /// The file cannot be read, or is no recording.
    #[error("{reason}")]
    Recording {
        /// The reason.
        reason: String,
    },
    /// The name is taken.
    #[error("{reason}")]
    NameTaken {
        /// The name, and what to do.
        reason: String,
    },
    /// The name is invalid.
    #[error("{reason}")]
    NameRefused {
        /// The reason.
        reason: String,
    },
    /// The daemon is ending.
    #[error("the daemon is stopping, nothing of the recording was kept: import it again once the daemon runs")]
    Stopping,
    /// The database did not accept it.
    #[error("the database did not take the recording: {reason}")]
    Store {
        /// The error that the database reported.
        reason: String,
    },
}

/// Imports recordings as captures; blocks until the import is done.
pub trait Importer: std::fmt::Debug + Send + Sync {
    /// Whether no more imports are accepted.
    fn is_stopping(&self) -> bool {
        false
    }

    /// Imports one recording, complete or not at all; the same recording imported twice is one capture.
    ///
    /// # Errors
    /// [`ImportError`]; nothing of the recording stays.
    fn import(&self, request: ImportRequest) -> Result<ImportReport, ImportError>;
}
