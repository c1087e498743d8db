//! Conditional answers: a finished result never changes, so that a client that has it need not fetch it again.

use crate::store::{ResultRow, SOFTWARE};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Returns the weak entity tag of a result: its id and the program that made it. It is weak because an answer and its
/// compressed form have the same tag (RFC 9110, section 8.8.3).
pub(super) fn entity_tag(result: &ResultRow) -> String {
    format!("W/\"{}-{}\"", result.id, plain(&result.software))
}

/// Returns the weak entity tag of a form that this program makes of a result: the result's tag, with the form and this
/// program.
pub(super) fn entity_tag_of_form(result: &ResultRow, form: &str) -> String {
    format!("W/\"{}-{}-{}-{}\"", result.id, plain(&result.software), plain(form), plain(SOFTWARE))
}

/// Returns the text without characters that a tag must not have.
pub(super) fn plain(text: &str) -> String {
    text.chars().map(|letter| if letter.is_ascii_alphanumeric() || letter == '.' { letter } else { '-' }).collect()
}

/// Returns whether `If-None-Match` names this tag (RFC 9110, section 13.1.2: weak comparison).
pub(super) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    fn opaque(tag: &str) -> &str {
        tag.strip_prefix("W/").unwrap_or(tag)
    }
    headers
        .get_all(header::IF_NONE_MATCH)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .any(|value| value.split(',').map(str::trim).any(|known| known == "*" || opaque(known) == opaque(tag)))
}

/// Returns `body` with its tag, or 304 without it if the client has the tag.
pub(super) fn answer(headers: &HeaderMap, tag: &str, body: impl IntoResponse) -> Response {
    let mut response =
        if is_known(headers, tag) { StatusCode::NOT_MODIFIED.into_response() } else { body.into_response() };
    if let Ok(tag) = HeaderValue::from_str(tag) {
        response.headers_mut().insert(header::ETAG, tag);
    }
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    // 304 has the field that the whole answer has (RFC 9110, section 15.4.5), whether that one is compressed or not.
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(values: &[&str]) -> HeaderMap {
        values.iter().map(|value| (header::IF_NONE_MATCH, HeaderValue::from_str(value).unwrap())).collect()
    }

    #[test]
    fn a_known_tag_is_answered_without_body() {
        for known in [&["\"1-x\""][..], &["W/\"1-x\""], &["*"], &["\"0-x\", \"1-x\""], &["\"a\"", "\"1-x\""]] {
            let response = answer(&asked(known), "\"1-x\"", "body");
            assert_eq!(response.status(), StatusCode::NOT_MODIFIED, "{known:?}");
            assert_eq!(response.headers()[header::ETAG], "\"1-x\"");
            assert_eq!(response.headers()[header::VARY], "accept-encoding");
            assert_eq!(answer(&asked(known), "W/\"1-x\"", "body").status(), StatusCode::NOT_MODIFIED, "{known:?}");
        }
    }

    #[test]
    fn an_unknown_tag_gets_the_body() {
        for unknown in [&[][..], &["\"2-x\""], &["1-x"], &["\"\u{e9}\""]] {
            let headers = if unknown.iter().any(|value| !value.is_ascii()) {
                HeaderMap::from_iter([(header::IF_NONE_MATCH, HeaderValue::from_bytes(b"\"\xff\"").unwrap())])
            } else {
                asked(unknown)
            };
            assert_eq!(answer(&headers, "\"1-x\"", "body").status(), StatusCode::OK, "{unknown:?}");
        }
    }
}
