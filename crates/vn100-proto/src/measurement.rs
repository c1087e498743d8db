//! Measurements: one decoded message with all its content, and its conversion to a [`Sample`].

use super::quantity::QuantitySet;
use super::{AsciiType, BinaryHeader, Quantity};
use imu_core::sample::{Channel, ChannelSet, Sample};

/// The message of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum MeasurementKind {
    /// An asynchronous ASCII message.
    Ascii(AsciiType),
    /// A binary output with this header.
    Binary(BinaryHeader),
}

impl MeasurementKind {
    /// Returns the common name of the output: `VNYMR`, `binary 01,0609`.
    pub fn output_name(&self) -> String {
        match self {
            Self::Ascii(ascii) => ascii.header().to_owned(),
            Self::Binary(header) => format!("binary {header}"),
        }
    }
    /// Returns the quantities of the message.
    pub fn quantities(&self) -> QuantitySet {
        match self {
            Self::Ascii(ascii) => {
                let mut set = QuantitySet::EMPTY;
                ascii.quantities().iter().for_each(|quantity| set.insert(*quantity));
                set
            }
            Self::Binary(header) => header.quantities(),
        }
    }
    /// Returns the channels of the message's samples (if every value is finite).
    pub fn channels(&self) -> ChannelSet {
        self.quantities().iter().flat_map(|quantity| quantity.channels().iter().copied()).collect()
    }
    /// Returns whether the message has TimeStartup; no ASCII message does.
    pub fn has_device_time(&self) -> bool {
        match self {
            Self::Ascii(_) => false,
            Self::Binary(header) => header.has_time_startup(),
        }
    }
}

impl std::fmt::Display for MeasurementKind {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.output_name())
    }
}

const NO_DECIMALS: u8 = u8::MAX;

/// One decoded message. Numbers of a binary message are its 32-bit floats, widened exactly; numbers of a line are the
/// doubles nearest to the decimals.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// The message.
    pub kind: MeasurementKind,
    /// TimeStartup, ns since the sensor's reset.
    pub device_time_ns: Option<u64>,
    /// The serial count of a line (`T…`; register 30 selects what it counts), or a binary output's SyncOutCnt.
    pub sync_count: Option<u32>,
    /// VPE status: the status of a line (`S…`, if register 30 has SerialStatus 1), or the binary field.
    pub vpe_status: Option<u16>,
    /// Time since the last SyncIn pulse, ns.
    pub time_sync_in_ns: Option<u64>,
    /// SyncIn pulses since reset.
    pub sync_in_count: Option<u32>,
    /// TimeStatus of the time group.
    pub time_status: Option<u8>,
    /// ImuStatus of the IMU group (reserved, 0).
    pub imu_status: Option<u16>,
    /// SensSat of the IMU group.
    pub sensor_saturation: Option<u16>,
    present: QuantitySet,
    values: [f64; Quantity::TOTAL_LEN],
    decimals: [u8; Quantity::COUNT],
}

impl Measurement {
    /// Creates a measurement of that kind without values.
    pub fn new(kind: MeasurementKind) -> Self {
        Self {
            kind,
            device_time_ns: None,
            sync_count: None,
            vpe_status: None,
            time_sync_in_ns: None,
            sync_in_count: None,
            time_status: None,
            imu_status: None,
            sensor_saturation: None,
            present: QuantitySet::EMPTY,
            values: [0.0; Quantity::TOTAL_LEN],
            decimals: [NO_DECIMALS; Quantity::COUNT],
        }
    }

    /// Returns the quantity's numbers, `quantity.components()` of them, if the message carried it.
    pub fn get(&self, quantity: Quantity) -> Option<&[f64]> {
        self.present.contains(quantity).then(|| &self.values[quantity.range()])
    }

    /// Returns the three numbers of a quantity with three components.
    pub fn vector(&self, quantity: Quantity) -> Option<[f64; 3]> {
        self.get(quantity)?.try_into().ok()
    }

    /// Returns the number of a quantity with one component.
    pub fn scalar(&self, quantity: Quantity) -> Option<f64> {
        let [value] = self.get(quantity)?.try_into().ok()?;
        Some(value)
    }

    /// Sets a quantity. Surplus values are dropped, missing ones are 0.
    pub fn set(&mut self, quantity: Quantity, values: &[f64]) {
        let slots = self.slots(quantity);
        slots.fill(0.0);
        for (slot, value) in slots.iter_mut().zip(values) {
            *slot = *value;
        }
    }

    /// Returns the quantity's place, marked as present.
    pub(super) fn slots(&mut self, quantity: Quantity) -> &mut [f64] {
        self.present.insert(quantity);
        &mut self.values[quantity.range()]
    }

    /// Returns the quantity's numbers whether present or not: absent ones are 0.
    pub(super) fn values_or_zero(&self, quantity: Quantity) -> &[f64] {
        &self.values[quantity.range()]
    }

    /// Records the digits behind the point of a line's number; of several numbers the highest count is kept.
    pub(super) fn note_decimals(&mut self, quantity: Quantity, decimals: u8) {
        let noted = &mut self.decimals[quantity as usize];
        *noted = if *noted == NO_DECIMALS { decimals } else { decimals.max(*noted) };
    }

    /// Returns the quantities that the message carried.
    pub fn quantities(&self) -> QuantitySet {
        self.present
    }

    /// Returns the digits behind the point with which the line printed this channel: its resolution is 10⁻ᵈ of the
    /// channel's unit. `None` for binary messages and absent channels. Firmware 1 prints fewer digits than firmware 2
    /// and 3.
    pub fn decimals(&self, channel: Channel) -> Option<u8> {
        // the same precedence as in `to_sample`: the last quantity that fills the channel counts
        Quantity::ALL
            .into_iter()
            .rev()
            .filter(|quantity| self.present.contains(*quantity) && quantity.channels().contains(&channel))
            .map(|quantity| self.decimals[quantity as usize])
            .find(|decimals| *decimals != NO_DECIMALS)
    }

    /// Returns the measurement as a sample that arrived at this host time.
    ///
    /// If a message carries a vector both compensated and uncompensated, the uncompensated one is used for gyroscope,
    /// accelerometer and magnetometer. The on-board filter has removed its own bias estimate from the compensated one,
    /// which would remove slow noise from an Allan deviation. Values that are not finite leave their channel absent.
    pub fn to_sample(&self, host_mono_ns: u64, host_utc_ns: i64) -> Sample {
        let mut sample = Sample::at(host_mono_ns, host_utc_ns);
        sample.device_time_ns = self.device_time_ns;
        sample.sync_count = self.sync_count;
        // compensated quantities stand before uncompensated ones, which therefore win
        for quantity in Self::SAMPLED {
            if self.present.contains(quantity) {
                for (channel, value) in quantity.channels().iter().zip(&self.values[quantity.range()]) {
                    sample.set(*channel, *value);
                }
            }
        }
        sample
    }

    const SAMPLED: [Quantity; 9] = [
        Quantity::YawPitchRoll,
        Quantity::Mag,
        Quantity::Accel,
        Quantity::AngularRate,
        Quantity::UncompMag,
        Quantity::UncompAccel,
        Quantity::UncompGyro,
        Quantity::Temperature,
        Quantity::Pressure,
    ];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_uncompensated_value_wins() {
        let mut measurement = Measurement::new(MeasurementKind::Ascii(AsciiType::Imu));
        measurement.set(Quantity::UncompGyro, &[1.0, 2.0, 3.0]);
        measurement.set(Quantity::AngularRate, &[10.0, 20.0, 30.0]);
        measurement.set(Quantity::Accel, &[0.0, 0.0, -9.8]);
        measurement.set(Quantity::LinearAccelBody, &[5.0, 5.0, 5.0]);
        measurement.set(Quantity::Temperature, &[f64::NAN]);
        let sample = measurement.to_sample(7, 8);
        assert_eq!(sample.get(Channel::GyroY), Some(2.0));
        assert_eq!(sample.get(Channel::AccelZ), Some(-9.8));
        assert_eq!(sample.get(Channel::AccelX), Some(0.0));
        assert_eq!(sample.get(Channel::Temperature), None);
        assert_eq!((sample.host_mono_ns, sample.host_utc_ns), (7, 8));
    }

    #[test]
    fn a_quantity_is_absent_until_it_is_set() {
        let mut measurement = Measurement::new(MeasurementKind::Ascii(AsciiType::Ypr));
        assert_eq!(measurement.vector(Quantity::YawPitchRoll), None);
        measurement.set(Quantity::YawPitchRoll, &[1.0, 2.0]);
        assert_eq!(measurement.vector(Quantity::YawPitchRoll), Some([1.0, 2.0, 0.0]));
        assert_eq!(measurement.scalar(Quantity::Pressure), None);
    }

    #[test]
    fn an_output_is_named_as_people_name_it() {
        assert_eq!(MeasurementKind::Ascii(AsciiType::Ymr).output_name(), "VNYMR");
        let header = BinaryHeader::parse_register("01,0609").unwrap();
        assert_eq!(MeasurementKind::Binary(header).to_string(), "binary 01,0609");
        assert!(MeasurementKind::Binary(header).has_device_time());
        let channels = MeasurementKind::Binary(header).channels();
        assert_eq!(channels.iter().count(), 14);
    }
}
