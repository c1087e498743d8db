//! From SQLite to noise parameters: time and memory; prints figures, `cargo bench --bench record`.
//!
//! Two records of the demonstration's sensor: the six inertial channels of five hours at 40 Hz, and nine channels of
//! five hours at 800 Hz (`--long`, 14.4 million samples, 2.7 GB under `TMPDIR`). Each is analysed by a background job
//! and by `vn100d noise`. The time for reading only the samples is printed beside the job's.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on ends")]

mod made;

use imu_core::sample::Channel;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use vn100d::jobs::{AnalysisRequest, JobKind, Jobs, JobsOptions};
use vn100d::store::{CaptureState, JobState, NewCapture, Store, StoreOptions};

fn main() {
    // `cargo test --benches` only checks that it runs.
    let quick = !std::env::args().any(|argument| argument == "--bench");
    let long = std::env::args().any(|argument| argument == "--long");
    let inertial = &Channel::ANALYSED[3..9];
    assert!(inertial.iter().all(|channel| matches!(channel.unit(), "rad/s" | "m/s²")), "{inertial:?}");
    let samples = if quick { 20_000 } else { 720_000 };
    measure("5 h at 40 Hz, six inertial channels", inertial, 40.0, samples, if quick { 1 } else { 7 });
    if long {
        measure("5 h at 800 Hz, nine channels", &Channel::ANALYSED, 800.0, 14_400_000, 1);
    }
}

fn measure(what: &str, channels: &[Channel], rate_hz: f64, samples: u64, rounds: usize) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("vn100d.db");
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    let reader = store.reader().unwrap();
    let (mut reading, mut working, mut waiting, mut job_peak, mut command_peak) = (vec![], vec![], vec![], 0, 0);
    for _ in 0..rounds {
        // The same request twice is the same job, so each round has a separate capture.
        let capture = NewCapture::new("bench", CaptureState::Imported);
        let id = made::capture(&store, capture, channels, rate_hz, samples, |_, value| f64::from(value as f32));
        let begun = Instant::now();
        let mut seq = 0;
        while seq < samples {
            seq = reader.read_chunk(id, seq, 65_536, channels).unwrap().next_seq();
        }
        reading.push(begun.elapsed());
        reset_peak();
        let jobs = Jobs::start(&store, JobsOptions::default()).unwrap();
        let begun = Instant::now();
        let job = jobs.submit(id, AnalysisRequest::usual(JobKind::Noise).unwrap()).unwrap().0.id;
        while reader.job(job).unwrap().state != JobState::Done {
            std::thread::sleep(Duration::from_millis(1));
        }
        working.push(begun.elapsed());
        job_peak = peak_kb("self").max(job_peak);
        jobs.stop();
        let begun = Instant::now();
        command_peak = command(directory.path()).max(command_peak);
        waiting.push(begun.elapsed());
    }
    let median = |times: &mut Vec<Duration>| {
        times.sort_unstable();
        times[times.len() / 2].as_secs_f64()
    };
    let (reading, working, waiting) = (median(&mut reading), median(&mut working), median(&mut waiting));
    println!("{what}, {samples} samples, median of {rounds}:");
    println!("  reading alone   {reading:>7.3} s");
    println!("  noise job       {working:>7.3} s, {:.1} times the reading, {} MB", working / reading, job_peak / 1000);
    println!(
        "  vn100d noise    {waiting:>7.3} s, {:.1} times the reading, {} MB",
        waiting / reading,
        command_peak / 1000
    );
}

/// Runs `vn100d noise latest` to its end and returns its peak memory, kB.
fn command(data_dir: &Path) -> u64 {
    let mut child = Command::new(env!("CARGO_BIN_EXE_vn100d"))
        .args(["--data-dir", data_dir.to_str().unwrap(), "--json", "noise", "latest"])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut peak = 0;
    loop {
        // The memory of a process that has ended cannot be read: the last reading before its end counts.
        peak = peak.max(peak_kb(&child.id().to_string()));
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success());
            return peak;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Returns the peak memory of a process since its start or [`reset_peak`], kB; 0 if it has ended.
fn peak_kb(process: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

fn reset_peak() {
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
}
