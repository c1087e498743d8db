//! Asking the running daemon over HTTP, for the commands that do.

use serde_json::Value;
use std::io::{self, Write};
use std::time::Duration;

/// How long an answer may take: the daemon answers from memory or says within 10 s that it cannot.
const PATIENCE: Duration = Duration::from_secs(12);
/// Bytes of an answer at most.
const ANSWER_BYTES: u64 = 16 << 20;

/// Why the daemon gave no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// Nobody answers there: exit code 69.
    #[error("no daemon answers at {base_url}: {reason}; start it with `vn100d run`, or name its address with --listen")]
    Unreachable {
        /// Where it was looked for.
        base_url: String,
        /// What the connection said.
        reason: String,
    },
    /// It answered with a problem.
    #[error("the daemon at {base_url} answered {status}: {detail}")]
    Refused {
        /// Where.
        base_url: String,
        /// The status code.
        status: u16,
        /// What it said.
        detail: String,
    },
    /// Something else than the daemon answered.
    #[error("what answers at {base_url} is not a vn100d: {reason}")]
    Foreign {
        /// Where.
        base_url: String,
        /// What is wrong with the answer.
        reason: String,
    },
    /// The answer could not be written out.
    #[error("cannot write to standard output: {0}")]
    Output(#[from] io::Error),
}

impl ClientError {
    /// Which exit code.
    pub(super) fn failure(&self) -> super::Failure {
        match self {
            Self::Unreachable { .. } => super::Failure::Unreachable,
            // The disk behind it is full or fails.
            Self::Refused { status: 503, .. } => super::Failure::InputOutput,
            _ => super::Failure::Other,
        }
    }

    /// Whether nobody answers: exit code 69.
    #[must_use]
    pub fn is_unreachable(&self) -> bool {
        matches!(self, Self::Unreachable { .. })
    }
}

/// The JSON that the daemon at `base_url` (`http://127.0.0.1:8100`) answers to `GET path`.
///
/// # Errors
/// [`ClientError`].
pub fn get(base_url: &str, path: &str) -> Result<Value, ClientError> {
    let base_url = base_url.trim_end_matches('/');
    let agent = ureq::Agent::config_builder()
        .http_status_as_error(false)
        .timeout_global(Some(PATIENCE))
        .max_redirects(0)
        .proxy(None)
        .build()
        .new_agent();
    let unreachable =
        |error: ureq::Error| ClientError::Unreachable { base_url: base_url.to_owned(), reason: error.to_string() };
    let response =
        agent.get(format!("{base_url}{path}")).header("accept", "application/json").call().map_err(unreachable)?;
    read(base_url, response)
}

/// The JSON that the daemon answers to `POST path` with a body of `length` bytes, however long it takes.
///
/// # Errors
/// [`ClientError`].
pub(super) fn send(
    base_url: &str,
    path: &str,
    query: &[(&str, String)],
    token: &str,
    length: u64,
    body: &mut dyn io::Read,
) -> Result<Value, ClientError> {
    let base_url = base_url.trim_end_matches('/');
    let agent = ureq::Agent::config_builder()
        .http_status_as_error(false)
        .timeout_connect(Some(PATIENCE))
        .max_redirects(0)
        .proxy(None)
        .build()
        .new_agent();
    // The daemon is asked before the first byte is sent: a refusal would be lost behind bytes that nobody reads.
    let mut request = agent
        .post(format!("{base_url}{path}"))
        .header("accept", "application/json")
        .header("content-type", "application/octet-stream")
        .header("content-length", length.to_string())
        .header("expect", "100-continue");
    for (name, value) in query {
        request = request.query(name, value);
    }
    if !token.is_empty() {
        request = request.header("authorization", format!("Bearer {token}"));
    }
    let response = request
        .send(ureq::SendBody::from_reader(body))
        .map_err(|error| ClientError::Unreachable { base_url: base_url.to_owned(), reason: error.to_string() })?;
    read(base_url, response)
}

fn read(base_url: &str, mut response: ureq::http::Response<ureq::Body>) -> Result<Value, ClientError> {
    let unreachable =
        |error: ureq::Error| ClientError::Unreachable { base_url: base_url.to_owned(), reason: error.to_string() };
    let foreign = |reason: String| ClientError::Foreign { base_url: base_url.to_owned(), reason };
    let status = response.status().as_u16();
    let text = response.body_mut().with_config().limit(ANSWER_BYTES).read_to_string().map_err(unreachable)?;
    let body: Value = serde_json::from_str(&text).map_err(|error| foreign(format!("no JSON ({error})")))?;
    if (200..300).contains(&status) {
        return Ok(body);
    }
    match body.get("detail").and_then(Value::as_str) {
        Some(detail) => Err(ClientError::Refused { base_url: base_url.to_owned(), status, detail: detail.to_owned() }),
        None => Err(foreign(format!("status {status} without a problem document"))),
    }
}

/// Writes `text` and a line's end to standard output; a reader that has gone is no error.
///
/// # Errors
/// What the system says.
pub fn print(text: &str) -> Result<(), ClientError> {
    match writeln!(io::stdout().lock(), "{}", text.trim_end()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        outcome => Ok(outcome?),
    }
}

/// A value of an answer as a person reads it; `–` where it is absent.
pub(super) fn shown(value: &Value) -> String {
    match value {
        Value::Null => "–".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};

    /// A server that answers one request with these bytes.
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
    fn nobody_there_is_told_from_somebody_else() {
        // A port that was free a moment ago.
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let base_url = format!("http://{}", listener.local_addr().unwrap());
        drop(listener);
        let error = get(&base_url, "/v1/status").unwrap_err();
        assert!(error.is_unreachable(), "{error}");
        let other = answering("HTTP/1.1 200 OK\r\nContent-Length: 5\r\nConnection: close\r\n\r\nhello");
        assert!(matches!(get(&other, "/"), Err(ClientError::Foreign { .. })));
    }

    #[test]
    fn a_problem_is_told_with_its_detail() {
        let base_url = answering(
            "HTTP/1.1 503 Service Unavailable\r\nContent-Length: 21\r\nConnection: close\r\n\r\n{\"detail\":\"too many\"}",
        );
        let error = get(&base_url, "/").unwrap_err();
        assert_eq!(error.to_string(), format!("the daemon at {base_url} answered 503: too many"));
        assert!(!error.is_unreachable());
    }
}
