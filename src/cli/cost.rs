//! `vn100d cost`: what a sensor model's errors cost in degrees, m/s and m.

use super::args::CostArgs;
use super::{Context, Outcome, failed, model, print_json, simulate, table, usage};
use imu_core::units::{RAD_PER_DEG, format_duration};
use imu_cost::{Cause, Cost, CostError, Method, Quantity, Request, cost};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// Causes with a smaller share of every horizon's mean square error are not shown.
const SHOWN_FROM: f64 = 0.05;

/// Both costs of a comparison: the model's own document, and beside it the other one.
#[derive(Debug, serde::Serialize)]
struct Compared<'a> {
    #[serde(flatten)]
    own: &'a Cost,
    against: &'a Cost,
    ratio: BTreeMap<Quantity, Vec<Option<f64>>>,
}

/// Prints the cost.
pub(super) fn run(context: &Context, args: &CostArgs) -> anyhow::Result<Outcome> {
    let request = Request {
        align_s: args.align.as_secs_f64(),
        horizons_s: args.horizons.iter().map(Duration::as_secs_f64).collect(),
        temperature: args.temperature.as_deref().map(simulate::temperature).transpose()?,
        tolerances: args.tolerance.iter().flat_map(|of| of.0.clone()).collect(),
        ..Request::default()
    };
    let own = cost_of(&args.model, &request)?;
    // Limits are those of the model itself.
    let plain = Request { tolerances: Vec::new(), ..request };
    let against = args.against.as_deref().map(|path| cost_of(path, &plain)).transpose()?;
    let mut stdout = std::io::stdout().lock();
    match (&against, context.json) {
        (None, true) => print_json(&own)?,
        (Some(against), true) => print_json(&Compared { own: &own, against, ratio: ratios(&own, against) })?,
        (None, false) => write_cost(&mut stdout, &own)?,
        (Some(against), false) => {
            write_cost(&mut stdout, &own)?;
            writeln!(stdout)?;
            write_cost(&mut stdout, against)?;
            write_ratios(&mut stdout, &own, against)?;
        }
    }
    let missed = args.check && own.tolerances.iter().any(|verdict| !verdict.pass);
    Ok(if missed { Outcome::LimitMissed } else { Outcome::Done })
}

fn cost_of(path: &Path, request: &Request) -> anyhow::Result<Cost> {
    let sensor = model::load(path)?;
    cost(&sensor, &path.display().to_string(), request).map_err(|error| match error {
        CostError::Model(_) | CostError::NoChannel { .. } => failed(format!("{}: {error}", path.display())),
        _ => usage(error.to_string()),
    })
}

/// Returns the model's band over the other's, by quantity and horizon; none if the other has no error.
fn ratios(own: &Cost, against: &Cost) -> BTreeMap<Quantity, Vec<Option<f64>>> {
    let both =
        own.quantities.iter().filter_map(|(quantity, of)| Some((*quantity, of, against.quantities.get(quantity)?)));
    both.map(|(quantity, of, other)| {
        let pairs = of.band95.iter().zip(&other.band95);
        (quantity, pairs.map(|(own, other)| (*other > 0.0).then(|| own / other)).collect())
    })
    .collect()
}

/// Returns the factor from a quantity's unit to the shown one, and the shown one.
fn shown_in(quantity: Quantity) -> (f64, &'static str) {
    match quantity.unit() {
        "rad" => (1.0 / RAD_PER_DEG, "°"),
        unit => (1.0, unit),
    }
}

/// Returns a number with three significant digits.
fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        size if (1e-3..1e5).contains(&size) => {
            let digits = (2.0 - size.log10().floor()).max(0.0) as usize;
            format!("{value:.digits$}")
        }
        _ => format!("{value:.2e}"),
    }
}

fn with_unit(quantity: Quantity, value: f64) -> String {
    let (factor, unit) = shown_in(quantity);
    match unit {
        "°" => format!("{}°", number(factor * value)),
        "m" if value >= 1e4 => format!("{} km", number(1e-3 * value)),
        _ => format!("{} {unit}", number(value)),
    }
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

fn time(time_s: f64) -> String {
    format_duration(Duration::from_secs_f64(time_s))
}

fn causes_of(cost: &Cost, quantity: Quantity) -> impl Iterator<Item = &Cause> {
    cost.causes.iter().filter(move |cause| cause.quantity == quantity)
}

/// Returns the largest angle and the largest position, else velocity, at the last horizon, each with its main cause.
fn headline(cost: &Cost) -> String {
    let last = |quantity: &Quantity| cost.quantities[quantity].band95.last().copied().unwrap_or_default();
    let largest = |unit: &str| {
        let own = cost.quantities.keys().copied().filter(|quantity| quantity.unit() == unit);
        own.max_by(|one, other| last(one).total_cmp(&last(other)))
    };
    let part = |quantity: Quantity| {
        let size = with_unit(quantity, last(&quantity));
        let main = causes_of(cost, quantity).next().and_then(|cause| Some((cause, *cause.share.last()?)));
        let main = main.filter(|(_, share)| *share > 0.0);
        let words = main.map(|(cause, share)| format!(" ({} on {}, {})", cause.cause, cause.channel, percent(share)));
        format!("{size} of {quantity}{}", words.unwrap_or_default())
    };
    let parts: Vec<String> = [largest("rad"), largest("m")].into_iter().flatten().map(part).collect();
    let horizon = cost.horizons_s.last().copied().unwrap_or_default();
    format!("{} costs up to {} after {}", cost.model, parts.join(" and "), time(horizon))
}

fn write_cost(to: &mut impl Write, cost: &Cost) -> std::io::Result<()> {
    writeln!(to, "{}.", headline(cost))?;
    writeln!(to, "At rest, {} of alignment; the size of an error stays below the band in 95 %.", time(cost.align_s))?;
    let beyond = |place: usize| cost.extrapolated.as_ref().is_some_and(|of| of.get(place) == Some(&true));
    let horizons = cost.horizons_s.iter().enumerate();
    let horizons: Vec<String> =
        horizons.map(|(place, horizon_s)| time(*horizon_s) + if beyond(place) { "*" } else { "" }).collect();
    let header = |first: &[&'static str]| -> Vec<String> {
        first.iter().map(|name| (*name).to_owned()).chain(horizons.iter().cloned()).collect()
    };
    let rows_of = |names: Vec<String>| table(&names.iter().map(String::as_str).collect::<Vec<_>>());
    let mut rows = rows_of(header(&["error", "unit", ""]));
    for (quantity, growth) in &cost.quantities {
        let (factor, unit) = shown_in(*quantity);
        let lines = [
            ("95 % band", Some(&growth.band95)),
            ("K at its limit", growth.band95_upper.as_ref()),
            ("sd", Some(&growth.sd)),
            ("mean", Some(&growth.mean).filter(|mean| mean.iter().any(|value| *value != 0.0))),
        ];
        let lines = lines.into_iter().filter_map(|(name, values)| Some((name, values?)));
        for (place, (name, values)) in lines.enumerate() {
            let first = if place == 0 { [quantity.to_string(), unit.to_owned()] } else { Default::default() };
            let values = values.iter().map(|value| number(factor * value));
            rows.add_row(first.into_iter().chain([name.to_owned()]).chain(values));
        }
    }
    writeln!(to, "{rows}")?;
    let mut rows = rows_of(header(&["share of the mean square", "by"]));
    for quantity in cost.quantities.keys() {
        let causes = causes_of(cost, *quantity).filter(|cause| cause.share.iter().any(|of| of.abs() >= SHOWN_FROM));
        for (place, cause) in causes.enumerate() {
            let name = if place == 0 { quantity.to_string() } else { String::new() };
            let by = format!("{} on {}", cause.cause, cause.channel);
            rows.add_row([name, by].into_iter().chain(cause.share.iter().map(|share| percent(*share))));
        }
    }
    if !rows.is_empty() {
        writeln!(to, "{rows}")?;
    }
    write_remarks(to, cost)
}

/// Writes extrapolations, simulations, missing channels and verdicts.
fn write_remarks(to: &mut impl Write, cost: &Cost) -> std::io::Result<()> {
    if cost.extrapolated.iter().flatten().any(|beyond| *beyond) {
        writeln!(to, "* extrapolation: the record that the model was fitted to is shorter")?;
    }
    for (quantity, growth) in &cost.quantities {
        if growth.method == Method::MonteCarlo {
            let runs = growth.runs.unwrap_or_default();
            writeln!(to, "{quantity}: Monte Carlo, {runs} runs, because of {}", growth.simulated.join(", "))?;
        }
    }
    for note in &cost.notes {
        writeln!(to, "note: {note}")?;
    }
    for verdict in &cost.tolerances {
        let [value, limit] = [verdict.value, verdict.limit].map(|value| with_unit(verdict.quantity, value));
        let deciding = if verdict.deciding.is_empty() { "nothing" } else { &verdict.deciding };
        writeln!(
            to,
            "{}: {} after {} is {value}, {} of the limit {limit}; {deciding} decides",
            if verdict.pass { "pass" } else { "FAIL" },
            verdict.quantity,
            time(verdict.horizon_s),
            percent(verdict.ratio),
        )?;
    }
    Ok(())
}

/// Writes how much larger the model's bands are than the other's.
fn write_ratios(to: &mut impl Write, own: &Cost, against: &Cost) -> std::io::Result<()> {
    writeln!(to, "\n95 % bands of {} over those of {}:", own.model, against.model)?;
    let times = own.horizons_s.iter().map(|horizon_s| time(*horizon_s));
    let header: Vec<String> = std::iter::once("ratio".to_owned()).chain(times).collect();
    let mut rows = table(&header.iter().map(String::as_str).collect::<Vec<_>>());
    for (quantity, ratios) in ratios(own, against) {
        let ratios = ratios.iter().map(|ratio| ratio.map_or_else(|| "–".to_owned(), number));
        rows.add_row(std::iter::once(quantity.to_string()).chain(ratios));
    }
    writeln!(to, "{rows}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_significant_digits() {
        let shown = [0.0, 1.0, 0.123_45, 12_345.0, -99.9, 1.234e-5, 2.5e7].map(number);
        assert_eq!(shown, ["0", "1.00", "0.123", "12345", "-99.9", "1.23e-5", "2.50e7"]);
    }
}
