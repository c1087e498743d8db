//! Background work that is interrupted, starved or given invalid input (rows F1 to F10).

use crate::audit::lines_with;
use crate::http::memory;
use crate::tools::scaled;
use crate::world::{Process, World};
use imu_core::sample::{Channel, Gap, GapCause, Record, Sample, Segment, Timebase};
use rusqlite::types::Value;
use serde_json::json;
use std::path::Path;
use std::time::Duration;
use vn100d::store::{CaptureState, NewCapture, Store, StoreOptions};

const START_NS: i64 = 1_800_000_000_000_000_000;
const SIX: [Channel; 6] =
    [Channel::AccelX, Channel::AccelY, Channel::AccelZ, Channel::GyroX, Channel::GyroY, Channel::GyroZ];
/// Number of samples of a job's chunk.
const CHUNK: u64 = vn100d::jobs::CHUNK as u64;

/// A stretch of samples at one rate, after `missing` missing samples.
pub struct Stretch {
    pub samples: u64,
    pub rate_hz: f64,
    pub missing: u64,
    pub cause: GapCause,
    /// Whether the sensor's clock restarts.
    pub reset: bool,
}

/// Returns white noise around 0 in ±0.005, the same for the same place.
pub fn noise(seq: u64, channel: Channel) -> f64 {
    let mut state = (seq + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ ((channel as u64 + 1) << 32);
    state ^= state >> 29;
    state = state.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((state >> 40) as f64 / f64::from(1 << 24) - 0.5) * 0.01
}

/// Returns one stretch of this many samples at 40 Hz.
pub fn plain(samples: u64) -> Vec<Stretch> {
    vec![Stretch { samples, rate_hz: 40.0, missing: 0, cause: GapCause::Checksum, reset: false }]
}

/// Makes a capture in the world's database, before a daemon opens it; returns its id.
pub fn fill(
    world: &World,
    name: &str,
    channels: &[Channel],
    stretches: &[Stretch],
    value: impl Fn(u64, Channel) -> f64,
) -> i64 {
    // A process that another test is just starting has this one's locks for a moment.
    let open = || Store::open(&world.database(), StoreOptions::default());
    let store = (0..20).find_map(|_| open().map_err(|_| std::thread::sleep(Duration::from_millis(50))).ok());
    let store = store.unwrap_or_else(|| open().unwrap());
    let mut capture = NewCapture::new("test", CaptureState::Imported);
    capture.name = Some(name.to_owned());
    let mut import = store.begin_import(capture, None).unwrap();
    let (mut seq, mut device_ns, mut utc_ns, mut epoch) = (0, 0_u64, START_NS, 1);
    for (number, stretch) in (1..).zip(stretches) {
        let period_ns = (1e9 / stretch.rate_hz) as u64;
        let before = (device_ns, utc_ns);
        if number > 1 {
            utc_ns += (stretch.missing * period_ns) as i64;
            device_ns = if stretch.reset { 0 } else { device_ns + stretch.missing * period_ns };
            epoch += u32::from(stretch.reset);
            import
                .push(Record::Gap(Gap {
                    before_seq: seq,
                    from_utc_ns: before.1,
                    to_utc_ns: utc_ns,
                    device_ns: (!stretch.reset).then_some((before.0, device_ns)),
                    missing: stretch.missing,
                    missing_exact: !stretch.reset,
                    cause: stretch.cause,
                }))
                .unwrap();
        }
        import
            .push(Record::Segment(Segment {
                number,
                epoch,
                first_seq: seq,
                rate_hz: stretch.rate_hz,
                timebase: Timebase::Device,
                channels: channels.iter().copied().collect(),
                first_device_time_ns: Some(device_ns),
                first_utc_ns: utc_ns,
                boot_id: None,
            }))
            .unwrap();
        for _ in 0..stretch.samples {
            let mut sample = Sample::at(device_ns, utc_ns);
            sample.device_time_ns = Some(device_ns);
            for channel in channels {
                let value = value(seq, *channel);
                if value.is_finite() {
                    sample.set(*channel, value);
                }
            }
            import.push(Record::Sample { seq, segment: number, sample }).unwrap();
            seq += 1;
            device_ns += period_ns;
            utc_ns += period_ns as i64;
        }
    }
    let id = import.finish(Some(utc_ns)).unwrap().id();
    store.close().unwrap();
    id
}

/// Checks at the end of every test that the file is sound and its counters agree with its rows.
pub fn settle(world: &World) {
    assert_eq!(world.query("PRAGMA integrity_check"), [[Value::Text("ok".to_owned())]]);
    let wrong = world.query(
        "SELECT id FROM capture WHERE lifecycle = 'live' AND (samples <> (SELECT count(*) FROM sample WHERE capture_id = \
         capture.id) OR missing <> (SELECT coalesce(sum(missing), 0) FROM gap WHERE capture_id = capture.id))",
    );
    assert!(wrong.is_empty(), "counters and rows differ: {wrong:?}");
}

/// Submits a job and returns its id.
fn submit(world: &World, body: &serde_json::Value) -> i64 {
    let (status, text) = world.request("POST", "/v1/jobs", &body.to_string()).unwrap();
    assert!(status == 202 || status == 200, "{status} {text}");
    serde_json::from_str::<serde_json::Value>(&text).unwrap()["id"].as_i64().unwrap()
}

/// Submits a diagnosis and returns its id.
fn diagnose(world: &World, capture: i64, wanted: &serde_json::Value) -> i64 {
    let route = format!("/v1/captures/{capture}/diagnoses");
    let (status, text) = world.request("POST", &route, &wanted.to_string()).unwrap();
    assert_eq!(status, 202, "{text}");
    serde_json::from_str::<serde_json::Value>(&text).unwrap()["id"].as_i64().unwrap()
}

/// Waits for the job's end and returns the job.
fn ended(world: &World, job: i64, daemon: &Process) -> serde_json::Value {
    let over = || {
        world
            .try_get(&format!("/v1/jobs/{job}"))
            .filter(|job| ["done", "failed", "cancelled"].contains(&job["state"].as_str().unwrap()))
    };
    world.until("the job ends", Duration::from_secs(120), over, daemon)
}

/// Returns the result's bytes as they are stored.
fn body(world: &World, job: i64) -> String {
    let rows = world.query(&format!("SELECT body FROM result WHERE job_id = {job}"));
    match &rows[..] {
        [row] => match &row[0] {
            Value::Text(text) => text.clone(),
            other => panic!("{other:?}"),
        },
        other => panic!("{} results", other.len()),
    }
}

fn progress(world: &World, job: i64) -> Option<f64> {
    world.try_get(&format!("/v1/jobs/{job}"))?["progress"].as_f64()
}

/// Returns a copy of the world's database without a daemon.
fn copy(world: &World) -> World {
    let other = World::new();
    std::fs::create_dir_all(other.path("data")).unwrap();
    std::fs::copy(world.database(), other.database()).unwrap();
    assert!(!Path::new(&format!("{}-wal", world.database().display())).exists(), "the log was not emptied");
    other
}

/// Returns the bytes of this job's result if nothing interrupts it.
fn uninterrupted(world: &World, wanted: &serde_json::Value) -> String {
    let world = copy(world);
    let daemon = world.daemon("", &[]);
    let job = submit(&world, wanted);
    assert_eq!(ended(&world, job, &daemon)["state"], "done");
    body(&world, job)
}

/// Row F1.
#[test]
fn a_job_killed_at_four_fifths_goes_on_there_and_comes_to_the_same_bytes() {
    let world = World::new();
    let samples = scaled(6 * CHUNK, 12 * 3600 * 40);
    let capture = fill(&world, "night", &SIX, &plain(samples), noise);
    let wanted = json!({"kind": "noise", "capture": capture});
    let whole = uninterrupted(&world, &wanted);
    let mut daemon = world.daemon("", &[]);
    let job = submit(&world, &wanted);
    let far = || progress(&world, job).filter(|progress| *progress >= 0.8);
    let before = world.until("four fifths are done", Duration::from_secs(120), far, &daemon);
    daemon.kill();
    assert!(before < 1.0, "it was killed before its end");
    let daemon = world.daemon("", &[]);
    let after = progress(&world, job).unwrap();
    eprintln!("F1: killed at {before:.4}, went on at {after:.4}");
    assert!(after >= 0.79 && after >= before - 0.01, "it went on at {after}, killed at {before}");
    let mut last = after;
    loop {
        let job = world.get(&format!("/v1/jobs/{job}"));
        let now = job["progress"].as_f64().unwrap();
        assert!(now >= last - 0.01, "progress went back from {last} to {now}");
        last = now;
        if job["state"] == "done" {
            break;
        }
        assert_ne!(job["state"], "failed", "{job}");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(body(&world, job) == whole, "the result differs from that of the uninterrupted run");
    drop(daemon);
    settle(&world);
}

/// Row F2.
#[test]
fn a_job_killed_after_any_chunk_comes_to_the_same_bytes() {
    let made = World::new();
    let chunks = scaled(4, 12);
    // The last chunk is a short one, and a gap lies across a boundary.
    let mut stretches = plain(2 * CHUNK - 500);
    stretches.push(Stretch {
        samples: (chunks - 2) * CHUNK - 300,
        rate_hz: 40.0,
        missing: 80,
        cause: GapCause::Unplugged,
        reset: false,
    });
    let capture = fill(&made, "night", &[Channel::GyroX, Channel::AccelZ], &stretches, noise);
    for kind in scaled(&["allan"][..], &["allan", "noise", "statistics"][..]) {
        let wanted = json!({"kind": kind, "capture": capture});
        let whole = {
            let world = copy(&made);
            let daemon = world.daemon("", &[]);
            let job = submit(&world, &wanted);
            assert_eq!(ended(&world, job, &daemon)["state"], "done");
            body(&world, job)
        };
        for n in 1..=chunks {
            let world = copy(&made);
            let mut daemon = world.daemon("", &[]);
            let job = submit(&world, &wanted);
            let at_boundary = || {
                let of = format!("SELECT next_seq FROM job_checkpoint WHERE job_id = {job}");
                let done = world.query(&format!("SELECT 1 FROM job WHERE id = {job} AND state = 'done'"));
                let reached = world.query(&of).first().and_then(|row| match row[0] {
                    Value::Integer(seq) => Some(seq as u64),
                    _ => None,
                });
                (reached.is_some_and(|seq| seq.div_ceil(CHUNK) >= n) || !done.is_empty()).then_some(())
            };
            world.until("the chunk is done", Duration::from_secs(60), at_boundary, &daemon);
            daemon.kill();
            let daemon = world.daemon("", &[]);
            assert_eq!(ended(&world, job, &daemon)["state"], "done");
            assert!(body(&world, job) == whole, "{kind}: killed after chunk {n} of {chunks} the result differs");
            drop(daemon);
            settle(&world);
        }
    }
}

/// Row F3.
#[test]
fn a_job_over_a_running_capture_takes_in_what_was_there_and_states_it() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let daemon = world.daemon("[sensor]\nrate-hz = 160\n", &["--capture", "60s"]);
    let some = || {
        world
            .try_get("/v1/captures/latest")
            .and_then(|capture| capture["samples"].as_u64())
            .filter(|samples| *samples > 300)
    };
    world.until("samples", Duration::from_secs(15), some, &daemon);
    let job = submit(&world, &json!({"kind": "allan", "capture": "latest"}));
    let row = ended(&world, job, &daemon);
    let end_seq = row["end_seq"].as_u64().unwrap();
    let result: serde_json::Value = serde_json::from_str(&body(&world, job)).unwrap();
    assert_eq!(result["samples"], end_seq, "the result names its input");
    assert_eq!(result["complete"], false);
    // One stretch: at the shortest averaging time every sample but the first makes a term.
    assert_eq!(result["channels"]["gyro_x"]["n"][0].as_u64().unwrap(), end_seq - 1);
    let more = || {
        world
            .try_get("/v1/captures/latest")
            .and_then(|capture| capture["samples"].as_u64())
            .filter(|samples| *samples > end_seq)
    };
    world.until("the capture grows", Duration::from_secs(15), more, &daemon);
    assert_eq!(world.get(&format!("/v1/jobs/{job}"))["end_seq"], end_seq, "the input stays what it was");
    let live = world.get("/v1/captures/latest/allan");
    assert_eq!((live["caught_up"].as_bool(), live["complete"].as_bool()), (Some(true), Some(false)), "{live}");
    drop(daemon);
    settle(&world);
}

/// Returns how many of the reader's wakes were at most `late_s` late, and how many there were.
pub fn wakes(world: &World, late_s: &str) -> (f64, f64) {
    let text = world.request("GET", "/metrics", "").unwrap().1;
    let value = |name: &str| {
        let line = text.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("{name} in {text}"));
        line.rsplit(' ').next().unwrap().parse::<f64>().unwrap()
    };
    let in_time = value(&format!("vn100d_reader_wake_seconds_bucket{{le=\"{late_s}\"}}"));
    (in_time, value("vn100d_reader_wake_seconds_count"))
}

/// Row F4.
#[test]
fn two_jobs_beside_a_capture_at_800_hz_cost_it_nothing() {
    let world = World::new();
    let capture = fill(&world, "night", &SIX, &plain(scaled(400_000, 2_000_000)), noise);
    let _sensor = world.emulate(&["--baud", "921600"]);
    let daemon = world.daemon("[sensor]\nrate-hz = 800\nbaud = 921600\n", &["--capture", "1h"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(800));
    world.until("samples at 800 Hz", Duration::from_secs(20), some, &daemon);
    // Other work on this machine is not the jobs' fault: one of three rounds must succeed.
    let mut shares = Vec::new();
    // Resubmitted jobs would be the same jobs: each pair has separate channels.
    let mut sets = (2..=SIX.len()).rev().flat_map(|count| SIX.windows(count));
    for _ in 0..3 {
        let before = wakes(&world, "0.02");
        let mut after = before;
        // On a fast machine a pair of jobs is over before any wake is counted.
        while after.1 - before.1 < 50.0 {
            let channels = sets.next().unwrap();
            let names: Vec<&str> = channels.iter().map(|channel| channel.name()).collect();
            let jobs = ["noise", "allan"]
                .map(|kind| submit(&world, &json!({"kind": kind, "capture": capture, "channels": names})));
            for job in jobs {
                assert_eq!(ended(&world, job, &daemon)["state"], "done");
            }
            after = wakes(&world, "0.02");
        }
        let (in_time, all) = (after.0 - before.0, after.1 - before.1);
        eprintln!("F4: {:.2} % of {all} wakes were at most 20 ms late", 100.0 * in_time / all);
        shares.push(in_time / all);
        if in_time / all >= 0.99 {
            break;
        }
    }
    assert!(shares.iter().any(|share| *share >= 0.99), "shares of wakes at most 20 ms late: {shares:?}");
    let running = world.get("/v1/status");
    assert_eq!(running["capture"]["missing"], 0, "{running}");
    assert_eq!(running["capture"]["gaps"], 0, "{running}");
    let nice = threads_nice(daemon.id(), "jobs-");
    assert_eq!(nice, ["10"], "the worker's priority");
    drop(daemon);
    settle(&world);
}

/// Returns the nice values of the process's threads of that name.
fn threads_nice(pid: u32, name: &str) -> Vec<String> {
    let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap().flatten();
    let stats = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("stat")).ok());
    let named = stats.filter(|stat| stat.contains(&format!("({name}")));
    // proc(5): field 19 is nice; the name may hold spaces and ends with the last parenthesis.
    named.map(|stat| stat.rsplit(") ").next().unwrap().split(' ').nth(16).unwrap().to_owned()).collect()
}

/// Returns the processes that the daemon has started.
pub fn children(daemon: u32) -> Vec<u32> {
    let tasks = std::fs::read_dir(format!("/proc/{daemon}/task")).unwrap().flatten();
    let lists = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("children")).ok());
    lists.flat_map(|list| list.split_whitespace().map(|pid| pid.parse().unwrap()).collect::<Vec<_>>()).collect()
}

/// Returns the process in which the daemon works on a job.
fn worker(daemon: &Process) -> Option<u32> {
    let is_worker = |pid: &u32| {
        std::fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| line.starts_with(b"vn100d\0worker\0"))
    };
    children(daemon.id()).into_iter().find(is_worker)
}

/// Returns a model with only white noise: `n` is N of each channel.
pub fn model(channels: &[Channel], rate_hz: f64, n: f64) -> serde_json::Value {
    let channels: serde_json::Map<_, _> = channels.iter().map(|of| (of.name().to_owned(), json!({"N": n}))).collect();
    json!({"format": "vn100d-sensor-model-1", "name": "m", "rate_hz": rate_hz, "channels": channels})
}

/// Row F8: a worker that is killed, for lack of memory or by hand, costs only the job's time. A daemon that is killed
/// takes its worker with it, which does not count as an attempt.
#[test]
fn a_killed_worker_costs_a_start_three_fail_the_job_and_killed_daemons_none() {
    let world = World::new();
    let capture = fill(&world, "night", &SIX, &plain(scaled(12 * CHUNK, 12 * 3600 * 40)), noise);
    let wanted = json!({"kind": "noise", "capture": capture});
    let whole = uninterrupted(&world, &wanted);
    let compared = json!({"kind": "diagnosis", "capture": capture, "sim": model(&SIX, 40.0, 2e-3)});
    let diagnosis = uninterrupted(&world, &compared);
    let mut job = 0;
    for killed in 0..5 {
        let mut daemon = world.daemon("", &[]);
        job = submit(&world, &wanted);
        let pid = world.until("a worker", Duration::from_secs(20), || worker(&daemon), &daemon);
        let limits = std::fs::read_to_string(format!("/proc/{pid}/limits")).unwrap();
        if killed == 0 {
            let data = limits.lines().find(|line| line.starts_with("Max data size")).unwrap();
            assert!(data.contains(&vn100d::jobs::JOB_MEMORY_BYTES.to_string()), "{data}");
            assert_eq!(threads_nice(pid, "vn100d"), ["10"]);
            assert_eq!(std::fs::read_to_string(format!("/proc/{pid}/oom_score_adj")).unwrap().trim(), "900");
        }
        daemon.kill();
        let gone = || (!Path::new(&format!("/proc/{pid}")).exists()).then_some(());
        world.until("the worker ends with its daemon", Duration::from_secs(5), gone, &daemon);
    }
    let daemon = world.daemon("", &[]);
    let kill = |before: Option<u32>| {
        let next = || worker(&daemon).filter(|pid| Some(*pid) != before);
        let pid = world.until("a worker", Duration::from_secs(20), next, &daemon);
        let raw = rustix::process::Pid::from_raw(pid as i32).unwrap();
        rustix::process::kill_process(raw, rustix::process::Signal::KILL).unwrap();
        pid
    };
    let first = kill(None);
    assert_eq!(world.get(&format!("/v1/jobs/{job}"))["error"], serde_json::Value::Null);
    kill(Some(first));
    assert_eq!(ended(&world, job, &daemon)["state"], "done", "two killed workers are two starts more");
    assert!(body(&world, job) == whole, "the result differs from that of the uninterrupted run");
    // With a checkpoint before each kill, a diagnosis goes on.
    let job = submit(&world, &compared);
    let mut last = None;
    let mut kept = Vec::new();
    for _ in 0..6 {
        let further = || {
            let rows = world.query(&format!("SELECT state FROM job_checkpoint WHERE job_id = {job}"));
            rows.into_iter().next().filter(|state| *state != kept)
        };
        kept = world.until("another checkpoint", Duration::from_secs(60), further, &daemon);
        last = Some(kill(last));
    }
    assert_eq!(ended(&world, job, &daemon)["state"], "done", "{}", daemon.log());
    assert!(body(&world, job) == diagnosis, "the result differs from that of the uninterrupted run");
    // Three in a row, before the first checkpoint, fail a diagnosis.
    let job = diagnose(&world, capture, &json!({"sim": model(&[Channel::GyroX], 40.0, 1e-3)}));
    for _ in 0..3 {
        last = Some(kill(last));
    }
    let row = ended(&world, job, &daemon);
    assert_eq!(
        (&row["state"], &row["error"]),
        (&"failed".into(), &"tried 3 times: its process ended by signal 9".into())
    );
    drop(daemon);
    settle(&world);
}

/// Row F9: a job that takes too long. Its process is given 1 s of processor time instead of six hours.
#[test]
fn a_job_beyond_its_processor_time_is_failed_at_once_and_the_next_one_is_done() {
    let world = World::new();
    // Reading it and the first turn of the search take longer: a job that has made a checkpoint would go on.
    let night = fill(&world, "night", &SIX, &plain(800_000), noise);
    fill(&world, "short", &SIX, &plain(2000), noise);
    let mut daemon = world.daemon("", &[]);
    let first = diagnose(&world, night, &json!({"sim": model(&SIX, 40.0, 1e-4)}));
    let next = submit(&world, &json!({"kind": "allan", "capture": "short"}));
    let pid = world.until("a worker", Duration::from_secs(20), || worker(&daemon), &daemon);
    // The process has its name before it has its limits: it sets them itself.
    let most_s = vn100d::jobs::JOB_PROCESSOR_S.to_string();
    let limited = || {
        let limits = std::fs::read_to_string(format!("/proc/{pid}/limits")).ok()?;
        limits.lines().find(|line| line.starts_with("Max cpu time"))?.contains(&most_s).then_some(())
    };
    world.until("its limit of processor time", Duration::from_secs(10), limited, &daemon);
    let process = rustix::process::Pid::from_raw(pid as i32);
    let less = rustix::process::Rlimit { current: Some(1), maximum: Some(10) };
    rustix::process::prlimit(process, rustix::process::Resource::Cpu, less).unwrap();
    let failed = ended(&world, first, &daemon);
    assert_eq!(failed["state"], "failed", "{failed}");
    assert!(failed["error"].as_str().unwrap().contains("all the processor time"), "{failed}");
    assert_eq!(lines_with(&daemon.log(), &["A job failed"]), 1, "tried once: {}", daemon.log());
    assert_eq!(ended(&world, next, &daemon)["state"], "done");
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    drop(daemon);
    settle(&world);
}

/// Row F10: references of the largest accepted size: many short rows, which take the most memory.
#[test]
fn the_largest_reference_costs_the_daemon_little_memory_and_is_kept_once() {
    let rows = scaled(500_000, 1_500_000);
    let world = World::new();
    let night = fill(&world, "night", &SIX, &plain(2000), noise);
    let long = fill(&world, "long", &SIX, &plain(300_000), noise);
    let mut daemon = world.daemon("", &[]);
    // A waiting job keeps its reference; a failed job does not.
    let first = diagnose(&world, long, &json!({"sim": model(&SIX, 40.0, 1e-4)}));
    let pid = world.until("a worker", Duration::from_secs(20), || worker(&daemon), &daemon);
    let pid = rustix::process::Pid::from_raw(pid as i32).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::STOP).unwrap();
    let head = "time_s,ref_gyro_x_rad_s,ref_gyro_y_rad_s,ref_gyro_z_rad_s,ref_accel_x_m_s2,ref_accel_y_m_s2,ref_accel_z_m_s2\n";
    let text: String = (0..rows).fold(head.to_owned(), |text, row| text + &format!("{row},0,0,0,0,0,1\n"));
    let jobs = [&SIX[..], &SIX[..3]]
        .map(|channels| diagnose(&world, night, &json!({"sim": model(channels, 40.0, 1e-4), "reference": text})));
    let kept = "SELECT count(*), sum(bytes) FROM reference";
    assert_eq!(world.query(kept)[0], [Value::Integer(1), Value::Integer(text.len() as i64)]);
    let most = memory(daemon.id(), "VmHWM");
    println!("F10: {} MiB of text, the daemon at most {} MiB", text.len() >> 20, most >> 20);
    let allowed = if cfg!(debug_assertions) { 128 << 20 } else { 64 << 20 };
    assert!(most < allowed, "{most}");
    for job in jobs.into_iter().chain([first]) {
        assert_eq!(world.request("DELETE", &format!("/v1/jobs/{job}"), "").unwrap().0, 200);
    }
    let gone = || (world.query(kept)[0][0] == Value::Integer(0)).then_some(());
    world.until("the reference is gone", Duration::from_secs(60), gone, &daemon);
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    drop(daemon);
    settle(&world);
}

/// Row F5.
#[test]
fn a_result_of_older_software_is_marked_kept_and_made_again_on_request() {
    let world = World::new();
    let capture = fill(&world, "desk", &[Channel::GyroX], &plain(4000), noise);
    let few = fill(&world, "few", &[Channel::GyroX], &plain(3), noise);
    let wanted = json!({"kind": "allan", "capture": capture});
    let (old, failed);
    {
        let mut daemon = world.daemon("", &[]);
        old = submit(&world, &wanted);
        failed = submit(&world, &json!({"kind": "allan", "capture": few}));
        assert_eq!(ended(&world, old, &daemon)["state"], "done");
        assert_eq!(ended(&world, failed, &daemon)["state"], "failed");
        assert_eq!(world.request("GET", &format!("/v1/captures/{few}/allan"), "").unwrap().0, 422);
        daemon.terminate();
    }
    // As an older program would have left it, with one more job in progress.
    let waiting = old + 100;
    let connection = rusqlite::Connection::open(world.database()).unwrap();
    connection
        .execute_batch(&format!(
            "UPDATE result SET software = 'vn100d 0.0.1';
             UPDATE job SET software = 'vn100d 0.0.1',
                 fingerprint = 'older ' || id;
             INSERT INTO job (id, kind, capture_id, params, end_seq, fingerprint, software, state, progress, created_utc_ns)
                 SELECT {waiting}, 'statistics', capture_id, params, end_seq, 'older', software, 'running', 0.5, created_utc_ns
                 FROM job WHERE id = {old};
             INSERT INTO job_checkpoint (job_id, next_seq, state, software) VALUES ({waiting}, 2000, x'09', 'vn100d 0.0.1');"
        ))
        .unwrap();
    drop(connection);
    let daemon = world.daemon("", &[]);
    let agent: ureq::Agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
    let mut answer = agent.get(format!("{}/v1/captures/{capture}/allan", world.url)).call().unwrap();
    assert_eq!(answer.headers()["vn100d-stale"], "vn100d 0.0.1");
    let before = answer.body_mut().read_to_string().unwrap();
    assert_eq!(world.get(&format!("/v1/jobs/{old}"))["stale"], true);
    // The older program's checkpoint is not used: the job is done from its beginning.
    assert_eq!(ended(&world, waiting, &daemon)["state"], "done");
    let statistics: serde_json::Value = serde_json::from_str(&body(&world, waiting)).unwrap();
    assert_eq!(statistics["channels"]["gyro_x"]["n"], 4000);
    // A job that failed in the older program is tried again, once.
    assert_eq!(world.request("GET", &format!("/v1/captures/{few}/allan"), "").unwrap().0, 202);
    let over = || world.request("GET", &format!("/v1/captures/{few}/allan"), "").filter(|(status, _)| *status == 422);
    world.until("this program's own answer", Duration::from_secs(10), over, &daemon);
    let new = submit(&world, &wanted);
    assert_ne!(new, old, "submitted again it is a new job");
    assert_eq!(ended(&world, new, &daemon)["stale"], false);
    let answer = agent.get(format!("{}/v1/captures/{capture}/allan", world.url)).call().unwrap();
    assert!(!answer.headers().contains_key("vn100d-stale"), "the new result answers");
    let mut kept = agent.get(format!("{}/v1/captures/{capture}/allan?job={old}", world.url)).call().unwrap();
    assert_eq!(kept.body_mut().read_to_string().unwrap(), before, "the old one is kept");
    drop(daemon);
    settle(&world);
}

/// Row F6.
#[test]
fn nothing_is_averaged_across_a_gap_a_reset_or_two_rates() {
    let world = World::new();
    let stretch = |samples, rate_hz, missing, cause, reset| Stretch { samples, rate_hz, missing, cause, reset };
    let stretches = [
        stretch(3000, 40.0, 0, GapCause::Checksum, false),
        stretch(2000, 40.0, 40, GapCause::Unplugged, false),
        stretch(2500, 40.0, 0, GapCause::SensorReset, true),
        stretch(1000, 100.0, 0, GapCause::RateChange, false),
        stretch(1500, 40.0, 10, GapCause::RateChange, false),
    ];
    // Each stretch has a different level: a term across any boundary would be a million times the noise. In the
    // accelerometer such a step is a motion, which is excluded with a second on both sides.
    let ends = [3000, 5000, 7500, 8500, 10_000];
    let level = |seq: u64| ends.iter().position(|end| seq < *end).unwrap() as f64 * 3.0;
    let steps = fill(&world, "steps", &[Channel::MagX], &stretches, |seq, channel| level(seq) + noise(seq, channel));
    let daemon = world.daemon("", &[]);
    let job = submit(&world, &json!({"kind": "allan", "capture": steps, "taus": "octave"}));
    assert_eq!(ended(&world, job, &daemon)["state"], "done");
    let report: serde_json::Value = serde_json::from_str(&body(&world, job)).unwrap();
    let curve = &report["channels"]["mag_x"];
    let taken = [0..3000, 3000..5000, 5000..7500, 8500..10_000_u64];
    for (index, m) in [1_usize, 2, 4, 8, 16, 32, 64, 128, 256].into_iter().enumerate() {
        let (mut squares, mut terms) = (0.0, 0_u64);
        for range in taken.clone() {
            let mut phases = vec![0.0];
            for seq in range {
                phases.push(phases.last().unwrap() + noise(seq, Channel::MagX));
            }
            for newest in 2 * m..phases.len() {
                squares += (phases[newest] - 2.0 * phases[newest - m] + phases[newest - 2 * m]).powi(2);
                terms += 1;
            }
        }
        let expected = (squares / (2.0 * terms as f64)).sqrt() / m as f64;
        let found = curve["deviation"][index].as_f64().unwrap();
        assert_eq!(curve["n"][index], terms, "terms at m = {m}");
        assert!((found / expected - 1.0).abs() < 1e-5, "m = {m}: {found}, by each stretch alone {expected}");
        // Several short stretches contain less information than one long one: the degrees of freedom are below those of
        // one stretch.
        assert!(curve["edf"][index].as_f64().unwrap() < terms as f64 + 1.0, "m = {m}");
    }
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("4 segments") && warnings.contains("1000 samples at another rate"), "{warnings}");
    drop(daemon);
    settle(&world);
}

/// Row F7.
#[test]
fn degenerate_input_gets_a_reason_and_no_number_that_is_none() {
    let world = World::new();
    type Make = fn(u64, Channel) -> f64;
    let table: [(&str, u64, Make); 6] = [
        ("constant", 4000, |_, _| 9.81),
        ("absent", 4000, |seq, _| if seq < 5 { 1.0 } else { f64::NAN }),
        ("every second absent", 4000, |seq, channel| if seq % 2 == 0 { noise(seq, channel) } else { f64::NAN }),
        ("three samples", 3, noise),
        ("saturated", 4000, |seq, _| if seq % 100 < 50 { 156.9 } else { -156.9 }),
        ("beyond range", 4000, |seq, channel| if seq % 10 == 0 { 1e300 } else { noise(seq, channel) }),
    ];
    let captures: Vec<(&str, i64)> = table
        .iter()
        .map(|(name, samples, make)| (*name, fill(&world, name, &[Channel::AccelX], &plain(*samples), make)))
        .collect();
    let daemon = world.daemon("", &[]);
    for (name, capture) in captures {
        for kind in ["allan", "noise", "statistics"] {
            let job = submit(&world, &json!({"kind": kind, "capture": capture}));
            let row = ended(&world, job, &daemon);
            let (status, text) = world.request("GET", &format!("/v1/captures/{capture}/{kind}"), "").unwrap();
            let answer: serde_json::Value =
                serde_json::from_str(&text).unwrap_or_else(|error| panic!("{name} {kind}: {error}: {text}"));
            for word in ["NaN", "inf", "Infinity"] {
                assert!(!text.contains(word), "{name} {kind}: {text}");
            }
            match status {
                200 => {
                    assert_eq!(row["state"], "done", "{name} {kind}");
                    // A constant has no noise: its parameters are not identified, and the reason is a flag.
                    if name == "constant" && kind == "noise" {
                        let channel = &answer["channels"]["accel_x"];
                        assert_eq!(channel["N"]["identified"], false, "{text}");
                        assert!(!channel["flags"].as_array().unwrap().is_empty(), "{text}");
                    }
                }
                422 => {
                    assert_eq!(row["state"], "failed", "{name} {kind}");
                    assert!(row["error"].as_str().unwrap().len() > 10, "{name} {kind}: {row}");
                    assert_eq!(answer["type"], "urn:vn100d:problem:analysis-failed");
                }
                other => panic!("{name} {kind}: {other} {text}"),
            }
        }
    }
    drop(daemon);
    settle(&world);
}
