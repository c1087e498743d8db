//! Notices: sets up the notifications, and reports captures that complete.

use crate::config::Config;
use crate::notify::deliver::Receiver;
use crate::notify::notice::{CaptureFacts, Sender};
use crate::notify::watch::WatchOptions;
use crate::notify::worker::Effort;
use crate::notify::{NotifyOptions, Tap};
use crate::observe::Status;
use crate::store::{CaptureState, Store};
use std::path::Path;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// The time for an ended capture's last samples to reach the disk before its notification is dropped.
const PATIENCE: Duration = Duration::from_secs(3600);

/// Returns the configured recipients and topics.
pub fn options(config: &Config, database: &Path) -> NotifyOptions {
    let notify = &config.notify;
    let mut receivers = Vec::new();
    if !notify.command.is_empty() {
        receivers.push(Receiver::Command(notify.command.clone()));
    }
    if !notify.url.is_empty() {
        receivers.push(Receiver::Url { url: notify.url.secret().to_owned(), shown: notify.url.to_string() });
    }
    NotifyOptions {
        receivers,
        events: notify.events.clone(),
        coalesce: notify.coalesce,
        watch: WatchOptions {
            sensor_lost_after: notify.sensor_lost_after,
            reserve_bytes: config.storage.reserve_bytes(),
        },
        effort: Effort { attempts: notify.attempts, timeout: notify.timeout, retry_after: notify.retry_after },
        sender: Sender {
            host: rustix::system::uname().nodename().to_string_lossy().into_owned(),
            database: database.display().to_string(),
        },
    }
}

/// Reports each capture that leaves the status because it is complete, once its last sample is on disk. Runs until
/// `stop`.
pub async fn report_ends(store: Store, tap: Tap, mut status: watch::Receiver<Status>, stop: CancellationToken) {
    if !tap.has_receiver() {
        return;
    }
    let mut running = None;
    loop {
        let now = status.borrow_and_update().capture.as_ref().map(|capture| capture.id);
        if let Some(ended) = std::mem::replace(&mut running, now).filter(|before| Some(*before) != now) {
            tokio::spawn(report_end(store.clone(), tap.clone(), ended));
        }
        tokio::select! {
            () = stop.cancelled() => return,
            changed = status.changed() => {
                if changed.is_err() {
                    return;
                }
            }
        }
    }
}

async fn report_end(store: Store, tap: Tap, id: i64) {
    // A disk that refuses writes leaves the end in memory; it is reported when it can be looked up.
    if !matches!(tokio::time::timeout(PATIENCE, store.flush()).await, Ok(Ok(()))) {
        return;
    }
    match store.offload(move |store| store.reader()?.capture(id)).await {
        Ok(row) if row.state == CaptureState::Complete => tap.completed(CaptureFacts {
            id,
            name: row.name,
            state: row.state.name().to_owned(),
            duration_s: row.duration_s,
            samples: row.samples,
            missing: row.missing,
            gaps: row.gaps,
        }),
        // A user stopped or deleted it.
        Ok(_) => {}
        Err(error) => tracing::warn!(capture = id, %error, "its end is not told"),
    }
}
