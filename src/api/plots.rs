//! Plots of a capture as SVG or PNG.

use super::analysis::{self, Drawn};
use super::conditional;
use super::extract::{P2, Q};
use super::problem::{ApiError, Problem, ProblemType};
use super::samples;
use super::state::ApiState;
use crate::gallery::{self, Documents, GalleryError, Needs, Picture, Window};
use crate::jobs::{JobError, JobKind, Place};
use crate::plot;
use crate::store::SOFTWARE;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

/// Which part is wanted.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PlotQuery {
    /// Of a time series: from this time on, RFC 3339 or seconds since the first sample.
    from: Option<String>,
    /// Of a time series: before this time.
    to: Option<String>,
}

/// A picture: `timeseries-<channel>`, `histogram-<channel>`, `allan-<triad>`, `allan-<channel>`, `hourly-<channel>`,
/// `psd-<triad>`, `gaps`; `.svg`, or `.png` for slides. Of a capture that runs it is of what there is so far.
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
    P2(capture, file): P2,
    Q(query): Q<PlotQuery>,
) -> Result<Response, ApiError> {
    let (stem, form) = file.rsplit_once('.').unwrap_or((file.as_str(), ""));
    let form = [Form::Svg, Form::Png].into_iter().find(|known| known.suffix() == form);
    let picture = form.zip(Picture::from_name(stem)).ok_or_else(|| {
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
    let name = capture.clone();
    let row = state.read(move |reader| reader.capture(reader.resolve(&name)?)).await?;
    let open = row.state.is_open();
    if let Some(lacking) = picture.channels().into_iter().find(|channel| !row.channels.contains(channel)) {
        let message = format!("the capture has no channel {}", lacking.name());
        return Err(ApiError::new(ProblemType::NotFound, message));
    }
    let id = row.id.to_string();
    let (documents, results) = match material(&state, picture.needs(), &id).await? {
        Material::There(documents, results) => (documents, results),
        Material::Later(answer) => return Ok(answer),
    };
    // An analysis may be done again: what is drawn of it is another picture then.
    let tag = format!(
        "\"{id}-{}-{}-{}-{}\"",
        conditional::plain(&file),
        // Another database has captures of the same ids and as many samples.
        conditional::plain(&format!("{} {}", row.started_at.map_or(0, |at| at.0), row.samples)),
        conditional::plain(&format!("{:?} {results:?}", (window.from, window.to))),
        conditional::plain(SOFTWARE)
    );
    if !open && conditional::is_known(&headers, &tag) {
        return Ok(conditional::answer(&headers, &tag, ()));
    }
    let image = state
        .compute(move |reader, parts| {
            let svg = gallery::svg(reader, &id, picture, window, &documents).map_err(|error| match error {
                GalleryError::Store(error) => JobError::from(error),
                GalleryError::Document(error) => JobError::from(error),
            })?;
            if svg.is_empty() {
                let reason = format!("there is not enough data for {}", picture.name());
                return Err(JobError::InsufficientData { reason });
            }
            match form {
                Form::Svg => Ok(plot::alone(&svg).into_bytes()),
                Form::Png if parts.jobs.place() == Place::Apart => {
                    gallery::apart::png(&svg).map_err(|reason| JobError::Died { reason })
                }
                Form::Png => plot::raster::png(&svg, plot::raster::SCALE)
                    .map_err(|error| JobError::InsufficientData { reason: error.to_string() }),
            }
        })
        .await?;
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
    Ok(match open {
        true => ([(header::CACHE_CONTROL, "no-store")], image).into_response(),
        false => conditional::answer(&headers, &tag, image),
    })
}

/// What a picture is drawn of.
enum Material {
    /// Documents, and the results that they are of.
    There(Documents, Vec<Option<i64>>),
    /// One is being worked on: the answer that says so.
    Later(Response),
}

async fn material(state: &ApiState, needs: Needs, id: &str) -> Result<Material, ApiError> {
    let mut documents = Documents::default();
    let mut results = Vec::new();
    let wanted = [
        (needs.statistics, JobKind::Statistics, &mut documents.statistics),
        (needs.allan, JobKind::Allan, &mut documents.allan),
        (needs.noise, JobKind::Noise, &mut documents.noise),
    ];
    for (_, kind, document) in wanted.into_iter().filter(|(wanted, ..)| *wanted) {
        match analysis::drawn(state, kind, id).await {
            Ok(Drawn::Document(text, result)) => {
                *document = Some(text);
                results.push(result);
            }
            Ok(Drawn::Later(answer)) => return Ok(Material::Later(answer)),
            // Lines that there will never be are left out; those that there may be in a moment are not.
            Err(error) if kind == JobKind::Noise && error.kind() == ProblemType::AnalysisFailed => results.push(None),
            Err(error) => return Err(error),
        }
    }
    Ok(Material::There(documents, results))
}

/// What a picture is sent as.
#[derive(Debug, Clone, Copy)]
enum Form {
    Svg,
    Png,
}

impl Form {
    fn suffix(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Png => "png",
        }
    }
    fn media_type(self) -> &'static str {
        match self {
            Self::Svg => "image/svg+xml",
            Self::Png => "image/png",
        }
    }
}
