//! Latest: the newest rows for the first page, read once a second however many look at it, and never waited for long: a
//! disk that hangs holds one query.

use super::diagnoses::DiagnosisEntry;
use super::jobs::Job;
use super::problem::ApiError;
use super::state::ApiState;
use crate::gallery;
use crate::store::{CaptureFilter, JobState, PageRequest};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Rows of a list.
const ROWS: u32 = 10;
/// How old rows may be.
const FRESH: Duration = Duration::from_secs(1);
/// How long new ones are waited for.
const PATIENCE: Duration = Duration::from_millis(150);
/// Rows older than this are none: the database does not answer.
const STALE: Duration = Duration::from_secs(10);

/// Lists as JSON.
#[derive(Debug, Clone)]
pub(super) struct Rows {
    pub(super) captures: String,
    pub(super) jobs: String,
    pub(super) diagnoses: String,
    pub(super) causes: String,
}

/// The rows and who reads them.
#[derive(Debug, Default)]
pub(super) struct Latest(Mutex<Kept>);

#[derive(Debug, Default)]
struct Kept {
    rows: Option<(Instant, Arc<Rows>)>,
    /// Somebody is reading.
    reading: bool,
}

impl Latest {
    fn kept(&self) -> std::sync::MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn not_older_than(&self, age: Duration) -> Option<Arc<Rows>> {
        self.kept().rows.as_ref().filter(|(at, _)| at.elapsed() < age).map(|(_, rows)| Arc::clone(rows))
    }
}

/// The newest rows; None where the database does not answer.
pub(super) async fn rows(state: &ApiState) -> Option<Arc<Rows>> {
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
        // Late rows are the next one's.
        let _ = tokio::time::timeout(PATIENCE, reading).await;
    } else if state.latest.not_older_than(STALE).is_none() {
        // Somebody reads already, and there is nothing older to show.
        let begun = Instant::now();
        while state.latest.not_older_than(STALE).is_none() && begun.elapsed() < PATIENCE {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
    state.latest.not_older_than(STALE)
}

async fn read(state: &ApiState) -> Result<Rows, ApiError> {
    let running = state.status().capture.map(|capture| capture.id);
    state
        .read(move |reader| {
            let some = PageRequest { limit: Some(ROWS), cursor: None };
            // What runs first, then what waits, then what was said last of those that failed.
            let mut jobs: Vec<Job> = Vec::new();
            for kind in [JobState::Running, JobState::Queued, JobState::Failed] {
                jobs.extend(reader.jobs(None, Some(kind), &some)?.rows.into_iter().map(Job::from));
            }
            jobs.truncate(ROWS as usize);
            let diagnoses: Vec<DiagnosisEntry> =
                reader.diagnoses(None, &some)?.rows.into_iter().map(DiagnosisEntry::from).collect();
            Ok(Rows {
                captures: json(&reader.captures(&CaptureFilter::default(), &some)?.rows),
                jobs: json(&jobs),
                diagnoses: json(&diagnoses),
                causes: gallery::causes(reader, running)?,
            })
        })
        .await
}

/// Rows are numbers and texts, which JSON has.
fn json(rows: &impl serde::Serialize) -> String {
    serde_json::to_string(rows).unwrap_or_else(|_| "[]".to_owned())
}
