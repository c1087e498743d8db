//! Retention's shell: asks what is to be deleted, says so, and deletes what is due.

use crate::clock::{Clock, rfc3339};
use crate::config::Config;
use crate::jobs::Jobs;
use crate::notify::Tap;
use crate::observe::{PlannedDeletion, RetentionStatus};
use crate::retention::{Announcement, Candidate, Limits, Planned, plan};
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
        loop {
            let this = self.clone();
            // Only a second look tells whether the clock is being set: nothing is deleted at the first.
            let first = offset_ns.is_none();
            let now_ns = self.clock.utc_ns();
            // Saturating: a clock that is years wrong must not stop this.
            let offset_now_ns = now_ns.saturating_sub(self.clock.mono_ns() as i64);
            let stepped = offset_ns.is_some_and(|before: i64| offset_now_ns.saturating_sub(before).abs() > STEP_NS);
            let before = status.borrow().deleted;
            match self.store.offload(move |_| this.look(now_ns, stepped, !first)).await {
                Ok((planned, deleted)) => {
                    offset_ns = Some(offset_now_ns);
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
        now_utc_ns: i64,
        stepped: bool,
        may_delete: bool,
    ) -> Result<(Vec<PlannedDeletion>, u64), StoreError> {
        let rows = self.store.reader()?.retention_rows()?;
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
