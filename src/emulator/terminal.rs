//! Terminal: the virtual sensor on a real pseudo-terminal. A shell: it moves bytes and waits.
//!
//! In real time the sensor sends whether somebody reads or not, as a real one does: what the terminal's buffer cannot
//! take is lost on the line. Accelerated, the terminal holds the sensor back instead, and the sensor holds the shared
//! clock ([`ScaledClock::hold_at`]), so that no sample is lost to the acceleration.

use super::Values;
use super::replay::Replay;
use super::sensor::{TICK_NS, VirtualSensor};
use crate::clock::{Clock, ScaledClock};
use crate::protocol::link::INTERNAL_RATE_HZ;
use crate::protocol::register::{ASYNC_RATE, ASYNC_TYPE, BinaryOutput};
use crate::sample::Channel;
use crate::simulator::{SensorModel, Simulator, SimulatorError};
use rustix::event::{PollFd, PollFlags};
use rustix::fs::OFlags;
use rustix::io::Errno;
use rustix::pty::OpenptFlags;
use rustix::termios::OptionalActions;
use std::io::Write;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long the loop sleeps at most: how soon a command is answered when nothing is sent.
const NAP: Duration = Duration::from_millis(20);
/// How far the held clock may run ahead of the loop while nothing is to be sent: less than any time-out of the host.
const IDLE_TICKS: u64 = 80;
/// Length of the records for which the simulated spectra hold at the low end, s.
const RECORD_LENGTH_S: f64 = 86_400.0;
/// Output that waits for the terminal: at most this much is prepared ahead.
const PENDING_BYTES: usize = 8192;

/// Why the emulator failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EmulatorError {
    /// The system gave no pseudo-terminal.
    #[error("the system gives no pseudo-terminal ({source}): is /dev/pts mounted?")]
    Terminal {
        /// Its words.
        source: std::io::Error,
    },
    /// The link cannot be made.
    #[error(
        "the link {path} cannot be made ({source}): choose a path in a folder that may be written, whose file is absent or a link"
    )]
    Link {
        /// The link.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
    /// The log cannot be written.
    #[error("the log {path} cannot be written: {source}")]
    Log {
        /// The file.
        path: String,
        /// The system's words.
        source: std::io::Error,
    },
    /// The model cannot run at the rate the sensor was told to send.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}

/// What the sensor sends.
pub enum Source {
    /// Simulated noise.
    Model(Box<Noise>),
    /// Recorded lines.
    Replay(Replay),
}

/// The noise of a model, at whatever rate the sensor is told to send.
pub struct Noise {
    model: SensorModel,
    seed: u64,
    running: Option<Running>,
}

/// A simulation under way, for one configuration of the output.
struct Running {
    stream: Stream,
    simulator: Simulator,
    /// The tick of its first values.
    origin: u64,
    /// How many instants were simulated, and the last of them.
    instants: u64,
    values: Values,
}

/// What the sensor is told to send.
#[derive(Debug, Clone, PartialEq)]
struct Stream {
    binary: Option<(u16, BinaryOutput)>,
    ascii: (String, String),
}

impl Stream {
    fn of(sensor: &VirtualSensor) -> Self {
        let read = |register| sensor.registers().read(register, None).unwrap_or_default();
        Self { binary: sensor.binary_output(), ascii: (read(ASYNC_TYPE), read(ASYNC_RATE)) }
    }

    /// The rate of its fastest output in Hz.
    fn rate_hz(&self) -> f64 {
        let binary = self.binary.as_ref().and_then(|(_, output)| output.rate_hz()).unwrap_or(0.0);
        let ascii = if self.ascii.0 == "0" { 0.0 } else { self.ascii.1.parse().unwrap_or(0.0) };
        let rate = f64::max(binary, ascii);
        if rate > 0.0 { rate } else { f64::from(INTERNAL_RATE_HZ) }
    }
}

impl Source {
    /// Noise of this model. The simulation begins with the first message after each change of what is sent, so that a
    /// stream's noise depends on the seed and not on when it was asked for.
    #[must_use]
    pub fn model(model: SensorModel, seed: u64) -> Self {
        Self::Model(Box::new(Noise { model, seed, running: None }))
    }
}

impl Noise {
    /// The values at `tick`; ticks do not run back within a stream.
    fn at(&mut self, tick: u64, stream: Stream) -> Result<Values, SimulatorError> {
        let running = match &mut self.running {
            Some(running) if running.stream == stream => running,
            other => {
                let simulator = Simulator::new(&self.model, self.seed, stream.rate_hz(), RECORD_LENGTH_S)?;
                other.insert(Running { stream, simulator, origin: tick, instants: 0, values: [0.0; Channel::COUNT] })
            }
        };
        let elapsed = (tick - running.origin) as f64 * running.simulator.rate_hz() / f64::from(INTERNAL_RATE_HZ);
        while running.instants <= (elapsed + 1e-6) as u64 {
            running.values = running.simulator.next_values();
            running.instants += 1;
        }
        Ok(running.values)
    }
}

/// How the terminal behaves.
#[derive(Debug, Clone, Default)]
pub struct TerminalOptions {
    /// Make this a link to the terminal.
    pub link: Option<PathBuf>,
    /// End after this much time of the sensor.
    pub duration: Option<Duration>,
    /// Write down every frame that was sent.
    pub log: Option<PathBuf>,
    /// Garble both directions while the terminal is set to another baud rate than the sensor.
    pub strict_baud: bool,
}

/// A pseudo-terminal with a sensor behind it.
pub struct Terminal {
    master: OwnedFd,
    /// Kept open: otherwise every reader that closes would end the line. Also tells the baud rate that the host set.
    slave: OwnedFd,
    path: PathBuf,
    options: TerminalOptions,
    log: Option<std::io::BufWriter<std::fs::File>>,
}

impl Terminal {
    /// Opens a terminal, raw, and makes the link.
    ///
    /// # Errors
    /// [`EmulatorError`].
    pub fn open(options: TerminalOptions) -> Result<Self, EmulatorError> {
        let (master, slave, path) = open_pair().map_err(|error| EmulatorError::Terminal { source: error.into() })?;
        if let Some(link) = &options.link {
            make_link(&path, link)
                .map_err(|source| EmulatorError::Link { path: link.display().to_string(), source })?;
        }
        let log = match &options.log {
            None => None,
            Some(path) => Some(std::io::BufWriter::new(
                std::fs::File::create(path)
                    .map_err(|source| EmulatorError::Log { path: path.display().to_string(), source })?,
            )),
        };
        Ok(Self { master, slave, path, options, log })
    }

    /// The terminal's name, such as /dev/pts/7.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Runs until `stop` is set or the duration is over.
    ///
    /// # Errors
    /// [`EmulatorError`] where terminal or log fail.
    pub fn run(
        &mut self,
        mut sensor: VirtualSensor,
        mut source: Source,
        clock: &Arc<ScaledClock>,
        stop: &AtomicBool,
    ) -> Result<(), EmulatorError> {
        let failed = |error: Errno| EmulatorError::Terminal { source: error.into() };
        let held = clock.speed() != 1.0;
        let origin_ns = clock.schedule_mono_ns();
        let mut pending: Vec<u8> = Vec::new();
        let mut sent = 0;
        let mut tick = 0_u64;
        let mut buffer = [0_u8; 4096];
        let mut free_again = Instant::now();
        while !stop.load(Ordering::Relaxed) {
            // What the host says.
            match rustix::io::read(&self.master, &mut buffer) {
                Ok(count) => {
                    let mut heard = buffer[..count].to_vec();
                    self.garble(&sensor, &mut heard);
                    let mut replies = Vec::new();
                    sensor.on_bytes(tick, &heard, &mut replies);
                    self.garble(&sensor, &mut replies);
                    pending.extend_from_slice(&replies);
                    if let Source::Replay(replay) = &mut source {
                        replay.heard(clock.schedule_mono_ns());
                    }
                }
                Err(Errno::AGAIN | Errno::INTR | Errno::IO) => {}
                Err(error) => return Err(failed(error)),
            }
            // What the sensor says: everything that is due, as far as the terminal takes it.
            let due = (clock.schedule_mono_ns() - origin_ns) / TICK_NS;
            let mut caught_up = false;
            while pending.len() - sent < PENDING_BYTES {
                let next = match &mut source {
                    Source::Model(_) => sensor.next_output_tick(),
                    Source::Replay(replay) => {
                        let line = replay.next_tick(tick, ascii_rate_hz(&sensor), clock.schedule_mono_ns());
                        line.filter(|next| sensor.may_send(*next)).into_iter().chain(sensor.next_output_tick()).min()
                    }
                };
                let Some(next) = next.filter(|next| *next <= due) else {
                    caught_up = true;
                    break;
                };
                tick = next;
                let start = pending.len();
                match &mut source {
                    Source::Model(noise) => {
                        let values = noise.at(tick, Stream::of(&sensor))?;
                        sensor.emit(tick, &values, &mut pending);
                    }
                    Source::Replay(replay) => {
                        // Replies that were waiting go first; the sensor itself sends no message.
                        sensor.emit(tick, &[0.0; Channel::COUNT], &mut pending);
                        let due = replay.next_tick(tick, ascii_rate_hz(&sensor), clock.schedule_mono_ns());
                        if due.is_some_and(|due| due <= tick) && sensor.may_send(tick) {
                            replay.emit(&mut pending);
                        }
                    }
                }
                self.note(tick, &pending[start..])?;
                let mut frame = pending.split_off(start);
                self.garble(&sensor, &mut frame);
                pending.append(&mut frame);
                if !held {
                    // On a real line the rest of a frame that does not fit is simply lost.
                    self.write(&mut pending, &mut sent).map_err(failed)?;
                    if pending.len() - sent > PENDING_BYTES / 2 {
                        pending.clear();
                        sent = 0;
                    }
                }
            }
            self.write(&mut pending, &mut sent).map_err(failed)?;
            if caught_up && pending.is_empty() {
                tick = tick.max(due);
            }
            if held {
                // Time goes on to what is sent next and no further, however long this thread had to wait for its turn.
                let next = match &mut source {
                    Source::Model(_) => sensor.next_output_tick(),
                    Source::Replay(_) => None,
                };
                let limit = if pending.is_empty() { next.unwrap_or(tick + IDLE_TICKS) } else { tick };
                clock.hold_at(origin_ns + (limit + 1) * TICK_NS);
            }
            if self.options.duration.is_some_and(|end| u128::from(tick * TICK_NS) >= end.as_nanos())
                && pending.is_empty()
            {
                break;
            }
            if free_again.elapsed() > Duration::from_secs(1) {
                free_again = Instant::now();
                // A host that was killed leaves its claim (TIOCEXCL) on the terminal, which a real port forgets.
                let _ = rustix::termios::ioctl_tiocnxcl(&self.slave);
            }
            self.wait(pending.len() > sent, clock, origin_ns, &sensor, &source, tick)?;
        }
        clock.release();
        if let Some(log) = &mut self.log {
            log.flush().map_err(|source| EmulatorError::Log { path: "log".to_owned(), source })?;
        }
        Ok(())
    }

    /// Sleeps until the host says something, the terminal takes more, or the next output is due.
    fn wait(
        &self,
        blocked: bool,
        clock: &ScaledClock,
        origin_ns: u64,
        sensor: &VirtualSensor,
        source: &Source,
        tick: u64,
    ) -> Result<(), EmulatorError> {
        let next = match source {
            Source::Model(_) => sensor.next_output_tick(),
            Source::Replay(_) => Some(tick + 1),
        };
        let next = next.unwrap_or(tick + IDLE_TICKS / 2);
        let due_ns = (origin_ns + next * TICK_NS).saturating_sub(clock.schedule_mono_ns());
        let nap = clock.real(Duration::from_nanos(due_ns)).clamp(Duration::from_micros(500), NAP);
        let mut wanted = PollFlags::IN;
        if blocked {
            wanted |= PollFlags::OUT;
        }
        let timeout = rustix::event::Timespec { tv_sec: 0, tv_nsec: nap.as_nanos() as i64 };
        match rustix::event::poll(&mut [PollFd::new(&self.master, wanted)], Some(&timeout)) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(EmulatorError::Terminal { source: error.into() }),
        }
    }

    fn write(&self, pending: &mut Vec<u8>, sent: &mut usize) -> Result<(), Errno> {
        while *sent < pending.len() {
            match rustix::io::write(&self.master, &pending[*sent..]) {
                Ok(count) => *sent += count,
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN | Errno::IO) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        pending.clear();
        *sent = 0;
        Ok(())
    }

    /// Turns bytes into what a line at the wrong baud rate makes of them.
    fn garble(&self, sensor: &VirtualSensor, bytes: &mut [u8]) {
        if !self.options.strict_baud || bytes.is_empty() {
            return;
        }
        let set = rustix::termios::tcgetattr(&self.slave).map(|termios| termios.output_speed());
        if set.is_ok_and(|set| set != sensor.baud()) {
            for (index, byte) in bytes.iter_mut().enumerate() {
                *byte = (*byte >> 3) ^ (index as u8).wrapping_mul(57) | 0x80;
            }
        }
    }

    fn note(&mut self, tick: u64, frame: &[u8]) -> Result<(), EmulatorError> {
        let Some(log) = &mut self.log else { return Ok(()) };
        if frame.is_empty() {
            return Ok(());
        }
        writeln!(log, "{tick} {} {}", tick * TICK_NS, frame.len())
            .map_err(|source| EmulatorError::Log { path: "log".to_owned(), source })
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(link) = &self.options.link
            && std::fs::read_link(link).is_ok_and(|target| target == self.path)
        {
            // Nothing to be done about a link that stays.
            let _ = std::fs::remove_file(link);
        }
    }
}

/// The rate of register 7 in Hz: what recorded lines are sent at.
fn ascii_rate_hz(sensor: &VirtualSensor) -> f64 {
    let text = sensor.registers().read(ASYNC_RATE, None).unwrap_or_default();
    text.parse().ok().filter(|rate: &f64| *rate > 0.0).unwrap_or(40.0)
}

fn open_pair() -> Result<(OwnedFd, OwnedFd, PathBuf), Errno> {
    let master = rustix::pty::openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    rustix::pty::grantpt(&master)?;
    rustix::pty::unlockpt(&master)?;
    let name = rustix::pty::ptsname(&master, Vec::new())?;
    let path = PathBuf::from(name.to_string_lossy().into_owned());
    let slave = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, rustix::fs::Mode::empty())?;
    // A fresh terminal echoes and edits lines; a serial sensor does neither.
    let mut termios = rustix::termios::tcgetattr(&slave)?;
    termios.make_raw();
    rustix::termios::tcsetattr(&slave, OptionalActions::Now, &termios)?;
    let flags = rustix::fs::fcntl_getfl(&master)?;
    rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;
    Ok((master, slave, path))
}

/// Replaces an absent file or an old link; never a real file.
fn make_link(target: &Path, link: &Path) -> std::io::Result<()> {
    if link.is_symlink() {
        std::fs::remove_file(link)?;
    }
    std::os::unix::fs::symlink(target, link)
}
