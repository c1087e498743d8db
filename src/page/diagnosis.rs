//! The page of a diagnosis: the sentence, how large the gap is and what closes it, where it lies, what the model lacks.

use super::figure::{percent, plain, second, with_interval};
use super::{Kind, escaped, framed};
use crate::plot::{Residuals, Spectra};
use crate::sample::Channel;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Entries of a list that are shown of one cause on one channel.
const ENTRIES: usize = 6;
/// The bars' scale over what a true model shows, at least.
const SCALE: f64 = 20.0;
/// Characters of a parameter that is no number.
const LONGEST: usize = 60;

/// Where the same is to be had by a program; label and address.
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
    causes: Vec<Cause>,
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

/// Where in a motion's range a gap lies.
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

#[derive(Debug, Deserialize)]
struct Cause {
    effect: String,
    channels: Vec<String>,
    #[serde(deserialize_with = "crate::plot::json::number")]
    confidence: f64,
    closes: Option<f64>,
    #[serde(default)]
    parameters: BTreeMap<String, Value>,
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

/// What is drawn, as lists in JSON.
#[derive(Debug, Clone, Copy)]
#[expect(clippy::exhaustive_structs, reason = "an argument that callers write out")]
pub struct Pictures<'a> {
    /// Spectra of the channels ([`crate::diagnosis::ChannelSpectra`]).
    pub spectra: &'a str,
    /// What is beyond the model in a record of a motion ([`crate::diagnosis::Residuals`]).
    pub residuals: &'a str,
}

/// The page of a diagnosis: `report` is the document `vn100d-diagnosis-1`.
///
/// # Errors
/// What is missing in a text that is no such document.
pub fn diagnosis(report: &str, drawn: Pictures<'_>, links: Links<'_>) -> Result<String, serde_json::Error> {
    let report: Report = serde_json::from_str(report)?;
    let spectra: Vec<Spectra> = serde_json::from_str(drawn.spectra)?;
    let residuals: Vec<Residuals> = serde_json::from_str(drawn.residuals)?;
    let mut out = String::new();
    head(&mut out, &report);
    bars(&mut out, &report.discrepancy);
    causes(&mut out, &report);
    off(&mut out, &report.parameters);
    places(&mut out, &report);
    motion(&mut out, &report, &residuals);
    pictures(&mut out, &report, &spectra);
    by_channel(&mut out, &report.per_channel);
    rest(&mut out, &report);
    foot(&mut out, &report, links);
    let kind = if links.is_empty() { Kind::File } else { Kind::Served };
    Ok(framed(&format!("Diagnosis: {}", report.summary), kind, &out))
}

fn head(out: &mut String, report: &Report) {
    let verdict = match report.verdict.as_str() {
        "no_gap" => "no gap",
        "parameters" => "parameters off",
        "effects" => "the model lacks an effect",
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

/// A bar of a length between 0 and 1, one of at least a hair's breadth.
fn bar(share: f64, class: &str) -> String {
    // Of what is no number the breadth of a hair.
    let width = if share.is_finite() { (100.0 * share).clamp(0.3, 100.0) } else { 0.3 };
    format!(
        "<svg viewBox=\"0 0 100 10\" preserveAspectRatio=\"none\" aria-hidden=\"true\">\
         <rect class=\"fill-{class}\" width=\"{width:.2}\" height=\"10\"/></svg>"
    )
}

fn bars(out: &mut String, gap: &Discrepancy) {
    let rows = [
        ("the model as it is", gap.before, "before"),
        ("its parameters corrected", gap.after_parameters, "parameters"),
        ("with what was found", gap.after, "after"),
        ("a true model shows", gap.floor, "floor"),
    ];
    // Where there is no gap the bars are short: the scale reaches to so many times what a true model shows, at least.
    let least = SCALE * gap.floor.max(f64::MIN_POSITIVE);
    let most = rows.iter().map(|(_, value, _)| *value).fold(least, f64::max);
    let _ = write!(out, "<h2>The gap, in {}</h2><div class=\"bars\">", escaped(&gap.unit));
    for (name, value, class) in rows {
        let _ =
            write!(out, "<span>{name}</span>{}<span class=\"value\">{}</span>", bar(value / most, class), plain(value));
    }
    *out += "</div>";
    if let Some(closed) = gap.closed {
        let interval = gap
            .closed_ci95
            .map_or_else(String::new, |[low, high]| format!(" (95 % interval {} to {})", percent(low), percent(high)));
        let _ = write!(out, "<p>{} of the gap is closed{interval}.</p>", percent(closed));
    }
    let chance = gap
        .p_value_after
        .map_or_else(String::new, |p| format!(" Chance that a true model leaves as much: {}.", plain(p)));
    let _ = write!(out, "<p class=\"soft\">Measured on the {}.{chance}</p>", escaped(&gap.measured_on));
}

fn causes(out: &mut String, report: &Report) {
    if report.causes.is_empty() {
        return;
    }
    *out += "<h2>What the model lacks</h2><div class=\"wide\"><table><tr><th>effect</th><th>on</th>\
             <th>parameters, with 95&nbsp;% intervals</th><th class=\"number\">sure</th><th class=\"number\">closes</th></tr>";
    for cause in &report.causes {
        // Never more sure than it is.
        let sure = percent((100.0 * cause.confidence).floor() / 100.0);
        let _ = write!(
            out,
            "<tr><td><b>{}</b></td><td>{}</td><td>{}</td><td class=\"number\">{sure}</td><td class=\"number\">{}</td></tr>",
            escaped(&cause.effect.replace('_', " ")),
            escaped(&cause.channels.join(", ")),
            parameters(cause),
            cause.closes.map_or_else(|| "–".to_owned(), percent),
        );
    }
    *out += "</table></div><ul>";
    for sentence in report.causes.iter().flat_map(|cause| &cause.evidence) {
        let _ = write!(out, "<li class=\"soft\">{}</li>", escaped(sentence));
    }
    *out += "</ul>";
}

/// A cause's parameters, channel by channel, in a list.
fn parameters(cause: &Cause) -> String {
    let mut out = String::from("<ul>");
    for (place, value) in &cause.parameters {
        let entries = entries(value);
        let known = cause.uncertainty.get(place).map(self::entries).unwrap_or_default();
        let of = if cause.parameters.len() > 1 { format!("{}: ", escaped(place)) } else { String::new() };
        for (index, entry) in entries.iter().take(ENTRIES).enumerate() {
            let intervals = known.get(index).copied();
            let told = entry.as_object().into_iter().flatten().map(|(key, value)| {
                let unit = Channel::from_name(place).map(|channel| unit(key, channel)).unwrap_or_default();
                format!("<code>{}</code> {}{unit}", escaped(key), figure(value, intervals.and_then(|of| of.get(key))))
            });
            let told: Vec<String> = told.collect();
            let _ = write!(out, "<li>{of}{}</li>", told.join(", "));
        }
        if entries.len() > ENTRIES {
            let _ = write!(out, "<li>{of}and {} more</li>", entries.len() - ENTRIES);
        }
    }
    out + "</ul>"
}

/// One or a list of several.
fn entries(value: &Value) -> Vec<&Value> {
    match value {
        Value::Array(list) => list.iter().collect(),
        one => vec![one],
    }
}

fn figure(value: &Value, interval: Option<&Value>) -> String {
    let ends = interval.and_then(|of| <[f64; 2]>::deserialize(of).ok());
    match (value.as_f64(), ends) {
        (Some(value), Some(ends)) => with_interval(value, ends),
        (Some(value), None) => plain(value),
        (None, _) => {
            let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            let short: String = text.chars().take(LONGEST).collect();
            escaped(&if short.len() < text.len() { format!("{short}…") } else { short })
        }
    }
}

/// The unit of an effect's parameter that follows the channel's; that of others is in their name.
fn unit(parameter: &str, channel: Channel) -> String {
    let unit = channel.unit();
    match parameter {
        "amplitude" | "sigma" | "size" | "step" | "low" | "high" => format!(" {unit}"),
        "per_c" => format!(" {unit} per °C"),
        "R" => format!(" {unit} per s"),
        _ => String::new(),
    }
}

fn off(out: &mut String, parameters: &[Parameter]) {
    if parameters.is_empty() {
        return;
    }
    *out += "<h2>Parameters that are off</h2><div class=\"wide\"><table><tr><th>channel</th><th>parameter</th>\
             <th class=\"number\">model</th><th class=\"number\">recording</th><th class=\"number\">ratio</th></tr>";
    for of in parameters {
        let found = of.ci95.map_or_else(|| plain(of.capture), |ends| with_interval(of.capture, ends));
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td class=\"number\">{}</td><td class=\"number\">{found}</td><td class=\"number\">{}</td></tr>",
            escaped(&of.channel),
            escaped(&of.parameter),
            plain(of.model),
            of.ratio.map_or_else(|| "–".to_owned(), plain)
        );
    }
    *out += "</table></div>";
}

fn places(out: &mut String, report: &Report) {
    if report.r#where.is_empty() {
        return;
    }
    let heading = if report.verdict == "unknown_effect" { "Where something remains" } else { "Where the gap lies" };
    let _ = write!(
        out,
        "<h2>{heading}</h2><div class=\"wide\"><table><tr><th>channel</th><th>band in Hz, or motion</th><th>time in s</th>\
         <th class=\"number\">share</th><th>the recording is</th></tr>"
    );
    for of in &report.r#where {
        let [from_hz, to_hz] = of.band_hz.map(plain);
        let band = of.at.as_ref().map_or_else(|| format!("{from_hz} to {to_hz}"), driver);
        let warm = of
            .temperature_c
            .map_or_else(String::new, |[low, high]| format!(", at {} to {} °C", plain(low), plain(high)));
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{} to {}{warm}</td><td class=\"number\">{}</td><td>{}</td></tr>",
            escaped(&of.channel),
            band,
            second(of.from_s),
            second(of.to_s),
            percent(of.share),
            escaped(of.sign.trim_start_matches("real "))
        );
    }
    *out += "</table></div>";
}

/// What the motion does where a gap lies that it drives.
fn driver(of: &Driver) -> String {
    let Driver { quantity, axis, unit, range, pose } = of;
    let [from, to] = range.map(plain);
    match pose {
        Some(pose) => escaped(pose),
        None => format!("{} {} {from} to {to} {}", escaped(quantity), escaped(axis), escaped(unit)),
    }
}

/// Whether anything was found on a channel.
fn named(report: &Report, channel: &str) -> bool {
    report.r#where.iter().any(|of| of.channel == channel)
        || report.parameters.iter().any(|of| of.channel == channel)
        || report.causes.iter().any(|of| of.channels.iter().any(|own| own == channel))
}

fn motion(out: &mut String, report: &Report, residuals: &[Residuals]) {
    if residuals.is_empty() {
        return;
    }
    *out += "<h2>Beyond the motion</h2><p class=\"soft\">The recording less what a simulator shows of the motion, means: \
             <span class=\"key before\"></span>the model as it is<span class=\"key after\"></span>the corrected model. Rate and \
             specific force are those of the reference.</p>";
    let picture = |out: &mut String, of: &Residuals| {
        let _ = write!(out, "<figure>{}</figure>", of.svg());
    };
    residuals.iter().filter(|of| named(report, of.channel())).for_each(|of| picture(out, of));
    let mut others = residuals.iter().filter(|of| !named(report, of.channel())).peekable();
    if others.peek().is_some() {
        *out += "<details><summary>channels without a finding</summary>";
        others.for_each(|of| picture(out, of));
        *out += "</details>";
    }
}

fn pictures(out: &mut String, report: &Report, spectra: &[Spectra]) {
    if spectra.is_empty() {
        return;
    }
    *out += "<h2>Spectra</h2><p class=\"soft\"><span class=\"key real\"></span>recording\
             <span class=\"key before\"></span>the model as it is<span class=\"key after\"></span>the corrected model. \
             White noise stands at its N; drifts, steps and single events are in the recording alone.</p>";
    let picture = |out: &mut String, of: &Spectra| {
        // What a motion drives is in no band of its own.
        let places = report.r#where.iter().filter(|place| place.channel == of.channel() && place.at.is_none());
        let bands: Vec<[f64; 2]> = places.map(|place| place.band_hz).collect();
        let _ = write!(out, "<figure>{}</figure>", of.svg(&bands));
    };
    spectra.iter().filter(|of| named(report, of.channel())).for_each(|of| picture(out, of));
    let others: Vec<&Spectra> = spectra.iter().filter(|of| !named(report, of.channel())).collect();
    if !others.is_empty() {
        let names: Vec<String> = others.iter().map(|of| escaped(of.channel())).collect();
        let _ = write!(out, "<details><summary>without a finding: {}</summary>", names.join(", "));
        others.into_iter().for_each(|of| picture(out, of));
        *out += "</details>";
    }
}

fn by_channel(out: &mut String, channels: &BTreeMap<String, Gap>) {
    if channels.len() < 2 {
        return;
    }
    let most = channels.values().map(|gap| gap.before.max(gap.after)).fold(f64::MIN_POSITIVE, f64::max);
    *out += "<h2>By channel</h2><p class=\"soft\">As the model is, and with everything found; a true model's share in brackets.</p>\
             <div class=\"bars\">";
    for (name, gap) in channels {
        let _ = write!(
            out,
            "<span>{}</span><div>{}{}</div><span class=\"value\">{} → {} ({})</span>",
            escaped(name),
            bar(gap.before / most, "before"),
            bar(gap.after / most, "after"),
            plain(gap.before),
            plain(gap.after),
            plain(gap.floor)
        );
    }
    *out += "</div>";
}

fn rest(out: &mut String, report: &Report) {
    if !report.alternatives.is_empty() {
        *out += "<h2>What was weighed and not named</h2><ul>";
        for of in &report.alternatives {
            let _ = write!(
                out,
                "<li>{} on {}: {}</li>",
                escaped(&of.effect.replace('_', " ")),
                escaped(&of.channels.join(", ")),
                escaped(&of.why_not)
            );
        }
        *out += "</ul>";
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn report() -> Value {
        json!({
            "format": "vn100d-diagnosis-1", "verdict": "effects", "summary": "accel_z: a 11.400 Hz tone <b> that the model lacks",
            "discrepancy": {"unit": "nats/sample", "before": 3.5e-4, "after_parameters": 3.4e-4, "after": -1e-7, "floor": 4.6e-6,
                "p_value_after": 0.4, "closed": 0.994, "closed_ci95": [0.98, 1.007], "measured_on": "second half"},
            "where": [{"channel": "accel_z", "band_hz": [11.1, 11.6], "tau_s": [0.03, 0.06], "from_s": 0, "to_s": 3600,
                "share": 0.98, "sign": "real noisier"}],
            "parameters": [{"channel": "gyro_x", "parameter": "N", "model": 1e-4, "capture": 1.2e-4, "ratio": 1.2,
                "ci95": [1.19e-4, 1.21e-4]}],
            "causes": [
                {"effect": "tone", "channels": ["accel_z"], "confidence": 0.999, "closes": 0.96,
                 "parameters": {"accel_z": {"frequency_hz": 11.4, "amplitude": 0.002}},
                 "uncertainty": {"accel_z": [{"amplitude": [0.0019, 0.0021]}]}, "evidence": ["2173 nats & more"]},
                {"effect": "bursts", "channels": ["gyro_x", "gyro_y"], "confidence": 0.5, "closes": null,
                 "parameters": {"gyro_x": {"intervals": [[1, 2]], "sigma": 1e-3}, "gyro_y": vec![json!({"sigma": 1}); 9]},
                 "evidence": []}],
            "alternatives": [{"effect": "resonance", "channels": ["accel_z"], "closes": null, "why_not": "355 nats less"}],
            "per_channel": {"accel_z": {"before": 1e-3, "after": 1e-6, "floor": 1e-6}, "gyro_x": {"before": 0, "after": 0, "floor": 0}},
            "notes": ["not compared: mag_x"], "software": "vn100d 0", "inputs": {"real": "night", "sim": "unit 7"}
        })
    }

    fn spectra() -> Value {
        let of = |channel: &str| {
            json!({"channel": channel, "unit": "m/s²", "frequency_hz": [0.1, 1, 10], "real": [1, 2, 3],
                   "before": [1, 2, 2], "after": null})
        };
        json!([of("accel_z"), of("accel_y")])
    }

    fn drawn(spectra: &str) -> Pictures<'_> {
        Pictures { spectra, residuals: "[]" }
    }

    #[test]
    fn residuals_of_a_motion_are_drawn_before_and_after() {
        let of = |channel: &str| {
            json!({"channel": channel, "unit": "m/s²", "against": "specific force", "axis": "z", "at_unit": "m/s²",
                   "at": [-9.8, 0, 9.8], "before": [0.1, 0, -0.1], "after": [0, 1e-4, 0]})
        };
        let residuals = json!([of("accel_z"), of("accel_y")]).to_string();
        let page = diagnosis(&report().to_string(), Pictures { spectra: "[]", residuals: &residuals }, &[]).unwrap();
        let at = |part: &str| page.find(part).unwrap_or_else(|| panic!("{part} is not in {page}"));
        assert!(at("aria-label=\"accel_z against the specific force along z") < at("channels without a finding"));
        assert!(at("channels without a finding") < at("aria-label=\"accel_y against the specific force along z"));
    }

    #[test]
    fn the_sentence_comes_first_and_every_part_is_there_without_anything_from_elsewhere() {
        let links = [("as JSON", "/v1/diagnoses/7".to_owned())];
        let page = diagnosis(&report().to_string(), drawn(&spectra().to_string()), &links).unwrap();
        let at = |part: &str| page.find(part).unwrap_or_else(|| panic!("{part} is not in {page}"));
        assert!(at("<h1>accel_z: a 11.400 Hz tone &lt;b&gt;") < at("The gap, in nats/sample"));
        assert!(at("the model as it is") < at("What the model lacks"));
        for part in [
            "99 % of the gap is closed (95 % interval 98 % to 101 %)",
            "<code>amplitude</code> 0.002 (0.0019 to 0.0021) m/s²",
            "<code>frequency_hz</code> 11.4",
            "gyro_y: and 3 more",
            "2173 nats &amp; more",
            "11.1 to 11.6",
            "355 nats less",
            "not compared: mag_x",
            "without a finding: accel_y",
            "href=\"/v1/diagnoses/7\"",
            "1.2·10⁻⁴ (1.19·10⁻⁴ to 1.21·10⁻⁴)",
        ] {
            at(part);
        }
        for absent in ["<b> that", "<script>", "http:", "https:", "url(", "NaN"] {
            assert!(!page.contains(absent), "{absent}");
        }
        for tag in ["table", "ul", "div", "figure", "svg", "details", "li", "tr"] {
            let (open, close) = (page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count());
            assert!(open >= close && close > 0, "{tag}: {open} and {close}");
        }
    }

    #[test]
    fn a_report_of_little_is_shown_and_no_report_is_refused() {
        let mut little = report();
        for key in ["where", "parameters", "causes", "alternatives", "notes", "per_channel", "software", "inputs"] {
            little.as_object_mut().unwrap().remove(key);
        }
        little["discrepancy"]["closed"] = Value::Null;
        let page = diagnosis(&little.to_string(), drawn("[]"), &[]).unwrap();
        assert!(!page.contains("What the model lacks") && !page.contains("is closed"), "{page}");
        assert!(diagnosis("{}", drawn("[]"), &[]).is_err());
    }

    #[test]
    fn what_was_not_finite_is_a_dash_and_loses_nothing_else() {
        let mut report = report();
        report["discrepancy"]["after"] = Value::Null;
        report["where"][0]["band_hz"] = json!([null, 11.6]);
        report["where"][0]["to_s"] = Value::Null;
        report["causes"][1]["confidence"] = Value::Null;
        report["per_channel"]["accel_z"]["after"] = Value::Null;
        let mut spectra = spectra();
        spectra[0]["real"][1] = Value::Null;
        let page = diagnosis(&report.to_string(), drawn(&spectra.to_string()), &[]).unwrap();
        assert!(!page.contains("NaN") && !page.contains("inf"), "{page}");
        for part in ["– to 11.6", "0 to –", "<td class=\"number\">–</td>", "0.001 → – (1·10⁻⁶)", "11.4"]
        {
            assert!(page.contains(part), "{part} is not in {page}");
        }
    }
}
