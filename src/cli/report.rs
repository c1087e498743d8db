//! `vn100d report`: everything known about a capture as one self-contained page, for colleagues and for paper.

use super::args::ReportArgs;
use super::figures::counted;
use super::output::Output;
use super::progress::bar;
use super::source::file;
use super::subject::{Stop, Subject};
use super::{Context, Outcome, print_json, usage, validation};
use crate::gallery::{self, Window};
use crate::jobs::{Documents, JobError, JobKind, read_diagnosis};
use crate::page::{self, CaptureView, Figure};
use crate::store::{DiagnosisRow, printable};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

/// Maximum number of diagnoses in a report, the latest: each has a spectrum of every channel.
const ENCLOSED: usize = 8;

/// The result of a report.
#[derive(Debug, serde::Serialize)]
struct Report<'a> {
    /// The capture's id; null for a recording.
    capture: Option<i64>,
    name: &'a str,
    out: &'a Path,
    bytes: usize,
    plots: &'a [String],
    diagnoses: &'a [i64],
    remarks: &'a [String],
}

/// Writes the page.
pub(super) fn run(context: &Context, args: &ReportArgs) -> anyhow::Result<Outcome> {
    let path = Some(args.out.as_path()).filter(|path| *path != Path::new("-"));
    let ending = path.and_then(Path::extension).map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    match path {
        Some(path) if !matches!(ending.as_deref(), Some("html" | "htm")) => {
            return Err(usage(format!("--out {}: expected a name that ends with .html", path.display())));
        }
        None if context.json => {
            return Err(usage("--json and the report both want standard output: name --out FILE.html"));
        }
        _ => {}
    }
    if args.validation.validation {
        return validation::run(context, args, validation::model_path(args)?);
    }
    let [capture] = &args.captures[..] else {
        return Err(usage("a report is of one capture; several are for --validation"));
    };
    let read: Vec<&Path> = file(capture).into_iter().collect();
    let stop = Stop::listen()?;
    let output = path.map(|path| Output::create(path, args.force, &read)).transpose()?;
    let subject = Subject::open(context, capture, args.rate, args.sampling.stated(), &stop)?;
    let made = stop.unless(Made::of(&subject, &stop))?;
    let outcome = if subject.row.has_rejected() { Outcome::WithLoss } else { Outcome::Done };
    let Some(output) = output else {
        std::io::stdout().lock().write_all(made.page.as_bytes())?;
        return Ok(outcome);
    };
    output.put(made.page.as_bytes())?;
    let bytes = made.page.len();
    if context.json {
        print_json(&Report {
            capture: Some(subject.row.id).filter(|_| !subject.of_file),
            name: &subject.row.name,
            out: &args.out,
            bytes,
            plots: &made.plots,
            diagnoses: &made.diagnoses,
            remarks: &made.remarks,
        })?;
    } else {
        let (plots, diagnoses) = (counted(made.plots.len() as u64, "plot", "plots"), made.diagnoses.len());
        let diagnoses = counted(diagnoses as u64, "diagnosis", "diagnoses");
        let out = args.out.display();
        writeln!(
            std::io::stdout(),
            "{out}: report of {}, {plots}, {diagnoses}, {bytes} bytes",
            printable(&subject.row.name)
        )?;
    }
    Ok(outcome)
}

/// A page and its contents.
struct Made {
    page: String,
    plots: Vec<String>,
    diagnoses: Vec<i64>,
    remarks: Vec<String>,
}

impl Made {
    fn of(subject: &Subject, stop: &Stop) -> anyhow::Result<Self> {
        let facts = gallery::facts(&subject.reader, subject.row.id)?;
        let (mut documents, mut remarks) = (Documents::default(), subject.remarks.clone());
        let bar = bar("{bar:30} {pos} of {len} · {msg}", 0);
        for kind in [JobKind::Statistics, JobKind::Noise, JobKind::Allan] {
            bar.set_message(kind.gives());
            match subject.document(kind) {
                Ok(found) => documents.extend(found),
                Err(error @ JobError::Store(_)) => stop.unless(Err(error.into()))?,
                Err(error) => remarks.push(format!("There is no {}: {error}.", kind.gives())),
            }
            stop.unless(Ok(()))?;
        }
        let pictures = gallery::pictures(&facts, &documents);
        bar.set_length(pictures.len() as u64);
        let (id, mut figures) = (subject.row.id.to_string(), BTreeMap::new());
        for picture in pictures {
            bar.set_message(picture.name());
            let svg = gallery::svg(&subject.reader, &id, picture, Window::default(), &documents);
            let svg = stop.unless(svg.map_err(anyhow::Error::from))?;
            if !svg.is_empty() {
                figures.insert(picture.name(), Figure::Drawn(svg));
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        remarks.extend(facts.remark());
        let diagnosed = Diagnosed::of(subject)?;
        let page = page::capture(&CaptureView {
            facts: &facts,
            is_kept: !subject.of_file,
            documents: &documents,
            remarks: &remarks,
            waits: false,
            diagnoses: &diagnosed.others,
            figures: &figures,
            served: None,
            enclosed: &diagnosed.enclosed,
        });
        Ok(Self { page, plots: figures.into_keys().collect(), diagnoses: diagnosed.ids, remarks })
    }
}

/// The diagnoses of a capture.
#[derive(Default)]
struct Diagnosed {
    /// The ids of the enclosed ones.
    ids: Vec<i64>,
    /// The contents of their pages.
    enclosed: Vec<String>,
    /// The others, each with a sentence.
    others: Vec<DiagnosisRow>,
}

impl Diagnosed {
    fn of(subject: &Subject) -> anyhow::Result<Self> {
        let (reader, mut own) = (&subject.reader, Self::default());
        for mut row in super::all(|page| reader.diagnoses(Some(subject.row.id), page))? {
            let job = &row.job;
            let result = job.result_id.filter(|_| own.ids.len() < ENCLOSED);
            match result.map(|id| reader.result(id)).transpose()?.flatten() {
                Some(result) => match read_diagnosis(&result.body) {
                    Ok((report, drawings)) => {
                        let body = page::diagnosis_body(&report, &drawings, &[]);
                        // On paper nothing can be opened.
                        own.enclosed.push(body.replace("<details>", "<details open>"));
                        own.ids.push(job.id);
                    }
                    // A newer program may have written it.
                    Err(error) => {
                        let id = job.id;
                        row.summary =
                            Some(format!("diagnosis {id} cannot be read by this version, run it again: {error}"));
                        own.others.push(row);
                    }
                },
                None => {
                    let why = job.error.as_ref().map_or_else(String::new, |why| format!(": {why}"));
                    let state = || format!("diagnosis {}, {}{why}", job.id, job.state.name());
                    row.summary = Some(row.summary.take().unwrap_or_else(state));
                    own.others.push(row);
                }
            }
        }
        Ok(own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::args::{SamplingArgs, ValidationArgs};
    use crate::clock::SystemClock;
    use crate::daemon::import::{Source, import};
    use crate::store::{NewJob, Store, StoreOptions};
    use serde_json::json;

    #[test]
    fn what_a_simulator_lacks_is_enclosed_and_a_diagnosis_that_failed_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let (recording, out) = (folder.path().join("few.csv"), folder.path().join("page.html"));
        std::fs::write(&recording, "time_s,gyro_x_rad_s\n0,0.1\n0.025,0.2\n0.05,0.3\n").unwrap();
        let store = Store::open(&folder.path().join("vn100d.db"), StoreOptions::default()).unwrap();
        let imported = import(&store, &SystemClock, Source::of(&recording), None, &mut |_, _| Ok(())).unwrap();
        let submit = |number: usize| {
            let (kind, params) = (JobKind::Diagnosis, json!({ "sim": number }));
            let id = store.submit_job(NewJob::new(kind, imported.end.id(), params), u64::MAX).unwrap().0.id;
            assert_eq!(store.claim_job().unwrap().unwrap().id, id);
            id
        };
        let failed = submit(0);
        store.fail_job(failed, "<too short>").unwrap();
        for number in 1..=ENCLOSED + 1 {
            let discrepancy = json!({"unit": "nats/sample", "before": 1.0, "after_parameters": 1.0, "after": 1.0, "floor": 1.0,
                "p_value_after": 0.5, "closed": null, "closed_ci95": null, "measured_on": "all of it"});
            let report = json!({"format": "vn100d-diagnosis-1", "verdict": "effects", "summary": format!("a <tone> {number}"),
                "discrepancy": discrepancy, "where": [], "parameters": [], "causes": [], "alternatives": [], "per_channel": {},
                "notes": [], "software": "", "inputs": {}});
            let body = json!({"report": report, "model": {}, "spectra": []});
            store.finish_job(submit(number), body.to_string()).unwrap();
        }
        store.close().unwrap();
        let context =
            Context { data_dir: Some(folder.path().to_owned()), config: None, json: false, ..Context::default() };
        let args = ReportArgs {
            part: super::super::args::PartArgs::default(),
            captures: vec!["latest".to_owned()],
            out: out.clone(),
            rate: None,
            sampling: SamplingArgs::default(),
            validation: ValidationArgs::default(),
            force: false,
        };
        assert_eq!(run(&context, &args).unwrap(), Outcome::Done);
        let page = std::fs::read_to_string(out).unwrap();
        assert_eq!(page.matches("class=\"enclosed\"").count(), ENCLOSED);
        // The latest ones completely, the earliest one by its sentence.
        assert!(page.contains("<h3>a &lt;tone&gt; 2</h3>") && page.contains("<li>a &lt;tone&gt; 1</li>"), "{page}");
        assert!(page.contains(&format!("<li>diagnosis {failed}, failed: &lt;too short&gt;</li>")), "{page}");
        assert_eq!(page.matches("<h1>").count(), 1);
    }
}
