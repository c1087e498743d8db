//! Both directions: an effect that the model has and the sensor lacks, or has with other numbers, is reported in the
//! same way as an effect that the model lacks.

use super::report::{Cause, Sense};
use super::round_trip::{model, recording};
use super::{Diagnosis, Options, Outcome, Verdict, diagnose};
use imu_model::effects::{BiasStep, EffectKind, Resonance};
use serde_json::{Value, json};

const SAMPLES: usize = 32_000;

fn compared(sensor: Option<&Value>, declared: Option<&Value>, seed: u64) -> Outcome {
    diagnose(&recording(&model(sensor), seed, SAMPLES), &model(declared), &Options::default()).unwrap()
}

fn brief(causes: &[Cause]) -> Vec<(&'static str, Sense, String)> {
    causes.iter().map(|of| (of.effect.name(), of.sense, of.channels.join(","))).collect()
}

/// Returns whether the corrected model explains the record: it lacks no effect and has no surplus effect.
fn is_mended(outcome: &Outcome, sensor: Option<&Value>, seed: u64) -> bool {
    let again = recording(&model(sensor), seed, SAMPLES);
    let found = diagnose(&again, &outcome.augmented, &Options::default()).unwrap().diagnosis;
    let is_mended = matches!(found.verdict, Verdict::NoGap | Verdict::Parameters);
    if !is_mended {
        println!("{:?} {:?} {:?}", found.verdict, brief(&found.causes), found.notes);
    }
    is_mended
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
fn what_the_sensor_has_as_the_model_states_is_no_gap() {
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

/// A long window with noise behind it would stand for B and K that are too small in the model.
#[test]
fn a_filter_that_the_sensor_lacks_is_no_longer_window() {
    let mut wrong = super::cliffs::Wrong::default();
    for (b, k, seed) in [(1.0, 1.0, 1), (30.0, 1.0, 2), (1.0, 3.0, 3), (60.0, 0.3, 4), (10.0, 3.0, 5), (1.0, 6.0, 7)] {
        let declared = json!({"effect": "moving_average", "window": 2, "white_behind": 2e-5});
        let (mut truth, mut stated) = (model(None), model(Some(&declared)));
        // A walk that shows up to some hertz.
        stated.channels.values_mut().for_each(|of| (of.b, of.k) = (0.02 * of.n, 0.2 * of.n));
        truth.channels.values_mut().for_each(|of| (of.b, of.k, of.n) = (b * 0.02 * of.n, k * 0.2 * of.n, 0.6 * of.n));
        let found = super::cliffs::diagnosed(&recording(&truth, seed, 40_000), &stated);
        let named: Vec<_> = found.diagnosis.causes.iter().map(|of| (of.effect.name(), of.sense)).collect();
        wrong.expect(named == [("moving_average", Sense::Superfluous)], || {
            format!("B × {b}, K × {k} seed {seed}: {named:?}")
        });
    }
    wrong.none();
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

/// Effects of the level, of the variance, of single samples and of stamps, each with one parameter and another value
/// for it.
fn further() -> Vec<(Value, &'static str, Value)> {
    vec![
        (json!({"effect": "rate_ramp", "R": 3e-5}), "R", json!(9e-5)),
        (json!({"effect": "temperature_bias", "per_c": 0.004, "reference_c": 25.0}), "per_c", json!(0.012)),
        (json!({"effect": "warm_up", "amplitude": 0.05, "tau_s": 100.0}), "amplitude", json!(0.15)),
        (json!({"effect": "warm_up", "amplitude": 0.05, "tau_s": 100.0}), "tau_s", json!(30.0)),
        (json!({"effect": "bias_step", "at_s": 300.0, "size": 0.03}), "size", json!(0.06)),
        (json!({"effect": "bias_step", "at_s": 300.0, "size": 0.03}), "at_s", json!(500.0)),
        (json!({"effect": "variance_change", "from_s": 200, "to_s": 500, "factor": 1.5}), "factor", json!(3.0)),
        (json!({"effect": "variance_change", "per_c": 0.1, "reference_c": 25.0}), "per_c", json!(0.3)),
        (
            json!({"effect": "bursts", "intervals": [[200.0, 203.0], [500.0, 504.0]], "sigma": 0.05}),
            "sigma",
            json!(0.2),
        ),
        (json!({"effect": "spikes", "rate_hz": 0.05, "amplitude": 0.2}), "amplitude", json!(0.6)),
        (json!({"effect": "heavy_tails", "degrees_of_freedom": 4.0}), "degrees_of_freedom", json!(9.0)),
        (json!({"effect": "resolution", "step": 0.005}), "step", json!(0.01)),
        (json!({"effect": "held_samples", "probability": 0.02}), "probability", json!(0.1)),
        (json!({"effect": "common_mode", "sigma": 0.006}), "sigma", json!(0.003)),
        (json!({"effect": "timing", "jitter_s": 0.002, "drop_probability": 0.01}), "drop_probability", json!(0.05)),
    ]
}

#[test]
fn what_else_the_sensor_has_as_the_model_states_is_no_gap() {
    let mut wrong = Vec::new();
    for ((effect, ..), seed) in further().into_iter().zip(101..) {
        let found = compared(Some(&effect), Some(&effect), seed).diagnosis;
        if !matches!(found.verdict, Verdict::NoGap | Verdict::Parameters) {
            wrong.push(format!("{effect}: {:?} {:?} {:?}", found.verdict, brief(&found.causes), found.notes));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn what_else_the_sensor_lacks_is_superfluous() {
    let mut wrong = Vec::new();
    for ((effect, ..), seed) in further().into_iter().zip(131..) {
        let name = effect["effect"].as_str().unwrap();
        let outcome = compared(None, Some(&effect), seed);
        let found = &outcome.diagnosis;
        let own = found.causes.iter().all(|of| of.effect.name() == name && of.sense == Sense::Superfluous);
        let right = own && found.causes.len() == 1 && found.verdict == Verdict::Effects;
        let mended = is_mended(&outcome, None, seed + 1000);
        if !right || !mended {
            wrong.push(format!("{effect}: {mended} {:?} {:?} {:?}", found.verdict, brief(&found.causes), found.notes));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn what_else_the_sensor_has_otherwise_is_a_size() {
    let mut wrong = Vec::new();
    for ((declared, parameter, value), seed) in further().into_iter().zip(161..) {
        let mut effect = declared.clone();
        effect[parameter] = value.clone();
        let name = effect["effect"].as_str().unwrap();
        // The sensor has more of the effect than the model states, then less.
        for (own, stated) in [(&effect, &declared), (&declared, &effect)] {
            let outcome = compared(Some(own), Some(stated), seed);
            let found = &outcome.diagnosis;
            let one = found.causes.len() == 1
                && found.causes[0].effect.name() == name
                && found.causes[0].sense == Sense::Size;
            if !one || found.verdict != Verdict::Effects || !is_mended(&outcome, Some(own), seed + 100) {
                let numbers: Vec<_> = found.causes.iter().map(|of| &of.parameters).collect();
                wrong.push(format!(
                    "{own} for {stated}: {:?} {:?} {numbers:?} {:?}",
                    found.verdict,
                    brief(&found.causes),
                    found.notes
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// An effect that the sensor lacks does not hide in N, and the model's addition to a level does not become an offset.
#[test]
fn what_is_too_much_leaves_n_and_the_level_alone() {
    for sigma in [0.006, 0.04, 0.6] {
        let shared = json!({"effect": "common_mode", "sigma": sigma});
        let outcome = compared(None, Some(&shared), 301);
        let Diagnosis { parameters, causes, .. } = &outcome.diagnosis;
        assert!(parameters.is_empty() && brief(causes).len() == 1, "{sigma}: {parameters:#?} {causes:#?}");
        for of in outcome.augmented.channels.values() {
            assert!((of.n / 2e-3 - 1.0).abs() < 0.02, "{sigma}: {}", of.n);
        }
    }
    // The temperature is far from the one to which the model refers.
    let quieter = json!({"effect": "variance_change", "per_c": 0.1, "reference_c": 10.0});
    let outcome = compared(None, Some(&quieter), 302);
    assert_eq!(brief(&outcome.diagnosis.causes).len(), 1, "{:#?}", outcome.diagnosis.causes);
    for (channel, of) in &outcome.augmented.channels {
        assert!((of.n / 2e-3 - 1.0).abs() < 0.02, "{channel}: {}", of.n);
    }
    let warm = json!({"effect": "temperature_bias", "per_c": 0.05, "reference_c": 10.0});
    let found = compared(Some(&warm), Some(&warm), 303).diagnosis;
    assert!(found.offsets.is_empty() && found.causes.is_empty(), "{found:#?}");
    // A stretch that is left out because the model makes it louder counts in the gap.
    let louder = json!({"effect": "variance_change", "from_s": 500, "to_s": 700, "factor": 3.0});
    let gap = compared(None, Some(&louder), 304).diagnosis.discrepancy;
    assert!(gap.before > 0.03 && gap.closed.is_some_and(|closed| (0.9..1.1).contains(&closed)), "{gap:#?}");
}

/// Each of the model's tones is the sensor's nearest.
#[test]
fn the_nearest_is_what_the_model_has_elsewhere() {
    let tone = |frequency_hz: f64| json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": 0.004});
    let mut declared = model(Some(&tone(14.1)));
    let more = model(Some(&tone(5.0)));
    for (channel, own) in &mut declared.channels {
        own.effects.extend(more.channels[channel].effects.iter().cloned());
    }
    let real = recording(&model(Some(&tone(14.2))), 305, SAMPLES);
    let found = diagnose(&real, &declared, &Options::default()).unwrap().diagnosis;
    let size = found.causes.iter().find(|cause| cause.sense == Sense::Size).unwrap();
    assert_eq!(size.model["accel_x"]["frequency_hz"], 14.1, "{found:#?}");
    let lacked = found.causes.iter().find(|cause| cause.sense == Sense::Superfluous).unwrap();
    assert_eq!(lacked.model["accel_x"]["frequency_hz"], 5.0, "{found:#?}");
}

/// A model may state more effects than a record can test.
#[test]
fn a_variance_by_temperature_of_a_record_without_one_is_taken_as_stated() {
    let quieter = json!({"effect": "variance_change", "per_c": 0.1, "reference_c": 25.0});
    let mut real = recording(&model(None), 310, SAMPLES);
    real.temperature_c = None;
    let found = diagnose(&real, &model(Some(&quieter)), &Options::default()).unwrap().diagnosis;
    assert!(found.causes.is_empty(), "{:#?}", found.causes);
}

#[test]
fn a_model_of_thousands_of_steps_and_bands_decides_neither_time_nor_memory() {
    let mut declared = model(None);
    let own = &mut declared.channels.get_mut(&imu_core::sample::Channel::AccelX).unwrap().effects;
    for at in 0..3000 {
        own.push(std::sync::Arc::new(BiasStep { at_s: 0.2 * f64::from(at), size: 1e-9 }));
        let frequency_hz = 1.0 + 0.005 * f64::from(at);
        own.push(std::sync::Arc::new(Resonance::new(frequency_hz, 0.1, 1e-9)));
    }
    let found = diagnose(&recording(&model(None), 311, 8_000), &declared, &Options::default()).unwrap().diagnosis;
    assert!(found.causes.is_empty(), "{:#?}", found.causes);
}

/// The model's own effects include a level that follows the temperature other than along a line, with its mean.
#[test]
fn a_models_own_curve_play_and_rate_of_temperature_are_no_gap() {
    for (further, seed) in [("per_c2", 61), ("play_c", 62), ("per_c_per_s", 63)] {
        let mut effect = json!({"effect": "temperature_bias", "per_c": 0.01, "reference_c": 5.0});
        effect[further] = match further {
            "play_c" => 2.0,
            "per_c2" => 5e-4,
            _ => 0.02,
        }
        .into();
        let sim = model(Some(&effect));
        let found = diagnose(&recording(&sim, seed, 32_000), &sim, &Options::default()).unwrap().diagnosis;
        assert_eq!(found.verdict, Verdict::NoGap, "{further}: {found:#?}");
        assert!(found.offsets.is_empty(), "{further}: {:?}", found.offsets);
        // A bias of 0.2 m/s² more would be a turn-on bias: the level itself has to be the model's.
        let mut shifted = sim.clone();
        shifted.channels.values_mut().for_each(|of| of.bias = of.bias.map(|bias| bias - 0.28));
        let moved = diagnose(&recording(&shifted, seed, 32_000), &sim, &Options::default()).unwrap().diagnosis;
        assert!(moved.offsets.is_empty(), "{further}: {:?}", moved.offsets);
        shifted.channels.values_mut().for_each(|of| of.bias = of.bias.map(|bias| bias + 0.56));
        let moved = diagnose(&recording(&shifted, seed, 32_000), &sim, &Options::default()).unwrap().diagnosis;
        assert!(moved.offsets.is_empty(), "{further}: {:?}", moved.offsets);
        let plain = diagnose(&recording(&sim, seed, 32_000), &model(None), &Options::default()).unwrap().diagnosis;
        let cause = plain.causes.iter().find(|cause| cause.effect == EffectKind::TemperatureBias);
        assert!(cause.is_some(), "{further}: {plain:#?}");
    }
}

/// A burst of the model may be as long as a change of variance. A filter of the model may hardly show in the record.
#[test]
fn what_is_of_another_size_is_no_further_cause() {
    let bursts =
        |sigma: f64| json!({"effect": "bursts", "sigma": sigma, "intervals": [[100.0, 101.0], [400.0, 520.0]]});
    let filter = |part: f64| json!({"effect": "low_pass", "cutoff_hz": part * super::round_trip::RATE_HZ, "order": 2});
    for (sensor, declared) in [(bursts(0.1), bursts(0.012)), (filter(0.13), filter(0.45))] {
        let found = compared(Some(&sensor), Some(&declared), 306).diagnosis;
        let name = sensor["effect"].as_str().unwrap();
        let right =
            found.causes.len() == 1 && found.causes[0].effect.name() == name && found.causes[0].sense == Sense::Size;
        assert!(right, "{name}: {:#?}", brief(&found.causes));
    }
}
