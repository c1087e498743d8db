//! Time: a host whose civil clock is stepped, unset, or in another zone. The sensor's time and the host's monotonic one
//! count; civil time is a label.

use crate::tools::Faketime;
use crate::world::{Process, World, program};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

const START: Duration = Duration::from_secs(20);

/// A daemon whose civil time can be set.
struct Faked {
    world: World,
    daemon: Process,
    sensor: Process,
    time: Faketime,
    zone: String,
}

impl Faked {
    /// Returns `None`, with a note, if the tool is not available.
    fn new(offset: &str, zone: &str) -> Option<Self> {
        let world = World::new();
        let time = Faketime::new(world.folder.path(), offset)?;
        let sensor = world.emulate(&["--faults", "-"]);
        let daemon = start(&world, &time, zone, &["--capture", "1h"]);
        let faked = Self { world, daemon, sensor, time, zone: zone.to_owned() };
        faked.samples(60);
        Some(faked)
    }

    /// Starts the daemon again, after it was killed.
    fn restart(&mut self) {
        self.daemon = start(&self.world, &self.time, &self.zone, &[]);
    }

    fn samples(&self, more: u64) {
        let now = || self.world.try_get("/v1/status")?["capture"]["samples"].as_u64();
        let before = now().unwrap_or(0);
        self.world.until("samples", START, || now().filter(|count| *count >= before + more), &self.daemon);
    }

    fn steps_seen(&self) -> Vec<serde_json::Value> {
        let events = self.world.get("/v1/captures/latest/events");
        let all = events["events"].as_array().unwrap().clone();
        all.into_iter().filter(|event| event["kind"] == "clock_step").collect()
    }

    fn await_steps(&self, count: usize) {
        let seen = || Some(self.steps_seen()).filter(|seen| seen.len() >= count);
        self.world.until("the step is told", Duration::from_secs(5), seen, &self.daemon);
    }

    fn count(&self, sql: &str) -> i64 {
        match self.world.query(sql)[0][0] {
            rusqlite::types::Value::Integer(number) => number,
            ref other => panic!("{sql}: {other:?}"),
        }
    }

    /// Stops the capture; nothing must be missing, and the order of rows must be that of the sensor's time.
    fn settle(&self) -> serde_json::Value {
        self.world.request("POST", "/v1/captures/latest/stop", "").unwrap();
        let capture = self.world.get("/v1/captures/latest");
        assert_eq!((&capture["gaps"], &capture["missing"], &capture["segments"]), (&0.into(), &0.into(), &1.into()));
        assert_eq!(capture["accounting"]["holds"], true, "{capture:#}");
        let backward = "SELECT count(*) FROM (SELECT device_time_ns - lag(device_time_ns) OVER (ORDER BY seq) AS device, \
                        host_mono_ns - lag(host_mono_ns) OVER (ORDER BY seq) AS mono FROM sample) WHERE device <= 0 OR mono < 0";
        assert_eq!(self.count(backward), 0);
        assert_eq!(self.count("SELECT count(*) FROM gap WHERE to_utc_ns < from_utc_ns"), 0);
        assert_eq!(format!("{:?}", self.world.query("PRAGMA integrity_check")), r#"[[Text("ok")]]"#);
        capture
    }
}

/// Returns a daemon with a separate civil time and zone.
fn start(world: &World, time: &Faketime, zone: &str, arguments: &[&str]) -> Process {
    let mut command = program();
    command.envs(time.environment()).env("TZ", zone);
    world.daemon_of(command, world.port().to_str().unwrap(), "", arguments)
}

fn now_s() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() as i64
}

/// Row D1.
#[test]
fn a_stepped_clock_makes_no_gap_and_is_reported_with_its_size() {
    let Some(faked) = Faked::new("+0", "UTC") else { return };
    let to_1970 = -(now_s() - 86_400);
    let offsets = [0, -3600, 3600, to_1970, 0];
    for (index, offset) in offsets.iter().enumerate().skip(1) {
        faked.time.step(&format!("{offset:+}"));
        faked.await_steps(index);
        faked.samples(20);
    }
    let capture = faked.settle();
    let seen = faked.steps_seen();
    assert_eq!(seen.len(), offsets.len() - 1, "{seen:?}");
    for (event, pair) in seen.iter().zip(offsets.windows(2)) {
        let by_s = event["detail"]["by_s"].as_f64().unwrap();
        assert!((by_s - (pair[1] - pair[0]) as f64).abs() < 0.010, "{by_s} s for {pair:?}");
    }
    assert!(capture["duration_s"].as_f64().unwrap() > 0.0);
    // Times in 1970 are corrected once the clock is set again, in steps beside the capture.
    let wrong = "SELECT count(*) FROM sample WHERE host_utc_ns < 1735689600000000000";
    let corrected = || Some(()).filter(|()| faked.count(wrong) == 0);
    faked.world.until("the rows of 1970 are corrected", START, corrected, &faked.daemon);
}

/// Row D3.
#[test]
fn summer_time_and_time_zones_change_nothing() {
    // Summer time ends in Berlin on 2026-10-25 at 01:00 UTC: the capture runs across it.
    let offset = 1_792_890_000 - 4 - now_s();
    let Some(faked) = Faked::new(&format!("{offset:+}"), "Europe/Berlin") else { return };
    let across = "SELECT count(*) FROM sample WHERE host_utc_ns > 1792890000000000000";
    faked.world.until("the hour is over", START, || Some(()).filter(|()| faked.count(across) > 20), &faked.daemon);
    let capture = faked.settle();
    assert_eq!(faked.steps_seen(), Vec::<serde_json::Value>::new());
    // On a loaded machine some samples are stamped late; summer time would be an hour.
    assert_eq!(
        faked.count(
            "SELECT count(*) FROM (SELECT host_utc_ns - lag(host_utc_ns) OVER (ORDER BY seq) AS step FROM sample) \
                     WHERE abs(step) > 600000000000"
        ),
        0
    );
    assert!(capture["started_at"].as_str().unwrap().ends_with('Z'), "{capture:#}");
    let shown = |zone: &str| {
        let data = faked.world.path("data");
        let mut command = crate::world::program();
        let output = command
            .args(["--data-dir", data.to_str().unwrap(), "--json", "show", "latest"])
            .env("TZ", zone)
            .output()
            .unwrap();
        assert!(output.status.success());
        output.stdout
    };
    let utc = shown("UTC");
    if !std::path::Path::new("/usr/share/zoneinfo/right/UTC").exists() {
        eprintln!("no zone data with leap seconds here: right/UTC is taken for UTC by the C library");
    }
    for zone in ["Europe/Berlin", "Australia/Lord_Howe", "right/UTC"] {
        assert_eq!(shown(zone), utc, "{zone}");
    }
}

/// Row D3: at a leap second the kernel's civil clock is set back by a second at 23:59:60 (`STA_INS`): a step like any
/// other.
#[test]
fn a_leap_second_is_a_step_of_one_second_that_costs_nothing() {
    // 2016-12-31T23:59:60, the last one so far.
    let leap_s = 1_483_228_800;
    let offset = leap_s - 4 - now_s();
    let Some(faked) = Faked::new(&format!("{offset:+}"), "right/UTC") else { return };
    let begun = faked.count("SELECT min(host_utc_ns) FROM sample");
    assert!(begun < leap_s * 1_000_000_000, "the capture begins before it: {begun}");
    let across = format!("SELECT count(*) FROM sample WHERE host_utc_ns > {leap_s}000000000");
    faked.world.until("midnight", START, || Some(()).filter(|()| faked.count(&across) > 0), &faked.daemon);
    faked.time.step(&format!("{:+}", offset - 1));
    faked.await_steps(1);
    faked.samples(60);
    let capture = faked.settle();
    let steps = faked.steps_seen();
    let by_s = steps[0]["detail"]["by_s"].as_f64().unwrap();
    assert!(steps.len() == 1 && (by_s + 1.0).abs() < 0.010, "{steps:?}");
    assert_eq!(steps[0]["detail"]["utc_back_filled"], false);
    // There is no sixty-first second in any zone, with or without leap seconds in its data.
    assert!(!capture.to_string().contains(":60."), "{capture:#}");
    let back = "SELECT count(*) FROM (SELECT host_utc_ns - lag(host_utc_ns) OVER (ORDER BY seq) AS step FROM sample) WHERE step < 0";
    assert_eq!(faked.count(back), 1, "once civil time goes back");
}

/// A clock is stepped by hours while the daemon is absent: within one boot its monotonic clock shows the length of the
/// absence, even if the sensor's own clock restarted.
#[test]
fn a_clock_stepped_while_the_daemon_was_away_makes_no_absence_longer_or_shorter() {
    let Some(mut faked) = Faked::new("+0", "UTC") else { return };
    for (times, offset) in [(1, 10_800), (2, -7200)] {
        faked.daemon.kill();
        let killed = Instant::now();
        faked.sensor.send_line("reset");
        faked.time.step(&format!("{offset:+}"));
        std::thread::sleep(Duration::from_secs(3));
        faked.restart();
        let gap = format!(
            "SELECT count(*) FROM gap JOIN sample ON seq = before_seq + 60 WHERE {times} = (SELECT count(*) FROM gap)"
        );
        faked.world.until("the gap", START, || (faked.count(&gap) > 0).then_some(()), &faked.daemon);
        let away_s = killed.elapsed().as_secs_f64();
        let rows = faked.world.query(
            "SELECT missing, missing_exact, to_utc_ns - from_utc_ns, cause,              (SELECT host_mono_ns FROM sample WHERE seq = before_seq) - (SELECT host_mono_ns FROM sample WHERE seq = before_seq - 1)              FROM gap ORDER BY before_seq",
        );
        assert_eq!(rows.len(), times, "{rows:?}");
        let number = |column: usize| match rows[times - 1][column] {
            rusqlite::types::Value::Integer(number) => number,
            ref other => panic!("{other:?}"),
        };
        let (missing_s, gap_s, mono_s) = (number(0) as f64 / 40.0, number(2) as f64 / 1e9, number(4) as f64 / 1e9);
        println!("{missing_s} s missing, gap of {gap_s:.3} s, {mono_s:.3} s by the host's monotonic clock");
        assert_eq!(number(1), 0, "the sensor was reset meanwhile: {rows:?}");
        assert!((missing_s - mono_s).abs() < 0.5 && (gap_s - mono_s).abs() < 0.5, "{rows:?}");
        // Up to a second before the kill was not committed; sixty samples came after the gap.
        assert!(mono_s > 3.0 && mono_s < away_s - 1.4 + 1.5, "{mono_s} s, away for {away_s} s");
    }
    // Across a boot only civil time counts: the host was restarted, and its clock was set by ten minutes.
    faked.daemon.kill();
    {
        use rusqlite::config::DbConfig;
        let connection = rusqlite::Connection::open(faked.world.database()).unwrap();
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true).unwrap();
        assert!(connection.execute("UPDATE segment SET boot_id = 'another'", []).unwrap() >= 3);
    }
    faked.sensor.send_line("reset");
    faked.time.step("-6600");
    faked.restart();
    faked.world.until("the gap", START, || (faked.count("SELECT count(*) FROM gap") == 3).then_some(()), &faked.daemon);
    let missing = faked.count("SELECT missing FROM gap ORDER BY before_seq DESC LIMIT 1");
    assert!((600 * 40..620 * 40).contains(&missing), "{missing}");
    let steps_s: Vec<f64> = faked.steps_seen().iter().map(|event| event["detail"]["by_s"].as_f64().unwrap()).collect();
    assert_eq!(steps_s.len(), 2, "{steps_s:?}");
    assert!((steps_s[0] - 10_800.0).abs() < 0.1 && (steps_s[1] + 18_000.0).abs() < 0.1, "{steps_s:?}");
    faked.world.request("POST", "/v1/captures/latest/stop", "").unwrap();
    let capture = faked.world.get("/v1/captures/latest");
    assert_eq!(capture["accounting"]["holds"], true, "{capture:#}");
}

/// Row D4.
#[test]
fn a_capture_begun_before_the_clock_was_set_has_its_times_corrected_and_reports_it() {
    let Some(faked) = Faked::new(&format!("{:+}", -(now_s() - 100)), "UTC") else { return };
    let early = faked.count("SELECT min(host_utc_ns) FROM sample");
    assert!(early < 1_000_000_000_000, "1970: {early}");
    faked.time.step("+0");
    faked.await_steps(1);
    faked.samples(40);
    let capture = faked.settle();
    assert_eq!(faked.steps_seen()[0]["detail"]["utc_back_filled"], true);
    let today = now_s() * 1_000_000_000;
    for (table, column) in [
        ("sample", "host_utc_ns"),
        ("segment", "first_utc_ns"),
        ("segment", "last_utc_ns"),
        ("capture", "started_utc_ns"),
        ("event", "utc_ns"),
    ] {
        let earliest = faked.count(&format!("SELECT min({column}) FROM {table}"));
        assert!((today - earliest) < 120_000_000_000, "{table}.{column}: {earliest}, now {today}");
    }
    // Civil time is continuous where it was set.
    assert_eq!(
        faked.count(
            "SELECT count(*) FROM (SELECT host_utc_ns - lag(host_utc_ns) OVER (ORDER BY seq) AS step FROM sample) \
                     WHERE step < 0 OR step > 1000000000"
        ),
        0
    );
    assert!(capture["started_at"].as_str().unwrap().starts_with("20"), "{capture:#}");
}

/// Row D4: a host without a battery-backed clock starts in 1970.
#[test]
fn a_capture_that_began_at_its_hour_does_not_wait_for_that_hour_again() {
    let world = World::new();
    let Some(time) = Faketime::new(world.folder.path(), "+0") else { return };
    let _sensor = world.emulate(&[]);
    let mut daemon = start(&world, &time, "UTC", &[]);
    let hour = chrono::DateTime::from_timestamp(now_s() + 2, 0).unwrap().to_rfc3339();
    let body = format!("{{\"start_at\": \"{hour}\", \"duration\": \"1h\"}}");
    let (code, answer) = world.request("POST", "/v1/captures", &body).unwrap();
    assert_eq!(code, 201, "{answer}");
    let samples = || world.try_get("/v1/status")?["capture"]["samples"].as_u64();
    world.until("its hour", START, || samples().filter(|count| *count > 60), &daemon);
    let committed = world.committed();
    daemon.kill();
    time.step(&format!("-{}", now_s() - 86_400));
    let daemon = start(&world, &time, "UTC", &[]);
    world.until("it goes on", START, || samples().filter(|count| *count > committed + 60), &daemon);
}
