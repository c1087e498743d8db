//! Aside: bodies that may be large go into a file beside the database, one piece in memory at a time.

use super::problem::{ApiError, ProblemType};
use super::state::ApiState;
use axum::body::Body;
use hyper::body::Body as _;
use std::path::Path;
use std::pin::Pin;
use std::time::{Duration, Instant};
use tokio::io::AsyncWriteExt;

/// Maximum number of bytes taken per second: the capture has priority on the disk.
const BYTES_PER_S: f64 = 64.0 * 1024.0 * 1024.0;
/// Bytes that must come within [`PATIENCE`].
const PROGRESS_BYTES: u64 = 64 * 1024;
/// Maximum time for which a body may stand still.
const PATIENCE: Duration = Duration::from_secs(30);
/// Number of received bytes after which free space is checked again.
const LOOK_BYTES: u64 = 8 << 20;
/// The part of a body that may stay in the kernel's memory. What waits there for the disk counts as the unit's memory:
/// at its limit the reader, too, has to wait for the disk when it needs a page.
const CACHED_BYTES: u64 = 64 << 20;

/// The kind of a body, in the sender's words, and its limits.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kind {
    /// Its name, such as `a recording`.
    pub(super) called: &'static str,
    /// Maximum number of bytes.
    pub(super) bytes_max: u64,
    /// Maximum total time, if others wait for it.
    pub(super) time_max: Option<Duration>,
}

impl Kind {
    /// Stores a body in a file, which is removed when the returned value is dropped.
    ///
    /// # Errors
    /// [`ApiError`]: 413 beyond the limit, 408 for a body that does not arrive, 503 if there is no room or on
    /// `stopping`, 400 for a body that ends early or is empty.
    pub(super) async fn put(
        self,
        state: &ApiState,
        body: Body,
        stopping: impl Fn() -> Result<(), ApiError>,
    ) -> Result<tempfile::NamedTempFile, ApiError> {
        self.room_for(state, body.size_hint().lower())?;
        let folder = state.parts.store.path().parent().unwrap_or(Path::new(".")).to_owned();
        let aside = tokio::task::spawn_blocking(move || {
            tempfile::Builder::new().prefix(crate::control::IMPORT_PREFIX).tempfile_in(folder)
        });
        let aside = aside.await.map_err(|error| ApiError::internal(error.to_string()))?;
        let aside = aside.map_err(|error| self.no_room(&error))?;
        let reopened = aside.reopen().map_err(|error| self.no_room(&error))?;
        self.receive(state, body, tokio::fs::File::from_std(reopened), stopping).await?;
        Ok(aside)
    }

    /// Writes the body to the file, at the disk's pace and no faster than [`BYTES_PER_S`].
    async fn receive(
        self,
        state: &ApiState,
        mut body: Body,
        mut file: tokio::fs::File,
        stopping: impl Fn() -> Result<(), ApiError>,
    ) -> Result<(), ApiError> {
        let begun = Instant::now();
        let (mut received, mut looked) = (0_u64, 0_u64);
        let (mut window, mut in_window) = (Instant::now(), 0_u64);
        loop {
            let next = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context));
            let frame = match tokio::time::timeout(PATIENCE, next).await {
                Err(_) => return Err(self.too_slow()),
                Ok(None) => break,
                Ok(Some(Err(error))) => return Err(ApiError::bad_request(format!("the body ended early: {error}"))),
                Ok(Some(Ok(frame))) => frame,
            };
            stopping()?;
            if self.time_max.is_some_and(|time| begun.elapsed() > time) {
                let time = self.time_max.unwrap_or_default().as_secs();
                return Err(ApiError::body_timeout(format!("{} must come within {time} s", self.called)));
            }
            let Ok(bytes) = frame.into_data() else { continue };
            received += bytes.len() as u64;
            in_window += bytes.len() as u64;
            if window.elapsed() > PATIENCE {
                if in_window < PROGRESS_BYTES {
                    return Err(self.too_slow());
                }
                (window, in_window) = (Instant::now(), 0);
            }
            if received >= looked + LOOK_BYTES {
                looked = received;
                self.room_for(state, 0)?;
                if received > CACHED_BYTES {
                    file.sync_data().await.map_err(|error| self.no_room(&error))?;
                    // A file system without such a cache refuses.
                    let _ = rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed);
                    // The disk's time is not the sender's.
                    (window, in_window) = (Instant::now(), 0);
                }
            }
            if received > self.bytes_max {
                return Err(self.too_large());
            }
            file.write_all(&bytes).await.map_err(|error| self.no_room(&error))?;
            let due = Duration::from_secs_f64(received as f64 / BYTES_PER_S);
            tokio::time::sleep(due.saturating_sub(begun.elapsed())).await;
        }
        if received == 0 {
            return Err(ApiError::bad_request(format!("the body is empty: expected {}", self.called)));
        }
        file.flush().await.map_err(|error| self.no_room(&error))
    }

    /// Checks whether this many more bytes leave the reserve untouched.
    pub(super) fn room_for(self, state: &ApiState, bytes: u64) -> Result<(), ApiError> {
        if bytes > self.bytes_max {
            return Err(self.too_large());
        }
        let free_bytes = state.status().storage.free_bytes;
        if free_bytes < state.parts.reserve_bytes.saturating_add(bytes) {
            return Err(ApiError::unavailable(
                format!(
                    "{} MiB are free and {} MiB are kept for captures: make room for {} MiB and try again",
                    free_bytes >> 20,
                    state.parts.reserve_bytes >> 20,
                    bytes >> 20
                ),
                60,
            ));
        }
        Ok(())
    }

    fn too_large(self) -> ApiError {
        let (called, bytes) = (self.called, self.bytes_max);
        let most = if bytes >= 1 << 30 { format!("{} GiB", bytes >> 30) } else { format!("{} MiB", bytes >> 20) };
        ApiError::new(ProblemType::TooLarge, format!("{called} has at most {most}"))
    }

    fn too_slow(self) -> ApiError {
        let (bytes, time) = (PROGRESS_BYTES >> 10, PATIENCE.as_secs());
        let reason = format!("less than {bytes} KiB came within {time} s: send {} again", self.called);
        ApiError::body_timeout(reason)
    }

    fn no_room(self, error: &std::io::Error) -> ApiError {
        ApiError::unavailable(format!("{} cannot be put aside beside the database: {error}", self.called), 60)
    }
}
