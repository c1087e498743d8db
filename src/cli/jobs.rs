//! `vn100d jobs`: the running daemon's background work.

use super::client::{self, ClientError, shown};
use super::figures::to_the_second;
use super::table::Table;
use serde_json::Value;

/// Queries the daemon at `base_url` (`http://127.0.0.1:8100`) and prints its latest 100 jobs as a table, or as the JSON
/// of `GET /v1/jobs`.
///
/// # Errors
/// [`ClientError`]; [`ClientError::is_unreachable`] is exit code 69.
pub fn run(base_url: &str, json: bool) -> Result<(), ClientError> {
    let answer = client::get(base_url, "/v1/jobs")?;
    if json {
        return client::print(&answer.to_string());
    }
    match answer["jobs"].as_array().map_or(&[][..], Vec::as_slice) {
        [] => client::print("There are no jobs."),
        jobs => client::print(&table(jobs).to_string()),
    }
}

fn table(jobs: &[Value]) -> Table {
    let mut table = Table::new(&["job", "kind", "capture", "state", "progress", "submitted", "result"]);
    for job in jobs {
        let progress = job["progress"].as_f64().map_or_else(|| "–".to_owned(), |part| format!("{:.0} %", part * 100.0));
        let outcome = if job["error"].is_null() { &job["result"] } else { &job["error"] };
        table.add_row([
            shown(&job["id"]),
            shown(&job["kind"]),
            shown(&job["capture"]),
            shown(&job["state"]),
            progress,
            seconds(&job["created_at"]),
            shown(outcome),
        ]);
    }
    table
}

/// Returns a time without its fraction of a second.
fn seconds(time: &Value) -> String {
    time.as_str().map_or_else(|| shown(time), to_the_second)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_job_is_a_line_with_what_came_of_it() {
        let jobs = [
            serde_json::json!({"id": 2, "kind": "allan", "capture": 1, "state": "running", "progress": 0.614,
                "created_at": "2026-11-21T20:00:00.123456789Z", "error": null, "result": null}),
            serde_json::json!({"id": 1, "kind": "allan", "capture": 1, "state": "failed", "progress": 0,
                "created_at": "2026-11-21T19:00:00.000000000Z", "error": "no samples", "result": null}),
        ];
        let text = table(&jobs).to_string();
        let lines: Vec<&str> = text.lines().filter(|line| line.starts_with('│')).collect();
        assert_eq!(lines.len(), 3, "{text}");
        for part in ["61 %", "2026-11-21T20:00:00Z", "running", "–"] {
            assert!(lines[1].contains(part), "{part} in {}", lines[1]);
        }
        assert!(lines[2].contains("no samples"), "{}", lines[2]);
        let narrow = table(&jobs).at_most(60).to_string();
        assert!(narrow.lines().all(|line| line.chars().count() <= 60) && narrow.contains("no samples"), "{narrow}");
    }
}
