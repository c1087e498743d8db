//! The guarantees of jobs, on real files.

use super::pass::Pass as _;
use super::runner::{Outcome, run};
use super::*;
use crate::store::{CaptureState, JobState, NewCapture, NewJob, Reader, Store, StoreOptions};
use imu_core::sample::{Channel, Gap, GapCause, Record, Sample, Segment, Timebase};
use imu_noise::NoiseReport;
use imu_noise::allan::{AllanCurve, AllanReport, FixedPoint, Phases, TauGrid, TauSpacing};
use imu_noise::robust::{Part, spectral_sums};
use imu_noise::whittle::{self, DstSums};
use std::time::{Duration, Instant};

/// Samples of the capture: two segments at 40 Hz with a gap between them, one at 100 Hz, one at 40 Hz in which values of
/// gyro_x are absent.
const SEGMENTS: [(u64, f64); 4] = [(1500, 40.0), (2200, 40.0), (700, 100.0), (1100, 40.0)];
const TOTAL: u64 = 5500;

fn value(seq: u64, channel: Channel) -> f64 {
    let mut state = (seq + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ ((channel as u64 + 1) << 32);
    state ^= state >> 29;
    state = state.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((state >> 40) as f64 / f64::from(1 << 24) - 0.5) * 0.01
}

fn segment(number: u32, first_seq: u64, rate_hz: f64) -> Record {
    Record::Segment(Segment {
        number,
        epoch: 1,
        first_seq,
        rate_hz,
        timebase: Timebase::Device,
        channels: [Channel::AccelX, Channel::GyroX, Channel::GyroY].into_iter().collect(),
        first_device_time_ns: Some(first_seq * 25_000_000),
        first_utc_ns: 1_800_000_000_000_000_000,
        boot_id: None,
    })
}

fn sample(number: u32, seq: u64) -> Record {
    let mut sample = Sample::at(seq * 25_000_000, 1_800_000_000_000_000_000 + (seq * 25_000_000) as i64);
    sample.device_time_ns = Some(seq * 25_000_000);
    for channel in [Channel::AccelX, Channel::GyroX, Channel::GyroY] {
        if !(channel == Channel::GyroX && (4600..4610).contains(&seq)) {
            sample.set(channel, value(seq, channel));
        }
    }
    Record::Sample { seq, segment: number, sample }
}

fn records() -> Vec<Record> {
    let mut records = Vec::new();
    let mut seq = 0;
    for (number, (samples, rate_hz)) in (1..).zip(SEGMENTS) {
        if number == 2 {
            records.push(Record::Gap(Gap {
                before_seq: seq,
                from_utc_ns: 0,
                to_utc_ns: 1,
                device_ns: None,
                missing: 7,
                missing_exact: true,
                cause: GapCause::Checksum,
            }));
        }
        records.push(segment(number, seq, rate_hz));
        records.extend((seq..seq + samples).map(|seq| sample(number, seq)));
        seq += samples;
    }
    records
}

struct World {
    directory: tempfile::TempDir,
    store: Store,
    capture: i64,
}

fn request(kind: JobKind, members: &serde_json::Value) -> AnalysisRequest {
    AnalysisRequest::of_members(kind, members.as_object().cloned().unwrap_or_default()).unwrap()
}

impl World {
    fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let store = Store::open(&directory.path().join("vn100d.db"), StoreOptions::default()).unwrap();
        let planned = Some(std::time::Duration::from_secs(3600));
        let named =
            NewCapture { name: Some("desk".to_owned()), planned, ..NewCapture::new("test", CaptureState::Complete) };
        let capture = store.create_capture(named).unwrap();
        let world = Self { directory, store, capture };
        world.send(records());
        world
    }
    fn send(&self, records: Vec<Record>) {
        for record in records {
            self.store.records().blocking_send(self.capture, record).unwrap();
        }
        self.store.flush_blocking().unwrap();
    }
    fn reader(&self) -> Reader {
        self.store.reader().unwrap()
    }
    fn queue(&self, kind: JobKind, params: serde_json::Value) -> i64 {
        self.queue_on(kind, self.capture, params)
    }
    fn queue_on(&self, kind: JobKind, capture_id: i64, params: serde_json::Value) -> i64 {
        let job = JobRequest::Analysis(request(kind, &params)).job(capture_id).unwrap();
        self.store.submit_job(job, u64::MAX).unwrap().0.id
    }
    /// Works on the job in turns of `turns` chunks each; every turn starts as a new program would.
    fn work(&self, job: i64, chunk: usize, turns: impl IntoIterator<Item = usize>) -> String {
        for chunks in turns {
            let claimed = self.store.claim_job().unwrap().unwrap();
            assert_eq!(claimed.id, job);
            let mut left = chunks;
            let outcome = run(&self.store, &self.reader(), &claimed, chunk, || {
                left -= 1;
                left > 0
            });
            match outcome.unwrap() {
                Outcome::Done(result) => return self.reader().result(result).unwrap().unwrap().body,
                Outcome::Stopped => {}
                Outcome::Cancelled => panic!("nobody cancelled"),
            }
        }
        panic!("the job did not come to an end");
    }
}

#[test]
fn a_job_killed_at_every_chunk_comes_to_the_same_bytes() {
    for kind in JobKind::USUAL {
        let world = World::new();
        let job = world.queue(kind, serde_json::Value::Null);
        let whole = world.work(job, 100_000, [usize::MAX]);
        for chunk in [97, 500, 1500, 4096] {
            let world = World::new();
            let job = world.queue(kind, serde_json::Value::Null);
            let result = world.work(job, chunk, std::iter::repeat_n(1, 1000));
            assert_eq!(result, whole, "{kind:?} in chunks of {chunk}");
        }
    }
}

#[test]
fn a_job_killed_at_every_checkpoint_comes_to_the_same_bytes() {
    let channels = [Channel::AccelX, Channel::GyroX, Channel::GyroY];
    let noise = channels.map(|of| (of.name().to_owned(), serde_json::json!({"N": 1e-4})));
    let sim = serde_json::json!({"format": "vn100d-sensor-model-1", "name": "m", "rate_hz": 40.0,
        "channels": noise.into_iter().collect::<serde_json::Map<_, _>>()});
    let result = |is_diagnosis: bool, is_killed: bool| {
        let world = World::new();
        let captures = [("one", 0..TOTAL), ("two", TOTAL..2 * TOTAL)]
            .map(|(name, range)| world.add(name, &serde_json::json!({}), 40.0, range));
        let request = match is_diagnosis {
            true => {
                let sim = Simulator::of(&world.reader(), sim.clone()).unwrap();
                JobRequest::Diagnosis(DiagnosisParameters { sim, reference: None })
            }
            false => JobRequest::Analysis(request(JobKind::Noise, &serde_json::json!({"with": [captures[1]]}))),
        };
        let job = world.store.submit_job(request.job(captures[0]).unwrap(), u64::MAX).unwrap().0.id;
        let kept = || world.reader().checkpoint(job).unwrap().map(|checkpoint| checkpoint.state);
        for kills in 0..50 {
            let claimed = world.store.claim_job().unwrap().unwrap();
            let before = kept();
            let goes_on = || !is_killed || kept() == before;
            match run(&world.store, &world.reader(), &claimed, 100_000, goes_on).unwrap() {
                Outcome::Done(result) => return (world.reader().result(result).unwrap().unwrap().body, kills),
                Outcome::Stopped => assert_ne!(kept(), before),
                Outcome::Cancelled => panic!("nobody cancelled"),
            }
        }
        panic!("the job did not come to an end");
    };
    for is_diagnosis in [true, false] {
        let (whole, killed) = (result(is_diagnosis, false), result(is_diagnosis, true));
        // Each of three channels, in four parts or more; a chunk, and two groups of channels.
        assert_eq!(whole.1, 0);
        let expected = if is_diagnosis { 12..50 } else { 3..4 };
        assert!(expected.contains(&killed.1), "{}", killed.1);
        assert!(whole.0 == killed.0, "{}\n{}", whole.0, killed.0);
    }
}

#[test]
fn curves_of_whole_stretches_are_those_of_the_definition_through_kills_at_every_chunk_and_channel() {
    for estimator in ["adev", "mdev", "hdev", "ohdev", "totdev"] {
        let world = World::new();
        let members = serde_json::json!({"estimator": estimator, "taus": "octave"});
        let job = world.queue(JobKind::Allan, members.clone());
        let whole = world.work(job, 100_000, [usize::MAX]);
        let report: AllanReport = serde_json::from_str(&whole).unwrap();
        assert_eq!((report.estimator.name(), report.samples, report.missing), (estimator, Some(TOTAL), Some(7)));
        let stretches: [std::ops::Range<u64>; 4] = [0..1500, 1500..3700, 4400..4600, 4610..5500];
        let of = |channel| stretches.clone().map(|stretch| stretch.map(|seq| value(seq, channel)).collect::<Vec<_>>());
        let phases = of(Channel::GyroX).map(|values| Phases::integrate(&values).unwrap());
        let grid = TauGrid::octave(2200).unwrap();
        let expected = AllanCurve::from_phases(&phases, report.estimator, &grid, 40.0, "rad/s");
        assert_eq!(report.channels[&Channel::GyroX], expected, "{estimator}");
        assert_eq!(report.channels.len(), 3);
        for chunk in [500, 4096] {
            let world = World::new();
            let job = world.queue(JobKind::Allan, members.clone());
            let result = world.work(job, chunk, std::iter::repeat_n(1, 1000));
            assert_eq!(result, whole, "{estimator} in chunks of {chunk}");
        }
    }
}

#[test]
fn what_would_not_fit_into_memory_or_time_is_refused_with_what_to_do() {
    let world = World::new();
    let plan = Plan::read(&world.reader(), world.capture, TOTAL, &Channel::ANALYSED).unwrap();
    let refused = |change: fn(&mut Plan), members: serde_json::Value| {
        let mut plan = plan.clone();
        change(&mut plan);
        curves::check(request(JobKind::Allan, &members).parameters(), &plan).map_err(|error| error.to_string())
    };
    let (mdev, all) =
        (serde_json::json!({"estimator": "mdev"}), serde_json::json!({"estimator": "mdev", "taus": "all"}));
    refused(|_| (), mdev.clone()).unwrap();
    refused(|_| (), all.clone()).unwrap();
    refused(|plan| plan.end_seq = curves::MOST, mdev.clone()).unwrap();
    let long = refused(|plan| plan.end_seq = curves::MOST + 1, mdev).unwrap_err();
    assert!(long.contains("4000001 samples") && long.contains("take the estimator `oadev`"), "{long}");
    for change in [|plan: &mut Plan| plan.longest = 100_000, |plan: &mut Plan| plan.end_seq = 3_900_000] {
        let many = refused(change, all.clone()).unwrap_err();
        assert!(many.contains("averaging times") && many.contains("take `taus` `log` or `octave`"), "{many}");
    }
    let parameters = JobParameters { taus: TauSpacing::All, ..JobParameters::default() };
    let mut too_long = plan.clone();
    too_long.longest = 100_000;
    assert!(curves::check(&parameters, &too_long).is_err(), "of the exact sums too");
}

/// Tests of several captures beside the world's first.
impl World {
    fn add(&self, name: &str, sensor: &serde_json::Value, rate_hz: f64, range: std::ops::Range<u64>) -> i64 {
        let named = NewCapture {
            name: Some(name.to_owned()),
            sensor: Some(sensor.clone().into()),
            ..NewCapture::new("test", CaptureState::Complete)
        };
        let id = self.store.create_capture(named).unwrap();
        let records = self.store.records();
        records.blocking_send(id, segment(1, 0, rate_hz)).unwrap();
        for (seq, from) in (0..).zip(range) {
            let Record::Sample { mut sample, .. } = sample(1, seq) else { panic!("no sample") };
            for channel in [Channel::AccelX, Channel::GyroX, Channel::GyroY] {
                sample.set(channel, value(from, channel));
            }
            records.blocking_send(id, Record::Sample { seq, segment: 1, sample }).unwrap();
        }
        self.store.flush_blocking().unwrap();
        id
    }
    fn work_on(&self, kind: JobKind, capture_id: i64, params: serde_json::Value, chunk: usize) -> serde_json::Value {
        let job = self.queue_on(kind, capture_id, params);
        serde_json::from_str(&self.work(job, chunk, std::iter::repeat_n(2, 30).chain([usize::MAX]))).unwrap()
    }
}

#[test]
fn captures_of_one_sensor_give_what_their_stretches_would_in_one() {
    let world = World::new();
    let sensor = serde_json::json!({"model": "VN-100", "serial_number": "0100012345"});
    // The capture's first two segments and its last, as separate captures.
    let nights = [("first", 0..1500), ("second", 1500..3700), ("third", 4610..5500)];
    let ids = nights.map(|(name, range)| world.add(name, &sensor, 40.0, range));
    let with = serde_json::json!({"with": [ids[2], ids[1]]});
    let reader = world.reader();
    let sums = |captures: &[(i64, u64)]| {
        let plan = together::plan(&reader, captures, &[Channel::AccelX]).unwrap();
        let parameters = JobParameters::default();
        let mut summation = sums::Summation::new(plan.clone(), &parameters).unwrap();
        let mut next = 0;
        while next < plan.end_seq {
            let chunk = plan.read_chunk(&reader, next, 613, &[Channel::AccelX]).unwrap();
            summation.take(&chunk);
            next = chunk.next_seq();
        }
        assert!(!summation.end_pass());
        summation.finish().1.remove(0).1
    };
    let whole = sums(&[(ids[0], 1500), (ids[1], 2200), (ids[2], 890)]);
    assert_eq!((whole.samples(), whole.segments()[0], whole.terms()[0]), (4590, 3, 1499 + 2199 + 889));
    assert_eq!(whole, sums(&[(ids[2], 890), (ids[0], 1500), (ids[1], 2200)]), "sums have no order");

    for estimator in ["oadev", "mdev"] {
        let mut members = with.clone();
        members["estimator"] = estimator.into();
        let report = world.work_on(JobKind::Allan, ids[0], members, 700);
        assert_eq!((&report["samples"], &report["missing"]), (&4590.into(), &0.into()), "{estimator}");
        let names: Vec<&str> =
            report["captures"].as_array().unwrap().iter().map(|of| of["capture"].as_str().unwrap()).collect();
        assert_eq!(names, ["first", "second", "third"]);
        assert_eq!(report["captures"][1]["samples"], 2200);
        assert_eq!(report["channels"]["accel_x"]["n"][0], 1499 + 2199 + 889);
    }

    let noise: NoiseReport = serde_json::from_value(world.work_on(JobKind::Noise, ids[0], with, 700)).unwrap();
    assert_eq!((noise.capture.as_str(), noise.samples, noise.missing), ("first + second + third", 4590, 0));
    assert!((noise.duration_s - 4590.0 / 40.0).abs() < 0.1, "{}", noise.duration_s);
    assert!(noise.captures.iter().all(|of| of.disturbances.len() == 3 && of.flags.len() == 3));
    // The same stretches one after the other in one capture: the sums of their spectra are the same.
    let mut merged = DstSums::new();
    for range in [0..1500, 1500..3700, 4610..5500] {
        let values = range.map(|seq| value(seq, Channel::AccelX)).collect();
        let part = Part { start_s: 0.0, values };
        merged.merge(&spectral_sums(&[part], FixedPoint::for_channel(Channel::AccelX)));
    }
    let expected = whittle::fit(&merged, 40.0, Channel::AccelX, &[], None);
    let found = &noise.channels[&Channel::AccelX];
    let close = |one: Option<[f64; 2]>, other: Option<[f64; 2]>| {
        one.unwrap().iter().zip(other.unwrap()).all(|(one, other)| (one / other - 1.0).abs() < 1e-9)
    };
    assert!(close(found.n.ci95, expected.n.ci95), "{:?} {:?}", found.n, expected.n);
    assert_eq!(found.b.upper_limit95.is_some(), expected.b.upper_limit95.is_some());
    let width = |report: &NoiseReport| {
        let [low, high] = report.channels[&Channel::AccelX].n.ci95.unwrap();
        high - low
    };
    let alone = world.work_on(JobKind::Noise, ids[0], serde_json::Value::Null, 700);
    let alone: NoiseReport = serde_json::from_value(alone).unwrap();
    assert!(alone.captures.is_empty());
    // Three times the samples: the interval of N shrinks with their root.
    assert!(width(&noise) < 0.7 * width(&alone), "{} {}", width(&noise), width(&alone));
}

#[test]
fn captures_that_are_not_of_one_sensor_at_one_setting_are_refused_at_once() {
    let world = World::new();
    let sensor = |serial: &str| serde_json::json!({"model": "VN-100", "serial_number": serial});
    let one = world.add("one", &sensor("7"), 40.0, 0..300);
    let other = world.add("other", &sensor("8"), 40.0, 0..300);
    let fast = world.add("fast", &sensor("7"), 100.0, 0..300);
    let running = world.store.create_capture(NewCapture::new("test", CaptureState::Capturing)).unwrap();
    let jobs = Jobs::start(&world.store, JobsOptions::default()).unwrap();
    let submit = |with: &[i64]| jobs.submit(one, request(JobKind::Noise, &serde_json::json!({ "with": with })));
    for (with, words) in [
        (vec![other], "`one` and `other` differ: serial number 7 and 8"),
        (vec![fast], "`one` and `fast` differ: rate in Hz 40 and 100"),
        (vec![one], "given twice"),
        (vec![world.capture, world.capture], "given twice"),
        (vec![running], "still runs"),
    ] {
        let error = submit(&with).unwrap_err();
        assert!(matches!(error, JobError::Together(_)), "{with:?}: {error}");
        assert!(error.to_string().contains(words), "{with:?}: {error}");
    }
    assert!(matches!(submit(&[999]).unwrap_err(), JobError::Store(_)));
    assert!(world.reader().jobs(None, None, &crate::store::PageRequest::first()).unwrap().rows.is_empty());
    // A capture that does not state its sensor may be of the same one.
    let (job, is_new) = submit(&[world.capture]).unwrap();
    assert!(is_new);
    let (again, is_new) = submit(&[world.capture]).unwrap();
    assert_eq!((again.id, is_new), (job.id, false));
    jobs.stop();
}

/// The check precedes any fit: these 300 samples would not suffice for one.
#[test]
fn a_simulator_of_another_rate_is_refused_before_any_work() {
    let world = World::new();
    let fast = world.add("fast", &serde_json::Value::Null, 100.0, 0..300);
    let params = serde_json::json!({ "sim": fast });
    let job = NewJob::new(JobKind::Diagnosis, world.capture, params);
    world.store.submit_job(job, u64::MAX).unwrap();
    let claimed = world.store.claim_job().unwrap().unwrap();
    let error = run(&world.store, &world.reader(), &claimed, 1000, || true).unwrap_err().to_string();
    assert!(error.contains("recording has 40 Hz") && error.contains("simulator 100 Hz"), "{error}");
}

/// The clocks of the captures differ: the whole has their mean rate, weighted by samples.
#[test]
fn rates_that_differ_by_their_clocks_are_one_rate() {
    let world = World::new();
    let [one, other] = [("one", 100.0, 0..300), ("other", 100.004, 0..900)]
        .map(|(name, rate_hz, range)| (world.add(name, &serde_json::Value::Null, rate_hz, range.clone()), range.end));
    let plan = |captures: &[(i64, u64)]| together::plan(&world.reader(), captures, &[Channel::AccelX]).unwrap().rate_hz;
    assert!((plan(&[one, other]) - 100.003).abs() < 1e-9 && (plan(&[other, one]) - 100.003).abs() < 1e-9);
    assert_eq!(plan(&[one]), 100.0);
}

#[test]
fn passes_over_groups_of_channels_and_kills_in_any_of_them_change_nothing() {
    let world = World::new();
    let parameters = JobParameters::default();
    let reader = world.reader();
    let plan = Plan::read(&reader, world.capture, TOTAL, &Channel::ANALYSED).unwrap();
    let sums = |group: usize, kill: bool| {
        let begun = || sums::Summation::new(plan.clone(), &parameters).unwrap().in_groups(group);
        let mut summation = begun();
        loop {
            let mut next = 0;
            while next < TOTAL {
                let chunk = reader.read_chunk(world.capture, next, 613, summation.read_channels()).unwrap();
                summation.take(&chunk);
                next = chunk.next_seq();
                if kill {
                    let state = summation.save().unwrap();
                    summation = begun().restored(&state, next, &reader).unwrap().unwrap();
                }
            }
            if !summation.end_pass() {
                break;
            }
        }
        summation.finish().1
    };
    let whole = sums(3, false);
    assert_eq!(whole.len(), 3);
    for group in 1..=3 {
        assert_eq!(sums(group, false), whole, "{group} at a time");
        assert_eq!(sums(group, true), whole, "{group} at a time, killed");
    }
}

#[test]
fn spectra_by_groups_and_through_kills_are_the_same_bits() {
    let world = World::new();
    let reader = world.reader();
    let plan = Plan::read(&reader, world.capture, TOTAL, &Channel::ANALYSED).unwrap();
    let sums = |group: usize, kill: bool| {
        let begun = || spectra::Spectra::new(plan.clone()).in_groups(group);
        let mut spectra = begun();
        loop {
            let mut next = 0;
            while next < TOTAL {
                let chunk = reader.read_chunk(world.capture, next, 613, spectra.read_channels()).unwrap();
                spectra.take(&chunk);
                next = chunk.next_seq();
                if kill {
                    let state = spectra.save().unwrap();
                    spectra = begun().restored(&state, next, &reader).unwrap().unwrap();
                }
            }
            if !spectra.end_pass() {
                break;
            }
        }
        spectra.finish().1
    };
    let whole = sums(3, false);
    assert_eq!(whole.iter().map(|(_, sums)| sums.samples()).collect::<Vec<_>>(), [4800, 4790, 4800]);
    for group in 1..=3 {
        assert_eq!(sums(group, false), whole, "{group} at a time");
        assert_eq!(sums(group, true), whole, "{group} at a time, killed");
    }
}

#[test]
fn the_curve_is_that_of_the_estimator_on_each_stretch_by_itself() {
    let world = World::new();
    let job = world.queue(JobKind::Allan, serde_json::json!({"taus": "octave"}));
    let report: imu_noise::allan::AllanReport = serde_json::from_str(&world.work(job, 1000, [usize::MAX])).unwrap();
    assert_eq!((report.rate_hz, report.complete), (40.0, true));
    assert_eq!(report.channels.keys().copied().collect::<Vec<_>>(), [Channel::AccelX, Channel::GyroX, Channel::GyroY]);
    let stretches: [std::ops::Range<u64>; 4] = [0..1500, 1500..3700, 4400..4600, 4610..5500];
    for (index, m) in [1u64, 2, 4, 8, 16, 32, 64, 128, 256, 512].into_iter().enumerate() {
        let (mut squares, mut terms) = (0.0, 0u64);
        for stretch in stretches.clone() {
            let mut phases = vec![0.0];
            for seq in stretch {
                phases.push(phases.last().unwrap() + value(seq, Channel::GyroX));
            }
            for newest in 2 * m as usize..phases.len() {
                let (middle, oldest) = (phases[newest - m as usize], phases[newest - 2 * m as usize]);
                squares += (phases[newest] - 2.0 * middle + oldest).powi(2);
                terms += 1;
            }
        }
        let curve = &report.channels[&Channel::GyroX];
        let expected = (squares / (2.0 * terms as f64)).sqrt() / m as f64;
        assert_eq!(curve.n[index], terms, "m = {m}");
        assert!(
            (curve.deviation[index] / expected - 1.0).abs() < 1e-6,
            "m = {m}: {} {expected}",
            curve.deviation[index]
        );
    }
}

#[test]
fn a_job_sees_the_samples_that_were_there_when_it_was_submitted() {
    let world = World::new();
    let before = world.queue(JobKind::Allan, serde_json::Value::Null);
    let more = (TOTAL..TOTAL + 900).map(|seq| sample(4, seq)).collect();
    world.send(more);
    let body = world.work(before, 1000, [usize::MAX]);
    let report: imu_noise::allan::AllanReport = serde_json::from_str(&body).unwrap();
    assert!(!report.complete);
    // accel_x at m = 1: every segment of n samples gives n − 1 terms.
    assert_eq!(report.channels[&Channel::AccelX].n[0], 1499 + 2199 + 1099);
    let after = world.queue(JobKind::Allan, serde_json::Value::Null);
    assert_ne!(after, before);
}

#[test]
fn a_cancelled_job_ends_at_the_next_chunk() {
    let world = World::new();
    let job = world.queue(JobKind::Allan, serde_json::Value::Null);
    let claimed = world.store.claim_job().unwrap().unwrap();
    let mut chunks = 0;
    let outcome = run(&world.store, &world.reader(), &claimed, 500, || {
        chunks += 1;
        if chunks == 3 {
            world.store.cancel_job(job).unwrap();
        }
        true
    });
    assert_eq!((outcome.unwrap(), chunks), (Outcome::Cancelled, 3));
    assert_eq!(world.reader().job(job).unwrap().state, JobState::Cancelled);
}

#[test]
fn a_damaged_checkpoint_is_refused() {
    let world = World::new();
    let job = world.queue(JobKind::Allan, serde_json::Value::Null);
    for state in [vec![], vec![9], vec![1, 0, 0, 0, 0], vec![1, 255, 255, 255, 255], vec![1; 64]] {
        let claimed = world.store.claim_job().unwrap().unwrap();
        let checkpoint = crate::store::JobCheckpoint { next_seq: 100, state };
        world.store.checkpoint_job(job, checkpoint, 0.1).unwrap();
        let error = run(&world.store, &world.reader(), &claimed, 500, || true).unwrap_err();
        assert!(matches!(error, JobError::Checkpoint(_)), "{error}");
        world.store.release_job(job).unwrap();
    }
}

fn wait_until(what: &str, condition: impl Fn() -> bool) {
    let begun = Instant::now();
    while !condition() {
        assert!(begun.elapsed() < Duration::from_secs(30), "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn workers_do_what_is_queued_and_clear_away_what_is_deleted() {
    let world = World::new();
    let jobs = Jobs::start(&world.store, JobsOptions { place: Place::Here { chunk: 1000 }, ..JobsOptions::default() })
        .unwrap();
    let queued = jobs.submit_all(world.capture).unwrap();
    assert_eq!(queued.len(), JobKind::USUAL.len());
    let reader = world.reader();
    wait_until("the jobs", || queued.iter().all(|job| reader.job(job.id).unwrap().state == JobState::Done));
    assert_eq!(jobs.submit_all(world.capture).unwrap()[0].id, queued[0].id);
    assert!(queued.iter().all(|job| reader.job(job.id).unwrap().result_id.is_some()));
    wait_until("the count", || jobs.status().done == queued.len() as u64 && jobs.status().running == 0);
    world.store.delete_capture(world.capture).unwrap();
    jobs.wake();
    wait_until("the deletion", || !reader.has_deleted().unwrap());
    jobs.stop();
    assert!(world.directory.path().exists());
}

#[test]
fn a_capture_with_too_little_in_it_fails_the_job_with_the_reason() {
    let world = World::new();
    let few = world.store.create_capture(NewCapture::new("test", CaptureState::Complete)).unwrap();
    let sender = world.store.records();
    sender.blocking_send(few, segment(1, 0, 40.0)).unwrap();
    for seq in 0..3 {
        sender.blocking_send(few, sample(1, seq)).unwrap();
    }
    world.store.flush_blocking().unwrap();
    let empty = world.store.create_capture(NewCapture::new("test", CaptureState::Stopped)).unwrap();
    let jobs = Jobs::start(&world.store, JobsOptions::default()).unwrap();
    let reader = world.reader();
    assert!(jobs.submit_all(empty).unwrap().is_empty(), "nobody asked for an analysis of nothing");
    for (capture, reason) in [(few, "3 samples"), (empty, "no samples")] {
        let job = jobs.submit(capture, AnalysisRequest::usual(JobKind::Allan).unwrap()).unwrap().0.id;
        wait_until("the end", || reader.job(job).unwrap().state == JobState::Failed);
        let error = reader.job(job).unwrap().error.unwrap();
        assert!(error.contains(reason), "{error}");
    }
    jobs.stop();
    assert_eq!(jobs.status().failed, 2);
}

#[test]
fn while_a_capture_runs_its_curve_grows_with_it() {
    let world = World::new();
    let live = Live::new();
    let reader = world.reader();
    let empty = world.store.create_capture(NewCapture::new("test", CaptureState::Capturing)).unwrap();
    assert!(matches!(live.allan(&reader, empty), Err(JobError::InsufficientData(_))));
    let early = live.points(&reader, world.capture).unwrap();
    assert_eq!((early.rate_hz, early.samples, early.next_seq, early.caught_up), (40.0, 4800, TOTAL, true));
    let job = world.queue(JobKind::Allan, serde_json::json!({"taus": "octave"}));
    let exact: imu_noise::allan::AllanReport = serde_json::from_str(&world.work(job, 1000, [usize::MAX])).unwrap();
    let report = live.allan(&reader, world.capture).unwrap();
    assert!(!report.complete);
    for (channel, curve) in &report.channels {
        // Up to m = 16 every term is taken.
        for index in 0..5 {
            let expected = exact.channels[channel].deviation[index];
            assert_eq!(curve.n[index], exact.channels[channel].n[index]);
            assert!((curve.deviation[index] / expected - 1.0).abs() < 1e-12, "{channel} {index}");
        }
    }
    world.send((TOTAL..TOTAL + 900).map(|seq| sample(4, seq)).collect());
    assert_eq!(live.points(&reader, world.capture).unwrap().samples, 5700);
    let noise = live.noise(&reader, world.capture).unwrap();
    assert_eq!((noise.samples, noise.missing, noise.complete), (TOTAL + 900, 7, false));
    assert!(noise.channels[&Channel::AccelX].n.identified);
    let statistics = live.statistics(&reader, world.capture).unwrap();
    assert_eq!(statistics.channels[&Channel::GyroX].n, TOTAL + 900 - 10);
}

/// A capture in which the sensor was carried about once had noise parameters until it ended.
#[test]
fn while_a_capture_runs_a_sensor_that_moved_has_no_usable_parameters() {
    let world = World::new();
    let (live, reader) = (Live::new(), world.reader());
    let still = live.noise(&reader, world.capture).unwrap();
    assert_eq!((still.moving_s, still.channels[&Channel::GyroX].usable), (Some(0.0), true));
    let turned = |seq| match sample(4, seq) {
        Record::Sample { seq, segment, mut sample } => {
            sample.set(Channel::GyroX, 0.5);
            Record::Sample { seq, segment, sample }
        }
        other => other,
    };
    world.send((TOTAL..TOTAL + 900).map(turned).collect());
    let moved = live.noise(&reader, world.capture).unwrap();
    assert!(moved.moving_s.is_some_and(|moving_s| (20.0..30.0).contains(&moving_s)), "{:?}", moved.moving_s);
    assert!(moved.at_rest_s.is_some_and(|at_rest_s| (110.0..125.0).contains(&at_rest_s)), "{:?}", moved.at_rest_s);
    for parameters in moved.channels.values() {
        assert!(!parameters.usable && parameters.reason.as_ref().unwrap().contains("moved"), "{:?}", parameters.reason);
    }
}

#[test]
fn noise_parameters_and_statistics_report_what_they_are_made_of() {
    let world = World::new();
    let job = world.queue(JobKind::Noise, serde_json::Value::Null);
    let noise: imu_noise::NoiseReport = serde_json::from_str(&world.work(job, 1000, [usize::MAX])).unwrap();
    assert_eq!((noise.format.as_str(), noise.rate_hz, noise.complete), ("vn100d-noise-1", 40.0, true));
    assert_eq!((noise.samples, noise.missing), (TOTAL, 7));
    // Uniform over 0.01: σ/√rate.
    let truth = 0.01 / 12f64.sqrt() / 40f64.sqrt();
    for parameters in noise.channels.values() {
        assert!((parameters.n.value.unwrap() / truth - 1.0).abs() < 0.05, "{:?}", parameters.n);
        assert!(parameters.flags.iter().any(|flag| flag.kind == "other_rate" && flag.note.contains("700")));
    }
    let job = world.queue(JobKind::Statistics, serde_json::Value::Null);
    let report: StatisticsReport = serde_json::from_str(&world.work(job, 1000, [usize::MAX])).unwrap();
    assert_eq!(report.format, "vn100d-statistics-1");
    assert_eq!(report.channels[&Channel::GyroX].n, TOTAL - 10);
    let values = (0..TOTAL).map(|seq| value(seq, Channel::AccelX));
    let mean = values.clone().sum::<f64>() / TOTAL as f64;
    assert!((report.channels[&Channel::AccelX].mean.unwrap() - mean).abs() < 1e-15);
    assert_eq!(report.channels[&Channel::AccelX].max, values.reduce(f64::max));
}
