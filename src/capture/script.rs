//! Script: sends commands to the sensor, one after the other. Each is answered, refused or abandoned. Pure.

use super::action::Action;
use std::collections::{BTreeMap, VecDeque};
use vn100_proto::{ChecksumKind, Command, DeviceError, Reply, Verb};

/// The time limit for an answer, ns. A reply of 100 characters at 9600 baud behind a full output buffer of the sensor
/// takes 2.2 s; at common rates it arrives within 20 ms.
pub const ANSWER_NS: u64 = 500_000_000;
/// The number of attempts before a command is abandoned.
pub const TRIES: u32 = 3;
/// After this many optional commands in succession without any answer the remaining optional ones are not sent.
const SILENT_MAX: u32 = 2;

/// One command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// The command; no command here can write the sensor's flash.
    pub command: Command,
    /// Whether the script fails without its answer.
    pub required: bool,
}

impl Step {
    /// Returns a command that the script fails without.
    pub fn required(command: Command) -> Self {
        Self { command, required: true }
    }
    /// Returns a command whose refusal or silence does no harm.
    pub fn optional(command: Command) -> Self {
        Self { command, required: false }
    }
}

/// Commands in order, with their results.
#[derive(Debug, Clone, Default)]
pub struct Script {
    steps: VecDeque<Step>,
    /// The time limit for an answer, ns.
    patience_ns: u64,
    sent_ns: Option<u64>,
    tries: u32,
    silent: u32,
    read: BTreeMap<u16, String>,
    refused: BTreeMap<String, DeviceError>,
    failure: Option<String>,
}

impl Script {
    /// Returns a script without commands. The time limit for answers is [`ANSWER_NS`], or `host_jitter_ns` if that is
    /// longer.
    pub fn patient(host_jitter_ns: u64) -> Self {
        Self { patience_ns: ANSWER_NS.max(host_jitter_ns), ..Self::default() }
    }
    /// Begins a new script and sends its first command.
    pub fn begin(&mut self, now_ns: u64, steps: Vec<Step>, actions: &mut Vec<Action>) {
        *self = Self { steps: steps.into(), ..Self::patient(self.patience_ns) };
        self.send(now_ns, actions);
    }
    /// Clears the script and its results.
    pub fn clear(&mut self) {
        *self = Self::patient(self.patience_ns);
    }
    /// Returns whether every command has been answered or abandoned, or a required one failed.
    pub fn is_done(&self) -> bool {
        self.steps.is_empty() || self.failure.is_some()
    }
    /// Returns the cause of a failure.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }
    /// Returns the registers read so far.
    pub fn read(&self) -> &BTreeMap<u16, String> {
        &self.read
    }
    /// Returns the commands that were refused, with the sensor's error.
    pub fn refused(&self) -> &BTreeMap<String, DeviceError> {
        &self.refused
    }
    /// Restarts the time limit for answers: no answer could have been received before.
    pub fn forgive(&mut self, now_ns: u64) {
        self.sent_ns = self.sent_ns.map(|_| now_ns);
    }
    /// Returns the time at which the present command is due, ns.
    pub fn deadline_ns(&self) -> u64 {
        self.sent_ns.filter(|_| !self.is_done()).map_or(u64::MAX, |sent| sent + self.patience_ns)
    }

    fn send(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        if let Some(step) = self.steps.front().filter(|_| self.failure.is_none()) {
            self.sent_ns = Some(now_ns);
            self.tries += 1;
            actions.push(Action::Send(step.command.to_bytes(ChecksumKind::Xor8)));
        } else {
            self.sent_ns = None;
        }
    }

    fn next(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        self.steps.pop_front();
        self.tries = 0;
        self.send(now_ns, actions);
    }

    /// Sends a command again whose answer is overdue, or abandons it.
    pub fn tick(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        if now_ns < self.deadline_ns() || self.is_done() {
            return;
        }
        let Some(step) = self.steps.front() else { return };
        if self.tries < TRIES && self.silent < SILENT_MAX {
            self.send(now_ns, actions);
        } else if step.required {
            self.failure = Some(format!("the sensor does not answer `${}`", step.command.body()));
        } else {
            self.silent += 1;
            if self.silent >= SILENT_MAX {
                self.steps.retain(|step| step.required);
                self.tries = 0;
                self.send(now_ns, actions);
            } else {
                self.next(now_ns, actions);
            }
        }
    }

    /// Takes a reply; returns whether it was the expected one.
    pub fn answer(&mut self, now_ns: u64, reply: &Reply<'_>, actions: &mut Vec<Action>) -> bool {
        let Some(step) = self.steps.front().filter(|step| self.sent_ns.is_some() && reply.answers(&step.command))
        else {
            return false;
        };
        if let (Verb::ReadRegister, Command::ReadRegister { register, .. }) = (reply.verb, &step.command) {
            self.read.insert(*register, reply.values.to_owned());
        }
        self.silent = 0;
        self.next(now_ns, actions);
        true
    }

    /// Takes an error of the sensor; returns whether it refuses a waiting command.
    pub fn refuse(&mut self, now_ns: u64, error: DeviceError, actions: &mut Vec<Action>) -> bool {
        let Some(step) = self.steps.front().filter(|_| self.sent_ns.is_some()) else { return false };
        let body = step.command.body();
        if step.required {
            self.failure = Some(format!("the sensor refuses `${body}`: {error}"));
        }
        self.refused.insert(body, error);
        self.silent = 0;
        self.next(now_ns, actions);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(actions: &[Action]) -> Vec<String> {
        actions
            .iter()
            .filter_map(|action| match action {
                Action::Send(bytes) => Some(String::from_utf8_lossy(bytes).into_owned()),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn commands_wait_for_their_answers_and_a_refusal_of_an_optional_one_is_noted() {
        let (mut script, mut actions) = (Script::patient(0), Vec::new());
        let steps = vec![Step::required(Command::read(1)), Step::optional(Command::read(85))];
        script.begin(0, steps, &mut actions);
        assert_eq!(sent(&actions), ["$VNRRG,01*72\r\n"]);
        assert!(!script.answer(1, &Reply::parse("VNRRG,03,x").unwrap(), &mut actions));
        assert!(script.answer(1, &Reply::parse("VNRRG,1,VN-100T").unwrap(), &mut actions));
        assert!(script.refuse(2, DeviceError::from_code(8), &mut actions));
        assert!(script.is_done() && script.failure().is_none());
        assert_eq!(script.read()[&1], "VN-100T");
        assert_eq!(script.refused()["VNRRG,85"], DeviceError::from_code(8));
    }

    #[test]
    fn a_required_command_is_sent_three_times_and_then_fails() {
        let (mut script, mut actions) = (Script::patient(0), Vec::new());
        script.begin(0, vec![Step::required(Command::write(75, "1,20,01,0609"))], &mut actions);
        for turn in 1..=TRIES {
            script.tick(u64::from(turn) * ANSWER_NS, &mut actions);
        }
        assert_eq!(sent(&actions).len(), 3);
        assert!(script.failure().is_some_and(|failure| failure.contains("VNWRG,75")));
    }

    #[test]
    fn a_sensor_that_never_answers_is_not_asked_for_every_register() {
        let (mut script, mut actions) = (Script::patient(0), Vec::new());
        script.begin(0, (20..40).map(|register| Step::optional(Command::read(register))).collect(), &mut actions);
        let mut now_ns = 0;
        while !script.is_done() {
            now_ns += ANSWER_NS;
            script.tick(now_ns, &mut actions);
            assert!(now_ns < 10 * ANSWER_NS);
        }
        assert!(script.failure().is_none());
    }
}
