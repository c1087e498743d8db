//! The validation sheet of a sensor model: one page, in the manner of ASME V&V 20 and NASA-STD-7009A.

use super::{Kind, escaped, framed, wide};
use crate::plot;
use imu_core::sample::Channel;
use imu_cost::{
    Comparison, Envelope, LimitState, LimitVerdict, ModelError, Quantity, Sheet, SheetVerdict, number, time,
};
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// Returns the page, with the version of the program that made it.
pub fn validation(sheet: &Sheet, software: &str) -> String {
    let title = format!("Validation of {}", sheet.model);
    framed(&title, Kind::File, &body(sheet, software))
}

fn body(sheet: &Sheet, software: &str) -> String {
    let mut out = String::new();
    let (class, verdict) = match sheet.verdict {
        SheetVerdict::Validated => ("no_gap", "validated inside the envelope"),
        SheetVerdict::NotValid => ("effects", "not valid"),
        SheetVerdict::Undecided => ("unknown_effect", "undecided"),
    };
    // Writing to a text cannot fail.
    let _ = write!(
        out,
        "<p class=\"soft\">Validation sheet</p><h1>{}</h1><p><span class=\"verdict {class}\">{verdict}</span></p><p>{}.</p>",
        escaped(&sheet.model),
        escaped(&capitalised(&sheet.reason))
    );
    limits(&mut out, &sheet.limits);
    errors(&mut out, sheet);
    pictures(&mut out, sheet);
    envelope(&mut out, &sheet.envelope);
    list(&mut out, "Where the model has not been validated", &sheet.not_validated);
    credibility(&mut out, sheet);
    list(&mut out, "To know", &sheet.notes);
    let _ = write!(out, "<footer>{}</footer>", escaped(software));
    out
}

fn capitalised(text: &str) -> String {
    // A name with an underscore stays as it is.
    if text.split_whitespace().next().is_some_and(|word| word.contains('_')) {
        return text.to_owned();
    }
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn list(out: &mut String, title: &str, sentences: &[String]) {
    if !sentences.is_empty() {
        let items: String = sentences.iter().map(|of| format!("<li>{}.</li>", escaped(&capitalised(of)))).collect();
        let _ = write!(out, "<h2>{title}</h2><ul>{items}</ul>");
    }
}

fn name(quantity: Quantity) -> String {
    quantity.to_string().replace('_', " ")
}

/// The unit of a row, in which D is at least 1 where a prefix allows it.
struct Shown {
    factor: f64,
    unit: String,
}

impl Shown {
    /// Chooses the unit for a size of the quantity.
    fn of(quantity: Quantity, size: f64) -> Self {
        let (own, unit) = quantity.shown_in();
        let prefixes = [(1e-3, "k"), (1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n")];
        let fits = |(factor, prefix): &&(f64, &str)| own * size * factor >= 1.0 && (*prefix != "k" || unit == "m");
        let (factor, prefix) = prefixes.iter().find(fits).unwrap_or(&(1e9, "n"));
        let prefix = if size > 0.0 { prefix } else { "" };
        let factor = if size > 0.0 { *factor } else { 1.0 };
        Self { factor: own * factor, unit: format!("{prefix}{unit}") }
    }

    /// Returns a number with two significant digits of its uncertainty.
    fn number(&self, value: f64, u_val: f64) -> String {
        let (value, u_val) = (self.factor * value, self.factor * u_val);
        let decimals = if u_val > 0.0 { (1.0 - u_val.log10().floor()).clamp(0.0, 9.0) } else { 3.0 };
        format!("{value:.*}", decimals as usize).replace('-', "−")
    }

    /// Returns `E ± u`.
    fn error(&self, of: &ModelError) -> String {
        format!("{} ± {}", self.number(of.error, of.u_val), self.number(of.u_val, of.u_val))
    }

    /// Returns `E ± u (low to high)`.
    fn with_interval(&self, of: &ModelError) -> String {
        let [low, high] = of.ci95.map(|end| self.number(end, of.u_val));
        format!("{} <span class=\"interval\">({low} to {high})</span>", self.error(of))
    }
}

fn limits(out: &mut String, limits: &[LimitVerdict]) {
    if limits.is_empty() {
        return;
    }
    let _ = write!(
        out,
        "<h2>Limits on the error</h2>{}<table><tr><th scope=\"col\">limit on |E|</th><th scope=\"col\">E ± u<sub>val</sub> \
         (95&nbsp;% interval)</th><th scope=\"col\">verdict</th></tr>",
        wide("limits")
    );
    for of in limits {
        let verdict = match of.state {
            LimitState::Met => "met",
            LimitState::Missed => "missed",
            LimitState::Undecided => "undecided",
        };
        let shown = Shown::of(of.quantity, of.limit);
        let error = of
            .error
            .as_ref()
            .map_or_else(|| "too few pieces".to_owned(), |own| format!("{} {}", shown.with_interval(own), shown.unit));
        let limit = of.quantity.with_unit(of.limit);
        let (name, after) = (name(of.quantity), time(of.horizon_s));
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{name} after {after}: {limit}</th><td>{error}</td><td>{verdict}</td></tr>"
        );
    }
    *out += "</table></div>";
}

fn errors(out: &mut String, sheet: &Sheet) {
    let _ = write!(
        out,
        "<h2>Error of the model</h2><p class=\"soft\">Unaided strapdown integration at rest, after {} of alignment. D: root mean \
         square of the errors in pieces of the recordings. S: the one that the model predicts for these pieces. E = S − D, with its \
         standard uncertainty u<sub>val</sub> of data and model parameters. If 0 is inside the 95&nbsp;% interval, the model's error is \
         too small to be seen in these data. Bias: E of the mean. Scatter: E of the standard deviation. Theil: bias² as a part of \
         bias² + scatter². In the band: pieces whose error is \
         inside the model's 95&nbsp;% band. Pieces overlap; in brackets how many are independent. One interval in twenty misses 0 by \
         chance.</p>",
        time(sheet.align_s)
    );
    for (quantity, all) in sheet.quantities.iter().filter(|(_, all)| all.iter().any(Option::is_some)) {
        let name = name(*quantity);
        *out += &wide(&name);
        let _ = write!(
            out,
            "<table><tr><th scope=\"col\">{name} after</th><th scope=\"col\">in</th><th scope=\"col\" class=\"number\">D</th>\
             <th scope=\"col\" class=\"number\">S</th><th scope=\"col\" class=\"number\">E ± u<sub>val</sub> (95&nbsp;% interval)</th>\
             <th scope=\"col\" class=\"number\">bias</th><th scope=\"col\" class=\"number\">scatter</th>\
             <th scope=\"col\" class=\"number\">Theil</th><th scope=\"col\" class=\"number\">in the band</th>\
             <th scope=\"col\" class=\"number\">pieces</th></tr>"
        );
        for (horizon_s, of) in sheet.horizons_s.iter().zip(all) {
            row(out, *quantity, *horizon_s, of.as_ref());
        }
        *out += "</table></div>";
    }
}

fn row(out: &mut String, quantity: Quantity, horizon_s: f64, of: Option<&Comparison>) {
    let horizon = time(horizon_s);
    let Some(of) = of else {
        let _ = write!(out, "<tr><th scope=\"row\">{horizon}</th><td colspan=\"9\">too few pieces</td></tr>");
        return;
    };
    let class = if of.rms.agrees() { "number" } else { "number bad" };
    // Of two errors that chance may have made there is no proportion.
    let theil = of.bias_proportion.filter(|_| !(of.bias.agrees() && of.scatter.agrees()));
    let theil = theil.map_or_else(|| "–".to_owned(), |share| format!("{:.0} %", 100.0 * share));
    let [low, high] = of.coverage_ci95.map(|share| 100.0 * share);
    let shown = Shown::of(quantity, of.rms.measured);
    let cells = [
        ("number", shown.number(of.rms.measured, of.rms.u_val)),
        ("number", shown.number(of.rms.predicted, of.rms.u_val)),
        (class, shown.with_interval(&of.rms)),
        ("number", shown.error(&of.bias)),
        ("number", shown.error(&of.scatter)),
        ("number", theil),
        ("number", format!("{:.0} % <span class=\"interval\">({low:.0} to {high:.0})</span>", 100.0 * of.coverage)),
        ("number", format!("{} <span class=\"interval\">({:.0})</span>", of.pieces, of.independent)),
    ];
    let cells = cells.map(|(class, cell)| format!("<td class=\"{class}\">{cell}</td>")).concat();
    let _ = write!(out, "<tr><th scope=\"row\">{horizon}</th><td>{}</td>{cells}</tr>", shown.unit);
}

fn pictures(out: &mut String, sheet: &Sheet) {
    let mut figures = String::new();
    for (quantity, all) in &sheet.quantities {
        let (factor, unit) = quantity.shown_in();
        let of = |value: &dyn Fn(&Comparison) -> f64| -> Vec<f64> {
            all.iter().map(|own| own.as_ref().map_or(f64::NAN, |own| factor * value(own))).collect()
        };
        // The interval of E is that of D about S.
        let end = |of: &Comparison, end: usize| of.rms.predicted - of.rms.ci95[end];
        let ends = of(&|own| end(own, 1)).into_iter().zip(of(&|own| end(own, 0)));
        let measured = of(&|own| own.rms.measured).into_iter().zip(ends).map(|(value, (low, high))| [value, low, high]);
        let svg = plot::growth(&plot::Growth {
            title: &name(*quantity),
            unit,
            horizons_s: sheet.horizons_s.clone(),
            measured: measured.collect(),
            predicted: vec![("after", of(&|own| own.rms.predicted))],
        });
        if !svg.is_empty() {
            let _ = write!(figures, "<figure>{svg}</figure>");
        }
    }
    if !figures.is_empty() {
        let _ = write!(
            out,
            "<p class=\"soft\"><span class=\"key real\"></span>D, with the 95&nbsp;% interval of E<span class=\"key after\"></span>S</p>\
             <div class=\"figures\">{figures}</div>"
        );
    }
}

fn recordings(count: usize) -> String {
    format!("{count} {}", if count == 1 { "recording" } else { "recordings" })
}

fn envelope(out: &mut String, of: &Envelope) {
    let list = |of: &BTreeSet<String>| match of.is_empty() {
        true => "not stated".to_owned(),
        false => of.iter().cloned().collect::<Vec<_>>().join(", "),
    };
    let degrees = |of: Option<[f64; 2]>| {
        of.map_or_else(|| "not recorded".to_owned(), |[low, high]| format!("{low:.1} to {high:.1} °C"))
    };
    let sizes = |is_of: &dyn Fn(&Channel) -> bool| -> String {
        let own = of.largest.iter().filter(|(channel, _)| is_of(channel));
        own.map(|(channel, most)| format!("{channel} {} {}", number(*most), channel.unit()))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let is_gyro = |channel: &Channel| channel.name().starts_with("gyro");
    let [from, to] = of.since_switch_on_s;
    let rows = [
        (
            "time of data",
            format!("{} in {}, {} Hz", time(of.total_s), recordings(of.recordings.len()), number(of.rate_hz)),
        ),
        ("time since switch-on", format!("{} to {}", time(from), time(to))),
        ("temperature", degrees(of.temperature_c)),
        ("largest angular rates", sizes(&is_gyro)),
        ("largest specific forces", sizes(&|channel| !is_gyro(channel))),
        ("units", list(&of.units)),
        ("dates", list(&of.dates)),
    ];
    let _ = write!(out, "<h2>What the data cover</h2>{}<table>", wide("envelope"));
    for (name, value) in rows.iter().filter(|(_, value)| !value.is_empty()) {
        let _ = write!(out, "<tr><th scope=\"row\">{name}</th><td>{}</td></tr>", escaped(value));
    }
    let _ = write!(
        out,
        "</table></div>{}<table><tr><th scope=\"col\">recording</th><th scope=\"col\">length</th><th scope=\"col\">unit</th>\
         <th scope=\"col\">date</th><th scope=\"col\">temperature</th><th scope=\"col\">mean specific force</th></tr>",
        wide("recordings")
    );
    for of in &of.recordings {
        let pose: Vec<String> =
            of.specific_force_m_s2.iter().map(|(channel, value)| format!("{channel} {}", number(*value))).collect();
        let pose = if pose.is_empty() { "–".to_owned() } else { format!("{} m/s²", pose.join(", ")) };
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{pose}</td></tr>",
            escaped(&of.name),
            time(of.length_s),
            escaped(of.unit.as_deref().unwrap_or("–")),
            escaped(of.date.as_deref().unwrap_or("–")),
            degrees(of.temperature_c)
        );
    }
    *out += "</table></div>";
}

/// Writes the credibility factors of NASA-STD-7009A and what this sheet shows of each. A level is the reader's to set.
fn credibility(out: &mut String, sheet: &Sheet) {
    let (units, dates) = (sheet.envelope.units.len(), sheet.envelope.dates.len());
    let validation = format!(
        "{} at rest, {}; units stated: {units}; dates stated: {dates}",
        recordings(sheet.envelope.recordings.len()),
        time(sheet.envelope.total_s)
    );
    let rows = [
        ("Data pedigree", "the table of recordings above; where they lie and how they were made is not checked"),
        ("Verification", "closed forms against runs of the simulator and against numpy: docs/cost.md of the program"),
        ("Validation", &validation),
        ("Input pedigree", "the model's file, and its `provenance` if it has one"),
        ("Uncertainty characterization", "u_val of the data and of the intervals that the model states"),
        ("Results robustness", "not shown: how much the result moves if an assumption is dropped"),
        ("Use history, management", "not shown"),
    ];
    let _ = write!(
        out,
        "<h2>Credibility</h2><p class=\"soft\">The factors of NASA-STD-7009A, and what this sheet shows of each. It sets no level.</p>\
         {}<table>",
        wide("credibility")
    );
    for (factor, shown) in rows {
        let _ = write!(out, "<tr><th scope=\"row\">{factor}</th><td>{}</td></tr>", escaped(shown));
    }
    *out += "</table></div>";
}
