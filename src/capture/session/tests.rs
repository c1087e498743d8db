//! A session against a sensor that answers from a register file.

use super::*;
use crate::capture::output::ascii_kind;
use crate::capture::port::OpenError;
use proptest::prelude::*;
use rand::SeedableRng;
use std::collections::BTreeMap;
use vn100_proto::{DeviceError, Measurement, Reply};

/// A sensor that answers commands from a register file, as far as the test lets it.
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
    /// The number of times that it was plugged in.
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
                    let port = Port {
                        path: "/dev/ttyUSB0".into(),
                        target: "/dev/ttyUSB0".into(),
                        node: format!("ttyUSB0 {}", self.plugged),
                    };
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
            vn100_proto::Verb::ReadRegister => match self.sensor.registers.get(&register) {
                Some(text) => {
                    let answer = format!("{body},{text}");
                    self.give(Input::Reply(&Reply::parse(&answer).unwrap()));
                }
                None => self.give(Input::DeviceError(DeviceError::from_code(8))),
            },
            vn100_proto::Verb::WriteRegister => {
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
    assert!(world.seen.contains(&RecorderAction::Accept(default_kind(), 40.0).into()), "{:?}", world.seen);
    assert!(world.sensor.commands.contains(&"VNWRG,75,1,20,01,0609".to_owned()));
    assert!(world.measured(default_kind()));
    assert_eq!(world.state(), SensorState::Streaming);
    assert_eq!(world.session.status().serial_number.as_deref(), Some("0100012345"));
    let described = world.seen.iter().rev().find_map(|action| {
        if let Action::Record(RecorderAction::Describe(value)) = action { Some(value) } else { None }
    });
    let described = described.unwrap();
    assert_eq!(described.filter_window.unwrap().windows.gyro, 4);
    assert!(!described.registers.contains_key(&44), "a refused register is absent");
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
    assert!(world.seen.contains(&RecorderAction::Accept(ymr, 40.0).into()));
    assert!(world.measured(ymr));
    world.give(Input::Stop);
    assert!(world.sensor.commands.iter().all(|command| command.starts_with("VNRRG")), "{:?}", world.sensor.commands);
}

#[test]
fn kept_output_of_another_type_than_the_registers_state_is_taken_from_its_first_line() {
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
    assert!(world.seen.contains(&RecorderAction::Accept(ymr, 40.0).into()), "{:?}", world.seen);
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
    assert!(world.seen.contains(&RecorderAction::Interrupt(GapCause::Silent).into()));
    assert!(world.opens >= 2);
}

#[test]
fn a_host_that_stood_still_does_not_take_its_own_absence_for_the_sensors_silence() {
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
    assert!(world.seen.contains(&RecorderAction::Counted(true).into()), "{:?}", world.seen);
    for count in 0..80 {
        world.pass(25_000_000);
        assert!(world.numbered(ymr, Some(count)));
    }
    // A single line without the count is damage or a slip, no reset.
    assert!(!world.measured(ymr));
    world.pass(25_000_000);
    assert!(world.numbered(ymr, Some(81)));
    assert_eq!(world.state(), SensorState::Streaming);
    world.seen.clear();
    world.sensor.registers = Sensor::new().registers;
    world.sensor.registers.extend(flash);
    let begun = world.now_ns;
    while !world.seen.contains(&RecorderAction::Accept(ymr, 40.0).into()) {
        world.pass(25_000_000);
        assert!(!world.measured(ymr), "no sample of the reset sensor passes for one that is counted");
        assert!(world.now_ns - begun < 2_000_000_000);
    }
    assert!(world.seen.contains(&RecorderAction::Interrupt(GapCause::FormatChange).into()) && world.opens == 1);
    assert!(world.sensor.registers[&30].starts_with("3,"), "{:?}", world.sensor.registers);
    assert!(world.numbered(ymr, Some(1)));
}

/// If the output is kept, messages without their count continue by their arrival.
#[test]
fn a_kept_count_that_vanishes_is_no_longer_relied_upon() {
    let ymr = ascii_kind(14).unwrap();
    let mut world = World::new(Output::Keep);
    world.sensor.registers.insert(30, "3,0,0,0,1,0,1".to_owned());
    world.sensor.registers.insert(32, "3,0,0,0,1,1,19,100000000,0".to_owned());
    world.pass(1_000_000_000);
    assert!(world.seen.contains(&RecorderAction::Counted(true).into()), "{:?}", world.seen);
    assert!(world.numbered(ymr, Some(7)));
    world.seen.clear();
    for _ in 0..120 {
        world.pass(25_000_000);
        world.measured(ymr);
    }
    assert!(world.seen.contains(&RecorderAction::Counted(false).into()), "{:?}", world.seen);
    assert!(world.measured(ymr) && world.state() == SensorState::Streaming);
}

/// A kept binary output whose sensor is reset to the messages in its flash.
#[test]
fn a_kept_binary_output_that_becomes_messages_after_a_boot_was_reset() {
    let ymr = ascii_kind(14).unwrap();
    for (silence_ns, cause) in [(30_000_000, GapCause::FormatChange), (1_250_000_000, GapCause::SensorReset)] {
        let mut world = World::new(Output::Keep);
        world.sensor.registers.insert(6, "0".to_owned());
        world.sensor.registers.insert(75, "1,20,01,0609".to_owned());
        world.pass(1_000_000_000);
        for _ in 0..40 {
            world.pass(25_000_000);
            assert!(world.measured(default_kind()), "{:?}", world.seen);
        }
        world.pass(silence_ns);
        for _ in 0..120 {
            world.measured(ymr);
            world.pass(25_000_000);
        }
        assert!(world.seen.contains(&RecorderAction::Interrupt(cause).into()), "{silence_ns}: {:?}", world.seen);
        let is_reset =
            |action: &Action| matches!(action, Action::Record(RecorderAction::Event(EventKind::SensorReset, _)));
        assert_eq!(
            world.seen.iter().filter(|action| is_reset(action)).count(),
            usize::from(silence_ns > 1_000_000_000)
        );
    }
}

#[test]
fn another_unit_is_refused_and_reported() {
    let mut world = World::new(default_output());
    world.give(Input::Expect(Some("0100099999".to_owned())));
    world.pass(2_000_000_000);
    assert_eq!(world.state(), SensorState::WrongUnit);
    assert!(world.session.status().hint.as_ref().unwrap().contains("0100012345"));
    assert!(!world.seen.iter().any(|action| matches!(action, Action::Record(RecorderAction::Accept(..)))));
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
    assert!(world.seen.contains(&RecorderAction::Accept(default_kind(), 40.0).into()));
}

#[test]
fn a_port_that_is_plugged_in_again_ends_any_wait() {
    let mut world = World::new(default_output());
    world.sensor.answers = false;
    world.pass(120_000_000_000);
    assert_eq!(world.state(), SensorState::Stalled);
    // The sensor is unplugged while no session has it open, and plugged in again.
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

    // A sensor that uses another rate is not tried at the last good one again and again.
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

/// The line is given to another unit without closing the port.
#[test]
fn what_a_kept_unit_sends_after_a_silence_waits_for_its_serial_number() {
    let ymr = ascii_kind(14).unwrap();
    let arrives = |world: &mut World| {
        assert!(world.session.is_unit_unknown());
        let mut actions = Vec::new();
        world.session.await_unit(world.now_ns, &mut actions);
        world.perform(actions);
    };
    for silence_ns in [1_100_000_000, 3_500_000_000, 4_900_000_000] {
        for serial in [Some("0100012345"), Some("0100099999"), None] {
            let mut world = World::new(Output::Keep);
            world.give(Input::Expect(Some("0100012345".to_owned())));
            world.pass(1_000_000_000);
            assert!(world.measured(ymr) && !world.session.is_unit_unknown());
            world.sensor.answers = false;
            world.pass(silence_ns);
            assert_eq!(world.state(), SensorState::Stalled);
            if let Some(serial) = serial {
                world.sensor.registers.insert(3, serial.to_owned());
                world.sensor.answers = true;
                arrives(&mut world);
                assert!(!world.session.is_unit_unknown());
                assert_eq!(world.measured(ymr), serial == "0100012345");
            } else {
                // What does not answer is the unit of before, after a while; the port stays open meanwhile.
                arrives(&mut world);
                world.pass(1_000_000_000);
                assert!(world.session.is_unit_unknown());
                world.pass(600_000_000);
                assert!(!world.session.is_unit_unknown() && world.measured(ymr));
            }
        }
    }
    // A line that carries nothing to the sensor: nothing is known of its unit.
    let mut world = World::new(Output::Keep);
    world.sensor.answers = false;
    for _ in 0..200 {
        world.pass(25_000_000);
        world.measured(ymr);
    }
    world.pass(1_100_000_000);
    assert!(!world.session.is_unit_unknown());
}

/// A unit whose serial number was read before is asked for it again, also if it sends before it answers.
#[test]
fn another_unit_that_sends_before_it_answers_is_noticed_where_the_output_is_kept() {
    let ymr = ascii_kind(14).unwrap();
    let mut world = World::new(Output::Keep);
    world.give(Input::Expect(Some("0100012345".to_owned())));
    world.pass(1_000_000_000);
    assert!(world.measured(ymr));
    let swapped = |world: &mut World, serial: &str| {
        world.give(Input::Disconnected("gone".to_owned()));
        world.plugged += 1;
        world.sensor.registers.insert(3, serial.to_owned());
        world.sensor.answers = false;
        let mut taken = 0;
        for step in 0..240 {
            world.pass(25_000_000);
            taken += usize::from(world.measured(ymr));
            // The probes at a baud rate are not answered; the next command is.
            world.sensor.answers = matches!(world.session.phase, Phase::Identifying | Phase::Describing) || step > 60;
        }
        taken
    };
    for _ in 0..2 {
        assert_eq!(swapped(&mut world, "0100099999"), 0);
        assert_eq!(world.state(), SensorState::WrongUnit);
        assert!(swapped(&mut world, "0100012345") > 0);
        assert_eq!(world.session.status().serial_number.as_deref(), Some("0100012345"));
    }
}

/// A line that carries nothing to the sensor any more is recorded, without the serial number of before.
#[test]
fn a_kept_output_that_is_no_longer_answered_goes_on_without_its_serial_number() {
    let ymr = ascii_kind(14).unwrap();
    let mut world = World::new(Output::Keep);
    world.give(Input::Expect(Some("0100012345".to_owned())));
    world.pass(1_000_000_000);
    assert!(world.measured(ymr));
    world.give(Input::Disconnected("gone".to_owned()));
    world.plugged += 1;
    world.sensor.answers = false;
    let taken = (0..400).filter(|_| {
        world.pass(25_000_000);
        world.measured(ymr)
    });
    assert!(taken.count() > 100);
    assert_eq!(world.session.status().serial_number, None);
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
    /// In every sequence of events the port is never opened twice (checked in the world), and the sensor streams within
    /// 12 s once all faults have passed.
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

/// A sensor whose output was switched off answers the probe; a noisy line does not.
#[test]
fn replies_to_a_probe_are_no_garbage() {
    for (garbage, cause) in [(0, GapCause::Silent), (40, GapCause::Silent), (400, GapCause::Checksum)] {
        let mut world = World::new(default_output());
        world.pass(1_000_000_000);
        world.measured(default_kind());
        // The sensor fell silent within a frame; the decoder rejects that frame once more bytes come.
        world.give(Input::Rejected(garbage));
        for _ in 0..40 {
            world.give(Input::Bytes(30));
            world.pass(200_000_000);
        }
        assert!(world.seen.contains(&RecorderAction::Interrupt(cause).into()), "{garbage}: {:?}", world.seen);
    }
}

/// The sensor sends at a rate that was not configured, or was reset to the settings in its flash: the registers decide.
#[test]
fn a_doubt_about_the_rate_is_answered_by_the_registers() {
    let ymr = ascii_kind(14).unwrap();
    const MS: u64 = 1_000_000;
    // The rates before and after, the silence before the samples in doubt, and the cause. A boot is half a second longer than
    // the longer period.
    for (rate_hz, sent_hz, silence_ms, cause) in [
        (50, 40, 20, GapCause::RateChange),
        (50, 40, 1250, GapCause::SensorReset),
        (2, 4, 1250, GapCause::SensorReset),
        (2, 1, 1250, GapCause::RateChange),
        (50, 1, 2000, GapCause::SensorReset),
        (50, 1, 1000, GapCause::RateChange),
    ] {
        let mut world = World::new(Output::Ascii { number: 14, rate_hz });
        world.pass(1_000_000_000);
        world.measured(ymr);
        world.give(Input::RateDoubted(RateDoubt::Open(0)));
        assert_eq!(world.seen.last(), Some(&RecorderAction::RateKnown(f64::from(rate_hz)).into()), "as configured");
        for _ in 0..6 * rate_hz {
            world.pass(1000 * MS / u64::from(rate_hz));
            world.measured(ymr);
        }
        world.pass(silence_ms * MS);
        world.measured(ymr);
        world.sensor.registers.insert(7, sent_hz.to_string());
        world.give(Input::RateDoubted(RateDoubt::Open(silence_ms * MS)));
        world.pass(500_000_000);
        let position =
            |action: RecorderAction| world.seen.iter().position(|seen| *seen == action.clone().into()).unwrap();
        let known = position(RecorderAction::RateKnown(f64::from(sent_hz)));
        assert!(known < position(RecorderAction::Interrupt(cause)), "{rate_hz} to {sent_hz} Hz after {silence_ms} ms");
        assert_eq!(world.sensor.registers[&7], rate_hz.to_string(), "configured again");
        let again = world.seen.iter().rev().find(|action| matches!(action, Action::Record(RecorderAction::Accept(..))));
        assert_eq!(again, Some(&RecorderAction::Accept(ymr, f64::from(rate_hz)).into()));
    }
    let mut world = World::new(Output::Keep);
    world.pass(1_000_000_000);
    world.measured(ymr);
    world.sensor.registers.insert(7, "100".to_owned());
    world.give(Input::RateDoubted(RateDoubt::Changed(0)));
    assert!(
        world.seen.ends_with(&[RecorderAction::Counted(false).into(), RecorderAction::Accept(ymr, 100.0).into()]),
        "{:?}",
        world.seen
    );
    assert!(world.sensor.commands.iter().all(|command| command.starts_with("VNRRG")), "nothing is written");
}
