//! Where a capture's file lies in a data set of many: `sensor=…/date=…/capture-….parquet`, as Hive names partitions.
//!
//! Programs that read such folders take the values from the names and undo `%XX`, so that any serial number is safe there.

use chrono::DateTime;

/// Characters of a capture's name that stand in its file's.
const NAME_CHARS: usize = 80;

/// The file's path inside the data set: of a sensor (`None` where its serial number is not known), of the day in UTC on which
/// the capture began, of its id and name.
#[must_use]
pub fn partition_path(serial_number: Option<&str>, started_utc_ns: i64, id: i64, name: &str) -> String {
    let sensor = escaped(serial_number.filter(|serial| !serial.is_empty()).unwrap_or("unknown"));
    let date = DateTime::from_timestamp_nanos(started_utc_ns).format("%Y-%m-%d");
    let name: String = name.chars().take(NAME_CHARS).map(|c| if is_plain(c) { c } else { '_' }).collect();
    format!("sensor={sensor}/date={date}/capture-{id}-{name}.parquet")
}

fn is_plain(character: char) -> bool {
    character.is_ascii_alphanumeric() || matches!(character, '-' | '_' | '.')
}

/// A partition's value: what is not plain as `%XX`, byte by byte.
fn escaped(value: &str) -> String {
    let byte =
        |byte: u8| if is_plain(char::from(byte)) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    value.bytes().map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVENING_NS: i64 = 1_795_305_599_999_999_999;

    #[test]
    fn a_path_has_the_sensor_the_day_in_utc_and_the_capture() {
        assert_eq!(
            partition_path(Some("0100012345"), EVENING_NS, 7, "night 1/desk"),
            "sensor=0100012345/date=2026-11-21/capture-7-night_1_desk.parquet"
        );
        assert_eq!(
            partition_path(None, EVENING_NS + 1, 8, ""),
            "sensor=unknown/date=2026-11-22/capture-8-.parquet",
            "midnight belongs to the day that begins"
        );
        assert_eq!(partition_path(Some(""), 0, 1, "a"), "sensor=unknown/date=1970-01-01/capture-1-a.parquet");
    }

    #[test]
    fn no_name_leads_out_of_its_folder() {
        for evil in ["../../etc", "a/b", "a=b", "%2F", "ä\n\0", "..", "."] {
            let path = partition_path(Some(evil), 0, 1, evil);
            assert_eq!(path.split('/').count(), 3, "{path}");
            assert!(path.is_ascii() && !path.contains("/.") && !path.contains(['\n', '\0']), "{path}");
        }
        assert_eq!(escaped("a b%/ä"), "a%20b%25%2F%C3%A4");
        let long = partition_path(None, 0, 1, &"x".repeat(500));
        assert!(long.rsplit('/').next().is_some_and(|file| file.len() < 128), "{long}");
    }
}
