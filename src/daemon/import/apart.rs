//! Apart: a recording is read in a separate process with its own limits, which may be killed at any time. Files of others may be
//! of any kind and size, and the recorder goes on whatever they do to their reader.

use super::ImportError;
use super::reading::{Facts, Source, Step, read};
use crate::control::ImportRequest;
use crate::process::{Child, Frame, FrameError, Received, write_frame};
use imu_core::sample::Record;
use imu_files::recording::{KeepOn, RecordingError};
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::time::Duration;

/// The interval at which the parent checks whether the import is still wanted.
const LOOK: Duration = Duration::from_millis(200);
/// The limit of private writable memory: more than any recording that is read piece by piece needs.
const MEMORY_BYTES: u64 = 192 << 20;
/// The limit of processor time: 256 GiB of text at 10 MB/s.
const PROCESSOR_S: u64 = 8 * 3600;
/// The maximum size of a step, which the daemon holds in memory: far more than its records or any recording's facts need.
const BODY_MAX: u64 = 16 << 20;

/// What the child is asked for.
#[derive(Debug, Serialize, Deserialize)]
struct Order {
    request: ImportRequest,
    /// The time of the first sample of a recording without times, UTC ns.
    started_utc_ns: i64,
}

/// The messages of the child. What may be long is the frame's body: facts as JSON, records as MessagePack, reasons as text.
#[derive(Debug, Serialize, Deserialize)]
enum Message {
    Identified(String),
    Found,
    Records,
    Ended(i64, [u64; 3]),
    /// The recording cannot be read.
    Refused,
    /// The file could not be read.
    Unread,
}

/// Reads the recording of a request in a separate process. `take` receives each step and returns whether the next one is wanted.
pub(super) fn read_apart(
    request: &ImportRequest,
    started_utc_ns: i64,
    keep_on: &KeepOn,
    take: &mut dyn FnMut(Step) -> Result<bool, ImportError>,
) -> Result<(), ImportError> {
    let process = |error: std::io::Error| ImportError::Process(error.to_string());
    let mut child =
        Child::<Message>::start(MEMORY_BYTES, PROCESSOR_S, &["import".as_ref()], BODY_MAX).map_err(process)?;
    let order = serde_json::to_vec(&Order { request: request.clone(), started_utc_ns });
    let order = order.map_err(|error| process(error.into()))?;
    if let Some(mut stdin) = child.stdin() {
        // A child that does not read it has ended, and its end has the reason.
        let _ = stdin.write_all(&order);
    }
    loop {
        if !keep_on.is_wanted() {
            // The child is killed as it is dropped.
            return Err(RecordingError::Unwanted { file: request.file.clone() }.into());
        }
        let step = match child.receive(LOOK).map_err(process)? {
            Received::Nothing => continue,
            Received::Ended(ended) if ended.out_of_memory => {
                let most = MEMORY_BYTES >> 20;
                let reason = format!("reading {} takes more than {most} MiB of memory", request.file.display());
                return Err(ImportError::Refused(reason));
            }
            // The next process would end in the same way.
            Received::Ended(ended) if ended.out_of_time => {
                let most = PROCESSOR_S / 3600;
                let reason = format!("reading {} takes more than {most} h of processor time", request.file.display());
                return Err(ImportError::Refused(reason));
            }
            Received::Ended(ended) => return Err(ImportError::Process(ended.reason)),
            Received::Frame(Frame { header, body }) => match header {
                Message::Identified(fingerprint) => Step::Identified(fingerprint),
                Message::Found => {
                    let facts: Facts = serde_json::from_slice(&body).map_err(|error| process(error.into()))?;
                    Step::Found(Box::new(facts))
                }
                Message::Records => {
                    let records: Result<Vec<Record>, _> = rmp_serde::from_slice(&body);
                    Step::Records(records.map_err(|error| ImportError::Process(error.to_string()))?)
                }
                Message::Ended(last_utc_ns, counts) => Step::Ended(last_utc_ns, counts),
                Message::Refused => return Err(ImportError::Refused(reason(&body))),
                Message::Unread => return Err(ImportError::Process(reason(&body))),
            },
        };
        let is_end = matches!(step, Step::Ended(..));
        if !take(step)? || is_end {
            return Ok(());
        }
    }
}

fn reason(body: &[u8]) -> String {
    String::from_utf8_lossy(body).into_owned()
}

/// Reads a recording in this process, which [`read_apart`] has started, as `order` requests it, and writes its steps to `out`.
///
/// # Errors
/// [`FrameError`], if the parent does not listen, or if the order cannot be read.
pub fn answer(mut order: impl Read, mut out: impl Write) -> Result<(), FrameError> {
    let mut text = Vec::new();
    order.read_to_end(&mut text)?;
    let Order { request, started_utc_ns } = serde_json::from_slice(&text)?;
    let mut broken = None;
    let mut send = |step: Step| {
        let (message, body) = match step {
            Step::Identified(fingerprint) => (Message::Identified(fingerprint), Vec::new()),
            Step::Found(facts) => {
                let body = serde_json::to_vec(&facts);
                (Message::Found, body.map_err(|error| ImportError::Process(error.to_string()))?)
            }
            Step::Records(records) => {
                let body = rmp_serde::to_vec(&records);
                (Message::Records, body.map_err(|error| ImportError::Process(error.to_string()))?)
            }
            Step::Ended(last_utc_ns, counts) => (Message::Ended(last_utc_ns, counts), Vec::new()),
        };
        // A parent that does not listen needs no more.
        broken = write_frame(&mut out, &message, &body).err();
        Ok(broken.is_none())
    };
    let read =
        Source::of_request(&request, KeepOn::default()).and_then(|source| read(source, started_utc_ns, &mut send));
    match (read, broken) {
        (_, Some(error)) => Err(error),
        (Ok(()), None) => Ok(()),
        (Err(error @ (ImportError::Read { .. } | ImportError::Process(_))), None) => {
            write_frame(&mut out, &Message::Unread, error.to_string().as_bytes())
        }
        (Err(error), None) => write_frame(&mut out, &Message::Refused, error.to_string().as_bytes()),
    }
}
