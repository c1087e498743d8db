//! `vn100d status`: prints the running daemon's status.

use super::client::{self, ClientError, shown};
use super::figures::{counted, hertz};
use super::table::{facts, terminal};
use crate::page::span;
use imu_core::units::format_duration;
use serde_json::Value;
use std::time::Duration;

/// Queries the daemon at `base_url` (`http://127.0.0.1:8100`) and prints its answer as a table, or as the JSON of `GET
/// /v1/status`.
///
/// # Errors
/// [`ClientError`]; [`ClientError::is_unreachable`] is exit code 69.
pub fn run(base_url: &str, json: bool) -> Result<(), ClientError> {
    let status = client::get(base_url, "/v1/status")?;
    client::print(&if json { status.to_string() } else { facts(&rows(&status), terminal()) })
}

fn rows(status: &Value) -> Vec<[String; 2]> {
    let mut rows = Vec::new();
    let mut row = |name: &str, value: String| rows.push([name.to_owned(), value]);
    let (sensor, capture) = (&status["sensor"], &status["capture"]);
    let (storage, jobs) = (&status["storage"], &status["jobs"]);
    row("daemon", format!("vn100d {}, up {}", shown(&status["version"]), duration(&status["uptime_s"])));
    row("sensor", shown(&sensor["state"]));
    let behind = &sensor["port_target"];
    let behind = if *behind == sensor["port"] { &Value::Null } else { behind };
    for (name, value) in [("", &sensor["hint"]), ("port", &sensor["port"]), ("", behind), ("output", &sensor["output"])]
    {
        if !value.is_null() {
            row(name, shown(value));
        }
    }
    if !sensor["model"].is_null() {
        let unit = [&sensor["model"], &sensor["serial_number"], &sensor["firmware"]].map(shown);
        row("unit", format!("{}, serial number {}, firmware {}", unit[0], unit[1], unit[2]));
    }
    if !sensor["rate_hz"].is_null() {
        row("rate", sensor["rate_hz"].as_f64().map_or_else(|| shown(&sensor["rate_hz"]), hertz));
    }
    if capture.is_null() {
        row("capture", "none".to_owned());
    } else {
        row(
            "capture",
            format!("{} ({}), {}", shown(&capture["id"]), shown(&capture["name"]), shown(&capture["state"])),
        );
        let (elapsed, remaining) = (duration(&capture["elapsed_s"]), duration(&capture["remaining_s"]));
        row("", format!("{elapsed} elapsed, {remaining} to come"));
        let [samples, missing, committed] = ["samples", "missing", "committed"].map(|name| shown(&capture[name]));
        let gaps = counted(capture["gaps"].as_u64().unwrap_or_default(), "gap", "gaps");
        row("samples", format!("{samples} received, {missing} missing in {gaps}, {committed} on disk"));
        if !capture["gap_open_since"].is_null() {
            row("", format!("nothing since {}", shown(&capture["gap_open_since"])));
        }
    }
    let schedule = &status["schedule"];
    if !schedule.is_null() {
        let [name, start, at] = ["name", "next_start", "at"].map(|key| shown(&schedule[key]));
        row("next night", format!("{name} at {start} ({at} local time)"));
        if !schedule["waits"].is_null() {
            row("", format!("it waits: {}", shown(&schedule["waits"])));
        }
    }
    row("storage", format!("{}, {}", shown(&storage["state"]), shown(&storage["database"])));
    if !storage["error"].is_null() {
        row("", shown(&storage["error"]));
    }
    row(
        "",
        format!(
            "{} used, {} free{}",
            size(storage, &["database_bytes", "wal_bytes"]),
            size(storage, &["free_bytes"]),
            lasts(storage)
        ),
    );
    for planned in status["retention"]["planned"].as_array().into_iter().flatten() {
        let [id, name, at] = ["capture", "name", "delete_at"].map(|key| shown(&planned[key]));
        row("", format!("capture {id} ({name}) will be deleted on {at} unless it is pinned"));
    }
    let notify = &status["notify"];
    let tally = ["sent", "failed", "dropped", "queued"].map(|name| notify[name].as_u64().unwrap_or(0));
    if tally.iter().any(|count| *count > 0) {
        row("notify", format!("{} sent, {} failed, {} dropped, {} waiting", tally[0], tally[1], tally[2], tally[3]));
        if !notify["error"].is_null() {
            row("", shown(&notify["error"]));
        }
    }
    let share = &status["share"];
    if !share.is_null() {
        let [link, bytes, dropped] = ["link", "bytes", "dropped_bytes"].map(|name| shown(&share[name]));
        if !share["link"].is_null() {
            let reading = if share["reading"] == true { "read" } else { "not read" };
            row("share", format!("{link}, {reading}, {bytes} bytes, {dropped} dropped"));
        }
        if !share["socket"].is_null() {
            let socket = shown(&share["socket"]);
            let lost = counted(share["lost_lines"].as_u64().unwrap_or_default(), "sample", "samples");
            let clients = counted(share["clients"].as_u64().unwrap_or_default(), "client", "clients");
            row("share", format!("{socket}, {clients}, {lost} lost by slow ones"));
        }
        if !share["error"].is_null() {
            row("", shown(&share["error"]));
        }
    }
    let counts = ["running", "queued", "done", "failed"].map(|name| format!("{} {name}", shown(&jobs[name])));
    row("jobs", counts.join(", "));
    rows
}

fn lasts(storage: &Value) -> String {
    let left = &storage["time_to_full_s"];
    if left.is_null() {
        String::new()
    } else {
        format!(", full in {}", left.as_f64().map_or_else(|| shown(left), span))
    }
}

fn size(storage: &Value, names: &[&str]) -> String {
    let bytes: f64 = names.iter().filter_map(|name| storage[*name].as_f64()).sum();
    let mib = bytes / f64::from(1 << 20);
    if mib < 1024.0 { format!("{mib:.1} MiB") } else { format!("{:.1} GiB", mib / 1024.0) }
}

/// Returns whole seconds, in the units of the command line.
fn duration(seconds: &Value) -> String {
    match seconds.as_f64().and_then(|seconds| Duration::try_from_secs_f64(seconds.round()).ok()) {
        Some(duration) if duration.is_zero() => "0s".to_owned(),
        Some(duration) => format_duration(duration),
        None => shown(seconds),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::{CaptureStatus, SensorState, Status};

    fn lines(status: &Status) -> String {
        let mut value = serde_json::to_value(status).unwrap();
        value["version"] = "0.1.0".into();
        value["uptime_s"] = 61.4.into();
        facts(&rows(&value), None)
    }

    #[test]
    fn an_idle_daemon_fits_a_few_lines() {
        let text = lines(&Status::default());
        assert!(text.contains("vn100d 0.1.0, up 1m1s"), "{text}");
        assert!(text.contains("absent") && text.contains("none"), "{text}");
        assert!(!text.contains("null") && !text.contains('–'), "{text}");
    }

    #[test]
    fn a_status_fits_the_terminal() {
        let mut status = Status::default();
        status.sensor.state = SensorState::Stalled;
        status.sensor.hint = Some("the cable may be loose, or the sensor may have no power: look at both".to_owned());
        let mut value = serde_json::to_value(&status).unwrap();
        value["version"] = "0.1.0".into();
        let text = facts(&rows(&value), Some(40));
        assert!(text.lines().all(|line| line.chars().count() <= 40), "{text}");
        assert!(text.contains("the cable") && text.contains("at both"), "{text}");
        // The names stand alone at the left.
        assert!(text.lines().any(|line| line.starts_with("          ") && !line.trim().is_empty()), "{text}");
    }

    #[test]
    fn a_running_capture_is_shown_with_its_counts() {
        let mut status = Status::default();
        status.sensor.state = SensorState::Stalled;
        status.sensor.hint = Some("the cable".to_owned());
        status.storage.free_bytes = 5 << 30;
        status.storage.time_to_full_s = Some(7200.0);
        status.capture = Some(CaptureStatus {
            id: 12,
            name: "night".to_owned(),
            state: "capturing".to_owned(),
            elapsed_s: 3600.2,
            remaining_s: 14_400.0,
            samples: 143_990,
            missing: 10,
            gaps: 2,
            committed: 143_950,
            received: 0,
            in_flight: 0,
            discarded: Default::default(),
            last_sample_age_s: Some(4.0),
            gap_open_since: Some("2026-11-21T20:00:00Z".to_owned()),
        });
        let text = lines(&status);
        for part in [
            "stalled",
            "the cable",
            "12 (night), capturing",
            "1h elapsed, 4h to come",
            "143990 received, 10 missing in 2 gaps, 143950 on disk",
            "nothing since 2026-11-21T20:00:00Z",
            "0.0 MiB used, 5.0 GiB free, full in 2 h",
        ] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
    }
}
