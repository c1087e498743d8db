//! Held: the memory that the bodies and answers of all connections take together.
//!
//! The number of connections is limited, and so is each body and each query. A thousand clients that send almost all of a
//! body and stop, or that read no answer, would still add up. What is larger than [`FREE_BYTES`] therefore takes part of one
//! budget for as long as it is in memory, and is answered 429 if nothing is left.

use super::problem::{ApiError, ProblemType};
use super::state::ApiState;
use super::stream::Streamed;
use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use hyper::body::Body as _;
use std::pin::Pin;
use tokio::sync::OwnedSemaphorePermit;

/// Maximum size of a body that is kept in memory, in bytes.
pub(super) const BODY_BYTES: usize = 64 * 1024;
/// A body or answer of at most this size takes nothing of the budget: 1,024 of them have 4 MiB.
const FREE_BYTES: usize = 4 * 1024;
/// The part of the budget that a larger body takes: JSON of 64 KiB has up to eight times its size when it is parsed.
const PARSED_BYTES: usize = 8 * BODY_BYTES;

/// Reads a body into memory. The body's memory counts until the returned permit is dropped.
///
/// # Errors
/// [`ApiError`]: 413 above [`BODY_BYTES`], 429 if the budget has no room, 400 for a body that ends early.
pub(super) async fn body(state: &ApiState, mut body: Body) -> Result<(Bytes, Option<OwnedSemaphorePermit>), ApiError> {
    let (mut bytes, mut permit) = (Vec::new(), None);
    while let Some(frame) = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await {
        let frame = frame.map_err(|error| ApiError::bad_request(format!("the body ended early: {error}")))?;
        let Ok(data) = frame.into_data() else { continue };
        let length = bytes.len() + data.len();
        if length > BODY_BYTES {
            return Err(ApiError::new(ProblemType::TooLarge, "a body holds at most 64 KiB"));
        }
        if length > FREE_BYTES && permit.is_none() {
            permit = Some(state.memory_permit(PARSED_BYTES)?);
            bytes.reserve_exact(BODY_BYTES);
        }
        bytes.extend_from_slice(&data);
    }
    Ok((bytes.into(), permit))
}

/// An answer with its permit: both end when the last byte is sent.
struct Answer {
    bytes: Bytes,
    _permit: OwnedSemaphorePermit,
}

impl AsRef<[u8]> for Answer {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Takes a part of the budget for each answer that is in memory as a whole, or answers 429 in its place.
pub(super) async fn answer(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    // What a change has done is reported in any case; few changes run at once.
    let is_change = !request.method().is_safe();
    let response = next.run(request).await;
    if is_change || response.extensions().get::<Streamed>().is_some() {
        return response;
    }
    let (head, body) = response.into_parts();
    let bytes = match axum::body::to_bytes(body, usize::MAX).await {
        Ok(bytes) => bytes,
        Err(error) => return ApiError::internal(error.to_string()).into_response(),
    };
    if bytes.len() <= FREE_BYTES {
        return Response::from_parts(head, bytes.into());
    }
    match state.memory_permit(bytes.len()) {
        Ok(permit) => Response::from_parts(head, Bytes::from_owner(Answer { bytes, _permit: permit }).into()),
        Err(error) => error.into_response(),
    }
}
