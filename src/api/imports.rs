//! Imports: a recording's bytes come as a body, are put aside in a file beside the database, and become a capture. The
//! daemon need not be able to read the user's files, nor the user to write the database.

use super::extract::Q;
use super::problem::{ApiError, Problem, ProblemType};
use super::state::ApiState;
use crate::control::{ImportError, ImportReport, ImportRequest, MessageText};
use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::body::Body as _;
use serde::Deserialize;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::io::AsyncWriteExt;
use tokio_util::sync::CancellationToken;

/// Where a recording is sent; the limits of time and size are its own.
pub(super) const PATH: &str = "/v1/imports";
/// Bytes of a recording at most: a year of raw lines at 40 Hz fits.
const RECORDING_BYTES: u64 = 256 << 30;
/// Bytes that are taken per second at most: the disk is the capture's first.
const BYTES_PER_S: f64 = 64.0 * 1024.0 * 1024.0;
/// Bytes that must come within [`PATIENCE`].
const PROGRESS_BYTES: u64 = 64 * 1024;
/// How long a body may stand still.
const PATIENCE: Duration = Duration::from_secs(30);
/// How often free space is looked at, in bytes that came.
const LOOK_BYTES: u64 = 8 << 20;
/// Media types of a recording: none that a form of another site can send.
const MEDIA_TYPES: [&str; 4] = ["application/octet-stream", "application/gzip", "application/x-gzip", "text/csv"];
/// Characters of a file's name at most.
const CALLED_MAX: usize = 4096;
/// Bytes of what the columns are at most.
const COLUMNS_MAX: usize = 16 * 1024;
/// Bytes of definitions of messages at most: they come in the address.
const DEFINITIONS_MAX: usize = 8 * 1024;

/// How the recording is to be read.
#[derive(Debug, Default, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ImportQuery {
    /// What the recording is called: its file's name. The capture is named after it.
    #[param(example = "desk.csv")]
    file: Option<String>,
    /// Name of the capture.
    name: Option<String>,
    /// Samples per second of a recording without stamps.
    rate_hz: Option<f64>,
    /// Gyroscope and accelerometer send means of so many samples: kept with the capture, whose jobs fit noise behind that filter.
    filter_window: Option<u32>,
    /// Rate of these samples in Hz; 800 if it is not given.
    internal_rate_hz: Option<f64>,
    /// What the columns of a foreign CSV are: pairs FOREIGN=NAME, separated by commas. FOREIGN is a header's name or a
    /// position (`#3`), NAME a channel with its unit (`accel_x_g`), or `time_s`, `time_ms`, `time_us`, `time_ns`.
    #[param(example = "Time [ms]=time_ms,ax=accel_x_g")]
    columns: Option<String>,
    /// Definitions of messages that a bag does not bring along: a JSON list of `{"name": "package/msg/Name", "text": "…"}`,
    /// the text being that of the type's `.msg` file.
    #[param(example = "[{\"name\": \"own_msgs/msg/Reading\", \"text\": \"float64 gyro_x_rad_s\"}]")]
    message_definitions: Option<String>,
}

/// Makes a recording (CSV, raw lines or bytes, a ROS bag, MCAP) a capture; answers once it is one. The same recording again is the same capture.
#[utoipa::path(post, path = "/v1/imports", tag = "captures", params(ImportQuery),
    request_body(content = Vec<u8>, content_type = "application/octet-stream", description = "The recording's bytes"), responses(
    (status = 201, body = ImportReport, headers(("Location" = String, description = "The capture"))),
    (status = 200, body = ImportReport, description = "It was imported before"),
    (status = 400, body = Problem, content_type = "application/problem+json"),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "The name is taken"),
    (status = 413, body = Problem, content_type = "application/problem+json"),
    (status = 415, body = Problem, content_type = "application/problem+json"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "It is no recording that can be read"),
    (status = 503, body = Problem, content_type = "application/problem+json", description = "Another one is being imported, or there is no room")))]
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
    let announced = request.body().size_hint().lower();
    room_for(&state, announced)?;
    let folder = state.parts.store.path().parent().unwrap_or(Path::new(".")).to_owned();
    let aside = tokio::task::spawn_blocking(move || {
        tempfile::Builder::new().prefix(crate::control::IMPORT_PREFIX).tempfile_in(folder)
    });
    let aside = aside.await.map_err(|error| ApiError::internal(error.to_string()))?.map_err(|error| no_room(&error))?;
    let reopened = aside.reopen().map_err(|error| no_room(&error))?;
    receive(&state, request.into_body(), tokio::fs::File::from_std(reopened)).await?;
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
        name: query.name,
        abandoned: abandoned.clone(),
    };
    // Whoever goes away before the answer has called it off.
    let _waiting = abandoned.drop_guard();
    let (answer, outcome) = tokio::sync::oneshot::channel();
    // A thread of its own: its priority is lower than that of the runtime's threads, which never wait for it.
    let thread = std::thread::Builder::new().name("import".to_owned()).spawn(move || {
        crate::jobs::step_back();
        let outcome = importer.import(wanted);
        // The next one may be sent as soon as this one is answered.
        drop((aside, permit));
        // Nobody hears it where whoever sent the recording has gone.
        let _ = answer.send(outcome);
    });
    thread.map_err(|error| ApiError::unavailable(format!("an import cannot be started now: {error}"), 5))?;
    let report = outcome.await.map_err(|_| ApiError::internal("an import ended abnormally"))??;
    let status = if report.new { StatusCode::CREATED } else { StatusCode::OK };
    let location = HeaderValue::from_str(&format!("/v1/captures/{}", report.capture));
    let mut response = (status, Json(report)).into_response();
    if let Ok(location) = location {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// Refuses what can be refused before the body comes; the definitions of messages.
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
    // A compressed recording is known by its bytes, whatever the header says; other encodings are not undone.
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
    // Before the body comes: it would be sent for nothing.
    if let Some(name) = &query.name {
        crate::store::check_name(name)?;
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

/// Writes the body to the file, at the disk's pace and no faster than [`BYTES_PER_S`]; one piece is in memory at a time.
async fn receive(state: &ApiState, mut body: Body, mut file: tokio::fs::File) -> Result<(), ApiError> {
    let begun = Instant::now();
    let (mut received, mut looked) = (0_u64, 0_u64);
    let (mut window, mut in_window) = (Instant::now(), 0_u64);
    loop {
        let next = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context));
        let frame = match tokio::time::timeout(PATIENCE, next).await {
            Err(_) => return Err(too_slow()),
            Ok(None) => break,
            Ok(Some(Err(error))) => return Err(ApiError::bad_request(format!("the body ended early: {error}"))),
            Ok(Some(Ok(frame))) => frame,
        };
        if state.parts.importer.is_stopping() {
            return Err(ImportError::Stopping.into());
        }
        let Ok(bytes) = frame.into_data() else { continue };
        received += bytes.len() as u64;
        in_window += bytes.len() as u64;
        if window.elapsed() > PATIENCE {
            if in_window < PROGRESS_BYTES {
                return Err(too_slow());
            }
            (window, in_window) = (Instant::now(), 0);
        }
        if received >= looked + LOOK_BYTES {
            looked = received;
            room_for(state, 0)?;
        }
        if received > RECORDING_BYTES {
            return Err(too_large());
        }
        file.write_all(&bytes).await.map_err(|error| no_room(&error))?;
        let due = Duration::from_secs_f64(received as f64 / BYTES_PER_S);
        tokio::time::sleep(due.saturating_sub(begun.elapsed())).await;
    }
    if received == 0 {
        return Err(ApiError::bad_request("the body is empty: expected a recording's bytes"));
    }
    file.flush().await.map_err(|error| no_room(&error))
}

/// Whether so many more bytes leave the reserve untouched.
fn room_for(state: &ApiState, bytes: u64) -> Result<(), ApiError> {
    if bytes > RECORDING_BYTES {
        return Err(too_large());
    }
    let free_bytes = state.status().storage.free_bytes;
    if free_bytes < state.parts.reserve_bytes.saturating_add(bytes) {
        return Err(ApiError::unavailable(
            format!(
                "{} MiB are free and {} MiB are kept for captures: make room for {} MiB and try again",
                free_bytes >> 20,
                state.parts.reserve_bytes >> 20,
                bytes >> 20
            ),
            60,
        ));
    }
    Ok(())
}

fn too_large() -> ApiError {
    ApiError::new(ProblemType::TooLarge, format!("a recording holds at most {} GiB", RECORDING_BYTES >> 30))
}

fn too_slow() -> ApiError {
    let detail = format!(
        "less than {} KiB came within {} s: send the recording again",
        PROGRESS_BYTES >> 10,
        PATIENCE.as_secs()
    );
    ApiError::new(ProblemType::BodyTimeout, detail)
}

fn no_room(error: &std::io::Error) -> ApiError {
    ApiError::unavailable(format!("the recording cannot be put aside beside the database: {error}"), 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_a_recording_is_checked_before_its_body_comes() {
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
    }
}
