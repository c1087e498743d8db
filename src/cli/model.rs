//! `vn100d model`: sensor models of captures, shown, compared and exported.

use super::args::{EffectNames, ModelArgs, ModelCommand, ModelFormat};
use super::{Context, Outcome, analysis, print_json, table};
use crate::export::{ImuNoise, Target};
use crate::jobs::{Plan, SampleSource, direct};
use crate::model_fit::{Difference, Level, Resolution, differences, model_of};
use crate::noise::statistics::Moments;
use crate::sample::Channel;
use crate::simulator::{ChannelModel, SensorModel};
use crate::store::{SOFTWARE, StoreError};
use anyhow::Context as _;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

/// Samples read at a time.
const CHUNK: usize = 65_536;

/// Runs the sub-command.
pub(super) fn run(context: &Context, args: &ModelArgs) -> anyhow::Result<Outcome> {
    match &args.command {
        ModelCommand::Fit { captures, rate, effects, name, out } => {
            let wanted = effects.as_ref().map(|EffectNames(names)| names.clone()).unwrap_or_default();
            let together = analysis::open(context, captures, *rate)?;
            let levels = levels(&together.source, &together.plan)?;
            let (rejected, title) = (together.rejected(), together.name());
            let report = direct::noise(&together.source, together.plan)?;
            let name = name.clone().unwrap_or(title);
            let model = model_of(&report, &levels, &wanted, &name, SOFTWARE);
            match out {
                None => print_json(&model)?,
                Some(path) => {
                    let text = serde_json::to_string_pretty(&model)? + "\n";
                    std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))?;
                    println!("{}: {} channels of {name} at {} Hz", path.display(), model.channels.len(), model.rate_hz);
                }
            }
            return Ok(if rejected { Outcome::WithLoss } else { Outcome::Done });
        }
        ModelCommand::Show { file } => {
            let model = load(file)?;
            if context.json { print_json(&model)? } else { show(&model)? }
        }
        ModelCommand::Diff { first, second } => {
            let found = differences(&load(first)?, &load(second)?);
            if context.json { print_json(&found)? } else { show_differences(&found)? }
        }
        ModelCommand::Export { file, format } => {
            let model = load(file)?;
            let target = match format {
                ModelFormat::Kalibr => Target::Kalibr,
                ModelFormat::Ros => Target::Ros,
                ModelFormat::Gazebo => Target::Gazebo,
                ModelFormat::GnssInsSim => Target::GnssInsSim,
                ModelFormat::Matlab => Target::Matlab,
            };
            write!(std::io::stdout().lock(), "{}", target.write(&ImuNoise::of_model(&model)))?;
        }
    }
    Ok(Outcome::Done)
}

fn load(path: &Path) -> anyhow::Result<SensorModel> {
    super::emulate::load_model(Some(path))
}

/// Mean and resolution of every channel of a plan, and of the temperature where it was recorded.
fn levels(source: &dyn SampleSource, plan: &Plan) -> Result<BTreeMap<Channel, Level>, StoreError> {
    let channels: Vec<Channel> = plan.channels.iter().copied().chain([Channel::Temperature]).collect();
    let mut seen: Vec<(Moments, Resolution)> = channels.iter().map(|_| Default::default()).collect();
    let mut next_seq = 0;
    while next_seq < plan.end_seq {
        let chunk = plan.read_chunk(source, next_seq, CHUNK, &channels)?;
        for ((moments, resolution), column) in seen.iter_mut().zip(&chunk.columns) {
            column.iter().filter(|value| value.is_finite()).for_each(|value| moments.add(*value));
            resolution.push(column);
        }
        next_seq = chunk.next_seq();
    }
    let level =
        |(moments, resolution): (Moments, Resolution)| Some(Level { mean: moments.mean()?, step: resolution.step() });
    Ok(channels.into_iter().zip(seen).filter_map(|(channel, seen)| Some((channel, level(seen)?))).collect())
}

fn show(model: &SensorModel) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match model.sampling {
        None => writeln!(stdout, "{}: as seen at {} Hz", model.name, model.rate_hz)?,
        Some(sampling) => writeln!(
            stdout,
            "{}: sampled at {} Hz, means of {}, sent at {} Hz",
            model.name, sampling.internal_rate_hz, sampling.filter_window, model.rate_hz
        )?,
    }
    let mut rows = table(&["channel", "unit U", "N in U/√Hz", "B in U", "K in U/√s", "bias in U", "effects"]);
    for (channel, of) in &model.channels {
        let cell = |key: &str, value: f64| {
            let limit = entry(of, key, "upper_limit95").and_then(|value| value.as_f64());
            match (value, limit, entry(of, key, "ci95")) {
                (0.0, Some(limit), _) => format!("0 (< {limit:.2e})"),
                (value, _, Some(ci95)) => {
                    let end = |index: usize| ci95.get(index).and_then(Value::as_f64).unwrap_or(f64::NAN);
                    format!("{value:.3e} [{:.2e}, {:.2e}]", end(0), end(1))
                }
                (0.0, ..) => "0".to_owned(),
                (value, ..) => format!("{value:.3e}"),
            }
        };
        rows.add_row([
            channel.name().to_owned(),
            channel.unit().to_owned(),
            cell("N", of.n),
            cell("B", of.b),
            cell("K", of.k),
            of.bias.map_or_else(|| "–".to_owned(), |bias| format!("{bias:.6}")),
            of.effects.iter().map(|effect| sentence(effect.name(), effect.parameters())).collect::<Vec<_>>().join("\n"),
        ]);
    }
    writeln!(stdout, "{rows}")?;
    for (triad, of) in &model.triads {
        for effect in &of.effects {
            writeln!(stdout, "{}: {}", triad.name(), sentence(effect.name(), effect.parameters()))?;
        }
    }
    if let Some(provenance) = &model.provenance {
        let told = |(key, value): (&String, &Value)| match value.as_str() {
            Some(text) => format!("{key} {text}"),
            None => format!("{key} {value}"),
        };
        writeln!(stdout, "from {}", provenance.iter().map(told).collect::<Vec<_>>().join(", "))?;
    }
    Ok(())
}

fn entry<'a>(of: &'a ChannelModel, key: &str, of_what: &str) -> Option<&'a Value> {
    of.uncertainty.as_ref()?.get(key)?.get(of_what)
}

fn sentence(name: &str, parameters: Vec<(&'static str, Value)>) -> String {
    let told: Vec<String> = parameters.into_iter().map(|(key, value)| format!("{key} {value}")).collect();
    format!("{name}: {}", told.join(", "))
}

fn show_differences(found: &[Difference]) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    if found.is_empty() {
        return writeln!(stdout, "no difference");
    }
    let mut rows = table(&["what", "first", "second", "second / first", "in the first's 95 % interval"]);
    for of in found {
        let told = |value: &Value| match value {
            Value::Null => "–".to_owned(),
            Value::Number(number) => number.as_f64().map_or_else(|| number.to_string(), |value| format!("{value:.4e}")),
            other => other.to_string(),
        };
        let within = of.within_ci95.map_or("–", |within| if within { "yes" } else { "no" });
        rows.add_row([
            of.path.clone(),
            told(&of.first),
            told(&of.second),
            of.ratio.map_or_else(|| "–".to_owned(), |ratio| format!("{ratio:.3}")),
            within.to_owned(),
        ]);
    }
    writeln!(stdout, "{rows}")
}
