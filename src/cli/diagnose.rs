//! `vn100d diagnose`: where a recording and a simulator differ, and which effect the simulator lacks.

use super::args::DiagnoseArgs;
use super::diagnose_text::Style;
use super::limits::Limit;
use super::output::{Output, is_same};
use super::reference::reference;
use super::{Context, Outcome, analysis, diagnose_limits, diagnose_text, junit, limits, model, usage};
use crate::jobs::{TwoThreads, add_cost, gridded};
use crate::page;
use crate::store::SOFTWARE;
use imu_diagnosis::{Drawings, Options};
use imu_model::simulator::SensorModel;
use std::path::{Path, PathBuf};

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
        let corrected = match &args.augmented_model {
            Some(path) => format!("--augmented-model wrote it to {}", path.display()),
            None => "--augmented-model OUT.json writes it".to_owned(),
        };
        let mut stdout = std::io::stdout().lock();
        diagnose_text::print(&mut stdout, &outcome.diagnosis, Style { verbose: args.verbose, corrected: &corrected })?;
        limits::write(&mut stdout, &judged)?;
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
        return Ok((context.part.of_model(sim, path)?, None));
    }
    let together = analysis::open(&context.at_any_time(), std::slice::from_ref(&args.sim), args.rate)?;
    same_rate(together.plan.rate_hz)?;
    Ok(model::fitted(together, &imu_diagnosis::effects(), None)?.fitted.as_law()?)
}
