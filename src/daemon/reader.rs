//! The reader's thread: a separate thread and runtime read the serial line, so that no request to the daemon delays it.

use super::DaemonError;
use crate::process::Priority;
use std::future::Future;
use tokio::sync::oneshot;

/// Runs the capture task on a separate thread, ahead of others if the system allows it. The returned channel receives a
/// message when it has ended.
///
/// # Errors
/// [`DaemonError::Reader`] if the thread or the runtime cannot be created.
pub(super) fn start(task: impl Future<Output = ()> + Send + 'static) -> Result<oneshot::Receiver<()>, DaemonError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(DaemonError::Reader)?;
    let (ended, end) = oneshot::channel();
    let read = move || {
        match crate::process::hurry() {
            Priority::RealTime => tracing::debug!("The reader has a real-time priority."),
            Priority::Nice => tracing::info!(
                "The reader runs at nice -10: the system allows it no real-time priority (LimitRTPRIO=1), and beside a busy \
                 service it may be late."
            ),
            Priority::Ordinary => tracing::info!(
                "The reader has the priority of every other thread: the system allows it no higher one (LimitRTPRIO=1), and on \
                 a busy machine it may be late."
            ),
        }
        runtime.block_on(task);
        // No one waits for it if the daemon could not start.
        let _ = ended.send(());
    };
    std::thread::Builder::new().name("reader".to_owned()).spawn(read).map_err(DaemonError::Reader)?;
    Ok(end)
}
