//! Publishing: puts together the status that the HTTP interface shows, from memory alone.

use crate::capture::task::Progress;
use crate::clock::{Clock, rfc3339};
use crate::jobs::{Jobs, Live};
use crate::observe::{CaptureStatus, SensorState, Status};
use crate::store::Store;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// How often the status is renewed, in real time.
const EVERY: Duration = Duration::from_millis(250);

/// Renews the status until `stop`.
pub async fn run(
    store: Store,
    jobs: Jobs,
    mut progress: watch::Receiver<Progress>,
    clock: Arc<dyn Clock>,
    status: watch::Sender<Status>,
    stop: CancellationToken,
) {
    let mut said = None;
    loop {
        let now = compose(&store, &jobs, &progress.borrow_and_update(), clock.as_ref());
        let line = one_line(&now);
        if said.as_ref() != Some(&line) {
            super::watchdog::notify(&[sd_notify::NotifyState::Status(&line)]);
            said = Some(line);
        }
        status.send_replace(now);
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(EVERY) => {}
        }
    }
}

/// How often the running capture's analysis takes in what was committed, in real time: so that a question for it is
/// answered at once.
const WARM: Duration = Duration::from_secs(10);

/// Keeps the live analysis close to the running capture until `stop`.
pub async fn keep_warm(store: Store, live: Arc<Live>, status: watch::Receiver<Status>, stop: CancellationToken) {
    loop {
        let running = status.borrow().capture.as_ref().filter(|capture| capture.samples > 0).map(|capture| capture.id);
        if let Some(id) = running {
            let live = Arc::clone(&live);
            let outcome = store.offload(move |store| Ok(live.catch_up(&store.reader()?, id))).await;
            if let Ok(Err(error)) = outcome {
                tracing::warn!(%error, "the running capture could not be analysed");
            }
        }
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(WARM) => {}
        }
    }
}

fn compose(store: &Store, jobs: &Jobs, progress: &Progress, clock: &dyn Clock) -> Status {
    let committed = store.progress().committed;
    let capture = progress.capture.as_ref().map(|(plan, counts, waiting)| CaptureStatus {
        id: plan.id,
        name: plan.name.clone(),
        state: if *waiting { "waiting" } else { "capturing" }.to_owned(),
        elapsed_s: counts.elapsed_ns / 1e9,
        remaining_s: ((plan.duration_ns as f64 - counts.elapsed_ns) / 1e9).max(0.0),
        samples: counts.samples,
        missing: counts.missing,
        gaps: counts.gaps,
        committed: committed.get(&plan.id).copied().unwrap_or(0),
        last_sample_age_s: counts.last_mono_ns.map(|last| clock.mono_ns().saturating_sub(last) as f64 / 1e9),
        gap_open_since: counts.gap_open_since_utc_ns.map(rfc3339),
    });
    Status { sensor: progress.sensor.clone(), capture, storage: store.status(), jobs: jobs.status() }
}

/// What `systemctl status` shows.
fn one_line(status: &Status) -> String {
    let sensor = match (status.sensor.state, &status.sensor.port) {
        (SensorState::Streaming, Some(port)) => format!("streaming from {port}"),
        (state, _) => format!("{state:?}").to_lowercase(),
    };
    match &status.capture {
        // Whole percents: systemd is not told every sample.
        Some(capture) => {
            let whole = capture.elapsed_s + capture.remaining_s;
            let percent = if whole > 0.0 { (100.0 * capture.elapsed_s / whole).floor() } else { 0.0 };
            format!("{sensor}; capture {} at {percent} %, {} missing", capture.name, capture.missing)
        }
        None => format!("{sensor}; no capture"),
    }
}
