//! Source: the input of a command, a capture of the database or a recording's file.

use super::args::{Cli, Command};
use super::part;
use super::{Context, usage};
use crate::clock::{Clock as _, SystemClock};
use crate::store::{CaptureRow, Reader, printable};
use anyhow::Context as _;
use imu_files::recording::{
    ColumnMap, DefinitionError, Input, KeepOn, MessageDefinition, Options, Recording, RecordingInfo,
    is_recording_folder, is_type_name, read_small,
};
use std::path::Path;

/// The input of a command.
pub(super) enum Source {
    /// A capture: its database and its row, or those of the wanted part of it.
    Capture(Box<Reader>, Box<CaptureRow>),
    /// A recording's file, or the wanted part of it.
    Recording(Box<Recording>),
}

impl Source {
    /// Opens the file of this name if there is one, and reads it while `keep_on` allows it; else the capture. Of both only
    /// the wanted part.
    ///
    /// # Errors
    /// If neither can be read.
    pub(super) fn open(context: &Context, named: &str, rate_hz: Option<f64>, keep_on: KeepOn) -> anyhow::Result<Self> {
        if let Some(file) = file(named) {
            let (definitions, part) = (context.definitions.clone(), context.part.of_recording());
            let options = Options { rate_hz, started_utc_ns: SystemClock.utc_ns(), definitions, part };
            let input = Input::file(file).while_wanted(keep_on).with_columns(context.columns.clone());
            let input = input.with_counts(context.takes_counts);
            let recording = Recording::read(input, options)?;
            note_ignored(named, &recording.info().ignored_columns);
            return Ok(Self::Recording(Box::new(recording)));
        }
        if !context.columns.is_empty() || !context.definitions.is_empty() {
            return Err(usage(format!(
                "--columns and --message-definition describe a recording's file, but there is no file {named}; leave them out for \
                 a capture"
            )));
        }
        let (mut reader, mut row) = context.capture(named)?;
        if !context.part.is_whole() {
            (reader, row) = part::of_capture(&reader, &row, &context.part, &keep_on)?;
        }
        Ok(Self::Capture(Box::new(reader), Box::new(row)))
    }
}

/// Returns the path if it leads to a file, which no output may replace.
pub(super) fn file(named: &str) -> Option<&Path> {
    Some(Path::new(named)).filter(|path| path.is_file() || is_recording_folder(path))
}

/// Maximum number of bytes of a message's definition.
const DEFINITION_BYTES: u64 = 1 << 20;

/// Returns what the user states about recordings.
///
/// # Errors
/// If it contradicts itself, or the command reads no recording.
pub(super) fn stated(cli: &Cli) -> anyhow::Result<(ColumnMap, Vec<MessageDefinition>)> {
    let reads = matches!(
        cli.command,
        Command::Import(_)
            | Command::Export(_)
            | Command::Show { .. }
            | Command::Allan(_)
            | Command::Noise(_)
            | Command::Plot(_)
            | Command::Report(_)
            | Command::Model(_)
            | Command::Diagnose(_)
            | Command::Calibrate(_)
            | Command::Cost(_)
            | Command::Trial(_)
    );
    let states = !cli.columns.is_empty() || !cli.message_definition.is_empty();
    if states && !reads {
        return Err(usage("--columns and --message-definition are for commands that read a recording"));
    }
    let columns = ColumnMap::parse(&cli.columns).map_err(|error| usage(format!("--{error}")))?;
    let definitions = cli.message_definition.iter().map(|given| definition(given)).collect::<Result<_, _>>()?;
    Ok((columns, MessageDefinition::list(definitions).map_err(no_definition)?))
}

/// Reads `FILE.msg` or `TYPE=FILE.msg`; without a type, the file's name is the type.
fn definition(given: &str) -> anyhow::Result<MessageDefinition> {
    let (name, file) = match given.split_once('=') {
        Some((name, file)) if is_type_name(name.trim()) && !Path::new(given).is_file() => (Some(name), Path::new(file)),
        _ => (None, Path::new(given)),
    };
    let text = read_small(file, DEFINITION_BYTES).context("--message-definition")?;
    let stem = file.file_stem().map(|stem| stem.to_string_lossy()).unwrap_or_default();
    let definition = MessageDefinition::new(name.unwrap_or(&stem), &text).map_err(no_definition);
    definition.with_context(|| format!("--message-definition {given}"))
}

fn no_definition(error: DefinitionError) -> anyhow::Error {
    usage(error.to_string())
}

/// Returns whether lines or frames of a recording were rejected.
pub(super) fn has_rejected(info: &RecordingInfo) -> bool {
    info.rejected.values().any(|count| *count > 0)
}

/// Reports on standard error that no source states the rate, so that machine-readable output stays clean.
pub(super) fn note_assumed_rate(named: &str, rate_hz: f64) {
    eprintln!("note: {named} tells no rate: {rate_hz} Hz is assumed (--rate HZ tells another)");
}

/// Names of ignored columns that are shown.
const IGNORED_SHOWN: usize = 6;

/// Reports on standard error the columns of a recording that are not read.
pub(super) fn note_ignored(named: &str, columns: &[String]) {
    if columns.is_empty() {
        return;
    }
    let shown = columns.iter().take(IGNORED_SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
    let more = columns.len().saturating_sub(IGNORED_SHOWN);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    eprintln!("{}", printable(&format!("note: {named}: not read: {shown}{more} (--columns names what a column is)")));
}

/// Reports on standard error that no source states the time.
pub(super) fn note_assumed_time(named: &str) {
    eprintln!("note: {named} tells no time of day: its first sample counts as taken now");
}
