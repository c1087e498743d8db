//! `vn100d demo`: the emulator on a pseudo-terminal, the daemon on it, five hours in a minute, and the diagnosis of an
//! effect that its model lacks.

use super::args::DemoArgs;
use super::hangup::Hangup;
use super::progress::bar;
use super::{Context, Outcome, failed};
use crate::clock::ScaledClock;
use crate::config::{Config, Device};
use crate::control::CaptureRequest;
use crate::daemon::{self, Handle, Options};
use crate::emulator::source::Source;
use crate::emulator::terminal::{Terminal, TerminalOptions};
use crate::emulator::{SensorOptions, VirtualSensor};
use crate::observe::logging::{self, LogStyle};
use anyhow::Context as _;
use imu_core::sample::Channel;
use imu_core::units::format_duration;
use imu_model::effects::Tone;
use imu_model::simulator::{SensorModel, default_model};
use std::io::Write as _;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// An effect that the emulated sensor has on accel_z and its model lacks: a fan in the room, a ninth of the white
/// noise's standard deviation.
const HUM: Tone = Tone { frequency_hz: 11.4, amplitude: 0.002 };

/// Runs the demonstration.
pub(super) fn run(context: &Context, args: &DemoArgs) -> anyhow::Result<Outcome> {
    // Without --data-dir, the user's database is never used: a temporary folder takes its place.
    let (folder, database) = match &context.data_dir {
        Some(directory) => (None, directory.join("vn100d.db")),
        None => {
            let folder =
                tempfile::Builder::new().prefix("vn100d-demo-").tempdir().context("no temporary folder can be made")?;
            let database = folder.path().join("vn100d.db");
            (Some(folder), database)
        }
    };
    logging::init("warn", LogStyle::of_process(false))?;
    let clock = Arc::new(ScaledClock::new(args.speed));
    let mut terminal = Terminal::open(TerminalOptions::default())?;
    let terminal_path = terminal.path().to_owned();
    let port = terminal_path.display().to_string();
    let stop_emulator = Arc::new(AtomicBool::new(false));
    let emulator = {
        let (clock, stop) = (Arc::clone(&clock), Arc::clone(&stop_emulator));
        let source = Source::model(humming(), args.seed);
        std::thread::Builder::new()
            .name("emulator".to_owned())
            .spawn(move || terminal.run(VirtualSensor::new(&SensorOptions::default()), source, &clock, &stop))?
    };
    let mut config = Config::default();
    config.sensor.device = Device::Path(terminal_path);
    config.http.listen = listen(args)?;
    let capture = CaptureRequest {
        duration: args.duration,
        name: folder.as_ref().map(|_| "demo".to_owned()),
        ..CaptureRequest::default()
    };
    let config = tokio::sync::watch::channel(config).1;
    let options = Options { database, config, capture: Some(capture), clock };
    let outcome = super::run::runtime()?.block_on(async {
        let stop = CancellationToken::new();
        super::run::stop_on_signal(stop.clone())?;
        Hangup::of_process(false).heed(stop.clone(), || ())?;
        let (ready, started) = tokio::sync::oneshot::channel();
        let running = tokio::spawn({
            let stop = stop.clone();
            async move {
                let on_ready = |handle| {
                    // If the demonstration was interrupted, the receiver is gone.
                    let _ = ready.send(handle);
                };
                daemon::run(options, stop, on_ready).await
            }
        });
        let shown = match started.await {
            Ok(handle) => show(args, &port, handle, &stop).await,
            // The daemon did not start; its own error states why.
            Err(_) => Ok(Outcome::Done),
        };
        stop.cancel();
        running.await??;
        shown
    });
    stop_emulator.store(true, Ordering::Relaxed);
    let emulated = emulator.join().map_err(|_| anyhow::anyhow!("the emulator ended unexpectedly"))?;
    drop(folder);
    let outcome = outcome?;
    emulated?;
    Ok(outcome)
}

/// Returns the emulated sensor: the usual model with an effect that the model lacks.
fn humming() -> SensorModel {
    let mut model = default_model();
    if let Some(channel) = model.channels.get_mut(&Channel::AccelZ) {
        channel.push_effect(Arc::new(HUM), &[]);
    }
    model
}

/// Returns the model for the comparison: the channels whose noise is analysed.
fn comparison_model() -> SensorModel {
    let mut model = default_model();
    model.channels.retain(|channel, _| Channel::ANALYSED.contains(channel));
    model
}

/// Returns the requested address; else the usual one, or any free one if that is taken.
fn listen(args: &DemoArgs) -> anyhow::Result<SocketAddr> {
    if let Some(address) = super::address(args.listen.as_deref())? {
        return Ok(address);
    }
    let usual = SocketAddr::from((Ipv4Addr::LOCALHOST, 8100));
    match std::net::TcpListener::bind(usual) {
        Ok(_) => Ok(usual),
        Err(_) => Ok(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))),
    }
}

/// Follows the capture, prints its noise parameters as `curl` would get them, and waits for Ctrl-C.
async fn show(args: &DemoArgs, port: &str, handle: Handle, stop: &CancellationToken) -> anyhow::Result<Outcome> {
    let base = format!("http://{}", handle.address);
    print_line(&format!("An emulated VN-100 sends from {port}; the daemon records it and answers at {base}."))?;
    print_line(&format!("Open {base}/ in a browser to see it move."))?;
    let begun = Instant::now();
    let bar = bar("{bar:40} {percent} %  {msg}", args.duration.as_secs());
    let mut status = handle.status.clone();
    let capture = format!("{base}/v1/captures/latest");
    while matches!(asked(capture.clone()).await?["state"].as_str(), Some("capturing" | "waiting")) {
        let now = status.borrow_and_update().clone();
        if let Some(capture) = &now.capture {
            bar.set_position(capture.elapsed_s as u64);
            bar.set_message(format!("{} samples, {} missing", capture.samples, capture.missing));
        }
        tokio::select! {
            changed = status.changed() => changed.context("the daemon ended")?,
            () = stop.cancelled() => return Ok(Outcome::Done),
        }
    }
    bar.finish_and_clear();
    let noise = tokio::select! {
        noise = finished(format!("{base}/v1/captures/latest/noise")) => noise?,
        () = stop.cancelled() => return Ok(Outcome::Done),
    };
    let took = begun.elapsed();
    let samples = noise["samples"].as_u64().unwrap_or(0);
    let missing = noise["missing"].as_u64().unwrap_or(0);
    print_line(&format!(
        "{} of sensor time in {:.0} s: {samples} samples, {missing} missing. What the sensor's model says, and what was found:\n",
        format_duration(args.duration),
        took.as_secs_f64(),
    ))?;
    print_line(&super::noise::comparison(&noise, &default_model()))?;
    print_line(&format!(
        "\nThe emulated accelerometer also hums at {} Hz with {} m/s², which that model does not say. A diagnosis against the model:\n",
        HUM.frequency_hz, HUM.amplitude
    ))?;
    tokio::select! {
        diagnosis = diagnosed(base.clone()) => print_line(&diagnosis?)?,
        () = stop.cancelled() => return Ok(Outcome::Done),
    }
    let tries = ["status", "captures/latest", "captures/latest/noise", "captures/latest/allan", "diagnoses/latest"];
    let tries: String = tries.iter().map(|path| format!("\n  curl {base}/v1/{path}")).collect();
    print_line(&format!(
        "\nTry:{tries}\nand in a browser {base}/, {base}/captures/latest and {base}/diagnoses/latest"
    ))?;
    if !args.once {
        print_line("\nServing until Ctrl-C.")?;
        stop.cancelled().await;
    }
    Ok(if missing > 0 { Outcome::WithLoss } else { Outcome::Done })
}

/// Sends one request.
async fn asked(url: String) -> anyhow::Result<serde_json::Value> {
    tokio::task::spawn_blocking(move || {
        let body = ureq::get(&url).call().with_context(|| format!("GET {url}"))?.body_mut().read_to_string()?;
        Ok(serde_json::from_str(&body)?)
    })
    .await?
}

/// Compares the capture with the model by an ordinary job, and returns the result as text.
async fn diagnosed(base: String) -> anyhow::Result<String> {
    let begun = Instant::now();
    let model = posted(format!("{base}/v1/models"), serde_json::to_value(comparison_model())?).await?;
    let body = serde_json::json!({ "sim": model["id"] });
    let job = posted(format!("{base}/v1/captures/latest/diagnoses"), body).await?;
    let job = loop {
        let job = asked(format!("{base}/v1/jobs/{}", job["id"])).await?;
        if !matches!(job["state"].as_str(), Some("queued" | "running")) {
            break job;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    };
    let Some(report) = job["result"].as_str() else {
        // A short capture has too few samples.
        return Ok(format!("  none: {}", job["error"].as_str().unwrap_or("it was called off")));
    };
    let report = asked(format!("{base}{report}")).await?;
    let gap = |name: &str| report["discrepancy"][name].as_f64().unwrap_or_default();
    Ok(format!(
        "  {}\n\nThe gap is {:.1e} nats a sample as the model is and {:.1e} with what was found; a true model shows {:.1e} \
         ({:.0} s of work).",
        report["summary"].as_str().unwrap_or_default(),
        gap("before"),
        gap("after"),
        gap("floor"),
        begun.elapsed().as_secs_f64(),
    ))
}

/// Posts a document.
async fn posted(url: String, body: serde_json::Value) -> anyhow::Result<serde_json::Value> {
    tokio::task::spawn_blocking(move || {
        let request = ureq::post(&url).header("content-type", "application/json");
        let answer =
            request.send(body.to_string()).with_context(|| format!("POST {url}"))?.body_mut().read_to_string()?;
        Ok(serde_json::from_str(&answer)?)
    })
    .await?
}

/// Repeats the request until the answer is there (202 means that the job still runs).
async fn finished(url: String) -> anyhow::Result<serde_json::Value> {
    tokio::task::spawn_blocking(move || {
        let deadline = Instant::now() + Duration::from_secs(300);
        loop {
            let mut answer = ureq::get(&url).call().with_context(|| format!("GET {url}"))?;
            let body = answer.body_mut().read_to_string()?;
            if answer.status() == 200 {
                return Ok(serde_json::from_str(&body)?);
            }
            if Instant::now() > deadline {
                return Err(failed(format!("{url} is not ready after five minutes: {body}")));
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    })
    .await?
}

fn print_line(text: &str) -> std::io::Result<()> {
    let mut stdout = std::io::stdout();
    writeln!(stdout, "{text}")?;
    stdout.flush()
}
