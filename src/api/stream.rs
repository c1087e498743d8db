//! A body that a thread fills while it is sent: the thread waits if the other side reads slowly, and is notified when
//! the other side has gone; and the mark of an answer with such a body.

use axum::body::{Body, Bytes};
use hyper::body::Frame;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::sync::mpsc;

/// Maximum number of pieces under way.
const PIECES: usize = 2;

/// Marks an answer that is made while it is sent. It is not compressed, because that would take a core from the
/// capture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Streamed;

/// The sending end, for the thread.
pub(super) type Pieces = mpsc::Sender<io::Result<Bytes>>;

/// Creates both ends.
pub(super) fn channel() -> (Pieces, Body) {
    let (sender, receiver) = mpsc::channel(PIECES);
    (sender, Body::new(Stream(receiver)))
}

struct Stream(mpsc::Receiver<io::Result<Bytes>>);

impl hyper::body::Body for Stream {
    type Data = Bytes;
    type Error = io::Error;

    /// An error piece ends the connection, so that a part is not taken for the whole.
    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.0.poll_recv(context).map(|piece| piece.map(|piece| piece.map(Frame::data)))
    }
}
