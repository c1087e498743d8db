//! The layers around every handler.

use super::problem::{self, ApiError, ProblemType};
use super::state::ApiState;
use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use hyper::body::{Frame, SizeHint};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
static REQUESTS: AtomicU64 = AtomicU64::new(0);

/// Handles the outermost layer: the request's id, its line in the log, its count, and the form of errors.
pub(super) async fn observe(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    // A client that sends many requests at once is answered one at a time, in turn with the others.
    tokio::task::yield_now().await;
    let started = Instant::now();
    let number = REQUESTS.fetch_add(1, Ordering::Relaxed);
    // The process id distinguishes requests of one start from those of the next.
    let id = format!("{:x}-{number:x}", std::process::id());
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    let as_page = problem::is_for_people(request.headers());
    let response = next.run(request).await;
    let mut response = problem::finish(response, &id, &path, as_page);
    let status = response.status().as_u16();
    state.parts.metrics.request(status);
    tracing::debug!(request = id, %method, path, status, took_ms = started.elapsed().as_millis() as u64, "Answered.");
    if let Ok(id) = HeaderValue::from_str(&id) {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

/// Checks, on loopback, that the requested host is this machine under a name that no foreign name server can give: a
/// page whose name was rebound to 127.0.0.1 could otherwise read and change everything.
pub(super) async fn check_host(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    let asked = request.uri().authority().map(|authority| authority.as_str().to_owned());
    let asked = asked.or_else(|| {
        let host = request.headers().get(header::HOST)?;
        // A host that is not text is not ours.
        Some(host.to_str().unwrap_or("?").to_owned())
    });
    match asked {
        Some(host) if state.parts.loopback && !is_local(&host) => ApiError::foreign_host(&host).into_response(),
        _ => next.run(request).await,
    }
}

/// Returns whether `host` (with or without a port) is an address, or `localhost`.
fn is_local(host: &str) -> bool {
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    let name = name.trim_end_matches('.').to_ascii_lowercase();
    name == "localhost" || name.ends_with(".localhost") || name.parse::<std::net::IpAddr>().is_ok()
}

/// Requests that change something need the token if one is configured, and must not come from another site's page.
pub(super) async fn authorize(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    if request.method().is_safe() || request.method() == Method::OPTIONS {
        return next.run(request).await;
    }
    if from_foreign_site(request.headers()) {
        return ApiError::foreign_site().into_response();
    }
    match &state.parts.token {
        Some(token) if !bears(request.headers(), token) => ApiError::new(
            ProblemType::NotAuthorized,
            "requests that change something need `Authorization: Bearer TOKEN` with the token of the daemon's \
             configuration (`http.token` or `http.token-file`; commands such as `vn100d import` and `vn100d start` take it from their own, \
             see --config)",
        )
        .into_response(),
        _ => next.run(request).await,
    }
}

/// Returns whether a request comes from another site. A browser sends the page's origin with requests that change
/// something; our page has the requested host. If the origin is absent, the browser still states whether the page is
/// ours (`same-origin`) or there is none (`none`).
fn from_foreign_site(headers: &HeaderMap) -> bool {
    let site = headers.get("sec-fetch-site").map(HeaderValue::as_bytes);
    if site.is_some_and(|site| site != b"same-origin" && site != b"none") {
        return true;
    }
    let Some(origin) = headers.get(header::ORIGIN) else { return false };
    let origin_host = origin.to_str().ok().and_then(|origin| origin.split_once("://")).map(|(_, host)| host);
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    origin_host.is_none() || origin_host != host
}

fn bears(headers: &HeaderMap, token: &str) -> bool {
    let Some(value) = headers.get(header::AUTHORIZATION).map(HeaderValue::as_bytes) else { return false };
    let Some((scheme, given)) = value.split_at_checked(7) else { return false };
    scheme.eq_ignore_ascii_case(b"bearer ") && same(given, token.as_bytes())
}

/// Compares in a time that does not depend on the position of the first difference.
fn same(given: &[u8], expected: &[u8]) -> bool {
    let differences = given.iter().zip(expected).fold(0, |seen, (a, b)| seen | (a ^ b));
    given.len() == expected.len() && differences == 0
}

/// Minimum interval between logs of bodies that do not arrive.
const WARN_EVERY: Duration = Duration::from_secs(60);
/// The time of the last such log, and the number of bodies since.
static STALLED: Mutex<(Option<Instant>, u64)> = Mutex::new((None, 0));

/// A body, and whether more of it is awaited.
struct Awaited {
    body: Body,
    waits: Arc<AtomicBool>,
}

impl HttpBody for Awaited {
    type Data = Bytes;
    type Error = axum::Error;
    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        self.waits.store(polled.is_pending(), Ordering::Relaxed);
        polled
    }
    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }
    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Logs from time to time that a body did not arrive: a stranger must not fill the log.
fn warn_of_stalled() {
    let mut stalled = STALLED.lock().unwrap_or_else(PoisonError::into_inner);
    stalled.1 += 1;
    if stalled.0.is_none_or(|at| at.elapsed() >= WARN_EVERY) {
        tracing::warn!(requests = stalled.1, "Requests announced a body that did not come.");
        *stalled = (Some(Instant::now()), 0);
    }
}

/// Limits the time until an answer's head is sent; a stream continues as long as it is read. Bodies that are stored as
/// they arrive have their own limits.
pub(super) async fn limit_time(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    if request.uri().path() == super::imports::PATH || super::diagnoses::is_put_aside(&request) {
        return next.run(request).await;
    }
    let limit = state.parts.limits.answer;
    let waits = Arc::new(AtomicBool::new(false));
    let request = request.map(|body| Body::new(Awaited { body, waits: Arc::clone(&waits) }));
    tokio::time::timeout(limit, next.run(request)).await.unwrap_or_else(|_| {
        let limit_s = limit.as_secs_f64();
        let error = if waits.load(Ordering::Relaxed) {
            warn_of_stalled();
            ApiError::new(
                ProblemType::BodyTimeout,
                format!("the body did not come within {limit_s} s: nothing was done"),
            )
        } else {
            let detail = format!("no answer within {limit_s} s; what was asked for may still happen: see /v1/status");
            ApiError::new(ProblemType::Timeout, detail)
        };
        error.into_response()
    })
}

/// The delay of a refusal. A client that repeats a refused request at once would otherwise cost as much as an answered
/// one.
const REFUSAL_PAUSE: Duration = Duration::from_secs(1);

/// Delays each 429 by [`REFUSAL_PAUSE`].
pub(super) async fn slow_refusals(request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    if response.status() == StatusCode::TOO_MANY_REQUESTS {
        tokio::time::sleep(REFUSAL_PAUSE).await;
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(HeaderName, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (name.clone(), HeaderValue::from_str(value).unwrap())).collect()
    }

    #[test]
    fn only_the_whole_token_is_the_token() {
        let authorized = |value: &str| bears(&headers(&[(header::AUTHORIZATION, value)]), "0123456789abcdef");
        assert!(authorized("Bearer 0123456789abcdef"));
        assert!(authorized("bearer 0123456789abcdef"));
        for wrong in
            ["", "Bearer", "Bearer ", "Bearer 0123456789abcde", "Bearer 0123456789abcdef0", "Basic 0123456789abcdef"]
        {
            assert!(!authorized(wrong), "{wrong}");
        }
        assert!(!bears(&HeaderMap::new(), "0123456789abcdef"));
    }

    #[test]
    fn a_name_that_a_name_server_can_give_is_not_this_machine() {
        for host in [
            "localhost",
            "LOCALHOST:8100",
            "127.0.0.1:8100",
            "127.0.0.1",
            "[::1]:8100",
            "[::1]",
            "192.168.1.5:80",
            "a.localhost",
        ] {
            assert!(is_local(host), "{host}");
        }
        for host in
            ["", "x", "evil.example", "evil.example:8100", "localhost.evil.example", "127.0.0.1.evil.example", "?"]
        {
            assert!(!is_local(host), "{host}");
        }
    }

    #[test]
    fn a_page_of_another_site_is_distinguished_from_our_own_and_from_curl() {
        let foreign = |origin: Option<&str>| {
            let mut pairs = vec![(header::HOST, "127.0.0.1:8100")];
            pairs.extend(origin.map(|origin| (header::ORIGIN, origin)));
            from_foreign_site(&headers(&pairs))
        };
        assert!(!foreign(None));
        assert!(!foreign(Some("http://127.0.0.1:8100")));
        for other in ["http://evil.example", "null", "http://127.0.0.1:81"] {
            assert!(foreign(Some(other)), "{other}");
        }
        // Without an origin; `same-site` is another port of this machine, possibly another user's.
        let site = HeaderName::from_static("sec-fetch-site");
        for (from, is_foreign) in [("same-origin", false), ("none", false), ("same-site", true), ("cross-site", true)] {
            assert_eq!(from_foreign_site(&headers(&[(site.clone(), from)])), is_foreign, "{from}");
        }
    }
}
