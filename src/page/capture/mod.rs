//! The page of a capture: its contents, the numbers, the pictures, the events, and its origin.

mod about;
mod actions;
mod cost;
mod noise;
mod statistics;

pub use actions::Served;
pub(super) use actions::options;

use super::figure::{clock, percent, span};
use super::picture::{self, Figure};
use super::{Kind, escaped, framed, wide};
use crate::jobs::Documents;
use crate::store::{CaptureRow, DiagnosisRow, EventRow, GapRow};
use imu_core::sample::audit::Report;
use imu_core::sample::{Channel, Triad};
use imu_core::units::counted;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The facts about a capture in the database, apart from its analyses.
#[derive(Debug, Clone)]
pub struct Facts {
    /// Its row.
    pub row: CaptureRow,
    /// Whether its numbers agree.
    pub accounting: Report,
    /// Its gaps; the first ones of many.
    pub gaps: Vec<GapRow>,
    /// The number of missing samples by cause.
    pub causes: BTreeMap<String, u64>,
    /// Its events; the first ones of many.
    pub events: Vec<EventRow>,
    /// Samples of its longest segment.
    pub longest: u64,
}

impl Facts {
    /// Returns a remark, if samples may still arrive.
    pub fn remark(&self) -> Option<String> {
        self.row.state.is_open().then(|| "It still runs: this is what there is so far.".to_owned())
    }
}

/// The content of the page.
#[derive(Debug, Clone, Copy)]
pub struct CaptureView<'a> {
    /// The facts in the database.
    pub facts: &'a Facts,
    /// Whether it is in a database, so that it has an id.
    pub is_kept: bool,
    /// Its analyses.
    pub documents: &'a Documents,
    /// The computations in progress, or the reasons why something is missing: sentences.
    pub remarks: &'a [String],
    /// Whether the page will show something that is being computed.
    pub waits: bool,
    /// Its diagnoses, apart from the enclosed ones.
    pub diagnoses: &'a [DiagnosisRow],
    /// Pictures by name, such as `allan-gyro`; missing ones are not shown.
    pub figures: &'a BTreeMap<String, Figure>,
    /// If it is a page of the daemon, with links to the rest: what that needs.
    pub served: Option<Served<'a>>,
    /// Its diagnoses, for a file that includes them: the contents of the bodies of their pages
    /// ([`super::diagnosis_body`]).
    pub enclosed: &'a [String],
}

impl CaptureView<'_> {
    /// Returns the capture's id for links; `None` if this is no page of the daemon.
    fn link(&self) -> Option<i64> {
        self.served.map(|_| self.facts.row.id)
    }
}

/// The maximum number of gaps and events listed; the interface returns all of them.
const LISTED: usize = 50;
/// Headings of a page, and their replacements in a section of another one.
const HEADINGS: [(&str, &str); 4] = [("<h2>", "<h4>"), ("</h2>", "</h4>"), ("<h1>", "<h3>"), ("</h1>", "</h3>")];
/// Triads that have pictures.
const TRIADS: [Triad; 3] = [Triad::Gyro, Triad::Accel, Triad::Mag];

/// Returns the page.
pub fn capture(view: &CaptureView<'_>) -> String {
    let mut out = String::new();
    head(&mut out, view);
    gaps(&mut out, view);
    if let Some(report) = &view.documents.noise {
        noise::section(&mut out, report, view);
        cost::section(&mut out, report, view);
    }
    spectra(&mut out, view);
    if let Some(report) = &view.documents.statistics {
        statistics::section(&mut out, &report.channels);
    }
    courses(&mut out, view);
    diagnoses(&mut out, view);
    events(&mut out, &view.facts.events);
    about::section(&mut out, view);
    foot(&mut out, view);
    let kind = match view.served {
        None => Kind::File,
        Some(_) if view.waits => Kind::Waiting(3),
        // A running capture grows: viewers want to see that, but a page with forms must not be replaced while they are
        // in use.
        Some(_) => Kind::Served,
    };
    framed(&view.facts.row.name, kind, &out)
}

/// Returns the entries in the order of the channels' names.
fn by_name<T>(channels: &BTreeMap<Channel, T>) -> Vec<(&'static str, &T)> {
    let mut entries: Vec<_> = channels.iter().map(|(channel, of)| (channel.name(), of)).collect();
    entries.sort_by_key(|(name, _)| *name);
    entries
}

/// Returns the attribute of parts that can be closed: a file may be printed, and a closed part is lost on paper.
fn opened(view: &CaptureView<'_>) -> &'static str {
    if view.served.is_none() { " open" } else { "" }
}

/// Writes the picture with that name, if it exists; returns whether it does.
fn figure(out: &mut String, view: &CaptureView<'_>, name: &str) -> bool {
    let Some(figure) = view.figures.get(name) else { return false };
    picture::write(out, figure, None);
    true
}

/// Returns the sensor's model and serial number, if one is known.
pub(super) fn sensor(of: &CaptureRow) -> Option<String> {
    let sensor = [of.sensor.model(), of.sensor.serial_number()].map(Option::unwrap_or_default);
    Some(sensor.join(" ").trim().to_owned()).filter(|sensor| !sensor.is_empty())
}

/// Returns how many samples are missing.
pub(super) fn missing(of: &CaptureRow) -> String {
    match (of.missing, of.gaps) {
        (0, _) => "none missing".to_owned(),
        (missing, gaps) => {
            let share = missing as f64 / (missing + of.samples).max(1) as f64;
            let share = if share < 0.005 { "less than 1 %".to_owned() } else { percent(share) };
            format!("{missing} missing ({share}) in {}", counted(gaps, "gap", "gaps"))
        }
    }
}

fn head(out: &mut String, view: &CaptureView<'_>) {
    let of = &view.facts.row;
    let begun = of.started_at.map_or_else(|| "not begun".to_owned(), |at| clock(&at.to_string()));
    // Writing to a text cannot fail.
    let _ = write!(
        out,
        "<p class=\"soft\">{}{}, from {}{}</p><h1>{}</h1><p class=\"large\">{}</p>",
        if view.is_kept { format!("capture {}, ", of.id) } else { String::new() },
        of.state.name(),
        escaped(sensor(of).as_deref().unwrap_or(&of.source)),
        if of.pinned { ", kept from deletion" } else { "" },
        escaped(&of.name),
        escaped(&sentence(of))
    );
    let ended = match &of.ended_at {
        Some(ended) => format!(" to {}", clock(&ended.to_string())),
        // On paper "now" has no meaning.
        None if of.state.is_open() && view.served.is_some() => " to now".to_owned(),
        None => String::new(),
    };
    let _ = write!(out, "<p class=\"soft\">{}{} UTC</p>", begun, ended);
    if let Some(note) = &of.note {
        let _ = write!(out, "<p class=\"note\">{}</p>", escaped(note));
    }
    if !view.facts.accounting.holds {
        *out += "<p class=\"alarm\">The accounting does not agree:</p><ul>";
        for violation in &view.facts.accounting.violations {
            let _ = write!(out, "<li>{}</li>", escaped(violation));
        }
        *out += "</ul>";
    }
    for remark in view.remarks {
        let _ = write!(out, "<p class=\"remark\">{}</p>", escaped(remark));
    }
    if let Some(served) = &view.served {
        actions::section(out, of, served);
    }
}

/// Returns the contents of the capture in one sentence.
fn sentence(of: &CaptureRow) -> String {
    let assumed = if of.rate_assumed { " (assumed)" } else { "" };
    let rate = of.rate_hz.map_or_else(String::new, |rate| format!(" at {} Hz{assumed}", super::figure::plain(rate)));
    let planned = match of.planned_duration_s {
        Some(planned) if planned - of.duration_s > 1.0 => format!(" of {} wanted", span(planned)),
        _ => String::new(),
    };
    format!("{}{planned}{rate}: {}, {}", span(of.duration_s), counted(of.samples, "sample", "samples"), missing(of))
}

fn gaps(out: &mut String, view: &CaptureView<'_>) {
    let (of, gaps) = (&view.facts.row, &view.facts.gaps);
    *out += "<h2>Samples and gaps</h2><div class=\"slim\">";
    figure(out, view, "gaps");
    *out += "</div>";
    if of.samples + of.missing > 0 && gaps.is_empty() {
        let _ = write!(
            out,
            "<p>No sample is missing, in {} {}.</p>",
            of.segments,
            if of.segments == 1 { "segment" } else { "segments" }
        );
    }
    if !gaps.is_empty() {
        let by_cause = view
            .facts
            .causes
            .iter()
            .map(|(cause, missing)| format!("{}: {missing} missing", escaped(&cause.replace('_', " "))));
        let by_cause: Vec<String> = by_cause.collect();
        let _ = write!(
            out,
            "<p>{}</p><details{}><summary>the list</summary>{}<table><tr><th scope=\"col\">from (UTC)</th>\
             <th scope=\"col\">to</th><th scope=\"col\" class=\"number\">missing</th><th scope=\"col\">cause</th></tr>",
            by_cause.join("; "),
            opened(view),
            wide("gaps")
        );
        for gap in gaps.iter().take(LISTED) {
            let _ = write!(
                out,
                "<tr><td>{}</td><td>{}</td><td class=\"number\">{}{}</td><td>{}</td></tr>",
                clock(&gap.from.to_string()),
                clock(&gap.to.to_string()),
                if gap.missing_exact { "" } else { "about " },
                gap.missing,
                gap.cause.name().replace('_', " ")
            );
        }
        *out += "</table></div>";
        let more = of.gaps.saturating_sub(LISTED as u64);
        if more > 0 {
            let _ = write!(out, "<p class=\"soft\">… and {more} more</p>");
        }
        *out += "</details>";
    }
    if !of.rejected.is_empty() {
        let all: Vec<String> = of
            .rejected
            .iter()
            .map(|(cause, count)| format!("{count} ({})", escaped(&cause.replace('_', " "))))
            .collect();
        let _ = write!(out, "<p>Arrived and not taken: {}.</p>", all.join(", "));
    }
}

fn spectra(out: &mut String, view: &CaptureView<'_>) {
    let names = TRIADS.map(|triad| format!("psd-{}", triad.name()));
    if !names.iter().any(|name| view.figures.contains_key(name)) {
        return;
    }
    *out += "<h2>Power spectrum</h2><p class=\"soft\">Two-sided: white noise stands at its N. Marked are the lines that were \
             found.</p><div class=\"figures\">";
    for name in &names {
        figure(out, view, name);
    }
    *out += "</div>";
}

fn courses(out: &mut String, view: &CaptureView<'_>) {
    let there = |channel: &&Channel| {
        view.figures.contains_key(&format!("timeseries-{channel}"))
            || view.figures.contains_key(&format!("histogram-{channel}"))
    };
    let mut channels: Vec<&Channel> = view.facts.row.channels.iter().filter(there).collect();
    if channels.is_empty() {
        return;
    }
    *out += "<h2>Channel by channel</h2>";
    // The temperature explains the others.
    channels.sort_by_key(|channel| **channel != Channel::Temperature);
    for (place, channel) in channels.into_iter().enumerate() {
        let name = channel.name();
        let open = if place == 0 { " open" } else { opened(view) };
        let _ = write!(out, "<details{open}><summary>{name}</summary><div class=\"figures\">");
        figure(out, view, &format!("timeseries-{channel}"));
        figure(out, view, &format!("histogram-{channel}"));
        *out += "</div>";
        if let Some(id) = view.link() {
            let _ = write!(out, "<p><a href=\"/captures/{id}/series/{name}\">look closer at {name}</a></p>");
        }
        *out += "</details>";
    }
}

fn diagnoses(out: &mut String, view: &CaptureView<'_>) {
    if view.diagnoses.is_empty() && view.enclosed.is_empty() {
        return;
    }
    *out += "<h2>Compared with a simulator</h2>";
    if !view.diagnoses.is_empty() {
        *out += "<ul>";
        for one in view.diagnoses {
            let summary = escaped(&one.summary_or_state());
            let _ = match view.served {
                Some(_) => write!(out, "<li><a href=\"/diagnoses/{}\">{summary}</a></li>", one.job.id),
                None => write!(out, "<li>{summary}</li>"),
            };
        }
        *out += "</ul>";
    }
    for own in view.enclosed {
        // Their headings are below this page's; no text of a document contains a tag.
        let own = HEADINGS.iter().fold(own.clone(), |own, (theirs, ours)| own.replace(theirs, ours));
        let _ = write!(out, "<section class=\"enclosed\">{own}</section>");
    }
}

fn events(out: &mut String, events: &[EventRow]) {
    if events.is_empty() {
        return;
    }
    *out += "<h2>What happened</h2>";
    *out += &wide("events");
    *out += "<table><tr><th scope=\"col\">when (UTC)</th><th scope=\"col\">what</th></tr>";
    for event in events.iter().take(LISTED) {
        let _ = write!(
            out,
            "<tr><td>{}</td><td title=\"{}\">{}</td></tr>",
            clock(&event.at.to_string()),
            escaped(&event.kind),
            escaped(&event.message)
        );
    }
    *out += "</table></div>";
    if events.len() > LISTED {
        let _ = write!(out, "<p class=\"soft\">… and {} more</p>", events.len() - LISTED);
    }
}

fn foot(out: &mut String, view: &CaptureView<'_>) {
    let software = escaped(&view.facts.row.software);
    let Some(id) = view.link() else {
        let _ = write!(out, "<footer>{software}</footer>");
        return;
    };
    let links = [
        ("JSON", ""),
        ("noise", "/noise"),
        ("Allan deviation", "/allan"),
        ("statistics", "/statistics"),
        ("gaps", "/gaps"),
        ("segments", "/segments"),
        ("samples as CSV", "/samples?format=csv"),
    ];
    let links = links.map(|(label, path)| format!("<a href=\"/v1/captures/{id}{path}\">{label}</a>"));
    let _ = write!(out, "<footer>{software} · {}</footer>", links.join(" · "));
}

#[cfg(test)]
mod tests;
