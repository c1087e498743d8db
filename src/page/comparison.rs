//! Two captures side by side: what they are, their noise parameters with the ratio of each, and their pictures.

use super::capture::{missing, options, sensor};
use super::figure::{clock, parted, plain, span};
use super::picture::{self, Figure};
use super::{Kind, escaped, framed, wide};
use crate::jobs::Documents;
use crate::plot::number::rounded;
use crate::store::CaptureRow;
use imu_core::sample::{Channel, Triad};
use imu_noise::NoiseReport;
use imu_noise::fit::{Estimate, NoiseParameters};
use imu_noise::ratio::{Difference, compare};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The pictures that are shown beside each other, by their names, under their headings.
pub const PAIRS: [(&str, &[&str]); 2] =
    [("Gaps", &["gaps"]), ("Power spectrum", &["psd-gyro", "psd-accel", "psd-mag"])];

/// One of the two captures.
#[derive(Debug, Clone, Copy)]
pub struct Side<'a> {
    /// Its row.
    pub row: &'a CaptureRow,
    /// Its analyses.
    pub documents: &'a Documents,
    /// Its pictures by name; those of [`PAIRS`] are shown.
    pub figures: &'a BTreeMap<String, Figure>,
}

/// The content of the page.
#[derive(Debug, Clone, Copy)]
pub struct ComparisonView<'a> {
    /// The captures.
    pub sides: [Side<'a>; 2],
    /// Pictures with a curve of each.
    pub both: &'a [Figure],
    /// The computations in progress, or the reasons why something is missing: sentences.
    pub remarks: &'a [String],
    /// Whether the page will show something that is being computed.
    pub waits: bool,
}

/// Returns the page on which two captures are chosen.
pub fn choice(captures: &[CaptureRow]) -> String {
    let title = "Two captures side by side";
    let options = options(captures);
    let body = match captures.len() {
        0 | 1 => format!("<h1>{title}</h1><p>There are no two captures that have ended.</p>"),
        _ => format!(
            "<h1>{title}</h1><form class=\"search\" action=\"/compare\"><label>one <select name=\"a\">{options}</select></label>\
             <label>the other <select name=\"b\">{options}</select></label><button>show both</button></form>"
        ),
    };
    framed(title, Kind::Served, &body)
}

/// Returns the page.
pub fn comparison(view: &ComparisonView<'_>) -> String {
    let names = view.sides.map(|side| escaped(&side.row.name));
    let [a, b] = view.sides.map(|side| side.row.id);
    let mut out = format!(
        "<p class=\"soft\"><a href=\"/compare\">two captures</a> side by side</p><h1>{} and {}</h1>\
         <p class=\"soft\"><a href=\"/compare?a={b}&amp;b={a}\">the other way round</a></p>",
        names[0], names[1]
    );
    for remark in view.remarks {
        // Writing to a text cannot fail.
        let _ = write!(out, "<p class=\"remark\">{}</p>", escaped(remark));
    }
    samples(&mut out, view, &names);
    if let [Some(a), Some(b)] = view.sides.map(|side| side.documents.noise.as_ref()) {
        noise(&mut out, [a, b], &names);
    }
    levels(&mut out, view, &names);
    curves(&mut out, view);
    pictures(&mut out, view);
    let title = view.sides.map(|side| side.row.name.as_str()).join(" and ");
    framed(&title, if view.waits { Kind::Waiting(3) } else { Kind::Served }, &out)
}

/// Returns the key by which channels are sorted: gyroscope, accelerometer, magnetometer, the others.
pub fn order(channel: &Channel) -> (usize, &'static str) {
    let triads = [Triad::Gyro, Triad::Accel, Triad::Mag];
    let place = triads.iter().position(|triad| channel.triad() == Some(*triad)).unwrap_or(triads.len());
    (place, channel.name())
}

/// Begins a table: a column for what is compared, one for each capture, and those behind.
fn table(out: &mut String, label: &str, before: &[&str], names: &[String; 2], behind: &[&str]) {
    *out += &wide(label);
    *out += "<table><tr>";
    for name in before.iter().copied().chain(names.iter().map(String::as_str)).chain(behind.iter().copied()) {
        let _ = write!(out, "<th scope=\"col\">{name}</th>");
    }
    *out += "</tr>";
}

/// Writes what the captures are, and what is missing of them.
fn samples(out: &mut String, view: &ComparisonView<'_>, names: &[String; 2]) {
    let rows = view.sides.map(|side| side.row);
    let links = [0, 1].map(|side| format!("<a href=\"/captures/{}\">{}</a>", rows[side].id, names[side]));
    *out += "<h2>Samples</h2>";
    table(out, "samples", &["what"], &links, &[]);
    type Cell = fn(&CaptureRow) -> String;
    let cells: [(&str, Cell); 10] = [
        ("begun (UTC)", |of| of.started_at.map_or_else(|| "–".to_owned(), |at| clock(&at.to_string()))),
        ("length", |of| span(of.duration_s)),
        ("rate", rate),
        ("samples", |of| of.samples.to_string()),
        ("gaps", missing),
        ("not taken", |of| of.rejected.values().sum::<u64>().to_string()),
        ("state", |of| of.state.name().to_owned()),
        ("sensor", |of| escaped(sensor(of).as_deref().unwrap_or(&of.source))),
        ("note", |of| escaped(of.note.as_deref().unwrap_or_default())),
        ("made by", |of| escaped(&of.software)),
    ];
    for (name, cell) in cells {
        let [a, b] = rows.map(cell);
        if !(a.is_empty() && b.is_empty()) {
            let _ = write!(out, "<tr><th scope=\"row\">{name}</th><td>{a}</td><td>{b}</td></tr>");
        }
    }
    *out += "</table></div>";
}

fn rate(of: &CaptureRow) -> String {
    let assumed = if of.rate_assumed { " (assumed)" } else { "" };
    of.rate_hz.map_or_else(|| "–".to_owned(), |rate_hz| format!("{} Hz{assumed}", plain(rate_hz)))
}

/// Writes the noise parameters, and how the second capture's compare with the first one's.
fn noise(out: &mut String, reports: [&NoiseReport; 2], names: &[String; 2]) {
    *out += "<h2>Noise parameters</h2><p class=\"soft\">With 95 % intervals. The ratio is the second over the first; its interval \
             holds for independent captures. They differ if it does not contain 1: of twenty equal pairs one does so by \
             chance.</p>";
    table(out, "noise parameters", &["channel", "parameter"], names, &["ratio", "second is"]);
    let mut channels: Vec<Channel> = reports.iter().flat_map(|of| of.channels.keys().copied()).collect();
    channels.sort_by_key(order);
    channels.dedup();
    for channel in channels {
        let of = reports.map(|report| report.channels.get(&channel));
        let rows = ["N", "B", "K"].map(|name| (name, of.map(|of| of.map(|of| parameter(of, name)))));
        let unusable = unusable(of, names);
        let _ = write!(
            out,
            "<tr><th scope=\"rowgroup\" rowspan=\"{}\">{channel}</th>",
            rows.len() + usize::from(!unusable.is_empty())
        );
        for (place, (name, of)) in rows.into_iter().enumerate() {
            let [a, b] = of.map(|of| of.map_or_else(|| "–".to_owned(), cell));
            let (ratio, verdict) = match of {
                [Some(a), Some(b)] => verdict(a, b),
                _ => ("–".to_owned(), String::new()),
            };
            let _ = write!(
                out,
                "{}<th scope=\"row\">{name}</th><td>{a}</td><td>{b}</td><td>{ratio}</td><td>{verdict}</td></tr>",
                if place == 0 { "" } else { "<tr>" },
            );
        }
        if !unusable.is_empty() {
            let _ = write!(out, "<tr><td colspan=\"5\" class=\"bad\">{unusable}</td></tr>");
        }
    }
    *out += "</table></div>";
}

fn parameter<'a>(of: &'a NoiseParameters, name: &str) -> &'a Estimate {
    match name {
        "N" => &of.n,
        "B" => &of.b,
        _ => &of.k,
    }
}

/// Returns which of the captures' parameters may not be used, and why.
fn unusable(of: [Option<&NoiseParameters>; 2], names: &[String; 2]) -> String {
    let reasons = of.into_iter().zip(names).filter_map(|(of, name)| {
        let of = of.filter(|of| !of.usable)?;
        let reason = of.reason.as_deref().map_or_else(String::new, |reason| format!(": {}", escaped(reason)));
        Some(format!("not usable in {name}{reason}"))
    });
    reasons.collect::<Vec<_>>().join("<br>")
}

fn cell(of: &Estimate) -> String {
    let unit = escaped(&of.unit);
    match (of.value, of.ci95, of.upper_limit95) {
        (Some(value), Some(ends), _) => {
            let (value, interval) = parted(value, ends);
            format!("{value}&nbsp;{unit} <span class=\"interval\">{interval}</span>")
        }
        (Some(value), None, _) => format!("{}&nbsp;{unit}", plain(value)),
        (None, _, Some(limit)) => format!("<span class=\"soft\">below {} {unit}</span>", plain(limit)),
        (None, ..) => "<span class=\"soft\">not found</span>".to_owned(),
    }
}

/// Returns the ratio and what it means.
fn verdict(a: &Estimate, b: &Estimate) -> (String, String) {
    let (ratio, difference) = compare(a, b);
    let verdict = match difference {
        Difference::Same => "<span class=\"soft\">not different</span>",
        Difference::Smaller => "<strong>smaller</strong>",
        Difference::Larger => "<strong>larger</strong>",
        Difference::Unknown => "",
    };
    let ratio = ratio.map_or_else(
        || "–".to_owned(),
        |of| {
            let (value, interval) = parted(of.value, of.ci95);
            format!("{value} <span class=\"interval\">{interval}</span>")
        },
    );
    (ratio, verdict.to_owned())
}

/// Writes the mean and the scatter of every channel.
fn levels(out: &mut String, view: &ComparisonView<'_>, names: &[String; 2]) {
    let [Some(a), Some(b)] = view.sides.map(|side| side.documents.statistics.as_ref()) else { return };
    let mut channels: Vec<Channel> = a.channels.keys().filter(|own| b.channels.contains_key(own)).copied().collect();
    channels.sort_by_key(order);
    if channels.is_empty() {
        return;
    }
    *out += "<h2>Mean and standard deviation</h2>";
    table(out, "mean and standard deviation", &["channel", "figure"], names, &["second less first"]);
    for channel in channels {
        let of = [&a.channels[&channel], &b.channels[&channel]];
        let unit = escaped(&of[0].unit);
        let rows = [("mean", of.map(|of| of.mean), 6), ("std", of.map(|of| of.std), 4)];
        for (place, (name, [a, b], digits)) in rows.into_iter().enumerate() {
            let first =
                if place == 0 { format!("<th scope=\"rowgroup\" rowspan=\"2\">{channel}</th>") } else { String::new() };
            let shown = |value: Option<f64>, digits| {
                value.map_or_else(|| "–".to_owned(), |value| format!("{}&nbsp;{unit}", rounded(value, digits)))
            };
            let less = shown(a.zip(b).map(|(a, b)| b - a), 3);
            let _ = write!(
                out,
                "<tr>{first}<th scope=\"row\">{name}</th><td>{}</td><td>{}</td><td>{less}</td></tr>",
                shown(a, digits),
                shown(b, digits)
            );
        }
    }
    *out += "</table></div>";
}

/// Writes the pictures that have a curve of each capture.
fn curves(out: &mut String, view: &ComparisonView<'_>) {
    if view.both.is_empty() {
        return;
    }
    *out += "<h2>Allan deviation</h2><p class=\"soft\">Overlapping estimator with its 68 % bands.</p><div class=\"figures\">";
    view.both.iter().for_each(|figure| picture::write(out, figure, None));
    *out += "</div>";
}

/// Writes the pictures of each capture, those of one heading beside each other.
fn pictures(out: &mut String, view: &ComparisonView<'_>) {
    for (heading, names) in PAIRS {
        let there = |name: &&&str| view.sides.iter().any(|side| side.figures.contains_key(**name));
        let names: Vec<&&str> = names.iter().filter(there).collect();
        if names.is_empty() {
            continue;
        }
        let _ = write!(out, "<h2>{heading}</h2><div class=\"figures\">");
        for name in names {
            for side in &view.sides {
                match side.figures.get(*name) {
                    Some(figure) => picture::write(out, figure, Some(&side.row.name)),
                    None => *out += "<span></span>",
                }
            }
        }
        *out += "</div>";
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::rows;
    use serde_json::{Value, json};

    fn row(id: i64, name: &str) -> CaptureRow {
        CaptureRow { id, name: name.to_owned(), ..rows::capture() }
    }

    /// Returns documents of one channel.
    fn documents(n: Value, changed: Value) -> Documents {
        let unknown = |unit: &str| json!({"value": null, "identified": false, "unit": unit});
        let mut own = json!({"unit": "rad/s", "N": n, "B": unknown("rad/s"), "K": unknown("rad/s/√s"), "Q": unknown("rad"),
            "R": unknown("rad/s/s"), "fit": {"method": "whittle-dst"}, "flags": []});
        own.as_object_mut().unwrap().extend(changed.as_object().unwrap().clone());
        let noise = json!({"format": NoiseReport::FORMAT, "capture": "a", "rate_hz": 40.0, "duration_s": 1.0, "samples": 40,
            "missing": 0, "complete": true, "channels": {"gyro_x": own}});
        let of = json!({"unit": "rad/s", "n": 2, "not_finite": 0, "mean": 1e-3, "std": 2e-3, "min": 0.0, "max": 0.0,
            "skewness": 0.0, "kurtosis": 0.0, "histogram": {"edges": [], "counts": []}, "normality": null});
        let statistics = json!({"format": "vn100d-statistics-1", "capture": "a", "duration_s": 1.0, "samples": 2, "missing": 0,
            "complete": true, "channels": {"gyro_x": of}});
        Documents {
            statistics: Some(serde_json::from_value(statistics).unwrap()),
            allan: None,
            noise: Some(serde_json::from_value(noise).unwrap()),
        }
    }

    fn n(value: f64) -> Value {
        json!({"value": value, "ci95": [0.98 * value, 1.02 * value], "identified": true, "unit": "rad/s/√Hz"})
    }

    #[test]
    fn numbers_stand_beside_each_other_with_their_ratio_and_nothing_is_markup() {
        let (rows, a) = ([row(7, "<night>"), row(8, "foam & desk")], documents(n(1e-4), json!({})));
        let b = documents(n(1.2e-4), json!({"usable": false, "reason": "<it> moved", "B": n(2.0)}));
        let psd = Figure::Linked { alt: "<psd>".to_owned(), address: "/p/psd-gyro.svg".to_owned(), height: 340 };
        let figures = [BTreeMap::from([("psd-gyro".to_owned(), psd.clone())]), BTreeMap::new()];
        let sides = [
            Side { row: &rows[0], documents: &a, figures: &figures[0] },
            Side { row: &rows[1], documents: &b, figures: &figures[1] },
        ];
        let remarks = ["the noise is <being> computed".to_owned()];
        let page = comparison(&ComparisonView { sides, both: &[psd], remarks: &remarks, waits: true });
        for expected in [
            "<h1>&lt;night&gt; and foam &amp; desk</h1>",
            "<a href=\"/compare?a=8&amp;b=7\">the other way round</a>",
            "<th scope=\"col\"><a href=\"/captures/7\">&lt;night&gt;</a></th>",
            "<tr><th scope=\"row\">gaps</th><td>10 missing (less than 1 %) in 1 gap</td>",
            "<tr><th scope=\"row\">rate</th><td>40 Hz</td><td>40 Hz</td></tr>",
            "1·10⁻⁴&nbsp;rad/s/√Hz <span class=\"interval\">9.8·10⁻⁵ to 1.02·10⁻⁴</span></td>\
             <td>1.2·10⁻⁴&nbsp;rad/s/√Hz",
            "<td>1.2 <span class=\"interval\">1.167 to 1.234</span></td><td><strong>larger</strong></td>",
            "<td><span class=\"soft\">not found</span></td>",
            "class=\"bad\">not usable in foam &amp; desk: &lt;it&gt; moved</td>",
            "<th scope=\"row\">mean</th><td>0.001&nbsp;rad/s</td><td>0.001&nbsp;rad/s</td><td>0&nbsp;rad/s</td>",
            "<figcaption>&lt;night&gt; · <a href=\"/p/psd-gyro.png\">PNG</a></figcaption>",
            "data-waits=\"3\"",
        ] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        for markup in ["<night>", "<it>", "<being>", "<psd>", "<foam>", "& desk"] {
            assert!(!page.contains(markup), "{markup}: {page}");
        }
    }

    #[test]
    fn what_one_capture_lacks_is_left_out_and_two_are_chosen_from_a_list() {
        let (rows, empty) = ([row(7, "<night>"), row(8, "foam")], Documents::default());
        let figures = BTreeMap::new();
        let sides = [0, 1].map(|side| Side { row: &rows[side], documents: &empty, figures: &figures });
        let page = comparison(&ComparisonView { sides, both: &[], remarks: &[], waits: false });
        assert!(page.contains("<h2>Samples</h2>") && page.matches("<h2>").count() == 1, "{page}");
        assert!(!page.contains("data-waits"), "{page}");
        let chosen = choice(&rows);
        assert!(chosen.contains("<select name=\"b\"><option value=\"7\">&lt;night&gt;</option>"), "{chosen}");
        assert!(choice(&rows[..1]).contains("There are no two captures"));
    }
}
