//! Round trips: the simulator knows all of a sensor's parameters, and the diagnosis receives some of them.

use super::*;
use crate::report::{Cause, Verdict};
use imu_model::effects::EffectKind;
use imu_model::motion::{Course, Kind, Site};
use imu_model::simulator::{Motion, Simulator};
use serde_json::{Value, json};

const RATE_HZ: f64 = 40.0;

fn reference(kind: Kind, samples: usize, ahead_s: f64) -> Reference {
    let course = Course::new(kind, samples as f64 / RATE_HZ, Site::default()).unwrap();
    Reference::new((0..samples).map(|i| i as f64 / RATE_HZ).map(|s| (s, course.at((s + ahead_s).max(0.0))))).unwrap()
}

/// Returns a VN-100 with these effects on triads and channels.
fn model(triads: Value, channels: Value) -> SensorModel {
    let mut entries = serde_json::Map::new();
    for (triad, n) in [(Triad::Accel, 0.0014), (Triad::Gyro, 6e-5)] {
        for channel in triad.channels() {
            let mut entry = json!({"N": n, "B": 0.3 * n, "K": 0.01 * n});
            if let Some(effects) = channels.get(channel.name()) {
                entry["effects"] = effects.clone();
            }
            entries.insert(channel.name().to_owned(), entry);
        }
    }
    let value = json!({
        "format": "vn100d-sensor-model-1", "name": "test", "rate_hz": RATE_HZ, "channels": entries, "triads": triads
    });
    SensorModel::from_value(&value, "test").unwrap()
}

fn recorded(model: &SensorModel, kind: Kind, samples: usize, seed: u64) -> Recording {
    let course = Course::new(kind, samples as f64 / RATE_HZ, Site::default()).unwrap();
    let motions: Vec<Motion> = course.sampled(RATE_HZ).take(samples).collect();
    let length_s = samples as f64 / RATE_HZ;
    let mut simulator = Simulator::new(model, seed, RATE_HZ, length_s).unwrap().with_motion(motions.into_iter());
    let mut channels: Vec<_> = model.channels.keys().map(|channel| (*channel, Vec::new())).collect();
    while let Some(sample) = simulator.next_sample() {
        if channels[0].1.len() == samples {
            break;
        }
        for (channel, values) in &mut channels {
            values.push(sample.values[*channel as usize]);
        }
    }
    Recording { rate_hz: RATE_HZ, channels, ..Recording::default() }
}

fn named(outcome: &Outcome) -> Vec<(String, &str)> {
    let causes = outcome.diagnosis.causes.iter();
    let on = |cause: &Cause| cause.triad.as_deref().map_or_else(|| cause.channels.join(" "), str::to_owned);
    causes.map(|cause| (on(cause), cause.effect.name())).collect()
}

const SAMPLES: usize = 16_384;

fn diagnosed(truth: &SensorModel, kind: Kind, seed: u64) -> Outcome {
    let real = recorded(truth, kind, SAMPLES, seed);
    let plain = model(json!({}), json!({}));
    let found = diagnose_moved(&real, &reference(kind, SAMPLES, 0.0), &plain, &Options::default()).unwrap();
    println!("{}", serde_json::to_string_pretty(&found.diagnosis).unwrap());
    found
}

#[test]
fn a_sensor_that_matches_its_model_has_no_gap() {
    for (kind, seed) in [(Kind::RateTable, 1), (Kind::Tumble, 2)] {
        let found = diagnosed(&model(json!({}), json!({})), kind, seed);
        assert_eq!(named(&found), [], "{kind:?}");
        assert_eq!(found.diagnosis.verdict, Verdict::NoGap, "{kind:?}");
    }
}

#[test]
fn each_effect_is_named_on_its_triad_with_its_parameters() {
    let cases = [
        ("gyro", json!({"effect": "scale_factor", "x": 1e-3, "y": -5e-4, "z": 0.0})),
        ("gyro", json!({"effect": "misalignment", "x": 1e-3, "y": -5e-4, "z": 2e-4})),
        ("gyro", json!({"effect": "cross_axis_sensitivity", "xy": 1e-3, "xz": -5e-4, "yz": 2e-4})),
        ("gyro", json!({"effect": "g_sensitivity", "m": [[1e-4, 0, 0], [0, -1e-4, 5e-5], [0, 0, 1e-4]]})),
        ("gyro", json!({"effect": "rectification", "x": 1e-4, "y": -5e-5, "z": 0.0})),
        ("accel", json!({"effect": "rectification", "x": 1e-3, "y": -5e-4, "z": 1e-3})),
        ("gyro", json!({"effect": "latency", "seconds": 0.02})),
        ("gyro", json!({"effect": "saturation", "range": 3.0})),
        ("gyro", json!({"effect": "bias", "x": 2e-3, "y": -1e-3, "z": 0.0})),
        ("accel", json!({"effect": "scale_factor", "x": 2e-3, "y": -1e-3, "z": 1e-3})),
        ("accel", json!({"effect": "misalignment", "x": 1e-3, "y": -1e-3, "z": 5e-4})),
    ];
    // The last one has the seed that it had before the list grew: with 20, chance names a rectification too.
    for (seed, (triad, effect)) in [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 8].into_iter().zip(cases) {
        let truth = model(json!({ triad: {"effects": [effect]} }), json!({}));
        let found = diagnosed(&truth, Kind::RateTable, 10 + seed as u64);
        let name = effect["effect"].as_str().unwrap();
        assert_eq!(named(&found), [(triad.to_owned(), name)]);
        assert_eq!(found.diagnosis.verdict, Verdict::Effects, "{name}");
        let cause = &found.diagnosis.causes[0];
        for (parameter, ends) in cause.uncertainty.get(triad).and_then(Value::as_object).into_iter().flatten() {
            // 95 % intervals of up to nine numbers in nine cases: all values lie within twice the intervals' width.
            let flat = |value: &Value| -> Vec<f64> {
                serde_json::to_string(value)
                    .unwrap()
                    .split(|c: char| "[],".contains(c))
                    .filter_map(|s| s.parse().ok())
                    .collect()
            };
            let (truth, ends) = (flat(&effect[parameter]), flat(ends));
            for (truth, ends) in truth.iter().zip(ends.chunks(2)) {
                let (middle, half) = (0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0]));
                assert!((truth - middle).abs() < 2.0 * half, "{name} {parameter}: {truth} {ends:?}");
            }
        }
        if name != "saturation" {
            assert!(found.diagnosis.discrepancy.closed.unwrap() > 0.9, "{name}: {:?}", found.diagnosis.discrepancy);
        }
        // The corrected model closes the gap.
        let again = recorded(&truth, Kind::RateTable, SAMPLES, 100 + seed as u64);
        let reference = reference(Kind::RateTable, SAMPLES, 0.0);
        let closed = diagnose_moved(&again, &reference, &found.augmented, &Options::default()).unwrap();
        assert!(
            matches!(closed.diagnosis.verdict, Verdict::NoGap | Verdict::Parameters),
            "{name}: {:?}",
            named(&closed)
        );
    }
}

#[test]
fn a_scale_factor_that_follows_the_temperature_is_named() {
    let effect = json!({"effect": "temperature_scale", "x": 2e-4, "y": -1e-4, "z": 1e-4, "reference_c": 30.0});
    let truth = model(json!({"gyro": {"effects": [effect]}}), json!({}));
    let warm = |t: usize| 30.0 + 5.0 * (4e-4 * t as f64).sin();
    let course = Course::new(Kind::RateTable, SAMPLES as f64 / RATE_HZ, Site::default()).unwrap();
    let motions: Vec<Motion> = course.sampled(RATE_HZ).take(SAMPLES).collect();
    let motions =
        motions.into_iter().enumerate().map(move |(t, motion)| Motion { temperature_c: Some(warm(t)), ..motion });
    let mut simulator = Simulator::new(&truth, 36, RATE_HZ, SAMPLES as f64 / RATE_HZ).unwrap().with_motion(motions);
    let mut channels: Vec<_> = truth.channels.keys().map(|channel| (*channel, Vec::new())).collect();
    while let Some(sample) = simulator.next_sample() {
        channels.iter_mut().for_each(|(channel, values)| values.push(sample.values[*channel as usize]));
    }
    channels.iter_mut().for_each(|(_, values)| values.truncate(SAMPLES));
    let real = Recording {
        rate_hz: RATE_HZ,
        channels,
        temperature_c: Some((0..SAMPLES).map(warm).collect()),
        ..Recording::default()
    };
    let plain = model(json!({}), json!({}));
    let found = diagnose_moved(&real, &reference(Kind::RateTable, SAMPLES, 0.0), &plain, &Options::default()).unwrap();
    assert!(named(&found).contains(&("gyro".to_owned(), "temperature_scale")), "{:?}", named(&found));
    let cause = found.diagnosis.causes.iter().find(|cause| cause.effect == EffectKind::TemperatureScale).unwrap();
    let x = cause.parameters["gyro"]["x"].as_f64().unwrap();
    assert!((x - 2e-4).abs() < 2e-5, "{:?}", cause.parameters);
}

#[test]
fn effects_of_motion_and_of_the_noise_are_named_together() {
    let line = json!([{"effect": "tone", "frequency_hz": 7.3, "amplitude": 5e-4}]);
    let truth = model(
        json!({"gyro": {"effects": [{"effect": "scale_factor", "x": 1e-3, "y": 1e-3, "z": 1e-3}]}}),
        json!({"gyro_y": line}),
    );
    let found = diagnosed(&truth, Kind::RateTable, 31);
    let mut named = named(&found);
    named.sort();
    assert_eq!(named, [("gyro".to_owned(), "scale_factor"), ("gyro_y".to_owned(), "tone")]);
}

#[test]
fn a_filter_is_no_latency() {
    let filter = json!([{"effect": "low_pass", "cutoff_hz": 6.0, "order": 1}]);
    let truth = model(json!({}), json!({"gyro_x": filter, "gyro_y": filter, "gyro_z": filter}));
    let found = diagnosed(&truth, Kind::RateTable, 32);
    assert_eq!(named(&found), [("gyro_x gyro_y gyro_z".to_owned(), "low_pass")]);
    // The corrected model states how well it knows the cutoffs. On another record of that sensor, they are not reported as a
    // latency either.
    let again = recorded(&truth, Kind::RateTable, SAMPLES, 35);
    let reference = reference(Kind::RateTable, SAMPLES, 0.0);
    let closed = diagnose_moved(&again, &reference, &found.augmented, &Options::default()).unwrap();
    assert!(named(&closed).is_empty(), "{:?}", named(&closed));
}

#[test]
fn what_the_library_does_not_have_is_unknown() {
    let plain = model(json!({}), json!({}));
    let mut real = recorded(&plain, Kind::RateTable, SAMPLES, 33);
    let reference = reference(Kind::RateTable, SAMPLES, 0.0);
    let mut dragged = 0.0f64;
    let mut near = 0;
    for (t, value) in real.channels[3].1.iter_mut().enumerate() {
        let rate = reference.at(t as f64 / RATE_HZ, &mut near).gyro_rad_s[0];
        dragged = dragged.clamp(rate - 0.4, rate + 0.4);
        *value += 2e-3 * (dragged - rate);
    }
    let found = diagnose_moved(&real, &reference, &plain, &Options::default()).unwrap();
    println!("{}", serde_json::to_string_pretty(&found.diagnosis).unwrap());
    assert_eq!(found.diagnosis.verdict, Verdict::UnknownEffect);
    assert!(found.diagnosis.notes[0].contains("play"), "{:?}", found.diagnosis.notes);
}

#[test]
fn a_clock_of_its_own_is_distinguished_from_a_latency() {
    let truth = model(json!({"gyro": {"effects": [{"effect": "latency", "seconds": 0.05}]}}), json!({}));
    let real = recorded(&truth, Kind::RateTable, SAMPLES, 34);
    let course = Course::new(Kind::RateTable, SAMPLES as f64 / RATE_HZ, Site::default()).unwrap();
    // The reference begins 3.21 s into the motion and runs a little fast.
    let rows = (0..38_000).map(|i| f64::from(i) / 100.0).map(|s| (1e5 + s * (1.0 + 2e-5), course.at(3.21 + s)));
    let reference = Reference::new(rows).unwrap();
    let plain = model(json!({}), json!({}));
    let found = diagnose_moved(&real, &reference, &plain, &Options::default()).unwrap();
    println!("{}", serde_json::to_string_pretty(&found.diagnosis).unwrap());
    assert_eq!(named(&found), [("gyro".to_owned(), "latency")]);
    let seconds = found.diagnosis.causes[0].parameters["gyro"]["seconds"].as_f64().unwrap();
    assert!((seconds - 0.05).abs() < 0.003, "{seconds}");
}
