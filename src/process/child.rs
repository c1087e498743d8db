//! Child: another process of this program, which does one task and answers in frames.

use super::frame::{Frame, read_frame};
use rustix::process::Signal;
use serde::de::DeserializeOwned;
use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// The maximum number of bytes read from a child's standard error; the rest is discarded.
const STDERR_BYTES: u64 = 64 * 1024;
/// The maximum number of characters kept of a line.
const LINE_CHARS: usize = 300;

/// The outcome of listening to a child.
#[derive(Debug)]
pub enum Received<H> {
    /// The child sent this frame.
    Frame(Frame<H>),
    /// Nothing has arrived yet.
    Nothing,
    /// The child has ended, and no more frames follow.
    Ended(Ended),
}

/// The way in which a child ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ended {
    /// Whether it ended by itself without an error.
    pub well: bool,
    /// Whether it ended because it reached its memory limit.
    pub out_of_memory: bool,
    /// Whether it ended because it reached its limit of processor time.
    pub out_of_time: bool,
    /// The reason why it ended, for the user: its signal or exit code, and its last messages.
    pub reason: String,
}

/// A child process that does one task. It is killed and waited for when this is dropped.
#[derive(Debug)]
pub struct Child<H> {
    process: std::process::Child,
    frames: Receiver<Result<Frame<H>, super::FrameError>>,
    last_words: Option<JoinHandle<Option<String>>>,
}

impl<H: DeserializeOwned + Send + 'static> Child<H> {
    /// Starts this program again as a worker that may write to `memory_bytes` of private memory and use `processor_s`
    /// seconds of processor time; `work` are the arguments that select its task. Its frames have bodies of at most
    /// `body_max` bytes.
    ///
    /// # Errors
    /// The error that the system reports, if no process can be started.
    pub fn start(memory_bytes: u64, processor_s: u64, work: &[&OsStr], body_max: u64) -> std::io::Result<Self> {
        // Not the path of the program: an upgrade may have replaced the file there. The child gets its own process
        // group: a terminal's signals to the daemon's group are for the daemon, which ends its children itself.
        let mut process = Command::new("/proc/self/exe")
            .arg0("vn100d")
            .process_group(0)
            .args(["worker", "--parent", &std::process::id().to_string()])
            .args(["--memory", &memory_bytes.to_string(), "--processor-s", &processor_s.to_string()])
            .args(work)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let pipes = process.stdout.take().zip(process.stderr.take());
        let (sender, frames) = sync_channel(1);
        let id = process.id();
        // From here on it is killed and waited for, whatever fails.
        let mut child = Self { process, frames, last_words: None };
        let (mut stdout, stderr) = pipes.ok_or_else(|| std::io::Error::other("a child without its pipes"))?;
        std::thread::Builder::new().name("child-frames".to_owned()).spawn(move || {
            // There is no listener any more, or no further data can arrive: either way it is over.
            while let Some(frame) = read_frame(&mut stdout, body_max).transpose() {
                let broken = frame.is_err();
                if sender.send(frame).is_err() || broken {
                    return;
                }
            }
        })?;
        let words = move || last_words(stderr, id);
        child.last_words = Some(std::thread::Builder::new().name("child-words".to_owned()).spawn(words)?);
        Ok(child)
    }

    /// Returns the standard input, once.
    pub fn stdin(&mut self) -> Option<ChildStdin> {
        self.process.stdin.take()
    }

    /// Returns the next frame, waited for at most this long.
    ///
    /// # Errors
    /// The error that the system reports, if the child cannot be waited for.
    pub fn receive(&mut self, time: Duration) -> std::io::Result<Received<H>> {
        match self.frames.recv_timeout(time) {
            Ok(Ok(frame)) => Ok(Received::Frame(frame)),
            Err(RecvTimeoutError::Timeout) => Ok(Received::Nothing),
            Ok(Err(error)) => {
                self.process.kill()?;
                let mut ended = self.end()?;
                // A pipe that breaks in the middle of a frame belongs to a child that was killed; its exit status is
                // more informative.
                if ended.well {
                    ended = Ended { well: false, reason: error.to_string(), ..ended };
                }
                Ok(Received::Ended(ended))
            }
            Err(RecvTimeoutError::Disconnected) => self.end().map(Received::Ended),
        }
    }

    fn end(&mut self) -> std::io::Result<Ended> {
        let status = self.process.wait()?;
        let words = self.last_words.take().and_then(|thread| thread.join().ok()).flatten();
        // The message of the standard library before it aborts; a panic aborts too.
        let out_of_memory = words.as_ref().is_some_and(|words| words.starts_with("memory allocation of"));
        let out_of_time = status.signal() == Some(Signal::XCPU.as_raw());
        Ok(Ended { well: status.success(), out_of_memory, out_of_time, reason: reason(status, words) })
    }
}

impl<H> Drop for Child<H> {
    fn drop(&mut self) {
        // A process that has ended already cannot be killed; it is waited for nevertheless.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn reason(status: ExitStatus, words: Option<String>) -> String {
    let end = match (status.signal(), status.code()) {
        (Some(signal), _) => format!("its process ended by signal {signal}"),
        (None, code) => format!("its process ended with code {}", code.unwrap_or_default()),
    };
    words.map_or_else(|| end.clone(), |words| format!("{end}: {words}"))
}

/// Writes the child's error output to the log, and returns its first two lines.
fn last_words(stderr: impl Read, process: u32) -> Option<String> {
    let mut first: Vec<String> = Vec::new();
    let mut lines = BufReader::new(stderr.take(STDERR_BYTES));
    let mut line = Vec::new();
    while lines.read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        let text: String = String::from_utf8_lossy(&line).trim().chars().take(LINE_CHARS).collect();
        line.clear();
        if !text.is_empty() {
            tracing::warn!(process, "A child process says: {text}");
            // A panic takes two lines; the backtrace that may follow is not a reason.
            if first.len() < 2 && !text.starts_with("note:") && !text.starts_with("stack backtrace") {
                first.push(text);
            }
        }
    }
    // A child that continues to write errors must not block.
    let _ = std::io::copy(&mut lines.into_inner().into_inner(), &mut std::io::sink());
    (!first.is_empty()).then(|| first.join(" "))
}
