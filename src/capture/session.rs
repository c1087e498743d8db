//! Session: the connection to one sensor as a state machine. Pure: it neither reads the clock nor touches the port; it
//! says what is to be done and is told what came of it. The only owner of retrying.
//!
//! ```text
//! Absent ─► Opening ─► Scanning (bauds) ─► Probing (identity, registers) ─► Configuring ─► Streaming ─► Restoring
//!    ▲          │            │                   │                              │            │   │
//!    └──────────┴── Backoff ◄┴───────────────────┴──────────────────────────────┴────────────┘   └► Stalled
//! ```
//!
//! Promises: ports are looked for every [`LOOK_NS`] whenever none is open, and one that came, went or is another ends any
//! wait; a wait in `Backoff` never exceeds [`super::backoff::LONGEST`], with a sensor that is known and silent a second;
//! the sensor's flash is never written; every state ends by itself.

use super::action::{Action, Input, Port};
use super::backoff::Backoff;
use super::description::{Registers, describe};
use super::output::{Output, ascii_kind, binary_output, check_fit, counts_messages, is_binary, serial_count};
use super::port::Latency;
use super::rate_meter::RateMeter;
use super::script::{Script, Step};
use crate::observe::{SensorState, SensorStatus};
use crate::protocol::{ChecksumKind, Command, Measurement, MeasurementKind};
use crate::sample::{EventKind, GapCause};
use crate::units::period_ns;
use rand_chacha::ChaCha8Rng;

mod connect;

/// How often an absent port is looked for, ns.
pub const LOOK_NS: u64 = 500_000_000;
/// Silence that means `stalled`: this long, but at least [`STALL_PERIODS`] periods.
const STALL_NS: f64 = 1e9;
const STALL_PERIODS: f64 = 20.0;
/// Silence after which the port is closed and opened again, ns (but at least 100 periods).
const REOPEN_NS: f64 = 5e9;
/// The same where bytes arrive that form no frame (but at least 40 periods).
const GARBLED_NS: f64 = 2e9;
/// How long frames of another kind are tolerated before the output is configured again, ns.
const FOREIGN_NS: u64 = 300_000_000;
/// How long a sensor of unknown rate is listened to, ns.
const MEASURE_NS: u64 = 2_000_000_000;
/// Registers that describe the measurement; a sensor that refuses one loses nothing but the description.
/// 0 user tag, 2 hardware, 5 baud, 6 and 7 ASCII output, 21 references, 23 magnetic, 25 acceleration, 26 frame rotation,
/// 30 communication, 32 synchronisation, 35 VPE, 44 hard/soft iron, 75–77 binary outputs, 82 delta, 83 reference model,
/// 84 gyro compensation, 85 filter windows.
const DESCRIPTIVE: [u16; 20] = [5, 6, 7, 75, 76, 77, 85, 30, 0, 2, 21, 23, 25, 26, 32, 35, 44, 82, 83, 84];

/// What a session wants to know.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionOptions {
    /// What the sensor shall send.
    pub output: Output,
    /// Baud rates to try, best first; not empty.
    pub bauds: Vec<u32>,
    /// How late the host may hear for reasons of its own, ns: no silence below it means anything. 0 at real time; where
    /// time runs faster the host's own lateness is magnified by the speed.
    pub host_jitter_ns: u64,
}

#[derive(Debug, Clone, PartialEq)]
enum Phase {
    Absent,
    Opening,
    Scanning { index: usize, since_ns: u64, heard: bool, valid: bool },
    Identifying,
    Describing,
    Configuring,
    Measuring { until_ns: u64, meter: RateMeter },
    Streaming,
    Restoring,
    Backoff { until_ns: u64 },
    Ended,
}

/// The connection to one sensor.
#[derive(Debug)]
pub struct Session {
    options: SessionOptions,
    phase: Phase,
    script: Script,
    backoff: Backoff,
    random: ChaCha8Rng,
    status: SensorStatus,
    next_look_ns: u64,
    /// Ports of the last look and which of them is tried.
    ports: Vec<Port>,
    port_index: usize,
    /// Ports that failed in succession since the last success.
    failed_ports: usize,
    last_good_baud: Option<u32>,
    /// Register contents as read, by number.
    registers: Registers,
    /// What the output registers held before they were changed, to be put back.
    previous: Registers,
    /// Serial number of the sensor that `previous` belongs to.
    previous_of: Option<String>,
    expected_serial: Option<String>,
    latency: Latency,
    accepted: Option<(MeasurementKind, f64)>,
    last_sample_ns: u64,
    bytes_since_sample: usize,
    foreign_since_ns: Option<u64>,
    /// A sample has come since streaming began.
    flowing: bool,
    /// As the registers say, the messages carry a serial count that steps by one.
    counted: bool,
    /// A sample with that count has come.
    numbered: bool,
    heard_any: bool,
    /// Bytes came at the baud rate that worked last, and were no frames.
    good_is_garbled: bool,
    stopping: bool,
}

impl Session {
    /// A session that has not begun; `seed` feeds the jitter of its waits.
    #[must_use]
    pub fn new(options: SessionOptions, random: ChaCha8Rng) -> Self {
        Self {
            phase: Phase::Absent,
            script: Script::patient(options.host_jitter_ns),
            options,
            backoff: Backoff::default(),
            random,
            status: SensorStatus::default(),
            next_look_ns: 0,
            ports: Vec::new(),
            port_index: 0,
            failed_ports: 0,
            last_good_baud: None,
            registers: Registers::new(),
            previous: Registers::new(),
            previous_of: None,
            expected_serial: None,
            latency: Latency::NotApplicable,
            accepted: None,
            last_sample_ns: 0,
            bytes_since_sample: 0,
            foreign_since_ns: None,
            flowing: false,
            counted: false,
            numbered: false,
            heard_any: false,
            good_is_garbled: false,
            stopping: false,
        }
    }

    /// The sensor as a person would describe it now.
    #[must_use]
    pub fn status(&self) -> &SensorStatus {
        &self.status
    }

    /// Whether a measurement that is no sample now is one of another output than was asked for, also after a silence.
    #[must_use]
    pub fn sees_another_format(&self) -> bool {
        self.phase == Phase::Streaming || self.status.state == SensorState::UnexpectedFormat
    }

    /// When [`Input::Tick`] is due at the latest, ns.
    #[must_use]
    pub fn deadline_ns(&self) -> u64 {
        match &self.phase {
            Phase::Absent => self.next_look_ns,
            Phase::Opening | Phase::Ended => u64::MAX,
            Phase::Scanning { .. } => self.scan_end_ns().min(self.script.deadline_ns()),
            Phase::Identifying | Phase::Describing | Phase::Configuring | Phase::Restoring => self.script.deadline_ns(),
            Phase::Measuring { until_ns, .. } => *until_ns,
            Phase::Backoff { until_ns } => (*until_ns).min(self.next_look_ns),
            Phase::Streaming => {
                let warned = matches!(self.status.state, SensorState::Stalled | SensorState::NoValidFrames);
                let silence = if warned { self.reopen_ns() } else { self.stall_ns() };
                (self.last_sample_ns + silence).min(self.script.deadline_ns())
            }
        }
    }

    /// Takes note of a valid measurement frame and says whether it is a sample of the stream.
    pub fn measured(&mut self, now_ns: u64, measurement: &Measurement, actions: &mut Vec<Action>) -> bool {
        let kind = measurement.kind;
        match &mut self.phase {
            Phase::Streaming => {}
            // A valid frame tells the baud rate even where the sensor does not answer.
            Phase::Scanning { valid, .. } => {
                if !std::mem::replace(valid, true) {
                    self.ask(now_ns, actions);
                }
                return false;
            }
            Phase::Measuring { meter, .. } => {
                meter.note(now_ns, kind, measurement.device_time_ns);
                return false;
            }
            _ => return false,
        }
        let is_other = self.accepted.is_none_or(|(accepted, _)| accepted != kind) && !self.adopt(kind, actions);
        // The flash may hold the very message that is recorded: then only the count that is gone tells of a reset.
        if is_other || (self.numbered && measurement.sync_count.is_none()) {
            self.foreign(now_ns, kind, actions);
            return false;
        }
        self.numbered |= self.counted && measurement.sync_count.is_some();
        self.last_sample_ns = now_ns;
        self.bytes_since_sample = 0;
        self.foreign_since_ns = None;
        if !self.flowing {
            self.flowing = true;
            self.failed_ports = 0;
            self.backoff.reset();
        }
        if self.status.state != SensorState::Streaming {
            self.set_state(SensorState::Streaming, None);
        }
        true
    }

    /// While the output is kept and nothing has come yet, an ASCII message of another type than register 6 says is
    /// taken for the stream at once: no sample of a recording that is played is lost.
    fn adopt(&mut self, kind: MeasurementKind, actions: &mut Vec<Action>) -> bool {
        let binary_on = [75, 76, 77].into_iter().any(|register| self.binary_output(register).is_some());
        if self.options.output != Output::Keep || self.flowing || is_binary(kind) || binary_on {
            return false;
        }
        let Some((_, rate_hz)) = self.accepted else { return false };
        self.accept(kind, rate_hz, actions);
        true
    }

    /// A sensor that was reset sends what its flash says: after a moment without samples its output is configured again.
    fn foreign(&mut self, now_ns: u64, kind: MeasurementKind, actions: &mut Vec<Action>) {
        let since_ns = *self.foreign_since_ns.get_or_insert(now_ns);
        if now_ns - since_ns < FOREIGN_NS || now_ns.saturating_sub(self.last_sample_ns) < FOREIGN_NS {
            return;
        }
        self.foreign_since_ns = None;
        let message = match self.accepted {
            Some((accepted, _)) if accepted == kind => format!("the sensor sends {kind} without its count"),
            Some((accepted, _)) => format!("the sensor sends {kind} instead of {accepted}"),
            None => format!("the sensor sends {kind}"),
        };
        self.set_state(SensorState::UnexpectedFormat, Some(message.clone()));
        actions.push(Action::Interrupt(GapCause::FormatChange));
        if self.options.output == Output::Keep {
            actions.push(Action::Event(EventKind::Reconfigured, message));
            // What it sends contradicts what its registers said of the count.
            COUNT_REGISTERS.iter().for_each(|register| drop(self.registers.remove(register)));
            self.measure(now_ns);
        } else {
            actions.push(Action::Event(EventKind::Reconfigured, format!("{message}: its output is configured again")));
            self.identify(now_ns, actions);
        }
    }

    /// Takes one input; what is to be done is pushed to `actions`.
    pub fn handle(&mut self, now_ns: u64, input: Input<'_>, actions: &mut Vec<Action>) {
        match input {
            Input::Tick => self.tick(now_ns, actions),
            Input::Ports(ports) => self.found(ports, actions),
            Input::Opened { latency } => self.opened(now_ns, latency, actions),
            Input::OpenFailed(error) => self.open_failed(now_ns, &error, actions),
            Input::Disconnected(reason) => self.disconnected(now_ns, &reason, actions),
            Input::Bytes(count) => {
                self.bytes_since_sample = self.bytes_since_sample.saturating_add(count);
                self.heard_any |= count > 0;
                if count > 0 {
                    self.heard(now_ns);
                }
            }
            Input::Reply(reply) => {
                if self.script.answer(now_ns, reply, actions) {
                    self.advance(now_ns, actions);
                }
            }
            Input::DeviceError(error) => {
                if self.script.refuse(now_ns, error, actions) {
                    self.advance(now_ns, actions);
                } else {
                    actions.push(Action::Event(EventKind::SensorError, format!("the sensor reports: {error}")));
                }
            }
            Input::Expect(serial) => self.expected_serial = serial,
            Input::GoodBaud(baud) => {
                self.last_good_baud.get_or_insert(baud);
            }
            Input::Previous(registers) => {
                if !registers.is_empty() {
                    self.previous = registers;
                    self.previous_of.clone_from(&self.expected_serial);
                }
            }
            Input::HostStalled => {
                self.last_sample_ns = now_ns;
                self.script.forgive(now_ns);
                if let Phase::Scanning { since_ns, .. } = &mut self.phase {
                    *since_ns = now_ns;
                }
            }
            Input::Stop => self.stop(now_ns, actions),
        }
    }

    fn set_state(&mut self, state: SensorState, hint: Option<String>) {
        self.status.state = state;
        self.status.hint = hint;
    }

    /// Silence in ns after which the state is `stalled`.
    fn stall_ns(&self) -> u64 {
        let period = self.accepted.map_or(0.0, |(_, rate_hz)| period_ns(rate_hz));
        (STALL_NS.max(STALL_PERIODS * period) as u64).max(self.options.host_jitter_ns)
    }

    /// Silence in ns after which the port is closed and opened again: bytes that form no frame need another baud rate.
    fn reopen_ns(&self) -> u64 {
        let period = self.accepted.map_or(0.0, |(_, rate_hz)| period_ns(rate_hz));
        let garbled = self.status.state == SensorState::NoValidFrames;
        let (least, periods) = if garbled { (GARBLED_NS, 2.0) } else { (REOPEN_NS, 5.0) };
        (least.max(periods * STALL_PERIODS * period) as u64).max(2 * self.options.host_jitter_ns)
    }

    fn tick(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        match &self.phase {
            Phase::Absent if now_ns >= self.next_look_ns => {
                self.next_look_ns = now_ns + LOOK_NS;
                actions.push(Action::Look);
            }
            Phase::Backoff { until_ns } => {
                let (over, look) = (now_ns >= *until_ns, now_ns >= self.next_look_ns);
                if over {
                    self.phase = Phase::Absent;
                }
                // A port that went or came meanwhile does not wait.
                if over || look {
                    self.next_look_ns = now_ns + LOOK_NS;
                    actions.push(Action::Look);
                }
            }
            Phase::Scanning { .. } => {
                if now_ns >= self.scan_end_ns() {
                    self.scan_next(now_ns, actions);
                } else {
                    self.script.tick(now_ns, actions);
                }
            }
            Phase::Identifying | Phase::Describing | Phase::Configuring | Phase::Restoring => {
                self.script.tick(now_ns, actions);
                self.advance(now_ns, actions);
            }
            Phase::Measuring { until_ns, .. } if now_ns >= *until_ns => self.rate_measured(now_ns, actions),
            Phase::Streaming => self.listen(now_ns, actions),
            _ => {}
        }
    }

    /// The script under way has moved: go on to the next phase where it is done.
    fn advance(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        if let Some(failure) = self.script.failure() {
            let failure = failure.to_owned();
            if self.phase == Phase::Restoring {
                self.end(actions);
            } else if self.phase != Phase::Streaming {
                self.fail(now_ns, SensorState::Backoff, failure, actions);
            }
            return;
        }
        if let (Phase::Scanning { .. }, Some(model)) = (&self.phase, self.script.read().get(&1)) {
            self.status.model = Some(model.clone());
            self.last_good_baud = self.status.baud;
            self.identify(now_ns, actions);
            return;
        }
        if !self.script.is_done() {
            return;
        }
        match self.phase {
            Phase::Identifying => self.identified(now_ns, actions),
            Phase::Describing => {
                let read = self.script.read().clone();
                self.registers.extend(read);
                self.configure(now_ns, actions);
            }
            Phase::Configuring => self.configured(now_ns, actions),
            Phase::Restoring => self.end(actions),
            Phase::Streaming => self.recognise(now_ns, actions),
            _ => {}
        }
    }

    /// A sensor that fell silent has answered: another one than before is found out from the beginning.
    fn recognise(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let found = self.script.read().get(&3).cloned();
        if found.is_some() && self.status.serial_number.is_some() && found != self.status.serial_number {
            actions.push(Action::Interrupt(GapCause::Silent));
            self.identify(now_ns, actions);
        }
    }

    fn identify(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        self.flowing = false;
        self.phase = Phase::Identifying;
        let mut steps = Vec::new();
        if self.options.output != Output::Keep {
            // Pausing lasts until resumed or reset; the registers stay as they are.
            steps.push(Step::optional(Command::AsyncOutput(false)));
        }
        steps.extend([
            Step::optional(Command::read(1)),
            Step::optional(Command::read(3)),
            Step::optional(Command::read(4)),
        ]);
        self.script.begin(now_ns, steps, actions);
    }

    fn identified(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let read = self.script.read().clone();
        self.status.model = read.get(&1).cloned().or(self.status.model.take());
        let serial_number = read.get(&3).cloned();
        if let (Some(before), Some(found)) = (&self.previous_of, &serial_number)
            && before != found
        {
            // Another unit: what the first one sent before is not to be written into it.
            self.previous.clear();
        }
        // A number that was not answered this once says nothing of another unit.
        if serial_number.is_some() {
            self.previous_of.clone_from(&serial_number);
        }
        self.status.serial_number = serial_number;
        self.status.firmware = read.get(&4).cloned();
        self.registers.extend(read);
        if let (Some(expected), Some(found)) = (&self.expected_serial, &self.status.serial_number)
            && expected != found
        {
            let hint = format!(
                "the capture belongs to the sensor with serial number {expected}, this one is {found}: plug the right one in, or stop the capture"
            );
            self.fail(now_ns, SensorState::WrongUnit, hint, actions);
            return;
        }
        self.phase = Phase::Describing;
        let steps = DESCRIPTIVE.into_iter().map(|register| Step::optional(Command::read(register))).collect();
        self.script.begin(now_ns, steps, actions);
    }

    fn configure(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        if let Err(misfit) = self.fits() {
            self.fail(now_ns, SensorState::Backoff, misfit, actions);
            return;
        }
        if self.previous.is_empty() {
            let messages = matches!(self.options.output, Output::Ascii { .. });
            self.previous = OUTPUT_REGISTERS
                .into_iter()
                .chain(COUNT_REGISTERS.into_iter().filter(|_| messages))
                .filter_map(|register| Some((register, self.registers.get(&register)?.clone())))
                .collect();
        }
        let mut steps = Vec::new();
        // The previous owner's outputs would share the line.
        for register in [75, 76, 77] {
            if self.binary_output(register).is_some() {
                steps.push(Step::optional(Command::write(register, "0,0,0")));
            }
        }
        match &self.options.output {
            Output::Keep => {
                self.begin_keeping(now_ns, actions);
                return;
            }
            Output::Binary { fields, divisor } => {
                steps.push(Step::required(Command::write(6, 0)));
                steps.push(Step::required(Command::write(75, format!("1,{divisor},{fields}"))));
                steps.push(Step::required(Command::read(75)));
            }
            Output::Ascii { number, rate_hz } => {
                steps.push(Step::required(Command::write(7, rate_hz)));
                steps.push(Step::required(Command::write(6, number)));
                steps.extend(self.counting(f64::from(*rate_hz)));
                steps.push(Step::required(Command::read(6)));
                steps.push(Step::required(Command::read(7)));
                steps.extend(COUNT_REGISTERS.map(|register| Step::optional(Command::read(register))));
            }
        }
        steps.push(Step::optional(Command::AsyncOutput(true)));
        self.phase = Phase::Configuring;
        self.script.begin(now_ns, steps, actions);
    }

    /// What makes the sensor number its messages, where it does not yet and its SyncOut pin drives nothing else.
    fn counting(&self, rate_hz: f64) -> Vec<Step> {
        let text = |register| self.registers.get(&register).map(String::as_str);
        let (Some(communication), Some(synchronization)) = (text(30), text(32)) else { return Vec::new() };
        serial_count(communication, synchronization, rate_hz)
            .into_iter()
            .map(|(register, values)| Step::optional(Command::write(register, values)))
            .collect()
    }

    /// Whether messages at this rate carry a count that steps by one for each, as registers 30 and 32 say.
    fn is_counted(&self, kind: MeasurementKind, rate_hz: f64) -> bool {
        let text = |register| self.registers.get(&register).map(String::as_str);
        !is_binary(kind)
            && text(30).zip(text(32)).is_some_and(|(communication, synchronization)| {
                counts_messages(communication, synchronization, rate_hz)
            })
    }

    /// Whether the wanted output fits the line, else the arithmetic.
    fn fits(&self) -> Result<(), String> {
        let (Some(baud), Some((kind, rate_hz))) = (self.status.baud, self.options.output.kind_and_rate()) else {
            return Ok(());
        };
        check_fit(kind, rate_hz, baud)
    }

    fn configured(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let read = self.script.read().clone();
        self.registers.extend(read);
        let Some((kind, rate_hz)) = self.options.output.kind_and_rate() else { return };
        let taken = match &self.options.output {
            Output::Binary { .. } => self.binary_output(75) == Some((kind, rate_hz)),
            Output::Ascii { .. } => self.ascii_output() == Some((kind, rate_hz)),
            Output::Keep => true,
        };
        if taken {
            self.stream(now_ns, kind, rate_hz, actions);
        } else {
            let hint = format!(
                "the sensor was told to send {kind} at {rate_hz} Hz, but its registers say otherwise (75: {}, 6: {}, 7: {})",
                self.register_text(75),
                self.register_text(6),
                self.register_text(7),
            );
            self.fail(now_ns, SensorState::Backoff, hint, actions);
        }
    }

    fn register_text(&self, register: u16) -> &str {
        self.registers.get(&register).map_or("unknown", String::as_str)
    }

    /// What binary output register 75, 76 or 77 sends, where it is on.
    fn binary_output(&self, register: u16) -> Option<(MeasurementKind, f64)> {
        binary_output(register, self.registers.get(&register)?)
    }

    /// What registers 6 and 7 send, where it is on.
    fn ascii_output(&self) -> Option<(MeasurementKind, f64)> {
        let first = |register| self.registers.get(&register)?.split(',').next();
        let kind = ascii_kind(first(6)?.parse().ok()?)?;
        let rate_hz: f64 = first(7)?.parse().ok()?;
        (rate_hz > 0.0).then_some((kind, rate_hz))
    }

    /// Takes what the sensor sends, as its registers describe it; where they do not, listens first.
    fn begin_keeping(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let outputs = [75, 76, 77].into_iter().find_map(|register| self.binary_output(register));
        match outputs.or_else(|| self.ascii_output()) {
            Some((kind, rate_hz)) => self.stream(now_ns, kind, rate_hz, actions),
            None => self.measure(now_ns),
        }
    }

    fn measure(&mut self, now_ns: u64) {
        self.flowing = false;
        self.script.clear();
        self.phase = Phase::Measuring {
            until_ns: now_ns + MEASURE_NS.max(self.options.host_jitter_ns),
            meter: RateMeter::default(),
        };
    }

    fn rate_measured(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let Phase::Measuring { meter, .. } = &self.phase else { return };
        match meter.result() {
            Some((kind, rate_hz)) => self.stream(now_ns, kind, rate_hz, actions),
            None => {
                let hint = "the sensor sends no measurements: its outputs are off, and the configuration says to keep them (`output = \"keep\"`)";
                self.fail(now_ns, SensorState::Stalled, hint.to_owned(), actions);
            }
        }
    }

    fn stream(&mut self, now_ns: u64, kind: MeasurementKind, rate_hz: f64, actions: &mut Vec<Action>) {
        self.script.clear();
        self.phase = Phase::Streaming;
        (self.flowing, self.numbered) = (false, false);
        self.last_sample_ns = now_ns;
        self.bytes_since_sample = 0;
        self.foreign_since_ns = None;
        self.accept(kind, rate_hz, actions);
        let unit = self.status.serial_number.as_deref().unwrap_or("unknown");
        let model = self.status.model.as_deref().unwrap_or("sensor of unknown model");
        let message = format!(
            "{model}, serial number {unit}, on {} at {} baud sends {kind} at {rate_hz} Hz",
            self.status.port.as_deref().unwrap_or("?"),
            self.status.baud.unwrap_or(0),
        );
        actions.push(Action::Event(EventKind::SensorFound, message));
        if let Some(hint) = self.latency.hint() {
            actions.push(Action::Event(EventKind::Warning, hint));
        }
    }

    fn accept(&mut self, kind: MeasurementKind, rate_hz: f64, actions: &mut Vec<Action>) {
        self.accepted = Some((kind, rate_hz));
        self.status.rate_hz = Some(rate_hz);
        self.status.output = Some(kind.to_string());
        let description = describe(&self.status, &self.registers, &self.previous, self.latency, kind, rate_hz);
        actions.push(Action::Describe(description));
        self.counted = self.is_counted(kind, rate_hz);
        actions.push(Action::Counted(self.counted));
        actions.push(Action::Accept(kind, rate_hz));
    }

    /// While streaming: how long has it been silent?
    fn listen(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let silence_ns = now_ns.saturating_sub(self.last_sample_ns);
        if silence_ns >= self.reopen_ns() {
            let (cause, message) = if self.bytes_since_sample > 0 {
                (
                    GapCause::Checksum,
                    "bytes arrive, but no valid frame: the port is opened again and its baud rate looked for",
                )
            } else {
                (GapCause::Silent, "the sensor is silent: the port is opened again")
            };
            actions.push(Action::Interrupt(cause));
            actions.push(Action::Event(EventKind::SensorLost, message.to_owned()));
            self.flowing = false;
            self.script.clear();
            actions.push(Action::Close);
            self.wait(now_ns, SensorState::Stalled);
        } else if silence_ns >= self.stall_ns()
            && !matches!(self.status.state, SensorState::Stalled | SensorState::NoValidFrames)
        {
            if self.bytes_since_sample > 0 {
                self.set_state(SensorState::NoValidFrames, Some("bytes arrive, but no valid frame".to_owned()));
                actions.push(Action::AcceptAny);
            } else {
                self.set_state(SensorState::Stalled, Some("the port is open, but nothing arrives".to_owned()));
            }
            // A sensor that answers is alive; an output that somebody paused resumes.
            let mut steps = vec![Step::optional(Command::read(1)), Step::optional(Command::read(3))];
            if self.options.output != Output::Keep {
                steps.insert(0, Step::optional(Command::AsyncOutput(true)));
            }
            self.script.begin(now_ns, steps, actions);
        } else {
            self.script.tick(now_ns, actions);
        }
    }

    fn stop(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        self.stopping = true;
        let changed = self.options.output != Output::Keep && !self.previous.is_empty();
        match self.phase {
            Phase::Streaming | Phase::Configuring if changed => {
                self.phase = Phase::Restoring;
                let mut steps = vec![Step::optional(Command::AsyncOutput(false))];
                steps.extend(
                    self.previous.iter().map(|(register, fields)| Step::optional(Command::write(*register, fields))),
                );
                steps.push(Step::optional(Command::AsyncOutput(true)));
                self.script.begin(now_ns, steps, actions);
            }
            // The answer to `Open` is still to come.
            Phase::Opening | Phase::Restoring => {}
            Phase::Ended => actions.push(Action::Ended),
            _ => {
                if self.options.output != Output::Keep && matches!(self.phase, Phase::Identifying | Phase::Describing) {
                    actions.push(Action::Send(Command::AsyncOutput(true).to_bytes(ChecksumKind::Xor8)));
                }
                self.end(actions);
            }
        }
    }

    fn end(&mut self, actions: &mut Vec<Action>) {
        self.phase = Phase::Ended;
        self.script.clear();
        self.set_state(SensorState::Absent, None);
        actions.push(Action::Close);
        actions.push(Action::Ended);
    }
}

/// Registers that choose the output; put back in this order.
const OUTPUT_REGISTERS: [u16; 5] = [6, 7, 75, 76, 77];
/// With messages, the count that they carry and what it counts as well.
const COUNT_REGISTERS: [u16; 2] = [30, 32];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::port::OpenError;
    use crate::protocol::{DeviceError, Reply};
    use proptest::prelude::*;
    use rand::SeedableRng;
    use std::collections::BTreeMap;

    /// A sensor that answers commands from a register file, as far as it is told to.
    struct Sensor {
        registers: BTreeMap<u16, String>,
        answers: bool,
        commands: Vec<String>,
    }

    impl Sensor {
        fn new() -> Self {
            let registers = [
                (1, "VN-100T-CR"),
                (3, "0100012345"),
                (4, "3.1.0.0"),
                (5, "115200"),
                (6, "14"),
                (7, "40"),
                (75, "0,0,0"),
                (76, "0,0,0"),
                (77, "0,0,0"),
                (85, "0,4,4,4,0,0,3,3,3,0"),
            ];
            Self {
                registers: registers.into_iter().map(|(number, text)| (number, text.to_owned())).collect(),
                answers: true,
                commands: Vec::new(),
            }
        }
    }

    struct World {
        session: Session,
        sensor: Sensor,
        now_ns: u64,
        port: bool,
        /// How often it was plugged in.
        plugged: u32,
        open: bool,
        opens: u32,
        seen: Vec<Action>,
        ended: bool,
    }

    impl World {
        fn new(output: Output) -> Self {
            let options = SessionOptions { output, bauds: vec![115_200, 921_600], host_jitter_ns: 0 };
            Self {
                session: Session::new(options, ChaCha8Rng::seed_from_u64(7)),
                sensor: Sensor::new(),
                now_ns: 0,
                port: true,
                plugged: 1,
                open: false,
                opens: 0,
                seen: Vec::new(),
                ended: false,
            }
        }

        fn give(&mut self, input: Input<'_>) {
            let mut actions = Vec::new();
            self.session.handle(self.now_ns, input, &mut actions);
            self.perform(actions);
        }

        fn perform(&mut self, actions: Vec<Action>) {
            for action in actions {
                self.seen.push(action.clone());
                match action {
                    Action::Look => {
                        let port = Port { path: "/dev/ttyUSB0".into(), node: format!("ttyUSB0 {}", self.plugged) };
                        let ports = if self.port { vec![port] } else { Vec::new() };
                        self.give(Input::Ports(ports));
                    }
                    Action::Open(..) => {
                        assert!(!self.open, "opened twice");
                        self.opens += 1;
                        if self.port {
                            self.open = true;
                            self.give(Input::Opened { latency: Latency::NotApplicable });
                        } else {
                            self.give(Input::OpenFailed(OpenError::Gone { path: "/dev/ttyUSB0".into() }));
                        }
                    }
                    Action::Close => self.open = false,
                    Action::Send(bytes) => self.answer(&String::from_utf8(bytes).unwrap()),
                    Action::Ended => self.ended = true,
                    _ => {}
                }
            }
        }

        fn answer(&mut self, line: &str) {
            let body = line.trim_start_matches('$').split('*').next().unwrap().to_owned();
            self.sensor.commands.push(body.clone());
            assert!(!body.starts_with("VNWNV") && !body.starts_with("VNFWU"), "flash must not be written: {body}");
            if !self.sensor.answers {
                return;
            }
            let command = Reply::parse(&body).unwrap();
            let register = command.register.unwrap_or(0);
            match command.verb {
                crate::protocol::Verb::ReadRegister => match self.sensor.registers.get(&register) {
                    Some(text) => {
                        let answer = format!("{body},{text}");
                        self.give(Input::Reply(&Reply::parse(&answer).unwrap()));
                    }
                    None => self.give(Input::DeviceError(DeviceError::from_code(8))),
                },
                crate::protocol::Verb::WriteRegister => {
                    self.sensor.registers.insert(register, command.values.to_owned());
                    self.give(Input::Reply(&command));
                }
                _ => self.give(Input::Reply(&command)),
            }
        }

        fn pass(&mut self, ns: u64) {
            let end = self.now_ns + ns;
            while self.session.deadline_ns() <= end && !self.ended {
                self.now_ns = self.now_ns.max(self.session.deadline_ns());
                let before = (self.session.deadline_ns(), self.seen.len());
                self.give(Input::Tick);
                if (self.session.deadline_ns(), self.seen.len()) == before {
                    self.now_ns += 1_000_000;
                }
            }
            self.now_ns = end;
        }

        fn measured(&mut self, kind: MeasurementKind) -> bool {
            self.numbered(kind, None)
        }

        fn numbered(&mut self, kind: MeasurementKind, sync_count: Option<u32>) -> bool {
            let mut actions = Vec::new();
            let mut measurement = Measurement::new(kind);
            measurement.sync_count = sync_count;
            let taken = self.session.measured(self.now_ns, &measurement, &mut actions);
            self.perform(actions);
            taken
        }

        fn state(&self) -> SensorState {
            self.session.status().state
        }
    }

    fn default_output() -> Output {
        Output::Binary { fields: "01,0609".to_owned(), divisor: 20 }
    }

    fn default_kind() -> MeasurementKind {
        default_output().kind_and_rate().unwrap().0
    }

    #[test]
    fn a_sensor_is_found_configured_and_streams() {
        let mut world = World::new(default_output());
        world.pass(1_000_000_000);
        assert!(world.seen.contains(&Action::Accept(default_kind(), 40.0)), "{:?}", world.seen);
        assert!(world.sensor.commands.contains(&"VNWRG,75,1,20,01,0609".to_owned()));
        assert!(world.measured(default_kind()));
        assert_eq!(world.state(), SensorState::Streaming);
        assert_eq!(world.session.status().serial_number.as_deref(), Some("0100012345"));
        let described = world
            .seen
            .iter()
            .rev()
            .find_map(|action| if let Action::Describe(value) = action { Some(value) } else { None });
        assert_eq!(described.unwrap()["filter_window"]["gyro"], 4);
        assert!(described.unwrap()["registers"].get("44").is_none(), "a refused register is absent");
    }

    #[test]
    fn a_clean_stop_puts_the_previous_output_back() {
        let mut world = World::new(default_output());
        world.pass(1_000_000_000);
        world.measured(default_kind());
        world.give(Input::Stop);
        world.pass(1_000_000_000);
        assert!(world.ended && !world.open);
        assert_eq!(world.sensor.registers[&6], "14");
        assert_eq!(world.sensor.registers[&75], "0,0,0");
    }

    #[test]
    fn kept_output_is_taken_as_the_registers_describe_it_and_nothing_is_written() {
        let mut world = World::new(Output::Keep);
        world.pass(1_000_000_000);
        let ymr = ascii_kind(14).unwrap();
        assert!(world.seen.contains(&Action::Accept(ymr, 40.0)));
        assert!(world.measured(ymr));
        world.give(Input::Stop);
        assert!(
            world.sensor.commands.iter().all(|command| command.starts_with("VNRRG")),
            "{:?}",
            world.sensor.commands
        );
    }

    #[test]
    fn kept_output_of_another_type_than_the_registers_say_is_taken_from_its_first_line() {
        let mut world = World::new(Output::Keep);
        world.pass(1_000_000_000);
        let imu = ascii_kind(19).unwrap();
        assert!(world.measured(imu));
    }

    #[test]
    fn a_sensor_that_only_sends_is_kept_with_its_rate_measured() {
        let mut world = World::new(Output::Keep);
        world.sensor.answers = false;
        let ymr = ascii_kind(14).unwrap();
        for _ in 0..400 {
            world.pass(25_000_000);
            world.measured(ymr);
        }
        assert!(world.seen.contains(&Action::Accept(ymr, 40.0)), "{:?}", world.seen);
    }

    #[test]
    fn silence_is_stalled_then_the_port_is_opened_again() {
        let mut world = World::new(default_output());
        world.pass(1_000_000_000);
        world.measured(default_kind());
        world.pass(1_500_000_000);
        assert_eq!(world.state(), SensorState::Stalled);
        assert_eq!(world.opens, 1);
        world.pass(5_000_000_000);
        assert!(world.seen.contains(&Action::Interrupt(GapCause::Silent)));
        assert!(world.opens >= 2);
    }

    #[test]
    fn a_host_that_stood_still_takes_its_own_absence_for_nobodys_silence() {
        let mut world = World::new(default_output());
        world.pass(1_000_000_000);
        world.measured(default_kind());
        world.now_ns += 60_000_000_000;
        world.give(Input::HostStalled);
        world.give(Input::Tick);
        assert_eq!((world.state(), world.opens), (SensorState::Streaming, 1));
        assert!(world.measured(default_kind()));
    }

    #[test]
    fn a_sensor_that_was_reset_is_configured_again_within_two_seconds() {
        let mut world = World::new(default_output());
        world.pass(1_000_000_000);
        world.measured(default_kind());
        world.sensor = Sensor::new();
        let ymr = ascii_kind(14).unwrap();
        let begun = world.now_ns;
        while world.sensor.registers[&75] == "0,0,0" {
            world.pass(25_000_000);
            world.measured(ymr);
            assert!(world.now_ns - begun < 2_000_000_000);
        }
        assert!(world.measured(default_kind()));
        assert_eq!(world.opens, 1);
    }

    /// The flash holds the message that is recorded, at its rate, but no count.
    #[test]
    fn a_count_that_vanishes_is_a_reset_and_is_switched_on_again_within_two_seconds() {
        let output = Output::Ascii { number: 14, rate_hz: 40 };
        let ymr = ascii_kind(14).unwrap();
        let mut world = World::new(output);
        let flash =
            [(30, "0,0,0,0,1,0,1"), (32, "3,0,0,0,6,1,0,100000000,0")].map(|(number, text)| (number, text.to_owned()));
        world.sensor.registers.extend(flash.clone());
        world.pass(1_000_000_000);
        assert!(world.seen.contains(&Action::Counted(true)), "{:?}", world.seen);
        for count in 0..80 {
            world.pass(25_000_000);
            assert!(world.numbered(ymr, Some(count)));
        }
        // A single line without it is damage or a slip, no reset.
        assert!(!world.measured(ymr));
        world.pass(25_000_000);
        assert!(world.numbered(ymr, Some(81)));
        assert_eq!(world.state(), SensorState::Streaming);
        world.seen.clear();
        world.sensor.registers = Sensor::new().registers;
        world.sensor.registers.extend(flash);
        let begun = world.now_ns;
        while !world.seen.contains(&Action::Accept(ymr, 40.0)) {
            world.pass(25_000_000);
            assert!(!world.measured(ymr), "no sample of the reset sensor passes for one that is counted");
            assert!(world.now_ns - begun < 2_000_000_000);
        }
        assert!(world.seen.contains(&Action::Interrupt(GapCause::FormatChange)) && world.opens == 1);
        assert!(world.sensor.registers[&30].starts_with("3,"), "{:?}", world.sensor.registers);
        assert!(world.numbered(ymr, Some(1)));
    }

    /// Where the output is kept, messages whose count is gone go on by their arrival.
    #[test]
    fn a_kept_count_that_vanishes_is_no_longer_relied_upon() {
        let ymr = ascii_kind(14).unwrap();
        let mut world = World::new(Output::Keep);
        world.sensor.registers.insert(30, "3,0,0,0,1,0,1".to_owned());
        world.sensor.registers.insert(32, "3,0,0,0,1,1,19,100000000,0".to_owned());
        world.pass(1_000_000_000);
        assert!(world.seen.contains(&Action::Counted(true)), "{:?}", world.seen);
        assert!(world.numbered(ymr, Some(7)));
        world.seen.clear();
        for _ in 0..120 {
            world.pass(25_000_000);
            world.measured(ymr);
        }
        assert!(world.seen.contains(&Action::Counted(false)), "{:?}", world.seen);
        assert!(world.measured(ymr) && world.state() == SensorState::Streaming);
    }

    #[test]
    fn another_unit_is_refused_and_said() {
        let mut world = World::new(default_output());
        world.give(Input::Expect(Some("0100099999".to_owned())));
        world.pass(2_000_000_000);
        assert_eq!(world.state(), SensorState::WrongUnit);
        assert!(world.session.status().hint.as_ref().unwrap().contains("0100012345"));
        assert!(!world.seen.iter().any(|action| matches!(action, Action::Accept(..))));
    }

    #[test]
    fn an_output_that_does_not_fit_the_line_is_refused_with_the_arithmetic() {
        let mut world = World::new(Output::Binary { fields: "01,0609".to_owned(), divisor: 1 });
        world.pass(2_000_000_000);
        let hint = world.session.status().hint.clone().unwrap();
        assert!(hint.contains("70 bytes × 800 Hz × 10 bits = 560000 bit/s"), "{hint}");
    }

    #[test]
    fn an_absent_port_is_looked_for_at_least_once_a_second() {
        let mut world = World::new(default_output());
        world.port = false;
        world.pass(60_000_000_000);
        let looks = world.seen.iter().filter(|action| **action == Action::Look).count();
        assert!((60..=130).contains(&looks), "{looks}");
        assert_eq!(world.state(), SensorState::Absent);
        world.port = true;
        world.pass(1_500_000_000);
        assert!(world.seen.contains(&Action::Accept(default_kind(), 40.0)));
    }

    #[test]
    fn a_port_that_is_plugged_in_anew_ends_any_wait() {
        let mut world = World::new(default_output());
        world.sensor.answers = false;
        world.pass(120_000_000_000);
        assert_eq!(world.state(), SensorState::Stalled);
        // pulled out while nobody has it open, and plugged in again
        while world.open {
            world.pass(50_000_000);
        }
        world.sensor.answers = true;
        world.plugged += 1;
        let begun = world.now_ns;
        while !world.measured(default_kind()) {
            world.pass(25_000_000);
            assert!(world.now_ns - begun < 1_500_000_000);
        }
    }

    #[test]
    fn a_known_sensor_that_was_silent_for_long_streams_within_three_seconds() {
        for silent_s in [3, 7, 20, 61, 200] {
            let mut world = World::new(default_output());
            world.pass(1_000_000_000);
            assert!(world.measured(default_kind()));
            world.sensor.answers = false;
            world.pass(silent_s * 1_000_000_000 + 123_456_789);
            world.sensor.answers = true;
            let begun = world.now_ns;
            while !world.measured(default_kind()) {
                world.pass(25_000_000);
                assert!(world.now_ns - begun < 3_000_000_000, "silent for {silent_s} s: {:?}", world.session.status());
            }
        }
    }

    #[test]
    fn the_baud_rate_that_worked_last_comes_first_and_between_the_others() {
        let mut world = World::new(default_output());
        world.session.options.bauds = vec![9600, 115_200, 921_600];
        world.give(Input::GoodBaud(921_600));
        world.sensor.answers = false;
        world.pass(8_000_000_000);
        let bauds: Vec<u32> = world
            .seen
            .iter()
            .filter_map(|action| match action {
                Action::Open(_, baud) | Action::SetBaud(baud) => Some(*baud),
                _ => None,
            })
            .take(5)
            .collect();
        assert_eq!(bauds, [921_600, 9600, 921_600, 115_200, 921_600]);

        // One that speaks at another rate is not looked for at the good one again and again.
        let mut world = World::new(default_output());
        world.session.options.bauds = vec![9600, 115_200, 230_400, 921_600];
        world.give(Input::GoodBaud(921_600));
        world.sensor.answers = false;
        for _ in 0..80 {
            world.pass(50_000_000);
            world.give(Input::Bytes(20));
        }
        let bauds: Vec<&Action> = world.seen.iter().filter(|action| matches!(action, Action::SetBaud(_))).collect();
        assert_eq!(bauds[..3], [&Action::SetBaud(9600), &Action::SetBaud(115_200), &Action::SetBaud(230_400)]);
    }

    #[test]
    fn another_unit_behind_the_same_port_is_noticed_after_a_silence() {
        let mut world = World::new(default_output());
        world.give(Input::Expect(Some("0100012345".to_owned())));
        world.pass(1_000_000_000);
        assert!(world.measured(default_kind()));
        world.sensor.registers.insert(3, "0100099999".to_owned());
        world.pass(1_100_000_000);
        assert_eq!(world.state(), SensorState::WrongUnit);
        world.sensor.registers.insert(3, "0100012345".to_owned());
        world.pass(3_000_000_000);
        assert!(world.measured(default_kind()));
    }

    #[derive(Debug, Clone)]
    enum Happening {
        Pass(u64),
        Unplug,
        Plug,
        Mute,
        Speak,
        Measure,
        Foreign,
        Garbage,
    }

    fn happening() -> impl Strategy<Value = Happening> {
        prop_oneof![
            (1_u64..3_000_000_000).prop_map(Happening::Pass),
            Just(Happening::Unplug),
            Just(Happening::Plug),
            Just(Happening::Mute),
            Just(Happening::Speak),
            Just(Happening::Measure),
            Just(Happening::Foreign),
            Just(Happening::Garbage),
        ]
    }

    proptest! {
        /// Whatever happens: never opened twice (checked in the world), and once all is well again, streaming within 12 s.
        #[test]
        fn every_state_ends_by_itself(happenings in proptest::collection::vec(happening(), 0..60)) {
            let mut world = World::new(default_output());
            for happening in happenings {
                match happening {
                    Happening::Pass(ns) => world.pass(ns),
                    Happening::Unplug => {
                        world.port = false;
                        if world.open {
                            world.give(Input::Disconnected("gone".to_owned()));
                        }
                    }
                    Happening::Plug => {
                        world.port = true;
                        world.plugged += 1;
                    }
                    Happening::Mute => world.sensor.answers = false,
                    Happening::Speak => world.sensor.answers = true,
                    Happening::Measure => { world.measured(default_kind()); }
                    Happening::Foreign => { world.measured(ascii_kind(14).unwrap()); }
                    Happening::Garbage => world.give(Input::Bytes(100)),
                }
            }
            world.port = true;
            world.sensor.answers = true;
            let mut streaming = false;
            for _ in 0..480 {
                world.pass(25_000_000);
                streaming = world.measured(default_kind());
                if streaming {
                    break;
                }
            }
            prop_assert!(streaming, "state {:?}", world.session.status());
            world.give(Input::Stop);
            world.pass(10_000_000_000);
            prop_assert!(world.ended && !world.open);
        }
    }
}
