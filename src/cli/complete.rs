//! Completions: what a shell offers for captures, models, channels and plots. The script of `vn100d completions` asks
//! the program itself, so that the answers are those of the database.

use super::Context;
use super::args::Cli;
use crate::gallery::Picture;
use crate::store::{CaptureRow, CaptureState, PageRequest};
use clap::{Command, CommandFactory as _};
use clap_complete::CompleteEnv;
use clap_complete::engine::{ArgValueCompleter, CompletionCandidate, PathCompleter, ValueCompleter as _};
use imu_core::sample::Channel;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

/// The variable by which a shell's script asks for completions.
pub(super) const ASKED: &str = "VN100D_COMPLETE";
/// The number of captures that are offered, the latest.
const OFFERED: u32 = 1000;
/// The number of characters of a note beside a capture.
const NOTE_CHARS: usize = 40;

/// Returns the part of the program that answers a shell.
pub(super) fn environment() -> CompleteEnv<'static, fn() -> Command> {
    CompleteEnv::with_factory(Cli::command as fn() -> Command).var(ASKED)
}

/// Offers captures.
pub(super) fn captures() -> ArgValueCompleter {
    ArgValueCompleter::new(|typed: &OsStr| of_database(typed, |_| true))
}

/// Offers captures and files.
pub(super) fn captures_and_files() -> ArgValueCompleter {
    ArgValueCompleter::new(|typed: &OsStr| {
        let mut offered = of_database(typed, |_| true);
        offered.extend(PathCompleter::file().complete(typed));
        offered
    })
}

/// Offers files of sensor models.
pub(super) fn models() -> ArgValueCompleter {
    ArgValueCompleter::new(model_files)
}

/// Offers files of sensor models and simulated captures.
pub(super) fn simulators() -> ArgValueCompleter {
    ArgValueCompleter::new(|typed: &OsStr| {
        let mut offered = model_files(typed);
        offered.extend(of_database(typed, |row| row.state == CaptureState::Simulated));
        offered
    })
}

/// Offers the next channel of a list, of those of the capture that the command line names.
pub(super) fn channels() -> ArgValueCompleter {
    ArgValueCompleter::new(|typed: &OsStr| {
        let known = named_captures().first().map_or_else(|| Channel::ALL.to_vec(), |row| row.channels.clone());
        next_of_list(typed, &known.iter().map(|channel| channel.name()).collect::<Vec<_>>())
    })
}

/// Offers the next effect of a list.
pub(super) fn effects() -> ArgValueCompleter {
    ArgValueCompleter::new(|typed: &OsStr| {
        let known: Vec<&str> = imu_diagnosis::effects().into_iter().map(|effect| effect.name()).collect();
        next_of_list(typed, &known)
    })
}

/// Offers plots of the capture that the command line names.
pub(super) fn plots() -> ArgValueCompleter {
    ArgValueCompleter::new(|typed: &OsStr| {
        let known = named_captures().first().map_or_else(|| Channel::ALL.to_vec(), |row| row.channels.clone());
        beginning(typed, Picture::all(&known).into_iter().map(|picture| CompletionCandidate::new(picture.name())))
    })
}

fn model_files(typed: &OsStr) -> Vec<CompletionCandidate> {
    let is_model = |path: &Path| path.extension().is_some_and(|ending| ending == "json");
    PathCompleter::any().filter(is_model).complete(typed)
}

/// Returns the candidates that begin with what was typed.
fn beginning(typed: &OsStr, all: impl Iterator<Item = CompletionCandidate>) -> Vec<CompletionCandidate> {
    let typed = typed.to_string_lossy();
    all.filter(|one| one.get_value().to_string_lossy().starts_with(&*typed)).collect()
}

/// Returns the list with each name that may follow; the typed ones stay.
fn next_of_list(typed: &OsStr, known: &[&str]) -> Vec<CompletionCandidate> {
    let text = typed.to_string_lossy();
    let before = text.rfind(',').map_or("", |comma| &text[..=comma]);
    let left = known.iter().filter(|name| !before.split(',').any(|used| used == **name));
    beginning(typed, left.map(|name| CompletionCandidate::new(format!("{before}{name}"))))
}

/// Returns the captures in the database that the command line means; none if it cannot be read. A name that a shell
/// would take apart is offered as its id.
fn of_database(typed: &OsStr, is_wanted: impl Fn(&CaptureRow) -> bool) -> Vec<CompletionCandidate> {
    let rows: Vec<CaptureRow> = rows().into_iter().filter(is_wanted).collect();
    let latest = (!rows.is_empty()).then(|| CompletionCandidate::new("latest"));
    beginning(typed, rows.iter().map(candidate).chain(latest))
}

fn candidate(row: &CaptureRow) -> CompletionCandidate {
    let is_plain = |character: char| character.is_alphanumeric() || "-_.+,".contains(character);
    let plain = row.name.chars().all(is_plain) && !row.name.starts_with('-');
    let (value, mut about) =
        if plain { (row.name.clone(), String::new()) } else { (row.id.to_string(), format!("{}, ", row.name)) };
    about = format!("{about}{}, {} samples", row.state.name(), row.samples);
    if let Some(note) = &row.note {
        about = format!("{about}, {}", note.chars().take(NOTE_CHARS).collect::<String>());
    }
    CompletionCandidate::new(value).help(Some(about.into()))
}

fn rows() -> Vec<CaptureRow> {
    let request = PageRequest { limit: Some(OFFERED), cursor: None };
    let reader = context().quiet_reader();
    reader.and_then(|reader| reader.captures(None, &request).ok()).map(|page| page.rows).unwrap_or_default()
}

/// Returns the captures that words of the command line name.
fn named_captures() -> Vec<CaptureRow> {
    let words: Vec<OsString> = words().collect();
    let Some(reader) = context().quiet_reader() else { return Vec::new() };
    let known = |word: &OsString| reader.capture(reader.resolve(word.to_str()?).ok()?).ok();
    // The first words are the program and the command.
    words.iter().skip(2).filter_map(known).collect()
}

/// Returns the words of the command line that is being completed: the shell's script passes them after `--`.
fn words() -> impl Iterator<Item = OsString> {
    std::env::args_os().skip_while(|word| word != "--").skip(1)
}

/// Returns the places that the command line names so far.
fn context() -> Context {
    let mut context = Context::default();
    let mut words = words().peekable();
    while let Some(word) = words.next() {
        let text = word.to_string_lossy();
        let (option, mut value) = match text.split_once('=') {
            Some((option, value)) => (option.to_owned(), Some(PathBuf::from(value))),
            None => (text.into_owned(), None),
        };
        if !["--data-dir", "--config"].contains(&option.as_str()) {
            continue;
        }
        // Bash makes a word of its own of `=`.
        if value.is_none() && words.peek().is_some_and(|word| word == "=") {
            words.next();
        }
        value = value.or_else(|| words.next().map(PathBuf::from));
        *if option == "--config" { &mut context.config } else { &mut context.data_dir } = value;
    }
    context
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(candidates: &[CompletionCandidate]) -> Vec<String> {
        candidates.iter().map(|one| one.get_value().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn a_list_goes_on_with_what_is_not_in_it() {
        let next = |typed: &str| values(&next_of_list(OsStr::new(typed), &["gyro_x", "gyro_y", "mag_x"]));
        assert_eq!(next(""), ["gyro_x", "gyro_y", "mag_x"]);
        assert_eq!(next("gyro_x,g"), ["gyro_x,gyro_y"]);
        assert_eq!(next("mag_x,gyro_y,"), ["mag_x,gyro_y,gyro_x"]);
        assert!(next("x").is_empty());
    }
}
