//! Apart: a job in a separate process with its own limits, which may be killed at any time.
//!
//! The child reads the database and reports its progress over a pipe; the parent, which alone writes, stores it. A
//! child that ends without a result has failed at that attempt: its job is tried again from its last checkpoint, or
//! failed with the reason. A daemon that ends terminates its child, and the job continues at the next start, which does
//! not count as an attempt.

use super::JobError;
use super::pass::Keeper;
use super::runner::{InStore, Outcome, work};
use super::source::CHUNK;
use crate::process::{Child, Frame, FrameError, Received, write_frame};
use crate::store::{JobCheckpoint, JobRow, Reader, Store, StoreError};
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// The interval at which the parent checks whether the job is still wanted.
const LOOK: Duration = Duration::from_millis(200);
/// A result or a checkpoint larger than this is a fault of the program.
const BODY_MAX: u64 = 256 << 20;
/// The limit of private writable memory of a job: more than a diagnosis of five hours of nine channels needs.
pub const JOB_MEMORY_BYTES: u64 = 640 << 20;
/// The limit of processor time of one process of a job, while other jobs wait: a thousand times that of a diagnosis of
/// five hours of nine channels. A job that has made a checkpoint by then continues from it in another process.
pub const JOB_PROCESSOR_S: u64 = 6 * 3600;

/// The messages of a child about its job; a checkpoint's state and a result's text are the frame's body.
#[derive(Debug, Serialize, Deserialize)]
enum Message {
    Checkpoint {
        next_seq: u64,
        progress: f64,
    },
    Progress(f64),
    Done,
    /// The job cannot be done. `sqlite` is the database's extended code, if the database returned the error.
    Failed {
        reason: String,
        sqlite: Option<i32>,
    },
    /// The job could not be begun: the database could not be opened.
    Unopened(String),
}

/// Works on a claimed job in a separate process until the job is done or cancelled, or `keep_on` returns `false`.
pub(super) fn run(
    store: &Store,
    reader: &Reader,
    job: &JobRow,
    keep_on: impl FnMut() -> bool + Send,
) -> Result<Outcome, JobError> {
    let (id, file) = (job.id.to_string(), store.file());
    let words = ["job", "--id", &id, "--file", &file, "--database"].map(OsStr::new);
    let work = [words.as_slice(), &[store.path().as_os_str()]].concat();
    let mut child =
        Child::<Message>::start(JOB_MEMORY_BYTES, JOB_PROCESSOR_S, &work, BODY_MAX).map_err(JobError::Process)?;
    let mut keeper = InStore::new(store, job.id, keep_on);
    let (mut looked, mut gets_on) = (Instant::now(), false);
    loop {
        let kept = match child.receive(LOOK).map_err(JobError::Process)? {
            Received::Frame(Frame { header: Message::Checkpoint { next_seq, progress }, body }) => {
                gets_on = true;
                keeper.checkpoint(JobCheckpoint { next_seq, state: body }, progress)
            }
            Received::Frame(Frame { header: Message::Progress(progress), .. }) => keeper.progress(progress),
            Received::Frame(Frame { header: Message::Done, body }) => {
                let text = String::from_utf8(body).map_err(|error| JobError::Died(error.to_string()));
                return keeper.end(text);
            }
            Received::Frame(Frame { header: Message::Failed { reason, sqlite }, .. }) => {
                return Err(match sqlite {
                    Some(code) => StoreError::of_code(code, reason).into(),
                    None => JobError::Refused(reason),
                });
            }
            Received::Frame(Frame { header: Message::Unopened(reason), .. }) => {
                return Err(JobError::Process(std::io::Error::other(reason)));
            }
            // The next process would end in the same way.
            Received::Ended(ended) if ended.out_of_time && !gets_on => return Err(JobError::OutOfTime),
            Received::Ended(ended) => return Err(JobError::Died(ended.reason)),
            Received::Nothing => Ok(()),
        };
        let kept = kept.and_then(|()| {
            if looked.elapsed() < LOOK {
                return Ok(());
            }
            looked = Instant::now();
            keeper.look(reader)
        });
        if kept.is_err() {
            // The child is killed as it is dropped.
            drop(child);
            return keeper.end(kept.map(|()| String::new()));
        }
    }
}

/// Keeps a job's progress by sending it to the parent.
struct InPipe<W>(W);

impl<W: Write> InPipe<W> {
    fn send(&mut self, message: &Message, body: &[u8]) -> Result<(), JobError> {
        // A parent that does not listen has ended; the job continues at its next start.
        write_frame(&mut self.0, message, body).map_err(|_| JobError::Stopped)
    }
}

impl<W: Write + Send> Keeper for InPipe<W> {
    fn checkpoint(&mut self, checkpoint: JobCheckpoint, progress: f64) -> Result<(), JobError> {
        self.send(&Message::Checkpoint { next_seq: checkpoint.next_seq, progress }, &checkpoint.state)
    }
    fn progress(&mut self, progress: f64) -> Result<(), JobError> {
        self.send(&Message::Progress(progress), &[])
    }
}

/// Works on a job in this process, which [`run`] has started, and writes its progress to `out`. `file` is the file that
/// the parent writes under the path ([`Store::file`]): a file that replaced it is not read.
///
/// # Errors
/// [`FrameError`], if the parent does not listen.
pub fn answer(database: &Path, file: &str, id: i64, out: impl Write + Send) -> Result<(), FrameError> {
    let mut keeper = InPipe(out);
    let opened = Reader::open_written(database, file).and_then(|reader| reader.job(id).map(|job| (reader, job)));
    let (reader, job) = match opened {
        Ok(opened) => opened,
        Err(error) => return write_frame(&mut keeper.0, &Message::Unopened(error.to_string()), &[]),
    };
    match work(&reader, &job, CHUNK, &mut keeper) {
        Ok(body) => write_frame(&mut keeper.0, &Message::Done, body.as_bytes()),
        Err(error) => {
            let sqlite = if let JobError::Store(error) = &error { error.sqlite_code() } else { None };
            write_frame(&mut keeper.0, &Message::Failed { reason: error.to_string(), sqlite }, &[])
        }
    }
}
