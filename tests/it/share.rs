//! Live data beside the recording: a copy of the port's bytes, and samples as JSON lines.

use crate::world::{Process, World, program};
use rusqlite::types::Value;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use vn100d::pty;

const START: Duration = Duration::from_secs(20);
const END: Duration = Duration::from_secs(60);

/// Returns a configuration that shares, at this rate.
fn sharing(world: &World, rate_hz: u32) -> String {
    format!(
        "[sensor]\nbaud = 921600\nrate-hz = {rate_hz}.0\n[share]\nlink = \"{}\"\nsocket = \"{}\"\n",
        world.path("tty").display(),
        world.path("imu.sock").display()
    )
}

fn emulate(world: &World) -> Process {
    world.emulate(&["--baud", "921600"])
}

/// Waits for the end of the capture; returns it.
fn complete(world: &World, daemon: &Process) -> serde_json::Value {
    let ended = || world.try_get("/v1/captures/latest").filter(|capture| capture["state"] == "complete");
    world.until("the capture ends", END, ended, daemon)
}

fn share(world: &World) -> serde_json::Value {
    world.get("/v1/status")["share"].clone()
}

/// Reads a terminal in a thread until it is gone; returns what arrived so far.
fn collect(terminal: OwnedFd, also: impl Fn(&[u8]) + Send + 'static) -> Arc<Mutex<Vec<u8>>> {
    let bytes = Arc::new(Mutex::new(Vec::new()));
    let theirs = Arc::clone(&bytes);
    std::thread::spawn(move || {
        let mut buffer = [0; 8192];
        loop {
            match rustix::io::read(&terminal, &mut buffer) {
                Ok(count) if count > 0 => {
                    theirs.lock().unwrap().extend_from_slice(&buffer[..count]);
                    also(&buffer[..count]);
                }
                Err(rustix::io::Errno::AGAIN) => std::thread::sleep(Duration::from_micros(300)),
                _ => return,
            }
        }
    });
    bytes
}

fn write(to: impl AsFd, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        match rustix::io::write(&to, bytes) {
            Ok(count) => bytes = &bytes[count..],
            Err(_) => std::thread::sleep(Duration::from_micros(300)),
        }
    }
}

/// A cable between the emulator and the daemon that remembers what the sensor sent.
fn cable(world: &World) -> (Arc<Mutex<Vec<u8>>>, OwnedFd) {
    let pair = pty::open().unwrap();
    let sensor = pty::open_slave(&world.port()).unwrap();
    let (to_daemon, to_sensor) = (pair.master.try_clone().unwrap(), sensor.try_clone().unwrap());
    let sent = collect(sensor, move |bytes| write(&to_daemon, bytes));
    collect(pair.master, move |bytes| write(&to_sensor, bytes));
    pty::link(&pair.path, &world.path("cable")).unwrap();
    (sent, pair.slave)
}

#[test]
fn at_800_hz_the_copy_has_the_ports_bytes_and_the_recording_misses_nothing() {
    let world = World::new();
    let mut sensor = emulate(&world);
    let daemon = world.daemon_on(world.path("cable").to_str().unwrap(), &sharing(&world, 800), &["--capture", "10s"]);
    // The program reads from the first byte on: the cable comes later.
    let copy = collect(pty::open_slave(&world.path("tty")).unwrap(), |_| ());
    world.until("the reader is noticed", START, || (share(&world)["reading"] == true).then_some(()), &daemon);
    let (sent, _kept_open) = cable(&world);
    let capture = complete(&world, &daemon);
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(8000), Some(0)));
    sensor.kill();
    let settled = || {
        let before = (sent.lock().unwrap().len(), copy.lock().unwrap().len());
        std::thread::sleep(Duration::from_millis(700));
        ((sent.lock().unwrap().len(), copy.lock().unwrap().len()) == before).then_some(())
    };
    world.until("the stream ends", START, settled, &daemon);
    let (sent, copy) = (sent.lock().unwrap(), copy.lock().unwrap());
    // What waited at the port before it was opened may have been discarded.
    let from = sent.len().checked_sub(copy.len()).expect("the copy has no more than was sent");
    assert!(copy.len() >= 8000 * 70, "{} bytes", copy.len());
    assert!(sent[from..] == copy[..], "the copy differs from the last {} of {} bytes", copy.len(), sent.len());
    let share = share(&world);
    assert_eq!((share["dropped_bytes"].as_u64(), share["bytes"].as_u64()), (Some(0), Some(copy.len() as u64)));
}

#[test]
fn a_program_that_only_writes_changes_nothing_and_holds_nothing_up() {
    let world = World::new();
    let _sensor = emulate(&world);
    let daemon = world.daemon(&sharing(&world, 800), &["--capture", "6s"]);
    let program = pty::open_slave(&world.path("tty")).unwrap();
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(100));
    world.until("samples", START, some, &daemon);
    // Each of them would end the stream.
    let commands = b"$VNWRG,75,0,1,01,0001*XX\r\n$VNASY,0*XX\r\n$VNRST*4D\r\n$VNWRG,05,9600*XX\r\n";
    (0..100).for_each(|_| write(&program, commands));
    let capture = complete(&world, &daemon);
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(4800), Some(0)));
    assert_eq!(capture["gaps"], 0);
    let share = share(&world);
    assert_eq!(share["ignored_bytes"].as_u64(), Some(100 * commands.len() as u64), "{share}");
    assert!(share["dropped_bytes"].as_u64() > Some(0), "it never read: {share}");
    let metrics = world.get("/metrics");
    let counted = format!("vn100d_share_ignored_bytes_total {}\n", 100 * commands.len());
    assert!(metrics.as_str().unwrap().contains(&counted), "{metrics}");
}

#[test]
fn a_flood_of_writes_and_ten_thousand_clients_cost_no_sample() {
    let world = World::new();
    let _sensor = emulate(&world);
    let daemon = world.daemon(&sharing(&world, 800), &["--capture", "8s"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(100));
    world.until("samples", START, some, &daemon);
    let files = || std::fs::read_dir(format!("/proc/{}/fd", daemon.id())).unwrap().count();
    let before = files();
    let until = Instant::now() + Duration::from_secs(4);
    let writers = [b'x', b'$'].map(|byte| {
        let terminal = pty::open_slave(&world.path("tty")).unwrap();
        std::thread::spawn(move || {
            let mut count = 0;
            while Instant::now() < until {
                count += rustix::io::write(&terminal, &[byte; 4096]).unwrap_or(0) as u64;
            }
            count
        })
    });
    for _ in 0..10_000 {
        UnixStream::connect(world.path("imu.sock")).unwrap();
    }
    let written: u64 = writers.map(|writer| writer.join().unwrap()).iter().sum();
    let capture = complete(&world, &daemon);
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(6400), Some(0)));
    let settled = || (files() <= before + 20 && share(&world)["clients"] == 0).then(|| share(&world));
    let share = world.until("all clients have gone", START, settled, &daemon);
    // What was on its way when the last writer closed is gone with it.
    assert!(share["ignored_bytes"].as_u64().unwrap().abs_diff(written) < 128 << 10, "{written} {share}");
    assert!(share["clients_refused"].as_u64() > Some(0), "{share}");
}

#[test]
fn the_copy_outlives_the_cable() {
    let world = World::new();
    let sensor = emulate(&world);
    let daemon = world.daemon(&sharing(&world, 40), &[]);
    let terminal = std::fs::read_link(world.path("tty")).unwrap();
    let copy = collect(pty::open_slave(&terminal).unwrap(), |_| ());
    let grows = || {
        let before = copy.lock().unwrap().len();
        std::thread::sleep(Duration::from_millis(500));
        (copy.lock().unwrap().len() > before + 10 * 70).then_some(())
    };
    world.until("the copy has frames", START, grows, &daemon);
    drop(sensor);
    let absent = || world.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "absent");
    world.until("the loss is noticed", START, absent, &daemon);
    assert_eq!(std::fs::read_link(world.path("tty")).unwrap(), terminal);
    let _sensor = emulate(&world);
    world.until("the copy goes on", START, grows, &daemon);
    assert_eq!(std::fs::read_link(world.path("tty")).unwrap(), terminal);
}

#[test]
fn what_a_killed_daemon_leaves_is_replaced_and_a_clean_end_leaves_nothing() {
    let world = World::new();
    let _sensor = emulate(&world);
    let mut daemon = world.daemon(&sharing(&world, 40), &[]);
    let socket = world.path("imu.sock");
    let connects = || UnixStream::connect(&socket).ok();
    world.until("the socket", START, connects, &daemon);
    daemon.kill();
    assert!(world.path("tty").is_symlink() && socket.exists());
    let mut daemon = world.daemon(&sharing(&world, 40), &[]);
    let stream = world.until("the socket again", START, connects, &daemon);
    let copy = collect(pty::open_slave(&world.path("tty")).unwrap(), |_| ());
    world.until("bytes", START, || (copy.lock().unwrap().len() > 700).then_some(()), &daemon);
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).unwrap();
    assert!(line.starts_with("{\"time_s\":"), "{line}");
    assert_eq!(daemon.terminate(), Some(0));
    assert!(!world.path("tty").is_symlink() && !socket.exists());
}

#[test]
fn a_file_in_the_links_place_is_refused_and_stays() {
    let world = World::new();
    std::fs::write(world.path("tty"), "data").unwrap();
    let device = world.port();
    let mut daemon = world.start_daemon(program(), device.to_str().unwrap(), &sharing(&world, 40), &[]);
    assert_eq!(daemon.wait(START), Some(78));
    let log = daemon.log();
    let path = world.path("tty").display().to_string();
    assert!(
        log.contains(&format!("`share.link` is {path}, where there is something that is no link of vn100d")),
        "{log}"
    );
    assert_eq!(std::fs::read_to_string(world.path("tty")).unwrap(), "data");
}

/// Returns the nanoseconds of a field in seconds.
fn nanoseconds(line: &str, field: &str) -> i64 {
    let (_, rest) = line.split_once(&format!("\"{field}\":")).unwrap_or_else(|| panic!("{line}"));
    let text = rest.split([',', '}']).next().unwrap();
    let (whole, part) = text.split_once('.').unwrap_or((text, ""));
    format!("{whole}{part:0<9}").parse().unwrap()
}

#[test]
fn a_clients_samples_are_those_that_are_stored() {
    let world = World::new();
    let _sensor = emulate(&world);
    let daemon = world.daemon(&sharing(&world, 200), &[]);
    let mut stream = world.until("the socket", START, || UnixStream::connect(world.path("imu.sock")).ok(), &daemon);
    // It is not read; the client goes on.
    stream.write_all(b"hello\n").unwrap();
    let lines = Arc::new(Mutex::new(Vec::<String>::new()));
    let theirs = Arc::clone(&lines);
    std::thread::spawn(move || {
        BufReader::new(stream).lines().map_while(Result::ok).for_each(|line| theirs.lock().unwrap().push(line));
    });
    world.until("a line", START, || (!lines.lock().unwrap().is_empty()).then_some(()), &daemon);
    assert_eq!(world.request("POST", "/v1/captures", "{\"duration\": \"4s\"}").unwrap().0, 201);
    let capture = complete(&world, &daemon);
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(800), Some(0)));
    let channels = [
        "yaw",
        "pitch",
        "roll",
        "mag_x",
        "mag_y",
        "mag_z",
        "accel_x",
        "accel_y",
        "accel_z",
        "gyro_x",
        "gyro_y",
        "gyro_z",
        "temperature",
        "pressure",
    ];
    let rows =
        world.query(&format!("SELECT host_utc_ns, device_time_ns, {} FROM sample ORDER BY seq", channels.join(", ")));
    let lines = lines.lock().unwrap();
    let first = rows[0][1].clone();
    let from = lines.iter().position(|line| Value::Integer(nanoseconds(line, "device_time_s")) == first).unwrap();
    assert_eq!(rows.len(), 800);
    for (row, line) in rows.iter().zip(&lines[from..]) {
        let values: serde_json::Value = serde_json::from_str(line).unwrap();
        let times = ["time_s", "device_time_s"].map(|field| Value::Integer(nanoseconds(line, field)));
        assert_eq!(row[..2], times, "{line}");
        let shared = channels.map(|channel| Value::Real(values[channel].as_f64().unwrap()));
        assert_eq!(row[2..], shared, "{line}");
    }
}

/// An independent client, which shares no code with the program: `tests/peers/share.py`.
#[test]
fn an_independent_client_reads_the_copy() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/share.py");
    let begun = Instant::now();
    let ended = std::process::Command::new("python3")
        .arg(&script)
        .args(["--program", env!("CARGO_BIN_EXE_vn100d"), "--seconds", "4", "--json"])
        .output();
    let Ok(ended) = ended else {
        vn100_testkit::tool(false, "python3", "it reads the shared terminal");
        return;
    };
    let printed = String::from_utf8_lossy(&ended.stdout);
    assert!(ended.status.success(), "{printed}{}", String::from_utf8_lossy(&ended.stderr));
    let found: serde_json::Value = serde_json::from_str(&printed).unwrap();
    for way in ["copy", "socket"] {
        let of = &found[way];
        assert!(of["frames"].as_u64() >= Some(3000), "{begun:?} {found}");
        assert_eq!(
            (of["bad"].as_u64(), of["not_logged"].as_u64(), of["skipped"].as_u64()),
            (Some(0), Some(0), Some(0)),
            "{found}"
        );
    }
    assert_eq!(found["missing"], 0, "{found}");
}
