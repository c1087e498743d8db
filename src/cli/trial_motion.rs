//! `vn100d trial --motion`: the blind check of the diagnosis with a known motion.
//!
//! As in [`super::trial`], one process makes the cases from the sealed seed and another diagnoses them; a manifest of
//! the keys' digests comes first and the keys last.

use super::args::{TrialArgs, TrialPart, TrialPartArgs};
use super::figures::counted;
use super::sealed::{Sealed, Shape, discrepancy, outcome, thresholds, words};
use super::trial_posed::Ground;
use super::{Context, Outcome, print_json, table, usage};
use crate::store::SOFTWARE;
use anyhow::Context as _;
use imu_core::sample::Triad;
use imu_diagnosis::Options;
use imu_trial::Manifest;
use imu_trial::motion::case::{SAMPLES_MIN, pack, unpack};
use imu_trial::motion::score::RATES;
use imu_trial::motion::{Case, Key, Score, judge, plan};
use imu_trial::page::{self, percent};
use imu_trial::posed;
use serde_json::Value;
use std::io::{Read as _, Write as _};

/// Maximum number of misses listed on a terminal; JSON has all.
const MISSES_SHOWN: usize = 20;

/// Runs a trial and prints the result.
pub(super) fn run(context: &Context, args: &TrialArgs) -> anyhow::Result<Outcome> {
    let ground = ground(context, args)?;
    if ground.is_none() {
        plan(0, 1, words(&args.kinds)).map_err(|error| usage(format!("--kinds: {error}")))?;
    }
    if args.samples.is_some_and(|samples| samples < SAMPLES_MIN) {
        return Err(usage(format!("--samples: a case with a motion takes {SAMPLES_MIN} or more")));
    }
    let required = thresholds(args, &RATES.map(|(name, _)| name))?;
    let sealed = Sealed::new(args, Shape::of(args), ground.as_ref().map(Ground::folder))?;
    let (manifest, manifest_sha256) = sealed.manifest(|| "--cases: there is no case".to_owned())?;
    let reports = sealed.reports(manifest.digests.len())?;
    let verified =
        |keys: &[Key]| Ok(manifest.verify_digests(keys.iter().map(|key| (key.case, key.digest())).collect())?);
    let keys: Vec<Key> = sealed.keys(verified)?;
    let of_library = |index: usize| {
        let effects = &keys[index].effects;
        !effects.is_empty() && effects.iter().all(|of| of.kind.effect().is_some())
    };
    let truths = sealed.truths(&reports, of_library, closed_by_truth)?;
    let judgements: Vec<_> = keys
        .iter()
        .zip(&reports)
        .zip(truths)
        .map(|((key, report), truth)| {
            let report = report.as_ref().map_err(String::as_str);
            match ground.as_ref().and_then(|ground| ground.of_case(key.case)) {
                Some((own, apart)) => posed::judge(key, report, own, apart),
                None => judge(key, report, truth),
            }
        })
        .collect();
    let score = Score::of(SOFTWARE, sealed.seed, &manifest_sha256, &judgements);
    sealed.keep("judgements.json", &serde_json::to_vec_pretty(&judgements)?)?;
    sealed.keep("score.json", &serde_json::to_vec_pretty(&score)?)?;
    if context.json {
        print_json(&score)?
    } else {
        show(&score)?
    }
    Ok(outcome(&required, |name| score.rates.get(name).and_then(|rate| rate.share)))
}

/// Returns the recording on which effects are imposed, if one is given with its poses.
fn ground(context: &Context, args: &TrialArgs) -> anyhow::Result<Option<Ground>> {
    match (&args.on, &args.reference) {
        (Some(named), Some(reference)) => Ground::of(context, args, named, reference).map(Some),
        (Some(_), None) => {
            Err(usage("--on: with --motion the poses of the recording are needed: give --reference POSE"))
        }
        (None, _) => Ok(None),
    }
}

/// Returns the part that the true effects close: the same discrepancy under the model that has them.
fn closed_by_truth(report: &Value, truth: &Value) -> Option<f64> {
    let (before, floor) = (discrepancy(report, "after_parameters")?, discrepancy(report, "floor")?);
    let after = discrepancy(truth, "after_parameters")?;
    if discrepancy(report, "closed").is_none() {
        // If nothing was named, no number has the motion's gap, and the truth closes it. If something was named, there
        // was nothing to close.
        return report["causes"].as_array().is_none_or(Vec::is_empty).then_some(1.0);
    }
    (before > floor).then(|| (before - after) / (before - floor))
}

/// Runs one part of a trial for the calling process.
pub(super) fn run_part(args: &TrialPartArgs) -> anyhow::Result<Outcome> {
    if args.posed {
        return super::trial_posed::run_part(args);
    }
    let mut stdout = std::io::stdout().lock();
    if args.part == TrialPart::Diagnose {
        let mut bytes = Vec::new();
        std::io::stdin().lock().read_to_end(&mut bytes)?;
        let (recording, model, reference) = unpack(&bytes)?;
        drop(bytes);
        let options = Options { software: SOFTWARE, real: "sealed case", sim: "its model", ..Options::default() };
        let outcome = imu_diagnosis::diagnose_moved(&recording, &reference, &model, &options)?;
        serde_json::to_writer(&mut stdout, &outcome.diagnosis)?;
        return Ok(Outcome::Done);
    }
    let plans = plan(args.seed, args.cases, words(&args.kinds)).map_err(usage)?;
    let draw = |index: usize| -> anyhow::Result<Case> {
        let own = plans.get(index).with_context(|| format!("there is no case {index}"))?;
        Ok(Case::draw(args.seed, index, own, args.samples))
    };
    let keys = || (0..plans.len()).map(|index| Ok(draw(index)?.key())).collect::<anyhow::Result<Vec<Key>>>();
    match args.part {
        TrialPart::Manifest => {
            let digests = keys()?.iter().map(Key::digest).collect();
            serde_json::to_writer_pretty(&mut stdout, &Manifest::of_digests(digests))?;
        }
        TrialPart::Key => serde_json::to_writer_pretty(&mut stdout, &keys()?)?,
        TrialPart::Case => {
            let case = draw(args.case)?;
            stdout.write_all(&pack(&case, &case.model(false)?)?)?;
        }
        TrialPart::Truth => {
            let case = draw(args.case)?;
            let (recording, rows) = case.record();
            let reference = imu_diagnosis::Reference::new(rows)?;
            let options = Options::default();
            let outcome = imu_diagnosis::diagnose_moved(&recording, &reference, &case.model(true)?, &options)?;
            serde_json::to_writer(&mut stdout, &outcome.diagnosis)?;
        }
        TrialPart::Again | TrialPart::Own | TrialPart::Diagnose => {}
    }
    Ok(Outcome::Done)
}

fn show(score: &Score) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(stdout, "{} with a motion of seed {}", counted(score.cases as u64, "case", "cases"), score.seed)?;
    let mut rows = table(&["", "cases", "share (95 %)"]);
    for (name, meaning) in RATES {
        if let Some(rate) = score.rates.get(name).filter(|rate| rate.of > 0) {
            rows.add_row([meaning.to_owned(), format!("{} of {}", rate.count, rate.of), percent(*rate)]);
        }
    }
    writeln!(stdout, "{rows}")?;
    let mut rows = table(&["alone", "right", "from 3 limits", "unknown", "spurious", "intervals", "closed", "90 % at"]);
    for of in &score.kinds {
        let share = |rate: imu_trial::interval::Rate| format!("{}/{}", rate.count, rate.of);
        rows.add_row([
            of.kind.name().to_owned(),
            share(of.right_first),
            share(of.right_first_clear),
            share(of.unknown),
            share(of.spurious),
            share(of.held),
            of.closed.map_or_else(|| "–".to_owned(), |closed| format!("{closed:.3}")),
            of.size_90.map_or_else(|| "–".to_owned(), |limit| format!("{:.2}", limit.size)),
        ]);
    }
    writeln!(stdout, "{rows}")?;
    let mut rows = table(&["bound, median of the cases", "gyro", "accel"]);
    for of in &score.kinds {
        let bound = |triad: Triad| {
            let size = of.bounds.get(triad.name()).map(|size| format!("{} {}", page::size(*size), of.kind.unit(triad)));
            size.map_or_else(|| "–".to_owned(), |text| text.trim().to_owned())
        };
        rows.add_row([of.kind.name().to_owned(), bound(Triad::Gyro), bound(Triad::Accel)]);
    }
    writeln!(stdout, "{rows}")?;
    for miss in score.misses.iter().take(MISSES_SHOWN) {
        let has: Vec<String> = miss
            .kinds
            .iter()
            .zip(&miss.triads)
            .zip(&miss.over_limit)
            .map(|((kind, triad), size)| format!("{kind} of the {triad} at {size:.1}"))
            .collect();
        let has = if has.is_empty() { "nothing".to_owned() } else { has.join(" and ") };
        let named: Vec<String> = miss
            .causes
            .iter()
            .map(|cause| format!("{} ({})", cause.effect, cause.triad.as_deref().unwrap_or("several")))
            .collect();
        let named = if named.is_empty() { "nothing".to_owned() } else { named.join(", ") };
        writeln!(stdout, "case {}: {has}; {}, named {named}", miss.case, miss.verdict)?;
    }
    let more = score.misses.len().saturating_sub(MISSES_SHOWN);
    if more > 0 { writeln!(stdout, "and {more} more: --json or --out has them") } else { Ok(()) }
}
