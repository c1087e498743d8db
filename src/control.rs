//! Control: passes the requests of the HTTP interface and the command line to the running daemon.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::CancellationToken;

/// A request for a capture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CaptureRequest {
    /// The sample time to record.
    pub duration: Duration,
    /// Its name; the daemon makes one from date and time if it is absent.
    pub name: Option<String>,
    /// Whether the name gets a number if it is taken; else the request is then refused.
    pub numbered: bool,
    /// A note about it.
    pub note: Option<String>,
    /// The planned start, UTC ns; at once if absent.
    pub start_at_utc_ns: Option<i64>,
}

/// The reasons why a request was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ControlError {
    /// A capture runs or waits already.
    #[error("capture {0} is running until it is complete or stopped: stop it first")]
    Busy(i64),
    /// Only a running capture can be stopped.
    #[error("capture {0} is not running")]
    NotRunning(i64),
    /// The name is taken.
    #[error("a capture named `{0}` exists already: choose another name")]
    NameTaken(String),
    /// The name or the note is invalid.
    #[error("{0}")]
    Refused(String),
    /// The database did not accept it.
    #[error("the database did not take the request: {0}")]
    Store(String),
    /// The capture takes no more samples, but its end is not on disk.
    #[error(
        "capture {0} takes no more samples, but the disk has not taken its end: it is written once the disk takes it, and if \
         the daemon is killed before, the capture goes on at the next start; see `storage` in the status"
    )]
    Unwritten(i64),
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
    /// Returns a pair of requesting and replying side.
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
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ImportRequest {
    /// The path of its bytes.
    pub file: PathBuf,
    /// The original name of the recording, after which its capture is named.
    pub called: String,
    /// Rate of a recording without stamps, Hz.
    pub rate_hz: Option<f64>,
    /// Number of samples whose mean gyroscope and accelerometer send.
    pub filter_window: Option<u32>,
    /// Rate of these samples, Hz.
    pub internal_rate_hz: Option<f64>,
    /// The map of the columns of a foreign CSV: `FOREIGN=NAME,…`.
    pub columns: Option<String>,
    /// Definitions of messages that are missing in a bag.
    pub definitions: Vec<MessageText>,
    /// The begin of the wanted part: RFC 3339, or seconds since the first sample.
    pub from: Option<String>,
    /// Its end.
    pub to: Option<String>,
    /// The wanted channels, separated by commas.
    pub channels: Option<String>,
    /// Name of the capture.
    pub name: Option<String>,
    /// A note about it.
    pub note: Option<String>,
    /// Cancelled once no client waits for the import any more.
    #[serde(skip)]
    pub abandoned: CancellationToken,
}

/// A message type that is not defined in a bag.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MessageText {
    /// The type: `Name`, `package/Name` or `package/msg/Name`.
    pub name: String,
    /// The text of its `.msg` file.
    pub text: String,
}

/// The outcome of an import, as `vn100d import --json` prints and `POST /v1/imports` returns it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ImportReport {
    /// The name of the recording.
    pub file: String,
    /// Id of its capture.
    pub capture: i64,
    /// False if the same recording was imported before.
    pub new: bool,
    /// Number of samples.
    pub samples: u64,
    /// Number of samples missing between them.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Rate in Hz.
    pub rate_hz: f64,
    /// Whether the rate was assumed because no source states it.
    pub rate_assumed: bool,
    /// Lines or messages that are not samples, by cause.
    pub rejected: BTreeMap<String, u64>,
    /// The first of these lines or messages.
    pub first_rejected: Vec<RejectedReport>,
    /// The kind of its times: `none`, `relative` or `unix`.
    pub stamps: String,
    /// The stamp that was chosen for its times, and how regular each stamp is.
    #[schema(value_type = Option<Object>)]
    pub stamp_choice: Option<serde_json::Value>,
    /// Figures of its times and values.
    #[schema(value_type = Object)]
    pub findings: serde_json::Value,
    /// Remarks for the user, one sentence each.
    pub remarks: Vec<String>,
    /// Columns that are not channels.
    pub ignored_columns: Vec<String>,
    /// Channels that were recorded in another unit.
    pub conversions: Vec<ConversionReport>,
}

/// A line or message that did not become a sample.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RejectedReport {
    /// `line`, or `message` of a bag.
    pub entry: String,
    /// Its number, from 1.
    pub line: u64,
    /// The reason.
    pub cause: String,
    /// Its text, at most 256 characters.
    pub text: String,
}

/// A channel that was recorded in another unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ConversionReport {
    /// The channel.
    pub channel: String,
    /// The column's name in the file.
    pub column: String,
    /// The unit in the file.
    pub original_unit: String,
    /// Value in the channel's unit = factor × value in the file.
    pub factor: f64,
}

/// The reasons why a recording was not imported.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImportError {
    /// The file cannot be read, or is no recording.
    #[error("{0}")]
    Recording(String),
    /// The name is taken.
    #[error("{0}")]
    NameTaken(String),
    /// The name is invalid.
    #[error("{0}")]
    NameRefused(String),
    /// The process that read it ended.
    #[error("reading the recording failed, nothing of it was kept: {0}; import it again")]
    Process(String),
    /// The daemon is ending.
    #[error("the daemon is stopping, nothing of the recording was kept: import it again once the daemon runs")]
    Stopping,
    /// The database did not accept it.
    #[error("the database did not take the recording: {0}")]
    Store(String),
}

/// Imports recordings as captures; blocks until the import is done.
pub trait Importer: std::fmt::Debug + Send + Sync {
    /// Returns whether no more imports are accepted.
    fn is_stopping(&self) -> bool {
        false
    }

    /// Imports one recording, complete or not at all; the same recording imported twice is one capture.
    ///
    /// # Errors
    /// [`ImportError`]; nothing of the recording stays.
    fn import(&self, request: ImportRequest) -> Result<ImportReport, ImportError>;
}
