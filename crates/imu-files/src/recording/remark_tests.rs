//! Reports about a recording: how foreign columns are understood, which oddities are found, and that none are reported
//! without cause.

use super::*;
use imu_core::sample::{Channel, DiscardCause};
use std::io::{Seek as _, Write as _};
use std::time::{Duration, Instant};

const GYRO: [&str; 3] = ["gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s"];

fn read(text: &str, pairs: &[&str], options: Options) -> Result<Recording, RecordingError> {
    let input = Input::memory("desk.csv", text.as_bytes().to_vec()).with_columns(ColumnMap::parse(pairs).unwrap());
    Recording::read(input, options)
}

fn remarks_of(text: &str) -> Vec<String> {
    read(text, &[], Options::default()).unwrap().info().remarks()
}

fn assert_remark(remarks: &[String], words: &[&str]) {
    let has = |remark: &String| words.iter().all(|word| remark.contains(word));
    assert!(remarks.iter().any(has), "{words:?} in none of {remarks:#?}");
}

fn assert_no_remark(remarks: &[String], word: &str) {
    assert!(remarks.iter().all(|remark| !remark.contains(word)), "{word}: {remarks:#?}");
}

/// Returns noise that is the same in every run, with a standard deviation near 1.
fn noise(state: &mut u64) -> f64 {
    let mut sum = 0.0;
    for _ in 0..12 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        sum += (*state >> 11) as f64 / (1_u64 << 53) as f64;
    }
    sum - 6.0
}

/// Returns a sensor that rests (or rocks about two axes): rate, acceleration and field in its channels' units.
fn rows(rocks: bool) -> Vec<[f64; 9]> {
    let (mut state, mut gravity) = (7, [0.0, 0.0, -9.8]);
    (0..6000)
        .map(|index| {
            let phase = f64::from(index) * 0.025;
            let rate = if rocks { [0.9 * phase.cos(), 0.7 * (0.6 * phase).sin(), 0.2] } else { [0.0; 3] };
            let step = rate.map(|rate| 0.025 * rate);
            let change = [
                gravity[1] * step[2] - gravity[2] * step[1],
                gravity[2] * step[0] - gravity[0] * step[2],
                gravity[0] * step[1] - gravity[1] * step[0],
            ];
            gravity = [0, 1, 2].map(|axis| gravity[axis] + change[axis]);
            let length = gravity.iter().map(|axis| axis * axis).sum::<f64>().sqrt();
            gravity = gravity.map(|axis| 9.8 * axis / length);
            let mut noisy = |value: f64, sigma: f64| value + sigma * noise(&mut state);
            let [gx, gy, gz] = rate.map(|rate| noisy(rate, 0.001));
            let [ax, ay, az] = gravity.map(|axis| noisy(axis, 0.02));
            let [mx, my, mz] = [0.2, -0.1, 0.42].map(|axis| noisy(axis, 0.002));
            [gx, gy, gz, ax, ay, az, mx, my, mz]
        })
        .collect()
}

/// Returns the rows as a CSV whose columns claim the channels' units, with the values multiplied by these factors.
fn claimed(rocks: bool, [gyro, accel, mag]: [f64; 3]) -> String {
    let mut text = format!(
        "time_s,{},accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,mag_x_gauss,mag_y_gauss,mag_z_gauss\n",
        GYRO.join(",")
    );
    for (index, row) in rows(rocks).iter().enumerate() {
        let cells: Vec<String> = row
            .iter()
            .zip([gyro, gyro, gyro, accel, accel, accel, mag, mag, mag])
            .map(|(value, factor)| format!("{:.6}", value * factor))
            .collect();
        text += &format!("{:.3},{}\n", index as f64 * 0.025, cells.join(","));
    }
    text
}

#[test]
fn a_unit_that_the_values_contradict_is_reported_with_the_one_that_fits_and_nothing_is_converted() {
    let degrees = 1.0_f64.to_degrees();
    for rocks in [false, true] {
        let remarks = remarks_of(&claimed(rocks, [1.0, 1.0, 1.0]));
        assert_no_remark(&remarks, "does not look like");
        let recording = read(&claimed(rocks, [degrees, 1.0, 1.0]), &[], Options::default()).unwrap();
        assert_remark(
            &recording.info().remarks(),
            &["gyro does not look like rad/s", "gyro_x_deg_s", "nothing was changed"],
        );
        let loaded = columns(&recording).unwrap();
        let first = loaded.column(Channel::GyroZ).unwrap().values[0];
        assert!((first - rows(rocks)[0][2] * degrees).abs() < 1e-5, "{first}");
    }
    assert_remark(
        &remarks_of(&claimed(false, [1.0, 1.0 / 9.80665, 1.0])),
        &["accel does not look like m/s²", "accel_x_g", "|a| is 0.99"],
    );
    assert_remark(
        &remarks_of(&claimed(false, [1.0, 1000.0 / 9.80665, 1.0])),
        &["accel does not look like m/s²", "accel_x_mg"],
    );
    assert_remark(
        &remarks_of(&claimed(false, [1.0, 16_384.0 / 9.80665, 1.0])),
        &["accel does not look like m/s²", "counts"],
    );
    assert_remark(
        &remarks_of(&claimed(false, [1.0, 1.0, 100.0])),
        &["mag does not look like gauss", "mag_x_ut", "|m| is 47"],
    );
}

/// About the vertical, gravity shows no turning: the motion of a rate table is no noise.
#[test]
fn turning_about_the_vertical_is_no_noise() {
    let mut text = format!("time_s,{},accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n", GYRO.join(","));
    let mut state = 5;
    for index in 0..20_000 {
        let time = f64::from(index) * 0.01;
        let turned =
            [0.0, 0.0, (time * std::f64::consts::TAU / 10.0).sin()].map(|rate| rate + 0.001 * noise(&mut state));
        let felt = [0.0, 0.0, -9.8].map(|accel| accel + 0.02 * noise(&mut state));
        let cells: Vec<String> = turned.iter().chain(&felt).map(|value| format!("{value:.6}")).collect();
        text += &format!("{time:.3},{}\n", cells.join(","));
    }
    assert_no_remark(&remarks_of(&text), "does not look like");
}

#[test]
fn stamps_that_stand_still_or_come_late_are_counted_and_reported() {
    let mut text = String::from("time_s,gyro_x_rad_s\n");
    let mut state = 3;
    for index in 0..400_i32 {
        // Two runs stand still; one row comes 50 ms late.
        let at = match index {
            100..=104 => 100,
            200..=201 => 200,
            300 => 297,
            index => index,
        };
        text += &format!("{:.3},{:.6}\n", f64::from(at) * 0.025, noise(&mut state));
    }
    let recording = read(&text, &[], Options::default()).unwrap();
    let found = &recording.info().findings;
    assert_eq!((found.frozen_stamps, found.frozen_runs, found.longest_frozen_run, found.late_stamps), (5, 2, 4, 1));
    assert_eq!(found.latest_by_s, Some(0.05));
    assert_eq!(recording.info().rejected, [(DiscardCause::Duplicate, 6)].into());
    let remarks = recording.info().remarks();
    assert_remark(&remarks, &["5 stamps repeat the one before, in 2 runs of up to 4"]);
    assert_remark(&remarks, &["1 stamp lies before the one before, by up to 0.05 s"]);
}

#[test]
fn a_stated_rate_that_the_stamps_contradict_is_reported_and_a_comment_gives_one_to_unstamped_rows() {
    let stamped = "# rate: 100 Hz\ntime_s,gyro_x_rad_s\n0,1\n0.025,2\n0.05,4\n";
    let recording = read(stamped, &[], Options::default()).unwrap();
    assert_eq!((recording.info().rate_hz, recording.info().unused_rate_hz), (40.0, Some(100.0)));
    assert_remark(&recording.info().remarks(), &["the rate of 100 Hz of a comment is not used", "a grid of 40.0 Hz"]);
    let plain = read("% sampling rate 100 Hz\ngyro_x_rad_s\n1\n2\n", &[], Options::default()).unwrap();
    assert_eq!((plain.info().rate_hz, plain.info().unused_rate_hz), (100.0, None));
    let options = Options { rate_hz: Some(50.0), ..Options::default() };
    assert_eq!(read("# rate=100\ngyro_x_rad_s\n1\n2\n", &[], options).unwrap().info().rate_hz, 50.0);
}

#[test]
fn axes_in_different_units_are_each_converted_and_reported() {
    let text =
        "time_s,accel_x_g,accel_y_m_s2,gyro_x_deg_s,gyro_y_deg_s\n0,1,9.5,1,2\n0.025,1.1,9.6,2,3\n0.05,1,9,3,1\n";
    assert_remark(&remarks_of(text), &["different units (accel_x in g, accel_y in m/s²)"]);
    assert_no_remark(&remarks_of(text), "gyro_x in");
}

#[test]
fn foreign_columns_are_what_the_user_states_by_name_or_place_whatever_divides_them() {
    let pairs = ["Time [ms]=time_ms,GyroX(dps)=gyro_x_dps", "az=accel_z_g"];
    for (delimiter, quote) in [(",", ""), (";", ""), ("\t", ""), (",", "\"")] {
        let header =
            ["note", "Time [ms]", "az", "GyroX(dps)"].map(|name| format!("{quote}{name}{quote}")).join(delimiter);
        let mut text = format!("{header}\r\n");
        for index in 0..40 {
            let cells = ["x".to_owned(), format!("{}", 25 * index), "-1".to_owned(), "180".to_owned()];
            text += &format!("{}\r\n", cells.join(delimiter));
        }
        let recording = read(&text, &pairs, Options::default()).unwrap();
        let info = recording.info();
        assert_eq!((info.rate_hz, info.samples, info.ignored_columns.as_slice()), (40.0, 40, &["note".to_owned()][..]));
        assert_eq!(info.stamp_choice.as_ref().map(|choice| choice.name.as_str()), Some("Time [ms]"));
        let loaded = columns(&recording).unwrap();
        assert_eq!(loaded.column(Channel::AccelZ).unwrap().values, [-9.80665; 40]);
        assert!(
            loaded
                .column(Channel::GyroX)
                .unwrap()
                .values
                .iter()
                .all(|rate| (rate - std::f64::consts::PI).abs() < 1e-15)
        );
    }
    // With positions no header line is needed; with a pair by name there is one.
    let bare = "1000000,0.5,7\n1025000,0.25,8\n1050000,0.75,9\n";
    let recording = read(bare, &["#1=time_us", "#2=gyro_y_rad_s"], Options::default()).unwrap();
    assert_eq!((recording.info().samples, recording.info().rate_hz), (3, 40.0));
    assert_eq!(recording.info().ignored_columns, ["#3"]);
    let nanos = "t,g\n1710358267000000000,0.5\n1710358267025000000,0.25\n1710358267050000000,1\n";
    let recording = read(nanos, &["t=time_ns,g=gyro_x_rad_s"], Options::default()).unwrap();
    assert_eq!((recording.info().stamps, recording.info().rate_hz), (Stamps::Unix, 40.0));
}

#[test]
fn columns_that_are_not_there_or_contradict_are_refused_with_what_is_there() {
    let refused = |text: &str, pairs: &[&str]| read(text, pairs, Options::default()).unwrap_err().to_string();
    let text = "t,ax,ay\n0,1,2\n1,1,2\n";
    for (pairs, words) in [
        (&["az=accel_z_g"][..], ["no column is \"az\"", "t | ax | ay"]),
        (&["#9=accel_z_g"], ["#9 (it has 3 columns)", "t | ax | ay"]),
        (&["ax=accel_x_g,ay=accel_x_g"], ["\"ax\" and \"ay\"", "accel_x"]),
        (&["t=time_s,ax=time_ms,ay=accel_x_g"], ["both give the time", "leave one of them out"]),
        (&[], ["--columns", "t | ax | ay"]),
    ] {
        let error = refused(text, pairs);
        assert!(error.contains("desk.csv") && words.iter().all(|word| error.contains(word)), "{pairs:?}: {error}");
    }
    let raw = "$VNYMR,+1*00\n$VNYMR,+1*00\n";
    let error = refused(raw, &["ax=accel_x_g"]);
    assert!(error.contains("raw `$VN…` lines") && error.contains("leave --columns out"), "{error}");
}

#[test]
fn the_first_decimal_sign_is_that_of_the_table() {
    let text = "time_s;gyro_x_rad_s\n0;0,5\n0,025;-0,25\n0,05;0,125\n0,075;1.5\n0,1;7\n0,125;1,2,3\n0,15;-1,5e-3\n";
    let recording = read(text, &[], Options::default()).unwrap();
    let values = columns(&recording).unwrap().columns[0].values.clone();
    assert_eq!(values, [0.5, -0.25, 0.125, 7.0, -1.5e-3]);
    assert_eq!(recording.info().rejected, [(DiscardCause::Malformed, 2)].into());
    assert_eq!(recording.info().rate_hz, 40.0);
    // Once a point was read, a comma separates thousands, and its row is rejected.
    let text = "time_s;gyro_x_rad_s\n0.0;0.5\n0.025;1,234\n0.05;0.125\n";
    let recording = read(text, &[], Options::default()).unwrap();
    assert_eq!((recording.info().samples, &recording.info().rejected), (2, &[(DiscardCause::Malformed, 1)].into()));
}

#[test]
fn a_csv_that_was_cut_loses_its_last_row_alone() {
    let whole = claimed(false, [1.0; 3]);
    let lines = whole.lines().count() as u64;
    // In the middle of the last row.
    let cut = &whole[..whole.len() - 40];
    let recording = read(cut, &[], Options::default()).unwrap();
    assert_eq!((recording.info().samples, &recording.info().rejected), (5999, &[(DiscardCause::Malformed, 1)].into()));
    assert_eq!(recording.info().first_rejected[0].line, lines);
}

/// Garbage of ten gigabytes is refused as soon as its beginning was examined, or read in little memory.
#[test]
fn ten_gigabytes_of_garbage_are_refused_at_once_with_file_and_place() {
    let folder = tempfile::tempdir().unwrap();
    let text: String =
        (0..200_000_u32).map(|index| char::from(b'!' + (index.wrapping_mul(2_654_435_761) >> 24) as u8 % 90)).collect();
    let text = text.replace("$VN", "xxx").replace(['"', '#', '%'], "x");
    let header = format!("time_s,gyro_x_rad_s\n0,1\n{}", "z".repeat(70_000));
    for (name, head, words) in [
        ("zeros", "", ["line 1 begins with", "expected raw `$VN…` lines"]),
        ("text", text.as_str(), ["text", "expected raw `$VN…` lines"]),
        ("header.csv", header.as_str(), ["beyond line 2", "expected one sample a line"]),
        ("old.bag", "#ROSBAG V2.0\n", ["old.bag", ""]),
        ("cut.db3", "SQLite format 3\0", ["cut.db3", "SQLite"]),
        ("cut.mcap", "\u{FFFD}", ["cut.mcap", ""]),
    ] {
        let path = folder.path().join(name);
        let mut file = std::fs::File::create(&path).unwrap();
        if name == "cut.mcap" {
            file.write_all(&[0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n']).unwrap();
        } else {
            file.write_all(head.as_bytes()).unwrap();
        }
        file.set_len(10 << 30).unwrap();
        file.rewind().unwrap();
        let begun = Instant::now();
        let error = Recording::open(&path, Options::default()).unwrap_err().to_string();
        assert!(error.contains(name) && words.iter().all(|word| error.contains(word)), "{name}: {error}");
        assert!(begun.elapsed() < Duration::from_secs(10), "{name}: {:?}", begun.elapsed());
    }
}

/// For each real recording the facts that its README states are found, and no unit is doubted.
#[test]
fn the_facts_of_real_recordings_are_reported_and_no_unit_is_doubted() {
    let Some(folder) = vn100_testkit::real_data("") else { return };
    for (file, rate_hz, words) in [
        ("vn100-desk/live_capture.txt.gz", None, &[][..]),
        (
            "vn100-desk/calibration_square.bag",
            None,
            &["they come in pairs: steps of 0.0193 ms and of 43.94 ms take turns"],
        ),
        (
            "vn100-cart/circle_carter.bag",
            None,
            &["a grid of 38.8 Hz", "samples are missing in", "the longest is 1.314 s"],
        ),
        ("vn100-car/data_circle2_0.imu.raw.txt.gz", None, &["a grid of 40.0 Hz, with a jitter of 0.1"]),
        ("vn100-1hz/Adrian_stationary_0.db3", None, &["the rate is 1.0 Hz"]),
        (
            "vn100-1hz/data_going_in_circles_0.db3",
            None,
            &["the rate is 1.0 Hz", "4796 samples are missing in 1 gap; the longest is 4797."],
        ),
        ("adis16405/adis_16405_imu1.csv.gz", Some(100.0), &["0.00333 g", "0.05 deg/s"]),
        ("broad/24_disturbed_tapping_A.csv.gz", None, &["0.00479 m/s²"]),
        ("broad/28_disturbed_stationary_magnet_A.csv.gz", None, &["0.001065 rad/s"]),
        ("mpu6050/still-10min.csv.gz", None, &["jitter too much", "the rate of 99.3 Hz is their mean"]),
    ] {
        let recording = Recording::open(&folder.join(file), Options { rate_hz, ..Options::default() }).unwrap();
        let remarks = recording.info().remarks();
        assert!(recording.info().findings.doubts.is_empty(), "{file}: {remarks:#?}");
        assert_no_remark(&remarks, "pairs or bursts");
        words.iter().for_each(|word| assert_remark(&remarks, &[word]));
    }
}
