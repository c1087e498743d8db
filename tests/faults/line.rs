//! The serial line: unplugged, silent, garbled, at another baud rate (rows B1 to B8, B13, B16).

use crate::audit::{Audited, Gap, Held, SensorLog, lines_with};
use crate::tools;
use crate::world::{Process, World, program};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use serde_json::Value;
use std::path::PathBuf;
use std::time::{Duration, Instant};

const START: Duration = Duration::from_secs(20);

/// A sensor that obeys faults, a daemon that captures from it, and a capture with samples.
struct Streaming {
    world: World,
    sensor: Process,
    daemon: Process,
    log: PathBuf,
    baseline: Held,
}

impl Streaming {
    fn begin(configuration: &str, emulator: &[&str]) -> Self {
        let world = World::new();
        let log = world.path("sensor.log");
        let arguments = [&["--faults", "-", "--log", log.to_str().unwrap()], emulator].concat();
        let sensor = world.emulate(&arguments);
        let daemon = world.daemon(configuration, &["--capture", "5h"]);
        world.until_more_samples(20, &daemon);
        let baseline = Held::of(daemon.id());
        Self { world, sensor, daemon, log, baseline }
    }

    fn state(&self) -> String {
        self.world.get("/v1/status")["sensor"]["state"].as_str().unwrap().to_owned()
    }

    /// Waits for a state of the sensor and returns the time that it took.
    fn until_state(&self, state: &str, patience: Duration) -> Duration {
        let begun = Instant::now();
        self.world.until(state, patience, || (self.state() == state).then_some(()), &self.daemon);
        begun.elapsed()
    }

    /// Waits until the emulator's log contains this event this many times.
    fn until_event(&self, what: &str, times: usize, patience: Duration) {
        let count = || SensorLog::read(&self.log).events.iter().filter(|event| event.what.starts_with(what)).count();
        self.world.until(what, patience, || (count() >= times).then_some(()), &self.daemon);
    }

    fn audit(mut self) -> Audited {
        let audited = self.world.settle_and_audit(&mut self.daemon, &self.log, Some(self.baseline));
        drop(self.sensor);
        audited
    }
}

/// Checks that the gap lasts as long on the host's clock as on the sensor's, within 0.1 s, and that its count follows
/// from the sensor's clock.
fn is_measured(gap: &Gap, away_s: f64, resumed_s: f64) {
    let (from, to) = gap.device_ns.expect("one epoch spans it");
    let device_s = (to - from) as f64 / 1e9;
    assert!(gap.exact);
    assert!(
        (gap.host_s() - device_s).abs() < 0.1,
        "{} s on the host's clock, {device_s} s on the sensor's",
        gap.host_s()
    );
    let missing_s = gap.missing as f64 / 40.0;
    assert!(
        (missing_s - away_s - resumed_s).abs() <= 0.1,
        "{missing_s} s missing, {away_s} s away, {resumed_s} s to resume"
    );
}

/// Row B1.
#[test]
fn after_an_unplug_the_same_capture_goes_on_within_three_seconds_and_the_gap_is_exact() {
    let mut run = Streaming::begin("", &[]);
    let away = tools::scaled(3, 10);
    run.sensor.send_line(&format!("unplug {away}s"));
    run.until_state("absent", Duration::from_secs(2));
    run.until_event("back", 1, Duration::from_secs(15));
    run.world.until_more_samples(40, &run.daemon);
    let log = run.daemon.log();
    assert_eq!(lines_with(&log, &["is gone"]), 1, "one line for the event:\n{log}");
    assert_eq!(lines_with(&log, &["serial number", "sends binary"]), 2, "one line per connection:\n{log}");
    let found = run.audit();
    let resumed = found.resumed_after_s("back");
    println!("B1: away {away} s, resumed after {resumed:.2} s, missing {}", found.missing);
    assert!(resumed <= 3.0, "{resumed} s");
    assert_eq!((found.causes(), found.segments), (vec!["unplugged"], 2));
    is_measured(&found.gaps[0], f64::from(away), resumed);
}

/// Row B2: the adapter has another number, and with a pattern another name.
#[test]
fn a_sensor_that_returns_under_another_name_is_found_and_status_shows_the_name() {
    let world = World::new();
    let log = world.path("sensor.log");
    let mut sensor = program();
    sensor.args(["emulate", "--faults", "-", "--log", log.to_str().unwrap()]);
    let mut sensor = Process::start(&mut sensor, true);
    let first = world.path("ttyUSB0");
    std::os::unix::fs::symlink(&sensor.first_line, &first).unwrap();
    let pattern = world.path("ttyUSB*");
    let mut daemon = world.daemon_on(pattern.to_str().unwrap(), "", &["--capture", "5h"]);
    world.until_more_samples(20, &daemon);
    assert_eq!(world.get("/v1/status")["sensor"]["port"], first.to_str().unwrap());
    sensor.send_line("unplug 2s");
    let gone = || (world.get("/v1/status")["sensor"]["state"] == "absent").then_some(());
    world.until("it is gone", Duration::from_secs(2), gone, &daemon);
    std::fs::remove_file(&first).unwrap();
    let back =
        || SensorLog::read(&log).events.iter().find_map(|event| event.what.strip_prefix("back on ").map(str::to_owned));
    let terminal = world.until("it is back", Duration::from_secs(10), back, &daemon);
    assert_ne!(terminal, sensor.first_line, "another terminal");
    let second = world.path("ttyUSB7");
    std::os::unix::fs::symlink(&terminal, &second).unwrap();
    world.until_more_samples(20, &daemon);
    assert_eq!(world.get("/v1/status")["sensor"]["port"], second.to_str().unwrap());
    let found = world.settle_and_audit(&mut daemon, &log, None);
    let resumed = found.resumed_after_s("back");
    println!("B2: resumed after {resumed:.2} s");
    assert!(resumed <= 3.0, "{resumed} s");
    assert_eq!((found.causes(), found.segments), (vec!["unplugged"], 2));
}

/// Row B2: the link stays and points at another device.
#[test]
fn behind_an_unchanged_link_the_status_shows_the_new_device() {
    let mut run = Streaming::begin("", &[]);
    let shown = |run: &Streaming| {
        let sensor = run.world.get("/v1/status")["sensor"].clone();
        (sensor["port"].as_str().unwrap().to_owned(), sensor["port_target"].as_str().unwrap().to_owned())
    };
    let link = run.world.port().to_str().unwrap().to_owned();
    assert_eq!(shown(&run), (link.clone(), run.sensor.first_line.clone()));
    run.sensor.send_line("unplug 2s");
    run.until_state("absent", Duration::from_secs(2));
    run.until_event("back", 1, Duration::from_secs(15));
    run.world.until_more_samples(40, &run.daemon);
    let device = std::fs::read_link(&link).unwrap().to_str().unwrap().to_owned();
    assert_ne!(device, run.sensor.first_line, "another terminal");
    assert_eq!(shown(&run), (link, device));
    let found = run.audit();
    let resumed = found.resumed_after_s("back");
    assert!(resumed <= 3.0, "{resumed} s");
    assert_eq!((found.causes(), found.segments), (vec!["unplugged"], 2));
}

/// Row B3.
#[test]
fn a_flapping_plug_leaks_nothing_and_costs_little() {
    let (times, half_ms) = tools::scaled((50, 120), (500, 600));
    let mut run = Streaming::begin("", &[]);
    let before = Held::of(run.daemon.id());
    let begun = Instant::now();
    for time in 1..=times {
        run.sensor.send_line(&format!("unplug {half_ms}ms"));
        run.until_event("back", time, Duration::from_secs(10));
        std::thread::sleep(Duration::from_millis(half_ms));
    }
    let cpu = (Held::of(run.daemon.id()).cpu - before.cpu).as_secs_f64() / begun.elapsed().as_secs_f64();
    run.world.until_more_samples(20, &run.daemon);
    let log = run.daemon.log();
    let lost = lines_with(&log, &["WARN"]);
    let found = run.audit();
    let resumed = found.resumed_after_s("back");
    println!(
        "B3: {times} unplugs, {:.1} % of a core, {lost} warnings, resumed after {resumed:.2} s, {:?}",
        100.0 * cpu,
        found.held
    );
    assert!(cpu < 0.2, "{cpu} of a core");
    assert!(lost <= times, "{lost} warnings for {times} unplugs:\n{log}");
    assert!(resumed <= 3.0, "{resumed} s");
    assert!(found.causes().iter().all(|cause| *cause == "unplugged"), "{:?}", found.causes());
}

/// Row B4.
#[test]
fn a_line_that_hung_up_is_absent_and_costs_nothing() {
    let seconds = tools::scaled(5, 60);
    let mut run = Streaming::begin("", &[]);
    run.sensor.send_line(&format!("eof {}s", seconds + 2));
    run.until_state("absent", Duration::from_secs(2));
    assert!(run.world.port().is_symlink(), "the link stays");
    let before = Held::of(run.daemon.id());
    std::thread::sleep(Duration::from_secs(seconds));
    let cpu = (Held::of(run.daemon.id()).cpu - before.cpu).as_secs_f64() / seconds as f64;
    run.until_event("back", 1, Duration::from_secs(20));
    run.world.until_more_samples(20, &run.daemon);
    let found = run.audit();
    let resumed = found.resumed_after_s("back");
    println!("B4: {:.2} % of a core over {seconds} s, resumed after {resumed:.2} s", 100.0 * cpu);
    assert!(cpu < 0.02, "{cpu} of a core");
    assert!(resumed <= 3.0, "{resumed} s");
    assert_eq!(found.causes(), ["unplugged"]);
}

/// Row B5.
#[test]
fn a_silent_sensor_is_stalled_within_a_second_and_streams_within_three_when_it_speaks_again() {
    let seconds = tools::scaled(8, 30);
    let mut run = Streaming::begin("", &[]);
    run.sensor.send_line(&format!("silence {seconds}s"));
    let stalled = run.until_state("stalled", Duration::from_secs(4)).as_secs_f64();
    run.world.until_more_samples(20, &run.daemon);
    assert_eq!(lines_with(&run.daemon.log(), &["the sensor is silent"]), 1, "{}", run.daemon.log());
    let found = run.audit();
    let from = found.log.last("silence");
    let last_before = found.row_mono_ns.iter().rev().find(|row| **row < from + 100_000_000).unwrap();
    let first_after = found.row_mono_ns.iter().find(|row| **row > from + 100_000_000).unwrap();
    let away = (first_after - last_before) as f64 / 1e9;
    println!("B5: stalled after {stalled:.2} s, {seconds} s silent, {away:.2} s without samples");
    assert!(stalled <= 2.0, "{stalled} s: a second, and what it takes to ask");
    assert!(away - (seconds as f64) <= 3.0, "{away} s");
    assert_eq!((found.causes(), found.segments), (vec!["silent"], 2));
    assert!((found.gaps[0].missing as f64 / 40.0 - away).abs() < 0.1);
}

/// Row B6, on the wire: whatever stands between frames, every intact frame is a row, and the noise is counted to the
/// byte.
#[test]
fn garbage_between_frames_costs_no_frame_and_is_counted_to_the_byte() {
    let bytes = tools::scaled(40_000_u64, 400_000);
    let mut run = Streaming::begin("", &["--baud", "921600"]);
    run.sensor.send_line(&format!("garbage {bytes}"));
    run.world.until_more_samples(bytes / 512 + 40, &run.daemon);
    let found = run.audit();
    let frames = (bytes / 512 + 1) as usize;
    let counted = found.rejected.get("garbage_bytes").copied().unwrap_or(0);
    // Random bytes may look like the beginning of a frame or a line; those are counted as such.
    let lookalikes: u64 =
        found.rejected.iter().filter(|(cause, _)| *cause != "garbage_bytes").map(|(_, count)| count).sum();
    println!("B6: {bytes} bytes before {frames} frames: {:?}, missing {}", found.rejected, found.missing);
    assert_eq!(found.missing, 0, "{:?}", found.gaps);
    assert!(counted <= bytes, "{counted} of {bytes} bytes");
    assert!(bytes - counted <= lookalikes * 200, "{counted} of {bytes} bytes, and {lookalikes} lookalikes");
}

/// Row B8.
#[test]
fn each_garbled_frame_is_one_missing_sample_and_its_neighbours_stand() {
    let bad = tools::scaled(12, 200);
    let mut run = Streaming::begin("", &[]);
    for _ in 0..bad {
        run.sensor.send_line("checksum 1");
        run.world.until_more_samples(3, &run.daemon);
    }
    run.world.until_more_samples(10, &run.daemon);
    let found = run.audit();
    println!("B8: {bad} garbled frames: {:?}, {} missing in {} gaps", found.rejected, found.missing, found.gaps.len());
    assert_eq!(found.log.count("garbled"), bad);
    assert_eq!((found.missing, found.gaps.len() as u64), (bad, bad));
    assert!(found.gaps.iter().all(|gap| gap.missing == 1 && gap.exact && gap.cause == "checksum"), "{:?}", found.gaps);
    assert_eq!(found.rejected.get("checksum"), Some(&bad), "{:?}", found.rejected);
}

/// Row B13: the baud rate changes while the sensor streams.
#[test]
fn a_sensor_at_another_baud_rate_is_reported_within_three_seconds_and_found() {
    let mut run = Streaming::begin("", &["--strict-baud"]);
    run.sensor.send_line("baud 230400");
    let reported_s = run.until_state("no_valid_frames", Duration::from_secs(6)).as_secs_f64();
    let begun = Instant::now();
    run.world.until_more_samples(20, &run.daemon);
    let streams = begun.elapsed().as_secs_f64();
    let status = run.world.get("/v1/status");
    assert_eq!(status["sensor"]["baud"], 230_400);
    let found = run.audit();
    println!("B13: reported after {reported_s:.2} s, streams {streams:.2} s later, {} missing", found.missing);
    assert!(reported_s <= 3.0, "{reported_s} s");
    assert_eq!(found.causes(), ["checksum"]);
}

/// Row B13: the sensor never uses a rate that is tried.
#[test]
fn a_baud_rate_that_is_not_to_be_tried_gives_a_hint_and_no_load() {
    let world = World::new();
    let _sensor = world.emulate(&["--strict-baud", "--baud", "460800"]);
    let mut daemon = world.daemon("[sensor]\nbaud = 115200\n", &[]);
    let begun = Instant::now();
    let no_frames = || Some(world.get("/v1/status")).filter(|status| status["sensor"]["state"] == "no_valid_frames");
    let status = world.until("no valid frames", Duration::from_secs(6), no_frames, &daemon);
    let after = begun.elapsed().as_secs_f64();
    assert!(status["sensor"]["hint"].as_str().unwrap().contains("baud rates 115200"), "{status}");
    let before = Held::of(daemon.id());
    std::thread::sleep(Duration::from_secs(4));
    let cpu = (Held::of(daemon.id()).cpu - before.cpu).as_secs_f64() / 4.0;
    println!("B13: said after {after:.2} s, {:.1} % of a core", 100.0 * cpu);
    assert!(after <= 3.0 && cpu < 0.2, "{after} s, {cpu} of a core");
    assert_eq!(lines_with(&daemon.log(), &["no valid frame"]), 1, "{}", daemon.log());
    assert_eq!(daemon.terminate(), Some(0));
    assert_eq!(world.query("SELECT count(*) FROM capture")[0][0], rusqlite::types::Value::Integer(0));
}

/// Row B16.
#[test]
fn a_port_that_may_not_be_opened_is_reported_with_the_remedy_and_tried_again() {
    if !tools::root("another user is needed to be refused") || !tools::have("setpriv", "it becomes another user") {
        return;
    }
    let world = World::new();
    let log = world.path("sensor.log");
    let sensor = world.emulate(&["--log", log.to_str().unwrap()]);
    std::fs::create_dir(world.path("data")).unwrap();
    let nobody = 65_534;
    for path in [world.folder.path().to_owned(), world.path("data")] {
        std::os::unix::fs::chown(&path, Some(nobody), Some(nobody)).unwrap();
    }
    let permit = |mode| {
        let permissions = std::os::unix::fs::PermissionsExt::from_mode(mode);
        std::fs::set_permissions(&sensor.first_line, permissions).unwrap();
    };
    permit(0o000);
    // The program may lie in a folder that only root may read.
    let copy = world.path("program");
    std::fs::copy(env!("CARGO_BIN_EXE_vn100d"), &copy).unwrap();
    let mut command = std::process::Command::new("setpriv");
    command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]).arg(&copy);
    let mut daemon = world.daemon_of(command, world.port().to_str().unwrap(), "", &["--capture", "5h"]);
    let refused = || Some(world.get("/v1/status")).filter(|status| status["sensor"]["state"] == "no_permission");
    let status = world.until("it is refused", START, refused, &daemon);
    assert!(status["sensor"]["hint"].as_str().unwrap().contains("dialout"), "{status}");
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(lines_with(&daemon.log(), &["may not be opened"]), 1, "{}", daemon.log());
    permit(0o666);
    let begun = Instant::now();
    world.until_more_samples(20, &daemon);
    println!("B16: streams {:.2} s after the permission came", begun.elapsed().as_secs_f64());
    let found = world.settle_and_audit(&mut daemon, &log, None);
    assert_eq!(found.missing, 0);
}

/// The capture belongs to one sensor (issue: another unit is refused and reported).
#[test]
fn another_unit_is_refused_and_reported_and_the_right_one_goes_on() {
    let mut run = Streaming::begin("", &[]);
    run.sensor.send_line("unit 0100099999");
    run.sensor.send_line("unplug 1s");
    let wrong = || Some(run.world.get("/v1/status")).filter(|status| status["sensor"]["state"] == "wrong_unit");
    let status: Value = run.world.until("it is refused", Duration::from_secs(15), wrong, &run.daemon);
    let hint = status["sensor"]["hint"].as_str().unwrap();
    assert!(hint.contains("0100012345") && hint.contains("0100099999"), "{hint}");
    let samples = status["capture"]["samples"].as_u64();
    std::thread::sleep(Duration::from_secs(3));
    assert_eq!(run.world.get("/v1/status")["capture"]["samples"].as_u64(), samples, "none of its samples is taken");
    assert_eq!(lines_with(&run.daemon.log(), &["the capture belongs to"]), 1, "{}", run.daemon.log());
    run.sensor.send_line("unit 0100012345");
    run.sensor.send_line("unplug 1s");
    run.world.until_more_samples(20, &run.daemon);
    let found = run.audit();
    let resumed = found.resumed_after_s("back");
    println!("wrong unit: the right one streams after {resumed:.2} s");
    assert_eq!(found.segments, 2);
    assert!(resumed <= 3.0, "{resumed} s");
}

/// “A capture that gaps 1,400 times keeps working.”
#[test]
fn a_capture_with_fourteen_hundred_gaps_keeps_working() {
    let world = World::new();
    let (script, log) = (world.path("faults"), world.path("sensor.log"));
    let lines: String = (0..1400).map(|gap| format!("{}ms drop 1\n", 15_000 + 100 * gap)).collect();
    std::fs::write(&script, lines).unwrap();
    let arguments = ["--speed", "20", "--faults", script.to_str().unwrap(), "--log", log.to_str().unwrap()];
    let _sensor = world.emulate(&arguments);
    let mut daemon = world.daemon("", &["--speed", "20", "--capture", "5h"]);
    let gaps = || world.try_get("/v1/status").filter(|status| status["capture"]["gaps"].as_u64() >= Some(1400));
    world.until("1,400 gaps", Duration::from_secs(60), gaps, &daemon);
    world.until_more_samples(100, &daemon);
    let begun = Instant::now();
    let status = world.get("/v1/status");
    let took = begun.elapsed();
    assert!(status["capture"]["samples"].as_u64() > Some(4000), "{status}");
    let found = world.settle_and_audit(&mut daemon, &log, None);
    println!("1,400 gaps: {} segments, status in {took:?}, {} MiB", found.segments, found.held.anonymous_bytes >> 20);
    assert_eq!((found.missing, found.gaps.len(), found.segments), (1400, 1400, 1401));
}

/// Returns a stream of frames and noise, and the number of frames in it.
fn stream(bytes: usize, random: &mut rand_chacha::ChaCha8Rng) -> (Vec<u8>, usize) {
    let frame = frame();
    let (mut out, mut frames) = (Vec::with_capacity(bytes + 1024), 0);
    while out.len() < bytes {
        let mut noise = vec![0; random.random_range(0..2000)];
        random.fill_bytes(&mut noise);
        out.extend_from_slice(&noise);
        for _ in 0..random.random_range(1..4) {
            out.extend_from_slice(&frame);
            frames += 1;
        }
    }
    (out, frames)
}

/// Returns one frame of the default output, as the emulator encodes it (checked against published vectors elsewhere).
fn frame() -> Vec<u8> {
    let mut sensor = vn100d::emulator::VirtualSensor::new(&vn100d::emulator::SensorOptions::default());
    let mut out = Vec::new();
    sensor.on_bytes(0, b"$VNWRG,06,0*XX\r\n$VNWRG,75,1,20,01,0609*XX\r\n", &mut out);
    out.clear();
    sensor.emit(20, &[0.5; imu_core::sample::Channel::COUNT], &mut out);
    out
}

/// Returns a decoder that accepts only the default output, as a capture does.
fn decoder() -> vn100_proto::Decoder {
    use vn100_proto::{BinaryAcceptance, Decoder, DecoderOptions, MeasurementKind};
    let output = vn100d::capture::output::Output::Binary { fields: "01,0609".to_owned(), divisor: 20 };
    let Some((MeasurementKind::Binary(header), _)) = output.kind_and_rate() else { panic!() };
    let mut decoder = Decoder::new(DecoderOptions::default());
    decoder.accept_binary(BinaryAcceptance::Only(header));
    decoder
}

/// Row B6, in the decoder.
#[test]
fn every_intact_frame_between_noise_is_decoded_and_noise_makes_no_frame() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(6);
    let (bytes, frames) = stream(tools::scaled(2, 10) << 20, &mut random);
    let (mut decoded, mut counted) = (0, 0);
    let mut decoder = decoder();
    for part in bytes.chunks(4096) {
        decoder.push(part, &mut |event| match event {
            vn100_proto::Event::Measurement(_) => decoded += 1,
            vn100_proto::Event::Rejected { bytes, .. } => counted += bytes.len(),
            _ => {}
        });
    }
    decoder.flush(&mut |event| {
        if let vn100_proto::Event::Rejected { bytes, .. } = event {
            counted += bytes.len();
        }
    });
    let noise = bytes.len() - frames * frame().len();
    println!("B6: {decoded} of {frames} frames, {counted} of {noise} bytes of noise counted");
    assert_eq!((decoded, counted), (frames, noise));

    let megabytes = tools::scaled(4, 100);
    let mut false_frames = 0;
    let mut noise = vec![0; 1 << 20];
    for _ in 0..megabytes {
        random.fill_bytes(&mut noise);
        decoder.push(&noise, &mut |event| {
            false_frames += usize::from(matches!(event, vn100_proto::Event::Measurement(_)));
        });
    }
    println!("B6: {false_frames} false frames in {megabytes} MiB");
    assert_eq!(false_frames, 0);
}

/// Row B7.
#[test]
fn however_the_bytes_are_split_the_samples_are_the_same() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let (mut bytes, _) = stream(40_000, &mut random);
    bytes.extend_from_slice(b"$VNYMR,+100.949,-007.330,+000.715,-00.2501,-00.0264,+00.3939,-01.252,+00.123,-09.702,+00.000123,-00.000456,+00.000789*XX\r\n");
    let decode = |sizes: &mut dyn FnMut() -> usize| {
        let (mut decoder, mut events, mut rest) = (decoder(), Vec::new(), &bytes[..]);
        let mut note = |event: vn100_proto::Event<'_>| {
            // The noise may arrive in other pieces, but its total must be the same.
            match event {
                vn100_proto::Event::Measurement(measurement) => events.push(format!("{measurement:?}")),
                vn100_proto::Event::Rejected { .. } => {}
                other => events.push(format!("{other:?}")),
            }
        };
        while !rest.is_empty() {
            let (part, behind) = rest.split_at(sizes().clamp(1, rest.len()));
            decoder.push(part, &mut note);
            rest = behind;
        }
        decoder.flush(&mut note);
        let stats = decoder.stats();
        events.push(format!("{stats:?}"));
        events
    };
    let whole = decode(&mut || 65_536);
    assert!(whole.len() > 40);
    assert_eq!(decode(&mut || 1), whole, "byte by byte");
    for split in 0..1000 {
        let longest = 1 << random.random_range(1..15);
        assert_eq!(decode(&mut || random.random_range(1..=longest)), whole, "split {split}");
    }
}
