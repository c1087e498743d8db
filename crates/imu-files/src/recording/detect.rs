//! Detects the kind of a file by its content: a ROS bag, raw bytes or lines of a VN-100, or CSV. Names and extensions
//! do not count.

use super::columns::foreign;
use super::error::{RecordingError, read_error};
use super::header::{Header, decoded, foreign_names, numbers_like};
use super::input::Input;
use super::kind::Kind;
use super::{folder, ros, table, vn_binary};
use std::io::Read;

/// The number of bytes of a file that are examined.
const LOOK_AT_BYTES: u64 = 64 * 1024;
/// The number of lines at the start of a file of raw lines that may lack `$VN`: a recorder's header, a cut first line.
const LOOK_AT_LINES: usize = 100;
/// The number of characters of an unrecognised file that are shown.
const SHOWN_CHARS: usize = 60;

/// The number of rows from which columns are proposed.
const PROPOSED_FROM: usize = 64;

/// The kinds that their first bytes identify.
const FIRST_BYTES: [(&[u8], Kind); 9] = [
    (ros::BAG_MAGIC, Kind::Bag),
    (ros::MCAP_MAGIC, Kind::Mcap),
    (ros::SQLITE_MAGIC, Kind::Db3),
    (b"PAR1", Kind::Parquet),
    (b"\x93NUMPY", Kind::Npy),
    (b"PK\x03\x04", Kind::Npz),
    (b"MATLAB 5.0 MAT-file", Kind::Mat),
    (b"\x89HDF\r\n\x1a\n", Kind::Hdf5),
    (table::ULOG_MAGIC, Kind::Ulog),
];

/// Returns whether a line has a raw message.
fn is_message(line: &str) -> bool {
    line.split_once("$VN").is_some_and(|(_, behind)| {
        let letters = behind.bytes().take_while(u8::is_ascii_uppercase).count();
        letters > 1 && behind.as_bytes().get(letters) == Some(&b',')
    })
}

/// Determines the kind of `input`.
///
/// # Errors
/// [`RecordingError`] if it cannot be read or is of no known kind. The error shows how the content begins.
pub fn detect(input: &Input) -> Result<Kind, RecordingError> {
    let input = &folder::resolved(input.clone())?;
    let file = input.path();
    let mut head = Vec::new();
    input.open()?.take(LOOK_AT_BYTES).read_to_end(&mut head).map_err(|source| read_error(file, 0, source))?;
    // The HDF5 of MATLAB 7.3 begins behind a text of 512 bytes.
    let is_matlab_73 = head.get(512..).is_some_and(|behind| behind.starts_with(b"\x89HDF\r\n\x1a\n"));
    let known = FIRST_BYTES.into_iter().find(|(magic, _)| head.starts_with(magic)).map(|(_, kind)| kind);
    let of_table = || is_matlab_73.then_some(Kind::Hdf5).or(table::is_dataflash(&head).then_some(Kind::Dataflash));
    if let Some(kind) = known.or_else(of_table) {
        if kind == Kind::Db3 {
            ros::check_db3(input)?;
        }
        return Ok(kind);
    }
    if head.starts_with(b"#ROSBAG V") {
        let found = "a ROS bag of another version than 2.0";
        return Err(RecordingError::NotReadYet { file: file.to_owned(), found });
    }
    if vn_binary::is_binary(&head) {
        return Ok(Kind::RawBytes);
    }
    let lines = || head.split(|byte| *byte == b'\n').filter(|line| !line.trim_ascii().is_empty());
    let map = input.columns();
    let text = |line: &[u8]| decoded(line);
    // Old files end their lines with a carriage return alone.
    let mut heads =
        lines().flat_map(|line| line.split(|byte| *byte == b'\r')).map(text).filter(|line| !line.is_empty());
    let heading = heads.find(|line| !Header::is_comment(line, map)).unwrap_or_default();
    // A table may have the raw line as a column, or mention `$VN` in a comment; a message is no header.
    if !is_message(&heading) && Header::names_channels(&heading, map) {
        return Ok(Kind::Csv);
    }
    if lines().take(LOOK_AT_LINES).any(|line| line.windows(3).any(|window| window == b"$VN")) {
        return Ok(Kind::VnText);
    }
    if head.trim_ascii().is_empty() && (head.len() as u64) < LOOK_AT_BYTES {
        return Err(RecordingError::Empty { file: file.to_owned() });
    }
    let (bytes_seen, has_ends) = (head.len() as u64, head.iter().any(|byte| matches!(byte, b'\n' | b'\r')));
    let first = lines().next().map(text).unwrap_or_default();
    if Header::is_known(&heading, map) {
        return Ok(Kind::Csv);
    }
    // A table has lines.
    let is_line = bytes_seen < LOOK_AT_BYTES || has_ends;
    if let Some(names) = foreign_names(&heading).filter(|_| is_line) {
        let behind = heads.take(PROPOSED_FROM).map(|row| numbers_like(&row, &heading)).collect::<Vec<_>>();
        return Err(foreign(&names, file, &|| behind.clone()));
    }
    let found = first.chars().take(SHOWN_CHARS).collect();
    Err(RecordingError::Unrecognised { file: file.to_owned(), found })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raw_message_is_no_header() {
        let kind = |text: &str| detect(&Input::memory("a", text.as_bytes())).ok();
        assert_eq!(kind("$VNIMU,gyro_x_rad_s,1*00\n$VNIMU,2,3*00\n"), Some(Kind::VnText));
        assert_eq!(kind("time_s,gyro_x_rad_s,$VN line\n0,1,2\n"), Some(Kind::Csv));
    }
}
