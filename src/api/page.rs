//! Pages of lists: `?limit=&cursor=` in, `next` in the body and `Link: <…>; rel="next"` out.

use super::problem::ApiError;
use crate::store::{Page, PageRequest};
use axum::Json;
use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

/// Maximum number of rows on a page.
const LIMIT_MAX: u32 = 1000;

/// The wanted part of a list.
#[derive(Debug, Clone, Default, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// Maximum number of rows.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<u32>,
    /// `next` of the page before.
    cursor: Option<String>,
}

impl PageQuery {
    pub(super) fn request(self) -> Result<PageRequest, ApiError> {
        request(self.limit, self.cursor)
    }
}

/// Returns the page that `limit` and `cursor` request.
pub(super) fn request(limit: Option<u32>, cursor: Option<String>) -> Result<PageRequest, ApiError> {
    match limit {
        Some(limit) if !(1..=LIMIT_MAX).contains(&limit) => {
            Err(ApiError::bad_request(format!("`limit` is {limit}: allowed is 1 to {LIMIT_MAX}")))
        }
        limit => Ok(PageRequest { limit, cursor }),
    }
}

/// Returns a list's answer. `build` puts the rows and `next` under their names.
pub(super) fn answer<T, B: Serialize>(
    uri: &Uri,
    page: Page<T>,
    build: impl FnOnce(Vec<T>, Option<String>) -> B,
) -> Response {
    let link = page.next.as_deref().and_then(|next| link(uri, next));
    let mut response = Json(build(page.rows, page.next)).into_response();
    if let Some(link) = link {
        response.headers_mut().insert(header::LINK, link);
    }
    response
}

/// Answers with what a request made, or with what an earlier one made, and its place.
pub(super) fn made(is_new: bool, place: &str, body: impl Serialize) -> Response {
    let status = if is_new { StatusCode::CREATED } else { StatusCode::OK };
    let mut response = (status, Json(body)).into_response();
    if let Ok(location) = HeaderValue::from_str(place) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    response
}

fn link(uri: &Uri, next: &str) -> Option<HeaderValue> {
    HeaderValue::from_str(&format!("<{}>; rel=\"next\"", with(uri, "cursor", next))).ok()
}

/// Returns the path and query of an address, of whose query one parameter is replaced. `value` needs no encoding.
pub(super) fn with(uri: &Uri, key: &str, value: &str) -> String {
    let is_other = |pair: &&str| !pair.is_empty() && pair.split('=').next() != Some(key);
    let mut query: Vec<String> =
        uri.query().unwrap_or_default().split('&').filter(is_other).map(str::to_owned).collect();
    query.push(format!("{key}={value}"));
    format!("{}?{}", uri.path(), query.join("&"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_link_keeps_the_filter_and_replaces_the_cursor() {
        let uri: Uri = "/v1/jobs?state=done&cursor=old&limit=5".parse().unwrap();
        assert_eq!(link(&uri, "jobs-1-z").unwrap(), "</v1/jobs?state=done&limit=5&cursor=jobs-1-z>; rel=\"next\"");
        let uri: Uri = "/v1/jobs".parse().unwrap();
        assert_eq!(link(&uri, "jobs-1-z").unwrap(), "</v1/jobs?cursor=jobs-1-z>; rel=\"next\"");
    }

    #[test]
    fn a_limit_is_1_to_1000() {
        assert!(request(Some(0), None).is_err());
        assert!(request(Some(1001), None).is_err());
        assert_eq!(request(Some(1000), None).unwrap().limit, Some(1000));
    }
}
