//! `vn100d show`: one capture with its segments, gaps and counts.

use super::figures::{counted, hertz};
use super::source::{Source, has_rejected};
use super::{Context, Outcome, all, print_json, table};
use crate::store::{DeviceClockRow, EventRow, GapRow, Page, PageRequest, Reader, SegmentRow, printable};
use imu_core::sample::GapCause;
use imu_core::sample::audit::{Report, Unchecked};
use imu_files::recording::{KeepOn, LoadedRecording, columns};
use std::collections::BTreeMap;
use std::io::Write as _;

/// Maximum number of rows shown of a long list.
const SHOWN: usize = 20;
/// Number of rejected lines shown, and number of characters of each.
const REJECTED_SHOWN: usize = 5;
const REJECTED_CHARS: usize = 90;

/// Prints the capture.
pub(super) fn run(context: &Context, capture: &str, rate_hz: Option<f64>) -> anyhow::Result<Outcome> {
    let (reader, row) = match Source::open(context, capture, rate_hz, KeepOn::default())? {
        Source::Recording(recording) => return show_recording(context, capture, &columns(&recording)?),
        Source::Capture(reader, row) => (reader, row),
    };
    let id = row.id;
    // As of the last commit: only the running daemon knows the samples in flight.
    let accounting = reader.accounting(id)?;
    let clocks = reader.device_clocks(id)?;
    if context.json {
        let mut shown = serde_json::to_value(&row)?;
        shown["accounting"] = serde_json::to_value(&accounting)?;
        shown["clocks"] = serde_json::to_value(&clocks)?;
        print_json(&shown)?;
        return Ok(Outcome::Done);
    }
    let segments: Vec<SegmentRow> = all(|request| Reader::segments(&reader, id, request))?;
    let gaps: Vec<GapRow> = all(|request| Reader::gaps(&reader, id, request))?;
    let mut stdout = std::io::stdout().lock();
    let time = |time: Option<crate::store::UtcNs>| time.map_or_else(|| "–".to_owned(), |time| time.to_string());
    let [name, source] = [&row.name, &row.source].map(|text| printable(text));
    writeln!(stdout, "capture {} `{name}`, {} from {source}", row.id, row.state.name())?;
    if let Some(note) = &row.note {
        writeln!(stdout, "  note: {}", printable(note))?;
    }
    writeln!(stdout, "  from {} to {}", time(row.started_at), time(row.ended_at))?;
    writeln!(
        stdout,
        "  {:.3} s at {}: {}, {} missing in {}, {}",
        row.duration_s,
        row.rate_hz.map_or_else(|| "? Hz".to_owned(), hertz),
        counted(row.samples, "sample", "samples"),
        row.missing,
        counted(row.gaps, "gap", "gaps"),
        counted(row.segments, "segment", "segments")
    )?;
    for (cause, count) in &row.rejected {
        writeln!(stdout, "  rejected: {count} ({})", printable(cause))?;
    }
    if !row.rejected.is_empty() {
        let events: Page<EventRow> = reader.events(id, &PageRequest::first())?;
        for event in events.rows.iter().filter(|event| event.kind == "rejected").take(REJECTED_SHOWN) {
            let text = event.detail.as_ref().and_then(|detail| detail["text"].as_str()).unwrap_or_default();
            let text: String = text.chars().take(REJECTED_CHARS).collect();
            writeln!(stdout, "    {}: {}", printable(&event.message), printable(&text))?;
        }
    }
    for remark in row.configuration.remarks() {
        writeln!(stdout, "  {}", printable(remark))?;
    }
    if row.pinned {
        writeln!(stdout, "  pinned: kept from deletion")?;
    } else if let Some(delete_at) = row.delete_at {
        writeln!(stdout, "  will be deleted on {delete_at} unless it is pinned")?;
    }
    let (sensor, keys) = (&row.sensor, ["model", "serial_number", "firmware"]);
    for (key, text) in keys.into_iter().zip([sensor.model(), sensor.serial_number(), sensor.firmware()]) {
        if let Some(text) = text {
            writeln!(stdout, "  {key}: {}", printable(text))?;
        }
    }
    for DeviceClockRow { epoch, estimate } in &clocks {
        writeln!(
            stdout,
            "  sensor's clock in epoch {epoch}: {:+.2} ± {:.2} ppm against the host's over {:.0} s; latency {:.1} ms, at most {:.1} ms",
            estimate.skew_ppm,
            estimate.skew_ppm_uncertainty,
            estimate.span_s,
            estimate.latency_mean_ms,
            estimate.latency_max_ms
        )?;
    }
    for line in accounting_lines(&accounting) {
        writeln!(stdout, "  {line}")?;
    }
    for line in by_cause(gaps.iter().map(|gap| (gap.cause, gap.missing))) {
        writeln!(stdout, "  {line}")?;
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
            let more = counted((gaps.len() - SHOWN) as u64, "more gap", "more gaps");
            writeln!(stdout, "… and {more} (--json or /v1/captures/{id}/gaps lists them)")?;
        }
    }
    writeln!(stdout, "segments: {}", segments.len())?;
    Ok(Outcome::Done)
}

/// Returns both identities for display.
fn accounting_lines(report: &Report) -> Vec<String> {
    let discarded: u64 = report.discarded.values().sum();
    let mut lines = Vec::new();
    if let Some(received) = report.received {
        lines.push(format!("received {received} = {} committed + {discarded} discarded", report.committed));
    }
    lines.push(format!("expected {} = {} received + {} missing", report.expected, report.committed, report.missing));
    for unchecked in &report.unchecked {
        let Unchecked { reason, samples, missing } = unchecked;
        let samples = counted(*samples, "sample", "samples");
        lines.push(format!("not checked by the sensor's ticks: {samples}, {missing} missing ({reason})"));
    }
    lines.extend(report.violations.iter().map(|violation| format!("DOES NOT AGREE: {violation}")));
    lines
}

/// Prints the capture that a recording's file would become.
fn show_recording(context: &Context, file: &str, recording: &LoadedRecording) -> anyhow::Result<Outcome> {
    let info = &recording.info;
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
            "recording {}: {:.3} s at {}{assumed}, {}, {} missing in {}, {}",
            printable(file),
            recording.duration_s(),
            hertz(info.rate_hz),
            counted(recording.samples, "sample", "samples"),
            recording.missing,
            counted(recording.gaps.len() as u64, "gap", "gaps"),
            counted(recording.segments.len() as u64, "segment", "segments")
        )?;
        for (cause, count) in &info.rejected {
            writeln!(stdout, "  rejected: {count} ({})", cause.name())?;
        }
        for rejected in info.first_rejected.iter().take(REJECTED_SHOWN) {
            let text: String = rejected.text.chars().take(REJECTED_CHARS).collect();
            writeln!(stdout, "    {} {}: {}", info.kind.entry(), rejected.line, printable(&text))?;
        }
        for remark in info.remarks() {
            writeln!(stdout, "  {}", printable(&remark))?;
        }
        for line in by_cause(recording.gaps.iter().map(|gap| (gap.cause, gap.missing))) {
            writeln!(stdout, "  {line}")?;
        }
    }
    Ok(if has_rejected(info) { Outcome::WithLoss } else { Outcome::Done })
}

/// Returns one line per cause of gaps.
fn by_cause(gaps: impl Iterator<Item = (GapCause, u64)>) -> Vec<String> {
    let mut causes = BTreeMap::<&str, (u64, u64)>::new();
    for (cause, missing) in gaps {
        let (gaps, sum) = causes.entry(cause.name()).or_default();
        *gaps += 1;
        *sum += missing;
    }
    causes
        .iter()
        .map(|(cause, (gaps, missing))| format!("{} by {cause}: {missing} missing", counted(*gaps, "gap", "gaps")))
        .collect()
}
