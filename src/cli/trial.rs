//! `vn100d trial`: the blind check of the diagnosis.
//!
//! The program runs itself: one process makes a case from the sealed seed and writes recording and model to its standard output,
//! another reads them there and writes its diagnosis. Neither says or hears what the case has. The manifest with the digests of
//! all keys is made first; the keys are asked for when the last diagnosis is there, and have to fit it.

use super::args::{TrialArgs, TrialPart, TrialPartArgs};
use super::progress::bar;
use super::trial_on::Ground;
use super::{CliError, Context, Failure, Outcome, print_json, table, trial_on};
use crate::clock::{Clock as _, SystemClock};
use crate::diagnosis::{self, Options};
use crate::store::SOFTWARE;
use crate::trial::impose::SAMPLES_MIN;
use crate::trial::page::{limit, page, percent, size};
use crate::trial::{Answer, Case, Class, Key, Kind, Manifest, Report, Score, Wanted, case, judge, parcel, plan};
use anyhow::Context as _;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Misses that are listed on a terminal; JSON and page have all.
const MISSES_SHOWN: usize = 12;

/// A trial that another process makes.
struct Sealed {
    seed: u64,
    cases: usize,
    kinds: String,
    samples: Option<usize>,
    /// The recording that effects are imposed on.
    ground: Option<Ground>,
}

/// Runs a trial and says what it came to.
pub(super) fn run(context: &Context, args: &TrialArgs) -> anyhow::Result<Outcome> {
    if args.motion {
        return super::trial_motion::run(context, args);
    }
    Wanted::from_words(words(&args.kinds)).map_err(|error| usage(format!("--kinds: {error}")))?;
    let thresholds = thresholds(args)?;
    if args.samples.is_some_and(|samples| samples < SAMPLES_MIN) {
        return Err(usage(format!("--samples: a case takes {SAMPLES_MIN} or more")));
    }
    let seed = args.seed.unwrap_or_else(|| SystemClock.utc_ns().unsigned_abs() / 1_000_000);
    let ground = args.on.as_ref().map(|named| Ground::of(context, args, named)).transpose()?;
    let sealed = Sealed { seed, cases: args.cases, kinds: args.kinds.clone(), samples: args.samples, ground };
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
        let possible = sealed.ground.as_ref().map_or_else(String::new, |ground| {
            let kinds: Vec<&str> = ground.survey.kinds.iter().map(|kind| kind.name()).collect();
            format!("; what can be imposed on every stretch of {} is {}", ground.name, kinds.join(", "))
        });
        return Err(usage(format!("--kinds and --cases: there is no such case{possible}")));
    }
    eprintln!("{cases} cases of seed {seed}; their keys are sealed: the manifest's SHA-256 is {manifest_sha256}");

    let reports = each(cases, args.threads, "cases diagnosed", |index| {
        let text = sealed.diagnosed(TrialPart::Case, index)?;
        if let Ok(text) = &text {
            keep(args, &format!("reports/{index:05}.json"), text)?;
        }
        Ok(text.and_then(|text| serde_json::from_slice::<Value>(&text).map_err(|error| error.to_string())))
    })?;
    let owns = match &sealed.ground {
        None => vec![None; cases],
        Some(_) => each(cases, args.threads, "cases diagnosed as they are", |index| {
            let Ok(text) = sealed.diagnosed(TrialPart::Own, index)? else { return Ok(None) };
            keep(args, &format!("reports/{index:05}-own.json"), &text)?;
            Ok(Some(Report::of(&read(&text, "diagnosis")?)?))
        })?,
    };

    let keys_text = sealed.ask(TrialPart::Key, None)?;
    let keys: Vec<Key> = read(&keys_text, "keys")?;
    manifest.verify(&keys)?;
    keep(args, "key.json", &keys_text)?;

    let truths = if args.truth { sealed.truths(&keys, &reports, args.threads)? } else { vec![None; cases] };
    let mut answers = Vec::with_capacity(cases);
    for ((report, own), closed_by_truth) in reports.into_iter().zip(owns).zip(truths) {
        let report = report.and_then(|value| Report::of(&value).map_err(|error| error.to_string()));
        answers.push(Answer { report, own, closed_by_truth });
    }
    let judgements: Vec<_> = keys.iter().zip(&answers).map(|(key, answer)| judge(key, answer)).collect();
    let score = Score::of(SOFTWARE, seed, &manifest_sha256, &judgements);
    let score = match &sealed.ground {
        Some(ground) => score.on(&ground.name, ground.survey.stretches, &judgements),
        None => score,
    };
    keep(args, "judgements.json", &serde_json::to_vec_pretty(&judgements)?)?;
    keep(args, "score.json", &serde_json::to_vec_pretty(&score)?)?;
    if let Some(path) = &args.html {
        write(path, page(&score).as_bytes())?;
    }
    if context.json {
        print_json(&score)?
    } else {
        show(&score)?
    }
    let mut outcome = Outcome::Done;
    for threshold in thresholds {
        if let Some(found) = threshold.missed_by(&score) {
            eprintln!("{found}");
            outcome = Outcome::WithLoss;
        }
    }
    Ok(outcome)
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

impl Sealed {
    fn command(&self, part: TrialPart, case: Option<usize>) -> anyhow::Result<Command> {
        let program = std::env::current_exe().context("the program does not find itself")?;
        let mut command = Command::new(program);
        command.args(["trial-part", part.name()]);
        if part != TrialPart::Diagnose {
            command.args(["--seed", &self.seed.to_string(), "--cases", &self.cases.to_string()]);
            command.args(["--kinds", &self.kinds]);
            if let Some(samples) = self.samples {
                command.args(["--samples", &samples.to_string()]);
            }
            if let Some(ground) = &self.ground {
                command.arg("--ground").arg(ground.folder());
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

    /// The diagnosis of a case, or why there is none: a program that dies on one case has failed that one.
    fn diagnosed(&self, part: TrialPart, case: usize) -> anyhow::Result<Result<Vec<u8>, String>> {
        let mut maker = self.command(part, Some(case))?.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
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
    fn truths(
        &self,
        keys: &[Key],
        reports: &[Result<Value, String>],
        threads: usize,
    ) -> anyhow::Result<Vec<Option<f64>>> {
        each(keys.len(), threads, "cases scored with the truth", |index| {
            let of_library = matches!(keys[index].class, Class::Single | Class::Pair);
            let Some(report) = reports[index].as_ref().ok().filter(|_| of_library) else { return Ok(None) };
            let Ok(truth) = self.ask(TrialPart::Truth, Some(index)) else { return Ok(None) };
            let truth: Value = read(&truth, "diagnosis")?;
            let number = |value: &Value, name: &str| value["discrepancy"][name].as_f64();
            let closed = || {
                let (before, floor) = (number(report, "after_parameters")?, number(report, "floor")?);
                // The true model's parameters are true: refitting them cannot do better but by chance, and may do worse.
                let after = number(&truth, "after_parameters")?.min(number(&truth, "before")?);
                // Where nothing was there to close, no part of it is.
                number(report, "closed").filter(|_| before > floor).map(|_| (before - after) / (before - floor))
            };
            Ok(closed())
        })
    }
}

/// Does something with every case on several threads, in any order.
pub(super) fn each<T: Send>(
    cases: usize,
    threads: usize,
    what: &'static str,
    work: impl Fn(usize) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    let bar = bar("{bar:30} {pos} of {len} {msg} · {eta} left", cases as u64).with_message(what);
    let next = AtomicUsize::new(0);
    let done: Vec<Mutex<Option<anyhow::Result<T>>>> = (0..cases).map(|_| Mutex::new(None)).collect();
    std::thread::scope(|scope| {
        for _ in 0..threads.clamp(1, cases.max(1)) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(place) = done.get(index) else { break };
                    let result = work(index);
                    if result.is_err() {
                        // What one case cannot have, such as a process, the next ones cannot either.
                        next.store(cases, Ordering::Relaxed);
                    }
                    *place.lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
                    bar.inc(1);
                }
            });
        }
    });
    bar.finish_and_clear();
    let results: Vec<_> =
        done.into_iter().filter_map(|place| place.into_inner().unwrap_or_else(PoisonError::into_inner)).collect();
    results.into_iter().collect()
}

pub(super) fn words(kinds: &str) -> impl Iterator<Item = &str> {
    kinds.split(',').map(str::trim).filter(|word| !word.is_empty())
}

pub(super) fn read<T: DeserializeOwned>(text: &[u8], what: &str) -> anyhow::Result<T> {
    serde_json::from_slice(text).with_context(|| format!("the trial's {what} cannot be read"))
}

/// Writes a file of the trial's folder, if it has one.
pub(super) fn keep(args: &TrialArgs, name: &str, text: &[u8]) -> anyhow::Result<()> {
    args.out.as_ref().map_or(Ok(()), |folder| write(&folder.join(name), text))
}

fn write(path: &Path, text: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}

pub(super) fn usage(message: String) -> anyhow::Error {
    CliError { failure: Failure::Usage, message }.into()
}

/// A rate that is asked for.
struct Threshold {
    name: String,
    share: f64,
    at_least: bool,
}

impl Threshold {
    /// What to say where the score does not reach it. A rate of no case reaches nothing.
    fn missed_by(&self, score: &Score) -> Option<String> {
        let share = score.rate(&self.name).and_then(|rate| rate.share);
        let word = if self.at_least { "at least" } else { "at most" };
        let reached = share.is_some_and(|share| if self.at_least { share >= self.share } else { share <= self.share });
        let found = share.map_or_else(|| "of no case".to_owned(), |share| share.to_string());
        (!reached).then(|| format!("{} is {found}; {word} {} was asked for", self.name, self.share))
    }
}

fn thresholds(args: &TrialArgs) -> anyhow::Result<Vec<Threshold>> {
    let names = Score::of("", 0, "", &[]).named_rates().map(|(name, ..)| name);
    let of = |(text, at_least): (&String, bool)| {
        let (name, share) = text.split_once('=').unwrap_or((text, ""));
        let share = share.parse().ok().filter(|share| (0.0..=1.0).contains(share));
        match share.filter(|_| names.contains(&name)) {
            Some(share) => Ok(Threshold { name: name.to_owned(), share, at_least }),
            None => Err(usage(format!("`{text}`: expected NAME=SHARE, NAME one of {}", names.join(", ")))),
        }
    };
    let least = args.at_least.iter().map(|text| (text, true));
    least.chain(args.at_most.iter().map(|text| (text, false))).map(of).collect()
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
