//! `vn100d trial`: the blind check of the diagnosis.
//!
//! The program runs itself: one process makes a case from the sealed seed and writes recording and model to its standard output,
//! another reads them there and writes its diagnosis. Neither says or hears what the case has. The manifest with the digests of
//! all keys is made first; the keys are asked for when the last diagnosis is there, and have to fit it.

use super::args::{TrialArgs, TrialPart, TrialPartArgs};
use super::sealed::{Sealed, Threshold, discrepancy, read, usage, words, write};
use super::trial_on::Ground;
use super::{Context, Outcome, print_json, table, trial_on};
use crate::diagnosis::{self, Options};
use crate::store::SOFTWARE;
use crate::trial::impose::SAMPLES_MIN;
use crate::trial::page::{limit, page, percent, size};
use crate::trial::{Answer, Case, Class, Key, Kind, Manifest, Report, Score, Wanted, case, judge, parcel, plan};
use anyhow::Context as _;
use serde_json::Value;
use std::io::{Read as _, Write as _};

/// Misses that are listed on a terminal; JSON and page have all.
const MISSES_SHOWN: usize = 12;

/// Runs a trial and says what it came to.
pub(super) fn run(context: &Context, args: &TrialArgs) -> anyhow::Result<Outcome> {
    if args.motion {
        return super::trial_motion::run(context, args);
    }
    Wanted::from_words(words(&args.kinds)).map_err(|error| usage(format!("--kinds: {error}")))?;
    let thresholds = Threshold::of(args, &Score::of("", 0, "", &[]).named_rates().map(|(name, ..)| name))?;
    if args.samples.is_some_and(|samples| samples < SAMPLES_MIN) {
        return Err(usage(format!("--samples: a case takes {SAMPLES_MIN} or more")));
    }
    let ground = args.on.as_ref().map(|named| Ground::of(context, args, named)).transpose()?;
    let sealed = Sealed::new(args, ground.as_ref().map(Ground::folder))?;
    let (manifest, manifest_sha256) = sealed.manifest(|| {
        let possible = ground.as_ref().map_or_else(String::new, |ground| {
            let kinds: Vec<&str> = ground.survey.kinds.iter().map(|kind| kind.name()).collect();
            format!("; what can be imposed on every stretch of {} is {}", ground.name, kinds.join(", "))
        });
        format!("--kinds and --cases: there is no such case{possible}")
    })?;
    let cases = manifest.digests.len();
    let reports = sealed.reports(cases)?;
    let owns = match &ground {
        None => vec![None; cases],
        Some(_) => sealed.each(cases, "cases diagnosed as they are", |index| {
            let Ok(text) = sealed.diagnosed(TrialPart::Own, index)? else { return Ok(None) };
            sealed.keep(&format!("reports/{index:05}-own.json"), &text)?;
            Ok(Some(Report::of(&read(&text, "diagnosis")?)?))
        })?,
    };
    let keys: Vec<Key> = sealed.keys(|keys| Ok(manifest.verify(keys)?))?;
    let of_library = |index: usize| matches!(keys[index].class, Class::Single | Class::Pair);
    let truths = sealed.truths(&reports, of_library, closed_by_truth)?;
    let mut answers = Vec::with_capacity(cases);
    for ((report, own), closed_by_truth) in reports.into_iter().zip(owns).zip(truths) {
        let report = report.and_then(|value| Report::of(&value).map_err(|error| error.to_string()));
        answers.push(Answer { report, own, closed_by_truth });
    }
    let judgements: Vec<_> = keys.iter().zip(&answers).map(|(key, answer)| judge(key, answer)).collect();
    let score = Score::of(SOFTWARE, sealed.seed, &manifest_sha256, &judgements);
    let score = match &ground {
        Some(ground) => score.on(&ground.name, ground.survey.stretches, &judgements),
        None => score,
    };
    sealed.keep("judgements.json", &serde_json::to_vec_pretty(&judgements)?)?;
    sealed.keep("score.json", &serde_json::to_vec_pretty(&score)?)?;
    if let Some(path) = &args.html {
        write(path, page(&score).as_bytes())?;
    }
    if context.json {
        print_json(&score)?
    } else {
        show(&score)?
    }
    Ok(Threshold::outcome(&thresholds, |name| score.rate(name).and_then(|rate| rate.share)))
}

/// What the true effects close: the same discrepancy under the model that has them.
fn closed_by_truth(report: &Value, truth: &Value) -> Option<f64> {
    let (before, floor) = (discrepancy(report, "after_parameters")?, discrepancy(report, "floor")?);
    // The true model's parameters are true: refitting them cannot do better but by chance, and may do worse.
    let after = discrepancy(truth, "after_parameters")?.min(discrepancy(truth, "before")?);
    // Where nothing was there to close, no part of it is.
    discrepancy(report, "closed").filter(|_| before > floor).map(|_| (before - after) / (before - floor))
}

/// Runs one part of a trial, for the process that asked.
pub(super) fn run_part(args: &TrialPartArgs) -> anyhow::Result<Outcome> {
    if args.motion {
        return super::trial_motion::run_part(args);
    }
    let mut stdout = std::io::stdout().lock();
    if args.part == TrialPart::Diagnose {
        let mut bytes = Vec::new();
        std::io::stdin().lock().read_to_end(&mut bytes)?;
        let (recording, model) = parcel::unpack(&bytes)?;
        drop(bytes);
        let options = Options { software: SOFTWARE, real: "sealed case", sim: "its model", ..Options::default() };
        let outcome = diagnosis::diagnose(&recording, &model, &options)?;
        serde_json::to_writer(&mut stdout, &outcome.diagnosis)?;
        return Ok(Outcome::Done);
    }
    let survey = args.ground.as_deref().map(trial_on::survey).transpose()?;
    let mut wanted = Wanted::from_words(words(&args.kinds))?;
    if let Some(survey) = &survey {
        wanted.kinds.retain(|kind| survey.kinds.contains(kind));
    }
    let kinds = plan(args.seed, args.cases, &wanted);
    let draw = |index: usize| -> anyhow::Result<Case> {
        let kinds: &[Kind] = kinds.get(index).with_context(|| format!("there is no case {index}"))?;
        Ok(match (&args.ground, &survey) {
            (Some(folder), Some(survey)) => {
                let stretch = trial_on::stretch(folder, index % survey.stretches.max(1))?;
                Case::draw_on(args.seed, index, kinds, 1, stretch)?
            }
            _ => Case::draw_of_length(args.seed, index, kinds, 1, args.samples)?,
        })
    };
    let keys = || (0..kinds.len()).map(|index| Ok(draw(index)?.key())).collect::<anyhow::Result<Vec<Key>>>();
    match args.part {
        TrialPart::Manifest => serde_json::to_writer_pretty(&mut stdout, &Manifest::of(&keys()?))?,
        TrialPart::Key => serde_json::to_writer_pretty(&mut stdout, &keys()?)?,
        TrialPart::Case => {
            let case = draw(args.case)?;
            stdout.write_all(&parcel::pack(&case.record(), &case.model())?)?;
        }
        TrialPart::Own => {
            let (recording, model) = draw(args.case)?.as_it_is().context("nobody recorded the case")?;
            stdout.write_all(&parcel::pack(&recording, &model)?)?;
        }
        TrialPart::Truth => {
            let case = draw(args.case)?;
            let truth = case::true_model(&case.key(), &case.model()).context("no model can say what the case has")?;
            let outcome = diagnosis::diagnose(&case.record(), &truth, &Options::default())?;
            serde_json::to_writer(&mut stdout, &outcome.diagnosis)?;
        }
        TrialPart::Diagnose => {}
    }
    Ok(Outcome::Done)
}

fn show(score: &Score) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    let classes: Vec<String> = score.classes.iter().map(|(name, count)| format!("{count} {name}")).collect();
    writeln!(stdout, "{} cases of seed {}: {}", score.cases, score.seed, classes.join(", "))?;
    if let Some(on) = &score.on {
        writeln!(
            stdout,
            "imposed on {} in {} stretches; {} causes are its own and set aside, {} of {} cases are called unknown as they are",
            on.recording, on.stretches, on.own_causes, on.own_unknown.count, on.own_unknown.of
        )?;
    }
    let mut rows = table(&["", "cases", "share (95 %)"]);
    for (_, meaning, rate) in score.named_rates() {
        rows.add_row([meaning.to_owned(), format!("{} of {}", rate.count, rate.of), percent(rate)]);
    }
    writeln!(stdout, "{rows}")?;
    let mut rows = table(&["effect alone", "cases", "first", "unknown", "spurious", "closed", "90 % at"]);
    for of in &score.kinds {
        let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| format!("{value:.2}"));
        rows.add_row([
            of.kind.name().to_owned(),
            of.unknown.of.to_string(),
            if of.library { of.right_first.count.to_string() } else { "–".to_owned() },
            of.unknown.count.to_string(),
            if of.library { of.spurious.count.to_string() } else { "–".to_owned() },
            number(of.closed),
            number(of.size_90),
        ]);
    }
    writeln!(stdout, "{rows}")?;
    show_detection(&mut stdout, score)?;
    show_confidence(&mut stdout, score)?;
    for miss in score.misses.iter().take(MISSES_SHOWN) {
        let kinds: Vec<&str> = miss.kinds.iter().map(|kind| kind.name()).collect();
        let kinds = if kinds.is_empty() { "none".to_owned() } else { kinds.join(" and ") };
        let size = miss.over_limit.map_or_else(String::new, |size| format!(" at {size:.1} times the limit"));
        let named: Vec<&str> = miss.named.iter().map(|cause| cause.effect.as_str()).collect();
        let named = miss.refusal.clone().unwrap_or_else(|| {
            if named.is_empty() { "nothing named".to_owned() } else { format!("named {}", named.join(", ")) }
        });
        writeln!(stdout, "case {}: {kinds}{size}; {}, {named}", miss.case, miss.verdict)?;
    }
    let more = score.misses.len().saturating_sub(MISSES_SHOWN);
    if more > 0 { writeln!(stdout, "and {more} more: --json, --html or --out has them") } else { Ok(()) }
}

/// How many of each size were named first, and from which size on.
fn show_detection(out: &mut impl std::io::Write, score: &Score) -> std::io::Result<()> {
    let library = || score.kinds.iter().filter_map(|of| Some((of, of.detection.as_ref()?)));
    let Some((first, _)) = library().next() else { return Ok(()) };
    let mut head = vec!["size over limit".to_owned()];
    head.extend(first.curve.iter().map(|bin| format!("to {}", bin.to)));
    let mut rows = table(&head.iter().map(String::as_str).collect::<Vec<_>>());
    for (of, _) in library() {
        let mut row = vec![of.kind.name().to_owned()];
        row.extend(of.curve.iter().map(|bin| match bin.right.of {
            0 => "–".to_owned(),
            all => format!("{}/{all}", bin.right.count),
        }));
        rows.add_row(row);
    }
    writeln!(out, "{rows}")?;
    let mut rows = table(&["named first", "50 % at (95 %)", "90 % at (95 %)", "bound", "size"]);
    for (of, at) in library() {
        let bound = at.bound_90.map_or_else(|| "–".to_owned(), size);
        rows.add_row([of.kind.name().to_owned(), limit(at.size_50), limit(at.size_90), bound, at.unit.to_owned()]);
    }
    writeln!(out, "{rows}")
}

/// Which part of the causes with a confidence was right.
fn show_confidence(out: &mut impl std::io::Write, score: &Score) -> std::io::Result<()> {
    let mut rows = table(&["stated confidence", "mean", "causes", "right (95 %)"]);
    for bin in score.reliability.iter().filter(|bin| bin.right.of > 0) {
        let mean = bin.mean.map_or_else(|| "–".to_owned(), |mean| format!("{mean:.3}"));
        rows.add_row([format!("{} to {}", bin.from, bin.to), mean, bin.right.of.to_string(), percent(bin.right)]);
    }
    let of = &score.calibration;
    let (Some(stated), Some(error)) = (of.mean_confidence, of.expected_error) else { return Ok(()) };
    writeln!(out, "{rows}")?;
    writeln!(out, "stated {stated:.3} on average, right {}; expected calibration error {error:.3}", percent(of.right))
}
