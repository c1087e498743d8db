//! Values of the configuration beyond plain numbers and texts. Each is read with an error that states the allowed
//! values, and written in the form in which it is read.

use chrono::{NaiveTime, Weekday};
use imu_core::units::{format_duration, parse_duration};
use serde::de::{self, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

/// ASCII measurements of a VN-100 that register 6 can select and that carry channels (ICD, table of register 6).
pub const ASCII_TYPES: [&str; 10] =
    ["VNYPR", "VNQMR", "VNMAG", "VNACC", "VNGYR", "VNMAR", "VNYMR", "VNYBA", "VNYIA", "VNIMU"];

/// The device to search for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Device {
    /// The first port of `/dev/serial/by-id` on which a VN-100 answers.
    Auto,
    /// This path, which may appear and disappear.
    Path(PathBuf),
    /// Every path that matches (`*`, `?`, `[…]`), in alphabetical order.
    Glob(String),
}

impl Device {
    /// Reads `auto`, a path or a pattern.
    ///
    /// # Errors
    /// A sentence that states the allowed values, if the text is empty.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text.trim() {
            "" => Err("`\"auto\"`, a path such as \"/dev/vn100\" or a pattern such as \"/dev/ttyUSB*\"".to_owned()),
            "auto" => Ok(Self::Auto),
            pattern if pattern.contains(['*', '?', '[']) => Ok(Self::Glob(pattern.to_owned())),
            path => Ok(Self::Path(PathBuf::from(path))),
        }
    }
}

impl fmt::Display for Device {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => formatter.write_str("auto"),
            Self::Path(path) => path.display().fmt(formatter),
            Self::Glob(pattern) => formatter.write_str(pattern),
        }
    }
}

/// The baud rate of the port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Baud {
    /// Every rate of `bauds` in turn, the last good one first.
    Auto,
    /// Only this rate.
    Fixed(u32),
}

/// The configured output of the sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Output {
    /// Binary output 1 with the groups and fields of `binary-fields`.
    Binary,
    /// The sensor's present output; it is not configured.
    Keep,
    /// An ASCII measurement, one of [`ASCII_TYPES`].
    Ascii(String),
}

impl Output {
    fn parse(text: &str) -> Result<Self, String> {
        match text {
            "binary" => Ok(Self::Binary),
            "keep" => Ok(Self::Keep),
            name if ASCII_TYPES.contains(&name) => Ok(Self::Ascii(name.to_owned())),
            _ => Err(format!("`\"binary\"`, `\"keep\"` or one of {}", ASCII_TYPES.join(", "))),
        }
    }
}

impl fmt::Display for Output {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Binary => "binary",
            Self::Keep => "keep",
            Self::Ascii(name) => name,
        })
    }
}

/// Groups and fields of binary output 1 in the form of `$VNWRG,75`: hexadecimal, `01,0609`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BinaryFields {
    /// Bits 0, 1, 2 and 4: groups 1 (common), 2 (time), 3 (IMU) and 5 (attitude).
    pub groups: u8,
    /// One mask of fields per group, lowest group first; never 0.
    pub masks: Vec<u16>,
}

impl BinaryFields {
    /// Groups that a VN-100 has and the decoder knows.
    const KNOWN_GROUPS: u8 = 0b0001_0111;
    /// Bit 15 of a mask announces a second mask, which a VN-100 does not have.
    const EXTENSION: u16 = 0x8000;

    fn parse(text: &str) -> Result<Self, String> {
        let refuse = || {
            "groups and one mask of fields per group in hexadecimal, as `$VNWRG,75` takes them, of groups 01, 02, 04 \
             and 10: such as \"01,0609\" or \"05,0001,0600\""
                .to_owned()
        };
        let mut parts = text.split(',').map(str::trim);
        let groups = parts.next().and_then(|group| u8::from_str_radix(group, 16).ok()).ok_or_else(refuse)?;
        let masks: Vec<u16> =
            parts.map(|mask| u16::from_str_radix(mask, 16)).collect::<Result<_, _>>().map_err(|_| refuse())?;
        let known = groups != 0 && groups & !Self::KNOWN_GROUPS == 0;
        let masks_fit = masks.len() == groups.count_ones() as usize
            && masks.iter().all(|mask| *mask != 0 && mask & Self::EXTENSION == 0);
        if known && masks_fit { Ok(Self { groups, masks }) } else { Err(refuse()) }
    }
}

impl fmt::Display for BinaryFields {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:02X}", self.groups)?;
        self.masks.iter().try_for_each(|mask| write!(formatter, ",{mask:04X}"))
    }
}

/// A secret that never appears in a log or in the effective configuration.
#[derive(Clone, PartialEq, Eq, Default)]
pub struct Token(String);

impl Token {
    /// Returns the secret itself; empty if there is none.
    pub fn secret(&self) -> &str {
        &self.0
    }
    /// Returns whether the token is empty.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
    /// Creates a token of this text.
    pub fn new(secret: impl Into<String>) -> Self {
        Self(secret.into())
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(if self.is_empty() { "(none)" } else { "(set)" })
    }
}

/// An address that events are posted to. Its path often is a secret: only scheme and host are shown.
#[derive(Clone, PartialEq, Eq, Default)]
pub struct Webhook(String);

impl Webhook {
    /// Returns the whole address; empty if there is none.
    pub fn secret(&self) -> &str {
        &self.0
    }
    /// Returns whether the address is empty.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn parse(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let allowed = || "an address such as \"https://ntfy.sh/my-sensor\", or \"\" for none".to_owned();
        if text.is_empty() {
            return Ok(Self::default());
        }
        let uri: ureq::http::Uri = text.parse().map_err(|_| allowed())?;
        let scheme_fits = matches!(uri.scheme_str(), Some("http" | "https"));
        if scheme_fits && uri.host().is_some_and(|host| !host.is_empty()) {
            Ok(Self(text.to_owned()))
        } else {
            Err(allowed())
        }
    }
}

impl fmt::Display for Webhook {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Ok(uri) = self.0.parse::<ureq::http::Uri>() else { return Ok(()) };
        // Without the name and password that an authority may carry.
        let host = uri.host().unwrap_or_default();
        write!(formatter, "{}://{host}", uri.scheme_str().unwrap_or_default())?;
        uri.port_u16().map_or(Ok(()), |port| write!(formatter, ":{port}"))
    }
}

impl fmt::Debug for Webhook {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() { formatter.write_str("(none)") } else { write!(formatter, "{self}/…") }
    }
}

/// The permissions of a file, as `chmod` takes them; its owner may read and write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileMode(u32);

impl FileMode {
    /// Returns the permissions as bits.
    pub fn bits(self) -> u32 {
        self.0
    }

    fn parse(text: &str) -> Result<Self, String> {
        let mode = u32::from_str_radix(text.trim(), 8).ok().filter(|mode| mode & !0o666 == 0 && mode & 0o600 == 0o600);
        mode.map(Self).ok_or_else(|| "permissions such as \"600\", \"660\" or \"666\"".to_owned())
    }
}

impl Default for FileMode {
    fn default() -> Self {
        Self(0o660)
    }
}

impl fmt::Display for FileMode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:o}", self.0)
    }
}

/// A local time of day, `22:00`; absent if it is empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StartTime(pub Option<NaiveTime>);

impl StartTime {
    fn parse(text: &str) -> Result<Self, String> {
        match text.trim() {
            "" => Ok(Self(None)),
            time => NaiveTime::parse_from_str(time, "%H:%M")
                .map(|time| Self(Some(time)))
                .map_err(|_| "a local time of day such as \"22:00\", or \"\" for none".to_owned()),
        }
    }
}

impl fmt::Display for StartTime {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.map_or(Ok(()), |time| time.format("%H:%M").fmt(formatter))
    }
}

/// The duration of a night's capture; if it is empty, the duration of any other capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct NightLength(pub Option<Duration>);

impl NightLength {
    fn parse(text: &str) -> Result<Self, String> {
        match text.trim() {
            "" => Ok(Self(None)),
            length => parse_duration(length)
                .map(|length| Self(Some(length)))
                .map_err(|_| "a duration such as \"5h\" or \"90m\", or \"\" for that of `[capture]`".to_owned()),
        }
    }
}

impl fmt::Display for NightLength {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.map_or(Ok(()), |length| formatter.write_str(&format_duration(length)))
    }
}

/// A day of the week.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Day {
    /// Monday
    Mon,
    /// Tuesday
    Tue,
    /// Wednesday
    Wed,
    /// Thursday
    Thu,
    /// Friday
    Fri,
    /// Saturday
    Sat,
    /// Sunday
    Sun,
}

impl Day {
    /// All days, in their order.
    pub const ALL: [Self; 7] = [Self::Mon, Self::Tue, Self::Wed, Self::Thu, Self::Fri, Self::Sat, Self::Sun];

    /// Returns the day in the calendar's type.
    pub fn weekday(self) -> Weekday {
        (0..self as u8).fold(Weekday::Mon, |day, _| day.succ())
    }
}

/// The form of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogFormat {
    /// One line of text; without a time under journald, which adds its own.
    Text,
    /// One JSON object per line.
    Json,
}

struct TextVisitor<T>(&'static str, fn(&str) -> Result<T, String>);

impl<T> Visitor<'_> for TextVisitor<T> {
    type Value = T;
    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.0)
    }
    fn visit_str<E: de::Error>(self, text: &str) -> Result<T, E> {
        (self.1)(text).map_err(|allowed| E::custom(format!("expected {allowed}")))
    }
}

macro_rules! text_serde {
    ($type:ty, $expecting:literal, $parse:expr, $write:expr) => {
        impl<'de> Deserialize<'de> for $type {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                deserializer.deserialize_str(TextVisitor($expecting, $parse))
            }
        }
        impl Serialize for $type {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let write: fn(&Self) -> String = $write;
                serializer.serialize_str(&write(self))
            }
        }
    };
}

text_serde!(Device, "`\"auto\"`, a path or a pattern", Device::parse, ToString::to_string);
text_serde!(Output, "`\"binary\"`, `\"keep\"` or an ASCII type", Output::parse, ToString::to_string);
text_serde!(BinaryFields, "groups and fields such as \"01,0609\"", BinaryFields::parse, ToString::to_string);
text_serde!(StartTime, "a local time of day such as \"22:00\"", StartTime::parse, ToString::to_string);
text_serde!(FileMode, "permissions such as \"660\"", FileMode::parse, ToString::to_string);
text_serde!(NightLength, "a duration such as \"5h\"", NightLength::parse, ToString::to_string);
text_serde!(Webhook, "an address", Webhook::parse, |url| if url.is_empty() {
    String::new()
} else {
    format!("{url}/…")
});
text_serde!(Token, "a text", |text| Ok(Token(text.to_owned())), |token| if token.is_empty() {
    String::new()
} else {
    "(set)".to_owned()
});

impl Serialize for Baud {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::Fixed(baud) => serializer.serialize_u32(*baud),
        }
    }
}

impl<'de> Deserialize<'de> for Baud {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct BaudVisitor;
        impl Visitor<'_> for BaudVisitor {
            type Value = Baud;
            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("`\"auto\"` or a baud rate such as 115200")
            }
            fn visit_str<E: de::Error>(self, text: &str) -> Result<Baud, E> {
                if text == "auto" { Ok(Baud::Auto) } else { Err(E::invalid_value(de::Unexpected::Str(text), &self)) }
            }
            fn visit_i64<E: de::Error>(self, baud: i64) -> Result<Baud, E> {
                u32::try_from(baud).map(Baud::Fixed).map_err(|_| E::invalid_value(de::Unexpected::Signed(baud), &self))
            }
            fn visit_u64<E: de::Error>(self, baud: u64) -> Result<Baud, E> {
                u32::try_from(baud)
                    .map(Baud::Fixed)
                    .map_err(|_| E::invalid_value(de::Unexpected::Unsigned(baud), &self))
            }
        }
        deserializer.deserialize_any(BaudVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_and_fields_are_read_and_written_in_hexadecimal() {
        let fields = BinaryFields::parse("01,0609").unwrap();
        assert_eq!(fields, BinaryFields { groups: 1, masks: vec![0x0609] });
        assert_eq!(fields.to_string(), "01,0609");
        assert_eq!(BinaryFields::parse("15, 0001,000c,0014").unwrap().to_string(), "15,0001,000C,0014");
    }

    #[test]
    fn groups_without_their_masks_or_that_a_vn100_has_not_are_refused() {
        for text in
            ["", "01", "01,", "00", "01,0000", "01,8001", "03,0001", "08,0001", "40,0001", "zz,0001", "01,12345"]
        {
            assert!(BinaryFields::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_device_is_automatic_a_path_or_a_pattern() {
        assert_eq!(Device::parse("auto").unwrap(), Device::Auto);
        assert_eq!(Device::parse("/dev/vn100").unwrap(), Device::Path("/dev/vn100".into()));
        assert_eq!(Device::parse("/dev/ttyUSB*").unwrap(), Device::Glob("/dev/ttyUSB*".into()));
        assert!(Device::parse("  ").is_err());
    }

    #[test]
    fn a_token_does_not_show_itself() {
        assert_eq!(format!("{:?}", Token::new("secret-secret-secret")), "(set)");
        assert_eq!(serde_json::to_string(&Token::new("secret-secret-secret")).unwrap(), "\"(set)\"");
    }

    #[test]
    fn an_address_shows_its_host_alone() {
        let url = Webhook::parse("https://name:password@ntfy.sh:8443/secret-topic?auth=key").unwrap();
        assert_eq!(format!("{url} {url:?}"), "https://ntfy.sh:8443 https://ntfy.sh:8443/…");
        assert!(url.secret().ends_with("/secret-topic?auth=key"));
        assert!(!serde_json::to_string(&url).unwrap().contains("secret"));
        assert!(Webhook::parse(" ").unwrap().is_empty());
        for text in ["ntfy.sh/topic", "ftp://host/", "http://", "https:///path", "http://a b/", "file:///etc/passwd"] {
            assert!(Webhook::parse(text).is_err(), "{text}");
        }
    }
}
