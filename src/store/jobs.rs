//! Jobs: durable states of background work. Module `jobs` computes; this file holds the data that survives a kill.

use super::captures::known;
use super::sql::{find, list, run, value};
use super::{Page, PageRequest, Reader, SOFTWARE, Store, StoreError, UtcNs};
use rusqlite::types::Value as Sql;
use rusqlite::{Connection, Row, Transaction, params, params_from_iter};
use serde::ser::Error as _;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::value::RawValue;
use sha2::{Digest as _, Sha256};

/// The number of processes of a job that may die without a checkpoint in between. The job itself is then taken to be
/// the cause.
pub const ATTEMPTS_MAX: u32 = 3;
/// The maximum number of waiting jobs. Further requests are refused.
pub const QUEUE_JOBS_MAX: u64 = 100;

/// Results of one kind, capture, parameters and version of the program that are kept: those over the most samples.
pub const RESULTS_KEPT: u32 = 10;
/// Superseded jobs removed in one transaction: an older version of the program left all of them.
const DROP_MAX: i64 = 100;
/// The number of jobs without a result that are kept: the last ones that failed or were cancelled.
const ENDED_KEPT: i64 = 1000;

/// The kinds of jobs that this program knows: those of a newer program wait for it.
pub(super) const KNOWN: &str = "kind IN ('allan', 'noise', 'statistics', 'diagnosis')";

/// The kind of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum JobKind {
    /// Deviation curves (`vn100d-allan-1`).
    Allan,
    /// Noise parameters (`vn100d-noise-1`).
    Noise,
    /// Moments, histogram and a test for normality (`vn100d-statistics-1`).
    Statistics,
    /// Differences and missing effects of a simulator (`vn100d-diagnosis-1`).
    Diagnosis,
}

impl JobKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Allan, Self::Noise, Self::Statistics, Self::Diagnosis];
    /// The kinds that are queued for every capture without a request.
    pub const USUAL: [Self; 3] = [Self::Allan, Self::Noise, Self::Statistics];

    /// Returns the name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
    /// Returns a description of its result.
    pub fn gives(self) -> &'static str {
        match self {
            Self::Allan => "Allan deviation",
            Self::Noise => "table of noise parameters",
            Self::Statistics => "table of statistics",
            Self::Diagnosis => "diagnosis",
        }
    }
}

/// The state of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum JobState {
    /// The job waits for its turn.
    Queued,
    /// The job is being worked on.
    Running,
    /// The result is available.
    Done,
    /// The job cannot be done; `error` states the reason.
    Failed,
    /// A user cancelled the job.
    Cancelled,
}

impl JobState {
    /// Returns the name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// Requested work.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewJob {
    /// The kind of the job.
    pub kind: JobKind,
    /// The capture that the job reads.
    pub capture_id: i64,
    /// Its parameters: the JSON text of an object with sorted keys, so that equal parameters are the same text.
    pub params: String,
    /// SHA-256 of the job's reference ([`Store::begin_reference`]).
    pub reference: Option<String>,
}

#[cfg(test)]
impl NewJob {
    /// Creates a job without a reference.
    pub(crate) fn new(kind: JobKind, capture_id: i64, params: serde_json::Value) -> Self {
        Self { kind, capture_id, params: params.to_string(), reference: None }
    }
}

/// A job as the interfaces show it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct JobRow {
    /// Its id.
    pub id: i64,
    /// Its kind.
    #[schema(value_type = String)]
    pub kind: JobKind,
    /// The capture that it reads.
    pub capture: i64,
    /// Its parameters.
    #[schema(value_type = Object)]
    #[serde(serialize_with = "as_json")]
    pub params: String,
    /// The job reads the samples with `seq` below this number, which was fixed when it was submitted.
    pub end_seq: u64,
    /// Its state.
    pub state: JobState,
    /// Its progress, 0–1; never decreases.
    pub progress: f64,
    /// The time at which it was submitted.
    pub created_at: UtcNs,
    /// The time at which it was first started.
    pub started_at: Option<UtcNs>,
    /// The time at which it ended.
    pub finished_at: Option<UtcNs>,
    /// The reason why it failed.
    pub error: Option<String>,
    /// The id of its result.
    pub result_id: Option<i64>,
    /// The version of the program to which it was submitted, or that took it over.
    pub software: String,
    /// Whether that version differs from this one: submit the job again for a new result; the old one stays.
    pub stale: bool,
}

/// Writes JSON text as the value that it is.
fn as_json<S: Serializer>(text: &str, serializer: S) -> Result<S::Ok, S::Error> {
    serde_json::from_str::<&RawValue>(text).map_err(S::Error::custom)?.serialize(serializer)
}

/// The state from which a job resumes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobCheckpoint {
    /// The first sample that is not yet taken in.
    pub next_seq: u64,
    /// The state of the computation, in its own encoding.
    pub state: Vec<u8>,
}

pub(super) const JOB_COLUMNS: &str = "id, kind, capture_id, params, end_seq, state, progress, created_utc_ns, started_utc_ns, \
    finished_utc_ns, error, result_id, software";

pub(super) fn job_of(row: &Row<'_>) -> Result<JobRow, StoreError> {
    let time = |index| row.get::<_, Option<i64>>(index).map(|ns| ns.map(UtcNs));
    let software: String = row.get(12)?;
    Ok(JobRow {
        id: row.get(0)?,
        kind: known("job.kind", row.get(1)?)?,
        capture: row.get(2)?,
        params: row.get(3)?,
        end_seq: row.get::<_, i64>(4)? as u64,
        state: known("job.state", row.get(5)?)?,
        progress: row.get(6)?,
        created_at: UtcNs(row.get(7)?),
        started_at: time(8)?,
        finished_at: time(9)?,
        error: row.get(10)?,
        result_id: row.get(11)?,
        stale: software != SOFTWARE,
        software,
    })
}

fn job(connection: &Connection, id: i64) -> Result<Option<JobRow>, StoreError> {
    let sql = format!("SELECT {JOB_COLUMNS} FROM job WHERE id = ?1 AND {KNOWN}");
    let mut statement = connection.prepare_cached(&sql)?;
    let mut rows = statement.query([id])?;
    rows.next()?.map(job_of).transpose()
}

impl Store {
    /// Queues a job over the samples that are on disk now. Returns the job and whether it is new. The same submission
    /// (kind, capture, samples, parameters, software) is the same job, unless that one failed or was cancelled. While
    /// the capture still grows, a waiting or running job counts as the same whatever samples it covers. `queue_max`
    /// bounds how many may wait.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], [`StoreError::QueueFull`], or the error that the database reports.
    pub fn submit_job(&self, new: NewJob, queue_max: u64) -> Result<(JobRow, bool), StoreError> {
        let utc_ns = self.utc_ns();
        self.execute(move |transaction| submit(transaction, &new, queue_max, utc_ns))
    }

    /// Takes the oldest queued job and marks it as running.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn claim_job(&self) -> Result<Option<JobRow>, StoreError> {
        let utc_ns = self.utc_ns();
        self.execute(move |transaction| {
            let sql = format!("SELECT id FROM job WHERE state = 'queued' AND {KNOWN} ORDER BY id LIMIT 1");
            let found: Option<i64> = find(transaction, &sql, [], |row| row.get(0))?;
            let Some(id) = found else { return Ok(None) };
            take_over(transaction, id)?;
            let sql = "UPDATE job SET state = 'running', started_utc_ns = coalesce(started_utc_ns, ?2) WHERE id = ?1";
            transaction.execute(sql, params![id, utc_ns])?;
            job(transaction, id)
        })
    }

    /// Stores the checkpoint of a running job. Returns `false` if the job was cancelled or deleted and must end.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn checkpoint_job(&self, id: i64, checkpoint: JobCheckpoint, progress: f64) -> Result<bool, StoreError> {
        self.execute(move |transaction| {
            let sql = "UPDATE job SET progress = max(progress, ?2), attempts = 0 WHERE id = ?1 AND state = 'running'";
            let running = run(transaction, sql, params![id, progress.clamp(0.0, 1.0)])?;
            if running == 1 {
                let sql = "INSERT INTO job_checkpoint (job_id, next_seq, state, software) VALUES (?1, ?2, ?3, ?4) \
                           ON CONFLICT (job_id) DO UPDATE SET next_seq = excluded.next_seq, state = excluded.state, \
                           software = excluded.software";
                run(transaction, sql, params![id, checkpoint.next_seq as i64, checkpoint.state, SOFTWARE])?;
            }
            Ok(running == 1)
        })
    }

    /// Stores the progress of a running job between its checkpoints. Its starts continue to be counted. Returns `false` if
    /// the job was cancelled or deleted and must end.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn note_progress(&self, id: i64, progress: f64) -> Result<bool, StoreError> {
        self.execute(move |transaction| {
            let sql = "UPDATE job SET progress = max(progress, ?2) WHERE id = ?1 AND state = 'running'";
            let running = run(transaction, sql, params![id, progress.clamp(0.0, 1.0)])?;
            Ok(running == 1)
        })
    }

    /// Stores a running job's result (a JSON document) and marks the job as done. Returns the result's id, or `None` if
    /// the job was cancelled or deleted meanwhile. Of jobs that differ only in how many samples of their capture they
    /// cover, the last [`RESULTS_KEPT`] stay, with their results.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn finish_job(&self, id: i64, body: String) -> Result<Option<i64>, StoreError> {
        let utc_ns = self.utc_ns();
        self.execute(move |transaction| {
            let Some(job) = job(transaction, id)?.filter(|job| job.state == JobState::Running) else { return Ok(None) };
            let sql = "INSERT INTO result (job_id, capture_id, kind, software, created_utc_ns, body) \
                       VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
            transaction.execute(sql, params![id, job.capture, job.kind.name(), SOFTWARE, utc_ns, body])?;
            let result_id = transaction.last_insert_rowid();
            let sql = "UPDATE job SET state = 'done', progress = 1, attempts = 0, finished_utc_ns = ?2, result_id = ?3 \
                       WHERE id = ?1";
            transaction.execute(sql, params![id, utc_ns, result_id])?;
            transaction.execute("DELETE FROM job_checkpoint WHERE job_id = ?1", [id])?;
            drop_superseded(transaction, id)?;
            Ok(Some(result_id))
        })
    }

    /// Marks a running job as failed.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn fail_job(&self, id: i64, error: &str) -> Result<(), StoreError> {
        let (error, utc_ns) = (error.to_owned(), self.utc_ns());
        self.execute(move |transaction| {
            let sql =
                "UPDATE job SET state = 'failed', error = ?2, finished_utc_ns = ?3 WHERE id = ?1 AND state = 'running'";
            transaction.execute(sql, params![id, error, utc_ns])?;
            leave_nothing(transaction, id)?;
            Ok(())
        })
    }

    /// Counts that the process of a running job died. The job is queued again, or fails with this reason if this was
    /// the [`ATTEMPTS_MAX`]th death without a checkpoint in between. Returns its new state and the number of deaths, or
    /// `None` if the job is gone.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn count_attempt(&self, id: i64, reason: &str) -> Result<Option<(JobState, u32)>, StoreError> {
        let (error, utc_ns) = (format!("tried {ATTEMPTS_MAX} times: {reason}"), self.utc_ns());
        self.execute(move |transaction| {
            let sql = "UPDATE job SET attempts = attempts + 1, state = iif(attempts + 1 >= ?2, 'failed', 'queued'), \
                       error = iif(attempts + 1 >= ?2, ?3, NULL), finished_utc_ns = iif(attempts + 1 >= ?2, ?4, NULL) \
                       WHERE id = ?1 AND state = 'running'";
            transaction.execute(sql, params![id, ATTEMPTS_MAX, error, utc_ns])?;
            let sql = "SELECT state, attempts FROM job WHERE id = ?1";
            let read = |row: &Row<'_>| Ok((row.get::<_, String>(0)?, row.get(1)?));
            let found = find(transaction, sql, [id], read)?;
            let found = found.and_then(|(state, attempts)| Some((state.parse().ok()?, attempts)));
            if found.is_some_and(|(state, _)| state == JobState::Failed) {
                leave_nothing(transaction, id)?;
            }
            Ok(found)
        })
    }

    /// Puts a running job back into the queue, with its checkpoint, when the program ends normally.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn release_job(&self, id: i64) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            transaction.execute("UPDATE job SET state = 'queued' WHERE id = ?1 AND state = 'running'", [id])?;
            Ok(())
        })
    }

    /// Cancels a queued or running job; a running one ends at its next checkpoint.
    ///
    /// # Errors
    /// [`StoreError::NoSuchJob`], [`StoreError::JobEnded`], or the error that the database reports.
    pub fn cancel_job(&self, id: i64) -> Result<(), StoreError> {
        let utc_ns = self.utc_ns();
        self.execute(move |transaction| {
            let job = job(transaction, id)?.ok_or(StoreError::NoSuchJob(id))?;
            if !matches!(job.state, JobState::Queued | JobState::Running) {
                return Err(StoreError::JobEnded { id, state: job.state.name() });
            }
            let sql = "UPDATE job SET state = 'cancelled', finished_utc_ns = ?2 WHERE id = ?1";
            transaction.execute(sql, params![id, utc_ns])?;
            leave_nothing(transaction, id)?;
            Ok(())
        })
    }
}

/// Removes the checkpoint of a job without a result, and its claim on a reference.
fn leave_nothing(transaction: &Transaction<'_>, id: i64) -> Result<(), StoreError> {
    transaction.execute("DELETE FROM job_checkpoint WHERE job_id = ?1", [id])?;
    transaction.execute("UPDATE job SET reference_id = NULL WHERE id = ?1", [id])?;
    Ok(())
}

fn submit(
    transaction: &Transaction<'_>,
    new: &NewJob,
    queue_max: u64,
    utc_ns: i64,
) -> Result<(JobRow, bool), StoreError> {
    let sql = "SELECT samples, state IN ('waiting', 'capturing') FROM capture WHERE id = ?1 AND lifecycle = 'live'";
    let (end_seq, growing): (i64, bool) =
        find(transaction, sql, [new.capture_id], |row| Ok((row.get(0)?, row.get(1)?)))?
            .ok_or_else(|| StoreError::NoSuchCapture(new.capture_id.to_string()))?;
    let kind = new.kind.name();
    let fingerprint = fingerprint(kind, new.capture_id, end_seq, &new.params);
    let sql = "SELECT id FROM job WHERE fingerprint = ?1 AND state IN ('queued', 'running', 'done')";
    let mut known: Option<i64> = find(transaction, sql, [&fingerprint], |row| row.get(0))?;
    if known.is_none() && growing {
        let sql = "SELECT id FROM job WHERE capture_id = ?1 AND kind = ?2 AND params = ?3 AND software = ?4 \
                   AND state IN ('queued', 'running') ORDER BY id DESC LIMIT 1";
        let of = params![new.capture_id, kind, new.params, SOFTWARE];
        known = find(transaction, sql, of, |row| row.get(0))?;
    }
    let (id, is_new) = match known {
        Some(id) => (id, false),
        None => {
            let sql = "SELECT count(*) FROM job WHERE state = 'queued'";
            let queued = value::<i64>(transaction, sql, [])? as u64;
            if queued >= queue_max {
                return Err(StoreError::QueueFull(queued));
            }
            drop_ended(transaction)?;
            let reference =
                new.reference.as_deref().map(|sha256| super::references::claim(transaction, sha256)).transpose()?;
            let sql = "INSERT INTO job (kind, capture_id, params, end_seq, fingerprint, software, state, created_utc_ns, reference_id) \
                       VALUES (?1, ?2, ?3, ?4, ?5, ?6, 'queued', ?7, ?8)";
            let values = params![kind, new.capture_id, new.params, end_seq, fingerprint, SOFTWARE, utc_ns, reference];
            transaction.execute(sql, values)?;
            (transaction.last_insert_rowid(), true)
        }
    };
    Ok((job(transaction, id)?.ok_or(StoreError::NoSuchJob(id))?, is_new))
}

/// Returns the SHA-256 of the properties that make two submissions the same, in hexadecimal digits.
fn fingerprint(kind: &str, capture_id: i64, end_seq: i64, params: &str) -> String {
    let text = format!(
        r#"{{"capture":{capture_id},"end_seq":{end_seq},"kind":"{kind}","params":{params},"software":"{SOFTWARE}"}}"#
    );
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Removes the oldest jobs that failed or were cancelled, which have no result: whoever submits what fails must not fill the disk.
fn drop_ended(transaction: &Transaction<'_>) -> Result<(), StoreError> {
    let sql = "DELETE FROM job WHERE id IN (SELECT id FROM job WHERE state IN ('failed', 'cancelled') \
               ORDER BY id DESC LIMIT ?1 OFFSET ?2)";
    run(transaction, sql, params![DROP_MAX, ENDED_KEPT])?;
    Ok(())
}

/// Removes results that newer ones of the same kind, capture, parameters and version supersede. The result over all
/// samples of an ended capture covers the most samples and stays. Results of other versions stay.
fn drop_superseded(transaction: &Transaction<'_>, id: i64) -> Result<(), StoreError> {
    let sql = "SELECT old.id, old.result_id FROM job AS new JOIN job AS old ON old.capture_id = new.capture_id \
               AND old.kind = new.kind AND old.params = new.params AND old.software = new.software \
               WHERE new.id = ?1 AND old.state = 'done' ORDER BY old.end_seq DESC, old.id DESC LIMIT ?2 OFFSET ?3";
    let ids = |row: &Row<'_>| Ok((row.get::<_, i64>(0)?, row.get::<_, Option<i64>>(1)?));
    let old = list(transaction, sql, params![id, DROP_MAX, RESULTS_KEPT], ids)?;
    for (job_id, result_id) in old {
        run(transaction, "DELETE FROM job WHERE id = ?1", [job_id])?;
        run(transaction, "DELETE FROM result WHERE id = ?1", [result_id])?;
    }
    Ok(())
}

/// Makes a job that an older program left in the queue one of this program, because its result will be.
fn take_over(transaction: &Transaction<'_>, id: i64) -> Result<(), StoreError> {
    let Some(old) = job(transaction, id)?.filter(|job| job.stale) else { return Ok(()) };
    let fingerprint = fingerprint(old.kind.name(), old.capture, old.end_seq as i64, &old.params);
    // If this program already has the same submission, the old job keeps its old version.
    let sql = "UPDATE OR IGNORE job SET fingerprint = ?2, software = ?3, attempts = 0 WHERE id = ?1";
    transaction.execute(sql, params![id, fingerprint, SOFTWARE])?;
    Ok(())
}

impl Reader {
    /// Returns a job.
    ///
    /// # Errors
    /// [`StoreError::NoSuchJob`], or the error that the database reports.
    pub fn job(&self, id: i64) -> Result<JobRow, StoreError> {
        job(&self.connection, id)?.ok_or(StoreError::NoSuchJob(id))
    }

    /// Returns jobs, the latest first; only those of a capture or in a state, if requested.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or the error that the database reports.
    pub fn jobs(
        &self,
        capture_id: Option<i64>,
        state: Option<JobState>,
        page: &PageRequest,
    ) -> Result<Page<JobRow>, StoreError> {
        let mut sql = format!("SELECT {JOB_COLUMNS} FROM job WHERE {KNOWN} AND id < ?");
        let mut values = vec![Sql::Integer(page.after("jobs")?.unwrap_or(i64::MAX))];
        if let Some(capture_id) = capture_id {
            sql.push_str(" AND capture_id = ?");
            values.push(Sql::Integer(capture_id));
        }
        if let Some(state) = state {
            sql.push_str(" AND state = ?");
            values.push(Sql::Text(state.name().to_owned()));
        }
        sql.push_str(" ORDER BY id DESC LIMIT ?");
        values.push(Sql::Integer(page.limit() as i64 + 1));
        Page::read(&self.connection, &sql, params_from_iter(values), page, "jobs", job_of)
    }

    /// Returns the jobs that cover all samples of this capture below `end_seq`, the latest first, at most 1000.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn jobs_over(&self, capture_id: i64, kind: JobKind, end_seq: u64) -> Result<Vec<JobRow>, StoreError> {
        let sql = format!(
            "SELECT {JOB_COLUMNS} FROM job WHERE capture_id = ?1 AND kind = ?2 AND end_seq = ?3 ORDER BY id DESC LIMIT 1000"
        );
        let mut statement = self.connection.prepare_cached(&sql)?;
        statement.query_and_then(params![capture_id, kind.name(), end_seq as i64], job_of)?.collect()
    }

    /// Returns the point from which a job resumes. `None` before its first checkpoint, and if another version of the
    /// program made the checkpoint: sums of two programs are never mixed.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn checkpoint(&self, job_id: i64) -> Result<Option<JobCheckpoint>, StoreError> {
        let sql = "SELECT next_seq, state FROM job_checkpoint WHERE job_id = ?1 AND software = ?2";
        let read = |row: &Row<'_>| Ok(JobCheckpoint { next_seq: row.get::<_, i64>(0)? as u64, state: row.get(1)? });
        Ok(find(&self.connection, sql, params![job_id, SOFTWARE], read)?)
    }

    /// Returns the number of jobs in a state.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn count_jobs(&self, state: JobState) -> Result<u64, StoreError> {
        let sql = format!("SELECT count(*) FROM job WHERE state = ?1 AND {KNOWN}");
        let count: i64 = value(&self.connection, &sql, [state.name()])?;
        Ok(count as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::{World, sample, segment};

    fn job(kind: JobKind, params: serde_json::Value) -> NewJob {
        NewJob::new(kind, 1, params)
    }

    fn finished(world: &World, new: NewJob) -> i64 {
        let id = world.store.submit_job(new, u64::MAX).unwrap().0.id;
        assert_eq!(world.store.claim_job().unwrap().unwrap().id, id);
        world.store.finish_job(id, "{}".to_owned()).unwrap().unwrap();
        id
    }

    #[test]
    fn a_job_of_a_kind_that_a_newer_program_has_holds_no_other_up() {
        let names: Vec<&str> = JobKind::ALL.iter().map(|kind| kind.name()).collect();
        assert_eq!(KNOWN, format!("kind IN ('{}')", names.join("', '")));
        let world = World::new();
        let id = world.capturing();
        world.send(id, [segment(1, 0), sample(1, 0)]);
        let unknown = world.store.submit_job(job(JobKind::Noise, serde_json::json!({})), u64::MAX).unwrap().0.id;
        let rename = move |transaction: &rusqlite::Transaction<'_>| {
            transaction.execute("UPDATE job SET kind = 'oracle' WHERE id = ?1", [unknown])?;
            Ok(())
        };
        world.store.execute(rename).unwrap();
        let known = world.store.submit_job(job(JobKind::Allan, serde_json::json!({})), u64::MAX).unwrap().0.id;
        let reader = world.reader();
        assert_eq!(reader.jobs(None, None, &PageRequest::first()).unwrap().rows.len(), 1);
        assert!(matches!(reader.job(unknown), Err(StoreError::NoSuchJob(_))));
        assert_eq!(world.store.claim_job().unwrap().map(|job| job.id), Some(known));
        assert!(world.store.claim_job().unwrap().is_none());
    }

    #[test]
    fn the_last_jobs_that_failed_stay_and_older_ones_go() {
        let world = World::new();
        let capture = world.capturing();
        let fill = move |transaction: &rusqlite::Transaction<'_>| {
            let sql = "INSERT INTO job (kind, capture_id, params, end_seq, fingerprint, software, state, created_utc_ns) \
                       WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 1050) \
                       SELECT 'noise', ?1, '{}', 0, 'f' || i, ?2, iif(i % 2, 'failed', 'cancelled'), 0 FROM n";
            transaction.execute(sql, params![capture, SOFTWARE])?;
            Ok(())
        };
        world.store.execute(fill).unwrap();
        let id = world.store.submit_job(NewJob::new(JobKind::Noise, capture, serde_json::json!({})), 100).unwrap().0.id;
        let reader = world.reader();
        assert_eq!(
            reader.count_jobs(JobState::Failed).unwrap() + reader.count_jobs(JobState::Cancelled).unwrap(),
            1000
        );
        assert!(reader.job(id).is_ok() && reader.job(id - 1).is_ok() && reader.job(id - 1001).is_err());
    }

    #[test]
    fn of_results_over_a_growing_capture_the_last_ones_stay() {
        let world = World::new();
        let id = world.capturing();
        world.send(id, [segment(1, 0)]);
        let plain = serde_json::json!({"taus": "log"});
        let once = finished(&world, job(JobKind::Noise, plain.clone()));
        let other = finished(&world, job(JobKind::Allan, serde_json::json!({"taus": "octave"})));
        let older = finished(&world, job(JobKind::Allan, plain.clone()));
        world
            .store
            .execute(move |transaction| {
                transaction
                    .execute("UPDATE job SET software = 'vn100d 0.0.1', fingerprint = '' WHERE id = ?1", [older])?;
                Ok(())
            })
            .unwrap();
        let mut all = Vec::new();
        for seq in 0..14 {
            world.send(id, [sample(1, seq)]);
            world.store.flush_blocking().unwrap();
            all.push(finished(&world, job(JobKind::Allan, plain.clone())));
        }
        let reader = world.reader();
        let there: Vec<i64> = all.iter().copied().filter(|id| reader.job(*id).is_ok()).collect();
        assert_eq!(there, all[4..], "the last ten");
        for id in [once, other, older] {
            let result = reader.job(id).unwrap().result_id.unwrap();
            assert!(reader.result(result).unwrap().is_some(), "another kind, other parameters, another version");
        }
        let count = |sql: &str| reader.connection.query_row(sql, [], |row| row.get::<_, i64>(0)).unwrap();
        assert_eq!(count("SELECT count(*) FROM result"), 13);
        assert_eq!(count("SELECT count(*) FROM job WHERE result_id IS NULL"), 0);
        // The job over all samples stays, whatever else is computed from the capture: the page shows it.
        assert_eq!(reader.jobs_over(id, JobKind::Allan, 14).unwrap()[0].id, all[13]);
    }
}
