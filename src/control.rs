//! Control: what the HTTP interface and the command line may ask of the running capture.

use std::time::Duration;
use tokio::sync::{mpsc, oneshot};

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
