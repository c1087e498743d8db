//! The text of a diagnosis: what `vn100d diagnose` prints for people.

use super::figures::{counted, rounded, with_interval};
use super::table;
use crate::page::{self, SURE, advice, part};
use imu_core::units::format_duration;
use imu_cost::Quantity;
use imu_diagnosis::Diagnosis;
use imu_diagnosis::report::{Cause, Driver, GapCost, Hint, Of, Offset, Parameter, Place, Sense};
use serde::Deserialize as _;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write;
use std::time::Duration;

/// The maximum number of entries of a list inside a parameter, without `--verbose`.
const ENTRIES: usize = 8;
/// The least share of a place that is listed without `--verbose`.
const SHARE: f64 = 0.01;

/// How a diagnosis is printed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Style<'a> {
    /// Whether everything is listed.
    pub(super) verbose: bool,
    /// Where the corrected model is, such as `better.json has it`.
    pub(super) corrected: &'a str,
}

/// Prints a diagnosis. It ends with what to do.
pub(super) fn print(out: &mut dyn Write, of: &Diagnosis, style: Style) -> std::io::Result<()> {
    writeln!(out, "{}", of.summary)?;
    write_gap(out, of)?;
    write_causes(out, of, style)?;
    if let Some(cost) = &of.discrepancy.cost {
        write_cost(out, cost)?;
    }
    if let Some(left) = &of.remainder {
        let on = left.channels.join(", ");
        writeln!(out, "\nwithout a name: {:.2} % of the gap, on {on}", 100.0 * left.share)?;
        left.what.iter().try_for_each(|what| writeln!(out, "  {what}"))?;
    }
    write_places(out, of, style)?;
    write_parameters(out, of)?;
    for Hint { about, text, .. } in &of.hints {
        writeln!(out, "{about}: {text}")?;
    }
    for cause in &of.causes {
        for sentence in cause.evidence.iter().take(if style.verbose { usize::MAX } else { 3 }) {
            writeln!(out, "{sentence}")?;
        }
    }
    for other in &of.alternatives {
        writeln!(out, "not {} on {}: {}", other.effect, other.channels.join(", "), other.why_not)?;
    }
    for note in &of.notes {
        writeln!(out, "{note}")?;
    }
    writeln!(out, "\nWhat to do:")?;
    advice(of, style.corrected).iter().try_for_each(|sentence| writeln!(out, "- {sentence}"))
}

fn write_gap(out: &mut dyn Write, of: &Diagnosis) -> std::io::Result<()> {
    let gap = &of.discrepancy;
    let [before, parameters, after, floor] =
        [gap.before, gap.after_parameters, gap.after, gap.floor].map(|nats| rounded(nats, 3));
    writeln!(
        out,
        "\ngap in nats a sample: {before} as the model is, {parameters} with its parameters corrected, {after} with what was found"
    )?;
    writeln!(out, "a true model shows {floor}; measured on the {}", gap.measured_on)?;
    if let (Some(closed), Some([low, high])) = (gap.closed, gap.closed_ci95) {
        writeln!(out, "closed: {} ({} to {})", part(closed), part(low).trim_end_matches(" %"), part(high))?;
    }
    Ok(())
}

fn write_causes(out: &mut dyn Write, of: &Diagnosis, style: Style) -> std::io::Result<()> {
    if of.causes.is_empty() {
        return Ok(());
    }
    let mut rows = table(&["effect", "on", "parameters", "sure", "closes"]);
    for cause in &of.causes {
        let closes = page::closes(cause, &of.discrepancy).unwrap_or_else(|| "–".to_owned());
        let sure = format!("{:.0} %", (100.0 * cause.confidence).floor());
        let (who, values) = match cause.sense {
            Sense::Missing => ("the model lacks it", &cause.parameters),
            Sense::Superfluous => ("the sensor lacks it", &cause.model),
            Sense::Size => ("the model has it otherwise", &cause.parameters),
        };
        let mut first = [format!("{}\n{who}", cause.effect), sure, closes];
        for (on, parameters) in parameters(cause, values, style) {
            let [effect, sure, closes] = std::mem::take(&mut first);
            rows.add_row([effect, on, parameters, sure, closes]);
        }
    }
    writeln!(out, "\n{rows}")?;
    writeln!(out, "sure: {SURE}")?;
    writeln!(out, "closes: the part of the gap that adding the effect closes, with its 95 % interval")
}

/// Returns the channels of a cause with the parameters that the sensor or the model has there: one line per channel and
/// per entry.
fn parameters(cause: &Cause, all: &BTreeMap<String, Value>, style: Style) -> Vec<(String, String)> {
    let text = |place: &str| all.get(place).map(|value| entries(value, cause.uncertainty.get(place), style));
    if let Some(triad) = &cause.triad {
        return vec![(cause.channels.join(", "), text(triad).unwrap_or_default())];
    }
    let rows = cause.channels.iter().map(|channel| (channel.clone(), text(channel).unwrap_or_default()));
    let rows: Vec<_> = rows.collect();
    if rows.is_empty() { vec![(String::new(), String::new())] } else { rows }
}

/// Returns one line per entry of a cause on a channel.
fn entries(value: &Value, uncertainty: Option<&Value>, style: Style) -> String {
    let list = |of: &Value| -> Vec<Value> { of.as_array().cloned().unwrap_or_else(|| vec![of.clone()]) };
    let known = uncertainty.map(list).unwrap_or_default();
    let one = |(index, entry): (usize, &Value)| {
        let fields = entry.as_object().into_iter().flatten();
        let fields = fields.map(|(name, value)| {
            let ends = known.get(index).and_then(|of| <[f64; 2]>::deserialize(of.get(name)?).ok());
            format!("{name} {}", field(name, value, ends, style))
        });
        fields.collect::<Vec<_>>().join(", ")
    };
    list(value).iter().enumerate().map(one).collect::<Vec<_>>().join("\n")
}

/// Returns the value of a parameter. A standard deviation is positive: a sign states that channels share noise with
/// opposite signs.
fn field(name: &str, value: &Value, ends: Option<[f64; 2]>, style: Style) -> String {
    let number =
        |value: f64, ends: Option<[f64; 2]>| ends.map_or_else(|| rounded(value, 4), |ends| with_interval(value, ends));
    match value {
        Value::Number(of) => {
            let of = of.as_f64().unwrap_or(f64::NAN);
            match name {
                "sigma" if of < 0.0 => {
                    format!("{}, of opposite sign", number(-of, ends.map(|[low, high]| [-high, -low])))
                }
                _ => number(of, ends),
            }
        }
        Value::Object(inner) => {
            let fields = inner.iter().map(|(name, value)| format!("{name} {}", field(name, value, None, style)));
            format!("({})", fields.collect::<Vec<_>>().join(", "))
        }
        Value::Array(list) if list.len() > ENTRIES && !style.verbose => {
            format!("{} entries (--verbose lists them)", list.len())
        }
        Value::Array(list) => {
            let inner: Vec<String> = list.iter().map(|value| field("", value, None, style)).collect();
            format!("[{}]", inner.join(", "))
        }
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn write_places(out: &mut dyn Write, of: &Diagnosis, style: Style) -> std::io::Result<()> {
    if of.r#where.is_empty() {
        return Ok(());
    }
    let mut rows = table(&["where the gap lies", "channel", "band in Hz", "time in s", "share", "sign"]);
    // The heaviest place is listed in any case.
    let count = of.r#where.iter().take_while(|place| style.verbose || place.share >= SHARE).count().max(1);
    let (listed, left) = of.r#where.split_at(count);
    for Place { of: what, channel, band_hz, from_s, to_s, at, share, sign, .. } in listed {
        let what = match what {
            Of::Cause(index) => of.causes.get(*index).map_or("", |cause| cause.effect.name()),
            Of::Parameters => "a parameter",
            Of::Remainder => "nothing known",
        };
        let band = match at {
            // The effect of a motion lies at a rate or a pose, not in a band.
            Some(at) => driver(at),
            None => format!("{:.3} … {:.3}", band_hz[0], band_hz[1]),
        };
        rows.add_row([
            what.to_owned(),
            channel.clone(),
            band,
            format!("{from_s:.0} … {to_s:.0}"),
            format!("{:.0} %", 100.0 * share),
            sign.to_string(),
        ]);
    }
    writeln!(out, "\n{rows}")?;
    if !left.is_empty() {
        let places = counted(left.len() as u64, "place", "places");
        writeln!(out, "and {places} with less than {:.0} % of the gap each: --verbose lists them", 100.0 * SHARE)?;
    }
    Ok(())
}

fn write_parameters(out: &mut dyn Write, of: &Diagnosis) -> std::io::Result<()> {
    if !of.parameters.is_empty() {
        let mut rows = table(&["parameter off", "", "model", "capture", "ratio"]);
        for Parameter { channel, parameter, model, capture, ratio, ci95, .. } in &of.parameters {
            let ratio = ratio.map_or_else(|| "–".to_owned(), |ratio| rounded(ratio, 3));
            let capture = ci95.map_or_else(|| rounded(*capture, 4), |ends| with_interval(*capture, ends));
            rows.add_row([channel.clone(), parameter.to_string(), rounded(*model, 4), capture, ratio]);
        }
        writeln!(out, "\n{rows}")?;
    }
    if !of.offsets.is_empty() {
        let mut rows = table(&["mean that differs", "model", "capture", "turn-on bias up to"]);
        for Offset { channel, model, capture, explained } in &of.offsets {
            let [model, capture] = [model, capture].map(|mean| format!("{mean:.4}"));
            rows.add_row([channel.clone(), model, capture, format!("{explained:.4}")]);
        }
        writeln!(out, "\n{rows}")?;
    }
    Ok(())
}

/// Writes the 95 % bands of unaided integration under the model, the corrected one, and that without the causes.
fn write_cost(out: &mut dyn Write, cost: &GapCost) -> std::io::Result<()> {
    let time = |time_s: f64| format_duration(Duration::from_secs_f64(time_s));
    let times = cost.horizons_s.iter().map(|horizon_s| time(*horizon_s));
    let header: Vec<String> = ["error in 95 %".to_owned(), String::new()].into_iter().chain(times).collect();
    let mut rows = table(&header.iter().map(String::as_str).collect::<Vec<_>>());
    for (name, bands) in &cost.quantities {
        let Ok(quantity) = name.parse::<Quantity>() else { continue };
        let lines = [("the model", &bands.before), ("corrected", &bands.after), ("without the causes", &bands.floor)];
        for (place, (whose, values)) in lines.into_iter().enumerate() {
            let first = if place == 0 { name.clone() } else { String::new() };
            let values = values.iter().map(|value| quantity.with_unit(*value));
            rows.add_row([first, whose.to_owned()].into_iter().chain(values));
        }
    }
    if !rows.is_empty() {
        writeln!(out, "\nwithout aid, after {} of alignment:\n{rows}", time(cost.align_s))?;
    }
    cost.notes.iter().try_for_each(|note| writeln!(out, "note: {note}"))
}

/// Returns a text such as "z turning at 1.2 … 3.5 rad/s" or "z down".
fn driver(at: &Driver) -> String {
    let Driver { quantity, axis, unit, range: [from, to], pose } = at;
    match pose {
        Some(pose) => pose.clone(),
        None => format!("{quantity} {axis} {from:.2} … {to:.2} {unit}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const STYLE: Style = Style { verbose: false, corrected: "better.json has it" };

    #[test]
    fn parameters_are_whole_have_the_digits_of_their_interval_and_no_negative_deviation() {
        let several =
            json!([{"frequency_hz": 13.377_71, "amplitude": 2.281_234e-3}, {"frequency_hz": 15.81, "amplitude": 1e-3}]);
        let known = json!([{"frequency_hz": [13.377_2, 13.378_2]}]);
        let text = entries(&several, Some(&known), STYLE);
        assert_eq!(
            text,
            "amplitude 2.281e-3, frequency_hz 13.37771 [13.37720, 13.37820]\namplitude 1.000e-3, frequency_hz 15.81"
        );
        let inside = json!({"intervals": [[327.05, 476.975]], "of": {"effect": "tone", "frequency_hz": 13.378}});
        let text = entries(&inside, None, STYLE);
        assert_eq!(text, "intervals [[327.1, 477.0]], of (effect tone, frequency_hz 13.38)");
        let negative = entries(&json!({"sigma": -2.3931e-4}), Some(&json!({"sigma": [-3e-4, -2e-4]})), STYLE);
        assert_eq!(negative, "sigma 2.39e-4 [2.00e-4, 3.00e-4], of opposite sign");
        let long = json!({"profile": (0..9).map(|at| json!([at, 1.0])).collect::<Vec<_>>()});
        assert_eq!(entries(&long, None, STYLE), "profile 9 entries (--verbose lists them)");
        assert!(entries(&long, None, Style { verbose: true, ..STYLE }).ends_with("[8.000, 1.000]]"));
    }
}
