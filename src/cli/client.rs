//! Requests to the running daemon over HTTP, for the commands that need it.

use super::connection::Watched;
use crate::api::ProblemType;
use crate::config::{JOIN_GROUP, MACHINE_TOKEN};
use crate::store::printable;
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use ureq::unversioned::resolver::DefaultResolver;

/// Maximum time for an answer: the daemon answers from memory, or reports within 10 s that it cannot.
pub(super) const PATIENCE: Duration = Duration::from_secs(12);
/// Maximum time for the daemon to report that it wants a body.
const PERMISSION: Duration = Duration::from_secs(5);
/// Maximum size of an answer in bytes.
const ANSWER_BYTES: u64 = 16 << 20;

/// The reasons why the daemon gave no answer.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No daemon answers: exit code 69.
    #[error("no daemon answers at {base_url}: {reason}; start it with `vn100d run`, or name its address with --listen")]
    Unreachable {
        /// The address.
        base_url: String,
        /// The error of the connection.
        reason: String,
    },
    /// The daemon answered with a problem.
    #[error("the daemon at {base_url} answered {status}: {detail}")]
    Refused {
        /// The address.
        base_url: String,
        /// The status code.
        status: u16,
        /// The problem's type.
        kind: String,
        /// The problem's detail.
        detail: String,
    },
    /// The daemon was there, but ended the connection before it had answered.
    #[error(
        "the daemon at {base_url} ended the connection{} ({reason}): see its log, then try again (what it has already is not \
         doubled)",
        progress(*sent_bytes, *length_bytes)
    )]
    BrokenOff {
        /// The address.
        base_url: String,
        /// Bytes that were sent.
        sent_bytes: u64,
        /// Bytes that the body has.
        length_bytes: u64,
        /// The error of the connection.
        reason: String,
    },
    /// The daemon was there, but did not answer to a change.
    #[error(
        "the daemon at {base_url} gave no answer ({reason}), so that it is not known whether it has done it: look with \
         `vn100d captures` or in its log before you do it again"
    )]
    Unanswered {
        /// The address.
        base_url: String,
        /// The error of the connection.
        reason: String,
    },
    /// The body could not be read.
    #[error("it cannot be read to its end: {0}")]
    Body(#[source] io::Error),
    /// Another program than the daemon answered.
    #[error("what answers at {base_url} is not a vn100d: {reason}")]
    Foreign {
        /// The address.
        base_url: String,
        /// The fault of the answer.
        reason: String,
    },
    /// The answer could not be printed.
    #[error("cannot write to standard output: {0}")]
    Output(#[from] io::Error),
}

/// Returns how much of a body was sent, if there was one.
fn progress(sent_bytes: u64, length_bytes: u64) -> String {
    if length_bytes == 0 { String::new() } else { format!(" after {sent_bytes} of {length_bytes} bytes") }
}

impl ClientError {
    /// Returns the exit code.
    pub(super) fn failure(&self) -> super::Failure {
        match self {
            Self::Unreachable { .. } => super::Failure::Unreachable,
            // The user only has to wait.
            Self::Refused { kind, .. } if kind == ProblemType::Busy.uri() => super::Failure::Other,
            // The disk behind it is full or fails.
            Self::Refused { status: 503, .. } => super::Failure::InputOutput,
            Self::BrokenOff { .. } | Self::Unanswered { .. } | Self::Body(_) => super::Failure::InputOutput,
            _ => super::Failure::Other,
        }
    }

    /// Returns whether no daemon answers: exit code 69.
    pub fn is_unreachable(&self) -> bool {
        matches!(self, Self::Unreachable { .. })
    }
}

/// Returns the JSON that the daemon at `base_url` (`http://127.0.0.1:8100`) answers to `GET path`.
///
/// # Errors
/// [`ClientError`].
pub fn get(base_url: &str, path: &str) -> Result<Value, ClientError> {
    get_within(base_url, path, PATIENCE)
}

/// Returns the JSON as [`get`] does, if it comes within this time.
///
/// # Errors
/// [`ClientError`].
pub(super) fn get_within(base_url: &str, path: &str, patience: Duration) -> Result<Value, ClientError> {
    let base_url = base_url.trim_end_matches('/');
    let agent = ureq::Agent::config_builder()
        .http_status_as_error(false)
        .timeout_global(Some(patience))
        .max_redirects(0)
        .proxy(None)
        .build()
        .new_agent();
    let unreachable =
        |error: ureq::Error| ClientError::Unreachable { base_url: base_url.to_owned(), reason: error.to_string() };
    let response =
        agent.get(format!("{base_url}{path}")).header("accept", "application/json").call().map_err(unreachable)?;
    read(base_url, response, (0, 0))
}

/// How a request changes something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    /// `POST`
    Post,
    /// `PATCH`
    Patch,
    /// `DELETE`
    Delete,
}

/// Returns the JSON that the daemon answers to a request that changes something; null if its answer is empty.
///
/// # Errors
/// [`ClientError`]. After [`ClientError::Unanswered`] it is not known whether the daemon has done it.
pub(super) fn change(
    base_url: &str,
    how: Change,
    path: &str,
    token: &str,
    body: Option<&Value>,
) -> Result<Value, ClientError> {
    let base_url = base_url.trim_end_matches('/');
    let config = ureq::Agent::config_builder()
        .http_status_as_error(false)
        .timeout_global(Some(PATIENCE))
        .max_redirects(0)
        .proxy(None)
        .build();
    let (agent, connected) = watched(config);
    let method = match how {
        Change::Post => ureq::http::Method::POST,
        Change::Patch => ureq::http::Method::PATCH,
        Change::Delete => ureq::http::Method::DELETE,
    };
    let mut request = ureq::http::Request::builder()
        .method(method)
        .uri(format!("{base_url}{path}"))
        .header("accept", "application/json");
    if !token.is_empty() {
        request = request.header("authorization", format!("Bearer {token}"));
    }
    if body.is_some() {
        request = request.header("content-type", "application/json");
    }
    let answered = match body {
        Some(body) => request.body(body.to_string()).map_err(ureq::Error::from).and_then(|request| agent.run(request)),
        None => request.body(()).map_err(ureq::Error::from).and_then(|request| agent.run(request)),
    };
    match answered {
        Ok(response) => read(base_url, response, (0, 0)).map_err(|error| match error {
            ClientError::BrokenOff { base_url, reason, .. } => ClientError::Unanswered { base_url, reason },
            other => other,
        }),
        Err(error) if connected.load(Ordering::Acquire) => {
            Err(ClientError::Unanswered { base_url: base_url.to_owned(), reason: error.to_string() })
        }
        Err(error) => Err(ClientError::Unreachable { base_url: base_url.to_owned(), reason: error.to_string() }),
    }
}

/// Returns an agent, and whether it has reached the daemon.
fn watched(config: ureq::config::Config) -> (ureq::Agent, Arc<AtomicBool>) {
    let connector = Watched::default();
    let connected = Arc::clone(&connector.connected);
    (ureq::Agent::with_parts(config, connector, DefaultResolver::default()), connected)
}

/// Returns a text as one segment of a path: a name may hold any character but `/` and control characters.
pub(super) fn segment(text: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_~".contains(&byte);
    text.bytes().map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

/// Returns the JSON that the daemon answers to `POST path` with a body of `length_bytes` bytes, however long it takes.
///
/// # Errors
/// [`ClientError`].
pub(super) fn send(
    base_url: &str,
    path: &str,
    query: &[(&str, String)],
    token: &str,
    length_bytes: u64,
    body: impl io::Read,
) -> Result<Value, ClientError> {
    let base_url = base_url.trim_end_matches('/');
    let config = ureq::Agent::config_builder()
        .http_status_as_error(false)
        .timeout_connect(Some(PATIENCE))
        .timeout_await_100(Some(PERMISSION))
        .max_redirects(0)
        .proxy(None)
        .build();
    let (agent, connected) = watched(config);
    let post = |body: &mut dyn io::Read| {
        // The daemon is asked before the first byte is sent, because a refusal would be lost behind bytes that it does
        // not read.
        let mut request = agent
            .post(format!("{base_url}{path}"))
            .header("accept", "application/json")
            .header("content-type", "application/octet-stream")
            .header("content-length", length_bytes.to_string())
            .header("expect", "100-continue");
        for (name, value) in query {
            request = request.query(name, value);
        }
        if !token.is_empty() {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        request.send(ureq::SendBody::from_reader(body))
    };
    let mut body = Sent { body: body.take(length_bytes), sent_bytes: 0, length_bytes, failed: None };
    let error = match post(&mut body) {
        Ok(response) => return read(base_url, response, (body.sent_bytes, length_bytes)),
        Err(error) => error,
    };
    if let Some(failed) = body.failed {
        return Err(ClientError::Body(failed));
    }
    if !connected.load(Ordering::Acquire) {
        return Err(ClientError::Unreachable { base_url: base_url.to_owned(), reason: error.to_string() });
    }
    // The daemon did not want the rest, and its answer was lost: on a second request it answers before a byte is sent.
    match post(&mut Nothing) {
        Ok(response) if !response.status().is_success() => read(base_url, response, (body.sent_bytes, length_bytes)),
        _ => Err(broken_off(base_url, (body.sent_bytes, length_bytes), &error)),
    }
}

/// Returns the error of a connection that was accepted and then ended. `sent` has the bytes of the body that were sent,
/// and its length.
fn broken_off(base_url: &str, sent: (u64, u64), error: &ureq::Error) -> ClientError {
    let (sent_bytes, length_bytes) = sent;
    ClientError::BrokenOff { base_url: base_url.to_owned(), sent_bytes, length_bytes, reason: error.to_string() }
}

/// A body being sent: the number of bytes sent, and the error that stopped it.
struct Sent<R> {
    body: io::Take<R>,
    sent_bytes: u64,
    length_bytes: u64,
    failed: Option<io::Error>,
}

impl<R: io::Read> io::Read for Sent<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = match self.body.read(buffer) {
            // The length was announced: a shorter body would keep the daemon waiting.
            Ok(0) if self.sent_bytes < self.length_bytes && !buffer.is_empty() => {
                Err(io::Error::new(io::ErrorKind::UnexpectedEof, "it became shorter while it was sent"))
            }
            read => read,
        };
        match read {
            Ok(read) => {
                self.sent_bytes += read as u64;
                Ok(read)
            }
            Err(error) => {
                let reported = io::Error::new(error.kind(), "the body ended early");
                self.failed = Some(error);
                Err(reported)
            }
        }
    }
}

/// A body that is never sent.
struct Nothing;

impl io::Read for Nothing {
    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        Err(io::Error::other("nothing is sent"))
    }
}

/// Returns the answer. `sent` has the bytes of the request's body that were sent, and its length.
fn read(
    base_url: &str,
    mut response: ureq::http::Response<ureq::Body>,
    sent: (u64, u64),
) -> Result<Value, ClientError> {
    let foreign = |reason: String| ClientError::Foreign { base_url: base_url.to_owned(), reason };
    let status = response.status().as_u16();
    let text = response.body_mut().with_config().limit(ANSWER_BYTES).read_to_string();
    let text = text.map_err(|error| broken_off(base_url, sent, &error))?;
    if status == 204 {
        return Ok(Value::Null);
    }
    let body: Value = serde_json::from_str(&text).map_err(|error| foreign(format!("no JSON ({error})")))?;
    if (200..300).contains(&status) {
        return Ok(body);
    }
    match body.get("detail").and_then(Value::as_str) {
        Some(detail) => Err(ClientError::Refused {
            base_url: base_url.to_owned(),
            status,
            kind: body["type"].as_str().unwrap_or_default().to_owned(),
            detail: format!("{detail}{}", if status == 401 { why_no_token(Path::new(MACHINE_TOKEN)) } else { "" }),
        }),
        None => Err(foreign(format!("status {status} without a problem document"))),
    }
}

/// Returns what to do for a user who may not read the machine's token.
fn why_no_token(file: &Path) -> &'static str {
    let refused = std::fs::File::open(file).is_err_and(|error| error.kind() == io::ErrorKind::PermissionDenied);
    if refused { JOIN_GROUP } else { "" }
}

/// Writes `text` and a line end to standard output, without control characters inside its lines; a reader that has gone
/// is no error.
///
/// # Errors
/// The error that the system reports.
pub fn print(text: &str) -> Result<(), ClientError> {
    let lines: Vec<String> = text.trim_end().lines().map(printable).collect();
    match writeln!(io::stdout().lock(), "{}", lines.join("\n")) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        outcome => Ok(outcome?),
    }
}

/// Returns a value of an answer for display in a line; `–` if it is absent.
pub(super) fn shown(value: &Value) -> String {
    match value {
        Value::Null => "–".to_owned(),
        Value::String(text) => printable(text),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};

    /// Returns a server that answers one request with these bytes.
    fn answering(answer: &'static str) -> String {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let base_url = format!("http://{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut head = [0; 2048];
            let _ = stream.read(&mut head).unwrap();
            stream.write_all(answer.as_bytes()).unwrap();
        });
        base_url
    }

    #[test]
    fn an_absent_daemon_is_distinguished_from_a_foreign_server() {
        // A port that was free a moment ago.
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let base_url = format!("http://{}", listener.local_addr().unwrap());
        drop(listener);
        let error = get(&base_url, "/v1/status").unwrap_err();
        assert!(error.is_unreachable(), "{error}");
        let other = answering("HTTP/1.1 200 OK\r\nContent-Length: 5\r\nConnection: close\r\n\r\nhello");
        assert!(matches!(get(&other, "/"), Err(ClientError::Foreign { .. })));
    }

    /// Returns a server that takes a request's head and `taken` bytes of its body, and then closes; the next request
    /// gets `answer`, or is closed at once if that is empty.
    fn breaking_off(taken: usize, answer: &'static str) -> String {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let base_url = format!("http://{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut bytes = vec![0; 4096];
            let _ = stream.read(&mut bytes).unwrap();
            stream.write_all(b"HTTP/1.1 100 Continue\r\n\r\n").unwrap();
            let mut left = taken;
            while left > 0 {
                left = left.saturating_sub(stream.read(&mut bytes).unwrap());
            }
            drop(stream);
            if let Ok((mut again, _)) = listener.accept() {
                let _ = again.read(&mut bytes).unwrap();
                again.write_all(answer.as_bytes()).unwrap();
            }
        });
        base_url
    }

    fn refusal(status: &str, kind: &str) -> String {
        let body = format!("{{\"type\":\"urn:vn100d:problem:{kind}\",\"detail\":\"why\"}}");
        format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}", body.len())
    }

    /// Exit code 69 only means that there is no daemon.
    #[test]
    fn a_daemon_that_does_not_take_a_body_is_there_all_the_same() {
        use crate::cli::Failure;
        let body = vec![7_u8; 8 << 20];
        let send = |base_url: &str| send(base_url, "/v1/imports", &[], "", body.len() as u64, &body[..]).unwrap_err();
        let error = send(&breaking_off(100_000, ""));
        assert!(matches!(&error, ClientError::BrokenOff { sent_bytes, .. } if *sent_bytes >= 100_000), "{error}");
        assert_eq!(error.failure(), Failure::InputOutput);
        // The reason comes with the answer to a second request.
        for (status, kind, failure) in [
            ("503 Service Unavailable", "unavailable", Failure::InputOutput),
            ("503 Service Unavailable", "busy", Failure::Other),
            ("413 Payload Too Large", "too-large", Failure::Other),
        ] {
            let error = send(&breaking_off(100_000, refusal(status, kind).leak()));
            assert!(matches!(&error, ClientError::Refused { detail, .. } if detail == "why"), "{error}");
            assert_eq!(error.failure(), failure, "{kind}");
        }
        let error = send(&answering(refusal("422 Unprocessable Content", "analysis-failed").leak()));
        assert_eq!((error.failure(), error.is_unreachable()), (Failure::Other, false), "{error}");
    }

    /// Once a connection was accepted, a daemon is there, even if no byte of the body was sent or the answer was cut.
    #[test]
    fn a_connection_that_ends_is_distinguished_from_one_that_is_never_made() {
        let send = |base_url: &str| send(base_url, "/v1/imports", &[], "", 10, &[7_u8; 10][..]).unwrap_err();
        let error = send(&answering(""));
        assert!(matches!(error, ClientError::BrokenOff { sent_bytes: 0, length_bytes: 10, .. }), "{error}");
        let cut = "HTTP/1.1 200 OK\r\nContent-Length: 50\r\nConnection: close\r\n\r\n{";
        for error in [send(&answering(cut)), get(&answering(cut), "/v1/status").unwrap_err()] {
            assert!(matches!(error, ClientError::BrokenOff { .. }), "{error}");
            assert_eq!(error.failure(), crate::cli::Failure::InputOutput);
        }
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let base_url = format!("http://{}", listener.local_addr().unwrap());
        drop(listener);
        assert!(send(&base_url).is_unreachable());
    }

    #[test]
    fn a_change_without_an_answer_is_not_called_harmless_to_repeat() {
        let cut = "HTTP/1.1 200 OK\r\nContent-Length: 50\r\nConnection: close\r\n\r\n{";
        for answer in ["", cut] {
            let body = Value::Object(serde_json::Map::new());
            let error = change(&answering(answer), Change::Post, "/v1/captures", "", Some(&body)).unwrap_err();
            assert!(matches!(error, ClientError::Unanswered { .. }), "{error}");
            assert!(error.to_string().contains("not known") && !error.to_string().contains("doubled"), "{error}");
            assert_eq!(error.failure(), crate::cli::Failure::InputOutput);
        }
    }

    #[test]
    fn a_file_that_becomes_shorter_while_it_is_sent_is_reported_as_such() {
        let base_url = breaking_off(0, "");
        let error = send(&base_url, "/v1/imports", &[], "", 1000, &[7_u8; 10][..]).unwrap_err();
        assert!(matches!(error, ClientError::Body(_)), "{error}");
        assert!(error.to_string().contains("shorter"), "{error}");
    }

    #[test]
    fn a_problem_is_reported_with_its_detail() {
        let base_url = answering(
            "HTTP/1.1 503 Service Unavailable\r\nContent-Length: 21\r\nConnection: close\r\n\r\n{\"detail\":\"too many\"}",
        );
        let error = get(&base_url, "/").unwrap_err();
        assert_eq!(error.to_string(), format!("the daemon at {base_url} answered 503: too many"));
        assert!(!error.is_unreachable());
    }
}
