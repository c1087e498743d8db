//! Background jobs: submit, list, show, cancel.

use super::extract::{J, P, Q};
use super::page;
use super::problem::{ApiError, Problem};
use super::state::ApiState;
use crate::jobs::{AnalysisRequest, DiagnosisBody, JobError, Jobs};
use crate::store::{JobKind, JobRow, JobState};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

/// When to query a job again that is not done, s.
pub(super) const RETRY_AFTER_S: u32 = 2;

/// A job, and the place of its result.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub(super) struct Job {
    #[serde(flatten)]
    row: JobRow,
    /// Path of the result; null until it is done.
    result: Option<String>,
}

impl From<JobRow> for Job {
    fn from(row: JobRow) -> Self {
        let result = row.result_id.map(|_| {
            if row.kind == JobKind::Diagnosis {
                return format!("/v1/diagnoses/{}", row.id);
            }
            format!("/v1/captures/{}/{}?job={}", row.capture, row.kind.name(), row.id)
        });
        Self { row, result }
    }
}

/// A page of jobs, the latest first.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct JobList {
    jobs: Vec<Job>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// The wanted jobs.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct JobsQuery {
    /// Only jobs of this capture: id, name, or `latest`.
    capture: Option<String>,
    /// Only jobs in this state.
    #[param(inline)]
    state: Option<JobState>,
    /// Maximum number of rows.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<u32>,
    /// `next` of the page before.
    cursor: Option<String>,
}

/// A capture, as named in a body.
#[derive(Debug, Clone, Deserialize, utoipa::ToSchema)]
#[serde(untagged, expecting = "a capture is an id, a name, or `latest`")]
pub(super) enum CaptureName {
    /// Its id.
    Id(i64),
    /// Its name, or `latest`.
    Name(String),
}

impl CaptureName {
    fn text(self) -> String {
        match self {
            Self::Id(id) => id.to_string(),
            Self::Name(name) => name,
        }
    }
}

/// The request for a job. Further members are the parameters of the kind.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
pub(super) struct SubmitBody {
    /// The computation.
    #[schema(example = "allan")]
    kind: String,
    /// The capture that the job reads.
    #[schema(inline)]
    capture: CaptureName,
    /// For `allan` and `noise`: further captures of the same sensor at the same setting, which have ended. Their sums
    /// are added and give one result.
    #[serde(default)]
    #[schema(inline)]
    with: Vec<CaptureName>,
    #[serde(flatten)]
    #[schema(value_type = Object)]
    parameters: serde_json::Map<String, serde_json::Value>,
}

/// Jobs, the latest first.
#[utoipa::path(get, path = "/v1/jobs", tag = "jobs", params(JobsQuery), responses(
    (status = 200, body = JobList),
    (status = 400, body = Problem, content_type = "application/problem+json")))]
pub(super) async fn list(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<JobsQuery>,
) -> Result<Response, ApiError> {
    let request = page::request(query.limit, query.cursor)?;
    let found = state
        .read(move |reader| {
            let capture_id = query.capture.as_deref().map(|name| reader.resolve(name)).transpose()?;
            reader.jobs(capture_id, query.state, &request)
        })
        .await?;
    Ok(page::answer(&uri, found, |jobs, next| JobList { jobs: jobs.into_iter().map(Job::from).collect(), next }))
}

/// Queues a job over the samples that the capture has now. The same request again returns the same job.
#[utoipa::path(post, path = "/v1/jobs", tag = "jobs", request_body = SubmitBody, responses(
    (status = 202, body = Job, description = "It is queued", headers(("Location" = String, description = "The job"))),
    (status = 200, body = Job, description = "It was submitted before"),
    (status = 400, body = Problem, content_type = "application/problem+json"),
    (status = 404, body = Problem, content_type = "application/problem+json")))]
pub(super) async fn submit(
    State(state): State<ApiState>,
    J(body, _permit): J<SubmitBody>,
) -> Result<Response, ApiError> {
    let body =
        body.ok_or_else(|| ApiError::bad_request("the body is empty: expected {\"kind\": …, \"capture\": …}"))?;
    let kind: JobKind = body.kind.parse().map_err(|_| {
        let (found, expected): (String, _) = (body.kind.chars().take(40).collect(), JobKind::ALL.map(JobKind::name));
        ApiError::bad_request(format!("there is no job kind `{found}`: expected one of {}", expected.join(", ")))
    })?;
    let capture_id = state.resolve(body.capture.text()).await?;
    let mut parameters = body.parameters;
    let mut with = Vec::new();
    for name in body.with {
        with.push(state.resolve(name.text()).await?);
    }
    if !with.is_empty() {
        parameters.insert("with".to_owned(), with.into());
    }
    if kind == JobKind::Diagnosis {
        let body = serde_json::to_vec(&parameters).map_err(JobError::from)?;
        return queue_diagnosis(&state, move |jobs| jobs.submit_diagnosis(capture_id, DiagnosisBody::Bytes(&body)))
            .await;
    }
    let request = AnalysisRequest::of_members(kind, parameters)?;
    Ok(submitted(state.change(move |parts| parts.jobs.submit(capture_id, request)).await?))
}

/// Queues a diagnosis: 202, or 200 if it exists already. It does not delay requests that start and stop captures.
pub(super) async fn queue_diagnosis(
    state: &ApiState,
    submit: impl FnOnce(&Jobs) -> Result<(JobRow, bool), JobError> + Send + 'static,
) -> Result<Response, ApiError> {
    Ok(submitted(state.take_in(move |parts| submit(&parts.jobs)).await?))
}

/// Returns the answer to a request for a job: 202, or 200 if the job exists already.
fn submitted((row, is_new): (JobRow, bool)) -> Response {
    answer(if is_new { StatusCode::ACCEPTED } else { StatusCode::OK }, row)
}

/// One job.
#[utoipa::path(get, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = i64, Path, description = "Id")), responses(
    (status = 200, body = Job, headers(("Retry-After" = u32, description = "While it is queued or runs")))))]
pub(super) async fn show(State(state): State<ApiState>, P(id): P) -> Result<Response, ApiError> {
    let id = job_id(&id)?;
    Ok(answer(StatusCode::OK, state.read(move |reader| reader.job(id)).await?))
}

/// Cancels a queued or running job.
#[utoipa::path(delete, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = i64, Path, description = "Id")), responses(
    (status = 200, body = Job, description = "It is cancelled"),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "It has ended already")))]
pub(super) async fn cancel(State(state): State<ApiState>, P(id): P) -> Result<Response, ApiError> {
    let id = job_id(&id)?;
    state.change(move |parts| parts.jobs.cancel(id)).await?;
    Ok(answer(StatusCode::OK, state.read(move |reader| reader.job(id)).await?))
}

fn job_id(text: &str) -> Result<i64, ApiError> {
    text.parse().map_err(|_| ApiError::bad_request("a job's id is a whole number: GET /v1/jobs lists them"))
}

/// Returns a job's answer: its place, and when to query it again while it is not done.
pub(super) fn answer(status: StatusCode, row: JobRow) -> Response {
    let (id, open) = (row.id, matches!(row.state, JobState::Queued | JobState::Running));
    let mut response = (status, Json(Job::from(row))).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    if let Ok(location) = HeaderValue::from_str(&format!("/v1/jobs/{id}")) {
        headers.insert(header::LOCATION, location);
    }
    if open {
        headers.insert(header::RETRY_AFTER, HeaderValue::from(RETRY_AFTER_S));
    }
    response
}
