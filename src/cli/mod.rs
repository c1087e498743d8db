//! The command line: one file per command. The only owner of exit codes.

mod allan;
mod analysis;
pub mod args;
mod backup;
mod by_hand;
mod calibrate;
mod calibration;
mod captures;
mod check;
mod client;
mod complete;
mod connection;
mod cost;
mod demo;
mod diagnose;
mod diagnose_limits;
mod diagnose_text;
mod emulate;
mod export;
mod figures;
mod filter_parameters;
mod generate;
mod hangup;
mod import;
mod jobs;
mod junit;
mod limits;
mod model;
mod noise;
mod notify;
mod output;
mod part;
mod place;
mod plot;
mod probe;
mod progress;
mod recover;
mod reference;
mod report;
mod run;
mod samples;
mod sealed;
mod show;
mod simulate;
mod source;
mod status;
mod subject;
mod table;
mod trial;
mod trial_motion;
mod trial_on;
mod trial_part;
mod trial_posed;
mod trial_show;
mod validation;
mod within;
mod worker;

use crate::config::{Config, ConfigError, Environment, MACHINE_TOKEN, Overrides};
use crate::daemon::DaemonError;
use crate::daemon::import::ImportError;
use crate::jobs::JobError;
use crate::store::{CaptureRow, Page, PageRequest, Reader, StoreError, StoreErrorKind, printable};
use args::{Cli, Command};
use clap::Parser as _;
use imu_files::recording::{ColumnMap, MessageDefinition, RecordingError, open_regular};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::OnceLock;

/// How a command ended, if it did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// All is done.
    Done,
    /// Done, but data was rejected or lost, or a check found something.
    WithLoss,
    /// Done, but a given limit is missed.
    LimitMissed,
}

/// Kinds of failure that a script can distinguish by the exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// Any other failure.
    Other,
    /// The command line is wrong.
    Usage,
    /// The daemon is not there.
    Unreachable,
    /// The database cannot be created, or another process holds it.
    CannotCreate,
    /// Reading or writing failed.
    InputOutput,
    /// The configuration is wrong, or the database has a newer version.
    Configuration,
}

impl Failure {
    /// Returns the exit code (docs/formats.md; the numbers above 63 are those of sysexits.h).
    fn code(self) -> u8 {
        match self {
            Self::Other => 1,
            Self::Usage => 2,
            Self::Unreachable => 69,
            Self::CannotCreate => 73,
            Self::InputOutput => 74,
            Self::Configuration => 78,
        }
    }
}

/// A failure with its kind; added to an error's context by the code that knows the kind.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct CliError {
    /// The kind of failure.
    pub failure: Failure,
    /// The message for the user.
    pub message: String,
}

/// Returns the error of a wrong command line.
fn usage(message: impl Into<String>) -> anyhow::Error {
    CliError { failure: Failure::Usage, message: message.into() }.into()
}

/// Returns the error of a command that failed.
fn failed(message: impl Into<String>) -> anyhow::Error {
    CliError { failure: Failure::Other, message: message.into() }.into()
}

/// The options that any command may need besides its own arguments.
#[derive(Debug, Clone, Default)]
pub struct Context {
    /// `--data-dir`.
    pub data_dir: Option<std::path::PathBuf>,
    /// `--config`.
    pub config: Option<std::path::PathBuf>,
    /// `--json`.
    pub json: bool,
    /// `--columns`.
    pub columns: ColumnMap,
    /// `--message-definition`.
    pub definitions: Vec<MessageDefinition>,
    /// Whether the command takes recordings in counts.
    pub takes_counts: bool,
    /// `--from`, `--to` and `--channels`.
    pub part: part::Part,
    /// The database that is read, once it was searched for: a command reads one database.
    place: OnceLock<place::Place>,
}

impl Context {
    /// Returns the same at any time: for another recording than the one of which a part is wanted.
    fn at_any_time(&self) -> Self {
        Self { part: part::Part { channels: self.part.channels.clone(), ..part::Part::default() }, ..self.clone() }
    }

    /// Returns the effective configuration.
    fn load(&self, overrides: &Overrides) -> Result<Config, ConfigError> {
        crate::config::load(self.config.as_deref(), &Environment::from_process(), overrides)
    }

    /// Returns the path of the database that this user's commands write.
    fn database(&self) -> Result<PathBuf, ConfigError> {
        Ok(Environment::from_process().data_dir(self.data_dir.as_deref())?.join("vn100d.db"))
    }

    /// Returns the named capture. A path that leads to no file, or to a folder, a pipe or a device, is refused as such:
    /// the user meant a recording.
    fn capture(&self, named: &str) -> anyhow::Result<(Reader, CaptureRow)> {
        let found = self.reader().and_then(|reader| {
            let row = reader.capture(reader.resolve(named)?)?;
            Ok((reader, row))
        });
        found.map_err(|error| {
            let is_unknown =
                matches!(error.downcast_ref(), Some(StoreError::NoDatabase(_) | StoreError::NoSuchCapture(_)));
            let path = Path::new(named);
            // No capture's name contains a `/`.
            let is_path = named.contains('/') || path.exists();
            match open_regular(path) {
                Err(refused) if is_unknown && is_path => refused.into(),
                _ => error,
            }
        })
    }

    /// Returns the token for the daemon at `--listen`, or at the configured address; empty if there is none, or none
    /// for that address ([`may_have_token`]); then its file is not read. A daemon on this machine gets the machine's
    /// token if the configuration, which may be the user's own, has none.
    fn token_for(&self, listen: Option<&str>) -> anyhow::Result<String> {
        let named = address(listen)?;
        if let Some(named) = named {
            let configured = self.load(&Overrides { without_token: true, ..Overrides::default() })?.http.listen;
            if !may_have_token(named, configured, self.config.is_some()) {
                return Ok(String::new());
            }
        }
        let http = self.load(&Overrides::default())?.http;
        let is_here = named.unwrap_or(http.listen).ip().to_canonical().is_loopback();
        let token = if http.token.is_empty() && is_here {
            // A user who may not read it gets a message if the daemon requires it.
            crate::config::token_in(Path::new(MACHINE_TOKEN)).unwrap_or_default()
        } else {
            http.token
        };
        Ok(token.secret().to_owned())
    }

    /// Returns the daemon's address.
    fn daemon_url(&self, listen: Option<&str>) -> anyhow::Result<String> {
        let config = self.load(&Overrides { listen: address(listen)?, without_token: true, ..Overrides::default() })?;
        Ok(format!("http://{}", config.http.listen))
    }
}

/// Returns whether the daemon at a named address gets the token, which is sent unencrypted: a daemon on this machine,
/// the configured one, or any if the configuration was named too.
fn may_have_token(named: SocketAddr, configured: SocketAddr, configuration_named: bool) -> bool {
    configuration_named || named.ip().to_canonical().is_loopback() || named == configured
}

/// Returns `--listen` as an address.
fn address(listen: Option<&str>) -> Result<Option<SocketAddr>, CliError> {
    let Some(text) = listen else { return Ok(None) };
    let text =
        if let Some(port) = text.strip_prefix("localhost:") { format!("127.0.0.1:{port}") } else { text.to_owned() };
    text.parse().map(Some).map_err(|_| CliError {
        failure: Failure::Usage,
        message: format!("--listen {text}: expected an address with a port, such as 127.0.0.1:8100 or [::1]:8100"),
    })
}

/// Returns how long the sensor was at rest and how long it moved, as a line; empty if motion is unknown.
fn stillness(at_rest_s: Option<f64>, moving_s: Option<f64>) -> String {
    let times_s = at_rest_s.zip(moving_s);
    times_s.map_or_else(String::new, |(at_rest_s, moving_s)| {
        format!("At rest {at_rest_s:.1} s, in motion {moving_s:.1} s; only the time at rest is analysed.\n")
    })
}

/// Returns every item of a list that comes in pages.
fn all<T>(mut page: impl FnMut(&PageRequest) -> Result<Page<T>, StoreError>) -> Result<Vec<T>, StoreError> {
    let (mut items, mut request) = (Vec::new(), PageRequest::first());
    loop {
        let next = page(&request)?;
        items.extend(next.rows);
        request.cursor = next.next;
        if request.cursor.is_none() {
            return Ok(items);
        }
    }
}

/// Returns a table for display.
fn table(header: &[&str]) -> table::Table {
    table::Table::new(header)
}

/// Prints only JSON on standard output.
fn print_json<T: serde::Serialize>(value: &T) -> anyhow::Result<()> {
    use std::io::Write as _;
    let mut stdout = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut stdout, value)?;
    writeln!(stdout)?;
    Ok(())
}

/// Parses the arguments, runs the command, and reports failures.
pub fn main() -> ExitCode {
    use std::io::Write as _;
    // If a shell asks for completions, this prints them and ends the process.
    generate::environment().complete();
    let cli = Cli::parse();
    match run(cli) {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::WithLoss) => ExitCode::from(3),
        Ok(Outcome::LimitMissed) => ExitCode::from(4),
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Standard error may be a terminal that was closed; the exit code still reports the failure.
            let _ = writeln!(std::io::stderr(), "error: {}", sentence(&error));
            ExitCode::from(failure(&error).code())
        }
    }
}

/// Returns the error and its causes in one line. A cause that the error itself names is not repeated, and text that
/// SQLite quotes from a damaged database may contain line ends.
fn sentence(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string).filter(|cause| !cause.is_empty()) {
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    printable(text.trim())
}

/// Returns whether a pipe was closed: `vn100d … | head` ends quietly.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<std::io::Error>())
        .any(|cause| cause.kind() == std::io::ErrorKind::BrokenPipe)
}

fn run(cli: Cli) -> anyhow::Result<Outcome> {
    let (columns, definitions) = source::stated(&cli)?;
    let takes_counts = matches!(cli.command, Command::Calibrate(_));
    let part = part::Part::stated(&cli.command)?;
    let (data_dir, config, json) = (cli.data_dir, cli.config, cli.json);
    let context = Context { data_dir, config, json, columns, definitions, takes_counts, part, place: OnceLock::new() };
    match cli.command {
        Command::Run(args) => run::run(&context, &args),
        Command::Demo(args) => demo::run(&context, &args),
        Command::Emulate(args) => emulate::run(&args),
        Command::Probe(args) => probe::run(&context, &args),
        Command::Status(args) => {
            status::run(&context.daemon_url(args.listen.as_deref())?, context.json)?;
            Ok(Outcome::Done)
        }
        Command::Jobs(args) => {
            jobs::run(&context.daemon_url(args.listen.as_deref())?, context.json)?;
            Ok(Outcome::Done)
        }
        Command::Start(args) => by_hand::start(&context, &args),
        Command::Stop(args) => by_hand::stop(&context, &args),
        Command::Pin(args) => by_hand::pin(&context, &args, true),
        Command::Unpin(args) => by_hand::pin(&context, &args, false),
        Command::Rename(args) => by_hand::rename(&context, &args),
        Command::Note(args) => by_hand::note(&context, &args),
        Command::Delete(args) => by_hand::delete(&context, &args),
        Command::Import(args) => import::run(&context, &args),
        Command::Export(args) => export::run(&context, &args),
        Command::Captures => captures::run(&context),
        Command::Show { capture, rate, .. } => show::run(&context, &capture, rate),
        Command::Allan(args) => allan::run(&context, &args),
        Command::Noise(args) => match args.consistent {
            Some(pair) => filter_parameters::run(&context, &args, pair),
            None => noise::run(&context, &args),
        },
        Command::Plot(args) => plot::run(&context, &args),
        Command::Report(args) => report::run(&context, &args),
        Command::Simulate(args) => simulate::run(&context, &args),
        Command::Trial(args) => trial::run(&context, &args),
        Command::TrialPart(args) => trial_part::run(&context, &args),
        Command::Worker(args) => worker::run(&args),
        Command::Model(args) => model::run(&context, &args),
        Command::Diagnose(args) => diagnose::run(&context, &args),
        Command::Calibrate(args) => calibrate::run(&context, &args),
        Command::Cost(args) => cost::run(&context, &args),
        Command::Backup(args) => backup::run(&context, &args),
        Command::Check { database } => check::run(&context, database),
        Command::Recover(args) => recover::run(&context, args),
        Command::Notify => notify::run(&context),
        Command::Completions(args) => generate::completions(&args),
        Command::Generate(args) => generate::generate(&args),
    }
}

/// Returns the kind of a failure, from the typed error that caused it.
fn failure(error: &anyhow::Error) -> Failure {
    error.chain().find_map(kind_of).unwrap_or(Failure::Other)
}

fn kind_of(cause: &(dyn std::error::Error + 'static)) -> Option<Failure> {
    if let Some(error) = cause.downcast_ref::<CliError>() {
        return Some(error.failure);
    }
    if let Some(error) = cause.downcast_ref::<client::ClientError>() {
        return Some(error.failure());
    }
    if cause.is::<ConfigError>() {
        return Some(Failure::Configuration);
    }
    if let Some(error) = cause.downcast_ref::<StoreError>() {
        return store_failure(error);
    }
    if let Some(error) = cause.downcast_ref::<ImportError>() {
        return match error {
            ImportError::Store(error) => store_failure(error),
            ImportError::Recording(error) => recording_failure(error),
            ImportError::Sampling(_) => Some(Failure::Usage),
            _ => None,
        };
    }
    if let Some(error) = cause.downcast_ref::<RecordingError>() {
        return recording_failure(error);
    }
    if let Some(JobError::Store(error)) = cause.downcast_ref::<JobError>() {
        return store_failure(error);
    }
    if let Some(error) = cause.downcast_ref::<DaemonError>() {
        return match error {
            DaemonError::Store(error) => store_failure(error),
            DaemonError::Jobs(JobError::Store(error)) => store_failure(error),
            DaemonError::Jobs(_) => Some(Failure::Other),
            DaemonError::Output(_) => Some(Failure::Configuration),
            DaemonError::Disk => Some(Failure::InputOutput),
            DaemonError::Notify(_) | DaemonError::Reader(_) => Some(Failure::InputOutput),
            DaemonError::Listen { .. } => Some(Failure::InputOutput),
            DaemonError::Share(error) if error.is_configuration() => Some(Failure::Configuration),
            DaemonError::Share(_) => Some(Failure::InputOutput),
            DaemonError::Control(_) => Some(Failure::Other),
        };
    }
    cause.is::<std::io::Error>().then_some(Failure::InputOutput)
}

/// Returns the kind of a recording's failure. Wrong content is no failure of the disk, although a decompressor reports
/// it as an error of reading.
fn recording_failure(error: &RecordingError) -> Option<Failure> {
    use std::io::ErrorKind::{InvalidData, InvalidInput, Other};
    match error {
        RecordingError::NoFile { .. } => Some(Failure::InputOutput),
        RecordingError::Read { source, .. } if matches!(source.kind(), InvalidData | InvalidInput | Other) => {
            Some(Failure::Other)
        }
        // If the system refused, its own error follows in the chain.
        _ => None,
    }
}

fn store_failure(error: &StoreError) -> Option<Failure> {
    match error.kind() {
        StoreErrorKind::CannotCreate => Some(Failure::CannotCreate),
        StoreErrorKind::NewerSchema => Some(Failure::Configuration),
        // A full or busy disk is a failure of input and output.
        StoreErrorKind::Io | StoreErrorKind::Unavailable => Some(Failure::InputOutput),
        _ => Some(Failure::Other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_token_goes_to_no_daemon_that_was_only_named() {
        let at = |text: &str| text.parse::<SocketAddr>().unwrap();
        let configured = at("192.0.2.7:8100");
        for (named, named_too, may) in [
            ("192.0.2.8:8100", false, false),
            ("192.0.2.7:8101", false, false),
            ("192.0.2.7:8100", false, true),
            ("127.0.0.1:9", false, true),
            ("[::1]:9", false, true),
            ("[::ffff:127.0.0.1]:9", false, true),
            ("192.0.2.8:8100", true, true),
        ] {
            assert_eq!(may_have_token(at(named), configured, named_too), may, "{named} {named_too}");
        }
    }

    #[test]
    fn an_error_is_one_line_and_states_no_cause_twice() {
        let io = || std::io::Error::from_raw_os_error(5);
        let error = StoreError::Create { path: "/data/vn100d.db.lock".into(), source: io() };
        let line = sentence(&anyhow::Error::from(error));
        assert_eq!(
            line,
            "cannot create /data/vn100d.db.lock: Input/output error (os error 5); see that its directory exists, has room and may be written to"
        );
        let error = anyhow::Error::from(io()).context("the token\n  file cannot be read");
        assert_eq!(sentence(&error), "the token file cannot be read: Input/output error (os error 5)");
    }

    #[test]
    fn a_disk_that_fails_is_no_file_that_cannot_be_created() {
        let code = |errno| {
            let source = std::io::Error::from_raw_os_error(errno);
            failure(&StoreError::Create { path: "x".into(), source }.into()).code()
        };
        assert_eq!([5, 28, 13, 2].map(code), [74, 74, 73, 73]);
    }
}
