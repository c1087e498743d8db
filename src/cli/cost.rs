//! `vn100d cost`: what a sensor model's errors cost in degrees, m/s and m.

use super::args::CostArgs;
use super::figures::counted;
use super::{Context, Outcome, analysis, failed, model, print_json, simulate, table, usage};
use crate::jobs::{self, Gridded};
use imu_core::units::format_duration;
use imu_cost::{
    Along, Cause, Cost, CostError, LEAST_PIECES, MOTION_ROWS_MAX, MeasureError, Measured, Method, MotionRefusal,
    Quantity, Request, cost, measured, number,
};
use imu_model::motion::CourseError;
use imu_model::simulator::SensorModel;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// Causes with a smaller share of every horizon's mean square error are not shown.
const SHOWN_FROM: f64 = 0.05;

/// A model's cost, and what a recording shows of it.
#[derive(Debug, serde::Serialize)]
struct Shown {
    #[serde(flatten)]
    cost: Cost,
    #[serde(skip_serializing_if = "Option::is_none")]
    measured: Option<Measured>,
}

/// Both costs of a comparison: the model's own document, and beside it the other one.
#[derive(Debug, serde::Serialize)]
struct Compared<'a> {
    #[serde(flatten)]
    own: &'a Shown,
    against: &'a Shown,
    ratio: BTreeMap<Quantity, Vec<Option<f64>>>,
}

/// Prints the cost.
pub(super) fn run(context: &Context, args: &CostArgs) -> anyhow::Result<Outcome> {
    let request = Request {
        begin_s: args.after.as_secs_f64(),
        align_s: args.align.as_secs_f64(),
        horizons_s: args.horizons.iter().map(Duration::as_secs_f64).collect(),
        temperature: args.temperature.as_deref().map(simulate::temperature).transpose()?,
        tolerances: args.tolerance.iter().flat_map(|of| of.0.clone()).collect(),
        ..Request::default()
    };
    let real = args.real.as_deref().map(|named| Real::open(context, named, args.rate)).transpose()?;
    let shown = |path: &Path, request: &Request| {
        let sensor = model::load(path)?;
        let motion = args.motion.as_deref().map(|named| along(named, &sensor, request)).transpose()?;
        let request = &Request { motion, ..request.clone() };
        let cost = cost_of(&sensor, path, request)?;
        let sensor = context.part.of_model(sensor, path)?;
        let measured = real.as_ref().map(|real| real.measured(&sensor, path, request)).transpose()?;
        Ok::<Shown, anyhow::Error>(Shown { cost, measured })
    };
    let own = shown(&args.model, &request)?;
    // Limits are those of the model itself.
    let plain = Request { tolerances: Vec::new(), ..request };
    let against = args.against.as_deref().map(|path| shown(path, &plain)).transpose()?;
    let mut stdout = std::io::stdout().lock();
    let write = |to: &mut dyn Write, of: &Shown| {
        write_cost(to, &of.cost)?;
        of.measured.as_ref().map_or(Ok(()), |measured| write_measured(to, &of.cost.model, measured))
    };
    match (&against, context.json) {
        (None, true) => print_json(&own)?,
        (Some(against), true) => {
            print_json(&Compared { own: &own, against, ratio: ratios(&own.cost, &against.cost) })?;
        }
        (None, false) => write(&mut stdout, &own)?,
        (Some(against), false) => {
            write(&mut stdout, &own)?;
            writeln!(stdout)?;
            write(&mut stdout, against)?;
            write_ratios(&mut stdout, &own.cost, &against.cost)?;
        }
    }
    let missed = args.check && own.cost.tolerances.iter().any(|verdict| !verdict.pass);
    let rejected = real.is_some_and(|real| real.rejected);
    Ok(match (missed, rejected) {
        (true, _) => Outcome::LimitMissed,
        (false, true) => Outcome::WithLoss,
        (false, false) => Outcome::Done,
    })
}

/// Reads a motion up to the last horizon or limit, at the rate of the model.
fn along(named: &str, sensor: &SensorModel, request: &Request) -> anyhow::Result<Along> {
    let limits_s = request.tolerances.iter().map(|limit| limit.horizon_s);
    let longest_s = request.horizons_s.iter().copied().chain(limits_s).fold(0.0, f64::max);
    let read = simulate::motion_rows(named, sensor, longest_s, MOTION_ROWS_MAX + 1);
    let (rate_hz, rows) = read.map_err(|error| match error.downcast_ref() {
        Some(CourseError::TooShort { kind, needed_s, .. }) => {
            usage(format!("the motion `{kind}` needs {needed_s:.0} s or more: expected a last horizon of that length"))
        }
        None => error,
    })?;
    Ok(Along { name: named.to_owned(), rate_hz, rows: rows.into() })
}

/// A recording at rest.
pub(super) struct Real {
    pub name: String,
    pub gridded: Gridded,
    /// Whether frames or lines were rejected on the way in.
    pub rejected: bool,
    /// The capture's id; none for a recording.
    pub id: Option<i64>,
    /// The sensor, if it is known.
    pub unit: Option<String>,
    /// The date, if it is known.
    pub date: Option<String>,
}

impl Real {
    pub(super) fn open(context: &Context, named: &str, rate_hz: Option<f64>) -> anyhow::Result<Self> {
        let together = analysis::open(context, &[named.to_owned()], rate_hz)?;
        let (name, rejected, [unit, date]) = (together.name(), together.rejected(), together.unit_and_date());
        let id = together.id();
        Ok(Self { name, gridded: jobs::resting(&together.source, together.plan)?, rejected, id, unit, date })
    }

    /// Returns a sentence if samples are outside the part that is compared.
    pub(super) fn left_out(&self) -> Option<String> {
        let Gridded { recording, from_s, left_out, .. } = &self.gridded;
        (*left_out > 0).then(|| {
            format!(
                "pieces are of the {:.0} s from {from_s:.0} s on, the longest part without a gap of a minute; {} outside it",
                recording.length_s(),
                counted(*left_out, "sample is", "samples are")
            )
        })
    }

    /// Measures the growth of errors. Without another temperature the recording's own counts.
    fn measured(&self, sensor: &SensorModel, path: &Path, request: &Request) -> anyhow::Result<Measured> {
        let Gridded { recording, from_s, .. } = &self.gridded;
        // The recording begins at switch-on, or `--after` it; the part that is compared begins later.
        let begin_s = request.begin_s + from_s;
        let temperature = request.temperature.clone().or_else(|| jobs::temperatures(recording, begin_s));
        let request = Request { begin_s, temperature, ..request.clone() };
        let mut found =
            measured(&jobs::rest(recording), &self.name, sensor, &request).map_err(|error| match error {
                MeasureError::Cost(error) => refused(path, &error),
                _ => failed(format!("{} and {}: {error}", self.name, path.display())),
            })?;
        found.notes.extend(self.left_out());
        Ok(found)
    }
}

fn cost_of(sensor: &SensorModel, path: &Path, request: &Request) -> anyhow::Result<Cost> {
    cost(sensor, &path.display().to_string(), request).map_err(|error| refused(path, &error))
}

pub(super) fn refused(path: &Path, error: &CostError) -> anyhow::Error {
    match error {
        CostError::Motion(MotionRefusal::Short { .. }) => usage(error.to_string()),
        CostError::Model(_) | CostError::Motion(_) | CostError::NoChannel { .. } | CostError::NoClosedForm { .. } => {
            failed(format!("{}: {error}", path.display()))
        }
        _ => usage(error.to_string()),
    }
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
        let size = quantity.with_unit(last(&quantity));
        let main = causes_of(cost, quantity).next().and_then(|cause| Some((cause, *cause.share.last()?)));
        let main = main.filter(|(_, share)| *share > 0.0);
        let words = main.map(|(cause, share)| format!(" ({} on {}, {})", cause.cause, cause.channel, percent(share)));
        format!("{size} of {quantity}{}", words.unwrap_or_default())
    };
    let parts: Vec<String> = [largest("rad"), largest("m")].into_iter().flatten().map(part).collect();
    let horizon = cost.horizons_s.last().copied().unwrap_or_default();
    format!("{} costs up to {} after {}", cost.model, parts.join(" and "), time(horizon))
}

fn write_cost(to: &mut dyn Write, cost: &Cost) -> std::io::Result<()> {
    writeln!(to, "{}.", headline(cost))?;
    let align = time(cost.align_s);
    let setting = match &cost.motion {
        Some(motion) => format!("Along {motion}, after {align} of alignment at rest"),
        None => format!("At rest, {align} of alignment"),
    };
    writeln!(to, "{setting}; the size of an error stays below the band in 95 %.")?;
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
        let (factor, unit) = quantity.shown_in();
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
fn write_remarks(to: &mut dyn Write, cost: &Cost) -> std::io::Result<()> {
    if cost.extrapolated.iter().flatten().any(|beyond| *beyond) {
        writeln!(to, "* extrapolation: the record that the model was fitted to is shorter")?;
    }
    let mut simulated: Vec<(String, Vec<String>)> = Vec::new();
    for (quantity, growth) in cost.quantities.iter().filter(|(_, growth)| growth.method == Method::MonteCarlo) {
        let runs = growth.runs.unwrap_or_default();
        let how = format!("Monte Carlo, {runs} runs, because of {}", growth.simulated.join(", "));
        match simulated.iter_mut().find(|(other, _)| *other == how) {
            Some((_, quantities)) => quantities.push(quantity.to_string()),
            None => simulated.push((how, vec![quantity.to_string()])),
        }
    }
    for (how, quantities) in simulated {
        writeln!(to, "{}: {how}", quantities.join(", "))?;
    }
    for note in &cost.notes {
        writeln!(to, "note: {note}")?;
    }
    for verdict in &cost.tolerances {
        let [value, limit] = [verdict.value, verdict.limit].map(|value| verdict.quantity.with_unit(value));
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

/// Writes what the pieces of a recording show beside the model's prediction.
fn write_measured(to: &mut dyn Write, model: &str, of: &Measured) -> std::io::Result<()> {
    writeln!(
        to,
        "\nMeasured in pieces of {} ({} at rest), beside {model}; 95 % intervals in brackets:",
        of.real,
        time(of.length_s.round())
    )?;
    let mut rows =
        table(&["error", "after", "pieces", "independent", "measured rms", "predicted rms", "inside the band"]);
    let mut short = Vec::new();
    for (quantity, growing) in &of.quantities {
        for (place, (horizon_s, pieces)) in of.horizons_s.iter().zip(&growing.pieces).enumerate() {
            let Some(pieces) = pieces else {
                short.push(time(*horizon_s));
                continue;
            };
            let [low, high] = pieces.rms_ci95.map(|end| quantity.with_unit(end));
            let [least, most] = pieces.coverage_ci95.map(|end| format!("{:.1}", 100.0 * end));
            rows.add_row([
                if place == 0 { quantity.to_string() } else { String::new() },
                time(*horizon_s),
                pieces.count.to_string(),
                format!("{:.0}", pieces.independent),
                format!("{} ({low} to {high})", quantity.with_unit(pieces.rms)),
                quantity.with_unit(pieces.predicted_rms),
                format!("{:.1} % ({least} to {most} %)", 100.0 * pieces.coverage),
            ]);
        }
    }
    writeln!(to, "{rows}")?;
    short.sort();
    short.dedup();
    if !short.is_empty() {
        writeln!(to, "fewer than {LEAST_PIECES} disjoint pieces: {}", short.join(", "))?;
    }
    of.notes.iter().try_for_each(|note| writeln!(to, "note: {note}"))
}
