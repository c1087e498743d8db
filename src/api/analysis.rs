//! Analyses of a capture: the stored result of its job, 202 until that is done, and what there is so far while the
//! capture still runs.

use super::conditional;
use super::extract::{P, Q};
use super::jobs::{self, Job};
use super::problem::{ApiError, Problem, ProblemType};
use super::state::{ApiParts, ApiState};
use crate::jobs::{JobError, JobKind, SoFar, StatisticsReport};
use crate::noise::NoiseReport;
use crate::noise::allan::AllanReport;
use crate::store::{JobRow, JobState, Reader, ResultRow, SOFTWARE, StoreError};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

/// Names the program version that made a result, where it is not this one; `POST /v1/jobs` has it made anew.
const STALE: HeaderName = HeaderName::from_static("vn100d-stale");

/// Which result is wanted.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ResultQuery {
    /// The result of this job, instead of the one with the usual parameters.
    job: Option<i64>,
    /// `json`.
    format: Option<String>,
}

/// How far a capture's analysis is.
enum Found {
    /// The capture runs or waits.
    Open(i64),
    /// Here it is.
    Result(ResultRow),
    /// It is being worked on.
    Job(JobRow),
    /// Nobody has asked for it yet.
    Nothing(i64),
}

/// Moments, histogram and a test for normality of every channel. While the capture runs: of what there is so far.
#[utoipa::path(get, path = "/v1/captures/{id}/statistics", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"), ResultQuery), responses(
    (status = 200, body = SoFar<StatisticsReport>, headers(("ETag" = String, description = "Of a finished result"))),
    (status = 202, body = Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 404, body = Problem, content_type = "application/problem+json"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "There is not enough data")))]
pub(super) async fn statistics(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P(capture): P,
    Q(query): Q<ResultQuery>,
) -> Result<Response, ApiError> {
    let live = |reader: &Reader, parts: &ApiParts, id| parts.live.statistics(reader, id);
    document(&state, &headers, JobKind::Statistics, capture, query, live).await
}

/// Overlapping Allan deviation of every analysed channel. While the capture runs: of what there is so far.
#[utoipa::path(get, path = "/v1/captures/{id}/allan", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"), ResultQuery), responses(
    (status = 200, body = SoFar<AllanReport>, headers(("ETag" = String, description = "Of a finished result"))),
    (status = 202, body = Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 404, body = Problem, content_type = "application/problem+json"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "There is not enough data")))]
pub(super) async fn allan(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P(capture): P,
    Q(query): Q<ResultQuery>,
) -> Result<Response, ApiError> {
    let live = |reader: &Reader, parts: &ApiParts, id| parts.live.allan(reader, id);
    document(&state, &headers, JobKind::Allan, capture, query, live).await
}

/// Noise parameters N, B, K, Q, R of every analysed channel, with intervals and units. While the capture runs: of what there is so far.
#[utoipa::path(get, path = "/v1/captures/{id}/noise", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"), ResultQuery), responses(
    (status = 200, body = SoFar<NoiseReport>, headers(("ETag" = String, description = "Of a finished result"))),
    (status = 202, body = Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 404, body = Problem, content_type = "application/problem+json"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "There is not enough data")))]
pub(super) async fn noise(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P(capture): P,
    Q(query): Q<ResultQuery>,
) -> Result<Response, ApiError> {
    let live = |reader: &Reader, parts: &ApiParts, id| parts.live.noise(reader, id);
    document(&state, &headers, JobKind::Noise, capture, query, live).await
}

/// The document of this kind: of the job asked for, or of the one with the usual parameters.
async fn document<T: Serialize + Send + 'static>(
    state: &ApiState,
    headers: &HeaderMap,
    kind: JobKind,
    name: String,
    query: ResultQuery,
    live: impl FnOnce(&Reader, &ApiParts, i64) -> Result<T, JobError> + Send + 'static,
) -> Result<Response, ApiError> {
    if let Some(format) = query.format.as_deref().filter(|format| *format != "json") {
        let found: String = format.chars().take(40).collect();
        return Err(ApiError::bad_request(format!("`format` is `{found}`: allowed is json")));
    }
    let usual = jobs::default_parameters(kind)?;
    let found = state.read(move |reader| find(reader, kind, &name, query.job, &usual)).await?;
    match found {
        Found::Open(id) => {
            let report = state.read_heavy(move |reader, parts| live(reader, parts, id)).await?;
            Ok(([(header::CACHE_CONTROL, "no-store")], axum::Json(report)).into_response())
        }
        Found::Result(result) => Ok(answer(headers, result)),
        Found::Job(row) => unfinished(row),
        Found::Nothing(id) => unfinished(jobs::submit_default(state, kind, id).await?),
    }
}

fn find(
    reader: &Reader,
    kind: JobKind,
    name: &str,
    job: Option<i64>,
    usual: &serde_json::Value,
) -> Result<Found, StoreError> {
    let id = reader.resolve(name)?;
    if let Some(job_id) = job {
        let row = reader.job(job_id)?;
        if row.capture != id || row.kind != kind.name() {
            return Err(StoreError::NoSuchJob { id: job_id });
        }
        return with_result(reader, row);
    }
    let capture = reader.capture(id)?;
    if capture.state.is_open() {
        return Ok(Found::Open(id));
    }
    let jobs = reader.jobs_over(id, kind.name(), capture.samples)?;
    // What another version of the program could not do, this one may.
    let counts = |row: &JobRow| row.params == *usual && !(row.state == JobState::Failed && row.stale);
    let usual_jobs: Vec<JobRow> = jobs.into_iter().filter(counts).collect();
    for state in [JobState::Done, JobState::Running, JobState::Queued, JobState::Failed] {
        if let Some(row) = usual_jobs.iter().find(|row| row.state == state) {
            return with_result(reader, row.clone());
        }
    }
    Ok(Found::Nothing(id))
}

fn with_result(reader: &Reader, row: JobRow) -> Result<Found, StoreError> {
    let result = match row.result_id {
        Some(result_id) => reader.result(result_id)?,
        None => None,
    };
    Ok(result.map_or(Found::Job(row), Found::Result))
}

fn answer(headers: &HeaderMap, result: ResultRow) -> Response {
    let tag = conditional::entity_tag(&result);
    let stale = (result.software != SOFTWARE).then(|| HeaderValue::from_str(&result.software).ok()).flatten();
    let json = [(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))];
    let mut response = conditional::answer(headers, &tag, (json, result.body));
    if let Some(software) = stale {
        response.headers_mut().insert(STALE, software);
    }
    response
}

fn unfinished(row: JobRow) -> Result<Response, ApiError> {
    match row.state {
        JobState::Queued | JobState::Running | JobState::Done => Ok(jobs::answer(StatusCode::ACCEPTED, row)),
        JobState::Failed | JobState::Cancelled => {
            let why = row.error.unwrap_or_else(|| "it was cancelled".to_owned());
            Err(ApiError::new(ProblemType::AnalysisFailed, format!("job {} ended without a result: {why}", row.id)))
        }
    }
}
