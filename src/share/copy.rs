//! Copy: the bytes of the port on a pseudo-terminal of our own, for one program that reads a serial port.
//!
//! The terminal belongs to the daemon, so it outlives the sensor's cable and its readers. Nothing here waits for a
//! reader: what the terminal does not take goes to the [`Backlog`]. While no program has the terminal open, nothing is
//! written to it, and what is left in it is discarded, so that a program begins with a fresh frame. What a program
//! writes is read and discarded.

use super::backlog::Backlog;
use super::figures::{ShareFigures, Way};
use crate::pty;
use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::fs::Mode;
use rustix::io::Errno;
use rustix::termios::QueueSelector;
use std::ffi::OsStr;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// How often a terminal that is full is tried again.
const RETRY: Duration = Duration::from_millis(5);
/// How often it is looked whether a program reads or writes, if the sensor sends nothing.
const LOOK: Duration = Duration::from_millis(50);
/// How often link and terminal are put in order.
const UPKEEP: Duration = Duration::from_secs(1);
/// The wait before a terminal is replaced that has failed.
const SOON: Duration = Duration::from_millis(100);
/// The wait after there was no terminal or no link.
const AGAIN: Duration = Duration::from_secs(5);
/// Bytes of a program that are discarded in one turn at most, so that a flood does not hold up the copy.
const IGNORED_AT_ONCE: usize = 64 << 10;

/// The reasons why there is no copy now.
#[derive(Debug, thiserror::Error)]
enum CopyError {
    #[error("the system gives no terminal for `share.link` ({0}); it is tried again")]
    Terminal(#[from] Errno),
    #[error(
        "the link {path} of `share.link` cannot be made ({source}): choose a folder that exists and may be written; it is tried again"
    )]
    Link { path: String, source: std::io::Error },
}

/// Copies the bytes until `stop`; a terminal that fails is replaced by another one.
pub(super) async fn run(
    link: PathBuf,
    mode: u32,
    mut bytes: mpsc::Receiver<Vec<u8>>,
    figures: ShareFigures,
    stop: CancellationToken,
) {
    while !stop.is_cancelled() {
        let (outcome, wait) = match Copy::open(&link, mode, &figures) {
            Ok(mut copy) => (copy.serve(&mut bytes, &stop).await, SOON),
            Err(error) => (Err(error), AGAIN),
        };
        let Err(error) = outcome else { return };
        figures.counts.reading.set(0);
        figures.state(Way::Link, Some(error.to_string()));
        let discard = async { while bytes.recv().await.is_some() {} };
        tokio::select! {
            () = stop.cancelled() => {}
            () = tokio::time::sleep(wait) => {}
            () = discard => return,
        }
    }
}

/// The folder in the targets of the share's links. Its spelling distinguishes a link of a killed daemon from one of another program,
/// although its terminal may belong to anybody by now.
const OWN_SPELLING: &str = "/dev/pts/./";

/// Returns whether a path may be taken for the link: nothing is there, or a link of the share, as a daemon leaves it
/// when it is killed.
pub(super) fn is_free(link: &Path) -> bool {
    match std::fs::read_link(link) {
        Ok(target) => target.as_os_str().as_bytes().starts_with(OWN_SPELLING.as_bytes()),
        // It cannot be read because it is no link, or because it is not there.
        Err(_) => std::fs::symlink_metadata(link).is_err(),
    }
}

struct Copy<'a> {
    master: OwnedFd,
    path: PathBuf,
    link: &'a Path,
    figures: &'a ShareFigures,
    backlog: Backlog,
    reading: bool,
    upkeep_due: Instant,
}

impl<'a> Copy<'a> {
    fn open(link: &'a Path, mode: u32, figures: &'a ShareFigures) -> Result<Self, CopyError> {
        let pair = pty::open()?;
        // The group of a new terminal is that of all terminals: the daemon's own group is of more use. The system may
        // refuse the change.
        let _ = rustix::fs::fchown(&pair.slave, None, Some(rustix::process::getegid()));
        rustix::fs::fchmod(&pair.slave, Mode::from_raw_mode(mode))?;
        let copy = Self {
            master: pair.master,
            path: pair.path,
            link,
            figures,
            backlog: Backlog::default(),
            reading: false,
            upkeep_due: Instant::now() + UPKEEP,
        };
        copy.link()?;
        figures.terminal(&copy.path);
        figures.state(Way::Link, None);
        tracing::info!(link = %link.display(), terminal = %copy.path.display(), "the port's bytes are shared");
        Ok(copy)
    }

    fn link(&self) -> Result<(), CopyError> {
        let failed = |source| CopyError::Link { path: self.link.display().to_string(), source };
        if !is_free(self.link) {
            return Err(failed(std::io::ErrorKind::AlreadyExists.into()));
        }
        let name = self.path.file_name().unwrap_or_default();
        pty::link(Path::new(&[OsStr::new(OWN_SPELLING), name].join(OsStr::new(""))), self.link).map_err(failed)
    }

    async fn serve(&mut self, bytes: &mut mpsc::Receiver<Vec<u8>>, stop: &CancellationToken) -> Result<(), CopyError> {
        loop {
            let wait = if self.backlog.front().is_empty() || !self.reading { LOOK } else { RETRY };
            let ends = tokio::select! {
                biased;
                () = stop.cancelled() => true,
                received = bytes.recv() => received.inspect(|received| self.push(received)).is_none(),
                () = tokio::time::sleep(wait) => false,
            };
            for _ in 0..bytes.len() {
                if let Ok(received) = bytes.try_recv() {
                    self.push(&received);
                }
            }
            self.turn()?;
            if ends {
                return Ok(());
            }
        }
    }

    fn push(&mut self, bytes: &[u8]) {
        self.figures.counts.dropped_bytes.add(self.backlog.push(bytes));
        if !self.reading {
            self.backlog.skip();
        }
    }

    /// Exchanges bytes with the terminal as far as it goes without waiting.
    fn turn(&mut self) -> Result<(), CopyError> {
        self.ignore_input()?;
        let reading = !self.is_closed()?;
        let ended = self.reading && !reading;
        self.reading = reading;
        self.figures.counts.reading.set(u64::from(reading));
        if reading {
            self.write()?;
        } else {
            self.backlog.skip();
        }
        let due = Instant::now() >= self.upkeep_due;
        if due {
            self.upkeep_due = Instant::now() + UPKEEP;
            self.keep_link()?;
        }
        if ended || (due && !reading) { self.tidy() } else { Ok(()) }
    }

    /// Returns whether no program has the terminal open: the slave's end is open nowhere.
    fn is_closed(&self) -> Result<bool, Errno> {
        let mut master = [PollFd::new(&self.master, PollFlags::empty())];
        let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
        match rustix::event::poll(&mut master, Some(&at_once)) {
            Ok(_) => Ok(master[0].revents().contains(PollFlags::HUP)),
            Err(Errno::INTR) => Ok(!self.reading),
            Err(error) => Err(error),
        }
    }

    fn write(&mut self) -> Result<(), Errno> {
        while !self.backlog.front().is_empty() {
            match rustix::io::write(&self.master, self.backlog.front()) {
                Ok(0) | Err(Errno::AGAIN | Errno::INTR) => return Ok(()),
                Ok(count) => {
                    self.backlog.took(count);
                    self.figures.counts.bytes.add(count as u64);
                }
                // The program has closed it in this moment.
                Err(Errno::IO) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn ignore_input(&self) -> Result<(), Errno> {
        let mut buffer = [0_u8; 4096];
        let mut ignored = 0;
        while ignored < IGNORED_AT_ONCE {
            match rustix::io::read(&self.master, &mut buffer) {
                Ok(0) | Err(Errno::AGAIN | Errno::INTR | Errno::IO) => break,
                Ok(count) => ignored += count,
                Err(error) => return Err(error),
            }
        }
        self.figures.counts.ignored_bytes.add(ignored as u64);
        Ok(())
    }

    /// Puts the terminal in order for the next program: without the last one's bytes, settings and claim.
    ///
    /// Only the superuser may open a terminal that a program has claimed (`TIOCEXCL`) and not released. For others this
    /// is an error, after which there is a new terminal.
    fn tidy(&mut self) -> Result<(), CopyError> {
        let slave = pty::open_slave(&self.path)?;
        rustix::termios::ioctl_tiocnxcl(&slave)?;
        pty::make_raw(&slave)?;
        rustix::termios::tcflush(&slave, QueueSelector::IOFlush)?;
        Ok(())
    }

    /// Makes a link again that was removed, and reports one that leads elsewhere.
    fn keep_link(&self) -> Result<(), CopyError> {
        if pty::is_link_to(self.link, &self.path) {
            self.figures.state(Way::Link, None);
        } else if std::fs::symlink_metadata(self.link).is_err() {
            self.link()?;
        } else {
            let error = format!(
                "{} of `share.link` leads elsewhere: another program uses this path; choose another one for each daemon",
                self.link.display()
            );
            self.figures.state(Way::Link, Some(error));
        }
        Ok(())
    }
}

impl Drop for Copy<'_> {
    fn drop(&mut self) {
        // A link that another program has replaced stays.
        if pty::is_link_to(self.link, &self.path) {
            let _ = std::fs::remove_file(self.link);
        }
    }
}
