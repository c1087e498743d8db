//! Session: the connection to one sensor as a state machine. Pure: it neither reads the clock nor touches the port; it
//! returns actions and receives their outcomes. All retrying is done here.
//!
//! ```text
//! Absent ─► Opening ─► Scanning (bauds) ─► Probing (identity, registers) ─► Configuring ─► Streaming ─► Restoring
//!    ▲          │            │                   │                              │            │   │
//!    └──────────┴── Backoff ◄┴───────────────────┴──────────────────────────────┴────────────┘   └► Stalled
//! ```
//!
//! Guarantees: ports are looked for every [`LOOK_NS`] whenever none is open, and a port that appeared, disappeared or
//! changed ends any wait. A wait in `Backoff` never exceeds [`super::backoff::LONGEST`], or a second with a known
//! sensor that is silent. The sensor's flash is never written. Every state ends by itself.

use super::action::{Action, Input, RecorderAction};
use super::backoff::Backoff;
use super::output::Output;
use super::port::{Latency, Port};
use super::rate_meter::RateMeter;
use super::script::{Script, Step};
use crate::observe::{SensorState, SensorStatus};
use imu_core::sample::{EventKind, GapCause, RateDoubt, Registers};
use rand_chacha::ChaCha8Rng;
use vn100_proto::{Command, MeasurementKind};

mod configure;
mod connect;
mod rate;
mod stream;
#[cfg(test)]
mod tests;

/// The interval at which an absent port is looked for, ns.
pub const LOOK_NS: u64 = 500_000_000;

/// Options of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionOptions {
    /// The requested output of the sensor.
    pub output: Output,
    /// Baud rates to try, best first; not empty.
    pub bauds: Vec<u32>,
    /// The host's own lateness in receiving, ns: a shorter silence has no meaning. 0 at real time; with accelerated
    /// time the host's lateness is multiplied by the speed.
    pub host_jitter_ns: u64,
}

#[derive(Debug, Clone, PartialEq)]
enum Phase {
    Absent,
    Opening,
    Scanning { index: usize, since_ns: u64, received: bool, valid: bool },
    Identifying,
    Describing,
    Configuring,
    Measuring { until_ns: u64, meter: RateMeter },
    Streaming,
    Restoring,
    Backoff { until_ns: u64 },
    Ended,
}

/// Which unit sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unit {
    /// The one of before.
    Known,
    /// Perhaps another one: the line was silent, and nothing has arrived since.
    Unknown,
    /// Perhaps another one: measurements have arrived since, and it was asked for its serial number.
    Asked,
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
    /// Ports of the last look and the index of the one that is tried.
    ports: Vec<Port>,
    port_index: usize,
    /// Ports that failed in succession since the last success.
    failed_ports: usize,
    last_good_baud: Option<u32>,
    /// Register contents as read, by number.
    registers: Registers,
    /// The contents of the output registers before they were changed, to be restored.
    previous: Registers,
    /// Serial number of the sensor that `previous` belongs to.
    previous_of: Option<String>,
    expected_serial: Option<String>,
    latency: Latency,
    accepted: Option<(MeasurementKind, f64)>,
    last_sample_ns: u64,
    /// Bytes since the last sample that belong to no frame: replies to a probe are not garbage.
    rejected_since_sample: usize,
    /// The doubt because of which the registers are read again.
    doubt: Option<RateDoubt>,
    /// The time from which an open doubt is examined, ns.
    next_doubt_ns: u64,
    foreign_since_ns: Option<u64>,
    /// Which unit sends, where the output is kept.
    unit: Unit,
    /// Whether a sample has arrived since streaming began.
    flowing: bool,
    /// Whether, according to the registers, the messages carry a serial count that increases by one.
    counted: bool,
    /// Whether a sample with that count has arrived.
    numbered: bool,
    received_any: bool,
    /// Whether bytes arrived at the last good baud rate that were no frames.
    good_is_garbled: bool,
    stopping: bool,
}

impl Session {
    /// Creates a session that has not begun; `seed` feeds the jitter of its waits.
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
            rejected_since_sample: 0,
            doubt: None,
            next_doubt_ns: 0,
            foreign_since_ns: None,
            unit: Unit::Known,
            flowing: false,
            counted: false,
            numbered: false,
            received_any: false,
            good_is_garbled: false,
            stopping: false,
        }
    }

    /// Returns the present state of the sensor, for the user.
    pub fn status(&self) -> &SensorStatus {
        &self.status
    }

    /// Returns the latest time at which [`Input::Tick`] is due, ns.
    pub fn deadline_ns(&self) -> u64 {
        match &self.phase {
            Phase::Absent => self.next_look_ns,
            Phase::Opening | Phase::Ended => u64::MAX,
            Phase::Scanning { .. } => self.scan_end_ns().min(self.script.deadline_ns()),
            Phase::Identifying | Phase::Describing | Phase::Configuring | Phase::Restoring => self.script.deadline_ns(),
            Phase::Measuring { until_ns, .. } => *until_ns,
            Phase::Backoff { until_ns } => (*until_ns).min(self.next_look_ns),
            Phase::Streaming if self.unit == Unit::Asked => self.script.deadline_ns(),
            Phase::Streaming => {
                let warned = matches!(self.status.state, SensorState::Stalled | SensorState::NoValidFrames);
                let silence = if warned { self.reopen_ns() } else { self.stall_ns() };
                (self.last_sample_ns + silence).min(self.script.deadline_ns())
            }
        }
    }

    /// Takes one input; the resulting actions are pushed to `actions`.
    pub fn handle(&mut self, now_ns: u64, input: Input<'_>, actions: &mut Vec<Action>) {
        match input {
            Input::Tick => self.tick(now_ns, actions),
            Input::Ports(ports) => self.found(ports, actions),
            Input::Opened { latency } => self.opened(now_ns, latency, actions),
            Input::OpenFailed(error) => self.open_failed(now_ns, &error, actions),
            Input::Disconnected(reason) => self.disconnected(now_ns, &reason, actions),
            Input::Bytes(count) => {
                self.received_any |= count > 0;
                if count > 0 {
                    self.received(now_ns);
                }
            }
            Input::Rejected(count) => self.rejected_since_sample = self.rejected_since_sample.saturating_add(count),
            Input::RateDoubted(doubt) => self.rate_doubted(now_ns, doubt, actions),
            Input::Reply(reply) => {
                if self.script.answer(now_ns, reply, actions) {
                    self.advance(now_ns, actions);
                }
            }
            Input::DeviceError(error) => {
                if self.script.refuse(now_ns, error, actions) {
                    self.advance(now_ns, actions);
                } else {
                    actions.push(
                        RecorderAction::Event(EventKind::SensorError, format!("the sensor reports: {error}")).into(),
                    );
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
                // A port that appeared or disappeared meanwhile does not wait.
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

    /// Continues with the next phase if the present script is done.
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
}
