//! The process and its host: killed, stopped, out of memory, upgraded (rows A1 to A10).

mod hangup;

use crate::audit::{Held, lines_with};
use crate::tools;
use crate::world::{Process, World, program};
use rand::{RngExt as _, SeedableRng as _};
use rusqlite::types::Value;
use rustix::process::Signal;
use std::os::unix::net::UnixDatagram;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const START: Duration = Duration::from_secs(20);
/// 400 Hz through 921,600 baud.
const FAST: &str = "[sensor]\nrate-hz = 400.0\nbaud = 921600\n";
const FAST_SENSOR: [&str; 2] = ["--baud", "921600"];

fn mono_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn integer(value: &Value) -> i64 {
    match value {
        Value::Integer(integer) => *integer,
        other => panic!("{other:?}"),
    }
}

/// Returns a sensor at 400 Hz with its log.
fn fast_sensor(world: &World) -> (Process, PathBuf) {
    let log = world.path("sensor.log");
    let sensor = world.emulate(&[&["--faults", "-", "--log", log.to_str().unwrap()], &FAST_SENSOR[..]].concat());
    (sensor, log)
}

/// Row A1.
#[test]
fn after_each_kill_nothing_reported_safe_is_lost_and_the_capture_goes_on_within_five_seconds() {
    let kills = tools::scaled(20, 200);
    let world = World::new();
    let (_sensor, log) = fast_sensor(&world);
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut daemon = world.daemon(FAST, &["--capture", "5h"]);
    world.until("samples are safe", START, || (world.committed() > 0).then_some(()), &daemon);
    let (mut worst_lost_s, mut worst_restart_s) = (0.0_f64, 0.0_f64);
    let mut rows_before = 0;
    for kill in 0..kills {
        // Every other kill comes right after the start, before anything is committed; the others after a commit.
        if kill % 2 == 1 {
            world.until("samples are safe", START, || (world.committed() > rows_before).then_some(()), &daemon);
        }
        let sleep = Duration::from_millis(random.random_range(50..1600));
        std::thread::sleep(sleep);
        let acked = world.committed();
        let killed_ns = mono_ns();
        daemon.kill();
        assert_eq!(world.query("PRAGMA integrity_check")[0][0], Value::Text("ok".into()), "after kill {kill}");
        let row = &world.query("SELECT count(*), max(host_mono_ns) FROM sample WHERE capture_id = 1")[0];
        let (rows, last_ns) = (integer(&row[0]) as u64, integer(&row[1]) as u64);
        assert!(rows >= acked, "after kill {kill}: {acked} were safe, {rows} are there");
        if rows > rows_before {
            worst_lost_s = worst_lost_s.max(killed_ns.saturating_sub(last_ns) as f64 / 1e9);
        }
        rows_before = rows;
        let begun = Instant::now();
        daemon = world.daemon(FAST, &[]);
        let more = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(rows));
        world.until("samples again", START, more, &daemon);
        worst_restart_s = worst_restart_s.max(begun.elapsed().as_secs_f64());
    }
    let found = world.settle_and_audit(&mut daemon, &log, None);
    println!(
        "A1: {kills} kills, acked lost 0, at most {worst_lost_s:.2} s uncommitted, at most {worst_restart_s:.2} s from restart to first sample, {} rows, {} missing",
        found.samples, found.missing
    );
    // Two kills with no commit between them leave one gap.
    assert!(found.causes().iter().all(|cause| *cause == "daemon_stopped"), "{:?}", found.causes());
    assert!((kills / 2..=kills).contains(&found.gaps.len()), "{} gaps", found.gaps.len());
    assert!(found.gaps.iter().all(|gap| gap.exact));
    assert!(worst_restart_s <= 5.0, "{worst_restart_s} s");
    assert!(worst_lost_s <= 1.0, "{worst_lost_s} s of data were not committed");
}

/// Row A3, while streaming.
#[test]
fn a_termination_while_streaming_loses_nothing_that_came_before_it() {
    let world = World::new();
    let (_sensor, log) = fast_sensor(&world);
    let mut daemon = world.daemon(FAST, &["--capture", "5h"]);
    world.until_more_samples(400, &daemon);
    let samples = world.get("/v1/status")["capture"]["samples"].as_u64().unwrap();
    let begun = Instant::now();
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    let took = begun.elapsed().as_secs_f64();
    let rows = integer(&world.query("SELECT count(*) FROM sample")[0][0]) as u64;
    println!("A3: ended within {took:.2} s");
    assert!(took <= 10.0 && rows >= samples, "{took} s, {rows} of {samples}");
    assert_eq!(
        world.query("SELECT state, missing FROM capture")[0],
        [Value::Text("capturing".into()), Value::Integer(0)]
    );
    let mut daemon = world.daemon(FAST, &[]);
    world.until_more_samples(100, &daemon);
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.causes(), ["daemon_stopped"]);
}

/// Makes a complete capture of this many samples, without jobs.
fn recorded(world: &World, samples: u64) {
    let mut daemon = world.daemon("", &[]);
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    let connection = rusqlite::Connection::open(world.database()).unwrap();
    connection
        .execute_batch(&format!(
            "BEGIN;
             INSERT INTO capture (id, name, source, state, created_utc_ns, started_utc_ns, ended_utc_ns, rate_hz, samples, segments,
                 sample_time_ns, software) VALUES (1, 'recorded', 'test', 'stopped', 0, 0, 1, 40.0, {samples}, 1, {samples} * 25000000, 'test');
             INSERT INTO segment (capture_id, segment_id, epoch, first_seq, samples, rate_hz, timebase, channels,
                 first_device_time_ns, last_device_time_ns, first_utc_ns, last_utc_ns)
                 VALUES (1, 1, 1, 0, {samples}, 40.0, 'device', '[\"gyro_x\"]', 0, ({samples} - 1) * 25000000, 0, {samples} * 25000000);
             WITH RECURSIVE n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i + 1 < {samples})
                 INSERT INTO sample (capture_id, segment_id, seq, device_time_ns, host_mono_ns, host_utc_ns, gyro_x)
                 SELECT 1, 1, i, i * 25000000, i * 25000000, i * 25000000, ((i * 7919) % 1009) / 1e6 FROM n;
             COMMIT;"
        ))
        .unwrap();
}

/// Row A3, during a job.
#[test]
fn a_termination_during_a_job_keeps_what_the_job_has() {
    let world = World::new();
    recorded(&world, 200_000);
    let mut slow = program();
    slow.env("VN100D_PROVOKE", "slow:job");
    let mut daemon = world.daemon_of(slow, "/nowhere", "", &[]);
    let (code, body) = world.request("POST", "/v1/jobs", r#"{"kind": "allan", "capture": "recorded"}"#).unwrap();
    assert_eq!(code, 202, "{body}");
    let moving = || Some(world.get("/v1/jobs/1")).filter(|job| job["progress"].as_f64() > Some(0.0));
    let progress = world.until("the job moves", START, moving, &daemon)["progress"].as_f64().unwrap();
    let begun = Instant::now();
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    let took = begun.elapsed().as_secs_f64();
    println!("A3: ended within {took:.2} s with the job at {progress}");
    assert!(took <= 10.0);
    let job = &world.query("SELECT state, progress >= 0.0, (SELECT count(*) FROM job_checkpoint) FROM job")[0];
    assert_eq!(job[..], [Value::Text("queued".into()), Value::Integer(1), Value::Integer(1)]);
    let mut daemon = world.daemon_on("/nowhere", "", &[]);
    let done = || Some(world.get("/v1/jobs/1")).filter(|job| job["state"] == "done");
    world.until("the job is done", START, done, &daemon);
    assert_eq!(daemon.terminate(), Some(0));
    assert_eq!(world.query("PRAGMA integrity_check")[0][0], Value::Text("ok".into()));
}

/// A separate file system that is removed with the test.
struct Mounted(PathBuf);

impl Mounted {
    fn small(path: &Path, megabytes: u32) -> Self {
        std::fs::create_dir_all(path).unwrap();
        let size = format!("size={megabytes}m");
        let done = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(path).status().unwrap();
        assert!(done.success(), "mount");
        Self(path.to_owned())
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// Row A3, while the disk is full: the program reports the data that it could not write, with an exit code other than
/// 0.
#[test]
fn a_termination_while_the_disk_is_full_ends_in_time_and_reports_what_is_lost() {
    if !tools::root("a file system of its own is mounted") {
        return;
    }
    let world = World::new();
    let disk = Mounted::small(&world.path("data"), 8);
    let (_sensor, log) = fast_sensor(&world);
    let mut daemon = world.daemon(FAST, &["--capture", "5h"]);
    world.until_more_samples(400, &daemon);
    let filler = world.path("data/filler");
    let full = std::fs::write(&filler, vec![1; 9 << 20]);
    assert!(full.is_err(), "the disk is full");
    let is_full = || Some(world.get("/v1/status")).filter(|status| status["storage"]["state"] == "storage_full");
    world.until("it is full", Duration::from_secs(20), is_full, &daemon);
    let committed = world.committed();
    let begun = Instant::now();
    let code = daemon.terminate();
    let took = begun.elapsed().as_secs_f64();
    println!("A3: full disk: ended within {took:.2} s with exit code {code:?}");
    assert!(took <= 10.0, "{took} s");
    // An exit code of 0 would state that everything is safe.
    assert_eq!(code, Some(74), "{}", daemon.log());
    std::fs::remove_file(&filler).unwrap();
    let rows = integer(&world.query("SELECT count(*) FROM sample")[0][0]) as u64;
    assert!(rows >= committed, "{rows} of {committed}");
    let mut daemon = world.daemon(FAST, &[]);
    world.until_more_samples(100, &daemon);
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.causes(), ["daemon_stopped"], "what could not be written is a gap");
    drop(disk);
}

/// systemd's side of the notification socket.
struct Manager {
    socket: UnixDatagram,
    path: PathBuf,
}

impl Manager {
    fn new(world: &World) -> Self {
        let path = world.path("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        Self { socket, path }
    }

    /// Returns how often the watchdog is fed within this time.
    fn fed(&self, within: Duration) -> usize {
        let deadline = Instant::now() + within;
        let (mut count, mut buffer) = (0, [0; 4096]);
        while Instant::now() < deadline {
            if let Ok(length) = self.socket.recv(&mut buffer) {
                count += usize::from(String::from_utf8_lossy(&buffer[..length]).contains("WATCHDOG=1"));
            }
        }
        count
    }

    /// Reads the daemon's messages from now on, as systemd does: the socket holds ten, and further ones wait or are
    /// dropped.
    fn listens(&self) -> Arc<Mutex<String>> {
        let messages = Arc::new(Mutex::new(String::new()));
        let (socket, weak) = (self.socket.try_clone().unwrap(), Arc::downgrade(&messages));
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Some(messages) = weak.upgrade() {
                if let Ok(length) = socket.recv(&mut buffer) {
                    messages.lock().unwrap().push_str(&String::from_utf8_lossy(&buffer[..length]));
                }
            }
        });
        messages
    }

    /// Returns the daemon, started as by systemd, with a watchdog of 8 s.
    fn daemon(&self, world: &World, configuration: &str, arguments: &[&str]) -> Process {
        let mut command = program();
        command.env("NOTIFY_SOCKET", &self.path).env("WATCHDOG_USEC", "8000000").env_remove("WATCHDOG_PID");
        world.daemon_of(command, world.port().to_str().unwrap(), configuration, arguments)
    }
}

/// Row A4.
#[test]
fn a_stopped_process_goes_on_and_what_it_missed_has_the_cause_host_stall() {
    let stopped = Duration::from_secs(tools::scaled(5, 60));
    let world = World::new();
    let (_sensor, log) = fast_sensor(&world);
    let manager = Manager::new(&world);
    let mut daemon = manager.daemon(&world, FAST, &["--capture", "5h"]);
    world.until_more_samples(400, &daemon);
    let stopped_ns = mono_ns();
    daemon.signal(Signal::STOP);
    std::thread::sleep(stopped);
    while manager.fed(Duration::from_millis(100)) > 0 {}
    daemon.signal(Signal::CONT);
    let continued_ns = mono_ns();
    let fed = manager.fed(Duration::from_secs(5));
    world.until_more_samples(400, &daemon);
    let found = world.settle_and_audit(&mut daemon, &log, None);
    let first = found.row_mono_ns.iter().find(|row| **row >= continued_ns).unwrap();
    let resumed = (first - continued_ns) as f64 / 1e9;
    let away = (continued_ns - stopped_ns) as f64 / 1e9;
    // Until the terminal was full it accepted data, which is not part of the gap: the sensor's log shows the rest.
    let overrun = found.log.count("overrun") as f64 / 400.0;
    let missing = found.missing as f64 / 400.0;
    println!(
        "A4: stopped {away:.2} s, {overrun:.3} s lost at the terminal, {missing:.3} s missing, first sample after {resumed:.2} s, fed {fed} times in 5 s"
    );
    assert!(fed >= 1, "the watchdog is fed again");
    assert!(resumed <= 3.0, "{resumed} s");
    assert!(!found.gaps.is_empty() && found.causes().iter().all(|cause| *cause == "host_stall"), "{:?}", found.gaps);
    assert!((overrun - missing).abs() <= 0.1, "{overrun} s lost, {missing} s missing");
    // 20 kB in the terminal, 4 kB before it.
    assert!(missing <= away + 0.1 && missing >= away - 1.5, "{away} s stopped, {missing} s missing");
}

/// A control group that limits memory, if this machine allows one.
struct Limited(PathBuf);

impl Limited {
    fn new(bytes: u64) -> Option<Self> {
        let name = format!("vn100d-test-{}", std::process::id());
        for (root, limit) in [
            ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            ("/sys/fs/cgroup", "memory.max"),
            ("/sys/fs/cgroup/unified", "memory.max"),
        ] {
            let folder = Path::new(root).join(&name);
            if std::fs::create_dir(&folder).is_err() {
                continue;
            }
            let limited = Self(folder.clone());
            if std::fs::write(folder.join(limit), bytes.to_string()).is_ok() {
                return Some(limited);
            }
        }
        None
    }

    fn take(&self, pid: u32) {
        std::fs::write(self.0.join("cgroup.procs"), pid.to_string()).unwrap();
    }
}

impl Drop for Limited {
    fn drop(&mut self) {
        for _ in 0..50 {
            if std::fs::remove_dir(&self.0).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

/// Row A5.
#[test]
fn little_memory_is_enough_for_a_large_request_a_job_and_a_capture() {
    let samples = tools::scaled(300_000, 1_000_000);
    let world = World::new();
    recorded(&world, samples);
    let log = world.path("sensor.log");
    let _sensor = world.emulate(&["--log", log.to_str().unwrap()]);
    let mut daemon = world.daemon("", &["--capture", "5h"]);
    let limited = Limited::new(128 << 20);
    match &limited {
        Some(limited) => limited.take(daemon.id()),
        None => eprintln!("no control group can be made here: memory is measured, not limited"),
    }
    world.until_more_samples(20, &daemon);
    let (code, body) = world.request("POST", "/v1/jobs", r#"{"kind": "noise", "capture": "recorded"}"#).unwrap();
    assert!(code == 202, "{code} {body}");
    let (mut most, mut answered) = (0, Vec::new());
    std::thread::scope(|scope| {
        let asking: Vec<_> = (0..4)
            .map(|_| {
                scope.spawn(|| {
                    world.request("GET", "/v1/captures/recorded/samples?format=csv", "").map(|(code, _)| code)
                })
            })
            .collect();
        while asking.iter().any(|asked| !asked.is_finished()) {
            most = most.max(Held::of(daemon.id()).anonymous_bytes);
            std::thread::sleep(Duration::from_millis(50));
        }
        answered.extend(asking.into_iter().map(|asked| asked.join().unwrap()));
    });
    let job = || Some(world.get("/v1/jobs/1")).filter(|job| job["state"] == "done");
    world.until("the job is done", Duration::from_secs(60), job, &daemon);
    most = most.max(Held::of(daemon.id()).anonymous_bytes);
    println!(
        "A5: at most {} MiB with {samples} samples; answers {answered:?}; limited: {}",
        most >> 20,
        limited.is_some()
    );
    assert!(most < 128 << 20, "{most}");
    assert!(answered.iter().all(|code| matches!(code, Some(200 | 413 | 429 | 503))), "{answered:?}");
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.missing, 0);
}

/// Row A6, in a handler.
#[test]
#[cfg_attr(not(debug_assertions), ignore = "only debug builds can be made to panic")]
fn a_panic_ends_the_process_at_once_and_the_capture_goes_on_after_the_restart() {
    let world = World::new();
    let (_sensor, log) = fast_sensor(&world);
    let mut poisoned = program();
    poisoned.env("VN100D_PROVOKE", "panic:handler");
    let mut daemon = world.daemon_of(poisoned, world.port().to_str().unwrap(), FAST, &["--capture", "5h"]);
    world.until_more_samples(400, &daemon);
    let acked = world.committed();
    assert!(world.request("GET", "/metrics", "").is_none());
    let status = daemon.ended(Duration::from_secs(5));
    // A shell reports this as 134.
    assert_eq!(status.signal(), Some(6), "{status:?}");
    assert_eq!(lines_with(&daemon.log(), &["panicked"]), 1, "{}", daemon.log());
    let rows = integer(&world.query("SELECT count(*) FROM sample")[0][0]) as u64;
    assert!(rows >= acked);
    let begun = Instant::now();
    let mut daemon = world.daemon(FAST, &[]);
    world.until_more_samples(100, &daemon);
    println!("A6: streams {:.2} s after the restart", begun.elapsed().as_secs_f64());
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.causes(), ["daemon_stopped"]);
}

/// Row A6, in a job.
#[test]
#[cfg_attr(not(debug_assertions), ignore = "only debug builds can be made to panic")]
fn a_job_that_panics_three_times_is_failed_and_the_daemon_goes_on() {
    let world = World::new();
    recorded(&world, 1000);
    let mut poisoned = program();
    poisoned.env("VN100D_PROVOKE", "panic:job");
    let mut daemon = world.daemon_of(poisoned, "/nowhere", "", &[]);
    let (code, body) = world.request("POST", "/v1/jobs", r#"{"kind": "allan", "capture": "recorded"}"#).unwrap();
    assert_eq!(code, 202, "{body}");
    let failed = || Some(world.get("/v1/jobs/1")).filter(|job| job["state"] == "failed");
    let job = world.until("the job is failed", 2 * START, failed, &daemon);
    println!("A6: {}", job["error"]);
    assert!(job["error"].as_str().unwrap().starts_with("tried 3 times: its process ended by signal 6"), "{job}");
    assert_eq!(lines_with(&daemon.log(), &["A child process says", "panicked"]), 3, "{}", daemon.log());
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    assert_eq!(world.query("PRAGMA integrity_check")[0][0], Value::Text("ok".into()));
}

/// Row A7: the writer hangs in an fsync that takes a minute.
#[test]
fn a_writer_that_hangs_is_reported_and_the_watchdog_is_not_fed() {
    if !tools::have("strace", "it makes fsync slow") {
        return;
    }
    let world = World::new();
    let (_sensor, log) = fast_sensor(&world);
    let manager = Manager::new(&world);
    let mut daemon = manager.daemon(&world, FAST, &["--capture", "5h"]);
    world.until_more_samples(400, &daemon);
    assert!(manager.fed(Duration::from_secs(5)) >= 1, "fed while all is well");
    let mut strace = Command::new("strace");
    strace.args(["-f", "-qq", "-o", "/dev/null", "-e", "trace=fsync,fdatasync"]);
    strace.args(["-e", "inject=fsync,fdatasync:delay_enter=60000000", "-p", &daemon.id().to_string()]);
    let mut attached = Process::start(&mut strace, false);
    let begun = Instant::now();
    let ill = || Some(world.get("/v1/status")).filter(|status| status["storage"]["state"] == "degraded");
    let status = world.until("storage is degraded", Duration::from_secs(15), ill, &daemon);
    let reported_s = begun.elapsed().as_secs_f64();
    assert!(status["storage"]["error"].as_str().unwrap().contains("commit has not ended"), "{}", status["storage"]);
    // The last turn may have earned one more feeding.
    manager.fed(Duration::from_secs(4));
    let fed = manager.fed(Duration::from_secs(6));
    let asked = Instant::now();
    world.get("/v1/status");
    println!(
        "A7: `{}` after {reported_s:.2} s, fed {fed} times in 6 s, status in {:?}",
        status["storage"]["state"],
        asked.elapsed()
    );
    assert_eq!(fed, 0, "the watchdog is withheld");
    assert!(reported_s <= 5.0, "{reported_s} s, of which up to a second until the next commit");
    assert!(asked.elapsed() < Duration::from_millis(500));
    let acked = world.committed();
    // Ended as by systemd's watchdog; strace releases no process before its delay is over.
    attached.kill();
    daemon.kill();
    let rows = integer(&world.query("SELECT count(*) FROM sample")[0][0]) as u64;
    assert!(rows >= acked);
    let mut daemon = world.daemon(FAST, &[]);
    world.until_more_samples(100, &daemon);
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.causes(), ["daemon_stopped"]);
}

/// Row A8.
#[test]
fn a_second_daemon_on_the_same_database_ends_at_once_and_names_the_first() {
    let world = World::new();
    let (_sensor, log) = fast_sensor(&world);
    let mut daemon = world.daemon(FAST, &["--capture", "5h"]);
    world.until_more_samples(100, &daemon);
    let begun = Instant::now();
    let data = world.path("data");
    let second = program()
        .args(["--data-dir", data.to_str().unwrap(), "--config", world.path("vn100d.toml").to_str().unwrap()])
        .args(["run", "--listen", "127.0.0.1:0", "--device", "/nowhere"])
        .output()
        .unwrap();
    let took = begun.elapsed().as_secs_f64();
    let stderr = String::from_utf8_lossy(&second.stderr).into_owned();
    println!("A8: ended within {took:.2} s: {}", stderr.trim());
    assert_eq!(second.status.code(), Some(73), "{stderr}");
    assert!(took <= 1.0, "{took} s");
    assert!(
        stderr.contains(&daemon.id().to_string()) && stderr.contains(world.database().to_str().unwrap()),
        "{stderr}"
    );
    world.until_more_samples(100, &daemon);
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.missing, 0, "the first is unaffected");
}

/// Row A9.
#[test]
fn a_port_that_another_program_holds_is_reported_with_its_name_and_taken_when_it_is_free() {
    if !tools::have("flock", "it holds the port") {
        return;
    }
    let world = World::new();
    let log = world.path("sensor.log");
    let sensor = world.emulate(&["--log", log.to_str().unwrap()]);
    let mut flock = Command::new("flock");
    flock.args([&sensor.first_line, "sleep", "60"]);
    let mut holder = Process::start(&mut flock, false);
    std::thread::sleep(Duration::from_millis(300));
    let mut daemon = world.daemon("", &["--capture", "5h"]);
    let busy = || Some(world.get("/v1/status")).filter(|status| status["sensor"]["state"] == "port_busy");
    let status = world.until("the port is busy", START, busy, &daemon);
    let hint = status["sensor"]["hint"].as_str().unwrap().to_owned();
    assert!(hint.contains(&format!("process {} (flock)", holder.id())), "{hint}");
    std::thread::sleep(Duration::from_secs(tools::scaled(5, 30)));
    assert_eq!(lines_with(&daemon.log(), &["is in use by"]), 1, "{}", daemon.log());
    // The child holds the lock too.
    for child in
        std::fs::read_to_string(format!("/proc/{0}/task/{0}/children", holder.id())).unwrap().split_whitespace()
    {
        let pid = rustix::process::Pid::from_raw(child.parse().unwrap()).unwrap();
        rustix::process::kill_process(pid, Signal::KILL).unwrap();
    }
    holder.kill();
    let begun = Instant::now();
    world.until_more_samples(1, &daemon);
    let took = begun.elapsed().as_secs_f64();
    println!("A9: `{hint}`; streams {took:.2} s after it is free");
    assert!(took <= 10.0, "{took} s: the longest wait, and a second to configure");
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.missing, 0);
}

/// A resumed capture first tries the one of eight baud rates that worked.
#[test]
fn a_capture_that_goes_on_tries_the_baud_rate_first_that_worked() {
    let world = World::new();
    let _sensor = world.emulate(&["--strict-baud", "--baud", "57600"]);
    let streams = |daemon: &Process| {
        let (begun, mut tried) = (Instant::now(), Vec::new());
        let streaming = || {
            let sensor = world.try_get("/v1/status")?["sensor"].take();
            tried.extend(sensor["baud"].as_u64().filter(|baud| tried.last() != Some(baud)));
            (sensor["state"] == "streaming").then_some(())
        };
        world.until("it streams", START, streaming, daemon);
        (tried, begun.elapsed().as_secs_f64())
    };
    let mut daemon = world.daemon("", &["--capture", "5h"]);
    let (first, first_s) = streams(&daemon);
    world.until("samples are safe", START, || (world.committed() > 0).then_some(()), &daemon);
    daemon.kill();
    let daemon = world.daemon("", &[]);
    let (again, again_s) = streams(&daemon);
    println!("baud rates tried: {first:?} in {first_s:.2} s, after the restart {again:?} in {again_s:.2} s");
    assert!(first.len() > 1, "{first:?}");
    assert_eq!(again, [57_600]);
}

/// Status, events and notifications show one name, which is the database's.
#[test]
fn a_capture_without_a_given_name_has_one_name_everywhere() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let notice_file = world.path("told");
    let notify = format!(
        "[notify]\ncommand = [\"/bin/sh\", \"-c\", \"cat >> {}\"]\nevents = [\"capture_completed\"]\n",
        notice_file.display()
    );
    let daemon = world.daemon(&notify, &["--capture", "2s"]);
    let name = world.get("/v1/captures/latest")["name"].as_str().unwrap().to_owned();
    let running = || world.try_get("/v1/status").filter(|status| !status["capture"].is_null());
    let status = world.until("it runs", START, running, &daemon);
    assert_eq!(status["capture"]["name"], name.as_str());
    let written =
        || std::fs::read_to_string(&notice_file).ok().filter(|text| text.ends_with('}') || text.ends_with('\n'));
    let notice = world.until("its end is reported", START, written, &daemon);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&notice).unwrap()["capture"]["name"], name.as_str());
    let events = world.get("/v1/captures/latest/events").to_string();
    assert!(events.contains(&format!("capture `{name}` has its first sample")), "{events}");
    let page = world.request("GET", "/captures/latest", "").unwrap().1;
    assert!(page.contains(&name), "{page}");
    let data = world.path("data").display().to_string();
    for arguments in [&["captures"][..], &["show", "latest"], &["noise", "latest"]] {
        let output = crate::world::vn100d(&[&["--data-dir", &data], arguments].concat());
        assert!(String::from_utf8_lossy(&output.stdout).contains(&name), "{arguments:?}: {output:?}");
    }
}
