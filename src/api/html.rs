//! Answers that are pages: their headers, with the policy that keeps other hosts and scripts out.

use axum::http::{HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};

/// Returns the policy of a page: nothing from other hosts, and no script but the daemon's own file. `forms` are the places
/// to which its forms may be sent without scripts.
fn policy(forms: &str) -> HeaderValue {
    let text = format!(
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; connect-src 'self'; img-src 'self' data:; \
         form-action {forms}; base-uri 'none'; frame-ancestors 'none'"
    );
    HeaderValue::from_str(&text).unwrap_or(HeaderValue::from_static("default-src 'none'"))
}

/// Returns a page's answer.
pub(super) fn html(page: String) -> Response {
    let headers = [
        (header::CONTENT_SECURITY_POLICY, policy("'none'")),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    (headers, Html(page)).into_response()
}

/// Returns the answer of a page with a form that a browser sends itself, such as a search.
pub(super) fn html_with_form(page: String) -> Response {
    let mut response = html(page);
    response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy("'self'"));
    response
}
