//! Extractors for the parts of a request, with errors of our own.

use super::held;
use super::problem::{ApiError, ProblemType};
use super::state::ApiState;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::{HeaderMap, header, request::Parts};
use serde::de::DeserializeOwned;
use tokio::sync::OwnedSemaphorePermit;

/// The query, of which every parameter must be known.
#[derive(Debug, Clone)]
pub(super) struct Q<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Q<T> {
    type Rejection = ApiError;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let Query(query) = Query::<T>::from_request_parts(parts, state)
            .await
            .map_err(|rejection| ApiError::bad_request(rejection.body_text()))?;
        Ok(Self(query))
    }
}

/// The part of the path in braces, or a tuple of several.
#[derive(Debug, Clone)]
pub(super) struct P<T = String>(pub T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for P<T> {
    type Rejection = ApiError;
    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let Path(names) = Path::<T>::from_request_parts(parts, state)
            .await
            .map_err(|rejection| ApiError::bad_request(rejection.body_text()))?;
        Ok(Self(names))
    }
}

/// Returns whether the body is announced as JSON. Only a media type that an HTML form cannot send: a page of another
/// site then needs permission first.
pub(super) fn is_json(headers: &HeaderMap) -> bool {
    let media_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    let media_type = media_type.and_then(|value| value.split(';').next());
    media_type.is_some_and(|value| value.trim().eq_ignore_ascii_case("application/json"))
}

/// Returns the answer to a body that is not JSON.
pub(super) fn no_json() -> ApiError {
    ApiError::new(
        ProblemType::UnsupportedMediaType,
        "the body must be JSON with `Content-Type: application/json` (with curl: --json '{…}')",
    )
}

/// A JSON body, or `None` if the request has no body, with its memory. Bind both: the memory counts until it is dropped.
#[derive(Debug)]
pub(super) struct J<T>(pub Option<T>, pub Option<OwnedSemaphorePermit>);

impl<T: DeserializeOwned> FromRequest<ApiState> for J<T> {
    type Rejection = ApiError;
    async fn from_request(request: Request, state: &ApiState) -> Result<Self, ApiError> {
        let is_json = is_json(request.headers());
        let (bytes, permit) = held::body(state, request.into_body()).await?;
        if bytes.is_empty() {
            return Ok(Self(None, permit));
        }
        if !is_json {
            return Err(no_json());
        }
        // A list would be read as the members in their order.
        if bytes.trim_ascii_start().first() != Some(&b'{') {
            return Err(ApiError::bad_request("the body is invalid: expected a JSON object, `{…}`"));
        }
        serde_json::from_slice(&bytes)
            .map(|body| Self(Some(body), permit))
            .map_err(|error| ApiError::bad_request(format!("the body: {error}")))
    }
}
