//! `vn100d diagnose`: where a recording and a simulator differ, and which effect the simulator lacks.

use super::args::{DiagnoseArgs, ReferenceAxis};
use super::limits::Limit;
use super::output::{Output, is_same};
use super::{Context, Outcome, analysis, diagnose_limits, junit, limits, model, table, usage};
use crate::jobs::{TwoThreads, add_cost, gridded, read_reference};
use crate::page;
use crate::store::SOFTWARE;
use anyhow::Context as _;
use imu_core::units::format_duration;
use imu_cost::Quantity;
use imu_diagnosis::report::{Cause, Driver, GapCost, Hint, Of, Offset, Place, Sense};
use imu_diagnosis::{Diagnosis, Drawings, Known, Options};
use imu_model::simulator::SensorModel;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Runs the command.
pub(super) fn run(context: &Context, args: &DiagnoseArgs) -> anyhow::Result<Outcome> {
    let paths = [Some(Path::new(&args.real)), Some(Path::new(&args.sim)), args.reference.as_deref()];
    let read: Vec<&Path> = paths.into_iter().flatten().filter(|path| path.exists()).collect();
    let limits = Limit::all(&args.at_least, &args.at_most, &diagnose_limits::KNOWN)?;
    if args.junit.is_some() && limits.is_empty() {
        return Err(usage("--junit has nothing to report without a limit: give --at-most or --at-least"));
    }
    let [augmented, html, junit] = outputs(args, &read)?;
    let reference = args.reference.as_deref().map(|path| reference(path, args.reference_axis)).transpose()?;
    let mut together = analysis::open(context, std::slice::from_ref(&args.real), args.rate)?;
    together.sampled(args.sampling.stated())?;
    let (sim, doubt) = simulator(context, args, together.plan.rate_hz)?;
    let gridded = gridded(&together.source, &together.plan, u64::MAX)?;
    let real_name = together.name();
    let tails = args.calibrate.then(|| super::calibration::tails(&gridded.recording, &sim)).transpose()?;
    let options = Options {
        software: SOFTWARE,
        real: &real_name,
        sim: &args.sim,
        workers: &TwoThreads,
        unknown_above: args.unknown_above,
        tails: tails.as_ref(),
        ..Options::default()
    };
    let outcome = imu_diagnosis::diagnose_any(&gridded.recording, reference.as_ref(), &sim, &options);
    let mut outcome = outcome?;
    if let Some(path) = &args.reference {
        outcome.diagnosis.inputs.insert("reference".into(), path.display().to_string());
    }
    gridded.adjust(&mut outcome.diagnosis);
    outcome.diagnosis.notes.extend(doubt);
    if reference.is_none() {
        add_cost(&mut outcome, &gridded.recording, &sim);
    }
    if let Some(output) = augmented {
        output.put((serde_json::to_string_pretty(&outcome.augmented)? + "\n").as_bytes())?;
    }
    if let Some(output) = html {
        let drawings = Drawings::new(&gridded.recording, gridded.from_s, &sim, &outcome);
        output.put(page::diagnosis(&outcome.diagnosis, &drawings, &[]).as_bytes())?;
    }
    let judged = diagnose_limits::judge(&limits, &outcome.diagnosis);
    if let Some(output) = junit {
        let inputs = [("real", real_name.as_str()), ("sim", args.sim.as_str())];
        let summary = &outcome.diagnosis.summary;
        let about = junit::About { command: "diagnose", inputs: &inputs, summary, lenient: false };
        output.put(junit::report(&about, &judged).as_bytes())?;
    }
    if context.json {
        limits::print_json(&outcome.diagnosis, &judged)?;
        limits::complain(&judged)?;
    } else {
        print(&outcome.diagnosis)?;
        limits::write(&mut std::io::stdout().lock(), &judged)?;
    }
    Ok(limits::outcome(&judged, together.rejected(), false))
}

/// Creates the files of the corrected model, the page and the report of limits, each under a name of its own.
fn outputs(args: &DiagnoseArgs, read: &[&Path]) -> anyhow::Result<[Option<Output>; 3]> {
    let named = [("the model", &args.augmented_model), ("the page", &args.html), ("the JUnit report", &args.junit)];
    let given: Vec<(&str, &Path)> = named.iter().filter_map(|(what, path)| Some((*what, path.as_deref()?))).collect();
    for (place, (one, path)) in given.iter().enumerate() {
        if let Some((other, _)) = given[..place].iter().find(|(_, other)| is_same(other, path)) {
            let message = format!("{} cannot be both {other} and {one}: choose another name", path.display());
            return Err(usage(message));
        }
    }
    let create = |path: &Option<PathBuf>| path.as_ref().map(|path| Output::create(path, args.force, read)).transpose();
    Ok([create(&args.augmented_model)?, create(&args.html)?, create(&args.junit)?])
}

/// Reads the reference: the sensor's motion, poses, or rates about one axis; gzip is unpacked.
fn reference(path: &Path, axis: Option<ReferenceAxis>) -> anyhow::Result<Known> {
    let name = path.display().to_string();
    let mut file = BufReader::new(File::open(path).with_context(|| format!("the reference {name} cannot be read"))?);
    anyhow::ensure!(!file.get_ref().metadata()?.is_dir(), "the reference {name} is a folder: expected a CSV file");
    let mut text = String::new();
    let read = match file.fill_buf()?.starts_with(&[0x1f, 0x8b]) {
        true => flate2::bufread::MultiGzDecoder::new(file).read_to_string(&mut text),
        false => file.read_to_string(&mut text),
    };
    read.with_context(|| format!("the reference {name} cannot be read as text"))?;
    let found = read_reference(&text, &name, axis.map(|axis| axis as usize));
    found.map_err(|reason| anyhow::anyhow!("the reference {name} cannot be used: {reason}"))
}

/// Returns the simulator's law: a model's file, or a recording that a simulator made, to which a law is fitted first.
/// Another rate than the recording's is refused before that. If that law is doubtful, a sentence for the diagnosis is
/// returned as well.
fn simulator(context: &Context, args: &DiagnoseArgs, real_hz: f64) -> anyhow::Result<(SensorModel, Option<String>)> {
    let path = Path::new(&args.sim);
    let is_model = path.is_file() && path.extension().is_some_and(|extension| extension == "json");
    let same_rate = |sim_hz| imu_diagnosis::same_rate(real_hz, sim_hz);
    if is_model {
        let sim = model::load(path)?;
        same_rate(sim.rate_hz)?;
        return Ok((sim, None));
    }
    let together = analysis::open(context, std::slice::from_ref(&args.sim), args.rate)?;
    same_rate(together.plan.rate_hz)?;
    Ok(model::fitted(together, &imu_diagnosis::effects(), None)?.fitted.as_law()?)
}

fn print(of: &Diagnosis) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", of.summary)?;
    let gap = &of.discrepancy;
    writeln!(out)?;
    writeln!(
        out,
        "gap in nats a sample: {:.2e} as the model is, {:.2e} with its parameters corrected, {:.2e} with what was found",
        gap.before, gap.after_parameters, gap.after
    )?;
    writeln!(out, "a true model shows {:.1e}; measured on the {}", gap.floor, gap.measured_on)?;
    if let (Some(closed), Some([low, high])) = (gap.closed, gap.closed_ci95) {
        writeln!(out, "closed: {:.1} % ({:.1} to {:.1} %)", 100.0 * closed, 100.0 * low, 100.0 * high)?;
    }
    if !of.causes.is_empty() {
        let mut rows = table(&["effect", "on", "parameters", "sure", "closes"]);
        for cause in &of.causes {
            let closes = cause.closes.map_or_else(|| "–".to_owned(), |part| format!("{:.0} %", 100.0 * part));
            let sure = format!("{:.0} %", (100.0 * cause.confidence).floor());
            let (who, of) = match cause.sense {
                Sense::Missing => ("the model lacks it", &cause.parameters),
                Sense::Superfluous => ("the sensor lacks it", &cause.model),
                Sense::Size => ("the model has it otherwise", &cause.parameters),
            };
            let effect = format!("{}\n{who}", cause.effect);
            rows.add_row([effect, cause.channels.join("\n"), parameters(cause, of), sure, closes]);
        }
        writeln!(out, "\n{rows}")?;
    }
    if let Some(cost) = &gap.cost {
        write_cost(&mut out, cost)?;
    }
    if let Some(left) = &of.remainder {
        let on = left.channels.join(", ");
        writeln!(out, "\nwithout a name: {:.2} % of the gap, on {on}", 100.0 * left.share)?;
        left.what.iter().try_for_each(|what| writeln!(out, "  {what}"))?;
    }
    if !of.r#where.is_empty() {
        let mut rows = table(&["where the gap lies", "channel", "band in Hz", "time in s", "share", "sign"]);
        for Place { of: what, channel, band_hz, from_s, to_s, at, share, sign, .. } in &of.r#where {
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
    }
    if !of.parameters.is_empty() {
        let mut rows = table(&["parameter off", "", "model", "capture", "ratio"]);
        for one in &of.parameters {
            let ratio = one.ratio.map_or_else(|| "–".to_owned(), |ratio| format!("{ratio:.3}"));
            let (model, capture) = (format!("{:.3e}", one.model), format!("{:.3e}", one.capture));
            rows.add_row([one.channel.clone(), one.parameter.to_string(), model, capture, ratio]);
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
    for Hint { about, text, .. } in &of.hints {
        writeln!(out, "{about}: {text}")?;
    }
    for cause in &of.causes {
        for sentence in cause.evidence.iter().take(3) {
            writeln!(out, "{sentence}")?;
        }
    }
    for other in &of.alternatives {
        writeln!(out, "not {} on {}: {}", other.effect, other.channels.join(", "), other.why_not)?;
    }
    for note in &of.notes {
        writeln!(out, "{note}")?;
    }
    Ok(())
}

/// Writes the 95 % bands of unaided integration under the model, the corrected one, and that without the causes.
fn write_cost(out: &mut impl std::io::Write, cost: &GapCost) -> std::io::Result<()> {
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

/// Returns the parameters of a cause that the sensor or the model has, one row per channel of its cell.
fn parameters(cause: &Cause, all: &BTreeMap<String, Value>) -> String {
    const LONGEST: usize = 40;
    let number = |value: &Value| value.as_f64().map_or_else(|| value.to_string(), |value| format!("{value:.4e}"));
    let one = |of: &Value| {
        let pairs = of.as_object().into_iter().flatten().map(|(name, value)| format!("{name} {}", number(value)));
        let text = pairs.collect::<Vec<_>>().join(", ");
        match text.char_indices().nth(LONGEST) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        }
    };
    let of_channel = |value: &Value| match value {
        Value::Array(list) => match list.as_slice() {
            [first, _, ..] => format!("{} and {} more", one(first), list.len() - 1),
            [first] => one(first),
            [] => String::new(),
        },
        other => one(other),
    };
    // In the order of the column of channels.
    let of_triad = cause.triad.as_ref().and_then(|triad| all.get(&**triad)).into_iter();
    let rows = cause.channels.iter().filter_map(|channel| all.get(channel)).chain(of_triad).map(of_channel);
    rows.collect::<Vec<_>>().join("\n")
}
