//! Terminal: the virtual sensor on a real pseudo-terminal. A shell: it moves bytes and waits.
//!
//! In real time the sensor sends whether the terminal is read or not, as a real one does: if the terminal is full and
//! not read, further data is lost on the line. The faults ([`super::faults`]) of terminal and link are applied here.
//! With accelerated time the terminal blocks the sensor instead, and the sensor holds the shared clock
//! ([`ScaledClock::hold_at`]), so that no sample is lost to the acceleration.

use super::faults::{Fault, FaultError, Schedule, ticks};
use super::line::{Fate, Frame, Line, Piece};
use super::options::TICK_NS;
use super::outbox::Outbox;
use super::sensor::VirtualSensor;
use super::source::{Source, Stream};
use super::uart;
use crate::clock::{Clock, ScaledClock};
use crate::pty::{self, Pair};
use imu_core::sample::Channel;
use imu_model::simulator::SimulatorError;
use rustix::event::{PollFd, PollFlags};
use rustix::io::Errno;
use std::fmt::Write as _;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};
use vn100_proto::register::ASYNC_RATE;

/// The longest sleep of the loop: the delay of an answer when nothing is sent.
const NAP: Duration = Duration::from_millis(20);
/// How far the held clock may run ahead of the loop while nothing is to be sent: less than any time-out of the host.
const IDLE_TICKS: u64 = 80;
/// The maximum output prepared ahead for the terminal.
const PENDING_BYTES: usize = 8192;
/// The maximum size of a delayed burst that waits for the terminal.
const BURST_BYTES: usize = 1 << 20;
/// The size of the kernel's buffer of a serial line before its own worker passes it to the reader
/// (`TTYB_DEFAULT_MEM_LIMIT`). A pseudo-terminal has only 8 KiB, so the rest waits here.
const DRIVER_BYTES: usize = 640 << 10;
/// A terminal with this many unread bytes is full: its line discipline holds 4095, and stops accepting shortly before.
const FULL_BYTES: u64 = 3900;
/// How long a terminal must be full and accept nothing before further data is lost.
const OVERRUN_AFTER: Duration = Duration::from_millis(20);
/// Seed of the faults' bits and noise.
const FAULT_SEED: u64 = 0x5eed;

/// The reasons why the emulator failed.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// The system provided no pseudo-terminal.
    #[error("the system gives no pseudo-terminal ({0}): is /dev/pts mounted?")]
    Terminal(#[source] std::io::Error),
    /// The link cannot be created.
    #[error(
        "the link {path} cannot be made ({source}): choose a path in a folder that may be written, whose file is absent or a link"
    )]
    Link {
        /// The link.
        path: String,
        /// The error message of the system.
        source: std::io::Error,
    },
    /// The log cannot be written.
    #[error("the log {path} cannot be written: {source}")]
    Log {
        /// The file.
        path: String,
        /// The error message of the system.
        source: std::io::Error,
    },
    /// The model cannot run at the sensor's configured rate.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    /// A requested fault is invalid.
    #[error(transparent)]
    Fault(#[from] FaultError),
}

/// Options of the terminal.
#[derive(Debug, Default)]
pub struct TerminalOptions {
    /// Create a link to the terminal at this path.
    pub link: Option<PathBuf>,
    /// End after this much time of the sensor.
    pub duration: Option<Duration>,
    /// Log every frame and its fate to this file.
    pub log: Option<PathBuf>,
    /// Garble both directions while the terminal is set to another baud rate than the sensor.
    pub strict_baud: bool,
    /// The faults, by the sensor's time.
    pub faults: Schedule,
    /// Faults that occur at once, as they are received.
    pub live_faults: Option<mpsc::Receiver<Result<Fault, FaultError>>>,
}

/// A pseudo-terminal with a sensor behind it.
pub struct Terminal {
    /// `None` while it is unplugged.
    ///
    /// Its slave is kept open: otherwise every reader that closes would end the line. It also shows the baud rate that
    /// the host set.
    pair: Option<Pair>,
    /// The terminal with which it returns, and the tick. It exists before the old one is closed, so that its name
    /// differs.
    back: Option<(u64, Pair)>,
    /// The side of a hung-up terminal, kept open to reserve its number: a link that dangles must not lead to another
    /// terminal.
    hung_up: Option<OwnedFd>,
    options: TerminalOptions,
    line: Line,
    outbox: Outbox,
    /// Pieces kept until the end of a hold.
    held: Vec<Piece>,
    /// Whether the delayed data is being sent.
    burst: bool,
    /// The time since which the terminal's data has not been read.
    full_since: Option<Instant>,
    log: Option<std::fs::File>,
    /// Lines of the log that are still to be written.
    lines: String,
}

impl Terminal {
    /// Opens a terminal, raw, and creates the link.
    ///
    /// # Errors
    /// [`EmulatorError`].
    pub fn open(options: TerminalOptions) -> Result<Self, EmulatorError> {
        let pair = pty::open().map_err(failed)?;
        let log = match &options.log {
            None => None,
            Some(path) => Some(
                std::fs::File::create(path)
                    .map_err(|source| EmulatorError::Log { path: path.display().to_string(), source })?,
            ),
        };
        let terminal = Self {
            pair: Some(pair),
            back: None,
            hung_up: None,
            options,
            line: Line::new(FAULT_SEED),
            outbox: Outbox::default(),
            held: Vec::new(),
            burst: false,
            full_since: None,
            log,
            lines: "# frame tick device_time_ns host_mono_ns bytes fate; ! tick host_mono_ns event\n".to_owned(),
        };
        terminal.link()?;
        Ok(terminal)
    }

    /// Returns the terminal's name, such as /dev/pts/7; empty while there is no terminal.
    pub fn path(&self) -> &Path {
        self.pair.as_ref().map_or(Path::new(""), |pair| &pair.path)
    }

    fn link(&self) -> Result<(), EmulatorError> {
        let (Some(link), Some(pair)) = (&self.options.link, &self.pair) else { return Ok(()) };
        pty::link(&pair.path, link).map_err(|source| EmulatorError::Link { path: link.display().to_string(), source })
    }

    /// Runs until `stop` is set or the duration is over.
    ///
    /// # Errors
    /// [`EmulatorError`] if terminal or log fail, or a fault is invalid.
    pub fn run(
        &mut self,
        mut sensor: VirtualSensor,
        mut source: Source,
        clock: &Arc<ScaledClock>,
        stop: &AtomicBool,
    ) -> Result<(), EmulatorError> {
        let held = clock.speed() != 1.0;
        let origin_ns = clock.schedule_mono_ns();
        let mut tick = 0_u64;
        let mut free_again = Instant::now();
        let mut emitted = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            self.receive(&mut sensor, &mut source, tick, clock)?;
            // The sensor's output: everything that is due, as far as the terminal accepts it.
            let due = (clock.schedule_mono_ns() - origin_ns) / TICK_NS;
            while let Some(fault) = self.next_live_fault()? {
                self.fault(fault, tick.max(due), &mut sensor, clock)?;
            }
            let mut caught_up = false;
            while !held || self.outbox.waiting().len() < PENDING_BYTES {
                let next = match &mut source {
                    Source::Model(_) => sensor.next_output_tick(),
                    Source::Replay(replay) => {
                        let line = replay.next_tick(tick, ascii_rate_hz(&sensor), clock.schedule_mono_ns());
                        line.filter(|next| sensor.may_send(*next)).into_iter().chain(sensor.next_output_tick()).min()
                    }
                };
                let next = next.filter(|next| *next <= due);
                if self.happen(next.unwrap_or(due), &mut sensor, clock)? {
                    // The fault may have changed the next output.
                    continue;
                }
                let Some(next) = next else {
                    caught_up = true;
                    break;
                };
                tick = next;
                emitted.clear();
                match &mut source {
                    Source::Model(noise) => {
                        let values = noise.at(tick, Stream::of(&sensor))?;
                        sensor.emit(tick, &values, &mut emitted);
                        let frames = sensor.frames();
                        let replies = frames.first().map_or(emitted.len(), |first| first.start);
                        self.reply(&sensor, tick, &emitted[..replies]);
                        for (index, frame) in frames.iter().enumerate() {
                            self.frame(&sensor, tick, &emitted[frame.clone()]);
                            let until = frames.get(index + 1).map_or(emitted.len(), |next| next.start);
                            self.reply(&sensor, tick, &emitted[frame.end..until]);
                        }
                    }
                    Source::Replay(replay) => {
                        // Waiting replies go first; the sensor itself sends no message.
                        sensor.emit(tick, &[0.0; Channel::COUNT], &mut emitted);
                        self.reply(&sensor, tick, &emitted);
                        let due = replay.next_tick(tick, ascii_rate_hz(&sensor), clock.schedule_mono_ns());
                        if due.is_some_and(|due| due <= tick) && sensor.may_send(tick) {
                            emitted.clear();
                            replay.emit(&mut emitted);
                            self.frame(&sensor, tick, &emitted);
                        }
                    }
                }
                if !held {
                    self.write()?;
                    if self.overruns() {
                        self.outbox.lose(Fate::Overrun);
                    }
                }
            }
            self.write()?;
            self.note(clock)?;
            if caught_up && self.outbox.is_empty() {
                tick = tick.max(due);
            }
            if held {
                // Time advances to the next output and no further, however long this thread had to wait for its turn.
                let next = match &mut source {
                    Source::Model(_) => sensor.next_output_tick(),
                    Source::Replay(_) => None,
                };
                let limit = if self.outbox.is_empty() { next.unwrap_or(tick + IDLE_TICKS) } else { tick };
                clock.hold_at(origin_ns + (limit + 1) * TICK_NS);
            }
            if self.options.duration.is_some_and(|end| u128::from(tick * TICK_NS) >= end.as_nanos())
                && self.outbox.is_empty()
            {
                break;
            }
            if let Some(pair) = &self.pair
                && free_again.elapsed() > Duration::from_secs(1)
            {
                free_again = Instant::now();
                // A host that was killed leaves its exclusive claim (TIOCEXCL) on the terminal, which a real port
                // releases.
                let _ = rustix::termios::ioctl_tiocnxcl(&pair.slave);
            }
            self.wait(clock, origin_ns, &sensor, &source, tick)?;
        }
        clock.release();
        self.note(clock)
    }

    /// Passes the host's bytes to the sensor.
    fn receive(
        &mut self,
        sensor: &mut VirtualSensor,
        source: &mut Source,
        tick: u64,
        clock: &ScaledClock,
    ) -> Result<(), EmulatorError> {
        let Some(pair) = &self.pair else { return Ok(()) };
        let mut buffer = [0_u8; 4096];
        let count = match rustix::io::read(&pair.master, &mut buffer) {
            Ok(count) => count,
            Err(Errno::AGAIN | Errno::INTR | Errno::IO) => return Ok(()),
            Err(error) => return Err(failed(error)),
        };
        if self.line.is_silent(tick) {
            return Ok(());
        }
        let mut received = buffer[..count].to_vec();
        if let Some(set) = self.wrong_baud(sensor) {
            received = uart::received(&received, set, sensor.baud());
        }
        let mut replies = Vec::new();
        sensor.on_bytes(tick, &received, &mut replies);
        self.reply(sensor, tick, &replies);
        if let Source::Replay(replay) = source {
            replay.on_command(clock.schedule_mono_ns());
        }
        Ok(())
    }

    /// Returns the next live fault, which occurs at once.
    fn next_live_fault(&mut self) -> Result<Option<Fault>, EmulatorError> {
        match self.options.live_faults.as_ref().map(mpsc::Receiver::try_recv) {
            Some(Ok(fault)) => Ok(Some(fault?)),
            // The source of faults has ended.
            Some(Err(_)) | None => Ok(None),
        }
    }

    /// Applies the first fault that is due at `limit` or before; returns `false` if there is none.
    fn happen(&mut self, limit: u64, sensor: &mut VirtualSensor, clock: &ScaledClock) -> Result<bool, EmulatorError> {
        if let Some((tick, pair)) = self.back.take_if(|(tick, _)| *tick <= limit) {
            self.event(clock, tick, &format!("back on {}", pair.path.display()));
            self.pair = Some(pair);
            self.hung_up = None;
            self.link()?;
            return Ok(true);
        }
        if !self.held.is_empty() && self.line.hold_until <= limit {
            self.event(clock, self.line.hold_until, "burst");
            self.held.drain(..).for_each(|piece| self.outbox.put(piece));
            self.burst = true;
            return Ok(true);
        }
        let at = self.options.faults.next_tick().unwrap_or(u64::MAX);
        match self.options.faults.due(limit) {
            Some(fault) => self.fault(fault, at, sensor, clock).map(|()| true),
            None => Ok(false),
        }
    }

    fn fault(
        &mut self,
        fault: Fault,
        tick: u64,
        sensor: &mut VirtualSensor,
        clock: &ScaledClock,
    ) -> Result<(), EmulatorError> {
        self.event(clock, tick, &fault.to_string());
        match fault {
            Fault::Unplug(time) => {
                self.gone(tick + ticks(time))?;
                self.remove_link();
            }
            Fault::Eof(time) => self.gone(tick + ticks(time))?,
            Fault::Reset => sensor.reset(tick),
            Fault::Silence(time) => self.line.silent_until = tick + ticks(time),
            Fault::Garbage(bytes) => self.line.garbage += bytes,
            Fault::Checksum(frames) => self.line.checksum += frames,
            Fault::Drop(frames) => self.line.drop += frames,
            Fault::Duplicate(frames) => self.line.duplicate += frames,
            Fault::Reorder(pairs) => self.line.reorder += pairs,
            Fault::Rate(rate_hz) => sensor.registers_mut().set_rate(rate_hz),
            Fault::Format(format) => sensor.registers_mut().set_format(format),
            Fault::Baud(baud) => {
                sensor.registers_mut().set_baud(baud);
                // On a line that accepts every baud rate this would have no effect.
                self.options.strict_baud = true;
            }
            Fault::Hold(time) => self.line.hold_until = tick + ticks(time),
            Fault::Unit(serial_number) => sensor.replace(tick, &serial_number),
            Fault::Clock(us) => sensor.set_clock(tick, us),
        }
        Ok(())
    }

    /// Removes the terminal; a new one appears at the tick `back`.
    fn gone(&mut self, back: u64) -> Result<(), EmulatorError> {
        let pair = match self.back.take() {
            Some((_, pair)) => pair,
            None => pty::open().map_err(failed)?,
        };
        self.back = Some((back, pair));
        self.held.drain(..).for_each(|piece| self.outbox.put(piece));
        self.outbox.lose(Fate::Unplugged);
        if let Some(pair) = self.pair.take() {
            self.hung_up = Some(pair.slave);
        }
        Ok(())
    }

    /// Sends bytes that are no frame.
    fn reply(&mut self, sensor: &VirtualSensor, tick: u64, bytes: &[u8]) {
        if bytes.is_empty() || self.pair.is_none() || self.line.is_silent(tick) {
            return;
        }
        self.deliver(sensor, tick, Piece { bytes: bytes.to_vec(), frame: None });
    }

    /// Sends a frame, with its faults applied.
    fn frame(&mut self, sensor: &VirtualSensor, tick: u64, bytes: &[u8]) {
        let mut pieces = Vec::new();
        self.line.frame(tick, sensor.device_time_ns(tick), bytes, self.pair.is_some(), &mut pieces);
        for piece in pieces {
            self.deliver(sensor, tick, piece);
        }
    }

    fn deliver(&mut self, sensor: &VirtualSensor, tick: u64, mut piece: Piece) {
        if let Some(set) = self.wrong_baud(sensor)
            && !piece.bytes.is_empty()
        {
            piece.bytes = uart::received(&piece.bytes, sensor.baud(), set);
            piece.frame = piece.frame.map(|(frame, _)| (frame, Fate::WrongBaud));
        }
        if tick < self.line.hold_until {
            self.held.push(piece);
        } else {
            self.outbox.put(piece);
        }
    }

    /// Returns the baud rate of the terminal, if it differs from the sensor's and that matters.
    fn wrong_baud(&self, sensor: &VirtualSensor) -> Option<u32> {
        let pair = self.pair.as_ref().filter(|_| self.options.strict_baud)?;
        let set = rustix::termios::tcgetattr(&pair.slave).ok()?.output_speed();
        (set != sensor.baud() && set > 0).then_some(set)
    }

    /// Sleeps until the host sends something, the terminal accepts more, or the next output is due.
    fn wait(
        &self,
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
        let Some(pair) = &self.pair else {
            std::thread::sleep(nap);
            return Ok(());
        };
        let mut wanted = PollFlags::IN;
        if !self.outbox.is_empty() {
            wanted |= PollFlags::OUT;
        }
        let timeout = rustix::event::Timespec { tv_sec: 0, tv_nsec: nap.as_nanos() as i64 };
        match rustix::event::poll(&mut [PollFd::new(&pair.master, wanted)], Some(&timeout)) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(failed(error)),
        }
    }

    /// Returns whether the waiting data is lost, as on a real line: the terminal's data is not read. If the terminal is
    /// not full, the kernel is late, and that loses nothing until its own buffer is full.
    fn overruns(&mut self) -> bool {
        let waiting = self.outbox.waiting().len();
        let (most, driver) = if self.burst { (BURST_BYTES, BURST_BYTES) } else { (PENDING_BYTES / 2, DRIVER_BYTES) };
        if waiting <= most {
            self.full_since = None;
            return false;
        }
        let Some(pair) = &self.pair else { return true };
        let is_full = rustix::io::ioctl_fionread(&pair.slave).is_ok_and(|bytes| bytes >= FULL_BYTES);
        let since = if is_full { *self.full_since.get_or_insert_with(Instant::now) } else { Instant::now() };
        if !is_full {
            self.full_since = None;
        }
        waiting > driver || since.elapsed() > OVERRUN_AFTER
    }

    /// Writes as much as the terminal accepts.
    fn write(&mut self) -> Result<(), EmulatorError> {
        let Some(pair) = &self.pair else { return Ok(()) };
        while !self.outbox.is_empty() {
            match rustix::io::write(&pair.master, self.outbox.waiting()) {
                Ok(count) => {
                    self.outbox.took(count);
                    // The terminal is being read.
                    self.full_since = None;
                }
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN | Errno::IO) => return Ok(()),
                Err(error) => return Err(failed(error)),
            }
        }
        self.burst = false;
        Ok(())
    }

    fn event(&mut self, clock: &ScaledClock, tick: u64, text: &str) {
        if self.log.is_some() {
            // Frames that are settled already precede it.
            self.describe_frames(clock);
            let _ = writeln!(self.lines, "! {tick} {} {text}", clock.schedule_mono_ns());
        }
    }

    fn describe_frames(&mut self, clock: &ScaledClock) {
        let now_ns = clock.schedule_mono_ns();
        for (frame, fate) in self.outbox.settled() {
            let Frame { number, tick, device_time_ns, bytes } = frame;
            let _ = writeln!(self.lines, "{number} {tick} {device_time_ns} {now_ns} {bytes} {}", fate.as_str());
        }
    }

    /// Logs the fate of frames since the last time, so that the log is complete if the emulator is killed.
    fn note(&mut self, clock: &ScaledClock) -> Result<(), EmulatorError> {
        if self.log.is_none() {
            self.outbox.settled();
            return Ok(());
        }
        self.describe_frames(clock);
        let Some(log) = self.log.as_mut().filter(|_| !self.lines.is_empty()) else { return Ok(()) };
        let written = std::io::Write::write_all(log, self.lines.as_bytes());
        self.lines.clear();
        written.map_err(|source| EmulatorError::Log {
            path: self.options.log.as_ref().map_or_else(String::new, |path| path.display().to_string()),
            source,
        })
    }

    fn remove_link(&self) {
        if let Some(link) = &self.options.link
            && link.is_symlink()
        {
            // A link that cannot be removed stays.
            let _ = std::fs::remove_file(link);
        }
    }
}

fn failed(error: Errno) -> EmulatorError {
    EmulatorError::Terminal(error.into())
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // A link that another emulator has replaced must not be removed.
        if let (Some(link), Some(pair)) = (&self.options.link, &self.pair)
            && pty::is_link_to(link, &pair.path)
        {
            self.remove_link();
        }
    }
}

/// Returns the rate of register 7 in Hz, at which recorded lines are sent.
fn ascii_rate_hz(sensor: &VirtualSensor) -> f64 {
    let text = sensor.registers().read(ASYNC_RATE, None).unwrap_or_default();
    text.parse().ok().filter(|rate: &f64| *rate > 0.0).unwrap_or(40.0)
}
