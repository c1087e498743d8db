//! The findings: effects in which sensor and model differ, with their evidence, the alternatives considered, the
//! offsets, and the places.

use super::super::figure::{part, percent, plain, second, with_interval};
use super::super::{escaped, wide};
use imu_core::sample::Channel;
use imu_diagnosis::Diagnosis;
use imu_diagnosis::report::{Cause, Discrepancy, Driver, Hint, Of, Offset, Parameter, Place, Remainder, Sense};
use serde::Deserialize as _;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The maximum number of list entries shown of one cause on one channel.
const ENTRIES: usize = 6;
/// The maximum length of a list in a parameter, in characters.
const LONGEST: usize = 60;

pub(super) fn causes(out: &mut String, report: &Diagnosis) {
    if report.causes.is_empty() {
        return;
    }
    let heading = match report.causes.iter().all(|cause| cause.sense == Sense::Missing) {
        true => "What the model lacks",
        false => "Effects in which sensor and model differ",
    };
    let _ = write!(out, "<h2>{heading}</h2>");
    *out += &wide(&heading.to_lowercase());
    *out += "<table><tr><th scope=\"col\">effect</th><th scope=\"col\">on</th>\
             <th scope=\"col\">parameters, with 95&nbsp;% intervals</th><th scope=\"col\" class=\"number\">sure</th><th scope=\"col\" class=\"number\">closes</th></tr>";
    for cause in &report.causes {
        // Rounded down, so that the confidence is never overstated.
        let sure = percent((100.0 * cause.confidence).floor() / 100.0);
        let _ = write!(
            out,
            "<tr><td><b>{}</b>{}</td><td>{}</td><td>{}</td><td class=\"number\">{sure}</td><td class=\"number\">{}</td></tr>",
            escaped(&cause.effect.name().replace('_', " ")),
            match cause.sense {
                Sense::Missing => "",
                Sense::Superfluous => "<br>the sensor lacks it",
                Sense::Size => "<br>the model has it otherwise",
            },
            escaped(&cause.channels.join(", ")),
            [("", &cause.parameters), ("the model’s ", &cause.model)]
                .map(|(whose, of)| parameters(whose, of, cause))
                .concat(),
            closes(cause, &report.discrepancy).map_or_else(|| "–".to_owned(), |text| escaped(&text)),
        );
    }
    *out += "</table></div>";
    let _ = write!(
        out,
        "<p class=\"soft\">Sure: {}. Closes: the part of the gap that adding it closes.</p><ul>",
        escaped(super::SURE)
    );
    for sentence in report.causes.iter().flat_map(|cause| &cause.evidence) {
        let _ = write!(out, "<li class=\"soft\">{}</li>", escaped(sentence));
    }
    *out += "</ul>";
}

/// Returns the part of the gap that a cause closes, with its 95 % interval: the cause's part of the interval of the whole.
pub fn closes(cause: &Cause, gap: &Discrepancy) -> Option<String> {
    let own = cause.closes?;
    let interval = gap.closed_ci95.zip(gap.closed.filter(|closed| *closed > 0.0));
    let interval = interval.map_or_else(String::new, |([low, high], closed)| {
        let [low, high] = [low, high].map(|end| part(own * end / closed));
        format!(" ({} to {high})", low.trim_end_matches(" %"))
    });
    Some(part(own) + &interval)
}

/// Returns the parameters of a cause that the sensor or the model has, channel by channel, in a list.
fn parameters(whose: &str, all: &BTreeMap<String, Value>, cause: &Cause) -> String {
    if all.is_empty() {
        return String::new();
    }
    let mut out = String::from("<ul>");
    for (place, value) in all {
        let entries = entries(value);
        let known = cause.uncertainty.get(place).filter(|_| whose.is_empty());
        let known = known.map(self::entries).unwrap_or_default();
        let of = if all.len() > 1 { format!("{whose}{}: ", escaped(place)) } else { whose.to_owned() };
        for (index, entry) in entries.iter().take(ENTRIES).enumerate() {
            let intervals = known.get(index).copied();
            let fields = entry.as_object().into_iter().flatten().map(|(key, value)| {
                let unit = unit(cause, place, key, value).unwrap_or_default();
                let interval = intervals.and_then(|of| of.get(key));
                // A standard deviation is positive: a sign states that channels share noise with opposite signs.
                let opposite = value.as_f64().filter(|value| key == "sigma" && *value < 0.0);
                let text = match opposite {
                    Some(value) => {
                        let ends = interval.and_then(|of| <[f64; 2]>::deserialize(of).ok());
                        let positive =
                            ends.map_or_else(|| plain(-value), |[low, high]| with_interval(-value, [-high, -low]));
                        format!("{positive}{unit}, of opposite sign")
                    }
                    None => format!("{}{unit}", figure(value, interval)),
                };
                format!("<code>{}</code> {text}", escaped(key))
            });
            let fields: Vec<String> = fields.collect();
            let _ = write!(out, "<li>{of}{}</li>", fields.join(", "));
        }
        if entries.len() > ENTRIES {
            let _ = write!(out, "<li>{of}and {} more</li>", entries.len() - ENTRIES);
        }
    }
    out + "</ul>"
}

/// Returns the unit of an effect's parameter on a channel, if it follows the channel's; other parameters have it in
/// their names.
fn unit(cause: &Cause, place: &str, parameter: &str, value: &Value) -> Option<String> {
    let unit = Channel::from_name(place)?.unit();
    let of = cause.effect.spec().parameters.iter().find(|of| of.name == parameter)?.unit;
    let has_pairs = value.as_array().is_some_and(|list| list.iter().any(Value::is_array));
    if has_pairs || !of.contains('U') {
        return None;
    }
    Some(match of.strip_prefix("U/") {
        Some("√Hz") => format!(" {unit}/√Hz"),
        Some(rest) => format!(" {unit} per {rest}"),
        None if of == "U" => format!(" {unit}"),
        None => format!(" {}", of.replace('U', &format!("({unit})"))),
    })
}

/// Returns one value, or the values of a list.
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
            let numbers = || value.as_array()?.iter().map(|of| of.as_f64().map(plain)).collect::<Option<Vec<String>>>();
            let text = match (value.as_str(), numbers()) {
                (Some(text), _) => text.to_owned(),
                (None, Some(numbers)) => numbers.join(", "),
                (None, None) => value.to_string(),
            };
            // A parameter is never cut: of a long list the number of entries is stated.
            let long = value.as_array().filter(|_| text.chars().count() > LONGEST);
            long.map_or_else(|| escaped(&text), |list| format!("{} entries", list.len()))
        }
    }
}

pub(super) fn off(out: &mut String, parameters: &[Parameter]) {
    if parameters.is_empty() {
        return;
    }
    *out += "<h2>Parameters that are off</h2>";
    *out += &wide("parameters that are off");
    *out += "<table><tr><th scope=\"col\">channel</th><th scope=\"col\">parameter</th>\
             <th scope=\"col\" class=\"number\">model</th><th scope=\"col\" class=\"number\">recording</th><th scope=\"col\" class=\"number\">ratio</th></tr>";
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

pub(super) fn offsets(out: &mut String, offsets: &[Offset]) {
    if offsets.is_empty() {
        return;
    }
    *out += "<h2>Means that differ</h2><ul>";
    for of in offsets {
        let unit = Channel::from_name(&of.channel).map(|channel| format!(" {}", channel.unit())).unwrap_or_default();
        let _ = write!(
            out,
            "<li>{}: {}{unit} in the recording, {}{unit} in the model; turn-on bias explains up to {}{unit}</li>",
            escaped(&of.channel),
            plain(of.capture),
            plain(of.model),
            plain(of.explained)
        );
    }
    *out += "</ul>";
}

pub(super) fn hints(out: &mut String, hints: &[Hint]) {
    if hints.is_empty() {
        return;
    }
    *out += "<h2>What the sizes may mean</h2><ul>";
    for of in hints {
        let _ = write!(out, "<li>{}: {}</li>", escaped(&of.about), escaped(&of.text));
    }
    *out += "</ul>";
}

pub(super) fn remainder(out: &mut String, of: Option<&Remainder>) {
    let Some(Remainder { share, channels, what, .. }) = of else { return };
    let on = escaped(&channels.join(", "));
    let _ = write!(out, "<h2>Without a name</h2><p>{:.2} % of the gap, on {on}</p><ul>", 100.0 * share);
    for one in what {
        let _ = write!(out, "<li>{}</li>", escaped(one));
    }
    *out += "</ul>";
}

pub(super) fn places(out: &mut String, report: &Diagnosis) {
    if report.r#where.is_empty() {
        return;
    }
    let _ = write!(
        out,
        "<h2>Where the gap lies</h2>{}<table><tr><th scope=\"col\">what</th><th scope=\"col\">channel</th><th scope=\"col\">band in Hz, or motion</th><th scope=\"col\">time in s</th>\
         <th scope=\"col\" class=\"number\">share</th><th scope=\"col\">the recording is</th></tr>",
        wide("where the gap lies")
    );
    for of in &report.r#where {
        let [from_hz, to_hz] = of.band_hz.map(plain);
        let band = of.at.as_ref().map_or_else(|| format!("{from_hz} to {to_hz}"), driver);
        let warm = of
            .temperature_c
            .map_or_else(String::new, |[low, high]| format!(", at {} to {} °C", plain(low), plain(high)));
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{} to {}{warm}</td><td class=\"number\">{}</td><td>{}</td></tr>",
            escaped(what(report, of)),
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

/// Returns the state of the motion at a gap that it drives.
fn driver(of: &Driver) -> String {
    let Driver { quantity, axis, unit, range, pose } = of;
    let [from, to] = range.map(plain);
    match pose {
        Some(pose) => escaped(pose),
        None => format!("{} {} {from} to {to} {}", escaped(quantity), escaped(axis), escaped(unit)),
    }
}

pub(super) fn alternatives(out: &mut String, report: &Diagnosis) {
    if !report.alternatives.is_empty() {
        *out += "<h2>What was weighed and not named</h2><ul>";
        for of in &report.alternatives {
            let _ = write!(
                out,
                "<li>{} on {}: {}</li>",
                escaped(&of.effect.name().replace('_', " ")),
                escaped(&of.channels.join(", ")),
                escaped(&of.why_not)
            );
        }
        *out += "</ul>";
    }
}

/// Returns the content of a place: the name of its effect, or another description.
fn what<'a>(report: &'a Diagnosis, place: &Place) -> &'a str {
    match place.of {
        Of::Cause(index) => report.causes.get(index).map_or("–", |cause| cause.effect.name()),
        Of::Parameters => "a parameter",
        Of::Remainder => "nothing known",
    }
}
