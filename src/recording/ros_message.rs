//! ROS 1 messages: the text of a definition → a layout → the values in a message's bytes. Pure.
//!
//! A definition is the text of the message's type, then those of all types in it, each behind a line of `=` and
//! `MSG: package/Name`. Values lie one behind the other, little-endian, without padding; strings and arrays of variable
//! length begin with their count. The layout keeps only what is wanted and how much lies between. Wanted are, wherever
//! they stand: `sensor_msgs/Imu`, `MagneticField`, `Temperature`, `FluidPressure`, the stamps of headers, and strings (one
//! may be the sensor's raw line). What stands in arrays is passed over.
//!
//! Neither text nor bytes are trusted: types that contain themselves, and definitions or messages that would take more
//! steps than the limits below, are refused. Format: <http://wiki.ros.org/msg>, <http://wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes>.

use crate::sample::{Channel, Triad};
use crate::units::NANOS_PER_SECOND;
use std::collections::HashMap;

/// Types in types.
const DEPTH_MAX: usize = 16;
/// Fields of a type, all types in it counted.
const FIELDS_MAX: usize = 4000;
/// Steps of reading one message.
const STEPS_MAX: u32 = 100_000;

/// Why a definition or a message cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum MessageError {
    /// A line of a definition.
    #[error("the definition's line {0:?} is no field")]
    Line(String),
    /// A type that is not there.
    #[error("the definition does not have the type {0:?}")]
    Type(String),
    /// Too many fields, or a type in itself.
    #[error("the definition has more than {FIELDS_MAX} fields, or a type that contains itself")]
    TooMuch,
    /// Fewer bytes than the layout asks for.
    #[error("the message ends too early")]
    Short,
    /// More bytes than the layout asks for.
    #[error("{0} bytes are left behind the message's last field")]
    Long(usize),
    /// Too many steps.
    #[error("the message has arrays of more than {STEPS_MAX} elements")]
    TooLong,
}

/// Nanoseconds since 1970 of a ROS time.
pub(super) fn time_ns(seconds: u32, nanos: u32) -> i64 {
    i64::from(seconds) * NANOS_PER_SECOND as i64 + i64::from(nanos)
}

/// What a message says.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Values<'a> {
    /// The first stamp of a header that is not 0, ns since 1970.
    pub(super) stamp_ns: Option<i64>,
    /// Values in the units of ROS: m/s², rad/s, tesla, °C, pascal.
    pub(super) channels: [Option<f64>; Channel::COUNT],
    /// The first string that holds a raw line, from its `$VN`.
    pub(super) raw: Option<&'a [u8]>,
}

/// One step of reading.
#[derive(Debug, Clone, PartialEq)]
enum Op {
    /// So many bytes that are not wanted.
    Skip(usize),
    /// A count, and as many elements of this size.
    SkipCounted(usize),
    /// So many elements (`None`: a count comes first) of variable length.
    Repeat(Option<u32>, Vec<Op>),
    Stamp,
    Text,
    Value {
        channel: Channel,
        wide: bool,
    },
    /// The first element of a covariance: −1 says that the triad's values are none.
    Covariance(Triad),
}

/// Where a type's values lie and which of them are wanted.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    ops: Vec<Op>,
}

/// A field of a type.
#[derive(Debug, Clone)]
struct Field {
    kind: String,
    name: String,
    repeat: Repeat,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Repeat {
    Once,
    Times(u32),
    Counted,
}

/// What a type's fields mean.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Meaning {
    Unknown,
    Header,
    Imu,
    Field,
    Temperature,
    Pressure,
    Vector(Triad),
}

impl Layout {
    /// Reads the definition of `message_type`.
    pub(super) fn parse(message_type: &str, definition: &str) -> Result<Self, MessageError> {
        let types = Types::parse(message_type, definition)?;
        let mut left = FIELDS_MAX;
        let mut ops = Vec::new();
        types.expand(message_type, Meaning::of(message_type), 0, &mut left, &mut ops)?;
        Ok(Self { ops })
    }

    /// The channels that a message of this type may have.
    pub(super) fn channels(&self) -> impl Iterator<Item = Channel> + '_ {
        self.ops.iter().filter_map(|op| if let Op::Value { channel, .. } = op { Some(*channel) } else { None })
    }

    /// Whether a message of this type may have the sensor's raw line.
    pub(super) fn has_text(&self) -> bool {
        self.ops.contains(&Op::Text)
    }

    /// The values in a message's bytes.
    pub(super) fn read<'a>(&self, bytes: &'a [u8]) -> Result<Values<'a>, MessageError> {
        let mut cursor = Cursor { rest: bytes, steps: 0 };
        let mut values = Values::default();
        cursor.walk(&self.ops, &mut values)?;
        if cursor.rest.is_empty() { Ok(values) } else { Err(MessageError::Long(cursor.rest.len())) }
    }
}

impl Meaning {
    fn of(kind: &str) -> Self {
        match kind {
            "std_msgs/Header" | "roslib/Header" => Self::Header,
            "sensor_msgs/Imu" => Self::Imu,
            "sensor_msgs/MagneticField" => Self::Field,
            "sensor_msgs/Temperature" => Self::Temperature,
            "sensor_msgs/FluidPressure" => Self::Pressure,
            _ => Self::Unknown,
        }
    }

    /// Of the type of the field `name`.
    fn of_field(self, kind: &str, name: &str) -> Self {
        match (self, name) {
            (Self::Imu, "angular_velocity") => Self::Vector(Triad::Gyro),
            (Self::Imu, "linear_acceleration") => Self::Vector(Triad::Accel),
            (Self::Field, "magnetic_field") => Self::Vector(Triad::Mag),
            _ => Self::of(kind),
        }
    }

    /// The channel that the number `name` gives.
    fn channel(self, name: &str) -> Option<Channel> {
        match (self, name) {
            (Self::Temperature, "temperature") => Some(Channel::Temperature),
            (Self::Pressure, "fluid_pressure") => Some(Channel::Pressure),
            (Self::Vector(triad), "x" | "y" | "z") => Channel::ALL
                .into_iter()
                .find(|channel| channel.triad() == Some(triad) && channel.name().strip_suffix(name).is_some()),
            _ => None,
        }
    }

    /// The triad whose covariance the array `name` is.
    fn covariance(self, name: &str) -> Option<Triad> {
        match (self, name) {
            (Self::Imu, "angular_velocity_covariance") => Some(Triad::Gyro),
            (Self::Imu, "linear_acceleration_covariance") => Some(Triad::Accel),
            _ => None,
        }
    }
}

/// Bytes of a built-in type; `None` for another one. `string` has no size of its own.
fn size_of(kind: &str) -> Option<usize> {
    Some(match kind {
        "bool" | "int8" | "uint8" | "byte" | "char" => 1,
        "int16" | "uint16" => 2,
        "int32" | "uint32" | "float32" => 4,
        "int64" | "uint64" | "float64" | "time" | "duration" => 8,
        _ => return None,
    })
}

/// The types of a definition, by their full names.
struct Types(HashMap<String, Vec<Field>>);

impl Types {
    fn parse(message_type: &str, definition: &str) -> Result<Self, MessageError> {
        let mut types = HashMap::new();
        let (mut name, mut fields) = (message_type.to_owned(), Vec::new());
        let mut count = 0;
        for line in definition.lines() {
            let line = line.trim();
            if line.len() >= 3 && line.bytes().all(|byte| byte == b'=') {
                continue;
            }
            if let Some(next) = line.strip_prefix("MSG:") {
                types.insert(std::mem::replace(&mut name, next.trim().to_owned()), std::mem::take(&mut fields));
                continue;
            }
            if let Some(field) = parse_field(line)? {
                count += 1;
                if count > FIELDS_MAX {
                    return Err(MessageError::TooMuch);
                }
                fields.push(field);
            }
        }
        types.insert(name, fields);
        Ok(Self(types))
    }

    /// The full name of the type that `kind` means inside a type of `package`.
    fn resolve(&self, kind: &str, package: &str) -> Result<&str, MessageError> {
        let names = [
            kind.to_owned(),
            format!("{package}/{kind}"),
            // `Header` alone is the only short name across packages.
            format!("std_msgs/{kind}"),
            format!("roslib/{kind}"),
        ];
        names
            .iter()
            .find_map(|name| self.0.get_key_value(name))
            .map(|(name, _)| name.as_str())
            .ok_or_else(|| MessageError::Type(kind.chars().take(80).collect()))
    }

    fn expand(
        &self,
        kind: &str,
        meaning: Meaning,
        depth: usize,
        left: &mut usize,
        ops: &mut Vec<Op>,
    ) -> Result<(), MessageError> {
        if depth > DEPTH_MAX {
            return Err(MessageError::TooMuch);
        }
        let fields = self.0.get(kind).ok_or_else(|| MessageError::Type(kind.to_owned()))?;
        let package = kind.split('/').next().unwrap_or_default();
        for field in fields {
            *left = left.checked_sub(1).ok_or(MessageError::TooMuch)?;
            let name = field.name.as_str();
            match (size_of(&field.kind), field.repeat) {
                (Some(size), Repeat::Once) => {
                    let wide = field.kind == "float64";
                    let is_float = wide || field.kind == "float32";
                    match meaning.channel(name).filter(|_| is_float) {
                        // A second sensor in one message does not overwrite the first.
                        Some(channel) if !has(ops, channel) => ops.push(Op::Value { channel, wide }),
                        _ if meaning == Meaning::Header && field.kind == "time" => ops.push(Op::Stamp),
                        _ => skip(ops, size)?,
                    }
                }
                (Some(size), Repeat::Times(times)) => {
                    let bytes = multiply(size, times)?;
                    match meaning.covariance(name).filter(|_| field.kind == "float64" && times > 0) {
                        Some(triad) => {
                            ops.push(Op::Covariance(triad));
                            skip(ops, bytes - size)?;
                        }
                        None => skip(ops, bytes)?,
                    }
                }
                (Some(size), Repeat::Counted) => ops.push(Op::SkipCounted(size)),
                (None, repeat) if field.kind == "string" => match repeat {
                    Repeat::Once if meaning == Meaning::Header => ops.push(Op::SkipCounted(1)),
                    Repeat::Once => ops.push(Op::Text),
                    Repeat::Times(times) => ops.push(Op::Repeat(Some(times), vec![Op::SkipCounted(1)])),
                    Repeat::Counted => ops.push(Op::Repeat(None, vec![Op::SkipCounted(1)])),
                },
                (None, repeat) => {
                    let inner = self.resolve(&field.kind, package)?;
                    if repeat == Repeat::Once {
                        self.expand(inner, meaning.of_field(inner, name), depth + 1, left, ops)?;
                        continue;
                    }
                    let mut body = Vec::new();
                    self.expand(inner, Meaning::Unknown, depth + 1, left, &mut body)?;
                    let size = match body.as_slice() {
                        [] => Some(0),
                        [Op::Skip(size)] => Some(*size),
                        _ => None,
                    };
                    match (size, repeat) {
                        (Some(size), Repeat::Times(times)) => skip(ops, multiply(size, times)?)?,
                        (Some(size), _) => ops.push(Op::SkipCounted(size)),
                        (None, Repeat::Times(times)) => ops.push(Op::Repeat(Some(times), body)),
                        (None, _) => ops.push(Op::Repeat(None, body)),
                    }
                }
            }
        }
        Ok(())
    }
}

fn has(ops: &[Op], wanted: Channel) -> bool {
    ops.iter().any(|op| matches!(op, Op::Value { channel, .. } if *channel == wanted))
}

fn multiply(size: usize, times: u32) -> Result<usize, MessageError> {
    usize::try_from(times).ok().and_then(|times| times.checked_mul(size)).ok_or(MessageError::TooMuch)
}

fn skip(ops: &mut Vec<Op>, bytes: usize) -> Result<(), MessageError> {
    match ops.last_mut() {
        _ if bytes == 0 => {}
        Some(Op::Skip(before)) => *before = before.checked_add(bytes).ok_or(MessageError::TooMuch)?,
        _ => ops.push(Op::Skip(bytes)),
    }
    Ok(())
}

/// A line of a definition; `None` where it is empty, a comment or a constant.
fn parse_field(line: &str) -> Result<Option<Field>, MessageError> {
    let line = line.split('#').next().unwrap_or_default().trim();
    if line.is_empty() || line.contains('=') {
        return Ok(None);
    }
    let refuse = || MessageError::Line(line.chars().take(80).collect());
    let mut words = line.split_whitespace();
    let (Some(kind), Some(name), None) = (words.next(), words.next(), words.next()) else { return Err(refuse()) };
    let (kind, repeat) = match kind.strip_suffix(']') {
        None => (kind, Repeat::Once),
        Some(array) => {
            let (kind, count) = array.split_once('[').ok_or_else(refuse)?;
            let repeat =
                if count.is_empty() { Repeat::Counted } else { Repeat::Times(count.parse().map_err(|_| refuse())?) };
            (kind, repeat)
        }
    };
    Ok(Some(Field { kind: kind.to_owned(), name: name.to_owned(), repeat }))
}

/// The bytes of a message that were not read yet.
struct Cursor<'a> {
    rest: &'a [u8],
    steps: u32,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, bytes: usize) -> Result<&'a [u8], MessageError> {
        let (taken, rest) = self.rest.split_at_checked(bytes).ok_or(MessageError::Short)?;
        self.rest = rest;
        Ok(taken)
    }

    fn number(&mut self) -> Result<u32, MessageError> {
        let bytes = self.take(4)?.try_into().map_err(|_| MessageError::Short)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn wide(&mut self) -> Result<f64, MessageError> {
        let bytes = self.take(8)?.try_into().map_err(|_| MessageError::Short)?;
        Ok(f64::from_le_bytes(bytes))
    }

    fn step(&mut self) -> Result<(), MessageError> {
        self.steps += 1;
        if self.steps > STEPS_MAX { Err(MessageError::TooLong) } else { Ok(()) }
    }

    fn walk(&mut self, ops: &[Op], values: &mut Values<'a>) -> Result<(), MessageError> {
        for op in ops {
            self.step()?;
            match op {
                Op::Skip(bytes) => {
                    self.take(*bytes)?;
                }
                Op::SkipCounted(size) => {
                    let count = self.number()?;
                    self.take(multiply(*size, count)?)?;
                }
                Op::Repeat(count, body) => {
                    let count = match count {
                        Some(count) => *count,
                        None => self.number()?,
                    };
                    // What stands in arrays is not wanted, so that nothing in them is kept.
                    let mut unwanted = Values::default();
                    for _ in 0..count {
                        self.step()?;
                        self.walk(body, &mut unwanted)?;
                    }
                }
                Op::Stamp => {
                    let stamp_ns = time_ns(self.number()?, self.number()?);
                    values.stamp_ns = values.stamp_ns.or(Some(stamp_ns).filter(|stamp_ns| *stamp_ns != 0));
                }
                Op::Text => {
                    let length = self.number()?;
                    let text = self.take(usize::try_from(length).map_err(|_| MessageError::Short)?)?;
                    if values.raw.is_none() {
                        let start = text.windows(3).position(|window| window == b"$VN");
                        values.raw = start.and_then(|start| text.get(start..));
                    }
                }
                Op::Value { channel, wide } => {
                    let value = if *wide { self.wide()? } else { f64::from(f32::from_bits(self.number()?)) };
                    values.channels[*channel as usize] = Some(value);
                }
                Op::Covariance(triad) => {
                    if self.wide()? == -1.0 {
                        for channel in triad.channels() {
                            values.channels[channel as usize] = None;
                        }
                    }
                }
            }
        }
        Ok(())
    }
}
