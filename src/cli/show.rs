//! `vn100d show`: one capture with its segments, gaps and counts.

use super::{Context, Outcome, print_json, table};
use crate::clock::{Clock as _, SystemClock};
use crate::recording::{Options, load_columns};
use crate::store::{GapRow, Page, PageRequest, Reader, SegmentRow, StoreError};
use std::io::Write as _;
use std::path::Path;

/// Rows that a person is shown of a long list.
const SHOWN: usize = 20;

/// Prints the capture.
pub(super) fn run(context: &Context, capture: &str, rate_hz: Option<f64>) -> anyhow::Result<Outcome> {
    if Path::new(capture).is_file() {
        return recording(context, capture, rate_hz);
    }
    let reader = context.reader()?;
    let id = reader.resolve(capture)?;
    let row = reader.capture(id)?;
    if context.json {
        print_json(&row)?;
        return Ok(Outcome::Done);
    }
    let segments: Vec<SegmentRow> = all(|request| Reader::segments(&reader, id, request))?;
    let gaps: Vec<GapRow> = all(|request| Reader::gaps(&reader, id, request))?;
    let mut stdout = std::io::stdout().lock();
    let time = |time: Option<crate::store::UtcNs>| time.map_or_else(|| "–".to_owned(), |time| time.to_string());
    writeln!(stdout, "capture {} `{}`, {} from {}", row.id, row.name, row.state.name(), row.source)?;
    writeln!(stdout, "  from {} to {}", time(row.started_at), time(row.ended_at))?;
    writeln!(
        stdout,
        "  {:.3} s at {} Hz: {} samples, {} missing in {} gaps, {} segments",
        row.duration_s,
        row.rate_hz.map_or_else(|| "?".to_owned(), |rate| rate.to_string()),
        row.samples,
        row.missing,
        row.gaps,
        row.segments
    )?;
    for (cause, count) in &row.rejected {
        writeln!(stdout, "  rejected: {count} ({cause})")?;
    }
    for key in ["model", "serial_number", "firmware"] {
        if let Some(text) = row.sensor[key].as_str() {
            writeln!(stdout, "  {key}: {text}")?;
        }
    }
    if !gaps.is_empty() {
        let mut rows = table(&["gap from", "to", "missing", "exact", "cause"]);
        for gap in gaps.iter().take(SHOWN) {
            let cells = serde_json::to_value(gap)?;
            let cell = |key: &str| cells[key].as_str().map_or_else(|| cells[key].to_string(), str::to_owned);
            rows.add_row(["from", "to", "missing", "missing_exact", "cause"].map(cell));
        }
        writeln!(stdout, "{rows}")?;
        if gaps.len() > SHOWN {
            writeln!(stdout, "… and {} more gaps (--json or /v1/captures/{id}/gaps lists them)", gaps.len() - SHOWN)?;
        }
    }
    writeln!(stdout, "segments: {}", segments.len())?;
    Ok(Outcome::Done)
}

/// Prints what a recording's file would be as a capture.
fn recording(context: &Context, file: &str, rate_hz: Option<f64>) -> anyhow::Result<Outcome> {
    let recording = load_columns(Path::new(file), Options { rate_hz, started_utc_ns: SystemClock.utc_ns() })?;
    let info = &recording.info;
    let rejected = info.rejected.values().any(|count| *count > 0);
    if context.json {
        print_json(&serde_json::json!({
            "id": null,
            "name": file,
            "source": file,
            "duration_s": recording.duration_s(),
            "rate_hz": info.rate_hz,
            "rate_assumed": info.rate_assumed,
            "samples": recording.samples,
            "missing": recording.missing,
            "gaps": recording.gaps.len(),
            "segments": recording.segments.len(),
            "rejected": info.rejected,
            "channels": info.channels.iter().map(|channel| channel.name()).collect::<Vec<_>>(),
        }))?;
    } else {
        let mut stdout = std::io::stdout().lock();
        let assumed = if info.rate_assumed { " (assumed)" } else { "" };
        writeln!(
            stdout,
            "recording {file}: {:.3} s at {} Hz{assumed}, {} samples, {} missing in {} gaps, {} segments",
            recording.duration_s(),
            info.rate_hz,
            recording.samples,
            recording.missing,
            recording.gaps.len(),
            recording.segments.len()
        )?;
        for (cause, count) in &info.rejected {
            writeln!(stdout, "  rejected: {count} ({})", cause.name())?;
        }
    }
    Ok(if rejected { Outcome::WithLoss } else { Outcome::Done })
}

/// Every item of a list that comes in pages.
fn all<T>(mut page: impl FnMut(&PageRequest) -> Result<Page<T>, StoreError>) -> Result<Vec<T>, StoreError> {
    let (mut items, mut request) = (Vec::new(), PageRequest::first());
    loop {
        let next = page(&request)?;
        items.extend(next.rows);
        match next.next {
            Some(cursor) => request.cursor = Some(cursor),
            None => return Ok(items),
        }
    }
}
