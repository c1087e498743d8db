//! The virtual sensor's registers: RAM, flash, and the rules by which a write is refused.
//!
//! In: register numbers and values in the form of commands. Out: values in the form of replies, or the [`DeviceError`]
//! that a sensor would report. Refuses: unknown registers (08), writes to read-only ones (09), too few (05) or too many
//! (06) values, values out of range (07), and outputs that exceed the baud rate (0C).
//!
//! Source: user manual UM001 rev 2.45, chapters 5–7; defaults of firmware 3.1 if recordings show them.

use super::faults::Format;
use super::options::SensorOptions;
use std::collections::BTreeMap;
use vn100_proto::link::{self, ASCII_RATES_HZ, BAUD_RATES, BITS_PER_BYTE, DEFAULT_BAUD, INTERNAL_RATE_HZ};
use vn100_proto::register::{
    ASYNC_RATE, ASYNC_TYPE, BAUD_RATE, BINARY_OUTPUT_1, BINARY_OUTPUT_3, BinaryOutput, COMMUNICATION,
    CommunicationControl, FIRMWARE, HARDWARE_REVISION, IMU_FILTER, ImuFilter, MODEL, SERIAL_NUMBER, SYNCHRONIZATION,
    SyncControl, USER_TAG,
};
use vn100_proto::{AsciiType, DeviceError, MeasurementKind, frame_bytes};

/// Longest user tag (register 0).
const USER_TAG_BYTES: usize = 20;
/// Serial ports of the sensor: 1 is RS-232, 2 is TTL.
const PORTS: usize = 2;
/// Registers that hold numbers without effect in the emulator: number, values as delivered, whether writable.
const PLAIN: [(u16, &str, bool); 17] = [
    (21, "1,0,1.8,0,0,-9.79375", true),
    (23, "1,0,0,0,1,0,0,0,1,0,0,0", true),
    (25, "1,0,0,0,1,0,0,0,1,0,0,0", true),
    (26, "1,0,0,0,1,0,0,0,1", true),
    (35, "1,1,1,1", true),
    (36, "5,5,5,3,3,3,4,4,4", true),
    (38, "5,5,5,3,3,3,4,4,4", true),
    (40, "5,5,5,3,3,3,4,4,4", true),
    (43, "+00.000000,+00.000000,+00.000000", true),
    // firmware 3.1: hard and soft iron estimation off
    (44, "0,1,5", true),
    // firmware 3.1 returns zeros
    (46, "0,0,0,0,0,0,0,0,0,0,0,0,0,0", false),
    (47, "1,0,0,0,1,0,0,0,1,0,0,0", false),
    (74, "+00.000000,+00.000000,+00.000000", true),
    (82, "0,0,0,0,0", true),
    (83, "0,0,0,0,1000,0.000,+00.00000000,+000.00000000,+00000.000", true),
    (84, "1,0,0,0,1,0,0,0,1,0,0,0", true),
    (116, "5.0,0.05,20.0,0.05,0.08,0.0,0.0", true),
];

/// The settings that the register values contain.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Register 5, per port.
    pub baud: [u32; PORTS],
    /// Register 6, per port; `None` is off.
    pub ascii: [Option<AsciiType>; PORTS],
    /// Register 7, per port, Hz; 0 is off.
    pub ascii_rate_hz: [u32; PORTS],
    /// Register 30.
    pub communication: CommunicationControl,
    /// Register 32.
    pub synchronization: SyncControl,
    /// Registers 75–77.
    pub outputs: [BinaryOutput; 3],
    /// Register 85.
    pub filter: ImuFilter,
    user_tag: String,
    plain: BTreeMap<u16, String>,
}

impl Default for Settings {
    /// Returns the settings as delivered: VNYMR at 40 Hz on both ports, 115200 baud, no binary output.
    fn default() -> Self {
        Self {
            baud: [DEFAULT_BAUD; PORTS],
            ascii: [Some(AsciiType::Ymr); PORTS],
            ascii_rate_hz: [40; PORTS],
            communication: CommunicationControl::default(),
            synchronization: SyncControl::default(),
            outputs: [BinaryOutput::default(); 3],
            filter: ImuFilter::default(),
            user_tag: String::new(),
            plain: PLAIN.iter().map(|(number, values, _)| (*number, (*values).to_owned())).collect(),
        }
    }
}

impl Settings {
    /// Returns whether the total output of every port fits its baud rate. A real sensor refuses VNYMR at 100 Hz and
    /// 115200 baud (106 %) and accepts 95.5 %. The exact limit is not documented; here it is 100 %.
    fn fits(&self) -> bool {
        (1..=2_u8).zip(0..PORTS).all(|(port, index)| {
            let mut bytes_per_s = 0.0;
            if let Some(ascii) = self.ascii[index] {
                let bytes = frame_bytes(&MeasurementKind::Ascii(ascii), &self.communication.frame_options());
                bytes_per_s += bytes as f64 * f64::from(self.ascii_rate_hz[index]);
            }
            for output in self.outputs.iter().filter(|output| output.is_sent_on(port)) {
                let bytes = output.header.map_or(0, |header| header.frame_bytes());
                bytes_per_s += bytes as f64 * output.rate_hz().unwrap_or(0.0);
            }
            bytes_per_s <= f64::from(self.baud[index]) / f64::from(BITS_PER_BYTE)
        })
    }
}

/// RAM and flash of the sensor.
#[derive(Debug, Clone)]
pub struct RegisterFile {
    ram: Settings,
    flash: Settings,
    flash_writes: u64,
    fixed: BTreeMap<u16, String>,
    firmware: (u32, u32),
    port: u8,
}

/// Returns whether the values are comma-separated numbers that a sensor accepts: finite decimals.
fn are_numbers(values: &str) -> bool {
    values.split(',').all(|field| field.trim().parse::<f64>().is_ok_and(f64::is_finite))
}

fn expect_count(found: usize, expected: usize) -> Result<(), DeviceError> {
    match found.cmp(&expected) {
        std::cmp::Ordering::Less => Err(DeviceError::NotEnoughParameters),
        std::cmp::Ordering::Greater => Err(DeviceError::TooManyParameters),
        std::cmp::Ordering::Equal => Ok(()),
    }
}

impl RegisterFile {
    /// Returns the registers of a sensor as delivered, accessed through serial port `port` (1 or 2).
    pub fn new(options: &SensorOptions) -> Self {
        let settings = Settings { user_tag: options.user_tag.clone(), ..Settings::default() };
        let mut version = options.firmware.split('.').map(|part| part.parse().unwrap_or(0));
        let firmware = (version.next().unwrap_or(0), version.next().unwrap_or(0));
        let fixed = [
            (MODEL, options.model.clone()),
            (HARDWARE_REVISION, options.hardware_revision.to_string()),
            (SERIAL_NUMBER, options.serial_number.clone()),
            (FIRMWARE, options.firmware.clone()),
        ];
        Self {
            ram: settings.clone(),
            flash: settings,
            flash_writes: 0,
            fixed: fixed.into(),
            firmware,
            port: options.port.clamp(1, 2),
        }
    }

    /// Returns the settings in force.
    pub fn settings(&self) -> &Settings {
        &self.ram
    }
    /// Returns the serial port in use, 1 or 2.
    pub fn port(&self) -> u8 {
        self.port
    }
    /// Returns the index of that port in the settings.
    pub fn port_index(&self) -> usize {
        usize::from(self.port) - 1
    }
    /// Returns the major and minor number of the firmware.
    pub fn firmware(&self) -> (u32, u32) {
        self.firmware
    }
    /// Returns how often the flash was written since the sensor was made.
    pub fn flash_writes(&self) -> u64 {
        self.flash_writes
    }
    /// Saves RAM to flash.
    pub fn save(&mut self) {
        self.flash = self.ram.clone();
        self.flash_writes += 1;
    }
    /// Loads the saved values, as a reset does.
    pub fn load(&mut self) {
        self.ram = self.flash.clone();
    }
    /// Restores the factory settings, also in flash.
    pub fn restore_factory(&mut self) {
        self.ram = Settings { user_tag: self.ram.user_tag.clone(), ..Settings::default() };
        self.save();
    }
    /// Turns off the asynchronous ASCII output of the port in use, as ErrorMode 2 does.
    pub fn stop_ascii(&mut self) {
        let index = self.port_index();
        self.ram.ascii[index] = None;
    }

    /// Writes a register in RAM and flash without any rule, including fixed ones, and without counting: the initial
    /// state of the sensor.
    ///
    /// # Errors
    /// [`DeviceError`] if the register or its values do not exist.
    pub fn preset(&mut self, register: u16, values: &str) -> Result<(), DeviceError> {
        if let Some(fixed) = self.fixed.get_mut(&register) {
            values.clone_into(fixed);
            return Ok(());
        }
        let mut settings = self.ram.clone();
        match settings.plain.get_mut(&register) {
            Some(plain) => values.clone_into(plain),
            None => self.apply(&mut settings, register, values)?,
        }
        self.ram = settings.clone();
        self.flash = settings;
        Ok(())
    }

    /// Replaces the unit: this serial number, everything else as delivered.
    pub fn replace(&mut self, serial_number: &str) {
        self.fixed.insert(SERIAL_NUMBER, serial_number.to_owned());
        self.ram = Settings { user_tag: self.ram.user_tag.clone(), ..Settings::default() };
        self.flash = self.ram.clone();
    }

    /// Sets the baud rate of the port in use, in RAM.
    pub fn set_baud(&mut self, baud: u32) {
        let index = self.port_index();
        self.ram.baud[index] = baud;
    }

    /// Sets the rate of all output of the port in use, in RAM; `rate_hz` divides 800.
    pub fn set_rate(&mut self, rate_hz: u32) {
        let (port, index) = (self.port, self.port_index());
        for output in self.ram.outputs.iter_mut().filter(|output| output.is_sent_on(port)) {
            output.rate_divisor = (INTERNAL_RATE_HZ / rate_hz.max(1)) as u16;
        }
        if self.ram.ascii[index].is_some() {
            self.ram.ascii_rate_hz[index] = rate_hz;
        }
    }

    /// Makes this the only output of the port in use, in RAM.
    pub fn set_format(&mut self, format: Format) {
        let (port, index) = (self.port, self.port_index());
        let before = self.ram.outputs.iter().find(|output| output.is_sent_on(port)).copied();
        for output in self.ram.outputs.iter_mut().filter(|output| output.is_sent_on(port)) {
            *output = BinaryOutput::default();
        }
        self.ram.ascii[index] = None;
        match format {
            Format::Ascii(ascii) => self.ram.ascii[index] = Some(ascii),
            Format::Binary(header) => {
                let rate_divisor = before.map_or(20, |output| output.rate_divisor);
                self.ram.outputs[0] = BinaryOutput { async_mode: port, rate_divisor, header: Some(header) };
            }
        }
    }

    /// Returns the port that a command names; `0` and `?` (which the SDK sends) are the one in use.
    fn named_port(&self, argument: &str) -> Result<usize, DeviceError> {
        match argument {
            "1" => Ok(0),
            "2" => Ok(1),
            "0" | "?" => Ok(self.port_index()),
            _ => Err(DeviceError::InvalidParameter),
        }
    }

    /// Returns the values of a register in the form of a reply. `argument` is the text after the register number.
    ///
    /// # Errors
    /// 08 for a register that does not exist, 06 for a surplus argument, 07 for a port that does not exist.
    pub fn read(&self, register: u16, argument: Option<&str>) -> Result<String, DeviceError> {
        if let BAUD_RATE..=ASYNC_RATE = register {
            let index = argument.map_or(Ok(self.port_index()), |argument| self.named_port(argument))?;
            let value = match register {
                BAUD_RATE => self.ram.baud[index],
                ASYNC_TYPE => self.ram.ascii[index].map_or(0, |ascii| u32::from(ascii.id())),
                _ => self.ram.ascii_rate_hz[index],
            };
            return Ok(argument.map_or(value.to_string(), |argument| format!("{value},{argument}")));
        }
        let values = match register {
            USER_TAG => self.ram.user_tag.clone(),
            COMMUNICATION => self.ram.communication.to_string(),
            SYNCHRONIZATION => self.ram.synchronization.to_string(),
            BINARY_OUTPUT_1..=BINARY_OUTPUT_3 => self.ram.outputs[usize::from(register - BINARY_OUTPUT_1)].to_string(),
            IMU_FILTER => self.ram.filter.to_string(),
            _ => {
                let plain = self.fixed.get(&register).or_else(|| self.ram.plain.get(&register));
                plain.ok_or(DeviceError::InvalidRegister)?.clone()
            }
        };
        if argument.is_some() { Err(DeviceError::TooManyParameters) } else { Ok(values) }
    }

    /// Writes a register in RAM.
    ///
    /// # Errors
    /// The error that the sensor reports; then nothing is changed.
    pub fn write(&mut self, register: u16, values: &str) -> Result<(), DeviceError> {
        let read_only = PLAIN.iter().any(|(number, _, writable)| *number == register && !writable);
        if read_only || self.fixed.contains_key(&register) || AsciiType::from_register(register).is_some() {
            return Err(DeviceError::UnauthorizedAccess);
        }
        let mut settings = self.ram.clone();
        self.apply(&mut settings, register, values)?;
        let concerns_link =
            matches!(register, BAUD_RATE | ASYNC_TYPE | ASYNC_RATE | COMMUNICATION | BINARY_OUTPUT_1..=BINARY_OUTPUT_3);
        if concerns_link && !settings.fits() {
            return Err(DeviceError::InsufficientBaudRate);
        }
        self.ram = settings;
        Ok(())
    }

    fn apply(&self, settings: &mut Settings, register: u16, values: &str) -> Result<(), DeviceError> {
        let count = if values.is_empty() { 0 } else { values.split(',').count() };
        let invalid = DeviceError::InvalidParameter;
        match register {
            USER_TAG => {
                if values.len() > USER_TAG_BYTES {
                    return Err(invalid);
                }
                values.clone_into(&mut settings.user_tag);
            }
            BAUD_RATE..=ASYNC_RATE => {
                if count == 0 || count > 2 {
                    expect_count(count, 1)?;
                }
                let (value, port) = values.split_once(',').map_or((values, None), |(value, port)| (value, Some(port)));
                let index = port.map_or(Ok(self.port_index()), |port| self.named_port(port))?;
                let value: u32 = value.parse().map_err(|_| invalid)?;
                return self.apply_port_value(settings, register, index, value);
            }
            COMMUNICATION => {
                expect_count(count, 7)?;
                let control = CommunicationControl::parse(values).map_err(|_| invalid)?;
                let in_range = control.serial_count <= 5
                    && control.serial_status <= 6
                    && matches!(control.serial_checksum, 1 | 3)
                    && control.error_mode <= 2;
                if !in_range {
                    return Err(invalid);
                }
                settings.communication = control;
            }
            SYNCHRONIZATION => {
                expect_count(count, 9)?;
                let control = SyncControl::parse(values).map_err(|_| invalid)?;
                if control.sync_out_mode > 6 || control.sync_out_polarity > 1 {
                    return Err(invalid);
                }
                settings.synchronization = control;
            }
            BINARY_OUTPUT_1..=BINARY_OUTPUT_3 => {
                // whatever the error in a binary output, a sensor reports 07
                let output = BinaryOutput::parse(register, values).map_err(|_| invalid)?;
                let divides = output.rate_divisor > 0 || output.async_mode == 0;
                if output.async_mode > 3 || !divides {
                    return Err(invalid);
                }
                settings.outputs[usize::from(register - BINARY_OUTPUT_1)] = output;
            }
            IMU_FILTER => {
                expect_count(count, 10)?;
                let filter = ImuFilter::parse(values).map_err(|_| invalid)?;
                if filter.modes.iter().any(|mode| *mode > 3) {
                    return Err(invalid);
                }
                settings.filter = filter;
            }
            _ => {
                let plain = settings.plain.get_mut(&register).ok_or(DeviceError::InvalidRegister)?;
                expect_count(count, plain.split(',').count())?;
                if !are_numbers(values) {
                    return Err(invalid);
                }
                values.clone_into(plain);
            }
        }
        Ok(())
    }

    fn apply_port_value(
        &self,
        settings: &mut Settings,
        register: u16,
        index: usize,
        value: u32,
    ) -> Result<(), DeviceError> {
        let invalid = DeviceError::InvalidParameter;
        match register {
            BAUD_RATE => {
                if !BAUD_RATES.contains(&value) {
                    return Err(invalid);
                }
                settings.baud[index] = value;
            }
            ASYNC_TYPE => {
                let id = u8::try_from(value).map_err(|_| invalid)?;
                let ascii = AsciiType::from_id(id);
                // VNDCM does not exist in firmware 3.1
                let absent = ascii == Some(AsciiType::Dcm) && self.firmware >= (3, 1);
                if absent || (ascii.is_none() && id != 0) {
                    return Err(invalid);
                }
                settings.ascii[index] = ascii;
            }
            _ => {
                if value != 0 && !ASCII_RATES_HZ.contains(&value) {
                    return Err(invalid);
                }
                settings.ascii_rate_hz[index] = value;
            }
        }
        Ok(())
    }

    /// Returns the number of ticks of 1/800 s between two ASCII messages of the port in use; `None` if none is sent.
    pub fn ascii_period_ticks(&self) -> Option<u64> {
        let rate = self.ram.ascii_rate_hz[self.port_index()];
        (rate != 0).then(|| u64::from(link::INTERNAL_RATE_HZ / rate))
    }
}

const _: () = {
    // every rate of register 7 is a whole number of ticks
    let mut index = 0;
    while index < ASCII_RATES_HZ.len() {
        assert!(INTERNAL_RATE_HZ.is_multiple_of(ASCII_RATES_HZ[index]));
        index += 1;
    }
};

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> RegisterFile {
        RegisterFile::new(&SensorOptions::default())
    }

    #[test]
    fn the_defaults_are_those_of_a_delivered_sensor() {
        let file = file();
        for (register, values) in [
            (3, "0100012345"),
            (4, "3.1.0.0"),
            (5, "115200"),
            (6, "14"),
            (7, "40"),
            (23, "1,0,0,0,1,0,0,0,1,0,0,0"),
            (26, "1,0,0,0,1,0,0,0,1"),
            (30, "0,0,0,0,1,0,1"),
            (32, "3,0,0,0,6,1,0,100000000,0"),
            (35, "1,1,1,1"),
            (44, "0,1,5"),
            (75, "0,0,0"),
            (77, "0,0,0"),
            (82, "0,0,0,0,0"),
            (85, "0,4,4,4,0,0,3,3,3,0"),
        ] {
            assert_eq!(file.read(register, None).as_deref(), Ok(values), "register {register}");
        }
        assert!(file.read(0, None).unwrap().contains("emulator"));
        assert!(file.settings().fits());
    }

    #[test]
    fn a_refused_write_changes_nothing() {
        use DeviceError::{
            InsufficientBaudRate, InvalidParameter, InvalidRegister, NotEnoughParameters, TooManyParameters,
            UnauthorizedAccess,
        };
        let mut file = file();
        let before = file.settings().clone();
        for (register, values, error) in [
            (7, "", NotEnoughParameters),
            (30, "0,0,0", NotEnoughParameters),
            (85, "0,4", NotEnoughParameters),
            (30, "0,0,0,0,1,0,1,0", TooManyParameters),
            (6, "14,1,1", TooManyParameters),
            (6, "20", InvalidParameter),
            (6, "9", InvalidParameter),
            (7, "3", InvalidParameter),
            (7, "x", InvalidParameter),
            (7, "40,3", InvalidParameter),
            (5, "12345", InvalidParameter),
            (30, "0,0,0,0,2,0,1", InvalidParameter),
            (75, "1,20", InvalidParameter),
            (75, "1,20,01,0609,0001", InvalidParameter),
            (75, "1,0,01,0609", InvalidParameter),
            (75, "4,20,01,0609", InvalidParameter),
            (75, "1,20,08,0001", InvalidParameter),
            (23, "1,0,0,0,1,0,0,0,1,0,0,x", InvalidParameter),
            (0, "a tag of more than twenty characters", InvalidParameter),
            (99, "1", InvalidRegister),
            (1, "VN-200", UnauthorizedAccess),
            (8, "1,2,3", UnauthorizedAccess),
            (47, "1,0,0,0,1,0,0,0,1,0,0,0", UnauthorizedAccess),
            (7, "100", InsufficientBaudRate),
            (75, "1,1,01,0609", InsufficientBaudRate),
            (5, "38400", InsufficientBaudRate),
        ] {
            assert_eq!(file.write(register, values), Err(error), "{register},{values}");
        }
        assert_eq!(file.settings(), &before);
    }

    #[test]
    fn the_link_carries_what_the_arithmetic_allows() {
        // VNYMR 122 bytes: 50 Hz is 53 % of 115200 baud, 100 Hz is 106 %
        let mut file = file();
        assert_eq!(file.write(7, "50"), Ok(()));
        assert_eq!(file.write(7, "100"), Err(DeviceError::InsufficientBaudRate));
        // 110 bytes at 800 Hz through 921600 baud (95.5 %), once the text is off
        assert_eq!(file.write(5, "921600"), Ok(()));
        assert_eq!(file.write(75, "1,1,01,0739"), Err(DeviceError::InsufficientBaudRate));
        assert_eq!(file.write(6, "0"), Ok(()));
        assert_eq!(file.write(75, "1,1,01,0739"), Ok(()));
        // a second output does not fit any more; on the other port it does not interfere
        assert_eq!(file.write(76, "1,20,01,0609,"), Err(DeviceError::InvalidParameter));
        assert_eq!(file.write(76, "1,8,01,0739"), Err(DeviceError::InsufficientBaudRate));
        assert_eq!(file.write(76, "2,40,01,0609"), Ok(()));
    }

    #[test]
    fn the_ports_have_settings_of_their_own() {
        let mut file = file();
        assert_eq!(file.write(6, "1,2"), Ok(()));
        assert_eq!(file.write(5, "230400,2"), Ok(()));
        assert_eq!(file.read(6, Some("2")).as_deref(), Ok("1,2"));
        assert_eq!(file.read(6, Some("1")).as_deref(), Ok("14,1"));
        assert_eq!(file.read(6, None).as_deref(), Ok("14"));
        assert_eq!(file.read(5, Some("?")).as_deref(), Ok("115200,?"));
        assert_eq!(file.read(5, Some("3")), Err(DeviceError::InvalidParameter));
        assert_eq!(file.read(30, Some("1")), Err(DeviceError::TooManyParameters));
        assert_eq!(file.read(98, None), Err(DeviceError::InvalidRegister));
    }

    #[test]
    fn flash_is_written_only_on_command() {
        let mut file = file();
        file.write(7, "20").unwrap();
        assert_eq!(file.flash_writes(), 0);
        file.load();
        assert_eq!(file.read(7, None).as_deref(), Ok("40"));
        file.write(7, "20").unwrap();
        file.save();
        file.load();
        assert_eq!((file.read(7, None).as_deref(), file.flash_writes()), (Ok("20"), 1));
        file.restore_factory();
        assert_eq!((file.read(7, None).as_deref(), file.flash_writes()), (Ok("40"), 2));
        file.preset(85, "0,20,20,20,0,0,3,3,3,0").unwrap();
        file.preset(1, "VN-100S-CR").unwrap();
        file.load();
        assert_eq!(file.read(85, None).as_deref(), Ok("0,20,20,20,0,0,3,3,3,0"));
        assert_eq!((file.read(1, None).as_deref(), file.flash_writes()), (Ok("VN-100S-CR"), 2));
    }
}
