//! Differences of two models, parameter by parameter.

use imu_core::sample::Channel;
use imu_model::simulator::SensorModel;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeSet;

/// One value in which two models differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// The place in the file, such as `channels.gyro_x.N`.
    pub path: String,
    /// The first model's value; null if it has none.
    pub first: Value,
    /// The second model's value.
    pub second: Value,
    /// Second over first, if both are numbers and the first is not 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ratio: Option<f64>,
    /// Whether the second value lies inside the first value's 95 % interval, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within_ci95: Option<bool>,
}

/// Returns the differences, in the order of the file. Names, provenance and uncertainties do not count as differences.
pub fn differences(first: &SensorModel, second: &SensorModel) -> Vec<Difference> {
    let mut found = Vec::new();
    let mut note = |path: String, one: Value, other: Value, interval: Option<[f64; 2]>| {
        if one == other {
            return;
        }
        let numbers = one.as_f64().zip(other.as_f64());
        found.push(Difference {
            path,
            ratio: numbers.filter(|(one, _)| *one != 0.0).map(|(one, other)| other / one),
            within_ci95: interval.zip(other.as_f64()).map(|([low, high], value)| (low..=high).contains(&value)),
            first: one,
            second: other,
        });
    };
    let (one, other) = (object(first), object(second));
    for key in ["rate_hz", "sampling"] {
        note(key.to_owned(), of(&one, key), of(&other, key), None);
    }
    let channels: BTreeSet<Channel> = first.channels.keys().chain(second.channels.keys()).copied().collect();
    for channel in channels {
        let path = |key: &str| format!("channels.{channel}.{key}");
        let side = |model: &Value, key: &str| of(&of(&of(model, "channels"), channel.name()), key);
        for key in ["N", "B", "K", "bias"] {
            let interval = first.channels.get(&channel).and_then(|model| model.interval(key));
            note(path(key), side(&one, key), side(&other, key), interval);
        }
        let known = |index: usize, key: &str| first.channels.get(&channel)?.effect_interval(index, key);
        effects(&path("effects"), &side(&one, "effects"), &side(&other, "effects"), known, &mut note);
    }
    let triads =
        |model: &Value| of(model, "triads").as_object().map(Map::keys).into_iter().flatten().cloned().collect();
    let (mut names, more): (BTreeSet<String>, BTreeSet<String>) = (triads(&one), triads(&other));
    names.extend(more);
    for triad in names {
        let side = |model: &Value| of(&of(&of(model, "triads"), &triad), "effects");
        effects(&format!("triads.{triad}.effects"), &side(&one), &side(&other), |_, _| None, &mut note);
    }
    found
}

fn object(model: &SensorModel) -> Value {
    serde_json::to_value(model).unwrap_or_default()
}

fn of(value: &Value, key: &str) -> Value {
    value.get(key).cloned().unwrap_or_default()
}

/// Compares effects of one kind in their order, parameter by parameter. `known` returns the interval of a parameter of
/// the first list's effect at a place.
fn effects(
    path: &str,
    one: &Value,
    other: &Value,
    known: impl Fn(usize, &str) -> Option<[f64; 2]>,
    note: &mut impl FnMut(String, Value, Value, Option<[f64; 2]>),
) {
    let numbered = |list: &Value| -> Vec<(String, usize, Value)> {
        let mut seen: Vec<(String, usize, Value)> = Vec::new();
        for effect in list.as_array().into_iter().flatten() {
            let name = of(effect, "effect").as_str().unwrap_or_default().to_owned();
            let number = seen.iter().filter(|(other, ..)| *other == name).count();
            seen.push((name, number, effect.clone()));
        }
        seen
    };
    let (first, second) = (numbered(one), numbered(other));
    let partner = |list: &[(String, usize, Value)], name: &str, number: usize| {
        list.iter().find(|(other, at, _)| other == name && *at == number).map(|(.., effect)| effect.clone())
    };
    let place = |name: &str, number: usize| match number {
        0 => format!("{path}.{name}"),
        _ => format!("{path}.{name}[{number}]"),
    };
    for (index, (name, number, effect)) in first.iter().enumerate() {
        match partner(&second, name, *number) {
            None => note(place(name, *number), effect.clone(), Value::Null, None),
            Some(theirs) => {
                let keys: BTreeSet<&String> =
                    [effect, &theirs].into_iter().filter_map(Value::as_object).flat_map(Map::keys).collect();
                for key in keys {
                    note(
                        format!("{}.{key}", place(name, *number)),
                        of(effect, key),
                        of(&theirs, key),
                        known(index, key),
                    );
                }
            }
        }
    }
    for (name, number, effect) in &second {
        if partner(&first, name, *number).is_none() {
            note(place(name, *number), Value::Null, effect.clone(), None);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(gyro_x: &str) -> SensorModel {
        let text =
            format!(r#"{{"format":"vn100d-sensor-model-1","name":"t","rate_hz":40,"channels":{{"gyro_x":{gyro_x}}}}}"#);
        SensorModel::from_json(&text, "m.json").unwrap()
    }

    #[test]
    fn a_model_does_not_differ_from_itself_by_name_or_uncertainty() {
        let one = model(r#"{"N":1e-4,"effects":[{"effect":"tone","frequency_hz":7,"amplitude":1e-3}]}"#);
        let mut other = one.clone();
        other.name = "another".to_owned();
        other.channels.values_mut().for_each(|channel| channel.uncertainty = Some(Map::new()));
        assert!(differences(&one, &other).is_empty());
    }

    #[test]
    fn parameters_are_compared_with_the_interval_and_effects_one_by_one() {
        let one = model(
            r#"{"N":1e-4,"B":1e-5,
                "uncertainty":{"N":{"ci95":[0.9e-4,1.1e-4]},"effects":[{"frequency_hz":{"ci95":[6.5,8.5]}},{}]},
                "effects":[{"effect":"tone","frequency_hz":7,"amplitude":1e-3},{"effect":"rate_ramp","R":1e-6}]}"#,
        );
        let other = model(
            r#"{"N":2e-4,"B":1e-5,
                "effects":[{"effect":"tone","frequency_hz":8,"amplitude":1e-3},{"effect":"tone","frequency_hz":9,"amplitude":1e-3}]}"#,
        );
        let found = differences(&one, &other);
        let paths: Vec<&str> = found.iter().map(|difference| difference.path.as_str()).collect();
        assert_eq!(
            paths,
            [
                "channels.gyro_x.N",
                "channels.gyro_x.effects.tone.frequency_hz",
                "channels.gyro_x.effects.rate_ramp",
                "channels.gyro_x.effects.tone[1]"
            ]
        );
        assert_eq!((found[0].ratio, found[0].within_ci95), (Some(2.0), Some(false)));
        assert_eq!((found[1].within_ci95, found[2].within_ci95), (Some(true), None));
        assert_eq!((found[2].second.is_null(), found[3].first.is_null()), (true, true));
    }
}
