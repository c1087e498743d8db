//! Share: live data for other programs beside the recording, which holds the serial port alone.
//!
//! In: the port's bytes and the decoded samples, from the recorder ([`ShareTap`]). Out: a byte-exact copy on a
//! pseudo-terminal ([`copy`]), and JSON lines on a Unix socket ([`lines`]). Promises: the recorder never waits for a
//! reader, nothing that a reader sends reaches the sensor, and no file of another program is replaced. Whatever a reader
//! misses is counted ([`ShareFigures`]). A folder that is missing does not end the daemon: the capture comes first.

mod backlog;
mod copy;
mod figures;
mod lines;

pub use backlog::LIMIT_BYTES;
pub use figures::ShareFigures;
pub use lines::CLIENTS_MAX;

use imu_core::sample::Sample;
use std::path::PathBuf;
use std::thread::JoinHandle;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// Reads of the port that may wait for the share's thread: more than a second at 800 Hz.
const QUEUE_READS: usize = 256;
/// Samples that may wait for the share's thread: five seconds at 800 Hz.
const QUEUE_SAMPLES: usize = 4096;

/// Where the live data is offered.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ShareOptions {
    /// The link to the terminal with the port's bytes, if it is wanted.
    pub link: Option<PathBuf>,
    /// The socket with the samples, if it is wanted.
    pub socket: Option<PathBuf>,
    /// The permissions of terminal and socket.
    pub mode: u32,
}

/// The reasons why nothing can be shared as configured.
#[derive(Debug, thiserror::Error)]
pub enum ShareError {
    /// Something else is in the link's place.
    #[error(
        "`share.link` is {path}, where there is something that is no link of vn100d: choose another path, or remove it"
    )]
    LinkOccupied {
        /// The path.
        path: String,
    },
    /// Something else is in the socket's place.
    #[error("`share.socket` is {path}, where there is something that is no socket: choose another path, or remove it")]
    SocketOccupied {
        /// The path.
        path: String,
    },
    /// Another program listens on the socket.
    #[error("`share.socket` is {path}, on which another program listens: choose another path, or stop that program")]
    SocketInUse {
        /// The path.
        path: String,
    },
    /// The thread could not be started.
    #[error("a thread for `[share]` cannot be started: {0}")]
    Thread(std::io::Error),
}

impl ShareError {
    /// Returns whether the configuration has to be changed, or something at its paths.
    pub fn is_configuration(&self) -> bool {
        !matches!(self, Self::Thread(_))
    }
}

/// The recorder's end: it takes bytes and samples, and never waits.
#[derive(Debug, Clone, Default)]
pub struct ShareTap {
    bytes: Option<mpsc::Sender<Vec<u8>>>,
    samples: Option<mpsc::Sender<Sample>>,
    figures: ShareFigures,
}

impl ShareTap {
    /// Takes bytes of the port. If they find no room they are dropped and counted.
    pub fn bytes(&self, bytes: &[u8]) {
        if let Some(queue) = &self.bytes
            && queue.try_send(bytes.to_vec()).is_err()
        {
            self.figures.counts.dropped_bytes.add(bytes.len() as u64);
        }
    }

    /// Takes a sample, if a client is there. If it finds no room it is dropped, and a line reports that.
    pub fn sample(&self, sample: &Sample) {
        let counts = &self.figures.counts;
        if let Some(queue) = self.samples.as_ref().filter(|_| counts.clients.get() > 0)
            && queue.try_send(sample.clone()).is_err()
        {
            counts.missed.add(1);
            counts.lost_lines.add(1);
        }
    }
}

/// The running share. When it is dropped, link and socket are removed.
#[derive(Debug)]
pub struct Share {
    tap: ShareTap,
    stop: CancellationToken,
    thread: Option<JoinHandle<()>>,
}

impl Share {
    /// Starts a thread that serves the readers, if anything is to be shared.
    ///
    /// # Errors
    /// [`ShareError`] if a path is taken by something else, or there is no thread.
    pub fn start(options: ShareOptions) -> Result<Self, ShareError> {
        let ShareOptions { link, socket, mode } = options;
        if let Some(path) = link.as_ref().filter(|path| !copy::is_free(path)) {
            return Err(ShareError::LinkOccupied { path: path.display().to_string() });
        }
        if let Some(found) = &socket {
            let path = found.display().to_string();
            match lines::look(found) {
                lines::Found::Free => {}
                lines::Found::InUse => return Err(ShareError::SocketInUse { path }),
                lines::Found::Other => return Err(ShareError::SocketOccupied { path }),
            }
        }
        let stop = CancellationToken::new();
        let shown = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
        let figures = ShareFigures { link: shown(&link), socket: shown(&socket), ..ShareFigures::default() };
        let mut tap = ShareTap { figures: figures.clone(), ..ShareTap::default() };
        if link.is_none() && socket.is_none() {
            return Ok(Self { tap, stop, thread: None });
        }
        let copying = link.map(|link| {
            let (sender, bytes) = mpsc::channel(QUEUE_READS);
            tap.bytes = Some(sender);
            copy::run(link, mode, bytes, figures.clone(), stop.clone())
        });
        let serving = socket.map(|socket| {
            let (sender, samples) = mpsc::channel(QUEUE_SAMPLES);
            tap.samples = Some(sender);
            lines::run(socket, mode, samples, figures, stop.clone())
        });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(ShareError::Thread)?;
        let work = async {
            let copying = async {
                if let Some(copying) = copying {
                    copying.await
                }
            };
            let serving = async {
                if let Some(serving) = serving {
                    serving.await
                }
            };
            tokio::join!(copying, serving);
        };
        let thread = std::thread::Builder::new().name("share".to_owned()).spawn(move || runtime.block_on(work));
        Ok(Self { tap, stop, thread: Some(thread.map_err(ShareError::Thread)?) })
    }

    /// Returns the recorder's end.
    pub fn tap(&self) -> ShareTap {
        self.tap.clone()
    }

    /// Returns the figures, if anything is shared.
    pub fn figures(&self) -> Option<ShareFigures> {
        self.thread.is_some().then(|| self.tap.figures.clone())
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.stop.cancel();
        if let Some(thread) = self.thread.take() {
            // Nothing in it waits. If it has panicked, the log has the reason.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests;
