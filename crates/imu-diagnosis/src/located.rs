//! Located: every cause and every parameter that is off has its places. A channel without findings has none.

use super::report::{Of, Place};
use super::round_trip::{model, recording};
use super::{Options, Outcome, diagnose};
use serde_json::{Value, json};

const SAMPLES: usize = 32_000;
const LENGTH_S: f64 = 800.0;

fn found(sensor: Option<&Value>, declared: Option<&Value>, seed: u64) -> Outcome {
    diagnose(&recording(&model(sensor), seed, SAMPLES), &model(declared), &Options::default()).unwrap()
}

fn is_about(place: &Place, band_hz: [f64; 2], time_s: [f64; 2]) -> bool {
    let inside = |found: [f64; 2], [low, high]: [f64; 2]| found[0] >= low && found[1] <= high;
    inside(place.band_hz, band_hz) && inside([place.from_s, place.to_s], time_s)
}

/// Returns an effect, with the frequencies and times in which its places have to lie.
fn cases() -> Vec<(Value, [f64; 2], [f64; 2])> {
    let all = [0.0, LENGTH_S];
    vec![
        (json!({"effect": "tone", "frequency_hz": 11.37, "amplitude": 0.002}), [11.36, 11.38], all),
        (json!({"effect": "resonance", "frequency_hz": 8.3, "bandwidth_hz": 0.4, "sigma": 0.008}), [7.7, 8.9], all),
        (json!({"effect": "gauss_markov", "sigma": 0.012, "tc_s": 4.0}), [0.0, 4.0], all),
        (json!({"effect": "quantization_noise", "Q": 1.5e-4}), [2.0, 20.0], all),
        (json!({"effect": "low_pass", "cutoff_hz": 7.0, "order": 2}), [4.0, 20.0], all),
        (json!({"effect": "rate_ramp", "R": 1e-5}), [0.0, 0.02], all),
        (json!({"effect": "bias_step", "at_s": 400.0, "size": 0.02}), [0.0, 2.0], [395.0, 405.0]),
        (json!({"effect": "variance_change", "from_s": 300, "to_s": 420, "factor": 1.5}), [0.0, 20.0], [280.0, 440.0]),
        (json!({"effect": "bursts", "intervals": [[300.0, 302.0]], "sigma": 0.05}), [0.0, 20.0], [299.0, 303.0]),
        (json!({"effect": "spikes", "rate_hz": 0.05, "amplitude": 0.2}), [0.0, 20.0], all),
        (json!({"effect": "temperature_bias", "per_c": 0.005, "reference_c": 25.0}), [0.0, 0.1], all),
        (json!({"effect": "resolution", "step": 0.01}), [0.0, 20.0], all),
    ]
}

#[test]
fn a_cause_lies_where_it_acts_and_nowhere_else() {
    for ((effect, band_hz, time_s), seed) in cases().into_iter().zip(1..) {
        let outcome = found(Some(&effect), None, seed);
        let places = &outcome.diagnosis.r#where;
        for channel in ["accel_x", "accel_z"] {
            let own: Vec<&Place> = places.iter().filter(|place| place.channel == channel).collect();
            assert!(!own.is_empty(), "{effect}: {places:#?}");
            for place in own {
                assert!(is_about(place, band_hz, time_s), "{effect}: {place:#?}");
                assert!(place.of == Of::Cause(0) && place.p_value < 1e-3 && place.nats > 8.0, "{effect}: {place:#?}");
            }
        }
        assert!(places.iter().all(|place| place.channel != "accel_y"), "{effect}: {places:#?}");
        assert!((places.iter().map(|place| place.share).sum::<f64>() - 1.0).abs() < 1e-9);
    }
}

#[test]
fn what_the_model_has_elsewhere_has_both_its_places() {
    let tone = |frequency_hz: f64| json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": 0.004});
    let outcome = found(Some(&tone(3.3)), Some(&tone(14.1)), 5);
    let of = |band_hz: [f64; 2]| {
        let own = outcome.diagnosis.r#where.iter().filter(|place| is_about(place, band_hz, [0.0, LENGTH_S]));
        own.map(|place| (place.channel.as_str(), &*place.sign)).collect::<Vec<_>>()
    };
    assert_eq!(of([3.29, 3.31]), [("accel_x", "real noisier"), ("accel_z", "real noisier")]);
    assert_eq!(of([14.09, 14.11]), [("accel_x", "real quieter"), ("accel_z", "real quieter")]);
    let outcome = found(None, Some(&tone(14.1)), 6);
    let places = &outcome.diagnosis.r#where;
    assert!(places.len() == 2 && places.iter().all(|place| place.sign == "real quieter"), "{places:#?}");
}

#[test]
fn a_parameter_that_is_off_has_its_place_and_noise_has_none() {
    let real = recording(&model(None), 9, SAMPLES);
    let none = diagnose(&real, &model(None), &Options::default()).unwrap().diagnosis;
    assert!(none.r#where.is_empty(), "{:#?}", none.r#where);
    let mut off = model(None);
    let mut channels = off.channels.values_mut();
    channels.next().unwrap().n *= 1.5;
    channels.next().unwrap().k *= 20.0;
    drop(channels);
    let places = diagnose(&real, &off, &Options::default()).unwrap().diagnosis.r#where;
    let brief: Vec<(&str, Of, &str)> =
        places.iter().map(|place| (place.channel.as_str(), place.of, &*place.sign)).collect();
    let quieter = |channel| (channel, Of::Parameters, "real quieter");
    assert_eq!(brief, [quieter("accel_x"), quieter("accel_y")], "{places:#?}");
    assert!(places[0].band_hz[1] > 15.0 && places[1].band_hz[1] < 1.0, "{places:#?}");
}

#[test]
fn what_remains_has_a_place_of_its_own() {
    // A band that is present for a while only, which no model can state.
    let mut real = recording(&model(None), 12, SAMPLES);
    let values = &mut real.channels.iter_mut().find(|(channel, _)| channel.name() == "accel_y").unwrap().1;
    for (t, value) in values.iter_mut().enumerate().skip(16_000).take(8000) {
        // A line that sweeps from 6 to 9 Hz.
        let s = (t - 16_000) as f64 / 40.0;
        *value += 0.006 * (std::f64::consts::TAU * (6.0 * s + 0.5 * 3.0 * s * s / 200.0)).sin();
    }
    let found = diagnose(&real, &model(None), &Options::default()).unwrap().diagnosis;
    let own = found.r#where.iter().filter(|place| place.of == Of::Remainder).collect::<Vec<_>>();
    assert!(own.iter().all(|place| place.channel == "accel_y" && place.p_value < 0.01), "{found:#?}");
    assert!(!own.is_empty(), "{found:#?}");
}

/// The sign is that of the record relative to the original model.
#[test]
fn what_the_model_has_too_much_or_too_little_of_has_its_sign() {
    let gauss_markov = |sigma: f64| json!({"effect": "gauss_markov", "sigma": sigma, "tc_s": 4.0});
    let low_pass = |cutoff_hz: f64| json!({"effect": "low_pass", "cutoff_hz": cutoff_hz, "order": 2});
    let louder = |factor: f64| json!({"effect": "variance_change", "from_s": 200, "to_s": 500, "factor": factor});
    let ramp = |r: f64| json!({"effect": "rate_ramp", "R": r});
    for (own, declared, sign) in [
        (None, Some(gauss_markov(0.012)), "real quieter"),
        (None, Some(low_pass(7.0)), "real noisier"),
        (Some(low_pass(10.0)), Some(low_pass(5.0)), "real noisier"),
        (Some(low_pass(5.0)), Some(low_pass(10.0)), "real quieter"),
        (Some(gauss_markov(0.036)), Some(gauss_markov(0.012)), "real noisier"),
        (Some(louder(1.5)), Some(louder(3.0)), "real quieter"),
        (None, Some(ramp(3e-5)), "real quieter"),
    ] {
        let places = found(own.as_ref(), declared.as_ref(), 21).diagnosis.r#where;
        assert!(!places.is_empty());
        for place in &places {
            assert_eq!(place.sign, sign, "{own:?} {declared:?}: {places:#?}");
            assert!(place.to_s <= LENGTH_S && place.tau_s[1] <= LENGTH_S);
        }
        if own.is_none() && declared == Some(ramp(3e-5)) {
            assert!(places[0].band_hz[1] < 0.1, "{places:#?}");
        }
    }
}
