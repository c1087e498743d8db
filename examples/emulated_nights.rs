//! The noise parameters of an emulated VN-100 with its factory filter, through pseudo-terminal, daemon and database.
//!
//! ```text
//! cargo run --release --example emulated_nights -- --nights 40 [--first 1] [--seconds 3600] [--rates 800,400,200,100,50]
//! ```
//!
//! The sensor samples at 800 Hz, sends means of 4 samples (register 85), and its own densities are those of `MODEL`. N
//! is the plateau as sampled: with d = 800 Hz / rate it is the sensor's own N times √(d/4), and the sensor's own N up
//! to d = 4. docs/validation.md has the table.

use imu_model::simulator::SensorModel;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use vn100d::clock::ScaledClock;
use vn100d::config::{Baud, Config, Device};
use vn100d::control::CaptureRequest;
use vn100d::daemon::{self, Options};
use vn100d::emulator::source::Source;
use vn100d::emulator::terminal::{Terminal, TerminalOptions};
use vn100d::emulator::{SensorOptions, VirtualSensor};

/// The densities of a VN-100 before its filter, with a walk that an hour shows.
const MODEL: &str = r#"{"format": "vn100d-sensor-model-1", "name": "emulated", "rate_hz": 800,
  "sampling": {"internal_rate_hz": 800, "filter_window": 4}, "channels": {
  "gyro_x": {"N": 6e-5, "B": 2.6e-5, "K": 1.5e-6}, "gyro_y": {"N": 6e-5, "B": 2.5e-5}, "gyro_z": {"N": 5.5e-5, "K": 1.7e-6},
  "accel_x": {"N": 1.05e-3, "B": 1.1e-3}, "accel_y": {"N": 8.5e-4}, "accel_z": {"N": 1.4e-3, "K": 6e-4, "bias": -9.79}}}"#;
/// Samples per second of real time: terminal, daemon and database keep up with this rate.
const PACE: f64 = 50_000.0;
const BAUD: u32 = 921_600;
const INTERNAL_RATE_HZ: f64 = 800.0;
const WINDOW: f64 = 4.0;

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// The results for one rate.
#[derive(Default)]
struct Found {
    channels: u32,
    inside: u32,
    named: u32,
    unusable: u32,
    missing: u64,
    /// Sum of (N − truth)/truth, and of its square.
    error: f64,
    square: f64,
    /// For B and K with a value: the number of intervals that contain the truth, the number of intervals, and limits
    /// below the truth.
    slow: [u32; 3],
}

fn night(rate_hz: f64, length: Duration, seed: u64) -> Result<serde_json::Value, Failed> {
    let folder = std::env::temp_dir().join(format!("vn100d-night-{}-{rate_hz}-{seed}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let clock = Arc::new(ScaledClock::new(PACE / rate_hz));
    let mut terminal = Terminal::open(TerminalOptions::default())?;
    let mut config = Config::default();
    config.sensor.device = Device::Path(terminal.path().to_owned());
    config.sensor.rate_hz = rate_hz;
    // 800 Hz does not fit 115,200 baud.
    let mut sensor = VirtualSensor::new(&SensorOptions::default());
    sensor.registers_mut().set_baud(BAUD);
    config.sensor.baud = Baud::Fixed(BAUD);
    config.http.listen = "127.0.0.1:0".parse()?;
    let stop_emulator = Arc::new(AtomicBool::new(false));
    let source = Source::model(SensorModel::from_json(MODEL, "emulated")?, seed);
    let emulator = std::thread::spawn({
        let (clock, stop) = (Arc::clone(&clock), Arc::clone(&stop_emulator));
        move || terminal.run(sensor, source, &clock, &stop)
    });
    let capture = CaptureRequest {
        duration: length,
        name: Some("night".to_owned()),
        start_at_utc_ns: None,
        note: None,
        numbered: false,
    };
    let config = tokio::sync::watch::channel(config).1;
    let options = Options { database: folder.join("vn100d.db"), config, capture: Some(capture), clock };
    let found = tokio::runtime::Runtime::new()?.block_on(async {
        let stop = CancellationToken::new();
        let (ready, started) = tokio::sync::oneshot::channel();
        let running = tokio::spawn(daemon::run(options, stop.clone(), |handle| {
            let _ = ready.send(handle.address);
        }));
        let address = started.await?;
        let noise = tokio::task::spawn_blocking(move || {
            // The status is 404 until the capture begins, a preliminary answer while it runs, 202 while its job runs.
            loop {
                std::thread::sleep(Duration::from_millis(200));
                let Ok(mut answer) = ureq::get(format!("http://{address}/v1/captures/latest/noise")).call() else {
                    continue;
                };
                if answer.status() == 200 {
                    let noise: serde_json::Value = serde_json::from_str(&answer.body_mut().read_to_string()?)?;
                    if noise["complete"] == true {
                        return Ok::<_, Failed>(noise);
                    }
                }
            }
        })
        .await?;
        stop.cancel();
        running.await??;
        noise
    });
    stop_emulator.store(true, Ordering::Relaxed);
    emulator.join().map_err(|_| "the emulator ended unexpectedly")??;
    std::fs::remove_dir_all(&folder)?;
    found
}

fn main() -> Result<(), Failed> {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str, or: &str| {
        let place = arguments.iter().position(|argument| argument == name);
        place.and_then(|place| arguments.get(place + 1)).map_or_else(|| or.to_owned(), String::clone)
    };
    let (nights, first): (u64, u64) = (option("--nights", "40").parse()?, option("--first", "1").parse()?);
    let length = Duration::from_secs(option("--seconds", "3600").parse()?);
    let truth: serde_json::Value = serde_json::from_str(MODEL)?;
    println!(
        "| rate, Hz | nights | N inside its interval | mean error of N | RMSE of N | register 85 named | unusable | B and K inside | limits below the truth | missing |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for rate in option("--rates", "800,400,200,100,50").split(',') {
        let rate_hz: f64 = rate.parse()?;
        let folding = (INTERNAL_RATE_HZ / rate_hz / WINDOW).max(1.0).sqrt();
        let mut found = Found::default();
        for seed in first..first + nights {
            let noise = night(rate_hz, length, seed)?;
            found.missing += noise["missing"].as_u64().unwrap_or(0);
            for (channel, model) in truth["channels"].as_object().into_iter().flatten() {
                let of = &noise["channels"][channel];
                let own = |letter: &str| model[letter].as_f64().unwrap_or(0.0);
                let within = |letter: &str, truth: f64| {
                    let ends = |end: usize| of[letter]["ci95"][end].as_f64();
                    ends(0).zip(ends(1)).map(|(low, high)| low <= truth && truth <= high)
                };
                found.channels += 1;
                found.unusable += u32::from(of["usable"] != true);
                found.named += u32::from(of["bandwidth"]["source"].as_str().is_some_and(|of| of.contains("85")));
                let n = own("N") * folding;
                found.inside += u32::from(within("N", n) == Some(true));
                let error = of["N"]["value"].as_f64().map_or(1.0, |value| value / n - 1.0);
                found.error += error;
                found.square += error * error;
                for letter in ["B", "K"] {
                    match within(letter, own(letter)) {
                        Some(inside) => {
                            found.slow[0] += u32::from(inside);
                            found.slow[1] += 1;
                        }
                        None => {
                            let limit = of[letter]["upper_limit95"].as_f64();
                            found.slow[2] += u32::from(limit.is_some_and(|limit| limit < own(letter)));
                        }
                    }
                }
            }
        }
        let Found { channels, inside, named, unusable, missing, error, square, slow: [held, intervals, below] } = found;
        let count = f64::from(channels);
        println!(
            "| {rate} | {nights} | {inside} of {channels} ({:.1} %) | {:+.3} % | {:.3} % | {named} | {unusable} | {held} of {intervals} | {below} | {missing} |",
            100.0 * f64::from(inside) / count,
            100.0 * error / count,
            100.0 * (square / count).sqrt()
        );
    }
    Ok(())
}
