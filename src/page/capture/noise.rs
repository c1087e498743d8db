//! Noise parameters: the table in both unit systems, the Allan deviations, hour by hour, and the datasheet beside them.

use super::{CaptureView, TRIADS, by_name, escaped, figure, opened, wide};
use crate::page::figure::{parted, plain};
use crate::plot::number::rounded;
use crate::store::CaptureRow;
use imu_core::sample::Channel;
use imu_files::export::paste::Paste;
use imu_noise::NoiseReport;
use imu_noise::datasheet::{BiasComparison, Comparison, Datasheet, DensityComparison, Verdict, compare_report};
use imu_noise::fit::{Estimate, Flag, GaussMarkov, NoiseParameters};
use imu_noise::words::grouped;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The datasheet with which sensors are compared, and the prefix of the models that it covers.
const DATASHEET: (&str, &str) = ("vn-100", "VN-100");

/// Writes the sections of the noise parameters and of the pictures that belong to them.
pub(super) fn section(out: &mut String, of: &NoiseReport, view: &CaptureView<'_>) {
    if of.channels.is_empty() {
        return;
    }
    if let Some((at_rest_s, moving_s)) = of.at_rest_s.zip(of.moving_s).filter(|(_, moving_s)| *moving_s > 0.0) {
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<p class=\"soft\">At rest {at_rest_s:.1} s, in motion {moving_s:.1} s, which are left out.</p>"
        );
    }
    parameters(out, &of.channels, opened(view));
    paste(out, &Paste::of(of), view.link());
    *out += "<h2>Allan deviation</h2><p class=\"soft\">Overlapping estimator with its 68 % band; dashed what the parameters above \
             predict, dotted the lines of N, B and K.</p><div class=\"figures\">";
    for triad in TRIADS {
        figure(out, view, &format!("allan-{}", triad.name()));
    }
    *out += "</div>";
    for (channel, _) in by_name(&of.channels) {
        let names = [format!("allan-{channel}"), format!("hourly-{channel}")];
        if !names.iter().any(|name| view.figures.contains_key(name)) {
            continue;
        }
        let open = opened(view);
        // Writing to a text cannot fail.
        let _ =
            write!(out, "<details{open}><summary>{channel}: N, B, K and hour by hour</summary><div class=\"figures\">");
        for name in &names {
            figure(out, view, name);
        }
        *out += "</div></details>";
    }
    let model = view.facts.row.sensor.model().unwrap_or_default();
    if let Some(sheet) = compared(of, model, &view.facts.row) {
        datasheet(out, &sheet, !model.is_empty());
    }
}

/// Returns the parameters beside the datasheet, unless the sensor is known to be another maker's.
fn compared(report: &NoiseReport, model: &str, row: &CaptureRow) -> Option<Comparison> {
    let (sheet, family) = DATASHEET;
    let sheet = Datasheet::named(sheet).ok().filter(|_| model.is_empty() || model.starts_with(family))?;
    compare_report(&sheet, report, row.configuration.filter_windows()).ok()
}

fn parameters(out: &mut String, channels: &BTreeMap<Channel, NoiseParameters>, open: &str) {
    *out += "<h2>Noise parameters</h2><p class=\"soft\">With 95 % intervals. N: angle or velocity random walk; B: bias instability \
             (coefficient of the flicker noise); K: rate random walk. If the data does not support a value, it is below what is shown with \
             95 % confidence.</p>";
    *out += &wide("noise parameters");
    *out += "<table><tr><th scope=\"col\">channel</th><th scope=\"col\">N</th>\
             <th scope=\"col\">B</th><th scope=\"col\">K</th></tr>";
    for (name, of) in by_name(channels) {
        // Further remarks take a line below: in a separate column they would be out of sight.
        let more = more(of, open);
        let (class, rows) = if more.is_empty() { ("", 1) } else { (" class=\"noted\"", 2) };
        let _ = write!(
            out,
            "<tr{class}><th scope=\"row\" rowspan=\"{rows}\">{}</th><td>{}</td><td>{}</td><td>{}</td></tr>",
            name,
            cell(&of.n),
            cell(&of.b),
            cell(&of.k),
        );
        if !more.is_empty() {
            let _ = write!(out, "<tr><td colspan=\"3\">{more}</td></tr>");
        }
    }
    *out += "</table></div>";
}

/// Returns a parameter in the unit of the standard, and below it in the units in common use.
fn cell(of: &Estimate) -> String {
    let unit = escaped(&of.unit);
    let alone = if of.source.is_some() { "<div class=\"soft\">from the Allan deviation alone</div>" } else { "" };
    let Some(value) = of.value else {
        let limit = of.upper_limit95.map_or_else(
            || "<span class=\"soft\">not found</span>".to_owned(),
            |limit| format!("<span class=\"soft\">below {} {unit}</span>", plain(limit)),
        );
        return limit + alone;
    };
    let mut out = String::new();
    let mut line = |value: f64, ends: Option<[f64; 2]>, unit: &str, class: &str| {
        let text = match ends {
            Some(ends) => {
                let (value, interval) = parted(value, ends);
                format!("{value}&nbsp;{} <span class=\"interval\">{interval}</span>", escaped(unit))
            }
            None => format!("{}&nbsp;{}", plain(value), escaped(unit)),
        };
        let _ = write!(out, "<div class=\"{class}\">{text}</div>");
    };
    line(value, of.ci95, &of.unit, "main");
    for (unit, also) in &of.also {
        // Another unit differs by a factor.
        let ends = of.ci95.filter(|_| value != 0.0).map(|ends| ends.map(|end| end * also / value));
        line(*also, ends, unit, "soft");
    }
    out + alone
}

/// Returns further remarks on a channel: first whether its parameters may be used.
fn more(of: &NoiseParameters, open: &str) -> String {
    let mut all: Vec<String> = Vec::new();
    if !of.usable {
        let reason = of.reason.as_deref().map_or_else(String::new, |reason| format!(": {}", escaped(reason)));
        all.push(format!("<strong class=\"bad\">not usable{reason}</strong>"));
    }
    for (name, own) in [("Q", &of.q), ("R", &of.r)] {
        if own.value.is_some() || own.source.is_some() {
            all.push(format!("{name}: {}", cell(own)));
        }
    }
    if let Some(GaussMarkov { sigma, tc_s }) = &of.gauss_markov {
        all.push(format!("Gauss–Markov process: σ {} correlation time {}", cell(sigma), cell(tc_s)));
    }
    all.extend(of.sentences(plain).iter().map(|sentence| escaped(&capitalized(sentence))));
    let sentence = |flag: &Flag| escaped(&capitalized(&flag.words()));
    let (words, counted, others) = grouped(&of.flags);
    all.extend(others.into_iter().map(sentence));
    let mut out = all.join("<br>");
    if let Some(words) = words {
        let each: Vec<String> = counted.into_iter().map(sentence).collect();
        let _ = write!(out, "<details{open}><summary>{}</summary>{}</details>", escaped(&words), each.join("<br>"));
    }
    out
}

/// Returns the sentence with a capital first letter.
fn capitalized(sentence: &str) -> String {
    let mut letters = sentence.chars();
    letters.next().map(|first| format!("{}{}.", first.to_uppercase(), letters.as_str())).unwrap_or_default()
}

/// Writes the numbers to paste, and where to paste them; on a served page with links to the files.
fn paste(out: &mut String, paste: &Paste, id: Option<i64>) {
    let (header, rows) = paste.table(plain);
    if rows.is_empty() {
        return;
    }
    *out += "<h2>Which number to paste where</h2><p class=\"soft\">Each in that program's own convention. One number \
             stands for three axes, that of the largest; each axis: the file has all three, and the largest stands here. &lt;: not \
             identified, 95 % upper limit. A dash: the program takes none, or the record has none for it.</p>";
    *out += &wide("which number to paste where");
    *out += "<table><tr>";
    for title in header {
        let _ = write!(out, "<th scope=\"col\">{title}</th>");
    }
    *out += "</tr>";
    let refused = rows.iter().flatten().any(|cell| cell == Paste::UNUSABLE);
    for row in &rows {
        *out += "<tr>";
        for (place, cell) in row.iter().enumerate() {
            let text = escaped(cell);
            let _ = match (place, id) {
                (0, Some(id)) => {
                    write!(out, "<th scope=\"row\"><a href=\"/v1/captures/{id}/noise?format={text}\">{text}</a></th>")
                }
                (0, None) => write!(out, "<th scope=\"row\">{text}</th>"),
                _ if cell == Paste::UNUSABLE => write!(out, "<td><span class=\"bad\">{text}</span></td>"),
                _ => write!(out, "<td>{text}</td>"),
            };
        }
        *out += "</tr>";
    }
    *out += "</table></div>";
    if refused {
        *out += "<p class=\"bad\">Not usable: a channel may not be used, for the reason above, and its files are refused.</p>";
    }
    let _ = write!(out, "<p class=\"soft\">{}</p>", escaped(&paste.note));
}

fn datasheet(out: &mut String, sheet: &Comparison, known: bool) {
    let _ = write!(
        out,
        "<h2>Beside the datasheet of the {}</h2><p class=\"soft\">{}. Expected is the datasheet's density as it shows at this output \
         rate and filter; the ratio is to what is expected, else to the datasheet.{}</p>{}<table><tr><th scope=\"col\">channel</th><th scope=\"col\">figure</th>\
         <th scope=\"col\" class=\"number\">measured</th><th scope=\"col\" class=\"number\">datasheet</th>\
         <th scope=\"col\" class=\"number\">expected</th><th scope=\"col\">unit</th><th scope=\"col\" class=\"number\">ratio</th>\
         <th scope=\"col\">verdict</th></tr>",
        escaped(&sheet.name),
        escaped(sheet.source.trim_end_matches('.')),
        if known { "" } else { " The recording does not name its sensor: it is taken for one of these." },
        wide("beside the datasheet")
    );
    let mut row = |channel: &str,
                   figure: &str,
                   [measured, sheet, expected, ratio]: [Option<f64>; 4],
                   [printed, unit]: [&str; 2],
                   verdict: Verdict,
                   needed: &str| {
        let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| rounded(value, 3));
        let (class, verdict) = match verdict {
            Verdict::Within => ("good", "within"),
            Verdict::ExplainedBySampling => ("good", "explained by sampling"),
            // This is no verdict on the sensor.
            Verdict::TooShort => ("soft", "too short"),
            Verdict::NotAtRest => ("soft", "not at rest"),
            Verdict::Above => ("bad", "above"),
        };
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{figure}</td><td class=\"number\">{}</td><td class=\"number\" title=\"{}\">{}</td>\
             <td class=\"number\">{}</td><td>{}</td><td class=\"number\">{}</td><td><span class=\"{class}\">{}</span></td></tr>",
            channel,
            number(measured),
            escaped(printed),
            number(sheet),
            number(expected),
            escaped(unit),
            number(ratio),
            format_args!("{verdict}{needed}")
        );
    };
    for (name, of) in by_name(&sheet.channels) {
        if of.verdict == Verdict::NotAtRest {
            row(name, "", [None; 4], ["", ""], of.verdict, "");
        }
        if let Some(density) = &of.noise_density {
            let DensityComparison { measured, datasheet, predicted, ratio_to_predicted, .. } = density;
            let numbers = [measured, datasheet, predicted, ratio_to_predicted].map(|number| Some(*number));
            row(name, "noise density", numbers, [&density.printed, &density.unit], density.verdict, "");
        }
        if let Some(bias) = &of.bias_stability {
            let BiasComparison { allan_minimum, tau_s, datasheet, ratio, needed_s, .. } = bias;
            let figure = format!("Allan minimum, at {} s", rounded(*tau_s, 2));
            let needed = needed_s.map_or_else(String::new, |needed_s| {
                format!(" to tell: {:.0} min of recording at rest would do", needed_s / 60.0)
            });
            let numbers = [Some(*allan_minimum), Some(*datasheet), None, Some(*ratio)];
            row(name, &figure, numbers, [&bias.printed, &bias.unit], bias.verdict, &needed);
        }
    }
    *out += "</table></div>";
}
