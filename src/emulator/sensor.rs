//! The virtual sensor: a VN-100's behaviour as a pure function of bytes, ticks and values.
//!
//! In: command bytes in any division ([`VirtualSensor::on_bytes`]), and one instant of channel values for each tick
//! that it requests ([`VirtualSensor::next_output_tick`], [`VirtualSensor::emit`]). Out: the bytes it sends.
//! Time is a tick of 1/800 s that the caller counts; the sensor's own clock starts with it, or at 0 after a reset.
//!
//! It accepts both checksum forms and the bypass, and answers with the one that register 30 selects. Not supported:
//! bootloader and command prompt (error 04), SPI, the on-board filters.

use super::instant::{Values, measure};
use super::options::{SensorOptions, TICK_NS};
use super::registers::RegisterFile;
use std::collections::VecDeque;
use std::ops::Range;
use vn100_proto::ascii::{Trailer, split_line};
use vn100_proto::link::INTERNAL_RATE_HZ;
use vn100_proto::register::{BINARY_OUTPUT_1, SYNCHRONIZATION, SYNCHRONIZATION_STATUS, SyncStatus};
use vn100_proto::{AsciiType, ChecksumKind, DeviceError, MeasurementKind, Verb, encode};

/// Characters that the sensor's input buffer holds (user manual UM001 rev 2.45, section 3.8).
const INPUT_BYTES: usize = 256;
/// The duration of writing the flash: about 500 ms (section 5.1.3).
const FLASH_TICKS: u64 = INTERNAL_RATE_HZ as u64 / 2;

/// Output to be sent later, in order.
#[derive(Debug, Clone)]
enum Queued {
    /// A reply that is ready.
    Line(String),
    /// The values of a measurement register.
    ReadMeasurement(AsciiType, String),
    /// One frame of this binary output.
    Poll(usize),
}

/// A VN-100.
#[derive(Debug, Clone)]
pub struct VirtualSensor {
    registers: RegisterFile,
    boot_ticks: u64,
    /// The tick at which its clock read 0; negative if before tick 0.
    clock_start: i64,
    /// The offset from that clock to TimeStartup, ns.
    clock_offset_ns: u64,
    /// The sensor neither receives nor sends before this tick.
    silent_until: u64,
    /// The latest tick passed by the caller.
    now: u64,
    /// Ticks up to this one have been emitted.
    emitted: Option<u64>,
    /// The output has been unchanged since this tick: nothing is sent for earlier ones.
    output_since: u64,
    paused: bool,
    replaying: bool,
    input: Vec<u8>,
    /// Whether `input` is inside a line.
    in_line: bool,
    queue: VecDeque<(u64, Queued)>,
    /// SyncOut counter at `sync_since`, the tick from which it counts.
    sync_out_count: u32,
    sync_since: u64,
    /// The positions of the messages of the last instant in the bytes sent.
    frames: Vec<Range<usize>>,
}

impl VirtualSensor {
    /// Creates a running sensor with its settings as delivered.
    pub fn new(options: &SensorOptions) -> Self {
        Self {
            registers: RegisterFile::new(options),
            boot_ticks: options.boot_ticks,
            clock_start: -i64::try_from(options.uptime_ticks).unwrap_or(i64::MAX),
            clock_offset_ns: 0,
            frames: Vec::new(),
            silent_until: 0,
            now: 0,
            emitted: None,
            output_since: 0,
            paused: false,
            replaying: false,
            input: Vec::with_capacity(INPUT_BYTES),
            in_line: false,
            queue: VecDeque::new(),
            sync_out_count: 0,
            sync_since: 0,
        }
    }

    /// Returns the registers.
    pub fn registers(&self) -> &RegisterFile {
        &self.registers
    }

    /// Returns the registers, to be set before the first command ([`RegisterFile::preset`]).
    pub fn registers_mut(&mut self) -> &mut RegisterFile {
        &mut self.registers
    }

    /// Returns the baud rate of the port in use.
    pub fn baud(&self) -> u32 {
        self.registers.settings().baud[self.registers.port_index()]
    }

    /// Replays a recording. Commands are answered and configuration is acknowledged as usual, but the sensor sends no
    /// message by itself; the caller sends recorded ones while [`VirtualSensor::may_send`].
    pub fn set_replaying(&mut self, replaying: bool) {
        self.replaying = replaying;
    }

    /// Returns whether asynchronous output goes out at this tick: the sensor runs and is not paused.
    pub fn may_send(&self, tick: u64) -> bool {
        tick >= self.silent_until && !self.paused
    }

    /// Returns TimeStartup at a tick, ns.
    pub fn device_time_ns(&self, tick: u64) -> u64 {
        (self.clock_ticks(tick) * TICK_NS).wrapping_add(self.clock_offset_ns)
    }

    /// Sets TimeStartup to `us` microseconds at `tick`, and the sync counter to the lower 32 bits of that number. The
    /// times of messages do not change.
    pub fn set_clock(&mut self, tick: u64, us: u64) {
        self.now = self.now.max(tick);
        self.clock_offset_ns = us.wrapping_mul(1000).wrapping_sub(self.clock_ticks(tick) * TICK_NS);
        self.set_sync_out_count((us & u64::from(u32::MAX)) as u32);
    }

    /// Replaces the unit at `tick`: its registers are as delivered, and its clock begins at 0.
    pub fn replace(&mut self, tick: u64, serial_number: &str) {
        self.registers.replace(serial_number);
        self.reset(tick);
    }

    /// Restarts at `tick` without a command, as after a brown-out or by a watchdog.
    pub fn reset(&mut self, tick: u64) {
        self.now = self.now.max(tick);
        self.registers.load();
        self.restart();
    }

    fn clock_ticks(&self, tick: u64) -> u64 {
        let tick = i64::try_from(tick).unwrap_or(i64::MAX);
        u64::try_from(tick.saturating_sub(self.clock_start)).unwrap_or(0)
    }

    fn restart(&mut self) {
        self.queue.clear();
        self.input.clear();
        (self.in_line, self.paused) = (false, false);
        self.silent_until = self.now + self.boot_ticks;
        self.clock_start = i64::try_from(self.silent_until).unwrap_or(i64::MAX);
        self.clock_offset_ns = 0;
        (self.sync_out_count, self.sync_since) = (0, self.silent_until);
    }

    /// Returns the ticks between two SyncOut events (register 32): IMU samples come at 800 Hz, attitude at 400 Hz; GPS
    /// pulses never.
    fn sync_out_period(&self) -> Option<u64> {
        let control = &self.registers.settings().synchronization;
        let events = match control.sync_out_mode {
            1 | 2 => 1,
            3 => 2,
            _ => return None,
        };
        Some(events * (u64::from(control.sync_out_skip_factor) + 1))
    }

    fn sync_out_count(&self, tick: u64) -> u32 {
        let pulses = self.sync_out_period().map_or(0, |period| tick.saturating_sub(self.sync_since) / period);
        // the counter has 32 bits and wraps
        self.sync_out_count.wrapping_add((pulses & u64::from(u32::MAX)) as u32)
    }

    /// Makes the counter continue from `count` at the current tick.
    fn set_sync_out_count(&mut self, count: u32) {
        (self.sync_out_count, self.sync_since) = (count, self.now);
    }

    /// Takes command bytes that arrive at `tick` and appends the replies that are sent at once. Others wait for
    /// [`VirtualSensor::next_output_tick`]: values need an instant, and writing the flash takes time.
    ///
    /// Emit the output due before `tick` first: a command that changes the output discards earlier output that was not
    /// emitted.
    pub fn on_bytes(&mut self, tick: u64, bytes: &[u8], out: &mut Vec<u8>) {
        self.now = self.now.max(tick);
        for byte in bytes {
            if self.now < self.silent_until {
                return;
            }
            match byte {
                b'$' => {
                    self.input.clear();
                    self.input.push(b'$');
                    self.in_line = true;
                }
                b'\r' | b'\n' if self.in_line => {
                    self.in_line = false;
                    let line = std::mem::take(&mut self.input);
                    self.on_line(&line, out);
                    self.input = line;
                }
                byte if self.in_line => {
                    if self.input.len() >= INPUT_BYTES {
                        self.in_line = false;
                        self.report(DeviceError::SerialBufferOverflow, out);
                    } else {
                        self.input.push(*byte);
                    }
                }
                _ => {}
            }
        }
    }

    fn on_line(&mut self, line: &[u8], out: &mut Vec<u8>) {
        let body =
            split_line(line).filter(|(body, trailer)| matches!(trailer, Trailer::Bypass(_)) || trailer.matches(body));
        let result = match body.and_then(|(body, _)| std::str::from_utf8(body).ok()) {
            Some(body) => self.on_command(body, out),
            None => Err(DeviceError::InvalidChecksum),
        };
        if let Err(error) = result {
            self.report(error, out);
        }
    }

    fn on_command(&mut self, body: &str, out: &mut Vec<u8>) -> Result<(), DeviceError> {
        let (header, rest) = body.split_once(',').map_or((body, None), |(header, rest)| (header, Some(rest)));
        let verb = Verb::from_header(header.as_bytes()).ok_or(DeviceError::InvalidCommand)?;
        let echo = Queued::Line(body.to_owned());
        match verb {
            Verb::ReadRegister => return self.on_read(rest, out),
            Verb::WriteRegister => return self.on_write(rest, echo, out),
            Verb::AsyncOutput => {
                self.paused = match rest {
                    Some("0") => true,
                    Some("1") => false,
                    Some(_) => return Err(DeviceError::InvalidParameter),
                    None => return Err(DeviceError::NotEnoughParameters),
                };
                self.output_since = self.now;
                self.answer(echo, out);
            }
            Verb::PollBinary => {
                let output = match rest {
                    Some("1") => 0,
                    Some("2") => 1,
                    Some("3") => 2,
                    Some(_) => return Err(DeviceError::InvalidParameter),
                    None => return Err(DeviceError::NotEnoughParameters),
                };
                if self.registers.settings().outputs[output].header.is_none() {
                    return Err(DeviceError::InvalidParameter);
                }
                self.queue_at(self.now + 1, Queued::Poll(output));
            }
            Verb::KnownMagneticDisturbance | Verb::KnownAccelerationDisturbance => match rest {
                Some("0" | "1") => self.answer(echo, out),
                Some(_) => return Err(DeviceError::InvalidParameter),
                None => return Err(DeviceError::NotEnoughParameters),
            },
            _ if rest.is_some() => return Err(DeviceError::TooManyParameters),
            Verb::Tare => {
                // gone in firmware 3.1
                if self.registers.firmware() >= (3, 1) {
                    return Err(DeviceError::InvalidCommand);
                }
                self.answer(echo, out);
            }
            Verb::SetGyroBias => self.answer(echo, out),
            Verb::WriteSettings => {
                self.registers.save();
                self.queue_at(self.now + FLASH_TICKS, echo);
            }
            Verb::Reset => {
                self.answer(echo, out);
                self.registers.load();
                self.restart();
            }
            Verb::RestoreFactorySettings => {
                self.answer(echo, out);
                self.registers.restore_factory();
                self.restart();
            }
        }
        Ok(())
    }

    fn on_read(&mut self, rest: Option<&str>, out: &mut Vec<u8>) -> Result<(), DeviceError> {
        let (register, argument) = register_number(rest)?;
        let head = format!("VNRRG,{register:02}");
        if let Some(ascii) = AsciiType::from_register(register) {
            if argument.is_some() {
                return Err(DeviceError::TooManyParameters);
            }
            self.queue_at(self.now + 1, Queued::ReadMeasurement(ascii, head));
            return Ok(());
        }
        let values = if register == SYNCHRONIZATION_STATUS {
            if argument.is_some() {
                return Err(DeviceError::TooManyParameters);
            }
            SyncStatus { sync_out_count: self.sync_out_count(self.now), ..SyncStatus::default() }.to_string()
        } else {
            self.registers.read(register, argument)?
        };
        self.answer(Queued::Line(format!("{head},{values}")), out);
        Ok(())
    }

    fn on_write(&mut self, rest: Option<&str>, echo: Queued, out: &mut Vec<u8>) -> Result<(), DeviceError> {
        let (register, values) = register_number(rest)?;
        let values = values.ok_or(DeviceError::NotEnoughParameters)?;
        if register == SYNCHRONIZATION_STATUS {
            let status = SyncStatus::parse(values).map_err(|_| match values.split(',').count() {
                0..3 => DeviceError::NotEnoughParameters,
                3 => DeviceError::InvalidParameter,
                _ => DeviceError::TooManyParameters,
            })?;
            self.set_sync_out_count(status.sync_out_count);
            self.answer(echo, out);
            return Ok(());
        }
        let count = self.sync_out_count(self.now);
        let checksum = self.checksum();
        self.registers.write(register, values)?;
        self.output_since = self.now;
        // the reply has the form (and is sent at the rate) in force when the command arrived
        self.answer_as(echo, checksum, out);
        if register == SYNCHRONIZATION {
            self.set_sync_out_count(count);
        }
        Ok(())
    }

    fn checksum(&self) -> ChecksumKind {
        self.registers.settings().communication.checksum()
    }

    /// Sends a reply at once, or behind those that wait.
    fn answer(&mut self, reply: Queued, out: &mut Vec<u8>) {
        self.answer_as(reply, self.checksum(), out);
    }

    fn answer_as(&mut self, reply: Queued, checksum: ChecksumKind, out: &mut Vec<u8>) {
        match reply {
            Queued::Line(body) if self.queue.is_empty() => encode::text_line(out, &body, checksum),
            reply => self.queue_at(self.now, reply),
        }
    }

    fn queue_at(&mut self, tick: u64, reply: Queued) {
        let behind = self.queue.back().map_or(tick, |(last, _)| tick.max(*last));
        self.queue.push_back((behind, reply));
    }

    /// Reports an error according to register 30's ErrorMode.
    fn report(&mut self, error: DeviceError, out: &mut Vec<u8>) {
        let mode = self.registers.settings().communication.error_mode;
        if mode >= 1 {
            self.answer(Queued::Line(format!("VNERR,{:02X}", error.code())), out);
        }
        if mode == 2 {
            self.registers.stop_ascii();
        }
    }

    /// Returns the next tick at which the sensor sends something, later than every tick emitted so far; `None` if it
    /// has nothing to send until the next command.
    pub fn next_output_tick(&self) -> Option<u64> {
        let from = self.emitted.map_or(0, |emitted| emitted + 1).max(self.silent_until);
        // a reply may be due while the output rests
        let reply = self.queue.front().map(|(due, _)| from.max(*due));
        if self.paused || self.replaying {
            return reply;
        }
        let settings = self.registers.settings();
        let ascii = settings.ascii[self.registers.port_index()].and_then(|_| self.registers.ascii_period_ticks());
        let port = self.registers.port();
        let binary = settings
            .outputs
            .iter()
            .filter(|output| output.is_sent_on(port))
            .map(|output| u64::from(output.rate_divisor));
        let from = from.max(self.output_since);
        let next = |period: u64| from + (period - self.clock_ticks(from) % period) % period;
        ascii.into_iter().chain(binary).map(next).chain(reply).min()
    }

    /// Appends the sensor's output at `tick`, given the values of that instant. Call it for each
    /// [`VirtualSensor::next_output_tick`] whose time has come; a tick that was emitted already produces nothing.
    pub fn emit(&mut self, tick: u64, values: &Values, out: &mut Vec<u8>) {
        self.frames.clear();
        if self.emitted.is_some_and(|emitted| tick <= emitted) || tick < self.silent_until {
            return;
        }
        self.emitted = Some(tick);
        self.now = self.now.max(tick);
        while let Some((_, reply)) = self.queue.pop_front_if(|(due, _)| *due <= tick) {
            match reply {
                Queued::Line(body) => encode::text_line(out, &body, self.checksum()),
                Queued::Poll(output) => self.send_binary(output, tick, values, out),
                Queued::ReadMeasurement(ascii, head) => {
                    let interval_s = 1.0 / f64::from(INTERNAL_RATE_HZ);
                    let measurement = measure(MeasurementKind::Ascii(ascii), values, interval_s);
                    let mut body = head.into_bytes();
                    encode::numbers(&mut body, ascii, &measurement);
                    encode::text_line(out, &String::from_utf8_lossy(&body), self.checksum());
                }
            }
        }
        if self.paused || self.replaying {
            return;
        }
        let clock = self.clock_ticks(tick);
        for output in 0..self.registers.settings().outputs.len() {
            let setting = &self.registers.settings().outputs[output];
            if setting.is_sent_on(self.registers.port()) && clock.is_multiple_of(u64::from(setting.rate_divisor)) {
                self.send_binary(output, tick, values, out);
            }
        }
        let ascii = self.registers.settings().ascii[self.registers.port_index()];
        if let (Some(ascii), Some(period)) = (ascii, self.registers.ascii_period_ticks())
            && clock.is_multiple_of(period)
        {
            self.send_ascii(ascii, period, tick, values, out);
        }
    }

    /// Returns the positions of the messages of the last [`VirtualSensor::emit`] in the output; the bytes before and
    /// between are replies.
    pub fn frames(&self) -> &[Range<usize>] {
        &self.frames
    }

    fn send_ascii(&mut self, ascii: AsciiType, period: u64, tick: u64, values: &Values, out: &mut Vec<u8>) {
        let communication = &self.registers.settings().communication;
        let interval_s = period as f64 / f64::from(INTERNAL_RATE_HZ);
        let mut measurement = measure(MeasurementKind::Ascii(ascii), values, interval_s);
        measurement.sync_count = match communication.serial_count {
            0 => None,
            3 => Some(self.sync_out_count(tick)),
            // SyncIn is not connected
            _ => Some(0),
        };
        // attitude excellent, nothing saturated, nothing disturbed
        measurement.vpe_status = (communication.serial_status != 0).then_some(0);
        let start = out.len();
        encode::ascii_message(out, ascii, &measurement, communication.checksum());
        self.frames.push(start..out.len());
    }

    fn send_binary(&mut self, output: usize, tick: u64, values: &Values, out: &mut Vec<u8>) {
        let setting = &self.registers.settings().outputs[output];
        let Some(header) = setting.header else { return };
        let interval_s = f64::from(setting.rate_divisor.max(1)) / f64::from(INTERNAL_RATE_HZ);
        let mut measurement = measure(MeasurementKind::Binary(header), values, interval_s);
        measurement.device_time_ns = Some(self.device_time_ns(tick));
        measurement.sync_count = Some(self.sync_out_count(tick));
        let start = out.len();
        encode::binary_frame(out, &header, &measurement);
        self.frames.push(start..out.len());
    }

    /// Returns the binary output of the port in use with the lowest register number: the one that a logger configured.
    pub fn binary_output(&self) -> Option<(u16, vn100_proto::register::BinaryOutput)> {
        let port = self.registers.port();
        (BINARY_OUTPUT_1..).zip(self.registers.settings().outputs).find(|(_, output)| output.is_sent_on(port))
    }
}

/// Returns the register number in a command, and the text after it.
fn register_number(rest: Option<&str>) -> Result<(u16, Option<&str>), DeviceError> {
    let rest = rest.ok_or(DeviceError::NotEnoughParameters)?;
    let (number, values) = rest.split_once(',').map_or((rest, None), |(number, values)| (number, Some(values)));
    if number.is_empty() {
        return Err(DeviceError::NotEnoughParameters);
    }
    let digits = number.bytes().all(|byte| byte.is_ascii_digit());
    let number = number.parse().ok().filter(|_| digits).ok_or(DeviceError::InvalidRegister)?;
    Ok((number, values))
}
