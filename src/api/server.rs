//! The accept loop: hyper's HTTP/1 under limits that `axum::serve` has not (a header's time, the number of connections,
//! a reader that stops reading), and an orderly end.

use super::connection::Guarded;
use crate::observe::Metrics;
use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// What the server lets others do to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Connections at once; one more is answered 503 and closed.
    pub connections: usize,
    /// How long a request's head may take, and how long a connection may stay idle between requests.
    pub header: Duration,
    /// How long a write may stand still because the other side does not read.
    pub write_stall: Duration,
    /// How long an answer may take until its head is sent.
    pub answer: Duration,
    /// Streams of samples at once, each some MiB; one more is answered 429 without waiting for a turn.
    pub streams: usize,
    /// Computations at once: analyses of a running capture, pictures, pages; one more waits up to [`Self::turn`], and is then
    /// answered 429.
    pub computations: usize,
    /// How long a computation waits for its turn.
    pub turn: Duration,
    /// Other queries at once; one more waits for its turn.
    pub light_queries: usize,
    /// How long requests under way may take at the end.
    pub farewell: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 1024,
            header: Duration::from_secs(5),
            write_stall: Duration::from_secs(30),
            answer: Duration::from_secs(10),
            streams: 4,
            computations: 2,
            turn: Duration::from_secs(5),
            light_queries: 16,
            farewell: Duration::from_secs(5),
        }
    }
}

/// Files that capture, store and jobs may have open at once; what they need is never left to connections.
const OWN_FILES: u64 = 40;
/// Files that a reader of the database has open: file, log, shared memory.
const READER_FILES: u64 = 3;

impl Limits {
    /// The usual limits, or smaller ones where the process may have few files open: a connection too many is refused
    /// before the sensor's port or the database could not be opened again.
    pub fn fitting(open_files: u64) -> Self {
        let usual = Self::default();
        let left = open_files.saturating_sub(OWN_FILES);
        let queries = (left / (4 * READER_FILES)).clamp(1, usual.light_queries as u64);
        // A refused connection has a file too, for as long as it takes to say so.
        let connections = left.saturating_sub(2 * queries * READER_FILES + 4).clamp(4, usual.connections as u64);
        Self {
            connections: connections as usize,
            streams: usual.streams.min(queries as usize),
            computations: usual.computations.min(queries as usize),
            light_queries: queries as usize,
            ..usual
        }
    }
}

/// Bytes of a request's head at most.
const HEAD_BYTES: usize = 16 * 1024;
/// Pause after an accept that failed for want of file descriptors: closing connections make room.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// How long a refusal may take.
const REFUSAL: Duration = Duration::from_secs(1);
/// The answer to a connection too many.
const FULL: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 5\r\nConnection: close\r\nContent-Length: 0\r\n\r\n";

/// Serves `router` on `listener` until `stop` is cancelled, then ends: no new connections, requests under way have
/// [`Limits::farewell`].
pub async fn serve(
    listener: TcpListener,
    router: Router,
    limits: Limits,
    metrics: Arc<Metrics>,
    stop: CancellationToken,
) {
    let connections = TaskTracker::new();
    let abort = CancellationToken::new();
    let mut failing = false;
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => break,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                metrics.accept_failed();
                if !failing {
                    tracing::warn!(%error, "No connection can be accepted now.");
                }
                failing = true;
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        failing = false;
        if connections.len() >= limits.connections {
            metrics.connection_refused();
            tokio::spawn(refuse(stream));
            continue;
        }
        let (router, metrics) = (router.clone(), Arc::clone(&metrics));
        let (stop, abort) = (stop.clone(), abort.clone());
        connections.spawn(async move {
            metrics.connection_opened();
            tokio::select! {
                () = connection(stream, router, limits, stop) => {}
                () = abort.cancelled() => {}
            }
            metrics.connection_closed();
        });
    }
    drop(listener);
    connections.close();
    if tokio::time::timeout(limits.farewell, connections.wait()).await.is_err() {
        tracing::info!(connections = connections.len(), "Connections that did not end in time are closed.");
        abort.cancel();
        connections.wait().await;
    }
}

/// Answers with a few bytes, for which no buffer is full, and closes.
async fn refuse(mut stream: TcpStream) {
    if !matches!(tokio::time::timeout(REFUSAL, stream.write_all(FULL)).await, Ok(Ok(()))) {
        tracing::debug!("A refused connection was closed without an answer.");
    }
}

async fn connection(stream: TcpStream, router: Router, limits: Limits, stop: CancellationToken) {
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "A connection has no TCP_NODELAY.");
    }
    let io = TokioIo::new(Guarded::new(stream, limits.write_stall));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.header)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(io, TowerToHyperService::new(router));
    let mut connection = std::pin::pin!(connection);
    let outcome = tokio::select! {
        outcome = connection.as_mut() => outcome,
        () = stop.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = outcome {
        tracing::debug!(%error, "A connection ended before its time.");
    }
}
