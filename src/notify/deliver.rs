//! Delivery: one attempt to pass a message to a program or to send it by HTTP, with a time limit in every case.

use super::notice::Message;
use std::io::{ErrorKind, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use ureq::tls::{RootCerts, TlsConfig};

/// The interval at which a running program is checked.
const LOOK: Duration = Duration::from_millis(20);
/// Variables with which systemd communicates with the daemon; they are not passed to the programs it starts.
const OF_SYSTEMD: [&str; 5] = ["NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC", "LISTEN_PID", "LISTEN_FDS"];

/// The receiver of messages.
#[derive(Debug, Clone)]
pub enum Receiver {
    /// A program and its arguments.
    Command(Vec<String>),
    /// An address that accepts JSON, and the part of it that may be shown: the rest often is a secret.
    Url {
        /// The whole address.
        url: String,
        /// Scheme and host.
        shown: String,
    },
}

/// The reasons why an attempt failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeliverError {
    /// The program cannot be started.
    #[error("{program} cannot be started: {reason}")]
    Start {
        /// The program.
        program: String,
        /// The error message of the system.
        reason: String,
    },
    /// The program reported a failure.
    #[error("{program} ended with {status}")]
    Ended {
        /// The program.
        program: String,
        /// Its exit code or signal.
        status: String,
    },
    /// The program took too long, and was killed with all processes that it had started.
    #[error("{program} took longer than {limit:?} and was killed")]
    Killed {
        /// The program.
        program: String,
        /// The time limit.
        limit: Duration,
    },
    /// The receiver returned another status than success.
    #[error("{shown} answered {status}")]
    Answered {
        /// Scheme and host.
        shown: String,
        /// The status code.
        status: u16,
    },
    /// There was no answer.
    #[error("{shown} did not answer: {reason}")]
    NoAnswer {
        /// Scheme and host.
        shown: String,
        /// The error.
        reason: String,
    },
    /// The daemon ends.
    #[error("the daemon ended before it was told")]
    Stopped,
}

impl DeliverError {
    /// Returns whether the same message may be accepted later. A status that reports an error in the request (4xx
    /// except 408 Request Timeout and 429 Too Many Requests) or another location (3xx) is permanent.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Answered { status, .. } => !(300..500).contains(status) || matches!(status, 408 | 429),
            Self::Stopped => false,
            _ => true,
        }
    }
}

impl Receiver {
    /// Returns the receiver in the form for logs.
    pub fn shown(&self) -> &str {
        match self {
            Self::Command(command) => command.first().map_or("", String::as_str),
            Self::Url { shown, .. } => shown,
        }
    }

    /// Makes one attempt that takes no longer than `limit`. `keep_on` is called while a program runs.
    ///
    /// # Errors
    /// [`DeliverError`].
    pub fn attempt(&self, message: &Message, limit: Duration, keep_on: impl Fn() -> bool) -> Result<(), DeliverError> {
        match self {
            Self::Command(command) => run(command, message, limit, keep_on),
            Self::Url { url, shown } => post(url, shown, message, limit),
        }
    }
}

fn run(command: &[String], message: &Message, limit: Duration, keep_on: impl Fn() -> bool) -> Result<(), DeliverError> {
    let Some((program, arguments)) = command.split_first() else { return Ok(()) };
    let named = || program.clone();
    let until = Instant::now() + limit;
    let mut starting = Command::new(program);
    starting.args(arguments).envs(message.environment.iter().map(|(name, value)| (name, value)));
    for name in OF_SYSTEMD {
        starting.env_remove(name);
    }
    // The program's error output goes to the daemon's own log. It gets its own process group, so that processes it
    // starts end with it.
    starting.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::inherit()).process_group(0);
    let mut child =
        starting.spawn().map_err(|error| DeliverError::Start { program: named(), reason: error.to_string() })?;
    let mut body = Handing::begin(child.stdin.take(), message.body.as_bytes());
    loop {
        body.go_on();
        match child.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => return Err(DeliverError::Ended { program: named(), status: describe(status) }),
            Ok(None) => {}
            Err(error) => {
                kill(&mut child);
                return Err(DeliverError::Start { program: named(), reason: error.to_string() });
            }
        }
        if Instant::now() >= until {
            kill(&mut child);
            return Err(DeliverError::Killed { program: named(), limit });
        }
        if !keep_on() {
            kill(&mut child);
            return Err(DeliverError::Stopped);
        }
        std::thread::sleep(LOOK);
    }
}

/// Writes the body to a program's standard input, which may never be read: a pipe holds 64 KiB, and a body may be
/// longer.
struct Handing<'a> {
    /// Closed once all is written or there is no reader.
    stdin: Option<ChildStdin>,
    left: &'a [u8],
}

impl<'a> Handing<'a> {
    fn begin(stdin: Option<ChildStdin>, body: &'a [u8]) -> Self {
        // A program whose pipe cannot be written without blocking has the environment.
        let stdin = stdin.filter(|stdin| rustix::io::ioctl_fionbio(stdin, true).is_ok());
        Self { stdin, left: body }
    }

    /// Writes as much as the pipe accepts now.
    fn go_on(&mut self) {
        let Some(stdin) = &mut self.stdin else { return };
        while !self.left.is_empty() {
            match stdin.write(self.left) {
                Ok(written) if written > 0 => self.left = &self.left[written..],
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                // The program does not read: it has the environment.
                _ => break,
            }
        }
        self.stdin = None;
    }
}

fn describe(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => status.to_string(),
    }
}

/// Kills the child's whole process group and collects its status, so that no process remains.
fn kill(child: &mut Child) {
    let group = rustix::process::Pid::from_child(child);
    // The child may have ended by itself a moment ago.
    let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    let _ = child.wait();
}

fn post(url: &str, shown: &str, message: &Message, limit: Duration) -> Result<(), DeliverError> {
    let no_answer = |reason: String| DeliverError::NoAnswer { shown: shown.to_owned(), reason };
    let tls = TlsConfig::builder().root_certs(RootCerts::PlatformVerifier).build();
    let agent: ureq::Agent = ureq::Agent::config_builder()
        .timeout_global(Some(limit))
        .http_status_as_error(false)
        // A message must not be posted to another address without the user's consent.
        .max_redirects(0)
        .max_redirects_will_error(false)
        .user_agent(concat!("vn100d/", env!("CARGO_PKG_VERSION")))
        .tls_config(tls)
        .build()
        .into();
    let answer = agent
        .post(url)
        .header("content-type", "application/json")
        .header("x-vn100d-event", message.event)
        .send(message.body.as_str())
        .map_err(|error| no_answer(error.to_string().replace(url, shown)))?;
    let status = answer.status().as_u16();
    if answer.status().is_success() { Ok(()) } else { Err(DeliverError::Answered { shown: shown.to_owned(), status }) }
}
