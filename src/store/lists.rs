//! Lists for people: rows that contain a text, and pages by number. Programs use the lists by [cursor](super::Page).

use super::captures::{CAPTURE_COLUMNS, capture_of};
use super::jobs::{JOB_COLUMNS, KNOWN, job_of};
use super::models::{HEAD, entry_of};
use super::{CaptureRow, DiagnosisRow, JobKind, JobRow, ModelEntry, Reader, StoreError};
use rusqlite::{Row, params};

/// The number of rows of a page.
pub const LIST_ROWS: u32 = 50;

/// The requested part of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Search {
    /// A text that each row must contain; upper and lower case of A–Z are the same. All rows if absent.
    pub text: Option<String>,
    /// The number of the page, from 1. A page has [`LIST_ROWS`] rows.
    pub page: u32,
}

/// A page of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Found<T> {
    /// The rows, the latest first.
    pub rows: Vec<T>,
    /// Whether there is a next page.
    pub more: bool,
}

/// A job in a list for people.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedJob {
    /// The job; its parameters are left out, as `{}`.
    pub job: JobRow,
    /// The name of its capture; `None` if that was deleted.
    pub capture: Option<String>,
}

/// A diagnosis in a list for people.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedDiagnosis {
    /// The diagnosis; the parameters of its job are left out, as `{}`.
    pub row: DiagnosisRow,
    /// The name of the capture; `None` if that was deleted.
    pub real: Option<String>,
    /// The name of the model, or of the capture that a simulator made; `None` if that was deleted.
    pub sim: Option<String>,
}

/// Name of a job's capture.
const CAPTURE_NAME: &str = "(SELECT name FROM capture WHERE id = job.capture_id AND lifecycle = 'live')";

/// A list, as SQL.
struct List<'a> {
    columns: &'a str,
    table: &'a str,
    filter: &'a str,
    /// The expressions that are searched, the cheapest first.
    searched: &'a [&'a str],
    key: &'a str,
}

/// Returns the columns of a job without its parameters, which may have 64 KiB.
fn job_columns() -> String {
    JOB_COLUMNS.replacen("params", "'{}'", 1)
}

/// Returns the pattern of `LIKE … ESCAPE '\'` for texts that contain this one.
fn containing(text: &str) -> String {
    let literal = text.replace('\\', "\\\\").replace('%', "\\%").replace('_', "\\_");
    format!("%{literal}%")
}

impl Reader {
    /// Returns captures whose name, note or source contains a text.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn find_captures(&self, search: &Search) -> Result<Found<CaptureRow>, StoreError> {
        let list = List {
            columns: CAPTURE_COLUMNS,
            table: "capture",
            filter: "lifecycle = 'live'",
            searched: &["name", "note", "source"],
            key: "id",
        };
        self.find(&list, search, capture_of)
    }

    /// Returns jobs whose kind, state, capture or error contains a text.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn find_jobs(&self, search: &Search) -> Result<Found<ListedJob>, StoreError> {
        let list = List {
            columns: &format!("{}, {CAPTURE_NAME}", job_columns()),
            table: "job",
            filter: KNOWN,
            searched: &["kind", "state", "error", CAPTURE_NAME],
            key: "id",
        };
        self.find(&list, search, |row| Ok(ListedJob { job: job_of(row)?, capture: row.get(13)? }))
    }

    /// Returns diagnoses whose capture, simulator, state, error, verdict or sentence contains a text.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn find_diagnoses(&self, search: &Search) -> Result<Found<ListedDiagnosis>, StoreError> {
        let sim = "coalesce(json_extract(params, '$.sim.name'), (SELECT name FROM capture \
                   WHERE id = json_extract(params, '$.sim') AND lifecycle = 'live'))";
        let [verdict, summary] = ["verdict", "summary"]
            .map(|key| format!("(SELECT json_extract(body, '$.report.{key}') FROM result WHERE id = job.result_id)"));
        let list = List {
            columns: &format!("{}, {verdict}, {summary}, {CAPTURE_NAME}, {sim}", job_columns()),
            table: "job",
            filter: &format!("kind = '{}'", JobKind::Diagnosis.name()),
            // A page shows the verdict with spaces.
            searched: &["state", "error", CAPTURE_NAME, sim, &format!("replace({verdict}, '_', ' ')"), &summary],
            key: "id",
        };
        self.find(&list, search, |row| {
            let diagnosis = DiagnosisRow { job: job_of(row)?, verdict: row.get(13)?, summary: row.get(14)? };
            Ok(ListedDiagnosis { row: diagnosis, real: row.get(15)?, sim: row.get(16)? })
        })
    }

    /// Returns models whose name or id contains a text.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn find_models(&self, search: &Search) -> Result<Found<ModelEntry>, StoreError> {
        let list = List {
            columns: HEAD,
            table: "model",
            filter: "TRUE",
            searched: &["name", "'model-' || model_id"],
            key: "model_id",
        };
        self.find(&list, search, |row| Ok(entry_of(row)?))
    }

    fn find<T>(
        &self,
        list: &List<'_>,
        search: &Search,
        row_of: impl Fn(&Row<'_>) -> Result<T, StoreError>,
    ) -> Result<Found<T>, StoreError> {
        let List { columns, table, filter, searched, key } = list;
        let searched: Vec<String> = searched.iter().map(|of| format!("{of} LIKE ?1 ESCAPE '\\'")).collect();
        let sql = format!(
            "SELECT {columns} FROM {table} WHERE {filter} AND (?1 IS NULL OR {}) ORDER BY {key} DESC LIMIT ?2 OFFSET ?3",
            searched.join(" OR ")
        );
        let skipped = i64::from(search.page.saturating_sub(1)) * i64::from(LIST_ROWS);
        let mut statement = self.connection.prepare_cached(&sql)?;
        let values = params![search.text.as_deref().map(containing), LIST_ROWS + 1, skipped];
        let mut rows = statement.query_and_then(values, row_of)?.collect::<Result<Vec<T>, StoreError>>()?;
        let more = rows.len() > LIST_ROWS as usize;
        rows.truncate(LIST_ROWS as usize);
        Ok(Found { rows, more })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::World;
    use crate::store::{CaptureState, NewCapture, NewJob};
    use serde_json::json;

    fn with(text: &str) -> Search {
        Search { text: Some(text.to_owned()), page: 1 }
    }

    fn page(page: u32) -> Search {
        Search { text: None, page }
    }

    #[test]
    fn a_capture_is_found_by_name_note_and_source_and_by_no_wildcard() {
        let world = World::new();
        for (name, note, source) in [
            ("Night_1", None, "/dev/ttyUSB0"),
            ("night-1", Some("50 % on foam"), "simulator"),
            (r"back\slash", Some("it's \"quoted\""), "a.csv"),
        ] {
            let capture = NewCapture {
                name: Some(name.to_owned()),
                note: note.map(str::to_owned),
                ..NewCapture::new(source, CaptureState::Complete)
            };
            world.store.create_capture(capture).unwrap();
        }
        let reader = world.reader();
        let found = |text: &str| -> Vec<String> {
            let rows = reader.find_captures(&with(text)).unwrap().rows;
            rows.into_iter().map(|row| row.name).collect()
        };
        assert_eq!(found("NIGHT"), ["night-1", "Night_1"]);
        assert_eq!(found("t_1"), ["Night_1"]);
        assert_eq!(found("%"), ["night-1"]);
        assert_eq!(found("50 %"), ["night-1"]);
        assert_eq!(found(r"\"), [r"back\slash"]);
        assert_eq!(found("'"), [r"back\slash"]);
        assert_eq!(found("\"quoted"), [r"back\slash"]);
        assert_eq!(found("ttyusb"), ["Night_1"]);
        assert_eq!(found("' OR 1 = 1 --"), [""; 0]);
        assert_eq!(found("%%"), [""; 0]);
    }

    #[test]
    fn pages_have_fifty_rows_and_lead_through_all() {
        let world = World::new();
        let ids: Vec<i64> = (0..101).map(|number| world.complete(&format!("c{number}"))).collect();
        world.store.delete_capture(ids[100]).unwrap();
        let reader = world.reader();
        let read = |search: &Search| {
            let found = reader.find_captures(search).unwrap();
            (found.rows.iter().map(|row| row.id).collect::<Vec<_>>(), found.more)
        };
        let latest_first: Vec<i64> = ids[..100].iter().rev().copied().collect();
        assert_eq!(read(&page(1)), (latest_first[..50].to_vec(), true));
        assert_eq!(read(&page(2)), (latest_first[50..].to_vec(), false));
        assert_eq!(read(&page(3)), (Vec::new(), false));
        assert_eq!(read(&page(u32::MAX)), (Vec::new(), false));
        // c9 and c90 to c99.
        assert_eq!(read(&with("C9")).0.len(), 11);
        assert_eq!(read(&Search { page: 2, ..with("c") }), (latest_first[50..].to_vec(), false));
    }

    #[test]
    fn jobs_and_diagnoses_have_the_names_of_what_they_read() {
        let world = World::new();
        let (real, made) = (world.complete("desk"), world.complete("made"));
        let submit = |kind: JobKind, params| {
            let id = world.store.submit_job(NewJob::new(kind, real, params), u64::MAX).unwrap().0.id;
            assert_eq!(world.store.claim_job().unwrap().map(|job| job.id), Some(id));
            id
        };
        let model = submit(JobKind::Diagnosis, json!({ "sim": { "name": "unit 7" } }));
        let body = r#"{"report": {"verdict": "no_gap", "summary": "gyro_x: a 3 Hz tone"}}"#;
        world.store.finish_job(model, body.to_owned()).unwrap();
        let capture = submit(JobKind::Diagnosis, json!({ "sim": made }));
        world.store.fail_job(capture, "too short").unwrap();
        let noise = submit(JobKind::Noise, json!({ "taus": "log" }));
        let reader = world.reader();
        let diagnoses = |text: &str| -> Vec<(i64, Option<String>)> {
            let rows = reader.find_diagnoses(&with(text)).unwrap().rows;
            rows.into_iter().map(|found| (found.row.job.id, found.sim)).collect()
        };
        let (unit, simulated) = ((model, Some("unit 7".to_owned())), (capture, Some("made".to_owned())));
        assert_eq!(diagnoses("DESK"), [simulated.clone(), unit.clone()]);
        for (text, expected) in
            [("3 hz", &unit), ("unit", &unit), ("no gap", &unit), ("made", &simulated), ("too short", &simulated)]
        {
            assert_eq!(diagnoses(text), std::slice::from_ref(expected), "{text}");
        }
        let jobs = |text: &str| -> Vec<i64> {
            reader.find_jobs(&with(text)).unwrap().rows.iter().map(|found| found.job.id).collect()
        };
        assert_eq!(jobs("desk"), [noise, capture, model]);
        assert_eq!((jobs("Noise"), jobs("short"), jobs("running")), (vec![noise], vec![capture], vec![noise]));
        let first = reader.find_jobs(&page(1)).unwrap().rows.remove(0);
        assert_eq!((first.capture.as_deref(), &*first.job.params), (Some("desk"), "{}"));
        world.store.delete_capture(made).unwrap();
        assert_eq!(diagnoses("too short"), [(capture, None)]);
    }

    #[test]
    fn a_model_is_found_by_its_name_and_id() {
        let world = World::new();
        for name in ["unit 7", "Unit 8", "model-1 again"] {
            world.store.keep_model(name, 40.0, format!("\"{name}\"")).unwrap();
        }
        let reader = world.reader();
        let found = |text: &str| -> Vec<String> {
            reader.find_models(&with(text)).unwrap().rows.into_iter().map(|row| row.id).collect()
        };
        assert_eq!(found("UNIT"), ["model-2", "model-1"]);
        assert_eq!(found("model-1"), ["model-3", "model-1"]);
        assert_eq!(reader.find_models(&page(1)).unwrap().rows.len(), 3);
    }
}
