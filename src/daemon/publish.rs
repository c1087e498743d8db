//! Publishing: assembles the status that the HTTP interface shows, from memory alone.

use crate::capture::task::Progress;
use crate::clock::{Clock, rfc3339};
use crate::jobs::{Jobs, Live};
use crate::notify::NotifyFigures;
use crate::observe::{CaptureStatus, RetentionStatus, ScheduleStatus, SensorState, Status, Tally};
use crate::share::ShareFigures;
use crate::store::Store;
use imu_core::sample::DiscardCause;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// The interval at which the status is renewed, in real time.
const EVERY: Duration = Duration::from_millis(250);

/// The reader's side of the running capture's numbers, as of its last measurement.
pub type SharedTally = Arc<Mutex<Option<Tally>>>;

/// The reported state of the capture task.
#[derive(Debug, Clone)]
pub struct Captured {
    /// Sensor, plan and counts, a few times a second.
    pub progress: watch::Receiver<Progress>,
    /// The present counts of all received measurements by their state.
    pub tally: SharedTally,
}

/// The status of retention, schedule and notifications, from memory.
#[derive(Debug, Clone)]
pub struct Unattended {
    /// The planned deletions.
    pub retention: watch::Receiver<RetentionStatus>,
    /// The next night.
    pub schedule: watch::Receiver<Option<ScheduleStatus>>,
    /// The state of the notifications.
    pub notify: NotifyFigures,
    /// What is shared, if anything is.
    pub share: Option<ShareFigures>,
}

/// Renews the status until `stop`.
pub async fn run(
    store: Store,
    jobs: Jobs,
    unattended: Unattended,
    mut captured: Captured,
    clock: Arc<dyn Clock>,
    status: watch::Sender<Status>,
    stop: CancellationToken,
) {
    let mut reported = None;
    loop {
        let mut now = compose(&store, &jobs, &mut captured, clock.as_ref());
        now.retention = unattended.retention.borrow().clone();
        now.schedule = unattended.schedule.borrow().clone();
        now.notify = unattended.notify.status();
        now.share = unattended.share.as_ref().map(ShareFigures::status);
        let line = one_line(&now);
        if reported.as_ref() != Some(&line) {
            super::watchdog::notify(&[sd_notify::NotifyState::Status(&line)]);
            reported = Some(line);
        }
        status.send_replace(now);
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(EVERY) => {}
        }
    }
}

/// The interval at which the running capture's analysis takes in new samples, in real time, so that a request for it is
/// answered at once.
const WARM: Duration = Duration::from_secs(10);

/// Keeps the live analysis close to the running capture. Runs until `stop`.
pub async fn keep_warm(store: Store, live: Arc<Live>, status: watch::Receiver<Status>, stop: CancellationToken) {
    loop {
        let running = status.borrow().capture.as_ref().filter(|capture| capture.samples > 0).map(|capture| capture.id);
        let mut pause = WARM;
        if let Some(id) = running {
            let (live, begun) = (Arc::clone(&live), Instant::now());
            let outcome = store.offload(move |store| Ok(live.catch_up(&store.reader()?, id))).await;
            match outcome {
                // After a restart a night of data may have to be caught up with; half of the time is left to other
                // work.
                Ok(Ok(false)) => pause = begun.elapsed(),
                Ok(Err(error)) => tracing::warn!(%error, "the running capture could not be analysed"),
                Ok(Ok(true)) | Err(_) => {}
            }
        }
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(pause) => {}
        }
    }
}

fn compose(store: &Store, jobs: &Jobs, captured: &mut Captured, clock: &dyn Clock) -> Status {
    // The disk's side is read first: the reader has counted its samples before. So the number in flight is never
    // negative, and received = committed + in flight + discarded holds at every instant.
    let on_disk = store.progress().committed;
    let tally = *captured.tally.lock().unwrap_or_else(PoisonError::into_inner);
    let progress = &*captured.progress.borrow_and_update();
    let capture = progress.capture.as_ref().map(|(plan, counts, waiting)| {
        let tally = tally.filter(|tally| tally.capture_id == plan.id);
        let base = tally.map_or(0, |tally| tally.base);
        let committed = on_disk.get(&plan.id).copied().unwrap_or(base);
        let stored = store.stored_id(plan.id);
        let discarded = tally.iter().flat_map(|tally| DiscardCause::ALL.into_iter().zip(tally.dropped));
        CaptureStatus {
            id: stored,
            name: store.renamed(stored).unwrap_or_else(|| plan.name.clone()),
            state: if *waiting { "waiting" } else { "capturing" }.to_owned(),
            elapsed_s: counts.elapsed_ns / 1e9,
            remaining_s: ((plan.duration_ns as f64 - counts.elapsed_ns) / 1e9).max(0.0),
            samples: counts.samples,
            missing: counts.missing,
            gaps: counts.gaps,
            received: tally.map_or(committed, |tally| tally.received),
            committed,
            in_flight: tally.map_or(0, |tally| (tally.samples + tally.held) as i64 - committed as i64),
            discarded: discarded
                .filter(|(_, count)| *count > 0)
                .map(|(cause, count)| (cause.name().to_owned(), count))
                .collect(),
            last_sample_age_s: counts.last_mono_ns.map(|last| clock.mono_ns().saturating_sub(last) as f64 / 1e9),
            gap_open_since: counts.gap_open_since_utc_ns.map(rfc3339),
        }
    });
    Status {
        sensor: progress.sensor.clone(),
        capture,
        storage: store.status(),
        jobs: jobs.status(),
        ..Status::default()
    }
}

/// Returns the line that `systemctl status` shows.
fn one_line(status: &Status) -> String {
    let sensor = match (status.sensor.state, &status.sensor.port) {
        (SensorState::Streaming, Some(port)) => format!("streaming from {port}"),
        (state, _) => format!("{state:?}").to_lowercase(),
    };
    match &status.capture {
        // Whole percents: systemd is not notified of every sample.
        Some(capture) => {
            let whole = capture.elapsed_s + capture.remaining_s;
            let percent = if whole > 0.0 { (100.0 * capture.elapsed_s / whole).floor() } else { 0.0 };
            format!("{sensor}; capture {} at {percent} %, {} missing", capture.name, capture.missing)
        }
        None => format!("{sensor}; no capture"),
    }
}
