//! `vn100d trial --motion`: the blind check of the diagnosis with a known motion.
//!
//! As [`super::trial`] does it: a process makes the cases from the sealed seed, another diagnoses what it is given, a manifest of
//! the keys' digests comes first and the keys last.

use super::args::{TrialArgs, TrialPart, TrialPartArgs};
use super::trial::{each, keep, read, usage, words};
use super::{Context, Outcome, print_json, table};
use crate::clock::{Clock as _, SystemClock};
use crate::diagnosis::{self, Options};
use crate::store::SOFTWARE;
use crate::trial::Manifest;
use crate::trial::motion::case::{SAMPLES_MIN, pack, unpack};
use crate::trial::motion::score::RATES;
use crate::trial::motion::{Case, Key, Score, judge, plan};
use crate::trial::page::percent;
use anyhow::Context as _;
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use std::io::{Read as _, Write as _};
use std::process::{Command, Stdio};

/// Misses that are listed on a terminal; JSON has all.
const MISSES_SHOWN: usize = 20;

/// A trial that another process makes.
struct Sealed<'a> {
    seed: u64,
    args: &'a TrialArgs,
}

/// Runs a trial and says what it came to.
pub(super) fn run(context: &Context, args: &TrialArgs) -> anyhow::Result<Outcome> {
    plan(0, 1, words(&args.kinds)).map_err(|error| usage(format!("--kinds: {error}")))?;
    if args.samples.is_some_and(|samples| samples < SAMPLES_MIN) {
        return Err(usage(format!("--samples: a case with a motion takes {SAMPLES_MIN} or more")));
    }
    let thresholds = thresholds(args)?;
    let seed = args.seed.unwrap_or_else(|| SystemClock.utc_ns().unsigned_abs() / 1_000_000);
    let sealed = Sealed { seed, args };
    if let Some(folder) = &args.out {
        let reports = folder.join("reports");
        std::fs::create_dir_all(&reports).with_context(|| format!("{} cannot be made", reports.display()))?;
    }
    let manifest_text = sealed.ask(TrialPart::Manifest, None)?;
    let manifest: Manifest = read(&manifest_text, "manifest")?;
    let manifest_sha256: String = Sha256::digest(&manifest_text).iter().map(|byte| format!("{byte:02x}")).collect();
    keep(args, "manifest.json", &manifest_text)?;
    let cases = manifest.digests.len();
    if cases == 0 {
        return Err(usage("--cases: there is no case".to_owned()));
    }
    eprintln!("{cases} cases of seed {seed}; their keys are sealed: the manifest's SHA-256 is {manifest_sha256}");
    let reports = each(cases, args.threads, "cases diagnosed", |index| {
        let text = sealed.diagnosed(index)?;
        if let Ok(text) = &text {
            keep(args, &format!("reports/{index:05}.json"), text)?;
        }
        Ok(text.and_then(|text| serde_json::from_slice::<Value>(&text).map_err(|error| error.to_string())))
    })?;
    let keys_text = sealed.ask(TrialPart::Key, None)?;
    let keys: Vec<Key> = read(&keys_text, "keys")?;
    manifest.verify_digests(keys.iter().map(|key| (key.case, key.digest())).collect())?;
    keep(args, "key.json", &keys_text)?;
    let truths = if args.truth { sealed.truths(&keys, &reports)? } else { vec![None; cases] };
    let judgements: Vec<_> = keys
        .iter()
        .zip(&reports)
        .zip(truths)
        .map(|((key, report), truth)| judge(key, report.as_ref().map_err(String::as_str), truth))
        .collect();
    let score = Score::of(SOFTWARE, seed, &manifest_sha256, &judgements);
    keep(args, "judgements.json", &serde_json::to_vec_pretty(&judgements)?)?;
    keep(args, "score.json", &serde_json::to_vec_pretty(&score)?)?;
    if context.json {
        print_json(&score)?
    } else {
        show(&score)?
    }
    let mut outcome = Outcome::Done;
    for (name, share, at_least) in thresholds {
        let found = score.rates.get(name.as_str()).and_then(|rate| rate.share);
        if !found.is_some_and(|found| if at_least { found >= share } else { found <= share }) {
            let found = found.map_or_else(|| "of no case".to_owned(), |found| found.to_string());
            eprintln!("{name} is {found}; {} {share} was asked for", if at_least { "at least" } else { "at most" });
            outcome = Outcome::WithLoss;
        }
    }
    Ok(outcome)
}

/// Runs one part of a trial, for the process that asked.
pub(super) fn run_part(args: &TrialPartArgs) -> anyhow::Result<Outcome> {
    let mut stdout = std::io::stdout().lock();
    if args.part == TrialPart::Diagnose {
        let mut bytes = Vec::new();
        std::io::stdin().lock().read_to_end(&mut bytes)?;
        let (recording, model, reference) = unpack(&bytes)?;
        drop(bytes);
        let options = Options { software: SOFTWARE, real: "sealed case", sim: "its model", ..Options::default() };
        let outcome = diagnosis::diagnose_moved(&recording, &reference, &model, &options)?;
        serde_json::to_writer(&mut stdout, &outcome.diagnosis)?;
        return Ok(Outcome::Done);
    }
    let wishes = plan(args.seed, args.cases, words(&args.kinds)).map_err(usage)?;
    let draw = |index: usize| -> anyhow::Result<Case> {
        let own = wishes.get(index).with_context(|| format!("there is no case {index}"))?;
        Ok(Case::draw(args.seed, index, own, args.samples))
    };
    let keys = || (0..wishes.len()).map(|index| Ok(draw(index)?.key())).collect::<anyhow::Result<Vec<Key>>>();
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
            let reference = diagnosis::Reference::new(rows)?;
            let options = Options::default();
            let outcome = diagnosis::diagnose_moved(&recording, &reference, &case.model(true)?, &options)?;
            serde_json::to_writer(&mut stdout, &outcome.diagnosis)?;
        }
        TrialPart::Own | TrialPart::Diagnose => {}
    }
    Ok(Outcome::Done)
}

impl Sealed<'_> {
    fn command(&self, part: TrialPart, case: Option<usize>) -> anyhow::Result<Command> {
        let program = std::env::current_exe().context("the program does not find itself")?;
        let mut command = Command::new(program);
        command.args(["trial-part", part.name(), "--motion"]);
        if part != TrialPart::Diagnose {
            command.args(["--seed", &self.seed.to_string(), "--cases", &self.args.cases.to_string()]);
            command.args(["--kinds", &self.args.kinds]);
            if let Some(samples) = self.args.samples {
                command.args(["--samples", &samples.to_string()]);
            }
        }
        if let Some(case) = case {
            command.args(["--case", &case.to_string()]);
        }
        Ok(command)
    }

    /// What a part writes.
    fn ask(&self, part: TrialPart, case: Option<usize>) -> anyhow::Result<Vec<u8>> {
        let output = self.command(part, case)?.stdin(Stdio::null()).output()?;
        let said = || String::from_utf8_lossy(&output.stderr).trim().to_owned();
        anyhow::ensure!(output.status.success(), "the trial's {} failed: {}", part.name(), said());
        Ok(output.stdout)
    }

    /// The diagnosis of a case, or why there is none.
    fn diagnosed(&self, case: usize) -> anyhow::Result<Result<Vec<u8>, String>> {
        let mut maker =
            self.command(TrialPart::Case, Some(case))?.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
        let parcel = maker.stdout.take().context("the maker has no output")?;
        let output = self.command(TrialPart::Diagnose, None)?.stdin(parcel).output()?;
        let made = maker.wait()?;
        anyhow::ensure!(made.success(), "case {case} could not be made");
        if output.status.success() {
            return Ok(Ok(output.stdout));
        }
        let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        Ok(Err(if said.is_empty() { format!("the diagnosis ended with {}", output.status) } else { said }))
    }

    /// What the true effects close of each case's gap: the same discrepancy under the model that has them.
    fn truths(&self, keys: &[Key], reports: &[Result<Value, String>]) -> anyhow::Result<Vec<Option<f64>>> {
        each(keys.len(), self.args.threads, "cases scored with the truth", |index| {
            let of_library = keys[index].effects.iter().all(|of| of.kind.effect().is_some());
            let told = reports[index].as_ref().ok().filter(|_| of_library && !keys[index].effects.is_empty());
            let Some(report) = told else { return Ok(None) };
            let Ok(truth) = self.ask(TrialPart::Truth, Some(index)) else { return Ok(None) };
            let truth: Value = read(&truth, "diagnosis")?;
            let number = |value: &Value, name: &str| value["discrepancy"][name].as_f64();
            let closed = || {
                let (before, floor) = (number(report, "after_parameters")?, number(report, "floor")?);
                let after = number(&truth, "after_parameters")?;
                // Where nothing was named the motion's gap is in no number: the truth closes it.
                let Some(_) = number(report, "closed") else { return Some(1.0) };
                (before > floor).then(|| (before - after) / (before - floor))
            };
            Ok(closed())
        })
    }
}

fn thresholds(args: &TrialArgs) -> anyhow::Result<Vec<(String, f64, bool)>> {
    let of = |(text, at_least): (&String, bool)| {
        let (name, share) = text.split_once('=').unwrap_or((text, ""));
        let share = share.parse().ok().filter(|share| (0.0..=1.0).contains(share));
        match share.filter(|_| RATES.iter().any(|(own, _)| *own == name)) {
            Some(share) => Ok((name.to_owned(), share, at_least)),
            None => {
                let names: Vec<&str> = RATES.iter().map(|(name, _)| *name).collect();
                Err(usage(format!("`{text}`: expected NAME=SHARE, NAME one of {}", names.join(", "))))
            }
        }
    };
    let least = args.at_least.iter().map(|text| (text, true));
    least.chain(args.at_most.iter().map(|text| (text, false))).map(of).collect()
}

fn show(score: &Score) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(stdout, "{} cases with a motion of seed {}", score.cases, score.seed)?;
    let mut rows = table(&["", "cases", "share (95 %)"]);
    for (name, meaning) in RATES {
        if let Some(rate) = score.rates.get(name) {
            rows.add_row([meaning.to_owned(), format!("{} of {}", rate.count, rate.of), percent(*rate)]);
        }
    }
    writeln!(stdout, "{rows}")?;
    let mut rows = table(&["alone", "right", "from 3 limits", "unknown", "spurious", "intervals", "closed", "90 % at"]);
    for of in &score.kinds {
        let share = |rate: crate::trial::interval::Rate| format!("{}/{}", rate.count, rate.of);
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
