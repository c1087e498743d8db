//! `vn100d check`: checks whether a database is intact and its accounting adds up.

use super::figures::counted;
use super::{Context, Outcome, print_json};
use crate::store::printable;
use std::io::Write as _;
use std::path::PathBuf;

/// Prints the findings; exit code 3 if there are any.
pub(super) fn run(context: &Context, database: Option<PathBuf>) -> anyhow::Result<Outcome> {
    let path = database.map_or_else(|| context.existing_database(), Ok)?;
    let report = crate::store::check(&path)?;
    let outcome = if report.is_clean() { Outcome::Done } else { Outcome::WithLoss };
    if context.json {
        let ok = report.is_clean();
        print_json(&serde_json::json!({
            "database": report.database, "ok": ok, "captures": report.captures, "findings": report.findings,
        }))?;
        return Ok(outcome);
    }
    let mut stdout = std::io::stdout().lock();
    for capture in &report.captures {
        write!(
            stdout,
            "capture {} `{}`: {}, {} missing, {} with the right checksum",
            capture.id,
            printable(&capture.name),
            counted(capture.samples, "sample", "samples"),
            capture.missing,
            counted(capture.batches, "batch", "batches")
        )?;
        match capture.without_checksum {
            0 => writeln!(stdout)?,
            count => writeln!(stdout, ", {} without one", counted(count, "sample", "samples"))?,
        }
    }
    for finding in &report.findings {
        let message = printable(&finding.message);
        match finding.capture {
            Some(capture) => writeln!(stdout, "{}: capture {capture}: {message}", finding.check)?,
            None => writeln!(stdout, "{}: {message}", finding.check)?,
        }
    }
    match report.findings.len() {
        0 => writeln!(stdout, "{}: all is well", report.database.display())?,
        count => writeln!(
            stdout,
            "{}: {count} findings; `vn100d recover {} --out FILE` salvages what is intact",
            report.database.display(),
            report.database.display()
        )?,
    }
    Ok(outcome)
}
