//! The records of a ROS 1 bag, format 2.0, one after another.
//!
//! A bag is its magic line and records: a header of `name=value` fields and data, each behind its length. Messages lie
//! in chunks, which may be compressed, behind the connection they belong to. The index at the end is not needed: a bag
//! that was cut (`.bag.active`) is read up to the cut.
//!
//! Guarantees: any bytes are read without panic. Memory is bounded by the limits below and by the bytes present, never
//! by a length that a record claims. Unreadable data becomes a separate entry ([`Entry::Damaged`]), behind which
//! reading continues at the next chunk. Format: <http://wiki.ros.org/Bags/Format/2.0>.

use super::super::error::{RecordingError, read_error, refused};
use super::super::input::Input;
use super::super::meter::{Expanded, Meter};
use super::layout::{Encoding, time_ns};
use super::{Connection, Entry, Messages};
use bzip2::read::BzDecoder;
use lz4_flex::frame::FrameDecoder;
use std::io::{BufRead, Read, Take};
use std::path::PathBuf;
use std::rc::Rc;

/// The first line.
pub(in crate::recording) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Longest header of a record: its fields are a topic and some numbers.
const HEADER_BYTES: u32 = 64 * 1024;
/// Longest message or definition that is kept; longer ones are skipped. An IMU's message has some 600 bytes.
const DATA_BYTES: u32 = 1024 * 1024;
/// Maximum size of a decompressed chunk in bytes. Recorders write chunks of 768 kB; one large image makes it longer.
const CHUNK_BYTES: u32 = 256 * 1024 * 1024;

const OP_MESSAGE: u8 = 0x02;
const OP_CHUNK: u8 = 0x05;
const OP_CONNECTION: u8 = 0x07;

/// The place from which records are read.
enum Place {
    File(Counting),
    Chunk(Chunk),
    End,
}

/// A chunk's content, decompressed.
enum Chunk {
    Plain(Take<Counting>),
    Bz2(Box<Take<BzDecoder<Take<Counting>>>>),
    Lz4(Box<Take<FrameDecoder<Take<Counting>>>>),
}

/// The file, and how much of it was read.
struct Counting {
    bytes: Box<dyn BufRead>,
    at: u64,
}

impl Read for Counting {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.bytes.read(buffer)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Chunk {
    fn reader(&mut self) -> &mut dyn Read {
        match self {
            Self::Plain(bytes) => bytes,
            Self::Bz2(bytes) => bytes.as_mut(),
            Self::Lz4(bytes) => bytes.as_mut(),
        }
    }

    /// Returns the file behind the chunk.
    fn leave(self) -> std::io::Result<Counting> {
        let mut rest = match self {
            Self::Plain(bytes) => bytes,
            Self::Bz2(bytes) => bytes.into_inner().into_inner(),
            Self::Lz4(bytes) => bytes.into_inner().into_inner(),
        };
        std::io::copy(&mut rest, &mut std::io::sink())?;
        Ok(rest.into_inner())
    }
}

/// Reads a bag's records.
pub(super) struct BagReader {
    path: PathBuf,
    meter: Rc<Meter>,
    place: Place,
    header: Vec<u8>,
    data: Vec<u8>,
}

/// Why the current record cannot be read.
enum Fault {
    /// The reader is at its end, before a record: this is no error.
    End,
    /// The description of the damage.
    Damaged(String),
}

impl From<std::io::Error> for Fault {
    fn from(error: std::io::Error) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// The content of a record's header.
struct Head {
    op: u8,
    connection: Option<u32>,
    received_ns: Option<i64>,
    topic: String,
    compression: String,
    size: Option<u32>,
}

impl BagReader {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let (bytes, meter) = input.open_metered()?;
        let mut file = Counting { bytes, at: 0 };
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic).map_err(|source| read_error(input.path(), 0, source))?;
        let path = input.path().to_owned();
        Ok(Self { path, meter, place: Place::File(file), header: Vec::new(), data: Vec::new() })
    }

    fn at(&self) -> u64 {
        match &self.place {
            Place::File(file) => file.at,
            Place::Chunk(Chunk::Plain(bytes)) => bytes.get_ref().at,
            Place::Chunk(Chunk::Bz2(bytes)) => bytes.get_ref().get_ref().get_ref().at,
            Place::Chunk(Chunk::Lz4(bytes)) => bytes.get_ref().get_ref().get_ref().at,
            Place::End => 0,
        }
    }

    fn enter(&mut self, compression: &str, size: u32, data_bytes: u32) -> Result<(), String> {
        let Place::File(file) = std::mem::replace(&mut self.place, Place::End) else {
            return Err("a chunk inside a chunk".to_owned());
        };
        let data = file.take(u64::from(data_bytes));
        let (chunk, refused) = match compression {
            "none" => (Chunk::Plain(data), None),
            "bz2" => (Chunk::Bz2(Box::new(BzDecoder::new(data).take(u64::from(size)))), None),
            "lz4" => (Chunk::Lz4(Box::new(FrameDecoder::new(data).take(u64::from(size)))), None),
            other => (Chunk::Plain(data), Some(format!("a chunk with the unknown compression {other:?}"))),
        };
        let refused = refused.or_else(|| {
            (size > CHUNK_BYTES).then(|| format!("a chunk of {size} bytes: at most {CHUNK_BYTES} are read"))
        });
        self.place = Place::Chunk(chunk);
        match refused {
            Some(what) => {
                self.leave()?;
                Err(what)
            }
            None => Ok(()),
        }
    }

    /// Leaves unreadable data: returns from a chunk to the file, or ends the file for good.
    fn leave(&mut self) -> Result<(), String> {
        if let Place::Chunk(chunk) = std::mem::replace(&mut self.place, Place::End) {
            self.place = Place::File(chunk.leave().map_err(|error| error.to_string())?);
        }
        Ok(())
    }
}

impl Messages for BagReader {
    fn check(&self) -> Result<(), RecordingError> {
        self.meter.refused().map_or(Ok(()), |refusal| Err(refused(&self.path, refusal)))
    }

    fn next_entry(&mut self, wanted: &dyn Fn(u32) -> bool) -> Option<Entry<'_>> {
        loop {
            let at = self.at();
            let step = match &mut self.place {
                Place::End => return None,
                Place::File(file) => read_record(file, &mut self.header, &mut self.data, wanted, true),
                Place::Chunk(Chunk::Plain(bytes)) => {
                    read_record(bytes, &mut self.header, &mut self.data, wanted, false)
                }
                Place::Chunk(chunk) => {
                    let mut bytes = Expanded { bytes: chunk.reader(), meter: Rc::clone(&self.meter) };
                    read_record(&mut bytes, &mut self.header, &mut self.data, wanted, false)
                }
            };
            match step {
                Ok(Step::Passed) => {}
                Ok(Step::Chunk { compression, size, data_bytes }) => {
                    if let Err(what) = self.enter(&compression, size, data_bytes) {
                        return Some(Entry::Damaged { at, what });
                    }
                }
                Ok(Step::Connection(connection)) => return Some(Entry::Connection(connection)),
                Ok(Step::Message { connection, received_ns }) => {
                    return Some(Entry::Message { connection, received_ns, data: &self.data });
                }
                Ok(Step::TooLong(what)) => return Some(Entry::Damaged { at, what }),
                Err(fault) => {
                    let left = self.leave();
                    match (fault, left) {
                        (Fault::End, Ok(())) => {}
                        (Fault::Damaged(what), _) | (Fault::End, Err(what)) => {
                            return Some(Entry::Damaged { at, what });
                        }
                    }
                }
            }
        }
    }
}

/// The outcome of one record.
enum Step {
    Passed,
    Chunk { compression: String, size: u32, data_bytes: u32 },
    Connection(Connection),
    Message { connection: u32, received_ns: i64 },
    TooLong(String),
}

/// Reads one record; only the header of a chunk.
fn read_record(
    bytes: &mut (impl Read + ?Sized),
    header: &mut Vec<u8>,
    data: &mut Vec<u8>,
    wanted: &dyn Fn(u32) -> bool,
    in_file: bool,
) -> Result<Step, Fault> {
    let Some(header_bytes) = read_length(bytes)? else { return Err(Fault::End) };
    if header_bytes > HEADER_BYTES {
        return Err(Fault::Damaged(format!("a record's header of {header_bytes} bytes: at most {HEADER_BYTES}")));
    }
    read_into(bytes, header, header_bytes)?;
    let head = Head::read(header)?;
    let Some(data_bytes) = read_length(bytes)? else {
        return Err(Fault::Damaged("the bag ends within a record".to_owned()));
    };
    let keeps = match head.op {
        OP_CHUNK if in_file => {
            let size = head.size.ok_or_else(|| Fault::Damaged("a chunk without its size".to_owned()))?;
            return Ok(Step::Chunk { compression: head.compression, size, data_bytes });
        }
        OP_CONNECTION => true,
        OP_MESSAGE => head.connection.is_some_and(wanted),
        _ => false,
    };
    if !keeps || data_bytes > DATA_BYTES {
        pass_over(bytes, data_bytes)?;
        return Ok(if keeps { Step::TooLong(format!("a record of {data_bytes} bytes")) } else { Step::Passed });
    }
    read_into(bytes, data, data_bytes)?;
    let number = head.connection.ok_or_else(|| Fault::Damaged("a record without its connection".to_owned()))?;
    if head.op == OP_CONNECTION {
        return Ok(Step::Connection(connection(number, head.topic, data)));
    }
    let received_ns = head.received_ns.ok_or_else(|| Fault::Damaged("a message without its time".to_owned()))?;
    Ok(Step::Message { connection: number, received_ns })
}

/// Reads a length; `None` if nothing is left.
fn read_length(bytes: &mut (impl Read + ?Sized)) -> Result<Option<u32>, Fault> {
    let mut length = [0; 4];
    let mut read = 0;
    while read < length.len() {
        match bytes.read(&mut length[read..]) {
            Ok(0) if read == 0 => return Ok(None),
            Ok(0) => return Err(Fault::Damaged("the bag ends within a length".to_owned())),
            Ok(more) => read += more,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(Some(u32::from_le_bytes(length)))
}

/// Reads `length` bytes; memory grows only with the bytes present.
fn read_into(bytes: &mut (impl Read + ?Sized), buffer: &mut Vec<u8>, length: u32) -> Result<(), Fault> {
    buffer.clear();
    let read = bytes.take(u64::from(length)).read_to_end(buffer)?;
    check_length(read as u64, length)
}

fn pass_over(bytes: &mut (impl Read + ?Sized), length: u32) -> Result<(), Fault> {
    let read = std::io::copy(&mut bytes.take(u64::from(length)), &mut std::io::sink())?;
    check_length(read, length)
}

fn check_length(read: u64, length: u32) -> Result<(), Fault> {
    if read < u64::from(length) {
        return Err(Fault::Damaged(format!("a record of {length} bytes of which {read} are there")));
    }
    Ok(())
}

/// Returns the fields of a header: each a length, a name, `=` and a value.
fn fields(mut header: &[u8]) -> impl Iterator<Item = Option<(&[u8], &[u8])>> {
    std::iter::from_fn(move || {
        if header.is_empty() {
            return None;
        }
        let field = header.split_at_checked(4).and_then(|(length, rest)| {
            let length = u32::from_le_bytes(length.try_into().ok()?);
            rest.split_at_checked(usize::try_from(length).ok()?)
        });
        let Some((field, rest)) = field else {
            header = &[];
            return Some(None);
        };
        header = rest;
        let equals = field.iter().position(|byte| *byte == b'=');
        Some(equals.map(|equals| (&field[..equals], &field[equals + 1..])))
    })
}

fn text(value: &[u8]) -> String {
    String::from_utf8_lossy(value).into_owned()
}

fn number(value: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(value.try_into().ok()?))
}

impl Head {
    fn read(header: &[u8]) -> Result<Self, Fault> {
        let mut head = Self {
            op: 0,
            connection: None,
            received_ns: None,
            topic: String::new(),
            compression: String::new(),
            size: None,
        };
        for field in fields(header) {
            let Some((name, value)) = field else {
                return Err(Fault::Damaged("a record's header is not made of fields".to_owned()));
            };
            match name {
                b"op" => head.op = value.first().copied().unwrap_or(0),
                b"conn" => head.connection = number(value),
                b"topic" => head.topic = text(value),
                b"compression" => head.compression = text(value),
                b"size" => head.size = number(value),
                b"time" => {
                    head.received_ns = value
                        .split_at_checked(4)
                        .and_then(|(seconds, nanos)| Some(time_ns(number(seconds)?, number(nanos)?)));
                }
                _ => {}
            }
        }
        // Zeros would be endless records: every record must state its kind.
        if head.op == 0 {
            return Err(Fault::Damaged("a record without its kind".to_owned()));
        }
        Ok(head)
    }
}

fn connection(number: u32, topic: String, data: &[u8]) -> Connection {
    let (message_type, definition) = (String::new(), String::new());
    let mut connection = Connection { number, topic, message_type, definition, encoding: Ok(Encoding::Ros1) };
    for (name, value) in fields(data).flatten() {
        match name {
            b"type" => connection.message_type = text(value),
            b"message_definition" => connection.definition = text(value),
            _ => {}
        }
    }
    connection
}
