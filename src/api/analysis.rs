//! Analyses of a capture: the stored result of its job, 202 until that is done, and partial results while the capture
//! runs.

use super::conditional;
use super::extract::{P, Q};
use super::jobs::{self, Job};
use super::problem::{ApiError, Problem, ProblemType};
use super::state::{ApiParts, ApiState};
use crate::jobs::{AnalysisRequest, Documents, JobError, JobParameters, JobRequest, SoFar, StatisticsReport};
use crate::store::{JobKind, JobRow, JobState, Reader, ResultRow, SOFTWARE, StoreError};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use imu_core::sample::FilterWindows;
use imu_files::export::Target;
use imu_files::export::paste::NoiseDocument;
use imu_noise::NoiseReport;
use imu_noise::allan::{AllanReport, Estimator, TauSpacing};
use imu_noise::datasheet::{Datasheet, compare_report};
use serde::{Deserialize, Serialize};

/// Names the program version that made a result, if it is not this one; `POST /v1/jobs` makes the result again.
const STALE: HeaderName = HeaderName::from_static("vn100d-stale");

/// The wanted result.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ResultQuery {
    /// The result of this job, instead of the one with the usual parameters.
    job: Option<i64>,
    /// The form: `json`.
    format: Option<String>,
}

/// The wanted deviation curves.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct AllanQuery {
    /// The result of this job, instead of the one with the usual parameters.
    job: Option<i64>,
    /// The form: `json`.
    format: Option<String>,
    /// The deviation; `oadev` if absent. The others have separate jobs, which are made on the first request.
    #[param(inline)]
    estimator: Option<Estimator>,
    /// Averaging times: `log` (twenty per decade) if absent, `octave`, or `all`.
    #[param(inline)]
    taus: Option<TauSpacing>,
}

/// The wanted form of the noise parameters.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct NoiseQuery {
    /// The result of this job, instead of the one with the usual parameters.
    job: Option<i64>,
    /// `json`, or text for a program: `kalibr`, `openvins`, `vins-fusion`, `orb-slam3`, `lio-sam`, `fast-lio`, `robot-localization`,
    /// `px4`, `ardupilot`, `ros`, `gazebo`, `isaac`, `gnss-ins-sim`, `matlab`.
    format: Option<String>,
    /// Write text for a program even if parameters are not usable; a comment then states so.
    #[serde(default)]
    force: bool,
    /// Compare with this datasheet: `vn-100`. Only with `json`.
    datasheet: Option<String>,
}

/// The state of a capture's analysis.
enum Found {
    /// The capture runs or waits.
    Open(i64),
    /// The result.
    Result(ResultRow),
    /// The job that works on it.
    Job(JobRow),
}

/// Moments, histogram and a test for normality of every channel. While the capture runs: of the samples so far.
#[utoipa::path(get, path = "/v1/captures/{id}/statistics", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"), ResultQuery), responses(
    (status = 200, body = SoFar<StatisticsReport>, headers(("ETag" = String, description = "Of a finished result"))),
    (status = 202, body = Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "There is not enough data")))]
pub(super) async fn statistics(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P(capture): P,
    Q(query): Q<ResultQuery>,
) -> Result<Response, ApiError> {
    let live = |reader: &Reader, parts: &ApiParts, id| parts.live.statistics(reader, id);
    document(&state, &headers, AnalysisRequest::usual(JobKind::Statistics)?, capture, query, live).await
}

/// Deviation curves of every analysed channel. While the capture runs: overlapping Allan deviation of the samples so
/// far.
#[utoipa::path(get, path = "/v1/captures/{id}/allan", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"), AllanQuery), responses(
    (status = 200, body = SoFar<AllanReport>, headers(("ETag" = String, description = "Of a finished result"))),
    (status = 202, body = Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 400, body = Problem, content_type = "application/problem+json", description = "There is no such estimator"),
    (status = 422, body = Problem, content_type = "application/problem+json",
     description = "There is not enough data, or too much for this estimator or these averaging times")))]
pub(super) async fn allan(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P(capture): P,
    Q(query): Q<AllanQuery>,
) -> Result<Response, ApiError> {
    let estimator = query.estimator.unwrap_or_default();
    let parameters = JobParameters { estimator, taus: query.taus.unwrap_or_default(), ..JobParameters::default() };
    let request = AnalysisRequest::new(JobKind::Allan, parameters)?;
    let live = move |reader: &Reader, parts: &ApiParts, id| {
        if estimator == Estimator::Oadev { parts.live.allan(reader, id) } else { Err(still_runs(id, estimator)) }
    };
    let plain = ResultQuery { job: query.job, format: query.format };
    document(&state, &headers, request, capture, plain, live).await
}

fn still_runs(id: i64, estimator: Estimator) -> JobError {
    let reason = format!(
        "capture {id} still runs, and {} needs all of it: ask again when it has ended, take `oadev`, which answers for what \
         there is so far, or submit a job (POST /v1/jobs) over the samples of now",
        estimator.name()
    );
    JobError::InsufficientData(reason)
}

/// Noise parameters N, B, K, Q, R of every analysed channel, with intervals and units, and the numbers to paste for
/// each program. While the capture runs: of the samples so far.
#[utoipa::path(get, path = "/v1/captures/{id}/noise", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"), NoiseQuery), responses(
    (status = 200, body = SoFar<NoiseDocument>, headers(("ETag" = String, description = "Of a finished result"))),
    (status = 202, body = Job, description = "Not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the result"),
    (status = 400, body = Problem, content_type = "application/problem+json",
     description = "There is no such format or datasheet, or both are asked for"),
    (status = 422, body = Problem, content_type = "application/problem+json",
     description = "There is not enough data, or a channel that the text would hold is not usable")))]
pub(super) async fn noise(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P(capture): P,
    Q(query): Q<NoiseQuery>,
) -> Result<Response, ApiError> {
    let format = query.format.as_deref().filter(|format| *format != "json");
    let target = match format.map(|format| (format, Target::from_name(format))) {
        None => None,
        Some((_, Some(target))) => Some(target),
        Some((format, None)) => {
            let found: String = format.chars().take(40).collect();
            let allowed = Target::ALL.map(Target::name).join(", ");
            return Err(ApiError::bad_request(format!("`format` is `{found}`: allowed are json, {allowed}")));
        }
    };
    let sheet = query.datasheet.as_deref().map(Datasheet::named).transpose();
    let sheet = sheet.map_err(|error| ApiError::bad_request(error.to_string()))?;
    if target.is_some() && sheet.is_some() {
        let reason =
            "`format` and `datasheet` do not go together: only the JSON document has a place for the comparison";
        return Err(ApiError::bad_request(reason));
    }
    let found = find(&state, AnalysisRequest::usual(JobKind::Noise)?, capture.clone(), query.job).await?;
    let (so_far, result): (SoFar<NoiseReport>, Option<ResultRow>) = match found {
        Found::Open(id) => (state.compute(move |reader, parts| parts.live.noise(reader, id)).await?, None),
        Found::Result(result) => {
            let report = serde_json::from_str(&result.body).map_err(JobError::from)?;
            (SoFar { report, caught_up: None }, Some(result))
        }
        Found::Job(row) => return unfinished(row),
    };
    let SoFar { mut report, caught_up } = so_far;
    if let Some(target) = target {
        if let Some(why) = target.refusal(&report).filter(|_| !query.force) {
            let reason =
                format!("{} is not written, since it would be wrong: {why}. `force=true` writes it", target.name());
            return Err(JobError::InsufficientData(reason).into());
        }
        let media = [(header::CONTENT_TYPE, HeaderValue::from_static(target.media_type()))];
        let body = (media, target.write_report(&report));
        return Ok(answer_of_form(&headers, result.as_ref(), target.name(), body));
    }
    let form = sheet.as_ref().map_or_else(|| "json".to_owned(), |sheet| sheet.name.clone());
    if let Some(sheet) = sheet {
        let job_id = result.as_ref().and_then(|result| result.job_id);
        let windows = state.read(move |reader| filter_windows(reader, &capture, job_id)).await?;
        let compared = compare_report(&sheet, &report, windows);
        let compared = compared.map_err(|error| ApiError::bad_request(error.to_string()))?;
        report.datasheet = Some(serde_json::to_value(compared).map_err(JobError::from)?);
    }
    let document = SoFar { report: NoiseDocument::from(report), caught_up };
    Ok(answer_of_form(&headers, result.as_ref(), &form, axum::Json(document)))
}

/// Returns the filter windows of the first of a result's captures that has them.
fn filter_windows(reader: &Reader, name: &str, job: Option<i64>) -> Result<Option<FilterWindows>, StoreError> {
    let request = job.map(|id| reader.job(id)).transpose()?.map(|row| JobRequest::of_row(&row));
    let others = match &request {
        Some(Ok(JobRequest::Analysis(request))) => request.parameters().with.as_slice(),
        _ => &[],
    };
    for id in std::iter::once(reader.resolve(name)?).chain(others.iter().copied()) {
        let row = reader.capture(id)?;
        if let Some(windows) = row.configuration.filter_windows() {
            return Ok(Some(windows));
        }
    }
    Ok(None)
}

/// Returns the document of an analysis: of the requested job, or of the one with the requested parameters.
async fn document<T: Serialize + Send + 'static>(
    state: &ApiState,
    headers: &HeaderMap,
    request: AnalysisRequest,
    name: String,
    query: ResultQuery,
    live: impl FnOnce(&Reader, &ApiParts, i64) -> Result<T, JobError> + Send + 'static,
) -> Result<Response, ApiError> {
    if let Some(format) = query.format.as_deref().filter(|format| *format != "json") {
        let found: String = format.chars().take(40).collect();
        return Err(ApiError::bad_request(format!("`format` is `{found}`: allowed is json")));
    }
    match find(state, request, name, query.job).await? {
        Found::Open(id) => {
            let report = state.compute(move |reader, parts| live(reader, parts, id)).await?;
            Ok(([(header::CACHE_CONTROL, "no-store")], axum::Json(report)).into_response())
        }
        Found::Result(result) => Ok(answer(headers, result)),
        Found::Job(row) => unfinished(row),
    }
}

/// The source of a picture.
pub(super) enum Drawn {
    /// The analysis, and the unchanging result that it belongs to; none for a running capture.
    Documents(Box<Documents>, Option<i64>),
    /// The analysis is being worked on: the answer that states so.
    Later(Response),
}

/// Returns the document of a kind with the usual parameters; for a running capture, of the samples so far.
pub(super) async fn drawn(state: &ApiState, kind: JobKind, name: &str) -> Result<Drawn, ApiError> {
    Ok(match find(state, AnalysisRequest::usual(kind)?, name.to_owned(), None).await? {
        Found::Result(result) => {
            let id = result.id;
            let documents = state.read(move |_| Documents::read(kind, &result.body)).await?;
            Drawn::Documents(Box::new(documents), Some(id))
        }
        Found::Open(id) => {
            let so_far = move |reader: &Reader, parts: &ApiParts| parts.live.documents(reader, kind, id);
            Drawn::Documents(Box::new(state.compute(so_far).await?), None)
        }
        Found::Job(row) => Drawn::Later(unfinished(row)?),
    })
}

/// Finds the requested job, or the one of this request; a job that does not exist yet is queued.
async fn find(state: &ApiState, request: AnalysisRequest, name: String, job: Option<i64>) -> Result<Found, ApiError> {
    let (kind, params) = (request.kind(), request.text()?);
    let found = state.read(move |reader| find_stored(reader, kind, &params, &name, job)).await?;
    match found {
        Ok(found) => Ok(found),
        Err(id) => Ok(Found::Job(state.change(move |parts| parts.jobs.submit(id, request)).await?.0)),
    }
}

/// Finds the job as [`find`] does; `Err` is the id of a capture that has no such job.
fn find_stored(
    reader: &Reader,
    kind: JobKind,
    params: &str,
    name: &str,
    job: Option<i64>,
) -> Result<Result<Found, i64>, StoreError> {
    let id = reader.resolve(name)?;
    if let Some(job_id) = job {
        let row = reader.job(job_id)?;
        if row.capture != id || row.kind != kind {
            return Err(StoreError::NoSuchJob(job_id));
        }
        return with_result(reader, row).map(Ok);
    }
    let capture = reader.capture(id)?;
    if capture.state.is_open() {
        return Ok(Ok(Found::Open(id)));
    }
    let jobs = reader.jobs_over(id, kind, capture.samples)?;
    // This version may be able to do what another version of the program could not.
    let counts = |row: &JobRow| row.params == params && !(row.state == JobState::Failed && row.stale);
    let such_jobs: Vec<JobRow> = jobs.into_iter().filter(counts).collect();
    for state in [JobState::Done, JobState::Running, JobState::Queued, JobState::Failed] {
        if let Some(row) = such_jobs.iter().find(|row| row.state == state) {
            return with_result(reader, row.clone()).map(Ok);
        }
    }
    Ok(Err(id))
}

fn with_result(reader: &Reader, row: JobRow) -> Result<Found, StoreError> {
    let result = match row.result_id {
        Some(result_id) => reader.result(result_id)?,
        None => None,
    };
    Ok(result.map_or(Found::Job(row), Found::Result))
}

fn answer(headers: &HeaderMap, result: ResultRow) -> Response {
    let (tag, software) = (conditional::entity_tag(&result), result.software);
    let json = [(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))];
    with_stale(conditional::answer(headers, &tag, (json, result.body)), &software)
}

/// Returns a form of a finished result, with a tag derived from the result's, or of a running capture.
fn answer_of_form(headers: &HeaderMap, result: Option<&ResultRow>, form: &str, body: impl IntoResponse) -> Response {
    match result {
        Some(result) => {
            let tag = conditional::entity_tag_of_form(result, form);
            with_stale(conditional::answer(headers, &tag, body), &result.software)
        }
        None => ([(header::CACHE_CONTROL, "no-store")], body).into_response(),
    }
}

/// Names the program that made the result, if it is not this one.
pub(super) fn with_stale(mut response: Response, software: &str) -> Response {
    let stale = (software != SOFTWARE).then(|| HeaderValue::from_str(software).ok()).flatten();
    if let Some(software) = stale {
        response.headers_mut().insert(STALE, software);
    }
    response
}

/// Returns the job of a result that is not there: 202, or the reason why there will be no result.
pub(super) fn unfinished(row: JobRow) -> Result<Response, ApiError> {
    match row.state {
        JobState::Queued | JobState::Running | JobState::Done => Ok(jobs::answer(StatusCode::ACCEPTED, row)),
        JobState::Failed | JobState::Cancelled => {
            let why = row.error.unwrap_or_else(|| "it was cancelled".to_owned());
            Err(ApiError::new(ProblemType::AnalysisFailed, format!("job {} ended without a result: {why}", row.id)))
        }
    }
}
