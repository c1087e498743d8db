//! HTTP under abuse (rows E1 to E7).

use crate::jobs::{fill, noise, plain, settle};
use crate::tools::{have, scaled};
use crate::world::{Process, World, program};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::{Duration, Instant};
use vn100d::sample::Channel;

const SIX: [Channel; 6] =
    [Channel::AccelX, Channel::AccelY, Channel::AccelZ, Channel::GyroX, Channel::GyroY, Channel::GyroZ];
const MIB: u64 = 1 << 20;

fn connect(world: &World) -> TcpStream {
    let stream = TcpStream::connect(world.url.trim_start_matches("http://")).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream
}

/// A connection on which this was sent; None where the daemon does not take it.
fn sent(world: &World, bytes: &[u8]) -> Option<TcpStream> {
    let mut stream = TcpStream::connect(world.url.trim_start_matches("http://")).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(10))).ok()?;
    stream.write_all(bytes).ok()?;
    Some(stream)
}

/// Whether the other side has closed: there is nothing to read any more.
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

/// `VmRSS` or `VmHWM` of a process in bytes.
fn memory(pid: u32, name: &str) -> u64 {
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

/// Asks for the status so often a second, for so long; answers how long each took, the shortest first.
fn ask(world: &World, per_s: u32, time: Duration) -> Vec<Duration> {
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

fn p99(sorted: &[Duration]) -> Duration {
    sorted[sorted.len() * 99 / 100]
}

/// A daemon that captures, once samples come.
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

/// E1.
#[test]
fn a_thousand_half_heads_are_closed_in_time_and_harm_nobody() {
    let world = World::new();
    let (_sensor, daemon) = capturing(&world);
    let head = b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nX-Slow: ";
    let mut slow: Vec<TcpStream> = (0..1000).map(|_| sent(&world, head).unwrap()).collect();
    let opened = Instant::now();
    let took = ask(&world, 50, Duration::from_secs(4));
    assert!(p99(&took) <= Duration::from_millis(100), "99 of 100 answers within {:?}", p99(&took));
    std::thread::sleep(Duration::from_secs(6).saturating_sub(opened.elapsed()));
    let open = slow.iter_mut().filter_map(|stream| (!is_closed(stream)).then_some(())).count();
    assert_eq!(open, 0, "half heads still open 6 s after they came");
    nothing_missing(&world);
    let peak = memory(daemon.id(), "VmHWM");
    assert!(peak < 64 * MIB, "{} MiB", peak / MIB);
    eprintln!("E1: status p99 {:?} of {}, peak {} MiB", p99(&took), took.len(), peak / MIB);
    drop(daemon);
    settle(&world);
}

/// E2.
#[test]
fn a_thousand_idle_connections_and_200_requests_a_second_harm_nobody() {
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
    let took = ask(&world, 200, scaled(Duration::from_secs(4), Duration::from_secs(30)));
    assert!(p99(&took) <= Duration::from_millis(100), "99 of 100 answers within {:?}", p99(&took));
    std::thread::sleep(Duration::from_secs(6).saturating_sub(opened.elapsed()));
    let open = idle.iter_mut().filter_map(|stream| (!is_closed(stream)).then_some(())).count();
    assert_eq!(open, 0, "idle connections still open after 6 s");
    nothing_missing(&world);
    let peak = memory(daemon.id(), "VmHWM");
    assert!(peak < 64 * MIB, "{} MiB", peak / MIB);
    eprintln!("E2: status p99 {:?} of {}, peak {} MiB", p99(&took), took.len(), peak / MIB);
    drop(daemon);
    settle(&world);
}

/// E3.
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
            // What the kernel has buffered comes to its end in months; an error is the end.
            let _ = stream.read(&mut [0]);
        }
        most = most.max(memory(daemon.id(), "VmRSS"));
        if begun.elapsed() > Duration::from_secs(5) && begun.elapsed() < Duration::from_secs(20) {
            // While they are held up, the log can be emptied to its end: no read transaction is open.
            let connection = rusqlite::Connection::open(world.database()).unwrap();
            let busy: i64 = connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get(0)).unwrap();
            assert_eq!(busy, 0, "a reader holds the log");
        }
        // This very question has a connection too.
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

/// E5.
#[test]
fn a_query_whose_client_has_gone_ends_within_a_second() {
    let world = World::new();
    let capture = fill(&world, "night", &SIX, &plain(scaled(600_000, 2_000_000)), noise);
    let daemon = world.daemon("", &[]);
    // More large queries than there may be: those refused tell that the others run.
    let large = format!("/v1/captures/{capture}/samples?max_points=10");
    let request = format!("GET {large} HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let begun = Instant::now();
    assert_eq!(world.request("GET", &large, "").unwrap().0, 200);
    let alone = begun.elapsed();
    let clients: Vec<TcpStream> = (0..24).map(|_| sent(&world, request.as_bytes()).unwrap()).collect();
    let refused = || (metric(&world, "vn100d_http_queries_refused_total") >= 8.0).then_some(());
    world.until("all large queries run", Duration::from_secs(10), refused, &daemon);
    let one_more = format!("/v1/captures/{capture}/samples?to=1");
    let (status, text) = world.request("GET", &one_more, "").unwrap();
    assert_eq!(status, 503, "16 queries of {alone:?} each have ended before their clients went: {text}");
    // Dropped with unread bytes: the kernel sends a reset.
    drop(clients);
    let gone = Instant::now();
    loop {
        let (status, text) = world.request("GET", &one_more, "").unwrap();
        if status == 200 {
            break;
        }
        assert_eq!(status, 503, "{text}");
        assert!(gone.elapsed() < Duration::from_secs(1), "queries of clients that have gone still run");
        std::thread::sleep(Duration::from_millis(10));
    }
    eprintln!("E5: a query is let in {:?} after the clients of 16 that take {alone:?} alone went", gone.elapsed());
    drop(daemon);
    settle(&world);
}

/// A daemon under `prlimit --nofile=64`.
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

fn open_files(pid: u32) -> u64 {
    std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap().count() as u64
}

fn limit_files(pid: u32, files: u64) {
    // The hard limit stays, so that the soft one may be raised again.
    let status =
        Command::new("prlimit").args(["--pid", &pid.to_string(), &format!("--nofile={files}:")]).status().unwrap();
    assert!(status.success());
}

/// E6.
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
    // Five times as many connections as there can be files; those held open keep asking.
    let request = b"GET /v1/captures HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let held: Vec<TcpStream> = (0..300).filter_map(|_| sent(&world, request)).collect();
    // What capture and store open comes first: the sensor is found again while connections are held.
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
    // Not one file is left: accept itself fails, is counted, and goes on once there are some.
    limit_files(daemon.id(), open_files(daemon.id()));
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

/// Status and id of 50 identical submissions at once.
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

/// E7.
#[test]
fn fifty_identical_submissions_are_one_job_also_while_the_capture_grows() {
    let world = World::new();
    let night = fill(&world, "night", &SIX, &plain(scaled(600_000, 2_000_000)), noise);
    let (_sensor, daemon) = capturing(&world);
    // The first keeps the worker busy while those over the running capture come in.
    for body in
        [json!({"kind": "noise", "capture": night}), json!({"kind": "allan", "capture": "latest", "taus": "octave"})]
    {
        let answers = submit_50(&world, &body);
        assert_eq!(answers.iter().filter(|(status, _)| *status == 202).count(), 1, "{answers:?}");
        assert_eq!(answers.iter().filter(|(status, _)| *status == 200).count(), 49, "{answers:?}");
        assert!(answers.iter().all(|(_, id)| *id == answers[0].1), "{answers:?}");
    }
    assert_eq!(world.query("SELECT count(*) FROM job"), [[rusqlite::types::Value::Integer(2)]]);
    // Many different ones: the queue is bounded, and says when to come again.
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
        if status == 503 {
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

/// Item 6 of what is promised: changes need the token beyond loopback, and on loopback this machine's name.
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

/// Runs `vn100d import --json` on the world's database; its exit code and answer.
fn import(world: &World, arguments: &[&str]) -> (Option<i32>, Value, String) {
    let output = program()
        .args(["--data-dir", world.path("data").to_str().unwrap()])
        .args(["--config", world.path("vn100d.toml").to_str().unwrap(), "--json", "import"])
        .args(arguments)
        .output()
        .unwrap();
    let answer = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code(), answer, String::from_utf8_lossy(&output.stderr).into_owned())
}

/// What the contract says of import: beside a daemon it goes through it, with the same report and exit codes.
#[test]
fn an_import_beside_a_daemon_goes_through_it_and_is_the_import_without_one() {
    let world = World::new();
    let mut csv = String::from("time_s,gyro_x_rad_s,colour\n");
    for row in 0..scaled(40_000, 2_000_000) {
        // One hole of 40 samples, one line that is none.
        let at = (row + if row < 5000 { 0 } else { 40 }) as f64 / 40.0;
        csv.push_str(&format!("{at:.3},{:.6},red\n", noise(row as u64, Channel::GyroX)));
        if row == 100 {
            csv.push_str("rubbish\n");
        }
    }
    let file = world.path("desk.csv");
    std::fs::write(&file, &csv).unwrap();
    let file = file.to_str().unwrap();
    let packed = world.path("second.csv.gz");
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(csv.replace("red", "blue").as_bytes()).unwrap();
    std::fs::write(&packed, encoder.finish().unwrap()).unwrap();

    let alone = World::new();
    std::fs::write(alone.path("vn100d.toml"), "").unwrap();
    let (code, offline, errors) = import(&alone, &[file]);
    assert_eq!(code, Some(3), "{errors}");

    let _sensor = world.emulate(&[]);
    let listen = world.url.trim_start_matches("http://").to_owned();
    let daemon = world.daemon(&format!("[http]\nlisten = \"{listen}\"\n"), &["--capture", "1h"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(20));
    world.until("samples", Duration::from_secs(15), some, &daemon);
    let (code, online, errors) = import(&world, &[file]);
    assert_eq!(code, Some(3), "{errors}");
    let mut expected = offline.clone();
    expected[0]["capture"] = online[0]["capture"].clone();
    assert_eq!(online, expected, "the report through the daemon");
    assert_eq!(online[0]["missing"], 40, "{online}");
    let (code, again, errors) = import(&world, &[file]);
    assert_eq!(code, Some(3), "{errors}");
    expected[0]["new"] = json!(false);
    assert_eq!(again, expected, "the same recording is the same capture");
    let (code, second, errors) = import(&world, &[packed.to_str().unwrap(), "--name", "packed"]);
    assert_eq!(code, Some(3), "{errors}");
    assert_eq!((&second[0]["samples"], &second[0]["new"]), (&online[0]["samples"], &json!(true)));
    let capture = world.get("/v1/captures/packed");
    assert_eq!((capture["state"].as_str(), capture["missing"].as_u64()), (Some("imported"), Some(40)));

    // What is refused is refused as without a daemon: by exit code, by the name the user knows.
    std::fs::write(world.path("nonsense.txt"), "this is no recording\n".repeat(200)).unwrap();
    let nonsense = world.path("nonsense.txt");
    let (code, _, errors) = import(&world, &[nonsense.to_str().unwrap()]);
    assert_eq!((code, import(&alone, &[nonsense.to_str().unwrap()]).0), (Some(1), Some(1)), "{errors}");
    assert!(errors.contains("nonsense.txt") && !errors.contains(".import-"), "{errors}");
    let (code, _, errors) = import(&world, &[world.path("absent.csv").to_str().unwrap()]);
    assert_eq!(code, Some(74), "{errors}");
    std::fs::write(world.path("third.csv"), csv.replace("red", "green")).unwrap();
    let (code, _, errors) = import(&world, &[world.path("third.csv").to_str().unwrap(), "--name", "packed"]);
    assert_eq!(code, Some(1), "{errors}");
    assert!(errors.contains("packed"), "{errors}");
    // A body that is cut off leaves nothing.
    let head =
        "POST /v1/imports HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/csv\r\nContent-Length: 100000\r\n\r\n";
    let cut = sent(&world, &[head.as_bytes(), &csv.as_bytes()[..50_000]].concat()).unwrap();
    std::thread::sleep(Duration::from_millis(200));
    drop(cut);
    let free = || {
        let left = std::fs::read_dir(world.path("data")).unwrap().flatten();
        (left.filter(|entry| entry.file_name().to_string_lossy().starts_with(".import-")).count() == 0).then_some(())
    };
    world.until("nothing is left of it", Duration::from_secs(5), free, &daemon);
    assert_eq!(world.get("/v1/captures")["captures"].as_array().unwrap().len(), 3);
    nothing_missing(&world);
    // Without a daemon that answers, the lock alone decides.
    let (code, _, errors) = {
        std::fs::write(world.path("vn100d.toml"), "[http]\nlisten = \"127.0.0.1:9\"\n").unwrap();
        import(&world, &[file])
    };
    assert_eq!(code, Some(73), "{errors}");
    drop(daemon);
    settle(&world);
}

/// A seeded generator of requests: routes, ids, queries, headers and bodies, many of which are none.
pub struct Fuzz {
    random: ChaCha8Rng,
}

/// A request that somebody may send.
#[derive(Debug, Clone)]
pub struct Asked {
    pub method: &'static str,
    pub target: String,
    pub headers: Vec<(&'static str, Vec<u8>)>,
    pub body: Vec<u8>,
}

impl Fuzz {
    pub fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed) }
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.random.random_range(0..from.len())]
    }

    fn chance(&mut self, percent: u32) -> bool {
        self.random.random_range(0..100) < percent
    }

    fn word(&mut self) -> String {
        const WORDS: [&str; 52] = [
            "",
            "0",
            "1",
            "2",
            "-1",
            "1000",
            "1001",
            "1e9",
            "NaN",
            "inf",
            "-inf",
            "1e-320",
            "9223372036854775807",
            "9223372036854775808",
            "18446744073709551616",
            "-9223372036854775809",
            "latest",
            "desk",
            "pinned",
            "json",
            "csv",
            "ndjson",
            "gyro_x",
            "gyro_x,gyro_x",
            "gyro_x,",
            "capturing",
            "done",
            "%00",
            "%ff%fe",
            "%F0%9F%A6%80",
            "%",
            "%zz",
            "..",
            "%2e%2e%2f",
            "..%2f..%2fetc%2fpasswd",
            "'--",
            "\"",
            "%27%20OR%201=1",
            "2027-01-15T08:00:00Z",
            "2027-01-15T08:00:00%2B01:00",
            "9999-12-31T23:59:59Z",
            "0000-01-01T00:00:00Z",
            "jobs-1-1",
            "gaps-1-zz",
            "segments-1-zzzzzzzzzzzzz",
            "captures-1-",
            "true",
            "null",
            "[]",
            "0x10",
            "1_000",
            "+5",
        ];
        match self.random.random_range(0..20) {
            0 => "x".repeat(self.random.random_range(1..10_240)),
            1 => format!("jobs-1-{}", "z".repeat(self.random.random_range(1..10_000))),
            2 => self.random.random::<i64>().to_string(),
            3 => self.random.random::<f64>().to_string(),
            4 => (0..8).map(|_| format!("%{:02x}", self.random.random::<u8>())).collect(),
            _ => self.pick(&WORDS).to_owned(),
        }
    }

    fn target(&mut self) -> String {
        const PATHS: [&str; 30] = [
            "/",
            "/healthz",
            "/readyz",
            "/metrics",
            "/openapi.json",
            "/v1/status",
            "/v1/captures",
            "/v1/captures/{}",
            "/v1/captures/{}/stop",
            "/v1/captures/{}/pin",
            "/v1/captures/{}/gaps",
            "/v1/captures/{}/segments",
            "/v1/captures/{}/events",
            "/v1/captures/{}/samples",
            "/v1/captures/{}/statistics",
            "/v1/captures/{}/allan",
            "/v1/captures/{}/noise",
            "/v1/jobs",
            "/v1/jobs/{}",
            "/v1/imports",
            "/v1/captures/",
            "/v1//captures",
            "/v1/captures/{}/samples/",
            "/v2/{}",
            "/{}",
            "/../../etc/passwd",
            "/v1/captures/../status",
            "/%2e%2e/{}",
            "/v1/captures/{}/plots/x.svg",
            "/v1/models",
        ];
        const NAMES: [&str; 16] = [
            "limit",
            "cursor",
            "from",
            "to",
            "max_points",
            "channels",
            "format",
            "state",
            "capture",
            "job",
            "file",
            "name",
            "rate_hz",
            "x",
            "limit",
            "%00",
        ];
        let mut path = self.pick(&PATHS).to_owned();
        if path.contains("{}") {
            let id =
                if self.chance(50) { self.pick(&["1", "2", "latest", "desk", "few"]).to_owned() } else { self.word() };
            path = path.replace("{}", &id.replace(['"', '[', ']'], "_"));
        }
        let parameters = self.random.random_range(0..4);
        let query: Vec<String> = (0..parameters)
            .map(|_| {
                let name = self.pick(&NAMES);
                format!("{name}={}", self.word().replace(['"', '[', ']'], "_"))
            })
            .collect();
        if query.is_empty() { path } else { format!("{path}?{}", query.join("&")) }
    }

    fn body(&mut self) -> Vec<u8> {
        const BODIES: [&str; 16] = [
            "",
            "{",
            "{}",
            "[]",
            "null",
            "1e999",
            "{\"duration\": \"-5h\"}",
            "{\"duration\": \"5h\", \"x\": 1}",
            "{\"duration\": 5}",
            "{\"kind\": \"allan\"}",
            "{\"kind\": \"allan\", \"capture\": 1}",
            "{\"kind\": \"nothing\", \"capture\": \"latest\"}",
            "{\"kind\": \"noise\", \"capture\": \"few\", \"taus\": \"all\"}",
            "{\"kind\": \"statistics\", \"capture\": 1e300}",
            "{\"pinned\": true}",
            "{\"start_at\": \"9999-12-31T00:00:00Z\"}",
        ];
        match self.random.random_range(0..12) {
            0 => (0..self.random.random_range(1..300)).map(|_| self.random.random()).collect(),
            1 => vec![b'['; self.random.random_range(1..2000)],
            2 => vec![b'x'; 70_000],
            _ => self.pick(&BODIES).as_bytes().to_vec(),
        }
    }

    /// The next request.
    pub fn next(&mut self) -> Asked {
        const HEADERS: [&str; 10] = [
            "accept",
            "accept-encoding",
            "if-none-match",
            "origin",
            "authorization",
            "content-encoding",
            "range",
            "cookie",
            "x-forwarded-for",
            "expect-ct",
        ];
        let method = if self.chance(55) {
            "GET"
        } else {
            self.pick(&["POST", "DELETE", "HEAD", "PUT", "PATCH", "OPTIONS", "TRACE"])
        };
        let mut headers = vec![("host", b"localhost".to_vec())];
        for _ in 0..self.random.random_range(0..3) {
            let value = if self.chance(20) {
                // Any byte that a header may carry, also such as are no UTF-8.
                (0..20).map(|_| self.random.random_range(128..=255_u8)).collect()
            } else {
                self.word().into_bytes()
            };
            headers.push((self.pick(&HEADERS), value));
        }
        let has_body = method != "GET" && method != "HEAD";
        if has_body {
            let media_types =
                ["application/json", "application/json", "application/json", "text/plain", "text/csv", "x"];
            headers.push(("content-type", self.pick(&media_types).as_bytes().to_vec()));
        }
        let (target, body) = (self.target(), if has_body { self.body() } else { Vec::new() });
        Asked { method, target, headers, body }
    }
}

/// What an answer must be, whatever was asked: declared in docs/openapi.json, an error a problem document, never 500.
pub struct Oracle {
    paths: Vec<(Vec<String>, Value)>,
}

impl Oracle {
    pub fn new() -> Self {
        let document: Value = serde_json::from_str(include_str!("../../docs/openapi.json")).unwrap();
        let paths = document["paths"].as_object().unwrap().iter();
        Self { paths: paths.map(|(path, item)| (path.split('/').map(str::to_owned).collect(), item.clone())).collect() }
    }

    fn operation(&self, asked: &Asked) -> Option<&Value> {
        let path: Vec<&str> = asked.target.split('?').next().unwrap().split('/').collect();
        let method = if asked.method == "HEAD" { "get".to_owned() } else { asked.method.to_lowercase() };
        let matches = |pattern: &[String]| {
            pattern.len() == path.len()
                && pattern
                    .iter()
                    .zip(&path)
                    .all(|(one, other)| one.starts_with('{') && !other.is_empty() || one == other)
        };
        self.paths
            .iter()
            .find(|(pattern, _)| matches(pattern))
            .map(|(_, item)| &item[&method])
            .filter(|found| found.is_object())
    }

    /// Panics where the answer is not what it must be.
    pub fn check(&self, asked: &Asked, status: u16, media_type: &str, body: &[u8]) {
        let said =
            || format!("{asked:?}: {status} {media_type} {}", String::from_utf8_lossy(&body[..body.len().min(500)]));
        assert!(status != 500 && status < 600, "{}", said());
        let media_type = media_type.split(';').next().unwrap();
        if status >= 400 {
            assert_eq!(media_type, "application/problem+json", "{}", said());
            if asked.method != "HEAD" {
                let problem: Value = serde_json::from_slice(body).unwrap_or_else(|_| panic!("{}", said()));
                assert_eq!(problem["status"], status, "{}", said());
                for member in ["type", "title", "detail", "instance"] {
                    assert!(problem[member].as_str().is_some_and(|text| !text.is_empty()), "{member}: {}", said());
                }
            }
        }
        let Some(operation) = self.operation(asked) else {
            // What no operation is declared for is an error, but for what is no part of the interface for programs.
            let page = ["/", "/openapi.json"].contains(&asked.target.split('?').next().unwrap());
            assert!(status >= 400 || page, "{}", said());
            return;
        };
        let responses = operation["responses"].as_object().unwrap();
        let declared = responses.get(&status.to_string()).or_else(|| (status >= 400).then(|| &responses["default"]));
        let declared = declared.unwrap_or_else(|| panic!("status not declared: {}", said()));
        if let Some(content) = declared["content"].as_object() {
            assert!(content.contains_key(media_type), "media type not declared: {}", said());
            if media_type == "application/json" && asked.method != "HEAD" {
                let answer: Result<Value, _> = serde_json::from_slice(body);
                assert!(answer.is_ok(), "{}", said());
            }
        }
    }
}

/// The interface itself, without sockets: for volume.
struct Inside {
    router: hyper_util::service::TowerToHyperService<axum::Router>,
    jobs: vn100d::jobs::Jobs,
    _store: vn100d::store::Store,
}

/// Takes no recording.
#[derive(Debug)]
struct NoImports;

impl vn100d::control::Importer for NoImports {
    fn import(
        &self,
        request: vn100d::control::ImportRequest,
    ) -> Result<vn100d::control::ImportReport, vn100d::control::ImportError> {
        Err(vn100d::control::ImportError::Recording { reason: format!("{} is no recording", request.called) })
    }
}

impl Inside {
    fn new(world: &World) -> Self {
        use std::sync::Arc;
        use vn100d::control::{CaptureControl, Command, ControlError};
        let store = vn100d::store::Store::open(&world.database(), vn100d::store::StoreOptions::default()).unwrap();
        let jobs = vn100d::jobs::Jobs::start(&store, vn100d::jobs::JobsOptions::default()).unwrap();
        let mut status = vn100d::observe::Status::default();
        status.storage.free_bytes = 10 << 30;
        let (control, mut commands) = CaptureControl::pair();
        tokio::spawn(async move {
            while let Some(command) = commands.recv().await {
                match command {
                    Command::Start(_, reply) => drop(reply.send(Err(ControlError::Busy { running: 1 }))),
                    Command::Stop(id, reply) => drop(reply.send(Err(ControlError::NotRunning { id }))),
                }
            }
        });
        let router = vn100d::api::router(vn100d::api::ApiParts {
            status: tokio::sync::watch::channel(status).1,
            control,
            store: store.clone(),
            jobs: jobs.clone(),
            live: Arc::new(vn100d::jobs::Live::new()),
            metrics: Arc::new(vn100d::observe::Metrics::default()),
            token: None,
            loopback: true,
            importer: Arc::new(NoImports),
            default_duration: Duration::from_secs(18_000),
            reserve_bytes: 1 << 30,
            limits: vn100d::api::Limits::default(),
        });
        Self { router: hyper_util::service::TowerToHyperService::new(router), jobs, _store: store }
    }

    /// Status, media type and body; None for a target or header that HTTP itself cannot carry.
    async fn ask(&self, asked: &Asked) -> Option<(u16, String, Vec<u8>)> {
        use hyper::body::Body as _;
        use hyper::service::Service as _;
        let mut request = hyper::Request::builder().method(asked.method).uri(&asked.target);
        for (name, value) in &asked.headers {
            request = request.header(*name, value.as_slice());
        }
        let request = request.body(axum::body::Body::from(asked.body.clone())).ok()?;
        let response = self.router.call(request).await.unwrap();
        let status = response.status().as_u16();
        let media_type =
            response.headers().get("content-type").and_then(|value| value.to_str().ok()).unwrap_or("").to_owned();
        let packed = response.headers().contains_key("content-encoding");
        let mut body = response.into_body();
        let mut bytes = Vec::new();
        while let Some(frame) = std::future::poll_fn(|context| std::pin::Pin::new(&mut body).poll_frame(context)).await
        {
            bytes.extend(frame.unwrap().into_data().unwrap_or_default());
        }
        if packed {
            let mut plain = Vec::new();
            flate2::read::MultiGzDecoder::new(&bytes[..]).read_to_end(&mut plain).unwrap();
            bytes = plain;
        }
        Some((status, media_type, bytes))
    }
}

fn desk(world: &World) {
    fill(world, "desk", &[Channel::GyroX, Channel::Temperature], &plain(400), noise);
    fill(world, "few", &[Channel::GyroX], &plain(3), noise);
}

/// E4.
#[test]
fn no_request_of_a_seeded_multitude_gives_a_500_or_an_undeclared_answer() {
    let world = World::new();
    desk(&world);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let requests = scaled(100_000, 1_000_000);
    let (mut refused, mut answered, mut slowest) = (0_u64, 0_u64, Duration::ZERO);
    runtime.block_on(async {
        let inside = Inside::new(&world);
        let (oracle, mut fuzz) = (Oracle::new(), Fuzz::new(7));
        for _ in 0..requests {
            let asked = fuzz.next();
            // Both captures shall be there to the end.
            if asked.method == "DELETE" && asked.target.starts_with("/v1/captures/") {
                continue;
            }
            let begun = Instant::now();
            let Some((status, media_type, body)) = inside.ask(&asked).await else { continue };
            let mut took = begun.elapsed();
            oracle.check(&asked, status, &media_type, &body);
            answered += 1;
            if (400..500).contains(&status) {
                refused += 1;
                // A machine with other work may be late; asked again it is the request's own time.
                for _ in 0..5 {
                    if took > Duration::from_millis(50) {
                        let begun = Instant::now();
                        inside.ask(&asked).await;
                        took = took.min(begun.elapsed());
                    }
                }
                assert!(took <= Duration::from_millis(50), "{asked:?} was refused after {took:?}");
                slowest = slowest.max(took);
            }
        }
        inside.jobs.stop();
    });
    eprintln!("E4: {answered} answers, {refused} of them 4xx, the slowest of those after {slowest:?}");
    assert!(answered > requests / 2 && refused > requests / 4 && answered - refused > requests / 20);
    drop(runtime);
    settle(&world);
}

/// E4, through the socket: what a client library would not send.
#[test]
fn bytes_that_are_no_request_are_refused_and_the_daemon_answers_on() {
    let world = World::new();
    desk(&world);
    let daemon = world.daemon("", &[]);
    let long = "x".repeat(10_240);
    let table: Vec<(Vec<u8>, &[u16])> = vec![
        (b"GET /v1/captures?limit=1000000000 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures?limit=-1 HTTP/1.1".to_vec(), &[400]),
        (format!("GET /v1/captures?cursor={long} HTTP/1.1").into_bytes(), &[400]),
        (format!("GET /v1/captures/{long} HTTP/1.1").into_bytes(), &[404]),
        (b"GET /v1/captures/desk/samples?from=NaN HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/desk/samples?from=-1e308&to=1e308 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/desk/samples?max_points=99999999999999999999 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/desk/samples?channels=%ff%fe HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/%ff%fe/gaps HTTP/1.1".to_vec(), &[400, 404]),
        (b"GET /v1/captures/\xff\xfe/gaps HTTP/1.1".to_vec(), &[400, 404]),
        (b"GET /../../../../etc/passwd HTTP/1.1".to_vec(), &[404]),
        (b"GET /v1/captures/..%2f..%2fetc%2fpasswd HTTP/1.1".to_vec(), &[404]),
        (b"GET http://evil.example/v1/status HTTP/1.1".to_vec(), &[403]),
        (b"DELETE /v1/status HTTP/1.1".to_vec(), &[405]),
        (b"BREW /v1/status HTTP/1.1".to_vec(), &[405]),
        (b"GET /v1/jobs/99999999999999999999 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/jobs/-1 HTTP/1.1".to_vec(), &[404]),
    ];
    for (line, expected) in table {
        let said = String::from_utf8_lossy(&line[..line.len().min(100)]).into_owned();
        let mut took = Duration::MAX;
        for _ in 0..5 {
            let mut stream = connect(&world);
            let begun = Instant::now();
            stream.write_all(&[&line[..], b"\r\nHost: localhost\r\nConnection: close\r\n\r\n"].concat()).unwrap();
            let mut bytes = Vec::new();
            stream.read_to_end(&mut bytes).unwrap();
            took = took.min(begun.elapsed());
            let text = String::from_utf8_lossy(&bytes);
            let status: u16 = text[9..12].parse().unwrap();
            assert!(expected.contains(&status), "{said}: {text}");
            // What is no HTTP is refused by the server before the interface sees it.
            assert!(text.contains("application/problem+json") || line.contains(&0xff), "{said}: {text}");
        }
        assert!(took <= Duration::from_millis(50), "{said}: {took:?}");
    }
    // Raw bytes, cut requests, several in one.
    let mut fuzz = Fuzz::new(11);
    for _ in 0..scaled(500, 20_000) {
        let asked = fuzz.next();
        let mut bytes = format!("{} {} HTTP/1.1\r\n", asked.method, asked.target).into_bytes();
        for (name, value) in &asked.headers {
            bytes.extend([name.as_bytes(), b": ", value, b"\r\n"].concat());
        }
        bytes.extend(format!("content-length: {}\r\nconnection: close\r\n\r\n", asked.body.len()).as_bytes());
        bytes.extend(&asked.body);
        if fuzz.chance(30) {
            let place = fuzz.random.random_range(0..bytes.len());
            bytes[place] = fuzz.random.random();
        }
        if fuzz.chance(10) {
            bytes.truncate(fuzz.random.random_range(0..bytes.len()));
        }
        let mut stream = connect(&world);
        // The daemon may close before it has all of it.
        if stream.write_all(&bytes).is_ok() && stream.shutdown(std::net::Shutdown::Write).is_ok() {
            let mut answer = Vec::new();
            let _ = stream.read_to_end(&mut answer);
            let text = String::from_utf8_lossy(&answer);
            assert!(!text.starts_with("HTTP/1.1 500"), "{} gave {text}", String::from_utf8_lossy(&bytes));
        }
    }
    assert_eq!(world.get("/healthz")["status"], "ok");
    drop(daemon);
    settle(&world);
}
