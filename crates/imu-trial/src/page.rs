//! Pages: a trial's score as one HTML file without scripts or external resources.

use super::detection::Limit;
use super::interval::Rate;
use super::limit::STUDY;
use super::of_kind::{Bin, Spread};
use super::score::{Miss, Score};
use super::suite::Suite;
use imu_model::EffectKind;
use std::fmt::Write as _;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;color:#222}\
table{border-collapse:collapse;margin:.5rem 0 1.5rem;font-variant-numeric:tabular-nums}\
th,td{border-bottom:1px solid #ddd;padding:.2rem .7rem;text-align:right;white-space:nowrap}\
th:first-child,td:first-child{text-align:left}th{border-bottom:2px solid #888}\
td.right{background:#e6f4e6}td.wrong{background:#fbe9e7}code{font-size:90%}.wide{overflow-x:auto}";

/// Returns the page.
pub fn page(score: &Score) -> String {
    let mut out = String::new();
    // Writing to a string never fails.
    let _ = write!(
        out,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Trial of the diagnosis</title><style>{STYLE}</style>\
         <h1>Trial of the diagnosis</h1><p>{} cases, seed {}, {}. Manifest, written before any diagnosis: SHA-256 \
         <code>{}</code>.</p>",
        score.cases,
        score.seed,
        escaped(&score.software),
        escaped(&score.manifest_sha256)
    );
    if let Some(suite) = score.suite.and_then(Suite::named) {
        out += "<h2>A frozen set</h2>";
        let _ = write!(out, "<p>{}</p>", escaped(&suite.described(&score.manifest_sha256)));
    }
    if let Some(on) = &score.on {
        let _ = write!(
            out,
            "<p>Imposed on {} in {} stretches. {} causes are its own and set aside; {} cases are called unknown as they are, \
             and verdicts on these do not count.</p>",
            escaped(&on.recording),
            on.stretches,
            on.own_causes,
            count(on.own_unknown)
        );
    }
    out += "<h2>In short</h2><p>Effects of 1.5 times the study's 90&nbsp;% limit or above; intervals are Clopper and Pearson's, \
            95&nbsp;%.</p>";
    let rows = score.rates.stated().map(|one| vec![escaped(one.meaning), count(one.rate), percent(one.rate)]);
    table(&mut out, &["", "count", "share"], rows);
    if let Some(places) = score.false_places {
        let _ = write!(out, "<p>False places per record: {places:.2}.</p>");
    }
    kinds(&mut out, score);
    curves(&mut out, score);
    confusion(&mut out, score);
    out += "<h2>Stated confidence</h2>";
    table(&mut out, &["confidence", "mean", "causes", "right"], score.reliability.iter().map(bin));
    let of = &score.calibration;
    let _ = write!(
        out,
        "<p>All: {} right, stated {} on average, expected calibration error {}.</p>",
        percent(of.right),
        number(of.mean_confidence),
        number(of.expected_error)
    );
    out += "<h2>Cases that went wrong</h2>";
    table(&mut out, &["case", "class", "has", "size/limit", "verdict", "named"], score.misses.iter().map(miss));
    out + "</html>\n"
}

fn kinds(out: &mut String, score: &Score) {
    *out += "<h2>By effect, alone in its case</h2>";
    let rows = score.kinds.iter().map(|of| {
        let spread = |map: &[(String, Spread)]| {
            let line = |(name, spread): &(String, Spread)| {
                format!("{} {:.3} ({:.3})", escaped(name), spread.median, spread.p90)
            };
            map.iter().map(line).collect::<Vec<_>>().join("<br>")
        };
        let location: Vec<_> = of.location.iter().map(|(name, spread)| ((*name).to_owned(), *spread)).collect();
        let parameters: Vec<_> = of.parameters.iter().map(|(name, spread)| (name.clone(), *spread)).collect();
        let first = if of.library { percent(of.right_first) } else { "–".to_owned() };
        vec![
            of.kind.name().to_owned(),
            of.unknown.of.to_string(),
            first,
            of.equivalent.to_string(),
            percent(of.unknown),
            percent(of.spurious),
            percent(of.channels_exact),
            number(of.closed),
            number(of.closed_of_truth),
            spread(&location),
            spread(&parameters),
        ]
    });
    let head = [
        "effect",
        "cases",
        "named first",
        "equivalent",
        "unknown",
        "spurious",
        "channels exact",
        "closed",
        "of the truth's",
        "place: median (90 %)",
        "parameters: relative, median (90 %)",
    ];
    table(out, &head, rows);
}

fn curves(out: &mut String, score: &Score) {
    *out += "<h2>Detection by size over the limit</h2>";
    let library = || score.kinds.iter().filter(|of| of.library);
    let edges: Vec<String> = library().next().map(|of| of.curve.iter().map(Bin::label).collect()).unwrap_or_default();
    let mut head = vec!["effect"];
    head.extend(edges.iter().map(String::as_str));
    let rows = library().map(|of| {
        let mut row = vec![of.kind.name().to_owned()];
        row.extend(of.curve.iter().map(|bin| format!("{}<br>{}", count(bin.right), percent(bin.right))));
        row
    });
    table(out, &head, rows);
    let _ = write!(
        out,
        "<h2>Detection limits</h2><p>Sizes at {STUDY} samples, σ the white part's standard deviation per sample, with intervals \
         by profile likelihood where they are determined. The bound: what nobody who knows the effect's form, place and noise \
         can be below at the same rate of false alarms.</p>"
    );
    let rows = library().filter_map(|of| Some((of.kind, of.detection.as_ref()?))).map(|(kind, of)| {
        let bound = of.bound_90.map_or_else(|| of.no_bound.unwrap_or_default().to_owned(), size);
        vec![
            kind.name().to_owned(),
            of.unit.to_owned(),
            limit(of.size_50),
            limit(of.size_90),
            escaped(&bound),
            size(of.limit),
        ]
    });
    table(out, &["effect", "size", "50 %", "90 %", "bound of 90 %", "study's 90 %"], rows);
}

fn confusion(out: &mut String, score: &Score) {
    *out += "<h2>First cause named</h2><p>Rows: what the case has. Columns: what was named first, or the verdict where nothing \
             was.</p>";
    let mut named: Vec<&String> = score.confusion.values().flat_map(|row| row.keys()).collect();
    named.sort();
    named.dedup();
    *out += "<div class=\"wide\"><table><tr><th></th>";
    for name in &named {
        let _ = write!(out, "<th>{}</th>", escaped(name));
    }
    *out += "</tr>";
    for (truth, row) in &score.confusion {
        let effect = truth
            .split(" (")
            .next()
            .filter(|_| !truth.ends_with("(known)"))
            .and_then(super::kind::Kind::from_name)
            .and_then(super::kind::Kind::effect);
        let _ = write!(out, "<tr><td>{}</td>", escaped(truth));
        for name in &named {
            let right = match effect {
                Some(effect) => EffectKind::from_name(name) == Some(effect),
                None if truth == "none" || truth.ends_with("(known)") => {
                    ["no_gap", "parameters"].contains(&name.as_str())
                }
                None => name.as_str() == "unknown_effect",
            };
            match row.get(*name) {
                Some(count) => {
                    let _ = write!(out, "<td class=\"{}\">{count}</td>", if right { "right" } else { "wrong" });
                }
                None => *out += "<td></td>",
            }
        }
        *out += "</tr>";
    }
    *out += "</table></div>";
}

fn bin(bin: &Bin) -> Vec<String> {
    vec![bin.label(), number(bin.mean), bin.right.of.to_string(), percent(bin.right)]
}

fn miss(miss: &Miss) -> Vec<String> {
    let kinds: Vec<&str> = miss.kinds.iter().map(|kind| kind.name()).collect();
    let named = |cause: &super::judge::Named| {
        let mark = if cause.right { "" } else { " (wrong)" };
        format!("{}{mark} on {}", escaped(&cause.effect), escaped(&cause.channels.join(", ")))
    };
    let named: Vec<String> = miss.named.iter().map(named).collect();
    let detail = miss.refusal.as_ref().map_or_else(|| named.join("; "), |refusal| escaped(refusal));
    vec![
        miss.case.to_string(),
        miss.class.name().to_owned(),
        if kinds.is_empty() { "none".to_owned() } else { kinds.join(", ") },
        number(miss.over_limit),
        escaped(&miss.verdict),
        detail,
    ]
}

fn table(out: &mut String, head: &[&str], rows: impl Iterator<Item = Vec<String>>) {
    *out += "<div class=\"wide\"><table><tr>";
    for cell in head {
        let _ = write!(out, "<th>{cell}</th>");
    }
    *out += "</tr>";
    for row in rows {
        let _ = write!(out, "<tr><td>{}</td></tr>", row.join("</td><td>"));
    }
    *out += "</table></div>";
}

/// Writes a count and its total.
fn count(rate: Rate) -> String {
    if rate.of == 0 { "–".to_owned() } else { format!("{}/{}", rate.count, rate.of) }
}

/// Returns a share with its interval, in percent.
pub fn percent(rate: Rate) -> String {
    match (rate.share, rate.ci95) {
        (Some(share), Some([low, high])) => {
            format!("{:.1} % ({:.1}–{:.1})", 100.0 * share, 100.0 * low, 100.0 * high)
        }
        _ => "–".to_owned(),
    }
}

/// Returns a size with its interval, for display.
pub fn limit(of: Option<Limit>) -> String {
    match of {
        Some(Limit { size: at, ci95: Some([low, high]) }) => format!("{} ({}–{})", size(at), size(low), size(high)),
        Some(of) => size(of.size),
        None => "–".to_owned(),
    }
}

/// Writes a size with three digits.
pub fn size(value: f64) -> String {
    if (1e-3..1e4).contains(&value) {
        let digits = (2 - value.log10().floor() as i32).max(0) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.2e}")
    }
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.3}"))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;
    use crate::judge::{Answer, judge};
    use crate::kind::Kind;

    #[test]
    fn a_page_has_every_part_and_nothing_from_elsewhere() {
        let refused = Answer { report: Err("<b>no</b>".to_owned()), own: None, closed_by_truth: None, again: None };
        let judged: Vec<_> = [&[Kind::Tone][..], &[], &[Kind::Echo]]
            .into_iter()
            .enumerate()
            .map(|(case, kinds)| judge(&Case::draw(1, case, kinds).unwrap().key(), &refused))
            .collect();
        let page = page(&Score::of("vn100d <test>", 7, "ab12", &judged, &[]).of_suite(Some("2026")));
        for part in [
            "In short",
            "A frozen set",
            "By effect",
            "Detection",
            "First cause named",
            "Stated confidence",
            "went wrong",
            "ab12",
        ] {
            assert!(page.contains(part), "{part}");
        }
        assert!(!page.contains("<b>no</b>") && !page.contains("<script") && !page.contains("http"));
        assert_eq!(page.matches("<table>").count(), page.matches("</table>").count());
    }
}
