//! The vocabulary of column names: which channel and unit, or which time, a name states.
//!
//! A name is split into words (`w_RS_S_x [rad s^-1]`, `GyroX(dps)`, `/imu/angular_velocity/x`, `gyro_rad[0]`). It names a
//! channel if it has a word for the quantity, an axis, and a unit that the quantity can have. The unit stands in brackets or
//! behind the name, or follows from the definition of the ROS message whose field the name is. A unit is never guessed: a
//! name without one means nothing here, and [`super::propose`] makes a proposal of it. Pure.
//!
//! Spellings: EuRoC and TUM-VI (`data.csv` of the ASL format), PX4's `sensor_combined`, phyphox, `sensor_msgs`,
//! VectorNav's interface control document (field names of the Common and IMU group).

use super::names::suffixes;
use imu_core::sample::{Channel, Triad};

/// What a quantity is, before its axis is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// One of three axes, or of yaw, pitch and roll.
    Triad(Triad),
    /// A single channel.
    Single(Channel),
}

use Quantity::{Single, Triad as Of};

/// Words of a quantity with axes, as they stand in a name without its axis and unit.
const WORDS: [(&str, Quantity); 34] = [
    ("gyro", Of(Triad::Gyro)),
    ("gyros", Of(Triad::Gyro)),
    ("gyr", Of(Triad::Gyro)),
    ("gyroscope", Of(Triad::Gyro)),
    ("angular velocity", Of(Triad::Gyro)),
    ("angular rate", Of(Triad::Gyro)),
    ("angularrate", Of(Triad::Gyro)),
    ("angularvelocity", Of(Triad::Gyro)),
    ("ang vel", Of(Triad::Gyro)),
    ("angvel", Of(Triad::Gyro)),
    ("rotation rate", Of(Triad::Gyro)),
    ("rotationrate", Of(Triad::Gyro)),
    ("rotational velocity", Of(Triad::Gyro)),
    ("omega", Of(Triad::Gyro)),
    ("imu rate", Of(Triad::Gyro)),
    ("w", Of(Triad::Gyro)),
    ("accel", Of(Triad::Accel)),
    ("acc", Of(Triad::Accel)),
    ("accelerometer", Of(Triad::Accel)),
    ("acceleration", Of(Triad::Accel)),
    ("totalacceleration", Of(Triad::Accel)),
    ("specific force", Of(Triad::Accel)),
    ("a", Of(Triad::Accel)),
    ("mag", Of(Triad::Mag)),
    ("magn", Of(Triad::Mag)),
    ("magnetometer", Of(Triad::Mag)),
    ("magnetic field", Of(Triad::Mag)),
    ("magneticfield", Of(Triad::Mag)),
    ("m", Of(Triad::Mag)),
    ("temperature", Single(Channel::Temperature)),
    ("temp", Single(Channel::Temperature)),
    ("pressure", Single(Channel::Pressure)),
    ("press", Single(Channel::Pressure)),
    ("pres", Single(Channel::Pressure)),
];

/// Words that only occur with the axis at their end (`gx`).
const BEFORE_AXIS: [(&str, Quantity); 1] = [("g", Of(Triad::Gyro))];

/// A name with one of these words is about a quantity, but is not its measurement.
const NOT_MEASURED: [&str; 43] = [
    "covariance",
    "cov",
    "bias",
    "integral",
    "std",
    "stddev",
    "var",
    "variance",
    "sigma",
    "err",
    "error",
    "delta",
    "diff",
    "magnitude",
    "norm",
    "abs",
    "absolute",
    "cmd",
    "command",
    "setpoint",
    "sp",
    "target",
    "ref",
    "reference",
    "offset",
    "scale",
    "limit",
    "vibe",
    "vib",
    "user",
    "dt",
    "gravity",
    "adev",
    "avar",
    "oadev",
    "mdev",
    "psd",
    "asd",
    "density",
    "counts",
    "count",
    "adc",
    "lsb",
];

/// A name with one of these words gives way to another one of the same channel: the value is not compensated, or
/// gravity is taken out of it.
const SECOND: [&str; 6] = ["uncomp", "uncompensated", "uncal", "uncalibrated", "raw", "linear"];

/// Spellings of units by quantity, without space and in lower case ([`plain_unit`]), and the suffix of the unit's column.
const UNITS: [(Quantity, &str, &[&str]); 22] = [
    (Of(Triad::Gyro), "_rad_s", &["rad/s", "rads-1", "rads^-1", "rad_s", "rads", "rad/sec"]),
    (Of(Triad::Gyro), "_deg_s", &["deg/s", "degs-1", "degs^-1", "deg_s", "dps", "deg/sec"]),
    (Of(Triad::Gyro), "_mdps", &["mdps", "mdeg/s", "mdeg_s"]),
    (Of(Triad::Gyro), "_mrad_s", &["mrad/s", "mrad_s"]),
    (Of(Triad::Gyro), "_deg_h", &["deg/h", "deg/hr", "degh-1", "degh^-1", "deg_h", "dph"]),
    (
        Of(Triad::Accel),
        "_m_s2",
        &["m/s2", "m/s^2", "ms-2", "ms^-2", "m/s/s", "m_s2", "m_s_2", "m_s^2", "mps2", "ms2", "m/sec2", "m/sec^2"],
    ),
    (Of(Triad::Accel), "_g", &["g"]),
    (Of(Triad::Accel), "_mg", &["mg"]),
    (Of(Triad::Accel), "_ug", &["ug"]),
    (Of(Triad::Mag), "_gauss", &["gauss", "g", "gs", "ga"]),
    (Of(Triad::Mag), "_mgauss", &["mgauss", "mg", "mgs", "mga", "milligauss"]),
    (Of(Triad::Mag), "_tesla", &["t", "tesla"]),
    (Of(Triad::Mag), "_mt", &["mt", "millitesla"]),
    (Of(Triad::Mag), "_ut", &["ut", "utesla", "microtesla"]),
    (Of(Triad::Mag), "_nt", &["nt", "ntesla", "nanotesla"]),
    (Of(Triad::Attitude), "_deg", &["deg"]),
    (Of(Triad::Attitude), "_rad", &["rad"]),
    (Single(Channel::Temperature), "_c", &["c", "degc", "celsius", "degcelsius"]),
    (Single(Channel::Pressure), "_kpa", &["kpa"]),
    (Single(Channel::Pressure), "_hpa", &["hpa", "mbar"]),
    (Single(Channel::Pressure), "_pa", &["pa", "pascal"]),
    (Single(Channel::Pressure), "_bar", &["bar"]),
];

/// Whole names of PX4's messages, whose definitions state their units; of an array without its index.
const WHOLE: [(&str, Quantity, &str); 5] = [
    ("gyro_rad", Of(Triad::Gyro), "_rad_s"),
    ("accelerometer_m_s2", Of(Triad::Accel), "_m_s2"),
    ("magnetometer_ga", Of(Triad::Mag), "_gauss"),
    ("baro_pressure_pa", Single(Channel::Pressure), "_pa"),
    ("baro_temp_celcius", Single(Channel::Temperature), "_c"),
];

/// Fields of ROS messages whose definitions state their units: `sensor_msgs` (SI), and `vectornav_msgs` (those of
/// VectorNav's interface control document). `{}` stands for the axis.
pub(super) const FIELDS: [(&str, Quantity, &str); 13] = [
    ("angular_velocity", Of(Triad::Gyro), "_rad_s"),
    ("linear_acceleration", Of(Triad::Accel), "_m_s2"),
    ("magnetic_field", Of(Triad::Mag), "_tesla"),
    ("fluid_pressure", Single(Channel::Pressure), "_pa"),
    ("imu_rate", Of(Triad::Gyro), "_rad_s"),
    ("imu_accel", Of(Triad::Accel), "_m_s2"),
    ("magpres_mag", Of(Triad::Mag), "_gauss"),
    ("magpres_temp", Single(Channel::Temperature), "_c"),
    ("magpres_pres", Single(Channel::Pressure), "_kpa"),
    ("angularrate", Of(Triad::Gyro), "_rad_s"),
    ("uncompgyro", Of(Triad::Gyro), "_rad_s"),
    ("uncompaccel", Of(Triad::Accel), "_m_s2"),
    ("uncompmag", Of(Triad::Mag), "_gauss"),
];

/// Fields of VectorNav's IMU group whose names alone state no unit.
const IMU_GROUP: [(&str, Quantity, &str); 2] =
    [("accel", Of(Triad::Accel), "_m_s2"), ("mag", Of(Triad::Mag), "_gauss")];

/// Units of time, and the decimal places from each to a nanosecond.
const TIMES: [(&[&str], usize); 4] = [
    (&["s", "sec", "secs", "second", "seconds"], 9),
    (&["ms", "msec", "millis", "millisecond", "milliseconds"], 6),
    (&["us", "usec", "micros", "microsecond", "microseconds"], 3),
    (&["ns", "nsec", "nanos", "nanosecond", "nanoseconds"], 0),
];
/// Words for time, and words that may stand beside them.
const TIME_WORDS: [&str; 9] = ["time", "timestamp", "timestamps", "stamp", "t", "ts", "elapsed", "epoch", "zeit"];
const BESIDE_TIME: [&str; 22] = [
    "since",
    "start",
    "startup",
    "in",
    "sample",
    "system",
    "sensor",
    "device",
    "host",
    "header",
    "field",
    "utc",
    "unix",
    "imu",
    "local",
    "log",
    "logging",
    "recording",
    "boot",
    "data",
    "of",
    "the",
];

/// What a name states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Meaning {
    /// A channel's values with their unit.
    Value {
        channel: Channel,
        unit: &'static str,
        factor: f64,
        /// It gives way to another column of the channel.
        second: bool,
    },
    /// A channel without a unit.
    Unitless { channel: Channel },
    /// An axis (0 to 2) of an unnamed quantity.
    Axis(usize),
    /// A time; `None`: in a unit that the name does not state.
    Time { places: Option<usize> },
    /// Whole seconds of a time, or the nanoseconds behind them (`header.stamp.secs`, `header.stamp.nsecs`).
    Part { places: usize },
}

/// A name's words, its unit in brackets and its index.
struct Name {
    words: Vec<String>,
    unit: Option<String>,
    index: Option<usize>,
}

impl Name {
    fn of(name: &str) -> Self {
        let mut rest = name.trim();
        let mut index = None;
        if let Some((before, inside)) = rest.strip_suffix(']').and_then(|text| text.rsplit_once('['))
            && let Ok(number) = inside.parse::<usize>()
        {
            (index, rest) = (Some(number), before);
        }
        let mut unit = None;
        for (open, close) in [('[', ']'), ('(', ')')] {
            if unit.is_none()
                && let Some((before, inside)) = rest.split_once(open)
                && let Some((inside, behind)) = inside.rsplit_once(close)
                && behind.trim().is_empty()
            {
                (unit, rest) = (Some(plain_unit(inside)), before);
            }
        }
        Self { words: words(rest), unit, index }
    }

    fn has(&self, word: &str) -> bool {
        self.words.iter().any(|own| own == word)
    }
}

/// Splits a name into words in lower case: at other characters than letters and digits, and where a small letter is
/// followed by a capital one.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut last = ' ';
    for letter in name.chars() {
        let ends = !letter.is_alphanumeric() || (last.is_lowercase() && letter.is_uppercase());
        if ends && words.last().is_some_and(|word| !word.is_empty()) {
            words.push(String::new());
        }
        if letter.is_alphanumeric()
            && let Some(word) = words.last_mut()
        {
            word.extend(letter.to_lowercase());
        }
        last = letter;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Returns a unit's spelling without space, in lower case and plain letters.
fn plain_unit(unit: &str) -> String {
    let mut plain: String =
        unit.to_lowercase().chars().filter(|c| !c.is_whitespace() && !"*·.\"".contains(*c)).collect();
    for (from, to) in [
        ("°", "deg"),
        ("º", "deg"),
        ("µ", "u"),
        ("μ", "u"),
        ("²", "2"),
        ("⁻¹", "-1"),
        ("⁻²", "-2"),
        ("**", ""),
        ("degrees", "deg"),
        ("degree", "deg"),
        ("radians", "rad"),
        ("radian", "rad"),
        ("seconds", "s"),
        ("second", "s"),
        ("meters", "m"),
        ("meter", "m"),
        ("hour", "h"),
        ("(", ""),
        (")", ""),
    ] {
        plain = plain.replace(from, to);
    }
    plain
}

/// Returns the quantity and the column's suffix of each unit of this spelling.
fn units(spelling: &str) -> impl Iterator<Item = (Quantity, &'static str)> {
    UNITS
        .into_iter()
        .filter(move |(.., known)| known.contains(&spelling))
        .map(|(quantity, suffix, _)| (quantity, suffix))
}

/// Returns the unit's name and the factor to the channel's unit, for the suffix of a column.
fn of_suffix(channel: Channel, suffix: &str) -> Option<(&'static str, f64)> {
    suffixes(channel).iter().find(|(known, ..)| *known == suffix).map(|(_, unit, factor)| (*unit, *factor))
}

fn value(channel: Channel, suffix: &str, second: bool) -> Option<Meaning> {
    let (unit, factor) = of_suffix(channel, suffix)?;
    Some(Meaning::Value { channel, unit, factor, second })
}

/// Returns what a name states; `None` if it is of no use.
pub(super) fn meaning(name: &str) -> Option<Meaning> {
    time(name).or_else(|| of_field(name)).or_else(|| of_words(name))
}

/// Returns the meaning of a field of a ROS message: a path with `.` or `/`.
fn of_field(name: &str) -> Option<Meaning> {
    one_of(name, &FIELDS)
}

/// Returns the meaning of a field of a message of VectorNav's IMU group, whose compensated values have plain names.
pub(super) fn of_imu_group(name: &str) -> Option<Meaning> {
    one_of(name, &IMU_GROUP)
}

fn one_of(name: &str, fields: &[(&str, Quantity, &'static str)]) -> Option<Meaning> {
    let parts: Vec<&str> = name.split(['.', '/']).filter(|part| !part.is_empty()).collect();
    let (last, before) = parts.split_last()?;
    let axis = ["x", "y", "z"].into_iter().position(|axis| axis == *last);
    fields.iter().find_map(|(field, quantity, suffix)| {
        let second = field.starts_with("uncomp");
        match (quantity, axis) {
            (Of(triad), Some(axis)) if before.last() == Some(field) => value(triad.channels()[axis], suffix, second),
            (Single(channel), None) if last == field => value(*channel, suffix, second),
            _ => None,
        }
    })
}

/// Returns the meaning of a name's words.
fn of_words(text: &str) -> Option<Meaning> {
    let mut name = Name::of(text);
    if NOT_MEASURED.iter().any(|word| name.has(word)) {
        return None;
    }
    let second = SECOND.iter().any(|word| name.has(word));
    let whole = text.split_once('[').filter(|_| name.index.is_some()).map_or(text, |(before, _)| before);
    let suffix = WHOLE.into_iter().find(|(known, ..)| *known == whole).map(|(_, quantity, suffix)| (quantity, suffix));
    let angle = ["yaw", "pitch", "roll"].iter().position(|angle| name.has(angle));
    let mut axis = name.index.filter(|index| *index < 3);
    let mut of_axis_word = None;
    name.words.retain(|word| {
        let letter = ["x", "y", "z"].into_iter().position(|letter| word == letter);
        axis = axis.or(letter);
        letter.is_none()
    });
    if axis.is_none() {
        // Quantity and axis in one word.
        for word in &name.words {
            let Some(letter) = ['x', 'y', 'z'].into_iter().position(|letter| word.ends_with(letter)) else { continue };
            let bare = &word[..word.len() - 1];
            let known = WORDS.iter().chain(&BEFORE_AXIS).find(|(known, _)| *known == bare);
            if let Some((_, quantity)) = known {
                (axis, of_axis_word) = (Some(letter), Some(*quantity));
            }
        }
    }
    let mut spelled: Vec<(Quantity, &str)> = suffix.into_iter().collect();
    if spelled.is_empty() {
        spelled = match &name.unit {
            Some(unit) => units(unit).collect(),
            None => unit_behind(&mut name.words),
        };
    }
    if let Some(angle) = angle {
        let (_, suffix) = spelled.into_iter().find(|(quantity, _)| *quantity == Of(Triad::Attitude))?;
        return value(Triad::Attitude.channels()[angle], suffix, second);
    }
    let joined = format!(" {} ", name.words.join(" "));
    let is_named = |quantity: Quantity| {
        of_axis_word == Some(quantity)
            || WORDS.iter().any(|(words, known)| *known == quantity && joined.contains(&format!(" {words} ")))
            || suffix.is_some_and(|(known, _)| known == quantity)
    };
    let channel = |quantity: Quantity| match quantity {
        Of(triad) => axis.map(|axis| triad.channels()[axis]),
        Single(channel) => Some(channel),
    };
    let stated = spelled.iter().find(|(quantity, _)| is_named(*quantity));
    if let Some((quantity, suffix)) = stated {
        return value(channel(*quantity)?, suffix, second);
    }
    if name.unit.is_some() {
        return None;
    }
    let quantity = WORDS.iter().map(|(_, quantity)| *quantity).find(|quantity| is_named(*quantity)).or(of_axis_word);
    match quantity {
        Some(quantity) => channel(quantity).map(|channel| Meaning::Unitless { channel }),
        None => axis.filter(|_| name.words.is_empty()).map(Meaning::Axis),
    }
}

/// Takes the unit off the end of a name's words, if one of at least two letters stands there, or `g`.
fn unit_behind(words: &mut Vec<String>) -> Vec<(Quantity, &'static str)> {
    for count in (1..=3.min(words.len().saturating_sub(1))).rev() {
        let spelling = words[words.len() - count..].join("_");
        let found: Vec<_> = units(&spelling)
            .filter(|(quantity, _)| spelling.len() > 1 || (spelling == "g" && *quantity == Of(Triad::Accel)))
            .collect();
        if !found.is_empty() {
            words.truncate(words.len() - count);
            return found;
        }
    }
    Vec::new()
}

/// Returns the meaning of a name of times.
fn time(text: &str) -> Option<Meaning> {
    // Of a path only the last part names it, except of a message's stamp.
    let last_part = text.rsplit(['/', '.']).next().filter(|part| !part.contains([']', ')']));
    if let Some(meaning) = last_part.filter(|part| part.len() < text.len()).and_then(time) {
        return Some(meaning);
    }
    let name = Name::of(text);
    let words: Vec<&str> = name.words.iter().map(String::as_str).collect();
    let (last, before) = words.split_last()?;
    if before.ends_with(&["header", "stamp"]) || (before.last() == Some(&"stamp") && name.unit.is_none()) {
        return match *last {
            "secs" | "sec" => Some(Meaning::Part { places: 9 }),
            "nsecs" | "nsec" | "nanosec" | "nanosecs" => Some(Meaning::Part { places: 0 }),
            _ => None,
        };
    }
    if words.ends_with(&["header", "stamp"]) {
        return Some(Meaning::Time { places: None });
    }
    let of_unit = |unit: &str| TIMES.iter().find(|(known, _)| known.contains(&unit)).map(|(_, places)| *places);
    let is_time = |words: &[&str]| {
        words.iter().any(|word| TIME_WORDS.contains(word))
            && words.iter().all(|word| TIME_WORDS.contains(word) || BESIDE_TIME.contains(word))
    };
    match &name.unit {
        // Remarks in brackets (`Time (UTC)`) are no units.
        Some(unit) => is_time(&words).then(|| Meaning::Time { places: of_unit(unit) }),
        None => match of_unit(last).or_else(|| of_unit(words[0])) {
            Some(places) => {
                let rest: Vec<&str> = words.iter().copied().filter(|word| of_unit(word).is_none()).collect();
                (is_time(&rest) && rest.len() + 1 == words.len()).then_some(Meaning::Time { places: Some(places) })
            }
            None => is_time(&words).then_some(Meaning::Time { places: None }),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meaning_of(name: &str) -> String {
        match meaning(name) {
            Some(Meaning::Value { channel, unit, second, .. }) => {
                format!("{channel} {unit}{}", if second { " second" } else { "" })
            }
            Some(Meaning::Unitless { channel }) => format!("{channel} ?"),
            Some(Meaning::Axis(axis)) => format!("axis {axis}"),
            Some(Meaning::Time { places }) => {
                format!("time {}", places.map_or("?".to_owned(), |places| places.to_string()))
            }
            Some(Meaning::Part { places }) => format!("part {places}"),
            None => "-".to_owned(),
        }
    }

    #[test]
    fn names_of_known_programs_state_channel_and_unit() {
        for (name, expected) in [
            ("#timestamp [ns]", "time 0"),
            ("w_RS_S_x [rad s^-1]", "gyro_x rad/s"),
            ("a_RS_S_z [m s^-2]", "accel_z m/s²"),
            ("gyro_rad[1]", "gyro_y rad/s"),
            ("accelerometer_m_s2[2]", "accel_z m/s²"),
            ("magnetometer_ga[0]", "mag_x gauss"),
            ("gyro_integral_dt", "-"),
            ("accelerometer_timestamp_relative", "-"),
            ("Time (s)", "time 9"),
            ("Acceleration x (m/s^2)", "accel_x m/s²"),
            ("Linear Acceleration x (m/s^2)", "accel_x m/s² second"),
            ("Absolute acceleration (m/s^2)", "-"),
            ("Gyroscope y (rad/s)", "gyro_y rad/s"),
            ("Magnetic field z (µT)", "mag_z µT"),
            ("seconds_elapsed", "time 9"),
            ("time", "time ?"),
            ("z", "axis 2"),
            ("angular_velocity.x", "gyro_x rad/s"),
            ("field.linear_acceleration.z", "accel_z m/s²"),
            ("field.angular_velocity_covariance0", "-"),
            ("angular_velocity_covariance_0", "-"),
            ("header.stamp.secs", "part 9"),
            ("header.stamp.nsecs", "part 0"),
            ("/imu/data/header/stamp/nanosec", "part 0"),
            ("field.header.stamp", "time ?"),
            ("field.header.seq", "-"),
            ("__time", "time ?"),
            ("/imu/data/angular_velocity/x", "gyro_x rad/s"),
            ("/vectornav/raw/common/imu_accel/y", "accel_y m/s²"),
            ("/mag/magnetic_field/x", "mag_x T"),
            ("IMU::AngularRate::Z [rad/s]", "gyro_z rad/s"),
            ("IMU::UncompGyro::X [rad/s]", "gyro_x rad/s second"),
            ("IMU::Mag::X [Gauss]", "mag_x gauss"),
            ("IMU::Temp [Celsius]", "temperature °C"),
            ("IMU::DeltaTheta::X [deg]", "-"),
            ("IMU::DeltaVel::X [m/s]", "-"),
            ("Time::TimeStartup [ns]", "time 0"),
            ("TimeUS", "time 3"),
            ("GyrX", "gyro_x ?"),
            ("orientation.x", "-"),
        ] {
            assert_eq!(meaning_of(name), expected, "{name}");
        }
    }

    #[test]
    fn units_are_read_in_any_case_and_spelling_and_never_guessed() {
        for (name, expected) in [
            ("gyro_x [rad/s]", "gyro_x rad/s"),
            ("GYRO X (DPS)", "gyro_x deg/s"),
            ("GyroZ(°/s)", "gyro_z deg/s"),
            ("gx [mdps]", "gyro_x mdps"),
            ("wy (deg/h)", "gyro_y deg/h"),
            ("Gyro_X_Rad_S", "gyro_x rad/s"),
            ("gyro_x_dps", "gyro_x deg/s"),
            ("ax (g)", "accel_x g"),
            ("AccX [mg]", "accel_x mg"),
            ("accY_ms2", "accel_y m/s²"),
            ("acc_x_g", "accel_x g"),
            ("Mag X [mG]", "mag_x mgauss"),
            ("mag_y (nT)", "mag_y nT"),
            ("mz [uT]", "mag_z µT"),
            ("Pressure [hPa]", "pressure hPa"),
            ("Temp (°C)", "temperature °C"),
            ("Yaw [deg]", "yaw deg"),
            ("roll_rad", "roll rad"),
            ("timestamp_us", "time 3"),
            ("Time [ms]", "time 6"),
            ("Time since start in ms ", "time 6"),
            // What no unit of the quantity is, or no quantity.
            ("gyro_x [m/s^2]", "-"),
            ("gyro_x [counts]", "-"),
            ("accel_x_counts", "-"),
            ("gyro_x", "gyro_x ?"),
            ("velocity_x [m/s]", "-"),
            ("gyro_x_bias [rad/s]", "-"),
            ("gyro_x_adev_rad_s", "-"),
            ("temperature", "temperature ?"),
            ("yaw", "-"),
            // A unit alone is no quantity.
            ("c", "-"),
            ("pa", "-"),
            ("kpa", "-"),
            ("bar", "-"),
            ("mbar", "-"),
            ("celsius", "-"),
            ("note", "-"),
            ("", "-"),
        ] {
            assert_eq!(meaning_of(name), expected, "{name}");
        }
    }
}
