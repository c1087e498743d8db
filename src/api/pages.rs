//! Pages for people: the first page, a capture, a channel over time; and the script that updates them.

use super::analysis::{self, Drawn};
use super::conditional;
use super::extract::{P, Q};
use super::html::{html, html_with_form};
use super::latest;
use super::problem::{ApiError, ProblemType};
use super::samples;
use super::state::ApiState;
use crate::gallery::{self, Picture};
use crate::jobs::{Documents, JobKind};
use crate::page::{self, CaptureView, DashboardView, Figure, SeriesView, Served};
use crate::store::{CaptureRow, JobRow, JobState, PageRequest, Reader, SOFTWARE, SampleRange, StoreError};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use imu_core::units::format_duration;
use serde::Deserialize;

/// The wanted part of the first page.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DashboardQuery {
    /// `live`: only the changing part.
    part: Option<String>,
}

/// The wanted part of a channel.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SeriesQuery {
    from: Option<String>,
    to: Option<String>,
}

/// Returns the script of all pages.
pub(super) async fn script(headers: HeaderMap) -> Response {
    let media = [(header::CONTENT_TYPE, HeaderValue::from_static("text/javascript; charset=utf-8"))];
    conditional::answer(&headers, &format!("\"{}\"", conditional::plain(SOFTWARE)), (media, page::SCRIPT))
}

/// Returns the first page, or the part of it that changes.
pub(super) async fn dashboard(
    State(state): State<ApiState>,
    Q(query): Q<DashboardQuery>,
) -> Result<Response, ApiError> {
    let rows = latest::rows(&state).await;
    let view = DashboardView {
        status: &state.status(),
        uptime_s: state.started.elapsed().as_secs_f64(),
        minute: &state.parts.recent.traces(state.parts.clock.mono_ns()),
        stored: rows.as_deref(),
        duration: &format_duration(state.parts.default_duration),
        token: state.parts.token.is_some(),
    };
    let page = match query.part.as_deref() {
        None => page::dashboard(&view),
        Some("live") => page::live(&view),
        Some(other) => {
            let found: String = other.chars().take(40).collect();
            return Err(ApiError::bad_request(format!("`part` is `{found}`: allowed is live")));
        }
    };
    Ok(html(page))
}

/// Returns a capture's page: its data, the numbers, the pictures.
pub(super) async fn capture(State(state): State<ApiState>, P(name): P) -> Result<Response, ApiError> {
    let _permit = state.drawing_permit().await?;
    let (facts, diagnoses, jobs, models, captures) = state
        .read(move |reader| {
            let id = reader.resolve(&name)?;
            let all = PageRequest::first();
            Ok((
                gallery::facts(reader, id)?,
                reader.diagnoses(Some(id), &all)?.rows,
                jobs_of(reader, id)?,
                reader.models(&all)?.rows,
                ended(reader, Some(id))?,
            ))
        })
        .await?;
    let Analyses { documents, mut remarks, waits } = analyses(&state, facts.row.id, &jobs).await;
    remarks.extend(facts.remark());
    let (id, pictures) = (facts.row.id.to_string(), gallery::pictures(&facts, &documents).into_iter());
    Ok(html_with_form(page::capture(&CaptureView {
        facts: &facts,
        is_kept: true,
        documents: &documents,
        remarks: &remarks,
        waits,
        diagnoses: &diagnoses,
        figures: &pictures.map(|picture| (picture.name(), linked(&id, picture))).collect(),
        served: Some(Served { token: state.parts.token.is_some(), models: &models, captures: &captures }),
        enclosed: &[],
    })))
}

/// Returns the captures that have ended and have samples, the latest hundred, without `but`.
pub(super) fn ended(reader: &Reader, but: Option<i64>) -> Result<Vec<CaptureRow>, StoreError> {
    let mut rows = reader.captures(None, &PageRequest::first())?.rows;
    rows.retain(|of| Some(of.id) != but && !of.state.is_open() && of.samples > 0);
    Ok(rows)
}

/// Returns the latest jobs over a capture.
pub(super) fn jobs_of(reader: &Reader, id: i64) -> Result<Vec<JobRow>, StoreError> {
    Ok(reader.jobs(Some(id), None, &PageRequest::first())?.rows)
}

/// The analyses of a capture that a page shows.
#[derive(Debug, Default)]
pub(super) struct Analyses {
    /// Those that are there.
    pub(super) documents: Documents,
    /// What is missing, and why: sentences.
    pub(super) remarks: Vec<String>,
    /// Whether something that is missing will be there.
    pub(super) waits: bool,
}

/// Returns the analyses of a capture; one that does not exist yet is queued. `jobs` are those over the capture.
pub(super) async fn analyses(state: &ApiState, id: i64, jobs: &[JobRow]) -> Analyses {
    let (id, mut all) = (id.to_string(), Analyses::default());
    for kind in [JobKind::Statistics, JobKind::Noise, JobKind::Allan] {
        match analysis::drawn(state, kind, &id).await {
            Ok(Drawn::Documents(found, _)) => all.documents.extend(*found),
            Ok(Drawn::Later(_)) => {
                all.waits = true;
                all.remarks.push(under_way(kind, jobs));
            }
            Err(error) if error.kind() == ProblemType::AnalysisFailed => {
                all.remarks.push(format!("There is no {}: {error}.", kind.gives()));
            }
            // Too many requests at once, or a slow disk: the page asks again. A result that cannot be read stays
            // unreadable.
            Err(error) => {
                all.waits |= error.kind() != ProblemType::Internal;
                all.remarks.push(format!("The {} is not at hand now: {error}.", kind.gives()));
            }
        }
    }
    all
}

pub(super) fn linked(id: &str, picture: Picture) -> Figure {
    let address = format!("/v1/captures/{id}/plots/{}.svg", picture.name());
    Figure::Linked { alt: picture.description(), address, height: picture.height() }
}

/// Returns the progress of a job.
fn under_way(kind: JobKind, jobs: &[JobRow]) -> String {
    let running = jobs.iter().find(|job| job.kind == kind && job.state == JobState::Running);
    match running {
        Some(job) => format!("The {} is being computed: {:.0} %.", kind.gives(), 100.0 * job.progress),
        None => format!("The {} waits for its turn.", kind.gives()),
    }
}

/// Returns a channel's page over time.
pub(super) async fn series(
    State(state): State<ApiState>,
    P((name, channel)): P<(String, String)>,
    Q(query): Q<SeriesQuery>,
) -> Result<Response, ApiError> {
    let [from, to] = [query.from, query.to].map(|text| text.as_deref().map(samples::time).transpose());
    let (from, to) = (from?, to?);
    let (row, there, ends) = state
        .read(move |reader| {
            let mut whole = SampleRange::read(reader, &name, None, None)?;
            let [_, length_s] = whole.ends_s(reader)?;
            let mut part = SampleRange::read(reader, &name, from, to)?;
            let [from_s, to_s] = part.ends_s(reader)?;
            // `to` is the first excluded instant: a period after the last sample.
            let period_s = whole.capture.rate_hz.filter(|rate_hz| *rate_hz > 0.0).map_or(0.0, f64::recip);
            let there = part.samples() > 0;
            Ok((whole.capture, there, (length_s + period_s, [from_s, to_s + period_s])))
        })
        .await?;
    let others: Vec<&str> = row.channels.iter().map(|other| other.name()).filter(|other| *other != channel).collect();
    let Some(own) = row.channels.iter().find(|own| own.name() == channel) else {
        let found: String = channel.chars().take(40).collect();
        let message = format!("the capture has no channel `{found}`: it has {}", others.join(", "));
        return Err(ApiError::new(ProblemType::NotFound, message));
    };
    if !there {
        return Err(ApiError::new(ProblemType::NotFound, "the capture has no samples in that time"));
    }
    let (length_s, [from_s, to_s]) = ends;
    let view =
        SeriesView { capture: (row.id, &row.name), channel: own.name(), others: &others, length_s, from_s, to_s };
    Ok(html(page::series(&view)))
}
