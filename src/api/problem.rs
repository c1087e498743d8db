//! Errors as RFC 9457 problem documents: the only place that assigns status codes to errors.
//!
//! A handler returns an [`ApiError`]. Its response carries a [`Problem`] as an extension and no body. [`finish`], which
//! handles every answer last, writes the body with the request's id. It also does so for all other answers with an
//! error status (an unknown path, a method that is not allowed), so that every error has this form. A browser that goes to
//! an address gets the same as a page.

use super::html::html;
use crate::control::{ControlError, ImportError};
use crate::jobs::JobError;
use crate::page::{RefusalView, refusal};
use crate::store::{StoreError, StoreErrorKind};
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use imu_cost::CostError;
use serde::Serialize;

/// Media type of the body of every error.
pub const PROBLEM_JSON: &str = "application/problem+json";

/// The types of problems; few, so that a program can handle each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "kebab-case", prefix = "urn:vn100d:problem:")]
#[expect(missing_docs, reason = "title() says it")]
pub enum ProblemType {
    BadRequest,
    NotAuthorized,
    NotFound,
    MethodNotAllowed,
    NotAcceptable,
    Conflict,
    TooLarge,
    UnsupportedMediaType,
    AnalysisFailed,
    Internal,
    Unavailable,
    Busy,
    Timeout,
    BodyTimeout,
}

impl ProblemType {
    /// Returns the member `type` (docs/api.md lists them).
    pub fn uri(self) -> &'static str {
        self.into()
    }

    /// Returns the member `title`: the same for every problem of this type.
    pub fn title(self) -> &'static str {
        match self {
            Self::BadRequest => "The request cannot be understood",
            Self::NotAuthorized => "The request is not authorized",
            Self::NotFound => "There is nothing here",
            Self::MethodNotAllowed => "The method is not allowed here",
            Self::NotAcceptable => "The answer does not exist in the form that is accepted",
            Self::Conflict => "The request contradicts what is there",
            Self::TooLarge => "The request is too large",
            Self::UnsupportedMediaType => "The body's media type is not understood",
            Self::AnalysisFailed => "The analysis failed",
            Self::Internal => "The program failed",
            Self::Unavailable => "This cannot be answered now",
            Self::Busy => "Too many ask for this at once",
            Self::Timeout => "The answer took too long",
            Self::BodyTimeout => "The body took too long",
        }
    }

    /// Returns the status code of the type.
    pub fn status(self) -> StatusCode {
        match self {
            Self::BadRequest => StatusCode::BAD_REQUEST,
            Self::NotAuthorized => StatusCode::UNAUTHORIZED,
            Self::NotFound => StatusCode::NOT_FOUND,
            Self::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
            Self::NotAcceptable => StatusCode::NOT_ACCEPTABLE,
            Self::Conflict => StatusCode::CONFLICT,
            Self::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Self::UnsupportedMediaType => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            Self::AnalysisFailed => StatusCode::UNPROCESSABLE_ENTITY,
            Self::Internal => StatusCode::INTERNAL_SERVER_ERROR,
            Self::Unavailable | Self::Timeout => StatusCode::SERVICE_UNAVAILABLE,
            Self::Busy => StatusCode::TOO_MANY_REQUESTS,
            Self::BodyTimeout => StatusCode::REQUEST_TIMEOUT,
        }
    }

    /// Returns the type for a status code that was not chosen by a handler.
    fn of(status: StatusCode) -> Self {
        match status {
            StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => Self::NotAuthorized,
            StatusCode::NOT_FOUND => Self::NotFound,
            StatusCode::METHOD_NOT_ALLOWED => Self::MethodNotAllowed,
            StatusCode::NOT_ACCEPTABLE => Self::NotAcceptable,
            StatusCode::CONFLICT => Self::Conflict,
            StatusCode::PAYLOAD_TOO_LARGE | StatusCode::URI_TOO_LONG => Self::TooLarge,
            StatusCode::UNSUPPORTED_MEDIA_TYPE => Self::UnsupportedMediaType,
            StatusCode::SERVICE_UNAVAILABLE => Self::Unavailable,
            StatusCode::TOO_MANY_REQUESTS => Self::Busy,
            StatusCode::REQUEST_TIMEOUT => Self::BodyTimeout,
            status if status.is_client_error() => Self::BadRequest,
            _ => Self::Internal,
        }
    }
}

/// A problem document.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Problem {
    /// The type: `urn:vn100d:problem:…`.
    #[serde(rename = "type")]
    pub kind: &'static str,
    /// The title, the same for every problem of this type.
    pub title: &'static str,
    /// The status code.
    pub status: u16,
    /// The problem of this request, and what to do.
    pub detail: String,
    /// `/requests/<id>`: the log has the same id.
    pub instance: String,
    /// The reasons, if there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub reasons: Vec<String>,
    /// When to try again, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retry_after_s: Option<u32>,
}

/// An error of a handler.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{detail}")]
pub struct ApiError {
    kind: ProblemType,
    status: StatusCode,
    detail: String,
    reasons: Vec<String>,
    retry_after_s: Option<u32>,
    /// The cause, for the log only.
    cause: Option<String>,
}

impl ApiError {
    /// Returns the type of the error.
    pub fn kind(&self) -> ProblemType {
        self.kind
    }

    /// Creates an error of this type. `detail` is for the client.
    pub fn new(kind: ProblemType, detail: impl Into<String>) -> Self {
        Self {
            kind,
            status: kind.status(),
            detail: detail.into(),
            reasons: Vec::new(),
            retry_after_s: None,
            cause: None,
        }
    }
    /// Creates the error of a request that cannot be understood.
    pub fn bad_request(detail: impl Into<String>) -> Self {
        Self::new(ProblemType::BadRequest, detail)
    }
    /// Creates the error of a request from another site's page in a browser.
    pub fn foreign_site() -> Self {
        let error = Self::new(
            ProblemType::NotAuthorized,
            "requests that change something are not taken from another site's page (headers `Origin`, `Sec-Fetch-Site`)",
        );
        Self { status: StatusCode::FORBIDDEN, ..error }
    }
    /// Creates the error of a request that on loopback names a host that is not this machine.
    pub fn foreign_host(host: &str) -> Self {
        let host: String = host.chars().take(100).collect();
        let error = Self::new(
            ProblemType::NotAuthorized,
            format!(
                "the header `Host` names `{host}`, but only this machine is served: ask for localhost or an address; a \
                 proxy sets `Host: localhost`"
            ),
        );
        Self { status: StatusCode::FORBIDDEN, ..error }
    }
    /// Creates the error of a request that cannot be answered now.
    pub fn unavailable(detail: impl Into<String>, retry_after_s: u32) -> Self {
        Self { retry_after_s: Some(retry_after_s), ..Self::new(ProblemType::Unavailable, detail) }
    }
    /// Creates the error of a body that does not arrive.
    pub fn body_timeout(detail: impl Into<String>) -> Self {
        Self::new(ProblemType::BodyTimeout, detail)
    }
    /// Creates the error of a request while the maximum number of such requests is under way.
    pub fn busy(detail: impl Into<String>, retry_after_s: u32) -> Self {
        Self { retry_after_s: Some(retry_after_s), ..Self::new(ProblemType::Busy, detail) }
    }
    /// Creates the error of a daemon that is not ready, for these reasons.
    pub fn not_ready(reasons: Vec<String>) -> Self {
        Self { reasons, ..Self::unavailable("the daemon is not ready", 5) }
    }
    /// Creates the error of a fault of this program; `cause` goes to the log.
    pub fn internal(cause: impl Into<String>) -> Self {
        Self {
            cause: Some(cause.into()),
            ..Self::new(ProblemType::Internal, "this is a fault of the program: the log has more under this instance")
        }
    }
    /// Returns the status code.
    pub fn status(&self) -> StatusCode {
        self.status
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        let detail = error.to_string();
        if matches!(error, StoreError::QueueFull(_)) {
            return Self::busy(detail, 10);
        }
        match error.kind() {
            StoreErrorKind::NotFound => Self::new(ProblemType::NotFound, detail),
            StoreErrorKind::Conflict => Self::new(ProblemType::Conflict, detail),
            StoreErrorKind::Invalid => Self::bad_request(detail),
            // A lock, a full disk, a failing disk: the state of the machine, not of this program.
            StoreErrorKind::Unavailable | StoreErrorKind::CannotCreate | StoreErrorKind::Io => {
                let cause = Some(detail.clone());
                Self { cause, ..Self::unavailable(format!("the database cannot be read now: {detail}"), 5) }
            }
            _ => Self::internal(detail),
        }
    }
}

impl From<JobError> for ApiError {
    fn from(error: JobError) -> Self {
        match error {
            JobError::Store(error) => error.into(),
            error @ (JobError::Parameters { .. } | JobError::Together(_) | JobError::Model(_)) => {
                Self::bad_request(error.to_string())
            }
            error @ (JobError::InsufficientData(_) | JobError::Allan(_) | JobError::Diagnosis(_)) => {
                Self::new(ProblemType::AnalysisFailed, error.to_string())
            }
            JobError::Cost(
                error @ (CostError::NoClosedForm { .. }
                | CostError::Size { .. }
                | CostError::NoChannel { .. }
                | CostError::Model(_)),
            ) => Self::new(ProblemType::AnalysisFailed, error.to_string()),
            JobError::Cost(error) => Self::bad_request(error.to_string()),
            error @ JobError::TooLarge(_) => Self::new(ProblemType::TooLarge, error.to_string()),
            error @ (JobError::Died(_) | JobError::Process(_)) => Self::unavailable(error.to_string(), 5),
            error => Self::internal(error.to_string()),
        }
    }
}

impl From<ImportError> for ApiError {
    fn from(error: ImportError) -> Self {
        let detail = error.to_string();
        match error {
            ImportError::Recording(_) => Self::new(ProblemType::AnalysisFailed, detail),
            ImportError::NameTaken(_) => Self::new(ProblemType::Conflict, detail),
            ImportError::NameRefused(_) => Self::bad_request(detail),
            // The disk is fine: the client should try again.
            ImportError::Stopping => Self { status: StatusCode::SERVICE_UNAVAILABLE, ..Self::busy(detail, 5) },
            ImportError::Store(_) | ImportError::Process(_) => Self::unavailable(detail, 5),
        }
    }
}

impl From<ControlError> for ApiError {
    fn from(error: ControlError) -> Self {
        let detail = error.to_string();
        match error {
            ControlError::Busy(_) | ControlError::NotRunning(_) | ControlError::NameTaken(_) => {
                Self::new(ProblemType::Conflict, detail)
            }
            ControlError::Refused(_) => Self::bad_request(detail),
            ControlError::Store(_) | ControlError::Unwritten(_) | ControlError::Stopping => {
                Self::unavailable(detail, 5)
            }
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let mut response = Response::new(Body::empty());
        *response.status_mut() = self.status;
        let headers = response.headers_mut();
        if let Some(seconds) = self.retry_after_s {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"vn100d\""));
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// Returns whether an error is shown as a page: `Accept` names HTML and no JSON, as a browser's does.
pub(super) fn is_for_people(headers: &HeaderMap) -> bool {
    let ranges: Vec<String> = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .map(|range| range.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
        .collect();
    ranges.iter().any(|media| media == "text/html") && !ranges.iter().any(|media| media.ends_with("json"))
}

/// Gives an error answer its body, a document or a page; other answers pass unchanged.
pub(super) fn finish(mut response: Response, request_id: &str, path: &str, as_page: bool) -> Response {
    let status = response.status();
    if !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let error = response.extensions_mut().remove::<ApiError>().unwrap_or_else(|| unexplained(status, path));
    if status.is_server_error() {
        let cause = error.cause.as_deref().unwrap_or(&error.detail);
        tracing::warn!(request = request_id, path, status = status.as_u16(), cause, "A request could not be answered.");
    }
    let problem = Problem {
        kind: error.kind.uri(),
        title: error.kind.title(),
        status: status.as_u16(),
        detail: error.detail,
        instance: format!("/requests/{request_id}"),
        reasons: error.reasons,
        retry_after_s: error.retry_after_s,
    };
    let (head, body) = if as_page { problem.page() } else { problem.document() }.into_parts();
    response.headers_mut().remove(header::CONTENT_LENGTH);
    for (name, value) in &head.headers {
        response.headers_mut().insert(name, value.clone());
    }
    *response.body_mut() = body;
    response
}

impl Problem {
    fn document(&self) -> Response {
        let headers = [(header::CONTENT_TYPE, PROBLEM_JSON), (header::CACHE_CONTROL, "no-store")];
        (headers, serde_json::to_vec(self).unwrap_or_default()).into_response()
    }

    fn page(&self) -> Response {
        html(refusal(&RefusalView {
            title: self.title,
            detail: &self.detail,
            reasons: &self.reasons,
            retry_after_s: self.retry_after_s,
            instance: &self.instance,
        }))
    }
}

fn unexplained(status: StatusCode, path: &str) -> ApiError {
    let kind = ProblemType::of(status);
    let detail = match kind {
        ProblemType::NotFound => {
            let path: String = path.chars().take(200).collect();
            format!("there is no `{path}`: /openapi.json lists all paths (a slash at the end makes another path)")
        }
        ProblemType::MethodNotAllowed => "the header `Allow` lists the methods of this path".to_owned(),
        _ => status.canonical_reason().unwrap_or("no more is known").to_owned(),
    };
    ApiError { status, ..ApiError::new(kind, detail) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use strum::VariantArray as _;

    #[test]
    fn every_type_has_its_own_name_and_title_and_is_documented() {
        let documentation = include_str!("../../docs/api.md");
        for (index, kind) in ProblemType::VARIANTS.iter().enumerate() {
            for other in &ProblemType::VARIANTS[index + 1..] {
                assert_ne!(kind.uri(), other.uri());
                assert_ne!(kind.title(), other.title());
            }
            assert!(kind.status().is_client_error() || kind.status().is_server_error());
            let row = format!("| `{}` | {}", kind.uri(), kind.status().as_u16());
            assert!(documentation.contains(&row), "{row}");
        }
    }

    #[test]
    fn what_a_handler_did_not_explain_is_explained_by_its_status() {
        for (status, kind) in [
            (StatusCode::FORBIDDEN, ProblemType::NotAuthorized),
            (StatusCode::URI_TOO_LONG, ProblemType::TooLarge),
            (StatusCode::IM_A_TEAPOT, ProblemType::BadRequest),
            (StatusCode::BAD_GATEWAY, ProblemType::Internal),
        ] {
            assert_eq!(ProblemType::of(status), kind);
            assert_eq!(unexplained(status, "/x").status, status);
        }
    }

    #[test]
    fn a_browser_gets_a_page_and_a_program_the_document() {
        let is_for_people = |accept: &[&'static str]| {
            let headers = accept.iter().map(|value| (header::ACCEPT, HeaderValue::from_static(value)));
            super::is_for_people(&headers.collect())
        };
        assert!(is_for_people(&["text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"]));
        assert!(is_for_people(&["image/png", "Text/HTML; q=0.5"]));
        for program in
            [&[][..], &["*/*"], &["application/json"], &["text/html, application/problem+json"], &["text/htm"]]
        {
            assert!(!is_for_people(program), "{program:?}");
        }
    }

    #[test]
    fn the_store_s_refusals_get_the_status_of_their_kind() {
        let status = |error: StoreError| ApiError::from(error).status().as_u16();
        assert_eq!(status(StoreError::NoSuchCapture("x".to_owned())), 404);
        assert_eq!(status(StoreError::NameTaken("x".to_owned())), 409);
        assert_eq!(status(StoreError::BadCursor("x".to_owned())), 400);
        assert_eq!(ApiError::from(ControlError::Refused("x".to_owned())).status().as_u16(), 400);
        assert_eq!(status(StoreError::Closed), 503);
        assert_eq!(status(StoreError::Unknown { column: "x", found: "y".to_owned() }), 500);
    }
}
