//! Captures: start, stop, list, show, change, pin, delete; and their accounting.

use super::extract::{J, P, Q};
use super::page::{self, PageQuery};
use super::problem::{ApiError, Problem};
use super::state::ApiState;
use crate::control::CaptureRequest;
use crate::store::{CaptureChange, CaptureRow, CaptureState, DeviceClockRow, EventRow, GapRow, SegmentRow, StoreError};
use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, Uri};
use axum::response::Response;
use chrono::{DateTime, Utc};
use imu_core::sample::audit::Report;
use imu_core::units::{format_duration, parse_duration};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Shortest and longest permitted sample time of a capture.
const DURATION: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(366 * 86_400));

/// A page of captures, the latest first.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Captures {
    captures: Vec<CaptureRow>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// The wanted captures.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CapturesQuery {
    /// Only captures in this state.
    #[param(inline)]
    state: Option<CaptureState>,
    /// Maximum number of rows.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<u32>,
    /// `next` of the page before.
    cursor: Option<String>,
}

/// The request to start a capture.
#[derive(Debug, Default, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct StartBody {
    /// Its sample time, `5h`, `90m`, `1h30m`; the configuration's if absent.
    #[schema(example = "5h")]
    duration: Option<String>,
    /// Its name, with a number if it is taken (`desk-2`); date and time if absent.
    name: Option<String>,
    /// A note about it, one line.
    #[schema(example = "on foam, 23 °C", max_length = 1000)]
    note: Option<String>,
    /// When to begin; at once if absent.
    start_at: Option<DateTime<Utc>>,
}

/// A change of a capture; what is absent stays.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ChangeBody {
    /// Its new name.
    #[schema(max_length = 100)]
    name: Option<String>,
    /// Its new note, one line; an empty one and null remove the note.
    #[serde(default, deserialize_with = "given")]
    #[schema(value_type = Option<String>, max_length = 1000)]
    note: Option<Option<String>>,
    /// Whether it is protected from deletion.
    pinned: Option<bool>,
}

/// The request to keep a capture.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PinBody {
    /// True (also without a body): the capture is not deleted by anything.
    pinned: bool,
}

/// Distinguishes a member that is null from one that is absent.
fn given<'de, D: serde::Deserializer<'de>>(value: D) -> Result<Option<Option<String>>, D::Error> {
    Option::deserialize(value).map(Some)
}

/// A capture with the check of its numbers.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CaptureWithAccounting {
    #[serde(flatten)]
    capture: CaptureRow,
    /// Whether its numbers agree with each other and with the sensor's ticks.
    accounting: Report,
    /// The sensor's clock against the host's, by epoch (the first hundred).
    clocks: Vec<DeviceClockRow>,
}

/// A page of gaps.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Gaps {
    gaps: Vec<GapRow>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// A page of segments.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Segments {
    segments: Vec<SegmentRow>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// A page of events.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Events {
    events: Vec<EventRow>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// Captures, the latest first.
#[utoipa::path(get, path = "/v1/captures", tag = "captures", params(CapturesQuery), responses(
    (status = 200, body = Captures),
    (status = 400, body = Problem, content_type = "application/problem+json")))]
pub(super) async fn list(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<CapturesQuery>,
) -> Result<Response, ApiError> {
    let request = page::request(query.limit, query.cursor)?;
    let found = state.read(move |reader| reader.captures(query.state, &request)).await?;
    Ok(page::answer(&uri, found, |captures, next| Captures { captures, next }))
}

/// Starts a capture, or lets one wait for its time.
#[utoipa::path(post, path = "/v1/captures", tag = "captures", request_body = StartBody, responses(
    (status = 201, body = CaptureRow, headers(("Location" = String, description = "The capture"))),
    (status = 400, body = Problem, content_type = "application/problem+json"),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "One runs already")))]
pub(super) async fn start(State(state): State<ApiState>, J(body, _permit): J<StartBody>) -> Result<Response, ApiError> {
    let body = body.unwrap_or_default();
    let duration = match &body.duration {
        Some(text) => parse_duration(text).map_err(|error| ApiError::bad_request(format!("`duration`: {error}")))?,
        None => state.parts.default_duration,
    };
    if !(DURATION.0..=DURATION.1).contains(&duration) {
        return Err(ApiError::bad_request(format!(
            "`duration` is {}: allowed is {} to {}",
            format_duration(duration),
            format_duration(DURATION.0),
            format_duration(DURATION.1)
        )));
    }
    let start_at_utc_ns = body
        .start_at
        .map(|at| {
            at.timestamp_nanos_opt().ok_or_else(|| ApiError::bad_request("`start_at` is before 1678 or after 2261"))
        })
        .transpose()?;
    let StartBody { name, note, .. } = body;
    let request = CaptureRequest { duration, name, numbered: true, note, start_at_utc_ns };
    let id = state.parts.control.start(request).await?;
    let capture = state.read(move |reader| reader.capture(id)).await?;
    Ok(page::made(true, &format!("/v1/captures/{id}"), capture))
}

/// One capture with its counts.
#[utoipa::path(get, path = "/v1/captures/{id}", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`")), responses(
    (status = 200, body = CaptureWithAccounting)))]
pub(super) async fn show(State(state): State<ApiState>, P(name): P) -> Result<Json<CaptureWithAccounting>, ApiError> {
    let (capture, accounting, clocks) = state
        .read(move |reader| {
            let id = reader.resolve(&name)?;
            Ok((reader.capture(id)?, reader.accounting(id)?, reader.device_clocks(id)?))
        })
        .await?;
    // While the capture runs, samples on their way to the disk count too.
    let running = state.status().capture.filter(|running| running.id == capture.id && capture.state.is_open());
    let accounting = match running {
        Some(now) => accounting.at_this_instant(now.received, now.committed, now.in_flight, now.discarded),
        None => accounting,
    };
    Ok(Json(CaptureWithAccounting { capture, accounting, clocks }))
}

/// Changes a capture's name, note or protection, all of it or nothing.
#[utoipa::path(patch, path = "/v1/captures/{id}", tag = "captures", request_body = ChangeBody,
    params(("id" = String, Path, description = "Id, name, or `latest`")), responses(
    (status = 200, body = CaptureRow),
    (status = 400, body = Problem, content_type = "application/problem+json", description = "The name or the note is not allowed, or nothing is to be changed"),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "Another capture has the name")))]
pub(super) async fn change(
    State(state): State<ApiState>,
    P(name): P,
    J(body, _permit): J<ChangeBody>,
) -> Result<Json<CaptureRow>, ApiError> {
    let Some(ChangeBody { name: new_name, note, pinned }) = body else { return Err(nothing_to_change()) };
    let change = CaptureChange { name: new_name, note: note.map(Option::unwrap_or_default), pinned };
    if change == CaptureChange::default() {
        return Err(nothing_to_change());
    }
    let id = state.resolve(name).await?;
    state.change(move |parts| parts.store.change_capture(id, change)).await?;
    Ok(Json(state.read(move |reader| reader.capture(id)).await?))
}

fn nothing_to_change() -> ApiError {
    ApiError::bad_request("the body changes nothing: name at least one of `name`, `note` (empty: none) and `pinned`")
}

/// Deletes a capture with all its samples. One that runs, waits or is pinned stays.
#[utoipa::path(delete, path = "/v1/captures/{id}", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`")), responses(
    (status = 204, description = "It is gone"),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "It runs, waits or is pinned")))]
pub(super) async fn delete(State(state): State<ApiState>, P(name): P) -> Result<StatusCode, ApiError> {
    let id = state.resolve(name).await?;
    state
        .change(move |parts| {
            parts.store.delete_capture(id)?;
            // The workers remove its rows step by step.
            parts.jobs.wake();
            Ok::<_, StoreError>(())
        })
        .await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Stops the running or waiting capture; answers once its last sample is on disk.
#[utoipa::path(post, path = "/v1/captures/{id}/stop", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`")), responses(
    (status = 200, body = CaptureRow),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "It is not running")))]
pub(super) async fn stop(State(state): State<ApiState>, P(name): P) -> Result<Json<CaptureRow>, ApiError> {
    let id = state.resolve(name).await?;
    state.parts.control.stop(id).await?;
    Ok(Json(state.read(move |reader| reader.capture(id)).await?))
}

/// Protects a capture from deletion, or ends the protection.
#[utoipa::path(post, path = "/v1/captures/{id}/pin", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`")),
    request_body(content = Option<PinBody>, description = "Without a body: pinned"), responses(
    (status = 200, body = CaptureRow)))]
pub(super) async fn pin(
    State(state): State<ApiState>,
    P(name): P,
    J(body, _permit): J<PinBody>,
) -> Result<Json<CaptureRow>, ApiError> {
    let pinned = body.is_none_or(|body| body.pinned);
    let id = state.resolve(name).await?;
    state.change(move |parts| parts.store.pin(id, pinned)).await?;
    Ok(Json(state.read(move |reader| reader.capture(id)).await?))
}

/// A capture's gaps: their times, their missing samples, their causes.
#[utoipa::path(get, path = "/v1/captures/{id}/gaps", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`"), PageQuery), responses(
    (status = 200, body = Gaps)))]
pub(super) async fn gaps(
    State(state): State<ApiState>,
    uri: Uri,
    P(name): P,
    Q(query): Q<PageQuery>,
) -> Result<Response, ApiError> {
    let request = query.request()?;
    let found = state.read(move |reader| reader.gaps(reader.resolve(&name)?, &request)).await?;
    Ok(page::answer(&uri, found, |gaps, next| Gaps { gaps, next }))
}

/// A capture's segments: the longest stretches without a gap, at one rate and one configuration.
#[utoipa::path(get, path = "/v1/captures/{id}/segments", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`"), PageQuery), responses(
    (status = 200, body = Segments)))]
pub(super) async fn segments(
    State(state): State<ApiState>,
    uri: Uri,
    P(name): P,
    Q(query): Q<PageQuery>,
) -> Result<Response, ApiError> {
    let request = query.request()?;
    let found = state.read(move |reader| reader.segments(reader.resolve(&name)?, &request)).await?;
    Ok(page::answer(&uri, found, |segments, next| Segments { segments, next }))
}

/// A capture's events.
#[utoipa::path(get, path = "/v1/captures/{id}/events", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`"), PageQuery), responses(
    (status = 200, body = Events)))]
pub(super) async fn events(
    State(state): State<ApiState>,
    uri: Uri,
    P(name): P,
    Q(query): Q<PageQuery>,
) -> Result<Response, ApiError> {
    let request = query.request()?;
    let found = state.read(move |reader| reader.events(reader.resolve(&name)?, &request)).await?;
    Ok(page::answer(&uri, found, |events, next| Events { events, next }))
}
