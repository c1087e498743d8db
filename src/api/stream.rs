//! A body that a thread fills while it is sent: the thread waits when the other side reads slowly, and learns when the
//! other side has gone.

use axum::body::{Body, Bytes};
use hyper::body::Frame;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::sync::mpsc;

/// Pieces on their way at once.
const PIECES: usize = 2;

/// The end that the thread writes to.
pub(super) type Pieces = mpsc::Sender<io::Result<Bytes>>;

/// Both ends.
pub(super) fn channel() -> (Pieces, Body) {
    let (sender, receiver) = mpsc::channel(PIECES);
    (sender, Body::new(Stream(receiver)))
}

struct Stream(mpsc::Receiver<io::Result<Bytes>>);

impl hyper::body::Body for Stream {
    type Data = Bytes;
    type Error = io::Error;

    /// An error piece ends the connection, so that nobody takes the part for the whole.
    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.0.poll_recv(context).map(|piece| piece.map(|piece| piece.map(Frame::data)))
    }
}
