//! Worker: a thread and a bounded queue for one receiver; tries a message a bounded number of times.

use super::deliver::{DeliverError, Receiver};
use super::notice::Message;
use crate::observe::NotifyStatus;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The maximum number of messages that wait for a receiver. Further ones are dropped, so that the beginning of the
/// trouble is reported.
pub const QUEUE: usize = 64;
/// The longest delay between two attempts.
const LONGEST: Duration = Duration::from_secs(300);
/// How long an ending daemon waits for its receivers.
const ENDING: Duration = Duration::from_secs(2);
/// The resolution with which waits can be ended.
const STEP: Duration = Duration::from_millis(50);

/// The attempts for one message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// The number of attempts.
    pub attempts: u32,
    /// The time limit of one attempt.
    pub timeout: Duration,
    /// The delay after the first failure; it doubles with every further one.
    pub retry_after: Duration,
}

impl Effort {
    /// Returns the delay after this many failed attempts (from 1).
    pub fn wait(&self, failed: u32) -> Duration {
        self.retry_after.saturating_mul(1 << failed.saturating_sub(1).min(16)).min(LONGEST.max(self.retry_after))
    }
}

/// The counts of one receiver, which its thread shares.
#[derive(Debug, Default)]
pub struct Figures(Mutex<NotifyStatus>);

impl Figures {
    /// Locks the counts.
    pub fn lock(&self) -> MutexGuard<'_, NotifyStatus> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The thread of one receiver.
#[derive(Debug)]
pub struct Worker {
    queue: mpsc::SyncSender<Arc<Message>>,
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

#[derive(Debug)]
struct Shared {
    figures: Arc<Figures>,
    /// Whether further attempts are forbidden.
    stop: AtomicBool,
    /// Whether the running attempt is cancelled too.
    abandon: AtomicBool,
}

impl Worker {
    /// Starts the thread.
    ///
    /// # Errors
    /// The error that the system reports.
    pub fn start(receiver: Receiver, effort: Effort) -> std::io::Result<Self> {
        let (queue, messages) = mpsc::sync_channel(QUEUE);
        let shared =
            Arc::new(Shared { figures: Arc::default(), stop: AtomicBool::new(false), abandon: AtomicBool::new(false) });
        let theirs = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("notify".to_owned())
            .spawn(move || work(&receiver, effort, &messages, &theirs))?;
        Ok(Self { queue, shared, thread })
    }

    /// Returns the counts.
    pub fn figures(&self) -> Arc<Figures> {
        Arc::clone(&self.shared.figures)
    }

    /// Puts a message into the queue; never waits.
    pub fn put(&self, message: Arc<Message>) {
        self.shared.figures.lock().queued += 1;
        if let Err(mpsc::TrySendError::Full(message) | mpsc::TrySendError::Disconnected(message)) =
            self.queue.try_send(message)
        {
            let mut figures = self.shared.figures.lock();
            figures.queued -= 1;
            figures.dropped += 1;
            if figures.dropped == 1 {
                tracing::warn!(event = message.event, "the queue of notifications is full, newer ones are dropped");
            }
        }
    }

    /// Ends the workers. Each waiting message is tried once more at most, for two seconds in all; a program that still
    /// runs then is killed.
    pub fn stop(workers: Vec<Self>) {
        let until = Instant::now() + ENDING;
        let mut threads = Vec::new();
        for Self { queue, shared, thread } in workers {
            shared.stop.store(true, Ordering::Release);
            // Without a sender the thread ends when its queue is empty.
            drop(queue);
            threads.push((shared, thread));
        }
        while Instant::now() < until && threads.iter().any(|(_, thread)| !thread.is_finished()) {
            std::thread::sleep(STEP);
        }
        for (shared, _) in &threads {
            shared.abandon.store(true, Ordering::Release);
        }
        // A program is killed within one or two checks; an HTTP request ends with the process.
        let until = Instant::now() + 4 * STEP;
        while Instant::now() < until && threads.iter().any(|(_, thread)| !thread.is_finished()) {
            std::thread::sleep(STEP);
        }
    }
}

fn work(receiver: &Receiver, effort: Effort, messages: &mpsc::Receiver<Arc<Message>>, shared: &Shared) {
    while let Ok(message) = messages.recv() {
        let outcome = deliver(receiver, effort, &message, shared);
        let mut figures = shared.figures.lock();
        figures.queued -= 1;
        figures.error = outcome.as_ref().err().map(ToString::to_string);
        match outcome {
            Ok(()) => figures.sent += 1,
            Err(error) => {
                figures.failed += 1;
                tracing::warn!(event = message.event, %error, "a notification was given up");
            }
        }
    }
}

fn deliver(receiver: &Receiver, effort: Effort, message: &Message, shared: &Shared) -> Result<(), DeliverError> {
    let mut failed = 0;
    loop {
        if shared.abandon.load(Ordering::Acquire) {
            return Err(DeliverError::Stopped);
        }
        let attempt = receiver.attempt(message, effort.timeout, || !shared.abandon.load(Ordering::Acquire));
        let Err(error) = attempt else { return Ok(()) };
        failed += 1;
        if failed >= effort.attempts || !error.may_pass() {
            return Err(error);
        }
        shared.figures.lock().error = Some(error.to_string());
        tracing::debug!(%error, failed, "a notification is tried again");
        let until = Instant::now() + effort.wait(failed);
        while Instant::now() < until {
            if shared.stop.load(Ordering::Acquire) {
                return Err(error);
            }
            std::thread::sleep(STEP.min(until.saturating_duration_since(Instant::now())));
        }
    }
}
