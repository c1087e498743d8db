//! The status, from memory, so that it answers while the disk hangs: once, or as events.

use super::problem::{ApiError, Problem};
use super::state::ApiState;
use super::stream::{self, Streamed};
use crate::observe::Status;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;
use std::time::Duration;

/// Interval between two events.
const EVERY: Duration = Duration::from_secs(1);
/// Time after which a browser that lost the connection tries again, ms.
const RETRY_MS: u32 = 2000;

/// The daemon's status.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct StatusBody {
    /// The program's version.
    version: &'static str,
    /// Age of the process, s of real time.
    uptime_s: f64,
    #[serde(flatten)]
    status: Status,
}

/// The status of sensor, capture, store and jobs; `capture` is null while none runs or waits.
#[utoipa::path(get, path = "/v1/status", tag = "daemon", responses((status = 200, body = StatusBody)))]
pub(super) async fn status(State(state): State<ApiState>) -> Response {
    ([(header::CACHE_CONTROL, "max-age=1")], Json(StatusBody::of(&state))).into_response()
}

impl StatusBody {
    /// Returns the present status.
    pub(super) fn of(state: &ApiState) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            uptime_s: state.started.elapsed().as_secs_f64(),
            status: state.status(),
        }
    }
}

/// The status each second, as server-sent events called `status` with the document of `GET /v1/status`. It ends when the
/// daemon does.
#[utoipa::path(get, path = "/v1/events/stream", tag = "daemon", responses(
    (status = 200, body = String, content_type = "text/event-stream", description = "`event: status`, `data: {…}`"),
    (status = 429, body = Problem, content_type = "application/problem+json", description = "Too many listen already")))]
pub(super) async fn events(State(state): State<ApiState>) -> Result<Response, ApiError> {
    let permit = state.listener_permit()?;
    let (pieces, body) = stream::channel();
    tokio::spawn(async move {
        let _permit = permit;
        let mut status = state.parts.status.clone();
        let mut next = tokio::time::interval(EVERY);
        next.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut head = format!("retry: {RETRY_MS}\n");
        loop {
            tokio::select! {
                () = pieces.closed() => return,
                _ = next.tick() => {}
            }
            // The publisher is gone: the daemon ends, and this stream with it.
            if status.has_changed().is_err() {
                return;
            }
            status.mark_unchanged();
            let Ok(json) = serde_json::to_string(&StatusBody::of(&state)) else { return };
            let event = format!("{head}event: status\ndata: {json}\n\n");
            head.clear();
            // Waits for a listener that does not read; the connection gives it up in the end.
            if pieces.send(Ok(event.into())).await.is_err() {
                return;
            }
        }
    });
    let headers = [(header::CONTENT_TYPE, "text/event-stream"), (header::CACHE_CONTROL, "no-store")];
    Ok((Extension(Streamed), headers, body).into_response())
}
