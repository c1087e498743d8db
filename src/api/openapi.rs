//! The interface's own description: OpenAPI 3.1, made from the handlers and types, served and kept in
//! docs/openapi.json.

use super::state::ApiState;
use axum::Router;
use axum::http::header;
use axum::routing::get;
use utoipa::OpenApi;
use utoipa::openapi::OpenApi as Document;

/// The document without its paths.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "vn100d",
        description = "Unattended capture of a VectorNav VN-100 into SQLite, Allan deviation and noise parameters. \
                       Errors are RFC 9457 problem documents; times are RFC 3339 in UTC; units are in names or beside \
                       the values; no number is NaN.",
    ),
    tags(
        (name = "daemon", description = "What the program is doing"),
        (name = "captures", description = "Recordings and their accounting; `{id}` is an id, a name, or `latest`"),
        (name = "analysis", description = "Statistics, Allan deviation, noise parameters"),
        (name = "jobs", description = "Background work"),
        (name = "diagnoses", description = "Sensor models, and where captures and simulators differ"),
    ),
    components(schemas(super::problem::Problem)),
)]
struct Head;

pub(super) fn head() -> Document {
    Head::openapi()
}

/// Writes a document as text, with the answers that every operation may give.
pub(super) fn text(document: &Document) -> String {
    let mut document = document.clone();
    for (path, item) in &mut document.paths.paths {
        for operation in [&mut item.get, &mut item.post, &mut item.patch, &mut item.delete].into_iter().flatten() {
            let responses = &mut operation.responses.responses;
            responses.insert("default".to_owned(), problem("Any other error: docs/api.md, Problems").into());
            if path.contains("{id}") {
                responses.entry("404".to_owned()).or_insert_with(|| problem("").into());
            }
        }
    }
    let mut text = document.to_pretty_json().unwrap_or_default();
    text.push('\n');
    text
}

/// Returns the answer that every operation may give besides its own.
fn problem(description: &str) -> utoipa::openapi::Response {
    let schema = utoipa::openapi::Ref::from_schema_name("Problem");
    utoipa::openapi::ResponseBuilder::new()
        .description(description)
        .content(super::PROBLEM_JSON, utoipa::openapi::Content::new(Some(schema)))
        .build()
}

/// Returns the route `GET /openapi.json`.
pub(super) fn route(document: &Document) -> Router<ApiState> {
    let text = axum::body::Bytes::from(text(document));
    Router::new().route(
        "/openapi.json",
        get(move || {
            let text = text.clone();
            async move { ([(header::CONTENT_TYPE, "application/json")], text) }
        }),
    )
}

#[cfg(test)]
mod tests {
    use super::super::document;

    /// Renew with `VN100D_BLESS=1 cargo test -p vn100d --lib openapi`.
    #[test]
    fn the_kept_document_is_the_one_served() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/openapi.json");
        if std::env::var_os("VN100D_BLESS").is_some() {
            std::fs::write(path, document()).unwrap();
        }
        let kept = std::fs::read_to_string(path).unwrap_or_default();
        assert!(
            kept == document(),
            "docs/openapi.json is not current: VN100D_BLESS=1 cargo test -p vn100d --lib openapi renews it"
        );
    }

    #[test]
    fn the_document_is_openapi_3_1_and_every_operation_describes_itself() {
        let document: serde_json::Value = serde_json::from_str(&document()).unwrap();
        assert!(document["openapi"].as_str().unwrap().starts_with("3.1"));
        let paths = document["paths"].as_object().unwrap();
        assert!(paths.len() >= 15);
        for (path, operations) in paths {
            for (method, operation) in operations.as_object().unwrap() {
                let summary = operation["summary"].as_str().unwrap_or_default();
                assert!(!summary.is_empty(), "{method} {path} has no summary");
                assert!(!operation["responses"].as_object().unwrap().is_empty(), "{method} {path}");
            }
        }
    }

    #[test]
    fn every_route_is_in_the_documentation() {
        let documentation = include_str!("../../docs/api.md");
        let document: serde_json::Value = serde_json::from_str(&document()).unwrap();
        for (path, operations) in document["paths"].as_object().unwrap() {
            for method in operations.as_object().unwrap().keys() {
                let heading = format!("### `{} {path}`", method.to_uppercase());
                assert!(documentation.contains(&heading), "{heading}");
            }
        }
    }
}
