//! Layouts: the positions of the wanted values in a message's bytes, and reading them. Pure.
//!
//! Wanted are the channels, the stamp of the first header that has one, and the first string that holds a raw `$VN…`
//! line; the rest is skipped. A layout is made from a type's definition ([`super::definition`]) and read from bytes in
//! one of two encodings. ROS 1: little-endian, without padding. CDR, as ROS 2 writes it: four bytes that state the byte
//! order, then values each at a multiple of its own size; strings end with a zero byte that counts.
//!
//! Bytes are not trusted: data that would take more steps than [`STEPS_MAX`], or lies beyond the message, is an error.
//! Formats: <http://wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes>; OMG DDSI-RTPS 2.5, clause 10.

use imu_core::sample::{Channel, Triad};
use imu_core::units::NANOS_PER_SECOND;

/// The maximum number of fields of a type, including those of all types in it.
pub(super) const FIELDS_MAX: usize = 4000;
/// The maximum number of steps to read one message.
const STEPS_MAX: u32 = 100_000;
/// The CDR header before the values: representation and options, two bytes each.
const CDR_HEAD_BYTES: usize = 4;
/// The maximum padding of a CDR message behind its last value, in bytes.
const CDR_FILL_BYTES: usize = 7;

/// Why a definition or a message cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(in crate::recording) enum MessageError {
    /// A line of a definition is invalid.
    #[error("the definition's line {0:?} is no field")]
    Line(String),
    /// A type is not defined.
    #[error("there is no definition of the type {0:?}: give it with --message-definition FILE.msg")]
    Type(String),
    /// There are too many fields, or a type contains itself.
    #[error("the definition has more than {} fields, or a type that contains itself", FIELDS_MAX)]
    TooMuch,
    /// The encoding is neither that of ROS 1 nor CDR.
    #[error("messages are encoded as {0:?}: ros1 and cdr are read")]
    Encoding(String),
    /// The message is compressed.
    #[error(
        "the message is compressed, which its bag does not state: convert the bag with `ros2 bag convert`, without compression"
    )]
    Compressed,
    /// The message has fewer bytes than the layout requires.
    #[error("the message ends too early")]
    Short,
    /// The message has more bytes than the layout requires.
    #[error("{0} bytes are left behind the message's last field")]
    Long(usize),
    /// Reading the message would take too many steps.
    #[error("the message has arrays of more than {STEPS_MAX} elements")]
    TooLong,
}

/// The encoding of a message's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::recording) enum Encoding {
    Ros1,
    Cdr,
}

impl Encoding {
    /// Returns the encoding with this name in MCAP and ROS 2 bags.
    pub(super) fn from_name(name: &str) -> Result<Self, MessageError> {
        match name {
            "ros1" => Ok(Self::Ros1),
            "cdr" => Ok(Self::Cdr),
            other => Err(MessageError::Encoding(other.chars().take(80).collect())),
        }
    }
}

/// A channel's unit in a message: its name, and the factor to the channel's own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unit {
    pub(super) name: &'static str,
    pub(super) factor: f64,
}

/// The values of a message.
#[derive(Debug, Clone, PartialEq, Default)]
pub(in crate::recording) struct Values<'a> {
    /// The first stamp of a header that is not 0, ns since 1970.
    pub(super) stamp_ns: Option<i64>,
    /// Values in the channels' units.
    pub(super) channels: [Option<f64>; Channel::COUNT],
    /// The first string that holds a raw line, from its `$VN`.
    pub(super) raw: Option<&'a [u8]>,
}

/// The form of a number in a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    Float32,
    Float64,
    /// An integer of 1, 2, 4 or 8 bytes.
    Int {
        bytes: usize,
        signed: bool,
    },
}

impl Number {
    /// Returns the form of a built-in type; `None` if it is no number.
    pub(super) fn of(kind: &str) -> Option<Self> {
        let int = |bytes, signed| Some(Self::Int { bytes, signed });
        match kind {
            "float32" => Some(Self::Float32),
            "float64" => Some(Self::Float64),
            "int8" => int(1, true),
            "uint8" => int(1, false),
            "int16" => int(2, true),
            "uint16" => int(2, false),
            "int32" => int(4, true),
            "uint32" => int(4, false),
            "int64" => int(8, true),
            "uint64" => int(8, false),
            _ => None,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::Float32 => 4,
            Self::Float64 => 8,
            Self::Int { bytes, .. } => bytes,
        }
    }
}

/// A wanted number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wanted {
    pub(super) channel: Channel,
    pub(super) number: Number,
    pub(super) unit: Unit,
}

/// One step of reading. Alignments are those of CDR.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Op {
    /// Unwanted bytes.
    Skip {
        align: usize,
        bytes: usize,
    },
    /// A count, and as many elements of this many bytes.
    SkipCounted {
        align: usize,
        bytes: usize,
    },
    /// This many elements (`None`: a count comes first) of variable length.
    Repeat(Option<u32>, Vec<Op>),
    Stamp,
    Text,
    Value(Wanted),
    /// This many numbers (`None`: a count comes first), of which some are wanted, by their places from 0.
    Elements(Option<u32>, Number, Vec<(u32, Wanted)>),
    /// The first element of a covariance: −1 states that the triad has no values.
    Covariance(Triad),
}

impl Op {
    /// Returns the wanted numbers of the step itself.
    pub(super) fn wanted(&self) -> impl Iterator<Item = &Wanted> {
        let (one, several): (Option<&Wanted>, &[(u32, Wanted)]) = match self {
            Self::Value(wanted) => (Some(wanted), &[]),
            Self::Elements(_, _, wanted) => (None, wanted),
            _ => (None, &[]),
        };
        one.into_iter().chain(several.iter().map(|(_, wanted)| wanted))
    }
}

/// The positions of a type's values, and which of them are wanted.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::recording) struct Layout {
    pub(super) ops: Vec<Op>,
    pub(super) encoding: Encoding,
    /// The pairs of the user's map whose fields it has.
    pub(super) mapped: Vec<usize>,
    /// The paths of its numbers.
    pub(super) paths: Vec<String>,
}

/// The first bytes of data that zstd compressed; those of CDR are 0 and an encoding, and no string of ROS 1 is so long.
const ZSTD: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];

impl Layout {
    /// Returns the channels that a message of this type may contain, and their units in it.
    pub(super) fn channels(&self) -> impl Iterator<Item = (Channel, Unit)> + '_ {
        self.ops.iter().flat_map(Op::wanted).map(|wanted| (wanted.channel, wanted.unit))
    }

    /// Returns whether a message of this type may have the sensor's raw line.
    pub(super) fn has_text(&self) -> bool {
        self.ops.contains(&Op::Text)
    }

    /// Returns the values in a message's bytes.
    pub(super) fn read<'a>(&self, bytes: &'a [u8]) -> Result<Values<'a>, MessageError> {
        if bytes.starts_with(&ZSTD) {
            return Err(MessageError::Compressed);
        }
        let mut cursor = Cursor::new(bytes, self.encoding)?;
        let mut values = Values::default();
        cursor.walk(&self.ops, &mut values)?;
        let left = bytes.len() - cursor.at;
        let fill = if self.encoding == Encoding::Cdr { CDR_FILL_BYTES } else { 0 };
        if left <= fill { Ok(values) } else { Err(MessageError::Long(left)) }
    }
}

/// Returns the nanoseconds since 1970 of a ROS time.
pub(super) fn time_ns(seconds: u32, nanos: u32) -> i64 {
    i64::from(seconds) * NANOS_PER_SECOND as i64 + i64::from(nanos)
}

pub(super) fn multiply(bytes: usize, times: u32) -> Result<usize, MessageError> {
    usize::try_from(times).ok().and_then(|times| times.checked_mul(bytes)).ok_or(MessageError::TooMuch)
}

/// A message's bytes, and the read position.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The origin of alignments, and the largest alignment: 1 if nothing is aligned.
    origin: usize,
    align_max: usize,
    big_endian: bool,
    /// Whether strings end with a zero byte.
    zero_ended: bool,
    steps: u32,
}

impl<'a> Cursor<'a> {
    fn new(bytes: &'a [u8], encoding: Encoding) -> Result<Self, MessageError> {
        let plain = Self { bytes, at: 0, origin: 0, align_max: 1, big_endian: false, zero_ended: false, steps: 0 };
        if encoding == Encoding::Ros1 {
            return Ok(plain);
        }
        let (Some(0), Some(representation)) = (bytes.first(), bytes.get(1)) else { return Err(MessageError::Short) };
        // 0 and 1 are CDR of XTypes' version 1, 6 and 7 plain CDR of version 2, which aligns to 4 at most; odd ones are
        // little-endian. The others are for extensible types, which ROS does not have.
        let align_max = match representation {
            0 | 1 => 8,
            6 | 7 => 4,
            other => return Err(MessageError::Encoding(format!("cdr representation {other}"))),
        };
        Ok(Self {
            at: CDR_HEAD_BYTES,
            origin: CDR_HEAD_BYTES,
            align_max,
            big_endian: representation % 2 == 0,
            zero_ended: true,
            ..plain
        })
    }

    fn align(&mut self, to: usize) {
        let to = to.min(self.align_max);
        self.at = self.origin + (self.at - self.origin).next_multiple_of(to);
    }

    fn take(&mut self, bytes: usize) -> Result<&'a [u8], MessageError> {
        let end = self.at.checked_add(bytes).ok_or(MessageError::Short)?;
        let taken = self.bytes.get(self.at..end).ok_or(MessageError::Short)?;
        self.at = end;
        Ok(taken)
    }

    fn number(&mut self) -> Result<u32, MessageError> {
        self.align(4);
        let bytes = self.take(4)?.try_into().map_err(|_| MessageError::Short)?;
        Ok(if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    fn wide(&mut self) -> Result<f64, MessageError> {
        self.align(8);
        let bytes = self.take(8)?.try_into().map_err(|_| MessageError::Short)?;
        Ok(if self.big_endian { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) })
    }

    fn value(&mut self, wanted: &Wanted, values: &mut Values<'a>) -> Result<(), MessageError> {
        let Wanted { channel, number, unit } = *wanted;
        let value = match number {
            Number::Float64 => self.wide()?,
            Number::Float32 => f64::from(f32::from_bits(self.number()?)),
            Number::Int { bytes, signed } => self.integer(bytes, signed)?,
        };
        // A factor of 1 must leave the value as it was sent.
        let value = if unit.factor == 1.0 { value } else { value * unit.factor };
        values.channels[channel as usize] = Some(value);
        Ok(())
    }

    fn integer(&mut self, bytes: usize, signed: bool) -> Result<f64, MessageError> {
        self.align(bytes);
        let taken = self.take(bytes)?;
        let shift = |sum: u64, byte: &u8| sum << 8 | u64::from(*byte);
        let bits = if self.big_endian { taken.iter().fold(0, shift) } else { taken.iter().rev().fold(0, shift) };
        // The sign is that of the value's own highest bit.
        let unused = 64 - 8 * bytes as u32;
        Ok(if signed { ((bits << unused) as i64 >> unused) as f64 } else { bits as f64 })
    }

    /// Reads the wanted ones of `count` numbers; a place behind the last one has no value.
    fn elements(
        &mut self,
        count: u32,
        number: Number,
        wanted: &[(u32, Wanted)],
        values: &mut Values<'a>,
    ) -> Result<(), MessageError> {
        let bytes = number.bytes();
        if count > 0 {
            self.align(bytes);
        }
        let from = self.at;
        self.take(multiply(bytes, count)?)?;
        let end = self.at;
        for (place, of) in wanted.iter().filter(|(place, _)| *place < count) {
            self.at = from + multiply(bytes, *place)?;
            self.value(of, values)?;
        }
        self.at = end;
        Ok(())
    }

    fn skip(&mut self, align: usize, bytes: usize) -> Result<(), MessageError> {
        if bytes > 0 {
            self.align(align);
            self.take(bytes)?;
        }
        Ok(())
    }

    fn text(&mut self) -> Result<&'a [u8], MessageError> {
        let length = self.number()?;
        let text = self.take(usize::try_from(length).map_err(|_| MessageError::Short)?)?;
        Ok(if self.zero_ended { text.strip_suffix(&[0]).unwrap_or(text) } else { text })
    }

    fn step(&mut self) -> Result<(), MessageError> {
        self.steps += 1;
        if self.steps > STEPS_MAX { Err(MessageError::TooLong) } else { Ok(()) }
    }

    fn walk(&mut self, ops: &[Op], values: &mut Values<'a>) -> Result<(), MessageError> {
        for op in ops {
            self.step()?;
            match op {
                Op::Skip { align, bytes } => self.skip(*align, *bytes)?,
                Op::SkipCounted { align, bytes } => {
                    let count = self.number()?;
                    self.skip(*align, multiply(*bytes, count)?)?;
                }
                Op::Repeat(count, body) => {
                    let count = match count {
                        Some(count) => *count,
                        None => self.number()?,
                    };
                    // The content of arrays is unwanted, so nothing of it is kept.
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
                    let text = self.text()?;
                    if values.raw.is_none() {
                        let start = text.windows(3).position(|window| window == b"$VN");
                        values.raw = start.and_then(|start| text.get(start..));
                    }
                }
                Op::Value(wanted) => self.value(wanted, values)?,
                Op::Elements(count, number, wanted) => {
                    let count = match count {
                        Some(count) => *count,
                        None => self.number()?,
                    };
                    self.elements(count, *number, wanted, values)?;
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
