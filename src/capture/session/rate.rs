//! Rate: reads the sensor's registers if samples without time do not arrive at the known rate. Pure.

use super::configure::COUNT_REGISTERS;
use super::{
    Action, Command, EventKind, GapCause, Output, Phase, RateDoubt, RecorderAction, SensorState, Session, Step,
};
use imu_core::sample::accounting::DOUBT_AGAIN_NS;

/// The registers that select baud rate, message, rate and binary output, read again on a doubt, with the serial number.
const RATE_REGISTERS: [u16; 5] = [3, 5, 6, 7, 75];
/// The minimum interval between queries, ns, if arrivals stay irregular although the registers are right. An undecided doubt is
/// raised a little less often; all of these are answered.
const DOUBT_EVERY_NS: u64 = DOUBT_AGAIN_NS / 20 * 19;

impl Session {
    /// Handles samples without time that do not arrive at the rate: the registers are read again.
    pub(super) fn rate_doubted(&mut self, now_ns: u64, doubt: RateDoubt, actions: &mut Vec<Action>) {
        if self.phase != Phase::Streaming || (matches!(doubt, RateDoubt::Open(_)) && now_ns < self.next_doubt_ns) {
            return;
        }
        self.next_doubt_ns = now_ns + DOUBT_EVERY_NS;
        self.doubt = Some(doubt);
        let registers = RATE_REGISTERS.into_iter().chain(COUNT_REGISTERS);
        let steps = registers.map(|register| Step::optional(Command::read(register))).collect();
        self.script.begin(now_ns, steps, actions);
    }

    /// Handles the registers that were read again. A sensor that was reset or reconfigured is configured again. A
    /// sensor whose output is kept is accepted as it is now.
    pub(super) fn look_again(&mut self, now_ns: u64, doubt: RateDoubt, actions: &mut Vec<Action>) {
        let read = self.script.read().clone();
        let Some((kind, rate_hz)) = self.accepted else { return };
        if !(read.contains_key(&7) && read.contains_key(&75)) {
            // The sensor does not answer: its arrivals alone decide.
            return;
        }
        self.registers.extend(read);
        let sends = match self.options.output {
            Output::Keep => self.kept_output(),
            Output::Binary { .. } => self.binary_output(75),
            Output::Ascii { .. } => self.ascii_output().filter(|_| self.binary_output(75).is_none()),
        };
        if sends == Some((kind, rate_hz)) && self.is_counted(kind, rate_hz) == self.counted {
            actions.push(match doubt {
                RateDoubt::Open(_) => RecorderAction::RateKnown(rate_hz),
                RateDoubt::Changed(_) => RecorderAction::Event(
                    EventKind::Warning,
                    format!("the sensor's registers say that it sends {kind} at {rate_hz} Hz, but it does not come at that rate"),
                ),
            }.into());
            return;
        }
        let now_hz = sends.filter(|(now, _)| *now == kind).map(|(_, now_hz)| now_hz);
        actions.extend(now_hz.map(|rate_hz| RecorderAction::RateKnown(rate_hz).into()));
        let was_reset = doubt.is_reset(rate_hz, sends.map_or(rate_hz, |(_, now_hz)| now_hz));
        let reset = if was_reset { " after a silence, as if it had been reset" } else { "" };
        let sent = sends.map_or("nothing".to_owned(), |(now, now_hz)| format!("{now} at {now_hz} Hz"));
        let message = format!("the sensor sends {sent} instead of {kind} at {rate_hz} Hz{reset}");
        if was_reset {
            actions.push(RecorderAction::Event(EventKind::SensorReset, message.clone()).into());
        }
        if self.options.output == Output::Keep {
            if let Some(now_hz) = now_hz {
                actions.push(RecorderAction::Event(EventKind::Reconfigured, message).into());
                self.accept(kind, now_hz, actions);
            }
            return;
        }
        self.set_state(SensorState::UnexpectedFormat, Some(message.clone()));
        let cause = if was_reset { GapCause::SensorReset } else { GapCause::RateChange };
        actions.push(RecorderAction::Interrupt(cause).into());
        actions.push(
            RecorderAction::Event(EventKind::Reconfigured, format!("{message}: its output is configured again")).into(),
        );
        self.identify(now_ns, actions);
    }
}
