//! `vn100d simulate`: a sensor model's output as CSV or as a capture.

use super::args::SimulateArgs;
use super::emulate::load_model;
use super::{CliError, Context, Failure, Outcome, print_json};
use crate::clock::{Clock as _, SystemClock};
use crate::motion::file::{Rows, Writer, between, rate_of, samples_per_row};
use crate::motion::{Course, Kind, Site, Temperatures, gravity};
use crate::sample::Channel;
use crate::simulator::records::Records;
use crate::simulator::{Block, Motion, SensorModel, Simulator};
use crate::store::{CaptureState, NewCapture, SOFTWARE, Store, StoreOptions};
use anyhow::Context as _;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fs::{File, Permissions};
use std::io::{BufReader, BufWriter, IsTerminal as _, Write};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Threads that make samples: a third would have no core where two are, and one of four leaves the writer its own.
const THREADS: usize = 2;

/// What the sensor goes through.
enum Given {
    /// One of the motions that need no file.
    Course(Course),
    /// A file at a rate, one row for so many of the sensor's own samples.
    File { path: String, rows: u64, has_temperature: bool, samples_per_row: u32 },
}

/// Runs to the end of the duration or of the motion.
pub(super) fn run(context: &Context, args: &SimulateArgs) -> anyhow::Result<Outcome> {
    refuse_same_file(args)?;
    let mut model = load_model(args.model.as_deref())?;
    let rate_hz = args.rate.unwrap_or(model.rate_hz);
    let internal_hz = model.internal_rate_hz(rate_hz);
    let told_s = args.duration.map(|duration| duration.as_secs_f64());
    let motion = args.motion.as_deref().map(|named| given(named, rate_hz, internal_hz, told_s)).transpose()?;
    let motion_s = match &motion {
        Some(Given::File { rows, samples_per_row, .. }) => {
            Some(*rows as f64 * f64::from(*samples_per_row) / internal_hz)
        }
        _ => None,
    };
    let duration_s = match (told_s, motion_s) {
        (Some(told_s), Some(motion_s)) => {
            if motion_s < told_s {
                eprintln!("note: the motion ends after {motion_s:.3} s, and with it the simulation");
            }
            told_s.min(motion_s)
        }
        (Some(one), None) | (None, Some(one)) => one,
        (None, None) => return Err(usage("--duration is missing: how much sample time, such as 5h".to_owned())),
    };
    let samples = (duration_s * rate_hz).round() as u64;
    if samples == 0 {
        return Err(usage(format!("{duration_s} s at {rate_hz} Hz are less than a sample")));
    }
    let temperature = args.temperature.as_deref().map(temperature).transpose()?.map(Arc::new);
    if motion.is_some() {
        without_gravity(&mut model);
    }
    let mut simulator = Simulator::new(&model, args.seed, rate_hz, duration_s)?.with_threads(THREADS);
    let failed = Arc::new(Mutex::new(None));
    if let Some(motion) = &motion {
        simulator = simulator.with_motion(motion.at_own_rate(internal_hz, &failed)?);
    }
    if let Some(temperature) = temperature.clone() {
        simulator = simulator.with_temperature(move |time_s: f64| temperature.at(time_s));
    }
    if let Some(path) = &args.motion_out {
        let motion =
            motion.as_ref().ok_or_else(|| usage("--motion-out has nothing to write without --motion".into()))?;
        write_motion(path, motion, temperature.as_deref(), rate_hz, internal_hz, samples, &failed)?;
    }
    let bar = bar(samples);
    let made = match (&args.out, &args.into_db) {
        (Some(path), _) => to_csv(path, &mut simulator, samples, &bar, &failed)?,
        (None, Some(name)) => to_database(context, args, name, &model, &mut simulator, samples, &bar, &failed)?,
        (None, None) => return Err(usage("name --out FILE or --into-db NAME: where the samples go".to_owned())),
    };
    bar.finish_and_clear();
    tell(context, args, &model, rate_hz, &made)?;
    Ok(Outcome::Done)
}

/// What a simulation came to.
#[derive(Debug, Default, serde::Serialize)]
struct Made {
    samples: u64,
    missing: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    capture: Option<i64>,
}

/// A motion's rows that failed are told here: an iterator cannot.
type Failed = Arc<Mutex<Option<crate::motion::file::MotionError>>>;

/// A motion that broke off has been simulated in part only.
fn whole(failed: &Failed) -> anyhow::Result<()> {
    match failed.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(error) => Err(error).context("the motion changed while it was read"),
        None => Ok(()),
    }
}

/// What is read is not to be written over.
fn refuse_same_file(args: &SimulateArgs) -> anyhow::Result<()> {
    let place = |path: &Path| path.canonicalize().ok();
    let read =
        [args.model.as_deref(), args.motion.as_deref().map(Path::new), args.temperature.as_deref().map(Path::new)];
    let read: Vec<_> = read.into_iter().flatten().filter_map(place).collect();
    let written: Vec<&Path> = [args.out.as_deref(), args.motion_out.as_deref()].into_iter().flatten().collect();
    for path in &written {
        if place(path).is_some_and(|place| read.contains(&place)) {
            return Err(usage(format!("{} is read: write to another file", path.display())));
        }
    }
    match written.as_slice() {
        [one, other] if one == other => Err(usage(format!("{} cannot be samples and motion", one.display()))),
        _ => Ok(()),
    }
}

/// A motion brings gravity with it.
fn without_gravity(model: &mut SensorModel) {
    if let Some(level) = gravity::take_out(model, Site::default().gravity_m_s2) {
        eprintln!(
            "note: the model's accelerometer biases ({:.4}, {:.4}, {:.4} m/s²) hold gravity, which the motion brings: they count as \
             what exceeds {} m/s² along them",
            level[0],
            level[1],
            level[2],
            Site::default().gravity_m_s2
        );
    }
}

fn usage(message: String) -> anyhow::Error {
    CliError { failure: Failure::Usage, message }.into()
}

fn given(named: &str, rate_hz: f64, internal_hz: f64, duration_s: Option<f64>) -> anyhow::Result<Given> {
    if let Some(kind) = Kind::from_name(named) {
        let Some(duration_s) = duration_s else {
            return Err(usage(format!("--duration is missing: how long the motion `{named}` is to be, such as 10min")));
        };
        return Ok(Given::Course(Course::new(kind, duration_s, Site::default())?));
    }
    let found_hz = rate_of(open(named)?, named)?;
    let survey = Rows::new(open(named)?, named, found_hz)?.survey()?;
    let samples_per_row = samples_per_row(named, survey.rate_hz, rate_hz, internal_hz)?;
    let (rows, has_temperature) = (survey.rows, survey.has_temperature);
    Ok(Given::File { path: named.to_owned(), rows, has_temperature, samples_per_row })
}

fn open(path: &str) -> anyhow::Result<BufReader<File>> {
    let kinds = Kind::ALL.map(Kind::name).join(", ");
    let file =
        File::open(path).with_context(|| format!("{path} cannot be opened (motions without a file: {kinds})"))?;
    Ok(BufReader::new(file))
}

impl Given {
    /// The rows or instants as they are, at the file's or at `rate_hz`.
    fn rows(&self, rate_hz: f64, failed: &Failed) -> anyhow::Result<Box<dyn Iterator<Item = Motion> + Send>> {
        match self {
            Self::Course(course) => Ok(Box::new(course.clone().sampled(rate_hz))),
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

    /// At the sensor's own rate.
    fn at_own_rate(
        &self,
        internal_hz: f64,
        failed: &Failed,
    ) -> anyhow::Result<Box<dyn Iterator<Item = Motion> + Send>> {
        let rows = self.rows(internal_hz, failed)?;
        Ok(match self {
            Self::File { samples_per_row, .. } if *samples_per_row > 1 => Box::new(between(rows, *samples_per_row)),
            _ => rows,
        })
    }
}

/// A temperature in °C, or a file with its course.
fn temperature(named: &str) -> anyhow::Result<Temperatures> {
    if let Ok(constant) = named.parse::<f64>() {
        if !(-273.15..=1000.0).contains(&constant) {
            return Err(usage(format!("--temperature {named}: expected °C from -273.15 to 1000, or a file")));
        }
        return Ok(Temperatures::constant(constant));
    }
    Ok(Temperatures::read(open(named)?, named)?)
}

/// The reference as a diagnosis takes it: a row for every sample sent.
fn write_motion(
    path: &Path,
    motion: &Given,
    temperature: Option<&Temperatures>,
    rate_hz: f64,
    internal_hz: f64,
    samples: u64,
    failed: &Failed,
) -> anyhow::Result<()> {
    let name = path.display();
    let every = match motion {
        Given::File { samples_per_row: 1, .. } => (internal_hz / rate_hz).round().max(1.0) as usize,
        _ => 1,
    };
    let known = temperature.is_some() || matches!(motion, Given::File { has_temperature: true, .. });
    let write = || -> anyhow::Result<()> {
        let mut writer = Writer::new(BufWriter::new(File::create(path)?), known)?;
        for (index, mut of) in (0..samples).zip(motion.rows(rate_hz, failed)?.step_by(every)) {
            let time_s = index as f64 / rate_hz;
            of.temperature_c = temperature.map(|course| course.at(time_s)).or(of.temperature_c);
            writer.row(time_s, &of)?;
        }
        Ok(writer.finish()?)
    };
    write().with_context(|| format!("the motion {name} cannot be written"))
}

fn bar(samples: u64) -> ProgressBar {
    let target =
        if std::io::stderr().is_terminal() { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let style = ProgressStyle::with_template("{bar:30} {percent} % · {human_pos} of {human_len} samples · {eta} left");
    let bar = ProgressBar::with_draw_target(Some(samples), target);
    if let Ok(style) = style { bar.with_style(style) } else { bar }
}

/// Hands the samples to `take`, block by block: at most `samples`, lost ones counted.
fn each(
    simulator: &mut Simulator,
    samples: u64,
    bar: &ProgressBar,
    mut take: impl FnMut(&Block<'_>, usize) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut left = samples;
    while left > 0 {
        let Some(block) = simulator.next_block() else { return Ok(()) };
        let length = block.len().min(usize::try_from(left).unwrap_or(usize::MAX));
        take(&block, length)?;
        left -= length as u64;
        bar.inc(length as u64);
    }
    Ok(())
}

/// Rows of the contract's CSV (section 4); lost samples have none. A file comes into being whole or not at all.
fn to_csv(
    path: &Path,
    simulator: &mut Simulator,
    samples: u64,
    bar: &ProgressBar,
    failed: &Failed,
) -> anyhow::Result<Made> {
    if path == Path::new("-") {
        let made = csv_rows(std::io::stdout().lock(), simulator, samples, bar)?;
        return whole(failed).map(|()| made);
    }
    let cannot = || format!("{} cannot be written", path.display());
    if path.exists() && !path.is_file() {
        // A pipe or a device takes what comes.
        let made = csv_rows(File::create(path).with_context(cannot)?, simulator, samples, bar).with_context(cannot)?;
        return whole(failed).map(|()| made);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let file = tempfile::Builder::new()
        .prefix(".simulating-")
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder)
        .with_context(cannot)?;
    let made = csv_rows(file.as_file(), simulator, samples, bar).with_context(cannot)?;
    whole(failed)?;
    file.persist(path).with_context(cannot)?;
    Ok(made)
}

fn csv_rows(to: impl Write, simulator: &mut Simulator, samples: u64, bar: &ProgressBar) -> anyhow::Result<Made> {
    let mut to = BufWriter::with_capacity(1 << 20, to);
    let channels: Vec<Channel> = simulator.channels().iter().collect();
    write!(to, "time_s")?;
    for channel in &channels {
        write!(to, ",{}{}", channel.name(), channel.csv_suffix())?;
    }
    writeln!(to)?;
    let mut made = Made::default();
    // Lost before the first sample or after the last one is not missing between any, as in the database.
    let mut lost = 0;
    each(simulator, samples, bar, |block, length| {
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

#[expect(clippy::too_many_arguments, reason = "what goes in, what is said, where it goes")]
fn to_database(
    context: &Context,
    args: &SimulateArgs,
    name: &str,
    model: &SensorModel,
    simulator: &mut Simulator,
    samples: u64,
    bar: &ProgressBar,
    failed: &Failed,
) -> anyhow::Result<Made> {
    let store = Store::open(&context.database()?, StoreOptions::default())
        .context("simulate with --out FILE and import that where a daemon has the database")?;
    let utc_ns = SystemClock.utc_ns();
    let capture = NewCapture {
        name: Some(name.to_owned()),
        started_utc_ns: Some(utc_ns),
        sensor: Some(serde_json::json!({ "model": model.name })),
        configuration: Some(serde_json::json!({
            "sensor_model": model,
            "seed": args.seed,
            "motion": args.motion,
            "temperature": args.temperature,
            "software": SOFTWARE,
        })),
        ..NewCapture::new("simulator", CaptureState::Simulated)
    };
    let mut import = store.begin_import(capture, None)?;
    let mut records = Records::new(simulator.rate_hz(), simulator.channels(), simulator.has_jitter(), utc_ns);
    each(simulator, samples, bar, |block, length| {
        (0..length).try_for_each(|row| Ok(records.take(&block.sample(row), |record| import.push(record))?))
    })?;
    whole(failed)?;
    let (received, missing) = records.counts();
    let id = import.finish(None)?.id();
    crate::jobs::leave_for_daemon(&store, id)?;
    store.close()?;
    Ok(Made { samples: received, missing, capture: Some(id) })
}

fn tell(context: &Context, args: &SimulateArgs, model: &SensorModel, rate_hz: f64, made: &Made) -> anyhow::Result<()> {
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
    println!("{place}: {} samples of `{}` at {rate_hz} Hz, seed {}{lost}", made.samples, model.name, args.seed);
    Ok(())
}
