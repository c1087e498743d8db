//! Retention's shell: determines the captures to delete, announces their deletion, and deletes the captures that are
//! due.

use crate::clock::{Clock, rfc3339};
use crate::config::Config;
use crate::jobs::Jobs;
use crate::notify::Tap;
use crate::observe::{ClockDistrust, PlannedDeletion, RetentionStatus};
use crate::retention::{Announcement, Candidate, Distrust, Judge, Limits, Moment, Planned, Verdict, plan};
use crate::store::{RetentionRow, Store, StoreError};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// The shortest and the longest interval between looks.
const EVERY: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(60));
/// Deletions that the status lists.
const LISTED: usize = 100;

/// Returns the limits of the configuration.
pub fn limits(config: &Config) -> Limits {
    let storage = &config.storage;
    Limits {
        keep: (storage.keep_days > 0).then(|| Duration::from_secs(u64::from(storage.keep_days) * 86_400)),
        keep_bytes: (storage.keep_mib > 0).then_some(storage.keep_mib << 20),
        notice: storage.delete_notice,
    }
}

/// The parts of the daemon that retention uses.
#[derive(Debug, Clone)]
pub struct Retention {
    /// The captures.
    pub store: Store,
    /// The workers that remove deleted rows.
    pub jobs: Jobs,
    /// The recipient of notifications.
    pub tap: Tap,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// The limits.
    pub limits: Limits,
}

impl Retention {
    /// Looks and deletes until `stop`; `status` receives the planned deletions. Without limits it looks once, to
    /// withdraw announcements made under other limits.
    pub async fn run(self, status: watch::Sender<RetentionStatus>, stop: CancellationToken) {
        let every = (self.limits.notice / 4).clamp(EVERY.0, EVERY.1);
        let mut judge = Judge::default();
        let mut logged = None;
        loop {
            let this = self.clone();
            let now = Moment {
                utc_ns: self.clock.utc_ns(),
                mono_ns: self.clock.mono_ns(),
                synchronised: self.clock.is_synchronised(),
            };
            let look = move |_: &Store| {
                let rows = this.store.reader()?.retention_rows()?;
                let captures: Vec<Candidate> = rows.iter().map(candidate).collect();
                let mut judged = judge;
                let verdict = judged.look(now, &captures);
                this.look(&rows, &captures, now.utc_ns, &verdict).map(|outcome| (judged, verdict, outcome))
            };
            match self.store.offload(look).await {
                Ok((judged, verdict, (planned, deleted))) => {
                    judge = judged;
                    // Without limits ages are irrelevant.
                    let found = verdict.distrust.filter(|_| !self.limits.is_unlimited());
                    let distrust = found.map(|distrust| clock_distrust(distrust, now.utc_ns));
                    if found != logged {
                        log_distrust(distrust.as_ref(), now.utc_ns);
                        logged = found;
                    }
                    let planned_total = planned.len() as u64;
                    let planned = planned.into_iter().take(LISTED).collect();
                    status.send_modify(|status| {
                        let deleted = status.deleted + deleted;
                        *status = RetentionStatus { planned, planned_total, deleted, distrust };
                    });
                    if self.limits.is_unlimited() {
                        return;
                    }
                }
                Err(StoreError::Closed) => return,
                Err(error) => tracing::warn!(%error, "retention waits for the database"),
            }
            tokio::select! {
                () = stop.cancelled() => return,
                () = tokio::time::sleep(every) => {}
            }
        }
    }

    /// Does one look; returns the planned deletions, and how many captures were deleted.
    fn look(
        &self,
        rows: &[RetentionRow],
        captures: &[Candidate],
        now_utc_ns: i64,
        verdict: &Verdict,
    ) -> Result<(Vec<PlannedDeletion>, u64), StoreError> {
        let planned = plan(captures, now_utc_ns, verdict, &self.limits);
        let row = |id: i64| rows.iter().find(|row| row.id == id);
        let listed = |one: &Planned| PlannedDeletion {
            capture: one.id,
            name: row(one.id).map(|row| row.name.clone()).unwrap_or_default(),
            bytes: one.bytes,
            reason: one.reason.name().to_owned(),
            delete_at: rfc3339(one.announcement.delete_at_utc_ns),
        };
        let mut changes = Vec::new();
        for one in planned.iter().filter(|one| one.is_new) {
            let Announcement { made_utc_ns, delete_at_utc_ns } = one.announcement;
            changes.push((one.id, Some((made_utc_ns, delete_at_utc_ns))));
        }
        let stays = |row: &&RetentionRow| row.announced.is_some() && !planned.iter().any(|one| one.id == row.id);
        changes.extend(rows.iter().filter(stays).map(|row| (row.id, None)));
        if !changes.is_empty() {
            self.store.announce_deletions(changes.clone())?;
        }
        for (id, _) in changes.iter().filter(|(_, announcement)| announcement.is_none()) {
            if verdict.distrust.is_some() {
                tracing::info!(capture = id, "it stays for now: the clock is not believed");
            } else {
                tracing::info!(capture = id, "it stays: the limits no longer ask for its deletion");
            }
        }
        // Announced only once it is written to the database: the announcement holds after a restart.
        let new: Vec<PlannedDeletion> = planned.iter().filter(|one| one.is_new).map(listed).collect();
        for one in &new {
            let PlannedDeletion { capture, name, reason, delete_at, bytes } = one;
            tracing::warn!(capture, name, reason, bytes, delete_at, "it will be deleted unless it is pinned");
        }
        if !new.is_empty() {
            self.tap.deletions(new);
        }
        let mut deleted = 0;
        for one in planned.iter().filter(|one| one.is_due) {
            match self.store.delete_capture(one.id) {
                Ok(()) => {
                    deleted += 1;
                    tracing::warn!(capture = one.id, reason = one.reason.name(), "deleted, as was announced");
                }
                // Pinned or deleted by a user a moment ago: that takes precedence.
                Err(StoreError::NotDeletable { .. } | StoreError::NoSuchCapture(_)) => {}
                Err(error) => return Err(error),
            }
        }
        if deleted > 0 {
            self.jobs.wake();
        }
        Ok((planned.iter().filter(|one| !one.is_due).map(listed).collect(), deleted))
    }
}

/// Returns the reason why the clock is distrusted, for the status.
fn clock_distrust(distrust: Distrust, now_utc_ns: i64) -> ClockDistrust {
    let now = rfc3339(now_utc_ns);
    let message = match distrust {
        Distrust::Unset => format!(
            "the clock shows {now}, so it was never set: no capture is deleted for its age; set it, or wait for a time server"
        ),
        Distrust::Behind { capture, since_utc_ns } => format!(
            "capture {capture} ended at {}, but the clock shows {now}: no capture is deleted for its age; set the clock, or, \
             where that capture's date is the wrong one, delete the capture",
            rfc3339(since_utc_ns)
        ),
        Distrust::FarAhead { newest_utc_ns } => format!(
            "the clock shows {now}, more than 30 days after {}, the latest time that is sure: no capture is deleted for its \
             age until a time server confirms the clock, or it has run for a day without a step and captures were made by it",
            rfc3339(newest_utc_ns)
        ),
    };
    ClockDistrust { reason: distrust.name().to_owned(), message }
}

/// Logs that the clock is distrusted, or that it is trusted again.
fn log_distrust(distrust: Option<&ClockDistrust>, now_utc_ns: i64) {
    match distrust {
        None => {
            tracing::info!(now = rfc3339(now_utc_ns), "the clock is believed again: ages count, from a new notice on")
        }
        Some(distrust) => tracing::warn!(reason = distrust.reason, "{}", distrust.message),
    }
}

/// Returns the facts about a capture by which the clock is judged.
pub(super) fn candidate(row: &RetentionRow) -> Candidate {
    Candidate {
        id: row.id,
        since_utc_ns: row.since.0,
        bytes: row.bytes,
        open: row.open,
        pinned: row.pinned,
        announced: row.announced.map(|(made_utc_ns, delete_at_utc_ns)| Announcement { made_utc_ns, delete_at_utc_ns }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::ManualClock;
    use crate::jobs::JobsOptions;
    use crate::notify::Notifier;
    use crate::store::{CaptureState, NewCapture, StoreOptions};

    const DAY_NS: i64 = 86_400_000_000_000;
    const NOW_NS: i64 = 1_800_000_000_000_000_000;

    /// Runs retention with a clock that shows `wrong_ns`, over one capture of [`NOW_NS`] that is too old by the right
    /// one, for eight looks and longer than its notice; then the clock is set to `right_ns`. Returns, once no capture
    /// is left, the number of captures left before that and the status of the clock.
    async fn left_by(wrong_ns: i64, right_ns: i64) -> (usize, Option<String>) {
        let folder = tempfile::tempdir().unwrap();
        let made_by: Arc<dyn Clock> = Arc::new(ManualClock::new(NOW_NS));
        let options = StoreOptions { clock: made_by, ..StoreOptions::default() };
        let store = Store::open(&folder.path().join("vn100d.db"), options).unwrap();
        let jobs = Jobs::start(&store, JobsOptions::default()).unwrap();
        let clock = Arc::new(ManualClock::new(wrong_ns));
        let limits =
            Limits { keep: Some(Duration::from_secs(86_400)), keep_bytes: None, notice: Duration::from_secs(1) };
        let notify_options = crate::daemon::notices::options(&Config::default(), store.path());
        let retention = Retention {
            store: store.clone(),
            jobs: jobs.clone(),
            tap: Notifier::start(notify_options).unwrap().tap(),
            clock: Arc::clone(&clock) as Arc<dyn Clock>,
            limits,
        };
        store.create_capture(NewCapture::new("test", CaptureState::Complete)).unwrap();
        let count = || store.reader().unwrap().retention_rows().unwrap().len();
        let stop = CancellationToken::new();
        let (sender, mut status) = watch::channel(RetentionStatus::default());
        let running = tokio::spawn(retention.run(sender, stop.clone()));
        // However slow the machine is, each pass is a look.
        let mut pass = async || {
            status.changed().await.unwrap();
            clock.advance(Duration::from_millis(500));
            status.borrow_and_update().clone()
        };
        for _ in 0..8 {
            pass().await;
        }
        let (left, reason) = (count(), pass().await.distrust.map(|distrust| distrust.reason));
        clock.step_utc(right_ns - clock.utc_ns());
        for _ in 0..200 {
            if count() == 0 {
                break;
            }
            pass().await;
        }
        assert_eq!(count(), 0, "by the right clock it goes");
        stop.cancel();
        running.await.unwrap();
        let ended = tokio::task::spawn_blocking(move || {
            jobs.stop();
            store.close()
        });
        ended.await.unwrap().unwrap();
        (left, reason)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn nothing_goes_by_a_clock_that_woke_in_1970_or_far_ahead() {
        for (wrong_ns, reason) in
            [(5 * DAY_NS, "unset"), (NOW_NS - DAY_NS, "behind"), (NOW_NS + 20_000 * DAY_NS, "far-ahead")]
        {
            assert_eq!(left_by(wrong_ns, NOW_NS + 2 * DAY_NS).await, (1, Some(reason.to_owned())), "{wrong_ns}");
        }
    }
}
