//! `vn100d captures`: the list.

use super::figures::{hertz, to_the_second};
use super::{Context, Outcome, all, print_json, table};
use crate::store::printable;
use std::io::Write as _;

/// Prints all captures, newest first.
pub(super) fn run(context: &Context) -> anyhow::Result<Outcome> {
    let reader = context.reader()?;
    let captures = all(|page| reader.captures(None, page))?;
    if context.json {
        print_json(&serde_json::json!({ "captures": captures, "next": null }))?;
        return Ok(Outcome::Done);
    }
    let mut header = vec!["id", "name", "state", "started", "duration s", "rate Hz", "samples", "missing", "gaps"];
    // The column is shown only if there are planned deletions.
    let deletions = captures.iter().any(|capture| capture.delete_at.is_some());
    if deletions {
        header.push("will be deleted on");
    }
    // So is that of the notes.
    let notes = captures.iter().any(|capture| capture.note.is_some());
    if notes {
        header.push("note");
    }
    let mut rows = table(&header);
    for capture in &captures {
        let mut cells = vec![
            capture.id.to_string(),
            printable(&capture.name),
            capture.state.name().to_owned(),
            capture.started_at.map(|time| to_the_second(&time.to_string())).unwrap_or_default(),
            format!("{:.1}", capture.duration_s),
            capture.rate_hz.map(|rate| hertz(rate).trim_end_matches(" Hz").to_owned()).unwrap_or_default(),
            capture.samples.to_string(),
            capture.missing.to_string(),
            capture.gaps.to_string(),
        ];
        if deletions {
            cells.push(capture.delete_at.map(|time| time.to_string()).unwrap_or_default());
        }
        if notes {
            cells.push(capture.note.as_deref().map(printable).unwrap_or_default());
        }
        rows.add_row(cells);
    }
    writeln!(std::io::stdout(), "{rows}")?;
    Ok(Outcome::Done)
}
