//! Diagnoses and their models.

use super::*;

fn model(body: &str) -> String {
    format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "unit <7>", "rate_hz": 40, "channels": {{"gyro_x": {body}}}}}"#
    )
}

fn done(world: &World, id: &serde_json::Value) -> Answer {
    eventually("the diagnosis", || world.get(&format!("/v1/diagnoses/{id}")), |answer| answer.status != 202)
}

#[test]
fn a_capture_is_compared_with_a_model_and_everyone_gets_the_form_they_read() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 2000);
    let body = format!(r#"{{"sim": {}}}"#, model(r#"{"N": 1e-5}"#));
    let asked = world.post("/v1/captures/a/diagnoses", &body);
    assert_eq!(asked.status, 202, "{asked:?}");
    let id = asked.json()["id"].clone();
    assert_eq!(
        (asked.header("location"), &asked.json()["kind"]),
        (format!("/v1/jobs/{id}").as_str(), &"diagnosis".into())
    );
    let report = done(&world, &id);
    assert_eq!(report.status, 200, "{report:?}");
    let json = report.json();
    assert_eq!((&json["format"], &json["inputs"]["real"]), (&"vn100d-diagnosis-1".into(), &"a".into()));
    assert_ne!(json["verdict"], "no_gap", "{json}");
    assert!(report.text.starts_with(r#"{"format":"#), "in the order of its keys: {}", report.text);
    let path = format!("/v1/diagnoses/{id}");
    assert_eq!(world.get_with(&path, "if-none-match", report.header("etag")).status, 304);
    assert_eq!(world.get("/v1/diagnoses/latest").text, report.text);
    let job = world.get(&format!("/v1/jobs/{id}")).json();
    assert_eq!((&job["result"], &job["state"], &job["progress"]), (&path.clone().into(), &"done".into(), &1.0.into()));
    let better = world.get(&format!("{path}/model"));
    assert_eq!((better.status, &better.json()["format"]), (200, &"vn100d-sensor-model-1".into()));
    assert_ne!(better.header("etag"), report.header("etag"));
    let page = world.get(&format!("/diagnoses/{id}"));
    assert_eq!((page.status, page.header("content-type")), (200, "text/html; charset=utf-8"));
    assert!(page.header("content-security-policy").starts_with("default-src 'none'"));
    let sentence = json["summary"].as_str().unwrap().replace('<', "&lt;").replace('>', "&gt;");
    assert!(
        page.text.contains(&format!("<h1>{sentence}</h1>")) && page.text.contains("unit &lt;7&gt;"),
        "{}",
        page.text
    );
    assert!(page.text.contains("<path class=\"line real\""), "{}", page.text);
    let list = world.get("/v1/diagnoses?capture=a").json();
    let entry = &list["diagnoses"][0];
    assert_eq!((&entry["id"], &entry["summary"], &entry["verdict"]), (&id, &json["summary"], &json["verdict"]));
    assert_eq!((&entry["page"], &list["next"]), (&format!("/diagnoses/{id}").into(), &serde_json::Value::Null));
    // The corrected model has the found effects: the gap to it is smaller.
    let again = world.post("/v1/captures/a/diagnoses", &format!(r#"{{"sim": {}}}"#, better.text));
    assert_eq!(again.status, 202);
    let closer = done(&world, &again.json()["id"]).json();
    let gap = |of: &serde_json::Value| of["discrepancy"]["before"].as_f64().unwrap();
    assert!(gap(&closer) < 0.1 * gap(&json), "{closer} {json}");
}

#[test]
fn the_same_request_is_the_same_job_however_it_is_written() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 1500);
    let kept = world.post("/v1/models", &model(r#"{"N": 1e-5}"#));
    assert_eq!((kept.status, kept.header("location")), (201, "/v1/models/model-1"), "{kept:?}");
    let ids: Vec<(u16, serde_json::Value)> = [
        ("/v1/captures/a/diagnoses", format!(r#"{{"sim": {}}}"#, model(r#"{"N": 0.00001, "effects": []}"#))),
        ("/v1/captures/1/diagnoses", format!(r#"{{"reference": null, "sim": {}}}"#, model(r#"{"N": 1e-5}"#))),
        ("/v1/captures/latest/diagnoses", r#"{"sim": "model-1"}"#.to_owned()),
        ("/v1/jobs", r#"{"kind": "diagnosis", "capture": "a", "sim": "model-1"}"#.to_owned()),
        ("/v1/captures/a/diagnoses", format!(r#"{{"sim": {}}}"#, model(r#"{"N": 2e-5}"#))),
    ]
    .iter()
    .map(|(path, body)| {
        let answer = world.post(path, body);
        (answer.status, answer.json()["id"].clone())
    })
    .collect();
    let first = ids[0].1.clone();
    assert_eq!(ids.iter().map(|(status, _)| *status).collect::<Vec<_>>(), [202, 200, 200, 200, 202], "{ids:?}");
    assert!(ids[..4].iter().all(|(_, id)| *id == first) && ids[4].1 != first, "{ids:?}");
    // The job has its model, and continues without the stored one.
    assert_eq!(world.delete("/v1/models/model-1").status, 204);
    assert_eq!(done(&world, &first).status, 200);
    world.post("/v1/captures/a/diagnoses", r#"{"sim": "model-1"}"#).problem(404, "not-found");
}

#[test]
fn models_are_kept_once_listed_and_deleted() {
    let world = World::new();
    let (one, other) = (model(r#"{"N": 1e-5}"#), model(r#"{"N": 2e-5}"#));
    assert_eq!(world.post("/v1/models", &one).status, 201);
    assert_eq!(world.post("/v1/models", &other).json()["id"], "model-2");
    let again = world.post("/v1/models", &one);
    assert_eq!((again.status, &again.json()["id"]), (200, &"model-1".into()));
    let shown = world.get("/v1/models/model-1").json();
    assert_eq!((&shown["name"], &shown["model"]["channels"]["gyro_x"]["N"]), (&"unit <7>".into(), &1e-5.into()));
    let list = world.get("/v1/models?limit=1").json();
    assert_eq!(list["models"][0]["id"], "model-2");
    assert!(list["next"].is_string());
    for id in ["model-3", "1", "model-x", "latest"] {
        assert!(world.get(&format!("/v1/models/{id}")).problem(404, "not-found").contains(id));
    }
    let refused =
        world.post("/v1/models", &model(r#"{"effects": [{"effect": "wobble"}]}"#)).problem(400, "bad-request");
    assert!(refused.contains("channels.gyro_x.effects[0].effect") && refused.contains("tone"), "{refused}");
}

#[test]
fn a_models_cost_is_answered_and_senseless_times_are_refused() {
    let world = World::new();
    assert_eq!(world.post("/v1/models", &model(r#"{"N": 1e-4}"#)).status, 201);
    let found = world.get("/v1/models/model-1/cost?horizons=1s,10s&align=20s&tolerance=attitude_x=1deg/1min").json();
    assert_eq!((&found["format"], &found["model"]), (&"vn100d-cost-1".into(), &"model-1".into()));
    assert_eq!(found["horizons_s"], serde_json::json!([1.0, 10.0]));
    // N √(t + t²/align).
    let sd = found["quantities"]["attitude_x"]["sd"][1].as_f64().unwrap();
    assert!((sd / (1e-4 * 15.0_f64.sqrt()) - 1.0).abs() < 1e-6, "{sd}");
    assert_eq!(found["tolerances"][0]["pass"], true);
    for (query, part) in [
        ("horizons=10s,1s", "increasing"),
        ("horizons=10", "`horizons`: "),
        ("horizons=1000h", "expected at most"),
        ("horizons=1s,2s,3s,4s,5s,6s,7s,8s,9s,10s,11s,12s,13s", "at most 12"),
        ("align=0s", "an alignment of 0 s"),
        ("tolerance=yaw=1deg/1s", "attitude_x"),
        ("tolerance=heading=1deg/1s", "one of attitude_x"),
        ("horizon=1s", "horizon"),
    ] {
        let refused = world.get(&format!("/v1/models/model-1/cost?{query}")).problem(400, "bad-request");
        assert!(refused.contains(part), "{query}: {refused}");
    }
    world.get("/v1/models/model-9/cost").problem(404, "not-found");
    let random = r#"{"effects": [{"effect": "intermittent", "of": {"effect": "tone", "frequency_hz": 3, "amplitude": 1e-3}, "on_s": 10, "off_s": 20}]}"#;
    assert_eq!(world.post("/v1/models", &model(random)).status, 201);
    let refused = world.get("/v1/models/model-2/cost").problem(422, "analysis-failed");
    assert!(refused.contains("intermittent on gyro_x has no closed form"), "{refused}");
}

#[test]
fn what_cannot_be_compared_is_refused_with_what_to_do() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 1500);
    world.capture("runs", CaptureState::Capturing, 1500);
    let good = model(r#"{"N": 1e-5}"#);
    let wobble = model(r#"{"effects": [{"effect": "wobble"}]}"#);
    for (body, status, part) in [
        (format!(r#"{{"sim": {wobble}}}"#), 400, "sim: channels.gyro_x.effects[0].effect: found \"wobble\""),
        (
            format!(r#"{{"sim": {good}, "reference": "motion.csv"}}"#),
            400,
            "`reference`: expected a motion's CSV with a header line",
        ),
        (format!(r#"{{"sim": {good}, "motion": 1}}"#), 400, "motion"),
        ("{}".to_owned(), 400, "`sim` is a model's id"),
        (r#"{"sim": 1.5}"#.to_owned(), 400, "no capture's id"),
        (r#"{"sim": 99}"#.to_owned(), 404, "99"),
        (r#"{"sim": "nobody"}"#.to_owned(), 404, "nobody"),
        (r#"{"sim": "model-9"}"#.to_owned(), 404, "model-9"),
        (r#"{"sim": "runs"}"#.to_owned(), 400, "still runs"),
    ] {
        let kind = if status == 404 { "not-found" } else { "bad-request" };
        let detail = world.post("/v1/captures/a/diagnoses", &body).problem(status, kind);
        assert!(detail.contains(part), "{body}: {detail}");
    }
    let as_job = format!(r#"{{"kind": "diagnosis", "capture": "a", "with": ["runs"], "sim": {good}}}"#);
    assert!(world.post("/v1/jobs", &as_job).problem(400, "bad-request").contains("`with`"));
    let as_job = format!(r#"{{"kind": "diagnosis", "capture": "a", "reference": 3, "sim": {good}}}"#);
    assert!(world.post("/v1/jobs", &as_job).problem(400, "bad-request").contains("`reference`"));
    world.post("/v1/captures/z/diagnoses", &format!(r#"{{"sim": {good}}}"#)).problem(404, "not-found");
    for path in ["/v1/diagnoses/latest", "/v1/diagnoses/7", "/v1/diagnoses/x", "/v1/diagnoses/7/model", "/diagnoses/7"]
    {
        world.get(path).problem(404, "not-found");
    }
    // A fault that shows only when the samples are read: the job fails with the sentence, on its page too.
    let asked = world.post("/v1/captures/a/diagnoses", &format!(r#"{{"sim": {}}}"#, good.replace("gyro_x", "gyro_y")));
    let id = asked.json()["id"].clone();
    assert!(done(&world, &id).problem(422, "analysis-failed").contains("no gyro_y, which the model has"));
    let page = world.get(&format!("/diagnoses/{id}"));
    assert!(page.status == 200 && page.text.contains("no gyro_y, which the model has"), "{page:?}");
    world.get("/v1/diagnoses/1").problem(422, "analysis-failed");
    // A job of another kind is not a diagnosis.
    let noise = world.post("/v1/jobs", r#"{"kind": "noise", "capture": "a"}"#).json()["id"].clone();
    world.get(&format!("/v1/diagnoses/{noise}")).problem(404, "not-found");
}

#[test]
fn another_capture_stands_for_its_simulator_and_a_running_diagnosis_can_be_called_off() {
    let world = World::new();
    world.capture("real", CaptureState::Complete, 2000);
    world.capture("simulated", CaptureState::Simulated, 2500);
    let asked = world.post("/v1/captures/real/diagnoses", r#"{"sim": "simulated"}"#);
    assert_eq!((asked.status, &asked.json()["params"]["sim"]), (202, &2.into()), "{asked:?}");
    let by_id = world.post("/v1/captures/real/diagnoses", r#"{"sim": 2}"#);
    assert_eq!((by_id.status, &by_id.json()["id"]), (200, &asked.json()["id"]));
    let path = format!("/v1/jobs/{}", asked.json()["id"]);
    eventually("its start", || world.get(&path).json(), |job| job["state"] != "queued");
    assert_eq!(world.delete(&path).json()["state"], "cancelled");
    let detail = done(&world, &asked.json()["id"]).problem(422, "analysis-failed");
    assert!(detail.contains("cancelled"), "{detail}");
}
