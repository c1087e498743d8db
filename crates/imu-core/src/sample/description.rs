//! Descriptions: a capture's sensor and how it was configured, as the database and the interfaces hold them.
//!
//! These JSON documents keep all keys that they came with. The program reads them through the methods here.

use crate::units::IMU_RATE_HZ;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt;

/// Register contents by number.
pub type Registers = BTreeMap<u16, String>;

/// A sensor as found when it was connected. A register that the sensor does not have is absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ConnectedSensor {
    /// The port's name.
    pub port: Option<String>,
    /// The baud rate.
    pub baud: Option<u32>,
    /// Register 1: the model.
    pub model: Option<String>,
    /// Register 2: the hardware revision.
    pub hardware_revision: Option<String>,
    /// Register 3: the serial number.
    pub serial_number: Option<String>,
    /// Register 4: the firmware version.
    pub firmware: Option<String>,
    /// The recorded measurements: the name of a message, or the groups and fields of a binary output.
    pub output: String,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// Register 85: the filter windows.
    pub filter_window: Option<Register85>,
    /// The latency timer of the port's adapter, if it has one.
    pub latency_timer_ms: Option<u32>,
    /// The registers that were read.
    pub registers: Registers,
    /// The output registers before the program changed them.
    pub previous_output: Registers,
}

impl ConnectedSensor {
    /// Returns the description that identifies the sensor.
    pub fn sensor(&self) -> SensorDescription {
        #[derive(Serialize)]
        struct Identity<'a> {
            model: &'a Option<String>,
            serial_number: &'a Option<String>,
            firmware: &'a Option<String>,
            hardware_revision: &'a Option<String>,
        }
        let Self { model, serial_number, firmware, hardware_revision, .. } = self;
        SensorDescription::of(&Identity { model, serial_number, firmware, hardware_revision })
    }

    /// Returns all data as the configuration of a capture.
    pub fn configuration(&self) -> CaptureConfiguration {
        CaptureConfiguration::of(self)
    }
}

/// Windows of the sensor's filters in internal samples; 0 and 1 are no averaging.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FilterWindows {
    /// Window of the magnetometer.
    pub mag: u32,
    /// Window of the accelerometer.
    pub accel: u32,
    /// Window of the gyroscope.
    pub gyro: u32,
}

impl FilterWindows {
    /// The factory setting (user manual UM001 rev 2.45, table of factory defaults; confirmed by the autocorrelation of
    /// a unit's 800 Hz output).
    pub const FACTORY: Self = Self { mag: 0, accel: 4, gyro: 4 };

    /// Returns the windows as a user states them. There is no such statement for the magnetometer.
    pub fn stated(window: u32) -> Self {
        Self { mag: 0, accel: window, gyro: window }
    }
}

/// All windows of register 85.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Register85 {
    /// The windows of the inertial sensors and the magnetometer.
    #[serde(flatten)]
    pub windows: FilterWindows,
    /// Window of the temperature.
    pub temperature: u32,
    /// Window of the pressure.
    pub pressure: u32,
}

impl Register85 {
    /// Parses the register's contents.
    pub fn parse(text: &str) -> Option<Self> {
        let windows: Vec<u32> = text.split(',').take(5).filter_map(|field| field.trim().parse().ok()).collect();
        let [mag, accel, gyro, temperature, pressure] = windows[..] else { return None };
        Some(Self { windows: FilterWindows { mag, accel, gyro }, temperature, pressure })
    }
}

/// The user's statement that the sensor sends means of its own samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedSampling {
    /// Number of samples per mean.
    pub filter_window: u32,
    /// Rate of these samples, Hz. Without it the known rate is used, else that of a VN-100.
    #[serde(default)]
    pub internal_rate_hz: Option<f64>,
}

impl StatedSampling {
    /// Returns the statement in the form stored with a capture.
    pub fn kept(self) -> Self {
        Self { internal_rate_hz: Some(self.internal_rate_hz.unwrap_or(IMU_RATE_HZ)), ..self }
    }
}

/// Describes a capture's sensor; an empty object if nothing is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SensorDescription(Value);

impl SensorDescription {
    /// Returns the model.
    pub fn model(&self) -> Option<&str> {
        self.0["model"].as_str()
    }
    /// Returns the serial number.
    pub fn serial_number(&self) -> Option<&str> {
        self.0["serial_number"].as_str()
    }
    /// Returns the version of the firmware.
    pub fn firmware(&self) -> Option<&str> {
        self.0["firmware"].as_str()
    }
}

/// Describes how a capture was configured, imported or simulated; an empty object if nothing is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct CaptureConfiguration(Value);

impl CaptureConfiguration {
    /// Returns the measurements that a sensor sent ([`ConnectedSensor::output`]).
    pub fn output(&self) -> Option<&str> {
        self.0["output"].as_str()
    }
    /// Returns the output registers before the program changed them.
    pub fn previous_output(&self) -> Registers {
        Registers::deserialize(&self.0["previous_output"]).unwrap_or_default()
    }
    /// Returns the filter windows of register 85.
    pub fn register_85(&self) -> Option<FilterWindows> {
        FilterWindows::deserialize(&self.0["filter_window"]).ok()
    }
    /// Returns the sampling that the user stated at an import.
    pub fn stated_sampling(&self) -> Option<StatedSampling> {
        StatedSampling::deserialize(&self.0["sampling"]).ok().map(StatedSampling::kept)
    }
    /// Returns the filter windows: those of register 85, else those stated at the import.
    pub fn filter_windows(&self) -> Option<FilterWindows> {
        self.register_85().or_else(|| Some(FilterWindows::stated(self.stated_sampling()?.filter_window)))
    }
    /// Returns the kind of recording that was imported.
    pub fn recording_kind(&self) -> Option<&str> {
        self.0["kind"].as_str()
    }
    /// Returns the first stamp of an imported recording on its own clock, s.
    pub fn first_stamp_s(&self) -> Option<f64> {
        self.0["first_stamp_s"].as_f64()
    }
    /// Returns remarks for the user about an imported recording, one sentence each.
    pub fn remarks(&self) -> impl Iterator<Item = &str> {
        self.0["remarks"].as_array().into_iter().flatten().filter_map(Value::as_str)
    }
}

macro_rules! document {
    ($($name:ident),*) => {$(
        impl $name {
            /// Returns the document with the keys of this data. Data that JSON cannot express gives an empty document.
            pub fn of(data: &impl Serialize) -> Self {
                serde_json::to_value(data).map_or_else(|_| Self::default(), Self)
            }

            /// Returns the keys with their values.
            pub fn entries(&self) -> impl Iterator<Item = (&str, &Value)> {
                self.0.as_object().into_iter().flatten().map(|(key, value)| (key.as_str(), value))
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self(json!({}))
            }
        }

        impl From<Value> for $name {
            fn from(document: Value) -> Self {
                Self(document)
            }
        }

        /// Writes the JSON text.
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    )*};
}
document!(SensorDescription, CaptureConfiguration);

#[cfg(test)]
mod tests {
    use super::*;

    /// As databases of earlier versions hold them.
    #[test]
    fn a_connected_sensor_is_written_as_before() {
        let connected = ConnectedSensor {
            port: Some("/dev/ttyUSB0".to_owned()),
            model: Some("VN-100".to_owned()),
            output: "VNYMR".to_owned(),
            rate_hz: 40.0,
            filter_window: Register85::parse("0,4,5,6,7"),
            registers: [(2, "7".to_owned()), (85, "0,4,5,6,7".to_owned()), (9, "1".to_owned())].into(),
            previous_output: [(6, "14".to_owned())].into(),
            ..ConnectedSensor::default()
        };
        assert_eq!(
            connected.configuration().to_string(),
            r#"{"baud":null,"filter_window":{"accel":4,"gyro":5,"mag":0,"pressure":7,"temperature":6},"firmware":null,"hardware_revision":null,"latency_timer_ms":null,"model":"VN-100","output":"VNYMR","port":"/dev/ttyUSB0","previous_output":{"6":"14"},"rate_hz":40.0,"registers":{"2":"7","85":"0,4,5,6,7","9":"1"},"serial_number":null}"#
        );
        assert_eq!(
            connected.sensor().to_string(),
            r#"{"firmware":null,"hardware_revision":null,"model":"VN-100","serial_number":null}"#
        );
        let read = connected.configuration();
        assert_eq!(read.register_85(), Some(FilterWindows { mag: 0, accel: 4, gyro: 5 }));
        assert_eq!((read.output(), read.previous_output()), (Some("VNYMR"), connected.previous_output));
        assert_eq!(Register85::parse("0,4,5"), None);
    }

    #[test]
    fn unknown_keys_stay_and_odd_values_are_absent() {
        let text = r#"{"colour":"red","filter_window":7,"model":3,"remarks":["one",2,"three"]}"#;
        let configuration: CaptureConfiguration = serde_json::from_str(text).unwrap();
        assert_eq!(configuration.to_string(), text);
        assert_eq!(configuration.remarks().collect::<Vec<_>>(), ["one", "three"]);
        assert_eq!((configuration.filter_windows(), configuration.recording_kind()), (None, None));
        assert!(configuration.previous_output().is_empty());
        assert_eq!(SensorDescription::from(json!(null)).model(), None);
    }

    /// A datasheet was compared at the factory's windows, for any stated window.
    #[test]
    fn register_85_precedes_what_an_import_stated() {
        let stated = json!({ "filter_window": 8, "internal_rate_hz": 800.0 });
        let windows = |mag, window| Some(FilterWindows { mag, accel: window, gyro: window });
        let of = |document| CaptureConfiguration::from(document).filter_windows();
        assert_eq!(of(json!({ "sampling": stated })), windows(0, 8));
        assert_eq!(
            of(json!({ "filter_window": { "mag": 3, "accel": 5, "gyro": 5 }, "sampling": stated })),
            windows(3, 5)
        );
        assert_eq!(of(json!({})), None);
        let kept = CaptureConfiguration::from(json!({ "sampling": { "filter_window": 5 } }));
        assert_eq!(kept.stated_sampling().unwrap().internal_rate_hz, Some(IMU_RATE_HZ));
    }
}
