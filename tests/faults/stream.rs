//! Stream: a sensor that is reset, changes its rate or format, repeats frames, stalls, or is replaced by another one.

use crate::world::{Process, World};
use serde_json::Value;
use std::time::{Duration, Instant};

const START: Duration = Duration::from_secs(20);
const SENSOR: &str = "[sensor]\n";

/// Returns an emulated sensor that obeys faults, the daemon on it, and a capture with some samples.
fn capturing(world: &World, configuration: &str) -> (Process, Process) {
    let sensor = world.emulate(&["--faults", "-", "--baud", "921600"]);
    let daemon = world.daemon(&format!("{configuration}baud = 921600\n"), &["--capture", "1h"]);
    samples(world, &daemon, 60);
    (sensor, daemon)
}

/// Waits for this many more samples.
fn samples(world: &World, daemon: &Process, more: u64) {
    let now = || world.try_get("/v1/status")?["capture"]["samples"].as_u64();
    let before = now().unwrap_or(0);
    world.until("samples", START, || now().filter(|count| *count >= before + more), daemon);
}

fn stop(world: &World) {
    let (status, body) = world.request("POST", "/v1/captures/latest/stop", "").unwrap();
    assert_eq!(status, 200, "{body}");
}

/// Stops the capture and checks the requirements for every capture: its numbers, the file, the order of its rows.
fn settle(world: &World) -> Value {
    stop(world);
    let capture = world.get("/v1/captures/latest");
    let accounting = &capture["accounting"];
    assert_eq!(accounting["holds"], true, "{accounting:#}");
    assert_eq!((&accounting["in_flight"], &accounting["received_difference"]), (&0.into(), &0.into()));
    assert_eq!(count(world, "SELECT count(*) FROM sample"), capture["samples"].as_u64().unwrap());
    assert_eq!(
        count(
            world,
            "SELECT count(*) FROM (SELECT device_time_ns - lag(device_time_ns) OVER (PARTITION BY epoch ORDER BY seq) AS step \
              FROM sample JOIN segment USING (capture_id, segment_id)) WHERE step <= 0"
        ),
        0,
        "no time of an epoch runs back"
    );
    let check = world.query("PRAGMA integrity_check");
    assert_eq!(format!("{check:?}"), r#"[[Text("ok")]]"#);
    capture
}

fn count(world: &World, sql: &str) -> u64 {
    match world.query(sql)[0][0] {
        rusqlite::types::Value::Integer(number) => number as u64,
        ref other => panic!("{other:?}"),
    }
}

fn gaps(world: &World) -> Vec<Value> {
    world.get("/v1/captures/latest/gaps")["gaps"].as_array().unwrap().clone()
}

fn segments(world: &World) -> Vec<Value> {
    world.get("/v1/captures/latest/segments")["segments"].as_array().unwrap().clone()
}

fn gap_length_s(world: &World, cause: &str) -> f64 {
    let sql = format!("SELECT max(to_utc_ns - from_utc_ns) FROM gap WHERE cause = '{cause}'");
    count(world, &sql) as f64 / 1e9
}

/// While a capture runs both identities hold at every instant.
#[test]
fn the_numbers_agree_at_every_instant_of_a_running_capture() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, "[sensor]\nrate-hz = 200\n");
    sensor.send_line("drop 7");
    sensor.send_line("duplicate 5");
    let (mut asked, mut in_flight) = (0, 0);
    let until = Instant::now() + Duration::from_secs(4);
    while Instant::now() < until {
        let capture = world.get("/v1/captures/latest");
        let accounting = &capture["accounting"];
        assert_eq!(accounting["holds"], true, "{accounting:#}");
        in_flight = in_flight.max(accounting["in_flight"].as_i64().unwrap());
        let status = &world.get("/v1/status")["capture"];
        let number = |key: &str| status[key].as_i64().unwrap();
        let discarded: i64 =
            status["discarded"].as_object().unwrap().values().map(|count| count.as_i64().unwrap()).sum();
        assert_eq!(number("received"), number("committed") + number("in_flight") + discarded, "{status:#}");
        asked += 1;
    }
    assert!(asked > 20 && in_flight > 0, "{asked} times asked, at most {in_flight} in flight");
    let capture = settle(&world);
    assert_eq!((&capture["missing"], &capture["rejected"]["duplicate"]), (&7.into(), &5.into()), "{capture:#}");
    drop(daemon);
}

/// Row B9.
#[test]
fn a_reset_sensor_is_configured_again_within_two_seconds_and_its_time_never_runs_back() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, SENSOR);
    sensor.send_line("reset");
    let second = || {
        world
            .try_get("/v1/captures/latest/segments")
            .filter(|found| found["segments"][1]["samples"].as_u64() > Some(40))
    };
    let found = world.until("the second epoch", START, second, &daemon);
    assert_eq!((&found["segments"][0]["epoch"], &found["segments"][1]["epoch"]), (&1.into(), &2.into()));
    settle(&world);
    let gaps = gaps(&world);
    assert_eq!((gaps.len(), &gaps[0]["cause"], &gaps[0]["missing_exact"]), (1, &"sensor_reset".into(), &false.into()));
    // The sensor boots for 1.25 s, then it is configured.
    let length_s = gap_length_s(&world, "sensor_reset");
    assert!((1.2..1.25 + 2.0).contains(&length_s), "{length_s} s");
    assert_eq!(count(&world, "SELECT count(*) FROM event WHERE kind = 'sensor_reset'"), 1);
    let missing = gaps[0]["missing"].as_f64().unwrap();
    assert!((missing - length_s * 40.0).abs() <= 3.0, "{missing} in {length_s} s");
}

/// Row B10.
#[test]
fn a_clock_beyond_32_bits_of_microseconds_and_a_counter_that_wraps_are_no_gap() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, SENSOR);
    // 2^32 µs is 4294.967 s.
    sensor.send_line("clock 4293500000");
    samples(&world, &daemon, 160);
    settle(&world);
    assert!(count(&world, "SELECT max(device_time_ns) FROM sample") > 4_294_967_296_000);
    // No gap may follow the jump: nothing is missing where the clock exceeds 32 bits.
    let beyond = "SELECT count(*) FROM gap WHERE to_device_ns > 4294000000000 AND from_device_ns > 4293000000000";
    assert_eq!(count(&world, beyond), 0);
    assert_eq!(segments(&world).len(), 2);
}

/// Row B11.
#[test]
fn a_silent_change_of_rate_is_noticed_within_two_seconds_and_no_analysis_mixes_the_rates() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, "[sensor]\nrate-hz = 200\n");
    sensor.send_line("rate 100");
    let begun = Instant::now();
    let noticed = || world.try_get("/v1/status").filter(|status| status["sensor"]["rate_hz"] == 100.0);
    world.until("the new rate", Duration::from_secs(2), noticed, &daemon);
    let took = begun.elapsed();
    samples(&world, &daemon, 300);
    let capture = settle(&world);
    let segments = segments(&world);
    let rates: Vec<_> = segments.iter().map(|segment| segment["rate_hz"].as_f64().unwrap()).collect();
    assert_eq!(rates, [200.0, 100.0], "noticed after {took:?}");
    assert_eq!((&capture["missing"], gaps(&world).len()), (&0.into(), 0));
    let mixed = "SELECT count(*) FROM (SELECT segment_id, rate_hz, device_time_ns - lag(device_time_ns) OVER (PARTITION BY segment_id \
                 ORDER BY seq) AS step FROM sample JOIN segment USING (capture_id, segment_id)) WHERE step <> CAST(1e9 / rate_hz AS INTEGER)";
    assert_eq!(count(&world, mixed), 0, "every step of a segment is the period of its rate");
    let allan = || world.try_get("/v1/captures/latest/allan");
    let allan = world.until("the analysis", START, allan, &daemon);
    let rate = allan["rate_hz"].as_f64().unwrap();
    let of_rate = segments.iter().find(|segment| segment["rate_hz"] == rate).unwrap()["samples"].as_u64().unwrap();
    let curve = &allan["channels"]["gyro_x"];
    assert_eq!(curve["tau_s"][0].as_f64(), Some(1.0 / rate));
    // At the shortest time a deviation of N values has N − 1 differences.
    assert_eq!(curve["n"][0].as_u64(), Some(of_rate - 1), "samples of {rate} Hz alone");
}

/// Row B12.
#[test]
fn a_sensor_that_changes_its_format_is_configured_again_and_what_it_sent_is_counted() {
    for format in ["VNYMR", "01,0001"] {
        let world = World::new();
        let (mut sensor, daemon) = capturing(&world, SENSOR);
        sensor.send_line(&format!("format {format}"));
        let again = || {
            let events = world.try_get("/v1/captures/latest/events")?;
            events["events"].as_array()?.iter().find(|event| event["kind"] == "reconfigured").cloned()
        };
        let event = world.until("it is configured again", Duration::from_secs(5), again, &daemon);
        assert!(event["message"].as_str().unwrap().contains("configured again"), "{event}");
        samples(&world, &daemon, 80);
        let noticed_ns = count(&world, "SELECT utc_ns FROM event WHERE kind = 'reconfigured'");
        let capture = settle(&world);
        let gaps = gaps(&world);
        assert_eq!((gaps.len(), &gaps[0]["cause"]), (1, &"format_change".into()), "{gaps:?}");
        let noticed_s = (noticed_ns - count(&world, "SELECT from_utc_ns FROM gap")) as f64 / 1e9;
        assert!(noticed_s <= 2.0, "{format}: noticed after {noticed_s} s");
        let rejected = &capture["rejected"];
        let counted =
            rejected["unexpected_format"].as_u64().unwrap_or(0) + rejected["garbage_bytes"].as_u64().unwrap_or(0);
        assert!(counted > 5, "{format}: {rejected}");
        assert_eq!(capture["segments"], 2);
    }
}

/// Row B12, with the output kept.
#[test]
fn a_kept_output_that_changes_goes_on_in_a_new_segment() {
    let world = World::new();
    let mut sensor = world.emulate(&["--faults", "-"]);
    sensor.send_line("format 01,0609");
    let daemon = world.daemon("[sensor]\noutput = \"keep\"\n", &["--capture", "1h"]);
    samples(&world, &daemon, 60);
    sensor.send_line("format VNYMR");
    let second = || {
        world
            .try_get("/v1/captures/latest/segments")
            .filter(|found| found["segments"][1]["samples"].as_u64() > Some(40))
    };
    let found = world.until("the second segment", START, second, &daemon);
    assert_eq!(
        (&found["segments"][0]["timebase"], &found["segments"][1]["timebase"]),
        (&"device".into(), &"arrival".into())
    );
    let capture = settle(&world);
    assert_eq!(gaps(&world)[0]["cause"], "format_change");
    let reason = capture["accounting"]["unchecked"].to_string();
    assert!(reason.contains("without time"), "{reason}");
}

/// Row B14.
#[test]
fn frames_that_come_twice_or_late_are_counted_and_never_stored_twice() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, SENSOR);
    sensor.send_line("duplicate 20");
    samples(&world, &daemon, 60);
    sensor.send_line("reorder 1");
    samples(&world, &daemon, 40);
    let capture = settle(&world);
    assert_eq!(
        (&capture["rejected"]["duplicate"], &capture["rejected"]["out_of_order"]),
        (&20.into(), &1.into()),
        "{capture:#}"
    );
    // The place of the late one was counted as missing when its successor arrived.
    assert_eq!(capture["missing"], 1);
    assert_eq!(count(&world, "SELECT count(*) - count(DISTINCT device_time_ns) FROM sample"), 0);
}

/// Row B15.
#[test]
fn a_burst_after_a_stall_of_the_line_loses_nothing_and_is_reported_as_latency() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, SENSOR);
    let clock = || world.try_get("/v1/status").filter(|status| !status["sensor"]["clock"].is_null());
    world.until("the clocks are compared", START, clock, &daemon);
    sensor.send_line("hold 2s");
    samples(&world, &daemon, 160);
    let status = world.get("/v1/status");
    let latest_ms = status["sensor"]["clock"]["latency_max_ms"].as_f64().unwrap();
    assert!((1500.0..2600.0).contains(&latest_ms), "{latest_ms} ms");
    let capture = settle(&world);
    assert_eq!((&capture["missing"], &capture["gaps"], &capture["segments"]), (&0.into(), &0.into(), &1.into()));
    assert!(capture["clocks"][0]["latency_max_ms"].as_f64().unwrap() > 1500.0, "{}", capture["clocks"]);
}

/// Messages without time: the sensor numbers them, and every loss is exact.
#[test]
fn messages_without_time_are_counted_by_the_sensor_itself() {
    let world = World::new();
    let configuration = "[sensor]\noutput = \"VNYMR\"\nrate-hz = 40\n";
    let (mut sensor, mut daemon) = capturing(&world, configuration);
    assert_eq!(world.get("/v1/status")["sensor"]["timebase"], "sync_counter");
    sensor.send_line("drop 7");
    samples(&world, &daemon, 60);
    // Without time a burst looks like a loss; the count distinguishes them.
    sensor.send_line("hold 2s");
    samples(&world, &daemon, 120);
    // The daemon dies and restarts: the count continues.
    daemon.kill();
    let mut daemon = world.daemon(&format!("{configuration}baud = 921600\n"), &[]);
    samples(&world, &daemon, 60);
    let capture = settle(&world);
    let gaps = gaps(&world);
    let actual: Vec<_> =
        gaps.iter().map(|gap| (gap["cause"].as_str().unwrap(), gap["missing_exact"].as_bool().unwrap())).collect();
    assert_eq!(actual, [("silent", true), ("daemon_stopped", true)], "{gaps:?}");
    assert_eq!(gaps[0]["missing"], 7);
    let stretch = &capture["accounting"]["stretches"][0];
    let had = capture["samples"].as_u64().unwrap() + capture["missing"].as_u64().unwrap();
    assert_eq!((&stretch["timebase"], stretch["expected"].as_u64()), (&"sync_counter".into(), Some(had)));
    // A clean stop restores the sensor's previous output, including its count.
    assert_eq!(daemon.terminate(), Some(0));
    // The emulator clears a daemon's claim on the terminal within a second; a real port does at once.
    let probe = || {
        let probe = crate::world::vn100d(&["--json", "probe", "--device", world.port().to_str().unwrap()]);
        probe.status.success().then(|| String::from_utf8_lossy(&probe.stdout).into_owned())
    };
    let text = world.until("the sensor answers", START, probe, &daemon);
    assert!(text.contains("0,0,0,0,1,0,1") && text.contains("3,0,0,0,6,1,0,100000000,0"), "{text}");
}

/// Row B9, B12: the flash of a sensor holds the recorded message at the same rate: only the missing count shows its
/// reset.
#[test]
fn a_reset_that_changes_nothing_but_the_count_is_noticed_and_the_count_is_switched_on_again() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, "[sensor]\noutput = \"VNYMR\"\nrate-hz = 40\n");
    sensor.send_line("reset");
    let again = || {
        let events = world.try_get("/v1/captures/latest/events")?;
        events["events"].as_array()?.iter().find(|event| event["kind"] == "reconfigured").cloned()
    };
    let event = world.until("it is configured again", START, again, &daemon);
    assert!(event["message"].as_str().unwrap().contains("without its count"), "{event}");
    samples(&world, &daemon, 80);
    let capture = settle(&world);
    let gaps = gaps(&world);
    assert_eq!((gaps.len(), &gaps[0]["cause"], &gaps[0]["missing_exact"]), (1, &"sensor_reset".into(), &false.into()));
    // The sensor boots for 1.25 s; two more may pass until it counts again.
    let length_s = gap_length_s(&world, "sensor_reset");
    assert!((1.2..1.25 + 2.0).contains(&length_s), "{length_s} s");
    let noticed_ns = count(&world, "SELECT utc_ns FROM event WHERE kind = 'reconfigured'");
    let noticed_s = (noticed_ns - count(&world, "SELECT from_utc_ns FROM gap")) as f64 / 1e9;
    assert!(noticed_s <= 1.25 + 2.0, "noticed {noticed_s} s after the last sample");
    let segments = segments(&world);
    let actual: Vec<_> = segments.iter().map(|segment| (&segment["timebase"], &segment["epoch"])).collect();
    assert_eq!(actual, [(&"sync_counter".into(), &1.into()), (&"sync_counter".into(), &2.into())]);
    assert_eq!(count(&world, "SELECT count(*) FROM sample WHERE sync_count IS NULL"), 0);
    assert!(capture["rejected"]["unexpected_format"].as_u64().unwrap() > 5, "{capture:#}");
}

/// Another unit replaces the capture's: it is refused and reported. If the capture is stopped by hand, the outage is a
/// gap up to the stop.
#[test]
fn another_unit_is_refused_and_an_outage_that_is_stopped_by_hand_is_a_gap_to_the_end() {
    let world = World::new();
    let (mut sensor, daemon) = capturing(&world, SENSOR);
    sensor.send_line("unit 0100099999");
    let refused = || world.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "wrong_unit");
    let status = world.until("the other unit is refused", START, refused, &daemon);
    let hint = status["sensor"]["hint"].as_str().unwrap();
    assert!(hint.contains("0100012345") && hint.contains("0100099999"), "{hint}");
    let capture = settle(&world);
    let gaps = gaps(&world);
    assert_eq!((gaps.len(), &gaps[0]["before_seq"]), (1, &capture["samples"]), "{gaps:?}");
    assert_eq!(gaps[0]["missing_exact"], false);
    let asked = "SELECT CAST(round((ended_utc_ns - started_utc_ns) / 25e6) AS INTEGER) FROM capture";
    let had = capture["samples"].as_u64().unwrap() + capture["missing"].as_u64().unwrap();
    assert!(count(&world, asked).abs_diff(had) <= 3, "{had} of {}", count(&world, asked));
}
