//! Sensor models: the file format of docs/formats.md. JSON text is read to checked parameters, and written back.
//!
//! Refused with the file, the path inside it, the value found and the values allowed: unknown keys, channels and
//! effects, parameters outside their ranges, tones from half the rate up, rates that do not divide one another,
//! disagreement of channels about shared effects. No input is ignored silently. The lists in the messages, and the JSON
//! Schema ([`schema`], committed as `docs/sensor-model.schema.json`), come from [`crate::effects::registry`].
//!
//! A key that occurs twice is refused: one of the two would be ignored.
//!
//! `provenance` (top level) may hold any value and is written back. `uncertainty` (per channel) has entries for N, B, K
//! and bias, and a list `effects` beside the channel's effects: for each effect, an object of the parameters whose
//! uncertainty is known. An entry is `{"ci95": [low, high]}` or `{"upper_limit95": limit}`, in the parameter's unit.

mod check;
mod place;
mod read;
#[cfg(test)]
mod round_trip;
pub mod schema;
mod uncertainty;
mod unique;
mod write;

pub use check::Fault;

use crate::effects::{Effect, TriadEffect};
use imu_core::sample::{Channel, Triad};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The format's name; a change that old readers would misread gets a new number.
pub const FORMAT: &str = "vn100d-sensor-model-1";

/// Keys of a file, a channel, a triad, and of `sampling`.
const KEYS: [&str; 7] = ["format", "name", "rate_hz", "channels", "triads", "sampling", "provenance"];
const CHANNEL_KEYS: [&str; 6] = ["N", "B", "K", "bias", "effects", "uncertainty"];
const TRIAD_KEYS: [&str; 1] = ["effects"];
const SAMPLING_KEYS: [&str; 2] = ["internal_rate_hz", "filter_window"];
/// Parameters whose uncertainty a channel may state, and the list of its effects' parameters.
const UNCERTAIN_KEYS: [&str; 5] = ["N", "B", "K", "bias", EFFECTS];
const EFFECTS: &str = "effects";
/// The triads that may carry effects.
const TRIADS: [Triad; 4] = [Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro];

/// The reason why a sensor model was refused.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The text is not JSON.
    #[error("{file} is not JSON: {source}")]
    Syntax {
        /// The source of the text.
        file: String,
        /// The error of the parser, with line and column.
        source: serde_json::Error,
    },
    /// A value in the text is not allowed.
    #[error("{file}: {path}: found {found}; expected {expected}")]
    Content {
        /// The source of the text.
        file: String,
        /// The place inside the text, such as `channels.gyro_x.N`.
        path: String,
        /// The value that was found.
        found: String,
        /// The values that are allowed.
        expected: String,
    },
}

/// The parameters of one channel; U is the channel's unit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChannelModel {
    /// White noise, U/√Hz (two-sided PSD N²).
    pub n: f64,
    /// Flicker noise, U (two-sided PSD B²/(2πf)).
    pub b: f64,
    /// Rate random walk, U/√s (two-sided PSD (K/2πf)²).
    pub k: f64,
    /// A constant, U.
    pub bias: Option<f64>,
    /// Further error sources. Their order matters only among several of one kind: each of these has its own random
    /// stream
    pub effects: Vec<Arc<dyn Effect>>,
    /// The accuracy of the parameters: entries for N, B, K and bias, such as `{"N": {"ci95": […]}}`, and under `effects` a list
    /// of objects, one for each of `effects`, such as `[{"tau_s": {"ci95": […]}}]`. Read and written by
    /// [`ChannelModel::interval`], [`ChannelModel::effect_interval`], [`ChannelModel::push_effect`] and their neighbours.
    pub uncertainty: Option<Map<String, Value>>,
}

/// The effects of one triad.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriadModel {
    /// The response of its axes to a motion.
    pub effects: Vec<Arc<dyn TriadEffect>>,
}

/// How a sensor computes its output from its own samples: the mean of the last `filter_window` samples, of which every
/// n-th is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling {
    /// The sensor's own rate, a whole multiple of the output's.
    pub internal_rate_hz: f64,
    /// Number of averaged samples at that rate, from 1.
    pub filter_window: u64,
}

impl Sampling {
    /// Returns the factor from the sensor's own white density to the one at `rate_hz`, at low frequencies: √Σ |H(kR)|²
    /// over the images k of the output's rate R, with H the boxcar's response. 1 if the rates do not divide one
    /// another.
    pub fn density_factor(self, rate_hz: f64) -> f64 {
        let images = self.decimation(rate_hz).unwrap_or(1);
        let gain = |image: usize| {
            crate::effects::moving_average::boxcar_gain(self.filter_window, image as f64 / images as f64)
        };
        (0..images).map(gain).sum::<f64>().sqrt()
    }
}

/// A sensor: the simulator's input.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SensorModel {
    /// A name for display.
    pub name: String,
    /// The output rate in Hz.
    pub rate_hz: f64,
    /// The channels of the sensor, in column order.
    pub channels: BTreeMap<Channel, ChannelModel>,
    /// Effects on triads.
    pub triads: BTreeMap<Triad, TriadModel>,
    /// If given, N, B and K are the sensor's own, before its boxcar and decimation; otherwise they are those at
    /// `rate_hz`.
    pub sampling: Option<Sampling>,
    /// The source of the model, in any form.
    pub provenance: Option<Map<String, Value>>,
}

impl SensorModel {
    /// Returns the rate at which the chain runs before sampling, for an output at `rate_hz`.
    pub fn internal_rate_hz(&self, rate_hz: f64) -> f64 {
        self.sampling.map_or(rate_hz, |sampling| sampling.internal_rate_hz)
    }

    /// Returns the model of a sensor that sends only some of its channels. Effects on a triad stay if one of its channels does.
    #[must_use]
    pub fn only(mut self, wanted: &[Channel]) -> Self {
        self.channels.retain(|channel, _| wanted.contains(channel));
        self.triads.retain(|triad, _| triad.channels().iter().any(|channel| self.channels.contains_key(channel)));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        SensorModel::from_json(text, "m.json").unwrap_err().to_string()
    }
    fn with_gyro_x(body: &str) -> String {
        format!(r#"{{"format":"vn100d-sensor-model-1","name":"t","rate_hz":40,"channels":{{"gyro_x":{body}}}}}"#)
    }

    #[test]
    fn a_triads_effects_stay_with_one_of_its_channels() {
        let text = r#"{"format":"vn100d-sensor-model-1","name":"t","rate_hz":40,
            "channels":{"gyro_x":{},"gyro_y":{},"accel_z":{}},
            "triads":{"gyro":{"effects":[{"effect":"latency","seconds":0.1}]},"accel":{"effects":[{"effect":"latency","seconds":0.1}]}}}"#;
        let model = SensorModel::from_json(text, "m.json").unwrap().only(&[Channel::GyroX, Channel::MagX]);
        assert_eq!(model.channels.keys().copied().collect::<Vec<_>>(), [Channel::GyroX]);
        assert_eq!(model.triads.keys().copied().collect::<Vec<_>>(), [Triad::Gyro]);
    }

    #[test]
    fn a_model_is_read_with_missing_parameters_as_zero() {
        let model = SensorModel::from_json(&with_gyro_x(r#"{"N":1.2e-4,"K":4e-7,"effects":[]}"#), "m.json").unwrap();
        let expected = ChannelModel { n: 1.2e-4, k: 4e-7, ..ChannelModel::default() };
        assert_eq!(model.channels, [(Channel::GyroX, expected)].into());
        assert_eq!((model.name.as_str(), model.rate_hz), ("t", 40.0));
    }

    #[test]
    fn a_model_written_is_read_back() {
        let model = super::super::default_model();
        let text = serde_json::to_string_pretty(&model).unwrap();
        assert_eq!(SensorModel::from_json(&text, "m.json").unwrap(), model);
    }

    #[test]
    fn errors_name_file_path_and_what_is_allowed() {
        for (text, parts) in [
            (with_gyro_x(r#"{"N":-1}"#), ["m.json", "channels.gyro_x.N", "found -1", "0 or more"]),
            (with_gyro_x(r#"{"K":1e300}"#), ["m.json", "channels.gyro_x.K", "found 1e300", "from 0 to 1e30"]),
            (with_gyro_x(r#"{"bias":-1e31}"#), ["m.json", "channels.gyro_x.bias", "found -1e31", "from -1e30 to 1e30"]),
            (
                with_gyro_x(r#"{"effects":[{"effect":"tone","frequency_hz":11,"amplitude":1e40}]}"#),
                ["m.json", "channels.gyro_x.effects[0].amplitude", "found 1e+40", "0 or more of 1e30 at most"],
            ),
            (with_gyro_x(r#"{"N":"1"}"#), ["m.json", "channels.gyro_x.N", "found \"1\"", "a number"]),
            (
                with_gyro_x(r#"{"M":1}"#),
                ["m.json", "channels.gyro_x.M", "unknown key `M`", "N, B, K, bias, effects, uncertainty"],
            ),
            (with_gyro_x("[]"), ["m.json", "channels.gyro_x:", "found []", "an object"]),
            (
                with_gyro_x(r#"{"effects":[{"effect":"wobble"}]}"#),
                ["m.json", "channels.gyro_x.effects[0].effect", "found \"wobble\"", "one of resolution"],
            ),
            (
                with_gyro_x(r#"{"effects":[{"effect":"tone","frequency_hz":11}]}"#),
                ["m.json", "channels.gyro_x.effects[0].amplitude", "no `amplitude`", "0 or more, peak"],
            ),
            (
                with_gyro_x(r#"{"effects":[{"effect":"tone","frequency_hz":25,"amplitude":1}]}"#),
                ["m.json", "channels.gyro_x.effects[0].frequency_hz", "found 25 Hz", "below 20 Hz"],
            ),
            (
                with_gyro_x(r#"{"effects":[{"effect":"warm_up","amplitude":1,"tau":3}]}"#),
                ["m.json", "channels.gyro_x.effects[0].tau:", "unknown key `tau`", "one of amplitude, tau_s"],
            ),
            (
                with_gyro_x(r#"{"effects":[{"effect":"bursts","intervals":[[0,1],[3,2]],"sigma":1}]}"#),
                ["m.json", "channels.gyro_x.effects[0].intervals[1]", "found [3,2]", "from_s < to_s"],
            ),
            (
                with_gyro_x(r#"{"effects":[{"effect":"variance_change","from_s":1,"factor":2}]}"#),
                ["m.json", "channels.gyro_x.effects[0].from_s", "`factor`, `from_s`", "profile; or per_c"],
            ),
            (
                with_gyro_x(r#"{"uncertainty":{"Q":{}}}"#),
                ["m.json", "channels.gyro_x.uncertainty.Q", "unknown key `Q`", "one of N, B, K, bias, effects"],
            ),
            (
                with_gyro_x(r#"{"N":1e-4,"B":1e-5,"N":2e-4}"#),
                ["m.json", "channels.gyro_x.N:", "found `N` a second time", "every key once"],
            ),
            (
                with_gyro_x(r#"{"uncertainty":{"N":3}}"#),
                ["m.json", "channels.gyro_x.uncertainty.N:", "found 3", "an object"],
            ),
            (
                with_gyro_x(r#"{"uncertainty":{"N":{"ci_95":[1,2]}}}"#),
                ["m.json", "channels.gyro_x.uncertainty.N.ci_95", "unknown key", "one of ci95, upper_limit95"],
            ),
            (
                with_gyro_x(r#"{"uncertainty":{"N":{"ci95":[2,1]}}}"#),
                ["m.json", "channels.gyro_x.uncertainty.N.ci95", "found [2,1]", "low ≤ high"],
            ),
            (
                with_gyro_x(r#"{"uncertainty":{"N":{"ci95":[0,1,"x"]}}}"#),
                ["m.json", "channels.gyro_x.uncertainty.N.ci95", "found [0,1,\"x\"]", "[low, high]"],
            ),
            (
                with_gyro_x(r#"{"uncertainty":{"K":{"upper_limit95":-1}}}"#),
                ["m.json", "channels.gyro_x.uncertainty.K.upper_limit95", "found -1", "0 or more"],
            ),
            (
                with_gyro_x(r#"{"uncertainty":{"effects":[{}]}}"#),
                ["m.json", "channels.gyro_x.uncertainty.effects:", "found 1 entries", "the channel's effects, 0"],
            ),
            (
                with_gyro_x(
                    r#"{"effects":[{"effect":"rate_ramp","R":1}],"uncertainty":{"effects":[{"Q":{"ci95":[0,1]}}]}}"#,
                ),
                ["m.json", "channels.gyro_x.uncertainty.effects[0].Q", "unknown key `Q`", "one of R"],
            ),
            (
                with_gyro_x(r#"{"effects":[{"effect":"rate_ramp","R":1}],"uncertainty":{"effects":[{"R":[0,1]}]}}"#),
                ["m.json", "channels.gyro_x.uncertainty.effects[0].R:", "found [0,1]", "an object"],
            ),
            (with_gyro_x("{}").replace("gyro_x", "gyro_w"), ["m.json", "channels.gyro_w", "gyro_w", "gyro_x, gyro_y"]),
            (with_gyro_x("{}").replace("model-1", "model-2"), ["m.json", "format", "model-2", FORMAT]),
            (with_gyro_x("{}").replace("\"rate_hz\":40,", ""), ["m.json", "top level", "no `rate_hz`", "output rate"]),
            (with_gyro_x("{}").replace("40", "0"), ["m.json", "rate_hz", "found 0", "from 0.001 to 100000 Hz"]),
            (
                with_gyro_x("{}").replace(
                    "\"rate_hz\"",
                    "\"triads\":{\"gyro\":{\"effects\":[{\"effect\":\"scale_factor\",\"x\":1}]}},\"rate_hz\"",
                ),
                ["m.json", "triads.gyro.effects[0].y", "no `y`", "fraction that the y axis"],
            ),
            (
                with_gyro_x("{}")
                    .replace("\"rate_hz\"", "\"triads\":{\"gyro\":{\"effects\":[{\"effect\":\"tone\"}]}},\"rate_hz\""),
                ["m.json", "triads.gyro.effects[0].effect", "found \"tone\"", "one of bias, scale_factor"],
            ),
            (
                with_gyro_x("{}").replace(
                    "\"rate_hz\"",
                    "\"triads\":{\"accel\":{\"effects\":[{\"effect\":\"latency\",\"seconds\":0.1}]}},\"rate_hz\"",
                ),
                ["m.json", "triads.accel:", "no accel channel", "the model has"],
            ),
            (
                with_gyro_x("{}").replace("\"rate_hz\"", "\"sampling\":{\"internal_rate_hz\":800},\"rate_hz\""),
                ["m.json", "sampling:", "no `filter_window`", "from 1"],
            ),
            (
                with_gyro_x("{}")
                    .replace("\"rate_hz\"", "\"sampling\":{\"internal_rate_hz\":790,\"filter_window\":4},\"rate_hz\""),
                ["m.json", "sampling.internal_rate_hz", "found 790 Hz", "multiple of the output's rate, 40 Hz"],
            ),
            ("{".to_owned(), ["m.json", "not JSON", "line 1", "column"]),
        ] {
            let message = message(&text);
            for part in parts {
                assert!(message.contains(part), "{part:?} is not in {message:?}");
            }
        }
    }

    #[test]
    fn what_is_known_about_an_effect_goes_with_it() {
        let tone = |frequency_hz| Arc::new(crate::effects::Tone { frequency_hz, amplitude: 1e-3 }) as Arc<dyn Effect>;
        let mut channel = ChannelModel { n: 1e-4, ..ChannelModel::default() };
        channel.set_interval("N", [0.9e-4, 1.1e-4]);
        channel.push_effect(tone(3.0), &[]);
        channel.push_effect(tone(7.0), &[("frequency_hz", [6.9, 7.1]), ("amplitude", [f64::NAN, 1.0])]);
        let model = SensorModel {
            name: "t".into(),
            rate_hz: 40.0,
            channels: [(Channel::GyroX, channel)].into(),
            ..SensorModel::default()
        };
        let read = |model: &SensorModel| {
            let text = serde_json::to_string(model).unwrap();
            SensorModel::from_json(&text, "m.json").unwrap()
        };
        let mut again = read(&model);
        assert_eq!(again, model);
        let of = again.channels.get_mut(&Channel::GyroX).unwrap();
        assert_eq!((of.interval("N"), of.upper_limit("N")), (Some([0.9e-4, 1.1e-4]), None));
        assert_eq!(of.effect_interval(0, "frequency_hz"), None);
        assert_eq!(
            (of.effect_interval(1, "frequency_hz"), of.effect_interval(1, "amplitude")),
            (Some([6.9, 7.1]), None)
        );
        // A caller that pushes an effect directly must not produce a file that cannot be read.
        of.effects.push(tone(9.0));
        assert_eq!(of.remove_effect(0), Some(tone(3.0)));
        assert_eq!(of.effect_interval(0, "frequency_hz"), Some([6.9, 7.1]));
        assert_eq!(of.remove_effect(5), None);
        let of = &read(&again).channels[&Channel::GyroX];
        assert_eq!((of.effects.len(), of.effect_interval(0, "frequency_hz")), (2, Some([6.9, 7.1])));
        again.channels.values_mut().for_each(|of| of.effects.clear());
        assert_eq!(read(&again).channels[&Channel::GyroX].effect_interval(0, "frequency_hz"), None);
    }
}
