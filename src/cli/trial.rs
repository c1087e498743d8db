//! `vn100d trial`: the blind check of the diagnosis.
//!
//! The program runs itself: one process makes a case from the sealed seed and writes recording and model to its
//! standard output, another reads them there and writes its diagnosis. Neither communicates the effects of the case.
//! The manifest with the digests of all keys is made first; the keys are requested after the last diagnosis, and must
//! match it.

use super::args::{TrialArgs, TrialPart};
use super::sealed::{Sealed, Shape, outcome, read, thresholds, words, write};
use super::trial_on::Ground;
use super::{Context, Outcome, print_json, trial_show, usage};
use crate::store::SOFTWARE;
use imu_trial::again::{Again, Diagnoses, closed_under};
use imu_trial::impose::SAMPLES_MIN;
use imu_trial::page::page;
use imu_trial::{Answer, Key, Rates, Report, Score, Suite, Wanted, judge};

/// Runs a trial and prints the result.
pub(super) fn run(context: &Context, args: &TrialArgs) -> anyhow::Result<Outcome> {
    if args.motion {
        return super::trial_motion::run(context, args);
    }
    let suite = args.suite.as_deref().map(|name| Suite::named(name).ok_or_else(|| unknown(name))).transpose()?;
    let all = Suite::words();
    let shape = suite.map_or_else(
        || Shape::of(args),
        |suite| Shape { cases: suite.cases, seed: Some(suite.seed), kinds: &all, samples: Some(suite.samples) },
    );
    Wanted::from_words(words(shape.kinds)).map_err(|error| usage(format!("--kinds: {error}")))?;
    let required = thresholds(args, &Rates::names())?;
    if shape.samples.is_some_and(|samples| samples < SAMPLES_MIN) {
        return Err(usage(format!("--samples: a case takes {SAMPLES_MIN} or more")));
    }
    let ground = args.on.as_ref().map(|named| Ground::of(context, args, named)).transpose()?;
    let sealed = Sealed::new(args, shape, ground.as_ref().map(Ground::folder))?;
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
    let truths = sealed.truths(&reports, |index| keys[index].class.in_library(), closed_under)?;
    let reports: Vec<Result<Report, String>> = reports
        .into_iter()
        .map(|report| report.and_then(|value| Report::of(&value).map_err(|error| error.to_string())))
        .collect();
    let again = sealed.again(
        cases,
        |index| !keys[index].class.is_silent(),
        |index, text| {
            let then: Diagnoses = read(text, "diagnoses")?;
            Ok(reports[index].as_ref().ok().map(|report| Again::of(report, &then, &keys[index])))
        },
    )?;
    let mut answers = Vec::with_capacity(cases);
    for (((report, own), closed_by_truth), again) in reports.into_iter().zip(owns).zip(truths).zip(again) {
        answers.push(Answer { report, own, closed_by_truth, again: again.flatten() });
    }
    let judgements: Vec<_> = keys.iter().zip(&answers).map(|(key, answer)| judge(key, answer)).collect();
    let halves = ground.as_ref().map_or(&[][..], |ground| &ground.halves);
    let score = Score::of(SOFTWARE, sealed.seed, &manifest_sha256, &judgements, halves);
    let score = score.of_suite(suite.map(|suite| suite.name));
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
        trial_show::show(&score)?
    }
    Ok(outcome(&required, |name| score.rates.get(name).and_then(|rate| rate.share)))
}

fn unknown(name: &str) -> anyhow::Error {
    let names: Vec<&str> = imu_trial::suite::SUITES.iter().map(|suite| suite.name).collect();
    usage(format!("--suite {name}: there is none of this name; expected {}", names.join(", ")))
}
