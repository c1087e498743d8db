//! A connection whose reader must keep reading: if writing makes too little progress for a while, it fails, which ends
//! the connection, the stream and its query.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Instant, Sleep};

/// Minimum number of bytes that a slow reader must take within the patience: a reader of one byte a second would
/// otherwise hold a query for days.
const PROGRESS_BYTES: usize = 16 * 1024;

/// A TCP connection on which a write may stand still for at most `patience`.
#[derive(Debug)]
pub(super) struct Guarded {
    stream: TcpStream,
    patience: Duration,
    stalled: Option<Stall>,
}

/// The state since the writer was last held up.
#[derive(Debug)]
struct Stall {
    alarm: Pin<Box<Sleep>>,
    moved: usize,
}

impl Guarded {
    pub(super) fn new(stream: TcpStream, patience: Duration) -> Self {
        Self { stream, patience, stalled: None }
    }

    /// Watches a write: one that is not ready sets the alarm, enough bytes clear it, and once it has gone off, writing
    /// fails.
    fn watch(&mut self, context: &mut Context<'_>, write: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        match (&write, &mut self.stalled) {
            (Poll::Ready(Ok(bytes)), Some(stall)) => {
                stall.moved += bytes;
                if stall.moved >= PROGRESS_BYTES {
                    self.stalled = None;
                }
                return write;
            }
            (Poll::Ready(_), _) => return write,
            (Poll::Pending, _) => {}
        }
        let patience = self.patience;
        let stall = self.stalled.get_or_insert_with(|| Stall {
            alarm: Box::pin(tokio::time::sleep_until(Instant::now() + patience)),
            moved: 0,
        });
        match stall.alarm.as_mut().poll(context) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncRead for Guarded {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Guarded {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let write = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.watch(context, write)
    }
    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffers: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let write = Pin::new(&mut self.stream).poll_write_vectored(context, buffers);
        self.watch(context, write)
    }
    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        // All data was passed on: the next write starts with a clear alarm.
        self.stalled = None;
        Pin::new(&mut self.stream).poll_flush(context)
    }
    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
