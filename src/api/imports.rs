//! Imports: a recording's bytes arrive as a body, are stored in a file beside the database, and become a capture. The
//! daemon need not be able to read the user's files, nor the user to write the database.

use super::extract::Q;
use super::problem::{ApiError, Problem, ProblemType};
use super::state::ApiState;
use super::{aside, page, samples};
use crate::control::{ImportError, ImportReport, ImportRequest, MessageText};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, header};
use axum::response::Response;
use imu_core::sample::Channel;
use serde::Deserialize;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

/// The path to which a recording is sent; it has its own limits of time and size.
pub(super) const PATH: &str = "/v1/imports";
/// Large enough for a year of raw lines at 40 Hz.
const RECORDING: aside::Kind = aside::Kind { called: "a recording", bytes_max: 256 << 30, time_max: None };
/// Media types of a recording, none of which a form of another site can send.
const MEDIA_TYPES: [&str; 4] = ["application/octet-stream", "application/gzip", "application/x-gzip", "text/csv"];
/// Maximum number of characters of a file's name.
const CALLED_MAX: usize = 4096;
/// Maximum size of the map of columns in bytes.
const COLUMNS_MAX: usize = 16 * 1024;
/// Maximum size of definitions of messages in bytes: they are part of the address.
const DEFINITIONS_MAX: usize = 8 * 1024;

/// The options for reading the recording.
#[derive(Debug, Default, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ImportQuery {
    /// The name of the recording's file, after which the capture is named.
    #[param(example = "desk.csv")]
    file: Option<String>,
    /// Name of the capture.
    name: Option<String>,
    /// Samples per second of a recording without stamps.
    rate_hz: Option<f64>,
    /// The number of samples in the means that gyroscope and accelerometer send: kept with the capture, whose jobs fit
    /// noise behind that filter.
    filter_window: Option<u32>,
    /// Rate of these samples in Hz; 800 if absent.
    internal_rate_hz: Option<f64>,
    /// The meaning of the columns of a foreign CSV: pairs FOREIGN=NAME, separated by commas. FOREIGN is a header's name
    /// or a position (`#3`), NAME a channel with its unit (`accel_x_g`), or `time_s`, `time_ms`, `time_us`, `time_ns`.
    #[param(example = "Time [ms]=time_ms,ax=accel_x_g")]
    columns: Option<String>,
    /// Definitions of messages that a bag lacks: a JSON list of `{"name": "package/msg/Name", "text": "…"}`, with the
    /// text of the type's `.msg` file.
    #[param(example = "[{\"name\": \"own_msgs/msg/Reading\", \"text\": \"float64 gyro_x_rad_s\"}]")]
    message_definitions: Option<String>,
    /// Only the samples from this time on: RFC 3339, or seconds since the first sample.
    from: Option<String>,
    /// Only the samples before this time.
    to: Option<String>,
    /// Only these channels: names, separated by commas.
    #[param(example = "gyro_x,gyro_y,gyro_z")]
    channels: Option<String>,
    /// A note about the capture, one line.
    note: Option<String>,
}

/// Imports a recording (CSV, raw lines or bytes, a ROS bag, MCAP) as a capture; answers once it is one. The same
/// recording again returns the same capture.
#[utoipa::path(post, path = "/v1/imports", tag = "captures", params(ImportQuery),
    request_body(content = Vec<u8>, content_type = "application/octet-stream", description = "The recording's bytes"), responses(
    (status = 201, body = ImportReport, headers(("Location" = String, description = "The capture"))),
    (status = 200, body = ImportReport, description = "It was imported before"),
    (status = 400, body = Problem, content_type = "application/problem+json"),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "The name is taken"),
    (status = 413, body = Problem, content_type = "application/problem+json"),
    (status = 415, body = Problem, content_type = "application/problem+json"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "It is no recording that can be read"),
    (status = 408, body = Problem, content_type = "application/problem+json", description = "The body does not come"),
    (status = 429, body = Problem, content_type = "application/problem+json", description = "Another one is being imported"),
    (status = 503, body = Problem, content_type = "application/problem+json", description = "There is no room")))]
pub(super) async fn import(
    State(state): State<ApiState>,
    Q(query): Q<ImportQuery>,
    request: Request,
) -> Result<Response, ApiError> {
    let definitions = check(&query, request.headers())?;
    if state.parts.importer.is_stopping() {
        return Err(ImportError::Stopping.into());
    }
    let permit = state.import_permit()?;
    let stopping = || if state.parts.importer.is_stopping() { Err(ImportError::Stopping.into()) } else { Ok(()) };
    let aside = RECORDING.put(&state, request.into_body(), stopping).await?;
    let importer = Arc::clone(&state.parts.importer);
    let abandoned = CancellationToken::new();
    let wanted = ImportRequest {
        file: aside.path().to_owned(),
        called: query.file.unwrap_or_else(|| "recording".to_owned()),
        rate_hz: query.rate_hz,
        filter_window: query.filter_window,
        internal_rate_hz: query.internal_rate_hz,
        columns: query.columns,
        definitions,
        from: query.from,
        to: query.to,
        channels: query.channels,
        name: query.name,
        note: query.note,
        abandoned: abandoned.clone(),
    };
    // A client that disconnects before the answer cancels the import.
    let _waiting = abandoned.drop_guard();
    let (answer, outcome) = tokio::sync::oneshot::channel();
    // A separate thread: its priority is lower than that of the runtime's threads, which never wait for it.
    let thread = std::thread::Builder::new().name("import".to_owned()).spawn(move || {
        crate::process::step_back();
        let outcome = importer.import(wanted);
        // The next recording may be sent as soon as this one is answered.
        drop((aside, permit));
        // If the client has gone, the answer is lost.
        let _ = answer.send(outcome);
    });
    thread.map_err(|error| ApiError::unavailable(format!("an import cannot be started now: {error}"), 5))?;
    let report = outcome.await.map_err(|_| ApiError::internal("an import ended abnormally"))??;
    Ok(page::made(report.new, &format!("/v1/captures/{}", report.capture), report))
}

/// Refuses all that can be refused before the body arrives, and returns the definitions of messages.
fn check(query: &ImportQuery, headers: &HeaderMap) -> Result<Vec<MessageText>, ApiError> {
    let media_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let media_type = media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    if !MEDIA_TYPES.contains(&media_type.as_str()) {
        let known = MEDIA_TYPES.join(", ");
        return Err(ApiError::new(
            ProblemType::UnsupportedMediaType,
            format!("a recording comes as one of {known} (with curl: -H 'Content-Type: application/octet-stream')"),
        ));
    }
    // A compressed recording is recognised by its bytes, regardless of the header; other encodings are not decoded.
    let encoding = headers.get(header::CONTENT_ENCODING).and_then(|value| value.to_str().ok()).unwrap_or("identity");
    if !["identity", "gzip", "x-gzip"].contains(&encoding) {
        return Err(ApiError::new(ProblemType::UnsupportedMediaType, "`Content-Encoding`: allowed is gzip"));
    }
    if query.rate_hz.is_some_and(|rate_hz| !(rate_hz.is_finite() && rate_hz > 0.0 && rate_hz <= 1e6)) {
        return Err(ApiError::bad_request("`rate_hz`: allowed is more than 0 and at most 1000000"));
    }
    if query.filter_window.is_some_and(|window| !(1..=1000).contains(&window)) {
        return Err(ApiError::bad_request("`filter_window`: allowed are 1 to 1000 samples"));
    }
    if let Some(internal_hz) = query.internal_rate_hz {
        if query.filter_window.is_none() {
            return Err(ApiError::bad_request("`internal_rate_hz` is given without `filter_window`: give both"));
        }
        if !(internal_hz > 0.0 && internal_hz <= 1e6) {
            return Err(ApiError::bad_request("`internal_rate_hz`: allowed is more than 0 and at most 1000000"));
        }
    }
    let called = query.file.as_deref().unwrap_or("recording");
    if called.is_empty() || called.len() > CALLED_MAX || called.chars().any(char::is_control) {
        return Err(ApiError::bad_request(format!(
            "`file`: allowed are 1 to {CALLED_MAX} bytes without control characters"
        )));
    }
    if query.columns.as_ref().is_some_and(|columns| columns.len() > COLUMNS_MAX) {
        return Err(ApiError::bad_request(format!("`columns`: allowed are {COLUMNS_MAX} bytes")));
    }
    // Before the body arrives: it would be sent for nothing.
    if let Some(name) = &query.name {
        crate::store::check_name(name)?;
    }
    query.note.as_deref().map(crate::store::check_note).transpose()?;
    [&query.from, &query.to].into_iter().flatten().try_for_each(|end| samples::time(end).map(|_| ()))?;
    if let Some(Err(error)) = query.channels.as_deref().map(Channel::list) {
        return Err(ApiError::bad_request(format!("`channels`: {error}")));
    }
    let Some(definitions) = &query.message_definitions else { return Ok(Vec::new()) };
    if definitions.len() > DEFINITIONS_MAX {
        return Err(ApiError::bad_request(format!("`message_definitions`: allowed are {DEFINITIONS_MAX} bytes")));
    }
    serde_json::from_str(definitions).map_err(|error| {
        ApiError::bad_request(format!(
            "`message_definitions`: {error}; expected a JSON list of {{\"name\": \"package/msg/Name\", \"text\": \"…\"}}"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    #[test]
    fn what_is_stated_about_a_recording_is_checked_before_its_body_comes() {
        let mut headers = HeaderMap::new();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("text/csv"));
        let asked = |columns: Option<String>, definitions: Option<String>| {
            let query = ImportQuery { columns, message_definitions: definitions, ..ImportQuery::default() };
            check(&query, &headers).map_err(|error| format!("{error:?}"))
        };
        let text = r#"[{"name": "own_msgs/msg/Reading", "text": "float64 gyro_x_rad_s"}]"#;
        let expected = MessageText { name: "own_msgs/msg/Reading".to_owned(), text: "float64 gyro_x_rad_s".to_owned() };
        assert_eq!(asked(None, Some(text.to_owned())), Ok(vec![expected]));
        assert_eq!(asked(Some("t=time_s".to_owned()), None), Ok(Vec::new()));
        for wrong in ["", "[1]", r#"{"name": "a"}"#, r#"[{"name": "a", "text": "", "more": 1}]"#] {
            let error = asked(None, Some(wrong.to_owned())).unwrap_err();
            assert!(error.contains("message_definitions") && error.contains("JSON list"), "{error}");
        }
        let long = asked(None, Some(" ".repeat(DEFINITIONS_MAX + 1))).unwrap_err();
        assert!(long.contains("allowed are 8192 bytes"), "{long}");
        assert!(asked(Some("x".repeat(COLUMNS_MAX + 1)), None).unwrap_err().contains("columns"));
        let part = |from: &str, channels: &str, note: &str| {
            let [from, channels, note] = [from, channels, note].map(|text| Some(text.to_owned()));
            check(&ImportQuery { from, channels, note, ..ImportQuery::default() }, &headers)
                .map_err(|error| error.to_string())
        };
        assert_eq!(part("2026-11-21T20:00:00Z", "gyro_x,accel_z", "on foam"), Ok(Vec::new()));
        for (from, channels, note, named) in
            [("soon", "gyro_x", "", "soon"), ("1", "gyro_w", "", "`channels`"), ("1", "gyro_x", "a\nb", "note")]
        {
            let error = part(from, channels, note).unwrap_err();
            assert!(error.contains(named), "{error}");
        }
    }
}
