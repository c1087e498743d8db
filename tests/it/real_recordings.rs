//! The table of docs/recordings.md: every real recording, with the program's findings.
//!
//! If the recordings are available, the page must agree with the present findings to the letter; `VN100D_BLESS=1`
//! writes it.

use imu_files::recording::{LoadedRecording, Options, load_columns};
use std::fmt::Write as _;
use std::path::Path;
use vn100_testkit::real_data;

const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/recordings.md");
/// The test's output stands between these two lines of the page.
const BEGIN: &str = "<!-- found by the program: cargo test --test it real_recordings -->\n";
const END: &str = "<!-- end of what the program found -->\n";
/// Recordings, and the rate of those without stamps whose rate is not the sensor's own.
const RECORDINGS: [(&str, Option<f64>); 48] = [
    ("vn100-desk/live_capture.txt.gz", None),
    ("vn100-desk/calibration_square.bag", None),
    ("vn100-cart/circle_carter.bag", None),
    ("vn100-cart/circle_carter.imu.raw.txt.gz", None),
    ("vn100-car/data_circle2_0.db3", None),
    ("vn100-car/data_circle2_0.imu.raw.txt.gz", None),
    ("vn100-1hz/Adrian_stationary_0.db3", None),
    ("vn100-1hz/data_going_in_circles_0.db3", None),
    ("adis16405/adis_16405_imu1.csv.gz", Some(100.0)),
    ("adis16405/adis_16405_imu2.csv.gz", Some(100.0)),
    ("broad/01_undisturbed_slow_rotation_A.csv.gz", None),
    ("broad/24_disturbed_tapping_A.csv.gz", None),
    ("broad/26_disturbed_phone_vibration_A.csv.gz", None),
    ("broad/28_disturbed_stationary_magnet_A.csv.gz", None),
    ("mpu6050/still-10min.csv.gz", None),
    ("adis16405/adis_16405_imu3_first200k.csv.gz", Some(100.0)),
    ("asen3801/ango_10-7-25_GYRO_MAN_F1_C0pt5.csv.gz", None),
    ("asen3801/ango_GYRO_AUTO_F0pt2_C0pt5.csv.gz", None),
    ("broad/02_undisturbed_slow_rotation_B.csv.gz", None),
    ("broad/06_undisturbed_fast_rotation_A.csv.gz", None),
    ("broad/21_undisturbed_fast_combined.csv.gz", None),
    ("broad/25_disturbed_tapping_B.csv.gz", None),
    ("broad/32_disturbed_attached_magnet_1cm.csv.gz", None),
    ("imu_tk_xsens/xsens.counts.csv.gz", None),
    ("memsense/turn_on_01.csv.gz", None),
    ("memsense/turn_on_02.csv.gz", None),
    ("memsense/turn_on_03.csv.gz", None),
    ("memsense/turn_on_04.csv.gz", None),
    ("memsense/turn_on_05.csv.gz", None),
    ("memsense/turn_on_06.csv.gz", None),
    ("mikoff_mpu9150/imu0.csv.gz", None),
    ("mikoff_mpu9150/imu1.csv.gz", None),
    ("mikoff_mpu9150/imu2.csv.gz", None),
    ("px4_ulog/sample_log_small.ulg", None),
    ("repoimu/Pendulum_Test03_Trial1_Segment_1.csv.gz", None),
    ("repoimu/Pendulum_Test05_Trial1_Segment_3.csv.gz", None),
    ("repoimu/TStick_Test01_Static.csv.gz", None),
    ("repoimu/TStick_Test04_Trial1.csv.gz", None),
    ("repoimu/TStick_Test07_Trial1.csv.gz", None),
    ("repoimu/TStick_Test10_Trial1.csv.gz", None),
    ("seoul_tumble/imu_good3.csv.gz", None),
    ("xsens_dot/x_stat_1.csv.gz", None),
    ("xsens_dot/x_stat_2.csv.gz", None),
    ("xsens_dot/x_stat_3.csv.gz", None),
    ("xsens_dot/x_stat_4.csv.gz", None),
    ("vn100-desk/oadev_gyro_x.csv.gz", None),
    ("allan-curves/ln200_av.csv", None),
    ("allan-curves/vn100_gyro_7h.csv", None),
];

#[test]
fn the_page_states_what_is_found_in_every_real_recording() {
    let Some(folder) = real_data("") else { return };
    let (mut rows, mut remarks) = (String::new(), String::new());
    for (name, rate_hz) in RECORDINGS {
        let options = Options { rate_hz, started_utc_ns: 0, ..Options::default() };
        let row = match load_columns(&folder.join(name), options) {
            Ok(found) => {
                writeln!(remarks, "{name}").unwrap();
                for remark in found.info.remarks() {
                    writeln!(remarks, "  {remark}").unwrap();
                }
                row(&found, rate_hz)
            }
            Err(error) => {
                let sentence = error.to_string().replace(&*folder.join("").to_string_lossy(), "");
                format!("refused: {} | | |", sentence.split(": say which").next().unwrap().replace('|', "·"))
            }
        };
        writeln!(rows, "| {name} | {row} |").unwrap();
    }
    let found = format!(
        "\n| recording | samples | rate | rejected | missing |\n|---|---|---|---|---|\n{rows}\nAnd said of each, word for word:\n\n\
         ```text\n{remarks}```\n\n"
    );
    let page = std::fs::read_to_string(PAGE).unwrap();
    let (before, rest) = page.split_once(BEGIN).expect("the page marks where the table begins");
    let (table, behind) = rest.split_once(END).expect("the page marks where the table ends");
    if std::env::var_os("VN100D_BLESS").is_some() {
        std::fs::write(PAGE, [before, BEGIN, &found, END, behind].concat()).unwrap();
    } else {
        assert_eq!(table, found, "VN100D_BLESS=1 writes what is found now");
    }
}

fn row(found: &LoadedRecording, given_hz: Option<f64>) -> String {
    let info = &found.info;
    let origin = if given_hz.is_some() {
        " (told)"
    } else if info.rate_assumed {
        " (assumed)"
    } else {
        ""
    };
    let rejected: Vec<String> =
        info.rejected.iter().map(|(cause, count)| format!("{count} ({})", cause.name())).collect();
    let rejected = if rejected.is_empty() { "none".to_owned() } else { rejected.join(", ") };
    let missing = match (found.missing, found.gaps.len(), info.findings.longest_gap_s) {
        (0, _, _) => "none".to_owned(),
        (missing, 1, Some(longest_s)) => format!("{missing} in 1 gap, of {longest_s:.3} s"),
        (missing, gaps, Some(longest_s)) => format!("{missing} in {gaps} gaps, the longest of {longest_s:.3} s"),
        (missing, gaps, None) => format!("{missing} in {gaps} gaps"),
    };
    format!("{} | {} Hz{origin} | {rejected} | {missing}", found.samples, shown_rate(info.rate_hz))
}

/// Returns the rate as `import` prints it, without the last digits, which are jitter.
fn shown_rate(rate_hz: f64) -> String {
    let text = format!("{rate_hz:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[test]
fn every_recording_there_is_is_in_the_table() {
    let Some(folder) = real_data("") else { return };
    for entry in folders(&folder) {
        let name = entry.strip_prefix(&folder).unwrap().display().to_string();
        let listed = RECORDINGS.iter().any(|(listed, _)| *listed == name);
        // Curves, deviations and references are not recordings: one curve of each kind shows how it is refused.
        let is_reference = [".optical.", ".vicon.", ".encoder.", ".json"].iter().any(|mark| name.contains(mark));
        let is_curve = name.starts_with("allan-curves/") || name.contains("oadev");
        assert!(listed || is_reference || is_curve, "{name} is not in the table");
    }
}

fn folders(folder: &Path) -> Vec<std::path::PathBuf> {
    let inside = |path: &Path| std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>();
    inside(folder).into_iter().filter(|path| path.is_dir()).flat_map(|path| inside(&path)).collect()
}
