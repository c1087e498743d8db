//! Captures: starts, stops and resumes them on request, and has them analysed when they end.

use super::resume_point;
use crate::capture::recorder::Plan;
use crate::capture::task::{Progress, TaskCommand};
use crate::control::{CaptureRequest, Command, ControlError};
use crate::jobs::Jobs;
use crate::store::{CaptureState, NewCapture, Store, StoreError};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

/// Keeps the one capture that runs or waits.
pub struct Keeper {
    store: Store,
    jobs: Jobs,
    task: mpsc::Sender<TaskCommand>,
    progress: watch::Receiver<Progress>,
    /// Where the sensor is looked for: what a capture says of its source until the port is known.
    device: String,
    /// The capture that the task has.
    running: Option<i64>,
}

impl Keeper {
    /// A keeper of no capture.
    #[must_use]
    pub fn new(
        store: Store,
        jobs: Jobs,
        task: mpsc::Sender<TaskCommand>,
        progress: watch::Receiver<Progress>,
        device: String,
    ) -> Self {
        Self { store, jobs, task, progress, device, running: None }
    }

    /// Lets the capture go on that an earlier run of the daemon left; `true` where there was one. Of several (which
    /// only a foreign hand can make) the newest goes on, the others are stopped.
    ///
    /// # Errors
    /// What the database says.
    pub async fn resume(&mut self) -> Result<bool, StoreError> {
        let mut unfinished = self.store.offload(Store::unfinished).await?;
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
            start_at_utc_ns: capture.start_at_utc_ns,
        };
        let point = (capture.samples > 0).then(|| resume_point(&capture));
        self.hand_over(plan, point).await;
        Ok(true)
    }

    async fn hand_over(&mut self, plan: Plan, point: Option<crate::capture::recorder::ResumePoint>) {
        self.running = Some(plan.id);
        // A task that is gone takes nothing: the daemon is ending, and the capture goes on when it runs again.
        let _ = self.task.send(TaskCommand::Begin(plan, point)).await;
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
                        // Whoever asked may be gone; the capture runs all the same.
                        let _ = reply.send(answer);
                    }
                    Some(Command::Stop(id, reply)) => {
                        let answer = self.stop(id).await;
                        let _ = reply.send(answer);
                    }
                },
                changed = self.progress.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    self.notice_end().await;
                }
            }
        }
    }

    /// Makes a capture and has it recorded; answers its id.
    ///
    /// # Errors
    /// [`ControlError::Busy`] while one runs or waits, [`ControlError::NameTaken`], or what the database says.
    pub async fn start(&mut self, request: CaptureRequest) -> Result<i64, ControlError> {
        self.notice_end().await;
        if let Some(running) = self.running {
            return Err(ControlError::Busy { running });
        }
        let source = self.progress.borrow().sensor.port.clone().unwrap_or_else(|| self.device.clone());
        let state = if request.start_at_utc_ns.is_some() { CaptureState::Waiting } else { CaptureState::Capturing };
        let mut capture = NewCapture::new(&source, state);
        capture.name.clone_from(&request.name);
        capture.planned = Some(request.duration);
        capture.start_at_utc_ns = request.start_at_utc_ns;
        let id = self.store.offload(move |store| store.create_capture(capture)).await.map_err(refused)?;
        let name = request.name.unwrap_or_else(|| id.to_string());
        let duration_ns = request.duration.as_nanos() as u64;
        self.hand_over(Plan { id, name, duration_ns, start_at_utc_ns: request.start_at_utc_ns }, None).await;
        Ok(id)
    }

    async fn stop(&mut self, id: i64) -> Result<(), ControlError> {
        self.notice_end().await;
        if self.running != Some(id) {
            return Err(ControlError::NotRunning { id });
        }
        let (reply, answer) = oneshot::channel();
        self.task.send(TaskCommand::Stop(reply)).await.map_err(|_| ControlError::Stopping)?;
        answer.await.map_err(|_| ControlError::Stopping)?;
        self.ended(id).await;
        Ok(())
    }

    /// The task has let go of the capture: it is at its end.
    async fn notice_end(&mut self) {
        let held = self.progress.borrow_and_update().capture.as_ref().map(|(plan, ..)| plan.id);
        if let Some(id) = self.running.filter(|id| Some(*id) != held) {
            // The task publishes before it has heard of a capture that was just handed over: the database decides.
            if self.store.flush().await.is_ok() && self.has_ended(id).await {
                self.ended(id).await;
            }
        }
    }

    async fn has_ended(&self, id: i64) -> bool {
        self.store.offload(move |store| store.reader()?.capture(id)).await.is_ok_and(|row| !row.state.is_open())
    }

    async fn ended(&mut self, id: i64) {
        self.running = None;
        if self.store.flush().await.is_err() {
            return;
        }
        let jobs = self.jobs.clone();
        match tokio::task::spawn_blocking(move || jobs.submit_all(id)).await {
            Ok(Ok(_)) => tracing::info!(capture = id, "capture ended, its analysis is queued"),
            Ok(Err(error)) => tracing::error!(capture = id, %error, "the analysis could not be queued"),
            Err(error) => tracing::error!(capture = id, %error, "the analysis could not be queued"),
        }
    }
}

fn refused(error: StoreError) -> ControlError {
    match error {
        StoreError::NameTaken { name } => ControlError::NameTaken { name },
        other => ControlError::Store { reason: other.to_string() },
    }
}
