//! Configuring: makes a sensor that answers send the requested output, and restores its previous output. Pure.

use super::super::output::{ascii_kind, binary_output, check_fit, counts_messages, is_binary, serial_count};
use super::{Action, Command, Output, Phase, SensorState, Session, Step};
use vn100_proto::{ChecksumKind, MeasurementKind};

/// Registers that describe the measurement; if a sensor refuses one, only the description suffers. 0 user tag, 2
/// hardware, 5 baud, 6 and 7 ASCII output, 21 references, 23 magnetic, 25 acceleration, 26 frame rotation, 30
/// communication, 32 synchronisation, 35 VPE, 44 hard/soft iron, 75–77 binary outputs, 82 delta, 83 reference model, 84
/// gyro compensation, 85 filter windows.
const DESCRIPTIVE: [u16; 20] = [5, 6, 7, 75, 76, 77, 85, 30, 0, 2, 21, 23, 25, 26, 32, 35, 44, 82, 83, 84];
/// Registers that select the output; restored in this order.
const OUTPUT_REGISTERS: [u16; 5] = [6, 7, 75, 76, 77];
/// The registers that control the count in messages; they matter only for messages.
pub(super) const COUNT_REGISTERS: [u16; 2] = [30, 32];

impl Session {
    pub(super) fn identify(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
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

    pub(super) fn identified(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let read = self.script.read().clone();
        self.status.model = read.get(&1).cloned().or(self.status.model.take());
        let serial_number = read.get(&3).cloned();
        if let (Some(before), Some(found)) = (&self.previous_of, &serial_number)
            && before != found
        {
            // This is another unit: the previous output of the first one must not be written to it.
            self.previous.clear();
        }
        // A serial number that is missing in one answer does not indicate another unit.
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
        // A line that carries nothing to the sensor: its registers will not be answered either.
        if self.options.output == Output::Keep && self.registers.is_empty() {
            self.measure(now_ns);
            return;
        }
        self.phase = Phase::Describing;
        let steps = DESCRIPTIVE.into_iter().map(|register| Step::optional(Command::read(register))).collect();
        self.script.begin(now_ns, steps, actions);
    }

    pub(super) fn configure(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
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
        // The outputs of the previous configuration would share the line.
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

    /// Returns the commands that make the sensor number its messages, if it does not yet and its SyncOut pin drives
    /// nothing else.
    pub(super) fn counting(&self, rate_hz: f64) -> Vec<Step> {
        let text = |register| self.registers.get(&register).map(String::as_str);
        let (Some(communication), Some(synchronization)) = (text(30), text(32)) else { return Vec::new() };
        serial_count(communication, synchronization, rate_hz)
            .into_iter()
            .map(|(register, values)| Step::optional(Command::write(register, values)))
            .collect()
    }

    /// Returns whether messages at this rate carry a count that increases by one for each, according to registers 30
    /// and 32.
    pub(super) fn is_counted(&self, kind: MeasurementKind, rate_hz: f64) -> bool {
        let text = |register| self.registers.get(&register).map(String::as_str);
        !is_binary(kind)
            && text(30).zip(text(32)).is_some_and(|(communication, synchronization)| {
                counts_messages(communication, synchronization, rate_hz)
            })
    }

    /// Checks whether the wanted output fits the line; the error is the calculation.
    pub(super) fn fits(&self) -> Result<(), String> {
        let (Some(baud), Some((kind, rate_hz))) = (self.status.baud, self.options.output.kind_and_rate()) else {
            return Ok(());
        };
        check_fit(kind, rate_hz, baud)
    }

    pub(super) fn configured(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
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

    pub(super) fn register_text(&self, register: u16) -> &str {
        self.registers.get(&register).map_or("unknown", String::as_str)
    }

    /// Returns the output of binary output register 75, 76 or 77, if it is on.
    pub(super) fn binary_output(&self, register: u16) -> Option<(MeasurementKind, f64)> {
        binary_output(register, self.registers.get(&register)?)
    }

    /// Returns the output of registers 6 and 7, if it is on.
    pub(super) fn ascii_output(&self) -> Option<(MeasurementKind, f64)> {
        let first = |register| self.registers.get(&register)?.split(',').next();
        let kind = ascii_kind(first(6)?.parse().ok()?)?;
        let rate_hz: f64 = first(7)?.parse().ok()?;
        (rate_hz > 0.0).then_some((kind, rate_hz))
    }

    pub(super) fn stop(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
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

    pub(super) fn end(&mut self, actions: &mut Vec<Action>) {
        self.phase = Phase::Ended;
        self.script.clear();
        self.set_state(SensorState::Absent, None);
        actions.push(Action::Close);
        actions.push(Action::Ended);
    }
}
