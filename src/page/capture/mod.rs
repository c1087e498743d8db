//! The page of a capture: its contents, the numbers, the pictures, the events, and its origin.

mod about;
mod noise;
mod statistics;

use super::figure::{clock, percent, span};
use super::{Kind, escaped, framed, wide};
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// A picture on the page.
#[derive(Debug, Clone, PartialEq)]
pub enum Figure {
    /// Fetched from there when it scrolls into view; `told` is the description for users who cannot see it.
    Linked {
        /// Its description.
        told: String,
        /// Its address.
        address: String,
        /// Its height in units in which its width is 560.
        height: u32,
    },
    /// Part of the file: `<svg>…</svg>`.
    Drawn(String),
}

/// The facts about a capture. Documents are JSON texts.
#[derive(Debug, Clone, Copy)]
pub struct CaptureView<'a> {
    /// `GET /v1/captures/{id}`.
    pub capture: &'a str,
    /// `vn100d-statistics-1`.
    pub statistics: Option<&'a str>,
    /// `vn100d-noise-1`, with its comparison with a datasheet.
    pub noise: Option<&'a str>,
    /// The computations in progress, or the reasons why something is missing: sentences.
    pub remarks: &'a [String],
    /// Whether the page will show something that is being computed.
    pub waits: bool,
    /// Gaps, a list; the first ones of many.
    pub gaps: &'a str,
    /// The number of missing samples by cause, an object.
    pub causes: &'a str,
    /// Events, a list.
    pub events: &'a str,
    /// Diagnoses, a list; without the enclosed ones.
    pub diagnoses: &'a str,
    /// Pictures by name, such as `allan-gyro`; missing ones are not shown.
    pub figures: &'a BTreeMap<String, Figure>,
    /// Whether it is a page of the daemon, with links to the rest, and if so whether requests need a token.
    pub served: Option<bool>,
    /// Its diagnoses, for a file that includes them: the contents of the bodies of their pages
    /// ([`super::diagnosis_body`]).
    pub enclosed: &'a [String],
}

/// The parts of a capture that are shown.
#[derive(Debug, Deserialize)]
struct Capture {
    /// `None` for a recording that is in no database.
    id: Option<i64>,
    name: String,
    state: String,
    source: String,
    started_at: Option<String>,
    ended_at: Option<String>,
    #[serde(default)]
    duration_s: f64,
    planned_duration_s: Option<f64>,
    #[serde(default)]
    samples: u64,
    #[serde(default)]
    missing: u64,
    #[serde(default)]
    gaps: u64,
    #[serde(default)]
    segments: u64,
    rate_hz: Option<f64>,
    #[serde(default)]
    rate_assumed: bool,
    #[serde(default)]
    pinned: bool,
    #[serde(default)]
    software: String,
    #[serde(default)]
    channels: Vec<String>,
    #[serde(default)]
    rejected: BTreeMap<String, u64>,
    #[serde(default)]
    sensor: Value,
    #[serde(default)]
    configuration: Value,
    #[serde(default)]
    accounting: Option<Accounting>,
}

#[derive(Debug, Deserialize)]
struct Accounting {
    holds: bool,
    #[serde(default)]
    violations: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Gap {
    from: String,
    to: String,
    missing: u64,
    #[serde(default)]
    missing_exact: bool,
    cause: String,
}

#[derive(Debug, Deserialize)]
struct Event {
    at: String,
    kind: String,
    message: String,
}

#[derive(Debug, Deserialize)]
struct Diagnosis {
    id: i64,
    state: String,
    summary: Option<String>,
}

/// The maximum number of gaps and events listed; the interface returns all of them.
const LISTED: usize = 50;
/// Headings of a page, and their replacements in a section of another one.
const HEADINGS: [(&str, &str); 4] = [("<h2>", "<h4>"), ("</h2>", "</h4>"), ("<h1>", "<h3>"), ("</h1>", "</h3>")];
/// Triads and the letters of their axes.
const TRIADS: [&str; 3] = ["gyro", "accel", "mag"];

/// The page.
///
/// # Errors
/// What is missing in a text that is none of these documents.
pub fn capture(view: &CaptureView<'_>) -> Result<String, serde_json::Error> {
    let of: Capture = serde_json::from_str(view.capture)?;
    let mut out = String::new();
    head(&mut out, &of, view);
    gaps(&mut out, &of, serde_json::from_str(view.gaps)?, serde_json::from_str(view.causes)?, view);
    if let Some(document) = view.noise {
        noise::section(&mut out, document, &of, view)?;
    }
    spectra(&mut out, view);
    if let Some(document) = view.statistics {
        statistics::section(&mut out, document)?;
    }
    courses(&mut out, &of, view);
    diagnoses(&mut out, serde_json::from_str(view.diagnoses)?, view);
    events(&mut out, serde_json::from_str(view.events)?);
    about::section(&mut out, &of, view);
    foot(&mut out, &of, view);
    let kind = match view.served {
        None => Kind::File,
        Some(_) if view.waits => Kind::Waiting(3),
        // A running capture grows: viewers want to see that, but a page with forms must not be replaced while they are
        // in use.
        Some(_) => Kind::Served,
    };
    Ok(framed(&of.name, kind, &out))
}

/// The attribute of parts that can be closed: a file may be printed, and a closed part is lost on paper.
fn opened(view: &CaptureView<'_>) -> &'static str {
    if view.served.is_none() { " open" } else { "" }
}

/// The picture with that name, if it exists.
fn figure(out: &mut String, view: &CaptureView<'_>, name: &str) -> bool {
    // Writing to a text cannot fail.
    match view.figures.get(name) {
        None => return false,
        Some(Figure::Drawn(svg)) => {
            let _ = write!(out, "<figure>{svg}</figure>");
        }
        Some(Figure::Linked { told, address, height }) => {
            let (told, address) = (escaped(told), escaped(address));
            let _ = write!(
                out,
                "<figure><img src=\"{address}\" alt=\"{told}\" width=\"560\" height=\"{height}\" loading=\"lazy\"></figure>"
            );
        }
    }
    true
}

fn head(out: &mut String, of: &Capture, view: &CaptureView<'_>) {
    let begun = of.started_at.as_deref().map_or_else(|| "not begun".to_owned(), clock);
    let sensor = ["model", "serial_number"].map(|key| of.sensor[key].as_str().unwrap_or_default());
    let sensor = sensor.join(" ").trim().to_owned();
    let _ = write!(
        out,
        "<p class=\"soft\">{}{}, from {}{}</p><h1>{}</h1><p class=\"large\">{}</p>",
        of.id.map_or_else(String::new, |id| format!("capture {id}, ")),
        escaped(&of.state.replace('_', " ")),
        escaped(if sensor.is_empty() { &of.source } else { &sensor }),
        if of.pinned { ", kept from deletion" } else { "" },
        escaped(&of.name),
        escaped(&sentence(of))
    );
    let ended = match &of.ended_at {
        Some(ended) => format!(" to {}", clock(ended)),
        // On paper "now" has no meaning.
        None if is_open(of) && view.served.is_some() => " to now".to_owned(),
        None => String::new(),
    };
    let _ = write!(out, "<p class=\"soft\">{}{} UTC</p>", escaped(&begun), escaped(&ended));
    if let Some(accounting) = &of.accounting
        && !accounting.holds
    {
        *out += "<p class=\"alarm\">The accounting does not agree:</p><ul>";
        for violation in &accounting.violations {
            let _ = write!(out, "<li>{}</li>", escaped(violation));
        }
        *out += "</ul>";
    }
    for remark in view.remarks {
        let _ = write!(out, "<p class=\"remark\">{}</p>", escaped(remark));
    }
    if let (Some(token), Some(id)) = (view.served, of.id) {
        wishes(out, of, id, token);
    }
}

/// Whether samples may still arrive.
fn is_open(of: &Capture) -> bool {
    matches!(of.state.as_str(), "capturing" | "waiting")
}

/// The contents of the capture in one sentence.
fn sentence(of: &Capture) -> String {
    let assumed = if of.rate_assumed { " (assumed)" } else { "" };
    let rate = of.rate_hz.map_or_else(String::new, |rate| format!(" at {} Hz{assumed}", super::figure::plain(rate)));
    let planned = match of.planned_duration_s {
        Some(planned) if planned - of.duration_s > 1.0 => format!(" of {} wanted", span(planned)),
        _ => String::new(),
    };
    let missing = match (of.missing, of.gaps) {
        (0, _) => "none missing".to_owned(),
        (missing, gaps) => {
            let share = missing as f64 / (missing + of.samples).max(1) as f64;
            let share = if share < 0.005 { "less than 1 %".to_owned() } else { percent(share) };
            format!("{missing} missing ({share}) in {gaps} {}", if gaps == 1 { "gap" } else { "gaps" })
        }
    };
    format!("{}{planned}{rate}: {} samples, {missing}", span(of.duration_s), of.samples)
}

/// The requests that the page offers; users without scripts have curl.
fn wishes(out: &mut String, of: &Capture, id: i64, token: bool) {
    let _ = write!(out, "<section class=\"wishes\" aria-label=\"actions\" hidden>");
    if is_open(of) {
        let _ = write!(
            out,
            "<form data-post=\"/v1/captures/{id}/stop\" data-ask=\"Stop this capture?\"><button>stop</button></form>"
        );
    } else {
        let _ = write!(
            out,
            "<form data-post=\"/v1/captures/{id}/pin\" data-json=\"{{&quot;pinned&quot;:{}}}\"><button>{}</button></form>\
             <form data-post=\"/v1/captures/{id}/diagnoses\" data-then=\"/diagnoses/\" class=\"models\">\
             <label>compare with the simulator <select name=\"sim\" data-models></select></label>\
             <label>or with a model's file <input name=\"sim\" type=\"file\" accept=\".json\"></label><button>diagnose</button></form>",
            !of.pinned,
            if of.pinned { "keep no longer" } else { "keep from deletion" }
        );
    }
    *out += &super::dashboard::token(token);
    *out += "<p class=\"said\" role=\"status\"></p></section>";
}

fn gaps(out: &mut String, of: &Capture, gaps: Vec<Gap>, causes: BTreeMap<String, u64>, view: &CaptureView<'_>) {
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
        let by_cause =
            causes.iter().map(|(cause, missing)| format!("{}: {missing} missing", escaped(&cause.replace('_', " "))));
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
                escaped(&clock(&gap.from)),
                escaped(&clock(&gap.to)),
                if gap.missing_exact { "" } else { "about " },
                gap.missing,
                escaped(&gap.cause.replace('_', " "))
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
    let names: Vec<String> = TRIADS.iter().map(|triad| format!("psd-{triad}")).collect();
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

fn courses(out: &mut String, of: &Capture, view: &CaptureView<'_>) {
    let there = |channel: &&String| {
        view.figures.contains_key(&format!("timeseries-{channel}"))
            || view.figures.contains_key(&format!("histogram-{channel}"))
    };
    let channels: Vec<&String> = of.channels.iter().filter(there).collect();
    if channels.is_empty() {
        return;
    }
    *out += "<h2>Channel by channel</h2>";
    // The temperature explains the others.
    let mut channels = channels;
    channels.sort_by_key(|channel| channel.as_str() != "temperature");
    for (place, channel) in channels.into_iter().enumerate() {
        let name = escaped(channel);
        let open = if place == 0 { " open" } else { opened(view) };
        let _ = write!(out, "<details{open}><summary>{name}</summary><div class=\"figures\">");
        figure(out, view, &format!("timeseries-{channel}"));
        figure(out, view, &format!("histogram-{channel}"));
        *out += "</div>";
        if let Some(id) = view.served.and(of.id) {
            let _ = write!(out, "<p><a href=\"/captures/{id}/series/{name}\">look closer at {name}</a></p>");
        }
        *out += "</details>";
    }
}

fn diagnoses(out: &mut String, diagnoses: Vec<Diagnosis>, view: &CaptureView<'_>) {
    if diagnoses.is_empty() && view.enclosed.is_empty() {
        return;
    }
    *out += "<h2>Compared with a simulator</h2>";
    if !diagnoses.is_empty() {
        *out += "<ul>";
        for one in &diagnoses {
            let told = one.summary.clone().unwrap_or_else(|| format!("diagnosis {}: {}", one.id, one.state));
            let _ = match view.served {
                Some(_) => write!(out, "<li><a href=\"/diagnoses/{}\">{}</a></li>", one.id, escaped(&told)),
                None => write!(out, "<li>{}</li>", escaped(&told)),
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

fn events(out: &mut String, events: Vec<Event>) {
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
            escaped(&clock(&event.at)),
            escaped(&event.kind),
            escaped(&event.message)
        );
    }
    *out += "</table></div>";
    if events.len() > LISTED {
        let _ = write!(out, "<p class=\"soft\">… and {} more</p>", events.len() - LISTED);
    }
}

fn foot(out: &mut String, of: &Capture, view: &CaptureView<'_>) {
    let Some(id) = view.served.and(of.id) else {
        let _ = write!(out, "<footer>{}</footer>", escaped(&of.software));
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
    let _ = write!(out, "<footer>{} · {}</footer>", escaped(&of.software), links.join(" · "));
}

#[cfg(test)]
mod tests;
