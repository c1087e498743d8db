//! `vn100d simulate`: a sensor model's output as CSV or as a capture.

use super::args::SimulateArgs;
use super::emulate::{load_model, stop_on_signal};
use super::figures::{counted, hertz};
use super::output::{Output, is_same, refuse_without_room};
use super::progress::{SAMPLES, bar};
use super::reference::reference;
use super::{Context, Outcome, failed, print_json, usage};
use crate::clock::{Clock as _, SystemClock};
use crate::store::{CaptureState, NewCapture, SOFTWARE, Store, StoreOptions};
use anyhow::Context as _;
use imu_core::sample::{CaptureConfiguration, Channel, SensorDescription};
use imu_diagnosis::Known;
use imu_model::motion::file::{Rows, Writer, between, rate_of, samples_per_row};
use imu_model::motion::{Course, Kind, Site, Temperatures, gravity};
use imu_model::simulator::records::Records;
use imu_model::simulator::{Block, Motion, SensorModel, Simulator};
use imu_pose::{External, Poses};
use indicatif::ProgressBar;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead as _, BufReader, BufWriter, Read as _, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Number of threads that make samples: with two cores a third would have none, and with four the writer keeps its own.
const THREADS: usize = 2;
/// Length of a motion's header at most.
const HEADER_BYTES: u64 = 4096;
/// The longest simulation, s: a hundred years. Stamps count nanoseconds from 1970 in 64 bits, which end in 2262.
const LONGEST_S: f64 = 3_155_760_000.0;

/// The sensor's motion.
enum Given {
    /// One of the motions that need no file.
    Course(Course),
    /// A file at a rate, with one row per `samples_per_row` of the sensor's own samples.
    File { path: String, rows: u64, has_temperature: bool, samples_per_row: u32 },
    /// Poses of another instrument, converted to rows at the output's rate.
    Poses { rows: Arc<[Motion]>, samples_per_row: u32 },
}

/// Runs to the end of the duration or of the motion.
pub(super) fn run(context: &Context, args: &SimulateArgs) -> anyhow::Result<Outcome> {
    let mut model = load_model(args.model.as_deref())?;
    let (out, motion_out) = outputs(args)?;
    let rate_hz = args.rate.unwrap_or(model.rate_hz);
    let internal_hz = model.internal_rate_hz(rate_hz);
    let requested_s = args.duration.map(|duration| duration.as_secs_f64());
    let motion = args.motion.as_deref().map(|named| given(named, rate_hz, internal_hz, requested_s)).transpose()?;
    let motion_s = match &motion {
        Some(Given::File { rows, samples_per_row, .. }) => {
            Some(*rows as f64 * f64::from(*samples_per_row) / internal_hz)
        }
        Some(Given::Poses { rows, samples_per_row }) => {
            Some(rows.len() as f64 * f64::from(*samples_per_row) / internal_hz)
        }
        _ => None,
    };
    let duration_s = match (requested_s, motion_s) {
        (Some(requested_s), Some(motion_s)) => {
            if motion_s < requested_s {
                eprintln!("note: the motion ends after {motion_s:.3} s, and with it the simulation");
            }
            requested_s.min(motion_s)
        }
        (Some(one), None) | (None, Some(one)) => one,
        (None, None) => return Err(usage("--duration is missing: how much sample time, such as 5h")),
    };
    let samples = (duration_s * rate_hz).round() as u64;
    if samples == 0 {
        return Err(usage(format!("{duration_s} s at {rate_hz} Hz are less than a sample")));
    }
    if duration_s > LONGEST_S {
        return Err(usage(format!("{duration_s} s are too long: expected at most {LONGEST_S} s, a hundred years")));
    }
    let values = samples.saturating_mul(1 + model.channels.len() as u64);
    match &args.out {
        Some(path) if out.is_some() => refuse_without_room(path, values)?,
        Some(_) => {}
        None => refuse_without_room(&context.database()?, values)?,
    }
    let temperature = args.temperature.as_deref().map(temperature).transpose()?.map(Arc::new);
    if motion.is_some() {
        without_gravity(&mut model, "the motion");
    }
    let mut simulator = Simulator::new(&model, args.seed, rate_hz, duration_s)?.with_threads(THREADS);
    let failed = Arc::new(Mutex::new(None));
    if let Some(motion) = &motion {
        simulator = simulator.with_motion(motion.at_own_rate(internal_hz, &failed)?);
    }
    if let Some(temperature) = temperature.clone() {
        simulator = simulator.with_temperature(move |time_s: f64| temperature.at(time_s));
    }
    if let (Some(output), Some(motion)) = (&motion_out, &motion) {
        write_motion(output, motion, temperature.as_deref(), rate_hz, internal_hz, samples, &failed)?;
    }
    let mut run = Run {
        simulator: &mut simulator,
        samples,
        bar: bar(SAMPLES, samples),
        stop: stop_on_signal()?,
        failed: &failed,
    };
    let made = match &args.into_db {
        Some(name) => to_database(context, args, name, &model, &mut run)?,
        None => to_csv(out, &mut run)?,
    };
    run.bar.finish_and_clear();
    // The samples are there; their reference would be of no use without them.
    motion_out.map_or(Ok(()), Output::keep)?;
    print_summary(context, args, &model, rate_hz, &made)?;
    Ok(Outcome::Done)
}

/// The result of a simulation.
#[derive(Debug, Default, serde::Serialize)]
struct Made {
    samples: u64,
    missing: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    capture: Option<i64>,
}

/// Failed rows of a motion are recorded here, because an iterator cannot report them.
type Failed = Arc<Mutex<Option<imu_model::motion::file::MotionError>>>;

/// Returns an error if the motion broke off, so that only a part was simulated.
fn whole(failed: &Failed) -> anyhow::Result<()> {
    match failed.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(error) => Err(error).context("the motion changed while it was read"),
        None => Ok(()),
    }
}

/// Returns the outputs of samples and motion, checked before anything is computed; `None` is standard output or the
/// database.
fn outputs(args: &SimulateArgs) -> anyhow::Result<(Option<Output>, Option<Output>)> {
    if args.out.is_none() && args.into_db.is_none() {
        return Err(usage("name --out FILE or --into-db NAME: where the samples go"));
    }
    if args.motion_out.is_some() && args.motion.is_none() {
        return Err(usage("--motion-out has nothing to write without --motion"));
    }
    let stdout = Path::new("-");
    match (&args.out, &args.motion_out) {
        (_, Some(motion)) if motion == stdout => {
            return Err(usage("--motion-out -: expected a file; standard output takes samples alone"));
        }
        (Some(one), Some(other)) if is_same(one, other) => {
            return Err(usage(format!("{} cannot be samples and motion", one.display())));
        }
        _ => {}
    }
    let read =
        [args.model.as_deref(), args.motion.as_deref().map(Path::new), args.temperature.as_deref().map(Path::new)];
    let read: Vec<&Path> = read.into_iter().flatten().filter(|path| path.exists()).collect();
    let output = |path: &Path| Output::create(path, args.force, &read);
    let out = args.out.as_deref().filter(|path| *path != stdout).map(output).transpose()?;
    Ok((out, args.motion_out.as_deref().map(output).transpose()?))
}

/// Leaves gravity to its source: a motion, another program.
pub(super) fn without_gravity(model: &mut SensorModel, brings: &str) {
    if let Some(level) = gravity::take_out(model, Site::default().gravity_m_s2) {
        eprintln!(
            "note: the model's accelerometer biases ({:.4}, {:.4}, {:.4} m/s²) hold gravity, which {brings} brings: they count as \
             what exceeds {} m/s² along them",
            level[0],
            level[1],
            level[2],
            Site::default().gravity_m_s2
        );
    }
}

fn given(named: &str, rate_hz: f64, internal_hz: f64, duration_s: Option<f64>) -> anyhow::Result<Given> {
    if let Some(kind) = Kind::from_name(named) {
        let Some(duration_s) = duration_s else {
            return Err(usage(format!("--duration is missing: how long the motion `{named}` is to be, such as 10min")));
        };
        return Ok(Given::Course(Course::new(kind, duration_s, Site::default())?));
    }
    if let Some(poses) = poses(named)? {
        let samples_per_row = samples_per_row(named, rate_hz, rate_hz, internal_hz)?;
        let instants =
            imu_pose::course(&poses, rate_hz).with_context(|| format!("the motion {named} cannot be used"))?;
        if poses.position_m.is_empty() {
            eprintln!("note: {named} has no positions: the accelerometer has gravity alone");
        }
        let row = |of: &imu_pose::Instant| Motion {
            gyro_rad_s: of.rate_rad_s.into(),
            accel_m_s2: of.force_m_s2.into(),
            temperature_c: None,
        };
        return Ok(Given::Poses { rows: instants.iter().map(row).collect(), samples_per_row });
    }
    let found_hz = rate_of(open(named)?, named)?;
    let survey = Rows::new(open(named)?, named, found_hz)?.survey()?;
    let samples_per_row = samples_per_row(named, survey.rate_hz, rate_hz, internal_hz)?;
    let (rows, has_temperature) = (survey.rows, survey.has_temperature);
    Ok(Given::File { path: named.to_owned(), rows, has_temperature, samples_per_row })
}

/// Returns the poses in a file; `None` if it has none.
fn poses(named: &str) -> anyhow::Result<Option<Poses>> {
    let mut line = String::new();
    let is_text = open(named)?.take(HEADER_BYTES).read_line(&mut line).is_ok();
    if is_text && line.contains("ref_gyro") {
        return Ok(None);
    }
    Ok(match reference(Path::new(named), None) {
        Ok(Known::External(External::Poses(poses))) => Some(poses),
        _ => None,
    })
}

/// Returns the rows of a motion up to a time, at most `most`, and their rate in Hz.
pub(super) fn motion_rows(
    named: &str,
    model: &SensorModel,
    length_s: f64,
    most: usize,
) -> anyhow::Result<(f64, Vec<Motion>)> {
    let internal_hz = model.internal_rate_hz(model.rate_hz);
    let motion = given(named, model.rate_hz, internal_hz, Some(length_s))?;
    let row_hz = match &motion {
        Given::File { samples_per_row, .. } | Given::Poses { samples_per_row, .. } => {
            internal_hz / f64::from(*samples_per_row)
        }
        Given::Course(_) => internal_hz,
    };
    let failed = Failed::default();
    let count = (length_s * row_hz).ceil() as usize;
    let rows = motion.rows(internal_hz, &failed)?.take(count.saturating_add(1).min(most)).collect();
    whole(&failed)?;
    Ok((row_hz, rows))
}

fn open(path: &str) -> anyhow::Result<BufReader<File>> {
    let kinds = Kind::ALL.map(Kind::name).join(", ");
    open_file(path).with_context(|| format!("the motion {path} cannot be read (motions without a file: {kinds})"))
}

/// Opens a file. Opening a folder succeeds too, but would fail at the first line.
fn open_file(path: &str) -> std::io::Result<BufReader<File>> {
    let file = File::open(path)?;
    if file.metadata()?.is_dir() {
        return Err(std::io::ErrorKind::IsADirectory.into());
    }
    Ok(BufReader::new(file))
}

impl Given {
    /// Returns the rows or instants unchanged, at the file's rate or at `rate_hz`.
    fn rows(&self, rate_hz: f64, failed: &Failed) -> anyhow::Result<Box<dyn Iterator<Item = Motion> + Send>> {
        match self {
            Self::Course(course) => Ok(Box::new(course.clone().sampled(rate_hz))),
            Self::Poses { rows, .. } => {
                let rows = Arc::clone(rows);
                Ok(Box::new((0..rows.len()).map(move |place| rows[place])))
            }
            Self::File { path, .. } => {
                let (failed, rows) = (failed.clone(), Rows::new(open(path)?, path, None)?);
                Ok(Box::new(rows.map_while(move |row| match row {
                    Ok((_, motion)) => Some(motion),
                    Err(error) => {
                        *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                        None
                    }
                })))
            }
        }
    }

    /// Converts the motion to the sensor's own rate.
    fn at_own_rate(
        &self,
        internal_hz: f64,
        failed: &Failed,
    ) -> anyhow::Result<Box<dyn Iterator<Item = Motion> + Send>> {
        let rows = self.rows(internal_hz, failed)?;
        Ok(match self {
            Self::File { samples_per_row, .. } | Self::Poses { samples_per_row, .. } if *samples_per_row > 1 => {
                Box::new(between(rows, *samples_per_row))
            }
            _ => rows,
        })
    }
}

/// Returns a temperature in °C, or a file with its course.
pub(super) fn temperature(named: &str) -> anyhow::Result<Temperatures> {
    if let Ok(constant) = named.parse::<f64>() {
        if !(-273.15..=1000.0).contains(&constant) {
            return Err(usage(format!("--temperature {named}: expected °C from -273.15 to 1000, or a file")));
        }
        return Ok(Temperatures::constant(constant));
    }
    let file =
        open_file(named).with_context(|| format!("--temperature {named}: neither °C nor a file that can be read"))?;
    Ok(Temperatures::read(file, named)?)
}

/// Writes the reference for a diagnosis: one row per sent sample.
fn write_motion(
    output: &Output,
    motion: &Given,
    temperature: Option<&Temperatures>,
    rate_hz: f64,
    internal_hz: f64,
    samples: u64,
    failed: &Failed,
) -> anyhow::Result<()> {
    let every = match motion {
        Given::File { samples_per_row: 1, .. } => (internal_hz / rate_hz).round().max(1.0) as usize,
        _ => 1,
    };
    let known = temperature.is_some() || matches!(motion, Given::File { has_temperature: true, .. });
    let write = || -> anyhow::Result<()> {
        let mut writer = Writer::new(BufWriter::new(output.file()), known)?;
        for (index, mut of) in (0..samples).zip(motion.rows(rate_hz, failed)?.step_by(every)) {
            let time_s = index as f64 / rate_hz;
            of.temperature_c = temperature.map(|course| course.at(time_s)).or(of.temperature_c);
            writer.row(time_s, &of)?;
        }
        Ok(writer.finish()?)
    };
    write().with_context(|| format!("the motion {} cannot be written", output.path().display()))
}

/// A running simulation.
struct Run<'a> {
    simulator: &'a mut Simulator,
    /// Maximum number of samples.
    samples: u64,
    bar: ProgressBar,
    /// Set by Ctrl-C and SIGTERM: partial results are removed.
    stop: Arc<AtomicBool>,
    failed: &'a Failed,
}

impl Run<'_> {
    /// Passes the samples to `take`, block by block.
    fn each(&mut self, mut take: impl FnMut(&Block<'_>, usize) -> anyhow::Result<()>) -> anyhow::Result<()> {
        let (channels, rate_hz) = (self.simulator.channels(), self.simulator.rate_hz());
        let mut left = self.samples;
        while left > 0 {
            let Some(block) = self.simulator.next_block() else { break };
            if self.stop.load(Ordering::Relaxed) {
                return Err(failed("stopped before the end: nothing is kept"));
            }
            let length = block.len().min(usize::try_from(left).unwrap_or(usize::MAX));
            for channel in channels.iter() {
                let values = block.values(channel).and_then(|values| values.get(..length)).unwrap_or_default();
                if let Some(place) = values.iter().position(|value| !value.is_finite()) {
                    let at_s = (block.first_index + place as u64) as f64 / rate_hz;
                    return Err(failed(format!(
                        "channel {channel} is no finite number at {at_s} s: an effect on it is too large for this motion, \
                         temperature or length"
                    )));
                }
            }
            take(&block, length)?;
            left -= length as u64;
            self.bar.inc(length as u64);
        }
        whole(self.failed)
    }
}

/// Writes the CSV of docs/formats.md; lost samples have no row. Without a file, it goes to standard output.
fn to_csv(output: Option<Output>, run: &mut Run<'_>) -> anyhow::Result<Made> {
    let Some(output) = output else { return csv_rows(std::io::stdout().lock(), run) };
    let made = csv_rows(output.file(), run).map_err(|error| match error.is::<std::io::Error>() {
        true => error.context(format!("{} cannot be written", output.path().display())),
        false => error,
    })?;
    output.keep()?;
    Ok(made)
}

fn csv_rows(to: impl Write, run: &mut Run<'_>) -> anyhow::Result<Made> {
    let mut to = BufWriter::with_capacity(1 << 20, to);
    let channels: Vec<Channel> = run.simulator.channels().iter().collect();
    write!(to, "time_s")?;
    for channel in &channels {
        write!(to, ",{}{}", channel.name(), channel.csv_suffix())?;
    }
    writeln!(to)?;
    let mut made = Made::default();
    // Samples lost before the first or after the last one do not count as missing, as in the database.
    let mut lost = 0;
    run.each(|block, length| {
        let columns: Vec<&[f64]> = channels.iter().filter_map(|channel| block.values(*channel)).collect();
        for row in 0..length {
            if block.lost[row] {
                lost += u64::from(made.samples > 0);
                continue;
            }
            made.samples += 1;
            made.missing += std::mem::take(&mut lost);
            write!(to, "{}", block.time_s[row])?;
            for column in &columns {
                write!(to, ",{}", column[row])?;
            }
            writeln!(to)?;
        }
        Ok(())
    })?;
    to.flush()?;
    Ok(made)
}

/// The configuration of a simulated capture, as the database holds it.
#[derive(Serialize)]
struct Simulation<'a> {
    sensor_model: &'a SensorModel,
    seed: u64,
    motion: Option<&'a str>,
    temperature: Option<&'a str>,
    software: &'a str,
}

fn to_database(
    context: &Context,
    args: &SimulateArgs,
    name: &str,
    model: &SensorModel,
    run: &mut Run<'_>,
) -> anyhow::Result<Made> {
    let store = Store::open(&context.database()?, StoreOptions::default())
        .context("simulate with --out FILE and import that where a daemon has the database")?;
    let utc_ns = SystemClock.utc_ns();
    let configuration = Simulation {
        sensor_model: model,
        seed: args.seed,
        motion: args.motion.as_deref(),
        temperature: args.temperature.as_deref(),
        software: SOFTWARE,
    };
    let capture = NewCapture {
        name: Some(name.to_owned()),
        started_utc_ns: Some(utc_ns),
        sensor: Some(SensorDescription::of(&BTreeMap::from([("model", &model.name)]))),
        configuration: Some(CaptureConfiguration::of(&configuration)),
        ..NewCapture::new("simulator", CaptureState::Simulated)
    };
    let mut import = store.begin_import(capture, None)?;
    let mut records =
        Records::new(run.simulator.rate_hz(), run.simulator.channels(), run.simulator.has_jitter(), utc_ns);
    run.each(|block, length| {
        (0..length).try_for_each(|row| Ok(records.take(&block.sample(row), |record| import.push(record))?))
    })?;
    let (received, missing) = records.counts();
    let id = import.finish(None)?.id();
    crate::jobs::leave_for_daemon(&store, id)?;
    store.close()?;
    Ok(Made { samples: received, missing, capture: Some(id) })
}

fn print_summary(
    context: &Context,
    args: &SimulateArgs,
    model: &SensorModel,
    rate_hz: f64,
    made: &Made,
) -> anyhow::Result<()> {
    let to_stdout = args.out.as_deref().is_some_and(|path| path == Path::new("-"));
    if to_stdout {
        return Ok(());
    }
    if context.json {
        return print_json(made);
    }
    let place = match (made.capture, &args.out) {
        (Some(id), _) => format!("capture {id}"),
        (None, out) => out.as_ref().map(|path| path.display().to_string()).unwrap_or_default(),
    };
    let lost = match made.missing {
        0 => String::new(),
        missing => format!(", {missing} lost"),
    };
    println!(
        "{place}: {} of `{}` at {}, seed {}{lost}",
        counted(made.samples, "sample", "samples"),
        model.name,
        hertz(rate_hz),
        args.seed
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As databases of earlier versions hold it.
    #[test]
    fn the_configuration_of_a_simulation_keeps_its_keys() {
        let model = load_model(None).unwrap();
        let simulation =
            Simulation { sensor_model: &model, seed: 3, motion: None, temperature: Some("25"), software: SOFTWARE };
        let configuration = CaptureConfiguration::of(&simulation);
        let keys: Vec<_> = configuration.entries().map(|(key, _)| key).collect();
        assert_eq!(keys, ["motion", "seed", "sensor_model", "software", "temperature"]);
    }
}
