//! Isolation: a combination of all requests to the daemon costs the recorder no sample (row H).
//!
//! `VN100D_ISOLATION=30m` sets the duration, and states that nothing else runs on the machine: the figures must then
//! meet the promises. Otherwise the test takes 15 s beside other tests, and lost samples are only bounded. As root the
//! daemon is in a memory cgroup with the limit of its unit.

use crate::http::{ask, memory, p99};
use crate::jobs::{children, fill, model, noise, plain, settle, wakes};
use crate::tools::{root, scaled};
use crate::world::{Process, World, program};
use imu_core::sample::Channel;
use serde_json::json;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

const MIB: u64 = 1 << 20;
/// The unit's `MemoryMax=`.
const UNIT_BYTES: u64 = 1280 * MIB;
/// The maximum resident memory of the recorder's own process.
const RECORDER_BYTES: u64 = 64 * MIB;
/// The size of a hostile body: the largest that is accepted.
const BODY_BYTES: usize = 32_000_000;
/// Number of workers that are killed.
const KILLS: u32 = 20;

/// A memory cgroup with the unit's limit; removed when dropped.
struct Cgroup {
    folder: PathBuf,
    /// Whether the hierarchy is version 2.
    unified: bool,
}

impl Cgroup {
    fn new(daemon: &Process) -> Option<Self> {
        let name = format!("vn100d-test-{}", daemon.id());
        let v2 = Path::new("/sys/fs/cgroup/cgroup.controllers");
        let unified = std::fs::read_to_string(v2).is_ok_and(|text| text.contains("memory"));
        let parent = if unified { "/sys/fs/cgroup" } else { "/sys/fs/cgroup/memory" };
        let folder = Path::new(parent).join(name);
        std::fs::create_dir(&folder).ok()?;
        let cgroup = Self { folder, unified };
        let limit = if unified { "memory.max" } else { "memory.limit_in_bytes" };
        std::fs::write(cgroup.folder.join(limit), UNIT_BYTES.to_string()).ok()?;
        std::fs::write(cgroup.folder.join("cgroup.procs"), daemon.id().to_string()).ok()?;
        Some(cgroup)
    }

    /// Returns the number of processes that were killed for lack of memory.
    fn killed(&self) -> u64 {
        let file = if self.unified { "memory.events" } else { "memory.oom_control" };
        let text = std::fs::read_to_string(self.folder.join(file)).unwrap();
        let line = text.lines().find(|line| line.starts_with("oom_kill ")).unwrap_or("oom_kill 0");
        line.rsplit(' ').next().unwrap().parse().unwrap()
    }

    /// Returns the present memory that does not belong to files.
    fn anonymous(&self) -> u64 {
        let name = if self.unified { "anon " } else { "total_rss " };
        let text = std::fs::read_to_string(self.folder.join("memory.stat")).unwrap_or_default();
        let line = text.lines().find(|line| line.starts_with(name));
        line.and_then(|line| line.rsplit(' ').next()?.parse().ok()).unwrap_or(0)
    }
}

impl Drop for Cgroup {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}

/// Removes a group once its processes are gone.
fn remove(folder: &Path) {
    for _ in 0..50 {
        if std::fs::remove_dir(folder).is_ok() {
            return;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// A group with a share of the processor (cgroup v1); removed when dropped.
struct Share(PathBuf);

impl Share {
    /// 1024 is the default share of a group.
    fn new(name: &str, shares: u32) -> Option<Self> {
        let folder = Path::new("/sys/fs/cgroup/cpu").join(format!("vn100d-test-{}-{name}", std::process::id()));
        std::fs::create_dir(&folder).ok()?;
        let share = Self(folder);
        std::fs::write(share.0.join("cpu.shares"), shares.to_string()).ok()?;
        // A kernel that divides real-time priority among groups accepts no real-time thread in a group without a share.
        let _ = std::fs::write(share.0.join("cpu.rt_runtime_us"), "100000");
        Some(share)
    }

    fn take(&self, pid: u32) {
        std::fs::write(self.0.join("cgroup.procs"), pid.to_string()).unwrap();
    }

    /// Moves the calling thread into the group.
    fn take_thread(&self) {
        let thread = std::fs::read_link("/proc/thread-self").unwrap();
        std::fs::write(self.0.join("tasks"), thread.file_name().unwrap().as_encoded_bytes()).unwrap();
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        remove(&self.0);
    }
}

/// The number of this policy in `sched_setscheduler`.
const SCHED_RR: u64 = 2;

/// Returns the scheduling policy of a thread of this name.
fn policy(pid: u32, name: &str) -> u64 {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap().flatten();
    let mut all = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("stat")).ok());
    let stat = all.find(|stat| stat.contains(&format!("({name})"))).unwrap();
    // The fields behind the name begin with the third; the policy is the 41st.
    stat.rsplit(") ").next().unwrap().split(' ').nth(38).unwrap().parse().unwrap()
}

/// Returns the status of a request whose body `fill` writes.
fn post(
    world: &World,
    route: &str,
    media_type: &str,
    length: u64,
    write: impl FnOnce(&mut TcpStream) -> std::io::Result<()>,
) -> Option<u16> {
    let mut stream = TcpStream::connect(world.url.trim_start_matches("http://")).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(600))).ok()?;
    write!(stream, "POST {route} HTTP/1.1\r\nHost: localhost\r\nContent-Type: {media_type}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n").ok()?;
    // A server that refuses does not read to the end.
    let _ = write(&mut stream);
    let mut text = String::new();
    let _ = stream.read_to_string(&mut text);
    text.split(' ').nth(1)?.parse().ok()
}

/// Sends a recording of this many bytes, row by row.
fn send_recording(stream: &mut TcpStream, bytes: u64, seed: u64) -> std::io::Result<()> {
    let mut out = std::io::BufWriter::with_capacity(1 << 16, stream);
    let head = "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n";
    out.write_all(head.as_bytes())?;
    let mut left = bytes - head.len() as u64;
    for row in 0_u64.. {
        let of = |channel| noise(row ^ (seed << 40), channel);
        let line = format!(
            "{:.3},{:.9},{:.9},{:.9},{:.7},{:.7},{:.7}\n",
            row as f64 / 200.0,
            of(Channel::GyroX),
            of(Channel::GyroY),
            of(Channel::GyroZ),
            of(Channel::AccelX),
            of(Channel::AccelY),
            of(Channel::AccelZ),
        );
        if line.len() as u64 + 1 > left {
            break;
        }
        left -= line.len() as u64;
        out.write_all(line.as_bytes())?;
    }
    out.write_all(&vec![b'\n'; left as usize])?;
    out.flush()
}

/// Requests to the daemon, and how often each was answered.
#[derive(Debug, Default)]
struct Asked {
    bodies: AtomicU64,
    diagnoses: AtomicU64,
    pages: AtomicU64,
    pictures: AtomicU64,
    imports: AtomicU64,
    exports: AtomicU64,
    kills: AtomicU64,
    refused: AtomicU64,
}

#[test]
fn nothing_that_is_asked_costs_the_recorder_a_sample() {
    let given = std::env::var("VN100D_ISOLATION").ok();
    let alone = given.is_some();
    let time = given.map_or(Duration::from_secs(15), |text| {
        imu_core::units::parse_duration(&text).expect("VN100D_ISOLATION is a duration, such as 30m")
    });
    let long = time > Duration::from_secs(300);
    let world = World::new();
    let nine = &Channel::ANALYSED;
    let night = fill(&world, "night", nine, &plain(if long { 720_000 } else { scaled(60_000, 720_000) }), noise);
    let sensor = world.emulate(&["--baud", "921600"]);
    if root("the emulated sensor ahead of everything else") {
        // It represents a sensor, which continues to send whatever the host does.
        for task in std::fs::read_dir(format!("/proc/{}/task", sensor.id())).unwrap().flatten() {
            let id = task.file_name().to_str().and_then(|id| rustix::process::Pid::from_raw(id.parse().ok()?));
            rustix::process::setpriority_process(id, -15).unwrap();
        }
    }
    let mut command = program();
    // As in the unit.
    command.env("MALLOC_ARENA_MAX", "2");
    let port = world.port();
    let configuration = "[sensor]\nrate-hz = 800\nbaud = 921600\n";
    // As under systemd, whose unit has CPUWeight=200. The clients represent other machines: their work costs this one
    // nothing.
    let shares = root("the daemon and its clients in processor groups")
        .then(|| Some((Share::new("unit", 2048)?, Share::new("clients", 2)?)))
        .flatten();
    if shares.is_none() {
        eprintln!("H1: without processor groups (cgroup v1), so the clients cost what the daemon has");
    }
    let elsewhere = || shares.iter().for_each(|(_, clients)| clients.take_thread());
    let mut daemon = world.daemon_of(command, port.to_str().unwrap(), configuration, &["--capture", "12h"]);
    shares.iter().for_each(|(unit, _)| unit.take(daemon.id()));
    let cgroup = root("the daemon in a memory cgroup").then(|| Cgroup::new(&daemon)).flatten();
    if root("the reader has a real-time priority") {
        assert_eq!(policy(daemon.id(), "reader"), SCHED_RR);
    }
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(800));
    world.until("samples at 800 Hz", Duration::from_secs(20), some, &daemon);
    let (pid, over, asked) = (daemon.id(), AtomicBool::new(false), Asked::default());
    let (most, unit_most, codes) =
        (AtomicU64::new(0), AtomicU64::new(0), Mutex::new(std::collections::BTreeMap::new()));
    let count = |what: &AtomicU64, status: Option<u16>| {
        *codes.lock().unwrap().entry(status).or_insert(0_u64) += 1;
        match status {
            Some(429) => asked.refused.fetch_add(1, Ordering::Relaxed),
            _ => what.fetch_add(1, Ordering::Relaxed),
        };
    };
    let go_on = || !over.load(Ordering::Relaxed);
    let hostile = {
        let (begin, end) = (r#"{"sim":{"x":["#, "{}]}}");
        let middle = "{},".repeat((BODY_BYTES - begin.len() - end.len()) / 3);
        format!("{begin}{middle}{end}").into_bytes()
    };
    let took = std::thread::scope(|scope| {
        let (world, asked, hostile, count, go_on, elsewhere) = (&world, &asked, &hostile, &count, &go_on, &elsewhere);
        for _ in 0..4 {
            scope.spawn(move || {
                elsewhere();
                while go_on() {
                    let route = format!("/v1/captures/{night}/diagnoses");
                    let status =
                        post(world, &route, "application/json", hostile.len() as u64, |to| to.write_all(hostile));
                    count(&asked.bodies, status);
                }
            });
        }
        scope.spawn(move || {
            elsewhere();
            for number in 1.. {
                let model = model(nine, 40.0, 1e-5 * f64::from(number));
                let answer = world.request(
                    "POST",
                    &format!("/v1/captures/{night}/diagnoses"),
                    &json!({"sim": model}).to_string(),
                );
                let Some((202, text)) = answer else {
                    assert!(!go_on(), "{answer:?}");
                    return;
                };
                let job: serde_json::Value = serde_json::from_str(&text).unwrap();
                let route = format!("/v1/jobs/{}", job["id"]);
                let ended = || {
                    world.try_get(&route).is_none_or(|job| !matches!(job["state"].as_str(), Some("queued" | "running")))
                };
                while go_on() && !ended() {
                    std::thread::sleep(Duration::from_millis(200));
                }
                if !go_on() {
                    return;
                }
                asked.diagnoses.fetch_add(1, Ordering::Relaxed);
            }
        });
        for browser in 0..6 {
            scope.spawn(move || {
                elsewhere();
                let get = |route: &str| world.request("GET", route, "").map(|(status, _)| status);
                while go_on() {
                    count(&asked.pages, get("/captures/latest"));
                    for picture in ["allan-gyro", "allan-accel", "timeseries-gyro_x", "timeseries-accel_z"] {
                        let form = if browser % 3 == 0 { "png" } else { "svg" };
                        count(&asked.pictures, get(&format!("/v1/captures/latest/plots/{picture}.{form}")));
                    }
                    std::thread::sleep(Duration::from_secs(1));
                }
            });
        }
        scope.spawn(move || {
            elsewhere();
            for seed in 0.. {
                let bytes = if long { 2_000_000_000 } else { scaled(5_000_000, 200_000_000) };
                let route = format!("/v1/imports?file=bench-{seed}.csv");
                let status = post(world, &route, "text/csv", bytes, |to| send_recording(to, bytes, seed));
                count(&asked.imports, status);
                if !go_on() || long {
                    return;
                }
            }
        });
        scope.spawn(move || {
            elsewhere();
            while go_on() {
                let route = format!("/v1/captures/{night}/samples?format=csv");
                let request = format!("GET {route} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
                let Ok(mut stream) = TcpStream::connect(world.url.trim_start_matches("http://")) else { return };
                let _ = stream.write_all(request.as_bytes());
                let mut head = [0; 12];
                let status = stream
                    .read_exact(&mut head)
                    .ok()
                    .and_then(|()| std::str::from_utf8(&head[9..12]).ok()?.parse().ok());
                let _ = std::io::copy(&mut stream, &mut std::io::sink());
                count(&asked.exports, status);
            }
        });
        scope.spawn(move || {
            let pause = time / KILLS;
            while go_on() {
                std::thread::sleep(pause);
                // An import that is killed again and again never ends.
                let is_job = |pid: &u32| {
                    let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
                    line.split(|byte| *byte == 0).any(|word| word == b"job")
                };
                let job = (0..100).find_map(|_| {
                    std::thread::sleep(Duration::from_millis(100));
                    children(pid).into_iter().find(is_job)
                });
                if let Some(child) = job.and_then(|pid| rustix::process::Pid::from_raw(pid as i32)) {
                    // The process may just have ended.
                    if rustix::process::kill_process(child, rustix::process::Signal::KILL).is_ok() {
                        asked.kills.fetch_add(1, Ordering::Relaxed);
                    }
                }
            }
        });
        let (most, unit_most, cgroup) = (&most, &unit_most, &cgroup);
        scope.spawn(move || {
            while go_on() {
                most.fetch_max(memory(pid, "VmRSS"), Ordering::Relaxed);
                unit_most.fetch_max(cgroup.as_ref().map_or(0, Cgroup::anonymous), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(100));
            }
        });
        let took = ask(world, 20, time);
        over.store(true, Ordering::Relaxed);
        took
    });
    assert!(daemon.is_running(), "{}", daemon.log());
    let status = world.get("/v1/status");
    let running = &status["capture"];
    let (most, unit_most) = (most.into_inner(), unit_most.into_inner());
    eprintln!(
        "H1: {time:?} at 800 Hz: {} samples, {} missing in {} gaps; status p50 {:?}, p99 {:?}; recorder at most {} MiB resident, \
         unit {} MiB; {asked:?}; {:?}",
        running["samples"],
        running["missing"],
        running["gaps"],
        took[took.len() / 2],
        p99(&took),
        most / MIB,
        unit_most / MIB,
        codes.lock().unwrap(),
    );
    let gaps = || world.get(&format!("/v1/captures/{}/gaps", running["id"]));
    let listed = || (gaps()["gaps"].as_array().unwrap().len() as u64 >= running["gaps"].as_u64().unwrap()).then(gaps);
    let gaps = world.until("the gaps are listed", Duration::from_secs(5), listed, &daemon);
    let (late, all) = wakes(&world, "0.02");
    eprintln!("H1: {} of {all} wakes were more than 20 ms late", all - late);
    // On every push other tests run beside it, on two cores: the machine's load is then more than the daemon's.
    let missing_max = if alone { 0 } else { running["samples"].as_u64().unwrap() / 10 };
    assert!(running["missing"].as_u64().unwrap() <= missing_max, "{gaps}");
    // A program with debug assertions is three times as large.
    let recorder_max = if cfg!(debug_assertions) { 2 * RECORDER_BYTES } else { RECORDER_BYTES };
    assert!(most < recorder_max, "the recorder had {} MiB", most / MIB);
    assert!(p99(&took) < Duration::from_millis(if alone { 50 } else { 1000 }), "{:?}", p99(&took));
    assert!(cgroup.as_ref().is_none_or(|cgroup| cgroup.killed() == 0 && unit_most < UNIT_BYTES));
    let Asked { bodies, diagnoses, pages, pictures, imports, exports, kills, .. } = &asked;
    let all = [bodies, diagnoses, pages, pictures, imports, exports].map(|count| count.load(Ordering::Relaxed));
    let killed = kills.load(Ordering::Relaxed);
    assert!(all[0] > 0 && killed > 0, "nothing was asked: {asked:?}");
    // The last one may fall behind the end.
    assert!(!alone || (killed >= u64::from(KILLS) - 1 && all.iter().all(|count| *count > 0)), "{asked:?}");
    // None: a client that continues to send after a refusal may not receive it. 503: the picture's process was among
    // those that were killed.
    let codes = codes.into_inner().unwrap();
    assert!(!alone || codes.contains_key(&Some(201)), "nothing was imported");
    assert!(codes.keys().all(|code| matches!(code, None | Some(200..=202 | 413 | 429 | 503))));
    daemon.terminate();
    drop(daemon);
    settle(&world);
}
