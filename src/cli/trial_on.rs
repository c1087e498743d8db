//! The stretches of a recording on which a trial imposes effects: diagnosed for their own effects, and kept in a folder
//! for the processes that make cases.

use super::args::TrialArgs;
use super::sealed::each;
use super::{Context, analysis, usage};
use crate::jobs::gridded;
use anyhow::Context as _;
use imu_diagnosis::{Options, Recording};
use imu_model::simulator::SensorModel;
use imu_trial::limit::STUDY;
use imu_trial::parcel::Parcel;
use imu_trial::{Kind, Report, Stretch, Survey, parcel, recorded};
use std::path::{Path, PathBuf};

/// Minimum number of samples in half a stretch for a diagnosis under the model of the other half.
const HALF_MIN: usize = 4_000;
/// Maximum number of diagnoses of a stretch for its remaining effects.
const ROUNDS: usize = 3;

/// A recording, ready for cases.
pub(super) struct Ground {
    /// The recording's name.
    pub name: String,
    /// The stretches, and the kinds that can be imposed on them.
    pub survey: Survey,
    /// For each stretch, the second half under the model of the first: verdict and number of causes.
    pub halves: Vec<(String, usize)>,
    folder: tempfile::TempDir,
}

impl Ground {
    /// Cuts a capture or a file into at most `cases` stretches.
    pub(super) fn of(context: &Context, args: &TrialArgs, named: &str) -> anyhow::Result<Self> {
        let stretches = {
            let together = analysis::open(context, &[named.to_owned()], args.rate)?;
            let whole = gridded(&together.source, &together.plan, u64::MAX)?.recording;
            drop(together);
            let mut stretches = recorded::cut(&whole, args.samples.unwrap_or(STUDY))
                .map_err(|error| usage(format!("--on {named}: {error}")))?;
            stretches.truncate(args.cases.max(1));
            stretches
        };
        let folder = tempfile::tempdir().context("no temporary folder can be made")?;
        let kinds = each(stretches.len(), args.threads, "stretches asked what they show of themselves", |number| {
            let stretch = of_itself(&stretches[number])?;
            let text = serde_json::to_vec(&stretch.own)?;
            std::fs::write(own(folder.path(), number), text)?;
            std::fs::write(parcel_of(folder.path(), number), parcel::pack(&stretch.recording, &stretch.model, false)?)?;
            Ok(stretch.kinds())
        })?;
        let halves =
            each(stretches.len(), args.threads, "halves against each other", |number| halves(&stretches[number]))?;
        let survey = Survey {
            stretches: stretches.len(),
            kinds: Kind::all().filter(|kind| kinds.iter().all(|of| of.contains(kind))).collect(),
        };
        std::fs::write(survey_of(folder.path()), serde_json::to_vec(&survey)?)?;
        Ok(Self { name: named.to_owned(), survey, halves: halves.into_iter().flatten().collect(), folder })
    }

    /// Returns the folder, which exists as long as this value.
    pub(super) fn folder(&self) -> &Path {
        self.folder.path()
    }
}

/// Returns the properties of the stretches in a folder.
pub(super) fn survey(folder: &Path) -> anyhow::Result<Survey> {
    read(&survey_of(folder)).and_then(|text| Ok(serde_json::from_slice(&text)?))
}

/// Returns one of the stretches.
pub(super) fn stretch(folder: &Path, number: usize) -> anyhow::Result<Stretch> {
    let Parcel { recording, model, .. } = parcel::unpack(&read(&parcel_of(folder, number))?)?;
    let own = serde_json::from_slice(&read(&own(folder, number))?)?;
    Ok(Stretch { recording, model, own })
}

/// Returns a stretch with the model of its own effects.
fn of_itself(recording: &Recording) -> anyhow::Result<Stretch> {
    let (model, report) =
        settled(recorded::first_model(recording), |model, options| imu_diagnosis::diagnose(recording, model, options))?;
    let causes = Report::of(&report)?.causes;
    let named: Vec<_> = causes.into_iter().map(|cause| (cause.effect, cause.channels)).collect();
    Ok(Stretch::new(recording.clone(), model, &named))
}

/// Diagnoses under a first model and then under what was found, until nothing is named or no round is left. Returns the last
/// model and its diagnosis.
pub(super) fn settled(
    first: SensorModel,
    diagnose: impl Fn(&SensorModel, &Options<'_>) -> Result<imu_diagnosis::Outcome, imu_diagnosis::DiagnosisError>,
) -> anyhow::Result<(SensorModel, serde_json::Value)> {
    let mut model = first;
    let mut round = 0;
    loop {
        // For a device without a description there is no prior; for a fitted model there is.
        let outcome = diagnose(&model, &Options { believed: round > 0, ..Options::default() })?;
        round += 1;
        if round == ROUNDS || (round > 1 && outcome.diagnosis.causes.is_empty()) {
            return Ok((model, serde_json::to_value(&outcome.diagnosis)?));
        }
        model = read_again(&outcome.augmented)?;
    }
}

/// Returns the second half of a stretch under the model fitted to the first half: verdict and number of causes; `None`
/// if half of it is too short.
fn halves(stretch: &Recording) -> anyhow::Result<Option<(String, usize)>> {
    let Ok(halves) = recorded::cut_in(stretch, stretch.len() / 2, HALF_MIN) else { return Ok(None) };
    let [first, second, ..] = halves.as_slice() else { return Ok(None) };
    let model = of_itself(first)?.model;
    let outcome = imu_diagnosis::diagnose(second, &model, &Options::default())?;
    let report = Report::of(&serde_json::to_value(&outcome.diagnosis)?)?;
    Ok(Some((report.verdict, report.causes.len())))
}

/// Returns the model in the form in which the processes read it.
pub(super) fn read_again(model: &SensorModel) -> anyhow::Result<SensorModel> {
    Ok(SensorModel::from_value(&serde_json::to_value(model)?, "the corrected model")?)
}

pub(super) fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("{} cannot be read", path.display()))
}

fn survey_of(folder: &Path) -> PathBuf {
    folder.join("survey.json")
}

pub(super) fn parcel_of(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("{number:05}.parcel"))
}

fn own(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("{number:05}.json"))
}
