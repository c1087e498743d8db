//! Exports of captures of a sensor's line: epochs of its clock, gaps, absent values, a capture that still grows.

use crate::export::Place;
use arrow_array::Array as _;
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Int32Type, Int64Type, TimestampNanosecondType};
use imu_core::sample::{Channel, ChannelSet, Gap, GapCause, Record, Sample, Segment, Timebase};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use vn100_testkit::tool;
use vn100d::store::{CaptureState, NewCapture, Store, StoreOptions};

const START_NS: i64 = 1_795_291_200_000_000_000;
const PERIOD_NS: i64 = 25_000_000;
const CHANNELS: [Channel; 7] =
    [Channel::MagX, Channel::MagY, Channel::MagZ, Channel::GyroX, Channel::GyroY, Channel::GyroZ, Channel::Temperature];

/// Returns the sample's period since the capture's start: 7 are missing before sample 400, 100 before sample 700.
fn tick(seq: u64) -> u64 {
    seq + if seq >= 400 { 7 } else { 0 } + if seq >= 700 { 100 } else { 0 }
}

/// Returns the sample's time by the sensor's clock: whole periods.
fn taken_ns(seq: u64) -> i64 {
    START_NS + tick(seq) as i64 * PERIOD_NS
}

/// Returns a sample of a sensor that restarted before sample 700. It arrives up to 3 ms late, except for the first
/// sample of each run of the clock.
fn sample(seq: u64) -> Sample {
    let run = if seq < 700 { 0 } else { 700 };
    let device_ns = 1_250_000_000 + (tick(seq) - tick(run)) * PERIOD_NS as u64;
    let late_ns = if seq == run { 0 } else { (seq * 7919 % 3000) as i64 * 1000 };
    let mut sample = Sample::at(5_000_000_000 + tick(seq) * PERIOD_NS as u64, taken_ns(seq) + late_ns);
    sample.device_time_ns = Some(device_ns);
    for (place, channel) in CHANNELS.into_iter().enumerate() {
        let absent = match channel {
            Channel::Temperature => seq.is_multiple_of(3),
            Channel::GyroY => seq % 10 == 7,
            _ => false,
        };
        if !absent {
            sample.set(channel, ((seq + 1) as f64).sqrt().sin() / (place as f64 + 3.0));
        }
    }
    sample
}

fn segment(number: u32, epoch: u32, first_seq: u64) -> Record {
    Record::Segment(Segment {
        number,
        epoch,
        first_seq,
        rate_hz: 40.0,
        timebase: Timebase::Device,
        channels: CHANNELS.into_iter().collect::<ChannelSet>(),
        first_device_time_ns: sample(first_seq).device_time_ns,
        first_utc_ns: sample(first_seq).host_utc_ns,
        boot_id: None,
    })
}

fn gap(before_seq: u64, missing: u64, cause: GapCause) -> Record {
    let (from, to) = (sample(before_seq - 1), sample(before_seq));
    let device_ns = from.device_time_ns.zip(to.device_time_ns).filter(|(from, to)| from < to);
    Record::Gap(Gap {
        before_seq,
        from_utc_ns: from.host_utc_ns,
        to_utc_ns: to.host_utc_ns,
        device_ns,
        missing,
        missing_exact: device_ns.is_some(),
        cause,
    })
}

fn named(name: &str, state: CaptureState) -> NewCapture {
    let mut capture = NewCapture::new("test", state);
    capture.name = Some(name.to_owned());
    capture
}

/// Returns a place whose capture 1, `line`, has 1,000 samples in three segments and two epochs.
fn with_line() -> Place {
    let place = Place::new();
    std::fs::create_dir(place.path("data")).unwrap();
    let store = Store::open(&place.path("data/vn100d.db"), StoreOptions::default()).unwrap();
    let mut import = store.begin_import(named("line", CaptureState::Imported), None).unwrap();
    import.push(segment(1, 1, 0)).unwrap();
    for seq in 0..1000 {
        match seq {
            400 => {
                import.push(gap(400, 7, GapCause::Checksum)).unwrap();
                import.push(segment(2, 1, 400)).unwrap();
            }
            700 => {
                import.push(gap(700, 100, GapCause::SensorReset)).unwrap();
                import.push(segment(3, 2, 700)).unwrap();
            }
            _ => {}
        }
        let number = 1 + u32::from(seq >= 400) + u32::from(seq >= 700);
        import.push(Record::Sample { seq, segment: number, sample: sample(seq) }).unwrap();
    }
    import.finish(None).unwrap();
    store.close().unwrap();
    place
}

/// Returns the rows that CSV must have, their times counted from `origin_ns`.
fn rows(count: u64, origin_ns: i64) -> Vec<String> {
    let row = |seq: u64| {
        let ns = taken_ns(seq) - origin_ns;
        let decimals = format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000);
        let values = CHANNELS.map(|channel| sample(seq).get(channel).map_or(String::new(), |value| value.to_string()));
        format!("{},{}", decimals.trim_end_matches('0').trim_end_matches('.'), values.join(","))
    };
    (0..count).map(row).collect()
}

#[test]
fn a_capture_with_epochs_and_gaps_leaves_by_the_sensor_s_clock_and_comes_back_the_same() {
    let place = with_line();
    let since_first = place.done(&["export", "line"]);
    assert!(since_first.lines().skip(1).eq(rows(1000, START_NS)), "{}", &since_first[..400]);
    let printed = place.done(&["export", "line", "--out", "line.csv", "--time", "utc"]);
    assert!(printed.contains("1000 samples of 7 channels as csv, 107 missing in 2 gaps"), "{printed}");
    assert!(place.text("line.csv").lines().skip(1).eq(rows(1000, 0)));
    place.done(&["export", "line", "--out", "line.mcap"]);
    let accounts = |id: i64| {
        let gaps = format!("SELECT before_seq, missing FROM gap WHERE capture_id = {id} ORDER BY before_seq");
        let segments = format!("SELECT segment_id, first_seq FROM segment WHERE capture_id = {id} ORDER BY segment_id");
        (place.query(&gaps), place.query(&segments))
    };
    for (id, file) in [(2, "line.csv"), (3, "line.mcap")] {
        place.done(&["import", file]);
        let back = format!("{id}.csv");
        place.done(&["export", &id.to_string(), "--out", &back, "--time", "utc"]);
        assert!(place.text(&back) == place.text("line.csv"), "{file} comes back as something else");
        assert_eq!(accounts(id), accounts(1), "{file}");
    }
    // A message of a magnetic field converts gauss to tesla and may not restore the same number. It has three axes, of
    // which the third is absent here: the recorded values are used anyway.
    let mag = ["--channels", "mag_z,mag_x"];
    place.done(&[&["export", "line", "--out", "mag.mcap"], &mag[..]].concat());
    place.done(&["import", "mag.mcap", "--name", "mag"]);
    let both = ["line", "mag"].map(|name| place.done(&[&["export", name], &mag[..]].concat()));
    assert!(both[0] == both[1] && both[0].lines().count() == 1001);
}

#[test]
fn parquet_states_segments_clocks_and_the_causes_of_gaps() {
    let place = with_line();
    place.done(&["export", "line", "--out", "line.parquet"]);
    let builder =
        ParquetRecordBatchReaderBuilder::try_new(std::fs::File::open(place.path("line.parquet")).unwrap()).unwrap();
    let metadata = &builder.schema().metadata;
    let gaps: serde_json::Value = serde_json::from_str(&metadata["gaps"]).unwrap();
    assert_eq!((&gaps[0]["cause"], &gaps[0]["missing_exact"]), (&"checksum".into(), &true.into()));
    assert_eq!((&gaps[1]["cause"], &gaps[1]["missing"]), (&"sensor_reset".into(), &100.into()));
    assert_eq!((metadata["samples"].as_str(), metadata["missing"].as_str()), ("1000", "107"));
    let mut seq = 0;
    for batch in builder.build().unwrap().map(Result::unwrap) {
        let column = |name: &str| batch.column_by_name(name).unwrap();
        let segment = column("segment").as_primitive::<Int32Type>();
        let utc = column("utc").as_primitive::<TimestampNanosecondType>();
        let device = column("device_time_ns").as_primitive::<Int64Type>();
        for row in 0..batch.num_rows() {
            let sample = sample(seq);
            assert_eq!(segment.value(row), 1 + i32::from(seq >= 400) + i32::from(seq >= 700));
            assert_eq!((utc.value(row), device.value(row) as u64), (taken_ns(seq), sample.device_time_ns.unwrap()));
            assert_eq!(column("temperature_c").is_null(row), sample.get(Channel::Temperature).is_none());
            seq += 1;
        }
    }
    assert_eq!(seq, 1000);
}

#[test]
fn a_capture_that_is_recorded_meanwhile_leaves_as_far_as_it_went() {
    let place = Place::new();
    std::fs::create_dir(place.path("data")).unwrap();
    let store = Store::open(&place.path("data/vn100d.db"), StoreOptions::default()).unwrap();
    let id = store.create_capture(named("growing", CaptureState::Capturing)).unwrap();
    let ended = AtomicBool::new(false);
    let expected = |count: usize| rows(400, START_NS).into_iter().take(count);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let records = store.records();
            records.blocking_send(id, segment(1, 1, 0)).unwrap();
            // It grows to the segment's end, a commit for each step.
            for seq in 0..400 {
                if ended.load(Ordering::Relaxed) {
                    return;
                }
                records.blocking_send(id, Record::Sample { seq, segment: 1, sample: sample(seq) }).unwrap();
                if seq % 10 == 9 {
                    store.flush_blocking().unwrap();
                    std::thread::sleep(Duration::from_millis(20));
                }
            }
        });
        let mut before = 0;
        while before < 400 {
            let output = place.run(&["export", "growing"]);
            let text = String::from_utf8(output.stdout).unwrap();
            let count = text.lines().count().saturating_sub(1);
            // At the capture's beginning there may be no rows yet.
            if count > 0 {
                assert!(text.lines().skip(1).eq(expected(count)), "{count} samples");
            }
            if count < before {
                ended.store(true, Ordering::Relaxed);
            }
            assert!(count >= before, "{count} samples after {before}");
            before = count;
        }
    });
    store.close().unwrap();
}

#[test]
fn a_signal_leaves_nothing_behind() {
    let place = crate::export::with_capture(20_000);
    let before = place.files();
    for named in ["night", "night.csv"] {
        for signal in [rustix::process::Signal::TERM, rustix::process::Signal::INT] {
            let interrupted = || {
                let mut child = Command::new(env!("CARGO_BIN_EXE_vn100d"))
                    .args(["--data-dir", "data", "export", named, "--out", "out.mcap"])
                    .current_dir(place.path(""))
                    .stderr(std::process::Stdio::null())
                    .spawn()
                    .unwrap();
                while place.files() == before {
                    assert!(child.try_wait().unwrap().is_none(), "{named} was over before it began");
                    std::thread::sleep(Duration::from_millis(1));
                }
                rustix::process::kill_process(rustix::process::Pid::from_child(&child), signal).unwrap();
                match child.wait().unwrap().code() {
                    // On a busy machine the export may end before the signal comes.
                    Some(0) => std::fs::remove_file(place.path("out.mcap")).map(|()| false).unwrap(),
                    code => {
                        assert_eq!(code, Some(1), "{named}");
                        true
                    }
                }
            };
            assert!((0..20).any(|_| interrupted()), "{named} was never interrupted");
            assert_eq!(place.files(), before, "{named}");
        }
    }
}

#[test]
fn other_programs_read_what_is_exported() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = root.join("target/peers/exports/bin/python");
    let what = "Python with mcap-ros2-support, rosbags and pyarrow";
    if !tool(python.exists(), what, "python3 tests/peers/exports.py --install brings them") {
        return;
    }
    let script = root.join("tests/peers/exports.py");
    let output = Command::new(python)
        .arg(script)
        .args(["--measure", "--binary", env!("CARGO_BIN_EXE_vn100d")])
        .env_remove("VN100D_DATA_DIR")
        .env_remove("VN100D_CONFIG")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("of 3000 samples agree"));
}
