//! Watchdog: reports to systemd that all is well, but only while reader and writer both advance.
//!
//! A timer that always fires proves nothing. The reader's loop turns every 200 ms whatever the sensor does; the
//! writer's turns every second at the latest. If one of the counters does not advance, the watchdog is not fed, and
//! systemd restarts the daemon.

use crate::store::Store;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// The writer turns every second: with a shorter interval its rest would count as a standstill.
const LEAST: Duration = Duration::from_secs(2);

/// Decides whether to feed the watchdog. Pure.
#[derive(Debug, Default)]
pub struct Judge {
    last: Option<(u64, u64)>,
}

impl Judge {
    /// Returns whether both counters have advanced since the last call (the first call returns `true`).
    pub fn is_alive(&mut self, reader: u64, writer: u64) -> bool {
        let alive = self.last.is_none_or(|(last_reader, last_writer)| reader != last_reader && writer != last_writer);
        self.last = Some((reader, writer));
        alive
    }
}

/// Feeds systemd's watchdog four times per interval, so that a stalled writer is noticed within 1.25 intervals; returns
/// at once if there is no watchdog. `reader` counts the turns of the reader's loop.
pub async fn feed(reader: Arc<AtomicU64>, store: Store, stop: CancellationToken) {
    let Some(interval) = sd_notify::watchdog_enabled() else { return };
    let mut judge = Judge::default();
    loop {
        if judge.is_alive(reader.load(Ordering::Relaxed), store.progress().ticks) {
            notify(&[sd_notify::NotifyState::Watchdog]);
        } else {
            tracing::error!("reader or writer stands still: the watchdog is not fed");
        }
        tokio::select! {
            () = tokio::time::sleep((interval / 4).max(LEAST)) => {}
            () = stop.cancelled() => return,
        }
    }
}

/// Messages that wait for systemd; further ones are dropped. A status line is dropped if [`STATUS_MAX`] wait, so that there is
/// room for what systemd acts on.
const WAITING_MAX: usize = 64;
const STATUS_MAX: usize = 4;

/// The number of messages that wait.
static WAITING: AtomicUsize = AtomicUsize::new(0);

/// Messages for systemd, for a thread of their own: a send blocks for as long as the manager does not read its socket.
static MESSAGES: LazyLock<Option<SyncSender<String>>> = LazyLock::new(|| {
    let (sender, messages) = sync_channel::<String>(WAITING_MAX);
    let send = move || {
        for message in messages {
            WAITING.fetch_sub(1, Ordering::Relaxed);
            if let Err(error) = sd_notify::notify(&[sd_notify::NotifyState::Custom(&message)]) {
                tracing::debug!(%error, "systemd was not notified");
            }
        }
    };
    std::thread::Builder::new().name("systemd".to_owned()).spawn(send).is_ok().then_some(sender)
});

/// Notifies systemd, and returns at once; without systemd nothing happens.
pub fn notify(states: &[sd_notify::NotifyState<'_>]) {
    if std::env::var_os("NOTIFY_SOCKET").is_none() {
        return;
    }
    let lines: Vec<String> = states.iter().map(ToString::to_string).collect();
    let is_status = matches!(states, [sd_notify::NotifyState::Status(_)]);
    let waiting = WAITING.fetch_add(1, Ordering::Relaxed);
    let is_wanted = !is_status || waiting < STATUS_MAX;
    let queued = MESSAGES.as_ref().filter(|_| is_wanted).map(|messages| messages.try_send(lines.join("\n")));
    if !matches!(queued, Some(Ok(()))) {
        WAITING.fetch_sub(1, Ordering::Relaxed);
        tracing::debug!("a message to systemd was dropped: too many wait");
    }
}

/// Reports to systemd that the daemon reads its configuration again. [`notify`] with `Ready` ends that.
pub fn reloading() {
    if let Ok(now) = sd_notify::NotifyState::monotonic_usec_now() {
        notify(&[sd_notify::NotifyState::Reloading, now]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_watchdog_is_fed_only_while_both_move() {
        let mut judge = Judge::default();
        assert!(judge.is_alive(0, 0));
        assert!(judge.is_alive(1, 1));
        assert!(!judge.is_alive(1, 2));
        assert!(!judge.is_alive(2, 2));
        assert!(judge.is_alive(3, 3));
    }
}
