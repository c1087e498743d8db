//! The page of a diagnosis: the sentence, the size of the gap and what closes it, its place, and what the model lacks.

mod drawn;
mod findings;
mod gap;
#[cfg(test)]
mod tests;

use super::{Kind, escaped, framed};
use drawn::Drawn;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Links to the same data for programs; label and address.
pub type Links<'a> = &'a [(&'a str, String)];

/// The parts of `vn100d-diagnosis-1` that are shown.
#[derive(Debug, Deserialize)]
struct Report {
    verdict: String,
    summary: String,
    discrepancy: Discrepancy,
    #[serde(default)]
    r#where: Vec<Place>,
    #[serde(default)]
    parameters: Vec<Parameter>,
    #[serde(default)]
    offsets: Vec<Offset>,
    #[serde(default)]
    hints: Vec<Hint>,
    #[serde(default)]
    causes: Vec<Cause>,
    #[serde(default)]
    remainder: Option<Remainder>,
    #[serde(default)]
    alternatives: Vec<Alternative>,
    #[serde(default)]
    per_channel: BTreeMap<String, Gap>,
    #[serde(default)]
    notes: Vec<String>,
    #[serde(default)]
    software: String,
    #[serde(default)]
    inputs: BTreeMap<String, String>,
}

#[derive(Debug, Deserialize)]
struct Remainder {
    share: f64,
    #[serde(default)]
    channels: Vec<String>,
    #[serde(default)]
    what: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Discrepancy {
    unit: String,
    #[serde(deserialize_with = "crate::plot::json::number")]
    before: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    after_parameters: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    after: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    floor: f64,
    p_value_after: Option<f64>,
    closed: Option<f64>,
    closed_ci95: Option<[f64; 2]>,
    #[serde(default)]
    measured_on: String,
}

#[derive(Debug, Deserialize)]
struct Place {
    #[serde(default)]
    of: String,
    channel: String,
    #[serde(deserialize_with = "crate::plot::json::pair")]
    band_hz: [f64; 2],
    #[serde(deserialize_with = "crate::plot::json::number")]
    from_s: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    to_s: f64,
    temperature_c: Option<[f64; 2]>,
    at: Option<Driver>,
    #[serde(deserialize_with = "crate::plot::json::number")]
    share: f64,
    sign: String,
}

/// The position of a gap in a motion's range.
#[derive(Debug, Deserialize)]
struct Driver {
    quantity: String,
    axis: String,
    unit: String,
    #[serde(deserialize_with = "crate::plot::json::pair")]
    range: [f64; 2],
    pose: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Parameter {
    channel: String,
    parameter: String,
    #[serde(deserialize_with = "crate::plot::json::number")]
    model: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    capture: f64,
    ratio: Option<f64>,
    ci95: Option<[f64; 2]>,
}

/// A mean that differs from the model's.
#[derive(Debug, Deserialize)]
struct Offset {
    channel: String,
    #[serde(deserialize_with = "crate::plot::json::number")]
    model: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    capture: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    explained: f64,
}

/// The possible meaning of a difference's size.
#[derive(Debug, Deserialize)]
struct Hint {
    about: String,
    text: String,
}

/// Which side has an effect.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Sense {
    /// The sensor alone; assumed for reports without a sense.
    #[default]
    Missing,
    Superfluous,
    Size,
}

#[derive(Debug, Deserialize)]
struct Cause {
    effect: String,
    #[serde(default)]
    sense: Sense,
    channels: Vec<String>,
    #[serde(deserialize_with = "crate::plot::json::number")]
    confidence: f64,
    closes: Option<f64>,
    #[serde(default)]
    parameters: BTreeMap<String, Value>,
    #[serde(default)]
    model: BTreeMap<String, Value>,
    #[serde(default)]
    uncertainty: BTreeMap<String, Value>,
    #[serde(default)]
    evidence: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Alternative {
    effect: String,
    channels: Vec<String>,
    why_not: String,
}

#[derive(Debug, Deserialize)]
struct Gap {
    #[serde(deserialize_with = "crate::plot::json::number")]
    before: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    after: f64,
    #[serde(deserialize_with = "crate::plot::json::number")]
    floor: f64,
}

/// The page of a diagnosis. `report` is the document `vn100d-diagnosis-1`. `drawings` is an object with the data of its
/// pictures ([`imu_diagnosis::Drawings`]) among its keys, as in the daemon's results.
///
/// # Errors
/// What is missing in a text that is no such document.
pub fn diagnosis(report: &str, drawings: &str, links: Links<'_>) -> Result<String, serde_json::Error> {
    let (title, body) = diagnosis_body(report, drawings, links)?;
    let kind = if links.is_empty() { Kind::File } else { Kind::Served };
    Ok(framed(&title, kind, &body))
}

/// The title and the body's content of the same page, to be [enclosed](super::CaptureView::enclosed) in another one.
///
/// # Errors
/// What is missing in a text that is no such document.
pub fn diagnosis_body(report: &str, drawings: &str, links: Links<'_>) -> Result<(String, String), serde_json::Error> {
    let report: Report = serde_json::from_str(report)?;
    let body = body(&report, &serde_json::from_str(drawings)?, links);
    Ok((format!("Diagnosis: {}", report.summary), body))
}

fn body(report: &Report, drawn: &Drawn, links: Links<'_>) -> String {
    let mut out = String::new();
    head(&mut out, report);
    gap::section(&mut out, &report.discrepancy);
    gap::by_channel(&mut out, report);
    findings::causes(&mut out, report);
    findings::alternatives(&mut out, report);
    findings::off(&mut out, &report.parameters);
    findings::offsets(&mut out, &report.offsets);
    findings::hints(&mut out, &report.hints);
    findings::remainder(&mut out, report.remainder.as_ref());
    drawn::heat(&mut out, drawn);
    findings::places(&mut out, report);
    drawn::motion(&mut out, report, drawn);
    drawn::timelines(&mut out, drawn);
    drawn::spectra(&mut out, report, drawn);
    notes(&mut out, report);
    foot(&mut out, report, links);
    out
}

fn head(out: &mut String, report: &Report) {
    let all = |sense: Sense| report.causes.iter().all(|cause| cause.sense == sense);
    let verdict = match report.verdict.as_str() {
        "no_gap" => "no gap",
        "parameters" => "parameters off",
        "effects" if all(Sense::Missing) => "the model lacks an effect",
        "effects" if all(Sense::Superfluous) => "the sensor lacks an effect",
        "effects" => "effects differ",
        "unknown_effect" => "something unknown remains",
        other => other,
    };
    let input = |key: &str| report.inputs.get(key).map_or("?", String::as_str);
    // Writing to a text cannot fail.
    let _ = write!(
        out,
        "<p class=\"soft\">{} against the simulator {}</p><h1>{}</h1><p><span class=\"verdict {}\">{}</span></p>",
        escaped(input("real")),
        escaped(input("sim")),
        escaped(&report.summary),
        escaped(&report.verdict),
        escaped(verdict)
    );
}

/// Whether anything was found on a channel.
fn named(report: &Report, channel: &str) -> bool {
    report.r#where.iter().any(|of| of.channel == channel)
        || report.parameters.iter().any(|of| of.channel == channel)
        || report.causes.iter().any(|of| of.channels.iter().any(|own| own == channel))
}

fn notes(out: &mut String, report: &Report) {
    if !report.notes.is_empty() {
        *out += "<h2>To know</h2><ul>";
        for note in &report.notes {
            let _ = write!(out, "<li>{}</li>", escaped(note));
        }
        *out += "</ul>";
    }
}

fn foot(out: &mut String, report: &Report, links: Links<'_>) {
    let links: Vec<String> = links
        .iter()
        .map(|(label, address)| format!("<a href=\"{}\">{}</a>", escaped(address), escaped(label)))
        .collect();
    let links = if links.is_empty() { String::new() } else { format!(" · {}", links.join(" · ")) };
    let _ = write!(out, "<footer>{}{links}</footer>", escaped(&report.software));
}
