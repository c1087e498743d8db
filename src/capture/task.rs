//! Task: connects session, decoder and recorder to the real port. A thin shell: they make every decision.

use super::action::{Action, Input};
use super::host_watch::{HostEvent, HostWatch, Reading, set_back_unset, stepped_while_away, unset_before};
use super::port;
use super::recorder::{Counts, Plan, Recorder, ResumePoint};
use super::session::{Session, SessionOptions};
use crate::clock::Clock;
use crate::observe::{SensorState, SensorStatus, Tally};
use imu_core::sample::device_clock::{ClockEstimate, DeviceClock};
use imu_core::sample::{
    Accountant, DiscardCause, EventKind, EventRecord, GapCause, RateDoubt, Record, Sample, Timebase,
};
use rand::SeedableRng;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_serial::SerialStream;
use vn100_proto::{BinaryAcceptance, Decoder, DecoderOptions, Event, MeasurementKind};

/// The interval at which time-outs, discards and progress are examined, in real time.
const TICK: Duration = Duration::from_millis(200);
/// Data that arrives within this time after the host stood still or slept may show what was lost, ns.
const HOST_BLAME_NS: u64 = 3_000_000_000;
/// The interval at which the estimate of the sensor's clock is recorded, ns.
const CLOCK_EVERY_NS: u64 = 60_000_000_000;
/// Places in the queue that samples never take, so that segments, gaps and events always find room.
const RESERVE: usize = 256;
/// The host's own lateness in reading, in real time; it counts if time runs faster.
const HOST_JITTER: Duration = Duration::from_millis(250);
/// The room that the accelerated reader waits for: more than one read can return.
const ROOM: usize = 8192;
/// At high rates several frames are read at once: a wake-up for each would cost more than the work it brings.
const COALESCE: Duration = Duration::from_millis(20);
/// Rates above which reads are coalesced, Hz; their frames carry the sensor's time.
const COALESCE_ABOVE_HZ: f64 = 250.0;
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
    /// Path or pattern of the port; the usual places if absent.
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
    pub description: Option<serde_json::Value>,
    /// The present capture: plan and counts, and whether it still waits for its start.
    pub capture: Option<(Plan, Counts, bool)>,
}

/// The destination of records: a bounded queue that never makes the reader wait.
pub trait Sink: Send + Sync + 'static {
    /// The number of records for which there is room now.
    fn room(&self) -> usize;
    /// Puts a record of this capture into the queue.
    ///
    /// # Errors
    /// The record, if the queue is full.
    fn put(&self, capture_id: i64, record: Record) -> Result<(), Box<Record>>;
    /// Whether the queue is no longer read.
    fn is_closed(&self) -> bool;
    /// Receives the counts of all received measurements by their state, before the counted records are put into the
    /// queue.
    fn tally(&self, _tally: Tally) {}
    /// Receives every measurement, whether a capture runs or not.
    fn seen(&self, _sample: &Sample) {}
    /// Receives the time by which the reader woke late.
    fn woke(&self, _late: Duration) {}
}

struct Shell {
    clock: Arc<dyn Clock>,
    session: Session,
    decoder: Decoder,
    book: Book,
    waiting: Option<(Plan, Option<ResumePoint>)>,
    /// The host's own lateness in receiving, on the clock.
    host_jitter_ns: f64,
    actions: Vec<Action>,
    host: HostWatch,
    device_clock: DeviceClock,
    /// The time at which the estimate of the sensor's clock is recorded next, ns.
    clock_due_ns: u64,
    /// Whether the session knows the sensor of the capture.
    expecting: bool,
    ended: bool,
}

/// The written data: the present capture and the queue to the store.
struct Book {
    recorder: Option<Recorder>,
    accepted: Option<(MeasurementKind, f64)>,
    /// Whether the messages carry a serial count that increases by one.
    counted: bool,
    /// The doubt about the rate that the arrivals raise, not yet passed to the session.
    doubt: Option<RateDoubt>,
    /// While no capture runs: determines when the sensor's clock restarted, and whether the rate is the same.
    idle: Option<Accountant>,
    /// The number of streams accepted without a capture.
    idle_runs: i64,
    description: Option<serde_json::Value>,
    /// The number of samples of the capture when an unset clock was last set back.
    set_back_seq: Option<u64>,
    sink: Box<dyn Sink>,
    /// Records that found no room: never samples.
    overflow: VecDeque<(i64, Record)>,
    out: Vec<Record>,
    /// The binary frames that the decoder must accept from the next read on, if they changed.
    filter: Option<BinaryAcceptance>,
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
        book: Book {
            recorder: None,
            accepted: None,
            counted: false,
            doubt: None,
            idle: None,
            idle_runs: 0,
            description: None,
            set_back_seq: None,
            sink,
            overflow: VecDeque::new(),
            out: Vec::new(),
            filter: None,
        },
        waiting: None,
        actions: Vec::new(),
        host: HostWatch::default(),
        device_clock: DeviceClock::default(),
        clock_due_ns: 0,
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
        // Arrived data is read before a silence is inferred from the time.
        let happened = tokio::select! {
            biased;
            command = commands.recv() => Happened::Command(command.unwrap_or(TaskCommand::Shutdown)),
            read = read(&mut stream, &mut buffer) => Happened::Read(read),
            () = tokio::time::sleep_until(wake.into()) => Happened::Nothing,
        };
        shell.runs(patient);
        let read_some = matches!(happened, Happened::Read(_));
        match happened {
            Happened::Command(command) => {
                shell.command(command);
                shell.publish(&progress);
            }
            Happened::Read(read) => {
                if patient {
                    shell.book.room().await;
                }
                let before = shell.session.status().state;
                match read {
                    Ok(0) => shell.input(Input::Disconnected("the line hung up".to_owned())),
                    Ok(count) => {
                        shell.received(&buffer[..count]);
                        if !patient && shell.book.accepted.is_some_and(|(_, rate_hz)| rate_hz > COALESCE_ABOVE_HZ) {
                            let due = Instant::now() + COALESCE;
                            tokio::time::sleep_until(due.into()).await;
                            shell.book.sink.woke(due.elapsed());
                        }
                    }
                    Err(error) => shell.input(Input::Disconnected(error.to_string())),
                }
                if shell.session.status().state != before {
                    shell.publish(&progress);
                }
            }
            Happened::Nothing => {
                shell.book.sink.woke(wake.elapsed());
                // The runtime may not have noticed yet what arrived; the port knows. The time is taken before this
                // query, so that data which arrives in between cannot be mistaken for silence.
                let now_ns = shell.clock.mono_ns();
                let unread = stream.as_mut().map(|(port, _)| port.try_read(&mut buffer));
                match unread {
                    Some(Ok(count)) if count > 0 => {
                        if patient {
                            shell.book.room().await;
                        }
                        shell.received(&buffer[..count]);
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
    shell.book.close().await;
    shell.publish(&progress);
}

/// The event that ended a wait.
enum Happened {
    Command(TaskCommand),
    Read(std::io::Result<usize>),
    Nothing,
}

async fn read(stream: &mut Option<(SerialStream, PathBuf)>, buffer: &mut [u8]) -> std::io::Result<usize> {
    match stream {
        Some((port, _)) => port.read(buffer).await,
        None => std::future::pending().await,
    }
}

impl Shell {
    /// Notes that the loop runs. If it did not run for a while, the session is notified first: data that arrived
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
                    self.book.blame_host(GapCause::HostStall, mono_ns + HOST_BLAME_NS);
                }
                HostEvent::Slept(slept_ns) => {
                    self.input(Input::HostStalled);
                    self.book.blame_host(GapCause::HostSuspend, mono_ns + HOST_BLAME_NS);
                    let message = format!("the host slept for {:.1} s", slept_ns as f64 / 1e9);
                    self.book.apply(Action::Event(EventKind::Warning, message), utc_ns);
                }
                HostEvent::Stepped(by_ns) => self.book.clock_stepped(by_ns, utc_ns),
            }
        }
    }

    /// Records the estimate of the sensor's clock at intervals.
    fn note_clock(&mut self, mono_ns: u64) {
        if mono_ns < self.clock_due_ns {
            return;
        }
        if let Some(estimate) = self.device_clock.estimate()
            && self.book.device_clock(estimate)
        {
            self.clock_due_ns = mono_ns + CLOCK_EVERY_NS;
        }
    }

    /// Performs the actions of the session; some of them lead to more.
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
                    // The rest concerns the capture.
                    action => self.book.apply(action, self.clock.utc_ns()),
                }
            }
            self.filter();
        }
    }

    /// Passes the expected binary frames to the decoder.
    fn filter(&mut self) {
        if let Some(binary) = self.book.filter.take() {
            self.decoder.accept_binary(binary);
        }
    }

    /// Bytes of a partial frame are void: the connection they belonged to is closed.
    fn discard_pending(&mut self) {
        let Self { decoder, book, .. } = self;
        let recording = book.accepted.is_some();
        decoder.flush(&mut |event| {
            if let (Event::Rejected { cause: DiscardCause::GarbageBytes, bytes }, true) = (event, recording) {
                book.discard(DiscardCause::GarbageBytes, bytes.len() as u64);
            }
        });
    }

    fn received(&mut self, bytes: &[u8]) {
        let (mono_ns, utc_ns) = (self.clock.mono_ns(), self.clock.utc_ns());
        let Self { session, decoder, book, actions, device_clock, .. } = self;
        session.handle(mono_ns, Input::Bytes(bytes.len()), actions);
        if bytes.len() >= FULL_BYTES && self.clock.speed() == 1.0 {
            // Data that the full line could not take was lost, and with it a part of a frame.
            book.blame_host(GapCause::HostStall, mono_ns + LATE_READ_NS);
        }
        decoder.push(bytes, &mut |event| match event {
            Event::Measurement(measurement) => {
                let before = actions.len();
                let taken = session.measured(mono_ns, measurement, actions);
                if actions.len() > before {
                    book.note(actions, utc_ns);
                }
                if taken {
                    book.sample(measurement.to_sample(mono_ns, utc_ns));
                    if let Some(device_time_ns) = measurement.device_time_ns {
                        device_clock.note(book.clock_run(), device_time_ns, mono_ns);
                    }
                } else if session.sees_another_format() {
                    book.refuse(DiscardCause::UnexpectedFormat);
                } else {
                    book.refuse(DiscardCause::Probing);
                }
            }
            Event::Reply(reply) => {
                session.handle(mono_ns, Input::Reply(&reply), actions);
                // The stream may begin within the very bytes that are being decoded.
                book.note(actions, utc_ns);
            }
            Event::DeviceError(error) => session.handle(mono_ns, Input::DeviceError(error), actions),
            // A partial frame received while the sensor is being identified was never part of the capture.
            Event::Rejected { cause, bytes } if session.status().state == SensorState::Streaming => {
                session.handle(mono_ns, Input::Rejected(bytes.len()), actions);
                let count = if cause == DiscardCause::GarbageBytes { bytes.len() as u64 } else { 1 };
                book.discard(cause, count);
                book.suspect(GapCause::Checksum);
            }
            Event::Rejected { bytes, .. } => session.handle(mono_ns, Input::Rejected(bytes.len()), actions),
            Event::Other(_) => {}
        });
        if let Some(doubt) = book.doubt.take() {
            session.handle(mono_ns, Input::RateDoubted(doubt), actions);
        }
        self.filter();
        self.settle();
    }

    /// Passes on what was written; a capture that has its planned duration is closed. A capture is of one sensor: the
    /// first that it has samples of.
    fn settle(&mut self) {
        if self.book.settle() {
            self.expecting = false;
            self.input(Input::Expect(None));
        } else if !self.expecting && self.book.recorder.as_ref().is_some_and(|recorder| recorder.counts().samples > 0) {
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
            // The step of civil time while no daemon watched, within this boot of the host.
            let last = resume.as_ref().and_then(|point| point.last).filter(|last| last.host_mono_ns > 0);
            let stepped =
                last.and_then(|last| stepped_while_away((last.host_mono_ns, last.host_utc_ns), (mono_ns, utc_ns)));
            let recorder = Recorder::new(plan, resume, self.host_jitter_ns).of_boot(self.clock.boot_id());
            self.book.begin(recorder);
            if let Some(by_ns) = stepped {
                self.book.clock_stepped(by_ns, utc_ns);
            }
        }
        self.book.tick(mono_ns, utc_ns);
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
                    // It never began: an empty capture, stopped.
                    let host_jitter_ns = self.host_jitter_ns;
                    self.book.recorder.get_or_insert_with(|| Recorder::new(plan, resume, host_jitter_ns));
                }
                self.clock_due_ns = 0;
                self.note_clock(self.clock.mono_ns());
                let running = self.book.stop(self.clock.mono_ns(), self.clock.utc_ns());
                self.settle();
                // The caller may be gone; the capture is stopped nevertheless.
                let _ = reply.send(running);
            }
            TaskCommand::Shutdown => {
                self.clock_due_ns = 0;
                self.note_clock(self.clock.mono_ns());
                self.input(Input::Stop);
            }
        }
    }

    fn publish(&self, progress: &watch::Sender<Progress>) {
        let capture = match (&self.book.recorder, &self.waiting) {
            (Some(recorder), _) => Some((recorder.plan().clone(), recorder.counts(), false)),
            (None, Some((plan, _))) => Some((plan.clone(), Counts::default(), true)),
            (None, None) => None,
        };
        let mut sensor = self.session.status().clone();
        // The same rate and timebase as the capture's, if one runs.
        let stream = self.book.recorder.as_ref().and_then(Recorder::stream);
        let accepted = self.book.accepted.map(|(kind, rate_hz)| (rate_hz, timebase(kind, self.book.counted)));
        if let Some((rate_hz, timebase)) = stream.or(accepted) {
            (sensor.rate_hz, sensor.timebase) = (Some(rate_hz), Some(timebase));
        }
        sensor.clock = self.device_clock.estimate();
        let description = self.book.description.clone();
        progress.send_replace(Progress { sensor, description, capture });
    }
}

/// The timebase of these measurements.
fn timebase(kind: MeasurementKind, counted: bool) -> Timebase {
    match (kind.has_device_time(), counted) {
        (true, _) => Timebase::Device,
        (false, true) => Timebase::SyncCounter,
        (false, false) => Timebase::Arrival,
    }
}

impl Book {
    /// Performs the actions that concern the capture at once, in order, and leaves those that concern the port.
    fn note(&mut self, actions: &mut Vec<Action>, utc_ns: i64) {
        for action in std::mem::take(actions) {
            match action {
                Action::Accept(..)
                | Action::AcceptAny
                | Action::RateKnown(_)
                | Action::Counted(_)
                | Action::Interrupt(_)
                | Action::Event(..)
                | Action::Describe(_) => {
                    self.apply(action, utc_ns);
                }
                port => actions.push(port),
            }
        }
    }

    fn apply(&mut self, action: Action, utc_ns: i64) {
        match action {
            Action::Accept(kind, rate_hz) => {
                self.accepted = Some((kind, rate_hz));
                // Random bytes can only be mistaken for a frame with the one expected header.
                self.filter = Some(match kind {
                    MeasurementKind::Binary(header) => BinaryAcceptance::Only(header),
                    MeasurementKind::Ascii(_) => BinaryAcceptance::Any,
                });
                match &mut self.recorder {
                    Some(recorder) => recorder.accept(rate_hz, timebase(kind, self.counted), &mut self.out),
                    None => {
                        self.idle_runs += 1;
                        self.idle = Some(Accountant::new(rate_hz, timebase(kind, self.counted)));
                    }
                }
            }
            Action::RateKnown(rate_hz) => match (&mut self.recorder, &mut self.idle) {
                (Some(recorder), _) => recorder.rate_known(rate_hz, &mut self.out),
                (None, Some(idle)) => idle.rate_known(rate_hz, &mut self.out),
                (None, None) => {}
            },
            Action::Counted(counted) => self.counted = counted,
            Action::AcceptAny => self.filter = Some(BinaryAcceptance::Any),
            Action::Interrupt(cause) => {
                self.filter = Some(BinaryAcceptance::Any);
                if let Some(recorder) = &mut self.recorder {
                    recorder.interrupt(cause, &mut self.out);
                }
            }
            Action::Event(kind, message) => {
                match kind {
                    EventKind::Warning | EventKind::SensorLost | EventKind::SensorError => {
                        tracing::warn!(%message, "sensor");
                    }
                    _ => tracing::info!(%message, "sensor"),
                }
                if self.recorder.is_some() {
                    self.out.push(Record::Event(EventRecord { utc_ns, kind, message, detail: None }));
                }
            }
            Action::Describe(description) => {
                if self.recorder.is_some() {
                    self.out.push(Record::Configuration(description.clone()));
                }
                self.description = Some(description);
            }
            _ => return,
        }
        self.flush();
    }

    fn begin(&mut self, mut recorder: Recorder) {
        if let Some((kind, rate_hz)) = self.accepted {
            recorder.accept(rate_hz, timebase(kind, self.counted), &mut self.out);
        }
        if let Some(description) = &self.description {
            self.out.push(Record::Configuration(description.clone()));
        }
        self.recorder = Some(recorder);
        self.set_back_seq = None;
        self.flush();
    }

    fn sample(&mut self, sample: Sample) {
        self.sink.seen(&sample);
        let Some(recorder) = &mut self.recorder else {
            if let Some(idle) = &mut self.idle {
                idle.observe(sample, &mut self.out);
                idle.take_refused();
                self.doubt = idle.take_doubt().or(self.doubt);
                self.out.clear();
            }
            return;
        };
        if self.sink.room() <= RESERVE + self.out.len() {
            // The disk is too slow by more than the queue holds: this becomes a gap, whose length the sensor's clock
            // will determine.
            recorder.interrupt(GapCause::StorageBackpressure, &mut self.out);
            recorder.refuse(DiscardCause::StorageBackpressure);
            self.sink.tally(recorder.tally());
            return;
        }
        recorder.sample(sample, &mut self.out);
        self.doubt = recorder.take_doubt().or(self.doubt);
        self.sink.tally(recorder.tally());
        if self.overflow.is_empty() {
            let id = recorder.plan().id;
            for record in self.out.drain(..) {
                if let Err(record) = self.sink.put(id, record) {
                    self.overflow.push_back((id, *record));
                }
            }
        }
    }

    /// The present run of the sensor's clock, as the accounting numbers it: capture and epoch. Without a capture each
    /// accepted stream is a run: it may be of another unit, or of one that lost power.
    fn clock_run(&self) -> (i64, u32) {
        match (&self.recorder, &self.idle) {
            (Some(recorder), _) => (recorder.plan().id, recorder.epoch().unwrap_or(0)),
            (None, idle) => (-self.idle_runs, idle.as_ref().map_or(0, Accountant::epoch)),
        }
    }

    fn discard(&mut self, cause: DiscardCause, count: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.discard(cause, count);
        }
    }

    fn refuse(&mut self, cause: DiscardCause) {
        if let Some(recorder) = &mut self.recorder {
            recorder.refuse(cause);
            self.sink.tally(recorder.tally());
        }
    }

    fn blame_host(&mut self, cause: GapCause, until_mono_ns: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.blame_host(cause, until_mono_ns);
        }
    }

    /// Handles a step of civil time. No count depends on it, but it is recorded. If the host's clock had not been set
    /// before, the times written with it are corrected.
    fn clock_stepped(&mut self, by_ns: i64, utc_ns: i64) {
        let before_utc_ns = unset_before(by_ns, utc_ns);
        let more = if before_utc_ns.is_some() {
            "; it had not been set, and what was recorded with it is corrected"
        } else {
            ""
        };
        let message = format!("the host's clock was stepped by {:+.3} s{more}", by_ns as f64 / 1e9);
        tracing::warn!(%message, "clock");
        if let Some(recorder) = &self.recorder {
            if let Some(before_utc_ns) = before_utc_ns {
                let (boot_id, since_seq) = (recorder.boot_id(), self.set_back_seq);
                self.out.push(Record::UtcSet { by_ns, before_utc_ns, boot_id, since_seq });
            } else if set_back_unset(by_ns, utc_ns) {
                self.set_back_seq = Some(recorder.counts().samples);
            }
            let filled = before_utc_ns.is_some();
            let detail = Some(serde_json::json!({"by_s": by_ns as f64 / 1e9, "utc_back_filled": filled}));
            self.out.push(Record::Event(EventRecord { utc_ns, kind: EventKind::ClockStep, message, detail }));
            self.flush();
        }
    }

    /// Records the estimate of the sensor's clock; returns `false` if there is no capture with samples.
    fn device_clock(&mut self, estimate: ClockEstimate) -> bool {
        let Some(epoch) = self.recorder.as_ref().and_then(Recorder::epoch) else { return false };
        self.out.push(Record::DeviceClock { epoch, estimate });
        self.flush();
        true
    }

    fn suspect(&mut self, cause: GapCause) {
        if let Some(recorder) = &mut self.recorder {
            recorder.suspect(cause);
        }
    }

    fn tick(&mut self, mono_ns: u64, utc_ns: i64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.tick(mono_ns, utc_ns, &mut self.out);
        }
        self.flush();
    }

    fn stop(&mut self, mono_ns: u64, utc_ns: i64) -> bool {
        let Some(recorder) = &mut self.recorder else { return false };
        recorder.stop(mono_ns, utc_ns, &mut self.out);
        true
    }

    /// Passes on what was written; returns `true` if the capture has ended.
    fn settle(&mut self) -> bool {
        if let Some(recorder) = self.recorder.as_mut().filter(|recorder| recorder.has_ended()) {
            // Measurements that arrived with the last one, but after the planned end.
            recorder.write_discards(&mut self.out);
        }
        self.flush();
        let ended = self.recorder.take_if(|recorder| recorder.has_ended()).is_some();
        if let (true, Some((kind, rate_hz))) = (ended, self.accepted) {
            self.idle = Some(Accountant::new(rate_hz, timebase(kind, self.counted)));
        }
        ended
    }

    /// Puts the records into the queue, in order; those without room wait (samples reserved theirs before).
    fn flush(&mut self) {
        if let Some(recorder) = &self.recorder {
            self.sink.tally(recorder.tally());
        }
        match self.recorder.as_ref().map(|recorder| recorder.plan().id) {
            Some(id) => {
                for record in self.out.drain(..) {
                    // While the disk refuses, every tick adds to the count of discards: one record grows instead of the
                    // queue.
                    if let (
                        Some((last_id, Record::Discarded { cause: last, count: total })),
                        Record::Discarded { cause, count },
                    ) = (self.overflow.back_mut(), &record)
                        && (*last_id, *last) == (id, *cause)
                    {
                        *total += count;
                        continue;
                    }
                    self.overflow.push_back((id, record));
                }
            }
            None => self.out.clear(),
        }
        while let Some((id, record)) = self.overflow.pop_front() {
            if let Err(record) = self.sink.put(id, record) {
                self.overflow.push_front((id, *record));
                break;
            }
        }
    }

    /// Waits until the queue has room for what one read may return.
    async fn room(&self) {
        while self.sink.room() < ROOM && !self.sink.is_closed() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Ends with the daemon: everything goes into the queue; an unfinished capture stays unfinished.
    async fn close(&mut self) {
        if let Some(recorder) = &mut self.recorder {
            recorder.pause(&mut self.out);
        }
        self.flush();
        while !self.overflow.is_empty() && !self.sink.is_closed() {
            tokio::time::sleep(Duration::from_millis(5)).await;
            self.flush();
        }
    }
}
