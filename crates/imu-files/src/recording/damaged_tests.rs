//! Odd files: a broken part costs only itself and is reported.

use super::*;
use imu_core::sample::{Channel, DiscardCause};

fn read(text: &[u8], options: Options) -> Result<Recording, RecordingError> {
    Recording::read(Input::memory("odd.csv", text.to_vec()), options)
}

fn at_40_hz() -> Options {
    Options { rate_hz: Some(40.0), ..Options::default() }
}

fn assert_remark(recording: &Recording, words: &[&str]) {
    let remarks = recording.info().remarks();
    assert!(remarks.iter().any(|remark| words.iter().all(|word| remark.contains(word))), "{words:?}: {remarks:#?}");
}

fn lines_rejected(recording: &Recording) -> Vec<u64> {
    recording.info().first_rejected.iter().map(|rejected| rejected.line).collect()
}

#[test]
fn a_quotation_mark_left_open_costs_its_own_line() {
    let mut text = String::from("gyro_x_rad_s,note\n");
    for index in 0..5000 {
        text += &match index {
            10 => format!("{index},\"left open\n"),
            20 => format!("\"{index}\",\"closed, \"\"too\"\"\"\n"),
            _ => format!("{index},plain\n"),
        };
    }
    let recording = read(text.as_bytes(), at_40_hz()).unwrap();
    assert_eq!((recording.info().samples, lines_rejected(&recording)), (4999, vec![12]));
    // Two of them, one at the end: nothing in between is consumed.
    let text = "gyro_x_rad_s,note\n1,\"a\n2,b\n3,\"c\n4,d\n5,\"";
    let recording = read(text.as_bytes(), at_40_hz()).unwrap();
    assert_eq!((recording.info().samples, lines_rejected(&recording)), (2, vec![2, 4, 6]));
}

#[test]
fn only_the_rate_of_samples_is_taken_from_a_comment() {
    for comment in [
        "# baud rate: 115200",
        "# baudrate 115200",
        "# bit-rate = 5",
        "# data rate: 5",
        "# integrate 5",
        "# rate 5 kHz",
        "# gyro rate: 5 Hz",
    ] {
        let text = format!("{comment}\ngyro_x_rad_s\n1\n2\n");
        let refused = read(text.as_bytes(), Options::default()).unwrap_err();
        assert!(matches!(refused, RecordingError::NoRate { .. }), "{comment}: {refused}");
    }
    for comment in [
        "# rate: 50 Hz",
        "# rate_hz = 50",
        "% Sampling Rate (Hz): 50",
        "# samplerate 50hz",
        "# VN-100, output_rate=50",
        "# baud rate: 115200, rate: 50",
    ] {
        let text = format!("{comment}\ngyro_x_rad_s\n1\n2\n");
        let recording = read(text.as_bytes(), Options::default()).unwrap();
        assert_eq!(recording.info().rate_hz, 50.0, "{comment}");
        assert_remark(&recording, &["50 Hz", "a comment"]);
        let overridden = read(text.as_bytes(), at_40_hz()).unwrap();
        assert_eq!((overridden.info().rate_hz, overridden.info().findings.commented_rate_hz), (40.0, None));
    }
}

#[test]
fn the_stamp_of_a_rejected_row_still_counts() {
    let mut text = String::from("time_s,gyro_x_rad_s,gyro_y_rad_s\n");
    for index in 0..100 {
        let time = f64::from(index) * 0.025;
        text += &match index {
            50 => format!("{time:.3},bad,1\n"),
            51 => format!("{time:.3},2\n"),
            52 => format!("{time:.3},\"2,3\n"),
            _ => format!("{time:.3},1.{index},2\n"),
        };
    }
    let recording = read(text.as_bytes(), Options::default()).unwrap();
    let at: Vec<_> = recording
        .items()
        .unwrap()
        .filter_map(|item| match item.unwrap() {
            Item::Rejected(rejected) => Some(rejected.at.map(|(device_ns, _)| device_ns)),
            Item::Sample(..) => None,
        })
        .collect();
    assert_eq!(at, [Some(1_250_000_000), Some(1_275_000_000), Some(1_300_000_000)]);
    assert_eq!(columns(&recording).unwrap().missing, 3);
}

#[test]
fn lines_that_end_with_a_carriage_return_alone_are_read_however_many_they_are() {
    let mut text = String::from("# old\rtime_s,gyro_x_rad_s\r");
    for index in 0..20_000 {
        text += &match index {
            0 => "0,0\r\r".to_owned(),
            15_000 => "375,bad\r".to_owned(),
            _ => format!("{:.3},{index}\r", f64::from(index) * 0.025),
        };
    }
    assert!(text.len() > 4 * 65_536);
    let recording = read(text.as_bytes(), Options::default()).unwrap();
    assert_eq!((recording.info().samples, lines_rejected(&recording)), (19_999, vec![15_004]));
    let loaded = columns(&recording).unwrap();
    let found = &loaded.column(Channel::GyroX).unwrap().values;
    assert!(
        found.iter().zip((0..20_000).filter(|index| *index != 15_000)).all(|(value, index)| *value == f64::from(index))
    );
}

#[test]
fn the_bytes_of_garbage_are_those_of_the_file() {
    let mut text = b"$VNYMR,-134.051,-000.443,-000.892,-00.1575,+00.1599,+00.3040,-00.077,+00.164,-09.965,+00.001309,+00.001325,+00.000043".to_vec();
    let checksum = text[1..].iter().fold(0, |sum, byte| sum ^ byte);
    text.extend(format!("*{checksum:02X}\n").bytes());
    text.extend([0xFF; 10]);
    text.extend(b"\n");
    let recording = read(&text, Options::default()).unwrap();
    assert_eq!(recording.info().rejected, [(DiscardCause::GarbageBytes, 10)].into());
}

/// Returns a valid `$VNYMR` line.
fn line(index: usize) -> String {
    let gyro = index as f64 * 1e-6;
    let body = format!(
        "VNYMR,-134.051,-000.443,-000.892,-00.1575,+00.1599,+00.3040,-00.077,+00.164,-09.965,{gyro:+010.6},+00.001325,+00.000043"
    );
    format!("${body}*{:02X}", body.bytes().fold(0, |sum, byte| sum ^ byte))
}

#[test]
fn a_line_number_or_a_constant_beside_the_time_is_no_time() {
    let lines = |prefix: &dyn Fn(usize, f64) -> String| -> String {
        (0..400).map(|index| format!("{} {}\n", prefix(index, index as f64 * 0.025), line(index))).collect()
    };
    for (column, text) in [
        (1, lines(&|index, time| format!("{:.6} {index}", 1.7e9 + time))),
        (2, lines(&|index, time| format!("{index} {:.6}", 1.7e9 + time))),
        (1, lines(&|_, time| format!("{:.6} 0", 1.7e9 + time))),
        (1, lines(&|index, time| format!("{time:.6} {index}"))),
        (1, lines(&|index, time| format!("{time:.6} {}", index + index / 50))),
        (2, lines(&|_, time| format!("{:.6} {:.6}", 7.0 + 2.0 * time, 1.7e9 + time))),
        (1, lines(&|_, time| format!("{:.6} {:.6}", 1.7e9 + time, 7.0 + 2.0 * time))),
    ] {
        let recording = read(text.as_bytes(), Options::default()).unwrap();
        let info = recording.info();
        assert_eq!((info.rate_hz, info.samples), (40.0, 400), "{}", &text[..40]);
        assert_eq!(info.stamp_choice.as_ref().unwrap().column, column, "{}", &text[..40]);
    }
    // Alone, the column is used.
    let text = lines(&|index, _| index.to_string());
    assert_eq!(read(text.as_bytes(), Options::default()).unwrap().info().rate_hz, 1.0);
}

#[test]
fn stamps_in_pairs_are_reported_first_and_have_the_rate_of_their_grid() {
    let mut text = String::from("time_s,gyro_x_rad_s\n");
    let mut time = 0.0;
    for index in 0..400 {
        text += &format!("{time:.6},{index}\n");
        time += if index % 2 == 0 { 1e-5 } else { 0.04999 };
    }
    let recording = read(text.as_bytes(), Options::default()).unwrap();
    let first = &recording.info().remarks()[0];
    assert!((recording.info().rate_hz - 40.0).abs() < 1e-3, "{}", recording.info().rate_hz);
    assert_eq!(recording.info().findings.missing, 0);
    for words in ["stamps come in pairs", "0.01 ms and of 49.99 ms", "40.0 Hz is that of the grid"] {
        assert!(first.contains(words), "{words}: {first}");
    }
}

#[test]
fn a_header_with_channels_makes_a_table_whatever_its_comments_and_columns_hold() {
    let commented = "# converted from $VNYMR lines\ntime_s,gyro_x_rad_s\n0,1\n0.025,2\n0.05,3\n".to_owned();
    let beside: String =
        (0..3).map(|index| format!("{:.3},{index},\"{}\"\n", f64::from(index) * 0.025, line(1))).collect();
    for text in [commented, format!("time_s,gyro_x_rad_s,raw\n{beside}")] {
        let recording = read(text.as_bytes(), Options::default()).unwrap();
        let info = recording.info();
        assert_eq!((info.kind, info.samples, info.rate_hz), (Kind::Csv, 3, 40.0), "{text}");
    }
    let lines: String = (0..3).map(|index| format!("{}\n", line(index))).collect();
    for comment in ["# a terminal's log\n", ""] {
        let recording = read(format!("{comment}{lines}").as_bytes(), Options::default()).unwrap();
        assert_eq!(recording.info().kind, Kind::VnText);
    }
}

#[test]
fn two_runs_in_one_file_are_reported_with_the_line_that_divides_them() {
    let run: String = (0..200).map(|index| format!("{:.3},{index}\n", f64::from(index) * 0.025)).collect();
    let recording = read(format!("time_s,gyro_x_rad_s\n{run}{run}").as_bytes(), Options::default()).unwrap();
    assert_eq!(recording.info().samples, 200);
    assert_remark(&recording, &["50 % of the samples were rejected", "two runs", "line 202"]);
}

#[test]
fn channels_without_a_value_are_counted_and_reported() {
    let mut text = String::from("time_s,accel_x_m_s2,accel_y_m_s2,gyro_x_rad_s,gyro_y_rad_s\n");
    for index in 0..200 {
        let x = if index % 10 == 0 { "NaN".to_owned() } else { format!("{index}") };
        text += &format!("{:.3},{x},{x},{index},\n", f64::from(index) * 0.025);
    }
    let recording = read(text.as_bytes(), Options::default()).unwrap();
    assert_remark(&recording, &["accel_x accel_y have no value in 20 of 200 samples"]);
    assert_remark(&recording, &["gyro_y has no value in 200 of 200 samples"]);
    let absent: Vec<u64> = recording.info().findings.absent.values().copied().collect();
    assert_eq!(absent, [20, 20, 200]);
}

#[test]
fn columns_by_their_places_never_take_a_row_for_a_header() {
    // As `rostopic echo -p` writes it: the header looks like a comment, and a column holds text.
    let mut text = String::from("%time,field.header.seq,field.header.frame_id,field.angular_velocity.x\n");
    for index in 0..100_u64 {
        text += &format!("{},{index},imu_link,0.{index}\n", 1_710_358_267_000_000_000 + 25_000_000 * index);
    }
    for text in [text.as_str(), text.split_once('\n').unwrap().1] {
        let columns = ColumnMap::parse(&["#1=time_ns,#4=gyro_x_rad_s"]).unwrap();
        let input = Input::memory("echo.csv", text.as_bytes().to_vec()).with_columns(columns);
        let recording = Recording::read(input, Options::default()).unwrap();
        assert_eq!((recording.info().samples, recording.info().rate_hz), (100, 40.0));
    }
}

#[test]
fn rows_with_a_stamp_and_a_raw_line_in_a_cell_keep_their_stamps() {
    for (header, open, close) in [
        ("", "", ""),
        ("time_s,raw\n", "", ""),
        ("stamp,raw\n", "\"", "\""),
        ("time_s,raw\n", "b'", "\\r\\n'"),
        ("time_s,raw\n", "\"b'", "\\r\\n'\""),
    ] {
        let rows = (0..100_usize)
            .map(|index| format!("{:.3},{open}{}{close}\n", 1_710_358_267.0 + 0.02 * index as f64, line(index)));
        let text = header.to_owned() + &rows.collect::<String>();
        let recording = read(text.as_bytes(), Options::default()).unwrap();
        let info = recording.info();
        assert_eq!(
            (info.samples, info.stamps),
            (100, Stamps::Unix),
            "{header}{open}: {:?}",
            info.first_rejected.first()
        );
        assert!((info.rate_hz - 50.0).abs() < 1e-6, "{header}{open}: {}", info.rate_hz);
    }
}
