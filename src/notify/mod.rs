//! Notifications: a message is sent when a capture completes, a gap opens or closes, storage runs low, or the sensor is
//! lost.
//!
//! In: status snapshots and the records of the capture ([`Tap`]). Out: a program run or a JSON posted per [`Notice`].
//! Pure parts: which events are reported ([`watch`]) and how often ([`coalesce`]). Each receiver has a separate thread
//! and a bounded queue ([`worker`]): one that hangs or fails costs its own messages and nothing else, least of all a
//! sample. Guarantees: each attempt ends within its time, with every process it started. Each message is tried a
//! bounded number of times. Messages that are abandoned or do not fit are counted and logged. Not guaranteed: that a
//! message survives the daemon's end. A client that must know for certain that the daemon is alive requests `/readyz`.

pub mod coalesce;
pub mod deliver;
pub mod notice;
pub mod watch;
pub mod worker;

pub use notice::{CaptureFacts, NightFacts, Notice};

use crate::clock::Clock;
use crate::observe::{NotifyEvent, NotifyStatus, PlannedDeletion, Status};
use coalesce::Coalescer;
use deliver::Receiver;
use imu_core::sample::Gap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch as channel};
use tokio_util::sync::CancellationToken;
use watch::{Sign, WatchOptions, Watcher};
use worker::Worker;

/// The maximum number of signs from the capture that wait to be processed.
const TAP: usize = 256;

/// The receivers and events of notifications.
#[derive(Debug, Clone)]
pub struct NotifyOptions {
    /// The receivers.
    pub receivers: Vec<Receiver>,
    /// The reported events.
    pub events: Vec<NotifyEvent>,
    /// The interval after which the same event is reported again.
    pub coalesce: Duration,
    /// The limits for lost and low.
    pub watch: WatchOptions,
    /// The attempts for one message.
    pub effort: worker::Effort,
    /// The sender in every message.
    pub sender: notice::Sender,
}

/// Receives the observations of other modules; never waits, cheap to clone. Without receivers it discards everything.
#[derive(Debug, Clone, Default)]
pub struct Tap(Option<mpsc::Sender<Sign>>);

impl Tap {
    fn put(&self, sign: Sign) {
        // The queue is full during many gaps: the status still counts them.
        let _ = self.0.as_ref().map(|sender| sender.try_send(sign));
    }
    /// Returns whether there is a receiver.
    pub fn has_receiver(&self) -> bool {
        self.0.is_some()
    }
    /// Reports that a gap was recorded: it is closed.
    pub fn gap(&self, capture_id: i64, gap: &Gap) {
        if self.has_receiver() {
            self.put(Sign::Gap(capture_id, gap.clone()));
        }
    }
    /// Reports that a capture is complete and on disk.
    pub fn completed(&self, capture: CaptureFacts) {
        self.put(Sign::Ended(capture));
    }
    /// Reports that deletions of captures are planned.
    pub fn deletions(&self, planned: Vec<PlannedDeletion>) {
        self.put(Sign::Deletions(planned));
    }
    /// Reports that a night of the schedule was not recorded: the name that it would have had, and the reason.
    pub fn night_skipped(&self, name: String, reason: String) {
        self.put(Sign::Skipped(NightFacts { name, reason }));
    }
}

/// The notifications of a daemon. It is created first, so that other modules have its [`Tap`]; then it runs.
#[derive(Debug)]
pub struct Notifier {
    options: NotifyOptions,
    signs: mpsc::Receiver<Sign>,
    tap: Tap,
    workers: Vec<Worker>,
}

/// The state of the notifications, from memory; cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct NotifyFigures(Vec<Arc<worker::Figures>>);

impl NotifyFigures {
    /// Returns the sum over all receivers.
    pub fn status(&self) -> NotifyStatus {
        let mut sum = NotifyStatus::default();
        for figures in &self.0 {
            let own = figures.lock();
            sum.sent += own.sent;
            sum.failed += own.failed;
            sum.dropped += own.dropped;
            sum.queued += own.queued;
            sum.error = sum.error.or_else(|| own.error.clone());
        }
        sum
    }
}

impl Notifier {
    /// Starts one worker per receiver.
    ///
    /// # Errors
    /// The error that the system reports if a thread cannot be started.
    pub fn start(options: NotifyOptions) -> std::io::Result<Self> {
        let (sender, signs) = mpsc::channel(TAP);
        let tap = Tap((!options.receivers.is_empty()).then_some(sender));
        let workers = options
            .receivers
            .iter()
            .map(|receiver| Worker::start(receiver.clone(), options.effort))
            .collect::<std::io::Result<_>>()?;
        Ok(Self { options, signs, tap, workers })
    }

    /// Returns the tap for the observations of other modules.
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }

    /// Returns the state of the notifications.
    pub fn figures(&self) -> NotifyFigures {
        NotifyFigures(self.workers.iter().map(Worker::figures).collect())
    }

    /// Watches and reports until `stop`; then held notices are reported, in the short time that an ending daemon has.
    pub async fn run(mut self, mut status: channel::Receiver<Status>, clock: Arc<dyn Clock>, stop: CancellationToken) {
        if self.workers.is_empty() {
            return;
        }
        self.tap = Tap::default();
        let mut watcher = Watcher::new(self.options.watch.clone());
        let mut coalescer = Coalescer::new(self.options.coalesce);
        loop {
            let now_ns = clock.mono_ns();
            let due = coalescer.due(now_ns);
            self.dispatch(due);
            let wait = coalescer.deadline_ns().map_or(Duration::from_secs(3600), |deadline_ns| {
                clock.real(Duration::from_nanos(deadline_ns.saturating_sub(now_ns)))
            });
            let notices = tokio::select! {
                () = stop.cancelled() => break,
                () = tokio::time::sleep(wait) => continue,
                changed = status.changed() => {
                    if changed.is_err() {
                        break;
                    }
                    let seen = status.borrow_and_update().clone();
                    watcher.observe(clock.mono_ns(), clock.utc_ns(), &seen)
                }
                sign = self.signs.recv() => match sign {
                    Some(sign) => watcher.sign(clock.utc_ns(), sign),
                    None => break,
                },
            };
            for notice in notices {
                if self.options.events.contains(&notice.event)
                    && let Some(notice) = coalescer.offer(clock.mono_ns(), notice)
                {
                    self.dispatch(vec![notice]);
                }
            }
        }
        let held = coalescer.due(u64::MAX);
        self.dispatch(held);
        let workers = std::mem::take(&mut self.workers);
        // Waiting for the threads blocks, so it is done on a thread for blocking work.
        let _ = tokio::task::spawn_blocking(move || Worker::stop(workers)).await;
    }

    fn dispatch(&self, notices: Vec<Notice>) {
        for notice in notices {
            tracing::info!(event = notice.event.name(), message = notice.message());
            let message = Arc::new(notice.rendered(&self.options.sender));
            for worker in &self.workers {
                worker.put(Arc::clone(&message));
            }
        }
    }
}

#[cfg(test)]
mod tests;
