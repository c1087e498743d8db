//! The messages of an MCAP file, one after another.
//!
//! The crate `mcap` finds the file's records. The content of a record or chunk is parsed here, so that a damaged chunk
//! costs only itself and no claimed length takes memory (the crate's own parsing of texts reserves the claimed length).
//! The index at the end is not needed: a file that was cut is read up to the cut. Messages of ROS 1 and ROS 2 with
//! definitions in their schemas (`ros1msg`, `ros2msg`) are read.
//!
//! Guarantees: as [`super::bag`]. Format: <https://mcap.dev/spec>.

use super::super::error::{RecordingError, refused};
use super::super::input::Input;
use super::super::meter::{Expanded, Meter};
use super::layout::Encoding;
use super::{Connection, Entry, Messages};
use ::mcap::records::op;
use ::mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use lz4_flex::frame::FrameDecoder;
use std::collections::HashMap;
use std::io::{BufRead, Read};
use std::path::PathBuf;
use std::rc::Rc;

/// The beginning of such a file.
pub(in crate::recording) const MAGIC: &[u8] = ::mcap::MAGIC;
/// Maximum size of a chunk in bytes, compressed and decompressed. Recorders write chunks of about 1 MB.
const CHUNK_BYTES: usize = 256 * 1024 * 1024;
/// How far back a compressed chunk may refer: 32 MiB, which its decompression then holds in memory.
const WINDOW_LOG_MAX: u32 = 25;
/// Longest message that is kept; longer ones are skipped.
const MESSAGE_BYTES: usize = 1024 * 1024;
/// Bytes read at a time.
const READ_BYTES: usize = 64 * 1024;
/// Opcode and length of a record.
const RECORD_HEAD_BYTES: usize = 9;
/// Channel, sequence, time of logging and of publishing of a message.
const MESSAGE_HEAD_BYTES: usize = 22;
/// The maximum number of message types that are kept.
const SCHEMAS_MAX: usize = 1024;

/// A message type.
struct Schema {
    name: String,
    encoding: String,
    text: String,
}

impl Schema {
    /// Parses a message type with its number.
    fn parse(data: &[u8]) -> Option<(u16, Self)> {
        let mut fields = Fields(data);
        Some((fields.u16()?, Self { name: fields.text()?, encoding: fields.text()?, text: fields.text()? }))
    }
}

/// Reads an MCAP file's messages.
pub(super) struct McapReader {
    path: PathBuf,
    meter: Rc<Meter>,
    bytes: Box<dyn BufRead>,
    file: LinearReader,
    /// The read position in the file.
    at: u64,
    ended: bool,
    /// Decompressed records to be parsed.
    records: Vec<u8>,
    next: usize,
    schemas: HashMap<u16, Schema>,
}

impl McapReader {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let (bytes, meter) = input.open_metered()?;
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_skip_end_magic(true)
            .with_record_length_limit(CHUNK_BYTES);
        Ok(Self {
            path: input.path().to_owned(),
            meter,
            bytes,
            file: LinearReader::new_with_options(options),
            at: 0,
            ended: false,
            records: Vec::new(),
            next: 0,
            schemas: HashMap::new(),
        })
    }

    /// Reads the file's next record into `records`: a chunk decompressed, any other record as it is. An error describes
    /// the damage; the file may continue behind it.
    fn fill(&mut self) -> Result<(), String> {
        self.records.clear();
        self.next = 0;
        let read = loop {
            match self.file.next_event() {
                None => {
                    self.ended = true;
                    return Ok(());
                }
                Some(Err(error)) => {
                    self.ended = true;
                    return Err(error.to_string());
                }
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    // The requested length is the file's claim: memory grows with the bytes present.
                    let wanted = wanted.clamp(1, READ_BYTES);
                    let read = self.bytes.read(self.file.insert(wanted)).map_err(|error| {
                        self.ended = true;
                        error.to_string()
                    })?;
                    self.at += read as u64;
                    self.file.notify_read(read);
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => break (opcode, data),
            }
        };
        match read {
            (op::CHUNK, data) => {
                let chunk = Chunk::parse(data).ok_or("a chunk that ends within its head")?;
                decompress(&chunk, &self.meter, &mut self.records)?;
                if chunk.crc32 != 0 && crc32fast::hash(&self.records) != chunk.crc32 {
                    self.records.clear();
                    return Err("a chunk whose checksum is wrong".to_owned());
                }
                Ok(())
            }
            (opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE), data) => {
                self.records.push(opcode);
                self.records.extend((data.len() as u64).to_le_bytes());
                self.records.extend(data);
                Ok(())
            }
            (op::FOOTER, _) => {
                self.ended = true;
                Ok(())
            }
            // Zeros would be endless records.
            (0, _) => {
                self.ended = true;
                Err("a record without its kind".to_owned())
            }
            _ => Ok(()),
        }
    }

    fn connection(&self, data: &[u8]) -> Option<Connection> {
        let mut fields = Fields(data);
        let (id, schema_id) = (fields.u16()?, fields.u16()?);
        let (topic, encoding) = (fields.text()?, fields.text()?);
        let schema = self.schemas.get(&schema_id);
        let text = schema.filter(|schema| ["ros1msg", "ros2msg"].contains(&schema.encoding.as_str()));
        Some(Connection {
            number: u32::from(id),
            topic,
            message_type: schema.map_or_else(String::new, |schema| schema.name.clone()),
            definition: text.map_or_else(String::new, |schema| schema.text.clone()),
            encoding: Encoding::from_name(&encoding),
        })
    }
}

/// The rest of a record's fields, little endian; a text or block has its length (4 or 8 bytes) before it.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, length: u64) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(usize::try_from(length).ok()?)?;
        self.0 = rest;
        Some(bytes)
    }
    fn u16(&mut self) -> Option<u16> {
        self.bytes(2)?.try_into().ok().map(u16::from_le_bytes)
    }
    fn u32(&mut self) -> Option<u32> {
        self.bytes(4)?.try_into().ok().map(u32::from_le_bytes)
    }
    fn u64(&mut self) -> Option<u64> {
        self.bytes(8)?.try_into().ok().map(u64::from_le_bytes)
    }
    fn text(&mut self) -> Option<String> {
        let length = self.u32()?;
        Some(String::from_utf8_lossy(self.bytes(length.into())?).into_owned())
    }
}

/// A chunk of records as it lies in the file.
struct Chunk<'a> {
    /// Bytes of its records.
    size: u64,
    /// The checksum of its records; 0: unknown.
    crc32: u32,
    compression: String,
    compressed: &'a [u8],
}

impl<'a> Chunk<'a> {
    fn parse(data: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(data);
        let (_first_ns, _last_ns) = (fields.u64()?, fields.u64()?);
        let (size, crc32, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
        let length = fields.u64()?;
        Some(Self { size, crc32, compression, compressed: fields.bytes(length)? })
    }
}

/// Appends the decompressed content of a chunk.
fn decompress(chunk: &Chunk<'_>, meter: &Rc<Meter>, out: &mut Vec<u8>) -> Result<(), String> {
    if chunk.size > CHUNK_BYTES as u64 {
        return Err(format!("a chunk of {} bytes: at most {CHUNK_BYTES} are read", chunk.size));
    }
    let plain: Box<dyn Read + '_> = match chunk.compression.as_str() {
        "" => {
            out.extend(chunk.compressed);
            return Ok(());
        }
        "zstd" => {
            let mut decoder =
                zstd::stream::read::Decoder::with_buffer(chunk.compressed).map_err(|error| error.to_string())?;
            decoder.window_log_max(WINDOW_LOG_MAX).map_err(|error| error.to_string())?;
            Box::new(decoder)
        }
        "lz4" => Box::new(FrameDecoder::new(chunk.compressed)),
        other => {
            return Err(format!(
                "a chunk with the unknown compression {:?}",
                other.chars().take(80).collect::<String>()
            ));
        }
    };
    let mut bytes = Expanded { bytes: plain, meter: Rc::clone(meter) }.take(chunk.size);
    let read = bytes.read_to_end(out);
    if let Err(error) = read {
        out.clear();
        return Err(format!("a chunk that cannot be decompressed: {error}"));
    }
    Ok(())
}

/// The outcome of a record; a message is given by its place.
enum Found {
    Passed,
    Connection(Connection),
    Message { connection: u32, received_ns: i64, from: usize, to: usize },
    Damaged(String),
}

impl McapReader {
    /// Parses the next record of `records`.
    fn take_apart(&mut self, wanted: &dyn Fn(u32) -> bool) -> Found {
        let begin = self.next;
        let head = self.records.get(begin..begin + RECORD_HEAD_BYTES);
        let Some((&opcode, length)) = head.and_then(|head| head.split_first()) else {
            self.next = self.records.len();
            return Found::Damaged("a chunk that ends within a record".to_owned());
        };
        let length = length.try_into().map_or(u64::MAX, u64::from_le_bytes);
        let from = begin + RECORD_HEAD_BYTES;
        let to = usize::try_from(length).ok().and_then(|length| from.checked_add(length));
        let Some((to, data)) = to.and_then(|to| Some((to, self.records.get(from..to)?))) else {
            self.next = self.records.len();
            return Found::Damaged(format!("a record of {length} bytes in a chunk that has fewer"));
        };
        self.next = to;
        match opcode {
            op::MESSAGE => {
                let (Some(channel), Some(logged)) = (data.first_chunk(), data.get(6..14)) else {
                    return Found::Damaged("a message that ends within its head".to_owned());
                };
                let connection = u32::from(u16::from_le_bytes(*channel));
                let received_ns = logged.try_into().map_or(0, u64::from_le_bytes);
                if !wanted(connection) {
                    return Found::Passed;
                }
                if data.len() < MESSAGE_HEAD_BYTES || data.len() > MESSAGE_BYTES {
                    return Found::Damaged(format!("a message of {} bytes", data.len()));
                }
                let received_ns = i64::try_from(received_ns).unwrap_or(i64::MAX);
                Found::Message { connection, received_ns, from: from + MESSAGE_HEAD_BYTES, to }
            }
            op::SCHEMA => match Schema::parse(data) {
                Some((id, schema)) => {
                    if self.schemas.len() < SCHEMAS_MAX && schema.text.len() <= MESSAGE_BYTES {
                        self.schemas.insert(id, schema);
                    }
                    Found::Passed
                }
                None => Found::Damaged("a schema that ends within a field".to_owned()),
            },
            op::CHANNEL => self
                .connection(data)
                .map_or_else(|| Found::Damaged("a channel that ends within a field".to_owned()), Found::Connection),
            _ => Found::Passed,
        }
    }
}

impl Messages for McapReader {
    fn check(&self) -> Result<(), RecordingError> {
        self.meter.refused().map_or(Ok(()), |refusal| Err(refused(&self.path, refusal)))
    }

    fn next_entry(&mut self, wanted: &dyn Fn(u32) -> bool) -> Option<Entry<'_>> {
        loop {
            if self.next >= self.records.len() {
                if self.ended {
                    return None;
                }
                let at = self.at;
                if let Err(what) = self.fill() {
                    return Some(Entry::Damaged { at, what });
                }
                continue;
            }
            match self.take_apart(wanted) {
                Found::Passed => {}
                Found::Connection(connection) => return Some(Entry::Connection(connection)),
                Found::Damaged(what) => return Some(Entry::Damaged { at: self.at, what }),
                Found::Message { connection, received_ns, from, to } => {
                    let data = self.records.get(from..to).unwrap_or_default();
                    return Some(Entry::Message { connection, received_ns, data });
                }
            }
        }
    }
}
