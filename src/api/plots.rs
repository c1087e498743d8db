//! Plots of a capture as SVG.

use super::analysis::{self, Drawn};
use super::conditional;
use super::extract::P2;
use super::problem::{ApiError, Problem, ProblemType};
use super::state::ApiState;
use crate::gallery::{self, Picture};
use crate::jobs::{JobError, JobKind};
use crate::plot;
use crate::store::SOFTWARE;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};

/// A picture: `timeseries-<channel>`, `histogram-<channel>`, `allan-<triad>`, `allan-<channel>`, `psd-<triad>`, `gaps`. Of a
/// capture that runs it is of what there is so far.
#[utoipa::path(get, path = "/v1/captures/{id}/plots/{name}", tag = "analysis",
    params(("id" = String, Path, description = "Id, name, or `latest`"),
           ("name" = String, Path, description = "Such as `allan-gyro.svg`", example = "allan-gyro.svg")), responses(
    (status = 200, body = String, content_type = "image/svg+xml", headers(("ETag" = String, description = "Of a finished capture"))),
    (status = 202, description = "The analysis that it is drawn of is not done yet", headers(
        ("Location" = String, description = "The job"), ("Retry-After" = u32, description = "When to ask again, s"))),
    (status = 304, description = "`If-None-Match` names the picture"),
    (status = 404, body = Problem, content_type = "application/problem+json", description = "There is no such capture, picture or channel"),
    (status = 422, body = Problem, content_type = "application/problem+json", description = "There is not enough data"),
    (status = 503, body = Problem, content_type = "application/problem+json", description = "Too many large queries at once")))]
pub(super) async fn plot(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P2(capture, file): P2,
) -> Result<Response, ApiError> {
    let picture = file.strip_suffix(".svg").and_then(Picture::from_name).ok_or_else(|| {
        let found: String = file.chars().take(60).collect();
        ApiError::new(ProblemType::NotFound, format!("there is no plot `{found}`: there are {}", Picture::forms()))
    })?;
    let name = capture.clone();
    let row = state.read(move |reader| reader.capture(reader.resolve(&name)?)).await?;
    let open = row.state.is_open();
    let tag = format!("\"{}-{}-{}-{}\"", row.id, picture.name(), row.samples, conditional::plain(SOFTWARE));
    if !open && conditional::is_known(&headers, &tag) {
        return Ok(conditional::answer(&headers, &tag, ()));
    }
    if let Some(lacking) = picture.channels().into_iter().find(|channel| !row.channels.contains(channel)) {
        let message = format!("the capture has no channel {}", lacking.name());
        return Err(ApiError::new(ProblemType::NotFound, message));
    }
    let id = row.id.to_string();
    let svg = match picture {
        Picture::Histogram(channel) => match analysis::drawn(&state, JobKind::Statistics, &id).await? {
            Drawn::Document(statistics) => gallery::from_statistics(channel, &statistics).map_err(JobError::from)?,
            Drawn::Later(answer) => return Ok(answer),
        },
        Picture::Allan(_) | Picture::AllanOfOne(_) => match analysis::drawn(&state, JobKind::Allan, &id).await? {
            Drawn::Document(allan) => {
                let noise = match analysis::drawn(&state, JobKind::Noise, &id).await {
                    Ok(Drawn::Document(noise)) => Some(noise),
                    Ok(Drawn::Later(answer)) => return Ok(answer),
                    // Lines that there will never be are left out.
                    Err(_) => None,
                };
                gallery::from_allan(picture, &allan, noise.as_deref()).map_err(JobError::from)?
            }
            Drawn::Later(answer) => return Ok(answer),
        },
        Picture::Timeseries(_) | Picture::Psd(_) | Picture::Gaps => {
            let svg = state.read_heavy(move |reader, _| Ok(gallery::from_samples(reader, &id, picture)?)).await?;
            svg.unwrap_or_default()
        }
    };
    if svg.is_empty() {
        let message = format!("there is not enough data for {}", picture.name());
        return Err(ApiError::new(ProblemType::AnalysisFailed, message));
    }
    let image = (
        [
            (header::CONTENT_TYPE, HeaderValue::from_static("image/svg+xml")),
            (
                header::CONTENT_SECURITY_POLICY,
                HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'"),
            ),
        ],
        plot::alone(&svg),
    );
    Ok(match open {
        true => ([(header::CACHE_CONTROL, "no-store")], image).into_response(),
        false => conditional::answer(&headers, &tag, image),
    })
}
