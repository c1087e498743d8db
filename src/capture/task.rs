//! Task: connects session, decoder and recorder to the real port. A thin shell: they make every decision.

use super::action::{Action, Input, RecorderAction};
use super::host_watch::{HostEvent, HostWatch, Reading, stepped_while_away};
use super::port;
use super::recorder::{Counts, Plan, Recorder, ResumePoint};
use super::recorder_state::{RecorderState, Sink, timebase};
use super::session::{Session, SessionOptions};
use crate::clock::Clock;
use crate::observe::{SensorState, SensorStatus};
use imu_core::sample::device_clock::DeviceClock;
use imu_core::sample::{ConnectedSensor, DiscardCause, EventKind, GapCause};
use rand::SeedableRng;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_serial::{SerialPort as _, SerialStream};
use vn100_proto::{Decoder, DecoderOptions, Event, Measurement};

/// The interval at which time-outs, discards and progress are examined, in real time.
const TICK: Duration = Duration::from_millis(200);
/// Data that arrives within this time after the host stood still or slept may show a loss, ns.
const HOST_BLAME_NS: u64 = 3_000_000_000;
/// The interval at which the estimate of the sensor's clock is recorded, ns.
const CLOCK_EVERY_NS: u64 = 60_000_000_000;
/// The host's own lateness in reading, in real time; it counts if time runs faster.
const HOST_JITTER: Duration = Duration::from_millis(250);
/// At high rates the line's buffer is looked at this often, and all that it holds is read at once: a wake-up for each
/// frame would cost more than it is worth. The buffer holds 44 ms of data at 921,600 baud, and an adapter drops data
/// when it is full.
const GATHER: Duration = Duration::from_millis(5);
/// Rates above which reads are gathered, Hz; their frames carry the sensor's time.
const GATHER_ABOVE_HZ: f64 = 250.0;
/// The maximum size of one read: 0.7 s at 921,600 baud.
const READ_BYTES: usize = 65_536;
/// A read of this many bytes shows that the line's buffer was full: it holds 4,095 bytes, however much a read may take.
const FULL_BYTES: usize = 4_095;
/// The data that waited behind a full buffer is read within this time, ns.
const LATE_READ_NS: u64 = 250_000_000;
/// The time limit for a command to leave the port.
const WRITE: Duration = Duration::from_secs(1);

/// Options of the task.
#[derive(Debug, Clone)]
pub struct TaskOptions {
    /// Path or pattern of the port; the usual places are searched if absent.
    pub device: Option<String>,
    /// The options of the session.
    pub session: SessionOptions,
    /// Seed of the waits' jitter.
    pub seed: u64,
}

/// The commands to the task.
#[derive(Debug)]
pub enum TaskCommand {
    /// Record from now (or from the plan's start) on.
    Begin(Plan, Option<Box<ResumePoint>>),
    /// Stop the capture; answered when its last record is in the queue.
    Stop(oneshot::Sender<bool>),
    /// Restore the sensor's output, close the port and return; an unfinished capture continues when the daemon runs
    /// again.
    Shutdown,
}

/// The reported state of the task.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Progress {
    /// The state of the sensor.
    pub sensor: SensorStatus,
    /// Its registers, after they were read.
    pub description: Option<Box<ConnectedSensor>>,
    /// The present capture: plan and counts, and whether it still waits for its start.
    pub capture: Option<(Plan, Counts, bool)>,
}

/// Maximum number of measurements that wait until their unit is recognised.
const HELD_MAX: usize = 16_384;

struct Shell {
    clock: Arc<dyn Clock>,
    session: Session,
    decoder: Decoder,
    state: RecorderState,
    waiting: Option<(Plan, Option<ResumePoint>)>,
    /// The host's own lateness in receiving, on the clock.
    host_jitter_ns: f64,
    actions: Vec<Action>,
    host: HostWatch,
    device_clock: DeviceClock,
    /// The time at which the estimate of the sensor's clock is recorded next, ns.
    clock_due_ns: u64,
    /// Measurements with their arrival (monotonic and UTC ns), of a unit that has not stated its serial number yet.
    unrecognised: Vec<(u64, i64, Measurement)>,
    /// Whether the session knows which sensor the capture is of.
    expecting: bool,
    ended: bool,
}

/// Captures until a shutdown command arrives.
///
/// `sink` is bounded. At speed 1 a full queue costs samples, which become a gap with cause `storage_backpressure`; the
/// reader never waits. At other speeds the reader waits, so that the terminal pauses the emulator. `progressed` counts
/// the turns of the loop, for the watchdog.
pub async fn run(
    options: TaskOptions,
    clock: Arc<dyn Clock>,
    sink: Box<dyn Sink>,
    mut commands: mpsc::Receiver<TaskCommand>,
    progress: watch::Sender<Progress>,
    progressed: Arc<AtomicU64>,
) {
    let patient = clock.speed() != 1.0;
    let host_jitter_ns = if patient { HOST_JITTER.as_nanos() as f64 * clock.speed() } else { 0.0 };
    let random = rand_chacha::ChaCha8Rng::seed_from_u64(options.seed);
    let mut shell = Shell {
        session: Session::new(SessionOptions { host_jitter_ns: host_jitter_ns as u64, ..options.session }, random),
        host_jitter_ns,
        decoder: Decoder::new(DecoderOptions::default()),
        state: RecorderState::new(sink),
        waiting: None,
        actions: Vec::new(),
        host: HostWatch::default(),
        device_clock: DeviceClock::default(),
        clock_due_ns: 0,
        unrecognised: Vec::new(),
        expecting: false,
        ended: false,
        clock,
    };
    let mut stream: Option<(SerialStream, PathBuf)> = None;
    let mut buffer = vec![0_u8; READ_BYTES];
    let mut next_tick = Instant::now();
    while !shell.ended {
        shell.perform(&options.device, &mut stream).await;
        let now = Instant::now();
        shell.runs(patient);
        let session_wait = shell.session.deadline_ns().saturating_sub(shell.clock.mono_ns());
        let wake = (now + shell.clock.real(Duration::from_nanos(session_wait)).min(TICK)).min(next_tick);
        let is_fast = shell.state.accepted.is_some_and(|(_, rate_hz)| rate_hz > GATHER_ABOVE_HZ);
        let gathers = (!patient && is_fast).then_some(&*shell.state.sink);
        // Arrived data is read before a silence is inferred.
        let happened = tokio::select! {
            biased;
            command = commands.recv() => Happened::Command(command.unwrap_or(TaskCommand::Shutdown)),
            read = read(&mut stream, &mut buffer, gathers) => Happened::Read(read),
            () = tokio::time::sleep_until(wake.into()) => Happened::Nothing,
        };
        shell.runs(patient);
        let mut read_some = matches!(happened, Happened::Read(_));
        match happened {
            Happened::Command(command) => {
                shell.command(command);
                shell.publish(&progress);
            }
            Happened::Read(read) => {
                if patient {
                    shell.state.room().await;
                }
                let before = shell.session.status().state;
                match read {
                    Ok(0) => shell.input(Input::Disconnected("the line hung up".to_owned())),
                    Ok(count) => shell.received(&buffer[..count]),
                    Err(error) => shell.input(Input::Disconnected(error.to_string())),
                }
                if shell.session.status().state != before {
                    shell.publish(&progress);
                }
            }
            Happened::Nothing => {
                shell.state.sink.woke(wake.elapsed());
                // The runtime may not have noticed new data yet, so the port is queried. The time is taken before the
                // query, so that data which arrives in between cannot be mistaken for silence.
                let now_ns = shell.clock.mono_ns();
                // A read from an empty buffer may take long: see [`read`].
                let is_due = shell.session.deadline_ns() <= now_ns;
                let unread = stream.as_mut().filter(|(port, _)| is_due || !is_fast || !is_empty(port));
                let unread = unread.map(|(port, _)| port.try_read(&mut buffer));
                match unread {
                    Some(Ok(count)) if count > 0 => {
                        if patient {
                            shell.state.room().await;
                        }
                        shell.received(&buffer[..count]);
                        read_some = true;
                    }
                    _ => shell.session.handle(now_ns, Input::Tick, &mut shell.actions),
                }
            }
        }
        if now >= next_tick {
            shell.runs(patient);
            // With bytes always available the time-outs of commands would never be examined.
            if read_some {
                shell.input(Input::Tick);
            }
            next_tick = now + TICK;
            shell.tick();
            progressed.fetch_add(1, Ordering::Relaxed);
            shell.publish(&progress);
        }
    }
    shell.state.close().await;
    shell.publish(&progress);
}

/// The event that ended a wait.
enum Happened {
    Command(TaskCommand),
    Read(std::io::Result<usize>),
    Nothing,
}

/// Reads what arrives; if `gathers`, whatever the line's buffer holds at intervals.
///
/// A read from an empty buffer waits until the kernel's own thread has handed on what the driver holds. That thread has
/// no priority: on a busy machine it is kept from its turn while the buffer is full and the reader waits for it. A look at
/// the number of bytes waits only while that thread copies some.
async fn read(
    stream: &mut Option<(SerialStream, PathBuf)>,
    buffer: &mut [u8],
    gathers: Option<&dyn Sink>,
) -> std::io::Result<usize> {
    let Some((port, _)) = stream else { return std::future::pending().await };
    let Some(sink) = gathers else { return port.read(buffer).await };
    loop {
        let due = Instant::now() + GATHER;
        tokio::time::sleep_until(due.into()).await;
        sink.woke(due.elapsed());
        if is_empty(port) {
            continue;
        }
        match port.try_read(buffer) {
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
            read => return read,
        }
    }
}

/// Returns whether the line's buffer is empty. One that has hung up is not: a read reports it.
fn is_empty(port: &SerialStream) -> bool {
    matches!(port.bytes_to_read(), Ok(0))
}

/// Takes the measurements that were held until their unit was recognised.
fn take_held(
    session: &mut Session,
    state: &mut RecorderState,
    device_clock: &mut DeviceClock,
    actions: &mut Vec<Action>,
    held: &mut Vec<(u64, i64, Measurement)>,
) {
    for (mono_ns, utc_ns, measurement) in held.drain(..) {
        measured(session, state, device_clock, actions, (mono_ns, utc_ns), &measurement);
    }
}

/// Takes a measurement that arrived at these times (monotonic and UTC ns).
fn measured(
    session: &mut Session,
    state: &mut RecorderState,
    device_clock: &mut DeviceClock,
    actions: &mut Vec<Action>,
    (mono_ns, utc_ns): (u64, i64),
    measurement: &Measurement,
) {
    let before = actions.len();
    let taken = session.measured(mono_ns, measurement, actions);
    if actions.len() > before {
        state.note(actions, utc_ns);
    }
    if taken {
        state.sample(measurement.to_sample(mono_ns, utc_ns));
        if let Some(device_time_ns) = measurement.device_time_ns {
            device_clock.note(state.clock_run(), device_time_ns, mono_ns);
        }
    } else if session.sees_another_format() {
        state.refuse(DiscardCause::UnexpectedFormat);
    } else {
        state.refuse(DiscardCause::Probing);
    }
}

impl Shell {
    /// Records that the loop runs. If it did not run for a while, the session is notified first: data that arrived
    /// meanwhile is still to be read.
    fn runs(&mut self, patient: bool) {
        if !patient {
            self.watch_host();
        }
    }

    fn input(&mut self, input: Input<'_>) {
        let now_ns = self.clock.mono_ns();
        self.session.handle(now_ns, input, &mut self.actions);
    }

    /// Reports the events that the host's clocks show.
    fn watch_host(&mut self) {
        let mono_ns = self.clock.mono_ns();
        let (awake_ns, utc_ns) = (self.clock.awake_ns(), self.clock.utc_ns());
        let reading = Reading { mono_ns, awake_ns, utc_ns, after_ns: self.clock.mono_ns() };
        for event in self.host.turn(reading, TICK.as_nanos() as u64) {
            match event {
                HostEvent::Stalled(_) => {
                    self.input(Input::HostStalled);
                    self.state.blame_host(GapCause::HostStall, mono_ns + HOST_BLAME_NS);
                }
                HostEvent::Slept(slept_ns) => {
                    self.input(Input::HostStalled);
                    self.state.blame_host(GapCause::HostSuspend, mono_ns + HOST_BLAME_NS);
                    let message = format!("the host slept for {:.1} s", slept_ns as f64 / 1e9);
                    self.state.apply(RecorderAction::Event(EventKind::Warning, message), utc_ns);
                }
                HostEvent::Stepped(by_ns) => self.state.clock_stepped(by_ns, utc_ns),
            }
        }
    }

    /// Records the estimate of the sensor's clock at intervals.
    fn note_clock(&mut self, mono_ns: u64) {
        if mono_ns < self.clock_due_ns {
            return;
        }
        if let Some(estimate) = self.device_clock.estimate()
            && self.state.device_clock(estimate)
        {
            self.clock_due_ns = mono_ns + CLOCK_EVERY_NS;
        }
    }

    /// Performs the actions of the session; some of them lead to further actions.
    async fn perform(&mut self, device: &Option<String>, stream: &mut Option<(SerialStream, PathBuf)>) {
        while !self.actions.is_empty() {
            for action in std::mem::take(&mut self.actions) {
                match action {
                    Action::Look => self.input(Input::Ports(port::look(device.as_deref()))),
                    Action::Open(path, baud) => {
                        self.discard_pending();
                        match port::open(&path, baud) {
                            Ok(port) => {
                                let latency = port::lower_latency(&path);
                                *stream = Some((port, path));
                                self.input(Input::Opened { latency });
                            }
                            Err(error) => self.input(Input::OpenFailed(error)),
                        }
                    }
                    Action::SetBaud(baud) => {
                        self.discard_pending();
                        let set = stream.as_mut().map(|(port, path)| port::set_baud(port, path, baud));
                        if let Some(Err(error)) = set {
                            // A rate that this port does not support counts as one without an answer.
                            tracing::debug!(%error, "baud rate not available");
                        }
                    }
                    Action::Send(bytes) => {
                        let Some((port, _)) = stream.as_mut() else { continue };
                        let sent = tokio::time::timeout(WRITE, port.write_all(&bytes)).await;
                        if let Ok(Err(error)) = sent {
                            self.input(Input::Disconnected(error.to_string()));
                        }
                    }
                    Action::Close => {
                        self.discard_pending();
                        *stream = None;
                    }
                    Action::Ended => self.ended = true,
                    Action::Record(action) => self.state.apply(action, self.clock.utc_ns()),
                }
            }
            self.filter();
        }
    }

    /// Passes the expected binary frames to the decoder.
    fn filter(&mut self) {
        if let Some(binary) = self.state.filter.take() {
            self.decoder.accept_binary(binary);
        }
    }

    /// Discards the bytes of a partial frame: the connection to which they belonged is closed.
    fn discard_pending(&mut self) {
        let Self { decoder, state, .. } = self;
        let recording = state.accepted.is_some();
        decoder.flush(&mut |event| {
            if let (Event::Rejected { cause: DiscardCause::GarbageBytes, bytes }, true) = (event, recording) {
                state.discard(DiscardCause::GarbageBytes, bytes.len() as u64);
            }
        });
    }

    fn received(&mut self, bytes: &[u8]) {
        let (mono_ns, utc_ns) = (self.clock.mono_ns(), self.clock.utc_ns());
        self.state.sink.bytes(bytes);
        self.recognised();
        let Self { session, decoder, state, actions, device_clock, unrecognised, .. } = self;
        session.handle(mono_ns, Input::Bytes(bytes.len()), actions);
        if bytes.len() >= FULL_BYTES && self.clock.speed() == 1.0 {
            // Data that the full line could not take was lost, and with it a part of a frame.
            state.blame_host(GapCause::HostStall, mono_ns + LATE_READ_NS);
        }
        decoder.push(bytes, &mut |event| match event {
            Event::Measurement(measurement) if session.is_unit_unknown() && unrecognised.len() < HELD_MAX => {
                session.await_unit(mono_ns, actions);
                unrecognised.push((mono_ns, utc_ns, measurement.clone()));
            }
            Event::Measurement(measurement) => {
                // The reply that recognised the unit may be in the same bytes.
                take_held(session, state, device_clock, actions, unrecognised);
                measured(session, state, device_clock, actions, (mono_ns, utc_ns), measurement);
            }
            Event::Reply(reply) => {
                session.handle(mono_ns, Input::Reply(&reply), actions);
                // The stream may begin within the very bytes that are being decoded.
                state.note(actions, utc_ns);
            }
            Event::DeviceError(error) => session.handle(mono_ns, Input::DeviceError(error), actions),
            // A partial frame received while the sensor is being identified was never part of the capture.
            Event::Rejected { cause, bytes }
                if session.status().state == SensorState::Streaming || session.is_unit_unknown() =>
            {
                session.handle(mono_ns, Input::Rejected(bytes.len()), actions);
                let count = if cause == DiscardCause::GarbageBytes { bytes.len() as u64 } else { 1 };
                state.discard(cause, count);
                state.suspect(GapCause::Checksum);
            }
            Event::Rejected { bytes, .. } => session.handle(mono_ns, Input::Rejected(bytes.len()), actions),
            Event::Other(_) => {}
        });
        if let Some(doubt) = state.doubt.take() {
            session.handle(mono_ns, Input::RateDoubted(doubt), actions);
        }
        self.recognised();
        self.filter();
        self.settle();
    }

    /// Takes the measurements of a unit that was not recognised when they arrived, if it is now or cannot be.
    fn recognised(&mut self) {
        if !self.session.is_unit_unknown() {
            self.take_held();
        }
    }

    /// Takes the held measurements now, as those of the unit of before.
    fn take_held(&mut self) {
        let Self { session, state, actions, device_clock, unrecognised, .. } = self;
        take_held(session, state, device_clock, actions, unrecognised);
    }

    /// Passes on the written records, and closes a capture that has its planned duration. A capture belongs to the
    /// first sensor of which it has samples.
    fn settle(&mut self) {
        if self.state.settle() {
            self.expecting = false;
            self.input(Input::Expect(None));
        } else if !self.expecting && self.state.recorder.as_ref().is_some_and(|recorder| recorder.counts().samples > 0)
        {
            self.expecting = true;
            let serial_number = self.session.status().serial_number.clone();
            self.input(Input::Expect(serial_number));
        }
    }

    fn tick(&mut self) {
        let (mono_ns, utc_ns) = (self.clock.mono_ns(), self.clock.utc_ns());
        if let Some((plan, resume)) =
            self.waiting.take_if(|(plan, _)| plan.start_at_utc_ns.is_none_or(|start| start <= utc_ns))
        {
            if let Some(point) = &resume {
                self.input(Input::Expect(point.serial_number.clone()));
                self.expecting = point.serial_number.is_some();
                self.input(Input::Previous(point.previous_output.clone()));
                if let Some(baud) = point.baud {
                    self.input(Input::GoodBaud(baud));
                }
            }
            // A step of civil time while no daemon ran, within this boot of the host.
            let last = resume.as_ref().and_then(|point| point.last).filter(|last| last.host_mono_ns > 0);
            let stepped =
                last.and_then(|last| stepped_while_away((last.host_mono_ns, last.host_utc_ns), (mono_ns, utc_ns)));
            let recorder = Recorder::new(plan, resume, self.host_jitter_ns).of_boot(self.clock.boot_id());
            // What arrived before the beginning belongs to no capture.
            self.unrecognised.drain(..).for_each(|_| self.state.refuse(DiscardCause::Probing));
            self.state.begin(recorder);
            if let Some(by_ns) = stepped {
                self.state.clock_stepped(by_ns, utc_ns);
            }
        }
        self.recognised();
        // Held measurements are no silence.
        if self.unrecognised.is_empty() {
            self.state.tick(mono_ns, utc_ns);
        }
        self.note_clock(mono_ns);
        self.settle();
    }

    fn command(&mut self, command: TaskCommand) {
        match command {
            TaskCommand::Begin(plan, resume) => {
                self.waiting = Some((plan, resume.map(|point| *point)));
                self.tick();
            }
            TaskCommand::Stop(reply) => {
                if let Some((plan, resume)) = self.waiting.take() {
                    // The capture never began: it is empty and stopped.
                    let host_jitter_ns = self.host_jitter_ns;
                    self.state.recorder.get_or_insert_with(|| Recorder::new(plan, resume, host_jitter_ns));
                }
                self.take_held();
                self.clock_due_ns = 0;
                self.note_clock(self.clock.mono_ns());
                let running = self.state.stop(self.clock.mono_ns(), self.clock.utc_ns());
                self.settle();
                // The caller may be gone; the capture is stopped anyway.
                let _ = reply.send(running);
            }
            TaskCommand::Shutdown => {
                self.take_held();
                self.clock_due_ns = 0;
                self.note_clock(self.clock.mono_ns());
                self.input(Input::Stop);
            }
        }
    }

    fn publish(&self, progress: &watch::Sender<Progress>) {
        let capture = match (&self.state.recorder, &self.waiting) {
            (Some(recorder), _) => Some((recorder.plan().clone(), recorder.counts(), false)),
            (None, Some((plan, _))) => Some((plan.clone(), Counts::default(), true)),
            (None, None) => None,
        };
        let mut sensor = self.session.status().clone();
        // The same rate and timebase as the capture's, if one runs.
        let stream = self.state.recorder.as_ref().and_then(Recorder::stream);
        let accepted = self.state.accepted.map(|(kind, rate_hz)| (rate_hz, timebase(kind, self.state.counted)));
        if let Some((rate_hz, timebase)) = stream.or(accepted) {
            (sensor.rate_hz, sensor.timebase) = (Some(rate_hz), Some(timebase));
        }
        sensor.clock = self.device_clock.estimate();
        let description = self.state.description.clone();
        progress.send_replace(Progress { sensor, description, capture });
    }
}
