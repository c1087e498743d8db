//! `vn100d probe`: reports the connected sensor without changing anything.

use super::args::ProbeArgs;
use super::{Context, Outcome, failed, print_json, table};
use crate::capture::output::Output;
use crate::capture::recorder_state::Sink;
use crate::capture::session::SessionOptions;
use crate::capture::task::{self, Progress, TaskCommand, TaskOptions};
use crate::clock::{Clock, SystemClock};
use crate::config::Overrides;
use imu_core::sample::Record;
use std::io::Write as _;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use tokio::sync::{mpsc, watch};

/// Long enough for every baud rate and every register of a sensor.
const PATIENCE: Duration = Duration::from_secs(20);

/// Nothing is recorded while probing.
struct Nowhere;

impl Sink for Nowhere {
    fn room(&self) -> usize {
        usize::MAX
    }
    fn put(&self, _: i64, _: Record) -> Result<(), Box<Record>> {
        Ok(())
    }
    fn is_closed(&self) -> bool {
        false
    }
}

/// Finds the sensor and prints its description.
pub(super) fn run(context: &Context, args: &ProbeArgs) -> anyhow::Result<Outcome> {
    let config =
        context.load(&Overrides { device: args.device.clone(), without_token: true, ..Overrides::default() })?;
    let session = SessionOptions { output: Output::Keep, ..crate::daemon::session_options(&config)? };
    let options = TaskOptions { device: crate::daemon::device(&config), session, seed: SystemClock.mono_ns() };
    let progress = super::run::runtime()?.block_on(find(options));
    let Some(sensor) = progress.description else {
        let state = serde_json::to_value(progress.sensor.state)?;
        let hint = progress.sensor.hint.unwrap_or_else(|| "nothing was found".to_owned());
        return Err(failed(format!("no sensor ({}): {hint}", state.as_str().unwrap_or("absent"))));
    };
    if context.json {
        print_json(&sensor.configuration())?;
        return Ok(Outcome::Done);
    }
    let mut rows = table(&["what", "value"]);
    let text = |text: &Option<String>| text.clone().unwrap_or_else(|| "null".to_owned());
    for (key, value) in [
        ("port", text(&sensor.port)),
        ("baud", sensor.baud.map_or_else(|| "null".to_owned(), |baud| baud.to_string())),
        ("model", text(&sensor.model)),
        ("hardware_revision", text(&sensor.hardware_revision)),
        ("serial_number", text(&sensor.serial_number)),
        ("firmware", text(&sensor.firmware)),
        ("output", sensor.output.clone()),
        ("rate_hz", format!("{:?}", sensor.rate_hz)),
    ] {
        rows.add_row([key.to_owned(), value]);
    }
    for (number, fields) in &sensor.registers {
        rows.add_row([format!("register {number}"), fields.clone()]);
    }
    writeln!(std::io::stdout(), "{rows}")?;
    Ok(Outcome::Done)
}

async fn find(options: TaskOptions) -> Progress {
    let (commands, receiver) = mpsc::channel(1);
    let (sender, mut progress) = watch::channel(Progress::default());
    let clock: Arc<dyn Clock> = Arc::new(SystemClock);
    let task =
        tokio::spawn(task::run(options, clock, Box::new(Nowhere), receiver, sender, Arc::new(AtomicU64::new(0))));
    // After the time limit, the last state shows the problem.
    let _ = tokio::time::timeout(PATIENCE, progress.wait_for(is_settled)).await;
    let found = progress.borrow().clone();
    let _ = commands.send(TaskCommand::Shutdown).await;
    let _ = tokio::time::timeout(Duration::from_secs(2), task).await;
    found
}

/// Returns whether the sensor is described, or there is nothing to wait for.
fn is_settled(progress: &Progress) -> bool {
    use crate::observe::SensorState::{Absent, NoPermission, NoValidFrames, PortBusy};
    let hopeless = matches!(progress.sensor.state, Absent | NoPermission | NoValidFrames | PortBusy);
    progress.description.is_some() || (hopeless && progress.sensor.hint.is_some())
}
