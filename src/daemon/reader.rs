//! The reader's thread: the serial line is read by a thread and a runtime of its own, so that nothing that anybody asks of
//! the daemon stands in its way.

use super::DaemonError;
use crate::process::Priority;
use std::future::Future;
use tokio::sync::oneshot;

/// Runs the capture task on a thread of its own, ahead of others if the system allows it. The answer comes when it has ended.
///
/// # Errors
/// [`DaemonError::Reader`], if there can be no such thread or runtime.
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
        // Nobody waits for it if the daemon could not start.
        let _ = ended.send(());
    };
    std::thread::Builder::new().name("reader".to_owned()).spawn(read).map_err(DaemonError::Reader)?;
    Ok(end)
}
