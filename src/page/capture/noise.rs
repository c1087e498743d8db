//! Noise parameters: the table in both unit systems, the Allan deviations, hour by hour, and the datasheet beside them.

use super::{Capture, CaptureView, TRIADS, escaped, figure, opened, wide};
use crate::page::figure::{parted, plain, span};
use crate::plot::number::rounded;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The parts of `vn100d-noise-1` that are shown.
#[derive(Debug, Deserialize)]
struct Noise {
    at_rest_s: Option<f64>,
    moving_s: Option<f64>,
    #[serde(default)]
    channels: BTreeMap<String, Parameters>,
    datasheet: Option<Sheet>,
}

#[derive(Debug, Deserialize)]
struct Parameters {
    #[serde(rename = "N")]
    n: Option<Estimate>,
    #[serde(rename = "B")]
    b: Option<Estimate>,
    #[serde(rename = "K")]
    k: Option<Estimate>,
    #[serde(rename = "Q")]
    q: Option<Estimate>,
    #[serde(rename = "R")]
    r: Option<Estimate>,
    gauss_markov: Option<GaussMarkov>,
    minimum: Option<Minimum>,
    #[serde(default)]
    record_needed: Needed,
    walk_shows_beyond_s: Option<f64>,
    #[serde(default)]
    fit: Fit,
    #[serde(default)]
    flags: Vec<Flag>,
}

#[derive(Debug, Deserialize)]
struct Minimum {
    deviation: f64,
    tau_s: f64,
    over_0_664: f64,
}

#[derive(Debug, Default, Deserialize)]
struct Needed {
    #[serde(rename = "B")]
    b: Option<f64>,
    #[serde(rename = "K")]
    k: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
struct Fit {
    curve: Option<Curve>,
}

#[derive(Debug, Deserialize)]
struct Curve {
    tau_s: Vec<f64>,
}

#[derive(Debug, Deserialize)]
struct Estimate {
    value: Option<f64>,
    ci95: Option<[f64; 2]>,
    upper_limit95: Option<f64>,
    unit: String,
    #[serde(default)]
    also: BTreeMap<String, f64>,
}

#[derive(Debug, Deserialize)]
struct GaussMarkov {
    sigma: Estimate,
    tc_s: Estimate,
}

#[derive(Debug, Deserialize)]
struct Flag {
    note: String,
}

#[derive(Debug, Deserialize)]
struct Sheet {
    name: String,
    source: String,
    channels: BTreeMap<String, Compared>,
}

#[derive(Debug, Deserialize)]
struct Compared {
    noise_density: Option<Density>,
    bias_stability: Option<Bias>,
    #[serde(default)]
    verdict: String,
}

#[derive(Debug, Deserialize)]
struct Density {
    measured: f64,
    datasheet: f64,
    printed: String,
    predicted: f64,
    ratio_to_predicted: f64,
    unit: String,
    verdict: String,
}

#[derive(Debug, Deserialize)]
struct Bias {
    allan_minimum: f64,
    tau_s: f64,
    datasheet: f64,
    printed: String,
    ratio: f64,
    unit: String,
    verdict: String,
    needed_s: Option<f64>,
}

/// The sections of `vn100d-noise-1` and of the pictures that belong to it.
pub(super) fn section(
    out: &mut String,
    document: &str,
    capture: &Capture,
    view: &CaptureView<'_>,
) -> Result<(), serde_json::Error> {
    let of: Noise = serde_json::from_str(document)?;
    if of.channels.is_empty() {
        return Ok(());
    }
    if let Some((at_rest_s, moving_s)) = of.at_rest_s.zip(of.moving_s).filter(|(_, moving_s)| *moving_s > 0.0) {
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<p class=\"soft\">At rest {at_rest_s:.1} s, in motion {moving_s:.1} s, which are left out.</p>"
        );
    }
    parameters(out, &of.channels);
    *out += "<h2>Allan deviation</h2><p class=\"soft\">Overlapping estimator with its 68 % band; dashed what the parameters above \
             predict, dotted the lines of N, B and K.</p><div class=\"figures\">";
    for triad in TRIADS {
        figure(out, view, &format!("allan-{triad}"));
    }
    *out += "</div>";
    for channel in of.channels.keys() {
        let names = [format!("allan-{channel}"), format!("hourly-{channel}")];
        if !names.iter().any(|name| view.figures.contains_key(name)) {
            continue;
        }
        let open = opened(view);
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<details{open}><summary>{}: N, B, K and hour by hour</summary><div class=\"figures\">",
            escaped(channel)
        );
        for name in &names {
            figure(out, view, name);
        }
        *out += "</div></details>";
    }
    if let Some(sheet) = &of.datasheet {
        datasheet(out, sheet, capture.sensor["model"].as_str().is_some_and(|model| !model.is_empty()));
    }
    Ok(())
}

fn parameters(out: &mut String, channels: &BTreeMap<String, Parameters>) {
    *out += "<h2>Noise parameters</h2><p class=\"soft\">With 95 % intervals. N: angle or velocity random walk; B: bias instability \
             (coefficient of the flicker noise); K: rate random walk. Where the data does not support a value, what it is below \
             with 95 % confidence.</p>";
    *out += &wide("noise parameters");
    *out += "<table><tr><th scope=\"col\">channel</th><th scope=\"col\">N</th>\
             <th scope=\"col\">B</th><th scope=\"col\">K</th></tr>";
    for (name, of) in channels {
        // What else there is to say takes a line below: a column of its own would lie out of sight.
        let more = more(of);
        let (class, rows) = if more.is_empty() { ("", 1) } else { (" class=\"noted\"", 2) };
        let _ = write!(
            out,
            "<tr{class}><th scope=\"row\" rowspan=\"{rows}\">{}</th><td>{}</td><td>{}</td><td>{}</td></tr>",
            escaped(name),
            cell(of.n.as_ref()),
            cell(of.b.as_ref()),
            cell(of.k.as_ref()),
        );
        if !more.is_empty() {
            let _ = write!(out, "<tr><td colspan=\"3\">{more}</td></tr>");
        }
    }
    *out += "</table></div>";
}

/// A parameter in the unit of the standard, and below it in the units that people quote.
fn cell(of: Option<&Estimate>) -> String {
    let Some(of) = of else { return "–".to_owned() };
    let unit = escaped(&of.unit);
    let Some(value) = of.value else {
        return of.upper_limit95.map_or_else(
            || "<span class=\"soft\">not found</span>".to_owned(),
            |limit| format!("<span class=\"soft\">below {} {unit}</span>", plain(limit)),
        );
    };
    let mut out = String::new();
    let mut line = |value: f64, ends: Option<[f64; 2]>, unit: &str, class: &str| {
        let told = match ends {
            Some(ends) => {
                let (value, interval) = parted(value, ends);
                format!("{value}&nbsp;{} <span class=\"interval\">{interval}</span>", escaped(unit))
            }
            None => format!("{}&nbsp;{}", plain(value), escaped(unit)),
        };
        let _ = write!(out, "<div class=\"{class}\">{told}</div>");
    };
    line(value, of.ci95, &of.unit, "main");
    for (unit, also) in &of.also {
        // Another unit is a factor.
        let ends = of.ci95.filter(|_| value != 0.0).map(|ends| ends.map(|end| end * also / value));
        line(*also, ends, unit, "soft");
    }
    out
}

fn more(of: &Parameters) -> String {
    let mut all: Vec<String> = Vec::new();
    for (name, own) in [("Q", &of.q), ("R", &of.r)] {
        if own.as_ref().is_some_and(|own| own.value.is_some()) {
            all.push(format!("{name}: {}", cell(own.as_ref())));
        }
    }
    if let Some(GaussMarkov { sigma, tc_s }) = &of.gauss_markov {
        all.push(format!("Gauss–Markov process: σ {} correlation time {}", cell(Some(sigma)), cell(Some(tc_s))));
    }
    all.extend(of_the_record(of));
    all.extend(of.flags.iter().map(|flag| escaped(&flag.note)));
    all.join("<br>")
}

/// The lowest deviation beside B, how long to record, and why no walk is seen.
fn of_the_record(of: &Parameters) -> Vec<String> {
    let mut all = Vec::new();
    let unit = |of: Option<&Estimate>| of.map(|of| escaped(&of.unit)).unwrap_or_default();
    if let Some(Minimum { deviation, tau_s, over_0_664 }) = of.minimum {
        let b = unit(of.b.as_ref());
        all.push(format!(
            "Lowest Allan deviation {} {b} at {} s; over 0.664 that is {} {b}, which B does not exceed but for the scatter of the curve.",
            plain(deviation),
            rounded(tau_s, 3),
            plain(over_0_664)
        ));
    }
    let times = [("B", of.record_needed.b), ("K", of.record_needed.k)];
    let times: Vec<String> =
        times.into_iter().filter_map(|(letter, s)| Some(format!("{letter} {}", span(s?)))).collect();
    if !times.is_empty() {
        all.push(format!("Known to ±20 % after, at rest and without a gap: {}.", times.join(", ")));
    }
    let limit_of = |of: &Option<Estimate>| of.as_ref().and_then(|of| of.upper_limit95);
    if limit_of(&of.b).is_some() {
        all.push("No flicker is seen: the record does not tell how long it takes to know B.".to_owned());
    }
    let limit = limit_of(&of.k);
    if let Some((beyond_s, limit)) = of.walk_shows_beyond_s.zip(limit) {
        let ends_s = of.fit.curve.as_ref().and_then(|curve| curve.tau_s.last().copied());
        let ends = match ends_s {
            Some(ends_s) if ends_s > beyond_s => {
                format!(", where this record's curve, which ends at {}, is of too few averages to tell", span(ends_s))
            }
            Some(ends_s) => format!("; this record's curve ends at {}", span(ends_s)),
            None => String::new(),
        };
        all.push(format!(
            "No random walk is seen, hence no slope of +½: one of {} {}, its limit, would rise above the lowest deviation beyond \
             {}{ends}.",
            plain(limit),
            unit(of.k.as_ref()),
            span(beyond_s)
        ));
    }
    all
}

fn datasheet(out: &mut String, sheet: &Sheet, known: bool) {
    let _ = write!(
        out,
        "<h2>Beside the datasheet of the {}</h2><p class=\"soft\">{}. Expected is the datasheet's density as it shows at this output \
         rate and filter; the ratio is to what is expected, else to the datasheet.{}</p>{}<table><tr><th scope=\"col\">channel</th><th scope=\"col\">figure</th>\
         <th scope=\"col\" class=\"number\">measured</th><th scope=\"col\" class=\"number\">datasheet</th>\
         <th scope=\"col\" class=\"number\">expected</th><th scope=\"col\">unit</th><th scope=\"col\" class=\"number\">ratio</th>\
         <th scope=\"col\">verdict</th></tr>",
        escaped(&sheet.name),
        escaped(sheet.source.trim_end_matches('.')),
        if known { "" } else { " Of what sensor the recording is it does not say: it is taken for one of these." },
        wide("beside the datasheet")
    );
    let mut row = |channel: &str,
                   figure: &str,
                   [measured, sheet, expected, ratio]: [Option<f64>; 4],
                   told: [&str; 3]| {
        let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| rounded(value, 3));
        let [printed, unit, verdict] = told;
        let class = if verdict == "within" || verdict == "explained_by_sampling" { "good" } else { "bad" };
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{figure}</td><td class=\"number\">{}</td><td class=\"number\" title=\"{}\">{}</td>\
             <td class=\"number\">{}</td><td>{}</td><td class=\"number\">{}</td><td><span class=\"{class}\">{}</span></td></tr>",
            escaped(channel),
            number(measured),
            escaped(printed),
            number(sheet),
            number(expected),
            escaped(unit),
            number(ratio),
            escaped(&verdict.replace('_', " "))
        );
    };
    for (name, of) in &sheet.channels {
        if of.verdict == "not_at_rest" {
            row(name, "", [None; 4], ["", "", &of.verdict]);
        }
        if let Some(density) = &of.noise_density {
            let Density { measured, datasheet, printed, predicted, ratio_to_predicted, unit, verdict } = density;
            row(
                name,
                "noise density",
                [measured, datasheet, predicted, ratio_to_predicted].map(|v| Some(*v)),
                [printed, unit, verdict],
            );
        }
        if let Some(bias) = &of.bias_stability {
            let Bias { allan_minimum, tau_s, datasheet, printed, ratio, unit, verdict, needed_s } = bias;
            let figure = format!("Allan minimum, at {} s", rounded(*tau_s, 2));
            let verdict = &match needed_s {
                Some(needed_s) => format!("too short to tell: {:.0} min would do", needed_s / 60.0),
                None => verdict.clone(),
            };
            row(name, &figure, [Some(*allan_minimum), Some(*datasheet), None, Some(*ratio)], [printed, unit, verdict]);
        }
    }
    *out += "</table></div>";
}
