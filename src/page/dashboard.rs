//! The first page: the recording, its progress, the last minute, missing samples and their causes, the disk, jobs,
//! captures.

use super::figure::{clock, plain, size, span};
use super::{Kind, escaped, framed};
use crate::plot::spark;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The last minute of a channel, as far as data arrived.
#[derive(Debug, Clone, PartialEq)]
pub struct Minute<'a> {
    /// The channel's name and unit.
    pub channel: (&'a str, &'a str),
    /// Age in s, least and greatest value of each stretch, oldest first.
    pub points: Vec<(f64, f64, f64)>,
    /// The latest value.
    pub last: f64,
}

/// The contents of the page. Documents are JSON texts.
#[derive(Debug, Clone, Copy)]
pub struct DashboardView<'a> {
    /// `GET /v1/status`.
    pub status: &'a str,
    /// The last minute.
    pub minute: &'a [Minute<'a>],
    /// The error that the database reports; `None` if it does not answer.
    pub stored: Option<Stored<'a>>,
    /// Sample time of a capture without a given duration: `5h`.
    pub duration: &'a str,
    /// Whether requests need a token.
    pub token: bool,
}

/// The latest rows of the database, lists as the interface returns them.
#[derive(Debug, Clone, Copy)]
pub struct Stored<'a> {
    /// Captures.
    pub captures: &'a str,
    /// Jobs.
    pub jobs: &'a str,
    /// Diagnoses.
    pub diagnoses: &'a str,
    /// Samples missing in the running capture by cause, an object.
    pub causes: &'a str,
}

/// A minute, s, and the distance of its stretches.
const MINUTE_S: f64 = 60.0;
const STEP_S: f64 = 0.25;

#[derive(Debug, Deserialize)]
struct Status {
    version: String,
    #[serde(default)]
    uptime_s: f64,
    sensor: Sensor,
    capture: Option<Running>,
    storage: Storage,
    #[serde(default)]
    jobs: Jobs,
    #[serde(default)]
    schedule: Option<Schedule>,
    #[serde(default)]
    retention: Retention,
}

#[derive(Debug, Deserialize)]
struct Sensor {
    state: String,
    hint: Option<String>,
    port: Option<String>,
    model: Option<String>,
    serial_number: Option<String>,
    firmware: Option<String>,
    rate_hz: Option<f64>,
    output: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Running {
    id: i64,
    name: String,
    state: String,
    elapsed_s: f64,
    remaining_s: f64,
    samples: u64,
    missing: u64,
    gaps: u64,
    gap_open_since: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Storage {
    state: String,
    error: Option<String>,
    warning: Option<String>,
    #[serde(default)]
    free_bytes: u64,
    #[serde(default)]
    database_bytes: u64,
    time_to_full_s: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
struct Jobs {
    #[serde(default)]
    running: u64,
    #[serde(default)]
    queued: u64,
    #[serde(default)]
    failed: u64,
}

#[derive(Debug, Deserialize)]
struct Schedule {
    at: String,
    next_start: String,
    name: String,
    duration_s: f64,
    waits: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
struct Retention {
    #[serde(default)]
    next: Vec<Planned>,
}

#[derive(Debug, Deserialize)]
struct Planned {
    #[serde(default)]
    name: String,
}

#[derive(Debug, Deserialize)]
struct CaptureEntry {
    id: i64,
    name: String,
    state: String,
    started_at: Option<String>,
    #[serde(default)]
    duration_s: f64,
    #[serde(default)]
    samples: u64,
    #[serde(default)]
    missing: u64,
    rate_hz: Option<f64>,
    #[serde(default)]
    pinned: bool,
}

#[derive(Debug, Deserialize)]
struct JobEntry {
    id: i64,
    kind: String,
    capture: i64,
    state: String,
    #[serde(default)]
    progress: f64,
    error: Option<String>,
}

#[derive(Debug, Deserialize)]
struct DiagnosisEntry {
    id: i64,
    state: String,
    summary: Option<String>,
}

/// The whole page.
///
/// # Errors
/// What is missing in a text that is none of these documents.
pub fn dashboard(view: &DashboardView<'_>) -> Result<String, serde_json::Error> {
    let live = live(view)?;
    // Assistive technology announces problems in time to act, and also that the daemon does not answer.
    let mut out = format!("<p id=\"lost\" class=\"alarm\" role=\"alert\"></p><div id=\"live\">{live}</div>");
    wishes(&mut out, view);
    out += "<footer><a href=\"/v1/status\">status as JSON</a> · <a href=\"/v1/captures\">captures</a> · \
            <a href=\"/v1/jobs\">jobs</a> · <a href=\"/v1/diagnoses\">diagnoses</a> · <a href=\"/v1/models\">models</a> · \
            <a href=\"/metrics\">metrics</a> · <a href=\"/openapi.json\">the interface</a></footer>";
    Ok(framed("vn100d", Kind::Live(5), &out))
}

/// The part of the page that changes: sections, each with an id.
///
/// # Errors
/// What is missing in a text that is none of these documents.
pub fn live(view: &DashboardView<'_>) -> Result<String, serde_json::Error> {
    let status: Status = serde_json::from_str(view.status)?;
    let mut out = String::new();
    state(&mut out, &status, view.stored.map(|stored| serde_json::from_str(stored.causes)).transpose()?);
    minute(&mut out, view.minute);
    storage(&mut out, &status);
    let Some(stored) = view.stored else {
        out += "<section id=\"stored\"><p class=\"alarm\">The database does not answer: what it holds cannot be shown now.</p></section>";
        return Ok(out);
    };
    jobs(&mut out, &status.jobs, serde_json::from_str(stored.jobs)?);
    captures(&mut out, serde_json::from_str(stored.captures)?);
    diagnoses(&mut out, serde_json::from_str(stored.diagnoses)?);
    Ok(out)
}

fn state(out: &mut String, status: &Status, causes: Option<BTreeMap<String, u64>>) {
    let sensor = &status.sensor;
    let streams = sensor.state == "streaming";
    let sentence = match &status.capture {
        Some(of) if of.state == "waiting" => format!("Waiting to record {}.", of.name),
        Some(of) if streams && of.gap_open_since.is_none() => format!("Recording {}.", of.name),
        Some(of) => format!("{} is interrupted: the sensor is {}.", of.name, sensor.state.replace('_', " ")),
        None if streams => "The sensor sends, nothing is recorded.".to_owned(),
        None => format!("Nothing is recorded; the sensor is {}.", sensor.state.replace('_', " ")),
    };
    let trouble = !streams || status.storage.state != "ok";
    let class = match (&status.capture, trouble) {
        (_, true) => "alarm",
        (Some(_), false) => "good",
        (None, false) => "idle",
    };
    // Writing to a text cannot fail.
    let _ = write!(out, "<section id=\"state\"><h1 class=\"{class}\" aria-live=\"polite\">{}</h1>", escaped(&sentence));
    if let Some(hint) = &sensor.hint {
        let _ = write!(out, "<p class=\"alarm\">{}</p>", escaped(hint));
    }
    for told in [&status.storage.error, &status.storage.warning].into_iter().flatten() {
        let _ = write!(out, "<p class=\"alarm\">Disk: {}</p>", escaped(told));
    }
    if let Some(of) = &status.capture {
        progress(out, of, causes.unwrap_or_default());
    }
    if let Some(schedule) = &status.schedule {
        let Schedule { at, next_start, name, duration_s, waits } = schedule;
        let next = clock(next_start);
        let told = format!("Scheduled at {at}: {name}, {} from {next} UTC.", span(*duration_s));
        let _ = write!(out, "<p class=\"soft\">{}</p>", escaped(&told));
        if let Some(waits) = waits {
            let _ = write!(out, "<p class=\"alarm\">{}</p>", escaped(waits));
        }
    }
    let facts = [&sensor.model, &sensor.serial_number, &sensor.firmware, &sensor.port, &sensor.output];
    let mut facts: Vec<String> = facts.into_iter().flatten().map(|fact| escaped(fact)).collect();
    facts.extend(sensor.rate_hz.map(|rate| format!("{} Hz", plain(rate))));
    facts.push(format!("vn100d {}, up {}", escaped(&status.version), span(status.uptime_s)));
    let _ = write!(out, "<p class=\"soft\">{}</p></section>", facts.join(" · "));
}

fn progress(out: &mut String, of: &Running, causes: BTreeMap<String, u64>) {
    let whole = of.elapsed_s + of.remaining_s;
    let share = if whole > 0.0 { (of.elapsed_s / whole).clamp(0.0, 1.0) } else { 0.0 };
    let causes: Vec<String> = causes
        .iter()
        .filter(|(_, missing)| **missing > 0)
        .map(|(cause, missing)| format!("{missing} {}", escaped(&cause.replace('_', " "))))
        .collect();
    let causes = if causes.is_empty() { String::new() } else { format!(": {}", causes.join(", ")) };
    let gaps = match of.gaps {
        0 => "no sample missing".to_owned(),
        1 => format!("{} missing in one gap{causes}", of.missing),
        gaps => format!("{} missing in {gaps} gaps{causes}", of.missing),
    };
    let _ = write!(
        out,
        "<progress value=\"{share:.4}\" aria-label=\"progress of the capture\">{:.0} %</progress>\
         <p class=\"large\">{} of {}, {} to go</p><p><a href=\"/captures/{}\">{} samples</a>, {gaps}.</p>",
        100.0 * share,
        span(of.elapsed_s),
        span(whole),
        span(of.remaining_s),
        of.id,
        of.samples
    );
    if let Some(since) = &of.gap_open_since {
        let _ = write!(out, "<p class=\"alarm\">Nothing has come since {} UTC.</p>", escaped(&clock(since)));
    }
}

fn minute(out: &mut String, minute: &[Minute<'_>]) {
    *out += "<section id=\"minute\"><h2>The last minute</h2>";
    if minute.is_empty() {
        *out += "<p class=\"soft\">Nothing has come.</p></section>";
        return;
    }
    *out += "<div class=\"sparks\">";
    for of in minute {
        let (name, unit) = of.channel;
        let label = format!("{name} over the last minute");
        let _ = write!(
            out,
            "<div><span>{}</span><span class=\"value\">{} {}</span>{}</div>",
            escaped(name),
            crate::plot::number::rounded(of.last, 4),
            escaped(unit),
            spark(&label, &of.points, MINUTE_S, STEP_S)
        );
    }
    *out += "</div></section>";
}

fn storage(out: &mut String, status: &Status) {
    let of = &status.storage;
    let lasts = match of.time_to_full_s {
        Some(time_s) => format!(", enough for {} at this rate", span(time_s)),
        None => String::new(),
    };
    let _ = write!(
        out,
        "<section id=\"storage\"><h2>Disk</h2><p>{} free{lasts}; the database has {}.</p>",
        size(of.free_bytes as f64),
        size(of.database_bytes as f64)
    );
    if !status.retention.next.is_empty() {
        let names: Vec<String> = status.retention.next.iter().map(|one| escaped(&one.name)).collect();
        let _ =
            write!(out, "<p class=\"soft\">To be deleted next, to keep within the limits: {}.</p>", names.join(", "));
    }
    *out += "</section>";
}

fn jobs(out: &mut String, counts: &Jobs, jobs: Vec<JobEntry>) {
    let _ = write!(out, "<section id=\"jobs\"><h2>Jobs</h2>");
    let under_way: Vec<&JobEntry> =
        jobs.iter().filter(|job| matches!(job.state.as_str(), "running" | "queued" | "failed")).collect();
    if under_way.is_empty() && counts.running + counts.queued == 0 {
        *out += "<p class=\"soft\">None is under way.</p></section>";
        return;
    }
    let _ = write!(
        out,
        "<p class=\"soft\">{} running, {} queued, {} failed</p>",
        counts.running, counts.queued, counts.failed
    );
    *out += "<div class=\"wide\"><table><tr><th scope=\"col\">job</th><th scope=\"col\">capture</th><th scope=\"col\">state</th></tr>";
    for job in under_way {
        let state = match (job.state.as_str(), &job.error) {
            ("running", _) => format!(
                "<progress value=\"{:.3}\" aria-label=\"progress of job {}\">{:.0} %</progress>",
                job.progress.clamp(0.0, 1.0),
                job.id,
                100.0 * job.progress
            ),
            (_, Some(error)) => escaped(error),
            (state, None) => escaped(state),
        };
        let _ = write!(
            out,
            "<tr><td><a href=\"/v1/jobs/{}\">{}</a></td><td><a href=\"/captures/{2}\">{2}</a></td><td>{state}</td></tr>",
            job.id,
            escaped(&job.kind),
            job.capture
        );
    }
    *out += "</table></div></section>";
}

fn captures(out: &mut String, captures: Vec<CaptureEntry>) {
    *out += "<section id=\"captures\"><h2>Captures</h2>";
    if captures.is_empty() {
        *out += "<p class=\"soft\">There is none yet.</p></section>";
        return;
    }
    *out += "<div class=\"wide\"><table><tr><th scope=\"col\">name</th><th scope=\"col\">state</th><th scope=\"col\">begun (UTC)</th>\
             <th scope=\"col\" class=\"number\">duration</th><th scope=\"col\" class=\"number\">rate</th>\
             <th scope=\"col\" class=\"number\">samples</th><th scope=\"col\" class=\"number\">missing</th></tr>";
    for of in &captures {
        let _ = write!(
            out,
            "<tr><td><a href=\"/captures/{}\">{}</a>{}</td><td>{}</td><td>{}</td><td class=\"number\">{}</td>\
             <td class=\"number\">{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td></tr>",
            of.id,
            escaped(&of.name),
            if of.pinned { " <span class=\"soft\">(kept)</span>" } else { "" },
            escaped(&of.state),
            of.started_at.as_deref().map_or_else(|| "–".to_owned(), |at| escaped(&clock(at))),
            span(of.duration_s),
            of.rate_hz.map_or_else(|| "–".to_owned(), |rate| format!("{} Hz", plain(rate))),
            of.samples,
            of.missing
        );
    }
    *out += "</table></div></section>";
}

fn diagnoses(out: &mut String, diagnoses: Vec<DiagnosisEntry>) {
    if diagnoses.is_empty() {
        return;
    }
    *out += "<section id=\"diagnoses\"><h2>Simulator compared</h2><ul>";
    for of in &diagnoses {
        let told = of.summary.clone().unwrap_or_else(|| format!("diagnosis {}: {}", of.id, of.state));
        let _ = write!(out, "<li><a href=\"/diagnoses/{}\">{}</a></li>", of.id, escaped(&told));
    }
    *out += "</ul></section>";
}

/// Forms, which scripts show and send; users without scripts have curl.
fn wishes(out: &mut String, view: &DashboardView<'_>) {
    *out += "<section class=\"wishes\" aria-label=\"start and stop\" hidden><h2>Record</h2>";
    let _ = write!(
        out,
        "<form data-post=\"/v1/captures\" data-when=\"idle\"><label>name <input name=\"name\" maxlength=\"100\" placeholder=\"date and time\"></label>\
         <label>duration <input name=\"duration\" value=\"{}\" size=\"6\" required></label>\
         <label>begin at, by this clock <input name=\"start_at\" type=\"datetime-local\"></label><button>start</button></form>",
        escaped(view.duration)
    );
    *out += "<form data-post=\"/v1/captures/{id}/stop\" data-when=\"running\" data-ask=\"Stop the capture?\" hidden><button>stop</button></form>";
    *out += &token(view.token);
    *out += "<p class=\"said\" role=\"status\"></p></section>\
             <noscript><p class=\"soft\">To start: <code>curl --json '{\"duration\":\"5h\"}' http://ADDRESS/v1/captures</code></p></noscript>";
}

/// The field for the token, if one is needed.
pub(super) fn token(needed: bool) -> String {
    if needed {
        "<label>token <input class=\"token\" type=\"password\" autocomplete=\"off\"></label>".to_owned()
    } else {
        String::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn status(sensor: &str, capture: serde_json::Value) -> String {
        json!({"version": "1", "uptime_s": 90.0, "sensor": {"state": sensor, "hint": null, "port": "/dev/<tty>", "model": "VN-100",
            "serial_number": null, "firmware": null, "rate_hz": 40.0, "output": null}, "capture": capture,
            "storage": {"state": "ok", "error": null, "warning": null, "free_bytes": 2_500_000_000u64, "database_bytes": 1_000_000,
            "time_to_full_s": 864_000.0}, "jobs": {"running": 1, "queued": 0, "done": 0, "failed": 0}})
        .to_string()
    }

    fn running() -> serde_json::Value {
        json!({"id": 7, "name": "<script>", "state": "capturing", "elapsed_s": 3600.0, "remaining_s": 14_400.0,
            "samples": 143_990, "missing": 10, "gaps": 2, "gap_open_since": null})
    }

    fn shown(status: &str, stored: Option<Stored<'_>>) -> String {
        let points = vec![(30.0, -1.0, 1.0), (29.75, 0.0, 2.0)];
        let minute = [Minute { channel: ("gyro_x", "rad/s"), points, last: 0.5 }];
        dashboard(&DashboardView { status, minute: &minute, stored, duration: "5h", token: true }).unwrap()
    }

    const STORED: Stored<'_> = Stored {
        captures: r#"[{"id": 7, "name": "<script>", "state": "capturing", "started_at": "2026-11-23T20:00:00.5Z", "duration_s": 3600.0,
            "samples": 143990, "missing": 10, "rate_hz": 40.0, "pinned": true}]"#,
        jobs: r#"[{"id": 3, "kind": "noise", "capture": 6, "state": "running", "progress": 0.25, "error": null},
            {"id": 2, "kind": "allan", "capture": 6, "state": "done", "progress": 1.0, "error": null}]"#,
        diagnoses: r#"[{"id": 9, "state": "done", "summary": "a <b> is missing"}]"#,
        causes: r#"{"unplugged": 8, "host_stall": 2, "reset": 0}"#,
    };

    #[test]
    fn a_capture_that_runs_is_told_with_what_is_missing_and_why() {
        let page = shown(&status("streaming", running()), Some(STORED));
        for told in [
            "<h1 class=\"good\" aria-live=\"polite\">Recording &lt;script&gt;.</h1>",
            "1 h of 5 h, 4 h to go",
            "10 missing in 2 gaps: 2 host stall, 8 unplugged",
            "2.5 GB free, enough for 10 d at this rate",
            "<progress value=\"0.250\" aria-label=\"progress of job 3\">",
            "2026-11-23 20:00:00",
            "a &lt;b&gt; is missing",
            "gyro_x over the last minute",
        ] {
            assert!(page.contains(told), "{told}: {page}");
        }
        assert!(!page.contains("<script>") && !page.contains("<tty>") && !page.contains("/v1/jobs/2"));
    }

    #[test]
    fn trouble_is_the_first_thing_that_is_read() {
        let idle = shown(&status("absent", json!(null)), Some(STORED));
        assert!(
            idle.contains("<h1 class=\"alarm\" aria-live=\"polite\">Nothing is recorded; the sensor is absent.</h1>"),
            "{idle}"
        );
        let cut = shown(&status("stalled", running()), None);
        assert!(
            cut.contains("is interrupted: the sensor is stalled") && cut.contains("The database does not answer"),
            "{cut}"
        );
    }

    #[test]
    fn who_has_no_scripts_asks_again() {
        let page = shown(&status("streaming", json!(null)), Some(STORED));
        assert!(page.contains("<noscript><meta http-equiv=\"refresh\" content=\"5\"></noscript>"), "{page}");
        assert!(
            page.contains("class=\"wishes\" aria-label=\"start and stop\" hidden") && page.contains("class=\"token\"")
        );
    }
}
