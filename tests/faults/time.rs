//! Time: a host whose civil clock is stepped, unset, or in another zone. The sensor's time and the host's monotonic one
//! count; civil time is a label.

use crate::tools;
use crate::world::{Process, World};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

const START: Duration = Duration::from_secs(20);
const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1";

/// A daemon whose civil time is off by what the file `offset` says.
struct Faked {
    world: World,
    daemon: Process,
    _sensor: Process,
}

impl Faked {
    /// `None` (said) where the tool is not at hand.
    fn new(offset: &str, zone: &str) -> Option<Self> {
        if !std::path::Path::new(FAKETIME).exists() {
            tools::have("libfaketime.so.1", "civil time is faked by it");
            return None;
        }
        let world = World::new();
        let file = world.path("offset");
        std::fs::write(&file, offset).unwrap();
        let sensor = world.emulate(&[]);
        let environment = [
            ("LD_PRELOAD", FAKETIME),
            ("FAKETIME_TIMESTAMP_FILE", file.to_str().unwrap()),
            ("FAKETIME_NO_CACHE", "1"),
            ("FAKETIME_DONT_FAKE_MONOTONIC", "1"),
            ("TZ", zone),
        ];
        let daemon = world.daemon_in(&environment, "", &["--capture", "1h"]);
        let faked = Self { world, daemon, _sensor: sensor };
        faked.samples(60);
        Some(faked)
    }

    fn samples(&self, more: u64) {
        let now = || self.world.try_get("/v1/status")?["capture"]["samples"].as_u64();
        let before = now().unwrap_or(0);
        self.world.until("samples", START, || now().filter(|count| *count >= before + more), &self.daemon);
    }

    /// Steps civil time to this offset, as a whole: readers never see half a file.
    fn step(&self, offset: &str) {
        let next = self.world.path("offset.next");
        std::fs::write(&next, offset).unwrap();
        std::fs::rename(next, self.world.path("offset")).unwrap();
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

    /// Stops the capture: nothing is missing, and the order of rows is that of the sensor's time.
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

fn now_s() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() as i64
}

/// D1.
#[test]
fn a_stepped_clock_makes_no_gap_and_is_told_with_its_size() {
    let Some(faked) = Faked::new("+0", "UTC") else { return };
    let to_1970 = -(now_s() - 86_400);
    let offsets = [0, -3600, 3600, to_1970, 0];
    for (index, offset) in offsets.iter().enumerate().skip(1) {
        faked.step(&format!("{offset:+}"));
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
    // What was stamped 1970 was corrected when the clock was set again.
    assert_eq!(faked.count("SELECT count(*) FROM sample WHERE host_utc_ns < 1735689600000000000"), 0);
}

/// D3.
#[test]
fn summer_time_and_time_zones_change_nothing() {
    // Summer time ends in Berlin on 2026-10-25 at 01:00 UTC: the capture runs across it.
    let offset = 1_792_890_000 - 4 - now_s();
    let Some(faked) = Faked::new(&format!("{offset:+}"), "Europe/Berlin") else { return };
    let across = "SELECT count(*) FROM sample WHERE host_utc_ns > 1792890000000000000";
    faked.world.until("the hour is over", START, || Some(()).filter(|()| faked.count(across) > 20), &faked.daemon);
    let capture = faked.settle();
    assert!(faked.steps_seen().is_empty());
    assert_eq!(
        faked.count(
            "SELECT count(*) FROM (SELECT host_utc_ns - lag(host_utc_ns) OVER (ORDER BY seq) AS step FROM sample) \
                     WHERE step < 0 OR step > 2000000000"
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
    for zone in ["Europe/Berlin", "Australia/Lord_Howe", "right/UTC"] {
        assert_eq!(shown(zone), utc, "{zone}");
    }
}

/// D4.
#[test]
fn a_capture_begun_before_the_clock_was_set_has_its_times_corrected_and_says_so() {
    let Some(faked) = Faked::new(&format!("{:+}", -(now_s() - 100)), "UTC") else { return };
    let early = faked.count("SELECT min(host_utc_ns) FROM sample");
    assert!(early < 1_000_000_000_000, "1970: {early}");
    faked.step("+0");
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
    // Civil time runs on over the place where it was set.
    assert_eq!(
        faked.count(
            "SELECT count(*) FROM (SELECT host_utc_ns - lag(host_utc_ns) OVER (ORDER BY seq) AS step FROM sample) \
                     WHERE step < 0 OR step > 1000000000"
        ),
        0
    );
    assert!(capture["started_at"].as_str().unwrap().starts_with("20"), "{capture:#}");
}
