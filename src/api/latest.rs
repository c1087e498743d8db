//! Latest: the newest rows for the first page, read once a second for any number of viewers. No viewer waits long: a
//! disk that hangs holds one query.

use super::problem::ApiError;
use super::state::ApiState;
use crate::page::Stored;
use crate::store::{JobRow, JobState, PageRequest};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Number of rows of a list.
const ROWS: u32 = 10;
/// Maximum age of fresh rows.
const FRESH: Duration = Duration::from_secs(1);
/// Maximum time to wait for new rows.
const PATIENCE: Duration = Duration::from_millis(150);
/// Rows older than this are not used: the database does not answer.
const STALE: Duration = Duration::from_secs(10);

/// Returns the newest rows; `None` if the database does not answer.
pub(super) async fn rows(state: &ApiState) -> Option<Arc<Stored>> {
    if let Some(rows) = state.latest.not_older_than(FRESH) {
        return Some(rows);
    }
    let first = !std::mem::replace(&mut state.latest.kept().reading, true);
    if first {
        let own = state.clone();
        let reading = tokio::spawn(async move {
            let read = read(&own).await;
            let mut kept = own.latest.kept();
            kept.reading = false;
            match read {
                Ok(rows) => kept.rows = Some((Instant::now(), Arc::new(rows))),
                Err(error) => tracing::warn!(%error, "The first page has no rows."),
            }
        });
        // Late rows are used by the next request.
        let _ = tokio::time::timeout(PATIENCE, reading).await;
    } else if state.latest.not_older_than(STALE).is_none() {
        // A query runs already, and there are no older rows to show.
        let begun = Instant::now();
        while state.latest.not_older_than(STALE).is_none() && begun.elapsed() < PATIENCE {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
    state.latest.not_older_than(STALE)
}

async fn read(state: &ApiState) -> Result<Stored, ApiError> {
    let running = state.status().capture.map(|capture| capture.id);
    state
        .read(move |reader| {
            let some = PageRequest { limit: Some(ROWS), cursor: None };
            // Running jobs first, then waiting ones, then the last message of failed ones.
            let mut jobs: Vec<JobRow> = Vec::new();
            for kind in [JobState::Running, JobState::Queued, JobState::Failed] {
                jobs.extend(reader.jobs(None, Some(kind), &some)?.rows);
            }
            jobs.truncate(ROWS as usize);
            Ok(Stored {
                captures: reader.captures(None, &some)?.rows,
                jobs,
                diagnoses: reader.diagnoses(None, &some)?.rows,
                causes: running.map(|id| reader.missing_by_cause(id)).transpose()?.unwrap_or_default(),
            })
        })
        .await
}
