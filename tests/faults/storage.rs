//! Storage: full, failing, slow, read-only, locked, damaged, gone (rows C1 to C11), a power loss (A2), upgrades (A10).

mod damaged;
mod failing;
pub mod full;
mod held;
mod images;
mod large;
mod replaced;

use crate::world::{Process, World, program, vn100d};
use imu_core::sample::{Channel, Record, Sample, Segment, Timebase};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vn100d::store::{CaptureState, NewCapture, Store, StoreOptions};

const START: Duration = Duration::from_secs(20);
/// A line that carries 800 Hz.
const FAST: &[&str] = &["--baud", "921600"];

/// Returns the daemon started through other programs (`strace …`), on the world's port and data directory.
fn start(world: &World, wrapper: &[&str], configuration: &str, arguments: &[&str]) -> Process {
    let process = begin(world, wrapper, configuration, arguments);
    world.until("the daemon answers", START, || world.try_get("/healthz").map(|_| ()), &process);
    process
}

/// Starts the daemon as [`start`] does, without waiting for an answer.
fn begin(world: &World, wrapper: &[&str], configuration: &str, arguments: &[&str]) -> Process {
    let config = world.path("vn100d.toml");
    std::fs::write(&config, configuration).unwrap();
    let daemon = program();
    let mut command = match wrapper {
        [] => program(),
        [first, rest @ ..] => {
            let mut command = Command::new(first);
            command.args(rest).arg(daemon.get_program());
            for name in ["VN100D_DATA_DIR", "VN100D_CONFIG", "STATE_DIRECTORY", "NOTIFY_SOCKET", "RUST_LOG"] {
                command.env_remove(name);
            }
            command
        }
    };
    command
        .args(["--data-dir", world.path("data").to_str().unwrap(), "--config", config.to_str().unwrap()])
        .args(["run", "--listen", world.url.trim_start_matches("http://")])
        .args(["--device", world.port().to_str().unwrap()])
        .args(arguments);
    Process::start(&mut command, false)
}

/// Returns an `strace` command that injects faults; the traced program stays this process's child.
fn strace<'a>(calls: &'a str, inject: &'a str) -> Vec<&'a str> {
    vec!["strace", "-D", "-f", "-qq", "-o", "/dev/null", "-e", calls, "-e", inject]
}

/// Returns the last line of a program that has ended with an error.
fn last_words(process: &Process) -> String {
    let begun = Instant::now();
    loop {
        let log = process.log();
        match log.lines().find(|line| line.starts_with("error: ")) {
            Some(line) => return line.to_owned(),
            None => assert!(begun.elapsed() < Duration::from_secs(5), "{log}"),
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn status(world: &World) -> serde_json::Value {
    world.get("/v1/status")
}

fn committed(world: &World) -> u64 {
    world.try_get("/v1/status").and_then(|status| status["capture"]["committed"].as_u64()).unwrap_or(0)
}

/// Waits until this many samples are on disk.
fn until_committed(world: &World, samples: u64, patience: Duration, daemon: &Process) {
    world.until("samples on disk", patience, || (committed(world) >= samples).then_some(()), daemon);
}

fn until_state(world: &World, state: &str, patience: Duration, daemon: &Process) {
    let there = || world.try_get("/v1/status").filter(|status| status["storage"]["state"] == state);
    world.until(state, patience, there, daemon);
}

/// Stops the capture and the daemon, and audits the data.
fn stop_and_settle(world: &World, daemon: &mut Process) {
    let capture = world.get("/v1/captures/latest");
    let (code, body) = world.request("POST", &format!("/v1/captures/{}/stop", capture["id"]), "").unwrap();
    assert_eq!(code, 200, "{body}");
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    settle(world);
}

/// Checks that the database is intact, its counters agree with its rows, and only samples in gaps are missing.
fn settle(world: &World) {
    assert!(sound(&world.database()));
}

fn sound(database: &Path) -> bool {
    let output = vn100d(&["--json", "check", database.to_str().unwrap()]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    assert_eq!(output.status.code(), Some(0), "{report} {}", String::from_utf8_lossy(&output.stderr));
    report["ok"] == true
}

fn gaps(world: &World) -> Vec<serde_json::Value> {
    world.get("/v1/captures/latest/gaps")["gaps"].as_array().unwrap().clone()
}

/// Requests the status all the time and records how long the answers take.
struct Watch {
    stop: Arc<AtomicBool>,
    thread: std::thread::JoinHandle<Vec<Duration>>,
}

impl Watch {
    fn start(world: &World) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (url, stopped) = (format!("{}/v1/status", world.url), stop.clone());
        let thread = std::thread::spawn(move || {
            let agent: ureq::Agent =
                ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(20))).build().into();
            let mut took = Vec::new();
            while !stopped.load(Ordering::Relaxed) {
                let begun = Instant::now();
                agent.get(&url).call().unwrap().body_mut().read_to_string().unwrap();
                took.push(begun.elapsed());
                std::thread::sleep(Duration::from_millis(10));
            }
            took
        });
        Self { stop, thread }
    }

    /// Asserts that the 99th percentile is within 100 ms.
    fn settle(self) {
        self.stop.store(true, Ordering::Relaxed);
        let mut took = self.thread.join().unwrap();
        took.sort_unstable();
        let p99 = took[(took.len() - 1) * 99 / 100];
        println!("status: {} answers, p99 {p99:?}, slowest {:?}", took.len(), took.last().unwrap());
        assert!(p99 <= Duration::from_millis(100), "status: p99 {p99:?} of {}", took.len());
    }
}

/// A separate file system under the world's data directory, removed with the test.
pub struct Mount(pub PathBuf);

impl Mount {
    pub fn tmpfs(world: &World, size: &str) -> Self {
        let data = world.path("data");
        std::fs::create_dir_all(&data).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"])
            .arg(&data)
            .status()
            .unwrap();
        assert!(mounted.success());
        Self(data)
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

const PERIOD_NS: u64 = 2_500_000;
const UTC_NS: i64 = 1_800_000_000_000_000_000;

fn segment(number: u32, first_seq: u64) -> Record {
    Record::Segment(Segment {
        number,
        epoch: 1,
        first_seq,
        rate_hz: 400.0,
        timebase: Timebase::Device,
        channels: Channel::ALL.into_iter().collect(),
        first_device_time_ns: Some(first_seq * PERIOD_NS),
        first_utc_ns: utc_ns(first_seq),
        boot_id: None,
    })
}

fn utc_ns(seq: u64) -> i64 {
    UTC_NS + (seq * PERIOD_NS) as i64
}

fn sample(segment: u32, seq: u64) -> Record {
    let mut sample = Sample::at(1 + seq * PERIOD_NS, utc_ns(seq));
    sample.device_time_ns = Some(seq * PERIOD_NS);
    for channel in Channel::ALL {
        sample.set(channel, (seq as f64 + 0.1) * 1e-3 + f64::from(channel as u8));
    }
    Record::Sample { seq, segment, sample }
}

/// Makes a database with one capture of `batches` commits of `each` samples.
fn build(database: &Path, batches: u64, each: u64) {
    let store = Store::open(database, StoreOptions::default()).unwrap();
    let capture = NewCapture { name: Some("night".to_owned()), ..NewCapture::new("pty", CaptureState::Stopped) };
    let id = store.create_capture(capture).unwrap();
    store.records().blocking_send(id, segment(1, 0)).unwrap();
    for batch in 0..batches {
        for seq in batch * each..(batch + 1) * each {
            store.records().blocking_send(id, sample(1, seq)).unwrap();
        }
        if each < 8192 {
            store.flush_blocking().unwrap();
        }
    }
    store.flush_blocking().unwrap();
    store.close().unwrap();
}
