//! Diagnoses: jobs of that kind with their results. A diagnosis has its job's id.

use super::jobs::{JOB_COLUMNS, job_of};
use super::sql::find;
use super::{JobKind, JobRow, Page, PageRequest, Reader, StoreError};
use rusqlite::params;

/// A diagnosis in a list.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnosisRow {
    /// Its job.
    pub job: JobRow,
    /// The verdict; `None` until the job is done.
    pub verdict: Option<String>,
    /// The one-sentence summary; `None` until the job is done.
    pub summary: Option<String>,
}

impl DiagnosisRow {
    /// Returns one sentence: the summary, or the state of the job.
    pub fn summary_or_state(&self) -> String {
        let state = || format!("diagnosis {}: {}", self.job.id, self.job.state.name());
        self.summary.clone().unwrap_or_else(state)
    }
}

impl Reader {
    /// Returns the id of the diagnosis that was requested last.
    ///
    /// # Errors
    /// [`StoreError::NoSuchDiagnosis`] if there is none, or the error that the database reports.
    pub fn latest_diagnosis(&self) -> Result<i64, StoreError> {
        let sql = "SELECT id FROM job WHERE kind = ?1 ORDER BY id DESC LIMIT 1";
        let found = find(&self.connection, sql, [JobKind::Diagnosis.name()], |row| row.get(0))?;
        found.ok_or_else(|| StoreError::NoSuchDiagnosis("latest".to_owned()))
    }

    /// Returns diagnoses, the latest first; only those of one capture if requested.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or the error that the database reports.
    pub fn diagnoses(&self, capture_id: Option<i64>, page: &PageRequest) -> Result<Page<DiagnosisRow>, StoreError> {
        let sql = format!(
            "SELECT {JOB_COLUMNS}, \
             (SELECT json_extract(body, '$.report.verdict') FROM result WHERE id = job.result_id), \
             (SELECT json_extract(body, '$.report.summary') FROM result WHERE id = job.result_id) \
             FROM job WHERE kind = ?1 AND id < ?2 AND capture_id = coalesce(?3, capture_id) ORDER BY id DESC LIMIT ?4"
        );
        let before = page.after("diagnoses")?.unwrap_or(i64::MAX);
        let values = params![JobKind::Diagnosis.name(), before, capture_id, page.limit() as i64 + 1];
        Page::read(&self.connection, &sql, values, page, "diagnoses", |row| {
            Ok(DiagnosisRow { job: job_of(row)?, verdict: row.get(13)?, summary: row.get(14)? })
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::store::tests::World;
    use crate::store::{JobKind, NewJob, PageRequest};

    #[test]
    fn diagnoses_are_listed_with_their_sentence_once_it_is_there() {
        let world = World::new();
        let id = world.capturing();
        let submit = |kind: JobKind, number: u32| {
            let params = serde_json::json!({ "sim": number });
            let job = NewJob::new(kind, id, params);
            world.store.submit_job(job, u64::MAX).unwrap().0.id
        };
        assert!(world.reader().latest_diagnosis().is_err());
        let done = submit(JobKind::Diagnosis, 1);
        world.store.claim_job().unwrap();
        let body = r#"{"report": {"verdict": "no_gap", "summary": "no gap"}}"#;
        world.store.finish_job(done, body.to_owned()).unwrap();
        submit(JobKind::Noise, 1);
        let waits = submit(JobKind::Diagnosis, 2);
        let reader = world.reader();
        assert_eq!(reader.latest_diagnosis().unwrap(), waits);
        let rows = reader.diagnoses(Some(id), &PageRequest::first()).unwrap().rows;
        let verdicts: Vec<_> = rows.iter().map(|row| (row.job.id, row.verdict.as_deref())).collect();
        assert_eq!(verdicts, [(waits, None), (done, Some("no_gap"))]);
        assert_eq!(rows[1].summary.as_deref(), Some("no gap"));
        assert!(reader.diagnoses(Some(id + 1), &PageRequest::first()).unwrap().rows.is_empty());
    }
}
