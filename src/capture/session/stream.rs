//! Streaming: determines which measurements are samples, how to react to their absence, and what the sensor presumably
//! sends. Pure.

use super::super::description::describe;
use super::super::output::is_binary;
use super::super::rate_meter::RateMeter;
use super::configure::COUNT_REGISTERS;
use super::{
    Action, Command, EventKind, GapCause, Output, Phase, RateDoubt, RecorderAction, SensorState, Session, Step, Unit,
};
use imu_core::units::period_ns;
use vn100_proto::{FrameOptions, Measurement, MeasurementKind, frame_bytes};

/// Silence that counts as `stalled`: this long, but at least [`STALL_PERIODS`] periods.
const STALL_NS: f64 = 1e9;
const STALL_PERIODS: f64 = 20.0;
/// Silence after which the port is closed and opened again, ns (but at least 100 periods).
const REOPEN_NS: f64 = 5e9;
/// [`REOPEN_NS`] if bytes arrive that form no frame (but at least 40 periods).
const GARBLED_NS: f64 = 2e9;
/// How long frames of another kind are tolerated before the output is configured again, ns.
const FOREIGN_NS: u64 = 300_000_000;
/// The time to listen to a sensor of unknown rate, ns.
const MEASURE_NS: u64 = 2_000_000_000;

impl Session {
    /// Returns whether a measurement that is no sample now belongs to another output than the requested one, also after
    /// a silence.
    pub fn sees_another_format(&self) -> bool {
        self.phase == Phase::Streaming || self.status.state == SensorState::UnexpectedFormat
    }

    /// Returns whether the unit that sends may be another one than before: its output is kept, the line was silent, and the unit has not stated its
    /// serial number yet. What arrives meanwhile belongs to a capture only if it is the unit of before.
    pub fn is_unit_unknown(&self) -> bool {
        let is_unknown = match self.unit {
            Unit::Known => false,
            Unit::Unknown => true,
            // A unit that does not answer any more is taken for the same one.
            Unit::Asked => !self.script.is_done(),
        };
        self.phase == Phase::Streaming && is_unknown
    }

    /// Asks the unit for its serial number when its first measurement arrives: a question during the silence may have gone to
    /// nobody.
    pub fn await_unit(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        if self.unit == Unit::Unknown {
            self.unit = Unit::Asked;
            self.script.begin(now_ns, vec![Step::optional(Command::read(3))], actions);
        }
    }

    /// Takes a valid measurement frame and returns whether it is a sample of the stream.
    pub fn measured(&mut self, now_ns: u64, measurement: &Measurement, actions: &mut Vec<Action>) -> bool {
        let kind = measurement.kind;
        match &mut self.phase {
            Phase::Streaming => {}
            // A valid frame determines the baud rate even if the sensor does not answer.
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
        // The flash may hold the very message that is recorded: then only the missing count indicates a reset.
        if is_other || (self.numbered && measurement.sync_count.is_none()) {
            self.foreign(now_ns, kind, actions);
            return false;
        }
        self.numbered |= self.counted && measurement.sync_count.is_some();
        self.last_sample_ns = now_ns;
        self.rejected_since_sample = 0;
        self.foreign_since_ns = None;
        self.unit = Unit::Known;
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

    /// Accepts an ASCII message of another type than in register 6 as the stream at once, while the output is kept and
    /// nothing has arrived yet. No sample of a recording that is played is lost.
    pub(super) fn adopt(&mut self, kind: MeasurementKind, actions: &mut Vec<Action>) -> bool {
        let binary_on = [75, 76, 77].into_iter().any(|register| self.binary_output(register).is_some());
        if self.options.output != Output::Keep || self.flowing || is_binary(kind) || binary_on {
            return false;
        }
        let Some((_, rate_hz)) = self.accepted else { return false };
        self.accept(kind, rate_hz, actions);
        true
    }

    /// Handles frames of another kind. A sensor that was reset sends the output in its flash: after a moment without
    /// samples its output is configured again.
    pub(super) fn foreign(&mut self, now_ns: u64, kind: MeasurementKind, actions: &mut Vec<Action>) {
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
        // Messages have no clock that shows a reset; the time of a boot before them does.
        let silence = RateDoubt::Open(since_ns.saturating_sub(self.last_sample_ns));
        let was_reset = self.options.output == Output::Keep
            && !is_binary(kind)
            && self.accepted.is_some_and(|(accepted, rate_hz)| accepted != kind && silence.is_reset(rate_hz, rate_hz));
        let cause = if was_reset { GapCause::SensorReset } else { GapCause::FormatChange };
        actions.push(RecorderAction::Interrupt(cause).into());
        if was_reset {
            let message = format!("{message} after a silence, as if it had been reset");
            actions.push(RecorderAction::Event(EventKind::SensorReset, message).into());
        }
        if self.options.output == Output::Keep {
            actions.push(RecorderAction::Event(EventKind::Reconfigured, message).into());
            // Its output contradicts the count that its registers stated.
            COUNT_REGISTERS.iter().for_each(|register| drop(self.registers.remove(register)));
            self.measure(now_ns);
        } else {
            actions.push(
                RecorderAction::Event(EventKind::Reconfigured, format!("{message}: its output is configured again"))
                    .into(),
            );
            self.identify(now_ns, actions);
        }
    }

    /// Returns the silence in ns after which the state is `stalled`.
    pub(super) fn stall_ns(&self) -> u64 {
        let period = self.accepted.map_or(0.0, |(_, rate_hz)| period_ns(rate_hz));
        (STALL_NS.max(STALL_PERIODS * period) as u64).max(self.options.host_jitter_ns)
    }

    /// Returns the silence in ns after which the port is closed and opened again. Bytes that form no frame require
    /// another baud rate.
    pub(super) fn reopen_ns(&self) -> u64 {
        let period = self.accepted.map_or(0.0, |(_, rate_hz)| period_ns(rate_hz));
        let garbled = self.status.state == SensorState::NoValidFrames;
        let (least, periods) = if garbled { (GARBLED_NS, 2.0) } else { (REOPEN_NS, 5.0) };
        (least.max(periods * STALL_PERIODS * period) as u64).max(2 * self.options.host_jitter_ns)
    }

    /// Handles the answer of a sensor that was probed while it streams or after it fell silent. Another sensor than
    /// before is identified from the beginning.
    pub(super) fn recognise(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let found = self.script.read().get(&3).cloned();
        if found.is_some() {
            self.unit = Unit::Known;
        }
        if found.is_some() && self.status.serial_number.is_some() && found != self.status.serial_number {
            actions.push(RecorderAction::Interrupt(GapCause::Silent).into());
            self.identify(now_ns, actions);
        } else if let Some(doubt) = self.doubt.take() {
            self.look_again(now_ns, doubt, actions);
        }
    }

    /// Accepts the sensor's output as its registers describe it; if they do not, it listens first.
    pub(super) fn begin_keeping(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        match self.kept_output() {
            Some((kind, rate_hz)) => self.stream(now_ns, kind, rate_hz, actions),
            None => self.measure(now_ns),
        }
    }

    /// Returns the output of a sensor whose output is kept, as its registers describe it.
    pub(super) fn kept_output(&self) -> Option<(MeasurementKind, f64)> {
        [75, 76, 77].into_iter().find_map(|register| self.binary_output(register)).or_else(|| self.ascii_output())
    }

    /// Returns whether more bytes were rejected since the last sample than those of one frame that was cut.
    fn is_garbled(&self) -> bool {
        let frame = self.accepted.map_or(0, |(kind, _)| frame_bytes(&kind, &FrameOptions::default()));
        self.rejected_since_sample > frame
    }

    pub(super) fn measure(&mut self, now_ns: u64) {
        self.flowing = false;
        self.script.clear();
        self.phase = Phase::Measuring {
            until_ns: now_ns + MEASURE_NS.max(self.options.host_jitter_ns),
            meter: RateMeter::default(),
        };
    }

    pub(super) fn rate_measured(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let Phase::Measuring { meter, .. } = &self.phase else { return };
        match meter.result() {
            Some((kind, rate_hz)) => self.stream(now_ns, kind, rate_hz, actions),
            None => {
                let hint = "the sensor sends no measurements: its outputs are off, and the configuration says to keep them (`output = \"keep\"`)";
                self.fail(now_ns, SensorState::Stalled, hint.to_owned(), actions);
            }
        }
    }

    pub(super) fn stream(&mut self, now_ns: u64, kind: MeasurementKind, rate_hz: f64, actions: &mut Vec<Action>) {
        self.script.clear();
        self.phase = Phase::Streaming;
        (self.flowing, self.numbered) = (false, false);
        self.unit = Unit::Known;
        self.last_sample_ns = now_ns;
        self.rejected_since_sample = 0;
        self.doubt = None;
        self.foreign_since_ns = None;
        self.accept(kind, rate_hz, actions);
        let unit = self.status.serial_number.as_deref().unwrap_or("unknown");
        let model = self.status.model.as_deref().unwrap_or("sensor of unknown model");
        let message = format!(
            "{model}, serial number {unit}, on {} at {} baud sends {kind} at {rate_hz} Hz",
            self.status.port.as_deref().unwrap_or("?"),
            self.status.baud.unwrap_or(0),
        );
        actions.push(RecorderAction::Event(EventKind::SensorFound, message).into());
        if let Some(hint) = self.latency.hint() {
            actions.push(RecorderAction::Event(EventKind::Warning, hint).into());
        }
    }

    pub(super) fn accept(&mut self, kind: MeasurementKind, rate_hz: f64, actions: &mut Vec<Action>) {
        self.accepted = Some((kind, rate_hz));
        self.status.rate_hz = Some(rate_hz);
        self.status.output = Some(kind.to_string());
        let description = describe(&self.status, &self.registers, &self.previous, self.latency, kind, rate_hz);
        actions.push(RecorderAction::Describe(description).into());
        self.counted = self.is_counted(kind, rate_hz);
        actions.push(RecorderAction::Counted(self.counted).into());
        actions.push(RecorderAction::Accept(kind, rate_hz).into());
    }

    /// Handles silence while streaming.
    pub(super) fn listen(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let silence_ns = now_ns.saturating_sub(self.last_sample_ns);
        if self.unit == Unit::Asked {
            self.script.tick(now_ns, actions);
            if self.script.is_done() {
                // What has arrived is taken next.
                (self.unit, self.last_sample_ns) = (Unit::Known, now_ns);
            }
        } else if silence_ns >= self.reopen_ns() {
            let (cause, message) = if self.is_garbled() {
                (
                    GapCause::Checksum,
                    "bytes arrive, but no valid frame: the port is opened again and its baud rate looked for",
                )
            } else {
                (GapCause::Silent, "the sensor is silent: the port is opened again")
            };
            actions.push(RecorderAction::Interrupt(cause).into());
            actions.push(RecorderAction::Event(EventKind::SensorLost, message.to_owned()).into());
            self.flowing = false;
            self.script.clear();
            actions.push(Action::Close);
            self.wait(now_ns, SensorState::Stalled);
        } else if silence_ns >= self.stall_ns()
            && !matches!(self.status.state, SensorState::Stalled | SensorState::NoValidFrames)
        {
            if self.is_garbled() {
                self.set_state(SensorState::NoValidFrames, Some("bytes arrive, but no valid frame".to_owned()));
                actions.push(RecorderAction::AcceptAny.into());
            } else {
                self.set_state(SensorState::Stalled, Some("the port is open, but nothing arrives".to_owned()));
            }
            if self.options.output == Output::Keep && self.status.serial_number.is_some() {
                self.unit = Unit::Unknown;
            }
            // A sensor that answers is alive; an output that was paused resumes.
            let mut steps = vec![Step::optional(Command::read(1)), Step::optional(Command::read(3))];
            if self.options.output != Output::Keep {
                steps.insert(0, Step::optional(Command::AsyncOutput(true)));
            }
            self.script.begin(now_ns, steps, actions);
        } else {
            self.script.tick(now_ns, actions);
        }
    }
}
