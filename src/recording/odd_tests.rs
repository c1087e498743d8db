//! Odd files: what is broken in them costs itself alone and is said.

use super::*;
use crate::sample::{Channel, DiscardCause};

fn read(text: &[u8], options: Options) -> Result<Recording, RecordingError> {
    Recording::read(Input::memory("odd.csv", text.to_vec()), options)
}

fn at_40_hz() -> Options {
    Options { rate_hz: Some(40.0), ..Options::default() }
}

fn says(recording: &Recording, words: &[&str]) {
    let remarks = recording.info().remarks();
    assert!(remarks.iter().any(|said| words.iter().all(|word| said.contains(word))), "{words:?}: {remarks:#?}");
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
    // Two of them, and as the last: nothing between is taken along.
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
        says(&recording, &["50 Hz", "a comment"]);
        let told = read(text.as_bytes(), at_40_hz()).unwrap();
        assert_eq!((told.info().rate_hz, told.info().findings.commented_rate_hz), (40.0, None));
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
            Item::Sample(_) => None,
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
