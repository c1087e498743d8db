//! `vn100d recover`: salvages the intact part of a damaged database into a new one.

use super::args::RecoverArgs;
use super::figures::counted;
use super::{Context, Outcome, print_json};
use crate::store::printable;
use std::io::Write as _;

/// Salvages; exit code 3 if anything was lost or damaged.
pub(super) fn run(context: &Context, args: RecoverArgs) -> anyhow::Result<Outcome> {
    let path = args.database.map_or_else(|| context.existing_database(), Ok)?;
    let report = crate::store::recover(&path, &args.out, args.force)?;
    let outcome = if report.has_damage() { Outcome::WithLoss } else { Outcome::Done };
    if context.json {
        print_json(&report)?;
        return Ok(outcome);
    }
    let mut stdout = std::io::stdout().lock();
    for capture in &report.captures {
        writeln!(
            stdout,
            "capture {} `{}`: {} recovered in {}, {} lost in {}; {} recovered, {} lost",
            capture.id,
            printable(&capture.name),
            counted(capture.samples, "sample", "samples"),
            counted(capture.batches, "batch", "batches"),
            counted(capture.samples_lost, "sample", "samples"),
            counted(capture.batches_lost, "batch", "batches"),
            counted(capture.gaps, "gap", "gaps"),
            capture.gaps_lost
        )?;
        if capture.without_checksum > 0 {
            writeln!(
                stdout,
                "  of these {} of no batch: no checksum vouches for them",
                counted(capture.without_checksum, "sample is", "samples are")
            )?;
        }
    }
    let (pages, rows, frames) = (report.damaged_pages, report.damaged_rows, report.damaged_frames);
    if pages + rows + frames > 0 {
        let [pages, frames] = [pages, frames].map(|count| counted(count, "page", "pages"));
        let rows = counted(rows, "row", "rows");
        writeln!(stdout, "unreadable: {pages}, {rows} on other pages, {frames} of the log")?;
    }
    for finding in &report.findings {
        writeln!(stdout, "found: {}", printable(&finding.message))?;
    }
    writeln!(stdout, "{}: what is intact of {}", report.out.display(), report.database.display())?;
    Ok(outcome)
}
