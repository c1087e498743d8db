//! The status, for programs and for people. From memory: it answers while the disk hangs.

use super::health::named;
use super::state::ApiState;
use crate::observe::Status;
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{Html, IntoResponse, Response};
use serde::Serialize;
use std::fmt::Write;

/// What the daemon is doing.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct StatusBody {
    /// The program's version.
    version: &'static str,
    /// Age of the process in seconds of real time.
    uptime_s: f64,
    #[serde(flatten)]
    status: Status,
}

/// The status of sensor, capture, store and jobs; `capture` is null while none runs or waits.
#[utoipa::path(get, path = "/v1/status", tag = "daemon", responses((status = 200, body = StatusBody)))]
pub(super) async fn status(State(state): State<ApiState>) -> Response {
    let body = StatusBody {
        version: env!("CARGO_PKG_VERSION"),
        uptime_s: state.started.elapsed().as_secs_f64(),
        status: state.status(),
    };
    ([(header::CACHE_CONTROL, "max-age=1")], Json(body)).into_response()
}

/// A page for people: the status and where to go on.
pub(super) async fn page(State(state): State<ApiState>) -> Response {
    let html = render(&state.status(), state.started.elapsed().as_secs());
    let headers = [
        (header::CONTENT_SECURITY_POLICY, "default-src 'none'; style-src 'unsafe-inline'"),
        (header::CACHE_CONTROL, "no-store"),
    ];
    (headers, Html(html)).into_response()
}

fn render(status: &Status, uptime_s: u64) -> String {
    let mut rows = String::new();
    let mut row = |name: &str, value: String| {
        // Writing to a text cannot fail.
        let _ = write!(rows, "<tr><th>{name}</th><td>{}</td></tr>", escape(&value));
    };
    let sensor = &status.sensor;
    row("sensor", named(&sensor.state));
    for (name, value) in [
        ("", &sensor.hint),
        ("port", &sensor.port),
        ("model", &sensor.model),
        ("serial number", &sensor.serial_number),
        ("firmware", &sensor.firmware),
        ("output", &sensor.output),
    ] {
        if let Some(value) = value {
            row(name, value.clone());
        }
    }
    if let Some(rate_hz) = sensor.rate_hz {
        row("rate", format!("{rate_hz} Hz"));
    }
    match &status.capture {
        None => row("capture", "none".to_owned()),
        Some(capture) => {
            row("capture", format!("{} ({}), {}", capture.id, capture.name, capture.state));
            row("elapsed", format!("{:.0} s, {:.0} s to come", capture.elapsed_s, capture.remaining_s));
            row(
                "samples",
                format!("{} received, {} missing in {} gaps", capture.samples, capture.missing, capture.gaps),
            );
        }
    }
    if let Some(schedule) = &status.schedule {
        row("next night", format!("{} at {} ({} local time)", schedule.name, schedule.next_start, schedule.at));
        if let Some(waits) = &schedule.waits {
            row("", format!("it waits: {waits}"));
        }
    }
    let storage = &status.storage;
    row("storage", named(&storage.state));
    if let Some(error) = &storage.error {
        row("", error.clone());
    }
    row("free", format!("{} MiB", storage.free_bytes >> 20));
    let jobs = &status.jobs;
    row(
        "jobs",
        format!("{} running, {} queued, {} done, {} failed", jobs.running, jobs.queued, jobs.done, jobs.failed),
    );
    row("uptime", format!("{uptime_s} s"));
    let links: String = [
        "/v1/status",
        "/v1/captures",
        "/v1/captures/latest",
        "/v1/captures/latest/noise",
        "/v1/captures/latest/allan",
        "/v1/captures/latest/statistics",
        "/v1/captures/latest/gaps",
        "/v1/jobs",
        "/v1/diagnoses",
        "/diagnoses/latest",
        "/readyz",
        "/metrics",
        "/openapi.json",
    ]
    .iter()
    .map(|path| format!("<li><a href=\"{path}\">{path}</a></li>"))
    .collect();
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>vn100d</title>\
         <meta http-equiv=\"refresh\" content=\"5\"><style>body{{font:16px/1.5 system-ui,sans-serif;margin:2em}}\
         th{{text-align:left;padding-right:2em;font-weight:600}}td{{font-variant-numeric:tabular-nums}}</style></head>\
         <body><h1>vn100d {}</h1><table>{rows}</table><ul>{links}</ul></body></html>\n",
        env!("CARGO_PKG_VERSION")
    )
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_sensor_says_does_not_become_markup() {
        let mut status = Status::default();
        status.sensor.model = Some("<script>&\"".to_owned());
        let html = render(&status, 1);
        assert!(html.contains("<td>&lt;script&gt;&amp;&quot;</td>"), "{html}");
        assert!(!html.contains("<script"));
    }
}
