//! Captures: starts, stops and resumes them on request, and queues their analysis when they end.

use super::resume_point;
use crate::capture::recorder::Plan;
use crate::capture::task::{Progress, TaskCommand};
use crate::clock::{Clock, SystemClock};
use crate::control::{CaptureRequest, Command, ControlError};
use crate::jobs::Jobs;
use crate::store::{CaptureState, NewCapture, Store, StoreError, StoreErrorKind, Unfinished, check_name};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

/// How long a request waits for a disk that refuses writes; the HTTP interface answers within ten seconds.
const PATIENCE: Duration = Duration::from_secs(4);
/// The delay between two attempts.
const RETRY: Duration = Duration::from_millis(200);
/// The delay between two attempts to withdraw a request.
const WITHDRAW_RETRY: Duration = Duration::from_secs(1);

/// Both ends of a channel.
type Channel<T> = (mpsc::Sender<T>, mpsc::Receiver<T>);

/// Manages the one capture that runs or waits. It never waits for the disk longer than [`PATIENCE`].
pub struct Keeper {
    store: Store,
    jobs: Jobs,
    task: mpsc::Sender<TaskCommand>,
    progress: watch::Receiver<Progress>,
    /// The configured device: a capture's source until the port is known.
    device: String,
    /// The capture that the task works on.
    running: Option<i64>,
    /// Whether the query for the end of the capture is pending.
    asking: bool,
    answers: Channel<(i64, bool)>,
}

impl Keeper {
    /// Creates a keeper without a capture.
    pub fn new(
        store: Store,
        jobs: Jobs,
        task: mpsc::Sender<TaskCommand>,
        progress: watch::Receiver<Progress>,
        device: String,
    ) -> Self {
        Self { store, jobs, task, progress, device, running: None, asking: false, answers: mpsc::channel(4) }
    }

    /// Resumes the capture that an earlier run of the daemon left; returns `true` if there was one. Of several (which
    /// only another program can cause) the one with the latest sample continues, and the others are stopped.
    ///
    /// # Errors
    /// The error that the database reports.
    pub async fn resume(&mut self, clock: &dyn Clock) -> Result<bool, StoreError> {
        let mut unfinished = self.store.offload(Store::unfinished).await?;
        // The order: captures with samples first, then those that ran, then the newest.
        let rank = |capture: &Unfinished| {
            let last = capture.last.map(|(_, _, utc_ns)| utc_ns);
            (last, capture.state == CaptureState::Capturing, capture.id)
        };
        unfinished.sort_by_key(rank);
        let Some(capture) = unfinished.pop() else { return Ok(false) };
        for older in unfinished {
            let ended = older.last.map_or(0, |(_, _, utc_ns)| utc_ns);
            self.store.offload(move |store| store.set_state(older.id, CaptureState::Stopped, ended)).await?;
        }
        tracing::info!(capture = capture.id, name = %capture.name, samples = capture.samples, "an unfinished capture goes on");
        let plan = Plan {
            id: capture.id,
            name: capture.name.clone(),
            duration_ns: capture.planned.map_or(u64::MAX, |planned| planned.as_nanos() as u64),
            // A capture that has begun does not wait for its start: after a reboot civil time may be years behind until
            // it is set.
            start_at_utc_ns: capture.start_at_utc_ns.filter(|_| capture.samples == 0),
        };
        self.hand_over(plan, Some(resume_point(&capture, clock.boot_id().as_deref(), clock.mono_ns()))).await;
        Ok(true)
    }

    async fn hand_over(&mut self, plan: Plan, point: Option<crate::capture::recorder::ResumePoint>) {
        self.running = Some(plan.id);
        // A task that has ended accepts nothing: the daemon is ending, and the capture continues when it runs again.
        let _ = self.task.send(TaskCommand::Begin(plan, point.map(Box::new))).await;
    }

    /// Serves requests until `stop`.
    pub async fn run(mut self, mut commands: mpsc::Receiver<Command>, stop: CancellationToken) {
        loop {
            tokio::select! {
                () = stop.cancelled() => return,
                command = commands.recv() => match command {
                    None => return,
                    Some(Command::Start(request, reply)) => {
                        let answer = self.start(request).await;
                        // The caller may be gone; the capture runs nevertheless.
                        let _ = reply.send(answer);
                    }
                    Some(Command::Stop(id, reply)) => {
                        let answer = self.stop(id).await;
                        let _ = reply.send(answer);
                    }
                },
                Some((id, ended)) = self.answers.1.recv() => self.answered(id, ended),
                changed = self.progress.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    self.notice_end();
                }
            }
        }
    }

    /// Starts a capture.
    ///
    /// # Errors
    /// [`ControlError::Busy`] while one runs or waits, [`ControlError::NameTaken`], [`ControlError::Refused`], or the
    /// error that the database reports.
    pub async fn start(&mut self, request: CaptureRequest) -> Result<i64, ControlError> {
        self.notice_end();
        if self.asking
            && let Ok(Some((id, ended))) = tokio::time::timeout(PATIENCE, self.answers.1.recv()).await
        {
            self.answered(id, ended);
        }
        if self.asking {
            return Err(ControlError::Store("the last capture's end is not on disk yet".to_owned()));
        }
        if let Some(running) = self.running {
            return Err(ControlError::Busy(running));
        }
        let source = self.progress.borrow().sensor.port.clone().unwrap_or_else(|| self.device.clone());
        let state = if request.start_at_utc_ns.is_some() { CaptureState::Waiting } else { CaptureState::Capturing };
        let mut capture = NewCapture::new(&source, state);
        match request.name {
            // A night that would not begin because of its name would be lost.
            Some(name) if request.numbered => {
                check_name(&name).map_err(refused)?;
                capture.liked_name = Some(name);
            }
            name => capture.name = name,
        }
        capture.note = request.note;
        capture.planned = Some(request.duration);
        capture.start_at_utc_ns = request.start_at_utc_ns;
        let (id, name) = self.create(capture).await?;
        let duration_ns = request.duration.as_nanos() as u64;
        self.hand_over(Plan { id, name, duration_ns, start_at_utc_ns: request.start_at_utc_ns }, None).await;
        Ok(id)
    }

    /// Creates the capture once, however often a failing disk requires a retry, and returns its id and the name that
    /// the database gave it. If there is no answer in time, the request is withdrawn as soon as possible.
    async fn create(&self, mut capture: NewCapture) -> Result<(i64, String), ControlError> {
        let token = token();
        capture.token = Some(token.clone());
        let until = Instant::now() + PATIENCE;
        let reason = loop {
            let (left, capture) = (until.saturating_duration_since(Instant::now()), capture.clone());
            let made = self.store.offload(move |store| {
                let id = store.create_capture(capture)?;
                Ok((id, store.reader()?.capture(id)?.name))
            });
            match tokio::time::timeout(left, made).await {
                Ok(Ok(made)) => return Ok(made),
                Ok(Err(error)) if !is_storage(&error) => return Err(refused(error)),
                Ok(Err(error)) if Instant::now() + RETRY >= until => break error.to_string(),
                Ok(Err(_)) => tokio::time::sleep(RETRY).await,
                Err(_) => break "the disk does not answer".to_owned(),
            }
        };
        let store = self.store.clone();
        tokio::spawn(async move {
            loop {
                let token = token.clone();
                match store.offload(move |store| store.withdraw(&token)).await {
                    Ok(()) | Err(StoreError::Closed) => return,
                    Err(_) => tokio::time::sleep(WITHDRAW_RETRY).await,
                }
            }
        });
        Err(ControlError::Store(reason))
    }

    async fn stop(&mut self, id: i64) -> Result<(), ControlError> {
        self.notice_end();
        // In a file that replaced a lost one it may have another id.
        let Some(id) = self.running.filter(|running| self.store.stored_id(*running) == id) else {
            return Err(ControlError::NotRunning(id));
        };
        let (reply, answer) = oneshot::channel();
        self.task.send(TaskCommand::Stop(reply)).await.map_err(|_| ControlError::Stopping)?;
        answer.await.map_err(|_| ControlError::Stopping)?;
        self.running = None;
        // A disk that refuses writes leaves the rest in memory; the capture is stopped nevertheless.
        match tokio::time::timeout(PATIENCE, self.analyse(id)).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(ControlError::Unwritten(id)),
        }
    }

    /// Handles a capture that the task no longer has. Once all is written, the database shows whether it has ended.
    fn notice_end(&mut self) {
        let held = self.progress.borrow_and_update().capture.as_ref().map(|(plan, ..)| plan.id);
        let Some(id) = self.running.filter(|id| Some(*id) != held && !self.asking) else { return };
        self.asking = true;
        let (store, answers) = (self.store.clone(), self.answers.0.clone());
        tokio::spawn(async move {
            // The task may publish before it has received a new capture: the database decides.
            let ended = store.flush().await.is_ok() && has_ended(&store, id).await;
            // Without a keeper no one waits for the result.
            let _ = answers.send((id, ended)).await;
        });
    }

    fn answered(&mut self, id: i64, ended: bool) {
        self.asking = false;
        if ended && self.running == Some(id) {
            self.running = None;
            drop(self.analyse(id));
        }
    }

    /// Queues the capture's analysis once all of it is on disk, however long that takes; the returned channel then
    /// receives a message.
    fn analyse(&self, id: i64) -> oneshot::Receiver<()> {
        let (store, jobs) = (self.store.clone(), self.jobs.clone());
        let (written, answer) = oneshot::channel();
        tokio::spawn(async move {
            if store.flush().await.is_err() {
                return;
            }
            let stored = store.stored_id(id);
            let submitted = tokio::task::spawn_blocking(move || jobs.submit_all(stored)).await;
            match submitted {
                Ok(Ok(jobs)) if jobs.is_empty() => tracing::info!(capture = id, "capture ended without a sample"),
                Ok(Ok(_)) => tracing::info!(capture = id, "capture ended, its analysis is queued"),
                Ok(Err(error)) => tracing::error!(capture = id, %error, "the analysis could not be queued"),
                Err(error) => tracing::error!(capture = id, %error, "the analysis could not be queued"),
            }
            // The caller may have stopped waiting.
            let _ = written.send(());
        });
        answer
    }
}

async fn has_ended(store: &Store, id: i64) -> bool {
    let stored = store.stored_id(id);
    store.offload(move |store| store.reader()?.capture(stored)).await.is_ok_and(|row| !row.state.is_open())
}

/// Returns a unique name for a request.
fn token() -> String {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    format!("{:x}-{:x}-{number:x}", SystemClock.utc_ns(), std::process::id())
}

/// Returns whether the request may succeed when it is repeated.
fn is_storage(error: &StoreError) -> bool {
    matches!(error.kind(), StoreErrorKind::Io | StoreErrorKind::Unavailable | StoreErrorKind::CannotCreate)
        && !matches!(error, StoreError::Closed)
}

fn refused(error: StoreError) -> ControlError {
    match error {
        StoreError::NameTaken(name) => ControlError::NameTaken(name),
        other @ (StoreError::NameRefused { .. } | StoreError::NoteRefused(_)) => {
            ControlError::Refused(other.to_string())
        }
        other => ControlError::Store(other.to_string()),
    }
}
