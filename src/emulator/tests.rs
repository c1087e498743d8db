//! Conversations with the virtual sensor, byte for byte.

use super::{SensorOptions, Values, VirtualSensor};
use imu_core::sample::Channel;
use vn100_proto::register::BinaryOutput;
use vn100_proto::{ChecksumKind, Command, Decoder, DecoderOptions, DeviceError, Event, Measurement, Quantity, encode};

/// Returns the first line of the manual's chapter on registers, for a sensor at rest on a desk.
fn values() -> Values {
    let mut values = [0.0; Channel::COUNT];
    for (channel, value) in [
        (Channel::Yaw, 100.949),
        (Channel::Pitch, -7.33),
        (Channel::Roll, 0.715),
        (Channel::MagX, -0.0049),
        (Channel::MagY, -0.2449),
        (Channel::MagZ, 0.5397),
        (Channel::AccelX, -1.258),
        (Channel::AccelY, -0.1),
        (Channel::AccelZ, -9.701),
        (Channel::GyroX, -1.8e-5),
        (Channel::GyroY, 0.001_122),
        (Channel::GyroZ, -0.000_551),
        (Channel::Temperature, 21.6),
        (Channel::Pressure, 99.761),
    ] {
        values[channel as usize] = value;
    }
    values
}

/// A recorded line (protocol vectors) with exactly these values.
const RECORDED: &str = "$VNYMR,+100.949,-007.330,+000.715,-00.0049,-00.2449,+00.5397,-01.258,-00.100,-09.701,-00.000018,+00.001122,-00.000551*69\r\n";

fn sensor() -> VirtualSensor {
    VirtualSensor::new(&SensorOptions::default())
}

/// Returns a sensor that sends nothing by itself.
fn quiet_sensor() -> VirtualSensor {
    let mut sensor = sensor();
    assert_eq!(ask(&mut sensor, 0, "$VNWRG,06,0*6C\r\n"), "$VNWRG,06,0*6C\r\n");
    sensor
}

/// Returns the immediate reply of the sensor.
fn ask(sensor: &mut VirtualSensor, tick: u64, command: &str) -> String {
    let mut out = Vec::new();
    sensor.on_bytes(tick, command.as_bytes(), &mut out);
    String::from_utf8(out).unwrap()
}

/// Returns the body of the sensor's reply to a command without checksum.
fn bare(sensor: &mut VirtualSensor, tick: u64, body: &str) -> String {
    let reply = ask(sensor, tick, &format!("${body}*XX\r\n"));
    let body = reply.strip_prefix('$').and_then(|line| line.rsplit_once('*'));
    body.map_or(String::new(), |(body, _)| body.to_owned())
}

/// Returns everything that the sensor sends up to and including `until`, with the ticks it requested.
fn run(sensor: &mut VirtualSensor, until: u64) -> (Vec<u64>, Vec<u8>) {
    let (mut ticks, mut out) = (Vec::new(), Vec::new());
    while let Some(tick) = sensor.next_output_tick().filter(|tick| *tick <= until) {
        sensor.emit(tick, &values(), &mut out);
        ticks.push(tick);
    }
    (ticks, out)
}

fn measurements(bytes: &[u8]) -> Vec<Measurement> {
    let mut found = Vec::new();
    let mut decoder = Decoder::new(DecoderOptions::default());
    decoder.push(bytes, &mut |event| match event {
        Event::Measurement(measurement) => found.push(measurement.clone()),
        other => panic!("{other:?}"),
    });
    assert_eq!(decoder.pending(), 0);
    found
}

#[test]
fn it_streams_as_delivered_byte_for_byte() {
    let mut sensor = sensor();
    let (ticks, bytes) = run(&mut sensor, 60);
    assert_eq!(ticks, [0, 20, 40, 60]);
    assert_eq!(String::from_utf8(bytes).unwrap(), RECORDED.repeat(4));
}

#[test]
fn reads_are_answered_with_the_checksum_of_register_30() {
    let mut sensor = sensor();
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,01*72\r\n"), "$VNRRG,01,VN-100T-CR*32\r\n");
    // the SDK sends CRC-16 regardless of register 30
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,01*E15F\r\n"), "$VNRRG,01,VN-100T-CR*32\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,7*XX\r\n"), "$VNRRG,07,40*5C\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,07*XXXX\n"), "$VNRRG,07,40*5C\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,04*XX\r\n"), "$VNRRG,04,3.1.0.0*77\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,44*XX\r\n"), "$VNRRG,44,0,1,5*6B\r\n");
    assert_eq!(bare(&mut sensor, 1, "VNRRG,75"), "VNRRG,75,0,0,0");
    assert_eq!(bare(&mut sensor, 1, "VNRRG,85"), "VNRRG,85,0,4,4,4,0,0,3,3,3,0");
    // CRC-16 from the next line on
    assert_eq!(bare(&mut sensor, 1, "VNWRG,30,0,0,0,0,3,0,1"), "VNWRG,30,0,0,0,0,3,0,1");
    assert_eq!(ask(&mut sensor, 1, "$VNWRG,06,1,1*CA15\r\n"), "$VNWRG,06,1,1*CA15\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,06,1*XX\r\n"), "$VNRRG,06,1,1*0865\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNWRG,07,2,1*3914\r\n"), "$VNWRG,07,2,1*3914\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNWRG,75,3,400,01,0321*D84E\r\n"), "$VNWRG,75,3,400,01,0321*D84E\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,75*XX\r\n"), "$VNRRG,75,3,400,01,0321*3B31\r\n");
}

#[test]
fn commands_may_come_in_any_pieces_and_between_noise() {
    let mut sensor = quiet_sensor();
    let mut out = Vec::new();
    for byte in b"\xFF\x00noise\r\n$VNRR$VNRRG,07*74\r\n$VNRRG,06*75\r\n" {
        sensor.on_bytes(5, &[*byte], &mut out);
    }
    assert_eq!(String::from_utf8(out).unwrap(), "$VNRRG,07,40*5C\r\n$VNRRG,06,0*69\r\n");
}

#[test]
fn errors_are_those_of_the_manual() {
    let mut sensor = quiet_sensor();
    for (line, error) in [
        ("$VNRRG,07*75\r\n", DeviceError::InvalidChecksum),
        ("$VNRRG,07*0000\r\n", DeviceError::InvalidChecksum),
        ("$VNRRG,07\r\n", DeviceError::InvalidChecksum),
        ("$VNXYZ*XX\r\n", DeviceError::InvalidCommand),
        ("$VNFWU*XX\r\n", DeviceError::InvalidCommand),
        ("$VNTAR*5F\r\n", DeviceError::InvalidCommand),
        ("$VNRRG*XX\r\n", DeviceError::NotEnoughParameters),
        ("$VNWRG,07*XX\r\n", DeviceError::NotEnoughParameters),
        ("$VNASY*XX\r\n", DeviceError::NotEnoughParameters),
        ("$VNWRG,33,0*XX\r\n", DeviceError::NotEnoughParameters),
        ("$VNRRG,30,1*XX\r\n", DeviceError::TooManyParameters),
        ("$VNRRG,08,1*XX\r\n", DeviceError::TooManyParameters),
        ("$VNRST,1*XX\r\n", DeviceError::TooManyParameters),
        ("$VNWRG,33,0,0,0,0*XX\r\n", DeviceError::TooManyParameters),
        ("$VNWRG,07,3*XX\r\n", DeviceError::InvalidParameter),
        ("$VNASY,2*XX\r\n", DeviceError::InvalidParameter),
        ("$VNBOM,1*XX\r\n", DeviceError::InvalidParameter),
        ("$VNBOM,4*XX\r\n", DeviceError::InvalidParameter),
        ("$VNKMD,7*XX\r\n", DeviceError::InvalidParameter),
        ("$VNRRG,99*XX\r\n", DeviceError::InvalidRegister),
        ("$VNRRG,x*XX\r\n", DeviceError::InvalidRegister),
        ("$VNWRG,99,1*XX\r\n", DeviceError::InvalidRegister),
        ("$VNWRG,01,x*XX\r\n", DeviceError::UnauthorizedAccess),
        ("$VNWRG,08,1,2,3*XX\r\n", DeviceError::UnauthorizedAccess),
        ("$VNWRG,75,1,1,01,0739*XX\r\n", DeviceError::InsufficientBaudRate),
    ] {
        let mut expected = Vec::new();
        encode::text_line(&mut expected, &format!("VNERR,{:02X}", error.code()), ChecksumKind::Xor8);
        assert_eq!(ask(&mut sensor, 1, line), String::from_utf8(expected).unwrap(), "{line}");
    }
    assert_eq!(ask(&mut sensor, 1, "$VNRRG,07*75\r\n"), "$VNERR,03*72\r\n");
    // 256 characters are the input buffer
    let long = format!("$VNWRG,00,{}*XX\r\n", "x".repeat(300));
    assert_eq!(ask(&mut sensor, 1, &long), "$VNERR,02*73\r\n");
    assert_eq!(bare(&mut sensor, 1, "VNRRG,07"), "VNRRG,07,40");
}

#[test]
fn error_mode_decides_how_errors_are_reported() {
    let mut sensor = sensor();
    assert_eq!(bare(&mut sensor, 1, "VNWRG,30,0,0,0,0,1,0,0"), "VNWRG,30,0,0,0,0,1,0,0");
    assert_eq!(bare(&mut sensor, 1, "VNRRG,99"), "");
    assert_eq!(bare(&mut sensor, 1, "VNWRG,30,0,0,0,0,1,0,2"), "VNWRG,30,0,0,0,0,1,0,2");
    assert_eq!(bare(&mut sensor, 1, "VNRRG,99"), "VNERR,08");
    assert_eq!(bare(&mut sensor, 1, "VNRRG,06"), "VNRRG,06,0");
    assert_eq!(sensor.next_output_tick(), None);
}

#[test]
fn a_binary_output_is_configured_and_carries_device_time() {
    let mut sensor = quiet_sensor();
    let write = "VNWRG,75,1,20,01,0609";
    assert_eq!(bare(&mut sensor, 7, write), write);
    assert_eq!(sensor.binary_output().unwrap().1, BinaryOutput::parse(75, "1,20,01,0609").unwrap());
    let (ticks, bytes) = run(&mut sensor, 100);
    assert_eq!(ticks, [20, 40, 60, 80, 100]);
    let found = measurements(&bytes);
    let times: Vec<_> = found.iter().map(|measurement| measurement.device_time_ns.unwrap()).collect();
    assert_eq!(times, [25_000_000, 50_000_000, 75_000_000, 100_000_000, 125_000_000]);
    assert_eq!(bytes.len(), 5 * 70);
    let narrow = |values: &[f64]| values.iter().map(|value| f64::from(*value as f32)).collect::<Vec<_>>();
    for (quantity, first) in [
        (Quantity::YawPitchRoll, Channel::Yaw),
        (Quantity::UncompAccel, Channel::AccelX),
        (Quantity::UncompGyro, Channel::GyroX),
        (Quantity::Mag, Channel::MagX),
    ] {
        let expected = narrow(&values()[first as usize..first as usize + 3]);
        assert_eq!(found[0].get(quantity), Some(&expected[..]), "{quantity:?}");
    }
    assert_eq!(found[0].scalar(Quantity::Pressure), Some(f64::from(99.761_f32)));
    // on the other port it has no effect
    assert_eq!(bare(&mut sensor, 101, "VNWRG,75,2,20,01,0609"), "VNWRG,75,2,20,01,0609");
    assert_eq!(sensor.next_output_tick(), None);
}

#[test]
fn several_outputs_share_the_line_each_at_its_rate() {
    let mut sensor = sensor();
    bare(&mut sensor, 1, "VNWRG,75,1,8,01,0009");
    bare(&mut sensor, 1, "VNWRG,76,1,16,04,0030");
    let (ticks, bytes) = run(&mut sensor, 80);
    assert_eq!(ticks, [8, 16, 20, 24, 32, 40, 48, 56, 60, 64, 72, 80]);
    let names: Vec<_> = measurements(&bytes).iter().map(|measurement| measurement.kind.output_name()).collect();
    let count = |name: &str| names.iter().filter(|found| *found == name).count();
    assert_eq!((count("binary 01,0009"), count("binary 04,0030"), count("VNYMR")), (10, 5, 4));
}

#[test]
fn every_message_it_can_be_configured_to_send_is_decoded() {
    for ascii in vn100_proto::AsciiType::ALL {
        let options = SensorOptions { firmware: "3.0.0.0".to_owned(), ..SensorOptions::default() };
        let mut sensor = VirtualSensor::new(&options);
        let write = format!("VNWRG,06,{}", ascii.id());
        assert_eq!(bare(&mut sensor, 0, &write), write);
        let (_, bytes) = run(&mut sensor, 0);
        let found = measurements(&bytes);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].kind.output_name(), ascii.header());
        // the register of the message holds the same values
        let mut reply = Vec::new();
        assert_eq!(bare(&mut sensor, 1, &format!("VNRRG,{}", ascii.register())), "");
        bare(&mut sensor, 1, "VNWRG,06,0");
        assert_eq!(sensor.next_output_tick(), Some(2));
        sensor.emit(2, &values(), &mut reply);
        let mut answered = false;
        Decoder::new(DecoderOptions::default()).push(&reply, &mut |event| {
            if let Event::Reply(reply) = event
                && let Some(read) = reply.measurement()
            {
                assert!(reply.answers(&Command::read(ascii.register())));
                let same = ascii.quantities().iter().all(|quantity| {
                    matches!(quantity, Quantity::DeltaTime | Quantity::DeltaTheta | Quantity::DeltaVelocity)
                        || read.get(*quantity) == found[0].get(*quantity)
                });
                assert!(same, "{read:?}");
                answered = true;
            }
        });
        assert!(answered, "{}", String::from_utf8_lossy(&reply));
    }
}

#[test]
fn serial_count_and_status_are_appended_as_recorded() {
    let mut sensor = sensor();
    // SyncOut counts every twentieth IMU sample, ASCII messages carry the count
    for write in ["VNWRG,32,3,0,0,0,1,1,19,100000000,0", "VNWRG,30,3,1,0,0,1,0,1", "VNWRG,06,1", "VNWRG,33,0,0,543"] {
        assert_eq!(bare(&mut sensor, 0, write), write);
    }
    let (_, bytes) = run(&mut sensor, 60);
    let lines = String::from_utf8(bytes).unwrap();
    let first = lines.lines().next().unwrap();
    assert!(first.starts_with("$VNYPR,+100.949,-007.330,+000.715,T0000000543,S0000*"), "{first}");
    let counts: Vec<_> = measurements(lines.as_bytes()).iter().map(|found| found.sync_count).collect();
    assert_eq!(counts, [Some(543), Some(544), Some(545), Some(546)]);
    assert_eq!(bare(&mut sensor, 80, "VNRRG,33"), "VNRRG,33,0,0,547");
    // the counter wraps at 32 bits
    bare(&mut sensor, 80, "VNWRG,33,0,0,4294967295");
    assert_eq!(bare(&mut sensor, 100, "VNRRG,33"), "VNRRG,33,0,0,0");
    // without skipping it counts IMU samples
    bare(&mut sensor, 100, "VNWRG,32,3,0,0,0,1,1,0,100000000,0");
    assert_eq!(bare(&mut sensor, 120, "VNRRG,33"), "VNRRG,33,0,0,20");
}

#[test]
fn pause_stops_the_stream_and_resume_sends_nothing_old() {
    let mut sensor = sensor();
    run(&mut sensor, 100);
    assert_eq!(bare(&mut sensor, 101, "VNASY,0"), "VNASY,0");
    assert_eq!((sensor.next_output_tick(), sensor.may_send(101)), (None, false));
    assert_eq!(bare(&mut sensor, 500, "VNRRG,06"), "VNRRG,06,14");
    assert_eq!(bare(&mut sensor, 1003, "VNASY,1"), "VNASY,1");
    assert_eq!(sensor.next_output_tick(), Some(1020));
}

#[test]
fn a_poll_answers_with_one_frame_of_the_next_instant() {
    let mut sensor = quiet_sensor();
    bare(&mut sensor, 0, "VNWRG,75,0,20,01,0609");
    let (ticks, _) = run(&mut sensor, 40);
    assert!(ticks.is_empty());
    let mut out = Vec::new();
    // the reply to a later command waits behind the frame
    sensor.on_bytes(50, b"$VNBOM,1*45\r\n$VNRRG,07*74\r\n", &mut out);
    assert_eq!(out, b"");
    assert_eq!(sensor.next_output_tick(), Some(51));
    sensor.emit(51, &values(), &mut out);
    let (frame, reply) = out.split_at(70);
    assert_eq!(measurements(frame)[0].device_time_ns, Some(51 * 1_250_000));
    assert_eq!(reply, b"$VNRRG,07,40*5C\r\n");
    assert_eq!(sensor.next_output_tick(), None);
}

#[test]
fn a_reset_answers_first_then_is_silent_then_begins_at_zero() {
    let mut sensor = sensor();
    run(&mut sensor, 4000);
    let write = "VNWRG,75,1,20,01,0609";
    assert_eq!(bare(&mut sensor, 4001, write), write);
    assert_eq!(bare(&mut sensor, 4001, "VNWRG,05,230400"), "VNWRG,05,230400");
    assert_eq!(sensor.baud(), 230_400);
    assert_eq!(ask(&mut sensor, 4010, "$VNRST*4D\r\n$VNRRG,01*72\r\n"), "$VNRST*4D\r\n");
    assert_eq!(sensor.baud(), 115_200);
    // 1.25 s of silence: it neither receives nor sends
    assert_eq!(ask(&mut sensor, 5009, "$VNRRG,01*72\r\n"), "");
    assert_eq!((sensor.next_output_tick(), sensor.may_send(5009)), (Some(5010), false));
    let (ticks, bytes) = run(&mut sensor, 5050);
    assert_eq!(ticks, [5010, 5030, 5050]);
    // settings that were not saved are gone: text again
    assert_eq!(bytes, RECORDED.repeat(3).into_bytes());
    assert_eq!(sensor.device_time_ns(5050), 50_000_000);
    assert_eq!(bare(&mut sensor, 5051, "VNRRG,75"), "VNRRG,75,0,0,0");
    assert_eq!(sensor.registers().flash_writes(), 0);
}

#[test]
fn saved_settings_survive_a_reset_and_every_flash_write_is_counted() {
    let mut sensor = quiet_sensor();
    bare(&mut sensor, 1, "VNWRG,75,1,40,01,0009");
    run(&mut sensor, 50);
    assert_eq!(ask(&mut sensor, 51, "$VNWNV*57\r\n$VNRRG,07*74\r\n"), "");
    assert_eq!(sensor.registers().flash_writes(), 1);
    // it answers half a second later, and later commands after that; the stream continues
    let mut out = Vec::new();
    while let Some(tick) = sensor.next_output_tick().filter(|tick| *tick < 451) {
        sensor.emit(tick, &values(), &mut out);
    }
    assert_eq!(measurements(&out).len(), 10);
    out.clear();
    assert_eq!(sensor.next_output_tick(), Some(451));
    sensor.emit(451, &values(), &mut out);
    assert_eq!(String::from_utf8(out).unwrap(), "$VNWNV*57\r\n$VNRRG,07,40*5C\r\n");
    sensor.reset(500);
    assert_eq!(sensor.next_output_tick(), Some(1500));
    assert_eq!(bare(&mut sensor, 1500, "VNRRG,75"), "VNRRG,75,1,40,01,0009");
    assert_eq!(ask(&mut sensor, 1501, "$VNRFS*5F\r\n"), "$VNRFS*5F\r\n");
    assert_eq!(bare(&mut sensor, 2501, "VNRRG,75"), "VNRRG,75,0,0,0");
    assert_eq!(sensor.registers().flash_writes(), 2);
}

#[test]
fn a_baud_change_is_answered() {
    let mut sensor = sensor();
    assert_eq!(ask(&mut sensor, 3, "$VNWRG,05,921600*53\r\n"), "$VNWRG,05,921600*53\r\n");
    assert_eq!(sensor.baud(), 921_600);
    // a lower rate than the stream needs is refused
    assert_eq!(bare(&mut sensor, 3, "VNWRG,05,38400"), "VNERR,0C");
    assert_eq!(sensor.baud(), 921_600);
    // the other port's rate is not the rate of this port
    assert_eq!(bare(&mut sensor, 3, "VNWRG,05,57600,2"), "VNWRG,05,57600,2");
    assert_eq!(sensor.baud(), 921_600);
}

#[test]
fn older_firmware_knows_commands_that_newer_does_not() {
    let options = SensorOptions { firmware: "3.0.0.0".to_owned(), ..SensorOptions::default() };
    let mut sensor = VirtualSensor::new(&options);
    assert_eq!(ask(&mut sensor, 1, "$VNTAR*5F\r\n"), "$VNTAR*5F\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNKMD,1*47\r\n"), "$VNKMD,1*47\r\n");
    assert_eq!(ask(&mut sensor, 1, "$VNKAD,1*4B\r\n"), "$VNKAD,1*4B\r\n");
    assert_eq!(bare(&mut sensor, 1, "VNSGB"), "VNSGB");
    assert_eq!(bare(&mut sensor, 1, "VNWRG,06,9"), "VNWRG,06,9");
}

#[test]
fn a_replaying_sensor_acknowledges_and_stays_silent() {
    let mut sensor = sensor();
    sensor.set_replaying(true);
    assert_eq!(sensor.next_output_tick(), None);
    assert!(sensor.may_send(0));
    let write = "VNWRG,75,1,20,01,0609";
    assert_eq!(bare(&mut sensor, 1, write), write);
    assert_eq!(sensor.next_output_tick(), None);
    assert_eq!(bare(&mut sensor, 1, "VNASY,0"), "VNASY,0");
    assert!(!sensor.may_send(1));
}

#[test]
fn a_clock_that_ran_before_goes_on() {
    let options = SensorOptions { uptime_ticks: 800 * 3600, ..SensorOptions::default() };
    let sensor = VirtualSensor::new(&options);
    assert_eq!(sensor.device_time_ns(0), 3_600_000_000_000);
    assert_eq!(sensor.next_output_tick(), Some(0));
}

#[test]
fn a_sensor_changes_rate_format_clock_and_identity_by_itself() {
    use super::faults::{Fault, parse_line};
    let Ok(Some(Fault::Format(short))) = parse_line("format 01,0009", "test", 1) else { panic!() };
    let mut sensor = quiet_sensor();
    bare(&mut sensor, 7, "VNWRG,75,1,20,01,0609");
    sensor.registers_mut().set_rate(100);
    let (ticks, _) = run(&mut sensor, 40);
    assert_eq!(ticks, [8, 16, 24, 32, 40]);
    sensor.registers_mut().set_format(short);
    sensor.set_clock(41, 4_294_967_290);
    let (ticks, bytes) = run(&mut sensor, 56);
    assert_eq!(ticks, [48, 56]);
    let found = measurements(&bytes);
    assert_eq!(found[0].kind.output_name(), "binary 01,0009");
    // 48 is 7 ticks of 1250 µs after the jump
    assert_eq!(found[0].device_time_ns, Some(4_294_967_290_000 + 7 * 1_250_000));
    sensor.registers_mut().set_format(super::faults::Format::Ascii(vn100_proto::AsciiType::Ymr));
    let (_, bytes) = run(&mut sensor, 80);
    assert_eq!(measurements(&bytes)[0].kind.output_name(), "VNYMR");
    sensor.set_clock(80, u64::MAX / 1000);
    assert!(sensor.device_time_ns(81) < 1_250_000, "64 bits of nanoseconds wrap");
    sensor.replace(100, "0100099999");
    let (ticks, _) = run(&mut sensor, 1140);
    assert_eq!((ticks[0], sensor.device_time_ns(1100)), (1100, 0));
    assert_eq!(bare(&mut sensor, 1141, "VNRRG,03"), "VNRRG,03,0100099999");
}
