//! Notifications: somebody is told when a capture completes, a gap opens or closes, storage runs low, the sensor is lost.
//!
//! Enters: status snapshots and what the capture writes down ([`Tap`]). Leaves: a program run or a JSON posted per
//! [`Notice`]. Pure: what is worth telling ([`watch`]) and how much of it ([`coalesce`]). Each receiver has a thread and
//! a bounded queue of its own ([`worker`]): one that hangs or fails costs its own messages and nothing else, least of all
//! a sample. Promised: each attempt ends in its time, with every process it started; each message is tried a bounded
//! number of times; what is given up or does not fit is counted and logged. Not promised: that a message survives the
//! daemon's end. Whoever must know for certain that the daemon lives asks `/readyz`.

pub mod coalesce;
pub mod deliver;
pub mod notice;
pub mod watch;
pub mod worker;

pub use notice::{CaptureFacts, NightFacts, Notice};

use crate::clock::Clock;
use crate::observe::{NotifyEvent, NotifyStatus, PlannedDeletion, Status};
use crate::sample::Gap;
use coalesce::Coalescer;
use deliver::Receiver;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch as channel};
use tokio_util::sync::CancellationToken;
use watch::{Sign, WatchOptions, Watcher};
use worker::Worker;

/// Signs from the capture that may wait to be looked at.
const TAP: usize = 256;

/// Who is told of what.
#[derive(Debug, Clone)]
pub struct NotifyOptions {
    /// Who is told.
    pub receivers: Vec<Receiver>,
    /// Of what.
    pub events: Vec<NotifyEvent>,
    /// How soon the same event is told again.
    pub coalesce: Duration,
    /// What counts as lost and low.
    pub watch: WatchOptions,
    /// How one message is tried.
    pub effort: worker::Effort,
    /// What every message says of its sender.
    pub sender: notice::Sender,
}

/// Where others put what they have seen; never waits, cheap to clone. Without receivers it forgets everything.
#[derive(Debug, Clone, Default)]
pub struct Tap(Option<mpsc::Sender<Sign>>);

impl Tap {
    fn put(&self, sign: Sign) {
        // Full in a storm of gaps: the status still counts them.
        let _ = self.0.as_ref().map(|sender| sender.try_send(sign));
    }
    /// Whether anybody listens.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        self.0.is_some()
    }
    /// A gap was written down: it is over.
    pub fn gap(&self, capture_id: i64, gap: &Gap) {
        if self.is_heard() {
            self.put(Sign::Gap(capture_id, gap.clone()));
        }
    }
    /// A capture is complete and on disk.
    pub fn completed(&self, capture: CaptureFacts) {
        self.put(Sign::Ended(capture));
    }
    /// Captures are going to be deleted.
    pub fn deletions(&self, planned: Vec<PlannedDeletion>) {
        self.put(Sign::Deletions(planned));
    }
    /// A night of the schedule was not recorded: the name that it would have had, and why.
    pub fn night_skipped(&self, name: String, reason: String) {
        self.put(Sign::Skipped(NightFacts { name, reason }));
    }
}

/// The notifications of a daemon: made first, so that others have its [`Tap`]; then run.
#[derive(Debug)]
pub struct Notifier {
    options: NotifyOptions,
    signs: mpsc::Receiver<Sign>,
    tap: Tap,
    workers: Vec<Worker>,
}

/// How the telling goes, from memory; cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct NotifyFigures(Vec<Arc<worker::Figures>>);

impl NotifyFigures {
    /// All receivers together.
    #[must_use]
    pub fn status(&self) -> NotifyStatus {
        let mut sum = NotifyStatus::default();
        for figures in &self.0 {
            figures.add_to(&mut sum);
        }
        sum
    }
}

impl Notifier {
    /// One worker per receiver.
    ///
    /// # Errors
    /// What the system says where a thread cannot be started.
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

    /// Where others put what they have seen.
    #[must_use]
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }

    /// How the telling goes.
    #[must_use]
    pub fn figures(&self) -> NotifyFigures {
        NotifyFigures(self.workers.iter().map(Worker::figures).collect())
    }

    /// Looks and tells until `stop`; then what was held back is told, in the short time that an ending daemon has.
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
            self.tell(due);
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
                    self.tell(vec![notice]);
                }
            }
        }
        let held = coalescer.due(u64::MAX);
        self.tell(held);
        let workers = std::mem::take(&mut self.workers);
        // The threads are waited for on one for such work.
        let _ = tokio::task::spawn_blocking(move || Worker::stop(workers)).await;
    }

    fn tell(&self, notices: Vec<Notice>) {
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
