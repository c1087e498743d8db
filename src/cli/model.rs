//! `vn100d model`: sensor models of captures, shown, compared and exported.

use super::analysis::Together;
use super::args::{EffectNames, ModelArgs, ModelCommand};
use super::figures::{counted, hertz, rounded};
use super::output::Output;
use super::simulate::without_gravity;
use super::{Context, Outcome, analysis, print_json, table};
use crate::jobs::{self, Fitted, TwoThreads};
use crate::page::digits;
use anyhow::Context as _;
use imu_diagnosis::model_fit::{Difference, differences};
use imu_files::export::ImuNoise;
use imu_model::EffectKind;
use imu_model::simulator::SensorModel;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

/// Runs the sub-command.
pub(super) fn run(context: &Context, args: &ModelArgs) -> anyhow::Result<Outcome> {
    match &args.command {
        ModelCommand::Fit { captures, rate, part: _, sampling, effects, name, out, overwrite, force } => {
            let read: Vec<&Path> = captures.iter().map(Path::new).filter(|path| path.exists()).collect();
            let output = |path: &Path| Output::create_by("--overwrite", path, *overwrite, &read);
            let out = out.as_deref().map(output).transpose()?;
            let wanted = effects.as_ref().map(|EffectNames(names)| names.clone()).unwrap_or_default();
            let mut together = analysis::open(context, captures, *rate)?;
            together.sampled(sampling.stated())?;
            let Fit { fitted: Fitted { mut model, refusal }, name, rejected } =
                fitted(together, &wanted, name.clone())?;
            if let Some(why) = refusal {
                if !*force {
                    return Err(super::noise::refused("the model is not written", &why));
                }
                model.provenance.get_or_insert_default().insert("not_usable".to_owned(), why.into());
            }
            match out {
                None => print_json(&model)?,
                Some(output) => {
                    let (text, path) =
                        (serde_json::to_string_pretty(&model)? + "\n", output.path().display().to_string());
                    output.file().write_all(text.as_bytes()).with_context(|| format!("{path} cannot be written"))?;
                    output.keep()?;
                    println!(
                        "{path}: {} of {name} at {}",
                        counted(model.channels.len() as u64, "channel", "channels"),
                        hertz(model.rate_hz)
                    );
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
            let mut model = load(file)?;
            without_gravity(&mut model, "the target");
            write!(std::io::stdout().lock(), "{}", format.write(&ImuNoise::of_model(&model)))?;
        }
    }
    Ok(Outcome::Done)
}

/// A model fitted to captures.
pub(super) struct Fit {
    pub(super) fitted: Fitted,
    /// The name of the model.
    name: String,
    /// Whether frames or lines were rejected on the way in.
    rejected: bool,
}

/// Returns the model of captures, with the wanted effects as far as they are found.
pub(super) fn fitted(together: Together, wanted: &[EffectKind], name: Option<String>) -> anyhow::Result<Fit> {
    let rejected = together.rejected();
    let name = name.unwrap_or_else(|| together.name());
    let fitted = jobs::fitted(&together.source, together.plan, wanted, &name, u64::MAX, &TwoThreads)?;
    Ok(Fit { fitted, name, rejected })
}

pub(super) fn load(path: &Path) -> anyhow::Result<SensorModel> {
    super::emulate::load_model(Some(path))
}

fn show(model: &SensorModel) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match model.sampling {
        None => writeln!(stdout, "{}: as seen at {}", model.name, hertz(model.rate_hz))?,
        Some(sampling) => writeln!(
            stdout,
            "{}: sampled at {}, means of {}, sent at {}",
            model.name,
            hertz(sampling.internal_rate_hz),
            sampling.filter_window,
            hertz(model.rate_hz)
        )?,
    }
    let mut rows = narrow(&["channel", "parameter", "value", "95 % interval"]);
    for (channel, of) in &model.channels {
        let mut head = [channel.name(), channel.unit()].into_iter();
        let mut add = |parameter: String, value: String, interval: String| {
            rows.add_row([head.next().unwrap_or_default().to_owned(), parameter, value, interval]);
        };
        for (key, unit, value) in [("N", "U/√Hz", of.n), ("B", "U", of.b), ("K", "U/√s", of.k)] {
            let limit = of.upper_limit(key).filter(|_| value == 0.0).map(|limit| format!("< {}", rounded(limit, 3)));
            let known = limit.or_else(|| of.interval(key).map(ends)).unwrap_or_default();
            let digits = of.interval(key).map_or(4, |ends| digits(value, ends));
            add(format!("{key}, {unit}"), rounded(value, digits), known);
        }
        if let Some(bias) = of.bias {
            let digits = of.interval("bias").map_or(6, |ends| digits(bias, ends));
            add("bias, U".to_owned(), rounded(bias, digits), of.interval("bias").map(ends).unwrap_or_default());
        }
        let named = numbered(of.effects.iter().map(|effect| effect.name()));
        for (index, (effect, name)) in of.effects.iter().zip(named).enumerate() {
            for (key, value) in effect.parameters() {
                let interval = of.effect_interval(index, key);
                let text = match value.as_f64().zip(interval) {
                    Some((value, ends)) => rounded(value, digits(value, ends)),
                    None => value_text(&value),
                };
                add(format!("{name}.{key}"), text, interval.map(ends).unwrap_or_default());
            }
        }
    }
    for (triad, of) in &model.triads {
        let mut head = triad.name().to_owned();
        let named = numbered(of.effects.iter().map(|effect| effect.name()));
        for (effect, name) in of.effects.iter().zip(named) {
            for (key, value) in effect.parameters() {
                rows.add_row([std::mem::take(&mut head), format!("{name}.{key}"), value_text(&value), String::new()]);
            }
        }
    }
    writeln!(stdout, "{rows}")?;
    if let Some(provenance) = &model.provenance {
        let of = |(key, value): (&String, &Value)| format!("{key} {}", in_words(value));
        let line = provenance.iter().map(of).filter(|of| !of.ends_with(' ')).collect::<Vec<_>>().join(", ");
        writeln!(stdout, "{}", wrapped(&format!("from {line}")))?;
    }
    Ok(())
}

/// Columns of a terminal of usual width.
const WIDTH: u16 = 80;

/// Returns a table that wraps its cells instead of its lines.
fn narrow(header: &[&str]) -> super::table::Table {
    table(header).at_most(WIDTH)
}

/// Returns the names of effects with a number from the second of a kind on, as in `model diff`.
fn numbered<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    let number = |name| {
        let count = seen.entry(name).or_default();
        *count += 1;
        if *count == 1 { name.to_owned() } else { format!("{name}[{}]", *count - 1) }
    };
    names.map(number).collect()
}

/// Returns an interval with as many digits as distinguish its ends.
fn ends([low, high]: [f64; 2]) -> String {
    let digits = digits(low, [low, high]);
    format!("{} … {}", rounded(low, digits), rounded(high, digits))
}

/// Returns a parameter; numbers have the relevant digits.
fn value_text(value: &Value) -> String {
    match value.as_f64() {
        Some(number) if number != 0.0 && !(9.99e-4..1e6).contains(&number.abs()) => format!("{number:.4e}"),
        Some(number) => {
            let text = format!("{number:.6}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        }
        None => value.as_str().map_or_else(|| value.to_string(), str::to_owned),
    }
}

/// Returns provenance without JSON's marks; values that all entries of an object share are written once.
fn in_words(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(list) => list.iter().map(in_words).collect::<Vec<_>>().join(" "),
        Value::Object(map) => match map.values().next() {
            Some(first) if map.values().all(|value| value == first) => in_words(first),
            _ => map.iter().map(|(key, value)| format!("{key}: {}", in_words(value))).collect::<Vec<_>>().join("; "),
        },
        other => other.to_string(),
    }
}

/// Returns the text in lines of at most [`WIDTH`] where the words allow it.
fn wrapped(text: &str) -> String {
    let (mut lines, mut line) = (Vec::new(), String::new());
    for word in text.split_whitespace() {
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > usize::from(WIDTH) {
            lines.push(std::mem::take(&mut line));
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    lines.push(line);
    lines.join("\n")
}

fn show_differences(found: &[Difference]) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    if found.is_empty() {
        return writeln!(stdout, "no difference");
    }
    let mut rows = narrow(&["what", "first", "second", "ratio", "in interval"]);
    for of in found {
        let cell = |value: &Value| match value {
            Value::Null => "–".to_owned(),
            Value::Object(effect) => {
                let parameter = |(key, value): (&String, &Value)| format!("{key} {}", value_text(value));
                effect.iter().filter(|(key, _)| *key != "effect").map(parameter).collect::<Vec<_>>().join("\n")
            }
            other => value_text(other),
        };
        let within = of.within_ci95.map_or("–", |within| if within { "yes" } else { "no" });
        rows.add_row([
            of.path.trim_start_matches("channels.").trim_start_matches("triads.").replace(".effects.", " "),
            cell(&of.first),
            cell(&of.second),
            of.ratio.map_or_else(|| "–".to_owned(), |ratio| format!("{ratio:.3}")),
            within.to_owned(),
        ]);
    }
    writeln!(stdout, "{rows}")?;
    writeln!(stdout, "ratio: second over first; in interval: the second in the first's 95 % interval")
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::Channel;
    use serde_json::json;

    /// The first quarter of the record is a turn, which is in no level and which no effect explains.
    #[test]
    fn a_model_is_that_of_the_samples_at_rest() {
        use std::fmt::Write as _;
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("turned.csv");
        let mut state = 1u64;
        let mut text = "time_s,gyro_z_rad_s\n".to_owned();
        for i in 0..12_000 {
            state = 16_807 * state % 2_147_483_647;
            let noise = 0.002 * (state as f64 / 2_147_483_647.0 - 0.5);
            let turned = if i < 3000 { 0.5 } else { 0.0 };
            writeln!(text, "{:.2},{:.6}", f64::from(i) / 100.0, noise + turned).unwrap();
        }
        std::fs::write(&path, text).unwrap();
        let context = Context { data_dir: None, config: None, json: false, ..Context::default() };
        for wanted in [&[][..], &[EffectKind::BiasStep]] {
            let opened = analysis::open(&context, &[path.to_str().unwrap().to_owned()], None).unwrap();
            let fit = fitted(opened, wanted, None).unwrap().fitted;
            let gyro = &fit.model.channels[&Channel::GyroZ];
            assert!(gyro.bias.unwrap().abs() < 1e-4 && gyro.effects.is_empty(), "{wanted:?}: {gyro:?}");
            assert_eq!(fit.refusal, None, "{wanted:?}");
        }
    }

    #[test]
    fn numbers_and_provenance_are_shown_as_a_person_reads_them() {
        for (value, text) in [
            (json!(0), "0"),
            (json!(13.375), "13.375"),
            (json!(2e-4), "2.0000e-4"),
            (json!(-0.0012), "-0.0012"),
            (json!(1800.0), "1800"),
            (json!("signed"), "signed"),
            (json!([[0, 1]]), "[[0,1]]"),
        ] {
            assert_eq!(value_text(&value), text);
        }
        assert_eq!(in_words(&json!({"gyro_x": "dst", "gyro_y": "dst"})), "dst");
        assert_eq!(in_words(&json!({"gyro_x": "dst", "gyro_y": ["a", 1]})), "gyro_x: dst; gyro_y: a 1");
        assert_eq!(ends([11.39, 11.41]), "11.390 … 11.410");
        assert_eq!((ends([0.0, 2e-5]), ends([1.0, 1.0])), ("0 … 2.00e-5".to_owned(), "1.00000 … 1.00000".to_owned()));
        assert_eq!(numbered(["tone", "comb", "tone"].into_iter()), ["tone", "comb", "tone[1]"]);
        let lines = wrapped(&"word ".repeat(100));
        assert!(lines.lines().all(|line| line.chars().count() <= 80) && lines.lines().count() == 7, "{lines}");
    }
}
