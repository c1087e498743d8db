//! `vn100d report --validation`: the validation sheet of a sensor model.

use super::analysis::same_file;
use super::args::ReportArgs;
use super::cost::{Real, refused};
use super::output::Output;
use super::source::file;
use super::{Context, Outcome, failed, model, print_json, usage};
use crate::jobs;
use crate::page;
use crate::store::SOFTWARE;
use imu_cost::{Evidence, MeasureError, Request, Sheet, SheetVerdict, sheet};
use imu_model::simulator::SensorModel;
use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

/// Writes the sheet.
pub(super) fn run(context: &Context, args: &ReportArgs, path: &Path) -> anyhow::Result<Outcome> {
    if args.sampling.stated().is_some() {
        return Err(usage(
            "--validation takes the sampling of the model's file: leave out --filter-window and --internal-rate",
        ));
    }
    let of = &args.validation;
    let out = Some(args.out.as_path()).filter(|out| *out != Path::new("-"));
    let mut read: Vec<&Path> = args.captures.iter().filter_map(|named| file(named)).collect();
    read.push(path);
    let output = out.map(|out| Output::create(out, args.force, &read)).transpose()?;
    let model = context.part.of_model(model::load(path)?, path)?;
    let reals: Vec<Real> =
        args.captures.iter().map(|named| Real::open(context, named, args.rate)).collect::<Result<_, _>>()?;
    for (number, real) in reals.iter().enumerate() {
        if reals[..number]
            .iter()
            .any(|other| other.id == real.id && (real.id.is_some() || same_file(&other.name, &real.name)))
        {
            return Err(usage(format!("`{}` is given twice: it would count as two recordings", real.name)));
        }
    }
    let request = Request {
        align_s: of.align.as_secs_f64(),
        horizons_s: of.horizons.iter().map(Duration::as_secs_f64).collect(),
        tolerances: of.tolerance.iter().flat_map(|of| of.0.clone()).collect(),
        ..Request::default()
    };
    let evidence: Vec<Evidence<'_>> = reals.iter().map(|real| evidence(real, &model, of.after.as_secs_f64())).collect();
    let name = path.display().to_string();
    let mut found = sheet(&model, &name, &evidence, &request).map_err(|error| match error {
        MeasureError::Cost(error) => refused(path, &error),
        _ => failed(format!("{} and {name}: {error}", args.captures.join(", "))),
    })?;
    found.notes.extend(reals.iter().filter_map(|real| Some(format!("{}: {}", real.name, real.left_out()?))));
    let html = page::validation(&found, SOFTWARE);
    match output {
        Some(output) => output.put(html.as_bytes())?,
        None => std::io::stdout().lock().write_all(html.as_bytes())?,
    }
    if context.json {
        print_json(&found)?;
    } else if let Some(out) = out {
        writeln!(std::io::stdout(), "{}: {}", out.display(), sentence(&found))?;
    }
    let rejected = reals.iter().any(|real| real.rejected);
    Ok(match (of.check && found.verdict != SheetVerdict::Validated, rejected) {
        (true, _) => Outcome::LimitMissed,
        (false, true) => Outcome::WithLoss,
        (false, false) => Outcome::Done,
    })
}

fn sentence(of: &Sheet) -> String {
    let verdict = match of.verdict {
        SheetVerdict::Validated => "validated inside the envelope of the data",
        SheetVerdict::NotValid => "not valid",
        SheetVerdict::Undecided => "undecided",
    };
    format!("{} is {verdict}: {}", of.model, of.reason)
}

fn evidence<'a>(real: &'a Real, model: &SensorModel, after_s: f64) -> Evidence<'a> {
    let recording = &real.gridded.recording;
    let begin_s = after_s + real.gridded.from_s;
    let there = recording.temperature_c.iter().flatten().copied().filter(|value| value.is_finite());
    let range = there.fold(None, |range: Option<[f64; 2]>, value| {
        Some(range.map_or([value; 2], |[low, high]| [low.min(value), high.max(value)]))
    });
    let fitted_to = model.provenance.as_ref().and_then(|of| of.get("capture")).and_then(serde_json::Value::as_str);
    let place = |name: &str| Path::new(name).canonicalize().ok();
    let is_it = |of: &str| of == real.name || place(of).is_some_and(|of| place(&real.name) == Some(of));
    // A model of several captures has the names of all.
    let is_source = fitted_to.is_some_and(|of| is_it(of) || of.split(" + ").any(is_it));
    Evidence {
        name: real.name.clone(),
        rest: jobs::rest(recording),
        begin_s,
        temperature: jobs::temperatures(recording, begin_s),
        temperature_c: range,
        unit: real.unit.clone(),
        date: real.date.clone(),
        is_source,
    }
}

/// Returns the arguments' model.
///
/// # Errors
/// If there is none.
pub(super) fn model_path(args: &ReportArgs) -> anyhow::Result<&Path> {
    args.validation.model.as_deref().ok_or_else(|| usage("--validation needs --model FILE"))
}
