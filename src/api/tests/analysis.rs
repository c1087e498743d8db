//! Analyses and the jobs that make them.

use super::*;

#[test]
fn an_analysis_is_202_until_its_job_is_done_and_then_has_a_tag() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 2000);
    let first = world.get("/v1/captures/a/allan");
    if first.status == 202 {
        assert!(first.header("location").starts_with("/v1/jobs/"), "{first:?}");
        assert_eq!(first.header("retry-after"), "2");
        assert_eq!(first.json()["kind"], "allan");
        assert_eq!(first.header("location"), format!("/v1/jobs/{}", first.json()["id"]));
    }
    let done = eventually("the job", || world.get("/v1/captures/a/allan"), |answer| answer.status == 200);
    let report = done.json();
    assert_eq!((report["format"].as_str(), report["complete"].as_bool()), (Some("vn100d-allan-1"), Some(true)));
    assert_eq!(report["channels"]["gyro_x"]["unit"], "rad/s");
    let tag = done.header("etag");
    assert!(tag.starts_with("W/\"") && tag.ends_with('"'), "{tag}");
    let again = world.get_with("/v1/captures/a/allan", "if-none-match", tag);
    assert_eq!((again.status, again.text.as_str(), again.header("etag")), (304, "", tag));
    assert_eq!(world.get_with("/v1/captures/a/allan", "if-none-match", "\"other\"").text, done.text);
    assert_eq!(world.get("/v1/jobs").json()["jobs"].as_array().unwrap().len(), 1, "asking makes one job");
}

#[test]
fn noise_parameters_and_statistics_are_answered_for_finished_and_for_running_captures() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 4000);
    world.capture("b", CaptureState::Capturing, 4000);
    for (capture, complete) in [("a", true), ("b", false)] {
        let ask = |kind: &str| {
            let path = format!("/v1/captures/{capture}/{kind}");
            eventually("the job", || world.get(&path), |answer| answer.status == 200).json()
        };
        let noise = ask("noise");
        assert_eq!(noise["format"], "vn100d-noise-1");
        assert_eq!((noise["capture"].as_str(), noise["complete"].as_bool()), (Some(capture), Some(complete)));
        assert_eq!((noise["samples"].as_u64(), noise["missing"].as_u64()), (Some(4000), Some(4)), "{capture}");
        assert_eq!(noise["channels"]["gyro_x"]["N"]["unit"], "rad/s/√Hz");
        let statistics = ask("statistics");
        assert_eq!(statistics["complete"], complete);
        let temperature = &statistics["channels"]["temperature"];
        assert_eq!((temperature["n"].as_u64(), temperature["mean"].as_f64()), (Some(3999), Some(21.5)), "{capture}");
        assert_eq!(ask("allan")["complete"], complete);
    }
}

#[test]
fn while_a_capture_runs_there_is_an_answer_for_what_it_has() {
    let world = World::new();
    world.capture("a", CaptureState::Capturing, 2000);
    let report = world.get("/v1/captures/a/allan");
    assert_eq!((report.status, report.header("etag")), (200, ""));
    assert_eq!(report.json()["complete"], false);
    assert!(!report.json()["channels"]["gyro_x"]["tau_s"].as_array().unwrap().is_empty());
    assert_eq!(world.get("/v1/jobs").json()["jobs"], serde_json::json!([]), "no job for a capture that runs");
    world.store.set_state(1, CaptureState::Stopped, START_NS).unwrap();
    world.capture("b", CaptureState::Waiting, 0);
    world.get("/v1/captures/b/allan").problem(422, "analysis-failed");
}

/// After a start, the analysis of a long capture catches up answer by answer and states this, so that a part is not
/// taken for the whole.
#[test]
fn an_answer_of_a_part_of_a_running_capture_states_that_it_is_one() {
    for kind in ["allan", "noise", "statistics"] {
        let world = World::with(Setting { live: Live::taking_in(1000), ..Setting::default() });
        world.capture("a", CaptureState::Capturing, 2500);
        for (samples, caught_up) in [(1000, false), (2000, false), (2500, true), (2500, true)] {
            let answer = world.get(&format!("/v1/captures/a/{kind}")).json();
            let found = (answer["samples"].as_u64(), answer["caught_up"].as_bool(), answer["complete"].as_bool());
            assert_eq!(found, (Some(samples), Some(caught_up), Some(false)), "{kind}: {answer}");
        }
        world.store.set_state(1, CaptureState::Stopped, START_NS).unwrap();
        let path = format!("/v1/captures/a/{kind}");
        let done = eventually("the job", || world.get(&path), |answer| answer.status == 200).json();
        assert!(done.get("caught_up").is_none() && done["complete"] == true, "{kind}: {done}");
    }
}

#[test]
fn an_impossible_analysis_reports_its_reason() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 0);
    let failed = eventually("the job", || world.get("/v1/captures/a/allan"), |answer| answer.status != 202);
    assert!(failed.problem(422, "analysis-failed").contains("no samples"), "{failed:?}");
    world.get("/v1/captures/z/allan").problem(404, "not-found");
    let kalibr = world.get("/v1/captures/a/allan?format=kalibr").problem(400, "bad-request");
    assert!(kalibr.contains("allowed is json"), "{kalibr}");
    let estimators = world.get("/v1/captures/a/allan?estimator=avar").problem(400, "bad-request");
    assert!(estimators.contains("totdev"), "{estimators}");
    world.get("/v1/captures/a/allan?taus=custom").problem(400, "bad-request");
}

#[test]
fn another_estimator_has_a_job_of_its_own_and_its_curves_name_the_noise() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 2000);
    for (estimator, taus) in [("mdev", "octave"), ("totdev", "log"), ("hdev", "all"), ("oadev", "octave")] {
        let path = format!("/v1/captures/a/allan?estimator={estimator}&taus={taus}");
        let first = world.get(&path);
        if first.status == 202 {
            assert_eq!((first.header("retry-after"), &first.json()["kind"]), ("2", &"allan".into()), "{first:?}");
        }
        let done = eventually("the job", || world.get(&path), |answer| answer.status == 200);
        let report = done.json();
        assert_eq!(
            (report["estimator"].as_str(), report["samples"].as_u64()),
            (Some(estimator), Some(2000)),
            "{report}"
        );
        let curve = &report["channels"]["gyro_x"];
        let count = curve["tau_s"].as_array().unwrap().len();
        assert_eq!(curve["noise"].as_array().unwrap().len(), count, "{curve}");
        assert_eq!(count > 400, taus == "all", "{count} averaging times");
        assert_eq!(world.get_with(&path, "if-none-match", done.header("etag")).status, 304);
    }
    let jobs = world.get("/v1/jobs").json()["jobs"].as_array().unwrap().len();
    assert_eq!(jobs, 4, "asking again makes no other job");
    // The same request in a body is the same job.
    let body = r#"{"kind": "allan", "capture": "a", "estimator": "mdev", "taus": "octave"}"#;
    let again = world.post("/v1/jobs", body);
    assert_eq!(again.status, 200, "{again:?}");
    assert_eq!(world.get(again.json()["result"].as_str().unwrap()).json()["estimator"], "mdev");
    assert_eq!(world.post("/v1/jobs", r#"{"kind": "noise", "capture": "a", "estimator": "mdev"}"#).status, 400);
}

#[test]
fn while_a_capture_runs_only_the_default_estimator_answers() {
    let world = World::new();
    world.capture("a", CaptureState::Capturing, 2000);
    assert_eq!(world.get("/v1/captures/a/allan?estimator=oadev&taus=octave").status, 200);
    let refused = world.get("/v1/captures/a/allan?estimator=mdev").problem(422, "analysis-failed");
    assert!(refused.contains("still runs") && refused.contains("oadev"), "{refused}");
}

#[test]
fn captures_of_one_sensor_are_analysed_together() {
    let world = World::new();
    let a = world.capture("a", CaptureState::Complete, 2000);
    let b = world.capture("b", CaptureState::Complete, 1500);
    let body = format!(r#"{{"kind": "noise", "capture": "a", "with": [{b}]}}"#);
    let job = world.post("/v1/jobs", &body);
    assert_eq!(job.status, 202, "{job:?}");
    assert_eq!(job.json()["params"]["with"], serde_json::json!([b]));
    let by_name = world.post("/v1/jobs", r#"{"kind": "noise", "capture": "a", "with": ["latest"]}"#);
    assert_eq!((by_name.status, by_name.header("location")), (200, job.header("location")));
    let done = eventually("the job", || world.get(job.header("location")).json(), |job| job["state"] == "done");
    let report = world.get(done["result"].as_str().unwrap()).json();
    assert_eq!((report["capture"].as_str(), report["samples"].as_u64()), (Some("a + b"), Some(3500)), "{report}");
    assert_eq!((report["missing"].as_u64(), report["captures"][1]["missing"].as_u64()), (Some(8), Some(4)));
    assert_eq!(report["captures"][1]["capture"], "b");
    // The capture's own result differs.
    let own = eventually("the job", || world.get("/v1/captures/a/noise"), |answer| answer.status == 200).json();
    assert_eq!((own["samples"].as_u64(), own.get("captures")), (Some(2000), None));
    let twice = world.post("/v1/jobs", &format!(r#"{{"kind": "allan", "capture": {a}, "with": [{a}]}}"#));
    assert!(twice.problem(400, "bad-request").contains("given twice"), "{twice:?}");
    world.post("/v1/jobs", r#"{"kind": "allan", "capture": "a", "with": ["z"]}"#).problem(404, "not-found");
    world.post("/v1/jobs", r#"{"kind": "statistics", "capture": "a", "with": ["b"]}"#).problem(400, "bad-request");
}

#[test]
fn noise_parameters_are_compared_and_exported() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 4000);
    let plain = eventually("the job", || world.get("/v1/captures/a/noise"), |answer| answer.status == 200).json();
    assert!(plain["datasheet"].is_null());
    assert!(plain["disturbances"]["gyro_x"]["excluded_s"].is_number(), "{plain}");
    let compared = world.get("/v1/captures/a/noise?datasheet=vn-100").json();
    let gyro = &compared["datasheet"]["channels"]["gyro_x"]["noise_density"];
    assert_eq!(gyro["unit"], "rad/s/√Hz", "{compared}");
    assert!(gyro["predicted"].as_f64().unwrap() >= gyro["datasheet"].as_f64().unwrap());
    let kalibr = world.get("/v1/captures/a/noise?format=kalibr");
    assert_eq!((kalibr.status, kalibr.header("content-type")), (200, "application/yaml"));
    assert!(kalibr.text.contains("\ngyroscope_noise_density: "), "{}", kalibr.text);
    assert!(world.get("/v1/captures/a/noise?format=xml").problem(400, "bad-request").contains("gnss-ins-sim"));
    assert!(world.get("/v1/captures/a/noise?datasheet=vn-1").problem(400, "bad-request").contains("vn-100"));
    let both = world.get("/v1/captures/a/noise?format=kalibr&datasheet=vn-100").problem(400, "bad-request");
    assert!(both.contains("`datasheet`") && both.contains("JSON"), "{both}");
    assert_eq!(world.get("/v1/captures/a/noise?format=json&datasheet=vn-100").status, 200);
}

/// The numbers for each program are beside the parameters, for a finished and for a running capture.
#[test]
fn the_noise_parameters_show_which_number_to_paste_where() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 4000);
    world.capture("b", CaptureState::Capturing, 4000);
    for form in ["a/noise", "a/noise?datasheet=vn-100", "b/noise"] {
        let path = format!("/v1/captures/{form}");
        let paste = eventually("the job", || world.get(&path), |answer| answer.status == 200).json()["paste"].clone();
        let kalibr = paste["programs"].as_array().unwrap().iter().find(|own| own["format"] == "kalibr").unwrap();
        let white = &kalibr["values"][0];
        assert_eq!((&white["name"], &white["of"]), (&"gyroscope_noise_density".into(), &"gyro".into()), "{paste}");
        assert!(white["value"].as_f64().unwrap() > 0.0 && white["unit"] == "rad/s/√Hz", "{paste}");
        assert!(paste["note"].as_str().unwrap().contains("Published values"), "{paste}");
    }
    let page = world.get("/captures/a");
    assert!(page.text.contains("href=\"/v1/captures/1/noise?format=orb-slam3\""), "{}", page.text);
}

/// A sensor that moved all the time: no file for a program, unless it is forced.
#[test]
fn what_is_not_usable_is_refused_and_written_if_it_is_forced() {
    let world = World::new();
    let mut moving = records(4000);
    for record in &mut moving {
        if let Record::Sample { seq, sample, .. } = record {
            let i = *seq as f64;
            sample.set(Channel::GyroX, 0.3 + 0.2 * (i * 0.05).sin() + 0.1 * (i * 0.013).cos());
        }
    }
    world.capture_of("a", CaptureState::Complete, moving);
    let noise = eventually("the job", || world.get("/v1/captures/a/noise"), |answer| answer.status == 200).json();
    assert_eq!(noise["channels"]["gyro_x"]["usable"], false, "{noise}");
    let number = &noise["paste"]["programs"][0]["values"][0];
    assert!(number["value"].is_null() && number["reason"].as_str().unwrap().starts_with("gyro_x: "), "{noise}");
    for target in imu_files::export::Target::ALL {
        let path = format!("/v1/captures/a/noise?format={}", target.name());
        let refused = world.get(&path).problem(422, "analysis-failed");
        assert!(refused.contains("not at rest") && refused.contains("`force=true`"), "{refused}");
        let forced = world.get(&format!("{path}&force=true"));
        assert!(forced.status == 200 && forced.text.contains("NOT USABLE"), "{forced:?}");
    }
    let page = world.get("/captures/a").text;
    assert!(page.contains("<strong class=\"bad\">not usable: the sensor was not at rest"), "{page}");
}

#[test]
fn what_is_made_of_noise_parameters_has_a_tag_and_none_while_the_capture_runs() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 4000);
    eventually("the job", || world.get("/v1/captures/a/noise"), |answer| answer.status == 200);
    let forms = ["", "?format=kalibr", "?format=openvins", "?format=px4", "?datasheet=vn-100"];
    let mut tags = std::collections::BTreeSet::new();
    for form in forms {
        let path = format!("/v1/captures/a/noise{form}");
        let first = world.get(&path);
        let tag = first.header("etag").to_owned();
        assert_eq!((first.status, first.header("cache-control")), (200, "no-cache"), "{form}");
        assert!(tag.len() > 4 && tag.starts_with("W/\"") && tag.ends_with('"'), "{form}: {tag}");
        let again = world.get_with(&path, "if-none-match", &tag);
        assert_eq!((again.status, again.text.as_str(), again.header("etag")), (304, "", tag.as_str()), "{form}");
        assert_eq!((first.header("vary"), again.header("vary")), ("accept-encoding", "accept-encoding"), "{form}");
        tags.insert(tag);
    }
    assert_eq!(tags.len(), forms.len(), "a tag names one form: {tags:?}");
    world.capture("b", CaptureState::Capturing, 4000);
    for form in forms {
        let open = world.get(&format!("/v1/captures/b/noise{form}"));
        assert_eq!((open.status, open.header("cache-control"), open.header("etag")), (200, "no-store", ""), "{form}");
    }
}

#[test]
fn the_same_job_is_made_once() {
    let world = World::new();
    let id = world.capture("a", CaptureState::Complete, 2000);
    let submit = |body: &str| world.post("/v1/jobs", body);
    let first = submit(&format!(r#"{{"kind": "allan", "capture": {id}}}"#));
    assert_eq!(first.status, 202, "{first:?}");
    let location = first.header("location").to_owned();
    assert_eq!(location, format!("/v1/jobs/{}", first.json()["id"]));
    for same in [r#"{"kind": "allan", "capture": "latest"}"#, r#"{"capture": "a", "taus": "log", "kind": "allan"}"#] {
        let again = submit(same);
        assert_eq!((again.status, again.header("location")), (200, location.as_str()), "{same}");
    }
    let other = submit(r#"{"kind": "allan", "capture": "a", "channels": ["gyro_x"], "taus": "octave"}"#);
    assert_eq!(other.status, 202);
    assert_ne!(other.header("location"), location);
    let done = eventually("the job", || world.get(other.header("location")).json(), |job| job["state"] == "done");
    assert_eq!(done["progress"], 1.0);
    let result = world.get(done["result"].as_str().unwrap());
    assert_eq!((result.status, result.json()["format"].as_str()), (200, Some("vn100d-allan-1")));
    let usual = eventually("the job", || world.get("/v1/captures/a/allan"), |answer| answer.status == 200);
    assert_ne!(usual.text, result.text, "a job with other parameters is not the capture's analysis");
}

#[test]
fn fifty_identical_submissions_at_once_make_one_job() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 2000);
    let statuses: Vec<u16> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..50)
            .map(|_| scope.spawn(|| world.post("/v1/jobs", r#"{"kind": "allan", "capture": "a"}"#).status))
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(statuses.iter().filter(|status| **status == 202).count(), 1, "{statuses:?}");
    assert_eq!(statuses.iter().filter(|status| **status == 200).count(), 49, "{statuses:?}");
    assert_eq!(world.get("/v1/jobs").json()["jobs"].as_array().unwrap().len(), 1);
}

#[test]
fn a_job_that_makes_no_sense_is_refused() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    for (body, detail) in [
        ("", "the body is empty"),
        ("{}", "missing field `kind`"),
        (r#"{"kind": "alan", "capture": 1}"#, "allan"),
        (r#"{"kind": "allan"}"#, "missing field `capture`"),
        (r#"{"kind": "allan", "capture": 1, "tau": 1}"#, "unknown field `tau`"),
        (r#"{"kind": "allan", "capture": 1, "taus": "custom"}"#, "taus"),
        (r#"{"kind": "allan", "capture": null}"#, "capture"),
    ] {
        let found = world.post("/v1/jobs", body).problem(400, "bad-request");
        assert!(found.contains(detail), "{body}: {found}");
    }
    world.post("/v1/jobs", r#"{"kind": "allan", "capture": 9}"#).problem(404, "not-found");
    world.get("/v1/jobs/9").problem(404, "not-found");
    world.get("/v1/jobs/x").problem(400, "bad-request");
    world.get("/v1/jobs?capture=nobody").problem(404, "not-found");
    world.delete("/v1/jobs/9").problem(404, "not-found");
    world.get("/v1/captures/a/allan?job=9").problem(404, "not-found");
}

#[test]
fn a_job_that_has_ended_is_not_cancelled() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 2000);
    world.post("/v1/jobs", r#"{"kind": "allan", "capture": "a"}"#);
    eventually("the job", || world.get("/v1/jobs/1").json(), |job| job["state"] == "done");
    assert_eq!(world.get("/v1/jobs?state=done&capture=a").json()["jobs"][0]["id"], 1);
    assert!(world.delete("/v1/jobs/1").problem(409, "conflict").contains("done"));
}

#[test]
fn a_queued_job_is_cancelled() {
    let world = World::new();
    world.jobs.stop();
    world.capture("a", CaptureState::Complete, 2000);
    let submitted = world.post("/v1/jobs", r#"{"kind": "allan", "capture": "a"}"#);
    assert_eq!((submitted.status, submitted.header("retry-after")), (202, "2"));
    let cancelled = world.delete(submitted.header("location"));
    assert_eq!((cancelled.status, cancelled.json()["state"].as_str()), (200, Some("cancelled")));
    let repeated = world.get("/v1/captures/a/allan");
    assert_eq!(repeated.status, 202, "whoever asks for the result gets a new job");
    assert_ne!(repeated.header("location"), submitted.header("location"));
}

#[test]
fn a_picture_has_a_tag_that_names_the_results_it_is_drawn_of() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 4000);
    let ask = |path: &str| {
        eventually("the job", || world.get(&format!("/v1/captures/a/{path}")), |answer| answer.status == 200)
    };
    let result = ask("statistics")
        .header("etag")
        .trim_start_matches("W/")
        .trim_matches('"')
        .split('-')
        .next()
        .unwrap()
        .to_owned();
    let picture = ask("plots/histogram-gyro_x.svg");
    let tag = picture.header("etag");
    assert!(tag.contains(&format!("-Some-{result}-")), "{tag} names not {result}");
    assert_eq!(world.get_with("/v1/captures/a/plots/histogram-gyro_x.svg", "if-none-match", tag).status, 304);
    let of_samples = ask("plots/timeseries-gyro_x.svg");
    assert!(!of_samples.header("etag").contains("Some") && of_samples.text.contains("<svg"), "{of_samples:?}");
    let part = ask("plots/timeseries-gyro_x.svg?from=1&to=2");
    assert_ne!(part.header("etag"), of_samples.header("etag"));
    world.capture("b", CaptureState::Capturing, 4000);
    assert_eq!(world.get("/v1/captures/b/plots/gaps.svg").header("etag"), "", "what grows has no tag");
}
