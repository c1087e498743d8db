//! Health, readiness and metrics, for service managers and monitoring. From memory alone.

use super::problem::{ApiError, Problem};
use super::state::ApiState;
use crate::observe::metrics::CONTENT_TYPE;
use crate::observe::{SensorState, Status, StorageState, WriterFigures};
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;

/// If a sample waits longer than this for the disk, the daemon is not ready; a healthy commit begins within a second.
const WAIT_MAX_S: f64 = 10.0;

/// The answer of a running process.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Alive {
    /// The state: `ok`.
    status: &'static str,
}

/// The answer of a daemon that is ready.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Ready {
    /// Always true; otherwise the answer is 503.
    ready: bool,
}

/// The process is alive.
#[utoipa::path(get, path = "/healthz", tag = "daemon", responses((status = 200, body = Alive)))]
pub(super) async fn healthz() -> Json<Alive> {
    Json(Alive { status: "ok" })
}

/// Ready, or the reasons why not: no samples arrive for the capture, the store is degraded, space runs out.
#[utoipa::path(get, path = "/readyz", tag = "daemon", responses(
    (status = 200, body = Ready),
    (status = 503, body = Problem, content_type = "application/problem+json", description = "`reasons` lists why")))]
pub(super) async fn readyz(State(state): State<ApiState>) -> Result<Json<Ready>, ApiError> {
    let reasons = reasons(&state.status(), state.parts.reserve_bytes);
    if reasons.is_empty() { Ok(Json(Ready { ready: true })) } else { Err(ApiError::not_ready(reasons)) }
}

/// Counters and gauges as OpenMetrics text.
#[utoipa::path(get, path = "/metrics", tag = "daemon", responses(
    (status = 200, body = String, content_type = "application/openmetrics-text")))]
pub(super) async fn metrics(State(state): State<ApiState>) -> Result<Response, ApiError> {
    crate::observe::provoke::provoke(crate::observe::provoke::Point::Handler);
    let progress = state.parts.store.progress();
    let writer = WriterFigures { committed: progress.committed.values().sum(), ..progress.figures };
    let text = state
        .parts
        .metrics
        .render(&state.status(), &writer, state.started.elapsed().as_secs_f64())
        .map_err(|error| ApiError::internal(format!("metrics: {error}")))?;
    Ok(([(header::CONTENT_TYPE, CONTENT_TYPE)], text).into_response())
}

/// Returns the reasons why the daemon is not ready. An absent sensor is no reason while nothing is to be captured.
fn reasons(status: &Status, reserve_bytes: u64) -> Vec<String> {
    let mut reasons = Vec::new();
    let capturing = status.capture.as_ref().is_some_and(|capture| capture.state == "capturing");
    if capturing && status.sensor.state != SensorState::Streaming {
        let state = status.sensor.state.name();
        let hint = status.sensor.hint.as_deref().unwrap_or("no samples arrive");
        reasons.push(format!("sensor {state}: {hint}"));
    }
    let storage = &status.storage;
    if storage.state != StorageState::Ok {
        let error = storage.error.as_deref().unwrap_or("commits are late");
        reasons.push(format!("storage {}: {error}", storage.state.name()));
    }
    if let Some(wait_s) = storage.oldest_waiting_s.filter(|wait_s| *wait_s > WAIT_MAX_S) {
        reasons.push(format!(
            "storage: {} samples wait for the disk, the oldest for {wait_s:.1} s (at most {WAIT_MAX_S} s are allowed)",
            storage.queued
        ));
    }
    if storage.free_bytes < reserve_bytes {
        reasons.push(format!(
            "storage: {} MiB free, the reserve is {} MiB",
            storage.free_bytes >> 20,
            reserve_bytes >> 20
        ));
    }
    reasons
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::CaptureStatus;

    fn healthy() -> Status {
        let mut status = Status::default();
        status.storage.free_bytes = 10 << 30;
        status
    }

    fn capture(state: &str) -> Option<CaptureStatus> {
        Some(CaptureStatus {
            id: 1,
            name: "a".to_owned(),
            state: state.to_owned(),
            elapsed_s: 0.0,
            remaining_s: 1.0,
            samples: 0,
            missing: 0,
            gaps: 0,
            received: 0,
            committed: 0,
            in_flight: 0,
            discarded: Default::default(),
            last_sample_age_s: None,
            gap_open_since: None,
        })
    }

    #[test]
    fn without_a_capture_an_absent_sensor_is_no_reason() {
        assert_eq!(reasons(&healthy(), 1 << 30), Vec::<String>::new());
        assert_eq!(reasons(&Status { capture: capture("waiting"), ..healthy() }, 0), Vec::<String>::new());
    }

    /// The first sample after an hour without samples is not an hour old, and a first commit that never ends has no
    /// age.
    #[test]
    fn the_age_of_the_oldest_sample_counts_and_not_that_of_the_last_commit() {
        let mut status = healthy();
        status.storage.queued = 1;
        status.storage.last_commit_age_s = Some(3600.0);
        status.storage.oldest_waiting_s = Some(0.1);
        assert_eq!(reasons(&status, 0), Vec::<String>::new());
        status.storage.last_commit_age_s = None;
        status.storage.oldest_waiting_s = Some(10.2);
        assert_eq!(reasons(&status, 0).len(), 1);
    }

    #[test]
    fn each_reason_is_named() {
        let mut status = Status { capture: capture("capturing"), ..healthy() };
        status.sensor.state = SensorState::PortBusy;
        status.sensor.hint = Some("stop minicom".to_owned());
        status.storage.state = StorageState::StorageFull;
        status.storage.queued = 400;
        status.storage.oldest_waiting_s = Some(12.3);
        status.storage.free_bytes = 3 << 20;
        assert_eq!(
            reasons(&status, 512 << 20),
            [
                "sensor port_busy: stop minicom",
                "storage storage_full: commits are late",
                "storage: 400 samples wait for the disk, the oldest for 12.3 s (at most 10 s are allowed)",
                "storage: 3 MiB free, the reserve is 512 MiB",
            ]
        );
    }
}
