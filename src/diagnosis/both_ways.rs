//! Both ways: what the model has and the sensor lacks, or has otherwise, is reported as what the model lacks is.

use super::report::{Cause, Sense};
use super::round_trip::{model, recording};
use super::{Options, Outcome, Verdict, diagnose};
use serde_json::{Value, json};

const SAMPLES: usize = 32_000;

fn compared(sensor: Option<&Value>, declared: Option<&Value>, seed: u64) -> Outcome {
    diagnose(&recording(&model(sensor), seed, SAMPLES), &model(declared), &Options::default()).unwrap()
}

fn brief(causes: &[Cause]) -> Vec<(&'static str, Sense, String)> {
    causes.iter().map(|of| (of.effect, of.sense, of.channels.join(","))).collect()
}

/// The corrected model explains the record: nothing is missing in it and nothing too much.
fn is_mended(outcome: &Outcome, sensor: Option<&Value>, seed: u64) -> bool {
    let again = recording(&model(sensor), seed, SAMPLES);
    let verdict = diagnose(&again, &outcome.augmented, &Options::default()).unwrap().diagnosis.verdict;
    matches!(verdict, Verdict::NoGap | Verdict::Parameters)
}

/// Effects at sizes that a record shows.
fn effects() -> Vec<Value> {
    vec![
        json!({"effect": "tone", "frequency_hz": 11.37, "amplitude": 0.004}),
        json!({"effect": "comb", "fundamental_hz": 3.17, "amplitudes": [0.004, 0.003, 0.0025]}),
        json!({"effect": "resonance", "frequency_hz": 8.3, "bandwidth_hz": 0.4, "sigma": 0.008}),
        json!({"effect": "gauss_markov", "sigma": 0.012, "tc_s": 4.0}),
        json!({"effect": "quantization_noise", "Q": 1.5e-4}),
        json!({"effect": "low_pass", "cutoff_hz": 7.0, "order": 2}),
        json!({"effect": "moving_average", "window": 3}),
    ]
}

#[test]
fn what_the_sensor_has_as_the_model_says_is_no_gap() {
    for (effect, seed) in effects().into_iter().zip(11..) {
        let found = compared(Some(&effect), Some(&effect), seed).diagnosis;
        assert!(matches!(found.verdict, Verdict::NoGap | Verdict::Parameters), "{effect}: {found:#?}");
    }
}

#[test]
fn what_the_sensor_lacks_is_superfluous() {
    for (effect, seed) in effects().into_iter().zip(31..) {
        let name = effect["effect"].as_str().unwrap();
        let outcome = compared(None, Some(&effect), seed);
        let found = &outcome.diagnosis;
        assert_eq!(brief(&found.causes), [(name, Sense::Superfluous, "accel_x,accel_z".to_owned())], "{found:#?}");
        assert_eq!(found.verdict, Verdict::Effects, "{found:#?}");
        assert!(found.parameters.is_empty(), "{name}: {:#?}", found.parameters);
        assert!(found.discrepancy.before > 10.0 * found.discrepancy.floor, "{name}: {:?}", found.discrepancy);
        assert!(found.causes[0].parameters.is_empty() && found.causes[0].model.len() == 2);
        let closed = found.discrepancy.closed.unwrap();
        assert!((0.9..1.1).contains(&closed), "{name}: {:?}", found.discrepancy);
        assert!(found.summary.contains("sensor lacks"), "{}", found.summary);
        assert!(outcome.augmented.channels.values().all(|of| of.effects.is_empty()));
        assert!(is_mended(&outcome, None, seed + 100), "{name}");
    }
}

#[test]
fn what_the_sensor_has_otherwise_is_a_size() {
    for (own, declared, parameter) in [
        (("amplitude", json!(0.004)), json!(0.04), effects()[0].clone()),
        (("amplitude", json!(0.02)), json!(0.004), effects()[0].clone()),
        (("sigma", json!(0.036)), json!(0.012), effects()[3].clone()),
        (("tc_s", json!(0.6)), json!(6.0), effects()[3].clone()),
        (("sigma", json!(0.02)), json!(0.008), effects()[2].clone()),
        (("cutoff_hz", json!(5.0)), json!(10.0), effects()[5].clone()),
        (("Q", json!(6e-4)), json!(1.5e-4), effects()[4].clone()),
    ]
    .map(|((name, own), declared, effect)| {
        let with = |value: &Value| {
            let mut effect = effect.clone();
            effect[name] = value.clone();
            effect
        };
        (with(&own), with(&declared), name)
    }) {
        let seed = 51;
        let outcome = compared(Some(&own), Some(&declared), seed);
        let found = &outcome.diagnosis;
        let name = own["effect"].as_str().unwrap();
        assert_eq!(
            brief(&found.causes),
            [(name, Sense::Size, "accel_x,accel_z".to_owned())],
            "{own} {declared}: {found:#?}"
        );
        assert_eq!(found.verdict, Verdict::Effects, "{found:#?}");
        for channel in ["accel_x", "accel_z"] {
            let measured = found.causes[0].parameters[channel][parameter].as_f64().unwrap();
            let truth = own[parameter].as_f64().unwrap();
            assert!((measured / truth - 1.0).abs() < 0.25, "{own} {declared} {channel}: {measured}");
            assert_eq!(found.causes[0].model[channel][parameter], declared[parameter]);
        }
        assert!(is_mended(&outcome, Some(&own), seed + 100), "{own} {declared}");
    }
}

#[test]
fn a_tone_at_another_frequency_is_the_models_elsewhere() {
    let tone = |frequency_hz: f64| json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": 0.004});
    for (own, declared) in [(11.37, 11.42), (3.3, 14.1)] {
        let found = compared(Some(&tone(own)), Some(&tone(declared)), 71).diagnosis;
        assert_eq!(brief(&found.causes), [("tone", Sense::Size, "accel_x,accel_z".to_owned())], "{found:#?}");
        let cause = &found.causes[0];
        assert!((cause.parameters["accel_x"]["frequency_hz"].as_f64().unwrap() - own).abs() < 1e-3);
        assert_eq!(cause.model["accel_x"]["frequency_hz"], declared);
    }
}
