//! The JSON Schema of sensor models, made from the same tables as the reader.

use super::read::RATES_HZ;
use super::uncertainty::ENTRY_KEYS;
use super::{CHANNEL_KEYS, EFFECTS, FORMAT, TRIADS, UNCERTAIN_KEYS};
use crate::effects::{CHANNEL, Definition, LARGEST, TRIAD};
use imu_core::sample::Channel;
use serde_json::{Map, Value, json};

/// Returns the schema (draft 2020-12) of `docs/sensor-model.schema.json`.
///
/// The schema expresses what a table of ranges can express. Only the reader refuses: frequencies from half the rate up,
/// rates that do not divide one another, limits in the wrong order, channels that disagree about a shared effect, keys
/// that occur twice, and uncertainties of absent parameters.
pub fn schema() -> Value {
    let object = |properties: Map<String, Value>, required: &[&str]| json!({"type": "object", "properties": properties, "required": required, "additionalProperties": false});
    let amplitude = |meaning: &str| json!({"type": "number", "minimum": 0, "maximum": LARGEST, "default": 0, "description": meaning});
    let entry = json!({"$ref": "#/$defs/uncertainty"});
    let of_effects = json!({
        "type": "array",
        "items": {"type": "object", "additionalProperties": entry},
        "description": "an object for each of the channel's effects: its parameters whose accuracy is known"
    });
    let uncertainty: Map<String, Value> = UNCERTAIN_KEYS
        .iter()
        .map(|key| ((*key).to_owned(), if *key == EFFECTS { of_effects.clone() } else { entry.clone() }))
        .collect();
    let mut uncertainty = object(uncertainty, &[]);
    uncertainty["description"] = json!("what is known about the parameters' accuracy");
    let channel: Map<String, Value> = CHANNEL_KEYS
        .iter()
        .map(|key| {
            let schema = match *key {
                "N" => amplitude("white noise, U/√Hz: two-sided density N²"),
                "B" => amplitude("flicker noise, U: two-sided density B²/(2πf)"),
                "K" => amplitude("rate random walk, U/√s: two-sided density (K/2πf)²"),
                "bias" => {
                    json!({"type": "number", "minimum": -LARGEST, "maximum": LARGEST, "description": "a constant, U"})
                }
                "effects" => json!({"type": "array", "items": {"oneOf": kinds(&CHANNEL)}}),
                _ => uncertainty.clone(),
            };
            ((*key).to_owned(), schema)
        })
        .collect();
    let channels: Map<String, Value> = Channel::ALL
        .iter()
        .map(|channel| {
            (
                channel.name().to_owned(),
                json!({"$ref": "#/$defs/channel", "description": format!("U: {}", channel.unit())}),
            )
        })
        .collect();
    let triads: Map<String, Value> =
        TRIADS.iter().map(|triad| (triad.name().to_owned(), json!({"$ref": "#/$defs/triad"}))).collect();
    let effects = json!({"type": "array", "items": {"oneOf": kinds(&TRIAD)}});
    let mut channels = object(channels, &[]);
    channels["minProperties"] = json!(1);
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": FORMAT,
        "description": "A sensor: what the simulator runs on. U is the channel's unit.",
        "type": "object",
        "required": ["format", "name", "rate_hz", "channels"],
        "additionalProperties": false,
        "properties": {
            "format": {"const": FORMAT},
            "name": {"type": "string", "description": "for people"},
            "rate_hz": {"type": "number", "minimum": RATES_HZ.start(), "maximum": RATES_HZ.end(), "description": "the output's rate, Hz"},
            "sampling": {
                "type": "object",
                "description": "how the sensor makes its output; N, B and K are then its own, before its boxcar",
                "required": ["internal_rate_hz", "filter_window"],
                "additionalProperties": false,
                "properties": {
                    "internal_rate_hz": {
                        "type": "number",
                        "exclusiveMinimum": 0,
                        "description": "the sensor's own rate, a whole multiple of rate_hz"
                    },
                    "filter_window": {
                        "type": "integer",
                        "minimum": 1,
                        "maximum": crate::effects::MovingAverage::WINDOW_MAX,
                        "description": "internal samples that are averaged"
                    }
                }
            },
            "channels": channels,
            "triads": object(triads, &[]),
            "provenance": {"type": "object", "description": "where the model comes from, in any form"}
        },
        "$defs": {
            "channel": object(channel, &[]),
            "uncertainty": {
                "type": "object",
                "description": "95 % interval, low to high, or upper limit, in the parameter's unit",
                "additionalProperties": false,
                "properties": entry_properties()
            },
            "triad": {
                "type": "object",
                "properties": {"effects": effects},
                "additionalProperties": false
            }
        }
    })
}

fn entry_properties() -> Map<String, Value> {
    let schema = |key: &str| match key {
        "ci95" => json!({"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}),
        _ => json!({"type": "number", "minimum": 0}),
    };
    ENTRY_KEYS.iter().map(|key| ((*key).to_owned(), schema(key))).collect()
}

fn kinds<E: ?Sized>(kinds: &[&Definition<E>]) -> Vec<Value> {
    kinds.iter().map(|of| of.spec.schema()).collect()
}
