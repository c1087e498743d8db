//! The schedule: a night begins by itself, once, despite restarts, and waits for another capture.

use crate::world::{Process, World, program};
use chrono::{DateTime, Days, Duration as Span, NaiveDateTime, Utc};
use serde_json::Value;
use std::time::Duration;

/// A zone five and a half hours ahead of UTC, by rules that need no zone data.
const ZONE: (&str, i64) = ("TST-5:30", 330);

/// A daemon may wait until the machine has run for five minutes.
fn patience() -> Duration {
    let up_s = rustix::time::clock_gettime(rustix::time::ClockId::Boottime).tv_sec.unsigned_abs();
    Duration::from_secs(20 + 300_u64.saturating_sub(up_s))
}

/// Returns a schedule whose hour was a minute or two ago, and that hour in local time.
fn begun(duration: &str) -> (String, NaiveDateTime) {
    let local = Utc::now().naive_utc() + Span::minutes(ZONE.1 - 1);
    let at = local.format("%H:%M").to_string();
    let text = format!("[schedule]\nat = \"{at}\"\nduration = \"{duration}\"\nname = \"evening\"\n");
    (text, local.date().and_time(chrono::NaiveTime::parse_from_str(&at, "%H:%M").unwrap()))
}

fn daemon(world: &World, configuration: &str, arguments: &[&str]) -> Process {
    let mut command = program();
    command.env("TZ", ZONE.0);
    world.daemon_of(command, world.port().to_str().unwrap(), configuration, arguments)
}

fn name(evening: NaiveDateTime) -> String {
    format!("evening-{}", evening.format("%Y-%m-%d"))
}

/// Waits until the status shows that the next night is tomorrow's and that none waits.
fn until_tomorrow(world: &World, evening: NaiveDateTime, daemon: &Process) -> Value {
    let tomorrow = evening.checked_add_days(Days::new(1)).unwrap();
    let planned = || world.try_get("/v1/status").filter(|status| status["schedule"]["name"] == name(tomorrow));
    let status = world.until("tomorrow's night is planned", patience(), planned, daemon);
    let next = DateTime::parse_from_rfc3339(status["schedule"]["next_start"].as_str().unwrap()).unwrap();
    assert_eq!(next.naive_utc(), tomorrow - Span::minutes(ZONE.1));
    assert_eq!(status["schedule"]["at"], evening.format("%H:%M").to_string());
    assert_eq!(status["schedule"]["waits"], Value::Null);
    status
}

fn captures(world: &World) -> Vec<(String, String)> {
    let page = world.get("/v1/captures");
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    page["captures"].as_array().unwrap().iter().map(|one| (text(&one["name"]), text(&one["state"]))).collect()
}

#[test]
fn a_night_whose_hour_has_passed_begins_once_whatever_is_restarted() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let (configuration, evening) = begun("20m");
    let mut running = daemon(&world, &configuration, &[]);
    let status = until_tomorrow(&world, evening, &running);
    assert_eq!(status["schedule"]["duration_s"], 1200.0);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["committed"].as_u64() > Some(40));
    let status = world.until("samples", Duration::from_secs(20), some, &running);
    assert_eq!(status["capture"]["name"], name(evening));
    assert!(running.log().contains("the night's capture begins"), "{}", running.log());
    // After a power cut the same capture continues.
    running.kill();
    let mut running = daemon(&world, &configuration, &[]);
    until_tomorrow(&world, evening, &running);
    assert_eq!(captures(&world), [(name(evening), "capturing".to_owned())]);
    // A user who stops it stops it for this night, also after a restart.
    assert_eq!(world.request("POST", &format!("/v1/captures/{}/stop", name(evening)), "").unwrap().0, 200);
    assert_eq!(running.terminate(), Some(0));
    let mut running = daemon(&world, &configuration, &[]);
    until_tomorrow(&world, evening, &running);
    assert_eq!(captures(&world), [(name(evening), "stopped".to_owned())]);
    assert!(!running.log().contains("the night's capture begins"), "{}", running.log());
    assert_eq!(running.terminate(), Some(0));
}

/// A minute of this daemon takes a second; a capture without a sensor is enough to delay a night.
#[test]
fn a_night_waits_for_another_capture_and_begins_when_that_has_ended() {
    let world = World::new();
    let (configuration, evening) = begun("10h");
    let mut running = daemon(&world, &configuration, &["--capture", "100h", "--speed", "60"]);
    let waits = || {
        let status = world.try_get("/v1/status")?;
        status["schedule"]["waits"].as_str().is_some_and(|why| why.starts_with("capture 1 ")).then_some(status)
    };
    let status = world.until("the night waits", patience(), waits, &running);
    assert_eq!(status["schedule"]["name"], name(evening));
    assert!(running.log().contains("the night waits: capture 1 runs or waits"), "{}", running.log());
    assert_eq!(world.request("POST", "/v1/captures/1/stop", "").unwrap().0, 200);
    let begun = || world.try_get("/v1/status").filter(|status| status["capture"]["name"] == name(evening));
    world.until("the night begins", patience(), begun, &running);
    until_tomorrow(&world, evening, &running);
    assert_eq!(running.terminate(), Some(0));
}

/// An hour of this daemon takes less than four seconds: the night passes while another capture runs.
#[test]
fn a_night_that_another_capture_takes_is_reported() {
    let world = World::new();
    let (configuration, evening) = begun("6h");
    let notice_file = world.path("told");
    let script = format!("echo \\\"$VN100D_EVENT: $VN100D_EVENT_MESSAGE\\\" >> {}", notice_file.display());
    let configuration =
        format!("{configuration}[notify]\ncommand = [\"sh\", \"-c\", \"{script}\"]\nevents = [\"night_skipped\"]\n");
    let mut running = daemon(&world, &configuration, &["--capture", "100h", "--speed", "1000"]);
    let skipped = || std::fs::read_to_string(&notice_file).ok().filter(|text| text.ends_with('\n'));
    let text = world.until("the night was skipped", Duration::from_secs(60), skipped, &running);
    let name = name(evening);
    assert_eq!(
        text,
        format!("night_skipped: the night {name} was not recorded: capture 1 runs or waits: stop it, or let it end\n")
    );
    assert!(running.log().contains("the night was skipped: capture 1 runs or waits"), "{}", running.log());
    assert_eq!(running.terminate(), Some(0));
}

#[test]
fn without_a_schedule_the_status_has_none() {
    let world = World::new();
    let mut running = daemon(&world, "", &[]);
    assert_eq!(world.get("/v1/status")["schedule"], Value::Null);
    assert_eq!(running.terminate(), Some(0));
}
