//! The cost of a capture: the built daemon records an emulated sensor at 800 Hz binary (70 bytes per frame, 921,600
//! baud) in real time; its processor time and peak memory are read from /proc.
//!
//! `cargo bench --bench capture`; `VN100D_BENCH_S=60` measures for 60 s instead of 20 s.

#![expect(clippy::expect_used, reason = "a bench that cannot go on ends")]

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The kernel's clock ticks per second in /proc/PID/stat (`getconf CLK_TCK`; 100 on every Linux architecture but alpha).
const TICKS_PER_SECOND: f64 = 100.0;
/// The project's limit.
const CORE_SHARE_MAX: f64 = 0.03;
const MEMORY_MIB_MAX: f64 = 64.0;

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn cpu_s(pid: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("the daemon runs");
    let fields: Vec<&str> = stat.rsplit(") ").next().expect("a stat line").split(' ').collect();
    let ticks: f64 = fields[11].parse::<f64>().expect("utime") + fields[12].parse::<f64>().expect("stime");
    ticks / TICKS_PER_SECOND
}

fn peak_mib(pid: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("the daemon runs");
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).expect("a peak");
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<f64>().ok()).expect("a number") / 1024.0
}

fn main() {
    let seconds: f64 = std::env::var("VN100D_BENCH_S").ok().and_then(|text| text.parse().ok()).unwrap_or(20.0);
    let folder = tempfile::tempdir().expect("a folder");
    let program = env!("CARGO_BIN_EXE_vn100d");
    let link = folder.path().join("sensor");
    let mut emulator = Command::new(program)
        .args(["emulate", "--baud", "921600", "--link", link.to_str().expect("a path")])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the emulator starts");
    let mut line = String::new();
    BufReader::new(emulator.stdout.take().expect("its output")).read_line(&mut line).expect("its terminal");
    let _emulator = Running(emulator);
    let config = folder.path().join("vn100d.toml");
    std::fs::write(&config, "[sensor]\nbaud = 921600\nrate-hz = 800\n").expect("a configuration");
    let port =
        std::net::TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a port").port();
    let daemon = Command::new(program)
        .args(["--data-dir", folder.path().join("data").to_str().expect("a path")])
        .args(["--config", config.to_str().expect("a path")])
        .args(["run", "--capture", "1h", "--listen", &format!("127.0.0.1:{port}")])
        .args(["--device", link.to_str().expect("a path")])
        .stderr(Stdio::null())
        .spawn()
        .expect("the daemon starts");
    let pid = daemon.id();
    let _daemon = Running(daemon);
    let url = format!("http://127.0.0.1:{port}/v1/status");
    let status = || -> Option<serde_json::Value> {
        serde_json::from_str(&ureq::get(&url).call().ok()?.body_mut().read_to_string().ok()?).ok()
    };
    let samples = || status().and_then(|status| status["capture"]["samples"].as_u64()).unwrap_or(0);
    let patience = Instant::now();
    while samples() < 1600 {
        assert!(patience.elapsed() < Duration::from_secs(20), "no samples within 20 s: {:?}", status());
        std::thread::sleep(Duration::from_millis(100));
    }
    let (cpu, begun, before) = (cpu_s(pid), Instant::now(), samples());
    std::thread::sleep(Duration::from_secs_f64(seconds));
    let (used, took, taken) = (cpu_s(pid) - cpu, begun.elapsed().as_secs_f64(), samples() - before);
    let last = status().expect("a status");
    let share = used / took;
    println!("capture of 800 Hz binary for {took:.1} s: {taken} samples ({:.1} Hz)", taken as f64 / took);
    println!("  processor  {:.2} % of one core (at most {:.0} %)", 100.0 * share, 100.0 * CORE_SHARE_MAX);
    println!("  memory     {:.1} MiB at its peak (at most {MEMORY_MIB_MAX:.0} MiB)", peak_mib(pid));
    println!("  missing    {} in {} gaps", last["capture"]["missing"], last["capture"]["gaps"]);
    assert_eq!(last["capture"]["missing"], 0, "samples are missing");
}
