//! The routes, one per line, the layers around them, and the document that describes them.

use super::held;
use super::layers;
use super::state::{ApiParts, ApiState};
use super::stream::Streamed;
use super::{
    analysis, captures, comparison, diagnoses, health, imports, jobs, lists, models, openapi, pages, plots, samples,
    status,
};
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, Version, header};
use axum::{Router, middleware};
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{Predicate, SizeAbove};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Answers smaller than this are not worth compressing.
const COMPRESS_BYTES: u64 = 1024;

/// Returns all documented routes.
fn documented() -> OpenApiRouter<ApiState> {
    OpenApiRouter::with_openapi(openapi::head())
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
        .routes(routes!(status::status))
        .routes(routes!(status::events))
        .routes(routes!(captures::list, captures::start))
        .routes(routes!(captures::show, captures::change, captures::delete))
        .routes(routes!(captures::stop))
        .routes(routes!(captures::pin))
        .routes(routes!(captures::gaps))
        .routes(routes!(captures::segments))
        .routes(routes!(captures::events))
        .routes(routes!(samples::samples))
        .routes(routes!(imports::import))
        .routes(routes!(analysis::statistics))
        .routes(routes!(analysis::allan))
        .routes(routes!(analysis::noise))
        .routes(routes!(plots::plot))
        .routes(routes!(jobs::list, jobs::submit))
        .routes(routes!(jobs::show, jobs::cancel))
        .routes(routes!(models::list, models::keep))
        .routes(routes!(models::show, models::delete))
        .routes(routes!(models::cost))
        .routes(routes!(diagnoses::submit))
        .routes(routes!(diagnoses::list))
        .routes(routes!(diagnoses::show))
        .routes(routes!(diagnoses::model))
}

/// Returns the whole document as text, as in docs/openapi.json.
pub fn document() -> String {
    openapi::text(&documented().into_openapi())
}

/// Returns the whole interface as a service.
pub fn router(parts: ApiParts) -> Router {
    let state = ApiState::new(parts);
    let (routes, document) = documented().split_for_parts();
    let compress =
        CompressionLayer::new().gzip(true).compress_when(SizeAbove::new(COMPRESS_BYTES).and(worth_compressing));
    // The last layer is the outermost.
    routes
        .route("/", axum::routing::get(pages::dashboard))
        .route("/captures", axum::routing::get(lists::captures))
        .route("/diagnoses", axum::routing::get(lists::diagnoses))
        .route("/jobs", axum::routing::get(lists::jobs))
        .route("/models", axum::routing::get(lists::models))
        .route("/captures/{id}", axum::routing::get(pages::capture))
        .route("/compare", axum::routing::get(comparison::comparison))
        .route("/captures/{id}/series/{channel}", axum::routing::get(pages::series))
        .route("/diagnoses/{id}", axum::routing::get(diagnoses::page))
        .layer(compress)
        .layer(middleware::from_fn_with_state(state.clone(), held::answer))
        // What all share takes no memory of each, and is not compressed for each.
        .merge(openapi::route(&document))
        .route(crate::page::SCRIPT_PATH, axum::routing::get(pages::script))
        .fallback(nothing_here)
        .layer(middleware::from_fn_with_state(state.clone(), layers::limit_time))
        .layer(middleware::from_fn(layers::slow_refusals))
        .layer(middleware::from_fn_with_state(state.clone(), layers::authorize))
        .layer(middleware::from_fn_with_state(state.clone(), layers::check_host))
        .layer(middleware::from_fn_with_state(state.clone(), layers::observe))
        .with_state(state)
}

fn worth_compressing(_: StatusCode, _: Version, headers: &HeaderMap, extensions: &axum::http::Extensions) -> bool {
    let media_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    extensions.get::<Streamed>().is_none()
        && (media_type.contains("json") || media_type.contains("svg") || media_type.starts_with("text/"))
}

async fn nothing_here(_: Request) -> StatusCode {
    StatusCode::NOT_FOUND
}
