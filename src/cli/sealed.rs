//! A sealed trial: the processes that make cases and diagnose them, the folder that keeps their output, and the
//! required rates. Both stationary trials and those with a motion run here.

use super::args::{TrialArgs, TrialPart};
use super::figures::counted;
use super::limits::Limit;
use super::progress::bar;
use super::{Outcome, usage};
use crate::clock::{Clock as _, SystemClock};
use anyhow::Context as _;
use imu_trial::Manifest;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// A trial in which other processes make and diagnose the cases.
pub(super) struct Sealed<'a> {
    pub(super) seed: u64,
    args: &'a TrialArgs,
    /// Number, kinds and length of the cases.
    shape: Shape<'a>,
    /// The folder in which corrected models are kept for a second test, if they are.
    corrected: Option<tempfile::TempDir>,
    /// The folder of the recording on which effects are imposed.
    ground: Option<&'a Path>,
}

/// The cases of a trial.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape<'a> {
    /// Number of cases.
    pub(super) cases: usize,
    /// The seed, if one is given.
    pub(super) seed: Option<u64>,
    /// The words for their kinds.
    pub(super) kinds: &'a str,
    /// Number of samples per case, if given.
    pub(super) samples: Option<usize>,
}

impl<'a> Shape<'a> {
    /// Creates the shape that the arguments describe.
    pub(super) fn of(args: &'a TrialArgs) -> Self {
        Self { cases: args.cases, seed: args.seed, kinds: &args.kinds, samples: args.samples }
    }
}

impl<'a> Sealed<'a> {
    /// Starts a trial with the given seed or the time, and makes its folder.
    pub(super) fn new(args: &'a TrialArgs, shape: Shape<'a>, ground: Option<&'a Path>) -> anyhow::Result<Self> {
        if let Some(folder) = &args.out {
            let reports = folder.join("reports");
            std::fs::create_dir_all(&reports).with_context(|| format!("{} cannot be made", reports.display()))?;
        }
        let seed = shape.seed.unwrap_or_else(|| SystemClock.utc_ns().unsigned_abs() / 1_000_000);
        let corrected = args.again.then(tempfile::tempdir).transpose().context("no temporary folder can be made")?;
        Ok(Self { seed, args, shape, corrected, ground })
    }

    /// Returns the manifest and its SHA-256, after printing and storing them; `empty` is the manifest of no case.
    pub(super) fn manifest(&self, empty: impl FnOnce() -> String) -> anyhow::Result<(Manifest, String)> {
        let text = self.ask(TrialPart::Manifest, None)?;
        let manifest: Manifest = read(&text, "manifest")?;
        let sha256: String = Sha256::digest(&text).iter().map(|byte| format!("{byte:02x}")).collect();
        self.keep("manifest.json", &text)?;
        let cases = manifest.digests.len();
        if cases == 0 {
            return Err(usage(empty()));
        }
        let cases = counted(cases as u64, "case", "cases");
        eprintln!("{cases} of seed {}; the keys are sealed: the manifest's SHA-256 is {sha256}", self.seed);
        Ok((manifest, sha256))
    }

    /// Returns every case's diagnosis, or why there is none.
    pub(super) fn reports(&self, cases: usize) -> anyhow::Result<Vec<Result<Value, String>>> {
        self.each(cases, "cases diagnosed", |index| {
            let text = self.diagnosed(TrialPart::Case, index)?;
            if let Ok(text) = &text {
                self.keep(&format!("reports/{index:05}.json"), text)?;
            }
            Ok(text.and_then(|text| serde_json::from_slice::<Value>(&text).map_err(|error| error.to_string())))
        })
    }

    /// Returns and stores the keys once they agree with the manifest.
    pub(super) fn keys<Key: DeserializeOwned>(
        &self,
        verify: impl FnOnce(&[Key]) -> anyhow::Result<()>,
    ) -> anyhow::Result<Vec<Key>> {
        let text = self.ask(TrialPart::Key, None)?;
        let keys: Vec<Key> = read(&text, "keys")?;
        verify(&keys)?;
        self.keep("key.json", &text)?;
        Ok(keys)
    }

    /// Returns how much the true effects close of each case's gap, if requested and if `of_library` reports that a
    /// model can have them: the `closed` of the case's diagnosis and of that under the model that has them.
    pub(super) fn truths(
        &self,
        reports: &[Result<Value, String>],
        of_library: impl Fn(usize) -> bool + Sync,
        closed: impl Fn(&Value, &Value) -> Option<f64> + Sync,
    ) -> anyhow::Result<Vec<Option<f64>>> {
        if !self.args.truth {
            return Ok(vec![None; reports.len()]);
        }
        self.each(reports.len(), "cases scored with the truth", |index| {
            let Some(report) = reports[index].as_ref().ok().filter(|_| of_library(index)) else { return Ok(None) };
            let Ok(truth) = self.ask(TrialPart::Truth, Some(index)) else { return Ok(None) };
            Ok(closed(report, &read(&truth, "diagnosis")?))
        })
    }

    /// Applies a function to every case on the requested number of threads.
    pub(super) fn each<T: Send>(
        &self,
        cases: usize,
        what: &'static str,
        work: impl Fn(usize) -> anyhow::Result<T> + Sync,
    ) -> anyhow::Result<Vec<T>> {
        each(cases, self.args.threads, what, work)
    }

    /// Returns the diagnosis of a case, or why there is none: if the program dies on a case, only that case fails.
    pub(super) fn diagnosed(&self, part: TrialPart, case: usize) -> anyhow::Result<Result<Vec<u8>, String>> {
        let mut maker = self.command(part, Some(case))?.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
        let parcel = maker.stdout.take().context("the maker has no output")?;
        let mut diagnose = self.command(TrialPart::Diagnose, None)?;
        if let Some(path) = self.corrected(case).filter(|_| part == TrialPart::Case) {
            diagnose.arg("--corrected").arg(path);
        }
        let output = diagnose.stdin(parcel).output()?;
        let made = maker.wait()?;
        anyhow::ensure!(made.success(), "case {case} could not be made");
        if output.status.success() {
            return Ok(Ok(output.stdout));
        }
        let stderr = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        Ok(Err(if stderr.is_empty() { format!("the diagnosis ended with {}", output.status) } else { stderr }))
    }

    /// Returns the file of a case's corrected model, if those are kept.
    fn corrected(&self, case: usize) -> Option<PathBuf> {
        Some(self.corrected.as_ref()?.path().join(format!("{case:05}.json")))
    }

    /// Returns the results of every case on other data, if requested and if `has_gap` holds.
    pub(super) fn again<T: Send>(
        &self,
        cases: usize,
        has_gap: impl Fn(usize) -> bool + Sync,
        of: impl Fn(usize, &[u8]) -> anyhow::Result<T> + Sync,
    ) -> anyhow::Result<Vec<Option<T>>> {
        self.each(cases, "cases tried again", |case| {
            let Some(path) = self.corrected(case).filter(|path| has_gap(case) && path.exists()) else {
                return Ok(None);
            };
            let output = self.command(TrialPart::Again, Some(case))?.arg("--corrected").arg(path).output()?;
            let stderr = || String::from_utf8_lossy(&output.stderr).trim().to_owned();
            anyhow::ensure!(output.status.success(), "case {case} could not be tried again: {}", stderr());
            self.keep(&format!("reports/{case:05}-again.json"), &output.stdout)?;
            of(case, &output.stdout).map(Some)
        })
    }

    /// Writes a file of the trial's folder, if it has one.
    pub(super) fn keep(&self, name: &str, text: &[u8]) -> anyhow::Result<()> {
        self.args.out.as_ref().map_or(Ok(()), |folder| write(&folder.join(name), text))
    }

    fn command(&self, part: TrialPart, case: Option<usize>) -> anyhow::Result<Command> {
        let program = std::env::current_exe().context("the program does not find itself")?;
        let mut command = Command::new(program);
        command.args(["trial-part", part.into()]);
        if self.args.motion {
            command.arg("--motion");
        }
        if self.args.reference.is_some() {
            command.arg("--posed");
        }
        if part != TrialPart::Diagnose {
            command.args(["--seed", &self.seed.to_string(), "--cases", &self.shape.cases.to_string()]);
            command.args(["--kinds", self.shape.kinds]);
            if let Some(samples) = self.shape.samples {
                command.args(["--samples", &samples.to_string()]);
            }
            if let Some(ground) = self.ground {
                command.arg("--ground").arg(ground);
            }
        }
        if let Some(case) = case {
            command.args(["--case", &case.to_string()]);
        }
        Ok(command)
    }

    /// Returns the output of a part.
    fn ask(&self, part: TrialPart, case: Option<usize>) -> anyhow::Result<Vec<u8>> {
        let output = self.command(part, case)?.stdin(Stdio::null()).output()?;
        let stderr = || String::from_utf8_lossy(&output.stderr).trim().to_owned();
        anyhow::ensure!(output.status.success(), "the trial's {part} failed: {}", stderr());
        Ok(output.stdout)
    }
}

/// Returns a discrepancy of a diagnosis, nats per sample.
pub(super) fn discrepancy(diagnosis: &Value, name: &str) -> Option<f64> {
    diagnosis["discrepancy"][name].as_f64()
}

/// Returns the required rates of the arguments; each must have one of these names.
pub(super) fn thresholds(args: &TrialArgs, names: &[&str]) -> anyhow::Result<Vec<Limit>> {
    let known: Vec<(&str, f64)> = names.iter().map(|name| (*name, 1.0)).collect();
    Limit::all(&args.at_least, &args.at_most, &known)
}

/// Reports which thresholds the rates miss. A rate over no case misses every threshold.
pub(super) fn outcome(thresholds: &[Limit], rate: impl Fn(&str) -> Option<f64>) -> Outcome {
    let mut outcome = Outcome::Done;
    for one in thresholds {
        let share = rate(&one.name);
        if !share.is_some_and(|share| one.holds(share)) {
            let found = share.map_or_else(|| "of no case".to_owned(), |share| share.to_string());
            eprintln!("{} is {found}; {} {} was asked for", one.name, one.bound.words(), one.number);
            outcome = Outcome::WithLoss;
        }
    }
    outcome
}

/// Applies a function to every case on several threads, in any order.
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
                        // A resource that one case cannot get, such as a process, the next cases cannot get either.
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

pub(super) fn write(path: &Path, text: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}
