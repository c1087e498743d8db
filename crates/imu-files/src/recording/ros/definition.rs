//! Definitions: converts the text of a message's type to its [`Layout`]. Pure.
//!
//! A definition is the text of the message's type, followed by those of all types in it, each behind a line of `=`
//! and `MSG: package/Name` (ROS 2 also writes `package/msg/Name`). Types that the text lacks come from the
//! definitions that the user gave ([`MessageDefinition`]), then from the [standard ones](imu_core::ros_messages).
//! The wanted types, at any depth, are `sensor_msgs/Imu`, `MagneticField`, `Temperature` and `FluidPressure`, and
//! the groups of `vectornav_msgs`. Also wanted are fields that the user names by their dotted paths (numbers of any
//! kind, and elements of arrays of numbers: `imu.rate[0]`), floating-point numbers named as a CSV's columns
//! (`gyro_x_rad_s`), the stamps of headers, and strings (one may be the sensor's raw line). The rest of arrays is
//! skipped.
//!
//! The text is not trusted: types that contain themselves and types of more fields than the limits below are refused.
//! Formats: <http://wiki.ros.org/msg>, <https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html>.

use super::super::mapping::ColumnMap;
use super::super::names::known_column;
use super::field::{Field, Repeat, parse_field, plain_name};
use super::given::MessageDefinition;
use super::layout::{Encoding, FIELDS_MAX, Layout, MessageError, Number, Op, Unit, Wanted, multiply};
use imu_core::ros_messages;
use imu_core::sample::{Channel, Triad};
use imu_core::units::GAUSS_PER_TESLA;
use std::collections::HashMap;
use std::rc::Rc;

/// The maximum nesting depth of types.
const DEPTH_MAX: usize = 16;
/// Kilopascal in one pascal.
const KPA_PER_PA: f64 = 1e-3;

/// Reads the definition of `message_type`; types that `text` lacks are looked up in `given`.
pub(super) fn layout(
    message_type: &str,
    text: &str,
    encoding: Encoding,
    given: &[MessageDefinition],
    map: &ColumnMap,
) -> Result<Layout, MessageError> {
    let message_type = plain_name(message_type);
    let mut types = Types {
        known: HashMap::new(),
        encoding,
        given,
        map,
        path: String::new(),
        mapped: Vec::new(),
        paths: Vec::new(),
    };
    if !text.trim().is_empty() {
        types.parse(&message_type, text)?;
    }
    let mut left = FIELDS_MAX;
    let mut ops = Vec::new();
    types.expand(&message_type, Meaning::of(&message_type), 0, &mut left, &mut ops)?;
    Ok(Layout { ops, encoding, mapped: types.mapped, paths: types.paths })
}

/// Vectors of `vectornav_msgs`, and the suffixes of their units. Uncompensated ones are left out.
const VECTORNAV: [(&str, Triad, &str); 7] = [
    ("yawpitchroll", Triad::Attitude, "_deg"),
    ("imu_accel", Triad::Accel, "_m_s2"),
    ("imu_rate", Triad::Gyro, "_rad_s"),
    ("magpres_mag", Triad::Mag, "_gauss"),
    ("mag", Triad::Mag, "_gauss"),
    ("accel", Triad::Accel, "_m_s2"),
    ("angularrate", Triad::Gyro, "_rad_s"),
];
/// Paths of fields that are kept for messages.
const PATHS_MAX: usize = 64;

/// The meaning of a type's fields.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Meaning {
    Unknown,
    Header,
    Imu,
    Field,
    Temperature,
    Pressure,
    /// Messages of VectorNav's driver, in the units of its interface control document.
    VectorNav,
    Vector(Triad),
    /// A vector with the suffix of its unit.
    VectorIn(Triad, &'static str),
    /// Nothing in it is wanted.
    Array,
}

impl Meaning {
    fn of(kind: &str) -> Self {
        match kind {
            "std_msgs/Header" | "roslib/Header" => Self::Header,
            "sensor_msgs/Imu" => Self::Imu,
            "sensor_msgs/MagneticField" => Self::Field,
            "sensor_msgs/Temperature" => Self::Temperature,
            "sensor_msgs/FluidPressure" => Self::Pressure,
            "vectornav_msgs/CommonGroup" | "vectornav_msgs/ImuGroup" => Self::VectorNav,
            _ => Self::Unknown,
        }
    }

    /// Returns the meaning of the type of the field `name`.
    fn of_field(self, kind: &str, name: &str) -> Self {
        match (self, name) {
            (Self::Imu, "angular_velocity") => Self::Vector(Triad::Gyro),
            (Self::Imu, "linear_acceleration") => Self::Vector(Triad::Accel),
            (Self::Field, "magnetic_field") => Self::Vector(Triad::Mag),
            (Self::Array, _) => Self::Array,
            (Self::VectorNav, name) => {
                let vector = VECTORNAV.iter().find(|(known, ..)| *known == name);
                vector.map_or_else(|| Self::of(kind), |(_, triad, suffix)| Self::VectorIn(*triad, suffix))
            }
            _ => Self::of(kind),
        }
    }

    /// Returns the channel that the number `name` contains, and its unit.
    fn channel(self, name: &str) -> Option<(Channel, Unit)> {
        let of_ros = |channel: Channel| {
            let (name, factor) = match channel.triad() {
                Some(Triad::Mag) => ("T", GAUSS_PER_TESLA),
                None if channel == Channel::Pressure => ("Pa", KPA_PER_PA),
                _ => (channel.unit(), 1.0),
            };
            (channel, Unit { name, factor })
        };
        match (self, name) {
            (Self::Temperature, "temperature") => Some(of_ros(Channel::Temperature)),
            (Self::Pressure, "fluid_pressure") => Some(of_ros(Channel::Pressure)),
            (Self::Vector(triad), "x" | "y" | "z") => Channel::ALL
                .into_iter()
                .find(|channel| channel.triad() == Some(triad) && channel.name().strip_suffix(name).is_some())
                .map(of_ros),
            (Self::VectorNav, "magpres_temp" | "temp") => {
                Some((Channel::Temperature, Unit { name: "°C", factor: 1.0 }))
            }
            (Self::VectorNav, "magpres_pres" | "pres") => Some((Channel::Pressure, Unit { name: "kPa", factor: 1.0 })),
            (Self::VectorIn(triad, suffix), "x" | "y" | "z") => {
                let place = ["x", "y", "z"].into_iter().position(|axis| axis == name)?;
                let (channel, unit, factor) = known_column(&format!("{}{suffix}", triad.channels()[place].name()))?;
                Some((channel, Unit { name: unit, factor }))
            }
            (Self::Unknown, name) => {
                known_column(name).map(|(channel, unit, factor)| (channel, Unit { name: unit, factor }))
            }
            _ => None,
        }
    }

    /// Returns the triad whose covariance is in the array `name`.
    fn covariance(self, name: &str) -> Option<Triad> {
        match (self, name) {
            (Self::Imu, "angular_velocity_covariance") => Some(Triad::Gyro),
            (Self::Imu, "linear_acceleration_covariance") => Some(Triad::Accel),
            _ => None,
        }
    }
}

/// Returns the bytes of a built-in type; `None` for another one. `string` has no fixed size.
fn size_of(kind: &str, encoding: Encoding) -> Option<usize> {
    Some(match kind {
        // In ROS 2 they are messages.
        "time" | "duration" if encoding == Encoding::Cdr => return None,
        "bool" | "int8" | "uint8" | "byte" | "char" => 1,
        "int16" | "uint16" => 2,
        "int32" | "uint32" | "float32" => 4,
        "int64" | "uint64" | "float64" | "time" | "duration" => 8,
        _ => return None,
    })
}

/// The types of a definition, by their full names.
struct Types<'a> {
    known: HashMap<String, Rc<[Field]>>,
    encoding: Encoding,
    given: &'a [MessageDefinition],
    /// The user's names for fields, by their dotted paths.
    map: &'a ColumnMap,
    /// The path to the present type, with a dot at its end.
    path: String,
    /// The pairs of the map that were found.
    mapped: Vec<usize>,
    /// The paths of the numbers.
    paths: Vec<String>,
}

impl Types<'_> {
    fn parse(&mut self, message_type: &str, definition: &str) -> Result<(), MessageError> {
        let (mut name, mut fields) = (message_type.to_owned(), Vec::new());
        let mut count = 0;
        let mut keep = |name: String, fields: Vec<Field>| {
            self.known.entry(name).or_insert(fields.into());
        };
        for line in definition.lines() {
            let line = line.trim();
            if line.len() >= 3 && line.bytes().all(|byte| byte == b'=') {
                continue;
            }
            if let Some(next) = line.strip_prefix("MSG:") {
                keep(std::mem::replace(&mut name, plain_name(next)), std::mem::take(&mut fields));
                continue;
            }
            if let Some(field) = parse_field(line, self.encoding)? {
                count += 1;
                if count > FIELDS_MAX {
                    return Err(MessageError::TooMuch);
                }
                fields.push(field);
            }
        }
        keep(name, fields);
        Ok(())
    }

    /// Returns the fields of the type `name`: from the definition, the given ones, or the standard types.
    fn fields(&mut self, name: &str) -> Result<Option<Rc<[Field]>>, MessageError> {
        if !self.known.contains_key(name) {
            let given = MessageDefinition::text_of(self.given, name);
            let Some(text) = given.or_else(|| self.standard(name)) else { return Ok(None) };
            self.parse(name, text)?;
        }
        Ok(self.known.get(name).map(Rc::clone))
    }

    /// Returns the fields of a standard type of ROS 2; those of ROS 1 differ, and its bags contain them.
    fn standard(&self, name: &str) -> Option<&'static str> {
        (self.encoding == Encoding::Cdr).then(|| ros_messages::fields_of(name)).flatten()
    }

    /// Returns the full name of the type that `kind` denotes inside a type of `package`, and its fields.
    fn resolve(&mut self, kind: &str, package: &str) -> Result<(String, Rc<[Field]>), MessageError> {
        let kind = plain_name(kind);
        let names = if kind.contains('/') {
            vec![kind.clone()]
        } else {
            // `Header` alone is the only short name across packages.
            [package, "std_msgs", "roslib"].map(|package| format!("{package}/{kind}")).to_vec()
        };
        for name in names {
            if let Some(fields) = self.fields(&name)? {
                return Ok((name, fields));
            }
        }
        Err(MessageError::Type(kind.chars().take(80).collect()))
    }

    fn expand(
        &mut self,
        kind: &str,
        meaning: Meaning,
        depth: usize,
        left: &mut usize,
        ops: &mut Vec<Op>,
    ) -> Result<(), MessageError> {
        if depth > DEPTH_MAX {
            return Err(MessageError::TooMuch);
        }
        let fields = self.fields(kind)?.ok_or_else(|| MessageError::Type(kind.chars().take(80).collect()))?;
        let package = kind.split('/').next().unwrap_or_default();
        if fields.is_empty() && self.encoding == Encoding::Cdr {
            // A type without fields is sent as one byte.
            return self.skip(ops, 1, 1);
        }
        for field in fields.iter() {
            *left = left.checked_sub(1).ok_or(MessageError::TooMuch)?;
            match size_of(&field.kind, self.encoding) {
                Some(size) => self.plain(field, size, meaning, ops)?,
                None if field.kind == "string" => ops.push(match field.repeat {
                    Repeat::Once if meaning == Meaning::Header => Op::SkipCounted { align: 1, bytes: 1 },
                    Repeat::Once => Op::Text,
                    Repeat::Times(times) => Op::Repeat(Some(times), vec![Op::SkipCounted { align: 1, bytes: 1 }]),
                    Repeat::Counted => Op::Repeat(None, vec![Op::SkipCounted { align: 1, bytes: 1 }]),
                }),
                None => self.nested(field, package, meaning, depth, left, ops)?,
            }
        }
        Ok(())
    }

    /// Adds a field of a built-in type of `size` bytes.
    fn plain(&mut self, field: &Field, size: usize, meaning: Meaning, ops: &mut Vec<Op>) -> Result<(), MessageError> {
        let name = field.name.as_str();
        match field.repeat {
            Repeat::Once => {
                let number = Number::of(&field.kind);
                let is_float = matches!(number, Some(Number::Float32 | Number::Float64));
                let own = meaning.channel(name).filter(|(channel, _)| is_float && !self.map.has(*channel));
                let found = number.and_then(|number| Some((number, self.of_user(name, meaning).or(own)?)));
                match found {
                    // A second sensor in one message does not overwrite the first.
                    Some((number, (channel, unit))) if !has(ops, channel) => {
                        ops.push(Op::Value(Wanted { channel, number, unit }));
                    }
                    _ if meaning == Meaning::Header && field.kind == "time" => ops.push(Op::Stamp),
                    _ => self.skip(ops, size, size)?,
                }
            }
            Repeat::Times(times) => {
                let bytes = multiply(size, times)?;
                if self.elements(field, Some(times), meaning, ops) {
                    return Ok(());
                }
                match meaning.covariance(name).filter(|_| field.kind == "float64" && times > 0) {
                    Some(triad) if !ops.contains(&Op::Covariance(triad)) => {
                        ops.push(Op::Covariance(triad));
                        self.skip(ops, size, bytes - size)?;
                    }
                    _ => self.skip(ops, size, bytes)?,
                }
            }
            Repeat::Counted if self.elements(field, None, meaning, ops) => {}
            Repeat::Counted => ops.push(Op::SkipCounted { align: size, bytes: size }),
        }
        Ok(())
    }

    /// Returns what the user's map states about a number.
    fn of_user(&mut self, name: &str, meaning: Meaning) -> Option<(Channel, Unit)> {
        if meaning == Meaning::Array {
            return None;
        }
        let path = format!("{}{name}", self.path);
        let found = self.map.of(0, &path).map(|(pair, name)| (pair, known_column(name)));
        self.note(path);
        let (pair, (channel, unit, factor)) = found.and_then(|(pair, known)| Some((pair, known?)))?;
        self.mapped.push(pair);
        Some((channel, Unit { name: unit, factor }))
    }

    /// Keeps a path for messages.
    fn note(&mut self, path: String) {
        if self.paths.len() < PATHS_MAX {
            self.paths.push(path);
        }
    }

    /// Adds an array of numbers if the user's map names elements of it, as `rate[0]` or `rate.0`; returns whether it does.
    fn elements(&mut self, field: &Field, count: Option<u32>, meaning: Meaning, ops: &mut Vec<Op>) -> bool {
        let Some(number) = Number::of(&field.kind).filter(|_| meaning != Meaning::Array && count != Some(0)) else {
            return false;
        };
        let path = format!("{}{}", self.path, field.name);
        let (map, mut wanted): (&ColumnMap, Vec<(u32, Wanted)>) = (self.map, Vec::new());
        for (pair, place, name) in map.elements(&path) {
            let known = known_column(name).filter(|_| count.is_none_or(|count| place < count));
            let Some((channel, unit, factor)) = known else { continue };
            if !has(ops, channel) && wanted.iter().all(|(_, other)| other.channel != channel) {
                wanted.push((place, Wanted { channel, number, unit: Unit { name: unit, factor } }));
                self.mapped.push(pair);
            }
        }
        let last = count.map_or_else(|| "…".to_owned(), |count| (count - 1).to_string());
        self.note(if last == "0" { format!("{path}[0]") } else { format!("{path}[0] to [{last}]") });
        let found = !wanted.is_empty();
        if found {
            ops.push(Op::Elements(count, number, wanted));
        }
        found
    }

    /// Adds a field that is itself a message, or an array of messages.
    fn nested(
        &mut self,
        field: &Field,
        package: &str,
        meaning: Meaning,
        depth: usize,
        left: &mut usize,
        ops: &mut Vec<Op>,
    ) -> Result<(), MessageError> {
        let (inner, _) = self.resolve(&field.kind, package)?;
        if field.repeat == Repeat::Once {
            if meaning == Meaning::Header && inner == "builtin_interfaces/Time" {
                ops.push(Op::Stamp);
                return Ok(());
            }
            let before = self.path.len();
            self.path.push_str(&field.name);
            self.path.push('.');
            let expanded = self.expand(&inner, meaning.of_field(&inner, &field.name), depth + 1, left, ops);
            self.path.truncate(before);
            return expanded;
        }
        let mut body = Vec::new();
        self.expand(&inner, Meaning::Array, depth + 1, left, &mut body)?;
        let plain = match body.as_slice() {
            [] => Some((1, 0)),
            [Op::Skip { align, bytes }] => Some((*align, *bytes)),
            _ => None,
        };
        match (plain, field.repeat) {
            (Some((align, bytes)), Repeat::Times(times)) => self.skip(ops, align, multiply(bytes, times)?)?,
            (Some((align, bytes)), _) => ops.push(Op::SkipCounted { align, bytes }),
            (None, Repeat::Times(times)) => ops.push(Op::Repeat(Some(times), body)),
            (None, _) => ops.push(Op::Repeat(None, body)),
        }
        Ok(())
    }

    /// Adds unwanted bytes, values of `size` bytes each; if nothing is aligned, neighbours are merged into one step.
    fn skip(&self, ops: &mut Vec<Op>, size: usize, bytes: usize) -> Result<(), MessageError> {
        let align = if self.encoding == Encoding::Cdr { size } else { 1 };
        match ops.last_mut() {
            _ if bytes == 0 => {}
            Some(Op::Skip { align: before, bytes: sum }) if *before == align => {
                *sum = sum.checked_add(bytes).ok_or(MessageError::TooMuch)?;
            }
            _ => ops.push(Op::Skip { align, bytes }),
        }
        Ok(())
    }
}

fn has(ops: &[Op], wanted: Channel) -> bool {
    ops.iter().flat_map(Op::wanted).any(|of| of.channel == wanted)
}
