//! Sensor models: the file format of the contract, section 5. JSON text in, checked parameters out, and back.
//!
//! Refused with the file, the path inside it, what was found and what is allowed: unknown keys, channels and effects,
//! negative or non-numeric parameters, and what the contract has but this version does not model yet (it models N, B, K
//! and bias). Nothing is ignored silently.

use crate::sample::{Channel, Triad};
use serde::Serialize;
use serde::ser::SerializeMap;
use serde_json::Value;
use std::collections::BTreeMap;

/// The format's name; a change that old readers would misread gets a new number.
pub const FORMAT: &str = "vn100d-sensor-model-1";

/// Effects on a channel that the contract names and this version does not model.
const CHANNEL_EFFECTS_TO_COME: [&str; 20] = [
    "resolution",
    "quantization_noise",
    "rate_ramp",
    "gauss_markov",
    "tone",
    "comb",
    "resonance",
    "temperature_bias",
    "warm_up",
    "spikes",
    "heavy_tails",
    "bias_step",
    "bursts",
    "variance_change",
    "low_pass",
    "moving_average",
    "saturation",
    "held_samples",
    "common_mode",
    "timing",
];
/// Effects on a triad that the contract names and this version does not model.
const TRIAD_EFFECTS_TO_COME: [&str; 8] = [
    "bias",
    "scale_factor",
    "scale_factor_nonlinearity",
    "misalignment",
    "cross_axis_sensitivity",
    "g_sensitivity",
    "latency",
    "saturation",
];

/// Why a sensor model was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The text is not JSON.
    #[error("{file} is not JSON: {source}")]
    Syntax {
        /// Where the text came from.
        file: String,
        /// What the parser found, with line and column.
        source: serde_json::Error,
    },
    /// Something in it is not allowed.
    #[error("{file}: {path}: found {found}; expected {expected}")]
    Content {
        /// Where the text came from.
        file: String,
        /// The place inside it, such as `channels.gyro_x.N`.
        path: String,
        /// What stood there.
        found: String,
        /// What may stand there.
        expected: String,
    },
    /// Something that the format has and this version cannot simulate.
    #[error("{file}: {path}: `{found}` is not modelled by this version, which models N, B, K and bias; remove it")]
    NotModelled {
        /// Where the text came from.
        file: String,
        /// The place inside it.
        path: String,
        /// The effect or key.
        found: String,
    },
}

/// The parameters of one channel; U is the channel's unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChannelModel {
    /// White noise, U/√Hz (two-sided PSD N²).
    pub n: f64,
    /// Flicker noise, U (two-sided PSD B²/(2πf)).
    pub b: f64,
    /// Rate random walk, U/√s (two-sided PSD (K/2πf)²).
    pub k: f64,
    /// A constant, U.
    pub bias: Option<f64>,
}

impl Serialize for ChannelModel {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("N", &self.n)?;
        map.serialize_entry("B", &self.b)?;
        map.serialize_entry("K", &self.k)?;
        if let Some(bias) = self.bias {
            map.serialize_entry("bias", &bias)?;
        }
        map.end()
    }
}

/// A sensor: what the simulator runs on.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorModel {
    /// A name for people.
    pub name: String,
    /// The output rate in Hz at which N, B and K are seen.
    pub rate_hz: f64,
    /// The channels it has, in column order.
    pub channels: BTreeMap<Channel, ChannelModel>,
}

impl Serialize for SensorModel {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("format", FORMAT)?;
        map.serialize_entry("name", &self.name)?;
        map.serialize_entry("rate_hz", &self.rate_hz)?;
        map.serialize_entry("channels", &self.channels)?;
        map.end()
    }
}

impl SensorModel {
    /// Reads a model from JSON text; `file` names it in messages.
    ///
    /// # Errors
    /// [`ModelError`] with the place and what is allowed there.
    pub fn from_json(text: &str, file: &str) -> Result<Self, ModelError> {
        let value =
            serde_json::from_str(text).map_err(|source| ModelError::Syntax { file: file.to_owned(), source })?;
        Self::from_value(&value, file)
    }

    /// Reads a model from parsed JSON (one that came inside a request, say); `file` names it in messages.
    ///
    /// # Errors
    /// [`ModelError`] with the place and what is allowed there.
    pub fn from_value(value: &Value, file: &str) -> Result<Self, ModelError> {
        let root = Place { file, path: String::new(), value };
        let keys = ["format", "name", "rate_hz", "channels", "triads", "sampling"];
        root.only_keys(&keys)?;
        let format = root.key("format", "the format's name")?;
        if format.value.as_str() != Some(FORMAT) {
            return Err(format.refuse(&format!("\"{FORMAT}\"")));
        }
        let name = root.key("name", "a name")?;
        let name = name.value.as_str().ok_or_else(|| name.refuse("a text"))?.to_owned();
        let rate = root.key("rate_hz", "the output rate in Hz")?;
        let rate_hz = rate.number()?;
        if rate_hz <= 0.0 {
            return Err(rate.refuse("a rate in Hz above 0"));
        }
        if let Some(sampling) = root.optional("sampling") {
            return Err(sampling.not_modelled("sampling"));
        }
        if let Some(triads) = root.optional("triads") {
            refuse_triads(&triads)?;
        }
        let places = root.key("channels", "an object of channels")?;
        let mut channels = BTreeMap::new();
        for place in places.entries("an object of channels")? {
            let found = place.last_key();
            let Some(channel) = Channel::from_name(found) else {
                return Err(place.refuse_key(&one_of(&Channel::ALL.map(Channel::name))));
            };
            channels.insert(channel, channel_model(&place)?);
        }
        if channels.is_empty() {
            return Err(places.refuse("at least one channel"));
        }
        Ok(Self { name, rate_hz, channels })
    }
}

fn channel_model(place: &Place<'_>) -> Result<ChannelModel, ModelError> {
    place.only_keys(&["N", "B", "K", "bias", "effects"])?;
    if let Some(effects) = place.optional("effects") {
        refuse_effects(&effects, &CHANNEL_EFFECTS_TO_COME)?;
    }
    let amplitude = |key| -> Result<f64, ModelError> {
        let Some(place) = place.optional(key) else { return Ok(0.0) };
        let value = place.number()?;
        if value < 0.0 { Err(place.refuse("a number of 0 or more")) } else { Ok(value) }
    };
    Ok(ChannelModel {
        n: amplitude("N")?,
        b: amplitude("B")?,
        k: amplitude("K")?,
        bias: place.optional("bias").map(|bias| bias.number()).transpose()?,
    })
}

fn refuse_triads(triads: &Place<'_>) -> Result<(), ModelError> {
    const TRIADS: [Triad; 4] = [Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro];
    for triad in triads.entries("an object of triads")? {
        if !TRIADS.iter().any(|known| known.name() == triad.last_key()) {
            return Err(triad.refuse_key(&one_of(&TRIADS.map(Triad::name))));
        }
        triad.only_keys(&["effects"])?;
        if let Some(effects) = triad.optional("effects") {
            refuse_effects(&effects, &TRIAD_EFFECTS_TO_COME)?;
        }
    }
    Ok(())
}

/// An empty list passes; an effect is refused as unknown or as one that this version does not model.
fn refuse_effects(effects: &Place<'_>, to_come: &[&str]) -> Result<(), ModelError> {
    let list = effects.value.as_array().ok_or_else(|| effects.refuse("a list of effects"))?;
    let Some(value) = list.first() else { return Ok(()) };
    let first = Place { file: effects.file, path: format!("{}[0]", effects.path), value };
    let kind = first.key("effect", "the effect's name")?;
    let name = kind.value.as_str().ok_or_else(|| kind.refuse("the effect's name"))?;
    Err(if to_come.contains(&name) { kind.not_modelled(name) } else { kind.refuse(&one_of(to_come)) })
}

fn one_of(names: &[&str]) -> String {
    format!("one of {}", names.join(", "))
}

/// A value and where it stands.
struct Place<'a> {
    file: &'a str,
    path: String,
    value: &'a Value,
}

impl<'a> Place<'a> {
    fn child(&self, key: &str, value: &'a Value) -> Self {
        let path = if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) };
        Self { file: self.file, path, value }
    }
    fn optional(&self, key: &str) -> Option<Self> {
        self.value.get(key).map(|value| self.child(key, value))
    }
    fn key(&self, key: &str, meaning: &str) -> Result<Self, ModelError> {
        self.optional(key).ok_or_else(|| ModelError::Content {
            file: self.file.to_owned(),
            path: self.shown_path(),
            found: format!("no `{key}`"),
            expected: format!("`{key}`: {meaning}"),
        })
    }
    fn last_key(&self) -> &str {
        self.path.rsplit('.').next().unwrap_or_default()
    }
    fn entries(&self, expected: &str) -> Result<Vec<Self>, ModelError> {
        let object = self.value.as_object().ok_or_else(|| self.refuse(expected))?;
        Ok(object.iter().map(|(key, value)| self.child(key, value)).collect())
    }
    fn only_keys(&self, allowed: &[&str]) -> Result<(), ModelError> {
        match self.entries("an object")?.iter().find(|entry| !allowed.contains(&entry.last_key())) {
            None => Ok(()),
            Some(unknown) => Err(unknown.refuse_key(&one_of(allowed))),
        }
    }
    fn number(&self) -> Result<f64, ModelError> {
        self.value.as_f64().filter(|number| number.is_finite()).ok_or_else(|| self.refuse("a number"))
    }
    fn shown_path(&self) -> String {
        if self.path.is_empty() { "top level".to_owned() } else { self.path.clone() }
    }
    fn refuse(&self, expected: &str) -> ModelError {
        ModelError::Content {
            file: self.file.to_owned(),
            path: self.shown_path(),
            found: self.value.to_string(),
            expected: expected.to_owned(),
        }
    }
    fn refuse_key(&self, expected: &str) -> ModelError {
        ModelError::Content {
            file: self.file.to_owned(),
            path: self.shown_path(),
            found: format!("the unknown key `{}`", self.last_key()),
            expected: expected.to_owned(),
        }
    }
    fn not_modelled(&self, found: &str) -> ModelError {
        ModelError::NotModelled { file: self.file.to_owned(), path: self.shown_path(), found: found.to_owned() }
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
    fn a_model_is_read_with_missing_parameters_as_zero() {
        let model = SensorModel::from_json(&with_gyro_x(r#"{"N":1.2e-4,"K":4e-7,"effects":[]}"#), "m.json").unwrap();
        let expected = ChannelModel { n: 1.2e-4, b: 0.0, k: 4e-7, bias: None };
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
            (with_gyro_x(r#"{"N":"1"}"#), ["m.json", "channels.gyro_x.N", "found \"1\"", "a number"]),
            (with_gyro_x(r#"{"M":1}"#), ["m.json", "channels.gyro_x.M", "unknown key `M`", "N, B, K, bias, effects"]),
            (with_gyro_x("[]"), ["m.json", "channels.gyro_x:", "found []", "an object"]),
            (
                with_gyro_x(r#"{"effects":[{"effect":"wobble"}]}"#),
                ["m.json", "channels.gyro_x.effects[0].effect", "found \"wobble\"", "one of resolution"],
            ),
            (
                with_gyro_x(r#"{"effects":[{"effect":"tone","frequency_hz":11}]}"#),
                ["m.json", "channels.gyro_x.effects[0].effect", "`tone` is not modelled", "N, B, K and bias"],
            ),
            (with_gyro_x("{}").replace("gyro_x", "gyro_w"), ["m.json", "channels.gyro_w", "gyro_w", "gyro_x, gyro_y"]),
            (with_gyro_x("{}").replace("model-1", "model-2"), ["m.json", "format", "model-2", FORMAT]),
            (with_gyro_x("{}").replace("\"rate_hz\":40,", ""), ["m.json", "top level", "no `rate_hz`", "output rate"]),
            (with_gyro_x("{}").replace("40", "0"), ["m.json", "rate_hz", "found 0", "above 0"]),
            (
                with_gyro_x("{}").replace(
                    "\"rate_hz\"",
                    "\"triads\":{\"gyro\":{\"effects\":[{\"effect\":\"scale_factor\"}]}},\"rate_hz\"",
                ),
                ["m.json", "triads.gyro.effects[0].effect", "`scale_factor`", "not modelled"],
            ),
            (
                with_gyro_x("{}").replace("\"rate_hz\"", "\"sampling\":{\"internal_rate_hz\":800},\"rate_hz\""),
                ["m.json", "sampling", "not modelled", "this version"],
            ),
            ("{".to_owned(), ["m.json", "not JSON", "line 1", "column"]),
        ] {
            let message = message(&text);
            for part in parts {
                assert!(message.contains(part), "{part:?} is not in {message:?}");
            }
        }
    }
}
