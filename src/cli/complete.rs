//! Completions: what a shell offers for captures, models, channels and plots. The script of `vn100d completions` asks
//! the program itself, so that the answers are those of the database.

use super::figures::counted;
use super::place::PATIENCE;
use super::{Context, client};
use crate::gallery::Picture;
use crate::store::{CaptureRow, CaptureState, PageRequest, check_name, printable};
use clap_complete::engine::{ArgValueCompleter, CompletionCandidate, PathCompleter, ValueCompleter as _};
use imu_core::sample::Channel;
use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};

/// The number of captures that are offered, the latest.
const OFFERED: u32 = 1000;
/// The number of characters of a note beside a capture.
const NOTE_CHARS: usize = 40;

/// Offers captures of the daemon that the command asks, which may have another database than the reading commands use.
pub(super) fn captures_of_daemon() -> ArgValueCompleter {
    ArgValueCompleter::new(|typed: &OsStr| offer(typed, &of_daemon().unwrap_or_default()))
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

/// A capture that is offered, with the members that a daemon's answer has.
#[derive(Debug, serde::Deserialize)]
struct Offered {
    id: i64,
    name: String,
    state: String,
    samples: u64,
    note: Option<String>,
}

impl From<CaptureRow> for Offered {
    fn from(row: CaptureRow) -> Self {
        let CaptureRow { id, name, state, samples, note, .. } = row;
        Self { id, name, state: state.name().to_owned(), samples, note }
    }
}

/// Returns the captures in the database that the command line means; none if it cannot be read.
fn of_database(typed: &OsStr, is_wanted: impl Fn(&CaptureRow) -> bool) -> Vec<CompletionCandidate> {
    offer(typed, &rows().into_iter().filter(is_wanted).map(Offered::from).collect::<Vec<_>>())
}

/// Returns the captures of the daemon that the command line means; none if it does not answer at once, or has another
/// database than the named data directory.
fn of_daemon() -> Option<Vec<Offered>> {
    let context = context();
    let base_url = context.daemon_url(option("--listen").as_deref().and_then(OsStr::to_str)).ok()?;
    context.refuse_another(&base_url, PATIENCE).ok()?;
    let path = format!("/v1/captures?limit={OFFERED}");
    let answer = client::get_within(&base_url, &path, PATIENCE).ok()?;
    serde_json::from_value(answer["captures"].clone()).ok()
}

/// Returns those that begin with what was typed.
fn offer(typed: &OsStr, rows: &[Offered]) -> Vec<CompletionCandidate> {
    let latest = (!rows.is_empty()).then(|| CompletionCandidate::new("latest"));
    beginning(typed, rows.iter().map(candidate).chain(latest))
}

/// A name that a shell would take apart, or that means another capture, is offered as its id.
fn candidate(row: &Offered) -> CompletionCandidate {
    let is_plain = |character: char| character.is_alphanumeric() || "-_.+,".contains(character);
    let plain = row.name.chars().all(is_plain) && !row.name.starts_with('-') && check_name(&row.name).is_ok();
    let (value, mut about) =
        if plain { (row.name.clone(), String::new()) } else { (row.id.to_string(), format!("{}, ", row.name)) };
    about = format!("{about}{}, {}", row.state, counted(row.samples, "sample", "samples"));
    if let Some(note) = &row.note {
        about = format!("{about}, {}", note.chars().take(NOTE_CHARS).collect::<String>());
    }
    CompletionCandidate::new(value).help(Some(printable(&about).into()))
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
    let path = |name| option(name).map(PathBuf::from);
    Context { data_dir: path("--data-dir"), config: path("--config"), ..Context::default() }
}

/// Returns the value that the command line gives to an option, the last one.
fn option(name: &str) -> Option<OsString> {
    let (mut words, mut last) = (words().peekable(), None);
    while let Some(word) = words.next() {
        let Some(rest) = word.as_bytes().strip_prefix(name.as_bytes()) else { continue };
        last = match rest {
            // Bash makes a word of its own of `=`.
            [] => {
                words.next_if(|word| word == "=");
                words.next()
            }
            [b'=', value @ ..] => Some(OsStr::from_bytes(value).to_owned()),
            _ => last,
        };
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(candidates: &[CompletionCandidate]) -> Vec<String> {
        candidates.iter().map(|one| one.get_value().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn a_name_is_offered_only_if_it_means_its_capture() {
        let offered = |name: &str, note: &str| {
            let (name, note) = (name.to_owned(), Some(note.to_owned()));
            candidate(&Offered { id: 12, name, state: "complete".to_owned(), samples: 5, note })
        };
        let value = |name: &str| offered(name, "").get_value().to_string_lossy().into_owned();
        for (name, expected) in
            [("desk", "desk"), ("+7", "+7"), ("-7", "12"), ("a b", "12"), ("7", "12"), ("latest", "12")]
        {
            assert_eq!(value(name), expected);
        }
        let about = offered("a\u{1b}[2Jb", "x\ty").get_help().unwrap().to_string();
        assert!(!about.contains(char::is_control), "{about:?}");
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
