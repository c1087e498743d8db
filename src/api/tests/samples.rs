//! Samples: ranges, forms, decimation, refusals.

use super::*;

#[test]
fn samples_are_timed_by_the_sensor_s_clock() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    let answer = world.get("/v1/captures/a/samples");
    assert_eq!((answer.status, answer.header("content-type")), (200, "application/json"));
    let body = answer.json();
    assert_eq!(body["origin"], "2027-01-15T08:00:00.000000000Z");
    assert_eq!(body["columns"], serde_json::json!(["time_s", "gyro_x", "temperature"]));
    assert_eq!(body["units"], serde_json::json!(["s", "rad/s", "°C"]));
    assert_eq!((body["range_samples"].as_u64(), body["samples_per_row"].as_u64()), (Some(120), Some(1)));
    let rows = body["samples"].as_array().unwrap();
    assert_eq!(rows.len(), 120);
    assert_eq!(rows[1], serde_json::json!([0.025, 0.000268, 21.5]));
    assert!(rows[2][2].is_null(), "an absent value is null");
    assert_eq!((rows[99][0].as_f64(), rows[100][0].as_f64()), (Some(2.475), Some(2.6)), "the gap is four periods");
}

#[test]
fn samples_exist_as_csv_and_ndjson() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    let csv = world.get("/v1/captures/a/samples?format=csv&channels=gyro_x");
    assert_eq!(csv.header("content-type"), "text/csv");
    let lines: Vec<&str> = csv.text.lines().collect();
    assert_eq!((lines.len(), lines[0], lines[2]), (121, "time_s,gyro_x_rad_s", "0.025,0.000268"));
    assert_eq!(world.get_with("/v1/captures/a/samples?channels=gyro_x", "accept", "text/csv").text, csv.text);
    let lines = world.get_with("/v1/captures/a/samples", "accept", "application/x-ndjson").text;
    let rows: Vec<serde_json::Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(
        (rows.len(), &rows[2]),
        (120, &serde_json::json!({"time_s": 0.05, "gyro_x": 369.0 * 1e-6, "temperature": null}))
    );
    world.get_with("/v1/captures/a/samples", "accept", "image/png").problem(406, "not-acceptable");
}

#[test]
fn a_range_is_by_time_from_the_start_inclusive_to_the_end_exclusive() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    for (query, samples) in [
        ("from=0&to=1", 40),
        ("from=1", 80),
        ("to=0", 0),
        ("from=2.5&to=2.55", 0),
        ("from=1000", 0),
        ("from=2&to=1", 0),
        ("from=2027-01-15T08:00:01Z&to=2027-01-15T09:00:02%2B01:00", 40),
        ("from=1970-01-01T00:00:00Z&to=2200-01-01T00:00:00Z", 120),
    ] {
        let body = world.get(&format!("/v1/captures/a/samples?{query}")).json();
        assert_eq!(body["range_samples"], samples, "{query}");
        assert_eq!(body["samples"].as_array().unwrap().len(), samples, "{query}");
    }
}

#[test]
fn many_samples_become_minima_and_maxima() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 20_000);
    let all = world.get("/v1/captures/a/samples?channels=gyro_x").json();
    let values: Vec<f64> = all["samples"].as_array().unwrap().iter().map(|row| row[1].as_f64().unwrap()).collect();
    let few = world.get("/v1/captures/a/samples?channels=gyro_x&max_points=150").json();
    assert_eq!(few["columns"], serde_json::json!(["time_s", "gyro_x_min", "gyro_x_max"]));
    assert_eq!((few["range_samples"].as_u64(), few["samples_per_row"].as_u64()), (Some(20_000), Some(134)));
    let rows = few["samples"].as_array().unwrap();
    assert_eq!(rows.len(), 150);
    for (row, part) in rows.iter().zip(values.chunks(134)) {
        let low = part.iter().copied().fold(f64::INFINITY, f64::min);
        let high = part.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        assert_eq!((row[1].as_f64(), row[2].as_f64()), (Some(low), Some(high)));
    }
    let enough = world.get("/v1/captures/a/samples?channels=gyro_x&max_points=20000").json();
    assert_eq!(enough["samples_per_row"], 1);
}

#[test]
fn a_request_for_samples_that_makes_no_sense_is_refused() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    for (query, detail) in [
        ("channels=gyro", "there is no `gyro`"),
        ("channels=", "there is no ``"),
        ("channels=pressure", "the capture has no `pressure`: it has gyro_x, temperature"),
        ("from=-1", "is no time"),
        ("from=NaN", "is no time"),
        ("to=1e300", "is no time"),
        ("from=yesterday", "is no time"),
        ("max_points=0", "allowed is 1 to 100000"),
        ("max_points=1000000000", "allowed is 1 to 100000"),
        ("max_points=1.5", "max_points"),
        ("format=xml", "allowed are json, csv, ndjson"),
        ("chanels=gyro_x", "unknown field `chanels`"),
    ] {
        let found = world.get(&format!("/v1/captures/a/samples?{query}")).problem(400, "bad-request");
        assert!(found.contains(detail), "{query}: {found}");
    }
    world.get("/v1/captures/b/samples").problem(404, "not-found");
}

#[test]
fn an_empty_capture_has_no_samples() {
    let world = World::new();
    world.capture("a", CaptureState::Waiting, 0);
    let body = world.get("/v1/captures/a/samples").json();
    assert_eq!((body["range_samples"].as_u64(), &body["samples"]), (Some(0), &serde_json::json!([])));
}

/// Returns a capture whose first segment has no device time, and whose second segment has the host's clock stepped back
/// by an hour.
fn two_timebases(world: &World) -> i64 {
    let id = world.store.create_capture(NewCapture::new("test", CaptureState::Complete)).unwrap();
    let send = |record| world.store.records().blocking_send(id, record).unwrap();
    for (number, timebase) in [(1_u32, Timebase::Arrival), (2, Timebase::Device)] {
        let first_seq = u64::from(number - 1) * 40;
        // The sensor had run for 1000 s when it began to send its time.
        let device_ns = 1_000_000_000_000;
        send(Record::Segment(Segment {
            number,
            epoch: 1,
            first_seq,
            rate_hz: 40.0,
            timebase,
            channels: [Channel::GyroX].into_iter().collect(),
            first_device_time_ns: (timebase == Timebase::Device).then_some(device_ns),
            first_utc_ns: START_NS + (first_seq * PERIOD_NS) as i64,
            boot_id: None,
        }));
        for seq in first_seq..first_seq + 40 {
            let stepped_ns = if seq < 60 { 0 } else { -3_600_000_000_000 };
            let mut sample = Sample::at(seq * PERIOD_NS, START_NS + (seq * PERIOD_NS) as i64 + stepped_ns);
            if timebase == Timebase::Device {
                sample.device_time_ns = Some(device_ns + (seq - first_seq) * PERIOD_NS);
            }
            sample.set(Channel::GyroX, seq as f64);
            send(Record::Sample { seq, segment: number, sample });
        }
    }
    world.store.flush_blocking().unwrap();
    id
}

#[test]
fn time_goes_on_where_the_sensor_begins_to_send_it_and_a_stepped_clock_moves_nothing() {
    let world = World::new();
    let id = two_timebases(&world);
    let body = world.get(&format!("/v1/captures/{id}/samples")).json();
    let rows = body["samples"].as_array().unwrap();
    assert_eq!(rows.len(), 80);
    for (seq, row) in rows.iter().enumerate() {
        assert!((row[0].as_f64().unwrap() - seq as f64 * 0.025).abs() < 1e-9, "sample {seq}: {row}");
        assert_eq!(row[1].as_f64(), Some(seq as f64), "sample {seq}: {row}");
    }
    // The selection is that of `time_s`, by seconds and by civil time.
    for query in ["from=0.5&to=1.75", "from=2027-01-15T08:00:00.5Z&to=2027-01-15T08:00:01.75Z"] {
        let rows = world.get(&format!("/v1/captures/{id}/samples?{query}")).json()["samples"].clone();
        let seqs: Vec<f64> = rows.as_array().unwrap().iter().map(|row| row[1].as_f64().unwrap()).collect();
        assert_eq!(seqs, (20..70).map(f64::from).collect::<Vec<_>>(), "{query}");
    }
}
