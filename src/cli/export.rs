//! `vn100d export`: a capture's samples for other programs, as one file or as part of a data set.

use super::args::{ExportArgs, TimeOrigin};
use super::figures::counted;
use super::output::Output;
use super::part::Part;
use super::progress::{SAMPLES, bar};
use super::samples::{Block, Samples};
use super::source::file;
use super::subject::Stop;
use super::{Context, Outcome, failed, print_json, usage};
use crate::store::StoreError;
use anyhow::Context as _;
use imu_core::sample::{Channel, ChannelError};
use imu_files::export::samples::{About, ExportError, SampleFormat, Tally, is_parquet_of, partition_path};
use std::fs::File;
use std::io::ErrorKind::NotFound;
use std::io::{BufWriter, IsTerminal as _, Write};
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

/// Number of bytes written at a time.
const WRITE_BYTES: usize = 1 << 20;
/// Number of blocks that wait between reading and writing, some 1 MB each.
const BLOCKS_AHEAD: usize = 4;

/// The result of an export.
#[derive(Debug, serde::Serialize)]
struct Report {
    file: String,
    format: &'static str,
    capture: Option<i64>,
    samples: u64,
    missing: u64,
    gaps: u64,
    channels: Vec<&'static str>,
    bytes: u64,
}

/// Writes one file, or each capture's part of a data set.
pub(super) fn run(context: &Context, args: &ExportArgs) -> anyhow::Result<Outcome> {
    match &args.partitioned {
        Some(folder) => data_set(context, args, folder),
        None => one_file(context, args),
    }
}

/// Converts the error for a channel that does not exist to an error of usage.
fn opened(source: anyhow::Result<Samples>) -> anyhow::Result<Samples> {
    source.map_err(|error| if error.is::<ChannelError>() { usage(error.to_string()) } else { error })
}

fn one_file(context: &Context, args: &ExportArgs) -> anyhow::Result<Outcome> {
    let [named] = args.captures.as_slice() else {
        return Err(usage("several captures were given: one file holds one (--partitioned DIR takes several)"));
    };
    let path = args.out.as_deref().filter(|path| *path != Path::new("-"));
    let format = format(args, path)?;
    if args.time == TimeOrigin::Utc && !format.is_text() {
        return Err(usage("--time is of csv and ndjson: parquet and mcap tell the time of day as well"));
    }
    if path.is_none() && context.json {
        return Err(usage("--json and the samples both want standard output: name --out FILE"));
    }
    if path.is_none() && !format.is_text() && std::io::stdout().is_terminal() {
        return Err(usage(format!("{} is nothing for a terminal: name --out FILE", format.name())));
    }
    let stop = Stop::listen()?;
    let read: Vec<&Path> = file(named).into_iter().collect();
    let output = path.map(|path| Output::create(path, args.force, &read)).transpose()?;
    let part = Part::of(args.part.clone());
    let is_part = !part.is_whole();
    let source = opened(Samples::open(context, named, args.rate, part, stop.keep_on()))?;
    let outcome = if source.rejected { Outcome::WithLoss } else { Outcome::Done };
    let utc = args.time == TimeOrigin::Utc;
    let Some(output) = output else {
        write(source, format, utc, std::io::stdout(), &stop, "standard output")?;
        return Ok(outcome);
    };
    let shown = output.path().display().to_string();
    let report = write(source, format, utc, output.file(), &stop, &shown)?;
    if is_part && report.samples == 0 {
        return Err(failed(format!("{named} has no sample in the part that is wanted; no file is kept")));
    }
    output.keep()?;
    if context.json {
        print_json(&report)?;
    } else {
        print_summary(&report)?;
    }
    Ok(outcome)
}

/// Returns the named form, else the one of the file's ending.
fn format(args: &ExportArgs, path: Option<&Path>) -> anyhow::Result<SampleFormat> {
    let Some(path) = path else { return Ok(args.format.unwrap_or(SampleFormat::Csv)) };
    let ending = path.extension().and_then(|ending| SampleFormat::of_ending(&ending.to_string_lossy()));
    args.format.or(ending).ok_or_else(|| {
        let known = SampleFormat::ALL.map(SampleFormat::name).join(", ");
        usage(format!("{} does not end with its form: name --format ({known})", path.display()))
    })
}

/// Writes every capture's file to its place; each is complete or absent.
fn data_set(context: &Context, args: &ExportArgs, folder: &Path) -> anyhow::Result<Outcome> {
    let stop = Stop::listen()?;
    // One schema for all files: a capture without a channel has an empty column.
    let channels = args.part.channels.as_ref().map_or_else(|| Channel::ALL.to_vec(), |channels| channels.0.clone());
    let (mut outcome, mut reports) = (Outcome::Done, Vec::new());
    for id in wanted(context, args)? {
        let placed = match Samples::of_capture(context, id, channels.clone()) {
            Ok(source) if source.samples == 0 => {
                eprintln!("note: capture {id} has no samples: it is left out");
                continue;
            }
            Ok(source) => {
                let (path, rejected) = (folder.join(partition_path(&source.about)), source.rejected);
                let report = place(context, source, folder, &stop).inspect_err(|_| take_away_empty(&path, folder));
                report.map(|report| (report, rejected))
            }
            Err(error) => Err(error),
        };
        let (report, rejected) = match placed {
            Ok(placed) => placed,
            Err(error) if args.all && is_gone(&error) => {
                eprintln!("note: capture {id} was deleted meanwhile: nothing is written of it");
                continue;
            }
            Err(error) => {
                let written = reports.len();
                return Err(error.context(format!("capture {id} is not written, {written} before it are")));
            }
        };
        if rejected {
            outcome = Outcome::WithLoss;
        }
        if !context.json {
            print_summary(&report)?;
        }
        reports.push(report);
    }
    if context.json {
        print_json(&reports)?;
    }
    Ok(outcome)
}

/// Returns whether the capture no longer exists.
fn is_gone(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(StoreError::NoSuchCapture(_)))
}

fn place(context: &Context, source: Samples, folder: &Path, stop: &Stop) -> anyhow::Result<Report> {
    let about = source.about.clone();
    let path = folder.join(partition_path(&about));
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).with_context(|| format!("{} cannot be made", parent.display()))?;
    }
    let output = Output::create(&path, true, &[])?;
    let shown = path.display().to_string();
    let report = write(source, SampleFormat::Parquet, false, output.file(), stop, &shown)?;
    output.keep()?;
    remove_earlier_names(context, &about, folder, &path);
    Ok(report)
}

/// Removes files of the same capture under names that it had before it was renamed. A file of which this is not certain
/// stays, with a note.
fn remove_earlier_names(context: &Context, about: &About, folder: &Path, written: &Path) {
    let names = context.reader().and_then(|reader| Ok(reader.earlier_names(about.id.unwrap_or_default())?));
    let names = names.unwrap_or_else(|error| {
        eprintln!("note: the earlier names of {} are not known: {error:#}", written.display());
        Vec::new()
    });
    for name in names {
        let earlier = About { name, ..about.clone() };
        let old = folder.join(partition_path(&earlier));
        let id = |path: &Path| path.symlink_metadata().ok().map(|file| (file.dev(), file.ino()));
        // A file system may take both names for one.
        if id(&old).is_none() || id(&old) == id(written) {
            continue;
        }
        let removed = remove_if_of(&earlier, &old, written);
        if let Err(error) = removed.or_else(|error| if error.kind() == NotFound { Ok(()) } else { Err(error) }) {
            eprintln!("note: {} stays beside {}: {error}", old.display(), written.display());
        }
    }
}

/// Removes a file of this capture, once the file that replaces it is on the disk.
fn remove_if_of(about: &About, old: &Path, written: &Path) -> std::io::Result<()> {
    if !old.symlink_metadata()?.is_file() || !is_parquet_of(about, File::open(old)?) {
        return Err(std::io::Error::other("it is not known to be of the same capture"));
    }
    File::open(written)?.sync_all()?;
    if let Some(parent) = written.parent() {
        File::open(parent)?.sync_all()?;
    }
    std::fs::remove_file(old)
}

/// Removes folders that were made for a file that was not written; the system keeps folders that are not empty.
fn take_away_empty(path: &Path, folder: &Path) {
    for parent in path.ancestors().skip(1).take_while(|parent| *parent != folder) {
        if std::fs::remove_dir(parent).is_err() {
            return;
        }
    }
}

/// Returns the named captures, each once, or all that have samples; the oldest first.
fn wanted(context: &Context, args: &ExportArgs) -> anyhow::Result<Vec<i64>> {
    let reader = context.reader()?;
    let mut ids = Vec::new();
    for named in &args.captures {
        if file(named).is_some() {
            return Err(usage(format!(
                "{named} is a file: a data set has captures of the database, so import it first"
            )));
        }
        ids.push(context.capture(named)?.1.id);
    }
    if args.all {
        let captures = super::all(|page| reader.captures(None, page))?;
        ids.extend(captures.iter().filter(|capture| capture.samples > 0).map(|capture| capture.id));
    }
    ids.sort_unstable();
    ids.dedup();
    Ok(ids)
}

/// A piece passed from the reading thread to the writing one.
enum Piece {
    Samples(Block),
    End(Tally),
}

/// Writes all samples and the end of the file: one thread reads, another one writes.
fn write(
    source: Samples,
    format: SampleFormat,
    utc: bool,
    to: impl Write + Send,
    stop: &Stop,
    shown: &str,
) -> anyhow::Result<Report> {
    let bar = bar(SAMPLES, source.samples);
    let about = source.about.clone();
    let abandoned = AtomicBool::new(false);
    let to = BufWriter::with_capacity(WRITE_BYTES, to);
    let mut counted = Counted { to, bytes: 0, abandoned: &abandoned };
    let (pieces, read) = mpsc::sync_channel(BLOCKS_AHEAD);
    let tally = std::thread::scope(|scope| {
        let writer = scope.spawn(|| all(read, format, &about, utc, &mut counted, &abandoned));
        let tally = source.each(&mut |block| {
            stop.unless(Ok(()))?;
            bar.inc(block.rows().len() as u64);
            pieces.send(Piece::Samples(block)).map_err(|_| anyhow::anyhow!("the writing ended before the reading"))
        });
        if let Ok(tally) = &tally {
            // If the writer no longer receives, it reports the reason.
            let _ = pieces.send(Piece::End(tally.clone()));
        }
        drop(pieces);
        match writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)) {
            Ok(()) => tally,
            Err(ExportError::Write(error)) => {
                Err(anyhow::Error::from(error).context(format!("{shown} cannot be written")))
            }
            Err(error) => Err(error.into()),
        }
    })?;
    bar.finish_and_clear();
    Ok(Report {
        file: shown.to_owned(),
        format: format.name(),
        capture: about.id,
        samples: tally.samples,
        missing: tally.missing,
        gaps: tally.gaps,
        channels: about.channels.iter().map(|channel| channel.name()).collect(),
        bytes: counted.bytes,
    })
}

/// Writes until the end; if the pieces end before it, the incomplete file is not kept.
fn all(
    pieces: mpsc::Receiver<Piece>,
    format: SampleFormat,
    about: &About,
    utc: bool,
    to: impl Write + Send,
    abandoned: &AtomicBool,
) -> Result<(), ExportError> {
    let mut sink = format.begin(to, about, utc)?;
    let until_end = || {
        for piece in pieces {
            match piece {
                Piece::Samples(block) => sink.rows(block.rows())?,
                Piece::End(tally) => return Ok(Some(tally)),
            }
        }
        Ok(None)
    };
    match until_end() {
        Ok(Some(tally)) => sink.finish(&tally),
        ended => {
            // MCAP's writer finishes a file when it is dropped: data sent to a pipe would look complete.
            abandoned.store(true, Ordering::Relaxed);
            ended.map(drop)
        }
    }
}

/// Counts the bytes written through it.
struct Counted<'a, W> {
    to: W,
    bytes: u64,
    /// Whether nothing more may be written.
    abandoned: &'a AtomicBool,
}

impl<W: Write> Write for Counted<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.abandoned.load(Ordering::Relaxed) {
            return Err(std::io::ErrorKind::Other.into());
        }
        let written = self.to.write(bytes)?;
        self.bytes += written as u64;
        Ok(written)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        self.to.flush()
    }
}

fn print_summary(report: &Report) -> std::io::Result<()> {
    let Report { file, format, samples, missing, gaps, channels, bytes, .. } = report;
    let channels = counted(channels.len() as u64, "channel", "channels");
    let [samples, gaps] = [counted(*samples, "sample", "samples"), counted(*gaps, "gap", "gaps")];
    let mut stdout = std::io::stdout().lock();
    writeln!(stdout, "{file}: {samples} of {channels} as {format}, {missing} missing in {gaps}, {bytes} bytes")
}
