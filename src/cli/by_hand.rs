//! `vn100d start`, `stop`, `pin`, `unpin`, `delete`, `rename` and `note`: what a person asks of the running daemon.

use super::args::{ClientArgs, DeleteArgs, NoteArgs, PinArgs, RenameArgs, StartArgs, StopArgs};
use super::client::{self, Change, shown};
use super::figures::counted;
use super::{Context, Outcome, failed, print_json, usage};
use crate::store::{check_name, check_note, printable};
use anyhow::Context as _;
use serde_json::{Map, Value, json};
use std::io::{BufRead, IsTerminal as _, Write};

/// The daemon that takes the changes.
struct Daemon {
    base_url: String,
    token: String,
}

impl Daemon {
    fn of(context: &Context, client: &ClientArgs) -> anyhow::Result<Self> {
        let listen = client.listen.as_deref();
        let base_url = context.daemon_url(listen)?;
        context.refuse_another(&base_url, client::PATIENCE)?;
        Ok(Self { base_url, token: context.token_for(listen)? })
    }

    fn ask(&self, how: Change, path: &str, body: Option<&Value>) -> anyhow::Result<Value> {
        Ok(client::change(&self.base_url, how, path, &self.token, body)?)
    }

    fn get(&self, path: &str) -> anyhow::Result<Value> {
        Ok(client::get(&self.base_url, path)?)
    }

    /// Returns these captures, each once. They are looked up before the first change: after a deletion, `latest` is
    /// another one.
    fn captures(&self, named: &[String]) -> anyhow::Result<Vec<Value>> {
        let mut rows: Vec<Value> = Vec::new();
        for named in named {
            let row = self.get(&path(named)?)?;
            if !rows.iter().any(|known| known["id"] == row["id"]) {
                rows.push(row);
            }
        }
        Ok(rows)
    }

    /// Returns the id of the capture that runs or waits. The database knows it at once, the status a moment later.
    fn open_capture(&self) -> anyhow::Result<Option<String>> {
        for state in ["capturing", "waiting"] {
            let found = self.get(&format!("/v1/captures?state={state}&limit=1"))?;
            if let Some(id) = found["captures"][0]["id"].as_i64() {
                return Ok(Some(id.to_string()));
            }
        }
        Ok(None)
    }
}

/// Returns the path of a capture.
fn path(capture: &str) -> anyhow::Result<String> {
    if capture.is_empty() {
        return Err(usage("the name of a capture is not empty: expected an id, a name or `latest`"));
    }
    Ok(format!("/v1/captures/{}", client::segment(capture)))
}

/// Returns a capture of an answer for display.
fn called(row: &Value) -> String {
    format!("capture {} `{}`", shown(&row["id"]), shown(&row["name"]))
}

/// Prints an answer: as JSON, or as a sentence.
fn tell(context: &Context, answer: &Value, sentence: &str) -> anyhow::Result<Outcome> {
    if context.json {
        print_json(answer)?;
    } else {
        client::print(sentence)?;
    }
    Ok(Outcome::Done)
}

/// Starts a capture.
pub(super) fn start(context: &Context, args: &StartArgs) -> anyhow::Result<Outcome> {
    if let Some(name) = &args.name {
        check_name(name).map_err(|error| usage(error.to_string()))?;
    }
    if let Some(note) = &args.note {
        check_note(note).map_err(|error| usage(error.to_string()))?;
    }
    let members = [
        ("duration", args.duration.clone()),
        ("name", args.name.clone()),
        ("note", args.note.clone()),
        ("start_at", args.at.map(|at| at.to_rfc3339())),
    ];
    let body: Map<String, Value> =
        members.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?.into()))).collect();
    let daemon = Daemon::of(context, &args.client)?;
    let row = daemon.ask(Change::Post, "/v1/captures", Some(&body.into()))?;
    tell(context, &row, &started(&row, args.name.as_deref()))
}

/// Returns what was started, and the name that was given instead of a taken one.
fn started(row: &Value, asked: Option<&str>) -> String {
    let begins = match row["start_at"].as_str() {
        Some(at) => format!("waits until {}", printable(at)),
        None => "begins".to_owned(),
    };
    let planned = row["planned_duration_s"].as_f64().and_then(|s| std::time::Duration::try_from_secs_f64(s).ok());
    let planned =
        planned.map_or_else(String::new, |of| format!(", {} of samples", imu_core::units::format_duration(of)));
    let taken = match asked.filter(|asked| row["name"].as_str() != Some(*asked)) {
        Some(asked) => format!(" (the name `{asked}` is taken)"),
        None => String::new(),
    };
    format!("{} {begins}{planned}{taken}", called(row))
}

/// Stops the named capture, or the one that runs or waits.
pub(super) fn stop(context: &Context, args: &StopArgs) -> anyhow::Result<Outcome> {
    let daemon = Daemon::of(context, &args.client)?;
    let named = match &args.capture {
        Some(named) => named.clone(),
        None => daemon.open_capture()?.ok_or_else(|| failed("no capture runs or waits: nothing to stop"))?,
    };
    let row = daemon.ask(Change::Post, &format!("{}/stop", path(&named)?), None)?;
    tell(context, &row, &format!("{} is stopped: {}, {} missing", called(&row), samples(&row), shown(&row["missing"])))
}

/// Protects captures from deletion, or ends the protection.
pub(super) fn pin(context: &Context, args: &PinArgs, pinned: bool) -> anyhow::Result<Outcome> {
    let how = if pinned { "is kept from deletion" } else { "may be deleted" };
    let daemon = Daemon::of(context, &args.client)?;
    each(context, &args.captures, |named| {
        let row = daemon.ask(Change::Patch, &path(named)?, Some(&json!({ "pinned": pinned })))?;
        let sentence = format!("{} {how}", called(&row));
        Ok((row, sentence))
    })
}

/// Deletes captures with their samples.
pub(super) fn delete(context: &Context, args: &DeleteArgs) -> anyhow::Result<Outcome> {
    let stdin = std::io::stdin();
    if !args.yes && !stdin.is_terminal() {
        return Err(usage(
            "standard input is no terminal, so that nobody can be asked: --yes deletes without a question",
        ));
    }
    let daemon = Daemon::of(context, &args.client)?;
    let rows = daemon.captures(&args.captures)?;
    if !args.yes && !is_wanted(&rows, &mut stdin.lock())? {
        return Err(failed("nothing is deleted"));
    }
    each(context, &rows, |row| {
        daemon.ask(Change::Delete, &path(&shown(&row["id"]))?, None)?;
        let answer = json!({ "id": row["id"], "name": row["name"], "deleted": true });
        Ok((answer, format!("{} is deleted", called(row))))
    })
}

fn samples(row: &Value) -> String {
    counted(row["samples"].as_u64().unwrap_or_default(), "sample", "samples")
}

/// Asks on the terminal whether these captures are to be deleted.
fn is_wanted(rows: &[Value], answers: &mut impl BufRead) -> std::io::Result<bool> {
    let mut question = std::io::stderr().lock();
    for row in rows {
        writeln!(question, "{}: {}", called(row), samples(row))?;
    }
    write!(question, "Delete with all samples, for good? [y/N] ")?;
    question.flush()?;
    let mut answer = String::new();
    answers.read_line(&mut answer)?;
    Ok(["y", "yes"].contains(&answer.trim().to_ascii_lowercase().as_str()))
}

/// Renames a capture.
pub(super) fn rename(context: &Context, args: &RenameArgs) -> anyhow::Result<Outcome> {
    check_name(&args.name).map_err(|error| usage(error.to_string()))?;
    let daemon = Daemon::of(context, &args.client)?;
    let row = daemon.ask(Change::Patch, &path(&args.capture)?, Some(&json!({ "name": args.name })))?;
    tell(context, &row, &format!("capture {} is named `{}`", shown(&row["id"]), shown(&row["name"])))
}

/// Writes or removes a capture's note.
pub(super) fn note(context: &Context, args: &NoteArgs) -> anyhow::Result<Outcome> {
    check_note(&args.text).map_err(|error| usage(error.to_string()))?;
    let daemon = Daemon::of(context, &args.client)?;
    let row = daemon.ask(Change::Patch, &path(&args.capture)?, Some(&json!({ "note": args.text })))?;
    let sentence = match row["note"].as_str() {
        Some(note) => format!("{}: {}", called(&row), printable(note)),
        None => format!("{} has no note", called(&row)),
    };
    tell(context, &row, &sentence)
}

/// Does this with each capture and prints each answer, also those before a failure, which states how many were done.
fn each<T>(
    context: &Context,
    captures: &[T],
    mut ask: impl FnMut(&T) -> anyhow::Result<(Value, String)>,
) -> anyhow::Result<Outcome> {
    let mut answers = Vec::new();
    let mut all = || -> anyhow::Result<Outcome> {
        for capture in captures {
            let done = answers.len();
            let asked = ask(capture);
            let (answer, sentence) = if done == 0 {
                asked?
            } else {
                asked.with_context(|| format!("{done} before it {} done", if done == 1 { "is" } else { "are" }))?
            };
            if !context.json {
                client::print(&sentence)?;
            }
            answers.push(answer);
        }
        Ok(Outcome::Done)
    };
    let outcome = all();
    if context.json && (outcome.is_ok() || !answers.is_empty()) {
        print_json(&answers)?;
    }
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_started_is_told_with_the_name_that_it_got() {
        let row = json!({"id": 3, "name": "desk-2", "planned_duration_s": 5400.0, "start_at": null});
        assert_eq!(
            started(&row, Some("desk")),
            "capture 3 `desk-2` begins, 1h30m of samples (the name `desk` is taken)"
        );
        let row = json!({"id": 3, "name": "desk", "planned_duration_s": 1.5, "start_at": "2027-01-15T08:00:00Z"});
        assert_eq!(started(&row, Some("desk")), "capture 3 `desk` waits until 2027-01-15T08:00:00Z, 1.5s of samples");
        assert!(!started(&row, None).contains("taken"));
    }

    #[test]
    fn what_a_daemon_says_does_not_command_the_terminal() {
        let row = json!({"id": "\u{1b}[1m", "name": "a\u{9b}2J\nb", "start_at": "\u{7}at", "planned_duration_s": 1.0});
        let text = started(&row, None);
        assert!(!text.contains(char::is_control), "{text:?}");
        assert_eq!(text, "capture [1m `a 2J b` waits until at, 1s of samples");
    }

    #[test]
    fn only_a_yes_deletes() {
        let wanted = |answer: &str| is_wanted(&[json!({"id": 1, "name": "x"})], &mut answer.as_bytes()).unwrap();
        assert!(wanted("y\n") && wanted("YES\n"));
        assert!(!["", "\n", "n\n", "yesterday\n"].into_iter().any(wanted));
    }

    #[test]
    fn a_name_is_one_segment_of_a_path() {
        assert_eq!(path("latest").unwrap(), "/v1/captures/latest");
        assert_eq!(path("../a b?#%é").unwrap(), "/v1/captures/%2E%2E%2Fa%20b%3F%23%25%C3%A9");
        assert!(path("").is_err());
    }
}
