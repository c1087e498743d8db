//! Plots of a capture as SVG or PNG.

use super::analysis::{self, Drawn};
use super::conditional;
use super::extract::{P, Q};
use super::problem::{ApiError, Problem, ProblemType};
use super::samples;
use super::state::ApiState;
use crate::gallery::{self, Form, Picture, Window};
use crate::jobs::{Documents, JobError, JobKind, Place};
use crate::store::{CaptureRow, Reader, SOFTWARE};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};

/// The wanted part.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PlotQuery {
    /// For a time series: from this time on, RFC 3339 or seconds since the first sample.
    from: Option<String>,
    /// For a time series: before this time.
    to: Option<String>,
    /// For `allan-<channel>`: the curve of this capture (id, name, or `latest`) in the same picture.
    beside: Option<String>,
}

/// A picture: `timeseries-<channel>`, `histogram-<channel>`, `allan-<triad>`, `allan-<channel>`, `hourly-<channel>`,
/// `psd-<triad>`, `gaps`; `.svg`, or `.png` for slides. For a running capture it shows the samples so far.
#[utoipa::path(get, path = "/v1/captures/{id}/plots/{name}", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"),
           ("name" = String, Path, description = "Such as `allan-gyro.svg`", example = "allan-gyro.svg"), PlotQuery), responses(
    (status = 200, body = String, content_type = "image/svg+xml", headers(("ETag" = String, description = "Of a finished capture"))),
    (status = 202, description = "The analysis that it is drawn of is not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the picture"),
    (status = 404, body = Problem, content_type = "application/problem+json", description = "There is no such capture, picture or channel"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "There is not enough data"),
    (status = 429, body = Problem, content_type = "application/problem+json", description = "Too many large queries at once")))]
pub(super) async fn plot(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P((capture, file)): P<(String, String)>,
    Q(query): Q<PlotQuery>,
) -> Result<Response, ApiError> {
    let (stem, form) = file.rsplit_once('.').unwrap_or((file.as_str(), ""));
    let picture = Form::from_suffix(form).zip(Picture::from_name(stem)).ok_or_else(|| {
        let found: String = file.chars().take(60).collect();
        ApiError::new(
            ProblemType::NotFound,
            format!("there is no plot `{found}`: there are {}, each with .svg or .png", Picture::forms()),
        )
    });
    let (form, picture) = picture?;
    let window = Window {
        from: query.from.as_deref().map(samples::time).transpose()?,
        to: query.to.as_deref().map(samples::time).transpose()?,
    };
    if window != Window::default() && !matches!(picture, Picture::Timeseries(_)) {
        return Err(ApiError::bad_request(format!("`from` and `to` are for timeseries-<channel>, not for {stem}")));
    }
    let channel = match (picture, &query.beside) {
        (Picture::AllanOfOne(channel), Some(_)) => Some(channel),
        (_, None) => None,
        _ => return Err(ApiError::bad_request(format!("`beside` is for allan-<channel>, not for {stem}"))),
    };
    let names = std::iter::once(capture).chain(query.beside);
    let (needs, names): (&[JobKind], Vec<String>) =
        (if channel.is_some() { &[JobKind::Allan] } else { picture.needs() }, names.collect());
    let read = move |reader: &Reader| names.iter().map(|name| reader.capture(reader.resolve(name)?)).collect();
    let rows: Vec<CaptureRow> = state.read(read).await?;
    let open = rows.iter().any(|row| row.state.is_open());
    let _permit = state.drawing_permit().await?;
    let mut drawn = Vec::new();
    for row in rows {
        match of_capture(&state, picture, needs, &row).await? {
            Ok((documents, results)) => drawn.push((row, documents, results)),
            Err(later) => return Ok(later),
        }
    }
    let tag = tag(&file, window, &drawn);
    if !open && conditional::is_known(&headers, &tag) {
        return Ok(conditional::answer(&headers, &tag, ()));
    }
    let image = state
        .compute(move |reader, parts| {
            let is_apart = parts.jobs.place() == Place::Apart;
            let file = match (channel, drawn.as_slice()) {
                (Some(channel), [(a, of_a, _), (b, of_b, _)]) => {
                    gallery::beside(channel, [(&a.name, of_a), (&b.name, of_b)], form, is_apart)?
                }
                (_, [(row, documents, _), ..]) => {
                    gallery::file(reader, &row.id.to_string(), (picture, window), documents, form, is_apart)?
                }
                _ => None,
            };
            let reason = || format!("there is not enough data for {}", picture.name());
            file.ok_or_else(|| JobError::InsufficientData(reason()))
        })
        .await?;
    Ok(answer(&headers, &tag, open, form, image))
}

/// A capture, what a picture of it is drawn of, and the results that this belongs to.
type Of = (CaptureRow, Documents, Vec<Option<i64>>);

/// Returns what a picture of a capture is drawn of, or the answer that it is not done yet.
async fn of_capture(
    state: &ApiState,
    picture: Picture,
    needs: &[JobKind],
    row: &CaptureRow,
) -> Result<Result<(Documents, Vec<Option<i64>>), Response>, ApiError> {
    if let Some(lacking) = picture.channels().into_iter().find(|channel| !row.channels.contains(channel)) {
        let message = format!("the capture {} has no channel {}", row.name, lacking.name());
        return Err(ApiError::new(ProblemType::NotFound, message));
    }
    let (id, mut documents, mut results) = (row.id.to_string(), Documents::default(), Vec::new());
    for kind in needs {
        match analysis::drawn(state, *kind, &id).await {
            Ok(Drawn::Documents(found, result)) => {
                documents.extend(*found);
                results.push(result);
            }
            Ok(Drawn::Later(answer)) => return Ok(Err(answer)),
            // Lines that can never exist are left out; lines that may exist in a moment are not.
            Err(error) if *kind == JobKind::Noise && error.kind() == ProblemType::AnalysisFailed => results.push(None),
            Err(error) => return Err(error),
        }
    }
    Ok(Ok((documents, results)))
}

/// Returns the tag of a picture. An analysis may be repeated; its picture is then a different one.
fn tag(file: &str, window: Window, drawn: &[Of]) -> String {
    let ids: Vec<String> = drawn.iter().map(|(row, ..)| row.id.to_string()).collect();
    // Another database may have captures with the same ids and as many samples.
    let begun = |row: &CaptureRow| format!("{} {}", row.started_at.map_or(0, |at| at.0), row.samples);
    let mut rows: Vec<String> = drawn.iter().map(|(row, ..)| begun(row)).collect();
    if drawn.len() > 1 {
        // A picture of two has their names.
        let mut hasher = DefaultHasher::new();
        drawn.iter().for_each(|(row, ..)| row.name.hash(&mut hasher));
        rows.push(hasher.finish().to_string());
    }
    let results: Vec<Option<i64>> = drawn.iter().flat_map(|(.., results)| results.iter().copied()).collect();
    format!(
        "W/\"{}-{}-{}-{}-{}\"",
        ids.join("+"),
        conditional::plain(file),
        conditional::plain(&rows.join(" ")),
        conditional::plain(&format!("{:?} {results:?}", (window.from, window.to))),
        conditional::plain(SOFTWARE)
    )
}

/// Returns the answer with a picture; that of a running capture is not kept.
fn answer(headers: &HeaderMap, tag: &str, open: bool, form: Form, image: Vec<u8>) -> Response {
    let image = (
        [
            (header::CONTENT_TYPE, HeaderValue::from_static(form.media_type())),
            (
                header::CONTENT_SECURITY_POLICY,
                HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'"),
            ),
        ],
        image,
    );
    match open {
        true => ([(header::CACHE_CONTROL, "no-store")], image).into_response(),
        false => conditional::answer(headers, tag, image),
    }
}
