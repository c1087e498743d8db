//! `vn100d emulate`: a VN-100 on a pseudo-terminal.

use super::args::EmulateArgs;
use super::hangup::Hangup;
use super::{Outcome, failed, usage};
use crate::clock::ScaledClock;
use crate::emulator::faults::{Fault, FaultError, Schedule, parse_line};
use crate::emulator::replay::Replay;
use crate::emulator::source::Source;
use crate::emulator::terminal::{EmulatorError, Terminal, TerminalOptions};
use crate::emulator::{SensorOptions, VirtualSensor};
use anyhow::Context as _;
use imu_model::simulator::{SensorModel, default_model};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use tokio::signal::unix::{SignalKind, signal};
use vn100_proto::register::{ASYNC_RATE, BAUD_RATE};

/// Runs until Ctrl-C, SIGTERM or the end of `--duration`.
pub(super) fn run(args: &EmulateArgs) -> anyhow::Result<Outcome> {
    let source = match &args.replay {
        Some(file) => Source::Replay(Replay::new(raw_lines(file)?, args.speed)),
        None => Source::model(load_model(args.model.as_deref())?, args.seed),
    };
    let mut sensor = VirtualSensor::new(&SensorOptions::default());
    let mut preset = |register, values: &str, what: &str| {
        sensor
            .registers_mut()
            .preset(register, values)
            .map_err(|error| usage(format!("{what} {values}: a VN-100 does not have that ({error})")))
    };
    preset(BAUD_RATE, &args.baud.to_string(), "--baud")?;
    if let Some(rate_hz) = args.rate {
        preset(ASYNC_RATE, &rate_hz.to_string(), "--rate")?;
    }
    sensor.set_replaying(args.replay.is_some());
    let (faults, live_faults) = faults(args.faults.as_deref())?;
    let mut terminal = Terminal::open(TerminalOptions {
        link: args.link.clone(),
        duration: args.duration,
        log: args.log.clone(),
        strict_baud: args.strict_baud,
        faults,
        live_faults,
    })?;
    let mut stdout = std::io::stdout();
    writeln!(stdout, "{}", terminal.path().display())?;
    stdout.flush()?;
    let stop = stop_on_signal()?;
    let clock = Arc::new(ScaledClock::new(args.speed));
    match terminal.run(sensor, source, &clock, &stop) {
        Err(EmulatorError::Fault(error)) => Err(usage(error.to_string())),
        ended => Ok(ended.map(|()| Outcome::Done)?),
    }
}

/// Faults by time, or those from standard input.
type Faults = (Schedule, Option<mpsc::Receiver<Result<Fault, FaultError>>>);

fn faults(script: Option<&Path>) -> anyhow::Result<Faults> {
    let Some(path) = script else { return Ok((Schedule::default(), None)) };
    if path != Path::new("-") {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).with_context(|| format!("the faults {name} cannot be read"))?;
        return Ok((Schedule::parse(&text, &name).map_err(|error| usage(error.to_string()))?, None));
    }
    let (sender, receiver) = mpsc::channel();
    std::thread::Builder::new().name("faults".to_owned()).spawn(move || {
        for (index, line) in std::io::stdin().lines().map_while(Result::ok).enumerate() {
            let parsed = parse_line(&line, "standard input", index + 1).transpose();
            if parsed.is_some_and(|fault| sender.send(fault).is_err()) {
                // The emulator has ended.
                return;
            }
        }
    })?;
    Ok((Schedule::default(), Some(receiver)))
}

/// Returns the model of this file, or the built-in one.
pub(super) fn load_model(path: Option<&Path>) -> anyhow::Result<SensorModel> {
    let Some(path) = path else { return Ok(default_model()) };
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(|| format!("the sensor model {name} cannot be read"))?;
    Ok(SensorModel::from_json(&text, &name)?)
}

/// Returns the raw `$VN…` lines of a recording, without the text before the `$` and without line ends.
fn raw_lines(path: &Path) -> anyhow::Result<Box<dyn Iterator<Item = Vec<u8>> + Send>> {
    let name = path.display().to_string();
    let file = std::fs::File::open(path).with_context(|| format!("the recording {name} cannot be opened"))?;
    let mut start = BufReader::new(file);
    let zipped =
        start.fill_buf().with_context(|| format!("the recording {name} cannot be read"))?.starts_with(&[0x1f, 0x8b]);
    let reader: Box<dyn Read + Send> =
        if zipped { Box::new(flate2::bufread::MultiGzDecoder::new(start)) } else { Box::new(start) };
    let lines = BufReader::new(reader).split(b'\n').map_while(Result::ok).filter_map(|mut line| {
        while line.last().is_some_and(u8::is_ascii_whitespace) {
            line.pop();
        }
        let dollar = line.iter().position(|byte| *byte == b'$')?;
        Some(line.split_off(dollar))
    });
    let mut lines = lines.peekable();
    if lines.peek().is_none() {
        return Err(failed(format!(
            "{name} holds no raw sensor lines: expected lines that begin with `$VN`, plain or .gz"
        )));
    }
    Ok(Box::new(lines))
}

/// Returns a flag that SIGINT and SIGTERM set, and also SIGHUP unless the process was started to continue without a
/// terminal.
pub(super) fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let goes_on = Hangup::is_ignored();
    // Before the caller continues, so that a signal right then is not lost.
    let (mut interrupt, mut terminate, mut hangup) = {
        let _inside = runtime.enter();
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?, signal(SignalKind::hangup())?)
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        runtime.block_on(async {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
                _ = hangup.recv(), if !goes_on => {}
            }
        });
        flag.store(true, Ordering::Relaxed);
    })?;
    Ok(stop)
}
