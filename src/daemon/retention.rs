//! Retention's shell: asks what is to be deleted, says so, and deletes what is due.

use crate::clock::{Clock, rfc3339};
use crate::config::Config;
use crate::jobs::Jobs;
use crate::notify::Tap;
use crate::observe::{PlannedDeletion, RetentionStatus};
use crate::retention::{Announcement, Candidate, Distrust, Limits, Planned, distrust, plan};
use crate::store::{RetentionRow, Store, StoreError};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// How often it looks: at most and at least so rarely.
const EVERY: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(60));
/// Civil time that moved against the monotonic clock by more between two looks has stepped, ns.
const STEP_NS: i64 = 60_000_000_000;
/// Deletions that the status lists.
const LISTED: usize = 100;

/// The limits of the configuration.
#[must_use]
pub fn limits(config: &Config) -> Limits {
    let storage = &config.storage;
    Limits {
        keep: (storage.keep_days > 0).then(|| Duration::from_secs(u64::from(storage.keep_days) * 86_400)),
        keep_bytes: (storage.keep_mib > 0).then_some(storage.keep_mib << 20),
        notice: storage.delete_notice,
    }
}

/// What it works with.
#[derive(Debug, Clone)]
pub struct Retention {
    /// The captures.
    pub store: Store,
    /// Who takes deleted rows away.
    pub jobs: Jobs,
    /// Who is told.
    pub tap: Tap,
    /// The time.
    pub clock: Arc<dyn Clock>,
    /// What may be kept.
    pub limits: Limits,
}

impl Retention {
    /// Looks and deletes until `stop`; `status` hears what is planned. Without limits it looks once, to take back what
    /// was announced under others.
    pub async fn run(self, status: watch::Sender<RetentionStatus>, stop: CancellationToken) {
        let every = (self.limits.notice / 4).clamp(EVERY.0, EVERY.1);
        let mut offset_ns = None;
        let mut judge = Judge::default();
        loop {
            let this = self.clone();
            // Only a second look tells whether the clock is being set: nothing is deleted at the first.
            let first = offset_ns.is_none();
            let now_ns = self.clock.utc_ns();
            // Saturating: a clock that is years wrong must not stop this.
            let offset_now_ns = now_ns.saturating_sub(self.clock.mono_ns() as i64);
            let stepped = offset_ns.is_some_and(|before: i64| offset_now_ns.saturating_sub(before).abs() > STEP_NS);
            let before = status.borrow().deleted;
            let synchronised = self.clock.is_synchronised();
            let mut judged = judge.clone();
            let look = move |_: &Store| {
                let rows = this.store.reader()?.retention_rows()?;
                // Without limits what was announced is taken back whatever the clock says.
                if !this.limits.is_unlimited() && !judged.trusts(&rows, now_ns, synchronised) {
                    return Ok((judged, None));
                }
                this.look(&rows, now_ns, stepped, !first).map(|outcome| (judged, Some(outcome)))
            };
            match self.store.offload(look).await {
                Ok((judged, outcome)) => {
                    judge = judged;
                    // By a clock that is not believed nothing was looked at: the next look is the first.
                    offset_ns = outcome.is_some().then_some(offset_now_ns);
                    let (planned, deleted) = outcome.unwrap_or_default();
                    let planned_total = planned.len() as u64;
                    let planned = planned.into_iter().take(LISTED).collect();
                    status.send_replace(RetentionStatus { planned, planned_total, deleted: before + deleted });
                }
                Err(StoreError::Closed) => return,
                Err(error) => tracing::warn!(%error, "retention waits for the database"),
            }
            if self.limits.is_unlimited() && offset_ns.is_some() {
                return;
            }
            tokio::select! {
                () = stop.cancelled() => return,
                () = tokio::time::sleep(every) => {}
            }
        }
    }

    /// One look: answers what is planned, and how many were deleted.
    fn look(
        &self,
        rows: &[RetentionRow],
        now_utc_ns: i64,
        stepped: bool,
        may_delete: bool,
    ) -> Result<(Vec<PlannedDeletion>, u64), StoreError> {
        let planned = plan(&rows.iter().map(candidate).collect::<Vec<_>>(), now_utc_ns, stepped, &self.limits);
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
            let Announcement { said_utc_ns, delete_at_utc_ns } = one.announcement;
            changes.push((one.id, Some((said_utc_ns, delete_at_utc_ns))));
        }
        let stays = |row: &&RetentionRow| row.announced.is_some() && !planned.iter().any(|one| one.id == row.id);
        changes.extend(rows.iter().filter(stays).map(|row| (row.id, None)));
        if !changes.is_empty() {
            self.store.announce_deletions(changes.clone())?;
        }
        for (id, _) in changes.iter().filter(|(_, announcement)| announcement.is_none()) {
            tracing::info!(capture = id, "it stays: the limits no longer ask for its deletion");
        }
        // Said only once it is written down: what is told holds after a restart.
        let new: Vec<PlannedDeletion> = planned.iter().filter(|one| one.is_new).map(listed).collect();
        for one in &new {
            let PlannedDeletion { capture, name, reason, delete_at, bytes } = one;
            tracing::warn!(capture, name, reason, bytes, delete_at, "it will be deleted unless it is pinned");
        }
        if !new.is_empty() {
            self.tap.deletions(new);
        }
        let mut deleted = 0;
        for one in planned.iter().filter(|one| one.is_due && may_delete) {
            match self.store.delete_capture(one.id) {
                Ok(()) => {
                    deleted += 1;
                    tracing::warn!(capture = one.id, reason = one.reason.name(), "deleted, as was announced");
                }
                // Pinned or deleted by somebody a moment ago: their word counts.
                Err(StoreError::NotDeletable { .. } | StoreError::NoSuchCapture { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        if deleted > 0 {
            self.jobs.wake();
        }
        Ok((planned.iter().filter(|one| !(one.is_due && may_delete)).map(listed).collect(), deleted))
    }
}

/// Judges the clock by the captures that were there when it was last believed: one that is made by a wrong clock does not
/// make it right.
#[derive(Debug, Clone, Default)]
struct Judge {
    /// Whether it has seen the captures at all.
    looked: bool,
    newest_utc_ns: Option<i64>,
    said: Option<Distrust>,
}

impl Judge {
    fn trusts(&mut self, rows: &[RetentionRow], now_utc_ns: i64, synchronised: bool) -> bool {
        // What runs has not ended.
        let newest = rows.iter().filter(|row| !row.open).map(|row| row.since.0).max();
        if !self.looked {
            (self.looked, self.newest_utc_ns) = (true, newest);
        }
        let found = distrust(now_utc_ns, self.newest_utc_ns, synchronised);
        if found.is_none() {
            self.newest_utc_ns = newest;
        }
        if found != self.said {
            let now = rfc3339(now_utc_ns);
            match found {
                None => tracing::info!(now, "the clock is believed again: retention goes on"),
                Some(Distrust::Unset) => {
                    tracing::warn!(
                        now,
                        "the clock was never set: no capture is deleted; set it, or wait for a time server"
                    );
                }
                Some(Distrust::Behind(newest)) => {
                    let newest = rfc3339(newest);
                    tracing::warn!(
                        now,
                        newest,
                        "a capture ended later than now: no capture is deleted until the clock is set"
                    );
                }
                Some(Distrust::FarAhead(newest)) => {
                    let newest = rfc3339(newest);
                    tracing::warn!(
                        now,
                        newest,
                        "the newest capture is far older than now: no capture is deleted until a time server confirms the \
                         clock, or the daemon starts with a newer capture"
                    );
                }
            }
            self.said = found;
        }
        found.is_none()
    }
}

fn candidate(row: &RetentionRow) -> Candidate {
    Candidate {
        id: row.id,
        since_utc_ns: row.since.0,
        bytes: row.bytes,
        open: row.open,
        pinned: row.pinned,
        announced: row.announced.map(|(said_utc_ns, delete_at_utc_ns)| Announcement { said_utc_ns, delete_at_utc_ns }),
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

    /// Retention by a clock that shows `wrong_ns`, over one capture of [`NOW_NS`] that is too old by the right one, for several
    /// looks and longer than its notice; then the clock is set to `right_ns`. Answers the captures left before that, and
    /// returns once there are none.
    async fn left_by(wrong_ns: i64, right_ns: i64) -> usize {
        let folder = tempfile::tempdir().unwrap();
        let made_by: Arc<dyn Clock> = Arc::new(ManualClock::new(NOW_NS));
        let options = StoreOptions { clock: made_by, ..StoreOptions::default() };
        let store = Store::open(&folder.path().join("vn100d.db"), options).unwrap();
        let jobs = Jobs::start(&store, JobsOptions::default()).unwrap();
        let clock = Arc::new(ManualClock::new(wrong_ns));
        let limits =
            Limits { keep: Some(Duration::from_secs(86_400)), keep_bytes: None, notice: Duration::from_secs(1) };
        let told = crate::daemon::notices::options(&Config::default(), store.path());
        let retention = Retention {
            store: store.clone(),
            jobs: jobs.clone(),
            tap: Notifier::start(told).unwrap().tap(),
            clock: Arc::clone(&clock) as Arc<dyn Clock>,
            limits,
        };
        store.create_capture(NewCapture::new("test", CaptureState::Complete)).unwrap();
        let count = || store.reader().unwrap().retention_rows().unwrap().len();
        let stop = CancellationToken::new();
        let running = tokio::spawn(retention.run(watch::channel(RetentionStatus::default()).0, stop.clone()));
        let pass = async || {
            tokio::time::sleep(Duration::from_millis(300)).await;
            clock.advance(Duration::from_millis(500));
        };
        for _ in 0..8 {
            pass().await;
        }
        let left = count();
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
        left
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn nothing_goes_by_a_clock_that_woke_in_1970_or_far_ahead() {
        for wrong_ns in [5 * DAY_NS, NOW_NS - DAY_NS, NOW_NS + 20_000 * DAY_NS] {
            assert_eq!(left_by(wrong_ns, NOW_NS + 2 * DAY_NS).await, 1, "{wrong_ns}");
        }
    }
}
