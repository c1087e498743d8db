//! The page of a diagnosis: the sentence, the size of the gap and the effects that close it, its place, and the effects
//! missing in the model.

mod advice;
mod cost;
mod drawn;
mod findings;
mod gap;
#[cfg(test)]
mod tests;

pub use advice::{NATS, SURE, advice};
pub use findings::closes;

use super::{Kind, escaped, framed};
use imu_diagnosis::report::{Sense, Verdict};
use imu_diagnosis::{Diagnosis, Drawings};
use std::fmt::Write as _;

/// Links to the same data for programs; label and address.
pub type Links<'a> = &'a [(&'a str, String)];

/// Returns the page of a diagnosis, with the data of its pictures.
pub fn diagnosis(report: &Diagnosis, drawings: &Drawings, links: Links<'_>) -> String {
    let kind = if links.is_empty() { Kind::File } else { Kind::Served };
    framed(&format!("Diagnosis: {}", report.summary), kind, &diagnosis_body(report, drawings, links))
}

/// Returns the body's content of that page, to be [enclosed](super::CaptureView::enclosed) in another one.
pub fn diagnosis_body(report: &Diagnosis, drawings: &Drawings, links: Links<'_>) -> String {
    let mut out = String::new();
    head(&mut out, report);
    gap::section(&mut out, &report.discrepancy);
    gap::by_channel(&mut out, report);
    findings::causes(&mut out, report);
    cost::section(&mut out, report);
    findings::alternatives(&mut out, report);
    findings::off(&mut out, &report.parameters);
    findings::offsets(&mut out, &report.offsets);
    findings::hints(&mut out, &report.hints);
    findings::remainder(&mut out, report.remainder.as_ref());
    drawn::heat(&mut out, drawings);
    findings::places(&mut out, report);
    drawn::motion(&mut out, report, drawings);
    drawn::timelines(&mut out, drawings);
    drawn::spectra(&mut out, report, drawings);
    notes(&mut out, report);
    advice::section(&mut out, report);
    foot(&mut out, report, links);
    out
}

fn head(out: &mut String, report: &Diagnosis) {
    let all = |sense: Sense| report.causes.iter().all(|cause| cause.sense == sense);
    let (class, verdict) = match report.verdict {
        Verdict::NoGap => ("no_gap", "no gap"),
        Verdict::Parameters => ("parameters", "parameters off"),
        Verdict::Effects if all(Sense::Missing) => ("effects", "the model lacks an effect"),
        Verdict::Effects if all(Sense::Superfluous) => ("effects", "the sensor lacks an effect"),
        Verdict::Effects => ("effects", "effects differ"),
        Verdict::UnknownEffect => ("unknown_effect", "something unknown remains"),
    };
    let input = |key: &str| report.inputs.get(key).map_or("?", String::as_str);
    // Writing to a text cannot fail.
    let _ = write!(
        out,
        "<p class=\"soft\">{} against the simulator {}</p><h1>{}</h1><p><span class=\"verdict {}\">{}</span></p>",
        escaped(input("real")),
        escaped(input("sim")),
        escaped(&report.summary),
        class,
        verdict
    );
}

/// Returns whether anything was found on a channel.
fn named(report: &Diagnosis, channel: &str) -> bool {
    report.r#where.iter().any(|of| of.channel == channel)
        || report.parameters.iter().any(|of| of.channel == channel)
        || report.causes.iter().any(|of| of.channels.iter().any(|own| own == channel))
}

fn notes(out: &mut String, report: &Diagnosis) {
    if !report.notes.is_empty() {
        *out += "<h2>To know</h2><ul>";
        for note in &report.notes {
            let _ = write!(out, "<li>{}</li>", escaped(note));
        }
        *out += "</ul>";
    }
}

fn foot(out: &mut String, report: &Diagnosis, links: Links<'_>) {
    let links: Vec<String> = links
        .iter()
        .map(|(label, address)| format!("<a href=\"{}\">{}</a>", escaped(address), escaped(label)))
        .collect();
    let links = if links.is_empty() { String::new() } else { format!(" · {}", links.join(" · ")) };
    let _ = write!(out, "<footer>{}{links}</footer>", escaped(&report.software));
}
