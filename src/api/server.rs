//! The accept loop: hyper's HTTP/1 with limits that `axum::serve` lacks (time of a header, number of connections,
//! readers that stop reading), and an orderly end.

use super::connection::Guarded;
use crate::observe::Metrics;
use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// The limits for clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Maximum number of connections; one more is answered 503 and closed.
    pub connections: usize,
    /// Maximum time for a request's head, and for an idle connection between requests.
    pub header: Duration,
    /// Maximum time for which a write may stand still because the other side does not read.
    pub write_stall: Duration,
    /// Maximum time until an answer's head is sent.
    pub answer: Duration,
    /// Maximum number of streams of samples, each some MiB; one more is answered 429 at once.
    pub streams: usize,
    /// Maximum number of computations: analyses of a running capture, pictures, pages; one more waits up to
    /// [`Self::turn`], and is then answered 429.
    pub computations: usize,
    /// Maximum time for which a computation waits for its turn.
    pub turn: Duration,
    /// Maximum number of other queries; one more waits for its turn.
    pub light_queries: usize,
    /// Memory that the bodies and answers of all connections take together, in bytes.
    pub held_bytes: usize,
    /// Time for running requests at the end.
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
            held_bytes: 8 << 20,
            farewell: Duration::from_secs(1),
        }
    }
}

/// Number of files reserved for capture, store and jobs; connections never use them.
const OWN_FILES: u64 = 40;
/// Number of files that a reader of the database has open: file, log, shared memory.
const READER_FILES: u64 = 3;

impl Limits {
    /// Returns the usual limits, or smaller ones if the process may have few files open: a surplus connection must be
    /// refused before the sensor's port or the database could not be opened again.
    pub fn fitting(open_files: u64) -> Self {
        let usual = Self::default();
        let left = open_files.saturating_sub(OWN_FILES);
        let queries = (left / (4 * READER_FILES)).clamp(1, usual.light_queries as u64);
        // A refused connection has a file too, until the refusal is sent.
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

/// Maximum size of a request's head in bytes.
const HEAD_BYTES: usize = 16 * 1024;
/// Pause after an accept that failed for lack of file descriptors: closing connections make room.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Maximum time for a refusal.
const REFUSAL: Duration = Duration::from_secs(1);
/// Bytes that the kernel keeps for a client that does not read. Its own choice is up to 4 MiB, which a service pays for,
/// and which takes seconds to fill for a crowd.
const UNREAD_BYTES: u32 = 128 * 1024;
/// Number of connections that wait to be accepted.
const BACKLOG: u32 = 1024;
/// The answer to a surplus connection.
const FULL: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 5\r\nConnection: close\r\nContent-Length: 0\r\n\r\n";

/// Returns a listener whose connections hold few unread bytes in the kernel.
///
/// # Errors
/// The system's error if the address cannot be used.
pub fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    socket.set_reuseaddr(true)?;
    socket.set_send_buffer_size(UNREAD_BYTES)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Serves `router` on `listener` until `stop` is cancelled, then ends: no new connections are accepted, and running
/// requests have [`Limits::farewell`].
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

/// Answers with a few bytes, which always fit a buffer, and closes.
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
