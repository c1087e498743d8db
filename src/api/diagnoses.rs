//! Diagnoses: request, list, and show as a document, as a model and as a page. A diagnosis has its job's id.

use super::analysis::{unfinished, with_stale};
use super::extract::{P, Q, is_json, no_json};
use super::problem::{ApiError, Problem};
use super::state::ApiState;
use super::{aside, conditional, held, jobs, page};
use crate::jobs::{DiagnosisBody as Body, DiagnosisDocument, ReferenceAxis, read_diagnosis};
use crate::page as pages;
use crate::store::{DiagnosisRow, JobKind, JobRow, JobState, Reader, ResultRow, StoreError, UtcNs};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use axum::response::Response;
use hyper::body::Body as _;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::time::Duration;

/// The object that a capture is compared with.
#[derive(Debug, utoipa::ToSchema)]
#[expect(dead_code, reason = "the interface's description; `jobs` reads the body")]
pub(super) struct DiagnosisBody {
    /// A model's id (`"model-1"`), a sensor model, or the id or name of a capture that a simulator made.
    #[schema(value_type = Object)]
    sim: Option<Value>,
    /// The sensor's motion: the text of a CSV with `time_s`, `ref_gyro_x_rad_s` … `ref_accel_z_m_s2`, or `still`,
    /// `tumble`, `poses`, `rate-table` for the motions that the simulator makes. Effects that a motion drives are diagnosed too.
    #[schema(value_type = String)]
    reference: Option<Value>,
    /// The sensor's axis about which an encoder turns: for a reference with `encoder_rpm`.
    #[schema(inline)]
    reference_axis: Option<ReferenceAxis>,
}

/// A diagnosis in a list.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct DiagnosisEntry {
    /// The id, which is also that of the job.
    id: i64,
    /// The capture's id.
    capture: i64,
    /// The state of the job.
    state: JobState,
    /// The progress, 0–1.
    progress: f64,
    /// The time of the request.
    created_at: UtcNs,
    /// The time of the end.
    finished_at: Option<UtcNs>,
    /// The verdict: `no_gap`, `parameters`, `effects` or `unknown_effect`; null until it is done.
    verdict: Option<String>,
    /// The summary in one sentence; null until it is done.
    summary: Option<String>,
    /// The reason for the failure.
    error: Option<String>,
    /// Whether another version of the program made it.
    stale: bool,
    /// Path of the page.
    page: String,
}

impl From<DiagnosisRow> for DiagnosisEntry {
    fn from(row: DiagnosisRow) -> Self {
        let DiagnosisRow { job, verdict, summary } = row;
        Self {
            id: job.id,
            capture: job.capture,
            state: job.state,
            progress: job.progress,
            created_at: job.created_at,
            finished_at: job.finished_at,
            verdict,
            summary,
            error: job.error,
            stale: job.stale,
            page: format!("/diagnoses/{}", job.id),
        }
    }
}

/// A page of diagnoses, the latest first.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Diagnoses {
    diagnoses: Vec<DiagnosisEntry>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// The wanted diagnoses.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DiagnosesQuery {
    /// Only diagnoses of this capture: id, name, or `latest`.
    capture: Option<String>,
    /// Maximum number of rows.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<u32>,
    /// `next` of the page before.
    cursor: Option<String>,
}

/// Enough for a request with a reference of half an hour at 100 Hz.
const LARGE_BODY: aside::Kind = aside::Kind {
    called: "a diagnosis with its reference",
    bytes_max: 32 << 20,
    time_max: Some(Duration::from_secs(120)),
};

/// Compares a capture with a simulator, as a job. The same request again returns the same job.
#[utoipa::path(post, path = "/v1/captures/{id}/diagnoses", tag = "diagnoses",
    params(("id" = String, Path, description = "Id, name, or `latest`")), request_body = DiagnosisBody, responses(
    (status = 202, body = jobs::Job, description = "It is queued", headers(("Location" = String, description = "The job"))),
    (status = 200, body = jobs::Job, description = "It was asked for before"),
    (status = 400, body = Problem, content_type = "application/problem+json", description = "No model, or an impossible one"),
    (status = 408, body = Problem, content_type = "application/problem+json", description = "The body does not come"),
    (status = 413, body = Problem, content_type = "application/problem+json", description = "More than 32 MiB, or a model of more than 64 KiB"),
    (status = 415, body = Problem, content_type = "application/problem+json"),
    (status = 429, body = Problem, content_type = "application/problem+json", description = "Another large body is being taken in")))]
pub(super) async fn submit(
    State(state): State<ApiState>,
    P(capture): P,
    request: Request,
) -> Result<Response, ApiError> {
    let announced = request.body().size_hint().upper();
    if announced == Some(0) {
        return Err(ApiError::bad_request("the body is empty: expected {\"sim\": …}"));
    }
    if !is_json(request.headers()) {
        return Err(no_json());
    }
    let capture_id = state.resolve(capture).await?;
    LARGE_BODY.room_for(&state, announced.unwrap_or(0))?;
    if !is_put_aside(&request) {
        let (body, _permit) = held::body(&state, request.into_body()).await?;
        return jobs::queue_diagnosis(&state, move |jobs| jobs.submit_diagnosis(capture_id, Body::Bytes(&body))).await;
    }
    let permit = state.body_permit()?;
    let aside = LARGE_BODY.put(&state, request.into_body(), || Ok(())).await?;
    jobs::queue_diagnosis(&state, move |jobs| {
        let submitted = jobs.submit_diagnosis(capture_id, Body::File(aside.path()));
        drop((aside, permit));
        submitted
    })
    .await
}

/// Returns whether this request asks for a diagnosis with a body that may be large.
pub(super) fn is_put_aside(request: &Request) -> bool {
    let is_small = request.body().size_hint().upper().is_some_and(|bytes| bytes <= held::BODY_BYTES as u64);
    request.method() == Method::POST && request.uri().path().ends_with("/diagnoses") && !is_small
}

/// Diagnoses, the latest first.
#[utoipa::path(get, path = "/v1/diagnoses", tag = "diagnoses", params(DiagnosesQuery), responses(
    (status = 200, body = Diagnoses),
    (status = 400, body = Problem, content_type = "application/problem+json")))]
pub(super) async fn list(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<DiagnosesQuery>,
) -> Result<Response, ApiError> {
    let request = page::request(query.limit, query.cursor)?;
    let found = state
        .read(move |reader| {
            let capture_id = query.capture.as_deref().map(|name| reader.resolve(name)).transpose()?;
            reader.diagnoses(capture_id, &request)
        })
        .await?;
    let entries = |rows: Vec<DiagnosisRow>, next| Diagnoses {
        diagnoses: rows.into_iter().map(DiagnosisEntry::from).collect(),
        next,
    };
    Ok(page::answer(&uri, found, entries))
}

/// A diagnosis: how capture and simulator differ, which effects the simulator lacks, and how far they close the gap.
#[utoipa::path(get, path = "/v1/diagnoses/{id}", tag = "diagnoses",
    params(("id" = String, Path, description = "Id, or `latest`")), responses(
    (status = 200, body = Object, description = "`vn100d-diagnosis-1`",
     headers(("ETag" = String, description = "Of the result"))),
    (status = 202, body = jobs::Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "They cannot be compared")))]
pub(super) async fn show(State(state): State<ApiState>, headers: HeaderMap, P(id): P) -> Result<Response, ApiError> {
    part(&state, &headers, id, "report", |document| document.report.get().to_owned()).await
}

/// The corrected model of a diagnosis: with the found parameters and the missing effects.
#[utoipa::path(get, path = "/v1/diagnoses/{id}/model", tag = "diagnoses",
    params(("id" = String, Path, description = "Id, or `latest`")), responses(
    (status = 200, body = Object, description = "`vn100d-sensor-model-1`",
     headers(("ETag" = String, description = "Of the result"))),
    (status = 202, body = jobs::Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "They cannot be compared")))]
pub(super) async fn model(State(state): State<ApiState>, headers: HeaderMap, P(id): P) -> Result<Response, ApiError> {
    part(&state, &headers, id, "model", |document| document.model.get().to_owned()).await
}

/// Returns a page for people: the diagnosis, or the progress of its job.
pub(super) async fn page(State(state): State<ApiState>, P(id): P) -> Result<Response, ApiError> {
    let (job, result) = state.read(move |reader| find(reader, &id)).await?;
    let html = match result {
        Some(result) => {
            state
                .compute(move |_, _| {
                    let (report, drawings) = read_diagnosis(&result.body)?;
                    let links = [
                        ("as JSON", format!("/v1/diagnoses/{}", job.id)),
                        ("corrected model", format!("/v1/diagnoses/{}/model", job.id)),
                        ("the capture", format!("/captures/{}", job.capture)),
                        ("its other diagnoses", format!("/v1/diagnoses?capture={}", job.capture)),
                    ];
                    Ok(pages::diagnosis(&report, &drawings, &links))
                })
                .await?
        }
        None => pages::waiting(&format!("diagnosis {}", job.id), job.state.name(), job.progress, job.error.as_deref()),
    };
    Ok(super::html::html(html))
}

/// Returns a part of a result as stored, or the job that will make it.
async fn part(
    state: &ApiState,
    headers: &HeaderMap,
    id: String,
    form: &str,
    take: impl FnOnce(&DiagnosisDocument<'_>) -> String,
) -> Result<Response, ApiError> {
    let (job, result) = state.read(move |reader| find(reader, &id)).await?;
    let Some(result) = result else { return unfinished(job) };
    let body = take(&DiagnosisDocument::read(&result.body)?);
    let json = [(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))];
    let tag = conditional::entity_tag_of_form(&result, form);
    Ok(with_stale(conditional::answer(headers, &tag, (json, body)), &result.software))
}

/// Returns the job of a diagnosis, and its result once it is there.
fn find(reader: &Reader, id: &str) -> Result<(JobRow, Option<ResultRow>), StoreError> {
    let unknown = || StoreError::NoSuchDiagnosis(id.chars().take(40).collect());
    let number = if id == "latest" { reader.latest_diagnosis()? } else { id.parse().map_err(|_| unknown())? };
    let job = match reader.job(number) {
        Err(StoreError::NoSuchJob(_)) => return Err(unknown()),
        job => job?,
    };
    if job.kind != JobKind::Diagnosis {
        return Err(unknown());
    }
    let result = job.result_id.map(|id| reader.result(id)).transpose()?.flatten();
    Ok((job, result))
}
