//! Pages for people: the first page, a capture, a channel over time; and the script that makes them move.

use super::analysis::{self, Drawn};
use super::conditional;
use super::diagnoses::DiagnosisEntry;
use super::extract::{P, P2, Q};
use super::latest;
use super::problem::{ApiError, ProblemType};
use super::samples;
use super::state::ApiState;
use super::status::StatusBody;
use crate::gallery::{Documents, Facts, Picture};
use crate::jobs::{JobError, JobKind};
use crate::observe::Trace;
use crate::page::{self, CaptureView, DashboardView, Figure, Minute, SeriesView, Stored};
use crate::store::{JobRow, JobState, PageRequest, SOFTWARE, SampleRange};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use imu_core::units::format_duration;
use imu_files::export::paste::NoiseDocument;
use imu_noise::NoiseReport;
use serde::Deserialize;

/// Nothing from elsewhere, and no script but the daemon's own file.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; connect-src 'self'; \
                      img-src 'self' data:; form-action 'none'; base-uri 'none'; frame-ancestors 'none'";

/// Which part of the first page is wanted.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DashboardQuery {
    /// `live`: only what changes.
    part: Option<String>,
}

/// Which part of a channel is wanted.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SeriesQuery {
    from: Option<String>,
    to: Option<String>,
}

/// A page's answer.
pub(super) fn html(page: String) -> Response {
    let headers = [(header::CONTENT_SECURITY_POLICY, POLICY), (header::CACHE_CONTROL, "no-store")];
    (headers, Html(page)).into_response()
}

/// The script of all pages.
pub(super) async fn script(headers: HeaderMap) -> Response {
    let media = [(header::CONTENT_TYPE, HeaderValue::from_static("text/javascript; charset=utf-8"))];
    conditional::answer(&headers, &format!("\"{}\"", conditional::plain(SOFTWARE)), (media, page::SCRIPT))
}

/// The first page, or the part of it that changes.
pub(super) async fn dashboard(
    State(state): State<ApiState>,
    Q(query): Q<DashboardQuery>,
) -> Result<Response, ApiError> {
    let status = serde_json::to_string(&StatusBody::of(&state)).map_err(JobError::from)?;
    let traces = state.parts.recent.traces(state.parts.clock.mono_ns());
    let minute: Vec<Minute<'_>> = traces.iter().map(minute_of).collect();
    let rows = latest::rows(&state).await;
    let stored = rows.as_deref().map(|rows| Stored {
        captures: &rows.captures,
        jobs: &rows.jobs,
        diagnoses: &rows.diagnoses,
        causes: &rows.causes,
    });
    let duration = format_duration(state.parts.default_duration);
    let token = state.parts.token.is_some();
    let view = DashboardView { status: &status, minute: &minute, stored, duration: &duration, token };
    let page = match query.part.as_deref() {
        None => page::dashboard(&view),
        Some("live") => page::live(&view),
        Some(other) => {
            let found: String = other.chars().take(40).collect();
            return Err(ApiError::bad_request(format!("`part` is `{found}`: allowed is live")));
        }
    };
    Ok(html(page.map_err(JobError::from)?))
}

fn minute_of(trace: &Trace) -> Minute<'_> {
    Minute { channel: (trace.channel.name(), trace.channel.unit()), points: trace.points.clone(), last: trace.last }
}

/// A capture: what it got, the numbers, the pictures.
pub(super) async fn capture(State(state): State<ApiState>, P(name): P) -> Result<Response, ApiError> {
    let (facts, diagnoses, jobs) = state
        .read(move |reader| {
            let id = reader.resolve(&name)?;
            let all = PageRequest::first();
            Ok((
                Facts::read(reader, id)?,
                reader.diagnoses(Some(id), &all)?.rows,
                reader.jobs(Some(id), None, &all)?.rows,
            ))
        })
        .await?;
    let id = facts.row.id.to_string();
    let open = facts.row.state.is_open();
    let mut remarks = Vec::new();
    let mut waits = false;
    let mut document = async |kind: JobKind| match analysis::drawn(&state, kind, &id).await {
        Ok(Drawn::Document(document, _)) => Some(document),
        Ok(Drawn::Later(_)) => {
            waits = true;
            remarks.push(under_way(kind, &jobs));
            None
        }
        Err(error) if error.kind() == ProblemType::AnalysisFailed => {
            remarks.push(format!("There is no {}: {error}.", kind.gives()));
            None
        }
        // Too much is asked at once, or the disk is slow: it is asked again.
        Err(error) => {
            waits = true;
            remarks.push(format!("The {} is not at hand now: {error}.", kind.gives()));
            None
        }
    };
    let statistics = document(JobKind::Statistics).await;
    let noise = document(JobKind::Noise).await;
    let allan = document(JobKind::Allan).await;
    let report = noise.as_deref().map(serde_json::from_str::<NoiseReport>).transpose().map_err(JobError::from)?;
    let report = report.map(|report| NoiseDocument::from(facts.compared(report)));
    let noise = report.as_ref().map(serde_json::to_string).transpose().map_err(JobError::from)?;
    let documents = Documents { statistics, allan, noise };
    let pictures = facts.pictures(&documents, report.as_ref().map(|of| &of.report));
    let figures = pictures.into_iter().map(|picture| (picture.name(), linked(&id, picture))).collect();
    let diagnoses: Vec<DiagnosisEntry> = diagnoses.into_iter().map(DiagnosisEntry::from).collect();
    let diagnoses = serde_json::to_string(&diagnoses).map_err(JobError::from)?;
    if open {
        remarks.push("It still runs: this is what there is so far.".to_owned());
    }
    let page = page::capture(&CaptureView {
        capture: &facts.capture,
        statistics: documents.statistics.as_deref(),
        noise: documents.noise.as_deref(),
        remarks: &remarks,
        waits,
        gaps: &facts.gaps,
        causes: &facts.causes,
        events: &facts.events,
        diagnoses: &diagnoses,
        figures: &figures,
        served: Some(state.parts.token.is_some()),
        enclosed: &[],
    });
    Ok(html(page.map_err(JobError::from)?))
}

fn linked(id: &str, picture: Picture) -> Figure {
    let address = format!("/v1/captures/{id}/plots/{}.svg", picture.name());
    Figure::Linked { told: picture.told(), address, height: picture.height() }
}

/// How far a job is.
fn under_way(kind: JobKind, jobs: &[JobRow]) -> String {
    let running = jobs.iter().find(|job| job.kind == kind.name() && job.state == JobState::Running);
    match running {
        Some(job) => format!("The {} is being computed: {:.0} %.", kind.gives(), 100.0 * job.progress),
        None => format!("The {} waits for its turn.", kind.gives()),
    }
}

/// A channel over time.
pub(super) async fn series(
    State(state): State<ApiState>,
    P2(name, channel): P2,
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
            // `to` is the first instant that is not wanted: a period after the last sample.
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
