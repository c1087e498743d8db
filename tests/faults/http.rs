//! HTTP under abuse (rows E1 to E7): crowds, clients that stall or vanish, no files left, changes without the token.

mod import;
mod multitude;

use crate::jobs::{fill, noise, plain, settle};
use crate::tools::{have, scaled};
use crate::world::{Process, World, program};
use imu_core::sample::Channel;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::{Duration, Instant};

const SIX: [Channel; 6] =
    [Channel::AccelX, Channel::AccelY, Channel::AccelZ, Channel::GyroX, Channel::GyroY, Channel::GyroZ];
const MIB: u64 = 1 << 20;

fn connect(world: &World) -> TcpStream {
    let stream = TcpStream::connect(world.url.trim_start_matches("http://")).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream
}

/// Returns a connection on which these bytes were sent; `None` if the daemon does not accept it.
fn sent(world: &World, bytes: &[u8]) -> Option<TcpStream> {
    let mut stream = TcpStream::connect(world.url.trim_start_matches("http://")).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(10))).ok()?;
    stream.write_all(bytes).ok()?;
    Some(stream)
}

/// Returns whether the other side has closed: no more bytes can be read.
fn is_closed(stream: &mut TcpStream) -> bool {
    stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let mut rest = [0; 4096];
    loop {
        match stream.read(&mut rest) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return error.kind() == std::io::ErrorKind::ConnectionReset,
        }
    }
}

/// Returns `VmRSS`, `RssAnon` or `VmHWM` of a process in bytes.
pub fn memory(pid: u32, name: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with(name)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() * 1024
}

fn metric(world: &World, name: &str) -> f64 {
    let text = world.request("GET", "/metrics", "").unwrap().1;
    let line =
        text.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap_or_else(|| panic!("{name}: {text}"));
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

/// Requests the status this many times per second, for this time; returns the durations, the shortest first.
pub fn ask(world: &World, per_s: u32, time: Duration) -> Vec<Duration> {
    let askers = per_s.div_ceil(50);
    let mut took: Vec<Duration> = std::thread::scope(|scope| {
        let ask = move || {
            let (begun, pause) = (Instant::now(), Duration::from_secs(1) * askers / per_s);
            let mut took = Vec::new();
            let mut next = Instant::now();
            while begun.elapsed() < time {
                let asked = Instant::now();
                let mut stream =
                    sent(world, b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
                let mut text = String::new();
                stream.read_to_string(&mut text).unwrap();
                assert!(text.starts_with("HTTP/1.1 200 "), "{text}");
                took.push(asked.elapsed());
                next += pause;
                std::thread::sleep(next.saturating_duration_since(Instant::now()));
            }
            took
        };
        let threads: Vec<_> = (0..askers).map(|_| scope.spawn(ask)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    took.sort_unstable();
    took
}

/// Asks as [`ask`] does, calls `meanwhile` every 50 ms, and returns the greatest memory of the daemon beside the times.
///
/// The memory is anonymous memory: an unoptimised build has more pages of its own code.
fn ask_and_watch(
    world: &World,
    daemon: &Process,
    per_s: u32,
    time: Duration,
    mut meanwhile: impl FnMut(),
) -> (u64, Vec<Duration>) {
    let mut most = 0;
    let took = std::thread::scope(|scope| {
        let asking = scope.spawn(|| ask(world, per_s, time));
        while !asking.is_finished() {
            meanwhile();
            most = most.max(memory(daemon.id(), "RssAnon"));
            std::thread::sleep(Duration::from_millis(50));
        }
        asking.join().unwrap()
    });
    (most, took)
}

pub fn p99(sorted: &[Duration]) -> Duration {
    sorted[sorted.len() * 99 / 100]
}

/// Returns the sensor and a daemon that captures, once samples arrive.
fn capturing(world: &World) -> (Process, Process) {
    let sensor = world.emulate(&[]);
    let daemon = world.daemon("", &["--capture", "1h"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(20));
    world.until("samples", Duration::from_secs(15), some, &daemon);
    (sensor, daemon)
}

fn nothing_missing(world: &World) {
    let status = world.get("/v1/status");
    assert_eq!((&status["capture"]["missing"], &status["capture"]["gaps"]), (&json!(0), &json!(0)), "{status}");
    assert_eq!(status["sensor"]["state"], "streaming", "{status}");
}

/// Row E1.
#[test]
fn a_thousand_half_heads_are_closed_in_time_and_do_no_harm() {
    let world = World::new();
    let (_sensor, daemon) = capturing(&world);
    let head = b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nX-Slow: ";
    let mut slow: Vec<TcpStream> = (0..1000).map(|_| sent(&world, head).unwrap()).collect();
    let opened = Instant::now();
    let (peak, took) = ask_and_watch(&world, &daemon, 50, Duration::from_secs(4), || ());
    assert!(p99(&took) <= Duration::from_millis(100), "99 of 100 answers within {:?}", p99(&took));
    std::thread::sleep(Duration::from_secs(6).saturating_sub(opened.elapsed()));
    let open = slow.iter_mut().filter_map(|stream| (!is_closed(stream)).then_some(())).count();
    assert_eq!(open, 0, "half heads still open 6 s after they came");
    nothing_missing(&world);
    let peak = peak.max(memory(daemon.id(), "RssAnon"));
    assert!(peak < 64 * MIB, "{} MiB", peak / MIB);
    eprintln!("E1: status p99 {:?} of {}, peak {} MiB", p99(&took), took.len(), peak / MIB);
    drop(daemon);
    settle(&world);
}

/// Row E2.
#[test]
fn a_thousand_idle_connections_and_200_requests_a_second_do_no_harm() {
    let world = World::new();
    let (_sensor, daemon) = capturing(&world);
    let request = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let mut idle: Vec<TcpStream> = (0..1000)
        .map(|_| {
            let mut stream = sent(&world, request).unwrap();
            let mut answer = [0; 1024];
            let length = stream.read(&mut answer).unwrap();
            assert!(answer[..length].starts_with(b"HTTP/1.1 200 "), "{}", String::from_utf8_lossy(&answer[..length]));
            stream
        })
        .collect();
    let opened = Instant::now();
    let time = scaled(Duration::from_secs(4), Duration::from_secs(30));
    let (peak, took) = ask_and_watch(&world, &daemon, 200, time, || ());
    assert!(p99(&took) <= Duration::from_millis(100), "99 of 100 answers within {:?}", p99(&took));
    std::thread::sleep(Duration::from_secs(6).saturating_sub(opened.elapsed()));
    let open = idle.iter_mut().filter_map(|stream| (!is_closed(stream)).then_some(())).count();
    assert_eq!(open, 0, "idle connections still open after 6 s");
    nothing_missing(&world);
    let peak = peak.max(memory(daemon.id(), "RssAnon"));
    assert!(peak < 64 * MIB, "{} MiB", peak / MIB);
    eprintln!("E2: status p99 {:?} of {}, peak {} MiB", p99(&took), took.len(), peak / MIB);
    drop(daemon);
    settle(&world);
}

/// Opens as many connections, sends what the daemon takes of these bytes without reading, and asks for the status meanwhile.
/// Returns the greatest memory and the times of the status.
fn crowd(world: &World, daemon: &Process, connections: usize, bytes: &[u8]) -> (u64, Vec<Duration>) {
    let mut sockets: Vec<(TcpStream, usize)> = (0..connections)
        .map(|_| {
            let stream = connect(world);
            stream.set_nonblocking(true).unwrap();
            (stream, 0)
        })
        .collect();
    ask_and_watch(world, daemon, 20, scaled(Duration::from_secs(2), Duration::from_secs(6)), || {
        for (stream, sent) in &mut sockets {
            let rest = &bytes[*sent..bytes.len().min(*sent + 32_768)];
            // A daemon that takes no more, or has closed, gets no more.
            *sent += stream.write(rest).unwrap_or(0);
        }
    })
}

/// Row E8.
#[test]
fn clients_that_finish_no_body_or_read_no_answer_share_one_budget() {
    let world = World::new();
    let (_sensor, mut daemon) = capturing(&world);
    let post = "POST /v1/models HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 65500\r\n\r\n";
    let body = format!("{post}{{\"name\":\"{}", "x".repeat(65_400));
    let get =
        |path: &str| format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nAccept-Encoding: gzip\r\n\r\n").repeat(600);
    let (page, openapi) = (get("/captures/latest"), get("/openapi.json"));
    for (what, connections, bytes) in [
        ("unfinished bodies", scaled(200, 900), &body),
        ("unread pages", scaled(200, 900), &page),
        ("unread descriptions", scaled(100, 500), &openapi),
    ] {
        let (most, took) = crowd(&world, &daemon, connections, bytes.as_bytes());
        eprintln!(
            "E8: {connections} {what}: {} MiB, status p99 {:?}, slowest {:?}",
            most / MIB,
            p99(&took),
            took.last()
        );
        assert!(most < scaled(64, 96) * MIB, "{what}: {} MiB", most / MIB);
        assert!(took.last().is_some_and(|slowest| *slowest < Duration::from_secs(2)), "{what}: {:?}", took.last());
        let have_gone = || (metric(&world, "vn100d_http_connections") <= 1.0).then_some(());
        world.until("the crowd has gone", Duration::from_secs(10), have_gone, &daemon);
    }
    nothing_missing(&world);
    // They do not delay the end by more than a second: nothing is recorded until the next start.
    let _unfinished: Vec<_> = (0..100).map(|_| sent(&world, &body.as_bytes()[..3000]).unwrap()).collect();
    let begun = Instant::now();
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    eprintln!("E8: SIGTERM beside them took {:?}", begun.elapsed());
    assert!(begun.elapsed() < Duration::from_secs(4), "{:?}", begun.elapsed());
    drop(daemon);
    settle(&world);
}

/// Row E3.
#[test]
fn readers_of_a_byte_a_second_are_dropped_after_30_s_and_hold_nothing() {
    const STREAMS: usize = 4;
    let world = World::new();
    let capture = fill(&world, "night", &SIX, &plain(scaled(300_000, 1_000_000)), noise);
    let daemon = world.daemon("", &[]);
    let before = memory(daemon.id(), "VmRSS");
    let request = format!("GET /v1/captures/{capture}/samples HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let begun = Instant::now();
    let mut slow: Vec<TcpStream> = (0..STREAMS).map(|_| sent(&world, request.as_bytes()).unwrap()).collect();
    let mut most = 0;
    let dropped = loop {
        for stream in &mut slow {
            // The kernel's buffer would last for months; an error is the end.
            let _ = stream.read(&mut [0]);
        }
        most = most.max(memory(daemon.id(), "VmRSS"));
        if begun.elapsed() > Duration::from_secs(5) && begun.elapsed() < Duration::from_secs(20) {
            // While they are held up, the log can be emptied to its end: no read transaction is open.
            let connection = rusqlite::Connection::open(world.database()).unwrap();
            let busy: i64 = connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get(0)).unwrap();
            assert_eq!(busy, 0, "a reader holds the log");
        }
        // This request has a connection too.
        if metric(&world, "vn100d_http_connections") <= 1.0 {
            break begun.elapsed();
        }
        assert!(begun.elapsed() < Duration::from_secs(45), "still open: {}", daemon.log());
        std::thread::sleep(Duration::from_secs(1));
    };
    assert!(dropped >= Duration::from_secs(29), "dropped after {dropped:?}");
    let each = most.saturating_sub(before) / STREAMS as u64;
    assert!(each < 8 * MIB, "{} MiB per stream", each / MIB);
    eprintln!("E3: dropped after {dropped:?}, {} KiB per stream", each >> 10);
    let again = world.request("GET", &format!("/v1/captures/{capture}/samples?to=1"), "").unwrap();
    assert_eq!(again.0, 200);
    drop(daemon);
    settle(&world);
}

/// Row E5.
#[test]
fn a_query_whose_client_has_gone_ends_within_a_second() {
    let world = World::new();
    let capture = fill(&world, "night", &SIX, &plain(scaled(600_000, 2_000_000)), noise);
    let daemon = world.daemon("", &[]);
    // More large queries than the four that may run: after twenty refusals the others run.
    let large = format!("/v1/captures/{capture}/samples?max_points=10");
    let request = format!("GET {large} HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let begun = Instant::now();
    assert_eq!(world.request("GET", &large, "").unwrap().0, 200);
    let alone = begun.elapsed();
    let clients: Vec<TcpStream> = (0..24).map(|_| sent(&world, request.as_bytes()).unwrap()).collect();
    let refused = |at_least: f64| metric(&world, "vn100d_http_queries_refused_total") >= at_least;
    world.until("all large queries run", Duration::from_secs(10), || refused(20.0).then_some(()), &daemon);
    let one_more = format!("/v1/captures/{capture}/samples?to=1");
    // Its answer comes after a pause, but the refusal is counted before.
    let asked = sent(&world, format!("GET {one_more} HTTP/1.1\r\nHost: localhost\r\n\r\n").as_bytes()).unwrap();
    let still = || refused(21.0).then_some(());
    world.until("four queries still run", Duration::from_secs(1), still, &daemon);
    // The connections are dropped with unread bytes: the kernel sends a reset.
    drop((clients, asked));
    std::thread::sleep(Duration::from_millis(900));
    let (status, text) = world.request("GET", &one_more, "").unwrap();
    assert_eq!(status, 200, "queries of clients that have gone still run: {text}");
    eprintln!("E5: a query is let in 0.9 s after the clients of four that take {alone:?} alone went");
    drop(daemon);
    settle(&world);
}

/// Returns a daemon under `prlimit --nofile=64`.
fn with_64_files(world: &World) -> Process {
    let mut command = Command::new("prlimit");
    let listen = world.url.trim_start_matches("http://");
    command.args(["--nofile=64:64", program().get_program().to_str().unwrap()]);
    command.args(["--data-dir", world.path("data").to_str().unwrap(), "run", "--listen", listen]);
    command.args(["--device", world.port().to_str().unwrap(), "--capture", "1h"]);
    command.env("VN100D_CONFIG", {
        std::fs::write(world.path("none.toml"), "").unwrap();
        world.path("none.toml")
    });
    let daemon = Process::start(&mut command, false);
    world.until("the daemon answers", Duration::from_secs(10), || world.try_get("/healthz"), &daemon);
    daemon
}

fn limit_files(pid: u32, files: u64) {
    // The hard limit stays, so that the soft one may be raised again.
    let status =
        Command::new("prlimit").args(["--pid", &pid.to_string(), &format!("--nofile={files}:")]).status().unwrap();
    assert!(status.success());
}

/// Row E6.
#[test]
fn without_files_left_nothing_breaks_and_accepting_goes_on() {
    if !have("prlimit", "limits the daemon to 64 open files") {
        return;
    }
    let world = World::new();
    let sensor = world.emulate(&[]);
    let daemon = with_64_files(&world);
    let streaming = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(20));
    world.until("samples", Duration::from_secs(15), streaming, &daemon);
    // Five times as many connections as there can be files; those held open repeat their requests.
    let request = b"GET /v1/captures HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let held: Vec<TcpStream> = (0..300).filter_map(|_| sent(&world, request)).collect();
    // Capture and store open their files first: the sensor is found again while connections are held.
    drop(sensor);
    std::thread::sleep(Duration::from_millis(300));
    let _sensor = world.emulate(&[]);
    let refresher = std::thread::spawn({
        let url = world.url.clone();
        move || {
            let mut held = held;
            let begun = Instant::now();
            while begun.elapsed() < Duration::from_secs(4) {
                held.extend((0..20).filter_map(|_| {
                    let mut stream = TcpStream::connect(url.trim_start_matches("http://")).ok()?;
                    stream.write_all(request).ok()?;
                    Some(stream)
                }));
                std::thread::sleep(Duration::from_millis(200));
            }
        }
    });
    refresher.join().unwrap();
    let answers = || world.try_get("/v1/status");
    let released = Instant::now();
    world.until("accepting goes on", Duration::from_secs(1), answers, &daemon);
    let after_crowd = released.elapsed();
    let again = || world.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "streaming");
    world.until("the sensor streams again", Duration::from_secs(3), again, &daemon);
    // No descriptor is free, whatever the daemon closes meanwhile: its first three are never closed. Accepting itself
    // fails, is counted, and continues once descriptors are free.
    limit_files(daemon.id(), 3);
    let mut waiting = sent(&world, b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let released = Instant::now();
    limit_files(daemon.id(), 64);
    let mut text = String::new();
    waiting.read_to_string(&mut text).unwrap();
    let after_famine = released.elapsed();
    assert!(text.starts_with("HTTP/1.1 200 "), "{text}");
    assert!(after_famine <= Duration::from_secs(1), "accepting went on after {after_famine:?}");
    assert!(metric(&world, "vn100d_http_accept_failures_total") > 0.0, "no accept failed: the test is none");
    eprintln!("E6: accepting after the crowd {after_crowd:?}, after the famine {after_famine:?}");
    drop(daemon);
    settle(&world);
}

/// Returns status and id of 50 identical submissions at once.
fn submit_50(world: &World, body: &Value) -> Vec<(u16, i64)> {
    let body = body.to_string();
    std::thread::scope(|scope| {
        let threads: Vec<_> =
            (0..50).map(|_| scope.spawn(|| world.request("POST", "/v1/jobs", &body).unwrap())).collect();
        threads
            .into_iter()
            .map(|thread| {
                let (status, text) = thread.join().unwrap();
                (
                    status,
                    serde_json::from_str::<Value>(&text).unwrap()["id"].as_i64().unwrap_or_else(|| panic!("{text}")),
                )
            })
            .collect()
    })
}

/// Row E7.
#[test]
fn fifty_identical_submissions_are_one_job_also_while_the_capture_grows() {
    let world = World::new();
    let night = fill(&world, "night", &SIX, &plain(scaled(600_000, 2_000_000)), noise);
    let (_sensor, daemon) = capturing(&world);
    // The first keeps the worker busy while the submissions over the running capture arrive.
    for body in
        [json!({"kind": "noise", "capture": night}), json!({"kind": "allan", "capture": "latest", "taus": "octave"})]
    {
        let answers = submit_50(&world, &body);
        assert_eq!(answers.iter().filter(|(status, _)| *status == 202).count(), 1, "{answers:?}");
        assert_eq!(answers.iter().filter(|(status, _)| *status == 200).count(), 49, "{answers:?}");
        assert!(answers.iter().all(|(_, id)| *id == answers[0].1), "{answers:?}");
    }
    assert_eq!(world.query("SELECT count(*) FROM job"), [[rusqlite::types::Value::Integer(2)]]);
    // Many different jobs: the queue is bounded, and the answer states when to try again.
    let mut refused = None;
    for channels in 1..=200_u32 {
        let names: Vec<&str> = SIX
            .iter()
            .enumerate()
            .filter(|(bit, _)| channels >> bit & 1 == 1)
            .map(|(_, channel)| channel.name())
            .collect();
        if names.is_empty() {
            continue;
        }
        let kind = ["allan", "noise", "statistics"][channels as usize / 64 % 3];
        let body = json!({"kind": kind, "capture": night, "channels": names, "taus": "octave"});
        let (status, text) = world.request("POST", "/v1/jobs", &body.to_string()).unwrap();
        if status == 429 {
            refused = Some(serde_json::from_str::<Value>(&text).unwrap());
            break;
        }
        assert!(status == 202 || status == 200, "{status} {text}");
    }
    let refused = refused.expect("the queue has no bound");
    assert_eq!(refused["retry_after_s"], 10, "{refused}");
    nothing_missing(&world);
    drop(daemon);
    settle(&world);
}

/// Promise 6: beyond loopback changes need the token, and on loopback the host must be this machine.
#[test]
fn beyond_loopback_changes_need_the_token_and_on_loopback_the_host_must_be_this_one() {
    let world = World::new();
    std::fs::write(world.path("open.toml"), "[http]\nlisten = \"0.0.0.0:0\"\n").unwrap();
    let refused = program()
        .args(["--data-dir", world.path("data").to_str().unwrap()])
        .args(["--config", world.path("open.toml").to_str().unwrap(), "run"])
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(78), "{}", String::from_utf8_lossy(&refused.stderr));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("token"), "{}", String::from_utf8_lossy(&refused.stderr));

    let beyond = World::new();
    let port = beyond.url.rsplit(':').next().unwrap().to_owned();
    let token = "0123456789abcdef0123456789abcdef";
    let configuration = format!("[http]\ntoken = \"{token}\"\n");
    std::fs::write(beyond.path("vn100d.toml"), configuration).unwrap();
    let mut command = program();
    command.args(["--data-dir", beyond.path("data").to_str().unwrap()]);
    command.args(["--config", beyond.path("vn100d.toml").to_str().unwrap()]);
    command.args(["run", "--listen", &format!("0.0.0.0:{port}"), "--device", beyond.port().to_str().unwrap()]);
    let daemon = Process::start(&mut command, false);
    beyond.until("the daemon answers", Duration::from_secs(10), || beyond.try_get("/healthz"), &daemon);
    let ask = |head: &str| {
        let mut stream = connect(&beyond);
        stream.write_all(format!("{head}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n").as_bytes()).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text[9..12].parse::<u16>().unwrap()
    };
    assert_eq!(ask("POST /v1/captures HTTP/1.1\r\nHost: vn.example"), 401);
    assert_eq!(ask("POST /v1/captures HTTP/1.1\r\nHost: vn.example\r\nAuthorization: Bearer 0123456789abcdef"), 401);
    assert_eq!(ask("POST /v1/imports HTTP/1.1\r\nHost: vn.example\r\nContent-Type: text/csv"), 401);
    assert_eq!(ask("GET /v1/status HTTP/1.1\r\nHost: vn.example"), 200);
    assert_eq!(ask(&format!("POST /v1/captures HTTP/1.1\r\nHost: vn.example\r\nAuthorization: Bearer {token}")), 201);
    drop(daemon);

    let local = World::new();
    let _daemon = local.daemon("", &[]);
    for (host, status) in [("localhost", "200"), ("127.0.0.1:8100", "200"), ("[::1]", "200"), ("evil.example", "403")] {
        let mut stream = connect(&local);
        let request = format!("GET /v1/status HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        assert_eq!(&text[9..12], status, "{host}: {text}");
    }
}
