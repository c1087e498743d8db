//! Captures and their accounting, jobs.

use super::*;

#[test]
fn a_capture_is_started_shown_and_stopped() {
    let world = World::new();
    let answer = world
        .post("/v1/captures", r#"{"duration": "90m", "name": "night", "start_at": "2027-01-15T09:00:00.5+01:00"}"#);
    assert_eq!(answer.status, 201, "{answer:?}");
    let id = answer.json()["id"].as_i64().unwrap();
    assert_eq!(answer.header("location"), format!("/v1/captures/{id}"));
    assert_eq!(
        *world.started.lock().unwrap(),
        [CaptureRequest {
            duration: Duration::from_secs(5400),
            name: Some("night".to_owned()),
            numbered: true,
            note: None,
            start_at_utc_ns: Some(1_800_000_000_500_000_000),
        }]
    );
    let busy = world.post("/v1/captures", "{}").problem(409, "conflict");
    assert!(busy.contains(&format!("capture {id} is running")), "{busy}");
    assert_eq!(world.get("/v1/captures/latest").json()["state"], "capturing");
    let stopped = world.post("/v1/captures/latest/stop", "");
    assert_eq!((stopped.status, stopped.json()["state"].as_str()), (200, Some("stopped")));
    world.post("/v1/captures/latest/stop", "").problem(409, "conflict");
}

#[test]
fn a_capture_without_a_body_has_the_configured_duration() {
    let world = World::new();
    assert_eq!(world.post("/v1/captures", "").status, 201);
    assert_eq!(world.started.lock().unwrap()[0].duration, Duration::from_secs(18_000));
}

#[test]
fn a_body_that_makes_no_sense_is_refused_and_starts_nothing() {
    let world = World::new();
    for (body, detail) in [
        ("{", "EOF"),
        ("[]", "invalid"),
        (r#"{"duration": 5}"#, "expected a string"),
        (r#"{"duration": "5"}"#, "`5` is not a duration"),
        (r#"{"duration": "0s"}"#, "allowed is 1s to"),
        (r#"{"duration": "9000h"}"#, "allowed is 1s to"),
        (r#"{"durations": "5h"}"#, "unknown field `durations`, expected one of `duration`, `name`, `note`, `start_at`"),
        (r#"{"start_at": "tomorrow"}"#, "invalid"),
        (r#"{"start_at": "9999-01-01T00:00:00Z"}"#, "2261"),
    ] {
        let found = world.post("/v1/captures", body).problem(400, "bad-request");
        assert!(found.contains(detail), "{body}: {found}");
    }
    let form = Answer::of(agent().post(world.url("/v1/captures")).content_type("text/plain").send("{}"));
    form.problem(415, "unsupported-media-type");
    let large = format!("{{\"name\": \"{}\"}}", "x".repeat(70_000));
    world.post("/v1/captures", &large).problem(413, "too-large");
    assert!(world.started.lock().unwrap().is_empty());
}

#[test]
fn captures_are_found_by_id_name_and_latest() {
    let world = World::new();
    world.get("/v1/captures/latest").problem(404, "not-found");
    let first = world.capture("first night", CaptureState::Complete, 120);
    let second = world.capture("second", CaptureState::Imported, 10);
    for (asked, id) in [("latest", second), ("first%20night", first), ("second", second), (&first.to_string(), first)] {
        assert_eq!(world.get(&format!("/v1/captures/{asked}")).json()["id"], id, "{asked}");
    }
    for asked in ["99", "third", "-1", "1e3", "99999999999999999999", "%00", "..%2f..%2fetc"] {
        world.get(&format!("/v1/captures/{asked}")).problem(404, "not-found");
    }
    world.get("/v1/captures/%ff").problem(400, "bad-request");
}

#[test]
fn a_capture_has_the_documented_fields() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    let capture = world.get("/v1/captures/latest").json();
    for name in [
        "id",
        "name",
        "source",
        "state",
        "started_at",
        "ended_at",
        "duration_s",
        "rate_hz",
        "rate_assumed",
        "samples",
        "missing",
        "gaps",
        "segments",
        "rejected",
        "pinned",
        "channels",
        "sensor",
        "configuration",
    ] {
        assert!(capture.get(name).is_some(), "{name} in {capture}");
    }
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(120), Some(4)));
    assert_eq!(capture["channels"], serde_json::json!(["gyro_x", "temperature"]));
}

#[test]
fn lists_come_in_pages_that_lead_on() {
    let world = World::new();
    for number in 0..5 {
        world.capture(&format!("c{number}"), CaptureState::Complete, 1);
    }
    let mut path = "/v1/captures?limit=2&state=complete".to_owned();
    let mut names = Vec::new();
    loop {
        let page = world.get(&path);
        names.extend(page.json()["captures"].as_array().unwrap().iter().map(|row| row["name"].clone()));
        let next = page.json()["next"].clone();
        let link = page.header("link");
        if next.is_null() {
            assert_eq!(link, "");
            break;
        }
        assert!(link.contains(next.as_str().unwrap()) && link.ends_with("; rel=\"next\""), "{link}");
        path = link.trim_start_matches('<').split('>').next().unwrap().to_owned();
    }
    assert_eq!(names, ["c4", "c3", "c2", "c1", "c0"]);
    assert_eq!(world.get("/v1/captures?state=imported").json(), serde_json::json!({"captures": [], "next": null}));
}

#[test]
fn a_page_that_makes_no_sense_is_refused() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    let long = "x".repeat(10_000);
    for query in [
        "limit=0",
        "limit=1001",
        "limit=1e9",
        "limit=-1",
        "limit=4294967296",
        "cursor=x",
        "cursor=gaps-1-1",
        "state=broken",
        "pages=1",
        "limit=1&limit=2",
        &format!("cursor={long}"),
        "cursor=%ff%fe",
    ] {
        world.get(&format!("/v1/captures?{query}")).problem(400, "bad-request");
    }
    world.get("/v1/captures/1/gaps?cursor=events-1-1").problem(400, "bad-request");
}

#[test]
fn gaps_segments_and_events_report_what_is_missing_and_why() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    let gaps = world.get("/v1/captures/a/gaps").json();
    let gap = &gaps["gaps"][0];
    assert_eq!(
        (gap["missing"].as_u64(), gap["missing_exact"].as_bool(), gap["cause"].as_str()),
        (Some(4), Some(true), Some("checksum"))
    );
    assert_eq!(gap["from"], "2027-01-15T08:00:02.475000000Z");
    assert_eq!(gap["to"], "2027-01-15T08:00:02.600000000Z");
    assert!(gaps["next"].is_null());
    let segments = world.get("/v1/captures/a/segments").json();
    assert_eq!(segments["segments"].as_array().unwrap().len(), 2);
    assert_eq!(segments["segments"][1]["first_seq"], 100);
    assert_eq!(world.get("/v1/captures/a/events").json()["events"], serde_json::json!([]));
    for list in ["gaps", "segments", "events"] {
        world.get(&format!("/v1/captures/b/{list}")).problem(404, "not-found");
    }
}

#[test]
fn a_pinned_or_running_capture_is_not_deleted() {
    let world = World::new();
    let id = world.capture("a", CaptureState::Complete, 120);
    let path = format!("/v1/captures/{id}");
    assert_eq!(world.post(&format!("{path}/pin"), "").json()["pinned"], true);
    assert!(world.delete(&path).problem(409, "conflict").contains("pinned"));
    assert_eq!(world.post(&format!("{path}/pin"), r#"{"pinned": false}"#).json()["pinned"], false);
    assert_eq!(world.delete(&path).status, 204);
    world.get(&path).problem(404, "not-found");
    world.delete(&path).problem(404, "not-found");
    world.capture("b", CaptureState::Capturing, 1);
    assert!(world.delete("/v1/captures/b").problem(409, "conflict").contains("running"));
}

#[test]
fn name_note_and_protection_are_changed_by_one_request() {
    let world = World::new();
    let id = world.capture("desk", CaptureState::Complete, 10);
    world.capture("shelf", CaptureState::Complete, 10);
    let path = format!("/v1/captures/{id}");
    let changed = world.patch(&path, r#"{"name": "night", "note": " on foam, 23 °C ", "pinned": true}"#);
    assert_eq!(changed.status, 200, "{changed:?}");
    let row = changed.json();
    assert_eq!((&row["name"], &row["note"], &row["pinned"]), (&"night".into(), &"on foam, 23 °C".into(), &true.into()));
    assert_eq!(world.patch("/v1/captures/night", r#"{"pinned": false}"#).json()["note"], "on foam, 23 °C");
    let events = world.get(&format!("{path}/events")).json();
    assert_eq!(events["events"][0]["detail"], serde_json::json!({"from": "desk", "to": "night"}));
    for nothing in [r#"{"note": ""}"#, r#"{"note": null}"#] {
        world.patch(&path, r#"{"note": "x"}"#);
        assert!(world.patch(&path, nothing).json()["note"].is_null(), "{nothing}");
    }
    assert!(world.patch(&path, r#"{"name": "shelf", "note": "x"}"#).problem(409, "conflict").contains("`shelf`"));
    world.patch("/v1/captures/99", r#"{"note": "x"}"#).problem(404, "not-found");
    let (long_name, long_note) = ("x".repeat(10_000), "x".repeat(1001));
    for (body, detail) in [
        ("", "the body changes nothing"),
        ("{}", "the body changes nothing"),
        (r#"{"name": null}"#, "the body changes nothing"),
        (r#"{"named": "x"}"#, "unknown field `named`, expected one of `name`, `note`, `pinned`"),
        (r#"{"pinned": 1}"#, "expected a boolean"),
        (r#"{"name": "../x"}"#, "cannot name a capture"),
        (r#"{"name": ""}"#, "cannot name a capture"),
        (r#"{"name": "a\nb"}"#, "cannot name a capture"),
        (r#"{"name": "\ud800"}"#, "the body"),
        (&format!(r#"{{"name": "{long_name}"}}"#), "longer than 100 characters"),
        (&format!(r#"{{"note": "{long_note}"}}"#), "longer than 1000 characters"),
        (r#"{"note": "a\u0007"}"#, "a note is one line"),
        (r#"["other", "x", true]"#, "expected a JSON object"),
        (" [null]", "expected a JSON object"),
        ("null", "expected a JSON object"),
    ] {
        let found = world.patch(&path, body).problem(400, "bad-request");
        assert!(found.contains(detail) && found.len() < 500, "{body}: {found}");
    }
    let row = world.get(&path).json();
    assert_eq!((&row["name"], row["note"].is_null(), &row["pinned"]), (&"night".into(), true, &false.into()));
}
