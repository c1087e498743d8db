//! Models of any content are written and read back.

use super::*;
use crate::effects::spec::{Form, Need, Range};
use crate::effects::{CHANNEL, Definition, EffectKind, Spec, TRIAD};
use proptest::prelude::*;
use serde_json::json;

/// A source of numbers from 0 to below 1.
struct Pool<'a>(std::iter::Cycle<std::slice::Iter<'a, f64>>);

impl Pool<'_> {
    fn unit(&mut self) -> f64 {
        self.0.next().copied().unwrap_or(0.5)
    }
    fn below(&mut self, count: usize) -> usize {
        (self.unit() * count as f64) as usize
    }
}

/// Returns a number of a range; it also satisfies relations that a table cannot express (limits in order, jitter below
/// a period).
fn number(name: &str, range: Range, pool: &mut Pool<'_>) -> f64 {
    let unit = pool.unit();
    match (name, range) {
        ("low" | "from_s", _) => -unit.min(0.0) + 0.1 * unit,
        ("high" | "to_s", _) => 1.0 + unit,
        ("jitter_s", _) => 1e-4 * unit,
        ("amplitude_sigma", _) => 3.0 * unit,
        ("asymmetry", _) => 2.0 * unit - 1.0,
        (_, Range::Any) => 20.0 * unit - 10.0,
        (_, Range::FromZero) => 9.0 * unit,
        (_, Range::Above(least)) => least + 0.001 + 9.0 * unit,
        (_, Range::Probability) => unit,
        (_, Range::From(least)) => least + 0.001 + 9.0 * unit,
        (_, Range::Between(low, high)) => low + (0.001 + 0.998 * unit) * (high - low),
    }
}

fn value(name: &str, form: Form, pool: &mut Pool<'_>) -> Value {
    let count = 1 + pool.below(4);
    match form {
        Form::Number(range) => json!(number(name, range, pool)),
        Form::Time => json!(number(name, Range::FromZero, pool)),
        Form::Whole(from, to) => json!(from + pool.below((to - from + 1) as usize) as u64),
        Form::Numbers(range) => json!((0..count).map(|_| number(name, range, pool)).collect::<Vec<_>>()),
        Form::Intervals => json!((0..count).map(|i| [i as f64, i as f64 + 0.01 + pool.unit()]).collect::<Vec<_>>()),
        Form::Profile | Form::Density => {
            json!((0..=count).map(|i| [i as f64 + pool.unit() / 2.0, pool.unit()]).collect::<Vec<_>>())
        }
        Form::Effect(specs) => entry_of(specs[pool.below(specs.len())], pool),
        Form::Matrix => json!([0; 3].map(|_| [0; 3].map(|_| 20.0 * pool.unit() - 10.0))),
        Form::Choice(words) => json!(words[pool.below(words.len())]),
    }
}

/// Returns a file's entry for a kind, with some of the optional keys.
fn entry<E: ?Sized>(kind: &Definition<E>, pool: &mut Pool<'_>) -> Value {
    entry_of(kind.spec, pool)
}

fn entry_of(spec: &Spec, pool: &mut Pool<'_>) -> Value {
    let mut entry = json!({"effect": spec.name()});
    let chosen = spec.forms.get(pool.below(spec.forms.len().max(1))).copied().unwrap_or_default();
    for parameter in spec.parameters {
        let there = match parameter.need {
            Need::Always => true,
            Need::Default(_) | Need::Unwritten(_) => {
                pool.unit() < 0.5 && (chosen.is_empty() || chosen.contains(&"per_c"))
            }
            Need::Optional => pool.unit() < 0.5,
            Need::InItsForm => chosen.contains(&parameter.name),
        };
        if there {
            entry[parameter.name] = value(parameter.name, parameter.form, pool);
        }
    }
    entry
}

/// Returns a model at 1000 Hz, or at a tenth of that behind a boxcar.
fn model(pool: &mut Pool<'_>) -> Value {
    let sampled = pool.unit() < 0.5;
    let mut model = json!({
        "format": FORMAT, "name": "any", "rate_hz": if sampled { 100.0 } else { 1000.0 }, "channels": {}, "triads": {},
    });
    if sampled {
        model["sampling"] = json!({"internal_rate_hz": 1000.0, "filter_window": 1 + pool.below(20)});
    }
    if pool.unit() < 0.5 {
        model["provenance"] = json!({"capture": "desk", "fit": {"p_value": pool.unit()}});
    }
    let shared = [entry(crate::effects::HeldSamples::DEFINITION, pool)];
    for channel in Channel::ALL {
        if channel != Channel::GyroX && pool.unit() < 0.6 {
            continue;
        }
        let kinds: Vec<_> = CHANNEL
            .iter()
            .filter(|kind| !matches!(kind.spec.kind, EffectKind::HeldSamples | EffectKind::Timing))
            .collect();
        let count = pool.below(5);
        let mut effects: Vec<Value> = (0..count).map(|_| entry(kinds[pool.below(kinds.len())], pool)).collect();
        if pool.unit() < 0.3 {
            effects.extend(shared.clone());
        }
        let mut body = json!({"N": pool.unit(), "K": pool.unit() * 1e-7, "effects": effects});
        if pool.unit() < 0.5 {
            body["bias"] = json!(pool.unit() - 0.5);
            let of = |effect: &Value| {
                let names =
                    effect.as_object().into_iter().flatten().map(|(name, _)| name).filter(|name| *name != "effect");
                names.map(|name| (name.clone(), json!({"ci95": [0.1, 0.2]}))).collect::<Map<_, _>>()
            };
            let known: Vec<_> = body["effects"].as_array().into_iter().flatten().map(of).collect();
            body["uncertainty"] = json!({"N": {"ci95": [pool.unit(), 2.0]}, "effects": known});
        }
        model["channels"][channel.name()] = body;
    }
    let count = pool.below(6);
    let effects: Vec<Value> = (0..count).map(|_| entry(TRIAD[pool.below(TRIAD.len())], pool)).collect();
    model["triads"]["gyro"] = json!({"effects": effects});
    model
}

proptest! {
    #[test]
    fn a_model_written_and_read_is_the_same_model(numbers in proptest::collection::vec(0.0..1.0_f64, 50..300)) {
        let value = model(&mut Pool(numbers.iter().cycle()));
        let model = SensorModel::from_value(&value, "any.json").map_err(|error| TestCaseError::fail(error.to_string()))?;
        let text = serde_json::to_string_pretty(&model).unwrap();
        let again = SensorModel::from_json(&text, "any.json").unwrap();
        prop_assert_eq!(&again, &model);
        prop_assert_eq!(serde_json::to_string_pretty(&again).unwrap(), text);
        // No given value is lost.
        for (name, channel) in value["channels"].as_object().unwrap() {
            let written = serde_json::to_value(&model.channels[&Channel::from_name(name).unwrap()]).unwrap();
            for (effect, kept) in channel["effects"].as_array().unwrap().iter().zip(written["effects"].as_array().unwrap_or(&Vec::new())) {
                for (key, given) in effect.as_object().unwrap() {
                    prop_assert_eq!(&kept[key], given);
                }
            }
            let known = |of: &Value| of["uncertainty"]["effects"].clone();
            prop_assert_eq!(known(channel), known(&written));
        }
    }

    #[test]
    fn an_effect_with_a_key_too_many_or_too_few_is_refused(numbers in proptest::collection::vec(0.0..1.0_f64, 50..100)) {
        for kind in CHANNEL {
            let full = entry(kind, &mut Pool(numbers.iter().cycle()));
            let mut map = full.as_object().unwrap().clone();
            map.remove("effect");
            prop_assert!(kind.read(&map).is_ok(), "{full}");
            let mut more = map.clone();
            more.insert("wobble".to_owned(), json!(1));
            prop_assert_eq!(kind.read(&more).unwrap_err().parameter, "wobble");
            for parameter in kind.spec.parameters.iter().filter(|parameter| parameter.default().is_none()) {
                let mut less = map.clone();
                if parameter.need != Need::Optional && less.remove(parameter.name).is_some() {
                    prop_assert!(kind.read(&less).is_err(), "{} without {}", kind.spec.name(), parameter.name);
                }
                let mut wrong = map.clone();
                wrong.insert(parameter.name.to_owned(), json!({"not": "this"}));
                prop_assert!(kind.read(&wrong).is_err(), "{} with a wrong {}", kind.spec.name(), parameter.name);
            }
        }
    }
}

#[test]
fn the_committed_schema_is_that_of_the_reader() {
    let committed = include_str!("../../../../../docs/sensor-model.schema.json");
    let made = format!("{:#}\n", schema::schema());
    assert!(
        committed == made,
        "docs/sensor-model.schema.json is out of date: cargo run --example sensor_model_schema > docs/sensor-model.schema.json"
    );
}

#[test]
fn channels_that_share_an_effect_have_to_agree() {
    let with = |x: &str, y: &str| {
        let text = format!(
            r#"{{"format":"{FORMAT}","name":"t","rate_hz":40,"channels":{{"gyro_x":{{"effects":[{x}]}},"gyro_y":{{"effects":[{y}]}}}}}}"#
        );
        SensorModel::from_json(&text, "m.json").map(|_| ()).map_err(|error| error.to_string())
    };
    let held = |p: f64| format!(r#"{{"effect":"held_samples","probability":{p}}}"#);
    assert_eq!(with(&held(0.1), &held(0.1)), Ok(()));
    assert_eq!(with(&held(0.1), ""), Ok(()));
    assert_eq!(
        with(&held(0.1), &held(0.2)).unwrap_err(),
        "m.json: channels.gyro_y.effects[0]: found probability 0.2; expected probability 0.1 as on gyro_x, because it \
         concerns all of gyro"
    );
    let lost = |p: f64| format!(r#"{{"effect":"timing","drop_probability":{p}}}"#);
    assert!(with(&lost(0.1), &lost(0.2)).unwrap_err().contains("all of the sensor"));
    let shared = |s: f64| format!(r#"{{"effect":"common_mode","sigma":{s}}}"#);
    assert_eq!(with(&shared(0.1), &shared(-0.2)), Ok(()));
}
