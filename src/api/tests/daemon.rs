//! Health, status, metrics, and properties of every request.

use super::*;
use crate::observe::{CaptureStatus, SensorState, StorageState};

fn running(status: &mut Status) {
    status.capture = Some(CaptureStatus {
        id: 3,
        name: "night".to_owned(),
        state: "capturing".to_owned(),
        elapsed_s: 2.5,
        remaining_s: 17_997.5,
        samples: 100,
        missing: 0,
        gaps: 0,
        committed: 80,
        received: 0,
        in_flight: 0,
        discarded: Default::default(),
        last_sample_age_s: Some(0.01),
        gap_open_since: None,
    });
}

#[test]
fn the_status_has_the_documented_fields() {
    let world = World::new();
    let idle = world.get("/v1/status");
    assert_eq!(idle.status, 200);
    assert_eq!(idle.header("content-type"), "application/json");
    assert!(idle.json()["capture"].is_null());
    world.status.send_modify(running);
    let status = world.get("/v1/status").json();
    assert_eq!(status["version"], env!("CARGO_PKG_VERSION"));
    assert!(status["uptime_s"].as_f64().unwrap() > 0.0);
    for (section, names) in [
        ("sensor", &["state", "port", "model", "serial_number", "firmware", "rate_hz"][..]),
        (
            "capture",
            &["id", "name", "state", "elapsed_s", "remaining_s", "samples", "missing", "gaps", "last_sample_age_s"],
        ),
    ] {
        for name in names {
            assert!(status[section].get(name).is_some(), "{section}.{name} in {status}");
        }
    }
    assert!(status["storage"].is_object() && status["jobs"].is_object());
    assert_eq!(status["capture"]["remaining_s"], 17_997.5);
}

#[test]
fn ready_is_no_while_a_capture_gets_no_samples() {
    let world = World::new();
    assert_eq!(world.get("/healthz").json()["status"], "ok");
    assert_eq!(world.get("/readyz").json()["ready"], true);
    world.status.send_modify(|status| {
        running(status);
        status.sensor.state = SensorState::Stalled;
        status.storage.state = StorageState::StorageFull;
    });
    let answer = world.get("/readyz");
    answer.problem(503, "unavailable");
    assert_eq!(answer.header("retry-after"), "5");
    let reasons = answer.json()["reasons"].as_array().unwrap().clone();
    assert_eq!(reasons.len(), 2, "{reasons:?}");
    assert!(reasons[0].as_str().unwrap().starts_with("sensor stalled"));
    assert_eq!(world.get("/healthz").status, 200);
}

#[test]
fn metrics_are_openmetrics_and_count_what_the_writer_did() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    let answer = eventually("commits", || world.get("/metrics"), |answer| !answer.text.contains("commits_total 0\n"));
    assert_eq!(answer.header("content-type"), crate::observe::metrics::CONTENT_TYPE);
    let commits = world.store.progress().figures.commits;
    assert!(answer.text.contains(&format!("\nvn100d_commits_total {commits}\n")), "{}", answer.text);
    assert!(answer.text.contains("\nvn100d_committed_samples_total 120\n"), "{}", answer.text);
    assert!(answer.text.ends_with("# EOF\n"));
}

#[test]
fn the_page_for_people_links_on_and_loads_nothing_from_elsewhere() {
    let world = World::new();
    let page = world.get("/");
    assert_eq!(page.status, 200);
    assert_eq!(page.header("content-type"), "text/html; charset=utf-8");
    assert!(page.header("content-security-policy").starts_with("default-src 'none'"));
    for path in ["/v1/status", "/metrics", "/openapi.json", "/v1/captures"] {
        assert!(page.text.contains(&format!("href=\"{path}\"")), "{path}");
        assert_eq!(world.get(path).status, 200, "{path}");
    }
}

#[test]
fn the_description_is_served() {
    let world = World::new();
    assert_eq!(world.get("/openapi.json").text, super::super::document());
}

#[test]
fn an_unknown_path_and_a_slash_too_many_are_not_found() {
    let world = World::new();
    for path in ["/v1/nothing", "/v1/status/", "/v1/captures/", "//", "/v2/status", "/v1/captures/1/plots/../gaps"] {
        assert!(world.get(path).problem(404, "not-found").contains("/openapi.json"), "{path}");
    }
}

#[test]
fn a_method_that_is_not_allowed_names_those_that_are() {
    let world = World::new();
    for (path, allowed) in [
        ("/v1/status", vec!["GET", "HEAD"]),
        ("/v1/captures/1", vec!["DELETE", "GET", "HEAD", "PATCH"]),
        ("/healthz", vec!["GET", "HEAD"]),
    ] {
        let answer = world.post(path, "{}");
        answer.problem(405, "method-not-allowed");
        let mut methods: Vec<&str> = answer.header("allow").split(',').map(str::trim).collect();
        methods.sort_unstable();
        assert_eq!(methods, allowed, "{path}");
    }
}

#[test]
fn head_is_answered_wherever_get_is() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    for path in ["/v1/status", "/healthz", "/v1/captures/latest", "/v1/captures/latest/samples", "/openapi.json", "/"] {
        let head = Answer::of(agent().head(world.url(path)).call());
        assert_eq!((head.status, head.text.as_str()), (200, ""), "{path}");
        assert_eq!(head.header("content-type"), world.get(path).header("content-type"), "{path}");
    }
    let missing = Answer::of(agent().head(world.url("/v1/captures/77")).call());
    assert_eq!((missing.status, missing.text.as_str()), (404, ""));
}

#[test]
fn every_answer_has_an_id_of_its_own() {
    let world = World::new();
    let (one, two) = (world.get("/healthz"), world.get("/healthz"));
    assert!(!one.header("x-request-id").is_empty());
    assert_ne!(one.header("x-request-id"), two.header("x-request-id"));
    assert_eq!(one.header("x-content-type-options"), "nosniff");
}

#[test]
fn a_large_answer_is_compressed_for_whoever_takes_it_and_samples_are_not() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 1000);
    let ask = |path: &str| {
        let response = agent().get(world.url(path)).header("accept-encoding", "gzip").call().unwrap();
        response.headers().get("content-encoding").map(|value| value.to_str().unwrap().to_owned())
    };
    assert_eq!(ask("/captures/a").as_deref(), Some("gzip"));
    // All share it as it is.
    assert_eq!(ask("/openapi.json"), None);
    assert_eq!(ask("/healthz"), None);
    assert_eq!(ask("/v1/captures/latest/samples"), None);
}

#[test]
fn with_a_token_changes_need_it_and_reading_does_not() {
    let token = Some("0123456789abcdef".to_owned());
    let world = World::with(Setting { token, ..Setting::default() });
    let id = world.capture("a", CaptureState::Complete, 120);
    assert_eq!(world.get("/v1/status").status, 200);
    let refused = world.post(&format!("/v1/captures/{id}/pin"), "");
    refused.problem(401, "not-authorized");
    assert_eq!(refused.header("www-authenticate"), "Bearer realm=\"vn100d\"");
    world.delete(&format!("/v1/captures/{id}")).problem(401, "not-authorized");
    world.post("/v1/captures", "{}").problem(401, "not-authorized");
    world.patch(&format!("/v1/captures/{id}"), r#"{"note": "x"}"#).problem(401, "not-authorized");
    world.post("/v1/jobs", "{}").problem(401, "not-authorized");
    assert!(world.started.lock().unwrap().is_empty());
    let path = world.url(&format!("/v1/captures/{id}/pin"));
    let send = |bearer: &str| Answer::of(agent().post(&path).header("authorization", bearer).send_empty());
    send("Bearer 0123456789abcdeX").problem(401, "not-authorized");
    assert_eq!(send("Bearer 0123456789abcdef").status, 200);
}

#[test]
fn another_site_s_page_changes_nothing() {
    let world = World::new();
    let id = world.capture("a", CaptureState::Complete, 120);
    let path = world.url(&format!("/v1/captures/{id}/pin"));
    let foreign = Answer::of(agent().post(&path).header("origin", "http://evil.example").send_empty());
    foreign.problem(403, "not-authorized");
    let own = format!("http://{}", world.address);
    assert_eq!(Answer::of(agent().post(&path).header("origin", own).send_empty()).status, 200);
}
