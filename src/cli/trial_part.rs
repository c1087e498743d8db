//! Parts of a trial, each in a separate process started by the trial: cases, their diagnoses, keys.

use super::args::{TrialPart, TrialPartArgs};
use super::sealed::words;
use super::{Context, Outcome, analysis, trial_on};
use crate::jobs::gridded;
use crate::store::SOFTWARE;
use anyhow::Context as _;
use imu_diagnosis::{Diagnosis, Options, Recording};
use imu_model::simulator::SensorModel;
use imu_trial::again::{Diagnoses, simulated};
use imu_trial::parcel::Parcel;
use imu_trial::{Case, Key, Manifest, Wanted, case, parcel, plan};
use serde_json::Value;
use std::io::{Read as _, Write as _};

/// Runs one part of a trial for the calling process.
pub(super) fn run(context: &Context, args: &TrialPartArgs) -> anyhow::Result<Outcome> {
    if args.motion {
        return super::trial_motion::run_part(args);
    }
    let mut stdout = std::io::stdout().lock();
    if args.part == TrialPart::Diagnose {
        let mut bytes = Vec::new();
        std::io::stdin().lock().read_to_end(&mut bytes)?;
        let parcel = parcel::unpack(&bytes)?;
        drop(bytes);
        let (diagnosis, corrected) = diagnosed(context, &parcel)?;
        if let Some(path) = &args.corrected {
            super::sealed::write(path, &serde_json::to_vec(&corrected)?)?;
        }
        serde_json::to_writer(&mut stdout, &diagnosis)?;
        return Ok(Outcome::Done);
    }
    let survey = args.ground.as_deref().map(trial_on::survey).transpose()?;
    let mut wanted = Wanted::from_words(words(&args.kinds))?;
    if let Some(survey) = &survey {
        wanted.kinds.retain(|kind| survey.kinds.contains(kind));
    }
    let recipes = plan(args.seed, args.cases, &wanted);
    let draw = |index: usize| -> anyhow::Result<Case> {
        let recipe = recipes.get(index).with_context(|| format!("there is no case {index}"))?;
        Ok(match (&args.ground, &survey) {
            (Some(folder), Some(survey)) => {
                let stretch = trial_on::stretch(folder, index % survey.stretches.max(1))?;
                Case::draw_on(args.seed, index, recipe, stretch)?
            }
            _ => Case::make(args.seed, index, recipe, args.samples)?,
        })
    };
    let keys = || (0..recipes.len()).map(|index| Ok(draw(index)?.key())).collect::<anyhow::Result<Vec<Key>>>();
    match args.part {
        TrialPart::Manifest => serde_json::to_writer_pretty(&mut stdout, &Manifest::of(&keys()?))?,
        TrialPart::Key => serde_json::to_writer_pretty(&mut stdout, &keys()?)?,
        TrialPart::Case => {
            let case = draw(args.case)?;
            stdout.write_all(&parcel::pack(&case.record(), &case.model(), case.is_table())?)?;
        }
        TrialPart::Own => {
            let (recording, model) = draw(args.case)?.as_it_is().context("nobody recorded the case")?;
            stdout.write_all(&parcel::pack(&recording, &model, false)?)?;
        }
        TrialPart::Truth => {
            let case = draw(args.case)?;
            let model = case::true_model(&case.key(), &case.model()).context("no model can say what the case has")?;
            let parcel = Parcel { recording: case.record(), model, table: case.is_table() };
            serde_json::to_writer(&mut stdout, &diagnosed(context, &parcel)?.0)?;
        }
        TrialPart::Again => {
            let path = args.corrected.as_ref().context("no corrected model is given: add --corrected FILE")?;
            let corrected: Value = serde_json::from_slice(&std::fs::read(path)?)?;
            let corrected = SensorModel::from_value(&corrected, "the corrected model")?;
            serde_json::to_writer(&mut stdout, &again(context, draw(args.case)?, corrected, args)?)?;
        }
        TrialPart::Diagnose => {}
    }
    Ok(Outcome::Done)
}

/// Returns a diagnosis and the corrected model; a table is written and read as one.
fn diagnosed(context: &Context, parcel: &Parcel) -> anyhow::Result<(Diagnosis, SensorModel)> {
    let options = Options { software: SOFTWARE, real: "sealed case", sim: "its model", ..Options::default() };
    if !parcel.table {
        let outcome = imu_diagnosis::diagnose(&parcel.recording, &parcel.model, &options)?;
        return Ok((outcome.diagnosis, outcome.augmented));
    }
    let folder = tempfile::tempdir().context("no temporary folder can be made")?;
    let file = folder.path().join("case.csv");
    super::sealed::write(&file, parcel::table(&parcel.recording).as_bytes())?;
    let together = analysis::open(context, &[file.display().to_string()], None)?;
    let gridded = gridded(&together.source, &together.plan, u64::MAX)?;
    let mut outcome = imu_diagnosis::diagnose(&gridded.recording, &parcel.model, &options)?;
    gridded.adjust(&mut outcome.diagnosis);
    Ok((outcome.diagnosis, outcome.augmented))
}

/// Returns diagnoses of a second record and of a simulation of the corrected model.
fn again(context: &Context, case: Case, corrected: SensorModel, args: &TrialPartArgs) -> anyhow::Result<Diagnoses> {
    // A seed that differs from any other simulation of this case; its value does not matter.
    let seed = args.seed.wrapping_mul(1_000_003).wrapping_add(args.case as u64);
    let plain = case.model();
    let of = |recording: &Recording, model: &SensorModel, table: bool| -> Result<Value, String> {
        let parcel = Parcel { recording: recording.clone(), model: model.clone(), table };
        let (diagnosis, _) = diagnosed(context, &parcel).map_err(|error| error.to_string())?;
        serde_json::to_value(&diagnosis).map_err(|error| error.to_string())
    };
    let first = case.record();
    let table = case.is_table();
    let second = case.again().map(|case| case.record());
    let made = simulated(&corrected, &first, seed).map_err(|error| error.to_string());
    let of_made = |model: &SensorModel| made.as_ref().map_err(Clone::clone).and_then(|made| of(made, model, false));
    Ok(Diagnoses {
        second: second.as_ref().map(|second| of(second, &plain, table)),
        second_corrected: second.as_ref().map(|second| of(second, &corrected, table)),
        itself: of_made(&corrected),
        returns: of_made(&plain),
    })
}
