//! Rate: a sensor that sends at another rate than before, because another program configured it or because it was reset
//! to its flash, in each way of recording (rows B9, B11); and the causes of gaps.

use crate::world::{Process, World};
use rusqlite::types::Value;
use std::io::Write as _;
use std::time::{Duration, Instant};

/// A way of recording.
struct Mode {
    name: &'static str,
    configuration: &'static str,
    /// SyncOut is in use: the sensor cannot number its messages.
    pin_in_use: bool,
    /// Whether the recorded rate ends at the configured one, because the sensor is configured again.
    insists: bool,
}

const MODES: [Mode; 4] = [
    Mode { name: "binary", configuration: "", pin_in_use: false, insists: false },
    Mode { name: "count", configuration: "output = \"VNYMR\"\n", pin_in_use: false, insists: true },
    Mode { name: "no count", configuration: "output = \"VNYMR\"\n", pin_in_use: true, insists: true },
    Mode { name: "keep", configuration: "output = \"keep\"\n", pin_in_use: false, insists: false },
];

fn integer(world: &World, sql: &str) -> i64 {
    match world.query(sql)[0][0] {
        Value::Integer(number) => number,
        ref other => panic!("{sql}: {other:?}"),
    }
}

fn real(world: &World, sql: &str) -> f64 {
    match world.query(sql)[0][0] {
        Value::Real(number) => number,
        Value::Integer(number) => number as f64,
        ref other => panic!("{sql}: {other:?}"),
    }
}

fn samples(world: &World, daemon: &Process, more: u64) {
    world.until_more_samples(more, daemon);
}

/// Returns the outcome of a fault: s until the rate was right and an event reported it, gaps, samples missing, and the
/// difference between the capture's sample time and the host's, s. With the number of events that report a reset.
fn outcome(mode: &Mode, fault: &str, end_hz: f64) -> (f64, Vec<String>, i64, f64, i64) {
    let world = World::new();
    let mut sensor = world.emulate(&["--faults", "-", "--baud", "921600"]);
    if mode.pin_in_use {
        let mut line = std::fs::OpenOptions::new().write(true).open(world.port()).unwrap();
        line.write_all(b"$VNWRG,32,3,0,0,0,3,1,0,100000000,0*XX\r\n$VNWNV*XX\r\n").unwrap();
        std::thread::sleep(Duration::from_millis(1500));
    }
    let rate = if mode.name == "keep" { "" } else { "rate-hz = 50\n" };
    if mode.name == "keep" {
        sensor.send_line("rate 50");
    }
    let configuration = format!("[sensor]\nbaud = 921600\n{}{rate}", mode.configuration);
    let daemon = world.daemon(&configuration, &["--capture", "1h"]);
    samples(&world, &daemon, 150);
    let timebase = world.get("/v1/status")["sensor"]["timebase"].as_str().unwrap().to_owned();
    let expected = match mode.name {
        "binary" => "device",
        "count" => "sync_counter",
        _ => "arrival",
    };
    assert_eq!(timebase, expected, "{}", mode.name);
    let before = |kind: &str| format!("SELECT count(*) FROM event WHERE kind = '{kind}'");
    let kinds = ["reconfigured", "sensor_reset", "warning"];
    let count = || kinds.iter().map(|kind| integer(&world, &before(kind))).sum::<i64>();
    let events = count();
    sensor.send_line(fault);
    let begun = Instant::now();
    let right = || {
        let status = world.try_get("/v1/status")?;
        let sensor = &status["sensor"];
        let right = sensor["rate_hz"].as_f64() == Some(end_hz) && sensor["state"] == "streaming" && count() > events;
        right.then_some(())
    };
    world.until("the rate is right and told", Duration::from_secs(10), right, &daemon);
    let took = begun.elapsed().as_secs_f64();
    samples(&world, &daemon, 200);
    let (status, body) = world.request("POST", "/v1/captures/latest/stop", "").unwrap();
    assert_eq!(status, 200, "{body}");
    assert_eq!(world.get("/v1/captures/latest")["accounting"]["holds"], true);
    let causes = world.query("SELECT cause || ' ' || missing FROM gap ORDER BY before_seq, gap_id");
    let causes = causes.iter().map(|row| if let Value::Text(text) = &row[0] { text.clone() } else { panic!() });
    // A gap has the rate of the segment before it; the first sample counts as a period.
    let had = "SELECT (SELECT sum(samples / rate_hz) FROM segment) + (SELECT coalesce(sum(missing / (SELECT rate_hz FROM segment \
               WHERE first_seq < before_seq ORDER BY segment_id DESC LIMIT 1)), 0) FROM gap)";
    let passed = "SELECT (max(host_mono_ns) - min(host_mono_ns)) / 1e9 + 0.02 FROM sample";
    let off = real(&world, had) - real(&world, passed);
    let resets = integer(&world, "SELECT count(*) FROM event WHERE kind = 'sensor_reset'");
    (took, causes.collect(), integer(&world, "SELECT coalesce(sum(missing), 0) FROM gap"), off, resets)
}

/// Checks that every gap has this cause and that there are `at_least` of them. Configuring the sensor again may pause
/// its output for less than a period.
fn in_all_modes(fault: &str, end_hz: impl Fn(&Mode) -> f64, cause: &str, at_least: usize) {
    for mode in &MODES {
        let (took, causes, missing, off_s, resets) = outcome(mode, fault, end_hz(mode));
        println!(
            "{fault}, {}: right after {took:.2} s, {missing} missing {causes:?}, sample time off by {:.0} ms",
            mode.name,
            off_s * 1e3
        );
        assert!(took <= 5.0, "{}: {took} s", mode.name);
        assert_eq!(resets, i64::from(cause == "sensor_reset"), "{}: events of a reset", mode.name);
        assert!(causes.iter().all(|actual| actual.starts_with(cause)), "{}: {causes:?}", mode.name);
        let most = if mode.insists { at_least + 1 } else { at_least };
        assert!((at_least..=most).contains(&causes.len()), "{}: {causes:?}", mode.name);
        assert!(off_s.abs() < 0.1, "{}: {off_s} s", mode.name);
    }
}

/// Row B11.
#[test]
fn a_rate_that_rises_is_right_within_five_seconds_and_makes_no_false_count_in_any_mode() {
    in_all_modes("rate 100", |mode| if mode.insists { 50.0 } else { 100.0 }, "rate_change", 0);
}

/// Row B11.
#[test]
fn a_rate_that_falls_is_right_within_five_seconds_and_makes_no_false_count_in_any_mode() {
    in_all_modes("rate 25", |mode| if mode.insists { 50.0 } else { 25.0 }, "rate_change", 0);
}

/// Row B9: the flash holds VNYMR at 40 Hz.
#[test]
fn a_brown_out_is_a_reset_within_five_seconds_and_makes_no_false_count_in_any_mode() {
    in_all_modes("reset", |mode| if mode.name == "keep" { 40.0 } else { 50.0 }, "sensor_reset", 1);
}

/// The reader pauses for less than the limit for a stall of the host: the terminal overflows within a frame.
#[test]
fn a_frame_that_is_cut_because_the_host_read_late_is_the_hosts_doing() {
    let world = World::new();
    let mut sensor = world.emulate(&["--faults", "-", "--baud", "921600"]);
    let daemon = world.daemon("[sensor]\nbaud = 921600\nrate-hz = 800\n", &["--capture", "1h"]);
    samples(&world, &daemon, 2000);
    for _ in 0..4 {
        daemon.signal(rustix::process::Signal::STOP);
        std::thread::sleep(Duration::from_millis(800));
        daemon.signal(rustix::process::Signal::CONT);
        samples(&world, &daemon, 1600);
    }
    // A frame that breaks on the line is the line's fault.
    sensor.send_line("checksum 1");
    samples(&world, &daemon, 800);
    let (status, body) = world.request("POST", "/v1/captures/latest/stop", "").unwrap();
    assert_eq!(status, 200, "{body}");
    let rows = world.query("SELECT cause, missing, to_utc_ns - from_utc_ns FROM gap ORDER BY before_seq");
    println!("{rows:?}");
    let text = |row: &Vec<Value>| if let Value::Text(text) = &row[0] { text.clone() } else { panic!() };
    let (last, stalls) = rows.split_last().unwrap();
    assert!(!stalls.is_empty() && stalls.iter().all(|row| text(row) == "host_stall"), "{rows:?}");
    assert_eq!((text(last), &last[1]), ("checksum".to_owned(), &Value::Integer(1)));
    for row in &rows {
        let (Value::Integer(missing), Value::Integer(length_ns)) = (&row[1], &row[2]) else { panic!() };
        assert_eq!(*length_ns, (missing + 1) * 1_250_000, "a gap is as long as what is missing");
    }
}

/// The sensor's clock jumps by half a second while its samples keep coming.
#[test]
fn a_clock_that_jumps_ahead_is_reported_and_nothing_is_missing() {
    let world = World::new();
    let mut sensor = world.emulate(&["--faults", "-", "--baud", "921600"]);
    let daemon = world.daemon("[sensor]\nbaud = 921600\n", &["--capture", "1h"]);
    samples(&world, &daemon, 120);
    // The clock's present time is known within the duration of a request.
    let seen = world.query("SELECT max(device_time_ns), max(host_mono_ns) FROM sample");
    let (Value::Integer(device_ns), Value::Integer(host_ns)) = (&seen[0][0], &seen[0][1]) else { panic!() };
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    let passed_ns = now.tv_sec * 1_000_000_000 + now.tv_nsec - host_ns;
    sensor.send_line(&format!("clock {}", (device_ns + passed_ns) / 1000 + 500_000));
    samples(&world, &daemon, 120);
    let (status, body) = world.request("POST", "/v1/captures/latest/stop", "").unwrap();
    assert_eq!(status, 200, "{body}");
    assert_eq!(world.get("/v1/captures/latest")["accounting"]["holds"], true);
    assert_eq!(integer(&world, "SELECT count(*) FROM gap"), 0, "{:?}", world.query("SELECT cause, missing FROM gap"));
    assert_eq!(integer(&world, "SELECT max(epoch) FROM segment"), 2);
    assert_eq!(integer(&world, "SELECT count(*) FROM event WHERE message LIKE '%jumped ahead by 0.%'"), 1);
}

/// After a silence the unit of a kept output is asked for its serial number, and what comes meanwhile waits: it keeps its order,
/// also if the reply and the next message come in one read.
#[test]
fn a_kept_output_goes_on_in_order_after_stalls_and_losses() {
    for fields in ["1,4,01,0609", "0,0,0"] {
        let world = World::new();
        let mut sensor = world.emulate(&["--faults", "-", "--baud", "921600", "--rate", "50"]);
        let mut line = std::fs::OpenOptions::new().write(true).open(world.port()).unwrap();
        line.write_all(format!("$VNWRG,75,{fields}*XX\r\n").as_bytes()).unwrap();
        drop(line);
        let daemon = world.daemon("[sensor]\nbaud = 921600\noutput = \"keep\"\n", &["--capture", "1h"]);
        samples(&world, &daemon, 100);
        for (before, fault) in [("drop 1", "hold 2500ms"), ("drop 2", "hold 1500ms"), ("hold 100ms", "hold 2s")] {
            sensor.send_line(before);
            std::thread::sleep(Duration::from_millis(200));
            sensor.send_line(fault);
            std::thread::sleep(Duration::from_secs(3));
            samples(&world, &daemon, 100);
        }
        let capture = world.get("/v1/captures/latest");
        assert_eq!(
            (&capture["state"], &capture["accounting"]["holds"]),
            (&"capturing".into(), &true.into()),
            "{capture:#}"
        );
        assert!(
            integer(&world, "SELECT coalesce(sum(missing), 0) FROM gap") <= 6,
            "{fields}: {:?}",
            world.query("SELECT * FROM gap")
        );
        let backwards =
            "SELECT count(*) FROM sample a JOIN sample b ON b.seq = a.seq + 1 WHERE b.host_mono_ns < a.host_mono_ns";
        assert_eq!(integer(&world, backwards), 0, "{fields}");
        assert_eq!(integer(&world, "SELECT coalesce(sum(count), 0) FROM rejected WHERE cause = 'out_of_order'"), 0);
    }
}
