//! The parts of a recording on which `vn100d trial --motion --on RECORDING --reference POSE` imposes effects: both halves,
//! diagnosed for what the sensor has by itself beside the poses, and kept in a folder for the processes that make cases.

use super::args::{TrialArgs, TrialPart, TrialPartArgs};
use super::reference::reference_text;
use super::sealed::{each, words};
use super::trial_on::{parcel_of, read, read_again, settled};
use super::{Context, Outcome, analysis, usage};
use crate::jobs::gridded;
use crate::store::SOFTWARE;
use anyhow::Context as _;
use imu_diagnosis::{Options, Recording};
use imu_model::simulator::SensorModel;
use imu_pose::{External, Unit};
use imu_trial::motion::Key;
use imu_trial::motion::kind::Planned;
use imu_trial::parcel::{self, Parcel};
use imu_trial::posed::{Case, Own, Part, plan};
use imu_trial::{Manifest, recorded};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

/// Number of parts of a recording.
const PARTS: usize = 2;

/// A recording beside poses, ready for cases.
pub(super) struct Ground {
    /// What each part shows of itself.
    pub owns: Vec<Own>,
    folder: tempfile::TempDir,
}

impl Ground {
    /// Cuts a capture or a file into halves and diagnoses each beside the poses.
    pub(super) fn of(context: &Context, args: &TrialArgs, named: &str, reference: &Path) -> anyhow::Result<Self> {
        let text = reference_text(reference)?;
        let poses = poses(&text).with_context(|| format!("--reference {}", reference.display()))?;
        let whole = {
            let together = analysis::open(context, &[named.to_owned()], args.rate)?;
            let mut whole = gridded(&together.source, &together.plan, u64::MAX)?.recording;
            // The parts keep their place on the recording's clock, which poses have.
            let begins_s = whole.begins_s.take().unwrap_or(0.0);
            whole.time_s.iter_mut().for_each(|time_s| *time_s += begins_s);
            whole
        };
        let half = whole.len() / PARTS;
        let folder = tempfile::tempdir().context("no temporary folder can be made")?;
        std::fs::write(reference_of(folder.path()), &text)?;
        let owns = each(PARTS, args.threads, "halves asked what they show of themselves", |number| {
            let recording = whole.part(number * half..(number + 1) * half);
            let (model, own) = of_itself(&recording, &poses)
                .with_context(|| format!("half {} of {named} cannot be used", number + 1))?;
            std::fs::write(own_of(folder.path(), number), serde_json::to_vec(&own)?)?;
            std::fs::write(parcel_of(folder.path(), number), parcel::pack(&recording, &model, false)?)?;
            Ok(own)
        })?;
        let ground = Self { owns, folder };
        // The words are checked before any case is made.
        plan(0, 1, words(&args.kinds), &ground.possible()).map_err(|error| usage(format!("--kinds: {error}")))?;
        Ok(ground)
    }

    /// Returns the folder, which exists as long as this value.
    pub(super) fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Returns what the part of a case shows, and what the other part shows.
    pub(super) fn of_case(&self, case: usize) -> Option<(&Own, Option<&Own>)> {
        let number = case % PARTS;
        Some((self.owns.get(number)?, self.owns.get((number + 1) % PARTS)))
    }

    fn possible(&self) -> Vec<Planned> {
        possible(&self.owns)
    }
}

/// Returns the effects that can be imposed on every part.
fn possible(owns: &[Own]) -> Vec<Planned> {
    let Some((first, rest)) = owns.split_first() else { return Vec::new() };
    let mut all = first.possible();
    all.retain(|one| rest.iter().all(|own| own.possible().contains(one)));
    all
}

/// Reads poses.
fn poses(text: &str) -> anyhow::Result<External> {
    match imu_pose::read(text, None)? {
        Some(poses @ External::Poses(_)) => Ok(poses),
        Some(External::Rates(_)) | None => {
            Err(usage("expected poses (docs/formats.md): effects are imposed beside these"))
        }
    }
}

/// Returns the model of what a part has of itself beside the poses, and what it shows.
fn of_itself(recording: &Recording, poses: &External) -> anyhow::Result<(SensorModel, Own)> {
    let (found, _) = imu_diagnosis::beside(recording, poses)?;
    let is_si = |unit: Unit| unit == Unit::Same;
    anyhow::ensure!(
        is_si(found.gyro.frames.unit) && found.accel.as_ref().is_none_or(|of| is_si(of.frames.unit)),
        "its values are in another unit than its columns state: correct that first"
    );
    let (model, report) = settled(recorded::first_model(recording), |model, options| {
        imu_diagnosis::diagnose_posed(recording, poses, model, options)
    })?;
    let named = report["causes"].as_array().cloned().unwrap_or_default();
    let verdict = report["verdict"].as_str().unwrap_or_default().to_owned();
    Ok((read_again(&model)?, Own::new(&found, verdict, named)))
}

/// Runs one part of a trial for the calling process.
pub(super) fn run_part(args: &TrialPartArgs) -> anyhow::Result<Outcome> {
    let mut stdout = std::io::stdout().lock();
    let Some(folder) = args.ground.as_deref() else {
        let (recording, model, poses) = unpacked()?;
        let options = Options { software: SOFTWARE, real: "sealed case", sim: "its model", ..Options::default() };
        let outcome = imu_diagnosis::diagnose_posed(&recording, &poses, &model, &options)?;
        serde_json::to_writer(&mut stdout, &outcome.diagnosis)?;
        return Ok(Outcome::Done);
    };
    let parts = (0..PARTS).map(|number| part(folder, number)).collect::<anyhow::Result<Vec<Part>>>()?;
    let owns: Vec<Own> = parts.iter().map(|part| part.own.clone()).collect();
    let plans = plan(args.seed, args.cases, words(&args.kinds), &possible(&owns)).map_err(usage)?;
    let case = |index: usize| -> anyhow::Result<Case<'_>> {
        let own = plans.get(index).with_context(|| format!("there is no case {index}"))?;
        Ok(Case::new(args.seed, index, own, &parts[index % PARTS]))
    };
    let keys = || (0..plans.len()).map(|index| Ok(case(index)?.key())).collect::<anyhow::Result<Vec<Key>>>();
    match args.part {
        TrialPart::Manifest => {
            let digests = keys()?.iter().map(Key::digest).collect();
            serde_json::to_writer_pretty(&mut stdout, &Manifest::of_digests(digests))?;
        }
        TrialPart::Key => serde_json::to_writer_pretty(&mut stdout, &keys()?)?,
        TrialPart::Case => {
            let parcel = parcel::pack(&case(args.case)?.record(), &parts[args.case % PARTS].model, false)?;
            stdout.write_all(&(parcel.len() as u64).to_le_bytes())?;
            stdout.write_all(&parcel)?;
            stdout.write_all(&read(&reference_of(folder))?)?;
        }
        TrialPart::Truth | TrialPart::Again | TrialPart::Own | TrialPart::Diagnose => {}
    }
    Ok(Outcome::Done)
}

/// Reads a case from standard input: the length of a parcel, the parcel, the text of the poses.
fn unpacked() -> anyhow::Result<(Recording, SensorModel, External)> {
    let mut bytes = Vec::new();
    std::io::stdin().lock().read_to_end(&mut bytes)?;
    let (length, rest) = bytes.split_first_chunk().context("the case is empty")?;
    let length = usize::try_from(u64::from_le_bytes(*length))?;
    let (parcel, text) = rest.split_at_checked(length).context("the case ends within its parcel")?;
    let Parcel { recording, model, .. } = parcel::unpack(parcel)?;
    Ok((recording, model, poses(std::str::from_utf8(text)?)?))
}

fn part(folder: &Path, number: usize) -> anyhow::Result<Part> {
    let Parcel { recording, model, .. } = parcel::unpack(&read(&parcel_of(folder, number))?)?;
    Ok(Part { recording, model, own: serde_json::from_slice(&read(&own_of(folder, number))?)? })
}

fn own_of(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("{number:05}.json"))
}

fn reference_of(folder: &Path) -> PathBuf {
    folder.join("reference.csv")
}
