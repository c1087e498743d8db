//! The place of a capture's file in a data set of many: `sensor=…/date=…/capture-….parquet`, as Hive names partitions.
//! The beginning of its database's identity is part of the name, so that capture 1 of each of two machines is a
//! separate file.
//!
//! Programs that read such folders take the values from the names and undo `%XX`, so that any serial number is safe there.

use super::About;
use chrono::DateTime;

/// The maximum number of characters of a capture's name in its file's name.
const NAME_CHARS: usize = 80;
/// The number of characters of a database's identity in the file's name: 32 bits.
const IDENTITY_CHARS: usize = 8;

/// Returns the file's path inside the data set, made from the sensor (`None` if its serial number is not known), the
/// day in UTC on which the capture began, its database, id and name.
pub fn partition_path(about: &About) -> String {
    let About { id, database, name, origin_ns, sensor, .. } = about;
    let sensor = escaped(sensor.serial_number().filter(|serial| !serial.is_empty()).unwrap_or("unknown"));
    let date = DateTime::from_timestamp_nanos(*origin_ns).format("%Y-%m-%d");
    let plain = |text: &str, count: usize| -> String {
        text.chars().take(count).map(|c| if is_plain(c) { c } else { '_' }).collect()
    };
    let (id, name, database) = (id.unwrap_or_default(), plain(name, NAME_CHARS), plain(database, IDENTITY_CHARS));
    format!("sensor={sensor}/date={date}/capture-{id}-{name}-{database}.parquet")
}

fn is_plain(character: char) -> bool {
    character.is_ascii_alphanumeric() || matches!(character, '-' | '_' | '.')
}

/// Returns a partition's value: characters that are not plain as `%XX`, byte by byte.
fn escaped(value: &str) -> String {
    let byte =
        |byte: u8| if is_plain(char::from(byte)) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    value.bytes().map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVENING_NS: i64 = 1_795_305_599_999_999_999;

    fn path(serial_number: Option<&str>, origin_ns: i64, id: i64, name: &str) -> String {
        partition_path(&About {
            id: Some(id),
            database: "0123456789abcdef0123456789abcdef".to_owned(),
            name: name.to_owned(),
            note: None,
            origin_ns,
            rate_hz: None,
            channels: Vec::new(),
            sensor: serde_json::json!({ "serial_number": serial_number }).into(),
            software: String::new(),
            writer: String::new(),
        })
    }

    #[test]
    fn a_path_has_the_sensor_the_day_in_utc_and_the_capture() {
        assert_eq!(
            path(Some("0100012345"), EVENING_NS, 7, "night 1/desk"),
            "sensor=0100012345/date=2026-11-21/capture-7-night_1_desk-01234567.parquet"
        );
        assert_eq!(
            path(None, EVENING_NS + 1, 8, ""),
            "sensor=unknown/date=2026-11-22/capture-8--01234567.parquet",
            "midnight belongs to the day that begins"
        );
        assert_eq!(path(Some(""), 0, 1, "a"), "sensor=unknown/date=1970-01-01/capture-1-a-01234567.parquet");
    }

    #[test]
    fn no_name_leads_out_of_its_folder() {
        for evil in ["../../etc", "a/b", "a=b", "%2F", "ä\n\0", "..", "."] {
            let path = path(Some(evil), 0, 1, evil);
            assert_eq!(path.split('/').count(), 3, "{path}");
            assert!(path.is_ascii() && !path.contains("/.") && !path.contains(['\n', '\0']), "{path}");
        }
        assert_eq!(escaped("a b%/ä"), "a%20b%25%2F%C3%A4");
        let long = path(None, 0, 1, &"x".repeat(500));
        assert!(long.rsplit('/').next().is_some_and(|file| file.len() < 128), "{long}");
    }
}
