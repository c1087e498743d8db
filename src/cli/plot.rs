//! `vn100d plot`: one picture of a capture as a file.

use super::args::PlotArgs;
use super::output::Output;
use super::source::file;
use super::subject::{Stop, Subject};
use super::{Context, Outcome, failed, print_json, usage};
use crate::gallery::{self, Form, Picture, Window};
use crate::jobs::{Documents, JobError, JobKind};
use crate::store::printable;
use std::io::Write as _;
use std::path::Path;

/// The result of a plot.
#[derive(Debug, serde::Serialize)]
struct Report<'a> {
    plot: String,
    /// The capture's id; null for a recording.
    capture: Option<i64>,
    out: &'a Path,
    bytes: usize,
}

/// Draws the picture.
pub(super) fn run(context: &Context, args: &PlotArgs) -> anyhow::Result<Outcome> {
    let picture = args.picture;
    let path = Some(args.out.as_path()).filter(|path| *path != Path::new("-"));
    let form = path.map_or(Ok(Form::Svg), form)?;
    // The times of a series go on counting from the capture's first sample; other pictures are of the part alone.
    let window = match picture {
        Picture::Timeseries(_) => Window { from: args.part.from, to: args.part.to },
        _ => Window::default(),
    };
    if args.part.channels.is_some() {
        return Err(usage(format!("--channels is not for a plot: {} names its channels", picture.name())));
    }
    if path.is_none() && context.json {
        return Err(usage("--json and the plot both want standard output: name --out FILE.svg"));
    }
    let read: Vec<&Path> = file(&args.capture).into_iter().collect();
    let stop = Stop::listen()?;
    let output = path.map(|path| Output::create(path, args.force, &read)).transpose()?;
    let subject = Subject::open(context, &args.capture, args.rate, args.sampling.stated(), &stop)?;
    let image = stop.unless(image(&subject, picture, window, form))?;
    let outcome = if subject.row.has_rejected() { Outcome::WithLoss } else { Outcome::Done };
    let Some(output) = output else {
        std::io::stdout().lock().write_all(&image)?;
        return Ok(outcome);
    };
    output.put(&image)?;
    let (name, bytes) = (picture.name(), image.len());
    if context.json {
        let capture = Some(subject.row.id).filter(|_| !subject.of_file);
        print_json(&Report { plot: name, capture, out: &args.out, bytes })?;
    } else {
        writeln!(
            std::io::stdout(),
            "{}: {name} of {}, {bytes} bytes",
            args.out.display(),
            printable(&subject.row.name)
        )?;
    }
    Ok(outcome)
}

/// Returns the form of the file's ending.
fn form(path: &Path) -> anyhow::Result<Form> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    ending
        .as_deref()
        .and_then(Form::from_suffix)
        .ok_or_else(|| usage(format!("--out {}: expected a name that ends with .svg or .png", path.display())))
}

fn image(subject: &Subject, picture: Picture, window: Window, form: Form) -> anyhow::Result<Vec<u8>> {
    let row = &subject.row;
    if let Some(lacking) = subject.lacks(&picture.channels()) {
        let there: Vec<&str> = row.channels.iter().map(|channel| channel.name()).collect();
        return Err(failed(format!(
            "{} needs {lacking}, which {} does not have: it has {}",
            picture.name(),
            row.name,
            if there.is_empty() { "no channel yet".to_owned() } else { there.join(", ") }
        )));
    }
    let mut documents = Documents::default();
    for kind in picture.needs() {
        match subject.document(*kind) {
            Ok(found) => documents.extend(found),
            // Lines that can never exist are left out.
            Err(error) if *kind == JobKind::Noise && !matches!(error, JobError::Store(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    let file = gallery::file(&subject.reader, &row.id.to_string(), (picture, window), &documents, form, false)?;
    file.ok_or_else(|| failed(format!("{} has not enough data for {}", row.name, picture.name())))
}

#[cfg(test)]
mod tests {
    use super::super::{Failure, failure};
    use super::*;

    #[test]
    fn the_name_of_the_file_determines_what_is_written() {
        assert_eq!(form(Path::new("a.svg")).unwrap(), Form::Svg);
        assert_eq!(form(Path::new("/tmp/a.b.PNG")).unwrap(), Form::Png);
        for wrong in ["a", "a.pdf", ".svg", "svg"] {
            let refused = form(Path::new(wrong)).unwrap_err();
            assert_eq!(failure(&refused), Failure::Usage);
            assert!(refused.to_string().contains(".svg or .png"), "{wrong}");
        }
    }
}
