//! The speed of exports: `vn100d export` in each format, ten channels and their times, five hours at 40 Hz; prints
//! figures, `cargo bench --bench export`. `python3 benches/export.py` runs that and pandas on the same database.
//!
//! Two captures of the demonstration's sensor: values as its ASCII output rounds them, and as the floats of its binary
//! output. Times are those of the whole command, from its start to the file under its name, beside the time for reading
//! only the samples. With `EXPORT_DIR` set, the database and the figures are written there.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on ends")]

mod made;

use imu_core::sample::Channel;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;
use vn100d::store::{CaptureState, NewCapture, Reader, Store, StoreOptions};

const RATE_HZ: f64 = 40.0;
const FORMATS: [&str; 4] = ["parquet", "csv", "ndjson", "mcap"];

fn main() {
    // `cargo test --benches` only checks that it runs.
    let quick = !std::env::args().any(|argument| argument == "--bench");
    let (samples, rounds) = if quick { (20_000, 1) } else { (720_000, 7) };
    let temporary = tempfile::tempdir().unwrap();
    let left = std::env::var_os("EXPORT_DIR");
    let directory = left.as_deref().map_or(temporary.path(), Path::new);
    let database = directory.join("vn100d.db");
    for suffix in ["", "-wal", "-shm"] {
        let _ = std::fs::remove_file(directory.join(format!("vn100d.db{suffix}")));
    }
    let channels: Vec<Channel> = Channel::ANALYSED.into_iter().chain([Channel::Temperature]).collect();
    let store = Store::open(&database, StoreOptions::default()).unwrap();
    for (name, binary) in [("decimals", false), ("floats", true)] {
        let mut capture = NewCapture::new("bench", CaptureState::Imported);
        capture.name = Some(name.to_owned());
        made::capture(&store, capture, &channels, RATE_HZ, samples, |channel, value| written(channel, value, binary));
    }
    store.close().unwrap();
    println!("{samples} samples, {} channels and their times, median of {rounds}", channels.len());
    let mut rows = Vec::new();
    for name in ["decimals", "floats"] {
        let mut reading = Vec::new();
        for _ in 0..rounds {
            reading.push(read(&database, name, &channels, samples));
        }
        println!("{name}: reading alone {:>28.0} rows/s", samples as f64 / median(&mut reading));
        for format in FORMATS {
            let out = directory.join(format!("{name}.{format}"));
            let (mut times, mut peak_kb) = (Vec::new(), 0);
            for _ in 0..rounds {
                let begun = Instant::now();
                peak_kb = export(directory, name, &out).max(peak_kb);
                times.push(begun.elapsed().as_secs_f64());
            }
            let (time_s, bytes) = (median(&mut times), std::fs::metadata(&out).unwrap().len());
            println!(
                "{name}: {format:<8} {time_s:>7.3} s {:>12.0} rows/s, {:>5.1} bytes a row, {} MB held",
                samples as f64 / time_s,
                bytes as f64 / samples as f64,
                peak_kb / 1000
            );
            rows.push(serde_json::json!({ "capture": name, "format": format, "s": time_s, "bytes": bytes }));
        }
    }
    if left.is_some() {
        let columns: Vec<&str> = channels.iter().map(|channel| channel.name()).collect();
        let run = serde_json::json!({ "samples": samples, "columns": columns, "rows": rows });
        std::fs::write(directory.join("run.json"), run.to_string()).unwrap();
    }
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Returns a value with the precision of the sensor's binary output, or with the decimals of its `$VN…` lines.
fn written(channel: Channel, value: f64, binary: bool) -> f64 {
    if binary {
        return f64::from(value as f32);
    }
    let steps = match channel.unit() {
        "rad/s" => 1e6,
        "gauss" => 1e4,
        "m/s²" => 1e3,
        _ => 10.0,
    };
    (value * steps).round() / steps
}

/// Reads the samples with their clocks; returns the time in s.
fn read(database: &Path, name: &str, channels: &[Channel], samples: u64) -> f64 {
    let reader = Reader::open(database).unwrap();
    let id = reader.resolve(name).unwrap();
    let begun = Instant::now();
    let mut seq = 0;
    while seq < samples {
        seq = reader.read_samples(id, seq, 8192, channels).unwrap().next_seq();
    }
    begun.elapsed().as_secs_f64()
}

/// Runs `vn100d export` to its end and returns its peak memory, kB.
fn export(data_dir: &Path, capture: &str, out: &Path) -> u64 {
    let mut child = Command::new(env!("CARGO_BIN_EXE_vn100d"))
        .args(["--data-dir", data_dir.to_str().unwrap(), "--json", "export", capture, "--force"])
        .args(["--out", out.to_str().unwrap()])
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
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

/// Returns the peak memory of a process, kB; 0 if it has ended.
fn peak_kb(process: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}
