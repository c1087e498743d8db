//! Connecting: finds a sensor that answers among the names of ports, and starts again when it disappears. Pure.

use super::super::port::{Latency, OpenError};
use super::{
    Action, Command, EventKind, GapCause, LOOK_NS, Output, Phase, Port, RecorderAction, SensorState, Session, Step,
};
use std::time::Duration;

/// The time to listen at a baud rate before the next one is tried, ns.
const SCAN_NS: u64 = 600_000_000;
/// How long a known sensor may be silent behind a port that just opened, ns: it boots for about 1.25 s.
const BOOT_NS: u64 = 2_000_000_000;
/// The longest delay if only a sign of the right sensor is missing: it must stream within 3 s of it.
const SILENT_WAIT: Duration = Duration::from_secs(1);

impl Session {
    pub(super) fn found(&mut self, ports: Vec<Port>, actions: &mut Vec<Action>) {
        let waiting = matches!(self.phase, Phase::Backoff { .. }) && ports != self.ports;
        if !(waiting || self.phase == Phase::Absent) || self.stopping {
            return;
        }
        self.phase = Phase::Absent;
        if ports != self.ports {
            self.ports = ports;
            self.port_index = 0;
            self.failed_ports = 0;
            self.backoff.reset();
        }
        let Some(port) = self.ports.get(self.port_index % self.ports.len().max(1)) else {
            let hint = "no serial port is there: plug the sensor in, it is looked for all the time";
            self.set_state(SensorState::Absent, Some(hint.to_owned()));
            return;
        };
        let path = port.path.clone();
        self.status.port = Some(path.display().to_string());
        self.status.port_target = Some(port.target.display().to_string());
        if self.failed_ports == 0 {
            self.set_state(SensorState::Opening, None);
        }
        self.phase = Phase::Opening;
        let baud = self.scan_list().first().copied().unwrap_or(115_200);
        actions.push(Action::Open(path, baud));
    }

    /// Returns the baud rates in the order to try: the last good one comes first.
    fn bauds(&self) -> Vec<u32> {
        let mut bauds = self.options.bauds.clone();
        if let Some(good) = self.last_good_baud {
            bauds.retain(|baud| *baud != good);
            bauds.insert(0, good);
        }
        bauds
    }

    pub(super) fn opened(&mut self, now_ns: u64, latency: Latency, actions: &mut Vec<Action>) {
        if self.stopping {
            self.end(actions);
            return;
        }
        self.latency = latency;
        self.registers.clear();
        self.received_any = false;
        self.good_is_garbled = false;
        if self.failed_ports == 0 {
            self.set_state(SensorState::Probing, None);
        }
        self.scan(now_ns, 0, actions);
    }

    /// Returns the baud rates in the order to listen to them. A known sensor that is silent will most likely use its
    /// previous rate: that rate has every other turn.
    fn scan_list(&self) -> Vec<u32> {
        let bauds = self.bauds();
        match (self.last_good_baud, bauds.split_first()) {
            (Some(_), Some((good, others))) if !others.is_empty() => {
                others.iter().flat_map(|other| [*good, *other]).chain([*good]).collect()
            }
            _ => bauds,
        }
    }

    fn scan(&mut self, now_ns: u64, index: usize, actions: &mut Vec<Action>) {
        self.status.baud = self.scan_list().get(index).copied();
        self.phase = Phase::Scanning { index, since_ns: now_ns, received: false, valid: false };
        self.ask(now_ns, actions);
    }

    /// Sends a probe, and a second one if there is no answer.
    pub(super) fn ask(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let who = Step::optional(Command::read(1));
        self.script.begin(now_ns, vec![who.clone(), who], actions);
    }

    /// Handles the first bytes at a baud rate: it takes [`SCAN_NS`] from now on to determine whether they are frames.
    pub(super) fn received(&mut self, now_ns: u64) {
        if let Phase::Scanning { since_ns, received, .. } = &mut self.phase
            && !std::mem::replace(received, true)
        {
            *since_ns = now_ns;
        }
    }

    /// Returns the time of the next baud rate's turn, ns.
    pub(super) fn scan_end_ns(&self) -> u64 {
        let Phase::Scanning { index, since_ns, received, .. } = self.phase else { return u64::MAX };
        let booting = index == 0 && !received && self.last_good_baud.is_some();
        let patience_ns = if booting { BOOT_NS } else { SCAN_NS };
        since_ns + patience_ns.max(2 * self.options.host_jitter_ns)
    }

    /// Moves on after a baud rate without an answer.
    pub(super) fn scan_next(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let Phase::Scanning { index, valid, .. } = self.phase else { return };
        if valid {
            if self.options.output == Output::Keep {
                self.last_good_baud = self.status.baud;
                // A sensor that never answers is recorded as it is. One that answered before may be another unit now.
                match &self.expected_serial {
                    Some(_) => self.identify(now_ns, actions),
                    None => self.measure(now_ns),
                }
            } else {
                let hint = "the sensor sends but does not answer commands: check the line from the host to the sensor, or set `output = \"keep\"` to record what it sends";
                self.fail(now_ns, SensorState::Backoff, hint.to_owned(), actions);
            }
            return;
        }
        // A sensor that sends, but not at the last good rate, uses another one.
        let spoke = matches!(self.phase, Phase::Scanning { received: true, .. });
        self.good_is_garbled |= spoke && self.status.baud == self.last_good_baud;
        let step = if self.good_is_garbled && index % 2 == 1 { 2 } else { 1 };
        if let Some(baud) = self.scan_list().get(index + step) {
            actions.push(Action::SetBaud(*baud));
            self.scan(now_ns, index + step, actions);
        } else if self.received_any {
            let tried = self.bauds().iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
            let hint = format!(
                "bytes arrive, but no valid frame at any of the baud rates {tried}: is this a VN-100, and is its baud rate among these?"
            );
            self.fail(now_ns, SensorState::NoValidFrames, hint, actions);
        } else {
            let hint = "the port opens, but nothing answers at any baud rate: check power and cable (port 1 of the Rugged is RS-232, port 2 is 3 V TTL)";
            self.fail(now_ns, SensorState::Stalled, hint.to_owned(), actions);
        }
    }

    pub(super) fn open_failed(&mut self, now_ns: u64, error: &OpenError, actions: &mut Vec<Action>) {
        if self.stopping {
            self.end(actions);
            return;
        }
        let state = match error {
            OpenError::Gone { .. } => SensorState::Absent,
            OpenError::Busy { .. } => SensorState::PortBusy,
            OpenError::Permission { .. } => SensorState::NoPermission,
            OpenError::Other { .. } => SensorState::Backoff,
        };
        self.fail(now_ns, state, error.to_string(), actions);
    }

    /// Handles a failed attempt: reports it once, closes the port, and waits. With several ports the next one is tried
    /// first.
    pub(super) fn fail(&mut self, now_ns: u64, state: SensorState, hint: String, actions: &mut Vec<Action>) {
        self.script.clear();
        self.failed_ports += 1;
        self.port_index += 1;
        actions.push(Action::Close);
        if self.status.hint.as_ref() != Some(&hint) {
            actions.push(RecorderAction::Event(EventKind::Warning, hint.clone()).into());
        }
        self.set_state(state, Some(hint));
        if state == SensorState::Absent {
            self.phase = Phase::Absent;
            self.next_look_ns = now_ns + LOOK_NS;
        } else if !self.failed_ports.is_multiple_of(self.ports.len().max(1)) {
            self.phase = Phase::Absent;
            self.next_look_ns = now_ns;
        } else {
            self.wait(now_ns, state);
        }
    }

    /// Waits before the next attempt; the delay depends on the previous failures and on the expected outcome of the
    /// next attempt.
    pub(super) fn wait(&mut self, now_ns: u64, state: SensorState) {
        let most = match state {
            SensorState::Stalled if self.last_good_baud.is_some() => SILENT_WAIT,
            SensorState::WrongUnit => SILENT_WAIT,
            _ => super::super::backoff::LONGEST,
        };
        let wait = self.backoff.next(&mut self.random).min(most);
        self.phase = Phase::Backoff { until_ns: now_ns + wait.as_nanos() as u64 };
        self.next_look_ns = now_ns + LOOK_NS;
    }

    pub(super) fn disconnected(&mut self, now_ns: u64, reason: &str, actions: &mut Vec<Action>) {
        if self.stopping {
            self.end(actions);
            return;
        }
        actions.push(RecorderAction::Interrupt(GapCause::Unplugged).into());
        if !self.flowing {
            // The port closed before a sample arrived: a port that does this repeatedly must not consume a core.
            self.fail(now_ns, SensorState::Backoff, format!("the port closed at once: {reason}"), actions);
            return;
        }
        self.flowing = false;
        self.script.clear();
        let port = self.status.port.clone().unwrap_or_default();
        actions.push(RecorderAction::Event(EventKind::SensorLost, format!("{port} is gone: {reason}")).into());
        actions.push(Action::Close);
        self.set_state(
            SensorState::Absent,
            Some(format!("{port} is gone: plug the sensor in, it is looked for all the time")),
        );
        self.phase = Phase::Absent;
        // The kernel releases the name only once the port is closed.
        self.next_look_ns = now_ns + LOOK_NS / 5;
    }
}
