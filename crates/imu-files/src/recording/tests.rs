//! The module as its callers see it, on files generated here and, if `VN100D_REAL_DATA` names them, on real ones.

use super::*;
use imu_core::sample::{Channel, DiscardCause, Gap, GapCause, Record, Timebase};
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use vn100_testkit::bag;

const MARCH_2024_NS: i64 = 1_710_358_267_000_000_000;

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }
    fn file(&self, name: &str, content: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, content).unwrap();
        path
    }
    fn load(&self, content: &str, options: Options) -> Result<LoadedRecording, RecordingError> {
        load_columns(&self.file("recording", content.as_bytes()), options)
    }
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

fn at_rate(rate_hz: f64) -> Options {
    Options { rate_hz: Some(rate_hz), ..Options::default() }
}

/// Returns a valid `$VNYMR` line whose gyro x is `value`.
fn line(value: f64) -> String {
    let body = format!(
        "VNYMR,-134.051,-000.443,-000.892,-00.1575,+00.1599,+00.3040,-00.077,+00.164,-09.965,{value:+010.6},+00.001325,+00.000043"
    );
    format!("${body}*{:02X}", body.bytes().fold(0, |sum, byte| sum ^ byte))
}

fn values(recording: &LoadedRecording, channel: Channel) -> &[f64] {
    &recording.column(channel).unwrap().values
}

fn shape(gaps: &[Gap]) -> Vec<(u64, u64, bool, GapCause)> {
    gaps.iter().map(|gap| (gap.before_seq, gap.missing, gap.missing_exact, gap.cause)).collect()
}

#[test]
fn columns_stand_in_any_order_and_units_are_converted_once() {
    let content = "accel_z_mg,note,time_s,gyro_x_dps,mag_y_ut,roll_rad,temperature_c,accel_x_g,mag_x_tesla,gyro_y_rad_s\n\
                   1000,a,0,180,50,3.141592653589793,25.5,-1,0.00005,0.125\n\
                   -1000,b,0.5,-90,25,0,25.25,1,0,0.25\n";
    let loaded = Folder::new().load(content, Options::default()).unwrap();
    assert_eq!(loaded.info.ignored_columns, ["note"]);
    assert_eq!((loaded.info.rate_hz, loaded.info.rate_assumed, loaded.info.stamps), (2.0, false, Stamps::Relative));
    for (channel, expected) in [
        (Channel::AccelZ, [9.80665, -9.80665]),
        (Channel::AccelX, [-9.80665, 9.80665]),
        (Channel::GyroX, [std::f64::consts::PI, -std::f64::consts::FRAC_PI_2]),
        (Channel::MagY, [0.5, 0.25]),
        (Channel::MagX, [0.5, 0.0]),
        (Channel::Roll, [180.0, 0.0]),
        (Channel::Temperature, [25.5, 25.25]),
        (Channel::GyroY, [0.125, 0.25]),
    ] {
        for (found, expected) in values(&loaded, channel).iter().zip(expected) {
            assert!((found - expected).abs() <= 1e-15 * expected.abs(), "{channel}: {found}");
        }
    }
    let converted: Vec<_> =
        loaded.info.conversions.iter().map(|conversion| (conversion.channel, conversion.original_unit)).collect();
    assert_eq!(converted.len(), 6);
    assert!(converted.contains(&(Channel::AccelZ, "mg")) && converted.contains(&(Channel::MagX, "T")));
    let decimals =
        [Channel::Temperature, Channel::GyroY, Channel::AccelX].map(|channel| loaded.info.decimals.get(channel));
    assert_eq!(decimals, [Some(2), Some(3), Some(0)]);
}

#[test]
fn a_blank_cell_or_nan_is_an_absent_channel_and_never_a_number() {
    for absent in ["NaN", "NA", "null", "None", "-", " n/a "] {
        let content =
            format!("time_s,gyro_x_rad_s,gyro_y_rad_s\n0,1,1\n1,,2\n2,{absent},3\n3,4,4\n4,,{absent}\n5,6,6\n");
        let loaded = Folder::new().load(&content, Options::default()).unwrap();
        let x = loaded.column(Channel::GyroX).unwrap();
        let numbers: Vec<Option<f64>> =
            x.values.iter().map(|value| Some(*value).filter(|value| value.is_finite())).collect();
        assert_eq!(numbers, [Some(1.0), None, None, Some(4.0), Some(6.0)], "{absent}");
        check_gap_of_an_empty_row(&loaded);
    }
}

fn check_gap_of_an_empty_row(loaded: &LoadedRecording) {
    // The row without any value is rejected: the stamps show the gap.
    assert_eq!(loaded.segments, [0..4, 4..5]);
    assert_eq!(shape(&loaded.gaps), [(4, 1, true, GapCause::Source)]);
    assert_eq!(loaded.info.rejected, [(DiscardCause::Malformed, 1)].into());
}

#[test]
fn what_programs_of_windows_write_around_a_table_is_read() {
    let rows = "0,1,2,3\n1,4,5,6\n";
    for (header, rows) in [
        ("sep=,\ntime_s,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s]\n", rows.to_owned()),
        (
            "// Start Time: Unknown\n// Update Rate: 1.0Hz\nZeit (s),gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s]\n",
            rows.to_owned(),
        ),
        ("time_s,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s]\n", rows.replace('\n', ",\n")),
        (
            "//seq,time_s,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s]\n",
            rows.replace("0,1", "7,0,1").replace("1,4", "8,1,4"),
        ),
    ] {
        let loaded = Folder::new().load(&format!("{header}{rows}"), Options::default()).unwrap();
        assert_eq!((loaded.samples, loaded.info.rate_hz, loaded.info.rejected.len()), (2, 1.0, 0), "{header}");
    }
    let mut latin = b"time_s,gyro_x [\xb0/s],accel_x [m/s\xb2]\n0,90,1\n1,90,1\n".to_vec();
    let loaded = columns(&Recording::read(Input::memory("a.csv", latin.clone()), Options::default()).unwrap()).unwrap();
    assert_eq!(loaded.samples, 2);
    assert!((values(&loaded, Channel::GyroX)[0] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    // A cell that is no UTF-8 is still no number.
    latin.extend(b"2,\xb0,1\n");
    let loaded = columns(&Recording::read(Input::memory("a.csv", latin), Options::default()).unwrap()).unwrap();
    assert_eq!((loaded.samples, loaded.info.rejected.len()), (2, 1));
}

#[test]
fn a_bad_row_is_rejected_with_its_line_and_the_rest_is_read() {
    let content = "time_s,gyro_x_rad_s\n0,1\n1,two\n2,3\n3\n4,5,6\n5,inf\nsix,7\n7,8\n\u{FFFD},9\n";
    let loaded = Folder::new().load(content, Options::default()).unwrap();
    assert_eq!(values(&loaded, Channel::GyroX), [1.0, 3.0, 8.0]);
    let rejected: Vec<_> = loaded.info.first_rejected.iter().map(|bad| (bad.line, bad.text.as_str())).collect();
    assert_eq!(rejected, [(3, "1,two"), (5, "3"), (6, "4,5,6"), (7, "5,inf"), (8, "six,7"), (10, "\u{FFFD},9")]);
    assert_eq!(loaded.info.rejected, [(DiscardCause::Malformed, 6)].into());
}

#[test]
fn a_gap_is_a_grid_point_without_a_sample_and_not_a_step_that_is_made_up_for() {
    // Twice a sample is late by half a period, once one is missing, once three.
    let times = [0.0, 1.0, 2.0, 3.51, 4.0, 6.0, 7.0, 11.0, 12.52, 13.0, 14.0, 15.0];
    let mut content = "time_s,gyro_x_rad_s\n".to_owned();
    for time in times {
        content.push_str(&format!("{:.6},1\n", 0.025 * time));
    }
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert!((loaded.info.rate_hz - 40.0).abs() < 0.4, "{}", loaded.info.rate_hz);
    assert_eq!(shape(&loaded.gaps), [(5, 1, true, GapCause::Source), (7, 3, true, GapCause::Source)]);
    assert_eq!(loaded.segments, [0..5, 5..7, 7..12]);
    assert_eq!((loaded.samples, loaded.missing), (12, 4));
    assert_eq!(loaded.gaps[1].device_ns, Some((175_000_000, 275_000_000)));
    assert!((loaded.duration_s() - 16.0 / 40.0).abs() < 0.01);
}

/// Whole milliseconds at 400 Hz for 600 s were once reported as "333.33 Hz, 720 s"; with 3 ms of jitter 7,236 samples
/// were invented.
#[test]
fn coarse_and_jittering_stamps_determine_rate_duration_and_what_is_missing() {
    let mut content = "time_s,gyro_x_rad_s\n".to_owned();
    for index in 0..240_000 {
        content.push_str(&format!("{:.3},{}\n", f64::from(index) * 0.0025 + 0.2, index % 7));
    }
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert!((loaded.info.rate_hz / 400.0 - 1.0).abs() < 1e-6, "{}", loaded.info.rate_hz);
    assert_eq!((loaded.samples, loaded.missing, loaded.gaps.len()), (240_000, 0, 0));
    let remarks = loaded.info.remarks().join("; ");
    assert!(remarks.contains("stamps lie on a grid of 400.0 Hz, rounded to 1 ms"), "{remarks}");
    // Two decimals at 200 Hz: two samples with each stamp. None is a duplicate.
    let mut content = "time_s,gyro_x_rad_s\n".to_owned();
    for index in 0..20_000 {
        content.push_str(&format!("{:.2},{}\n", f64::from(index) * 0.005 + 0.001, index % 7));
    }
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert!((loaded.info.rate_hz / 200.0 - 1.0).abs() < 1e-4, "{}", loaded.info.rate_hz);
    assert_eq!((loaded.samples, loaded.missing, loaded.info.rejected.len()), (20_000, 0, 0));
    assert!(loaded.stamps_ns.is_sorted_by(|one, other| one < other));
    // 100 Hz with 3 ms of jitter, which puts one stamp in a hundred before the last one; each 97th sample is missing.
    let mut content = "time_s,gyro_x_rad_s\n".to_owned();
    let (mut state, mut missing) = (9_u64, 0);
    for index in 0..60_000_u64 {
        let normal: f64 = (0..12).fold(-6.0, |sum, _| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum + (state >> 11) as f64 / (1_u64 << 53) as f64
        });
        if index % 97 == 50 {
            missing += 1;
            continue;
        }
        content.push_str(&format!("{:.6},{}\n", 1.0 + index as f64 * 0.01 + 0.003 * normal, index % 7));
    }
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert!((loaded.info.rate_hz / 100.0 - 1.0).abs() < 1e-5, "{}", loaded.info.rate_hz);
    assert_eq!((loaded.samples, loaded.missing, loaded.info.rejected.len()), (60_000 - missing, missing, 0));
    assert!((loaded.duration_s() - 600.0).abs() < 0.011, "{}", loaded.duration_s());
}

/// Returns the rate of a recording whose stamps, s, are written with this many decimals; none of its samples may be
/// lost.
fn rate_of(stamps_s: impl Iterator<Item = f64>, decimals: usize) -> (f64, u64) {
    let mut content = "time_s,gyro_x_rad_s\n".to_owned();
    let mut count = 0;
    for (index, stamp_s) in stamps_s.enumerate() {
        // A coarse channel: neighbours are often equal.
        content.push_str(&format!(
            "{stamp_s:.decimals$},{}\n",
            0.01 * ((index * index).wrapping_mul(2_654_435_761) >> 30 & 3) as f64
        ));
        count += 1;
    }
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert_eq!((loaded.samples, loaded.info.rejected.len()), (count, 0), "{:?}", loaded.info.remarks());
    assert!(loaded.stamps_ns.is_sorted_by(|one, other| one < other));
    (loaded.info.rate_hz, loaded.missing)
}

/// Each was once taken for a duplicate: 1024 Hz in whole ms was reported as "1000 Hz" with 2.3 % rejected, pairs of one
/// stamp as half their rate.
#[test]
fn samples_that_share_a_stamp_by_rounding_or_delivery_all_count() {
    let is = |(found_hz, missing): (f64, u64), rate_hz: f64| {
        assert!((found_hz / rate_hz - 1.0).abs() < 1e-4 && missing == 0, "{found_hz} for {rate_hz}, {missing} missing");
    };
    for (rate_hz, decimals) in [(1024.0, 3), (102.4, 2), (100.3, 2), (1000.5, 3), (119.0, 2), (1600.0, 3)] {
        is(rate_of((0..60_000).map(|index| f64::from(index) / rate_hz), decimals), rate_hz);
    }
    // Pairs, and a buffer of eight, with the stamp of their delivery.
    for (group, decimals) in [(2, 3), (2, 6), (8, 6)] {
        let delivered = |index: u32| (f64::from(index / group * group + group) * 0.01 * 1e3).round() / 1e3;
        let (found_hz, missing) = rate_of((0..40_000).map(delivered), decimals);
        assert!((found_hz / 100.0 - 1.0).abs() < 1e-3 && missing == 0, "{found_hz}, {missing} missing");
    }
}

/// At 200 Hz with 1 ms of jitter one stamp in five thousand lies before the last one; such samples were once rejected.
#[test]
fn rare_falls_by_jitter_are_no_misplaced_samples() {
    let mut state = 5_u64;
    let mut normal = || {
        (0..12).fold(-6.0, |sum, _| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum + (state >> 11) as f64 / (1_u64 << 53) as f64
        })
    };
    for (rate_hz, jitter_s, decimals) in [(200.0, 0.001, 6), (40.0, 0.005, 9), (800.0, 0.0003, 3)] {
        let stamps_s: Vec<f64> =
            (0..120_000).map(|index| 1.0 + f64::from(index) / rate_hz + jitter_s * normal()).collect();
        let (found_hz, missing) = rate_of(stamps_s.into_iter(), decimals);
        assert!((found_hz / rate_hz - 1.0).abs() < 1e-4, "{found_hz} for {rate_hz}, {missing} missing");
        assert!(missing == 0 || decimals == 3, "{rate_hz}: {missing} missing");
    }
}

#[test]
fn a_given_rate_overrides_the_stamps_and_a_remark_states_it() {
    let content: String =
        (0..200).map(|index| format!("{:.3},{index}\n", 0.025 * f64::from(index + index / 100))).collect();
    let content = format!("time_s,gyro_x_rad_s\n{content}");
    let load = |rate_hz| Folder::new().load(&content, at_rate(rate_hz)).unwrap();
    // The sensor's own clock is 0.1 % off the host's: gaps are still those of the stamps.
    let near = load(40.04);
    assert_eq!((near.info.rate_hz, near.missing, near.info.stamps), (40.04, 1, Stamps::Relative));
    let far = load(400.0);
    assert_eq!((far.info.rate_hz, far.missing, far.info.stamps), (400.0, 0, Stamps::None));
    for (loaded, words) in [(near, "gaps are still theirs"), (far, "they do not count")] {
        let remarks = loaded.info.remarks().join("; ");
        let overrides = format!("--rate {} overrides", loaded.info.rate_hz);
        assert!(remarks.contains(words) && remarks.contains(&overrides) && remarks.contains("40.0 Hz"), "{remarks}");
    }
}

/// A recording that begins at 40 Hz and continues at 80 Hz has 80 Hz, and its beginning lacks every other sample.
#[test]
fn a_rate_that_rises_is_that_of_the_whole_recording() {
    let mut content = "time_s,gyro_x_rad_s\n".to_owned();
    for index in 0..40_000 {
        let time = if index < 20_000 { f64::from(index) * 0.025 } else { 500.0 + f64::from(index - 20_000) * 0.0125 };
        content.push_str(&format!("{time:.4},{}\n", index % 7));
    }
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert!((loaded.info.rate_hz - 80.0).abs() < 1e-3, "{}", loaded.info.rate_hz);
    assert!(loaded.missing.abs_diff(20_000) < 2, "{}", loaded.missing);
    assert!((loaded.duration_s() - 750.0).abs() < 0.02, "{}", loaded.duration_s());
}

#[test]
fn samples_are_never_reordered_a_stamp_that_does_not_advance_is_a_duplicate() {
    let content = "time_s,gyro_x_rad_s\n0,1\n1,2\n1,3\n0.5,4\n2,5\n";
    let loaded = Folder::new().load(content, Options::default()).unwrap();
    assert_eq!(values(&loaded, Channel::GyroX), [1.0, 2.0, 5.0]);
    assert_eq!(loaded.info.rejected, [(DiscardCause::Duplicate, 2)].into());
    assert_eq!(loaded.missing, 0);
    assert_eq!(loaded.info.first_rejected[1].line, 5);
}

#[test]
fn a_stamp_of_another_clock_than_the_others_is_rejected_and_costs_no_other_sample() {
    let folder = Folder::new();
    let unix = "time_s,gyro_x_rad_s\n8267.9,0\n1710358268,1\n1710358268.1,2\n17103,3\n1710358268.2,4\n";
    let relative = "time_s,gyro_x_rad_s\n0,1\n0.1,2\n1710358268,3\n0.2,4\n";
    for content in [unix, relative] {
        let loaded = folder.load(content, Options::default()).unwrap();
        assert_eq!(values(&loaded, Channel::GyroX), [1.0, 2.0, 4.0]);
        assert!((loaded.info.rate_hz - 10.0).abs() < 1e-6 && loaded.gaps.is_empty(), "{:?}", loaded.gaps);
        assert!(loaded.info.first_rejected.iter().all(|bad| bad.text.contains("as the others are")));
        assert!(loaded.info.rejected[&DiscardCause::Malformed] >= 1);
    }
}

#[test]
fn stamps_since_1970_give_the_utc_to_the_nanosecond_others_count_from_the_given_start() {
    let folder = Folder::new();
    let times = |content: &str, options| -> Vec<(Option<u64>, i64)> {
        let file = folder.file("times", content.as_bytes());
        let recording = Recording::open(&file, options).unwrap();
        let items = recording.items().unwrap().map(|item| match item.unwrap() {
            Item::Sample(sample, _) => (sample.device_time_ns, sample.host_utc_ns),
            Item::Rejected(rejected) => panic!("{rejected:?}"),
        });
        items.collect()
    };
    let unix = "time_s,gyro_x_rad_s\n1710358267.000000001,1\n1710358267.025000002,2\n";
    let expected = [(Some(0), MARCH_2024_NS + 1), (Some(25_000_001), MARCH_2024_NS + 25_000_002)];
    assert_eq!(times(unix, Options::default()), expected);
    let relative = "time_s,gyro_x_rad_s\n100,1\n100.5,2\n";
    let started = Options { started_utc_ns: 7, ..Options::default() };
    assert_eq!(times(relative, started), [(Some(0), 7), (Some(500_000_000), 500_000_007)]);
    let unstamped = "gyro_x_rad_s\n1\n2\n";
    let started = Options { rate_hz: Some(8.0), started_utc_ns: 7, ..Options::default() };
    assert_eq!(times(unstamped, started), [(None, 7), (None, 125_000_007)]);
}

#[test]
fn without_stamps_a_csv_needs_a_rate() {
    let folder = Folder::new();
    let refused = folder.load("gyro_x_rad_s\n1\n", Options::default()).unwrap_err();
    assert!(refused.to_string().contains("--rate HZ"), "{refused}");
    let loaded = folder.load("gyro_x_rad_s\n1\n2\n", at_rate(100.0)).unwrap();
    assert_eq!((loaded.info.rate_hz, loaded.info.timebase()), (100.0, Timebase::Rate));
    for rate in [0.0, -1.0, f64::NAN] {
        assert!(matches!(folder.load("gyro_x_rad_s\n1\n", at_rate(rate)), Err(RecordingError::Rate { .. })));
    }
}

#[test]
fn stamps_that_determine_no_rate_are_refused() {
    let folder = Folder::new();
    for content in ["time_s,gyro_x_rad_s\n5,1\n", "time_s,gyro_x_rad_s\n5,1\n5,2\n"] {
        assert!(matches!(folder.load(content, Options::default()), Err(RecordingError::NoStep { samples: 1, .. })));
    }
}

#[test]
fn two_columns_for_one_channel_or_for_the_time_are_refused() {
    let folder = Folder::new();
    let error = folder.load("gyro_x_rad_s,gyro_x_dps\n1,1\n", at_rate(1.0)).unwrap_err().to_string();
    assert!(error.contains("gyro_x_rad_s") && error.contains("gyro_x_dps"), "{error}");
    let error = folder.load("time_s,gyro_x_rad_s,time_s\n1,1,1\n", at_rate(1.0)).unwrap_err();
    assert!(matches!(error, RecordingError::DuplicateTime { .. }));
}

#[test]
fn raw_lines_without_stamps_are_taken_at_forty_hertz_and_report_the_assumption() {
    let content: String = (0..5).map(|i| line(f64::from(i) * 1e-6) + "\r\n").collect();
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert_eq!((loaded.info.kind, loaded.info.stamps), (Kind::VnText, Stamps::None));
    assert_eq!((loaded.info.rate_hz, loaded.info.rate_assumed), (40.0, true));
    assert_eq!(values(&loaded, Channel::GyroX), [0.0, 1e-6, 2e-6, 3e-6, 4e-6]);
    assert_eq!(values(&loaded, Channel::AccelZ)[0], -9.965);
    assert_eq!(loaded.info.decimals.get(Channel::GyroX), Some(6));
    assert_eq!(loaded.info.decimals.get(Channel::MagX), Some(4));
    let overridden = Folder::new().load(&content, at_rate(50.0)).unwrap();
    assert_eq!((overridden.info.rate_hz, overridden.info.rate_assumed), (50.0, false));
}

#[test]
fn the_last_number_before_the_dollar_is_the_stamp() {
    let folder = Folder::new();
    for separator in ["\t", ",", " ", ", ", ";"] {
        let content: String = (0..4)
            .map(|i| format!("1710358267.9{separator}1710358267.{:09}{separator}{}\n", 25_000_000 * i, line(0.1)))
            .collect();
        let loaded = folder.load(&content, Options::default()).unwrap();
        assert_eq!((loaded.info.rate_hz, loaded.info.stamps), (40.0, Stamps::Unix), "{separator:?}");
        assert_eq!(loaded.info.started_utc_ns, MARCH_2024_NS);
        assert_eq!(loaded.samples, 4);
    }
    let content: String = (0..4).map(|i| format!("[12:30:0{i}] {}\n", line(0.1))).collect();
    let loaded = folder.load(&content, Options::default()).unwrap();
    assert_eq!((loaded.info.stamps, loaded.info.rate_hz), (Stamps::Relative, 1.0));
    let content: String = (0..4).map(|_| format!("desk: {}\n", line(0.1))).collect();
    let loaded = folder.load(&content, Options::default()).unwrap();
    assert_eq!((loaded.info.stamps, loaded.info.ignored_columns.len()), (Stamps::None, 1));
}

#[test]
fn a_raw_line_that_fails_its_checksum_is_one_missing_sample_where_nothing_else_decides() {
    let bad = line(0.5).replace("+00.500000", "+00.400000");
    let cut = &line(0.2)[40..];
    let reply = "$VNWRG,07,40*59";
    let content = [cut, &line(0.0), &line(0.1), &bad, &bad, reply, &line(0.2), "hello", &line(0.3), &bad].join("\n");
    let folder = Folder::new();
    let file = folder.file("raw", content.as_bytes());
    let recording = Recording::open(&file, Options::default()).unwrap();
    assert_eq!(recording.info().rejected[&DiscardCause::Checksum], 3);
    assert_eq!(recording.info().rejected[&DiscardCause::GarbageBytes], cut.len() as u64 + 5);
    assert_eq!(recording.info().first_rejected[1].line, 4);
    let mut accountant = RecordingAccountant::new(recording.info());
    let mut records = Vec::new();
    for item in recording.items().unwrap() {
        accountant.take(item.unwrap(), &mut records);
    }
    let gaps: Vec<Gap> = records
        .iter()
        .filter_map(|record| if let Record::Gap(gap) = record { Some(gap.clone()) } else { None })
        .collect();
    assert_eq!(shape(&gaps), [(2, 2, false, GapCause::Checksum)]);
    assert_eq!((gaps[0].from_utc_ns, gaps[0].to_utc_ns), (25_000_000, 100_000_000));
    let segments: Vec<_> = records
        .iter()
        .filter_map(|record| if let Record::Segment(segment) = record { Some(segment.first_seq) } else { None })
        .collect();
    assert_eq!(segments, [0, 2]);
    let discarded = records.iter().filter(|record| matches!(record, Record::Discarded { .. })).count();
    let events = records.iter().filter(|record| matches!(record, Record::Event(_))).count();
    assert_eq!((discarded, events), (5, 5));
    assert_eq!((accountant.received(), accountant.missing(), accountant.gaps()), (4, 2, 1));
}

#[test]
fn a_good_message_behind_a_spliced_one_is_still_a_sample() {
    let content = format!("{0}\n{0}\n$VNYMR,-134.051,-000{1}\n{0}\n$VNQTN,0,0,0,1*52\n{0}\n", line(0.1), line(0.2));
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert_eq!(values(&loaded, Channel::GyroX), [0.1, 0.1, 0.2, 0.1, 0.1]);
    assert_eq!(shape(&loaded.gaps), [(2, 1, false, GapCause::Checksum)]);
    let rejected = [(DiscardCause::Checksum, 1), (DiscardCause::UnexpectedFormat, 1)];
    assert_eq!(loaded.info.rejected, rejected.into());
}

#[test]
fn a_stamped_gap_in_which_a_line_failed_its_checksum_has_that_cause() {
    let bad = line(0.5).replace("+00.500000", "+00.400000");
    let content: String = (0..8)
        .filter(|i| *i != 5)
        .map(|i| format!("{} {}\n", f64::from(i) * 0.025, if i == 2 { bad.clone() } else { line(0.1) }))
        .collect();
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert_eq!(shape(&loaded.gaps), [(2, 1, true, GapCause::Checksum), (4, 1, true, GapCause::Source)]);
}

#[test]
fn a_stamped_recording_rejects_a_line_without_stamp() {
    let content = format!("0 {0}\n1 {0}\n{0}\n3 {0}\n4 {0}\n", line(0.1));
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert_eq!(loaded.info.rejected, [(DiscardCause::Malformed, 1)].into());
    assert_eq!((loaded.samples, loaded.missing), (4, 1));
}

#[test]
fn compressed_and_plain_files_give_the_same() {
    let folder = Folder::new();
    let content: String = (0..500).map(|i| line(f64::from(i) * 1e-6) + "\n").collect();
    let plain = load_columns(&folder.file("a", content.as_bytes()), Options::default()).unwrap();
    // Two members, as `cat a.gz b.gz` makes them.
    let (first, second) = content.split_at(content.len() / 2);
    let members = [gzip(first.as_bytes()), gzip(second.as_bytes())].concat();
    let packed = load_columns(&folder.file("b", &members), Options::default()).unwrap();
    assert_eq!(packed.columns, plain.columns);
}

#[test]
fn cut_compressed_data_are_reported_with_the_place_and_the_remedy() {
    let content: String = (0..20_000).map(|i| line(f64::from(i) * 1e-6) + "\n").collect();
    let mut packed = gzip(content.as_bytes());
    packed.truncate(packed.len() / 2);
    let folder = Folder::new();
    let error = load_columns(&folder.file("cut.gz", &packed), Options::default()).unwrap_err();
    let RecordingError::CutCompression { line, .. } = &error else { panic!("{error}") };
    assert!((5_000..15_000).contains(line), "{line}");
    assert!(error.to_string().contains("zcat"), "{error}");
}

#[test]
fn what_is_no_recording_is_refused_with_how_it_begins() {
    let folder = Folder::new();
    for (content, part) in [
        (&b"#ROSBAG V1.2\n"[..], "a ROS bag of another version"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "ends after 38 bytes"),
        (b"\xFA\x01\x29", "raw bytes of a VN-100"),
        (b"\x89PNG\r\n\x1a\n", "expected raw `$VN"),
        (b"", "is empty"),
        (b"\n \r\n\n", "is empty"),
        (b"time,gx,gy\n1,2,3\n", "time | gx | gy): no unit stands in the file, so check this guess"),
        (b"gyro_x,gyro_y\n1,2\n", "--columns 'gyro_x=gyro_x_rad_s,gyro_y=gyro_y_rad_s' --rate HZ"),
        (b"Tau,Adev\n1,2\n", "gyro_{x,y,z}_{rad_s,"),
    ] {
        let error = load_columns(&folder.file("other", content), at_rate(1.0)).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains("other"), "{error}");
    }
    let error = load_columns(&folder.0.path().join("absent.csv"), at_rate(1.0)).unwrap_err();
    assert!(matches!(error, RecordingError::Open { .. }), "{error}");
}

#[test]
fn an_error_shows_the_beginnings_of_names_that_are_long() {
    let long = "é\0".repeat(20_000);
    let table = |name: &str, map: &str| {
        let input = Input::memory("other", format!("{name},gyro_x_rad_s\n1,2\n3,4\n").as_bytes());
        let columns = ColumnMap::parse(&[map]).unwrap();
        Recording::read(input.with_columns(columns), at_rate(1.0)).unwrap_err().to_string()
    };
    for (name, map) in [
        ("a", format!("{long}=accel_x_g")),
        (&long, "#1=accel_x_g,#2=accel_x_g".to_owned()),
        (&long, "#1=time_s,#2=time_s".to_owned()),
        (&long, "#1=accel_x_counts".to_owned()),
    ] {
        let error = table(name, &map);
        assert!(error.contains('…') && error.len() < 4_000, "{} bytes", error.len());
    }
}

#[test]
fn a_recording_without_any_sample_is_refused_with_its_first_bad_line() {
    let folder = Folder::new();
    let error = folder.load("$VNYMR,1,2,3*00\n$VNYMR\n", Options::default()).unwrap_err().to_string();
    assert!(error.contains("2 lines, 2 of them rejected") && error.contains("line 1 (checksum)"), "{error}");
    let error = folder.load("time_s,gyro_x_rad_s\n", Options::default()).unwrap_err();
    assert!(matches!(error, RecordingError::NoSample { lines: 0, .. }));
}

#[test]
fn a_line_without_end_takes_bounded_memory() {
    let mut content = line(0.1) + "\n";
    content.push_str(&"x".repeat(1_000_000));
    content.push('\n');
    content.push_str(&line(0.2));
    let loaded = Folder::new().load(&content, Options::default()).unwrap();
    assert_eq!(values(&loaded, Channel::GyroX), [0.1, 0.2]);
    assert_eq!(loaded.info.rejected[&DiscardCause::GarbageBytes], 1_000_000);
    assert_eq!(loaded.missing, 0);
}

#[test]
fn the_real_desk_capture_has_30178_samples_and_no_rejected_line() {
    let Some(folder) = vn100_testkit::real_data("vn100-desk") else { return };
    let loaded = load_columns(&folder.join("live_capture.txt.gz"), Options::default()).unwrap();
    assert_eq!((loaded.samples, loaded.missing, loaded.info.rate_assumed), (30_178, 0, true));
    assert!(loaded.info.rejected.is_empty());
    assert_eq!(loaded.segments, std::slice::from_ref(&(0..30_178)));
    assert_eq!(loaded.columns.len(), 12);
    assert_eq!(values(&loaded, Channel::GyroX)[1], -0.000_023);
    assert_eq!(loaded.info.decimals.get(Channel::AccelX), Some(3));
}

#[test]
fn the_real_cart_recording_keeps_its_driver_stamps_and_rejects_the_spliced_lines() {
    let Some(folder) = vn100_testkit::real_data("vn100-cart") else { return };
    let file = folder.join("circle_carter.imu.raw.txt.gz");
    let loaded = load_columns(&file, Options::default()).unwrap();
    assert_eq!(loaded.samples, 3_875);
    assert_eq!(loaded.info.rejected, [(DiscardCause::Checksum, 5)].into());
    let lines: Vec<u64> = loaded.info.first_rejected.iter().map(|bad| bad.line).collect();
    assert_eq!(lines, [820, 1611, 2863, 3015, 3165]);
    assert_eq!((loaded.info.stamps, loaded.info.started_utc_ns), (Stamps::Unix, 1_710_358_267_715_127_945));
    let of = |cause| loaded.gaps.iter().filter(|gap| gap.cause == cause).collect::<Vec<_>>();
    let missing = |gaps: &[&Gap]| gaps.iter().map(|gap| gap.missing).sum::<u64>();
    let (source, checksum) = (of(GapCause::Source), of(GapCause::Checksum));
    // Its driver was throttled: steps of 25.77 ms and of 42 ms. The missing samples fill the span of the stamps.
    assert!((loaded.info.rate_hz - 38.8).abs() < 0.1, "{}", loaded.info.rate_hz);
    assert!((1_060..1_100).contains(&loaded.missing), "{}", loaded.missing);
    assert!((loaded.duration_s() - 127.85).abs() < 0.03, "{}", loaded.duration_s());
    assert_eq!(missing(&source) + missing(&checksum), loaded.missing);
    assert_eq!((checksum.len(), missing(&checksum)), (5, 5));
    let longest = loaded.gaps.iter().map(|gap| gap.to_utc_ns - gap.from_utc_ns).max();
    assert_eq!(longest, Some(1_297_774_791));
    let found = &loaded.info.findings;
    assert_eq!((found.steps, found.repeated_samples), (3_879, 0));
    assert!(values(&loaded, Channel::GyroZ).iter().all(|value| value.abs() < 35.0));
}

#[test]
fn the_real_adis16405_run_has_a_million_samples_at_the_given_rate() {
    let Some(folder) = vn100_testkit::real_data("adis16405") else { return };
    let loaded = load_columns(&folder.join("adis_16405_imu1.csv.gz"), at_rate(100.0)).unwrap();
    assert_eq!((loaded.samples, loaded.missing, loaded.info.rate_hz), (1_000_000, 0, 100.0));
    assert!(loaded.info.rejected.is_empty());
    assert_eq!(loaded.info.conversions.len(), 6);
    let first = values(&loaded, Channel::AccelZ)[0];
    assert!((first + 1.01565 * 9.80665).abs() < 1e-12, "{first}");
}

#[test]
fn real_stamped_recordings_of_other_sensors_are_read_whole() {
    let Some(folder) = vn100_testkit::real_data("") else { return };
    for (file, samples, missing, rate_hz) in [
        ("vn100-car/data_circle2_0.imu.raw.txt.gz", 2_617, 0, 40.000),
        ("broad/01_undisturbed_slow_rotation_A.csv.gz", 56_940, 0, 285.714),
        // Its stamps come in bursts.
        ("mpu6050/still-10min.csv.gz", 65_067, 0, 99.32),
    ] {
        let loaded = load_columns(&folder.join(file), Options::default()).unwrap();
        assert_eq!((loaded.samples, loaded.missing, loaded.info.rejected.len()), (samples, missing, 0), "{file}");
        assert!((loaded.info.rate_hz / rate_hz - 1.0).abs() < 2e-4, "{file}: {}", loaded.info.rate_hz);
    }
}

#[test]
fn a_csv_row_without_end_is_refused_before_it_fills_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    for (name, cell) in [("long.csv", "1".repeat(1 << 20)), ("quote.csv", format!("\"{}", "1\n".repeat(1 << 19)))] {
        let file = folder.path().join(name);
        std::fs::write(&file, format!("time_s,gyro_x_rad_s\n0,1\n0.025,{cell}")).unwrap();
        let error = Recording::open(&file, Options::default()).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
}

/// Returns an input with small limits of `expansion`: they are counted over the whole reading.
fn small_bounds(bytes: Vec<u8>) -> Input {
    let expansion = meter::Expansion { free_bytes: 100_000, ratio: 20, most_bytes: 1 << 30 };
    Input::memory("bomb", bytes).expanding(expansion)
}

#[test]
fn few_compressed_bytes_that_become_very_many_are_refused() {
    let rows = |count: usize| format!("time_s,gyro_x_rad_s\n{}", "\n".repeat(count));
    let error = Recording::read(small_bounds(gzip(rows(10_000_000).as_bytes())), Options::default()).unwrap_err();
    assert!(matches!(error, RecordingError::Expands { .. }), "{error}");
    assert!(error.to_string().starts_with("bomb: its first "), "{error}");
    // The same amount of a sensor's data does not exceed them.
    let mut text = String::from("time_s,gyro_x_rad_s\n");
    for row in 0..20_000_u64 {
        text += &format!("{}.{:03},{}\n", row / 40, row % 40 * 25, row * 7919 % 100_003);
    }
    assert_eq!(
        columns(&Recording::read(small_bounds(gzip(text.as_bytes())), Options::default()).unwrap()).unwrap().samples,
        20_000
    );
}

#[test]
fn chunks_of_a_bag_that_become_very_much_are_refused() {
    for compression in ["bz2", "lz4"] {
        let mut chunks = Vec::new();
        for _ in 0..40 {
            let mut records = bag::connection(0, "/imu", bag::IMU);
            records.extend(bag::message(0, MARCH_2024_NS as u64, &vec![0; 500_000]));
            chunks.push(bag::chunk(compression, &records));
        }
        let error = Recording::read(small_bounds(bag::bag(&chunks)), Options::default()).unwrap_err();
        assert!(matches!(error, RecordingError::Expands { .. }), "{compression}: {error}");
    }
}

#[test]
fn a_recording_that_is_no_longer_wanted_is_not_read_on() {
    let raw: String = (0..20_000).map(|index| line(1e-3 * f64::from(index % 100)) + "\n").collect();
    let mut records = bag::connection(0, "/raw", bag::TEXT);
    for index in 0..20_000 {
        let data = bag::string(&line(1e-3 * f64::from(index % 100)));
        records.extend(bag::message(0, MARCH_2024_NS as u64 + u64::from(index as u32) * 25_000_000, &data));
    }
    let bag = bag::bag(&[bag::chunk("lz4", &records)]);
    for (kind, bytes) in [("plain", raw.clone().into_bytes()), ("gzip", gzip(raw.as_bytes())), ("bag", bag)] {
        for asked in [1_usize, 4, 12] {
            let left = Arc::new(std::sync::atomic::AtomicUsize::new(asked));
            let counted = Arc::clone(&left);
            let keep_on = KeepOn::asking(move || {
                counted
                    .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| Some(left.saturating_sub(1)))
                    .is_ok_and(|before| before > 0)
            });
            let input = Input::memory("long", bytes.clone()).while_wanted(keep_on);
            let outcome = Recording::read(input, Options::default()).and_then(|recording| columns(&recording));
            assert!(matches!(outcome, Err(RecordingError::Unwanted { .. })), "{kind} {asked}: {outcome:?}");
            assert_eq!(left.load(Ordering::Relaxed), 0);
        }
    }
}

#[test]
fn a_pipe_a_device_and_a_folder_are_no_files_and_nothing_waits_for_them() {
    let folder = Folder::new();
    let pipe = folder.0.path().join("pipe");
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR).unwrap();
    for (path, found) in [(pipe.as_path(), "a pipe"), (Path::new("/dev/zero"), "a device")] {
        let error = Recording::open(path, Options::default()).unwrap_err();
        assert!(matches!(error, RecordingError::NoFile { found: actual, .. } if actual == found), "{error}");
    }
    let error = Recording::open(folder.0.path(), Options::default()).unwrap_err();
    assert!(matches!(error, RecordingError::Folder { .. }), "{error}");
    // Of several bags none is chosen.
    folder.file("b_0.mcap", b"");
    folder.file("b_1.mcap", b"");
    folder.file("metadata.yaml", b"");
    let error = Recording::open(folder.0.path(), Options::default()).unwrap_err().to_string();
    assert!(error.contains("a folder with b_0.mcap, b_1.mcap"), "{error}");
}

#[test]
fn raw_lines_in_the_cells_of_a_table_have_the_stamps_of_their_rows() {
    let raw = |index: u32| line(f64::from(index) * 1e-3);
    let stamp = |index: u32| format!("{:.3}", 1_710_358_267.0 + 0.025 * f64::from(index));
    let quoted: [(&str, &dyn Fn(u32) -> String); 5] = [
        ("plain", &|index| format!("{},\"{}\"\n", stamp(index), raw(index))),
        ("of Python", &|index| format!("{},\"b'{}\\r\\n'\"\n", stamp(index), raw(index))),
        ("with a line end", &|index| format!("{},\"{}\r\n\"\n", stamp(index), raw(index))),
        ("unquoted", &|index| format!("{},{}\n", stamp(index), raw(index))),
        ("of rostopic", &|index| {
            format!("{},{}\n", 1_710_358_267_000_000_000 + 25_000_000 * u64::from(index), raw(index))
        }),
    ];
    for (kind, row) in quoted {
        for header in ["", "time,data\n"] {
            let content = format!("{header}{}", (0..100).map(row).collect::<String>());
            let loaded = Folder::new().load(&content, Options::default()).unwrap();
            assert_eq!(
                (loaded.samples, loaded.missing, loaded.info.stamps),
                (100, 0, Stamps::Unix),
                "{kind} {header:?}"
            );
            assert!((loaded.info.rate_hz - 40.0).abs() < 0.01, "{kind}: {}", loaded.info.rate_hz);
            assert!((values(&loaded, Channel::GyroX)[99] - 0.099).abs() < 1e-9, "{kind}");
            assert!(loaded.info.rejected.is_empty(), "{kind} {header:?}: {:?}", loaded.info.first_rejected);
        }
    }
}

#[test]
fn one_corrupt_stamp_costs_its_own_sample_and_no_other() {
    let mut text = String::from("time_s,gyro_x_rad_s\n");
    for row in 0..1000 {
        let time_s = if row == 300 { 987_654.0 } else { f64::from(row) * 0.025 };
        text += &format!("{time_s:.3},{row}\n");
    }
    let loaded = Folder::new().load(&text, Options::default()).unwrap();
    assert_eq!((loaded.samples, loaded.missing, loaded.info.rate_hz), (999, 1, 40.0));
    assert_eq!(loaded.info.rejected, std::collections::BTreeMap::from([(DiscardCause::Malformed, 1)]));
    let rejected = &loaded.info.first_rejected[0];
    assert_eq!((rejected.line, rejected.text.as_str()), (302, "stamp 987654 s lies ahead of those that follow"));
    assert_eq!(shape(&loaded.gaps), [(300, 1, true, GapCause::Source)]);
}
