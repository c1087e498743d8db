//! Soak: all faults at once, for a given time, from a seed (row G).
//!
//! `VN100D_SOAK=8h` runs it for eight hours (30 s if it is not set), `VN100D_SOAK_SEED=N` repeats a run: the same
//! faults in the same order after the same pauses. Effects of the scheduler (the sample at which a kill falls) differ.
//! `VN100D_SOAK_RATE=800` sets the sensor's rate in Hz (400 unless it is set): 75 minutes then give the samples of 25
//! hours at 40 Hz. `VN100D_SOAK_CALM=1` omits faults, kills and jobs, to observe the memory alone.

use crate::audit::Held;
use crate::jobs::model;
use crate::storage::{Mount, full};
use crate::tools::{self, Faketime};
use crate::world::{Process, World, program, vn100d};
use imu_core::sample::Channel;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Bytes of a sample in the database (docs/performance.md).
const BYTES_PER_SAMPLE: u64 = 190;
/// Requests per second.
const REQUESTS: u32 = 20;
const ROUTES: [&str; 8] = [
    "/v1/status",
    "/healthz",
    "/readyz",
    "/metrics",
    "/v1/captures",
    "/v1/captures/latest",
    "/v1/captures/latest/gaps",
    "/v1/status",
];

fn rate_hz() -> u64 {
    std::env::var("VN100D_SOAK_RATE").map_or(400, |text| text.parse().expect("VN100D_SOAK_RATE is a number"))
}

/// Returns the requested duration and seed.
fn asked() -> (Duration, u64) {
    let duration = std::env::var("VN100D_SOAK").map_or(Duration::from_secs(30), |text| {
        imu_core::units::parse_duration(&text).expect("VN100D_SOAK is a duration, such as 10m")
    });
    let seed = std::env::var("VN100D_SOAK_SEED").ok().map(|text| text.parse().expect("VN100D_SOAK_SEED is a number"));
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    (duration, seed.unwrap_or(u64::from(now.subsec_nanos())))
}

/// Starts the daemon, with a separate civil time if it can be set.
fn start(world: &World, civil: Option<&Faketime>, arguments: &[&str]) -> Process {
    let mut command = program();
    command.envs(civil.iter().flat_map(|civil| civil.environment()));
    let configuration = format!("[sensor]\nrate-hz = {}.0\nbaud = 921600\n", rate_hz());
    world.daemon_of(command, world.port().to_str().unwrap(), &configuration, arguments)
}

/// The next fault.
#[derive(Debug)]
enum Fault {
    /// The daemon is killed and started again.
    Kill,
    /// The file system is full for a while.
    FullDisk(Duration),
    /// Every sync takes half a second, for a while.
    SlowSync(Duration),
    /// A command to the emulated sensor.
    Sensor(String),
}

impl Fault {
    fn next(random: &mut ChaCha8Rng) -> Self {
        let ms = random.random_range(200..2500);
        Self::Sensor(match random.random_range(0..14) {
            0 | 1 => return Self::Kill,
            2 => return Self::FullDisk(Duration::from_millis(2 * ms)),
            3 => return Self::SlowSync(Duration::from_millis(2 * ms)),
            4 | 5 => format!("unplug {ms}ms"),
            6 => format!("eof {ms}ms"),
            7 => format!("silence {}ms", 2 * ms),
            8 => format!("garbage {}", 4 * ms),
            9 => format!("checksum {}", random.random_range(1..20)),
            10 => format!("drop {}", random.random_range(1..40)),
            11 => format!("duplicate {}", random.random_range(1..20)),
            12 => format!("hold {}ms", ms / 4),
            _ => "reset".to_owned(),
        })
    }
}

/// Attaches `strace` to the running daemon and delays each of its syncs; its end releases the daemon.
fn slow_syncs(daemon: &Process, how_long: Duration) {
    let mut strace = Command::new("strace");
    strace.args(["-f", "-qq", "-o", "/dev/null", "-e", "trace=fsync,fdatasync"]);
    strace.args(["-e", "inject=fsync,fdatasync:delay_enter=500000", "-p", &daemon.id().to_string()]);
    let mut attached = Process::start(&mut strace, false);
    std::thread::sleep(how_long);
    assert!(attached.is_running(), "strace could not attach: {}", attached.log());
    // It lets go between two calls, which on a busy machine takes long.
    attached.signal(rustix::process::Signal::TERM);
    attached.ended(Duration::from_secs(120));
}

/// The outcomes of the requests.
#[derive(Default)]
struct Asked {
    answered: AtomicU64,
    server_errors: AtomicU64,
    status_s: Mutex<Vec<f64>>,
    jobs: AtomicU64,
    diagnoses: AtomicU64,
}

impl Asked {
    fn ask(&self, world: &World, stop: &AtomicBool) {
        for route in ROUTES.iter().cycle() {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            let begun = Instant::now();
            if let Some((code, body)) = world.request("GET", route, "") {
                self.answered.fetch_add(1, Ordering::Relaxed);
                if code >= 500 && code != 503 {
                    eprintln!("{route}: {code} {body}");
                    self.server_errors.fetch_add(1, Ordering::Relaxed);
                }
                if *route == "/v1/status" {
                    self.status_s.lock().unwrap().push(begun.elapsed().as_secs_f64());
                }
            }
            std::thread::sleep((Duration::from_secs(1) / REQUESTS).saturating_sub(begun.elapsed()));
        }
    }

    /// Runs one job after the other: a noise report, then a diagnosis.
    fn work(&self, world: &World, stop: &AtomicBool) {
        let diagnosis = serde_json::json!({"sim": model(&Channel::ANALYSED[..6], rate_hz() as f64, 1e-4)}).to_string();
        let wanted = [
            ("/v1/jobs", r#"{"kind": "noise", "capture": "latest"}"#),
            ("/v1/captures/latest/diagnoses", diagnosis.as_str()),
        ];
        for (route, wanted) in wanted.iter().cycle() {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            let submitted = world.request("POST", route, wanted);
            let id =
                submitted.and_then(|(_, body)| serde_json::from_str::<serde_json::Value>(&body).ok()?["id"].as_u64());
            while let Some(id) = id.filter(|_| !stop.load(Ordering::Relaxed)) {
                let job = world.try_get(&format!("/v1/jobs/{id}")).unwrap_or_default();
                if job["state"] == "done" || job["state"] == "failed" {
                    self.jobs.fetch_add(1, Ordering::Relaxed);
                    let is_diagnosis = job["kind"] == "diagnosis" && job["state"] == "done";
                    self.diagnoses.fetch_add(u64::from(is_diagnosis), Ordering::Relaxed);
                    break;
                }
                std::thread::sleep(Duration::from_millis(200));
            }
            std::thread::sleep(Duration::from_millis(500));
        }
    }
}

/// Cancels each job that waits or runs: a diagnosis may take minutes, and its process holds pipes and threads of the daemon.
fn end_jobs(world: &World, daemon: &Process) {
    let ended = || {
        let mut left = 0;
        for state in ["queued", "running"] {
            for job in world.try_get(&format!("/v1/jobs?state={state}"))?["jobs"].as_array()? {
                world.request("DELETE", &format!("/v1/jobs/{}", job["id"]), "")?;
                left += 1;
            }
        }
        (left == 0).then_some(())
    };
    world.until("every job has ended", Duration::from_secs(60), ended, daemon);
}

/// The time after which a process's growth is judged by its rate, s, and the permitted growth before.
const FIRST_S: f64 = 3600.0;
const FIRST_GROWTH_BYTES: f64 = (4 << 20) as f64;

/// Returns the growth of memory in bytes per hour, from (s, bytes) after `from_s`; `None` for less than ten minutes.
/// The minimum of each minute counts, because a job's work space varies.
fn slope(points: &[(f64, f64)], from_s: f64) -> Option<Slope> {
    let late: Vec<(f64, f64)> = points.iter().copied().filter(|(time, _)| *time > from_s).collect();
    let least = |minute: &[(f64, f64)]| minute.iter().copied().min_by(|one, other| one.1.total_cmp(&other.1));
    let points: Vec<(f64, f64)> =
        late.chunk_by(|one, next| (one.0 / 60.0).floor() == (next.0 / 60.0).floor()).filter_map(least).collect();
    let (first, last) = (points.first()?, points.last()?);
    if last.0 - first.0 < 600.0 {
        return None;
    }
    let count = points.len() as f64;
    let mean = |value: fn(&(f64, f64)) -> f64| points.iter().map(value).sum::<f64>() / count;
    let (time, bytes) = (mean(|point| point.0), mean(|point| point.1));
    let covariance: f64 = points.iter().map(|point| (point.0 - time) * (point.1 - bytes)).sum();
    let variance: f64 = points.iter().map(|point| (point.0 - time).powi(2)).sum();
    Some(Slope { bytes_per_h: 3600.0 * covariance / variance, span_s: last.0 - first.0 })
}

#[derive(Debug)]
struct Slope {
    bytes_per_h: f64,
    span_s: f64,
}

/// Row G.
#[test]
fn everything_at_once_loses_nothing_silently() {
    let (duration, seed) = asked();
    println!(
        "G: {duration:?} with seed {seed}; to repeat it: VN100D_SOAK={}s VN100D_SOAK_SEED={seed}",
        duration.as_secs()
    );
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // In eight hours a fault occurs every two and a half minutes, in half a minute every three seconds.
    let mean_s = (duration.as_secs_f64() / 200.0).clamp(2.0, 150.0);
    let world = World::new();
    // Twice the room that the samples need: a full disk was filled on purpose.
    let size = (64 << 20) + 2 * BYTES_PER_SAMPLE * rate_hz() * duration.as_secs();
    let disk = tools::root("a file system of its own is mounted").then(|| Mount::tmpfs(&world, &size.to_string()));
    let can_trace = tools::have("strace", "it makes fsync slow");
    let log = world.path("sensor.log");
    let civil = Faketime::new(world.folder.path(), "+0");
    let mut sensor = world.emulate(&["--faults", "-", "--baud", "921600", "--log", log.to_str().unwrap()]);
    let mut daemon = start(&world, civil.as_ref(), &["--capture", "30h"]);
    world.until_more_samples(400, &daemon);
    let (asked, stop) = (Asked::default(), AtomicBool::new(false));
    let (mut kills, mut faults, mut full_disks, mut slow, mut steps, mut backups) = (0, 0, 0, 0, 0, 0);
    // At the end of a long run the daemon continues for up to 100 minutes, so that the growth of its memory can be
    // judged.
    let long = duration >= Duration::from_secs(1800);
    let last_kill = duration - if long { (duration * 2 / 3).min(Duration::from_secs(6000)) } else { Duration::ZERO };
    let mut baseline = Held::of(daemon.id());
    let calm = std::env::var_os("VN100D_SOAK_CALM").is_some();
    let (mut slopes, mut late) = (Vec::new(), Vec::new());
    std::thread::scope(|scope| {
        let mut asking = vec![scope.spawn(|| asked.ask(&world, &stop))];
        if !calm {
            asking.push(scope.spawn(|| asked.work(&world, &stop)));
        }
        let begun = Instant::now();
        let mut started = Instant::now();
        let mut memory = Vec::new();
        while begun.elapsed() < duration {
            let pause = Duration::from_secs_f64(mean_s * random.random_range(0.5..1.5));
            let until = Instant::now() + pause;
            while Instant::now() < until {
                let held = Held::of(daemon.id());
                assert!(held.anonymous_bytes > 0, "the daemon ended by itself:\n{}", daemon.log());
                memory.push((started.elapsed().as_secs_f64(), held.anonymous_bytes as f64));
                std::thread::sleep(Duration::from_millis(500).min(pause));
            }
            if calm {
                continue;
            }
            match Fault::next(&mut random) {
                Fault::Sensor(fault) => {
                    sensor.send_line(&fault);
                    faults += 1;
                }
                Fault::FullDisk(how_long) => {
                    if let Some(Mount(folder)) = &disk {
                        let filler = full::fill(folder);
                        std::thread::sleep(how_long);
                        std::fs::remove_file(filler).unwrap();
                        full_disks += 1;
                    }
                }
                Fault::SlowSync(how_long) => {
                    if can_trace {
                        slow_syncs(&daemon, how_long);
                        slow += 1;
                    }
                }
                Fault::Kill if begun.elapsed() > last_kill => {}
                Fault::Kill => {
                    daemon.kill();
                    kills += 1;
                    slopes.extend(slope(&memory, 120.0));
                    late.extend(slope(&std::mem::take(&mut memory), FIRST_S));
                    daemon = start(&world, civil.as_ref(), &[]);
                    (started, baseline) = (Instant::now(), Held::of(daemon.id()));
                }
            }
            if random.random_bool(0.1) {
                let offset = random.random_range(-7200..7200);
                if let Some(civil) = &civil {
                    civil.step(&format!("{offset:+}"));
                    steps += 1;
                }
            }
            if random.random_bool(0.1) {
                backups += 1;
                let out = world.path(&format!("backup-{backups}.db"));
                let data = world.path("data");
                let made = vn100d(&["--data-dir", data.to_str().unwrap(), "backup", "--out", out.to_str().unwrap()]);
                assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
                let copy = rusqlite::Connection::open(&out).unwrap();
                let whole: String = copy.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
                assert_eq!(whole, "ok", "backup {backups}");
                drop(copy);
                std::fs::remove_file(&out).unwrap();
            }
        }
        slopes.extend(slope(&memory, 120.0));
        late.extend(slope(&memory, FIRST_S));
        stop.store(true, Ordering::Relaxed);
        for thread in asking {
            thread.join().unwrap();
        }
    });
    world.until_more_samples(400, &daemon);
    end_jobs(&world, &daemon);
    // Descriptors of a start may be fewer than those of a daemon at work.
    baseline.fds = baseline.fds.max(20);
    baseline.threads = baseline.threads.max(24);
    let found = world.settle_and_audit(&mut daemon, &log, Some(baseline));
    let mut status_s = asked.status_s.into_inner().unwrap();
    status_s.sort_by(f64::total_cmp);
    let p99 = status_s[status_s.len() * 99 / 100];
    println!(
        "G: {faults} faults, {kills} kills, {full_disks} full disks, {slow} times slow syncs, {steps} clock steps, {backups} backups, {} requests, {} jobs and {} of them diagnoses that were made; {} frames made, {} rows, {} missing in {} gaps, {:?}; status p99 {:.0} ms; {} MiB, {slopes:?}, after the first hour {late:?}",
        asked.answered.load(Ordering::Relaxed),
        asked.jobs.load(Ordering::Relaxed),
        asked.diagnoses.load(Ordering::Relaxed),
        found.log.frames.len(),
        found.samples,
        found.missing,
        found.gaps.len(),
        found.rejected,
        1e3 * p99,
        found.held.anonymous_bytes >> 20,
    );
    assert_eq!(asked.server_errors.load(Ordering::Relaxed), 0);
    assert!(calm || duration < Duration::from_secs(600) || asked.diagnoses.load(Ordering::Relaxed) > 0);
    assert!(found.samples > 0 && asked.answered.load(Ordering::Relaxed) > 0);
    for slope in &slopes {
        assert!(slope.bytes_per_h * slope.span_s.min(FIRST_S) / 3600.0 < FIRST_GROWTH_BYTES, "memory grows: {slope:?}");
    }
    for slope in late.iter().filter(|slope| slope.span_s >= 1500.0) {
        assert!(slope.bytes_per_h < f64::from(1 << 20), "memory grows: {slope:?}");
    }
}
