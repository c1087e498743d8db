//! The first page: the recording, its progress, the last minute, missing samples and their causes, the disk, jobs,
//! captures.

use super::figure::{clock, plain, size, span};
use super::{Kind, escaped, framed};
use crate::observe::{CaptureStatus, JobsStatus, ScheduleStatus, SensorState, Status, StorageState, Trace};
use crate::plot::spark;
use crate::store::{CaptureRow, DiagnosisRow, JobRow, JobState};
use imu_core::units::counted;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The contents of the page.
#[derive(Debug, Clone, Copy)]
pub struct DashboardView<'a> {
    /// The status of sensor, capture, store and jobs.
    pub status: &'a Status,
    /// Age of the process, s.
    pub uptime_s: f64,
    /// The last minute.
    pub minute: &'a [Trace],
    /// `None` if the database does not answer.
    pub stored: Option<&'a Stored>,
    /// Sample time of a capture without a given duration: `5h`.
    pub duration: &'a str,
    /// Whether requests need a token.
    pub token: bool,
}

/// The latest rows of the database.
#[derive(Debug, Clone)]
pub struct Stored {
    /// Captures.
    pub captures: Vec<CaptureRow>,
    /// Jobs.
    pub jobs: Vec<JobRow>,
    /// Diagnoses.
    pub diagnoses: Vec<DiagnosisRow>,
    /// Samples missing in the running capture by cause.
    pub causes: BTreeMap<String, u64>,
}

/// A minute, and the distance of its stretches, s.
const MINUTE_S: f64 = 60.0;
const STEP_S: f64 = 0.25;

/// Returns the whole page.
pub fn dashboard(view: &DashboardView<'_>) -> String {
    let live = live(view);
    // Assistive technology announces problems in time to act, and also that the daemon does not answer.
    let mut out = format!("<p id=\"lost\" class=\"alarm\" role=\"alert\"></p><div id=\"live\">{live}</div>");
    controls(&mut out, view);
    out += "<footer>As JSON: <a href=\"/v1/status\">status</a> · <a href=\"/v1/captures\">captures</a> · \
            <a href=\"/v1/jobs\">jobs</a> · <a href=\"/v1/diagnoses\">diagnoses</a> · <a href=\"/v1/models\">models</a> · \
            <a href=\"/metrics\">metrics</a> · <a href=\"/openapi.json\">the interface</a></footer>";
    framed("vn100d", Kind::Live(5), &out)
}

/// Returns the part of the page that changes: sections, each with an id.
pub fn live(view: &DashboardView<'_>) -> String {
    let mut out = String::new();
    state(&mut out, view);
    minute(&mut out, view.minute);
    storage(&mut out, view.status);
    let Some(stored) = view.stored else {
        out += "<section id=\"stored\"><p class=\"alarm\">The database does not answer: what it holds cannot be shown now.</p></section>";
        return out;
    };
    jobs(&mut out, &view.status.jobs, &stored.jobs);
    captures(&mut out, &stored.captures);
    diagnoses(&mut out, &stored.diagnoses);
    out
}

fn state(out: &mut String, view: &DashboardView<'_>) {
    let (status, sensor) = (view.status, &view.status.sensor);
    let (streams, now) = (sensor.state == SensorState::Streaming, sensor.state.name().replace('_', " "));
    let sentence = match &status.capture {
        Some(of) if of.state == "waiting" => format!("Waiting to record {}.", of.name),
        Some(of) if streams && of.gap_open_since.is_none() => format!("Recording {}.", of.name),
        Some(of) => format!("{} is interrupted: the sensor is {now}.", of.name),
        None if streams => "The sensor sends, nothing is recorded.".to_owned(),
        None => format!("Nothing is recorded; the sensor is {now}."),
    };
    let trouble = !streams || status.storage.state != StorageState::Ok;
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
    for message in [&status.storage.error, &status.storage.warning].into_iter().flatten() {
        let _ = write!(out, "<p class=\"alarm\">Disk: {}</p>", escaped(message));
    }
    if let Some(of) = &status.capture {
        progress(out, of, view.stored.iter().flat_map(|stored| &stored.causes));
    }
    if let Some(schedule) = &status.schedule {
        let ScheduleStatus { at, next_start, name, duration_s, waits } = schedule;
        let next = clock(next_start);
        let summary = format!("Scheduled at {at}: {name}, {} from {next} UTC.", span(*duration_s));
        let _ = write!(out, "<p class=\"soft\">{}</p>", escaped(&summary));
        if let Some(waits) = waits {
            let _ = write!(out, "<p class=\"alarm\">{}</p>", escaped(waits));
        }
    }
    let facts = [&sensor.model, &sensor.serial_number, &sensor.firmware, &sensor.port, &sensor.output];
    let mut facts: Vec<String> = facts.into_iter().flatten().map(|fact| escaped(fact)).collect();
    facts.extend(sensor.rate_hz.map(|rate| format!("{} Hz", plain(rate))));
    facts.push(format!("vn100d {}, up {}", env!("CARGO_PKG_VERSION"), span(view.uptime_s)));
    let _ = write!(out, "<p class=\"soft\">{}</p></section>", facts.join(" · "));
}

fn progress<'a>(out: &mut String, of: &CaptureStatus, causes: impl Iterator<Item = (&'a String, &'a u64)>) {
    let whole = of.elapsed_s + of.remaining_s;
    let share = if whole > 0.0 { (of.elapsed_s / whole).clamp(0.0, 1.0) } else { 0.0 };
    let causes: Vec<String> = causes
        .filter(|(_, missing)| **missing > 0)
        .map(|(cause, missing)| format!("{missing} {}", escaped(&cause.replace('_', " "))))
        .collect();
    let causes = if causes.is_empty() { String::new() } else { format!(": {}", causes.join(", ")) };
    let gaps = match of.gaps {
        0 => "no sample missing".to_owned(),
        1 => format!("{} missing in one gap{causes}", of.missing),
        gaps => format!("{} missing in {gaps} gaps{causes}", of.missing),
    };
    let samples = counted(of.samples, "sample", "samples");
    let _ = write!(
        out,
        "<progress value=\"{share:.4}\" aria-label=\"progress of the capture\">{:.0} %</progress>\
         <p class=\"large\">{} of {}, {} to go</p><p><a href=\"/captures/{}\">{samples}</a>, {gaps}.</p>",
        100.0 * share,
        span(of.elapsed_s),
        span(whole),
        span(of.remaining_s),
        of.id
    );
    if let Some(since) = &of.gap_open_since {
        let _ = write!(out, "<p class=\"alarm\">Nothing has come since {} UTC.</p>", escaped(&clock(since)));
    }
}

fn minute(out: &mut String, minute: &[Trace]) {
    *out += "<section id=\"minute\"><h2>The last minute</h2>";
    if minute.is_empty() {
        *out += "<p class=\"soft\">Nothing has come.</p></section>";
        return;
    }
    *out += "<div class=\"sparks\">";
    for of in minute {
        let (name, unit) = (of.channel.name(), of.channel.unit());
        let label = format!("{name} over the last minute");
        let _ = write!(
            out,
            "<div><span>{}</span><span class=\"value\">{} {}</span>{}</div>",
            name,
            crate::plot::number::rounded(of.last, 4),
            unit,
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
    if !status.retention.planned.is_empty() {
        const NAMED: usize = 5;
        let planned = &status.retention.planned;
        let names: Vec<String> = planned.iter().take(NAMED).map(|one| escaped(&one.name)).collect();
        let more = match status.retention.planned_total.saturating_sub(names.len() as u64) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let names = names.join(", ");
        let _ = write!(out, "<p class=\"soft\">To be deleted next, to keep within the limits: {names}{more}.</p>");
    }
    *out += "</section>";
}

fn jobs(out: &mut String, counts: &JobsStatus, jobs: &[JobRow]) {
    let _ = write!(out, "<section id=\"jobs\"><h2>Jobs</h2>");
    let is_shown = |job: &&JobRow| matches!(job.state, JobState::Running | JobState::Queued | JobState::Failed);
    let under_way: Vec<&JobRow> = jobs.iter().filter(is_shown).collect();
    if under_way.is_empty() && counts.running + counts.queued == 0 {
        *out += "<p class=\"soft\">None is under way.</p><p><a href=\"/jobs\">all jobs</a></p></section>";
        return;
    }
    let _ = write!(
        out,
        "<p class=\"soft\">{} running, {} queued, {} failed</p>",
        counts.running, counts.queued, counts.failed
    );
    *out += "<div class=\"wide\"><table><tr><th scope=\"col\">job</th><th scope=\"col\">capture</th><th scope=\"col\">state</th></tr>";
    for job in under_way {
        let state = match (job.state, &job.error) {
            (JobState::Running, _) => format!(
                "<progress value=\"{:.3}\" aria-label=\"progress of job {}\">{:.0} %</progress>",
                job.progress.clamp(0.0, 1.0),
                job.id,
                100.0 * job.progress
            ),
            (_, Some(error)) => escaped(error),
            (state, None) => state.name().to_owned(),
        };
        let _ = write!(
            out,
            "<tr><td><a href=\"/v1/jobs/{}\">{}</a></td><td><a href=\"/captures/{2}\">{2}</a></td><td>{state}</td></tr>",
            job.id,
            job.kind.name(),
            job.capture
        );
    }
    *out += "</table></div><p><a href=\"/jobs\">all jobs</a></p></section>";
}

fn captures(out: &mut String, captures: &[CaptureRow]) {
    *out += "<section id=\"captures\"><h2>Captures</h2>";
    if captures.is_empty() {
        *out += "<p class=\"soft\">There is none yet.</p></section>";
        return;
    }
    *out += "<div class=\"wide\"><table><tr><th scope=\"col\">name</th><th scope=\"col\">state</th><th scope=\"col\">begun (UTC)</th>\
             <th scope=\"col\" class=\"number\">duration</th><th scope=\"col\" class=\"number\">rate</th>\
             <th scope=\"col\" class=\"number\">samples</th><th scope=\"col\" class=\"number\">missing</th></tr>";
    for of in captures {
        let _ = write!(
            out,
            "<tr><td><a href=\"/captures/{}\">{}</a>{}</td><td>{}</td><td>{}</td><td class=\"number\">{}</td>\
             <td class=\"number\">{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td></tr>",
            of.id,
            escaped(&of.name),
            note(of),
            of.state.name(),
            of.started_at.map_or_else(|| "–".to_owned(), |at| clock(&at.to_string())),
            span(of.duration_s),
            of.rate_hz.map_or_else(|| "–".to_owned(), |rate| format!("{} Hz", plain(rate))),
            of.samples,
            of.missing
        );
    }
    *out += "</table></div><p><a href=\"/captures\">all captures</a></p></section>";
}

/// Returns what a row says behind the name.
fn note(of: &CaptureRow) -> String {
    let kept = if of.pinned { " <span class=\"soft\">(kept)</span>" } else { "" };
    match &of.note {
        Some(note) => format!("{kept}<br><span class=\"soft\">{}</span>", escaped(note)),
        None => kept.to_owned(),
    }
}

fn diagnoses(out: &mut String, diagnoses: &[DiagnosisRow]) {
    if diagnoses.is_empty() {
        return;
    }
    *out += "<section id=\"diagnoses\"><h2>Simulator compared</h2><ul>";
    for of in diagnoses {
        let _ = write!(out, "<li><a href=\"/diagnoses/{}\">{}</a></li>", of.job.id, escaped(&of.summary_or_state()));
    }
    *out += "</ul><p><a href=\"/diagnoses\">all diagnoses</a></p></section>";
}

/// Writes the forms, which scripts show and send; users without scripts have curl.
fn controls(out: &mut String, view: &DashboardView<'_>) {
    *out += "<section class=\"controls\" aria-label=\"start and stop\" hidden><h2>Record</h2>";
    let _ = write!(
        out,
        "<form data-post=\"/v1/captures\" data-when=\"idle\"><label>name <input name=\"name\" maxlength=\"100\" placeholder=\"date and time\"></label>\
         <label>note <input name=\"note\" maxlength=\"1000\" placeholder=\"on foam, 23 °C\"></label>\
         <label>duration <input name=\"duration\" value=\"{}\" size=\"6\" required></label>\
         <label>begin at, by this clock <input name=\"start_at\" type=\"datetime-local\"></label><button>start</button></form>",
        escaped(view.duration)
    );
    *out += "<form data-post=\"/v1/captures/{id}/stop\" data-when=\"running\" data-ask=\"Stop the capture?\" hidden><button>stop</button></form>";
    *out += &token(view.token);
    *out += "<p class=\"said\" role=\"status\"></p></section>\
             <noscript><p class=\"soft\">To start: <code>curl --json '{\"duration\":\"5h\"}' http://ADDRESS/v1/captures</code></p></noscript>";
}

/// Returns the field for the token, if one is needed.
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
    use crate::observe::{PlannedDeletion, SensorStatus, StorageStatus};
    use crate::page::rows;
    use crate::store::CaptureState;
    use imu_core::sample::Channel;

    fn status(state: SensorState, capture: Option<CaptureStatus>) -> Status {
        let port = Some("/dev/<tty>".to_owned());
        let (database_bytes, time_to_full_s) = (1_000_000, Some(864_000.0));
        let mut status = Status {
            sensor: SensorStatus { state, port, rate_hz: Some(40.0), ..SensorStatus::default() },
            capture,
            storage: StorageStatus { free_bytes: 2_500_000_000, database_bytes, time_to_full_s, ..Default::default() },
            jobs: JobsStatus { running: 1, ..JobsStatus::default() },
            ..Status::default()
        };
        status.retention.planned.push(PlannedDeletion {
            capture: 5,
            name: "<old>".to_owned(),
            bytes: 1,
            reason: "age".to_owned(),
            delete_at: "2026-11-24T00:00:00Z".to_owned(),
        });
        status
    }

    fn running() -> Option<CaptureStatus> {
        Some(CaptureStatus {
            id: 7,
            name: "<script>".to_owned(),
            state: "capturing".to_owned(),
            elapsed_s: 3600.0,
            remaining_s: 14_400.0,
            samples: 143_990,
            missing: 10,
            gaps: 2,
            received: 143_990,
            committed: 143_990,
            in_flight: 0,
            discarded: BTreeMap::new(),
            last_sample_age_s: None,
            gap_open_since: None,
        })
    }

    fn shown(status: &Status, stored: Option<&Stored>) -> String {
        let points = vec![(30.0, -1.0, 1.0), (29.75, 0.0, 2.0)];
        let minute = [Trace { channel: Channel::GyroX, points, last: 0.5 }];
        dashboard(&DashboardView { status, uptime_s: 90.0, minute: &minute, stored, duration: "5h", token: true })
    }

    fn stored() -> Stored {
        Stored {
            captures: vec![CaptureRow { state: CaptureState::Capturing, pinned: true, ..rows::capture() }],
            jobs: vec![
                rows::job(3, crate::store::JobKind::Noise, JobState::Running),
                rows::job(2, crate::store::JobKind::Allan, JobState::Done),
            ],
            diagnoses: vec![rows::diagnosis("a <b> is missing")],
            causes: [("unplugged", 8), ("host_stall", 2), ("reset", 0)].map(|(of, n)| (of.to_owned(), n)).into(),
        }
    }

    #[test]
    fn a_running_capture_is_shown_with_what_is_missing_and_why() {
        let page = shown(&status(SensorState::Streaming, running()), Some(&stored()));
        for expected in [
            "<h1 class=\"good\" aria-live=\"polite\">Recording &lt;script&gt;.</h1>",
            "1 h of 5 h, 4 h to go",
            "10 missing in 2 gaps: 2 host stall, 8 unplugged",
            "2.5 GB free, enough for 10 d at this rate",
            "<progress value=\"0.250\" aria-label=\"progress of job 3\">",
            "2026-11-23 20:00:00",
            "(kept)</span><br><span class=\"soft\">on &lt;foam&gt;, 23 °C</span>",
            "a &lt;b&gt; is missing",
            "To be deleted next, to keep within the limits: &lt;old&gt;.",
            "gyro_x over the last minute",
        ] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        assert!(!page.contains("<script>") && !page.contains("<tty>") && !page.contains("/v1/jobs/2"));
    }

    #[test]
    fn trouble_is_the_first_thing_that_is_read() {
        let idle = shown(&status(SensorState::Absent, None), Some(&stored()));
        assert!(
            idle.contains("<h1 class=\"alarm\" aria-live=\"polite\">Nothing is recorded; the sensor is absent.</h1>"),
            "{idle}"
        );
        let cut = shown(&status(SensorState::Stalled, running()), None);
        assert!(
            cut.contains("is interrupted: the sensor is stalled") && cut.contains("The database does not answer"),
            "{cut}"
        );
    }

    #[test]
    fn who_has_no_scripts_asks_again() {
        let page = shown(&status(SensorState::Streaming, None), Some(&stored()));
        assert!(page.contains("<noscript><meta http-equiv=\"refresh\" content=\"5\"></noscript>"), "{page}");
        assert!(
            page.contains("class=\"controls\" aria-label=\"start and stop\" hidden")
                && page.contains("class=\"token\"")
        );
    }
}
