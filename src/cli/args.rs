//! Arguments: the command line as parsed by `clap`.

use super::complete;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use imu_core::sample::StatedSampling;
use imu_core::units::parse_duration;
use imu_diagnosis::model_fit::effects_named;
use imu_files::export::Target;
use imu_model::EffectKind;
use imu_noise::allan::{Estimator, TauSpacing};
use std::path::PathBuf;
use std::time::Duration;

mod by_hand;
mod calibrate;
mod cost;
mod diagnose;
mod noise;
mod part;
mod pictures;
mod recordings;
mod validation;

pub use by_hand::{DeleteArgs, NoteArgs, PinArgs, RenameArgs, StartArgs, StopArgs};
pub use calibrate::{CalibrateArgs, Form};
pub use cost::{CostArgs, Tolerances};
pub use diagnose::DiagnoseArgs;
pub use noise::{ConsistentPair, NoiseArgs, SheetChoice, Undecided};
pub use part::{ChannelList, PartArgs};
pub use pictures::{PlotArgs, ReportArgs};
pub use recordings::{ExportArgs, ImportArgs, TimeOrigin};
pub use validation::ValidationArgs;

/// Captures a VectorNav VN-100 unattended into SQLite and reports its noise parameters.
#[derive(Debug, Parser)]
#[command(name = "vn100d", version, max_term_width = 100, arg_required_else_help = true, after_help = AFTER_HELP)]
pub struct Cli {
    /// Directory of the database vn100d.db (default: $VN100D_DATA_DIR, else $STATE_DIRECTORY, else $XDG_STATE_HOME/vn100d, else ~/.local/state/vn100d; commands that read may find that of a running daemon, docs/cli.md)
    #[arg(long, global = true, value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
    /// Configuration file (default: $VN100D_CONFIG, else $XDG_CONFIG_HOME/vn100d/vn100d.toml, else /etc/vn100d/vn100d.toml, else built-in values)
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print only JSON on standard output
    #[arg(long, global = true)]
    pub json: bool,
    /// For a recording's file: the meaning of its columns or of its messages' fields, as in 'Time [ms]=time_ms,ax=accel_x_g' by
    /// names, '#3=gyro_x_dps' by position, 'left.gyro.x=gyro_x_dps' by the path in a message. May be given several times
    #[arg(long, global = true, value_name = "FOREIGN=NAME,…")]
    pub columns: Vec<String>,
    /// For a bag's file: the definition of a message type that it lacks: the type's .msg file, named after the type, or
    /// 'package/msg/Name=FILE.msg'. May be given several times
    #[arg(long, global = true, value_name = "[TYPE=]FILE.msg")]
    pub message_definition: Vec<String>,
    /// The command to run
    #[command(subcommand)]
    pub command: Command,
}

const AFTER_HELP: &str = "\
Examples:
  vn100d demo                           no hardware: an emulated sensor, a five-hour capture in a minute
  vn100d run --capture 5h               record the sensor that is plugged in for five hours
  vn100d noise latest                   its noise parameters, once recorded
  curl localhost:8100/v1/captures/latest/noise

Exit codes: 0 done, 1 failed, 2 usage, 3 finished but data was rejected or lost, 4 a given limit is missed,
69 daemon not reachable, 73 database cannot be created or locked, 74 input/output error, 78 bad configuration or newer database";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the daemon: captures, background jobs, HTTP
    Run(RunArgs),
    /// Try everything without hardware: emulated sensor, daemon, five-hour capture in accelerated time, noise parameters
    Demo(DemoArgs),
    /// Emulate a VN-100 on a pseudo-terminal
    Emulate(EmulateArgs),
    /// Find the sensor: port, baud rate, model, serial number, firmware, relevant registers
    Probe(ProbeArgs),
    /// Print the status of the running daemon
    Status(ClientArgs),
    /// List the running daemon's background jobs
    Jobs(ClientArgs),
    /// Start a capture of the running daemon
    Start(StartArgs),
    /// Stop the capture that runs or waits
    Stop(StopArgs),
    /// Keep captures from deletion
    Pin(PinArgs),
    /// End the protection of captures from deletion
    Unpin(PinArgs),
    /// Give a capture another name
    Rename(RenameArgs),
    /// Write a note about a capture, such as "on foam, 23 °C"
    Note(NoteArgs),
    /// Delete captures with all their samples
    Delete(DeleteArgs),
    /// Import a recording as a capture: CSV and other tables, raw $VN… lines or bytes of the port, ROS bags, logs of PX4
    /// and ArduPilot (docs/recordings.md)
    Import(ImportArgs),
    /// Write a capture's samples for other programs: CSV, NDJSON, Parquet, MCAP
    Export(ExportArgs),
    /// List the captures
    Captures,
    /// Show one capture with its segments, gaps and counts
    Show {
        /// Id, name, `latest`, or the path of a recording
        #[arg(add = complete::captures_and_files())]
        capture: String,
        /// Rate of a recording in Hz: for one without stamps, or to override its stamps
        #[arg(long, value_name = "HZ", value_parser = rate)]
        rate: Option<f64>,
        /// The part that is shown
        #[command(flatten)]
        part: PartArgs,
    },
    /// Print Allan deviation curves of a capture or a recording
    Allan(AllanArgs),
    /// Print noise parameters N, B, K of a capture or a recording
    Noise(NoiseArgs),
    /// Draw one plot of a capture or a recording, as SVG or PNG
    Plot(PlotArgs),
    /// Write one self-contained page of a capture or a recording, for a lab report
    Report(ReportArgs),
    /// Simulate samples of a sensor model: noise, effects, motion
    Simulate(SimulateArgs),
    /// Fit, show, compare and export sensor models
    Model(ModelArgs),
    /// Report where a recording and a simulator differ, which effect the simulator lacks, and how far the gap shrinks
    /// with it
    Diagnose(DiagnoseArgs),
    /// Report scale factors, misalignment and bias with intervals from a tumble or beside poses, and write what corrects them
    Calibrate(CalibrateArgs),
    /// Report what a sensor model's errors cost: growth of attitude, velocity and position errors of unaided integration
    /// at rest, by cause, and against limits
    Cost(CostArgs),
    /// Check the diagnosis blindly: sealed cases, diagnosed without their key, then scored with it
    Trial(TrialArgs),
    /// Run one part of a trial in a separate process
    #[command(hide = true)]
    TrialPart(TrialPartArgs),
    /// Do one piece of heavy work in a separate process
    #[command(hide = true)]
    Worker(WorkerArgs),
    /// Copy the database, also while a daemon writes it
    Backup(BackupArgs),
    /// Check structure, checksums and accounting of a database; reads only
    Check {
        /// The database (default: that of the data directory)
        #[arg(value_name = "DB")]
        database: Option<PathBuf>,
    },
    /// Salvage everything intact from a damaged database into a new one
    Recover(RecoverArgs),
    /// Send a test message to the receivers of the configuration's [notify]
    Notify,
    /// Print completions for a shell: bash, zsh, fish, elvish or powershell
    Completions(CompletionsArgs),
    /// Write manual pages or completions into a folder, for packages
    #[command(hide = true)]
    Generate(GenerateArgs),
}

/// Arguments of `completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    pub shell: clap_complete::Shell,
}

/// Arguments of `generate`.
#[derive(Debug, Args)]
pub struct GenerateArgs {
    /// `man` or `completions`
    pub what: String,
    /// Target folder
    pub dir: PathBuf,
}

/// Arguments of `run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Serial port, or a pattern such as /dev/ttyUSB* (default: the configuration's, else what /dev/serial/by-id shows)
    #[arg(long, value_name = "PATH")]
    pub device: Option<String>,
    /// Address of the HTTP interface (default: the configuration's, else 127.0.0.1:8100)
    #[arg(long, value_name = "ADDR")]
    pub listen: Option<String>,
    /// Start a capture of this sample time at once, such as 5h (an unfinished one is continued instead)
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub capture: Option<Duration>,
    /// Continue if the terminal is closed or the SSH session is lost, which otherwise end the daemon cleanly
    #[arg(long)]
    pub keep_on_hangup: bool,
    /// Run this many times faster than real time; only with an emulator at the same speed
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = speed)]
    pub speed: f64,
}

/// Arguments of `demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// End when all is done instead of serving until Ctrl-C
    #[arg(long)]
    pub once: bool,
    /// Address of the HTTP interface; port 0 takes any free one (default: 127.0.0.1:8100, or a free port if that is
    /// taken)
    #[arg(long, value_name = "ADDR")]
    pub listen: Option<String>,
    /// Speed, as a multiple of real time
    #[arg(long, value_name = "X", default_value_t = 1000.0, value_parser = speed)]
    pub speed: f64,
    /// Sample time to capture
    #[arg(long, value_name = "DURATION", default_value = "5h", value_parser = parse_duration)]
    pub duration: Duration,
    /// Seed of the emulated sensor's noise
    #[arg(long, value_name = "N", default_value_t = DEMO_SEED)]
    pub seed: u64,
}

/// The demo's seed. Another seed gives other noise; with 95 % intervals, about one in twenty parameters then lies
/// outside.
pub const DEMO_SEED: u64 = 2;

/// Arguments of `emulate`.
#[derive(Debug, Args)]
pub struct EmulateArgs {
    /// Make this path a link to the terminal
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,
    /// Sensor model (JSON) whose noise it sends (default: a desk VN-100)
    #[arg(long, value_name = "FILE", conflicts_with = "replay", add = complete::models())]
    pub model: Option<PathBuf>,
    /// Output rate at power-up in Hz (ASCII; the host may configure another)
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
    /// Speed, as a multiple of real time
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = speed)]
    pub speed: f64,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// End after this time of the emulated sensor (default: run until Ctrl-C)
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub duration: Option<Duration>,
    /// Send the recorded raw lines of this file (plain or .gz) unchanged; configuration is acknowledged only
    #[arg(long, value_name = "FILE")]
    pub replay: Option<PathBuf>,
    /// Inject the faults of this script, such as `10s unplug 10s` (docs/cli.md); `-` reads lines from standard input
    /// and obeys them at once
    #[arg(long, value_name = "FILE|-")]
    pub faults: Option<PathBuf>,
    /// Log every frame: its number, tick, device time, and fate
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Baud rate at power-up
    #[arg(long, value_name = "BAUD", default_value_t = 115_200)]
    pub baud: u32,
    /// Garble input and output while the terminal has another baud rate, as a real line does
    #[arg(long)]
    pub strict_baud: bool,
}

/// Arguments of `probe`.
#[derive(Debug, Args)]
pub struct ProbeArgs {
    /// Serial port or pattern (default: the configuration's, else what /dev/serial/by-id shows)
    #[arg(long, value_name = "PATH")]
    pub device: Option<String>,
}

/// Arguments of commands that query the daemon.
#[derive(Debug, Args)]
pub struct ClientArgs {
    /// The daemon's address (default: the configuration's, else 127.0.0.1:8100)
    #[arg(long, value_name = "ADDR")]
    pub listen: Option<String>,
}

/// Forms of noise parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum NoiseFormat {
    Table,
    Json,
    Csv,
    /// Text for a program.
    For(Target),
}

/// Returns a parser for the name of one of these values.
fn one_of<T: Clone + Send + Sync + 'static>(values: Vec<(PossibleValue, T)>) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(values.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>()).try_map(move |given| {
        let found = values.iter().find(|(name, _)| name.get_name() == given);
        found.map(|(_, value)| value.clone()).ok_or("expected one of the names")
    })
}

/// Returns a parser for the name of a program.
fn target() -> impl TypedValueParser<Value = Target> {
    one_of(targets().collect())
}

fn targets() -> impl Iterator<Item = (PossibleValue, Target)> {
    Target::ALL.into_iter().map(|target| (PossibleValue::new(target.name()).help(target.about()), target))
}

fn noise_format() -> impl TypedValueParser<Value = NoiseFormat> {
    let own = [("table", NoiseFormat::Table), ("json", NoiseFormat::Json), ("csv", NoiseFormat::Csv)];
    let own = own.into_iter().map(|(name, format)| (name.into(), format));
    one_of(own.chain(targets().map(|(name, target)| (name, NoiseFormat::For(target)))).collect())
}

fn estimator() -> impl TypedValueParser<Value = Estimator> {
    one_of(Estimator::ALL.map(|estimator| (estimator.name().into(), estimator)).to_vec())
}

fn taus() -> impl TypedValueParser<Value = TauSpacing> {
    let values = [
        ("octave", "Powers of two", TauSpacing::Octave),
        ("log", "About twenty per decade", TauSpacing::Log),
        ("all", "Every averaging time", TauSpacing::All),
    ];
    one_of(values.map(|(name, help, taus)| (PossibleValue::new(name).help(help), taus)).to_vec())
}

/// Forms of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Format {
    Table,
    Json,
    Csv,
}

/// Arguments of `allan`.
#[derive(Debug, Args)]
pub struct AllanArgs {
    /// Id, name, `latest`, or the path of a recording; several of one sensor give one result
    #[arg(required = true, value_name = "CAPTURE", add = complete::captures_and_files())]
    pub captures: Vec<String>,
    /// Rate of recordings without stamps in Hz
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// The part of each capture
    #[command(flatten)]
    pub part: PartArgs,
    /// Estimator
    #[arg(long, value_parser = estimator(), default_value = "oadev")]
    pub estimator: Estimator,
    /// Averaging times
    #[arg(long, value_parser = taus(), default_value = "log")]
    pub taus: TauSpacing,
    /// Form of the output
    #[arg(long, value_enum, default_value_t = Format::Table)]
    pub format: Format,
}

/// The sampling of gyroscope and accelerometer, for all commands that fit noise parameters.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct SamplingArgs {
    /// Gyroscope and accelerometer send means of this many samples (register 85 of a VN-100)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub filter_window: Option<u32>,
    /// Rate at which the sensor takes these samples in Hz (default: the capture's, else 800)
    #[arg(long, value_name = "HZ", value_parser = rate, requires = "filter_window")]
    pub internal_rate: Option<f64>,
}

impl SamplingArgs {
    /// Returns the statement of the options, if they are given.
    pub fn stated(self) -> Option<StatedSampling> {
        Some(StatedSampling { filter_window: self.filter_window?, internal_rate_hz: self.internal_rate })
    }
}

/// Arguments of `simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// Sensor model (JSON; default: a desk VN-100)
    #[arg(long, value_name = "FILE", add = complete::models())]
    pub model: Option<PathBuf>,
    /// Sample time to simulate, such as 5h (default: as long as the motion's file)
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub duration: Option<Duration>,
    /// Output rate in Hz (default: the model's)
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// Seed: the same seed gives the same samples
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Motion that the sensor follows: a file (docs/simulation.md), still, tumble, poses or rate-table (default: none, at rest without gravity or Earth rate)
    #[arg(long, value_name = "FILE|NAME")]
    pub motion: Option<String>,
    /// Write the motion, with one row per sample: the reference of a diagnosis
    #[arg(long, value_name = "FILE")]
    pub motion_out: Option<PathBuf>,
    /// Temperature in °C, or a file with its course: time_s, temperature_c
    #[arg(long, value_name = "FILE|°C", allow_hyphen_values = true)]
    pub temperature: Option<String>,
    /// Write CSV here; `-` is standard output
    #[arg(long, value_name = "FILE", conflicts_with = "into_db")]
    pub out: Option<PathBuf>,
    /// Store a capture of this name in the database, marked as simulated
    #[arg(long, value_name = "NAME")]
    pub into_db: Option<String>,
    /// Replace files that exist
    #[arg(long)]
    pub force: bool,
}

/// Arguments of `trial`.
#[derive(Debug, Args)]
pub struct TrialArgs {
    /// Number of cases; docs/trial.md has the share of each class
    #[arg(long, value_name = "N", default_value_t = 250)]
    pub cases: usize,
    /// Seed of the cases (default: the time in ms; it is printed)
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Only these, separated by commas: none, known, single, pair, several, superfluous, size, outside, kept, or names
    /// of effects (docs/trial.md); default: all but kept
    #[arg(long, value_name = "NAMES", default_value = "")]
    pub kinds: String,
    /// A frozen set of cases that others can compare with: 2026
    #[arg(long, value_name = "NAME", conflicts_with_all = ["cases", "seed", "kinds", "samples", "motion", "on"])]
    pub suite: Option<String>,
    /// Use cases with a known motion: scale factor, misalignment, g-sensitivity and similar effects; a fifth of the
    /// cases have no effect, half one of the library, a fifth two, a tenth one outside it
    #[arg(long, conflicts_with = "html")]
    pub motion: bool,
    /// Impose the effects on this recording instead of on a simulated one: id, name, `latest`, or a file's path; with
    /// --motion also give --reference
    #[arg(long, value_name = "CAPTURE|FILE", add = complete::captures_and_files())]
    pub on: Option<String>,
    /// Poses of the recording that --on names (docs/formats.md): with --motion, each case has scale factors, cross-axis
    /// sensitivity, bias or latency on top of the real motion
    #[arg(long, value_name = "FILE", requires_all = ["motion", "on"], conflicts_with_all = ["samples", "truth"])]
    pub reference: Option<PathBuf>,
    /// Rate of a recording in Hz: for one without stamps, or to override its stamps
    #[arg(long, value_name = "HZ", value_parser = rate, requires = "on")]
    pub rate: Option<f64>,
    /// The part of that recording
    #[command(flatten)]
    pub part: PartArgs,
    /// Samples per case, 10000 or more (default: drawn, 27 min to 5 h; of a recording 65536, or all if it is shorter)
    #[arg(long, value_name = "N")]
    pub samples: Option<usize>,
    /// Number of cases diagnosed at a time
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub threads: usize,
    /// Also measure how much the true effects would close; takes twice as long
    #[arg(long)]
    pub truth: bool,
    /// Also record each case with a gap again, simulate its corrected model, and diagnose both; takes five times as
    /// long
    #[arg(long, conflicts_with = "motion")]
    pub again: bool,
    /// Write the score as a page
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Keep manifest, diagnoses, keys and score in this folder
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// End with exit code 3 if this rate is lower, such as right_first=0.97; may be repeated
    #[arg(long, value_name = "NAME=SHARE", value_delimiter = ',')]
    pub at_least: Vec<String>,
    /// End with exit code 3 if this rate is higher, such as none_named=0.02; may be repeated
    #[arg(long, value_name = "NAME=SHARE", value_delimiter = ',')]
    pub at_most: Vec<String>,
}

/// Arguments of `worker`.
#[derive(Debug, Args)]
pub struct WorkerArgs {
    /// The calling process; this process ends with it
    #[arg(long)]
    pub parent: u32,
    /// Private memory that it may write to, bytes
    #[arg(long)]
    pub memory: u64,
    /// Processor time that it may use, s
    #[arg(long)]
    pub processor_s: u64,
    /// The work to do
    #[command(subcommand)]
    pub work: Work,
}

/// Work of a separate process.
#[derive(Debug, Clone, Subcommand)]
pub enum Work {
    /// Make a PNG of the SVG on standard input
    Png,
    /// Read the body of a request for a diagnosis
    #[command(name = "diagnosis-body")]
    DiagnosisBody {
        /// The body
        #[arg(long)]
        file: PathBuf,
    },
    /// Read a recording for an import, as standard input requests it
    Import,
    /// A background job
    Job {
        /// Its id
        #[arg(long)]
        id: i64,
        /// The database
        #[arg(long)]
        database: PathBuf,
        /// Identity of the database file
        #[arg(long)]
        file: String,
    },
}

/// Arguments of `trial-part`.
#[derive(Debug, Args)]
pub struct TrialPartArgs {
    /// The part to run
    #[arg(value_enum)]
    pub part: TrialPart,
    /// Cases with a known motion
    #[arg(long)]
    pub motion: bool,
    /// Cases on a recording beside poses
    #[arg(long)]
    pub posed: bool,
    /// Seed of the cases
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Number of cases in the trial
    #[arg(long, default_value_t = 0)]
    pub cases: usize,
    /// Only these
    #[arg(long, default_value = "")]
    pub kinds: String,
    /// Samples per case
    #[arg(long)]
    pub samples: Option<usize>,
    /// Folder with the stretches of a recording
    #[arg(long)]
    pub ground: Option<PathBuf>,
    /// The case, from 0
    #[arg(long, default_value_t = 0)]
    pub case: usize,
    /// The corrected model: where the diagnosis writes it, and what is tried again
    #[arg(long)]
    pub corrected: Option<PathBuf>,
}

/// Parts of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, strum::Display, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum TrialPart {
    /// Digests of all keys
    Manifest,
    /// A case's recording and model
    Case,
    /// The recording of a case without imposed effects, and the model fitted to it
    Own,
    /// The diagnosis of a recording and a model from standard input
    Diagnose,
    /// All keys
    Key,
    /// The discrepancy of a case under the model that has its effects
    Truth,
    /// Diagnoses of a second record and of a simulation of the corrected model
    Again,
}

/// Arguments of `model`.
#[derive(Debug, Args)]
pub struct ModelArgs {
    /// The command to run
    #[command(subcommand)]
    pub command: ModelCommand,
}

/// The commands of `model`.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// Fit a model to a capture or recording
    Fit {
        /// Id, name, `latest`, or the path of a recording; several of one sensor give one model
        #[arg(required = true, value_name = "CAPTURE", add = complete::captures_and_files())]
        captures: Vec<String>,
        /// Rate of recordings without stamps in Hz
        #[arg(long, value_name = "HZ", value_parser = rate)]
        rate: Option<f64>,
        /// The part of each capture
        #[command(flatten)]
        part: PartArgs,
        /// The sampling of the sensor
        #[command(flatten)]
        sampling: SamplingArgs,
        /// Effects to look for besides N, B, K and bias: all, or names of docs/effects.md separated by commas, such as
        /// tone,resonance
        #[arg(long, value_name = "NAMES", value_parser = effect_names, add = complete::effects())]
        effects: Option<EffectNames>,
        /// Name of the model (default: the capture's)
        #[arg(long, value_name = "NAME")]
        name: Option<String>,
        /// Write the model here (default: standard output)
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Replace an existing file
        #[arg(long)]
        overwrite: bool,
        /// Write a model that should not be used, with the reason in its provenance
        #[arg(long)]
        force: bool,
    },
    /// Show a model's parameters with their intervals
    Show {
        /// The model
        #[arg(add = complete::models())]
        file: PathBuf,
    },
    /// Print the differences of two models
    Diff {
        /// A model
        #[arg(add = complete::models())]
        first: PathBuf,
        /// Another model
        #[arg(add = complete::models())]
        second: PathBuf,
    },
    /// Write a model's parameters for another program
    Export {
        /// The model
        #[arg(add = complete::models())]
        file: PathBuf,
        /// The target program
        #[arg(long, value_parser = target())]
        format: Target,
    },
}

/// Effects by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EffectNames(pub Vec<EffectKind>);

/// Arguments of `backup`.
#[derive(Debug, Args)]
pub struct BackupArgs {
    /// The copy
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace an existing copy
    #[arg(long)]
    pub force: bool,
}

/// Arguments of `recover`.
#[derive(Debug, Args)]
pub struct RecoverArgs {
    /// The damaged database (default: that of the data directory)
    #[arg(value_name = "DB")]
    pub database: Option<PathBuf>,
    /// The new database
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace an existing new database
    #[arg(long)]
    pub force: bool,
}

fn speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|speed: &f64| (0.01..=10_000.0).contains(speed))
        .ok_or_else(|| "a number from 0.01 to 10000".to_owned())
}

fn effect_names(text: &str) -> Result<EffectNames, String> {
    effects_named(text).map(EffectNames)
}

fn share(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|share: &f64| (0.0..=1.0).contains(share))
        .ok_or_else(|| "a share from 0 to 1, such as 0.02".to_owned())
}

fn rate(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|rate: &f64| (0.001..=100_000.0).contains(rate))
        .ok_or_else(|| "a rate from 0.001 to 100000 Hz".to_owned())
}
